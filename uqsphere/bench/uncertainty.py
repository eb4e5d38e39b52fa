"""Evidence for the uncertainty engine: accuracy beside peers, coverage of intervals, overhead, rough outputs."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from uqsphere.bench import chaos, chaos_rival, coverage, given, overhead, rough, study_runs, surrogates
from uqsphere.bench.chaos_models import MODELS
from uqsphere.errors import FolderError, UsageError

if TYPE_CHECKING:
    from uqsphere.report.canvas import Picture

__all__ = ["PARTS", "SCHEMA_VERSION", "Part", "run_uncertainty"]

SCHEMA_VERSION: Final = 2
_FILE: Final = "uq.json"
_SIZES: Final = (64, 128, 256, 512)


@dataclass(frozen=True, kw_only=True)
class Part:
    """A measurement (quick, notice) -> what JSON holds; from that alone the text below its title, and figures."""

    title: str
    measure: Callable[[bool, Callable[[str], None]], dict[str, Any]]
    text: Callable[[dict[str, Any]], str]
    figures: Callable[[dict[str, Any]], list[Picture]]


# --- polynomial chaos -----------------------------------------------------------------------------


def _measure_chaos(quick: bool, notice: Callable[[str], None]) -> dict[str, Any]:
    sizes = _SIZES[:1] if quick else _SIZES

    def tell(one: chaos.Measured) -> None:
        rival = "" if one.rival_true is None else f"; OpenTURNS {one.rival_true:.1e} in {one.rival_seconds:.1f} s"
        notice(f"{one.model}, {one.samples} points, seed {one.seed}: {one.true:.1e} in {one.seconds:.2f} s{rival}")

    found = chaos.measure(list(MODELS), sizes, chaos.SEEDS[: 1 if quick else None], notice=tell)
    versions = sorted({one.version for one in chaos_rival.stored().values()})
    return {"checked": chaos.CHECKED, "peer": ", ".join(versions), "fits": [asdict(one) for one in found]}


def _chaos_text(content: dict[str, Any]) -> str:
    fits = [chaos.Measured(**one) for one in content["fits"]]
    peerless = all(one.rival_true is None for one in fits)
    lines = [
        f"Relative mean square error on {content['checked']:,} points that no fit has seen, median over the designs; "
        "the error that the fit reports; processor seconds of one thread.",
        "Nothing stands beside it: no run of OpenTURNS is stored for these designs." if peerless else
        f"OpenTURNS {content['peer']} (LARS, corrected leave-one-out) has the first design, the same points and germs; "
        "of all its degrees and norms the one with the least true error is counted, and the seconds of all are added "
        "up. It stops a norm after two degrees that were worse. Its numbers are "
        "those of a stored run of its own (`python -m uqsphere.bench.chaos_rival`), where the design was the same.",
        "", chaos.table(fits), "",
        f"Design by design: no worse is an error within 5 %, or both below {chaos.EXACT:g}; better is a smaller one, "
        f"and not both below that. Designs: {', '.join(str(one) for one in dict.fromkeys(fit.seed for fit in fits))}.",
        "",
        "| N | no worse | better | of | slowest fit, s | error within a factor 3 | "
        f"or both below {chaos.EXACT:g} |", "|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    sizes = list(dict.fromkeys(one.samples for one in fits))
    for name, group in [
        *((str(samples), [one for one in fits if one.samples == samples]) for samples in sizes),
        *([("all", fits)] if len(sizes) > 1 else []),
    ]:
        no_worse, better, compared = chaos.verdicts(group)
        slowest = max(one.seconds for one in group)
        honest = sum(one.honest for one in group)
        small = sum(one.honest or max(one.true, one.reported) < chaos.EXACT for one in group)
        lines.append(f"| {name} | {no_worse} | {better} | {compared} | {slowest:.2f} | {honest} of {len(group)} | "
                     f"{small} of {len(group)} |")  # fmt: skip
    lines += ["", "Slowest fit of each model, s:", ""]
    lines += ["| model | " + " | ".join(str(samples) for samples in sizes) + " |", "|---" * (1 + len(sizes)) + "|"]
    for model in dict.fromkeys(one.model for one in fits):
        times = [[one.seconds for one in fits if (one.model, one.samples) == (model, size)] for size in sizes]
        lines.append(f"| {model} | " + " | ".join(f"{max(some):.2f}" if some else "-" for some in times) + " |")
    lines += ["", "Reported beyond a factor 3 of the true error:", ""]
    lines += ["| model | too small | too large | of | reported over true |", "|---|---|---|---|---|"]
    for model in dict.fromkeys(one.model for one in fits):
        group = [one for one in fits if one.model == model]
        off = [one.reported / max(one.true, 1e-24) for one in group if not one.honest]
        if off:
            small = sum(ratio < 1.0 for ratio in off)
            spans = f"{min(off):.2g} to {max(off):.2g}" if len(off) > 1 else f"{off[0]:.2g}"
            lines.append(f"| {model} | {small} | {len(off) - small} | {len(group)} | {spans} |")
    return "\n".join(lines)


def _chaos_figures(content: dict[str, Any]) -> list[Picture]:
    from uqsphere.bench.uncertainty_figures import chaos_figure

    return [chaos_figure([chaos.Measured(**one) for one in content["fits"]])]


# --- coverage -------------------------------------------------------------------------------------


def _measure_coverage(quick: bool, notice: Callable[[str], None]) -> dict[str, Any]:
    rows, _, _ = coverage.coverage_table(quick=quick, notice=notice)
    return {"cells": [asdict(row) for row in rows], "pooled": [asdict(row) for row in coverage.pooled(rows)]}


def _coverage_text(content: dict[str, Any]) -> str:
    cells = [coverage.CoverageRow(**row) for row in content["cells"]]
    living = [row for row in cells if not row.exact]
    lowest = min(living, key=lambda row: row.covered)
    models = len({row.model for row in cells})
    low, high = coverage.POOLED
    due = coverage.pooled(cells)
    inside = sum(low <= row.covered <= high for row in due)
    return "\n".join([
        f"How often nominal 95 % intervals hold the truth, on {models} models with known answers, two of them with "
        "inputs that do nothing. Pooled rows first, the mean over the models, then every cell below "
        f"{coverage.LEAST:.0%}.",
        "",
        coverage.coverage_text(cells, cells=False),
        "",
        f"Pooled between {low:.1%} and {high:.0%}: {inside} of {len(due)} kinds. Lowest of {len(living)} cells: "
        f"{lowest.covered:.1%} ({lowest.kind}, {lowest.way}, {lowest.model} {lowest.answer}, {lowest.points} points, "
        f"{lowest.repetitions:,} repetitions).",
    ])  # fmt: skip


def _coverage_figures(content: dict[str, Any]) -> list[Picture]:
    from uqsphere.bench.uncertainty_figures import coverage_figure

    return [coverage_figure([coverage.CoverageRow(**row) for row in content["cells"]])]


PARTS: Final[dict[str, Part]] = {
    "chaos": Part(title="Polynomial chaos", measure=_measure_chaos, text=_chaos_text, figures=_chaos_figures),
    "coverage": Part(
        title="Coverage of the intervals", measure=_measure_coverage, text=_coverage_text, figures=_coverage_figures
    ),
    "given": Part(
        title="Coverage from given runs", measure=given.measure, text=given.text, figures=given.figures
    ),
    "overhead": Part(
        title="What indices cost beside the model", measure=overhead.measure, text=overhead.text,
        figures=overhead.figures,
    ),
    "granite": Part(
        title="Surrogates of the granite study", measure=surrogates.measure, text=surrogates.text,
        figures=surrogates.figures,
    ),
    "rough": Part(title="A rough output", measure=rough.measure, text=rough.text, figures=rough.figures),
    "studies": Part(
        title="The shipped studies on a small budget", measure=study_runs.measure, text=study_runs.text,
        figures=study_runs.figures,
    ),
}  # fmt: skip


def _machine() -> dict[str, Any]:
    from importlib import metadata

    from uqsphere.bench.machine import describe_machine

    found = describe_machine()
    packages = {}
    for name in ("numpy", "scipy", "numba", "chaospy", "SALib", "openturns"):
        try:
            packages[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            packages[name] = "absent (extra: peers)" if name == "openturns" else "absent"
    return {**found, "packages": packages}


def _kept(folder: Path) -> dict[str, Any]:
    """Parts that an earlier benchmark left in the folder."""
    path = folder / _FILE
    if not path.is_file():
        return {}
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        parts = {name: part for name, part in found["parts"].items() if name in PARTS and isinstance(part, dict)}
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise FolderError(f"{path} is not what this benchmark writes: choose another folder with --out") from error
    if found.get("schema_version") != SCHEMA_VERSION:
        raise FolderError(f"{path} is of another version of the benchmark: choose another folder with --out")
    return parts


def _machine_text(machine: dict[str, Any]) -> str:
    packages = ", ".join(f"{name} {version}" for name, version in machine["packages"].items())
    return f"{machine['processor']}, {machine['system']}, Python {machine['python']}; {packages}."


def _text(content: dict[str, Any]) -> str:
    last = _machine_text(content["machine"])
    lines = ["# The uncertainty engine, measured", "", last, "One thread of linear algebra throughout."]
    for name, part in content["parts"].items():
        how = ", quick" if part["quick"] else ""
        told = f"`uqsphere bench --uq {name}`: {part['seconds']:,.0f} s{how}."
        # what was measured in pieces says so
        told += f" {part['note']}" if "note" in part else ""
        # as was what was measured elsewhere
        on = _machine_text(part["machine"])
        told += "" if on == last else f" On {on}"
        lines += ["", f"## {PARTS[name].title}", "", told, "", PARTS[name].text(part)]
    return "\n".join(lines)


def run_uncertainty(
    folder: Path, *, parts: Sequence[str], quick: bool, notice: Callable[[str], None]
) -> dict[str, Any]:
    """Measure parts and write uq.json, uq.md and figures/*.svg to `folder`.

    Parts that an earlier benchmark measured there are kept, so that long ones can be measured by themselves.

    Raises
    ------
    UsageError
        For a part that does not exist.
    FolderError
        When the folder holds something that is no such benchmark.
    """
    from threadpoolctl import threadpool_limits

    from uqsphere.report.canvas import render, style

    unknown = [name for name in parts if name not in PARTS]
    if unknown:
        raise UsageError(f"--uq: unknown part {unknown[0]!r} (allowed: all, {', '.join(PARTS)})")
    if folder.exists() and (not folder.is_dir() or (any(folder.iterdir()) and not (folder / _FILE).is_file())):
        raise FolderError(f"{folder} is not empty and holds no such benchmark: choose another with --out")
    _kept(folder)
    content: dict[str, Any] = {}
    for name in PARTS:
        if name not in parts:
            continue
        notice(f"{name}: {PARTS[name].title}")
        begin = time.monotonic()
        with threadpool_limits(limits=1, user_api="blas"):
            found = PARTS[name].measure(quick, notice)
        machine = _machine()
        part = {"quick": quick, "seconds": time.monotonic() - begin, "machine": machine, **found}
        # read again: another process may have measured another part meanwhile
        kept = {**_kept(folder), name: part}
        content = {
            "schema_version": SCHEMA_VERSION, "machine": machine,
            "parts": {each: kept[each] for each in PARTS if each in kept},
        }  # fmt: skip
        (folder / "figures").mkdir(parents=True, exist_ok=True)
        with style():
            for picture in (figure for each, part in content["parts"].items() for figure in PARTS[each].figures(part)):
                (folder / "figures" / f"{picture.name}.svg").write_text(render(picture), encoding="utf-8")
        (folder / "uq.md").write_text(_text(content) + "\n", encoding="utf-8")
        (folder / _FILE).write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return {**content, "text": _text(content)}
