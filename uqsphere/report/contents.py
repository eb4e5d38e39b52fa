"""What a report is made of: the stored answers of a finished run, read once."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.errors import AccessError, FolderError
from uqsphere.files import Json, load_document, read_whole
from uqsphere.quantities import lookup, unit_that_reads
from uqsphere.results import NO_RIG, Results, read_results
from uqsphere.results.entries import LawTable, Manifest, Resolved, Sliders, read_entry, read_manifest, read_resolved
from uqsphere.results.tables import Stored, read_fields
from uqsphere.runner.finished import read_points
from uqsphere.runner.schedule import REPLICATES
from uqsphere.study import quantity_of, strength_name
from uqsphere.study.columns import open_observations
from uqsphere.uq import Law, make_law
from uqsphere.uq.families import Family, LawError, family_stored


@dataclass(frozen=True, kw_only=True)
class Samples:
    """Sampled rows of one quantity, failed rows left out: values (n,) SI and censored flags (n,)."""

    values: Array
    censored: npt.NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Contents:
    """The files of a result folder.

    `resolved` is study.resolved.json; `samples` are by quantity, `failed` the share of the sampled rows that
    have no answer; `points` are the inputs of the rows that have one (n,), in SI; `courses` is courses.json, where
    forces were followed over time; `fields` are the answers that are vectors; `services` are the contents of the
    services' own folders; `tests` are the tests behind strengths, by their names: how many, what they measured, in
    which file.
    """

    results: Results
    manifest: Manifest
    resolved: Resolved
    samples: Mapping[str, Samples] = field(default_factory=dict)
    failed: float = 0.0
    points: Mapping[str, Array] = field(default_factory=dict)
    courses: Mapping[str, Json] | None = None
    fields: Mapping[str, Stored] = field(default_factory=dict)
    services: Mapping[str, Contents] = field(default_factory=dict)
    #: the randomisation that each row belongs to (n,), and what its page may move
    replicates: Array = field(default_factory=lambda: np.zeros(0))
    sliders: Sliders | None = None
    tests: Mapping[str, str] = field(default_factory=dict)

    @property
    def parts(self) -> dict[str, Contents]:
        """The rig's own answers by an empty name, where it has one, and those of the services."""
        return {**({} if self.results.rig == NO_RIG else {"": self}), **self.services}

    @property
    def black_box(self) -> bool:
        return bool(self.resolved.kind == "black box")

    def subject(self, name: str) -> str:
        """The name whose unit a number has: a strength has that of the limit's quantity."""
        return subject_of(self.results, name)

    def at_mean(self, name: str) -> float | None:
        """The number of an input that the study states: fixed, or the mean of its law (SI)."""
        if name in self.resolved.fixed:
            return float(self.resolved.fixed[name])
        law = law_of(self.resolved, name)
        return None if law is None else law.nominal_mean()


def family_of(table: LawTable) -> Family:
    """The family of a law of the study."""
    family = family_stored(table.dist)
    if family is None:
        raise FolderError(f"study.resolved.json is damaged: there is no distribution {table.dist[:60]!r}")
    return family


def law_of(resolved: Resolved, name: str) -> Law | None:
    """The law of a random number of the study; None where it is not random."""
    found = resolved.random.get(name)
    if found is None:
        return None
    return stored_law(found, name)


def stored_law(found: LawTable, name: str) -> Law:
    """The law that a table holds, of what is called `name`."""
    family = family_of(found)
    if family.observed:
        return Law(
            family=family,
            parameters=found.parameters,
            data=tuple(found.data),
            draws=tuple(found.draws),
            lower=-np.inf if found.lower is None else found.lower,
            upper=np.inf if found.upper is None else found.upper,
        )
    try:
        return make_law(found.dist, found.parameters, found.lower, found.upper)
    except LawError as error:
        raise FolderError(f"study.resolved.json is damaged: {name}: {error}") from error


def _tests_of(folder: Path) -> dict[str, str]:
    """The tests that the study file names for its strengths: how many, what they measured with its range and unit."""
    found: dict[str, str] = {}
    try:
        limits = tomllib.loads(read_whole(folder / "study.toml").decode()).get("limits", {})
        for name, limit in limits.items():
            table = limit.get("strength", {})
            if not isinstance(table, dict) or "file" not in table:
                continue
            key = next((key for key in ("force", "energy", "column") if key in table), "")
            rows = open_observations(table["file"], folder)
            at = rows.place_of(table[key])
            values = [float(row[at]) for _, row in rows.lines if len(row) > at and row[at]]
            unit = str(table.get(f"{key}_unit", table.get("unit", "")))
            what = {"force": "failure force", "energy": "energy at failure"}.get(key, str(table.get(key)))
            ends = f"{min(values):.3g} to {max(values):.3g} {unit}".rstrip()
            found[strength_name(name)] = f"{len(values)} tests ({what} {ends}, {Path(table['file']).name})"
        for name, limit in limits.items():
            same = isinstance(limit.get("strength"), dict) and limit["strength"].get("same_as")
            if same in found:
                found[strength_name(name)] = found[same]
    except (AccessError, ValueError, KeyError, AttributeError, TypeError):
        # a folder whose study is told without its file still has its answers
        return found
    return found


def read_contents(folder: Path, tests: Mapping[str, str] | None = None) -> Contents:
    """Everything stored that the report shows; a service has the tests of the study that it belongs to.

    Raises FolderError when a file is missing or is not what a run writes.
    """
    results = read_results(folder)
    manifest, resolved = read_manifest(folder), read_resolved(folder)
    strange = [name for name in results.limits if name not in resolved.limits]
    strange += [name for name in results.inputs if name not in resolved.random]
    if strange:
        raise FolderError(f"{folder / 'results.json'} is not that of the study beside it: {strange[0]!r}")
    tests = _tests_of(folder) if tests is None else tests
    services = {name: read_contents(folder / "services" / name, tests) for name in results.services}
    own = {} if results.rig == NO_RIG else _of_rig(folder)
    return Contents(results=results, manifest=manifest, resolved=resolved, services=services, tests=tests, **own)


def _of_rig(folder: Path) -> dict[str, Any]:
    """What is stored of the rows of the study's own rig."""
    inputs, quantities, rows = read_points(folder)
    d, q = len(inputs), len(quantities)
    good = rows[:, -1] == 0.0
    samples = {
        name: Samples(values=rows[good, d + k], censored=rows[good, d + q + k] > 0.0)
        for k, name in enumerate(quantities)
    }
    courses = load_document(folder / "courses.json") if (folder / "courses.json").is_file() else None
    if courses is not None and not (isinstance(courses, dict) and {"time", "force_a", "hardest"} <= courses.keys()):
        raise FolderError(f"{folder / 'courses.json'} is not what a run writes")
    return {
        "samples": samples,
        "failed": float(1.0 - good.mean()) if len(good) else 0.0,
        "points": {name: rows[good, k] for k, name in enumerate(inputs)},
        "courses": courses,
        "fields": read_fields(folder),
        "replicates": (np.arange(len(rows)) * min(REPLICATES, len(rows)) // max(len(rows), 1))[good],
        "sliders": read_entry(folder / "sliders.json", Sliders) if (folder / "sliders.json").is_file() else None,
    }


def subject_of(results: Results, solve: str) -> str:
    """The name whose unit the free scalar has: a strength has that of its limit's quantity."""
    return quantity_of(solve, {limit: str(entry.quantity) for limit, entry in results.limits.items()})


# --- units ----------------------------------------------------------------------------------------------

#: state at fracture -> the quantity whose unit it is read in
_STATE: Final = {"time": "contact_time", "force": "P_max", "energy": "energy", "specific_energy": "specific_energy"}
#: numbers of the scene -> the quantity whose unit they are read in
_NUMBERS: Final = {"P_0_median": "P_max", "t_c_median": "contact_time"}


Values = Iterable[tuple[str, Iterable[float | None]]]


def _grouped(pairs: Values) -> dict[str, list[float]]:
    """The values that are known, by name."""
    found: dict[str, list[float]] = {}
    for name, values in pairs:
        found.setdefault(name, []).extend(float(value) for value in values if value is not None)
    return found


def _deciding(results: Results) -> Values:
    """What was asked for, and decides the unit."""
    for name, quantity in results.quantities.items():
        yield name, (e.value for e in (quantity.mean, *quantity.quantiles.values()))
    yield from ((name, [law.mean]) for name, law in results.inputs.items())
    for margin in results.margins.values():
        yield subject_of(results, margin.solve), (e.value for e in margin.values.values())
        if margin.family:
            yield margin.family.path, (member.value for member in margin.family.members)


def _following(results: Results) -> Values:
    """What else is read."""
    states = results.fracture.states()
    for key, name in _STATE.items():
        yield name, (e.value for e in states[key].quantiles.values()) if key in states else ()
    yield from ((name, [results.model.numbers.get(key)]) for key, name in _NUMBERS.items())


def units_of(*runs: Results, courses: Mapping[str, Json] | None = None) -> dict[str, str]:
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
    first = _grouped(pair for results in runs for pair in _deciding(results))
    second = _grouped(pair for results in runs for pair in _following(results))
    if courses is not None:
        # the largest pressure, tension and force of the hardest scene
        hardest = courses["hardest"]
        second.setdefault("P_max", []).append(max(max(hardest["force_a"]), max(hardest["force_b"])))
        if (contact := hardest.get("contact")) is not None:
            second.setdefault("p_max", []).append(contact["pressure"])
            second.setdefault("core_tension", []).append(0.05 * contact["pressure"])
    groups = {**{name: values for name, values in second.items() if values}, **first}
    return {name: unit_that_reads(name, values) for name, values in groups.items() if lookup(name).display}
