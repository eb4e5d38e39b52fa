"""Limits: demand against strength at the sampled points, the strength integrated exactly."""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.quantities import format_estimate
from uqsphere.results import Fields, LimitEntry
from uqsphere.runner.campaign import Missed
from uqsphere.runner.evaluate import Work
from uqsphere.study import Limit, strength_name
from uqsphere.units import told_apart
from uqsphere.uq import NORMAL, Estimate, Law, Sample, absent, exact
from uqsphere.uq.describe import controlled_probability
from uqsphere.uq.failure_indices import BY_DIRECTION, failure_shares
from uqsphere.uq.limit_state import (
    CERTAIN,
    LimitState,
    by_replicate,
    exceedance,
    margin_quantiles,
    miss,
    reliability_index,
    tails,
    target_met,
)

TABLED = "randomised quasi-Monte Carlo, controlled by a table, strength integrated"
#: a probability below this is not chased for its relative accuracy by plain sampling
NEGLIGIBLE = 1e-12
#: a probability below this is left to the methods for rare events where sampling is not accurate
SMALL = 0.01
#: a probability above this is as well sampled
MOST_SEARCHED = 0.3
#: runs that a probability has to rest on
SEEN = 1.0
#: runs that have to carry a smaller one for the spread of replicates to tell how well it is known, by Kish's count:
#: of strengths with a normal score of their own, intervals held 30 % of the answers that one run carries, 60 % with
#: three, 80 % with ten, and from twenty on 93 to 97 %
CARRYING = 20.0
#: why a limit has no design point that none was looked for of
UNSOUGHT: Final = "no search for a design point was made"


@dataclass(frozen=True, kw_only=True)
class LimitAnswer:
    """What is known of one limit; `counted`: by rows that lie on a side of it."""

    quantity: str
    aim: str
    target: float | None
    exceedance: Estimate
    miss: Estimate
    margin: dict[str, Estimate]
    governing: dict[str, float] | None
    governing_method: str = BY_DIRECTION
    design: dict[str, float] | None = None
    design_points: int = 0
    design_reason: str = UNSOUGHT
    modes: int | None = None
    checks: tuple[str, ...] = ()
    counted: bool = False

    def accuracy_missed(self, which: str, asked: float) -> str:
        """Why a probability is not as accurate as asked, or an empty text."""
        estimate: Estimate = getattr(self, which)
        if math.isinf(asked):
            return ""
        if estimate.value is None:
            return f"{which}: {estimate.reason}"
        if self.beneath(which):
            return ""
        if estimate.half_width <= asked * estimate.value:
            return ""
        if not estimate.value > 0.0:
            return f"{which}: none seen, at most {estimate.high:.2g}, so that it is not known to {asked:g} of itself"
        relative = estimate.half_width / estimate.value
        return f"{which}: half-width {told_apart(relative, asked)} of the probability, asked {asked:g}"

    @property
    def pursued(self) -> tuple[str, ...]:
        """The probabilities whose accuracy is pursued."""
        return ("exceedance", "miss") if self.aim == "break" else ("miss",)

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None: undecided, or no target."""
        return None if self.target is None else target_met(self.miss, self.target)

    @property
    def told(self) -> str:
        """The probability of missing the aim with its interval, for people; empty where it is not known."""
        value, low, high = self.miss.value, self.miss.low, self.miss.high
        if value is None or low is None or high is None:
            return ""
        return format_estimate(value, low, high, most=5)

    def entry(self) -> Fields:
        """The same as results.json has it, before its verdict."""
        return {
            **{key: value for key, value in vars(self).items() if key in LimitEntry.model_fields},
            "reliability_index": reliability_index(self.miss.value),
            "reliability_index_interval": (reliability_index(self.miss.high), reliability_index(self.miss.low)),
            "met": self.met,
            "design_point": self.design,
            "design_point_reason": None if self.design else self.design_reason,
            "governing_inputs": self.governing,
            "governing_inputs_method": self.governing_method,
        }

    def with_check(self, text: str) -> LimitAnswer:
        """The same with one remark more."""
        return replace(self, checks=(*self.checks, text))

    def beneath(self, which: str) -> bool:
        """Whether a probability is too small to matter: beneath notice, or far beneath the target."""
        high = getattr(self, which).high
        return high is not None and (high < NEGLIGIBLE or (self.target is not None and high < 0.01 * self.target))


def takes_over(work: Work, answer: LimitAnswer) -> bool:
    """Whether the methods for rare events may take a limit on: its probability is small, or nothing of it was seen, or
    the budget has too few rows to be counted on either side of it.

    They know the Gaussian copula alone.
    """
    if work.all_inputs.groups:
        return False
    p, analysis = answer.miss.value, work.study.analysis
    small = p is None or p < SMALL
    if p is not None and answer.counted and SMALL <= p < MOST_SEARCHED and analysis.pursues("miss"):
        # half-width of n independent rows: t sqrt((1 - p)/(p n)) of itself
        small = (NORMAL / analysis.accuracy.probability) ** 2 * (1.0 - p) / p > analysis.budget.evaluations
    return small and "auto" in work.study.analysis.methods and bool(work.drawn.names)


def limits_missed(work: Work, limits: Mapping[str, LimitAnswer]) -> list[Missed]:
    """What of the limits is not yet as accurate as the study asks."""
    asked = work.study.analysis.accuracy.probability
    return [
        Missed(subject=f"limits.{name}", kind=which, said=f"limit {name}: {text}")
        for name, limit in limits.items()
        for which in limit.pursued
        if (text := limit.accuracy_missed(which, asked))
    ]


def state_of(work: Work, limit: Limit, sample: Sample) -> LimitState:
    """Demands of a limit at the points, with what they tell of the strength."""
    demands = sample.answer(limit.quantity)
    names = work.drawn.names
    if isinstance(limit.model_factor, Law):
        demands = demands * sample.inputs[:, :, names.index(f"limits.{limit.name}.model_factor")]
    else:
        demands = demands * limit.model_factor
    policy = work.study.analysis.on_failure
    state = LimitState(
        demands=demands,
        strength=limit.strength,
        censored=sample.late(limit.quantity),
        failed=sample.lost(limit.quantity),
        on_failure="drop" if policy == "abort" else policy,
    )
    if not isinstance(limit.strength, Law) or not work.study.dependence:
        return state
    scores = work.drawn.scores(sample.scores.reshape(-1, len(names))).reshape(sample.scores.shape)
    return tie_strength(work, limit, state, names, scores)


def tie_strength(work: Work, limit: Limit, state: LimitState, names: Sequence[str], scores: Array) -> LimitState:
    """The state with what the dependent scores (R, n, d) of `names` tell of the strength."""
    if not isinstance(limit.strength, Law):
        return state
    strength = strength_name(limit.name)
    weights, remaining = work.all_inputs.regression(strength, names)
    shift = scores @ weights if np.any(weights) else None
    tie = work.all_inputs.tie(strength, names, scores)
    return replace(state, shift=shift, remaining_sd=remaining, weights=tuple(weights.tolist()), tie=tie)


def _governing(work: Work, limit: Limit, sample: Sample, state: LimitState) -> tuple[dict[str, float] | None, str]:
    """Shares of the inputs in the failures, the strength among them, and how they were found."""
    from scipy.special import ndtr, ndtri

    keep = ~state.broken
    names, score = list(work.drawn.names), None
    if isinstance(limit.strength, Law):
        with np.errstate(divide="ignore"):
            score = np.asarray(ndtri(limit.strength.cdf(np.where(keep, state.demands, 0.0))))
        score = np.clip(state.score_given_inputs(score), -CERTAIN, CERTAIN)[keep]
        weight = np.asarray(ndtr(score))
        names.append(strength_name(limit.name))
    else:
        weight = (state.demands > limit.strength)[keep].astype(float)
    regression = work.all_inputs.regression(names[-1], work.drawn.names) if score is not None else None
    inputs = sample.scores[keep][:, : len(work.drawn.names)]
    found = failure_shares(inputs, weight, score, work.drawn, regression)
    if found is None:
        return None, BY_DIRECTION
    return dict(zip(names, found[0].tolist(), strict=True)), found[1]


def judge_limits(work: Work, sample: Sample, quantities: Container[str] | None = None) -> dict[str, LimitAnswer]:
    """Every limit of the study, or those of some quantities, at the points that were sampled."""
    answers = {}
    for limit in work.study.limits:
        if quantities is not None and limit.quantity not in quantities:
            continue
        state = state_of(work, limit, sample)
        missed, exceeded = miss(state, limit.aim), exceedance(state)
        if not work.drawn.names and not state.late.any() and not state.broken.any():
            missed, exceeded = (exact(e.value) if e.value is not None else e for e in (missed, exceeded))
        shares, method = _governing(work, limit, sample, state)
        answers[limit.name] = LimitAnswer(
            quantity=limit.quantity,
            aim=limit.aim,
            target=limit.target,
            exceedance=exceeded,
            miss=missed,
            margin=margin_quantiles(state),
            governing=shares,
            governing_method=method,
            counted=not isinstance(limit.strength, Law),
        )
    return answers


# --- few runs ---------------------------------------------------------------------------------------------


def controlled_limits(
    work: Work, plain: Mapping[str, LimitAnswer], sample: Sample, many: Sample
) -> dict[str, LimitAnswer]:
    """The limits of a sample with probabilities corrected by a table at `many` points, the first of which are its own;
    margins and directions stay those of the sample."""
    answers, few = {}, many.head(sample.count)
    for limit in work.study.limits:
        given, states = plain[limit.name], [state_of(work, limit, part) for part in (sample, few, many)]
        counted = not isinstance(limit.strength, Law)
        exceeded = _controlled(states, "survive", counted) or given.exceedance
        missed = exceeded
        if limit.aim == "break":
            missed = _controlled(states, "break", counted) or given.miss
        answers[limit.name] = replace(given, exceedance=exceeded, miss=missed)
    return answers


def _controlled(states: Sequence[LimitState], aim: str, counted: bool) -> Estimate | None:
    """A probability of missing an aim of the first state, corrected by those of the other two; None where a replicate
    has none."""
    rows = [by_replicate(state, aim) for state in states]
    if rows[0] is None or rows[1] is None or rows[2] is None:
        return None
    sizes = states[0].demands.shape[1], states[2].demands.shape[1]
    return controlled_probability(rows[0], rows[1], rows[2], sizes=sizes, counted=counted, method=TABLED)


def carriers(state: LimitState, aim: str, runs: int) -> dict[str, float]:
    """How many of the runs the probabilities of exceedance and of missing the aim rest on: by Kish's count."""
    counts = []
    for weights in tails(state):
        squares = float((weights**2).sum())
        counts.append(runs * float(weights.sum()) ** 2 / squares / weights.size if squares > 0.0 else 0.0)
    return {"exceedance": counts[0], "miss": counts[0 if aim == "survive" else 1]}


def told_by_runs(found: Estimate, state: LimitState, which: str, aim: str) -> Estimate:
    """A probability by the spread of replicates, as far as it is known by that.

    It says little of one that hangs on a few runs: where fewer than one in all would show it and few carry it, it is
    bounded only.
    """
    runs = state.demands.size
    if not found.value or found.value * runs >= SEEN or carriers(state, aim, runs)[which] >= CARRYING:
        return found
    return unseen(found, runs, f"{runs:,} runs alone: too few of them carry it")


def unseen(estimate: Estimate, runs: int, why: str) -> Estimate:
    """No value, since it is too small for `why`, and the bound that `runs` of which none shows it allow."""
    bound = max(estimate.high or 0.0, -math.expm1(math.log(0.05) / runs))
    return replace(absent(f"too small for {why}", estimate.method, runs), low=0.0, high=min(bound, 1.0))
