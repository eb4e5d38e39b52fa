"""The other contact law: rows of a study that takes its contacts for elastic by name, with contacts
that yield.
"""

from dataclasses import dataclass, replace

from uqsphere.errors import StudyError
from uqsphere.models.scene import evaluate_scene
from uqsphere.propagation.design import Design
from uqsphere.propagation.line import Line, moving_at
from uqsphere.propagation.tables import answered, input_rows
from uqsphere.study import load_study
from uqsphere.uq import Sample


@dataclass(frozen=True, kw_only=True)
class YieldingRows:
    """Rows with contacts that yield, evaluated where they are asked for."""

    design: Design
    evaluated: dict[float, Sample]

    def along(self, line: Line) -> Line | None:
        """The rows of a line with contacts that yield; None where none of them has an answer."""
        samples = []
        for value, sample in zip(line.values, line.samples, strict=True):
            if value not in self.evaluated or self.evaluated[value].count < sample.count:
                self.evaluated[value] = self._evaluated(value, sample)
            samples.append(self.evaluated[value].head(sample.count))
        if any(sample.failed.all() for sample in samples):
            return None
        return replace(line, design=self.design, samples=tuple(samples))

    def _evaluated(self, value: float, sample: Sample) -> Sample:
        design = self.design
        moving = moving_at(design, value)
        names, rows = input_rows(design, sample, moving)
        answers = evaluate_scene(design.judged, names, rows, design.columns)
        return answered(design, sample, answers, moving)


def yielding_rows(design: Design) -> YieldingRows | None:
    """The rows of a study read again with contacts that yield, the rig of its crushing tests
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
        return YieldingRows(design=replace(design, study=other), evaluated={})
    return None
