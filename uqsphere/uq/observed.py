"""Standard forms of laws that are made from observations: a step function, a kernel density, and the draws of a fit.

The last two are means of many laws.  A table of z(x) = ndtri(F(x)), which is smooth and almost a straight line in both
tails, and of dz/dx with cubic interpolation gives F and its inverse to 1e-9 anywhere, at the price of a look-up.  Every
draw is a law of its own, (kind, least, scale, shape, bound), one of those that the tests allow:

    kind 0   ln(x*/scale)/shape is standard normal, x* = x/(1 - bound x/scale): a lognormal law with an upper end
             scale/bound, or none where bound is 0
    kind 1   1 - exp(-((x - least)/scale)^shape): a Weibull law
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.uq.forms import Form, Function

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

    from uqsphere.uq.law import Law

#: Beyond this many observations a kernel density has nothing to add to the step function.
MOST_KERNELS: Final = 5000
#: normal scores beyond this are below the smallest floating-point probability
FURTHEST: Final = 37.5
#: numbers of a draw, and the kinds
WIDTH: Final = 5
LOGNORMAL, WEIBULL = 0.0, 1.0
#: values times laws up to which a mean is taken of the laws themselves, and that a part of a table is made of at once
_FEW: Final = 1_000_000
_PART: Final = 2_000_000
_ROOT: Final = math.sqrt(2.0 * math.pi)


def empirical(law: Law) -> Form:
    """A kernel density of the observations with the parameter `bandwidth`; a step function where that is 0."""
    data, width = np.array(law.data), law.parameters["bandwidth"]
    return _kernels(data, width) if width > 0.0 else _steps(data[(data >= law.lower) & (data <= law.upper)])


def _steps(data: Array) -> Form:
    def share(x: Array) -> Array:
        return np.asarray(np.searchsorted(data, x, side="right") / data.size)

    def quantile(p: Array) -> Array:
        """The smallest observation whose share at or below it reaches p."""
        # A share such as 3/10 is not exact in binary: half a unit of rounding must not skip an observation.
        rank = np.ceil(p * data.size * (1.0 - 4e-16)).astype(int) - 1
        return np.asarray(data[np.clip(rank, 0, data.size - 1)])

    moments = (float(data.mean()), float(data.std())) if data.size else (math.nan, math.nan)
    return Form(cdf=share, sf=lambda x: 1.0 - share(x), ppf=quantile, isf=lambda q: quantile(1.0 - q), pdf=None,
                moments=moments)  # fmt: skip


def bandwidth(data: Array) -> float:
    """Width of the Gaussian kernel: 0.9 min(sd, IQR/1.34) n^(-1/5) (Silverman 1986)."""
    sd = float(np.std(data, ddof=1))
    quartiles = np.quantile(data, [0.25, 0.75])
    spread = float(quartiles[1] - quartiles[0]) / 1.34
    return float(0.9 * (min(sd, spread) if spread > 0.0 else sd) * data.size**-0.2)


# --- means of many laws: cubics of normal scores between the nodes of x, a straight line beyond --------------------


def _mean_of_laws(
    count: int, cdf: Function, sf: Function, pdf: Function, nodes: Callable[[], Array],
    moments: tuple[float, float] | None = None,
) -> Form:  # fmt: skip
    """The form of a mean of `count` laws: of few values by the laws themselves, of more by a table over the nodes."""

    @cache
    def table() -> CubicHermiteSpline:
        """Normal scores over x, of the two tails and the density there, as far as they are known and rise."""
        from scipy.interpolate import CubicHermiteSpline

        x = nodes()
        parts = np.array_split(x, 1 + x.size * count // _PART)
        below, above, density = (np.concatenate([one(part) for part in parts]) for one in (cdf, sf, pdf))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            score = np.where(below <= 0.5, special.ndtri(below), -special.ndtri(above))
            slope = density * _ROOT * np.exp(0.5 * score * score)
            known = np.isfinite(score) & np.isfinite(slope) & (np.diff(score, prepend=-math.inf) >= 0.0)
        return CubicHermiteSpline(x[known], score[known], slope[known])

    def score(x: Array) -> Array:
        spline = table()
        near = np.clip(x, spline.x[0], spline.x[-1])
        return np.asarray(spline(near) + np.where(x == near, 0.0, spline(near, 1) * (x - near)))

    def quantile(score: Array) -> Array:
        """Inverse of the score, solved inside one cell of the table."""
        from scipy.optimize import elementwise

        spline = table()
        scores = spline(spline.x)
        near = np.clip(score, scores[0], scores[-1])
        cell = np.clip(np.searchsorted(scores, near) - 1, 0, scores.size - 2)
        ends = spline.x[cell], spline.x[cell + 1]

        def gap(x: Array, wanted: Array) -> Array:
            return np.asarray(spline(x) - wanted)

        solved = elementwise.find_root(gap, ends, args=(near,), tolerances={"fatol": 1e-13})
        # in a gap between observations the score does not rise at all
        found = np.where(solved.success, solved.x, np.where(near > scores[cell], ends[1], ends[0]))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(found + np.where(score == near, 0.0, (score - near) / spline(found, 1)))

    def density(x: Array) -> Array:
        spline = table()
        near = np.clip(x, spline.x[0], spline.x[-1])
        return np.where(x == near, spline(near, 1) * np.exp(-0.5 * spline(near) ** 2) / _ROOT, 0.0)

    def few(x: Array) -> bool:
        return x.size * count <= _FEW

    return Form(
        cdf=lambda x: cdf(x) if few(x) else special.ndtr(score(x)),
        sf=lambda x: sf(x) if few(x) else special.ndtr(-score(x)),
        ppf=lambda p: quantile(special.ndtri(p)),
        isf=lambda q: quantile(-special.ndtri(q)),
        pdf=lambda x: pdf(x) if few(x) else density(x),
        moments=moments,
    )


def _kernels(data: Array, width: float) -> Form:
    def z(x: Array) -> Array:
        return np.asarray((x[..., None] - data) / width)

    def nodes() -> Array:
        # every width/48 within nine widths of an observation; in a wider gap F is constant to 1e-18
        breaks = np.flatnonzero(np.diff(data) > 18.0 * width)
        starts = np.concatenate([data[:1] - FURTHEST * width, data[breaks + 1] - 9.0 * width])
        ends = np.concatenate([data[breaks] + 9.0 * width, data[-1:] + FURTHEST * width])
        return np.concatenate([np.linspace(a, b, max(2, math.ceil((b - a) / width * 48.0)))
                               for a, b in zip(starts, ends, strict=True)])  # fmt: skip

    return _mean_of_laws(
        data.size,
        lambda x: special.ndtr(z(x)).mean(axis=-1),
        lambda x: special.ndtr(-z(x)).mean(axis=-1),
        lambda x: np.exp(-0.5 * z(x) ** 2).mean(axis=-1) / (width * _ROOT),
        nodes,
        moments=(float(data.mean()), math.hypot(float(data.std()), width)),
    )


def drawn(law: Law) -> Form:
    """The mean of the laws of the draws, of y = ln x."""
    rows = np.array(law.draws)
    count, weibull = len(rows), rows[:, 0] == WEIBULL
    _, _, median, sd, bound = rows[~weibull].T
    _, least, scale, modulus, _ = rows[weibull].T

    def left(x: Array) -> Array:
        """What is left of 1 below the upper end of each lognormal law."""
        return np.asarray(np.maximum(1.0 - bound * (x / median), 0.0))

    def z(x: Array) -> Array:
        return np.asarray((np.log(x / median) - np.log(left(x))) / sd)

    def hazard(x: Array) -> Array:
        return np.asarray(np.maximum((x - least) / scale, 0.0) ** modulus)

    @np.errstate(all="ignore")
    def mean(y: Array, normal: Function, extreme: Function) -> Array:
        x = np.exp(np.asarray(y, dtype=float))[..., None]
        return np.asarray((normal(x).sum(axis=-1) + extreme(x).sum(axis=-1)) / count)

    def normal_density(x: Array) -> Array:
        return np.asarray(np.nan_to_num(np.exp(-0.5 * z(x) ** 2) / (_ROOT * sd * left(x))))

    def extreme_density(x: Array) -> Array:
        return np.asarray(np.nan_to_num(modulus * hazard(x) * x / (x - least) * np.exp(-hazard(x))))

    def nodes() -> Array:
        # 4001 nodes between scores of -6 and 6, and 400 on either side: shares are then known to 1e-8
        start, low, high, end = (reach(s) for s in (-FURTHEST, -6.0, 6.0, FURTHEST))
        tails = np.linspace(start, low, 400)[:-1], np.linspace(high, end, 400)[1:]
        return np.concatenate([tails[0], np.linspace(low, high, 4001), tails[1]])

    @np.errstate(all="ignore")
    def reach(score: float) -> float:
        """ln x beyond which no draw has this normal score."""
        stretched = median * np.exp(sd * score)
        # a hazard of -ln(1 - Phi(z))
        hazards = np.maximum(-special.log_ndtr(-score), 1e-300)
        found = [*(stretched / (1.0 + bound * stretched / median)), *(least + scale * hazards ** (1.0 / modulus))]
        return math.log(max(min(found), 1e-300)) if score < 0.0 else math.log(max(found))

    return _mean_of_laws(
        count,
        lambda y: mean(y, lambda x: special.ndtr(z(x)), lambda x: -np.expm1(-hazard(x))),
        lambda y: mean(y, lambda x: special.ndtr(-z(x)), lambda x: np.exp(-hazard(x))),
        lambda y: mean(y, normal_density, extreme_density),
        nodes,
    )
