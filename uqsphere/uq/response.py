"""Expansions that stand for a model at many points, cross-fitted to few rows of it.

The rows are split into `FOLDS` folds.  Expansion k is fitted without fold k, so that every row is
compared with an expansion that has not seen it.  `uqsphere.uq.corrected` makes answers of them.

No residual sees the variance that an expansion makes where no row lies: the exponential of a
polynomial, or a polynomial of high degree in an unbounded input, can run away in the tails.  A fold
is therefore compared with the rows and with the other folds (`_bounded`).  One that is contradicted
is held at the reach of its rows: a point beyond is predicted at the nearest place of the box about
them.  Where this does not help, the mean of its rows stands for it.  Its own rows stay: they are
often those that the others need in order to agree, and to leave them out would be to choose rows by
their residuals.

The exponential of a polynomial, and polynomials of an unbounded law of an input's own, grow faster
where no row lies than Hermite polynomials of normal scores do.  Where a fold is contradicted, or
more than `GOOD` is left at the rows or may be wrong beyond them, the output is expanded in the
scores as well, itself where one of these is normal, and the response that misses less is kept
(`Response.missing`).
"""

import math
from dataclasses import replace
from functools import cached_property

import numpy as np

from uqsphere.arrays import Array, Duo, Places, bundle

from .chaos.basis import Germs, base_of, score_of
from .chaos.beyond import moments_beyond
from .chaos.expansion import ROUNDING, Chaos, Integrals, law_points
from .chaos.fit import constant_fit, fit_chaos, folds_of
from .estimate import count_bound, distances, mean_and_sd, student

METHOD = "polynomial chaos, corrected by its residuals"
#: folds that rows are split into: seven eighths of them fit each time, and twice 8 are the
#: replicates of a table
FOLDS = 8
#: largest share of the variance that expansions may leave and still stand for the distribution of
#: the output.  Of a bivariate normal pair with half of the variance left, a prediction lies on the
#: other side of a quantile as often as its output; a quarter leaves room for other pairs.
MOST = 0.25
#: share below which a second fit gains nothing
GOOD = 0.01
#: level at which a fold is contradicted, and points of the law at which its variance is looked at
REJECTED = 0.99
LOOKED = 1024
#: standard deviation of a fold without a finite variance
LARGEST_SD = 1e150


def unseen(runs: int) -> str:
    """What n runs cannot show, in words: an event as probable as `count_bound` is missed in 5 % of
    all cases.

    >>> unseen(200)
    'an event rarer than about 0.015 (3 in 200 runs) is not in it'
    """
    return f"an event rarer than about {count_bound(runs):.2g} (3 in {runs} runs) is not in it"


@bundle
class Fold:
    """The expansion that was fitted without one fold of the rows.

    fit : the expansion
    reach : least and largest germ points (d,) each of its rows, at which it is held; empty for one
        that is not
    """

    fit: Chaos
    reach: tuple[Array, ...] = ()

    def values(self, points: Array) -> Array:
        """Values (...) at germ points (..., d)."""
        if self.reach:
            points = np.clip(points, *self.reach)
        return self.fit.predict(points)


@bundle
class Response:
    """Expansions of the folds of n rows, and what each row differs from the one that was fitted
    without it.

    Attributes
    ----------
    folds : one expansion for each fold, fitted to the others
    fold : (n,) the fold of every row
    points, outputs : (n, d) germ points and (n,) outputs of the rows
    levels, residuals : (n,) what the expansion without a row predicts for it, and what that lacks
    trusted : folds whose coefficients count
    error : share of the variance that is left
    """

    folds: tuple[Fold, ...]
    fold: Places
    points: Array
    outputs: Array
    levels: Array
    trusted: tuple[int, ...]

    @property
    def count(self) -> int:
        """Rows of the model."""
        return len(self.outputs)

    @property
    def residuals(self) -> Array:
        """What the predictions lack (n,)."""
        return self.outputs - self.levels

    @property
    def germs(self) -> Germs:
        """What its points are given in."""
        return self.folds[0].fit.germs

    @property
    def constant(self) -> bool:
        """Whether no fold has more than a constant."""
        return all(fold.fit.constant for fold in self.folds)

    @cached_property
    def error(self) -> float:
        """Share of the variance that is left, at most 1."""
        mean, sd = mean_and_sd(self.outputs)
        if sd <= 1e-14 * abs(mean):
            return 0.0
        return min(float(np.mean((self.residuals / sd) ** 2)), 1.0)

    @cached_property
    def integrals(self) -> tuple[Integrals, ...]:
        """Moments and indices of the expansion of every fold."""
        return tuple(fold.fit.integrals for fold in self.folds)

    @cached_property
    def beyond(self) -> Array:
        """What may be wrong of mean and variance beyond all rows, (2, d) as `moments_beyond` has
        it, by the tails of each input.

        The median of the folds whose coefficients count, as values of moments are: these folds
        share most of their rows, and may run away together.  Tails are independent, so that their
        squares add up.
        """
        points = self.points
        reach = np.array([points.min(axis=0), points.max(axis=0)])
        wrong = []
        for k in self.trusted:
            fit = self.folds[k].fit
            left = self.outputs - fit.predict(points)
            wrong.append(moments_beyond(fit, points, left, reach=reach, others=points))
        if not wrong:
            return np.zeros((2, len(self.germs)))
        return np.asarray(np.linalg.norm(np.median(wrong, axis=0), axis=1))

    @property
    def missing(self) -> float:
        """Share of the variance that is left at the rows, and what may be wrong of mean and
        variance beyond them; infinite where the coefficients of no fold count.
        """
        if not self.trusted:
            return math.inf
        return self.error + float(np.linalg.norm(self.beyond))

    @cached_property
    def variance_ends(self) -> Duo:
        """The 99 % interval of the variance by the rows, for all folds together: they share most of
        their rows, so that unlucky rows contradict all of them at once.
        """
        squares = (self.outputs - self.outputs.mean()) ** 2
        variance = float(squares.mean())
        down, up = distances(squares, 1.0 - (1.0 - REJECTED) / FOLDS)
        return variance - down, variance + up

    def allows(self, fit: Chaos) -> bool:
        """Whether the variance of an expansion, with what it leaves, is one that the rows allow."""
        low, high = self.variance_ends
        variance = min(fit.integrals.sd, LARGEST_SD) ** 2
        missing = fit.cross_validation_error * float(self.outputs.var())
        return variance <= high and variance + missing >= low

    @property
    def usable(self) -> bool:
        """Whether the expansions stand for the distribution of the output."""
        return self.error <= MOST

    @property
    def reason(self) -> str:
        """Why it may, or may not, be used."""
        largest = max((fold.fit for fold in self.folds), key=lambda fit: fit.coefficients.size)
        terms = (
            f"{largest.coefficients.size} terms of degree {largest.degree} from {self.count} runs"
        )
        if self.usable:
            return f"it leaves {self.error:.2g} of the variance ({terms}); {unseen(self.count)}"
        return (
            f"rejected: it leaves {self.error:.2g} of the variance unexplained, more than "
            f"{MOST:g} ({terms})"
        )

    def table(self, points: Array) -> Array:
        """Predictions (R, m) at germ points (R, m, d) of the law: the folds take turns."""
        table = np.empty(points.shape[:2])
        for k, fold in enumerate(self.folds):
            table[k::FOLDS] = fold.values(points[k::FOLDS])
        return table

    def scattered(self, table: Array) -> Array:
        """A table (R, m) with a residual of a row on every prediction.

        Replicates of one fold share the rows that it has not seen: so their spread is that of the
        rows, as if each replicate were a sample of the model.
        """
        rng = np.random.default_rng(0)
        scattered = table.copy()
        for k in range(FOLDS):
            replicates = range(k, len(table), FOLDS)
            for place, r in enumerate(replicates):
                residuals = self.residuals[self.fold == k][place :: len(replicates)]
                scattered[r] += rng.choice(residuals, table.shape[1])
        return scattered


def cross_fit(
    points: Array, outputs: Array, germs: Germs, *, plain: bool = False, independent: bool = True
) -> list[Response]:
    """Responses of every column of outputs (n, q) at the same germ points (n, d).

    Parameters
    ----------
    points : (n, d) of the germs' bases, n >= 8
    outputs : (n, q) or (n,)
    plain : expand the outputs themselves, never their logarithms
    independent : whether the germs of the points are independent, as those of a run are; else the
        variance of an expansion is not known, and no fold is held

    Raises ValueError for fewer than 8 rows.
    """
    n = len(outputs)
    if n < 8:
        raise ValueError(f"cross-fitting needs at least 8 different rows, not {n}")
    scores = tuple(map(score_of, germs))
    responses = []
    for y in outputs.reshape(n, -1).T:
        response = _fitted(points, y, germs, plain)
        if independent:
            response = _bounded(response)
            logs = any(fold.fit.log for fold in response.folds)
            doubtful = len(response.trusted) < FOLDS or response.missing > GOOD
            if doubtful and (logs or scores != germs):
                # the exponential of a polynomial runs away in an unbounded score
                plainly = plain or scores == germs or "normal" in map(base_of, scores)
                calmer = _bounded(_fitted(points, y, scores, plainly))
                response = min(response, calmer, key=lambda each: each.missing)
        responses.append(response)
    return responses


def _fitted(points: Array, y: Array, germs: Germs, plain: bool) -> Response:
    """The response of outputs (n,), whose folds are all trusted as yet."""
    fold = folds_of(len(y), FOLDS)
    folds = []
    levels = np.empty(len(y))
    for k in range(FOLDS):
        left_out = fold == k
        fit = fit_chaos(points[~left_out], y[~left_out], germs, plain=plain)
        folds.append(Fold(fit=fit))
        levels[left_out] = fit.predict(points[left_out])
    return Response(
        folds=tuple(folds),
        fold=fold,
        points=points,
        outputs=y,
        levels=levels,
        trusted=tuple(range(FOLDS)),
    )


# --- folds that run away --------------------------------------------------------------------------


def _bounded(response: Response) -> Response:
    """The response with folds held that the rows or the other folds contradict.

    The variance of a fold has to lie in the 99 % interval of that of the rows, for all folds
    together, and no farther from the median of the other folds than their own scatter, their
    correction by the rows, the error of their integration and what the fold leaves allow: the
    standard deviations of an output and of an expansion of it differ by no more than that of what
    the expansion leaves.
    """
    y = response.outputs
    whole = float(y.var())
    if response.constant or not whole > 0.0:
        return response
    # a fold that runs away may have no finite variance
    variances = np.minimum([moments.sd for moments in response.integrals], LARGEST_SD) ** 2
    influence = (y - y.mean()) ** 2 - (response.levels - y.mean()) ** 2
    integration = ROUNDING + 4.0 * max(moments.error for moments in response.integrals)
    t = student(FOLDS - 1, REJECTED)
    law = law_points(response.germs)[:LOOKED]
    folds = list(response.folds)
    levels = response.levels.copy()
    trusted = []
    for k, fold in enumerate(response.folds):
        variance = float(variances[k])
        others = np.delete(variances, k)
        left_out = response.fold == k
        median = float(np.median(others))
        missing = fold.fit.cross_validation_error * whole
        room = max(distances(influence[~left_out], REJECTED)) + integration * median
        room += t * 1.4826 * float(np.median(np.abs(others - median)))
        room += missing + 2.0 * math.sqrt(missing * max(variance, median))
        if response.allows(fold.fit) and abs(variance - median) <= room:
            trusted.append(k)
            continue
        points = response.points[~left_out]
        fold = replace(fold, reach=(points.min(axis=0), points.max(axis=0)))
        if not fold.values(law).var() <= response.variance_ends[1]:
            fold = Fold(fit=constant_fit(y[~left_out], response.germs))
        folds[k] = fold
        levels[left_out] = fold.values(response.points[left_out])
    if len(trusted) <= FOLDS // 2:
        trusted = []
    return replace(response, folds=tuple(folds), levels=levels, trusted=tuple(trusted))
