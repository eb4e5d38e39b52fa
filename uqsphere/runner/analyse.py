"""The questions of a run, one after the other, each with what the ones before it have found."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import Any

from uqsphere.errors import UsageError
from uqsphere.quantities import format_estimate
from uqsphere.results import AnalysisEntry
from uqsphere.runner.drivers import find_drivers
from uqsphere.runner.evaluate import Work
from uqsphere.runner.expensive import Expensive, answer_expensive, keep_answers, keep_indices, keep_margins, price
from uqsphere.runner.fidelity import Pilot, first_look
from uqsphere.runner.finish import finish, finish_bare
from uqsphere.runner.finished import Run
from uqsphere.runner.forecast import more_to_come
from uqsphere.runner.questions.carried import find_carried
from uqsphere.runner.questions.distributions import Sampled, sample_distributions
from uqsphere.runner.questions.fracture import find_fracture
from uqsphere.runner.questions.further import find_analyses, first_analyses, noise_of
from uqsphere.runner.questions.margins import find_margins, judge_answers
from uqsphere.runner.questions.probabilities import refine_limits
from uqsphere.runner.questions.replicates import without_noise
from uqsphere.runner.questions.shapley import share_variance
from uqsphere.runner.questions.tolerance import find_tolerance
from uqsphere.runner.results import Findings
from uqsphere.store import Store
from uqsphere.study import Study


def analyse(work: Work, store: Store, notice: Callable[[str], None] | None = None) -> Run:
    """Every analysis of a run, one after the other, and its files; what is stored already is not evaluated again."""
    if work.study.rig == "none":
        return finish_bare(work, store)
    ledger = work.ledger
    pilot = first_look(work)
    work = replace(work, fidelity=pilot.chosen, fallback=pilot.fallback)
    ledger.evaluations.update(pilot.evaluations)
    priced = price(work)
    ledger.close("pilot")
    whole, expensive, found, first = work, None, None, first_analyses(work)
    if priced.way.surrogate:
        work = priced.bounded(work)
        expensive = answer_expensive(work, priced, noise_of(first))
        ledger.close("surrogate")
        found = _by_surrogate(work, pilot, expensive, first)
    if found is None:
        found = _by_sampling(work, pilot, expensive, first, notice)
        if notice is not None and store.damaged:
            notice(f"damaged chunks were found and evaluated again: {', '.join(store.damaged)}")
    return finish(whole, store, priced, expensive, found)


def _by_surrogate(
    work: Work, pilot: Pilot, one: Expensive, first: Mapping[str, AnalysisEntry] | None
) -> Findings | None:
    """What the surrogate way found, as every run writes it; None where the model has to be sampled."""
    if one.sampled is None:
        return None
    tolerance = find_tolerance(work)
    work.ledger.close("tolerance intervals")
    return Findings(
        pilot=pilot,
        sampled=one.sampled,
        sensitivity=one.sensitivity,
        margins=one.margins,
        tolerance=tolerance,
        analyses=find_analyses(work) if first is None else dict(first),
        history=work.ledger.rows,
        stops={"sampling": one.sampled.stopped, "sensitivity": one.sampled.stopped},
    )


def _by_sampling(
    work: Work,
    pilot: Pilot,
    one: Expensive | None,
    first: Mapping[str, AnalysisEntry] | None,
    notice: Callable[[str], None] | None,
) -> Findings:
    """Everything by sampling the model; surrogates that did not answer all still answer what they know better."""
    ledger = work.ledger
    sampled = sample_distributions(work, more_to_come=more_to_come(work.study))
    ledger.close("sampling")
    sampled = refine_limits(work, sampled)
    if one is not None:
        sampled = keep_answers(work, sampled, one)
    ledger.close("rare events")
    _tell_verdicts(sampled, notice)
    tolerance = find_tolerance(work)
    ledger.close("tolerance intervals")
    analyses = find_analyses(work) if first is None else dict(first)
    margins = find_margins(work, sampled)
    if one is not None:
        margins = keep_margins(work, margins, one)
    margins = judge_answers(work, margins)
    ledger.close("margins")
    carried = find_carried(work, sampled)
    ledger.close("carriers")
    fracture = find_fracture(work, sampled, margins)
    ledger.close("fracture")
    shared = share_variance(work, sampled)
    shared = replace(shared, sensitivity=without_noise(shared.sensitivity, (first or {}).get("replicates")))
    if one is not None:
        shared = replace(shared, sensitivity=keep_indices(shared.sensitivity, one))
    ledger.close("sensitivity")
    drivers = find_drivers(work, sampled, shared)
    ledger.close("drivers")
    return Findings(
        pilot=pilot,
        sampled=sampled,
        sensitivity=shared.sensitivity,
        drivers=drivers,
        tabled=shared.tabled,
        margins=margins,
        fracture=fracture,
        carried=carried,
        tolerance=tolerance,
        analyses=analyses,
        history=work.ledger.rows,
        stops={"sampling": sampled.stopped, "sensitivity": shared.stopped},
        paper=compare_with_paper(work.study),
    )


def _tell_verdicts(sampled: Sampled, notice: Callable[[str], None] | None) -> None:
    for name, limit in sampled.limits.items():
        miss = limit.miss
        if notice is not None and miss.value is not None and miss.low is not None and miss.high is not None:
            interval = format_estimate(miss.value, miss.low, miss.high, most=5)
            notice(f"limit {name}: probability of missing its aim {interval}")


def compare_with_paper(study: Study) -> list[dict[str, Any]]:
    """Rows of as printed, corrected and full answers at the means, where the study asks for them.

    Raises UsageError where the scene at the means has no answer.
    """
    if study.black_box or not study.model.compare_with_paper:
        return []
    from uqsphere.mechanics.as_printed import compare
    from uqsphere.model import scene_of

    try:
        return [asdict(row) for row in compare(scene_of(study, {}), tolerance=study.model.tolerance)]
    except ValueError as error:
        raise UsageError(f"model.compare_with_paper: leave it out; at the means of all inputs {error}") from None
