"""The two halves of a run that need nothing of each other: what breaks, and what shares the variance out."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from typing import Any, Final

from uqsphere.runner.beside import aside, may_copy
from uqsphere.runner.campaign import Findings
from uqsphere.runner.drivers import find_drivers
from uqsphere.runner.evaluate import Work
from uqsphere.runner.expensive import Expensive, keep_indices, keep_margins
from uqsphere.runner.forecast import forecast
from uqsphere.runner.questions.carried import find_carried
from uqsphere.runner.questions.fields import find_courses
from uqsphere.runner.questions.fracture import find_fracture
from uqsphere.runner.questions.further import Analyses
from uqsphere.runner.questions.margins import find_margins, judge_answers
from uqsphere.runner.questions.probabilities import find_designs
from uqsphere.runner.questions.shapley import share_variance
from uqsphere.runner.results import told_early
from uqsphere.runner.sliders import find_sliders

#: share of the budget that may be spent, with the most that margins and fracture take, for these to be answered beside
#: what shares the variance out
ROOM: Final = 0.5
_BREAKING: Final = ("margins", "carriers", "fracture")


def reserved(work: Work) -> int:
    """The most that margins and fracture take, where the budget has room for the rest beside it; else nothing."""
    budget = work.study.analysis.budget.evaluations
    most = sum(part.most for part in forecast(work.study, budget) if part.name in _BREAKING)
    return most if work.ledger.total + most <= ROOM * budget else 0


def side_by_side(work: Work, found: Findings, first: Analyses | None, reserved: int) -> Findings:
    """Margins and fracture beside what shares the variance out, each with its own part of the budget: on two
    processors where there are two, with the same answers where there is one."""
    store = work.store
    assert store is not None
    base, copied = deepcopy(work.ledger), store.shared and may_copy(work.threads)
    side, own = replace(work, ledger=deepcopy(base)), work.within(work.study.analysis.budget.evaluations - reserved)
    if copied:
        side = replace(side, progress=None, reached=None)
    with aside(lambda: (breaking(side, found, None), side.ledger, store.damaged), copied=copied) as broken:
        shared = sharing(own, told_early(own, found), None, first)
        fracture, spent, damaged = broken()
    work.ledger.follow(spent, base)
    store.take_in(damaged)
    return replace(shared, **fracture)


def breaking(work: Work, found: Findings, one: Expensive | None) -> dict[str, Any]:
    """Margins, what is carried from tests, fracture, and what sliders show, as `Findings` has them."""
    sampled = found.sampled
    margins = find_margins(work, sampled)
    if one is not None:
        margins = keep_margins(work, margins, one)
    margins = judge_answers(work, margins)
    work.ledger.close("margins")
    carried = find_carried(work, sampled)
    work.ledger.close("carriers")
    fracture = find_fracture(work, sampled, margins)
    work.ledger.close("fracture")
    sliders = find_sliders(work, margins)
    return {"margins": margins, "carried": carried, "fracture": fracture, "sliders": sliders}


def sharing(work: Work, found: Findings, one: Expensive | None, first: Analyses | None) -> Findings:
    """What was found, with indices, drivers and courses."""
    found = replace(found, sampled=find_designs(work, found.sampled))
    shared = share_variance(work, found.sampled, first)
    if one is not None:
        shared = replace(shared, sensitivity=keep_indices(shared.sensitivity, one))
    work.ledger.close("sensitivity")
    drivers = find_drivers(work, found.sampled, shared)
    work.ledger.close("drivers")
    stops = {"sampling": found.sampled.stopped, "sensitivity": shared.stopped}
    courses = find_courses(work, found.sampled.sample)
    return replace(found, sensitivity=shared.sensitivity, drivers=drivers, courses=courses, tabled=shared.tabled,
                   stops=stops)  # fmt: skip
