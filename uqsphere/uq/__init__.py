"""Uncertainty: laws, inputs, sampling, estimates, surrogates, sensitivity, reliability and margins.

Knows only arrays and callables rows -> rows; the physics is somewhere else.

    inputs        law · families (the table of distributions) · forms (their functions)
                  joint (dependence) · fitting (tests) · foreign (SciPy, chaospy, SALib)
    designs       points · sample
    answers       estimate · describe
    expansions    chaos · response · surrogate
    sensitivity   indices · shapley · interop (SALib's methods, chaospy's objects)
    limits        limit_state · curve · rare

To add a distribution, write its standard form in `forms` (both tails, quantiles, density), its row
in `families.FAMILIES` (keys of a study, location and scale) and its fit in `fitting`.  Truncation,
moments, sampling, refusals, the schema and the table of docs/study-file.md follow.  Its test is a
line in PAIRS of tests/uq/test_laws.py.
"""

from .estimate import ENDS, LEVEL_TEXT, Estimate, absent, exact, from_replicates, student
from .forms import LawError
from .joint import Dependence, Joint, make_joint
from .law import Law, discrete_law, make_law
from .limit_state import LimitState, score_of
from .points import random_generator, sobol_points
from .sample import Sample

__all__ = [
    "ENDS",
    "LEVEL_TEXT",
    "Dependence",
    "Estimate",
    "Joint",
    "Law",
    "LawError",
    "LimitState",
    "Sample",
    "absent",
    "discrete_law",
    "exact",
    "from_replicates",
    "make_joint",
    "make_law",
    "random_generator",
    "score_of",
    "sobol_points",
    "student",
]
