"""The questions of a run, one after the other, each with what the ones before it have found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from uqsphere.runner.campaign import Findings
from uqsphere.runner.drivers import Drivers
from uqsphere.runner.ending import finish, finish_bare
from uqsphere.runner.evaluate import Work, draw
from uqsphere.runner.evidence import Early, gathered_ahead
from uqsphere.runner.expensive import Expensive, answer_expensive, keep_answers, price
from uqsphere.runner.fidelity import Pilot, first_look
from uqsphere.runner.finished import Run
from uqsphere.runner.halves import breaking, reserved, sharing, side_by_side
from uqsphere.runner.questions.carried import carried_far
from uqsphere.runner.questions.distributions import Sampled, sample_distributions
from uqsphere.runner.questions.further import (
    Analyses,
    find_analyses,
    find_tolerance,
    first_analyses,
    noise_of,
    planned_analyses,
    screened_by,
)
from uqsphere.runner.questions.probabilities import refine_limits
from uqsphere.runner.results import told_early
from uqsphere.store import Store


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
        work = work.within(priced.way.affordable)
        expensive = answer_expensive(work, priced, noise_of(first))
        ledger.close("surrogate")
        found = _by_surrogate(work, pilot, expensive, first)
    if found is None:
        found = _by_sampling(work, pilot, expensive, first, notice)
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
    pilot: Pilot,
    one: Expensive | None,
    first: Analyses | None,
    notice: Callable[[str], None] | None,
) -> Findings:
    """Everything by sampling the model; surrogates that did not answer all still answer what they know better."""
    with gathered_ahead(work) as early:
        return _sampled(work, pilot, one, first, notice, early)


def _sampled(
    work: Work,
    pilot: Pilot,
    one: Expensive | None,
    first: Analyses | None,
    notice: Callable[[str], None] | None,
    early: Callable[[], Early | None],
) -> Findings:
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
        early=early,
        tolerance=tolerance,
        analyses=find_analyses(work) if first is None else first,
    )
    room = 0 if one is not None or work.study.black_box else reserved(work)
    if not room:
        if work.study.black_box:
            told_early(work, found)
        return sharing(work, replace(found, **breaking(work, found, one)), one, first)
    return side_by_side(work, found, first, room)
