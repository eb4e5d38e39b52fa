"""From the columns of a file to strains over even time, mended in named steps.

read · spikes · clipped · baseline · drift · sign · gauges.  Every step adds a `Change` for what it
changed, with its size; what cannot be changed without inventing a record is marked as unknown, or
refused.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from scipy.ndimage import binary_closing, maximum_filter, median_filter

from uqsphere.arrays import Array, Flags, Places
from uqsphere.errors import UsageError
from uqsphere.labs.shpb.document import BarTable, RecordDocument
from uqsphere.labs.shpb.recorded import read_recorded
from uqsphere.tables import Table, unit_in_heading
from uqsphere.units import UNITS

#: bytes of a record, at the most
_LARGEST: Final = 1 << 28
_RATE: Final = re.compile(
    r"sampl\w*[ _]*(?:rate|frequency)\W*(?P<rate>[\d.]+(?:e[+-]?\d+)?)\s*(?P<prefix>[kM]?)", re.I
)
_INTERVAL: Final = re.compile(
    r"sampl\w*[ _]*(?:interval|time|period)\W*(?P<step>[\d.]+(?:e[+-]?\d+)?)\W*(?P<unit>[a-zµ]*)",
    re.I,
)
#: missing samples in a row that a line fills; samples of a record and of a baseline, at the least
_SHORT_GAP, _FEWEST, _BASELINE = 10, 20, 10
#: more strain is no strain of an elastic bar; a longer record [s] is no test
_MOST_STRAIN, _LONGEST = 0.05, 10.0
#: no wave of a bar is shorter [s]
_SHORTEST: Final = 1e-6
#: robust standard deviations, and share of the peak, beyond which a sample is a spike
_ODD, _ROBUST, _SPIKE_SHARE = 8.0, 1.4826, 0.02
#: part of the longest excursion that a first wave lasts: bursts of a trigger do not
_LASTS: Final = 0.25
#: passes of the incident bar that no pulse lasts
_PASSES: Final = 12.0
#: a gauge that shows less of what its partner shows is dead
_DEAD: Final = 0.2


@dataclass(frozen=True, kw_only=True)
class Change:
    """What a step of mending changed; `size` in strain (time shift: s)."""

    step: str
    signal: str
    text: str
    size: float | None = None


class Changes(list[Change]):
    """The steps of mending in their order."""

    def add(self, step: str, signal: str, text: str, size: float | None = None) -> None:
        """One more; a text without the name of the signal gets it in front."""
        self.append(
            Change(
                step=step, signal=signal, text=f"{signal}: {text}" if signal else text, size=size
            )
        )


@dataclass(frozen=True, kw_only=True)
class Wave:
    """The first wave of a signal: samples of its foot, of the first and last half of its top, of
    its end.

    rising : samples from a tenth to half the way up; peak : of the smoothed signal, > 0; ended :
        comes back to rest.
    """

    foot: int
    half: int
    falling: int
    end: int
    rising: int
    peak: float
    sign: float
    ended: bool


@dataclass(frozen=True, kw_only=True)
class Signal:
    """One wave or bar: strain (n,), compression negative, about its rest.

    known : (n,) whether a sample is known; noise : standard deviation of a sample at rest,
    correlated over `memory` samples; offset : standard deviation of the baseline; spread : (n,)
    half the difference of the gauges of a bar, 0 of one; single : whether a bar rests on one gauge,
    whose bending is not seen.
    """

    name: str
    strain: Array
    known: Flags
    noise: float
    memory: float
    offset: float
    spread: Array
    single: bool
    wave: Wave


@dataclass(kw_only=True)
class Record:
    """Mended signals over even time: `start`, `step` [s]; `reflected` is None where the incident
    gauge shows both.
    """

    start: float
    step: float
    incident: Signal
    reflected: Signal | None
    receiving: Signal
    changes: Changes


def load_record(document: RecordDocument, folder: Path) -> Record:
    """The record of an input file, read and mended.

    Raises UsageError for columns, units or a clock that cannot be, and for a signal without a wave
        or a rest.
    """
    changes, asked = Changes(), document.record
    read = [read_recorded(folder / name, _LARGEST) for name in (asked.file, *asked.more_files)]
    for text in (text for table, _ in read for text in table.notes):
        changes.add("read", "", text)
    time, groups = _columns(document, [table for table, _ in read], read[0][1], changes)
    start, step, columns = _even(time, groups, changes)
    for name, (values, known) in columns.items():
        _despike(name, values, step, changes)
        _mark_clipped(name, values, known, changes)
    names = {role: [name for name, _ in signals] for role, signals in groups.items()}
    first, rough, lasts = _incident_foot(
        {name: columns[name][0] for name in names["incident"]}, step
    )
    bar, behind = document.incident_bar, document.receiving_bar
    passes = 0.0 if bar.length is None else lasts * step * bar.wave_speed / bar.length
    if passes > _PASSES:
        raise UsageError(
            f"the pulse lasts {passes:.0f} passes of the incident bar: another unit "
            "(record.time_unit)?"
        )
    # the first wave of a signal stands before the first echo of a far end
    limits = dict.fromkeys(names, math.inf)
    if not asked.aligned:
        way = bar.gauge / bar.wave_speed + behind.gauge / behind.wave_speed + behind.echo
        limits["receiving"] = rough + way / step
        limits["incident"] = rough + 2.0 * (bar.length or math.inf) / bar.wave_speed / step
    given = {"auto": 0.0, "tension": 1.0, "compression": -1.0}[asked.polarity]
    joined: dict[str, Signal] = {}
    pressing = 0.0  # sign of the incident wave in the file
    for role, own in names.items():
        gauges = [
            _cut_out(name, *columns[name], step, changes)
            if asked.aligned
            else _rested(
                name,
                *columns[name],
                step,
                first if role == "receiving" else None,
                limits[role],
                changes,
            )
            for name in own
        ]
        # one sign a bar: a reflected wave has that of the incident gauge of its place
        signs = [
            given or -(pressing if role == "reflected" else gauge.wave.sign) for gauge in gauges
        ]
        pressing = -signs[0] if role == "incident" else pressing
        turned = [
            gauge.name
            for gauge, sign in zip(gauges, signs, strict=True)
            if sign < 0.0 and not given
        ]
        if turned:
            changes.add(
                "sign", ", ".join(turned), "compression is positive in the file; the sign is turned"
            )
        joined[role] = _joined(
            [
                replace(
                    gauge,
                    strain=gauge.strain * sign,
                    wave=replace(gauge.wave, sign=gauge.wave.sign * sign),
                )
                for gauge, sign in zip(gauges, signs, strict=True)
            ],
            step,
            limits[role],
            changes,
        )
    if asked.window is not None:
        signal = joined["incident"]
        begin, end = (round((t - start) / step) for t in asked.window)
        if not 0 <= begin < end < len(signal.strain):
            raise UsageError("record.window lies outside the record, or is empty")
        inside = np.zeros(len(signal.strain))
        inside[begin : end + 1] = signal.strain[begin : end + 1]
        wave = replace(first_wave(inside, step, signal.noise, signal.name), foot=begin, end=end)
        joined["incident"] = replace(signal, wave=wave)
    return Record(
        start=start, step=step, changes=changes, reflected=joined.pop("reflected", None), **joined
    )


# --- columns, units, clock ------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Column:
    """A column of a file as numbers (n,), NaN where a cell is none."""

    table: Table
    heading: str
    values: Array

    @property
    def name(self) -> str:
        """The heading without its unit."""
        dimension = self.unit()[0]
        return unit_in_heading(self.heading, dimension)[0] if dimension else self.heading

    @property
    def faulty(self) -> bool:
        """Whether some cells are no numbers."""
        return any(key == self.heading for key, _ in self.table.faults)

    @property
    def rises(self) -> bool:
        """Whether it goes on like a time."""
        steps = np.diff(self.values[np.isfinite(self.values)])
        return bool(
            not self.faulty and len(steps) and (steps >= 0.0).mean() > 0.99 and steps.max() > 0.0
        )

    def unit(self, given: str = "") -> tuple[str, str]:
        """Dimension and unit: as given, else of the heading; empty without one that is known."""
        text = f"x [{given}]" if given else self.heading
        for dimension in ("time", "strain", "voltage", *UNITS):
            if unit := unit_in_heading(text, dimension)[1]:
                return dimension, unit
        return "", given

    def checked(self) -> Array:
        """The numbers; TableError with the lines of cells that are none."""
        if self.faulty:
            kept = {
                fault: lines
                for fault, lines in self.table.faults.items()
                if fault[0] == self.heading
            }
            replace(self.table, faults=kept).check()
        return self.values


def _columns(
    document: RecordDocument, tables: Sequence[Table], above: str, changes: Changes
) -> tuple[Array, dict[str, list[tuple[str, Array]]]]:
    """Time (n,) [s] and strains of every gauge by role; `above`: metadata of the first file."""
    asked, main = document.record, tables[0]
    files = [
        [Column(table=t, heading=h, values=t.numbers(h, key=h, blank=True)) for h in t.headings]
        for t in tables
    ]
    guessed, own = asked.time is None, files[0]
    interval = asked.sample_interval or (
        _interval(above) if not own[0].rises and len(tables) == 1 else 0.0
    )
    if guessed and interval > 0.0:
        clock, time = -1, np.asarray(interval * np.arange(len(main)), dtype=float)
        changes.add("read", "", f"no column of time: a sample every {interval * 1e6:.6g} us")
    else:
        clock = main.place(1 if asked.time is None else asked.time)
        dimension, unit = own[clock].unit(asked.time_unit)
        several = len(own) < 3 or len(tables) > 1
        if guessed and (dimension in ("strain", "voltage") or (several and not own[clock].rises)):
            raise UsageError(_no_time(own, clock))
        changes.add(
            "read", own[clock].name, f"is in {unit}" if unit else "has no unit: seconds are taken"
        )
        if unit and dimension != "time":
            raise UsageError(
                f"the time is in {unit!r}: allowed are {', '.join(UNITS['time'])} "
                "(record.time_unit)"
            )
        time = own[clock].checked() * UNITS["time"][unit or "s"]
        _check_clock(time, own, clock, guessed)
    # every file in the layout of the first: the clock of the others must be the same
    count = len(time)
    for other in files[1:]:
        if len(other) <= clock:
            raise UsageError(
                f"{other[0].table.name}: has no column {clock + 1}, where the first file has its "
                "time"
            )
        unit = other[clock].unit(asked.time_unit)[1]
        there = other[clock].checked() * UNITS["time"].get(unit or "s", math.nan)
        both, step = min(count, len(there)), float(np.median(np.abs(np.diff(time))))
        if not np.nanmax(np.abs(there[:both] - time[:both]), initial=0.0) <= 0.5 * step:
            raise UsageError(
                f"{other[0].table.name}: its clock is not that of {main.name}; bring them to one "
                "first"
            )
        if len(there) != len(time):
            changes.add("read", other[0].table.name, "files of unlike length: the longer is cut")
        count = both
    pool = [column for file in files for k, column in enumerate(file) if k != clock]
    roles = {"incident": asked.incident, "reflected": asked.reflected, "receiving": asked.receiving}
    if not (asked.incident or asked.receiving):
        # all that are left, in their order
        free = [column for column in pool if not column.faulty]
        each = {2: 1, 4: 2}.get(len(free))
        if each is None or asked.reflected:
            names = ", ".join(repr(column.name) for column in pool)
            ask = "name them by record.incident, record.receiving (and record.reflected)"
            raise UsageError(f"{main.name}: {len(pool)} signals ({names}); {ask}")
        picked = {"incident": free[:each], "receiving": free[each:]}
    else:
        picked = {
            role: [_pick(files, name) for name in names] for role, names in roles.items() if names
        }
        if not {"incident", "receiving"} <= set(picked):
            raise UsageError("record.incident and record.receiving are both required")
    groups: dict[str, list[tuple[str, Array]]] = {}
    for role, columns in picked.items():
        bar = document.receiving_bar if role == "receiving" else document.incident_bar
        titles = [
            one.name if len(tables) == 1 else f"{Path(one.table.name).stem} {one.name}"
            for one in columns
        ]
        groups[role] = [
            (name, _strain(one, name, bar, changes)[:count])
            for name, one in zip(titles, columns, strict=True)
        ]
    return time[:count], groups


def _pick(files: Sequence[Sequence[Column]], name: str | int) -> Column:
    """A column by its name in the first file; `FILE:COLUMN` names it in one of several."""
    stem, _, rest = str(name).rpartition(":")
    for file in files:
        if stem and stem in (file[0].table.name, Path(file[0].table.name).stem):
            return file[file[0].table.place(rest)]
    return files[0][files[0][0].table.place(name)]


def _strain(column: Column, name: str, bar: BarTable, changes: Changes) -> Array:
    """A column as strain."""
    dimension, unit = column.unit(bar.unit)
    if dimension == "strain" or not unit:
        factor = UNITS["strain"][unit or "1"]
        said = {1.0: "strain", 1e-6: "microstrain"}.get(factor, unit)
        text = f"is in {said}" if unit else "has no unit: strain is taken"
    elif dimension == "voltage":
        if bar.excitation is None:
            raise UsageError(
                f"{name} is in {unit}: the bridge is required too, such as excitation = 5.0 (volts)"
            )
        factor = UNITS["voltage"][unit] * bar.strain_per_volt
        text = f"is in {unit}: {bar.strain_per_volt * 1e6:.5g} microstrain a volt"
    else:
        raise UsageError(
            f"{name} is in {unit!r}: allowed are strain, microstrain, %, "
            f"{', '.join(UNITS['voltage'])}"
        )
    values = column.checked() * factor
    good = values[np.isfinite(values)]
    if len(good) < max(_FEWEST, len(values) // 2):
        raise UsageError(
            f"{name}: {len(values) - len(good)} of {len(values)} samples are no numbers"
        )
    away = np.abs(good - np.median(good))
    if away.max() == 0.0:
        raise UsageError(f"{name}: every sample is the same; there is no wave in it")
    if (size := float(np.quantile(away, 0.98))) > _MOST_STRAIN:
        raise UsageError(
            f"{name}: a strain of {size:.3g}, which no elastic bar bears; another unit (BAR.unit)?"
        )
    changes.add("read", name, text)
    return values


def _interval(text: str) -> float:
    """Time between samples [s] that metadata give, 0 if they do not."""
    if match := _RATE.search(text):
        rate = float(match["rate"]) * {"": 1.0, "k": 1e3, "M": 1e6}[match["prefix"]]
        return 1.0 / rate if rate > 0.0 else 0.0
    if match := _INTERVAL.search(text):
        return float(match["step"]) * UNITS["time"].get(match["unit"] or "s", 1.0)
    return 0.0


def _no_time(columns: Sequence[Column], clock: int) -> str:
    rising = [column.name for column in columns if column.rises]
    hint = (
        f'{rising[0]!r} rises like one: record.time = "{rising[0]}"'
        if rising
        else ('no column does, the file seems to have no time: record.sample_interval = "0.8 us"')
    )
    return f"{columns[0].table.name}: {columns[clock].name!r} does not rise like a time; {hint}"


def _check_clock(time: Array, columns: Sequence[Column], clock: int, guessed: bool) -> None:
    name, good = columns[0].table.name, time[np.isfinite(time)]
    falls = np.diff(good) < 0.0
    if len(good) < _FEWEST:
        raise UsageError(
            f"{name}: {len(good)} samples with a time; a record has {_FEWEST} at least"
        )
    if guessed and falls.mean() > 0.01:
        raise UsageError(_no_time(columns, clock))
    if falls.any():
        raise UsageError(
            f"{name}: the time falls at sample {int(np.argmax(falls)) + 2}; several records?"
        )
    if good[-1] - good[0] > _LONGEST:
        raise UsageError(
            f"{name}: lasts {good[-1] - good[0]:.4g} s: is its time in another unit "
            "(record.time_unit)?"
        )


def _even(
    time: Array, groups: dict[str, list[tuple[str, Array]]], changes: Changes
) -> tuple[float, float, dict[str, tuple[Array, Flags]]]:
    """Start and step [s], and strain and known samples of every gauge by its name, on even
    steps.
    """
    names = [name for signals in groups.values() for name, _ in signals]
    raw = np.stack([values for signals in groups.values() for _, values in signals])
    there = np.isfinite(time)
    if not there.all():
        changes.add("read", "", f"{int((~there).sum())} rows without a time are left out")
        time, raw = time[there], raw[:, there]
    steps = np.diff(time)
    if (steps == 0.0).any():
        even, digit = np.linspace(time[0], time[-1], len(time)), float(steps.max())
        if digit == 0.0 or np.abs(even - time).max() > 1.01 * digit:
            raise UsageError(
                f"the same time stands twice, first at sample {int(np.argmax(steps == 0.0)) + 2}"
            )
        # the last time is rounded like the others: the mean step comes from a line
        slope = float(np.polyfit(np.arange(len(time), dtype=float), time - time[0], 1)[0])
        time = time[0] + slope * np.arange(len(time))
        changes.add(
            "read",
            "",
            "the time has too few digits to tell its samples apart: even steps are assumed",
        )
        steps = np.diff(time)
    step = float(np.median(steps))
    grid = time
    if np.abs(steps - step).max() > 0.01 * step:
        count = round((time[-1] - time[0]) / step) + 1
        if count > 4 * len(time) + 1000:
            raise UsageError("the steps of time differ too much: most of the record is missing")
        grid = time[0] + step * np.arange(count)
        changes.add(
            "read",
            "",
            f"uneven steps of time: brought to {step * 1e6:.6g} us by lines between samples",
        )
    else:
        step = float((time[-1] - time[0]) / (len(time) - 1))
    found, filled, lost = dict[str, tuple[Array, Flags]](), 0, 0
    for name, values in zip(names, raw, strict=True):
        good = np.isfinite(values)
        own = time[good]
        after = np.clip(np.searchsorted(own, grid), 1, len(own) - 1)
        wide = own[after] - own[after - 1]
        inside = np.minimum(np.abs(grid - own[after - 1]), np.abs(own[after] - grid)) > 1e-6 * step
        filled += int((inside & (wide > 1.5 * step)).sum())
        outside = inside & ((grid < own[0]) | (grid > own[-1]))
        unknown = outside | (inside & (wide > (_SHORT_GAP + 1.5) * step))
        lost += int(unknown.sum())
        found[name] = np.interp(grid, own, values[good]), ~unknown
    if filled:
        changes.add(
            "read", "", f"{filled} missing samples are filled by lines between their neighbours"
        )
    if lost:
        changes.add("read", "", f"{lost} samples lie in gaps of more than {_SHORT_GAP}: not used")
    return float(grid[0]), step, found


# --- spikes, clipping -----------------------------------------------------------------------------


def _runs(same: Flags) -> tuple[Places, Places]:
    """First places and lengths of the runs of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8)))
    return edges[::2], edges[1::2] - edges[::2]


def _despike(name: str, values: Array, step: float, changes: Changes) -> None:
    """Samples that jump up and down within less than any wave of a bar lasts, replaced by lines (in
    place).
    """
    most = min(max(5, math.ceil(_SHORTEST / step)), 40)
    width = 4 * most + 1
    if len(values) < 2 * width:
        return
    removed: list[tuple[int, int, float]] = []
    for _ in range(3):  # what a large spike hides shows behind it
        middle = median_filter(values, width, mode="nearest")
        left = values - middle
        away = np.abs(left)
        scatter = _ROBUST * np.maximum(
            median_filter(away, 5 * width, mode="nearest"), np.median(away)
        )
        peak = float(np.abs(middle - np.median(middle[: max(_FEWEST, len(middle) // 50)])).max())
        bounds = np.maximum(_ODD * scatter, _SPIKE_SHARE * peak)
        near = away > np.maximum(0.5 * bounds, 0.05 * maximum_filter(away, width, mode="nearest"))
        odd = []
        for begin, length in zip(*_runs(binary_closing(near, np.ones(3, dtype=bool))), strict=True):
            first, last = int(begin), int(begin + length) - 1
            inner = left[first : last + 1]
            size = float(inner[np.argmax(np.abs(inner))])
            # ringing of a spike above any wave lasts longer
            short = (
                length <= (2 * most if abs(size) > peak else most)
                and first >= 1
                and last <= len(left) - 2
            )
            if short and (np.abs(inner) > bounds[first : last + 1]).any():
                jumps = np.diff(values[first - 1 : last + 2]) / size
                if min(jumps.max(), -jumps.min()) > 0.4:
                    odd.append((first, last, size))
        for first, last, _ in odd:
            inner_places = np.arange(first, last + 1)
            values[inner_places] = np.interp(
                inner_places, [first - 1, last + 1], values[[first - 1, last + 1]]
            )
        removed += odd
        if not odd:
            break
    if removed:
        samples = sum(last - first + 1 for first, last, _ in removed)
        worst = max(removed, key=lambda one: abs(one[2]))
        text = (
            f"{len(removed)} spike{'s' * (len(removed) > 1)} ({samples} samples) taken out, the "
            "largest of "
        )
        text += f"{worst[2] * 1e6:.4g} microstrain at sample {worst[0]}"
        changes.add("spikes", name, text, worst[2])


def _mark_clipped(name: str, values: Array, known: Flags, changes: Changes) -> None:
    """Stretches at the end of the recorder's range, where it writes one number again and again
    (marked in place).
    """
    head = values[: max(len(values) // 20, _FEWEST)]
    if np.ptp(head) == 0.0:  # without noise a flat top may be one
        return
    quiet = int(_runs(np.diff(head) == 0.0)[1].max(initial=0))
    for extreme in (values.max(), values.min()):
        same = np.abs(values - extreme) <= 1e-9 * abs(extreme)
        lengths = _runs(same)[1]
        if lengths.max() >= 8 and lengths.max() > 2 * (quiet + 1):
            known[same] = False
            text = (
                f"clipped at {extreme * 1e6:.5g} microstrain, {int(same.sum())} samples; its "
                "peak is not known"
            )
            changes.add("clipped", name, text, float(extreme))


# --- the first wave, and the rest before it -------------------------------------------------------


def smooth(values: Array, samples: int) -> Array:
    """Running means."""
    if samples < 2:
        return values
    return np.convolve(values, np.full(samples, 1.0 / samples), mode="same")


def _stay(values: Array, step: float, share: float, name: str) -> tuple[Array, int, int, int]:
    """The calm course of a signal about zero; first and last sample, and rise, of its first stay
    above a share of its largest.  Bursts of a trigger swing within a few microseconds: running
    medians have nothing of them."""
    calm = smooth(
        median_filter(values, 2 * min(3 * round(_SHORTEST / step), 40) + 1, mode="nearest"),
        max(1, round(2.0 * _SHORTEST / step)),
    )
    size = np.abs(calm)
    begins, lengths = _runs(size > share * float(size.max()))
    if lengths.max(initial=0) < 3:
        raise UsageError(f"{name}: no wave rises above the noise before it")
    k = int(np.argmax(lengths >= max(3.0, _LASTS * lengths.max())))
    first, last = int(begins[k]), int(begins[k] + lengths[k]) - 1
    sign = math.copysign(1.0, calm[first])
    low = np.flatnonzero(
        sign * calm[:first] < 0.2 * share * float((sign * calm[first : last + 1]).max())
    )
    return calm, first, last, first - (int(low[-1]) if len(low) else 0)


def first_wave(values: Array, step: float, noise: float, name: str) -> Wave:
    """The first wave of a signal about zero; UsageError where none rises above the noise at
    rest.
    """
    calm, half, falling, rising = _stay(values, step, 0.5, name)
    width = max(1, round(2.0 * _SHORTEST / step))
    if not float(np.abs(calm).max()) > 5.0 * noise / math.sqrt(width):
        raise UsageError(f"{name}: no wave rises above the noise before it")
    sign = math.copysign(1.0, calm[half])
    top = float((sign * calm[half : falling + 1]).max())
    width = max(width, rising // 5 + 1)
    calm = sign * smooth(values, width)
    level = max(0.01 * top, 4.0 * noise / math.sqrt(width))
    before = np.flatnonzero(calm[:half] < level)
    behind = np.flatnonzero(calm[falling:] < max(0.02 * top, level))
    end = falling + int(behind[0]) if len(behind) else len(values) - 1
    return Wave(
        foot=int(before[-1]) + 1 if len(before) else 0,
        half=half,
        falling=falling,
        end=end,
        rising=rising,
        peak=top,
        sign=sign,
        ended=len(behind) > 0,
    )


def _incident_foot(gauges: dict[str, Array], step: float) -> tuple[int, int, int]:
    """The earliest foot of the incident gauges, before which every gauge of the rig is at rest, and
    about when the wave is there and how long: the first stay above a fifth of the largest, however
    large echoes grow later."""
    stays = [
        _stay(
            values - float(np.median(values[: max(2 * _BASELINE, len(values) // 50)])),
            step,
            0.2,
            name,
        )[1:]
        for name, values in gauges.items()
    ]
    foot = min(first - 2 * rising for first, _, rising in stays)
    return (
        max(foot, 0),
        min(stay[0] for stay in stays),
        min(last - first + 1 for first, last, _ in stays),
    )


def _line(quiet: Array, place: Array) -> tuple[float, float, float, float, float]:
    """Mean, slope a sample, standard deviation about the line, its memory in samples, sd of the
    slope.
    """
    about = place - place.mean()
    slope = float((about * (quiet - quiet.mean())).sum() / np.square(about).sum())
    left = quiet - quiet.mean() - slope * about
    sd = float(left.std(ddof=2))
    if sd <= 1e-12 * float(np.abs(quiet).max(initial=0.0)):  # rounding is no noise
        return float(quiet.mean()), slope, 0.0, 1.0, 1e-6 * abs(slope)
    memory = 1.0
    for lag in range(1, min(len(left) // 4, 200)):
        alike = float((left[lag:] * left[:-lag]).mean() / sd**2)
        if alike < 2.0 / math.sqrt(len(left)):
            break
        memory += 2.0 * alike
    return (
        float(quiet.mean()),
        slope,
        sd,
        memory,
        sd * math.sqrt(memory / float(np.square(about).sum())),
    )


def _rested(
    name: str,
    values: Array,
    known: Flags,
    step: float,
    rest_end: int | None,
    limit: float,
    changes: Changes,
) -> Signal:
    """A gauge about its rest: baseline and drift from the samples before its first wave.

    rest_end : sample before which it is at rest whatever it shows itself, where another gauge
        settles that.
    limit : sample before which its first wave stands.
    """
    seen = slice(int(min(limit, len(values))))
    head = values[: max(2 * _BASELINE, len(values) // 50)]
    middle = float(np.median(head))
    wave = first_wave((values - middle)[seen], step, 0.0, name)
    early = max(wave.half - 3 * wave.rising, rest_end or 0, 0)
    if early >= 3 * _BASELINE:
        # the scatter of the rest before the wave alone, about a line through it
        place = np.arange(early, dtype=float)
        third = early // 3
        climb = (float(np.median(values[2 * third : early])) - float(np.median(values[:third]))) / (
            2.0 * third
        )
        left = values[:early] - climb * place
        scatter = _ROBUST * float(np.median(np.abs(left - np.median(left))))
        drifts = abs(climb) * 2.0 * third > 7.0 * scatter / math.sqrt(third)
        level = float(np.median(left)) + (climb * np.arange(len(values)) if drifts else 0.0)
        wave = first_wave((values - level)[seen], step, scatter, name)
    count = max(wave.foot - max(3, wave.rising // 5), 0)
    if rest_end is not None and rest_end >= _BASELINE:
        count = max(min(count, len(values)), min(rest_end, wave.half))
    quiet, place = values[:count], np.arange(count, dtype=float)
    if count < _BASELINE:
        last = values[-max(2 * _BASELINE, len(values) // 20) :]
        if np.ptp(last) > 0.1 * wave.peak:
            raise UsageError(
                f"{name}: at rest neither before nor behind its wave: was it cut out "
                "(record.aligned)?"
            )
        if abs(float(np.median(values[:5])) - float(last.mean())) > 0.1 * wave.peak:
            raise UsageError(f"{name}: the record begins inside the wave; its beginning is missing")
        quiet, place = last, np.arange(len(values) - len(last), len(values), dtype=float)
        changes.add("baseline", name, "taken from the end of the record")
        wave = first_wave(values - float(last.mean()), step, 0.0, name)
    away = np.abs(quiet - np.median(quiet))
    burst = away > max(_ODD * _ROBUST * float(np.median(away)), 0.02 * wave.peak)
    if 0 < burst.sum() < len(quiet) // 3:
        size = float(away.max())
        text = (
            f"{int(burst.sum())} samples of trigger noise, up to {size * 1e6:.4g} microstrain, "
            "are no rest"
        )
        changes.add("baseline", name, text, size)
        quiet, place = quiet[~burst], place[~burst]
    mean, slope, noise, memory, slope_sd = _line(quiet, place)
    unsure = noise * math.sqrt(min(1.0, memory / len(quiet)))
    line, reach = np.full(len(values), mean), wave.end - float(place.mean())
    if abs(mean) > 0.005 * wave.peak:
        text = (
            f"a baseline of {mean * 1e6:.4g} microstrain is taken off "
            f"({abs(mean) / wave.peak:.1%} of the wave)"
        )
        changes.add("baseline", name, text, mean)
    if abs(slope) > 5.0 * slope_sd and abs(slope * reach) > 0.01 * wave.peak:
        line += slope * (np.arange(len(values)) - float(place.mean()))
        unsure = math.hypot(unsure, slope_sd * reach)
        size = slope * reach
        text = (
            f"a drift of {slope / step * 1e3:.4g} microstrain/ms is taken off, {size * 1e6:.3g} "
            "microstrain in all"
        )
        changes.add("drift", name, text, size)
    return Signal(
        name=name,
        strain=values - line,
        known=known,
        noise=noise,
        memory=memory,
        offset=unsure,
        spread=np.zeros(len(values)),
        single=False,
        wave=wave,
    )


def _cut_out(name: str, values: Array, known: Flags, step: float, changes: Changes) -> Signal:
    """A wave that was cut out at its foot: it has no rest of its own, its first samples are its
    zero.
    """
    start = float(np.median(values[:3]))
    values = values - start
    noise = _ROBUST * float(np.median(np.abs(np.diff(values)))) / math.sqrt(2.0)
    wave = first_wave(values, step, noise, name)
    changes.add(
        "baseline",
        name,
        f"cut out at its foot: its first {start * 1e6:.4g} microstrain are its zero",
        start,
    )
    return Signal(
        name=name,
        strain=values,
        known=known,
        noise=noise,
        memory=1.0,
        offset=0.01 * wave.peak,
        spread=np.zeros(len(values)),
        single=False,
        wave=wave,
    )


def _joined(gauges: Sequence[Signal], step: float, limit: float, changes: Changes) -> Signal:
    """The gauges of a bar as one signal: dead ones left out, the others averaged, with the bending
    that they show.
    """
    peaks = [
        float(np.abs(g.strain[g.known]).max(initial=0.0)) if not g.known.all() else g.wave.peak
        for g in gauges
    ]
    alive = [g for g, peak in zip(gauges, peaks, strict=True) if peak >= _DEAD * max(peaks)]
    for gauge, peak in zip(gauges, peaks, strict=True):
        if peak < _DEAD * max(peaks):
            changes.add(
                "gauges",
                gauge.name,
                f"shows {peak / max(peaks):.1%} of what its partner shows, left out",
            )
    if len(alive) == 1:
        return replace(alive[0], single=len(gauges) > 1)
    first = min(g.wave.foot for g in alive)
    known = np.stack([g.known for g in alive], axis=1)
    strains = np.stack([g.strain for g in alive], axis=1)
    both = np.asarray(known.all(axis=1))
    # where one is not known the others stand for the mean, and the difference stays what it was at
    # the most
    mean = (strains * known).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    spread = 0.5 * np.ptp(strains, axis=1)
    spread[~both] = max(float(spread[first:][both[first:]].max(initial=0.0)), 0.0)
    count = max(first - 3, _BASELINE)
    _, _, noise, memory, _ = _line(mean[:count], np.arange(count, dtype=float))
    name = " and ".join(g.name for g in alive)
    wave = first_wave(mean[: int(min(limit, len(mean)))], step, noise, name)
    bent = float(spread[wave.foot : wave.end + 1].max())
    changes.add(
        "gauges",
        name,
        f"averaged; they differ by up to {2.0 * bent / wave.peak:.1%} of the wave",
        bent,
    )
    offset = math.hypot(*(g.offset for g in alive)) / len(alive)
    return Signal(
        name=name,
        strain=mean,
        known=np.asarray(known.any(axis=1)),
        noise=noise,
        memory=memory,
        offset=offset,
        spread=spread,
        single=len(alive) < len(gauges),
        wave=wave,
    )
