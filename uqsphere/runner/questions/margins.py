"""Margins: the answers of inverse questions, and whether the model holds there.

The checks of the pilot are repeated on a sample of its own at each answer: bars that are elastic at the planned speed
may yield at the speed that is said to be allowed, or needed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from uqsphere.errors import UqsphereError
from uqsphere.model import scene_of
from uqsphere.quantities import lookup
from uqsphere.results.entries import Fields, ValidityAtEntry
from uqsphere.runner.axis_rows import axis_of, study_at
from uqsphere.runner.evaluate import OutOfBudget, Work, draw
from uqsphere.runner.fidelity import check_table, solved
from uqsphere.runner.questions.curves import (
    NO_CURVE,
    Band,
    CurveFound,
    EnergyCurve,
    accepted,
    asked_probabilities,
    curves_along,
    energy_curve,
    family_curves,
    lognormal_table,
    member_values,
)
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.runner.questions.margin_parts import describe_margin
from uqsphere.runner.schedule import CHECKED, CURVE
from uqsphere.study import Limit, Study, quantity_of
from uqsphere.uq import Estimate, absent
from uqsphere.uq.curve import LognormalCurve


@dataclass(frozen=True, kw_only=True)
class MarginAnswer:
    """Fragility curve of one limit and the values of the free scalar at the probabilities asked for.

    `lognormal` is the lognormal curve beside it, or why there is none; `family` holds the curves at other values of
    another number, as tables for results.json, and `about` what the margin is made of; `against` is the curve over the
    specific energy, where that is asked for; `band` is how well the curve is known, `bands` the same of the curves
    of the family, by what they are called.
    """

    values: Mapping[float, Estimate]
    curve: list[list[float]]
    missed: list[str] = field(default_factory=list)
    lognormal: LognormalCurve | str = "no curve could be computed"
    family: list[Fields] = field(default_factory=list)
    about: Fields = field(default_factory=dict)
    against: EnergyCurve | None = None
    band: Band | None = None
    bands: dict[str, Band] = field(default_factory=dict)

    @property
    def value(self) -> float | None:
        """The free scalar at the probability that the margin is told for."""
        value = self.about.get("value")
        return value.value if isinstance(value, Estimate) else None

    def entry(self, study: Study) -> Fields:
        """The same as results.json has it."""
        assert study.margins is not None
        path, family = study.margins.axis.path, study.margins.family
        own = quantity_of(path, {limit.name: limit.quantity for limit in study.limits})
        parts = {"against": self.against, "band": self.band}
        return {
            "solve": path,
            "unit": lookup(own).unit,
            "values": self.values,
            "curve": [list(point) for point in self.curve],
            "lognormal": lognormal_table(self.lognormal),
            **({"family": {"path": family.path, "members": self.family}} if family and self.family else {}),
            **{key: part.table() for key, part in parts.items() if part is not None},
            **self.about,
        }


def unmoved_margins(work: Work) -> dict[str, MarginAnswer]:
    """The answers of limits that a free strength of another leaves where they are."""
    own = axis_of(work).limit
    said = f"the free strength is that of limit {own}, which does not move this"
    return {
        limit.name: MarginAnswer(values={}, curve=[], missed=[said], lognormal=said)
        for limit in work.study.limits
        if own is not None and own != limit.name
    }


def find_margins(work: Work, sampled: Sampled) -> dict[str, MarginAnswer]:
    """Fragility curves and margins of every limit; empty where the study asks for none."""
    margins = work.study.margins
    if margins is None or not work.study.limits:
        return {}
    unmoved = unmoved_margins(work)
    limits = [limit for limit in work.study.limits if limit.name not in unmoved]
    curves = 1 + (len(margins.family.values) if margins.family else 0)
    most = int(CURVE.share * work.study.analysis.budget.evaluations / curves)
    try:
        found = curves_along(work, limits, most=most)
    except OutOfBudget:
        found = dict.fromkeys((limit.name for limit in limits), NO_CURVE)
    members = family_curves(work, limits, most)
    return {
        limit.name: unmoved[limit.name]
        if limit.name in unmoved
        else _margin(work, sampled, limit, found[limit.name], {v: member[limit.name] for v, member in members.items()})
        for limit in work.study.limits
    }


def _margin(
    work: Work, sampled: Sampled, limit: Limit, found: CurveFound | str, members: Mapping[float, CurveFound | str]
) -> MarginAnswer:
    """The answer of one limit from its curve and those of the family."""
    assert work.study.margins is not None
    against, family = work.study.margins.against, work.study.margins.family
    if isinstance(found, str):
        return _unknown(work, limit, found, against)
    kin: dict[str, CurveFound | str] = {}
    if family is not None:
        names = member_values(family.path, list(members))
        kin = {f"{family.path} {name}": one for name, one in zip(names, members.values(), strict=True)}
    drawn = {at: curve for at, curve in kin.items() if not isinstance(curve, str)}
    lacking = {at: [curve] if isinstance(curve, str) else curve.missed() for at, curve in kin.items()}
    return MarginAnswer(
        values=found.values,
        curve=found.answer(()).curve,
        missed=[*found.missed(), *(f"at {at}: {text}" for at, texts in lacking.items() for text in texts)],
        lognormal=found.lognormal(),
        family=[_member(value, member) for value, member in members.items()],
        about=describe_margin(work, sampled, limit, decisive(work, limit), found),
        against=(against and energy_curve(found.rows, limit, against, asked_probabilities(work, limit))) or None,
        band=found.band,
        bands={at: one.band for at, one in drawn.items()},
    )


def _member(value: float, found: CurveFound | str) -> Fields:
    if isinstance(found, str):
        return {"value": value, "values": {}, "curve": [], "lognormal": None, "reason": found}
    return {
        "value": value,
        "values": found.values,
        "curve": [list(row) for row in found.answer(()).curve],
        "lognormal": lognormal_table(found.lognormal()),
        "band": found.band.table(),
    }


def _unknown(work: Work, limit: Limit, reason: str, against: str | None) -> MarginAnswer:
    nothing = absent(reason, "none", 0)
    return MarginAnswer(
        values=dict.fromkeys(asked_probabilities(work, limit), nothing), curve=[], missed=[reason], lognormal=reason,
        about={"probability": decisive(work, limit), "value": nothing},
        against=None if against is None else EnergyCurve.none(against, reason),
    )  # fmt: skip


def decisive(work: Work, limit: Limit) -> float:
    """The probability that a margin is told for: that of the limit's target, or the smallest that is asked for."""
    assert work.study.margins is not None
    return accepted(limit) or min(work.study.margins.for_probability)


# --- whether the model holds there -------------------------------------------------------------------------


def judge_answers(work: Work, margins: Mapping[str, MarginAnswer]) -> dict[str, MarginAnswer]:
    """The margins with `validity` in what is told about them: the value of the free scalar and the checks there.

    Nothing is added where there is no value, where the scene is the same at every value (a strength is the free
    scalar), or where the budget of evaluations has nothing left.
    """
    if work.study.margins is None or work.study.black_box or not axis_of(work).moves_rows:
        return dict(margins)
    found, seen = dict(margins), dict[float, ValidityAtEntry | None]()
    for limit in work.study.limits:
        margin = margins.get(limit.name)
        value = None if margin is None else margin.value
        if margin is None or value is None:
            continue
        if value not in seen:
            seen[value] = _checks_at(work, limit, float(value))
        judged = seen[value]
        if judged is not None:
            found[limit.name] = replace(margin, about={**margin.about, "validity": judged.document()})
    return found


def _checks_at(work: Work, limit: Limit, value: float) -> ValidityAtEntry | None:
    """Checks, force and energy with the free scalar at a value; None where they cannot be made."""
    count = CHECKED if work.scene_names else 1
    placed = study_at(work, limit, value)
    if isinstance(placed, str) or work.ledger.total + count > work.study.analysis.budget.evaluations:
        return None
    moved = placed[0]
    points = draw(
        moved.all_inputs.only(moved.scene_names),
        seed=moved.study.seed, task="pilot", start=0, count=count, replicates=1,
    )  # fmt: skip
    rows = {name: points.input(name)[0] for name in moved.scene_names}
    try:
        scene = scene_of(moved.study, rows, count)
    except UqsphereError:
        return None
    answers = solved(moved, "validity.full", scene, None)
    return ValidityAtEntry(
        value=value,
        samples=CHECKED,
        checks=tuple(check_table(scene, answers, work.quantities)),
        medians={
            name: float(np.nanmedian(answers.values[name]))
            for name in ("P_max", "specific_energy")
            if name in answers.values and np.isfinite(answers.values[name]).any()
        },
    )
