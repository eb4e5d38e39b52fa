"""The force in crushing tests that is worth a row's value.

A crushing test is a slow compression between two flat platens.  By the law of the study's contact its force gives the
value that the limit's criterion reached, and those values the strength (`uqsphere.study.limits`).  `equivalent_force`
goes the other way: the force that gives a row's value on the row's own sphere in the rig of the tests; `test_force`
carries it to the size of the tests, where `Tested.law` holds.  So the scatter of E and nu in the tests is never counted
twice.  One size law serves rows, curves and the free number: `Tested.exponent`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from uqsphere.arrays import Array, Values
from uqsphere.mechanics import contact
from uqsphere.mechanics.criteria import CRITERIA, demand
from uqsphere.mechanics.outputs import Columns, at_force
from uqsphere.mechanics.yielding import Face
from uqsphere.study.study import Limit


def reached(limit: Limit, force: Array, sphere: Mapping[str, Values], radius: Array, platens: tuple[float, float],
            rate: Array | None = None) -> Array:  # fmt: skip
    """The value (n,) of a limit's demand in spheres of a radius (n,) that are pressed to a force (n,) between platens.

    Parameters as of `equivalent_force`; rate: of the loading [N/s].
    """
    own = {key: np.broadcast_to(np.asarray(value, dtype=float), radius.shape) for key, value in sphere.items()}
    modulus, face = np.asarray(contact.reduced_modulus(own["E"], own["nu"], *platens)), None
    if "takes" in own:
        face = Face(onset=own["onset_pressure"], hardness=own["hardness"], pile_up=own["pile_up"], modulus=modulus,
                    effective_radius=radius)  # fmt: skip
    state = at_force(force, {
        **{f"sphere.{key}": value for key, value in own.items()}, "sphere.radius": radius, "modulus": modulus,
        "effective_radius": radius, "hertz_constant": contact.hertz_constant(modulus, radius), "face": face,
        "mass": contact.sphere_mass(radius, own["density"]), "takes": own.get("takes", 0.0),
        "loading_rate": np.zeros(radius.shape) if rate is None else rate,
    })  # fmt: skip
    energies = {"energy_sphere": state["energy_sphere"], "impact_energy": state["energy"]}
    if "partner" in own:
        # what the sphere stores here, and what the partners in the study's own rig would store beside it
        compliance = (1.0 - np.square(own["nu"])) / own["E"] + own["partner"]
        energies["energy"] = modulus * compliance * state["energy"]
    state = Columns({**state, **energies})
    if limit.criterion is not None:
        return demand(CRITERIA[limit.criterion], state, limit.parameters)
    return np.asarray(state[limit.quantity], dtype=float)


def equivalent_force(
    limit: Limit, value: Values, sphere: Mapping[str, Values], radius: Values, platens: tuple[float, float]
) -> Array:
    """The force [N] that gives a criterion's value on the row's own sphere, pressed slowly between platens.

    Every criterion rises with the force, nearly as a power of it: the secant in logarithms ends after some steps.  It
    is exact for Hertz: p_max = (6 P E*²/(pi³ r²))^(1/3) gives P = pi³ p_max³ r²/(6 E*²).

    Parameters
    ----------
    limit : its quantity, or criterion with parameters.
    value : (n,) of that criterion in the row, SI.
    sphere : E [Pa], nu, density [kg/m³], (n,) each or numbers; where its poles yield onset_pressure, hardness [Pa],
        pile_up and takes, 1 if the sphere itself yields; partner: (1 - nu²)/E [1/Pa] of what is on the other side in
        the row's own rig, where the energy of both is what is limited.
    radius : of the row's sphere [m], (n,).
    platens : E [Pa], infinite if rigid, and nu of the platens of the tests.

    Returns
    -------
    (n,) forces; 0 for a value of 0, infinite for one that no force reaches (a pressure above the hardness).
    """
    slow = replace(limit, parameters={k: v for k, v in limit.parameters.items() if k != "rate_0"})
    value, radius = np.broadcast_arrays(*(np.atleast_1d(np.asarray(v, dtype=float)) for v in (value, radius)))
    with np.errstate(all="ignore"):
        wanted = np.log(np.where(value > 0.0, value, 1.0))
        x, slope = np.log(1e7 * np.square(radius)), np.full(radius.shape, 0.7)
        y = np.log(reached(slow, np.exp(x), sphere, radius, platens))
        for _ in range(60):
            step = np.clip((wanted - y) / slope, -6.0, 6.0)
            if not (np.abs(step) > 1e-13 * np.maximum(np.abs(x), 1.0)).any():
                break
            after = np.log(reached(slow, np.exp(x + step), sphere, radius, platens))
            secant = (after - y) / step
            slope = np.where((secant > 0.02) & (np.abs(step) > 1e-9), secant, slope)
            x, y = x + step, after
    found = np.where(np.abs(wanted - y) < 1e-6, np.exp(x), np.inf)
    return np.where(value > 0.0, found, 0.0)


def test_force(limit: Limit, value: Values, sphere: Mapping[str, Values], radius: Values) -> Array:
    """The force [N] in the limit's tests that is worth a row's value: what `limit.tested.law` is held against.

    The equivalent force on the row's own sphere, times (D_tests/D)^a with the exponent a of `Tested`; of the draws of a
    lab the value itself, in the size that they hold for.  Parameters and result as of `equivalent_force`.
    """
    tested = limit.tested
    assert tested is not None
    if tested.law is not None:
        value = equivalent_force(limit, value, {**tested.sphere, **sphere}, radius, tested.platens)
    return np.asarray(value * (tested.diameter / (2.0 * np.asarray(radius, dtype=float))) ** tested.exponent)


test_force.__test__ = False  # type: ignore[attr-defined]
