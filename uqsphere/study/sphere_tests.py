"""A strength from crushing tests on spheres: force at failure and diameter become what the limit is held against.

Every test is taken for a static compression between two flat platens.  Its force gives contact pressure, contact
radius and stored energy by Hertz, with the stiffness that the study has for the sphere, and the criterion of the limit
makes the demand out of them: what it was at the failure is the strength of that specimen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from uqsphere.materials import library
from uqsphere.mechanics.criteria import CRITERIA
from uqsphere.mechanics.criteria import demand as demand_of
from uqsphere.mechanics.outputs import at_force, follows_force
from uqsphere.study.columns import Observations, open_observations, unit_factor
from uqsphere.study.document import SphereTestsTable
from uqsphere.study.faults import Findings, Misplaced, Place, Raw, shown
from uqsphere.study.numbers import Reading
from uqsphere.study.scene import Scene
from uqsphere.study.tables import read_table
from uqsphere.units import Quantity, UnitError, parse_value
from uqsphere.uq.families import LawError
from uqsphere.uq.fitting import fitted_law
from uqsphere.uq.law import Law

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]

#: columns at the failure of every test, (n,) each, by the names of the nomenclature
Columns = Mapping[str, Any]
#: what a column holds, by its key
_COLUMNS: Final = {
    "force": Quantity(name="force", symbol="P", dimension="force", meaning="the force at failure"),
    "diameter": Quantity(name="diameter", symbol="D", dimension="length", meaning="the diameter"),
    "rate": Quantity(name="rate", symbol="dP/dt", dimension="loading_rate", meaning="the loading rate"),
}


@dataclass(frozen=True, kw_only=True)
class Demand:
    """What a limit holds against its strength: a quantity, or a criterion with its parameters by a name of its own."""

    quantity: str
    criterion: str | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)


def is_sphere_tests(raw: object) -> bool:
    """Whether a strength is written as tests that give a force."""
    return isinstance(raw, Mapping) and raw.get("dist") == "empirical" and "force" in raw


def read_sphere_tests(
    raw: Mapping[str, Raw], place: Place, demand: Demand, scene: Scene, findings: Findings
) -> Reading | None:
    """The law of the strength against a demand; None, with the faults noted, where there is none."""
    table = read_table(SphereTestsTable, raw, findings, place)
    if demand.criterion is None and not follows_force(demand.quantity):
        findings.add((*place, "force"), f"a force at failure says nothing of {demand.quantity}")
    sphere = {key: scene.mean(f"sphere.{key}") for key in ("E", "nu", "density")}
    platens = _platens(table.platens, scene)
    stiff = {key: value for key, value in sphere.items() if value is not None}
    if not findings.clean(place) or platens is None or len(stiff) < len(sphere):
        # a sphere without its stiffness has been told of already
        return None
    with findings.noting(place):
        tests = open_observations(table.file, findings.folder)
        columns = _columns(table, tests)
        stopped = None if table.censored is None else tests.flags(table.censored, "censored")
        try:
            return Reading(value=_law(table, _at_failure(columns, stiff, platens), stopped, demand))
        except LawError as error:
            key = "force" if error.key in ("column", "file") else error.key
            raise Misplaced(error.message, key if key in raw else "") from None
        except ValueError as error:
            raise Misplaced(f"the tests cannot be turned into a strength: {error}") from None
    return None


def _columns(table: SphereTestsTable, tests: Observations) -> dict[str, tuple[float, ...]]:
    """Force, diameter and rate of every test in SI; raises Misplaced."""
    found = {"force": _positive(table.force, table.force_unit, tests, "force")}
    try:
        same = parse_value(table.diameter, "length")
    except UnitError:
        found["diameter"] = _positive(table.diameter, table.diameter_unit, tests, "diameter")
    else:
        if same <= 0.0:
            raise Misplaced(f"found {shown(table.diameter)}: the diameter must be above 0", "diameter")
        found["diameter"] = (same,) * len(tests.lines)
    if table.rate is not None:
        found["rate"] = _positive(table.rate, table.rate_unit, tests, "rate")
    return found


def _positive(column: str, unit: str | None, tests: Observations, key: str) -> tuple[float, ...]:
    """A column of numbers above zero in SI, which a rate may be too; raises Misplaced."""
    factor = unit_factor(unit, _COLUMNS[key], f"{key}_unit")
    values = tests.numbers(column, key, factor)
    for (line, _), value in zip(tests.lines, values, strict=True):
        if value < 0.0 or (value == 0.0 and key != "rate"):
            found = f"{_COLUMNS[key].meaning} must be above 0, found {value / factor:g}"
            raise Misplaced(f"line {line} of {shown(tests.name)}: {found}", key)
    return values


def _platens(name: str, scene: Scene) -> tuple[float, float] | None:
    """Young's modulus and Poisson ratio of what the spheres were crushed between; an infinite modulus if rigid."""
    if name == "rigid":
        return math.inf, 0.3
    if name == "bars":
        stiffness, ratio = scene.mean("bars.E"), scene.mean("bars.nu")
        return None if stiffness is None or ratio is None else (stiffness, ratio)
    entry = library()["bars"][name].properties
    return entry["E"].value, entry["nu"].value


def _law(table: SphereTestsTable, state: Columns, flags: tuple[bool, ...] | None, demand: Demand) -> Law:
    """The law of the strengths of the tests at whose failure the state is; raises LawError, ValueError."""
    import numpy as np

    def fitted(parameters: Mapping[str, float]) -> Law:
        values = _strengths(state, demand, parameters)
        stopped = np.zeros(values.shape, dtype=bool) if flags is None else np.array(flags)
        rest = values[stopped].tolist()
        return fitted_law(values[~stopped].tolist(), table.fit, censored=rest, unbiased=table.unbiased)

    parameters = dict(demand.parameters)
    needs = demand.criterion is not None and "modulus" in CRITERIA[demand.criterion].parameters
    if not needs or "modulus" in parameters:
        return fitted(parameters)
    if table.fit != "weibull":
        raise LawError('the strength of a weakest link is a Weibull law: fit = "weibull" is due', "fit")
    # the modulus makes the demand, and the demand the modulus
    modulus = 8.0
    for _ in range(60):
        law = fitted({**parameters, "modulus": modulus})
        before, modulus = modulus, law.parameters["modulus"]
        if abs(modulus - before) < 1e-10 * modulus:
            return law
    raise ValueError("no modulus agrees with itself: give it by the key modulus of the limit")


def _at_failure(
    columns: Mapping[str, tuple[float, ...]], sphere: Mapping[str, float], platens: tuple[float, float]
) -> Columns:
    """What the criteria read, (n,) each, at the force of every test."""
    import numpy as np

    from uqsphere.mechanics import contact

    force, radius = np.array(columns["force"]), 0.5 * np.array(columns["diameter"])
    modulus = contact.reduced_modulus(sphere["E"], sphere["nu"], platens[0], platens[1])
    return at_force(force, {
        "modulus": modulus, "effective_radius": radius, "hertz_constant": contact.hertz_constant(modulus, radius),
        "mass": contact.sphere_mass(radius, sphere["density"]),
        "loading_rate": np.array(columns.get("rate", (0.0,) * force.size)),
        "sphere.radius": radius, "sphere.E": np.full(force.size, sphere["E"]),
        "sphere.nu": np.full(force.size, sphere["nu"]),
    })  # fmt: skip


def _strengths(state: Columns, of: Demand, parameters: Mapping[str, float]) -> Array:
    """The demand of the limit at the failure of every test, (n,)."""
    import numpy as np

    if of.criterion is not None:
        return demand_of(CRITERIA[of.criterion], state, parameters)
    return np.asarray(state[of.quantity], dtype=float)
