"""The fragility chart: probability of fracture over the free number, on normal probability paper.

Names stand where a curve leaves the frame, plan and number to use under the axis, so that no text
crosses a curve and no legend is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from uqsphere.arrays import Array
from uqsphere.quantities import display_unit, format_probability
from uqsphere.report.format import with_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: colours that people with any colour vision tell apart (Okabe and Ito 2008), darkened to a
#: contrast of 4.5 on white
BLUE, GREEN, PURPLE, RED = "#0072b2", "#007a58", "#aa4499", "#b84a00"
BROWN, INDIGO = "#7a5500", "#4b5fc1"
GREY, INK, FAINT = "#656b75", "#1b1f24", "#e6e8eb"
#: probabilities that the axis is marked at, and the ends of the axis
TICKS: Final = (1e-4, 1e-3, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 0.999)
LOWEST, HIGHEST = 3e-5, 1.0 - 3e-5
#: height of a line of text, and width of a letter, at the font size of the chart [points]
LINE, LETTER = 14.0, 6.4


@dataclass(frozen=True, kw_only=True, eq=False)
class Curve:
    """Probability of exceedance over the free number, of a limit or of failure modes together.

    x : values of the free number (n,) [SI]; p : probabilities (n,)
    kind : `limit` of the study, `assumed` strength of the library, or `joint`
    governs : whether it sets the number to use
    """

    name: str
    x: Array
    p: Array
    kind: Literal["limit", "assumed", "joint"]
    governs: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Tests:
    """What tests say of one limit: the 95 % band of its curve, and the tests themselves.

    x, low, high : the band, (n,); places, shares : a point a test, (m,); stopped : right-censored
    """

    curve: str
    x: Array
    low: Array
    high: Array
    places: Array
    shares: Array
    stopped: Array


@dataclass(frozen=True, kw_only=True)
class Mark:
    """A number to use, at its target: `least` where larger values are safe."""

    value: float
    probability: float
    text: str
    least: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class Chart:
    """All that one fragility chart shows.

    free : path of the free number; meaning : what it is called; ends : its range [SI]
    planned : its planned value and how that is written; targets : probabilities with their text
    """

    free: str
    meaning: str
    ends: tuple[float, float]
    curves: Sequence[Curve]
    tests: Tests | None = None
    planned: tuple[float, str] | None = None
    marks: Sequence[Mark] = ()
    targets: Sequence[tuple[float, str]] = ()
    fracture: bool = True


@dataclass(frozen=True)
class _Label:
    """A text beside the frame, at a place along its edge."""

    at: float
    text: str
    colour: str


def draw_fragility(axes: Axes, chart: Chart) -> None:
    """Curves with their names, band and points of the tests, targets, plan and numbers to use."""
    from scipy.special import ndtri

    unit, factor = display_unit(chart.free, (chart.planned or (chart.ends[1],))[0])
    low, high = _ends_of_interest(chart)
    axes.set(xlim=(low * factor, high * factor), ylim=(ndtri(LOWEST), ndtri(HIGHEST)))
    if low > 0.0:
        axes.set_xscale("log")
        plain_logarithms(axes.xaxis, high / low)
    axes.set_yticks(ndtri(np.array(TICKS)), [format_probability(tick) for tick in TICKS])
    axes.grid(color=FAINT, linewidth=0.7)
    axes.set_axisbelow(True)
    colours = _colours(chart)
    above, right = _draw_curves(axes, chart, colours, factor)
    if chart.tests is not None:
        _draw_tests(axes, chart.tests, colours[chart.tests.curve], factor)
    for probability, text in chart.targets:
        height = float(ndtri(probability))
        axes.axhline(height, color=INK, linewidth=0.9, linestyle=(0, (1, 2)))
        right.append(_Label(height, text, INK))
    below = _draw_marks(axes, chart, factor)
    _label_edge(axes, above, "above")
    rows = _label_edge(axes, below, "below")
    _right(axes, right)
    axes.set_xlabel(with_unit(chart.meaning, unit), labelpad=6.0 + LINE * rows)


def plain_logarithms(axis: object, ratio: float) -> None:
    """Plain ticks of a logarithmic axis over a ratio: powers of ten, 2 and 5 times these where
    there is room.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

    locator: object = LogLocator(subs=(1.0, 2.0, 5.0))
    if ratio >= 2e3:
        locator = LogLocator()
    elif ratio < 5.0:
        locator = MaxNLocator(4)
    axis.set_major_locator(locator)  # type: ignore[attr-defined]
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))  # type: ignore[attr-defined]
    axis.set_minor_locator(NullLocator())  # type: ignore[attr-defined]


def _ends_of_interest(chart: Chart) -> tuple[float, float]:
    """The part of the range in which a curve is inside the frame, with plan and numbers to use."""
    places = [mark.value for mark in chart.marks]
    if chart.planned is not None:
        places.append(chart.planned[0])
    for curve in chart.curves:
        places += curve.x[(curve.p > LOWEST) & (curve.p < HIGHEST)].tolist()
    places = [place for place in places if chart.ends[0] <= place <= chart.ends[1]]
    if len(places) < 2 or max(places) <= min(places):
        return chart.ends
    low, high = min(places), max(places)
    if chart.ends[0] > 0.0:
        return max(low / 1.15, chart.ends[0]), min(high * 1.15, chart.ends[1])
    room = 0.04 * (high - low)
    return max(low - room, chart.ends[0]), min(high + room, chart.ends[1])


def _colours(chart: Chart) -> dict[str, str]:
    """A colour a curve: limits in hues of their own, assumed strengths in grey, what governs in
    red.
    """
    hues, colours = [BLUE, GREEN, PURPLE, BROWN, INDIGO], dict[str, str]()
    for curve in chart.curves:
        if curve.kind == "joint":
            colours[curve.name] = INK
        elif curve.kind == "limit":
            colours[curve.name] = hues[len(colours) % len(hues)]
        elif curve.governs:
            colours[curve.name] = RED
        else:
            colours[curve.name] = GREY
    return colours


STYLES: Final = {"limit": ("-", 2.2), "assumed": ((0, (5, 2)), 1.4), "joint": ("-.", 2.0)}


def _draw_curves(
    axes: Axes, chart: Chart, colours: dict[str, str], factor: float
) -> tuple[list[_Label], list[_Label]]:
    """Draw the curves; names of those that leave the frame above, and of those at its right."""
    x = np.linspace(*axes.get_xlim(), 400)
    if axes.get_xscale() == "log":
        x = np.geomspace(*axes.get_xlim(), 400)
    bottom, top = axes.get_ylim()
    names: dict[str, str] = {}
    heights: dict[str, Array] = {}
    for curve in chart.curves:
        y = _scores(curve, x / factor, logarithmic=axes.get_xscale() == "log")
        style, width = STYLES[curve.kind]
        axes.plot(
            x, y, linestyle=style, linewidth=width, color=colours[curve.name], zorder=2 + width
        )
        same = [name for name in names if np.allclose(heights[name], y, atol=1e-6)]
        if same:
            names[same[0]] += f" = {curve.name}"
        else:
            names[curve.name], heights[curve.name] = curve.name, y
    above, right = [], []
    for name, text in names.items():
        y = heights[name]
        outside = np.flatnonzero((y[:-1] < top) != (y[1:] < top))
        if bottom < y[-1] < top:
            right.append(_Label(float(y[-1]), text, colours[name]))
        elif outside.size:
            above.append(_Label(float(x[outside[0]]), text, colours[name]))
    return above, right


def _scores(curve: Curve, x: Array, *, logarithmic: bool) -> Array:
    """Normal scores of a curve at places x, by the monotone cubic through its points."""
    from scipy.interpolate import PchipInterpolator
    from scipy.special import ndtri

    finite = np.isfinite(curve.p)
    places, y = curve.x[finite], ndtri(np.clip(curve.p[finite], 1e-15, 1.0 - 1e-15))
    if logarithmic:
        places, x = np.log(places), np.log(x)
    if len(places) < 2:
        return np.full(len(x), np.nan)
    inside = np.clip(x, places[0], places[-1])
    return np.asarray(PchipInterpolator(places, y)(inside))


def _draw_tests(axes: Axes, tests: Tests, colour: str, factor: float) -> None:
    from scipy.special import ndtri

    low, high = ndtri(np.clip((tests.low, tests.high), 1e-9, 1.0 - 1e-9))
    axes.fill_between(tests.x * factor, low, high, color=colour, alpha=0.16, linewidth=0, zorder=1)
    shares = ndtri(np.clip(tests.shares, LOWEST, HIGHEST))
    for stopped, marker, fill in ((False, "o", colour), (True, ">", "white")):
        chosen = tests.stopped == stopped
        places = tests.places[chosen] * factor, shares[chosen]
        axes.plot(*places, marker, ms=5, mec=colour, mfc=fill, zorder=5, linestyle="none")


def _draw_marks(axes: Axes, chart: Chart, factor: float) -> list[_Label]:
    """Draw plan and numbers to use, with the values that are allowed as a bar on the axis."""
    from scipy.special import ndtri

    labels = []
    if chart.planned is not None:
        value, text = chart.planned
        axes.axvline(value * factor, color=INK, linewidth=1.2, zorder=1.5)
        labels.append(_Label(value * factor, text, INK))
    bottom, ends = axes.get_ylim()[0], axes.get_xlim()
    for mark in chart.marks:
        at, height = mark.value * factor, float(ndtri(mark.probability))
        allowed = (ends[0], at)
        if mark.least:
            allowed = (at, ends[1])
        axes.hlines(bottom, *allowed, color=RED, linewidth=6, clip_on=False)
        axes.vlines(at, bottom, height, color=RED, linewidth=1.4, zorder=5)
        axes.plot(at, height, "D", mfc=RED, mec=RED, ms=8, zorder=6)
        labels.append(_Label(at, mark.text, RED))
    return labels


def _label_edge(axes: Axes, labels: Sequence[_Label], edge: Literal["above", "below"]) -> int:
    """Write texts above or below the frame, in rows, so that no leader crosses one; returns the
    number of rows.
    """
    from matplotlib.transforms import ScaledTranslation

    frame, ticks, sign = 1.0, 0.0, 1.0
    if edge == "below":  # the ticks have their numbers first
        frame, ticks, sign = 0.0, -19.0 / 72.0, -1.0
    down = ScaledTranslation(0.0, ticks, axes.figure.dpi_scale_trans)
    edge_transform = axes.get_xaxis_transform() + down
    ends: list[float] = []
    for label in sorted(labels, key=lambda label: label.at):
        place = float(axes.transData.transform((label.at, 0.0))[0])
        width = LETTER * len(label.text)
        # left of the leader; right of it where there is no room
        start, stop, side, gap = place - width - 4.0, place, "right", -3.0
        if start <= 0.0:
            start, stop, side, gap = place, place + width + 4.0, "left", 3.0
        row = next((k for k, reached in enumerate(ends) if start > reached + 6.0), len(ends))
        if row == len(ends):
            ends.append(stop)
        # a leader crosses the rows between its text and the frame
        for k in range(row):
            ends[k] = max(ends[k], place + 3.0)
        ends[row] = max(ends[row], stop)
        height = (9.0 + LINE * row) * sign
        edge_place = (label.at, frame)
        axes.annotate(
            label.text,
            edge_place,
            (gap, height),
            edge_transform,
            "offset points",
            color=label.colour,
            ha=side,
            va="center",
            annotation_clip=False,
        )
        leader = {"arrowstyle": "-", "color": label.colour, "linewidth": 0.9, "shrinkB": 0}
        axes.annotate(
            "",
            edge_place,
            (0.0, height + 5.0 * sign),
            edge_transform,
            "offset points",
            annotation_clip=False,
            arrowprops={**leader, "shrinkA": 0},
        )
    return len(ends)


def _right(axes: Axes, labels: Sequence[_Label]) -> None:
    """Texts at the right edge, pushed apart so that none covers another."""
    extent = axes.get_window_extent()
    bottom, top = axes.get_ylim()
    step = LINE * (top - bottom) / extent.height
    least = -np.inf
    for label in sorted(labels, key=lambda label: label.at):
        least = max(label.at, least + step)
        axes.annotate(
            label.text,
            (1.0, least),
            (5.0, 0.0),
            ("axes fraction", "data"),
            "offset points",
            color=label.colour,
            va="center",
            annotation_clip=False,
        )
