"""A damper at the end of the receiving bar whose impedance depends on the frequency.

The integrators know a far end as one number.  Where the end's impedance is given against frequency, the wave that it
sends back is a convolution: h(t) = R_inf k_B(t - T_3) + ∫_0^∞ r(tau) k_B(t - T_3 - tau) dtau.  Since nothing comes
back within a round trip, the motion can be found round trip by round trip, exactly coupled, with a plain integrator.
That serves one scene over time (`history`); a run takes a number.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array, Values
from uqsphere.mechanics.field import arriving, leaving
from uqsphere.mechanics.integrator.solve import Motion
from uqsphere.mechanics.scene import STATUS, Scene

Complex = npt.NDArray[np.complex128]

#: largest share of the response that may come before its cause, and largest |R|: both leave room for a table's rounding
_ANTICIPATION: Final = 0.02
_PASSIVE: Final = 1.0 + 1e-6
#: samples of the response per sample of the wave, per period of the sphere's oscillation and per round trip: histories
#: are then right to about 1e-7 (`tests/test_damper.py`); and the most samples, for memory
_FINER: Final = 8
_PER_PERIOD: Final = 400.0
_PER_TRIP: Final = 1000.0
_MOST: Final = 1_000_000
#: points that a step's polynomial goes through: the dense output of DOP853 has degree 7; and its tolerance
_NODES: Final = 8
_TOLERANCE: Final = 1e-9


@dataclass(frozen=True, kw_only=True)
class Damper:
    """An end of a bar by its velocity reflection coefficient over frequency.

    frequency (n,): ascending, positive [Hz], at least two; coefficient (n,): complex R(f) with the time factor exp(+i 2
    pi f t), a mass has a positive imaginary impedance.  Above the table the imaginary part dies out like 1/f, and what
    the real part has beyond its limit like 1/f².  ValueError for tables of another shape, frequencies that do not
    ascend, numbers that are not finite, or an end that gives back more than it gets, abs(R) > 1.
    """

    frequency: Array
    coefficient: Complex

    def __post_init__(self) -> None:
        if self.frequency.ndim != 1 or self.frequency.shape != self.coefficient.shape or len(self.frequency) < 2:
            raise ValueError("a damper needs two rows (n,) of one length, at least 2: frequencies and coefficients")
        if not (np.isfinite(self.frequency).all() and np.isfinite(self.coefficient).all()):
            raise ValueError("frequencies and coefficients of a damper must be finite")
        if self.frequency[0] <= 0.0 or not (np.diff(self.frequency) > 0.0).all():
            raise ValueError("the frequencies of a damper must be positive and ascend")
        worst = int(np.argmax(np.abs(self.coefficient)))
        if abs(self.coefficient[worst]) > _PASSIVE:
            raise ValueError(
                f"the damper gives back more than it gets at {self.frequency[worst]:g} Hz, |R| = "
                f"{abs(self.coefficient[worst]):.6g}: the real part of an impedance must not be negative"
            )

    @property
    def limit(self) -> float:
        """R_inf, what comes back at once: the end of the table, its real part going on like 1/f²."""
        first = int(np.argmin(np.abs(self.frequency - 0.5 * self.frequency[-1])))
        first = min(first, len(self.frequency) - 2)
        squares = np.square(self.frequency[[first, -1]])
        ends = self.coefficient[[first, -1]].real
        return float(np.clip((ends @ (squares * [-1.0, 1.0])) / (squares[1] - squares[0]), -1.0, 1.0))

    @property
    def jump(self) -> float:
        """J, what the response begins with [1/s]: the end of the table, its imaginary part going on like 1/f."""
        return -2.0 * np.pi * float(self.frequency[-1] * self.coefficient[-1].imag)

    def at(self, frequency: Array) -> Complex:
        """R at frequencies [Hz], (m,): a cubic spline through the table and its mirror image, R(-f) = conj R(f)."""
        from scipy.interpolate import CubicSpline

        known = np.concatenate([-self.frequency[::-1], self.frequency])
        value = np.concatenate([self.coefficient[::-1].conj(), self.coefficient])
        # straight lines would let the response die out too soon, by sinc² of the spacing times the time
        inside = CubicSpline(known, value)(np.minimum(frequency, known[-1]))
        share = known[-1] / np.maximum(frequency, known[-1])
        beyond = self.limit + (value[-1].real - self.limit) * share**2 + 1j * value[-1].imag * share
        return np.asarray(np.where(frequency > known[-1], beyond, inside))


def damper_from_impedance(frequency: Values, impedance: Values, bar_impedance: float) -> Damper:
    """A damper from force over velocity at its face: R = (Z - Z_d)/(Z + Z_d).

    frequency (n,): [Hz], ascending; impedance (n,): Z_d(f) [kg/s] with the time factor exp(+i 2 pi f t), c + i (2 pi f
    m - k/(2 pi f)) of dashpot, mass and spring; bar_impedance: Z.  ValueError as `Damper`, and for a negative real
    part.

    >>> damper_from_impedance([1e3, 1e5], [0.0, 0.0], 5e4).coefficient.real.tolist()     # a free end
    [1.0, 1.0]
    """
    ratio = np.asarray(impedance, dtype=complex) / bar_impedance
    if (ratio.real < -1e-9 * np.abs(ratio)).any():
        raise ValueError("the real part of a damper's impedance must not be negative: it would feed the bar")
    coefficient = np.asarray((1.0 - ratio) / (1.0 + ratio), dtype=complex)
    return Damper(frequency=np.asarray(frequency, dtype=float), coefficient=coefficient)


def _weights(damper: Damper, step: float, count: int) -> Array:
    """What each earlier sample of a wave, joined by straight lines, adds to the one that comes back, (count,).

    The answer to a hat of half-width `step` is the second difference of the response integrated twice.
    """
    fine = step / _FINER
    size = 2 ** int(np.ceil(np.log2(2 * (count + 1) * _FINER)))
    frequency = np.asarray(np.fft.rfftfreq(size, fine), dtype=float)
    whole = damper.at(frequency) - damper.limit
    # the jump at time zero goes by itself, as J exp(-b t): what is left has none, and its transform does not ring
    # how much slower than the end of the table the part dies out that has the response's jump: any number that is large
    # against 1 and small against the table's range of frequencies serves
    decay = 2.0 * np.pi * float(damper.frequency[-1]) / 50.0
    rest = np.fft.irfft(whole - damper.jump / (2j * np.pi * frequency + decay), size) / fine
    _check_causality(np.fft.irfft(whole, size) / fine, fine * step)
    rest = rest[: size // 2]
    once = np.concatenate([[0.0], np.cumsum(0.5 * (rest[1:] + rest[:-1]))]) * fine
    twice = np.concatenate([[0.0], np.cumsum(0.5 * (once[1:] + once[:-1]))]) * fine
    times = step * np.arange(count + 1)
    own = damper.jump * (times / decay + np.expm1(-decay * times) / decay**2)
    nodes = np.concatenate([[0.0], twice[::_FINER][: count + 1] + own])
    return np.asarray(np.diff(nodes, 2) / step)


def _check_causality(response: Array, scale: float) -> None:
    """ValueError for a response (m,), the second half of which stands for times before zero, that foresees."""
    # a jump at time zero rings over a few samples before it
    early = response[len(response) // 2 : len(response) - 4 * _FINER]
    total, before = float(np.square(response).sum()), float(np.square(early).sum())
    if before > _ANTICIPATION * total and total * scale > 1e-12:
        raise ValueError(
            f"the damper is not causal: {before / total:.0%} of its response comes before the wave. The sign of the "
            "imaginary part may be turned (a mass is +i 2 pi f m), or the table ends too early or is too coarse"
        )


def _reflect(damper: Damper, weights: Array, wave: Array) -> Array:
    size = 2 ** int(np.ceil(np.log2(2 * len(weights))))
    echo = np.fft.irfft(np.fft.rfft(wave, size) * np.fft.rfft(weights, size), size)[: len(wave)]
    return np.asarray(damper.limit * wave + echo)


def move_with_damper(scene: Scene, row: int, damper: Damper) -> Motion:
    """The motion of one scene, `full` model, with a damper at the far end of the receiving bar.

    Round trip by round trip with DOP853 at a tolerance of 1e-9; waves are joined by cubic splines through 400 points
    per period of the sphere's oscillation.  ValueError if the row lies outside the domain, its bars are infinite, its
    sphere is so light that it takes too many samples, or the damper is not causal.
    """
    if scene.status[row]:
        raise ValueError(f"row {row} cannot be integrated: {STATUS[int(scene.status[row])]}")
    trips = scene.round_trips[row]
    if scene.infinite or not np.isfinite(trips[1]):
        raise ValueError("a damper needs a receiving bar with an end: infinite bars have none")
    scales = scene.scales
    horizon, period = float(scene.record_end[row]), 2.0 * np.pi * np.sqrt(scales.mass_number[row] / 3.0)
    back = int(np.ceil(trips[1] / min(trips[1] / _PER_TRIP, period * scales.time[row] / _PER_PERIOD)))
    step = float(trips[1]) / back
    count = int(np.ceil(horizon / step)) + 1
    if count > _MOST:
        raise ValueError(
            f"the sphere is too light for a damper against frequency: {count} samples, at most {_MOST}; give the end a "
            "number, or the history a shorter horizon"
        )
    echo = _Echo(damper=damper, weights=_weights(damper, step, count + 1), step=step, back=back)
    window = step * int(min(trips[1], trips[0] if scene.reflections[row, 0] != 0.0 else np.inf) / step * (1.0 + 1e-12))
    motion = Motion(
        scene=scene, row=row, start=np.zeros(1), length=np.ones(1), states=np.zeros((1, 3, _NODES)), end=0.0,
        returning=np.zeros_like,
    )  # fmt: skip
    state, begin = np.zeros(3), 0.0
    for end in _stops(scene, row, horizon, window):
        found = _advance(motion, state, begin, end, step)
        motion = found if begin == 0.0 else _joined(motion, found)
        state = found.states[-1].sum(axis=1)
        motion = replace(motion, returning=echo.course(motion, end))
        begin = end
    return motion


@dataclass(frozen=True, kw_only=True)
class _Echo:
    """How the wave that has left face B comes back: `back` samples of `step` later, through the damper."""

    damper: Damper
    weights: Array
    step: float
    back: int

    def course(self, motion: Motion, known: float) -> Callable[[Array], Array]:
        """h over time from all that left face B up to `known` [s]; it holds for one round trip more."""
        from scipy.interpolate import CubicSpline

        grid = np.asarray(self.step * np.arange(int(known / self.step * (1.0 + 1e-12)) + 1), dtype=float)
        back = np.concatenate([np.zeros(self.back), _reflect(self.damper, self.weights, leaving(motion, 1, grid))])
        spline = CubicSpline(self.step * np.arange(len(back)), back)
        return lambda times: np.where(times > 0.0, spline(times), 0.0)


def _stops(scene: Scene, row: int, horizon: float, window: float) -> Array:
    """Where the integration pauses: round trips, and every jump of the pulse and of what comes back of it."""
    breaks = scene.pulse.breaks[row]
    times = [breaks[np.isfinite(breaks)], window * np.arange(1, int(horizon / window) + 1), [horizon]]
    if scene.reflections[row, 0] != 0.0:
        trip = float(scene.round_trips[row, 0])
        times += [times[0] + k * trip for k in range(1, int(horizon / trip) + 1)]
    found = np.unique(np.concatenate(times))
    found = found[(found > 0.0) & (found <= horizon)]
    # two that rounding alone tells apart are one
    return np.asarray(found[np.append(np.diff(found) > 1e-9 * horizon, True)])


def _advance(motion: Motion, state: Array, begin: float, end: float, step: float) -> Motion:
    """The motion from begin to end [s], between which no wave jumps, from a state in scaled variables."""
    from scipy.integrate import solve_ivp
    from scipy.interpolate import CubicSpline

    scales, row = motion.scene.scales, motion.row
    unit, mass = float(scales.time[row]), float(scales.mass_number[row])
    speed = 0.5 * float(motion.scene.columns["striker.speed"][row])
    times = np.linspace(begin, end, max(int(np.ceil((end - begin) / step)), 8) + 1)
    sides = np.where(times < end, 1.0, -1.0)
    waves = np.stack([arriving(motion, bar, times, sides=sides) for bar in (0, 1)], axis=1)
    push = CubicSpline(times / unit, waves * [2.0 / speed, -2.0 / speed])

    def rates(s: float, y: Array) -> list[float]:
        first, second = max(y[0], 0.0) ** 1.5, max(y[1], 0.0) ** 1.5
        given = push(s)
        return [given[0] - first - y[2], y[2] - second + given[1], (first - second) / mass]

    span = (begin / unit, end / unit)
    found = solve_ivp(rates, span, state, method="DOP853", rtol=_TOLERANCE, atol=1e-2 * _TOLERANCE,
                      dense_output=True)  # fmt: skip
    dense = found.sol
    if not found.success or dense is None:
        raise ValueError(f"the motion with a damper cannot be integrated: {found.message}")
    # the dense output is a polynomial of degree 7 on every step: as many points give it back
    shares = 0.5 - 0.5 * np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
    start, length = found.t[:-1], np.diff(found.t)
    values = np.asarray(dense((start[:, None] + length[:, None] * shares).ravel())).T.reshape(len(start), _NODES, 3)
    powers = np.linalg.solve(np.vander(shares, increasing=True), values)
    return replace(motion, start=start, length=length, states=np.swapaxes(powers, 1, 2), end=end / unit)


def _joined(one: Motion, other: Motion) -> Motion:
    return replace(
        other,
        start=np.concatenate([one.start, other.start]),
        length=np.concatenate([one.length, other.length]),
        states=np.concatenate([one.states, other.states]),
    )
