"""A cheap fidelity beside the full model: not accurate enough to replace it, but able to spare evaluations of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from uqsphere.arrays import Array
from uqsphere.runner.evaluate import Work, draw, evaluate_sample
from uqsphere.runner.fidelity import Candidate, Pilot
from uqsphere.runner.limits import LimitAnswer, state_of
from uqsphere.runner.schedule import MOST_CHEAPER, REPLICATES
from uqsphere.study import Limit
from uqsphere.uq.control import best_ratio, describe_controlled, predicted_cost, probability
from uqsphere.uq.describe import Description
from uqsphere.uq.estimate import Estimate
from uqsphere.uq.law import Law
from uqsphere.uq.limit_state import LimitState, exceedance, miss, pick_replicates, reliability_index, target_met
from uqsphere.uq.sample import Sample

#: half-width over what is asked, by quantity and limit, of what is not accurate enough yet
Excess = Callable[[dict[str, Description], dict[str, LimitAnswer]], dict[str, float]]

#: the best cost over that of plain sampling, by the pilot's correlations, from which on nothing is tried
HOPEFUL = 0.5
#: points of each replicate at which the trial is made: the second stage, where quantiles have some samples beyond
TRIED = 256
#: fall of the half-widths of quantiles and probabilities with the points, in the shipped studies 0.6 to 0.8
RATE = 0.75
#: most that the evaluations of the cheap model for each of the full one may cost together over that one
MOST_COST = 0.7
#: the forecast cost with the control over that without, from which on it is not used
WORTHWHILE = 0.8


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Which fidelity would serve as a control variate, and on how many points for each of the full model."""

    candidate: Candidate
    ratio: int

    @property
    def row_cost(self) -> float:
        """Cost of a point of the full model together with its share of cheap ones, over that of the former."""
        return 1.0 + self.ratio * self.candidate.cost


@dataclass(frozen=True, kw_only=True)
class Control:
    """The state of the control variate in the course of sampling.

    `sample` has the rows of the cheap model, (R, m), in the order of the full model's; `descriptions`
    and `limits` the answers with its help; `used` None before it was tried.
    """

    plan: Plan | None
    text: str
    used: bool | None = None
    sample: Sample | None = None
    descriptions: dict[str, Description] = field(default_factory=dict)
    limits: dict[str, LimitAnswer] = field(default_factory=dict)
    gain: dict[str, float] = field(default_factory=dict)
    forecast: int | None = None


# --- whether and how ------------------------------------------------------------------------------


def _best_cost(candidate: Candidate) -> tuple[float, str]:
    """The predicted cost of the quantity that gains least, and its name."""
    costs = {
        name: 1.0 if rho is None else predicted_cost(rho, candidate.cost) for name, rho in candidate.correlation.items()
    }
    worst = max(costs, key=lambda name: costs[name])
    return costs[worst], worst


def propose(pilot: Pilot) -> Control:
    """The cheaper fidelity that promises most as a control variate for the full model, or why there is none."""
    if pilot.chosen != "full" or not pilot.candidates:
        return Control(plan=None, text="", used=False)
    candidate = min(pilot.candidates, key=lambda c: _best_cost(c)[0])
    cost, worst = _best_cost(candidate)
    if candidate.unlike:
        return Control(
            plan=None,
            used=False,
            text=f"a control variate was considered and not tried: in some rows {candidate.fidelity} or full outlasts "
            "the record or has no answer",
        )
    if cost > HOPEFUL:
        rho = candidate.correlation[worst]
        tie = "not measurable" if rho is None else f"{rho:.3g}"
        return Control(
            plan=None,
            used=False,
            text=f"a control variate was considered and not tried: the correlation of {candidate.fidelity} with full "
            f"in {worst} is {tie} and a row of it costs {candidate.cost:.2g} of one of full, so that at best "
            f"{100.0 * cost:.0f} % of the cost would be left",
        )
    rho = min(abs(r) for r in candidate.correlation.values() if r is not None)
    wanted = min(best_ratio(rho, candidate.cost), MOST_COST / candidate.cost, MOST_CHEAPER)
    ratio = 2 ** max(1, math.floor(math.log2(wanted)))
    return Control(plan=Plan(candidate=candidate, ratio=ratio), text="")


def needed(excess: dict[str, float], size: int, rate: float) -> float:
    """Evaluations at which the last of the accuracies would be reached; one that has no width yet takes two stages."""
    widest = max(excess.values(), default=1.0)
    return size * max(widest, 1.0) ** (1.0 / rate) if math.isfinite(widest) else 4.0 * size


def weigh(
    plan: Plan, plain: dict[str, float], controlled: dict[str, float], size: int, rate: float = RATE
) -> tuple[bool, int, int]:
    """Whether the control pays, and the evaluations of full to the accuracy asked for, with it and without.

    `plain` and `controlled` are half-widths over what is asked after `size` evaluations of full, and fall with
    their number to the power of -`rate`.  Without the
    control a stage is not rounded up, with it it is: what is doubtful speaks for plain sampling.
    """
    without = max(2.0 * size, needed(plain, size, rate))
    within = size * 2.0 ** math.ceil(math.log2(needed(controlled, size, rate) / size) - 1e-9)
    return within * plan.row_cost <= WORTHWHILE * without, int(within), _round(without)


def verdict(plan: Plan, pays: bool, gain: dict[str, float], size: int, within: int, without: int) -> str:
    """What came of the trial, in words."""
    least = min(gain, key=lambda name: gain[name])
    fidelity, named = plan.candidate.fidelity, f"{within:,} evaluations of full and {plan.ratio} of"
    if pays:
        return (
            f"{fidelity} is used as a control variate: tried on {size:,} evaluations, it promised the accuracy asked "
            f"for with {named} {fidelity} for each, in place of some {without:,} evaluations of full"
        )
    return (
        f"{fidelity} was tried as a control variate on {size:,} evaluations and saves nothing: of what is not accurate "
        f"enough yet it changes the interval of {least} by a factor of {1.0 / gain[least]:.2g}, and would take {named} "
        f"{fidelity} for each, in place of some {without:,} evaluations of full"
    )


def _judge(control: Control, plan: Plan, plain: dict[str, float], controlled: dict[str, float], size: int) -> Control:
    """Use the control, or not, by what both ways would cost from here on to the accuracy asked for."""
    gain = {name: min(ratio, 1e6) / controlled.get(name, 1.0) for name, ratio in plain.items()}
    pays, within, without = weigh(plan, plain, controlled, size)
    text = verdict(plan, pays, gain, size, within, without)
    if pays:
        return replace(control, used=True, text=text, gain=gain, forecast=without)
    return Control(plan=None, used=False, text=text, gain=gain, forecast=without)


def _round(value: float) -> int:
    """A forecast to two figures.

    >>> _round(16_943.0)
    17000
    """
    return int(round(value, 1 - math.floor(math.log10(value))))


# --- the stages -----------------------------------------------------------------------------------


def affordable_rows(control: Control, count: int) -> int:
    """Evaluations of all fidelities that a further stage of `count` points in every replicate takes."""
    each = 1 + control.plan.ratio if control.used and control.plan is not None else 1
    return REPLICATES * count * each


def follow(
    work: Work,
    control: Control,
    sample: Sample,
    plain: tuple[dict[str, Description], dict[str, LimitAnswer]],
    excess: Excess,
    budget: float,
) -> Control:
    """The control variate after a stage of the full model: tried, continued, or left alone.

    Raises
    ------
    OutOfBudget
        When the time is over before the cheap model has been evaluated.
    """
    plan = control.plan
    n = sample.count
    lacking = excess(*plain)
    if plan is None or control.used is False or (control.used is None and (n < TRIED or not lacking)):
        return control
    have = 0 if control.sample is None else control.sample.count
    wanted = plan.ratio * n - have
    if work.ledger.total + REPLICATES * wanted > budget:
        return Control(plan=None, used=False, text="a control variate was not tried: the budget does not allow it")
    drawn = draw(work.drawn, seed=work.study.seed, task="sampling", start=have, count=wanted)
    cheap = replace(work, fidelity=plan.candidate.fidelity, fallback=None, spare=True)
    fresh = _calibrated(work, plan.candidate, evaluate_sample(cheap, f"control.{have}", drawn))
    if control.sample is not None:
        fresh = control.sample.join(fresh)
    if any(part.failed.any() or part.censored.any() for part in (sample, fresh)):
        fidelity = plan.candidate.fidelity
        text = f"{fidelity} is not used as a control variate: rows outlast the record or have no answer"
        return Control(plan=None, used=False, text=text)
    control = replace(control, sample=fresh)
    control = replace(
        control,
        descriptions=_descriptions(work, plan, sample, fresh),
        limits=_limits(work, plan, sample, fresh, plain[1]),
    )
    size = n * REPLICATES
    if control.used is None:
        return _judge(control, plan, lacking, excess(control.descriptions, control.limits), size)
    # the more points there are, the better is known what sampling alone would have taken
    return replace(control, forecast=_round(needed(lacking, size, RATE)))


def _calibrated(work: Work, candidate: Candidate, sample: Sample) -> Sample:
    """Cheap answers put on the pilot's line through those of the full model, so that thresholds correspond."""
    lines = np.array([candidate.calibration[name] for name in work.quantities])
    return replace(sample, answers=lines[:, 0] + lines[:, 1] * sample.answers)


def _method(plan: Plan) -> str:
    return f"randomised quasi-Monte Carlo, controlled by {plan.ratio} times as many {plan.candidate.fidelity}"


def _descriptions(work: Work, plan: Plan, sample: Sample, many: Sample) -> dict[str, Description]:
    n = sample.count
    return {
        name: describe_controlled(
            sample.answer(name),
            many.answer(name)[:, :n],
            many.answer(name),
            quantiles=work.study.analysis.quantiles,
            method=_method(plan),
        )
        for name in work.quantities
    }


def _by_replicate(state: LimitState, answer: Callable[[LimitState], Estimate]) -> Array | None:
    """Probability of every replicate by itself, (R,); None where one has none."""
    found = []
    for r in range(state.demands.shape[0]):
        # two copies of one row: the value is that row's own
        row = replace(pick_replicates(state, [r, r]), censored=None, failed=None)
        value = answer(row).value
        if value is None:
            return None
        found.append(value)
    return np.array(found)


def _limits(
    work: Work, plan: Plan, sample: Sample, many: Sample, plain: dict[str, LimitAnswer]
) -> dict[str, LimitAnswer]:
    """The limits with their probabilities controlled; margins and directions stay those of the full sample."""
    few = many.head(sample.count)
    answers = {}
    for limit in work.study.limits:
        given = plain[limit.name]
        states = [state_of(work, limit, part) for part in (sample, few, many)]
        exceeded = _probability(plan, limit, states, exceedance) or given.exceedance
        missed = exceeded
        if limit.aim == "break":
            missed = _probability(plan, limit, states, lambda state: miss(state, "break")) or given.miss
        answers[limit.name] = replace(
            given,
            exceedance=exceeded,
            miss=missed,
            reliability_index=reliability_index(missed.value),
            reliability_interval=(reliability_index(missed.high), reliability_index(missed.low)),
            met=None if limit.target is None else target_met(missed, limit.target),
        )
    return answers


def _probability(
    plan: Plan, limit: Limit, states: list[LimitState], answer: Callable[[LimitState], Estimate]
) -> Estimate | None:
    rows = [_by_replicate(state, answer) for state in states]
    if rows[0] is None or rows[1] is None or rows[2] is None:
        return None
    return probability(
        rows[0],
        rows[1],
        rows[2],
        sizes=(states[0].demands.shape[1], states[2].demands.shape[1]),
        counted=not isinstance(limit.strength, Law),
        method=f"{_method(plan)}, strength integrated",
    )
