"""Convergence, and speed against error of every method, as figures."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

from uqsphere.report.contents import Contents
from uqsphere.report.figures.canvas import (
    BLUE,
    GREEN,
    GREY,
    INK,
    MARKS,
    ORANGE,
    RED,
    SKY,
    Picture,
    legend_above,
    new_figure,
    spread,
    style,
    wrap,
)
from uqsphere.report.phrases import limit_name, number_text, symbol
from uqsphere.results.entries import AccuracyTable
from uqsphere.runner.account import FURTHER
from uqsphere.runner.questions.curves import METHOD

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS: Final = (BLUE, ORANGE, GREEN, RED, SKY)
#: series with a label; the rest is drawn thin
_LABELLED: Final = 10
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
    "marker": "o", "markersize": 3.5, "markerfacecolor": "none", "markeredgecolor": GREY, "markeredgewidth": 0.8,
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


def _course(axes: Axes, series: Series, column: int, method: int, linestyle: Any, width: float) -> None:
    """One error over what it took."""
    points = [p for p in series.points if p[column] > 0.0]
    axes.plot(
        [p[column] for p in points],
        [p[2] for p in points],
        color=_COLOURS[method % len(_COLOURS)],
        marker=MARKS[method % len(MARKS)],
        markersize=4.5,
        linestyle=linestyle,
        linewidth=width,
    )


def _drawing(contents: Contents, column: int, name: str, title: str, label: str) -> Picture | None:
    series = [s for s in error_series(contents) if any(p[column] > 0.0 for p in s.points)]
    if not series:
        return None
    series.sort(key=lambda s: -s.points[-1][2])
    further = [s for s in series if s.kind in FURTHER]
    pursued = [s for s in series if s.kind not in FURTHER]
    methods = sorted({s.method for s in pursued})
    labelled = _labelled(pursued)
    with style():
        figure, (axes,) = new_figure(3.9)
        axes.set_xscale("log")
        axes.set_yscale("log")
        ends = [s.points[-1] for s in further]
        axes.plot([p[column] for p in ends], [p[2] for p in ends], linestyle="", **_FURTHER_MARK)
        for k, s in enumerate(pursued):
            _course(axes, s, column, methods.index(s.method), _STYLES[k % len(_STYLES)], 1.2 if s in labelled else 0.6)
        axes.axhline(1.0, color=INK, linewidth=1.0, linestyle=(0, (6, 3)))
        _limits(axes, series, column)
        _end_labels(axes, labelled, column)
        axes.set_xlabel(label)
        axes.set_ylabel("error over what was asked")
        axes.grid()
        _method_legend(axes, methods, bool(further), sum(s.points[-1][2] < _LEAST for s in series))
    return Picture(name=name, title=title, figure=figure)


def _labelled(pursued: list[Series]) -> list[Series]:
    """The series with a label: of two methods for one question the better one, and none that ends below the axis."""
    best: dict[tuple[str, str], Series] = {}
    for s in pursued:
        other = best.setdefault((s.quantity, s.kind), s)
        if s.points[-1][2] < other.points[-1][2]:
            best[s.quantity, s.kind] = s
    kept = [s for s in pursued if s is best[s.quantity, s.kind] and s.points[-1][2] >= _LEAST]
    return kept[:_LABELLED]


def _limits(axes: Axes, series: list[Series], column: int) -> None:
    """Decades around the points, with room for labels on the right."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

    xs = [p[column] for s in series for p in s.points if p[column] > 0.0]
    ys = [p[2] for s in series for p in s.points] + [1.0]
    low, high = math.log10(min(xs)), math.log10(max(xs))
    width = max(high - low, 0.5)
    axes.set_xlim(10.0 ** (low - 0.1 * width), 10.0 ** (high + 0.1 * width))
    axes.set_ylim(max(min(ys) / 2.0, _LEAST), max(ys) * 2.0)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0,), numticks=8))
    axes.xaxis.set_major_locator(FixedLocator(_ticks(low - 0.1 * width, high + 0.1 * width)))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(FuncFormatter(_thousands))


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers between two powers of ten, as few as serve: at least three, and none beside another.

    >>> _ticks(1.2, 2.2)
    [20.0, 50.0, 100.0]
    >>> _ticks(3.2, 3.7)
    [2000.0, 3000.0, 4000.0, 5000.0]
    >>> _ticks(-0.05, 0.2)
    [1.0, 1.2, 1.4]
    """
    decades = range(math.floor(low), math.ceil(high) + 1)
    found: list[float] = []
    for steps in ((1.0,), (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)):
        found = [step * 10.0**k for k in decades for step in steps if low <= math.log10(step) + k <= high]
        if len(found) >= 3:
            return found
    # too narrow for that: equal steps
    power = 10.0 ** math.floor(math.log10(10.0**high - 10.0**low))
    for step in (5.0 * power, 2.0 * power, power, 0.5 * power, 0.2 * power):
        found = [round(n * step, 12) for n in range(math.ceil(10.0**low / step), math.floor(10.0**high / step) + 1)]
        if len(found) >= 3:
            break
    return found


def _thousands(value: float, _: object = None) -> str:
    if value < 1e-3:
        return number_text(f"{value:.0e}").removeprefix("1 × ")
    return f"{value:,.0f}".replace(",", "\u202f") if value >= 1000.0 else f"{value:g}"


def _end_labels(axes: Axes, series: list[Series], column: int) -> None:
    """Labels in a column on the right, at the height of their last point as far as there is room."""
    low, high = (math.log10(v) for v in axes.get_ylim())
    wanted = [math.log10(s.points[-1][2]) for s in series]
    places = spread(wanted, 0.062 * (high - low), low + 0.03 * (high - low), high - 0.03 * (high - low))
    for s, place in zip(series, places, strict=True):
        last = s.points[-1]
        axes.annotate(
            s.label,
            (last[column], last[2]),
            xycoords="data",
            xytext=(1.06, (place - low) / (high - low)),
            textcoords="axes fraction",
            va="center",
            fontsize=8.0,
            annotation_clip=False,
            arrowprops={
                "arrowstyle": "-",
                "color": GREY,
                "linewidth": 0.5,
                "shrinkA": 1.0,
                "shrinkB": 3.0,
                "relpos": (0.0, 0.5),
            },
        )


#: methods whose names are too long for a legend, in few plain words
_SHORT: Final = {METHOD: "runs along the curve"}
#: letters of a line of the legend
_LINE: Final = 30


def _legend_names(methods: list[str]) -> list[str]:
    """Names of methods that fit a legend: what comes before the first comma where that tells them apart."""
    heads = [_SHORT.get(method, method.partition(",")[0]) for method in methods]
    return [
        head if heads.count(head) == 1 and len(head) <= _LINE else wrap(method, _LINE, lines=3)
        for head, method in zip(heads, methods, strict=True)
    ]


def _method_legend(axes: Axes, methods: list[str], further: bool, below: int) -> None:
    from matplotlib.lines import Line2D

    handles: list[Any] = [
        Line2D([], [], color=_COLOURS[k % len(_COLOURS)], marker=MARKS[k % len(MARKS)], markersize=5, label=name)
        for k, name in enumerate(_legend_names(methods))
    ]
    if further:
        handles.append(Line2D([], [], linestyle="", label="read off the same rows", **_FURTHER_MARK))
    handles.append(Line2D([], [], color=INK, linewidth=1.0, linestyle=(0, (6, 3)), label="what was asked"))
    if below:
        handles.append(Line2D([], [], linestyle="", label=f"not shown: {below} below {_LEAST:g}"))
    legend_above(axes, 2, handles)


def convergence_figure(contents: Contents) -> Picture | None:
    """Error over what was asked against the evaluations spent."""
    return _drawing(contents, 0, "convergence", "Error against evaluations", "model evaluations")


def speed_figure(contents: Contents) -> Picture | None:
    """Error over what was asked against the seconds of this machine."""
    return _drawing(contents, 1, "speed", "Error against time", "seconds since the start, this machine")
