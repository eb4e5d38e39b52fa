"""A strength carried from the test to another rig: what the test would have to do to be as hard on the same sphere.

Which of the loads of a sphere breaks it is not settled: the force on the contact where failure begins near it, the
energy in the sphere, or the tension at its centre, which feels the mean of the forces at the two poles.  Each says at
which slow force between the test's platens, F, the sphere would be loaded alike; the demand there is held against the
strength.  So a strength is never turned into a force, and its law, its tests and their scatter stay what they are.
Numbering (R...) of docs/theory.md; section 6 of it has what was published for each.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Values
from uqsphere.mechanics import contact
from uqsphere.mechanics.yielding import CAP_PILE_UP, Face

#: what a strength can be carried by -> the columns that it reads of the service
CARRIERS: Final[dict[str, tuple[str, ...]]] = {
    "force": ("P_max",),
    "energy": ("energy_sphere", "P_max"),
    "centre": ("mean_force_max", "P_max"),
}
#: what a demand that is carried needs to know beside the parameters of its criterion
CARRIED: Final = ("carrier", "platen_E", "platen_nu")


def carried_parameters(carrier: str, platens: tuple[float, float]) -> dict[str, float]:
    """The parameters of a demand in the test: the place of its carrier in `CARRIERS`, E [Pa] and nu of the platens."""
    return {"carrier": float(list(CARRIERS).index(carrier)), "platen_E": platens[0], "platen_nu": platens[1]}


def needs_of(parameters: Mapping[str, float]) -> tuple[str, ...]:
    """Columns that a carried demand reads of the service."""
    rate = ("loading_rate",) if "rate_0" in parameters else ()
    return (*CARRIERS[list(CARRIERS)[int(parameters["carrier"])]], *rate)


def pole_of(columns: Mapping[str, Values], modulus: Array, radius: Array) -> Face | None:
    """The law of a sphere's pole between harder platens; None where its onset or its hardness is not given."""
    law = [columns.get(f"sphere.{key}") for key in ("onset_pressure", "hardness")]
    if any(part is None for part in law):
        return None
    onset, hardness = (np.broadcast_to(np.asarray(part, dtype=float), radius.shape) for part in law)
    return Face(onset=onset, hardness=hardness, pile_up=np.full(radius.shape, CAP_PILE_UP), modulus=modulus,
                effective_radius=radius)  # fmt: skip


def in_the_test(
    columns: Mapping[str, Values], parameters: Mapping[str, float], *, yields: bool = False
) -> tuple[Array, dict[str, Values]]:
    """The slow force in the test, (n,) [N], and what `uqsphere.mechanics.outputs.at_force` is to know of it.

    force: F = P_max; centre: F = (P_A + P_B)/2 at its largest, (R19); energy: F = (5 U/(4 chi))^0.6 beta^0.4 from the
    energy U of the sphere, chi its share in the test, (R22), or, where its poles yield, what chi times the stored
    energy and the plastic work together take.  The rate is that of the service.
    """
    carrier = list(CARRIERS)[int(parameters["carrier"])]
    E, nu, radius = (np.asarray(columns[f"sphere.{key}"], dtype=float) for key in ("E", "nu", "radius"))
    modulus = np.asarray(contact.reduced_modulus(E, nu, parameters["platen_E"], parameters["platen_nu"]))
    beta = contact.hertz_constant(modulus, radius)
    share = modulus * (1.0 - nu * nu) / E
    face = pole_of(columns, modulus, radius) if yields else None
    peak = np.asarray(columns["P_max"], dtype=float)
    if carrier == "force":
        force = peak
    elif carrier == "centre":
        force = np.asarray(columns["mean_force_max"], dtype=float)
    elif face is not None:
        depth = face.depth_of_share(0.5 * np.asarray(columns["energy_sphere"]), share)
        force = face.force(depth) * face.onset_force
    else:
        force = (1.25 * np.asarray(columns["energy_sphere"]) / share) ** 0.6 * beta**0.4
    known = {"modulus": modulus, "effective_radius": radius, "hertz_constant": beta, "mass": columns["mass"],
             "sphere.E": E, "sphere.nu": nu, "sphere.radius": radius, "face": face}  # fmt: skip
    if "rate_0" in parameters:
        known["loading_rate"] = columns["loading_rate"] * (force / peak)
    return force, known
