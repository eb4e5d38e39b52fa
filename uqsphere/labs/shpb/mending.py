"""From raw strains to signals about their rest: spikes, clipping, baseline, drift, sign, gauges.

Every step adds a `Change` with its size.  What cannot be mended without inventing a record is
marked as unknown, or refused.
"""

import math
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_closing, maximum_filter, median_filter, uniform_filter1d

from uqsphere.arrays import Array, Flags, Places
from uqsphere.errors import UsageError
from uqsphere.tables import TableError

from .document import BarTable, RecordDocument
from .recorder import Changes, Trace, read_traces

#: no wave of a bar is shorter [s]
_SHORTEST = 1e-6
#: part of the longest excursion that a first wave lasts: trigger bursts are shorter
_LASTS = 0.25
#: most samples on either side of a running median
_LONGEST_MEDIAN = 40
#: fewest samples of a rest, and of a baseline
_FEWEST, _BASELINE = 20, 10
#: robust standard deviations, and share of the peak, beyond which a sample is a spike
_ODD, _ROBUST, _SPIKE_SHARE = 8.0, 1.4826, 0.02
#: a gauge that records less than this share of its partner's peak is dead
_DEAD = 0.2
#: passes of the incident bar that no pulse lasts
_PASSES = 12.0
#: share of the largest strain by which the incident wave is found, however large echoes are later
_INCIDENT = 0.2


class Wave(NamedTuple):
    """The first wave of a signal, by samples.

    half, falling : first and last sample above half its top, or another share by which it is
        sought; foot, end : first and last sample.
    rising : samples from a fifth of that share to it.
    peak : top of the smoothed signal, above 0; sign : +1 for tension.
    ended : whether the signal returns to rest.
    """

    half: int
    falling: int
    rising: int
    peak: float
    sign: float
    foot: int
    end: int
    ended: bool

    @property
    def lead(self) -> int:
        """Samples before the foot that belong to the wave."""
        return max(2, round(0.2 * self.rising))

    @property
    def start(self) -> int:
        """The first sample that belongs to the wave."""
        return max(self.foot - self.lead, 0)


class Signal(NamedTuple):
    """The strain (n,) of one bar or one wave about its rest, compression negative.

    role, name, bar, changes, step, known : as of a `Trace`.
    noise : standard deviation of a sample at rest, correlated over `memory` samples.
    offset : standard deviation of the baseline.
    single : whether a bar has one working gauge, which does not show bending.
    spread : (n,) half the difference between the gauges of a bar; one 0 for one gauge.
    """

    role: str
    name: str
    bar: BarTable
    changes: Changes
    step: float
    strain: Array
    known: Flags
    noise: float
    offset: float
    wave: Wave
    memory: float = 1.0
    single: bool = False
    spread: Array = np.zeros(1)

    @property
    def peak(self) -> float:
        """The largest strain: of the wave, or of the known samples where some are not."""
        if self.known.all():
            return self.wave.peak
        return float(np.abs(self.strain[self.known]).max(initial=0.0))


def note(gauge: Trace | Signal, step: str, text: str, size: float | None = None) -> None:
    """Note what a step of mending changed at a gauge."""
    gauge.changes.add(text, step, size, gauge.name)


class Record(NamedTuple):
    """Mended signals over even time from `start` [s] on.

    reflected : of its own column; `incident` where the incident gauge records both waves.
    """

    document: RecordDocument
    start: float
    incident: Signal
    reflected: Signal
    receiving: Signal

    @property
    def shared(self) -> bool:
        """Whether one gauge records the incident and the reflected wave."""
        return self.reflected is self.incident


def load_record(document: RecordDocument, folder: Path) -> Record:
    """The record of an input file, read and mended.

    Raises UsageError for columns, units or a clock that cannot be, for a pulse longer than any
        striker gives, and for a signal without a wave or a rest.
    """
    changes = Changes()
    asked = document.record
    bar = document.incident_bar
    behind = document.receiving_bar
    start, traces = read_traces(document, folder, changes)
    traces = [_without_faults(trace) for trace in traces]
    pulses = [
        _first_wave(trace, _above_rest(trace.strain), share=_INCIDENT)
        for trace in traces
        if trace.role == "incident"
    ]
    length = len(traces[0].strain)
    step = traces[0].step
    passage = (bar.length or math.inf) / bar.wave_speed
    passes = min(pulse.falling - pulse.half + 1 for pulse in pulses) * step / passage
    if passes > _PASSES:
        raise TableError(
            f"the pulse lasts {passes:.0f} passes of the incident bar. Is the time in another unit "
            "(record.time_unit)?",
            "time_unit",
        )
    # the first wave of a signal begins before the first echo of a far end
    first = min(pulse.half for pulse in pulses)
    delay = bar.passage + behind.passage + behind.echo
    echoes = {"incident": first + 2.0 * passage / step, "receiving": first + delay / step}
    polarity = {"auto": 0.0, "tension": 1.0, "compression": -1.0}[asked.polarity]
    signals = {}
    signs = list[float]()
    for role, gauges in groupby(traces, lambda trace: trace.role):
        end = 0
        limit = length
        turned = []
        names = []
        if not asked.aligned:
            limit = int(min(length, echoes.get(role, length)))
        if role == "receiving":
            end = max(min(pulse.half - 2 * pulse.rising for pulse in pulses), 0)
        for trace in gauges:
            if asked.aligned:
                signal = _cut_out(trace)
            else:
                signal = _about_rest(trace, end, limit)
            # one sign a bar: a reflected wave has the sign of its incident gauge
            sign = polarity or -signal.wave.sign
            if role == "reflected":
                sign = signs[0]
            signs.append(sign)
            if sign < 0.0:
                names.append(signal.name)
            wave = signal.wave._replace(sign=signal.wave.sign * sign)
            turned.append(signal._replace(strain=signal.strain * sign, wave=wave))
        if names and not polarity:
            changes.add(
                "compression is positive in the file; the sign is changed",
                "sign",
                signal=", ".join(names),
            )
        signals[role] = _joined(turned, limit)
    incident = signals["incident"]
    if asked.window:
        begin, end = (round((time - start) / step) for time in asked.window)
        if not 0 <= begin < end < length:
            raise TableError("record.window must be [begin, end] within the record", "window")
        inside = np.zeros(length)
        inside[begin : end + 1] = incident.strain[begin : end + 1]
        wave = _first_wave(incident, inside, incident.noise)
        incident = incident._replace(wave=wave._replace(foot=begin, end=end))
    return Record(
        document, start, incident, signals.get("reflected", incident), signals["receiving"]
    )


# --- first waves ----------------------------------------------------------------------------------


def runs(same: Flags) -> tuple[Places, Places]:
    """First places and lengths of the runs of True."""
    edges = np.flatnonzero(np.diff(same, prepend=False, append=False))
    return edges[::2], edges[1::2] - edges[::2]


def smooth(values: Array, samples: int) -> Array:
    """Running means over so many samples."""
    return uniform_filter1d(values, samples, mode="constant")


def _first_wave(
    gauge: Trace | Signal, values: Array, noise: float = 0.0, share: float = 0.5
) -> Wave:
    """The first long stay of a signal (n,) about zero above a share of its largest value.

    Trigger bursts swing within a few microseconds: running medians remove them.

    Raises UsageError for a signal that stays nowhere, or does not rise above its noise at rest.
    """
    half = min(3 * round(_SHORTEST / gauge.step), _LONGEST_MEDIAN)
    width = max(1, round(2.0 * _SHORTEST / gauge.step))
    smoothed = smooth(median_filter(values, 2 * half + 1, mode="nearest"), width)
    size = np.abs(smoothed)
    begins, lengths = runs(size > share * size.max())
    if lengths.max(initial=0) < 3 or not size.max() > 5.0 * noise / math.sqrt(width):
        raise UsageError(f"{gauge.name}: no wave rises above the noise before it")
    chosen = np.argmax(lengths >= max(3.0, _LASTS * lengths.max()))
    first = begins[chosen]
    last = first + lengths[chosen] - 1
    sign = math.copysign(1.0, smoothed[first])
    upward = sign * smoothed
    peak = upward[first : last + 1].max()
    rising = first - np.flatnonzero(upward[:first] < 0.2 * share * peak).max(initial=0)
    # from foot to end, by running means that are short beside its rise
    width = max(width, rising // 5 + 1)
    upward = sign * smooth(values, width)
    level = max(0.01 * peak, 4.0 * noise / math.sqrt(width))
    before = np.flatnonzero(upward[:first] < level)
    behind = last + np.flatnonzero(upward[last:] < max(0.02 * peak, level))
    return Wave(
        half=first,
        falling=last,
        rising=rising,
        peak=peak,
        sign=sign,
        foot=before.max(initial=-1) + 1,
        end=behind.min(initial=len(values) - 1),
        ended=len(behind) > 0,
    )


# --- spikes, clipping -----------------------------------------------------------------------------


def _without_faults(trace: Trace) -> Trace:
    """A gauge whose spikes, which jump up and down faster than any wave of a bar, are replaced by
    lines, and whose clipped samples are marked unknown."""
    values = trace.strain.copy()
    longest = min(max(5, math.ceil(_SHORTEST / trace.step)), 40)
    removed = []
    for _ in range(3):  # a large spike hides smaller ones
        spikes = _spikes(values, longest)
        for first, last, _size in spikes:
            inside = np.arange(first, last + 1)
            ends = [first - 1, last + 1]
            values[inside] = np.interp(inside, ends, values[ends])
        removed += spikes
        if not spikes:
            break
    if removed:
        samples = sum(last - first + 1 for first, last, _ in removed)
        first, _, size = max(removed, key=lambda spike: abs(spike[2]))
        note(
            trace,
            "spikes",
            f"{_counted(len(removed), 'spike')} ({_counted(samples, 'sample')}) removed, the "
            f"largest {size * 1e6:.4g} microstrain at sample {first}",
            size,
        )
    known = trace.known
    head = values[: max(len(values) // 20, _FEWEST)]
    # a recorder writes the end of its range again and again; without noise a top may be flat
    quiet = runs(np.diff(head) == 0.0)[1].max(initial=0)
    for extreme in (values.max(), values.min()):
        same = np.abs(values - extreme) <= 1e-9 * abs(extreme)
        repeats = runs(same)[1].max()
        if np.ptp(head) > 0.0 and repeats >= 8 and repeats > 2 * (quiet + 1):
            known = known & ~same
            note(
                trace,
                "clipped",
                f"clipped at {extreme * 1e6:.5g} microstrain, {same.sum()} samples: its peak is "
                "not known",
                extreme,
            )
    return trace._replace(strain=values, known=known)


def _counted(number: int, noun: str) -> str:
    if number != 1:
        noun += "s"
    return f"{number} {noun}"


def _spikes(values: Array, longest: int) -> list[tuple[int, int, float]]:
    """The spikes of a signal, excursions of few samples from its running median: first and last
    sample, and size in strain."""
    width = 4 * longest + 1
    if len(values) < 2 * width:
        return []
    middle = median_filter(values, width, mode="nearest")
    left = values - middle
    away = np.abs(left)
    scatter = np.maximum(median_filter(away, 5 * width, mode="nearest"), np.median(away))
    peak = np.abs(_above_rest(middle)).max()
    bounds = np.maximum(_ODD * (_ROBUST * scatter), _SPIKE_SHARE * peak)
    near = away > np.maximum(0.5 * bounds, 0.05 * maximum_filter(away, width, mode="nearest"))
    spikes = []
    for first, length in zip(*runs(binary_closing(near)), strict=True):
        last = first + length - 1
        if first < 1 or last > len(left) - 2:
            continue
        inner = left[first : last + 1]
        size = inner[np.argmax(np.abs(inner))]
        # a spike above any wave rings for longer
        allowed = 2 * longest if abs(size) > peak else longest
        if length > allowed or not (np.abs(inner) > bounds[first : last + 1]).any():
            continue
        jumps = np.diff(values[first - 1 : last + 2]) / size
        if min(jumps.max(), -jumps.min()) > 0.4:
            spikes.append((first, last, size))
    return spikes


# --- the rest before the first wave ---------------------------------------------------------------


def _above_rest(values: Array) -> Array:
    """A signal (n,) less its median at the beginning of the record."""
    return values - np.median(values[: max(_FEWEST, len(values) // 50)])


def _line(quiet: Array, place: Array) -> tuple[float, float, float, float]:
    """Slope of a line through samples at rest, with its standard deviation; the noise about the
    line, and the samples over which it is correlated."""
    about = place - place.mean()
    squares = about @ about
    rest = quiet - quiet.mean()
    slope = about @ rest / squares
    left = rest - slope * about
    noise = left.std(ddof=2)
    memory = 1.0
    if noise <= 1e-12 * np.abs(quiet).max():  # rounding is not noise
        return slope, 1e-6 * abs(slope), 0.0, memory
    for lag in range(1, min(len(left) // 4, 200)):
        correlation = (left[lag:] * left[:-lag]).mean() / noise**2
        if correlation < 2.0 / math.sqrt(len(left)):
            break
        memory += 2.0 * correlation
    return slope, noise * math.sqrt(memory / squares), noise, memory


def _about_rest(trace: Trace, end: int, limit: int) -> Signal:
    """A gauge about its rest: baseline and drift come from the samples before its first wave.

    end : sample before which the other bar shows that this one is at rest, 0 where it does not;
        limit : sample before which its first wave stands.

    Raises UsageError for a gauge without a wave or a rest.
    """
    values = trace.strain
    places = np.arange(len(values), dtype=float)
    wave = _first_wave(trace, _above_rest(values)[:limit])
    early = max(wave.half - 3 * wave.rising, end)
    if early >= 3 * _BASELINE:  # the wave above the scatter of the rest about a line through it
        third = early // 3
        climb = float(np.median(values[2 * third : early]) - np.median(values[:third]))
        slope = climb / (2.0 * third)
        left = (values - slope * places)[:early]
        level = np.median(left)
        scatter = _ROBUST * np.median(np.abs(left - level))
        if abs(climb) <= 7.0 * scatter / math.sqrt(third):
            slope = 0.0
        wave = _first_wave(trace, (values - (level + slope * places))[:limit], scatter)
    count = max(wave.foot - max(3, wave.rising // 5), 0)
    if end >= _BASELINE:
        count = max(count, min(end, wave.half))
    rest = slice(count)
    if count < _BASELINE:
        rest = slice(-max(2 * _BASELINE, len(values) // 20), None)
        if np.ptp(values[rest]) > 0.1 * wave.peak:
            raise UsageError(
                f"{trace.name}: there is no rest before or after its wave. Was the wave cut out "
                "(record.aligned = true)?"
            )
        mean = values[rest].mean()
        if abs(np.median(values[:5]) - mean) > 0.1 * wave.peak:
            raise UsageError(
                f"{trace.name}: the record begins inside the wave; its beginning is missing"
            )
        note(trace, "baseline", "taken from the end of the record")
        wave = _first_wave(trace, values - mean)
    quiet = values[rest]
    place = places[rest]
    away = np.abs(quiet - np.median(quiet))
    burst = away > max(_ODD * _ROBUST * np.median(away), 0.02 * wave.peak)
    if 0 < burst.sum() < len(quiet) // 3:
        note(
            trace,
            "baseline",
            f"{burst.sum()} samples of trigger noise, up to {away.max() * 1e6:.4g} microstrain, "
            "are left out of the rest",
            away.max(),
        )
        quiet = quiet[~burst]
        place = place[~burst]
    slope, slope_sd, noise, memory = _line(quiet, place)
    mean = quiet.mean()
    offset = noise * math.sqrt(min(1.0, memory / len(quiet)))
    if abs(mean) > 0.005 * wave.peak:
        note(
            trace,
            "baseline",
            f"a baseline of {mean * 1e6:.4g} microstrain is subtracted "
            f"({abs(mean) / wave.peak:.1%} of the wave)",
            mean,
        )
    strain = values - mean
    middle = place.mean()
    reach = wave.end - middle
    drift = slope * reach
    if abs(slope) > 5.0 * slope_sd and abs(drift) > 0.01 * wave.peak:
        strain = values - (mean + slope * (places - middle))
        offset = math.hypot(offset, slope_sd * reach)
        note(
            trace,
            "drift",
            f"a drift of {slope / trace.step * 1e3:.4g} microstrain/ms is subtracted, "
            f"{drift * 1e6:.3g} microstrain in total",
            drift,
        )
    return Signal(*trace._replace(strain=strain), noise, offset, wave, memory)


def _cut_out(trace: Trace) -> Signal:
    """A wave that was cut out at its foot: without a rest, its first samples are its zero."""
    start = float(np.median(trace.strain[:3]))
    values = trace.strain - start
    noise = _ROBUST * np.median(np.abs(np.diff(values))) / math.sqrt(2.0)
    wave = _first_wave(trace, values, noise)
    note(
        trace,
        "baseline",
        f"cut out at its foot: its first {start * 1e6:.4g} microstrain are its zero",
        start,
    )
    return Signal(*trace._replace(strain=values), noise, 0.01 * wave.peak, wave)


# --- the gauges of a bar --------------------------------------------------------------------------


def _joined(gauges: list[Signal], limit: int) -> Signal:
    """The gauges of a bar as one signal: dead ones left out, the others averaged, with the bending
    that they show."""
    largest = max(gauge.peak for gauge in gauges)
    alive = []
    for gauge in gauges:
        share = gauge.peak / largest
        if share >= _DEAD:
            alive.append(gauge)
        else:
            note(gauge, "gauges", f"records {share:.1%} of the wave of its partner and is left out")
    if len(alive) == 1:
        return alive[0]._replace(single=len(gauges) > 1)
    first = min(gauge.wave.foot for gauge in alive)
    known = np.array([gauge.known for gauge in alive])
    strains = np.array([gauge.strain for gauge in alive])
    every = np.all(known, axis=0)
    # where a gauge is not known the others stand for the mean, with the largest difference so far
    mean = (strains * known).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    spread = 0.5 * np.ptp(strains, axis=0)
    spread[~every] = spread[first:][every[first:]].max(initial=0.0)
    count = max(first - 3, _BASELINE)
    _, _, noise, memory = _line(mean[:count], np.arange(count, dtype=float))
    joined = alive[0]._replace(
        name=" and ".join(gauge.name for gauge in alive),
        strain=mean,
        known=np.any(known, axis=0),
        noise=noise,
        memory=memory,
        offset=math.hypot(*(gauge.offset for gauge in alive)) / len(alive),
        spread=spread,
        single=len(alive) < len(gauges),
    )
    wave = _first_wave(joined, mean[:limit], noise)
    bending = spread[wave.foot : wave.end + 1].max()
    note(
        joined,
        "gauges",
        f"averaged; they differ by up to {2.0 * bending / wave.peak:.1%} of the wave",
        bending,
    )
    return joined._replace(wave=wave)
