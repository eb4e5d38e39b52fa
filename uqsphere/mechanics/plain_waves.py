"""Waves of the plain integrator: the pulse, the waves that come back, the times at which something jumps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

__all__ = ["Waves", "incoming"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

_POINTS: Final = 13
#: barycentric weights of the Chebyshev points with both ends
_WEIGHTS: Final = np.where(np.arange(_POINTS) % 2 == 0, 1.0, -1.0) * np.where(
    (np.arange(_POINTS) == 0) | (np.arange(_POINTS) == _POINTS - 1), 0.5, 1.0
)
_THETAS: Final = 0.5 - 0.5 * np.cos(np.pi * np.arange(_POINTS) / (_POINTS - 1))
#: jumps that a row may have to meet before its record ends
_MOST_STOPS: Final = 4096


@dataclass(kw_only=True)
class Waves:
    """The waves that have left the faces of n rows, as values at the points of the steps on which they left."""

    trips: Array
    ends: Array
    stops: Array
    crowded: Index
    echoing: npt.NDArray[np.bool_]
    count: Index
    first: Index
    start: Array
    length: Array
    span: Array
    values: Array

    @classmethod
    def begin(cls, arguments: dict[str, Any]) -> Waves:
        """No wave has left yet; `arguments` as of `uqsphere.mechanics.integrator.solve`."""
        trips, horizon = arguments["round_trips"], arguments["horizon"]
        n = len(horizon)
        stops, crowded = _all_stops(arguments["breaks"], trips, horizon)
        room = 64
        return cls(
            trips=trips, ends=arguments["ends"], stops=stops, crowded=crowded, echoing=np.isfinite(trips).any(axis=1),
            count=np.zeros(n, dtype=np.int64), first=np.zeros((2, n), dtype=np.int64), start=np.full((n, room), np.inf),
            length=np.ones((n, room)), span=np.ones((n, room)), values=np.zeros((n, room, 2, _POINTS)),
        )  # fmt: skip

    def next_stop(self, live: Index, time: Array, horizon: Array) -> Array:
        """The next time after `time` at which a wave jumps or the record ends."""
        later = self.stops[live] > (time + 1e-12 * (1.0 + time))[:, None]
        return np.asarray(np.minimum(np.where(later, self.stops[live], np.inf).min(axis=1), horizon))

    def leave(self, live: Index, start: Array, h: Array, ends: Array, values: Array) -> None:
        """Keep the waves (2, n, points) of a step of rows `live` that ends at theta = ends."""
        kept = np.flatnonzero(self.echoing[live])
        if len(kept) == 0:
            return
        rows = live[kept]
        if self.count[rows].max() >= self.start.shape[1]:
            self._grow()
        place = self.count[rows]
        self.start[rows, place], self.length[rows, place], self.span[rows, place] = start[kept], h[kept], ends[kept]
        self.values[rows, place] = np.moveaxis(values[:, kept], 0, 1)
        self.count[rows] += 1

    def _grow(self) -> None:
        n, room = self.start.shape
        self.start = np.concatenate([self.start, np.full((n, room), np.inf)], axis=1)
        self.length = np.concatenate([self.length, np.ones((n, room))], axis=1)
        self.span = np.concatenate([self.span, np.ones((n, room))], axis=1)
        self.values = np.concatenate([self.values, np.zeros_like(self.values)], axis=1)

    def read(self, rows: Index, bar: int, times: Array) -> Array:
        """Wave that left a face at `times` (n, points), which ascend along a row."""
        place = self.first[bar, rows]
        found = np.zeros_like(times)
        for i in range(times.shape[1]):
            while True:
                following = np.minimum(place + 1, self.count[rows] - 1)
                ahead = (following > place) & (self.start[rows, following] <= times[:, i])
                if not ahead.any():
                    break
                place = place + ahead
            if i == 0:
                self.first[bar, rows] = place
            theta = (times[:, i] - self.start[rows, place]) / self.length[rows, place]
            found[:, i] = _interpolate(self.values[rows, place, bar], theta)
        return found


def _interpolate(values: Array, theta: Array) -> Array:
    """Polynomials through values (n, points) at the Chebyshev points, at theta (n,)."""
    above, below = np.zeros_like(theta), np.zeros_like(theta)
    exact = np.full(len(theta), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        for k in range(_POINTS):
            gap = theta - _THETAS[k]
            exact = np.where(gap == 0.0, values[:, k], exact)
            share = _WEIGHTS[k] / gap
            above, below = above + share * values[:, k], below + share
        return np.where(np.isnan(exact), above / below, exact)


def _all_stops(breaks: Array, trips: Array, horizon: Array) -> tuple[Array, Index]:
    """Times of all jumps of the pulse and of what comes back, (n, k) ascending; rows that have too many."""
    n = len(horizon)
    found: list[list[float]] = []
    crowded = []
    for row in range(n):
        times = {float(b) for b in breaks[row] if 0.0 < b < np.inf}
        end = horizon[row]
        for trip in trips[row]:
            if not np.isfinite(trip) or not np.isfinite(end):
                continue
            if end / trip > _MOST_STOPS:
                crowded.append(row)
                break
            for k in range(1, int(end / trip) + 1):
                times |= {k * trip + b for b in breaks[row] if b < np.inf and k * trip + b <= end}
        found.append(sorted(times))
    width = max([1, *(len(times) for times in found)])
    stops = np.full((n, width), np.inf)
    for row, ascending in enumerate(found):
        stops[row, : len(ascending)] = ascending
    return stops, np.asarray(crowded, dtype=np.int64)


def _pulse(arguments: dict[str, Any], live: Index, start: Array, times: Array) -> Array:
    """f of the pulse at `times` (n, points) of steps that begin at `start` and cross no break."""
    breaks = arguments["breaks"][live]
    piece = (breaks <= (start + 1e-12 * (1.0 + start))[:, None]).sum(axis=1) - 1
    inside = piece < arguments["coefficients"].shape[1]
    piece = np.minimum(piece, arguments["coefficients"].shape[1] - 1)
    cubic = arguments["coefficients"][live, piece]
    z = times - breaks[np.arange(len(live)), piece][:, None]
    value = cubic[:, :1] + z * (cubic[:, 1:2] + z * (cubic[:, 2:3] + z * cubic[:, 3:]))
    frequency = arguments["frequencies"][live][:, None]
    value = np.where(frequency > 0.0, np.sin(frequency * times), value)
    return np.where(inside[:, None], value, 0.0)


def incoming(arguments: dict[str, Any], waves: Waves, live: Index, start: Array, times: Array) -> Array:
    """2 f at face A and -2 h at face B at `times`, (2, n, points): the waves that run towards the sphere."""
    push = np.stack([2.0 * _pulse(arguments, live, start, times), np.zeros_like(times)])
    for bar in range(2):
        trip = waves.trips[live, bar]
        back = np.flatnonzero(start >= trip * (1.0 - 1e-12))
        if len(back):
            rows = live[back]
            seen = waves.read(rows, bar, np.maximum(times[back] - trip[back][:, None], 0.0))
            push[bar, back] += 2.0 * waves.ends[rows, bar][:, None] * seen
    return push
