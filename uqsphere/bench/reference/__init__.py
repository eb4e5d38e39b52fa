"""A second opinion on one scene: implicit collocation in extended precision, sharing nothing but the equations."""

from uqsphere.bench.reference.answers import Reference, refer
from uqsphere.bench.reference.motion import Problem, Unaffordable, follow, problem_of

__all__ = ["Problem", "Reference", "Unaffordable", "follow", "problem_of", "refer"]
