"""Analyses beside what every run answers: those a study asks for, and those its model or many inputs call for.

Each has the evaluations that it is likely to take and a table of estimates; what it finds is known before anything else
is asked.  Screening after Morris tells how far an output goes when one input at a time crosses half of its law.
Replicates tell a model's own scatter from that of the inputs: with `w` the mean of the variances within rows of `T`
answers each and `b` the variance of the rows' means, the inputs scatter with the variance `b - w/T` and the model with
`w` (one-way analysis of variance with random effects; Searle, Casella, McCulloch, Variance Components, 1992, ch. 3).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from uqsphere.arrays import Array
from uqsphere.results import AnalysisEntry, Est, ToleranceEntry
from uqsphere.runner.evaluate import Work, draw, evaluate_whole
from uqsphere.runner.schedule import MANY, MORRIS, REPEATED
from uqsphere.study import Study
from uqsphere.study.document import FURTHER
from uqsphere.uq import random_generator
from uqsphere.uq.estimate import Estimate, absent, mean_alone, sd_alone
from uqsphere.uq.tolerance import tolerance_limits

if TYPE_CHECKING:
    from uqsphere.runner.questions.indices import Sensitivity

#: what they answer, by name
Analyses: TypeAlias = dict[str, AnalysisEntry]


def _asked(study: Study) -> Iterator[tuple[str, int, Callable[[Work], AnalysisEntry]]]:
    """Name, likely evaluations and answer of every analysis that a study or its model asks for."""
    if not study.random:
        return
    if study.model.stochastic:
        yield "replicates", TIMES * _replicated(study), _replicates
    if count := _walks(study):
        # one for the start of every trajectory and one for each of its steps
        yield "morris", count * (len(study.random) + 1), _morris
    if study.analysis.fields:
        from uqsphere.runner.questions import fields

        yield "fields", fields.planned(study), fields.answer


def planned_analyses(study: Study) -> Iterator[tuple[str, int]]:
    """Every analysis that is asked for, and the evaluations that it is likely to take."""
    return ((name, likely) for name, likely, _ in _asked(study))


def first_analyses(work: Work) -> Analyses | None:
    """The answers where everything else rests on them: of a model that scatters by itself, or with many inputs."""
    named = set(work.study.analysis.methods) & set(FURTHER)
    return find_analyses(work) if not named and any(name != "fields" for name, *_ in _asked(work.study)) else None


def _told(first: Analyses | None, name: str) -> Mapping[str, Mapping[str, Mapping[str, Est]]]:
    """The table of an analysis that was asked first; empty where it was not."""
    return first[name].values if first and name in first else {}


def find_analyses(work: Work) -> Analyses:
    """The answers by name; empty where the study asks for none or nothing is random."""
    found = {}
    for name, _, answer in _asked(work.study):
        found[name] = answer(work)
        work.ledger.close(name)
    return found


# --- tolerance limits -------------------------------------------------------------------------------------


def find_tolerance(work: Work) -> dict[str, ToleranceEntry]:
    """Tolerance limits by quantity, or why there are none; empty where the study asks for none or nothing is random.

    They rest on independent runs: Wilks' counts do not hold for Sobol' points.

    Where the policy for failures lets the study go on, a run without an answer takes the worst place of each limit; one
    that outlasts the record takes that of an upper limit.
    """
    request = work.study.analysis.tolerance_intervals
    if request is None or not work.scene_names:
        return {}
    inputs = work.all_inputs.only(work.scene_names)
    rng = random_generator(seed=work.study.seed, task="tolerance")
    rows = inputs.physical(rng.standard_normal((request.runs, len(inputs.names))))
    answered = evaluate_whole(work, "tolerance", rows)
    if isinstance(answered, str):
        nothing = ToleranceEntry(
            coverage=request.coverage, confidence=request.confidence, runs=request.runs,
            upper=None, lower=None, between=None, orders=(0, 0), attained=(0.0, 0.0), reason=answered,
        )  # fmt: skip
        return dict.fromkeys(work.quantities, nothing)
    values = answered.known
    found = {
        name: tolerance_limits(
            values[:, k],
            coverage=request.coverage,
            confidence=request.confidence,
            unknown_above=answered.censored[:, k],
        )
        for k, name in enumerate(work.quantities)
    }
    return {name: ToleranceEntry(**asdict(limits)) for name, limits in found.items()}


# --- screening after Morris ----------------------------------------------------------------------------------------


#: levels of an input, at the middle of four equally probable classes: a step of two crosses half of its law
LEVELS: Final = 4
EFFECTS: Final = "elementary effects"
#: share of all squared effects that inputs left out of fits may have: a fifth of what a fit may leave of the variance
SCREENED: Final = 0.01
_ABSOLUTE: Final = "mean absolute effect"


def _walks(study: Study) -> int:
    """Trajectories: those of a study that names it, else, where indices are asked for, of their share of the budget; 0
    where they are too few."""
    if "morris" in study.analysis.methods:
        return MORRIS.first
    wanted = "auto" in study.analysis.methods and study.analysis.samples_indices
    if not (study.black_box and wanted and len(study.random) >= MANY):
        return 0
    count = min(MORRIS.first, int(MORRIS.share * study.analysis.affordable / (len(study.random) + 1)))
    return count if count >= MORRIS.least else 0


def _trajectories(count: int, inputs: int, seed: int) -> tuple[Array, Array]:
    """Normal scores (count, d + 1, d) of walks that move every input once, and its direction in each (count, d).

    M. D. Morris, Technometrics 33, 1991, 161: each walk starts at a random level of every input, and each step takes
    one input two of four levels up (1) or down (-1).
    """
    from SALib.sample.morris import sample
    from scipy.special import ndtri

    ends = [0.5 / LEVELS, 1.0 - 0.5 / LEVELS]
    problem = {"num_vars": inputs, "names": [f"x{k}" for k in range(inputs)], "bounds": [ends] * inputs}
    number = int(random_generator(seed=seed, task="morris").integers(1, 2**31))  # SALib takes 0 for none
    walks = sample(problem, count, num_levels=LEVELS, seed=number).reshape(count, inputs + 1, inputs)
    return np.asarray(ndtri(walks)), np.sign(walks[:, -1] - walks[:, 0])


def screened_by(first: Analyses | None) -> frozenset[str]:
    """Inputs that by a first screening do next to nothing together, by the upper ends of their effects.

    A total index goes with the mean square of the effects, which is no less than the square of the mean absolute one.
    """
    rows = [{name: row[_ABSOLUTE] for name, row in table.items()} for table in _told(first, "morris").values()]
    out: set[str] = set() if not rows else set(rows[0])
    for row in rows:
        if any(e.high is None or e.value is None for e in row.values()):
            return frozenset()
        most = {name: float(e.high or 0.0) ** 2 for name, e in row.items()}
        names = sorted(most, key=lambda name: most[name])
        sums = np.cumsum([most[name] for name in names])
        out &= set(names[: int((sums <= SCREENED * sum(float(e.value or 0.0) ** 2 for e in row.values())).sum())])
    return frozenset(out)


def _morris(work: Work) -> AnalysisEntry:
    """Mean of the absolute effect, mean and standard deviation of the effect, by quantity and input.

    The mean absolute effect is that of F. Campolongo, J. Cariboni, A. Saltelli, Environ. Model. Softw. 22, 2007, 1509;
    intervals are those of independent trajectories.  A trajectory with a row without an answer is left out.
    """
    names, inputs = work.scene_names, work.all_inputs.only(work.scene_names)
    if tied := inputs.tied():
        return AnalysisEntry(reason=f"{', '.join(tied)} depend on each other: none moves alone")
    scores, directions = _trajectories(_walks(work.study), len(names), work.study.seed)
    answered = evaluate_whole(work, "morris", inputs.physical(scores.reshape(-1, len(names))))
    if isinstance(answered, str):
        return AnalysisEntry(reason=answered)
    shape, evaluations = scores.shape[:2], len(answered.status)
    whole = answered.good.reshape(shape).all(axis=1)
    values = answered.values.reshape(*shape, -1)[whole]
    # the step before which an input has its first score, and after which its second
    step = np.argmax(np.diff(scores[whole], axis=1) != 0.0, axis=1)
    table = {}
    for k, quantity in enumerate(work.quantities):
        jumps = np.take_along_axis(np.diff(values[..., k], axis=1), step, axis=1) * directions[whole]
        table[quantity] = {name: _columns(jumps[:, j], evaluations) for j, name in enumerate(names)}
    return AnalysisEntry(values=table)


def _columns(effects: Array, evaluations: int) -> dict[str, Est]:
    """The three numbers of an input from its effects (trajectories,)."""
    found: dict[str, Estimate]
    if len(effects) < 4 or not np.isfinite(effects).all():
        nothing = absent("too few trajectories have an answer in every row", EFFECTS, evaluations)
        found = dict.fromkeys((_ABSOLUTE, "mean effect", "sd of the effect"), nothing)
    else:
        found = {
            _ABSOLUTE: mean_alone(np.abs(effects)),
            "mean effect": mean_alone(effects),
            "sd of the effect": sd_alone(effects),
        }
    return {name: Est.model_validate(replace(e, method=EFFECTS, evaluations=evaluations)) for name, e in found.items()}


# --- a model that scatters by itself -------------------------------------------------------------------------------


#: answers of each row
TIMES: Final = 4
REPLICATED: Final = "replicates of some rows"
SUBJECT: Final = "the model's own scatter"
SHARE_NAME: Final = "share of the variance"
#: standard errors to either side: Student's 97.5 % point of some twenty rows
REACH: Final = 2.1


def _replicated(study: Study) -> int:
    """Rows that are answered several times: a fifth of the budget at the most."""
    return min(max(int(REPEATED.share * study.analysis.affordable / TIMES), REPEATED.least), REPEATED.most)


def _replicates(work: Work) -> AnalysisEntry:
    """Standard deviations by the model itself and by the inputs, and the model's share of the variance."""
    count = _replicated(work.study)
    points = draw(work.drawn, seed=work.study.seed, task="replicates", start=0, count=count, replicates=1)
    rows = points.inputs[0, :, : len(work.scene_names)]
    answered = evaluate_whole(work, "replicates", np.repeat(rows, TIMES, axis=0))
    if isinstance(answered, str):
        return AnalysisEntry(reason=answered)
    whole = answered.good.reshape(count, TIMES).all(axis=1)
    values = answered.values.reshape(count, TIMES, -1)[whole]
    return AnalysisEntry(values={
        quantity: {SUBJECT: _split(values[:, :, k], len(answered.status))}
        for k, quantity in enumerate(work.quantities)
    })  # fmt: skip


def _split(values: Array, evaluations: int) -> dict[str, Est]:
    """The three numbers from answers (n, T), with intervals by leaving out one row at a time."""
    names = ("sd by the model", "sd by the inputs", SHARE_NAME)
    if len(values) < REPEATED.least // 2:
        nothing = absent("too few rows have all their answers", REPLICATED, evaluations)
        return dict.fromkeys(names, Est.model_validate(nothing))
    n, unit = len(values), float(np.abs(values).max()) or 1.0
    within, means = (values / unit).var(axis=1, ddof=1), (values / unit).mean(axis=1)

    def numbers(keep: Array) -> Array:
        own = float(within[keep].mean())
        inputs = max(float(means[keep].var(ddof=1)) - own / values.shape[1], 0.0)
        return np.array([math.sqrt(own) * unit, math.sqrt(inputs) * unit, own / ((own + inputs) or 1.0)])

    found = numbers(np.ones(n, dtype=bool))
    left = np.array([numbers(np.arange(n) != k) for k in range(n)])
    errors = np.sqrt((n - 1) / n * ((left - left.mean(axis=0)) ** 2).sum(axis=0))
    tops = (math.inf, math.inf, 1.0)
    table = {}
    for name, value, error, top in zip(names, found.tolist(), errors.tolist(), tops, strict=True):
        # as factors, since scatter by few rows is as likely a half of what it is as the double of it
        factor = math.exp(min(REACH * error / value, 50.0)) if value > 0.0 else 1.0
        low, high = value / factor, min(value * factor, top) if value > 0.0 else REACH * error
        one = Estimate(value=value, low=low, high=high, std_error=error, method=REPLICATED, evaluations=evaluations)
        table[name] = Est.model_validate(one)
    return table


def noise_of(first: Analyses | None) -> dict[str, float]:
    """The model's own share of the variance by quantity, at the most that its replicates allow."""
    shares = {quantity: table[SUBJECT][SHARE_NAME].high for quantity, table in _told(first, "replicates").items()}
    return {quantity: share for quantity, share in shares.items() if share is not None}


def without_noise(found: Mapping[str, Sensitivity], first: Analyses | None) -> dict[str, Sensitivity]:
    """Sampled indices without the model's own share, which pairs of runs count to every total index."""
    answers = dict(found)
    for quantity, table in _told(first, "replicates").items():
        share = table[SUBJECT][SHARE_NAME]
        if share.value is None or share.low is None or share.high is None:
            continue
        one, width, total = answers[quantity], 0.5 * (share.high - share.low), {}
        for name, e in answers[quantity].total.items():
            total[name] = e
            if e.value is not None and e.low is not None and e.high is not None:
                low, high = math.hypot(e.value - e.low, width), math.hypot(e.high - e.value, width)
                value = e.value - share.value
                total[name] = replace(e, value=max(value, 0.0)).spanning(max(value - low, 0.0), max(value + high, 0.0))
        text = f"{one.text} The model's own scatter, {share.value:.2g} of the variance, is in no index."
        answers[quantity] = replace(one, total=total, text=text)
    return answers
