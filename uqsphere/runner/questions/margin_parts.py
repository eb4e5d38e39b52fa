"""What a margin is made of: factors, what it is lost to, what scatter, few tests and computing leave, yielding bars."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.mechanics.bars import pulse_stress
from uqsphere.mechanics.yielding import metal_onset
from uqsphere.model import scene_of
from uqsphere.results.entries import Fields, MarginOpenEntry
from uqsphere.runner.axis_rows import AxisRows, axis_of, study_at
from uqsphere.runner.evaluate import LATE, OutOfBudget, Work
from uqsphere.runner.limits import state_of
from uqsphere.runner.questions.curves import CurveFound
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.runner.questions.probabilities import find_design
from uqsphere.runner.whatif import margin_left_open
from uqsphere.study import SPEED, Limit, strength_name
from uqsphere.uq import Estimate, Law, LimitState, Sample
from uqsphere.uq.curve import fit_lognormal_curve, fragility

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
        about["lost_to"] = {"reason": LATE}
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
