"""What more tests would buy: the number to use by number of tests.

Series of tests are drawn from the fitted strength.  What each would allow follows from the pivots
of its distribution, the margin of a limit being tabulated over location and scale of its strength.
Each series also cuts the library's failure modes anew, so that tests raise the number twice.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from uqsphere.arrays import Array, Flags, Pair, special
from uqsphere.results.types import TestsGain
from uqsphere.study import Limit
from uqsphere.uq import Law, make_law
from uqsphere.uq.estimate import ENDS
from uqsphere.uq.fitting import STRENGTHS, LocationScale, is_fitted

from .decision import Settled
from .doubts import LAWS, Others, tests_behind
from .failure_modes import (
    REFUTED,
    AssumedMode,
    demands_in_tests,
    failure_modes_of,
    least_factor,
    median,
    scaled_strength,
)
from .line import exceedance, score

#: numbers of tests that are told
SIZES = (10, 25, 50, 100, 200)
#: series of tests behind each
_SERIES = 200
#: nodes of the table: in the quantile of the strength at the target, and in its scale
_QUANTILES = 13
_SCALES = 9
#: shares of the target that a limit by itself may take beside other failure modes
_SHARES = (0.003, 0.03, 0.15, 0.4, 0.7, 1.0)
#: nodes between the middle and the strong end of the library's strength, and in the demand of tests
_STRENGTHS = 7
_FORCES = 60
#: Euler's constant
_GAMMA = 0.5772156649015329

#: what failure modes add to the exceedance of a limit at places (J, L), those of the library being
#: stronger than at their middle by logarithms (J,)
Added = Callable[[Sequence[Array], Array], Array]


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
    limits = []
    for limit in settled.aim.limits:
        law = limit.resistance
        if is_fitted(law) and law.family.name in STRENGTHS and law.data:
            limits.append(limit)
    if not limits or settled.use is None:
        return []
    line = settled.line
    pick = np.maximum if settled.safe_above else np.minimum
    margins = [settled.ends[1]]
    for doubt in settled.doubts:
        by_tests = doubt.limit in limits and (doubt.code == "computation" or doubt.detail)
        if not by_tests and doubt.margin is not None and math.isfinite(doubt.margin):
            margins.append(doubt.margin)
    start = np.full(_SERIES, line.place_of(pick.reduce(margins)))
    promises = [_Promise(settled, limit) for limit in limits]
    today = max(len(tests_behind(limit)) for limit in limits)
    gains = []
    for n in sizes:
        if n > today:
            uniforms = np.sort(np.random.default_rng(n).random((_SERIES, n)), axis=1)
            allowed = [start]
            for promise in promises:
                allowed += promise.places(uniforms)
            ends = np.quantile(pick.reduce(allowed), [0.1, 0.5, 0.9])
            low, middle, high = sorted(line.value_at(end) for end in ends)
            gains.append(TestsGain(tests=n, low=low, median=middle, high=high))
    return gains


class _Promise:
    """What tests of a limit's strength allow, with the failure modes that they leave."""

    def __init__(self, settled: Settled, limit: Limit) -> None:
        law = limit.resistance
        assert isinstance(law, Law)
        self.settled, self.limit, self.law = settled, limit, law
        names = [*STRENGTHS]
        if limit.needs_modulus:
            names = [law.family.name]
        counted = [mode.called for mode in settled.aim.modes if settled.adds_up(limit)]
        library = failure_modes_of(settled.aim.design.study)[0]
        self.modes = [mode for mode in library if mode.called in counted]
        self.allowed = limit.allowable * np.array(_SHARES)
        self.added = _added(settled, limit, self.modes)
        self.tables = {name: self._tabulated(name) for name in names}

    def places(self, uniforms: Array) -> Iterator[Array]:
        """Places (J,) that series of tests (J, n) allow, by distribution and by other modes."""
        settled = self.settled
        line = settled.line
        logs, leaving = self._series(uniforms)
        stronger = [self._stronger(mode, logs, leaving) for mode in self.modes]
        added = partial(self.added, stronger)
        if settled.adds_up(self.limit):
            along = np.broadcast_to(line.places, (_SERIES, line.places.size))
            target = np.array([self.limit.allowable])
            yield _places(settled, score(added(along)), target)[:, 0]
        for name, (z, splines) in self.tables.items():
            kind = STRENGTHS[name]
            location, scale = (part[:, None] for part in kind.fit(logs, leaving))
            centre, inverse = _pivots(kind, tuple(leaving.tolist()), self.limit.allowable)
            wide = scale * inverse
            quantile = location - scale * centre + z * wide
            allowed = [spline.ev(quantile, np.log(wide)) for spline in splines]
            at = np.quantile(allowed, ENDS[settled.safe_above], axis=2).T
            # where the limit's share and the other modes make the target
            together = score(self.allowed + added(at))
            target = score(self.limit.allowable)
            pairs = zip(together, at, strict=True)
            places = np.array([np.interp(target, scores, row) for scores, row in pairs])
            if name != self.law.family.name:
                refuted = _refuted(kind, logs, leaving)
                places = np.where(refuted, line.place_of(settled.ends[1]), places)
            yield places

    def _series(self, uniforms: Array) -> Pair:
        """Logarithms (J, r) of the strengths that failed, and the tests that end with each failure
        (r,): as many are stopped, at the largest, as today.
        """
        kind, location, scale = _place_of(self.law)
        n = uniforms.shape[1]
        law = self.law
        broken = max(n - round(n * len(law.censored) / law.tests), 3)
        logs = location + scale * kind.form.quantile(uniforms, 1.0 - uniforms)
        return logs[:, :broken], np.append(np.ones(broken - 1), 1.0 + n - broken)

    def _stronger(self, mode: AssumedMode, logs: Array, leaving: Array) -> Array:
        """Logarithm (J,) of what series of tests multiply the middle of a mode by; infinite where
        they refute it.
        """
        tested = self.limit.tested
        if not tested or not tested.forces:
            return np.zeros(len(logs))
        grid = np.linspace(logs.min(), logs.max(), _FORCES)
        alike = replace(tested, forces=tuple(np.exp(grid)), diameters=(tested.diameter,) * _FORCES)
        demands = np.log(demands_in_tests(self.settled.aim.design.study, [alike], mode))
        borne = np.repeat(logs, leaving.astype(int), axis=1)
        raised = np.log(least_factor(mode.weak, np.exp(np.interp(borne, grid, demands))))
        raised += math.log(median(mode.weak) / median(mode.middle))
        # forces beyond what a mode can reach say nothing of it
        return np.where(raised > _range_of(mode), math.inf, np.fmax(raised, 0.0))

    def _tabulated(self, name: str) -> tuple[float, list[Any]]:
        """The standard quantile at the target of a distribution; and, for every allowed probability
        of exceedance, a spline of the places that strengths with such logarithms allow: over their
        quantile at the target, in which places are nearly linear, and the logarithm of their scale;
        beyond the line its ends.
        """
        from scipy.interpolate import RectBivariateSpline

        fitted, location, scale = _place_of(self.law)
        wider = math.sqrt(6.0) / math.pi
        kind = STRENGTHS[name]
        # the same mean and standard deviation of the logarithm
        if kind is not fitted and kind.normal:
            location -= _GAMMA * scale
            scale /= wider
        elif kind is not fitted:
            location += _GAMMA * wider * scale
            scale *= wider
        below = np.array([self.limit.allowable])
        (z,) = kind.form.quantile(below, 1.0 - below)
        scales = scale * np.geomspace(0.25, 4.0, _SCALES)
        steps = np.linspace(-3.0, 3.0, _QUANTILES) * max(abs(z), 1.0) * scale
        quantiles = location + z * scale + steps
        laws = [
            make_law(name, kind.parameters(quantile - z * width, width))
            for quantile, width in itertools.product(quantiles, scales)
        ]
        curves = self.settled.by_strengths(self.limit, laws)[0].mean(axis=2)
        table = _places(self.settled, score(curves), self.allowed).reshape(
            quantiles.size, scales.size, -1
        )
        return z, [
            RectBivariateSpline(quantiles, np.log(scales), places, kx=1, ky=1)
            for places in np.moveaxis(table, 2, 0)
        ]


def _range_of(mode: AssumedMode) -> float:
    """Logarithm of the strong end of the library's range over its middle."""
    return math.log(median(mode.strong) / median(mode.middle))


def _added(settled: Settled, limit: Limit, modes: Sequence[AssumedMode]) -> Added:
    """What other failure modes add to the exceedance of a limit."""
    from scipy.interpolate import RectBivariateSpline

    line = settled.line.few
    survive = settled.survive
    exceeded_here = exceedance(line.state(limit), survive)
    stands = 1.0 - exceeded_here
    others = settled.few.own.others.get(limit.name, Others())
    # neither of the study's other limits without this one
    held = line.means(1.0 - others.or_any(exceeded_here) + exceeded_here).mean(axis=1)
    tables = []
    for mode in modes:
        nodes = np.linspace(0.0, max(_range_of(mode), 1e-6), _STRENGTHS)
        state = line.state(mode.limit)
        rows = []
        for node in nodes:
            stronger = replace(state, strength=scaled_strength(mode.middle, math.exp(node)))
            rows.append(line.means(exceedance(stronger, survive) * stands).mean(axis=1))
        scores = score(np.array(rows))
        tables.append(RectBivariateSpline(nodes, line.places, scores, kx=1, ky=1))

    def added(stronger: Sequence[Array], places: Array) -> Array:
        none = np.interp(places, line.places, held)
        for table, by in zip(tables, stronger, strict=True):
            # beyond its nodes a spline stays at its end
            exceeded = special.ndtr(table.ev(by[:, None], places))
            none = none * np.where(np.isinf(by)[:, None], 1.0, 1.0 - exceeded)
        return np.asarray(1.0 - none)

    return added


def _place_of(law: Law) -> tuple[LocationScale, float, float]:
    """The kind of a law, with the location and the scale of ln(strength)."""
    kind = STRENGTHS[law.family.name]
    p = law.parameters
    if kind.normal:
        return kind, p["log_mean"], p["log_sd"]
    return kind, math.log(p["scale"]), 1.0 / p["modulus"]


@lru_cache(maxsize=16)
def _pivots(kind: LocationScale, leaving: tuple[float, ...], at: float) -> Pair:
    return kind.pivots(np.array(leaving), LAWS, np.random.default_rng(len(leaving)), at)


def _refuted(kind: LocationScale, logs: Array, leaving: Array) -> Flags:
    """Whether each of some series of tests (J, r) refutes a distribution that is fitted to it."""
    usual = kind.series(leaving, 1000, np.random.default_rng(leaving.size + 1))
    most = np.quantile(kind.misfit(usual, leaving), 1.0 - REFUTED)
    return kind.misfit(logs, leaving) > most


def _places(settled: Settled, scores: Array, allowed: Array) -> Array:
    """Places (J, L) at which curves of normal scores (J, K) first leave the safe side of some
    probabilities (L,), seen from the safe end; beyond the line its ends.
    """
    from scipy.interpolate import PchipInterpolator

    line = settled.line
    fine = np.linspace(line.places[0], line.places[-1], 8 * line.places.size)
    curves = PchipInterpolator(line.places, scores, axis=1)(fine)
    levels = score(allowed)
    if not settled.survive:
        curves = -curves
        levels = -levels
    if settled.safe_above:
        curves = curves[:, ::-1]
        fine = fine[::-1]
    rising = np.maximum.accumulate(curves, axis=1)
    return np.array([np.interp(levels, row, fine) for row in rising])
