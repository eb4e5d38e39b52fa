"""Quantities in figures: how they are distributed beside the strengths, what makes their scatter, vectors, and how the
errors of all answers fell."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.quantities import display_unit
from uqsphere.report.contents import Contents, Samples, law_of
from uqsphere.report.figures import canvas
from uqsphere.report.phrases import limit_name, listed, plain_percent, share_text, short_input, symbol, unit_text
from uqsphere.report.tables import ranked
from uqsphere.results import IndexEntry, QuantityEntry
from uqsphere.results.entries import AccuracyTable, Est, Ests
from uqsphere.results.tables import Stored
from uqsphere.runner.results import FURTHER
from uqsphere.uq import Law

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure


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
    # a range of more than this ratio is drawn on a logarithmic axis
    if low > 0.0 and high > 40.0 * low:
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


_COLOURS: Final = (canvas.BLUE, canvas.ORANGE, canvas.GREEN, canvas.RED, canvas.SKY)
#: errors below this share of what was asked lie below the axis: they would leave the rest no room
_LEAST: Final = 1e-3
#: what the errors of answers without a course are called in a label, in the order of `FURTHER`
_WORDS: Final = dict(
    zip(FURTHER, ("value", "fracture", "share", "median", "delta", "PAWN", "index of a miss", "inputs of a miss"),
        strict=True)
)  # fmt: skip
_FRACTURE: Final = {
    "union": "fracture probability",
    "first_loading": "fracture, first loading",
    "curve": "fracture value",
    "governed_by": "limit that comes first",
}
#: answers that no stage pursues are marks alone
_FURTHER_MARK: Final[dict[str, Any]] = {
    "marker": "o", "markersize": 3.5, "markerfacecolor": "none", "markeredgecolor": canvas.GREY, "markeredgewidth": 0.8,
}  # fmt: skip
_STYLES: Final = ("-", "--", ":", "-.")


@dataclass(frozen=True, kw_only=True)
class Series:
    """The errors of one method for one question: points (evaluations, seconds, error over what was asked)."""

    method: str
    quantity: str
    kind: str
    asked: float
    points: tuple[tuple[float, float, float], ...] = ()

    @property
    def label(self) -> str:
        """Which question it is."""
        head, _, rest = self.quantity.partition(".")
        if head == "fracture" and rest:
            return _FRACTURE.get(rest, f"{rest.replace('_', ' ')} at fracture")
        rest, _, where = rest.partition(" at ")
        name = limit_name(rest, 20) if head in ("limits", "margins") and rest else symbol(self.quantity, 20)
        name += f" ({where.partition(' ')[2]})" if where else ""
        return f"{name} {_short(self.kind)}"


def _short(kind: str) -> str:
    if kind in FURTHER:
        return _WORDS[kind]
    for word in ("band", "mean", "quantile", "probability", "index"):
        if word in kind:
            return word
    return "unexplained" if "variance" in kind else kind


def _asked(kind: str, accuracy: AccuracyTable) -> float | None:
    if _short(kind) == "band":
        return accuracy.curve
    word = {"mean": "mean", "quantile": "quantile", "probability": "probability"}.get(_short(kind), "sobol")
    found: float | None = getattr(accuracy, FURTHER.get(kind, word))
    return found


def error_series(contents: Contents) -> list[Series]:
    """The speed-error rows of a run as series; the seconds are those of the manifest, in the same order."""
    rows = contents.results.speed_error
    seconds = list(contents.manifest.speed_error_seconds)
    seconds += [math.nan] * (len(rows) - len(seconds))
    accuracy = contents.resolved.analysis.accuracy
    found: dict[tuple[str, str, str], Series] = {}
    for row, second in zip(rows, seconds, strict=False):
        if not row.error or row.error <= 0.0:
            continue
        key = (row.method, row.quantity, row.error_kind)
        asked = _asked(row.error_kind, accuracy)
        if asked is None:
            continue
        series = found.setdefault(key, Series(method=key[0], quantity=key[1], kind=key[2], asked=asked))
        point = (float(row.evaluations), float(second), row.error / asked)
        found[key] = replace(series, points=(*series.points, point))
    return list(found.values())


def _drawing(contents: Contents, column: int, name: str, title: str, label: str) -> canvas.Picture | None:
    """Every error over what it took: a course for each question, a mark and a colour for each method."""
    series = _shown(contents, column)
    if not series:
        return None
    pursued = [s for s in series if s.kind not in FURTHER]
    further = np.array([s.points[-1] for s in series if s.kind in FURTHER]).reshape(-1, 3)
    methods = sorted({s.method for s in pursued})
    below, labelled = sum(s.points[-1][2] < _LEAST for s in series), _labelled(pursued)
    asked: dict[str, Any] = {"color": canvas.INK, "linewidth": 1.0, "linestyle": (0, (6, 3))}
    with canvas.style():
        figure, (axes,) = canvas.new_figure(4.2 + 0.12 * len(labelled))
        _limits(axes, np.array([(p[column], p[2]) for s in series for p in s.points]))
        if len(further):
            axes.plot(further[:, column], further[:, 2], label="read off the same rows", **_FURTHER_MARK)
        axes.axhline(1.0, label="what was asked", **asked)
        for k, s in enumerate(pursued):
            at, points = methods.index(s.method), np.array(s.points)
            axes.plot(points[:, column], points[:, 2], markersize=4.5, color=_COLOURS[at % len(_COLOURS)],
                      marker=canvas.MARKS[at % len(canvas.MARKS)], linestyle=_STYLES[k % len(_STYLES)],
                      linewidth=1.2 if s in labelled else 0.6, label=s.label if s in labelled else None)  # fmt: skip
        if below:
            axes.plot([], [], linestyle="", label=f"not shown: {below} below {_LEAST:g}")
        canvas.frame(axes, x=label, y="error over what was asked", grid=True)
        _legends(axes, methods)
    return canvas.Picture(name=name, title=title, figure=figure)


def _legends(axes: Axes, methods: list[str]) -> None:
    """Marks of the methods above, courses below."""
    marks = zip(methods, cycle(_COLOURS), cycle(canvas.MARKS))
    handles = [canvas.mark(c, canvas.wrap(name, 30, lines=3), marker=m, markersize=5) for name, c, m in marks]
    canvas.legend_above(axes, 2, handles)
    above = axes.get_legend()
    assert above is not None
    axes.add_artist(above)
    above.set_clip_on(False)  # what is cut off at the axes is left out of the layout
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.2), ncols=2, fontsize=8.0, handlelength=2.6)


def _shown(contents: Contents, column: int) -> list[Series]:
    """Series of points that have a place, those that end with the largest error first."""
    known = ((s, tuple(p for p in s.points if p[column] > 0.0)) for s in error_series(contents))
    return sorted((replace(s, points=points) for s, points in known if points), key=lambda s: -s.points[-1][2])


def _labelled(pursued: list[Series]) -> list[Series]:
    """The series with a label: of two methods for one question the better one, and none that ends below the axis."""
    best = {(s.quantity, s.kind): s for s in pursued}
    # series with a label; the rest is drawn thin
    return [s for s in pursued if s is best[s.quantity, s.kind] and s.points[-1][2] >= _LEAST][:10]


def _limits(axes: Axes, points: Array) -> None:
    """Axes about the points (n, 2) and an error of one."""
    (x, y), (right, top) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    wide = max(right / x, 10.0**0.5) ** 0.1
    canvas.log_axis(axes, "x", x / wide, right * wide)
    canvas.log_axis(axes, "y", max(min(1.0, y) / 2.0, _LEAST), max(1.0, top) * 2.0)


def convergence_figure(contents: Contents) -> canvas.Picture | None:
    """Error over what was asked against the evaluations spent."""
    return _drawing(contents, 0, "convergence", "Error against evaluations", "model evaluations")


def speed_figure(contents: Contents) -> canvas.Picture | None:
    """Error over what was asked against the seconds of this machine."""
    return _drawing(contents, 1, "speed", "Error against time", "seconds since the start, this machine")
