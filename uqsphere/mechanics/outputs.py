"""Quantities of interest: their definitions, and the answers of a batch of scenes in SI.

A quantity is one entry of ``outputs.toml``, with its formula here.  One that a criterion names as
its `quantity` and that is not there, such as the core tension, is the demand of that criterion:
all of it is in ``criteria.toml``.
"""

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from functools import partial, reduce
from operator import itemgetter, or_
from typing import Any

import numpy as np

from uqsphere.arrays import Array, ColumnMap, Flags, Places, Values, frozen, quiet
from uqsphere.units import Quantity

from . import contact
from .criteria import CRITERIA, Demands, demand
from .inputs import declared
from .integrator.tracked import DOMAIN, NOT_FINITE, WISHES
from .scene import Partner, Scene, answered
from .yielding import Press

#: compliance of a half-space under a harmonic point load, nu = 1/4, times rho c_s³ (Reissner;
#: Miller and Pursey 1954)
_RADIATION = 0.1486
#: radiated fraction of the impact energy over D beta^1.2 M^-0.2 v^0.6 for Hertz's P(t), (R14)
_PULSE = 3.80584
#: quantities that are the demand of a criterion, by their names
_DEMAND_OF = {entry.quantity: entry for entry in CRITERIA.values() if entry.quantity}
#: every quantity of interest of the impact model
OUTPUTS = declared("outputs.toml", Quantity)
OUTPUTS |= {
    name: replace(entry, name=name, meaning=entry.measures)
    for name, entry in _DEMAND_OF.items()
    if name not in OUTPUTS
}


def _hertz_pressure(columns: ColumnMap, force: Values) -> Values:
    """p_0 of the contact that gives the scale factors, at a force [N]."""
    return contact.pressure_at_force(force, columns["modulus"], columns["effective_radius"])


#: quantities as functions of columns: of the scene, its scale factors, the integrator, and other
#: quantities; any other one is the product of the columns that it needs
FORMULAS = {
    **dict.fromkeys(("p_max", "p_hertz"), lambda c: _hertz_pressure(c, c["P_max"])),
    "P_max": lambda c: c["force"] * c["x_max"] ** c["power"],
    "a_max": lambda c: contact.contact_radius(
        contact.approach_at_force(c["P_max"], c["hertz_constant"]), c["effective_radius"]
    ),
    "p_mean": lambda c: c["P_max"] / (np.pi * np.square(c["a_max"])),
    "loading_rate": lambda c: 0.8 * c["P_max"] / c["rise_time"],
    "first_peak": lambda c: _hertz_pressure(c, c["force"] * c["x_first"] ** c["power"]),
    "force_imbalance": lambda c: c["difference"] / c["x_max"] ** c["power"],
    "specific_energy": lambda c: c["energy"] / c["mass"],
    "energy_sphere": lambda c: c["share"] * c["energy"],
    "specific_energy_sphere": lambda c: c["energy_sphere"] / c["mass"],
    "specific_impact_energy": lambda c: c["impact_energy"] / c["mass"],
    "transmitted_energy": lambda c: c["carried_off"],
}


class Columns(dict[str, Any]):
    """Columns of n rows by name, (n,) each, and every quantity of `OUTPUTS`, computed when read.

    A value is a column, or a function without arguments that returns it when it is first read.
    """

    @quiet
    def __getitem__(self, name: str) -> Values:
        source = self.get(name)
        if source is None:
            source = self._quantity(name)
        elif callable(source):
            source = source()
        self[name] = source
        return source

    def _quantity(self, name: str) -> Values:
        if name in FORMULAS:
            return FORMULAS[name](self)
        if name in _DEMAND_OF:
            return demand(_DEMAND_OF[name], self)
        return math.prod(self[column] for column in OUTPUTS[name].needs)


def columns_of(scene: Scene, rows: Places | slice = slice(None)) -> dict[str, Any]:
    """Numbers and scale factors of some rows of a scene, and the sphere's share of the energy."""
    numbers = {**scene.columns, **scene.scales._asdict(), "share": scene.struck.share}
    return {name: column[rows] for name, column in numbers.items()}


def _roots(names: Iterable[str], demands: Demands) -> set[str]:
    """What quantities and demands are computed from: names of `tracked.answer_columns`, and inputs
    that may be absent.
    """
    roots = set()
    for name in names:
        if name in demands:
            key, parameters = demands[name]
            roots |= _roots(CRITERIA[key].needs_with(parameters), demands)
        elif name in OUTPUTS:
            roots |= _roots(OUTPUTS[name].needs, demands)
        else:
            roots.add(name)
    return roots


def wishes(quantities: Collection[str] | None, demands: Demands) -> int:
    """Flags `tracked.WANT_*` of what the integrator must track for quantities and demands.

    quantities: all of `OUTPUTS` if None.
    """
    names = OUTPUTS if quantities is None else quantities
    return reduce(or_, (WISHES.get(root, 0) for root in _roots(names, demands)), 0)


# --- contacts that differ, or yield ---------------------------------------------------------------


def columns_of_press(press: Press, takes: Values) -> dict[str, Array]:
    """Columns of a contact that yields.

    `p_field` is the Hertz pressure of the same force on the same circle, from which the stress
    inside the sphere follows.  `p_rim` is the same, except where the sphere `takes` the plastic
    work: there the rim tension is at most Hertz's for the same force.
    """
    field = 1.5 * press.p_mean
    rim = np.where(takes > 0.0, press.p_hertz, field)
    return {**press._asdict(), "p_field": field, "p_rim": rim}


def _side(scene: Scene, partner: Partner, x: Array) -> Columns:
    """Columns of one contact at its peak approach x alpha_c: force, pressures, radius, energy."""
    scales = scene.scales
    beta = partner.hertz_constant
    approach = scales.approach * x
    if partner.face is not None:
        state = partner.face.pressed(approach / partner.face.onset_approach)
        return Columns(columns_of_press(state, partner.takes))
    return Columns(
        modulus=partner.modulus,
        effective_radius=partner.effective_radius,
        hertz_constant=beta,
        P_max=scales.force * (x * np.sqrt(x)) * (beta / scales.hertz_constant),
        alpha_max=approach,
        **dict.fromkeys(("dent_left", "dissipated"), np.zeros(len(scene))),
        stored=lambda: contact.contact_energy(approach, beta),
    )


#: columns of a row that are the largest over its contacts, each separately
_LARGEST = ("P_max", "alpha_max", "a_max", "p_max", "p_mean", "p_hertz", "dent_left")


def _of_faces(scene: Scene, tracked: ColumnMap) -> dict[str, Any]:
    """Columns of contacts that differ or yield: of each contact ("sides"), and of the row.

    The stress inside the sphere depends on the force at the other contact as well: `balance` is
    that force over the contact's own, at its peak.
    """
    if scene.by_hertz:
        return {}
    force = scene.scales.force
    single = len(scene.there) == 1
    sides = []
    for partner in scene.there:
        side = _side(scene, partner, tracked[f"x_{partner.pole}"])
        side["takes"] = partner.takes
        if not scene.by_wave:
            other = 0.0 if single else force * tracked[f"other_{partner.pole}"]
            side["balance"] = np.where(side["P_max"] > 0.0, other / side["P_max"], 0.0)
        sides.append(side)

    def largest(column: str) -> Values:
        return np.maximum.reduce([side[column] for side in sides])

    def first_peak() -> Values:
        firsts = [_side(scene, p, tracked[f"x_first_{p.pole}"])["p_max"] for p in scene.there]
        return np.maximum.reduce(firsts)

    def energy_of_sphere() -> Values:
        """chi of the energy in each contact, and plastic work where the sphere itself yields."""
        stored = tracked.get("stored_sphere", scene.struck.share * tracked["stored"])
        plastic = sum(side["takes"] * side["dissipated"] for side in sides)
        return force * scene.scales.approach * stored + plastic

    columns: dict[str, Any] = {
        "sides": sides,
        **{column: partial(largest, column) for column in _LARGEST},
        "energy_sphere": energy_of_sphere,
        "dissipated": lambda: sum(side["dissipated"] for side in sides),
    }
    if f"x_first_{scene.struck.pole}" in tracked:
        columns["first_peak"] = first_peak
    if single:
        # a single contact loads the centre by half
        names = ("mean_force_max", "force_at_centre")
        return columns | dict.fromkeys(names, lambda: 0.5 * sides[0]["P_max"])
    columns["force_imbalance"] = lambda: force * tracked["difference"] / largest("P_max")
    if not scene.by_wave:
        columns["force_at_centre"] = lambda: force * tracked["mean_force"]
    return columns


def _of_impact(scene: Scene, tracked: ColumnMap) -> dict[str, Any]:
    """Columns of an impact: its energy, speeds after it, energy radiated as waves."""
    if not scene.setup.by_impact:
        return {}
    scales = scene.scales
    behind = scene.partners[0]
    radiated = loss_to_waves(scene)
    if radiated is not None and "end_speed" in tracked:
        # at most what the contact leaves
        radiated = np.minimum(radiated, np.square(tracked["end_speed"]))
    # P_c alpha_c = m V_c², (R5)
    offered = 0.5 * scales.force * scales.approach

    def carried_off() -> Values:
        if radiated is not None:
            return radiated * offered
        total = np.zeros(len(scene))
        for partner in scene.there:
            name = f"carried_{partner.pole}"
            if _carries(partner) and name in tracked:
                total = total + scales.force**2 * scales.time / partner.impedance * tracked[name]
        return total

    columns = {"offered": offered, "carried_off": carried_off}
    if behind is not None:
        return columns | dict.fromkeys(("leaving", "parting_speed"), -tracked["end_speed_a"])
    back = -tracked["end_speed"]
    parting = tracked["end_speed_b"] - tracked["end_speed"]
    if radiated is not None:
        back = parting = np.sqrt(np.maximum(np.square(parting) - radiated, 0.0))
    return columns | {"leaving": back, "parting_speed": parting}


@quiet
def loss_to_waves(scene: Scene) -> Values | None:
    """Fraction of the impact energy that a thick target radiates, (n,), (R14).

    The compliance is that of nu = 1/4.  None for other targets, or without a density.
    Source: S. C. Hunter, J. Mech. Phys. Solids 5 (1957) 162, from memory.
    """
    behind, ahead = scene.partners
    given = f"{ahead.table}.density" in scene.columns
    if behind is not None or ahead.kind != "thick" or not given:
        return None
    scales, (E, nu, density) = scene.scales, scene.numbers(ahead.table, "E nu density")
    shear_speed = np.sqrt(E / (2.0 * (1.0 + nu) * density))
    compliance = _RADIATION / (density * shear_speed**3)
    contact_factor = scales.hertz_constant**1.2 * scales.mass**-0.2
    return _PULSE * compliance * contact_factor * scales.speed**0.6


def _carries(partner: Partner) -> bool:
    """Whether a counter-body radiates waves by its impedance."""
    return partner.kind in ("bar", "plate")


def absent_in(scene: Scene, quantity: str) -> str:
    """Why a scene does not have a quantity of interest, in words; empty if it has it."""
    roots = _roots([quantity], scene.demands)
    missing = sorted({name for name in roots if "." in name} - scene.columns.keys())
    if missing:
        return f"{quantity} needs {' and '.join(missing)}; add them to the study"
    rig = scene.setup

    def rests_on(*columns: str) -> bool:
        return not roots.isdisjoint(columns)

    if rests_on("difference") and not rig.behind:
        return "there is only one contact, so that the imbalance is 1 by definition"
    if rests_on("parting", "touches") and scene.by_wave:
        return "between bars, reflected waves load the sphere again and again"
    if rests_on("carried_off") and scene.by_wave:
        return "bars carry waves in both directions; see history"
    if rests_on("offered", "leaving", "parting_speed") and not rig.by_impact:
        return "this rig loads the sphere by a wave or slowly, not by impact"
    if rests_on("parting", "touches", "contact", "duration", "carried_off") and rig.by_press:
        return "platens load slowly and stay in contact"
    radiate = any(map(_carries, scene.there))
    if rests_on("carried_off") and not radiate and loss_to_waves(scene) is None:
        return "the counter-bodies radiate no waves (for a thick target, set its density)"
    timed = {"platens.speed", "platens.loading_rate"} & scene.columns.keys()
    if rests_on("rise") and rig.by_press and not timed:
        return 'the platens have no speed; set speed, for example "1 mm/min", or loading_rate'
    if rests_on("x_first") and not (scene.by_wave or np.any(scene.reflections)):
        return "no reflected wave returns to the sphere"
    faces = [partner.face for partner in scene.there]
    if rests_on("dent_left", "dissipated") and not any(faces):
        return 'both bodies are elastic; set contact.law = "plastic"'
    return ""


# --- answers of a batch ---------------------------------------------------------------------------


@frozen
class SceneAnswers:
    """Quantities of interest of n rows, (n,) arrays.

    values: the requested quantities, SI; NaN where `status` is not 0.  censored: of
    time_to_first_loss, whether the evaluation window ended first, so that the value is a lower
    bound.  grazes: above 0 where, at the finest tolerance, an error may still decide when contact
    is first or finally lost, or change a duration (`tracked.GRAZES`); or change a peak
    (`tracked.RATTLES`).  status: a key of `scene.STATUS`.  record: end of the evaluation window
    [s], or the time after which no requested quantity could change.  steps: of the integrator.
    """

    values: Mapping[str, Array]
    censored: Mapping[str, Flags]
    grazes: Array
    status: Places
    record: Array
    steps: Places


def merged_answers(*parts: tuple[Places, SceneAnswers]) -> SceneAnswers:
    """Answers of one batch from parts, each with its rows, that together are all rows."""
    order = np.argsort(np.concatenate([rows for rows, _ in parts]))

    def joined(columns: list[Any]) -> Any:
        if isinstance(columns[0], Mapping):
            return {name: joined([*map(itemgetter(name), columns)]) for name in columns[0]}
        return np.concatenate(columns)[order]

    return SceneAnswers(**joined([vars(part) for _, part in parts]))


def _value(scene: Scene, columns: Columns, quantity: str) -> Values:
    why = absent_in(scene, quantity)
    if why.startswith(quantity):
        raise ValueError(why)
    if why:
        raise ValueError(f"{quantity} is not available: {why}")
    if quantity not in scene.demands:
        return columns[quantity]
    key, parameters = scene.demands[quantity]
    return demand(CRITERIA[key], columns, parameters)


@quiet
def answers_from(
    scene: Scene,
    tracked: ColumnMap,
    *,
    linear: bool = False,
    quantities: Collection[str] | None,
) -> SceneAnswers:
    """Answers in SI from scaled results of the integrator or of a closed form.

    tracked: what `tracked.answer_columns` has, (n,) each.  linear: the force is proportional to
    the approach; the pressure follows from the force by Hertz.  quantities: all available ones if
    None.  A row with a quantity that is not finite gets the status `NOT_FINITE`.

    Raises ValueError for a quantity that the scene does not have.
    """
    made = {**_of_faces(scene, tracked), **_of_impact(scene, tracked)}
    columns = Columns({**columns_of(scene), **tracked, "power": 1.0 if linear else 1.5, **made})
    if quantities is None:
        quantities = (*(name for name in OUTPUTS if not absent_in(scene, name)), *scene.demands)
    values = {name: _value(scene, columns, name) for name in quantities}
    finite = np.isfinite([columns["x_max"], *values.values()]).all(axis=0)
    status = columns["status"]
    status = np.where(answered(status) & ~finite, NOT_FINITE, status)
    for partner, side in zip(scene.there, columns.get("sides", ()), strict=False):
        if partner.kind == "bar" and not scene.by_wave:
            # the contact is wider than the end of its rod
            wide = 2.0 * side["a_max"] > scene.columns[f"{partner.table}.diameter"]
            status = np.where(answered(status) & wide, DOMAIN, status)
    good = answered(status)
    return SceneAnswers(
        values={name: np.where(good, value, np.nan) for name, value in values.items()},
        censored={
            name: (columns[OUTPUTS[name].censored] > 0.0) & good
            for name in values
            if name in OUTPUTS and OUTPUTS[name].censored
        },
        grazes=np.nan_to_num(columns["grazes"]),
        status=status,
        record=scene.scales.time * columns["ended"],
        steps=columns["steps"],
    )
