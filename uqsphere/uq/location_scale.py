"""Location-scale families: their largest likelihood with stopped tests among the others, and what few tests leave open.

A family belongs here where some u(x), such as ln x, has a location m and a scale s, so that z = (u - m)/s is standard
normal, or the logarithm of an exponential variable.  With the estimates (m*, s*) of n draws of the standard law, the
pivots m - s m*/s* and s/s* are draws whose quantile intervals cover a quantile, or a probability, exactly as often as
they promise, however small n is (J. F. Lawless, Statistical Models and Methods for Lifetime Data, 2003, sections 4.1
and E).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.uq.forms import GAUSS, SMALLEST, Form

#: beyond so many failures the pivots follow the law of large samples
MANY: Final = 300
#: simulated series that are fitted at a time
_BLOCK: Final = 1000


@dataclass(frozen=True, kw_only=True, eq=False)
class LocationScale:
    """A family whose u(x) has a location m and a scale s."""

    u: Callable[[Array], Array]  # rising or falling with x
    parameters: Callable[[Any, Any], dict[str, Any]]  # (m, s), numbers or arrays -> parameters of the family
    inverse: bool = False  # the shape is 1/s (a modulus), else s itself
    form: Form  # of z
    #: (z, failures, stopped), those numbers of tests at each z -> log-likelihood without ln(1/s), and its first and
    #: second derivative by z
    terms: Callable[[Array, Any, Any], tuple[Array, Array, Array]]

    def shape(self, s: Any) -> Any:
        """Shape of the law with the scale s, and the other way round."""
        return 1.0 / s if self.inverse else s

    def maximum(self, u: Array, failures: Array, stopped: Any = 0.0) -> tuple[Array, Array]:
        """Location and scale (rows,) of the largest likelihood of u (rows, n).

        `failures`, `stopped` (n,): how many tests failed, or were stopped, at each value.  sum over failures [ln f(z) -
        ln s] + sum over stopped tests ln S(z) is concave in 1/s and m/s (R. J. Olsen, Econometrica 46, 1978, 1211):
        Newton's method finds its one maximum.
        """
        count = float(failures.sum())
        centre = (u @ failures / count)[:, None]
        spread = np.sqrt(np.square(u - centre) @ failures / count)[:, None]
        y = (u - centre) / spread
        at, step = np.array([np.ones(len(y)), np.zeros(len(y))]), np.zeros((2, len(y)))
        best = np.full(len(y), -math.inf)
        for _ in range(200):
            h, g = at + step
            value, first, second = self.terms(h[:, None] * y - g[:, None], failures, stopped)
            level = value.sum(axis=1) + count * np.log(h)
            climbs = level >= best - 1e-12 * np.abs(best)
            at, best = np.where(climbs, at + step, at), np.where(climbs, level, best)
            slope_h, slope_g = (first * y).sum(axis=1) + count / h, -first.sum(axis=1)
            hh, hg = (second * y * y).sum(axis=1) - count / h**2, -(second * y).sum(axis=1)
            gg = second.sum(axis=1)
            newton = np.array([hg * slope_g - gg * slope_h, hg * slope_h - hh * slope_g]) / (hh * gg - hg * hg)
            # a step that leaves h > 0 ends before it does, one that does not climb is halved
            newton *= np.minimum(1.0, 0.9 * h / np.maximum(-newton[0], 1e-300))
            step = np.where(climbs, newton, 0.5 * step)
            if np.max(np.abs(step[0]) / at[0] + np.abs(step[1])) < 1e-12:
                break
        return at[1] / at[0] * spread[:, 0] + centre[:, 0], spread[:, 0] / at[0]

    def series(self, leaving: Array, count: int, generator: np.random.Generator) -> Array:
        """Failures (count, r) of simulated series of the standard law, in rising order.

        `leaving` (r,): tests that end with each failure, those stopped before the next one with it.  Such series are
        progressively censored (N. Balakrishnan, R. A. Sandhu, Am. Stat. 49, 1995, 229): the distribution of (m* - m)/s*
        and s*/s depends on neither m nor s, exactly without stopped tests and with tests stopped at the r-th failure.
        """
        steps = generator.standard_exponential((count, leaving.size)) / np.cumsum(leaving[::-1])[::-1]
        return self._of_hazard(np.cumsum(steps, axis=1))

    def _of_hazard(self, hazards: Array) -> Array:
        return self.form.quantile(-np.expm1(-hazards), np.exp(-hazards))

    def pivots(self, leaving: Array, count: int, generator: np.random.Generator) -> tuple[Array, Array]:
        """(m*/s*, 1/s*) (count,) of the largest likelihood of such series; normal beyond `MANY` failures."""
        ones, stopped = np.ones(leaving.size), leaving - 1.0
        if leaving.size > MANY:
            z = self._of_hazard(np.cumsum(1.0 / np.cumsum(leaving[::-1])[::-1]))
            second = self.terms(z, ones, stopped)[2]
            mixed = (second * z).sum()
            information = [[ones.sum() - (second * z * z).sum(), mixed], [mixed, -second.sum()]]
            logs, places = generator.multivariate_normal([0.0, 0.0], np.linalg.inv(information), count).T
            return places, np.exp(logs)
        blocks = [min(_BLOCK, count - done) for done in range(0, count, _BLOCK)]
        found = [self.maximum(self.series(leaving, block, generator), ones, stopped) for block in blocks]
        location, scale = (np.concatenate(part) for part in zip(*found, strict=True))
        return location / scale, 1.0 / scale


def _normal_terms(z: Array, failures: Any, stopped: Any) -> tuple[Array, Array, Array]:
    hazard = math.sqrt(2.0 / math.pi) / special.erfcx(z / math.sqrt(2.0))  # phi(z)/S(z)
    value = stopped * special.log_ndtr(-z) - failures * (0.5 * z * z + 0.5 * math.log(2.0 * math.pi))
    return value, -failures * z - stopped * hazard, -failures - stopped * hazard * (hazard - z)


def _extreme_terms(z: Array, failures: Any, stopped: Any) -> tuple[Array, Array, Array]:
    power = (failures + stopped) * np.exp(np.minimum(z, 700.0))
    return failures * z - power, failures - power, -power


NORMAL: Final = LocationScale(
    u=np.asarray, parameters=lambda m, s: {"mean": m, "sd": s}, terms=_normal_terms, form=GAUSS
)
LOGNORMAL: Final = replace(NORMAL, u=np.log, parameters=lambda m, s: {"log_mean": m, "log_sd": s})
WEIBULL: Final = LocationScale(
    u=np.log, parameters=lambda m, s: {"modulus": 1.0 / s, "scale": np.exp(m), "threshold": 0.0 * m}, inverse=True,
    terms=_extreme_terms, form=SMALLEST,
)  # fmt: skip
#: 1/x is Weibull with the same shape
FRECHET: Final = replace(
    WEIBULL,
    u=lambda x: -np.log(x),
    parameters=lambda m, s: {"shape": 1.0 / s, "scale": np.exp(-m), "location": 0.0 * m},
)
#: the negative of a largest value is the logarithm of a Weibull variable
GUMBEL: Final = replace(WEIBULL, u=np.negative, parameters=lambda m, s: {"location": -m, "scale": s})
