"""Sparse polynomial chaos in standardised germs: fit, values, moments, Sobol' indices, and
chaospy's objects.
"""

from .basis import (
    Germ,
    GermLike,
    Germs,
    base_of,
    germ_points,
    germs_of,
    hyperbolic_indices,
    rows_of,
)
from .expansion import Chaos, ChaospyObjects, Integrals, integrals, predict, projections
from .fit import fit_chaos

__all__ = [
    "Chaos",
    "ChaospyObjects",
    "Germ",
    "GermLike",
    "Germs",
    "Integrals",
    "base_of",
    "fit_chaos",
    "germ_points",
    "germs_of",
    "hyperbolic_indices",
    "integrals",
    "predict",
    "projections",
    "rows_of",
]
