"""What an answer rests on beside its scatter: the tests behind a strength, assumed strengths, and
the contact law.

Each is one more failure probability, with something taken otherwise: epistemic uncertainty, told in
rows of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.models.scene import rows_under_plastic_contact
from uqsphere.propagation.demands import strength_of, with_test_forces
from uqsphere.propagation.design import Design
from uqsphere.propagation.fragility import curve_of
from uqsphere.propagation.free_number import demand_factor
from uqsphere.propagation.limits import failure_given_inputs, state_of
from uqsphere.propagation.tables import Tables
from uqsphere.quantities import lookup
from uqsphere.results import Answers
from uqsphere.study import Limit, strength_name
from uqsphere.uq import Law, LawError, LimitState, Sample, make_law, random_generator
from uqsphere.uq.fitting import count_tests, is_fitted, possible_laws
from uqsphere.uq.union import make_union, residual_correlation

#: strengths that the tests allow, for the range of a probability, and of a margin
LAWS, MARGIN_LAWS = 200, 40
#: what a strength may be instead, with the same mean and standard deviation: the other usual
#: distribution
OTHER_DISTRIBUTIONS: Final = ("lognormal strength", "Weibull strength")
#: points of a replicate that these rest on at most
MOST: Final = 512


@dataclass(frozen=True, kw_only=True)
class Assumptions:
    """Rows of answers, and what a verdict asks of them.

    answers : rows of failure probabilities and margins, each with something taken otherwise
    tests : by limit, the 95 % range of the failure probability over the strengths that its tests
        allow
    plastic : the first rows under a contact that yields; None where none would, or the study has
        such a contact
    """

    answers: Answers
    tests: dict[str, tuple[float, float]]
    plastic: Sample | None


def assumptions(design: Design, tables: Tables) -> Assumptions:
    """All that is taken for granted by the limits, taken otherwise."""
    answers, ranges = Answers(), dict[str, tuple[float, float]]()
    head = tables.sample.head(min(tables.sample.count, MOST))

    def otherwise(limit: Limit, name: str, state: LimitState, note: str) -> float:
        p = _mean(limit, state)
        answers.row(
            design.subject(limit),
            "failure_probability",
            f"assumed: {name}",
            p,
            unit="1",
            runs=state.demands.size,
            method="epistemic",
            note=note,
        )
        return p

    for limit in design.judged.limits:
        law, laws = strength_of(limit), _possible_strengths(design, limit, LAWS)
        if not isinstance(law, Law) or laws is None:
            continue
        few = head.head(min(head.count, 64))
        found = np.array([_mean(limit, state_of(design, limit, few, one)) for one in laws])
        low, high = (float(x) for x in np.quantile(found, [0.025, 0.975]))
        ranges[limit.name] = low, high
        note = f"95 % range over the strengths that {count_tests(law)} tests allow"
        answers.row(
            design.subject(limit),
            "failure_probability",
            "tests",
            float(found.mean()),
            low,
            high,
            unit="1",
            runs=few.size,
            method="epistemic",
            note=note,
        )
        _margin_by_tests(design, tables, limit, answers)
    for mode in design.modes:
        for end, law in (("weak", mode.weak), ("strong", mode.strong)):
            state = state_of(design, mode.limit, head, law)
            otherwise(mode.limit, f"{end} end of the library's range", state, mode.source)
    for limit in design.limits:
        for name, other in _other_distributions(limit).items():
            otherwise(
                limit,
                name,
                state_of(design, limit, head, other),
                "same mean and standard deviation",
            )
        state = state_of(design, limit, head)
        if state.tie is not None:
            alone = replace(state, tie=None)
            otherwise(limit, "strength independent of the inputs", alone, "without dependence")
    plastic = _under_plastic_contact(design, head)
    for limit in design.fracture:
        if plastic is None:
            break
        p = otherwise(
            limit, "contacts yield", state_of(design, limit, plastic), '[contact] law = "plastic"'
        )
        own = _mean(limit, state_of(design, limit, head))
        if limit.has_target and (p < limit.target) is not (own < limit.target):
            _margin_under_plastic_contact(design, tables, limit, answers)
    return Assumptions(answers=answers, tests=ranges, plastic=plastic)


def _mean(limit: Limit, state: LimitState) -> float:
    return float(failure_given_inputs(state, limit.aim).mean())


def _possible_strengths(design: Design, limit: Limit, count: int) -> Iterator[Law] | None:
    """Strengths that the tests behind a limit allow, one by one, all equally likely; None where no
    tests tell.
    """
    law = strength_of(limit)
    if not isinstance(law, Law) or not is_fitted(law):
        return None
    generator = random_generator(
        seed=design.study.seed, task=f"tests of {strength_name(limit.name)}"
    )
    with suppress(LawError):
        return possible_laws(law, count, generator)
    return None


def _margin_by_tests(design: Design, tables: Tables, limit: Limit, answers: Answers) -> None:
    """The free number at the target, with the range that the tests leave it and its conservative
    end.
    """
    margins = design.study.margins
    laws = _possible_strengths(design, limit, MARGIN_LAWS)
    if margins is None or laws is None:
        return
    wanted = limit.allowable
    values = [curve_of(design, tables, limit, law, (wanted,)).values[wanted].value for law in laws]
    known = np.array([value for value in values if value is not None])
    # where a law has none in the range, it lies beyond an end of it, which is no number to promise
    if len(known) < 0.95 * len(values):
        note = (
            f"{len(values) - len(known)} of {len(values)} strengths that the tests allow leave "
            "none in the range"
        )
        answers.row(
            design.subject(limit),
            "margin",
            "tests",
            None,
            unit=lookup(margins.solve).unit,
            method="epistemic",
            note=note,
        )
        return
    low, high = (float(x) for x in np.quantile(known, [0.025, 0.975]))
    note = f"95 % range over the strengths that the tests allow, at the target {limit.target:g}"
    answers.row(
        design.subject(limit),
        "margin",
        "tests",
        float(np.median(known)),
        low,
        high,
        unit=lookup(margins.solve).unit,
        method="epistemic",
        note=note,
    )


def _other_distributions(limit: Limit) -> dict[str, Law]:
    """The strength by the other usual distribution, with the same mean and standard deviation."""
    from scipy.optimize import brentq
    from scipy.special import gammaln

    law = strength_of(limit)
    if not isinstance(law, Law) or law.family.name not in ("weibull", "lognormal", "normal"):
        return {}
    mean, sd = law.mean(), law.sd()
    if mean is None or sd is None or not mean > 0.0 or not sd > 0.0:
        return {}
    with suppress(ValueError):  # a scatter that no law has
        if law.family.name == "weibull":
            return {"lognormal strength": make_law("lognormal", {"mean": mean, "cov": sd / mean})}
        # 1 + cov² = Gamma(1 + 2/m)/Gamma(1 + 1/m)²
        excess = math.log1p((sd / mean) ** 2)
        modulus = brentq(
            lambda m: gammaln(1.0 + 2.0 / m) - 2.0 * gammaln(1.0 + 1.0 / m) - excess, 0.1, 1e4
        )
        return {"Weibull strength": make_law("weibull", {"mean": mean, "modulus": modulus})}
    return {}


def _under_plastic_contact(
    design: Design, sample: Sample, further: Mapping[str, float] | None = None
) -> Sample | None:
    """Points under a contact that yields, None where the study has one, or no face would yield.

    further : numbers that all points share in place of the study's
    """
    if design.study.black_box or not design.fracture:
        return None
    fixed = {name: value for name, value in (further or {}).items() if name not in design.inputs}
    rows = np.column_stack(
        [
            sample.inputs[:, :, : len(design.inputs)].reshape(sample.size, -1),
            *(np.full(sample.size, value) for value in fixed.values()),
        ]
    )
    found = rows_under_plastic_contact(
        design.judged, (*design.inputs, *fixed), rows, design.columns
    )
    if found is None:
        return None
    shape, values = sample.scores.shape[:2], np.where(found.good[:, None], found.values, np.nan)
    answered = sample.with_answers(
        design.columns, values.reshape(*shape, -1), failed=~found.good.reshape(shape)
    )
    return with_test_forces(
        design, answered, {name: np.full(shape, x) for name, x in (further or {}).items()}
    )


def _margin_under_plastic_contact(
    design: Design, tables: Tables, limit: Limit, answers: Answers
) -> None:
    """The free number at the target where contacts yield, which turns the verdict."""
    margins, line = design.study.margins, dict[float, Sample]()
    if margins is None or not tables.line:
        return
    path = margins.solve
    for value, sample in tables.line.items():
        moved = _under_plastic_contact(design, sample, {path: value})
        if moved is None or moved.failed.any():
            return
        line[value] = moved
    wanted = limit.allowable
    margin = curve_of(design, replace(tables, line=line), limit, None, (wanted,)).values[wanted]
    answers.add(
        design.subject(limit),
        "margin",
        "assumed: contacts yield",
        margin,
        unit=lookup(path).unit,
        runs=sum(sample.size for sample in line.values()),
    )


# --- several limits together ----------------------------------------------------------------------


def together(design: Design, sample: Sample, limits: Sequence[Limit]) -> Array:
    """Probability (R, n) that any of some limits is exceeded, given the inputs."""
    generator = random_generator(seed=design.study.seed, task="limits together")
    states = [state_of(design, limit, sample) for limit in limits]
    return make_union(states, _common_factor(design, limits), generator).any


def _common_factor(design: Design, limits: Sequence[Limit]) -> Array:
    """Cholesky factor of the correlation that strengths have with each other, given all that is
    drawn.
    """
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
    """What `fragility.curve_by` asks: the probability that any of some limits is exceeded at a
    value.
    """
    margins = design.study.margins

    def probability(sample: Sample, value: float) -> Array:
        moved = [
            replace(limit, model_factor=limit.model_factor * demand_factor(margins, limit, value))
            if margins and margins.limit == limit.name and not isinstance(limit.model_factor, Law)
            else limit
            for limit in limits
        ]
        return together(design, sample, moved)

    return probability
