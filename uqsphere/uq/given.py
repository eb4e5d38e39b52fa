"""Answers from runs that were made already: a surrogate fitted to them, and what they leave open of the inputs' laws.

Two errors stand apart.  What the surrogate lacks beside the model is held as for a dear model (`augmented`), whose runs
were designed: nothing there needs more than that the runs follow the laws, predictions leave their own run out, and a
fit to the first half is checked by the other half, which it has not seen.  What the runs leave open of the laws, their
family and their dependence, is found by asking the surrogate again under other laws that the runs allow, at the same
Sobol' points, so that the difference is that of the laws.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np

from uqsphere.uq.augmented import METHOD, Trusted, index_estimate, indices_of, trust, widened, with_residuals
from uqsphere.uq.blocks import Blocks
from uqsphere.uq.chaos import Chaos, fit_chaos, germ_points, predict
from uqsphere.uq.estimates import Estimate, absent, describe
from uqsphere.uq.families import Array
from uqsphere.uq.inputs import Inputs, normal_scores
from uqsphere.uq.laws import Law, cdf, from_normal, sf
from uqsphere.uq.sampling import random_generator, sobol_points
from uqsphere.uq.shapley import BLOCK, MOST_EXACT, orders_of, shapley_estimates, subset_design, subset_scores

__all__ = [
    "LAWS",
    "Answer",
    "LeftOpen",
    "germs_of",
    "given_answers",
    "law_scores",
    "least_runs",
    "odd_pairs",
    "score_table",
    "trusted_from",
]

#: laws that are tried in place of the fitted ones, and points of the design that they are tried on
LAWS: Final = 64
_POINTS: Final = 512
#: the large design that the surrogate is evaluated on
_REPLICATES: Final = 16
_LARGE: Final = 2048
#: rows of each replicate where inputs depend on each other, base points at least and at most, and laws tried there
_SHARED_ROWS: Final = 4096
_SHARED: Final = (64, 512)
_SHARED_LAWS: Final = 24
#: no law is asked beyond these normal scores
_FURTHEST: Final = 8.0
#: scores at which a law is compared with another
_GRID: Final = np.linspace(-_FURTHEST, _FURTHEST, 321)
#: 95 % of what the other laws move an answer by, which is known from some dozens of them
_OPEN: Final = 2.0

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
    would ask it, is not known, and it is asked at the nearest run instead.
    """

    tables: Array
    inputs: tuple[Inputs, ...]
    low: Array
    high: Array


def least_runs(inputs: int) -> int:
    """Runs below which no surrogate is fitted."""
    return max(16, 4 * (inputs + 1))


def germs_of(laws: Sequence[Law]) -> tuple[str, ...]:
    """Legendre polynomials for laws between bounds, Hermite polynomials of the normal score for all others."""
    bounded = ("uniform", "loguniform", "triangular", "beta")
    return tuple("uniform" if law.kind in bounded else "normal" for law in laws)


def _scores(below: Array, above: Array) -> Array:
    from scipy.special import ndtri

    with np.errstate(divide="ignore"):
        return np.clip(np.where(below < 0.5, ndtri(below), -ndtri(above)), -_FURTHEST, _FURTHEST)


def law_scores(laws: Sequence[Law], x: Array) -> Array:
    """Normal scores (n, d) of values (n, d) under their laws, within 8 of the median."""
    return np.column_stack([_scores(cdf(law, x[:, k]), sf(law, x[:, k])) for k, law in enumerate(laws)])


def score_table(law: Law, others: Sequence[Law]) -> Array:
    """Scores (laws, grid) under other laws of the values that have the scores of a grid under `law`.

    A kernel density is followed by the shares of its observations, with the same bandwidth.
    """
    from uqsphere.uq.ignorance import possible_tails

    x = from_normal(law, _GRID)
    if law.kind == "empirical":
        generator = random_generator(seed=0, task=f"given: observations {len(law.data)} {law.data[0]!r}")
        return _scores(*possible_tails(law, x, len(others), generator))
    return np.array([_scores(cdf(other, x), sf(other, x)) for other in others])


def trusted_from(scores: Array, outputs: Array, germs: Sequence[str]) -> Trusted:
    """A surrogate of outputs (n,) at independent rows of normal scores (n, d), in any order that tells nothing.

    Raises ValueError where none can be fitted.
    """
    points = germ_points(scores, germs)
    half = len(outputs) // 2
    before = fit_chaos(points[:half], outputs[:half], germs)
    return trust(fit_chaos(points, outputs, germs), points, outputs, before)


def odd_pairs(scores: Array, pairs: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Pairs of columns of scores (n, d) that no Gaussian copula ties: their squares hang together otherwise.

    Of normal scores with correlation r the squares have correlation r²; more than 3.5 standard errors from that is odd.
    """
    n = len(scores)
    found = []
    for i, j in pairs:
        a, b = scores[:, i] - scores[:, i].mean(), scores[:, j] - scores[:, j].mean()
        r = float(np.corrcoef(a, b)[0, 1])
        squares = float(np.corrcoef(a * a, b * b)[0, 1])
        error = math.sqrt((1.0 + 10.0 * r * r) / n)
        if abs(squares - r * r) > 3.5 * error:
            found.append((i, j))
    return found


# --- the answers ----------------------------------------------------------------------------------------------


def given_answers(
    trusted: Trusted,
    inputs: Inputs,
    left_open: LeftOpen | None,
    *,
    quantiles: Sequence[float],
    seed: int,
    task: str,
) -> Answers:
    """{"statistics": {"mean", "sd", "0.05" ...}, "first": {input: ...}, ...} of a surrogate that may be used.

    `inputs` are the laws that its scores were taken by; `left_open` is None where they are known.  With dependent
    inputs there are "shapley", "first" and "total" (Kucherenko's) in place of Sobol' indices.
    """
    dependent = inputs.correlation is not None or bool(inputs.groups)
    answers = {"statistics": _statistics(trusted, inputs, left_open, quantiles, seed, task)}
    if trusted.chaos.constant:
        nothing = absent("the output does not vary with the inputs, or the expansion is a constant", METHOD,
                         len(trusted.residuals))  # fmt: skip
        rows = ("shapley", "first", "total") if dependent else ("first", "total")
        none = Answer(surrogate=nothing, left_open=0.0, whole=nothing)
        return answers | {row: dict.fromkeys(inputs.names, none) for row in rows}
    shares = (
        _shared(trusted, inputs, left_open, seed, task) if dependent else _indices(trusted, inputs, left_open, seed)
    )
    return answers | shares


def _surrogate(chaos: Chaos, left_open: LeftOpen | None) -> Callable[[Array, int | None], Array]:
    """The surrogate of dependent normal scores (n, d): of the fitted laws, or between the runs (-1), or of others."""

    def values(scores: Array, which: int | None) -> Array:
        if which is not None and left_open is not None:
            if which >= 0:
                tables = left_open.tables[which]
                scores = np.column_stack(
                    [np.interp(z, table, _GRID) for z, table in zip(scores.T, tables, strict=True)]
                )
            scores = np.clip(scores, left_open.low, left_open.high)
        return np.asarray(predict(chaos, germ_points(np.clip(scores, -_FURTHEST, _FURTHEST), chaos.germs)))

    return values


def _under(inputs: Inputs, left_open: LeftOpen | None, which: int | None) -> Inputs:
    return inputs if which is None or which < 0 or left_open is None else left_open.inputs[which]


@lru_cache(maxsize=64)
def _drawn(dimension: int, count: int, replicate: int, what: str, seed: int) -> Array:
    """Independent normal scores (count, dimension) of one randomisation; the same for every output."""
    from scipy.special import ndtri

    points = sobol_points(dimension=dimension, count=count, seed=seed, task=f"given: {what}", replicate=replicate)
    return np.asarray(ndtri(points))


def _numbers(left_open: LeftOpen | None) -> range:
    return range(0 if left_open is None else len(left_open.inputs))


def _answer(estimate: Estimate, moved: Sequence[float], value: float, within: tuple[float, float]) -> Answer:
    """An answer with what it moves by under the other laws, from the same points that gave `value`."""
    if estimate.value is None or estimate.low is None or estimate.high is None or not moved:
        return Answer(surrogate=estimate, left_open=0.0, whole=estimate)
    steps = np.asarray(moved) - value
    unit = float(np.abs(steps).max()) or 1.0
    left_open = _OPEN * unit * math.sqrt(float(np.mean((steps / unit) ** 2)))
    low = estimate.value - math.hypot(estimate.value - estimate.low, left_open)
    high = estimate.value + math.hypot(estimate.high - estimate.value, left_open)
    low, high = min(max(low, within[0]), estimate.value), max(min(high, within[1]), estimate.value)
    whole = replace(estimate, low=low, high=high, std_error=0.25 * (high - low))
    return Answer(surrogate=estimate, left_open=left_open, whole=whole)


def _statistics(
    trusted: Trusted, inputs: Inputs, left_open: LeftOpen | None, quantiles: Sequence[float], seed: int, task: str
) -> dict[str, Answer]:
    d = len(inputs.names)
    values = _surrogate(trusted.chaos, left_open)
    large = np.concatenate([_drawn(d, _LARGE, replicate, "large", seed) for replicate in range(_REPLICATES)])
    centre = values(normal_scores(inputs, large), None).reshape(_REPLICATES, _LARGE)
    moved, reach = with_residuals(trusted, centre, random_generator(seed=seed, task=f"given: residuals {task}"))
    told = [describe(moved + side * reach, quantiles=quantiles, method=METHOD) for side in (0.0, -1.0, 1.0)]
    middle = widened(trusted, *told)
    few = np.concatenate([_drawn(d, _POINTS, replicate, "laws", seed) for replicate in range(2)])

    def told_by(which: int | None) -> list[float]:
        y = values(normal_scores(_under(inputs, left_open, which), few), which)
        unit = float(np.abs(y).max()) or 1.0
        low = np.quantile(y, list(quantiles), method="hazen").tolist() if quantiles else []
        return [float((y / unit).mean()) * unit, float((y / unit).std()) * unit, *low]

    own, rows = told_by(-1), [told_by(k) for k in _numbers(left_open)]
    estimates = [("mean", middle.mean), ("sd", middle.sd), *((f"{p:g}", e) for p, e in middle.quantiles.items())]
    everywhere = (-math.inf, math.inf)
    return {
        name: _answer(estimate, [row[k] for row in rows], own[k], (0.0, math.inf) if name == "sd" else everywhere)
        for k, (name, estimate) in enumerate(estimates)
    }


def _indices(trusted: Trusted, inputs: Inputs, left_open: LeftOpen | None, seed: int) -> Answers:
    """Sobol' indices of independent inputs."""
    d = len(inputs.names)
    values, blocks = _surrogate(trusted.chaos, left_open), Blocks(inputs_count=d)
    points = _drawn(2 * d, _POINTS, 0, "pairs", seed)
    design = blocks.mix(points[:, :d], points[:, d:]).reshape(-1, d)
    shape = (_POINTS, len(design) // _POINTS)
    own = _pick_freeze(values(design, -1).reshape(shape), d)
    rows = [_pick_freeze(values(design, k).reshape(shape), d) for k in _numbers(left_open)]
    found = indices_of(trusted)
    return {
        order: {
            name: _answer(estimate, [row[k][j] for row in rows], float(own[k][j]), (0.0, 1.0))
            for j, (name, estimate) in enumerate(zip(inputs.names, found[order], strict=True))
        }
        for k, order in enumerate(("first", "total"))
    }


def _pick_freeze(outputs: Array, d: int) -> Array:
    """First and total indices (2, d) from outputs (n, d + 2) of `Blocks`: Saltelli's (2010) and Jansen's (1999)."""
    y = (outputs - outputs[:, 0].mean()) / (float(outputs[:, 0].std()) or 1.0)
    a, mixed, b = y[:, :1], y[:, 1 : d + 1], y[:, d + 1 :]
    variance = 0.5 * float(np.mean((a - b) ** 2)) or 1.0
    return np.array([np.mean(b * (mixed - a), axis=0), 0.5 * np.mean((a - mixed) ** 2, axis=0)]) / variance


def _shared(trusted: Trusted, inputs: Inputs, left_open: LeftOpen | None, seed: int, task: str) -> Answers:
    """Shapley effects, and Kucherenko's first and total indices, of inputs that depend on each other."""
    d, n = len(inputs.names), len(trusted.residuals)
    values = _surrogate(trusted.chaos, left_open)
    design = subset_design(d, exact=d <= min(8, MOST_EXACT))
    name = f"given: subsets {task}"
    count = BLOCK * (min(max(_SHARED_ROWS // design.rows, _SHARED[0]), _SHARED[1]) // BLOCK)

    def asked(which: int | None, replicates: int) -> dict[str, list[Estimate]]:
        under = _under(inputs, left_open, which)
        outputs, orders = [], []
        for replicate in range(replicates):
            scores = subset_scores(design, under, count=count, seed=seed, task=name, replicate=replicate)
            outputs.append(values(scores.reshape(-1, d), which).reshape(count, design.rows))
            orders.append(orders_of(design, count=count, seed=seed, task=name, replicate=replicate))
        return shapley_estimates(design, np.stack(outputs), None if design.exact else np.stack(orders))

    found = asked(None, _REPLICATES)
    own = asked(-1, 2)
    rows = [asked(k, 2) for k in _numbers(left_open)[:_SHARED_LAWS]]
    answer: Answers = {}
    for order, estimates in found.items():
        answer[order] = {}
        for j, (label, estimate) in enumerate(zip(inputs.names, estimates, strict=True)):
            told = index_estimate(estimate, trusted.error, n, sampled=estimate.half_width)
            moved = [e for row in rows if (e := row[order][j].value) is not None]
            answer[order][label] = _answer(told, moved, own[order][j].value or 0.0, (-1.0, 2.0))
    return answer
