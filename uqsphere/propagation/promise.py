"""What more tests would buy: the number to use by number of tests.

Series of tests are drawn from the fitted strength.  What each would allow follows from the pivots
of its distribution, the margin of a limit being tabulated over location and scale of its strength.
Each series also cuts the library's failure modes anew, so that tests raise the number twice.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.propagation.decision import Settled
from uqsphere.propagation.demands import strength_of
from uqsphere.propagation.doubts import (
    COMPUTATION,
    ENDS,
    LAWS,
    REFUTED,
    TESTS,
    Doubt,
    others_survive,
    tests_behind,
)
from uqsphere.propagation.evidence import demands_in_tests, least_factor, median
from uqsphere.propagation.failure_modes import AssumedMode, failure_modes_of, scaled_strength
from uqsphere.propagation.line import Line, score
from uqsphere.results.types import TestsGain
from uqsphere.study import Limit
from uqsphere.uq import Law, make_law
from uqsphere.uq.fitting import FINER, STRENGTHS, LocationScale, count_tests, distance, is_fitted

#: numbers of tests that are told
SIZES: Final = (10, 25, 50, 100, 200)
#: series of tests behind each
_SERIES: Final = 200
#: nodes of the table: in the quantile of the strength at the target, and in its scale
_QUANTILES: Final = 13
_SCALES: Final = 9
#: shares of the target that a limit by itself may take beside other failure modes
_SHARES: Final = (0.003, 0.03, 0.15, 0.4, 0.7, 1.0)
#: nodes between the middle and the strong end of the library's strength, and in the demand of tests
_STRENGTHS: Final = 7
_FORCES: Final = 60
#: Euler's constant
_GAMMA: Final = 0.5772156649015329

#: what strengths with these locations and scales of their logarithm allow
Tabulated = Callable[[Array, Array], Array]


@dataclass(frozen=True, kw_only=True, eq=False)
class Series:
    """Series of tests of a limit's strength.

    logs : logarithms (J, r) of the strengths of those that failed
    leaving : tests that end with each failure (r,): as many are stopped, at the largest, as today
    """

    limit: Limit
    logs: Array
    leaving: Array


def gains_of(settled: Settled, sizes: Sequence[int] = SIZES) -> list[TestsGain]:
    """The number to use with n tests drawn from the fitted strengths.

    Parameters
    ----------
    settled : the decision by today's tests
    sizes : numbers of tests; those that are no more than today's are left out

    Returns
    -------
    For each n the number to use in 10 %, 50 % and 90 % of the series; none without tests of a
    Weibull or lognormal strength, or without a number.
    """
    limits = [limit for limit in settled.aim.limits if _has_tests(limit)]
    number = settled.number
    if not limits or number is None or math.isinf(number):
        return []
    promise = _Promise(settled, limits)
    today = max(len(tests_behind(limit)) for limit in limits)
    gains = []
    for n in sizes:
        if n > today:
            numbers = promise.numbers(n)
            low, middle, high = (float(x) for x in np.quantile(numbers, [0.1, 0.5, 0.9]))
            gains.append(TestsGain(tests=n, low=low, median=middle, high=high))
    return gains


def _has_tests(limit: Limit) -> bool:
    law = strength_of(limit)
    fitted = isinstance(law, Law) and is_fitted(law) and bool(law.data)
    return fitted and isinstance(law, Law) and law.family.name in STRENGTHS


class _Promise:
    """The tables behind the numbers of an aim, and what does not depend on the tests."""

    def __init__(self, settled: Settled, limits: Sequence[Limit]) -> None:
        self.settled, self.limits = settled, limits
        names = [mode.called for mode in settled.aim.modes]
        library = failure_modes_of(settled.aim.design.study).assumed
        self.modes = [Cut(settled, mode) for mode in library if mode.called in names]
        self.others = [doubt for doubt in settled.doubts if not self._by_tests(doubt)]
        asked = {limit.name: limit for limit in limits}
        asked |= {doubt.limit.name: doubt.limit for doubt in self.others}
        self.added = {
            name: Added(settled, limit, self.modes)
            for name, limit in asked.items()
            if settled.curves.adds_up(limit)
        }
        self.tables = {limit.name: self._tables(limit) for limit in limits}

    def _by_tests(self, doubt: Doubt) -> bool:
        """Whether a doubt follows the tests."""
        return doubt.code == TESTS or (doubt.code == COMPUTATION and doubt.limit in self.limits)

    def _tables(self, limit: Limit) -> dict[str, list[Tabulated]]:
        """By distribution that the tests may leave, the place at shares of the target."""
        law, allowed = strength_of(limit), np.array([limit.allowable])
        assert isinstance(law, Law)
        names = dict.fromkeys([law.family.name, *STRENGTHS])
        if limit.needs_modulus:
            names = {law.family.name: None}
        if limit.name in self.added:
            allowed = limit.allowable * np.array(_SHARES)
        return {name: _tabulated(self.settled, limit, name, allowed) for name in names}

    def numbers(self, n: int) -> Array:
        """The number to use (J,) by each of some series of n tests."""
        settled, line = self.settled, self.settled.line
        uniforms = np.sort(np.random.default_rng(n).random((_SERIES, n)), axis=1)
        series = [_series(limit, uniforms) for limit in self.limits]
        stronger = {mode.name: mode.stronger(series, n) for mode in self.modes}
        pick = np.maximum if settled.least else np.minimum
        places = np.full(_SERIES, line.place_of(settled.ends[1]))
        along = np.broadcast_to(line.places, (_SERIES, line.places.size))
        for doubt in self.others:
            curves = np.broadcast_to(doubt.single, along.shape)
            if doubt.limit.name in self.added:
                curves = curves + self.added[doubt.limit.name](stronger, along)
            at = _places(settled, score(curves), np.array([doubt.allowed]))
            places = pick(places, at[:, 0])
        for tests in series:
            own, added = strength_of(tests.limit), self.added.get(tests.limit.name)
            assert isinstance(own, Law)
            for name, tables in self.tables[tests.limit.name].items():
                at = self._allowed(tests, STRENGTHS[name], tables)
                if added is not None:
                    at = self._together(tests.limit, at, added(stronger, at))
                if name != own.family.name:
                    unsafe = line.place_of(settled.ends[1])
                    refuted = _refuted(STRENGTHS[name], tests)
                    at = np.where(refuted[:, None], unsafe, at)
                places = pick(places, at[:, -1])
            if added is not None:
                by_modes = score(added(stronger, along))
                at = _places(settled, by_modes, np.array([tests.limit.allowable]))
                places = pick(places, at[:, 0])
        return np.asarray(np.exp(places) if line.values[0] > 0.0 else places)

    def _allowed(self, tests: Series, kind: LocationScale, tables: Sequence[Tabulated]) -> Array:
        """The place (J, shares) that the strengths allow which each series leaves."""
        ones, stopped = np.ones(tests.leaving.size), tests.leaving - 1.0
        location, scale = (part[:, None] for part in kind.maximum(tests.logs, ones, stopped))
        pivots = _pivots(kind, tuple(tests.leaving.tolist()))
        centre, inverse = kind.ranked(*pivots, tests.limit.allowable)
        end = ENDS[1] if self.settled.least else ENDS[0]
        columns = [
            np.quantile(table(location - scale * centre, scale * inverse), end, axis=1)
            for table in tables
        ]
        return np.stack(columns, axis=1)

    @staticmethod
    def _together(limit: Limit, places: Array, added: Array) -> Array:
        """The place (J, 1) where a limit, which takes a share of its target at each place, reaches
        it with what other failure modes add.
        """
        together = score(limit.allowable * np.array(_SHARES) + added)
        target = float(score(limit.allowable))
        pairs = zip(together, places, strict=True)
        return np.array([[np.interp(target, scores, row)] for scores, row in pairs])


class Cut:
    """A failure mode of the library, and how far tests cut its range."""

    def __init__(self, settled: Settled, mode: AssumedMode) -> None:
        middle = mode.limit.strength
        assert isinstance(middle, Law)
        self.mode, self.name, self.middle = mode, mode.called, middle
        self.study, self.line = settled.aim.design.study, settled.line
        self.weak, self.strong = (
            math.log(median(law) / median(middle)) for law in (mode.weak, mode.strong)
        )

    def stronger(self, series: Sequence[Series], n: int) -> Array:
        """Logarithm (J,) of what series of n tests multiply the middle by; infinite where they
        refute the mode.
        """
        parts, forces = [], set[tuple[float, ...]]()
        for tests in series:
            tested = tests.limit.tested
            if tested is None or not tested.forces or tested.forces in forces:
                continue
            forces.add(tested.forces)
            logs = np.repeat(tests.logs, tests.leaving.astype(int), axis=1)
            grid = np.linspace(logs.min(), logs.max(), _FORCES)
            alike = replace(
                tested, forces=tuple(np.exp(grid)), diameters=(tested.diameter,) * _FORCES
            )
            demands = np.log(demands_in_tests(self.study, [alike], self.mode))
            parts.append(np.exp(np.interp(logs, grid, demands)))
        if not parts:
            return np.zeros(_SERIES)
        raised = self.weak + np.log(least_factor(self.mode.weak, np.concatenate(parts, axis=1)))
        return np.where(raised > self.strong, math.inf, np.maximum(raised, 0.0))


class Added:
    """What other failure modes add to the exceedance of a limit, at places of the free number and
    by strengths of the library's modes.
    """

    def __init__(self, settled: Settled, limit: Limit, modes: Sequence[Cut]) -> None:
        from scipy.interpolate import RectBivariateSpline

        line, word = settled.curves.few.line, settled.aim.word
        stands = 1.0 - line.exceedance(line.state(limit), word)
        self.line, self.tables, self.ends = line, {}, {}
        others = others_survive(replace(settled.aim, modes=()), line).get(limit.name)
        self.others = np.zeros(line.places.size)
        if others is not None:
            self.others = line.means((1.0 - others) * stands).mean(axis=1)
        for cut in modes:
            nodes, rows = np.linspace(0.0, max(cut.strong, 1e-6), _STRENGTHS), []
            for node in nodes:
                strength = scaled_strength(cut.middle, math.exp(node))
                exceeded = line.exceedance(line.state(cut.mode.limit, strength), word)
                rows.append(line.means(exceeded * stands).mean(axis=1))
            self.ends[cut.name] = float(nodes[-1])
            self.tables[cut.name] = RectBivariateSpline(
                nodes, line.places, score(np.array(rows)), kx=1, ky=1
            )

    def __call__(self, stronger: Mapping[str, Array], places: Array) -> Array:
        """The probability (J, L) at places (J, L), where modes are stronger (J,) than the library's
        middle.
        """
        from scipy.special import ndtr

        held = 1.0 - np.interp(places, self.line.places, self.others)
        for name, table in self.tables.items():
            by = stronger[name][:, None]
            exceeded = ndtr(table.ev(np.minimum(by, self.ends[name]), places))
            held = held * np.where(np.isinf(by), 1.0, 1.0 - exceeded)
        return np.asarray(1.0 - held)


def _place_of(law: Law) -> tuple[LocationScale, float, float]:
    """The kind of a law, with the location and the scale of ln(strength)."""
    kind, p = STRENGTHS[law.family.name], law.parameters
    if kind.normal:
        return kind, p["log_mean"], p["log_sd"]
    return kind, math.log(p["scale"]), 1.0 / p["modulus"]


def _series(limit: Limit, uniforms: Array) -> Series:
    """Series of tests of a limit's strength at sorted uniforms (J, n)."""
    law = strength_of(limit)
    assert isinstance(law, Law)
    kind, location, scale = _place_of(law)
    n = uniforms.shape[1]
    broken = max(n - round(n * len(law.censored) / count_tests(law)), 3)
    logs = location + scale * kind.form.quantile(uniforms, 1.0 - uniforms)
    leaving = np.append(np.ones(broken - 1), 1.0 + n - broken)
    return Series(limit=limit, logs=logs[:, :broken], leaving=leaving)


@lru_cache(maxsize=16)
def _pivots(kind: LocationScale, leaving: tuple[float, ...]) -> tuple[Array, Array]:
    generator = np.random.default_rng(len(leaving))
    return kind.pivots(np.array(leaving), FINER * LAWS, generator)


def _refuted(kind: LocationScale, tests: Series) -> Flags:
    """Whether each series refutes a distribution that is fitted to it."""
    leaving = tests.leaving

    def away(values: Array) -> Array:
        ones = np.ones(leaving.size)
        location, scale = (part[:, None] for part in kind.maximum(values, ones, leaving - 1.0))
        return distance(kind.form.tails((values - location) / scale)[0], leaving)

    usual = away(kind.series(leaving, 1000, np.random.default_rng(leaving.size + 1)))
    return np.asarray(away(tests.logs) > np.quantile(usual, 1.0 - REFUTED))


def _tabulated(settled: Settled, limit: Limit, name: str, allowed: Array) -> list[Tabulated]:
    """Places at some probabilities of exceedance under a distribution: over the quantile of the
    strength at the target, in which they are nearly linear, and the scale; beyond the line its
    ends.
    """
    from scipy.interpolate import RectBivariateSpline

    law = strength_of(limit)
    assert isinstance(law, Law)
    own, location, scale = _place_of(law)
    kind = STRENGTHS[name]
    if kind is not own:
        # the same mean and standard deviation of the logarithm
        wider = math.sqrt(6.0) / math.pi
        location, scale = location + _GAMMA * wider * scale, scale * wider
        if kind.normal:
            _, location, scale = _place_of(law)
            location, scale = location - _GAMMA * scale, scale / wider
    below = np.array([limit.allowable])
    z = float(kind.form.quantile(below, 1.0 - below)[0])
    scales = scale * np.geomspace(0.25, 4.0, _SCALES)
    steps = np.linspace(-3.0, 3.0, _QUANTILES) * max(abs(z), 1.0) * scale
    quantiles = location + z * scale + steps
    laws = []
    for quantile, width in itertools.product(quantiles, scales):
        parameters = kind.parameters(quantile - z * width, width)
        laws.append(make_law(name, {key: float(x) for key, x in parameters.items()}))
    curves = settled.curves.by_strengths(limit, laws)[0].mean(axis=2)
    table = _places(settled, score(curves), allowed).reshape(quantiles.size, scales.size, -1)
    splines = [
        RectBivariateSpline(quantiles, np.log(scales), table[:, :, k], kx=1, ky=1)
        for k in range(allowed.size)
    ]

    def tabulated(spline: RectBivariateSpline) -> Tabulated:
        return lambda at, wide: spline.ev(at + z * wide, np.log(wide))

    return [tabulated(spline) for spline in splines]


def _places(settled: Settled, scores: Array, allowed: Array) -> Array:
    """Places (J, L) at which curves of normal scores (J, K) first leave the safe side of some
    probabilities (L,), seen from the safe end; beyond the line its ends.
    """
    from scipy.interpolate import PchipInterpolator

    line: Line = settled.line
    fine = np.linspace(line.places[0], line.places[-1], 8 * line.places.size)
    curves, levels = PchipInterpolator(line.places, scores, axis=1)(fine), score(allowed)
    if not settled.aim.survive:
        curves, levels = -curves, -levels
    if settled.least:
        curves, fine = curves[:, ::-1], fine[::-1]
    rising = np.maximum.accumulate(curves, axis=1)
    return np.array([np.interp(levels, row, fine) for row in rising])
