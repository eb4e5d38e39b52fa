"""From gauges to faces: the three waves at the sphere, on one time axis, with their noise.

The incident gauge stands a distance d_1 before face A, the receiving gauge d_3 behind face B.  The incident wave
reaches A d_1/c0 after its gauge, the reflected wave left A d_1/c0 before it, the transmitted wave left B d_3/c0
before its own.
Of one gauge that sees incident and reflected wave both, the first must be over before the second arrives.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from uqsphere.arrays import Array, Places
from uqsphere.mechanics import bars, contact
from uqsphere.mechanics.field import waves_at
from uqsphere.mechanics.integrator.solve import Motion, motion
from uqsphere.mechanics.pulses import NOISE_MODES, MeasuredPulse, noise_names, pulse_value
from uqsphere.mechanics.scene import Scene
from uqsphere.records.pulse import WINDOW, Bar, CutPulse, carried, cut_pulse, fit_pulse
from uqsphere.records.record import Record
from uqsphere.records.table import RecordError
from uqsphere.uq.estimate import NORMAL

#: samples at the faces, at the least
_FEWEST: Final = 50
#: bending over the wave, as standard deviation, where one gauge of a bar stands alone: of seven real rock tests the
#: pairs of gauges show 0.02 to 0.05 under the incident wave
_BENT: Final = 0.04
#: share of its peak that the tail of the incident wave may have where the reflected one comes to the same gauge, and
#: part of the time between the two over which they may meet
_TAIL, _MEETING = 0.10, 0.25


@dataclass(frozen=True, kw_only=True)
class Rig:
    """Bars and gauges.

    incident_gauge, receiving_gauge : distances from the sphere [m].
    incident_length, receiving_length : of the bars [m]; infinite where nothing comes back.
    absorbing_length : of the bars whose ends are said to send nothing back [m]: from its gauge to there, the shorter
    one.
    receiving_bar : where it is another than the incident bar.
    """

    bar: Bar
    incident_gauge: float
    receiving_gauge: float
    incident_length: float = math.inf
    receiving_length: float = math.inf
    correct_dispersion: bool = False
    absorbing_length: float = math.inf
    receiving_bar: Bar | None = None

    def __post_init__(self) -> None:
        for name in ("incident", "receiving"):
            gauge, length = getattr(self, f"{name}_gauge"), getattr(self, f"{name}_length")
            if not 0.0 <= gauge < math.inf or gauge > length:
                raise RecordError(
                    f"the {name} gauge, {gauge:.4g} m from the sphere, must sit on its bar of {length:.4g} m"
                )

    @property
    def undisturbed(self) -> float:
        """Time after first touch up to which no wave from a far end mixes with those at the gauges [s]."""
        return 2.0 * min((self.incident_length - self.incident_gauge) / self.bar.wave_speed,
                         (self.receiving_length - self.receiving_gauge) / self.behind.wave_speed)  # fmt: skip

    @property
    def behind(self) -> Bar:
        """The receiving bar."""
        return self.receiving_bar or self.bar


@dataclass(frozen=True, kw_only=True)
class Faces:
    """Strains of the three waves at the faces, tension positive, on one time axis.

    step : time between samples [s]; the first is the begin of the incident wave at face A.
    incident, reflected, transmitted : (n,) arrays
    noise, memory, offset : (3,) arrays; of the three: standard deviation of a sample, samples over which it is
    correlated, standard deviation of the baseline.
    known : samples of the incident wave; it is taken as over behind them.
    shared : incident and reflected wave come from one gauge, and share gain and baseline.
    overlap : (n,) array; strain by which the tail of the incident wave may be wrong at face A, where it meets the
    reflected one.
    alone : tuple of bool; whether the incident, and the receiving, bar's signal lacks a gauge that would show bending.
    spread : (n,) array; bending that the gauges of the receiving bar show, 0 with one.
    merged : the two overlap by more than a tail: only the force at B is known.
    pulse : CutPulse; the incident wave as samples.
    """

    step: float
    incident: Array
    reflected: Array
    transmitted: Array
    noise: Array
    memory: Array
    offset: Array
    known: int
    shared: bool
    overlap: Array
    spread: Array
    alone: tuple[bool, bool]
    pulse: CutPulse
    notes: tuple[str, ...]
    merged: bool = False

    @property
    def time(self) -> Array:
        """Time since the incident wave reached face A, (n,) [s]."""
        return np.asarray(self.step * np.arange(len(self.incident)), dtype=float)


def _read_at(values: Array, place: float, count: int) -> tuple[Array, float]:
    """`count` samples from a place between samples on, by cubics through four, and what that does to white noise."""
    whole = math.floor(place)
    x = place - whole
    weights = np.array([-x * (x - 1) * (x - 2) / 6, (x + 1) * (x - 1) * (x - 2) / 2, -(x + 1) * x * (x - 2) / 2,
                        (x + 1) * x * (x - 1) / 6])  # fmt: skip
    padded = np.concatenate([np.full(2, values[0]), values, np.full(4, values[-1])])
    base = whole + 2
    if base < 1 or base + count + 2 > len(padded):
        raise RecordError("the record ends before the wave that is looked for")
    found = sum(weight * padded[base - 1 + k : base - 1 + k + count] for k, weight in enumerate(weights))
    return np.asarray(found), float(np.sqrt(np.square(weights).sum()))


def _carried(values: Array, step: float, bar: Bar, distance: float) -> tuple[Array, float]:
    """A whole signal as it was, or will be, a distance along its way, and what that does to white noise."""
    room = max(256, len(values) // 8)
    # the signal need not end at rest: it is led back to zero behind its end
    tail = values[-1] * (0.5 + 0.5 * np.cos(np.pi * (np.arange(room) + 1.0) / room))
    wave = np.concatenate([np.zeros(room), values, tail, np.zeros(room)])
    there, factor = carried(wave, step, bar, distance)
    return there[room : room + len(values)], float(np.sqrt(np.square(np.abs(factor)).mean()))


def at_faces(record: Record, rig: Rig, *, begin: float | None = None, end: float | None = None) -> Faces:
    """The three waves at the faces.

    record : with baseline and sign; two signals (gauge of the incident bar, gauge of the receiving bar) or three
    (incident, reflected and transmitted wave, each alone).
    begin, end : times in the record between which the incident wave passes its gauge [s].

    Raises RecordError where waves overlap at a gauge, a part is missing, or fewer than 50 samples are left.
    """
    signals = record.strain.shape[1]
    if signals not in (2, 3):
        raise RecordError(f"found {signals} signals; two (one gauge per bar) or three waves are due")
    bar, step, length, shared = rig.bar, record.step, len(record.strain), signals == 2
    delay = 2.0 * rig.incident_gauge / bar.wave_speed / step
    cut, tail = _incident(record, rig, delay if shared else math.inf, begin, end)
    # places of samples: the incident wave at its gauge, the reflected one there, the transmitted one at the other
    first = (cut.begin - record.start) / step
    again = first + delay
    behind = first + (rig.incident_gauge / bar.wave_speed + rig.receiving_gauge / rig.behind.wave_speed) / step
    count, notes = _samples(int(min(length - 3 - again, length - 3 - behind)), rig, step)
    channels = [0, 0, 1] if shared else [0, 1, 2]
    count = _known(record, [(channels[1], int(again)), (channels[2], int(behind))], count, notes)
    grown, waves = np.ones(3), []
    for k, place, way in ((1, again, -rig.incident_gauge), (2, behind, -rig.receiving_gauge)):
        values = record.strain[:, channels[k]]
        if rig.correct_dispersion:
            alone = _within(values, int(again) if k == 1 and shared else 0, length)
            values, grown[k] = _carried(alone, step, bar if k == 1 else rig.behind, way)
        wave, spread = _read_at(values, place, count)
        grown[k] *= spread
        waves.append(wave)
    # behind its window the incident wave is known until the reflected one comes to the same gauge
    last = min(count, int(delay)) if shared else count
    incident = np.zeros(count)
    values = record.strain[:, 0]
    if rig.correct_dispersion:
        alone = _within(values, 0, int(again) + 1 if shared else length)
        values, grown[0] = _carried(alone, step, bar, rig.incident_gauge)
    incident[:last] = values[round(first) : round(first) + last]
    noise, memory = record.noise[channels] * grown, record.memory[channels] / np.square(grown)
    # the tail of the incident wave stands in the beginning of the reflected one, and is missing where it belongs
    # where it is no tail any more nobody knows where the two part
    much = tail > _TAIL * float(cut.strain.max())
    overlap, over = np.zeros(count), count if much else round(_MEETING * delay) if tail else 0
    overlap[:over] = tail
    overlap[last:][:over] = tail
    return Faces(
        step=step, incident=incident, reflected=waves[0], transmitted=waves[1], noise=noise, memory=memory,
        offset=record.offset[channels], known=last, shared=shared, pulse=cut, notes=(*cut.notes, *notes),
        overlap=overlap, merged=much, alone=(bool(record.alone[channels[0]]), bool(record.alone[channels[2]])),
        spread=_read_at(record.spread[:, channels[2]], behind, count)[0],
    )  # fmt: skip


def _incident(record: Record, rig: Rig, delay: float, begin: float | None,
              end: float | None) -> tuple[CutPulse, float]:  # fmt: skip
    """The incident wave, which one gauge must see before the reflected one `delay` samples later, and the strain of
    its tail that meets that."""
    bar, step = rig.bar, record.step
    distance = rig.incident_gauge if rig.correct_dispersion else 0.0
    cut = cut_pulse(record, begin=begin, end=end)
    lasts, tail = len(cut.strain) - 1, 0.0
    if lasts > delay * (1.0 + 1e-9):
        # of a long foot and tail the wave is what stands between; a part of its tail may meet the reflected one
        strain = cut.strain
        peak, split = float(strain.max()), int(delay)
        tail = float(np.abs(strain[split:]).max())
        end = record.start + step * (round((cut.begin - record.start) / step) + split)
        cut = cut_pulse(record, begin=cut.begin, end=end)
        said = f"the tail of the pulse, {tail / peak:.1%} of its peak, meets the reflected wave: the force at A is "
        if tail > _TAIL * peak:
            said = (
                f"incident and reflected wave overlap at the incident gauge: the pulse lasts {lasts * step * 1e6:.4g} "
                f"us, and {delay * step * 1e6:.4g} us lie between the two at {rig.incident_gauge:.4g} m from the "
                f"sphere, where {tail / peak:.0%} of its peak are left; shorten the pulse, set the gauge further back, "
                f"or say where the pulse stands by {WINDOW}; the force at A is "
            )
        cut = replace(cut, notes=(*cut.notes, f"{said}so much less sure there"))
    if distance:
        notes = cut.notes[len(record.notes) :]
        cut = cut_pulse(record, bar=bar, distance=distance, begin=cut.begin if tail else begin, end=end)
        cut = replace(cut, notes=(*cut.notes, *notes))
    return cut, tail


def _known(record: Record, waves: list[tuple[int, int]], count: int, notes: list[str]) -> int:
    """Samples of the reflected and the transmitted wave before the first that nobody knows."""
    left = count
    for signal, place in waves:
        lost = np.flatnonzero(record.held[max(place, 0) : place + count, signal])
        if len(lost) and int(lost[0]) < left:
            left = int(lost[0])
            if left < _FEWEST:
                record.refuse_held(signal, place, place + count, "in the reflected or transmitted wave")
            notes.append(
                f"{record.names[signal]}: samples are not known from {left * record.step * 1e6:.4g} us after first "
                "touch on: what is later is left out"
            )
    return left


def _samples(count: int, rig: Rig, step: float) -> tuple[int, list[str]]:
    """Samples at the faces, those left out into which waves from the far ends mix."""
    notes = []
    if math.isfinite(rig.undisturbed) and int(rig.undisturbed / step) < count:
        count = int(rig.undisturbed / step)
        notes = [f"waves from the far ends mix in after {rig.undisturbed * 1e6:.4g} us: what is later is left out"]
    silent = 2.0 * rig.absorbing_length / rig.bar.wave_speed
    if count * step > silent:
        notes.append(
            f"the record outlasts the {silent * 1e6:.4g} us that a wave takes to an end called absorbing and back: if "
            "that end does not absorb, what is later is wrong"
        )
    if count < _FEWEST:
        raise RecordError(
            f"{max(count, 0)} samples are left behind first touch, {_FEWEST} at least are needed: the record ends "
            f"before the wave that is looked for, or {WINDOW} says where the incident wave stands"
        )
    return count, notes


def _within(values: Array, first: int, last: int) -> Array:
    """The signal without the waves that pass before `first` and from `last` on."""
    left = np.zeros_like(values)
    left[max(first, 0) : last] = values[max(first, 0) : last]
    return left


# --- what a test says ----------------------------------------------------------------------------------
#
# Forces follow from the waves alone, P_A = -E_b F_0 (eps_i + eps_r) and P_B = -E_b F_0 eps_t, with no model in between.
# The stiffness is the reduced modulus E* with which the model of theory (3), driven by the measured incident wave,
# shows the reflected and transmitted waves that were measured: weighted least squares over E*, the gains, small shifts
# of time and the noise of the incident wave, each but E* with its prior, so that the interval of E* has all of them.
# Blocks of the residuals say whether one E* serves from first touch to the end; if not, the blocks are taken in one by
# one, and the first that the fit to those before it does not foresee holds the point of departure.

#: blocks of a record, and the residual of a block over its standard deviation that no chance explains
_BLOCKS, _ODD = 24, 4.5
#: blocks that one fit has to foresee
_AHEAD: Final = 3
#: share of the largest force above which a departure is looked for, and samples of a block at the least
_LOADED, _FEWEST_INVERSE = 0.1, 8
#: what the model and the cubics of the pulse leave of a record without noise, over its peak
_FLOOR: Final = 2e-4
#: samples over which that lasts
_LASTING: Final = 25.0
_TOLERANCE: Final = 1e-7
# parameters: log E*, log gains of both gauges, shifts of the reflected and the transmitted wave, noise of the pulse,
# baselines of the three waves
_MODULUS, _GAIN_A, _GAIN_B, _SHIFT_A, _SHIFT_B, _NOISE = range(6)
_BASE: Final = _NOISE + NOISE_MODES
#: numbers of the scene that the model takes
_NEEDED: Final = ("sphere.E", "sphere.nu", "sphere.radius", "sphere.density", "bars.E", "bars.nu", "bars.density",
                  "bars.diameter")  # fmt: skip
_COUNT: Final = _BASE + 3


@dataclass(frozen=True, kw_only=True)
class Forces:
    """Forces at the faces from the waves alone [N], (n,), with the standard deviations of noise, baseline and gain."""

    time: Array
    force_a: Array
    force_b: Array
    sd_a: Array
    sd_b: Array

    def interval(self, face: str) -> tuple[Array, Array]:
        """Limits that hold the true force with 95 % at every instant, (n,), (n,) [N]."""
        force, sd = {"A": (self.force_a, self.sd_a), "B": (self.force_b, self.sd_b)}[face]
        return force - NORMAL * sd, force + NORMAL * sd


@dataclass(frozen=True, kw_only=True)
class Stiffness:
    """E* [Pa] with its 95 % interval and what the study `expected`; gains that the fit prefers; misfit over noise, 1 if
    the noise explains it all, and what is left `unexplained` over the largest transmitted wave."""

    modulus: float
    low: float
    high: float
    std_error: float
    gain_a: float
    gain_b: float
    misfit: float
    unexplained: float
    expected: float
    samples: int


@dataclass(frozen=True, kw_only=True)
class Departure:
    """Where the elastic contact ends: time and the blocks it lies in [s], forces with 95 % intervals [N]."""

    time: float
    earliest: float
    latest: float
    force_a: tuple[float, float, float]
    force_b: tuple[float, float, float]
    excess: float


@dataclass(frozen=True, kw_only=True)
class Inverse:
    """The answer of one test.

    `fitted_a`, `fitted_b` (n,) [N]: forces of the model at the stiffness that fits, on to the end of the record.
    `departure` is None where the elastic law held throughout.
    """

    forces: Forces
    stiffness: Stiffness
    fitted_a: Array
    fitted_b: Array
    departure: Departure | None
    pulse: MeasuredPulse
    notes: tuple[str, ...] = field(default=())

    @property
    def held(self) -> bool:
        """Whether the elastic contact law explains the record from first touch to its end."""
        return self.departure is None


def _stiffness_of_bar(columns: Mapping[str, float]) -> float:
    return float(columns["bars.E"] * bars.section(columns["bars.diameter"]))


def forces_of(faces: Faces, columns: Mapping[str, float], gain_sd: float = 0.0,
              receiving: float | None = None) -> Forces:  # fmt: skip
    """Forces at the faces by two waves at A and one at B.

    columns : numbers of the scene, SI; the bars are needed.
    gain_sd : relative standard deviation of the gain of each gauge, which is taken as 1.
    receiving : E A of the receiving bar [N], where it is another.
    """
    scale = _stiffness_of_bar(columns)
    scale_b = scale if receiving is None else receiving
    force_a = -scale * (faces.incident + faces.reflected)
    force_b = -scale_b * faces.transmitted
    base_a = (faces.offset[0] + faces.offset[1]) if faces.shared else math.hypot(faces.offset[0], faces.offset[1])
    # where the incident wave is taken as over there is no noise of it
    there = np.arange(len(force_a)) < faces.known
    noise_a = np.square(faces.noise[1]) + np.where(there, np.square(faces.noise[0]), 0.0)
    rest_a = np.where(there, np.square(base_a), np.square(faces.offset[1]))
    if faces.shared:
        gained = np.square(gain_sd * force_a)
    else:
        gained = np.square(gain_sd * scale) * (np.square(faces.incident) + np.square(faces.reflected))
    # bending that a gauge left out would have shown goes with the wave at the gauge, not with the force
    gained = gained + (faces.alone[0] * _BENT * scale) ** 2 * (np.square(faces.incident) + np.square(faces.reflected))
    gain_b = math.hypot(gain_sd, faces.alone[1] * _BENT)
    sd_a = np.sqrt(np.square(scale) * (noise_a + rest_a + np.square(faces.overlap)) + gained)
    sd_b = np.sqrt(np.square(scale_b) * (np.square(faces.noise[2]) + np.square(faces.offset[2]))
                   + np.square(gain_b * force_b))  # fmt: skip
    return Forces(time=faces.time, force_a=force_a, force_b=force_b, sd_a=sd_a, sd_b=sd_b)


class _Fit:
    """The model of one test over its parameters; motions are kept, for shifts and gauge gains need no new one."""

    def __init__(self, faces: Faces, columns: Mapping[str, float], gain_sd: float) -> None:
        self.faces, self.columns = faces, dict(columns)
        self.pulse = fit_pulse(faces.pulse)
        self.speed = float(bars.wave_speed(columns["bars.E"], columns["bars.density"]))
        cut, curve = faces.pulse, self.pulse.pulse(1, {})
        places = np.asarray(cut.step * np.arange(len(cut.strain)), dtype=float)
        misfit = np.square(cut.strain - self.pulse.peak * pulse_value(curve, 0, places))
        # what the cubics miss of the pulse is no noise: it comes back in many samples at once
        missed = _LASTING * (max(float(misfit.mean()) - cut.noise**2, 0.0) + (_FLOOR * self.pulse.peak) ** 2)
        # the sums of correlated noise scatter by its memory more
        self.sd = np.sqrt(np.square(faces.noise[1:]) * np.maximum(faces.memory[1:], 1e-3) + missed)
        self.prior = np.full(_COUNT, np.inf)
        self.prior[[_GAIN_A, _GAIN_B]] = max(gain_sd, 1e-9)
        self.prior[[_SHIFT_A, _SHIFT_B]] = max(faces.step, 1e-12)
        self.prior[_NOISE:] = 1.0
        self.start = np.zeros(_COUNT)
        self.start[_MODULUS] = math.log(float(contact.reduced_modulus(
            columns["sphere.E"], columns["sphere.nu"], columns["bars.E"], columns["bars.nu"])))  # fmt: skip
        self.kept: dict[bytes, Motion] = {}

    def motion(self, parameters: Array) -> Motion:
        # what the baseline is off by lies under the whole pulse: a box, by its share of each mode of the noise
        scale = self.pulse.noise * self.pulse.peak
        box = parameters[_BASE] * self.faces.offset[0] / scale if scale > 0.0 else 0.0
        modes = [
            float(parameters[_NOISE + j - 1]) + (box * 2.0 * math.sqrt(2.0) / (j * math.pi) if j % 2 else 0.0)
            for j in range(1, NOISE_MODES + 1)
        ]
        key = np.array([parameters[_MODULUS], parameters[_GAIN_A], *modes]).tobytes()
        if key not in self.kept:
            modulus, gain = math.exp(parameters[_MODULUS]), math.exp(parameters[_GAIN_A])
            columns = {name: np.array([value]) for name, value in self.columns.items()}
            # E* itself is the parameter: 1/E* = (1 - nu²)/E between bars that do not yield
            columns["sphere.E"] = np.array([modulus * (1.0 - self.columns["sphere.nu"] ** 2)])
            columns["striker.speed"] = np.array([2.0 * self.speed * self.pulse.peak * gain])
            for name, mode in zip(noise_names(), modes, strict=True):
                columns[name] = np.array([mode])
            end = self.faces.step * len(self.faces.incident) + 1e-5
            scene = Scene(columns=columns, shape="measured", record=self.pulse, infinite=True, rigid_contact=True,
                          horizon=end)  # fmt: skip
            try:
                self.kept[key] = motion(scene, 0, tolerance=_TOLERANCE)
            except ValueError as error:
                raise RecordError(f"the model cannot follow the incident wave of the record: {error}") from None
            if len(self.kept) > 200:
                self.kept.pop(next(iter(self.kept)))
        return self.kept[key]

    def waves(self, parameters: Array) -> tuple[Array, Array]:
        """Strains that the gauges would show of the reflected and the transmitted wave at the faces."""
        found = self.motion(parameters)
        last = found.scene.record_end[0]
        times = [np.clip(self.faces.time + parameters[shift], 0.0, last) for shift in (_SHIFT_A, _SHIFT_B)]
        reflected = waves_at(found, times[0]).leaving_a / self.speed
        transmitted = -waves_at(found, times[1]).leaving_b / self.speed
        offset = self.faces.offset
        base = parameters[_BASE] * offset[0] if self.faces.shared else parameters[_BASE + 1] * offset[1]
        return (
            reflected * math.exp(-parameters[_GAIN_A]) + base,
            transmitted * math.exp(-parameters[_GAIN_B]) + parameters[_BASE + 2] * offset[2],
        )

    def residual(self, parameters: Array, count: int) -> Array:
        """Measured less modelled over the standard deviation, first `count` samples of both waves, (2 count,)."""
        reflected, transmitted = self.waves(parameters)
        return np.concatenate([
            (self.faces.reflected[:count] - reflected[:count]) / self.sd[0],
            (self.faces.transmitted[:count] - transmitted[:count]) / self.sd[1],
        ])  # fmt: skip

    def slopes(self, parameters: Array, count: int) -> Array:
        """Derivatives of the residual, (2 count, parameters), by differences; of noise and baseline to one side."""
        steps = np.full(_COUNT, 1e-3)
        steps[[_SHIFT_A, _SHIFT_B]] = 0.25 * self.faces.step
        steps[_NOISE:] = 0.3 if self.pulse.noise > 0.0 else 0.0
        if self.faces.shared:
            steps[_BASE + 1] = 0.0
        columns = []
        here = self.residual(parameters, count)
        for k, step in enumerate(steps):
            if step == 0.0:
                columns.append(np.zeros(2 * count))
                continue
            move = np.zeros(_COUNT)
            move[k] = step
            above = self.residual(parameters + move, count)
            if k >= _NOISE:
                columns.append((above - here) / step)
            else:
                columns.append((above - self.residual(parameters - move, count)) / (2.0 * step))
        return np.stack(columns, axis=1)

    def solve(self, count: int, start: Array) -> tuple[Array, Array]:
        """Parameters of least loss and their covariance."""
        weight = 1.0 / self.prior

        def left(x: Array) -> Array:
            return np.append(self.residual(x, count), weight * x)

        def steep(x: Array) -> Array:
            return np.concatenate([self.slopes(x, count), np.diag(weight)])

        found = least_squares(left, start, steep, x_scale="jac")
        slopes = np.asarray(found.jac)
        information = slopes.T @ slopes
        scaled = np.sqrt(np.maximum(np.diag(information), 1e-300))
        covariance = np.linalg.pinv(information / np.outer(scaled, scaled), rcond=1e-13) / np.outer(scaled, scaled)
        return found.x, covariance

    def scan(self, count: int) -> Array:
        """The best of E* from an eighth to eight times that of the study, all else at its prior."""
        trials = []
        for factor in np.linspace(-math.log(8.0), math.log(8.0), 13):
            trial = self.start.copy()
            trial[_MODULUS] += factor
            trials.append((float(np.square(self.residual(trial, count)).sum()), trial))
        return min(trials, key=lambda pair: pair[0])[1]


def _unforeseen(fit: _Fit, parameters: Array, covariance: Array, borders: Places, width: int) -> list[float]:
    """Mean residuals of blocks behind the fit over their standard deviations, the larger of both waves."""
    count = len(fit.faces.incident)
    residual, slopes = fit.residual(parameters, count), fit.slopes(parameters, count)
    found = []
    for first in borders:
        worst = 0.0
        for wave in range(2):
            part = slice(wave * count + int(first), wave * count + min(int(first) + width, count))
            lean = slopes[part].mean(axis=0)
            spread = 1.0 / (part.stop - part.start) + float(lean @ covariance @ lean)
            worst = max(worst, abs(float(residual[part].mean())) / math.sqrt(spread))
        found.append(worst)
    return found


def _departure(fit: _Fit, forces: Forces, borders: Places,
               width: int) -> tuple[Departure | None, Array, Array, int]:  # fmt: skip
    """The first block that the fit to those before does not foresee, and that fit."""
    length = len(forces.time)
    start = fit.scan(int(borders[0]) + 4 * width)
    parameters, covariance = start, np.zeros((_COUNT, _COUNT))
    for k in range(3, len(borders), _AHEAD):
        ahead = borders[k : k + _AHEAD]
        parameters, covariance = fit.solve(int(ahead[0]), parameters)
        excesses = _unforeseen(fit, parameters, covariance, ahead, width)
        odd = next((n for n, excess in enumerate(excesses) if excess > _ODD), None)
        if odd is None:
            continue
        first, excess = int(ahead[odd]), excesses[odd]
        # where the residual begins to grow: the best corner of a broken line over this block and the one before
        low, high = max(first - width, 0), min(first + width, length)
        residual = fit.residual(parameters, length).reshape(2, length)[:, low:high]
        place = np.arange(high - low, dtype=float)
        losses = []
        for corner in range(2, high - low - 2):
            ramp = np.maximum(place - corner, 0.0)
            slope = residual @ ramp / np.square(ramp).sum()
            losses.append(float(np.square(residual - slope[:, None] * ramp).sum()))
        at = low + 2 + int(np.argmin(losses))
        limits = [forces.interval(face) for face in "AB"]
        a, b = float(forces.force_a[at]), float(forces.force_b[at])
        found = Departure(
            time=float(forces.time[at]), earliest=float(forces.time[low]), latest=float(forces.time[high - 1]),
            force_a=(a, float(limits[0][0][at]), float(limits[0][1][at])),
            force_b=(b, float(limits[1][0][at]), float(limits[1][1][at])), excess=excess,
        )  # fmt: skip
        before = min(first, at) if min(first, at) > int(borders[1]) else first
        parameters, covariance = fit.solve(before, parameters)
        return found, parameters, covariance, before
    return None, parameters, covariance, length


def invert(faces: Faces, columns: Mapping[str, float], *, gain_sd: float = 0.01,
           departure: bool = True) -> Inverse:  # fmt: skip
    """Forces, contact stiffness and the end of the elastic contact of one test.

    columns : numbers of the scene by dotted path, SI; those of sphere and bars are needed.  `sphere.E` is where the
    search begins, from an eighth to eight times its E*.
    gain_sd : relative standard deviation of the gain of each gauge.
    departure : look for the end of the elastic contact.

    Raises RecordError where the model cannot follow the record or no force rises above its noise.
    """
    scene = {name: float(columns[name]) for name in _NEEDED}
    if "bars.end_radius" in columns:
        scene["bars.end_radius"] = float(columns["bars.end_radius"])
    forces = forces_of(faces, scene, gain_sd)
    fit = _Fit(faces, scene, gain_sd)
    largest = float(forces.force_b.max())
    if not largest > 3.0 * NORMAL * float(forces.sd_b[0]):
        raise RecordError("no force at the receiving face rises above the noise of the record")
    length = len(forces.time)
    loaded = int(np.argmax(forces.force_b > _LOADED * largest))
    width = max(_FEWEST_INVERSE, (length - loaded) // _BLOCKS)
    borders = np.arange(loaded, length - width + 1, width, dtype=np.int64)
    parameters, covariance = fit.solve(length, fit.scan(length))
    found, used = None, length
    notes = [*faces.notes, *fit.pulse.notes[len(faces.pulse.notes) :]]
    # the largest mean residual of a block over the scatter of its noise
    residual = fit.residual(parameters, length).reshape(2, length)
    means = [np.abs(residual[:, first : first + width].mean(axis=1)).max() for first in borders]
    if departure and len(borders) > 6 and max(means) * math.sqrt(width) > _ODD:
        found, before, spread, used = _departure(fit, forces, borders, width)
        if found is None:
            notes.append("the model does not explain the record to its noise, yet no single moment stands out")
        else:
            parameters, covariance = before, spread
    stiffness = _stiffness(fit, parameters, covariance, used)
    if stiffness.misfit > 1.3 and found is None:
        notes.append(
            f"the misfit is {stiffness.misfit:.3g} times the noise: the interval of E* is too narrow by as much"
        )
    reflected, transmitted = fit.waves(parameters)
    scale, moved = _stiffness_of_bar(fit.columns), fit.motion(parameters)
    incident = -waves_at(moved, np.minimum(faces.time, moved.scene.record_end[0])).incident / fit.speed
    return Inverse(
        forces=forces, departure=found, pulse=fit.pulse, notes=tuple(notes), stiffness=stiffness,
        fitted_a=-scale * (incident + reflected * math.exp(parameters[_GAIN_A])),
        fitted_b=-scale * transmitted * math.exp(parameters[_GAIN_B]),
    )  # fmt: skip


def _stiffness(fit: _Fit, parameters: Array, covariance: Array, used: int) -> Stiffness:
    """E* with its interval from the fit to the first `used` samples."""
    noise = fit.faces.noise[1:, None]
    residual = fit.residual(parameters, len(fit.faces.incident)).reshape(2, -1)[:, :used]
    scaled = residual * fit.sd[:, None] / noise if (noise > 0.0).all() else residual
    spread = math.sqrt(max(float(covariance[_MODULUS, _MODULUS]), 0.0))
    modulus = math.exp(parameters[_MODULUS])
    largest = float(np.abs(fit.faces.transmitted[:used]).max())
    return Stiffness(
        unexplained=math.sqrt(max(float(np.square(residual * fit.sd[:, None]).mean() - np.square(noise).mean()), 0.0))
        / largest,
        expected=math.exp(fit.start[_MODULUS]),
        modulus=modulus, low=modulus * math.exp(-NORMAL * spread), high=modulus * math.exp(NORMAL * spread),
        std_error=modulus * spread, gain_a=math.exp(parameters[_GAIN_A]), gain_b=math.exp(parameters[_GAIN_B]),
        misfit=math.sqrt(float(np.square(scaled).mean())), samples=used,
    )  # fmt: skip
