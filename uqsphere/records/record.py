"""A table of numbers as a recorder writes it: CSV or TSV, any line ends, decimal point or comma, with or without names.

What is not a number becomes NaN and is counted; rows that do not fit the others are an error with their line.
Nothing is mended here: that is `uqsphere.records.record`.
"""

from __future__ import annotations

import codecs
import csv
import os
import re
import stat
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.units import UNITS

#: bytes of a file; 10 million rows of two columns have about a third of this
LARGEST_RECORD: Final = 1 << 30
#: rows that are read one by one where the fast way meets something odd
_MOST_ODD: Final = 2_000_000
#: what the kinds of line, separator and names are told from
_HEAD: Final = 1 << 16
#: words that a recorder writes for a number it does not have, in lower case
_ABSENT: Final = frozenset(
    {"", "nan", "na", "n/a", "null", "none", "-", "--", "#n/a", "inf", "-inf", "+inf", "overflow"}
)
_NAME: Final = re.compile(r"^(?P<name>.*?)\s*[\[(/]\s*(?P<unit>[^\])]*?)\s*[\])]?\s*$")


class RecordError(ValueError):
    """A record cannot be used; says where, what was found and what to do."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """Columns of a file.

    Attributes
    ----------
    names : tuple of str
        As written, without units; ``column 1`` … where the file has none.
    units : tuple of str
        As written in brackets behind the name, else empty.
    values : (n, columns) array
        NaN where the file has no number.
    notes : tuple of str
        What was done to read it.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    notes: tuple[str, ...] = field(default=())


def read_table(path: str | Path) -> Table:
    """The columns of a record.

    Parameters
    ----------
    path : str or Path
        Text in UTF-8, UTF-16 or Latin-1; columns divided by comma, semicolon, tab or blanks; lines that begin with
        ``#`` are left out.

    Raises
    ------
    RecordError
        Where the file is missing, too large, empty or no table of numbers.
    """
    path = Path(path)
    encoding = _check_file(path)
    with open(path, encoding=encoding, newline=None, errors="strict") as stream:
        try:
            head = stream.read(_HEAD)
        except UnicodeDecodeError as error:
            raise RecordError(f"{path.name}: this is not text ({error.reason})") from None
    if "\0" in head:
        raise RecordError(f"{path.name}: found a NUL byte: export the record as text (CSV)")
    form = _form(head, path.name)
    try:
        values = _fast(path, encoding, form)
    except (ValueError, UnicodeDecodeError):
        values = _slow(path, encoding, form)
    strange = int(np.isnan(values).sum())
    if len(values) < 2:
        raise RecordError(f"{path.name}: found {len(values)} rows of numbers, a record needs more")
    notes = list(form.notes)
    if strange:
        notes.append(f"{strange} cells hold no number")
    return Table(names=form.names, units=form.units, values=values, notes=tuple(notes))


def _check_file(path: Path) -> str:
    """The encoding of a file that can be read at all."""
    try:
        kind = os.stat(path)
        if not stat.S_ISREG(kind.st_mode):
            raise RecordError(f"{path.name}: this is no file")
        if kind.st_size > LARGEST_RECORD:
            raise RecordError(
                f"{path.name}: {kind.st_size / 2**20:,.0f} MiB is more than the {LARGEST_RECORD >> 20:,} MiB that are "
                "read: cut the record to the test, or thin it"
            )
        with open(path, "rb") as stream:
            begin = stream.read(_HEAD)
    except FileNotFoundError:
        raise RecordError(f"{path.name}: there is no such file") from None
    except OSError as error:
        raise RecordError(f"{path.name}: cannot be read: {error.strerror}") from None
    if begin.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(begin)
    except UnicodeDecodeError:
        return "latin-1"  # the micro sign of an older recorder
    return "utf-8-sig"


@dataclass(frozen=True, kw_only=True)
class _Form:
    """How the file is written: separator (None: blanks), decimal comma, lines before the first number, names."""

    separator: str | None
    comma: bool
    skip: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    notes: tuple[str, ...]


def _split(line: str, separator: str | None) -> list[str]:
    if separator is None:
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]


def _number(cell: str, comma: bool) -> float | None:
    """The number of a cell, NaN where it says that there is none, None where it is something else."""
    text = cell.strip().strip('"')
    if text.lower() in _ABSENT:
        return float("nan")
    try:
        return float(text.replace(",", ".") if comma else text)
    except ValueError:
        return None


#: separator (None: blanks) and decimal comma, the likelier first
_WRITTEN: Final = (
    (";", False), (";", True), ("\t", False), ("\t", True), (",", False), (None, False), (None, True),
)  # fmt: skip


def _counts(line: str) -> bool:
    """Whether a line is neither blank nor a comment."""
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _columns_of(lines: Sequence[str], separator: str | None, comma: bool) -> tuple[int, int]:
    """Rows of numbers with the usual number of columns, and that number."""
    rows = [[_number(cell, comma) for cell in _split(line, separator)] for line in lines if _counts(line)]
    good = [len(row) for row in rows if len(row) > 1 and None not in row and not _empty(row)]
    usual = max(set(good), key=good.count) if good else 0
    return good.count(usual), usual


def _form(head: str, name: str) -> _Form:
    lines = head.split("\n")
    if len(head) == _HEAD:
        lines = lines[:-1]  # cut in the middle
    found = [(_columns_of(lines[:400], *way), way) for way in _WRITTEN]
    (score, width), (separator, comma) = max(found, key=lambda one: one[0][0])
    if not score:
        single = any(_number(line, True) is not None for line in filter(str.strip, lines))
        raise RecordError(
            f"{name}: no table of numbers was found (columns of numbers: {'one column only' if single else 'none'}); a "
            "record has a column of time and one or more of strain or volts, divided by comma, semicolon or tab"
        )
    skip, header = _above_numbers(lines, separator, comma, width)
    names, notes = list(header or ()), [] if header else ["the file names no columns"]
    if len(names) == width + 1 and not names[-1]:
        names = names[:-1]
    names += [f"column {k + 1}" for k in range(len(names), width)]
    split = [_unit_of(text) for text in names]
    units = _units_below(lines[:skip], separator, header, [unit for _, unit in split])
    notes += ["decimal comma"] * comma
    return _Form(separator=separator, comma=comma, skip=skip, names=tuple(text for text, _ in split),
                 units=tuple(units), notes=tuple(notes))  # fmt: skip


def _above_numbers(
    lines: Sequence[str], separator: str | None, comma: bool, width: int
) -> tuple[int, list[str] | None]:
    """Lines before the first row of numbers, and the cells of the one that names the columns."""
    header = None
    for skip, line in enumerate(lines):
        if not _counts(line):
            continue
        cells = _split(line, separator)
        row = [_number(cell, comma) for cell in cells]
        if len(row) < 2:
            continue
        if row[0] is not None and not _empty(row):
            return skip, header
        if None in row and (header is None or len(cells) == width):
            header = cells
    return len(lines), header


def _empty(row: Sequence[float | None]) -> bool:
    return all(value is None or value != value for value in row)


def _unit_of(text: str) -> tuple[str, str]:
    """Name and unit of a heading such as ``time [us]``."""
    found = _NAME.match(text)
    if found is None or not found["name"] or not any(mark in text for mark in "[("):
        return text, ""
    return found["name"], found["unit"]


def _units_below(lines: Sequence[str], separator: str | None, header: list[str] | None, units: list[str]) -> list[str]:
    """Units from a line of their own below the names."""
    if header is None or any(units):
        return units
    at = [k for k, line in enumerate(lines) if line.strip() and _split(line, separator) == header]
    for line in lines[at[-1] + 1 :] if at else []:
        cells = [cell.strip("[]() ") for cell in _split(line, separator)] if line.strip() else []
        if cells and cells[0] in UNITS["time"]:
            return [*cells, *[""] * len(units)][: len(units)]
    return units


def _lines(path: Path, encoding: str, form: _Form) -> Iterator[tuple[int, str]]:
    """Lines with their number, from the first number on."""
    with open(path, encoding=encoding, newline=None) as stream:
        for number, line in enumerate(stream, start=1):
            if number > form.skip:
                yield number, line


def _fast(path: Path, encoding: str, form: _Form) -> Array:
    """A clean file, by numpy's own reader."""
    width = len(form.names)
    if form.comma:
        lines: object = (line.replace(",", ".") for _, line in _lines(path, encoding, form))
    else:
        lines = (line for _, line in _lines(path, encoding, form))
    values = np.loadtxt(lines, delimiter=form.separator, comments="#", ndmin=2, dtype=float)  # type: ignore[call-overload]
    if values.shape[1] != width:
        raise ValueError("not the columns of the head")
    return np.where(np.isfinite(values), values, np.nan)


def _slow(path: Path, encoding: str, form: _Form) -> Array:
    """Row by row: cells without a number become NaN, the first row that does not fit is an error."""
    rows: list[list[float]] = []
    try:
        for number, line in _lines(path, encoding, form):
            if _counts(line):
                rows.append(_row(line, form, f"{path.name}: line {number}"))
            if len(rows) > _MOST_ODD:
                raise RecordError(
                    f"{path.name}: more than {_MOST_ODD:,} rows, some of which are not plain numbers: cut or clean it"
                )
    except (UnicodeDecodeError, csv.Error) as error:
        raise RecordError(f"{path.name}: this is no table of numbers: {error}") from None
    values = np.asarray(rows, dtype=float).reshape(len(rows), len(form.names))
    return np.where(np.isfinite(values), values, np.nan)


def _row(line: str, form: _Form, where: str) -> list[float]:
    """The numbers of a line."""
    width, cells = len(form.names), _split(line, form.separator)
    if len(cells) == width + 1 and cells[-1] == "":
        cells = cells[:-1]  # a separator at the end of the line
    if len(cells) != width:
        raise RecordError(
            f"{where} has {len(cells)} columns, the lines before have {width}: {line.strip()[:60]!r}"
            + _comma_hint(form)
        )
    row = []
    for cell in cells:
        value = _number(cell, form.comma)
        if value is None:
            raise RecordError(f"{where}: found {cell[:40]!r}, where a number is due")
        row.append(value)
    return row


def _comma_hint(form: _Form) -> str:
    if form.separator == "," and not form.comma:
        return "; with a decimal comma the columns must be divided by semicolons or tabs"
    return ""


# --- From the columns of a table to strain over even time: units, gaps, uneven steps, clipping, baseline.
# Whatever is changed is said in a note; what cannot be changed without inventing a record is an error.


#: unit of a signal -> factor to strain, or to volts where the second entry says so
SIGNAL_UNITS: Final[dict[str, tuple[float, bool]]] = {
    "strain": (1.0, False), "m/m": (1.0, False), "mm/mm": (1.0, False), "-": (1.0, False), "1": (1.0, False),
    "microstrain": (1e-6, False), "ustrain": (1e-6, False), "ue": (1e-6, False), "µε": (1e-6, False),
    "με": (1e-6, False), "um/m": (1e-6, False), "µm/m": (1e-6, False), "%": (1e-2, False),
    "V": (1.0, True), "mV": (1e-3, True), "uV": (1e-6, True), "µV": (1e-6, True),
}  # fmt: skip
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
#: samples that make a baseline
_BASELINE: Final = 20
#: share of the peak, and multiple of the noise, at which a wave begins
_ONSET_SHARE, _ONSET_NOISE = 0.03, 5.0


@dataclass(frozen=True, kw_only=True)
class Wiring:
    """How a signal becomes a strain: eps = 4 U/(k N U_0 A) for a Wheatstone bridge, N active arms.

    Attributes
    ----------
    unit : str
        One of `SIGNAL_UNITS`; empty: what the file says, else strain.
    gauge_factor, excitation, amplification, active_arms : float
        k [-], bridge supply U_0 [V] (0: not given), A of the amplifier, N: 1 quarter, 2 half bridge.
    time_unit : str
        Unit of the time; empty: what the file says, else s.
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

    Attributes
    ----------
    start, step : float
        Time of the first sample and between samples [s].
    strain : (n, k) array
        One column per signal, tension positive.
    held : (n,) array of bool
        Samples inside gaps too long to be filled with any right.
    noise : (k,) array
        Standard deviation of a sample at rest; 0 where there is no baseline to tell it from.
    memory : (k,) array
        Samples over which the noise is correlated, at least 1.
    offset : (k,) array
        Standard deviation of the baseline that was taken off.
    names, notes : tuples of str
    """

    start: float
    step: float
    strain: Array
    held: Flags
    noise: Array
    memory: Array
    offset: Array
    names: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def time(self) -> Array:
        """Instants of the samples, (n,) [s]."""
        return np.asarray(self.start + self.step * np.arange(len(self.strain)), dtype=float)


def _pick(table: Table, signals: int, columns: Sequence[str]) -> list[int]:
    """Places of time and signals among the columns."""
    count = len(table.names)
    if columns:
        if len(columns) != signals + 1:
            raise RecordError(f"{len(columns)} columns are named, {signals + 1} are due: time and {signals} of strain")
        for name in columns:
            if table.names.count(name) != 1:
                said = "more than once" if name in table.names else "not"
                raise RecordError(f"the column {name!r} is {said} in the file, which has {', '.join(table.names)}")
        return [table.names.index(name) for name in columns]
    if count != signals + 1:
        what = "too few" if count < signals + 1 else "too many"
        raise RecordError(
            f"found {count} columns ({', '.join(table.names)}), {what}: time and {signals} of strain or volts are due; "
            "name those that count with columns"
        )
    return list(range(count))


def make_record(table: Table, signals: int = 1, *, wiring: Wiring | None = None,
                columns: Sequence[str] = ()) -> Record:  # fmt: skip
    """Strains of a table over even time, as they were recorded: baseline and sign are untouched.

    Parameters
    ----------
    table : Table
    signals : int
        Columns of strain that are due beside the time.
    wiring : Wiring, optional
    columns : sequence of str
        Names of the time's and the signals' columns; all in their order if empty.

    Raises
    ------
    RecordError
        For a wrong number of columns, an unknown unit, time that runs backwards, a clipped signal, numbers that no bar
        can have, fewer than 20 samples.
    """
    wiring = Wiring() if wiring is None else wiring
    at = _pick(table, signals, columns)
    notes = list(table.notes)
    unit = wiring.time_unit or table.units[at[0]] or "s"
    if unit not in UNITS["time"]:
        raise RecordError(f"the unit {unit!r} of the time is not known; allowed: {', '.join(UNITS['time'])}")
    time = table.values[:, at[0]] * UNITS["time"][unit]
    factors = [wiring.factor(table.units[place], table.names[place]) for place in at[1:]]
    raw = table.values[:, at[1:]] * np.array(factors)
    names = tuple(table.names[place] for place in at[1:])
    there = np.isfinite(time)
    if not there.all():
        notes.append(f"{int((~there).sum())} rows without a time are left out")
        time, raw = time[there], raw[there]
    if len(time) < _BASELINE:
        raise RecordError(f"found {len(time)} samples, a record has {_BASELINE} at least")
    time = _ascending(time, notes)
    if time[-1] - time[0] > _LONGEST:
        raise RecordError(
            f"the record lasts {time[-1] - time[0]:.4g} s, more than any test: is its time in another unit? "
            'Say so, as in time_unit = "us"'
        )
    for column, name in zip(raw.T, names, strict=True):
        _refuse_nonsense(column, name)
        _refuse_clipped(time, column, name)
    start, step, strain, held = _even(time, raw, notes)
    if len(strain) > _LARGE:
        start, step, strain, held = _thinned(start, step, strain, held, notes)
    unknown, memory = np.zeros(signals), np.ones(signals)
    return Record(start=start, step=step, strain=strain, held=held, noise=unknown, memory=memory,
                  offset=unknown.copy(), names=names, notes=tuple(notes))  # fmt: skip


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


def _refuse_nonsense(column: Array, name: str) -> None:
    good = column[np.isfinite(column)]
    if len(good) < max(_BASELINE, len(column) // 2):
        raise RecordError(f"{name}: {len(column) - len(good)} of {len(column)} samples are no numbers")
    size = float(np.abs(good - np.median(good)).max())
    if size == 0.0:
        raise RecordError(f"{name}: every sample is the same: there is no wave in it")
    if size > _MOST_STRAIN:
        raise RecordError(
            f"{name}: reaches {size:.3g}, which is no strain of an elastic bar: is it in microstrain or volts? "
            'Say so, as in unit = "microstrain"'
        )


def _longest_run(same: Flags) -> tuple[int, int]:
    """Length and first place of the longest run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8)))
    if len(edges) == 0:
        return 0, 0
    lengths = edges[1::2] - edges[::2]
    best = int(np.argmax(lengths))
    return int(lengths[best]), int(edges[2 * best])


def _refuse_clipped(time: Array, column: Array, name: str) -> None:
    """A recorder at the end of its range writes one number again and again, where elsewhere it writes noise."""
    good = np.isfinite(column)
    values, at = column[good], time[good]
    head = values[: max(len(values) // 20, _BASELINE)]
    if np.ptp(head) == 0.0:  # without noise a flat top may be one
        return
    quiet, _ = _longest_run(np.concatenate([[False], np.diff(head) == 0.0]))
    for extreme in (values.max(), values.min()):
        run, first = _longest_run(values == extreme)
        if run >= _FLAT and run > 2 * (quiet + 1):
            raise RecordError(
                f"{name} is clipped at {extreme:.6g}: {run} samples from {at[first] * 1e6:.6g} us on are the same; "
                "its peak is not in the record: record again with a wider range"
            )


def _even(time: Array, raw: Array, notes: list[str]) -> tuple[float, float, Array, Flags]:
    """Even steps and no missing numbers; `held` marks what lies in long gaps."""
    steps = np.diff(time)
    step = float(np.median(steps))
    uneven = bool(np.abs(steps - step).max() > 0.01 * step)
    if not uneven:
        step = float((time[-1] - time[0]) / (len(time) - 1))
    missing = np.isnan(raw)
    if not uneven and not missing.any():
        return float(time[0]), step, raw, np.zeros(len(raw), dtype=bool)
    count = round((time[-1] - time[0]) / step) + 1
    if count > 4 * len(time) + 1000:
        raise RecordError("the steps of time differ too much: most of the record is missing")
    grid = time[0] + step * np.arange(count)
    strain, held = np.empty((count, raw.shape[1])), np.zeros(count, dtype=bool)
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
        held |= inside & (wide > (_SHORT_GAP + 1.5) * step)
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


def _thinned(start: float, step: float, strain: Array, held: Flags,
             notes: list[str]) -> tuple[float, float, Array, Flags]:  # fmt: skip
    """Means of blocks of samples."""
    block = -(-len(strain) // _LEFT)
    whole = len(strain) // block * block
    notes.append(f"{len(strain):,} samples are thinned to {whole // block:,}, the means of {block} each")
    means = strain[:whole].reshape(-1, block, strain.shape[1]).mean(axis=1)
    lost = np.asarray(held[:whole].reshape(-1, block).any(axis=1))
    return start + 0.5 * (block - 1) * step, step * block, np.asarray(means, dtype=float), lost


@dataclass(frozen=True, kw_only=True)
class Onset:
    """Where a wave begins: sample, level that it exceeds there, largest value against rest."""

    sample: int
    level: float
    peak: float


def find_onset(values: Array, noise: float = 0.0) -> Onset:
    """The first sample that leaves the rest before the wave for good, on values about zero."""
    peak = float(np.abs(values).max())
    level = max(_ONSET_SHARE * peak, _ONSET_NOISE * noise)
    if not level < peak:
        raise RecordError("no wave rises above the noise of the record")
    above = np.abs(values) > level
    # one spike is no wave: three samples in a row
    sure = above[:-2] & above[1:-1] & above[2:]
    if not sure.any():
        raise RecordError("no wave of three samples or more rises above the noise of the record")
    return Onset(sample=int(np.argmax(sure)), level=level, peak=peak)


def _rest(values: Array) -> tuple[float, float]:
    """Middle of the first samples, and the scatter of neighbours, both robust."""
    some = values[: max(_BASELINE, len(values) // 50)]
    return float(np.median(some)), 1.4826 * float(np.median(np.abs(np.diff(values)))) / np.sqrt(2.0)


def set_baseline(record: Record) -> Record:
    """Every signal about its own rest, with the noise that was found there.

    Raises
    ------
    RecordError
        Where a signal is nowhere at rest.
    """
    strain, notes = record.strain.copy(), list(record.notes)
    noise, memory, unsure = record.noise.copy(), record.memory.copy(), record.offset.copy()
    for k, name in enumerate(record.names):
        values = strain[:, k]
        middle, scatter = _rest(values)
        try:
            onset = find_onset(values - middle, scatter)
        except RecordError as error:
            raise RecordError(f"{name}: {error}") from None
        count = onset.sample - max(3, onset.sample // 20)
        quiet = values[: max(count, 0)]
        if count < _BASELINE or abs(quiet.mean() - middle) > 0.05 * onset.peak:
            quiet = _rest_behind(values, name, onset.peak)
            notes.append(f"{name}: no baseline before the wave, taken from the end of the record")
        offset = float(quiet.mean())
        if abs(offset) > 0.005 * onset.peak:
            notes.append(f"{name}: a baseline of {offset * 1e6:.4g} microstrain is taken off")
        noise[k], memory[k], drift = _scatter(quiet)
        unsure[k] = noise[k] * np.sqrt(min(1.0, memory[k] / len(quiet)))
        if drift > 0.02 * onset.peak:
            notes.append(f"{name}: the baseline drifts by {drift * 1e6:.3g} microstrain, which is left in")
        strain[:, k] = values - offset
    return replace(record, strain=strain, noise=noise, memory=memory, offset=unsure, notes=tuple(notes))


def _rest_behind(values: Array, name: str, peak: float) -> Array:
    last = values[-max(_BASELINE, len(values) // 20) :]
    begins = float(np.median(values[:5]))
    if np.ptp(last) > 0.1 * peak:
        raise RecordError(f"{name}: the signal is at rest neither before the wave nor at the end: there is no baseline")
    if abs(begins - last.mean()) > 0.1 * np.abs(values - last.mean()).max():
        raise RecordError(f"{name}: the record begins inside the wave: its beginning is missing")
    return last


def _scatter(quiet: Array) -> tuple[float, float, float]:
    """Standard deviation about a line, samples over which it is correlated, drift along the baseline."""
    place = np.linspace(-0.5, 0.5, len(quiet))
    slope = float((place * (quiet - quiet.mean())).sum() / np.square(place).sum())
    left = quiet - quiet.mean() - slope * place
    sd = float(left.std(ddof=2))
    unsure = sd / np.sqrt(len(quiet) / 12.0)
    drift = abs(slope) if abs(slope) > 4.0 * unsure else 0.0
    if sd <= 1e-12 * float(np.abs(quiet).max()):  # rounding is no noise
        return 0.0, 1.0, drift
    memory = 1.0
    for lag in range(1, min(len(left) // 4, 200)):
        alike = float((left[lag:] * left[:-lag]).mean() / sd**2)
        if alike < 2.0 / np.sqrt(len(left)):
            break
        memory += 2.0 * alike
    return sd, memory, drift


def turn_sign(record: Record, signal: int) -> Record:
    """The first wave of a signal made compression, below zero, if it is not."""
    values = record.strain[:, signal]
    onset = find_onset(values, float(record.noise[signal]))
    first = values[onset.sample :]
    over = np.flatnonzero(np.abs(first) > 0.5 * onset.peak)
    if first[over[0]] < 0.0:
        return record
    strain = record.strain.copy()
    strain[:, signal] = -values
    said = (
        f"{record.names[signal]}: its first wave was positive; a wave that presses is negative here, the sign is turned"
    )
    return replace(record, strain=strain, notes=(*record.notes, said))
