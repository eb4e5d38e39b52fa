"""Doubts: everything that a decision takes for granted and can quantify, each with a curve of its
own along the free number.

A doubt is one limit with one thing taken otherwise, the other failure modes being at their middle:
for a sphere that must survive all failure modes add up; for one that must break others would help,
and leaving them out is conservative.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from typing import Self

import numpy as np

from uqsphere.arrays import Array, Flags, Pair, Values, bundle, special
from uqsphere.results import types
from uqsphere.results.types import DoubtCode
from uqsphere.study import Limit
from uqsphere.uq import Law, LawError, LimitState, make_law
from uqsphere.uq.estimate import (
    ENDS,
    carriers,
    count_bound,
    lost_share,
    probability_ends,
    spread,
    spreads,
)
from uqsphere.uq.fitting import STRENGTHS, fitted_law, is_fitted, possible_laws, series_behind
from uqsphere.uq.joint import FREE
from uqsphere.uq.limit_state import make_union

from .design import Design
from .failure_modes import REFUTED, AssumedMode, means_fracture
from .limits import common_factor
from .line import CLOSE, Line, YieldingRows, exceedance, score
from .tables import FEW

#: strengths that tests allow
LAWS = 400
#: rows that carry a probability at least at a number
FEWEST = 5.0


@bundle
class Aim:
    """The limits of a study that must survive, or break, with the failure modes beside them.

    limits : in the order of the study
    untargeted : limits of the study without a target that mean fracture, and add up with the others
    modes : those with an assumed strength that mean fracture; none for a sphere that must break
    others : everything of the limits that may be otherwise
    yielding : rows with contacts that yield; None where the study has such, or none would
    """

    design: Design
    word: types.Aim
    limits: Sequence[Limit]
    untargeted: Sequence[Limit]
    modes: Sequence[AssumedMode]
    others: Sequence[Alternative]
    yielding: YieldingRows | None

    @property
    def survive(self) -> bool:
        """Whether exceedance is what must not happen."""
        return self.word == "survive"

    @property
    def has_target(self) -> bool:
        """Whether its limits have targets: those without are left out where others have."""
        return self.limits[0].has_target

    @cached_property
    def groups(self) -> list[list[Limit]]:
        """Limits by the tests behind them: those on the same tests are one failure mode, carried
        over in different ways; first the one that counts as fracture.
        """
        groups: dict[object, list[Limit]] = {}
        for limit in (*self.limits, *self.untargeted):
            groups.setdefault(tests_behind(limit) or limit.name, []).append(limit)
        return [
            sorted(group, key=lambda limit: limit.fracture is False) for group in groups.values()
        ]

    def without(self, name: str) -> Aim:
        """The aim without a limit or a failure mode."""
        return replace(
            self,
            limits=[limit for limit in self.limits if limit.name != name],
            untargeted=[limit for limit in self.untargeted if limit.name != name],
            modes=[mode for mode in self.modes if mode.limit.name != name],
        )


@bundle
class Alternative:
    """One thing of a limit taken otherwise.

    detail : what it is then, "lognormal" for a distribution
    laws : the strengths, all equally likely; empty for the limit's own
    """

    code: DoubtCode
    limit: Limit
    detail: str = ""
    laws: Sequence[Law] = ()


@bundle
class Doubt(Alternative):
    """An alternative with its curve along a line.

    single, curve : probability of exceedance (K,) at the unsafe end, of the limit alone and with
        the other failure modes
    opposite : the joint curve at the other end of what tests leave open; None for other doubts
    failed : what rows that failed add to the joint curve (K,), where they might all be failures
    error : standard error (K,) of the curve by the numerical computation
    margin : where the curve crosses its target; None where the safe end misses it, infinite where
        the whole range keeps it
    """

    single: Array
    curve: Array
    error: Array
    margin: float | None
    opposite: Array | None = None
    failed: Array | float = 0.0

    @property
    def key(self) -> tuple[str, str, str]:
        """What tells it from other doubts of its aim."""
        return self.code, self.limit.name, self.detail


def tests_behind(limit: Limit) -> tuple[float, ...]:
    """The forces of the crushing tests behind a limit, or the observations, both with those that
    were stopped before failure; empty without.
    """
    if limit.tested is not None and limit.tested.forces:
        return limit.tested.forces
    law = limit.resistance
    if is_fitted(law):
        return law.data + law.censored
    return ()


# --- what may be otherwise ------------------------------------------------------------------------


def alternatives(design: Design, limits: Sequence[Limit]) -> Iterator[Alternative]:
    """Every strength of limits that may be otherwise, and every tie to the inputs."""
    for limit in limits:
        law = limit.resistance
        if not isinstance(law, Law):
            continue
        code: DoubtCode = "distribution"
        strengths = other_distributions(law)
        if is_fitted(law):
            code = "tests"
            strengths = strengths_allowed(design, limit, law)
        for name, laws in strengths.items():
            yield Alternative(code=code, limit=limit, detail=name, laws=laws)
        if any(limit.strength_name in tie.of for tie in design.study.dependence):
            yield Alternative(code="tie", limit=limit)


def strengths_allowed(design: Design, limit: Limit, law: Law) -> dict[str, list[Law]]:
    """By distribution, strengths that the tests behind a limit allow: its own distribution, and the
    other usual one where the tests do not refute it.

    One stream of random numbers for one set of tests: limits on the same tests share their draws.
    """
    laws = {law.family.name: law}
    if law.family.name in STRENGTHS and law.data and not limit.needs_modulus:
        series = series_behind(law)
        for name, kind in STRENGTHS.items():
            if name != law.family.name and series.probability_of(kind) >= REFUTED:
                with suppress(LawError):
                    laws[name] = fitted_law(law.data, name, censored=law.censored)
    allowed = {}
    tests = tests_behind(limit) or (0.0,)
    task = f"{law.tests} tests from {tests[0]!r} to {tests[-1]!r}"
    for name, fitted in laws.items():
        generator = design.generator(task)
        with suppress(LawError):
            allowed[name] = [*possible_laws(fitted, LAWS, generator, limit.allowable)]
    return allowed


def other_distributions(law: Law) -> dict[str, list[Law]]:
    """The other usual distribution of a strength, with the same mean and standard deviation."""
    from scipy.optimize import brentq

    if law.family.name not in ("weibull", "lognormal", "normal"):
        return {}
    mean = law.mean()
    sd = law.sd()
    if not (mean > 0.0 and sd > 0.0):
        return {}
    with suppress(ValueError):  # a scatter that no law has
        if law.family.name == "weibull":
            return {"lognormal": [make_law("lognormal", {"mean": mean, "cov": sd / mean})]}
        # 1 + cov² = Gamma(1 + 2/m)/Gamma(1 + 1/m)²
        excess = math.log1p((sd / mean) ** 2)
        modulus = brentq(
            lambda m: math.lgamma(1.0 + 2.0 / m) - 2.0 * math.lgamma(1.0 + 1.0 / m) - excess,
            0.1,
            1e4,
        )
        return {"weibull": [make_law("weibull", {"mean": mean, "modulus": modulus})]}
    return {}


# --- curves ---------------------------------------------------------------------------------------


@bundle
class Others:
    """The failure modes beside a limit, at each row.

    none : probability (R, N) that none of them is exceeded
    shift, scale : of a strength that depends on theirs: given that they hold, the normal score of
        the limit's exceedance is reduced by the shift and divided by the scale
    """

    none: Array | float = 1.0
    shift: Array | float = 0.0
    scale: float = 1.0

    def or_any(self, rows: Array) -> Array:
        """Probability (R, N) that any failure mode is exceeded, from that of the limit."""
        if self.scale < 1.0:
            rows = special.ndtr((score(rows) - self.shift) / self.scale)
        return 1.0 - self.none + rows * self.none


@bundle
class Curves:
    """The limits of an aim along a line, alone and with the other failure modes."""

    aim: Aim
    line: Line

    @property
    def survive(self) -> bool:
        """Whether exceedance is what must not happen."""
        return self.aim.survive

    @cached_property
    def others(self) -> dict[str, Others]:
        """What adds up with a limit, by its name; nothing for limits that are no fracture."""
        holds = {}
        groups = []
        for group in (*self.aim.groups, *([mode.limit] for mode in self.aim.modes)):
            counted = [*filter(means_fracture, group)]
            if counted and self.survive:
                first = counted[0]
                groups.append((first, group))
                holds[first.name] = 1.0 - exceedance(self.line.state(first), self.survive)
        others = dict[str, Others]()
        for first, group in groups:
            beside = [limit for limit, _ in groups if limit is not first]
            if beside:
                hold = np.prod([holds[limit.name] for limit in beside], axis=0)
                others |= {limit.name: self._others_of(limit, beside, hold) for limit in group}
        return others

    def _others_of(self, limit: Limit, beside: Sequence[Limit], hold: Array) -> Others:
        """What limits beside another one add, that hold with a probability (R, N) each by itself:
        strengths that depend on each other are drawn one after the other.
        """
        design = self.line.design
        factor = common_factor(design, [*beside, limit])
        if (factor == np.eye(len(factor))).all():
            return Others(none=hold)
        union = make_union(
            [self.line.state(other) for other in beside],
            factor[:-1, :-1],
            design.generator("tied strengths"),
        )
        return Others(
            none=np.where(hold > 0.0, union.none, hold),  # rows without an answer stay as they are
            shift=np.einsum("l,lrn->rn", factor[-1, :-1], union.holding),
            scale=float(factor[-1, -1]),
        )

    @cached_property
    def yielding(self) -> Line | None:
        """The rows of `line.few` with contacts that yield; None where none would."""
        if self.aim.yielding is None:
            return None
        return self.aim.yielding.along(self.line.few)

    @cached_property
    def few(self) -> Curves:
        """The same on some of the rows."""
        return replace(self, line=self.line.few)

    @property
    def own(self) -> Self:
        """The same by the study's own limits, without failure modes beside them."""
        return replace(self, aim=replace(self.aim, modes=()))

    @cached_property
    def _bases(self) -> dict[str, Array]:
        return {}

    def adds_up(self, limit: Limit) -> bool:
        """Whether other failure modes add up with a limit."""
        return limit.name in self.others

    def base(self, limit: Limit) -> Array:
        """The mean exceedance (2, K, R) of a limit by its own strength: alone, and with the other
        failure modes.
        """
        if limit.name not in self._bases:
            self._bases[limit.name] = self.by_strengths(limit)[:, 0]
        return self._bases[limit.name]

    def middle(self, limit: Limit) -> Values:
        """The mean exceedance (K,) of a limit with the other failure modes."""
        return self.base(limit)[1].mean(axis=1)

    @cached_property
    def rises(self) -> Values:
        """How much more each limit is exceeded at the last value than at the first (L,)."""
        exceeded = np.array([self.base(limit)[0].mean(axis=1) for limit in self.aim.limits])
        return exceeded[:, -1] - exceeded[:, 0]

    @property
    def safe_above(self) -> bool:
        """Whether larger values are safe, for all limits together: "use at least"."""
        return bool((self.rises.sum() >= 0.0) != self.survive)

    def margin(self, limit: Limit, curve: Array) -> float | None:
        """The value of the free number at which a curve (K,) of a limit misses its target, seen
        from the safe end.

        None at the plan, and where the safe end itself misses it; infinite where the whole range
        keeps it.
        """
        from scipy.optimize import brentq

        if len(curve) < 2:
            return None
        missed = np.flatnonzero(limit.missed(curve) > limit.target)
        if not missed.size:
            return math.inf
        k = missed[0]
        if self.safe_above:
            k = missed[-1] + 1
        if k in (0, len(curve)):
            return None
        excess = self.line.interpolated(score(curve) - score(limit.allowable))
        low, high = self.line.places[k - 1 : k + 1]
        if high - low < 2.0 * CLOSE * np.ptp(self.line.places):
            # between the two the curve may jump
            return float(self.line.values[k - 1 + self.safe_above])
        return float(self.line.value_at(brentq(excess, low, high)))

    def by_strengths(
        self, limit: Limit, laws: Sequence[Law | float] = (), *, tied: bool = True
    ) -> Array:
        """The mean exceedance (2, laws, K, R) of a limit, alone and with the other failure modes,
        by each of some strengths; by its own where there are none.
        """
        state, others = self._against(limit, tied=tied)
        means = []
        for strength in laws or [state.strength]:
            alone = exceedance(replace(state, strength=strength), self.survive)
            means.append([self.line.means(rows) for rows in (alone, others.or_any(alone))])
        return np.clip(np.moveaxis(np.array(means), 1, 0), 0.0, 1.0)

    def _against(self, limit: Limit, *, tied: bool = True) -> tuple[LimitState, Others]:
        """The demands of a limit at all rows against its strength, with what adds up with it; one
        that is not `tied` depends on neither the inputs nor other strengths.
        """
        state = self.line.state(limit)
        others = self.others.get(limit.name, Others())
        if tied:
            return state, others
        return replace(state, tie=FREE), Others(none=others.none)

    def computed(self, limit: Limit) -> Doubt:
        """The limit as the study has it, at the unsafe end of the numerical interval; without a
        margin where too few rows carry the failures beside it.
        """
        base = self.base(limit)
        rows = self._exceeded(limit)
        carried_by = [*map(self._carrying, rows)]
        curves = [self._ends(limit, *parts) for parts in zip(base, carried_by, strict=True)]
        if self.line.compared is not None:
            curves = self._by_rows(limit, base)
        # the failed rows that are left out would all have been on the unsafe side
        for k, exceeded in enumerate(rows):
            failed = [np.isnan(part) for part in self.line.by_value(exceeded)]
            lost = self._lost(failed)
            if not self.survive:
                lost = -lost
            known = curves[k]
            curves[k] = np.clip(known + lost, 0.0, 1.0)
            carried_by[k] = np.add(carried_by[k], [part.sum() for part in failed]).tolist()
        doubt = self._doubt(Alternative(code="computation", limit=limit), curves, base[1])
        doubt = replace(doubt, failed=curves[1] - known)
        if doubt.margin is not None and math.isfinite(doubt.margin):
            above = int(np.searchsorted(self.line.values, doubt.margin))
            if max(carried_by[1][max(above - 1, 0) : above + 1]) < FEWEST:
                return replace(doubt, margin=None)
        return doubt

    def is_lost_by_failed(self, doubt: Doubt) -> bool:
        """Whether a limit, as computed, keeps its target at the plan or somewhere along the line,
        and nowhere where all rows that failed would miss it.
        """
        limit = doubt.limit
        middle = self.middle(limit)
        return self.keeps(limit, middle) and not self.keeps(limit, middle + doubt.failed)

    def keeps(self, limit: Limit, curve: Array) -> bool:
        """Whether a curve (K,) of a limit keeps its target somewhere along the line, or at the
        plan.
        """
        if len(curve) > 1:
            return self.margin(limit, curve) is not None
        return bool(limit.missed(curve[0]) <= limit.target)

    def _lost(self, failed: Sequence[Flags]) -> Array:
        """The shares (K,) that rows of each value which failed may stand for: no more than at a
        value nearer to the unsafe end, unless surely more have; few rows leave much open.
        """
        own = np.array([*map(lost_share, failed)])
        surely = [1.0 - count_bound(part.sum(), (~part).sum()) for part in failed]
        nearer = np.minimum.accumulate(own[self._from_unsafe])[self._from_unsafe]
        return np.where(surely > nearer, own, nearer)

    def _by_rows(self, limit: Limit, base: Array) -> list[Array]:
        """The unsafe ends (K,) of probabilities (2, K, R) of a limit by a slow model: what its rows
        leave open, and do not show, of every limit that adds up with it is added.
        """
        adding = [limit]
        if self.adds_up(limit):
            every = (*self.aim.limits, *self.aim.untargeted)
            adding += [other for other in every if other != limit and self.adds_up(other)]
        away = []
        for other in adding:
            means = self.base(other)[0]
            ends = self.line.ends_by_rows(other, means)
            away.append(ends[2 + self.survive] - means.mean(axis=1))
        alone, joint = base.mean(axis=2)
        return [alone + away[0], np.clip(joint + np.sum(away, axis=0), 0.0, 1.0)]

    def _ends(self, limit: Limit, means: Array, carried_by: Sequence[float]) -> Array:
        """The unsafe ends (K,) of the numerical intervals of probabilities (K, R) of a limit that
        so many rows carry.

        Where its rows are counted, and none fails, failures are as probable as a count of none
        allows; where few rows carry them, as these few leave possible.
        """
        ends = []
        for row, count, carrying in zip(means, self._counts(limit), carried_by, strict=True):
            p = row.mean()
            q = (1.0 - row).mean()
            # a replicate knows what it counts to one row; of few rows their count says more
            cell = 0.0 if carrying < FEW else 1.0 / count
            low, high, _ = probability_ends(p, q, spread(row, cell), row.size, row.size * count)
            if carrying < FEW:
                most = float(special.gammaincinv(carrying + 1.0, ENDS[1])) / carrying
                low = min(low, 1.0 - min(q * most, 1.0))
                high = max(high, min(p * most, 1.0))
            ends.append(high if self.survive else low)
        return self._without_turns(np.array(ends), means.mean(axis=1))

    def _without_turns(self, ends: Array, means: Array) -> Array:
        """Unsafe ends (K,) of probabilities (K,): where no row fails, failures are no more probable
        than at any value nearer to the unsafe end.
        """
        survive = self.survive
        none_fails = means <= 0.0 if survive else means >= 1.0
        accumulate = np.minimum.accumulate if survive else np.maximum.accumulate
        from_unsafe = accumulate(ends[self._from_unsafe])
        return np.where(none_fails, from_unsafe[self._from_unsafe], ends)

    @property
    def _from_unsafe(self) -> slice:
        """The values of the line from the unsafe end on; of these, those of the line."""
        return slice(None, None, 1 if self.safe_above else -1)

    def _exceeded(self, limit: Limit) -> Pair:
        """Probabilities (R, N) of exceedance of a limit by its own strength, alone and with the
        other failure modes.
        """
        state, others = self._against(limit)
        alone = exceedance(state, self.survive)
        return alone, others.or_any(alone)

    def _carrying(self, exceeded: Array) -> list[float]:
        """The rows of each value that carry failures, by probabilities (R, N) of exceedance;
        infinite where none does.
        """
        failing = np.nan_to_num(exceeded if self.survive else 1.0 - exceeded)
        return [carriers(part) or math.inf for part in self.line.by_value(failing)]

    def _counted(self, limit: Limit) -> bool:
        """Whether rows of a limit are counted: its strength takes few values, or ends where demands
        lie.  Without such an end every row fails with some probability, however small.
        """
        state = self.line.state(limit)
        strength = state.strength
        if not isinstance(strength, Law) or strength.is_steps:
            return True
        low, high = strength.ppf(np.array([0.0, 1.0]))
        if self.survive:
            return bool(np.nanmin(state.demands) <= low)
        return bool(np.nanmax(state.demands) >= high)

    def _counts(self, limit: Limit) -> Array:
        """The rows (K,) of a replicate at each value; infinite where they are not counted."""
        return np.where(self._counted(limit), self.line.counts, math.inf)

    def assumed(self, mode: AssumedMode) -> Doubt:
        """A failure mode by itself, its strength at the middle of the library's range."""
        alone = self.base(mode.limit)[0]
        by_library = Alternative(code="assumed strength", limit=mode.limit)
        return self._doubt(by_library, [alone.mean(axis=1)] * 2, alone)

    def otherwise(self, alternative: Alternative) -> Doubt:
        """A limit with an alternative, at the unsafe end of what its strengths give.

        The quantiles of many strengths are taken on few rows. One strength, the one at the unsafe
        end near the target, is taken on all rows as well: the difference of its normal scores
        corrects the curve.
        """
        limit = alternative.limit
        laws = alternative.laws
        if len(laws) < 2:
            rows = self.by_strengths(limit, laws, tied=alternative.code != "tie")[:, 0]
            return self._doubt(alternative, rows.mean(axis=2), rows[1])
        few = self.few.by_strengths(limit, laws)
        ends = np.quantile(few.mean(axis=3), self._unsafe, axis=1)
        near = np.argmin(np.abs(score(ends[1]) - score(limit.allowable)))
        law = int(np.argmin(np.abs(few[1, :, near].mean(axis=1) - ends[1, near])))
        every = self.by_strengths(limit, [laws[law]])[:, 0]
        unsafe = self._shifted(limit, few, few[:, law], every, self._unsafe)
        opposite = self._shifted(limit, few, few[:, law], every, 1.0 - self._unsafe)[0][1]
        return replace(self._doubt(alternative, *unsafe), opposite=opposite)

    def contacts_yield(self, limit: Limit, others: Sequence[Alternative]) -> Iterator[Doubt]:
        """A limit where contacts yield, by its own strength and by the alternatives to it; none
        where none would.
        """
        if self.yielding is None:
            return
        design = self.yielding.design
        aim = replace(
            self.aim,
            limits=[design.limit(asked.name) for asked in self.aim.limits],
            untargeted=[design.limit(asked.name) for asked in self.aim.untargeted],
        )
        curves = Curves(aim=aim, line=self.yielding)
        before = self.few.base(limit), self.base(limit)
        strengths = [other for other in others if other.laws]
        for other in (Alternative(code="contact law", limit=limit), *strengths):
            rows = curves.by_strengths(design.limit(limit.name), other.laws)
            unsafe = self._shifted(limit, rows, *before, self._unsafe)
            yield self._doubt(replace(other, code="contact law"), *unsafe)

    @property
    def _unsafe(self) -> float:
        return ENDS[self.survive]

    def _shifted(self, limit: Limit, means: Array, few: Array, every: Array, end: float) -> Pair:
        """Curves (2, K) at a quantile of (2, laws, K, R) on few rows, and the joint one of each
        replicate (K, R), moved by the difference in normal scores between all rows and few.
        """
        counted = self._counted(limit)

        def scores(line: Line, probability: Array) -> Array:
            if counted:  # no failure among so many rows does not mean never
                probability = line.seen(probability)
            return score(probability)

        # the mean of the replicates stands before them
        means, few, every = (
            np.concatenate([rows.mean(axis=-1, keepdims=True), rows], axis=-1)
            for rows in (means, few, every)
        )
        change = scores(self.line, every) - scores(self.few.line, few)
        quantiles = np.quantile(means, end, axis=1)
        moved = special.ndtr(scores(self.few.line, quantiles) + change)
        # far out in a tail a difference of scores is a large factor: the difference of the
        # probabilities is taken where it moves the curve less
        added = np.clip(quantiles + every - few, 0.0, 1.0)
        milder = np.abs(added - quantiles) < np.abs(moved - quantiles)
        moved = np.where(milder, added, moved)
        curves = moved[:, :, 0]
        if counted:
            curves = np.array([*map(self._without_turns, curves, every[:, :, 0])])
        return curves, moved[1, :, 1:]

    def _doubt(
        self, alternative: Alternative, curves: Sequence[Array] | Array, rows: Array
    ) -> Doubt:
        """A doubt with its curves (K,), alone and joint, and the error that its replicates (K, R)
        show.
        """
        return Doubt(
            **vars(alternative),
            single=curves[0],
            curve=curves[1],
            error=spreads(rows.T, 1.0 / self._counts(alternative.limit)),
            margin=self.margin(alternative.limit, curves[1]),
        )
