"""What a run evaluates: the random variables, the columns of every failure mode, and the points of
each table.

Points are scrambled Sobol' sequences, `REPLICATES` of them, each an independent randomisation of
the same design: intervals of sampled answers follow from what the replicates differ by.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from uqsphere.arrays import Array, frozen, special
from uqsphere.models.scene import absent_quantity
from uqsphere.results.types import EvidenceEntry
from uqsphere.study import Limit, Study, limit_of
from uqsphere.uq import Joint, Law, Sample, random_generator, sobol_points
from uqsphere.uq.chaos import GermLike, germs_of
from uqsphere.uq.estimate import REPLICATES
from uqsphere.uq.indices import Blocks

from .failure_modes import AssumedMode, failure_modes_of, judged_by_tests, means_fracture

#: values of the free number
VALUES = 25


@frozen(eq=False)
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
    def columns(self) -> tuple[str, ...]:
        """The quantities that are evaluated at every point."""
        return _quantities(self.study, self.judged.limits)

    @property
    def limits(self) -> tuple[Limit, ...]:
        """The limits of the study file."""
        return self.study.limits

    @cached_property
    def joint(self) -> Joint:
        """All random variables with their dependence: inputs, model factors and strengths."""
        return self.judged.inputs()

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        """The random inputs of the model."""
        return tuple(self.study.random)

    @cached_property
    def joint_inputs(self) -> Joint:
        """The random inputs of the model with their dependence."""
        return self.joint.only(self.inputs)

    @cached_property
    def germs(self) -> tuple[GermLike, ...]:
        """The germs of the inputs in which expansions are written."""
        return germs_of(self.joint_inputs.laws)

    @property
    def blocks(self) -> Blocks:
        """The blocks of the design of Sobol' indices."""
        return Blocks(inputs_count=len(self.inputs), second=self.study.analysis.second_order)

    @cached_property
    def drawn(self) -> Joint:
        """The variables that points are drawn of: the model's inputs and model factors.  Strengths
        are integrated.
        """
        return self.joint.only([name for name in self.joint.names if not is_strength(name)])

    @cached_property
    def described(self) -> tuple[str, ...]:
        """The quantities whose distributions and indices are answered: those asked for, and those
        of limits.
        """
        return _quantities(self.study, self.limits)

    @cached_property
    def explained(self) -> tuple[str, ...]:
        """Those with indices: not what is held against a force of tests, where E and nu cancel."""
        held = {limit.quantity for limit in self.limits if by_force(limit)}
        held -= {*self.study.analysis.quantities}
        return tuple(name for name in self.described if name not in held)

    @cached_property
    def fracture(self) -> tuple[Limit, ...]:
        """The limits of the file that mean fracture of the sphere."""
        return tuple(filter(means_fracture, self.limits))

    @cached_property
    def planned(self) -> float | None:
        """The planned value of the free number: the mean that the study gives it."""
        margins = self.study.margins
        if margins is None:
            return None
        if margins.limit is not None:
            limit = next(limit for limit in self.limits if limit.name == margins.limit)
            return number(limit.strength)
        return self.study.at_means().get(margins.solve)

    @property
    def on_failure(self) -> str:
        """What becomes of failed rows, as the estimates take it."""
        if self.study.analysis.policy == "bound":
            return "bound"
        return "drop"

    def generator(self, task: str) -> np.random.Generator:
        """Random numbers of a task, by the seed of the study."""
        return random_generator(seed=self.study.seed, task=task)

    def subject(self, limit: Limit) -> str:
        """The name of a limit in the table of answers."""
        assumed = {mode.limit.name: f"modes.{mode.called}" for mode in self.modes}
        return assumed.get(limit.name, f"limits.{limit.name}")

    def points(self, count: int, start: int = 0, joint: Joint | None = None) -> Sample:
        """`count` points of every replicate, from the `start`-th of its sequence on; `joint`
        replaces the variables.
        """
        drawn = self.drawn if joint is None else joint
        if not drawn.names:
            nothing = np.zeros((REPLICATES, count, 0))
            return Sample.at((), nothing, nothing)
        return at_normals(drawn, self.normals(count, start))

    def many_normals(self, count: int) -> Array:
        """The same for as many points as an expansion is evaluated at; those of one count are
        kept."""
        if count not in self._many:
            self._many.clear()
            self._many[count] = self.normals(count)
        return self._many[count]

    @cached_property
    def _many(self) -> dict[int, Array]:
        return {}

    def normals(self, count: int, start: int = 0) -> Array:
        """The points as independent standard normals (R, count, D)."""
        uniforms = [
            sobol_points(
                dimension=len(self.drawn.names),
                count=count,
                start=start,
                seed=self.study.seed,
                task="sample",
                replicate=replicate,
            )
            for replicate in range(REPLICATES)
        ]
        return normal_scores(np.stack(uniforms))


def with_modes(study: Study, modes: Iterable[AssumedMode]) -> Study:
    """A study with the limits of failure modes behind its own."""
    return replace(study, limits=(*study.limits, *(mode.limit for mode in modes)))


def _quantities(study: Study, limits: Iterable[Limit]) -> tuple[str, ...]:
    """The quantities that a study asks for, and those of limits."""
    names = [*study.analysis.quantities, *(limit.quantity for limit in limits)]
    return tuple(dict.fromkeys(names))


def normal_scores(uniforms: Array) -> Array:
    """Standard normal scores of uniforms of any shape."""
    return special.ndtri(uniforms)


def at_normals(joint: Joint, normals: Array) -> Sample:
    """The points of a joint distribution at independent standard normals (R, n, D)."""
    return Sample.at(joint.names, normals, joint.physical(normals))


def number(value: Law | float) -> float:
    """A number, or the mean of its distribution."""
    return value.nominal_mean() if isinstance(value, Law) else float(value)


def by_force(limit: Limit) -> bool:
    """Whether a limit is held against the force of crushing tests, or against draws with a law of
    size.
    """
    tested = limit.tested
    return tested is not None and (tested.law is not None or tested.exponent != 0.0)


def is_strength(name: str) -> bool:
    """Whether a random variable is the strength of a limit."""
    return limit_of(name) is not None and name.endswith(".strength")
