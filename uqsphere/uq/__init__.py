"""Uncertainty: laws, inputs, sampling, estimates, surrogates, sensitivity, reliability and margins.

Knows only arrays and callables rows -> rows; the physics is somewhere else.
"""

from __future__ import annotations

from uqsphere.uq.estimate import (
    NEVER,
    NORMAL,
    Estimate,
    Why,
    absent,
    exact,
    finite,
    from_replicates,
    spread,
    student,
    widest,
)
from uqsphere.uq.families import LawError
from uqsphere.uq.joint import Dependence, Joint, make_joint
from uqsphere.uq.law import Law, make_law
from uqsphere.uq.limit_state import LimitState, complement, miss, score_of, tails, target_met
from uqsphere.uq.points import random_generator, sobol_points
from uqsphere.uq.sample import Sample, without
from uqsphere.uq.whatif import root

__all__ = [
    "NEVER", "NORMAL", "Dependence", "Estimate", "Joint", "Law", "LawError", "LimitState", "Sample", "Why", "absent",
    "complement", "exact", "finite", "from_replicates", "make_joint", "make_law", "miss", "random_generator", "root",
    "score_of", "sobol_points", "spread", "student", "tails", "target_met", "widest", "without",
]  # fmt: skip
