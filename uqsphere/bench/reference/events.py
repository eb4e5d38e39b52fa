"""What happens in the steps of the reference: peaks, contact that is lost, thresholds, the end of the record.

Steps are looked at on a grid of 61 points, and between them where a slope changes its sign.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.bench.reference.steps import FINE, FINE_BASIS, FINE_SLOPES, Piece, evaluate

__all__ = ["Course", "crossing", "faded", "largest", "loss"]

Array = npt.NDArray[Any]
Long = np.longdouble
#: how closely the place of a peak is found: its height is flat there
_PEAK: Final = 1e-9


@dataclass(kw_only=True)
class Course:
    """The motion of one scene over its record, and what was found on the way, scaled.

    `end` is the share of the last piece that belongs to the record; `lost` the face that let go, or None;
    `dips` (time, depth over the largest approach) the moments at which a face nearly let go; `tail` the
    largest last coefficient of an accepted step.
    """

    pieces: list[Piece] = field(default_factory=list)
    end: Any = 1.0
    lost: int | None = None
    x_max: Any = 0.0
    x_first: Any = 0.0
    difference: Any = 0.0
    energy: Any = 0.0
    dips: list[tuple[float, float]] = field(default_factory=list)
    tail: float = 0.0

    @property
    def ended(self) -> Any:
        """End of the record."""
        return self.pieces[-1].time(self.end)


def _root(function: Callable[[Any], Any], a: Any, b: Any, within: float = 1e-19) -> Any:
    """Zero of a function between a and b, at which it has different signs; regula falsi, Illinois."""
    at_a, at_b = function(a), function(b)
    for _ in range(200):
        if at_b == at_a or abs(b - a) < within:
            break
        c = b - at_b * (b - a) / (at_b - at_a)
        if not min(a, b) < c < max(a, b):
            c = (a + b) / 2
        at_c = function(c)
        if at_c == 0 or abs(c - b) < within:
            return c
        if (at_c < 0) != (at_b < 0):
            a, at_a = b, at_b
        else:
            at_a = at_a / 2
        b, at_b = c, at_c
    return b


def _measures(values: Array, slopes: Array) -> tuple[Array, Array]:
    """x_1, x_2, q_1 - q_2 and the energy, and their derivatives, (..., 4), from those of x_1, x_2."""
    pressed = np.maximum(values[..., :2], 0.0)
    root = np.sqrt(pressed)
    a, b = pressed[..., 0] * root[..., 0], pressed[..., 1] * root[..., 1]
    rates = 1.5 * root * slopes[..., :2]
    stored = (a * pressed[..., 0] + b * pressed[..., 1]) * 2 / 5
    change = a * slopes[..., 0] + b * slopes[..., 1]
    return (
        np.stack([values[..., 0], values[..., 1], a - b, stored], axis=-1),
        np.stack([slopes[..., 0], slopes[..., 1], rates[..., 0] - rates[..., 1], change], axis=-1),
    )


def _fine(piece: Piece, end: Any) -> tuple[Array, Array, Array]:
    """Shares theta over [0, end] of a piece, and values and slopes of x_1, x_2 there."""
    if end == 1:
        return FINE, FINE_BASIS @ piece.states[:, :2], FINE_SLOPES @ piece.states[:, :2]
    theta = FINE * end
    pairs = [evaluate(piece.states[:, :2], share) for share in theta]
    return theta, np.array([pair[0] for pair in pairs]), np.array([pair[1] for pair in pairs])


def largest(piece: Piece, end: Any, known: Array) -> Array:
    """Largest absolute x_1, x_2, q_1 - q_2, energy over a piece, or what is known if that is larger, (4,)."""
    theta, values, slopes = _fine(piece, end)
    measures, rates = _measures(values, slopes)
    best = known.copy()
    for kind in range(4):

        def rate_at(share: Any, kind: int = kind) -> Any:
            return _measures(*evaluate(piece.states[:, :2], share))[1][kind]

        course = np.abs(measures[:, kind])
        top = int(course.argmax())
        best[kind] = max(best[kind], course[top])
        around = range(max(top - 1, 0), min(top + 1, len(theta) - 1))
        bend = abs(course[max(top - 1, 0)] - course[top]) + abs(course[min(top + 1, len(theta) - 1)] - course[top])
        if course[top] + bend < known[kind]:
            continue
        for i in around:
            if (rates[i, kind] > 0) != (rates[i + 1, kind] > 0):
                share = _root(rate_at, theta[i], theta[i + 1], _PEAK)
                best[kind] = max(best[kind], abs(_measures(*evaluate(piece.states[:, :2], share))[0][kind]))
    return best


def loss(course: Course, piece: Piece, x_max: Any) -> tuple[Any, int | None]:
    """Share of a piece at which a face lets go, and the face; (1, None) if none does.  Near misses are noted."""
    end, lost = Long(1), None
    if not course.pieces:  # the touch itself
        return end, lost
    _, values, slopes = _fine(piece, end)
    for face in range(2):

        def approach(share: Any, face: int = face) -> Any:
            return evaluate(piece.states[:, :2], share)[0][face]

        def slope(share: Any, face: int = face) -> Any:
            return evaluate(piece.states[:, :2], share)[1][face]

        x, rate = values[:, face], slopes[:, face]
        low: list[tuple[Any, Any]] = [(FINE[i], x[i]) for i in np.flatnonzero(x < 0)[:1]]
        for i in np.flatnonzero((rate[:-1] < 0) & (rate[1:] >= 0) & (np.minimum(x[:-1], x[1:]) < 0.05 * x_max)):
            share = _root(slope, FINE[i], FINE[i + 1], _PEAK)
            low.append((share, approach(share)))
            course.dips.append((float(piece.time(share)), float(low[-1][1] / x_max)))
        for share, depth in sorted(low):
            if depth < 0:
                before = [s for s, value in zip(FINE, x, strict=True) if s < share and value > 0]
                found = _root(approach, before[-1] if before else Long(0), share)
                if found < end:
                    end, lost = found, face
                break
    return end, lost


def faded(piece: Piece, level: Any) -> Any:
    """Share of a piece from which both approaches lie below `level`, or None."""
    _, values, _ = _fine(piece, Long(1))

    def excess(share: Any) -> Any:
        return evaluate(piece.states[:, :2], share)[0].max() - level

    def lead(share: Any) -> Any:
        at = evaluate(piece.states[:, :2], share)[0]
        return at[0] - at[1]

    shares = list(FINE)
    ahead = values[:, 0] > values[:, 1]
    for i in np.flatnonzero(ahead[1:] != ahead[:-1]):  # the larger of the two is least where they change places
        shares.append(_root(lead, FINE[i], FINE[i + 1]))
    shares.sort()
    below = [excess(share) < 0 for share in shares] if values.max(axis=1).min() < 1.1 * level else [False]
    if not any(below):
        return None
    first = below.index(True)
    return _root(excess, shares[first - 1], shares[first]) if first else Long(0)


def _peaks(piece: Piece, theta: Array, values: Array, slopes: Array, least: Any) -> list[Any]:
    """Shares at which one of the approaches has a maximum near or above `least`."""
    found = []
    for face in range(2):

        def slope(share: Any, face: int = face) -> Any:
            return evaluate(piece.states[:, :2], share)[1][face]

        x, rate = values[:, face], slopes[:, face]
        for i in np.flatnonzero((rate[:-1] > 0) & (rate[1:] <= 0) & (np.maximum(x[:-1], x[1:]) > least)):
            found.append(_root(slope, theta[i], theta[i + 1], _PEAK))
    return found


def crossing(course: Course, level: Any, *, last: bool = False) -> Any:
    """Time of the first (or the last) crossing of `level` by the larger approach; the record's end if it is above."""
    order = range(len(course.pieces) - 1, -1, -1) if last else range(len(course.pieces))
    for index in order:
        piece = course.pieces[index]
        theta, values, slopes = _fine(piece, course.end if index == len(course.pieces) - 1 else Long(1))
        if values.max() < 0.9 * level:
            continue

        def excess(share: Any, piece: Piece = piece) -> Any:
            return evaluate(piece.states[:, :2], share)[0].max() - level

        points = list(zip(theta, values.max(axis=1) >= level, strict=True))
        points += [(top, excess(top) >= 0) for top in _peaks(piece, theta, values, slopes, 0.9 * level)]
        points.sort()
        shares, above = [point[0] for point in points], [bool(point[1]) for point in points]
        if not any(above):
            continue
        at = len(above) - 1 - above[::-1].index(True) if last else above.index(True)
        beside = at + 1 if last else at - 1
        if not 0 <= beside < len(shares):
            return piece.time(shares[at])
        return piece.time(_root(excess, shares[beside], shares[at]))
    return Long(math.nan)
