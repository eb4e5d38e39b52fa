"""Slow crushing tests between two flat platens: the value of a demand at a force, and the force
that gives a value.

By the law of the study's contact the force at failure gives the value of the demand that a strength
is made of. `force_at` goes the other way on a row's own sphere, so that E and nu of the tests are
never scattered twice.

A sphere is given by E [Pa], nu, density [kg/m³], (n,) each or numbers; where its poles yield by
onset_pressure, hardness [Pa], pile_up and takes, 1 if the sphere itself yields; and by partner, (1
- nu²)/E [1/Pa] of what is on the other side in the row's own rig, where the energy of both is what
is limited.  Platens have E [Pa], infinite if rigid, and nu.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias

import numpy as np

from uqsphere.arrays import Array, Values
from uqsphere.mechanics import contact
from uqsphere.mechanics.criteria import CRITERIA, Parameters, demand
from uqsphere.mechanics.outputs import Columns, pressures_of
from uqsphere.mechanics.yielding import Face

#: a quantity, or a criterion with its parameters
Demand: TypeAlias = str | tuple[str, Parameters]


def value_at(
    force: Array,
    of: Demand,
    sphere: Mapping[str, Values],
    radius: Array,
    platens: tuple[float, float],
    rate: Array | None = None,
) -> Array:
    """The value (n,) of a demand in spheres of a radius (n,) [m], pressed to a force (n,) [N] at a
    rate [N/s].
    """
    own = {
        key: np.broadcast_to(np.asarray(value, dtype=float), radius.shape)
        for key, value in sphere.items()
    }
    modulus = np.asarray(contact.reduced_modulus(own["E"], own["nu"], *platens))
    beta, share = (
        contact.hertz_constant(modulus, radius),
        modulus * (1.0 - np.square(own["nu"])) / own["E"],
    )
    takes = own.get("takes")
    if takes is None:
        press, approach = {}, contact.approach_at_force(force, beta)
        stored, lost = 2.0 * contact.contact_energy(approach, beta), np.zeros(radius.shape)
    else:
        face = Face(
            onset=own["onset_pressure"],
            hardness=own["hardness"],
            pile_up=own["pile_up"],
            modulus=modulus,
            effective_radius=radius,
        )
        state = face.pressed(face.depth_at(force))
        press, approach = pressures_of(state, modulus, radius, takes), state.approach
        stored, lost = 2.0 * state.stored, 2.0 * takes * state.plastic
    columns = Columns(
        {
            **{f"sphere.{key}": value for key, value in own.items()},
            "sphere.radius": radius,
            "modulus": modulus,
            "effective_radius": radius,
            "hertz_constant": beta,
            "mass": contact.sphere_mass(radius, own["density"]),
            "P_max": force,
            "alpha_max": approach,
            **press,
            "first_peak": lambda: columns["p_max"],
            "energy_sphere": share * stored + lost,
            "impact_energy": stored,
            # what the sphere stores here, and what the partners in the study's own rig would store
            # beside it
            "energy": (share + modulus * own["partner"]) * stored if "partner" in own else stored,
            "loading_rate": np.zeros(radius.shape) if rate is None else rate,
        }
    )
    if isinstance(of, str):
        return np.asarray(columns[of], dtype=float)
    return demand(CRITERIA[of[0]], columns, of[1])


def force_at(
    value: Values,
    of: Demand,
    sphere: Mapping[str, Values],
    radius: Values,
    platens: tuple[float, float],
) -> Array:
    """The force (n,) [N] that gives a demand's value on the row's own sphere; 0 for 0, infinite
    where none does.

    Every demand rises with the force, nearly as a power of it: the secant in logarithms ends after
    some steps.  It is exact for Hertz: p_max = (6 P E*²/(pi³ r²))^(1/3) gives P = pi³ p_max³ r²/(6
    E*²).
    """
    if not isinstance(of, str):  # the tests were slow
        of = of[0], {key: part for key, part in of[1].items() if key != "rate_0"}
    value, radius = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(v, dtype=float)) for v in (value, radius))
    )
    with np.errstate(all="ignore"):
        wanted = np.log(np.where(value > 0.0, value, 1.0))
        x, slope = np.log(1e7 * np.square(radius)), np.full(radius.shape, 0.7)
        y = np.log(value_at(np.exp(x), of, sphere, radius, platens))
        for _ in range(60):
            step = np.clip((wanted - y) / slope, -6.0, 6.0)
            if not (np.abs(step) > 1e-13 * np.maximum(np.abs(x), 1.0)).any():
                break
            after = np.log(value_at(np.exp(x + step), of, sphere, radius, platens))
            secant = (after - y) / step
            slope = np.where((secant > 0.02) & (np.abs(step) > 1e-9), secant, slope)
            x, y = x + step, after
    found = np.where(np.abs(wanted - y) < 1e-6, np.exp(x), np.inf)
    return np.where(value > 0.0, found, 0.0)
