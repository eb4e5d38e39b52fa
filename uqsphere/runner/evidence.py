"""The rows that verdicts on fracture rest on: rows of a run's sample with the demands of every way to break."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from uqsphere.arrays import Array
from uqsphere.mechanics.outputs import absent_in, all_with
from uqsphere.mechanics.yielding import Face
from uqsphere.model import EvaluatedRows, is_answered, scene_of
from uqsphere.runner.axis_rows import evaluate_along
from uqsphere.runner.beside import aside, may_copy
from uqsphere.runner.campaign import Findings
from uqsphere.runner.evaluate import Ledger, OutOfBudget, Work, with_answered
from uqsphere.runner.fidelity import solved
from uqsphere.runner.forecast import JUDGED
from uqsphere.runner.questions.any_limit import AnyLimit
from uqsphere.runner.schedule import PILOT, REPLICATES, WAYS, WAYS_CURVE
from uqsphere.study import Limit, Study, Ways, means_fracture, spaced, ways_of
from uqsphere.uq import Sample, root

if TYPE_CHECKING:
    from uqsphere.mechanics.outputs import Answers
    from uqsphere.mechanics.scene import Scene

#: one in so many values of the free scalar is looked at first
_STRIDE: Final = 4


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """Rows of a run's sample with the demands of all ways to break; `along` has such rows by values of the free scalar.

    `work` has the limits of the ways behind those of the file; `scene` and `answers`, on which the checks of the model
    are made, are those of the first points of each replicate.  `static` are the rows under the static contact law, None
    where no face yields, or the study has such a law itself.
    """

    work: Work
    ways: Ways
    sample: Sample
    scene: Scene
    answers: Answers
    along: Mapping[float, Sample]
    static: Sample | None

    def chances(self, limits: Sequence[Limit], aim: str, sample: Sample | None = None) -> Array:
        """Probability (R, n) that the aim is missed by any of some limits, given the inputs."""
        together = AnyLimit.of(self.work, tuple(limits))
        return together.at(self.work, self.sample if sample is None else sample, aim=aim).any

    def curve(self, limit: Limit) -> list[tuple[float, float]]:
        """Values of the free scalar, and the probability there that a limit is exceeded."""
        return [(value, float(self.chances([limit], "survive", rows).mean())) for value, rows in self.along.items()]

    def value_at(self, limits: Sequence[Limit], aim: str, wanted: float) -> float | None:
        """The free scalar at which the aim is missed by any of some limits with a probability; None where nowhere."""
        if not self.along:
            return None
        values, samples = list(self.along), list(self.along.values())

        def missed(at: int) -> float:
            return float(self.chances(limits, aim, samples[at]).mean())

        logarithmic = values[0] > 0.0
        places = np.log(values) if logarithmic else np.array(values)
        place = root(places, missed, wanted, rising=missed(len(values) - 1) > missed(0))
        if not math.isfinite(place):
            return None
        return math.exp(place) if logarithmic else place


class Early(NamedTuple):
    """Rows along the free scalar that were made before they are asked for, and what that took."""

    along: dict[float, Sample]
    evaluations: int
    damaged: list[str]


@contextmanager
def gathered_ahead(work: Work) -> Iterator[Callable[[], Early | None]]:
    """While the block goes on, on another processor where there is one: what `gather_early` finds."""
    beside = replace(work, progress=None, reached=None)
    stored = work.store is not None and work.store.shared
    copied = stored and not work.study.black_box and may_copy(work.threads)
    with aside(lambda: gather_early(beside), copied=copied) as told:
        early = cache(told)
        yield early
        early()  # kept for who asks when the other process has ended


def gather_early(work: Work) -> Early | None:
    """Rows of the ways that wait for nothing; None where there are none, or they are much of the budget."""
    study, most = work.study, REPLICATES * WAYS_CURVE.first * WAYS_CURVE.most
    left = WAYS_CURVE.share * (study.analysis.budget.evaluations - work.ledger.total)
    if study.black_box or most > left or not any(means_fracture(limit) for limit in study.limits):
        return None
    own = _own(work, with_ways(study)[0])
    along = _along(own, most)
    return Early(along, own.ledger.total, [] if work.store is None else work.store.damaged)


def gather(work: Work, sample: Sample, early: Early | None) -> Evidence | None:
    """The rows that verdicts on fracture rest on beside the answers of the run, with the full model.

    None where no limit means fracture, and where the budget has nothing left.  Counted as evaluations of the ways.
    """
    study, random = work.study, bool(work.scene_names)
    left = study.analysis.budget.evaluations - work.ledger.total
    # the rows are answered twice, by the study's contact law and by the static one, and some by all that checks read
    checks = min(PILOT.first, left // 4)
    count = min(WAYS.first, sample.count, (left - checks) // 2 // (sample.replicates if random else 1))
    if study.black_box or count < 1 or not any(means_fracture(limit) for limit in study.limits):
        return None
    head, d = sample.head(count), len(work.scene_names)
    rows = head.inputs[:, :, :d].reshape(head.size, d)[: None if random else 1]
    wide, ways = with_ways(study)
    scene = scene_of(wide, {name: rows[:, k] for k, name in enumerate(work.scene_names)}, len(rows))
    own = _own(work, wide)
    answers = _solved(own, scene, own.quantities)
    first = np.arange(head.size).reshape(head.replicates, -1)[:, : max(checks // head.replicates, 1)]
    checked = scene.at(first.ravel()) if random else scene
    found = Evidence(work=own, ways=ways, sample=_with(own, head, answers), scene=checked,
                     answers=_solved(own, checked, all_with(scene, own.quantities)),
                     along=_along(own, left - 2 * len(rows) - checks) if early is None else early.along,
                     static=_static(own, head, scene, answers))  # fmt: skip
    work.ledger.evaluations["ways"] = own.ledger.total + (0 if early is None else early.evaluations)
    return found


def _own(work: Work, wide: Study) -> Work:
    """The work on a study with all ways, by the full model, with an account of its own."""
    return replace(work, study=wide, ledger=Ledger(started=work.ledger.started), fidelity="full", fallback=None,
                   spare=True)  # fmt: skip


def with_ways(study: Study) -> tuple[Study, Ways]:
    """The study with the limits of the ways behind its own, asked for the demands of all of them, and these ways."""
    ways, means = ways_of(study), study.at_means()
    if not ways.assumed:
        return _wider(study, ways), ways
    scene = scene_of(_wider(study, ways), {name: np.array([means[name]]) for name in study.random}, 1)
    lacking = {way.called: why for way in ways.assumed if (why := absent_in(scene, way.limit.quantity))}
    ways = Ways(
        assumed=tuple(way for way in ways.assumed if way.called not in lacking),
        not_judged={**ways.not_judged, **lacking},
    )
    return _wider(study, ways), ways


def _wider(study: Study, ways: Ways) -> Study:
    limits = (*study.limits, *(way.limit for way in ways.assumed))
    # by the Hertz pressure faces yield
    asked = tuple(dict.fromkeys([*(limit.quantity for limit in limits), "p_hertz"]))
    return replace(study, limits=limits, analysis=replace(study.analysis, quantities=asked))


def _solved(work: Work, scene: Scene, quantities: tuple[str, ...] | None) -> Answers:
    asked = "" if quantities else ".checked"
    return solved(work, f"verdict.{scene.contact_law}{asked}", scene, quantities)


def _static(work: Work, points: Sample, scene: Scene, elastic: Answers) -> Sample | None:
    """The rows with faces that yield: between bars, which set the force, under the forces of the elastic motion; in
    other rigs under their own, which yielding lowers."""
    if scene.contact_law != "hertz":
        return None
    yielding = replace(scene, contact_law="plastic", contact_dynamics="elastic" if scene.rig == "bars" else "path")
    onsets = [partner.face.onset for partner in yielding.partners if partner and isinstance(partner.face, Face)]
    rows = (
        np.any([elastic.values["p_hertz"] > onset for onset in onsets], axis=0) if onsets else np.zeros(1, dtype=bool)
    )
    if not rows.any():
        return None
    # the motion is the elastic one, which stands: faces that do not yield need no other answer
    found = _solved(work, yielding.at(np.flatnonzero(rows)), work.quantities)
    answered = is_answered(found.status)
    rows[rows] = answered
    values = {name: column.copy() for name, column in elastic.values.items()}
    for name, column in values.items():
        column[rows] = found.values[name][answered]
    return _with(work, points, replace(elastic, values=values))


def _with(work: Work, points: Sample, answers: Answers) -> Sample:
    """The points with the answers to all of their rows, or with one answer for all."""
    none = np.zeros(len(answers.status), dtype=bool)
    return with_answered(work, points, EvaluatedRows(
        values=np.stack([answers.values[name] for name in work.quantities], axis=1),
        censored=np.stack([answers.censored.get(name, none) for name in work.quantities], axis=1),
        status=answers.status,
    ))  # fmt: skip


def _along(work: Work, left: int) -> dict[float, Sample]:
    """Few rows at values of the free scalar, none where it moves no row, or the budget or the time is over.

    Every fourth value first, then those between two whose probabilities differ, by a tenth of what is solved for.
    """
    margins, count = work.study.margins, min(WAYS_CURVE.first, left // (REPLICATES * WAYS_CURVE.most))
    if margins is None or not margins.axis.moves_rows or count < 1:
        return {}
    values = spaced(margins.axis.low, margins.axis.high, WAYS_CURVE.most)
    wanted = min(limit.target or min(margins.for_probability) for limit in work.study.limits)
    try:
        rows = evaluate_along(work, dict.fromkeys(values[::_STRIDE], (0, count)), ".ways")
        if between := _between(work, values, rows, 0.1 * wanted):
            rows |= evaluate_along(work, dict.fromkeys(between, (0, count)), ".ways.between")
    except OutOfBudget:
        return {}
    return dict(sorted(rows.items()))


def _between(work: Work, values: Sequence[float], rows: Mapping[float, Sample], least: float) -> list[float]:
    """The values beside those of some rows between which the probability of a limit moves by more than `least`."""
    limits = [AnyLimit.of(work, (limit,)) for limit in work.study.limits if means_fracture(limit)]
    said = [np.array([one.at(work, sample).any.mean() for one in limits]) for sample in rows.values()]
    moves = [bool((np.abs(after - before) > least).any()) for before, after in pairwise(said)]
    return [value for k, value in enumerate(values) if k % _STRIDE and moves[k // _STRIDE]]


def judged_ways(work: Work, found: Findings) -> Findings:
    """What was found, with the rows that verdicts on fracture rest on beside it, once."""
    if JUDGED in work.ledger.parts:
        return found
    early = None if found.early is None else found.early()
    if early is not None and work.store is not None:
        work.store.take_in(early.damaged)
    found = replace(found, evidence=gather(work, found.sampled.sample, early))
    work.ledger.close(JUDGED)
    return found
