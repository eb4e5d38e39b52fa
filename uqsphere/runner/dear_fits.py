"""Surrogates fitted to the design of a dear model."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

from uqsphere.runner.evaluate import Work
from uqsphere.runner.questions.indices import dependent_names
from uqsphere.runner.schedule import SURROGATE
from uqsphere.uq.augmented import MOST, Trusted, trust

if TYPE_CHECKING:
    from uqsphere.uq.expansion import Chaos
    from uqsphere.uq.sample import Sample

__all__ = ["fit_design", "simpler_fits"]


def fit_design(
    work: Work, design: Sample, before: dict[int, Chaos], most: float = 1.0
) -> tuple[dict[str, Trusted], dict[int, Chaos]]:
    """Surrogates of all quantities, each checked by runs that the fit before had not seen; the fits by number.

    `most` is the error from which on simpler ones may take their place (`fit_chaos`).
    """
    from uqsphere.uq.expansion import fit_outputs, germ_points

    d, germs = len(work.scene_names), work.germs
    whole = ~design.failed[0]
    if design.count < SURROGATE.first or (not whole.all() and work.study.analysis.on_failure != "drop"):
        return {}, {}
    points = germ_points(design.scores[0, :, :d], germs)[whole]
    outputs = design.answers[0][whole]
    if len(outputs) < SURROGATE.first // 2:
        return {}, {}
    if not before:
        half = len(outputs) // 2
        before = dict(enumerate(fit_outputs(points[:half], outputs[:half], germs, most=most)))
    fits = dict(enumerate(fit_outputs(points, outputs, germs, most=most)))
    checked = {
        quantity: trust(fits[k], points, outputs[:, k], before.get(k)) for k, quantity in enumerate(work.quantities)
    }
    return checked, fits


def simpler_fits(work: Work, design: Sample, rough: Collection[str]) -> dict[str, Trusted]:
    """Surrogates that may be used of quantities that are too rough for the best: their indices are all they tell.

    None where inputs depend on each other.
    """
    if not rough or dependent_names(work):
        return {}
    found, _ = fit_design(work, design, {}, MOST)
    return {quantity: one for quantity, one in found.items() if quantity in rough and one.usable}
