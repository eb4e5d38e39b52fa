"""The nomenclature: one table of names, symbols, units, meanings and bounds, and the closed table of units.

The study parser, the result tables, the axis labels and the documentation all read it, so that a
quantity has one name and one unit everywhere.  Inside the code every value is in SI.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, replace
from typing import Final

__all__ = [
    "DEMANDS", "DRIVES", "INPUTS", "OUTPUTS", "UNITS", "Quantity", "UnitError", "bare_number", "display_unit",
    "format_estimate", "format_value", "lookup", "parse_value", "reading_units", "told_apart", "unit_that_reads",
    "units_of",
]  # fmt: skip


class UnitError(ValueError):
    """A text is not a number with a unit of the dimension that is due."""


#: dimension -> unit -> factor to SI.  The first unit of each dimension is the SI unit itself.
UNITS: Final[dict[str, dict[str, float]]] = {
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "in": 0.0254},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "speed": {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "um/s": 1e-6, "km/h": 1.0 / 3.6},
    "pressure": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "TPa": 1e12, "psi": 6894.757293168361},
    "density": {"kg/m3": 1.0, "kg/m^3": 1.0, "kg/m³": 1.0, "g/cm3": 1e3, "g/cm^3": 1e3, "g/cm³": 1e3},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "MN": 1e6},
    "energy": {"J": 1.0, "mJ": 1e-3, "uJ": 1e-6, "kJ": 1e3},
    "specific_energy": {"J/kg": 1.0, "mJ/kg": 1e-3, "kJ/kg": 1e3, "kWh/t": 3600.0},
    "mass_per_energy": {"kg/J": 1.0, "kg/kJ": 1e-3, "t/kWh": 1.0 / 3600.0},
    "share": {"1": 1.0, "%": 0.01},
    "loading_rate": {"N/s": 1.0, "kN/s": 1e3, "MN/s": 1e6, "GN/s": 1e9, "kN/ms": 1e6, "N/us": 1e6},
    "toughness": {"Pa.sqrt(m)": 1.0, "kPa.sqrt(m)": 1e3, "MPa.sqrt(m)": 1e6, "MPa·√m": 1e6},
    "volume": {"m3": 1.0, "cm3": 1e-6, "mm3": 1e-9},
    "area": {"m2": 1.0, "cm2": 1e-4, "mm2": 1e-6},
    "strain_rate": {"1/s": 1.0},
    "number": {"": 1.0},
}

#: units that numbers of a dimension are read in beside the one that is usual for their quantity: SI prefixes alone
_LADDERS: Final[dict[str, tuple[str, ...]]] = {
    "length": ("um", "mm", "m"),
    "time": ("ns", "us", "ms", "s"),
    "speed": ("um/s", "mm/s", "m/s"),
    "pressure": ("Pa", "kPa", "MPa", "GPa"),
    "force": ("mN", "N", "kN", "MN"),
    "energy": ("uJ", "mJ", "J", "kJ"),
    "specific_energy": ("mJ/kg", "J/kg", "kJ/kg"),
    "loading_rate": ("N/s", "kN/s", "MN/s", "GN/s"),
    "toughness": ("Pa.sqrt(m)", "kPa.sqrt(m)", "MPa.sqrt(m)"),
}
#: the units of the page or the table that is being written, by the name of the quantity
_CHOSEN: Final[ContextVar[Mapping[str, str]]] = ContextVar("units_of_the_page")

#: single underscores between digits, as TOML has them
_NUMBER = re.compile(r"[+-]?(?:\d(?:_?\d)*\.?(?:\d(?:_?\d)*)?|\.\d(?:_?\d)*)(?:[eE][+-]?\d+)?", re.ASCII)


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """One entry of the nomenclature.

    `lower` and `upper` bound what has a meaning at all (open ends: the bound itself is refused);
    `plausible` is the range outside which a value is worth a second look; `display` is the unit
    that people read, all values inside the code being SI.
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

    @property
    def unit(self) -> str:
        """The SI unit of the quantity."""
        return next(iter(UNITS[self.dimension]))

    @property
    def label(self) -> str:
        """Axis label in the display unit, without the meaning: ``p_max [GPa]``."""
        return f"{self.symbol} [{self.display}]" if self.display else self.symbol

    def allows(self, value: float) -> bool:
        """Whether `value` (SI) lies inside the bounds of meaning."""
        if self.closed:
            return self.lower <= value <= self.upper
        return self.lower < value < self.upper


def _table(*rows: Quantity) -> dict[str, Quantity]:
    return {row.name: row for row in rows}


#: Every number of a scene that a study can fix or scatter, by its dotted path in the study file.
INPUTS: Final[dict[str, Quantity]] = _table(
    Quantity(name="sphere.E", symbol="E", dimension="pressure", display="GPa", plausible=(1e9, 6e11),
             meaning="Young's modulus of the sphere"),
    Quantity(name="sphere.nu", symbol="nu", dimension="number", lower=-1.0, upper=0.5, plausible=(0.05, 0.45),
             meaning="Poisson ratio of the sphere"),
    Quantity(name="sphere.radius", symbol="r", dimension="length", display="mm", plausible=(1e-4, 0.1),
             meaning="radius of the sphere"),
    Quantity(name="sphere.density", symbol="rho", dimension="density", display="kg/m3", plausible=(500.0, 2e4),
             meaning="density of the sphere"),
    Quantity(name="bars.E", symbol="E_b", dimension="pressure", display="GPa", plausible=(1e9, 6e11),
             meaning="Young's modulus of the bars"),
    Quantity(name="bars.nu", symbol="nu_b", dimension="number", lower=-1.0, upper=0.5, plausible=(0.05, 0.45),
             meaning="Poisson ratio of the bars"),
    Quantity(name="bars.density", symbol="rho_b", dimension="density", display="kg/m3", plausible=(500.0, 2e4),
             meaning="density of the bars"),
    Quantity(name="bars.diameter", symbol="d_b", dimension="length", display="mm", plausible=(1e-3, 0.2),
             meaning="diameter of both bars"),
    Quantity(name="bars.incident_length", symbol="l_1", dimension="length", display="m", plausible=(0.05, 30.0),
             meaning="length of the incident bar"),
    Quantity(name="bars.receiving_length", symbol="l_3", dimension="length", display="m", plausible=(0.05, 30.0),
             meaning="length of the receiving bar"),
    Quantity(name="bars.incident_end", symbol="R_1", dimension="number", lower=-1.0, upper=1.0, closed=True,
             plausible=(-1.0, 1.0), meaning="velocity reflection coefficient of the incident bar's far end"),
    Quantity(name="bars.receiving_end", symbol="R_3", dimension="number", lower=-1.0, upper=1.0, closed=True,
             plausible=(-1.0, 1.0), meaning="velocity reflection coefficient of the receiving bar's far end"),
    Quantity(name="bars.end_radius", symbol="r_end", dimension="length", display="mm", plausible=(1e-3, 1e3),
             meaning="radius of rounded bar ends (flat ends: absent)"),
    Quantity(name="bars.yield_strength", symbol="Y_b", dimension="pressure", display="MPa", plausible=(1e7, 5e9),
             meaning="yield strength of the bars"),
    Quantity(name="striker.speed", symbol="v_0", dimension="speed", display="m/s", plausible=(1e-3, 50.0),
             meaning="speed of the striker"),
    Quantity(name="striker.length", symbol="l_0", dimension="length", display="m", plausible=(0.01, 5.0),
             meaning="length of the striker"),
    Quantity(name="striker.E", symbol="E_s", dimension="pressure", display="GPa", plausible=(1e9, 6e11),
             meaning="Young's modulus of the striker (absent: that of the bars)"),
    Quantity(name="striker.density", symbol="rho_s", dimension="density", display="kg/m3", plausible=(500.0, 2e4),
             meaning="density of the striker (absent: that of the bars)"),
    Quantity(name="striker.diameter", symbol="d_s", dimension="length", display="mm", plausible=(1e-3, 0.2),
             meaning="diameter of the striker (absent: that of the bars)"),
    Quantity(name="pulse.duration", symbol="t_i", dimension="time", display="us", plausible=(1e-6, 1e-2),
             meaning="duration of the pulse (at half height for a trapezoid)"),
    Quantity(name="pulse.rise", symbol="t_rise", dimension="time", display="us", closed=True, plausible=(0.0, 1e-3),
             meaning="rise of a trapezoidal pulse"),
    Quantity(name="pulse.fall", symbol="t_fall", dimension="time", display="us", closed=True, plausible=(0.0, 1e-3),
             meaning="fall of a trapezoidal pulse"),
    Quantity(name="pulse.t1", symbol="t_1", dimension="time", display="us", plausible=(1e-6, 1e-2),
             meaning="time of the first peak of a two-peak pulse"),
    Quantity(name="pulse.level1", symbol="g_1", dimension="number", plausible=(0.1, 2.0),
             meaning="level of the first peak over v_0/2"),
    Quantity(name="pulse.t2", symbol="t_2", dimension="time", display="us", plausible=(1e-6, 1e-2),
             meaning="time of the second peak of a two-peak pulse"),
    Quantity(name="pulse.level2", symbol="g_2", dimension="number", plausible=(0.1, 2.0),
             meaning="level of the second peak over v_0/2"),
    Quantity(name="pulse.valley", symbol="g_v", dimension="number", plausible=(0.0, 2.0), closed=True,
             meaning="level half-way between the peaks of a two-peak pulse"),
    Quantity(name="pulse.gain", symbol="G", dimension="number", plausible=(0.5, 2.0),
             meaning="true strain over that of a measured pulse"),
    Quantity(name="product.A", symbol="A", dimension="share", display="%", lower=1e-3, upper=1.0, closed=True,
             plausible=(0.2, 1.0), meaning="largest product fineness t10"),
    Quantity(name="product.b", symbol="b", dimension="mass_per_energy", display="t/kWh",
             plausible=(0.1 / 3600.0, 10.0 / 3600.0), meaning="how fast the product fineness rises with the energy"),
    *(Quantity(name=f"pulse.noise_{j}", symbol=f"xi_{j}", dimension="number", lower=-math.inf, plausible=(-8.0, 8.0),
               meaning=f"noise of a measured pulse, mode {j}, over its standard deviation") for j in range(1, 7)),
)  # fmt: skip

#: Every quantity of interest that the impact model answers.
OUTPUTS: Final[dict[str, Quantity]] = _table(
    Quantity(name="p_max", symbol="p_max", dimension="pressure", display="GPa",
             meaning="largest contact pressure at either face"),
    Quantity(name="P_max", symbol="P_max", dimension="force", display="kN",
             meaning="largest contact force at either face"),
    Quantity(name="alpha_max", symbol="alpha_max", dimension="length", display="um",
             meaning="approach of sphere and bar at the largest force"),
    Quantity(name="a_max", symbol="a_max", dimension="length", display="mm",
             meaning="radius of the contact circle at the largest force"),
    Quantity(name="contact_time", symbol="t_contact", dimension="time", display="us",
             meaning="time from first touch to the first loss of contact at either face"),
    Quantity(name="pulse_width", symbol="t_width", dimension="time", display="us",
             meaning="time between the first and the last crossing of half the largest force"),
    Quantity(name="rise_time", symbol="t_rise", dimension="time", display="us",
             meaning="time between the first crossings of 10 % and 90 % of the largest force"),
    Quantity(name="loading_rate", symbol="dP/dt", dimension="loading_rate", display="MN/s",
             meaning="mean loading rate, 0.8 P_max over the rise time"),
    Quantity(name="first_peak", symbol="p_first", dimension="pressure", display="GPa",
             meaning="largest contact pressure before the first reflected wave returns"),
    Quantity(name="force_imbalance", symbol="|P_A-P_B|/P_max", dimension="number",
             meaning="largest difference of the two contact forces over the largest force"),
    Quantity(name="energy", symbol="W", dimension="energy", display="J",
             meaning="largest elastic energy stored in both contacts"),
    Quantity(name="specific_energy", symbol="W/M", dimension="specific_energy", display="J/kg",
             meaning="largest elastic energy stored in both contacts, per mass of the sphere"),
    Quantity(name="t10", symbol="t10", dimension="share", display="%", upper=1.0,
             meaning="share of the product finer than a tenth of the sphere, if it breaks (needs [product])"),
    Quantity(name="edge_tension", symbol="sigma_e", dimension="pressure", display="GPa",
             meaning="largest radial tension at the rim of the contact"),
    Quantity(name="centre_tension", symbol="sigma_c", dimension="pressure", display="MPa",
             meaning="tension at the centre of the sphere at the largest force"),
    Quantity(name="core_tension", symbol="sigma_core", dimension="pressure", display="MPa",
             meaning="largest hoop tension on the axis inside the sphere"),
    Quantity(name="equatorial_tension", symbol="sigma_eq", dimension="pressure", display="MPa",
             meaning="hoop tension on the sphere's surface half-way between the contacts"),
    Quantity(name="hiramatsu_oka_tension", symbol="sigma_HO", dimension="pressure", display="MPa",
             meaning="tensile stress 0.9 P/D² that lumps of rock are credited with in practice"),
    Quantity(name="subsurface_shear", symbol="tau_max", dimension="pressure", display="MPa",
             meaning="largest shear stress on the axis, below the contact"),
    Quantity(name="ring_crack_toughness", symbol="K_ring", dimension="toughness", display="MPa.sqrt(m)",
             meaning="fracture toughness at which a ring crack just grows into a cone"),
)  # fmt: skip


#: Demands of criteria with parameters, by the criterion; a study adds the limit's name, ``weakest_link_volume.NAME``.
DEMANDS: Final[dict[str, Quantity]] = _table(
    Quantity(name="weakest_link_volume", symbol="sigma_V", dimension="pressure", display="MPa",
             meaning="uniform tension in the reference volume that is as dangerous as the hoop tension in the sphere"),
    Quantity(name="weakest_link_surface", symbol="sigma_S", dimension="pressure", display="MPa",
             meaning="uniform tension in the reference area that is as dangerous as that in the sphere's surface"),
    Quantity(name="weakest_link_rim", symbol="sigma_rim", dimension="pressure", display="MPa",
             meaning="uniform tension in the reference area that is as dangerous as that around the contacts"),
    Quantity(name="core_tension", symbol="sigma_core", dimension="pressure", display="MPa",
             meaning="largest hoop tension on the axis over the increase of strength by its rate"),
    Quantity(name="centre_tension", symbol="sigma_c", dimension="pressure", display="MPa",
             meaning="tension at the centre over the increase of strength by its rate"),
    Quantity(name="equatorial_tension", symbol="sigma_eq", dimension="pressure", display="MPa",
             meaning="hoop tension at the equator over the increase of strength by its rate"),
    Quantity(name="hiramatsu_oka", symbol="sigma_HO", dimension="pressure", display="MPa",
             meaning="0.9 P/D² over the increase of strength by its rate"),
    Quantity(name="specific_energy", symbol="E'", dimension="specific_energy", display="J/kg",
             meaning="specific energy, stretched so that a bounded fracture energy becomes lognormal"),
)  # fmt: skip


#: Free scalars of margins that are no numbers of the file.
DRIVES: Final[dict[str, Quantity]] = _table(
    Quantity(name="striker.specific_energy", symbol="E_k/M", dimension="specific_energy", display="J/kg",
             meaning="kinetic energy of the striker over the mass of the sphere"),
)  # fmt: skip


def lookup(name: str) -> Quantity:
    """The nomenclature entry of an input or an output; a black-box name gets a plain entry without unit."""
    found = INPUTS.get(name) or OUTPUTS.get(name) or DRIVES.get(name)
    if found is None and (base := name.partition(".")[0]) in DEMANDS:
        # the demand of a criterion goes by the names of criterion and limit
        return replace(DEMANDS[base], name=name)
    return found or Quantity(name=name, symbol=name, dimension="number", lower=-math.inf, meaning=name)


def units_of(dimension: str) -> list[str]:
    """The units that are understood for a dimension, SI first."""
    return list(UNITS[dimension])


def parse_value(text: object, dimension: str, example: str = "") -> float:
    """Number with unit → SI value.

    A dimensional value must be a string such as ``"25 mm"``; a plain number is taken for a dimensionless quantity
    only.  No expression is evaluated.  A message shows the unit `example`, SI without one.

    Raises
    ------
    UnitError
        With what was found, what is allowed, and the fix.

    >>> parse_value("25 mm", "length")
    0.025
    >>> parse_value(25, "length", "mm")
    Traceback (most recent call last):
    ...
    uqsphere.quantities.UnitError: 25 has no unit: write it as a string, such as "25 mm" (units: m, cm, mm, um, in)
    """
    table = UNITS[dimension]
    example = example or next(iter(table))
    allowed = ", ".join(unit for unit in table if unit.isascii() and "^" not in unit)
    if isinstance(text, bool) or not isinstance(text, (int, float, str)):
        names: dict[type, str] = {bool: "a boolean", list: "an array", dict: "a table", type(None): "nothing"}
        kind = names.get(type(text), f"a {type(text).__name__}")
        raise UnitError(f"expected a number{'' if dimension == 'number' else ' with a unit'}, found {kind}")
    if isinstance(text, (int, float)):
        if dimension != "number":
            bare = bare_number(text)
            raise UnitError(f'{bare} has no unit: write it as a string, such as "{bare} {example}" (units: {allowed})')
        return _finite(text, repr(text))
    stripped = text.strip()
    match = _NUMBER.match(stripped)
    if match is None:
        such = "0.25" if dimension == "number" else f'"1.5 {example}"'
        raise UnitError(f"{text!r} is not a number{'' if dimension == 'number' else ' with a unit'}, such as {such}")
    number, unit = match.group(), stripped[match.end() :].strip()
    if dimension == "number":
        if unit:
            raise UnitError(f"{text!r}: a plain number is due here, without a unit (found {unit!r})")
        return _finite(float(number), text)
    if unit not in table:
        if not unit:
            raise UnitError(f'{text!r} has no unit: write "{number} {example}" (units: {allowed})')
        raise UnitError(f"unknown unit {unit!r} for a {dimension.replace('_', ' ')} (units: {allowed})")
    return _finite(float(number) * table[unit], text)


def bare_number(value: float) -> str:
    """A number as people type it.

    >>> bare_number(52000000000.0), bare_number(0.5), bare_number(40)
    ('52e9', '0.5', '40')
    """
    power = next((p for p in (12, 9, 6) if isinstance(value, float) and 10.0**p <= abs(value) < 1e15), 0)
    text = f"{value / 10.0**power:.15g}e{power}" if power else ""
    return text if text and float(text) == value else repr(value).removesuffix(".0")


def _finite(value: float, text: str) -> float:
    try:
        value = float(value)
    except OverflowError:
        raise UnitError(f"{text} is too large for a floating-point number") from None
    if not math.isfinite(value):
        raise UnitError(f"{text} is not a finite number")
    return value


def display_unit(name: str) -> tuple[str, float]:
    """The unit people read for a quantity, and the factor that turns an SI value into it."""
    quantity = lookup(name)
    unit = _CHOSEN.get({}).get(name) or quantity.display or quantity.unit
    return unit, 1.0 / UNITS[quantity.dimension].get(unit, 1.0)


@contextlib.contextmanager
def reading_units(units: Mapping[str, str]) -> Iterator[None]:
    """Other units for people inside the block, by name of quantity: all that is written there then agrees.

    >>> with reading_units({"P_max": "N"}):
    ...     format_value(32.0, "P_max")
    '32 N'
    """
    token = _CHOSEN.set({**_CHOSEN.get({}), **units})
    try:
        yield
    finally:
        _CHOSEN.reset(token)


def unit_that_reads(name: str, values: Sequence[float]) -> str:
    """The unit in which a group of values (SI) of one quantity has the fewest zeros and digits before its point.

    The usual unit stays unless another SI prefix is better: 0.1 to 10 000 counts as readable.

    >>> unit_that_reads("P_max", [32.0, 41.0]), unit_that_reads("P_max", [320.0]), unit_that_reads("p_max", [5e5])
    ('N', 'kN', 'kPa')
    """
    quantity = lookup(name)
    usual = quantity.display or quantity.unit
    sizes = [math.log10(abs(v)) for v in values if v and math.isfinite(v)]
    ladder = _LADDERS.get(quantity.dimension, ())
    if not sizes or usual not in ladder:
        return usual

    def clumsy(unit: str) -> int:
        exponents = [math.floor(size - math.log10(UNITS[quantity.dimension][unit]) + 1e-9) for size in sizes]
        return sum(max(-1 - e, 0) + max(e - 3, 0) for e in exponents)

    def tall(unit: str) -> float:
        # of units that read alike the one with one to three digits before the point
        return abs(max(sizes) - math.log10(UNITS[quantity.dimension][unit]) - 1.5)

    return min(ladder, key=lambda unit: (clumsy(unit), unit != usual, tall(unit)))


def format_value(value: float, name: str, digits: int = 4) -> str:
    """`value` (SI) of the named quantity for people, in its display unit, to `digits` significant digits.

    >>> format_value(2.5541e9, "p_max")
    '2.554 GPa'
    """
    unit, factor = display_unit(name)
    return f"{value * factor:.{digits}g} {unit}".rstrip()


def told_apart(value: float, bound: float) -> str:
    """`value` to two significant digits, or to as many as tell it from `bound` as that is written."""
    return next((t for n in range(2, 18) if float(t := f"{value:.{n}g}") != float(f"{bound:g}")), f"{value:.2g}")


def format_estimate(value: float, low: float, high: float, name: str = "", most: int = 15) -> str:
    """``value (low to high) unit``, every number rounded to what the interval supports.

    The half-width keeps two significant digits, the value the same decimal and at most `most` digits; where that would
    round the value away, an interval that is far longer to one side has the digits of its shorter one.

    >>> format_estimate(2.55412e9, 2.5502e9, 2.5581e9, "p_max")
    '2.5541 (2.5502 to 2.5581) GPa'
    """
    unit, factor = display_unit(name) if name else ("", 1.0)
    scaled = [number * factor for number in (value, low, high)]
    if low == high:
        return f"{scaled[0]:.6g} {unit}".rstrip()
    if not all(map(math.isfinite, scaled)):  # a difference of numbers near the largest there are
        return f"{scaled[0]:.6g} ({scaled[1]:.6g} to {scaled[2]:.6g}) {unit}".rstrip()
    half_width = 0.5 * abs(scaled[2] - scaled[1])
    if half_width > 0.0 and math.isfinite(half_width):
        decimals = 1 - math.floor(math.log10(half_width))
        nearer = min(scaled[0] - scaled[1], scaled[2] - scaled[0])
        if 1e-3 < nearer / half_width < 0.1 and abs(round(scaled[0], decimals) - scaled[0]) > 0.1 * abs(scaled[0]):
            decimals = 1 - math.floor(math.log10(nearer))
    else:
        decimals = 5 - (math.floor(math.log10(abs(scaled[0]))) if scaled[0] else 0)
    largest = max(abs(number) for number in scaled)
    decimals = min(decimals, most - 1 - math.floor(math.log10(largest)) if largest else decimals)
    if (decimals > 6 and largest < 1e-3) or largest >= 1e7:
        digits = max(1, decimals + 1 + (math.floor(math.log10(largest)) if largest else 0))
        texts = [f"{number:.{digits - 1}e}" for number in scaled]
    else:
        places = max(0, decimals)
        # + 0.0: what rounds to zero has no sign
        texts = [f"{round(number, decimals) + 0.0:.{places}f}" for number in scaled]
    return f"{texts[0]} ({texts[1]} to {texts[2]}) {unit}".rstrip()
