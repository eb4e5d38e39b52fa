"""Indices of pairs and groups of inputs from a surrogate of a dear model, with intervals that hold its error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uqsphere.uq.augmented import METHOD, Trusted
from uqsphere.uq.augmented_indices import (
    FIRST,
    TOTAL,
    Terms,
    active_shares,
    replicates_of,
    share_estimate,
    standard_errors,
)
from uqsphere.uq.chaos.sampled import law_shares
from uqsphere.uq.estimates import Estimate, absent
from uqsphere.uq.families import Array

__all__ = ["group_indices", "pair_indices"]


def pair_indices(trusted: Trusted, pairs: Sequence[tuple[int, int]], seed: int = 0) -> list[Estimate]:
    """Second-order index of every pair of inputs, S_ij = closed S_ij - S_i - S_j.

    The interval is that of a total index of one input (`uqsphere.uq.augmented_indices`): the terms of a pair are a
    subspace of the outputs, orthogonal to all others, as those of one input are.
    """
    if trusted.chaos.constant:
        return [_nothing(trusted)] * len(pairs)
    single = sorted({i for pair in pairs for i in pair})
    closed = _closed(trusted, [*([i] for i in single), *(list(pair) for pair in pairs)], seed)[:, :, 0]
    alone = dict(zip(single, closed[:, : len(single)].T, strict=True))
    rows = [row - alone[i] - alone[j] for row, (i, j) in zip(closed[:, len(single) :].T, pairs, strict=True)]
    return _estimates(trusted, rows, rows, [_exactly(pair) for pair in pairs], TOTAL, seed)


def group_indices(
    trusted: Trusted, groups: Sequence[Sequence[int]], seed: int = 0
) -> tuple[list[Estimate], list[Estimate]]:
    """Closed and total index of every group of inputs."""
    if trusted.chaos.constant:
        return [_nothing(trusted)] * len(groups), [_nothing(trusted)] * len(groups)
    shares = _closed(trusted, groups, seed)
    closed, total = ([shares[:, g, k] for g in range(len(groups))] for k in range(2))
    return (
        _estimates(trusted, closed, total, [_within(group) for group in groups], FIRST, seed),
        _estimates(trusted, total, total, [_touching(group) for group in groups], TOTAL, seed),
    )


def _exactly(group: Sequence[int]) -> Terms:
    return lambda active: np.asarray(active[:, list(group)].all(axis=1) & (active.sum(axis=1) == len(group)))


def _within(group: Sequence[int]) -> Terms:
    return lambda active: np.asarray(active.any(axis=1) & ~np.delete(active, list(group), axis=1).any(axis=1))


def _touching(group: Sequence[int]) -> Terms:
    return lambda active: np.asarray(active[:, list(group)].any(axis=1))


def _nothing(trusted: Trusted) -> Estimate:
    reason = "the output does not vary with the inputs, or the expansion is a constant"
    return absent(reason, METHOD, len(trusted.residuals))


def _closed(trusted: Trusted, subsets: Sequence[Sequence[int]], seed: int) -> Array:
    """Closed and total share of every subset, (designs, subsets, 2): one design where the coefficients tell."""
    chaos = trusted.chaos
    if not chaos.plain:
        return np.array([law_shares(chaos, subsets, replicate) for replicate in replicates_of(seed)])
    found = [active_shares(chaos, [kind(subset) for subset in subsets]) for kind in (_within, _touching)]
    return np.stack(found, axis=1)[None]


def _estimates(
    trusted: Trusted, shares: Sequence[Array], total: Sequence[Array], terms: Sequence[Terms], factor: float, seed: int
) -> list[Estimate]:
    spreads = standard_errors(trusted, terms, seed)
    return [
        share_estimate(
            trusted, shares[k], float(np.mean(total[k])), None if spreads is None else float(spreads[k]), factor
        )
        for k in range(len(shares))
    ]
