"""The paper's numbers as printed, beside the corrected ones, in the units that people read."""

import math

from uqsphere.mechanics.as_printed import PaperValue, compare_with_paper
from uqsphere.models.scene import scene_of
from uqsphere.quantities import display_unit
from uqsphere.study import Study

from .types import PaperRow


def paper_of(study: Study) -> list[PaperRow]:
    """The paper's formulas for the scene of a study, every number at its mean; none for a study
    without `compare_with_paper`.
    """
    if not study.model.compare_with_paper:
        return []
    return list(map(paper_row, compare_with_paper(scene_of(study, {}))))


def paper_row(value: PaperValue) -> PaperRow:
    """A value as people read it; the note gives the full model's."""
    unit, factor = display_unit(value.unit_of)
    note = value.note
    if math.isfinite(value.full):
        note += f"; full model: {value.full * factor:.4g} {unit}".rstrip()
    return PaperRow(
        name=value.name,
        printed=value.printed * factor,
        corrected=value.corrected * factor,
        unit=unit,
        note=note,
    )
