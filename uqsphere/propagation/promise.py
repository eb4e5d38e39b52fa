"""What more tests would buy: the number to use by number of tests.

The margin of a limit is tabulated over location and scale of its strength; series of tests are
drawn from the fitted strength, and what each would allow follows from the pivots of its
distribution.  Failure modes stay as today's tests leave them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.propagation.decision import Settled
from uqsphere.propagation.demands import strength_of
from uqsphere.propagation.doubts import ENDS, LAWS, REFUTED, TESTS, tests_behind
from uqsphere.results.types import TestsGain
from uqsphere.study import Limit
from uqsphere.uq import Law, make_law
from uqsphere.uq.fitting import STRENGTHS, LocationScale, count_tests, distance, is_fitted

#: numbers of tests that are told
SIZES: Final = (10, 25, 50, 100, 200)
#: series of tests behind each
_SERIES: Final = 200
#: nodes of the table: in the quantile of the strength at the target, and in its scale
_QUANTILES: Final = 13
_SCALES: Final = 9

#: margins of strengths with these locations and scales of their logarithm
Margins = Callable[[Array, Array], Array]


@dataclass(frozen=True, kw_only=True, eq=False)
class Tabulated:
    """The margin of a limit as a function of the location and the scale of ln(strength).

    own : whether the distribution is that of the fitted strength
    """

    kind: LocationScale
    margins: Margins
    own: bool


def gains_of(settled: Settled, sizes: Sequence[int] = SIZES) -> list[TestsGain]:
    """The number to use with n tests drawn from the fitted strengths: 10 %, 50 % and 90 % of the
    series; none without tests of a Weibull or lognormal strength.
    """
    limits = [limit for limit in settled.aim.limits if _has_tests(limit)]
    number = settled.number
    if not limits or number is None or math.isinf(number):
        return []
    tables = {limit.name: _tables(settled, limit) for limit in limits}
    pick = np.maximum if settled.least else np.minimum
    others = [
        doubt.margin
        for doubt in settled.doubts
        if doubt.code != TESTS and doubt.margin is not None and math.isfinite(doubt.margin)
    ]
    today = max(len(tests_behind(limit)) for limit in limits)
    gains = []
    for n in sizes:
        if n <= today:
            continue
        uniforms = np.sort(np.random.default_rng(n).random((_SERIES, n)), axis=1)
        numbers = np.full(_SERIES, settled.ends[1])
        for margin in others:
            numbers = pick(numbers, margin)
        for limit in limits:
            series = _series(limit, uniforms)
            for table in tables[limit.name]:
                numbers = pick(numbers, _allowed(settled, table, *series))
        low, median, high = (float(x) for x in np.quantile(numbers, [0.1, 0.5, 0.9]))
        gains.append(TestsGain(tests=n, low=low, median=median, high=high))
    return gains


def _has_tests(limit: Limit) -> bool:
    law = strength_of(limit)
    fitted = isinstance(law, Law) and is_fitted(law) and bool(law.data)
    return fitted and isinstance(law, Law) and law.family.name in STRENGTHS


def _place_of(law: Law) -> tuple[LocationScale, float, float]:
    """The kind of a law, with the location and the scale of ln(strength)."""
    kind, p = STRENGTHS[law.family.name], law.parameters
    if kind.normal:
        return kind, p["log_mean"], p["log_sd"]
    return kind, math.log(p["scale"]), 1.0 / p["modulus"]


def _series(limit: Limit, uniforms: Array) -> tuple[Array, Array]:
    """Logarithms (J, n) of series of tests of a limit's strength, and the tests that end with each
    failure (r,): as many are stopped, at the largest forces, as today.
    """
    law = strength_of(limit)
    assert isinstance(law, Law)
    kind, location, scale = _place_of(law)
    n = uniforms.shape[1]
    broken = max(n - round(n * len(law.censored) / count_tests(law)), 3)
    logs = location + scale * kind.form.quantile(uniforms, 1.0 - uniforms)
    return logs[:, :broken], np.append(np.ones(broken - 1), 1.0 + n - broken)


def _allowed(settled: Settled, table: Tabulated, logs: Array, leaving: Array) -> Array:
    """The number (J,) that a distribution allows by each of some series of tests; that of a
    distribution which a series refutes does not count.
    """
    kind, stopped = table.kind, leaving - 1.0
    ones = np.ones(leaving.size)
    location, scale = (part[:, None] for part in kind.maximum(logs, ones, stopped))
    centre, inverse = kind.pivots(leaving, LAWS, np.random.default_rng(leaving.size))
    margins = table.margins(location - scale * centre, scale * inverse)
    end = ENDS[1] if settled.least else ENDS[0]
    numbers = np.quantile(margins, end, axis=1)
    if not table.own:
        numbers = np.where(_refuted(kind, logs, leaving), settled.ends[1], numbers)
    return np.asarray(numbers)


def _refuted(kind: LocationScale, logs: Array, leaving: Array) -> Flags:
    """Whether series of tests (J, r) refute a distribution that is fitted to them."""

    def away(values: Array) -> Array:
        ones = np.ones(leaving.size)
        location, scale = (part[:, None] for part in kind.maximum(values, ones, leaving - 1.0))
        return distance(kind.form.tails((values - location) / scale)[0], leaving)

    usual = away(kind.series(leaving, 1000, np.random.default_rng(leaving.size + 1)))
    return np.asarray(away(logs) > np.quantile(usual, 1.0 - REFUTED))


def _tables(settled: Settled, limit: Limit) -> list[Tabulated]:
    """The margin under each distribution that the tests may leave."""
    law = strength_of(limit)
    assert isinstance(law, Law)
    kinds = {law.family.name: STRENGTHS[law.family.name]}
    if not limit.needs_modulus:
        kinds |= STRENGTHS
    return [
        Tabulated(kind=kind, margins=_table(settled, limit, name), own=name == law.family.name)
        for name, kind in kinds.items()
    ]


def _table(settled: Settled, limit: Limit, name: str) -> Margins:
    """Margins under a distribution: over the quantile of the strength at the target, in which they
    are nearly linear, and the scale; beyond the line its ends.
    """
    from scipy.interpolate import RectBivariateSpline

    law = strength_of(limit)
    assert isinstance(law, Law)
    own, location, scale = _place_of(law)
    kind = STRENGTHS[name]
    if kind is not own:
        # the same mean and standard deviation of the logarithm
        if kind.normal:
            location -= 0.5772156649015329 * scale
            scale *= math.pi / math.sqrt(6.0)
        else:
            scale *= math.sqrt(6.0) / math.pi
            location += 0.5772156649015329 * scale
    below = np.array([limit.allowable])
    z = float(kind.form.quantile(below, 1.0 - below)[0])
    scales = scale * np.geomspace(0.25, 4.0, _SCALES)
    steps = np.linspace(-3.0, 3.0, _QUANTILES) * max(abs(z), 1.0) * scale
    quantiles = location + z * scale + steps
    laws = []
    for quantile, width in itertools.product(quantiles, scales):
        parameters = kind.parameters(quantile - z * width, width)
        laws.append(make_law(name, {key: float(x) for key, x in parameters.items()}))
    curves = settled.curves.by_strengths(limit, laws)[1].mean(axis=2)
    line, survive = settled.line, settled.aim.survive
    nowhere, everywhere = line.places[0], line.places[-1]
    if settled.least:
        nowhere, everywhere = everywhere, nowhere
    places = []
    for curve in curves:
        margin = line.crossing(curve, limit.allowable, keeps_below=survive)
        if margin is None:
            places.append(nowhere)
        elif math.isinf(margin):
            places.append(everywhere)
        else:
            places.append(line.place_of(margin))
    table = np.reshape(places, (len(quantiles), len(scales)))
    spline = RectBivariateSpline(quantiles, np.log(scales), table, kx=1, ky=1)

    def margins(at: Array, wide: Array) -> Array:
        place = spline.ev(at + z * wide, np.log(wide))
        return np.exp(place) if line.values[0] > 0.0 else place

    return margins
