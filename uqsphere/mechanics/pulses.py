"""Incident pulses: the particle velocity of the wave running towards the sphere, over v0/2, as smooth pieces.

Every shape is a row of breaks and one cubic per piece (a half sine is one piece with its own formula), so
that an integrator can end its steps exactly where a pulse or one of its derivatives jumps.
The shapes conserve the striker's impulse where theory (20) says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

__all__ = ["PARAMETERS", "SHAPES", "Pulse", "build_pulse", "pulse_value"]

Array = npt.NDArray[np.float64]

#: relative depth of the dip of a two-peak pulse whose study does not give it
DEFAULT_VALLEY: Final = 0.75


@dataclass(frozen=True, kw_only=True)
class Pulse:
    """Pieces of n pulses of one shape.

    Attributes
    ----------
    breaks : (n, m + 1) array
        Start of each piece and the end of the last [s]; infinite for a step.
    coefficients : (n, m, 4) array
        Cubic in the time since the piece's start, ascending powers [1, 1/s, 1/s², 1/s³].
    frequency : (n,) array
        Angular frequency of a half sine [1/s], 0 for the shapes made of cubics.
    valid : (n,) array
        Whether the parameters of the row make a pulse of this shape at all.
    """

    breaks: Array
    coefficients: Array
    frequency: Array
    valid: npt.NDArray[np.bool_]

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


def _rectangular(duration: Array, numbers: Mapping[str, Array]) -> Pulse:
    zero, one = np.zeros_like(duration), np.ones_like(duration)
    return Pulse(breaks=np.stack([zero, duration], axis=1), coefficients=_line(duration, one, one)[:, None, :],
                 frequency=zero, valid=duration > 0.0)  # fmt: skip


def _step(duration: Array, numbers: Mapping[str, Array]) -> Pulse:
    return _rectangular(np.full_like(duration, np.inf), numbers)


def _trapezoid(duration: Array, numbers: Mapping[str, Array]) -> Pulse:
    rise, fall = numbers["rise"], numbers["fall"]
    plateau = duration - 0.5 * (rise + fall)
    zero, one = np.zeros_like(duration), np.ones_like(duration)
    breaks = np.stack([zero, rise, rise + plateau, rise + plateau + fall], axis=1)
    pieces = [_line(rise, zero, one), _line(plateau, one, one), _line(fall, one, zero)]
    # rounding may leave a plateau of -1e-20 s where rise and fall use up the whole width
    valid = (rise >= 0.0) & (fall >= 0.0) & (plateau >= -1e-12 * duration) & (duration > 0.0)
    breaks = np.maximum.accumulate(breaks, axis=1)
    return Pulse(breaks=breaks, coefficients=np.stack(pieces, axis=1), frequency=zero, valid=valid)


def _half_sine(duration: Array, numbers: Mapping[str, Array]) -> Pulse:
    zero = np.zeros_like(duration)
    return Pulse(breaks=np.stack([zero, duration], axis=1), coefficients=np.zeros((len(duration), 1, 4)),
                 frequency=np.pi / duration, valid=duration > 0.0)  # fmt: skip


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
    "half_sine": _half_sine,
    "two_peak": _two_peak,
    "step": _step,
}

#: the numbers each shape needs beside its duration
PARAMETERS: Final[dict[str, tuple[str, ...]]] = {
    "rectangular": (),
    "trapezoid": ("rise", "fall"),
    "half_sine": (),
    "two_peak": ("t1", "level1", "t2", "level2"),
    "step": (),
}


def build_pulse(shape: str, duration: Any, numbers: Mapping[str, Any] | None = None) -> Pulse:
    """Pieces of the pulses of n rows.

    Parameters
    ----------
    shape : str
        One of `SHAPES`.
    duration : (n,) array
        Width t_i [s]: full base of a rectangle or half sine, width at half height of a trapezoid, end of a
        two-peak pulse; not used by a step.
    numbers : mapping of str to (n,) array
        What `PARAMETERS` names for the shape (times in s, levels over v0/2), and `valley` for two peaks.

    >>> pulse = build_pulse("trapezoid", [100e-6], {"rise": [20e-6], "fall": [20e-6]})
    >>> (pulse.breaks * 1e6).round(9).tolist()
    [[0.0, 20.0, 100.0, 120.0]]
    """
    duration = np.atleast_1d(np.asarray(duration, dtype=float))
    columns = {
        name: np.broadcast_to(np.asarray(value, dtype=float), duration.shape) for name, value in (numbers or {}).items()
    }
    with np.errstate(all="ignore"):
        return SHAPES[shape](duration, columns)


def pulse_value(pulse: Pulse, row: int, times: Array) -> Array:
    """g(t) of one row at `times` [s], over v0/2; the right limit at a jump, zero before and after the pulse."""
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
