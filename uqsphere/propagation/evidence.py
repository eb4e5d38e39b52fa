"""What the crushing tests of a study say of strengths of the library.

Each sphere of the tests stood up to its force, so that every one of its strengths is at least the
demand at that force in the test rig, and F(demand) of a true strength lies below a uniform
variable: the one-sided Kolmogorov-Smirnov distance has at most its usual probability.  (The product
of the probabilities to stand would refute every true strength, because at the forces of failure it
is a product of uniform variables.)
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from uqsphere.arrays import Array
from uqsphere.mechanics.crushing import value_at
from uqsphere.propagation.failure_modes import AssumedMode, scaled_strength, size_factor
from uqsphere.results.types import EvidenceEntry
from uqsphere.study import Study
from uqsphere.study.values import Tested
from uqsphere.uq import Law

#: a strength, or a distribution, that makes the tests less probable than this is refuted
REFUTED = 0.05


def series_of(study: Study) -> list[Tested]:
    """The crushing tests of a study, each series once."""
    series = {
        limit.tested.forces: limit.tested
        for limit in study.limits
        if limit.tested is not None and limit.tested.forces
    }
    return list(series.values())


def judged_by_tests(
    study: Study, modes: Sequence[AssumedMode]
) -> tuple[list[EvidenceEntry], list[AssumedMode]]:
    """The evidence on every assumed mode, and the modes that are left, with what is left of their
    range.
    """
    series = series_of(study)
    if not series:
        return [], list(modes)
    results = []
    modes_left = []
    for mode in modes:
        evidence = _evidence(study, series, mode)
        results.append(evidence)
        if evidence.refuted:
            continue
        weak = scaled_strength(mode.weak, evidence.raised)
        middle = max(mode.middle, weak, key=median)
        modes_left.append(replace(mode, weak=weak, limit=replace(mode.limit, strength=middle)))
    return results, modes_left


def _evidence(study: Study, series: Sequence[Tested], mode: AssumedMode) -> EvidenceEntry:
    demands = demands_in_tests(study, series, mode)
    weak, centre, strong = standing(
        np.array([law.cdf(demands) for law in (mode.weak, mode.middle, mode.strong)])
    ).tolist()
    refuted = strong < REFUTED
    raised = 1.0
    if weak < REFUTED and not refuted:
        # the strong end of a range may be of another scatter than its weak end
        factor = float(least_factor(mode.weak, demands[None, :])[0])
        raised = min(factor, median(mode.strong) / median(mode.weak))
    return EvidenceEntry(
        mode=mode.called,
        tests=len(demands),
        weak=weak,
        middle=centre,
        strong=strong,
        refuted=refuted,
        raised=raised,
    )


def demands_in_tests(study: Study, series: Sequence[Tested], mode: AssumedMode) -> Array:
    """The demand (n,) of a mode in each test at its force, over its size factor for that sphere."""
    mean = study.at_means()["sphere.radius"]
    parts = []
    for tested in series:
        radius = 0.5 * np.array(tested.diameters)
        demand = value_at(
            np.array(tested.forces), mode.limit.demand, tested.sphere, radius, tested.platens
        )
        parts.append(demand / (size_factor(mode, radius) / size_factor(mode, mean)))
    return np.concatenate(parts)


def standing(below: Array) -> Array:
    """Probability (J,) of J series of tests, from F(demand at the force that was borne) (J, n).

    >>> standing(np.array([[0.1, 0.3, 0.5, 0.7, 0.9], [0.9, 0.95, 0.97, 0.98, 0.99]])).round(3)
    array([0.854, 0.   ])
    """
    from scipy.stats import ksone

    ordered = np.sort(below, axis=1)
    n = ordered.shape[1]
    distance = (ordered - np.arange(n) / n).max(axis=1)
    return np.asarray(ksone.sf(np.maximum(distance, 1e-9), n))


def least_factor(law: Law, demands: Array) -> Array:
    """What a strength must be multiplied by (J,) at least for J series of tests, whose spheres bore
    demands (J, n), not to refute it.
    """
    from scipy.stats import ksone

    n = demands.shape[1]
    below = np.arange(n) / n + ksone.isf(REFUTED, n)
    inside = below < 1.0
    ordered = np.sort(demands, axis=1)[:, inside]
    return np.asarray((ordered / law.ppf(below[inside])).max(axis=1))


def median(law: Law) -> float:
    """The median of a distribution."""
    return float(law.ppf(0.5))


def refuted_text(evidence: EvidenceEntry) -> str:
    """Why a mode that the tests refute is not judged."""
    return f"refuted by your {evidence.tests} tests: spheres bore more than this strength allows"
