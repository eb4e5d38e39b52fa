"""A strength from crushing tests on spheres: force at failure and diameter become what the limit is held against.

Every test is taken for a static compression between two flat platens.  Its force gives contact pressure, contact
radius and stored energy by Hertz, with the stiffness that the study has for the sphere, and the criterion of the limit
makes the demand out of them: what it was at the failure is the strength of that specimen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from uqsphere.materials import library
from uqsphere.mechanics.criteria import CRITERIA
from uqsphere.mechanics.criteria import demand as demand_of
from uqsphere.mechanics.outputs import at_force, follows_force
from uqsphere.study.columns import Rows, column_values, open_table, read_flags, unit_factor
from uqsphere.study.faults import Findings, Place, one_of, shown, suggestion
from uqsphere.study.numbers import Reading
from uqsphere.study.scene import Scene
from uqsphere.units import UNITS, Quantity, UnitError, parse_value
from uqsphere.uq.fitting import fitted_law
from uqsphere.uq.law import Law, LawError

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]

__all__ = ["Demand", "is_sphere_tests", "read_sphere_tests"]

_KEYS: Final = (
    "dist", "file", "force", "force_unit", "diameter", "diameter_unit", "rate", "rate_unit", "censored", "platens",
    "fit", "unbiased",
)  # fmt: skip
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
    raw: Mapping[str, Any],
    place: Place,
    demand: Demand,
    scene: Scene,
    findings: Findings,
    folder: Path,
) -> Reading | None:
    """The law of the strength against a demand; None, with the faults noted, where there is none."""
    before = len(findings.faults)
    for key in raw:
        if key not in _KEYS:
            near = suggestion(key, _KEYS) or f"; tests on spheres take {one_of(_KEYS[1:])}"
            findings.add((*place, key), f"unknown key {shown(key)}{near}")
    if not _convertible(demand):
        findings.add((*place, "force"), f"a force at failure says nothing of {demand.quantity}")
    file = raw.get("file")
    if not isinstance(file, str) or not file:
        findings.add(place, 'tests need file = "tests.csv"')
        return None
    rows = open_table(file, (*place, "file"), findings, folder)
    if rows is None:
        return None
    columns = _columns(raw, rows, file, place, findings)
    flags = read_flags(raw, place, findings, folder) if "censored" in raw else None
    platens = _platens(raw.get("platens", "bars"), (*place, "platens"), scene, findings)
    sphere = {key: scene.mean(f"sphere.{key}") for key in ("E", "nu", "density")}
    if not isinstance(raw.get("unbiased", False), bool):
        findings.add((*place, "unbiased"), f"found {shown(raw['unbiased'])}, where true or false is due")
    if len(findings.faults) > before or columns is None or platens is None or None in sphere.values():
        # a sphere without its stiffness has been told of already
        return None
    stiff = {key: float(value) for key, value in sphere.items() if value is not None}
    try:
        law = _law(raw, columns, flags, stiff, platens, demand)
    except LawError as error:
        key = "force" if error.key in ("column", "file") else error.key
        findings.add((*place, key) if key in raw else place, error.message)
        return None
    except ValueError as error:
        findings.add(place, f"the tests cannot be turned into a strength: {error}")
        return None
    return Reading(value=law)


def _convertible(demand: Demand) -> bool:
    return demand.criterion is not None or follows_force(demand.quantity)


def _columns(
    raw: Mapping[str, Any], rows: Rows, file: str, place: Place, findings: Findings
) -> dict[str, tuple[float, ...]] | None:
    """Force, diameter and rate of every test in SI."""
    if len(rows) < 2:
        findings.add((*place, "file"), f"there are no tests in {shown(file)}: at least two failures are needed")
        return None
    found: dict[str, tuple[float, ...]] = {}
    for key, quantity in _COLUMNS.items():
        name = raw.get(key)
        if name is None:
            if key == "diameter":
                findings.add(place, 'tests need their diameter: a column, or a value such as diameter = "16 mm"')
            continue
        if not isinstance(name, str) or not name:
            findings.add((*place, key), f"found {shown(name)}, where the name of a column is due")
            continue
        if key == "diameter" and (same := _one_value(name)) is not None:
            found[key] = (same,) * (len(rows) - 1)
            continue
        unit = {"unit": raw[f"{key}_unit"]} if f"{key}_unit" in raw else {}
        if not unit:
            units = ", ".join(name for name in UNITS[quantity.dimension] if name.isascii() and "^" not in name)
            findings.add(place, f"the unit of the column is missing: add {key}_unit (units: {units})")
            continue
        factor = unit_factor(unit, (*place, f"{key}_unit"), quantity, findings)
        values = column_values(rows, {"file": file, "column": name}, place, findings, factor, key)
        for (line, _), value in zip(rows[1:], values, strict=False):
            if value < 0.0 or (value == 0.0 and key != "rate"):
                text = f"line {line} of {shown(file)}: {quantity.meaning} must be above 0, found {value / factor:g}"
                findings.add((*place, key), text)
                break
        found[key] = values
    return found if all(found.get(key) for key in ("force", "diameter")) else None


def _one_value(text: str) -> float | None:
    """A length that stands for all tests, where the text is one."""
    try:
        value = parse_value(text, "length")
    except UnitError:
        return None
    return value if value > 0.0 else None


def _platens(raw: object, place: Place, scene: Scene, findings: Findings) -> tuple[float, float] | None:
    """Young's modulus and Poisson ratio of what the spheres were crushed between; an infinite modulus if rigid."""
    if raw == "rigid":
        return float("inf"), 0.3
    if raw == "bars":
        stiffness, ratio = scene.mean("bars.E"), scene.mean("bars.nu")
        return None if stiffness is None or ratio is None else (stiffness, ratio)
    known = library()["bars"]
    if isinstance(raw, str) and raw in known:
        entry = known[raw].properties
        return float(entry["E"].value), float(entry["nu"].value)
    words = ["bars", "rigid", *known]
    near = suggestion(raw, words) if isinstance(raw, str) else ""
    findings.add(place, f"found {shown(raw)}, allowed: {one_of(words)}{near}")
    return None


def _law(
    raw: Mapping[str, Any],
    columns: Mapping[str, tuple[float, ...]],
    flags: tuple[bool, ...] | None,
    sphere: Mapping[str, float],
    platens: tuple[float, float],
    demand: Demand,
) -> Law:
    """Raises LawError, ValueError."""
    import numpy as np

    stopped = np.zeros(len(columns["force"]), dtype=bool) if flags is None else np.array(flags)
    state = _at_failure(columns, sphere, platens)
    fit, unbiased = raw.get("fit", "weibull"), raw.get("unbiased", False)

    def fitted(parameters: Mapping[str, float]) -> Law:
        values = _strengths(state, demand, parameters)
        return fitted_law(values[~stopped].tolist(), fit, censored=values[stopped].tolist(), unbiased=unbiased)

    parameters = dict(demand.parameters)
    needs = demand.criterion is not None and "modulus" in CRITERIA[demand.criterion].parameters
    if not needs or "modulus" in parameters:
        return fitted(parameters)
    if fit != "weibull":
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
) -> Mapping[str, Any]:
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


def _strengths(state: Mapping[str, Any], of: Demand, parameters: Mapping[str, float]) -> Array:
    """The demand of the limit at the failure of every test, (n,)."""
    import numpy as np

    if of.criterion is not None:
        return demand_of(CRITERIA[of.criterion], state, parameters)
    return np.asarray(state[of.quantity], dtype=float)
