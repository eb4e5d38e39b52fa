"""The end of a dear model's design: everything that it answers, by surrogates and by the runs themselves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from uqsphere.runner.campaign import Cost, Missed, indices_missed
from uqsphere.runner.dear_answers import Answers, answers_of, dear_sets, demands_of, limits_of_runs, widest
from uqsphere.runner.dear_course import Course
from uqsphere.runner.dear_fits import fit_design, simpler_fits
from uqsphere.runner.dear_margins import dear_margins
from uqsphere.runner.dear_tails import dear_tails
from uqsphere.runner.evaluate import OutOfBudget, Work
from uqsphere.runner.limits import LimitAnswer, limits_missed
from uqsphere.runner.price import Priced, enlarge
from uqsphere.runner.questions.distributions import METHOD, Sampled, find_missed
from uqsphere.runner.questions.indices import CHAOS, Sensitivity, dependent_names
from uqsphere.runner.questions.margins import MarginAnswer
from uqsphere.runner.questions.probabilities import Learned, learn_limits, with_surrogate_design
from uqsphere.runner.schedule import REPLICATES
from uqsphere.uq import augmented
from uqsphere.uq.augmented import Trusted
from uqsphere.uq.describe import describe
from uqsphere.uq.estimate import Estimate, absent
from uqsphere.uq.indices import WORTHLESS
from uqsphere.uq.sample import Sample

__all__ = ["Dear", "End", "blocks_of_runs", "conclude", "refusal", "to_be_sampled"]


@dataclass(frozen=True, kw_only=True)
class Dear:
    """What the surrogate way found; without `sampled` where the model has to be sampled instead, and `why`.

    `believed` are the quantities that a surrogate speaks for, `tails` what they inherit of laws without moments.  Where
    the model is sampled, `found` is what surrogates said of quantities and limits, and `trusted` has those surrogates.
    """

    why: str
    surrogate: bool
    sampled: Sampled | None = None
    found: Answers = field(default_factory=Answers)
    sensitivity: dict[str, Sensitivity] = field(default_factory=dict)
    margins: dict[str, MarginAnswer] = field(default_factory=dict)
    stopped: str = "accuracy"
    believed: tuple[str, ...] = ()
    tails: dict[str, HeavyTail | None] = field(default_factory=dict)
    trusted: Mapping[str, Trusted] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class End:
    """Where the design ended, and why: its surrogates, what they answer, the quantities too rough for one."""

    work: Work
    priced: Priced
    design: Sample
    trusted: Mapping[str, Trusted]
    fits: dict[int, Chaos]
    found: Answers
    rough: tuple[str, ...]
    course: Course
    stopped: str


def _with_all_runs(end: End, design: Sample) -> End:
    """The end with surrogates of a larger design, where all that were believed still are."""
    trusted, fits = fit_design(end.work, design, end.fits)
    usable = {quantity: one for quantity, one in trusted.items() if one.usable}
    if not usable.keys() >= end.found.descriptions.keys():
        return end
    found = answers_of(end.work, design.count, usable)
    end.course.add(end.work, design.count, found)
    rough = tuple(quantity for quantity in end.rough if quantity not in usable)
    return replace(end, design=design, trusted=trusted, fits=fits, found=found, rough=rough)


def refusal(end: End) -> str:
    """Why surrogates are not used, or an empty text."""
    if not end.rough:
        return ""
    if not end.trusted:
        return "no surrogate was fitted, since runs are too few or some have no answer"
    told = [f"{quantity}: {end.trusted[quantity].reason}" for quantity in end.rough]
    which = "the surrogate is" if len(told) == 1 else "surrogates are"
    return f"{which} too rough ({'; '.join(told)})"


def blocks_of_runs(design: Sample) -> Sample:
    """The runs in consecutive blocks, which serve as replicates: each is spread as evenly as a design of its size.

    Blocks of one sequence fill each other's gaps, so that intervals from their spread are too wide rather than narrow.
    """
    # of two runs each a standard deviation has no interval to speak of
    each = max(4 if design.count >= 16 else 2, design.count // REPLICATES)
    blocks = design.count // each
    kept = blocks * each
    return design.head(kept).blocks(blocks)


def _believable(estimate: Estimate) -> Estimate:
    if estimate.value is None or estimate.half_width <= WORTHLESS:
        return estimate
    return absent("the interval spans the whole range", estimate.method, estimate.evaluations)


def to_be_sampled(end: End, why: str) -> Dear:
    """That the model is sampled, with what surrogates say of the quantities that have one."""
    tails = dear_tails(end.work, end.design, end.trusted)
    plain = tuple(quantity for quantity in end.found.descriptions if tails[quantity] is None)
    return Dear(
        why=why,
        surrogate=False,
        found=end.found,
        sensitivity={quantity: _sensitivity(end, quantity) for quantity in plain},
        believed=plain,
        tails=tails,
        trusted={quantity: end.trusted[quantity] for quantity in plain},
    )


def conclude(end: End) -> Dear:
    """Everything the run answers: by surrogates, and what is too rough for one by the runs themselves.

    Indices of the latter are those of a simpler surrogate, where one may be used: all else the runs know better.
    """
    work, course, design, stopped = end.work, end.course, end.design, end.stopped
    affordable = end.priced.way.affordable
    sample = blocks_of_runs(design)
    alone = _from_runs(end, sample)
    limits, learned = end.found.limits | alone.limits, Learned(limits={})
    if stopped != "time":
        learned = learn_limits(work, limits)
        limits = with_surrogate_design(work, learned.limits, demands_of(work, end.trusted), affordable)
    margins = dear_margins(work, end.trusted, affordable)
    if end.rough and stopped != "time":
        # runs that no surrogate can use still sharpen what sampling says: as far as the budget goes
        most = design.count + affordable - work.ledger.total
        before = end.found.limits | alone.limits
        try:
            design = enlarge(work, design, max(design.count, REPLICATES * (most // REPLICATES)))
            stopped = "evaluations"
        except OutOfBudget:
            stopped = "time"
        if end.found.excess and design.count > end.design.count:
            end = _with_all_runs(end, design)
        sample = blocks_of_runs(design)
        alone = _from_runs(end, sample)
        after = end.found.limits | alone.limits
        limits |= {n: _sharpened(limits[n], before[n], one) for n, one in after.items() if one is not before[n]}
    course.end(work, design.count, alone)
    answers = end.found.descriptions | alone.descriptions
    descriptions = {quantity: answers[quantity] for quantity in work.quantities}
    limits = {limit.name: limits[limit.name] for limit in work.study.limits}
    lacking = [*find_missed(work, descriptions, {}), *limits_missed(work, limits)]
    simpler = simpler_fits(work, design, end.rough)
    missed = [_refused(quantity, end.trusted.get(quantity), simpler.get(quantity)) for quantity in end.rough]
    indices = end.found.indices | answers_of(work, design.count, simpler).indices
    told = replace(end, trusted={**end.trusted, **simpler}, found=replace(end.found, indices=indices))
    why = end.priced.way.why
    if end.rough:
        why = f"{refusal(end)}: the {design.count} runs are sampled"
    if end.rough and end.found.descriptions:
        why += f"; surrogates answer {', '.join(end.found.descriptions)}"
    sampled = Sampled(
        sample=sample,
        descriptions=descriptions,
        limits=limits,
        missed=missed + course.priced(lacking, end.priced, learned.calls),
        stopped=stopped,
    )
    return Dear(
        why=why,
        surrogate=bool(end.found.descriptions),
        sampled=sampled,
        sensitivity={quantity: _sensitivity(told, quantity) for quantity in work.quantities},
        margins=margins,
        stopped=stopped,
        believed=tuple(end.found.descriptions),
        tails=dear_tails(work, design, end.trusted),
    )


def _sharpened(answer: LimitAnswer, before: LimitAnswer, more: LimitAnswer) -> LimitAnswer:
    """A limit by more runs, with the checks and the probability that active learning gave it beside those `before`."""
    if answer.miss is not before.miss:
        return replace(answer, margin=more.margin)
    if answer.design is not None:
        return replace(answer.with_probabilities(more.exceedance, more.miss), margin=more.margin)
    return replace(more, checks=answer.checks, design_reason=answer.design_reason)


def _from_runs(end: End, sample: Sample) -> Answers:
    """Answers of the runs alone, for quantities without a surrogate."""
    work, analysis = end.work, end.work.study.analysis
    descriptions = {
        name: describe(
            sample.answer(name),
            failed=sample.failed,
            on_failure=analysis.on_failure,
            quantiles=analysis.quantiles,
            method=METHOD,
        )
        for name in work.quantities
        if name in end.rough
    }
    return Answers(descriptions=descriptions, limits=limits_of_runs(work, sample, end.rough))


def _refused(quantity: str, one: Trusted | None, simpler: Trusted | None) -> Missed:
    reason = "no surrogate was fitted" if one is None else one.reason
    rest = "there are no indices"
    if simpler is not None:
        rest = f"the indices those of a simpler surrogate: {simpler.reason}"
    said = f"{quantity}: {reason}; the answers are those of the runs alone, and {rest}"
    return Missed(subject=quantity, kind="surrogate", said=said)


def _sensitivity(end: End, quantity: str) -> Sensitivity:
    work, one, found = end.work, end.trusted.get(quantity), end.found.indices.get(quantity)
    names, analysis, sampling = work.scene_names, work.study.analysis, end.priced.way.sampling
    about: dict[str, Any] = {"kind": None, "error": None, "evaluations": 0}
    if one is not None:
        about = {
            "kind": CHAOS,
            "error": min(one.error, 1.0),
            "evaluations": len(one.residuals),
            "usable": one.usable,
            "reason": one.reason,
            "degree": one.chaos.degree,
            "terms": int(one.chaos.coefficients.size),
        }
    tied = dependent_names(work)
    reason = (
        f"{', '.join(tied)} depend on each other: Shapley effects take their place, and are sampled"
        if tied
        else "no surrogate may be used, and sampled indices are beyond the budget"
    )
    nothing = absent(reason, augmented.METHOD, work.ledger.total)
    sets = dear_sets(work, None if found is None else one, reason)
    if found is None:
        rows = dict.fromkeys(names, nothing)
        cost = Cost(f" ({sampling:,} evaluations)", sampling)
        missed = [indices_missed(quantity, None, analysis.accuracy.sobol, f": {reason}", cost)]
        return Sensitivity(first=rows, total=dict(rows), surrogate=about, sampled={}, expanded={}, agree=None,
                           text=f"No index is given: {reason}.", missed=missed, **sets)  # fmt: skip
    width = widest(found)
    missed = []
    if width is not None and width > analysis.accuracy.sobol:
        cost = end.course.cost(quantity, "indices", None, end.priced)
        missed = [indices_missed(quantity, width, analysis.accuracy.sobol, cost=cost)]
    text = "Indices are those of the surrogate; their intervals hold what it leaves of the variance."
    given = {order: [_believable(e) for e in row] for order, row in found.items()}
    return Sensitivity(
        first=dict(zip(names, given["first"], strict=True)),
        total=dict(zip(names, given["total"], strict=True)),
        surrogate=about,
        sampled={},
        expanded=dict(given),
        agree=None,
        text=text,
        missed=missed,
        estimators="Off the coefficients of the surrogate, or by sampling it where its output was transformed.",
        **sets,
    )


if TYPE_CHECKING:
    from uqsphere.uq.expansion import Chaos
    from uqsphere.uq.heavy_tails import HeavyTail
