"""The equations of motion by collocation, in plain numpy: a second opinion on the compiled integrator.

Every step is a polynomial of degree 12 for each of the three states that satisfies theory (9), in its integrated
form, at the Chebyshev points of the step; Picard's iteration finds it.  The size of its last terms gives the
error.  Nothing is shared with the compiled integrator but the names of what goes in and comes out: not the
method, not the search for events, not the way in which waves that come back are read.

Rows advance together, each with its own time and step; all arithmetic is elementwise along the rows, so that the
answer of a row does not depend on the others.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt
from numpy.polynomial import chebyshev

from uqsphere.mechanics.integrator import tracked as layout
from uqsphere.mechanics.scene import Scene

if TYPE_CHECKING:
    from uqsphere.mechanics.integrator.solve import Scaled

__all__ = [
    "DEGREE",
    "THETAS",
    "TO_INTEGRALS",
    "TO_TERMS",
    "Waves",
    "apply",
    "crossing",
    "incoming",
    "integrate_plain",
    "march_plain",
    "tops",
    "value_at",
]

# --- The polynomials of the plain integrator's steps: values, slopes, tops and crossings, row by row.
# A step's motion is known by its values at Chebyshev points, or by its Chebyshev coefficients, its terms.

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

#: degree of a step's polynomials, and the points at which they satisfy the equations
DEGREE: Final = 12
_SIDES: Final = -np.cos(np.pi * np.arange(DEGREE + 1) / DEGREE)
THETAS: Final = 0.5 + 0.5 * _SIDES
#: values at the points to Chebyshev coefficients; values to integrals from the step's start to the points
TO_TERMS: Final = np.linalg.inv(chebyshev.chebvander(_SIDES, DEGREE))
TO_INTEGRALS: Final = np.stack(
    [0.5 * chebyshev.chebval(_SIDES, chebyshev.chebint(column, lbnd=-1.0)) for column in TO_TERMS.T], axis=1
)
#: points at which a step is looked at for events
_GRID: Final = np.linspace(0.0, 1.0, 33)
_TO_GRID: Final = chebyshev.chebvander(2.0 * _GRID - 1.0, DEGREE)
_TO_SLOPES: Final = np.stack(
    [chebyshev.chebval(2.0 * _GRID - 1.0, 2.0 * chebyshev.chebder(term)) for term in np.eye(DEGREE + 1)], axis=1
)
_SEARCHES: Final = 14


def apply(matrix: npt.NDArray[np.floating[Any]], values: npt.NDArray[np.floating[Any]]) -> Array:
    """Every row of `values` (n, m) times `matrix` (k, m), term after term: (n, k), the same bits for any n."""
    total = values[:, :1] * matrix[None, :, 0]
    for j in range(1, matrix.shape[1]):
        total = total + values[:, j : j + 1] * matrix[None, :, j]
    return np.asarray(total, dtype=float)


def value_at(terms: Array, theta: Array) -> Array:
    """Chebyshev series (n, 13), one per row, at theta (n,) of the step."""
    side = 2.0 * theta - 1.0
    high, higher = np.zeros_like(side), np.zeros_like(side)
    for k in range(DEGREE, 0, -1):
        high, higher = terms[:, k] + 2.0 * side * high - higher, high
    return np.asarray(terms[:, 0] + side * high - higher)


def _derivative(terms: Array) -> Array:
    """Series of the derivatives by theta."""
    slopes = np.zeros_like(terms)
    for k in range(DEGREE - 1, -1, -1):
        above = slopes[:, k + 2] if k + 2 <= DEGREE else 0.0
        slopes[:, k] = above + 2.0 * (k + 1.0) * terms[:, k + 1]
    slopes[:, 0] *= 0.5
    return 2.0 * slopes


def _root(terms: Array, low: Array, high: Array) -> Array:
    """Where series change sign between low and high, (n,): regula falsi with the Illinois rule."""
    at_low, at_high = value_at(terms, low), value_at(terms, high)
    for _ in range(_SEARCHES):
        with np.errstate(divide="ignore", invalid="ignore"):
            middle = high - at_high * (high - low) / (at_high - at_low)
        inside = (middle >= np.minimum(low, high)) & (middle <= np.maximum(low, high))
        middle = np.where(inside, middle, 0.5 * (low + high))
        at = value_at(terms, middle)
        crossed = (at < 0.0) != (at_high < 0.0)
        low, at_low = np.where(crossed, high, low), np.where(crossed, at_high, 0.5 * at_low)
        high, at_high = middle, at
    return high


def tops(terms: Array, above: Array, ends: Array) -> tuple[Index, Array, Array]:
    """Local maxima of series before `ends` that may exceed `above` (n,): rows, theta, values."""
    grid, bends = apply(_TO_GRID, terms), apply(_TO_SLOPES, terms)
    width = _GRID[1]
    turns = (bends[:, :-1] > 0.0) & (bends[:, 1:] <= 0.0) & (_GRID[None, :-1] < ends[:, None])
    # a bend rises by less than its slopes would in the whole of its part
    reach = np.maximum(grid[:, :-1] + bends[:, :-1] * width, grid[:, 1:] - bends[:, 1:] * width)
    found, part = np.nonzero(turns & (reach >= above[:, None]))
    if len(found) == 0:
        return found, np.zeros(0), np.zeros(0)
    theta = np.minimum(_root(_derivative(terms[found]), _GRID[part], _GRID[part + 1]), ends[found])
    return found, theta, value_at(terms[found], theta)


def crossing(terms: Array, level: Array, falling: bool, begin: Array) -> Array:
    """First theta after `begin` at which a series passes `level` downwards (or upwards), NaN if it does not."""
    sign = -1.0 if falling else 1.0
    moved = terms * sign
    moved[:, 0] -= sign * level
    grid = apply(_TO_GRID, moved)
    passed = (grid >= 0.0) & (_GRID[None, :] > begin[:, None])
    first = np.where(passed.any(axis=1), passed.argmax(axis=1), len(_GRID))
    # theta by which a value above the level is known, on the grid or at the top of a bend between its points
    known = np.where(first < len(_GRID), _GRID[np.minimum(first, len(_GRID) - 1)], np.inf)
    found, theta, values = tops(moved, np.zeros(len(terms)), np.ones(len(terms)))
    reached = (values >= 0.0) & (theta > begin[found])
    np.minimum.at(known, found[reached], theta[reached])
    answer = np.full(len(terms), np.nan)
    picked = np.flatnonzero(np.isfinite(known))
    if len(picked) == 0:
        return answer
    high = known[picked]
    low = np.maximum(np.maximum(np.ceil(high * (len(_GRID) - 1) - 1e-9) - 1.0, 0.0) / (len(_GRID) - 1), begin[picked])
    already = value_at(moved[picked], low) >= 0.0
    answer[picked] = np.where(already, low, _root(moved[picked], low, high))
    return answer


# --- Waves of the plain integrator: the pulse, the waves that come back, the times at which something jumps.

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


_ROUNDS: Final = 60
_MOST_STEPS: Final = 400_000
_HALF: Final = 2.0 / 3.0


@dataclass(kw_only=True)
class _Rows:
    """State of all rows, (n,) each, and what has been found of them so far."""

    time: Array
    x: Array
    u: Array
    free: npt.NDArray[np.bool_]
    step: Array
    size_x: Array
    size_u: Array
    touched: npt.NDArray[np.bool_]
    top: Array
    difference: Array
    energy: Array
    first: Array
    lost: Array
    ended: Array
    taken: Index
    path: list[tuple[Index, Array, Array, Array]] = field(default_factory=list)


def _force(mode: int, x: Array) -> Array:
    pressed = np.maximum(x, 0.0)
    return pressed if mode == 1 else pressed * np.sqrt(pressed)


def _slopes(mode: int, mu: Array, push: Array, x: Array, u: Array, free: npt.NDArray[np.bool_]) -> tuple[Array, Array]:
    """Right-hand sides of theory (9) at the points: x (2, n, 13), u (n, 13); push (2, n, 13) = 2 f, -2 h."""
    force = np.where(free[:, :, None], 0.0, _force(mode, x))
    if mode == 2:
        rate = 0.5 * (push[0] + push[1]) - force[0]
        return np.stack([rate, rate]), np.zeros_like(u)
    return np.stack([push[0] - force[0] - u, push[1] - force[1] + u]), (force[0] - force[1]) / mu


def _collocate(
    mode: int, mu: Array, h: Array, push: Array, x0: Array, u0: Array, free: npt.NDArray[np.bool_], allowed: Array
) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """Picard's iteration over one step of every row: states at the points, and whether it has converged."""
    x = np.repeat(x0[:, :, None], DEGREE + 1, axis=2)
    u = np.repeat(u0[:, None], DEGREE + 1, axis=1)
    done = np.zeros(len(h), dtype=bool)
    last = np.full(len(h), np.inf)
    for _ in range(_ROUNDS):
        rate_x, rate_u = _slopes(mode, mu, push, x, u, free)
        new_x = np.stack([x0[face, :, None] + h[:, None] * apply(TO_INTEGRALS, rate_x[face]) for face in range(2)])
        new_u = u0[:, None] + h[:, None] * apply(TO_INTEGRALS, rate_u)
        change = np.abs(new_x - x).max(axis=(0, 2))
        # a row that has converged, or runs away, keeps what it has: its bits must not depend on the others
        moving = ~done & (change < 1e6)
        x, u = np.where(moving[None, :, None], new_x, x), np.where(moving[:, None], new_u, u)
        done = done | (moving & (change <= allowed) & (change <= last))
        last = change
        if not (moving & ~done).any():
            break
    return x, u, done


def _measure(mode: int, wanted: int, rows: _Rows, live: Index, terms: Array, ends: Array) -> None:
    """Bring the largest approach, difference and energy up to date with the steps up to `ends`."""
    top = rows.top[live]
    for face in range(2):
        for theta in (np.zeros_like(ends), ends):
            top = np.maximum(top, value_at(terms[face], theta))
        found, _, values = tops(terms[face], top, ends)
        np.maximum.at(top, found, values)
    rows.top[live] = top
    if wanted & (layout.WANT_DIFFERENCE | layout.WANT_ENERGY):
        _measure_forces(mode, rows, live, terms, ends)


def _both(mode: int, terms: Array, theta: Array) -> tuple[Array, Array]:
    """Difference of the forces and stored energy at theta."""
    x = np.stack([np.maximum(value_at(terms[face], theta), 0.0) for face in range(2)])
    force = _force(mode, x)
    return np.abs(force[0] - force[1]), (0.5 if mode == 1 else 0.4) * (x[0] * force[0] + x[1] * force[1])


def _measure_forces(mode: int, rows: _Rows, live: Index, terms: Array, ends: Array) -> None:
    """Largest difference and energy: the best of a fine grid, then a golden-section search beside it."""
    fine = np.linspace(0.0, 1.0, 33)
    found = [_both(mode, terms, point * ends) for point in fine]
    golden = 0.5 * (np.sqrt(5.0) - 1.0)
    for kind, kept in enumerate((rows.difference, rows.energy)):
        grid = np.stack([pair[kind] for pair in found], axis=1)
        place = grid.argmax(axis=1)
        low, high = fine[np.maximum(place - 1, 0)] * ends, fine[np.minimum(place + 1, len(fine) - 1)] * ends
        best = grid.max(axis=1)
        likely = np.flatnonzero(best > 0.98 * kept[live])
        low, high, part = low[likely], high[likely], terms[:, likely]
        if len(likely) == 0:
            continue
        for _ in range(30):
            left, right = high - golden * (high - low), low + golden * (high - low)
            at_left, at_right = _both(mode, part, left)[kind], _both(mode, part, right)[kind]
            low, high = np.where(at_left < at_right, left, low), np.where(at_left < at_right, high, right)
        best[likely] = np.maximum(best[likely], _both(mode, part, 0.5 * (low + high))[kind])
        kept[live] = np.maximum(kept[live], best)


def _level_times(rows: _Rows, level: Array, last: bool, n: int) -> Array:
    """Time at which the larger approach first reaches `level` (n,), or falls below it for the last time."""
    answer = np.full(n, np.nan)
    for live, start, length, states in reversed(rows.path) if last else rows.path:
        open_rows = np.isnan(answer[live]) & (start < rows.ended[live])
        span = np.minimum(length, rows.ended[live] - start) / length
        for face in range(2):
            terms = apply(TO_TERMS, states[face])
            if last:
                # the way back: the same series, read from its end
                terms = terms * np.where(np.arange(DEGREE + 1) % 2 == 1, -1.0, 1.0)[None, :]
            at = crossing(terms, level[live], False, 1.0 - span if last else np.zeros(len(live)))
            at = np.where(value_at(terms, 1.0 - span if last else np.zeros(len(live))) >= level[live],
                          1.0 - span if last else 0.0, at)  # fmt: skip
            at = np.where(at <= 1.0 if last else at <= span, at, np.nan)
            time = start + length * (1.0 - at if last else at)
            better = open_rows & ~np.isnan(time)
            known = answer[live]
            best = np.fmax(known, time) if last else np.fmin(known, time)
            answer[live] = np.where(better, best, known)
    return answer


def _finish(mode: int, wanted: int, rows: _Rows, answers: Array, status: Index) -> None:
    n = len(status)
    good = status == 0
    lost = ~np.isnan(rows.lost)
    power = 1.0 if mode == 1 else _HALF
    answers[good, layout.ANSWER_X_MAX] = rows.top[good]
    answers[good, layout.ANSWER_X_FIRST] = rows.first[good]
    answers[good, layout.ANSWER_DIFFERENCE] = rows.difference[good]
    answers[good, layout.ANSWER_ENERGY] = rows.energy[good]
    answers[good, layout.ANSWER_END] = rows.ended[good]
    answers[good, layout.ANSWER_CONTACT] = np.where(lost, rows.lost, rows.ended)[good]
    answers[good, layout.ANSWER_CONTACT_CENSORED] = np.where(lost, 0.0, 1.0)[good]
    if wanted & layout.WANT_WIDTH:
        half = rows.top * 0.5**power
        above, below = (_level_times(rows, half, last, n) for last in (False, True))
        answers[good, layout.ANSWER_WIDTH] = (below - above)[good]
        answers[good, layout.ANSWER_WIDTH_CENSORED] = (below >= rows.ended * (1.0 - 1e-12))[good]
    if wanted & layout.WANT_RISE:
        tenth, nine = (_level_times(rows, rows.top * share**power, False, n) for share in (0.1, 0.9))
        answers[good, layout.ANSWER_RISE] = (nine - tenth)[good]


def _events(
    mode: int, arguments: dict[str, Any], rows: _Rows, live: Index, terms: Array, start: Array, h: Array, local: float
) -> tuple[Array, Index, npt.NDArray[np.bool_]]:
    """First event of each step: theta at which it ends, 2 + face for a loss or a touch, whether the record ends."""
    n = len(live)
    ends, why, over = np.ones(n), np.zeros(n, dtype=np.int64), np.zeros(n, dtype=bool)
    for face in range(2):
        free = rows.free[face, live]
        # a face that has just left, or just touched, is clear of zero a little later
        clear = np.where(np.abs(rows.x[face, live]) <= 1e-13 * rows.size_x[live], 1e-6, 0.0)
        for falling, chosen in ((True, ~free & rows.touched[face, live]), (False, free)):
            picked = np.flatnonzero(chosen)
            if len(picked) == 0:
                continue
            at = crossing(terms[face][picked], np.zeros(len(picked)), falling, clear[picked])
            earlier = picked[at < ends[picked]]
            why[earlier] = 2 + face
            ends[earlier] = at[at < ends[picked]]
    tail = np.isinf(arguments["horizon"][live]) & (start >= arguments["pulse_end"][live] * (1.0 - 1e-12))
    if tail.any():
        share = layout.TAIL_SHARE if mode == 1 else layout.TAIL_SHARE**_HALF
        low = share * rows.top[live]
        below = np.zeros(n)
        for _ in range(8):  # while one face falls below, the other may rise again
            for face in range(2):
                at = crossing(terms[face], low, True, np.nan_to_num(below, nan=2.0))
                under = value_at(terms[face], np.nan_to_num(below, nan=1.0)) <= low * (1.0 + 1e-12)
                below = np.where(np.isnan(below) | under, below, at)
        ending = tail & (below <= ends)
        ends, over = np.where(ending, below, ends), ending
    return ends, why, over


def march_plain(arguments: dict[str, Any], mode: int, tolerance: float, wanted: int) -> tuple[Array, Index, Index]:
    """Integrate all rows of `arguments` (see dynamics): answers (n, layout.ANSWERS), status (n,), steps (n,)."""
    n = len(arguments["mass"])
    local = 0.02 * tolerance
    zeros = np.zeros(n)
    rows = _Rows(
        time=zeros.copy(), x=np.zeros((2, n)), u=zeros.copy(), free=np.zeros((2, n), dtype=bool),
        step=np.full(n, 1e-3) * arguments["level"], size_x=arguments["level"].copy(), size_u=0.1 * arguments["level"],
        touched=np.zeros((2, n), dtype=bool), top=zeros.copy(), difference=zeros.copy(), energy=zeros.copy(),
        first=zeros.copy(), lost=np.full(n, np.nan), ended=np.full(n, np.nan), taken=np.zeros(n, dtype=np.int64),
    )  # fmt: skip
    waves = Waves.begin(arguments)
    answers, status = layout.empty_answers(n), np.zeros(n, dtype=np.int64)
    status[waves.crowded] = layout.CROWDED
    live = np.flatnonzero(status == 0)
    while len(live):
        live = _advance(mode, wanted, arguments, rows, waves, status, live, local)
    _finish(mode, wanted, rows, answers, status)
    return answers, status, rows.taken


def _advance(
    mode: int, wanted: int, arguments: dict[str, Any], rows: _Rows, waves: Waves, status: Index, live: Index,
    local: float,
) -> Index:  # fmt: skip
    """One step of every live row; the rows that are still live after it."""
    start = rows.time[live]
    left = waves.next_stop(live, start, arguments["horizon"][live]) - start
    h = np.minimum(np.minimum(rows.step[live], left), waves.trips[live].min(axis=1))
    h = np.where(h >= 0.999999 * left, left, np.where(2.0 * h > left, 0.5 * left, h))
    times = start[:, None] + h[:, None] * THETAS[None, :]
    push = incoming(arguments, waves, live, start, times)
    free = rows.free[:, live]
    mu = arguments["mass"][live][:, None]
    allowed = 1e-2 * local * rows.size_x[live]
    x, u, done = _collocate(mode, mu, h, push, rows.x[:, live], rows.u[live], free, allowed)
    terms = np.stack([apply(TO_TERMS, x[face]) for face in range(2)])
    terms_u = apply(TO_TERMS, u)
    missing = np.abs(terms[:, :, -2:]).sum(axis=2).max(axis=0) / rows.size_x[live]
    missing = np.maximum(missing, np.abs(terms_u[:, -2:]).sum(axis=1) / rows.size_u[live]) / local
    with np.errstate(divide="ignore", invalid="ignore"):
        growth = np.clip(0.85 * np.maximum(missing, 1e-30) ** (-1.0 / DEGREE), 0.2, 4.0)
    good = done & (missing <= 1.0)
    rows.step[live] = h * np.where(good, growth, np.where(done, np.minimum(growth, 0.7), 0.4))
    rows.taken[live] += 1
    stuck = (rows.step[live] < 1e-14 * (1.0 + start)) | (rows.taken[live] > _MOST_STEPS)
    status[live[stuck & ~good]] = layout.STUCK
    kept = np.flatnonzero(good)
    if len(kept):
        _accept(mode, wanted, arguments, rows, waves, live[kept], start[kept], h[kept], left[kept], push[:, kept],
                x[:, kept], terms[:, kept], terms_u[kept], local)  # fmt: skip
    return np.asarray(live[np.isnan(rows.ended[live]) & (status[live] == 0)])


def _accept(
    mode: int, wanted: int, arguments: dict[str, Any], rows: _Rows, waves: Waves, live: Index, start: Array, h: Array,
    left: Array, push: Array, x: Array, terms: Array, terms_u: Array, local: float,
) -> None:  # fmt: skip
    """Take finished steps over: events, trackers, waves that leave, the state at their ends."""
    ends, why, over = _events(mode, arguments, rows, live, terms, start, h, local)
    _measure(mode, wanted, rows, live, terms, ends)
    force = np.where(rows.free[:, live][:, :, None], 0.0, _force(mode, x))
    waves.leave(live, start, h, ends, 0.5 * push - force)
    if wanted & (layout.WANT_RISE | layout.WANT_WIDTH):
        rows.path.append((live, start, h, x))
    early = start < waves.trips[live].min(axis=1) * (1.0 - 1e-12)
    rows.first[live] = np.where(early, rows.top[live], rows.first[live])
    full = ends >= 1.0
    time = np.where(full & (h == left), start + left, start + ends * h)
    lost = (why >= 2) & ~rows.free[np.maximum(why - 2, 0), live]
    rows.lost[live] = np.where(lost, time, rows.lost[live])
    rows.time[live] = time
    for face in range(2):
        at = value_at(terms[face], ends)
        rows.x[face, live] = np.where(why == 2 + face, 0.0, at)
        rows.free[face, live] ^= why == 2 + face
        rows.touched[face, live] |= at > 50.0 * local * rows.size_x[live]
    if mode == 2:
        rows.x[1, live] = rows.x[0, live]
    rows.u[live] = value_at(terms_u, ends)
    rows.size_x[live] = np.maximum(rows.size_x[live], np.abs(rows.x[:, live]).max(axis=0))
    rows.size_u[live] = np.maximum(rows.size_u[live], np.abs(rows.u[live]))
    finished = lost | over | (time >= arguments["horizon"][live] * (1.0 - 1e-14))
    finished |= _nothing_left(mode, wanted, arguments, rows, waves, live)
    rows.ended[live] = np.where(finished, time, rows.ended[live])


def _nothing_left(
    mode: int, wanted: int, arguments: dict[str, Any], rows: _Rows, waves: Waves, live: Index
) -> npt.NDArray[np.bool_]:
    """Whether the largest approach is all that is wanted and the energy that is left cannot exceed it."""
    if mode == 1 or wanted & ~layout.WANT_RISE:
        return np.zeros(len(live), dtype=bool)
    quiet = (rows.time[live] >= arguments["pulse_end"][live]) & np.isinf(waves.trips[live]).all(axis=1)
    pressed = np.maximum(rows.x[:, live], 0.0)
    energy = 0.4 * (pressed * pressed * np.sqrt(pressed)).sum(axis=0)
    energy += 0.5 * arguments["mass"][live] * rows.u[live] ** 2
    return np.asarray(quiet & ((2.5 * energy) ** 0.4 <= rows.top[live]))


def integrate_plain(
    scene: Scene,
    *,
    fidelity: str = "full",
    tolerance: float = 1e-6,
    threads: int | None = None,
    quantities: Collection[str] | None = None,
) -> Scaled:
    """The same as `integrate` of the compiled integrator, by collocation; contacts left undecided have no status.

    threads is accepted and not used.
    """
    from uqsphere.mechanics.integrator.solve import MODES, Scaled, scaled_arguments
    from uqsphere.mechanics.outputs import wishes

    status = scene.status.copy()
    rows = np.flatnonzero(status == 0)
    answers, steps = layout.empty_answers(len(scene)), np.zeros(len(scene), dtype=np.int64)
    if len(rows):
        with np.errstate(over="ignore", invalid="ignore"):
            answers[rows], status[rows], steps[rows] = march_plain(
                scaled_arguments(scene, rows), MODES[fidelity], tolerance, wishes(quantities)
            )
    return Scaled(answers=answers, others=layout.empty_answers(len(scene)), status=status, steps=steps)
