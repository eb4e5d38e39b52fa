"""From samples to an expansion, and whether it may be used."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.expansion.choice import Contest, Found, compete, lowered, prepare
from uqsphere.uq.expansion.expansion import Chaos, Piece, predict
from uqsphere.uq.expansion.germs import HIGHEST_DEGREE, GermLike, base_of, grown, products, rows_of, skipping
from uqsphere.uq.expansion.shares import SAMPLED, law_points
from uqsphere.uq.expansion.solvers import blended, leaned, neglected, refits, solve_rows, steadied
from uqsphere.uq.expansion.splits import Split, find_split

#: a K-fold error above this is not told from 1 by the best of a few dozen trials
_NOTHING: Final = 0.9
#: an output that leaves more than this is taken for a rough one
_ROUGH: Final = 2e-3
_SPLIT_HELPS: Final = 0.6
#: contenders that are looked at beyond the samples
_TRIED: Final = 5
#: share of the samples left out one by one in the error of two pieces: with a fifth fewer, border and terms are lost
_FEWER: Final = 0.5
#: terms beside those kept among which those that come next are looked for
_BESIDE: Final = 300
#: times what the folds move an expansion by under the law: more variance than that is not put down to it
_WILD: Final = 100.0


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Whether a surrogate may be used: its error (mean square over variance), and why or why not."""

    usable: bool
    error: float
    reason: str


def fit_chaos(
    points: Array, outputs: Array, germs: Sequence[GermLike], *, plain: bool = False, most: float = 1.0,
    settled: bool = False,
) -> Chaos:  # fmt: skip
    """Sparse expansion of outputs (n,) at germ points (n, d).

    Solvers, degrees, norms and output transforms compete by K-fold error in the units of the output; an output that
    stays rough is tried in two pieces.  Never more terms than half the points, or than two thirds where a whole set of
    degrees is fitted.  A fit whose error reaches the
    variance is given up for the constant.  `plain`: the output itself is expanded, in one piece, so that its indices
    are those of the coefficients.  `most` is the largest error that may be used: a winner that leaves no more than
    that by K-fold and reports more, since it is wild beyond the samples, gives way to a contender, or to itself without
    its highest degrees, that reports no more.  Raises ValueError for values that are not finite and for shapes that do
    not go together.

    >>> import numpy as np
    >>> x = np.random.default_rng(1).uniform(-1.0, 1.0, (60, 2))
    >>> chaos = fit_chaos(x, 1.0 + x[:, 0] * x[:, 1] ** 2, ("uniform", "uniform"))
    >>> float(predict(chaos, np.array([[0.5, 0.5]]))[0].round(12))
    1.125
    """
    outputs = np.asarray(outputs, dtype=float)
    columns = outputs[:, None] if outputs.ndim == 1 else outputs
    return fit_outputs(points, columns, germs, plain=plain, most=most, settled=settled)[0]


def fit_again(chaos: Chaos, points: Array, outputs: Array) -> Chaos:
    """The terms of a plain expansion with coefficients from other samples of the same output, (n, d) and (n,).

    Raises ValueError for an expansion that is not plain, and for fewer samples than terms.
    """
    if not chaos.plain:
        raise ValueError("only an expansion of the output itself, in one piece, is fitted again")
    piece = chaos.pieces[0]
    points, outputs = np.asarray(points, dtype=float), np.asarray(outputs, dtype=float)
    if len(outputs) < len(piece.coefficients):
        raise ValueError(f"{len(piece.coefficients)} terms need as many samples, found {len(outputs)}")
    unit = float(np.abs(outputs).max()) or 1.0
    coefficients = solve_rows(rows_of(chaos.germs, points, piece.multi_indices), outputs / unit) * unit
    return replace(chaos, pieces=(replace(piece, coefficients=coefficients),), samples=outputs.size)


def fit_outputs(
    points: Array, outputs: Array, germs: Sequence[GermLike], *, plain: bool = False, most: float = 1.0,
    settled: bool = False,
) -> list[Chaos]:  # fmt: skip
    """Expansions of each column of outputs (n, m) at the same germ points (n, d), which share their bases.

    A germ that is a law of its own competes with the one known by name that its points are in, for all such inputs
    together, unless the germs are `settled`.
    """
    points, outputs = np.asarray(points, dtype=float), np.asarray(outputs, dtype=float)
    n = outputs.shape[0]
    if points.ndim != 2 or outputs.ndim != 2 or points.shape != (n, len(germs)) or n < 4:
        raise ValueError(f"need points (n, {len(germs)}) and outputs (n,), n >= 4; found {points.shape}, {n}")
    if not (np.isfinite(outputs).all() and np.isfinite(points).all()):
        raise ValueError("a polynomial chaos cannot be fitted to values that are not finite")
    kinds: list[tuple[GermLike, ...]] = [] if settled else [tuple(base_of(germ) for germ in germs)]
    contests = [prepare(points, one) for one in dict.fromkeys([*kinds, tuple(germs)]) if germs]
    law = law_points(germs, 0)[0][:SAMPLED] if germs else points
    return [_fitted(contests, points, column, tuple(germs), plain, law, most) for column in outputs.T]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Candidate:
    """An expansion with its K-fold error, what it varies too much (`_excess`), and the error that it reports."""

    chaos: Chaos
    folded: float
    excess: float
    reported: float


def _unit(largest: float) -> float:
    """What outputs are divided by: a power of two loses no figures, and squares stay finite."""
    return 2.0 ** math.frexp(largest)[1] if 0.0 < largest < 2.0**1000 else max(largest, 1e-300)


def _fitted(
    contests: Sequence[Contest], points: Array, outputs: Array, germs: tuple[GermLike, ...], plain: bool, law: Array,
    most: float,
) -> Chaos:  # fmt: skip
    largest = float(np.abs(outputs).max())
    unit = _unit(largest)
    scaled = outputs / unit
    centre, scale = float(scaled.mean()), float(scaled.std())
    if not contests or scale <= 1e-14 * abs(centre):
        error = 0.0 if contests else 1.0
        return _constant(centre * unit, germs, error, outputs.size)
    leaders = compete(contests, scaled, plain=plain)
    error = leaders[0].error if leaders else 1.0
    split = None if plain else _split(leaders[0].contest if leaders else contests[0], error, points, scaled)
    candidates = _candidates(leaders, split, points, scaled, unit, law)
    best, tried = _best(candidates, _constant(centre * unit, germs, 1.0, outputs.size))
    if leaders and error <= most < best.cross_validation_error:
        lower = (_whole(found, scaled, unit, law) for found in lowered(leaders[0], scaled))
        calm = [one for one in chain(tried, candidates, lower) if one.reported <= most]
        if calm:  # the least of their errors is a lucky one: the largest is taken
            one = max(calm, key=lambda one: one.reported)
            return replace(one.chaos, cross_validation_error=one.reported)
    return best


def _best(candidates: Iterator[_Candidate], constant: Chaos) -> tuple[Chaos, list[_Candidate]]:
    """The first candidate that no excess makes worse than its folds do, else the best of all; and those looked at."""
    best, least, tried = constant, 1.0, []
    for one in candidates:
        tried.append(one)
        believed = max(one.folded, one.excess)
        if believed < least:
            best, least = replace(one.chaos, cross_validation_error=min(one.reported, 1.0)), believed
            if believed == one.folded:
                break
    return best, tried


def _split(contest: Contest, error: float, points: Array, scaled: Array) -> Split | None:
    """Two pieces, where one leaves much and there are samples enough."""
    if error <= _ROUGH or scaled.size < max(48, 6 * (len(contest.germs) + 1)):
        return None
    return find_split(contest, points, scaled, below=_SPLIT_HELPS * min(error, 1.0))


def _candidates(
    leaders: Sequence[Found], split: Split | None, points: Array, scaled: Array, unit: float, law: Array
) -> Iterator[_Candidate]:
    """The split, if there is one, then the leaders in their order."""
    if split is not None:
        yield _in_two(split, points, scaled, unit, law)
    for found in leaders[: _TRIED - (split is not None)]:
        if not found.error < _NOTHING:
            break
        yield _whole(found, scaled, unit, law)


def _excess(values: Array, scaled: Array, loose: float) -> float:
    """How much more values of an expansion under the law vary than the samples (n,) allow, over their variance.

    What is wild in the tails, or at the edges, no sample left out will tell: folds do not lie beyond the samples.
    The variance of the samples is uncertain by their fourth moment; two standard errors are let pass.  Samples with
    heavy tails vary less than their law more often than that: an expansion that is the same without any of the folds
    is not wild.
    """
    z = (scaled - scaled.mean()) / scaled.std()
    allowed = 1.0 + 2.0 * math.sqrt(max(float(np.mean(z**4)) - 1.0, 0.0) / z.size)
    excess = float(np.mean((values - scaled.mean()) ** 2)) / float(np.var(scaled)) - allowed
    return min(excess, _WILD * loose)


def _constant(value: float, germs: tuple[GermLike, ...], error: float, samples: int) -> Chaos:
    piece = Piece(coefficients=np.array([value]), multi_indices=np.zeros((1, len(germs)), dtype=np.int64),
                  transform=None)  # fmt: skip
    return Chaos(pieces=(piece,), border=None, germs=germs, cross_validation_error=error, samples=samples,
                 solver="constant")  # fmt: skip


def _whole(found: Found, scaled: Array, unit: float, law: Array) -> _Candidate:
    """One expansion, of all samples in the terms that were found."""
    contest, transform = found.contest, found.transform
    germs = contest.germs
    order = np.argsort(found.indices.sum(axis=1) > 0, kind="stable")  # the constant first
    indices, rows = found.indices[order], found.rows[order]
    fits = refits(rows, transform.forward(scaled), contest.folds)
    there = rows_of(germs, law, indices)
    values = transform.back(fits.coefficients @ there)
    variance = float(np.var(scaled))
    moved = transform.back(fits.without @ there) - values
    shifts = (len(moved) - 1) * np.mean(moved**2, axis=1) / variance
    left_out = steadied((transform.back(fits.left_out) - scaled) ** 2) / variance
    chosen = np.mean(moved**2, axis=1) / variance
    if found.without:
        chosen = _chosen_without(found, scaled, law, values)
    near = grown(indices, np.abs(fits.coefficients), HIGHEST_DEGREE, len(indices) + _BESIDE)[len(indices) :]
    near = np.unique(np.concatenate([near, skipping(indices, HIGHEST_DEGREE)]), axis=0)
    coming = neglected(rows, transform.forward(scaled), products(contest.values, near))
    # what a small change of the transformed output is in the output itself, over the variance
    gain = float(np.mean(transform.slope(fits.coefficients @ there) ** 2)) / variance
    coefficients = fits.coefficients.copy()
    if transform.kind == "identity":
        coefficients *= transform.scale * unit
        coefficients[0] += transform.centre * unit
    piece = Piece(coefficients=coefficients, multi_indices=indices,
                  transform=None if transform.kind == "identity" else replace(transform, unit=unit))  # fmt: skip
    chaos = Chaos(pieces=(piece,), border=None, germs=germs, cross_validation_error=min(found.reported, 1.0),
                  samples=scaled.size, solver=found.solver)  # fmt: skip
    reported = leaned(blended(found.steady, left_out, steadied(shifts), steadied(chosen)), gain * coming.energy,
                      coming.share)  # fmt: skip
    excess = _excess(values, scaled, float(np.mean(shifts)))
    return _Candidate(chaos=chaos, folded=found.reported, excess=excess, reported=max(reported, excess))


def _chosen_without(found: Found, scaled: Array, law: Array, values: Array) -> Array:
    """Mean squares (K,) between the values under the law and expansions whose terms were chosen without each fold."""
    contest, germs = found.contest, found.contest.germs
    every, places = np.unique(np.concatenate(found.without), axis=0, return_inverse=True)
    law, values = law[: SAMPLED // 2], values[: SAMPLED // 2]
    here = products(contest.values, every)
    there = rows_of(germs, law, every)
    outputs, begin, answer = found.transform.forward(scaled), 0, []
    for fold, indices in enumerate(found.without):
        own = places.ravel()[begin : begin + len(indices)]
        begin += len(indices)
        seen = contest.folds != fold
        coefficients = solve_rows(here[np.ix_(own, seen)], outputs[seen])
        moved = found.transform.back(coefficients @ there[own]) - values
        answer.append(float(np.mean(moved**2)) / float(np.var(scaled)))
    return np.array(answer)


def _in_two(split: Split, points: Array, scaled: Array, unit: float, law: Array) -> _Candidate:
    """Two expansions and their border, which the K-fold error finds anew."""
    pieces = tuple(
        Piece(coefficients=coefficients * unit, multi_indices=indices, transform=None)
        for indices, coefficients in split.pieces
    )
    chaos = Chaos(pieces=pieces, border=split.border, germs=split.contest.germs, cross_validation_error=split.error,
                  samples=scaled.size, solver=f"two pieces: {split.proposal}")  # fmt: skip
    loose = steadied(_shifts(split, points, scaled, law))
    excess = _excess(predict(chaos, law) / unit, scaled, 1.0)
    reported = max(blended(split.steady, split.left_out, loose, share=_FEWER), excess)
    return _Candidate(chaos=chaos, folded=split.error, excess=excess, reported=reported)


def _shifts(split: Split, points: Array, scaled: Array, law: Array) -> Array:
    """What each fold (K,) moves the two pieces by under the law of the inputs, their terms as they are.

    A piece goes on beyond its own samples, and where it wins there the folds show how much is made up.
    """
    contest, germs = split.contest, split.contest.germs
    count = int(contest.folds.max()) + 1
    rows = [rows_of(germs, points, indices) for indices, _ in split.pieces]
    ends = [coefficients @ own for (_, coefficients), own in zip(split.pieces, rows, strict=True)]
    side = split.border.side(points, ends)
    lines = []
    for (indices, coefficients), own, part in zip(split.pieces, rows, (~side, side), strict=True):
        several = np.tile(coefficients, (count + 1, 1))
        if own.shape[0] <= int(part.sum()):
            fits = refits(own[:, part], scaled[part], contest.folds[part])
            several = np.tile(fits.coefficients, (count + 1, 1))
            several[1 : 1 + len(fits.without)] = fits.without
        lines.append(several @ rows_of(germs, law, indices))
    values = np.array([np.where(split.border.side(law, pair), pair[1], pair[0]) for pair in zip(*lines, strict=True)])
    moved = values[1:] - values[0]
    return np.asarray((count - 1) * np.mean(moved**2, axis=1) / float(np.var(scaled)))


def validation_error(chaos: Chaos, points: Array, outputs: Array) -> float:
    """1 - Q²: mean square error on held-out germ points (n, d) over the variance of their outputs (n,).

    Not clipped: above 1 the expansion is worse than a constant (`judge` refuses it).
    """
    outputs = np.asarray(outputs, dtype=float)
    unit = float(np.abs(outputs).max(initial=0.0)) or 1.0
    variance = float(np.var(outputs / unit))
    residual = float(np.mean((outputs / unit - predict(chaos, points) / unit) ** 2))
    if variance == 0.0:
        return 0.0 if residual <= 1e-24 else math.inf
    return residual / variance


def judge(chaos: Chaos, error: float | None = None, most: float = 0.05) -> Verdict:
    """Whether the expansion may be used: its error is at most `most`.

    `error` was found on at least as many samples as the expansion has, none of which it has seen: it counts in place
    of what the expansion reports of itself, which supposes the worst of tails that these samples reach.
    """
    worst = chaos.cross_validation_error if error is None else error
    if not math.isfinite(worst):
        return Verdict(usable=False, error=1.0, reason="the error of the expansion is not finite")
    terms = f"{chaos.size} from {chaos.samples} samples"
    if worst > most:
        reason = f"refused: it leaves {worst:.2g} of the variance unexplained, more than {most:g} ({terms})"
        return Verdict(usable=False, error=min(worst, 1.0), reason=reason)
    return Verdict(usable=True, error=worst, reason=f"it leaves {worst:.2g} of the variance ({terms})")
