"""[limits.NAME]: a demand and its strength, and strengths from the forces at which spheres broke in
tests.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from uqsphere.arrays import Array, Duo, Places
from uqsphere.documents import Fault, declared, one_of, suggestion, unknown, within
from uqsphere.materials import materials_of
from uqsphere.mechanics.contact import reduced_modulus
from uqsphere.mechanics.criteria import CERTAIN, CRITERIA, PARAMETERS
from uqsphere.mechanics.crushing import value_at
from uqsphere.mechanics.rigs import LAW, sphere_body
from uqsphere.quantities import INPUTS, OUTPUTS, lookup, plain_quantity
from uqsphere.tables import Table
from uqsphere.units import UNITS, Quantity, shown
from uqsphere.uq import Law
from uqsphere.uq.fitting import modulus_of

from .document import LimitTable
from .plausibility import range_of
from .study import DEFAULT_TARGET, Draft, Limit
from .values import (
    FARTHEST_SIZE,
    TESTS,
    Number,
    Observations,
    Tested,
    fit,
    is_tests,
    number_of,
    observations,
    value_of,
    warn_of_rows,
    warn_unusual,
)

#: the energy that a strength in J/kg is based on, and the demand that is compared with it
_ENERGIES = {
    "contact": "specific_energy",
    "sphere": "specific_energy_sphere",
    "input": "specific_impact_energy",
}
_PRESSURES = (
    'strength_is is missing. Set it to "hertz" if the strength was computed from a failure force '
    'by Hertz, as nearly all tabulated contact strengths are, or to "pressure" if it is a true '
    "pressure, which never exceeds the hardness. The probabilities can differ by decades"
)
#: ratio of the diameters of tests and sphere above which a warning is given; above `FARTHEST_SIZE`
#: a size law is required
_SIZES_TOLD = 1.1
#: a criterion increases at least with this power of the force
_RISES = 0.05
#: at equal strength the force goes with this power of the diameter, without flaws (default: 2)
_POWERS = {
    "ring_crack": 1.0,
    "ring_crack_toughness": 1.0,
    "energy": 0.2,
    "energy_sphere": 0.2,
    "P_max": 0.0,
}
#: usual strengths by dimension [SI], where the pressures are tensions, and those of contacts
_USUAL = {"pressure": (1e5, 5e9), "specific_energy": (1.0, 2e4), "toughness": (1e4, 2e7)}
_CONTACT = (3e7, 1e11)
#: tensile strengths of brittle spheres [Pa]; a factor off them within which 0.9 P/D² is usual
_TENSION, _FAR = (4e6, 2.5e7), 20.0
#: units that a file of tests may have been in
_LENGTHS, _FORCES = ("um", "mm", "cm", "m"), ("N", "kN", "MN")
#: 0.9 P/D² of a test over the median, or the other way round, above which its unit is asked about
_SLIP = 300.0
_FACTOR = Quantity(name="model_factor", meaning="the model factor", plausible=(0.5, 2.0))


def read_limit(draft: Draft, name: str, table: LimitTable) -> None:
    """One limit: demand, strength and model factor; raises Fault."""
    limit = _demand(draft, name, table)
    of_fracture = sorted(key for key, entry in OUTPUTS.items() if entry.fracture)
    if table.fracture and not table.criterion and limit.quantity not in of_fracture:
        raise Fault(
            f"{limit.quantity} is not a fracture quantity; fracture = true needs a criterion or "
            f"one of {one_of(of_fracture)}",
            "fracture",
        )
    with draft.within("model_factor"):
        factor = number_of(table.model_factor, _FACTOR, draft)
    with draft.within("strength"):
        strength = _strength(draft, table, limit)
    if limit.needs_modulus:
        fitted = modulus_of(strength.value)
        modulus = limit.parameters.get("modulus", fitted)
        if modulus is None:
            raise Fault(
                "modulus is missing. Add it, or use a strength with a Weibull distribution",
                "modulus",
            )
        if fitted is None:
            draft.warn(
                "a weakest-link strength has a Weibull distribution with the modulus of the "
                "limit; with another distribution P_f does not follow from the flaws"
            )
        elif abs(fitted - modulus) > 1e-9 * modulus:
            raise Fault(
                f"modulus must be that of the strength, {fitted:g}, not {modulus:g}. Remove "
                "modulus",
                "modulus",
            )
        limit = replace(limit, parameters={"modulus": modulus, **limit.parameters})
    draft.numbers |= {f"limits.{name}.strength": strength, f"limits.{name}.model_factor": factor}
    draft.limits[name] = replace(
        limit, strength=strength.value, model_factor=factor.value, tested=strength.tested
    )


def _demand(draft: Draft, name: str, table: LimitTable) -> Limit:
    """A limit without its strength; raises Fault."""
    quantity = table.quantity
    criterion = table.criterion
    if quantity is not None and quantity not in draft.quantities:
        raise Fault(unknown("quantity", quantity, draft.quantities), "quantity")
    if criterion and draft.box:
        raise Fault(
            "a criterion needs the impact model. Set quantity to an output of the black box",
            "criterion",
        )
    if criterion == "specific_energy":
        if not (table.energy_is or draft.rig.by_wave):
            raise Fault(
                "energy_is is missing. Set it to the energy that the strength is based on: "
                f"{one_of(map(shown, _ENERGIES))}",
                "energy_is",
            )
        criterion = _ENERGIES[table.energy_is or "contact"]
    parameters = {part: value for part, value in table if part in PARAMETERS and value is not None}
    if not criterion:
        for part in parameters:
            raise Fault(
                f"{part} is used only with a criterion (uqsphere list criteria). Add criterion = …",
                part,
            )
    else:
        entry = CRITERIA[criterion]
        takes = (*entry.parameters, *entry.optional)
        for part in parameters:
            if part not in takes:
                raise Fault(
                    f"{part} is not a key of the criterion {criterion}, which takes "
                    f"{one_of(takes)}. Remove it",
                    part,
                )
        for part in entry.parameters:
            # the strength, which is read later, may have the modulus
            if part not in (*parameters, "modulus"):
                raise Fault(
                    f"{part} is missing. Add it: the {PARAMETERS[part].meaning} is required by the "
                    f"criterion {criterion}",
                    part,
                )
        if entry.quantity and not parameters:
            quantity = entry.quantity
            criterion = None
    compared = _compared(draft, table, str(criterion or quantity))
    return Limit(
        name=name,
        quantity=f"{compared}.{name}" if criterion else compared,
        criterion=criterion,
        parameters=parameters,
        strength=math.nan,
        aim=table.aim,
        target=table.target or DEFAULT_TARGET,
        has_target=table.target is not None,
        fracture=table.fracture,
    )


def _compared(draft: Draft, table: LimitTable, demand: str) -> str:
    """What a strength is compared with: p_hertz in place of a pressure where it is one by Hertz,
    which a yielding contact does not reach; raises Fault.
    """
    meant = table.strength_is
    pressure = demand in ("p_max", "first_peak")
    if meant and not pressure and (demand, meant) != ("p_hertz", "hertz"):
        raise Fault(
            f"strength_is is used only with p_max and first_peak, not with {demand}. Remove it",
            "strength_is",
        )
    if not (draft.plastic and pressure):
        return demand
    if not meant and draft.document.contact.law:
        raise Fault(_PRESSURES, "strength_is")
    if meant == "pressure" and is_tests(table.strength):
        raise Fault(
            'forces at failure become pressures by Hertz. Set strength_is = "hertz"', "strength_is"
        )
    if demand == "p_max" and meant != "pressure":
        return "p_hertz"  # as nearly all tabulated contact strengths are
    if meant == "hertz":
        raise Fault(
            'first_peak is a true pressure if contacts yield. Set strength_is = "pressure", or '
            'quantity = "p_max"',
            "strength_is",
        )
    return demand


def _strength(draft: Draft, table: LimitTable, limit: Limit) -> Number:
    """A strength: a number or distribution in the unit of the demand, or one from tests; raises
    Fault.
    """
    if draft.box:
        number = number_of(table.strength, plain_quantity(limit.quantity), draft)
        if number.tested and number.tested.exponent:
            raise Fault(
                "the draws have a size_exponent, by which their strength follows the diameter of a "
                "sphere, and a black box has no sphere. Remove the column size_exponent: they then "
                f"hold for the output {limit.quantity} as they are",
                "draws",
            )
        return number
    entry = lookup(limit.quantity)
    usual = _USUAL.get(entry.dimension, (0.0, math.inf))
    if entry.place == "contact":
        usual = _CONTACT
    entry = replace(
        entry, meaning=f"the strength against {limit.quantity}", closed=False, plausible=usual
    )
    if is_tests(table.strength):
        number = _tested(draft, declared(Observations, {"fit": "weibull", **table.strength}), limit)
        warn_unusual(number.mean, entry, draft)
        return number
    number = number_of(table.strength, entry, draft)
    compare_sizes(limit, number.tested, _radii(draft), draft, "draws")
    return number


# --- strengths from crushing tests ----------------------------------------------------------------


def _tested(draft: Draft, table: Observations, limit: Limit) -> Number:
    """The distribution of the strength from forces at failure, and the tests themselves; raises
    Fault.
    """
    demand = limit.criterion or limit.quantity
    if not (limit.criterion or lookup(demand).follows):
        raise Fault(
            f"forces at failure do not determine {demand}. Use a criterion (uqsphere list "
            "criteria)",
            "force",
        )
    platens = _platens(draft, table.platens)
    sphere = _sphere(draft, platens)
    cells, lines, columns, stopped = observations(table, draft, **TESTS)
    force = columns["force"]
    diameter = columns["diameter"]
    rate = columns.get("rate", 0.0)
    tension = _warn_of_slips(table, cells, lines, columns, draft)
    warn_of_rows(table, cells, lines, tension, stopped, draft)

    power = _POWERS.get(demand, 2.0)
    mean = float(diameter.mean())
    # flaws lie in the surface around a contact, or in the volume
    flaws = 2.0 if lookup(limit.quantity).place in ("contact", "rim", "below") else 3.0

    def by_size(exponent: float) -> tuple[Law, float]:
        law = fit(force * (mean / diameter) ** exponent, stopped, table)
        return law, power and power - flaws / (modulus_of(law) or math.inf)

    law, exponent = _fixed_point(by_size, power)
    tested = Tested(
        diameter=mean,
        forces=tuple(force.tolist()),
        diameters=tuple(diameter.tolist()),
        platens=platens,
        sphere=sphere,
        law=law,
        exponent=exponent,
    )
    compare_sizes(limit, tested, _radii(draft), draft, "diameter")
    if not draft.rig.by_press and "rate_0" not in limit.parameters:
        _warn_of_rate(draft, limit)

    def value(modulus: float, factor: float = 1.0) -> Array:
        weakest = replace(limit, parameters={"modulus": modulus, **limit.parameters})
        return value_at(factor * force, weakest.demand, sphere, 0.5 * diameter, platens, rate)

    slopes = np.log(value(8.0, 1.01) / value(8.0)) / math.log(1.01)
    largest = limit.parameters.get("largest_energy", math.inf)
    if not (value(8.0) < largest * CERTAIN).all():
        raise Fault(
            f"some tests exceed the largest possible {demand}. Raise largest_energy or the hardness"
        )
    if not (slopes > _RISES).all():
        raise Fault(
            f"{demand} is insensitive to the force of such tests, so the strength cannot be "
            "inferred. Check that the diameter is no radius, and both units; else use another "
            "criterion"
        )

    def by_value(modulus: float) -> tuple[Law, float]:
        law = fit(value(modulus), stopped, table, slope=float(np.median(slopes)))
        return law, modulus_of(law) or modulus

    law, _ = _fixed_point(by_value, 8.0) if limit.needs_modulus else by_value(8.0)
    return Number(value=law, synthetic=table.synthetic, tested=tested)


def _warn_of_rate(draft: Draft, limit: Limit) -> None:
    """Warn of quasi-static tests in a rig that loads dynamically: where the sphere is to break, the
    strength that is left out is on the unsafe side.
    """
    text = (
        "the tests were quasi-static, but the rig loads dynamically, and rock was then 1.24 to "
        "2.12 times as strong"
    )
    way = f"test the strength of {limit.name} at the rate of the rig"
    demand = limit.quantity.partition(".")[0]
    if any(
        "rate_0" in entry.optional and demand in (name, entry.quantity)
        for name, entry in CRITERIA.items()
    ):
        way = f"set limits.{limit.name}.rate_0 (110 to 760 1/s)"
    if limit.aim == "survive":
        draft.warn(f"{text}. Ignoring this is conservative; to include it, {way}")
    else:
        draft.warn(f"{text}, so fewer would break than computed: {way}", holds="rate")


def _fixed_point(fitted: Callable[[float], tuple[Law, float]], start: float) -> tuple[Law, float]:
    """A distribution that depends on a number, and the number that follows from it: exponent of the
    size law, modulus of a weakest link; raises Fault.
    """
    from scipy.optimize import fixed_point

    start = fitted(start)[1]  # a fault of the tests themselves is reported first
    try:
        agreed = fixed_point(
            lambda x: fitted(float(x))[1], start, xtol=1e-11, maxiter=200, method="iteration"
        )
        return fitted(float(agreed))
    except (Fault, RuntimeError):
        raise Fault(
            "the fit of Weibull modulus and size effect did not converge. Check the diameters, or "
            "set modulus"
        ) from None


def compare_sizes(
    limit: Limit, tested: Tested | None, radii: Sequence[float], draft: Draft, key: str
) -> None:
    """Warn of tests of a limit that have another diameter than the sphere, of its first radius [m].

    Raises Fault if no size law, of the tests or of the criterion itself, scales them to one of the
    radii.
    """
    if not tested:
        return
    linked = limit.needs_modulus or (modulus_of(tested.law) and tested.exponent)
    ratios = [
        max(tested.diameter / (2.0 * radius), 2.0 * radius / tested.diameter) for radius in radii
    ]
    refused = not linked and max(ratios) > FARTHEST_SIZE
    radius = radii[ratios.index(max(ratios))] if refused else radii[0]
    sizes = (
        f"the tests of {limit.name} have a mean diameter of {1e3 * tested.diameter:.4g} mm, the "
        f"sphere of {2e3 * radius:.4g} mm"
    )
    if refused:
        way = 'set fit = "weibull"'
        if not tested.law:
            way = "fit again with strength_at of this size"
        elif not _POWERS.get(limit.criterion or limit.quantity, 2.0):
            way = "hold the tests against a pressure or tension: a force has no size law"
        raise Fault(
            f"{sizes}, and no size law covers more than 50 %. Test spheres of this size, or {way}",
            key,
        )
    if ratios[0] > _SIZES_TOLD:
        scaling = "not scaled"
        if linked:
            scaling = "scaled by the weakest link"
        elif tested.exponent and not tested.law:
            scaling = "scaled by its size_exponent"
        draft.warn(f"{sizes}: the strength is {scaling}", key)


def _warn_of_slips(
    table: Observations, cells: Table, lines: Places, columns: Mapping[str, Array], draft: Draft
) -> Array:
    """Warn of forces [N] and diameters [m] that no sphere has, with what would make them usual.

    Returns 0.9 P/D² [Pa] of every test (n,), that of a test of which a slip is told at the median.
    """
    force = columns["force"]
    diameter = columns["diameter"]
    across = 2.0 * draft.mean("sphere.radius")
    # around the tensile strength of the material
    low, high, _ = range_of(draft.materials.get("sphere", ""), "tensile_strength")
    if math.isnan(low):
        low, high = _TENSION
    low, high = low / _FAR, high * _FAR

    def is_usual(force: Array, diameter: Array) -> bool:
        typical = np.median(0.9 * force / np.square(diameter))
        return bool(low <= typical <= high and 1 / 3 <= np.median(diameter) / across <= 3.0)

    of_force = cells.units["force"]
    of_length = cells.units.get("diameter", math.nan)
    tension: Array = 0.9 * force / np.square(diameter)
    typical = np.median(tension)
    far = np.abs(np.log(diameter / across)) > math.log(3.0)
    slips = np.abs(np.log(tension / typical)) > math.log(_SLIP)
    key = "force"
    likely = []
    if slips.any():
        first = np.argmax(slips)
        ratios = {
            key: columns[key][first] / np.median(columns[key]) for key in ("force", "diameter")
        }
        key = max(ratios, key=lambda key: abs(math.log(ratios[key])))
        text = f"line {lines[first]}: the {key} is {ratios[key]:,.4g} times the median"
        tension[slips] = typical
    elif far.any():
        key = "diameter"
        text = (
            f"{far.sum()} of {len(far)} diameters differ from the sphere's by more than a factor "
            f"of three, the first is {1e3 * diameter[far][0]:.4g} mm"
        )
        likely = [u for u in _LENGTHS if is_usual(force, diameter * UNITS["length"][u] / of_length)]
    elif low <= typical <= high:
        return tension
    else:
        text = (
            f"0.9 P/D² is {1e-6 * typical:,.3g} MPa, usual are {1e-6 * low:g} to {1e-6 * high:g} "
            "MPa"
        )
        likely = [u for u in _FORCES if is_usual(force * UNITS["force"][u] / of_force, diameter)]
    hint = f"is the unit {one_of(likely or ['right'])}?"
    if is_usual(diameter * (of_force / of_length), force * (of_length / of_force)):
        hint = "are the columns of force and diameter swapped?"
    draft.warn(f"{table.file}: {text}: {hint}", key, holds="unit")
    return tension


# --- the sphere in the tests ----------------------------------------------------------------------


def _platens(draft: Draft, raw: Any) -> Duo:
    """E [Pa], infinite if rigid, and nu of the platens of the tests; raises Fault."""
    choices = {"bars": (draft.mean("bars.E"), draft.mean("bars.nu")), "rigid": (math.inf, 0.3)}
    for name, material in materials_of("bars").items():
        choices[name] = material.properties["E"].value, material.properties["nu"].value
    with within("platens"):
        if isinstance(raw, Mapping) and set(raw) == {"E", "nu"}:
            return value_of(raw["E"], INPUTS["bars.E"]), value_of(raw["nu"], INPUTS["bars.nu"])
        if not isinstance(raw, str) or raw not in choices:
            raise Fault(
                f"must be {one_of([*map(shown, choices), 'a table of E and nu'])}, not {shown(raw)}"
                f"{suggestion(raw, choices)}"
            )
        if math.isnan(choices[raw][0]):
            raise Fault('this rig has no bars. Set platens to "rigid" or to a material')
    return choices[raw]


def _radii(draft: Draft) -> Sequence[float]:
    """The mean radius of the sphere [m], and its 1 % and 99 % quantiles if it is random."""
    radius = draft.numbers["sphere.radius"]
    radii = [radius.mean]
    if isinstance(radius.value, Law):
        radii += radius.value.ppf([0.01, 0.99]).tolist()
    return radii


def _sphere(draft: Draft, platens: Duo) -> dict[str, float]:
    """The sphere of the tests at its means, as `uqsphere.mechanics.crushing` takes it."""
    assert draft.scene is not None
    sphere = {key: draft.mean(f"sphere.{key}") for key in ("E", "nu", "density")}
    E, nu, _ = sphere.values()
    # the counter-bodies of the study's rig store energy in the contacts too
    sphere["partner"] = 1.0 / draft.contact_modulus - (1.0 - nu * nu) / E
    # the platens may be the partner in the rig; then the same body yields, else the sphere
    face: Any = sphere_body(draft.scene.columns)
    takes = 1.0
    modulus = reduced_modulus(E, nu, *platens)
    for partner in reversed(draft.scene.there):
        if np.isclose(partner.modulus[0], modulus, rtol=1e-9):
            face = partner.face
            takes = float(partner.takes[0])
    if draft.plastic and face:
        law = parameters_of(face)
        if np.isfinite([*law.values()]).all():
            return sphere | law | {"takes": takes}
    return sphere


def parameters_of(face: Any) -> dict[str, float]:
    """Onset and hardness [Pa] and pile-up of a contact law, by their keys in a study."""
    values = (face.onset, face.hardness, face.pile_up)
    return {key: float(value[0]) for key, value in zip(LAW, values, strict=True)}
