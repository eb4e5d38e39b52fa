"""Several inputs together: their laws, and the Gaussian and Student t copulas that tie them.

A normal score z stands for the probability Φ(z), so that both tails keep their digits.  Dependent
scores are made from independent ones by the inverse Rosenblatt transform (Rosenblatt 1952): every
member is the conditional quantile given those before it, which is monotone in its own number and
goes with quasi-random points.

The Gaussian copula is given by the Pearson correlation of the normal scores; a Spearman rank
correlation rho_S becomes 2 sin(pi rho_S / 6) (Pearson 1907; exact for the Gaussian copula).  Any
number of groups with Student t copulas stand next to it; an input belongs to one of them at most.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import chain, combinations

import numpy as np

from uqsphere.arrays import Array, Names, Pair, bundle, frozen, special

from .forms import CERTAIN, GAUSS, LawError, student_t
from .law import Law
from .points import sobol_points

COPULAS = ("gaussian", "student_t")
#: least eigenvalue of a correlation matrix that is taken for positive definite: the inverse then
#: keeps six digits
_SMALLEST = 1e-10


# --- one copula -----------------------------------------------------------------------------------


@bundle
class Copula:
    """The Gaussian copula with the correlation (size, size) of its scores, or Student's t with
    `dof` of freedom.
    """

    correlation: Array
    dof: float = math.inf

    def among(self, members: Sequence[int]) -> "Copula":
        """The copula of some of the members, in the order given."""
        return Copula(correlation=self.correlation[np.ix_(members, members)], dof=self.dof)

    def _centre_and_scale(self, before: Array) -> Pair:
        """Those (n,) of the (t) variate of a member, given the scores (n, j) of the j before it."""
        j = before.shape[1]
        inverse = np.linalg.inv(self.correlation[:j, :j])
        across = self.correlation[j, :j]
        weights = inverse @ across
        x = _variate(before, self.dof)
        scale = np.full(len(x), math.sqrt(max(0.0, 1.0 - float(across @ weights))))
        if math.isfinite(self.dof):
            distance = self.dof + np.einsum("ni,ij,nj->n", x, inverse, x)
            scale *= np.sqrt(distance / (self.dof + j))
        return x @ weights, scale

    def conditional_score(self, before: Array, score: Array) -> Array:
        """Normal score (n,) of P(a member <= `score` | the scores (n, j) of the j before it)."""
        centre, scale = self._centre_and_scale(before)
        return _score((_variate(score, self.dof) - centre) / scale, self.dof + before.shape[1])

    def score_at(self, before: Array, normal: Array) -> Array:
        """Score (n,) of a member whose conditional score is `normal` (n,): the inverse of
        `conditional_score`.
        """
        centre, scale = self._centre_and_scale(before)
        return _score(centre + scale * _variate(normal, self.dof + before.shape[1]), self.dof)

    def dependent(self, scores: Array, fixed: int = 0) -> Array:
        """Scores (n, size): the first ones are fixed, and the others made from independent
        standard normals.
        """
        scores = scores.copy()
        for k in range(fixed, scores.shape[1]):
            scores[:, k] = self.score_at(scores[:, :k], scores[:, k])
        return scores

    def score_gradient(self, scores: Array) -> Array:
        """-∂ ln f/∂s (n, size) of the joint density f of the scores s (n, size)."""
        inverse = np.linalg.inv(self.correlation)
        nu = self.dof
        if math.isinf(nu):
            return scores @ inverse
        x = _variate(scores, nu)
        distance = np.einsum("ni,ij,nj->n", x, inverse, x)
        # ln f = ln c(x) + Σ ln phi(s), c the density of x over its marginals t(x); dx/ds =
        # phi(s)/t(x)
        joint = (nu + len(inverse)) * (x @ inverse) / (nu + distance)[:, None]
        single = (nu + 1.0) * x / (nu + x**2)
        with np.errstate(over="ignore"):
            rate = GAUSS.pdf(scores) / student_t(nu).pdf(x)
        return np.asarray((joint - single) * rate + scores)


#: columns of inputs with the copula that ties them
Block = tuple[tuple[int, ...], Copula]


def _variate(score: Array, dof: float) -> Array:
    """Student's t variate with the same probability below it as a normal score."""
    if math.isinf(dof):
        return score
    return student_t(dof).quantile(*GAUSS.tails(score))


def _score(variate: Array, dof: float) -> Array:
    """Normal score of Student's t variate."""
    if math.isinf(dof):
        return variate
    return np.clip(GAUSS.quantile(*student_t(dof).tails(variate)), -CERTAIN, CERTAIN)


@frozen
class Dependence:
    """One rank correlation, Spearman's or Kendall's, for every pair of the names; `dof` of a
    Student t copula.
    """

    of: Names
    spearman: float | None = None
    kendall: float | None = None
    copula: str = "gaussian"
    dof: float | None = None

    @property
    def text(self) -> str:
        """The rank correlation in words."""
        if self.kendall is None:
            return f"Spearman's rank correlation {self.spearman or 0.0:g}"
        return f"Kendall's rank correlation {self.kendall:g}"

    def make_copula(self) -> Copula:
        """The copula of all pairs; raises LawError (keys "copula", "of", "spearman", "kendall",
        "dof").

        >>> Dependence(of=("a", "b"), kendall=0.5).make_copula().correlation.round(6).tolist()
        [[1.0, 0.707107], [0.707107, 1.0]]
        """
        size = len(self.of)
        dof = self.dof
        if self.copula not in COPULAS:
            raise LawError(f"unknown copula {self.copula!r}; known: {', '.join(COPULAS)}", "copula")
        if size < 2 or len(set(self.of)) != size:
            raise LawError(
                f"a dependence must name at least two different inputs, not {list(self.of)}", "of"
            )
        key, rank = "spearman", self.spearman
        if rank is None:
            key, rank = "kendall", self.kendall
        if rank is None or None not in (self.spearman, self.kendall):
            raise LawError(
                "one rank correlation between -1 and 1 is required, spearman or kendall",
                "" if rank is None else "kendall",
            )
        if not -1.0 < rank < 1.0:
            raise LawError(f"{key} must lie strictly between -1 and 1, found {rank:g}", key)
        if (self.copula == "student_t") != (dof is not None):
            raise LawError('dof (for example 4) is used only with copula = "student_t"', "dof")
        if dof is not None and not 1.0 <= dof <= 1000.0:
            raise LawError(f"dof must lie between 1 and 1000, found {dof}", "dof")
        if key == "kendall":
            # for every dof (Lindskog, McNeil, Schmock 2003)
            rho = math.sin(0.5 * math.pi * rank)
        elif dof is None:
            rho = 2.0 * math.sin(math.pi * rank / 6.0)
        else:
            rho = _correlation_of_t(rank, dof)
        correlation = np.where(np.eye(size), 1.0, rho)
        if np.linalg.eigvalsh(correlation)[0] < _SMALLEST:
            raise LawError(
                f"{size} inputs cannot all have {key} {rank:g} with each other (not positive "
                "definite)",
                key,
            )
        return Copula(correlation=correlation, dof=dof or math.inf)


def _correlation_of_t(spearman: float, dof: float) -> float:
    """The t copula's correlation r with this Spearman's rho = 6/pi E[arcsin(r/sqrt((1 + S/S1)(1 +
    S/S2)))].

    S, S1, S2 are independent gamma variables of the shape dof/2 (A. Heinen, A. Valdesogo, J.
    Multivar. Anal. 179, 2020, 104639); 4096 points of Sobol' know rho to 1e-4.
    """
    from scipy.optimize import brentq

    points = sobol_points(3, 4096, seed=0, task="t copula")
    common, first, second = special.gammaincinv(0.5 * dof, points.T)
    factor = 1.0 / np.sqrt((1.0 + common / first) * (1.0 + common / second))
    # rho is 1 for r = 1, which the points should say too
    whole = np.arcsin(factor).mean()
    return brentq(lambda r: np.arcsin(r * factor).mean() / whole - spearman, -1.0, 1.0)


# --- several inputs -------------------------------------------------------------------------------


@bundle
class Tie:
    """An input that is not drawn: the last member of `copula`, given the normal `scores` (..., size
    - 1) of others, which are these columns of the inputs that are drawn; there may be none."""

    copula: Copula
    scores: Array
    columns: tuple[int, ...]

    def conditional_score(self, score: Array) -> Array:
        """Normal score of P(it <= its score | the others), elementwise."""
        return self._mapped(self.copula.conditional_score, score)

    def score_at(self, normal: Array) -> Array:
        """Its score where `conditional_score` is this one, elementwise."""
        return self._mapped(self.copula.score_at, normal)

    def _mapped(self, function: Callable[[Array, Array], Array], score: Array) -> Array:
        if not self.columns:
            return score
        near = np.clip(score, -CERTAIN, CERTAIN).ravel()
        mapped = function(self.scores.reshape(near.size, -1), near)
        return np.where(np.isinf(score), score, mapped.reshape(score.shape))


#: what depends on no input
FREE = Tie(copula=Copula(correlation=np.eye(1)), scores=np.empty(0), columns=())


@bundle
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
    blocks: tuple[Block, ...] = ()

    def __repr__(self) -> str:
        return f"<Joint of {', '.join(self.names)}{', dependent' if self.dependent else ''}>"

    @property
    def dependent(self) -> bool:
        """Whether any input depends on another."""
        return bool(self.blocks)

    @property
    def correlation(self) -> Array:
        """Correlation (d, d) of the normal scores under the Gaussian copula."""
        matrix = np.eye(len(self.names))
        for columns, copula in self.blocks:
            if math.isinf(copula.dof):
                matrix[np.ix_(columns, columns)] = copula.correlation
        return matrix

    def scores(self, normals: Array) -> Array:
        """Independent standard normals (..., d) -> dependent normal scores (..., d)."""
        flat = normals.reshape(math.prod(normals.shape[:-1]), normals.shape[-1])
        return self.redrawn((), flat, flat).reshape(normals.shape)

    def physical(self, normals: Array) -> Array:
        """Independent standard normals (..., d) -> inputs (..., d) in SI, with laws and copulas in
        force.
        """
        physical = self.scores(normals)
        for column, law in enumerate(self.laws):
            physical[..., column] = law.from_normal(physical[..., column])
        return physical

    def marginal_scores(self, physical: Array) -> Array:
        """Inputs (n, d) in SI -> dependent normal scores (n, d), within 8 standard deviations:
        1e-15 lies beyond.
        """
        scores = np.empty(physical.shape)
        for k, law in enumerate(self.laws):
            scores[:, k] = GAUSS.quantile(*law.tails(physical[:, k]))
        return np.clip(scores, -8.0, 8.0)

    def normals(self, physical: Array) -> Array:
        """Inputs (n, d) in SI -> independent standard normals (n, d): the inverse of `physical`."""
        normals = self.marginal_scores(physical)
        for columns, copula in self.blocks:
            scores = normals[:, columns]
            for k, column in enumerate(columns):
                normals[:, column] = copula.conditional_score(scores[:, :k], scores[:, k])
        return normals

    def only(self, names: Names) -> "Joint":
        """Some of the inputs, with what ties them to each other."""
        at = [self.names.index(name) for name in names]
        blocks = []
        for columns, copula in self.blocks:
            kept = [columns.index(k) for k in at if k in columns]
            copula = copula.among(kept)
            tied = np.any(copula.correlation - np.eye(len(kept))) or math.isfinite(copula.dof)
            if len(kept) > 1 and tied:
                blocks.append((tuple(at.index(columns[k]) for k in kept), copula))
        return Joint(names=tuple(names), laws=tuple(self.laws[k] for k in at), blocks=tuple(blocks))

    def redrawn(self, columns: Sequence[int], scores: Array, normals: Array) -> Array:
        """Dependent scores (n, d): `columns` as in `scores` (n, d), the others drawn afresh given
        those.

        `normals` (n, d) are independent standard normals; those of the given columns are not used.
        """
        drawn = normals.copy()
        drawn[:, columns] = scores[:, columns]
        for block, copula in self.blocks:
            # those of the given columns come first
            members = sorted(range(len(block)), key=lambda k: block[k] not in columns)
            at = [block[k] for k in members]
            fixed = len(set(block) & set(columns))
            drawn[:, at] = copula.among(members).dependent(drawn[:, at], fixed)
        return drawn

    def score_gradients(self, scores: Array) -> Array:
        """-∂ ln f/∂s (n, d) of the joint density f of the dependent normal scores s (n, d): s where
        nothing is tied.
        """
        gradients = scores.copy()
        for columns, copula in self.blocks:
            gradients[:, columns] = copula.score_gradient(scores[:, columns])
        return gradients

    def tie(self, target: str, drawn: Names, scores: Array) -> Tie:
        """What ties `target`, which is not drawn, to the drawn inputs at their dependent scores
        (..., d).
        """
        for columns, copula in self.only([*drawn, target]).blocks:
            others = columns[:-1]
            tied = math.isfinite(copula.dof) or np.any(copula.correlation[-1, :-1])
            if columns[-1] == len(drawn) and tied:
                return Tie(copula=copula, scores=scores[..., others], columns=others)
        return FREE


def make_joint(laws: Mapping[str, Law], dependences: Sequence[Dependence]) -> Joint:
    """Inputs by name, with the dependences of a study.

    Raises LawError (keys "of", "spearman", "kendall", "dof", "copula") where they cannot hold.

    >>> from uqsphere.uq.law import make_law
    >>> law = make_law("normal", {"mean": 0.0, "sd": 1.0})
    >>> make_joint({"a": law, "b": law, "c": law}, [Dependence(of=("a", "c"), spearman=0.5)])
    <Joint of a, b, c, dependent>
    """
    names = tuple(laws)
    pairs = set[tuple[int, ...]]()
    blocks = list[Block]()
    correlation = np.eye(len(names))
    for tie in dependences:
        for name in tie.of:
            if name not in names:
                random = ", ".join(names) or "none"
                raise LawError(f"{name!r} is not a random input; random are: {random}", "of")
        copula = tie.make_copula()
        columns = tuple(names.index(name) for name in tie.of)
        if math.isfinite(copula.dof):
            blocks.append((columns, copula))
            continue
        for pair in combinations(sorted(columns), 2):
            if pair in pairs:
                first, second = (names[column] for column in pair)
                raise LawError(f"the dependence of {first} and {second} is given twice", "of")
            pairs.add(pair)
            correlation[pair] = correlation[pair[::-1]] = copula.correlation[0, 1]
    tied = sorted(set(chain(*pairs)))
    taken = list(chain(tied, *(columns for columns, _ in blocks)))
    for column in taken:
        if taken.count(column) > 1:
            raise LawError(
                f"{names[column]} is in more than one dependence, and one of them is not Gaussian: "
                "name all of them in one dependence, or take Gaussian copulas",
                "of",
            )
    if tied:
        gaussian = Copula(correlation=correlation).among(tied)
        smallest = np.linalg.eigvalsh(gaussian.correlation)[0]
        if smallest < _SMALLEST:
            raise LawError(
                "the dependences cannot hold together: the correlation matrix is not positive "
                f"definite (least eigenvalue {smallest:.3g}); weaken or remove some of them",
                "spearman",
            )
        blocks.insert(0, (tuple(tied), gaussian))
    return Joint(names=names, laws=tuple(laws.values()), blocks=tuple(blocks))
