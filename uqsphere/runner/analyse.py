"""The questions of a run, one after the other, each with what the ones before it have found."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from typing import Any, Final

from uqsphere.runner.account import Findings
from uqsphere.runner.beside import aside, may_copy
from uqsphere.runner.drivers import Drivers, find_drivers
from uqsphere.runner.evaluate import Work, draw
from uqsphere.runner.expensive import Expensive, answer_expensive, keep_answers, keep_indices, keep_margins, price
from uqsphere.runner.fidelity import Pilot, first_look
from uqsphere.runner.finished import Run
from uqsphere.runner.forecast import forecast
from uqsphere.runner.questions.carried import carried_far, find_carried
from uqsphere.runner.questions.distributions import Sampled, sample_distributions
from uqsphere.runner.questions.fracture import find_fracture
from uqsphere.runner.questions.further import (
    Analyses,
    find_analyses,
    find_tolerance,
    first_analyses,
    noise_of,
    planned_analyses,
    screened_by,
)
from uqsphere.runner.questions.margins import find_margins, judge_answers
from uqsphere.runner.questions.probabilities import refine_limits
from uqsphere.runner.questions.shapley import share_variance
from uqsphere.runner.results import finish, finish_bare, judged_ways, told_early
from uqsphere.store import Store

#: share of the budget that may be spent, with the most that margins and fracture take, for these to be answered beside
#: what shares the variance out
ROOM: Final = 0.5
_BREAKING: Final = ("margins", "carriers", "fracture")


def analyse(work: Work, store: Store, notice: Callable[[str], None] | None = None) -> Run:
    """Every analysis of a run, one after the other, and its files; what is stored already is not evaluated again."""
    if work.study.rig == "none":
        return finish_bare(work, store)
    if not work.quantities:
        return _fields_alone(work, store)
    ledger = work.ledger
    pilot = first_look(work)
    work = replace(work, fidelity=pilot.chosen, fallback=pilot.fallback)
    priced = price(work)
    ledger.close("pilot")
    first = first_analyses(work)
    work = replace(work, screened=screened_by(first))
    whole, expensive, found = work, None, None
    if priced.way.surrogate:
        work = priced.bounded(work)
        expensive = answer_expensive(work, priced, noise_of(first))
        ledger.close("surrogate")
        found = _by_surrogate(work, pilot, expensive, first)
    if found is None:
        found = _by_sampling(work, store, pilot, expensive, first, notice)
        if notice is not None and store.damaged:
            notice(f"damaged chunks were found and evaluated again: {', '.join(store.damaged)}")
    if work.study.analysis.budget.evaluations < whole.study.analysis.budget.evaluations:
        # the evaluations that the time has room for
        late = {part: "time" if stop == "evaluations" else stop for part, stop in found.stops.items()}
        found = replace(found, stops=late)
    return finish(whole, store, priced, expensive, found)


def _fields_alone(work: Work, store: Store) -> Run:
    """What is said of vectors where no quantity is asked for: the sample has the rows that they were computed at."""
    analyses, count = find_analyses(work), dict(planned_analyses(work.study))["fields"]
    rows = draw(work.drawn, seed=work.study.seed, task="fields", start=0, count=count, replicates=1)
    sampled = Sampled(sample=rows.with_answers((), rows.scores[:, :, :0]), descriptions={}, limits={}, missed=[],
                      stopped="accuracy")  # fmt: skip
    found = Findings(pilot=first_look(work), sampled=sampled, sensitivity={}, drivers=Drivers(), tabled=sampled.tabled,
                     analyses=analyses)  # fmt: skip
    return finish(work, store, price(work), None, found)


def _by_surrogate(work: Work, pilot: Pilot, one: Expensive, first: Analyses | None) -> Findings | None:
    """What the surrogate way found, as every run writes it; None where the model has to be sampled."""
    if one.sampled is None:
        return None
    tolerance = find_tolerance(work)
    work.ledger.close("tolerance intervals")
    return Findings(
        pilot=pilot,
        sampled=one.sampled,
        sensitivity=one.sensitivity,
        drivers=Drivers(),
        tabled=one.sampled.tabled,
        margins=one.margins,
        tolerance=tolerance,
        analyses=find_analyses(work) if first is None else first,
        stops=dict.fromkeys(("sampling", "sensitivity"), one.sampled.stopped),
    )


def _by_sampling(
    work: Work,
    store: Store,
    pilot: Pilot,
    one: Expensive | None,
    first: Analyses | None,
    notice: Callable[[str], None] | None,
) -> Findings:
    """Everything by sampling the model; surrogates that did not answer all still answer what they know better."""
    ledger = work.ledger
    sampled = sample_distributions(work)
    ledger.close("sampling")
    sampled = refine_limits(work, sampled)
    if one is not None:
        sampled = keep_answers(work, sampled, one)
    ledger.close("rare events")
    for name, limit in sampled.limits.items():
        if notice is not None and limit.told:
            notice(f"limit {name}: probability of missing its aim {limit.told}")
    tolerance = find_tolerance(work)
    ledger.close("tolerance intervals")
    found = Findings(
        pilot=pilot,
        sampled=sampled,
        sensitivity={},
        drivers=Drivers(),
        tabled=sampled.tabled,
        far=carried_far(work.study),
        tolerance=tolerance,
        analyses=find_analyses(work) if first is None else first,
    )
    reserved = 0 if one is not None or work.study.black_box else _reserved(work)
    if not reserved:
        if work.study.black_box:
            told_early(work, found)
        return _sharing(work, replace(found, **_breaking(work, sampled, one)), one, first)
    return _side_by_side(work, store, found, first, reserved)


def _reserved(work: Work) -> int:
    """The most that margins and fracture take, where the budget has room for the rest beside it; else nothing."""
    budget = work.study.analysis.budget.evaluations
    most = sum(part.most for part in forecast(work.study, budget) if part.name in _BREAKING)
    return most if work.ledger.total + most <= ROOM * budget else 0


def _side_by_side(work: Work, store: Store, found: Findings, first: Analyses | None, reserved: int) -> Findings:
    """Margins and fracture beside what shares the variance out, each with its own part of the budget: on two
    processors where there are two, with the same answers where there is one."""
    base, copied = deepcopy(work.ledger), store.shared and may_copy(work.threads)
    side, own = replace(work, ledger=deepcopy(base)), work.within(work.study.analysis.budget.evaluations - reserved)
    if copied:
        side = replace(side, progress=None, reached=None)
    with aside(lambda: (_breaking(side, found.sampled, None), side.ledger, store.damaged), copied=copied) as broken:
        shared = _sharing(own, told_early(own, judged_ways(own, found)), None, first)
        breaking, spent, damaged = broken()
    work.ledger.follow(spent, base)
    store.damaged[:] = sorted({*store.damaged, *damaged})
    store.look()
    return replace(shared, **breaking)


def _breaking(work: Work, sampled: Sampled, one: Expensive | None) -> dict[str, Any]:
    """Margins, what is carried from tests, and fracture, as `Findings` has them."""
    margins = find_margins(work, sampled)
    if one is not None:
        margins = keep_margins(work, margins, one)
    margins = judge_answers(work, margins)
    work.ledger.close("margins")
    carried = find_carried(work, sampled)
    work.ledger.close("carriers")
    fracture = find_fracture(work, sampled, margins)
    work.ledger.close("fracture")
    return {"margins": margins, "carried": carried, "fracture": fracture}


def _sharing(work: Work, found: Findings, one: Expensive | None, first: Analyses | None) -> Findings:
    """What was found, with indices and drivers."""
    shared = share_variance(work, found.sampled, first)
    if one is not None:
        shared = replace(shared, sensitivity=keep_indices(shared.sensitivity, one))
    work.ledger.close("sensitivity")
    drivers = find_drivers(work, found.sampled, shared)
    work.ledger.close("drivers")
    stops = {"sampling": found.sampled.stopped, "sensitivity": shared.stopped}
    return replace(found, sensitivity=shared.sensitivity, drivers=drivers, tabled=shared.tabled, stops=stops)
