"""The union of the limits that mean fracture: its probability at what was sampled, and over the free scalar."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.runner.limits import RARE, state_of
from uqsphere.runner.margins import MarginAnswer
from uqsphere.runner.moved import axis_of, evaluate_at
from uqsphere.runner.rare import DOUBTFUL, LEAST, MOST, SHARE, narrower
from uqsphere.runner.sampling import Sampled
from uqsphere.runner.work import REPLICATES, OutOfBudget, Work, evaluate_points, with_answered
from uqsphere.study import Limit, Study
from uqsphere.uq.estimates import Estimate
from uqsphere.uq.joint import physical_from_normal
from uqsphere.uq.law import Law
from uqsphere.uq.margins import fragility
from uqsphere.uq.reliability import LimitState, exceedance, pick_replicates
from uqsphere.uq.sample import Sample
from uqsphere.uq.sampling import random_generator
from uqsphere.uq.union import Union, make_union, residual_correlation, union_state

__all__ = ["fracture_limits", "strength_factor", "tied_otherwise", "union_at", "union_curve", "union_estimate"]

Array = npt.NDArray[np.float64]

#: points of each replicate at one value of the free scalar, and values at most
CURVE_POINTS: Final = 64
CURVE_VALUES: Final = 17
#: a probability of fracture this close to 0 or 1 needs no more points of the curve
NEGLIGIBLE: Final = 1e-6


def fracture_limits(study: Study) -> tuple[Limit, ...]:
    """The limits of a study whose exceedance breaks the sphere."""
    from uqsphere.mechanics.criteria import path_of

    if study.black_box:
        return ()
    return tuple(
        limit
        for limit in study.limits
        if limit.fracture is not False and path_of(limit.quantity, study.demands) is not None
    )


def tied_otherwise(work: Work, names: Sequence[str]) -> list[str]:
    """Limits two of whose strengths one copula other than the Gaussian ties to each other."""
    for group in work.all_inputs.groups:
        found = [name for name in names if f"limits.{name}.strength" in group.members]
        if len(found) > 1:
            return found
    return []


def strength_factor(work: Work, limits: Sequence[Limit]) -> Array:
    """Cholesky factor of the correlation of the strengths' scores given all that is drawn."""
    inputs = work.all_inputs
    covariance = np.eye(len(limits))
    if inputs.correlation is None:
        return covariance
    random = [k for k, limit in enumerate(limits) if isinstance(limit.strength, Law)]
    at = [inputs.names.index(f"limits.{limits[k].name}.strength") for k in random]
    given = [inputs.names.index(name) for name in work.drawn.names]
    own, across = inputs.correlation[np.ix_(at, at)], inputs.correlation[np.ix_(given, at)]
    within = inputs.correlation[np.ix_(given, given)]
    covariance[np.ix_(random, random)] = own - across.T @ np.linalg.solve(within, across)
    return residual_correlation(covariance)


def union_at(work: Work, limits: Sequence[Limit], factor: Array, sample: Sample) -> Union:
    # one stream wherever the union is asked for: common random numbers, where any are needed at all
    rng = random_generator(seed=work.study.seed, task="fracture.holding")
    return make_union([state_of(work, limit, sample) for limit in limits], factor, rng)


# --- probability of the union -------------------------------------------------------------------------


def union_estimate(work: Work, sampled: Sampled, limits: Sequence[Limit], factor: Array) -> Estimate:
    """Probability that any limit is exceeded; one limit's own where there is but one."""
    if len(limits) == 1:
        return sampled.limits[limits[0].name].exceedance
    plain = exceedance(union_state(union_at(work, limits, factor, sampled.sample)))
    asked = work.study.analysis.accuracy.probability
    small = plain.value is None or plain.value < RARE
    known = plain.value is not None and plain.value >= DOUBTFUL and plain.half_width <= asked * plain.value
    left = int(min(MOST, SHARE * (work.study.analysis.budget.evaluations - work.ledger.total)))
    independent = not np.any(factor - np.diag(np.diag(factor)))
    possible = "auto" in work.study.analysis.methods and not work.all_inputs.groups and bool(work.drawn.names)
    if not small or known or left < LEAST or not independent or not possible:
        return plain
    from uqsphere.uq.rare.auto import find_probability
    from uqsphere.uq.rare.problem import LimitFunction

    integrated = any(isinstance(limit.strength, Law) for limit in limits)
    function = LimitFunction(
        function=_limit_function(replace(work, spare=True), limits, factor),
        dimension=len(work.drawn.names),
        integrated=integrated,
        on_failure="bound",
    )
    rare = find_probability(function, seed=work.study.seed, accuracy=asked, budget=left)
    return narrower(rare.estimate, plain)[0]


def _limit_function(work: Work, limits: Sequence[Limit], factor: Array) -> Any:
    """The union as a function of normal scores: negative, or exceeded with the probability Phi(-g)."""
    d, calls = len(work.scene_names), iter(range(10**9))
    fixed = not any(isinstance(limit.strength, Law) for limit in limits)

    def g(normals: Array) -> Array:
        if work.ledger.elapsed > work.seconds:
            raise OutOfBudget
        physical = physical_from_normal(work.drawn, normals)
        rows = physical[:, :d] if d else physical[:1, :d]
        answered = evaluate_points(work, f"rare-events.union.{next(calls)}", work.scene_names, rows)
        # a limit state is of two replicates at least: the same one twice
        points = Sample.at(work.drawn.names, np.stack([normals] * 2), np.stack([physical] * 2))
        sample = with_answered(work, points, answered)
        states = [state_of(work, limit, sample) for limit in limits]
        if fixed:
            found = [_ratio(state) for state in states]
            value = np.log(np.min(found, axis=0))
        else:
            together = make_union(states, factor, random_generator(seed=0, task="fracture.unused"))
            value = -union_state(together).demands[0]
        return np.where(~sample.failed[0], value, np.nan)

    return g


def _ratio(state: LimitState) -> Array:
    """A fixed strength over the demand, (n,): 1 at the limit, never 0."""
    assert not isinstance(state.strength, Law)
    return np.asarray(np.maximum(state.strength, 1e-300) / np.maximum(state.demands[0], 1e-300))


# --- along the free scalar ----------------------------------------------------------------------------


def union_curve(
    work: Work, limits: Sequence[Limit], factor: Array, margins: Mapping[str, MarginAnswer]
) -> dict[str, Any]:
    """Probability of fracture by any limit over the free scalar of the margins; empty where there is no such curve."""
    asked = work.study.margins
    grid = _grid([margins[limit.name].curve for limit in limits if limit.name in margins])
    if asked is None or len(grid) < 2 or len(limits) < 2 or not asked.axis.moves_rows:
        return {}
    if len(grid) > CURVE_VALUES:
        grid = [grid[k] for k in np.unique(np.linspace(0, len(grid) - 1, CURVE_VALUES).round().astype(int))]
    left = work.study.analysis.budget.evaluations - work.ledger.total
    if len(grid) * CURVE_POINTS * REPLICATES > left:
        return {}
    table = np.array([_at_value(work, value, limits, factor) for value in grid])
    usable = np.isfinite(table).all(axis=1)
    if usable.sum() < 2:
        return {}
    found = fragility(
        np.array(grid)[usable], table[usable], asked.for_probability, samples=CURVE_POINTS,
        evaluations=len(grid) * CURVE_POINTS * REPLICATES,
    )  # fmt: skip
    return {
        "solve": asked.axis.path,
        "values": {f"{p:.15g}": estimate.as_dict() for p, estimate in found.values.items()},
        "curve": [list(point) for point in found.curve],
    }


def _grid(curves: Sequence[list[list[float]]]) -> list[float]:
    """The values at which one of the curves is neither surely broken nor surely whole, and one beside on each side."""
    points = [point for curve in curves for point in curve]
    grid = sorted({float(point[0]) for point in points})
    # the limit that is reached first decides when fracture is sure
    worst = {value: max(float(p[1]) for p in points if float(p[0]) == value) for value in grid}
    open_at = [k for k, value in enumerate(grid) if NEGLIGIBLE < worst[value] < 1.0 - NEGLIGIBLE]
    return grid[max(open_at[0] - 1, 0) : open_at[-1] + 2] if open_at else []


def _at_value(work: Work, value: float, limits: Sequence[Limit], factor: Array) -> Array:
    """Probability of the union in every replicate (R,), the same random numbers at every value."""
    moved = replace(work, study=axis_of(work).move(work.study, value))
    sample = evaluate_at(work, value, start=0, count=CURVE_POINTS)
    state = union_state(union_at(moved, limits, factor, sample))
    found = [exceedance(pick_replicates(state, [r, r])).value for r in range(REPLICATES)]
    return np.array([np.nan if p is None else p for p in found])
