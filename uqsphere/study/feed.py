"""The feed of a study: [material], [feed] and [product] read into the nouns of `uqsphere.feed`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Final

from uqsphere.mechanics.rigs import GRAVITY, drop_speed
from uqsphere.quantities import INPUTS
from uqsphere.study.columns import open_observations
from uqsphere.study.document import Document
from uqsphere.study.faults import Findings, Misplaced, Place, Raw, one_of, shown, suggestion
from uqsphere.study.numbers import Reading, plain_quantity, read_number
from uqsphere.study.particle_tables import (
    FROM_TESTS,
    CurveTable,
    EnergyTable,
    FeedTable,
    MaterialTable,
    OnTable,
    ProductTable,
    SizesTable,
)
from uqsphere.study.scene import material_of
from uqsphere.study.study import Particles, Study
from uqsphere.units import UNITS, Quantity
from uqsphere.uq import Law

if TYPE_CHECKING:
    from uqsphere.feed.answers import FeedPlan
    from uqsphere.feed.population import Sizes
    from uqsphere.feed.product import ProductPlan

#: what a blow offers: dimension, kind of `uqsphere.feed.population.Blows`
_ENERGIES: Final = {
    "specific": ("specific_energy", "specific"), "energy": ("energy", "energy"), "speed": ("speed", "speed"),
    "drop_height": ("length", "specific"),
}  # fmt: skip
_NEEDS: Final = {
    "rosin_rammler": ("d63", "n"), "gaudin_schuhmann": ("n",), "lognormal": ("d50", "log_sd"), "table": ("file",),
}  # fmt: skip
_EXAMPLES: Final = {
    "d63": '"30 mm"', "n": "1.2", "d50": '"20 mm"', "log_sd": "0.7", "file": '"sieves.csv"', "top": '"70 mm"',
}  # fmt: skip
_MATERIAL: Final = {"E": '"60 GPa"', "nu": "0.25", "density": '"2700 kg/m3"'}


def without_scene(data: Mapping[str, Raw]) -> bool:
    """Whether a file speaks of particles alone, so that it needs no sphere."""
    return ("tests" in data or "feed" in data) and "sphere" not in data


# --- the material -----------------------------------------------------------------------------------------------


def read_particles(document: Document, study: Study | None, findings: Findings) -> Particles | None:
    """The material of [material], else that of the study's sphere; None, with the fault noted, where there is none."""
    table = document.material
    if table is None:
        if document.sphere is None and findings.clean(("sphere",)):
            findings.lack(("material",), 'the table [material] is missing: add one with name = "limestone"')
        if study is None or document.sphere is None:
            return None
        means = study.at_means()
        return Particles(**{key: means[f"sphere.{key}"] for key in _MATERIAL}, name=study.materials.get("sphere", ""))
    if document.sphere is not None:
        findings.add(("material",), "[sphere] says what the particles are of already: leave [material] out")
    return _particles(table, findings)


def _particles(table: MaterialTable, findings: Findings) -> Particles | None:
    material = None if table.name is None else material_of(table.name, ("material", "name"), findings, ("sphere",))
    if material is None and table.name is not None:
        return None
    found: dict[str, float] = {}
    for key, example in _MATERIAL.items():
        place, raw = ("material", key), getattr(table, key)
        if raw is not None:
            reading = read_number(raw, place, INPUTS[f"sphere.{key}"], findings)
            if reading is not None:
                found[key] = reading.nominal
        elif material is not None:
            found[key] = material.properties[key].value
        elif findings.clean(place):
            findings.add(place, f'{key} is missing: add {key} = {example}, or name = "limestone" to take it from')
    return Particles(**found, name=table.name or "") if len(found) == len(_MATERIAL) else None


# --- the product -------------------------------------------------------------------------------------------------


def read_product(table: ProductTable | None, findings: Findings) -> ProductPlan:
    """How fine the product is; without [product] the tests are to tell."""
    from uqsphere.feed.product import ProductPlan

    if table is None:
        return ProductPlan()
    quantities = {key: INPUTS[f"product.{key}"] for key in ("A", "b")}
    if table.form != "jk":
        quantities["b"] = plain_quantity("product.b")
    numbers = {key: _value(getattr(table, key), ("product", key), one, findings) for key, one in quantities.items()}
    curve, place = table.curve or CurveTable(), ("product", "curve")
    alpha = _value(curve.alpha, (*place, "alpha"), plain_quantity("alpha"), findings)
    if curve.law == "beta" and not curve.table:
        findings.lack((*place, "table"), "beta takes a table of rows [n, alpha_n, beta_n]: none is built in")
    for key, is_given, of in (("alpha", curve.alpha is not None, "trr"), ("table", bool(curve.table), "beta")):
        if is_given and curve.law != of:
            findings.add((*place, key), f'{key} belongs to law = "{of}": leave it out')
    if alpha is not None and Reading(value=alpha).nominal <= 0.0:
        findings.add((*place, "alpha"), "alpha must be above 0")
    return ProductPlan(
        form=table.form, A=numbers["A"], b=numbers["b"], threshold=table.threshold, curve=curve.law, knots=curve.table,
        alpha=alpha, discrepancy=curve.discrepancy,
    )  # fmt: skip


def _value(raw: Raw, place: Place, quantity: Quantity, findings: Findings) -> Law | float | None:
    """A number or law; None where it is left to the tests, or faulty."""
    reading = None if raw in (None, FROM_TESTS) else read_number(raw, place, quantity, findings)
    return None if reading is None else reading.value


def readable(table: ProductTable) -> bool:
    """Whether the product is an answer of every sphere: A and b are given, of the energy offered."""
    return table.form == "jk" and FROM_TESTS not in (table.A, table.b)


# --- the feed ---------------------------------------------------------------------------------------------------


def read_feed(
    document: Document, particles: Particles | None, services: Mapping[str, Study], findings: Findings
) -> FeedPlan | None:
    """The feed of a study; None, with every fault noted, where there is none."""
    from uqsphere.feed.answers import FeedPlan
    from uqsphere.feed.population import Blows, Feed, make_classes

    table, product_table = document.feed, document.product
    product = read_product(product_table, findings)
    if table is None:
        return None
    sizes = _read_sizes(table, findings)
    energy = _read_energy(table, services, findings)
    share = _read_share(table, particles, services, findings)
    if sizes is None or energy is None or particles is None or share is None or not findings.clean(("feed",)):
        return None
    assert table.sizes is not None
    kind, value, words = energy
    classes = make_classes(sizes, ratio=table.sizes.ratio, count=table.sizes.classes)
    feed = Feed(
        classes=classes, blows=Blows(count=table.blows, kind=kind, energy=value, share=share[0]),
        density=particles.density, progeny=table.progeny, rest_breaks=table.rest == "breaks",
        lot=math.inf if table.lot is None else table.lot, fines=table.fines, seed=document.seed,
    )  # fmt: skip
    goal = None if table.goal is None else (table.goal.broken, table.goal.at_least)
    of = {"sizes": _size_words(table.sizes, sizes.top), "energy": words, "partner": share[1]}
    meaning: dict[str, Raw] = {"table": asdict(table), "particles": asdict(particles)}
    meaning |= {} if product_table is None else {"product": asdict(product_table)}
    meaning["sizes"] = {"edges": classes.edges.tolist(), "mass": classes.mass.tolist()}
    numbers = {key: getattr(particles, key) for key in _MATERIAL}
    return FeedPlan(feed=feed, product=product, goal=goal, of=of, particles=numbers, meaning=meaning)


def _size_words(own: SizesTable, top: float) -> str:
    told = {"d63": own.d63, "d50": own.d50, "n": own.n, "sd of ln d": own.log_sd, "top": top}
    words = (f"{key} {1e3 * value:.4g} mm" if key in ("d63", "d50", "top") else f"{key} {value:g}"
             for key, value in told.items() if value is not None)  # fmt: skip
    return f"{own.law.replace('_', '-')}, {', '.join(words)}"


def _read_sizes(table: FeedTable, findings: Findings) -> Sizes | None:
    """The size distribution."""
    from uqsphere.feed.population import Sizes

    sizes, place = table.sizes, ("feed", "sizes")
    if sizes is None or not sizes.law:
        return None
    needed = (*_NEEDS[sizes.law], *(() if sizes.law == "table" else ("top",)))
    _check_keys(sizes, needed, place, findings)
    if not findings.clean(place):
        return None
    if sizes.law == "table":
        return _read_table(sizes, place, findings)
    assert sizes.top is not None
    given = {key: getattr(sizes, key) for key in needed}
    return Sizes(law=sizes.law, parameters=given, top=sizes.top)


def _check_keys(sizes: SizesTable, needed: tuple[str, ...], place: Place, findings: Findings) -> None:
    """Every law has keys of its own."""
    for key in needed:
        if getattr(sizes, key) is None:
            findings.lack((*place, key), f"{key} is missing: {sizes.law} needs it, such as {key} = {_EXAMPLES[key]}")
    for key in ("d63", "n", "d50", "log_sd", "file"):
        if getattr(sizes, key) is not None and key not in _NEEDS[sizes.law]:
            findings.add((*place, key), f"{key} does not belong to {sizes.law}, which takes {one_of(needed)}")


def _read_table(sizes: SizesTable, place: Place, findings: Findings) -> Sizes | None:
    """The size distribution of a table of sieves."""
    import numpy as np

    from uqsphere.feed.population import Sizes

    with findings.noting(place):
        assert sizes.file is not None
        rows = open_observations(sizes.file, findings.folder)
        sieves = rows.whole(sizes.sieve, "sieve", UNITS["length"][sizes.sieve_unit])
        finer = 0.01 * rows.whole(sizes.passing, "passing")
        order = np.argsort(sieves)
        same, falls = np.zeros((2, len(order)), dtype=bool)
        same[order[1:]], falls[order[1:]] = np.diff(sieves[order]) == 0.0, np.diff(finer[order]) < 0.0
        rows.refuse(sieves <= 0.0, "sieve", lambda row: "a sieve must be above 0")
        rows.refuse(same, "sieve", lambda row: "this sieve stands there twice")
        rows.refuse(falls, "passing", lambda row: "the passing falls from a finer sieve to this one")
        rows.refuse((finer < 0.0) | (finer > 1.0), "passing", lambda row: "a passing must lie from 0 to 100 %")
        rows.raise_first()
        sieves, finer = sieves[order], finer[order]
        if finer[-1] <= 0.0:
            raise Misplaced(f"nothing passes the largest sieve of {shown(rows.name)}", "passing")
        top = min(sizes.top or math.inf, float(sieves[-1]))
        return Sizes(sieves=tuple(sieves.tolist()), finer=tuple(finer.tolist()), top=top)
    return None


def _read_energy(
    table: FeedTable, services: Mapping[str, Study], findings: Findings
) -> tuple[str, float | Law, str] | None:
    """Kind of `Blows`, value or law in SI, and in words what a blow offers."""
    given, place = table.energy, ("feed", "energy")
    if given is None or not findings.clean(place):
        return None
    keys = [key for key in (*_ENERGIES, "service") if getattr(given, key) is not None]
    if len(keys) != 1:
        found = f"found {one_of(keys)}" if keys else "found none"
        findings.add((*place, *keys[1:2]), f"{found}: one of {one_of([*_ENERGIES, 'service'])} is due")
        return None
    if keys == ["service"]:
        return _of_service(given, services, findings)
    (key,) = keys
    dimension, kind = _ENERGIES[key]
    quantity = Quantity(
        name=f"feed.{key}", symbol="E", dimension=dimension, meaning=f"the {dimension.replace('_', ' ')}"
    )
    reading = read_number(getattr(given, key), (*place, key), quantity, findings)
    if reading is None:
        return None
    words = f"{reading.nominal:.4g} {quantity.unit}{' in the mean' if isinstance(reading.value, Law) else ''}"
    if key == "drop_height":
        if isinstance(reading.value, Law):
            findings.add((*place, key), "a height is one value here: give a law of specific instead")
            return None
        return kind, GRAVITY * reading.value, f"fall of {words}"
    return kind, reading.value, f"blows of {words}"


def _of_service(
    given: EnergyTable, services: Mapping[str, Study], findings: Findings
) -> tuple[str, float | Law, str] | None:
    """The closing speed of a service, square to the face."""
    place = ("feed", "energy", "service")
    name = str(given.service)
    service = services.get(name)
    if service is None:
        known = f"known: {one_of(list(services))}{suggestion(name, services)}" if services else "the study has none"
        findings.add(place, f"no service {shown(name)}, {known}: add [service.{name}]")
        return None
    if service.rig != "impact":
        findings.add(place, f"{shown(name)} is a rig {shown(service.rig)}: the closing speed of an impact is due")
        return None
    means, law = service.at_means(), service.random.get("rig.speed")
    sine = math.sin(means["rig.angle"])
    if law is not None and sine > 1.0 - 1e-12:
        return "speed", law, f"closing speed {law.nominal_mean():.4g} m/s in the mean (service {name})"
    speed = means.get("rig.speed")
    if speed is None:
        speed = float(drop_speed(means["rig.drop_height"], means["sphere.radius"], means["sphere.density"]))
    if "rig.speed" in service.random or "rig.drop_height" in service.random:
        findings.warn(place, "the scatter of its speed is left out: a law of feed.energy.speed has it")
    return "speed", speed * sine, f"closing speed {speed * sine:.4g} m/s (service {name})"


def _read_share(
    table: FeedTable, particles: Particles | None, services: Mapping[str, Study], findings: Findings
) -> tuple[float, str] | None:
    """Share of the energy that a particle takes up, and its partner in words."""
    from uqsphere.feed.laws import particle_share

    if particles is None:
        return None
    partner, words = _partner(table.on, findings), "" if table.on is None else (table.on.material or "E and nu given")
    service = None if table.energy is None else services.get(str(table.energy.service))
    if table.on is None and service is not None:
        means = service.at_means()
        partner = means["target.E"], means["target.nu"]
        words = service.materials.get("target", "the target")
    if table.on is not None and partner is None:
        return None
    if partner is None:
        return 1.0, "the energy is the particle's own"
    share = float(particle_share(particles.E, particles.nu, *partner))
    return share, f"on {words}: a particle takes up {100.0 * share:.3g} % of what is offered"


def _partner(on: OnTable | None, findings: Findings) -> tuple[float, float] | None:
    if on is None:
        return None
    place = ("feed", "on")
    given = {key: getattr(on, key) for key in ("E", "nu")}
    if on.material is not None:
        material = material_of(on.material, (*place, "material"), findings)
        if material is None:
            return None
        given = {key: material.properties[key].value if value is None else value for key, value in given.items()}
    for key, value in given.items():
        if value is None:
            findings.lack((*place, key), f'{key} is missing: add it, or material = "steel"')
    return None if None in given.values() else (float(given["E"]), float(given["nu"]))
