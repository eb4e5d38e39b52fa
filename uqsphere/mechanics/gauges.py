"""What strain gauges on the bars see, and the forces at the faces that are read off the waves.

The paper's (3.17) holds for gauges half-way along, bars of equal length and no reflection; here a gauge sits
anywhere, and every reflection is in its signal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Values
from uqsphere.mechanics.field import BARS, check_position, field_at, last_time, leaving
from uqsphere.mechanics.integrator.solve import Motion

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

    Attributes
    ----------
    bar : str
        `incident` or `receiving`.
    position : float
        Distance from the sphere [m].
    time, strain : (m,) arrays
        Instants [s] since first touch, jumps twice (before, after); strain [-], tension positive.
    overlaps : tuple of Overlap
        Where waves cannot be told apart.
    clean_until : float
        The time at the face [s] up to which the wave that leaves the sphere is seen alone.
    """

    bar: str
    position: float
    time: Array
    strain: Array
    overlaps: tuple[Overlap, ...]
    clean_until: float

    @property
    def name(self) -> str:
        """Bar and place, as in tables: ``incident 750 mm``."""
        return f"{self.bar} {self.position * 1e3:.6g} mm"


@dataclass(frozen=True, kw_only=True)
class BarForces:
    """Forces at the faces by wave analysis [N], (m,), over the time at the faces [s], compression positive.

    one_wave: the receiving face, from the transmitted wave; two_wave: the incident face, from the incident and the
    reflected wave; three_wave: their mean.  Valid up to `end` [s], after which an echo is in a record.
    """

    time: Array
    one_wave: Array
    two_wave: Array
    three_wave: Array
    end: float


# --- signals ------------------------------------------------------------------------------------------


def gauge_strain(motion: Motion, bar: str, position: float, times: Values, *, sides: Array | None = None) -> Array:
    """Axial strain at a place of a bar, tension positive.

    At a distance d from the sphere, with c0 the wave speed of the bars:

        incident:  eps = [g_A(t - d/c0) - f(t + d/c0)]/c0,   receiving:  eps = [h(t + d/c0) - k_B(t - d/c0)]/c0.

    Parameters
    ----------
    motion : Motion
    bar : str
        `incident` or `receiving`.
    position : float
        Distance d of the gauge from the bar's face at the sphere [m].
    times : (m,) array
        Instants [s] since first touch; the pulse passes a gauge on the incident bar before that, from -d/c0.
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
        history had to go on longer (`uqsphere.mechanics.field.last_time`).

    Notes
    -----
    One-dimensional waves: no dispersion, and a gauge closer to the sphere than a few bar diameters sees the local
    field as well.  W. K. Nowacki, Engng. Trans. 42(3), 1994, eq. (3.17), re-derived (docs/errata.md).

    >>> from uqsphere import history, load_study
    >>> found = history(load_study("studies/granite.toml"))
    >>> float(gauge_strain(found.motion, "incident", 0.75, [-100e-6])[0]) * 1e6    # -v0/(2 c0)
    -51.2989...
    """
    check_position(motion, bar, position)
    stress = field_at(motion, bar, position, times, sides=sides).stress
    return np.asarray(stress / float(motion.scene.columns["bars.E"][motion.row]))


def gauge_record(motion: Motion, bar: str, position: float, *, points: int = 2000) -> GaugeRecord:
    """The signal of a gauge from the arrival of the first wave to the end of what the motion decides.

    On an even grid of so many `points`, with jumps twice on top.

    Raises
    ------
    ValueError
        For an unknown bar, or a place that is not on it.
    """
    number = check_position(motion, bar, position)
    delay = position / motion.wave_speed
    begin, end = (-1.1 * delay if number == 0 else 0.0), float(last_time(motion, bar, position))
    grid = np.linspace(begin, end, points)
    jumps = _jumps(motion, number)
    jumps = np.unique(np.concatenate([jumps - delay, jumps + delay]))
    jumps = jumps[(jumps > begin) & (jumps < end)]
    times = np.concatenate([grid, jumps, jumps])
    sides = np.concatenate([np.ones(len(grid)), -np.ones(len(jumps)), np.ones(len(jumps))])
    order = np.lexsort((sides, times))
    times, sides = times[order], sides[order]
    strain = gauge_strain(motion, bar, position, times, sides=sides)
    return GaugeRecord(
        bar=bar, position=position, time=times, strain=strain, overlaps=overlaps(motion, bar, position),
        clean_until=_clean_until(motion, number, delay),
    )  # fmt: skip


def default_positions(motion: Motion) -> tuple[tuple[str, float], ...]:
    """Where gauges are put that nobody placed: half-way along, as in the paper; a bar without a length has none."""
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

    The incident and the reflected wave overlap for position < c0 t_pulse/2; the wave that leaves the sphere is met by
    its own reflection where it is not over by then, that is, below 1 % of its largest value for good.

    Raises
    ------
    ValueError
        For an unknown bar, or a place that is not on it.
    """
    number = check_position(motion, bar, position)
    delay = position / motion.wave_speed
    names = ("reflected", "its return from the struck end") if number == 0 else ("transmitted", "its return")
    found = []
    if number == 0 and motion.pulse_end > 2.0 * delay:
        # a step overlaps to the end of what is known
        end = min(motion.pulse_end - delay, float(last_time(motion, bar, position)))
        found.append(Overlap(first="incident", second="reflected", begin=delay, end=end))
    back = _clean_until(motion, number, delay)
    if back < min(motion.round_trip(number), motion.horizon):
        looks = np.linspace(0.0, min(motion.round_trip(number), motion.horizon), _LOOKS)
        wave = np.abs(leaving(motion, number, looks, sides=-np.ones_like(looks)))
        above = looks[wave > _OVER * wave.max()]
        if above.size and above[-1] > back:
            found.append(Overlap(first=names[0], second=names[1], begin=back + delay, end=float(above[-1]) + delay))
    return tuple(found)


def _clean_until(motion: Motion, number: int, delay: float) -> float:
    """Time at the face [s] up to which the wave that leaves it passes a gauge before it has come back there."""
    return np.inf if not motion.echoes(number) else motion.round_trip(number) - 2.0 * delay


# --- forces -------------------------------------------------------------------------------------------


def bar_forces(motion: Motion, incident_position: float, receiving_position: float, *, points: int = 2000,
               ) -> BarForces:  # fmt: skip
    """Forces at the faces from the signals of two gauges, as an experimentalist takes them.

    The record of the incident bar is cut half-way between the passages of the pulse and of its reflection, and the
    three waves are shifted to the faces by the way from the gauge:

        P_B = -E F0 eps_t (one wave),   P_A = -E F0 (eps_i + eps_r) (two waves),   (P_A + P_B)/2 (three waves).

    Parameters
    ----------
    incident_position, receiving_position : float
        Distances of the gauges from the sphere [m].
    points : int
        Instants from first touch to the first echo in a record, or to the horizon.

    Raises
    ------
    ValueError
        Where the incident and the reflected wave overlap at the gauge, or no time is left before an echo.

    Notes
    -----
    G. T. Gray III, Classic split-Hopkinson pressure bar testing, ASM Handbook 8, 2000 (names of the analyses).
    """
    check_position(motion, "incident", incident_position)
    check_position(motion, "receiving", receiving_position)
    delays = [position / motion.wave_speed for position in (incident_position, receiving_position)]
    if not np.isfinite(motion.pulse_end):
        raise ValueError("a step never ends, so that incident and reflected wave overlap at any gauge")
    if motion.pulse_end > 2.0 * delays[0] * (1.0 + 1e-12):
        raise ValueError(
            f"the pulse of {motion.pulse_end * 1e6:.6g} us overlaps with its reflection at {incident_position:g} m "
            f"from the sphere: the gauge must be at least {0.5 * motion.wave_speed * motion.pulse_end:.4g} m away"
        )
    end = min(motion.horizon, *(_clean_until(motion, bar, delays[bar]) for bar in (0, 1)))
    if not end > 0.0:
        raise ValueError("no time is left between a wave and its return: a gauge is at the far end of its bar")
    # up to the end and not with it, where the echo jumps in
    times = np.linspace(0.0, end, points)
    sides = np.where(times < end, 1.0, -1.0)
    incident = np.zeros_like(times)
    first = times < 2.0 * delays[0]
    incident[first] = gauge_strain(motion, "incident", incident_position, times[first] - delays[0])
    reflected = gauge_strain(motion, "incident", incident_position, times + delays[0], sides=sides)
    transmitted = gauge_strain(motion, "receiving", receiving_position, times + delays[1], sides=sides)
    stiffness = float(motion.scene.columns["bars.E"][motion.row]) * motion.section
    one, two = -stiffness * transmitted, -stiffness * (incident + reflected)
    return BarForces(time=times, one_wave=one, two_wave=two, three_wave=0.5 * (one + two), end=end)


def force_imbalance(force_a: Values, force_b: Values) -> Array:
    """R = 2 |P_A - P_B|/(P_A + P_B), (m,): 0 in equilibrium, 2 where one face alone is pressed, 0 where none is.

    G. Ravichandran, G. Subhash, J. Am. Ceram. Soc. 77(1), 1994, 263-267, who ask for R <= 0.05.

    >>> force_imbalance([0.0, 1.0, 1.0], [0.0, 0.0, 0.9]).round(4).tolist()
    [0.0, 2.0, 0.1053]
    """
    force_a, force_b = np.asarray(force_a, dtype=float), np.asarray(force_b, dtype=float)
    total = force_a + force_b
    return np.asarray(2.0 * np.abs(force_a - force_b) / np.where(total > 0.0, total, 1.0))
