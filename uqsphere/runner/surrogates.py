"""Surrogates of an expensive model: a question of the campaign, which doubles their design."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.results import SpeedRow, SurrogateEntry
from uqsphere.runner.campaign import Accuracy, Cost, indices_missed, speed_rows_of
from uqsphere.runner.evaluate import Work, none_answered
from uqsphere.runner.expensive_margins import margin_runs
from uqsphere.runner.pricing import enlarge
from uqsphere.runner.questions.indices import CHAOS, Sensitivity, dependent_names, no_surrogate, without_sets
from uqsphere.runner.questions.probabilities import Demand, reserve
from uqsphere.runner.schedule import REPLICATES, SURROGATE
from uqsphere.runner.surrogate_answers import RunAnswers, answers_of, answers_of_runs, blocks_of_runs
from uqsphere.uq import Sample, absent, response, widest
from uqsphere.uq.expansion import germ_points
from uqsphere.uq.indices import believable
from uqsphere.uq.response import Response, cross_fit, group_shares, pair_shares, spread_of

#: how the error of a surrogate is called in the speed-error table
UNEXPLAINED: Final = "share of the variance left unexplained (runs left out)"


@dataclass(kw_only=True)
class Surrogates:
    """All that is asked of an expensive model, answered by surrogates of its runs: a question of the campaign."""

    work: Work
    design: Sample | None = None
    responses: dict[str, Response] = field(default_factory=dict)
    found: RunAnswers = field(default_factory=RunAnswers)
    alone: RunAnswers = field(default_factory=RunAnswers)
    begun: bool = False
    noise: Mapping[str, float] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Runs."""
        return 0 if self.design is None else self.design.count

    @property
    def judged(self) -> int:
        """Runs from which on a course tells what more would do."""
        return SURROGATE.judged // 2

    @property
    def usable(self) -> dict[str, Response]:
        """The surrogates that may speak for the model."""
        return {quantity: one for quantity, one in self.responses.items() if one.usable}

    @property
    def rough(self) -> tuple[str, ...]:
        """The quantities without one."""
        return tuple(quantity for quantity in self.work.quantities if quantity not in self.usable)

    def advance(self, room: float) -> bool:
        """The design doubled and all fitted again; in whole blocks, and no more than leaves room for rare events."""
        have = self.size
        every = int(have + room)
        # what is too rough for a response so far may be less so once its course tells
        rough = max(min(reserve(self.work, self.alone.limits, every), every - SURROGATE.judged), 0)
        kept = min(reserve(self.work, self.found.limits, every) + rough + margin_runs(self.work), every // 2)
        affordable = min(every - kept, SURROGATE.most)
        count = self._next(affordable)
        if self.begun and count <= have:
            return False
        self.design = enlarge(self.work, self.design, max(count, have))
        self.begun = True
        if self.design.failed.all():
            raise none_answered(self.work)
        self.answer()
        return True

    def _next(self, affordable: int) -> int:
        """The size of the next stage: twice as much, or all that is affordable in whole blocks."""
        have = self.size
        if not self.begun and affordable >= SURROGATE.first:
            return SURROGATE.first
        if not self.begun:
            return 2 * (affordable // 2)
        if 2 * have <= affordable:
            return 2 * have
        last = REPLICATES * (affordable // REPLICATES)
        return last if last >= 1.25 * have else have

    def answer(self) -> None:
        """Fit the runs, and answer with what may be used."""
        self.responses = self.fitted()
        self._ask()

    def fitted(self, more: Sequence[tuple[Array, Array]] = ()) -> dict[str, Response]:
        """Responses fitted to the runs and `more`: points (n, D) and answers (n, q), nan where there is none.

        Those help to fit: the design's own runs, drawn by the law, correct and judge what was fitted.
        """
        assert self.design is not None
        work, d, drop = self.work, len(self.work.scene_names), self.work.study.analysis.on_failure == "drop"
        normals = np.concatenate([self.design.scores[0], *(scores for scores, _ in more)])
        answers = np.concatenate([self.design.answers[0], *(values for _, values in more)])
        points, own = germ_points(normals[:, :d], work.germs), np.arange(len(normals)) < self.size
        lost = ~np.isfinite(answers.T)
        lost[:, own] = [self.design.lost(quantity)[0] for quantity in work.quantities]
        made: dict[str, Response] = {}
        # outputs that miss the same rows are fitted together
        for known in ~np.unique(lost, axis=0):
            these = np.flatnonzero((lost != known).all(axis=1)).tolist()
            if self.size >= SURROGATE.first <= 2 * int(known[own].sum()) and (drop or known[own].all()):
                found = cross_fit(points[known], answers[known][:, these], work.germs, active=work.active)
                found = [one.of_rows(own[known]) for one in found] if more else found
                made |= dict(zip([work.quantities[k] for k in these], found, strict=True))
        return {q: replace(made[q], noise=self.noise.get(q, 0.0)) for q in work.quantities if q in made}

    def take(self, others: Mapping[str, Response]) -> None:
        """Answer with other responses, which more runs than the design's have helped to fit, where they leave less."""
        have = self.responses
        better = {q: one for q, one in others.items() if q not in have or one.error < have[q].error}
        if any(one.usable for one in better.values()):
            self.responses = {q: (have | better)[q] for q in self.work.quantities if q in have | better}
            self._ask()

    def _ask(self) -> None:
        """What the responses that may be used say, and the runs alone of the other quantities."""
        assert self.design is not None
        work = self.work
        self.found = answers_of(work, self.size, self.usable)
        # a limit may be followed by learning although its quantity is too rough for a response
        self.alone = answers_of_runs(work, blocks_of_runs(self.design), self.rough)

    def lacking(self) -> dict[Accuracy, float]:
        """What surrogates leave of the variance over what they may, and what their answers lack."""
        rough = {
            Accuracy(quantity, "surrogate"): self.responses[quantity].error / response.MOST
            if quantity in self.responses
            else math.inf
            for quantity in self.rough
        }
        return rough | self.found.lacking

    def errors(self) -> list[SpeedRow]:
        """Rows of the speed-error table."""
        rows: list[SpeedRow] = []
        for quantity, one in self.responses.items():
            rows += speed_rows_of(CHAOS, quantity, self.size, one.error, UNEXPLAINED)
        return rows + self.found.errors(self.size)

    def refusal(self) -> str:
        """Why surrogates are not used, or an empty text."""
        if not self.rough:
            return ""
        if not self.responses:
            return "no surrogate was fitted, since runs are too few or some have no answer"
        nothing = "some of its runs have no answer"
        told = [f"{q}: {self.responses[q].reason if q in self.responses else nothing}" for q in self.rough]
        which = "the surrogate is" if len(told) == 1 else "surrogates are"
        return f"{which} too rough ({'; '.join(told)})"

    def demands(self) -> dict[str, tuple[Demand, float, float]]:
        """By quantity its surrogate at normal scores, the scatter of its residuals, and its standard deviation."""
        germs = self.work.germs

        def demand(one: Response) -> Demand:
            return lambda normals: one.at(germ_points(normals, germs))

        return {
            quantity: (demand(one), math.sqrt(one.error) * spread_of(one.outputs), spread_of(one.outputs))
            for quantity, one in self.usable.items()
        }

    def sensitivity(self, quantity: str, cost: Callable[[Accuracy], Cost], sampling: int) -> Sensitivity:
        """Indices off the surrogate of a quantity, with what more accurate ones would cost, or sampled ones."""
        work, one, found = self.work, self.responses.get(quantity), self.found.indices.get(quantity)
        names, asked = work.scene_names, work.study.analysis.accuracy.sobol
        about = no_surrogate()
        if one is not None:
            about = SurrogateEntry(kind=CHAOS, error=one.error, evaluations=one.count, usable=one.usable,
                                   reason=one.reason, degree=one.degree, terms=one.terms)  # fmt: skip
        if one is None or found is None:
            return self._without_indices(quantity, about, sampling)
        width = widest(*found.values())
        missed = []
        if width > asked:
            missed = [indices_missed(quantity, width, asked, cost=cost(Accuracy(quantity, "indices")))]
        given = {order: believable(row) for order, row in found.items()}
        return Sensitivity(
            first=dict(zip(names, given["first"], strict=True)),
            total=dict(zip(names, given["total"], strict=True)),
            surrogate=about,
            sampled={},
            expanded=dict(given),
            agree=None,
            text="Indices are those of the surrogate; their intervals hold what it leaves of the variance.",
            missed=missed,
            estimators="Off the coefficients of the surrogate, or by sampling it where its output was transformed.",
            **_sets(work, one),
        )

    def _without_indices(self, quantity: str, about: SurrogateEntry, sampling: int) -> Sensitivity:
        work, tied = self.work, dependent_names(self.work)
        reason = (
            f"{', '.join(tied)} depend on each other: Shapley effects take their place, and are sampled"
            if tied
            else "no surrogate may be used, and sampled indices are beyond the budget"
        )
        nothing = absent(reason, response.METHOD, work.ledger.total)
        cost = Cost(f" ({sampling:,} evaluations)", sampling)
        missed = [indices_missed(quantity, None, work.study.analysis.accuracy.sobol, f": {reason}", cost)]
        none = Sensitivity.none(work.scene_names, nothing, surrogate=about, missed=missed,
                                text=f"No index is given: {reason}.")  # fmt: skip
        return without_sets(work, none, replace(nothing, evaluations=0))


def _sets(work: Work, one: Response) -> dict[str, Any]:
    """Indices of pairs and groups where the study asks for them, off the surrogate."""
    names, analysis, seed = work.scene_names, work.study.analysis, work.study.seed
    pairs = [(i, j) for i in range(len(names)) for j in range(i + 1, len(names))] if analysis.second_order else []
    labels = [f"{names[i]}|{names[j]}" for i, j in pairs]
    groups = [[names.index(name) for name in members] for members in analysis.groups.values()]
    first, total = group_shares(one, groups, seed) if groups else ([], [])
    return {
        "second": dict(zip(labels, pair_shares(one, pairs, seed) if pairs else [], strict=True)),
        "group_first": dict(zip(analysis.groups, first, strict=True)),
        "group_total": dict(zip(analysis.groups, total, strict=True)),
    }
