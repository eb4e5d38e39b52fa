"""Incident pulses: particle velocity of the wave towards the sphere, over v0/2, in smooth pieces.

Every shape is a row of breaks with one cubic per piece (a half sine is one piece with its own
formula), so that the integrator can end its steps exactly where a pulse or a derivative jumps.  The
shapes conserve the striker's impulse where theory (20) says so.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polyval

from uqsphere.arrays import Array, ColumnMap, Flags, Values, frozen, quiet

#: default level of the valley of a two-peak pulse, over the lower peak
DEFAULT_VALLEY = 0.75
#: steps of a striker stiffer than its bar: least level, over the first step, and largest number
_FAINT_STEP = 1e-3
_MOST_STEPS = 32


class Pulse(NamedTuple):
    """Pieces of n pulses of one shape.

    breaks (n, m + 1): start of each piece and the end of the last [s]; infinite for a step.
    coefficients (n, m, 4): cubics in the time since the start of the piece, ascending powers.
    frequency (n,): angular frequency of a half sine [1/s], in place of its cubic, or 0.  valid
    (n,): whether the parameters are valid for the shape.
    """

    breaks: Array
    coefficients: Array
    frequency: Array
    valid: Flags

    @property
    def end(self) -> Array:
        """End of the pulse, (n,) [s]."""
        return self.breaks[:, -1]


def _hermite(length: Array, left: Values, right: Values) -> Array:
    """Cubic from `left` to `right` with zero slope at both ends, (n, 4) ascending."""
    rise = right - left
    zero = np.zeros_like(length)
    return np.stack([left + zero, zero, 3.0 * rise / length**2, -2.0 * rise / length**3], axis=1)


def _line(length: Array, left: Values, right: Values) -> Array:
    """Straight line from `left` to `right`, (n, 4) ascending; `left` over no length."""
    zero = np.zeros_like(length)
    slope = (right - left) / np.where(length > 0.0, length, 1.0)
    return np.stack([left + zero, slope, zero, zero], axis=1)


def _pieces(breaks: list[Array], cubics: list[Array], valid: Flags) -> Pulse:
    """The pulse of its breaks, (n,) each, and the cubics between them, (n, 4) each."""
    # rounding may make a plateau of -1e-20 s if rise and fall fill the whole width
    return Pulse(
        breaks=np.maximum.accumulate(np.stack(breaks, axis=1), axis=1),
        coefficients=np.stack(cubics, axis=1),
        frequency=np.zeros(len(valid)),
        valid=valid,
    )


@quiet
def striker_steps(ratio: Values) -> tuple[Array, Flags]:
    """Steps of a pulse from strikers with the impedance ratio Z_s/Z (n,), theory section 7.

    The striker moves the bar end with 2 ratio/(1 + ratio) of v0/2; after each round trip of its own
    wave, 2 l_0/c_s, a fraction (ratio - 1)/(ratio + 1) remains; a striker softer than the bar
    rebounds after the first step.  Returns levels (n, m) over v0/2, with steps below 1e-3 of the
    first set to 0, and whether they are complete (n,): at most 32 steps, enough up to a ratio of 9.

    >>> striker_steps([0.5, 1.0, 2.0])[0][:, :3].round(4).tolist()
    [[0.6667, 0.0, 0.0], [1.0, 0.0, 0.0], [1.3333, 0.4444, 0.1481]]
    """
    ratio = np.array(ratio, float, ndmin=2).T
    left = np.maximum((ratio - 1.0) / (ratio + 1.0), 0.0)
    shares = left ** np.arange(_MOST_STEPS)
    shares = np.where(shares >= _FAINT_STEP, shares, 0.0)
    complete = left[:, 0] ** _MOST_STEPS < _FAINT_STEP
    levels = 2.0 * ratio / (1.0 + ratio) * shares
    used = (shares > 0.0).sum(axis=1).max(initial=1)
    return levels[:, :used], complete


def _stepped(duration: Array, rise: Array, fall: Array, ratio: Array | None) -> Pulse:
    """Steps of equal width, one without a ratio of impedances; the first rises over `rise`, later
    changes are centred over `fall`.
    """
    levels = np.ones((len(duration), 1))
    valid = duration > 0.0
    if ratio is not None:
        levels, complete = striker_steps(ratio)
        valid &= complete & (duration - fall >= -1e-12 * duration)
    middle = 0.5 * rise
    end = middle + (levels > 0.0).sum(axis=1) * duration + 0.5 * fall
    breaks = [np.zeros_like(duration), rise]
    pieces = [_line(rise, 0.0, levels[:, 0])]
    steps = [*levels.T, np.zeros_like(duration)]
    for k, (level, following) in enumerate(pairwise(steps), start=1):
        change = middle + k * duration
        breaks += [np.minimum(change - 0.5 * fall, end), np.minimum(change + 0.5 * fall, end)]
        pieces += [_line(duration, level, level), _line(fall, level, following)]
    valid &= (rise >= 0.0) & (fall >= 0.0) & (duration - 0.5 * (rise + fall) >= -1e-12 * duration)
    return _pieces(breaks, pieces, valid)


def _rectangular(duration: Array, numbers: ColumnMap) -> Pulse:
    abrupt = np.zeros_like(duration)
    if "striker_ratio" in numbers:
        return _stepped(duration, abrupt, abrupt, numbers["striker_ratio"])
    return _pieces([abrupt, duration], [_line(duration, 1.0, 1.0)], duration > 0.0)


def _step(duration: Array, numbers: ColumnMap) -> Pulse:
    return _rectangular(np.full_like(duration, np.inf), numbers)


def _trapezoid(duration: Array, numbers: ColumnMap) -> Pulse:
    # a ramp has no fall
    fall = numbers.get("fall", np.zeros_like(duration))
    return _stepped(duration, numbers["rise"], fall, numbers.get("striker_ratio"))


def _half_sine(duration: Array, numbers: ColumnMap) -> Pulse:
    return _rectangular(duration, {})._replace(frequency=np.pi / duration)


def _two_peak(duration: Array, numbers: ColumnMap) -> Pulse:
    first = numbers["t1"]
    second = numbers["t2"]
    high = numbers["level1"]
    low = numbers["level2"]
    valley = numbers.get("valley", DEFAULT_VALLEY * np.minimum(high, low))
    zero = np.zeros_like(duration)
    breaks = [zero, first, 0.5 * (first + second), second, duration]
    levels = [zero, high, valley, low, zero]
    lengths = np.diff(breaks, axis=0)
    pieces = [_hermite(lengths[k], levels[k], levels[k + 1]) for k in range(4)]
    valid = (lengths > 0.0).all(axis=0) & (np.stack(levels) >= 0.0).all(axis=0) & (high > 0.0)
    return _pieces(breaks, pieces, valid)


#: pulse shapes by name
SHAPES = {
    "rectangular": _rectangular,
    "trapezoid": _trapezoid,
    "ramp": _trapezoid,
    "half_sine": _half_sine,
    "two_peak": _two_peak,
    "step": _step,
}

#: shapes that depend on the impedance of a striker that differs from the bars
STRIKER_SHAPES = ("rectangular", "trapezoid", "ramp")

#: the three pulses of the paper's Fig. 2: shape and numbers [s, over v0/2].  Durations, and the
#: second maximum of the first at about 19 us, are in the paper's text; levels, rise times and the
#: other times are assumed.
PRESETS = {
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


@quiet
def build_pulse(shape: str, duration: Values, numbers: ColumnMap | None = None) -> Pulse:
    """Pulses of n rows, of a shape of `SHAPES`.

    duration (n,): width t_i [s]: base of a rectangle or half sine, width at half height of a
    trapezoid, end of a two-peak pulse, width of one step of a striker that differs from the bars;
    not used by a step.  numbers: keys of `forms.FORMS` (times in s, levels over v0/2), `valley` for
    two peaks, and `striker_ratio`, Z_s/Z, for the shapes of `STRIKER_SHAPES`; (n,) each.

    >>> pulse = build_pulse("trapezoid", [100e-6], {"rise": [20e-6], "fall": [20e-6]})
    >>> (pulse.breaks * 1e6).round(9).tolist()
    [[0.0, 20.0, 100.0, 120.0]]
    """
    duration = np.array(duration, float, ndmin=1)
    columns = {
        name: np.broadcast_to(np.array(value, float), duration.shape)
        for name, value in (numbers or {}).items()
    }
    return SHAPES[shape](duration, columns)


def pulse_value(pulse: Pulse, row: int, times: Array) -> Array:
    """g(t) of one row at `times` [s], over v0/2; right limits at jumps, zero outside the pulse."""
    breaks = pulse.breaks[row]
    piece = np.searchsorted(breaks, times, side="right") - 1
    inside = (piece >= 0) & (times < breaks[-1])
    piece = np.clip(piece, 0, pulse.coefficients.shape[1] - 1)
    local = times - breaks[piece]
    value = polyval(local, pulse.coefficients[row][piece].T, tensor=False)
    if pulse.frequency[row] > 0.0:
        value = np.sin(pulse.frequency[row] * times)
    return np.where(inside, value, 0.0)


# --- A measured pulse: least-squares cubics over a record; the integrator ends its steps at their
# joints.

#: root mean square misfit of the cubics over the peak, and largest number of pieces
_MISFIT, _MOST_PIECES = 5e-4, 64
#: fractions of the peak: largest value at both ends of the record, and start of the pulse
_END_LEVEL, _START_LEVEL = 0.1, 0.003
#: least number of samples of a pulse
_FEWEST_SAMPLES = 8


@frozen
class MeasuredPulse:
    """The pulse of a record.

    breaks (m + 1,): joints of the cubics [s], from 0.  coefficients (m, 4): strain over its peak,
    ascending powers of the time since the joint.  peak: peak compressive strain, v0 = 2 c0 peak.
    rise: from 10 % to 90 % of the peak [s].
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
        return Pulse(
            breaks=np.tile(self.breaks, (rows, 1)),
            coefficients=np.tile(self.coefficients, (rows, 1, 1)),
            frequency=np.zeros(rows),
            valid=np.ones(rows, bool),
        )


def measured_pulse(time: Array, strain: Array) -> tuple[MeasuredPulse, float]:
    """The pulse of a clean record, and the largest misfit of its cubics over the peak.

    time, strain (n,): [s], compression positive.  The joints are those of Dierckx's smoothing
    spline.

    Raises ValueError for a record that is not a single pulse, with the remedy.
    """
    from scipy.interpolate import PPoly, generate_knots, make_lsq_spline

    peak = float(strain.max())
    limit = _END_LEVEL * peak
    # the negative values before the pulse give the amplitude of the noise
    noise = -1.5 * strain[: np.argmax(strain > limit)].min(initial=0.0)
    inside = np.flatnonzero(np.abs(strain) > max(_START_LEVEL * peak, noise))
    if len(inside) < _FEWEST_SAMPLES:
        raise ValueError(
            f"the pulse must have at least {_FEWEST_SAMPLES} samples, not {len(inside)}"
        )
    first = max(inside[0] - 1, 0)
    last = min(inside[-1] + 1, len(strain) - 1)
    if -strain.min() > limit:
        raise ValueError(
            f"the strain reaches {-strain.min() / peak:.0%} of its peak in tension; cut off the "
            "reflected wave, or smooth a noisy record"
        )
    for place, verb in ((first, "start"), (last, "end")):
        if abs(strain[place]) > limit:
            level = abs(strain[place]) / peak
            raise ValueError(f"the record {verb}s at {level:.0%} of its peak; {verb} it at rest")
    time = time[first : last + 1] - time[first]
    curve = strain[first : last + 1] / peak
    weight = np.ones(len(curve))
    # from 0 to 0
    curve[[0, -1]] = 0.0
    weight[[0, -1]] = 1e3
    *_, knots = generate_knots(
        time, curve, w=weight, k=3, s=len(curve) * _MISFIT**2, nest=_MOST_PIECES + 7
    )
    spline = make_lsq_spline(time, curve, knots, 3, weight)
    fine = np.linspace(0.0, time[-1], 2000)
    smooth = spline(fine)
    top = float(smooth.max())
    start, stop = (fine[np.argmax(smooth >= share * top)] for share in (0.1, 0.9))
    cubics = PPoly.from_spline((spline.t, spline.c, 3)).c[::-1, 3:-3].T / top
    cubics[0, 0] = 0.0
    found = MeasuredPulse(
        breaks=tuple(knots[3:-3].tolist()),
        coefficients=tuple(map(tuple, cubics.tolist())),
        peak=peak * top,
        rise=float(stop - start),
    )
    return found, float(np.abs(curve - spline(time)).max())
