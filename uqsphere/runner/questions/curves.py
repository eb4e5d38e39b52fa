"""Inverse questions: the curve over the free scalar, and the scalar's values at given probabilities.

A look at few rows over the whole range tells where the curves rise, by each row's demands interpolated between the
values looked at.  There a few rows are evaluated at every value of the curve, and twice as many where it is not known
as well as asked.  Demands that are censored count as they are; a row without an answer is left to the others.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.files import Json
from uqsphere.quantities import format_value, lookup
from uqsphere.results import Fields, SpeedRow
from uqsphere.runner.axis_rows import AxisRows, Look, axis_of, evaluate_along, judge_of
from uqsphere.runner.campaign import Accuracy, Cost, Course, campaign, rounded, speed_rows_of
from uqsphere.runner.evaluate import LATE, MOST_DROPPED, OutOfBudget, Work
from uqsphere.runner.questions.distributions import FALL
from uqsphere.runner.schedule import CURVE, CURVE_VALUES, FREE_CURVE, LOOK, REPLICATES
from uqsphere.runner.similarity import Tabled
from uqsphere.runner.whatif import probabilities_by_tests
from uqsphere.study import Limit, spaced, with_number
from uqsphere.units import told_apart
from uqsphere.uq import Estimate
from uqsphere.uq.curve import Fragility, LognormalCurve, fit_lognormal_curve, fragility, half_widths

#: times that a range is widened which turned out too narrow
WIDER: Final = 3
#: the smallest probability whose band a curve is made for, over the smallest that is asked for
BELOW: Final = 0.5
KIND: Final = "half-width of the band over the smaller side of its probability"
METHOD: Final = "rows along the free scalar, beside a polynomial of them"
NO_ANSWERS: Final = "half of the evaluations, or more, have no answer"
NO_CURVE: Final = f"{LATE}, before the curve was known"


# --- how well a curve is known ---------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Band:
    """How well a curve is known: the largest half-width of its 95 % intervals over the smaller side of the probability.

    `cost` is what the half-width that was asked would take; `share` the evaluations that the curve was allowed over the
    budget of the study, where that ended it; `tabled` is the table beside its rows.
    """

    half_width: float
    asked: float
    evaluations: int
    cost: Cost = field(default_factory=Cost)
    share: float = 0.0
    tabled: Tabled = field(default_factory=Tabled)

    def missed(self) -> str:
        """What is said of a band that is wider than asked: what it reached, and what it would take; or nothing."""
        if self.half_width <= self.asked:
            return ""
        text = (
            f"the band of the curve: half-width {told_apart(self.half_width, self.asked)} of the smaller side of its "
            f"probability, asked {self.asked:g}{self.cost.text}"
        )
        if self.cost.needed is None or not self.share > 0.0:
            return text
        return f"{text}; a budget of about {rounded(self.cost.needed / self.share):,} has room for as many"

    def table(self) -> dict[str, Json]:
        """The entry of results.json."""
        return {
            "half_width": self.half_width,
            "asked": self.asked,
            "evaluations": self.evaluations,
            "needed": rounded(self.evaluations) if self.half_width <= self.asked else self.cost.needed,
        }


def widest(table: Array, least: float) -> float:
    """The largest half-width of a curve (K, R) over the smaller side, where that is not below `least`."""
    widths, side = half_widths(table)
    return float(widths[side >= least].max(initial=0.0))


# --- where the rows go -----------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Found:
    """What there is of the curves: the look, the rows, and the course of every limit's band."""

    look: Look
    rows: AxisRows
    bands: dict[str, Band]


def _shortage(work: Work, cost: int) -> str:
    """What is said where so many evaluations were due and are not left."""
    lacking = work.ledger.total + cost - work.study.analysis.budget.evaluations
    return f"the evaluations ran out before the curve: it takes at least {lacking:,} more than the budget has"


def find_rows(
    work: Work, limits: Sequence[Limit], *, least: float, most: int, tag: str = "", called: str = ""
) -> Found | str:
    """Rows where the curves of some limits rise, for about `most` evaluations; at least what a curve takes.

    `least` is the smallest probability of interest.
    """
    axis, before = axis_of(work), work.ledger.total
    left = work.study.analysis.budget.evaluations - before
    if not axis.moves_rows:
        return _find_free(work, limits, least, before + min(most, left), tag, called)
    each = REPLICATES * CURVE_VALUES
    cost = REPLICATES * LOOK.first * LOOK.most + CURVE.least * each
    if cost > left:
        return _shortage(work, cost)
    found = evaluate_along(work, dict.fromkeys(axis.grid(LOOK.most), (0, LOOK.first)), tag)
    look = Look(work=work, samples=found)
    allowed = min(max(most, 3 * each), left)
    count = next((n for n in (CURVE.first, CURVE.least) if cost + (n - CURVE.least) * each <= allowed), CURVE.least)
    ends = _region(work, limits, look, least)
    for _ in range(WIDER):
        rows = AxisRows(work=work, tag=tag, grid=spaced(*ends, CURVE_VALUES))
        rows.begin(count)
        limits = _answered(rows, limits)
        if not limits:
            break
        wider = _widened(limits, rows, look, least)
        if wider == ends or work.ledger.total + count * each > work.study.analysis.budget.evaluations:
            break
        ends = wider
    return _found(
        look, _Bands(rows=rows, limits=limits, least=2.0 * least, most=before + min(most, left), called=called)
    )


def _find_free(work: Work, limits: Sequence[Limit], least: float, most: int, tag: str, called: str) -> Found | str:
    """The same where the scalar is a strength: the rows of one value serve all."""
    axis = axis_of(work)
    left = work.study.analysis.budget.evaluations - work.ledger.total
    count = min(FREE_CURVE.first, left // REPLICATES) if work.scene_names else FREE_CURVE.first
    if count < FREE_CURVE.least:
        return _shortage(work, REPLICATES * FREE_CURVE.least)
    rows = AxisRows(work=work, tag=tag, grid=[axis.low, axis.high])
    rows.begin(count)
    limits = _answered(rows, limits)
    sample = rows.at(axis.low)
    look = Look(work=work, samples={axis.low: sample, axis.high: sample})
    grid = spaced(*_region(work, limits, look, least), CURVE_VALUES)
    rows = AxisRows(work=work, tag=tag, grid=grid, rows={grid[0]: sample}, used=count)
    return _found(look, _Bands(rows=rows, limits=limits, least=2.0 * least, most=most, called=called))


def _answered(rows: AxisRows, limits: Sequence[Limit]) -> list[Limit]:
    """The limits of which most rows have a demand."""
    return [limit for limit in limits if rows.lost(limit.quantity) < 0.5]


def _found(look: Look, question: _Bands) -> Found | str:
    """The curves as accurate as asked, or as is affordable."""
    if not question.limits:
        return NO_ANSWERS
    work = question.rows.work
    before = work.ledger.total - question.size
    bands = question.answer(campaign(work, question), before)
    return Found(look=look, rows=question.rows, bands=bands)


def _region(work: Work, limits: Sequence[Limit], look: Look, least: float) -> tuple[float, float]:
    """Where the probabilities of the limits lie between `least` and its complement, by the few rows of the look."""
    fine = spaced(look.grid[0], look.grid[-1], 301)
    inside = np.zeros(len(fine), dtype=bool)
    for limit in limits:
        p = look.curve(limit, fine).mean(axis=1)
        sides = (p > least).astype(int) + (p > 1.0 - least)
        crossed = np.flatnonzero(np.diff(sides) != 0)
        inside |= sides == 1
        inside[crossed] = inside[crossed + 1] = True
        inside |= _open_to_tests(work, limit, look, fine, least)
    if not inside.any():
        return look.grid[0], look.grid[-1]
    at = np.flatnonzero(inside)
    return fine[max(at[0] - 2, 0)], fine[min(at[-1] + 2, len(fine) - 1)]


def _open_to_tests(work: Work, limit: Limit, look: Look, fine: Sequence[float], least: float) -> Array | bool:
    """Where a strength that was fitted to tests may bring the probability between `least` and its complement."""
    coarse = fine[:: max(1, len(fine) // 30)]
    ends = probabilities_by_tests(work, limit, look.states(limit, coarse))
    if ends is None:
        return False
    inside = (ends[1] > least) & (ends[0] < 1.0 - least)
    return np.asarray(np.interp(np.arange(len(fine)), np.searchsorted(fine, coarse), inside.astype(float)) > 0.0)


def _widened(limits: Sequence[Limit], rows: AxisRows, look: Look, least: float) -> tuple[float, float]:
    """The ends of the rows, or the next values of the look beyond, where a curve is still rising at an end."""
    low, high = rows.grid[0], rows.grid[-1]
    for limit in limits:
        p = rows.table(limit)[[0, -1]].mean(axis=1)
        outer = look.curve(limit, [look.grid[0], look.grid[-1]]).mean(axis=1)
        # an end is open where it lies between the two levels, and the look's own end is beyond one of them
        within, beyond = (p > least) & (p < 1.0 - least), (outer <= least) | (outer >= 1.0 - least)
        if within[0] and beyond[0]:
            low = max((value for value in look.grid if value < rows.grid[0]), default=low)
        if within[1] and beyond[1]:
            high = min((value for value in look.grid if value > rows.grid[-1]), default=high)
    return low, high


@dataclass(kw_only=True)
class _Bands:
    """How well the curves of some limits are known, a question for `campaign`: rows are doubled where they are not.

    `least` is the smaller side of a probability from which on it counts, `most` the ledger's evaluations up to which
    rows are taken, `called` what the curves are of beside their limits.
    """

    rows: AxisRows
    limits: Sequence[Limit]
    least: float
    most: int
    called: str = ""
    judged: int = 0
    begun: bool = False
    full: bool = False

    @property
    def size(self) -> int:
        return REPLICATES * self.rows.samples + self.rows.tabled.taken

    @property
    def asked(self) -> float:
        return self.rows.work.study.analysis.accuracy.curve

    def name(self, limit: Limit) -> str:
        """What the curve of a limit is called."""
        return f"margins.{limit.name}{self.called}"

    def advance(self, room: float) -> bool:
        """Twice the rows where a curve is wider than asked; False where there is no room, or no value takes more."""
        if not self.begun:
            self.begun = True
            return True
        worst = max(self.lacking().values(), default=1.0)
        left = min(room, self.most - self.rows.work.ledger.total)
        if self.rows.ask_table(self.limits, worst, self.size * min(worst, 1e3) ** FALL, left):
            return True
        rows, highest = self.rows, FREE_CURVE.most if self.rows.free else CURVE.most
        wanted = [value for value in self._wide() if rows.rows[value].count < highest]
        cost, self.full = sum(rows.rows[value].size for value in wanted), not wanted
        if not wanted or cost > left:
            return False
        rows.double(wanted)
        return True

    def _wide(self) -> list[float]:
        """The values at which a curve is wider than asked, and one on either side: they share what they tell."""
        wide = np.zeros(len(self.rows.grid), dtype=bool)
        for limit in self.limits:
            widths, side = half_widths(self.rows.table(limit))
            wide |= (widths > self.asked) & (side >= self.least)
        if self.rows.free:
            return self.rows.grid[:1] if wide.any() else []
        near = wide | np.append(wide[1:], False) | np.append(False, wide[:-1])
        return [value for value, wanted in zip(self.rows.grid, near, strict=True) if wanted]

    def lacking(self) -> dict[Accuracy, float]:
        """Half-width over what is asked of the curves that are wider."""
        widths = {self.name(limit): widest(self.rows.table(limit), self.least) for limit in self.limits}
        return {Accuracy(name, "band"): width / self.asked for name, width in widths.items() if width > self.asked}

    def errors(self) -> list[SpeedRow]:
        """The half-width of every band."""
        self.rows.make_tables(self.limits)
        return [
            row
            for limit in self.limits
            for row in speed_rows_of(
                METHOD, self.name(limit), self.size, widest(self.rows.table(limit), self.least), KIND
            )
        ]

    def answer(self, course: Course, before: int) -> dict[str, Band]:
        """The bands that a campaign has reached; `before` it there were so many evaluations."""
        budget = self.rows.work.study.analysis.budget.evaluations
        share = (self.most - before) / budget if course.stopped in ("evaluations", "out of reach") else 0.0
        highest = REPLICATES * (FREE_CURVE.most if self.rows.free else CURVE.most)
        tabled = self.rows.tabled
        # by itself sampling would take the more, the closer the curves have come to what was asked
        forecast = int(tabled.forecast / max(self.lacking().values(), default=1.0) ** FALL)
        tabled = replace(tabled, paired=REPLICATES * self.rows.samples, forecast=forecast)
        full = Cost(f" (no value is given more than {highest:,} evaluations)") if self.full else None
        return {
            limit.name: Band(
                half_width=widest(self.rows.table(limit), self.least),
                asked=self.asked,
                evaluations=self.size,
                cost=full or course.cost(Accuracy(self.name(limit), "band")),
                share=share,
                tabled=tabled,
            )
            for limit in self.limits
        }


# --- the curves of a study --------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class CurveFound:
    """A curve of one limit: values (K,), every replicate's probabilities (K, R), and the rows.

    `samples` is the number of points of each replicate behind one probability; `values` are the free scalar's at the
    probabilities asked for.
    """

    grid: Array
    table: Array
    samples: int
    evaluations: int
    band: Band
    rows: AxisRows
    values: Mapping[float, Estimate] = field(default_factory=dict)
    note: str = ""

    def missed(self) -> list[str]:
        """What the curve lacks: what was reached, asked, and would be taken of each."""
        texts = [self.note] if self.note else []
        texts += [self.band.missed()] if self.band.missed() else []
        return texts + unknown_values(self.values)

    def answer(self, targets: Sequence[float]) -> Fragility:
        """The curve with its intervals, and the values at some probabilities."""
        return fragility(self.grid, self.table, targets, samples=self.samples, evaluations=self.evaluations)

    def value_at(self, probability: float) -> Estimate:
        """The value at a probability, whether it was asked for or not."""
        return self.values.get(probability) or self.answer((probability,)).values[probability]

    def lognormal(self) -> LognormalCurve | str:
        """The lognormal curve beside it, or why there is none."""
        return fit_lognormal_curve(self.grid, self.table, evaluations=self.evaluations)


def lognormal_table(fitted: LognormalCurve | str) -> Fields:
    """A lognormal curve for results.json; with the reason where there is none."""
    if isinstance(fitted, str):
        return {"median": None, "dispersion": None, "reason": fitted}
    return {
        "median": fitted.median, "dispersion": fitted.dispersion, "rising": fitted.rising,
        "largest_gap": fitted.gap, "largest_gap_at": fitted.gap_at,
    }  # fmt: skip


def unknown_values(values: Mapping[float, Estimate]) -> list[str]:
    """Why values are not known, each by its probability."""
    return [f"{p:g}: {e.reason}" for p, e in values.items() if e.value is None and e.reason]


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


def curves_along(
    work: Work, limits: Sequence[Limit], *, most: int, tag: str = "", called: str = ""
) -> dict[str, CurveFound | str]:
    """The curve of every limit, by few rows at each value where its demands are known in full, or why there is none.

    Raises OutOfBudget when the time is over before there is a curve.
    """
    before = work.ledger.total
    smallest = min(min(p, 1.0 - p) for limit in limits for p in asked_probabilities(work, limit))
    seen = find_rows(work, limits, least=BELOW * smallest, most=most, tag=tag, called=called)
    if isinstance(seen, str):
        return dict.fromkeys((limit.name for limit in limits), seen)
    rows, found = seen.rows, dict[str, CurveFound | str]()
    for limit in limits:
        if limit.name not in seen.bands:
            found[limit.name] = NO_ANSWERS
            continue
        lost, (grid, table) = rows.lost(limit.quantity), _with_outer(limit, rows, seen.look)
        one = CurveFound(
            grid=grid, table=table, samples=rows.samples, evaluations=work.ledger.total - before, rows=rows,
            band=seen.bands[limit.name],
            note=f"{100.0 * lost:.2g} % of the evaluations have no answer, the others stand for them"
            * (lost > MOST_DROPPED),
        )  # fmt: skip
        found[limit.name] = replace(one, values=one.answer(asked_probabilities(work, limit)).values)
    return found


def _with_outer(limit: Limit, rows: AxisRows, look: Look) -> tuple[Array, Array]:
    """The curve on its grid, and what was looked at beyond its ends."""
    outer = [] if rows.free else [x for x in look.grid if not rows.grid[0] <= x <= rows.grid[-1]]
    if not outer:
        return np.array(rows.grid), rows.table(limit)
    inner = rows.table(limit)
    ends = [0 if x < rows.grid[0] else -1 for x in outer]
    off = np.array([_odds(inner[k]) / _odds(look.curve(limit, [rows.grid[k]])) for k in ends])[:, None]
    seen = look.curve(limit, outer)
    known = np.isfinite(off) & (off > 0.0)
    told = np.where(known, seen * off / (1.0 - seen + seen * off), seen)
    grid, table = np.array([*outer, *rows.grid]), np.concatenate([told, inner])
    order = np.argsort(grid)
    return grid[order], table[order]


def _odds(probabilities: Array) -> float:
    """Odds of the mean of some probabilities; NaN where they are nought or infinite."""
    p = float(np.mean(probabilities))
    return p / (1.0 - p) if 0.0 < p < 1.0 else math.nan


def family_curves(work: Work, limits: Sequence[Limit], most: int) -> dict[float, dict[str, CurveFound | str]]:
    """The curves at every value of another number that the study asks for, by that value."""
    assert work.study.margins is not None
    family = work.study.margins.family
    found: dict[float, dict[str, CurveFound | str]] = {}
    if family is None:
        return found
    for k, (value, name) in enumerate(zip(family.values, member_values(family.path, family.values), strict=True)):
        moved = replace(work, study=with_number(work.study, family.path, value))
        called = f" at {family.path} {name}"
        try:
            found[value] = curves_along(moved, limits, most=most, tag=f"-family{k}", called=called)
        except OutOfBudget:
            found[value] = dict.fromkeys((limit.name for limit in limits), NO_CURVE)
    return found


def member_values(path: str, values: Sequence[float], digits: int = 4) -> list[str]:
    """Different values (SI) of a number as they are printed, to as many digits, from `digits` on, as tell them apart.

    >>> member_values("sphere.radius", [0.01, 0.012]), member_values("sphere.radius", [0.01, 0.010002])
    (['10 mm', '12 mm'], ['10 mm', '10.002 mm'])
    """
    tried = ([format_value(value, path, count) for value in values] for count in range(digits, 18))
    return next((texts for texts in tried if len(set(texts)) == len(values)), [repr(value) for value in values])


# --- over the specific energy ----------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class EnergyCurve:
    """Curve [[energy, probability, low, high], ...] (J/kg), its values by probability, the lognormal curve beside it.

    `reason`: why there is none.
    """

    quantity: str
    curve: list[list[float]] = field(default_factory=list)
    values: Mapping[float, Estimate] = field(default_factory=dict)
    lognormal: LognormalCurve | str = ""
    reason: str = ""

    @classmethod
    def none(cls, quantity: str, reason: str) -> EnergyCurve:
        """No curve, and why."""
        return cls(quantity=quantity, lognormal=reason, reason=reason)

    def table(self) -> Fields:
        """The entry of results.json."""
        return {
            "quantity": self.quantity,
            "unit": lookup(self.quantity).unit,
            "values": self.values,
            "curve": [list(point) for point in self.curve],
            "lognormal": lognormal_table(self.lognormal),
            **({"reason": self.reason} if self.reason else {}),
        }


def energy_curve(rows: AxisRows, limit: Limit, quantity: str, probabilities: Sequence[float]) -> EnergyCurve:
    """The fragility of a limit over `quantity`, a positive answer that rises with the free scalar of the rows.

    Comminution asks for the probability that a particle breaks at a given specific energy, as a drop-weight test finds
    it that gives every particle the same energy per mass (L. M. Tavares and R. P. King, Int. J. Miner. Process. 54,
    1998, 1).  The energy in the contacts is an answer, not an input: it scatters at a given speed.  So P(e) is the mean
    over the inputs of the probability that the strength is below D(e, z), where D is the demand of a specimen with the
    inputs z at the value of the scalar at which the quantity is e: the same rows lie where their own energies are.
    """
    if rows.free:
        return EnergyCurve.none(quantity, f"{quantity} does not move with the free number")
    if unknown := [name for name in (quantity, limit.quantity) if not rows.knows(name)]:
        return EnergyCurve.none(quantity, f"{unknown[0]} is not known in full in every row")
    if not all(bool((sample.answer(quantity) > 0.0).all()) for sample in rows.rows.values()):
        return EnergyCurve.none(quantity, f"{quantity} is zero in some rows")
    low, high = (float(np.median(rows.rows[end(rows.rows)].answer(quantity))) for end in (min, max))
    if not high > low * (1.0 + 1e-9):
        return EnergyCurve.none(quantity, f"{quantity} does not rise with the free number")
    work, grid = rows.work, spaced(low, high, CURVE_VALUES)
    table = rows.curve_of(limit.quantity, judge_of(work, limit), over=quantity).table(grid)
    told = fragility(np.array(grid), table, probabilities, samples=rows.samples, evaluations=work.ledger.total)
    lognormal = fit_lognormal_curve(np.array(grid), table, evaluations=work.ledger.total)
    error = work.study.model.tolerance
    if not isinstance(lognormal, str):
        median, dispersion = (_no_closer(estimate, error) for estimate in (lognormal.median, lognormal.dispersion))
        lognormal = replace(lognormal, median=median, dispersion=dispersion)
    values = {p: _no_closer(estimate, error) for p, estimate in told.values.items()}
    return EnergyCurve(quantity=quantity, curve=told.curve, values=values, lognormal=lognormal)


def _no_closer(estimate: Estimate, error: float) -> Estimate:
    """The estimate with an interval that is no narrower than the energies are integrated to, relative."""
    if estimate.value is None or estimate.low is None or estimate.high is None:
        return estimate
    reach = error * abs(estimate.value)
    low, high = min(estimate.low, estimate.value - reach), max(estimate.high, estimate.value + reach)
    return replace(estimate, low=low, high=high)
