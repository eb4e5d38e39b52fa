"""What ties the inputs of a table of runs to each other, and what the runs leave open of that and of the laws."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Places
from uqsphere.given.answers import LAWS, LeftOpen, score_table
from uqsphere.uq.archimedean import ARCHIMEDEAN, Archimedean
from uqsphere.uq.estimate import Estimate
from uqsphere.uq.families import LawError
from uqsphere.uq.joint import Dependence, Group, Joint, correlation_from_spearman, make_copula, make_joint
from uqsphere.uq.law import Law

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
    ranks = np.column_stack([rankdata(columns[:, j]) for j in range(d)])
    matrix = np.corrcoef(ranks, rowvar=False).reshape(d, d)
    error = math.sqrt(1.06 / (n - 3))
    found = []
    for i in range(d):
        for j in range(i + 1, d):
            value = float(np.clip(matrix[i, j], -1.0, 1.0))
            centre = math.atanh(np.clip(value, -1.0 + 1e-15, 1.0 - 1e-15))
            low, high = math.tanh(centre - 1.96 * error), math.tanh(centre + 1.96 * error)
            estimate = Estimate(
                value=value, low=min(low, value), high=max(high, value), std_error=error * (1.0 - value**2),
                method="Spearman, Fisher's interval", evaluations=n,
            )  # fmt: skip
            found.append((i, j, estimate))
    return found


def tied(pairs: Sequence[tuple[int, int, Estimate]]) -> list[tuple[int, int, Estimate]]:
    """Pairs whose interval leaves out zero by so much that chance is no explanation among so many pairs."""
    from scipy.special import ndtri

    factor = -float(ndtri(0.005 / max(1, len(pairs)))) / 1.96
    found = []
    for i, j, estimate in pairs:
        if estimate.value is None or estimate.low is None or estimate.high is None:
            continue
        centre = math.atanh(min(max(estimate.value, -1.0 + 1e-15), 1.0 - 1e-15))
        half = 0.5 * (math.atanh(min(estimate.high, 1.0 - 1e-15)) - math.atanh(max(estimate.low, -1.0 + 1e-15)))
        if abs(centre) > factor * half:
            found.append((i, j, estimate))
    return found


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
    from scipy.special import ndtri
    from scipy.stats import rankdata

    ranks = np.column_stack([rankdata(column, method="ordinal") for column in x.T])
    scores = np.asarray(ndtri(ranks / (len(x) + 1.0)))
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
    dependences = [
        Dependence(of=(every[tie.columns[0]], every[tie.columns[1]]), spearman=tie.spearman, copula=tie.copula)
        for tie in ties
    ]
    return make_joint(names, laws, dependences)


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
    ranked = [_ranked(rehearsed[:, :, list(pair)]) for pair in pairs]
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
        moved = _moved(inputs, opened, [(every[i], every[j]) for i, j in (tie.columns for tie in ties)])
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
    from scipy.special import ndtri

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


def _ranked(pair: Array) -> Array:
    """Fisher's transform of the rank correlations (K,) of rehearsals (K, rows, 2)."""
    ranks = pair.argsort(axis=1).argsort(axis=1).astype(float)
    ranks -= ranks.mean(axis=1, keepdims=True)
    found = (ranks[:, :, 0] * ranks[:, :, 1]).sum(axis=1) / (ranks[:, :, 0] ** 2).sum(axis=1)
    return np.asarray(np.arctanh(np.clip(found, -0.9999, 0.9999)))


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


def _moved(
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
