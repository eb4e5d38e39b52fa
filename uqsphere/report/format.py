"""Answers as text: one formatter for values, estimates and probabilities, for page, terminal and figures alike."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from uqsphere.quantities import display_unit, format_estimate, format_probability, format_value, lookup

Row = Mapping[str, Any]


def find(rows: Sequence[Row], subject: str, answer: str, at: float | str = "") -> Row | None:
    """The row of an answer, None where there is none."""
    return next((r for r in rows if r["subject"] == subject and r["answer"] == answer and r["at"] == at), None)


def of(rows: Sequence[Row], subject: str, answer: str) -> list[Row]:
    """All rows of an answer."""
    return [row for row in rows if row["subject"] == subject and row["answer"] == answer]


def value(number: float | None, name: str, digits: int = 3) -> str:
    """A number of a quantity with its unit; a dash where there is none.

    >>> value(2.5541e9, "p_max"), value(None, "p_max")
    ('2.55 GPa', '–')
    """
    if number is None:
        return "–"
    scaled = abs(number * display_unit(name, number)[1])
    # no power of ten where the digits before the point say it
    digits = max(digits, math.floor(math.log10(scaled)) + 1) if 1.0 <= scaled < 1e6 else digits
    return format_value(number, name, digits)


def estimate(row: Row | None, name: str = "", most: int = 4) -> str:
    """Value (low to high) with the unit; a dash with the reason where there is no value.

    >>> estimate({"value": 0.5, "low": 0.49, "high": 0.51, "note": ""})
    '0.500 (0.490 to 0.510)'
    """
    if row is None:
        return "–"
    if row["value"] is None:
        return f"– ({row['note']})" if row["note"] else "–"
    if row["low"] is None or row["high"] is None or row["low"] == row["high"]:
        return value(row["value"], name, most)
    text = format_estimate(row["value"], row["low"], row["high"], name, most)
    middle, _, rest = text.partition(" (")
    ends, _, unit = rest.partition(")")
    # an interval that rounds to the value says nothing more
    return f"{middle}{unit}" if ends == f"{middle} to {middle}" else text


def probability(row: Row | None) -> str:
    """A probability in per cent with its interval; an upper bound where nothing was seen.

    >>> probability({"value": 0.02017, "low": 0.0199, "high": 0.0204, "note": ""})
    '2.02 % (1.99 to 2.04 %)'
    >>> probability({"value": None, "low": 0.0, "high": 1e-5, "note": "too few"})
    'below 1e-05'
    """
    if row is None:
        return "–"
    low, high = row["low"], row["high"]
    if row["value"] is None or (row["value"] == 0.0 and high):
        return "–" if high is None else format_probability(None, high)
    if low is None or high is None or low == high:
        return format_probability(row["value"])
    texts = [format_probability(p) for p in (row["value"], low, high)]
    if low >= 1e-4 and high <= 0.99:
        # as many digits as tell the ends apart, three of the value at most
        least = 2 - math.floor(math.log10(100.0 * min(row["value"], 1.0 - row["value"])))
        digits = max(min(least, 1 - math.floor(math.log10(100.0 * (high - low)))), 0)
        texts = [f"{100.0 * p:.{digits}f} %" for p in (row["value"], low, high)]
    if texts[0] == texts[1] == texts[2]:
        return texts[0]
    first = texts[1].removesuffix(" %") if texts[2].endswith("%") else texts[1]
    return f"{texts[0]} ({first} to {texts[2]})"


def meaning(name: str, inputs: Mapping[str, Any] | None = None) -> str:
    """What a number is called by people.

    >>> meaning("limits.crushing.strength")
    'strength (crushing)'
    """
    if name.startswith("limits."):
        limit, _, part = name.removeprefix("limits.").rpartition(".")
        return f"{part.replace('_', ' ')} ({limit.removesuffix(' (assumed)')})"
    if inputs and name in inputs:
        return short(str(inputs[name]["meaning"]))
    return short(lookup(name).meaning)


def short(text: str) -> str:
    """What a quantity is called, without what it is made of.

    >>> short("equivalent contact duration: impulse over peak")
    'equivalent contact duration'
    """
    return text.partition(":")[0]


def label(subject: str) -> str:
    """A limit or failure mode by its own name.

    >>> label("limits.crushing"), label("modes.ring crack")
    ('crushing', 'ring crack (assumed)')
    """
    kind, _, name = subject.partition(".")
    return f"{name} (assumed)" if kind == "modes" else name or subject
