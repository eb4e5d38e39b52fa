"""Margins: the answers of inverse questions, and whether the model holds there.

The checks of the pilot are repeated on a sample of its own at each answer: bars that are elastic at the planned speed
may yield at the speed that is said to be allowed, or needed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import UqsphereError
from uqsphere.mechanics.bars import pulse_stress
from uqsphere.mechanics.yielding import metal_onset
from uqsphere.model import scene_of
from uqsphere.quantities import lookup
from uqsphere.results.entries import Fields, MarginOpenEntry, ValidityAtEntry
from uqsphere.runner.axis_rows import AxisRows, axis_of
from uqsphere.runner.evaluate import OutOfBudget, Work, draw
from uqsphere.runner.fidelity import check_table, solved
from uqsphere.runner.limits import state_of
from uqsphere.runner.questions.curves import (
    LATE,
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
from uqsphere.runner.questions.probabilities import find_design
from uqsphere.runner.schedule import CHECKED, CURVE
from uqsphere.runner.whatif import margin_left_open
from uqsphere.study import SPEED, Limit, Study, quantity_of, strength_name
from uqsphere.uq import Estimate, Law, LimitState, Sample, absent
from uqsphere.uq.curve import LognormalCurve, fit_lognormal_curve, fragility


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
        found = dict.fromkeys((limit.name for limit in limits), LATE)
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
    return found.member(value)


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


# --- what a margin is made of --------------------------------------------------------------------------------------

#: bars that yield under the contact in more of the cases than this are not called elastic, whatever the limit
BARS_SHARE: Final = 0.01


def describe_margin(work: Work, sampled: Sampled, limit: Limit, probability: float, found: CurveFound) -> Fields:
    """A table for results.json of one limit at one probability of exceeding it, by its curve; parts that are not known
    hold a reason."""
    value, margins = found.value_at(probability), work.study.margins
    assert margins is not None
    about: Fields = {
        "probability": probability,
        "value": value,
        "factors": safety_factors(work, sampled, limit),
        "lost_to": {"reason": value.reason},
    }
    try:
        if value.value is not None:
            about["lost_to"] = _lost_to(work, limit, value.value)
    except OutOfBudget:
        about["lost_to"] = {"reason": "the time was over, or the run was stopped"}
    rising = bool(found.table[-1].mean() >= found.table[0].mean())
    left = margin_left_open(work, sampled, limit, found.rows, value, probability=probability, rising=rising)
    about |= {**left, "split": _split(found, value, left.get("ignorance"))}
    if value.value is not None and (also := _also(work, value)):
        about["also"] = also
    # bars that may yield, where the curve has the contact pressure anyhow; else the answers hold what yields
    bars = not work.study.black_box and work.study.at_means().get("bars.yield_strength", 0.0) > 0.0
    elastic = bars and work.study.options.get("contact.law", "hertz") == "hertz"
    moving = found.rows if margins.axis.moves_rows and "p_max" in work.quantities else None
    moving = moving if moving is not None and moving.knows("p_max") else None
    if margins.bars_elastic or (elastic and moving is not None):
        about["bars"] = _bars(work, {**found.values, probability: value}, moving)
    return about


def _split(found: CurveFound, value: Estimate, ignorance: object) -> dict[str, float | None]:
    """Standard deviations of the logarithm of the value: from specimen to specimen, from few tests, of computing."""
    left = ignorance.sd_log if isinstance(ignorance, MarginOpenEntry) else None
    scatter = numerical = None
    if found.grid[0] > 0.0:
        fitted = fit_lognormal_curve(found.grid, found.table, evaluations=0)
        scatter = None if isinstance(fitted, str) else fitted.dispersion.value
        if value.value is not None and value.std_error is not None:
            numerical = value.std_error / value.value
    return {"scatter": scatter, "ignorance": left, "numerical": numerical}


def _also(work: Work, value: Estimate) -> Fields:
    """A speed or a height of a fall as the other, and as the energy that the blow offers per mass; at the means."""
    path, study = axis_of(work).path, work.study
    table, _, key = path.partition(".")
    if study.rig == "bars" or key not in ("speed", "drop_height") or table == "platens":
        return {}
    ends = [value.value, value.low, value.high]
    known = [end for end in ends if end is not None]
    scene = scene_of(study, {path: np.array(known)})
    square = np.sin(scene.column("rig.angle", 0.5 * np.pi))
    found = {"specific_impact_energy": 0.5 * scene.scales.force * scene.scales.approach / scene.scales.mass}
    if key == "drop_height":
        found[f"{table}.speed"] = scene.closing_speed / square
    answers: Fields = {}
    for name, column in found.items():
        read = iter(column.tolist())
        numbers = [None if end is None else next(read) for end in ends]
        method = f"from {path}, the rest of the scene at its means"
        answers[name] = replace(value, value=numbers[0], low=numbers[1], high=numbers[2], std_error=None,
                                method=method)  # fmt: skip
    return answers


# --- factors -------------------------------------------------------------------------------------------


def safety_factors(work: Work, sampled: Sampled, limit: Limit) -> Fields:
    """Strength over demand as planned: of their medians, and of the two fractiles that lie against the aim.

    To survive: 5 % of the strength over 95 % of the demand, above 1 where it is safe; to break: 95 % over 5 %, below 1.
    """
    state = state_of(work, limit, sampled.sample)
    demands = state.demands[~state.broken & ~state.late]
    if demands.size < 20:
        return {"reason": "too few demands are known"}
    against = (0.05, 0.95) if limit.aim == "survive" else (0.95, 0.05)
    strengths = {p: _strength_at(limit.strength, p) for p in (0.5, against[0])}
    middle, far = (float(q) for q in np.quantile(demands, [0.5, against[1]]))
    if not (middle > 0.0 and far > 0.0):
        return {"reason": "the demand may be zero"}
    return {
        "medians": strengths[0.5] / middle,
        "fractiles": strengths[against[0]] / far,
        "fractiles_of": {"strength": against[0], "demand": against[1]},
    }


def _strength_at(strength: Law | float, p: float) -> float:
    return float(strength.ppf(np.array([p]))[0]) if isinstance(strength, Law) else strength


def study_at(work: Work, limit: Limit, value: float) -> tuple[Work, Limit] | str:
    """The work and the limit with the free scalar at a value, for a search of its own."""
    found = axis_of(work).fix(work.study, limit, value)
    return found if isinstance(found, str) else (replace(work, study=found[0]), found[1])


def _lost_to(work: Work, limit: Limit, value: float) -> Fields:
    """Importance factors of the design point at the value, and the partial factors there."""
    placed = study_at(work, limit, value)
    if isinstance(placed, str):
        return {"reason": placed}
    moved, limit = placed
    own = strength_name(limit.name)
    if not moved.drawn.names and isinstance(limit.strength, Law):
        return {"shares": {own: 1.0}, "partial": {}}
    found = find_design(moved, limit)
    if isinstance(found, str):
        return {"reason": found}
    laws = dict(zip(moved.drawn.names, moved.drawn.laws, strict=True))
    if isinstance(limit.strength, Law):
        laws[own] = limit.strength
    partial = {}
    for name, design in found.values.items():
        low = 0.05 if limit.aim == "survive" else 0.95
        typical = _strength_at(limit.strength, low) if name == own else laws[name].median()
        if name == own or typical != 0.0:
            factor = typical / design if name == own else design / typical
            partial[name] = {"design": design, "characteristic": typical, "factor": factor}
    return {"shares": found.shares, "partial": partial}


# --- bars that must stay elastic -----------------------------------------------------------------------


def _bars(work: Work, told: Mapping[float, Estimate], rows: AxisRows | None) -> Fields:
    """The values at which the bars yield, in the pulse and in some cases under the contact, and how often they do.

    `yields_at` has the share of the cases in which they yield under the contact, by value of the free scalar asked for.
    The pulse's stress is rho_b c_0 v_0/2, the contact's pressure at first yield `metal_onset`.
    """
    study = work.study
    assert study.margins is not None
    means = study.at_means()
    strength = means["bars.yield_strength"]
    stress = float(pulse_stress(means[SPEED], means["bars.E"], means["bars.density"]))
    found: Fields = {
        "yield_strength": strength,
        "pulse_stress": stress,
        "pulse_elastic": stress < strength,
        "pulse_value": means[SPEED] * strength / stress if study.margins.axis.path == SPEED else None,
    }
    if rows is None:
        return {**found, "contact": None, "reason": "no curve of the contact pressure was computed"}
    names = work.drawn.names

    def yields(points: Sample, pressures: Array, value: float) -> LimitState:
        paths = [
            f"bars.insert_{key}" if f"bars.insert_{key}" in means else f"bars.{key}" for key in ("yield_strength", "nu")
        ]
        strength, nu = (points.input(path) if path in names else means[path] for path in paths)
        return LimitState(demands=pressures / metal_onset(strength, nu), strength=1.0)

    values, share = np.array(rows.grid), rows.curve_of("p_max", yields).table(rows.grid)
    answered = fragility(values, share, (BARS_SHARE,), samples=rows.samples, evaluations=0).values[BARS_SHARE]
    found["contact_probability"] = BARS_SHARE
    found["contact"] = answered
    shares = share.mean(axis=1)
    found["yields_at"] = {
        f"{p:.15g}": float(np.clip(np.interp(e.value, values, shares), 0.0, 1.0))
        for p, e in told.items()
        if e.value is not None and values[0] <= e.value <= values[-1]
    }
    if answered.value is None:
        always, never = bool((shares > BARS_SHARE).all()), bool((shares < BARS_SHARE).all())
        found["contact_everywhere"] = "yields" if always else "elastic" if never else None
    return found
