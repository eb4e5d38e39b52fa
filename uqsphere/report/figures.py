"""Figures of a run, by matplotlib: what each shows is read from the results, with its text."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.errors import UsageError
from uqsphere.quantities import display_unit, format_probability, format_value
from uqsphere.report.format import capital, label, meaning, short, table_of, value, with_unit
from uqsphere.report.fragility import (
    BLUE,
    GREEN,
    HIGHEST,
    INK,
    PURPLE,
    RED,
    Chart,
    Curve,
    Mark,
    Tests,
)
from uqsphere.report.fragility import draw_fragility as draw_chart
from uqsphere.report.pictures import Density, Indices, draw_convergence, draw_density, draw_indices
from uqsphere.report.sentences import chart_title, decision_text
from uqsphere.results.types import Answer, Decision, Kind, QuantityEntry, Results

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: colours of lines that share a figure
COLOURS: Final = (BLUE, RED, GREEN, PURPLE, INK)
#: curves that one chart has room for, rows of Sobol' indices, and letters of a name beside a row
MOST_CURVES, MOST_INPUTS, MOST_LETTERS = 9, 8, 30
STYLE: Final[dict[str, Any]] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "uqsphere",
    "font.size": 12.0,
    "font.family": "sans-serif",
    "text.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#9aa0a8",
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "path.simplify": True,
    "path.simplify_threshold": 0.3,
}


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A figure of the page: its title, what it shows in words, and its SVG text."""

    title: str
    text: str
    svg: str


# --- SVG ------------------------------------------------------------------------------------------


def picture_svg(draw: Callable[[Figure], None], width: float, height: float) -> str:
    """The SVG of what `draw` puts on a figure of `width` by `height` pixels; text stays text."""
    import matplotlib
    from matplotlib.figure import Figure

    matplotlib.use("Agg")
    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # a user's matplotlibrc may ask for TeX
        matplotlib.rcParams.update(STYLE)  # type: ignore[arg-type]
        figure, text = Figure(figsize=(width / 72.0, height / 72.0), dpi=72), io.StringIO()
        draw(figure)
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    body = re.sub(r"^.*?(?=<svg)", "", text.getvalue(), flags=re.S)
    # a curve outside the frame leaves a path without places
    body = re.sub(r"<metadata>.*?</metadata>|<path (?![^>]*\bd=)[^>]*/>", "", body, flags=re.S)
    # coordinates to a tenth of a point: a third of the bytes
    return re.sub(r'\bd="[^"]*"', lambda path: re.sub(r"(\d+\.\d)\d+", r"\1", path[0]), body)


def svg(draw: Callable[[Axes], None], width: float = 620.0, height: float = 310.0) -> str:
    """The SVG of what `draw` puts on axes that fill the figure."""

    def on_figure(figure: Figure) -> None:
        figure.set_layout_engine("constrained")
        draw(figure.add_subplot())

    return picture_svg(on_figure, width, height)


# --- what a run's figures show --------------------------------------------------------------------


def chart_of(results: Results, limit: str | None = None) -> Chart | None:
    """The fragility chart of a run, or of one limit; None for a run without curves."""
    free, answers = results.study.free, table_of(results)
    subjects = [row.subject for row in answers if row.answer == Kind.CURVE]
    if limit is not None:
        subjects = [name for name in subjects if name in (f"limits.{limit}", f"modes.{limit}")]
    if free is None or not subjects:
        return None
    governing = {decision.governing for decision in results.decisions if decision.use is not None}
    curves = []
    for subject in _most_exceeded(results, dict.fromkeys(subjects)):
        points = [(row.at, row.value) for row in answers.where(subject, Kind.CURVE)]
        x, p = np.array(points, dtype=float).T
        kind: Any = "limit" if subject.startswith("limits.") else "assumed"
        curves.append(Curve(name=label(subject), x=x, p=p, kind=kind, governs=subject in governing))
    joint, marks = _joint_curve(results), list[Mark]()
    if limit is None:
        marks = [_mark(results, entry) for entry in results.decisions if entry.use is not None]
        if joint is not None:
            curves.append(joint)
    planned = None
    if free.planned is not None and free.low <= free.planned <= free.high:
        planned = (free.planned, f"planned {format_value(free.planned, free.path, 3)}")
    return Chart(
        free=free.path,
        meaning=free.meaning,
        ends=(free.low, free.high),
        curves=curves,
        tests=_tests(results, {curve.name for curve in curves}),
        planned=planned,
        marks=marks,
        targets=_targets(results, limit),
        fracture=any(entry.fracture for entry in results.study.limits.values()),
    )


def _most_exceeded(results: Results, subjects: Sequence[str] | dict[str, None]) -> list[str]:
    """Of too many curves for a chart those that are exceeded most often, in their order."""
    answers, often = table_of(results), dict.fromkeys(subjects, 0.0)
    for subject in often:
        row = answers.get(subject, Kind.EXCEEDANCE_PROBABILITY)
        if row is not None:
            often[subject] = row.value or 0.0
    kept = sorted(often, key=lambda subject: -often[subject])[:MOST_CURVES]
    return [subject for subject in often if subject in kept]


def _joint_curve(results: Results) -> Curve | None:
    for decision in results.decisions:
        if decision.aim == "survive" and decision.curve:
            points = [(point.at, point.value) for point in decision.curve]
            x, p = np.array(points, dtype=float).T
            return Curve(name="all failure modes", x=x, p=p, kind="joint")
    return None


def _allowable(decision: Decision) -> float:
    """Probability of exceedance at the target of a decision."""
    target = decision.target or 0.0
    return target if decision.aim == "survive" else 1.0 - target


def _mark(results: Results, decision: Decision) -> Mark:
    assert decision.use is not None
    return Mark(
        value=decision.use.value,
        probability=_allowable(decision),
        text=decision_text(results, decision).use.lower(),
        least=decision.use.safe_end == "smallest",
    )


def _targets(results: Results, limit: str | None) -> list[tuple[float, str]]:
    targets: dict[float, str] = {}
    for name, entry in results.study.limits.items():
        if entry.has_target and limit in (None, name):
            sign = "≤" if entry.aim == "survive" else "≥"
            targets[entry.allowable] = f"target {sign} {format_probability(entry.allowable)}"
    return sorted(targets.items())


def _tests(results: Results, shown: set[str]) -> Tests | None:
    """Band and points of the limit with tests that governs, else of the first one."""
    for decision in results.decisions:
        names = [name for name in decision.limits if name in results.study.limits]
        tested = [name for name in names if results.study.limits[name].tests]
        governing = decision.governing.removeprefix("limits.")
        tested.sort(key=lambda name: name != governing)
        if not decision.band or not tested or tested[0] not in shown:
            continue
        ends = np.array([(point.at, point.low, point.high) for point in decision.band], dtype=float)
        x, low, high = ends.T
        if decision.aim == "break":
            low, high = 1.0 - high, 1.0 - low
        points = np.array(results.study.limits[tested[0]].test_points or np.empty((2, 0)))
        places, shares = points[:2]
        stopped = np.zeros(len(places), dtype=bool)
        if len(points) > 2:
            stopped = points[2] > 0.0
        drawn = np.isfinite(low) & np.isfinite(high) & _inside(low, high)
        return Tests(
            curve=tested[0],
            x=x[drawn],
            low=low[drawn],
            high=high[drawn],
            places=places,
            shares=shares,
            stopped=stopped,
        )
    return None


def _inside(low: Array, high: Array) -> Flags:
    """Where a band is to be drawn: no point whose ends fall back, and behind the upper edge of the
    frame only as long as the lower end rises.
    """
    if high[-1] < high[0]:
        return _inside(low[::-1], high[::-1])[::-1]
    before = np.concatenate([[0.0], np.maximum.accumulate(low)[:-1]])
    rises = high >= np.maximum.accumulate(high)
    return rises & ((high < HIGHEST) | ((low > before) & (low < HIGHEST)))


def density_of(results: Results, quantity: str) -> Density | None:
    """The density of a quantity, with the strengths that it is compared with; None without one."""
    entry = results.study.quantities.get(quantity)
    if entry is None:
        names = ", ".join(results.study.quantities)
        raise UsageError(f"the run does not contain the quantity {quantity!r} (known: {names})")
    if not entry.density or None in entry.range:
        return None
    middle = entry.range[1] or 1.0
    unit, factor = display_unit(quantity, middle)
    x, y = np.array(entry.density, dtype=float)
    quantiles = [
        (end * factor, value(end, quantity).removesuffix(f" {unit}"))
        for end in entry.range
        if end is not None
    ]
    strengths = []
    for name, limit in results.study.limits.items():
        if limit.quantity == quantity and limit.strength.density:
            places, heights = np.array(limit.strength.density, dtype=float)
            strengths.append((name, np.array([places * factor, heights / factor])))
    return Density(
        x=x * factor,
        y=y / factor,
        quantiles=quantiles,
        strengths=strengths[:3],
        onset=_onset(results, quantity, unit, factor),
    )


def _onset(results: Results, quantity: str, unit: str, factor: float) -> tuple[float, str] | None:
    """Where a contact starts to yield on the axis of the peak pressure, and how many do."""
    entry = results.study.quantities[quantity]
    if entry.onset is None or not entry.density:
        return None
    places, heights = np.array(entry.density, dtype=float)
    above = places >= entry.onset
    share = float(np.trapezoid(heights[above], places[above]))
    for check in results.checks:
        if check.name == "dented":
            share = check.share
    who = f"in {format_probability(share)} of impacts"
    if share > 0.999:
        who = "in all impacts"
    elif share < 0.001:
        who = "in no impact"
    return entry.onset * factor, f"yield from {entry.onset * factor:.3g} {unit}: {who}"


def indices_of(results: Results, quantities: Sequence[str]) -> list[Indices]:
    """Sobol' indices of some quantities, the inputs in one order: the largest total first."""
    answers, largest = table_of(results), dict[str, float]()
    for quantity in quantities:
        for row in answers.where(quantity, Kind.SOBOL_TOTAL):
            if row.value is not None:
                largest[str(row.at)] = max(largest.get(str(row.at), 0.0), row.value)
    inputs = sorted(largest, key=lambda name: -largest[name])[:MOST_INPUTS]
    names = [_brief(meaning(name, results.inputs)) for name in inputs]
    columns = []
    for quantity in quantities:
        orders = []
        for kind in (Kind.SOBOL_FIRST, Kind.SOBOL_TOTAL):
            ends = [_interval(answers.get(quantity, kind, name)) for name in inputs]
            orders.append(np.array(ends, dtype=float).reshape(-1, 3).T)
        if inputs and np.isfinite(orders[1][0]).any():
            name = short(results.study.quantities[quantity].meaning).removeprefix("equivalent ")
            columns.append(Indices(name=name, inputs=names, first=orders[0], total=orders[1]))
    return columns


def _interval(row: Answer | None) -> Sequence[float | None]:
    """Value and ends of an index; None where there is no number."""
    if row is None:
        return (None,) * 3
    return row.value, row.low, row.high


def _brief(text: str) -> str:
    if len(text) <= MOST_LETTERS:
        return text
    return f"{text[: MOST_LETTERS - 1].rstrip()}…"


def convergence_of(results: Results) -> tuple[Array, Array] | None:
    """Model runs and largest error / tolerance at each size; None for a run of one size."""
    rows = [(row.runs, row.error) for row in results.accuracy.reached if row.error]
    if len(rows) < 2:
        return None
    runs, error = np.array(rows, dtype=float).T
    return runs, error


# --- pictures of the page -------------------------------------------------------------------------


def fragility_pictures(results: Results) -> list[Picture]:
    """The fragility chart, for a wide screen and for a narrow one; empty for a run without it."""
    chart = chart_of(results)
    if chart is None:
        return []
    right = max([6.4 * len(curve.name) for curve in chart.curves] + [90.0])

    def draw(figure: Figure, chart: Chart, edges: tuple[float, float, float, float]) -> None:
        width, height = figure.get_size_inches() * 72.0
        left, right, above, below = edges
        room = (left / width, below / height)
        size = (1.0 - (left + right) / width, 1.0 - (above + below) / height)
        draw_chart(figure.add_axes((*room, *size)), chart)

    title, text = chart_title(results), _chart_text(results, chart)
    wide = partial(draw, chart=chart, edges=(62.0, min(right, 190.0) + 12.0, 58.0, 74.0))
    narrow = partial(draw, chart=_brief_chart(chart), edges=(58.0, 92.0, 84.0, 84.0))
    return [
        Picture(title=title, text=text, svg=picture_svg(wide, 822.0, 430.0)),
        Picture(title=title, text=text, svg=picture_svg(narrow, 370.0, 430.0)),
    ]


def _brief_chart(chart: Chart) -> Chart:
    """A chart with shorter texts under its axis."""
    marks = []
    for mark in chart.marks:
        sign = "≥" if mark.least else "≤"
        number = mark.text.partition("most ")[2] or mark.text.partition("least ")[2]
        marks.append(replace(mark, text=f"{sign} {number}"))
    planned = chart.planned
    if planned is not None:
        planned = (planned[0], planned[1].replace("planned", "plan"))
    return replace(chart, marks=marks, planned=planned)


def _chart_text(results: Results, chart: Chart) -> str:
    """What the fragility chart shows, for a reader who cannot see it."""
    texts = [f"{chart_title(results)} over the {chart.meaning}"]
    if chart.planned is not None:
        place, _ = chart.planned
        for curve in chart.curves:
            p = float(np.interp(place, curve.x, curve.p))
            texts.append(f"{curve.name} at the planned value: {format_probability(p)}")
    texts += [mark.text for mark in chart.marks]
    return "; ".join(texts)


def density_picture(results: Results, quantity: str) -> Picture | None:
    """The small picture of a distribution; None for a quantity that does not vary."""
    density = density_of(results, quantity)
    if density is None:
        return None

    def draw(figure: Figure) -> None:
        draw_density(figure.add_axes((0.02, 0.19, 0.96, 0.79)), density)

    entry = results.study.quantities[quantity]
    unit = display_unit(quantity, entry.range[1] or 1.0)[0]
    shares = zip(("5 %", "50 %", "95 %"), entry.range, strict=True)
    ends = "; ".join(f"{share} at {value(end, quantity)}" for share, end in shares)
    title = with_unit(title_of(quantity, entry), unit)
    return Picture(title=title, text=f"Density: {ends}", svg=picture_svg(draw, 370.0, 190.0))


def title_of(name: str, entry: QuantityEntry) -> str:
    """A quantity as a heading: a name of the user's stays as it is."""
    text = short(entry.meaning)
    if text == name:
        return text
    return capital(text)


def sobol_picture(results: Results, quantities: Sequence[str]) -> Picture | None:
    """Sobol' indices of up to three quantities in one chart, a row an input; None without any."""
    columns = indices_of(results, quantities)
    if not columns:
        return None
    rows = len(columns[0].inputs)
    height = max(190.0, 50.0 + 26.0 * rows)

    def draw(figure: Figure) -> None:
        names = 6.2 * max(len(name) for name in columns[0].inputs) + 14.0
        each = (480.0 - names) / len(columns)
        for k, column in enumerate(columns):
            left, width = names + each * k, each - 50.0
            place = (left / 480.0, 26.0 / height, width / 480.0, 1.0 - 52.0 / height)
            draw_indices(figure.add_axes(place), column, names=k == 0)

    texts = []
    for column in columns:
        totals = zip(column.inputs, column.total[0], strict=True)
        listed = ", ".join(f"{name} {total:.2f}" for name, total in totals)
        texts.append(f"{column.name}: {listed}")
    text = f"Total Sobol’ indices; {'; '.join(texts)}"
    return Picture(title="Sobol’ indices", text=text, svg=picture_svg(draw, 480.0, height))


def convergence_picture(results: Results) -> Picture | None:
    """The largest error against model runs; None for a run of one size."""
    points = convergence_of(results)
    if points is None:
        return None

    def draw(figure: Figure) -> None:
        draw_convergence(figure.add_axes((0.15, 0.22, 0.66, 0.74)), *points)

    last = points[1][-1]
    text = f"Largest error over tolerance, {last:.2g} at {points[0][-1]:,.0f} model runs"
    return Picture(title="Convergence", text=text, svg=picture_svg(draw, 420.0, 210.0))


# --- plots on axes --------------------------------------------------------------------------------


class Plots:
    """Plots of a run on matplotlib axes: those given as `ax`, or new ones, which are returned."""

    def __init__(self, results: Results) -> None:
        self._results = results

    def fragility(self, limit: str | None = None, ax: Axes | None = None) -> Axes:
        """Probability of fracture over the free number, of one limit or of all.

        Raises UsageError for a run without [margins].
        """
        chart = chart_of(self._results, limit)
        if chart is None:
            raise UsageError("the run has no curve: add [margins] to the study")
        return self._on(ax, partial(draw_chart, chart=chart))

    def density(self, quantity: str, ax: Axes | None = None) -> Axes:
        """Density of a quantity with the strengths that it is compared with.

        Raises UsageError for a quantity that the run does not contain, or that does not vary.
        """
        density = density_of(self._results, quantity)
        if density is None:
            raise UsageError(f"{quantity!r} does not vary: it has no density")
        return self._on(ax, partial(draw_density, density=density))

    def sobol(self, quantity: str, ax: Axes | None = None) -> Axes:
        """Sobol' indices of a quantity.

        Raises UsageError for a quantity without indices.
        """
        columns = indices_of(self._results, [quantity])
        if not columns:
            raise UsageError(f"the run has no Sobol' indices of {quantity!r}")
        return self._on(ax, partial(draw_indices, indices=columns[0]))

    def convergence(self, ax: Axes | None = None) -> Axes:
        """The largest error over its tolerance, against model runs.

        Raises UsageError for a run of one size.
        """
        points = convergence_of(self._results)
        if points is None:
            raise UsageError("the run has one size of the sample: there is no convergence to plot")
        return self._on(ax, lambda axes: draw_convergence(axes, *points))

    @staticmethod
    def _on(ax: Axes | None, draw: Callable[[Axes], None]) -> Axes:
        if ax is None:
            import matplotlib.pyplot as plt

            ax = plt.subplots(layout="constrained")[1]
        draw(ax)
        return ax
