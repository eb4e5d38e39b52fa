"""Sobol' indices of a dear model off a surrogate of its runs, with intervals that hold the model's own.

With S the surrogate and h what it lacks, an index of the model is (1 - e) I_S + e I_h, plus what S shares with h: the
noise of the coefficients.  Runs left out one by one say how far that noise moves each index (`left_out_moves`), which
is far more where the output is large and scatters most than noise of one size on all runs would make of it.  They
know nothing of the choice of terms.  How far the indices moved since the fit of half the runs does, once it is taken
down to the error of today's: what all moved, as a factor, and what each moved itself.  An input without terms has no
noise, and counts the unexplained share in full.

Beyond the outermost runs S may grow on where the model does not.  What an index changes by as S is drawn in there,
along one input after the other, is room that its interval has besides (`beyond_runs`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final, TypeAlias

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.uq.augmented import METHOD, Trusted, index_estimate, piece_rows, piece_values
from uqsphere.uq.beyond_runs import shares_within
from uqsphere.uq.estimate import Estimate, absent, exact, student
from uqsphere.uq.expansion import Chaos, predict
from uqsphere.uq.expansion.expansion import Piece
from uqsphere.uq.expansion.shares import Companion, active_inputs, law_points, law_shares

__all__ = [
    "DESIGNS",
    "FIRST",
    "TOTAL",
    "Terms",
    "active_shares",
    "earlier",
    "left_out_moves",
    "moves_since",
    "reaching",
    "replicates_of",
    "share_estimate",
    "standard_errors",
    "trusted_indices",
    "with_reach",
]

#: designs on which an expansion that was transformed or split is sampled, their mean is the answer
DESIGNS: Final = 8
#: standard errors to either side: of first and closed indices, and of those that hold interactions, of which a design
#: of few points confounds more with what the surrogate lacks, and whose errors have longer tails
FIRST: Final = 1.9
TOTAL: Final = 2.1
#: part of what the indices moved since the fit before that counts as choice of terms, and how much more at most
_MOVED: Final = 0.3
_MOST_MOVED: Final = 50.0
#: points of the law that derivatives are averaged over
_POINTS: Final = 4096

#: which terms (P,) belong to an index, from which inputs (P, d) each term has
Terms: TypeAlias = Callable[[Flags], Flags]


def replicates_of(seed: int) -> range:
    """Numbers of the designs that a seed samples expansions on: those of another seed are independent."""
    return range(DESIGNS * seed, DESIGNS * (seed + 1))


def _alone(j: int) -> Terms:
    return lambda active: active[:, j] & (active.sum(axis=1) == 1)


def _with(j: int) -> Terms:
    return lambda active: active[:, j]


def _singles(d: int) -> list[Terms]:
    """First indices of all inputs, then total ones."""
    return [kind(j) for kind in (_alone, _with) for j in range(d)]


def active_shares(chaos: Chaos, asked: Sequence[Terms]) -> Array:
    """Shares (m,) of the variance of a plain expansion that fall to the terms asked for."""
    coefficients = chaos.pieces[0].coefficients[1:]
    squares = (coefficients / np.abs(coefficients).max()) ** 2
    active = chaos.pieces[0].multi_indices[1:] > 0
    return np.asarray([squares[terms(active)].sum() for terms in asked]) / float(squares.sum())


def _steps(rows: Array, values: Array) -> Array:
    """What each value (n,) left out moves the coefficients of least squares in rows (k, n) by: (k, n)."""
    q, r = np.linalg.qr(rows.T)
    off = values - q @ (q.T @ values)
    leverage = np.minimum((q**2).sum(axis=1), 1.0 - 1e-6)
    return np.asarray(-np.linalg.solve(r, q.T * (off / (1.0 - leverage))))


def left_out_moves(chaos: Chaos, points: Array, outputs: Array, asked: Sequence[Terms]) -> Array | None:
    """How far each of the samples (n, d), (n,), left out of the coefficients, moves each of m indices: (n, m).

    To first order, the terms as they are.  None where a piece has no more samples than terms.
    """
    if chaos.plain:
        return _moves_of_plain(chaos, points, outputs, asked)
    there = law_points(chaos.germs, 0)[0][:_POINTS]
    values = predict(chaos, there)
    unit = float(np.abs(values).max()) or 1.0
    varying = values / unit - float(np.mean(values / unit))
    scale = float(np.std(varying)) * unit
    whole = varying * (unit / scale)
    companion = Companion(chaos, there, whole)
    masks = np.array([terms(companion.active) for terms in asked])
    parts = (masks * companion.coefficients) @ companion.rows(there)
    shares = np.mean(parts**2, axis=1)
    here_all, there_all = [np.ones(len(outputs), dtype=bool)], [np.ones(len(there), dtype=bool)]
    if chaos.border is not None:
        side = chaos.border.side(points, [piece_values(chaos, piece, points) for piece in chaos.pieces])
        beyond = chaos.border.side(there, [piece_values(chaos, piece, there) for piece in chaos.pieces])
        here_all, there_all = [~side, side], [~beyond, beyond]
    moves = np.zeros((len(outputs), len(asked)))
    for piece, here, inside in zip(chaos.pieces, here_all, there_all, strict=True):
        if not here.any():
            continue
        rows = piece_rows(chaos, piece, points[here])
        if rows.shape[0] >= rows.shape[1]:
            return None
        law = piece_rows(chaos, piece, there)
        slopes = _slopes(piece, piece.coefficients @ law, scale) * inside
        rates = 2.0 / len(there) * ((parts - shares[:, None] * whole) * slopes) @ law.T
        target = outputs[here] / scale if piece.transform is None else piece.transform.forward(outputs[here])
        moves[here] = (rates @ _steps(rows, target)).T
    return moves


def _slopes(piece: Piece, inner: Array, scale: float) -> Array:
    """Derivatives of the output over its standard deviation with respect to the values that were fitted."""
    return np.ones_like(inner) if piece.transform is None else piece.transform.slope(inner) / scale


def _moves_of_plain(chaos: Chaos, points: Array, outputs: Array, asked: Sequence[Terms]) -> Array | None:
    piece = chaos.pieces[0]
    unit = float(np.abs(piece.coefficients[1:]).max())
    weights = np.concatenate([[0.0], piece.coefficients[1:] / unit])
    variance = float(weights @ weights)
    active = piece.multi_indices > 0
    rows = piece_rows(chaos, piece, points)
    if rows.shape[0] >= rows.shape[1]:
        return None
    shares = active_shares(chaos, asked)
    rates = [
        2.0 * weights * (terms(active) - share) / variance for terms, share in zip(asked, shares.tolist(), strict=True)
    ]
    return np.asarray((np.array(rates) @ _steps(rows, outputs / unit)).T)


def _shares(chaos: Chaos, replicate: int) -> Array:
    """First and total index of every input, (2, d): off the coefficients, or sampled on one design."""
    d = len(chaos.germs)
    if chaos.plain:
        return active_shares(chaos, _singles(d)).reshape(2, d)
    found, inputs = np.zeros((2, d)), active_inputs(chaos)
    found[:, list(inputs)] = law_shares(chaos, [[j] for j in inputs], replicate).T
    return found


def earlier(trusted: Trusted) -> Chaos | None:
    """The fit of fewer runs that today's indices are compared with, if there is one that varies."""
    before = trusted.before
    return None if before is None or before.constant or trusted.seen_by_none is None else before


def moves_since(trusted: Trusted, seed: int, shares: Array | None = None) -> Array | None:
    """How far first and total indices (2, d) moved since the fit of fewer runs; None without one.

    Both on the first design of the seed, whose noise they have in common; `shares` are today's there, if known.
    """
    before, replicate = earlier(trusted), replicates_of(seed)[0]
    if before is None:
        return None
    return _shares(before, replicate) - (_shares(trusted.chaos, replicate) if shares is None else shares)


def _choice(trusted: Trusted, since: Array | None, spread: Array) -> tuple[float, float]:
    """What the choice of terms adds to squares of standard errors (2, d) of the coefficients.

    A factor >= 1 for all of them, and the part of the square of its own move that each takes besides.  The factor
    comes from what all indices moved, `since` (2, d), taken down to the error of now; without a fit before, from the
    K-fold error, which holds the choice, over that of runs left out.
    """
    squares = float(np.sum(spread**2))
    if not trusted.scatter > 0.0:
        return 1.0, 0.0
    folded, unseen = trusted.chaos.cross_validation_error, trusted.seen_by_none
    if since is None or unseen is None:
        left_out = trusted.error * float(np.mean((trusted.residuals / trusted.scatter) ** 2))
        return min(max(folded / left_out, 1.0), _MOST_MOVED) if left_out > 0.0 else 1.0, 0.0
    ratio = min(folded / unseen, 1.0) if unseen > 0.0 else 1.0
    factor = min(ratio * float(np.sum(since**2)) / squares, _MOST_MOVED) if squares > 0.0 else 0.0
    return 1.0 + _MOVED * factor, ratio


def standard_errors(trusted: Trusted, asked: Sequence[Terms], since: Array | None, moved: Array | None) -> Array | None:
    """Standard errors (m,) of indices by the terms that each asks for; None where runs are too few to leave one out.

    `since` (2, d) and `moved` (m,) are how far the indices of single inputs, and those asked for, moved since the
    fit of fewer runs.
    """
    d, n = len(trusted.chaos.germs), len(trusted.residuals)
    both = [*_singles(d), *asked]
    moves = left_out_moves(trusted.chaos, trusted.points, trusted.levels + trusted.residuals, both)
    if moves is None:
        return None
    spread = np.sqrt((n - 1) / n * ((moves - moves.mean(axis=0)) ** 2).sum(axis=0))
    factor, ratio = _choice(trusted, since, spread[: 2 * d].reshape(2, d))
    return np.asarray(np.sqrt(factor * spread[2 * d :] ** 2 + ratio * (0.0 if moved is None else moved**2)))


def share_estimate(trusted: Trusted, shares: Array, total: float, spread: float | None, factor: float) -> Estimate:
    """An index from its values on designs (R,), one where coefficients tell, with an interval for the model's.

    `total` is the share of all terms that have its inputs: where it is nothing beside what the noise of one
    coefficient leaves, e/N, the unexplained share e counts in full, and no less than e/N anywhere.  It fades more
    slowly above than below: terms that a design of few points does not show are missing from small indices.
    """
    n, error = len(trusted.residuals), trusted.error
    value = min(max(float(np.mean(shares)), 0.0), 1.0)
    # half of Student's interval: the two standard errors of many designs
    designs = 0.0
    if shares.size > 1:
        designs = 0.5 * student(shares.size) * float(np.std(shares, ddof=1)) / math.sqrt(shares.size)
    if spread is None:
        return index_estimate(exact(value), error, n, sampled=factor * designs)
    noise = error / (error + n * max(total, 0.0)) if error > 0.0 else 0.0
    half = factor * math.hypot(spread, designs) + 1e-15
    low = max(0.0, value - half - error * max(1.0 / n, noise))
    high = min(1.0, value + half + error * max(1.0 / n, math.sqrt(noise)))
    return Estimate(value=value, low=low, high=high, std_error=0.25 * (high - low), method=METHOD, evaluations=n)


def reaching(found: Sequence[Estimate], shares: Array) -> list[Estimate]:
    """Indices whose intervals reach as far again as drawing in beyond the runs moves them.

    `shares` (1 + d, indices) are those as it is, then drawn in along every input.  What one of these moves an index
    down by, another may move it up by: all that go down, and all that go up, are held together.
    """
    moves = shares[1:] - shares[0]
    down, up = np.minimum(moves, 0.0).sum(axis=0).tolist(), np.maximum(moves, 0.0).sum(axis=0).tolist()
    answer = []
    for estimate, less, more in zip(found, down, up, strict=True):
        if estimate.low is None or estimate.high is None:
            answer.append(estimate)
            continue
        low, high = max(estimate.low + less, 0.0), min(estimate.high + more, 1.0)
        error = max(estimate.std_error or 0.0, 0.25 * (high - low))
        answer.append(replace(estimate, low=low, high=high, std_error=error))
    return answer


def with_reach(trusted: Trusted, found: Mapping[str, Sequence[Estimate]]) -> dict[str, list[Estimate]]:
    """First and total indices of all inputs, whose intervals hold what is not known beyond the runs."""
    shares = shares_within(trusted, [[j] for j in range(len(trusted.chaos.germs))])
    return {order: reaching(found[order], shares[:, :, k]) for k, order in enumerate(("first", "total"))}


def trusted_indices(trusted: Trusted, seed: int = 0) -> dict[str, list[Estimate]]:
    """First and total indices {"first": [...], "total": [...]} of the model, one for each input.

    `seed` chooses the designs on which an expansion is sampled that was transformed or split.
    """
    chaos, n, d = trusted.chaos, len(trusted.residuals), len(trusted.chaos.germs)
    if chaos.constant:
        nothing = absent("the output does not vary with the inputs, or the expansion is a constant", METHOD, n)
        return {order: [nothing] * d for order in ("first", "total")}
    numbers = replicates_of(seed)[:1] if chaos.plain else replicates_of(seed)
    shares = np.array([_shares(chaos, replicate) for replicate in numbers])
    since = moves_since(trusted, seed, shares[0])
    spread = standard_errors(trusted, _singles(d), since, None if since is None else since.ravel())
    total = shares[:, 1].mean(axis=0)
    found = {
        order: [
            share_estimate(
                trusted, shares[:, k, j], float(total[j]), None if spread is None else float(spread[k * d + j]), factor
            )
            for j in range(d)
        ]
        for k, (order, factor) in enumerate((("first", FIRST), ("total", TOTAL)))
    }
    return with_reach(trusted, found)
