"""Answers as text, for page, terminal and figures alike; and what stands in one row."""

import math
import re
from collections.abc import Iterable, Sequence
from itertools import chain

import numpy as np

from uqsphere.arrays import Array
from uqsphere.quantities import (
    format_estimate,
    format_probability,
    format_probability_estimate,
    format_together,
    format_value,
    lookup,
    with_ends,
)
from uqsphere.results.types import Answer, QuantityEntry, Range
from uqsphere.units import UNITS

DASH = "–"
#: share of a variance that sums do not tell from none
_ROUNDING = 1e-12
#: a number with its interval
Estimated = Answer | Range
_UNITS = "|".join(map(re.escape, filter(None, chain.from_iterable(UNITS.values()))))
#: a number in front of its unit, with a blank that may break
_SPLIT = re.compile(rf"(?<=\d) (?=(?:%|{_UNITS})(?![\w/]))")


def ends_of(rows: Iterable[Estimated]) -> Array:
    """Values, and lower and upper ends, of n answers (3, n); nan where there is none."""
    return np.array([(row.value, row.low, row.high) for row in rows], float).reshape(-1, 3).T


def keep_units(text: str) -> str:
    """A text in which no line breaks between a number and its unit.

    >>> keep_units("2.5 GPa to 3 GPa, 5 % of 3 metres")
    '2.5\\xa0GPa to 3\\xa0GPa, 5\\xa0% of 3 metres'
    """
    return _SPLIT.sub("\N{NO-BREAK SPACE}", text)


def value(number: float | None, name: str, digits: int = 3) -> str:
    """A number of a quantity with its unit; a dash if there is none.

    >>> value(2.5541e9, "p_max"), value(None, "p_max")
    ('2.55 GPa', '–')
    """
    if number is None:
        return DASH
    return format_value(number, name, digits)


def value_range(low: float | None, high: float | None, name: str) -> str:
    """The range of a quantity, in one unit; a dash if it has no two ends.

    >>> value_range(0.0644, 0.404, "striker.speed"), value_range(None, 1.0, "p_max")
    ('0.064 to 0.404 m/s', '–')
    """
    if low is None or high is None or low == high:
        return DASH
    first, last = format_together([low, high], name)
    unit = last.partition(" ")[2]
    return f"{first.removesuffix(f' {unit}')} to {last}"


def estimate(row: Estimated, name: str = "", most: int = 4) -> str:
    """Value (low to high) with the unit; a dash with the reason if there is no value.

    >>> estimate(Range(value=0.5, low=0.49, high=0.51))
    '0.500 (0.490 to 0.510)'
    """
    if row.value is None:
        return f"{DASH} ({row.note})".removesuffix(" ()")
    return format_estimate(row.value, row.low, row.high, name, most)


def index(row: Estimated) -> str:
    """A Sobol' index with its interval, to three decimals.

    >>> index(Range(value=0.98412, low=0.981, high=0.987))
    '0.984 (0.981 to 0.987)'
    >>> index(Range(value=4e-5, low=0.0, high=9e-5))
    '0.000'
    """
    share = row.value
    if share is None:
        return DASH
    ends = (share if end is None else end for end in (row.low, row.high))
    return with_ends(*(f"{number:.3f}" for number in (share, *ends)))


def probability(row: Estimated) -> str:
    """A probability in per cent with its interval; a bound if only that is known.

    >>> probability(Range(value=0.0, low=0.0, high=1e-3)), probability(Range())
    ('below 0.1 %', '–')
    """
    if row.value is None and row.high is None:
        return DASH
    return format_probability_estimate(row.value, row.low, row.high)


def unexplained(entry: QuantityEntry) -> str:
    """The share of a quantity's variance that its expansion does not explain, as far as rounding
    lets it be known.
    """
    share = entry.expansion_error or 0.0
    return format_probability(share if share > _ROUNDING else 0.0, _ROUNDING)


def plain_probability(row: Estimated) -> str:
    """A probability without its interval; a bound if the estimate is 0 or 1.

    >>> plain_probability(Range(value=1.0, low=0.9998, high=1.0))
    'above 99.98 %'
    """
    return format_probability(row.value, row.high, row.low)


def change_text(before: Sequence[float], after: Sequence[float]) -> str:
    """How an answer (value, low, high) changed: in per cent, as a factor, or in orders of
    magnitude; in words where one of the values is zero within its interval.

    >>> change_text((2.5, 2.4, 2.6), (3.0, 2.9, 3.1)), change_text((2.0, 2, 2), (9.0, 9, 9))
    ('+20 %', 'times 4.5')
    >>> change_text((1e-15, 9e-16, 2e-15), (0.02, 0.01, 0.03))
    '+13 orders of magnitude'
    >>> change_text((1e-17, -2e-14, 2e-14), (0.3, 0.29, 0.31))
    'zero within its interval before'
    """
    for (number, low, high), when in ((before, "before"), (after, "after")):
        if number == 0.0 or low < 0.0 < high:
            return f"zero within its interval {when}"
    ratio = after[0] / before[0]
    if ratio < 0.0:
        return "other sign"
    if not 1e-3 < ratio < 1e3:
        return f"{math.log10(ratio):+.0f} orders of magnitude"
    if not 0.5 < ratio < 2.0:
        return f"times {float(f'{ratio:.2g}'):g}"
    return f"{100.0 * (ratio - 1.0):+.3g} %"


def meaning(name: str) -> str:
    """What a number is called by people.

    >>> meaning("limits.crushing.strength"), meaning("contact_duration")
    ('strength (crushing)', 'equivalent contact duration')
    >>> meaning("limits.crushing")
    'crushing'
    """
    if name.startswith("limits."):
        limit, _, part = name.removeprefix("limits.").rpartition(".")
        if not limit:
            return part
        return f"{part.replace('_', ' ')} ({limit.removesuffix(' (assumed)')})"
    return lookup(name).called


def with_unit(text: str, unit: str) -> str:
    """A name with its unit in brackets, if it has one.

    >>> with_unit("force", "N"), with_unit("angle", "")
    ('force [N]', 'angle')
    """
    return f"{text} [{unit}]".removesuffix(" []")


def source_text(source: str, checked: bool) -> str:
    """A source, and whether it was read."""
    if checked:
        return source
    return f"{source} (source not checked)"


def title_of(name: str) -> str:
    """A quantity as a heading: a name of the user's stays as it is."""
    text = meaning(name)
    if text == name:
        return text
    return capital(text)


def capital(text: str) -> str:
    """A text that begins a sentence.

    >>> capital("peak P_max")
    'Peak P_max'
    """
    return text[:1].upper() + text[1:]


def small(text: str) -> str:
    """A text that goes on in a sentence; units keep their letters.

    >>> small("Use at most 2.8 kN")
    'use at most 2.8 kN'
    """
    return text[:1].lower() + text[1:]


def plain_name(subject: str) -> str:
    """A limit or failure mode by its own name.

    >>> plain_name("modes.core tension"), plain_name("limits.crushing")
    ('core tension', 'crushing')
    """
    return subject.removeprefix("limits.").removeprefix("modes.")


def label(subject: str) -> str:
    """A limit or failure mode by its own name, with a star if its strength is assumed.

    >>> label("limits.crushing"), label("modes.ring crack")
    ('crushing', 'ring crack*')
    """
    if subject.startswith("modes."):
        return f"{plain_name(subject)}*"
    return plain_name(subject)
