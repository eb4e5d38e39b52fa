"""What strain gauges on the bars see: the two waves of a bar, each later or earlier by the way to the gauge.

The paper's (3.17) holds for gauges half-way along, bars of equal length and no reflection; here a gauge sits
anywhere, and every reflection is in its signal.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.history import History
from uqsphere.mechanics.waves import BARS, Solution, arriving, leaving

__all__ = ["check_position", "gauge_strain", "last_time"]

Array = npt.NDArray[np.float64]

#: instants may exceed the end of what is known by this share of it: that is rounding
_ROUNDING: Final = 1e-9


def gauge_strain(history: History, bar: str, position: float, times: Any, *, sides: Array | None = None) -> Array:
    """Axial strain at a place of a bar, tension positive.

    At a distance d from the sphere, with c0 the wave speed of the bars:

        incident:  eps = [g_A(t - d/c0) - f(t + d/c0)]/c0,   receiving:  eps = [h(t + d/c0) - k_B(t - d/c0)]/c0.

    Parameters
    ----------
    history : History
    bar : str
        `incident` or `receiving`.
    position : float
        Distance d of the gauge from the bar's face at the sphere [m].
    times : (m,) array
        Instants [s] since first touch; the pulse passes a gauge on the incident bar before that, at -d/c0.
    sides : (m,) array, optional
        -1 takes the value before a jump at that instant, 1 (everywhere if None) the value after it.

    Returns
    -------
    (m,) array
        Strain [-].

    Raises
    ------
    ValueError
        For an unknown bar, a gauge outside its bar, times that are no finite (m,) array, or one for which the
        history had to go on longer (`last_time`).

    Notes
    -----
    One-dimensional waves: no dispersion, and a gauge closer to the sphere than a few bar diameters sees the local
    field as well.  W. K. Nowacki, Engng. Trans. 42(3), 1994, eq. (3.17), re-derived (docs/errata.md).

    >>> from uqsphere import history, load_study
    >>> found = history(load_study("studies/granite.toml"))
    >>> float(gauge_strain(found, "incident", 0.75, [-100e-6])[0]) * 1e6    # the pulse: -v0/2 c0 once it has risen
    -51.2989...
    """
    number = check_position(history.solution, bar, position)
    times = _instants(history.solution, number, position, times)
    delay = position / history.solution.wave_speed
    towards = arriving(history.solution, number, times + delay, sides=sides)
    away = leaving(history.solution, number, times - delay, sides=sides)
    signal = away - towards if number == 0 else towards - away
    return np.asarray(signal / history.solution.wave_speed)


def check_position(solution: Solution, bar: str, position: float) -> int:
    """Number of a bar, 0 or 1; ValueError for an unknown bar or a place that is not on it."""
    if bar not in BARS:
        raise ValueError(f"unknown bar {bar!r} (allowed: {', '.join(BARS)})")
    number = BARS.index(bar)
    length = 0.5 * solution.wave_speed * solution.round_trip(number)
    if not 0.0 <= position <= length * (1.0 + _ROUNDING):
        raise ValueError(f"a gauge {position:g} m from the sphere is not on the {bar} bar of {length:g} m")
    return number


def last_time(solution: Solution, bar: str, position: float) -> float:
    """The last instant [s] at which the motion known so far decides what a place of a bar sees."""
    number = check_position(solution, bar, position)
    delay = position / solution.wave_speed
    if solution.reflection(number) == 0.0:
        return solution.horizon + delay
    return solution.horizon + min(delay, solution.round_trip(number) - delay)


def _instants(solution: Solution, number: int, position: float, times: Any) -> Array:
    times = np.asarray(times, dtype=float)
    if times.ndim != 1 or not np.isfinite(times).all():
        raise ValueError(f"times must be finite numbers in one row (m,), found shape {times.shape}")
    last = last_time(solution, BARS[number], position)
    if times.size and times.max() > last * (1.0 + _ROUNDING):
        raise ValueError(
            f"the history ends at {solution.horizon:.6g} s, which decides the {BARS[number]} bar at {position:g} m up to "
            f"{last:.6g} s only, and {times.max():.6g} s is asked for: compute a history with a longer horizon"
        )
    return times
