"""What a run evaluates: the random variables, the columns of every failure mode with what strengths
are held against, and the points of each table.

Points are scrambled Sobol' sequences, `REPLICATES` of them, each an independent randomisation of
the same design: intervals of sampled answers follow from what the replicates differ by.

A strength is held against a quantity, or the equivalent force where it is that of crushing tests.
A crushing test gives a force on its own sphere.  A row fails where the force that would give its
value of the criterion in the rig of the tests, on the row's own sphere, exceeds the force of the
tests.  So the scatter of E and nu in the tests is never counted a second time.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from uqsphere.arrays import Array, Names, bundle, special
from uqsphere.mechanics.crushing import force_at
from uqsphere.mechanics.rigs import LAW
from uqsphere.models.scene import absent_quantity
from uqsphere.results.types import EvidenceEntry
from uqsphere.study import Limit, Study, limit_of, mean_of
from uqsphere.study.document import Analysis
from uqsphere.uq import Joint, Law, Sample, random_generator, sobol_points
from uqsphere.uq.chaos.basis import Germs, germs_of
from uqsphere.uq.estimate import REPLICATES
from uqsphere.uq.fitting import is_fitted
from uqsphere.uq.indices import Blocks

from .failure_modes import AssumedMode, failure_modes_of, judged_by_tests, means_fracture

#: numbers of the sphere that the force in a test depends on
SPHERE = ("sphere.E", "sphere.nu", "sphere.density")


@bundle
class Design:
    """A study with the limits of all its failure modes, and the columns that they need.

    study : the study, as the user gave it
    modes : failure modes that the file has no limit for, judged with strengths of the library
    not_judged : other failure modes, and why they are not judged
    evidence : what the crushing tests of the study say of the library's strengths
    """

    study: Study
    modes: Sequence[AssumedMode]
    not_judged: dict[str, str]
    evidence: list[EvidenceEntry]

    @classmethod
    def of(cls, study: Study) -> Design:
        """The design of a study, with its failure modes that a model of the sphere can answer."""
        assumed, not_judged = failure_modes_of(study)
        wide = with_modes(study, assumed)
        answered = []
        for mode in assumed:
            reason = absent_quantity(wide, mode.limit.quantity)
            if reason:
                not_judged[mode.called] = reason
            else:
                answered.append(mode)
        evidence, modes = judged_by_tests(study, answered)
        for entry in evidence:
            if entry.refuted:
                not_judged[entry.mode] = (
                    f"refuted by your {entry.tests} tests: spheres bore more than this strength "
                    "allows"
                )
        return cls(study=study, modes=modes, not_judged=not_judged, evidence=evidence)

    @cached_property
    def judged(self) -> Study:
        """The study that the model evaluates: behind its own limits stand those of `modes`."""
        return with_modes(self.study, self.modes)

    @cached_property
    def columns(self) -> Names:
        """The quantities that are evaluated at every point."""
        return _quantities(self.judged)

    @property
    def analysis(self) -> Analysis:
        """What the study asks of its answers."""
        return self.study.analysis

    @property
    def limits(self) -> tuple[Limit, ...]:
        """The limits of the study file."""
        return self.study.limits

    def limit(self, name: str) -> Limit:
        """A limit of the study or of a failure mode by its name."""
        return next(limit for limit in self.judged.limits if limit.name == name)

    @cached_property
    def joint(self) -> Joint:
        """All random variables with their dependence: inputs, model factors and strengths."""
        return self.judged.inputs()

    @cached_property
    def inputs(self) -> Names:
        """The random inputs of the model."""
        return tuple(self.study.random)

    @cached_property
    def joint_inputs(self) -> Joint:
        """The random inputs of the model with their dependence."""
        return self.joint.only(self.inputs)

    @cached_property
    def germs(self) -> Germs:
        """The germs of the inputs in which expansions are written."""
        return germs_of(self.joint_inputs.laws)

    @property
    def blocks(self) -> Blocks:
        """The blocks of the design of Sobol' indices."""
        return Blocks(inputs_count=len(self.inputs), second=self.analysis.second_order)

    @cached_property
    def drawn(self) -> Joint:
        """The variables that points are drawn of: the model's inputs and model factors.  Strengths
        are integrated.
        """
        return self.joint.only([name for name in self.joint.names if not is_strength(name)])

    @property
    def variables(self) -> Names:
        """Their names."""
        return self.drawn.names

    @cached_property
    def described(self) -> Names:
        """The quantities whose distributions and indices are answered: those asked for, and those
        of limits.
        """
        return _quantities(self.study)

    @cached_property
    def explained(self) -> Names:
        """Those with indices: not what is held against a force of tests, where E and nu cancel."""
        held = {limit.quantity for limit in self.limits if limit.by_force}
        held -= {*self.analysis.quantities}
        return tuple(name for name in self.described if name not in held)

    @cached_property
    def fracture(self) -> tuple[Limit, ...]:
        """The limits of the file that mean fracture of the sphere."""
        return tuple(filter(means_fracture, self.limits))

    @cached_property
    def planned(self) -> float:
        """The planned value of the free number: the mean that the study gives it; nan without."""
        margins = self.study.margins
        if not margins:
            return math.nan
        if margins.limit:
            return mean_of(self.limit(margins.limit).strength)
        return self.study.at_means()[margins.solve]

    @property
    def free_quantity(self) -> str:
        """What gives the free number its unit: itself, or the demand on the strength it is."""
        margins = self.study.margins
        assert margins is not None
        if not margins.limit:
            return margins.solve
        return self.limit(margins.limit).quantity

    def generator(self, task: str) -> np.random.Generator:
        """Random numbers of a task, by the seed of the study."""
        return random_generator(self.study.seed, task)

    def points(self, count: int, start: int = 0) -> Sample:
        """`count` points of every replicate, from the `start`-th of its sequence on."""
        return at_normals(self.drawn, self.normals(count, start))

    def at_value(self, normals: Array, value: float) -> Sample:
        """The points at independent standard normals (R, n, D) where the free number has a value;
        one that is fixed in the study stands behind the variables.
        """
        points = at_normals(self.study.moved(value).inputs().only(self.variables), normals)
        free = self.study.moving
        if free is None or free.solve in self.inputs:
            return points
        column = np.full(normals.shape[:2], value)
        return replace(
            points,
            names=(*points.names, free.solve),
            inputs=np.dstack([points.inputs, column]),
        )

    @cached_property
    def _kept(self) -> dict[str, Array]:
        """The normals of as many first points as were asked for."""
        return {"first": self._normals(0)}

    def normals(self, count: int, start: int = 0) -> Array:
        """The points as independent standard normals (R, count, D).

        Those from the first on are kept: all values of a line and all expansions ask for the same,
        and a larger sample for more of them.
        """
        first = self._kept["first"]
        more = start + count - first.shape[1]
        if more > 0 and start > 0:
            return self._normals(count, start)
        if more > 0:
            first = np.concatenate([first, self._normals(more, first.shape[1])], axis=1)
            self._kept["first"] = first
        return first[:, start : start + count]

    def _normals(self, count: int, start: int = 0) -> Array:
        uniforms = [
            sobol_points(
                dimension=len(self.variables),
                count=count,
                start=start,
                seed=self.study.seed,
                task="sample",
                replicate=replicate,
            )
            for replicate in range(REPLICATES)
        ]
        return special.ndtri(np.stack(uniforms))


def with_modes(study: Study, modes: Iterable[AssumedMode]) -> Study:
    """A study with the limits of failure modes behind its own."""
    return replace(study, limits=(*study.limits, *(mode.limit for mode in modes)))


def _quantities(study: Study) -> Names:
    """The quantities that a study asks for, and those of its limits."""
    names = [*study.analysis.quantities, *(limit.quantity for limit in study.limits)]
    return tuple(dict.fromkeys(names))


def at_normals(joint: Joint, normals: Array) -> Sample:
    """The points of a joint distribution at independent standard normals (R, n, D)."""
    return Sample.at(joint.names, normals, joint.physical(normals))


def is_strength(name: str) -> bool:
    """Whether a random variable is the strength of a limit."""
    return limit_of(name) is not None and name.endswith(".strength")


# --- demands --------------------------------------------------------------------------------------


def number_of_tests(strength: Law | float) -> int | None:
    """Number of tests behind a strength, None for one that was not fitted to tests."""
    if is_fitted(strength):
        return strength.tests
    return None


def demands_of(limit: Limit, sample: Sample) -> Array:
    """Demands (R, n) of a limit, with its model factor; those against forces of tests have it
    already.
    """
    demands = sample.answer(limit.column)
    if limit.by_force:
        return demands
    return demands * _factor(limit, sample)


def _factor(limit: Limit, sample: Sample) -> Array | float:
    name = f"limits.{limit.name}.model_factor"
    if name in sample.names:
        return sample.input(name)
    return mean_of(limit.model_factor)


def with_test_forces(design: Design, sample: Sample, limits: Sequence[Limit] = ()) -> Sample:
    """An evaluated sample with a column of equivalent test forces for every limit, or some, that
    need them.
    """
    shape = sample.scores.shape[:2]
    varying = {name: sample.input(name) for name in sample.names}
    values: dict[str, Array | float] = {**design.study.at_means(), **varying}
    for limit in limits or design.judged.limits:
        tested = limit.tested
        if not tested or not limit.by_force:
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
        if tested.law:
            sphere = {**tested.sphere, **sphere}
            worth = force_at(worth, limit.demand, sphere, radius, tested.platens)
        # one law of size serves rows, curves and the free number; of draws the value itself is the
        # force, in the size that they hold for
        force = np.full(shape, np.nan)
        force[finite] = worth * (tested.diameter / (2.0 * radius)) ** tested.exponent
        sample = replace(
            sample,
            quantities=(*sample.quantities, limit.column),
            answers=np.dstack([sample.answers, force]),
            censored=np.dstack([sample.censored, sample.late(limit.quantity)]),
        )
    return sample
