"""From gauges to faces: forces by one, two and three waves with intervals, energies, equilibrium.

The incident gauge is at d_i before face A, the receiving gauge at d_r behind face B.  With E A of a
bar and compression positive:

    P_A = -E A (eps_i + eps_r)                two waves
    P_B = -E A eps_t                          one wave
    (P_A + P_B)/2                             three waves
    W = E A c0 ∫ eps² dt                      energy of a wave

Source: G. T. Gray III, ASM Handbook 8, 2000.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.signal import savgol_filter

from uqsphere.arrays import Array
from uqsphere.errors import UsageError
from uqsphere.mechanics.bars import correct
from uqsphere.tables import TableError

from .arrivals import Arrivals, find_arrivals
from .doubts import (
    EQUILIBRIUM,
    check_bending,
    check_impulse,
    check_specimen,
    check_striker,
    check_widths,
)
from .mending import Record, Signal, note, smooth
from .peaks import Force, Peak, Peaks, largest_force
from .recorder import Changes

#: fewest samples of a wave at a face
_FEWEST = 50
#: bending over the wave (sd) that a single gauge of a pair does not show: pairs of real tests show
#: 0.02 to 0.05
_BENDING = 0.04


class Reading(NamedTuple):
    """One test.

    step, touch : sampling interval, and time of first touch in the record [s].
    forces : by face, "A" and "B"; A only where it is known, NaN at samples at which it is not.
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
    forces: dict[str, Force]
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

    arrivals : of the waves at their gauges; alive : samples of the incident wave before the
    reflected one is at this gauge.
    length : samples at face B; apart : those of face A in which the waves are apart.
    withheld : why the force at A is not given.
    """

    arrivals: Arrivals
    alive: int
    length: int
    apart: slice
    withheld: list[str]

    @property
    def whole(self) -> bool:
        """Whether face A is known at all samples."""
        return self.apart == slice(0, self.length)


def read_test(record: Record) -> Reading:
    """Forces, energies and equilibrium of a test.

    Raises UsageError for a pulse that cannot be one of these bars, for forces within the noise, and
        for a record that ends at first touch.
    """
    asked = record.document.record
    before = record.incident
    receiving = record.receiving
    bar = before.bar
    behind = receiving.bar
    step = before.step
    wave = before.wave
    if wave.sign > 0.0:
        raise TableError(
            "the first wave of the incident bar is tension, compression is required: check "
            "record.polarity",
            "polarity",
        )
    arrivals = find_arrivals(record)
    window = _window(record, arrivals)

    transmitted = _at_face(receiving, arrivals.to_b, window.length, asked.dispersion)
    force = -behind.stiffness * transmitted
    gain_b = behind.gain_sd
    if receiving.single:
        gain_b = math.hypot(gain_b, _BENDING)
    random = behind.stiffness**2 * (receiving.noise**2 + receiving.offset**2)
    face_b = Force(
        time=step * np.arange(window.length, dtype=float),
        force=force,
        sd=np.sqrt(random + (gain_b * force) ** 2),
        noise=behind.stiffness * receiving.noise,
        memory=receiving.memory,
    )
    largest = largest_force(face_b)
    peaks = Peaks(B=largest)
    noise = face_b.scatter(receiving.wave.falling - receiving.wave.half)
    if not largest.low > 0.0 or largest.value < 3.0 * noise:
        raise UsageError("no force at the receiving face rises above the noise of the record")
    peaks.doubt("B", arrivals.doubt_b)
    if arrivals.speed_ratio != 1.0:
        other = largest.value * arrivals.speed_ratio**2
        peaks.doubt(
            "B",
            f"if E is wrong in place of a distance, the force is {other * 1e-3:.4g} kN",
            0.98 * other,
            1.02 * other,
        )
    forces = {"B": face_b}
    energies = None
    mass = None
    if not window.withheld:
        face_a, incident, reflected = _near_face(record, window, peaks, face_b)
        forces = {"A": face_a, "B": face_b}
        peaks.doubt("A", arrivals.doubt_b)
        velocity_a = bar.wave_speed * (reflected - incident)
        motion = np.array([face_a.force, force, velocity_a, -behind.wave_speed * transmitted])
        zeros_sd = bar.stiffness * (before.offset + record.reflected.offset)
        zeros_sd += behind.stiffness * receiving.offset
        heaviest = record.document.specimen.heaviest(min(bar.diameter, behind.diameter))
        mass = check_impulse(peaks, motion, step, bar.gain_sd + gain_b, zeros_sd, heaviest)
        if window.whole:
            carried = bar.stiffness * bar.wave_speed * step
            offered, returned = carried * np.square([incident, reflected]).sum(axis=1)
            carried = behind.stiffness * behind.wave_speed * step
            passed = carried * np.square(transmitted).sum()
            energies = {
                "incident": offered,
                "reflected": returned,
                "transmitted": passed,
                "absorbed": offered - (returned + passed),
            }
        else:
            note(
                before,
                "overlap",
                "the incident wave is longer than its way to the face and back: A is known from "
                f"{window.apart.start * step * 1e6:.4g} to {window.apart.stop * step * 1e6:.4g} us",
            )
    check_striker(peaks, before, asked.striker_speed)
    pressed = bar.stiffness * wave.peak if wave.ended else math.inf
    notes = check_specimen(peaks, pressed, record.document.specimen.strongest, mass)
    _check_gauges(peaks, record, window)
    check_widths(peaks)
    balanced, rate = _balance(forces, largest, step)
    touch = record.start + step * wave.start
    if not asked.aligned:
        touch += bar.passage
    return Reading(
        step=step,
        touch=touch,
        forces=forces,
        pulse=_pulse(before, asked.dispersion),
        peaks=dict(sorted(peaks.items())),
        energies=energies,
        balanced=balanced,
        loading_rate=rate,
        withheld=window.withheld,
        notes=notes,
        changes=before.changes,
    )


# --- which samples are known ----------------------------------------------------------------------


def _window(record: Record, arrivals: Arrivals) -> _Window:
    """The samples of both faces; UsageError for too few of the transmitted wave."""
    incident = record.incident
    wave = incident.wave
    aligned = record.document.record.aligned
    count = _known_samples(record.receiving, int(arrivals.to_b), aligned)
    if count < _FEWEST:
        raise UsageError(
            f"{max(count, 0)} samples of the transmitted wave, {_FEWEST} are required: the record "
            "ends too early, or an echo or a gap comes before"
        )
    count_a = _known_samples(record.reflected, int(arrivals.to_a), aligned)
    # samples between both waves at a gauge that they share, and those in which they are apart
    delay = math.inf
    if record.shared:
        delay = 2.0 * incident.bar.passage / incident.step
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
        arrivals=arrivals,
        alive=int(min(count, delay, len(incident.strain) - wave.start)),
        length=count,
        apart=slice(first, min(last, count)),
        withheld=[f"force at A: {reason}" for reason in reasons],
    )


def _known_samples(signal: Signal, first: int, aligned: bool) -> int:
    """Samples from a place on until the record ends, an echo comes, or one is not known."""
    count = len(signal.strain) - 3 - first
    if not aligned:
        count = int(min(count, signal.bar.echo / signal.step))
    lost = np.flatnonzero(~signal.known[max(first, 0) :])
    return int(lost.min(initial=count))


# --- waves at the faces ---------------------------------------------------------------------------


def _moved(wave: Array, gauge: Signal, direction: float) -> Array:
    """A wave (n,) by itself, moved from its gauge to the face (1), or against its way (-1), in the
    time of the one-dimensional wave.

    Phases of the first mode of Pochhammer and Chree (P. S. Follansbee, C. Frantz, J. Eng. Mater.
    Technol. 105 (1983) 61).  Amplitudes stay: the factors of the section amplify noise.
    """
    bar = gauge.bar
    room = max(8, math.ceil(2.0 * bar.passage / gauge.step))
    fading = wave[-1] * 0.5 * (1.0 + np.cos(np.linspace(0.0, math.pi, room)))
    moved = correct(
        np.pad(np.append(wave, fading), room),
        gauge.step,
        direction * bar.gauge,
        radius=0.5 * bar.diameter,
        wave_speed=bar.wave_speed,
        nu=bar.nu,
    )
    return moved[room : room + len(wave)]


def _samples(values: Array, first: float, count: int) -> Array:
    """Samples from a place between samples on, by cubic splines."""
    return map_coordinates(values, [first + np.arange(count)], mode="nearest")


def _at_face(signal: Signal, first: float, count: int, moves: bool) -> Array:
    """The wave of a gauge behind the specimen from first touch on; `moves`: at the face."""
    wave = _samples(signal.strain, first, count)
    if not moves:
        return wave
    more = count + math.ceil(signal.bar.passage / signal.step)
    longer = _samples(signal.strain, first, min(more, len(signal.strain) - 3 - int(first)))
    moved = _moved(longer, signal, -1.0)[:count]
    largest = np.abs(moved - wave).max()
    share = largest / max(np.abs(wave).max(), 1e-300)
    note(
        signal,
        "dispersion",
        f"moved to the face by the first mode of a bar: changes of up to {share:.1%} of the wave",
        largest,
    )
    return moved


def _near_face(
    record: Record, window: _Window, peaks: Peaks, face_b: Force
) -> tuple[Force, Array, Array]:
    """The force at A by two waves, incident and reflected wave (n,) there; adds the peaks of A and
    of the mean (in place).

    Where waves were cut out, a reflected wave in its own column that has the sign of compression is
    the size of one: a specimen softer than the bar reflects tension.
    """
    asked = record.document.record
    count = window.length
    before = record.incident
    after = record.reflected
    stiffness = before.bar.stiffness
    apart = window.apart
    doubt = ""
    alive = np.arange(count) < window.alive
    incident = np.zeros(count)
    incident[alive] = before.strain[before.wave.start :][: window.alive]
    # where the two waves overlap neither can be moved by itself
    moves = asked.dispersion and window.whole
    if moves:
        incident = _moved(incident, before, 1.0)
    reflected = _at_face(after, window.arrivals.to_a, count, moves)
    if asked.aligned and asked.polarity == "auto" and not record.shared:
        body = np.abs(reflected) > 0.5 * np.abs(reflected).max()
        if reflected[body].mean() <= 0.0:
            note(after, "sign", "has the sign of the incident wave; it is taken as tension")
            force = -stiffness * (incident + reflected)
            doubt = (
                "the reflected wave is taken as tension; with the sign of the file A would be "
                f"{force.max() * 1e-3:.4g} kN"
            )
            reflected = -reflected
    force = -stiffness * (incident + reflected)
    force[: apart.start] = math.nan
    force[apart.stop :] = math.nan
    noise = after.noise**2 + alive * before.noise**2
    offset = after.offset + alive * before.offset
    both = stiffness**2 * (incident**2 + reflected**2)
    gain_sd = before.bar.gain_sd
    gain = gain_sd**2 * both
    if record.shared:  # one gauge: its gain is common to both waves
        gain = (gain_sd * force) ** 2
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
    peaks["A"] = largest_force(face_a.part(apart))
    peaks["mean"] = largest_force(mean.part(apart))
    if apart.start > 0 and peaks["A"].time < before.step * (apart.start + before.wave.lead):
        peaks.doubt("A", "its largest value lies where incident and reflected wave overlap")
    peaks.doubt("A", doubt)
    return face_a, incident, reflected


# --- checks, equilibrium, pulse -------------------------------------------------------------------


def _check_gauges(peaks: Peaks, record: Record, window: _Window) -> None:
    """Compare the gauges of each bar (in place)."""
    count = window.length
    incident = record.incident
    receiving = record.receiving
    step = incident.step
    spread = _samples(receiving.spread, window.arrivals.to_b, count)
    check_bending(peaks, "B", receiving.bar.stiffness * spread, step, peaks["B"].value)
    if window.withheld:
        peaks.doubt("B", "the force at A is not known: it does not check gauge and gain of B")
        return
    spread = np.maximum(
        _samples(incident.spread, incident.wave.start, count),
        _samples(record.reflected.spread, window.arrivals.to_a, count),
    )
    stiffness = incident.bar.stiffness
    check_bending(peaks, "A", stiffness * spread, step, stiffness * incident.wave.peak)


def _balance(forces: dict[str, Force], peak: Peak, step: float) -> tuple[float | None, float]:
    """Share of the rise in which the forces agree within 5 % of their mean, and loading rate
    [N/s]."""
    smooth_b = smooth(forces["B"].force, 5)
    top = max(round(peak.time / step), 3)
    half = min(int(np.argmax(smooth_b > 0.5 * peak.value)), top - 2)
    rate = 0.5 * peak.value / (step * (top - half))
    if "A" not in forces or np.isnan(forces["A"].force).any():
        return None, rate
    smooth_a = smooth(forces["A"].force, 5)
    even = np.abs(smooth_a - smooth_b) <= EQUILIBRIUM * np.abs(smooth_a + smooth_b)
    return even[half : top + 1].mean(), rate


def _pulse(incident: Signal, moves: bool) -> Array:
    """The incident wave, at face A if it `moves`, compression positive, from rest to rest."""
    wave = incident.wave
    pulse = -incident.strain[wave.start : wave.end + wave.lead]
    # parabolas over half the rise follow the pulse and leave most of the noise
    if 8 <= wave.rising < len(pulse):
        pulse = savgol_filter(pulse, 2 * (wave.rising // 4) + 1, 2)
    if moves:
        pulse = _moved(pulse, incident, 1.0)
    pulse[[0, -1]] = 0.0
    return pulse
