"""Waves in the bars: at the contacts, anywhere along the bars, and in strain gauge signals.

They are evaluated from the polynomials of the integrator by theory (4) and (5), unrolled into a sum
over reflections, at any instant without loss of accuracy.  The waves that arrive at the contact and
leave it determine the whole bar.  The paper's (3.17) holds for gauges midway along bars of equal
length without reflections; here a gauge may be anywhere, and every reflection is in its signal.
"""

from typing import NamedTuple

import numpy as np

from uqsphere.arrays import Array, Pair, Values, quiet

from .integrator.solve import Motion
from .pulses import pulse_value

#: the bars by name, in the order of every pair of numbers
BARS = ("incident", "receiving")
#: reflected waves weaker than this, relative to the first wave, are neglected
_FAINT = 1e-18
#: relative tolerance of positions
_ROUNDING = 1e-9


def leaving(motion: Motion, bar: int, times: Array, *, sides: Values = 1.0) -> Array:
    """The wave that leaves a contact, (m,) [m/s]: g_A of the incident bar (0), k_B (1).

        g_A(t) = sum_k R_1^k [f_in(t - k T_1) - P_A(t - k T_1)/Z]
        k_B(t) = sum_k R_3^k P_B(t - k T_3)/Z

    times: (m,) [s].  sides (m,): -1 for the value before a jump at that instant, 1 (default) for
    the value after it.
    """
    return _echoes(motion, bar, times, sides, first=0)


def arriving(motion: Motion, bar: int, times: Array, *, sides: Values = 1.0) -> Array:
    """The wave that arrives at a contact, (m,) [m/s]; arguments as of `leaving`.

    It is f = f_in + R_1 g_A(t - T_1) in the incident bar (0), h = R_3 k_B(t - T_3) in the receiving
    bar (1).
    """
    wave = _echoes(motion, bar, times, sides, first=1)
    if bar == 0:
        wave += _pulse(motion, times + _nudge(motion, times, sides))
    return wave


def _nudge(motion: Motion, times: Array, sides: Values) -> Values:
    """Shift of an instant to the requested side of a jump, above the rounding of t - k T."""
    return 1e-12 * (np.abs(times) + motion.unit) * sides


@quiet
def _echoes(motion: Motion, bar: int, times: Array, sides: Values, *, first: int) -> Array:
    """Sum over k >= first of R^k times the wave that first left the contact at t - k T."""
    end = motion.scene.reflections[motion.row, bar]
    last = times.max(initial=0.0)
    trip = min(motion.echo(bar), 4.0 * (last + motion.horizon))
    nudge = _nudge(motion, times, sides)
    most = np.abs(np.log(_FAINT) / np.log(np.abs(end)))  # infinite where |R| is 1
    total = np.zeros_like(times)
    for begin, until in _sending(motion, bar, last):
        k = np.maximum(np.ceil((times - until) / trip), first)
        while True:
            earlier = times - k * trip
            at = np.flatnonzero((earlier >= begin) & (k <= most))
            if len(at) == 0:
                break
            part = motion.forces_at(earlier[at])[:, bar] / motion.scales.impedance
            if bar == 0:
                part = _pulse(motion, (earlier + nudge)[at]) - part
            total[at] += end ** k[at] * part
            k += 1.0
    return total


def _sending(motion: Motion, bar: int, last: float) -> list[tuple[float, float]]:
    """Spans of time [s] in which a face may send a wave into its bar: while it is pressed; between
    bars all the time up to `last`.
    """
    if motion.scene.by_wave or motion.forces is None:
        return [(-motion.unit, last)]  # a jump at first touch may lie before it, but for rounding
    pressed = motion.forces[:, bar].any(axis=1)
    (edges,) = np.nonzero(np.diff(pressed, prepend=False, append=False))
    begins = motion.unit * motion.start
    ends = begins + motion.unit * motion.length
    return [*zip(begins[edges[::2]].tolist(), ends[edges[1::2] - 1].tolist(), strict=True)]


def _pulse(motion: Motion, times: Array) -> Values:
    return motion.scales.speed * pulse_value(motion.scene.pulse, motion.row, times)


# --- Stress and particle velocity anywhere in both bars, by the method of characteristics.  The
# wave towards the sphere is constant along t + d/c0, the wave away from it along t - d/c0 (d: the
# distance from the sphere), so that theory (4) and (5) at the contacts give the whole plane.


class Field(NamedTuple):
    """Stress [Pa], tension positive, and particle velocity [m/s], positive from A to B."""

    stress: Array
    velocity: Array


def field_at(
    motion: Motion, bar: str, position: Values, times: Array, *, sides: Values = 1.0
) -> Field:
    """Stress and particle velocity at positions of a bar, (m,).

    With d the distance from the sphere, rho and c0 of the bars:

        incident:   sigma = rho c0 [g_A(t - d/c0) - f(t + d/c0)],   v = f(t + d/c0) + g_A(t - d/c0)
        receiving:  sigma = rho c0 [h(t + d/c0) - k_B(t - d/c0)],   v = k_B(t - d/c0) + h(t + d/c0)

    bar: `incident` or `receiving`.  position: d [m], one or (m,).  times: (m,) [s] since first
    touch; negative while the pulse approaches, up to `last_time`.  sides (m,): see `leaving`.

    Raises ValueError for an unknown bar or a position beyond its end.
    Source: W. K. Nowacki, Engng. Trans. 42(3), 1994, (2.1), (2.2), (3.13), (3.14), re-derived
    (docs/errata.md) and extended to all reflections.

    >>> from uqsphere.mechanics.integrator.solve import motion
    >>> from uqsphere.mechanics.scene import Scene
    >>> numbers = {"sphere.E": 52e9, "sphere.nu": 0.25, "sphere.radius": 0.01,
    ...            "sphere.density": 2650.0, "bars.E": 190e9, "bars.nu": 0.3,
    ...            "bars.density": 8000.0, "bars.diameter": 0.04,
    ...            "bars.incident_length": 1.5, "bars.receiving_length": 1.5,
    ...            "bars.incident_end": 1.0, "bars.receiving_end": 0.0, "striker.speed": 0.5,
    ...            "striker.length": 0.4}
    >>> columns = {name: np.array([number]) for name, number in numbers.items()}
    >>> found = motion(Scene(columns=columns), 0)
    >>> field_at(found, "incident", 0.75, np.array([-1e-4])).velocity.tolist()  # v0/2
    [0.25]
    """
    number = check_position(motion, bar, position)
    delay = position / motion.wave_speed
    towards = arriving(motion, number, times + delay, sides=sides)
    away = leaving(motion, number, times - delay, sides=sides)
    _, density = motion.material
    sign = 1 - 2 * number
    stress = sign * density * motion.wave_speed * (away - towards)
    return Field(stress, towards + away)


def check_position(motion: Motion, bar: str, position: Values) -> int:
    """Number of a bar, 0 or 1; ValueError for an unknown bar or a position beyond its end."""
    if bar not in BARS:
        raise ValueError(f"unknown bar {bar!r} (allowed: {', '.join(BARS)})")
    number = BARS.index(bar)
    length = motion.bar_length(number)
    position = np.ravel(position)
    outside = ~((position >= 0.0) & (position <= length * (1.0 + _ROUNDING)))
    if outside.any():
        raise ValueError(
            f"position on the {bar} bar must be between 0 and {length:g} m, not "
            f"{position[outside][0]:g} m"
        )
    return number


def field_grid(motion: Motion, places: Array, times: Array) -> Field:
    """The field (m, k) on a grid of instants (m,) [s] and positions (k,) [m] of both bars.

    The sphere is at 0; positions are negative in the incident bar and positive in the receiving
    bar.
    """
    both = np.zeros((2, len(times), len(places)))
    for bar, inside in (("incident", places <= 0.0), ("receiving", places > 0.0)):
        distances, instants = np.meshgrid(np.abs(places[inside]), times)
        field = field_at(motion, bar, distances.ravel(), instants.ravel())
        both[:, :, inside] = np.reshape(field, (2, *distances.shape))
    return Field(*both)


# --- gauges ---------------------------------------------------------------------------------------

#: a wave has ended once it stays below this fraction of its peak
_ENDED_LEVEL = 0.01
#: instants of a round trip at which a wave is evaluated to find its end
_END_POINTS = 4000


class Overlap(NamedTuple):
    """Two waves that overlap at a gauge: their names, begin and end [s]."""

    first: str
    second: str
    begin: float
    end: float


class GaugeRecord(NamedTuple):
    """The signal of one gauge.

    bar: `incident`, `receiving` or `rod`.  position: distance from the sphere [m].  time, strain
    (m,): [s] since first touch, instants of jumps twice (before, after); tension positive.
    overlaps: times at which waves cannot be separated.
    """

    bar: str
    position: float
    time: Array
    strain: Array
    overlaps: tuple[Overlap, ...] = ()

    @property
    def name(self) -> str:
        """Bar and position, as in tables: ``incident 750 mm``."""
        return f"{self.bar} {self.position * 1e3:.6g} mm"


def gauge_strain(
    motion: Motion, bar: str, position: float, times: Array, *, sides: Values = 1.0
) -> Values:
    """Axial strain at a position of a bar, (m,), tension positive: stress of `field_at` over E_b.

    One-dimensional waves without dispersion; within a few bar diameters of the sphere a gauge also
    measures the local field.  Source: W. K. Nowacki, Engng. Trans. 42(3), 1994, (3.17), re-derived
    (docs/errata.md).
    """
    stress = field_at(motion, bar, position, times, sides=sides).stress
    E, _ = motion.material
    return stress / E


def gauge_record(motion: Motion, bar: str, position: float, *, points: int = 2000) -> GaugeRecord:
    """The signal of a gauge from the first wave to `last_time`.

    points: of an even grid, to which the jumps are added twice.
    """
    number = check_position(motion, bar, position)
    delay = position / motion.wave_speed
    end = last_time(motion, bar, position)
    begin = 0.0
    jumps = np.zeros(0)
    if number == 0:
        begin = -1.1 * delay
        echo = motion.echo(number)
        count = int(min(motion.horizon / echo, 16.0))
        jumps = pulse_kinks(motion, [0.0, *(echo * np.arange(1, 1 + count))])
    passing = np.concatenate([jumps - delay, jumps + delay])
    times, sides = with_jumps(np.linspace(begin, end, points), passing)
    return GaugeRecord(
        bar,
        position,
        times,
        gauge_strain(motion, bar, position, times, sides=sides),
        overlaps(motion, bar, position),
    )


def last_time(motion: Motion, bar: str, position: float) -> float:
    """Last instant [s] at which the motion up to the horizon determines a position of a bar."""
    number = BARS.index(bar)
    delay = position / motion.wave_speed
    return motion.horizon + min(delay, motion.echo(number) - delay)


def pulse_kinks(motion: Motion, delays: Values) -> Array:
    """Instants (k,) [s] at which the pulse or its slope may jump, after each of several delays."""
    breaks = motion.scene.pulse.breaks[motion.row]
    return np.ravel(breaks[np.isfinite(breaks), None] + delays)


def with_jumps(smooth: Array, jumps: Array) -> Pair:
    """Sorted instants, with the jumps between them twice, and sides: -1 at the first instant of a
    jump, else 1.
    """
    jumps = np.unique(jumps)
    jumps = jumps[(jumps > smooth.min()) & (jumps < smooth.max())]
    times = np.sort(np.concatenate([np.union1d(smooth, jumps), jumps]))
    before = np.append(times[1:] == times[:-1], False)
    return times, np.where(before, -1.0, 1.0)


def default_positions(motion: Motion) -> tuple[tuple[str, float], ...]:
    """Default gauges: midway along each bar with a length, as in the paper."""
    halves = (0.5 * motion.bar_length(number) for number in (0, 1))
    return tuple(pair for pair in zip(BARS, halves, strict=True) if np.isfinite(pair[1]))


def overlaps(motion: Motion, bar: str, position: float) -> tuple[Overlap, ...]:
    """Overlapping waves at a gauge.

    The incident and the reflected wave overlap for position < c0 t_pulse/2.  The wave that leaves
    the sphere overlaps its own reflection if it has not ended by then (1 % of its peak).
    """
    number = BARS.index(bar)
    delay = position / motion.wave_speed
    overlapping = []
    if number == 0 and motion.pulse_end > 2.0 * delay:
        # a step overlaps to the end of the computed time
        end = min(motion.pulse_end - delay, last_time(motion, bar, position))
        overlapping.append(Overlap("incident", "reflected", delay, end))
    # return of the wave that leaves the contact, in the time of the contact
    echo = motion.echo(number)
    back = echo - 2.0 * delay
    end = min(echo, motion.horizon)
    if back < end:
        instants = np.linspace(0.0, end, _END_POINTS)
        wave = np.abs(leaving(motion, number, instants, sides=-1.0))
        above = instants[wave > _ENDED_LEVEL * wave.max()]
        first, second = (
            ("reflected", "its reflection from the struck end"),
            ("transmitted", "its reflection"),
        )[number]
        if above.size and above[-1] > back:
            end = float(above[-1]) + delay
            overlapping.append(Overlap(first, second, back + delay, end))
    return tuple(overlapping)


def force_imbalance(force_a: Values, force_b: Values) -> Values:
    """R = 2 |P_A - P_B|/(P_A + P_B), (m,): 0 in equilibrium, 2 for a single force, 0 without force.

    Source: G. Ravichandran, G. Subhash, J. Am. Ceram. Soc. 77(1), 1994, 263-267; R <= 0.05.

    >>> force_imbalance(np.array([0.0, 1.0, 1.0]), np.array([0.0, 0.0, 0.9])).round(4).tolist()
    [0.0, 2.0, 0.1053]
    """
    total = force_a + force_b
    return 2.0 * np.abs(force_a - force_b) / np.where(total > 0.0, total, 1.0)
