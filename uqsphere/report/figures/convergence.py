"""Convergence, and speed against error of every method, as figures."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.report.contents import Contents
from uqsphere.report.figures import canvas
from uqsphere.report.phrases import limit_name, symbol
from uqsphere.results.entries import AccuracyTable
from uqsphere.runner.results import FURTHER

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

_COLOURS: Final = (canvas.BLUE, canvas.ORANGE, canvas.GREEN, canvas.RED, canvas.SKY)
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
    """Every error over what it took: courses with a mark for each method, answers that no stage pursues as marks."""
    series = _shown(contents, column)
    if not series:
        return None
    further = [s.points[-1] for s in series if s.kind in FURTHER]
    pursued = [s for s in series if s.kind not in FURTHER]
    methods = sorted({s.method for s in pursued})
    labelled = _labelled(pursued)
    with canvas.style():
        figure, (axes,) = canvas.new_figure(3.9)
        _limits(axes, np.array([(p[column], p[2]) for s in series for p in s.points]))
        axes.plot([p[column] for p in further], [p[2] for p in further], linestyle="", **_FURTHER_MARK)
        for k, s in enumerate(pursued):
            own, points = _of_method(methods.index(s.method)), np.array(s.points)
            axes.plot(points[:, column], points[:, 2], markersize=4.5, color=own["colour"], marker=own["marker"],
                      linestyle=_STYLES[k % len(_STYLES)], linewidth=1.2 if s in labelled else 0.6)  # fmt: skip
        axes.axhline(1.0, color=canvas.INK, linewidth=1.0, linestyle=(0, (6, 3)))
        _end_labels(axes, labelled, column)
        canvas.frame(axes, x=label, y="error over what was asked", grid=True)
        handles = _handles(methods, bool(further), sum(s.points[-1][2] < _LEAST for s in series))
        canvas.legend_above(axes, 2, handles)
    return canvas.Picture(name=name, title=title, figure=figure)


def _shown(contents: Contents, column: int) -> list[Series]:
    """Series of points that have a place, those that end with the largest error first."""
    known = ((s, tuple(p for p in s.points if p[column] > 0.0)) for s in error_series(contents))
    return sorted((replace(s, points=points) for s, points in known if points), key=lambda s: -s.points[-1][2])


def _limits(axes: Axes, points: Array) -> None:
    """Axes about the points (n, 2) and an error of one."""
    (x, y), (right, top) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    wide = max(right / x, 10.0**0.5) ** 0.1
    canvas.log_axis(axes, "x", x / wide, right * wide)
    canvas.log_axis(axes, "y", max(min(1.0, y) / 2.0, _LEAST), max(1.0, top) * 2.0)


def _of_method(k: int) -> dict[str, str]:
    """The colour and the mark of the k-th method."""
    return {"colour": _COLOURS[k % len(_COLOURS)], "marker": canvas.MARKS[k % len(canvas.MARKS)]}


def _labelled(pursued: list[Series]) -> list[Series]:
    """The series with a label: of two methods for one question the better one, and none that ends below the axis."""
    best = {(s.quantity, s.kind): s for s in pursued}
    return [s for s in pursued if s is best[s.quantity, s.kind] and s.points[-1][2] >= _LEAST][:_LABELLED]


def _handles(methods: list[str], further: bool, below: int) -> list[Artist]:
    """What each mark is."""
    found = [
        canvas.mark(label=canvas.wrap(name, 30, lines=3), markersize=5, **_of_method(k))
        for k, name in enumerate(methods)
    ]
    found += [canvas.mark(canvas.GREY, "read off the same rows", linestyle="", **_FURTHER_MARK)] if further else []
    found.append(canvas.mark(canvas.INK, "what was asked", linewidth=1.0, linestyle=(0, (6, 3))))
    return [*found, canvas.mark(canvas.INK, f"not shown: {below} below {_LEAST:g}", linestyle="")] if below else found


def _end_labels(axes: Axes, series: list[Series], column: int) -> None:
    """Labels in a column on the right, at the height of their last point as far as there is room."""
    low, high = (math.log10(v) for v in axes.get_ylim())
    wanted = [math.log10(s.points[-1][2]) for s in series]
    places = canvas.spread(wanted, 0.062 * (high - low), low + 0.03 * (high - low), high - 0.03 * (high - low))
    # without room at its ends, which matplotlib searches along the line for long
    arrow = {"arrowstyle": "-", "color": canvas.GREY, "linewidth": 0.5, "shrinkA": 0.0, "shrinkB": 0.0, "patchA": None,
             "relpos": (-0.02, 0.5)}  # fmt: skip
    for s, place in zip(series, places, strict=True):
        last = s.points[-1]
        axes.annotate(s.label, (last[column], last[2]), xytext=(1.06, (place - low) / (high - low)),
                      textcoords="axes fraction", va="center", fontsize=8.0, annotation_clip=False,
                      arrowprops=arrow)  # fmt: skip


def convergence_figure(contents: Contents) -> canvas.Picture | None:
    """Error over what was asked against the evaluations spent."""
    return _drawing(contents, 0, "convergence", "Error against evaluations", "model evaluations")


def speed_figure(contents: Contents) -> canvas.Picture | None:
    """Error over what was asked against the seconds of this machine."""
    return _drawing(contents, 1, "speed", "Error against time", "seconds since the start, this machine")
