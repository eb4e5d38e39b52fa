"""Several limits that mean fracture: the probability of any, which comes first, and the state in which it comes.

The union is averaged over everything that was sampled, the strengths integrated (`uqsphere.uq.union`).  What needs
the moment of fracture is read off the loading of a few hundred specimens, drawn with their strengths from those that
break (`uqsphere.mechanics.fracture`), by the full model.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.model import scene_of
from uqsphere.runner.axis_rows import axis_of, evaluate_at
from uqsphere.runner.chunks import remembered_fractures
from uqsphere.runner.evaluate import OutOfBudget, Work, evaluate_points, evaluate_sample, with_answered
from uqsphere.runner.forecast import fracture_limits, reflected
from uqsphere.runner.limits import SMALL, state_of
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.runner.questions.margins import MarginAnswer
from uqsphere.runner.questions.probabilities import DOUBTFUL, narrower
from uqsphere.runner.schedule import FRACTURE, FRACTURE_CURVE, RARE, REPLICATES, SPECIMENS
from uqsphere.study import Limit
from uqsphere.uq.curve import fragility
from uqsphere.uq.estimate import Estimate, absent, student
from uqsphere.uq.law import Law
from uqsphere.uq.limit_state import LimitState, exceedance, pick_replicates
from uqsphere.uq.points import random_generator
from uqsphere.uq.sample import Sample
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

__all__ = [
    "find_fracture",
    "strength_factor",
    "tied_otherwise",
    "union_at",
    "union_curve",
    "union_estimate",
]

# --- The union of the limits that mean fracture: its probability at what was sampled, and over the free scalar.

Array = npt.NDArray[np.float64]

#: a probability of fracture this close to 0 or 1 needs no more points of the curve
NEGLIGIBLE: Final = 1e-6


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
    small = plain.value is None or plain.value < SMALL
    known = plain.value is not None and plain.value >= DOUBTFUL and plain.half_width <= asked * plain.value
    left = int(min(RARE.most, RARE.share * (work.study.analysis.budget.evaluations - work.ledger.total)))
    independent = not np.any(factor - np.diag(np.diag(factor)))
    possible = "auto" in work.study.analysis.methods and not work.all_inputs.groups and bool(work.drawn.names)
    if not small or known or left < RARE.least or not independent or not possible:
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
        physical = work.drawn.physical(normals)
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
    if len(grid) > FRACTURE_CURVE.most:
        grid = [grid[k] for k in np.unique(np.linspace(0, len(grid) - 1, FRACTURE_CURVE.most).round().astype(int))]
    left = work.study.analysis.budget.evaluations - work.ledger.total
    if len(grid) * FRACTURE_CURVE.first * REPLICATES > left:
        return {}
    table = np.array([_at_value(work, value, limits, factor) for value in grid])
    usable = np.isfinite(table).all(axis=1)
    if usable.sum() < 2:
        return {}
    found = fragility(
        np.array(grid)[usable], table[usable], asked.for_probability, samples=FRACTURE_CURVE.first,
        evaluations=len(grid) * FRACTURE_CURVE.first * REPLICATES,
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
    sample = evaluate_at(work, value, start=0, count=FRACTURE_CURVE.first)
    state = union_state(union_at(moved, limits, factor, sample))
    found = [exceedance(pick_replicates(state, [r, r])).value for r in range(REPLICATES)]
    return np.array([np.nan if p is None else p for p in found])


#: orders that are listed
ORDERS: Final = 8
#: share of specimens whose loading could not be followed, above which nothing is said
MOST_LOST: Final = 0.05
_QUANTILES: Final = (0.05, 0.5, 0.95)
_UNITS: Final = {"time": "s", "force": "N", "energy": "J", "specific_energy": "J/kg", "imbalance": "", "t10": "1"}
_METHOD: Final = "specimens that break, on the loading path of the full model"


def find_fracture(work: Work, sampled: Sampled, margins: Mapping[str, MarginAnswer]) -> dict[str, Any] | None:
    """Plain JSON of the fracture by any limit; None where no limit of the study means fracture."""
    limits = fracture_limits(work.study)
    if not limits:
        return None
    names = [limit.name for limit in limits]
    answer: dict[str, Any] = {
        "limits": names,
        "left_out": [limit.name for limit in work.study.limits if limit.name not in names],
    }
    tied = tied_otherwise(work, names)
    if tied:
        reason = f"the strengths of {' and '.join(tied)} depend on each other by a copula that is not Gaussian"
        return {**answer, "union": absent(reason, _METHOD, 0).as_dict(), "reason": reason}
    factor = strength_factor(work, limits)
    try:
        union = union_estimate(work, sampled, limits, factor)
        answer |= {"union": union.as_dict(), "over_record": union.as_dict()}
        answer |= _moments(work, sampled, limits, factor, union)
        answer |= union_curve(work, limits, factor, margins)
    except OutOfBudget:
        work.ledger.stopped_by_time = True
        answer["reason"] = "the time was over, or the run was stopped"
    return answer


# --- the moment of fracture ---------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class _Pool:
    """Some of the sampled rows, answered by the full model."""

    sample: Sample
    work: Work


def _affordable(work: Work, most: int) -> int:
    """Rows of each replicate that one step may take; 0 where it is not worth it."""
    left = work.study.analysis.budget.evaluations - work.ledger.total
    found = min(most, int(FRACTURE.share * left / REPLICATES))
    return found if found >= FRACTURE.least else 0


def _pool(work: Work, sampled: Sampled) -> _Pool | None:
    full = replace(work, fidelity="full", fallback=None, spare=True)
    if work.fidelity == "full":
        count = min(FRACTURE.first, sampled.sample.count)
        return _Pool(sample=sampled.sample.head(count), work=full)
    count = _affordable(work, min(FRACTURE.first, sampled.sample.count))
    if count == 0:
        return None
    return _Pool(sample=evaluate_sample(full, "fracture.full", sampled.sample.head(count)), work=full)


def _moments(work: Work, sampled: Sampled, limits: Sequence[Limit], factor: Array, union: Estimate) -> dict[str, Any]:
    """What is governing, the order, and the state at fracture; a reason where nothing can be said."""
    pool = _pool(work, sampled)
    specimens = _affordable(work, SPECIMENS)
    if pool is None or specimens == 0:
        return {"reason": "the budget of evaluations leaves nothing for the loading of specimens"}
    if find_spec("numba") is None:
        return {"reason": "the loading over time needs the compiled integrator (numba)"}
    together = union_at(pool.work, limits, factor, pool.sample)
    rng = random_generator(seed=work.study.seed, task="fracture.specimens")
    drawn = draw_breaking(together, specimens, rng)
    found: dict[str, Any] = {"first_loading": _first_loading(pool, sampled, limits, factor, union, together).as_dict()}
    if drawn is None:
        return {**found, "reason": "no sample breaks"}
    return {**found, **_at_fracture(pool, limits, drawn)}


def _at_fracture(pool: _Pool, limits: Sequence[Limit], drawn: Breaking) -> dict[str, Any]:
    """Shares, order and quantiles over the specimens drawn."""
    from uqsphere.mechanics.fracture import first_fractures
    from uqsphere.mechanics.outputs import path_of
    from uqsphere.mechanics.validity import check_at_fracture

    work, shape = pool.work, drawn.rows.shape
    flat = (np.arange(shape[0])[:, None] * pool.sample.count + drawn.rows).ravel()
    distinct, rows = np.unique(flat, return_inverse=True)
    names, d = work.scene_names, len(work.scene_names)
    if d == 0:
        distinct, rows = distinct[:1], np.zeros_like(rows)
    physical = pool.sample.inputs[:, :, :d].reshape(-1, d)[distinct]
    scene = scene_of(work.study, {name: physical[:, k] for k, name in enumerate(names)}, len(distinct))
    paths = [path for limit in limits if (path := path_of(limit.quantity, work.study.demands)) is not None]
    shares = drawn.shares.reshape(len(limits), -1).T
    result = remembered_fractures(
        work.store, "fracture.loading", scene, [limit.quantity for limit in limits], [shares, rows],
        lambda: first_fractures(scene, shares, paths, rows=rows, threads=work.threads),
    )  # fmt: skip
    work.ledger.evaluations["full"] = work.ledger.evaluations.get("full", 0) + len(distinct)
    lost = float((result.first < 0).mean())
    if lost > MOST_LOST:
        return {"reason": f"the loading of {100.0 * lost:.0f} % of the specimens could not be followed"}
    weights, evaluations = drawn.weights, int(flat.size)
    known = {
        "time": result.time,
        "force": result.force,
        "energy": result.energy,
        "specific_energy": result.energy / scene.scales.mass[rows],
        "imbalance": result.imbalance,
    }
    first = result.first.reshape(shape)
    if "t10" in work.quantities:
        # of the energy of the whole record: what a sphere takes that has broken is not followed
        answers = pool.sample.answer("t10")
        known["t10"] = np.take_along_axis(answers, drawn.rows, axis=1).ravel()
    state = {
        name: {"unit": _UNITS[name], **_quantiles(values.reshape(shape), weights, evaluations)}
        for name, values in known.items()
    }
    early = share_of(result.early.reshape(shape), weights, _METHOD, evaluations)
    graded = np.repeat(weights, shape[1]) * (result.first >= 0)
    return {
        "governed_by": {
            limit.name: share_of(first == k, weights, _METHOD, evaluations).as_dict() for k, limit in enumerate(limits)
        },
        "order": _orders(result.times, weights, shape, limits, evaluations),
        **state,
        "share_in_first_loading": early.as_dict(),
        "specimens": evaluations,
        "distinct_rows": len(distinct),
        "lost_share": lost,
        "check": _check_json(check_at_fracture(result.imbalance, graded)),
    }


def _check_json(check: Any) -> dict[str, Any]:
    return {
        "check": check.check,
        "share": check.share_warning + check.share_failure,
        "share_information": check.share_information,
        "share_warning": check.share_warning,
        "share_failure": check.share_failure,
        "worst": check.worst,
        "text": check.text,
    }


def _quantiles(values: Array, weights: Array, evaluations: int) -> dict[str, Any]:
    found = {f"{p:g}": weighted_quantile(values, weights, p, _METHOD, evaluations).as_dict() for p in _QUANTILES}
    return {"median": found["0.5"], "quantiles": found}


def _orders(
    times: Array, weights: Array, shape: tuple[int, ...], limits: Sequence[Limit], evaluations: int
) -> list[dict[str, Any]]:
    """The commonest orders in which the strengths are reached, were the sphere to hold; unreached ones left out."""
    ranked = np.argsort(times, axis=1, kind="stable")
    reached = np.isfinite(times).sum(axis=1)
    orders = [tuple(row[:count].tolist()) for row, count in zip(ranked, reached, strict=True)]
    mass: defaultdict[tuple[int, ...], float] = defaultdict(float)
    for order, weight in zip(orders, np.repeat(weights, shape[1]), strict=True):
        mass[order] += float(weight)
    listed = [order for order, _ in sorted(mass.items(), key=lambda item: (-item[1], item[0])) if order][:ORDERS]
    return [
        {
            "limits": [limits[k].name for k in order],
            "share": share_of(
                np.array([other == order for other in orders]).reshape(shape), weights, _METHOD, evaluations
            ).as_dict(),
        }
        for order in listed
    ]


# --- first loading ------------------------------------------------------------------------------------


def _first_loading(
    pool: _Pool, sampled: Sampled, limits: Sequence[Limit], factor: Array, union: Estimate, over_record: Union
) -> Estimate:
    """Probability of fracture before the first reflected wave is back: the union's, times what share of it that is.

    The demands of the first loading are no larger than those of the record, also where the rate differs.
    """
    work = pool.work
    study = work.study
    if not reflected(study):
        return union
    method = "common random numbers, the record ended by the first reflected wave"
    if union.value is None:
        return absent(union.reason or "the union is not known", method, 0)
    count = _affordable(work, pool.sample.count)
    if count == 0:
        return absent("the budget of evaluations leaves nothing for the first loading", method, 0)
    whole = pool.sample.head(count)
    moved = replace(work, study=replace(study, model=replace(study.model, first_loading_only=True)))
    early = evaluate_sample(moved, "fracture.first", whole)
    states = [_no_larger(state_of(work, limit, early), state_of(work, limit, whole))
              for limit in limits]  # fmt: skip
    rng = random_generator(seed=study.seed, task="fracture.holding")
    if over_record.factor.any() and count != over_record.chances.shape[2]:
        over_record = union_at(work, limits, factor, whole)
    p, q = make_union(states, factor, rng).any.mean(axis=1), over_record.any.mean(axis=1)
    if not q.sum() > 0.0:
        return replace(union, method=method)
    share = min(float(p.sum() / q.sum()), 1.0)
    spread = math.sqrt(float(np.square(p - share * q).sum()) / (REPLICATES * (REPLICATES - 1))) / float(q.mean())
    return _times(union, share, spread, method, union.evaluations + REPLICATES * count)


def _no_larger(early: LimitState, whole: LimitState) -> LimitState:
    return replace(
        early,
        demands=np.where(early.broken | whole.broken, np.nan, np.minimum(early.demands, whole.demands)),
        censored=None,
    )


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
