"""Laws of the fracture energy of a particle: scatter, size, repeated blows, force, product.

Every function is elementwise on arrays.  The energy e [J/kg] is what the particle itself absorbs
per mass, d [m] the diameter of the sphere of its volume.

    (L1) lognormal  P(e) = Phi(ln(e*/E50)/sigma),  e* = e/(1 - e/E_max),  E_max = r E50
    (L2) weibull    P(e) = 1 - exp(-ln 2 (e/E50)^s),  s = 3 m/5,  m the modulus of the force
    (L3) size       tavares  E50 = E_inf (1 + (d0/d)^phi)
                    king     E50 = E_inf (1 + d0/d)^phi
                    power    E50 = C d^-phi
    (L4) damage     a blow E < e leaves e (1 - D),  E/e = D^(5/(2g)) (2g + 5 - 5D)/(2g)
    (L5) blows      n equal blows E break particles with e <= u_n E,  u_(n+1) (1 - D(1/u_(n+1))) =
                    u_n
    (L6) product    t10 = A (1 - exp(-b E)),  t_n = 1 - (1 - t10)^((9/(n-1))^alpha)

Half of the particles break at e = r/(1 + r) E50 of (L1), not at E50.  Sources: L. M. Tavares, R. P.
King, Powder Technol. 123 (2002) 138; R. P. King, MODSIM (BRPROB, TN, TN1); T. J. Napier-Munn and
others, Mineral Comminution Circuits, 1996.
"""

import math
from typing import NamedTuple

import numpy as np

from uqsphere.arrays import Array, Values, quiet, special
from uqsphere.mechanics.contact import hertz_constant, sphere_mass
from uqsphere.mechanics.roots import bisect

#: parameters of a size law, the energy first, by its name
SIZES = {"tavares": ("e_inf", "d0", "phi"), "king": ("e_inf", "d0", "phi"), "power": ("C", "phi")}
LAWS = {"lognormal": "sigma", "weibull": "modulus"}


class Scatter(NamedTuple):
    """The scatter of fracture energies: (L1) for the law "lognormal", (L2) for "weibull".

    median : E50 [J/kg]; shape : sigma, or the modulus m; ratio : E_max/E50 of (L1).
    """

    law: str
    median: Values
    shape: Values
    ratio: Values

    @quiet
    def standard(self, energy: Values) -> Values:
        """z = ln(e*/E50)/sigma of (L1); -inf without energy, inf from E_max on."""
        top = self.ratio * self.median
        left = np.where(energy < top, 1.0 - energy / top, 0.0)
        return (np.log(energy / self.median) - np.log(left)) / self.shape

    @quiet
    def hazard(self, energy: Values) -> Values:
        """-ln(1 - P) of (L2)."""
        return math.log(2.0) * (energy / self.median) ** (0.6 * self.shape)

    def broken_share(self, energy: Values) -> Values:
        """P(e): share of particles that one blow of e [J/kg] breaks."""
        if self.law == "lognormal":
            return special.ndtr(self.standard(energy))
        return -np.expm1(-self.hazard(energy))

    def energy_at(self, share: Values) -> Values:
        """The energy [J/kg] that breaks a share: the inverse of `broken_share`."""
        if self.law == "lognormal":
            stretched = self.median * np.exp(self.shape * special.ndtri(share))
            return stretched / (1.0 + stretched / (self.ratio * self.median))
        hazards = -np.log1p(-share) / math.log(2.0)
        return self.median * hazards ** (1.0 / (0.6 * self.shape))

    def log_density(self, ends: Array) -> Values:
        """ln f(e) at the upper one of two ends (2, ...) [J/kg]."""
        energy = ends[1]
        if self.law == "weibull":
            exponent = self.hazard(energy)
            return np.log(0.6 * self.shape * exponent / energy) - exponent
        z = self.standard(energy)
        top = self.ratio * self.median
        density = -0.5 * z * z - np.log(self.shape * math.sqrt(2.0 * math.pi) * energy)
        return np.where(energy < top, density - np.log1p(-energy / top), -np.inf)

    def log_between(self, ends: Array) -> Array:
        """ln(P(high) - P(low)) of two ends (2, ...) [J/kg]."""
        if self.law == "weibull":
            low, high = map(self.hazard, ends)
            larger = -low
            gap = high - low
        else:
            low, high = map(self.standard, ends)
            # the normal distribution is even: both ends in the lower tail
            upper = low + high > 0.0
            larger = special.log_ndtr(np.where(upper, -low, high))
            gap = larger - special.log_ndtr(np.where(upper, -high, low))
        h = np.maximum(gap, 0.0)  # and ln(1 - exp(-h))
        rest = np.where(h < 1.0, np.log(-np.expm1(-h)), np.log1p(-np.exp(-np.maximum(h, 1.0))))
        return np.where(np.isneginf(larger), -np.inf, larger + rest)


@quiet
def median_energy(
    size: str, diameter: Values, energy: Values, phi: Values, d0: Values = math.nan
) -> Values:
    """E50 [J/kg] at a diameter [m], (L3); `energy` is E_inf [J/kg], or C [J/kg m^phi]."""
    if size == "tavares":
        return energy * (1.0 + (d0 / diameter) ** phi)
    if size == "king":
        return energy * (1.0 + d0 / diameter) ** phi
    return energy * diameter**-phi


@quiet
def before_blow(left: Values, gamma: Values) -> Array:
    """x = e/E >= 1 of a particle of which a blow E leaves x (1 - D) = `left`, (L4); 1 for nothing
    left.

    (1 - D)/(E/e) = left falls with D; by bisection in the logit of D, since (L4) is flat at D = 1.

    >>> round(float(before_blow(2.0 * (1.0 - 0.168913045), 4.0)), 7)
    2.0
    """
    g = np.asarray(gamma)
    wanted = np.log(np.maximum(left, 1e-300))

    def log_share(t: Values) -> Values:
        """ln E/e at the logit of a damage."""
        log_d = -np.logaddexp(0.0, -t)
        return (2.5 / g) * log_d + np.log((2.0 * g + 5.0 - 5.0 * np.exp(log_d)) / (2.0 * g))

    logit, _ = bisect(
        lambda t: -np.logaddexp(0.0, t) - log_share(t) > wanted, -150.0, 700.0, halvings=70
    )
    return np.where(left > 0.0, np.exp(-log_share(logit)), 1.0)


def survivor_bound(energies: Values, gamma: Values) -> Array:
    """First fracture energy [J/kg] above which a particle survives blows (..., n) in their order; 0
    is no blow.

    From the last blow to the first: c = 0, then the x >= E with x (1 - D(E/x)) = c.

    >>> survivor_bound([1.0, 1.0, 1.0], 4.0).round(4).tolist()
    1.8166
    """
    blows = np.asarray(energies, float)
    bound = np.zeros(np.broadcast_shapes(blows.shape[:-1], np.shape(gamma)))
    for energy in np.moveaxis(blows, -1, 0)[::-1]:
        struck = energy > 0.0
        left = bound / np.where(struck, energy, 1.0)
        reached = np.maximum(energy * before_blow(left, gamma), energy)
        bound = np.where(struck, reached, bound)
    return bound


def thresholds(gamma: Values, blows: int) -> Array:
    """u_0 ... u_n of (L5), (..., n + 1).

    >>> thresholds(4.0, 3).round(4).tolist()
    [0.0, 1.0, 1.4509, 1.8166]
    """
    steps = [np.zeros(np.shape(gamma))]
    for _ in range(blows):
        steps.append(before_blow(steps[-1], gamma))
    return np.stack(steps, axis=-1)


def energy_of_force(force: Values, diameter: Values, modulus: Values, mass: Values) -> Values:
    """W/m [J/kg] of both contacts at a force [N] by Hertz: two of (2/5) F alpha, alpha =
    (F/beta)^(2/3).
    """
    beta = hertz_constant(modulus, 0.5 * diameter)
    return 0.8 * force ** (5.0 / 3.0) / beta ** (2.0 / 3.0) / mass


def particle_share(particle: float, partner: float) -> float:
    """k_s/(k_p + k_s), k = E/(1 - nu²) [Pa] of particle and partner: the particle's share of the
    energy of a contact.

    >>> round(particle_share(52e9 / (1.0 - 0.25**2), 210e9 / (1.0 - 0.3**2)), 6)
    0.80622
    """
    return partner / (particle + partner)


def mass_of(diameter: Values, density: Values) -> Values:
    """pi/6 rho d³ [kg]."""
    return sphere_mass(0.5 * diameter, density)


def t10(energy: Values, A: Values, b: Values) -> Values:
    """Share finer than a tenth of the size, (L6); b [kg/J] of the energy offered."""
    return A * -np.expm1(-b * energy)


@quiet
def t_n(n: Values, fineness: Values, curve: str, alpha: Values) -> Array:
    """Share finer than d/n of t10; 1 for n <= 1.  `milin`: t_n = I_t10(a(n), b(n)).

    >>> t_n([2.0, 10.0], 0.3, "trr", 0.8).round(6).tolist()
    [0.873631, 0.3]
    """
    n, fine, alpha = np.broadcast_arrays(n, np.clip(fineness, 0.0, 1.0), alpha)
    x = np.where(n > 1.0, n, 2.0)
    if curve == "trr":
        finer = -np.expm1((9.0 / (x - 1.0)) ** alpha * np.log1p(-fine))
    else:
        a = -0.7846 * np.exp(-0.4988 * x)
        a += 0.9190 * x**0.04526 / (0.000972 * x**2 + 1.0) ** 0.03797
        b = 1.193 / (x - 1.0) ** 1.392
        b += 2.722 * x**-0.3404 / (0.01175 * x**2 + 1.0) ** 0.3381
        finer = special.betainc(a, np.minimum(b, 1e6), fine)
    return np.where(n > 1.0, finer, 1.0)
