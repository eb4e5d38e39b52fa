"""Descriptions of outputs whose moments do not exist: withheld, with the reason, where a law of an input has none."""

from __future__ import annotations

from typing import TYPE_CHECKING

from uqsphere.uq.heavy_tails import HeavyTail, heavy_tail, without_moments

if TYPE_CHECKING:
    from uqsphere.runner.evaluate import Work
    from uqsphere.uq.describe import Description
    from uqsphere.uq.sample import Sample

__all__ = ["describe_heavy", "tail_of"]


def tail_of(work: Work, sample: Sample, quantity: str) -> HeavyTail | None:
    """The tail that a quantity inherits of the laws of the inputs."""
    d = len(work.scene_names)
    if d == 0:
        return None
    laws = {name: work.study.random[name] for name in work.scene_names}
    return heavy_tail(laws, sample.inputs[:, :, :d].reshape(-1, d), sample.outputs(quantity))


def describe_heavy(work: Work, sample: Sample, descriptions: dict[str, Description]) -> dict[str, Description]:
    """The same without moments that do not exist."""
    return {
        name: without_moments(found, tail_of(work, sample, name), sample.outputs(name))
        for name, found in descriptions.items()
    }
