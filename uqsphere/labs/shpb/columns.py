"""From the columns of a recorder's files to strains over even time: names, units, clock."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.errors import UsageError
from uqsphere.labs.shpb.document import BarTable, RecordDocument, RecordTable
from uqsphere.labs.shpb.recorded import read_recorded
from uqsphere.labs.shpb.signals import Changes
from uqsphere.tables import Table, factor_in_heading, unit_in_heading
from uqsphere.units import UNITS

#: most bytes of a file
_LARGEST: Final = 1 << 28
_RATE: Final = re.compile(
    r"sampl\w*[ _]*(?:rate|frequency)\W*(?P<rate>[\d.]+(?:e[+-]?\d+)?)\s*(?P<prefix>[kM]?)", re.I
)
_INTERVAL: Final = re.compile(
    r"sampl\w*[ _]*(?:interval|time|period)\W*(?P<step>[\d.]+(?:e[+-]?\d+)?)\W*(?P<unit>[a-zµ]*)",
    re.I,
)
#: missing samples in a row that a line fills; fewest samples of a record
_SHORT_GAP, _FEWEST = 10, 20
#: largest strain of an elastic bar; longest record of a test [s]
_MOST_STRAIN, _LONGEST = 0.05, 10.0
#: largest deviation of even steps from their median; samples that may repeat the time before them
_UNEVEN, _FEW_TWICE = 0.01, 3
#: names of the factors of strain
_STRAINS: Final = {1.0: "strain", 1e-6: "microstrain"}


@dataclass(frozen=True, kw_only=True)
class Trace:
    """A gauge over even time: strain (n,), and whether a sample is known (n,)."""

    name: str
    strain: Array
    known: Flags


class Traces(NamedTuple):
    """The gauges of a record by role, over even time: `start` and `step` [s]."""

    start: float
    step: float
    by_role: Mapping[str, tuple[Trace, ...]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Column:
    """A column of a file as numbers (n,), NaN for a cell that is not a number."""

    table: Table
    heading: str
    values: Array

    @property
    def name(self) -> str:
        """The heading without its unit."""
        dimension = self.unit()[0]
        return unit_in_heading(self.heading, dimension)[0] if dimension else self.heading

    @property
    def faults(self) -> dict[tuple[str, str], list[int]]:
        """Lines of cells that are not numbers, by what is wrong with them."""
        faults = self.table.faults.items()
        return {fault: lines for fault, lines in faults if fault[0] == self.heading}

    @property
    def rises(self) -> bool:
        """Whether it rises like a time."""
        steps = np.diff(self.values[np.isfinite(self.values)])
        if self.faults or not len(steps):
            return False
        return bool((steps >= 0.0).mean() > 0.99 and steps.max() > 0.0)

    def unit(self, key: str = "") -> tuple[str, str]:
        """Dimension and unit of a key or of the heading; the dimension is empty if not known."""
        text = f"x [{key}]" if key else self.heading
        for dimension in ("time", "strain", "voltage", *UNITS):
            if unit := unit_in_heading(text, dimension)[1]:
                return dimension, unit
        if factor := factor_in_heading(text):
            raise UsageError(
                f"the heading {text!r} has the factor {factor!r}. Multiply the values by it and "
                "write only the unit"
            )
        return "", key

    def checked(self) -> Array:
        """The numbers; TableError with the lines of cells that are not numbers."""
        if self.faults:
            replace(self.table, faults=self.faults).check()
        return self.values

    def in_seconds(self, unit: str) -> Array:
        """The numbers as a time [s] in a unit that is given, that of the heading, or seconds."""
        return self.checked() * UNITS["time"].get(self.unit(unit)[1] or "s", math.nan)


def read_traces(document: RecordDocument, folder: Path, changes: Changes) -> Traces:
    """The gauges of an input file as strains over even time.

    Raises UsageError for columns, units or a clock that cannot be those of a record.
    """
    asked = document.record
    names = (asked.file, *asked.more_files)
    tables, texts = zip(*(read_recorded(folder / name, _LARGEST) for name in names), strict=True)
    for note in chain(*(table.notes for table in tables)):
        changes.add("read", "", note)
    files = [_columns_of(table) for table in tables]
    time, place = _clock(asked, files, texts[0], changes)
    time = _common(asked.time_unit, files, (time, place), changes)
    strains: dict[str, list[tuple[str, Array]]] = {}
    for role, columns in _by_role(asked, files, (time, place)).items():
        bar, strains[role] = document.incident_bar, []
        if role == "receiving":
            bar = document.receiving_bar
        for column in columns:
            name = column.name
            if len(files) > 1:
                name = f"{Path(column.table.name).stem} {name}"
            strains[role].append((name, _strain(column, name, bar, changes)[: len(time)]))
    return _even(time, strains, changes)


def _columns_of(table: Table) -> list[Column]:
    return [
        Column(table=table, heading=h, values=table.numbers(h, key=h, blank=True))
        for h in table.headings
    ]


# --- time -----------------------------------------------------------------------------------------


def _clock(
    asked: RecordTable, files: Sequence[Sequence[Column]], above: str, changes: Changes
) -> tuple[Array, int]:
    """The time (n,) [s] of the first file, whose metadata are `above`, and the place of its column;
    -1 without one."""
    first = files[0]
    table, guessed, interval = first[0].table, asked.time is None, asked.sample_interval or 0.0
    if not interval and not first[0].rises and len(files) == 1:
        interval = _interval(above)
    if guessed and interval > 0.0:
        changes.add("read", "", f"no time column: a sample every {interval * 1e6:.6g} us")
        return np.asarray(interval * np.arange(len(table)), dtype=float), -1
    place = table.place(asked.time or 1)
    column = first[place]
    dimension, unit = column.unit(asked.time_unit)
    several = len(first) < 3 or len(files) > 1
    if guessed and (dimension in ("strain", "voltage") or (several and not column.rises)):
        raise UsageError(_no_time(first, place))
    if unit and dimension != "time":
        raise UsageError(
            f"the unit of time must be one of {', '.join(UNITS['time'])} (record.time_unit), not "
            f"{unit!r}"
        )
    text = f"is in {unit}" if unit else "has no unit: seconds are taken"
    changes.add("read", column.name, text)
    time = column.in_seconds(asked.time_unit)
    _check_clock(time, first, place, guessed)
    return time, place


def _interval(text: str) -> float:
    """Time between samples [s] from the metadata, 0 without it."""
    rated, timed = _RATE.search(text), _INTERVAL.search(text)
    if rated:
        rate = float(rated["rate"]) * {"": 1.0, "k": 1e3, "M": 1e6}[rated["prefix"]]
        return 1.0 / rate if rate > 0.0 else 0.0
    if timed:
        return float(timed["step"]) * UNITS["time"].get(timed["unit"] or "s", 1.0)
    return 0.0


def _no_time(columns: Sequence[Column], place: int) -> str:
    rising = [column.name for column in columns if column.rises]
    hint = 'no column does. Without a time column set record.sample_interval = "0.8 us"'
    if rising:
        hint = f'column {rising[0]!r} does: record.time = "{rising[0]}"'
    return (
        f"{columns[0].table.name}: column {columns[place].name!r} does not rise like a time; {hint}"
    )


def _check_clock(time: Array, columns: Sequence[Column], place: int, guessed: bool) -> None:
    """Refuse a time of too few samples, that falls, or that lasts too long."""
    name, good = columns[0].table.name, time[np.isfinite(time)]
    falls = np.diff(good) < 0.0
    if len(good) < _FEWEST:
        raise UsageError(
            f"{name}: {len(good)} samples with a time; a record has at least {_FEWEST}"
        )
    if guessed and falls.mean() > 0.01:
        raise UsageError(_no_time(columns, place))
    if falls.any():
        raise UsageError(
            f"{name}: time falls at sample {int(np.argmax(falls)) + 2}. Does the file contain "
            "several records?"
        )
    if good[-1] - good[0] > _LONGEST:
        raise UsageError(
            f"{name}: lasts {good[-1] - good[0]:.4g} s. Is the time in another unit "
            "(record.time_unit)?"
        )


def _common(
    unit: str, files: Sequence[Sequence[Column]], clock: tuple[Array, int], changes: Changes
) -> Array:
    """The time that all files have; UsageError for files that do not have the same clock."""
    time, place = clock
    step, count = float(np.median(np.abs(np.diff(time)))), len(time)
    for other in files[1:]:
        table = other[0].table
        if len(other) <= place:
            raise UsageError(
                f"{table.name}: has no column {place + 1}, the time column of the first file"
            )
        there = other[place].in_seconds(unit)
        both = min(count, len(there))
        if not np.nanmax(np.abs(there[:both] - time[:both]), initial=0.0) <= 0.5 * step:
            raise UsageError(
                f"{table.name}: its clock differs from that of {files[0][0].table.name}. Write "
                "both channels with one clock"
            )
        if len(there) != len(time):
            changes.add("read", table.name, "files of different length: the longer one is cut")
        count = both
    return time[:count]


# --- gauges ---------------------------------------------------------------------------------------


def _by_role(
    asked: RecordTable, files: Sequence[Sequence[Column]], clock: tuple[Array, int]
) -> dict[str, Sequence[Column]]:
    """The columns of the incident, the reflected and the receiving gauges.

    Two or four unnamed signals: first those of the incident bar.
    """
    roles = {role: getattr(asked, role) for role in ("incident", "reflected", "receiving")}
    if asked.incident and asked.receiving:
        pick = partial(_pick, files)
        return {role: [*map(pick, names)] for role, names in roles.items() if names}
    if asked.incident or asked.receiving:
        raise UsageError("record.incident and record.receiving are both required")
    signals = [
        column
        for file in files
        for place, column in enumerate(file)
        if place != clock[1] and not _repeats(column, clock[0], asked.time_unit)
    ]
    usable = [column for column in signals if not column.faults]
    if len(usable) not in (2, 4) or asked.reflected:
        names = ", ".join(repr(column.name) for column in signals)
        raise UsageError(
            f"{files[0][0].table.name}: {len(signals)} signals ({names}); name them by "
            "record.incident, record.receiving (and record.reflected)"
        )
    each = len(usable) // 2
    return {"incident": usable[:each], "receiving": usable[each:]}


def _repeats(column: Column, time: Array, unit: str) -> bool:
    """Whether a column repeats the time; UsageError for the time of another clock."""
    dimension = column.unit(unit)[0]
    if not column.rises or dimension not in ("time", "") or len(column.values) < len(time):
        return False
    other = column.in_seconds(unit)[: len(time)]
    if np.nanmax(np.abs(other - time)) <= 0.5 * float(np.median(np.abs(np.diff(time)))):
        return True
    if dimension == "time":
        raise UsageError(
            f"{column.table.name}: column {column.name!r} is a second clock that differs from the "
            "first. Write all channels with one clock"
        )
    return False


def _pick(files: Sequence[Sequence[Column]], name: str | int) -> Column:
    """A column by its name in the first file; `FILE:COLUMN` names one of another file."""
    stem, _, rest = str(name).rpartition(":")
    for file in files:
        table = file[0].table
        if stem and stem in (table.name, Path(table.name).stem):
            return file[table.place(rest)]
    return files[0][files[0][0].table.place(name)]


def _strain(column: Column, name: str, bar: BarTable, changes: Changes) -> Array:
    """A column as strain."""
    dimension, unit = column.unit(bar.unit)
    if dimension == "strain" or not unit:
        factor = UNITS["strain"][unit or "1"]
        text = "has no unit: strain is taken"
        if unit:
            text = f"is in {_STRAINS.get(factor, unit)}"
    elif dimension == "voltage":
        if bar.excitation is None:
            raise UsageError(
                f"{name} is in {unit}: the bridge is required too, for example excitation = 5.0 "
                "(a number, volts)"
            )
        factor = UNITS["voltage"][unit] * bar.strain_per_volt
        text = f"is in {unit}: {bar.strain_per_volt * 1e6:.5g} microstrain a volt"
    else:
        raise UsageError(
            f"{name}: its unit must be strain, microstrain, % or one of "
            f"{', '.join(UNITS['voltage'])}, not {unit!r}"
        )
    values = column.checked() * factor
    good = values[np.isfinite(values)]
    if len(good) < max(_FEWEST, len(values) // 2):
        raise UsageError(
            f"{name}: {len(values) - len(good)} of {len(values)} samples are not numbers"
        )
    away = np.abs(good - np.median(good))
    if away.max() == 0.0:
        raise UsageError(f"{name}: all samples are equal; it contains no wave")
    size = float(np.quantile(away, 0.98))
    if size > _MOST_STRAIN:
        raise UsageError(
            f"{name}: a strain of {size:.3g}, but no elastic bar bears more than {_MOST_STRAIN:g}. "
            "Is it in another unit (BAR.unit)?"
        )
    changes.add("read", name, text)
    return values


# --- even steps -----------------------------------------------------------------------------------


def _even(
    time: Array, strains: Mapping[str, Sequence[tuple[str, Array]]], changes: Changes
) -> Traces:
    """The strains on even steps of time."""
    raw = np.stack([values for gauges in strains.values() for _, values in gauges])
    there = np.isfinite(time)
    if not there.all():
        changes.add("read", "", f"{int((~there).sum())} rows without a time are ignored")
        time, raw = time[there], raw[:, there]
    time, raw = _distinct(time, raw, changes)
    steps = np.diff(time)
    step, grid = float(np.median(steps)), time
    if np.abs(steps - step).max() > _UNEVEN * step:
        count = round((time[-1] - time[0]) / step) + 1
        if count > 4 * len(time) + 1000:
            raise UsageError("the steps of time differ too much: most of the record is missing")
        grid = time[0] + step * np.arange(count)
        changes.add("read", "", f"uneven time steps: interpolated to {step * 1e6:.6g} us")
    else:
        step = float((time[-1] - time[0]) / (len(time) - 1))
    rows, by_role = iter(raw), dict[str, tuple[Trace, ...]]()
    filled = lost = 0
    for role, gauges in strains.items():
        traces = []
        for name, _ in gauges:
            strain, missing, unknown = _on_grid(time, next(rows), grid, step)
            filled += int(missing.sum())
            lost += int(unknown.sum())
            traces.append(Trace(name=name, strain=strain, known=~unknown))
        by_role[role] = tuple(traces)
    if filled:
        changes.add("read", "", f"{filled} missing samples are filled by interpolation")
    if lost:
        text = f"{lost} samples lie in gaps of more than {_SHORT_GAP} and are not used"
        changes.add("read", "", text)
    return Traces(float(grid[0]), step, by_role)


def _distinct(time: Array, raw: Array, changes: Changes) -> tuple[Array, Array]:
    """Time that rises at every sample: rows that are there twice go, coarse times are spread."""
    same = np.diff(time) == 0.0
    if not same.any():
        return time, raw
    equal = (raw[:, 1:] == raw[:, :-1]) | (np.isnan(raw[:, 1:]) & np.isnan(raw[:, :-1]))
    twice = same & equal.all(axis=0)
    kept = np.concatenate([[True], ~twice])
    if _is_even(time[kept], 0.5):
        changes.add("read", "", f"{int(twice.sum())} repeated rows are ignored")
        return time[kept], raw[:, kept]
    first = np.concatenate([[True], ~same])
    if same.sum() <= _FEW_TWICE and _is_even(time[first], _UNEVEN):
        places = np.flatnonzero(first)
        counts = np.diff(np.append(places, len(time)))
        changes.add(
            "read",
            "",
            f"{int(same.sum())} samples have the time of the sample before, first sample "
            f"{int(np.argmax(same)) + 2}: their mean is taken",
        )
        return time[first], np.add.reduceat(raw, places, axis=1) / counts
    # a coarse clock takes steps of one digit, again and again
    steps = np.diff(time)
    digit = float(steps.max())
    even = np.linspace(time[0], time[-1], len(time))
    again = int((steps > 0.99 * digit).sum()) > _FEW_TWICE
    if digit == 0.0 or not again or np.abs(even - time).max() > 1.01 * digit:
        raise UsageError(
            f"two samples have the same time, first at sample {int(np.argmax(same)) + 2}. Remove "
            "one of them, or leave out the time column and set record.sample_interval"
        )
    # the last time is rounded like the others: a line gives the mean step
    slope = float(np.polyfit(np.arange(len(time), dtype=float), time - time[0], 1)[0])
    changes.add(
        "read", "", "the time has too few digits to distinguish its samples: even steps are assumed"
    )
    return time[0] + slope * np.arange(len(time)), raw


def _is_even(time: Array, tolerance: float) -> bool:
    """Whether a time rises at every sample, by steps within a share of their median."""
    steps = np.diff(time)
    return bool((steps > 0.0).all() and np.abs(steps / np.median(steps) - 1.0).max() < tolerance)


def _on_grid(time: Array, values: Array, grid: Array, step: float) -> tuple[Array, Flags, Flags]:
    """A strain on even steps; which samples a line fills, and which are not known."""
    good = np.isfinite(values)
    seen = time[good]
    after = np.clip(np.searchsorted(seen, grid), 1, len(seen) - 1)
    wide = seen[after] - seen[after - 1]
    nearest = np.minimum(np.abs(grid - seen[after - 1]), np.abs(seen[after] - grid))
    between = nearest > 1e-6 * step
    outside = between & ((grid < seen[0]) | (grid > seen[-1]))
    unknown = outside | (between & (wide > (_SHORT_GAP + 1.5) * step))
    return np.interp(grid, seen, values[good]), between & (wide > 1.5 * step), unknown
