"""Several limits that mean fracture: the probability of any (`AnyLimit`), which comes first, and the state in which it
comes.

What needs the moment of fracture is read off the loading of a few hundred specimens, drawn with their strengths from
those that break (`uqsphere.mechanics.fracture`), by the full model.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.util import find_spec
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.model import scene_of
from uqsphere.results import CheckEntry, Est, FractureEntry, LimitsOrder
from uqsphere.runner.chunks import remembered
from uqsphere.runner.evaluate import LATE, OutOfBudget, Work, evaluate_sample
from uqsphere.runner.forecast import fracture_limits
from uqsphere.runner.questions.any_limit import AnyLimit, affordable, tied_otherwise
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.runner.questions.margins import MarginAnswer
from uqsphere.runner.schedule import FRACTURE, SPECIMENS
from uqsphere.uq import Estimate, Sample, absent, random_generator
from uqsphere.uq.union import Breaking, draw_breaking, share_of, weighted_quantile

# --- several limits together ---------------------------------------------------------------------------------------

#: orders that are listed
ORDERS: Final = 8
#: share of specimens whose loading could not be followed, above which nothing is said
MOST_LOST: Final = 0.05
_QUANTILES: Final = (0.05, 0.5, 0.95)
_UNITS: Final = {"time": "s", "force": "N", "energy": "J", "specific_energy": "J/kg", "imbalance": "", "t10": "1"}
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
        answer |= together.curve(work, {name: margin.curve for name, margin in margins.items()})
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
    if pool is None and (count := affordable(work, count)):
        pool = evaluate_sample(full, "fracture.full", sample.head(count))
    specimens = affordable(work, SPECIMENS)
    if pool is None or specimens == 0:
        return {"reason": "the budget of evaluations leaves nothing for the loading of spheres"}
    if find_spec("numba") is None:
        return {"reason": "the loading over time needs the compiled integrator (numba)"}
    over_record = together.at(full, pool)
    drawn = draw_breaking(over_record, specimens, random_generator(seed=work.study.seed, task="fracture.specimens"))
    first = (
        {"first_loading": together.first_loading(full, pool, over_record, union)} if work.study.rig == "bars" else {}
    )
    return {**first, **({"reason": "no sample breaks"} if drawn is None else _at_fracture(full, pool, together, drawn))}


# --- the moment of fracture ---------------------------------------------------------------------------


def _at_fracture(work: Work, pool: Sample, together: AnyLimit, drawn: Breaking) -> dict[str, object]:
    """Shares, order and quantiles over the specimens drawn."""
    from uqsphere.mechanics.fracture import Fractures, first_fractures
    from uqsphere.mechanics.outputs import path_of
    from uqsphere.mechanics.validity import check_at_fracture

    limits, shape = together.limits, drawn.rows.shape
    called = [limit.name for limit in limits]
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
    two = scene.contacts == 2
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
        "governed_by": dict(zip(called, governing, strict=True)),
        "order": _orders(result.times, weights, shape, called, evaluations),
        **states,
        "share_in_first_loading": share_of(result.early.reshape(shape), weights, _METHOD, evaluations),
        "specimens": evaluations,
        "distinct_rows": len(distinct),
        "lost_share": lost,
        **({"check": CheckEntry.of(check_at_fracture(result.imbalance, graded))} if two else {}),
    }


def _orders(
    times: Array, weights: Array, shape: tuple[int, ...], names: Sequence[str], evaluations: int
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
        found.append(LimitsOrder(limits=tuple(names[k] for k in order), share=share))
    return found
