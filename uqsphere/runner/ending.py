"""The end of a run: what was found is written down, in a folder that says by its results.json that it is whole."""

from __future__ import annotations

from uqsphere.results import Manifest, PlanEntry, Results
from uqsphere.results.entries import PricesEntry
from uqsphere.runner.campaign import Findings
from uqsphere.runner.evaluate import Work
from uqsphere.runner.evidence import judged_ways
from uqsphere.runner.expensive import Expensive, Priced
from uqsphere.runner.finished import Run, save_points, write_results
from uqsphere.runner.questions.fields import find_courses, save_courses
from uqsphere.runner.results import account, bare_results, further_rows, manifest_content, results_content
from uqsphere.runner.sliders import find_sliders
from uqsphere.store import Store, keep_data, write_json


def finish(work: Work, store: Store, priced: Priced, expensive: Expensive | None, found: Findings) -> Run:
    """Write what was found, with the way that was taken; what an evaluation costs stands in the manifest alone."""
    way, ledger = priced.way, work.ledger
    found = judged_ways(work, found)
    taken = "surrogate" if expensive is not None and expensive.surrogate else "sampling"
    plan = PlanEntry(
        way=taken,
        why=way.why if expensive is None else expensive.why,
        sampling_evaluations=way.sampling,
        surrogate_evaluations=way.runs,
        parts=account(work, planned=way.surrogate, affordable=way.affordable),
    )
    store.take_over()
    save_points(work, store, found.sampled.sample)
    sliders, courses = found.sliders, found.courses
    if sliders is None:  # what a surrogate answered, or fields by themselves
        sliders, courses = find_sliders(work, found.margins), find_courses(work, found.sampled.sample)
    write_json(store.folder / "sliders.json", sliders.document())
    save_courses(store, courses)
    results = Results.model_validate(results_content(work, found, plan))
    further = further_rows(results)
    results = results.model_copy(update={"speed_error": (*results.speed_error, *(row for _, row in further))})
    ends = [ledger.seconds.get(part, ledger.elapsed) for part, _ in further]
    return _written(work, store, results, [*ledger.times, *ends], priced)


def finish_bare(work: Work, store: Store) -> Run:
    """Write what the services of a study without a rig of its own have found."""
    store.take_over()
    return _written(work, store, bare_results(work.study, work.services), [])


def _written(work: Work, store: Store, results: Results, seconds: list[float], priced: Priced | None = None) -> Run:
    keep_data(work.study, store.folder)
    prices = PricesEntry() if priced is None else priced.entry()
    manifest = Manifest.model_validate(manifest_content(work, seconds, prices))
    write_results(store, results, manifest)
    return Run(folder=store.folder, results=results, manifest=manifest)
