"""Uncertainty: laws, inputs, sampling, estimates, surrogates, sensitivity, reliability and margins.

Knows only arrays and callables rows -> rows; the physics is somewhere else.  By module: `law`, `families`, `fitting`,
`joint` (inputs) · `points`, `sample` (designs) · `estimate`, `describe` (answers) · `chaos`, `response` (expansions) ·
`indices`, `shapley`, `interop` (sensitivity) · `limit_state`, `curve`, `union`, `rare`
(limits).
"""

from __future__ import annotations

from uqsphere.uq.estimate import NORMAL, REPLICATES, Estimate, absent, exact, from_replicates, spread, student
from uqsphere.uq.forms import LawError
from uqsphere.uq.joint import Dependence, Joint, make_joint
from uqsphere.uq.law import Law, discrete_law, make_law
from uqsphere.uq.limit_state import (
    LimitState,
    complement,
    exceedance,
    miss,
    reliability_index,
    safety_factor,
    score_of,
    tails,
    target_met,
)
from uqsphere.uq.points import random_generator, sobol_points
from uqsphere.uq.sample import Sample

__all__ = [
    "NORMAL", "REPLICATES", "Dependence", "Estimate", "Joint", "Law", "LawError", "LimitState", "Sample", "absent",
    "complement", "discrete_law", "exact", "exceedance", "from_replicates", "make_joint", "make_law",
    "miss", "random_generator", "reliability_index", "safety_factor", "score_of", "sobol_points", "spread",
    "student", "tails", "target_met",
]  # fmt: skip
