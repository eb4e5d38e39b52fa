"""Units, the nomenclature entry of a number, and the parsing of values with their unit.

All values inside the code are in SI.
"""

import json
import math
import re
import unicodedata
from collections.abc import Mapping
from typing import Any

from uqsphere.arrays import Duo, Names, Values, frozen
from uqsphere.errors import Fault, as_text
from uqsphere.files import packaged


class UnitError(Fault):
    """A text is not a number with a unit of the required dimension."""


_TABLES = packaged("units.toml")
#: dimension -> unit -> factor to SI; the first unit of each dimension is the SI unit
UNITS: dict[str, dict[str, float]] = _TABLES["units"]
#: other spellings of units in headings, and of units that were likely meant, in small letters
SPELLED: dict[str, str] = _TABLES["headings"]
_MEANT: dict[str, list[str]] = _TABLES["meant"]

#: what stands in units, and between numbers, beside ASCII
_TYPED = "µμ°²³√·ε±–—…×¡"
_SUPERSCRIPTS = str.maketrans("²³", "23", "^* ")
#: a number, with single underscores between digits as in TOML
_NUMBER = re.compile(
    r"[+-]?(?:\d(?:_?\d)*\.?(?:\d(?:_?\d)*)?|\.\d(?:_?\d)*)(?:[eE][+-]?\d+)?", re.ASCII
)
#: tip speed of a rotor: revolutions per minute, and diameter
_ROTOR = re.compile(r"(.+?)\s*rpm\s*(?:at|@|x)\s*(.+)")
#: what stands between two numbers: 40-60 GPa, 52 ± 3 GPa, 40 to 60 GPa
_RANGE = re.compile(r"[^\W\d]*\s*(?:[-–—…]|±|\+/?-|\.\.+|to\b)\s*\d")
#: 1.234,5 and 1,234.5, with the mark of thousands as a group
_THOUSANDS = re.compile(r"[+-]?\d{1,3}([.,])\d{3}(?:\1\d{3})*(?!\1)[.,]\d*")


@frozen
class Quantity:
    """One entry of the nomenclature: an input, or a quantity of interest.

    meaning : its name, and after a colon what it is made of.
    dimension : a key of `UNITS`.
    display : the unit that people read; all values inside the code are SI.
    lower, upper : bounds of valid values, exclusive unless `closed`.
    plausible : (low, high); a value outside gets a warning.
    follows : `force` or `energy` if it increases with the peak force or energy so far; else empty.
    fracture : whether its exceedance can mean that the sphere breaks.
    early : whether only the time before the first reflected wave counts.
    place : part of the sphere that it loads: `contact`, the contact `rim`, the `core`, the region
        `below` a contact; else empty.  Demands on contact and rim decrease where the bars yield,
        since the contact circle widens; those on the core and below a contact are computed for
        equal forces at both contacts.
    censored : column of rows whose evaluation window ended too early; empty if there is none.
    needs : columns that it is computed from.
    """

    name: str
    meaning: str
    symbol: str = ""
    dimension: str = "number"
    display: str = ""
    lower: float = 0.0
    upper: float = math.inf
    plausible: Duo = (0.0, math.inf)
    closed: bool = False
    follows: str = ""
    fracture: bool = False
    early: bool = False
    place: str = ""
    censored: str = ""
    needs: Names = ()

    @property
    def unit(self) -> str:
        """The SI unit of the quantity."""
        return next(iter(UNITS[self.dimension]))

    @property
    def called(self) -> str:
        """Its name, without what it is made of."""
        return self.meaning.partition(":")[0]

    def allows(self, value: Values) -> Values:
        """Whether each value [SI] is within the bounds."""
        if self.closed:
            return (self.lower <= value) & (value <= self.upper)
        return (self.lower < value) & (value < self.upper)


def typed_units(dimension: str) -> str:
    """Units of a dimension that can be typed on every keyboard."""
    return ", ".join(unit for unit in UNITS[dimension] if unit.isascii() and "^" not in unit)


def parse_value(text: object, dimension: str, example: str = "") -> float:
    """SI value of a number with a unit.

    A dimensional value must be a string such as ``"25 mm"``.  Only a dimensionless quantity may be
    a plain number, or ``"15 %"``.  A speed may be a rotor's tip speed, ``"1450 rpm at 0.9 m"``.
    No expression is evaluated.  Messages suggest the unit `example` (default: SI).

    Raises UnitError with the allowed form and the correction.

    >>> parse_value("25 mm", "length"), parse_value("15 %", "number"), parse_value("2 tf", "force")
    (0.025, 0.15, 19613.3)
    >>> round(parse_value("1450 rpm at 0.9 m", "speed"), 3)
    68.33
    >>> parse_value(25, "length", "mm")
    Traceback (most recent call last):
    ...
    uqsphere.units.UnitError: 25 has no unit. Write it as a text, such as "25 mm" (units: m, cm,
    mm, um, in, ft)
    """
    table = UNITS[dimension]
    example = example or next(iter(table))
    allowed = typed_units(dimension)
    with_unit = " with a unit"
    such = f'"1.5 {example}"'
    if dimension == "number":
        table = {"": 1.0, "%": 0.01}
        with_unit = ""
        such = "0.25"
    if isinstance(text, bool) or not isinstance(text, int | float | str):
        raise UnitError(f"must be a number{with_unit}, not {shown(text)}")
    if not isinstance(text, str):
        if dimension != "number":
            bare = bare_number(text)
            raise UnitError(
                f'{bare} has no unit. Write it as a text, such as "{bare} {example}" (units: '
                f"{allowed})"
            )
        return _finite(text, repr(text))
    stripped = text.strip().replace("\N{MINUS SIGN}", "-")
    if dimension == "speed" and (rotor := _ROTOR.fullmatch(stripped)):
        turns = parse_value(rotor[1], "number")
        diameter = parse_value(rotor[2], "length", "m")
        return math.pi * diameter * turns / 60.0
    if mark := _THOUSANDS.match(stripped):
        number = mark[0].replace(mark[1], "").replace(",", ".")
        raise UnitError(
            f'{text!r} has a thousands separator. Write "{number}{stripped[mark.end() :]}"'
        )
    match = _NUMBER.match(stripped)
    if not match:
        raise UnitError(
            f"{text!r} is not a number{with_unit}{alien(text)}. Write, for example, {such}"
        )
    number = match[0]
    unit = stripped[match.end() :].strip()
    if _RANGE.match(unit):
        raise UnitError(
            f'{text!r} is a range. Write a distribution, such as {{ dist = "uniform", lower = …, '
            "upper = … }"
        )
    if re.match(r",\d", unit):
        raise UnitError(f'{text!r} has a decimal comma. Write "{stripped.replace(",", ".", 1)}"')
    if unit not in table:
        if dimension == "number":
            raise UnitError(f"must be a plain number, without the unit {unit!r}, not {text!r}")
        if not unit:
            raise UnitError(f'{text!r} has no unit. Write "{number} {example}" (units: {allowed})')
        if unit == "rpm" and dimension == "speed":
            raise UnitError(
                f'{text!r}: a tip speed needs the rotor\'s diameter. Write "{number} rpm at 0.9 m"'
            )
        near = nearest_unit(unit, dimension)
        hint = f'; did you mean "{number} {near}"?' if near else ""
        raise UnitError(
            f"unknown unit {unit!r} for a {dimension.replace('_', ' ')}{alien(unit)}{hint} (units: "
            f"{allowed})"
        )
    return _finite(float(number) * table[unit], text)


def nearest_unit(text: str, dimension: str) -> str:
    """The unit of a dimension that a text was likely meant to be; empty without one.

    MJ is never taken for mJ, nor mPa for MPa: only a slip of other letters is.

    >>> [nearest_unit(text, "force") for text in ("KN", "lbs", "kips", "mn")]
    ['kN', 'lbf', '', '']
    >>> nearest_unit("MJ", "energy"), nearest_unit("gpa", "pressure")
    ('', 'GPa')
    """
    plain = text.translate(_SUPERSCRIPTS)
    for spelled in (plain, *_MEANT.get(plain.lower(), [])):
        if spelled and spelled in UNITS[dimension]:
            return spelled
    near = [unit for unit in UNITS[dimension] if unit and unit.lower() == plain.lower()]
    if len(near) != 1:
        return ""
    unit = near[0]
    stem = unit[1:]
    if unit[0] in "mM" and stem[:1].isalpha() and stem == plain[1:]:
        return ""  # another power of ten
    return unit


def alien(text: str) -> str:
    """A remark on a character that is not typed in numbers and units, but may look as if it was.

    >>> alien("5 \N{CYRILLIC SMALL LETTER EM}m")
    '; its character U+043C is CYRILLIC SMALL LETTER EM'
    >>> alien("5 µm")
    ''
    """
    for character in text:
        if not character.isascii() and character not in _TYPED:
            return (
                f"; its character U+{ord(character):04X} is "
                f"{unicodedata.name(character, 'not a letter')}"
            )
    return ""


def likely_unit(raw: Any, quantity: Quantity) -> str:
    """Unit to suggest for a number without one: the display unit, or the first plausible one."""
    try:
        bare = float(raw)
    except (TypeError, ValueError, OverflowError):
        return quantity.display
    low, high = quantity.plausible
    factors = UNITS[quantity.dimension]
    for unit in (quantity.display, *factors):
        if low <= bare * factors.get(unit, 1.0) <= high:
            return unit
    return quantity.display


def bare_number(value: float) -> str:
    """A number as people type it.

    >>> bare_number(52000000000.0), bare_number(0.5), bare_number(40)
    ('52e9', '0.5', '40')
    """
    for power in (12, 9, 6):
        if isinstance(value, float) and 10.0**power <= abs(value) < 1e15:
            text = f"{value / 10.0**power:.15g}e{power}"
            if float(text) == value:
                return text
    return repr(value).removesuffix(".0")


#: larger whole numbers are not written out
_LARGEST_SHOWN = 10**60


def shown(value: object) -> str:
    """A value of a file as its message shows it."""
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, list | tuple):
        return f"an array of {len(value)}"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int) and abs(value) > _LARGEST_SHOWN:
        return f"a whole number of {len(f'{abs(value):x}'):,} hexadecimal digits"
    if isinstance(value, int | float):
        return bare_number(value)
    if isinstance(value, str):
        return json.dumps(as_text(value, 60), ensure_ascii=False)
    return f"a {type(value).__name__}"


def _finite(value: float, text: str) -> float:
    try:
        value = float(value)
    except OverflowError:
        raise UnitError(f"{text} is too large for a floating-point number") from None
    if not math.isfinite(value):
        raise UnitError(f"{text} is not a finite number")
    return value
