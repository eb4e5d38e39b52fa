"""A strength from crushing tests on spheres: force at failure and diameter become what the limit is held against.

Every test is taken for a static compression between two flat platens.  Its force gives contact pressure, contact
radius and energy by the study's law of the contact, with the stiffness, onset and hardness that the study has for the
sphere (platens are harder), and the criterion of the limit makes the demand out of them: what it was at the failure is
the strength of that sphere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.mechanics import contact
from uqsphere.mechanics.criteria import CRITERIA, pole_of
from uqsphere.mechanics.criteria import demand as demand_of
from uqsphere.mechanics.outputs import Columns, at_force, follows_force
from uqsphere.study.document import RIG_TABLES
from uqsphere.study.faults import Findings, Misplaced, Place, Raw
from uqsphere.study.numbers import Reading, Tested
from uqsphere.study.particle_tables import ENERGY_OF, SphereTestsTable
from uqsphere.study.scene import Scene, read_platens
from uqsphere.study.tables import read_table
from uqsphere.study.tests import Measured, read_measured, share_of
from uqsphere.uq import Law, LawError
from uqsphere.uq.fitting import fitted_law

#: columns at the failure of every test, (n,) each, by the names of the nomenclature
State = Mapping[str, Any]
#: where tests belong that give no strength by themselves
_TO_FIT: Final = '`uqsphere fit` makes a law of such tests, strength = { fit = "DIR" } takes it'
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


@dataclass(frozen=True, kw_only=True)
class Demand:
    """What a limit holds against its strength: a quantity, or a criterion with its parameters by a name of its own."""

    quantity: str
    criterion: str | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)


def is_sphere_tests(raw: object) -> bool:
    """Whether a strength is written as tests that give a force, or an energy: by `tests`, or by `dist` and `file`."""
    if not isinstance(raw, Mapping):
        return False
    return "tests" in raw or (raw.get("dist") == "empirical" and ("force" in raw or "energy" in raw))


def read_sphere_tests(
    raw: Mapping[str, Raw], place: Place, demand: Demand, scene: Scene, findings: Findings
) -> Reading | None:
    """The law of the strength against a demand; None, with the faults noted, where there is none."""
    table = read_table(SphereTestsTable, raw, findings, place)

    file, key = _file_of(table, place, findings)
    _check_measured(table, place, demand, findings)
    platens = read_platens(table.platens or "bars", (*place, "platens"), scene, findings)
    keys = ("E", "nu", "density")
    stiff = {key: value for key in keys if (value := scene.mean(f"sphere.{key}")) is not None}
    measured = read_measured(table, file, place, findings, key=key, rig="platens") if file else None
    if not findings.clean(place) or measured is None or platens is None or len(stiff) < len(keys):
        # a sphere without its stiffness has been told of already
        return None
    with findings.noting(place):
        columns = _columns(table, file, measured, stiff["density"])
        _compare_sizes(columns["diameter"], place, demand, scene, findings)
        _compare_rates(place, demand, scene, findings)
        try:
            state = _at_failure(columns, {**stiff, **_yields(scene)}, platens, measured.stiffness)
            state = _beside(_with_energy(state, columns, table, stiff, platens), stiff, platens, scene)
            law = _law(table, state, measured.broken == 0, demand)
        except LawError as error:
            key = "force" if error.key in ("column", "file") else error.key
            raise Misplaced(error.message, key if key in raw else "") from None
        except ValueError as error:
            raise Misplaced(f"the tests cannot be turned into a strength: {error}") from None
        growth = columns["rate"] / columns["force"] if {"rate", "force"} <= columns.keys() else np.zeros(1)
        tested = Tested(diameter=float(columns["diameter"].mean()), growth=float(np.median(growth)) or None)
        return Reading(value=law, made_up=table.made_up, tested=tested)
    return None


def _file_of(table: SphereTestsTable, place: Place, findings: Findings) -> tuple[str, str]:
    """The file of the tests and the key that names it; an empty name, with the fault noted, where there is none."""
    if table.tests is None:
        if not table.file:
            findings.lack((*place, "file"), 'file is missing: add file = "tests.csv"')
        return table.file or "", "file"
    if table.file is not None:
        findings.add((*place, "file"), "tests names a file too: leave one of them out")
    return table.tests, "tests"


def _with_energy(
    state: State,
    columns: Mapping[str, Array],
    table: SphereTestsTable,
    sphere: Mapping[str, float],
    platens: tuple[float, float],
) -> State:
    """The state with the three definitions of an energy that was measured; slow platens offer what is stored."""
    energy = columns.get("energy")
    if energy is None:
        return state
    both = energy / share_of(sphere["E"], sphere["nu"], platens) if table.energy_is == "sphere" else energy
    return {**state, "energy": both, "specific_energy": both / state["mass"], "impact_energy": energy,
            "specific_impact_energy": energy / state["mass"]}  # fmt: skip


def _check_measured(table: SphereTestsTable, place: Place, demand: Demand, findings: Findings) -> None:
    """Note what was measured where it says nothing of the demand."""
    key = "energy" if table.energy is not None else "specific_energy"
    if table.speed is not None:
        findings.add((*place, "speed"), f"a speed is what was offered, not what broke the sphere: {_TO_FIT}")
    if demand.criterion is None and not follows_force(demand.quantity):
        key = key if getattr(table, key) is not None else "force"
        findings.add((*place, key), f"a force at failure says nothing of {demand.quantity}")
    if getattr(table, key) is None:
        return
    if table.force is not None:
        findings.add((*place, key), f"force is given too: leave one of force or {key} out")
    if _base(demand) not in ENERGY_OF.values():
        findings.add((*place, key), f"an energy at failure says nothing of {_base(demand)}: name a column of forces")
    if table.energy_is == "input" and _base(demand) != ENERGY_OF["input"]:
        said = "what was offered to a sphere is not what it took"
        findings.add((*place, "energy_is"), f'{said}: it goes with energy_is = "input" of the limit alone')


def _base(demand: Demand) -> str:
    """The quantity that a demand is of."""
    return demand.quantity if demand.criterion is None else str(CRITERIA[demand.criterion].quantity)


def _compare_sizes(diameters: Array, place: Place, demand: Demand, scene: Scene, findings: Findings) -> None:
    """Tests on spheres of another size: told, and refused where the criterion knows no size."""
    radius = scene.mean("sphere.radius")
    if radius is None:
        return
    mean = sum(diameters.tolist()) / len(diameters)
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
    ends = [pick(MEASURED_RATES, key=lambda entry: entry[1]) for pick in (min, max)]
    rates = " to ".join(f"{rate:g} 1/s for {rock}" for rock, rate, _ in ends)
    gains = [more for *_, more in MEASURED_RATES]
    said = f"slow tests in a quick rig: struck, rocks bore {min(gains):g} to {max(gains):g} times as much; that is"
    findings.warn(place, f"{said} safe to survive and unsafe to break; rate_0 of the criterion carries it ({rates})")


def _columns(table: SphereTestsTable, file: str, measured: Measured, density: float) -> dict[str, Array]:
    """Force or energy, diameter and rate of every test in SI; raises Misplaced for tests that are no strengths."""
    if table.censored is not None and table.outcome is not None:
        raise Misplaced("outcome is given too: leave one of them out", "censored")
    alike = measured.particles > 1
    again = (measured.blows > 1) | (np.bincount(measured.specimen)[measured.specimen] > 1)
    for key, wrong, said in (
        ("rig", ~measured.at_failure, "this rig gives what was offered, not what broke the sphere"),
        ("particles", alike, "a strength takes one particle a row"),
        ("specimen", again, "a strength takes one blow a particle"),
    ):
        for row in np.flatnonzero(wrong)[:1]:
            raise Misplaced(f"{file}:{measured.lines[row]}: {said}: {_TO_FIT}", key)
    if len(measured.value) < 2:
        raise Misplaced(f"found {len(measured.value)} test, two or more are due", "tests" if table.tests else "file")
    kind, value = str(measured.kind[0]), measured.value
    if kind == "specific_energy":
        mass = measured.mass if measured.mass is not None else contact.sphere_mass(0.5 * measured.diameter, density)
        kind, value = "energy", value * mass
    found = {"diameter": measured.diameter, kind: value}
    return found if measured.rate is None else {**found, "rate": measured.rate}


def _law(table: SphereTestsTable, state: State, stopped: Flags, demand: Demand) -> Law:
    """The law of the strengths of the tests at whose failure the state is; raises LawError, ValueError."""

    def fitted(parameters: Mapping[str, float]) -> Law:
        values = _strengths(state, demand, parameters)
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


def _yields(scene: Scene) -> dict[str, float]:
    """Onset and hardness of a sphere whose poles yield in the test as well."""
    if scene.options.get("contact.law") != "plastic":
        return {}
    known = {key: scene.mean(f"sphere.{key}") for key in ("onset_pressure", "hardness")}
    return {key: value for key, value in known.items() if value is not None}


def _at_failure(
    columns: Mapping[str, Array], sphere: Mapping[str, float], platens: tuple[float, float], measured: Array | None
) -> State:
    """What the criteria read, (n,) each, at the force of every test; `measured` are stiffnesses K_e of the contact."""
    radius = 0.5 * columns["diameter"]
    plane = contact.reduced_modulus(sphere["E"], sphere["nu"], platens[0], platens[1])
    modulus = np.full(radius.size, plane) if measured is None else measured
    # what was measured as an energy is put in its place afterwards
    force = columns.get("force", np.ones(radius.size))
    return at_force(force, {
        "modulus": modulus, "effective_radius": radius, "hertz_constant": contact.hertz_constant(modulus, radius),
        "mass": contact.sphere_mass(radius, sphere["density"]),
        "loading_rate": columns.get("rate", np.zeros(force.size)),
        "sphere.radius": radius, "sphere.E": np.full(force.size, sphere["E"]),
        "sphere.nu": np.full(force.size, sphere["nu"]),
        "face": pole_of({f"sphere.{key}": value for key, value in sphere.items()}, modulus, radius),
    })  # fmt: skip


def _strengths(state: State, of: Demand, parameters: Mapping[str, float]) -> Array:
    """The demand of the limit at the failure of every test, (n,)."""
    if of.criterion is not None:
        return demand_of(CRITERIA[of.criterion], state, parameters)
    return np.asarray(state[of.quantity], dtype=float)


# --- energies ------------------------------------------------------------------------------------------


def _beside(state: State, sphere: Mapping[str, float], platens: tuple[float, float], scene: Scene) -> State:
    """The state at failure with the energies that the study's own partners would store beside the sphere's share."""
    share = share_of(sphere["E"], sphere["nu"], platens)
    own = share * state["energy"] + state["dissipated"]
    found = {"energy_sphere": own, "specific_energy_sphere": own / state["mass"]}
    tables = [table for table in RIG_TABLES[str(scene.options.get("rig.kind", "bars"))] if table != "bars"]
    partners = [(scene.mean(f"{table}.E"), scene.mean(f"{table}.nu")) for table in tables]
    shares = [share_of(sphere["E"], sphere["nu"], (E, nu)) for E, nu in partners if E is not None and nu is not None]
    if shares:
        both = (own - state["dissipated"]) * len(shares) / sum(shares)
        found |= {"energy": both, "specific_energy": both / state["mass"]}
    return Columns({**state, **found})
