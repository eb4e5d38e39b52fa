"""From what a file has to a number in SI: a fixed value, or the distribution that a table describes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.documents import Fault, Place, one_of, shown, suggestion, unknown, within
from uqsphere.mechanics.bars import END_COEFFICIENTS
from uqsphere.quantities import INPUTS, format_bounds, format_value, plain_quantity
from uqsphere.units import Quantity, UnitError, likely_unit, parse_value
from uqsphere.uq import Law, LawError, make_law
from uqsphere.uq.families import DIMENSIONAL, FAMILIES, family_named

if TYPE_CHECKING:
    from uqsphere.study.document import Draft
    from uqsphere.study.study import Tested

#: a share of a law outside what has a meaning that is worth a warning
NOTABLE: Final = 1e-6


@dataclass(frozen=True, kw_only=True)
class Number:
    """A number in SI: value or law, whether its data are synthetic, tests behind it."""

    value: float | Law
    synthetic: bool = False
    tested: Tested | None = None

    @property
    def mean(self) -> float:
        """The value, or the law's mean before truncation."""
        return self.value.nominal_mean() if isinstance(self.value, Law) else self.value


@cache
def numbers_of(table: str) -> dict[str, Quantity]:
    """The numbers that a table of a scene can have, by their keys; those of inserts stand among those of the bars."""
    start = "bars.insert_" if table == "insert" else f"{table}."
    numbers = {name.removeprefix(start): entry for name, entry in INPUTS.items() if name.startswith(start)}
    return {key: entry for key, entry in numbers.items() if not key.startswith("insert_")}


def value_of(raw: object, quantity: Quantity, *, bounded: bool = True) -> float:
    """SI value of a fixed number; raises Fault where it is none, or outside the bounds of its meaning."""
    if isinstance(raw, str) and quantity.name.endswith(("_end", ".end")):
        if raw not in END_COEFFICIENTS:
            raise Fault(f"{unknown('end', raw, END_COEFFICIENTS)}; a number from -1 to 1 is known too")
        return END_COEFFICIENTS[raw]
    try:
        value = parse_value(raw, quantity.dimension, likely_unit(raw, quantity))
    except UnitError as error:
        raise Fault(str(error)) from None
    if bounded and not quantity.allows(value):
        raise Fault(f"found {shown(raw)}: {format_bounds(quantity)}")
    return value


def number_of(raw: object, quantity: Quantity, draft: Draft, place: Place) -> Number:
    """Value or law of what a file has; warns of what is unusual, and raises Fault."""
    if not isinstance(raw, Mapping):
        found = Number(value=value_of(raw, quantity))
    elif "file" in raw or "draws" in raw or raw.get("dist") in ("empirical", "discrete"):
        from uqsphere.study.data import law_of_data

        found = law_of_data(raw, quantity, draft, place)
    else:
        found = _member(raw, quantity)
    warn_unusual(found.mean, quantity, draft, place)
    if isinstance(found.value, Law):
        _check_law(found.value, quantity, draft, place)
    return found


def warn_unusual(value: float, quantity: Quantity, draft: Draft, place: Place) -> None:
    """Warn of a value (SI) outside the usual range of its quantity."""
    if not quantity.plausible[0] <= value <= quantity.plausible[1]:
        said, low, high = (format_value(v, quantity.name) for v in (value, *quantity.plausible))
        draft.warn(place, f"{said} is unusual (usual: {low} to {high}); is the unit right?")


def _member(raw: Mapping[str, Any], quantity: Quantity) -> Number:
    """The law of a table with `dist`, and its parameters in SI; raises Fault."""
    kind = raw.get("dist")
    if (family := family_named(kind) if isinstance(kind, str) else None) is None:
        near = suggestion(kind, FAMILIES) or suggestion(next(iter(raw), ""), ["dist"])
        said = f'a distribution is required, such as {{ dist = "normal", … }}, known: {one_of(FAMILIES)}{near}'
        raise Fault(said, *["dist"] * ("dist" in raw))
    keys = (*family.keys, "lower", "upper")
    given: dict[str, float] = {}
    for key in (key for key in raw if key != "dist"):
        if key not in keys:
            said = f"{shown(key)} does not belong to the distribution {family.name}, which takes {one_of(keys)}"
            raise Fault(said + suggestion(key, keys), key)
        entry = quantity if key in DIMENSIONAL else plain_quantity(quantity.name)
        if key not in ("mean", "mode", "lower", "upper") and entry.dimension != "number":
            entry = replace(entry, plausible=(0.0, math.inf))
        with within(key):
            given[key] = value_of(raw[key], entry, bounded=False)
    given = {key: given[key] for key in keys if key in given}
    bounds = given.pop("lower", None), given.pop("upper", None)
    try:
        return Number(value=make_law(family.name, given, *bounds))
    except LawError as error:
        unit = f" (numbers in {quantity.unit})" * (error.key in ("", *DIMENSIONAL) and quantity.unit != "")
        raise Fault(f"{error.message}{unit}", error.key if error.key in raw else "") from None


def _check_law(law: Law, quantity: Quantity, draft: Draft, place: Place) -> None:
    """Refuse a law outside what has a meaning; warn of wide ones, of those cut off, and of tails without a meaning."""
    name, centre, ends = quantity.name, law.nominal_mean(), {"lower": law.lower, "upper": law.upper}
    if not quantity.allows(centre):
        raise Fault(f"the distribution has its mean at {format_value(centre, name)}: {format_bounds(quantity)}")
    for key, end in ends.items() if law.family.bounded else ():
        if not quantity.lower <= end <= quantity.upper:
            raise Fault(f"{format_value(end, name)}: {format_bounds(quantity)}", key)
    cov = max(law.sd() / abs(law.mean()) if law.mean() else 0.0, law.given.get("cov", 0.0))
    if cov > 1.0:
        share = ' 15 % is written "15 %" or 0.15' * ("cov" in law.given)
        draft.warn(place, f"the standard deviation is {cov:.3g} times the mean: is that meant?{share}")
    if (mean := law.given.get("mean")) is not None and not law.lower <= mean <= law.upper:
        key, side = ("lower", "below") if mean < law.lower else ("upper", "above")
        said = f"the mean {format_value(mean, name)} lies {side} the bound {format_value(ends[key], name)}"
        draft.warn((*place, key), f"{said}: only a tail of the distribution is sampled")
    outside = float(law.cdf(np.array([quantity.lower]))[0] + law.sf(np.array([quantity.upper]))[0])
    if outside > NOTABLE:
        effect = "these samples count as failed evaluations; " if name in INPUTS else ""
        draft.warn(place, f"a share of {outside:.2g} of the distribution lies where it has no meaning "
                          f"({format_bounds(quantity)}); {effect}truncate it with lower or upper")  # fmt: skip
