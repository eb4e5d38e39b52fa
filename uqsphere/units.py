"""Units, the nomenclature entry of a number, and the parsing of values with their unit.

All values inside the code are in SI.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from uqsphere.arrays import Values


class UnitError(ValueError):
    """A text is not a number with a unit of the required dimension."""


_G: Final = 9.80665  # standard gravity [m/s²]
_LBF: Final = 0.45359237 * _G
#: dimension -> unit -> factor to SI; the first unit of each dimension is the SI unit
UNITS: Final[dict[str, dict[str, float]]] = {
    "length": {
        "m": 1.0,
        "cm": 1e-2,
        "mm": 1e-3,
        "um": 1e-6,
        "µm": 1e-6,
        "μm": 1e-6,
        "in": 0.0254,
        "ft": 0.3048,
    },
    "time": {
        "s": 1.0,
        "ms": 1e-3,
        "us": 1e-6,
        "µs": 1e-6,
        "μs": 1e-6,
        "ns": 1e-9,
        "min": 60.0,
        "h": 3600.0,
    },
    "speed": {
        "m/s": 1.0,
        "mm/s": 1e-3,
        "cm/s": 1e-2,
        "um/s": 1e-6,
        "km/h": 1.0 / 3.6,
        "mm/min": 1e-3 / 60.0,
        "ft/s": 0.3048,
    },
    "pressure": {
        "Pa": 1.0,
        "kPa": 1e3,
        "MPa": 1e6,
        "GPa": 1e9,
        "TPa": 1e12,
        "psi": 6894.757293168361,
        "bar": 1e5,
        "N/mm2": 1e6,
    },
    "density": {
        "kg/m3": 1.0,
        "kg/m^3": 1.0,
        "kg/m³": 1.0,
        "g/cm3": 1e3,
        "g/cm^3": 1e3,
        "g/cm³": 1e3,
        "t/m3": 1e3,
        "t/m^3": 1e3,
        "t/m³": 1e3,
    },
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "MN": 1e6, "kgf": _G, "tf": 1e3 * _G, "lbf": _LBF},
    "energy": {"J": 1.0, "mJ": 1e-3, "uJ": 1e-6, "kJ": 1e3},
    "specific_energy": {"J/kg": 1.0, "mJ/kg": 1e-3, "kJ/kg": 1e3, "kWh/t": 3600.0, "J/g": 1e3},
    "mass_per_energy": {"kg/J": 1.0, "kg/kJ": 1e-3, "t/kWh": 1.0 / 3600.0},
    "share": {"1": 1.0, "%": 0.01},
    "loading_rate": {
        "N/s": 1.0,
        "kN/s": 1e3,
        "MN/s": 1e6,
        "GN/s": 1e9,
        "kN/ms": 1e6,
        "N/us": 1e6,
        "kN/min": 1e3 / 60.0,
        "N/min": 1.0 / 60.0,
    },
    "toughness": {"Pa.sqrt(m)": 1.0, "kPa.sqrt(m)": 1e3, "MPa.sqrt(m)": 1e6, "MPa·√m": 1e6},
    "volume": {"m3": 1.0, "cm3": 1e-6, "mm3": 1e-9},
    "area": {"m2": 1.0, "cm2": 1e-4, "mm2": 1e-6},
    "strain_rate": {"1/s": 1.0},
    "mass": {"kg": 1.0, "g": 1e-3, "mg": 1e-6, "t": 1e3, "lb": 0.45359237},
    "angle": {"rad": 1.0, "deg": math.pi / 180.0, "°": math.pi / 180.0},
    "stiffness": {"N/m": 1.0, "N/um": 1e6, "kN/mm": 1e6, "MN/m": 1e6},
    "strain": {
        "1": 1.0,
        "%": 0.01,
        "mm/m": 1e-3,
        "microstrain": 1e-6,
        "um/m": 1e-6,
        "µm/m": 1e-6,
        "με": 1e-6,
    },
    "voltage": {"V": 1.0, "mV": 1e-3, "uV": 1e-6, "kV": 1e3},
    "number": {"": 1.0},
}

#: other spellings of units, in small letters, and the units that they may mean
_MISSPELLED: Final = {
    "lbs": "lb lbf",
    "lb": "lbf",
    "pounds": "lb lbf",
    "kg": "kgf",
    "t": "tf",
    "newton": "N",
    "newtons": "N",
    "kilonewton": "kN",
    "inch": "in",
    "inches": "in",
    "micron": "um",
    "microns": "um",
    "sec": "s",
    "seconds": "s",
    "msec": "ms",
    "usec": "us",
    "m/sec": "m/s",
    "mps": "m/s",
    "kph": "km/h",
    "kmh": "km/h",
    "g/cc": "g/cm3",
    "n/m2": "Pa",
    "kn/mm2": "GPa",
    "kn/m2": "kPa",
    "degrees": "deg",
    "joule": "J",
    "joules": "J",
    "volts": "V",
}
_SUPERSCRIPTS: Final = str.maketrans("²³", "23", "^* ")
#: a number, with single underscores between digits as in TOML
_NUMBER: Final = re.compile(
    r"[+-]?(?:\d(?:_?\d)*\.?(?:\d(?:_?\d)*)?|\.\d(?:_?\d)*)(?:[eE][+-]?\d+)?", re.ASCII
)
#: tip speed of a rotor: revolutions per minute, and diameter
_ROTOR: Final = re.compile(r"(.+?)\s*rpm\s*(?:at|@|x)\s*(.+)")
#: what stands between two numbers: 40-60 GPa, 52 ± 3 GPa, 40 to 60 GPa
_RANGE: Final = re.compile(r"[^\W\d]*\s*(?:[-–—…]|±|\+/?-|\.\.+|to\b)\s*\d")
_THOUSANDS: Final = re.compile(r"[+-]?\d{1,3}(?:\.\d{3})+,\d*|[+-]?\d{1,3}(?:,\d{3})+\.\d*")


@dataclass(frozen=True, kw_only=True)
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
    needs : columns that `formula` reads.
    formula : function of columns (scene, scale factors, integrator, other quantities) that returns
        the quantity, (n,).
    """

    name: str
    symbol: str
    dimension: str
    meaning: str
    display: str = ""
    lower: float = 0.0
    upper: float = math.inf
    plausible: tuple[float, float] = (0.0, math.inf)
    closed: bool = False
    follows: str = ""
    fracture: bool = False
    early: bool = False
    place: str = ""
    censored: str = ""
    needs: tuple[str, ...] = ()
    formula: Callable[[Mapping[str, Values]], Values] | None = None

    @property
    def unit(self) -> str:
        """The SI unit of the quantity."""
        return next(iter(UNITS[self.dimension]))

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
    with_unit, such = " with a unit", f'"1.5 {example}"'
    if dimension == "number":
        with_unit, such = "", "0.25"
    if isinstance(text, bool) or not isinstance(text, (int, float, str)):
        names: dict[type, str] = {
            bool: "a boolean",
            list: "an array",
            dict: "a table",
            type(None): "nothing",
        }
        kind = names.get(type(text), f"a {type(text).__name__}")
        raise UnitError(f"must be a number{with_unit}, not {kind}")
    if isinstance(text, (int, float)):
        if dimension != "number":
            bare = bare_number(text)
            raise UnitError(
                f'{bare} has no unit. Write it as a text, such as "{bare} {example}" (units: '
                f"{allowed})"
            )
        return _finite(text, repr(text))
    stripped = text.strip()
    if dimension == "speed" and (rotor := _ROTOR.fullmatch(stripped)):
        turns, diameter = parse_value(rotor[1], "number"), parse_value(rotor[2], "length", "m")
        return math.pi * diameter * turns / 60.0
    if mark := _THOUSANDS.match(stripped):
        number = mark[0].replace(",", "")
        if "," in mark[0][-4:]:
            number = mark[0].replace(".", "").replace(",", ".")
        raise UnitError(
            f'{text!r} has a thousands separator. Write "{number}{stripped[mark.end() :]}"'
        )
    match = _NUMBER.match(stripped)
    if match is None:
        raise UnitError(f"{text!r} is not a number{with_unit}. Write, for example, {such}")
    number, unit = match.group(), stripped[match.end() :].strip()
    if _RANGE.match(unit):
        raise UnitError(
            f'{text!r} is a range. Write a distribution, such as {{ dist = "uniform", lower = …, '
            "upper = … }"
        )
    if unit.startswith(",") and unit[1:2].isdigit():
        raise UnitError(f'{text!r} has a decimal comma. Write "{stripped.replace(",", ".", 1)}"')
    if dimension == "number":
        if unit not in ("", "%"):
            raise UnitError(f"must be a plain number, without the unit {unit!r}, not {text!r}")
        return _finite(float(number) * (0.01 if unit else 1.0), text)
    if unit not in table:
        if not unit:
            raise UnitError(f'{text!r} has no unit. Write "{number} {example}" (units: {allowed})')
        if unit == "rpm" and dimension == "speed":
            raise UnitError(
                f'{text!r}: a tip speed needs the rotor\'s diameter. Write "{number} rpm at 0.9 m"'
            )
        near = nearest_unit(unit, dimension)
        hint = f'; did you mean "{number} {near}"?' if near else ""
        raise UnitError(
            f"unknown unit {unit!r} for a {dimension.replace('_', ' ')}{hint} (units: {allowed})"
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
    for spelled in (plain, *_MISSPELLED.get(plain.lower(), "").split()):
        if spelled and spelled in UNITS[dimension]:
            return spelled
    near = [unit for unit in UNITS[dimension] if unit and unit.lower() == plain.lower()]
    if len(near) != 1:
        return ""
    prefix, stem = near[0][0], near[0][1:]
    if prefix in "mM" and stem[:1].isalpha() and stem == plain[1:]:
        return ""  # another power of ten
    return near[0]


def likely_unit(raw: Any, quantity: Quantity) -> str:
    """Unit to suggest for a number without one: the display unit, or the first plausible one."""
    try:
        bare = float(raw)
    except (TypeError, ValueError, OverflowError):
        return quantity.display
    (low, high), factors = quantity.plausible, UNITS[quantity.dimension]
    for unit in (quantity.display, *factors):
        if low <= bare * factors.get(unit, 1.0) <= high:
            return unit
    return quantity.display


def bare_number(value: float) -> str:
    """A number as people type it.

    >>> bare_number(52000000000.0), bare_number(0.5), bare_number(40)
    ('52e9', '0.5', '40')
    """
    if isinstance(value, float):
        for power in (12, 9, 6):
            if 10.0**power <= abs(value) < 1e15:
                text = f"{value / 10.0**power:.15g}e{power}"
                if float(text) == value:
                    return text
    return repr(value).removesuffix(".0")


def _finite(value: float, text: str) -> float:
    try:
        value = float(value)
    except OverflowError:
        raise UnitError(f"{text} is too large for a floating-point number") from None
    if not math.isfinite(value):
        raise UnitError(f"{text} is not a finite number")
    return value
