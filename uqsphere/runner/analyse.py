"""The questions of a run, one after the other, each with what the ones before it have found."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import replace
from typing import Final

from uqsphere.results import FractureEntry
from uqsphere.results.entries import CarriedEntry
from uqsphere.runner.account import Findings
from uqsphere.runner.drivers import Drivers, find_drivers
from uqsphere.runner.evaluate import Ledger, Work, draw
from uqsphere.runner.expensive import Expensive, answer_expensive, keep_answers, keep_indices, keep_margins, price
from uqsphere.runner.fidelity import Pilot, first_look
from uqsphere.runner.finished import Run
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
from uqsphere.runner.questions.margins import MarginAnswer, find_margins, judge_answers
from uqsphere.runner.questions.probabilities import refine_limits
from uqsphere.runner.questions.shapley import share_variance
from uqsphere.runner.results import finish, finish_bare
from uqsphere.runner.verdict import gather
from uqsphere.runner.workers import aside, may_copy, processors
from uqsphere.store import Store

#: share of the budget up to which, once probabilities are known, the two halves of what is left are given what is left
#: of it both, and are answered side by side
APART: Final = 0.1


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
    work: Work, store: Store, pilot: Pilot, one: Expensive | None, first: Analyses | None,
    notice: Callable[[str], None] | None,
) -> Findings:  # fmt: skip
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
    analyses = find_analyses(work) if first is None else first
    apart = one is None and not work.study.black_box and ledger.total <= APART * work.study.analysis.budget.evaluations
    base = deepcopy(ledger)
    side = replace(work, ledger=deepcopy(ledger)) if apart else work
    copied = apart and may_copy(work.threads)
    if copied:
        each = max(1, processors() // 2 if work.threads is None else work.threads // 2)
        work, side = replace(work, threads=each), replace(side, threads=each, progress=None, reached=None)
    with aside(lambda: _breaking(side, sampled, one), copied=copied) as broken:
        shared = share_variance(work, sampled, first)
        if one is not None:
            shared = replace(shared, sensitivity=keep_indices(shared.sensitivity, one))
        ledger.close("sensitivity")
        drivers = find_drivers(work, sampled, shared)
        ledger.close("drivers")
        evidence = gather(work, sampled.sample) if apart else None
        margins, carried, fracture, spent = broken()
    if apart:
        ledger.follow(spent, base)
        store.look()
    return Findings(
        pilot=pilot,
        sampled=sampled,
        sensitivity=shared.sensitivity,
        drivers=drivers,
        tabled=shared.tabled,
        margins=margins,
        fracture=fracture,
        carried=carried,
        far=carried_far(work.study),
        tolerance=tolerance,
        analyses=analyses,
        evidence=evidence,
        stops={"sampling": sampled.stopped, "sensitivity": shared.stopped},
    )


def _breaking(
    work: Work, sampled: Sampled, one: Expensive | None
) -> tuple[dict[str, MarginAnswer], Mapping[str, CarriedEntry], FractureEntry | None, Ledger]:
    """Margins, what is carried from tests, and fracture, with the ledger of it."""
    margins = find_margins(work, sampled)
    if one is not None:
        margins = keep_margins(work, margins, one)
    margins = judge_answers(work, margins)
    work.ledger.close("margins")
    carried = find_carried(work, sampled)
    work.ledger.close("carriers")
    fracture = find_fracture(work, sampled, margins)
    work.ledger.close("fracture")
    return margins, carried, fracture, work.ledger
