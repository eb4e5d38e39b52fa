"""The nomenclature: every number by its name, and how its values are written for people.

Numbers of a scene are declared in `uqsphere.mechanics.scene`, quantities of interest in
`uqsphere.mechanics.outputs`, demands of criteria in `uqsphere.mechanics.criteria`.  Result tables,
axis labels and the documentation all read them here, so that a quantity has one name and one unit
everywhere.
"""

from __future__ import annotations

import math
from dataclasses import replace

from uqsphere.mechanics.criteria import DEMANDS
from uqsphere.mechanics.outputs import OUTPUTS
from uqsphere.mechanics.scene import INPUTS
from uqsphere.units import UNITS, Quantity

__all__ = [
    "DEMANDS",
    "INPUTS",
    "OUTPUTS",
    "display_unit",
    "format_bounds",
    "format_conservative",
    "format_estimate",
    "format_probability",
    "format_value",
    "lookup",
    "plain_quantity",
]

#: the unit that is read in place of a larger one
SMALLER = {"m": "mm", "kN": "N"}


def lookup(name: str) -> Quantity:
    """The nomenclature entry of an input or an output; a black-box name gets a plain entry without
    unit.
    """
    found = INPUTS.get(name) or OUTPUTS.get(name)
    if found is None and (
        entry := DEMANDS.get(base := name.partition(".")[0]) or OUTPUTS.get(base)
    ):
        # the demand of a criterion goes by the names of criterion and limit, and what is carried of
        # a quantity too
        return replace(entry, name=name)
    return found or plain_quantity(name)


def plain_quantity(name: str, meaning: str = "", lower: float = -math.inf) -> Quantity:
    """The entry of a number without unit: a black-box input, say."""
    return Quantity(
        name=name,
        symbol=name,
        dimension="number",
        lower=lower,
        meaning=meaning or name,
        plausible=(-math.inf, math.inf),
    )


def format_bounds(quantity: Quantity) -> str:
    """Where the values of a quantity must lie."""
    low, high = (format_value(end, quantity.name) for end in (quantity.lower, quantity.upper))
    way = (
        f"lie from {low} to {high}"
        if quantity.closed
        else f"lie between {low} and {high}, both excluded"
    )
    return f"{quantity.meaning} must {way if math.isfinite(quantity.upper) else f'be above {low}'}"


def display_unit(name: str, magnitude: float = math.inf) -> tuple[str, float]:
    """The unit people read for a quantity, and the factor that turns an SI value into it; a
    `magnitude` (SI) below one such unit chooses a smaller one.

    >>> display_unit("striker.length"), display_unit("striker.length", 0.03)
    (('m', 1.0), ('mm', 1000.0))
    """
    quantity = lookup(name)
    unit, factors = quantity.display or quantity.unit, UNITS[quantity.dimension]
    if 0.0 < abs(magnitude) < 0.9999 * factors.get(unit, 1.0):
        unit = SMALLER.get(unit, unit)
    return unit, 1.0 / factors.get(unit, 1.0)


def format_value(value: float, name: str, digits: int = 4) -> str:
    """`value` (SI) of the named quantity for people, in its display unit, to `digits` significant
    digits; no power of ten where the digits before the point say it.

    >>> format_value(2.5541e9, "p_max"), format_value(0.001091, "contact_duration", 3)
    ('2.554 GPa', '1091 us')
    """
    unit, factor = display_unit(name, value)
    scaled = value * factor
    before = math.floor(math.log10(abs(scaled))) + 1 if 1.0 <= abs(scaled) < 1e6 else 0
    return f"{scaled:.{max(digits, before)}g} {unit}".rstrip()


def format_conservative(value: float, name: str, *, least: bool, digits: int = 2) -> str:
    """As `format_value`, rounded up where a value is the `least` that is safe, else down.

    >>> [format_conservative(0.458, "striker.speed", least=least) for least in (False, True)]
    ['0.45 m/s', '0.46 m/s']
    """
    unit, factor = display_unit(name, value)
    scaled = value * factor
    step = 10.0 ** (math.floor(math.log10(abs(scaled))) - digits + 1) if scaled else 1.0
    rounded = (
        math.ceil(scaled / step - 1e-9) if least else math.floor(scaled / step + 1e-9)
    ) * step
    return f"{float(f'{rounded:.{digits}g}'):g} {unit}".rstrip()


def format_probability(value: float | None, high: float | None = None) -> str:
    """A probability for people: percent to two digits, more near 100 %, a power of ten below 0.01
    %, "above" 99.99 %; never rounded to 0 or 100 %.

    Without a value its upper bound, if there is one.

    >>> [format_probability(p) for p in (0.0333, 2.6e-7, 0.999743, 0.99996, 0.0)]
    ['3.3 %', '2.6e-07', '99.974 %', 'above 99.99 %', '0 %']
    >>> format_probability(None, 1e-5), format_probability(None)
    ('below 1e-05', 'not known')
    """
    if value is None:
        return "not known" if high is None else f"below {format_probability(high)}"
    if 0.0 < value < 1e-4:
        return f"{value:.2g}"
    if 0.9999 < value < 1.0:
        return "above 99.99 %"
    digits = 2 if value <= 0.99 else 1 - math.floor(math.log10(1.0 - value)) if value < 1.0 else 3
    return f"{100.0 * value:.{digits}g} %"


def format_estimate(value: float, low: float, high: float, name: str = "", most: int = 15) -> str:
    """``value (low to high) unit``, every number rounded to what the interval supports.

    The half-width keeps two significant digits, the value the same decimal and at most `most`
    digits; where that would round the value away, an interval that is far longer to one side has
    the digits of its shorter one.

    >>> format_estimate(2.55412e9, 2.5502e9, 2.5581e9, "p_max")
    '2.5541 (2.5502 to 2.5581) GPa'
    """
    unit, factor = display_unit(name, value) if name else ("", 1.0)
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
    """Decimals of the second significant digit of a half-width, or six digits of the value where
    there is none.
    """
    half_width = 0.5 * abs(high - low)
    if not (half_width > 0.0 and math.isfinite(half_width)):
        return 5 - (math.floor(math.log10(abs(value))) if value else 0)
    decimals = 1 - math.floor(math.log10(half_width))
    nearer = min(value - low, high - value)
    if 1e-3 < nearer / half_width < 0.1 and abs(round(value, decimals) - value) > 0.1 * abs(value):
        return 1 - math.floor(math.log10(nearer))
    return decimals
