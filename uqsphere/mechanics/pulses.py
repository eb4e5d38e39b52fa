"""Incident pulses: the particle velocity of the wave running towards the sphere, over v0/2, as
smooth pieces.

Every shape is a row of breaks and one cubic per piece (a half sine is one piece with its own
formula), so that an integrator can end its steps exactly where a pulse or one of its derivatives
jumps. The shapes conserve the striker's impulse where theory (20) says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags, Values

#: relative depth of the dip of a two-peak pulse whose study does not give it
DEFAULT_VALLEY: Final = 0.75
#: steps of a striker stiffer than its bar: those below this share of the first are left out, and
#: there are no more than this many
_FAINT_STEP: Final = 1e-3
_MOST_STEPS: Final = 32


@dataclass(frozen=True, kw_only=True)
class Pulse:
    """Pieces of n pulses of one shape.

    breaks (n, m + 1): start of each piece and the end of the last [s]; infinite for a step.
    coefficients (n, m, 4): cubic in the time since the piece's start, ascending powers.  frequency
    (n,): angular one of a half sine [1/s], 0 for the shapes made of cubics.  valid (n,): whether
    the parameters make a pulse of this shape at all.
    """

    breaks: Array
    coefficients: Array
    frequency: Array
    valid: Flags

    @property
    def end(self) -> Array:
        """Time at which the pulse is over, (n,) [s]."""
        return self.breaks[:, -1]


def _hermite(length: Array, left: Array, right: Array) -> Array:
    """Cubic from `left` to `right` with zero slope at both ends, (n, 4) ascending."""
    rise = right - left
    zero = np.zeros_like(length)
    return np.stack([left + zero, zero, 3.0 * rise / length**2, -2.0 * rise / length**3], axis=1)


def _line(length: Array, left: Array, right: Array) -> Array:
    safe = np.where(length > 0.0, length, 1.0)
    zero = np.zeros_like(length)
    return np.stack([left + zero, (right - left) / safe, zero, zero], axis=1)


def striker_steps(ratio: Values) -> tuple[Array, Flags]:
    """Levels (n, m) over v0/2 of the steps that strikers of Z_s/Z = `ratio` (n,) send,
    docs/theory.md, section 7.

    The striker moves the bar's end with 2 ratio/(1 + ratio) of v0/2; each round trip of its own
    wave, 2 l_0/c_s, leaves (ratio - 1)/(ratio + 1) of that; one softer than the bar is thrown back
    after the first.  Steps below 1e-3 of the first are left out, as 0; the second result (n,) says
    whether these are all: at most 32 are made, enough up to a ratio of 9.

    >>> striker_steps([0.5, 1.0, 2.0])[0][:, :3].round(4).tolist()
    [[0.6667, 0.0, 0.0], [1.0, 0.0, 0.0], [1.3333, 0.4444, 0.1481]]
    """
    ratio = np.atleast_1d(np.asarray(ratio, dtype=float))[:, None]
    with np.errstate(all="ignore"):
        left = np.maximum((ratio - 1.0) / (ratio + 1.0), 0.0)
        shares = np.where(np.arange(_MOST_STEPS) == 0, 1.0, left ** np.arange(_MOST_STEPS))
        shares = np.where(shares >= _FAINT_STEP, shares, 0.0)
        complete = left[:, 0] ** _MOST_STEPS < _FAINT_STEP
        levels = 2.0 * ratio / (1.0 + ratio) * shares
    used = max(int((shares > 0.0).sum(axis=1).max(initial=0)), 1)
    return levels[:, :used], complete


def _stepped(duration: Array, rise: Array, fall: Array, ratio: Array) -> Pulse:
    """Steps of one width, the first rising over `rise`, each later change over `fall`, centred on
    its instant.
    """
    levels, complete = striker_steps(ratio)
    count = (levels > 0.0).sum(axis=1)
    middle = 0.5 * rise
    end = middle + count * duration + 0.5 * fall
    breaks, pieces = (
        [np.zeros_like(duration), rise],
        [_line(rise, np.zeros_like(duration), levels[:, 0])],
    )
    following = np.concatenate([levels[:, 1:], np.zeros_like(levels[:, :1])], axis=1)
    for k in range(levels.shape[1]):
        change = middle + (k + 1) * duration
        breaks += [np.minimum(change - 0.5 * fall, end), np.minimum(change + 0.5 * fall, end)]
        pieces += [
            _line(duration, levels[:, k], levels[:, k]),
            _line(fall, levels[:, k], following[:, k]),
        ]
    plateau = duration - 0.5 * (rise + fall)
    roomy = (plateau >= -1e-12 * duration) & (duration - fall >= -1e-12 * duration)
    valid = complete & roomy & (rise >= 0.0) & (fall >= 0.0) & (duration > 0.0)
    return Pulse(
        breaks=np.maximum.accumulate(np.stack(breaks, axis=1), axis=1),
        coefficients=np.stack(pieces, axis=1),
        frequency=np.zeros_like(duration),
        valid=valid,
    )


def _rectangular(duration: Array, numbers: Mapping[str, Array]) -> Pulse:
    if "striker_ratio" in numbers:
        return _stepped(
            duration, np.zeros_like(duration), np.zeros_like(duration), numbers["striker_ratio"]
        )
    zero, one = np.zeros_like(duration), np.ones_like(duration)
    return Pulse(
        breaks=np.stack([zero, duration], axis=1),
        coefficients=_line(duration, one, one)[:, None, :],
        frequency=zero,
        valid=duration > 0.0,
    )


def _step(duration: Array, numbers: Mapping[str, Array]) -> Pulse:
    return _rectangular(np.full_like(duration, np.inf), numbers)


def _trapezoid(duration: Array, numbers: Mapping[str, Array]) -> Pulse:
    rise, fall = numbers["rise"], numbers["fall"]
    if "striker_ratio" in numbers:
        return _stepped(duration, rise, fall, numbers["striker_ratio"])
    plateau = duration - 0.5 * (rise + fall)
    zero, one = np.zeros_like(duration), np.ones_like(duration)
    breaks = np.stack([zero, rise, rise + plateau, rise + plateau + fall], axis=1)
    pieces = [_line(rise, zero, one), _line(plateau, one, one), _line(fall, one, zero)]
    # rounding may leave a plateau of -1e-20 s where rise and fall use up the whole width
    valid = (rise >= 0.0) & (fall >= 0.0) & (plateau >= -1e-12 * duration) & (duration > 0.0)
    breaks = np.maximum.accumulate(breaks, axis=1)
    return Pulse(breaks=breaks, coefficients=np.stack(pieces, axis=1), frequency=zero, valid=valid)


def _ramp(duration: Array, numbers: Mapping[str, Array]) -> Pulse:
    return _trapezoid(duration, {**numbers, "fall": np.zeros_like(duration)})


def _half_sine(duration: Array, numbers: Mapping[str, Array]) -> Pulse:
    zero = np.zeros_like(duration)
    return Pulse(
        breaks=np.stack([zero, duration], axis=1),
        coefficients=np.zeros((len(duration), 1, 4)),
        frequency=np.pi / duration,
        valid=duration > 0.0,
    )


def _two_peak(duration: Array, numbers: Mapping[str, Array]) -> Pulse:
    first, second = numbers["t1"], numbers["t2"]
    high, low = numbers["level1"], numbers["level2"]
    valley = numbers.get("valley", DEFAULT_VALLEY * np.minimum(high, low))
    zero = np.zeros_like(duration)
    middle = 0.5 * (first + second)
    breaks = np.stack([zero, first, middle, second, duration], axis=1)
    levels = np.stack([zero, high, valley, low, zero], axis=1)
    lengths = np.diff(breaks, axis=1)
    pieces = [_hermite(lengths[:, k], levels[:, k], levels[:, k + 1]) for k in range(4)]
    valid = (lengths > 0.0).all(axis=1) & (levels >= 0.0).all(axis=1) & (high > 0.0)
    return Pulse(breaks=breaks, coefficients=np.stack(pieces, axis=1), frequency=zero, valid=valid)


SHAPES: Final[dict[str, Callable[[Array, Mapping[str, Array]], Pulse]]] = {
    "rectangular": _rectangular,
    "trapezoid": _trapezoid,
    "ramp": _ramp,
    "half_sine": _half_sine,
    "two_peak": _two_peak,
    "step": _step,
}

#: shapes that follow from the striker's impedance where it is not the bars'
STRIKER_SHAPES: Final = ("rectangular", "trapezoid", "ramp")

#: The three kinds of pulse of the paper's Fig. 2: shape and numbers [s, over v0/2].  The durations,
#: and that the first has a second maximum at about 19 us, are in the paper's text; levels, rises
#: and the other times are ours.
PRESETS: Final[dict[str, tuple[str, Mapping[str, float]]]] = {
    "very_short": (
        "two_peak",
        {"duration": 24.8e-6, "t1": 7e-6, "level1": 1.0, "t2": 19e-6, "level2": 0.6},
    ),
    "short": (
        "two_peak",
        {"duration": 60e-6, "t1": 16e-6, "level1": 1.0, "t2": 40e-6, "level2": 0.8},
    ),
    "long": ("trapezoid", {"duration": 400e-6, "rise": 40e-6, "fall": 40e-6}),
}


def build_pulse(shape: str, duration: Values, numbers: Mapping[str, Values] | None = None) -> Pulse:
    """Pieces of the pulses of n rows, of a shape of `SHAPES`.

    duration (n,): width t_i [s], full base of a rectangle or half sine, width at half height of a
    trapezoid, end of a two-peak pulse; not used by a step.  Width of one step where the striker's
    impedance is not the bars'.  numbers: what `forms.FORMS` names (times in s, levels over v0/2),
    `valley` for two peaks, and `striker_ratio`, Z_s/Z, for the shapes of `STRIKER_SHAPES`; (n,)
    each.

    >>> pulse = build_pulse("trapezoid", [100e-6], {"rise": [20e-6], "fall": [20e-6]})
    >>> (pulse.breaks * 1e6).round(9).tolist()
    [[0.0, 20.0, 100.0, 120.0]]
    """
    duration = np.atleast_1d(np.asarray(duration, dtype=float))
    columns = {
        name: np.broadcast_to(np.asarray(value, dtype=float), duration.shape)
        for name, value in (numbers or {}).items()
    }
    with np.errstate(all="ignore"):
        return SHAPES[shape](duration, columns)


def pulse_value(pulse: Pulse, row: int, times: Array) -> Array:
    """g(t) of one row at `times` [s], over v0/2; the right limit at a jump, zero before and after
    the pulse.
    """
    breaks = pulse.breaks[row]
    piece = np.searchsorted(breaks, times, side="right") - 1
    inside = (piece >= 0) & (times < breaks[-1])
    piece = np.clip(piece, 0, pulse.coefficients.shape[1] - 1)
    local = times - breaks[piece]
    cubic = pulse.coefficients[row][piece]
    value = cubic[:, 0] + local * (cubic[:, 1] + local * (cubic[:, 2] + local * cubic[:, 3]))
    if pulse.frequency[row] > 0.0:
        value = np.sin(pulse.frequency[row] * times)
    return np.where(inside, value, 0.0)


# --- A measured pulse: least-squares cubics over a record, at whose joints the integrator ends its

#: root mean square over the peak that the cubics may leave, and pieces at most
_FINE, _PIECES = 5e-4, 64
#: share of the peak that both ends may have, and from which on the pulse counts
_ENDS, _COUNTS = 0.1, 0.003


@dataclass(frozen=True, kw_only=True)
class MeasuredPulse:
    """The pulse of a record.

    breaks (m + 1,): joints of the cubics [s], from 0; coefficients (m, 4): strain over its largest
    value, ascending powers of the time since the joint.  peak: largest compressive strain, v0 = 2
    c0 peak; rise: from 10 % to 90 % of the peak [s].
    """

    breaks: tuple[float, ...]
    coefficients: tuple[tuple[float, ...], ...]
    peak: float
    rise: float

    @property
    def duration(self) -> float:
        """End of the pulse [s]."""
        return self.breaks[-1]

    def pulse(self, rows: int) -> Pulse:
        """The pieces of n rows."""
        joints, cubics = np.asarray(self.breaks), np.asarray(self.coefficients)
        return Pulse(
            breaks=np.tile(joints, (rows, 1)),
            coefficients=np.tile(cubics, (rows, 1, 1)),
            frequency=np.zeros(rows),
            valid=np.ones(rows, dtype=bool),
        )


def measured_pulse(time: Array, strain: Array) -> tuple[MeasuredPulse, float]:
    """The pulse of a clean record (n,), compression positive, and the largest misfit of its cubics
    over the peak.

    Their joints are those of Dierckx's smoothing spline.  ValueError for a record that is none,
    with the way out.
    """
    from scipy.interpolate import PPoly, generate_knots, make_lsq_spline

    peak = float(strain.max())
    # noise swings to both sides: what lies below zero ahead of the pulse says how far it goes above
    noise = -1.5 * strain[: int(np.argmax(strain > _ENDS * peak))].min(initial=0.0)
    inside = np.flatnonzero(np.abs(strain) > max(_COUNTS * peak, noise))
    if len(inside) < 8:
        raise ValueError(f"found {len(inside)} samples of a pulse, 8 or more are required")
    first, last = max(int(inside[0]) - 1, 0), min(int(inside[-1]) + 1, len(strain) - 1)
    for level, why in (
        (
            -strain.min(),
            "the strain turns to tension, -{:.0%} of its peak: cut the reflected wave off",
        ),
        (abs(strain[first]), "the pulse begins at {:.0%} of its peak: cut it out at rest"),
        (abs(strain[last]), "the pulse ends at {:.0%} of its peak: cut it out at rest"),
    ):
        if level > _ENDS * peak:
            raise ValueError(why.format(level / peak))
    time, curve = time[first : last + 1] - time[first], strain[first : last + 1] / peak
    # from 0 to 0
    curve[[0, -1]], weight = 0.0, np.ones(len(curve))
    weight[[0, -1]] = 1e3
    *_, knots = generate_knots(
        time, curve, w=weight, k=3, s=len(curve) * _FINE**2, nest=_PIECES + 7
    )
    spline = make_lsq_spline(time, curve, knots, 3, weight)
    fine = np.linspace(0.0, time[-1], 2000)
    smooth = spline(fine)
    top = float(smooth.max())
    rise = fine[int(np.argmax(smooth >= 0.9 * top))] - fine[int(np.argmax(smooth >= 0.1 * top))]
    cubics = PPoly.from_spline((spline.t, spline.c, 3)).c[::-1, 3:-3].T / top
    cubics[0, 0] = 0.0
    found = MeasuredPulse(
        breaks=tuple(knots[3:-3].tolist()),
        coefficients=tuple(map(tuple, cubics.tolist())),
        peak=peak * top,
        rise=float(rise),
    )
    return found, float(np.abs(curve - spline(time)).max())
