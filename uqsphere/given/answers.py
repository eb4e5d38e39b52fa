"""Answers from runs that were made already: a surrogate fitted to them, and what they leave open of the inputs' laws.

Two errors stand apart.  What the surrogate lacks beside the model is held by runs that it was not fitted to, as for an
expensive model (`response`): nothing there needs more than that the runs follow the laws.  What the runs leave open of
the laws, their family and their dependence, is found by asking the surrogate again under other laws that the runs
allow, at the same Sobol' points, so that the difference is that of the laws.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from typing import Final

import numpy as np
from scipy.special import expit, logit, ndtri

from uqsphere.arrays import Array, Places
from uqsphere.uq import NORMAL, Estimate, Law, LawError, absent, random_generator, sobol_points
from uqsphere.uq.copulas import ARCHIMEDEAN, Archimedean, Elliptical
from uqsphere.uq.estimate import REPLICATES
from uqsphere.uq.expansion import germ_points
from uqsphere.uq.indices import Blocks
from uqsphere.uq.joint import (
    Dependence,
    Group,
    Joint,
    correlation_from_spearman,
    independent_scores,
    make_copula,
    make_joint,
)
from uqsphere.uq.response import METHOD, Response, answered, index_shares, share_of_noise
from uqsphere.uq.shapley import BLOCK, MOST_EXACT, orders_of, shapley_estimates, subset_design, subset_scores
from uqsphere.uq.surrogate import FARTHEST, scores_of

# --- How far an answer reaches under other laws than the fitted ones, from the steps that it takes to each of them.

#: 95 % of what the other laws move an answer by, which is known from some dozens of them
_OPEN: Final = 2.0
#: logarithm of a factor beyond which steps are counted
_FACTORS: Final = 2.0
#: laws of a copula from which on their mean is known well enough: an eighth of all
_SEVERAL: Final = 8


def reach(answer: float, moved: Array, value: float, way: str) -> tuple[float, float]:
    """How far below and above an answer the other laws reach, from its values (K,) under them and the one without.

    By `way`: "steps" of the answer itself, "factors" of a standard deviation, "shares" of the variance by their logit,
    so that more is left open above a small one than below, "squares" by the arcsine of the root: the first index of
    an input that depends on others is the square of a correlation, which may be none.
    """
    steps = moved - value
    unit = float(np.abs(steps).max()) or 1.0
    plain = _OPEN * unit * math.sqrt(float(np.mean((steps / unit) ** 2)))
    ways: dict[str, tuple[Callable[..., Array], Callable[..., Array]]] = {
        "squares": (lambda share: np.arcsin(np.sqrt(np.clip(share, 0.0, 1.0))), _share),
        "factors": (np.log, np.exp),
        "shares": (logit, expit),
    }
    if way not in ways:
        return plain, plain
    there, back = ways[way]
    with np.errstate(invalid="ignore", divide="ignore"):
        changes, centre = there(moved) - there(value), float(there(answer))
    half = _OPEN * float(np.sqrt(np.mean(changes**2)))
    if way == "squares":
        # a root has lost its sign: about a correlation near zero the laws lie on both sides of it
        above = max(float(_share(centre + half)) - answer, plain * (answer < 0.5))
        return max(answer - float(_share(centre - half)), 0.0), above
    # what is zero but for the noise of the design is no factor of anything
    if math.isfinite(centre) and half < _FACTORS:
        return answer - float(back(centre - half)), float(back(centre + half)) - answer
    return plain, plain


def spanned(steps: Array, copulas: Sequence[Hashable]) -> tuple[float, float] | None:
    """How far below and above steps (K,) reach under every copula that several of the laws have; None for one copula.

    Which copula is right is not drawn by chance: about the mean step of each the steps scatter as far as the laws do,
    and all these intervals are held.

    >>> spanned(np.array([1.0, -1.0] * 8 + [4.0, 2.0] * 8), ["gaussian"] * 16 + ["clayton"] * 16)
    (2.065591117977289, 5.065591117977289)
    """
    groups = [steps[[one == kind for one in copulas]] for kind in dict.fromkeys(copulas)]
    groups = [group for group in groups if group.size >= _SEVERAL]
    if len(groups) < 2:
        return None
    means = [float(group.mean()) for group in groups]
    squares = sum(float(((group - mean) ** 2).sum()) for group, mean in zip(groups, means, strict=True))
    half = _OPEN * math.sqrt(squares / (sum(group.size for group in groups) - len(groups)))
    return max(half - min(means), 0.0), max(half + max(means), 0.0)


def leaning(moved: Array, means: Array) -> tuple[float, float]:
    """What the interval of a quantile reaches further below and above than by steps, the fitted laws' values first.

    Its distance from the mean moves by factors: where the runs show too little of a tail, the interval would be short.
    """
    distance = moved - means
    with np.errstate(invalid="ignore", divide="ignore"):
        half = _OPEN * float(np.sqrt(np.mean(np.log(distance[1:] / distance[0]) ** 2)))
    if not half < _FACTORS:
        return 0.0, 0.0
    size = abs(float(distance[0]))
    out, back = size * (math.expm1(half) - half), -size * (half + math.expm1(-half))
    return (out, back) if distance[0] < 0.0 else (back, out)


def _share(angle: float) -> Array:
    return np.asarray(math.sin(min(max(angle, 0.0), 0.5 * math.pi)) ** 2)


#: laws that are tried in place of the fitted ones, and points of the design that they are tried on
LAWS: Final = 64
_POINTS: Final = 512
#: points of each replicate of the large design that the surrogate is evaluated on
_LARGE: Final = 2048
#: rows of each replicate where inputs depend on each other, and base points at least and at most
_SHARED_ROWS: Final = 4096
_SHARED: Final = (64, 512)
#: scores at which a law is compared with another
_GRID: Final = np.linspace(-FARTHEST, FARTHEST, 321)

Answers = dict[str, dict[str, "Answer"]]


@dataclass(frozen=True, kw_only=True)
class Answer:
    """An answer under the fitted laws.

    `surrogate`: with an interval that holds what the surrogate lacks, the laws being as fitted.  `left_open`: how far
    the answer may be off on account of the laws, 0 where they are known.  `whole`: the interval that holds both.
    """

    surrogate: Estimate
    left_open: float
    whole: Estimate


@dataclass(frozen=True, kw_only=True, eq=False)
class LeftOpen:
    """Laws that the runs leave open: `tables` (laws, d, grid) by `score_table`, and the same inputs with their ties.

    `low`, `high` (d,) are the scores between which the runs lie: what the surrogate says beyond them, where wider laws
    would ask it, is not known, and it goes on there as it came (`_going_on`).
    """

    tables: Array
    inputs: tuple[Joint, ...]
    low: Array
    high: Array


def score_table(law: Law, others: Sequence[Law]) -> Array:
    """Scores (laws, grid) under other laws of the values that have the scores of a grid under `law`.

    A kernel density is followed by the shares of its observations, with the same bandwidth.
    """
    from uqsphere.uq.fitting import possible_tails

    x = law.from_normal(_GRID)
    if law.family.observed:
        generator = random_generator(seed=0, task=f"given: observations {len(law.data)} {law.data[0]!r}")
        return scores_of(*possible_tails(law, x, len(others), generator))
    return np.array([scores_of(other.cdf(x), other.sf(x)) for other in others])


def odd_pairs(inputs: Joint, scores: Array) -> list[tuple[str, str, str]]:
    """Pairs that their copula does not tie, by dependent scores (n, d): names and the copula that was taken.

    The squares of normal scores with correlation r have correlation r², and where the copula is another one, its
    Rosenblatt transform makes them independent; more than 3.5 standard errors from that is odd.
    """
    n = len(scores)
    found = []
    for columns, copula in inputs.blocks():
        for one, other in combinations(range(len(columns)), 2):
            if isinstance(copula, Elliptical) and copula.correlation[one, other] == 0.0:
                continue
            i, j = columns[one], columns[other]
            pair = scores[:, [i, j]]
            if isinstance(copula, Archimedean):
                pair = independent_scores(copula.among([one, other]), pair)
            a, b = (pair - pair.mean(axis=0)).T
            r = float(np.corrcoef(a, b)[0, 1])
            squares = float(np.corrcoef(a * a, b * b)[0, 1])
            if abs(squares - r * r) > 3.5 * math.sqrt((1.0 + 10.0 * r * r) / n):
                found.append((inputs.names[i], inputs.names[j], copula.label))
    return found


# --- the answers ----------------------------------------------------------------------------------------------


def given_answers(
    response: Response, inputs: Joint, left_open: LeftOpen | None, *, quantiles: Sequence[float], seed: int, task: str
) -> Answers:
    """{"statistics": {"mean", "sd", "0.05" ...}, "first": {input: ...}, ...} of a surrogate that may be used.

    `inputs` are the laws that its scores were taken by; `left_open` is None where they are known.  With dependent
    inputs there are "shapley", "first" and "total" (Kucherenko's) in place of Sobol' indices.
    """
    dependent = inputs.dependent
    moved = _moved(response, inputs, left_open, seed)
    under = () if left_open is None else left_open.inputs
    copulas = [tuple((group.members, group.copula.name) for group in one.groups) for one in under]
    answers = {"statistics": _statistics(response, inputs, moved, copulas, quantiles, seed, task)}
    if response.constant:
        nothing = absent("the output does not vary with the inputs, or the expansion is a constant", METHOD,
                         response.count)  # fmt: skip
        rows = ("shapley", "first", "total") if dependent else ("first", "total")
        none = Answer(surrogate=nothing, left_open=0.0, whole=nothing)
        return answers | {row: dict.fromkeys(inputs.names, none) for row in rows}
    if dependent:
        return answers | variance_shares(response, inputs, left_open, seed, task)
    return answers | _indices(response, inputs, moved)


def _moved(response: Response, inputs: Joint, left_open: LeftOpen | None, seed: int) -> list[Array]:
    """The surrogate (n, columns) under the laws as fitted, first, and under every other, at the same points.

    Of independent inputs the columns are those of `Blocks`, of dependent ones there is one.
    """
    if left_open is None:
        return []
    d, values = len(inputs.names), _surrogate(response, left_open)
    points, blocks = _drawn(2 * d, _POINTS, 0, "pairs", seed), Blocks(inputs_count=d)
    halves = points[:, :d], points[:, d:]
    tied = inputs.dependent
    found = []
    for which, under in ((-1, inputs), *enumerate(left_open.inputs)):
        scores = under.scores(np.concatenate(halves)) if tied else blocks.mix(*halves).reshape(-1, d)
        found.append(values(scores, which).reshape(-1, 1 if tied else d + 2))
    return found


def _surrogate(response: Response, left_open: LeftOpen | None) -> Callable[[Array, int | None], Array]:
    """The surrogate of dependent normal scores (n, d): of the fitted laws, or between the runs (-1), or of others."""

    def values(scores: Array, which: int | None) -> Array:
        points = np.clip(scores, -FARTHEST, FARTHEST)
        if which is None or left_open is None:
            return response.at(germ_points(points, response.germs))
        if which >= 0:
            tables = left_open.tables[which]
            points = np.column_stack([np.interp(z, table, _GRID) for z, table in zip(points.T, tables, strict=True)])
        return _going_on(response, germ_points(points, response.germs),
                         germ_points(np.stack([left_open.low, left_open.high]), response.germs))  # fmt: skip

    return values


def _going_on(response: Response, points: Array, ends: Array) -> Array:
    """The surrogate at germ points (n, d), mirrored where they lie beyond ends (2, d).

    A step e beyond an end b it is 2 S(b) - S(b - e): it goes on with the slope that it has between the runs, and is
    asked nowhere else.  Held at S(b) it would miss what wider laws do to the tails, which are what they change most.
    """
    inside = np.clip(points, ends[0], ends[1])
    beyond = np.clip(points - inside, -0.5 * (ends[1] - ends[0]), 0.5 * (ends[1] - ends[0]))
    values = response.at(inside)
    rows = np.flatnonzero(beyond.any(axis=1))
    if rows.size:
        values[rows] = 2.0 * values[rows] - response.at(inside[rows] - beyond[rows])
    return values


@lru_cache(maxsize=64)
def _drawn(dimension: int, count: int, replicate: int, what: str, seed: int) -> Array:
    """Independent normal scores (count, dimension) of one randomisation; the same for every output."""
    points = sobol_points(dimension=dimension, count=count, seed=seed, task=f"given: {what}", replicate=replicate)
    return np.asarray(ndtri(points))


def _answer(
    estimate: Estimate,
    moved: Sequence[float],
    value: float,
    within: tuple[float, float],
    *,
    way: str = "steps",
    lean: tuple[float, float] = (0.0, 0.0),
    copulas: Sequence[Hashable] = (),
) -> Answer:
    """An answer with what it moves by under the other laws, from the same points that gave `value`.

    `way` is that of `reach`; with `copulas`, those of the other laws, every copula that is left open is held by itself.
    `lean` is added below and above.
    """
    if estimate.value is None or estimate.low is None or estimate.high is None or not moved:
        return Answer(surrogate=estimate, left_open=0.0, whole=estimate)
    opened = reach(estimate.value, np.asarray(moved), value, way)
    if copulas:
        opened = spanned(np.asarray(moved) - value, copulas) or opened
    below, above = (max(half + more, 0.0) for half, more in zip(opened, lean, strict=True))
    low = estimate.value - math.hypot(estimate.value - estimate.low, below)
    high = estimate.value + math.hypot(estimate.high - estimate.value, above)
    low, high = min(max(low, within[0]), estimate.value), max(min(high, within[1]), estimate.value)
    # a share of the variance that is not told from none: fitted bounds leave such of what cancels under the law itself
    if way == "shares" and 0.0 < low < 1e-6:
        low = 0.0
    whole = estimate.spanning(low, high)
    return Answer(surrogate=estimate, left_open=max(below, above), whole=whole)


def _statistics(
    response: Response,
    inputs: Joint,
    moved: Sequence[Array],
    copulas: Sequence[Hashable],
    quantiles: Sequence[float],
    seed: int,
    task: str,
) -> dict[str, Answer]:
    d = len(inputs.names)
    large = np.concatenate([_drawn(d, _LARGE, replicate, "large", seed) for replicate in range(REPLICATES)])
    scores = np.clip(inputs.scores(large), -FARTHEST, FARTHEST)
    generator = random_generator(seed=seed, task=f"given: residuals {task}")
    points, shape = germ_points(scores, response.germs), (REPLICATES, _LARGE)
    middle = answered(response, points, shape, generator, quantiles).description

    def told_by(outputs: Array) -> list[float]:
        y = outputs[:, [0, -1]] if outputs.shape[1] > 1 else outputs
        unit = float(np.abs(y).max()) or 1.0
        low = np.quantile(y, list(quantiles), method="hazen").tolist() if quantiles else []
        return [float((y / unit).mean()) * unit, float((y / unit).std()) * unit, *low]

    rows = np.array([told_by(outputs) for outputs in moved])
    estimates = [("mean", middle.mean), ("sd", middle.sd), *((f"{p:g}", e) for p, e in middle.quantiles.items())]
    found = {}
    for k, (name, estimate) in enumerate(estimates):
        told_so = rows[1:, k].tolist() if rows.size else []
        value = rows[0, k] if rows.size else 0.0
        within, way = ((0.0, math.inf), "factors") if name == "sd" else ((-math.inf, math.inf), "steps")
        quantile = k > 1
        lean = leaning(rows[:, k], rows[:, 0]) if rows.size and quantile else (0.0, 0.0)
        kinds = copulas if quantile else ()
        found[name] = _answer(estimate, told_so, value, within, way=way, lean=lean, copulas=kinds)
    return found


def _indices(response: Response, inputs: Joint, moved: Sequence[Array]) -> Answers:
    d = len(inputs.names)
    rows = []
    for outputs in moved:  # by Saltelli's estimator (2010) and Jansen's (1999), off the columns of `Blocks`
        y = (outputs - outputs[:, 0].mean()) / (float(outputs[:, 0].std()) or 1.0)
        a, mixed, b = y[:, :1], y[:, 1 : d + 1], y[:, d + 1 :]
        variance = 0.5 * float(np.mean((a - b) ** 2)) or 1.0
        pair = np.array([np.mean(b * (mixed - a), axis=0), 0.5 * np.mean((a - mixed) ** 2, axis=0)])
        rows.append(pair / variance)
    found = index_shares(response)
    return {
        order: {
            name: _answer(estimate, [row[k][j] for row in rows[1:]], float(rows[0][k][j]) if rows else 0.0,
                          (0.0, 1.0), way="shares")
            for j, (name, estimate) in enumerate(zip(inputs.names, found[order], strict=True))
        }
        for k, order in enumerate(("first", "total"))
    }  # fmt: skip


def variance_shares(response: Response, inputs: Joint, left_open: LeftOpen | None, seed: int, task: str) -> Answers:
    """Shapley effects, and Kucherenko's first and total indices, of inputs that depend on each other."""
    d = len(inputs.names)
    values = _surrogate(response, left_open)
    design = subset_design(d, exact=d <= min(8, MOST_EXACT))
    name = f"given: subsets {task}"
    count = BLOCK * (min(max(_SHARED_ROWS // design.rows, _SHARED[0]), _SHARED[1]) // BLOCK)

    def asked(under: Joint, which: int | None, replicates: int) -> dict[str, list[Estimate]]:
        outputs, orders = [], []
        for replicate in range(replicates):
            scores = subset_scores(design, under, count=count, seed=seed, task=name, replicate=replicate)
            outputs.append(values(scores.reshape(-1, d), which).reshape(count, design.rows))
            orders.append(orders_of(design, count=count, seed=seed, task=name, replicate=replicate))
        # a single replicate has no interval, and is parted for its values, which pool the parts
        shape = (max(replicates, 2), -1)
        order = None if design.exact else np.stack(orders).reshape(*shape, d)
        return shapley_estimates(design, np.stack(outputs).reshape(*shape, design.rows), order)

    found = asked(inputs, None, REPLICATES)
    # all laws, since only together they scatter as they should; at the same few points, whose error all but cancels
    own = asked(inputs, -1, 1)
    rows = [asked(under, k, 1) for k, under in enumerate(left_open.inputs if left_open else ())]
    answer: Answers = {}
    for order, estimates in found.items():
        answer[order] = {}
        for j, (label, estimate) in enumerate(zip(inputs.names, estimates, strict=True)):
            told = share_of_noise(response, estimate)
            moved = [e for row in rows if (e := row[order][j].value) is not None]
            way = "squares" if order == "first" else "shares"
            answer[order][label] = _answer(told, moved, own[order][j].value or 0.0, (-1.0, 2.0), way=way)
    return answer


# --- What ties the inputs to each other, and what the runs leave open of that and of the laws --------------

#: copulas that two inputs, tied to no other, may have
CHOICES: Final = ("gaussian", "clayton", "gumbel", "frank")
#: logarithm of the likelihood by which another copula has to beat the Gaussian
_BETTER: Final = 2.0
#: the same, beyond which a copula is out of the question
_FAR: Final = 4.0
#: laws that each input is offered for the choice of those that belong together: of more, the chosen are liker
_OFFERED: Final = 400
#: runs of a rehearsal
_ROWS: Final = 1000


@dataclass(frozen=True, kw_only=True)
class TiedPair:
    """Two columns with Spearman's correlation, their copula, and the weights of those that the runs leave open."""

    columns: tuple[int, int]
    spearman: float
    copula: str
    weights: Mapping[str, float]


def rank_correlations(columns: Array) -> list[tuple[int, int, Estimate]]:
    """Spearman's rank correlation of every pair of columns (n, d), with Fisher's interval.

    The variance of artanh r is 1.06/(n - 3) (E. C. Fieller, H. O. Hartley, E. S. Pearson, Biometrika 44, 1957, 470).
    """
    from scipy.stats import rankdata

    n, d = columns.shape
    if n < 5:
        raise ValueError(f"a correlation takes 5 rows or more, found {n}")
    matrix = np.corrcoef(rankdata(columns, axis=0), rowvar=False).reshape(d, d)
    error = math.sqrt(1.06 / (n - 3))
    found = []
    for i, j in combinations(range(d), 2):
        value = float(np.clip(matrix[i, j], -1.0, 1.0))
        low, high = (math.tanh(_fisher(value) + side * NORMAL * error) for side in (-1.0, 1.0))
        found.append((i, j, Estimate(value=value, low=min(low, value), high=max(high, value),
                                     std_error=error * (1.0 - value**2), method="Spearman, Fisher's interval",
                                     evaluations=n)))  # fmt: skip
    return found


def _fisher(correlation: float) -> float:
    return math.atanh(min(max(correlation, -1.0 + 1e-15), 1.0 - 1e-15))


def tied(pairs: Sequence[tuple[int, int, Estimate]]) -> list[tuple[int, int, Estimate]]:
    """Pairs whose interval leaves out zero by so much that chance is no explanation among so many pairs."""
    factor = -float(ndtri(0.005 / max(1, len(pairs)))) / NORMAL

    def clear(e: Estimate) -> bool:
        if e.value is None or e.low is None or e.high is None:
            return False
        return abs(_fisher(e.value)) > factor * 0.5 * (_fisher(e.high) - _fisher(e.low))

    return [pair for pair in pairs if clear(pair[2])]


def ties_of(x: Array, pairs: Mapping[tuple[int, int], float]) -> tuple[TiedPair, ...]:
    """The copula of every pair of columns of x (n, d) that depend on each other, {(i, j): Spearman's correlation}.

    All copulas have one parameter, which the rank correlation settles, and are judged by the likelihood of the ranks
    (C. Genest, K. Ghoudi, L.-P. Rivest, Biometrika 82, 1995, 543).  Inputs of which one is tied to two others take the
    Gaussian copula together.
    """
    columns = [column for pair in pairs for column in pair]
    found = []
    for pair, value in pairs.items():
        kind, weights = "gaussian", {"gaussian": 1.0}
        if all(columns.count(column) == 1 for column in pair) and 0.0 < abs(value) < 0.99:
            kind, weights = _weights(x[:, list(pair)], value)
        found.append(TiedPair(columns=pair, spearman=value, copula=kind, weights=weights))
    return tuple(found)


def _weights(x: Array, spearman: float) -> tuple[str, dict[str, float]]:
    """The copula to take, the Gaussian where none is clearly better, and weights of all by their likelihood."""
    from scipy.stats import rankdata

    scores = np.asarray(ndtri(rankdata(x, method="ordinal", axis=0) / (len(x) + 1.0)))
    told = {}
    for kind in CHOICES:
        try:
            told[kind] = float(make_copula(kind, 2, spearman=spearman).log_density(scores).sum())
        except LawError:
            continue
    best = max(told, key=lambda kind: told[kind])
    weights = {kind: math.exp(value - told[best]) for kind, value in told.items() if value > told[best] - _FAR}
    whole = sum(weights.values())
    taken = best if told[best] - told["gaussian"] >= _BETTER else "gaussian"
    return taken, {kind: weight / whole for kind, weight in weights.items()}


def with_ties(names: Sequence[str], laws: Sequence[Law], ties: Sequence[TiedPair], every: Sequence[str]) -> Joint:
    """Inputs with their ties; `every` names the columns of the table.  Raises LawError where they cannot hold."""
    return make_joint(names, laws, [
        Dependence(of=tuple(every[k] for k in tie.columns), spearman=tie.spearman, copula=tie.copula) for tie in ties
    ])  # fmt: skip


# --- what is left open ------------------------------------------------------------------------------------------


def left_open(
    inputs: Joint,
    others: Sequence[Sequence[Law]],
    ties: Sequence[TiedPair],
    every: Sequence[str],
    scores: Array,
    n: int,
    generator: np.random.Generator,
) -> LeftOpen | None:
    """Laws and dependences that n runs leave open, in the form that the answers are asked in.

    Inputs that depend on each other were seen in the same runs: where the mean of one came out high, so did that of
    the other.  A rehearsal draws n runs of the inputs as they are taken to be; what these runs would make of means,
    standard deviations and rank correlations belongs together, and every law is given to the rehearsal that it fits.
    Rehearsals are few: they are turned and stretched until they have the covariance that n runs have (`_steadied`).
    """
    if not others:
        return None
    at = {name: k for k, name in enumerate(inputs.names)}
    pairs = [(at[every[tie.columns[0]]], at[every[tie.columns[1]]]) for tie in ties]
    tables = [score_table(law, open_[:_OFFERED]) for law, open_ in zip(inputs.laws, others, strict=True)]
    rows = min(n, _ROWS)
    drawn = inputs.scores(generator.standard_normal((LAWS * rows, len(inputs.names))))
    rehearsed = drawn.reshape(LAWS, rows, -1)
    ranked = []
    for pair in pairs:  # Fisher's transform of their rank correlations
        ranks = rehearsed[:, :, list(pair)].argsort(axis=1).argsort(axis=1).astype(float)
        ranks -= ranks.mean(axis=1, keepdims=True)
        found = (ranks[:, :, 0] * ranks[:, :, 1]).sum(axis=1) / (ranks[:, :, 0] ** 2).sum(axis=1)
        ranked.append(np.arctanh(np.clip(found, -0.9999, 0.9999)))
    told = np.column_stack([rehearsed.mean(axis=1), rehearsed.std(axis=1), *ranked])
    # of a standard deviation near 1, that of its square is twice its own
    squares = 0.5 * (drawn - drawn.mean(axis=0)) ** 2
    moves = np.column_stack([drawn, squares, *(rank_influence(drawn[:, list(pair)]) for pair in pairs)])
    asked, d = _steadied(told, moves, math.sqrt(rows / n), n), len(inputs.names)
    for k, table in enumerate(tables):
        tables[k] = table[_assigned(table, -asked[:, [k, d + k]])]
    moved = [inputs] * LAWS
    if pairs:
        opened = [_open(tie, shift, generator) for tie, shift in zip(ties, asked.T[2 * d :], strict=True)]
        moved = _tied_otherwise(inputs, opened, [(every[i], every[j]) for i, j in (tie.columns for tie in ties)])
    return LeftOpen(
        tables=np.stack(tables, axis=1), inputs=tuple(moved), low=scores.min(axis=0), high=scores.max(axis=0)
    )


def _steadied(told: Array, moves: Array, part: float, n: int) -> Array:
    """What rehearsals tell (K, m), with mean zero and the very covariance that n runs give it.

    Some dozens of rehearsals scatter and correlate by chance, which would be that of every analysis: answers that rest
    on one direction would have intervals that are always too short.  `moves` (rows, m) are the influences of single
    rows on what is told, whose covariance over n - 3 is due (that of Fisher's transform, and nearly of the others).
    Where K are too few for that many, they keep their correlations, times `part` for rehearsals of other than n rows.
    """
    centred = told - told.mean(axis=0)
    scatter, due = (np.atleast_2d(np.cov(columns, rowvar=False)) for columns in (centred, moves))
    due = due / max(n - 3, 1)
    correlations = [matrix / np.sqrt(np.outer(np.diag(matrix), np.diag(matrix))) for matrix in (scatter, due)]
    if min(float(np.linalg.eigvalsh(matrix)[0]) for matrix in correlations) <= 1e-9:
        return np.asarray(centred * part)
    # not the unbiased one: what is asked of the laws are means of squares over all K
    centred = centred * math.sqrt(len(told) / (len(told) - 1.0))
    return np.asarray(np.linalg.solve(np.linalg.cholesky(scatter), centred.T).T @ np.linalg.cholesky(due).T)


def _assigned(tables: Array, asked: Array) -> Places:
    """Which table (of M, grid) goes with which mean and width that is asked for (K, 2): the like of it, one each.

    Runs that came out low, or narrow, leave open a law that is higher, or wider.
    """
    from scipy.optimize import linear_sum_assignment

    grid, normal = np.linspace(-8.0, 8.0, tables.shape[1]), np.asarray(ndtri((np.arange(200) + 0.5) / 200.0))
    values = np.array([np.interp(normal, table, grid) for table in tables])
    offered = _whitened(np.column_stack([values.mean(axis=1), values.std(axis=1)]))
    distances = ((_whitened(asked)[:, None, :] - offered[None, :, :]) ** 2).sum(axis=2)
    return np.asarray(linear_sum_assignment(distances)[1], dtype=np.int64)


def _whitened(columns: Array) -> Array:
    """Columns (n, 2) with mean zero and variance one, the second without what it shares with the first."""
    centred = columns - columns.mean(axis=0)
    first = centred[:, 0] / max(float(centred[:, 0].std()), 1e-300)
    second = centred[:, 1] - first * float((first * centred[:, 1]).mean())
    return np.column_stack([first, second / max(float(second.std()), 1e-300)])


def rank_influence(pair: Array) -> Array:
    """What each row of a sample (n, 2) moves Fisher's transform of Spearman's correlation by, times n: (n,), mean 0.

    With u and v the shares of the sample below, the influence on the correlation r is 12 (u v + E[U; V > v] +
    E[V; U > u]) less its mean (C. Croux, C. Dehon, Statistical Methods & Applications 19, 2010, 497), on artanh r that
    over 1 - r².

    >>> rows = np.random.default_rng(1).standard_normal((4000, 2))
    >>> bool(abs(rank_influence(rows).std() - 1.0) < 0.03)
    True
    """
    n = len(pair)
    order = pair.argsort(axis=0)
    below = (order.argsort(axis=0) + 0.5) / n
    u, v = below.T

    def beyond(of: Array, along: Places) -> Array:
        sums, sorted_ = np.empty(n), of[along]
        sums[along] = (np.cumsum(sorted_[::-1])[::-1] - 0.5 * sorted_) / n
        return sums

    r = float(np.clip(12.0 * np.mean((u - 0.5) * (v - 0.5)), -0.9999, 0.9999))
    moved = 12.0 * (u * v + beyond(u, order[:, 1]) + beyond(v, order[:, 0]))
    return np.asarray((moved - moved.mean()) / (1.0 - r * r))


def _open(tie: TiedPair, shifts: Array, generator: np.random.Generator) -> list[tuple[float, Archimedean | None]]:
    """Spearman's correlation and copula that other runs would have shown, None for the Gaussian."""
    values = np.tanh(math.atanh(min(max(tie.spearman, -0.99), 0.99)) - shifts)
    kinds = list(tie.weights)
    drawn = generator.choice(len(kinds), size=len(values), p=list(tie.weights.values()))
    copulas: list[Archimedean | None] = [None] * len(values)
    said = [kinds[k] for k in drawn]
    for kind in set(said) - {"gaussian"}:
        # the Archimedean copulas have none of the other sign
        rows = [k for k, one in enumerate(said) if one == kind and values[k] * tie.spearman > 0.01]
        if rows:
            some = np.clip(values[rows], -0.985, 0.985)
            grid = np.linspace(float(some.min()), float(some.max()), 5 if np.ptp(some) > 1e-6 else 1)
            # strengths are expensive to solve for and smooth
            solved = [make_copula(kind, 2, spearman=float(value)) for value in grid]
            thetas = np.interp(some, grid, [one.theta for one in solved if isinstance(one, Archimedean)])
            for k, theta in zip(rows, thetas, strict=True):
                copulas[k] = Archimedean(generator=ARCHIMEDEAN[kind], size=2, theta=float(theta)) if theta else None
    return list(zip(map(float, values), copulas, strict=True))


def _tied_otherwise(
    inputs: Joint, ties: Sequence[Sequence[tuple[float, Archimedean | None]]], names: Sequence[tuple[str, str]]
) -> list[Joint]:
    """The inputs with every set of ties in turn; as they are where those cannot hold together."""
    found = []
    for row in zip(*ties, strict=True):
        told = list(zip(names, row, strict=True))
        gaussian = [(pair, value) for pair, (value, copula) in told if copula is None]
        groups = tuple(Group(members=pair, copula=copula) for pair, (_, copula) in told if copula is not None)
        try:
            found.append(replace(inputs, correlation=correlation_from_spearman(inputs.names, gaussian), groups=groups))
        except LawError:
            found.append(inputs)
    return found
