"""What each command does that begins with a study and runs nothing but one scene: new, check, history, schema."""

from __future__ import annotations

import argparse
from pathlib import Path

from uqsphere.console import plain, print_document, say, screen_width, table, wrap
from uqsphere.errors import AccessError, UsageError
from uqsphere.quantities import OUTPUTS, format_value, lookup, reading_units
from uqsphere.study import Study, json_schema, load_study, shipped_studies


def warn(study: Study) -> None:
    """Say what a user should know of a study."""
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
        print_document({"written": written})
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


def _short(text: str, longest: int = 60) -> str:
    return text if len(text) <= longest else text[: longest - 1].rstrip() + "…"


def command_check(chosen: argparse.Namespace) -> int:
    """Validate a study; print the resolved scene and what a run will cost."""
    from uqsphere.runner.forecast import plan_run, plan_text

    study = load_study(chosen.study, chosen.overrides)
    warn(study)
    plan = plan_run(study)
    if chosen.json:
        print_document({**study.resolved(), "hash": study.hash, "plan": plan})
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


def command_history(chosen: argparse.Namespace) -> int:
    """One deterministic scene over time."""
    from uqsphere.report.figures.history import units_of_history, write_history
    from uqsphere.runner.deterministic import history_of, history_summary

    study = load_study(chosen.study, chosen.overrides)
    warn(study)
    if study.black_box:
        raise UsageError("history shows an impact scene; this study is a black box")
    trace = history_of(study)
    with reading_units(units_of_history(trace)):
        summary = history_summary(trace)
    if chosen.out is not None:
        summary["written"] = [str(path) for path in write_history(trace, study, chosen.out)]
    if chosen.json:
        print_document(summary)
        return 0
    print(f"{plain(study.title)}: one scene, every number at its mean\n")
    rows = [(lookup(name).meaning if name in OUTPUTS else name, text) for name, text in summary["lines"]]
    print(table(("what", "value"), rows))
    for path in summary.get("written", []):
        print(f"wrote {path}")
    return 0


def command_schema(chosen: argparse.Namespace) -> int:
    """Print the JSON schema of study files."""
    print_document(json_schema())
    return 0
