"""Mean, standard deviation and skewness of replicates in two passes, the same to the last bit however the rows come.

Sums are taken over pieces of `PIECE` points of every replicate and added in their order, so that a sample in memory and
one that is generated block by block give the same numbers.  The second pass works about the mean of all samples: no
cancellation, whatever the offset of the quantity.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.arrays import Array

__all__ = [
    "PIECE",
    "FirstSums",
    "Moments",
    "SecondSums",
    "finish",
    "first_sums",
    "merge_first",
    "merge_second",
    "pieces",
    "second_sums",
    "skewness",
]

#: points of every replicate that are summed together
PIECE: Final = 65_536


@dataclass(frozen=True, kw_only=True)
class FirstSums:
    """Of every replicate, (R,): how many samples and their sum; of all together the least and the largest."""

    counts: Array
    sums: Array
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class SecondSums:
    """Sums (R, 3) of q, q², q³ with q = (x - centre)² / scale, scale a power of two, and the largest q."""

    centre: float
    scale: float
    powers: Array
    largest: float


@dataclass(frozen=True, kw_only=True)
class Moments:
    """Means and standard deviations of the replicates, (R,), and of all samples together.

    `largest_share` is the share of the variance that one sample makes, `skewness` that of the squared deviations.
    """

    means: Array
    mean: float
    deviations: Array
    deviation: float
    largest_share: float
    skewness: float


def pieces(blocks: Iterable[Array]) -> Iterator[Array]:
    """The same points of blocks (R, any) in pieces (R, PIECE), the last one shorter."""
    held: list[Array] = []
    size = 0
    for block in blocks:
        at = 0
        while at < block.shape[1]:
            part = block[:, at : at + PIECE - size]
            held.append(part)
            at, size = at + part.shape[1], size + part.shape[1]
            if size == PIECE:
                yield held[0] if len(held) == 1 else np.concatenate(held, axis=1)
                held, size = [], 0
    if held:
        yield held[0] if len(held) == 1 else np.concatenate(held, axis=1)


def _kept(piece: Array) -> tuple[Array, bool]:
    """Which samples count, those that are not nan, and whether all do."""
    kept = ~np.isnan(piece)
    return kept, bool(kept.all())


def first_sums(piece: Array) -> FirstSums:
    """Of a piece (R, n); nan marks a sample that is left out."""
    kept, whole = _kept(piece)
    values = piece if whole else np.where(kept, piece, 0.0)
    inside = piece if whole else piece[kept]
    with np.errstate(over="ignore", invalid="ignore"):
        sums = np.ascontiguousarray(values).sum(axis=1)
    return FirstSums(
        counts=kept.sum(axis=1).astype(float),
        sums=sums,
        low=float(inside.min(initial=math.inf)),
        high=float(inside.max(initial=-math.inf)),
    )


def merge_first(one: FirstSums, other: FirstSums) -> FirstSums:
    """Both together; the order decides the last bit."""
    with np.errstate(over="ignore", invalid="ignore"):
        sums = one.sums + other.sums
    return FirstSums(
        counts=one.counts + other.counts, sums=sums, low=min(one.low, other.low), high=max(one.high, other.high)
    )


def second_sums(piece: Array, first: FirstSums) -> SecondSums:
    """Of a piece (R, n), about the mean of all samples."""
    centre = float(first.sums.sum() / first.counts.sum())
    reach = max(first.high - centre, centre - first.low)
    # A power of two: dividing by it rounds nothing, and keeps the squares of 1e300 inside floating point.
    root = 2.0 ** -np.frexp(reach)[1] if 0.0 < reach < math.inf else 1.0
    kept, whole = _kept(piece)
    with np.errstate(over="ignore", invalid="ignore"):
        squares = ((piece - centre) * root) ** 2
    squares = np.ascontiguousarray(squares if whole else np.where(kept, squares, 0.0))
    powers = np.stack([squares.sum(axis=1), (squares**2).sum(axis=1), (squares**3).sum(axis=1)], axis=1)
    return SecondSums(centre=centre, scale=root, powers=powers, largest=float(squares.max(initial=0.0)))


def merge_second(one: SecondSums, other: SecondSums) -> SecondSums:
    """Both together, of one centre and scale."""
    return SecondSums(
        centre=one.centre,
        scale=one.scale,
        powers=one.powers + other.powers,
        largest=max(one.largest, other.largest),
    )


def finish(first: FirstSums, second: SecondSums) -> Moments:
    """The moments that the sums of both passes give."""
    counts, total = first.counts, float(first.counts.sum())
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        means = first.sums / counts
        # Each replicate about its own mean: a common offset of the replicates is not scatter of the quantity.
        offsets = ((means - second.centre) * second.scale) ** 2
        deviations = np.sqrt(np.maximum(second.powers[:, 0] / counts - offsets, 0.0)) / second.scale
        one, two, three = (float(x) for x in second.powers.sum(axis=0) / total)
        deviation = math.sqrt(one) / second.scale if one >= 0.0 else math.nan
    spread = two - one * one
    bent = (three - 3.0 * one * two + 2.0 * one**3) / spread**1.5 if spread > 1e-12 * two else 0.0
    return Moments(
        means=means,
        mean=second.centre,
        deviations=deviations,
        deviation=deviation,
        largest_share=second.largest / (one * total) if one > 0.0 else 0.0,
        skewness=bent,
    )


def skewness(values: Array) -> float:
    """Third moment of values (R,) about their mean over their deviation to the third power; 0 if they agree."""
    rest = values - values.mean()
    scale = float(np.abs(rest).max(initial=0.0))
    if not 0.0 < scale < math.inf:
        return 0.0
    rest = rest / scale
    return float(np.mean(rest**3) / np.mean(rest**2) ** 1.5)
