"""Stress inside an elastic sphere under Hertz pressure on two polar caps: tables of its largest
values and of weakest-link integrals.

Every table holds a ratio that depends on nothing else, as coefficients of products of Chebyshev
polynomials in ln(a/r), nu and 1/m, in `stress_tables.json`.  `tests/campaigns/stress_tables.py`
computes them from the Legendre series of theory section 6, and
`tests/mechanics/test_sphere_stress.py` compares random points with the series.  The error of every
ratio is below 1e-6 of its value over the whole range (of one force alone: 2e-5 at m = 2 and 1e-4 at
m = 50); that of the rim below 2e-4, for it bends where the largest tension of a place is one of the
past.  Outside the range the ratio is that of the nearest point inside, so that a demand is never
absent; the ranges of the criteria say which rows are concerned.  Below a/r = 0.005 this is within
some 7 % of the half space's value; above 0.3 Hertz's contact has ended anyway.
"""

import json
from functools import cache
from pathlib import Path

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from uqsphere.arrays import Array, Values

#: ranges of the tables
CONTACT_RATIO = (0.005, 0.3)
POISSON = (0.0, 0.5)
#: of those of the weakest link: above 0.4 a ring of hoop tension around the contact comes up, and
#: the integrals bend
POISSON_WEIBULL = (0.0, 0.4)
MODULUS = (2.0, 50.0)
#: rows evaluated at a time, so that the polynomials stay in the cache
_CHUNK = 256


@cache
def load_table(name: str) -> Array:
    """Coefficients of exp(sum c_ij(k) T_i(x) T_j(y) (T_k(z))), (i, j) or (i, j, k).

    A table over p_0: core, shear (largest on the axis), equator (over (a/r)²), volume, surface
    (I^(1/m)), rim (over that of the half space); with `_one` where one pole is pressed, with
    `_depth` where it lies, (1 - u)/(a/r).

    >>> load_table("shear").ndim
    2
    """
    entry = json.loads(Path(__file__).with_name("stress_tables.json").read_text("utf-8"))[name]
    coefficients = np.zeros(entry["shape"])
    # whole numbers of `unit`; they fall off towards the end of every row, and what is not written
    # is zero
    for written, row in zip(
        entry["rows"], coefficients.reshape(-1, entry["shape"][-1]), strict=True
    ):
        row[: len(written)] = np.array(written) * entry["unit"]
    return coefficients


def ratio(name: str, contact_ratio: Values, nu: Values, modulus: float | None = None) -> Array:
    """The tabulated ratio of n rows, (n,); with one Weibull modulus for tables of the weakest link.

    Parameters
    ----------
    name : of a table, see `load_table`.
    contact_ratio, nu : a/r and Poisson ratio of the rows, (n,) or numbers.
    modulus : Weibull modulus m of three-way tables.
    """
    matrix = load_table(name)
    bounds = POISSON
    if modulus is not None:
        inverse = _unit(1.0 / modulus, 1.0 / MODULUS[1], 1.0 / MODULUS[0])
        matrix = matrix @ chebvander(inverse, matrix.shape[2] - 1)[0]
        bounds = POISSON_WEIBULL
    parts = np.broadcast_arrays(contact_ratio, nu)
    size = parts[0].size
    # always whole chunks: products of matrices add up in an order that depends on their shape, and
    # a row must not depend on how many others come with it
    a, v = (np.pad(part.ravel(), (0, -size % _CHUNK)) for part in parts)
    low, high = np.log(CONTACT_RATIO)
    degree_a, degree_v = np.subtract(matrix.shape, 1)
    out = np.empty(len(a))
    for start in range(0, len(a), _CHUNK):
        piece = slice(start, start + _CHUNK)
        logarithm = np.log(np.maximum(a[piece], 1e-300))
        first = chebvander(_unit(logarithm, low, high), degree_a)
        second = chebvander(_unit(v[piece], *bounds), degree_v)
        out[piece] = np.einsum("nj,nj->n", first @ matrix, second)
    return np.exp(out[:size]).reshape(parts[0].shape)


def _unit(value: Values, low: float, high: float) -> Values:
    """From [low, high] to [-1, 1]."""
    return np.clip((2.0 * value - low - high) / (high - low), -1.0, 1.0)


def core_ratio(contact_ratio: Values, nu: Values) -> Array:
    """Largest hoop tension on the axis over p_0.

    Its place moves to the centre as the contact grows.  Its squared distance u from there passes
    through zero smoothly; where it is negative, the largest tension is that of the centre itself.

    >>> round(float(core_ratio(0.1, 0.25)), 4)
    0.0099
    """
    inside = np.clip(contact_ratio, *CONTACT_RATIO)
    value = ratio("core", contact_ratio, nu)
    square = 1.0 - inside * ratio("core_depth", contact_ratio, nu)
    return np.where(square > 0.0, value, centre_ratio(inside, np.clip(nu, *POISSON)))


def centre_ratio(contact_ratio: Array, nu: Array) -> Values:
    """Hoop tension at the centre over p_0, exact: only the degrees 0 and 2 reach it.

    sigma = -p_0th + p_2 (7 + 2 nu)/(2 (7 + 5 nu)) with the integrals of the load in closed form.
    """
    a = contact_ratio
    c2 = 1.0 - np.square(a)
    # ∫ sqrt(t² - c²) dt and ∫ t² sqrt(t² - c²) dt from c to 1
    logarithm = np.log((1.0 + a) / np.sqrt(c2))
    zeroth = 0.5 * (a - c2 * logarithm)
    second = 0.25 * a**3 + 0.25 * c2 * zeroth
    mean = zeroth / a
    p_2 = 5.0 * (1.5 * second / a - 0.5 * mean)
    return -mean + p_2 * (7.0 + 2.0 * nu) / (2.0 * (7.0 + 5.0 * nu))


def half_space_rim(contact_ratio: Values, nu: Values, modulus: Values) -> Values:
    """I_rim^(1/m) of the half space: (1 - 2 nu)/3 [(a/r)²/2 3 m/((m - 1) (m + 2))]^(1/m)."""
    m = modulus
    area = 0.5 * np.square(contact_ratio) * 3.0 * m / ((m - 1.0) * (m + 2.0))
    return (1.0 - 2.0 * np.array(nu)) / 3.0 * area ** (1.0 / m)
