"""Several limits taken together: the probability that any of them is exceeded, here, along the free scalar, and before
the first reflected wave is back.

The union is averaged over everything that was sampled, the strengths integrated (`uqsphere.uq.union`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.runner.axis_rows import evaluate_along
from uqsphere.runner.evaluate import OutOfBudget, Work, evaluate_points, evaluate_sample, with_answered
from uqsphere.runner.forecast import reflected
from uqsphere.runner.limits import SMALL, state_of
from uqsphere.runner.questions.probabilities import DOUBTFUL, search_failures
from uqsphere.runner.schedule import FRACTURE, FRACTURE_CURVE, RARE, REPLICATES
from uqsphere.study import Limit
from uqsphere.uq import Estimate, Law, Sample, absent, random_generator, student
from uqsphere.uq.curve import fragility
from uqsphere.uq.limit_state import exceedance, pick_replicates
from uqsphere.uq.union import Union, make_union, residual_correlation, union_state

#: a probability of fracture this close to 0 or 1 needs no more points of the curve
NEGLIGIBLE: Final = 1e-6


def tied_otherwise(work: Work, names: Sequence[str]) -> list[str]:
    """Limits two of whose strengths one copula other than the Gaussian ties to each other."""
    for group in work.all_inputs.groups:
        found = [name for name in names if f"limits.{name}.strength" in group.members]
        if len(found) > 1:
            return found
    return []


@dataclass(frozen=True, kw_only=True)
class AnyLimit:
    """Several limits taken together; `factor` is the Cholesky factor of the correlation of their strengths' scores
    given all that is drawn."""

    limits: tuple[Limit, ...]
    factor: Array

    @classmethod
    def of(cls, work: Work, limits: tuple[Limit, ...]) -> AnyLimit:
        """The limits with what their strengths have in common."""
        inputs, covariance = work.all_inputs, np.eye(len(limits))
        if inputs.correlation is None:
            return cls(limits=limits, factor=covariance)
        random = [k for k, limit in enumerate(limits) if isinstance(limit.strength, Law)]
        at = [inputs.names.index(f"limits.{limits[k].name}.strength") for k in random]
        given = [inputs.names.index(name) for name in work.drawn.names]
        own, across = inputs.correlation[np.ix_(at, at)], inputs.correlation[np.ix_(given, at)]
        within = inputs.correlation[np.ix_(given, given)]
        covariance[np.ix_(random, random)] = own - across.T @ np.linalg.solve(within, across)
        return cls(limits=limits, factor=residual_correlation(covariance))

    def at(self, work: Work, sample: Sample, aim: str = "survive") -> Union:
        """The union at the rows of a sample, of limits that are exceeded, or for the aim to break, that are not."""
        # one stream wherever the union is asked for: common random numbers, where any are needed at all
        rng = random_generator(seed=work.study.seed, task="fracture.holding")
        states = [state_of(work, limit, sample) for limit in self.limits]
        return make_union(states, self.factor, rng, missed=aim == "break")

    def probability(self, work: Work, sample: Sample) -> Estimate:
        """Probability that any limit is exceeded, by the sample, or by importance sampling where it is small."""
        plain = exceedance(union_state(self.at(work, sample)))
        asked = work.study.analysis.accuracy.probability
        small = plain.value is None or plain.value < SMALL
        known = plain.value is not None and plain.value >= DOUBTFUL and plain.half_width <= asked * plain.value
        left = int(min(RARE.most, RARE.share * (work.study.analysis.budget.evaluations - work.ledger.total)))
        independent = not np.any(self.factor - np.diag(np.diag(self.factor)))
        possible = "auto" in work.study.analysis.methods and not work.all_inputs.groups and bool(work.drawn.names)
        if not small or known or left < RARE.least or not independent or not possible:
            return plain
        integrated = any(isinstance(limit.strength, Law) for limit in self.limits)
        return search_failures(work, self._function(replace(work, spare=True)), plain, integrated=integrated, most=left)

    def _function(self, work: Work) -> Callable[[Array], Array]:
        """The union as a function of normal scores: negative, or exceeded with the probability Phi(-g)."""
        d, calls = len(work.scene_names), count()
        fixed = not any(isinstance(limit.strength, Law) for limit in self.limits)

        def g(normals: Array) -> Array:
            if work.ledger.elapsed > work.seconds:
                raise OutOfBudget
            physical = work.drawn.physical(normals)
            rows = physical[:, :d] if d else physical[:1, :d]
            answered = evaluate_points(work, f"rare-events.union.{next(calls)}", work.scene_names, rows)
            # a limit state is of two replicates at least: the same one twice
            points = Sample.at(work.drawn.names, np.stack([normals] * 2), np.stack([physical] * 2))
            sample = with_answered(work, points, answered)
            states = [state_of(work, limit, sample) for limit in self.limits]
            if fixed:
                # a fixed strength over the demand is 1 at the limit, and never 0
                ratios = [
                    np.maximum(state.strength, 1e-300) / np.maximum(state.demands[0], 1e-300)
                    for state in states
                    if not isinstance(state.strength, Law)
                ]
                value = np.log(np.min(ratios, axis=0))
            else:
                together = make_union(states, self.factor, random_generator(seed=0, task="fracture.unused"))
                value = -union_state(together).demands[0]
            return np.where(~sample.failed[0], value, np.nan)

        return g

    def curve(self, work: Work, curves: Mapping[str, list[list[float]]]) -> dict[str, object]:
        """Probability of any over the free scalar of the margins, as results.json has it; empty where there is no such
        curve."""
        asked = work.study.margins
        grid = _grid([curves[limit.name] for limit in self.limits if limit.name in curves])
        if asked is None or len(grid) < 2 or len(self.limits) < 2 or not asked.axis.moves_rows:
            return {}
        evaluations = len(grid) * FRACTURE_CURVE.first * REPLICATES
        if evaluations > work.study.analysis.budget.evaluations - work.ledger.total:
            return {}
        rows, table = evaluate_along(work, dict.fromkeys(grid, (0, FRACTURE_CURVE.first))), []
        for value, sample in rows.items():
            # the same random numbers at every value
            state = union_state(self.at(replace(work, study=asked.axis.move(work.study, value)), sample))
            found = [exceedance(pick_replicates(state, [r, r])).value for r in range(REPLICATES)]
            table.append([np.nan if p is None else p for p in found])
        usable = np.isfinite(table).all(axis=1)
        if usable.sum() < 2:
            return {}
        curve = fragility(np.array(grid)[usable], np.array(table)[usable], asked.for_probability,
                          samples=FRACTURE_CURVE.first, evaluations=evaluations)  # fmt: skip
        return {"solve": asked.axis.path, "values": curve.values, "curve": [list(point) for point in curve.curve]}

    def first_loading(self, work: Work, pool: Sample, over_record: Union, union: Estimate) -> Estimate:
        """Probability of fracture before the first reflected wave is back: the union's, times what share of it that is.

        The demands of the first loading are no larger than those of the record, also where the rate differs.
        """
        study, method = work.study, "common random numbers, the record ended by the first reflected wave"
        if not reflected(study):
            return union
        if union.value is None:
            return absent(union.reason or "the union is not known", method, 0)
        count = affordable(work, pool.count)
        if count == 0:
            return absent("the budget of evaluations leaves nothing for the first loading", method, 0)
        whole = pool.head(count)
        moved = replace(work, study=replace(study, model=replace(study.model, first_loading_only=True)))
        early = evaluate_sample(moved, "fracture.first", whole)
        states = []
        for limit in self.limits:
            first, record = state_of(work, limit, early), state_of(work, limit, whole)
            demands = np.where(first.broken | record.broken, np.nan, np.minimum(first.demands, record.demands))
            states.append(replace(first, demands=demands, censored=None))
        rng = random_generator(seed=study.seed, task="fracture.holding")
        if over_record.factor.any() and count != over_record.chances.shape[2]:
            over_record = self.at(work, whole)
        p, q = make_union(states, self.factor, rng).any.mean(axis=1), over_record.any.mean(axis=1)
        if not q.sum() > 0.0:
            return replace(union, method=method)
        share = min(float(p.sum() / q.sum()), 1.0)
        spread = math.sqrt(float(np.square(p - share * q).sum()) / (REPLICATES * (REPLICATES - 1))) / float(q.mean())
        return _times(union, share, spread, method, union.evaluations + REPLICATES * count)


def affordable(work: Work, most: int) -> int:
    """Rows of each replicate that one step may take; 0 where it is not worth it."""
    left = work.study.analysis.budget.evaluations - work.ledger.total
    found = min(most, int(FRACTURE.share * left / REPLICATES))
    return found if found >= FRACTURE.least else 0


def _grid(curves: Sequence[list[list[float]]]) -> list[float]:
    """The values at which one of the curves is neither surely broken nor surely whole, and one beside on each side."""
    points = [point for curve in curves for point in curve]
    grid = sorted({float(point[0]) for point in points})
    # the limit that is reached first decides when fracture is sure
    worst = {value: max(float(p[1]) for p in points if float(p[0]) == value) for value in grid}
    open_at = [k for k, value in enumerate(grid) if NEGLIGIBLE < worst[value] < 1.0 - NEGLIGIBLE]
    grid = grid[max(open_at[0] - 1, 0) : open_at[-1] + 2] if open_at else []
    kept = np.linspace(0, len(grid) - 1, min(len(grid), FRACTURE_CURVE.most)).round().astype(int)
    return [grid[k] for k in np.unique(kept)]


def _times(union: Estimate, share: float, spread: float, method: str, evaluations: int) -> Estimate:
    """The union's estimate times a share with a standard error of its own; the interval in logarithms."""
    assert union.value is not None
    if share <= 0.0 or union.value <= 0.0 or union.low is None or union.high is None or union.std_error is None:
        top = (union.high or 0.0) * min(1.0, share + student(REPLICATES) * spread)
        return Estimate(value=union.value * share, low=0.0, high=top, std_error=union.std_error, method=method,
                        evaluations=evaluations)  # fmt: skip
    own = student(REPLICATES) * spread / share
    value = union.value * share
    below = math.hypot(math.log(union.value / union.low) if union.low > 0.0 else 600.0, own)
    above = math.hypot(math.log(union.high / union.value), own)
    return Estimate(
        value=value,
        low=value * math.exp(-min(below, 600.0)),
        high=min(value * math.exp(min(above, 600.0)), union.high),
        std_error=math.hypot(union.std_error * share, spread * union.value),
        method=method,
        evaluations=evaluations,
    )
