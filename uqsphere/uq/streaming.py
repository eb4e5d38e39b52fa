"""Moments and exact quantiles of samples too many to hold: generated block by block, as often as it takes.

Moments take two passes (`uqsphere.uq.moments`).  A quantile is an order statistic of all samples together, found by
narrowing: a histogram of a bracket shows in which of its bins the wanted rank lies, that bin is the next bracket, and
once few enough different values are in it they are kept and counted by replicate.  Values and intervals are those of
`uqsphere.uq.estimates.describe` on the whole sample, bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.uq.estimates import (
    LEAST_BEYOND,
    Description,
    Estimate,
    absent,
    describe_moments,
    hazen,
    hazen_ranks,
    none_of,
    student,
    woodruff_reach,
)
from uqsphere.uq.moments import FirstSums, finish, first_sums, merge_first, merge_second, pieces, second_sums

__all__ = ["Stream", "describe_stream"]

#: Generates the blocks (R, n_k) of a sample, the same ones at every call.
Stream: TypeAlias = Callable[[], Iterable[Array]]

Counts: TypeAlias = npt.NDArray[np.int64]

_BINS: Final = 32_768
#: different values of a bracket that are kept
_MOST: Final = 1 << 19
_MOST_PASSES: Final = 60


def describe_stream(
    blocks: Stream,
    *,
    quantiles: Sequence[float] = (0.01, 0.05, 0.5, 0.95, 0.99),
    method: str = "randomised quasi-Monte Carlo",
) -> Description:
    """Mean, standard deviation and quantiles of the samples that `blocks` generates.

    Parameters
    ----------
    blocks : callable
        Yields arrays (R, n_k), the points of R replicates in their order; called about four times, more where the
        values are very unevenly spread, and has to yield the same every time.
    quantiles : probabilities inside (0, 1)
    method : text of every estimate

    Memory is some tens of megabytes beside a block, whatever the number of samples; of values that are all equal too.

    Raises
    ------
    ValueError
        For samples that are not finite, fewer than two replicates or points, and blocks that change between calls.

    >>> rows = np.random.default_rng(1).random((4, 1000))
    >>> found = describe_stream(lambda: (rows[:, k : k + 100] for k in range(0, 1000, 100)), quantiles=(0.5,))
    >>> found.quantiles[0.5].value == float(np.median(rows))
    True
    """
    first: FirstSums | None = None
    for piece in pieces(_checked(blocks)):
        sums = first_sums(piece)
        first = sums if first is None else merge_first(first, sums)
    if first is None or len(first.counts) < 2 or first.counts[0] < 2:
        raise ValueError("a stream needs at least two replicates of two points")
    replicates, n = len(first.counts), int(first.counts[0])
    total = replicates * n
    second = None
    for piece in pieces(_checked(blocks)):
        powers = second_sums(piece, first)
        second = powers if second is None else merge_second(second, powers)
    if second is None:
        raise ValueError("the blocks changed between two calls: the second had none")
    asked = [p for p in dict.fromkeys(quantiles) if min(p, 1.0 - p) * total >= LEAST_BEYOND]
    orders = _Orders(blocks, first)
    found = _quantiles(orders, asked, replicates, n, method)

    def inner() -> tuple[float, float]:
        low, high = (e.value for e in _quantiles(orders, [0.16, 0.84], replicates, n, method).values())
        return low or 0.0, high or 0.0

    mean, sd, scale = describe_moments(finish(first, second), total, n, method, inner)
    nothing = {p: absent(f"too few samples beyond the {p:g} quantile", method, total) for p in quantiles}
    return Description(
        mean=mean,
        sd=sd,
        quantiles={p: found.get(p, nothing[p]) for p in quantiles},
        censored_share=none_of(total),
        scale=scale,
    )


def _checked(blocks: Stream) -> Iterable[Array]:
    for block in blocks():
        rows = np.asarray(block, dtype=float)
        if rows.ndim != 2:
            raise ValueError(f"blocks must have shape (R, n), found {rows.shape}")
        if not np.isfinite(rows).all():
            bad = int((~np.isfinite(rows)).sum())
            raise ValueError(f"{bad} samples of a block are not finite: drop their points before")
        yield rows


class _Bracket:
    """The samples from low to high, ends included: how they spread, and which they are while they are few."""

    def __init__(self, low: float, high: float, replicates: int, keep: bool = True) -> None:
        self.low, self.high, self.replicates = low, high, replicates
        self.under: Counts = np.zeros(replicates, dtype=np.int64)
        self.histogram: Counts = np.zeros(_BINS, dtype=np.int64)
        self.keep = keep
        self.values: Array = np.empty(0)
        self.counts: Counts = np.empty((0, replicates), dtype=np.int64)
        self._fresh: list[tuple[Array, Counts]] = []

    def take(self, piece: Array) -> None:
        """Count a piece (R, n)."""
        self.under += (piece < self.low).sum(axis=1)
        inside = (piece >= self.low) & (piece <= self.high)
        values = piece[inside]
        # Halves, so that a bracket from -1e308 to 1e308 has a width; never falls as the value rises.
        width = 0.5 * self.high - 0.5 * self.low
        place = (0.5 * values - 0.5 * self.low) / width if width > 0.0 else np.zeros(values.size)
        self.histogram += np.bincount(np.minimum((place * _BINS).astype(np.int64), _BINS - 1), minlength=_BINS)
        if self.keep:
            self._fresh.append((values, np.nonzero(inside)[0]))
            if sum(len(v) for v, _ in self._fresh) > _MOST:
                self.settle()

    def settle(self) -> None:
        """Sort what came in among the values kept; give them up where there are too many different ones."""
        if not self._fresh:
            return
        fresh = np.concatenate([v for v, _ in self._fresh])
        owners = np.concatenate([o for _, o in self._fresh])
        self._fresh = []
        values, place = np.unique(np.concatenate([self.values, fresh]), return_inverse=True)
        if len(values) > _MOST:
            self.keep = False
            self.values, self.counts = np.empty(0), self.counts[:0]
            return
        counts = np.zeros((len(values), self.replicates), dtype=np.int64)
        counts[place[: len(self.values)]] = self.counts
        flat = place[len(self.values) :] * self.replicates + owners
        counts += np.bincount(flat, minlength=counts.size).reshape(counts.shape)
        self.values, self.counts = values, counts

    def holds(self, rank: int) -> bool:
        """Whether the sample of this rank, from 0, is inside."""
        start = int(self.under.sum())
        return start <= rank < start + int(self.histogram.sum())

    def find(self, rank: int) -> tuple[float, Counts]:
        """The value of this rank, and how many samples of each replicate are at most as large."""
        cumulative = self.counts.cumsum(axis=0)
        at = int(np.searchsorted(cumulative.sum(axis=1) + int(self.under.sum()), rank, side="right"))
        return float(self.values[at]), self.under + cumulative[at]

    def narrower(self, rank: int) -> tuple[float, float]:
        """The bin that holds this rank, to be sure with the numbers next to its ends."""
        at = int(np.searchsorted(self.histogram.cumsum() + int(self.under.sum()), rank, side="right"))
        width = 0.5 * self.high - 0.5 * self.low
        low, high = (self.low + 2.0 * width * (edge / _BINS) for edge in (at - 1e-3, at + 1.001))
        return max(self.low, math.nextafter(low, -math.inf)), min(self.high, math.nextafter(high, math.inf))


class _Orders:
    """Order statistics of a stream, several at a time.  The histogram of the whole range is made once."""

    def __init__(self, blocks: Stream, first: FirstSums) -> None:
        self.blocks = blocks
        self.replicates = len(first.counts)
        self.whole = _Bracket(first.low, first.high, self.replicates, keep=first.low == first.high)
        self._pass([self.whole])

    def _pass(self, brackets: Iterable[_Bracket]) -> None:
        chosen = list(brackets)
        for piece in pieces(_checked(self.blocks)):
            for bracket in chosen:
                bracket.take(piece)
        for bracket in chosen:
            bracket.settle()

    def find(self, ranks: Iterable[int]) -> dict[int, tuple[float, Counts]]:
        """Value and counts at most as large, of every rank."""
        found: dict[int, tuple[float, Counts]] = {}
        left = dict.fromkeys(ranks, self.whole)
        for _ in range(_MOST_PASSES):
            if any(not bracket.holds(rank) for rank, bracket in left.items()):
                break
            found |= {rank: bracket.find(rank) for rank, bracket in left.items() if bracket.keep}
            left = {rank: bracket for rank, bracket in left.items() if rank not in found}
            if not left:
                return found
            # Ranks of one bin share their bracket.
            ends = {rank: bracket.narrower(rank) for rank, bracket in left.items()}
            fresh = {pair: _Bracket(*pair, self.replicates) for pair in set(ends.values())}
            self._pass(fresh[pair] for pair in sorted(fresh))
            left = {rank: fresh[ends[rank]] for rank in left}
        raise ValueError("the blocks changed between two calls: no bracket holds its quantile")


def _quantiles(orders: _Orders, asked: Sequence[float], replicates: int, n: int, method: str) -> dict[float, Estimate]:
    """Quantiles with their intervals after Woodruff, as `describe` gives them."""
    total = replicates * n
    found = orders.find({rank for p in asked for rank in hazen_ranks(p, total)})
    middle, reach = {}, {}
    for p in asked:
        middle[p] = hazen(lambda rank: found[rank][0], total, p)
        lower, upper = hazen_ranks(p, total)
        # Nothing lies between the two: what is at most the value is at most the one or the other.
        below = found[upper if middle[p] >= found[upper][0] else lower][1]
        reach[p] = woodruff_reach(below / n, n)
    ends = {p: (max(p - reach[p], 0.0), min(p + reach[p], 1.0)) for p in asked}
    found |= orders.find({rank for pair in ends.values() for end in pair for rank in hazen_ranks(end, total)})
    answers = {}
    for p in asked:
        low, high = (hazen(lambda rank: found[rank][0], total, end) for end in ends[p])
        answers[p] = Estimate(
            value=middle[p],
            low=low,
            high=high,
            std_error=0.5 * (high - low) / student(replicates),
            method=method,
            evaluations=total,
        )
    return answers
