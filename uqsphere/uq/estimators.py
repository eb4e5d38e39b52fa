"""Estimators of first and total Sobol' indices by pick and freeze: ratios of two means over the points of a replicate.

Write a, b, ab, ba for the outputs on the blocks A, B, AB_j, BA_j of a design (`uqsphere.uq.blocks`), about their common
mean, and V for their variance.  Every function gives numerators and denominators (R, m) of R replicates and m indices.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, TypeAlias

import numpy as np

from uqsphere.arrays import Array

__all__ = ["ESTIMATORS", "Ratio", "block_mean", "jansen_total"]

#: Numerators and denominators of replicates, (R, m) each, of m indices that are their ratios.
Ratio: TypeAlias = tuple[Array, Array]


def block_mean(rows: Array) -> Array:
    """Means (R, m) over the points of (R, N, m)."""
    return np.asarray(rows.mean(axis=1))


def _variance(a: Array, b: Array, like: Array) -> Array:
    """V of every replicate about the common mean, repeated for as many indices as `like` has blocks."""
    return np.repeat(0.5 * block_mean(a * a + b * b), like.shape[2], axis=1)


def _saltelli_first(a: Array, b: Array, ab: Array) -> Ratio:
    """<b (ab - a)> / V (Saltelli et al., Comput. Phys. Commun. 181, 2010, 259, table 2 (b))."""
    return block_mean(b * (ab - a)), _variance(a, b, ab)


def _jansen_first(a: Array, b: Array, ab: Array) -> Ratio:
    """1 - <(b - ab)²> / 2V (Jansen, Comput. Phys. Commun. 117, 1999, 35; Saltelli's table 2 (c))."""
    v = _variance(a, b, ab)
    return v - 0.5 * block_mean((b - ab) ** 2), v


def jansen_total(a: Array, b: Array, ab: Array) -> Ratio:
    """<(a - ab)²> / 2V (Jansen 1999; Saltelli's table 2 (f))."""
    return 0.5 * block_mean((a - ab) ** 2), _variance(a, b, ab)


def _pairs(y: Array, z: Array) -> Ratio:
    """<y z> / <(y² + z²)/2> about the common mean of the pair, for runs that share some inputs.

    Janon, Klein, Lagnoux, Nodet, Prieur, ESAIM: Prob. Stat. 18, 2014, 342, equation (6).  Numerator and
    denominator share their noise: little of it is left where the index is near 1.
    """
    mean = 0.5 * (y.mean(axis=(0, 1)) + z.mean(axis=(0, 1)))
    y, z = y - mean, z - mean
    return block_mean(y * z), 0.5 * block_mean(y * y + z * z)


def _janon_first(a: Array, b: Array, ab: Array) -> Ratio:
    return _pairs(b, ab)


def _janon_total(a: Array, b: Array, ab: Array) -> Ratio:
    product, square = _pairs(a, ab)
    return square - product, square


def _martinez(y: Array, z: Array) -> Ratio:
    """Pearson's correlation of pairs, each about its own mean and in its own scale.

    J.-M. Martinez, GdR MASCOT-NUM, 2011; the statistic is that of Baudin et al., arXiv 1606.01746.
    """
    y, z = y - y.mean(axis=(0, 1)), z - z.mean(axis=(0, 1))
    vy, vz = block_mean(y * y), block_mean(z * z)
    # The root of the product of two means, linearised about their pooled values, is a mean over replicates again.
    py, pz = vy.mean(axis=0), vz.mean(axis=0)
    root = np.sqrt(py * pz)
    with np.errstate(invalid="ignore", divide="ignore"):
        return block_mean(y * z), np.where(root > 0.0, 0.5 * root * (vy / py + vz / pz), 0.0)


def _martinez_first(a: Array, b: Array, ab: Array) -> Ratio:
    return _martinez(b, ab)


def _martinez_total(a: Array, b: Array, ab: Array) -> Ratio:
    product, root = _martinez(a, ab)
    return root - product, root


def _azzini_scale(a: Array, b: Array, ab: Array, ba: Array) -> Array:
    return block_mean((a - b) ** 2 + (ba - ab) ** 2)


def _azzini_first(a: Array, b: Array, ab: Array, ba: Array) -> Ratio:
    """2 <(ba - b)(a - ab)> / <(a - b)² + (ba - ab)²> (Azzini, Mara, Rosati, MethodsX 8, 2021, 101201)."""
    return 2.0 * block_mean((ba - b) * (a - ab)), _azzini_scale(a, b, ab, ba)


def _azzini_total(a: Array, b: Array, ab: Array, ba: Array) -> Ratio:
    """<(b - ba)² + (a - ab)²> / <(a - b)² + (ba - ab)²> (the same)."""
    return block_mean((b - ba) ** 2 + (a - ab) ** 2), _azzini_scale(a, b, ab, ba)


def _owen_first(a: Array, b: Array, ac: Array, ba: Array) -> Ratio:
    """<(a - ac)(ba - b)> / V: "correlation 2" of Owen (ACM Trans. Model. Comput. Simul. 23, 2013, article 11).

    Both factors vanish with the effect of the input, so that the error of a small index is small beside it.
    """
    return block_mean((a - ac) * (ba - b)), _variance(a, b, ba)


#: Estimator -> order -> ratio of what it needs: a, b, ab; "azzini_rosati" also ba; "owen" a, b, ac, ba.
ESTIMATORS: Final[Mapping[str, Mapping[str, Callable[..., Ratio]]]] = {
    "saltelli": {"first": _saltelli_first, "total": jansen_total},
    "jansen": {"first": _jansen_first, "total": jansen_total},
    "janon_monod": {"first": _janon_first, "total": _janon_total},
    "martinez": {"first": _martinez_first, "total": _martinez_total},
    "azzini_rosati": {"first": _azzini_first, "total": _azzini_total},
    "owen": {"first": _owen_first},
}
