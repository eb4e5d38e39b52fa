"""Polynomial chaos: sparse expansions in standardised germs, with an error that can refuse them."""

from uqsphere.uq.chaos.bases import GERMS, germ_points, hyperbolic_indices, orthonormal_slopes, orthonormal_values
from uqsphere.uq.chaos.surrogate import (
    Chaos,
    Verdict,
    chaos_indices,
    chaos_moments,
    closed_index,
    fit_chaos,
    gradient,
    judge,
    predict,
    total_index,
    validation_error,
)

__all__ = [
    "GERMS",
    "Chaos",
    "Verdict",
    "chaos_indices",
    "chaos_moments",
    "closed_index",
    "fit_chaos",
    "germ_points",
    "gradient",
    "hyperbolic_indices",
    "judge",
    "orthonormal_slopes",
    "orthonormal_values",
    "predict",
    "total_index",
    "validation_error",
]
