"""Strengths carried from their tests to a service by force, by energy and by centre tension: what each would answer.

Each carrier is the same study with other demands (`uqsphere.mechanics.carried`): the sampled points are evaluated once
with all of them, and so are the rows of the curves, which follow the same points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

from uqsphere.mechanics import contact
from uqsphere.mechanics.carried import CARRIERS, carried_parameters
from uqsphere.model import scene_of
from uqsphere.results.entries import CarriedEntry, CheckEntry
from uqsphere.runner.evaluate import OutOfBudget, Work, evaluate_sample
from uqsphere.runner.limits import LimitAnswer, judge_limits
from uqsphere.runner.questions.curves import CurveFound, curves_along
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.runner.questions.margins import decisive
from uqsphere.runner.schedule import CARRIED
from uqsphere.study import Limit, Study
from uqsphere.uq.estimate import Estimate, absent

#: share of the budget for the curves of one carrier: with the sample and the margins less than half of it
CURVES: Final = 0.05
#: ratio of the contact moduli of test and service that is told, and that is warned of (rigs.md section 8)
TOLD, FAR = 1.1, 1.5


def find_carried(work: Work, sampled: Sampled) -> dict[str, CarriedEntry]:
    """What every limit whose strength was measured elsewhere answers by each carrier."""
    limits = [limit for limit in work.study.limits if limit.platens is not None]
    if not limits:
        return {}
    demands = {carrier: [_carried(limit, carrier) for limit in limits] for carrier in CARRIERS}
    everything = tuple(limit for carried in demands.values() for limit in carried)
    analysis = replace(work.study.analysis, quantities=tuple(limit.quantity for limit in everything))
    asked = replace(work, study=replace(work.study, limits=everything, analysis=analysis))
    budget = analysis.budget.evaluations
    room = min(CARRIED.share * budget, budget - work.ledger.total) / sampled.sample.replicates
    if room < 1.0:
        return {}
    points = sampled.sample.head(min(CARRIED.first, int(room)))
    try:
        sample = evaluate_sample(asked, "carried", points)
    except OutOfBudget:
        return {}
    answers = {
        carrier: judge_limits(asked, sample, [limit.quantity for limit in carried])
        for carrier, carried in demands.items()
    }
    curves = {carrier: _curves(asked, carried, carrier) for carrier, carried in demands.items()}
    return {limit.name: _entry(work, limit, answers, curves) for limit in limits}


def carried_far(study: Study) -> list[CheckEntry]:
    """How much stiffer or softer the contact of the test was than those of the service, at the means.

    The ratio of E* is told above 1.1 and warned of above 1.5 (rigs.md section 8); sizes are compared where the tests
    are read.
    """
    tests = {limit.name: limit.platens for limit in study.limits if limit.platens is not None}
    if not tests:
        return []
    scene = scene_of(study, {})
    here = [float(one.modulus[0]) for one in scene.partners if one is not None]
    E, nu = (float(scene.columns[f"sphere.{key}"][0]) for key in ("E", "nu"))
    ratios = {
        name: max(max(there / own, own / there) for own in here)
        for name, platens in tests.items()
        for there in (float(contact.reduced_modulus(E, nu, *platens)),)
    }
    worst = max(ratios, key=lambda name: ratios[name])
    far, told = (ratios[worst] > bound for bound in (FAR, TOLD))
    text = (
        f"the strength of {worst} was measured on a contact whose E* differs by a factor of {ratios[worst]:.3g} "
        f"(told from {TOLD:g}, warned of from {FAR:g}); so do the carriers"
    )
    return [
        CheckEntry(
            check="carried_far", share=float(far), share_information=float(told and not far),
            share_warning=float(far), share_failure=0.0, worst=ratios[worst], text=text,
        )
    ]  # fmt: skip


def _carried(limit: Limit, carrier: str) -> Limit:
    """The limit with its demand in the test, where it was measured."""
    assert limit.platens is not None
    base = limit.criterion or limit.quantity
    parameters = {**limit.parameters, **carried_parameters(carrier, limit.platens)}
    return replace(limit, quantity=f"{base}.{limit.name}@{carrier}", criterion=base, parameters=parameters)


def _curves(work: Work, limits: Sequence[Limit], carrier: str) -> dict[str, CurveFound | str]:
    """The curve of each limit along the free scalar; empty where nothing is solved for."""
    margins = work.study.margins
    if margins is None or not margins.axis.moves_rows:
        return {}
    most = int(CURVES * work.study.analysis.budget.evaluations)
    try:
        return curves_along(work, limits, most=most, tag=f"-carried-{carrier}", called=f" by {carrier}")
    except OutOfBudget:
        return {}


def _entry(
    work: Work,
    limit: Limit,
    answers: Mapping[str, Mapping[str, LimitAnswer]],
    curves: Mapping[str, Mapping[str, CurveFound | str]],
) -> CarriedEntry:
    """The entry of results.json: the free number where one is solved for, else the probability of missing the aim."""
    margins = work.study.margins
    miss = {carrier: answers[carrier][limit.name].miss for carrier in CARRIERS}
    told, values = miss, dict[str, Mapping[float, Estimate]]()
    solved = margins is not None and all(limit.name in curves[carrier] for carrier in CARRIERS)
    if solved:
        p, told = decisive(work, limit), {}
        for carrier in CARRIERS:
            found = curves[carrier][limit.name]
            if isinstance(found, str):
                told[carrier] = absent(found, "none", 0)
                continue
            told[carrier] = found.value_at(p)
            values[carrier] = found.values
    known = {carrier: one.value for carrier, one in told.items() if one.value is not None}
    return CarriedEntry.model_validate({
        "solve": margins.axis.path if solved and margins is not None else "",
        **told,
        "lowest": min(known, key=lambda carrier: known[carrier], default=""),
        "highest": max(known, key=lambda carrier: known[carrier], default=""),
        "miss": miss,
        "met": {carrier: answers[carrier][limit.name].met for carrier in CARRIERS},
        **({"values": values} if values else {}),
    })  # fmt: skip
