"""A cheap model at many points, corrected by the real one at few of them, in independent replicates.

The model is known on R replicates of n points; the cheap one on the same points and on m > n points that continue each
replicate's sequence, or exactly.  Any answer T of the replicates, a mean, a share or a standard deviation, is

    T = T_cheap(m) + (T_model(n) - T_cheap(n))

the estimate of `uqsphere.uq.response` with rows of its own for the correction: the cheap model has seen none of them.
Its replicates scatter independently, and Student's interval rests on that (on quasi-random points it does not follow
from the correlation of the rows: F. J. Hickernell, C. Lemieux, A. B. Owen, Statistical Science 20, 2005, 1).  The
slope is one: a fitted one is wild when a single row lies on the other side of a threshold.  Indices are corrected the
same way (`uqsphere.uq.indices.sampled_indices`); those of an expansion are known exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.uq.describe import Description
from uqsphere.uq.estimate import Estimate, absent, corrected, share, student
from uqsphere.uq.expansion import Chaos, germ_points, predict
from uqsphere.uq.indices import Blocks, Surrogate

#: probabilities on either side of a quantile, over the smaller side up to a tenth, where differences are counted
RANGE: Final = 0.5


def _estimate(value: float, error: float, replicates: int, method: str, evaluations: int,
              least: float = -math.inf) -> Estimate:  # fmt: skip
    half = student(replicates) * error
    if not (math.isfinite(value) and math.isfinite(half)):
        return absent("the answer is beyond floating point", method, evaluations)
    return Estimate(value=value, low=max(least, value - half), high=value + half, std_error=error, method=method,
                    evaluations=evaluations)  # fmt: skip


def _floor(n: int, m: int, replicates: int) -> float:
    """Least standard error of a share: the cells of the many points, and one row in which the models may disagree."""
    return math.hypot(0.5 / m / math.sqrt(replicates), 1.0 / (n * replicates))


def probability(
    expensive: Array, cheap: Array, cheap_many: Array, *, sizes: tuple[int, int], counted: bool, method: str
) -> Estimate | None:
    """A probability from those of the replicates (R,); None where it comes out at 0 or 1, which shows nothing.

    `sizes` are n and m; `counted` if rows either exceed or do not, so that resolution limits the error.  The
    interval is symmetric in logits, as that of `uqsphere.uq.limit_state`.
    """
    p, error = corrected(expensive, cheap - cheap_many)
    replicates, (n, m) = len(expensive), sizes
    if not 0.0 < p < 1.0:
        return None
    error = math.hypot(error, _floor(n, m, replicates)) if counted else error
    half = min(student(replicates) * error / (p * (1.0 - p)), 600.0)
    return Estimate(
        value=p,
        low=p * math.exp(-half) / (1.0 - p + p * math.exp(-half)),
        high=p / ((1.0 - p) * math.exp(-half) + p),
        std_error=error,
        method=method,
        evaluations=n * replicates,
    )


def describe_controlled(
    expensive: Array, cheap: Array, cheap_many: Array, *, quantiles: Sequence[float], method: str
) -> Description:
    """Mean, standard deviation and quantiles of the expensive model, controlled by the cheap one.

    Parameters
    ----------
    expensive, cheap : (R, n) arrays
        Both models at the same points, finite and not censored.
    cheap_many : (R, m) array
        The cheap model at the points of each replicate continued; its first n columns are `cheap`.
    quantiles : probabilities
    method : text of every estimate

    Each estimate counts the evaluations of the expensive model.
    """
    replicates = len(expensive)
    total = expensive.size
    mean, error = corrected(expensive.mean(axis=1), cheap.mean(axis=1) - cheap_many.mean(axis=1))
    # about one centre for all replicates, so that their means are not taken for scatter of the quantity
    squares = [((rows - mean) ** 2).mean(axis=1) for rows in (expensive, cheap, cheap_many)]
    variance, spread = corrected(squares[0], squares[1] - squares[2])
    scale = math.sqrt(variance) if variance > 0.0 else float(expensive.std())
    loose = 0.5 * spread / scale if scale > 0.0 else 0.0
    many = np.sort(cheap_many, axis=None)
    return Description(
        mean=_estimate(mean, error, replicates, method, total),
        sd=_estimate(scale, loose, replicates, method, total, least=0.0),
        quantiles={p: _quantile(p, (expensive, cheap, cheap_many), many, method) for p in quantiles},
        censored_share=share(np.zeros(expensive.shape, dtype=bool), "share of the samples"),
        scale=scale,
    )


def _quantile(p: float, rows: tuple[Array, Array, Array], many: Array, method: str) -> Estimate:
    """A quantile off the corrected distribution function, its interval after Woodruff (1952); `many` in order.

    Where the cheap model is close, steps of both would hardly meet between the same rows; counted over a range of
    values, as a kernel of that width does, what the model lies above the cheap one counts by how far, and a row in
    which they disagree altogether counts whole.  Half of the probability beyond the quantile, on either side,
    is a range that leaves the difference as it is: its density hardly bends there.
    """
    from scipy.special import ndtr

    expensive, cheap, more = rows
    replicates, side = len(expensive), min(p, 1.0 - p)
    if side * expensive.size < 5:
        return absent(f"too few samples beyond the {p:g} quantile", method, expensive.size)

    def read(probability: float) -> float:
        return float(np.interp(probability * many.size - 0.5, np.arange(many.size), many))

    at = read(p)
    width = 0.5 * (read(p + RANGE * min(side, 0.1)) - read(p - RANGE * min(side, 0.1)))
    if width > 0.0:
        moved = (ndtr((at - expensive) / width) - ndtr((at - cheap) / width)).mean(axis=1)
    else:
        moved = (expensive <= at).mean(axis=1) - (cheap <= at).mean(axis=1)
    _, error = corrected(moved, -(more <= at).mean(axis=1))
    error = math.hypot(error, 0.5 / more.shape[1] / math.sqrt(replicates))
    half, middle = student(replicates) * error, p - float(moved.mean())
    value, low, high = (read(x) for x in (middle, middle - half, middle + half))
    return Estimate(
        value=value,
        low=low,
        high=high,
        std_error=0.5 * (high - low) / student(replicates),
        method=method,
        evaluations=expensive.size,
    )


# --- an expansion as the cheap model, whose indices are known exactly ------------------------------


def expansion_indices(coefficients: Array, multi_indices: npt.NDArray[np.int64], blocks: Blocks) -> dict[str, Array]:
    """Indices of an expansion in products of orthonormal polynomials, exactly: what a `Surrogate` is known by.

    Parameters
    ----------
    coefficients : (P,) array
    multi_indices : (P, d) array
        Degrees of each product; the constant has none.
    blocks : Blocks

    >>> degrees = np.array([[0, 0], [1, 0], [1, 1]])
    >>> found = expansion_indices(np.array([5.0, 3.0, 1.0]), degrees, Blocks(inputs_count=2, second=True))
    >>> found["first"].tolist(), found["total"].tolist(), found["second"].tolist()
    ([0.9, 0.0], [1.0, 0.1], [0.1])
    """
    active = multi_indices > 0
    count = active.sum(axis=1)
    varying = np.where(count > 0, coefficients, 0.0)
    # by a power of two, which rounds nothing: the squares of 1e300 are beyond floating point
    shares = np.ldexp(varying, -np.frexp(np.abs(varying).max())[1]) ** 2
    shares = shares / shares.sum()
    rows, columns = np.triu_indices(blocks.inputs_count, 1) if blocks.second else (np.array([], int),) * 2
    inside = [active[:, list(group)].sum(axis=1) for group in blocks.groups]
    return {
        "first": np.asarray(shares @ (active & (count == 1)[:, None])),
        "total": np.asarray(shares @ active),
        "second": np.asarray(shares @ (active[:, rows] & active[:, columns] & (count == 2)[:, None])),
        "group_first": np.array([shares[k == count].sum() for k in inside]),
        "group_total": np.array([shares[k > 0].sum() for k in inside]),
    }


def mean_expansion(fits: Sequence[Chaos]) -> Chaos:
    """The mean of plain expansions in the same germs: their terms together, each with its mean coefficient.

    Raises ValueError for an expansion of a transformed output or in two pieces: its indices are not known exactly.
    """
    if not all(fit.plain for fit in fits):
        raise ValueError("a control variate takes expansions of the output itself, in one piece: fit them with plain")
    degrees = np.concatenate([fit.multi_indices for fit in fits])
    values = np.concatenate([fit.coefficients for fit in fits]) / len(fits)
    terms, place = np.unique(degrees, axis=0, return_inverse=True)
    coefficients = np.zeros(len(terms))
    np.add.at(coefficients, place.reshape(-1), values)
    # the constant first, as in every expansion: np.unique sorts it there
    piece = replace(fits[0].pieces[0], coefficients=coefficients, multi_indices=terms)
    return replace(fits[0], pieces=(piece,), samples=sum(f.samples for f in fits))


def chaos_outputs(chaos: Chaos, blocks: Blocks, halves: Sequence[Array]) -> Array:
    """Values (N, blocks.count) of an expansion on the blocks of halves of independent standard normals, (N, d) each."""
    points = blocks.mix(*(germ_points(half, chaos.germs) for half in halves))
    return predict(chaos, points.reshape(-1, blocks.inputs_count)).reshape(-1, blocks.count)


def chaos_surrogate(chaos: Chaos, blocks: Blocks, outputs: Array) -> Surrogate | None:
    """An expansion with its `chaos_outputs` (R, N, blocks.count) as a surrogate; None where it is a constant."""
    if not chaos.coefficients[chaos.multi_indices.any(axis=1)].any():
        return None
    return Surrogate(outputs=outputs, indices=expansion_indices(chaos.coefficients, chaos.multi_indices, blocks))
