"""Standard forms of probability laws on scipy.special: what `Family` and `Law` compute with.

The lower and the upper tail p and q = 1 - p are always both there, so that neither is a difference
from the other: each keeps its relative accuracy however small it is.  A form is cut off by
`truncated`; a law of SciPy becomes a form by `form_of`, which holds its tails to account.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from math import inf, nan
from typing import TYPE_CHECKING, Any

import numpy as np

from uqsphere.arrays import Array, Duo, Function, Pair, bundle, quiet, special
from uqsphere.errors import Fault

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator

    from .law import Law

Quantile = Callable[[Array, Array], Array]
Tails = Pair  # P(Y <= y), P(Y > y)

#: normal scores beyond which a tail is taken for certain: the largest whose tail is a normal number
CERTAIN = 37.0
#: tail probabilities at which quantiles and probabilities are held against each other: a sample of
#: 1e6 points reaches 1e-7, and what is rarer is looked for by importance sampling; the last only
#: tells how heavy a tail is
_TAILS = np.array([0.3, 1e-3, 1e-6, 1e-9, 1e-12])
#: quantiles at 1e-6 and 1e-12 of a tail without variance lie at least this factor apart, 1e6^(1/2),
#: less its start
_HEAVY = 100.0


class LawError(Fault):
    """A law cannot be made, or a dependence cannot hold; `key` is the offending key ("" for the
    table).
    """


def no_density(y: Array) -> Array:
    """The density of a step function, which has none."""
    raise LawError("a step function has no density", "fit")


@bundle
class Form:
    """A law in standard form."""

    tails: Callable[[Array], Tails]
    #: p and q = 1 - p, each exact where it is small -> y
    quantile: Quantile
    #: nan, or anything beyond bounds of its own, off the law
    pdf: Function = no_density
    #: mean and sd, where quadrature in normal scores is slow or inexact
    moments: Duo | None = None
    #: from which on the lower, the upper tail has no moments
    orders: Duo = (inf, inf)
    #: probability that truncation has left
    mass: float = 1.0

    def truncated(self, a: float, b: float) -> "Form":
        """The form between a and b."""
        start, end = np.transpose(self.tails(np.array([a, b])))
        mass = float(_between(start, end))

        def tails(y: Array) -> Tails:
            place = self.tails(y)
            below = _between(start, place) / mass
            return np.clip(below, 0.0, 1.0), np.clip(_between(place, end) / mass, 0.0, 1.0)

        def quantile(p: Array, q: Array) -> Array:
            # rounding must not take the larger one beyond 1
            lower = np.minimum(start[0] + p * mass, 1.0)
            return self.quantile(lower, np.minimum(end[1] + q * mass, 1.0))

        return Form(
            tails=tails,
            quantile=quantile,
            pdf=lambda y: self.pdf(y) / mass,
            mass=mass,
            orders=tuple(np.where(np.isinf([a, b]), self.orders, inf).tolist()),
        )

    def falling(self, order: float = inf) -> "Form":
        """The form whose tails are exchanged: that of a hazard that falls."""
        return replace(
            self,
            tails=lambda y: self.tails(y)[::-1],
            quantile=lambda p, q: self.quantile(q, p),
            orders=(inf, order),
        )

    def examined(self, name: str, key: str, order: float | None = None) -> "Form":
        """The form with the order of its heavy tails, whose quantiles grow as p^(-1/order) where
        it is not known.

        Raises LawError, for a key, where a quantile in a tail has another probability.
        """
        orders = [inf, inf]
        for tail, side in enumerate(("lower", "upper")):
            with np.errstate(all="ignore"):
                places = self.quantile(*(_TAILS, 1.0 - _TAILS)[:: 1 - 2 * tail])
                # what both may differ by, as a share: a tenth of the smallest error that a run can
                # ask of a probability
                right = np.abs(self.tails(places)[tail] / _TAILS - 1.0) < 1e-4
            if np.isnan(places).all():
                raise LawError(f"{name} has no law with these shapes", key)
            if not right[:-1].all():
                raise LawError(
                    f"the {side} tail of {name} is wrong from the probability "
                    f"{_TAILS[~right][0]:g} on: its quantile there has another probability"
                )
            _, _, start, _, end = np.abs(places)
            if end > _HEAVY * start:
                orders[tail] = order or round(6.0 / math.log10(end / start), 3)
        return replace(self, orders=(orders[0], orders[1]))


#: location and scale of a law, and its standard form
Placed = tuple[float, float, Form]


def _between(start: Tails, end: Tails) -> Any:
    """Probability between two places from both tails of each, off the smaller ones: no digits are
    lost however far out they are.
    """
    return np.where(start[1] >= 0.5, end[0] - start[0], start[1] - end[1])


def either(ppf: Function, isf: Function) -> Quantile:
    """Quantiles by the smaller tail, from the inverses of both."""

    def quantile(p: Array, q: Array) -> Array:
        y = np.empty_like(p)
        below = p <= 0.5
        y[below] = ppf(p[below])
        y[~below] = isf(q[~below])
        return y

    return quantile


def symmetric(cdf: Function, ppf: Function, pdf: Function, order: float = inf) -> Form:
    """A form that is the same for -y."""
    return Form(
        tails=lambda y: (cdf(y), cdf(-y)),
        quantile=either(ppf, lambda q: -ppf(q)),
        pdf=pdf,
        orders=(order, order),
    )


def tails_at(hazard: Array) -> Tails:
    """Both tails at cumulative hazards of any shape."""
    return -np.expm1(-hazard), np.exp(-hazard)


def by_hazard(hazard: Function, inverse: Function, log_rate: Function) -> Form:
    """P(Y > y) = exp(-H(y)) of a hazard H; `log_rate`: ln |dH/dy|, nan off the law."""
    return Form(
        tails=lambda y: tails_at(hazard(y)),
        quantile=lambda p, q: inverse(np.where(p <= 0.5, -np.log1p(-p), -np.log(q))),
        pdf=lambda y: np.exp(log_rate(y) - hazard(y)),
    )


# --- the forms that families are made of ----------------------------------------------------------

GAUSS = replace(
    symmetric(
        lambda y: special.ndtr(y),
        lambda p: special.ndtri(p),
        lambda y: np.exp(-0.5 * y * y) / math.sqrt(2.0 * math.pi),
    ),
    moments=(0.0, 1.0),
)
#: of the logarithm of an exponential variable, and the largest extreme value
SMALLEST = by_hazard(lambda y: np.exp(np.minimum(y, 700.0)), np.log, np.asarray)
GUMBEL = by_hazard(lambda y: np.exp(-y), lambda h: -np.log(h), np.negative).falling()
UNIFORM = Form(
    tails=lambda y: (np.clip(y, 0.0, 1.0), np.clip(1.0 - y, 0.0, 1.0)),
    quantile=lambda p, q: p,
    pdf=np.ones_like,
    moments=(0.5, 12.0**-0.5),
)


def weibull(m: float | Array) -> Form:
    """P(Y > y) = exp(-y^m), also of a negative m, whose hazard falls."""
    return by_hazard(
        lambda y: np.maximum(y, 0.0) ** m,
        lambda h: h ** (1.0 / m),
        lambda y: np.log(np.abs(m)) + special.xlogy(m - 1.0, np.where(y < 0.0, nan, y)),
    )


def incomplete(name: str, end: float, log_density: Function, *shapes: float) -> Form:
    """A form on [0, end] by an incomplete function of scipy.special, its complement and both
    inverses.
    """
    below, above, ppf, isf = (getattr(special, name + kind) for kind in ("", "c", "inv", "cinv"))

    def tails(y: Array) -> Tails:
        y = np.clip(y, 0.0, end)
        return below(*shapes, y), above(*shapes, y)

    return Form(
        tails=tails,
        quantile=either(lambda p: ppf(*shapes, p), lambda q: isf(*shapes, q)),
        pdf=lambda y: np.exp(log_density(y)),
    )


def gamma(k: float) -> Form:
    return incomplete(
        "gammainc",
        inf,
        lambda y: special.xlogy(k - 1.0, np.where(y < 0.0, nan, y)) - y - math.lgamma(k),
        k,
    )


def beta(a: float, b: float) -> Form:
    def log_density(y: Array) -> Array:
        powers = special.xlogy(a - 1.0, y) + special.xlog1py(b - 1.0, -y)
        return powers - special.betaln(a, b)

    return incomplete("betainc", 1.0, log_density, a, b)


def student_t(dof: float) -> Form:
    def ppf(p: Array) -> Array:
        # stdtrit of SciPy 1.17 answers inf in far tails; below 1e-290 a square of y would overflow
        far = np.maximum(special.betaincinv(0.5 * dof, 0.5, 2.0 * p), 1e-290)
        inside = special.betaincinv(0.5, 0.5 * dof, 1.0 - 2.0 * np.maximum(p, 0.3))
        ratio = np.where(p < 0.3, 1.0 / far - 1.0, inside / (1.0 - inside))
        return np.where(p == 0.0, -inf, -np.sqrt(dof * ratio))

    def pdf(y: Array) -> Array:
        power = 0.5 * (dof + 1.0) * np.log1p(y * y / dof) + special.betaln(0.5, 0.5 * dof)
        return np.exp(-power) / math.sqrt(dof)

    return symmetric(lambda y: special.stdtr(dof, y), ppf, pdf, dof)


def triangular(mode: float) -> Form:
    rest = 1.0 - mode

    def tails(y: Array) -> Tails:
        y = np.clip(y, 0.0, 1.0)
        below = y * y / (mode or 1.0)
        above = (1.0 - y) ** 2 / (rest or 1.0)
        rises = y < mode
        return np.where(rises, below, 1.0 - above), np.where(rises, 1.0 - below, above)

    return Form(
        tails=tails,
        quantile=lambda p, q: np.where(p <= mode, np.sqrt(p * mode), 1.0 - np.sqrt(q * rest)),
        pdf=lambda y: 2.0 * np.fmin(y / mode, (1.0 - y) / rest),  # 0/0 counts for nothing
        # its quantiles have a kink, and quadrature fewer digits
        moments=((1.0 + mode) / 3.0, math.sqrt((1.0 - mode + mode**2) / 18.0)),
    )


def form_of(name: str, law: Any, key: str) -> Form:
    """The form of a frozen law of SciPy.

    Raises LawError, for a key, where quantiles and probabilities of a tail do not belong to each
        other.
    """
    mean, variance = map(float, law.stats(moments="mv"))
    form = Form(
        tails=lambda y: (law.cdf(y), law.sf(y)),
        quantile=either(law.ppf, law.isf),
        pdf=law.pdf,
        moments=(mean, math.sqrt(variance)),
    )
    order = inf if math.isfinite(variance) else 2.0
    return form.examined(name, key, order if math.isfinite(mean) else 1.0)


def by_functions(distribution: Any) -> Form:
    """The form of a distribution of chaospy by its `cdf`, `inv` and `pdf`; its tails are known to
    1e-9, and end where it ends.

    Raises LawError where `inv` and `cdf` do not belong to each other.
    """
    form = Form(
        tails=lambda y: (distribution.cdf(y), 1.0 - distribution.cdf(y)),
        quantile=lambda p, q: distribution.inv(p),
        pdf=distribution.pdf,
    )
    return form.examined(f"{type(distribution).__name__} of chaospy", "")


# --- forms of laws that are made from observations ------------------------------------------------

# A kernel density and the draws of a fit are means of many laws.  Monotone cubics of z(x) =
# ndtri(F(x)), which is smooth and almost a straight line in both tails, and of its inverse x(z)
# give probabilities to 1e-7 anywhere, at the price of a look-up.  Every draw is a law of its own,
# (kind, least, scale, shape, bound), one of those that the tests allow:
#
#     kind 0   ln(x*/scale)/shape is standard normal, x* = x/(1 - bound x/scale): a lognormal law
#              with an upper end scale/bound, or none where bound is 0
#     kind 1   1 - exp(-((x - least)/scale)^shape): a Weibull law

#: a kernel density of so many is tabulated in two seconds, and its kernels add 1.3 % to the
#: standard deviation: beyond, the step function says as much
MOST_KERNELS = 5000
#: the kinds of a draw
LOGNORMAL, WEIBULL = 0.0, 1.0
#: values times laws up to which a mean is taken of the laws themselves, at once: 8 MB for each
#: array on the way
_FEW = 1_000_000


def empirical(law: "Law") -> Form:
    """A kernel density of the observations with the parameter `bandwidth`; a step function where
    that is 0.
    """
    data = np.array(law.data)
    width = law.parameters["bandwidth"]
    if width > 0.0:
        return _kernels(data, width)

    def tails(x: Array) -> Tails:
        share = np.searchsorted(data, x, side="right") / data.size
        return share, 1.0 - share

    def quantile(p: Array, q: Array) -> Array:
        """The smallest observation whose share at or below it reaches p."""
        # A share such as 3/10 is not exact in binary: half a unit of rounding must not skip an
        # observation.
        rank = np.ceil(p * data.size * (1.0 - 4e-16)).astype(int) - 1
        return np.asarray(data[np.clip(rank, 0, data.size - 1)])

    moments = float(data.mean()), float(data.std())
    return Form(tails=tails, quantile=quantile, moments=moments)


def bandwidth(data: Array) -> float:
    """Width of the Gaussian kernel: 0.9 min(sd, IQR/1.34) n^(-1/5) (Silverman 1986)."""
    width = np.std(data, ddof=1)
    quarter, rest = np.quantile(data, [0.25, 0.75])
    if rest > quarter:
        width = min(width, (rest - quarter) / 1.34)
    return float(0.9 * width * data.size**-0.2)


# --- means of many laws ---------------------------------------------------------------------------


def _mean_of(count: int, each: Callable[[Array], Any], nodes: Callable[[], Array]) -> Form:
    """The form of a mean of `count` laws by the tails of each, (2, ..., count) at y (..., 1): of
    few values by these themselves, of more by cubics over the nodes.
    """

    @quiet
    def own_tails(y: Array) -> Tails:
        below, above = np.mean(each(y[..., None]), axis=-1)
        return below, above

    @cache
    def cubics() -> "tuple[PchipInterpolator, PchipInterpolator]":
        """Normal scores over y, as far as they are known and rise, and y over them."""
        from scipy.interpolate import PchipInterpolator

        y = nodes()
        some = np.array_split(y, 1 + y.size * count // _FEW)
        score = GAUSS.quantile(*np.hstack([own_tails(part) for part in some]))
        y = y[np.isfinite(score)]
        score = score[np.isfinite(score)]
        rises = np.diff(np.maximum.accumulate(score), prepend=-inf) > 0.0
        return PchipInterpolator(y[rises], score[rises]), PchipInterpolator(score[rises], y[rises])

    def inside(cubic: "PchipInterpolator", x: Array) -> Array:
        return cubic(np.clip(x, cubic.x[0], cubic.x[-1]))

    def tails(y: Array) -> Tails:
        if y.size * count <= _FEW:
            return own_tails(y)
        return GAUSS.tails(inside(cubics()[0], y))

    def pdf(y: Array) -> Array:
        scores = cubics()[0]
        return scores(y, 1, extrapolate=False) * GAUSS.pdf(scores(y))

    return Form(
        tails=tails,
        quantile=lambda p, q: inside(cubics()[1], GAUSS.quantile(p, q)),
        pdf=pdf,
    )


def _kernels(data: Array, width: float) -> Form:
    def nodes() -> Array:
        # every width/48 within nine widths of an observation; in a wider gap F is constant to 1e-18
        breaks = np.flatnonzero(np.diff(data) > 18.0 * width)
        starts = np.append(data[0] - CERTAIN * width, data[breaks + 1] - 9.0 * width)
        ends = np.append(data[breaks] + 9.0 * width, data[-1] + CERTAIN * width)
        pieces = [
            np.linspace(a, b, max(2, math.ceil((b - a) / width * 48.0)))
            for a, b in zip(starts, ends, strict=True)
        ]
        return np.concatenate(pieces)

    form = _mean_of(data.size, lambda y: GAUSS.tails((y - data) / width), nodes)
    return replace(form, moments=(float(data.mean()), math.hypot(data.std(), width)))


def drawn(law: "Law") -> Form:
    """The mean of the laws of the draws, of y = ln x."""
    rows = np.array(law.draws)
    _, _, median, sd, bound = rows[rows[:, 0] == LOGNORMAL].T
    _, least, scale, modulus, _ = rows[rows[:, 0] == WEIBULL].T
    hazard = weibull(modulus)

    def each(y: Array) -> Array:
        # what is left of 1 below the upper end of each law
        left = np.maximum(1.0 - bound * (np.exp(y) / median), 0.0)
        logarithm = (y - np.log(median) - np.log(left)) / sd
        weakest = hazard.tails((np.exp(y) - least) / scale)
        return np.concatenate([GAUSS.tails(logarithm), weakest], axis=-1)

    @quiet
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
        start, low = y[:2].min(axis=1)
        high, end = y[2:].max(axis=1)
        pieces = (max(start, -690.0), low, 1000), (low, high, 4001), (high, end, 1000)
        return np.unique(np.concatenate([np.linspace(*piece) for piece in pieces]))

    return _mean_of(len(rows), each, nodes)
