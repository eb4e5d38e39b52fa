"""What each input can move (tornado), and where the margin goes (waterfall)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.quantities import display_unit
from uqsphere.report.blocks import Table
from uqsphere.report.contents import Contents
from uqsphere.report.figures.canvas import (
    BLUE,
    GREY,
    INK,
    ORANGE,
    RED,
    Picture,
    legend_above,
    name_rows,
    new_figure,
    slug,
    style,
    wrap,
)
from uqsphere.report.figures.distributions import axis_label
from uqsphere.report.phrases import (
    begin,
    estimate_text,
    input_name,
    limit_name,
    number_text,
    rounded,
    short_input,
    symbol,
    the_input,
    value_text,
)
from uqsphere.results import IndexEntry, LimitEntry
from uqsphere.results.entries import Est
from uqsphere.uq.failure_indices import BY_INFORMATION

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: share of the samples at either end of an input
TENTH: Final = 0.1
#: samples at either end below which nothing is said
_FEWEST: Final = 40
#: bars of a tornado, steps of a waterfall
_MOST: Final = 10
_STEPS: Final = 5


@dataclass(frozen=True, kw_only=True)
class Swing:
    """Median of a quantity (SI) where an input is in its lowest and in its highest tenth, with 95 % intervals."""

    name: str
    at_low: tuple[float, float, float]
    at_high: tuple[float, float, float]
    below: float
    above: float

    @property
    def reach(self) -> float:
        return abs(self.at_high[0] - self.at_low[0])

    @property
    def seen(self) -> bool:
        """Whether the two ends are further apart than their intervals."""
        return self.at_low[2] < self.at_high[1] or self.at_high[2] < self.at_low[1]


def _median(values: Array) -> tuple[float, float, float]:
    """Median and its 95 % interval by order statistics (binomial, normal approximation): value, low, high."""
    ordered = np.sort(values)
    n = len(ordered)
    reach = 1.96 * 0.5 * math.sqrt(n)
    low, high = max(math.floor(0.5 * n - reach), 0), min(math.ceil(0.5 * n + reach), n - 1)
    return float(np.median(ordered)), float(ordered[low]), float(ordered[high])


def swings(contents: Contents, quantity: str) -> list[Swing]:
    """Swings of a quantity, the largest first; empty where the samples are too few, or half of them are bounds."""
    samples = contents.samples.get(quantity)
    if samples is None or TENTH * len(samples.values) < _FEWEST or samples.censored.mean() > 0.05:
        return []
    found = []
    for name in contents.results.sensitivity.get(quantity, IndexEntry()).first:
        x = contents.points.get(name)
        if x is None or not np.ptp(x) > 0.0:
            continue
        below, above = (float(v) for v in np.quantile(x, [TENTH, 1.0 - TENTH]))
        found.append(
            Swing(
                name=name,
                at_low=_median(samples.values[x <= below]),
                at_high=_median(samples.values[x >= above]),
                below=below,
                above=above,
            )
        )
    return sorted(found, key=lambda s: -s.reach)


def tornado_figure(contents: Contents, quantity: str) -> Picture | None:
    """Bars from the median in the lowest tenth of an input to that in its highest tenth; None without samples."""
    found = swings(contents, quantity)
    shown = found[:_MOST]
    if not shown or not shown[0].reach > 0.0:
        return None
    factor = display_unit(quantity)[1]
    middle = float(np.median(contents.samples[quantity].values)) * factor
    with style():
        figure, (axes,) = new_figure(1.2 + 0.42 * len(shown))
        ends = [v * factor for s in shown for v in (*s.at_low, *s.at_high)]
        left, right = min(*ends, middle), max(*ends, middle)
        margin = 0.2 * (right - left)
        axes.set_xlim(left - margin, right + margin)
        for row, s in enumerate(shown):
            _swing_bar(axes, row, s, middle, quantity)
        axes.axvline(middle, color=INK, linewidth=0.9)
        name_rows(axes, [wrap(short_input(s.name), 24) for s in shown], -0.6, -0.4)
        axes.spines["left"].set_visible(False)
        axes.set_xlabel(axis_label(quantity, f"median of {symbol(quantity, 30)}"))
        _end_legend(axes)
    rows = [(s.name, s.below, *s.at_low, s.above, *s.at_high) for s in found]
    return Picture(
        name=slug("tornado", quantity),
        title=f"How far each input moves {symbol(quantity)}",
        finding=tornado_finding(contents, quantity),
        figure=figure,
        header=(
            "input",
            "lowest tenth up to",
            "median there",
            "low",
            "high",
            "highest tenth from",
            "median there",
            "low",
            "high",
        ),
        rows=tuple(rows),
    )


def _swing_bar(axes: Axes, row: int, swing: Swing, middle: float, quantity: str) -> None:
    factor = display_unit(quantity)[1]
    for (value, low, high), colour, hatch in ((swing.at_low, BLUE, ""), (swing.at_high, ORANGE, "///")):
        x = value * factor
        axes.barh(
            row, x - middle, 0.55, left=middle, facecolor="none" if hatch else colour, edgecolor=colour, hatch=hatch,
            linewidth=1.0, alpha=1.0 if hatch else 0.75,
        )  # fmt: skip
        axes.plot([low * factor, high * factor], [row, row], color=INK, linewidth=1.1, marker="|", markersize=5)
    ends = sorted((swing.at_low, swing.at_high))
    # with both ends on one side of the middle the nearer one's number stands on the other bar
    over = (ends[0][0] * factor - middle) * (ends[1][0] * factor - middle) > 0.0
    for (value, low, high), side in zip(ends, ("right", "left"), strict=True):
        axes.annotate(
            rounded(Est.of(value, low, high), quantity).rsplit(" ", 1)[0],
            ((low if side == "right" else high) * factor, row),
            xytext=(-4 if side == "right" else 4, 0),
            ha=side,
            va="center",
            textcoords="offset points",
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6} if over else None,
            fontsize=8.0,
        )


def _end_legend(axes: Axes) -> None:
    from matplotlib.patches import Patch

    handles = [
        Patch(facecolor=BLUE, alpha=0.75, edgecolor=BLUE, label="input in its lowest tenth"),
        Patch(facecolor="none", edgecolor=ORANGE, hatch="///", label="in its highest tenth"),
    ]
    legend_above(axes, 2, handles, 1.4)


def tornado_finding(contents: Contents, quantity: str) -> str:
    """Which input moves the quantity furthest, from where to where."""
    found = [s for s in swings(contents, quantity) if s.seen]
    if not found:
        return f"No input is seen to move the median of {symbol(quantity)}."
    s = found[0]
    text = (
        f"{begin(s.name, short_input(s.name))} moves the median of {symbol(quantity)} furthest: from "
        f"{value_text(s.at_low[0], quantity, 4)} in its lowest tenth to {value_text(s.at_high[0], quantity, 4)} in its "
        "highest."
    )
    idle = len(swings(contents, quantity)) - len(found)
    if idle:
        text += f" {idle} input{'s are' if idle > 1 else ' is'} not seen to move it."
    return text


def furthest(contents: Contents, quantity: str) -> str:
    """The input that moves the median of a quantity furthest; empty where none is seen to."""
    return next((s.name for s in swings(contents, quantity) if s.seen), "")


def tornado_table(contents: Contents, quantity: str) -> Table | None:
    """Medians at both ends of every input."""
    found = swings(contents, quantity)
    if not found:
        return None

    def text(end: tuple[float, float, float]) -> str:
        return estimate_text(Est.of(end[0], end[1], end[2]), quantity)

    rows = tuple(
        (
            input_name(s.name),
            f"up to {value_text(s.below, contents.subject(s.name))}",
            text(s.at_low),
            f"from {value_text(s.above, contents.subject(s.name))}",
            text(s.at_high),
        )
        for s in found
    )
    header = ("input", "lowest tenth", "median there", "highest tenth", "median there")
    return Table(caption=f"Median of {symbol(quantity)} at both ends of each input", header=header, rows=rows)


# --- waterfall ----------------------------------------------------------------------------------------


def _steps(limit: LimitEntry) -> tuple[float, float, list[tuple[str, float]]]:
    """Median margin, margin at the bad end, and the factors of the inputs between them; empty where not known.

    The way in logarithms is shared out by importance factors, the squared direction cosines of the design point:
    for margins that are products of lognormal variables that is exact, as the shares of Euler's allocation.
    Failures in several directions have no such way.
    """
    margin, shares = limit.margin, limit.governing_inputs or {}
    if limit.governing_inputs_method == BY_INFORMATION:
        return 0.0, 0.0, []
    bad = "0.05" if limit.aim == "survive" else "0.95"
    ends = [e.number for key in ("median", bad) if (e := margin[key]).value is not None]
    if len(ends) < 2 or min(ends) <= 0.0 or ends[0] == ends[1]:
        return 0.0, 0.0, []
    whole = sum(float(v) for v in shares.values())
    if not whole > 0.0:
        return 0.0, 0.0, []
    way = math.log(ends[1] / ends[0])
    order = sorted(shares, key=lambda name: -float(shares[name]))
    steps = [(name, math.exp(way * float(shares[name]) / whole)) for name in order[:_STEPS]]
    rest = sum(float(shares[name]) for name in order[_STEPS:])
    if rest > 0.0:
        steps.append(("", math.exp(way * rest / whole)))
    return ends[0], ends[1], steps


def _step_name(name: str) -> str:
    return short_input(name) if name else "all others"


def waterfall_figure(contents: Contents, name: str) -> Picture | None:
    """From the median margin to the margin in the worst twentieth of cases, input by input; None where not known."""
    limit = contents.results.limits[name]
    begin_at, end_at, steps = _steps(limit)
    if not steps:
        return None
    with style():
        figure, (axes,) = new_figure(1.3 + 0.42 * (len(steps) + 2))
        low, high = min(1.0, begin_at, end_at), max(1.0, begin_at, end_at)
        width = 0.2 * (high - low) or 0.1
        axes.set_xlim(low - width, high + width)
        _whole_bar(axes, 0, begin_at)
        here = begin_at
        for row, (_, factor) in enumerate(steps, start=1):
            there = here * factor
            axes.barh(
                row, there - here, 0.55, left=here, facecolor="none", edgecolor=ORANGE, hatch="///", linewidth=1.0
            )
            axes.plot([here, here], [row - 0.73, row + 0.28], color=GREY, linewidth=0.7)
            _beside(axes, row, max(here, there), f"× {factor:.3f}")
            here = there
        axes.plot([here, here], [len(steps) + 0.27, len(steps) + 0.73], color=GREY, linewidth=0.7)
        _whole_bar(axes, len(steps) + 1, end_at)
        axes.axvline(1.0, color=RED, linestyle="--", linewidth=1.2)
        worst = "5 % case" if limit.aim == "survive" else "95 % case"
        words = ["median case", *(_step_name(n) for n, _ in steps), worst]
        name_rows(axes, [wrap(w, 24) for w in words], -0.9, -0.4)
        axes.spines["left"].set_visible(False)
        axes.set_xlabel("strength over demand (dashed: they are equal)")
    return Picture(
        name=slug("waterfall", name),
        title=f"Where the margin of {limit_name(name)} goes",
        finding=waterfall_finding(contents, name),
        figure=figure,
        header=("step", "factor"),
        rows=(("median", begin_at), *((n or "others", f) for n, f in steps), ("end", end_at)),
    )


def _whole_bar(axes: Axes, row: int, value: float) -> None:
    left = axes.get_xlim()[0]
    axes.barh(row, value - left, 0.55, left=left, facecolor=BLUE, alpha=0.75, edgecolor=BLUE)
    _beside(axes, row, value, f"{value:.3g}")


def _beside(axes: Axes, row: int, x: float, text: str) -> None:
    axes.annotate(text, (x, row), xytext=(5, 0), textcoords="offset points", va="center", fontsize=8.5)


def waterfall_finding(contents: Contents, name: str) -> str:
    """Which input takes most of the margin."""
    limit = contents.results.limits[name]
    begin_at, end_at, steps = _steps(limit)
    if not steps:
        return ""
    first, factor = steps[0]
    share = 100.0 * math.log(factor) / math.log(end_at / begin_at)
    text = (
        f"On the way from the median margin of {begin_at:.3g} to {end_at:.3g} in the worst twentieth of cases, "
        f"{_step_name(first)} takes {share:.0f} %."
    )
    missed = end_at < 1.0 if limit.aim == "survive" else end_at > 1.0
    return text + (" There the aim is missed." if missed else "")


def waterfall_heading(contents: Contents, name: str) -> str:
    """The heading over the waterfall, with the input that takes most."""
    subject = f"Where the margin of {limit_name(name)} goes"
    begin_at, end_at, steps = _steps(contents.results.limits[name])
    if not steps:
        return subject
    first, factor = steps[0]
    share = 100.0 * math.log(factor) / math.log(end_at / begin_at)
    return f"{subject}: {share:.0f} % to {the_input(first) if first else 'all others'}"


def waterfall_table(contents: Contents, name: str) -> Table | None:
    """Steps of the waterfall."""
    begin_at, _, steps = _steps(contents.results.limits[name])
    if not steps:
        return None
    here = begin_at
    rows = [("median case", "", f"{begin_at:.3g}")]
    for step, factor in steps:
        here *= factor
        label = input_name(step) if step else "all others"
        rows.append((label, number_text(f"{100.0 * (factor - 1.0):+.2g}") + " %", f"{here:.3g}"))
    return Table(
        caption=f"From the median margin of {limit_name(name)} to its worst twentieth, by importance factors",
        header=("step", "change", "margin after it"),
        rows=tuple(rows),
        note="No intervals: the way is shared out by the design point. Both ends have theirs in the table of limits.",
    )
