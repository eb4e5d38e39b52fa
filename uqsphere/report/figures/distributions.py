"""Distributions of the quantities against the strengths, and what drives them, as figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.quantities import display_unit
from uqsphere.report.contents import Contents, Samples, law_of
from uqsphere.report.figures.canvas import BLUE, INK, PAPER, RED, Picture, legend_above, new_figure, slug, style
from uqsphere.report.phrases import limit_name, listed, plain_percent, symbol, unit_text
from uqsphere.results import QuantityEntry
from uqsphere.results.entries import Est
from uqsphere.uq.law import Law

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: a range of more than this ratio is drawn on a logarithmic axis
_WIDE: Final = 40.0


@dataclass(frozen=True, kw_only=True)
class _Strength:
    """A strength on the axis of its quantity: a law, or one value."""

    name: str
    law: Law | None
    value: float | None

    @property
    def ends(self) -> tuple[float, float]:
        if self.law is None:
            assert self.value is not None
            return self.value, self.value
        low, high = self.law.ppf(np.array([0.001, 0.999]))
        return float(low), float(high)


def axis_label(name: str, words: str = "") -> str:
    """Name (or the words given) and display unit of a quantity."""
    unit = unit_text(display_unit(name)[0])
    text = words or symbol(name, 40)
    return f"{text} [{unit}]" if unit else text


def _strengths(contents: Contents, quantity: str) -> list[_Strength]:
    found = []
    for name, limit in contents.resolved.limits.items():
        if limit.quantity == quantity:
            law = law_of(contents.resolved, f"limits.{name}.strength")
            value = None if law is not None else float(limit.strength)
            found.append(_Strength(name=name, law=law, value=value))
    return found


def _alike(one: _Strength, other: _Strength) -> bool:
    """Whether two limits have the same strength, so that one curve stands for both."""
    return one.law == other.law and one.value == other.value


def _apart(strengths: list[_Strength]) -> list[_Strength]:
    """The strengths that differ from all before them."""
    return [s for k, s in enumerate(strengths) if not any(_alike(s, other) for other in strengths[:k])]


def _range(values: Array, strengths: list[_Strength]) -> tuple[float, float, bool]:
    """Ends of the axis (SI), and whether it is logarithmic."""
    low, high = (float(x) for x in np.quantile(values, [0.0005, 0.9995]))
    for strength in strengths:
        low, high = min(low, strength.ends[0]), max(high, strength.ends[1])
    if low > 0.0 and high > _WIDE * low:
        return low / 1.1, high * 1.1, True
    margin = 0.04 * (high - low) or 0.05 * abs(high) or 1.0
    return low - margin, high + margin, False


def distribution_figure(contents: Contents, quantity: str) -> Picture | None:
    """Density of the samples with median and 90 % range, the strengths on the same axis, the censored share.

    None where there is nothing to draw: no sample, or the same value in all of them.
    """
    samples = contents.samples.get(quantity)
    if samples is None or len(samples.values) < 2:
        return None
    spread = float(np.ptp(samples.values))
    if not spread > 1e-9 * float(np.abs(samples.values).max()):
        return None
    strengths = _strengths(contents, quantity)
    with style():
        figure, (axes,) = new_figure(3.0 if not strengths else 3.3)
        low, high, logarithmic = _range(samples.values, strengths)
        factor = display_unit(quantity)[1]
        if logarithmic:
            axes.set_xscale("log")
            _log_ticks(axes.xaxis)
        tallest = _density(axes, samples, (low, high), logarithmic, factor)
        for strength in _apart(strengths):
            tallest = max(tallest, _strength_curve(axes, strength, (low, high), logarithmic, factor))
        axes.set_xlim(low * factor, high * factor)
        axes.set_ylim(0.0, 1.22 * tallest)
        _marks(axes, contents.results.quantities[quantity], tallest, quantity)
        _curve_legend(axes, samples, strengths, quantity)
        axes.set_yticks([])
        axes.spines["left"].set_visible(False)
        axes.set_xlabel(axis_label(quantity))
    return Picture(
        name=slug("distribution", quantity),
        title=f"Distribution of {symbol(quantity)}",
        figure=figure,
        **_drawn_densities(samples, strengths, (low, high), logarithmic),
    )


def _log_ticks(axis: Any) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=12))
    axis.set_minor_formatter(NullFormatter())
    axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))


def _density(axes: Axes, samples: Samples, ends: tuple[float, float], logarithmic: bool, factor: float) -> float:
    """Histogram of what was seen and a hatched bar for what outlasted its record; areas are shares."""
    total = len(samples.values)
    scale = np.log if logarithmic else np.asarray
    whole = float(scale(np.array(ends[1])) - scale(np.array(ends[0])))
    edges = _edges(samples, logarithmic)
    seen = samples.values[~samples.censored]
    counts, _ = np.histogram(seen, bins=edges)
    # per width of the axis as drawn, so that areas compare on a logarithmic axis too
    heights = counts / total * whole / np.diff(scale(edges))
    axes.stairs(heights, edges * factor, fill=True, color=BLUE, alpha=0.35, linewidth=0.0)
    axes.stairs(heights, edges * factor, color=BLUE, linewidth=1.2)
    late = samples.values[samples.censored]
    if len(late) == 0:
        return float(heights.max())
    # at the usual end of the record, as wide as can be seen
    middle, half = float(scale(np.array(np.median(late)))), 0.025 * whole
    back = np.exp if logarithmic else np.asarray
    left, right = float(back(np.array(middle - half))) * factor, float(back(np.array(middle + half))) * factor
    height = len(late) / total * whole / (2.0 * half)
    axes.bar(left, height, right - left, align="edge", facecolor="none", edgecolor=RED, hatch="///", linewidth=1.0)
    return max(float(heights.max()), height)


def _edges(samples: Samples, logarithmic: bool) -> Array:
    """Ends of the bars of a histogram."""
    low, high = np.quantile(samples.values, [0.0005, 0.9995])
    bins = 40 if len(samples.values) >= 4000 else 25
    return np.asarray(np.geomspace(low, high, bins + 1) if logarithmic else np.linspace(low, high, bins + 1))


def _drawn_densities(
    samples: Samples, strengths: list[_Strength], ends: tuple[float, float], logarithmic: bool
) -> dict[str, Any]:
    """Header and rows of the bars and of the laws of the strengths beside them, in SI."""
    edges = _edges(samples, logarithmic)
    counts, _ = np.histogram(samples.values[~samples.censored], bins=edges)
    rows: list[tuple[Any, ...]] = [
        ("samples", float(a), float(b), float(c) / len(samples.values))
        for a, b, c in zip(edges[:-1], edges[1:], counts, strict=True)
    ]
    late = samples.values[samples.censored]
    if len(late):
        rows.append(("outlasts the record", float(late.min()), float(late.max()), len(late) / len(samples.values)))
    cuts = np.geomspace(*ends, 61) if logarithmic else np.linspace(*ends, 61)
    for strength in strengths:
        name = f"strength of {strength.name}"
        if strength.law is None:
            rows.append((name, strength.value, strength.value, 1.0))
        else:
            shares = np.diff(strength.law.cdf(cuts))
            rows += [(name, *map(float, row)) for row in zip(cuts[:-1], cuts[1:], shares, strict=True)]
    return {"header": ("what", "from", "to", "share"), "rows": tuple(rows)}


def _strength_curve(
    axes: Axes, strength: _Strength, ends: tuple[float, float], logarithmic: bool, factor: float
) -> float:
    if strength.law is None:
        assert strength.value is not None
        axes.axvline(strength.value * factor, color=RED, linestyle="--", ymax=0.8)
        return 0.0
    x = np.geomspace(*ends, 300) if logarithmic else np.linspace(*ends, 300)
    density = np.nan_to_num(strength.law.pdf(x), nan=0.0, posinf=0.0)
    width = x * np.log(ends[1] / ends[0]) if logarithmic else np.full_like(x, ends[1] - ends[0])
    heights = density * width
    axes.plot(x * factor, heights, color=RED, linestyle="--")
    axes.fill_between(x * factor, heights, color=RED, alpha=0.12, linewidth=0.0)
    return float(heights.max())


def _marks(axes: Axes, entry: QuantityEntry, tallest: float, quantity: str) -> None:
    """Median and 5 to 95 % range above the density."""
    factor = display_unit(quantity)[1]
    low, middle, high = (entry.quantiles.get(p, Est()).value for p in ("0.05", "0.5", "0.95"))
    y = 1.1 * tallest
    if low is not None and high is not None:
        axes.plot([low * factor, high * factor], [y, y], color=INK, linewidth=1.2, marker="|", markersize=8)
    if middle is not None:
        axes.plot([middle * factor], [y], marker="o", markersize=6, color=INK, markerfacecolor=PAPER)


def _curve_legend(axes: Axes, samples: Samples, strengths: list[_Strength], quantity: str) -> None:
    """What each mark is, above the drawing."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    share = float(samples.censored.mean())
    handles: list[Any] = []
    if share < 1.0:
        handles += [
            Patch(facecolor=BLUE, alpha=0.35, label=symbol(quantity, 24)),
            Line2D([], [], color=INK, marker="o", markerfacecolor=PAPER, label="median, 5 to 95 %"),
        ]
    if share > 0.0:
        handles.append(
            Patch(facecolor="none", edgecolor=RED, hatch="///", label=f"{plain_percent(share)} outlast the record")
        )
    for strength in _apart(strengths)[:3]:
        alike = [limit_name(s.name, 24) for s in strengths if _alike(s, strength)]
        names = listed(alike) if len(alike) == 1 or len(listed(alike)) <= 26 else f"{len(alike)} limits"
        handles.append(Line2D([], [], color=RED, linestyle="--", label=f"strength of {names}"))
    legend_above(axes, 1 if max(len(str(handle.get_label())) for handle in handles) > 34 else 2, handles, 1.8)
