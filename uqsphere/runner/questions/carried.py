"""Strengths carried from their tests to a service by force, by energy and by centre tension: what each would answer.

Each carrier is the same study with other demands (`uqsphere.mechanics.criteria`): the sampled points are evaluated once
with all of them, and so are the rows of the curves, which follow the same points.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

from uqsphere.mechanics import contact
from uqsphere.mechanics.criteria import CARRIERS, carried_parameters
from uqsphere.mechanics.outputs import absent_in
from uqsphere.mechanics.scene import Scene
from uqsphere.model import scene_of, solve_scene
from uqsphere.results.entries import CarriedEntry, CheckEntry
from uqsphere.runner.evaluate import OutOfBudget, Work, evaluate_sample
from uqsphere.runner.limits import LimitAnswer, judge_limits
from uqsphere.runner.questions.curves import CurveFound, curves_along
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.runner.questions.margins import decisive
from uqsphere.runner.schedule import CARRIED, CARRIED_CURVE
from uqsphere.study import Limit, Study
from uqsphere.uq import Estimate, absent

#: what test and service are compared by -> the ratios that are told and warned of (theory section 9), and words
FAR: Final = {
    "carried_far": (1.1, 1.5, "the E* of the contacts in test and service differ",
                    "what each carrier makes of the strength differs by that"),
    "carried_size": (1.1, 1.5, "the spheres of test and service differ in size", "small spheres are stronger"),
    "carried_rate": (2.0, 1e3, "the rates of loading in test and service differ",
                     "struck, rocks bore more, by rate_0 of the criterion"),
}  # fmt: skip


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


def _curves(work: Work, limits: Sequence[Limit], carrier: str) -> dict[str, CurveFound | str]:
    """The curve of each limit along the free scalar; empty where nothing is solved for."""
    found: dict[str, CurveFound | str] = {}
    if work.study.margins is not None and work.study.margins.axis.moves_rows:
        most = int(CARRIED_CURVE.share * work.study.analysis.budget.evaluations)
        with contextlib.suppress(OutOfBudget):
            found = curves_along(work, limits, most=most, tag=f"-carried-{carrier}", called=f" by {carrier}")
    return found


def _carried(limit: Limit, carrier: str) -> Limit:
    """The limit with its demand in the test, where it was measured."""
    assert limit.platens is not None
    base = limit.criterion or limit.quantity
    parameters = {**limit.parameters, **carried_parameters(carrier, limit.platens)}
    return replace(limit, quantity=f"{base}.{limit.name}@{carrier}", criterion=base, parameters=parameters)


def carried_far(study: Study) -> list[CheckEntry]:
    """How far apart tests and service are at the means: in the E* of the contact, the size, and the rate of loading.

    Told and warned of from the bounds of `FAR` on; the rate is that of the force over the force, and left out where the
    law of the strength has the rate in it.
    """
    limits = [limit for limit in study.limits if limit.platens is not None]
    if not limits:
        return []
    scene = scene_of(study, {})
    ratios = {limit.name: _ratios(study, scene, limit) for limit in limits}
    checks = {check: {name: found[check] for name, found in ratios.items() if check in found} for check in FAR}
    return [_far(check, found) for check, found in checks.items() if found]


def _ratios(study: Study, scene: Scene, limit: Limit) -> dict[str, float]:
    """By how much the test of a limit and its service are apart, by check."""
    assert limit.platens is not None
    E, nu, radius = (float(scene.columns[f"sphere.{key}"][0]) for key in ("E", "nu", "radius"))
    there, tested = float(contact.reduced_modulus(E, nu, *limit.platens)), limit.tested
    found = {"carried_far": max(_apart(there, float(one.modulus[0])) for one in scene.there)}
    if tested is None:
        return found
    found["carried_size"] = _apart(tested.diameter / (2.0 * radius), 1.0)
    if tested.growth is not None and "rate_0" not in limit.parameters and (rate := _growth(study, scene)) is not None:
        found["carried_rate"] = _apart(rate, tested.growth)
    return found


def _apart(one: float, other: float) -> float:
    return max(one / other, other / one)


def _far(check: str, ratios: Mapping[str, float]) -> CheckEntry:
    told, far, apart, follows = FAR[check]
    worst = max(ratios, key=ratios.__getitem__)
    ratio, warned = ratios[worst], float(ratios[worst] > far)
    text = f"{apart} by a factor of {ratio:.3g} for {worst} (told from {told:g}, warned of from {far:g}); {follows}"
    return CheckEntry(check=check, share=warned, share_information=float(told < ratio <= far), share_warning=warned,
                      share_failure=0.0, worst=ratio, text=text)  # fmt: skip


def _growth(study: Study, scene: Scene) -> float | None:
    """Growth of the force in the service over its largest [1/s], at the means; None where it is not known."""
    if absent_in(scene, "loading_rate"):
        return None
    asked = ("loading_rate", "P_max")
    found = solve_scene(scene, "full", tolerance=study.model.tolerance, threads=1, quantities=asked).values
    growth = float(found["loading_rate"][0] / found["P_max"][0])
    return growth if growth > 0.0 else None


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
