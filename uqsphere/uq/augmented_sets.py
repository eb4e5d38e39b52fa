"""Indices of pairs and groups of inputs from a surrogate of a dear model, with intervals that hold its error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.augmented import METHOD, Trusted
from uqsphere.uq.augmented_indices import (
    FIRST,
    TOTAL,
    Terms,
    active_shares,
    earlier,
    moves_since,
    reaching,
    replicates_of,
    share_estimate,
    standard_errors,
)
from uqsphere.uq.beyond_runs import shares_within
from uqsphere.uq.estimate import Estimate, absent
from uqsphere.uq.expansion import Chaos
from uqsphere.uq.expansion.shares import law_shares

__all__ = ["group_indices", "pair_indices"]


def pair_indices(trusted: Trusted, pairs: Sequence[tuple[int, int]], seed: int = 0) -> list[Estimate]:
    """Second-order index of every pair of inputs, S_ij = closed S_ij - S_i - S_j.

    The interval is that of a total index of one input (`uqsphere.uq.augmented_indices`): the terms of a pair are a
    subspace of the outputs, orthogonal to all others, as those of one input are.
    """
    if trusted.chaos.constant:
        return [_nothing(trusted)] * len(pairs)
    single = sorted({i for pair in pairs for i in pair})
    subsets = [*([i] for i in single), *(list(pair) for pair in pairs)]
    now, then = _closed(trusted, subsets, seed)
    shares = _interactions(now[:, :, 0], single, pairs)
    before = None if then is None else _interactions(then[:, :, 0], single, pairs)
    within = _interactions(shares_within(trusted, subsets)[:, :, 0], single, pairs)
    return _estimates(trusted, shares, before, shares, [_exactly(pair) for pair in pairs], within, TOTAL, seed)


def _interactions(closed: Array, single: Sequence[int], pairs: Sequence[tuple[int, int]]) -> Array:
    """What every pair has beyond its two inputs, (designs, pairs), from closed shares of inputs and pairs."""
    alone = dict(zip(single, closed[:, : len(single)].T, strict=True))
    rows = [row - alone[i] - alone[j] for row, (i, j) in zip(closed[:, len(single) :].T, pairs, strict=True)]
    return np.array(rows).reshape(len(pairs), len(closed)).T


def group_indices(
    trusted: Trusted, groups: Sequence[Sequence[int]], seed: int = 0
) -> tuple[list[Estimate], list[Estimate]]:
    """Closed and total index of every group of inputs."""
    if trusted.chaos.constant:
        return [_nothing(trusted)] * len(groups), [_nothing(trusted)] * len(groups)
    shares, before = _closed(trusted, groups, seed)
    within = shares_within(trusted, groups)
    found = [
        _estimates(
            trusted,
            shares[:, :, k],
            None if before is None else before[:, :, k],
            shares[:, :, 1],
            [kind(group) for group in groups],
            within[:, :, k],
            factor,
            seed,
        )
        for k, (kind, factor) in enumerate(((_within, FIRST), (_touching, TOTAL)))
    ]
    return found[0], found[1]


def _exactly(group: Sequence[int]) -> Terms:
    return lambda active: np.asarray(active[:, list(group)].all(axis=1) & (active.sum(axis=1) == len(group)))


def _within(group: Sequence[int]) -> Terms:
    return lambda active: np.asarray(active.any(axis=1) & ~np.delete(active, list(group), axis=1).any(axis=1))


def _touching(group: Sequence[int]) -> Terms:
    return lambda active: np.asarray(active[:, list(group)].any(axis=1))


def _nothing(trusted: Trusted) -> Estimate:
    reason = "the output does not vary with the inputs, or the expansion is a constant"
    return absent(reason, METHOD, len(trusted.residuals))


def _closed(trusted: Trusted, subsets: Sequence[Sequence[int]], seed: int) -> tuple[Array, Array | None]:
    """Closed and total share of every subset, (designs, subsets, 2); of the fit before on the first design."""
    before, replicates = earlier(trusted), replicates_of(seed)
    shares = _shares(trusted.chaos, subsets, replicates)
    return shares, None if before is None else _shares(before, subsets, replicates[:1])


def _shares(chaos: Chaos, subsets: Sequence[Sequence[int]], replicates: Sequence[int]) -> Array:
    """As many designs as asked for, one where the coefficients tell."""
    if not chaos.plain:
        return np.array([law_shares(chaos, subsets, replicate) for replicate in replicates])
    found = [active_shares(chaos, [kind(subset) for subset in subsets]) for kind in (_within, _touching)]
    return np.stack(found, axis=1)[None]


def _estimates(
    trusted: Trusted,
    shares: Array,
    before: Array | None,
    total: Array,
    terms: Sequence[Terms],
    within: Array,
    factor: float,
    seed: int,
) -> list[Estimate]:
    moved = None if before is None else before[0] - shares[0]
    spreads = standard_errors(trusted, terms, moves_since(trusted, seed), moved)
    found = [
        share_estimate(
            trusted, shares[:, k], float(np.mean(total[:, k])), None if spreads is None else float(spreads[k]), factor
        )
        for k in range(len(terms))
    ]
    return reaching(found, within)
