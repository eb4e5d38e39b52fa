"""The study with its free scalar elsewhere: rows evaluated there, and the states of limits."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.runner.evaluate import Work, evaluate_points, with_answered
from uqsphere.runner.limits import state_of
from uqsphere.runner.schedule import REPLICATES
from uqsphere.study import Axis, Limit
from uqsphere.uq.limit_state import LimitState
from uqsphere.uq.points import sobol_points
from uqsphere.uq.sample import Sample
from uqsphere.uq.whatif import WhatIf

__all__ = [
    "at_strength",
    "axis_of",
    "draw_points",
    "evaluate_at",
    "limit_state",
]

Array = npt.NDArray[np.float64]

#: points that are drawn at a time
BLOCK: Final = 256


def axis_of(work: Work) -> Axis:
    """The free scalar of a study that has one."""
    assert work.study.margins is not None
    return work.study.margins.axis


@lru_cache(maxsize=64)
def _block(dimension: int, seed: int, number: int) -> Array:
    """Normal scores (R, BLOCK, dimension) of a block of points, drawn together since a sequence is slow to set up."""
    from scipy.special import ndtri

    found = [
        sobol_points(dimension=dimension, count=BLOCK, start=number * BLOCK, seed=seed, task="margins", replicate=r)
        for r in range(REPLICATES)
    ]
    return np.asarray(ndtri(np.stack(found)))


def _normals(dimension: int, seed: int, start: int, count: int) -> Array:
    """The same normal scores (R, count, dimension) at every value."""
    blocks = range(start // BLOCK, (start + count - 1) // BLOCK + 1)
    together = np.concatenate([_block(dimension, seed, number) for number in blocks], axis=1)
    first = start - blocks[0] * BLOCK
    return np.asarray(together[:, first : first + count])


def draw_points(work: Work, *, start: int, count: int) -> Sample:
    """The points `start` to `start + count` of every replicate, not evaluated."""
    normals = _normals(len(work.drawn.names), work.study.seed, start, count)
    flat = normals.reshape(normals.shape[0] * normals.shape[1], normals.shape[2])
    physical = work.drawn.physical(flat).reshape(normals.shape)
    return Sample.at(work.drawn.names, normals, physical)


def evaluate_at(work: Work, value: float, *, start: int, count: int, tag: str = "") -> Sample:
    """The points `start` to `start + count` of every replicate, the same random numbers at every value."""
    axis = axis_of(work)
    moved = replace(work, study=axis.move(work.study, value))
    points = draw_points(moved, start=start, count=count)
    names, rows = axis.place(moved.study, points.inputs[:, :, : len(moved.scene_names)], value)
    key = f"margins{tag}.{value:.12e}.{start}.{count}".replace("+", "p")
    flat = rows.reshape(rows.shape[0] * rows.shape[1], rows.shape[2])
    # without scatter in the scene one row stands for all
    answered = evaluate_points(moved, key, names, flat if rows.shape[2] else flat[:1])
    return with_answered(work, points, answered)


def limit_state(work: Work, limit: Limit, points: Sample, demands: Array, value: float) -> LimitState:
    """The state of a limit at a value, with demands (R, n) before its model factor, all of them known."""
    full = np.ones((*demands.shape, len(work.quantities)))
    full[:, :, work.quantities.index(limit.quantity)] = demands
    sample = points.with_answers(work.quantities, full)
    return at_strength(work, limit, state_of(work, limit, sample), value)


def at_strength(work: Work, limit: Limit, state: LimitState, value: float) -> LimitState:
    """The state of a limit where the free scalar has a value: moved where that is the limit's own strength.

    All values of the strength go in proportion to the mean, or the demands the other way.
    """
    return WhatIf(demands=axis_of(work).demand_factor(limit, value)).of(state)
