"""From the columns of a table to strain over even time, and the chain that mends it.

Units, clocks and gaps come first (`make_record`); then `mend`: spikes, clipped stretches, sign, baseline with drift,
several gauges of a bar.  Every step says what it changed, with signal, sample, time and size; what cannot be changed
without inventing a record is an error, or held: no answer may rest on it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.ndimage import binary_closing, maximum_filter, median_filter

from uqsphere.arrays import Array, Flags, Places
from uqsphere.records.table import SIGNAL_UNITS, RecordError, Table, place_of
from uqsphere.units import UNITS

#: missing samples in a row that are filled from their neighbours
_SHORT_GAP: Final = 10
#: samples beyond which a record is thinned, and about how many are left
_LARGE: Final = 1_000_000
_LEFT: Final = 400_000
#: more strain than this, and a longer record [s], is no record of a bar: the unit is wrong
_MOST_STRAIN: Final = 0.05
_LONGEST: Final = 10.0
#: equal samples in a row at the largest value that make a clipped record
_FLAT: Final = 8
#: samples of a record, and of a baseline, at the least
_FEWEST, _BASELINE = 20, 10
#: no wave of a bar lasts shorter: it would have to cross a bar of 5 mm in this time [s]
_SHORTEST: Final = 1e-6
#: standard deviation of a normal over its median deviation; robust standard deviations beyond which a sample is odd
_ROBUST, _ODD = 1.4826, 8.0
#: samples of a spike where these are more than `_SHORTEST`, and at the most, for the time that running medians take
_SPIKE, _SPIKE_MOST = 5, 40
#: samples between parts of one spike that rings, and the share of its size that they have
_RINGING, _RINGS = 3, 0.05
#: share of a spike that its neighbours have to jump: a wave climbs to its top in more than two samples
_JUMP: Final = 0.4
#: share of the peak, and standard deviations of a mean, at which a wave begins and ends
_FOOT_SHARE, _FOOT_NOISE = 0.01, 4.0
#: part of the longest excursion that a first wave has to last: bursts of a trigger do not
_LASTS: Final = 0.25
#: difference of two medians of n samples over their noise/sqrt(n) that is a drift: four times its 1.25 sqrt(2)
_CLIMBS: Final = 7.0
#: a gauge that shows less than this share of what its partner shows is dead
_DEAD: Final = 0.2
#: share of the peak beyond which a spike or a burst is one
_TOLD: Final = 0.02


@dataclass(frozen=True, kw_only=True)
class Change:
    """What a step of mending did or found: in words and, where it can be told, sample, time [s] and size [strain]."""

    step: str
    text: str
    signal: str = ""
    sample: int | None = None
    time: float | None = None
    size: float | None = None


@dataclass(frozen=True, kw_only=True)
class Wiring:
    """How a signal becomes a strain: eps = 4 U/(k N U_0 A) for a Wheatstone bridge, N active arms.

    unit : one of `SIGNAL_UNITS`; empty: what the file says, else strain.
    gauge_factor, excitation, amplification, active_arms : k [-], bridge supply U_0 [V] (0: not given), A of the
    amplifier, N: 1 quarter, 2 half bridge.
    time_unit : unit of the time; empty: what the file says, else s.
    """

    unit: str = ""
    gauge_factor: float = 2.0
    excitation: float = 0.0
    amplification: float = 1.0
    active_arms: float = 1.0
    time_unit: str = ""

    def factor(self, written: str, name: str) -> float:
        """Strain per unit of the column `name`, whose heading says `written`."""
        unit = self.unit or written or "strain"
        if unit not in SIGNAL_UNITS:
            raise RecordError(f"the unit {unit!r} of {name} is not known; allowed: {', '.join(SIGNAL_UNITS)}")
        factor, volts = SIGNAL_UNITS[unit]
        if not volts:
            return factor
        if not self.excitation > 0.0:
            raise RecordError(f"{name} is in {unit}: the supply of the bridge is needed too, such as excitation = 5.0")
        return factor * 4.0 / (self.gauge_factor * self.active_arms * self.excitation * self.amplification)


@dataclass(frozen=True, kw_only=True)
class Record:
    """Strains over even time.

    start, step : time of the first sample and between samples [s].
    strain : (n, k) array; one column per signal, tension positive.
    held : (n, k) array of bool; samples that nobody knows: in gaps too long to be filled with any right, or clipped.
    noise : (k,) array; standard deviation of a sample at rest; 0 where there is no baseline to tell it from.
    memory : (k,) array; samples over which the noise is correlated, at least 1.
    offset : (k,) array; standard deviation of the baseline that was taken off.
    spread : (n, k) array; half the difference of the gauges of a bar, the bending they show; 0 with one gauge.
    alone : (k,) array of bool; whether a signal rests on one gauge because another of its bar was left out.
    bars : tuple of tuples of int; the gauges that make a signal, before they are joined; one each after that.
    changes : tuple of Change
    """

    start: float
    step: float
    strain: Array
    held: Flags
    noise: Array
    memory: Array
    offset: Array
    spread: Array
    alone: Flags
    bars: tuple[tuple[int, ...], ...]
    names: tuple[str, ...]
    changes: tuple[Change, ...] = ()

    @property
    def time(self) -> Array:
        """Instants of the samples, (n,) [s]."""
        return np.asarray(self.start + self.step * np.arange(len(self.strain)), dtype=float)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was changed, in words."""
        return tuple(change.text for change in self.changes)

    def refuse_held(self, signal: int, first: int, last: int, where: str) -> None:
        """Raise RecordError where samples from `first` to `last` of a signal are not known, with what hides them."""
        lost = np.flatnonzero(self.held[max(first, 0) : last + 1, signal])
        if len(lost) == 0:
            return
        clipped = [one.text for one in self.changes if one.step == "clipped" and one.signal in self.names[signal]]
        why = f"; {clipped[0]}" if clipped else ", more than can be filled"
        raise RecordError(
            f"samples are missing {where}, {len(lost)} from {self.time[max(first, 0) + lost[0]] * 1e6:.8g} us on{why}"
        )


# --- columns, units, clocks, gaps ----------------------------------------------------------------------


def _places(table: Table, text: str) -> list[int]:
    """Columns that a name, a number, or several with + between them stand for."""
    several = "+" in text and text not in table.names
    return [place_of(table, part.strip()) for part in text.split("+")] if several else [place_of(table, text)]


def _pick(table: Table, signals: int, columns: Sequence[str]) -> tuple[int, list[list[int]]]:
    """Places of the time and of the gauges of every signal among the columns."""
    count = len(table.names)
    if columns:
        if len(columns) != signals + 1:
            raise RecordError(f"{len(columns)} columns are named, {signals + 1} are due: time and {signals} of strain")
        places = [_places(table, text) for text in columns]
        if len(places[0]) != 1:
            raise RecordError("the time is one column")
        return places[0][0], places[1:]
    if signals > 1 and count == 2 * signals + 1:
        return 0, [[2 * k + 1, 2 * k + 2] for k in range(signals)]
    if count != signals + 1:
        what = "too few" if count < signals + 1 else "too many"
        raise RecordError(
            f"found {count} columns ({', '.join(table.names)}), {what}: time and {signals} of strain or volts are due; "
            "name those that count with columns, several gauges of a bar as A+B"
        )
    return 0, [[at] for at in range(1, count)]


def make_record(table: Table, signals: int = 1, *, wiring: Wiring | Sequence[Wiring] | None = None,
                columns: Sequence[str] = ()) -> Record:  # fmt: skip
    """Strains of a table over even time, one column for every gauge, as they were recorded.

    signals : signals that are due beside the time, of one gauge or more each.
    wiring : one for all signals or one for each.
    columns : names or numbers of the time's and the signals' columns, gauges of one bar as ``A+B``; all in their order
    if empty, two gauges a bar where there are twice as many.

    Raises RecordError for a wrong number of columns, an unknown unit, time that runs backwards, numbers that no bar can
    have, fewer than 20 samples.
    """
    wirings = [wiring or Wiring()] * signals if wiring is None or isinstance(wiring, Wiring) else list(wiring)
    clock, groups = _pick(table, signals, columns)
    notes = list(table.notes)
    there, time = _clock(table, clock, wirings[0].time_unit, notes)
    raw: list[Array] = []
    names: list[str] = []
    bars: list[tuple[int, ...]] = []
    alone: list[bool] = []
    for group, own in zip(groups, wirings, strict=True):
        faults, used = [], []
        for at in group:
            values = table.values[there, at] * own.factor(table.units[at], table.names[at])
            fault = _nonsense(values, table.names[at])
            if fault:
                faults.append(fault)
                continue
            used.append(len(raw))
            raw.append(values)
            names.append(table.names[at])
        if not used:
            raise RecordError(faults[0])
        notes += [f"{fault}: the other gauges of the bar stand alone" for fault in faults]
        alone += [bool(faults)] * len(used)
        bars.append(tuple(used))
    start, step, strain, held = _even(time, np.stack(raw, axis=1), notes)
    if len(strain) > _LARGE:
        block = -(-len(strain) // _LEFT)
        whole = len(strain) // block * block
        notes.append(f"{len(strain):,} samples are thinned to {whole // block:,}, the means of {block} each")
        strain = strain[:whole].reshape(-1, block, strain.shape[1]).mean(axis=1)
        held = np.asarray(held[:whole].reshape(-1, block, held.shape[1]).any(axis=1))
        start, step = start + 0.5 * (block - 1) * step, step * block
    none = np.zeros(len(raw))
    return Record(start=start, step=step, strain=strain, held=held, noise=none, memory=none + 1.0, offset=none,
                  spread=np.zeros_like(strain), alone=np.array(alone), bars=tuple(bars), names=tuple(names),
                  changes=tuple(Change(step="read", text=note) for note in notes))  # fmt: skip


def _clock(table: Table, clock: int, given: str, notes: list[str]) -> tuple[Flags, Array]:
    """Rows that have a time, and those times [s], growing."""
    unit = given or table.units[clock] or "s"
    if unit not in UNITS["time"]:
        raise RecordError(f"the unit {unit!r} of the time is not known; allowed: {', '.join(UNITS['time'])}")
    time = table.values[:, clock] * UNITS["time"][unit]
    there = np.isfinite(time)
    if not there.all():
        notes.append(f"{int((~there).sum())} rows without a time are left out")
    time = time[there]
    if len(time) < _FEWEST:
        raise RecordError(f"found {len(time)} samples, a record has {_FEWEST} at least")
    time = _ascending(time, notes)
    if time[-1] - time[0] > _LONGEST:
        raise RecordError(
            f"the record lasts {time[-1] - time[0]:.4g} s, more than any test: is its time in another unit? "
            'Say so, as in time_unit = "us"'
        )
    return there, time


def _ascending(time: Array, notes: list[str]) -> Array:
    """Times that grow; a time written with too few digits is built anew."""
    steps = np.diff(time)
    if (steps < 0.0).any():
        at = int(np.argmax(steps < 0.0)) + 2
        raise RecordError(
            f"time runs backwards at sample {at}: {time[at - 2]:.9g} s, then {time[at - 1]:.9g} s; "
            "are there several records in the file?"
        )
    if not (steps == 0.0).any():
        return time
    even = np.linspace(time[0], time[-1], len(time))
    digit = float(steps.max())
    if digit == 0.0 or np.abs(even - time).max() > 1.01 * digit:
        raise RecordError(f"the same time stands twice, first at sample {int(np.argmax(steps == 0.0)) + 2}")
    # the last time is rounded like the others: the mean step comes from a fit
    slope = np.polyfit(np.arange(len(time), dtype=float), time - time[0], 1)[0]
    notes.append("the time has too few digits to tell its samples apart: even steps are assumed")
    return np.asarray(time[0] + slope * np.arange(len(time)))


def _nonsense(column: Array, name: str) -> str:
    """Why a column can be no signal of a bar, empty if it can."""
    good = column[np.isfinite(column)]
    if len(good) < max(_FEWEST, len(column) // 2):
        return f"{name}: {len(column) - len(good)} of {len(column)} samples are no numbers"
    away = np.abs(good - np.median(good))
    if away.max() == 0.0:
        return f"{name}: every sample is the same: there is no wave in it"
    size = float(np.quantile(away, 0.98))  # spikes are fewer
    if size > _MOST_STRAIN:
        return (
            f"{name}: reaches {size:.3g}, which is no strain of an elastic bar: is it in microstrain or volts? "
            'Say so, as in unit = "microstrain"'
        )
    return ""


def _runs(same: Flags) -> tuple[Places, Places]:
    """First places and lengths of the runs of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8)))
    return edges[::2], edges[1::2] - edges[::2]


def _even(time: Array, raw: Array, notes: list[str]) -> tuple[float, float, Array, Flags]:
    """Even steps and no missing numbers; `held` marks what lies in long gaps."""
    steps = np.diff(time)
    step = float(np.median(steps))
    uneven = bool(np.abs(steps - step).max() > 0.01 * step)
    if not uneven:
        step = float((time[-1] - time[0]) / (len(time) - 1))
    missing = np.isnan(raw)
    if not uneven and not missing.any():
        return float(time[0]), step, raw, np.zeros(raw.shape, dtype=bool)
    count = round((time[-1] - time[0]) / step) + 1
    if count > 4 * len(time) + 1000:
        raise RecordError("the steps of time differ too much: most of the record is missing")
    grid = time[0] + step * np.arange(count)
    strain, held = np.empty((count, raw.shape[1])), np.zeros((count, raw.shape[1]), dtype=bool)
    filled = 0
    for k in range(raw.shape[1]):
        good = ~missing[:, k]
        own = time[good]
        strain[:, k] = np.interp(grid, own, raw[good, k])
        after = np.clip(np.searchsorted(own, grid), 1, len(own) - 1)
        wide = own[after] - own[after - 1]
        inside = (grid > own[after - 1] + 1e-6 * step) & (grid < own[after] - 1e-6 * step)
        inside |= (grid < own[0]) | (grid > own[-1])
        filled += int((inside & (wide > 1.5 * step)).sum())
        held[:, k] = inside & (wide > (_SHORT_GAP + 1.5) * step)
    jitter = uneven and bool(np.abs(steps[steps < 1.5 * step] - step).max(initial=0.0) > 0.01 * step)
    if jitter:
        notes.append(
            f"the steps of time are uneven: brought to even ones of {step * 1e6:.6g} us by lines between samples"
        )
    if filled:
        notes.append(f"{filled} missing samples are filled by lines between their neighbours")
    if held.any():
        notes.append(f"{int(held.sum())} samples lie in gaps of more than {_SHORT_GAP}: no wave may stand there")
    return float(time[0]), step, strain, held


# --- the first wave of a signal ------------------------------------------------------------------------


def smooth(values: Array, samples: int) -> Array:
    """Running means of a number of samples."""
    if samples < 2:
        return values
    return np.convolve(values, np.full(samples, 1.0 / samples), mode="same")


@dataclass(frozen=True, kw_only=True)
class Wave:
    """The first wave of a signal, by its shape: samples of its foot, first and last half of the top, and end.

    `rising` samples lie between a tenth and half the way up; `peak` is the largest size of the smoothed signal, `sign`
    that of the wave; `ended` whether the signal comes back to its rest.
    """

    foot: int
    half: int
    falling: int
    end: int
    rising: int
    peak: float
    sign: float
    ended: bool


def first_wave(values: Array, step: float, noise: float) -> Wave:
    """Where the first wave of a signal about zero stands, told back and forth from its body, not from its first noise.

    Raises RecordError where no wave rises above the noise.
    """
    width = max(1, round(2.0 * _SHORTEST / step))
    # bursts of a trigger swing within a few microseconds; running medians have nothing of them
    calm = smooth(median_filter(values, 2 * min(3 * round(_SHORTEST / step), _SPIKE_MOST) + 1, mode="nearest"), width)
    peak = float(np.abs(calm).max())
    if not peak > 5.0 * noise / math.sqrt(width) or peak == 0.0:
        raise RecordError("no wave rises above the noise of the record")
    high = np.abs(calm) > 0.5 * peak
    begins, lengths = _runs(high)
    if lengths.max() < 3:
        raise RecordError("no wave of three samples or more rises above the noise of the record")
    first = int(np.argmax(lengths >= max(3.0, _LASTS * lengths.max())))
    half, falling = int(begins[first]), int(begins[first] + lengths[first]) - 1
    sign = math.copysign(1.0, calm[half])
    top = float((sign * calm[half : falling + 1]).max())
    low = np.flatnonzero(sign * calm[:half] < 0.1 * top)
    rising = half - (int(low[-1]) if len(low) else 0)
    # means over a part of the rise see its foot and the end of the fall through the noise
    width = max(width, rising // 5 + 1)
    calm = sign * smooth(values, width)
    level = max(_FOOT_SHARE * top, _FOOT_NOISE * noise / math.sqrt(width))
    before = np.flatnonzero(calm[:half] < level)
    behind = np.flatnonzero(calm[falling:] < max(2.0 * _FOOT_SHARE * top, level))
    end = falling + int(behind[0]) if len(behind) else len(values) - 1
    return Wave(foot=int(before[-1]) + 1 if len(before) else 0, half=half, falling=falling, end=end, rising=rising,
                peak=top, sign=sign, ended=len(behind) > 0)  # fmt: skip


# --- mending -------------------------------------------------------------------------------------------


def mend(record: Record, polarity: str = "auto") -> Record:
    """The chain: spikes, clipped stretches, baseline and drift, sign, the gauges of a bar; one signal a bar is left.

    polarity : ``auto`` takes the first wave of every gauge as compression, ``tension`` a record that is positive in
    tension, ``compression`` one that is positive in compression.

    Raises RecordError where a bar has no signal with a wave and a rest to tell it from.
    """
    if polarity not in ("auto", "tension", "compression"):
        raise RecordError(f"polarity {polarity!r} is not known; allowed: auto, tension, compression")
    return _joined(_marked(_despiked(record)), polarity)


def _despiked(record: Record) -> Record:
    """Without samples that stand alone: against running medians, beyond what the residuals around them scatter.

    What is shorter than any wave of a bar and jumps up and down within two samples is a spike; lines between its
    neighbours take its place.
    """
    most = min(max(_SPIKE, math.ceil(_SHORTEST / record.step)), _SPIKE_MOST)
    width = 4 * most + 1
    strain, changes = record.strain.copy(), []
    if len(strain) < 2 * width:
        return record
    for k, name in enumerate(record.names):
        values = strain[:, k]
        for _ in range(3):  # what a large spike hides shows behind it
            middle = median_filter(values, width, mode="nearest")
            left = values - middle
            scatter = _ROBUST * np.maximum(
                median_filter(np.abs(left), 5 * width, mode="nearest"), np.median(np.abs(left))
            )
            peak = float(np.abs(middle - np.median(middle[: max(_FEWEST, len(middle) // 50)])).max())
            bounds = np.maximum(_ODD * scatter, _TOLD * peak)
            odd = _spikes(values, left, bounds, most, peak)
            if not odd:
                break
            for first, last in odd:
                inner = np.arange(first, last + 1)
                size = float(left[inner[np.argmax(np.abs(left[inner]))]])
                values[inner] = np.interp(inner, [first - 1, last + 1], values[[first - 1, last + 1]])
                at = record.start + first * record.step
                count = f"{len(inner)} sample{'s' * (len(inner) > 1)}"
                changes.append(Change(
                    step="spike", signal=name, sample=first, time=at, size=size,
                    text=f"{name}: a spike of {size * 1e6:.4g} microstrain at {at * 1e6:.8g} us, {count}, is taken out",
                ))  # fmt: skip
    return replace(record, strain=strain, changes=(*record.changes, *changes))


def _spikes(values: Array, left: Array, bounds: Array, most: int, peak: float) -> list[tuple[int, int]]:
    """First and last samples of runs beyond the bounds that are short, and jump up and down; twice as long with their
    ringing where they rise above the peak of the record, which no wave does in two samples."""
    away = np.abs(left)
    # a large spike moves the medians around it by what the wave climbs there
    near = away > np.maximum(0.5 * bounds, _RINGS * maximum_filter(away, 4 * most + 1, mode="nearest"))
    spikes = []
    for begin, length in zip(*_runs(binary_closing(near, np.ones(_RINGING, dtype=bool))), strict=True):
        first, last = int(begin), int(begin + length) - 1
        inner = left[first : last + 1]
        size = float(inner[np.argmax(np.abs(inner))])
        short = length <= (2 * most if abs(size) > peak else most) and first >= 1 and last <= len(left) - 2
        if short and (np.abs(inner) > bounds[first : last + 1]).any():
            jumps = np.diff(values[first - 1 : last + 2]) / size
            if min(jumps.max(), -jumps.min()) > _JUMP:
                spikes.append((first, last))
    return spikes


def _marked(record: Record) -> Record:
    """Clipped stretches held: a recorder at the end of its range writes one number again and again, where elsewhere it
    writes noise."""
    held, changes = record.held.copy(), []
    for k, name in enumerate(record.names):
        values = record.strain[:, k]
        head = values[: max(len(values) // 20, _FEWEST)]
        if np.ptp(head) == 0.0:  # without noise a flat top may be one
            continue
        quiet = int(_runs(np.diff(head) == 0.0)[1].max(initial=0))
        for extreme in (values.max(), values.min()):
            same = np.abs(values - extreme) <= 1e-9 * abs(extreme)
            begins, lengths = _runs(same)
            if lengths.max() >= _FLAT and lengths.max() > 2 * (quiet + 1):
                held[same, k] = True
                first = int(begins[np.argmax(lengths)])
                at = record.start + first * record.step
                changes.append(Change(
                    step="clipped", signal=name, sample=first, time=at, size=float(extreme),
                    text=f"{name} is clipped at {extreme:.6g}: {int(same.sum())} samples from {at * 1e6:.6g} us on are "
                    "the same; its peak is not in the record: record again with a wider range",
                ))  # fmt: skip
    return replace(record, held=held, changes=(*record.changes, *changes))


@dataclass(frozen=True, kw_only=True)
class _Rested:
    """A signal about its own rest, with noise, memory and standard deviation of the baseline found there."""

    values: Array
    noise: float
    memory: float
    offset: float
    wave: Wave


def _rested(values: Array, step: float, name: str, time: Array, changes: list[Change]) -> _Rested:
    """A signal without its baseline and drift, told from the samples before its first wave.

    Raises RecordError where the signal has no wave or is nowhere at rest.
    """
    told: list[Change] = []
    middle = float(np.median(values[: max(2 * _BASELINE, len(values) // 50)]))
    scatter = _ROBUST * float(np.median(np.abs(np.diff(values)))) / math.sqrt(2.0)
    try:
        wave = first_wave(values - middle, step, scatter)
        # a drift hides the foot: a line through what lies well before the rise comes off first
        early = max(wave.half - 3 * wave.rising, 0) // 3
        if early >= _BASELINE:
            low, high = np.median(values[:early]), np.median(values[early : 2 * early])
            level = low + (high - low) / early * (np.arange(len(values)) - 0.5 * early)
            flat = first_wave(values - level, step, scatter)
            # medians of noise differ too, and a line through them climbs to anything by the end of a record
            if flat.half <= wave.end or abs(high - low) > _CLIMBS * scatter / math.sqrt(early):
                wave = flat
    except RecordError as error:
        raise RecordError(f"{name}: {error}") from None
    count = wave.foot - max(3, wave.rising // 5)
    quiet = values[: max(count, 0)]
    place = np.arange(len(quiet), dtype=float)
    third = max(len(quiet) // 3, 1)
    climbs = abs(float(np.median(quiet[:third]) - np.median(quiet[-third:]))) / (2 * third) if count > 0 else 0.0
    # a drift climbs far slower than the wave
    if count < _BASELINE or climbs * wave.rising > 0.05 * wave.peak:
        quiet, place = _rest_behind(values, name, wave.peak)
        told.append(Change(step="baseline", signal=name,
                           text=f"{name}: no baseline before the wave, taken from the end of the record"))  # fmt: skip
    else:
        away = np.abs(quiet - np.median(quiet))
        burst = away > max(_ODD * _ROBUST * float(np.median(away)), _TOLD * wave.peak)
        if 0 < burst.sum() < len(quiet) // 3:
            worst = int(np.argmax(away))
            told.append(Change(
                step="trigger noise", signal=name, sample=worst, time=float(time[worst]), size=float(away[worst]),
                text=f"{name}: {int(burst.sum())} samples before the wave, of up to {away[worst] * 1e6:.4g} "
                f"microstrain at {time[worst] * 1e6:.8g} us, are noise of the trigger and no rest",
            ))  # fmt: skip
            quiet, place = quiet[~burst], place[~burst]
    offset, centre = float(quiet.mean()), float(place.mean())
    noise, memory, slope, slope_sd = _scatter(quiet, place)
    unsure = noise * math.sqrt(min(1.0, memory / len(quiet)))
    line, reach = np.full(len(values), offset), wave.end - centre
    if abs(offset) > 0.005 * wave.peak:
        told.append(Change(step="baseline", signal=name, size=offset,
                           text=f"{name}: a baseline of {offset * 1e6:.4g} microstrain is taken off"))  # fmt: skip
    if abs(slope) > 5.0 * slope_sd and abs(slope * reach) > 0.01 * wave.peak:
        line += slope * (np.arange(len(values)) - centre)
        unsure = math.hypot(unsure, slope_sd * reach)
        told.append(Change(step="drift", signal=name, size=slope * reach,
                           text=f"{name}: a drift of {slope * reach * 1e6:.3g} microstrain up to the end of the wave "
                           "is taken off"))  # fmt: skip
    changes += told
    return _Rested(values=values - line, noise=noise, memory=memory, offset=unsure, wave=wave)


def _rest_behind(values: Array, name: str, peak: float) -> tuple[Array, Array]:
    """The end of a record, if it is at rest, and its places."""
    last = values[-max(2 * _BASELINE, len(values) // 20) :]
    begins = float(np.median(values[:5]))
    if np.ptp(last) > 0.1 * peak:
        raise RecordError(f"{name}: the signal is at rest neither before the wave nor at the end: there is no baseline")
    if abs(begins - last.mean()) > 0.1 * np.abs(values - last.mean()).max():
        raise RecordError(f"{name}: the record begins inside the wave: its beginning is missing")
    return last, np.arange(len(values) - len(last), len(values), dtype=float)


def _scatter(quiet: Array, place: Array) -> tuple[float, float, float, float]:
    """Standard deviation about a line, samples over which it is correlated, slope per sample and its scatter."""
    about = place - place.mean()
    slope = float((about * (quiet - quiet.mean())).sum() / np.square(about).sum())
    left = quiet - quiet.mean() - slope * about
    sd = float(left.std(ddof=2))
    if sd <= 1e-12 * float(np.abs(quiet).max()):  # rounding is no noise
        return 0.0, 1.0, slope, 1e-6 * abs(slope)
    memory = 1.0
    for lag in range(1, min(len(left) // 4, 200)):
        alike = float((left[lag:] * left[:-lag]).mean() / sd**2)
        if alike < 2.0 / np.sqrt(len(left)):
            break
        memory += 2.0 * alike
    return sd, memory, slope, sd * math.sqrt(memory / float(np.square(about).sum()))


def _joined(record: Record, polarity: str) -> Record:
    """Every gauge about its rest and with its sign; those of a bar averaged, with the bending they show."""
    changes = list(record.changes)
    signs: list[str] = []
    alone = [bool(record.alone[list(bar)].any()) for bar in record.bars]
    names: list[str] = []
    columns, helds, spreads, rests = [], [], [], []
    # half of what most gauges show at the most
    largest = 0.5 * float(np.median(np.abs(record.strain - np.median(record.strain, axis=0)).max(axis=0)))
    for bar in record.bars:
        alive = _alive(record, bar, polarity, changes, signs, largest)
        alone[len(names)] |= len(alive) < len(bar)
        known = np.stack([~record.held[:, k] for k, _ in alive], axis=1)
        gauges = np.stack([one.values for _, one in alive], axis=1)
        mean = _bridged(gauges, known).mean(axis=1)
        name = " and ".join(record.names[k] for k, _ in alive)
        rest = alive[0][1]
        spread = np.zeros(len(mean))
        if len(alive) > 1:
            rest = _rested(mean, record.step, name, record.time, [])
            both = np.asarray(known.all(axis=1))
            spread = 0.5 * np.ptp(gauges, axis=1) * both
            if not both[rest.wave.falling :].any():
                # lost for good: what they differed by goes on, by nobody knows how much
                alone[len(names)] = True
                spread[~both] = spread.max()
            part = slice(rest.wave.foot, rest.wave.end + 1)
            bent = float(spread[part].max()) / rest.wave.peak
            changes.append(Change(step="gauges", signal=name, size=bent * rest.wave.peak,
                                  text=f"{name} are averaged; they show a bending of up to {bent:.1%} of the "
                                  "wave"))  # fmt: skip
        columns.append(rest.values)
        helds.append(~known.any(axis=1))
        spreads.append(spread)
        names.append(name)
        rests.append(rest)
    if signs:
        changes.append(Change(step="sign", signal=", ".join(signs), text=f"{', '.join(signs)}: the first wave was "
                              "positive; a wave that presses is negative here, the sign is turned"))  # fmt: skip
    return replace(
        record, strain=np.stack(columns, axis=1), held=np.stack(helds, axis=1), spread=np.stack(spreads, axis=1),
        alone=np.array(alone),
        names=tuple(names), bars=tuple((k,) for k in range(len(names))), changes=tuple(changes),
        noise=np.array([one.noise for one in rests]), memory=np.array([one.memory for one in rests]),
        offset=np.array([one.offset for one in rests]),
    )  # fmt: skip


def _bridged(gauges: Array, known: Flags) -> Array:
    """Gauges of a bar (n, g) where one is not known: the others, and the bending between the ends of the stretch."""
    bridged, place = gauges.copy(), np.arange(len(gauges))
    for k in range(gauges.shape[1]):
        others = np.delete(np.arange(gauges.shape[1]), k)
        lost = ~known[:, k]
        if len(others) == 0 or not lost.any() or lost.all():
            continue
        count = known[:, others].sum(axis=1)
        rest = (gauges[:, others] * known[:, others]).sum(axis=1) / np.maximum(count, 1)
        lost &= count > 0
        both = known[:, k] & (count > 0)
        bent = np.interp(place, place[both], (gauges[:, k] - rest)[both])
        bridged[lost, k] = (rest + bent)[lost]
    return bridged


def _alive(record: Record, bar: tuple[int, ...], polarity: str, changes: list[Change],
           signs: list[str], least: float) -> list[tuple[int, _Rested]]:  # fmt: skip
    """Gauges of a bar that show its wave, about their rest and with their sign."""
    found: list[tuple[int, _Rested]] = []
    faults = []
    for k in bar:
        try:
            rest = _rested(record.strain[:, k], record.step, record.names[k], record.time, changes)
        except RecordError as error:
            faults.append(str(error))
            continue
        turned = polarity == "compression" or (polarity == "auto" and rest.wave.sign > 0.0)
        found.append((k, replace(rest, values=-rest.values) if turned else rest))
        if turned and polarity == "auto":
            signs.append(record.names[k])
    if not found:
        raise RecordError(faults[0])
    found = _sound(record, found, faults, least)
    # the end of its range is not what a gauge shows
    peaks = [min(rest.wave.peak, float(np.abs(rest.values[~record.held[:, k]]).max(initial=0.0))) for k, rest in found]
    for (k, _), peak in zip(found, peaks, strict=True):
        if peak < _DEAD * max(peaks):
            faults.append(f"{record.names[k]}: shows {peak / max(peaks):.1%} of what its partner shows")
    for fault in faults:
        changes.append(Change(step="dead gauge", signal=fault.partition(":")[0],
                              text=f"{fault}: left out, the other gauges of the bar stand alone"))  # fmt: skip
    return [one for one, peak in zip(found, peaks, strict=True) if peak >= _DEAD * max(peaks)]


def _sound(record: Record, found: list[tuple[int, _Rested]], faults: list[str],
           least: float) -> list[tuple[int, _Rested]]:  # fmt: skip
    """Two gauges of a bar without one that came off: they differ by more than the other ever shows, and than `least`,
    which no bending of a bar does."""
    if len(found) != 2:
        return found
    (one, first), (two, other) = found
    both = ~record.held[:, one] & ~record.held[:, two]
    both[: min(first.wave.foot, other.wave.foot)] = False
    sizes = [float(np.abs(rest.values[both]).max(initial=0.0)) for rest in (first, other)]
    apart = float(np.abs(first.values - other.values)[both].max(initial=0.0))
    clipped = [int(record.held[:, k].sum()) for k in (one, two)]
    # a weak one is left to the next step
    if apart <= max(min(sizes), least) or (not any(clipped) and min(sizes) < _DEAD * max(sizes)):
        return found
    # a gauge at the end of its range is the one that came off; else the one that shows more
    lost = int(clipped[1] > clipped[0]) if clipped[0] != clipped[1] else int(sizes[1] > sizes[0])
    at = record.start + record.step * int(np.argmax(both & (np.abs(first.values - other.values) > min(sizes))))
    faults.append(f"{record.names[found[lost][0]]}: came off, at {at * 1e6:.6g} us it differs from its partner by "
                  f"{apart * 1e6:.4g} microstrain, more than that ever shows")  # fmt: skip
    return [found[1 - lost]]
