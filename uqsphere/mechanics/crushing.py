"""Slow crushing tests between two flat platens: the demand at a force, and the force of a demand.

The force at failure gives a demand by the contact law of the study, and so a strength.  `force_at`
inverts this for a row's own sphere, so that the scatter of E and nu in the tests is not counted
twice.

A sphere is given by E [Pa], nu, density [kg/m³], (n,) each or numbers.  If its contacts yield it
also has onset_pressure, hardness [Pa], pile_up and takes (1 if the sphere itself yields).  If the
energy of both bodies is limited it has partner, (1 - nu²)/E [1/Pa] of the counter-body in the row's
own rig.  Platens have E [Pa], infinite if rigid, and nu.
"""

import numpy as np

from uqsphere.arrays import Array, ColumnMap, Duo, Values, quiet

from . import contact
from .criteria import CRITERIA, Parameters, demand
from .outputs import Columns, columns_of_press
from .yielding import Face

#: a quantity, or a criterion with its parameters
Demand = str | tuple[str, Parameters]


def value_at(
    force: Array,
    of: Demand,
    sphere: ColumnMap,
    radius: Array,
    platens: Duo,
    rate: Values = 0.0,
) -> Array:
    """Demand (n,) in spheres of a radius (n,) [m] under a force (n,) [N] at a rate [N/s], (n,)
    or one.
    """
    own = {key: np.broadcast_to(value, radius.shape) for key, value in sphere.items()}
    modulus = contact.reduced_modulus(own["E"], own["nu"], *platens)
    beta = contact.hertz_constant(modulus, radius)
    share = modulus * (1.0 - np.square(own["nu"])) / own["E"]
    if "takes" in own:
        face = Face(
            onset=own["onset_pressure"],
            hardness=own["hardness"],
            pile_up=own["pile_up"],
            modulus=modulus,
            effective_radius=radius,
        )
        state = face.pressed(face.depth_at(force))
        press = columns_of_press(state, own["takes"])
        stored = 2.0 * state.stored
        lost = 2.0 * own["takes"] * state.dissipated
    else:
        approach = contact.approach_at_force(force, beta)
        press = {"alpha_max": approach}
        stored = 2.0 * contact.contact_energy(approach, beta)
        lost = np.zeros_like(beta)
    energy = stored
    if "partner" in own:
        # energy of the sphere here, and of the counter-bodies in the study's own rig
        energy = (share + modulus * own["partner"]) * stored
    columns: Columns = Columns(
        {
            **{f"sphere.{key}": value for key, value in own.items()},
            "sphere.radius": radius,
            "modulus": modulus,
            "effective_radius": radius,
            "hertz_constant": beta,
            "mass": contact.sphere_mass(radius, own["density"]),
            **press,
            "P_max": force,
            "first_peak": lambda: columns["p_max"],
            "energy_sphere": share * stored + lost,
            "impact_energy": stored,
            "energy": energy,
            "loading_rate": np.broadcast_to(rate, radius.shape),
        }
    )
    if isinstance(of, str):
        return np.asarray(columns[of])
    return demand(CRITERIA[of[0]], columns, of[1])


@quiet
def force_at(
    value: Values,
    of: Demand,
    sphere: ColumnMap,
    radius: Values,
    platens: Duo,
) -> Array:
    """Force (n,) [N] at which a demand reaches a value on the row's own sphere.

    It is 0 for a value of 0, and infinite if no force reaches the value.  Every demand increases
    with the force, nearly as a power of it, so that the secant method in logarithms converges in a
    few steps.  It is exact for Hertz: P = pi³ p_max³ r²/(6 E*²).
    """
    if not isinstance(of, str):
        # the tests were slow: without the rate effect
        of = of[0], {key: part for key, part in of[1].items() if key != "rate_0"}
    value, radius = np.broadcast_arrays(*np.atleast_1d(value, radius))

    def logarithm(x: Array) -> Array:
        return np.log(value_at(np.exp(x), of, sphere, radius, platens))

    wanted = np.log(np.where(value > 0.0, value, 1.0))
    x = np.log(1e7 * np.square(radius))
    slope = np.full(radius.shape, 0.7)
    y = logarithm(x)
    for _ in range(60):
        step = np.clip((wanted - y) / slope, -6.0, 6.0)
        if not (np.abs(step) > 1e-13 * np.maximum(np.abs(x), 1.0)).any():
            break
        after = logarithm(x + step)
        secant = (after - y) / step
        slope = np.where((secant > 0.02) & (np.abs(step) > 1e-9), secant, slope)
        x = x + step
        y = after
    force = np.where(np.abs(wanted - y) < 1e-6, np.exp(x), np.inf)
    return np.where(value > 0.0, force, 0.0)
