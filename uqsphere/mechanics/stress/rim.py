"""Radial tension on the surface around the contacts, and its weakest-link integral.

Around the contact the half space has sigma_t = (1 - 2 nu)/3 p_0 (a/rho)².  A finite contact has less of it: from the
rim on it falls faster, turns to compression at some place, and for a large contact there is none at all.  While the
force rises, p_0 in proportion with a, the contact grows over places that were at its rim before.  A place counts with
the largest tension that it has seen,

    I_rim = ∫ max over a' <= min(a, rho) of (a'/a sigma_t(rho; a')/p_0(a'))^m dS / S,

over the whole surface, S = 4 pi r², so that the demand never falls while the force rises.  In the half space that is
[(1 - 2 nu)/3]^m a²/(2 r²) 3 m/((m - 1) (m + 2)), of which a²/(2 r² (m - 1)) lies outside of the contacts.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.stress.series import Load, load_coefficients
from uqsphere.mechanics.stress.surface import cross_in_closed_form
from uqsphere.mechanics.stress.tables import CONTACT_RATIO, POISSON, half_space_rim
from uqsphere.mechanics.stress.weakest_link import legendre_even

Array = npt.NDArray[np.float64]

__all__ = ["field_of_the_table", "rim_integrals", "rim_tension"]

#: number of polynomials in z, a/r and nu for the field that the integrals are taken of
_SHAPE: Final = (24, 16, 8)
#: smaller contacts that are looked at: steps of ln a', and their number
_STEP: Final = 0.02
_STEPS: Final = 160


def rim_tension(contact_ratio: float, places: npt.ArrayLike, nu: npt.ArrayLike) -> Array:
    """sigma_t/p_0 at `places` z (k,) for Poisson ratios (n,), from the series: (k, n).

    z runs from 0 at the rim to 1 at the equator, ln(rho/a) = z² ln(r/a); in z the rim is smooth, where the field goes
    with (rho - a)^(3/2).  The sum is cut off smoothly at 800 over a/r and at half of that; at the rim it errs by
    n^(-3/2), which is taken out, and leaves an error below 1e-6.

    >>> float(rim_tension(0.01, [0.0], [0.25])[0, 0].round(3))  # 0.167 in the half space
    0.16
    """
    a = contact_ratio
    z, v = np.atleast_1d(np.asarray(places, dtype=float)), np.atleast_1d(np.asarray(nu, dtype=float))
    angle = np.arcsin(np.minimum(a * np.exp(z**2 * math.log(1.0 / a)), 1.0))
    load = Load.balanced(a)
    terms = 4 * math.ceil(200.0 / a)
    p = load_coefficients(load, terms)
    values, slopes = legendre_even(np.cos(angle), terms)
    n = np.arange(2, terms + 1, 2, dtype=float)[:, None]
    first = 0.5 / (n * n + n + 1.0 + v * (2.0 * n + 1.0))
    second = -first * (n * n + 2.0 * n - 1.0 + 2.0 * v) / (n - 1.0)
    by_value = 1.0 - first * (n * n + 4.0 * n + 2.0 + 2.0 * v) * (n + 1.0) - second * n * n
    by_slope = first * (n + 5.0 - 4.0 * v) + second - (1.0 - 2.0 * v) / (n * (n + 1.0))
    sums = []
    for last in (terms // 2, terms):
        size = (p[2::2] * np.exp(-36.0 * np.minimum(n[:, 0] / last, 2.0) ** 8))[:, None]
        sums.append(values.T @ (size * by_value) + slopes.T @ (size * by_slope))
    rest = sums[1] + (sums[1] - sums[0]) / (2.0**1.5 - 1.0)
    cross = cross_in_closed_form(angle, load, float(p[0]))[:, None]
    return np.asarray(rest - (1.0 - 2.0 * v) * cross)


def _unit_nodes(count: int) -> Array:
    return np.asarray(np.cos(math.pi * (np.arange(count) + 0.5) / count))


@cache
def field_of_the_table() -> Array:
    """Chebyshev coefficients of sigma_t/p_0 in z, ln(a/r) and nu; takes some seconds, once."""
    low, high = (math.log(bound) for bound in CONTACT_RATIO)
    ratios = np.exp(low + 0.5 * (_unit_nodes(_SHAPE[1]) + 1.0) * (high - low))
    places, poisson = 0.5 * (_unit_nodes(_SHAPE[0]) + 1.0), 0.5 * (_unit_nodes(_SHAPE[2]) + 1.0) * POISSON[1]
    found = np.stack([rim_tension(float(ratio), places, poisson) for ratio in ratios], axis=1)
    for axis, count in enumerate(_SHAPE):
        matrix = np.cos(np.outer(np.arange(count), math.pi * (np.arange(count) + 0.5) / count)) * (2.0 / count)
        matrix[0] *= 0.5
        found = np.moveaxis(np.tensordot(matrix, found, axes=(1, axis)), 0, axis)
    return np.asarray(found)


def _tension(contact_ratio: Array, sine: Array, nu: float) -> Array:
    """sigma_t/p_0 at sines rho/r, both of one shape, from the coefficients; between them and the half space below."""
    c = field_of_the_table()
    chebyshev = np.polynomial.chebyshev
    low, high = (math.log(bound) for bound in CONTACT_RATIO)
    known = np.clip(contact_ratio, *CONTACT_RATIO)
    over = np.maximum(sine / contact_ratio, 1.0)
    # a smaller contact than the smallest has its field in rho/a, and a smaller share of what it lacks
    z = np.sqrt(np.minimum(np.log(over) / np.log(1.0 / known), 1.0))
    in_nu = np.tensordot(c, chebyshev.chebval(4.0 * nu - 1.0, np.eye(_SHAPE[2])), axes=(2, 0))
    scale = np.asarray((2.0 * np.log(known) - low - high) / (high - low))
    field = np.zeros_like(sine)
    for weights, polynomial in zip(in_nu, np.eye(_SHAPE[0]), strict=True):
        field += chebyshev.chebval(scale, weights) * chebyshev.chebval(2.0 * z - 1.0, polynomial)
    half_space = (1.0 - 2.0 * nu) / 3.0 / over**2
    return np.asarray(half_space + np.minimum(contact_ratio / CONTACT_RATIO[0], 1.0) * (field - half_space))


def _largest_seen(contact_ratio: float, sine: Array, nu: float) -> Array:
    """max over a' of a'/a sigma_t/p_0(a') at sines (k,), at least zero."""
    smaller = np.minimum(sine, contact_ratio)[:, None] * np.exp(-_STEP * np.arange(_STEPS))
    seen = smaller / contact_ratio * _tension(smaller, np.broadcast_to(sine[:, None], smaller.shape), nu)
    at = np.arange(len(sine))
    k = seen.argmax(axis=1)
    inner = np.clip(k, 1, _STEPS - 2)
    before, here, after = seen[at, inner - 1], seen[at, inner], seen[at, inner + 1]
    bend = before - 2.0 * here + after
    # the top of the parabola through three steps, where the largest one lies between others
    top = here - np.where(bend < 0.0, (after - before) ** 2 / (8.0 * np.where(bend < 0.0, bend, -1.0)), 0.0)
    return np.asarray(np.maximum(np.where((k == inner) & (k > 0), top, seen[at, k]), 0.0))


def rim_integrals(contact_ratio: float, nu: float, moduli: npt.ArrayLike) -> Array:
    """I_rim^(1/m) of every modulus (k,), over that of the half space, `half_space_rim`."""
    nodes, weight = np.polynomial.legendre.leggauss(12)

    def panels(edges: Array) -> tuple[Array, Array]:
        half = 0.5 * np.diff(edges)[:, None]
        return (edges[:-1, None] + half * (nodes + 1.0)).ravel(), (half * weight).ravel()

    length = math.log(1.0 / contact_ratio)
    # places that the contact has grown over, in ln(a/rho), and those outside, in z
    inner, inner_weight = panels(np.concatenate([[0.0], np.geomspace(0.02, 8.0, 14)]))
    outer, outer_weight = panels(np.linspace(0.0, 1.0, 25))
    sine = contact_ratio * np.concatenate([np.exp(-inner), np.exp(outer**2 * length)])
    measure = np.concatenate([inner_weight, 2.0 * outer * length * outer_weight])
    # both hemispheres over the whole sphere: rho drho/(r² cos t)
    measure = measure * sine**2 / np.sqrt(np.maximum(1.0 - sine**2, 1e-15))
    seen = _largest_seen(contact_ratio, np.minimum(sine, 1.0), nu)
    largest = float(seen.max())
    found = [largest * float(np.sum(measure * (seen / largest) ** m)) ** (1.0 / m) for m in np.atleast_1d(moduli)]
    return np.asarray(np.array(found) / half_space_rim(contact_ratio, nu, np.atleast_1d(moduli)))
