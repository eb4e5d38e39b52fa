"""Figures of a finished run for notebooks and papers: axes of matplotlib in and out, nothing shown or saved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from uqsphere.errors import UsageError
from uqsphere.quantities import display_unit

if TYPE_CHECKING:
    from collections.abc import Iterable

    from matplotlib.axes import Axes

    from uqsphere.runner.finished import Run

#: bars of a histogram
_BINS = 60


@dataclass(frozen=True, kw_only=True)
class Plots:
    """What can be drawn of a run.  Every figure takes the axes that it is drawn into, or makes some, and returns them.

    Raises UsageError for a name that the run does not have.
    """

    run: Run

    def fragility(self, limit: str | None = None, ax: Axes | None = None) -> Axes:
        """Probability that a limit is exceeded over the free scalar, with its band, and the values solved for."""
        margins = self.run.results.margins
        name = _chosen(limit, margins, "limit with margins")
        entry, axes = margins[name], _axes(ax)
        quantity = entry.solve
        unit, factor = display_unit(quantity)
        curve = np.array([[p.value, p.probability, p.low, p.high] for p in entry.curve])
        (line,) = axes.plot(factor * curve[:, 0], curve[:, 1], label=name)
        axes.fill_between(factor * curve[:, 0], curve[:, 2], curve[:, 3], color=line.get_color(), alpha=0.25)
        solved = [(factor * e.value, float(p)) for p, e in entry.values.items() if e.value is not None]
        if solved:
            axes.plot(*zip(*solved, strict=True), "o", color=line.get_color())
        if curve[0, 0] > 0.0:
            axes.set_xscale("log")
        axes.set(xlabel=f"{quantity} [{unit}]", ylabel=f"probability of exceeding {name}", ylim=(0.0, 1.0))
        return axes

    def indices(self, quantity: str | None = None, ax: Axes | None = None) -> Axes:
        """Shares of the variance of a quantity: total indices, Shapley effects where inputs depend on each other."""
        found = self.run.results.sensitivity
        name = _chosen(quantity, found, "quantity with indices")
        entry, axes = found[name], _axes(ax)
        order = entry.shapley or entry.total
        known = sorted(((e.value, e.low, e.high, n) for n, e in order.items() if e.value is not None), reverse=True)
        values = np.array([value for value, *_ in known])
        ends = np.array([[value - (low or 0.0), (high or 1.0) - value] for value, low, high, _ in known]).T
        axes.barh([n for *_, n in known], values, xerr=np.maximum(ends, 0.0) if known else None)
        axes.set(xlabel=f"{'Shapley effect' if entry.shapley else 'total index'} of {name}", xlim=(0.0, 1.0))
        return axes

    def histogram(self, quantity: str | None = None, ax: Axes | None = None) -> Axes:
        """How a quantity is distributed over the stored rows that have an answer."""
        samples, axes = self.run.samples(), _axes(ax)
        name = _chosen(quantity, self.run.results.quantities, "quantity")
        unit, factor = display_unit(name)
        axes.hist(factor * samples.loc[samples["status"] == 0, name], bins=_BINS, density=True)
        axes.set(xlabel=f"{name} [{unit}]" if unit else name, ylabel="density")
        return axes


def _axes(given: Axes | None) -> Axes:
    """The axes given, or new ones of a figure by themselves."""
    if given is not None:
        return given
    from matplotlib import pyplot

    return pyplot.subplots()[1]


def _chosen(name: str | None, known: Iterable[str], what: str) -> str:
    """A name that the run has; the first where none is given."""
    names = list(known)
    if not names or (name is not None and name not in names):
        raise UsageError(
            f"there is no {what} {'' if name is None else repr(name)} (there are: {', '.join(names) or 'none'})"
        )
    return names[0] if name is None else name
