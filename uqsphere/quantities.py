"""The nomenclature: every number by its name, and how its values are written for people.

Numbers of a scene are declared in `uqsphere.mechanics.scene`, quantities of interest in `uqsphere.mechanics.outputs`,
demands of criteria in `uqsphere.mechanics.criteria`.  Result tables, axis labels and the documentation all read them
here, so that a quantity has one name and one unit everywhere.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import replace
from typing import Final

from uqsphere.mechanics.criteria import DEMANDS
from uqsphere.mechanics.outputs import OUTPUTS
from uqsphere.mechanics.scene import INPUTS
from uqsphere.units import UNITS, Quantity, format_distinct, format_probability

__all__ = [
    "DEMANDS",
    "INPUTS",
    "OUTPUTS",
    "display_unit",
    "format_distinct",
    "format_estimate",
    "format_probability",
    "format_value",
    "lookup",
    "reading_units",
    "unit_that_reads",
]

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


def lookup(name: str) -> Quantity:
    """The nomenclature entry of an input or an output; a black-box name gets a plain entry without unit."""
    found = INPUTS.get(name) or OUTPUTS.get(name)
    if found is None and (entry := DEMANDS.get(base := name.partition(".")[0]) or OUTPUTS.get(base)):
        # the demand of a criterion goes by the names of criterion and limit, and what is carried of a quantity too
        return replace(entry, name=name)
    return found or Quantity(name=name, symbol=name, dimension="number", lower=-math.inf, meaning=name)


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
    decimals = _decimals(*scaled)
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


def _decimals(value: float, low: float, high: float) -> int:
    """Decimals of the second significant digit of a half-width, or six digits of the value where there is none."""
    half_width = 0.5 * abs(high - low)
    if not (half_width > 0.0 and math.isfinite(half_width)):
        return 5 - (math.floor(math.log10(abs(value))) if value else 0)
    decimals = 1 - math.floor(math.log10(half_width))
    nearer = min(value - low, high - value)
    if 1e-3 < nearer / half_width < 0.1 and abs(round(value, decimals) - value) > 0.1 * abs(value):
        return 1 - math.floor(math.log10(nearer))
    return decimals
