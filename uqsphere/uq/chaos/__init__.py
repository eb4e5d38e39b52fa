"""Sparse polynomial chaos in standardised germs, with an error that can refuse it.

An output is expanded in products of orthonormal polynomials of independent germs (`bases`).  Sets of products
(`truncation`), solvers (`solvers`) and output transforms (`outputs`) compete by K-fold error in the units of the
output (`choice`); what stays rough is tried in two pieces (`splits`, `borders`).  `fit` puts it together and judges
it, `honesty` says what error it reports, `surrogate` evaluates and differentiates it, `indices` reads moments and
Sobol' indices off it, `enrichment` says whether more points would help.
"""

from __future__ import annotations

from uqsphere.uq.chaos.bases import GERMS, Germ, germ_points, law_germ, orthonormal_slopes, orthonormal_values
from uqsphere.uq.chaos.enrichment import Forecast, enrichment, forecast
from uqsphere.uq.chaos.fit import Verdict, fit_again, fit_chaos, fit_outputs, judge, validation_error
from uqsphere.uq.chaos.indices import chaos_indices, chaos_moments, index_of, indices_of_order
from uqsphere.uq.chaos.surrogate import Chaos, Piece, gradients, predict
from uqsphere.uq.chaos.truncation import hyperbolic_indices

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
