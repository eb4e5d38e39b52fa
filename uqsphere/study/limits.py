"""[limits.NAME]: what is held against which strength, and strengths from the forces at which
spheres broke in tests.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.documents import Fault, Place, declared, one_of, shown, suggestion, unknown, within
from uqsphere.materials import library
from uqsphere.mechanics.criteria import CRITERIA, PARAMETERS
from uqsphere.mechanics.crushing import value_at
from uqsphere.mechanics.outputs import PATHS, follows_force
from uqsphere.mechanics.rigs import LAW, RIGS, sphere_body
from uqsphere.quantities import INPUTS, lookup, plain_quantity
from uqsphere.study import values
from uqsphere.study.document import Draft, LimitTable
from uqsphere.study.study import DEFAULT_TARGET, Limit
from uqsphere.study.values import Number, Observations, Tested, number_of, value_of
from uqsphere.units import UNITS
from uqsphere.uq import Law
from uqsphere.uq.fitting import modulus_of

#: which energy a strength in J/kg means, and the quantity that is held against it
_ENERGIES: Final = {
    "contact": "specific_energy",
    "sphere": "specific_energy_sphere",
    "input": "specific_impact_energy",
}
_PRESSURES: Final = (
    'strength_is is missing: "hertz" if the strength was computed from a failure force by Hertz, '
    "as nearly all "
    'tabulated contact strengths are; "pressure" if it is a true pressure, which never exceeds '
    "the hardness: the "
    "probabilities can differ by decades"
)
#: ratio of diameters of tests and sphere that is told, and beyond which nothing but a size law
#: carries a strength
_SIZES_TOLD, _SIZES_REFUSED = 1.1, 1.5
#: a criterion rises at least with this power of the force
_RISES: Final = 0.05
#: at equal strength a force goes with this power of the diameter, but for flaws; with its square
#: where nothing is said
_POWERS: Final = {
    "ring_crack": 1.0,
    "ring_crack_toughness": 1.0,
    "energy": 0.2,
    "energy_sphere": 0.2,
    "P_max": 0.0,
}
#: usual strengths by dimension [SI], where the pressures are tensions, and those of contacts
_USUAL: Final = {"pressure": (1e5, 5e9), "specific_energy": (1.0, 2e4), "toughness": (1e4, 2e7)}
_CONTACT: Final = (3e7, 1e11)
#: usual 0.9 P/D² of brittle spheres [Pa], and units that a file of tests may have been in
_TENSION: Final = (2e5, 5e8)
_UNITS: Final = ("um", "mm", "cm", "m", "N", "kN", "MN")
_FACTOR: Final = replace(
    plain_quantity("model_factor", "the model factor", 0.0), plausible=(0.5, 2.0)
)


def read_limit(draft: Draft, name: str, table: LimitTable) -> None:
    """One limit: what is held against its strength, the strength, the factor; raises Fault."""
    place = ("limits", name)
    limit = _demand(draft, name, table)
    if table.fracture and table.criterion is None and limit.quantity not in PATHS:
        paths = one_of(sorted(PATHS))
        raise Fault(
            f"exceeding {limit.quantity} breaks no sphere: fracture = true is for a criterion or "
            f"one of {paths}",
            "fracture",
        )
    with within("model_factor"):
        factor = number_of(table.model_factor, _FACTOR, draft, (*place, "model_factor"))
    with within("strength"):
        strength = _strength(draft, table, limit, (*place, "strength"))
    if limit.needs_modulus:
        fitted, modulus = modulus_of(strength.value), limit.parameters.get("modulus")
        if fitted is None and modulus is None:
            raise Fault(
                "modulus is missing: give it here or by a strength that is a Weibull distribution",
                "modulus",
            )
        if fitted is None:
            draft.warn(
                place,
                "the strength of a weakest link is a Weibull distribution of its modulus; with "
                "another the probability is not that of the flaws",
            )
        elif modulus is not None and abs(fitted - modulus) > 1e-9 * modulus:
            raise Fault(
                f"modulus is {modulus:g}, but the strength has the modulus {fitted:g}. Remove "
                "modulus",
                "modulus",
            )
        limit = replace(limit, parameters={"modulus": fitted or modulus or 0.0, **limit.parameters})
    draft.numbers |= {f"limits.{name}.strength": strength, f"limits.{name}.model_factor": factor}
    draft.limits[name] = replace(
        limit, strength=strength.value, model_factor=factor.value, tested=strength.tested
    )


def _demand(draft: Draft, name: str, table: LimitTable) -> Limit:
    """A limit without its strength; raises Fault."""
    quantity, criterion, meant = table.quantity, table.criterion, table.strength_is
    if quantity is not None and quantity not in draft.known:
        raise Fault(unknown("quantity", quantity, draft.known), "quantity")
    if criterion is not None and draft.box:
        raise Fault("a criterion belongs to the impact model: name a quantity instead", "criterion")
    if criterion == "specific_energy":
        if table.energy_is is None and not RIGS[draft.rig].by_wave:
            raise Fault(
                f"energy_is is missing: write what the strength means, {one_of(_ENERGIES)}",
                "energy_is",
            )
        criterion = _ENERGIES[table.energy_is or "contact"]
    values_of = {part: getattr(table, part) for part in PARAMETERS}
    parameters = {part: value for part, value in values_of.items() if value is not None}
    entry = CRITERIA.get(str(criterion))
    needs: tuple[str, ...] = ()
    way, takes = "add criterion = …", needs
    if entry:
        needs, takes = entry.parameters, (*entry.parameters, *entry.optional)
        way = f"the criterion {criterion} takes {one_of(takes)}"
    for part in parameters:
        if part not in takes:
            raise Fault(
                f"{part} belongs to another criterion (uqsphere list criteria): {way}", part
            )
    for part in needs:
        # the modulus may stand in the strength, which is read later
        if part not in (*parameters, "modulus"):
            raise Fault(
                f"{part} is missing: the criterion {criterion} needs the "
                f"{PARAMETERS[part].meaning}",
                part,
            )
    if entry and entry.quantity and not parameters:
        quantity, criterion = entry.quantity, None
    compared, pressure = (
        str(criterion or quantity),
        quantity in ("p_max", "first_peak") and criterion is None,
    )
    if draft.plastic and not draft.law_given and quantity == "p_max" and pressure and meant is None:
        meant = "hertz"  # as nearly all tabulated strengths of contacts are
    if meant and not pressure and (compared, meant) != ("p_hertz", "hertz"):
        raise Fault(
            f"strength_is belongs to a limit on p_max or first_peak, not on {compared}: "
            "leave it out",
            "strength_is",
        )
    if draft.plastic and draft.law_given and pressure and meant is None:
        raise Fault(_PRESSURES, "strength_is")
    if draft.plastic and pressure and meant == "pressure" and values.is_tests(table.strength):
        raise Fault(
            'forces at failure become pressures by Hertz: write strength_is = "hertz"',
            "strength_is",
        )
    if draft.plastic and quantity == "first_peak" and meant == "hertz":
        raise Fault(
            "first_peak is a true pressure where faces yield: write strength_is = "
            '"pressure", or quantity = "p_max"',
            "strength_is",
        )
    if draft.plastic and meant == "hertz":
        compared = "p_hertz"
    return Limit(
        name=name,
        quantity=f"{compared}.{name}" if criterion else compared,
        criterion=criterion,
        parameters=parameters,
        strength=math.nan,
        aim=table.aim,
        target=DEFAULT_TARGET if table.target is None else table.target,
        has_target=table.target is not None,
        fracture=table.fracture,
    )


def _strength(draft: Draft, table: LimitTable, limit: Limit, place: Place) -> Number:
    """A strength: a number or law in the unit of the demand, or what tests tell of it; raises
    Fault.
    """
    if draft.box:
        return number_of(table.strength, plain_quantity(limit.quantity), draft, place)
    entry = lookup(limit.quantity)
    usual = _USUAL.get(entry.dimension, (0.0, math.inf))
    if entry.place == "contact":
        usual = _CONTACT
    entry = replace(
        entry, meaning=f"the strength against {limit.quantity}", closed=False, plausible=usual
    )
    if values.is_tests(table.strength):
        number = _tested(draft, declared(Observations, table.strength), limit, place)
        values.warn_unusual(number.mean, entry, draft, place)
        return number
    number = number_of(table.strength, entry, draft, place)
    compare_sizes(replace(limit, tested=number.tested), _radii(draft), draft, (*place, "draws"))
    return number


# --- strengths from crushing tests ----------------------------------------------------------------


def _tested(draft: Draft, table: Observations, limit: Limit, place: Place) -> Number:
    """The law of the strength from forces at failure, and the tests themselves; raises Fault."""
    if limit.criterion is None and not follows_force(limit.quantity):
        raise Fault(
            f"a force at failure does not measure {limit.quantity}. Name a criterion", "force"
        )
    name = f"limits.{limit.name}."
    kind, platens, radii = table.fit or "weibull", _platens(draft, table.platens), _radii(draft)
    sphere = _sphere(draft, platens)
    cells, rows, columns, stopped = values.observations(
        table, draft, force="force", diameter="length", rate="loading_rate"
    )
    force, diameter, rate = columns["force"], columns["diameter"], columns.get("rate")
    values.warn_of_rows(cells, rows, 0.9 * force / np.square(diameter), stopped, draft, place)
    warn_of_tests(table, force, diameter, radii[0], draft, place)

    power, mean = _POWERS.get(limit.criterion or limit.quantity, 2.0), float(diameter.mean())
    # flaws lie in the surface around a contact, or in the volume
    flaws = 2.0 if lookup(limit.quantity).place in ("contact", "rim", "below") else 3.0

    def by_size(exponent: float) -> tuple[Law, float]:
        law = values.fit(force * (mean / diameter) ** exponent, stopped, table, kind)
        return law, power and power - flaws / (modulus_of(law) or math.inf)

    law, exponent = _agreeing(by_size, power)
    tested = Tested(
        diameter=mean,
        forces=tuple(force.tolist()),
        diameters=tuple(diameter.tolist()),
        platens=platens,
        sphere=sphere,
        law=law,
        exponent=exponent,
    )
    compare_sizes(replace(limit, tested=tested), radii, draft, (*place, "diameter"))
    if not RIGS[draft.rig].by_press and "rate_0" not in limit.parameters:
        draft.warn(
            place,
            "slow tests, quick rig: struck rocks bore 1.24 to 2.12 times as much; that is "
            "conservative "
            "for survive, not for break; rate_0 of the criterion accounts for it (110 to 760 1/s)",
        )

    def value(modulus: float, factor: float = 1.0) -> Array:
        weakest = limit
        if limit.needs_modulus:
            weakest = replace(limit, parameters={"modulus": modulus, **limit.parameters})
        return value_at(factor * force, weakest.demand, sphere, 0.5 * diameter, platens, rate)

    slopes = np.log(value(8.0, 1.01) / value(8.0)) / math.log(1.01)
    if not np.isfinite(value(8.0)).all():
        raise Fault(
            f"some tests lie beyond what {limit.quantity} can reach: raise largest_energy, or "
            "the hardness"
        )
    if not (slopes > _RISES).all():
        hint = ""
        for code, path, text in draft.caveats:
            if code == "unit" and name in path:
                hint = f" ({text})"
        raise Fault(
            f"{limit.quantity} hardly rises with the force of such tests, so that no force tells "
            f"its strength: take another criterion{hint}"
        )

    def by_value(modulus: float) -> tuple[Law, float]:
        law = values.fit(value(modulus), stopped, table, kind, slope=float(np.median(slopes)))
        return law, modulus_of(law) or modulus

    if limit.needs_modulus:
        law, _ = _agreeing(by_value, 8.0)
    else:
        law, _ = by_value(8.0)
    return Number(value=law, synthetic=table.synthetic, tested=tested)


def _agreeing(fitted: Callable[[float], tuple[Law, float]], number: float) -> tuple[Law, float]:
    """A law that needs a number, and the number that it gives: of the size law, of a weakest link;
    raises Fault.
    """
    from scipy.optimize import fixed_point

    start = fitted(number)[1]  # what is wrong with the tests themselves is said first
    try:
        agreed = fixed_point(
            lambda x: fitted(float(x))[1], start, xtol=1e-11, maxiter=200, method="iteration"
        )
        return fitted(float(agreed))
    except (Fault, RuntimeError):
        raise Fault(
            "no modulus agrees with itself: check the diameters, or give the key modulus"
        ) from None


def compare_sizes(limit: Limit, radii: tuple[float, ...], draft: Draft, place: Place) -> None:
    """Warn of tests of another diameter than the sphere's, of its first radius [m].

    Raises Fault where no size law, of the tests or of the criterion itself, carries them to one of
        the radii.
    """
    tested = limit.tested
    if tested is None:
        return
    linked = limit.needs_modulus or (modulus_of(tested.law) is not None and tested.exponent != 0.0)
    ratios = [
        max(tested.diameter / (2.0 * radius), 2.0 * radius / tested.diameter) for radius in radii
    ]
    refused = not linked and max(ratios) > _SIZES_REFUSED
    radius = radii[ratios.index(max(ratios))] if refused else radii[0]
    sizes = (
        f"the tests of {limit.name} have a mean diameter of {1e3 * tested.diameter:.4g} mm, the "
        f"sphere of {2e3 * radius:.4g} mm"
    )
    if refused:
        way = 'take fit = "weibull"'
        if tested.law is None:
            way = "fit anew with this size as strength_at"
        raise Fault(
            f"{sizes}, and no size law over more than 50 %: test spheres of this size, or {way}",
            str(place[-1]),
        )
    if ratios[0] > _SIZES_TOLD:
        carrier = "nothing"
        if linked:
            carrier = "the weakest link"
        elif tested.law is None and tested.exponent:
            carrier = "its size_exponent"
        draft.warn(place, f"{sizes}: {carrier} carries the strength")


def warn_of_tests(
    table: Observations, force: Array, diameter: Array, radius: float, draft: Draft, place: Place
) -> None:
    """Warn of forces [N] and diameters [m] that no sphere has, with the unit that would make them
    usual.
    """
    size, tension = diameter / (2.0 * radius), np.median(0.9 * force / np.square(diameter))
    far = (size > 3.0) | (size < 1.0 / 3.0)
    first = int(np.argmax(far))
    for key, typical, (low, high), units, unit, text in (
        (
            "diameter",
            size[first],
            (1.0 / 3.0, 3.0),
            UNITS["length"],
            table.diameter_unit,
            f"{far.sum()} of {len(far)} diameters are more than three times off the sphere's, "
            f"the first {1e3 * diameter[first]:.4g} mm",
        ),
        (
            "force",
            tension,
            _TENSION,
            UNITS["force"],
            table.force_unit,
            f"0.9 P/D² is {1e-6 * tension:,.3g} MPa, usual are {1e-6 * _TENSION[0]:g} to "
            f"{1e-6 * _TENSION[1]:g} MPa",
        ),
    ):
        if not low <= typical <= high:
            scale = typical / units.get(unit or "", math.nan)
            likely = [name for name in _UNITS if low < scale * units.get(name, 0.0) < high]
            hint = f"is the unit {one_of(likely)}?" if likely else "are the units right?"
            draft.warn((*place, key), f"{table.file}: {text}: {hint}", holds="unit")
            return


# --- the sphere in the tests ----------------------------------------------------------------------


def _platens(draft: Draft, raw: Any) -> tuple[float, float]:
    """E [Pa], infinite if rigid, and nu of what a strength was measured between; raises Fault."""
    of_library = {
        name: (material.properties["E"].value, material.properties["nu"].value)
        for name, material in library()["bars"].items()
    }
    choices = {
        "bars": (draft.mean("bars.E"), draft.mean("bars.nu")),
        "rigid": (math.inf, 0.3),
        **of_library,
    }
    with within("platens"):
        if isinstance(raw, Mapping) and set(raw) == {"E", "nu"}:
            return value_of(raw["E"], INPUTS["bars.E"]), value_of(raw["nu"], INPUTS["bars.nu"])
        if not isinstance(raw, str) or raw not in choices:
            raise Fault(
                f"platens must be {one_of([*choices, 'a table of E and nu'])}, not {shown(raw)}"
                f"{suggestion(raw, of_library)}"
            )
        if math.isnan(choices[raw][0]):
            raise Fault(
                'there are no bars here: write what it was measured between, platens = "rigid" '
                "or a material"
            )
    return choices[raw]


def _radii(draft: Draft) -> tuple[float, ...]:
    """The mean radius of the sphere [m], and the 1 % and 99 % quantiles of its scatter."""
    law, mean = draft.numbers["sphere.radius"].value, draft.mean("sphere.radius")
    if not isinstance(law, Law):
        return (mean,)
    return (mean, *law.ppf(np.array([0.01, 0.99])).tolist())


def _sphere(draft: Draft, platens: tuple[float, float]) -> dict[str, float]:
    """The sphere of the tests at its means, as `uqsphere.mechanics.crushing` takes it."""
    assert draft.scene is not None
    E, nu, density = (draft.mean(f"sphere.{key}") for key in ("E", "nu", "density"))
    # what stores energy beside the sphere in the contacts of the study's rig
    modulus = float(np.mean([partner.modulus[0] for partner in draft.scene.there]))
    sphere = {"E": E, "nu": nu, "density": density, "partner": 1.0 / modulus - (1.0 - nu * nu) / E}
    # what yields is the same as in the rig if its partner is the platens, else the sphere
    alike = next(
        (p for p in draft.scene.there if np.allclose(draft.elastic(p.table), platens, rtol=1e-9)),
        None,
    )
    face = sphere_body(draft.scene.columns) if alike is None else alike.face
    if (
        not draft.plastic
        or face is None
        or not np.isfinite(face.onset + face.hardness + face.pile_up).all()
    ):
        return sphere
    law = {
        key: float(value[0])
        for key, value in zip(LAW, (face.onset, face.hardness, face.pile_up), strict=True)
    }
    return {**sphere, **law, "takes": 1.0 if alike is None else float(alike.takes[0])}
