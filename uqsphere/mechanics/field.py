"""The waves in the bars: at the two faces, anywhere along them, and as strain gauges see them.

They are read off the polynomials that the integrator leaves, by theory (4) and (5), unrolled into a
sum over the echoes, so that the instants asked for cost nothing in accuracy.  A bar has a wave that
arrives at its face and one that leaves it: between them they say all there is to say about the bar.
The paper's (3.17) for the forces holds for gauges half-way along, bars of equal length and no
reflection; here a gauge sits anywhere, and every reflection is in its signal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Values
from uqsphere.mechanics.integrator.solve import Motion
from uqsphere.mechanics.pulses import pulse_value
from uqsphere.mechanics.scene import Scene

#: the bars by name, in the order of every pair of numbers
BARS: Final = ("incident", "receiving")
#: echoes weaker than this, over the first wave, are left out: far below the rounding of a double
_FAINT: Final = 1e-18


@dataclass(frozen=True, kw_only=True)
class Waves:
    """Particle velocities at the faces [m/s], (m,): towards the sphere (f, h) and away from it
    (g_A, k_B).
    """

    incident: Array
    returning: Array
    leaving_a: Array
    leaving_b: Array

    @classmethod
    def none(cls, count: int) -> Waves:
        """Where nothing moves."""
        still = np.zeros(count)
        return cls(incident=still, returning=still, leaving_a=still, leaving_b=still)


def leaving(motion: Motion, bar: int, times: Array, *, sides: Array | None = None) -> Array:
    """The wave that leaves a face at `times` [s], (m,) [m/s]: g_A of the incident bar (0), k_B of
    the receiving (1).

    g_A(t) = sum_k R_1^k [f_in(t - k T_1) - P_A(t - k T_1)/Z],   k_B(t) = sum_k R_3^k P_B(t - k
    T_3)/Z. sides (m,): -1 takes the value before a jump at that instant, 1 (everywhere if None) the
    value after it.
    """
    return _echoes(motion, bar, times, _sided(motion, times, sides), first=0)


def arriving(motion: Motion, bar: int, times: Array, *, sides: Array | None = None) -> Array:
    """The wave that arrives at a face at `times` [s], (m,) [m/s]: f = f_in + R_1 g_A(t - T_1) in
    the incident bar (0), h = R_3 k_B(t - T_3) in the receiving bar (1).
    """
    nudge = _sided(motion, times, sides)
    echo = _echoes(motion, bar, times, nudge, first=1)
    return _pulse(motion.scene, motion.row, times + nudge) + echo if bar == 0 else echo


def _sided(motion: Motion, times: Array, sides: Array | None) -> Array:
    """What moves an instant to the asked side of a jump although t - k T is rounded."""
    scale = float(motion.scene.scales.time[motion.row])
    nudge = 1e-12 * (np.abs(times) + scale)
    return np.asarray(nudge if sides is None else nudge * sides)


def _echoes(motion: Motion, bar: int, times: Array, nudge: Array, *, first: int) -> Array:
    """sum over k >= first of R^k times what left the face anew at t - k T."""
    scene, row = motion.scene, motion.row
    end, trip, impedance = motion.reflection(bar), motion.round_trip(bar), motion.impedance
    last = float(times.max(initial=0.0)) * (1.0 + 1e-12)
    total = np.zeros_like(times)
    k, strength = first, end**first
    while k == 0 or (abs(strength) > _FAINT and k * trip <= last):
        earlier = times - k * trip if k else times
        part = motion.forces_at(earlier)[:, bar] / impedance
        if bar == 0:
            part = _pulse(scene, row, earlier + nudge) - part
        total += strength * part
        k, strength = k + 1, strength * end
    return total


def waves_at(motion: Motion, times: Array, *, sides: Array | None = None) -> Waves:
    """All four waves at the faces at `times` [s]; `sides` as of `leaving`."""
    return Waves(
        incident=arriving(motion, 0, times, sides=sides),
        returning=arriving(motion, 1, times, sides=sides),
        leaving_a=leaving(motion, 0, times, sides=sides),
        leaving_b=leaving(motion, 1, times, sides=sides),
    )


def _pulse(scene: Scene, row: int, times: Array) -> Array:
    return 0.5 * float(scene.columns["striker.speed"][row]) * pulse_value(scene.pulse, row, times)


# --- Stress and particle velocity anywhere in both bars at any time, from the characteristics of
# the wave equation. Along t + d/c0 = const the wave that runs towards the sphere keeps its value,
# along t - d/c0 = const the one that runs away from it (d the distance from the sphere): theory (4)
# and (5) at the faces give the whole plane.

#: instants and places may exceed what is known by this share of it: that is rounding
_ROUNDING: Final = 1e-9
#: share of the pulse's stress that counts as tension, and its most where the record has tension of
#: its own
_LEVEL: Final = 1e-6
_MOST_LEVEL: Final = 0.05
#: instants at each face from which the first tension is sought; how often the search zooms in and
#: on how many points, by a factor of 8 each time: 8^12 is more than the digits of a double
_COARSE: Final = 1500
_ZOOMS: Final = 12
_FINE: Final = 33


@dataclass(frozen=True, kw_only=True)
class Field:
    """Stress [Pa], tension positive, and particle velocity [m/s] away from the struck end, both of
    one shape.
    """

    stress: Array
    velocity: Array


@dataclass(frozen=True, kw_only=True)
class Tension:
    """Where and when a bar is first under tension: distance from the sphere [m], time [s]."""

    bar: str
    position: float
    time: float


def field_at(
    motion: Motion, bar: str, position: Values, times: Values, *, sides: Array | None = None
) -> Field:
    """Stress and particle velocity at places of a bar, (m,).

    With d the distance from the sphere, rho and c0 of the bars:

        incident:   sigma = rho c0 [g_A(t - d/c0) - f(t + d/c0)],   v = f(t + d/c0) + g_A(t - d/c0)
        receiving:  sigma = rho c0 [h(t + d/c0) - k_B(t - d/c0)],   v = k_B(t - d/c0) + h(t + d/c0)

    bar: `incident` or `receiving`; position: d [m], one or (m,); times (m,): [s] since first touch,
    before which the pulse is under way; sides (m,): see `leaving`.  ValueError for an unknown bar,
    a place that is not on it, times that are no finite (m,) array, or one for which the history had
    to go on longer (`last_time`). Source: W. K. Nowacki, Engng. Trans. 42(3), 1994, (2.1), (2.2),
    (3.13), (3.14), re-derived (docs/errata.md), and carried on through every reflection.

    >>> from uqsphere.mechanics.integrator.solve import motion
    >>> numbers = {"sphere.E": 52e9, "sphere.nu": 0.25, "sphere.radius": 0.01,
    ...            "sphere.density": 2650.0, "bars.E": 190e9, "bars.nu": 0.3,
    ...            "bars.density": 8000.0, "bars.diameter": 0.04,
    ...            "bars.incident_length": 1.5, "bars.receiving_length": 1.5,
    ...            "bars.incident_end": 1.0, "bars.receiving_end": 0.0, "striker.speed": 0.5,
    ...            "striker.length": 0.4}
    >>> columns = {name: np.array([number]) for name, number in numbers.items()}
    >>> found = motion(Scene(columns=columns), 0)
    >>> field_at(found, "incident", 0.75, [-100e-6]).velocity.tolist()  # v0/2 behind the front
    [0.25]
    """
    times = np.asarray(times, dtype=float)
    if times.ndim != 1 or not np.isfinite(times).all():
        raise ValueError(f"times must be finite numbers in one row (m,), found shape {times.shape}")
    position = np.broadcast_to(np.asarray(position, dtype=float), times.shape)
    number = check_position(motion, bar, position)
    _check_end(motion, bar, position, times)
    delay = position / motion.wave_speed
    towards = arriving(motion, number, times + delay, sides=sides)
    away = leaving(motion, number, times - delay, sides=sides)
    stress = motion.scene.columns["bars.density"][motion.row] * motion.wave_speed * (away - towards)
    return Field(stress=stress if number == 0 else -stress, velocity=towards + away)


def check_position(motion: Motion, bar: str, position: Values) -> int:
    """Number of a bar, 0 or 1; ValueError for an unknown bar or a place that is not on it."""
    if bar not in BARS:
        raise ValueError(f"unknown bar {bar!r} (allowed: {', '.join(BARS)})")
    number = BARS.index(bar)
    length = 0.5 * motion.wave_speed * motion.round_trip(number)
    position = np.atleast_1d(np.asarray(position, dtype=float))
    outside = ~((position >= 0.0) & (position <= length * (1.0 + _ROUNDING)))
    if outside.any():
        raise ValueError(
            f"{position[outside][0]:g} m from the sphere is not on the {bar} bar of {length:g} m"
        )
    return number


def last_time(motion: Motion, bar: str, position: Values) -> Values:
    """The last instant [s] at which the motion up to the horizon decides what a place of a bar
    sees.
    """
    number = BARS.index(bar)
    delay = np.asarray(position, dtype=float) / motion.wave_speed
    if not motion.echoes(number):
        return motion.horizon + delay
    return motion.horizon + np.minimum(delay, motion.round_trip(number) - delay)


def _check_end(motion: Motion, bar: str, position: Array, times: Array) -> None:
    last = last_time(motion, bar, position)
    late = times > last + _ROUNDING * motion.horizon
    if late.any():
        k = int(np.argmax(late))
        raise ValueError(
            f"the history ends at {motion.horizon:.6g} s, which decides the {bar} bar at "
            f"{position[k]:g} m up to "
            f"{last[k]:.6g} s only, and {times[k]:.6g} s is requested: compute a history with a "
            "longer horizon"
        )


def field_grid(motion: Motion, places: Values, times: Values) -> Field:
    """The field (m, k) on a grid of instants (m,) [s] and places (k,) [m] of both bars.

    The sphere stands at 0: negative in the incident bar, positive in the receiving bar; 0 is the
    incident face.
    """
    places, times = np.asarray(places, dtype=float), np.asarray(times, dtype=float)
    stress, velocity = np.zeros((len(times), len(places))), np.zeros((len(times), len(places)))
    for bar, inside in (("incident", places <= 0.0), ("receiving", places > 0.0)):
        where = np.abs(places[inside])
        found = field_at(motion, bar, np.tile(where, len(times)), np.repeat(times, len(where)))
        stress[:, inside] = found.stress.reshape(len(times), -1)
        velocity[:, inside] = found.velocity.reshape(len(times), -1)
    return Field(stress=stress, velocity=velocity)


def tension_level(motion: Motion) -> float:
    """Stress over the pulse's nominal stress rho c0 v0/2 from which on `first_tension` calls it
    tension.

    A measured pulse has tension of its own, before its foot and after its end, where noise and
    baseline leave the strain of a pressing wave on the other side of zero.  One and a half times
    the largest of it is the level then, and 5 % at the most: what is more than that is no noise.
    """
    record = motion.scene.record
    if record is None:
        return _LEVEL
    joints = np.asarray(record.breaks)
    step = np.linspace(0.0, 1.0, 65) * np.diff(joints)[:, None]
    coefficients = np.asarray(record.coefficients)
    strain = sum(coefficients[:, k, None] * step**k for k in range(coefficients.shape[1]))
    return float(np.clip(-1.5 * np.min(strain), _LEVEL, _MOST_LEVEL))


def first_tension(motion: Motion, bar: str, *, share: float | None = None) -> Tension | None:
    """Where and when the stress of a bar first rises above `share` (`tension_level`) of the pulse's
    stress rho c0 v0/2.

    Tension is where more leaves than arrives, g_A(u) > f(w) (receiving bar: h(w) > k_B(u)), with u
    = t - d/c0 and w = t + d/c0: the least u + w among those with 0 <= w - u <= 2 l/c0 is sought, on
    a grid and by zooming in. None where the bar sees none up to the horizon.
    """
    number = check_position(motion, bar, 0.0)
    share = tension_level(motion) if share is None else share
    level = share * 0.5 * float(motion.scene.columns["striker.speed"][motion.row])
    trip, horizon = motion.round_trip(number), motion.horizon
    nodes = _nodes(motion, number, horizon)
    away, towards = leaving(motion, number, nodes), arriving(motion, number, nodes)
    best, found = np.inf, (0, 0)
    for k, begin in enumerate(nodes):
        if 2.0 * begin >= best:
            break
        stop = min(
            np.searchsorted(
                nodes, min(begin + trip * (1.0 + _ROUNDING), best - begin), side="right"
            ),
            len(nodes),
        )
        pulled = _pull(number, away[k], towards[k:stop]) > level
        if pulled.any() and begin + nodes[k + (first := int(np.argmax(pulled)))] < best:
            best, found = begin + nodes[k + first], (k, k + first)
    if not np.isfinite(best):
        return None
    at = [_around(nodes, k) for k in found]
    point = (nodes[found[0]], nodes[found[1]])
    for _ in range(_ZOOMS):
        grids = [
            np.append(np.linspace(low, high, _FINE), here)
            for (low, high), here in zip(at, point, strict=True)
        ]
        u, w = (grid.ravel() for grid in np.meshgrid(*grids, indexing="ij"))
        inside = (w >= u) & (w - u <= trip * (1.0 + _ROUNDING)) & (u >= 0.0)
        pull = _pull(number, leaving(motion, number, u), arriving(motion, number, w))
        total = np.where(inside & (pull > level), u + w, np.inf)
        k = int(np.argmin(total))
        point = (float(u[k]), float(w[k]))
        widths = [(high - low) / (_FINE - 1) for low, high in at]
        at = [
            (here - 2.0 * width, here + 2.0 * width)
            for here, width in zip(point, widths, strict=True)
        ]
    u_best, w_best = point
    return Tension(
        bar=bar, position=0.5 * motion.wave_speed * (w_best - u_best), time=0.5 * (u_best + w_best)
    )


def _pull(number: int, away: Values, towards: Values) -> Values:
    return away - towards if number == 0 else towards - away


def _nodes(motion: Motion, number: int, horizon: float) -> Array:
    """Instants of a face: an even grid with the kinks of the pulse and what comes back of them."""
    breaks = motion.scene.pulse.breaks[motion.row]
    kinks = breaks[np.isfinite(breaks)]
    if motion.echoes(number):
        kinks = np.concatenate(
            [kinks, kinks + motion.round_trip(number), [motion.round_trip(number)]]
        )
    near = min(horizon, 4.0 * motion.round_trip(number), 20.0 * motion.pulse_end)
    grid = np.concatenate(
        [np.linspace(0.0, horizon, _COARSE), np.linspace(0.0, near, _COARSE), kinks]
    )
    return np.unique(grid[(grid >= 0.0) & (grid <= horizon)])


def _around(nodes: Array, k: int) -> tuple[float, float]:
    return float(nodes[max(k - 1, 0)]), float(nodes[min(k + 1, len(nodes) - 1)])


#: a wave is over once it stays below this share of its largest value
_OVER: Final = 0.01
#: instants of a round trip at which a wave is looked at to see when it is over
_LOOKS: Final = 4000


@dataclass(frozen=True, kw_only=True)
class Overlap:
    """Two waves at one gauge at once: their names, begin and end [s]."""

    first: str
    second: str
    begin: float
    end: float


@dataclass(frozen=True, kw_only=True)
class GaugeRecord:
    """The signal of one gauge.

    bar: `incident` or `receiving`; position: distance from the sphere [m]; time, strain (m,): [s]
    since first touch, jumps twice (before, after), tension positive; overlaps: where waves cannot
    be told apart.
    """

    bar: str
    position: float
    time: Array
    strain: Array
    overlaps: tuple[Overlap, ...]

    @property
    def name(self) -> str:
        """Bar and place, as in tables: ``incident 750 mm``."""
        return f"{self.bar} {self.position * 1e3:.6g} mm"


# --- signals --------------------------------------------------------------------------------------


def gauge_strain(
    motion: Motion, bar: str, position: float, times: Values, *, sides: Array | None = None
) -> Array:
    """Axial strain at a place of a bar, (m,), tension positive: the stress of `field_at` over E_b.

    One-dimensional waves: no dispersion, and a gauge closer to the sphere than a few bar diameters
    sees the local field as well.  W. K. Nowacki, Engng. Trans. 42(3), 1994, (3.17), re-derived
    (docs/errata.md).
    """
    check_position(motion, bar, position)
    stress = field_at(motion, bar, position, times, sides=sides).stress
    return np.asarray(stress / float(motion.scene.columns["bars.E"][motion.row]))


def gauge_record(motion: Motion, bar: str, position: float, *, points: int = 2000) -> GaugeRecord:
    """The signal of a gauge from the arrival of the first wave to the end of what the motion
    decides.

    On an even grid of so many `points`, with jumps twice on top.
    """
    number = check_position(motion, bar, position)
    delay = position / motion.wave_speed
    begin, end = (-1.1 * delay if number == 0 else 0.0), float(last_time(motion, bar, position))
    grid = np.linspace(begin, end, points)
    jumps = _jumps(motion, number)
    jumps = np.unique(np.concatenate([jumps - delay, jumps + delay]))
    jumps = jumps[(jumps > begin) & (jumps < end)]
    times, sides = with_jumps(grid, jumps)
    strain = gauge_strain(motion, bar, position, times, sides=sides)
    return GaugeRecord(
        bar=bar,
        position=position,
        time=times,
        strain=strain,
        overlaps=overlaps(motion, bar, position),
    )


def with_jumps(smooth: Array, jumps: Array) -> tuple[Array, Array]:
    """Instants in order, jumps twice; `sides` is -1 at the first of the two instants of a jump,
    else 1.
    """
    times = np.concatenate([smooth, jumps, jumps])
    sides = np.concatenate([np.ones(len(smooth)), -np.ones(len(jumps)), np.ones(len(jumps))])
    order = np.lexsort((sides, times))
    return times[order], sides[order]


def default_positions(motion: Motion) -> tuple[tuple[str, float], ...]:
    """Where gauges are put that nobody placed: half-way along, as in the paper; a bar without a
    length has none.
    """
    places = []
    for number, bar in enumerate(BARS):
        half = 0.25 * motion.wave_speed * motion.round_trip(number)
        if np.isfinite(half):
            places.append((bar, half))
    return tuple(places)


def _jumps(motion: Motion, number: int) -> Array:
    """When a wave of a bar jumps or bends at the face: the pulse, and what has come back of it."""
    breaks = motion.scene.pulse.breaks[motion.row]
    breaks = breaks[np.isfinite(breaks)] if number == 0 else np.zeros(0)
    if not motion.echoes(number):
        return np.asarray(breaks)
    trips = np.arange(1 + int(min(motion.horizon / motion.round_trip(number), 16.0)))
    return np.asarray((breaks[:, None] + trips * motion.round_trip(number)).ravel())


def overlaps(motion: Motion, bar: str, position: float) -> tuple[Overlap, ...]:
    """Where a gauge sees two waves at once.

    The incident and the reflected wave overlap for position < c0 t_pulse/2; the wave that leaves
    the sphere is met by its own reflection where it is not over by then, that is, below 1 % of its
    largest value for good.
    """
    number = check_position(motion, bar, position)
    delay = position / motion.wave_speed
    names = (
        ("reflected", "its return from the struck end")
        if number == 0
        else ("transmitted", "its return")
    )
    found = []
    if number == 0 and motion.pulse_end > 2.0 * delay:
        # a step overlaps to the end of what is known
        end = min(motion.pulse_end - delay, float(last_time(motion, bar, position)))
        found.append(Overlap(first="incident", second="reflected", begin=delay, end=end))
    # until then the wave that leaves the face passes the gauge before it has come back there
    back = np.inf if not motion.echoes(number) else motion.round_trip(number) - 2.0 * delay
    if back < min(motion.round_trip(number), motion.horizon):
        looks = np.linspace(0.0, min(motion.round_trip(number), motion.horizon), _LOOKS)
        wave = np.abs(leaving(motion, number, looks, sides=-np.ones_like(looks)))
        above = looks[wave > _OVER * wave.max()]
        if above.size and above[-1] > back:
            found.append(
                Overlap(
                    first=names[0],
                    second=names[1],
                    begin=back + delay,
                    end=float(above[-1]) + delay,
                )
            )
    return tuple(found)


def force_imbalance(force_a: Values, force_b: Values) -> Array:
    """R = 2 |P_A - P_B|/(P_A + P_B), (m,): 0 in equilibrium, 2 where one face alone is pressed, 0
    where none is.

    G. Ravichandran, G. Subhash, J. Am. Ceram. Soc. 77(1), 1994, 263-267, who ask for R <= 0.05.

    >>> force_imbalance([0.0, 1.0, 1.0], [0.0, 0.0, 0.9]).round(4).tolist()
    [0.0, 2.0, 0.1053]
    """
    force_a, force_b = np.asarray(force_a, dtype=float), np.asarray(force_b, dtype=float)
    total = force_a + force_b
    return np.asarray(2.0 * np.abs(force_a - force_b) / np.where(total > 0.0, total, 1.0))
