"""Samples on both sides of a limit: the input that matters most against the strength, or against the demand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.quantities import display_unit
from uqsphere.report import canvas, directions
from uqsphere.report.canvas import BLUE, INK, ORANGE, RED, Picture
from uqsphere.report.contents import Contents, law_of
from uqsphere.report.figures import axis_label, slug
from uqsphere.report.tables import thousands
from uqsphere.report.wording import limit_name, plain_percent, short_input, symbol
from uqsphere.uq.law import ppf

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["Sides", "sides_of", "surface_figure", "surface_finding"]

Array = npt.NDArray[np.float64]

#: points that are drawn, and slices in which the demand is described
_DRAWN: Final = 900
_SLICES: Final = 12
#: misses, and what is not, of which a picture says something; misses that are drawn one and all where fewer are chosen
_TELLING: Final = 10
_SPARSE: Final = 60
#: points that a slice must hold
_FEWEST: Final = 20
#: fraction of the golden section: its multiples fill (0, 1) evenly, in the order of the samples
_GOLDEN: Final = 0.6180339887498949


@dataclass(frozen=True, kw_only=True)
class Sides:
    """Samples of a limit: the input `name` (n,), demand (n,), strength (n,), all in SI; `missed` (n,) flags.

    `random` tells whether the strength scatters.
    """

    name: str
    x: Array
    demand: Array
    strength: Array
    missed: npt.NDArray[np.bool_]
    random: bool


def _paired(contents: Contents, limit: str) -> bool:
    """Whether the strength depends on another number, so that it cannot be drawn by itself."""
    own = f"limits.{limit}.strength"
    return any(own in group["of"] for group in contents.resolved.get("dependence", []))


def sides_of(contents: Contents, limit: str) -> Sides | None:
    """The samples of a limit with a strength each; None where there is nothing to show.

    A strength that scatters by itself is not sampled by a run but integrated; for the picture each sample gets one
    from an even sequence over its law.  One that depends on an input is set by the rank of that input, by the
    normal copula, where it depends on one input alone.
    """
    entry, resolved = contents.results["limits"][limit], contents.resolved["limits"][limit]
    samples = contents.samples.get(entry["quantity"])
    names = [
        n for n in contents.results["sensitivity"].get(entry["quantity"], {}).get("first", {}) if _varies(contents, n)
    ]
    if samples is None or not names or resolved["model_factor"] != 1.0 or samples.censored.mean() > 0.05:
        return None
    if len(samples.values) < _SLICES * _FEWEST:
        return None
    shares = entry.get("governing_inputs") or {}
    name = max(names, key=lambda n: (float(shares.get(n, 0.0)), _tie(contents.points[n], samples.values)))
    law = law_of(contents.resolved, f"limits.{limit}.strength")
    if law is None:
        if resolved["strength"] == "random":
            return None
        strength = np.full(len(samples.values), float(resolved["strength"]))
    else:
        levels = _levels(contents, limit, len(samples.values))
        if levels is None:
            return None
        strength = np.asarray(ppf(law, levels), dtype=float)
    over = samples.values > strength
    return Sides(
        name=name,
        x=contents.points[name],
        demand=samples.values,
        strength=strength,
        missed=over if entry["aim"] == "survive" else ~over,
        random=law is not None,
    )


def _varies(contents: Contents, name: str) -> bool:
    return name in contents.points and float(np.ptp(contents.points[name])) > 0.0


def _tie(x: Array, y: Array) -> float:
    """Rank correlation, without its sign."""
    ranks = np.array([np.argsort(np.argsort(v)) for v in (x, y)], dtype=float)
    return abs(float(np.corrcoef(ranks)[0, 1]))


def _levels(contents: Contents, limit: str, n: int) -> Array | None:
    """Probabilities of the strengths of n samples, in (0, 1)."""
    even = np.asarray((0.5 + _GOLDEN * np.arange(1, n + 1)) % 1.0)
    if not _paired(contents, limit):
        return even
    from scipy.special import ndtr, ndtri

    own = f"limits.{limit}.strength"
    groups = [group for group in contents.resolved["dependence"] if own in group["of"]]
    others = [name for group in groups for name in group["of"] if name != own]
    if len(others) != 1 or others[0] not in contents.points or groups[0]["copula"] not in ("gaussian", "normal"):
        return None
    rank = groups[0].get("spearman")
    if rank is None:
        return None
    # Pearson's correlation of the normal scores from Spearman's of the ranks (Pearson 1907)
    rho = 2.0 * np.sin(np.pi * float(rank) / 6.0)
    scores = ndtri((np.argsort(np.argsort(contents.points[others[0]])) + 0.5) / n)
    return np.asarray(ndtr(rho * scores + np.sqrt(1.0 - rho**2) * ndtri(even)))


def _slices(x: Array, y: Array) -> tuple[Array, Array]:
    """Middles (k,) of slices of x with equally many points, and 5, 50 and 95 % of y in each (k, 3)."""
    order = np.argsort(x)
    parts = np.array_split(order, _SLICES)
    middles = np.array([np.median(x[part]) for part in parts])
    return middles, np.array([np.quantile(y[part], [0.05, 0.5, 0.95]) for part in parts])


def surface_figure(contents: Contents, limit: str) -> Picture | None:
    """Samples over the governing input: strengths against the demand that they must withstand."""
    sides = sides_of(contents, limit)
    if sides is None or not _telling(sides):
        return None
    quantity = contents.results["limits"][limit]["quantity"]
    across, up = display_unit(sides.name)[1], display_unit(quantity)[1]
    drawn, whole = _chosen(sides)
    y = sides.strength if sides.random else sides.demand
    with canvas.style():
        figure, (axes,) = canvas.new_figure(3.9)
        kept = drawn & ~sides.missed
        lost = drawn & sides.missed
        canvas.dots(axes, sides.x[kept] * across, y[kept] * up, colour=BLUE, size=2.4, alpha=0.55)
        canvas.dots(axes, sides.x[lost] * across, y[lost] * up, colour=RED, size=3.8, square=True)
        middles, band = _to_the_ends(*_slices(sides.x, sides.demand), sides.x[drawn])
        if sides.random:
            axes.fill_between(middles * across, band[:, 0] * up, band[:, 2] * up, color=ORANGE, alpha=0.30, linewidth=0)
            axes.plot(middles * across, band[:, 1] * up, color=INK)
        else:
            axes.axhline(float(sides.strength[0]) * up, color=INK, linestyle="--")
        axes.set_xlabel(axis_label(sides.name, canvas.shorten(short_input(sides.name), 50)))
        axes.set_ylabel(axis_label(quantity, "strength" if sides.random else symbol(quantity, 24)))
        axes.grid()
        _legend(axes, sides, quantity, whole)
    columns = np.stack([sides.x[drawn], sides.demand[drawn], sides.strength[drawn], sides.missed[drawn]], axis=1)
    return Picture(
        name=slug("surface", limit),
        title=f"Samples on both sides of {limit_name(limit)}",
        finding=surface_finding(contents, limit),
        figure=figure,
        header=(sides.name, quantity, "strength", "missed"),
        rows=tuple((float(a), float(b), float(c), int(d)) for a, b, c, d in columns),
    )


def _telling(sides: Sides) -> bool:
    """Whether enough samples lie on either side."""
    missed = int(sides.missed.sum())
    return min(missed, len(sides.missed) - missed) >= _TELLING


def _chosen(sides: Sides) -> tuple[npt.NDArray[np.bool_], bool]:
    """An even choice of the samples, and whether it holds every miss, which it does where the choice has few."""
    n = len(sides.x)
    drawn = np.zeros(n, dtype=bool)
    drawn[:: max(1, -(-n // _DRAWN))] = True
    sparse = int((drawn & sides.missed).sum()) < _SPARSE
    if sparse:
        drawn[np.flatnonzero(sides.missed)[:_DRAWN]] = True
    return drawn, sparse and int(sides.missed.sum()) <= _DRAWN


def _to_the_ends(middles: Array, band: Array, x: Array) -> tuple[Array, Array]:
    """Slices drawn on to the first and the last point of the picture, along the median's straight line.

    The band keeps its width: it is not known there, and the lines of its ends would spread without reason.
    """
    ends = []
    for place, near, far in ((float(x.min()), 0, 1), (float(x.max()), -1, -2)):
        width = middles[near] - middles[far]
        slope = (band[near, 1] - band[far, 1]) / width if width else 0.0
        ends.append((place, band[near] + slope * (place - middles[near])))
    (low, first), (high, last) = ends
    return np.concatenate([[low], middles, [high]]), np.concatenate([first[None], band, last[None]])


def _legend(axes: Axes, sides: Sides, quantity: str, whole: bool) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    label = f"all {int(sides.missed.sum())} that miss it" if whole else "sample that misses it"
    thinned = -(-len(sides.x) // _DRAWN)
    met = f"one in {thinned} of those that meet the aim" if whole and thinned > 1 else "sample that meets the aim"
    handles: list[Any] = [
        Line2D([], [], color=BLUE, marker=".", linestyle="", label=met),
        Line2D([], [], color=RED, marker="s", markersize=4, linestyle="", label=label),
    ]
    if sides.random:
        handles += [
            Line2D([], [], color=INK, label=f"limit: median {symbol(quantity, 20)}"),
            Patch(facecolor=ORANGE, alpha=0.30, label=f"5 to 95 % of {symbol(quantity, 20)}"),
        ]
    else:
        handles.append(Line2D([], [], color=INK, linestyle="--", label="limit: the strength"))
    axes.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderaxespad=0.2, borderpad=0.0)


def surface_finding(contents: Contents, limit: str) -> str:
    """Where along the governing input the misses lie."""
    sides = sides_of(contents, limit)
    if sides is None:
        return ""
    n = int(sides.missed.sum())
    words = short_input(sides.name)
    if n == 0:
        return f"None of {thousands(len(sides.x))} samples misses the aim."
    if n == len(sides.x):
        return f"All of {thousands(len(sides.x))} samples miss the aim."
    where = float((sides.x[sides.missed] > np.median(sides.x)).mean())
    half = "upper" if where >= 0.5 else "lower"
    share = max(where, 1.0 - where)
    text = f"Of the samples that miss the aim {100.0 * share:.0f} % lie in the {half} half of {words}"
    if n < 30:
        text = f"The {n} samples that miss the aim are too few to say where along {words} they lie"
    text += f"; in this picture {plain_percent(n / len(sides.x))} of the samples miss it."
    return text + (directions.opposed(contents, limit, sides, where) if n >= 30 else "")
