"""Quantities in figures: how they are distributed beside the strengths, what makes their scatter, and vectors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.quantities import display_unit
from uqsphere.report.contents import Contents, Samples, law_of
from uqsphere.report.figures import canvas
from uqsphere.report.phrases import limit_name, listed, plain_percent, share_text, short_input, symbol, unit_text
from uqsphere.report.tables import ranked
from uqsphere.results import IndexEntry, QuantityEntry
from uqsphere.results.entries import Est, Ests
from uqsphere.results.tables import Stored
from uqsphere.uq import Law

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

#: a range of more than this ratio is drawn on a logarithmic axis
_WIDE: Final = 40.0


@dataclass(frozen=True, kw_only=True)
class _Strength:
    """A strength on the axis of its quantity, by the limits that have it: a law, or one value."""

    names: tuple[str, ...]
    law: Law | None
    value: float

    @property
    def ends(self) -> tuple[float, float]:
        if self.law is None:
            return self.value, self.value
        low, high = self.law.ppf(np.array([0.001, 0.999]))
        return float(low), float(high)


def axis_label(name: str, words: str = "") -> str:
    """Name (or the words given) and display unit of a quantity."""
    unit = unit_text(display_unit(name)[0])
    text = words or symbol(name, 40)
    return f"{text} [{unit}]" if unit else text


def _strengths(contents: Contents, quantity: str) -> list[_Strength]:
    """The strengths against a quantity, each once."""
    found: list[_Strength] = []
    for name, limit in contents.resolved.limits.items():
        if limit.quantity != quantity:
            continue
        law = law_of(contents.resolved, f"limits.{name}.strength")
        value = 0.0 if law is not None else float(limit.strength)
        same = next((k for k, s in enumerate(found) if (s.law, s.value) == (law, value)), len(found))
        names = found[same].names if same < len(found) else ()
        found[same : same + 1] = [_Strength(names=(*names, name), law=law, value=value)]
    return found


@dataclass(frozen=True, kw_only=True)
class _Scale:
    """The axis of a distribution: its ends (SI), whether it is logarithmic, and what an SI unit is on it."""

    low: float
    high: float
    logarithmic: bool
    factor: float

    def cuts(self, low: float, high: float, count: int) -> Array:
        """`count` values from low to high in equal ratios or steps."""
        return np.asarray((np.geomspace if self.logarithmic else np.linspace)(low, high, count))

    def place(self, x: Array) -> Array:
        """Values as the axis spaces them."""
        return np.asarray(np.log(x) if self.logarithmic else x)

    @property
    def width(self) -> float:
        """Its length as it is spaced."""
        low, high = self.place(np.array([self.low, self.high]))
        return float(high - low)


def _scale(values: Array, strengths: list[_Strength], factor: float) -> _Scale:
    ends = [*(float(x) for x in np.quantile(values, [0.0005, 0.9995])), *(end for s in strengths for end in s.ends)]
    low, high = min(ends), max(ends)
    if low > 0.0 and high > _WIDE * low:
        return _Scale(low=low / 1.1, high=high * 1.1, logarithmic=True, factor=factor)
    margin = 0.04 * (high - low) or 0.05 * abs(high) or 1.0
    return _Scale(low=low - margin, high=high + margin, logarithmic=False, factor=factor)


def distribution_figure(contents: Contents, quantity: str) -> canvas.Picture | None:
    """Density of the samples with median and 90 % range, the strengths on the same axis, the censored share.

    None where there is nothing to draw: no sample, or the same value in all of them.
    """
    samples = contents.samples.get(quantity)
    if samples is None or len(samples.values) < 2:
        return None
    if not float(np.ptp(samples.values)) > 1e-9 * float(np.abs(samples.values).max()):
        return None
    strengths, rows = _strengths(contents, quantity), list[tuple[object, ...]]()
    with canvas.style():
        figure, (axes,) = canvas.new_figure(3.0 if not strengths else 3.3)
        scale = _scale(samples.values, strengths, display_unit(quantity)[1])
        if scale.logarithmic:
            axes.set_xscale("log")
            log_ticks(axes.xaxis)
        tallest = _density(axes, samples, scale, rows)
        for strength in strengths:
            tallest = max(tallest, _strength_curve(axes, strength, scale, rows))
        axes.set_xlim(scale.low * scale.factor, scale.high * scale.factor)
        axes.set_ylim(0.0, 1.22 * tallest)
        _marks(axes, contents.results.quantities[quantity], tallest, scale.factor)
        _curve_legend(axes, samples, strengths, quantity)
        axes.set_yticks([])
        axes.spines["left"].set_visible(False)
        axes.set_xlabel(axis_label(quantity))
    return canvas.Picture(
        name=canvas.slug("distribution", quantity), title=f"Distribution of {symbol(quantity)}", figure=figure,
        header=("what", "from", "to", "share"), rows=tuple(rows),
    )  # fmt: skip


def log_ticks(axis: Axis) -> None:
    """Round numbers at a logarithmic axis."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=12))
    axis.set_minor_formatter(NullFormatter())
    axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))


def _density(axes: Axes, samples: Samples, scale: _Scale, rows: list[tuple[object, ...]]) -> float:
    """Histogram of what was seen and a hatched bar for what outlasted its record; areas are shares.

    The height of what is drawn; the bars are added to the rows, in SI.
    """
    total = len(samples.values)
    low, high = (float(end) for end in np.quantile(samples.values, [0.0005, 0.9995]))
    edges = scale.cuts(low, high, 41 if total >= 4000 else 26)
    counts, _ = np.histogram(samples.values[~samples.censored], bins=edges)
    rows += [("samples", float(a), float(b), float(c) / total)
             for a, b, c in zip(edges[:-1], edges[1:], counts, strict=True)]  # fmt: skip
    # per width of the axis as drawn, so that areas compare on a logarithmic axis too
    heights = counts / total * scale.width / np.diff(scale.place(edges))
    axes.stairs(heights, edges * scale.factor, fill=True, color=canvas.BLUE, alpha=0.35, linewidth=0.0)
    axes.stairs(heights, edges * scale.factor, color=canvas.BLUE, linewidth=1.2)
    late = samples.values[samples.censored]
    if len(late) == 0:
        return float(heights.max())
    rows.append(("outlasts the record", float(late.min()), float(late.max()), len(late) / total))
    # at the usual end of the record, as wide as can be seen
    middle, half = float(scale.place(np.array(np.median(late)))), 0.025 * scale.width
    left, right = (float((np.exp if scale.logarithmic else np.asarray)(middle + s * half)) * scale.factor
                   for s in (-1.0, 1.0))  # fmt: skip
    height = len(late) / total * scale.width / (2.0 * half)
    axes.bar(
        left, height, right - left, align="edge", facecolor="none", edgecolor=canvas.RED, hatch="///", linewidth=1.0
    )
    return max(float(heights.max()), height)


def _strength_curve(axes: Axes, strength: _Strength, scale: _Scale, rows: list[tuple[object, ...]]) -> float:
    """The density of a strength, or a line where it has one value; the height of it, the law added to the rows."""
    if strength.law is None:
        rows += [(f"strength of {name}", strength.value, strength.value, 1.0) for name in strength.names]
        axes.axvline(strength.value * scale.factor, color=canvas.RED, linestyle="--", ymax=0.8)
        return 0.0
    cuts = scale.cuts(scale.low, scale.high, 61)
    parts = zip(cuts[:-1], cuts[1:], np.diff(strength.law.cdf(cuts)), strict=True)
    drawn = [tuple(map(float, part)) for part in parts]
    rows += [(f"strength of {name}", *part) for name in strength.names for part in drawn]
    x = scale.cuts(scale.low, scale.high, 300)
    density = np.nan_to_num(strength.law.pdf(x), nan=0.0, posinf=0.0)
    heights = density * scale.width * (x if scale.logarithmic else 1.0)
    axes.plot(x * scale.factor, heights, color=canvas.RED, linestyle="--")
    canvas.band(axes, x * scale.factor, np.zeros_like(x), heights, canvas.RED, 0.12)
    return float(heights.max())


def _marks(axes: Axes, entry: QuantityEntry, tallest: float, factor: float) -> None:
    """Median and 5 to 95 % range above the density."""
    low, middle, high = (entry.quantiles.get(p, Est()).value for p in ("0.05", "0.5", "0.95"))
    y = 1.1 * tallest
    if low is not None and high is not None:
        axes.plot([low * factor, high * factor], [y, y], color=canvas.INK, linewidth=1.2, marker="|", markersize=8)
    if middle is not None:
        axes.plot([middle * factor], [y], marker="o", markersize=6, color=canvas.INK, markerfacecolor=canvas.PAPER)


def _curve_legend(axes: Axes, samples: Samples, strengths: list[_Strength], quantity: str) -> None:
    """What each mark is, above the drawing."""
    from matplotlib.patches import Patch

    share = float(samples.censored.mean())
    handles: list[Artist] = []
    if share < 1.0:
        handles.append(Patch(facecolor=canvas.BLUE, alpha=0.35, label=symbol(quantity, 24)))
        handles.append(canvas.mark(canvas.INK, "median, 5 to 95 %", marker="o", markerfacecolor=canvas.PAPER))
    if share > 0.0:
        words = f"{plain_percent(share)} outlast the record"
        handles.append(Patch(facecolor="none", edgecolor=canvas.RED, hatch="///", label=words))
    for strength in strengths[:3]:
        names = listed([limit_name(name, 24) for name in strength.names])
        names = names if len(strength.names) == 1 or len(names) <= 26 else f"{len(strength.names)} limits"
        handles.append(canvas.mark(canvas.RED, f"strength of {names}", linestyle="--"))
    canvas.legend_above(axes, 1 if max(len(str(handle.get_label())) for handle in handles) > 34 else 2, handles, 1.8)


# --- shares of the variance: a violin for what is likely, a whisker for 95 % ----------------------------

_HALF: Final = 0.17
#: what an index is drawn within: a bad estimate must not squeeze the others
_LEFT, _RIGHT = -0.1, 1.5
#: inputs of a sensitivity figure
MOST_INPUTS: Final = 12


def draw_indices(
    names: Sequence[str],
    labels: Mapping[str, str],
    first: Ests,
    total: Ests,
    axis: str,
    words: tuple[str, str] = ("alone (first)", "with interactions (total)"),
) -> Figure:
    """A row for each of `names`, from the top; the indices in it above each other, each with its violin."""
    with canvas.style():
        figure, (axes,) = canvas.new_figure(1.15 + 0.52 * len(names))
        ends = [0.0]
        for row, name in enumerate(names):
            ends.append(_index_mark(axes, first[name], row - 0.19, canvas.BLUE, "o"))
            ends.append(_index_mark(axes, total[name], row + 0.19, canvas.ORANGE, "D"))
        canvas.name_rows(axes, [canvas.wrap(labels[name], 24) for name in names])
        axes.spines["left"].set_visible(False)
        axes.axvline(0.0, color=canvas.GREY, linewidth=0.8)
        axes.set_xlim(min(0.0, axes.get_xlim()[0]), max(1.0, *ends) * 1.22)
        axes.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0", "25 %", "50 %", "75 %", "100 %"])
        axes.grid(axis="x")
        axes.set_xlabel(axis)
        handles = [
            canvas.mark(canvas.BLUE, words[0], alpha=0.9, marker="o", markeredgecolor=canvas.INK),
            canvas.mark(canvas.ORANGE, words[1], marker="D", markerfacecolor=canvas.PAPER, markeredgecolor=canvas.INK),
            canvas.mark(canvas.INK, "95 % interval", linewidth=1.0, marker="|", markersize=6),
        ]
        canvas.legend_above(axes, 3, handles, 1.8)
    return figure


def _index_mark(axes: Axes, estimate: Est, y: float, colour: str, marker: str) -> float:
    """Stem, violin, whisker, mark and label of one index; the right end of what is drawn."""
    value = estimate.value
    if value is None:
        return 0.0
    low = value if estimate.low is None else max(estimate.low, _LEFT)
    high = value if estimate.high is None else min(estimate.high, _RIGHT)
    axes.plot([0.0, value], [y, y], color=colour, linewidth=2.6, alpha=0.35, solid_capstyle="butt")
    error = estimate.std_error or (high - low) / 4.0
    if error > 0.0:
        x = np.linspace(max(value - 3.0 * error, _LEFT), min(value + 3.0 * error, _RIGHT), 61)
        half = _HALF * np.exp(-0.5 * ((x - value) / error) ** 2)
        canvas.band(axes, x, y - half, y + half, colour, 0.45)
    axes.plot([low, high], [y, y], color=canvas.INK, linewidth=1.0, marker="|", markersize=5)
    face = colour if marker == "o" else canvas.PAPER
    axes.plot([value], [y], marker=marker, markersize=4.5, color=canvas.INK, markerfacecolor=face)
    canvas.note(axes, share_text(estimate), (max(high, value, 0.0), y), (6, 0), va="center", fontsize=8.0)
    return float(max(high, value))


def group_figure(contents: Contents, quantity: str) -> canvas.Picture | None:
    """Closed and total indices of groups of inputs; None where none is known."""
    groups = contents.results.sensitivity.get(quantity, IndexEntry()).groups
    names = [n for n, e in groups.total.items() if e.value is not None]
    if not names:
        return None
    names.sort(key=lambda n: -groups.total[n].number)
    labels, axis = {n: canvas.shorten(n, 40) for n in names}, f"share of the variance of {symbol(quantity, 24)}"
    words = ("by themselves (closed)", "with interactions (total)")
    figure = draw_indices(names, labels, groups.first, groups.total, axis, words)
    title = f"What groups of inputs do to {symbol(quantity)}"
    return canvas.Picture(name=canvas.slug("groups", quantity), title=title, figure=figure)


def sensitivity_figure(contents: Contents, quantity: str) -> canvas.Picture | None:
    """First and total indices with their uncertainty, the largest on top; None where there are none."""
    entry = contents.results.sensitivity.get(quantity, IndexEntry())
    shown = ranked(entry)[:MOST_INPUTS]
    if not shown:
        return None
    labels, axis = {n: short_input(n) for n in shown}, f"share of the variance of {symbol(quantity, 24)}"
    figure = draw_indices(shown, labels, entry.first, entry.total, axis)
    return canvas.Picture(
        name=canvas.slug("sensitivity", quantity), title=f"What drives {symbol(quantity)}", figure=figure
    )


# --- answers that are vectors -----------------------------------------------------------------------------

#: length of an interval of an index above which it is not drawn
_TOLD: Final = 0.5


def field_figure(name: str, stored: Stored, *, over_time: bool) -> canvas.Picture:
    """The band above, with the intervals of its ends; below it the total index of the inputs that matter most."""
    from matplotlib.colors import to_hex

    answer, places = stored.answer, stored.places * (1e6 if over_time else 1.0)
    with canvas.style():
        figure, axes = canvas.new_figure(5.0 if stored.inputs else 3.2, rows=2 if stored.inputs else 1, sharex=True)
        above = axes[0]
        for k, level in enumerate(answer.levels):
            ends = answer.quantiles
            canvas.band(above, places, ends.low[k], ends.high[k], canvas.BLUE, 0.35)
            middle = level == 0.5
            above.plot(
                places, ends.value[k], color=canvas.BLUE, linewidth=1.4 if middle else 0.7, label=f"{100.0 * level:g} %"
            )
        canvas.frame(above, y="force [N]" if over_time else name, legend=len(answer.levels))
        if stored.inputs:
            total = answer.total
            largest = np.argsort(-np.nan_to_num(total.value).mean(axis=1))[:5]
            for j in largest.tolist():
                # an interval over half of the axis tells nothing
                known = total.high[j] - total.low[j] < _TOLD
                value = np.where(known, total.value[j], np.nan)
                (line,) = axes[1].plot(places, value, label=short_input(stored.inputs[j]))
                canvas.band(axes[1], places, total.low[j], total.high[j], to_hex(line.get_color()), where=known)
            axes[1].set_ylim(0.0, 1.0)
            canvas.frame(axes[1], y="total index", legend=2)
        axes[-1].set_xlabel("time since first touch [µs]" if over_time else "place")
    return canvas.Picture(
        name=f"field-{canvas.slug(name)}", title=f"{name}: band and what makes its scatter", figure=figure
    )
