"""Indices of pairs and groups of inputs from a surrogate of a dear model, with intervals that hold its error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from uqsphere.uq.augmented import METHOD, Trusted, index_estimate
from uqsphere.uq.chaos.sampled import sampled_shares
from uqsphere.uq.estimates import Estimate, absent, exact
from uqsphere.uq.families import Array

__all__ = ["group_indices", "pair_indices"]

#: designs on which an expansion that was transformed or split is sampled: the first answers, all show its noise
_DESIGNS: Final = 4


def pair_indices(trusted: Trusted, pairs: Sequence[tuple[int, int]]) -> list[Estimate]:
    """Second-order index of every pair of inputs, S_ij = closed S_ij - S_i - S_j.

    The interval is that of an index of one input (`uqsphere.uq.augmented.indices_of`): the terms of a pair are a
    subspace of the outputs, orthogonal to all others, as those of one input are.
    """
    if trusted.chaos.constant:
        return [_nothing(trusted)] * len(pairs)
    single = sorted({i for pair in pairs for i in pair})
    closed = _closed(trusted, [*([i] for i in single), *(list(pair) for pair in pairs)])[:, :, 0]
    alone = dict(zip(single, closed[:, : len(single)].T, strict=True))
    both = closed[:, len(single) :].T
    return [_estimate(trusted, row - alone[i] - alone[j]) for row, (i, j) in zip(both, pairs, strict=True)]


def group_indices(trusted: Trusted, groups: Sequence[Sequence[int]]) -> tuple[list[Estimate], list[Estimate]]:
    """Closed and total index of every group of inputs."""
    if trusted.chaos.constant:
        return [_nothing(trusted)] * len(groups), [_nothing(trusted)] * len(groups)
    shares = _closed(trusted, groups)
    return (
        [_estimate(trusted, shares[:, g, 0]) for g in range(len(groups))],
        [_estimate(trusted, shares[:, g, 1]) for g in range(len(groups))],
    )


def _nothing(trusted: Trusted) -> Estimate:
    reason = "the output does not vary with the inputs, or the expansion is a constant"
    return absent(reason, METHOD, len(trusted.residuals))


def _closed(trusted: Trusted, subsets: Sequence[Sequence[int]]) -> Array:
    """Closed and total share of every subset, (designs, subsets, 2): one design where the coefficients tell."""
    chaos = trusted.chaos
    if not chaos.plain:
        return np.array([sampled_shares(chaos, subsets, replicate) for replicate in range(_DESIGNS)])
    coefficients = chaos.pieces[0].coefficients[1:]
    squares = (coefficients / np.abs(coefficients).max()) ** 2
    active = chaos.pieces[0].multi_indices[1:] > 0
    found = np.empty((1, len(subsets), 2))
    for k, subset in enumerate(subsets):
        inside = np.zeros(active.shape[1], dtype=bool)
        inside[list(subset)] = True
        found[0, k, 0] = squares[~active[:, ~inside].any(axis=1)].sum()
        found[0, k, 1] = squares[active[:, inside].any(axis=1)].sum()
    return np.asarray(found / squares.sum())


def _estimate(trusted: Trusted, shares: Array) -> Estimate:
    n = len(trusted.residuals)
    value = min(max(float(shares[0]), 0.0), 1.0)
    half = 3.0 * float(shares.std(ddof=1)) if shares.size > 1 else 0.0
    return index_estimate(exact(value), trusted.error, n, sampled=half)
