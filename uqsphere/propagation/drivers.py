"""What drives a failure probability: its change per standard deviation that the centre of an input
is moved by.

Failure has the conditional probability T = P(failure | inputs), F_S(demand) or its complement, the
strength being integrated.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.propagation.design import Design
from uqsphere.propagation.limits import failure_given_inputs, state_of
from uqsphere.propagation.tables import Tables
from uqsphere.results import Answers
from uqsphere.study import limit_of, strength_name
from uqsphere.uq import Estimate, Law, from_replicates, score_of

#: points of a replicate that the derivatives rest on at most
MOST = 2048
#: step of a score, for the derivative by a strength
STEP = 1e-3


def drivers(design: Design, tables: Tables) -> Answers:
    """The drivers of every limit of the study, among them its own strength."""
    answers, names = Answers(), design.drawn.names
    if not names:
        return answers
    sample, origin = tables.sample.head(MOST), {"unit": "1", "runs": tables.runs}
    scores = design.drawn.scores(sample.scores.reshape(-1, len(names)))
    gradients = design.drawn.score_gradients(scores).reshape(sample.scores.shape)
    for limit in design.judged.limits:
        state, subject = state_of(design, limit, sample), design.subject(limit)
        moved, tie = np.zeros(gradients.shape), state.tie
        if tie is not None:
            # a strength that depends on an input stays where it was while the input moves
            for step, column in zip(STEP * np.eye(len(tie.columns)), tie.columns, strict=True):
                below, above = (
                    failure_given_inputs(replace(state, tie=replace(tie, scores=at)), limit.aim)
                    for at in (tie.scores - step, tie.scores + step)
                )
                moved[:, :, column] = (below - above) / (2.0 * STEP)
        changes = change_per_sd(failure_given_inputs(state, limit.aim), gradients, moved)
        for name, estimate in zip(names, changes, strict=True):
            if limit_of(name) in (None, limit.name):
                answers.add(subject, "driver", name, estimate, **origin)
        law = state.strength
        if isinstance(law, Law) and not law.is_steps:
            score, sign = score_of(*law.tails(state.demands)), 1.0
            if limit.aim == "break":
                sign = -1.0
            low, high = (
                special.ndtr(sign * state.score_given_inputs(score + step)).mean(axis=1)
                for step in (-STEP, STEP)
            )
            change = from_replicates((low - high) / (2.0 * STEP), "difference", tables.runs)
            answers.add(subject, "driver", strength_name(limit.name), change, **origin)
    return answers


def change_per_sd(
    probabilities: Array, gradients: Array, moved: Array | float = 0.0
) -> list[Estimate]:
    """Change of the failure probability per standard deviation that an input's centre is moved by.

    For T (R, n) and gradients (R, n, d) of `Joint.score_gradients` it is E[T g_i], by the density
    that moves with the law's centre in normal scores, everything that ties inputs staying as it is;
    T is taken about its mean, which changes nothing but the noise.  `moved` (R, n, d) adds what a
    strength that is tied to the inputs does meanwhile.
    """
    about = probabilities - probabilities.mean()
    rows = (about[:, :, None] * gradients + moved).mean(axis=1)
    return [from_replicates(row, "derivative of the density", probabilities.size) for row in rows.T]
