"""Uncertainty: laws, inputs, sampling, estimates, surrogates, sensitivity, reliability and margins.

Knows only arrays and callables rows -> rows; the physics is somewhere else.

    inputs        law · families (the table of distributions) · forms (their functions) · joint (dependence)
                  fitting, location_scale (tests) · observed (columns, draws) · foreign (SciPy, chaospy, SALib)
    designs       points · sample
    answers       estimate · describe
    expansions    chaos · response · surrogate
    sensitivity   indices · shapley · interop (SALib's methods, chaospy's objects)
    limits        limit_state · curve · union · rare

To add a distribution, write its standard form in `forms` (both tails, quantiles, density) and its row in
`families.FAMILIES` (keys of a study, location and scale, fit).  Truncation, moments, sampling, refusals, the schema and
the table of docs/study-file.md follow.  Its test is a line in PAIRS of tests/uq/test_laws.py.

>>> from scipy.special import expit, logit
>>> from uqsphere.uq import families, forms
>>> form = forms.symmetric(expit, logit, lambda y: expit(y) * expit(-y))
>>> row = families.Family(name="logistic", alternatives=(("location", "scale"),),
...                       form=lambda own, lower, upper: (own["location"], own["scale"], form))
>>> law = Law(family=row, parameters=row.parameters({"location": 2.0, "scale": 0.5}, -1.0, 3.0), lower=-1.0, upper=3.0)
>>> law.ppf(law.cdf([2.5])).round(12).tolist(), round(law.mean(), 6)
([2.5], 1.801883)
"""

from __future__ import annotations

from uqsphere.uq.estimate import Estimate, absent, exact, from_replicates, student
from uqsphere.uq.forms import LawError
from uqsphere.uq.joint import Dependence, Joint, make_joint
from uqsphere.uq.law import Law, discrete_law, make_law
from uqsphere.uq.limit_state import LimitState, complement, failure_of_aim, score_of, tails, target_met
from uqsphere.uq.points import random_generator, sobol_points
from uqsphere.uq.sample import Sample

__all__ = [
    "Dependence", "Estimate", "Joint", "Law", "LawError", "LimitState", "Sample", "absent", "complement",
    "discrete_law", "exact", "failure_of_aim", "from_replicates", "make_joint", "make_law", "random_generator",
    "score_of", "sobol_points", "student", "tails", "target_met",
]  # fmt: skip
