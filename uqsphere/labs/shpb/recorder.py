"""From the files of a recorder to strains over even time: tables as recorders write them, units,
clock."""

import math
import re
from dataclasses import replace
from pathlib import Path
from statistics import mode
from typing import NamedTuple

import numpy as np

from uqsphere import tables
from uqsphere.arrays import Array, Flags, Pair
from uqsphere.errors import UsageError
from uqsphere.labs.files import InputError
from uqsphere.tables import NOTHING, Table, TableError, cells_of, is_comment
from uqsphere.units import UNITS

from .document import BarTable, RecordDocument, RecordTable

#: lines of the second half of a file that show its form
_LOOKED_AT = 200
#: lines of metadata that are returned where the numbers begin at once
_METADATA = 40
#: most bytes of a file
_LARGEST = 1 << 28
#: no part of a date, a time of day or another number
_NUMBER = r"[^\w.]*((?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)(?!\.?\d|:|e)"
_RATE = re.compile(rf"sampl\w*[ _]*(?:rate|frequency){_NUMBER}\s*([kM](?=Hz|S)|)", re.IGNORECASE)
_INTERVAL = re.compile(
    rf"sampl\w*[ _]*(?:interval|time|period){_NUMBER}\W*([a-zµ]*)", re.IGNORECASE
)
#: of a rate
_PREFIXES = {"": 1.0, "k": 1e3, "m": 1e6}
#: missing samples in a row that a line fills; fewest samples of a record
_SHORT_GAP, _FEWEST = 10, 20
#: largest strain of an elastic bar; longest record of a test [s]
_MOST_STRAIN, _LONGEST = 0.05, 10.0
#: largest deviation of even steps from their median; samples that may repeat the time before them
_UNEVEN, _FEW_TWICE = 0.01, 3


# --- tables of recorders --------------------------------------------------------------------------


def read_recorded(path: Path, sheet: str = "") -> tuple[Table, str]:
    """The table of a recorder's file, and the text above its numbers.

    Columns may be divided by blanks too, with metadata above the numbers, with or without headings.
    The second half of the file shows the divider and which columns have numbers: metadata are above
    or beside the first half at most.

    Raises TableError for a file without a table of numbers, AccessError as
        `uqsphere.files.read_given`.
    """
    name = path.name
    lines, notes = tables.read_lines(path, _LARGEST, sheet)
    if not lines:
        raise TableError(f"{name!r} is empty")
    # without quotes around a whole line
    lines = {number: re.sub('^"([^"]*)"$', r"\1", line) for number, line in lines.items()}
    live = {number: line for number, line in lines.items() if not is_comment(line)}
    lower = dict([*live.items()][len(live) // 2 :][:_LOOKED_AT])
    forms = [_form_of(lower, divider) for divider in "\t;, "]
    *_, divider, width, places = max(forms, key=lambda form: form[:2])
    cells = cells_of(live, divider)
    first = 0
    for number, row in cells.items():
        chosen = [row[place] for place in places if place < len(row)]
        if len(chosen) == len(places) and any(chosen) and all(map(_is_number, chosen)):
            first = number
            break
    if not first:
        raise TableError(
            f"{name}: no table of numbers. Divide the columns by commas, semicolons, tabs or blanks"
        )
    body = {number: row for number, row in cells.items() if number >= first}
    if divider == "\t":
        body = {number: row + [""] * (width - len(row)) for number, row in body.items()}
    ragged = [
        k for k, row in body.items() if not width <= len(row) <= width + 1 or any(row[width:])
    ]
    if ragged:
        hint = ""
        if divider == ",":
            hint = ". With a decimal comma divide the columns by semicolons or tabs"
        raise TableError(
            f"{name}: {len(ragged)} lines do not have {width} columns; the first is line "
            f"{ragged[0]} with {len(body[ragged[0]])}{hint}"
        )
    numbers = "".join(row[place] for row in body.values() for place in places)
    mark = max(".,", key=numbers.count)
    above = [row for number, row in cells.items() if number < first]
    if not above:
        comments = {k: line.lstrip("# ") for k, line in lines.items() if k < first}
        above = [*cells_of(comments, divider).values()]
    above = [row[:width] for row in above if len(row) in (width, width + 1)]
    units = []
    if above and tables.are_units(above[-1]):
        units = [above.pop()]
    if not above:
        above = [[""] * width]
        notes.append(f"{name} has no headings")
    if mark == ",":
        notes.append(f"{name}: decimal comma")
    # an empty heading is named by its place, a repeated one gets its place
    names = [heading or f"column {place}" for place, heading in enumerate(above[-1], 1)]
    headings = [*names]
    for place, heading in enumerate(names):
        if names.count(heading) > 1:
            headings[place] = f"{place + 1} {heading}"
    used = [place for place in range(width) if place in places or above[-1][place]]
    whole = dict(enumerate([headings, *units], first - len(units) - 1)) | body
    used_cells = {number: [row[place] for place in used] for number, row in whole.items()}
    metadata = [line for number, line in lines.items() if number < max(first, _METADATA)]
    return tables.table_of(name, used_cells, notes, mark), "\n".join(metadata)


def _form_of(lines: dict[int, str], divider: str) -> tuple[int, float, str, int, list[int]]:
    """How well a divider fits: how many columns of numbers it gives, up to two, and which share of
    the columns has no texts in most rows; with it the cells of a row, and the places of the former.
    """
    rows = [row for row in cells_of(lines, divider).values() if any(map(tables.is_number, row))]
    width = mode([*map(len, rows)] or [1])
    places = []
    filled = 0
    for place, column in enumerate(zip(*(row for row in rows if len(row) == width), strict=True)):
        if 2 * sum(map(_is_number, column)) > len(column):
            filled += 1
            if any(map(tables.is_number, column)):
                places.append(place)
    return min(len(places), 2), filled / width, divider, width, places


def _is_number(cell: str) -> bool:
    """Whether a cell is a number, or says that there is none."""
    return tables.is_number(cell) or cell.lower() in NOTHING


# --- steps of mending -----------------------------------------------------------------------------


class Change(NamedTuple):
    """What a step of mending changed; `size` is a strain, or the time of a shift [s]."""

    step: str
    signal: str
    text: str
    size: float | None


class Changes(list[Change]):
    """The steps of mending in their order."""

    def add(
        self, text: str, step: str = "read", size: float | None = None, signal: str = ""
    ) -> None:
        """Add a step; its text begins with the name of the signal."""
        if signal:
            text = f"{signal}: {text}"
        self.append(Change(step, signal, text, size))


# --- columns --------------------------------------------------------------------------------------


class Trace(NamedTuple):
    """A gauge over even time: strain (n,), and whether a sample is known (n,).

    role : of its wave, incident, reflected or receiving; step : of time [s]; changes : where its
        mending is noted.
    """

    role: str
    name: str
    bar: BarTable
    changes: Changes
    step: float
    strain: Array
    known: Flags


class Column(NamedTuple):
    """A column of a file as numbers (n,), NaN for a cell that is not a number; the table has the
    faults of this column.

    time_unit : of a time, where the heading does not give it.
    """

    table: Table
    heading: str
    values: Array
    time_unit: str

    @property
    def name(self) -> str:
        """The heading without its unit."""
        return tables.unit_in_heading(self.heading, self.unit()[0] or "number")[0]

    @property
    def rises(self) -> bool:
        """Whether it rises like a time."""
        steps = np.diff(self.values[np.isfinite(self.values)])
        climbs = steps.max(initial=0.0) > 0.0 and (steps >= 0.0).mean() > 0.99
        return bool(climbs and not self.table.faults)

    def unit(self, key: str = "") -> tuple[str, str]:
        """Dimension and unit of a key or of the heading; the dimension is empty if not known."""
        text = f"x [{key}]" if key else self.heading
        for dimension in ("time", "strain", "voltage", *UNITS):
            unit = tables.unit_in_heading(text, dimension)[1]
            if unit:
                return dimension, unit
        factor = tables.factor_in_heading(text)
        if factor:
            raise UsageError(
                f"the heading {text!r} has the factor {factor!r}. Multiply the values by it and "
                "write only the unit"
            )
        return "", key

    def checked(self) -> Array:
        """The numbers; TableError with the lines of cells that are not numbers."""
        if self.table.faults:
            self.table.check()
        return self.values

    def in_seconds(self) -> Array:
        """The numbers as a time [s] in the unit that is given, that of the heading, or seconds."""
        unit = self.unit(self.time_unit)[1] or "s"
        return self.checked() * UNITS["time"].get(unit, math.nan)

    def is_clock(self, time: Array) -> bool:
        """Whether it begins as a time (n,) within half a step."""
        apart = np.abs(self.in_seconds()[: len(time)] - time)
        return bool(np.nanmax(apart, initial=0.0) <= 0.5 * _step(time))


class Recorded(NamedTuple):
    """A file of a recorder; `above`: the text above its numbers."""

    table: Table
    columns: list[Column]
    above: str


def read_traces(
    document: RecordDocument, folder: Path, changes: Changes
) -> tuple[float, list[Trace]]:
    """The beginning [s] of a record, and its gauges in the order of their roles.

    Raises UsageError for columns, units or a clock that cannot be those of a record.
    """
    asked = document.record
    files = []
    for file in (asked.file, *asked.more_files):
        table, above = read_recorded(folder / file, asked.sheet)
        for note in table.notes:
            changes.add(note)
        columns = []
        for heading in table.headings:
            table.faults = {}
            values = table.numbers(heading, blank=True)
            columns.append(Column(replace(table), heading, values, asked.time_unit))
        files.append(Recorded(table, columns, above))
    time, place = _clock(asked, files, changes)
    time = _common(time, place, files, changes)
    traces = []
    for role, gauges in _by_role(asked, files, place, time).items():
        home = "receiving_bar" if role == "receiving" else "incident_bar"
        bar = getattr(document, home)
        for column in gauges:
            name = column.name
            if len(files) > 1:
                name = f"{Path(column.table.name).stem} {name}"
            strain = _strain(column, name, bar, home, changes)[: len(time)]
            traces.append(Trace(role, name, bar, changes, math.nan, strain, np.isfinite(strain)))
    return _even(time, traces, changes)


# --- time -----------------------------------------------------------------------------------------


def _clock(asked: RecordTable, files: list[Recorded], changes: Changes) -> tuple[Array, int]:
    """The time (n,) [s] of the first file and the place of its column, -1 without one.

    Refused is a time of too few samples, that falls, or that lasts too long.
    """
    table, columns, above = files[0]
    guessed = asked.time is None
    interval = asked.sample_interval
    if not interval and not columns[0].rises and len(files) == 1:
        interval = _interval(above)
    if guessed and interval > 0.0:
        changes.add(f"no time column: a sample every {interval * 1e6:.6g} us")
        return interval * np.arange(len(table), dtype=float), -1
    place = 0
    if asked.time is not None:
        place = table.place(asked.time, key="time")
    column = columns[place]
    dimension, unit = column.unit(column.time_unit)

    def other_column() -> UsageError:
        hint = 'no column does. Without a time column set record.sample_interval = "0.8 us"'
        rising = [column.name for column in columns if column.rises]
        if rising:
            hint = f'column {rising[0]!r} does: record.time = "{rising[0]}"'
        message = f"{table.name}: column {column.name!r} does not rise like a time; {hint}"
        return TableError(message, "time")

    alone = len(columns) > 2 and len(files) == 1
    if guessed and (dimension in ("strain", "voltage") or not (alone or column.rises)):
        raise other_column()
    if unit and dimension != "time":
        raise TableError(
            f"the unit of time must be one of {', '.join(UNITS['time'])} (record.time_unit), not "
            f"{unit!r}",
            "time_unit",
        )
    text = "has no unit: seconds are taken"
    if unit:
        text = f"is in {unit}"
    changes.add(text, signal=column.name)
    time = column.in_seconds()
    good = time[np.isfinite(time)]
    if len(good) < _FEWEST:
        raise UsageError(
            f"{table.name}: {len(good)} samples with a time; a record has at least {_FEWEST}"
        )
    falls = np.diff(good) < 0.0
    if guessed and falls.mean() > 0.01:
        raise other_column()
    if falls.any():
        raise UsageError(
            f"{table.name}: time falls at sample {np.argmax(falls) + 2}. Does the file contain "
            "several records?"
        )
    lasts = np.ptp(good)
    if lasts > _LONGEST:
        raise TableError(
            f"{table.name}: lasts {lasts:.4g} s. Is the time in another unit (record.time_unit)?",
            "time_unit",
        )
    return time, place


def _interval(text: str) -> float:
    """Time between samples [s] from the metadata, 0 without it."""
    rated = _RATE.search(text)
    timed = _INTERVAL.search(text)
    if rated:
        rate = float(rated[1]) * _PREFIXES[rated[2].lower()]
        return 1.0 / rate if rate > 0.0 else 0.0
    if timed:
        return float(timed[1]) * UNITS["time"].get(timed[2] or "s", 1.0)
    return 0.0


def _common(time: Array, place: int, files: list[Recorded], changes: Changes) -> Array:
    """The time that all files have; UsageError for files that do not have the same clock."""
    count = len(time)
    for table, columns, _ in files[1:]:
        count = min(count, len(table))
        if len(columns) <= place:
            raise UsageError(
                f"{table.name}: has no column {place + 1}, the time column of the first file"
            )
        if place >= 0 and not columns[place].is_clock(time[:count]):
            raise UsageError(
                f"{table.name}: its clock differs from that of {files[0].table.name}. Write both "
                "channels with one clock"
            )
        if len(table) != len(time):
            changes.add("files of different length: the longer one is cut", signal=table.name)
    return time[:count]


def _step(time: Array) -> float:
    """Median of the steps of a time."""
    return float(np.median(np.diff(time)))


# --- gauges ---------------------------------------------------------------------------------------


def _by_role(
    asked: RecordTable, files: list[Recorded], clock: int, time: Array
) -> dict[str, list[Column]]:
    """The columns of the incident, the reflected and the receiving gauges.

    Two or four unnamed signals: first those of the incident bar.  `FILE:COLUMN` names a column of
    another file than the first.
    """

    def named(name: str | int, role: str) -> Column:
        stem, _, rest = str(name).rpartition(":")
        for table, columns, _ in files:
            if stem and stem in (table.name, Path(table.name).stem):
                return columns[table.place(rest, key=role)]
        return files[0].columns[files[0].table.place(name, key=role)]

    if asked.incident and asked.receiving:
        roles = ("incident", "reflected", "receiving")
        return {role: [named(name, role) for name in getattr(asked, role)] for role in roles}
    if asked.incident or asked.receiving:
        missing = "receiving" if asked.incident else "incident"
        raise TableError("record.incident and record.receiving are both required", missing)
    signals = [
        column
        for file in files
        for place, column in enumerate(file.columns)
        if place != clock and not _repeats(column, time)
    ]
    usable = [column for column in signals if not column.table.faults]
    if len(usable) not in (2, 4) or asked.reflected:
        names = ", ".join(repr(column.name) for column in signals)
        raise TableError(
            f"{files[0].table.name}: {len(signals)} signals ({names}); name them by "
            "record.incident, record.receiving (and record.reflected)",
            "incident",
        )
    each = len(usable) // 2
    return {"incident": usable[:each], "receiving": usable[each:]}


def _repeats(column: Column, time: Array) -> bool:
    """Whether a column repeats the time; UsageError for the time of another clock."""
    dimension = column.unit(column.time_unit)[0]
    if not column.rises or dimension not in ("time", ""):
        return False
    alike = column.is_clock(time)
    if dimension == "time" and not alike:
        raise UsageError(
            f"{column.table.name}: column {column.name!r} is a second clock that differs from the "
            "first. Write all channels with one clock"
        )
    return alike


def _strain(column: Column, name: str, bar: BarTable, home: str, changes: Changes) -> Array:
    """A column as strain; `home` is the table of its bar."""
    dimension, unit = column.unit(bar.unit)
    factor = UNITS.get(dimension, {}).get(unit, 1.0)
    text = f"is strain in {unit}"
    if not unit:
        text = "has no unit: strain is taken"
    elif dimension == "voltage":
        if not bar.excitation:
            raise InputError(
                f"{name} is in {unit}: the bridge is required too, for example excitation = 5.0 "
                "(a number, volts)",
                home,
            )
        factor *= bar.strain_per_volt
        text = f"is in {unit}: {bar.strain_per_volt * 1e6:.5g} microstrain a volt"
    elif dimension != "strain":
        raise InputError(
            f"{name}: its unit must be strain, microstrain, % or one of "
            f"{', '.join(UNITS['voltage'])}, not {unit!r}",
            home,
            "unit",
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
    size = np.quantile(away, 0.98)
    if size > _MOST_STRAIN:
        raise InputError(
            f"{name}: a strain of {size:.3g}, but no elastic bar bears more than {_MOST_STRAIN:g}. "
            "Is it in another unit (BAR.unit)?",
            home,
            "unit",
        )
    changes.add(text, signal=name)
    return values


# --- even steps -----------------------------------------------------------------------------------


def _even(time: Array, traces: list[Trace], changes: Changes) -> tuple[float, list[Trace]]:
    """The beginning [s], and the traces on even steps of time."""
    raw = np.array([trace.strain for trace in traces])
    there = np.isfinite(time)
    if not there.all():
        changes.add(f"{(~there).sum()} rows without a time are ignored")
        time = time[there]
        raw = raw[:, there]
    time, raw = _distinct(time, raw, changes)
    step = _step(time)
    grid = time
    if _is_even(time, _UNEVEN):
        step = np.ptp(time) / (len(time) - 1)
    else:
        count = round(np.ptp(time) / step) + 1
        if count > 4 * len(time) + 1000:
            raise UsageError("the steps of time differ too much: most of the record is missing")
        grid = time[0] + step * np.arange(count)
        changes.add(f"uneven time steps: interpolated to {step * 1e6:.6g} us")
    even = []
    filled = 0
    lost = 0
    for trace, values in zip(traces, raw, strict=True):
        good = np.isfinite(values)
        seen = np.pad(time[good], 1, constant_values=(-np.inf, np.inf))
        place = np.searchsorted(seen, grid)
        before = seen[place - 1]
        after = seen[place]
        gap = after - before
        nearest = np.minimum(grid - before, after - grid)
        missing = (nearest > 1e-6 * step) & (gap > 1.5 * step)
        unknown = missing & (gap > (_SHORT_GAP + 1.5) * step)
        filled += (missing & ~unknown).sum()
        lost += unknown.sum()
        strain = np.interp(grid, time[good], values[good])
        even.append(trace._replace(step=step, strain=strain, known=~unknown))
    if filled:
        changes.add(f"{filled} missing samples are filled by interpolation")
    if lost:
        changes.add(f"{lost} samples lie in gaps of more than {_SHORT_GAP} and are not used")
    return grid[0], even


def _distinct(time: Array, raw: Array, changes: Changes) -> Pair:
    """Time that rises at every sample: rows that are there twice go, coarse times are spread."""
    steps = np.diff(time)
    same = steps == 0.0
    if not same.any():
        return time, raw
    equal = np.isclose(raw[:, 1:], raw[:, :-1], rtol=0.0, atol=0.0, equal_nan=True)
    first = np.append(True, ~same)
    sample = np.argmax(same) + 2
    text = ""
    if equal[:, same].all() and _is_even(time[first], 0.5):
        text = f"{same.sum()} repeated rows are ignored"
    elif same.sum() <= _FEW_TWICE and _is_even(time[first], _UNEVEN):
        text = (
            f"{same.sum()} samples have the time of the sample before, first sample {sample}: "
            "their mean is taken"
        )
    if text:
        changes.add(text)
        places = np.flatnonzero(first)
        counts = np.diff(places, append=len(time))
        return time[first], np.add.reduceat(raw, places, axis=1) / counts
    # a coarse clock takes steps of one digit, again and again
    digit = steps.max()
    samples = np.arange(len(time))
    even = np.linspace(time[0], time[-1], len(time))
    again = (steps > 0.99 * digit).sum() > _FEW_TWICE
    if digit == 0.0 or not again or np.abs(even - time).max() > 1.01 * digit:
        raise UsageError(
            f"two samples have the same time, first at sample {sample}. Remove one of them, or "
            "leave out the time column and set record.sample_interval"
        )
    changes.add("the time has too few digits to distinguish its samples: even steps are assumed")
    # the last time is rounded like the others: a line gives the mean step
    slope = np.polyfit(samples, time - time[0], 1)[0]
    return time[0] + slope * samples, raw


def _is_even(time: Array, tolerance: float) -> bool:
    """Whether a time rises by steps within a share of their median."""
    step = _step(time)
    return bool((np.abs(np.diff(time) - step) <= tolerance * step).all())
