"""The criterion of a limit: which demand is held against its strength, and with which parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from uqsphere.mechanics.criteria import CRITERIA, PARAMETERS, Criterion
from uqsphere.quantities import Quantity
from uqsphere.study.document import LimitTable
from uqsphere.study.faults import Findings, Place, one_of, shown, suggestion
from uqsphere.study.numbers import Reading, read_fixed
from uqsphere.uq.law import Law

__all__ = ["KEYS", "CriterionReading", "read_criterion", "with_modulus_of"]

#: keys of a limit that belong to a criterion
KEYS: Final = tuple(PARAMETERS)


@dataclass(frozen=True, kw_only=True)
class CriterionReading:
    """A criterion as understood; `quantity` is its demand for this limit, `criterion` None if that is plain."""

    quantity: str
    criterion: str | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)


def read_criterion(table: LimitTable, name: str, black_box: bool, findings: Findings) -> CriterionReading | None:
    """The criterion of a limit that names one; None, with the faults noted, where it cannot be understood."""
    place: Place = ("limits", name)
    key = table.criterion
    if black_box:
        findings.add((*place, "criterion"), "a criterion belongs to the impact model: name a quantity instead")
        return None
    if key not in CRITERIA:
        near = suggestion(str(key), list(CRITERIA))
        findings.add((*place, "criterion"), f"unknown criterion {shown(key)}, known: {one_of(list(CRITERIA))}{near}")
        return None
    if table.quantity is not None:
        findings.add((*place, "quantity"), "quantity and criterion both say what is compared: leave one of them out")
        return None
    entry = CRITERIA[key]
    parameters = _parameters(table, entry, place, findings)
    if parameters is None:
        return None
    if not parameters and entry.quantity is not None:
        return CriterionReading(quantity=entry.quantity)
    return CriterionReading(quantity=f"{key}.{name}", criterion=key, parameters=parameters)


def _parameters(table: LimitTable, entry: Criterion, place: Place, findings: Findings) -> dict[str, float] | None:
    takes = (*entry.parameters, *entry.optional)
    found: dict[str, float] = {}
    clean = True
    for key in KEYS:
        raw = getattr(table, key)
        if raw is None:
            # the modulus may stand in the strength, which is read later
            if key in entry.parameters and key != "modulus" and findings.clean((*place, key)):
                findings.add((*place, key), f"{key} is missing: the criterion {entry.name} needs the {_meaning(key)}")
                clean = False
            continue
        if key not in takes:
            allowed = one_of(takes) if takes else "none"
            findings.add((*place, key), f"the criterion {entry.name} takes no {key} (it takes: {allowed})")
            clean = False
            continue
        part = PARAMETERS[key]
        quantity = Quantity(name=key, symbol=key, dimension=part.dimension, lower=part.lower, upper=part.upper,
                            meaning=f"the {part.meaning}")  # fmt: skip
        value = read_fixed(raw, (*place, key), quantity, findings)
        clean &= value is not None
        if value is not None:
            found[key] = value
    return found if clean else None


def _meaning(key: str) -> str:
    return PARAMETERS[key].meaning


def with_modulus_of(
    strength: Reading | None, reading: CriterionReading, name: str, findings: Findings
) -> CriterionReading | None:
    """The criterion with the Weibull modulus of its strength, where it needs one; they must not contradict."""
    if reading.criterion is None or "modulus" not in CRITERIA[reading.criterion].parameters:
        return reading
    law = strength.value if strength is not None else None
    own = law.parameters.get("modulus") if isinstance(law, Law) and law.kind == "weibull" else None
    given = reading.parameters.get("modulus")
    place: Place = ("limits", name, "modulus")
    if own is not None and given is not None and abs(own - given) > 1e-9 * given:
        findings.add(place, f"found {given:g}, but the strength has the modulus {own:g}: leave modulus out")
        return None
    if own is None and given is None:
        if findings.clean(place) and strength is not None:
            findings.add(place, "modulus is missing: give it here or by a strength that is a Weibull law")
        return None
    if own is None and strength is not None:
        findings.warnings.append(
            f"limits.{name}: the strength of a weakest link is a Weibull law of its modulus; with another the "
            "probability is not that of the flaws"
        )
    modulus = given if own is None else own
    assert modulus is not None
    return CriterionReading(
        quantity=reading.quantity,
        criterion=reading.criterion,
        parameters={"modulus": float(modulus), **reading.parameters},
    )
