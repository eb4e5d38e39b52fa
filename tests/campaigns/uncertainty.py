"""Evidence for the uncertainty engine: accuracy beside peers, coverage of intervals, overhead, rough outputs."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from tests.campaigns import chaos, coverage, given, overhead, rough, study_runs, surrogates
from tests.campaigns.chaos import MODELS, Measured
from tests.campaigns.coverage import LEAST, NOMINAL, POOLED, CoverageRow, pooled
from uqsphere.errors import FolderError, UsageError
from uqsphere.report.figures.canvas import BLUE, GREEN, GREY, INK, MARKS, ORANGE, PURPLE, RED, SKY, Picture, new_figure

if TYPE_CHECKING:
    from uqsphere.report.figures.canvas import Picture

__all__ = [
    "PARTS",
    "SCHEMA_VERSION",
    "Part",
    "chaos_figure",
    "coverage_figure",
    "rough_figure",
    "run_uncertainty",
    "study_figure",
    "surrogate_figure",
]

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
    versions = sorted({one.version for one in chaos.stored().values()})
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
        "those of a stored run of its own (`python -m tests.campaigns.chaos --store`), where the design was the same.",
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
        told = f"`python -m tests.campaigns.uncertainty {name}`: {part['seconds']:,.0f} s{how}."
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

    from uqsphere.report.figures.canvas import render, style

    unknown = [name for name in parts if name not in PARTS]
    if unknown:
        raise UsageError(f"unknown part {unknown[0]!r} (allowed: all, {', '.join(PARTS)})")
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


# --- Figures of the benchmark of the uncertainty engine.

_COLOURS = (BLUE, ORANGE, GREEN, RED, SKY, PURPLE)


def _powers(value: float, _: object = None) -> str:
    """Powers of ten as the tables have them."""
    return f"{value:,.0f}" if 1.0 <= value < 1e7 else f"{value:.0e}" if value < 1e-3 else f"{value:g}"


def _logarithmic(panel: Any, axes: str) -> None:
    for name in axes:
        axis = panel.xaxis if name == "x" else panel.yaxis
        getattr(panel, f"set_{name}scale")("log")
        axis.set_major_formatter(_powers)
        axis.set_minor_formatter(lambda value, _: "")
    panel.grid(True, which="major")


def chaos_figure(fits: Sequence[Measured]) -> Picture:
    """True error beside the peer's and beside the reported one, one panel each."""
    sizes = list(dict.fromkeys(one.samples for one in fits))
    pairs = [one for one in fits if one.rival_true is not None]
    figure, axes = new_figure(8.4 if pairs else 4.4, rows=2 if pairs else 1)
    # both are rounding below that
    floor = 1e-16
    for k, samples in enumerate(sizes):
        look: dict[str, Any] = {"color": _COLOURS[k % 6], "marker": MARKS[k % 6], "linestyle": "none", "markersize": 5}
        here = [one for one in pairs if one.samples == samples]
        if here:
            theirs = [max(one.rival_true or 0.0, floor) for one in here]
            axes[0].plot(theirs, [max(one.true, floor) for one in here], label=f"{samples} points", **look)
        group = [one for one in fits if one.samples == samples]
        axes[-1].plot(
            [max(one.true, floor) for one in group], [max(one.reported, floor) for one in group],
            label=f"{samples} points", **look,
        )  # fmt: skip
    ends = np.array([min(max(one.true, floor) for one in fits) / 5.0, 3.0])
    for panel in axes:
        panel.plot(ends, ends, color=INK, linewidth=1.0)
        _logarithmic(panel, "xy")
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    if pairs:
        axes[0].set_xlabel("error of OpenTURNS, its best degree and norm")
        axes[0].set_ylabel("error of uqsphere")
        axes[0].set_title("Below the line: uqsphere is nearer to the truth")
    axes[-1].fill_between(ends, ends / 3.0, ends * 3.0, color=GREY, alpha=0.2, linewidth=0.0)
    axes[-1].set_xlabel("true relative mean square error")
    axes[-1].set_ylabel("reported by the fit")
    axes[-1].set_title("Grey: within a factor 3")
    honest = sum(one.honest for one in fits)
    better = sum(one.true < (one.rival_true or 0.0) for one in pairs)
    beside = f"Nearer to the truth than OpenTURNS in {better} of {len(pairs)} fits; " if pairs else ""
    return Picture(name="chaos", title="Errors of polynomial chaos", figure=figure,
                   finding=f"{beside}reported within a factor 3 in {honest} of {len(fits)}.")  # fmt: skip


def coverage_figure(rows: Sequence[CoverageRow]) -> Picture:
    """Share of intervals that hold the truth: the pooled rows, and the cells that they are made of."""
    due = pooled(rows)
    figure, (panel,) = new_figure(1.6 + 0.27 * len(due))
    for place, row in enumerate(due):
        cells = [r for r in rows if (r.kind, r.way, r.points) == (row.kind, row.way, row.points) and not r.exact]
        panel.plot([100.0 * r.covered for r in cells], [place] * len(cells), color=GREY, marker="|", linestyle="none",
                   markersize=7, label="cells" if place == 0 else None)  # fmt: skip
        error = 196.0 * (NOMINAL * (1.0 - NOMINAL) / row.repetitions) ** 0.5
        panel.errorbar([100.0 * row.covered], [place], xerr=[error], color=BLUE, marker="o", markersize=5,
                       label="pooled, and what chance allows" if place == 0 else None)  # fmt: skip
    panel.axvspan(100.0 * POOLED[0], 100.0 * POOLED[1], color=GREEN, alpha=0.15, linewidth=0.0)
    panel.axvline(100.0 * LEAST, color=RED, linewidth=1.0, linestyle="--", label=f"cells: at least {LEAST:.0%}")
    panel.set_yticks(range(len(due)), [f"{row.kind}, {row.way}, {row.points}" for row in due])
    panel.set_ylim(len(due) - 0.4, -0.6)
    panel.set_xlabel("intervals that hold the truth [%]; green: due")
    panel.grid(True, axis="x")
    figure.legend(loc="outside upper center", ncols=3)
    inside = sum(POOLED[0] <= row.covered <= POOLED[1] for row in due)
    return Picture(name="coverage", title="Coverage of nominal 95 % intervals", figure=figure,
                   finding=f"Pooled, {inside} of {len(due)} kinds lie where they are due.")  # fmt: skip


def surrogate_figure(content: dict[str, Any]) -> Picture:
    """True and reported error of every fit against evaluations."""
    fits = content["fits"]
    figure, (panel,) = new_figure(3.6)
    for key, colour, mark, shift, label in (
        ("error", BLUE, "o", 0.97, "1 - Q² on points that were not fitted"),
        ("reported", ORANGE, "s", 1.03, "reported by the fit"),
    ):
        panel.plot([shift * fit["points"] for fit in fits], [fit[key] for fit in fits], color=colour, marker=mark,
                   linestyle="none", markersize=4.5, label=label)  # fmt: skip
    panel.axhline(content["due"], color=INK, linewidth=1.0, linestyle="--", label=f"{content['due']:g}")
    _logarithmic(panel, "xy")
    panel.set_xticks(sorted({fit["points"] for fit in fits}))
    panel.set_xlabel("evaluations that the surrogate was fitted to")
    panel.set_ylabel("share of the variance")
    panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)
    return Picture(
        name="granite", title=f"Surrogates of {content['quantity']}, study {content['study']}", figure=figure,
        finding="How far fits came with their evaluations, and what they report of themselves.",
    )  # fmt: skip


def rough_figure(content: dict[str, Any]) -> Picture:
    """The jump along one input, and the distribution that comes of it."""
    figure, (above, below) = new_figure(7.6, rows=2)
    curve, spread = content["curve"], content["distribution"]
    low, high = (1e6 * end for end in content["gap"])
    length = 1e3 * np.array(curve["length"])
    truth = 1e6 * np.array(curve["truth"])
    # a line across the jump would be a value that nothing has
    truth = np.where(np.append(np.diff(truth), 0.0) > 0.5 * (high - low), np.nan, truth)
    label = f"plain expansion, degree {content['degree']}"
    above.plot(length, truth, color=INK, linewidth=2.0, label="model")
    above.plot(length, 1e6 * np.array(curve["plain"]), color=RED, linestyle="--", label=label)
    above.set_xlabel("length of the striker [mm], at the mean speed")
    above.set_ylabel("contact time [us]")
    share = np.array(spread["share"])
    times = 1e6 * np.array(spread["truth"])
    below.plot(times, share, color=INK, linewidth=2.0, label=f"model, {content['truth_evaluations']:,} evaluations")
    below.plot(1e6 * np.array(spread["plain"]), share, color=RED, linestyle="--", label=label)
    first = True
    for name, row in content["answers"].items():
        ours = row["engine"]
        if name.startswith("quantile") and ours["value"] is not None:
            value = 1e6 * ours["value"]
            reach = [[value - 1e6 * ours["low"]], [1e6 * ours["high"] - value]]
            below.errorbar([value], [float(name.split()[1])], xerr=reach, color=BLUE, marker="o", markersize=5,
                           linestyle="none", label="engine: quantiles, 95 % intervals" if first else None)  # fmt: skip
            first = False
    ours = content["answers"]["probability"]["engine"]
    if ours["value"] is not None:
        reach = [[ours["value"] - ours["low"]], [ours["high"] - ours["value"]]]
        below.errorbar([1e6 * content["level"]], [1.0 - ours["value"]], yerr=[[reach[1][0]], [reach[0][0]]], color=BLUE,
                       marker="D", markersize=5, linestyle="none",
                       label=f"engine: probability up to {1e6 * content['level']:g} us")  # fmt: skip
    below.axvspan(low, high, color=GREY, alpha=0.2, linewidth=0.0)
    above.axhspan(low, high, color=GREY, alpha=0.2, linewidth=0.0)
    below.set_xlabel("contact time [us]; grey: no scene has such a one")
    below.set_ylabel("share of the scenes up to it")
    for panel in (above, below):
        panel.grid(True)
        panel.legend(loc="upper left")
    probability = content["answers"]["probability"]
    off = abs(probability["plain"] / probability["truth"] - 1.0)
    return Picture(
        name="rough", title="A contact time that jumps", figure=figure,
        finding=f"The smooth expansion puts {content['in_gap']:.0%} of the scenes where there are none and is off by "
        f"{off:.0%} in a probability; the engine samples, and its intervals hold the truth.",
    )  # fmt: skip


def study_figure(content: dict[str, Any], column: int) -> Picture:
    """Error over what was asked against evaluations (column 0) or seconds (1): a panel for each study."""
    from matplotlib.ticker import LogLocator

    runs = content["runs"]
    figure, axes = new_figure(2.5 * len(runs), rows=len(runs))
    words = ("mean", "quantile", "probability", "index")
    shown = ("mean", "worst quantile", "probability", "widest index")
    used: set[int] = set()
    at = [p[column] for run in runs for s in run["series"] for p in s["points"] if p[column] > 0.0]
    for panel, run in zip(axes, runs, strict=True):
        # nothing is asked of what a surrogate leaves unexplained
        for s in (s for s in run["series"] if "variance" not in s["kind"]):
            k = next(k for k, word in enumerate(words) if word in s["kind"])
            points = [p for p in s["points"] if p[column] > 0.0]
            panel.plot(
                [p[column] for p in points], [p[2] / s["asked"] for p in points], color=_COLOURS[k], marker=MARKS[k],
                markersize=4.0, linewidth=1.0, label=None if k in used else shown[k],
            )  # fmt: skip
            used |= {k} if points else set()
        panel.axhline(1.0, color=INK, linewidth=1.0, linestyle="--")
        _logarithmic(panel, "xy")
        panel.set_xlim(min(at, default=1.0) / 1.3, 1.3 * max(at, default=10.0))
        panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        panel.set_title(run["study"])
        panel.set_ylabel("error over asked")
    axes[-1].set_xlabel("model evaluations" if column == 0 else "seconds since the start")
    figure.legend(loc="outside lower center", ncols=4)
    reached = [s["points"][-1][2] <= s["asked"] for run in runs for s in run["series"] if "variance" not in s["kind"]]
    return Picture(
        name="studies-evaluations" if column == 0 else "studies-seconds", figure=figure,
        title="Error against " + ("evaluations" if column == 0 else "time"),
        finding=f"{sum(reached)} of {len(reached)} errors are below what was asked (dashed) after the last evaluation.",
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Measures parts; the text goes to stdout, progress to stderr."""
    parser = argparse.ArgumentParser(description="The uncertainty engine, measured")
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"some of {', '.join(PARTS)} (default: all)")
    parser.add_argument("--quick", action="store_true", help="fewer of everything")
    parser.add_argument("--out", type=Path, metavar="DIR", default=Path("uq-results"))
    asked = parser.parse_args(arguments)

    def notice(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    print(run_uncertainty(asked.out, parts=asked.parts or list(PARTS), quick=asked.quick, notice=notice)["text"])
    return 0


if __name__ == "__main__":
    sys.exit(main())
