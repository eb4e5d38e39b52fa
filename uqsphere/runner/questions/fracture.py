"""Several limits that mean fracture: the probability of any, which comes first, and the state in which it comes.

The union is averaged over everything that was sampled, the strengths integrated (`uqsphere.uq.union`).  What needs
the moment of fracture is read off the loading of a few hundred specimens, drawn with their strengths from those that
break (`uqsphere.mechanics.fracture`), by the full model.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.util import find_spec
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.mechanics.rigs import RIGS
from uqsphere.model import scene_of
from uqsphere.results import FractureEntry, LimitsOrder
from uqsphere.results.entries import CheckEntry, Est
from uqsphere.runner.chunks import remembered
from uqsphere.runner.evaluate import OutOfBudget, Work, evaluate_sample
from uqsphere.runner.forecast import fracture_limits, reflected
from uqsphere.runner.limits import state_of
from uqsphere.runner.questions.any_limit import AnyLimit, tied_otherwise
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.runner.questions.margins import MarginAnswer
from uqsphere.runner.schedule import FRACTURE, REPLICATES, SPECIMENS
from uqsphere.study import Limit
from uqsphere.uq.estimate import Estimate, absent, student
from uqsphere.uq.points import random_generator
from uqsphere.uq.sample import Sample
from uqsphere.uq.union import Breaking, Union, draw_breaking, make_union, share_of, weighted_quantile

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
    physical = pool.inputs[:, :, :d].reshape(-1, d)[distinct]
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
