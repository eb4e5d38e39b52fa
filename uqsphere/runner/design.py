"""The design of pick and freeze for a study: which blocks, their outputs, and what failures leave of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from uqsphere.model import is_answered
from uqsphere.runner.work import MOST_DROPPED, REPLICATES, Work, evaluate_points, sub_inputs
from uqsphere.uq.blocks import Blocks, uniform_halves

__all__ = ["blocks_of", "helpers_of", "lost_designs", "pick_and_freeze", "surrogate_outputs"]

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


def blocks_of(work: Work) -> Blocks:
    """The blocks that the study's indices take: those of first and total indices come first."""
    names = work.scene_names
    analysis = work.study.analysis
    return Blocks(
        inputs_count=len(names),
        second=analysis.second_order and len(names) > 1,
        groups=tuple(tuple(names.index(name) for name in group) for group in analysis.groups.values()),
    )


def pick_and_freeze(work: Work, key: str, start: int, count: int, blocks: Blocks | None = None) -> tuple[Array, Flags]:
    """Outputs (R, count, blocks, q) and failures (R, count) of more base points of the design.

    Without `blocks` those of first and total indices alone, d + 2.
    """
    from uqsphere.uq.joint import physical_from_normal

    inputs = sub_inputs(work.all_inputs, work.scene_names)
    blocks = blocks or Blocks(inputs_count=len(inputs.names))
    # the inputs are independent here, so the halves are mapped once and mixed afterwards
    rows = [
        blocks.mix(*(physical_from_normal(inputs, half) for half in halves))
        for halves in _normal_halves(work, start, count, blocks)
    ]
    answered = evaluate_points(work, key, work.scene_names, np.stack(rows).reshape(-1, blocks.inputs_count))
    shape = (REPLICATES, count, blocks.count)
    values = answered.values.reshape(*shape, len(work.quantities))
    failed = ~is_answered(answered.status).reshape(shape)
    return values, np.asarray(failed.any(axis=2))


def _normal_halves(work: Work, start: int, count: int, blocks: Blocks) -> Iterator[list[Array]]:
    """The halves of every replicate as independent standard normals."""
    from scipy.special import ndtri

    for replicate in range(REPLICATES):
        halves = uniform_halves(
            blocks, count=count, seed=work.study.seed, task="sensitivity", replicate=replicate, start=start
        )
        yield [np.asarray(ndtri(half)) for half in halves]


def surrogate_outputs(work: Work, start: int, count: int, blocks: Blocks, chaoses: Sequence[Chaos]) -> Array:
    """What expansions say at the points of `pick_and_freeze`, (R, count, blocks, len(chaoses))."""
    from uqsphere.uq.surrogate import chaos_outputs

    rows = [
        np.stack([chaos_outputs(chaos, blocks, halves) for chaos in chaoses], axis=-1)
        for halves in _normal_halves(work, start, count, blocks)
    ]
    return np.stack(rows)


def helpers_of(chaoses: Mapping[str, Chaos], blocks: Blocks, outputs: Array | None) -> dict[str, Surrogate]:
    """The expansions as control variates, by quantity, from their outputs (R, N, blocks, len(chaoses))."""
    if outputs is None:
        return {}
    from uqsphere.uq.surrogate import chaos_surrogate

    made = {q: chaos_surrogate(chaos, blocks, outputs[..., k]) for k, (q, chaos) in enumerate(chaoses.items())}
    return {q: surrogate for q, surrogate in made.items() if surrogate is not None}


def lost_designs(failed: Flags) -> str:
    """Why no design of indices is made: too many of its runs would fail; or an empty text.

    A design of pairs loses a base point with any of its runs, and an expansion sees nothing where the model has no
    answer, so that both would answer for laws that nobody gave.
    """
    if failed.mean() <= MOST_DROPPED:
        return ""
    return (
        f"{100.0 * failed.mean():.2g} % of the evaluations failed, and indices of the others would be those of other "
        f"laws; they are given up to {100.0 * MOST_DROPPED:g} %: narrow the inputs to where the model answers"
    )


if TYPE_CHECKING:
    from uqsphere.uq.chaos import Chaos
    from uqsphere.uq.surrogate import Surrogate
