"""From gauges to faces: arrivals, forces by one, two and three waves with intervals, energies,
equilibrium.

The incident gauge stands d_i before face A, the receiving gauge d_r behind face B.  With E A of a
bar:

    P_A = -E A (eps_i + eps_r)    two waves        P_B = -E A eps_t    one wave        (P_A + P_B)/2
    three waves W = E A c0 ∫ eps² dt          energy of a wave

(G. T. Gray III, ASM Handbook 8, 2000).  What the file says of distances is held against the
arrivals of the waves.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.ndimage import map_coordinates, median_filter
from scipy.signal import savgol_filter
from scipy.special import ndtri

from uqsphere.arrays import Array
from uqsphere.errors import UsageError
from uqsphere.labs.shpb.document import BarTable, RecordDocument
from uqsphere.labs.shpb.record import Change, Changes, Record, Signal, Wave, smooth
from uqsphere.mechanics.bars import correct

NORMAL: Final = 1.959964
#: samples at the faces and above 80 % of a largest force, at the least
_FEWEST, _FEW_ON_TOP = 50, 8
#: share of the largest force below which the force has fallen where the record ends
_FALLEN: Final = 0.9
#: shares of the peak at which an arrival is read, on means over so long [s]: to doubt distances; to
#: shift a steep wave
_SURE, _FINE = (0.15, 8e-6), (0.05, 2e-6)
#: shares of the predicted delay by which a wave may come early, and late, before distances are
#: doubted
_EARLY, _LATE = 0.02, 0.10
#: bending over the wave (sd) that a single gauge of a pair may hide: pairs of real tests show 0.02
#: to 0.05
_BENT: Final = 0.04
#: difference of two gauges of a bar over the wave, and of both faces over the larger force, that is
#: a gross fault
_GROSS: Final = 0.25
#: width of an interval over its value beyond which a number is hardly known; difference of the
#: faces that is a doubt even where their intervals meet
_WIDE, _APART = 0.3, 0.2
#: speeds of a striker [m/s] between which tests are made; relative difference from the given one
#: that is a fault
_STRUCK, _AWRY = (0.1, 100.0), 0.1
#: difference of the forces over their mean that counts as equilibrium
_BALANCE: Final = 0.05


@dataclass(frozen=True, kw_only=True)
class Peak:
    """The largest force [N] with its 95 % interval, its time after first touch [s], and what doubts
    it.
    """

    value: float
    low: float
    high: float
    time: float
    doubts: tuple[str, ...] = ()


class Peaks(dict[str, Peak]):
    """Largest forces by face, "A", "B" and "mean"; only faces that are known."""

    def doubt(self, faces: Iterable[str], text: str, *ends: float) -> None:
        """A doubt at faces, whose intervals then reach to `ends` [N]; none without a text."""
        for face in faces:
            if text and face in self:
                peak = self[face]
                self[face] = replace(
                    peak,
                    doubts=(*peak.doubts, text),
                    low=min((peak.low, *ends)),
                    high=max((peak.high, *ends)),
                )


@dataclass(frozen=True, kw_only=True)
class Reading:
    """One test.

    time, force_a, force_b (n,) [s], [N] with their standard deviations; `force_a` is None where it
    is not known.
    energies : of the waves [J], by name; `absorbed` stays between the bars.
    pulse : the incident wave at face A, compression positive, from rest to rest.
    peaks : by face, "A", "B" and "mean"; only faces that are known.
    withheld : why a number is not given; changes : what mending changed, the shift of time
        included.
    balanced : share of the rise from half the largest force in which both forces agree within 5 %.
    """

    step: float
    touch: float
    time: Array
    force_a: Array | None
    force_b: Array
    sd_a: Array
    sd_b: Array
    pulse: Array
    peaks: Mapping[str, Peak]
    energies: Mapping[str, float] | None
    balanced: float | None
    loading_rate: float
    withheld: tuple[str, ...]
    changes: tuple[Change, ...]


def read_test(record: Record, document: RecordDocument) -> Reading:
    """Forces, energies and equilibrium of a test.

    Raises UsageError where the pulse cannot be one of these bars, where no force rises above the
    noise, or where nothing is left of the record behind first touch.
    """
    inc, rec, step = record.incident, record.receiving, record.step
    bar, behind = document.incident_bar, document.receiving_bar
    wave, aligned = inc.wave, document.record.aligned
    shared = record.reflected is None
    signal = record.reflected if record.reflected is not None else inc
    delay = 2.0 * bar.gauge / bar.wave_speed / step if shared else math.inf
    if wave.sign > 0.0:
        raise UsageError("the first wave of the incident bar does not press (record.polarity)")
    changes = Changes(record.changes)
    reflects, transmits, doubt_a, doubt_b, fast = _arrivals(record, document, changes)
    start, lead = max(wave.foot - _lead(wave), 0), _lead(wave)

    # first touch in the receiving and the reflected signal; where distances are wrong a wave begins
    # at its own foot
    to_b = float(rec.wave.foot - _lead(rec.wave)) if doubt_b else start + transmits
    to_a = start + reflects
    count = _known(rec, int(to_b), math.inf if aligned else behind.echo / step)
    if count < _FEWEST:
        ends = "the record ends too early, or an echo or a gap comes before"
        raise UsageError(
            f"{max(count, 0)} samples of the transmitted wave, {_FEWEST} are required: {ends}"
        )
    count_a = _known(signal, int(to_a), math.inf if aligned else bar.echo / step)
    first, last = _clean(wave, start, delay)
    withheld = [
        f"force at A: {reason}"
        for reason, wrong in {
            "samples of the incident wave are not known": not inc.known[start : wave.end].all(),
            doubt_a: bool(doubt_a),
            "the record ends before the reflected wave": count_a < _FEWEST,
            "incident and reflected wave overlap at the incident gauge; shorten the pulse, move "
            "the gauge back, or say "
            "where it stands (record.window)": shared
            and (not wave.ended or last - first < 0.5 * delay),
        }.items()
        if wrong
    ]
    count = count if withheld else min(count, count_a)
    last = min(last, count)
    whole, time = (first, last) == (0, count), np.asarray(step * np.arange(count), dtype=float)

    disperses = document.record.dispersion
    transmitted = _at_face(
        rec, to_b, count, -behind.gauge, behind, step, changes if disperses else None
    )
    force_b = -behind.stiffness * transmitted
    gain_b = math.hypot(behind.gain_sd, _BENT if rec.single else 0.0)
    sd_b = np.sqrt(behind.stiffness**2 * (rec.noise**2 + rec.offset**2) + (gain_b * force_b) ** 2)
    peaks = Peaks(B=_peak(time, force_b, sd_b, behind.stiffness * rec.noise, rec.memory))
    lasting = max(1.0, (rec.wave.falling - rec.wave.half) / rec.memory)
    if not peaks["B"].low > 0.0 or peaks[
        "B"
    ].value < 3.0 * behind.stiffness * rec.noise / math.sqrt(lasting):
        raise UsageError("no force at the receiving face rises above the noise of the record")
    peaks.doubt("B", doubt_b)
    if fast != 1.0:
        other = peaks["B"].value * fast**2
        text = f"with another E in place of another distance the force is {other * 1e-3:.4g} kN"
        peaks.doubt("B", text, 0.98 * other, 1.02 * other)

    incident = np.zeros(count)
    there = int(min(count, delay, len(inc.strain) - start))
    incident[:there] = inc.strain[start : start + there]
    # where incident and reflected wave overlap neither can be moved by itself
    moved = changes if disperses and whole else None
    if moved is not None:
        incident = moved_wave(incident, bar.gauge, bar, step)
    force_a, sd_a, energies = None, np.full(count, np.inf), None
    if not withheld:
        reflected = _at_face(signal, to_a, count, -bar.gauge, bar, step, moved)
        turned, doubt = _sign_of_reflected(record, document, incident, reflected, bar, changes)
        reflected = turned * reflected
        force_a = -bar.stiffness * (incident + reflected)
        alive = np.arange(count) < there
        noise = signal.noise**2 + np.where(alive, inc.noise**2, 0.0)
        rest = np.where(alive, (inc.offset + signal.offset) ** 2, signal.offset**2)
        both = incident**2 + reflected**2
        gained = (
            (bar.gain_sd * force_a) ** 2 if shared else (bar.gain_sd * bar.stiffness) ** 2 * both
        )
        gained = gained + (_BENT * bar.stiffness) ** 2 * both * (inc.single or signal.single)
        sd_a = np.sqrt(bar.stiffness**2 * (noise + rest) + gained)
        zone, noise_a = slice(first, last), bar.stiffness * math.hypot(inc.noise, signal.noise)
        mean, sd_mean = 0.5 * (force_a + force_b), 0.5 * np.hypot(sd_a, sd_b)
        peaks["A"] = _peak(time[zone], force_a[zone], sd_a[zone], noise_a, inc.memory)
        peaks["mean"] = _peak(time[zone], mean[zone], sd_mean[zone], 0.5 * noise_a, inc.memory)
        if first > 0 and peaks["A"].time < time[min(first + lead, count - 1)]:
            peaks.doubt("A", "its largest value lies where incident and reflected wave overlap")
        peaks.doubt("A", doubt)
        peaks.doubt("A", doubt_b)
        _same_impulse(
            peaks,
            force_a,
            force_b,
            time,
            bar.gain_sd + gain_b,
            bar.stiffness * (inc.offset + signal.offset) + behind.stiffness * rec.offset,
        )
        if whole:
            each = (
                ("incident", bar, incident),
                ("reflected", bar, reflected),
                ("transmitted", behind, transmitted),
            )
            energies = {
                name: one.stiffness * one.wave_speed * step * float(np.square(strain).sum())
                for name, one, strain in each
            }
            energies["absorbed"] = (
                energies["incident"] - energies["reflected"] - energies["transmitted"]
            )
        else:
            ends = f"from {first * step * 1e6:.4g} to {last * step * 1e6:.4g} us"
            changes.add(
                "overlap", inc.name, f"longer than the way to the face and back: A is known {ends}"
            )
        force_a[:first] = force_a[last:] = np.nan
    _struck(
        peaks, 2.0 * bar.wave_speed * wave.peak, wave.peak, document.record.striker_speed, changes
    )
    _held_together(peaks, bar.stiffness * wave.peak if wave.ended else math.inf, document)
    _bent(peaks, "B", behind.stiffness * _at(rec.spread, to_b, count), time, peaks["B"].value)
    if not withheld:
        both = np.maximum(_at(inc.spread, float(start), count), _at(signal.spread, to_a, count))
        _bent(peaks, "A", bar.stiffness * both, time, bar.stiffness * wave.peak)
        every = dict.fromkeys((*peaks["mean"].doubts, *peaks["A"].doubts, *peaks["B"].doubts))
        peaks["mean"] = replace(peaks["mean"], doubts=tuple(every))
    else:
        peaks.doubt("B", "the force at A is not known: gauge and gain of B are not checked by it")
    balanced, rate = _balance(time, force_a, force_b, peaks["B"])
    # parabolas over half the rise follow the pulse and leave most of the noise
    pulse = -inc.strain[start : wave.end + lead]
    pulse = (
        savgol_filter(pulse, 2 * (wave.rising // 4) + 1, 2)
        if 8 <= wave.rising < len(pulse)
        else pulse
    )
    pulse = moved_wave(pulse, bar.gauge, bar, step) if disperses else pulse
    pulse[[0, -1]] = 0.0
    return Reading(
        step=step,
        touch=record.start + step * start + (0.0 if aligned else bar.gauge / bar.wave_speed),
        time=time,
        force_a=force_a,
        force_b=force_b,
        sd_a=sd_a,
        sd_b=sd_b,
        pulse=pulse,
        peaks=dict(sorted(peaks.items())),
        energies=energies,
        balanced=balanced,
        loading_rate=rate,
        withheld=tuple(withheld),
        changes=tuple(changes),
    )


def _crossing(values: Array, level: float, begin: int, end: int) -> int | None:
    """First place in [begin, end) from which three values lie above a level."""
    above = values[begin:end] > level
    runs = np.flatnonzero(above[:-2] & above[1:-1] & above[2:])
    return begin + int(runs[0]) if len(runs) else None


def _arrivals(
    record: Record, document: RecordDocument, changes: Changes
) -> tuple[float, float, str, str, float]:
    """The three arrivals held against distances and wave speeds: delays of the reflected and the
    transmitted wave in samples, shifted where a wave comes a little early, why the distances to A
    and B are doubted, and the wave speed that the reflected wave has over that of the bar, 1
    without doubt."""
    step, inc, rec = record.step, record.incident, record.receiving
    bar, behind = document.incident_bar, document.receiving_bar
    wave = inc.wave
    if document.record.aligned:
        own = [s.wave.foot - _lead(s.wave) for s in (record.reflected or inc, rec)]
        start = max(wave.foot - _lead(wave), 0)
        return max(own[0], 0) - start, max(own[1], 0) - start, "", "", 1.0
    reflected = 2.0 * bar.gauge / bar.wave_speed / step
    transmitted = (bar.gauge / bar.wave_speed + behind.gauge / behind.wave_speed) / step
    steep, fast = float(wave.rising), 1.0

    def lags(share: float, window: float) -> tuple[int | None, int | None]:
        """Samples by which reflected and transmitted wave come behind the incident one; None where
        that is not seen.
        """
        width = max(1, round(window / step))
        calm = smooth(inc.strain, width)
        level = max(share * wave.peak, 5.0 * inc.noise / math.sqrt(width))
        first = _crossing(-calm, level, max(wave.foot - 2 * wave.rising - 5, 0), wave.falling)
        if first is None:
            return None, None
        if record.reflected is not None:
            back = _crossing(np.abs(smooth(record.reflected.strain, width)), level, 0, len(calm))
        else:  # the first excursion of either sign behind the end of the incident wave
            low = np.flatnonzero(-calm[wave.falling :] < level)
            back = (
                _crossing(np.abs(calm), level, wave.falling + int(low[0]) + 1, len(calm))
                if len(low)
                else None
            )
        level = max(share * rec.wave.peak, 5.0 * rec.noise / math.sqrt(width))
        there = _crossing(-smooth(rec.strain, width), level, 0, rec.wave.falling + 1)
        return None if back is None else back - first, None if there is None else there - first

    back, there = lags(*_SURE)
    if there is not None and there < -steep:
        raise UsageError(
            f"{rec.name}: its wave comes {-there * step * 1e6:.4g} us before the incident wave: "
            "are the "
            "columns exchanged?"
        )

    def doubt(
        name: str, lag: int | None, predicted: float, late: float, gauge: float, fits: float
    ) -> str:
        """Why a wave that comes `lag` samples behind the incident one does not fit the distance of
        its gauge [m].
        """
        off = 0.0 if lag is None else lag - predicted
        if (
            -(_EARLY * predicted + 0.5 * steep + 3.0)
            <= off
            <= late + _LATE * predicted + 2.0 * steep
        ):
            return ""
        would = f"{fits:.4g} m would fit" if fits > 0.0 else "no distance of this gauge fits"
        by = f"{abs(off) * step * 1e6:.4g} us too {'early' if off < 0.0 else 'late'}"
        return f"the {name} wave comes {by} for a gauge at {gauge:.4g} m; {would}"

    if doubt_a := doubt(
        "reflected", back, reflected, 5.0, bar.gauge, 0.5 * (back or 0) * step * bar.wave_speed
    ):
        doubt_a += " (or another E or density)"
        fast = reflected / max(back or 0, 1)
    # the transmitted wave may be late, by the transit and the softness of the specimen, but not
    # early
    late, fits = (
        0.5 * (wave.falling - wave.half) + 50e-6 / step,
        ((there or 0) * step - bar.gauge / bar.wave_speed),
    )
    if doubt_b := doubt(
        "transmitted", there, transmitted, late, behind.gauge, fits * behind.wave_speed
    ):
        also = transmitted / max(there or 0, 1)
        if doubt_a and abs(also - fast) < abs(fast - 1.0) / 3.0:
            seen = f"{fast * bar.wave_speed:.4g} m/s, not {bar.wave_speed:.4g} m/s"
            why = "E, density or both distances are wrong"
            raise UsageError(
                f"both arrivals fit a wave speed of {seen}: {why} ({doubt_a}; {doubt_b})"
            )
        if (
            there is not None and there < transmitted
        ):  # no force before first touch: the incident wave is elsewhere
            doubt_a = doubt_a or doubt_b
    if steep < 0.05 * reflected and not doubt_a and not doubt_b:
        back, there = lags(*_FINE)
        for name, lag, predicted in (
            ("reflected", back, reflected),
            ("transmitted", there, transmitted),
        ):
            off = 0.0 if lag is None else lag - predicted
            if -_EARLY * predicted - 3.0 <= off < -max(1.0, 1e-6 / step):
                signal = rec.name if name == "transmitted" else (record.reflected or inc).name
                text = (
                    f"the {name} wave is taken {-off * step * 1e6:.3g} us earlier than the "
                    "gauges' distances predict"
                )
                changes.add("time shift", signal, text, off * step)
                reflected += off * (name == "reflected")
                transmitted += off * (name == "transmitted")
    return reflected, transmitted, doubt_a, doubt_b, fast


def _lead(wave: Wave) -> int:
    """Samples before the foot of a wave that belong to it."""
    return max(2, round(0.2 * wave.rising))


def _clean(wave: Wave, start: int, delay: float) -> tuple[int, int]:
    """Samples after first touch between which the incident gauge shows incident and reflected wave
    one by one.
    """
    if not math.isfinite(delay) or wave.end - start <= delay:
        return 0, 1 << 60
    return math.ceil(wave.end - start - delay + 0.05 * delay), int(delay)


def _sign_of_reflected(
    record: Record,
    document: RecordDocument,
    incident: Array,
    reflected: Array,
    bar: BarTable,
    changes: Changes,
) -> tuple[float, str]:
    """+1 or -1 for a reflected wave in a column of its own, with a doubt where its sign had to be
    taken.

    The sign is that of its bar.  Only where waves were cut out, so that each may stand as its size,
    a reflected wave of the sign of the incident one is turned: a specimen softer than the bar
    pulls.
    """
    if record.reflected is None or document.record.polarity != "auto":
        return 1.0, ""
    body = np.abs(reflected) > 0.5 * float(np.abs(reflected).max())
    if not document.record.aligned or float(reflected[body].mean()) > 0.0:
        return 1.0, ""
    changes.add(
        "sign", record.reflected.name, "has the sign of the incident wave; taken as a size, tension"
    )
    other = bar.stiffness * float(-(incident + reflected).min())
    return (
        -1.0,
        (
            "the reflected wave is taken as tension; as it stands in the file A would be "
            f"{other * 1e-3:.4g} kN"
        ),
    )


def _known(signal: Signal, place: int, most: float) -> int:
    """Samples from a place on, at most so many, until the record ends or one is not known."""
    count = int(min(len(signal.strain) - 3 - place, most))
    lost = np.flatnonzero(~signal.known[max(place, 0) : max(place, 0) + max(count, 0)])
    return int(lost[0]) if len(lost) else count


def _at(values: Array, place: float, count: int) -> Array:
    """Samples from a place between samples on, by cubic splines."""
    return np.asarray(map_coordinates(values, [place + np.arange(count)], order=3, mode="nearest"))


def moved_wave(wave: Array, distance: float, bar: BarTable, step: float) -> Array:
    """A wave (n,) by itself, `distance` [m] further on, in the time of the one-dimensional wave.

    Phases by the first mode of Pochhammer and Chree (P. S. Follansbee, C. Frantz, J. Eng. Mater.
    Technol. 105 (1983) 61); amplitudes stay, since the factors of the section amplify noise.
    """
    room = max(8, math.ceil(2.0 * abs(distance) / bar.wave_speed / step))
    fading = wave[-1] * 0.5 * (1.0 + np.cos(np.linspace(0.0, math.pi, room)))
    padded = np.concatenate([np.zeros(room), wave, fading, np.zeros(room)])
    found = correct(
        padded,
        step,
        distance,
        radius=0.5 * bar.diameter,
        wave_speed=bar.wave_speed,
        nu=bar.nu,
        surface=False,
    )
    return np.asarray(found[room : room + len(wave)])


def _at_face(
    signal: Signal,
    place: float,
    count: int,
    distance: float,
    bar: BarTable,
    step: float,
    changes: Changes | None,
) -> Array:
    """A wave of a gauge from a place on, (count,); where `changes` are given as it is at the
    face.
    """
    if changes is None:
        return _at(signal.strain, place, count)
    more = min(
        count + math.ceil(abs(distance) / bar.wave_speed / step),
        len(signal.strain) - 3 - int(place),
    )
    wave = _at(signal.strain, place, max(count, more))
    moved = moved_wave(wave, distance, bar, step)[:count]
    by = float(np.abs(moved - wave[:count]).max())
    share = by / max(float(np.abs(wave[:count]).max()), 1e-300)
    text = f"moved to the face by the first mode of a bar: changes of up to {share:.1%} of the wave"
    changes.add("dispersion", signal.name, text, by)
    return moved


def _peak(time: Array, force: Array, sd: Array, noise: float, memory: float) -> Peak:
    """The largest force from a parabola over a third of its top, not from its highest sample."""
    calm = median_filter(force, 5, mode="nearest")
    at = int(np.argmax(calm))
    low = np.flatnonzero(calm < 0.8 * calm[at])
    before, behind = low[low < at], low[low > at]
    top = int(behind[0] if len(behind) else len(calm)) - int(before[-1] if len(before) else 0)
    width = min(max(5, 2 * (top // 6) + 1), len(calm) - 1 + len(calm) % 2)
    curve = savgol_filter(savgol_filter(calm, width, 2), width, 2)
    at = int(np.argmax(curve))
    value = float(curve[at])
    # the middle of a parabola through `width` samples has 9/4 of the variance of their mean
    kept = noise * math.sqrt(min(1.0, 2.25 * memory / width))
    # of m places that might as well be the top the highest is too high, by Blom's mean of the
    # largest of m
    rivals = 1.0 + float((curve > value - 2.0 * kept).sum()) / (width * max(1.0, memory / width))
    value -= kept * float(ndtri((rivals - 0.375) / (rivals + 0.25)))
    half = NORMAL * math.hypot(math.sqrt(max(float(sd[at]) ** 2 - noise**2, 0.0)), kept)
    high, doubts = value + half, []
    highest = float(force.max())
    if highest > value + 5.0 * noise + 0.05 * value:
        doubts.append(
            f"single samples reach {highest * 1e-3:.4g} kN, which those around them do not bear out"
        )
        high = max(high, highest)
    if top < _FEW_ON_TOP:
        doubts.append(f"its top has {top} samples: the record is too slow for it")
        high = max(high, highest)
    if at >= len(force) - max(3, width // 2) or float(curve[-1]) > _FALLEN * value:
        doubts.append("the force is largest where the record ends: it is at least this")
        high = math.inf
    return Peak(
        value=value, low=value - half, high=high, time=float(time[at]), doubts=tuple(doubts)
    )


def _struck(
    peaks: Peaks, struck: float, strain: float, given: float | None, changes: Changes
) -> None:
    """The incident wave against the speed of the striker [m/s], given or of any test."""
    if given is None:
        changes.add(
            "gains",
            "",
            "a factor of both bars (gain, E, diameter) does not show in a record; "
            "record.striker_speed checks the gains",
        )
    if (
        _STRUCK[0] <= struck <= _STRUCK[1]
        if given is None
        else abs(struck - given) <= _AWRY * given
    ):
        return
    text = (
        f"an incident wave of {strain * 1e6:.4g} microstrain is that of a striker of "
        f"{struck:.3g} m/s"
    )
    text += (
        ": is a unit or a gain wrong?"
        if given is None
        else f", not {given:.3g} m/s: a gain or a unit is wrong"
    )
    for face, peak in [*peaks.items()]:
        peaks.doubt([face], text, *(v * (given or struck) / struck for v in (peak.low, peak.high)))


def _bent(peaks: Peaks, face: str, spread: Array, time: Array, whole: float) -> None:
    """What the gauges of the bar of a face differ by [N], against the wave `whole` [N]."""
    at = int(np.searchsorted(time, peaks[face].time))
    near = spread[max(at - 3, 0) : at + 4]
    bent = float(near.mean()) if len(near) else 0.0
    if 2.0 * bent > _GROSS * whole:
        text = (
            f"the gauges of the {'incident' if face == 'A' else 'receiving'} bar differ by "
            f"{2.0 * bent / whole:.0%}"
        )
        peaks.doubt(
            face, f"{text} of the wave there", peaks[face].low - bent, peaks[face].high + bent
        )


def _same_impulse(
    peaks: Peaks, force_a: Array, force_b: Array, time: Array, gains: float, zeros: float
) -> None:
    """A specimen moves little: while B bears half its largest force or more, A gives the same
    impulse (in place).

    gains : sum of the relative standard deviations of both gains; zeros : sum of those of the
        forces' zeros [N].
    """
    b, low = peaks["B"], force_b < 0.5 * peaks["B"].value
    at = int(np.searchsorted(time, b.time))
    before, behind = np.flatnonzero(low[:at]), np.flatnonzero(low[at:])
    held = slice(
        int(before[-1]) + 1 if len(before) else 0, at + int(behind[0]) if len(behind) else len(low)
    )
    known = np.isfinite(force_a[held])
    share = float(force_a[held][known].sum() / max(force_b[held][known].sum(), 1e-300))
    if known.sum() > 2 and abs(share - 1.0) > NORMAL * (gains + zeros / b.value):
        text = f"A gives {share:.3g} times the impulse of B: a gain, a zero or an arrival is wrong"
        for face, peak in [*peaks.items()]:
            peaks.doubt(
                [face],
                text,
                peak.value * (share if face == "B" else 1.0 / share if share > 0.0 else 1.0),
            )


def _held_together(peaks: Peaks, pressed: float, document: RecordDocument) -> None:
    """The faces against each other, the wave that made them [N], and the specimen (in place)."""
    strongest, before = document.specimen.strongest, dict(peaks)
    for face, peak in before.items():
        if peak.low > 2.0 * pressed:
            text = f"an incident wave of {pressed * 1e-3:.4g} kN presses with at most twice as much"
            peaks.doubt([face], text, 2.0 * pressed)
        if _WIDE * peak.value < peak.high - peak.low < math.inf:
            half = 0.5 * (peak.high - peak.low) / peak.value
            peaks.doubt([face], f"hardly known: 95 % interval of +- {half:.0%}")
        if strongest is not None and peak.low > strongest:
            peaks.doubt([face], f"the specimen bears at most {strongest * 1e-3:.4g} kN", strongest)
    if "A" not in before:
        return
    a, b = before["A"], before["B"]
    apart = abs(a.value - b.value) / max(a.value, b.value)
    if a.low > b.high or b.low > a.high or apart > _APART:
        text = (
            f"the faces differ by {apart:.0%} (A {a.value * 1e-3:.4g}, B {b.value * 1e-3:.4g} kN)"
        )
        peaks.doubt(before, text, a.low, b.low, a.high, b.high)
    if before["mean"].value < (1.0 - _BALANCE) * 0.5 * (a.value + b.value):
        text = (
            f"both faces reach their largest force {abs(a.time - b.time) * 1e6:.4g} us apart: no "
            "common force"
        )
        peaks.doubt(["mean"], text, a.high, b.high)


def _balance(
    time: Array, force_a: Array | None, force_b: Array, peak: Peak
) -> tuple[float | None, float]:
    """Share of the rise in which both forces agree within 5 % of their mean, and the loading rate
    [N/s].
    """
    top = max(int(np.searchsorted(time, peak.time)), 3)
    calm = smooth(force_b, 5)
    half = min(int(np.argmax(calm > 0.5 * peak.value)), top - 2)
    rate = 0.5 * peak.value / float(time[top] - time[half])
    if force_a is None or np.isnan(force_a).any():
        return None, rate
    mean = 0.5 * (smooth(force_a, 5) + calm)
    even = np.abs(smooth(force_a, 5) - calm) <= 2.0 * _BALANCE * np.abs(mean)
    return float(even[half : top + 1].mean()), rate
