"""In which unit each quantity of a run is read: one for all sentences, tables and figures of a page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

from uqsphere.quantities import lookup, unit_that_reads
from uqsphere.report.margins import subject_of

__all__ = ["units_of"]

#: state at fracture -> the quantity whose unit it is read in
_STATE: Final = {"time": "contact_time", "force": "P_max", "energy": "energy", "specific_energy": "specific_energy"}
#: numbers of the scene -> the quantity whose unit they are read in
_NUMBERS: Final = {"P_0_median": "P_max", "t_c_median": "contact_time"}


def _known(estimates: Iterable[Mapping[str, Any] | None]) -> list[float]:
    return [float(e["value"]) for e in estimates if e and e.get("value") is not None]


def units_of(*runs: Mapping[str, Any], courses: Mapping[str, Any] | None = None) -> dict[str, str]:
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
        for name, entry in results["quantities"].items():
            first.setdefault(name, []).extend(_known([entry["mean"], *entry["quantiles"].values()]))
        for name, entry in results["inputs"].items():
            first.setdefault(name, []).extend(_known([{"value": entry.get("mean")}]))
        for entry in results["margins"].values():
            first.setdefault(subject_of(results, entry["solve"]), []).extend(_known(entry["values"].values()))
            family = entry.get("family") or {}
            if family:
                values = [member["value"] for member in family["members"]]
                first.setdefault(family["path"], []).extend(values)
        fracture = results.get("fracture") or {}
        for key, name in _STATE.items():
            second.setdefault(name, []).extend(_known((fracture.get(key) or {}).get("quantiles", {}).values()))
        numbers = results["model"].get("numbers", {})
        for key, name in _NUMBERS.items():
            second.setdefault(name, []).extend(_known([{"value": numbers.get(key)}]))
    if courses is not None:
        contact = courses["hardest"].get("contact")
        if contact is not None:
            second.setdefault("p_max", []).append(contact["pressure"])
            second.setdefault("core_tension", []).append(0.05 * contact["pressure"])
        second.setdefault("P_max", []).append(max(map(max, (courses["hardest"][f] for f in ("force_a", "force_b")))))
    groups = {**{name: values for name, values in second.items() if values}, **first}
    return {name: unit_that_reads(name, values) for name, values in groups.items() if lookup(name).display}
