"""The energy that a particle itself absorbs in a test: its share of what is offered or stored.

A blow of a weight, a throw or a fall offers an energy, of which the particle takes the share that
the impact model of a study gives it (`uqsphere.evaluate`): what a fit calls the fracture energy is
what a study compares with it.  A force, or an energy that is stored in the contacts, is shared
elastically.
"""

import warnings
from operator import attrgetter
from typing import Any

import numpy as np

from uqsphere.arrays import Array, Cells, Values
from uqsphere.errors import UqsphereError
from uqsphere.labs.files import InputError
from uqsphere.materials import materials_of
from uqsphere.tables import Table

from . import laws
from .document import ComminutionDocument, Elastic

#: mass of a falling weight over that of a particle, where it only carries the energy
_HEAVY = 1000.0
_GRAVITY = 9.80665
#: place of what particles touched in tests
_PARTNER = "tests.partner"


def stiffness(asked: ComminutionDocument, place: str) -> float:
    """k = E/(1 - nu²) [Pa] of the body at a place of an input file; InputError where it is not
    known.
    """
    body = attrgetter(place)(asked)
    if body.E is None or body.nu is None:
        raise InputError("E and nu, or a material of the library, are required", place)
    return float(body.E / (1.0 - body.nu**2))


def particle_energies(
    asked: ComminutionDocument, table: Table, diameter: Array, rig: Cells
) -> tuple[Array, list[str]]:
    """The particle's own energy per mass [J/kg] of every row, and notes; UsageError for impossible
    rows."""
    want = asked.tests
    material = asked.material
    partner = want.partner
    notes = []
    if want.mass:
        mass = table.numbers(want.mass, "mass", want.mass_unit, key="mass")
    elif material.density:
        mass = laws.mass_of(diameter, material.density)
    else:
        raise InputError("density is required, or a column tests.mass", "material")
    name = want.measured
    energy = table.numbers(getattr(want, name), name, want.unit, key=name)
    meaning = {"force": "contact", "speed": "input"}.get(name, want.energy_is)
    if name == "energy":
        energy = energy / mass
    elif name == "speed":
        energy = 0.5 * np.square(energy)
    elif name == "force":
        # E* of the contacts: as measured, or of intact rock
        if want.stiffness:
            modulus: Values = table.numbers(
                want.stiffness, "pressure", want.stiffness_unit, key="stiffness"
            )
        else:
            compliance = 1.0 / stiffness(asked, "material")
            if partner:
                compliance += 1.0 / stiffness(asked, _PARTNER)
            modulus = 1.0 / compliance
            notes.append(
                "the stiffness of intact rock is assumed: energies from the measured stiffness are "
                "often 2 to 3 times larger"
            )
        energy = laws.energy_of_force(energy, diameter, modulus, mass)
    table.refuse(name, "the energy must be above 0", energy <= 0.0)
    table.check()
    if meaning == "sphere":
        return energy, notes
    if not partner:
        whole = "offered"
        if meaning == "contact":
            whole = "stored in the contacts"
        notes.append(
            f"without tests.partner the particle is credited with the whole energy {whole}; a "
            "study credits it with its share only"
        )
        return energy, notes
    bodies = stiffness(asked, "material"), stiffness(asked, _PARTNER)
    shares = np.full_like(energy, laws.particle_share(*bodies))
    if meaning == "input":
        for falling in (True, False):
            rows = (rig == "drop_weight") == falling
            if rows.any():
                shares[rows], told = offered_shares(
                    asked, _PARTNER, falling, energy[rows], diameter[rows]
                )
                notes += told
    return energy * shares, notes


def offered_shares(
    asked: ComminutionDocument, place: str, falling: bool, energy: Array, diameter: Array
) -> tuple[Array, list[str]]:
    """Shares (n,) of offered energies [J/kg] that particles of diameters [m] take, and notes.

    place : of the partner in the input file
    falling : whether a weight falls on the particle on an anvil, both of the partner's material;
        else it hits a thick target.

    Rows that the impact model cannot compute have the share of elastic contacts.
    """
    import uqsphere

    particle = asked.material
    partner = attrgetter(place)(asked)
    bodies = stiffness(asked, "material"), stiffness(asked, place)
    elastic = np.full_like(energy, laws.particle_share(*bodies))
    if not (particle.density and partner.density):
        return elastic, []
    sphere = _table(particle, "sphere")
    other = _table(partner, "plates", "bars")
    thick = {"kind": "thick", **other}
    sphere["radius"] = f"{0.5 * float(diameter.mean())!r} m"
    tables = {"sphere": sphere}
    if asked.contact_law:
        tables["contact"] = {"law": asked.contact_law}
    rows = {"sphere.radius": 0.5 * diameter}
    if falling:
        mass = laws.mass_of(diameter, particle.density)
        weight = _HEAVY * float(mass.max())
        hammer = {"mass": f"{weight!r} kg", "drop_height": "1 m", "face_radius": "flat"}
        tables |= {"rig": {"kind": "drop_weight"}, "hammer": hammer | other}
        tables["anvil"] = thick
        rows["hammer.drop_height"] = energy * mass / (weight * _GRAVITY)
    else:
        tables["rig"] = {"kind": "impact", "speed": "1 m/s"}
        tables["target"] = thick
        rows["rig.speed"] = np.sqrt(2.0 * energy)
    quantities = ["specific_energy_sphere", "specific_impact_energy"]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            answers = uqsphere.evaluate(uqsphere.Study(**tables), rows, quantities=quantities)
        except UqsphereError as error:
            return elastic, [f"the shares of the energy are those of elastic contacts: {error}"]
    notes = [*dict.fromkeys(f"share of the energy: {warning.message}" for warning in caught)]
    taken, whole = answers[quantities].to_numpy(float).T
    share = taken / whole
    return np.where(np.isfinite(share), share, elastic), notes


def _table(body: Elastic, *kinds: str) -> dict[str, Any]:
    """A body as a table of a study: its material where the library has it there, and its
    numbers."""
    table = {
        "E": f"{body.E!r} Pa",
        "nu": body.nu,
        "density": f"{body.density!r} kg/m3",
    }
    if body.material in materials_of(*kinds):
        table["material"] = body.material
    return table
