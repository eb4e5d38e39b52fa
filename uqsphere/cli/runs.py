"""What each command does.  stdout carries the result, stderr everything else."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
from pathlib import Path
from typing import Any

from uqsphere.bench.command import command_bench as command_bench
from uqsphere.cli.watch import KILLED, attend, last_words
from uqsphere.console import plain, say, screen_width, table, wrap
from uqsphere.console import print_document as _document
from uqsphere.errors import AccessError, FolderError, UsageError
from uqsphere.experiment import command_records as command_records
from uqsphere.planning.command import command_plan as command_plan
from uqsphere.quantities import INPUTS, OUTPUTS, format_value, lookup, reading_units
from uqsphere.report.terminal import summary_of
from uqsphere.study import Study, json_schema, load_study, shipped_studies
from uqsphere.units import UNITS, UnitError, parse_value

#: exit code of a finished run that misses a target
MISSED = 3


def _warn(study: Study) -> None:
    for text in study.warnings:
        say(f"warning: {text}")


def command_new(chosen: argparse.Namespace) -> int:
    """Write a shipped study to a new file."""
    found = shipped_studies()
    if chosen.template not in found:
        raise UsageError(f"unknown template {chosen.template!r} (allowed: {', '.join(found)})")
    _write_new(chosen.output, found[chosen.template])
    written = [str(chosen.output)]
    study = found[chosen.template]
    # a study may have a model of its own, and tests of its own
    for source in (study.with_suffix(".py"), *sorted(study.parent.glob(f"{study.stem}_*.csv"))):
        target = chosen.output.parent / source.name
        if source.is_file() and not target.exists():
            _write_new(target, source)
            written.append(str(target))
    if chosen.json:
        _document({"written": written})
        return 0
    print(f"wrote {written[0]}; next: uqsphere check {written[0]}")
    for path in written[1:]:
        print(f"wrote {path}, {'its model' if path.endswith('.py') else 'its data'}")
    return 0


def _write_new(path: Path, source: Path) -> None:
    """Copy `source` to a file that must not exist yet; nothing is left behind where that fails."""
    try:
        text = source.read_text(encoding="utf-8")
        with open(path, "x", encoding="utf-8") as file:
            try:
                file.write(text)
                file.flush()
            except OSError:
                path.unlink(missing_ok=True)
                raise
    except FileExistsError as error:
        raise UsageError(f"{path} exists already: choose another name") from error
    except OSError as error:
        raise AccessError(f"{path}: {error.strerror}") from error


# --- check ----------------------------------------------------------------------------------------


def _short(text: str, longest: int = 60) -> str:
    return text if len(text) <= longest else text[: longest - 1].rstrip() + "…"


def command_check(chosen: argparse.Namespace) -> int:
    """Validate a study; print the resolved scene and what a run will cost."""
    from uqsphere.runner.plan import plan_run, plan_text

    study = load_study(chosen.study, chosen.overrides)
    _warn(study)
    plan = plan_run(study)
    if chosen.json:
        _document({**study.resolved(), "hash": study.hash, "plan": plan})
        return 0
    width = screen_width()
    print(wrap(f"{study.title}: the study is valid", width) + "\n")
    rows = []
    for name, value in study.at_means().items():
        law = study.random.get(name)
        text = format_value(value, name) if not study.black_box else f"{value:.6g}"
        source = study.sources.get(name)
        rows.append((name, text, law.family.name if law else "fixed", _short(source.text) if source else "study"))
    print(table(("number", "mean", "law", "source"), rows, width))
    print()
    if not study.black_box:
        numbers = plan["scene"]
        bars = "infinite" if study.options["bars.infinite"] else "finite"
        print(f"pulse: {study.options['pulse.shape']}; bars: {bars}")
        theta = f"{numbers['theta']:.4g}" if numbers["theta"] is not None else "infinite"
        text = f"mu = {numbers['mu']:.4g} (mass of the sphere), theta = {theta} (length of the pulse); at the means"
        print(wrap(text, width))
    print("\n".join(wrap(line, width) for line in plan_text(study, plan).split("\n")))
    return 0


# --- run ------------------------------------------------------------------------------------------


def _seconds(text: str | None) -> float | None:
    if text is None:
        return None
    try:
        seconds = parse_value(text, "time")
    except UnitError as error:
        raise UsageError(f"--budget: {error}") from error
    if seconds <= 0.0:
        raise UsageError(f"--budget must be positive, found {text}")
    return seconds


def command_run(chosen: argparse.Namespace) -> int:
    """Run a study and write its report."""
    from uqsphere.report import build_report
    from uqsphere.report.phrases import SUBJECTS, shortfalls

    study = load_study(chosen.study, chosen.overrides)
    _warn(study)
    if chosen.jobs is not None and chosen.jobs < 1:
        raise UsageError(f"--jobs must be at least 1, found {chosen.jobs}")
    with contextlib.ExitStack() as opened:
        executor = None
        if chosen.model is not None:
            opened.enter_context(last_words(KILLED))
        if chosen.dask is not None:
            from uqsphere.runner.cluster import dask_cluster

            executor = opened.enter_context(dask_cluster(chosen.dask, chosen.jobs))
        found, interrupted = attend(
            study,
            out=chosen.out,
            model=chosen.model,
            jobs=chosen.jobs,
            executor=executor,
            fresh=chosen.fresh,
            extend=chosen.extend,
            seconds=_seconds(chosen.budget),
        )
    if sys.stderr.isatty():
        say("writing the report")
    page = build_report(found.folder)
    for text in shortfalls(found.results.accuracy.missed, SUBJECTS):
        say(f"accuracy not reached: {text}")
    if chosen.json:
        _document(found.results.document())
    else:
        print(summary_of(found.results))
        print(f"\nreport: {page}")
    if interrupted:
        # what is there has been told; the command line says how to go on
        raise KeyboardInterrupt
    return 0 if found.met else MISSED


# --- history --------------------------------------------------------------------------------------


def command_history(chosen: argparse.Namespace) -> int:
    """One deterministic scene over time."""
    from uqsphere.report.figures.history import units_of_history, write_history
    from uqsphere.runner.deterministic import history_of, history_summary

    study = load_study(chosen.study, chosen.overrides)
    _warn(study)
    if study.black_box:
        raise UsageError("history shows an impact scene; this study is a black box")
    trace = history_of(study)
    with reading_units(units_of_history(trace)):
        summary = history_summary(trace)
    if chosen.out is not None:
        summary["written"] = [str(path) for path in write_history(trace, study, chosen.out)]
    if chosen.json:
        _document(summary)
        return 0
    print(f"{plain(study.title)}: one scene, every number at its mean\n")
    rows = [(lookup(name).meaning if name in OUTPUTS else name, text) for name, text in summary["lines"]]
    print(table(("what", "value"), rows))
    for path in summary.get("written", []):
        print(f"wrote {path}")
    return 0


# --- lists ----------------------------------------------------------------------------------------


def _materials() -> tuple[list[dict[str, Any]], str]:
    from uqsphere.materials import library

    content = []
    rows: list[tuple[str, ...] | str] = []
    for kind, materials in library().items():
        for name, material in materials.items():
            rows.append(f"{kind}: {name}")
            for key, entry in material.properties.items():
                content.append(
                    {
                        "kind": kind,
                        "material": name,
                        "property": key,
                        "value": entry.value,
                        "cov": entry.cov,
                        "source": entry.source,
                        "source_seen": entry.seen,
                    }
                )
                path = f"{kind}.{key}"
                stress = "p_max" if key.endswith("strength") else ""
                known = path if path in INPUTS else stress
                shown = format_value(entry.value, known) if known else f"{entry.value:.4g}"
                scatter = f"{100.0 * entry.cov:.0f} %" if entry.cov is not None else "-"
                rows.append((key, shown, scatter, entry.source + ("" if entry.seen else " (not seen)")))
    return content, table(("material", "value", "cov", "source"), rows, screen_width())


def _models() -> tuple[list[dict[str, Any]], str]:
    rows = [
        ("massless", "no mass of the sphere (mu = 0); closed form for a rectangle or step on infinite bars"),
        ("linear", "linear spring of the secant stiffness in place of the Hertz contact"),
        ("full", "Hertz contact at both faces, mass of the sphere, waves and reflections in the bars"),
        ("auto", "the cheapest of these whose measured error is small against the accuracy asked for"),
    ]
    return [{"fidelity": name, "meaning": text} for name, text in rows], table(
        ("fidelity", "meaning"), rows, screen_width()
    )


def _quantity_rows(names: list[str]) -> tuple[list[dict[str, Any]], str]:
    entries = [OUTPUTS[name] for name in names]
    content = [{"name": e.name, "unit": e.unit, "shown_in": e.display or e.unit, "meaning": e.meaning} for e in entries]
    return content, table(
        ("quantity", "unit", "meaning"),
        [(e.name, e.display or e.unit or "-", e.meaning) for e in entries],
        screen_width(),
    )


def _criteria() -> tuple[list[dict[str, Any]], str]:
    from uqsphere.mechanics.criteria import CRITERIA, PARAMETERS

    content: list[dict[str, Any]] = []
    rows = []
    for name, entry in CRITERIA.items():
        unit = next(iter(UNITS[entry.dimension]))
        keys = {key: PARAMETERS[key].meaning for key in (*entry.parameters, *entry.optional)}
        content.append({"criterion": name, "quantity": entry.quantity, "unit": unit, "meaning": entry.meaning,
                        "formula": entry.formula, "strength": entry.strength, "range": entry.range_text,
                        "source": entry.source, "required": list(entry.parameters), "parameters": keys})  # fmt: skip
        takes = ", ".join(key if key in entry.parameters else f"({key})" for key in keys)
        rows.append((name, entry.formula, unit, takes or "-", entry.range_text, entry.source))
    return content, table(("criterion", "demand", "unit", "takes", "range", "source"), rows, screen_width(), named=True)


def command_list(chosen: argparse.Namespace) -> int:
    """What there is to choose from."""
    if chosen.what == "materials":
        content, text = _materials()
    elif chosen.what == "models":
        content, text = _models()
    elif chosen.what == "quantities":
        content, text = _quantity_rows(list(OUTPUTS))
    else:
        content, text = _criteria()
    if chosen.json:
        _document(content)
    else:
        print(text)
    return 0


def command_analyse(chosen: argparse.Namespace) -> int:
    """Analyse a table of runs."""
    from uqsphere.given import analyse_data, analysis_text, known_laws, read_data, study_text

    def names(text: str) -> list[str]:
        return [name.strip() for name in text.split(",") if name.strip()]

    data = read_data(chosen.data, names(chosen.inputs), names(chosen.outputs))
    known = None if chosen.laws is None else known_laws(chosen.laws, data.inputs)
    found = analyse_data(data, known=known)
    if chosen.out is not None:
        if chosen.out.exists() and any(chosen.out.iterdir()) and not (chosen.out / "analysis.json").is_file():
            raise FolderError(f"{chosen.out} is not empty and holds no analysis: choose another with --out")
        chosen.out.mkdir(parents=True, exist_ok=True)
        text = json.dumps(found, indent=1, allow_nan=False) + "\n"
        (chosen.out / "analysis.json").write_text(text, encoding="utf-8")
        (chosen.out / "inputs.toml").write_text(study_text(found), encoding="utf-8")
    if chosen.json:
        _document(found)
    else:
        print(analysis_text(found))
        if chosen.out is not None:
            print(f"\nwritten to {chosen.out}: analysis.json, and inputs.toml to begin a study with")
    return 0


def command_schema(chosen: argparse.Namespace) -> int:
    """Print the JSON schema of study files."""
    _document(json_schema())
    return 0
