"""The nomenclature: every number by its name, and the one formatter of its values.

Numbers of a scene are declared in `uqsphere.mechanics.inputs`, quantities of interest in
`uqsphere.mechanics.outputs`, demands of criteria in `uqsphere.mechanics.criteria`.  Tables,
axis labels and documentation read them here, so that a quantity has one name and one unit.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from math import inf, nan

from uqsphere.mechanics.criteria import DEMANDS as DEMANDS
from uqsphere.mechanics.inputs import INPUTS as INPUTS
from uqsphere.mechanics.outputs import OUTPUTS as OUTPUTS
from uqsphere.units import UNITS, Quantity

#: a probability next to 1, beyond which nobody reads its digits
_LARGEST_WRITTEN = 1.0 - 1e-6
#: smaller unit for values below one display unit
SMALLER = {"m": "mm", "kN": "N"}


def lookup(name: str) -> Quantity:
    """The nomenclature entry of an input or output; names of a black box get one without unit."""
    # demands of a criterion, and transferred quantities, are named after the limit too
    base = name.partition(".")[0]
    entry = INPUTS.get(name) or OUTPUTS.get(name) or DEMANDS.get(base) or OUTPUTS.get(base)
    return replace(entry or plain_quantity(name), name=name)


def plain_quantity(name: str) -> Quantity:
    """The entry of a number without unit, for example a black-box input."""
    return Quantity(name=name, symbol=name, meaning=name, lower=-inf, plausible=(-inf, inf))


def format_bounds(quantity: Quantity) -> str:
    """Sentence on the bounds of a quantity.

    >>> format_bounds(lookup("sphere.nu"))
    'Poisson ratio of the sphere must be between -1 and 0.5 (exclusive)'
    """
    low = format_value(quantity.lower, quantity.name)
    if not math.isfinite(quantity.upper):
        return f"{quantity.called} must be above {low}"
    ends = "inclusive" if quantity.closed else "exclusive"
    high = format_value(quantity.upper, quantity.name)
    return f"{quantity.called} must be between {low} and {high} ({ends})"


def display_unit(name: str, magnitude: float = inf) -> tuple[str, float]:
    """Display unit of a quantity, and the factor from SI to it.

    A `magnitude` [SI] below one display unit selects a smaller unit.

    >>> display_unit("striker.length"), display_unit("striker.length", 0.03)
    (('m', 1.0), ('mm', 1000.0))
    """
    quantity = lookup(name)
    unit = quantity.display or quantity.unit
    factors = UNITS[quantity.dimension]
    if 0.0 < abs(magnitude) < 0.9999 * factors.get(unit, 1.0):
        unit = SMALLER.get(unit, unit)
    return unit, 1.0 / factors.get(unit, 1.0)


def format_value(value: float, name: str, digits: int = 4) -> str:
    """Text of a value [SI] of the named quantity, in its display unit.

    The value has `digits` significant digits, and no power of ten below a million.

    >>> format_value(2.5541e9, "p_max"), format_value(0.001091, "contact_duration", 3)
    ('2.554 GPa', '1091 us')
    """
    unit, factor = display_unit(name, value)
    scaled = value * factor
    before = 0
    if 1.0 <= abs(scaled) < 1e6:
        before = _power(scaled) + 1
    return f"{scaled:.{max(digits, before)}g} {unit}".rstrip()


def format_together(values: Sequence[float], name: str) -> list[str]:
    """Texts of several values [SI] of the named quantity, in one unit and with as many decimals.

    The largest has three significant digits, the smallest and the range at least two.

    >>> format_together([2.6e9, 2.689e9, 2.78e9], "p_max"), format_together([0.081, 2.5], "fall")
    (['2.60 GPa', '2.69 GPa', '2.78 GPa'], ['0.081', '2.500'])
    """
    sizes = [abs(value) for value in values if value]
    if not sizes:
        return [format_value(value, name) for value in values]
    largest = max(sizes)
    unit, factor = display_unit(name, largest)
    span = max(values) - min(values) or largest
    first, smallest, spanned = (-_power(size * factor) for size in (largest, min(sizes), span))
    # of ends that are close, one digit more at most
    decimals = max(first + 2, smallest + 1, min(spanned + 1, first + 3), 0)
    if decimals > 6:
        return [format_value(value, name, 3) for value in values]
    return [f"{value * factor:.{decimals}f} {unit}".rstrip() for value in values]


def round_conservative(
    value: float, name: str, *, safe_above: bool, planned: float | None = None
) -> tuple[float, str]:
    """A conservative bound [SI] rounded to what people read, and its text: up if it is the least
    allowable value, else down.

    Further digits are kept where two would give away more than 5 %, or would leave a planned value
    without margin that has one.  Ratios that stand beside the rounded number are computed from it,
    so that text and ratio agree.

    >>> [round_conservative(x, "striker.speed", safe_above=False) for x in (0.458, 1.08)]
    [(0.45, '0.45 m/s'), (1.08, '1.08 m/s')]
    >>> round_conservative(0.458, "striker.speed", safe_above=False, planned=0.456)
    (0.458, '0.458 m/s')
    """
    unit, factor = display_unit(name, value)
    scaled = value * factor
    direction = 1 if safe_above else -1
    kept = direction * factor * (nan if planned is None else planned)
    rounded = scaled
    for digits in (2, 3, 4, 5):
        rounded = _significant(scaled, digits, direction)
        passed = direction * rounded > kept >= direction * scaled
        if abs(rounded - scaled) <= 0.05 * abs(scaled) and not passed:
            break
    return rounded / factor, f"{rounded:g} {unit}".rstrip()


def _power(value: float) -> int:
    """The power of ten of the first digit of a number; 0 of zero."""
    return math.floor(math.log10(abs(value))) if value else 0


def _significant(value: float, digits: int, direction: int) -> float:
    """`value` to significant digits: rounded up for a direction of 1, down for -1, else to the
    nearest.
    """
    if value == 0.0 or not math.isfinite(value):
        return value
    step = 10.0 ** (_power(value) - digits + 1)
    # what is a round number but for the last bits stays what it is
    whole = (round, math.ceil, math.floor)[direction]
    return float(f"{whole(value / step - 1e-9 * direction) * step:.{digits}g}")


def format_share(share: float) -> str:
    """Text of a probability that was asked for, in per cent with all its digits.

    >>> [format_share(p) for p in (0.0125, 1.0 - 1e-6, 2.6e-9)]
    ['1.25 %', '99.9999 %', '2.6e-7 %']
    """
    return f"{100.0 * share:.15g} %".replace("e-0", "e-")


def format_probability(
    value: float | None, high: float | None = None, low: float | None = None
) -> str:
    """Text of a probability: percent to two digits, near 100 % to the first that is no nine.

    It is never rounded to 0 or 100 %.  With the ends of its interval, 0 is "below" the upper and 1
    "above" the lower end; without a value the ends themselves are given.

    >>> [format_probability(p) for p in (0.0333, 2.6e-7, 0.999743, 1.0 - 2.6e-7, 0.0)]
    ['3.3 %', '2.6e-5 %', '99.97 %', 'above 99.9999 %', '0 %']
    >>> format_probability(0.0, 7.32e-4), format_probability(1.0, 1.0, 0.9998)
    ('below 0.074 %', 'above 99.98 %')
    >>> format_probability(None, 1e-5), format_probability(None, 1.0, 0.9998)
    ('below 0.001 %', 'above 99.98 %')
    >>> format_probability(None)
    'not known'
    """
    low = low or 0.0
    if high is None:
        high = 1.0
    least = _percent(low, -1)
    most = _percent(high, 1)
    if value is None and low > 0.0 and high < 1.0:
        return f"{least} to {most}"
    if value in (None, 1.0) and 0.0 < low != value:
        return f"above {least.removeprefix('above ')}"
    if value in (None, 0.0) and 1.0 > high != value:
        return f"below {most}"
    if value is None:
        return "not known"
    return _percent(value)


def _percent(value: float, direction: int = 0, decimals: int | None = None) -> str:
    """A probability without an interval, rounded up or down if it is a bound."""
    if decimals is not None:
        return f"{100.0 * value:.{decimals}f} %"
    if 0.0 < value < 1e-6:
        mantissa, _, exponent = f"{_significant(100.0 * value, 2, direction):.1e}".partition("e")
        return f"{float(mantissa):g}e{int(exponent)} %"
    if _LARGEST_WRITTEN < value < 1.0:
        return f"above {format_share(_LARGEST_WRITTEN)}"
    digits = 2
    if value >= 1.0:
        # a ratio, such as a coefficient of variation, may exceed 100 %
        digits = 3
    elif value > 0.99:
        # the first digit of what is missing to 100 %, and of a bound the second one
        digits = abs(direction) - _power(1.0 - value)
    return f"{_significant(100.0 * value, digits, direction):.{digits}g} %"


def format_probability_estimate(value: float | None, low: float | None, high: float | None) -> str:
    """Text of a probability with its interval, `format_probability` where one of them is enough.

    >>> format_probability_estimate(0.02017, 0.0199, 0.0204)
    '2.02 % (1.99 to 2.04 %)'
    >>> format_probability_estimate(0.99904, 0.999, 0.99911)
    '99.90 % (99.90 to 99.91 %)'
    >>> format_probability_estimate(None, 0.0, 1e-5), format_probability_estimate(0.2, 0.2, 0.2)
    ('below 0.001 %', '20 %')
    """
    if value is None or low is None or high is None or low == high:
        return format_probability(value, high, low)
    if value in (0.0, 1.0) and high - low < 1.0:
        return format_probability(value, high, low)
    decimals = None
    next_to_all = low > 0.99
    if low >= 1e-6 and high <= (0.9999 if next_to_all else 0.99):
        # two digits of the width, at most three of the value
        gaps = (min(value, 1.0 - value), high - low, 1.0 - high)
        most, width, missing = (-_power(100.0 * gap + 1e-12) for gap in gaps)
        decimals = width + 1
        if next_to_all:
            # one, and what the upper end lacks of 100 %
            decimals = max(width, missing)
        decimals = max(min(most + 2, decimals), 0)
    texts = (_percent(number, decimals=decimals) for number in (value, low, high))
    return with_ends(*texts).replace(" % to", " to")


def with_ends(text: str, low: str, high: str) -> str:
    """A number with the ends of its interval, where they differ from it."""
    if text == low == high:
        return text
    return f"{text} ({low} to {high})"


def format_estimate(
    value: float, low: float | None, high: float | None, name: str = "", most: int = 15
) -> str:
    """``value (low to high) unit``, every number rounded to what the interval supports.

    The half-width keeps two significant digits, the value the same decimal and at most `most`
    digits.  If that would round the value away, an interval that is far longer to one side has the
    digits of its shorter side.  An interval that rounds to the value is omitted.

    >>> format_estimate(2.55412e9, 2.5502e9, 2.5581e9, "p_max")
    '2.5541 (2.5502 to 2.5581) GPa'
    >>> format_estimate(0.5, None, None), format_estimate(2.5e9, 2.499999e9, 2.5e9, "p_max", 4)
    ('0.5', '2.500 GPa')
    """
    if low is None or high is None or low == high:
        return format_value(value, name, min(most, 6))
    unit, factor = display_unit(name, value)
    scaled = [number * factor for number in (value, low, high)]
    spec = ".6g"
    if all(map(math.isfinite, scaled)):  # not a difference of numbers near the largest there are
        decimals = _decimals(*scaled)
        largest = max(map(abs, scaled))
        magnitude = _power(largest)
        if largest:
            decimals = min(decimals, most - 1 - magnitude)
        if (decimals > 6 and largest < 1e-3) or largest >= 1e7:
            spec = f".{max(0, decimals + magnitude)}e"
        else:
            spec = f".{max(0, decimals)}f"
            # + 0.0: what rounds to zero has no sign
            scaled = [round(number, decimals) + 0.0 for number in scaled]
    texts = (f"{number:{spec}}" for number in scaled)
    return f"{with_ends(*texts)} {unit}".rstrip()


def _decimals(value: float, low: float, high: float) -> int:
    """Decimals of the second significant digit of the half-width; without one, of six digits."""
    half_width = 0.5 * abs(high - low)
    if not (half_width > 0.0 and math.isfinite(half_width)):
        return 5 - _power(value)
    decimals = 1 - _power(half_width)
    nearer = min(value - low, high - value)
    if 1e-3 < nearer / half_width < 0.1 and abs(round(value, decimals) - value) > 0.1 * abs(value):
        return 1 - _power(nearer)
    return decimals
