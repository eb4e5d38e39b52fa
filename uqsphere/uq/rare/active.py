"""Few calls of an expensive model: a Gaussian process that learns where the failure domain ends.

Given the process, with mean m(u) and standard deviation s(u), the probability of failure is itself uncertain.  With
t = m/s its mean and variance are (Stein's lemma; the tetrachoric series of a pair of normal variables)

    E P = E[Phi(-t(u))],    V P = E[ sum_k  rho(u, u')^k / k!  phi(t) He_(k-1)(t) phi(t') He_(k-1)(t') ],

with rho the correlation that the values leave between u and u', and the covariance of P with the value at x

    C(x) = -E[ phi(t(u))/s(u) k(u, x) ].

The next call is where C(x)²/k(x, x) is largest: it takes the most of V P (as stepwise uncertainty reduction does, Bect
et al. 2012, doi 10.1007/s11222-011-9241-4, here to first order and without sampling).  Calls that are made at once
follow from each other, since covariances do not depend on values.  The search ends when 1.96 sqrt(V P)/P, scaled up by
how far off the process was at the points it chose, is below the accuracy.  Where the strength is integrated, s² has one
more for it, so that one formula serves both.

The candidates u cover the wide surroundings in all directions, and some calls are spent where no point is near: what
nobody has seen yet counts as long as the process cannot exclude it there (compare Echard, Gayton and Lemaire 2011, doi
10.1016/j.strusafe.2011.01.002, whose population of the law misses far modes).
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from scipy.special import ndtr, ndtri

from uqsphere.arrays import Array
from uqsphere.uq.estimate import NORMAL, Estimate, absent
from uqsphere.uq.points import sobol_points
from uqsphere.uq.rare import LOOKS
from uqsphere.uq.rare.auto import find_probability
from uqsphere.uq.rare.form import FormAnswer
from uqsphere.uq.rare.importance import Component, Mixture, as_drawn, draw_mixture, joined, log_density, wide_mixture
from uqsphere.uq.rare.problem import REACH, Evaluator, LimitFunction, Spent, log_normal_density

# What no formula gives was halved and doubled as the constants of `active`.
#: noise over the variance of the process: the root of 2e-16, rounding, is 1.5e-8; so little leaves a factor of 128
#: points positive
_NUGGET = 1e-9
#: squared distance from the origin at which the trend is as strong as there: three standard deviations
_FAR = 9.0
#: where logarithms of lengths and of the trend's weight may lie, and where they are taken to lie before the data speak:
#: lengths from a fortieth of the surroundings, six scores, to ten times these; weights from none to all
_LENGTHS, _TREND = (math.log(0.15), math.log(60.0), math.log(4.0)), (math.log(1e-3), math.log(1e5), math.log(10.0))
#: weight of that belief, as a multiple of the squared logarithm
_BELIEF = 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class Kriging:
    """A process through points (n, d) and values (n,), with a quadratic trend of its own:

        k(x, y) = s² [ m(x, y) + q (1 + x·y/9)² + n 1{x = y} ]

    m is the Matérn correlation 5/2, or 3/2 for limits with kinks (`rough`), with `lengths` (d,), q the weight of the
    `trend`, s² the `variance`, n a little noise; the likelihood has lengths and q (Rasmussen and Williams, Gaussian
    Processes for Machine Learning, 2006, ch. 4 and 5).  `factor` (n, n) is the Cholesky
    factor of the correlations, `loads` (n,) what solves them for the values.
    """

    points: Array
    values: Array
    lengths: Array
    trend: float
    rough: bool
    variance: float
    factor: Array
    loads: Array


def _matern(squares: Array, *, rough: bool) -> tuple[Array, Array]:
    """Correlation 3/2 or 5/2 at squared distances over the lengths, and minus twice its slope in these."""
    r = np.sqrt((3.0 if rough else 5.0) * np.maximum(squares, 0.0))
    decay = np.exp(-r)
    if rough:
        return np.asarray((1.0 + r) * decay), np.asarray(3.0 * decay)
    return np.asarray((1.0 + r + r**2 / 3.0) * decay), np.asarray(5.0 / 3.0 * (1.0 + r) * decay)


def covariance(model: Kriging, first: Array, second: Array) -> Array:
    """k/s² (n, m) before any value is known."""
    a, b = first / model.lengths, second / model.lengths
    squares = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1)[None, :] - 2.0 * a @ b.T
    trend = 1.0 + first @ second.T / _FAR
    return np.asarray(_matern(squares, rough=model.rough)[0] + model.trend * trend**2)


def _solve(factor: Array, right: Array, *, transposed: bool = False) -> Array:
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(factor, right, lower=True, trans=1 if transposed else 0, check_finite=False))


def _settled(model: Kriging, points: Array, values: Array, factor: Array) -> Kriging:
    scores = _solve(factor, values)
    return replace(model, points=points, values=values, factor=factor,
                   variance=max(float(scores @ scores) / len(values), 1e-300),
                   loads=_solve(factor, scores, transposed=True))  # fmt: skip


def fit_kriging(points: Array, values: Array, start: Kriging | None = None, *, rough: bool = False) -> Kriging:
    """The process through points (n, d) and values (n,) with the most likely lengths and trend.

    >>> x = np.linspace(-2.0, 2.0, 12)[:, None]
    >>> model = fit_kriging(x, np.sin(x[:, 0]))
    >>> bool(abs(predict(model, np.array([[0.3]]))[0][0] - np.sin(0.3)) < 1e-3)
    True
    """
    from scipy.optimize import minimize

    n, d = points.shape
    squares = np.array([np.subtract.outer(column, column) ** 2 for column in points.T])
    quadratic = (1.0 + points @ points.T / _FAR) ** 2
    bounds = [_LENGTHS[:2]] * d + [_TREND[:2]]
    middle = np.array([_LENGTHS[2]] * d + [_TREND[2]])
    begin = middle if start is None else np.log(np.append(start.lengths, start.trend))

    def cost(logs: Array) -> tuple[float, Array]:
        """Negative logarithm of the likelihood with its best s², and its slopes."""
        scaled = squares / np.exp(2.0 * logs[:d, None, None])
        matern, steep = _matern(scaled.sum(axis=0), rough=rough)
        trend = math.exp(logs[d]) * quadratic
        whole = matern + trend
        whole[np.diag_indices(n)] += _NUGGET * (1.0 + math.exp(logs[d]))
        try:
            factor = np.linalg.cholesky(whole)
        except np.linalg.LinAlgError:
            return 1e10, np.zeros(d + 1)
        inverse = _solve(np.asarray(factor, dtype=np.float64), np.eye(n))
        inverse = inverse.T @ inverse
        loads = inverse @ values
        variance = max(float(values @ loads) / n, 1e-300)
        middling = 0.5 * (inverse - np.outer(loads, loads) / variance)
        slopes = np.einsum("kij,ij->k", scaled, middling * steep)
        off = logs - middle
        found = 0.5 * n * math.log(variance) + float(np.log(np.diag(factor)).sum()) + _BELIEF * float(off @ off)
        return found, np.append(slopes, (middling * trend).sum()) + 2.0 * _BELIEF * off

    best = minimize(cost, begin, jac=True, method="L-BFGS-B", bounds=bounds,
                    options={"maxiter": 40 if start is None else 15}).x  # fmt: skip
    return through(points, values, np.exp(best[:d]), math.exp(best[d]), rough=rough)


def through(points: Array, values: Array, lengths: Array, trend: float, *, rough: bool = False) -> Kriging:
    """The process through points (n, d) and values (n,) with given lengths (d,) and trend."""
    bare = Kriging(points=points, values=values, lengths=lengths, trend=trend, rough=rough, variance=1.0,
                   factor=np.empty((0, 0)), loads=values)  # fmt: skip
    whole = covariance(bare, points, points) + _NUGGET * (1.0 + trend) * np.eye(len(points))
    return _settled(bare, points, values, np.asarray(np.linalg.cholesky(whole), dtype=np.float64))


def grown(model: Kriging, points: Array, values: Array) -> Kriging:
    """The same process with more points (m, d) and values (m,): the factor is continued, nothing is fitted again.

    >>> x = np.linspace(-2.0, 2.0, 9)[:, None]
    >>> whole = fit_kriging(x, np.sin(x[:, 0]))
    >>> few = through(x[:7], whole.values[:7], whole.lengths, whole.trend)
    >>> np.allclose(grown(few, x[7:], whole.values[7:]).factor, whole.factor, atol=1e-6)
    True
    """
    n, m = len(model.points), len(points)
    rows = _solve(model.factor, covariance(model, model.points, points))
    rest = covariance(model, points, points) + _NUGGET * (1.0 + model.trend) * np.eye(m) - rows.T @ rows
    factor = np.zeros((n + m, n + m))
    factor[:n, :n], factor[n:, :n] = model.factor, rows.T
    factor[n:, n:] = np.linalg.cholesky(rest + 1e-14 * np.eye(m))
    return _settled(model, np.concatenate([model.points, points]), np.concatenate([model.values, values]), factor)


def reduced(model: Kriging, points: Array, before: Array | None = None) -> Array:
    """What prediction at points (m, d) needs of a process through n values, (n, m).

    `before` is that of the same process with fewer values, the first of these: only the rest is computed.
    """
    if before is None:
        return _solve(model.factor, covariance(model, model.points, points))
    k = len(before)
    across = covariance(model, model.points[k:], points) - model.factor[k:, :k] @ before
    return np.concatenate([before, _solve(model.factor[k:, k:], across)])


def predict_reduced(model: Kriging, points: Array, rows: Array) -> tuple[Array, Array]:
    """Mean and standard deviation (m,) at points (m, d) with their `reduced` rows (n, m)."""
    own = 1.0 + model.trend * (1.0 + (points**2).sum(axis=1) / _FAR) ** 2
    left = np.maximum(own - np.einsum("nm,nm->m", rows, rows), 1e-14)
    return np.asarray(rows.T @ (model.factor.T @ model.loads)), np.sqrt(model.variance * left)


def predict(model: Kriging, points: Array) -> tuple[Array, Array]:
    """Mean and standard deviation (n,) at points (n, d)."""
    blocks = np.array_split(points, max(1, len(points) // 4096))
    found = [predict_reduced(model, block, reduced(model, block)) for block in blocks]
    return np.concatenate([mean for mean, _ in found]), np.concatenate([deviation for _, deviation in found])


def mean_of(model: Kriging, points: Array) -> Array:
    """Mean (n,) at points (n, d)."""
    blocks = np.array_split(points, max(1, len(points) // 4096))
    return np.concatenate([covariance(model, block, model.points) @ model.loads for block in blocks])


def left_out(model: Kriging) -> tuple[Array, Array]:
    """What each value (n,) differs from the process without it, and that process's standard deviations there.

    >>> x = np.linspace(-2.0, 2.0, 9)[:, None]
    >>> model = fit_kriging(x, np.sin(x[:, 0]))
    >>> rest = through(x[:-1], model.values[:-1], model.lengths, model.trend, rough=model.rough)
    >>> bool(abs(left_out(model)[0][-1] - model.values[-1] + predict(rest, x[-1:])[0][0]) < 1e-9)
    True
    """
    inverse = _solve(model.factor, np.eye(len(model.values)))
    own = (inverse**2).sum(axis=0)
    return model.loads / own, np.sqrt(model.variance / own)


def left_between(model: Kriging, points: Array, rows: Array) -> Array:
    """Covariances (m, m) that the values leave between points (m, d) with their `reduced` rows (n, m)."""
    return np.asarray(model.variance * (covariance(model, points, points) - rows.T @ rows))


# --- learning ------------------------------------------------------------------------------------------------

# Constants that no formula gives were halved and doubled on public problems (docs/validation.md, "Few calls";
# `python -m tests.campaigns.rare --few --set NAME=VALUE`).
#: the process is fitted again once its points have grown by so much: six fits double them.  Candidates choose the next
#: call and tell the doubt, which bears chance (the answer has points of its own); those that its variance is of
GROWTH, CANDIDATES, NEAREST = 1.12, 6000, 600
#: terms of the tetrachoric series: the fourth is below a tenth of the first
TERMS = 4
#: first points at least, three for each variable; of points that are known already, the most that are used: the cube
#: of their number is what a step costs
FIRST, MOST_KNOWN = 10, 128
#: values over their median where great ones begin to be pulled in; the likelihood says whether they are
SQUEEZE = 0.5
#: calls in a row that have to leave it sure enough: one may be luck
CALM = 2
#: calls between two looks at untouched space
BETWEEN = 4
#: chosen points that tell how far off the process is: its scatter is known to 1/sqrt(2 · 16), 18 %; and how many right
#: ones it is taken to have had before
RECENT, TRUSTED = 16, 4
#: factor on the process's standard deviations, which take its lengths for known: with it 95 % of the intervals hold
SAFE = 2.0
#: values of a free scalar between which the logarithm of a probability is taken for straight, 0.375 of a score apart
STEPS = 17
#: candidates nearer to a point without an answer than this, in normal scores, are not asked for again
LOST = 0.3
#: doubt from which on the interval is more than a factor 1.5 to either side, exp(1.96 · 0.2)
DOUBT = 0.2
METHOD = "active learning, Gaussian process"


@dataclass(frozen=True, kw_only=True, eq=False)
class ActiveAnswer:
    """The estimate after `calls` of the model, and what speaks for and against it.

    `doubt`: standard deviation of the probability that the process leaves, over itself; `modes` and `design` as
    `find_probability` has them, of the process.  `looked` of `looks` points were spent in untouched space; `failed`
    points have no answer.
    """

    estimate: Estimate
    calls: int
    doubt: float
    modes: int
    looked: int = 0
    looks: int = 0
    failed: int = 0
    design: FormAnswer | None = None

    @property
    def warning(self) -> str:
        """Why the answer may be wrong beyond its interval, or an empty text."""
        texts = []
        if self.looked < self.looks:
            texts.append(
                f"a mode may have been missed: {self.looked} of the {self.looks} looks at untouched space were made "
                f"before the calls ran out"
            )
        if self.doubt > DOUBT:
            texts.append(f"the process could have {min(self.doubt, 1.0):.0%} of the probability wrong")
        if self.failed:
            texts.append(f"{self.failed} of its points have no answer, and what lies there is guessed")
        return "; ".join(texts)


@dataclass(kw_only=True, eq=False)
class Search:
    """Points and values of the limit, the process through them, and candidates with their weights in the law.

    Of four processes, with values pulled in or not and of either correlation, that is taken which says best what the
    half of the points nearest to the limit have, each left out (`misfit`: its mean square error over what it expects;
    `off`: that of chosen points, before they were known).  With a `level` the last variable is no random one but a
    free scalar in [-REACH, REACH], and the probability that is learned is that at the scalar `where` it is `level`.
    """

    evaluator: Evaluator
    seed: int
    task: str
    points: Array
    values: Array
    level: float | None = None
    where: float = 0.0
    candidates: Array = field(default_factory=lambda: np.empty((0, 0)))
    weights: Array = field(default_factory=lambda: np.empty(0))
    processes: dict[tuple[float, bool], Kriging] = field(default_factory=dict)
    scale: float = math.inf
    fitted: int = 0
    misfit: float = 1.0
    off: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.rows = np.empty((0, 0))
        self.fit()

    @property
    def own(self) -> float:
        """Variance that an integrated strength adds to that of the process."""
        return float(self.evaluator.limit.integrated)

    @property
    def size(self) -> int:
        """Random variables."""
        return self.evaluator.dimension - (self.level is not None)

    def squeezed(self, values: Array) -> Array:
        """Values with their sign, great ones pulled in: what matters is where they change it."""
        return np.asarray(self.scale * np.arcsinh(values / self.scale)) if np.isfinite(self.scale) else values

    def placed(self, points: Array, where: float | None = None) -> Array:
        """Points (n, size) of the law as points of the process."""
        if self.level is None:
            return points
        return np.column_stack([points, np.full(len(points), self.where if where is None else where)])

    def fit(self) -> None:
        """The process with new lengths, and new candidates."""
        known = np.isfinite(self.values)
        values = self.values[known]
        unit = float(np.median(np.abs(values))) or 1.0
        near, told = np.abs(values) <= unit, []
        for share, rough in product((math.inf,) if self.own else (SQUEEZE, math.inf), (False, True)):
            self.scale = share * unit
            found = fit_kriging(
                self.points[known], self.squeezed(values), self.processes.get((share, rough)), rough=rough
            )
            self.processes[share, rough] = found
            off, deviation = (each[near] for each in left_out(found))
            # densities of the values themselves, each without itself: those of the squeezed ones times their slope
            told.append((-float((np.log(deviation) + 0.5 * (off / deviation) ** 2
                                 + 0.5 * np.log1p((values[near] / self.scale) ** 2)).sum()),
                         float(np.mean((off / deviation) ** 2)), (share, rough)))  # fmt: skip
        _, self.misfit, best = max(told)
        self.scale, self.model = best[0] * unit, self.processes[best]
        self.candidates, self.weights = _candidates(self)
        if self.level is not None:
            self.where = self._crossing(self.level)
        self.rows = reduced(self.model, self.placed(self.candidates))
        self.fitted = len(self.points)

    def _crossing(self, level: float) -> float:
        """Where along the scalar the probability by the process is `level`, or nearest to it."""
        grid = np.linspace(-REACH, REACH, STEPS)
        means = [mean_of(self.model, self.placed(self.candidates, x)) for x in grid]
        failing = np.array([self.weights @ (ndtr(-m) if self.own else m < 0.0) for m in means])
        off = np.log(np.maximum(failing, 1e-12) / level)
        crossed = np.flatnonzero(off[1:] * off[:-1] <= 0.0)
        if not len(crossed):
            return float(grid[int(np.argmin(np.abs(off)))])
        k = int(crossed[0])
        return float(grid[k] + (grid[k + 1] - grid[k]) * off[k] / (off[k] - off[k + 1]) if off[k] else grid[k])

    def add(self, chosen: Array) -> Array:
        """Calls at points (b, d); gives their values."""
        mean, deviation = predict(self.model, chosen)
        values = self.evaluator.values(chosen)
        known = np.isfinite(values)
        self.off += list(((self.squeezed(values) - mean) / deviation)[known])
        self.points, self.values = np.concatenate([self.points, chosen]), np.concatenate([self.values, values])
        if len(self.points) >= GROWTH * self.fitted:
            self.fit()
        elif known.any():
            self.model = grown(self.model, chosen[known], self.squeezed(values[known]))
            self.rows = reduced(self.model, self.placed(self.candidates), self.rows)
        return values

    @property
    def widening(self) -> float:
        """By how much standard deviations of the process are too small, by its surprises."""
        late = np.array(self.off[-RECENT:])
        return SAFE * math.sqrt(max(1.0, self.misfit, float((late**2).sum() + TRUSTED) / (len(late) + TRUSTED)))

    def look(self) -> Seen:
        """What the process says of the probability."""
        placed = self.placed(self.candidates)
        mean, deviation = predict_reduced(self.model, placed, self.rows)
        return Seen.of(self, mean, np.sqrt(self.own + deviation**2))

    def learn(self, accuracy: float, looks: int, at_once: int = 1) -> tuple[Seen, int]:
        """Calls until half the interval is below `accuracy` and so many looks are made, or the calls are spent.

        Gives what is seen then, and the looks that were made.
        """
        calm, looked, begun = 0, 0, len(self.points)
        while True:
            seen = self.look()
            calm = calm + at_once if NORMAL * seen.doubt < accuracy else 0
            left = int(max(self.evaluator.left, 0))
            if not left or (calm >= CALM and looked >= looks):
                return seen, looked
            count, learnt = min(at_once, left), len(self.points) - begun - looked
            far = looked < looks and (calm >= CALM or learnt >= (looked + 1) * BETWEEN or left <= looks - looked)
            if far:
                chosen = self.untouched(seen.probability, min(count, looks - looked))
            else:
                chosen = seen.chosen(count, self.points[np.isnan(self.values)])
            excluded = predict(self.model, chosen)[0] > 0.0
            values = self.add(chosen)
            if far:
                looked += len(chosen)
                # what was excluded there and yet fails: there may be more of it
                if bool((excluded & (values < 0.0)).any()):
                    looked = min(looked, looks - self.size)

    def untouched(self, probability: float, count: int) -> Array:
        """Candidates farthest from every point, no farther out than failures of that probability would be."""
        reach = 1.0 - float(ndtri(min(max(probability / CANDIDATES, 1e-15), 0.4)))
        near = self.candidates[np.linalg.norm(self.candidates, axis=1) <= max(reach, 2.0)]
        near = self.placed(near if len(near) else self.candidates)
        known = self.points
        for _ in range(count):
            squares = (near**2).sum(axis=1)[:, None] + (known**2).sum(axis=1)[None, :] - 2.0 * near @ known.T
            known = np.concatenate([known, near[[int(np.argmax(squares.min(axis=1)))]]])
        return known[len(self.points) :]

    def bounds(self, points: Array, where: float) -> Array:
        """Probabilities (3, n) of failure at points (n, size) of the law: the mean's, and both ends of the interval."""
        placed = self.placed(points, where)
        mean, deviation = predict(self.model, placed)
        whole = np.sqrt(self.own + deviation**2)
        slope = np.exp(-0.5 * (mean / whole) ** 2) / whole
        here = replace_where(self, where).look()
        # pointwise shifts that move the mean of all as far as the interval goes
        moved = float((slope * deviation).mean()) / math.sqrt(2.0 * math.pi)
        middle = float(ndtr(-mean / whole).mean())
        reach = deviation * NORMAL * min(here.doubt * middle / max(moved, 1e-300), self.widening)
        found = [mean, mean + reach, mean - reach]
        return np.array([ndtr(-m) if self.own else (m < 0.0).astype(float) for m in found])


@dataclass(kw_only=True, eq=False)
class Seen:
    """The probability by the process, its relative standard deviation, and candidates that matter to it.

    `slopes` (k,) is how P moves with the value at candidates `near` (k, d), `left` (k, k) the covariances there.
    """

    probability: float
    doubt: float
    near: Array
    slopes: Array
    left: Array

    @classmethod
    def of(cls, search: Search, mean: Array, deviation: Array) -> Seen:
        """From means and deviations (n,) at the candidates, with the strength's own in these."""
        t = mean / deviation
        density = search.weights * np.exp(-0.5 * t**2) / math.sqrt(2.0 * math.pi)
        total = float(search.weights @ ndtr(-t))
        plain = total if search.own else float(search.weights[mean < 0.0].sum())
        most = np.argpartition(-density, NEAREST)[:NEAREST]
        near, t, density, deviation = search.placed(search.candidates[most]), t[most], density[most], deviation[most]
        left = left_between(search.model, near, search.rows[:, most])
        rho = left / deviation[:, None] / deviation[None, :]
        variance, power, hermite, before = 0.0, np.ones_like(rho), np.ones_like(t), np.zeros_like(t)
        for k in range(1, TERMS + 1):
            power = power * rho
            side = density * hermite
            variance += float(side @ power @ side) / math.factorial(k)
            hermite, before = t * hermite - (k - 1) * before, hermite
        doubt = search.widening * math.sqrt(max(variance, 0.0) + (plain - total) ** 2) / max(total, 1e-300)
        return cls(probability=total, doubt=doubt, near=near, slopes=density / deviation, left=left)

    def chosen(self, count: int, lost: Array) -> Array:
        """Candidates (count, d) that take the most of the variance, one given those before it; none near `lost`."""
        left, found = self.left.copy(), []
        floor = 1e-8 * float(np.diag(left).max()) + 1e-300
        apart = np.linalg.norm(self.near[:, None, :] - lost[None, :, :], axis=2).min(axis=1, initial=math.inf)
        for _ in range(count):
            own = np.diag(left)
            gain = np.where(own > floor, (left @ self.slopes) ** 2 / np.maximum(own, floor), 0.0)
            at = int(np.argmax(np.where(apart > LOST, gain, -1.0)))
            found.append(at)
            left = left - np.outer(left[:, at], left[at]) / max(float(left[at, at]), floor)
        return self.near[found]


def replace_where(search: Search, where: float) -> Search:
    """The search with its scalar elsewhere, to look from there."""
    found = copy(search)
    if search.level is not None:
        found.where = where
        found.rows = reduced(found.model, found.placed(found.candidates))
    return found


def learn_probability(
    limit: LimitFunction,
    *,
    seed: int,
    budget: int = 200,
    accuracy: float = 0.05,
    task: str = "active",
    at_once: int = 1,
    known: tuple[Array, Array] | None = None,
) -> ActiveAnswer:
    """Probability of failure from at most `budget` calls, ended earlier when half the interval is below `accuracy`.

    `at_once` calls are chosen together, for models that run side by side; `known` points (n, d) and values (n,) are
    not called again.  For at most ten or so variables, and limits that a Gaussian process can follow.
    """
    evaluator = Evaluator(limit=limit, budget=budget)
    looks = LOOKS * evaluator.dimension
    search = begin(evaluator, seed=seed, task=task, known=known)
    if isinstance(search, str):
        return ActiveAnswer(estimate=absent(search, METHOD, evaluator.count), calls=evaluator.count, doubt=1.0,
                            modes=0, looks=looks, failed=evaluator.failed)  # fmt: skip
    seen, looked = search.learn(accuracy, looks, at_once)
    return replace(_answer(search, seen), looked=looked, looks=looks)


def begin(
    evaluator: Evaluator, *, seed: int, task: str, known: tuple[Array, Array] | None = None, level: float | None = None
) -> Search | str:
    """A search from first points, beside those that are `known`; or why there is none."""
    size = evaluator.dimension
    points, values = np.empty((0, size)), np.empty(0)
    if known is not None:
        # those nearest to the limit, if a process through all would be slow
        nearest = np.argsort(np.abs(known[1]), kind="stable")[:MOST_KNOWN]
        points, values = known[0][nearest], known[1][nearest]
    first = _first_points(size, seed, task, size + 2 if len(points) else min(max(FIRST, 3 * size), evaluator.budget))
    try:
        found = evaluator.values(first)
    except Spent:
        return "the budget does not suffice for a first design"
    points, values = np.concatenate([points, first]), np.concatenate([values, found])
    if np.isfinite(values).sum() < 3:
        return "fewer than three of the first points have an answer"
    return Search(evaluator=evaluator, seed=seed, task=task, points=points, values=values, level=level)


def _first_points(size: int, seed: int, task: str, count: float) -> Array:
    """The origin, and directions all around at rising distances."""
    uniforms = sobol_points(dimension=size + 1, count=int(count) - 1, seed=seed, task=task, replicate=0)
    normals = np.asarray(ndtri(uniforms[:, 1:]))
    rays = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    reach = np.sqrt(size) + 4.0
    return np.concatenate([np.zeros((1, size)), rays * (1.0 + (reach - 1.0) * uniforms[:, :1])])


def _candidates(search: Search) -> tuple[Array, Array]:
    """Points in the wide surroundings and about the failures that are known, and their weights in the law."""
    size, points = search.size, search.model.points[:, : search.size]
    near = points[np.argsort((points**2).sum(axis=1) + 1e3 * (search.model.values > 0.0))][:6]
    if len(search.candidates):
        mean, deviation = predict(search.model, search.placed(search.candidates))
        failing = np.cumsum(search.weights * ndtr(-mean / np.sqrt(search.own + deviation**2)))
        where = np.searchsorted(failing, (np.arange(12) + 0.5) / 12 * failing[-1])
        near = np.concatenate([near[:4], search.candidates[np.minimum(where, len(failing) - 1)]])
    local = tuple(Component(mean=point, factor=0.8 * np.eye(size)) for point in near)
    wide = wide_mixture(size, reach=5.0)
    mixture = joined([(0.5, wide), (0.5, Mixture(shares=np.full(len(local), 1.0 / len(local)), components=local))])
    counts, drawn = as_drawn(mixture, CANDIDATES)
    found = draw_mixture(drawn, counts, seed=search.seed, task=f"{search.task} candidates",
                         replicate=search.evaluator.count)  # fmt: skip
    return found, np.exp(log_normal_density(found) - log_density(drawn, found)) / CANDIDATES


def _answer(search: Search, seen: Seen) -> ActiveAnswer:
    """Importance sampling on the process, with what the process leaves open in the interval."""
    evaluator = search.evaluator
    limit = replace(evaluator.limit, function=lambda u: mean_of(search.model, u))
    found = find_probability(limit, seed=search.seed, budget=20_000, accuracy=0.01)
    value, calls = found.estimate.value, evaluator.count
    estimate = replace(found.estimate, method=METHOD, evaluations=calls)
    if value:
        spread = math.hypot(NORMAL * seen.doubt, found.estimate.half_width / value)
        estimate = estimate.spanning(value * math.exp(-spread), min(value * math.exp(spread), 1.0))
    return ActiveAnswer(estimate=estimate, calls=calls, doubt=seen.doubt, modes=found.modes, design=found.design,
                        failed=evaluator.failed)  # fmt: skip
