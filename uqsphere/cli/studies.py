"""What each command does that begins with a study and runs nothing but one scene: new, check, history, schema."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from uqsphere.console import plain, print_document, say, screen_width, table, wrap
from uqsphere.errors import AccessError, UsageError
from uqsphere.quantities import OUTPUTS, format_value, lookup, reading_units
from uqsphere.study import Study, json_schema, load_study, shipped_studies

if TYPE_CHECKING:
    from uqsphere.runner.forecast import Plan


def warn(study: Study) -> None:
    """Say what a user should know of a study, and of its services what was not said yet."""
    for text in study.warnings:
        say(f"warning: {text}")
    said = set(study.warnings)
    for name, service in study.services.items():
        for text in service.warnings:
            if text not in said:
                say(f"warning: service {plain(name)}: {text}")
        said |= set(service.warnings)


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
    """Validate a study; print the resolved scene and what a run will cost, and the same of its services."""
    from uqsphere.runner.forecast import plan_run

    study = load_study(chosen.study, chosen.overrides)
    warn(study)
    plan = plan_run(study)
    plans = plan.pop("services", {})
    if chosen.json:
        services = {
            name: {**own.resolved(), "hash": own.hash, "plan": plans[name]} for name, own in study.services.items()
        }
        nested = {"services": services} if services else {}
        print_document({**study.resolved(), "hash": study.hash, "plan": plan, **nested})
        return 0
    print(wrap(f"{study.title}: the study is valid", screen_width()))
    for name, part in study.parts.items():
        if name:
            print(f"\nservice {plain(name)}")
        _show_part(part, plans[name] if name else plan)
    return 0


def _show_part(study: Study, plan: Plan) -> None:
    """The numbers of one rig, and its plan."""
    from uqsphere.runner.forecast import plan_text

    width = screen_width()
    rows = []
    for name, value in study.at_means().items():
        law = study.random.get(name)
        text = format_value(value, name) if not study.black_box else f"{value:.6g}"
        source = study.sources.get(name)
        rows.append((name, text, law.family.name if law else "fixed", _short(source.text) if source else "study"))
    print("\n" + table(("number", "mean", "law", "source"), rows, width))
    print()
    if plan["scene"] is not None:
        print("\n".join(wrap(line, width) for line in _scene_lines(study, plan["scene"])))
    print("\n".join(wrap(line, width) for line in plan_text(study, plan).split("\n")))


def _scene_lines(study: Study, numbers: Mapping[str, float | None]) -> list[str]:
    """What loads the sphere, with the similarity numbers at the means."""
    if study.rig == "bars":
        bars = "infinite" if study.options["bars.infinite"] else "finite"
        theta = f"{numbers['theta']:.4g}" if numbers["theta"] is not None else "infinite"
        text = f"mu = {numbers['mu']:.4g} (mass of the sphere), theta = {theta} (length of the pulse); at the means"
        return [f"pulse: {study.options['pulse.shape']}; bars: {bars}", text]
    words = [f"{name.partition('.')[0]}: {word}" for name, word in study.options.items() if name.endswith(".kind")]
    speed = numbers["speed"]
    closing = "" if speed is None else f"; the bodies close at {format_value(speed, 'rig.speed')} square to the face"
    return [f"{'; '.join(words)}{closing}"]


def command_history(chosen: argparse.Namespace) -> int:
    """One deterministic scene over time."""
    from uqsphere.report.figures.history import units_of_history, write_history
    from uqsphere.runner.deterministic import history_of, history_summary

    study = load_study(chosen.study, chosen.overrides)
    warn(study)
    if study.black_box:
        raise UsageError("history shows an impact scene; this study is a black box")
    if study.rig == "none":
        raise UsageError("history shows the study's own rig, and this study has none but its services")
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
