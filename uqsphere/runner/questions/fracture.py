"""Several limits that mean fracture: the probability of any, which comes first, and the state in which it comes.

The union is averaged over everything that was sampled, the strengths integrated (`uqsphere.uq.union`).  What needs
the moment of fracture is read off the loading of a few hundred specimens, drawn with their strengths from those that
break (`uqsphere.mechanics.fracture`), by the full model.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.mechanics.rigs import RIGS
from uqsphere.model import scene_of
from uqsphere.results import FractureEntry, LimitsOrder, SpeedRow, StateEntry
from uqsphere.results.entries import Est
from uqsphere.runner.campaign import Accuracy, campaign
from uqsphere.runner.chunks import remembered_fractures
from uqsphere.runner.evaluate import Work, evaluate_sample
from uqsphere.runner.fidelity import check_entry
from uqsphere.runner.forecast import fracture_limits, reflected
from uqsphere.runner.limits import state_of
from uqsphere.runner.questions.any_limit import AnyLimit, tied_otherwise
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.runner.questions.margins import MarginAnswer
from uqsphere.runner.schedule import FRACTURE, REPLICATES, SPECIMENS
from uqsphere.study import Limit
from uqsphere.uq.estimate import Estimate, absent, student
from uqsphere.uq.limit_state import LimitState
from uqsphere.uq.points import random_generator
from uqsphere.uq.sample import Sample
from uqsphere.uq.union import Breaking, Union, draw_breaking, make_union, share_of, weighted_quantile

#: orders that are listed
ORDERS: Final = 8
#: share of specimens whose loading could not be followed, above which nothing is said
MOST_LOST: Final = 0.05
_QUANTILES: Final = (0.05, 0.5, 0.95)
_UNITS: Final = {"time": "s", "force": "N", "energy": "J", "specific_energy": "J/kg", "imbalance": "", "t10": "1"}
_METHOD: Final = "spheres that break, on the loading path of the full model"


@dataclass(kw_only=True)
class Fracture:
    """Fracture by any of several limits, in three stages: how likely, when and in what state, along the free scalar
    (a `Question`)."""

    work: Work
    sampled: Sampled
    margins: Mapping[str, MarginAnswer]
    limits: tuple[Limit, ...]
    together: AnyLimit
    answer: dict[str, object] = field(default_factory=dict)
    union: Estimate | None = None
    done: int = 0
    size: int = 0
    judged: int = 0

    def advance(self, room: float) -> bool:
        """The next stage."""
        if self.done == len(_STAGES):
            return False
        _STAGES[self.done](self)
        self.done += 1
        return True

    def lacking(self) -> dict[Accuracy, float]:
        """The stages that are left."""
        return {Accuracy("fracture", stage.__name__.strip("_")): math.inf for stage in _STAGES[self.done :]}

    def errors(self) -> list[SpeedRow]:
        """None: what is found has the error that it comes out with."""
        return []

    def _probability(self) -> None:
        """The probability of any; one limit's own where there is but one."""
        if len(self.limits) == 1:
            union = self.sampled.limits[self.limits[0].name].exceedance
        else:
            union = self.together.probability(self.work, self.sampled.sample)
        self.union = union
        self.answer |= {"union": union, "over_record": union}

    def _moments(self) -> None:
        """What is governing, the order, and the state at fracture; a reason where nothing can be said."""
        work, pool = self.work, self._pool()
        specimens = _affordable(work, SPECIMENS)
        if pool is None or specimens == 0:
            self.answer["reason"] = "the budget of evaluations leaves nothing for the loading of spheres"
            return
        if find_spec("numba") is None:
            self.answer["reason"] = "the loading over time needs the compiled integrator (numba)"
            return
        full = replace(work, fidelity="full", fallback=None, spare=True)
        over_record = self.together.at(full, pool)
        drawn = draw_breaking(over_record, specimens, random_generator(seed=work.study.seed, task="fracture.specimens"))
        if work.study.rig == "bars":
            self.answer["first_loading"] = self._first_loading(full, pool, over_record)
        self.answer |= {"reason": "no sample breaks"} if drawn is None else _at_fracture(full, pool, self.limits, drawn)

    def _pool(self) -> Sample | None:
        """Some of the sampled rows, answered by the full model."""
        work, sample = self.work, self.sampled.sample
        count = min(FRACTURE.first, sample.count)
        if work.fidelity == "full":
            return sample.head(count)
        count = _affordable(work, count)
        full = replace(work, fidelity="full", fallback=None, spare=True)
        return evaluate_sample(full, "fracture.full", sample.head(count)) if count else None

    def _first_loading(self, work: Work, pool: Sample, over_record: Union) -> Estimate:
        """Probability of fracture before the first reflected wave is back: the union's, times what share of it that is.

        The demands of the first loading are no larger than those of the record, also where the rate differs.
        """
        study, union = work.study, self.union
        assert union is not None
        if not reflected(study):
            return union
        method = "common random numbers, the record ended by the first reflected wave"
        if union.value is None:
            return absent(union.reason or "the union is not known", method, 0)
        count = _affordable(work, pool.count)
        if count == 0:
            return absent("the budget of evaluations leaves nothing for the first loading", method, 0)
        whole = pool.head(count)
        moved = replace(work, study=replace(study, model=replace(study.model, first_loading_only=True)))
        early = evaluate_sample(moved, "fracture.first", whole)
        states = [_no_larger(state_of(work, one, early), state_of(work, one, whole)) for one in self.limits]
        rng = random_generator(seed=study.seed, task="fracture.holding")
        if over_record.factor.any() and count != over_record.chances.shape[2]:
            over_record = self.together.at(work, whole)
        p, q = make_union(states, self.together.factor, rng).any.mean(axis=1), over_record.any.mean(axis=1)
        if not q.sum() > 0.0:
            return replace(union, method=method)
        share = min(float(p.sum() / q.sum()), 1.0)
        spread = math.sqrt(float(np.square(p - share * q).sum()) / (REPLICATES * (REPLICATES - 1))) / float(q.mean())
        return _times(union, share, spread, method, union.evaluations + REPLICATES * count)

    def _curve(self) -> None:
        """The probability of any over the free scalar of the margins."""
        found, margins = self.together.curve(self.work, self.margins), self.work.study.margins
        if found is not None and margins is not None:
            self.answer |= {
                "solve": margins.axis.path,
                "values": found.values,
                "curve": [list(point) for point in found.curve],
            }


_STAGES: Final[tuple[Callable[[Fracture], None], ...]] = (Fracture._probability, Fracture._moments, Fracture._curve)


def find_fracture(work: Work, sampled: Sampled, margins: Mapping[str, MarginAnswer]) -> FractureEntry | None:
    """Fracture by any limit; None where no limit of the study means fracture."""
    limits = fracture_limits(work.study)
    if not limits:
        return None
    names = [limit.name for limit in limits]
    left_out = [limit.name for limit in work.study.limits if limit.name not in names]
    answer: dict[str, object] = {"limits": names, "left_out": left_out}
    if tied := tied_otherwise(work, names):
        reason = f"the strengths of {' and '.join(tied)} depend on each other by a copula that is not Gaussian"
        return FractureEntry.model_validate({**answer, "union": absent(reason, _METHOD, 0), "reason": reason})
    question = Fracture(
        work=work, sampled=sampled, margins=margins, limits=limits, together=AnyLimit.of(work, limits), answer=answer
    )
    if campaign(work, question).stopped == "time" and question.done < len(_STAGES):
        work.ledger.stopped_by_time = True
        question.answer["reason"] = "the time was over, or the run was stopped"
    return FractureEntry.model_validate(question.answer)


def _affordable(work: Work, most: int) -> int:
    """Rows of each replicate that one step may take; 0 where it is not worth it."""
    left = work.study.analysis.budget.evaluations - work.ledger.total
    found = min(most, int(FRACTURE.share * left / REPLICATES))
    return found if found >= FRACTURE.least else 0


# --- the moment of fracture ---------------------------------------------------------------------------


def _at_fracture(work: Work, pool: Sample, limits: Sequence[Limit], drawn: Breaking) -> dict[str, object]:
    """Shares, order and quantiles over the specimens drawn."""
    from uqsphere.mechanics.fracture import first_fractures
    from uqsphere.mechanics.outputs import path_of
    from uqsphere.mechanics.validity import check_at_fracture

    shape = drawn.rows.shape
    flat = (np.arange(shape[0])[:, None] * pool.count + drawn.rows).ravel()
    distinct, rows = np.unique(flat, return_inverse=True)
    names, d = work.scene_names, len(work.scene_names)
    if d == 0:
        distinct, rows = distinct[:1], np.zeros_like(rows)
    physical = pool.inputs[:, :, :d].reshape(-1, d)[distinct]
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
    governing = [share_of(first == k, weights, _METHOD, evaluations) for k in range(len(limits))]
    return {
        "governed_by": dict(zip((limit.name for limit in limits), governing, strict=True)),
        "order": _orders(result.times, weights, shape, limits, evaluations),
        **{name: _state(name, values.reshape(shape), weights, evaluations) for name, values in known.items()},
        "share_in_first_loading": share_of(result.early.reshape(shape), weights, _METHOD, evaluations),
        "specimens": evaluations,
        "distinct_rows": len(distinct),
        "lost_share": lost,
        **({"check": check_entry(check_at_fracture(result.imbalance, graded))} if two else {}),
    }


def _state(name: str, values: Array, weights: Array, evaluations: int) -> StateEntry:
    found = {p: weighted_quantile(values, weights, p, _METHOD, evaluations) for p in _QUANTILES}
    return StateEntry.model_validate({"unit": _UNITS[name], "median": found[0.5], "quantiles": found})


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
    return [
        LimitsOrder(
            limits=tuple(limits[k].name for k in order),
            share=Est.model_validate(
                share_of(np.array([other == order for other in orders]).reshape(shape), weights, _METHOD, evaluations)
            ),
        )
        for order in listed
    ]


# --- first loading ------------------------------------------------------------------------------------


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
