"""Inverse questions: the fragility curve over one scalar of the scene, and its values at given probabilities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from uqsphere.quantities import format_value
from uqsphere.results import SpeedRow
from uqsphere.runner.band import Band
from uqsphere.runner.curve_rows import CurveRows
from uqsphere.runner.curve_values import POINTS, refined_values
from uqsphere.runner.curves import find_rows
from uqsphere.runner.design_margins import Where, describe_margin
from uqsphere.runner.energy_curve import EnergyCurve, energy_curve, energy_table, not_known
from uqsphere.runner.evaluate import OutOfBudget, Work
from uqsphere.runner.moved import axis_of
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.runner.schedule import REPLICATES
from uqsphere.runner.stepwise import Coarse, stepwise_curves
from uqsphere.study import Limit
from uqsphere.study.axis import with_number
from uqsphere.uq.estimate import Estimate, absent
from uqsphere.uq.fragility import LognormalCurve, fit_lognormal_curve
from uqsphere.uq.margins import Fragility, fragility
from uqsphere.uq.sample import Sample

__all__ = [
    "MarginAnswer",
    "asked_probabilities",
    "band_history",
    "find_margins",
    "limit_values",
    "member_values",
    "unmoved_margins",
]

Array = npt.NDArray[np.float64]

#: share of the budget of evaluations that all curves together may take
SHARE = 0.1
#: the smallest probability whose band a curve is made for, over the smallest that is asked for
BELOW = 0.5
_LATE = "the time was over, or the run was stopped, before the curve was known"


@dataclass(frozen=True, kw_only=True)
class MarginAnswer:
    """Fragility curve of one limit and the values of the free scalar at the probabilities asked for.

    `lognormal` is the lognormal curve beside it, or why there is none; `family` holds the curves at other values of
    another number, as tables for results.json, and `about` what the margin is made of (`design_margins`); `against` is
    the curve over the specific energy, where that is asked for; `band` is how well the curve is known, `coarse` what
    its steps lack; `bands` and `steps` hold the same of the curves of the family, by what they are called.
    """

    values: dict[float, Estimate]
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


def accepted(limit: Limit) -> float | None:
    """Probability of exceeding that the limit's target allows, or asks for."""
    if limit.target is None:
        return None
    return limit.target if limit.aim == "survive" else float(f"{1.0 - limit.target:.12g}")


def asked_probabilities(work: Work, limit: Limit) -> tuple[float, ...]:
    """The probabilities of the study and that of the limit's own target."""
    assert work.study.margins is not None
    own = accepted(limit)
    return tuple(sorted({*work.study.margins.for_probability, *(() if own is None else (own,))}))


def _least(work: Work, limits: Sequence[Limit]) -> float:
    """The smallest probability, on either side, that the curves are to answer for."""
    return BELOW * min(min(p, 1.0 - p) for limit in limits for p in asked_probabilities(work, limit))


@dataclass(frozen=True, kw_only=True)
class _Found:
    """A curve of one limit: the values, every replicate's probabilities (K, R), and the rows if they are few."""

    grid: Array
    table: Array
    samples: int
    evaluations: int
    rows: CurveRows | None
    values: dict[float, Estimate]
    note: str = ""
    band: Band | None = None
    coarse: Coarse | None = None

    def missed(self) -> list[str]:
        """What the curve lacks: what was reached, asked, and would be taken of each."""
        texts = [self.note] if self.note else []
        texts += [self.band.missed()] if self.band is not None and self.band.missed() else []
        texts += [self.coarse.missed()] if self.coarse is not None else []
        return texts + [f"{p:g}: {e.reason}" for p, e in self.values.items() if e.value is None and e.reason]

    def answer(self, targets: Sequence[float]) -> Fragility:
        return fragility(self.grid, self.table, targets, samples=self.samples, evaluations=self.evaluations)


def _curves(work: Work, limits: Sequence[Limit], *, most: int, tag: str) -> dict[str, _Found | str]:
    """The curve of every limit, by few rows at each value where its demands are known in full, or why there is none."""
    before, budget = work.ledger.total, work.study.analysis.budget.evaluations
    seen = find_rows(work, limits, least=_least(work, limits), most=most // 2, tag=tag)
    if seen.reason:
        return dict.fromkeys((limit.name for limit in limits), seen.reason)
    found: dict[str, _Found | str] = {}
    taken: dict[float, Sample] = {}
    rows = seen.rows
    known = [limit for limit in limits if rows is not None and rows.knows(limit.quantity)]
    for limit in known:
        assert rows is not None
        grid, table = np.array(rows.grid), rows.curve(limit)
        if seen.look is not None and not rows.still:
            outer = np.array([value for value in seen.look.grid if not grid[0] <= value <= grid[-1]])
            if outer.size:
                grid, table = np.concatenate([outer, grid]), np.concatenate([seen.look.curve(limit, outer), table])
        order = np.argsort(grid)
        one = _Found(
            grid=grid[order], table=table[order], samples=rows.samples, evaluations=work.ledger.total - before,
            rows=rows, values={}, note=seen.note, band=seen.bands.get(limit.name),
        )  # fmt: skip
        asked = asked_probabilities(work, limit)
        # at each value some rows of its own, as long as there are evaluations at all, more within the share
        up_to = max(before + most, work.ledger.total + REPLICATES * POINTS * len(asked))
        values = refined_values(rows, limit, one.answer(asked).values, most=min(up_to, budget), taken=taken)
        found[limit.name] = replace(one, values=values)
    rest = [limit for limit in limits if limit.name not in found]
    steep = stepwise_curves(work, rest, tag, least=2.0 * _least(work, limits)) if rest else {}
    for name, steps in steep.items():
        if isinstance(steps, str):
            found[name] = steps
            continue
        one = _Found(
            grid=steps.grid, table=steps.table, samples=steps.samples, evaluations=steps.evaluations, rows=None,
            values={}, band=steps.band, coarse=steps.coarse,
        )  # fmt: skip
        limit = next(limit for limit in rest if limit.name == name)
        found[name] = replace(one, values=dict(one.answer(asked_probabilities(work, limit)).values))
    return found


def limit_values(work: Work, limit: Limit, *, most: int) -> dict[float, Estimate]:
    """The values asked for of one limit, by about `most` evaluations; none where there is no curve."""
    found = _curves(work, [limit], most=most, tag="")[limit.name]
    return {} if isinstance(found, str) else found.values


def _member(work: Work, found: _Found | str, limit: Limit, value: float) -> dict[str, Any]:
    """One curve of a family as a table."""
    if isinstance(found, str):
        return {"value": value, "values": {}, "curve": [], "lognormal": None, "reason": found}
    curve = found.answer(()).curve
    fitted = fit_lognormal_curve(found.grid, found.table, evaluations=found.evaluations)
    return {
        "value": value,
        "values": {f"{p:.15g}": e.as_dict() for p, e in found.values.items()},
        "curve": [list(row) for row in curve],
        "lognormal": lognormal_table(fitted),
        **({} if found.band is None else {"band": found.band.table()}),
        **({} if found.coarse is None else {"steps": found.coarse.table()}),
    }


def lognormal_table(fitted: LognormalCurve | str) -> dict[str, Any]:
    """A lognormal curve for results.json; with the reason where there is none."""
    if isinstance(fitted, str):
        return {"median": None, "dispersion": None, "reason": fitted}
    return {
        "median": fitted.median.as_dict(), "dispersion": fitted.dispersion.as_dict(), "rising": fitted.rising,
        "largest_gap": fitted.gap, "largest_gap_at": fitted.gap_at,
    }  # fmt: skip


def against_table(found: EnergyCurve | None) -> dict[str, Any]:
    """The entry of results.json for a curve over the specific energy; nothing where it was not asked for."""
    return {} if found is None else {"against": energy_table(found, lognormal_table(found.lognormal))}


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
    family = margins.family
    curves = 1 + (len(family.values) if family else 0)
    most = int(SHARE * work.study.analysis.budget.evaluations / curves)
    try:
        found = _curves(work, limits, most=most, tag="")
    except OutOfBudget:
        found = dict.fromkeys((limit.name for limit in limits), _LATE)
    members = _members(work, limits, most)
    answers = {}
    for limit in work.study.limits:
        if limit.name in unmoved:
            answers[limit.name] = unmoved[limit.name]
            continue
        one = found[limit.name]
        if isinstance(one, str):
            answers[limit.name] = _unknown(work, limit, one)
            continue
        kin = _named(work, members, limit)
        drawn = {at: curve for at, curve in kin.items() if not isinstance(curve, str)}
        lacking = {at: [curve] if isinstance(curve, str) else curve.missed() for at, curve in kin.items()}
        where = Where(
            limit=limit, probability=_decisive(work, limit), values=one.values, grid=one.grid, table=one.table,
            rows=one.rows,
        )  # fmt: skip
        answers[limit.name] = MarginAnswer(
            values=one.values,
            curve=one.answer(()).curve,
            missed=[*one.missed(), *(f"at {at}: {text}" for at, texts in lacking.items() for text in texts)],
            lognormal=fit_lognormal_curve(one.grid, one.table, evaluations=one.evaluations),
            family=[_member(work, member[limit.name], limit, value) for value, member in members.items()],
            about=describe_margin(work, sampled, where),
            against=_against(work, limit, one.rows),
            band=one.band,
            coarse=one.coarse,
            bands={at: of.band for at, of in drawn.items() if of.band is not None},
            steps={at: of.coarse for at, of in drawn.items() if of.coarse is not None},
        )
    return answers


def _named(work: Work, members: Mapping[float, dict[str, _Found | str]], limit: Limit) -> dict[str, _Found | str]:
    """The curves of a limit over the family, by what they are called."""
    if work.study.margins is None or work.study.margins.family is None:
        return {}
    path = work.study.margins.family.path
    names = member_values(path, list(members))
    return {f"{path} {name}": found[limit.name] for name, found in zip(names, members.values(), strict=True)}


def member_values(path: str, values: Sequence[float], digits: int = 4) -> list[str]:
    """Different values (SI) of a number as they are printed, to as many digits, from `digits` on, as tell them apart.

    >>> member_values("sphere.radius", [0.01, 0.012]), member_values("sphere.radius", [0.01, 0.010002])
    (['10 mm', '12 mm'], ['10 mm', '10.002 mm'])
    """
    tried = ([format_value(value, path, count) for value in values] for count in range(digits, 18))
    return next((texts for texts in tried if len(set(texts)) == len(values)), [repr(value) for value in values])


def band_history(margins: Mapping[str, MarginAnswer]) -> tuple[list[SpeedRow], list[float]]:
    """Rows of the speed-error table that the bands of the curves give, and their seconds."""
    known: dict[str, Band] = {}
    for name, found in margins.items():
        known |= {} if found.band is None else {name: found.band}
        known |= {f"{name} at {at}": band for at, band in found.bands.items()}
    rows = [row for name, band in known.items() for row in band.rows(name)]
    return rows, [stage.seconds for band in known.values() for stage in band.course]


def _against(work: Work, limit: Limit, rows: CurveRows | None) -> EnergyCurve | None:
    """The curve over the specific energy from the rows of that over the speed; None where it is not asked for."""
    assert work.study.margins is not None
    quantity = work.study.margins.against
    return None if quantity is None else energy_curve(rows, limit, quantity, asked_probabilities(work, limit))


def _decisive(work: Work, limit: Limit) -> float:
    """The probability that a margin is told for: that of the limit's target, or the smallest that is asked for."""
    assert work.study.margins is not None
    return accepted(limit) or min(work.study.margins.for_probability)


def _unknown(work: Work, limit: Limit, reason: str) -> MarginAnswer:
    """What is said of a limit without a curve: why every value is absent."""
    assert work.study.margins is not None
    values = {p: absent(reason, "none", 0) for p in asked_probabilities(work, limit)}
    decisive = _decisive(work, limit)
    about = {"probability": decisive, "value": absent(reason, "none", 0).as_dict()}
    asked = work.study.margins.against
    return MarginAnswer(
        values=values, curve=[], missed=[reason], lognormal=reason, about=about,
        against=None if asked is None else not_known(asked, reason),
    )  # fmt: skip


def _members(work: Work, limits: Sequence[Limit], most: int) -> dict[float, dict[str, _Found | str]]:
    """The curves of a family, by the value of its number."""
    assert work.study.margins is not None
    family = work.study.margins.family
    if family is None:
        return {}
    found: dict[float, dict[str, _Found | str]] = {}
    for k, value in enumerate(family.values):
        moved = replace(work, study=with_number(work.study, family.path, value))
        try:
            found[value] = _curves(moved, limits, most=most, tag=f"-family{k}")
        except OutOfBudget:
            found[value] = dict.fromkeys(
                (limit.name for limit in limits),
                "the time was over, or the run was stopped, before the curve was known",
            )
    return found
