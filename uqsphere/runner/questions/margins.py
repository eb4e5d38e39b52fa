"""Margins: the answers of inverse questions, what each is made of, and whether the model holds there.

What a margin is made of concerns one limit at one probability, that of its target or the smallest that is asked for:
safety factors, the inputs it is lost to, what few tests leave open, and the bars' own limit.  The checks of the pilot
are repeated on a sample of its own at that value: bars that are elastic at the planned speed may yield at the speed
that is said to be allowed, or needed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import UqsphereError
from uqsphere.mechanics.bars import pulse_stress
from uqsphere.model import scene_of, solve_scene
from uqsphere.results import CheckEntry
from uqsphere.runner.axis_rows import axis_of
from uqsphere.runner.chunks import remembered
from uqsphere.runner.evaluate import OutOfBudget, Work, draw
from uqsphere.runner.fidelity import check_table
from uqsphere.runner.limits import state_of
from uqsphere.runner.questions.curves import (
    LATE,
    Band,
    Coarse,
    CurveFound,
    EnergyCurve,
    accepted,
    asked_probabilities,
    curves_along,
    energy_curve,
    family_curves,
    member_values,
)
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.runner.questions.probabilities import find_design
from uqsphere.runner.whatif import laws_of, more_tests, value_range
from uqsphere.study import Limit
from uqsphere.study.axis import SPEED, strength_name
from uqsphere.uq.curve import LognormalCurve, fit_lognormal_curve, fragility
from uqsphere.uq.estimate import Estimate, absent
from uqsphere.uq.fitting import count_tests, is_fitted
from uqsphere.uq.law import Law, LawError
from uqsphere.uq.limit_state import LimitState
from uqsphere.uq.sample import Sample

if TYPE_CHECKING:
    from uqsphere.mechanics.outputs import Answers

__all__ = ["YIELD_FACTOR", "MarginAnswer", "find_margins", "judge_answers", "unmoved_margins"]

#: share of the budget of evaluations that all curves together may take
SHARE: Final = 0.1
#: contact pressure at which the bars' ends begin to yield, over their yield strength (Johnson 1985, section 6.2)
YIELD_FACTOR: Final = 1.6
#: bars that yield under the contact in more of the cases than this are not called elastic, whatever the limit
BARS_SHARE: Final = 0.01
#: scenes that are checked at each answer
CHECKED: Final = 128


@dataclass(frozen=True, kw_only=True)
class MarginAnswer:
    """Fragility curve of one limit and the values of the free scalar at the probabilities asked for.

    `lognormal` is the lognormal curve beside it, or why there is none; `family` holds the curves at other values of
    another number, as tables for results.json, and `about` what the margin is made of; `against` is the curve over the
    specific energy, where that is asked for; `band` is how well the curve is known, `coarse` what its steps lack;
    `bands` and `steps` hold the same of the curves of the family, by what they are called.
    """

    values: Mapping[float, Estimate]
    curve: list[list[float]]
    missed: list[str] = field(default_factory=list)
    lognormal: LognormalCurve | str = "no curve could be computed"
    family: list[dict[str, Any]] = field(default_factory=list)
    about: dict[str, Any] = field(default_factory=dict)
    against: EnergyCurve | None = None
    band: Band | None = None
    coarse: Coarse | None = None
    bands: dict[str, Band] = field(default_factory=dict)
    steps: dict[str, Coarse] = field(default_factory=dict)


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
    most = int(SHARE * work.study.analysis.budget.evaluations / curves)
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
        family=[
            {"value": value, "values": {}, "curve": [], "lognormal": None, "reason": member}
            if isinstance(member, str)
            else member.member(value)
            for value, member in members.items()
        ],
        about=_described(work, sampled, _Where(limit=limit, probability=_decisive(work, limit), found=found)),
        against=(against and energy_curve(found.rows, limit, against, asked_probabilities(work, limit))) or None,
        band=found.band,
        coarse=found.coarse,
        bands={at: one.band for at, one in drawn.items() if one.band is not None},
        steps={at: one.coarse for at, one in drawn.items() if one.coarse is not None},
    )


def _decisive(work: Work, limit: Limit) -> float:
    """The probability that a margin is told for: that of the limit's target, or the smallest that is asked for."""
    assert work.study.margins is not None
    return accepted(limit) or min(work.study.margins.for_probability)


def _unknown(work: Work, limit: Limit, reason: str, against: str | None) -> MarginAnswer:
    """What is said of a limit without a curve: why every value is absent."""
    nothing = absent(reason, "none", 0)
    return MarginAnswer(
        values=dict.fromkeys(asked_probabilities(work, limit), nothing), curve=[], missed=[reason], lognormal=reason,
        about={"probability": _decisive(work, limit), "value": nothing.as_dict()},
        against=None if against is None else EnergyCurve.none(against, reason),
    )  # fmt: skip


# --- what a margin is made of ------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class _Where:
    """One limit at one probability of exceeding, and its curve."""

    limit: Limit
    probability: float
    found: CurveFound

    @property
    def value(self) -> Estimate:
        known = self.found.values.get(self.probability)
        return known or self.found.answer((self.probability,)).values[self.probability]


def _described(work: Work, sampled: Sampled, where: _Where) -> dict[str, Any]:
    """A table for results.json; parts that are not known hold a reason."""
    value = where.value
    known = value.value is not None
    about: dict[str, Any] = {
        "probability": where.probability,
        "value": value.as_dict(),
        "factors": safety_factors(work, sampled, where.limit),
    }
    try:
        about["lost_to"] = _lost_to(work, where) if known else {"reason": value.reason}
    except OutOfBudget:
        about["lost_to"] = {"reason": "the time was over, or the run was stopped"}
    strength = where.limit.strength
    if isinstance(strength, Law) and is_fitted(strength):
        try:
            left: dict[str, Any] = _left_open(work, where, strength) if known else {"reason": value.reason}
            about["ignorance"] = left
            about["more_tests"] = more_tests(work, sampled, where.limit, strength, left.get("sd_log"))
        except LawError as error:
            about["ignorance"] = {"reason": str(error)}
    about["split"] = _split(where, about.get("ignorance"))
    asked = work.study.margins is not None and work.study.margins.bars_elastic
    if asked or _tells_of_bars(work, where):
        about["bars"] = _bars(work, where)
    return about


# --- factors -------------------------------------------------------------------------------------------


def safety_factors(work: Work, sampled: Sampled, limit: Limit) -> dict[str, Any]:
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


def _lost_to(work: Work, where: _Where) -> dict[str, Any]:
    """Importance factors of the design point at the value, and the partial factors there."""
    assert where.value.value is not None
    placed = study_at(work, where.limit, where.value.value)
    if isinstance(placed, str):
        return {"reason": placed}
    moved, limit = placed
    own = strength_name(limit.name)
    found = find_design(moved, limit)
    if isinstance(found, str):
        if found.startswith("nothing but") and isinstance(limit.strength, Law):
            return {"shares": {own: 1.0}, "partial": {}}
        return {"reason": found}
    laws = {**dict(zip(moved.drawn.names, moved.drawn.laws, strict=True))}
    if isinstance(limit.strength, Law):
        laws[own] = limit.strength
    partial = {}
    for name, design in found.values.items():
        if name == own:
            low = 0.05 if limit.aim == "survive" else 0.95
            typical = _strength_at(limit.strength, low)
            partial[name] = {"design": design, "characteristic": typical, "factor": typical / design}
        elif (middle := laws[name].median()) != 0.0:
            partial[name] = {"design": design, "characteristic": middle, "factor": design / middle}
    return {"shares": found.shares, "partial": partial}


# --- scatter, ignorance, numerical error ---------------------------------------------------------------


def _split(where: _Where, ignorance: dict[str, Any] | None) -> dict[str, float | None]:
    """Standard deviations of the logarithm of the value: from specimen to specimen, from few tests, of computing."""
    found, logarithmic = where.found, where.found.grid[0] > 0.0
    fitted = fit_lognormal_curve(found.grid, found.table, evaluations=0) if logarithmic else "no logarithm"
    value = where.value
    numerical = None
    if value.value is not None and value.std_error is not None and logarithmic:
        numerical = value.std_error / value.value
    return {
        "scatter": None if isinstance(fitted, str) else fitted.dispersion.value,
        "ignorance": None if ignorance is None else ignorance.get("sd_log"),
        "numerical": numerical,
    }


def _left_open(work: Work, where: _Where, strength: Law) -> dict[str, Any]:
    """Where the value may lie over the laws that the tests allow.  Raises LawError where these are not known."""
    rows, limit, table = where.found.rows, where.limit, where.found.table
    if rows is None:
        reason = "the demands are not known in full, so that no rows serve all values"
        return {"tests": count_tests(strength), "reason": reason}
    return value_range(
        strength, laws_of(work, limit, strength), lambda values, count: rows.states(limit, values, count),
        (rows.grid[0], rows.grid[-1]), probability=where.probability, value=where.value.value,
        rising=bool(table[-1].mean() >= table[0].mean()), survive=limit.aim == "survive",
    )  # fmt: skip


# --- bars that must stay elastic -----------------------------------------------------------------------


def _tells_of_bars(work: Work, where: _Where) -> bool:
    """Whether the curve has the contact pressure anyhow, along a scalar that moves it, for bars that may yield."""
    study = work.study
    return (
        not study.black_box
        and study.margins is not None
        and study.margins.axis.moves_rows
        and study.at_means().get("bars.yield_strength", 0.0) > 0.0
        and "p_max" in work.quantities
        and where.found.rows is not None
        and where.found.rows.knows("p_max")
    )


def _bars(work: Work, where: _Where) -> dict[str, Any]:
    """The values at which the bars yield, in the pulse and in some cases under the contact, and how often they do.

    `yields_at` has the share of the cases in which they yield under the contact, by value of the free scalar asked for.
    The pulse's stress is rho_b c_0 v_0/2, the contact's pressure at first yield 1.6 times the yield strength.
    """
    study = work.study
    assert study.margins is not None
    means = study.at_means()
    strength = means["bars.yield_strength"]
    stress = float(pulse_stress(means[SPEED], means["bars.E"], means["bars.density"]))
    found: dict[str, Any] = {
        "yield_strength": strength,
        "pulse_stress": stress,
        "pulse_elastic": stress < strength,
        "pulse_value": means[SPEED] * strength / stress if study.margins.axis.path == SPEED else None,
    }
    rows = where.found.rows
    if rows is None or not study.margins.axis.moves_rows or not rows.knows("p_max"):
        return {**found, "contact": None, "reason": "no curve of the contact pressure was computed"}
    names = work.drawn.names
    random = "bars.yield_strength" in names

    def yields(points: Sample, pressures: Array, value: float) -> LimitState:
        own = points.input("bars.yield_strength") if random else strength
        return LimitState(demands=pressures / own, strength=YIELD_FACTOR)

    values, share = np.array(rows.grid), rows.curve_of("p_max", yields).table(rows.grid)
    answered = fragility(values, share, (BARS_SHARE,), samples=rows.samples, evaluations=0).values[BARS_SHARE]
    found["contact_probability"] = BARS_SHARE
    found["contact"] = answered.as_dict()
    shares = share.mean(axis=1)
    told = {**where.found.values, where.probability: where.value}
    found["yields_at"] = {
        f"{p:.15g}": float(np.clip(np.interp(e.value, values, shares), 0.0, 1.0))
        for p, e in told.items()
        if e.value is not None and values[0] <= e.value <= values[-1]
    }
    if answered.value is None:
        p = share.mean(axis=1)
        always, never = bool((p > BARS_SHARE).all()), bool((p < BARS_SHARE).all())
        found["contact_everywhere"] = "yields" if always else "elastic" if never else None
    return found


# --- whether the model holds there -------------------------------------------------------------------------


def judge_answers(work: Work, margins: Mapping[str, MarginAnswer]) -> dict[str, MarginAnswer]:
    """The margins with `validity` in what is told about them: the value of the free scalar and the checks there.

    Nothing is added where there is no value, where the scene is the same at every value (a strength is the free
    scalar), or where the budget of evaluations has nothing left.
    """
    if work.study.margins is None or work.study.black_box or not axis_of(work).moves_rows:
        return dict(margins)
    found, seen = dict(margins), dict[float, list[CheckEntry] | None]()
    for limit in work.study.limits:
        margin = margins.get(limit.name)
        value = ((margin.about.get("value") or {}) if margin else {}).get("value")
        if margin is None or value is None:
            continue
        if value not in seen:
            seen[value] = _checks_at(work, limit, float(value))
        checks = seen[value]
        if checks is not None:
            tables = [one.document() for one in checks]
            about = {**margin.about, "validity": {"value": float(value), "samples": CHECKED, "checks": tables}}
            found[limit.name] = replace(margin, about=about)
    return found


def _checks_at(work: Work, limit: Limit, value: float) -> list[CheckEntry] | None:
    """Checks with the free scalar at a value; None where they cannot be made."""
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
    tolerance = moved.study.model.tolerance

    def solved() -> Answers:
        return solve_scene(scene, "full", tolerance=tolerance, threads=work.threads, quantities=None)

    answers = remembered(work.store, "validity.full", scene, ["full", tolerance, None], solved)
    work.ledger.evaluations["full"] = work.ledger.evaluations.get("full", 0) + count
    return check_table(scene, answers, work.quantities)
