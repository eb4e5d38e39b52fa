"""A second opinion on one scene: implicit collocation in extended precision, sharing nothing but the equations."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.scene import Scene

# --- One step of the reference integrator: implicit collocation at 20 Radau points in extended precision.
# Over a step the state X = (x_1, x_2, u) is a polynomial of degree 20 that satisfies the equations of motion at
# the points c_1 ... c_20 = 1 of the right Radau rule (E. Hairer, G. Wanner, Solving Ordinary Differential Equations
# II, 1996, section IV.5), in the integrated form
#
# X(c_i) = X(0) + h sum of a_ij F(c_j)
#
# solved by Newton's method: matrix in double, residual in `numpy.longdouble`, so that every iteration gains the
# digits that the matrix is good for.  The method is implicit and damps what it does not resolve, so a step may
# be long where a stiff oscillation has died out; where it has not, the Chebyshev coefficients of the step do not
# fall off and the step is refused.  Nothing is shared with the batch integrator but the equations.
#
# Where the motion has a power t^(3/2) or t^(7/2) at the start of a step, the step is taken in sigma, t = h sigma^m.

Array = npt.NDArray[Any]
Long = np.longdouble

#: collocation points of a step
NODES: Final = 20
#: last coefficients of an accepted step over the largest value of the state so far: extended precision, or the
#: best that this machine's longest float gives
TAIL: Final[float] = max(1e-16, 30.0 * float(np.finfo(Long).eps))
_ITERATIONS: Final = 14


def chebyshev(theta: Array, degree: int = NODES) -> Array:
    """T_0 ... T_degree of 2 theta - 1, (len(theta), degree + 1)."""
    z = 2.0 * np.asarray(theta, dtype=Long) - 1.0
    values = np.empty((len(z), degree + 1), dtype=Long)
    values[:, 0], values[:, 1] = 1.0, z
    for k in range(2, degree + 1):
        values[:, k] = 2.0 * z * values[:, k - 1] - values[:, k - 2]
    return values


def _legendre(z: Array, degree: int) -> tuple[Array, Array]:
    """P_degree and its derivative inside (-1, 1)."""
    before, value = np.ones_like(z), z.copy()
    for k in range(2, degree + 1):
        before, value = value, ((2 * k - 1) * z * value - (k - 1) * before) / k
    return value, degree * (z * value - before) / (z * z - 1.0)


def _radau() -> Array:
    """Points of the right Radau rule on (0, 1]: the roots of P_(n-1) - P_n, of which 1 is the last."""
    series = np.zeros(NODES + 1)
    series[NODES - 1], series[NODES] = 1.0, -1.0
    z = np.sort(np.polynomial.legendre.legroots(series))[:-1].astype(Long)
    for _ in range(4):
        one, two = _legendre(z, NODES - 1), _legendre(z, NODES)
        z -= (one[0] - two[0]) / (one[1] - two[1])
    return np.append(0.5 * (1.0 + z), Long(1.0))


def _inverse(matrix: Array) -> Array:
    """Inverse in extended precision: that of double, improved three times by X (2 - M X)."""
    found = np.linalg.inv(matrix.astype(float)).astype(Long)
    two = 2.0 * np.eye(len(matrix), dtype=Long)
    for _ in range(3):
        found = found @ (two - matrix @ found)
    return found


def _integrals(theta: Array, degree: int) -> Array:
    """Integrals of T_0 ... T_degree of 2 theta - 1 from 0 to theta."""
    upper, lower = chebyshev(theta, degree + 1), chebyshev(np.zeros(1), degree + 1)
    values = np.empty((len(theta), degree + 1), dtype=Long)
    values[:, 0] = theta
    values[:, 1] = 0.125 * (upper[:, 2] - lower[:, 2])
    for k in range(2, degree + 1):
        rise = upper - lower
        values[:, k] = 0.25 * (rise[:, k + 1] / (k + 1) - rise[:, k - 1] / (k - 1))
    return values


def _slopes(theta: Array) -> Array:
    """Derivatives by theta of T_0 ... T_NODES of 2 theta - 1."""
    return _both(theta)[1]


def _both(theta: Array) -> tuple[Array, Array]:
    """T_0 ... T_NODES of 2 theta - 1 and their derivatives by theta."""
    values = chebyshev(theta)
    slopes = np.zeros_like(values)
    slopes[:, 1] = 2.0
    slopes[:, 2] = 4.0 * values[:, 1] * 2.0
    for k in range(3, NODES + 1):  # T_k' = 2k T_(k-1) + k/(k-2) T_(k-2)', by z
        slopes[:, k] = 4.0 * k * values[:, k - 1] + k / Long(k - 2) * slopes[:, k - 2]
    return values, slopes


POINTS: Final = _radau()
#: values at 0 and the points -> Chebyshev coefficients
TO_SERIES: Final = _inverse(chebyshev(np.append(Long(0.0), POINTS)))
#: a_ij of the collocation
WEIGHTS: Final = _integrals(POINTS, NODES - 1) @ _inverse(chebyshev(POINTS, NODES - 1))
_WEIGHTS_DOUBLE: Final = WEIGHTS.astype(float)
#: where a step is looked at for events
FINE: Final = np.linspace(0.0, 1.0, 61).astype(Long)
FINE_BASIS: Final = chebyshev(FINE)
FINE_SLOPES: Final = _slopes(FINE)


@dataclass(frozen=True, kw_only=True)
class Piece:
    """The motion over one step: t = start + length theta^power, 0 <= theta <= 1, scaled time.

    `states` (NODES + 1, 3) are the Chebyshev coefficients of x_1, x_2, u, `waves` (NODES + 1, 2) those of the
    waves g_A and k_B that leave the faces, `tail` the size of the last coefficients over that of the state.
    """

    start: Any
    length: Any
    power: int
    states: Array
    waves: Array
    tail: float
    expected: float

    def share(self, times: Array) -> Array:
        """theta at `times`."""
        passed = np.maximum((times - self.start) / self.length, 0.0)
        return np.asarray(passed if self.power == 1 else passed ** (Long(1.0) / self.power))

    def time(self, theta: Any) -> Any:
        """Time at theta."""
        return self.start + self.length * Long(theta) ** self.power


def evaluate(series: Array, theta: Any) -> tuple[Array, Array]:
    """Values and derivatives by theta of Chebyshev series (NODES + 1, columns) at one theta, (columns,)."""
    values, slopes = _both(np.array([theta], dtype=Long))
    return (values @ series)[0], (slopes @ series)[0]


def _matrix(roots: Array, weights: Array, mass: float) -> Array:
    """Newton's matrix of a step: one minus h a_ij times the Jacobian at the points."""
    n = NODES
    matrix = np.eye(3 * n)
    mix = _WEIGHTS_DOUBLE * weights
    slopes = 1.5 * roots
    a, b = mix * slopes[:, 0], mix * slopes[:, 1]
    matrix[:n, :n] += a
    matrix[:n, 2 * n :] = mix
    matrix[n : 2 * n, n : 2 * n] += b
    matrix[n : 2 * n, 2 * n :] = -mix
    matrix[2 * n :, :n] = -a / mass
    matrix[2 * n :, n : 2 * n] = b / mass
    return matrix


def collocate(
    begin: Array, guess: Array, push: Array, start: Any, length: Any, power: int, mass: Any, sizes: Array
) -> Piece | None:
    """Solve the equations of motion over one step; None if Newton's method does not converge.

    begin (3,): state at the start.  guess (NODES, 3): first guess at the points.  push (NODES + 1, 2): the waves
    f and h at the start and the points.  sizes (3,): largest values of the states so far.
    """
    from scipy.linalg import lapack

    weights = length * power * POINTS ** (power - 1)
    state, factors, before = guess.copy(), None, np.inf
    for iteration in range(_ITERATIONS):
        pressed = np.maximum(state[:, :2], 0.0)
        roots = np.sqrt(pressed)
        force = pressed * roots
        rates = np.empty_like(state)
        rates[:, 0] = 2.0 * push[1:, 0] - force[:, 0] - state[:, 2]
        rates[:, 1] = state[:, 2] - force[:, 1] - 2.0 * push[1:, 1]
        rates[:, 2] = (force[:, 0] - force[:, 1]) / mass
        residual = (begin + WEIGHTS @ (weights[:, None] * rates) - state).astype(float)
        if not np.isfinite(residual).all():
            return None
        if factors is None:
            lu, pivots, _ = lapack.dgetrf(_matrix(roots.astype(float), weights.astype(float), float(mass)))
            factors = (lu, pivots)
        change = lapack.dgetrs(*factors, residual.T.ravel())[0].reshape(3, NODES).T
        state = state + change
        scale = np.maximum(sizes, np.abs(state).max(axis=0)) + Long(1e-300)
        moved = float((np.abs(change) / scale).max())
        if moved < 0.01 * TAIL or (moved < TAIL and moved > 0.2 * before):
            break
        if moved > 0.05 * before or iteration < 2:
            factors = None
        before = moved
    else:
        return None
    full = np.concatenate([begin[None, :], state])
    series = TO_SERIES @ full
    pressed = np.maximum(full[:, :2], 0.0)
    force = pressed * np.sqrt(pressed)
    waves = TO_SERIES @ np.stack([push[:, 0] - force[:, 0], force[:, 1] + push[:, 1]], axis=1)
    tail = float((np.abs(series[-2:]).max(axis=0) / scale).max())
    middle = float((np.abs(series[NODES // 2 - 1 : NODES // 2 + 2]).max(axis=0) / scale).max())
    return Piece(
        start=start, length=length, power=power, states=series, waves=waves,
        tail=tail, expected=max(1e-30, min(tail, 1e2 * middle * middle)),
    )  # fmt: skip


# --- What happens in the steps of the reference: peaks, contact that is lost, thresholds, the end of the record.
# Steps are looked at on a grid of 61 points, and between them where a slope changes its sign.

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


# --- The reference: one scene at a time, by a method of its own, to about 1e-15.
# It solves theory (9) for the full model, with every pulse and every end of the bars, and answers all quantities
# that `uqsphere.mechanics.integrator.solve` answers.  It is slow (a tenth of a second to ten seconds a scene) and it
# says so when a scene would take more steps than it may: no answer rather than a doubtful one.
#
# Steps are those of `tests.independent.reference`.  A step ends where the pulse, or a reflection of it, jumps or
# bends, and begins there in powers of the root of time.  Waves that come back are read off the steps on which they
# left.  A face that lets go needs no search: as x goes to zero x^(3/2) loses its smoothness, so the steps shorten
# towards that moment by themselves, and the crossing is read off the last one.

#: forces below this share of the largest end the record on infinite bars
_TAIL_SHARE: Final = Long("0.01")
#: tail of the coefficients that the choice of the next step aims at
_AIM: Final = 0.1 * TAIL
#: reflections weaker than this are not worth a step's end
_FAINT: Final = 1e-19
#: what the largest state so far counts beside that of the step, when its error is judged
_MEMORY: Final = 0.01
_MOST_JUMPS: Final = 20_000


class Unaffordable(RuntimeError):
    """The scene needs more steps, or has more reflections, than the reference may take."""


@dataclass(frozen=True, kw_only=True)
class Problem:
    """One scene in scaled variables, theory (8) to (10), in extended precision.

    breaks (m + 1,), cubics (m, 4), frequency: the pulse.  trips, ends (2,): round trips and reflection
    coefficients of the bars.  record: its end, infinite for the rule of infinite bars.
    """

    mass: Any
    breaks: Array
    cubics: Array
    frequency: Any
    trips: Array
    ends: Array
    record: Any

    def pulse(self, times: Array) -> Array:
        """f_in at times that lie between two neighbouring breaks, ends included."""
        middle = 0.5 * (times[0] + times[-1])
        piece = int(np.searchsorted(self.breaks, middle, side="right")) - 1
        if piece >= len(self.cubics):
            return np.zeros_like(times)
        if self.frequency > 0.0:
            return np.asarray(np.sin(self.frequency * times))
        local = times - self.breaks[piece]
        c = self.cubics[piece]
        return np.asarray(c[0] + local * (c[1] + local * (c[2] + local * c[3])))

    @property
    def first_echo(self) -> Any:
        """Time at which the first reflected wave is back; infinite if none is."""
        return np.where(self.ends != 0.0, self.trips, Long(np.inf)).min()


def problem_of(scene: Scene, row: int) -> Problem:
    """One row of a scene in scaled variables, from its columns by the formulas of the theory."""
    c = {name: Long(column[row]) for name, column in scene.columns.items()}
    bar = (1 - c["bars.nu"] ** 2) / c["bars.E"]
    modulus = 1 / ((1 - c["sphere.nu"] ** 2) / c["sphere.E"] + (0 if scene.rigid_contact else bar))
    radius = 1 / (1 / c["sphere.radius"] + 1 / c.get("bars.end_radius", Long(np.inf)))
    pi = Long(4) * np.arctan(Long(1))
    impedance = np.sqrt(c["bars.density"] * c["bars.E"]) * pi * c["bars.diameter"] ** 2 / 4
    speed = c["striker.speed"]
    stiffness = modulus * np.sqrt(radius) * 4 / 3
    approach = (impedance * speed / (2 * stiffness)) ** (Long(2) / 3)
    time = 2 * approach / speed
    trips = scene.round_trips[row].astype(Long) / time
    ends = scene.reflections[row].astype(Long)
    pulse = scene.pulse
    return Problem(
        mass=4 * pi / 3 * c["sphere.radius"] ** 3 * c["sphere.density"] / (impedance * time),
        breaks=pulse.breaks[row].astype(Long) / time,
        cubics=pulse.coefficients[row].astype(Long) * time ** np.arange(4),
        frequency=Long(pulse.frequency[row]) * time,
        trips=np.where(ends != 0.0, trips, Long(np.inf)),
        ends=ends,
        record=Long(scene.record_end[row]) / time,
    )


def _jumps(problem: Problem, most: Any) -> list[tuple[Any, bool]]:
    """Ends of steps that are due before `most`: time, and whether a wave comes back there."""
    reach: list[list[Any]] = []
    for trip, end in zip(problem.trips, problem.ends, strict=True):
        weight, shift = 1.0, Long(0)
        shifts: list[Any] = []
        while weight > _FAINT and shift < most and len(shifts) < _MOST_JUMPS:
            shifts.append(shift)
            weight, shift = weight * abs(float(end)), shift + trip
        reach.append(shifts)
    if len(reach[0]) * len(reach[1]) > 50 * _MOST_JUMPS:
        raise Unaffordable("too many reflections")
    edges = [Long(0), *(edge for edge in problem.breaks[1:] if np.isfinite(edge))]
    times = sorted(
        (one + two + edge, bool(one + two > 0)) for one in reach[0] for two in reach[1] for edge in edges
        if 0 < one + two + edge < most
    )  # fmt: skip
    found: list[tuple[Any, bool]] = []
    for time, echo in times:
        if found and time - found[-1][0] < 1e-15 * time:
            found[-1] = (found[-1][0], found[-1][1] or echo)
        else:
            found.append((time, echo))
    if len(found) > _MOST_JUMPS:
        raise Unaffordable("too many reflections")
    return found


def _returning(course: Course, starts: list[Any], bar: int, times: Array, trip: Any) -> Array:
    """g_A (bar 0) or k_B (bar 1) one round trip before `times`."""
    left = times - trip
    span = left[-1] - left[0]
    inside = np.clip(left, left[0] + 1e-6 * span, left[-1] - 1e-6 * span)
    pieces = np.searchsorted(np.array(starts), inside, side="right") - 1
    values = np.empty_like(times)
    for index in np.unique(pieces):
        here = pieces == index
        piece = course.pieces[index]
        values[here] = chebyshev(piece.share(left[here])) @ piece.waves[:, bar]
    return values


def follow(problem: Problem, *, budget: int = 20_000) -> Course:
    """Integrate one scene over its record.

    Raises
    ------
    Unaffordable
        If that takes more than `budget` steps.
    """
    course = Course()
    starts: list[Any] = []
    jumps = _jumps(problem, min(problem.record, Long(1e9) if np.isinf(problem.record) else problem.record))
    shortest = problem.trips.min()
    pulse_end = problem.breaks[-1]
    time, state, sizes, power, at_jump = Long(0), np.zeros(3, dtype=Long), np.zeros(3, dtype=Long), 4, 0
    length = Long(1e-3) * min(Long(1), np.sqrt(problem.mass), problem.breaks[1])
    known = np.zeros(4, dtype=Long)
    refused, worst = 0, np.inf
    for _ in range(budget):
        jump, echo = jumps[at_jump] if at_jump < len(jumps) else (problem.record, False)
        left = jump - time
        length = min(length, shortest)
        length = left if length > 0.99 * left else (left / 2 if length > left / 2 else length)
        times = time + length * np.append(Long(0), POINTS) ** power
        push = np.zeros((NODES + 1, 2), dtype=Long)
        push[:, 0] = problem.pulse(times)
        for bar in range(2):
            if problem.ends[bar] != 0 and times[NODES // 2] > problem.trips[bar]:
                push[:, bar] += problem.ends[bar] * _returning(course, starts, bar, times, problem.trips[bar])
        guess = np.tile(state, (NODES, 1))
        if course.pieces and power == 1 and course.pieces[-1].power == 1 and length < 1.2 * course.pieces[-1].length:
            guess = chebyshev(course.pieces[-1].share(times[1:])) @ course.pieces[-1].states
        scales = _MEMORY * sizes
        if not course.pieces:  # face B follows face A at first with a power too high for any step
            scales = push[-1, 0] * np.array([length, length, Long(1)])
        piece = collocate(state, guess, push, time, length, power, problem.mass, scales)
        tail = np.inf if piece is None else piece.tail
        if piece is None or (tail > TAIL and not (refused > 3 and tail > 0.1 * worst and tail < 100 * TAIL)):
            refused, worst = refused + 1, tail
            length = length * max(0.1, min(0.7, (_AIM / tail) ** (power / NODES) if tail < 1.0 else 0.1))
            if length < 1e-18 * (1 + time):
                raise Unaffordable("the step has become too short")
            continue
        refused, worst = 0, np.inf
        course.end, course.lost = loss(course, piece, max(known[0], known[1]))
        course.tail = max(course.tail, tail)
        course.pieces.append(piece)
        starts.append(piece.start)
        known = largest(piece, course.end, known)
        course.x_max, course.difference, course.energy = max(known[0], known[1]), known[2], known[3]
        if time < problem.first_echo:
            course.x_first = course.x_max
        if course.lost is not None:
            return course
        if np.isinf(problem.record) and time >= pulse_end:
            gone = faded(piece, _TAIL_SHARE ** (Long(2) / 3) * course.x_max)
            if gone is not None:
                course.end = gone
                return course
        state = piece.states.sum(axis=0)
        sizes = np.maximum(sizes, np.abs(state))
        grown = length * min(3.0, 0.9 * (_AIM / piece.expected) ** (power / NODES))
        if length == left:
            if at_jump >= len(jumps):
                return course
            time, at_jump, power = jump, at_jump + 1, 2 if echo else 1
            length = grown if power == 1 else min(grown, 0.05 * grown)
        else:
            time, power, length = time + length, 1, grown
    raise Unaffordable(f"more than {budget} steps")


# --- All quantities of interest of one scene by the reference integrator, in SI.


@dataclass(frozen=True, kw_only=True)
class Reference:
    """Answers of one scene.

    `values`: every quantity of `uqsphere.quantities.OUTPUTS` that the impact model answers [SI]; `censored`:
    for time_to_first_loss; `record`: its end [s]; `dips` (time [s], approach over the largest): the
    moments at which a face nearly let go; `steps`: steps taken; `tail`: largest error estimate of a step,
    relative to the state.
    """

    values: Mapping[str, float]
    censored: Mapping[str, bool]
    record: float
    dips: tuple[tuple[float, float], ...]
    steps: int
    tail: float


def refer(scene: Scene, row: int = 0, *, budget: int = 20_000) -> Reference:
    """Answers of one row of a scene.

    Raises
    ------
    ValueError
        If the row lies outside the domain.
    tests.independent.reference.Unaffordable
        If it takes more than `budget` steps.

    >>> import numpy as np
    >>> numbers = {"sphere.E": 52e9, "sphere.nu": 0.25, "sphere.radius": 0.01, "sphere.density": 2650.0,
    ...            "bars.E": 210e9, "bars.nu": 0.3, "bars.density": 7850.0, "bars.diameter": 0.04,
    ...            "bars.incident_length": 1.5, "bars.receiving_length": 1.5, "bars.incident_end": 1.0,
    ...            "bars.receiving_end": 1.0, "striker.length": 0.4, "striker.speed": 1.0}
    >>> found = refer(Scene(columns={name: np.array([number]) for name, number in numbers.items()}))
    >>> round(found.values["time_to_first_loss"] * 1e3, 8)
    1.52195874
    """
    if scene.status[row] != 0:
        raise ValueError(f"row {row} lies outside the domain of the model")
    return _in_si(scene, row, follow(problem_of(scene, row), budget=budget))


def _in_si(scene: Scene, row: int, course: Course) -> Reference:
    c = {name: Long(column[row]) for name, column in scene.columns.items()}
    pi = Long(4) * np.arctan(Long(1))
    bar = 0 if scene.rigid_contact else (1 - c["bars.nu"] ** 2) / c["bars.E"]
    modulus = 1 / ((1 - c["sphere.nu"] ** 2) / c["sphere.E"] + bar)
    radius = 1 / (1 / c["sphere.radius"] + 1 / c.get("bars.end_radius", Long(np.inf)))
    beta = 4 * modulus * np.sqrt(radius) / 3
    unit_force = np.sqrt(c["bars.density"] * c["bars.E"]) * pi * c["bars.diameter"] ** 2 / 8 * c["striker.speed"]
    unit = (unit_force / beta) ** (Long(2) / 3)
    unit_time = 2 * unit / c["striker.speed"]

    def pressure(x: Any) -> Any:
        return 2 / pi * modulus * np.sqrt(unit * x / radius)

    x_max = course.x_max
    third = Long(2) / 3
    rise = crossing(course, x_max * Long("0.9") ** third) - crossing(course, x_max * Long("0.1") ** third)
    force = unit_force * x_max**1.5
    energy = unit_force * unit * course.energy
    values = {
        "p_max": pressure(x_max),
        "P_max": force,
        "alpha_max": unit * x_max,
        "a_max": np.sqrt(radius * unit * x_max),
        "time_to_first_loss": unit_time * course.ended,
        "rise_time": unit_time * rise,
        "loading_rate": Long("0.8") * force / (unit_time * rise),
        "first_peak": pressure(course.x_first),
        "force_imbalance": course.difference / x_max**1.5,
        "energy": energy,
        "specific_energy": energy / (4 * pi / 3 * c["sphere.radius"] ** 3 * c["sphere.density"]),
        "edge_tension": (1 - 2 * c["sphere.nu"]) / 3 * pressure(x_max),
        "centre_tension": 21 * force / (4 * pi * (7 + 5 * c["sphere.nu"]) * c["sphere.radius"] ** 2),
    }
    return Reference(
        values={name: float(value) for name, value in values.items()},
        censored={"time_to_first_loss": course.lost is None},
        record=float(unit_time * course.ended),
        dips=tuple((float(unit_time) * time, depth) for time, depth in course.dips),
        steps=len(course.pieces),
        tail=course.tail,
    )
