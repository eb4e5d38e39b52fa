"""The one reader of tables: CSV with comma, semicolon or tab, and .xlsx, as they come from
instruments and Excel.

Decimal point or comma; UTF-8 with or without mark, UTF-16, else Windows' cp1252 with a note.  Units
stand in a heading (``force [kN]``, ``force_kN``, ``force in kN``), in a row below it, or are given.
All faults of a kind are one message.
"""

import codecs
import csv
import io
import math
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from uqsphere.arrays import Array, Flags, Places
from uqsphere.documents import WORDS, suggestion
from uqsphere.errors import Fault, UsageError, as_text
from uqsphere.files import TooLarge, read_given
from uqsphere.units import SPELLED, UNITS, alien, nearest_unit, typed_units

LARGEST = 32 << 20
#: columns of a table, characters of a line, cells and rows of a workbook
MOST_COLUMNS, _LONGEST, _MOST_CELLS = 2_000, 100_000, 400_000
_MOST_LINES = 8
#: rows among which headings with units are looked for
_PREAMBLE = 40
#: numbers beyond this have no squares
LARGEST_NUMBER = 1e150
_OTHER_SHEETS = "other sheets"

# --- what cells and headings look like ------------------------------------------------------------

_COLUMN_UNIT = re.compile(r"\s*[/,_]\s*|\s+in\s+|\s+")
_BRACKET = re.compile(r"[\[(]\s*([^\[\]()]*(?:\([^()]*\))?[^\[\]()]*)\s*[\])]")
#: a factor before or behind a unit: x10 MPa, MPa x 10; 10 MPa, 10^3 MPa, 1e3 N
_TIMES = re.compile(r"[x×*]\s*\d[\d.^*eE+-]*(?=[\s\]):/,_]|$)")
_FACTOR = re.compile(
    r"(?<![A-Za-z0-9.^=])(?:[x×*]\s*)?(?:10+|10\s*\^\s*[+-]?\d+|10\*\*[+-]?\d+"
    rf"|\d*\.?\d+[eE][+-]?\d+|0?\.0*1)(?=[\s\]):/,_]|$)|{_TIMES.pattern}"
)
#: #DIV/0!, #N/A, #NAME?, #WERT!, #¡VALOR!, #NV, #GETTING_DATA
_ERROR_VALUE = re.compile(r"#(?:¡?[^\W\d_][\w/ ]*[!?]|[A-Z]+[/_][A-Z\d]+|NV|NB)")
NOTHING = {"", "-", "nan", "n/a", "na", "none", "null", "#n/a"}
NUMBER = {
    mark: re.compile(rf"[+-]?(\d+[{mark}]?\d*|[{mark}]\d+)([eE][+-]?\d+)?", re.ASCII)
    for mark in ".,"
}
#: 1.234,5 and 1,234.5 and 1 234 are certainly marks of thousands, 2.830 possibly
_MARKED = re.compile(
    r"[+-]?\d{1,3}(?:(?:\.\d{3})+,\d*|(?:,\d{3})+\.\d*|(?:['\u00a0\u202f ]\d{3})+(?:[.,]\d*)?)"
)
_PERHAPS = re.compile(r"[+-]?[1-9]\d{0,2}(?:[.,]\d{3})+")
_DATE = re.compile(r"\d{4}-\d\d-\d\d.*|\d\d:\d\d:\d\d.*")
_SUMMARY = re.compile(
    r"(mean|average|avg|median|sd|std\.?( ?dev\.?)?|standard deviation|cov|cv|var|variance|σ|ø|x̄|"
    r"mittelwert|mittel|mw|durchschnitt|standardabweichung|stabw|varianz|anzahl|moyenne|"
    r"[ée]cart[- ]type|media|promedio|desviaci[óo]n)(?!\w).*|"
    r"(min|max|minimum|maximum|sum|summe|somme|suma|total)\W*",
    re.IGNORECASE,
)
#: keys that a study gives the unit of a column by
_UNIT_KEYS = {"force": "force_unit", "diameter": "diameter_unit", "column": "unit", "draws": "unit"}
#: what a row of units below the headings may have; units of US customary tables that no key takes
_ALL_UNITS = {"", "-", *SPELLED} | {unit for unit in chain(*UNITS.values()) if not unit.isdigit()}
_FOREIGN_UNITS = {"kip", "kips", "klbf", "tonf", "mil", "mils"}


class TableError(UsageError, Fault):
    """A table cannot be used: every fault, one a line; `key` is what the caller named the first bad
    column by.
    """


def unit_in_heading(heading: str, dimension: str) -> tuple[str, str | None]:
    """Bare name and unit of a heading; None where it names no unit of the dimension.

    A bracket counts as a whole, so that a factor in it is never dropped; so does a unit of another
    dimension.

    >>> unit_in_heading("rate_kN_s", "loading_rate"), unit_in_heading("D in mm", "length")
    (('rate', 'kN/s'), ('D', 'mm'))
    >>> unit_in_heading("energy_J/kg", "mass")
    ('energy_J/kg', None)
    >>> unit_in_heading("stress [10 MPa]", "pressure")
    ('stress [10 MPa]', None)
    """
    heading = heading[:200]
    brackets = [b for b in _BRACKET.finditer(heading) if _known_unit(b[1], dimension)]
    if len(brackets) == 1:
        name, _, behind = heading.partition(brackets[0][0])
        name = name.strip()
        if name and not (factor_in_heading(behind) or _TIMES.search(name)):
            return name, _known_unit(brackets[0][1], dimension)
    for gap in _COLUMN_UNIT.finditer(heading):
        name = heading[: gap.start()].strip()
        rest = heading[gap.end() :].strip()
        if not name or rest.isdigit() or _is_open(name) or factor_in_heading(name):
            continue
        if name.endswith((" per", "_per")) or ("/" in gap[0] and _is_compound(name, dimension)):
            break
        if rest == "in" and not set("/,") & set(gap[0]):
            continue  # the inner diameter D_in is no length in inches
        unit = _known_unit(rest, dimension)
        if unit:
            return name, unit
        if any(_known_unit(rest, other) for other in UNITS):
            break
    return heading, None


def factor_in_heading(heading: str) -> str:
    """The factor that a heading has beside a unit, such as x10 or 10^3; empty without one."""
    factor = _FACTOR.search(heading)
    return factor[0].strip() if factor else ""


def _known_unit(text: str, dimension: str) -> str | None:
    """The unit of a dimension that a text spells."""
    text = text.strip().removeprefix("in ").strip()
    ascii_powers = text.replace("²", "2").replace("³", "3")
    for spelled in (text, text.replace("_", "/"), ascii_powers, SPELLED.get(text)):
        if spelled and spelled in UNITS[dimension]:
            return spelled
    return None


def _is_compound(name: str, dimension: str) -> bool:
    """Whether what stands before / is a unit itself: N/mm is none of length, but in "Weg s/mm" and
    "time t/ms" a symbol stands there.
    """
    before = re.split(r"[\s_,(\[]", name)[-1]
    certain = len(before) > 1 or before in "NJ"
    return certain and before in _ALL_UNITS - UNITS[dimension].keys()


def _is_open(text: str) -> bool:
    """Whether a bracket in a text is not closed."""
    return any(text.count(opens) > text.count(closes) for opens, closes in ("[]", "()"))


def _unknown_unit(heading: str, dimension: str) -> str:
    """What is wrong with the unit that a heading seems to have, and the way out; empty where it
    seems to have none.

    >>> _unknown_unit("Load [KN]", "force")
    "'KN' is not a unit of this column; did you mean 'kN'?"
    """
    heading = heading[:200].strip()
    if _is_open(heading):
        return "a bracket of its heading is not closed. Quote headings that contain the divider"
    brackets = _BRACKET.findall(heading)
    words = re.split(r"[\s_,]+", heading)
    if not _is_compound(words[-1].partition("/")[0], dimension):
        words = words[-1].split("/")
    text = (brackets or words)[-1].strip()
    factor = factor_in_heading(heading)
    if factor:
        message = (
            f"its heading {as_text(heading, 60)!r} has the factor {factor!r}. Multiply the values "
            "by it"
        )
        for unit in filter(None, UNITS[dimension]):
            if re.search(rf"(?<!\w){re.escape(unit)}(?!\w)", heading):
                return f"{message} and write [{unit}]"
        return message
    if text and text in UNITS[dimension]:
        return f"is {text!r} its unit? Write a name and [{text}]"
    message = f"{as_text(text, 30)!r} is not a unit of this column{alien(text)}"
    near = nearest_unit(text, dimension)
    if near:
        return f"{message}; did you mean {near!r}?"
    return message if brackets or "/" in text else ""


def is_comment(line: str) -> bool:
    """Whether a line is a comment, and not a row that begins with an error of a spreadsheet."""
    return line.lstrip(" ").startswith("#") and not is_error_value(re.split("[,;\t]", line)[0])


def is_error_value(cell: str) -> bool:
    """Whether a cell is what spreadsheets write for an error, in any of their languages.

    >>> [is_error_value(cell) for cell in ("#DIV/0!", "#N/A", "#NV", "#REF!", "# a note")]
    [True, True, True, True, False]
    """
    return _ERROR_VALUE.fullmatch(cell.strip(' "')) is not None


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with a decimal point or comma."""
    return any(number.fullmatch(cell) for number in NUMBER.values())


def _decimal_mark(texts: Iterable[str]) -> str:
    """The mark that some cells have for certain; both, ".,", or neither, ""."""
    certain = set()
    for text in texts:
        if not _PERHAPS.fullmatch(text):
            certain |= {m for m in ".," if m in text and NUMBER[m].fullmatch(text)}
    return "".join(sorted(certain, reverse=True))


def _lines(lines: Sequence[int] | Places) -> str:
    text = ", ".join(map(str, lines[:_MOST_LINES]))
    if len(lines) > _MOST_LINES:
        text += f" and {len(lines) - _MOST_LINES} more"
    noun = "lines" if len(lines) > 1 else "line"
    return f"{noun} {text}"


# --- tables ---------------------------------------------------------------------------------------


@dataclass(kw_only=True)
class Table:
    """The cells of a file as texts: rows of data with the numbers of their lines, notes for the
    user, and the units [SI] of the columns that were read, by the keys that name them; `unit_keys`
    are the keys that give their units.
    """

    name: str
    headings: list[str]
    rows: list[list[str]]
    lines: Places
    notes: list[str]
    decimal: str
    unit_keys: Mapping[str, str] = field(default_factory=_UNIT_KEYS.copy)
    units: dict[str, float] = field(default_factory=dict)
    faults: dict[tuple[str, str], dict[int, None]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.rows)

    @cached_property
    def _mark(self) -> str:
        return _decimal_mark(chain(*self.rows))

    @cached_property
    def _no_data(self) -> dict[int, str]:
        """Places of rows that are no data, and what they are."""
        strange = {}
        for k, row in enumerate(self.rows):
            if row == self.headings:
                strange[k] = "the headings are repeated; pasted twice?"
            elif any(map(_SUMMARY.fullmatch, row)):
                strange[k] = "this is a summary row, not data. Delete it"
        return strange

    def place(self, column: str | int, dimension: str = "number", key: str = "") -> int:
        """Where a column stands, by its heading with or without its unit, or its number from 1 on;
        TableError else.
        """
        column = str(column)
        headings = self.headings
        bare = []
        for heading in headings:
            without = (unit_in_heading(heading, name)[0] for name in (dimension, *UNITS))
            bare.append(next((name for name in without if name != heading), heading))
        for names in (headings, bare):
            if names.count(column) == 1:
                return names.index(column)
        names = headings + bare
        often = "twice or more"
        hint = ""
        if column not in names:
            if column.isdigit() and 1 <= int(column) <= len(headings):
                return int(column) - 1
            same = [h for h in headings if _BRACKET.sub("", h).strip() == column]
            if len(same) == 1 and dimension != "number":
                raise TableError(
                    f"{same[0]!r}: {_unknown_unit(same[0], dimension)} ({typed_units(dimension)})",
                    key,
                )
            often = "not"
            hint = suggestion(column, names)
        hint = hint or _other_sheets(self.notes)
        if not hint and all(map(is_number, headings)):
            hint = "; the first row holds numbers: add a row of headings"
        elif not hint and len(headings) == 1 and re.search(r"\S[\s|]", headings[0]):
            hint = "; divide columns by commas, semicolons or tabs"
        listed = ", ".join(repr(h[:24]) for h in headings[:12])
        raise TableError(
            f"the column {column!r} is {often} in {self.name!r}, which has {listed}{hint}", key
        )

    def texts(self, column: str, key: str = "") -> list[str]:
        """Cells of a column."""
        at = self.place(column, key=key)
        return [row[at] for row in self.rows]

    def numbers(
        self,
        column: str | int,
        dimension: str = "number",
        unit: str | None = None,
        *,
        key: str = "",
        blank: bool = False,
    ) -> Array:
        """A column in SI, (n,); nan where a cell is empty and may be, or faulty, which is noted.

        unit : of the column; None or empty: that of its heading.  TableError at `key` without any,
            or with a contradiction.
        """
        at = self.place(column, dimension, key)
        column = str(column)
        heading = self.headings[at]
        if column.isdigit():
            column = heading or f"column {at + 1}"
        factor = self.units[key] = self._factor(heading, column, dimension, unit, key)
        values = self._parsed([row[at] for row in self.rows], column, key, blank)
        with np.errstate(over="ignore"):
            values *= factor
        large = np.abs(values) > LARGEST_NUMBER
        self.refuse(key, f"{column}: a number is too large", large)
        values[large] = math.nan
        return values

    def _factor(
        self, heading: str, column: str, dimension: str, unit: str | None, key: str
    ) -> float:
        """The unit of a column in SI: as given or of its heading, which must agree."""
        if dimension == "number":
            return 1.0
        units = UNITS[dimension]
        allowed = typed_units(dimension)
        unit_key = self.unit_keys.get(key, "units")
        in_heading = unit_in_heading(heading, dimension)[1]
        bracket = _BRACKET.search(heading)
        other = bracket and bracket[1] in _ALL_UNITS - {"", "-"}
        if not in_heading and (other or not unit):
            wrong = _unknown_unit(heading, dimension)
            if wrong:
                raise TableError(f"{heading!r}: {wrong} ({allowed})", key)
            more = ""
            if key in self.unit_keys:
                more = f', or add {unit_key} = "{next(iter(units))}"'
            raise TableError(
                f"the unit of the column {column!r} is missing. Write it in the heading, "
                f'"{column} [{next(iter(units))}]"{more} ({allowed})',
                key,
            )
        if unit and unit not in units:
            near = nearest_unit(unit, dimension)
            hint = f"; did you mean {near!r}?" if near else ""
            raise TableError(f"{unit_key} must be one of {allowed}, not {unit!r}{hint}", unit_key)
        if unit and in_heading and units[unit] != units[in_heading]:
            raise TableError(
                f"{unit_key} is {unit!r}, but the heading {heading!r} has {in_heading!r}", unit_key
            )
        return units[unit or in_heading or ""]

    def _parsed(self, texts: list[str], column: str, key: str, blank: bool) -> Array:
        """The number of each cell of a column (n,), nan where there is none; notes what is wrong
        with cells.
        """
        thousands = "a mark of thousands: write the number without it"
        certain = _decimal_mark(texts)
        mark = self.decimal or certain or self._mark
        other = ""
        doubt = ""
        perhaps = next(filter(_PERHAPS.fullmatch, texts), "")
        if certain == ".,":
            mark, other = sorted(".,", key=lambda m: -sum(m in text for text in texts))
        elif perhaps and not self.decimal:
            whole = next((w for w in texts if w.isdigit() and (len(w) > 3 or not certain)), "")
            if mark in (".", ",") and mark not in perhaps:
                doubt = thousands
            elif whole:
                doubt = f"{perhaps!r} beside {whole!r}: a mark of thousands? write it without"
            elif not mark and "," in perhaps:
                doubt = (
                    f'{perhaps!r} can be a decimal comma or a mark of thousands: add decimal = ","'
                )
        number = NUMBER.get(mark, NUMBER["."])
        no_data = self._no_data
        values = np.full(len(texts), math.nan)
        strange = ""
        for k, text in enumerate(texts):
            if k in no_data or (blank and text.lower() in NOTHING):
                continue
            if doubt and _PERHAPS.fullmatch(text):
                message = doubt
            elif number.fullmatch(text):
                values[k] = float(text.replace(",", "."))
                continue
            elif _MARKED.fullmatch(text):
                message = thousands
            elif other and other in text:
                message = "decimal point and comma in one column: write all alike"
            elif not text:
                message = "an empty cell"
            elif text.startswith("="):
                message = (
                    "a formula without a stored value: save the file in a spreadsheet program, or "
                    "paste values"
                )
            else:  # all that are no numbers are told by the first
                strange = strange or text
                message = self._strange(strange)
            self.refuse(key, f"{column}: {message}", [k])
        return values

    def _strange(self, text: str) -> str:
        """What is wrong with a cell that is no number."""
        message = f"{as_text(text, 60)!r} is not a number{alien(text)}"
        if is_number(text):
            message += f" with decimal = {self.decimal!r}"
        if _DATE.fullmatch(text):
            message += "; a cell of a workbook in the format of a date? Change it to a number"
        return message

    def refuse(self, key: str, message: str, wrong: Flags | list[int]) -> None:
        """Note that rows are wrong, flags (n,) or their places; each line is told of once for one
        fault.
        """
        lines = self.lines[wrong].tolist()
        if lines:
            self.faults.setdefault((key, message), {}).update(dict.fromkeys(lines))

    def flags(
        self, column: str, key: str, meant: str, words: Mapping[str, bool] = WORDS["flags"]
    ) -> Flags:
        """A column of flags, (n,), by the word in each cell."""
        texts = [text.lower() for text in self.texts(column, key)]
        wrong = [k for k, text in enumerate(texts) if not (text in words or k in self._no_data)]
        if wrong:
            self.refuse(key, f"{column}: {as_text(texts[wrong[0]], 60)!r} is not {meant}", wrong)
        return np.array([words.get(text, False) for text in texts], bool)

    def check(self) -> None:
        """Raise TableError with every fault noted so far."""
        for k, message in self._no_data.items():
            self.refuse("", message, [k])
        if self.faults:
            messages = [
                f"{self.name}: {_lines([*lines])}: {text}"
                for (_, text), lines in self.faults.items()
            ]
            raise TableError("\n".join(messages), next(iter(self.faults))[0])

    def finish(self) -> None:
        """Check, and note rows that repeat others."""
        self.check()
        first = dict[tuple[str, ...], int]()
        back = [k - first.setdefault(tuple(row), k) for k, row in enumerate(self.rows)]
        again = [k for k, shift in enumerate(back) if shift]
        # a block that was pasted twice repeats rows in their order; tests stopped at one load are
        # one row many times
        pasted = 2 * sum(back[k] == back[k - 1] for k in again) > len(again) > 1
        if 0 < len(again) <= _MOST_LINES:
            pasted |= len(again) > 1 or len(set(self.rows[again[0]])) > 2
        if pasted:
            verb = "repeats" if len(again) == 1 else "repeat"
            self.notes.append(
                f"{self.name}: {_lines(self.lines[again])} {verb} earlier rows: pasted twice?"
            )


# --- from files to tables -------------------------------------------------------------------------


def read_table(path: Path, *, decimal: str = "", sheet: str = "") -> Table:
    """The table of a CSV or .xlsx file; its first line that is no comment (`#`) has the headings.

    sheet : of a workbook (default: the first that is not empty).

    A title, or the preamble of an instrument, may stand above the headings.  Every line that is
    left out between rows of data is noted; an empty one is an empty cell of a single column.

    Raises TableError for what is no table, AccessError as `uqsphere.files.read_given`.
    """
    lines, notes = read_lines(path, sheet=sheet)
    name = as_text(path.name)
    live = {k: line for k, line in lines.items() if not is_comment(line)}
    texts = [*live.values()]
    ends = "".join(texts[:1] + texts[-1:])  # a title has no divider
    divider = next((mark for mark in "\t;" if mark in ends), ",")
    try:
        cells = cells_of(live, divider, strict=True)
    except csv.Error:
        raise TableError(
            f"{name!r}: a text in quotes extends over several lines. Keep every row on one line"
        ) from None
    rows = {k: _trimmed(row) for k, row in cells.items()}
    above = [*rows][: _place_of_headings([*rows.values()])]
    if above:
        notes.append(f"{name}: {_lines(above)}: above the headings, left out")
    for k in above:
        del rows[k]
    span = range(min(rows, default=0), max(rows, default=0))
    comments = [k for k in lines if k not in live and k in span]
    if comments:
        notes.append(f"{name}: {_lines(comments)}: comments (#), left out")
    empty = {k: [""] for k in span if k not in lines}
    if empty and max(map(len, rows.values())) == 1:
        rows = dict(sorted((rows | empty).items()))
    elif empty:
        notes.append(
            f"{name}: {_lines([*empty])}: empty, left out. If a mean stands below, delete it"
        )
    try:
        return table_of(name, rows, notes, decimal)
    except TableError as error:
        raise TableError(f"{error}{_other_sheets(notes)}") from None


def _other_sheets(notes: Iterable[str]) -> str:
    return "".join(f"; {note}" for note in notes if _OTHER_SHEETS in note)


def _trimmed(row: list[str]) -> list[str]:
    """A row without the empty cells at its end."""
    row = [*row]
    while row and not row[-1]:
        row.pop()
    return row


def _place_of_headings(rows: Sequence[list[str]]) -> int:
    """The place of the headings, below titles or what an instrument writes; 0 where the first row
    has them.

    Headings are a row without numbers: one that has a unit in brackets; else the first of several
    cells, below rows of one text; else the last row of texts, if all rows below it are numbers.
    """

    def has_unit(cell: str) -> bool:
        return bool(_BRACKET.search(cell)) and any(unit_in_heading(cell, name)[1] for name in UNITS)

    words = [not any(map(is_number, row)) for row in rows]
    cells = [[*filter(None, row)] for row in rows]
    least = min(2, max(map(len, rows), default=0))
    for place, texts in enumerate(cells[:_PREAMBLE]):
        if words[place] and len(texts) >= least and any(map(has_unit, texts)):
            return place
    place = next((k for k, texts in enumerate(cells) if len(texts) > 1 or not words[k]), 0)
    if place > 0 and words[place]:
        return place
    numbers = [len(texts) > 1 and all(map(is_number, texts)) for texts in cells]
    below = next((k for k, whole in enumerate(numbers) if whole), 0)
    place = below - 1
    if place > 0 and are_units(rows[place]):
        place -= 1
    if place < 1 or not words[place] or not all(numbers[below:]):
        return 0
    texts = [cell for cell in cells[place] if cell.lower() not in NOTHING]
    return place if len(texts) > 1 and not any(map(is_error_value, texts)) else 0


def read_lines(
    path: Path, largest: int = LARGEST, sheet: str = ""
) -> tuple[dict[int, str], list[str]]:
    """Lines of a CSV or .xlsx file by their numbers, empty ones left out, and notes; cells of a
    sheet end with tabs.

    Raises TableError for what is no text or sheet, AccessError as `uqsphere.files.read_given`.
    """
    name = as_text(path.name)
    notes = list[str]()
    try:
        data = read_given(path, largest)
    except TooLarge:
        raise TableError(f"{name!r} is larger than {largest >> 20} MiB") from None
    if data.startswith(b"PK\x03\x04"):
        lines = _sheet(data, name, notes, sheet)
    elif sheet:
        raise TableError(f"sheet belongs to workbooks, and {name!r} is a text file", "sheet")
    else:
        # only what ends a line everywhere: a text may have other marks of Unicode
        lines = dict(enumerate(re.split("\r*\n|\r", _decoded(data, name, notes)), 1))
        if re.fullmatch("sep=.", lines[1]):
            del lines[1]
        longest = max(map(len, lines.values()), default=0)
        if longest > _LONGEST:
            raise TableError(
                f"{name!r} has a line of {longest:,} characters; {_LONGEST:,} are read at most"
            )
    return {k: line for k, line in lines.items() if line.strip(" ;,\t").strip()}, notes


def _decoded(data: bytes, name: str, notes: list[str]) -> str:
    coding = "utf-8"
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        coding = "utf-16"
    try:
        text = data.decode(coding)
    except UnicodeDecodeError:
        notes.append(f"{name} is not {coding.upper()}: read as Windows text (cp1252)")
        text = data.decode("cp1252", "replace")
    if "\0" in text[:4096]:
        raise TableError(f"{name!r} is not a text file. Save it as CSV or .xlsx")
    return text.lstrip("\ufeff").replace("\N{MINUS SIGN}", "-")


def cells_of(
    lines: Mapping[int, str], divider: str, *, strict: bool = False
) -> dict[int, list[str]]:
    """Cells of lines by their numbers, divided by a character, or by blanks; csv.Error for quotes
    that do not close, if `strict`.
    """

    def divided(line: str) -> list[str]:
        if divider == " ":
            return line.split()
        (cells,) = csv.reader([line], delimiter=divider, strict=strict)
        return [cell.strip() for cell in cells]

    return {k: divided(line) for k, line in lines.items()}


def table_of(
    name: str, rows: Mapping[int, list[str]], notes: list[str], decimal: str = ""
) -> Table:
    """The table of rows by the numbers of their lines: headings, their units where they are a row,
    and data.
    """
    if not rows:
        raise TableError(f"{name!r} is empty")
    (_, headings), *numbered = rows.items()
    headings = _trimmed(headings)
    width = len(headings)
    wide = next((line for line, row in numbered if any(row[width:])), 0)
    if wide:
        way = "Give every column a heading"
        whole = [re.fullmatch(r"[+-]?\d+", cell) for cell in rows[wide]]
        if sum(map(bool, whole)) > len(rows[wide]) - width:
            way = "A decimal comma between commas? Save the file with semicolons"
        raise TableError(f"{name}: line {wide}: more cells than headings. {way}")
    if width > MOST_COLUMNS:
        raise TableError(f"{name!r} has {width:,} columns; {MOST_COLUMNS:,} are read at most")
    if numbered and are_units(numbered[0][1]):
        units = [f" [{cell.strip('[]()- ')}]" for cell in numbered.pop(0)[1]]
        pairs = zip_longest(headings, units, fillvalue="")
        headings = [heading + unit.removesuffix(" []") for heading, unit in pairs]
    if not numbered:
        raise TableError(f"{name!r} has no row below its headings")
    return Table(
        name=name,
        headings=headings,
        lines=np.array([line for line, _ in numbered]),
        notes=notes,
        decimal=decimal,
        rows=[row[:width] + [""] * (width - len(row)) for _, row in numbered],
    )


def are_units(row: list[str]) -> bool:
    """Whether the cells of a row are units."""
    texts = [cell.strip("[]() ") for cell in row]
    if set(texts) <= _ALL_UNITS:
        return any(row)

    def is_like_a_unit(text: str) -> bool:  # misspelled, unknown here, or multiplied by a factor
        bare = _FACTOR.sub("", text).strip()
        return bare in _ALL_UNITS | _FOREIGN_UNITS or any(nearest_unit(bare, d) for d in UNITS)

    # one of them may be misspelled, or have a factor, which the column tells
    certain = any(len(text) > 1 and text in _ALL_UNITS for text in texts)
    return certain and all(map(is_like_a_unit, texts))


# --- workbooks ------------------------------------------------------------------------------------


def _sheet(data: bytes, name: str, notes: list[str], wanted: str) -> dict[int, str]:
    """Rows of a sheet of a workbook, by default the first that has any and is not hidden, by their
    numbers, a tab behind each cell.  A formula stands in the place of a value that is not stored.
    """
    from openpyxl import load_workbook

    try:
        formulas = _has_formulas(data, name)
        with warnings.catch_warnings():  # of styles and charts, which are not read
            warnings.simplefilter("ignore")
            book = load_workbook(io.BytesIO(data), read_only=True, data_only=True)
        sheets = sorted(book.worksheets, key=lambda sheet: sheet.sheet_state != "visible")
        full = {sheet: _rows_of(sheet) for sheet in sheets if wanted in ("", sheet.title)}
        if wanted and not full:
            listed = ", ".join(repr(as_text(sheet.title, 40)) for sheet in sheets[:12])
            raise TableError(
                f"there is no sheet {wanted!r} in {name!r}, which has {listed}", "sheet"
            )
        sheet, *others = [sheet for sheet, rows in full.items() if rows] or full
        rows = full[sheet]
        numbers = (
            cell for cell in chain.from_iterable(sheet.iter_rows()) if isinstance(cell.value, float)
        )
        if any("%" in cell.number_format for cell in numbers):
            notes.append(f"{name}: cells that show a percentage are read as shares, 5 % as 0.05")
        if formulas:
            written = _rows_of(load_workbook(io.BytesIO(data), read_only=True)[sheet.title])
            for k, cells in written.items():
                both = zip_longest(rows.get(k, []), cells, fillvalue="")
                rows[k] = [stored or formula for stored, formula in both]
    except TableError:
        raise
    except Exception as error:
        raise TableError(
            f"{name!r} cannot be read as .xlsx: {type(error).__name__}. Save the sheet as CSV"
        ) from None
    if sheet.sheet_state != "visible" and not wanted:
        notes.append(f"{name}: the hidden sheet {sheet.title!r} is read; the others are empty")
    if others:
        listed = ", ".join(repr(as_text(other.title, 40)) for other in others[:6])
        notes.append(
            f"{name}: the sheet {sheet.title!r} is read; {_OTHER_SHEETS}: {listed} "
            f'(sheet = "{as_text(others[0].title, 40)}")'
        )
    # a row ends with its last cell that is not empty
    width = min(max(map(len, rows.values()), default=0), MOST_COLUMNS)
    return {k: "\t".join(row + [""] * (width + 1 - len(row))) for k, row in rows.items()}


def _has_formulas(data: bytes, name: str) -> bool:
    """Whether some cell of a workbook is a formula; raises TableError where it is too large."""
    from zipfile import ZipFile

    archive = ZipFile(io.BytesIO(data))
    size = sum(part.file_size for part in archive.infolist())
    if size > 8 * LARGEST:
        raise TableError(
            f"{name!r} unpacks to {size >> 20:,} MiB; at most {8 * LARGEST >> 20} MiB are read"
        )
    parts = [part for part in archive.namelist() if part.startswith("xl/worksheets/")]
    content = b"".join(map(archive.read, parts))
    if len(re.findall(rb"<c[ >]|<row", content)) > _MOST_CELLS:
        raise TableError(f"{name!r} has more than {_MOST_CELLS:,} cells. Save the sheet as CSV")
    return bool(re.search(rb"<f[ >]", content))


def _rows_of(sheet: Any) -> dict[int, list[str]]:
    """The cells of a sheet by the numbers of their rows, without empty rows."""
    sheet.reset_dimensions()  # what a file says of its size may be wrong
    rows = enumerate(sheet.iter_rows(values_only=True), 1)
    return {k: [*map(_cell_text, row)] for k, row in rows if {*row} - {None}}


def _cell_text(cell: object) -> str:
    """A cell as it is shown, on one line and in quotes where it has some: Excel may keep
    7.4199999999999999 of 7.42.
    """
    if isinstance(cell, float):
        return str(int(cell)) if cell.is_integer() else f"{cell:.12g}"
    if cell is None:
        return ""
    text = " ".join(str(cell).split())
    if '"' in text:
        text = f'"{text.replace(chr(34), 2 * chr(34))}"'
    return text
