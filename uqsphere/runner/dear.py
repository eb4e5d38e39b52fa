"""Models that are dear: one design, enlarged, a surrogate fitted to it, and answers that hold the surrogate's error.

The design is doubled from 32 runs on until every accuracy is reached, the budget ends it, or the forecast says that
more runs will not do.  A surrogate speaks for the model only while runs that no fit had seen, and those left out of
the fits, agree with it.  An output that is too rough for one is sampled: by the usual way where the budget has room
for it, else by the runs that were made.  The other outputs keep what their surrogates say.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from uqsphere.runner.dear_answers import Answers, answers_of
from uqsphere.runner.dear_course import BEFORE, UNEXPLAINED, Course, needed
from uqsphere.runner.dear_end import Dear, End, conclude, refusal, to_be_sampled
from uqsphere.runner.dear_fits import fit_design
from uqsphere.runner.evaluate import OutOfBudget, Work, none_answered
from uqsphere.runner.price import Priced, enlarge
from uqsphere.runner.questions.indices import CHAOS
from uqsphere.runner.questions.probabilities import reserve
from uqsphere.runner.schedule import CAUTION, FIRST_SAMPLE, REPLICATES, SURROGATE
from uqsphere.uq.augmented import MOST, Trusted

__all__ = ["answer_dear"]


def answer_dear(work: Work, priced: Priced) -> Dear:
    """Answer a study through a surrogate; `work` is bounded by what is affordable.

    Raises
    ------
    TooManyFailures
        By the study's failure policy.
    OutOfBudget
        When the time is over, or the run interrupted, before the first surrogates.
    UsageError
        For a budget below the smallest design.
    """
    from uqsphere.errors import UsageError

    most = min(priced.way.affordable, SURROGATE.most)
    if most < SURROGATE.least and priced.design is None:
        raise UsageError(
            f"the budget has room for {priced.way.affordable} evaluations, and the smallest design takes "
            f"{SURROGATE.least}: raise analysis.budget"
        )
    design = priced.design
    course = Course()
    fits: dict[int, Chaos] = {}
    trusted: dict[str, Trusted] = {}
    found = Answers()
    rough: Sequence[str] = work.quantities
    stopped = "evaluations"
    for count in _sizes(most, 0 if design is None else design.count):
        kept = reserve(work, found.limits, priced.way.affordable)
        if kept and count > priced.way.affordable - kept:
            break
        try:
            design = enlarge(work, design, count)
        except OutOfBudget:
            if design is None:
                raise
            stopped = "time"
            break
        if design.failed.all():
            raise none_answered(work)
        trusted, fits = fit_design(work, design, fits)
        for quantity, one in trusted.items():
            course.note(work, CHAOS, quantity, count, one.error, UNEXPLAINED)
            course.note(work, CHAOS, quantity, count, one.seen_by_none, BEFORE)
        usable = {quantity: one for quantity, one in trusted.items() if one.usable}
        rough = [quantity for quantity in work.quantities if quantity not in usable]
        found = answers_of(work, count, usable)
        course.add(work, count, found)
        if not rough and not found.excess:
            stopped = "accuracy"
            break
        if work.out_of_time:
            stopped = "time"
            break
        waiting = [bool(rough), bool(found.excess)]
        hopeless = [
            _hopeless([course.errors(quantity, UNEXPLAINED) for quantity in rough], MOST, most),
            _hopeless([course.worst[name] for name in found.excess], 1.0, most),
        ]
        if count >= SURROGATE.judged and not work.study.analysis.budget.exhaust and hopeless == waiting:
            stopped = "out of reach"
            break
    assert design is not None
    end = End(work=work, priced=priced, design=design, trusted=trusted, fits=fits, found=found,
              rough=tuple(rough), course=course, stopped=stopped)  # fmt: skip
    room = priced.way.affordable - work.ledger.total
    if stopped == "time":
        return conclude(end)
    if rough and room >= FIRST_SAMPLE:
        return to_be_sampled(end, f"{refusal(end)}: the model is sampled")
    if stopped != "accuracy" and room >= priced.way.sampling:
        return to_be_sampled(
            end, "a surrogate does not reach the accuracies, and sampling is forecast to: the model is sampled"
        )
    return conclude(end)


def _sizes(most: int, have: int) -> list[int]:
    """Sizes of the design: doubled from the first, the last what is affordable in whole blocks."""
    sizes = []
    size = SURROGATE.first
    while size <= most:
        sizes.append(size)
        size *= 2
    if not sizes:
        return [max(2 * (most // 2), have)]
    last = REPLICATES * (most // REPLICATES)
    return sizes + ([last] if last >= 1.25 * sizes[-1] and sizes[-1] < SURROGATE.most else [])


def _hopeless(courses: Sequence[Sequence[tuple[int, float]]], wanted: float, most: int) -> bool:
    """Whether something is not to be reached with the runs that are affordable."""
    for course in courses:
        if len(course) >= 2:
            runs = needed(course, wanted)
            if runs is None or runs > CAUTION * most:
                return True
    return False


if TYPE_CHECKING:
    from uqsphere.uq.expansion import Chaos
