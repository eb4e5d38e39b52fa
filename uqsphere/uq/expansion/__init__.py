"""Sparse polynomial chaos in standardised germs, with an error that can refuse it.

An output is expanded in products of orthonormal polynomials of independent germs (`germs`).  Sets of products, solvers
(`solvers`) and output transforms compete by K-fold error in the units of the output (`choice`); what stays rough is
tried in two pieces (`splits`).  `fit` puts it together and judges it; `expansion` evaluates it, `shares`
reads moments and Sobol' indices off it.
"""

from __future__ import annotations

from uqsphere.uq.expansion.expansion import Chaos, Piece, held, padded, predict
from uqsphere.uq.expansion.fit import Verdict, fit_again, fit_chaos, fit_outputs, judge, validation_error
from uqsphere.uq.expansion.germs import GERMS, Germ, germ_points, hyperbolic_indices, orthonormal_values
from uqsphere.uq.expansion.shares import chaos_indices, chaos_moments, error_with_tails

__all__ = [
    "GERMS", "Chaos", "Germ", "Piece", "Verdict", "chaos_indices", "chaos_moments", "error_with_tails", "fit_again",
    "fit_chaos", "fit_outputs", "germ_points", "held", "hyperbolic_indices", "judge", "orthonormal_values", "padded",
    "predict", "validation_error",
]  # fmt: skip
