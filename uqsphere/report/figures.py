"""Figures of a run, by matplotlib: as SVG with a text of what each shows, and on axes."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from uqsphere.errors import UsageError
from uqsphere.quantities import display_unit
from uqsphere.results.types import QuantityEntry, Results
from uqsphere.uq import LEVEL_TEXT

from .format import probability, small, title_of, unexplained, with_unit
from .fragility import curves_of, draw_fragility, planned_value
from .pictures import (
    INK,
    LETTER,
    Indices,
    convergence_of,
    draw_convergence,
    draw_density,
    draw_expansion,
    draw_indices,
    indices_of,
    quantile_texts,
    varies,
)
from .sentences import chart_title, decision_texts

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: quantities on the first screen, and those with pictures
FIRST, MOST_PICTURES = 2, 6
#: settings of matplotlib beside its own defaults: a matplotlibrc of a user may ask for TeX
STYLE = Path(__file__).with_name("page.mplstyle")


class Picture(NamedTuple):
    """A figure of the page: its title, what it shows in words, its SVG text, and a note."""

    title: str
    text: str
    svg: str
    note: str = ""


# --- SVG ------------------------------------------------------------------------------------------


def picture_svg(draw: Callable[[Figure], None], width: float, height: float) -> str:
    """The SVG of what `draw` puts on a figure of `width` by `height` pixels; text stays text."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context({"text.color": INK}, STYLE):
        figure = Figure(figsize=(width / 72.0, height / 72.0), dpi=72)
        text = io.StringIO()
        draw(figure)
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    body = re.sub(r"^.*?(?=<svg)", "", text.getvalue(), flags=re.S)
    # a curve outside the frame leaves a path without places
    body = re.sub(r"<metadata>.*?</metadata>|<path (?![^>]*\bd=)[^>]*/>", "", body, flags=re.S)
    # coordinates to a tenth of a point: a third of the bytes
    return re.sub(r'\bd="[^"]*"', lambda path: re.sub(r"(\d+\.\d)\d+", r"\1", path[0]), body)


def svg(
    draw: Callable[..., None],
    *shown: Any,
    size: tuple[float, float] = (620.0, 310.0),
    edges: tuple[float, float, float, float] | None = None,
) -> str:
    """The SVG of what `draw` puts on axes, given what is `shown`: in a figure of a size, with room
    at its left, right, top and bottom [px], or as much as the texts need.
    """

    def on_figure(figure: Figure) -> None:
        if not edges:
            figure.set_layout_engine("constrained")
            draw(figure.add_subplot(), *shown)
        else:
            (width, height), (left, right, top, bottom) = size, edges
            inner = (1.0 - (left + right) / width, 1.0 - (top + bottom) / height)
            draw(figure.add_axes((left / width, bottom / height, *inner)), *shown)

    return picture_svg(on_figure, *size)


# --- pictures of the page -------------------------------------------------------------------------


def pictures_of(results: Results) -> dict[str, Picture]:
    """The figures of a run by name."""
    quantities = list(results.study.quantities.items())[:MOST_PICTURES]
    drawn = _fragility(results)
    for number, (name, entry) in enumerate(quantities, 1):
        if varies(entry):
            low, middle, high = quantile_texts(entry, name)
            text = f"Density: 5 % at {low}; 50 % at {middle}; 95 % at {high}"
            title = with_unit(title_of(name), display_unit(name, entry.range[1] or 1.0)[0])
            figure = svg(
                draw_density, results, name, size=(370.0, 190.0), edges=(7.0, 7.0, 4.0, 36.0)
            )
            drawn[f"density-{number}"] = Picture(title, text, figure, "probability density")
    columns = indices_of(results, [name for name, _ in quantities[:FIRST]])
    if columns:
        drawn["sobol"] = _sobol(columns)
    sizes = convergence_of(results)
    if sizes.shape[1] > 1:
        runs, error = sizes[:, -1]
        text = f"Largest error over tolerance, {error:.2g} at {runs:,.0f} model runs"
        figure = svg(draw_convergence, sizes, size=(420.0, 210.0), edges=(63.0, 80.0, 8.0, 46.0))
        drawn["convergence"] = Picture("Convergence", text, figure)
    for number, (name, entry) in enumerate(quantities[:FIRST], 1):
        if entry.held_out:
            title = title_of(name)
            text = (
                f"{title} as predicted by polynomial chaos against model runs that it was not "
                f"fitted to; {unexplained(entry)} of the variance is not explained"
            )
            figure = svg(
                draw_expansion, results, name, size=(260.0, 210.0), edges=(56.0, 12.0, 8.0, 46.0)
            )
            drawn[f"expansion-{number}"] = Picture(f"{title}: polynomial chaos", text, figure)
    return drawn


def _fragility(results: Results) -> dict[str, Picture]:
    """The fragility chart, for a wide screen and for a narrow one; empty for a run without it."""
    free = results.study.free
    curves = curves_of(results)
    if not free or not curves:
        return {}
    title = chart_title(results)
    texts = [f"{title} over the {free.meaning}"]
    if planned_value(free) is not None:
        texts += [
            f"{curve.name} at the planned value: {probability(curve.at_plan)}" for curve in curves
        ]
    texts += [small(decision.use) for decision in decision_texts(results)]
    text = "; ".join(texts)
    letters = max(len(curve.name) for curve in curves)
    edges = (78.0, min(max(LETTER * letters, 90.0), 190.0) + 12.0, 58.0, 74.0)
    wide = svg(draw_fragility, results, size=(822.0, 430.0), edges=edges)
    brief = partial(draw_fragility, brief=True)
    narrow = svg(brief, results, size=(370.0, 430.0), edges=(74.0, 92.0, 84.0, 84.0))
    return {
        "fragility": Picture(title, text, wide),
        "fragility-narrow": Picture(title, text, narrow),
    }


def _sobol(columns: Sequence[Indices]) -> Picture:
    """Sobol' indices of some quantities in one chart, a row an input."""
    inputs = columns[0].inputs
    height = max(190.0, 50.0 + 26.0 * len(inputs))
    names = LETTER * max(map(len, inputs)) + 12.0
    each = (480.0 - names) / len(columns)

    def draw(figure: Figure) -> None:
        for k, column in enumerate(columns):
            left = (names + each * k) / 480.0
            width = (each - 50.0) / 480.0
            place = (left, 26.0 / height, width, 1.0 - 52.0 / height)
            draw_indices(figure.add_axes(place), column, names=k == 0)

    texts = []
    for column in columns:
        totals = zip(inputs, column.total[0], strict=True)
        texts.append(f"{column.name}: " + ", ".join(f"{name} {t:.2f}" for name, t in totals))
    text = f"Total Sobol’ indices; {'; '.join(texts)}"
    note = f"○ first order, ● total; {LEVEL_TEXT} intervals"
    return Picture("Sobol’ indices", text, picture_svg(draw, 480.0, height), note)


# --- plots on axes --------------------------------------------------------------------------------


class Plots:
    """Plots of a run on matplotlib axes: those given as `ax`, or new ones, which are returned."""

    def __init__(self, results: Results) -> None:
        self._results = results

    def fragility(self, limit: str | None = None, ax: Axes | None = None) -> Axes:
        """Probability of fracture over the free number, of one limit or of all.

        Raises UsageError for a run without [margins].
        """
        if not curves_of(self._results, limit):
            raise UsageError("the run has no curve: add [margins] to the study")
        return self._on(ax, draw_fragility, self._results, limit)

    def density(self, quantity: str, ax: Axes | None = None) -> Axes:
        """Density of a quantity with the strengths that it is compared with.

        Raises UsageError for a quantity that the run does not contain, or that does not vary.
        """
        if not varies(self._entry(quantity)):
            raise UsageError(f"{quantity!r} does not vary: it has no density")
        return self._on(ax, draw_density, self._results, quantity)

    def sobol(self, quantity: str, ax: Axes | None = None) -> Axes:
        """Sobol' indices of a quantity.

        Raises UsageError for a quantity that the run does not contain, or without indices.
        """
        self._entry(quantity)
        columns = indices_of(self._results, [quantity])
        if not columns:
            raise UsageError(f"the run has no Sobol' indices of {quantity!r}")
        return self._on(ax, draw_indices, columns[0])

    def _entry(self, quantity: str) -> QuantityEntry:
        quantities = self._results.study.quantities
        if quantity not in quantities:
            raise UsageError(
                f"the run does not contain the quantity {quantity!r} "
                f"(known: {', '.join(quantities)})"
            )
        return quantities[quantity]

    @staticmethod
    def _on(ax: Axes | None, draw: Callable[..., None], *shown: Any) -> Axes:
        if ax is None:
            import matplotlib.pyplot as plt

            ax = plt.subplots(layout="constrained")[1]
        draw(ax, *shown)
        return ax
