"""Descriptions of outputs whose moments do not exist: withheld, with the reason, where a law of an input has none."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from uqsphere.uq.heavy_tails import HeavyTail, heavy_tail, without_moments

if TYPE_CHECKING:
    from uqsphere.runner.work import Draw, Sample, Work
    from uqsphere.uq.estimates import Description
    from uqsphere.uq.families import Array

__all__ = ["describe_heavy", "outputs_of", "tail_of"]


def outputs_of(work: Work, sample: Sample, k: int) -> Array:
    """Answers (n,) of a quantity, nan where there is none."""
    flat: Array = np.where(sample.failed, np.nan, sample.values[:, :, k]).ravel()
    return flat


def tail_of(work: Work, points: Draw, sample: Sample, k: int) -> HeavyTail | None:
    """The tail that a quantity inherits of the laws of the inputs."""
    d = len(work.scene_names)
    if d == 0:
        return None
    laws = {name: work.study.random[name] for name in work.scene_names}
    return heavy_tail(laws, points.physical[:, :, :d].reshape(-1, d), outputs_of(work, sample, k))


def describe_heavy(
    work: Work, points: Draw, sample: Sample, descriptions: dict[str, Description]
) -> dict[str, Description]:
    """The same without moments that do not exist."""
    return {
        name: without_moments(found, tail_of(work, points, sample, k), outputs_of(work, sample, k))
        for (k, name), found in zip(enumerate(work.quantities), descriptions.values(), strict=True)
    }
