"""Control variates: a cheap model on many points sharpens what a dear one says on few.

The dear model is known on R replicates of n points; the cheap one on the same points and on m > n points that
continue each replicate's sequence.  Any answer T of the replicates, a mean, a share or a standard deviation, is
corrected by what the cheap model says that n points lack beside m:

    T = T_dear(n) - alpha (T_cheap(n) - T_cheap(m))

alpha and the interval come from the R replicates: on quasi-random points neither follows from the correlation
of the rows (F. J. Hickernell, C. Lemieux, A. B. Owen, Statistical Science 20, 2005, 1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.describe import Description
from uqsphere.uq.estimate import Estimate, absent, share, student

__all__ = [
    "Controlled",
    "best_ratio",
    "control",
    "controlled_indices",
    "describe_controlled",
    "predicted_cost",
    "probability",
]

#: alpha of a share below a threshold: the models agree on a row or not, and more or less than that is noise, which
#: would make the distribution function fall and rise
SHARE_ALPHA = (0.0, 1.5)


@dataclass(frozen=True, kw_only=True)
class Controlled:
    """A corrected answer, its standard error, the coefficient alpha, and the standard error without correction."""

    value: float
    std_error: float
    alpha: float
    plain_error: float


def predicted_cost(correlation: float, cost: float) -> float:
    """Cost of a control variate over that of plain sampling at equal error, with random points and the best sizes.

    (sqrt(1 - rho²) + sqrt(w rho²))², rho the correlation of the models and w the cost of the cheap one over that
    of the dear one; 1 where it does not pay (A. Gruber, M. Gunzburger and others call the sizes those of
    multifidelity Monte Carlo: B. Peherstorfer, K. Willcox, M. Gunzburger, SIAM J. Sci. Comput. 38, 2016, A3163).

    >>> round(predicted_cost(0.99, 0.01), 3), predicted_cost(0.5, 0.5)
    (0.058, 1.0)
    """
    square = min(correlation * correlation, 1.0)
    return min(1.0, (math.sqrt(1.0 - square) + math.sqrt(cost * square)) ** 2)


def best_ratio(correlation: float, cost: float) -> float:
    """Evaluations of the cheap model for each of the dear one at which `predicted_cost` is reached.

    >>> round(best_ratio(0.99, 0.01), 1)
    70.2
    """
    square = min(correlation * correlation, 1.0 - 1e-12)
    return math.sqrt(square / (cost * (1.0 - square)))


def control(
    dear: Array, cheap: Array, cheap_many: Array, bounds: tuple[float, float] = (-math.inf, math.inf)
) -> Controlled:
    """Correct the answers of replicates.

    The value is where the regression of `dear` on the difference of the two cheap answers, whose expectation is
    zero, meets zero; its error is that of this intercept, with R - 2 degrees of freedom.  So the noise of alpha
    itself is counted (S. S. Lavenberg, P. D. Welch, Management Science 27, 1981, 322).

    Parameters
    ----------
    dear, cheap : (R,) arrays
        Answers of the replicates from n points.
    cheap_many : (R,) array
        Answers of the replicates from m points.
    bounds : least and largest alpha; one beyond is put there, and the error is that of an alpha given beforehand

    Raises
    ------
    ValueError
        For fewer than four replicates.

    >>> noise = np.array([0.3, -0.2, 0.1, -0.4, 0.2])
    >>> found = control(1.0 + noise, 2.0 + noise, np.full(5, 2.0))
    >>> round(found.value, 12), round(found.alpha, 12)
    (1.0, 1.0)
    """
    replicates = len(dear)
    if replicates < 4:
        raise ValueError(f"a control variate needs at least four replicates, found {replicates}")
    plain = float(np.std(dear, ddof=1)) / math.sqrt(replicates)
    gap = cheap - cheap_many
    centred = gap - gap.mean()
    spread = float(centred @ centred)
    if not spread > 0.0:
        return Controlled(value=float(dear.mean()), std_error=plain, alpha=0.0, plain_error=plain)
    alpha = float(centred @ dear) / spread
    if not bounds[0] <= alpha <= bounds[1]:
        alpha = min(max(alpha, bounds[0]), bounds[1])
        rest = dear - alpha * gap
        error = float(np.std(rest, ddof=1)) / math.sqrt(replicates)
        return Controlled(value=float(rest.mean()), std_error=error, alpha=alpha, plain_error=plain)
    value = float(dear.mean()) - alpha * float(gap.mean())
    rest = dear - dear.mean() - alpha * centred
    variance = float(rest @ rest) / (replicates - 2) * (1.0 / replicates + float(gap.mean()) ** 2 / spread)
    return Controlled(value=value, std_error=math.sqrt(variance), alpha=alpha, plain_error=plain)


def _factor(replicates: int) -> float:
    """Student's quantile with R - 2 degrees of freedom."""
    return student(replicates - 1)


def _estimate(found: Controlled, replicates: int, method: str, evaluations: int, least: float = -math.inf) -> Estimate:
    half = _factor(replicates) * found.std_error
    if not (math.isfinite(found.value) and math.isfinite(half)):
        return absent("the answer is beyond floating point", method, evaluations)
    return Estimate(
        value=found.value,
        low=max(least, found.value - half),
        high=found.value + half,
        std_error=found.std_error,
        method=method,
        evaluations=evaluations,
    )


def _floor(alpha: float, n: int, m: int, replicates: int) -> float:
    """Least standard error of a share: the cells of the points, and one row in which the models may disagree."""
    root = math.sqrt(replicates)
    return math.hypot(0.5 * alpha / m / root, 0.5 * (1.0 - alpha) / n / root, 1.0 / (n * replicates))


def probability(
    dear: Array, cheap: Array, cheap_many: Array, *, sizes: tuple[int, int], counted: bool, method: str
) -> Estimate | None:
    """A probability from those of the replicates (R,); None where it comes out at 0 or 1, which shows nothing.

    `sizes` are n and m; `counted` if rows either exceed or do not, so that resolution limits the error.  The
    interval is symmetric in logits, as that of `uqsphere.uq.limit_state`.
    """
    found = control(dear, cheap, cheap_many, SHARE_ALPHA if counted else (-math.inf, math.inf))
    replicates, (n, m) = len(dear), sizes
    p = found.value
    if not 0.0 < p < 1.0:
        return None
    error = math.hypot(found.std_error, _floor(found.alpha, n, m, replicates)) if counted else found.std_error
    half = min(_factor(replicates) * error / (p * (1.0 - p)), 600.0)
    return Estimate(
        value=p,
        low=p * math.exp(-half) / (1.0 - p + p * math.exp(-half)),
        high=p / ((1.0 - p) * math.exp(-half) + p),
        std_error=error,
        method=method,
        evaluations=n * replicates,
    )


def describe_controlled(
    dear: Array, cheap: Array, cheap_many: Array, *, quantiles: Sequence[float], method: str
) -> Description:
    """Mean, standard deviation and quantiles of the dear model, controlled by the cheap one.

    Parameters
    ----------
    dear, cheap : (R, n) arrays
        Both models at the same points, finite and not censored.
    cheap_many : (R, m) array
        The cheap model at the points of each replicate continued; its first n columns are `cheap`.
    quantiles : probabilities
    method : text of every estimate

    Each estimate counts the evaluations of the dear model.
    """
    replicates = len(dear)
    total = dear.size
    mean = control(dear.mean(axis=1), cheap.mean(axis=1), cheap_many.mean(axis=1))
    # about one centre for all replicates, so that their means are not taken for scatter of the quantity
    squares = [((rows - mean.value) ** 2).mean(axis=1) for rows in (dear, cheap, cheap_many)]
    variance = control(*squares)
    scale = math.sqrt(variance.value) if variance.value > 0.0 else float(dear.std())
    spread = Controlled(
        value=scale,
        std_error=0.5 * variance.std_error / scale if scale > 0.0 else 0.0,
        alpha=variance.alpha,
        plain_error=0.5 * variance.plain_error / scale if scale > 0.0 else 0.0,
    )
    pools = [np.sort(rows, axis=None) for rows in (dear, cheap, cheap_many)]
    return Description(
        mean=_estimate(mean, replicates, method, total),
        sd=_estimate(spread, replicates, method, total, least=0.0),
        quantiles={p: _quantile(p, (dear, cheap, cheap_many), pools, method) for p in quantiles},
        censored_share=share(np.zeros(dear.shape, dtype=bool), "share of the samples"),
        scale=scale,
    )


def _quantile(p: float, rows: tuple[Array, Array, Array], pools: list[Array], method: str) -> Estimate:
    """A quantile off the controlled distribution function, its interval after Woodruff (1952).

    The cheap model is shifted so that its own quantile from the n points falls on that of the dear one.  There the
    replicates give alpha and the standard error of the probability; with that alpha the three pooled samples make
    one distribution function, which is read off at p and at the two ends of the probability.
    """
    dear, cheap, many = rows
    (replicates, n), m = dear.shape, many.shape[1]
    if min(p, 1.0 - p) * dear.size < 5:
        return absent(f"too few samples beyond the {p:g} quantile", method, dear.size)
    at, own = (float(pool[min(int(p * pool.size), pool.size - 1)]) for pool in pools[:2])
    pools = [pools[0], pools[1] + (at - own), pools[2] + (at - own)]
    shares = [(dear <= at).mean(axis=1), (cheap <= own).mean(axis=1), (many <= own).mean(axis=1)]
    found = control(shares[0], shares[1], shares[2], SHARE_ALPHA)
    error = math.hypot(found.std_error, _floor(found.alpha, n, m, replicates))
    half = _factor(replicates) * error
    values = np.concatenate(pools)
    weights = np.repeat(
        [1.0 / pools[0].size, -found.alpha / pools[1].size, found.alpha / pools[2].size], [len(x) for x in pools]
    )
    order = np.argsort(values, kind="stable")
    values, mass = values[order], np.cumsum(weights[order])
    # the function may fall here and there: between its upper and its lower hull it is taken in the middle
    upper = np.maximum.accumulate(mass)
    lower = np.minimum.accumulate(mass[::-1])[::-1]

    def read(probability: float) -> float:
        last = len(values) - 1
        first = values[min(int(np.searchsorted(upper, probability)), last)]
        return 0.5 * float(first + values[min(int(np.searchsorted(lower, probability)), last)])

    value, low, high = read(p), read(max(p - half, 0.0)), read(min(p + half, 1.0))
    return Estimate(
        value=value,
        low=min(low, value),
        high=max(high, value),
        std_error=0.5 * (high - low) / _factor(replicates),
        method=method,
        evaluations=dear.size,
    )


def _indices(outputs: Array) -> Array:
    """First and total indices of every replicate, (2, R, d), from outputs (R, N, d + 2) in the blocks A, AB_j, B."""
    a, mixed, b = outputs[:, :, :1], outputs[:, :, 1:-1], outputs[:, :, -1:]
    base = np.concatenate([a, b], axis=1)
    mean, variance = base.mean(axis=1, keepdims=True), base.var(axis=1)
    first = ((b - mean) * (mixed - a)).mean(axis=1) / variance
    total = 0.5 * ((a - mixed) ** 2).mean(axis=1) / variance
    return np.stack([first, total])


def controlled_indices(dear: Array, cheap: Array, cheap_many: Array, *, method: str) -> dict[str, list[Estimate]]:
    """First and total Sobol' indices {"first": [...], "total": [...]} by pick and freeze, controlled by a cheap model.

    First indices after Saltelli et al. (Comput. Phys. Commun. 181, 2010, 259, table 2 (b)), total ones after
    Jansen (table 2 (f) there).  A model that does not vary in a replicate is answered by absent estimates.

    Parameters
    ----------
    dear, cheap : (R, N, d + 2) arrays
        Outputs of both models at the same base points, in the blocks of `uqsphere.uq.sensitivity.mix`.
    cheap_many : (R, M, d + 2) array
        The cheap model at the base points continued.
    """
    replicates, d = len(dear), dear.shape[2] - 2
    with np.errstate(all="ignore"):
        one, two, three = (_indices(outputs) for outputs in (dear, cheap, cheap_many))
    if not (np.isfinite(one).all() and np.isfinite(two).all() and np.isfinite(three).all()):
        nothing = [absent("the output does not vary", method, dear.size)] * d
        return {"first": nothing, "total": list(nothing)}
    return {
        order: [
            _estimate(control(one[k, :, j], two[k, :, j], three[k, :, j]), replicates, method, dear.size)
            for j in range(d)
        ]
        for k, order in enumerate(("first", "total"))
    }
