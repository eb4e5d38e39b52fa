"""Two expansions in place of one, for outputs with a kink or a jump.

Proposals: a cut across the input along which two planes fit best; a score that tells the two groups of a gapped
output apart; and the larger or the smaller of two functions, found by turns – which one holds where, and what they
are (Magnani and Boyd 2009).  Every proposal is made anew without each fold and predicts it, border and all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.uq.expansion.choice import Contest, deal
from uqsphere.uq.expansion.expansion import Border, Side, score_features
from uqsphere.uq.expansion.germs import Indices, products
from uqsphere.uq.expansion.solvers import Task, forward_selection, left_one_out, solve_rows, steadied

Samples: TypeAlias = npt.NDArray[np.intp]

_LEAST_SHARE: Final = 0.08  # of the samples on either side
_TURNS: Final = 12
_MOST_TERMS: Final = 80
_MOST_CANDIDATES: Final = 600


@dataclass(frozen=True, kw_only=True, eq=False)
class Split:
    """Two expansions (multi-indices, coefficients) with their border and their K-fold error.

    `steady` is that error without what a single fold decides, `left_out` that of samples left out of the coefficients
    alone, of the piece that holds them.
    """

    contest: Contest
    pieces: tuple[tuple[Indices, Array], tuple[Indices, Array]]
    border: Border
    error: float
    steady: float
    left_out: float
    proposal: str


@dataclass(frozen=True, kw_only=True, eq=False)
class _Data:
    """All samples: germ points (n, d), outputs (n,), and the contest at these points."""

    points: Array
    outputs: Array
    contest: Contest


#: a basis and how many of its terms, among which the terms of a piece are chosen
Trial: TypeAlias = tuple[int, int]
Trials: TypeAlias = tuple[Trial | None, Trial | None]
#: two expansions, each with its multi-indices and coefficients, and their border
Halves: TypeAlias = tuple[tuple[tuple[Indices, Array], tuple[Indices, Array]], Border]
#: points, outputs and, if there is one, the side that each was on when all were seen -> where the second piece holds,
#: and the border; the hint spares the turns a bad start, and nothing else is taken from it
Proposal: TypeAlias = Callable[[Array, Array, Side | None], tuple[Side, Border] | None]


def _planes(points: Array, outputs: Array, side: Side) -> tuple[Array, Array]:
    """Values (n,) everywhere of the planes through the samples on either side."""
    features = score_features(points, points.shape[1] + 1)
    found = []
    for part in (~side, side):
        rows = features[part]
        gram = rows.T @ rows + 1e-8 * max(len(rows), 1) * np.eye(features.shape[1])
        found.append(features @ np.linalg.solve(gram, rows.T @ outputs[part]))
    return found[0], found[1]


def _balanced(side: Side) -> bool:
    return bool(_LEAST_SHARE <= side.mean() <= 1.0 - _LEAST_SHARE)


def _left_by_cuts(points: Array, outputs: Array, axes: Samples, places: Array) -> Array:
    """Mean squares (t,) left by planes on either side of cuts across inputs axes (t,) at places (t,); inf where few."""
    n, d = points.shape
    features = score_features(points, d + 1)
    above = np.greater(points[:, axes].T, places[:, None])
    pairs = (features[:, :, None] * features[:, None, :]).reshape(n, -1)
    aims = features * outputs[:, None]
    predicted = np.zeros(above.shape)
    for side in (above, ~above):
        inside = side.astype(float)
        counts = np.maximum(inside.sum(axis=1), 1.0)[:, None, None]
        grams = (inside @ pairs).reshape(-1, d + 1, d + 1) + 1e-8 * counts * np.eye(d + 1)
        planes = np.linalg.solve(grams, (inside @ aims)[:, :, None])[:, :, 0]
        predicted += inside * (planes @ features.T)
    left = np.mean((predicted - outputs) ** 2, axis=1)
    share = above.mean(axis=1)
    return np.where((share >= _LEAST_SHARE) & (share <= 1.0 - _LEAST_SHARE), left, np.inf)


def _cut(points: Array, outputs: Array, hint: Side | None) -> tuple[Side, Border] | None:
    """The cut across one input that leaves the least to two planes: of nine for each input, and of those near it.

    It lies in the middle between two neighbouring samples.
    """
    d = points.shape[1]
    levels = np.linspace(0.1, 0.9, 9)
    places = np.quantile(points, levels, axis=0).T.ravel()
    axes = np.repeat(np.arange(d), levels.size)
    best = int(np.argmin(_left_by_cuts(points, outputs, axes, places)))
    axis = int(axes[best])
    ordered = np.sort(points[:, axis])
    middles = 0.5 * (ordered[1:] + ordered[:-1])
    place = int(np.searchsorted(middles, places[best]))
    reach = max(len(ordered) // 12, 2)
    near = middles[max(place - reach, 0) : place + reach + 1]
    left = _left_by_cuts(points, outputs, np.full(near.size, axis), near)
    best = int(np.argmin(left))
    if not np.isfinite(left[best]):
        return None
    at = float(near[best])
    return points[:, axis] > at, Border(kind="axis", axis=axis, at=at)


def _gap(points: Array, outputs: Array, hint: Side | None) -> tuple[Side, Border] | None:
    """Two groups of outputs with a gap between them, told apart by a logistic score of the inputs."""
    ordered = np.sort(outputs)
    n = ordered.size
    first, last = int(_LEAST_SHARE * n), int((1.0 - _LEAST_SHARE) * n)
    gaps = ordered[first + 1 : last + 1] - ordered[first:last]
    place = first + int(np.argmax(gaps))
    # A gap where outputs lie dense is one of many, and no border.
    if ordered[place + 1] - ordered[place] < 8.0 * (ordered[-1] - ordered[0]) / n:
        return None
    side = outputs > 0.5 * (ordered[place] + ordered[place + 1])
    d = points.shape[1]
    quadratic = (d + 1) * (d + 2) // 2
    best: tuple[float, Array] | None = None
    folds = deal(n, 5)
    for count in (d + 1, quadratic):
        if 4 * count > n:
            continue
        features = score_features(points, count)
        wrong = 0.0
        for fold in range(5):
            weights = _logistic(features[folds != fold], side[folds != fold])
            wrong += float(np.sum((features[folds == fold] @ weights > 0.0) != side[folds == fold]))
        if best is None or wrong < best[0]:
            best = (wrong, _logistic(features, side))
    return None if best is None else (side, Border(kind="score", weights=best[1]))


def _logistic(features: Array, side: Side) -> Array:
    """Weights of a logistic regression with a slight penalty, by Newton's steps."""
    weights = np.zeros(features.shape[1])
    penalty = 1e-2 * np.eye(features.shape[1])
    for _ in range(25):
        chance = 1.0 / (1.0 + np.exp(-np.clip(features @ weights, -30.0, 30.0)))
        slope = features.T @ (chance - side) + penalty @ weights
        curvature = (features.T * (chance * (1.0 - chance))) @ features + penalty
        step = np.linalg.solve(curvature, slope)
        weights -= step
        if float(np.abs(step).max()) < 1e-6:
            break
    return weights


def _crossing(kind: str) -> Proposal:
    sign = 1.0 if kind == "upper" else -1.0

    def propose(points: Array, outputs: Array, hint: Side | None) -> tuple[Side, Border] | None:
        """The larger (smaller) of two planes, from cuts across the inputs that matter, by turns."""
        centred = points - points.mean(axis=0)
        slopes = centred.T @ (outputs - outputs.mean()) / np.maximum(np.sum(centred**2, axis=0), 1e-300)
        directions = [centred @ slopes, *(centred[:, j] for j in np.argsort(-np.abs(slopes))[:3])]
        best: tuple[float, Side] | None = None
        starts = [along > np.median(along) for along in directions]
        for side in starts if hint is None else [hint, *starts]:
            for _ in range(_TURNS):
                low, high = _planes(points, outputs, side)
                new = sign * (high - low) > 0.0
                if not _balanced(new) or bool(np.all(new == side)):
                    break
                side = new
            low, high = _planes(points, outputs, side)
            left = float(np.mean((np.where(side, high, low) - outputs) ** 2))
            if _balanced(side) and (best is None or left < best[0]):
                best = (left, side)
        return None if best is None else (best[1], Border(kind=kind))

    return propose


#: name -> proposal
PROPOSALS: Final[dict[str, Proposal]] = {
    "cut": _cut,
    "gap": _gap,
    "upper": _crossing("upper"),
    "lower": _crossing("lower"),
}


def _piece(data: _Data, samples: Samples, trial: Trial | None = None) -> tuple[tuple[Indices, Array], Trial | None]:
    """Sparse expansion of some of the samples, and on what: a trial given, or the best by their own K-fold error."""
    outputs = data.outputs[samples]
    scale = float(outputs.std())
    zero = np.zeros((1, data.points.shape[1]), dtype=np.int64)
    if scale <= 1e-12 * float(np.abs(outputs).max(initial=0.0)) or samples.size < 8:
        return (zero, np.array([float(outputs.mean())])), trial
    centre = float(outputs.mean())
    values = (outputs - centre) / scale
    folds = deal(samples.size, 5)
    best, chosen = (1.0, zero, np.zeros(1)), trial
    for which, size in _trials(data, samples.size) if trial is None else [trial]:
        indices, rows, _ = data.contest.bases[which]
        basis = np.ascontiguousarray(rows[:size][:, samples])
        task = Task(basis=basis, values=values, folds=folds, most=max(min(samples.size // 3, _MOST_TERMS), 1),
                    error=lambda predicted: float(np.vecdot(off := predicted - values, off)) / values.size)  # fmt: skip
        active, error = forward_selection(task).best()
        if error < best[0]:
            best, chosen = (error, indices[active], solve_rows(basis[active], values)), (which, size)
    coefficients = best[2] * scale
    coefficients[0] += centre
    return (best[1], coefficients), chosen


def _trials(data: _Data, count: int) -> list[Trial]:
    """The two largest sets of each of two bases that are not too large for the samples."""
    answer = []
    for which, (_, _, sizes) in enumerate(data.contest.bases[:2]):
        answer += [(which, s) for s in sizes if s <= max(min(2 * count, _MOST_CANDIDATES), sizes[0])][-2:]
    return answer


def _values(data: _Data, piece: tuple[Indices, Array]) -> Array:
    """Values (n,) of a piece at all samples."""
    return np.asarray(piece[1] @ _rows(data, piece[0]))


def _rows(data: _Data, indices: Indices) -> Array:
    """Rows (k, n) of some terms at all samples."""
    return products(data.contest.values, indices)


def _build(
    data: _Data, seen: Samples, propose: Proposal, hint: Side | None = None, trials: Trials = (None, None)
) -> tuple[Halves, Trials] | None:
    """A proposal from the samples seen, with its two pieces; those that cross are refined by two more turns.

    `trials` are the sets that the pieces are chosen from, found here where they are not given.
    """
    points = data.points[seen]
    found = propose(points, data.outputs[seen], None if hint is None else hint[seen])
    if found is None or not _balanced(found[0]):
        return None
    side, border = found
    one, other = _piece(data, seen[~side], trials[0]), _piece(data, seen[side], trials[1])
    for _ in range(2 if border.kind in ("upper", "lower") else 0):
        low, high = (_values(data, piece)[seen] for piece in (one[0], other[0]))
        new = border.side(points, [low, high])
        if not _balanced(new) or bool(np.all(new == side)):
            break
        side = new
        one, other = _piece(data, seen[~side], one[1]), _piece(data, seen[side], other[1])
    pieces = one[0], other[0]
    if border.kind in ("upper", "lower"):
        pieces = _settled(data, seen, pieces, border, side)
    return (pieces, border), (one[1], other[1])


def _settled(
    data: _Data, seen: Samples, pieces: tuple[tuple[Indices, Array], tuple[Indices, Array]], border: Border, side: Side
) -> tuple[tuple[Indices, Array], tuple[Indices, Array]]:
    """Pieces that cross, fitted again in their terms to the samples where each holds, until these stay the same.

    A piece that was fitted to samples of the other bends to them.
    """
    rows = [_rows(data, indices)[:, seen] for indices, _ in pieces]
    for _ in range(_TURNS):
        new = border.side(data.points[seen], [piece[1] @ own for piece, own in zip(pieces, rows, strict=True)])
        enough = all(len(own) <= 0.5 * part.sum() for own, part in zip(rows, (~new, new), strict=True))
        if not enough or not _balanced(new) or bool(np.all(new == side)):
            break
        side = new
        fitted = [solve_rows(own[:, part], data.outputs[seen[part]])
                  for own, part in zip(rows, (~side, side), strict=True)]  # fmt: skip
        pieces = (pieces[0][0], fitted[0]), (pieces[1][0], fitted[1])
    return pieces


def _doubt(data: _Data, whole: Halves) -> float:
    """What it costs that samples leave the place of the border open: a share of a sample on the wrong side.

    A cut lies anywhere between two samples: a quarter of what is between them is lost in the mean.  Of a score, the
    few samples that were found on the wrong side say little: none of n leaves up to 3/n (Hanley and Lippman-Hand
    1983).  The jump is taken where it matters, among the tenth of the samples nearest to the border.
    """
    pieces, border = whole
    if border.kind in ("upper", "lower"):
        return 0.0
    low, high = (_values(data, piece) for piece in pieces)
    near = np.argsort(border.distance(data.points))[: max(len(low) // 10, 2)]
    return (0.5 if border.kind == "axis" else 3.0) * float(np.mean((high - low)[near] ** 2))


def _moved(data: _Data, seen: Samples, border: Border, whole: Border) -> Border:
    """The cut that all samples gave, where that of the samples seen is the same as far as they can tell.

    What its place is uncertain by is counted by `_doubt`: a sample left out would count it as a whole sample.
    """
    if border.kind != "axis" or whole.kind != "axis" or border.axis != whole.axis:
        return border
    low, high = sorted((border.at, whole.at))
    column = data.points[seen, border.axis]
    return whole if int(np.sum((column > low) & (column <= high))) <= 1 else border


def _left_out(data: _Data, unseen: Side, propose: Proposal, side: Side, border: Border, trials: Trials) -> float:
    """Sum of squares left on the samples unseen by a proposal made anew without them; inf where there is none."""
    seen = np.flatnonzero(~unseen)
    made = _build(data, seen, propose, side, trials)
    if made is None:
        return float(np.inf)
    part, _ = made
    values = [_values(data, piece)[unseen] for piece in part[0]]
    there = _moved(data, seen, part[1], border).side(data.points[unseen], values)
    return float(np.sum((np.where(there, values[1], values[0]) - data.outputs[unseen]) ** 2))


def _one_left_out(data: _Data, pieces: Sequence[tuple[Indices, Array]], side: Side) -> float:
    """Sum of squares of what each sample differs from its piece, fitted without it in the same terms."""
    total = 0.0
    for (indices, coefficients), part in zip(pieces, (~side, side), strict=True):
        rows = _rows(data, indices)[:, part]
        if rows.shape[0] >= rows.shape[1]:
            total += float(np.sum((data.outputs[part] - coefficients @ rows) ** 2))
            continue
        total += float(np.sum((left_one_out(rows, data.outputs[part]) - data.outputs[part]) ** 2))
    return total


def find_split(contest: Contest, points: Array, outputs: Array, *, below: float) -> Split | None:
    """The proposal with the least K-fold error, over the variance of outputs (n,), if it is less than `below`.

    `points` (n, d) are those of the contest.  A proposal that its first fold shows to be hopeless is dropped.
    """
    data = _Data(points=points, outputs=outputs, contest=contest)
    variance = float(np.var(outputs))
    count = int(contest.folds.max()) + 1
    folds = contest.folds if count == 5 else deal(outputs.size, 5)
    best: Split | None = None
    for name, propose in PROPOSALS.items():
        made = _build(data, np.arange(outputs.size), propose)
        if made is None:
            continue
        whole, trials = made
        limit = (below if best is None else best.error) * variance * outputs.size
        values = [_values(data, piece) for piece in whole[0]]
        side = whole[1].side(points, values)
        at_hand = float(np.sum((np.where(side, values[1], values[0]) - outputs) ** 2))
        doubt = _doubt(data, whole)
        # What does not even describe the samples at hand will not foretell others.
        if at_hand + doubt >= limit:
            continue
        left, lost = doubt, []
        for fold in range(5):
            lost.append(_left_out(data, folds == fold, propose, side, whole[1], trials))
            left += lost[-1]
            if left >= limit:
                break
        if left < limit:
            total = variance * outputs.size
            one_by_one = _one_left_out(data, whole[0], side) + doubt
            best = Split(
                contest=contest, pieces=whole[0], border=whole[1], error=left / total, left_out=one_by_one / total,
                proposal=name, steady=(5.0 * steadied(np.array(lost)) + doubt) / total,
            )  # fmt: skip
    return best
