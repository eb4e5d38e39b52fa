"""What strengths are held against: a quantity, or the equivalent force where the strength is that
of crushing tests.

A crushing test gives a force on its own sphere.  A row fails where the force that would give its
value of the criterion in the rig of the tests, on the row's own sphere, exceeds the force of the
tests.  So the scatter of E and nu in the tests is never counted a second time.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from uqsphere.arrays import Array
from uqsphere.mechanics.crushing import force_at
from uqsphere.mechanics.rigs import LAW
from uqsphere.study import Limit
from uqsphere.uq import Law, Sample
from uqsphere.uq.fitting import count_tests, is_fitted

from .design import Design, by_force, number

#: numbers of the sphere that the force in a test depends on
SPHERE = ("sphere.E", "sphere.nu", "sphere.density")


def strength_of(limit: Limit) -> Law | float:
    """What a limit is held against: the distribution of the force of its crushing tests, or its
    strength.
    """
    if limit.tested is None or limit.tested.law is None:
        return limit.strength
    return limit.tested.law


def number_of_tests(strength: Law | float) -> int | None:
    """Number of tests behind a strength, None for one that was not fitted to tests."""
    if isinstance(strength, Law) and is_fitted(strength):
        return count_tests(strength)
    return None


def column_of(limit: Limit) -> str:
    """The column of a sample that a limit is held against."""
    if by_force(limit):
        return f"limits.{limit.name}.test_force"
    return limit.quantity


def demands_of(limit: Limit, sample: Sample) -> Array:
    """Demands (R, n) of a limit, with its model factor; those against forces of tests have it
    already.
    """
    demands = sample.answer(column_of(limit))
    if by_force(limit):
        return demands
    return demands * _factor(limit, sample)


def _factor(limit: Limit, sample: Sample) -> Array | float:
    name = f"limits.{limit.name}.model_factor"
    if name in sample.names:
        return sample.input(name)
    return number(limit.model_factor)


def with_test_forces(design: Design, sample: Sample, limits: Sequence[Limit] = ()) -> Sample:
    """An evaluated sample with a column of equivalent test forces for every limit, or some, that
    need them.
    """
    shape = sample.scores.shape[:2]
    varying = {name: sample.input(name) for name in sample.names}
    values: dict[str, Array | float] = {**design.study.at_means(), **varying}
    for limit in limits or design.judged.limits:
        tested = limit.tested
        if tested is None or not by_force(limit):
            continue
        # numbers of what yields in the tests count where they scatter from row to row
        parts = ("sphere", "contact") if tested.sphere.get("takes") else ("contact",)
        yielding = [f"{part}.{key}" for part in parts for key in LAW if key in tested.sphere]
        demand = sample.answer(limit.quantity) * _factor(limit, sample)
        finite = np.isfinite(demand)
        sphere = {
            name.partition(".")[2]: np.broadcast_to(values[name], shape)[finite]
            for name in (*SPHERE, "sphere.radius", *varying.keys() & yielding)
        }
        radius = sphere.pop("radius")
        worth = demand[finite]
        if tested.law is not None:
            sphere = {**tested.sphere, **sphere}
            worth = force_at(worth, limit.demand, sphere, radius, tested.platens)
        # one law of size serves rows, curves and the free number; of draws the value itself is the
        # force, in the size that they hold for
        force = np.full(shape, np.nan)
        force[finite] = worth * (tested.diameter / (2.0 * radius)) ** tested.exponent
        sample = replace(
            sample,
            quantities=(*sample.quantities, column_of(limit)),
            answers=np.dstack([sample.answers, force]),
            censored=np.dstack([sample.censored, sample.late(limit.quantity)]),
        )
    return sample
