"""Laws of the fracture energy of a particle: its scatter, its size, repeated blows, and the force in its place.

Every function is elementwise; a parameter is a number or an array that broadcasts with energies and diameters.  The
energy e [J/kg] is what the particle itself takes up per its mass; d [m] is the diameter of the sphere of its volume.

    lognormal       P(e) = Phi(ln(e*/E50)/sigma),  e* = e/(1 - e/E_max),  E_max = r E50                        (F1)
    weibull         P(e) = 1 - exp(-ln 2 (e/E50)^m_E),  m_E = 3 m/5, m the modulus of the force                (F2)
    vogel_peukert   P(e) = 1 - exp(-f_mat d (e - W_min)),  d W_min constant                                    (F3)
    size            tavares: E50 = E_inf (1 + (d0/d)^phi);  king: E_inf (1 + d0/d)^phi;  power: C d^-phi       (F4)
    blows           a blow E < e leaves e (1 - D(E/e)), (C17); n equal ones break what has e <= u_n E          (F5)

E50 of (F1) is the median of e*: half the particles break at r/(1 + r) E50.  Sources: L. M. Tavares, R. P. King,
Powder Technol. 123 (2002) 138, in the form of the Rocky white paper on breakage; size "king": BRPROB of MODSIM;
L. Vogel, W. Peukert, Powder Technol. 129 (2003) 101, in the form of fix_break_particle.cpp of LIGGGHTS-PFM.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Values
from uqsphere.mechanics import contact
from uqsphere.mechanics.criteria import fracture_energy
from uqsphere.mechanics.damage import damage_of, energy_share

#: what a law is asked with, by name: median, sigma, ratio, modulus, f_mat, threshold, diameter
Parameters = Mapping[str, Values]
#: E_max over E50 of the truncated law, Rocky's default (from memory)
RATIO: Final = 4.0
#: Newton's steps that find a damage to 1e-15, from a start that is exact at both ends; what counts as nothing left
_STEPS: Final = 7
_LEAST: Final = 1e-30


# --- scatter ----------------------------------------------------------------------------------------------


def _standard(energy: Values, p: Parameters) -> Array:
    """z = ln(e*/E50)/sigma; -inf where there is no energy, inf at E_max and above."""
    e, top = np.asarray(energy, dtype=float), np.asarray(p["ratio"]) * p["median"]
    with np.errstate(divide="ignore", invalid="ignore"):
        left = np.where(e < top, 1.0 - np.where(np.isfinite(top), e / top, 0.0), 0.0)
        return np.asarray((np.log(e / p["median"]) - np.log(left)) / p["sigma"])


def _lognormal_density(energy: Values, p: Parameters) -> Array:
    z, top = _standard(energy, p), np.asarray(p["ratio"]) * p["median"]
    with np.errstate(divide="ignore", invalid="ignore"):
        found = -0.5 * z * z - np.log(np.asarray(p["sigma"]) * math.sqrt(2.0 * math.pi)) - np.log(energy)
        return np.where(np.isfinite(z), found - np.log1p(-np.asarray(energy) / top), -np.inf)


def _lognormal_quantile(share: Values, p: Parameters) -> Array:
    from scipy.special import ndtri

    stretched = p["median"] * np.exp(np.asarray(p["sigma"]) * ndtri(share))
    return np.asarray(stretched / (1.0 + stretched / (np.asarray(p["ratio"]) * p["median"])))


def _hazard(energy: Values, p: Parameters) -> Array:
    """-ln(1 - P) of the Weibull law."""
    return np.asarray(math.log(2.0) * (np.asarray(energy) / p["median"]) ** (0.6 * np.asarray(p["modulus"])))


def _weibull_density(energy: Values, p: Parameters) -> Array:
    h = _hazard(energy, p)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(0.6 * np.asarray(p["modulus"]) * h / energy) - h)


def _excess(energy: Values, p: Parameters) -> Array:
    """-ln(1 - P) of Vogel and Peukert's law."""
    least = np.asarray(p["threshold"]) / p["diameter"]
    return np.asarray(p["f_mat"] * p["diameter"] * np.maximum(np.asarray(energy) - least, 0.0))


def _excess_density(energy: Values, p: Parameters) -> Array:
    least, slope = np.asarray(p["threshold"]) / p["diameter"], np.asarray(p["f_mat"]) * p["diameter"]
    with np.errstate(divide="ignore"):
        return np.where(np.asarray(energy) > least, np.log(slope) - _excess(energy, p), -np.inf)


def _log_rest(hazard: Array) -> Array:
    """ln(1 - exp(-h)), accurate at both ends."""
    with np.errstate(divide="ignore"):
        return np.where(hazard < 1.0, np.log(-np.expm1(-hazard)), np.log1p(-np.exp(-np.maximum(hazard, 1.0))))


def _lognormal_tail(energy: Values, p: Parameters, sign: float = 1.0) -> Array:
    """ln P(e), or ln(1 - P(e)) where the sign is -1."""
    from scipy.special import log_ndtr

    return np.asarray(log_ndtr(sign * _standard(energy, p)))


def _lognormal_between(low: Values, high: Values, p: Parameters) -> Array:
    from scipy.special import log_ndtr

    a, b = _standard(low, p), _standard(high, p)
    # the normal law is even: both ends in the lower tail
    upper = a + b > 0.0
    larger, smaller = log_ndtr(np.where(upper, -a, b)), log_ndtr(np.where(upper, -b, a))
    with np.errstate(invalid="ignore"):
        return np.where(np.isneginf(larger), -np.inf, larger + _log_rest(np.maximum(larger - smaller, 0.0)))


def _between_hazards(first: Array, last: Array) -> Array:
    """ln(exp(-h) - exp(-H)) = -h + ln(1 - exp(h - H))."""
    with np.errstate(invalid="ignore"):
        return np.where(np.isposinf(first), -np.inf, -first + _log_rest(np.maximum(last - first, 0.0)))


@dataclass(frozen=True, kw_only=True)
class FractureLaw:
    """One law of the first fracture energy, as functions of energies [J/kg] and parameters.

    below, above : ln P(e) and ln(1 - P(e)); density : ln f(e) [ln kg/J]; quantile : share -> energy [J/kg]
    between : (low, high) -> ln(P(high) - P(low))
    keys : its own parameters beside those of the size, which give `median`
    sized : whether a size law gives its median
    """

    name: str
    keys: tuple[str, ...]
    below: Callable[[Values, Parameters], Array]
    above: Callable[[Values, Parameters], Array]
    density: Callable[[Values, Parameters], Array]
    between: Callable[[Values, Values, Parameters], Array]
    quantile: Callable[[Values, Parameters], Array]
    sized: bool = True


LAWS: Final = {
    law.name: law
    for law in (
        FractureLaw(
            name="lognormal", keys=("sigma",), density=_lognormal_density, quantile=_lognormal_quantile,
            below=_lognormal_tail, above=lambda e, p: _lognormal_tail(e, p, -1.0),
            between=_lognormal_between,
        ),
        FractureLaw(
            name="weibull", keys=("modulus",), density=_weibull_density,
            quantile=lambda q, p: p["median"]
            * (-np.log1p(-np.asarray(q)) / math.log(2.0)) ** (1.0 / (0.6 * p["modulus"])),
            below=lambda e, p: _log_rest(_hazard(e, p)), above=lambda e, p: -_hazard(e, p),
            between=lambda low, high, p: _between_hazards(_hazard(low, p), _hazard(high, p)),
        ),
        FractureLaw(
            name="vogel_peukert", keys=("f_mat", "threshold"), sized=False,
            density=_excess_density,
            quantile=lambda q, p: p["threshold"] / p["diameter"]
            - np.log1p(-np.asarray(q)) / (p["f_mat"] * p["diameter"]),
            below=lambda e, p: _log_rest(_excess(e, p)), above=lambda e, p: -_excess(e, p),
            between=lambda low, high, p: _between_hazards(_excess(low, p), _excess(high, p)),
        ),
    )
}  # fmt: skip


def broken_share(law: str, energy: Values, p: Parameters) -> Array:
    """P(e): share of particles that one blow of e [J/kg] breaks.

    >>> float(broken_share("lognormal", 80.0, {"median": 100.0, "sigma": 0.6, "ratio": 4.0}))
    0.5
    """
    return np.asarray(np.exp(LAWS[law].below(energy, p)))


# --- size -------------------------------------------------------------------------------------------------

#: parameters of every size law in SI: E_inf [J/kg], d0 [m], phi; C [J/kg m^phi]
SIZES: Final = {
    "tavares": ("e_inf", "d0", "phi"),
    "king": ("e_inf", "d0", "phi"),
    "power": ("C", "phi"),
    "weakest_link": ("C",),
    "class": (),
}


def median_energy(size: str, diameter: Values, p: Parameters) -> Array:
    """E50 [J/kg] at a diameter [m], (F4); `weakest_link`: power with phi = 5/m of flaws in the volume, (F7).

    >>> truth = {"e_inf": 200.0, "d0": 0.006, "phi": 1.1}
    >>> bool(median_energy("tavares", 0.01, truth) < median_energy("king", 0.01, truth))
    True
    """
    d = np.asarray(diameter, dtype=float)
    if size == "tavares":
        return np.asarray(p["e_inf"] * (1.0 + (p["d0"] / d) ** p["phi"]))
    if size == "king":
        return np.asarray(p["e_inf"] * (1.0 + p["d0"] / d) ** p["phi"])
    phi = 5.0 / np.asarray(p["modulus"]) if size == "weakest_link" else p["phi"]
    return np.asarray(p["C"] * d**-phi)


def size_slope(size: str, diameter: Values, p: Parameters) -> Array:
    """-d ln E50/d ln d at a diameter [m]: what scatter and intervals of phi mean at one size."""
    d = np.asarray(diameter, dtype=float)
    if size == "tavares":
        return np.asarray(p["phi"] / (1.0 + (d / p["d0"]) ** p["phi"]))
    if size == "king":
        return np.asarray(p["phi"] / (1.0 + d / p["d0"]))
    return np.asarray(5.0 / np.asarray(p["modulus"]) if size == "weakest_link" else p["phi"]) + 0.0 * d


# --- repeated blows ---------------------------------------------------------------------------------------


def before_blow(left: Values, gamma: Values) -> Array:
    """x = e/E of a particle that a blow E leaves with x (1 - D(1/x)) = left: 1 for nothing left, rising.

    With D the damage, 1/x = energy_share(D): one root of (1 - D) = left energy_share(D), by Newton in the logit of D,
    in which the logarithm of both sides is nearly straight.

    >>> round(float(before_blow(1.0, 4.0)), 6)
    1.450927
    """
    left, g = np.broadcast_arrays(np.asarray(left, dtype=float), np.asarray(gamma, dtype=float))
    with np.errstate(divide="ignore"):
        target = np.log(np.maximum(left, _LEAST))
    slope, total = 2.5 / g, 2.0 * g + 5.0
    t = np.where(target > 0.0, -target / slope, -target)
    for _ in range(_STEPS):
        # ln(1 - D) and ln D of D = 1/(1 + exp(-t)), then ln(1 - D) - ln energy_share(D) and its slope
        whole, damage = -np.logaddexp(0.0, t), 1.0 / (1.0 + np.exp(-t))
        height = whole - slope * (t + whole) - np.log((total - 5.0 * damage) / (2.0 * g)) - target
        steep = -damage - slope * (1.0 - damage) + 5.0 * damage * (1.0 - damage) / (total - 5.0 * damage)
        t = t - height / steep
    return np.maximum(1.0 / energy_share(1.0 / (1.0 + np.exp(-t)), g), 1.0)


def thresholds(gamma: Values, blows: int) -> Array:
    """u_0 ... u_n, (..., n + 1): n equal blows E break what has a first fracture energy of at most u_n E, (F5).

    u_0 = 0, u_1 = 1, u_(k+1) (1 - D(1/u_(k+1))) = u_k; gamma alone settles them.

    >>> thresholds(4.0, 3).round(4).tolist()
    [0.0, 1.0, 1.4509, 1.8166]
    """
    found = [np.zeros(np.shape(gamma))]
    for _ in range(blows):
        found.append(before_blow(found[-1], gamma))
    return np.stack(found, axis=-1)


def survivor_bound(energies: Values, counts: Values, gamma: Values) -> Array:
    """First fracture energy above which a particle survives a series of blows, (...) [J/kg].

    `energies` (..., K) and `counts` (..., K) in the order of the blows, 0 for none; gamma broadcasts with (...).
    From the last blow to the first: c = 0, then the x >= E with x (1 - D(E/x)) = c.
    """
    energies, counts = np.broadcast_arrays(np.asarray(energies, dtype=float), np.asarray(counts))
    bound = np.zeros(np.broadcast_shapes(energies.shape[:-1], np.shape(gamma)))
    for k in range(energies.shape[-1] - 1, -1, -1):
        energy = energies[..., k]
        for blow in range(int(counts[..., k].max(initial=0))):
            struck = (counts[..., k] > blow) & (energy > 0.0)
            with np.errstate(divide="ignore", invalid="ignore"):
                reached = energy * before_blow(np.where(struck, bound / energy, 0.0), gamma)
            bound = np.where(struck, reached, bound)
    return bound


def excess_after(energies: Values, counts: Values, least: Values) -> Array:
    """Sum of n_i max(E_i - W_min, 0) over (..., K) blows, in which Vogel and Peukert's damage is linear, (...)."""
    return np.asarray((counts * np.maximum(np.asarray(energies) - np.asarray(least)[..., None], 0.0)).sum(axis=-1))


def damaged(energy: Values, blow: Values, gamma: Values) -> Array:
    """Fracture energy that a blow leaves: e (1 - D(E/e)), 0 where it breaks the particle.

    >>> float(damaged(100.0, 120.0, 4.0))
    0.0
    """
    e = np.asarray(energy, dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(e > 0.0, np.minimum(np.asarray(blow) / e, 1.0), 1.0)
    return np.where(share < 1.0, e * (1.0 - damage_of(share, gamma)), 0.0)


# --- forces -----------------------------------------------------------------------------------------------


def energy_of_force(force: Values, diameter: Values, stiffness: Values, density: Values) -> Array:
    """W/m [J/kg] of both contacts at a force [N], K_e = E* [Pa]: W = (2/5) F^(5/3) (K_e sqrt(d)/3)^(-2/3).

    Half of it is the particle's between two bodies alike, `particle_share` of it in general.
    """
    radius = 0.5 * np.asarray(diameter, dtype=float)
    work = fracture_energy(force, contact.hertz_constant(stiffness, radius))
    return np.asarray(work / contact.sphere_mass(radius, density))


def force_of_energy(energy: Values, diameter: Values, stiffness: Values, density: Values) -> Array:
    """The force [N] at which both contacts hold W/m [J/kg]: the inverse of `energy_of_force`."""
    radius = 0.5 * np.asarray(diameter, dtype=float)
    work = np.asarray(energy) * contact.sphere_mass(radius, density)
    return np.asarray((1.25 * work) ** 0.6 * contact.hertz_constant(stiffness, radius) ** 0.4)


def particle_share(E: Values, nu: Values, partner_E: Values, partner_nu: Values) -> Array:
    """k_s/(k_p + k_s) = E* (1 - nu²)/E, k = E/(1 - nu²): the particle's share of the energy of a contact, (R22).

    >>> round(float(particle_share(52e9, 0.25, 210e9, 0.3)), 6)
    0.80622
    """
    modulus = contact.reduced_modulus(E, nu, partner_E, partner_nu)
    return np.asarray(modulus * (1.0 - np.square(nu)) / np.asarray(E, dtype=float))
