"""A strength from crushing tests on spheres: force at failure and diameter become what the limit is held against.

Every test is taken for a static compression between two flat platens.  Its force gives contact pressure, contact
radius and stored energy by Hertz, with the stiffness that the study has for the sphere, and the criterion of the limit
makes the demand out of them: what it was at the failure is the strength of that specimen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.materials import library
from uqsphere.mechanics import contact
from uqsphere.mechanics.criteria import CRITERIA
from uqsphere.mechanics.criteria import demand as demand_of
from uqsphere.mechanics.outputs import Columns, at_force, follows_force
from uqsphere.quantities import INPUTS
from uqsphere.study.columns import Observations, open_observations, unit_factor
from uqsphere.study.document import ENERGY_OF, RIG_TABLES, SphereTestsTable
from uqsphere.study.faults import Findings, Misplaced, Place, Raw, one_of, shown
from uqsphere.study.numbers import Reading, read_fixed
from uqsphere.study.scene import Scene
from uqsphere.study.tables import read_table
from uqsphere.units import Quantity, UnitError, parse_value
from uqsphere.uq.families import LawError
from uqsphere.uq.fitting import fitted_law
from uqsphere.uq.law import Law

#: columns at the failure of every test, (n,) each, by the names of the nomenclature
State = Mapping[str, Any]
#: ratio of the mean diameters of tests and sphere that is told, and that only a modulus can carry
_TOLD, _REFUSED = 1.1, 1.5
#: rock, rate_0 [1/s] and mean of the dynamic over the slow strength [-]: slow uniaxial strengths (36 cylinders) against
#: those between titanium bars at 36 to 346 1/s (86), Rae and others, 2020 and 2021; rate_0 by least squares of
#: logarithms in 1 + (rate/rate_0)^(2/3), which leaves 10 to 27 % (docs/validation.md)
MEASURED_RATES: Final = (
    ("granite of Malsburg", 760.0, 1.24),
    ("quartzite of the Taunus", 380.0, 1.36),
    ("gneiss of Maggia along its layers", 260.0, 1.52),
    ("across them", 160.0, 1.9),
    ("sandstone of Seebergen", 240.0, 1.63),
    ("limestone of Savonnieres", 190.0, 1.79),
    ("marble of Carrara", 110.0, 2.12),
)
#: what a column holds, by its key
_COLUMNS: Final = {
    "energy": Quantity(name="energy", symbol="W", dimension="energy", meaning="the energy at failure"),
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
    """Whether a strength is written as tests that give a force, or an energy."""
    return isinstance(raw, Mapping) and raw.get("dist") == "empirical" and ("force" in raw or "energy" in raw)


def read_sphere_tests(
    raw: Mapping[str, Raw], place: Place, demand: Demand, scene: Scene, findings: Findings
) -> Reading | None:
    """The law of the strength against a demand; None, with the faults noted, where there is none."""
    table = read_table(SphereTestsTable, raw, findings, place)
    _check_measured(table, place, demand, findings)
    sphere = {key: scene.mean(f"sphere.{key}") for key in ("E", "nu", "density")}
    platens = read_platens(table.platens, (*place, "platens"), scene, findings)
    stiff = {key: value for key, value in sphere.items() if value is not None}
    if not findings.clean(place) or platens is None or len(stiff) < len(sphere):
        # a sphere without its stiffness has been told of already
        return None
    with findings.noting(place):
        tests = open_observations(table.file, findings.folder)
        columns = _columns(table, tests)
        stopped = None if table.censored is None else tests.flags(table.censored, "censored")
        _compare_sizes(columns["diameter"], place, demand, scene, findings)
        _compare_rates(place, demand, scene, findings)
        try:
            state = _at_failure(columns, stiff, platens)
            if table.energy is not None:
                state = {
                    **state,
                    **_by_energy(np.array(columns["energy"]), str(table.energy_is), stiff, platens, state),
                }
            law = _law(table, _beside(state, stiff, platens, scene), stopped, demand)
            return Reading(value=law, made_up=table.made_up)
        except LawError as error:
            key = "force" if error.key in ("column", "file") else error.key
            raise Misplaced(error.message, key if key in raw else "") from None
        except ValueError as error:
            raise Misplaced(f"the tests cannot be turned into a strength: {error}") from None
    return None


def _check_measured(table: SphereTestsTable, place: Place, demand: Demand, findings: Findings) -> None:
    """Note what was measured where it says nothing of the demand, or is not told in full."""
    both = table.force is not None and table.energy is not None
    key, unit, example = ("energy", "energy_unit", "J") if table.energy is not None else ("force", "force_unit", "kN")
    if both:
        findings.add((*place, "energy"), "force is given too: leave one of force or energy out")
    elif getattr(table, unit) is None and findings.clean((*place, unit)):
        findings.add((*place, unit), f'{unit} is missing: add {unit} = "{example}"')
    if demand.criterion is None and not follows_force(demand.quantity):
        findings.add((*place, key), f"a force at failure says nothing of {demand.quantity}")
    if table.energy is None:
        if table.energy_is is not None:
            findings.add((*place, "energy_is"), "energy_is belongs to a column of energies: leave it out")
        return
    if _base(demand) not in ENERGY_OF.values():
        findings.add(
            (*place, "energy"), f"an energy at failure says nothing of {_base(demand)}: name a column of forces"
        )
    if table.energy_is is None and findings.clean((*place, "energy_is")):
        findings.add((*place, "energy_is"), f"energy_is is missing: say what the energies are, {one_of(ENERGY_OF)}")
    elif table.energy_is == "input" and _base(demand) != ENERGY_OF["input"]:
        said = "what was offered to a sphere is not what it took"
        findings.add((*place, "energy_is"), f'{said}: it goes with energy_is = "input" of the limit alone')


def _base(demand: Demand) -> str:
    """The quantity that a demand is of."""
    return demand.quantity if demand.criterion is None else str(CRITERIA[demand.criterion].quantity)


def _compare_sizes(
    diameters: tuple[float, ...], place: Place, demand: Demand, scene: Scene, findings: Findings
) -> None:
    """Tests on spheres of another size: told, and refused where the criterion knows no size."""
    radius = scene.mean("sphere.radius")
    if radius is None:
        return
    mean = sum(diameters) / len(diameters)
    ratio = max(mean / (2.0 * radius), 2.0 * radius / mean)
    found = f"the tests have a mean diameter of {1e3 * mean:.4g} mm, the sphere of {2e3 * radius:.4g} mm"
    knows = demand.criterion is not None and "modulus" in CRITERIA[demand.criterion].parameters
    if ratio > _REFUSED and not knows and scene.options.get("rig.kind", "bars") != "bars":
        due = "test spheres of this size, or take a criterion with a modulus, such as weakest_link_volume"
        findings.add((*place, "diameter"), f"{found}: a strength by this criterion does not know its size; {due}")
    elif ratio > _TOLD:
        carried = "the modulus of the criterion carries it" if knows else "nothing carries the strength over"
        findings.warn((*place, "diameter"), f"{found}: {carried}")


def _compare_rates(place: Place, demand: Demand, scene: Scene, findings: Findings) -> None:
    """Slow tests in a rig that is quick: what rocks were measured to bear more there is said."""
    if scene.options.get("rig.kind", "bars") == "platens" or "rate_0" in demand.parameters:
        return
    rates = ", ".join(f"{rate:g} for {rock}" for rock, rate, _ in MEASURED_RATES)
    gains = [more for *_, more in MEASURED_RATES]
    said = f"slow tests in a quick rig: struck, rocks bore {min(gains):g} to {max(gains):g} times as much; that is"
    findings.warn(
        place, f"{said} safe to survive and unsafe to break; rate_0 of the criterion carries it (in 1/s: {rates})"
    )


def _columns(table: SphereTestsTable, tests: Observations) -> dict[str, tuple[float, ...]]:
    """Force or energy, diameter and rate of every test in SI; raises Misplaced."""
    measured = "force" if table.energy is None else "energy"
    found = {measured: _positive(str(getattr(table, measured)), getattr(table, f"{measured}_unit"), tests, measured)}
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


def read_platens(
    raw: str | Mapping[str, Raw], place: Place, scene: Scene, findings: Findings
) -> tuple[float, float] | None:
    """Young's modulus and Poisson ratio of what a strength was measured between; an infinite modulus if rigid.

    None, with the fault noted, where there are none.
    """
    if isinstance(raw, Mapping):
        E = read_fixed(raw["E"], (*place, "E"), INPUTS["bars.E"], findings)
        nu = read_fixed(raw["nu"], (*place, "nu"), INPUTS["bars.nu"], findings)
        return None if E is None or nu is None else (E, nu)
    if raw == "rigid":
        return math.inf, 0.3
    if raw == "bars":
        stiffness, ratio = scene.mean("bars.E"), scene.mean("bars.nu")
        if scene.options.get("rig.kind", "bars") != "bars" and findings.clean(place):
            said = 'there are no bars here: say what it was measured between, platens = "rigid" or a material'
            findings.add(place, said)
        return None if stiffness is None or ratio is None else (stiffness, ratio)
    entry = library()["bars"][raw].properties
    return entry["E"].value, entry["nu"].value


def _law(table: SphereTestsTable, state: State, flags: tuple[bool, ...] | None, demand: Demand) -> Law:
    """The law of the strengths of the tests at whose failure the state is; raises LawError, ValueError."""

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
) -> State:
    """What the criteria read, (n,) each, at the force of every test."""
    radius = 0.5 * np.array(columns["diameter"])
    modulus = contact.reduced_modulus(sphere["E"], sphere["nu"], platens[0], platens[1])
    # what was measured as an energy is put in its place afterwards
    force = np.array(columns.get("force", np.ones(radius.size)))
    return at_force(force, {
        "modulus": modulus, "effective_radius": radius, "hertz_constant": contact.hertz_constant(modulus, radius),
        "mass": contact.sphere_mass(radius, sphere["density"]),
        "loading_rate": np.array(columns.get("rate", (0.0,) * force.size)),
        "sphere.radius": radius, "sphere.E": np.full(force.size, sphere["E"]),
        "sphere.nu": np.full(force.size, sphere["nu"]),
    })  # fmt: skip


def _strengths(state: State, of: Demand, parameters: Mapping[str, float]) -> Array:
    """The demand of the limit at the failure of every test, (n,)."""
    if of.criterion is not None:
        return demand_of(CRITERIA[of.criterion], state, parameters)
    return np.asarray(state[of.quantity], dtype=float)


# --- energies ------------------------------------------------------------------------------------------


def _share(sphere: Mapping[str, float], partner: tuple[float, float]) -> float:
    """chi = E* (1 - nu²)/E, the sphere's share of the energy of a contact, (R22)."""
    modulus = contact.reduced_modulus(sphere["E"], sphere["nu"], partner[0], partner[1])
    return float(modulus * (1.0 - sphere["nu"] ** 2) / sphere["E"])


def _by_energy(
    energy: Array, meaning: str, sphere: Mapping[str, float], platens: tuple[float, float], state: State
) -> dict[str, Array]:
    """Energies of every test as the three definitions have them, (n,) each; slow platens offer what is stored."""
    both = energy / _share(sphere, platens) if meaning == "sphere" else energy
    return {"energy": both, "specific_energy": both / state["mass"], "impact_energy": energy,
            "specific_impact_energy": energy / state["mass"]}  # fmt: skip


def _beside(state: State, sphere: Mapping[str, float], platens: tuple[float, float], scene: Scene) -> State:
    """The state at failure with the energies that the study's own partners would store beside the sphere's share."""
    share = _share(sphere, platens)
    own = share * state["energy"]
    found = {"energy_sphere": own, "specific_energy_sphere": own / state["mass"]}
    tables = [table for table in RIG_TABLES[str(scene.options.get("rig.kind", "bars"))] if table != "bars"]
    partners = [(scene.mean(f"{table}.E"), scene.mean(f"{table}.nu")) for table in tables]
    shares = [_share(sphere, (E, nu)) for E, nu in partners if E is not None and nu is not None]
    if shares:
        both = own * len(shares) / sum(shares)
        found |= {"energy": both, "specific_energy": both / state["mass"]}
    return Columns({**state, **found})
