"""The other contact law: rows of a study that takes its contacts for elastic by name, with contacts
that yield.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uqsphere.errors import StudyError
from uqsphere.models.scene import evaluate_scene
from uqsphere.propagation.demands import with_test_forces
from uqsphere.propagation.design import Design
from uqsphere.propagation.line import Line
from uqsphere.propagation.tables import stacked
from uqsphere.study import load_study
from uqsphere.uq import Sample


def yielding_design(design: Design) -> Design | None:
    """The design of a study read again with contacts that yield, the rig of its crushing tests
    among them; None where the study has such contacts, where none would yield, and for a black box.
    """
    study = design.study
    if study.black_box or study.options.get("contact.law", "hertz") != "hertz":
        return None
    pressures = [
        f"limits.{limit.name}.strength_is=hertz"
        for limit in study.limits
        if limit.quantity == "p_max"
    ]
    for further in ([], pressures):
        try:
            other = load_study(
                study.path,
                [*study.overrides, "contact.law=plastic", *further],
                text=study.text,
            )
        except StudyError:  # a pressure whose meaning has to be said, or nothing that could yield
            continue
        judged = replace(other, limits=(*other.limits, *(mode.limit for mode in design.modes)))
        columns = dict.fromkeys(
            [*study.analysis.quantities, *(limit.quantity for limit in judged.limits)]
        )
        return replace(design, study=other, judged=judged, columns=tuple(columns))
    return None


@dataclass(frozen=True, kw_only=True)
class YieldingRows:
    """Rows with contacts that yield, evaluated where they are asked for."""

    design: Design
    evaluated: dict[float, Sample]

    def along(self, line: Line) -> Line | None:
        """The rows of a line with contacts that yield; None where none of them has an answer."""
        for value, sample in zip(line.values, line.samples, strict=True):
            if value not in self.evaluated or self.evaluated[value].count < sample.count:
                self.evaluated[value] = self._evaluated(value, sample)
        samples = [
            self.evaluated[value].head(sample.count)
            for value, sample in zip(line.values, line.samples, strict=True)
        ]
        if any(sample.failed.all() for sample in samples):
            return None
        return Line(design=self.design, values=line.values, samples=tuple(samples))

    def _evaluated(self, value: float, sample: Sample) -> Sample:
        margins, names = self.design.study.margins, list(self.design.inputs)
        shape = sample.scores.shape[:2]
        columns = [sample.input(name).ravel() for name in names]
        moving = {}
        at_plan = margins is None or margins.limit is not None or np.isnan(value)
        if not at_plan and margins is not None and margins.solve not in names:
            names.append(margins.solve)
            columns.append(np.full(sample.size, value))
            moving[margins.solve] = np.full(shape, value)
        rows = stacked(columns, sample.size)
        evaluated = evaluate_scene(self.design.judged, names, rows, self.design.columns)
        answers = np.where(evaluated.good[:, None], evaluated.values, np.nan)
        answered = sample.with_answers(
            self.design.columns,
            answers.reshape(*shape, -1),
            censored=evaluated.censored.reshape(*shape, -1),
            failed=~evaluated.good.reshape(shape),
        )
        return with_test_forces(self.design, answered, moving)
