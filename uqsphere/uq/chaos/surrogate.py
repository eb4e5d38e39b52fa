"""A fitted expansion: values, moments, indices of any order and derivatives off its coefficients."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.uq.chaos.bases import Indices, germ_points, orthonormal_slopes, orthonormal_values, products
from uqsphere.uq.chaos.choice import Choice, choose, repeat
from uqsphere.uq.estimates import Estimate, absent, from_replicates, student
from uqsphere.uq.families import Array
from uqsphere.uq.sampling import sobol_points

__all__ = [
    "Chaos",
    "Verdict",
    "chaos_indices",
    "chaos_moments",
    "closed_index",
    "fit_chaos",
    "gradient",
    "judge",
    "predict",
    "total_index",
    "validation_error",
]

_BLOCK: Final = 16384
#: points at which an expansion of the logarithm is read, since its coefficients are not those of the output
_READ: Final = 16384
_READINGS: Final = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Chaos:
    """A fitted expansion: coefficients (P,) of the products with degrees multi_indices (P, d).

    Attributes
    ----------
    germs : of every input
    cross_validation_error : mean square error of predictions for samples left out, over the variance of the
        outputs; 1 for a constant
    samples : how many it was fitted to
    transform : "none", or "logarithm" where ln |output| is what was expanded; `negative` then gives the sign
    solver : how the terms were found, among the products of `basis`
    """

    coefficients: Array
    multi_indices: Indices
    germs: tuple[str, ...]
    cross_validation_error: float
    samples: int
    transform: str = "none"
    negative: bool = False
    solver: str = "none"
    basis: Indices | None = None

    @property
    def degree(self) -> int:
        """Largest total degree of a term."""
        return int(self.multi_indices.sum(axis=1).max())


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Whether a surrogate may be used: its error (mean square over variance), and why or why not."""

    usable: bool
    error: float
    reason: str


def fit_chaos(
    points: Array, outputs: Array, germs: Sequence[str], like: Chaos | None = None, *, transform: bool = True
) -> Chaos:
    """Expansion of outputs (n,) at germ points (n, d); basis, solver, size and transform by what they predict.

    Never more terms than half the points.  A fit whose error reaches the variance is given up for the
    constant.  `like` is an expansion of the same output at as many other points: what won there is taken, its
    terms found anew, which costs a hundredth.  Without `transform` the output is expanded as it is.  Raises
    ValueError for outputs that are not finite and for shapes that do not go together.
    """
    points, outputs = np.asarray(points, dtype=float), np.asarray(outputs, dtype=float)
    n = outputs.size
    if points.ndim != 2 or points.shape != (n, len(germs)) or n < 4:
        raise ValueError(f"need points (n, {len(germs)}) and outputs (n,), n >= 4; found {points.shape}, {n}")
    if not (np.isfinite(outputs).all() and np.isfinite(points).all()):
        raise ValueError("a polynomial chaos cannot be fitted to values that are not finite")
    # in units of their own size, so that no square overflows or vanishes
    size = float(np.abs(outputs).max()) or 1.0
    scaled = outputs / size
    centre, scale = float(scaled.mean()), float(scaled.std())
    dimension = len(germs)
    constant = np.zeros((1, dimension), dtype=np.int64)
    if scale <= 1e-14 * abs(centre) or dimension == 0:
        return Chaos(coefficients=np.array([centre * size]), multi_indices=constant, germs=tuple(germs),
                     cross_validation_error=0.0 if dimension else 1.0, samples=n)  # fmt: skip
    found = (
        choose(points, scaled, germs, transform=transform)
        if like is None
        else repeat(_won(like), points, scaled, germs)
    )
    coefficients = found.coefficients * size
    if found.transform == "logarithm":
        coefficients = found.coefficients.copy()
        coefficients[0] += math.log(size)
    return Chaos(
        coefficients=coefficients, multi_indices=found.multi_indices, germs=tuple(germs),
        cross_validation_error=found.error, samples=n, transform=found.transform, negative=bool(outputs[0] < 0.0),
        solver=found.solver, basis=found.basis,
    )  # fmt: skip


def _won(chaos: Chaos) -> Choice:
    basis = chaos.basis if chaos.basis is not None else chaos.multi_indices[1:]
    return Choice(coefficients=chaos.coefficients, multi_indices=chaos.multi_indices, solver=chaos.solver,
                  error=chaos.cross_validation_error, transform=chaos.transform, basis=basis)  # fmt: skip


def _plain(chaos: Chaos, points: Array) -> Array:
    """The sum of products itself (n,), before the logarithm is undone."""
    result = np.empty(points.shape[0])
    highest = chaos.multi_indices.max(axis=0)
    for first in range(0, points.shape[0], _BLOCK):
        block = points[first : first + _BLOCK]
        values = [orthonormal_values(germ, block[:, j], int(highest[j])) for j, germ in enumerate(chaos.germs)]
        result[first : first + _BLOCK] = chaos.coefficients @ products(values, chaos.multi_indices)
    return result


def predict(chaos: Chaos, points: Array) -> Array:
    """Values (n,) of the expansion at germ points (n, d)."""
    plain = _plain(chaos, np.asarray(points, dtype=float))
    if chaos.transform == "none":
        return plain
    with np.errstate(over="ignore"):
        return np.asarray((-1.0 if chaos.negative else 1.0) * np.exp(plain))


def gradient(chaos: Chaos, points: Array) -> Array:
    """Derivatives (n, d) of the expansion by the germs, at germ points (n, d)."""
    points = np.asarray(points, dtype=float)
    highest = chaos.multi_indices.max(axis=0)
    values = [orthonormal_values(germ, points[:, j], int(highest[j])) for j, germ in enumerate(chaos.germs)]
    found = np.empty(points.shape)
    for j, germ in enumerate(chaos.germs):
        slopes = list(values)
        slopes[j] = orthonormal_slopes(germ, points[:, j], int(highest[j]))
        moving = chaos.multi_indices[:, j] > 0
        found[:, j] = chaos.coefficients[moving] @ products(slopes, chaos.multi_indices[moving])
    return found if chaos.transform == "none" else found * predict(chaos, points)[:, None]


def validation_error(chaos: Chaos, points: Array, outputs: Array) -> float:
    """1 - Q²: mean square error on held-out germ points (n, d) over the variance of their outputs (n,).

    Not clipped: above 1 the expansion is worse than a constant (`judge` refuses it).
    """
    outputs = np.asarray(outputs, dtype=float)
    variance = float(np.var(outputs))
    residual = float(np.mean((outputs - predict(chaos, points)) ** 2))
    if variance == 0.0:
        return 0.0 if residual <= 1e-24 * float(np.mean(outputs**2)) else math.inf
    return residual / variance


def judge(chaos: Chaos, error: float | None = None, most: float = 0.05) -> Verdict:
    """Whether the expansion may be used: the larger of `error` (held out) and its own is at most `most`."""
    own = chaos.cross_validation_error
    worst = own if error is None else max(own, error)
    if not (math.isfinite(worst) and (error is None or math.isfinite(error))):
        return Verdict(usable=False, error=1.0, reason="the error of the expansion is not finite")
    terms = f"{chaos.coefficients.size} terms of degree {chaos.degree} from {chaos.samples} samples"
    if worst > most:
        reason = f"refused: it leaves {worst:.2g} of the variance unexplained, more than {most:g} ({terms})"
        return Verdict(usable=False, error=min(worst, 1.0), reason=reason)
    return Verdict(usable=True, error=worst, reason=f"it leaves {worst:.2g} of the variance ({terms})")


# --- moments and indices ------------------------------------------------------------------------------


def _read(chaos: Chaos, blocks: Sequence[Sequence[int]], replicate: int) -> tuple[Array, list[Array]]:
    """Values of an expansion at points A, and at points that share the inputs of each block with A."""
    from scipy.special import ndtri

    d = len(chaos.germs)
    uniforms = sobol_points(dimension=2 * d, count=_READ, seed=0, task="read an expansion", replicate=replicate)
    normals = np.asarray(ndtri(uniforms))
    a, b = germ_points(normals[:, :d], chaos.germs), germ_points(normals[:, d:], chaos.germs)
    shared = []
    for block in blocks:
        mixed = b.copy()
        mixed[:, list(block)] = a[:, list(block)]
        shared.append(predict(chaos, mixed))
    return predict(chaos, a), shared


def chaos_moments(chaos: Chaos) -> tuple[float, float]:
    """Mean and standard deviation of the expansion, off its coefficients (of a logarithm: off its values)."""
    if chaos.transform == "none":
        return float(chaos.coefficients[0]), math.sqrt(float(np.sum(chaos.coefficients[1:] ** 2)))
    values = np.concatenate([_read(chaos, (), replicate)[0] for replicate in range(_READINGS)])
    return float(values.mean()), float(values.std())


def _closed(chaos: Chaos, blocks: Sequence[Sequence[int]], replicate: int) -> Array:
    """Share of the variance that each block of inputs explains by itself, (blocks,)."""
    if chaos.transform == "none":
        squares = chaos.coefficients[1:] ** 2
        active = chaos.multi_indices[1:] > 0
        outside = [np.delete(active, list(block), axis=1).any(axis=1) for block in blocks]
        return np.asarray(np.array([squares[~out].sum() for out in outside]) / squares.sum())
    values, shared = _read(chaos, blocks, replicate)
    found = []
    for other in shared:
        mean = 0.5 * (values.mean() + other.mean())
        y, z = values - mean, other - mean
        found.append(float((y * z).mean() / (0.5 * (y * y + z * z).mean())))
    return np.array(found)


def closed_index(chaos: Chaos, inputs: Sequence[int]) -> float:
    """Share of the variance that some inputs (columns) and their interactions among themselves explain.

    One input: its first-order index.  The expansion must not be constant.
    """
    return float(np.mean([_closed(chaos, [tuple(inputs)], replicate)[0] for replicate in range(_READINGS)]))


def total_index(chaos: Chaos, inputs: Sequence[int]) -> float:
    """Share of the variance in which some inputs (columns) have a part."""
    return 1.0 - closed_index(chaos, [j for j in range(len(chaos.germs)) if j not in set(inputs)])


def _shares(chaos: Chaos, replicate: int) -> tuple[Array, Array]:
    """First and total index (d,) of every input; the expansion must not be constant."""
    d = len(chaos.germs)
    blocks = [(j,) for j in range(d)] + [tuple(k for k in range(d) if k != j) for j in range(d)]
    closed = _closed(chaos, blocks, replicate)
    return closed[:d], 1.0 - closed[d:]


def chaos_indices(
    fits: Sequence[Chaos], error: float | None = None, evaluations: int | None = None
) -> dict[str, list[Estimate]]:
    """First and total Sobol' indices {"first": [...], "total": [...]}, one per input.

    `fits` are expansions of independent randomisations; `error` is the share of the variance they leave
    unexplained (the mean of their own leave-one-out errors if not given).  The interval is the sum of the
    spread over the fits, which holds the error of the coefficients, and of what the unexplained share
    could move: with f = g + h, h orthogonal to g, an index is (1 - e) S_g + e S_h with S_h in [0, 1].  A
    single fit has no spread, and takes Cauchy and Schwarz: |sqrt(S) - sqrt(S_g)| <= sqrt(e).
    """
    method = "polynomial chaos"
    count = sum(fit.samples for fit in fits) if evaluations is None else evaluations
    dimension = len(fits[0].germs)
    unexplained = float(np.mean([fit.cross_validation_error for fit in fits])) if error is None else error
    reason = ""
    if any(not np.any(fit.coefficients[1:]) for fit in fits):
        reason = "the output does not vary with the inputs, or the expansion is a constant"
    elif not math.isfinite(unexplained) or unexplained >= 1.0:
        reason = "the expansion explains nothing of the variance"
    if reason:
        nothing = [absent(reason, method, count)] * dimension
        return {"first": nothing, "total": list(nothing)}
    # (R, 2, d); an expansion that has to be read at points is read at others for every fit, so that the spread knows
    shares = np.array([_shares(fit, replicate) for replicate, fit in enumerate(fits)])
    if len(fits) == 1 and fits[0].transform != "none":
        shares = np.array([_shares(fits[0], replicate) for replicate in range(_READINGS)])
        read = [from_replicates(column, method, count).half_width for column in shares.reshape(_READINGS, -1).T]
        unexplained += max(read)
        shares = shares.mean(axis=0, keepdims=True)
    answer = {}
    for row, name in enumerate(("first", "total")):
        answer[name] = [_index(shares[:, row, j], unexplained, method, count) for j in range(dimension)]
    return answer


def _index(shares: Array, unexplained: float, method: str, evaluations: int) -> Estimate:
    if shares.size == 1:
        root, reach = math.sqrt(float(shares[0])), math.sqrt(unexplained)
        value, low, high = float(shares[0]), max(0.0, root - reach) ** 2, (root + reach) ** 2
        factor = 1.96
    else:
        spread = from_replicates(shares, method, evaluations)
        value = float(np.mean(shares))
        factor = student(shares.size)
        half = spread.half_width
        # On both sides, since the noise of superfluous coefficients adds to shares that are zero; and twice,
        # since the unexplained share is itself an estimate.
        low, high = value - half - 2.0 * unexplained, value + half + 2.0 * unexplained
    low, high = max(0.0, low), min(1.0, high)
    return Estimate(value=value, low=low, high=high, std_error=0.5 * (high - low) / factor,
                    method=method, evaluations=evaluations)  # fmt: skip
