"""What drives a failure probability: its change per standard deviation that the centre of an input is moved by."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from uqsphere.results import Answers
from uqsphere.run.design import Design
from uqsphere.run.limits import chances, state_of
from uqsphere.study import limit_of, strength_name
from uqsphere.uq import Law, from_replicates, score_of
from uqsphere.uq.failure_indices import score_gradients, sway_estimates

if TYPE_CHECKING:
    from uqsphere.run.grow import Tables

#: points of a replicate that the derivatives rest on at most
MOST = 2048
#: step of a score, for the derivative by a strength
STEP = 1e-3


def drivers(design: Design, tables: Tables) -> Answers:
    """The drivers of every limit of the study, among them its own strength."""
    answers = Answers()
    names = design.drawn.names
    if not names:
        return answers
    sample = tables.sample.head(min(tables.sample.count, MOST))
    scores = design.drawn.scores(sample.scores.reshape(-1, len(names)))
    gradients = score_gradients(design.drawn, scores).reshape(sample.scores.shape)
    for limit in design.study.limits:
        state, subject = state_of(design, limit, sample), design.subject(limit)
        moved = None
        if state.shift is not None:
            # a strength that depends on an input stays where it was while the input moves
            moved = np.stack([(chances(replace(state, shift=state.shift - w * STEP), limit.aim)
                               - chances(replace(state, shift=state.shift + w * STEP), limit.aim)) / (2.0 * STEP)
                              for w in state.weights], axis=2)  # fmt: skip
        found = sway_estimates(chances(state, limit.aim), gradients, moved)
        for name, estimate in zip(names, found, strict=True):
            if limit_of(name) in (None, limit.name):
                answers.add(subject, "driver", name, estimate, unit="1", runs=sample.size)
        law = state.strength
        if isinstance(law, Law) and not law.is_steps:
            below, above = law.cdf(state.demands), law.sf(state.demands)
            rows = []
            for step in (-STEP, STEP):
                score = state.score_given_inputs(score_of(below, above) + step)
                from scipy.special import ndtr

                rows.append(ndtr(-score if limit.aim == "break" else score).mean(axis=1))
            change = from_replicates((rows[0] - rows[1]) / (2.0 * STEP), "difference", sample.size)
            answers.add(subject, "driver", strength_name(limit.name), change, unit="1", runs=sample.size)
    return answers
