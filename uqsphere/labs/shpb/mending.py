"""From raw strains to signals about their rest: spikes, clipping, baseline, drift, gauges.

Every step adds a `Change` with its size.  What cannot be mended without inventing a record is
marked as unknown, or refused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from scipy.ndimage import binary_closing, maximum_filter, median_filter

from uqsphere.arrays import Array, Flags
from uqsphere.errors import UsageError
from uqsphere.labs.shpb.columns import Trace
from uqsphere.labs.shpb.signals import SHORTEST, Changes, Signal, Wave, first_wave, runs

#: fewest samples of a rest, and of a baseline
_FEWEST, _BASELINE = 20, 10
#: robust standard deviations, and share of the peak, beyond which a sample is a spike
_ODD, _ROBUST, _SPIKE_SHARE = 8.0, 1.4826, 0.02
#: a gauge that records less than this share of its partner's peak is dead
_DEAD: Final = 0.2


def rest_of(values: Array) -> float:
    """The strain at the beginning of a record."""
    return float(np.median(values[: max(2 * _BASELINE, len(values) // 50)]))


# --- spikes, clipping -----------------------------------------------------------------------------


def without_faults(trace: Trace, step: float, changes: Changes) -> Trace:
    """A gauge whose spikes are replaced by lines and whose clipped samples are marked unknown."""
    strain = _without_spikes(trace, step, changes)
    return replace(trace, strain=strain, known=trace.known & ~_clipped(trace.name, strain, changes))


def _without_spikes(trace: Trace, step: float, changes: Changes) -> Array:
    """Samples that jump up and down faster than any wave of a bar are replaced by lines."""
    values = trace.strain.copy()
    longest = min(max(5, math.ceil(SHORTEST / step)), 40)
    if len(values) < 2 * (4 * longest + 1):
        return values
    removed = list[tuple[int, int, float]]()
    for _ in range(3):  # a large spike hides smaller ones
        spikes = _spikes(values, longest)
        for first, last, _ in spikes:
            inside, ends = np.arange(first, last + 1), [first - 1, last + 1]
            values[inside] = np.interp(inside, ends, values[ends])
        removed += spikes
        if not spikes:
            break
    if removed:
        samples = sum(last - first + 1 for first, last, _ in removed)
        first, _, size = max(removed, key=lambda spike: abs(spike[2]))
        changes.add(
            "spikes",
            trace.name,
            f"{_counted(len(removed), 'spike')} ({_counted(samples, 'sample')}) removed, the "
            f"largest {size * 1e6:.4g} microstrain at sample {first}",
            size,
        )
    return values


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _spikes(values: Array, longest: int) -> list[tuple[int, int, float]]:
    """The spikes of a signal, excursions of few samples from its running median: first and last
    sample, and size in strain."""
    width = 4 * longest + 1
    middle = median_filter(values, width, mode="nearest")
    left = values - middle
    away = np.abs(left)
    floor = np.median(away)
    scatter = _ROBUST * np.maximum(median_filter(away, 5 * width, mode="nearest"), floor)
    rest = np.median(middle[: max(_FEWEST, len(middle) // 50)])
    peak = float(np.abs(middle - rest).max())
    bounds = np.maximum(_ODD * scatter, _SPIKE_SHARE * peak)
    near = away > np.maximum(0.5 * bounds, 0.05 * maximum_filter(away, width, mode="nearest"))
    begins, lengths = runs(binary_closing(near, np.ones(3, dtype=bool)))
    spikes = []
    for first, length in zip(begins.tolist(), lengths.tolist(), strict=True):
        last = first + length - 1
        if first < 1 or last > len(left) - 2:
            continue
        inner = left[first : last + 1]
        size = float(inner[np.argmax(np.abs(inner))])
        # a spike above any wave rings for longer
        allowed = 2 * longest if abs(size) > peak else longest
        if length > allowed or not (np.abs(inner) > bounds[first : last + 1]).any():
            continue
        jumps = np.diff(values[first - 1 : last + 2]) / size
        if min(jumps.max(), -jumps.min()) > 0.4:
            spikes.append((first, last, size))
    return spikes


def _clipped(name: str, values: Array, changes: Changes) -> Flags:
    """Samples (n,) at the end of the recorder's range, where it writes one number repeatedly."""
    clipped = np.zeros(len(values), dtype=bool)
    head = values[: max(len(values) // 20, _FEWEST)]
    if np.ptp(head) == 0.0:  # a record without noise may have a flat top
        return clipped
    quiet = int(runs(np.diff(head) == 0.0)[1].max(initial=0))
    for extreme in (values.max(), values.min()):
        same = np.abs(values - extreme) <= 1e-9 * abs(extreme)
        longest = int(runs(same)[1].max())
        if longest >= 8 and longest > 2 * (quiet + 1):
            clipped |= same
            text = (
                f"clipped at {extreme * 1e6:.5g} microstrain, {int(same.sum())} samples: its "
                "peak is not known"
            )
            changes.add("clipped", name, text, float(extreme))
    return clipped


# --- the rest before the first wave ---------------------------------------------------------------


class _Line(NamedTuple):
    """A line through samples at rest.

    noise : standard deviation about the line, correlated over `memory` samples; slope : a sample,
    with its standard deviation; middle : place of the mean.
    """

    mean: float
    slope: float
    noise: float
    memory: float
    slope_sd: float
    middle: float


def _line(quiet: Array, place: Array) -> _Line:
    about = place - place.mean()
    squares = float(np.square(about).sum())
    mean, middle = float(quiet.mean()), float(place.mean())
    slope = float((about * (quiet - mean)).sum()) / squares
    left = quiet - mean - slope * about
    noise, memory = float(left.std(ddof=2)), 1.0
    if noise <= 1e-12 * float(np.abs(quiet).max(initial=0.0)):  # rounding is not noise
        noise, slope_sd = 0.0, 1e-6 * abs(slope)
    else:
        for lag in range(1, min(len(left) // 4, 200)):
            correlation = float((left[lag:] * left[:-lag]).mean() / noise**2)
            if correlation < 2.0 / math.sqrt(len(left)):
                break
            memory += 2.0 * correlation
        slope_sd = noise * math.sqrt(memory / squares)
    return _Line(mean, slope, noise, memory, slope_sd, middle)


def about_rest(
    trace: Trace, step: float, rest: tuple[int | None, float], changes: Changes
) -> Signal:
    """A gauge about its rest: baseline and drift come from the samples before its first wave.

    rest : sample before which the other bar shows that it is at rest, None where it shows that
        itself; sample before which its first wave stands.

    Raises UsageError for a gauge without a wave or a rest.
    """
    name, values, end = trace.name, trace.strain, rest[0]
    wave = _wave_above_rest(trace, step, *rest)
    count = max(wave.foot - max(3, wave.rising // 5), 0)
    if end is not None and end >= _BASELINE:
        count = max(min(count, len(values)), min(end, wave.half))
    quiet, place = values[:count], np.arange(count, dtype=float)
    if count < _BASELINE:
        quiet = _rest_at_end(name, values, wave)
        place = np.arange(len(values) - len(quiet), len(values), dtype=float)
        changes.add("baseline", name, "taken from the end of the record")
        wave = first_wave(values - float(quiet.mean()), step, 0.0, name)
    calm = _without_bursts(name, quiet, wave, changes)
    line = _line(quiet[calm], place[calm])
    offset = line.noise * math.sqrt(min(1.0, line.memory / int(calm.sum())))
    if abs(line.mean) > 0.005 * wave.peak:
        text = (
            f"a baseline of {line.mean * 1e6:.4g} microstrain is subtracted "
            f"({abs(line.mean) / wave.peak:.1%} of the wave)"
        )
        changes.add("baseline", name, text, line.mean)
    zero, reach = np.full(len(values), line.mean), wave.end - line.middle
    drift = line.slope * reach
    if abs(line.slope) > 5.0 * line.slope_sd and abs(drift) > 0.01 * wave.peak:
        zero += line.slope * (np.arange(len(values)) - line.middle)
        offset = math.hypot(offset, line.slope_sd * reach)
        text = (
            f"a drift of {line.slope / step * 1e3:.4g} microstrain/ms is subtracted, "
            f"{drift * 1e6:.3g} microstrain in total"
        )
        changes.add("drift", name, text, drift)
    return Signal(
        name=name,
        strain=values - zero,
        known=trace.known,
        noise=line.noise,
        memory=line.memory,
        offset=offset,
        spread=np.zeros(len(values)),
        wave=wave,
    )


def _wave_above_rest(trace: Trace, step: float, end: int | None, limit: float) -> Wave:
    """The first wave of a gauge, found about its median and then about its rest."""
    values = trace.strain
    seen = slice(int(min(limit, len(values))))
    wave = first_wave((values - rest_of(values))[seen], step, 0.0, trace.name)
    early = max(wave.half - 3 * wave.rising, end or 0, 0)
    if early < 3 * _BASELINE:
        return wave
    # the scatter of the rest before the wave, about a line through it
    third = early // 3
    climb = float(np.median(values[2 * third : early]) - np.median(values[:third]))
    slope = climb / (2.0 * third)
    left = values[:early] - slope * np.arange(early)
    scatter = _ROBUST * float(np.median(np.abs(left - np.median(left))))
    level: Array = np.full(len(values), float(np.median(left)))
    if abs(climb) > 7.0 * scatter / math.sqrt(third):
        level += slope * np.arange(len(values))
    return first_wave((values - level)[seen], step, scatter, trace.name)


def _rest_at_end(name: str, values: Array, wave: Wave) -> Array:
    """The last samples of a gauge that has no rest before its wave; UsageError without a rest."""
    last = values[-max(2 * _BASELINE, len(values) // 20) :]
    if np.ptp(last) > 0.1 * wave.peak:
        raise UsageError(
            f"{name}: there is no rest before or after its wave. Was the wave cut out "
            "(record.aligned = true)?"
        )
    if abs(float(np.median(values[:5])) - float(last.mean())) > 0.1 * wave.peak:
        raise UsageError(f"{name}: the record begins inside the wave; its beginning is missing")
    return last


def _without_bursts(name: str, quiet: Array, wave: Wave, changes: Changes) -> Flags:
    """Samples of a rest that are not trigger noise."""
    away = np.abs(quiet - np.median(quiet))
    burst = away > max(_ODD * _ROBUST * float(np.median(away)), 0.02 * wave.peak)
    if not 0 < burst.sum() < len(quiet) // 3:
        return np.ones(len(quiet), dtype=bool)
    size = float(away.max())
    text = (
        f"{int(burst.sum())} samples of trigger noise, up to {size * 1e6:.4g} microstrain, are "
        "left out of the rest"
    )
    changes.add("baseline", name, text, size)
    return np.asarray(~burst)


def cut_out(trace: Trace, step: float, changes: Changes) -> Signal:
    """A wave that was cut out at its foot: without a rest, its first samples are its zero."""
    start = float(np.median(trace.strain[:3]))
    values = trace.strain - start
    noise = _ROBUST * float(np.median(np.abs(np.diff(values)))) / math.sqrt(2.0)
    wave = first_wave(values, step, noise, trace.name)
    text = f"cut out at its foot: its first {start * 1e6:.4g} microstrain are its zero"
    changes.add("baseline", trace.name, text, start)
    return Signal(
        name=trace.name,
        strain=values,
        known=trace.known,
        noise=noise,
        offset=0.01 * wave.peak,
        spread=np.zeros(len(values)),
        wave=wave,
    )


# --- the gauges of a bar --------------------------------------------------------------------------


def joined(gauges: Sequence[Signal], step: float, limit: float, changes: Changes) -> Signal:
    """The gauges of a bar as one signal: dead ones left out, the others averaged, with the bending
    that they show."""
    largest, alive = max(map(_largest_known, gauges)), []
    for gauge in gauges:
        share = _largest_known(gauge) / largest
        if share >= _DEAD:
            alive.append(gauge)
        else:
            text = f"records {share:.1%} of the wave of its partner and is left out"
            changes.add("gauges", gauge.name, text)
    if len(alive) == 1:
        return replace(alive[0], single=len(gauges) > 1)
    first = min(gauge.wave.foot for gauge in alive)
    known = np.stack([gauge.known for gauge in alive], axis=1)
    strains = np.stack([gauge.strain for gauge in alive], axis=1)
    every = np.asarray(known.all(axis=1))
    # where a gauge is not known the others stand for the mean, with the largest difference so far
    mean = (strains * known).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    spread = 0.5 * np.ptp(strains, axis=1)
    spread[~every] = float(spread[first:][every[first:]].max(initial=0.0))
    count = max(first - 3, _BASELINE)
    line = _line(mean[:count], np.arange(count, dtype=float))
    name = " and ".join(gauge.name for gauge in alive)
    wave = first_wave(mean[: int(min(limit, len(mean)))], step, line.noise, name)
    bending = float(spread[wave.foot : wave.end + 1].max())
    text = f"averaged; they differ by up to {2.0 * bending / wave.peak:.1%} of the wave"
    changes.add("gauges", name, text, bending)
    return Signal(
        name=name,
        strain=mean,
        known=np.asarray(known.any(axis=1)),
        noise=line.noise,
        memory=line.memory,
        offset=math.hypot(*(gauge.offset for gauge in alive)) / len(alive),
        spread=spread,
        wave=wave,
        single=len(alive) < len(gauges),
    )


def _largest_known(gauge: Signal) -> float:
    """The peak of a gauge, of its known samples where some are not."""
    if gauge.known.all():
        return gauge.wave.peak
    return float(np.abs(gauge.strain[gauge.known]).max(initial=0.0))
