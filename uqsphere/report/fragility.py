"""The fragility chart: probability of fracture over the free number, on normal probability paper.

Names stand where a curve leaves the frame, plan and number to use under the axis, so that no text
crosses a curve and no legend is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from uqsphere.arrays import Array, Duo, special
from uqsphere.quantities import display_unit, format_probability, format_share, format_value
from uqsphere.results.types import Answer, CurvePoint, Decision, FreeNumber, Kind, Results

from .format import Estimated, label, plain_name, small, with_unit
from .pictures import (
    BLUE,
    BROWN,
    FAINT,
    GREEN,
    GREY,
    INDIGO,
    INK,
    LEADER,
    LETTER,
    PURPLE,
    RED,
    apart,
    plain_logarithms,
    write,
)
from .sentences import DecisionText, all_together, chart_title, joint_event

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: probabilities that the axis is marked at, and the ends of the axis
TICKS = (1e-4, 1e-3, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 0.999)
LOWEST, HIGHEST = 3e-5, 1.0 - 3e-5
#: height of a line of text [points], and curves that one chart has room for
LINE, MOST_CURVES = 14.0, 9
#: dashes and width of a line
Style = tuple[Any, float]
#: of limits, of assumed strengths, and of all failure modes together
LIMIT: Style = ("-", 2.2)
ASSUMED: Style = ((0, (5, 2)), 1.4)
JOINT: Style = ("-.", 2.0)


class Curve(NamedTuple):
    """Probability of exceedance over the free number, of a limit or of failure modes together.

    x : values of the free number (n,) [SI]; p : probabilities (n,)
    style : of its line
    at_plan : the probability at the planned value
    """

    name: str
    x: Array
    p: Array
    colour: str
    style: Style
    at_plan: Estimated


class _Label(NamedTuple):
    """A text beside the frame, at a place along its edge."""

    at: float
    text: str
    colour: str


def curves_of(results: Results, limit: str | None = None) -> list[Curve]:
    """The curves of a run, or of one limit: limits in hues of their own, assumed strengths in
    grey, one that governs in red.  Of too many, those that are exceeded most often.
    """
    at_plan = {
        subject: results.get(subject, Kind.EXCEEDANCE_PROBABILITY)
        for subject in results.entries
        if limit in (None, plain_name(subject)) and results.where(subject, Kind.CURVE)
    }
    kept = sorted(at_plan, key=lambda subject: -(at_plan[subject].value or 0.0))[:MOST_CURVES]
    governing = {decision.governing for decision in results.decisions if decision.use}
    hues = cycle((BLUE, GREEN, PURPLE, BROWN, INDIGO))
    curves = []
    for subject, estimate in at_plan.items():
        if subject in kept:
            look = RED if subject in governing else GREY, ASSUMED
            if subject.startswith("limits."):
                look = next(hues), LIMIT
            x, p, *_ = _ends(results.where(subject, Kind.CURVE))
            curves.append(Curve(label(subject), x, p, *look, estimate))
    for decision in results.decisions:
        if limit is None and decision.adds_up and decision.curve:
            x, p, *_ = _ends(decision.curve)
            curves.append(Curve(all_together(decision), x, p, INK, JOINT, joint_event(decision)))
    return curves


def _ends(points: Sequence[CurvePoint | Answer]) -> Array:
    """Places, values, lower and upper ends (4, n) of a curve; nan where there is none."""
    rows = [(point.at, point.value, point.low, point.high) for point in points]
    return np.array(rows, float).T


def planned_value(free: FreeNumber) -> float | None:
    """The planned value of the free number, where it lies in the range of its curve."""
    if free.planned is not None and free.low <= free.planned <= free.high:
        return free.planned
    return None


def draw_fragility(
    axes: Axes, results: Results, limit: str | None = None, *, brief: bool = False
) -> None:
    """Curves with their names, band and points of the tests, targets, plan and numbers to use.

    limit : only this one; brief : shorter texts, for a narrow chart
    """
    free = results.study.free
    curves = curves_of(results, limit)
    assert free
    planned = planned_value(free)
    used = [decision for decision in results.decisions if decision.use and limit is None]
    unit, factor = display_unit(free.quantity, planned or free.high)
    places = [decision.use.value for decision in used if decision.use]
    if planned is not None:
        places.append(planned)
    low, high = _ends_of_interest(free, curves, places)
    axes.set(xlim=(low * factor, high * factor), ylim=special.ndtri((LOWEST, HIGHEST)))
    if low > 0.0:
        axes.set_xscale("log")
        plain_logarithms(axes.xaxis, high / low)
    axes.set_yticks(special.ndtri(TICKS), list(map(format_probability, TICKS)))
    axes.grid(color=FAINT, linewidth=0.7)
    axes.set_axisbelow(True)
    above, right = _draw_curves(axes, curves, factor)
    _draw_tests(axes, results, curves, factor)
    targets = {}
    for name, entry in results.study.limits.items():
        if entry.has_target and limit in (None, name):
            sign = "≤" if entry.aim == "survive" else "≥"
            targets[entry.allowable] = f"target {sign} {format_share(entry.allowable)}"
    for p, text in targets.items():
        height = float(special.ndtri(p))
        axes.axhline(height, color=INK, linewidth=0.9, linestyle=(0, (1, 2)))
        right.append(_Label(height, text, INK))
    below = []
    if planned is not None:
        axes.axvline(planned * factor, color=INK, linewidth=1.2, zorder=1.5)
        word = "plan" if brief else "planned"
        text = f"{word} {format_value(planned, free.quantity, 3)}"
        below.append(_Label(planned * factor, text, INK))
    for decision in used:
        text = small(DecisionText(results, decision).use)
        if brief:
            text = text.partition(" (")[0]
            text = text.replace("use at most", "≤").replace("use at least", "≥")
        below.append(_Label(_draw_mark(axes, decision, factor), text, RED))
    _label_edge(axes, above, "above")
    rows = _label_edge(axes, below, "below")
    _label_right(axes, right)
    axes.set_xlabel(with_unit(free.meaning, unit), labelpad=6.0 + LINE * rows)
    axes.set_ylabel(small(chart_title(results)))


def _ends_of_interest(free: FreeNumber, curves: Sequence[Curve], places: Sequence[float]) -> Duo:
    """The part of the range in which a curve is inside the frame, with plan and numbers to use."""
    inside = [curve.x[(curve.p > LOWEST) & (curve.p < HIGHEST)] for curve in curves]
    shown = np.concatenate([places, *inside])
    shown = shown[(shown >= free.low) & (shown <= free.high)]
    low, high = free.low, free.high
    if len(set(shown)) > 1:
        low, high = shown.min(), shown.max()
        if free.low > 0.0:
            low, high = low / 1.15, high * 1.15
        else:
            room = 0.04 * (high - low)
            low, high = low - room, high + room
    return max(low, free.low), min(high, free.high)


def _draw_curves(
    axes: Axes, curves: Sequence[Curve], factor: float
) -> tuple[list[_Label], list[_Label]]:
    """Draw the curves, on normal scores by monotone cubics; names of those that leave the frame
    above, and of those at its right.
    """
    from scipy.interpolate import PchipInterpolator

    logarithmic = axes.get_xscale() == "log"
    spaced = np.geomspace if logarithmic else np.linspace
    x = spaced(*axes.get_xlim(), 400)
    bottom, top = axes.get_ylim()
    above, right = [], []
    for curve in curves:
        finite = np.isfinite(curve.p)
        if finite.sum() < 2:
            continue
        places = curve.x[finite]
        at = np.clip(x / factor, places[0], places[-1])
        if logarithmic:
            places, at = np.log(places), np.log(at)
        scores = special.ndtri(np.clip(curve.p[finite], 1e-15, 1.0 - 1e-15))
        y = PchipInterpolator(places, scores)(at)
        dashes, width = curve.style
        axes.plot(x, y, linestyle=dashes, lw=width, color=curve.colour, zorder=2 + width)
        outside = np.flatnonzero((y[:-1] < top) != (y[1:] < top))
        if bottom < y[-1] < top:
            right.append(_Label(y[-1], curve.name, curve.colour))
        elif outside.size:
            above.append(_Label(x[outside[0]], curve.name, curve.colour))
    return above, right


def _draw_tests(axes: Axes, results: Results, curves: Sequence[Curve], factor: float) -> None:
    """Band and points of the limit with tests that governs, else of the first one."""
    limits = results.study.limits
    colours = {curve.name: curve.colour for curve in curves}
    for decision in results.decisions:
        tested = [name for name in decision.limits if limits[name].tests]
        name = min(tested, key=lambda name: f"limits.{name}" != decision.governing, default="")
        if not decision.band or name not in colours:
            continue
        colour = colours[name]
        x, _, low, high = _ends(decision.band)
        if decision.aim == "break":
            low, high = 1.0 - high, 1.0 - low
        edges = special.ndtri(np.clip((low, high), 1e-9, 1.0 - 1e-9))
        axes.fill_between(x * factor, *edges, color=colour, alpha=0.16, lw=0, zorder=1)
        at, shares, stopped = np.array(limits[name].test_points or np.empty((3, 0)))
        y = special.ndtri(np.clip(shares, LOWEST, HIGHEST))
        for kind, marker, fill in ((0.0, "o", colour), (1.0, ">", "white")):
            chosen = stopped == kind
            axes.plot(at[chosen] * factor, y[chosen], marker, ms=5, mec=colour, mfc=fill, zorder=5)
        return


def _draw_mark(axes: Axes, decision: Decision, factor: float) -> float:
    """Draw a number to use, with the values that are allowed as a bar on the axis; its place."""
    use = decision.use
    assert use
    p = decision.target or 0.0
    height = special.ndtri(1.0 - p if decision.aim == "break" else p)
    at, bottom, (left, right) = use.value * factor, axes.get_ylim()[0], axes.get_xlim()
    allowed = (at, right) if use.safe_end == "smallest" else (left, at)
    axes.hlines(bottom, *allowed, color=RED, linewidth=6, clip_on=False)
    axes.vlines(at, bottom, height, color=RED, linewidth=1.4, zorder=5)
    axes.plot(at, height, "D", color=RED, ms=8, zorder=6)
    return at


def _label_edge(axes: Axes, labels: Sequence[_Label], edge: Literal["above", "below"]) -> int:
    """Write texts above or below the frame, in rows, so that no leader crosses one; returns the
    number of rows.
    """
    from matplotlib.transforms import ScaledTranslation

    frame, sign, shift = 1.0, 1.0, 0.0
    if edge == "below":  # the ticks have their numbers first
        frame, sign, shift = 0.0, -1.0, -19.0 / 72.0
    moved = ScaledTranslation(0.0, shift, axes.figure.dpi_scale_trans)
    coordinates = axes.get_xaxis_transform() + moved
    ends: list[float] = []
    for at, text, colour in sorted(labels):
        place = float(axes.transData.transform((at, 0.0))[0])
        width = LETTER * len(text) + 4.0
        # left of the leader; right of it where there is no room
        start, side, gap = place - width, "right", -3.0
        if start <= 0.0:
            start, side, gap = place, "left", 3.0
        row = next((k for k, end in enumerate(ends) if start > end + 6.0), len(ends))
        # a leader crosses the rows between its text and the frame
        ends[:row] = [max(end, place + 3.0) for end in ends[:row]]
        ends[row : row + 1] = [start + width]
        height = (9.0 + LINE * row) * sign
        write(axes, text, (at, frame), (gap, height), coordinates, color=colour, ha=side)
        leader = {**LEADER, "color": colour, "lw": 0.9}
        write(axes, "", (at, frame), (0.0, height + 5.0 * sign), coordinates, arrowprops=leader)
    return len(ends)


def _label_right(axes: Axes, labels: Sequence[_Label]) -> None:
    """Texts at the right edge, pushed apart so that none covers another."""
    bottom, top = axes.get_ylim()
    step = LINE * (top - bottom) / axes.get_window_extent().height
    labels = sorted(labels)
    heights = apart([label.at for label in labels], [step] * len(labels))
    for (_, text, colour), height in zip(labels, heights, strict=True):
        write(axes, text, (1.0, height), (5.0, 0.0), ("axes fraction", "data"), color=colour)
