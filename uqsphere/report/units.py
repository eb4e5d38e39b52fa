"""In which unit each quantity of a run is read: one for all sentences, tables and figures of a page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

from uqsphere.quantities import lookup, unit_that_reads
from uqsphere.report.claims import subject_of
from uqsphere.results import Results

__all__ = ["units_of"]

#: state at fracture -> the quantity whose unit it is read in
_STATE: Final = {"time": "contact_time", "force": "P_max", "energy": "energy", "specific_energy": "specific_energy"}
#: numbers of the scene -> the quantity whose unit they are read in
_NUMBERS: Final = {"P_0_median": "P_max", "t_c_median": "contact_time"}


def _known(values: Iterable[float | None]) -> list[float]:
    return [float(value) for value in values if value is not None]


def units_of(*runs: Results, courses: Mapping[str, Any] | None = None) -> dict[str, str]:
    """The unit of every quantity and input by name.

    A quantity that was asked for decides by its mean and its quantiles; what else is read in its unit follows. A
    spread may then have zeros after its point, but never another unit than what it is the spread of.

    Parameters
    ----------
    runs : results.json of one run, or of several that stand side by side
    courses : courses.json, where forces were followed

    Returns
    -------
    dict
        As `uqsphere.quantities.reading_units` takes it.
    """
    first: dict[str, list[float]] = {}
    second: dict[str, list[float]] = {}
    for results in runs:
        for name, quantity in results.quantities.items():
            estimates = [quantity.mean, *quantity.quantiles.values()]
            first.setdefault(name, []).extend(_known(e.value for e in estimates))
        for name, law in results.inputs.items():
            first.setdefault(name, []).extend(_known([law.mean]))
        for margin in results.margins.values():
            subject = subject_of(results, margin.solve)
            first.setdefault(subject, []).extend(_known(e.value for e in margin.values.values()))
            if margin.family:
                first.setdefault(margin.family.path, []).extend(member.value for member in margin.family.members)
        states = results.fracture.states()
        for key, name in _STATE.items():
            estimates = list(states[key].quantiles.values()) if key in states else []
            second.setdefault(name, []).extend(_known(e.value for e in estimates))
        for key, name in _NUMBERS.items():
            second.setdefault(name, []).extend(_known([results.model.numbers.get(key)]))
    if courses is not None:
        contact = courses["hardest"].get("contact")
        if contact is not None:
            second.setdefault("p_max", []).append(contact["pressure"])
            second.setdefault("core_tension", []).append(0.05 * contact["pressure"])
        second.setdefault("P_max", []).append(max(map(max, (courses["hardest"][f] for f in ("force_a", "force_b")))))
    groups = {**{name: values for name, values in second.items() if values}, **first}
    return {name: unit_that_reads(name, values) for name, values in groups.items() if lookup(name).display}
