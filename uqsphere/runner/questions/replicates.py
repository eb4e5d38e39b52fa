"""A model that answers the same row otherwise each time: its own scatter apart from that of the inputs.

Some rows are evaluated several times.  With `w` the mean of the variances within rows of `T` answers each and `b` the
variance of the rows' means, the inputs scatter with the variance `b - w/T` and the model with `w` (one-way analysis of
variance with random effects; Searle, Casella and McCulloch, Variance Components, 1992, ch. 3).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.results import AnalysisEntry, Est
from uqsphere.runner.evaluate import Work, draw, evaluate_whole
from uqsphere.study import Study
from uqsphere.uq import Estimate, absent

if TYPE_CHECKING:
    from uqsphere.runner.questions.indices import Sensitivity

#: answers of each row, the fewest rows and the most, and their share of the budget
TIMES: Final = 4
LEAST, MOST, SHARE = 8, 64, 0.2
METHOD: Final = "replicates of some rows"
SUBJECT: Final = "the model's own scatter"
SHARE_NAME: Final = "share of the variance"
#: standard errors to either side: Student's 97.5 % point of some twenty rows
REACH: Final = 2.1


def planned(study: Study) -> int:
    """Evaluations: a fifth of the budget at the most."""
    rows = int(SHARE * study.analysis.affordable / TIMES)
    return TIMES * min(max(rows, LEAST), MOST)


def answer(work: Work) -> AnalysisEntry:
    """Standard deviations by the model itself and by the inputs, and the model's share of the variance."""
    count = planned(work.study) // TIMES
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
    if len(values) < LEAST // 2:
        nothing = absent("too few rows have all their answers", METHOD, evaluations)
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
        one = Estimate(value=value, low=low, high=high, std_error=error, method=METHOD, evaluations=evaluations)
        table[name] = Est.model_validate(one)
    return table


def noise_of(entry: AnalysisEntry | None) -> dict[str, float]:
    """The model's own share of the variance by quantity, at the most that its replicates allow."""
    shares = {} if entry is None else {q: table[SUBJECT][SHARE_NAME].high for q, table in entry.values.items()}
    return {quantity: share for quantity, share in shares.items() if share is not None}


def without_noise(found: Mapping[str, Sensitivity], entry: AnalysisEntry | None) -> dict[str, Sensitivity]:
    """Sampled indices without the model's own share, which pairs of runs count to every total index."""
    answers = dict(found)
    for quantity, table in ({} if entry is None else entry.values).items():
        share = table[SUBJECT][SHARE_NAME]
        if share.value is None or share.low is None or share.high is None:
            continue
        one, width, total = answers[quantity], 0.5 * (share.high - share.low), {}
        for name, e in answers[quantity].total.items():
            total[name] = e
            if e.value is not None and e.low is not None and e.high is not None:
                low, high = math.hypot(e.value - e.low, width), math.hypot(e.high - e.value, width)
                value = e.value - share.value
                total[name] = replace(e, value=max(value, 0.0), low=max(value - low, 0.0), high=max(value + high, 0.0),
                                      std_error=0.5 * (low + high) / 1.96)  # fmt: skip
        text = f"{one.text} The model's own scatter, {share.value:.2g} of the variance, is in no index."
        answers[quantity] = replace(one, total=total, text=text)
    return answers
