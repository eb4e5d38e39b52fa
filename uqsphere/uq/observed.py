"""Standard forms of laws that are made from observations: a step function, a kernel density, and
the draws of a fit.

The last two are means of many laws.  Monotone cubics of z(x) = ndtri(F(x)), which is smooth and
almost a straight line in both tails, and of its inverse x(z) give probabilities to 1e-7 anywhere,
at the price of a look-up.  Every draw is a law of its own, (kind, least, scale, shape, bound), one
of those that the tests allow:

    kind 0   ln(x*/scale)/shape is standard normal, x* = x/(1 - bound x/scale): a lognormal law with
    an upper end
             scale/bound, or none where bound is 0
    kind 1   1 - exp(-((x - least)/scale)^shape): a Weibull law
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.forms import CERTAIN, GAUSS, Form, weibull

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator

    from uqsphere.uq.law import Law

#: a kernel density of so many is tabulated in two seconds, and its kernels add 1.3 % to the
#: standard deviation: beyond, the step function says as much
MOST_KERNELS = 5000
#: the kinds of a draw
LOGNORMAL, WEIBULL = 0.0, 1.0
#: values times laws up to which a mean is taken of the laws themselves, at once: 8 MB for each
#: array on the way
_FEW = 1_000_000


def empirical(law: Law) -> Form:
    """A kernel density of the observations with the parameter `bandwidth`; a step function where
    that is 0.
    """
    data, width = np.array(law.data), law.parameters["bandwidth"]
    if width > 0.0:
        return _kernels(data, width)
    inside = data[(data >= law.lower) & (data <= law.upper)]

    def tails(x: Array) -> tuple[Array, Array]:
        share = np.asarray(np.searchsorted(inside, x, side="right") / inside.size)
        return share, 1.0 - share

    def quantile(p: Array, q: Array) -> Array:
        """The smallest observation whose share at or below it reaches p."""
        # A share such as 3/10 is not exact in binary: half a unit of rounding must not skip an
        # observation.
        rank = np.ceil(p * inside.size * (1.0 - 4e-16)).astype(int) - 1
        return np.asarray(inside[np.clip(rank, 0, inside.size - 1)])

    moments = (float(inside.mean()), float(inside.std())) if inside.size else (math.nan, math.nan)
    return Form(tails=tails, quantile=quantile, moments=moments, mass=inside.size / data.size)


def bandwidth(data: Array) -> float:
    """Width of the Gaussian kernel: 0.9 min(sd, IQR/1.34) n^(-1/5) (Silverman 1986)."""
    sd = float(np.std(data, ddof=1))
    quartiles = np.quantile(data, [0.25, 0.75])
    spread = float(quartiles[1] - quartiles[0]) / 1.34
    return float(0.9 * (min(sd, spread) if spread > 0.0 else sd) * data.size**-0.2)


# --- means of many laws ---------------------------------------------------------------------------

#: laws of a mean by their standard form, and y (..., 1) -> its argument (..., laws)
Part = tuple[Form, Callable[[Array], Array]]


def _mean_of(
    count: int, parts: list[Part], nodes: Callable[[], Array], moments: tuple[float, float] | None
) -> Form:
    """The form of a mean of `count` laws: of few values by the laws themselves, of more by cubics
    over the nodes.
    """

    @np.errstate(all="ignore")
    def own_tails(y: Array) -> tuple[Array, Array]:
        each = [form.tails(z(y[..., None])) for form, z in parts]
        below, above = (
            sum(tail.sum(axis=-1) for tail in side) / count for side in zip(*each, strict=True)
        )
        return np.asarray(below), np.asarray(above)

    @cache
    def cubics() -> tuple[PchipInterpolator, PchipInterpolator]:
        """Normal scores over y, as far as they are known and rise, and y over them."""
        from scipy.interpolate import PchipInterpolator

        y = nodes()
        some = np.array_split(y, 1 + y.size * count // _FEW)
        score = GAUSS.quantile(*np.hstack([own_tails(part) for part in some]))
        y, score = y[np.isfinite(score)], score[np.isfinite(score)]
        rises = np.diff(np.maximum.accumulate(score), prepend=-math.inf) > 0.0
        return PchipInterpolator(y[rises], score[rises]), PchipInterpolator(score[rises], y[rises])

    def inside(cubic: PchipInterpolator, x: Array) -> Array:
        return np.asarray(cubic(np.clip(x, cubic.x[0], cubic.x[-1])))

    def tails(y: Array) -> tuple[Array, Array]:
        if y.size * count <= _FEW:
            return own_tails(y)
        return GAUSS.tails(inside(cubics()[0], y))

    def pdf(y: Array) -> Array:
        scores = cubics()[0]
        return np.asarray(scores(y, 1, extrapolate=False) * GAUSS.pdf(scores(y)))

    def quantile(p: Array, q: Array) -> Array:
        return inside(cubics()[1], GAUSS.quantile(p, q))

    return Form(tails=tails, quantile=quantile, pdf=pdf, moments=moments)


def _kernels(data: Array, width: float) -> Form:
    def nodes() -> Array:
        # every width/48 within nine widths of an observation; in a wider gap F is constant to 1e-18
        breaks = np.flatnonzero(np.diff(data) > 18.0 * width)
        starts = np.concatenate([data[:1] - CERTAIN * width, data[breaks + 1] - 9.0 * width])
        ends = np.concatenate([data[breaks] + 9.0 * width, data[-1:] + CERTAIN * width])
        return np.concatenate(
            [
                np.linspace(a, b, max(2, math.ceil((b - a) / width * 48.0)))
                for a, b in zip(starts, ends, strict=True)
            ]
        )

    moments = float(data.mean()), math.hypot(float(data.std()), width)
    return _mean_of(data.size, [(GAUSS, lambda y: (y - data) / width)], nodes, moments)


def drawn(law: Law) -> Form:
    """The mean of the laws of the draws, of y = ln x."""
    rows = np.array(law.draws)
    _, _, median, sd, bound = rows[rows[:, 0] == LOGNORMAL].T
    _, least, scale, modulus, _ = rows[rows[:, 0] == WEIBULL].T
    hazard = weibull(modulus)

    def logarithm(y: Array) -> Array:
        # what is left of 1 below the upper end of each law
        left = np.maximum(1.0 - bound * (np.exp(y) / median), 0.0)
        return np.asarray((y - np.log(median) - np.log(left)) / sd)

    @np.errstate(all="ignore")
    def nodes() -> Array:
        # 4001 nodes between scores of -6 and 6, and 1000 on either side: shares are then known to
        # 1e-8
        scores = np.array([-CERTAIN, -6.0, 6.0, CERTAIN])[:, None]
        y = np.hstack(
            [
                np.log(median) + sd * scores - np.log1p(bound * np.exp(sd * scores)),
                np.log(least + scale * hazard.quantile(*GAUSS.tails(scores))),
            ]
        )
        start, low, high, end = y[0].min(), y[1].min(), y[2].max(), y[3].max()
        tails = np.linspace(max(start, -690.0), low, 1000)[:-1], np.linspace(high, end, 1000)[1:]
        return np.concatenate([tails[0], np.linspace(low, high, 4001), tails[1]])

    parts: list[Part] = [(GAUSS, logarithm), (hazard, lambda y: (np.exp(y) - least) / scale)]
    return _mean_of(len(rows), parts, nodes, None)
