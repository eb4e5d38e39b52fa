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
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.uq.forms import GAUSS, ROOT, Form, either, weibull

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


def empirical(law: Law) -> Form:
    """A kernel density of the observations with the parameter `bandwidth`; a step function where that is 0."""
    data, width = np.array(law.data), law.parameters["bandwidth"]
    if width > 0.0:
        return _kernels(data, width)
    inside = data[(data >= law.lower) & (data <= law.upper)]

    def tails(x: Array) -> tuple[Array, Array]:
        share = np.asarray(np.searchsorted(inside, x, side="right") / inside.size)
        return share, 1.0 - share

    def quantile(p: Array, q: Array) -> Array:
        """The smallest observation whose share at or below it reaches p."""
        # A share such as 3/10 is not exact in binary: half a unit of rounding must not skip an observation.
        rank = np.ceil(p * inside.size * (1.0 - 4e-16)).astype(int) - 1
        return np.asarray(inside[np.clip(rank, 0, inside.size - 1)])

    moments = (float(inside.mean()), float(inside.std())) if inside.size else (math.nan, math.nan)
    return Form(tails=tails, quantile=quantile, pdf=None, moments=moments, mass=inside.size / data.size)


def bandwidth(data: Array) -> float:
    """Width of the Gaussian kernel: 0.9 min(sd, IQR/1.34) n^(-1/5) (Silverman 1986)."""
    sd = float(np.std(data, ddof=1))
    quartiles = np.quantile(data, [0.25, 0.75])
    spread = float(quartiles[1] - quartiles[0]) / 1.34
    return float(0.9 * (min(sd, spread) if spread > 0.0 else sd) * data.size**-0.2)


# --- means of many laws: cubics of normal scores between the nodes, a straight line beyond --------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """Some laws of a mean, by their standard form: y (..., 1) -> z (..., laws), its slope by y, and z -> y."""

    form: Form
    z: Callable[[Array], Array]
    slope: Callable[[Array], Array | float]
    y: Callable[[Array], Array]


def _mean_of(count: int, parts: list[Part], nodes: Callable[[], Array], moments: tuple[float, float] | None) -> Form:
    """The form of a mean of `count` laws: of few values by the laws themselves, of more by a table over the nodes."""

    @np.errstate(all="ignore")
    def own_tails(y: Array) -> tuple[Array, Array]:
        each = [part.form.tails(part.z(y[..., None])) for part in parts]
        below, above = (sum(tail.sum(axis=-1) for tail in side) / count for side in zip(*each, strict=True))
        return np.asarray(below), np.asarray(above)

    @np.errstate(all="ignore")
    def own_density(y: Array) -> Array:
        y, total = y[..., None], np.zeros(y.shape)
        for part in parts:
            assert part.form.pdf is not None
            total = total + np.nan_to_num(part.form.pdf(part.z(y)) * part.slope(y)).sum(axis=-1)
        return total / count

    @cache
    def table() -> CubicHermiteSpline:
        """Normal scores over y, of the two tails and the density there, as far as they are known and rise."""
        from scipy.interpolate import CubicHermiteSpline

        y = nodes()
        some = np.array_split(y, 1 + y.size * count // _PART)
        below, above, density = np.hstack([(*own_tails(one), own_density(one)) for one in some])
        with np.errstate(all="ignore"):
            score = GAUSS.quantile(below, above)
            slope = density * ROOT * np.exp(0.5 * score * score)
            known = np.isfinite(score) & np.isfinite(slope) & (np.diff(score, prepend=-math.inf) >= 0.0)
        return CubicHermiteSpline(y[known], score[known], slope[known])

    def inside(y: Array) -> Array:
        return np.clip(y, table().x[0], table().x[-1])

    def tails(y: Array) -> tuple[Array, Array]:
        if y.size * count <= _FEW:
            return own_tails(y)
        near = inside(y)
        score = table()(near) + np.where(y == near, 0.0, table()(near, 1) * (y - near))
        return GAUSS.tails(score)

    def of_score(score: Array) -> Array:
        """Solved inside one cell of the table."""
        from scipy.optimize import elementwise

        spline = table()
        scores = spline(spline.x)
        near = np.clip(score, scores[0], scores[-1])
        cell = np.clip(np.searchsorted(scores, near) - 1, 0, scores.size - 2)
        ends = spline.x[cell], spline.x[cell + 1]

        def gap(y: Array, wanted: Array) -> Array:
            return np.asarray(spline(y) - wanted)

        solved = elementwise.find_root(gap, ends, args=(near,), tolerances={"fatol": 1e-13})
        # in a gap between observations the score does not rise at all
        found = np.where(solved.success, solved.x, np.where(near > scores[cell], ends[1], ends[0]))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(found + np.where(score == near, 0.0, (score - near) / spline(found, 1)))

    def pdf(y: Array) -> Array:
        if y.size * count <= _FEW:
            return own_density(y)
        near = inside(y)
        return np.where(y == near, table()(near, 1) * np.exp(-0.5 * table()(near) ** 2) / ROOT, 0.0)

    quantile = either(lambda p: of_score(special.ndtri(p)), lambda q: of_score(-special.ndtri(q)))
    return Form(tails=tails, quantile=quantile, pdf=pdf, moments=moments)


def _kernels(data: Array, width: float) -> Form:
    def nodes() -> Array:
        # every width/48 within nine widths of an observation; in a wider gap F is constant to 1e-18
        breaks = np.flatnonzero(np.diff(data) > 18.0 * width)
        starts = np.concatenate([data[:1] - FURTHEST * width, data[breaks + 1] - 9.0 * width])
        ends = np.concatenate([data[breaks] + 9.0 * width, data[-1:] + FURTHEST * width])
        return np.concatenate([np.linspace(a, b, max(2, math.ceil((b - a) / width * 48.0)))
                               for a, b in zip(starts, ends, strict=True)])  # fmt: skip

    part = Part(form=GAUSS, z=lambda y: (y - data) / width, slope=lambda y: 1.0 / width, y=lambda z: data + width * z)
    return _mean_of(data.size, [part], nodes, (float(data.mean()), math.hypot(float(data.std()), width)))


def drawn(law: Law) -> Form:
    """The mean of the laws of the draws, of y = ln x."""
    rows = np.array(law.draws)
    _, _, median, sd, bound = rows[rows[:, 0] == LOGNORMAL].T
    _, least, scale, modulus, _ = rows[rows[:, 0] == WEIBULL].T

    def left(y: Array) -> Array:
        """What is left of 1 below the upper end of each lognormal law."""
        return np.asarray(np.maximum(1.0 - bound * (np.exp(y) / median), 0.0))

    parts = [
        Part(form=GAUSS, z=lambda y: (y - np.log(median) - np.log(left(y))) / sd, slope=lambda y: 1.0 / (sd * left(y)),
             y=lambda z: np.log(median) + sd * z - np.log1p(bound * np.exp(sd * z))),
        Part(form=weibull(modulus), z=lambda y: (np.exp(y) - least) / scale, slope=lambda y: np.exp(y) / scale,
             y=lambda z: np.log(least + scale * z)),
    ]  # fmt: skip

    @np.errstate(all="ignore")
    def nodes() -> Array:
        # 4001 nodes between scores of -6 and 6, and 400 on either side: shares are then known to 1e-8
        scores = np.array([-FURTHEST, -6.0, 6.0, FURTHEST])[:, None]
        y = np.hstack([part.y(part.form.quantile(*GAUSS.tails(scores))) for part in parts])
        start, low, high, end = y[0].min(), y[1].min(), y[2].max(), y[3].max()
        tails = np.linspace(max(start, -690.0), low, 400)[:-1], np.linspace(high, end, 400)[1:]
        return np.concatenate([tails[0], np.linspace(low, high, 4001), tails[1]])

    return _mean_of(len(rows), parts, nodes, None)
