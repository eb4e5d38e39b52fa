"""What an answer rests on beside its scatter: the tests behind a strength, assumed strengths, and the contact law.

Each is one more failure probability, with something taken otherwise: epistemic uncertainty, told in rows of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.models.scene import rows_under_plastic_contact
from uqsphere.quantities import lookup
from uqsphere.results import Answers
from uqsphere.run.demands import strength_of, with_test_forces
from uqsphere.run.design import Design
from uqsphere.run.fragility import allowable_probability, curve_of, target_of
from uqsphere.run.limits import failure_given_inputs, state_of
from uqsphere.run.tables import Tables
from uqsphere.study import Limit, means_fracture, strength_name
from uqsphere.uq import Law, LawError, Sample, random_generator
from uqsphere.uq.fitting import count_tests, is_fitted, possible_laws
from uqsphere.uq.union import make_union, residual_correlation

#: strengths that the tests allow, for the range of a probability, and of a margin
LAWS, MARGIN_LAWS = 200, 40
#: points of a replicate that these rest on at most
MOST: Final = 512


@dataclass(frozen=True, kw_only=True)
class Assumptions:
    """Rows of answers, and what a verdict asks of them.

    answers : rows of failure probabilities and margins, each with something taken otherwise
    tests : by limit, the 95 % range of the failure probability over the strengths that its tests allow
    plastic : the first rows under a contact that yields; None where none would, or the study has such a contact
    """

    answers: Answers
    tests: dict[str, tuple[float, float]]
    plastic: Sample | None


def assumptions(design: Design, tables: Tables) -> Assumptions:
    """All that is taken for granted by the limits, taken otherwise."""
    answers, ranges = Answers(), dict[str, tuple[float, float]]()
    head = tables.sample.head(min(tables.sample.count, MOST))
    for limit in design.study.limits:
        subject = design.subject(limit)
        law = strength_of(limit)
        if isinstance(law, Law) and is_fitted(law):
            found = _by_tests(design, tables, limit, head)
            if found is not None:
                value, low, high = found
                ranges[limit.name] = low, high
                note = f"95 % range over the strengths that {count_tests(law)} tests allow"
                answers.row(subject, "failure_probability", "tests", value, low, high, unit="1", runs=head.size,
                            method="epistemic", note=note)  # fmt: skip
                _margin_by_tests(design, tables, limit, answers)
    for mode in design.modes:
        subject = design.subject(mode.limit)
        for name, end in (
            ("weak end of the library's range", mode.weak),
            ("strong end of the library's range", mode.strong),
        ):
            p = float(failure_given_inputs(state_of(design, mode.limit, head, end), mode.limit.aim).mean())
            answers.row(subject, "failure_probability", f"assumed: {name}", p, unit="1", runs=head.size,
                        method="epistemic", note=mode.source)  # fmt: skip
    for limit in design.limits:
        for name, other in other_distributions(limit):
            p = float(failure_given_inputs(state_of(design, limit, head, other), limit.aim).mean())
            answers.row(design.subject(limit), "failure_probability", f"assumed: {name}", p, unit="1", runs=head.size,
                        method="epistemic", note="same mean and standard deviation")  # fmt: skip
        state = state_of(design, limit, head)
        if state.shift is not None or state.tie is not None:
            alone = replace(state, shift=None, remaining_sd=1.0, weights=(), tie=None)
            p = float(failure_given_inputs(alone, limit.aim).mean())
            answers.row(design.subject(limit), "failure_probability", "assumed: strength independent of the inputs", p,
                        unit="1", runs=head.size, method="epistemic", note="without dependence")  # fmt: skip
    plastic = _under_plastic_contact(design, head)
    if plastic is not None:
        for limit in design.fracture:
            p = float(failure_given_inputs(state_of(design, limit, plastic), limit.aim).mean())
            answers.row(design.subject(limit), "failure_probability", "assumed: contacts yield", p, unit="1",
                        runs=plastic.size, method="epistemic", note='[contact] law = "plastic"')  # fmt: skip
            if limit.target is not None and (p < limit.target) is not (_own(design, head, limit) < limit.target):
                _margin_under_plastic_contact(design, tables, limit, answers)
    return Assumptions(answers=answers, tests=ranges, plastic=plastic)


def possible_strengths(design: Design, limit: Limit, count: int) -> list[Law] | None:
    """Strengths that the tests behind a limit allow, each as likely as the other; None where the tests do not tell."""
    law = strength_of(limit)
    assert isinstance(law, Law)
    generator = random_generator(seed=design.study.seed, task=f"tests of {strength_name(limit.name)}")
    try:
        return possible_laws(law, count, generator)
    except LawError:
        return None


def _by_tests(design: Design, tables: Tables, limit: Limit, head: Sample) -> tuple[float, float, float] | None:
    laws = possible_strengths(design, limit, LAWS)
    if laws is None:
        return None
    few = head.head(min(head.count, 64))
    found = np.array([float(failure_given_inputs(state_of(design, limit, few, law), limit.aim).mean()) for law in laws])
    low, high = (float(x) for x in np.quantile(found, [0.025, 0.975]))
    return float(found.mean()), low, high


def _margin_by_tests(design: Design, tables: Tables, limit: Limit, answers: Answers) -> None:
    """The free number at the target, with the range that the tests leave it and its conservative end."""
    margins = design.study.margins
    laws = possible_strengths(design, limit, MARGIN_LAWS)
    if margins is None or laws is None:
        return
    wanted = allowable_probability(design, limit)
    values = [curve_of(design, tables, limit, law, (wanted,)).values[wanted].value for law in laws]
    known = np.array([value for value in values if value is not None])
    # where a law has none in the range, it lies beyond an end of it, which is no number to promise
    if len(known) < 0.95 * len(laws):
        note = f"{len(laws) - len(known)} of {len(laws)} strengths that the tests allow leave none in the range"
        answers.row(design.subject(limit), "margin", "tests", None, unit=lookup(margins.axis.path).unit,
                    method="epistemic", note=note)  # fmt: skip
        return
    low, high = (float(x) for x in np.quantile(known, [0.025, 0.975]))
    note = f"95 % range over the strengths that the tests allow, at the target {target_of(design, limit):g}"
    answers.row(design.subject(limit), "margin", "tests", float(np.median(known)), low, high,
                unit=lookup(margins.axis.path).unit, method="epistemic", note=note)  # fmt: skip


def other_distributions(limit: Limit) -> list[tuple[str, Law]]:
    """The strength by the other usual distribution, with the same mean and standard deviation."""
    from uqsphere.uq import make_law

    law = strength_of(limit)
    if not isinstance(law, Law) or law.family.name not in ("weibull", "lognormal", "normal"):
        return []
    mean, sd = law.mean(), law.sd()
    if mean is None or sd is None or not mean > 0.0 or not sd > 0.0:
        return []
    try:
        if law.family.name == "weibull":
            return [("lognormal strength", make_law("lognormal", {"mean": mean, "cov": sd / mean}))]
        return [("Weibull strength", make_law("weibull", {"mean": mean, "cov": sd / mean}))]
    except LawError:
        return []


def _under_plastic_contact(design: Design, head: Sample) -> Sample | None:
    """The first rows under a contact that yields, None where the study has one, or no face would yield."""
    study = design.study
    if study.black_box or not any(means_fracture(limit) for limit in design.limits) or not design.fracture:
        return None
    shape = head.scores.shape[:2]
    rows = np.stack([head.input(name).ravel() for name in design.inputs], axis=1) if design.inputs else np.zeros((1, 0))
    found = rows_under_plastic_contact(study, design.inputs, rows, design.columns)
    if found is None:
        return None
    values = np.where(found.good[:, None], found.values, np.nan)
    cells = np.broadcast_to(values, (shape[0] * shape[1], values.shape[1])) if not design.inputs else values
    flags = np.broadcast_to(~found.good, (shape[0] * shape[1],)) if not design.inputs else ~found.good
    answered = head.with_answers(design.columns, cells.reshape(*shape, -1), failed=flags.reshape(shape))
    return with_test_forces(design, answered, {})


def _own(design: Design, head: Sample, limit: Limit) -> float:
    return float(failure_given_inputs(state_of(design, limit, head), limit.aim).mean())


def _margin_under_plastic_contact(design: Design, tables: Tables, limit: Limit, answers: Answers) -> None:
    """The free number at the target where contacts yield, which turns the verdict."""
    margins = design.study.margins
    if margins is None or not tables.line:
        return
    axis, line = margins.axis, {}
    place = axis.path
    for value, sample in tables.line.items():
        names = (*design.inputs, *(() if place in design.inputs else (place,)))
        columns = [
            sample.input(name).ravel() if name in design.inputs else np.full(sample.size, value) for name in names
        ]
        found = rows_under_plastic_contact(design.study, names, np.stack(columns, axis=1), design.columns)
        if found is None or not found.good.all():
            return
        answered = sample.with_answers(design.columns, found.values.reshape(*sample.scores.shape[:2], -1))
        line[value] = with_test_forces(design, answered, {place: np.full(sample.scores.shape[:2], value)})
    wanted = allowable_probability(design, limit)
    margin = curve_of(design, replace(tables, line=line), limit, None, (wanted,)).values[wanted]
    answers.add(design.subject(limit), "margin", "assumed: contacts yield", margin,
                unit=lookup(axis.path).unit, runs=sum(sample.size for sample in line.values()))  # fmt: skip


# --- several limits together ----------------------------------------------------------------------------------------


def together(
    design: Design, sample: Sample, limits: Sequence[Limit], strengths: Sequence[Law | float | None] = ()
) -> Array:
    """Probability (R, n) that any of some limits is exceeded, given the inputs."""
    states = [
        state_of(design, limit, sample, strength)
        for limit, strength in zip(limits, strengths or [None] * len(limits), strict=True)
    ]
    generator = random_generator(seed=design.study.seed, task="limits together")
    return make_union(states, _common_factor(design, limits), generator).any


def _common_factor(design: Design, limits: Sequence[Limit]) -> Array:
    """Cholesky factor of the correlation that strengths have with each other, given all that is drawn."""
    joint, covariance = design.joint, np.eye(len(limits))
    names = [strength_name(limit.name) for limit in limits]
    random = [k for k, name in enumerate(names) if name in joint.names]
    if joint.correlation is None or len(random) < 2:
        return covariance
    at = [joint.names.index(names[k]) for k in random]
    given = [joint.names.index(name) for name in design.drawn.names]
    own, across = joint.correlation[np.ix_(at, at)], joint.correlation[np.ix_(given, at)]
    within = joint.correlation[np.ix_(given, given)]
    covariance[np.ix_(random, random)] = own - across.T @ np.linalg.solve(within, across)
    return residual_correlation(covariance)


def along_line(design: Design, limits: Sequence[Limit]) -> Callable[[Sample, float], Array]:
    """What `fragility.curve_by` asks: the probability that any of some limits is exceeded at a value."""
    axis = design.study.margins.axis if design.study.margins is not None else None

    def probability(sample: Sample, value: float) -> Array:
        moved = [replace(limit, model_factor=limit.model_factor * axis.demand_factor(limit, value))
                 if axis is not None and axis.limit == limit.name and not isinstance(limit.model_factor, Law) else limit
                 for limit in limits]  # fmt: skip
        return together(design, sample, moved)

    return probability
