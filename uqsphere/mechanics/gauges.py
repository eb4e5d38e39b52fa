"""What strain gauges on the bars see, and what is read off their signals: forces, equilibrium, energies.

The paper's (3.17) holds for gauges half-way along, bars of equal length and no reflection; here a gauge sits
anywhere, and every reflection is in its signal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.field import (
    BARS,
    Solution,
    arriving,
    check_position,
    field_at,
    force_at,
    last_time,
    leaving,
    states_at,
)
from uqsphere.mechanics.history import History, largest

__all__ = [
    "BarForces",
    "Energies",
    "Equilibrium",
    "GaugeRecord",
    "Overlap",
    "bar_forces",
    "default_positions",
    "equilibrium",
    "force_imbalance",
    "gauge_record",
    "gauge_strain",
    "overlaps",
    "wave_energies",
]

Array = npt.NDArray[np.float64]

#: a wave is over once it stays below this share of its largest value
_OVER: Final = 0.01
#: instants at which a wave is looked at to see when it is over
_LOOKS: Final = 4000
#: points of a step's quadrature, parts of a step that are scanned, halvings that leave nothing of one
_GAUSS: Final = 8
_SCAN: Final = 16
_HALVINGS: Final = 52


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


@dataclass(frozen=True, kw_only=True)
class Equilibrium:
    """When the imbalance is within `level`: at first, and from when on up to `until` [s]; None: never.

    `until` is the time of the largest force before a reflected wave returns or contact is lost.
    """

    level: float
    first: float | None
    lasting: float | None
    until: float


@dataclass(frozen=True, kw_only=True)
class Energies:
    """What the waves have carried past the faces up to some time, and what is left with the sphere [J]."""

    incident: float
    reflected: float
    transmitted: float
    returned: float

    @property
    def absorbed(self) -> float:
        """Energy that came and did not go: both contacts and the sphere's motion hold it."""
        return self.incident + self.returned - self.reflected - self.transmitted


# --- signals ------------------------------------------------------------------------------------------


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
    >>> float(gauge_strain(found, "incident", 0.75, [-100e-6])[0]) * 1e6    # the pulse: -v0/(2 c0) once it has risen
    -51.2989...
    """
    check_position(history.solution, bar, position)
    stress = field_at(history, bar, position, times, sides=sides).stress
    return np.asarray(stress / float(history.solution.scene.columns["bars.E"][history.solution.row]))


def gauge_record(history: History, bar: str, position: float) -> GaugeRecord:
    """The signal of a gauge from the arrival of the first wave to the end of what the history decides.

    Raises
    ------
    ValueError
        For an unknown bar, or a place that is not on it.
    """
    solution = history.solution
    number = check_position(solution, bar, position)
    delay = position / solution.wave_speed
    begin, end = (-1.1 * delay if number == 0 else 0.0), float(last_time(solution, bar, position))
    grid = np.linspace(begin, end, len(history.time))
    jumps = _jumps(solution, number)
    jumps = np.unique(np.concatenate([jumps - delay, jumps + delay]))
    jumps = jumps[(jumps > begin) & (jumps < end)]
    times = np.concatenate([grid, jumps, jumps])
    sides = np.concatenate([np.ones(len(grid)), -np.ones(len(jumps)), np.ones(len(jumps))])
    order = np.lexsort((sides, times))
    times, sides = times[order], sides[order]
    strain = gauge_strain(history, bar, position, times, sides=sides)
    return GaugeRecord(
        bar=bar, position=position, time=times, strain=strain, overlaps=overlaps(history, bar, position),
        clean_until=_clean_until(solution, number, delay),
    )  # fmt: skip


def default_positions(history: History) -> tuple[tuple[str, float], ...]:
    """Where gauges are put that nobody placed: half-way along, as in the paper; a bar without a length has none."""
    solution = history.solution
    places = []
    for number, bar in enumerate(BARS):
        half = 0.25 * solution.wave_speed * solution.round_trip(number)
        if np.isfinite(half):
            places.append((bar, half))
    return tuple(places)


def _jumps(solution: Solution, number: int) -> Array:
    """When a wave of a bar jumps or bends at the face: the pulse, and what has come back of it."""
    breaks = solution.scene.pulse.breaks[solution.row]
    breaks = breaks[np.isfinite(breaks)] if number == 0 else np.zeros(0)
    if not solution.echoes(number):
        return np.asarray(breaks)
    trips = np.arange(1 + int(min(solution.horizon / solution.round_trip(number), 16.0)))
    return np.asarray((breaks[:, None] + trips * solution.round_trip(number)).ravel())


def overlaps(history: History, bar: str, position: float) -> tuple[Overlap, ...]:
    """Where a gauge sees two waves at once.

    The incident and the reflected wave overlap for position < c0 t_pulse/2; the wave that leaves the sphere is met by
    its own reflection where it is not over by then, that is, below 1 % of its largest value for good.

    Raises
    ------
    ValueError
        For an unknown bar, or a place that is not on it.
    """
    solution = history.solution
    number = check_position(solution, bar, position)
    delay = position / solution.wave_speed
    names = ("reflected", "its return from the struck end") if number == 0 else ("transmitted", "its return")
    found = []
    if number == 0 and solution.pulse_end > 2.0 * delay:
        # a step overlaps to the end of what is known
        end = min(solution.pulse_end - delay, float(last_time(solution, bar, position)))
        found.append(Overlap(first="incident", second="reflected", begin=delay, end=end))
    back = _clean_until(solution, number, delay)
    if back < min(solution.round_trip(number), solution.horizon):
        looks = np.linspace(0.0, min(solution.round_trip(number), solution.horizon), _LOOKS)
        wave = np.abs(leaving(solution, number, looks, sides=-np.ones_like(looks)))
        above = looks[wave > _OVER * wave.max()]
        if above.size and above[-1] > back:
            found.append(Overlap(first=names[0], second=names[1], begin=back + delay, end=float(above[-1]) + delay))
    return tuple(found)


def _clean_until(solution: Solution, number: int, delay: float) -> float:
    """Time at the face [s] up to which the wave that leaves it passes a gauge before it has come back there."""
    return np.inf if not solution.echoes(number) else solution.round_trip(number) - 2.0 * delay


# --- forces -------------------------------------------------------------------------------------------


def bar_forces(history: History, incident_position: float, receiving_position: float, *, points: int = 2000,
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
    solution = history.solution
    check_position(solution, "incident", incident_position)
    check_position(solution, "receiving", receiving_position)
    delays = [position / solution.wave_speed for position in (incident_position, receiving_position)]
    if not np.isfinite(solution.pulse_end):
        raise ValueError("a step never ends, so that incident and reflected wave overlap at any gauge")
    if solution.pulse_end > 2.0 * delays[0] * (1.0 + 1e-12):
        raise ValueError(
            f"the pulse of {solution.pulse_end * 1e6:.6g} us overlaps with its reflection at {incident_position:g} m "
            f"from the sphere: the gauge must be at least {0.5 * solution.wave_speed * solution.pulse_end:.4g} m away"
        )
    end = min(solution.horizon, *(_clean_until(solution, bar, delays[bar]) for bar in (0, 1)))
    if not end > 0.0:
        raise ValueError("no time is left between a wave and its return: a gauge is at the far end of its bar")
    # up to the end and not with it, where the echo jumps in
    times = np.linspace(0.0, end, points)
    sides = np.where(times < end, 1.0, -1.0)
    incident = np.zeros_like(times)
    first = times < 2.0 * delays[0]
    incident[first] = gauge_strain(history, "incident", incident_position, times[first] - delays[0])
    reflected = gauge_strain(history, "incident", incident_position, times + delays[0], sides=sides)
    transmitted = gauge_strain(history, "receiving", receiving_position, times + delays[1], sides=sides)
    stiffness = float(solution.scene.columns["bars.E"][solution.row]) * solution.section
    one, two = -stiffness * transmitted, -stiffness * (incident + reflected)
    return BarForces(time=times, one_wave=one, two_wave=two, three_wave=0.5 * (one + two), end=end)


def force_imbalance(force_a: Any, force_b: Any) -> Array:
    """R = 2 |P_A - P_B|/(P_A + P_B), (m,): 0 in equilibrium, 2 where one face alone is pressed, 0 where none is.

    G. Ravichandran, G. Subhash, J. Am. Ceram. Soc. 77(1), 1994, 263-267, who ask for R <= 0.05.

    >>> force_imbalance([0.0, 1.0, 1.0], [0.0, 0.0, 0.9]).round(4).tolist()
    [0.0, 2.0, 0.1053]
    """
    force_a, force_b = np.asarray(force_a, dtype=float), np.asarray(force_b, dtype=float)
    total = force_a + force_b
    return np.asarray(2.0 * np.abs(force_a - force_b) / np.where(total > 0.0, total, 1.0))


def equilibrium(history: History, level: float = 0.05) -> Equilibrium:
    """When the two contact forces agree within a level of `force_imbalance`, up to the first loading's largest force.

    Parameters
    ----------
    level : float
        Largest imbalance that counts as equilibrium, between 0 and 2.

    Raises
    ------
    ValueError
        For a level outside its range.
    """
    if not 0.0 < level < 2.0:
        raise ValueError(f"the level of equilibrium must lie between 0 and 2, found {level!r}")
    solution = history.solution
    loading = min(history.record_end, float(solution.scene.first_echo[solution.row]))
    peak = largest(solution.scene, solution.row, solution.motion, 0.0, loading, fidelity=solution.fidelity)
    if peak is None:
        return Equilibrium(level=level, first=None, lasting=None, until=loading)
    end = peak.time

    def excess(times: Array) -> Array:
        forces = _forces(solution, times)
        # before first touch there is no equilibrium to speak of
        return np.where(forces.sum(axis=1) > 0.0, force_imbalance(forces[:, 0], forces[:, 1]), 2.0) - level

    unit = float(solution.scene.scales.time[solution.row])
    motion = solution.motion
    inner = ((motion.start[:, None] + motion.length[:, None] * np.arange(_SCAN) / _SCAN) * unit).ravel()
    nodes = np.concatenate([[0.0], inner[(inner > 0.0) & (inner < end)], [end]])
    outside = excess(nodes) > 0.0
    entries = np.flatnonzero(outside[:-1] & ~outside[1:])
    if len(entries) == 0:
        return Equilibrium(level=level, first=None, lasting=None, until=end)
    low, high = nodes[entries], nodes[entries + 1]
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        above = excess(middle) > 0.0
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    lasting = None if outside[-1] else float(high[-1])
    return Equilibrium(level=level, first=float(high[0]), lasting=lasting, until=end)


def _forces(solution: Solution, times: Array) -> Array:
    """Contact forces at both faces [N], (m, 2)."""
    approaches = states_at(solution.scene, solution.row, solution.motion, times)[:, :2]
    return force_at(solution.scene, solution.row, approaches, solution.fidelity)


# --- energies -----------------------------------------------------------------------------------------


def wave_energies(history: History, time: float) -> Energies:
    """What the waves carried past the faces from first touch to `time`: Z ∫ v² dt of each, theory (6).

    Parameters
    ----------
    time : float
        Instant [s] between 0 and the horizon.

    Raises
    ------
    ValueError
        For a time outside the history.
    """
    solution = history.solution
    if not 0.0 <= time <= solution.horizon * (1.0 + 1e-9):
        raise ValueError(f"the history lasts from 0 to {solution.horizon:.6g} s, found {time!r}")
    starts = solution.motion.start * float(solution.scene.scales.time[solution.row])
    cuts = [starts, np.array([0.0, time])]
    for number in (0, 1):
        cuts.append(_jumps(solution, 0))
        if solution.echoes(number):
            trips = np.arange(1, 2 + int(min(time / solution.round_trip(number), 64.0)))
            # the waves have the kinks of the forces of earlier round trips besides those of the present
            cuts.append((starts[:, None] + trips * solution.round_trip(number)).ravel())
    nodes = np.unique(np.concatenate(cuts))
    nodes = nodes[(nodes >= 0.0) & (nodes <= time)]
    points, weights = np.polynomial.legendre.leggauss(_GAUSS)
    half = 0.5 * np.diff(nodes)
    times = ((nodes[:-1] + half)[:, None] + half[:, None] * points).ravel()
    share = (half[:, None] * weights).ravel() * solution.impedance

    def energy(wave: Array) -> float:
        return float(np.square(wave) @ share)

    return Energies(
        incident=energy(arriving(solution, 0, times)), reflected=energy(leaving(solution, 0, times)),
        transmitted=energy(leaving(solution, 1, times)), returned=energy(arriving(solution, 1, times)),
    )  # fmt: skip
