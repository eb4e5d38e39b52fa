"""The study with its free scalar elsewhere: rows evaluated there, and the states of limits."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.bars import section
from uqsphere.mechanics.contact import sphere_mass
from uqsphere.runner.limits import state_of
from uqsphere.runner.work import REPLICATES, Work, evaluate_points, with_answered
from uqsphere.study import ENERGY, Limit, Study, law_with_mean
from uqsphere.uq.joint import physical_from_normal
from uqsphere.uq.law import Law, nominal_mean
from uqsphere.uq.reliability import LimitState, tails
from uqsphere.uq.sample import Sample
from uqsphere.uq.sampling import sobol_points

__all__ = [
    "at_strength",
    "draw_points",
    "evaluate_at",
    "limit_state",
    "moved_study",
    "probabilities",
    "strength_solved",
]

Array = npt.NDArray[np.float64]

#: points that are drawn at a time
BLOCK: Final = 256


def strength_solved(name: str) -> str | None:
    """The limit whose strength is the free scalar; None for a number of the scene."""
    parts = name.split(".")
    return parts[1] if len(parts) == 3 and parts[0] == "limits" and parts[2] == "strength" else None


def moved_study(study: Study, name: str, value: float) -> Study:
    """The study with a number at `value`: the mean of its law, or the number itself."""
    if name in study.random:
        return replace(study, random={**study.random, name: law_with_mean(study, name, value)})
    return replace(study, fixed={**study.fixed, name: value})


def _speed_at_energy(work: Work, physical: Array, energy: float) -> Array:
    """Speeds (R, n) at which the striker's kinetic energy is `energy` times the mass of each row's sphere.

    A random speed keeps its ratio to its mean.
    """
    study, names = work.study, work.scene_names

    def column(name: str) -> Array:
        if name in names:
            return np.asarray(physical[:, :, names.index(name)])
        return np.full(physical.shape[:2], study.fixed[name])

    mass = sphere_mass(column("sphere.radius"), column("sphere.density"))
    striker = column("bars.density") * section(column("bars.diameter")) * column("striker.length")
    speed = np.sqrt(2.0 * energy * mass / striker)
    if "striker.speed" in study.random:
        speed = speed * column("striker.speed") / nominal_mean(study.random["striker.speed"])
    return np.asarray(speed)


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
    physical = physical_from_normal(work.drawn, flat).reshape(normals.shape)
    return Sample.at(work.drawn.names, normals, physical)


def evaluate_at(work: Work, value: float, *, start: int, count: int, tag: str = "") -> Sample:
    """The points `start` to `start + count` of every replicate, the same random numbers at every value."""
    assert work.study.margins is not None
    solve = work.study.margins.solve
    energy = solve == ENERGY
    outside = energy or strength_solved(solve) is not None
    moved = work if outside else replace(work, study=moved_study(work.study, solve, value))
    points = draw_points(moved, start=start, count=count)
    names, d = moved.scene_names, len(moved.scene_names)
    rows = points.inputs[:, :, :d]
    if energy:
        speed = _speed_at_energy(work, rows, value)
        if "striker.speed" in names:
            rows = rows.copy()
            rows[:, :, names.index("striker.speed")] = speed
        else:
            names, rows = (*names, "striker.speed"), np.concatenate([rows, speed[:, :, None]], axis=2)
    key = f"margins{tag}.{value:.12e}.{start}.{count}".replace("+", "p")
    flat = rows.reshape(rows.shape[0] * rows.shape[1], rows.shape[2])
    # without scatter in the scene one row stands for all
    answered = evaluate_points(moved, key, names, flat if rows.shape[2] else flat[:1])
    return with_answered(work, points, answered)


def probabilities(state: LimitState) -> Array:
    """Exceedance of every replicate by itself, (R,)."""
    below, above = tails(state)
    total = below.sum(axis=1) + above.sum(axis=1)
    return np.asarray(below.sum(axis=1) / np.where(total > 0.0, total, 1.0))


def limit_state(work: Work, limit: Limit, points: Sample, demands: Array, value: float) -> LimitState:
    """The state of a limit at a value, with demands (R, n) before its model factor, all of them known."""
    assert work.study.margins is not None
    full = np.ones((*demands.shape, len(work.quantities)))
    full[:, :, work.quantities.index(limit.quantity)] = demands
    sample = points.with_answers(work.quantities, full)
    return at_strength(work, limit, state_of(work, limit, sample), value)


def at_strength(work: Work, limit: Limit, state: LimitState, value: float) -> LimitState:
    """The state of a limit where the free scalar has a value: moved where that is the limit's own strength.

    All values of the strength go in proportion to the mean, or the demands the other way.
    """
    assert work.study.margins is not None
    if strength_solved(work.study.margins.solve) != limit.name:
        return state
    nominal = nominal_mean(limit.strength) if isinstance(limit.strength, Law) else limit.strength
    return replace(state, demands=state.demands * (nominal / value))
