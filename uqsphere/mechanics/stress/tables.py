"""What the series says about a whole batch: Chebyshev tables over a/r, Poisson ratio and Weibull modulus.

Every table holds a ratio that depends on nothing else, as coefficients of products of Chebyshev polynomials in
ln(a/r), nu and 1/m; `tables.json` beside this file holds them, `tests/campaigns/stress_tables.py` computes them, and
tests/test_sphere_stress.py compares random points with the series.  The error of every ratio, against the series,
is below 1e-6 of its value over the whole range (of one force alone: 2e-5 at m = 2 and 1e-4 at m = 50); that of the
rim below 2e-4, for it bends where the largest tension of a place is one of the past.

Outside the range the ratio is that of the nearest point inside, so that a demand is never absent; `outside` says
which rows are concerned.  Below a/r = 0.005 this is within some 7 % of the half space's value; above 0.3 Hertz's
contact has ended anyway.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array, Flags, Values

#: ranges of the tables
CONTACT_RATIO: Final = (0.005, 0.3)
POISSON: Final = (0.0, 0.5)
#: of those of the weakest link: above 0.4 a ring of hoop tension around the contact comes up, and the integrals bend
POISSON_WEIBULL: Final = (0.0, 0.4)
MODULUS: Final = (2.0, 50.0)
#: name of a table -> what its values are
NAMES: Final[dict[str, str]] = {
    "core": "largest hoop tension on the axis over p_0, continued through the centre",
    "core_depth": "depth of that tension: (1 - u)/(a/r), u the square of its distance from the centre over r",
    "equator": "hoop tension on the equator over p_0 (a/r)²",
    "shear": "largest shear stress on the axis over p_0",
    "shear_depth": "depth of that shear: (1 - u)/(a/r)",
    "volume": "I_V^(1/m), hoop tension over p_0",
    "surface": "I_S^(1/m), hoop tension over p_0",
    "core_one": "largest hoop tension on the axis over p_0 where one pole alone is pressed",
    "volume_one": "I_V^(1/m) where one pole alone is pressed",
    "surface_one": "I_S^(1/m) where one pole alone is pressed",
    "rim": "I_rim^(1/m), radial tension around the contacts, over that of the half space",
}
#: rows evaluated at a time, so that the polynomials stay in the cache
_CHUNK: Final = 256


@dataclass(frozen=True, kw_only=True)
class Table:
    """Coefficients of exp(sum c_ij(k) T_i(x) T_j(y) (T_k(z))), (i, j) or (i, j, k)."""

    name: str
    coefficients: Array

    def __call__(self, contact_ratio: npt.ArrayLike, nu: npt.ArrayLike, modulus: npt.ArrayLike | None = None) -> Array:
        """The ratio of n rows, (n,) or of the shape the arguments broadcast to; `modulus` for three-way tables."""
        if modulus is None:
            return _two_way([self.coefficients], contact_ratio, nu, POISSON)[0]
        if np.ndim(modulus) == 0:
            # one modulus for all rows: three-way becomes two-way
            weights = _polynomials(_unit_modulus(np.array([modulus], dtype=float)), self.coefficients.shape[2])[0]
            return _two_way([self.coefficients @ weights], contact_ratio, nu, POISSON_WEIBULL)[0]
        return self._three_way(contact_ratio, nu, modulus)

    def _three_way(self, contact_ratio: npt.ArrayLike, nu: npt.ArrayLike, modulus: npt.ArrayLike) -> Array:
        parts = np.broadcast_arrays(*[np.asarray(part, dtype=float) for part in (contact_ratio, nu, modulus)])
        a, v, m = (part.ravel() for part in parts)
        c, out = self.coefficients, np.empty(parts[0].size)
        for start in range(0, len(out), _CHUNK):
            piece = slice(start, start + _CHUNK)
            first = _polynomials(_unit_ratio(_whole(a[piece])), c.shape[0])
            second = _polynomials(_unit(_whole(v[piece]), *POISSON_WEIBULL), c.shape[1])
            third = _polynomials(_unit_modulus(_whole(m[piece])), c.shape[2])
            inner = (first @ c.reshape(c.shape[0], -1)).reshape(len(first), *c.shape[1:])
            column = np.einsum("nj,nj->n", np.einsum("njk,nk->nj", inner, third), second)
            out[piece] = column[: len(out[piece])]
        return np.asarray(np.exp(out).reshape(parts[0].shape))


def _two_way(
    matrices: list[Array], contact_ratio: npt.ArrayLike, nu: npt.ArrayLike, bounds: tuple[float, float]
) -> list[Array]:
    """exp of the sums of several matrices of one shape at the same rows."""
    parts = np.broadcast_arrays(np.asarray(contact_ratio, dtype=float), np.asarray(nu, dtype=float))
    a, v = (part.ravel() for part in parts)
    out = [np.empty(len(a)) for _ in matrices]
    for start in range(0, len(a), _CHUNK):
        piece = slice(start, start + _CHUNK)
        first = _polynomials(_unit_ratio(_whole(a[piece])), matrices[0].shape[0])
        second = _polynomials(_unit(_whole(v[piece]), *bounds), matrices[0].shape[1])
        for matrix, column in zip(matrices, out, strict=True):
            column[piece] = np.einsum("nj,nj->n", first @ matrix, second)[: len(column[piece])]
    return [np.exp(column).reshape(parts[0].shape) for column in out]


def _whole(piece: Array) -> Array:
    """Always as many rows: products of matrices add up in an order that depends on their shape, and a row must not
    depend on how many others come with it."""
    return piece if len(piece) == _CHUNK else np.pad(piece, (0, _CHUNK - len(piece)), mode="edge")


def _unit(value: Array, low: float, high: float) -> Array:
    return np.clip((2.0 * value - low - high) / (high - low), -1.0, 1.0)


def _unit_ratio(value: Array) -> Array:
    with np.errstate(all="ignore"):
        return _unit(np.log(np.maximum(value, 1e-300)), math.log(CONTACT_RATIO[0]), math.log(CONTACT_RATIO[1]))


def _unit_modulus(value: Array) -> Array:
    return _unit(1.0 / value, 1.0 / MODULUS[1], 1.0 / MODULUS[0])


def _polynomials(x: Array, count: int) -> Array:
    """T_0 … T_(count-1) at x, (n, count)."""
    out = np.empty((count, len(x)))
    out[0] = 1.0
    if count > 1:
        out[1] = x
    double = 2.0 * x
    for k in range(2, count):
        np.multiply(double, out[k - 1], out=out[k])
        out[k] -= out[k - 2]
    return out.T


@cache
def load_table(name: str) -> Table:
    """The table of that name, one of `NAMES`.

    >>> load_table("shear").coefficients.ndim
    2
    """
    with (Path(__file__).parent / "tables.json").open(encoding="utf-8") as file:
        entry = json.load(file)[name]
    coefficients = np.zeros(entry["shape"])
    # whole numbers of `unit`; they fall off towards the end of every row, and what is not written is zero
    for index, row in enumerate(entry["rows"]):
        coefficients.reshape(-1, entry["shape"][-1])[index, : len(row)] = np.array(row) * entry["unit"]
    return Table(name=name, coefficients=coefficients)


def ratio(name: str, contact_ratio: Values, nu: Values, modulus: Values = None) -> Array:
    """The tabulated ratio of n rows."""
    return load_table(name)(contact_ratio, nu, modulus)


def core_ratio(contact_ratio: npt.ArrayLike, nu: npt.ArrayLike) -> tuple[Array, Array]:
    """Largest hoop tension on the axis over p_0, and its depth below the surface over r.

    The place moves to the centre as the contact grows.  Its squared distance u from there passes through zero
    smoothly; where it is negative, the largest tension is that of the centre itself.

    >>> tension, depth = core_ratio(0.1, 0.25)
    >>> print(f"{float(tension):.4f} {float(depth):.3f}")
    0.0099 0.219
    """
    a, v = (np.asarray(part, dtype=float) for part in np.broadcast_arrays(contact_ratio, nu))
    inside = np.clip(a, *CONTACT_RATIO)
    value, depth = _two_way([load_table(name).coefficients for name in ("core", "core_depth")], a, v, POISSON)
    square = 1.0 - inside * depth
    tension = np.where(square > 0.0, value, centre_ratio(inside, np.clip(v, *POISSON)))
    return tension, 1.0 - np.sqrt(np.maximum(square, 0.0))


def centre_ratio(contact_ratio: Array, nu: Array) -> Array:
    """Hoop tension at the centre over p_0, exact: only the degrees 0 and 2 reach it.

    sigma = -p_0th + p_2 (7 + 2 nu)/(2 (7 + 5 nu)) with the integrals of the load in closed form.
    """
    a2 = np.square(contact_ratio)
    a = np.sqrt(a2)
    if np.any(a2 <= 0.0):
        raise ValueError("contact_ratio must be above 0")
    c2 = 1.0 - a2
    # ∫ sqrt(t² - c²) dt and ∫ t² sqrt(t² - c²) dt from c to 1
    logarithm = np.log((1.0 + a) / np.sqrt(c2))
    zeroth = 0.5 * (a - c2 * logarithm)
    second = 0.25 * a**3 + 0.25 * c2 * zeroth
    mean = zeroth / a
    p_2 = 5.0 * (1.5 * second / a - 0.5 * mean)
    return np.asarray(-mean + p_2 * (7.0 + 2.0 * nu) / (2.0 * (7.0 + 5.0 * nu)))


def half_space_rim(contact_ratio: npt.ArrayLike, nu: npt.ArrayLike, modulus: npt.ArrayLike) -> Array:
    """I_rim^(1/m) of the half space: (1 - 2 nu)/3 [(a/r)²/2 3 m/((m - 1) (m + 2))]^(1/m)."""
    m = np.asarray(modulus, dtype=float)
    area = 0.5 * np.square(np.asarray(contact_ratio, dtype=float)) * 3.0 * m / ((m - 1.0) * (m + 2.0))
    return np.asarray((1.0 - 2.0 * np.asarray(nu, dtype=float)) / 3.0 * area ** (1.0 / m))


def outside(contact_ratio: npt.ArrayLike, nu: npt.ArrayLike, modulus: npt.ArrayLike | None = None) -> Flags:
    """Which rows lie outside the range of the tables; with a modulus, of those of the weakest link.

    >>> outside([0.1, 0.4], 0.25).tolist()
    [False, True]
    """
    ranges = [(contact_ratio, CONTACT_RATIO), (nu, POISSON if modulus is None else POISSON_WEIBULL)]
    if modulus is not None:
        ranges.append((modulus, MODULUS))
    inside = [(np.asarray(value) >= low) & (np.asarray(value) <= high) for value, (low, high) in ranges]
    return np.asarray(~np.logical_and.reduce(np.broadcast_arrays(*inside)))
