"""Sparse polynomial chaos in standardised germs, with an error that can refuse it.

An output is expanded in products of orthonormal polynomials of independent germs (`germs`).  Sets of products, solvers
(`solvers`) and output transforms compete by K-fold error in the units of the output (`choice`); what stays rough is
tried in two pieces (`splits`).  `fit` puts it together, judges it, and says whether more points would help;
`expansion` evaluates and differentiates it, `shares` reads moments and Sobol' indices off it.
"""

from __future__ import annotations

from uqsphere.uq.expansion.expansion import Chaos, Piece, gradients, predict
from uqsphere.uq.expansion.fit import (
    Forecast,
    Verdict,
    enrichment,
    fit_again,
    fit_chaos,
    fit_outputs,
    forecast,
    judge,
    validation_error,
)
from uqsphere.uq.expansion.germs import (
    GERMS,
    Germ,
    germ_points,
    hyperbolic_indices,
    law_germ,
    orthonormal_slopes,
    orthonormal_values,
)
from uqsphere.uq.expansion.shares import chaos_indices, chaos_moments, index_of, indices_of_order

__all__ = [
    "GERMS",
    "Chaos",
    "Forecast",
    "Germ",
    "Piece",
    "Verdict",
    "chaos_indices",
    "chaos_moments",
    "enrichment",
    "fit_again",
    "fit_chaos",
    "fit_outputs",
    "forecast",
    "germ_points",
    "gradients",
    "hyperbolic_indices",
    "index_of",
    "indices_of_order",
    "judge",
    "law_germ",
    "orthonormal_slopes",
    "orthonormal_values",
    "predict",
    "validation_error",
]
