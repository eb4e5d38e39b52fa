"""From gauges to faces: forces by one, two and three waves with intervals, energies, equilibrium.

The incident gauge is at d_i before face A, the receiving gauge at d_r behind face B.  With E A of a
bar and compression positive:

    P_A = -E A (eps_i + eps_r)                two waves
    P_B = -E A eps_t                          one wave
    (P_A + P_B)/2                             three waves
    W = E A c0 ∫ eps² dt                      energy of a wave

Source: G. T. Gray III, ASM Handbook 8, 2000.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.signal import savgol_filter

from uqsphere.arrays import Array, Flags
from uqsphere.errors import UsageError
from uqsphere.labs.shpb.arrivals import Arrivals, find_arrivals
from uqsphere.labs.shpb.document import BarTable, RecordDocument
from uqsphere.labs.shpb.doubts import (
    EQUILIBRIUM,
    Faces,
    check_bending,
    check_impulse,
    check_specimen,
    check_striker,
)
from uqsphere.labs.shpb.mending import Record, Signal, smooth
from uqsphere.labs.shpb.peaks import Force, Peak, Peaks, largest_force
from uqsphere.labs.shpb.recorder import Changes
from uqsphere.mechanics.bars import correct

#: fewest samples of a wave at a face
_FEWEST = 50
#: bending over the wave (sd) that a single gauge of a pair does not show: pairs of real tests show
#: 0.02 to 0.05
_BENDING = 0.04


@dataclass(frozen=True, kw_only=True)
class Reading:
    """One test.

    step, touch : sampling interval, and time of first touch in the record [s].
    time, force_a, force_b (n,) : [s], [N], with standard deviations `sd_a`, `sd_b`; `force_a` is
        None where it is not known.
    pulse : incident wave at face A, compression positive, from rest to rest.
    peaks : by face, "A", "B" and "mean"; only faces that are known.
    energies : of the waves [J], by name; `absorbed` stays between the bars.
    balanced : share of the rise from half the largest force in which the forces agree within 5 %.
    loading_rate : [N/s].
    withheld : why a number is not given; notes : what the numbers mean.
    changes : what mending changed, time shifts included.
    """

    step: float
    touch: float
    time: Array
    force_a: Array | None
    force_b: Array
    sd_a: Array
    sd_b: Array
    pulse: Array
    peaks: dict[str, Peak]
    energies: dict[str, float] | None
    balanced: float | None
    loading_rate: float
    withheld: list[str]
    notes: list[str]
    changes: Changes


class _Window(NamedTuple):
    """Which samples after first touch are known at which face.

    start : sample of first touch at the incident gauge; alive : samples of the incident wave before
    the reflected one is at this gauge.
    to_a, to_b : sample of first touch of the reflected and the transmitted wave at their gauges.
    length : samples at face B; apart : those of face A in which the waves are apart.
    withheld : why the force at A is not given.
    """

    start: int
    alive: int
    to_a: float
    to_b: float
    length: int
    apart: slice
    withheld: list[str]

    @property
    def whole(self) -> bool:
        """Whether face A is known at all samples."""
        return self.apart == slice(0, self.length)


def read_test(record: Record, document: RecordDocument) -> Reading:
    """Forces, energies and equilibrium of a test.

    Raises UsageError for a pulse that cannot be one of these bars, for forces within the noise, and
        for a record that ends at first touch.
    """
    bar = document.incident_bar
    behind = document.receiving_bar
    asked = document.record
    step = record.step
    receiving = record.receiving
    wave = record.incident.wave
    if wave.sign > 0.0:
        raise UsageError(
            "the first wave of the incident bar is tension, compression is required: check "
            "record.polarity"
        )
    changes = Changes(record.changes)
    arrivals = find_arrivals(record, document, changes)
    window = _window(record, document, arrivals)

    moved = changes if asked.dispersion else None
    transmitted = _at_face(receiving, behind, window.to_b, window.length, step, moved)
    gain_b = math.hypot(behind.gain_sd, _BENDING) if receiving.single else behind.gain_sd
    random = behind.stiffness**2 * (receiving.noise**2 + receiving.offset**2)
    face_b = Force(
        time=step * np.arange(window.length, dtype=float),
        force=-behind.stiffness * transmitted,
        sd=np.sqrt(random + (gain_b * (-behind.stiffness * transmitted)) ** 2),
        noise=behind.stiffness * receiving.noise,
        memory=receiving.memory,
    )
    peaks = Peaks(B=largest_force(face_b))
    independent = max(1.0, (receiving.wave.falling - receiving.wave.half) / receiving.memory)
    noise = face_b.noise / math.sqrt(independent)
    if not peaks["B"].low > 0.0 or peaks["B"].value < 3.0 * noise:
        raise UsageError("no force at the receiving face rises above the noise of the record")
    peaks.doubt("B", arrivals.doubt_b)
    if arrivals.speed_ratio != 1.0:
        other = peaks["B"].value * arrivals.speed_ratio**2
        text = f"if E is wrong in place of a distance, the force is {other * 1e-3:.4g} kN"
        peaks.doubt("B", text, 0.98 * other, 1.02 * other)
    force_a = None
    sd_a = np.full(window.length, np.inf)
    energies = None
    mass = None
    if not window.withheld:
        face_a, incident, reflected = _near_face(record, document, window, (peaks, changes), face_b)
        force_a = np.full(window.length, np.nan)
        sd_a = face_a.sd
        force_a[window.apart] = face_a.force[window.apart]
        peaks.doubt("A", arrivals.doubt_b)
        faces = Faces(
            time=face_b.time,
            force_a=force_a,
            force_b=face_b.force,
            velocity_a=bar.wave_speed * (reflected - incident),
            velocity_b=-behind.wave_speed * transmitted,
        )
        zeros_sd = bar.stiffness * (record.incident.offset + record.reflected.offset)
        zeros_sd += behind.stiffness * receiving.offset
        heaviest = document.specimen.heaviest(min(bar.diameter, behind.diameter))
        mass = check_impulse(peaks, faces, bar.gain_sd + gain_b, zeros_sd, heaviest)
        if window.whole:
            energies = {}
            for name, strain, carrier in (
                ("incident", incident, bar),
                ("reflected", reflected, bar),
                ("transmitted", transmitted, behind),
            ):
                squares = np.square(strain).sum()
                energies[name] = carrier.stiffness * carrier.wave_speed * step * squares
            passed = energies["reflected"] + energies["transmitted"]
            energies["absorbed"] = energies["incident"] - passed
        else:
            begin, end = (at * step * 1e6 for at in (window.apart.start, window.apart.stop))
            text = (
                "the incident wave is longer than its way to the face and back: A is known from "
                f"{begin:.4g} to {end:.4g} us"
            )
            changes.add("overlap", record.incident.name, text)
    check_striker(peaks, wave.peak, bar.wave_speed, asked.striker_speed, changes)
    pressed = bar.stiffness * wave.peak if wave.ended else math.inf
    notes = check_specimen(peaks, pressed, document, mass)
    _check_gauges(peaks, record, document, window, face_b.time)
    balanced, rate = _balance(face_b.time, force_a, face_b.force, peaks["B"])
    touch = record.start + step * window.start
    if not asked.aligned:
        touch += bar.gauge / bar.wave_speed
    return Reading(
        step=step,
        touch=touch,
        time=face_b.time,
        force_a=force_a,
        force_b=face_b.force,
        sd_a=sd_a,
        sd_b=face_b.sd,
        pulse=_pulse(record, bar, asked.dispersion),
        peaks=dict(sorted(peaks.items())),
        energies=energies,
        balanced=balanced,
        loading_rate=rate,
        withheld=window.withheld,
        notes=notes,
        changes=changes,
    )


# --- which samples are known ----------------------------------------------------------------------


def _window(record: Record, document: RecordDocument, arrivals: Arrivals) -> _Window:
    """The samples of both faces; UsageError for too few of the transmitted wave."""
    bar = document.incident_bar
    behind = document.receiving_bar
    incident = record.incident
    receiving = record.receiving
    step = record.step
    wave = incident.wave
    # first touch; a wave whose distance is wrong begins at its own foot
    to_a = wave.start + arrivals.reflected
    to_b = wave.start + arrivals.transmitted
    if arrivals.doubt_b:
        to_b = receiving.wave.foot - receiving.wave.lead
    echoes = [bar.echo / step, behind.echo / step]
    if document.record.aligned:
        echoes = [math.inf, math.inf]
    count = _known_samples(receiving, int(to_b), echoes[1])
    if count < _FEWEST:
        raise UsageError(
            f"{max(count, 0)} samples of the transmitted wave, {_FEWEST} are required: the record "
            "ends too early, or an echo or a gap comes before"
        )
    count_a = _known_samples(record.reflected, int(to_a), echoes[0])
    # samples between both waves at a gauge that they share, and those in which they are apart
    delay = 2.0 * bar.gauge / bar.wave_speed / step if record.shared else math.inf
    first = 0
    last = 1 << 60
    length = wave.end - wave.start
    if length > delay:
        first = math.ceil(length - delay + 0.05 * delay)
        last = int(delay)
    reasons = []
    if not incident.known[wave.start : wave.end].all():
        reasons.append("samples of the incident wave are not known")
    if arrivals.doubt_a:
        reasons.append(arrivals.doubt_a)
    if count_a < _FEWEST:
        reasons.append("the record ends before the reflected wave")
    if record.shared and (not wave.ended or last - first < 0.5 * delay):
        reasons.append(
            "incident and reflected wave overlap at the incident gauge. Shorten the pulse, move "
            "the gauge away from the specimen, or set record.window"
        )
    if not reasons:
        count = min(count, count_a)
    return _Window(
        start=wave.start,
        alive=int(min(count, delay, len(incident.strain) - wave.start)),
        to_a=to_a,
        to_b=to_b,
        length=count,
        apart=slice(first, min(last, count)),
        withheld=[f"force at A: {reason}" for reason in reasons],
    )


def _known_samples(signal: Signal, first: int, most: float) -> int:
    """Samples from a place on, at most so many, until the record ends or one is not known."""
    count = int(min(len(signal.strain) - 3 - first, most))
    begin = max(first, 0)
    lost = np.flatnonzero(~signal.known[begin : begin + max(count, 0)])
    return int(lost.min(initial=count))


# --- waves at the faces ---------------------------------------------------------------------------


def moved_wave(wave: Array, distance: float, bar: BarTable, step: float) -> Array:
    """A wave (n,) by itself, `distance` [m] further on, in the time of the one-dimensional wave.

    Phases of the first mode of Pochhammer and Chree (P. S. Follansbee, C. Frantz, J. Eng. Mater.
    Technol. 105 (1983) 61).  Amplitudes stay: the factors of the section amplify noise.
    """
    room = max(8, math.ceil(2.0 * abs(distance) / bar.wave_speed / step))
    fading = wave[-1] * 0.5 * (1.0 + np.cos(np.linspace(0.0, math.pi, room)))
    moved = correct(
        np.concatenate([np.zeros(room), wave, fading, np.zeros(room)]),
        step,
        distance,
        radius=0.5 * bar.diameter,
        wave_speed=bar.wave_speed,
        nu=bar.nu,
    )
    return moved[room : room + len(wave)]


def _samples(values: Array, first: float, count: int) -> Array:
    """Samples from a place between samples on, by cubic splines."""
    return map_coordinates(values, [first + np.arange(count)], order=3, mode="nearest")


def _at_face(
    signal: Signal, bar: BarTable, first: float, count: int, step: float, changes: Changes | None
) -> Array:
    """The wave of a gauge from first touch on; at the face where `changes` are given."""
    if changes is None:
        return _samples(signal.strain, first, count)
    more = count + math.ceil(bar.gauge / bar.wave_speed / step)
    more = min(more, len(signal.strain) - 3 - int(first))
    wave = _samples(signal.strain, first, max(count, more))
    moved = moved_wave(wave, -bar.gauge, bar, step)[:count]
    wave = wave[:count]
    largest = np.abs(moved - wave).max()
    share = largest / max(np.abs(wave).max(), 1e-300)
    text = f"moved to the face by the first mode of a bar: changes of up to {share:.1%} of the wave"
    changes.add("dispersion", signal.name, text, largest)
    return moved


def _near_face(
    record: Record,
    document: RecordDocument,
    window: _Window,
    noted: tuple[Peaks, Changes],
    face_b: Force,
) -> tuple[Force, Array, Array]:
    """The force at A by two waves, incident and reflected wave (n,) there; adds the peaks of A and
    of the mean (in place).

    Where waves were cut out, a reflected wave in its own column that has the sign of compression is
    the size of one: a specimen softer than the bar reflects tension.
    """
    bar, asked, count, (peaks, changes) = (
        document.incident_bar,
        document.record,
        window.length,
        noted,
    )
    before = record.incident
    after = record.reflected
    stiffness = bar.stiffness
    incident = np.zeros(count)
    doubt = ""
    incident[: window.alive] = before.strain[window.start : window.start + window.alive]
    # where the two waves overlap neither can be moved by itself
    moved = changes if asked.dispersion and window.whole else None
    if moved is not None:
        incident = moved_wave(incident, bar.gauge, bar, record.step)
    reflected = _at_face(after, bar, window.to_a, count, record.step, moved)
    force = -stiffness * (incident + reflected)
    if asked.aligned and asked.polarity == "auto" and not record.shared:
        body = np.abs(reflected) > 0.5 * np.abs(reflected).max()
        if reflected[body].mean() <= 0.0:
            text = "has the sign of the incident wave; it is taken as tension"
            changes.add("sign", after.name, text)
            doubt = (
                "the reflected wave is taken as tension; with the sign of the file A would be "
                f"{force.max() * 1e-3:.4g} kN"
            )
            reflected = -reflected
            force = -stiffness * (incident + reflected)
    alive: Flags = np.arange(count) < window.alive
    noise = after.noise**2 + np.where(alive, before.noise**2, 0.0)
    offset = np.where(alive, before.offset + after.offset, after.offset)
    both = stiffness**2 * (incident**2 + reflected**2)
    gain = bar.gain_sd**2 * both
    if record.shared:  # one gauge: its gain is common to both waves
        gain = (bar.gain_sd * force) ** 2
    if before.single or after.single:
        gain = gain + _BENDING**2 * both
    face_a = Force(
        time=face_b.time,
        force=force,
        sd=np.sqrt(stiffness**2 * (noise + offset**2) + gain),
        noise=stiffness * math.hypot(before.noise, after.noise),
        memory=before.memory,
    )
    mean = face_a._replace(
        force=0.5 * (force + face_b.force),
        sd=0.5 * np.hypot(face_a.sd, face_b.sd),
        noise=0.5 * face_a.noise,
    )
    peaks["A"] = largest_force(face_a.part(window.apart))
    peaks["mean"] = largest_force(mean.part(window.apart))
    begin = window.apart.start
    edge = face_a.time[min(begin + before.wave.lead, count - 1)]
    if begin > 0 and peaks["A"].time < edge:
        peaks.doubt("A", "its largest value lies where incident and reflected wave overlap")
    peaks.doubt("A", doubt)
    return face_a, incident, reflected


# --- checks, equilibrium, pulse -------------------------------------------------------------------


def _check_gauges(
    peaks: Peaks, record: Record, document: RecordDocument, window: _Window, time: Array
) -> None:
    """Compare the gauges of each bar; the mean takes the doubts of both faces (in place)."""
    count = window.length
    stiffness = document.incident_bar.stiffness
    spread = _samples(record.receiving.spread, window.to_b, count)
    check_bending(peaks, "B", document.receiving_bar.stiffness * spread, time, peaks["B"].value)
    if window.withheld:
        peaks.doubt("B", "the force at A is not known: it does not check gauge and gain of B")
        return
    both = np.maximum(
        _samples(record.incident.spread, window.start, count),
        _samples(record.reflected.spread, window.to_a, count),
    )
    check_bending(peaks, "A", stiffness * both, time, stiffness * record.incident.wave.peak)
    every = dict.fromkeys((*peaks["mean"].doubts, *peaks["A"].doubts, *peaks["B"].doubts))
    peaks["mean"] = peaks["mean"]._replace(doubts=(*every,))


def _balance(
    time: Array, force_a: Array | None, force_b: Array, peak: Peak
) -> tuple[float | None, float]:
    """Share of the rise in which the forces agree within 5 % of their mean, and loading rate
    [N/s]."""
    top = max(int(np.searchsorted(time, peak.time)), 3)
    smooth_b = smooth(force_b, 5)
    half = min(int(np.argmax(smooth_b > 0.5 * peak.value)), top - 2)
    rate = 0.5 * peak.value / float(time[top] - time[half])
    if force_a is None or np.isnan(force_a).any():
        return None, rate
    smooth_a = smooth(force_a, 5)
    mean = 0.5 * (smooth_a + smooth_b)
    even = np.abs(smooth_a - smooth_b) <= 2.0 * EQUILIBRIUM * np.abs(mean)
    return float(even[half : top + 1].mean()), rate


def _pulse(record: Record, bar: BarTable, disperses: bool) -> Array:
    """The incident wave at face A, compression positive, from rest to rest."""
    wave = record.incident.wave
    pulse: Array = -record.incident.strain[wave.start : wave.end + wave.lead]
    # parabolas over half the rise follow the pulse and leave most of the noise
    if 8 <= wave.rising < len(pulse):
        pulse = savgol_filter(pulse, 2 * (wave.rising // 4) + 1, 2)
    if disperses:
        pulse = moved_wave(pulse, bar.gauge, bar, record.step)
    pulse[[0, -1]] = 0.0
    return pulse
