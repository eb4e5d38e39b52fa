"""Limits: demand against strength at the sampled points, the strength integrated exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from uqsphere.runner.work import Draw, Sample, Work
from uqsphere.study import Limit
from uqsphere.uq.distribution import Law, cdf
from uqsphere.uq.estimates import Estimate, exact
from uqsphere.uq.inputs import conditional_normal
from uqsphere.uq.reliability import LimitState, exceedance, margin_quantiles, miss, reliability_index, target_met

__all__ = ["LimitAnswer", "judge_limits", "state_of", "takes_over"]

Array = npt.NDArray[np.float64]

#: a probability below this is not chased for its relative accuracy by plain sampling
NEGLIGIBLE = 1e-12
#: a probability below this is left to the methods for rare events where sampling is not accurate
RARE = 0.01


@dataclass(frozen=True, kw_only=True)
class LimitAnswer:
    """What is known of one limit; `met` None: undecided, or no target."""

    quantity: str
    aim: str
    target: float | None
    exceedance: Estimate
    miss: Estimate
    reliability_index: float | None
    reliability_interval: tuple[float | None, float | None]
    margin: dict[str, Estimate]
    governing: dict[str, float] | None
    met: bool | None
    governing_method: str = "squared direction of the centre of failures in standard normal space"
    design: dict[str, float] | None = None
    design_points: int = 0
    design_reason: str = "no search for a design point was made"
    modes: int | None = None
    checks: tuple[str, ...] = ()

    def accuracy_missed(self, which: str, asked: float) -> str:
        """Why a probability is not as accurate as asked, or an empty text."""
        estimate: Estimate = getattr(self, which)
        if estimate.value is None:
            return f"{which}: {estimate.reason}"
        if self.beneath(which):
            return ""
        if estimate.half_width <= asked * estimate.value:
            return ""
        relative = estimate.half_width / estimate.value if estimate.value > 0.0 else float("inf")
        return f"{which}: half-width {relative:.2g} of the probability, asked {asked:g}"

    def beneath(self, which: str) -> bool:
        """Whether a probability is too small to matter: beneath notice, or far beneath the target."""
        high = getattr(self, which).high
        return high is not None and (high < NEGLIGIBLE or (self.target is not None and high < 0.01 * self.target))


def takes_over(work: Work, answer: LimitAnswer) -> bool:
    """Whether the methods for rare events may take a limit on: its probability is small, or nothing of it was seen."""
    small = answer.miss.value is None or answer.miss.value < RARE
    return small and "auto" in work.study.analysis.methods and bool(work.drawn.names)


def state_of(work: Work, limit: Limit, points: Draw, values: Sample) -> LimitState:
    """Demands of a limit at the points, with what they tell of the strength."""
    k = work.quantities.index(limit.quantity)
    demands = values.values[:, :, k]
    names = work.drawn.names
    if isinstance(limit.model_factor, Law):
        demands = demands * points.physical[:, :, names.index(f"limits.{limit.name}.model_factor")]
    else:
        demands = demands * limit.model_factor
    shift, remaining = None, 1.0
    if isinstance(limit.strength, Law):
        weights, remaining = conditional_normal(work.all_inputs, f"limits.{limit.name}.strength", names)
        if np.any(weights):
            scores = points.normals
            if work.drawn.correlation is not None:
                scores = scores @ np.linalg.cholesky(work.drawn.correlation).T
            shift = scores @ weights
    policy = work.study.analysis.on_failure
    return LimitState(
        demands=demands,
        strength=limit.strength,
        shift=shift,
        remaining_sd=remaining,
        censored=values.censored[:, :, k],
        failed=values.failed,
        on_failure="drop" if policy == "abort" else policy,
    )


def _governing(work: Work, limit: Limit, points: Draw, state: LimitState) -> dict[str, float] | None:
    """Shares of the inputs in the direction of the failures' centre in standard normal space.

    For a plane limit state these are the squared direction cosines of the design point.  The strength's own
    direction is integrated: given the demand, E[z 1(z < zeta)] = -phi(zeta).
    """
    from scipy.special import ndtr, ndtri

    keep = ~state.broken
    if isinstance(limit.strength, Law):
        with np.errstate(divide="ignore"):
            score = np.asarray(ndtri(cdf(limit.strength, np.where(keep, state.demands, 0.0))))
        if state.shift is not None:
            score = score - state.shift
        score = np.clip(score / max(state.remaining_sd, 1e-12), -37.0, 37.0)
        weight = np.where(keep, ndtr(score), 0.0)
        own = -float(np.exp(-0.5 * score**2)[keep].sum()) / np.sqrt(2.0 * np.pi)
    else:
        weight = np.where(keep, (state.demands > limit.strength).astype(float), 0.0)
        own = 0.0
    mass = float(weight.sum())
    if not 0.0 < mass < keep.sum():
        return None
    if mass > 0.5 * keep.sum():
        # both centres lie on one line through the origin; that of the fewer samples is seen more clearly
        weight = np.where(keep, 1.0 - weight, 0.0)
    centre = {name: float((weight * points.normals[:, :, k]).sum()) for k, name in enumerate(work.drawn.names)}
    if isinstance(limit.strength, Law):
        centre[f"limits.{limit.name}.strength"] = own
    squares = {name: value**2 for name, value in centre.items()}
    total = sum(squares.values())
    return {name: value / total for name, value in squares.items()} if total > 0.0 else None


def judge_limits(work: Work, points: Draw, values: Sample) -> dict[str, LimitAnswer]:
    """Every limit of the study at the points that were sampled."""
    answers = {}
    for limit in work.study.limits:
        state = state_of(work, limit, points, values)
        missed, exceeded = miss(state, limit.aim), exceedance(state)
        if not work.drawn.names and not state.late.any() and not state.broken.any():
            missed, exceeded = (exact(e.value) if e.value is not None else e for e in (missed, exceeded))
        answers[limit.name] = LimitAnswer(
            quantity=limit.quantity,
            aim=limit.aim,
            target=limit.target,
            exceedance=exceeded,
            miss=missed,
            reliability_index=reliability_index(missed.value),
            reliability_interval=(reliability_index(missed.high), reliability_index(missed.low)),
            margin=margin_quantiles(state),
            governing=_governing(work, limit, points, state),
            met=None if limit.target is None else target_met(missed, limit.target),
        )
    return answers
