"""Several inputs together: their laws, and the Gaussian and Student t copulas that tie them.

A normal score z stands for the probability Φ(z), so that both tails keep their digits.  Dependent
scores are made from independent ones by the inverse Rosenblatt transform (Rosenblatt 1952): every
member is the conditional quantile given those before it, which is monotone in its own number and
goes with quasi-random points.

The Gaussian copula is given by the Pearson correlation of the normal scores; a Spearman rank
correlation rho_S becomes 2 sin(pi rho_S / 6) (Pearson 1907; exact for the Gaussian copula).  Any
number of groups with Student t copulas stand next to it; an input belongs to one of them at most.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain, combinations
from typing import Final

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.uq.forms import CERTAIN, GAUSS, LawError, student_t
from uqsphere.uq.law import Law
from uqsphere.uq.points import sobol_points

COPULAS: Final = ("gaussian", "student_t")
#: least eigenvalue of a correlation matrix that is taken for positive definite: the inverse then
#: keeps six digits
_SMALLEST: Final = 1e-10


# --- one copula -----------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Copula:
    """The Gaussian copula with the correlation (size, size) of its scores, or Student's t with
    `dof` of freedom.
    """

    correlation: Array
    dof: float = math.inf

    @property
    def size(self) -> int:
        return len(self.correlation)

    def among(self, members: Sequence[int]) -> Copula:
        """The copula of some of the members, in the order given."""
        return Copula(correlation=self.correlation[np.ix_(members, members)], dof=self.dof)

    def _conditional(
        self, target: int, others: Sequence[int], scores: Array
    ) -> tuple[Array, Array]:
        """Centre and scale (n,) of the (t) variate of a member, given others at these scores
        (n, j).
        """
        inverse = np.linalg.inv(self.correlation[np.ix_(others, others)])
        across = self.correlation[list(others), target]
        weights = inverse @ across
        remaining = math.sqrt(max(0.0, 1.0 - float(across @ weights)))
        x = _variate(scores, self.dof)
        if math.isinf(self.dof):
            return np.asarray(x @ weights), np.full(len(x), remaining)
        # scale of the conditional t law: sqrt((dof + x' R⁻¹ x)/(dof + j))
        distance = self.dof + np.einsum("ni,ij,nj->n", x, inverse, x)
        return np.asarray(x @ weights), remaining * np.sqrt(distance / (self.dof + x.shape[1]))

    def conditional_score(
        self, target: int, others: Sequence[int], scores: Array, score: Array
    ) -> Array:
        """Normal score (n,) of P(member `target` <= `score` | `others` at the scores (n, j))."""
        centre, scale = self._conditional(target, others, scores)
        return _score((_variate(score, self.dof) - centre) / scale, self.dof + len(others))

    def score_at(self, target: int, others: Sequence[int], scores: Array, normal: Array) -> Array:
        """Score (n,) of a member whose conditional score is `normal` (n,): the inverse of
        `conditional_score`.
        """
        centre, scale = self._conditional(target, others, scores)
        return _score(centre + scale * _variate(normal, self.dof + len(others)), self.dof)

    def conditional_scores(self, others: Sequence[int], scores: Array, normals: Array) -> Array:
        """Scores (n, size - j) of the members beside the others, in their order, from independent
        standard normals.
        """
        drawn = list(others)
        free = [k for k in range(self.size) if k not in others]
        for member, normal in zip(free, normals.T, strict=True):
            scores = np.column_stack([scores, self.score_at(member, drawn, scores, normal)])
            drawn.append(member)
        return scores[:, len(others) :]

    def score_gradient(self, scores: Array) -> Array:
        """-∂ ln f/∂s (n, size) of the joint density f of the scores s (n, size)."""
        inverse = np.linalg.inv(self.correlation)
        if math.isinf(self.dof):
            return np.asarray(scores @ inverse)
        x, nu = _variate(scores, self.dof), self.dof
        distance = np.einsum("ni,ij,nj->n", x, inverse, x)
        # ln f = ln c(x) + Σ ln phi(s), c the density of x over its marginals t(x); dx/ds =
        # phi(s)/t(x)
        joint = (nu + self.size) * (x @ inverse) / (nu + distance)[:, None]
        single = (nu + 1.0) * x / (nu + x**2)
        with np.errstate(over="ignore"):
            rate = GAUSS.pdf(scores) / student_t(nu).pdf(x)
        return np.asarray((joint - single) * rate + scores)


def _variate(score: Array, dof: float) -> Array:
    """Student's t variate with the same probability below it as a normal score."""
    if math.isinf(dof):
        return np.asarray(score)
    return student_t(dof).quantile(*GAUSS.tails(score))


def _score(variate: Array, dof: float) -> Array:
    """Normal score of Student's t variate."""
    if math.isinf(dof):
        return np.asarray(variate)
    with np.errstate(divide="ignore"):
        return np.clip(GAUSS.quantile(*student_t(dof).tails(variate)), -CERTAIN, CERTAIN)


@dataclass(frozen=True, kw_only=True)
class Dependence:
    """One rank correlation, Spearman's or Kendall's, for every pair of the names; `dof` of a
    Student t copula.
    """

    of: tuple[str, ...]
    spearman: float | None = None
    kendall: float | None = None
    copula: str = "gaussian"
    dof: float | None = None

    def make_copula(self) -> Copula:
        """The copula of all pairs; raises LawError (keys "copula", "of", "spearman", "kendall",
        "dof").

        >>> Dependence(of=("a", "b"), kendall=0.5).make_copula().correlation.round(6).tolist()
        [[1.0, 0.707107], [0.707107, 1.0]]
        """
        size, dof = len(self.of), self.dof
        if self.copula not in COPULAS:
            raise LawError(f"unknown copula {self.copula!r}; known: {', '.join(COPULAS)}", "copula")
        if size < 2 or len(set(self.of)) != size:
            raise LawError(
                f"a dependence must name at least two different inputs, not {list(self.of)}", "of"
            )
        ranks = {"spearman": self.spearman, "kendall": self.kendall}
        there = {key: value for key, value in ranks.items() if value is not None}
        if len(there) != 1:
            raise LawError(
                "one rank correlation between -1 and 1 is required, spearman or kendall",
                *list(there)[1:],
            )
        ((key, value),) = there.items()
        if not -1.0 < value < 1.0:
            raise LawError(f"{key} must lie strictly between -1 and 1, found {value:g}", key)
        if (self.copula == "student_t") != (dof is not None):
            raise LawError('dof (for example 4) is used only with copula = "student_t"', "dof")
        if dof is not None and not 1.0 <= dof <= 1000.0:
            raise LawError(f"dof must lie between 1 and 1000, found {dof}", "dof")
        if key == "kendall":
            # for every dof (Lindskog, McNeil, Schmock 2003)
            rho = math.sin(0.5 * math.pi * value)
        elif dof is None:
            rho = 2.0 * math.sin(math.pi * value / 6.0)
        else:
            rho = _correlation_of_t(value, dof)
        correlation = np.where(np.eye(size), 1.0, rho)
        if np.linalg.eigvalsh(correlation)[0] < _SMALLEST:
            raise LawError(
                (
                    f"{size} inputs cannot all have {key} {value:g} with each other (not positive "
                    "definite)"
                ),
                key,
            )
        return Copula(correlation=correlation, dof=math.inf if dof is None else dof)


def _correlation_of_t(spearman: float, dof: float) -> float:
    """The t copula's correlation r with this Spearman's rho = 6/pi E[arcsin(r/sqrt((1 + S/S1)(1 +
    S/S2)))].

    S, S1, S2 are independent gamma variables of the shape dof/2 (A. Heinen, A. Valdesogo, J.
    Multivar. Anal. 179, 2020, 104639); 4096 points of Sobol' know rho to 1e-4.
    """
    from scipy.optimize import brentq

    points = sobol_points(dimension=3, count=4096, seed=0, task="t copula")
    common, first, second = special.gammaincinv(0.5 * dof, points.T)
    factor = 1.0 / np.sqrt((1.0 + common / first) * (1.0 + common / second))
    # rho is 1 for r = 1, which the points should say too
    whole = np.arcsin(factor).mean()
    return float(brentq(lambda r: np.arcsin(r * factor).mean() / whole - spearman, -1.0, 1.0))


# --- several inputs -------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Tie:
    """An input that is not drawn: the last member of `copula`, given the normal `scores` (..., size
    - 1) of others, which are these columns of the inputs that are drawn."""

    copula: Copula
    scores: Array
    columns: tuple[int, ...]

    def conditional_score(self, score: Array) -> Array:
        """Normal score of P(it <= its score | the others), elementwise."""
        return self._mapped(self.copula.conditional_score, score)

    def score_at(self, normal: Array) -> Array:
        """Its score where `conditional_score` is this one, elementwise."""
        return self._mapped(self.copula.score_at, normal)

    def _mapped(self, function: Callable[..., Array], score: Array) -> Array:
        last, near = self.copula.size - 1, np.clip(score, -CERTAIN, CERTAIN).reshape(-1)
        mapped = function(last, range(last), self.scores.reshape(score.size, -1), near)
        return np.where(np.isinf(score), score, mapped.reshape(score.shape))


@dataclass(frozen=True, kw_only=True, eq=False)
class Joint:
    """Named laws in a fixed order, and what ties them: columns with their copula; all that Gaussian
    copulas tie are one block.

    >>> from uqsphere.uq.law import make_law
    >>> two = Joint(names=("a", "b"), laws=(make_law("normal", {"mean": 1.0, "sd": 0.1}),
    ...                                     make_law("uniform", {}, 0.0, 2.0)))
    >>> two.physical(np.array([[0.0, 0.0]])).round(12).tolist()
    [[1.0, 1.0]]
    """

    names: tuple[str, ...]
    laws: tuple[Law, ...]
    blocks: tuple[tuple[tuple[int, ...], Copula], ...] = ()

    def __repr__(self) -> str:
        return f"<Joint of {', '.join(self.names)}{', dependent' if self.dependent else ''}>"

    @property
    def dependent(self) -> bool:
        """Whether any input depends on another."""
        return bool(self.blocks)

    @property
    def correlation(self) -> Array | None:
        """Correlation (d, d) of the normal scores under the Gaussian copula; None if no two are
        tied so.
        """
        matrix = np.eye(len(self.names))
        for columns, copula in self.blocks:
            if math.isinf(copula.dof):
                matrix[np.ix_(columns, columns)] = copula.correlation
        if np.any(matrix - np.eye(len(matrix))):
            return matrix
        return None

    def scores(self, normals: Array) -> Array:
        """Independent standard normals (..., d) -> dependent normal scores (..., d)."""
        flat = normals.reshape(-1, len(self.names))
        return self.redrawn((), flat, flat).reshape(normals.shape)

    def marginal(self, scores: Array) -> Array:
        """Dependent normal scores (..., d) -> inputs (..., d) in SI: the laws, without what ties
        them.
        """
        physical = np.empty_like(scores)
        for column, law in enumerate(self.laws):
            physical[..., column] = law.from_normal(scores[..., column])
        return physical

    def physical(self, normals: Array) -> Array:
        """Independent standard normals (..., d) -> inputs (..., d) in SI, with laws and copulas in
        force.
        """
        return self.marginal(self.scores(normals))

    def marginal_scores(self, physical: Array) -> Array:
        """Inputs (n, d) in SI -> dependent normal scores (n, d), within 8 standard deviations:
        1e-15 lies beyond.
        """
        scores = np.empty_like(physical)
        for column, law in enumerate(self.laws):
            scores[:, column] = GAUSS.quantile(*law.tails(physical[:, column]))
        return np.clip(scores, -8.0, 8.0)

    def normals(self, physical: Array) -> Array:
        """Inputs (n, d) in SI -> independent standard normals (n, d): the inverse of `physical`."""
        scores = self.marginal_scores(physical)
        normals = scores.copy()
        for columns, copula in self.blocks:
            for k, column in enumerate(columns):
                before = scores[:, list(columns[:k])]
                score = scores[:, column]
                normals[:, column] = copula.conditional_score(k, range(k), before, score)
        return normals

    def only(self, names: Sequence[str]) -> Joint:
        """Some of the inputs, with what ties them to each other."""
        at, blocks = [self.names.index(name) for name in names], []
        for columns, copula in self.blocks:
            kept = [columns.index(k) for k in at if k in columns]
            copula = copula.among(kept)
            if len(kept) > 1 and (
                np.any(copula.correlation - np.eye(len(kept))) or math.isfinite(copula.dof)
            ):
                blocks.append((tuple(at.index(columns[k]) for k in kept), copula))
        return Joint(names=tuple(names), laws=tuple(self.laws[k] for k in at), blocks=tuple(blocks))

    def redrawn(self, columns: Sequence[int], scores: Array, normals: Array) -> Array:
        """Dependent scores (n, d): `columns` as in `scores` (n, d), the others drawn afresh given
        those.

        `normals` (n, d) are independent standard normals; those of the given columns are not used.
        """
        drawn = np.array(normals, dtype=float)
        drawn[:, list(columns)] = scores[:, list(columns)]
        for block, copula in self.blocks:
            fixed = [k for k, column in enumerate(block) if column in columns]
            free = [column for column in block if column not in columns]
            others = drawn[:, [block[k] for k in fixed]]
            drawn[:, free] = copula.conditional_scores(fixed, others, normals[:, free])
        return drawn

    def score_gradients(self, scores: Array) -> Array:
        """-∂ ln f/∂s (n, d) of the joint density f of the dependent normal scores s (n, d): s where
        nothing is tied.
        """
        gradients = np.array(scores, dtype=float)
        for columns, copula in self.blocks:
            gradients[:, list(columns)] = copula.score_gradient(scores[:, list(columns)])
        return gradients

    def tie(self, target: str, drawn: Sequence[str], scores: Array) -> Tie | None:
        """What ties `target`, which is not drawn, to the drawn inputs at their dependent scores
        (..., d); or None.
        """
        at = self.names.index(target)
        for block, copula in self.blocks:
            others = [k for k, column in enumerate(block) if self.names[column] in drawn]
            if at not in block or not others:
                continue
            member = block.index(at)
            if math.isfinite(copula.dof) or np.any(copula.correlation[member, others]):
                columns = tuple(list(drawn).index(self.names[block[k]]) for k in others)
                among = copula.among([*others, member])
                return Tie(copula=among, scores=scores[..., columns], columns=columns)
        return None


def make_joint(
    names: Sequence[str], laws: Sequence[Law], dependences: Sequence[Dependence]
) -> Joint:
    """Inputs with the dependences of a study.

    Raises LawError (keys "of", "spearman", "kendall", "dof", "copula") where they cannot hold.

    >>> from uqsphere.uq.law import make_law
    >>> law = make_law("normal", {"mean": 0.0, "sd": 1.0})
    >>> make_joint(("a", "b", "c"), (law,) * 3, [Dependence(of=("a", "c"), spearman=0.5)])
    <Joint of a, b, c, dependent>
    """
    pairs, blocks = set[tuple[int, ...]](), list[tuple[tuple[int, ...], Copula]]()
    correlation = np.eye(len(names))
    for tie in dependences:
        if unknown := [name for name in tie.of if name not in names]:
            raise LawError(
                f"{unknown[0]!r} is not a random input; random are: {', '.join(names) or 'none'}",
                "of",
            )
        copula, columns = tie.make_copula(), [list(names).index(name) for name in tie.of]
        if math.isfinite(copula.dof):
            blocks.append((tuple(columns), copula))
            continue
        for pair in combinations(sorted(columns), 2):
            if pair in pairs:
                first, second = (names[column] for column in pair)
                raise LawError(f"the dependence of {first} and {second} is given twice", "of")
            pairs.add(pair)
            correlation[pair] = correlation[pair[::-1]] = copula.correlation[0, 1]
    tied = sorted(set(chain.from_iterable(pairs)))
    taken = list(chain(tied, *(columns for columns, _ in blocks)))
    twice = [names[column] for column in taken if taken.count(column) > 1]
    if twice:
        raise LawError(
            f"{twice[0]} is in more than one dependence, and one of them is not Gaussian: name all "
            "of them in one dependence, or take Gaussian copulas",
            "of",
        )
    if tied:
        gaussian = Copula(correlation=correlation).among(tied)
        if (smallest := float(np.linalg.eigvalsh(gaussian.correlation)[0])) < _SMALLEST:
            raise LawError(
                "the dependences cannot hold together: the correlation matrix is not positive "
                "definite "
                f"(least eigenvalue {smallest:.3g}); weaken or remove some of them",
                "spearman",
            )
        blocks.insert(0, (tuple(tied), gaussian))
    return Joint(names=tuple(names), laws=tuple(laws), blocks=tuple(blocks))
