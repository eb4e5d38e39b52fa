"""Figures of the benchmark of the uncertainty engine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from uqsphere.bench.chaos import Measured
from uqsphere.bench.coverage import LEAST, NOMINAL, POOLED, CoverageRow, pooled
from uqsphere.report.canvas import BLUE, GREEN, GREY, INK, MARKS, ORANGE, PURPLE, RED, SKY, Picture, new_figure

__all__ = ["chaos_figure", "coverage_figure", "rough_figure", "study_figure", "surrogate_figure"]

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
