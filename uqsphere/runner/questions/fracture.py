"""Several limits that mean fracture: the probability of any, which comes first, and the state in which it comes.

The union is averaged over everything that was sampled, the strengths integrated (`uqsphere.uq.union`).  What needs
the moment of fracture is read off the loading of a few hundred specimens, drawn with their strengths from those that
break (`uqsphere.mechanics.fracture`), by the full model.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from itertools import count
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.mechanics.rigs import RIGS
from uqsphere.model import scene_of
from uqsphere.results import CheckEntry, Est, FractureEntry, LimitsOrder
from uqsphere.runner.axis_rows import evaluate_along
from uqsphere.runner.chunks import remembered
from uqsphere.runner.evaluate import OutOfBudget, Work, evaluate_points, evaluate_sample, with_answered
from uqsphere.runner.forecast import fracture_limits, reflected
from uqsphere.runner.limits import SMALL, state_of
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.runner.questions.margins import MarginAnswer
from uqsphere.runner.questions.probabilities import DOUBTFUL, search_failures
from uqsphere.runner.schedule import FRACTURE, FRACTURE_CURVE, RARE, REPLICATES, SPECIMENS
from uqsphere.study import Limit
from uqsphere.uq import Estimate, Law, Sample, absent, random_generator, student
from uqsphere.uq.curve import fragility
from uqsphere.uq.limit_state import exceedance, pick_replicates
from uqsphere.uq.union import (
    Breaking,
    Union,
    draw_breaking,
    make_union,
    residual_correlation,
    share_of,
    union_state,
    weighted_quantile,
)

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

    def curve(self, work: Work, margins: Mapping[str, MarginAnswer]) -> dict[str, object]:
        """Probability of any over the free scalar of the margins, as results.json has it; empty where there is no such
        curve."""
        asked = work.study.margins
        grid = _grid([margins[limit.name].curve for limit in self.limits if limit.name in margins])
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


# --- several limits together ---------------------------------------------------------------------------------------

#: orders that are listed
ORDERS: Final = 8
#: share of specimens whose loading could not be followed, above which nothing is said
MOST_LOST: Final = 0.05
_QUANTILES: Final = (0.05, 0.5, 0.95)
_UNITS: Final = {"time": "s", "force": "N", "energy": "J", "specific_energy": "J/kg", "imbalance": "", "t10": "1"}
LATE: Final = "the time was over, or the run was stopped"
_METHOD: Final = "spheres that break, on the loading path of the full model"


def find_fracture(work: Work, sampled: Sampled, margins: Mapping[str, MarginAnswer]) -> FractureEntry | None:
    """Fracture by any limit: how likely, when and in what state, along the free scalar of the margins; None where no
    limit of the study means fracture."""
    limits = fracture_limits(work.study)
    if not limits:
        return None
    names = [limit.name for limit in limits]
    left_out = [limit.name for limit in work.study.limits if limit.name not in names]
    answer: dict[str, object] = {"limits": names, "left_out": left_out, "union": absent(LATE, _METHOD, 0)}
    if tied := tied_otherwise(work, names):
        reason = f"the strengths of {' and '.join(tied)} depend on each other by a copula that is not Gaussian"
        return FractureEntry.model_validate({**answer, "union": absent(reason, _METHOD, 0), "reason": reason})
    together = AnyLimit.of(work, limits)
    try:
        union = sampled.limits[names[0]].exceedance if len(names) == 1 else together.probability(work, sampled.sample)
        answer |= {"union": union, "over_record": union}
        _in_time(work)
        answer |= _moments(work, sampled.sample, together, union)
        _in_time(work)
        answer |= together.curve(work, margins)
    except OutOfBudget:
        work.ledger.stopped_by_time = True
        answer["reason"] = LATE
    return FractureEntry.model_validate(answer)


def _in_time(work: Work) -> None:
    if work.out_of_time:
        raise OutOfBudget


def _moments(work: Work, sample: Sample, together: AnyLimit, union: Estimate) -> dict[str, object]:
    """What is governing, the order, and the state at fracture; a reason where nothing can be said."""
    full = replace(work, fidelity="full", fallback=None, spare=True)
    count = min(FRACTURE.first, sample.count)
    pool = sample.head(count) if work.fidelity == "full" else None
    if pool is None and (count := _affordable(work, count)):
        pool = evaluate_sample(full, "fracture.full", sample.head(count))
    specimens = _affordable(work, SPECIMENS)
    if pool is None or specimens == 0:
        return {"reason": "the budget of evaluations leaves nothing for the loading of spheres"}
    if find_spec("numba") is None:
        return {"reason": "the loading over time needs the compiled integrator (numba)"}
    over_record = together.at(full, pool)
    drawn = draw_breaking(over_record, specimens, random_generator(seed=work.study.seed, task="fracture.specimens"))
    first = (
        {"first_loading": _first_loading(full, pool, together, over_record, union)} if work.study.rig == "bars" else {}
    )
    return {**first, **({"reason": "no sample breaks"} if drawn is None else _at_fracture(full, pool, together, drawn))}


def _first_loading(work: Work, pool: Sample, together: AnyLimit, over_record: Union, union: Estimate) -> Estimate:
    """Probability of fracture before the first reflected wave is back: the union's, times what share of it that is.

    The demands of the first loading are no larger than those of the record, also where the rate differs.
    """
    study, method = work.study, "common random numbers, the record ended by the first reflected wave"
    if not reflected(study):
        return union
    if union.value is None:
        return absent(union.reason or "the union is not known", method, 0)
    count = _affordable(work, pool.count)
    if count == 0:
        return absent("the budget of evaluations leaves nothing for the first loading", method, 0)
    whole = pool.head(count)
    moved = replace(work, study=replace(study, model=replace(study.model, first_loading_only=True)))
    early = evaluate_sample(moved, "fracture.first", whole)
    states = []
    for limit in together.limits:
        first, record = state_of(work, limit, early), state_of(work, limit, whole)
        demands = np.where(first.broken | record.broken, np.nan, np.minimum(first.demands, record.demands))
        states.append(replace(first, demands=demands, censored=None))
    rng = random_generator(seed=study.seed, task="fracture.holding")
    if over_record.factor.any() and count != over_record.chances.shape[2]:
        over_record = together.at(work, whole)
    p, q = make_union(states, together.factor, rng).any.mean(axis=1), over_record.any.mean(axis=1)
    if not q.sum() > 0.0:
        return replace(union, method=method)
    share = min(float(p.sum() / q.sum()), 1.0)
    spread = math.sqrt(float(np.square(p - share * q).sum()) / (REPLICATES * (REPLICATES - 1))) / float(q.mean())
    return _times(union, share, spread, method, union.evaluations + REPLICATES * count)


def _affordable(work: Work, most: int) -> int:
    """Rows of each replicate that one step may take; 0 where it is not worth it."""
    left = work.study.analysis.budget.evaluations - work.ledger.total
    found = min(most, int(FRACTURE.share * left / REPLICATES))
    return found if found >= FRACTURE.least else 0


# --- the moment of fracture ---------------------------------------------------------------------------


def _at_fracture(work: Work, pool: Sample, together: AnyLimit, drawn: Breaking) -> dict[str, object]:
    """Shares, order and quantiles over the specimens drawn."""
    from uqsphere.mechanics.fracture import Fractures, first_fractures
    from uqsphere.mechanics.outputs import path_of
    from uqsphere.mechanics.validity import check_at_fracture

    limits, shape = together.limits, drawn.rows.shape
    flat = (np.arange(shape[0])[:, None] * pool.count + drawn.rows).ravel()
    distinct, rows = np.unique(flat, return_inverse=True)
    names, d = work.scene_names, len(work.scene_names)
    if d == 0:
        distinct, rows = distinct[:1], np.zeros_like(rows)
    physical = pool.inputs[:, :, :d].reshape(pool.size, d)[distinct]
    scene = scene_of(work.study, {name: physical[:, k] for k, name in enumerate(names)}, len(distinct))
    paths = [path for limit in limits if (path := path_of(limit.quantity, work.study.demands)) is not None]
    shares = drawn.shares.reshape(len(limits), -1).T
    result = remembered(
        work.store, "fracture.loading", scene, [[limit.quantity for limit in limits], shares, rows],
        lambda: first_fractures(scene, shares, paths, rows=rows, threads=work.threads), Fractures, len(shares),
    )  # fmt: skip
    work.ledger.evaluations["full"] = work.ledger.evaluations.get("full", 0) + len(distinct)
    lost = float((result.first < 0).mean())
    if lost > MOST_LOST:
        return {"reason": f"the loading of {100.0 * lost:.0f} % of the spheres could not be followed"}
    weights, evaluations, first = drawn.weights, int(flat.size), result.first.reshape(shape)
    known = {
        "time": result.time,
        "force": result.force,
        "energy": result.energy,
        "specific_energy": result.energy / scene.scales.mass[rows],
    }
    # with one contact the other force is nothing by definition
    two = RIGS[work.study.rig].contacts == 2
    if two:
        known["imbalance"] = result.imbalance
    if "t10" in work.quantities:
        # of the energy of the whole record: what a sphere takes that has broken is not followed
        known["t10"] = np.take_along_axis(pool.answer("t10"), drawn.rows, axis=1).ravel()
    graded = np.repeat(weights, shape[1]) * (result.first >= 0)
    states = {}
    for name, column in known.items():
        quantiles = {p: weighted_quantile(column.reshape(shape), weights, p, _METHOD, evaluations) for p in _QUANTILES}
        states[name] = {"unit": _UNITS[name], "median": quantiles[0.5], "quantiles": quantiles}
    governing = [share_of(first == k, weights, _METHOD, evaluations) for k in range(len(limits))]
    return {
        "governed_by": dict(zip((limit.name for limit in limits), governing, strict=True)),
        "order": _orders(result.times, weights, shape, limits, evaluations),
        **states,
        "share_in_first_loading": share_of(result.early.reshape(shape), weights, _METHOD, evaluations),
        "specimens": evaluations,
        "distinct_rows": len(distinct),
        "lost_share": lost,
        **({"check": CheckEntry.of(check_at_fracture(result.imbalance, graded))} if two else {}),
    }


def _orders(
    times: Array, weights: Array, shape: tuple[int, ...], limits: Sequence[Limit], evaluations: int
) -> list[LimitsOrder]:
    """The commonest orders in which the strengths are reached, were the sphere to hold; unreached ones left out."""
    ranked = np.argsort(times, axis=1, kind="stable")
    reached = np.isfinite(times).sum(axis=1)
    orders = [tuple(row[:count].tolist()) for row, count in zip(ranked, reached, strict=True)]
    mass: defaultdict[tuple[int, ...], float] = defaultdict(float)
    for order, weight in zip(orders, np.repeat(weights, shape[1]), strict=True):
        mass[order] += float(weight)
    listed = [order for order, _ in sorted(mass.items(), key=lambda item: (-item[1], item[0])) if order][:ORDERS]
    found = []
    for order in listed:
        same = np.array([other == order for other in orders]).reshape(shape)
        share = Est.model_validate(share_of(same, weights, _METHOD, evaluations))
        found.append(LimitsOrder(limits=tuple(limits[k].name for k in order), share=share))
    return found


# --- first loading ------------------------------------------------------------------------------------


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
