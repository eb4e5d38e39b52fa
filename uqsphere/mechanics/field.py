"""Stress and particle velocity anywhere in both bars at any time, from the characteristics of the wave equation.

Along t + d/c0 = const the wave that runs towards the sphere keeps its value, along t - d/c0 = const the one that
runs away from it (d the distance from the sphere): theory (4) and (5) at the faces give the whole plane.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.history import History
from uqsphere.mechanics.waves import BARS, Solution, arriving, leaving

__all__ = [
    "Field",
    "Tension",
    "check_position",
    "field_at",
    "field_grid",
    "first_tension",
    "last_time",
    "tension_level",
]

Array = npt.NDArray[np.float64]

#: instants and places may exceed what is known by this share of it: that is rounding
_ROUNDING: Final = 1e-9
#: share of the pulse's stress that counts as tension, and its most where the record has tension of its own
_LEVEL: Final = 1e-6
_MOST_LEVEL: Final = 0.05
#: instants at each face from which the first tension is sought, and how often the search zooms in
_COARSE: Final = 1500
_ZOOMS: Final = 12
_FINE: Final = 33


@dataclass(frozen=True, kw_only=True)
class Field:
    """Stress [Pa], tension positive, and particle velocity [m/s] away from the struck end, both of one shape."""

    stress: Array
    velocity: Array


@dataclass(frozen=True, kw_only=True)
class Tension:
    """Where and when a bar is first under tension: distance from the sphere [m], time [s]."""

    bar: str
    position: float
    time: float


def field_at(history: History, bar: str, position: Any, times: Any, *, sides: Array | None = None) -> Field:
    """Stress and particle velocity at places of a bar.

    With d the distance from the sphere, rho and c0 of the bars:

        incident:   sigma = rho c0 [g_A(t - d/c0) - f(t + d/c0)],   v = f(t + d/c0) + g_A(t - d/c0)
        receiving:  sigma = rho c0 [h(t + d/c0) - k_B(t - d/c0)],   v = k_B(t - d/c0) + h(t + d/c0)

    Parameters
    ----------
    history : History
    bar : str
        `incident` or `receiving`.
    position : float or (m,) array
        Distance d from the bar's face at the sphere [m].
    times : (m,) array
        Instants [s] since first touch; the pulse is under way in the incident bar before that.
    sides : (m,) array, optional
        -1 takes the value before a jump at that instant, 1 (everywhere if None) the value after it.

    Returns
    -------
    Field
        Of shape (m,).

    Raises
    ------
    ValueError
        For an unknown bar, a place that is not on it, times that are no finite (m,) array, or one for which the
        history had to go on longer (`last_time`).

    Notes
    -----
    W. K. Nowacki, Engng. Trans. 42(3), 1994, eqs. (2.1), (2.2), (3.13), (3.14), re-derived (docs/errata.md), and
    carried on through every reflection.

    >>> from uqsphere import history, load_study
    >>> found = history(load_study("studies/granite.toml"))
    >>> field_at(found, "incident", 0.75, [-100e-6]).velocity.tolist()    # v0/2 behind the front of the pulse
    [0.25]
    """
    solution = history.solution
    times = np.asarray(times, dtype=float)
    if times.ndim != 1 or not np.isfinite(times).all():
        raise ValueError(f"times must be finite numbers in one row (m,), found shape {times.shape}")
    position = np.broadcast_to(np.asarray(position, dtype=float), times.shape)
    number = check_position(solution, bar, position)
    _check_end(solution, bar, position, times)
    delay = position / solution.wave_speed
    towards = arriving(solution, number, times + delay, sides=sides)
    away = leaving(solution, number, times - delay, sides=sides)
    stress = solution.impedance / solution.section * (away - towards) * (1.0 if number == 0 else -1.0)
    return Field(stress=stress, velocity=towards + away)


def check_position(solution: Solution, bar: str, position: Any) -> int:
    """Number of a bar, 0 or 1; ValueError for an unknown bar or a place that is not on it."""
    if bar not in BARS:
        raise ValueError(f"unknown bar {bar!r} (allowed: {', '.join(BARS)})")
    number = BARS.index(bar)
    length = 0.5 * solution.wave_speed * solution.round_trip(number)
    position = np.atleast_1d(np.asarray(position, dtype=float))
    outside = ~((position >= 0.0) & (position <= length * (1.0 + _ROUNDING)))
    if outside.any():
        raise ValueError(f"{position[outside][0]:g} m from the sphere is not on the {bar} bar of {length:g} m")
    return number


def last_time(solution: Solution, bar: str, position: Any) -> Any:
    """The last instant [s] at which the motion up to the horizon decides what a place of a bar sees."""
    number = BARS.index(bar)
    delay = np.asarray(position, dtype=float) / solution.wave_speed
    if not solution.echoes(number):
        return solution.horizon + delay
    return solution.horizon + np.minimum(delay, solution.round_trip(number) - delay)


def _check_end(solution: Solution, bar: str, position: Array, times: Array) -> None:
    last = last_time(solution, bar, position)
    late = times > last + _ROUNDING * solution.horizon
    if late.any():
        k = int(np.argmax(late))
        raise ValueError(
            f"the history ends at {solution.horizon:.6g} s, which decides the {bar} bar at {position[k]:g} m up to "
            f"{last[k]:.6g} s only, and {times[k]:.6g} s is asked for: compute a history with a longer horizon"
        )


def field_grid(history: History, places: Any, times: Any) -> Field:
    """The field on a grid of both bars, (m, k).

    Parameters
    ----------
    places : (k,) array
        Along the axis [m], the sphere at 0: negative in the incident bar, positive in the receiving bar; a sphere is
        no bar, so that 0 is the incident face.
    times : (m,) array
        Instants [s].
    """
    places, times = np.asarray(places, dtype=float), np.asarray(times, dtype=float)
    stress, velocity = np.zeros((len(times), len(places))), np.zeros((len(times), len(places)))
    for bar, inside in (("incident", places <= 0.0), ("receiving", places > 0.0)):
        where = np.abs(places[inside])
        found = field_at(history, bar, np.tile(where, len(times)), np.repeat(times, len(where)))
        stress[:, inside] = found.stress.reshape(len(times), -1)
        velocity[:, inside] = found.velocity.reshape(len(times), -1)
    return Field(stress=stress, velocity=velocity)


def tension_level(history: History) -> float:
    """Stress over the pulse's nominal stress rho c0 v0/2 from which on `first_tension` calls it tension.

    A measured pulse has tension of its own, before its foot and after its end, where noise and baseline leave the
    strain of a pressing wave on the other side of zero.  One and a half times the largest of it is the level then,
    and 5 % at the most: what is more than that is no noise.
    """
    record = history.solution.scene.record
    if record is None:
        return _LEVEL
    joints = np.asarray(record.breaks)
    step = np.linspace(0.0, 1.0, 65) * np.diff(joints)[:, None]
    coefficients = np.asarray(record.coefficients)
    strain = sum(coefficients[:, k, None] * step**k for k in range(coefficients.shape[1]))
    return float(np.clip(-1.5 * np.min(strain), _LEVEL, _MOST_LEVEL))


def first_tension(history: History, bar: str, *, share: float | None = None) -> Tension | None:
    """Where and when the stress of a bar first rises above `share` of the pulse's nominal stress rho c0 v0/2.

    `share` is `tension_level` if it is not given.

    Tension is where more leaves than arrives, g_A(u) > f(w) (receiving bar: h(w) > k_B(u)), with u = t - d/c0 and
    w = t + d/c0: the least u + w among those with 0 <= w - u <= 2 l/c0 is sought, on a grid and by zooming in.

    Returns
    -------
    Tension or None
        None where the bar sees none up to the horizon.

    Raises
    ------
    ValueError
        For an unknown bar.

    >>> from uqsphere import history, load_study
    >>> found = history(load_study("studies/granite.toml"))
    >>> first_tension(found, "receiving") is None       # its end absorbs: nothing comes back to pull
    True
    """
    solution = history.solution
    number = check_position(solution, bar, 0.0)
    share = tension_level(history) if share is None else share
    level = share * 0.5 * float(solution.scene.columns["striker.speed"][solution.row])
    trip, horizon = solution.round_trip(number), solution.horizon
    nodes = _nodes(history, number, horizon)
    away, towards = leaving(solution, number, nodes), arriving(solution, number, nodes)
    best, found = np.inf, (0, 0)
    for k, begin in enumerate(nodes):
        if 2.0 * begin >= best:
            break
        stop = min(
            np.searchsorted(nodes, min(begin + trip * (1.0 + _ROUNDING), best - begin), side="right"), len(nodes)
        )
        pulled = _pull(number, away[k], towards[k:stop]) > level
        if pulled.any() and begin + nodes[k + (first := int(np.argmax(pulled)))] < best:
            best, found = begin + nodes[k + first], (k, k + first)
    if not np.isfinite(best):
        return None
    at = [_around(nodes, k) for k in found]
    point = (nodes[found[0]], nodes[found[1]])
    for _ in range(_ZOOMS):
        grids = [np.append(np.linspace(low, high, _FINE), here) for (low, high), here in zip(at, point, strict=True)]
        u, w = (grid.ravel() for grid in np.meshgrid(*grids, indexing="ij"))
        inside = (w >= u) & (w - u <= trip * (1.0 + _ROUNDING)) & (u >= 0.0)
        pull = _pull(number, leaving(solution, number, u), arriving(solution, number, w))
        total = np.where(inside & (pull > level), u + w, np.inf)
        k = int(np.argmin(total))
        point = (float(u[k]), float(w[k]))
        widths = [(high - low) / (_FINE - 1) for low, high in at]
        at = [(here - 2.0 * width, here + 2.0 * width) for here, width in zip(point, widths, strict=True)]
    u_best, w_best = point
    return Tension(bar=bar, position=0.5 * solution.wave_speed * (w_best - u_best), time=0.5 * (u_best + w_best))


def _pull(number: int, away: Any, towards: Any) -> Any:
    return away - towards if number == 0 else towards - away


def _nodes(history: History, number: int, horizon: float) -> Array:
    """Instants of a face: an even grid with the kinks of the pulse and what comes back of them."""
    solution = history.solution
    breaks = solution.scene.pulse.breaks[solution.row]
    kinks = breaks[np.isfinite(breaks)]
    if solution.echoes(number):
        kinks = np.concatenate([kinks, kinks + solution.round_trip(number), [solution.round_trip(number)]])
    near = min(horizon, 4.0 * solution.round_trip(number), 20.0 * solution.pulse_end)
    grid = np.concatenate([np.linspace(0.0, horizon, _COARSE), np.linspace(0.0, near, _COARSE), kinks])
    return np.unique(grid[(grid >= 0.0) & (grid <= horizon)])


def _around(nodes: Array, k: int) -> tuple[float, float]:
    return float(nodes[max(k - 1, 0)]), float(nodes[min(k + 1, len(nodes) - 1)])
