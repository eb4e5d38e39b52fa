"""Several inputs together: their laws, and the copulas that tie them.

A normal score z stands for the probability Φ(z), so that both tails keep their digits.  Dependent scores are made
from independent ones by the inverse Rosenblatt transform (Rosenblatt 1952): every member is the conditional
quantile given those before it, which is monotone in its own number and goes with quasi-random points.  The same
step gives some members when others are held.

The Gaussian copula is given by the Pearson correlation of the normal scores; a Spearman rank correlation rho_S
becomes 2 sin(pi rho_S / 6) (Pearson 1907; exact for the Gaussian copula).  Any number of groups with other copulas
stand beside it; an input belongs to one of them at most.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import combinations
from typing import Final, TypeAlias

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.uq.copulas import ARCHIMEDEAN, Archimedean, Elliptical
from uqsphere.uq.families import LawError
from uqsphere.uq.law import Law
from uqsphere.uq.roots import root

Copula: TypeAlias = Elliptical | Archimedean

COPULAS: Final = ("gaussian", "student_t", *ARCHIMEDEAN)
#: the strongest rank correlation of an Archimedean copula: beyond it, one input is the other
_STRONGEST: Final = 0.99
LEAST_DOF, MOST_DOF = 1.0, 1000.0


# --- the copula of one group -----------------------------------------------------------------------------


def make_copula(
    kind: str, size: int, *, spearman: float | None = None, kendall: float | None = None, dof: float | None = None
) -> Copula:
    """The copula all of whose pairs have one rank correlation, Spearman's or Kendall's.

    Gaussian and Student t copulas take negative ones down to where the correlation matrix of all pairs ceases to
    be positive definite; Frank's takes them for two members; Clayton's and Gumbel's take none.

    Raises
    ------
    LawError
        Keys "copula", "of", "spearman", "kendall", "dof": what was found and what is allowed.

    >>> make_copula("clayton", 2, kendall=0.5).theta
    2.0
    """
    key, value = _asked_rank(kind, size, spearman, kendall)
    if kind == "student_t":
        if dof is None or not LEAST_DOF <= dof <= MOST_DOF:
            raise LawError(f"dof must lie between {LEAST_DOF:g} and {MOST_DOF:g}, found {dof}", "dof")
    elif dof is not None:
        raise LawError(f"dof belongs to the Student t copula, not to {kind}", "dof")
    if kind in ("gaussian", "student_t"):
        rho = _strength(kind, key, value, math.inf if dof is None else dof)
        correlation = np.full((size, size), rho)
        np.fill_diagonal(correlation, 1.0)
        if 1.0 + (size - 1) * min(rho, 0.0) < 1e-10 or rho > 1.0 - 1e-10:
            raise LawError(
                f"{size} inputs cannot all have {key} {value:g} with each other (not positive definite)", key
            )
        return Elliptical(correlation=correlation, dof=math.inf if dof is None else dof)
    _check_archimedean(kind, size, key, value)
    return Archimedean(generator=ARCHIMEDEAN[kind], size=size, theta=_strength(kind, key, value))


def _asked_rank(kind: str, size: int, spearman: float | None, kendall: float | None) -> tuple[str, float]:
    """By which rank correlation a dependence is given, and what it is; raises LawError."""
    if kind not in COPULAS:
        raise LawError(f"unknown copula {kind!r}; known: {', '.join(COPULAS)}", "copula")
    if size < 2:
        raise LawError(f"a dependence needs two or more different inputs, found {size}", "of")
    if (spearman is None) == (kendall is None):
        raise LawError("a dependence is given by one of spearman and kendall", "spearman")
    key, value = ("kendall", kendall) if spearman is None else ("spearman", spearman)
    assert value is not None
    if not (math.isfinite(value) and -1.0 < value < 1.0):
        raise LawError(f"{key} must lie strictly between -1 and 1, found {value:g}", key)
    return key, value


def _check_archimedean(kind: str, size: int, key: str, value: float) -> None:
    name = kind.capitalize()
    if value == 0.0:
        raise LawError(f"{key} is 0, which is no dependence: leave it out", key)
    negative = ARCHIMEDEAN[kind].negative
    if value < 0.0 and (not negative or size > 2):
        allowed = f"{name}'s ties no more than two inputs" if negative else f"{name}'s has none"
        raise LawError(
            f"{key} must be above 0 here, found {value:g}: of negative dependence {allowed}; "
            "take a Gaussian or Student t copula",
            key,
        )
    if abs(value) > _STRONGEST:
        raise LawError(f"{key} must be at most {_STRONGEST} with {name}'s copula, found {value:g}", key)


def _strength(kind: str, key: str, value: float, dof: float = math.inf) -> float:
    """theta of an Archimedean copula, the correlation of the scores of an elliptical one; from Kendall's tau that is
    sin(πτ/2) for every dof (Lindskog, McNeil, Schmock 2003)."""
    if key == "spearman" and kind == "gaussian":
        return 2.0 * math.sin(math.pi * value / 6.0)
    if key == "spearman":
        return math.copysign(_solved(kind, abs(value), dof), value)
    if kind in ARCHIMEDEAN:
        return math.copysign(ARCHIMEDEAN[kind].strength(abs(value)), value)
    return math.sin(0.5 * math.pi * value)


@lru_cache(maxsize=256)
def _solved(kind: str, spearman: float, dof: float) -> float:
    """theta, or the t copula's correlation, with this Spearman's rho >= 0.

    rho = 12 E[U V] - 3 by the trapezoidal rule over independent normal scores, which converges geometrically for
    smooth integrands; the search runs over Kendall's tau, in which all families are alike.
    """
    grid = np.linspace(-7.5, 7.5, 61)
    weight = np.exp(-0.5 * grid**2)
    weight /= weight.sum()
    first, second = (axis.reshape(-1) for axis in np.meshgrid(grid, grid, indexing="ij"))
    mass = (weight[:, None] * weight[None, :]).reshape(-1) * special.ndtr(first)

    def gap(tau: float) -> float:
        copula: Copula
        value = _strength(kind, "kendall", tau)
        if kind == "student_t":
            copula = Elliptical(correlation=np.array([[1.0, value], [value, 1.0]]), dof=dof)
        else:
            copula = Archimedean(generator=ARCHIMEDEAN[kind], size=2, theta=value)
        v = special.ndtr(conditional_scores(copula, (0,), first[:, None], second[:, None])[:, 0])
        return 12.0 * float(mass @ v) - 3.0 - spearman

    if spearman == 0.0:
        return 0.0
    # tau lies below rho, and not below a third of it (Daniels 1950 bounds their distance)
    return _strength(kind, "kendall", root(gap, spearman / 3.0, 0.5 * (1.0 + spearman), xtol=1e-10))


def conditional_score(copula: Copula, target: int, given: Sequence[int], known: Array, score: Array) -> Array:
    """Normal score (n,) of P(member `target` <= `score` | members `given` at the scores `known` (n, j)).

    Increasing in `score`; the score itself where nothing is given.

    >>> pair = make_copula("clayton", 2, kendall=0.5)
    >>> bool(conditional_score(pair, 1, (0,), np.array([[-2.0]]), np.array([0.0]))[0] > 0.0)
    True
    """
    score = np.asarray(score, dtype=float)
    return copula.conditional_score(target, given, known, score) if len(given) else score


def conditional_scores(copula: Copula, given: Sequence[int], known: Array, normals: Array) -> Array:
    """Scores (n, size - j) of the members not given, in their order, given j members at the scores `known` (n, j).

    `normals` (n, size - j) are independent standard normals, one for every member that is not given.
    """
    known, normals = np.asarray(known, dtype=float), np.asarray(normals, dtype=float)
    rest = [member for member in range(copula.size) if member not in given]
    held, before = list(given), known
    found = np.empty_like(normals)
    for column, member in enumerate(rest):
        found[:, column] = copula.score_at(member, held, before, normals[:, column]) if held else normals[:, column]
        held = [*held, member]
        before = np.concatenate([before, found[:, column : column + 1]], axis=1)
    return found


def dependent_scores(copula: Copula, normals: Array) -> Array:
    """Independent standard normals (n, size) -> dependent normal scores (n, size): inverse Rosenblatt transform."""
    return conditional_scores(copula, (), np.empty((len(normals), 0)), normals)


def independent_scores(copula: Copula, scores: Array) -> Array:
    """Dependent normal scores (n, size) -> independent standard normals (n, size): Rosenblatt transform."""
    found = np.empty_like(scores)
    for member in range(copula.size):
        before = list(range(member))
        found[:, member] = conditional_score(copula, member, before, scores[:, :member], scores[:, member])
    return found


# --- several inputs ----------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Tie:
    """An input that is not drawn, tied to some that are: the last member of `copula`, given the scores of the others.

    `given` (..., size - 1) are normal scores; `of` says which columns of the drawn inputs they are.
    """

    copula: Copula
    given: Array
    of: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class Group:
    """Names that are tied by a copula other than the Gaussian; in the order of its members."""

    members: tuple[str, ...]
    copula: Copula


@dataclass(frozen=True, kw_only=True)
class Dependence:
    """One rank correlation, Spearman's or Kendall's, for every pair of the names; `dof` of a Student t copula."""

    of: tuple[str, ...]
    spearman: float | None = None
    kendall: float | None = None
    copula: str = "gaussian"
    dof: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Joint:
    """Named laws in a fixed order, and what ties them.

    `correlation` (d, d) is that of the normal scores under the Gaussian copula, None if no two are tied so; `groups`
    are tied by other copulas, and their members have no correlation here.

    >>> from uqsphere.uq.law import make_law
    >>> two = Joint(names=("a", "b"), laws=(make_law("normal", {"mean": 1.0, "sd": 0.1}),
    ...                                     make_law("uniform", {}, 0.0, 2.0)))
    >>> two.physical(np.array([[0.0, 0.0]])).round(12).tolist()
    [[1.0, 1.0]]
    """

    names: tuple[str, ...]
    laws: tuple[Law, ...]
    correlation: Array | None = None
    groups: tuple[Group, ...] = ()

    def __post_init__(self) -> None:
        if len(self.names) != len(self.laws) or len(set(self.names)) != len(self.names):
            raise LawError(f"{len(self.laws)} laws need as many different names, found {list(self.names)}")
        if self.correlation is not None:
            _factor(self.names, np.asarray(self.correlation, dtype=float))
        _check_groups(self)

    @property
    def dependent(self) -> bool:
        """Whether any input depends on another."""
        return self.correlation is not None or bool(self.groups)

    @cached_property
    def _lower(self) -> Array | None:
        return None if self.correlation is None else _factor(self.names, self.correlation)

    # --- from independent normals to inputs -------------------------------------------------------------

    def scores(self, normals: Array) -> Array:
        """Independent standard normals (..., d) -> dependent normal scores (..., d)."""
        normals = np.asarray(normals, dtype=float)
        rows = normals.reshape(int(np.prod(normals.shape[:-1])), normals.shape[-1])  # d may be 0
        if self._lower is not None:
            rows = rows @ self._lower.T
        if self.groups:
            rows = rows.copy()
            for group in self.groups:
                at = [self.names.index(name) for name in group.members]
                rows[:, at] = dependent_scores(group.copula, rows[:, at])
        return rows.reshape(normals.shape)

    def marginal(self, scores: Array) -> Array:
        """Dependent normal scores (..., d) -> inputs (..., d) in SI: the laws alone."""
        physical = np.empty_like(scores)
        for column, law in enumerate(self.laws):
            physical[..., column] = law.from_normal(scores[..., column])
        return physical

    def physical(self, normals: Array) -> Array:
        """Independent standard normals (..., d) -> inputs (..., d) in SI, with laws and copulas in force."""
        return self.marginal(self.scores(normals))

    # --- some inputs, and some given others -----------------------------------------------------------------

    def only(self, names: Sequence[str]) -> Joint:
        """Some of the inputs, with what ties them to each other."""
        at = [self.names.index(name) for name in names]
        correlation = None
        if self.correlation is not None:
            correlation = self.correlation[np.ix_(at, at)]
            if not np.any(correlation - np.eye(len(at))):
                correlation = None
        groups = []
        for group in self.groups:
            kept = [k for k, name in enumerate(group.members) if name in names]
            if len(kept) > 1:
                members = tuple(group.members[k] for k in kept)
                groups.append(Group(members=members, copula=group.copula.among(kept)))
        laws = tuple(self.laws[k] for k in at)
        return Joint(names=tuple(names), laws=laws, correlation=correlation, groups=tuple(groups))

    def blocks(self) -> list[tuple[tuple[int, ...], Copula]]:
        """Columns that are tied to each other, with their copula; all that the Gaussian one ties are one block."""
        found: list[tuple[tuple[int, ...], Copula]] = [
            (tuple(self.names.index(name) for name in group.members), group.copula) for group in self.groups
        ]
        if self.correlation is not None:
            off = np.abs(self.correlation - np.eye(len(self.names))).max(axis=1) > 0.0
            tied = tuple(int(k) for k in np.flatnonzero(off))
            if tied:
                found.insert(0, (tied, Elliptical(correlation=self.correlation[np.ix_(tied, tied)])))
        return found

    def tied(self) -> list[str]:
        """Names that depend on another one, in order."""
        tied = {column for columns, _ in self.blocks() for column in columns}
        return [name for column, name in enumerate(self.names) if column in tied]

    def given(self, columns: Sequence[int], scores: Array, normals: Array) -> Array:
        """Dependent scores (n, d): `columns` as in `scores` (n, d), the others drawn afresh given those.

        `normals` (n, d) are independent standard normals; those of the given columns are not used.
        """
        found = np.array(normals, dtype=float)
        held = set(columns)
        found[:, list(columns)] = scores[:, list(columns)]
        for block, copula in self.blocks():
            fixed = [k for k, column in enumerate(block) if column in held]
            free = [column for column in block if column not in held]
            if free:
                known = found[:, [block[k] for k in fixed]]
                found[:, free] = conditional_scores(copula, fixed, known, normals[:, free])
        return found

    def regression(self, target: str, given: Sequence[str]) -> tuple[Array, float]:
        """Normal score of `target` given the normal scores of `given`: weights (k,) and remaining sd.

        z_target | z_given is normal with mean weights · z_given and standard deviation sd; independent: 0, 1.
        """
        if self.correlation is None or not given:
            return np.zeros(len(given)), 1.0
        at = self.names.index(target)
        others = [self.names.index(name) for name in given]
        within = self.correlation[np.ix_(others, others)]
        across = self.correlation[others, at]
        weights = np.asarray(np.linalg.solve(within, across), dtype=np.float64)
        return weights, math.sqrt(max(0.0, 1.0 - float(across @ weights)))

    def tie(self, target: str, drawn: Sequence[str], scores: Array) -> Tie | None:
        """What ties `target`, which is not drawn, to the drawn inputs at their dependent scores (..., d).

        None where it depends on none of them or by the Gaussian copula, for which there is `regression`.
        """
        for group in self.groups:
            if target not in group.members:
                continue
            known = [name for name in group.members if name in drawn]
            if not known:
                return None
            copula = group.copula.among([group.members.index(name) for name in (*known, target)])
            of = tuple(list(drawn).index(name) for name in known)
            return Tie(copula=copula, given=scores[..., list(of)], of=of)
        return None


def _check_groups(inputs: Joint) -> None:
    taken: set[str] = set()
    if inputs.correlation is not None and inputs.groups:
        tied = np.abs(inputs.correlation - np.eye(len(inputs.names))).max(axis=1) > 0.0
        taken = {name for name, is_tied in zip(inputs.names, tied, strict=True) if is_tied}
    for group in inputs.groups:
        if group.copula.size != len(group.members):
            raise LawError(f"a copula of {group.copula.size} members cannot tie {list(group.members)}", "of")
        for name in group.members:
            if name not in inputs.names:
                known = ", ".join(inputs.names) or "none"
                raise LawError(f"{name!r} is not a random input; random are: {known}", "of")
            if name in taken:
                raise LawError(
                    f"{name} is in more than one dependence, and one of them is not Gaussian: name all that depend "
                    "on each other in one dependence, or take Gaussian copulas",
                    "of",
                )
            taken.add(name)


def _factor(names: Sequence[str], correlation: Array) -> Array:
    """Lower Cholesky factor (d, d) of a correlation matrix; raises LawError where it is not one."""
    d = len(names)
    if correlation.shape != (d, d):
        raise LawError(f"the correlation matrix must be {d} x {d}, found shape {correlation.shape}")
    if not np.isfinite(correlation).all() or not np.allclose(np.diag(correlation), 1.0, rtol=0.0, atol=1e-12):
        raise LawError("the correlation matrix must be finite with ones on its diagonal")
    if not np.allclose(correlation, correlation.T, rtol=0.0, atol=1e-12):
        raise LawError("the correlation matrix must be symmetric")
    smallest = float(np.linalg.eigvalsh(correlation)[0]) if d else 1.0
    if smallest < 1e-10:
        raise LawError(
            f"the dependences cannot hold together: the correlation matrix is not positive definite "
            f"(smallest eigenvalue {smallest:.3g}); weaken or remove some of them",
            "spearman",
        )
    return np.asarray(np.linalg.cholesky(correlation), dtype=np.float64)


def correlation_from_spearman(names: Sequence[str], groups: Sequence[tuple[tuple[str, ...], float]]) -> Array | None:
    """Correlation (d, d) of the normal scores from rank correlations that hold for every pair of a group.

    None if nothing depends on anything.  Raises LawError (keys "of", "spearman") for unknown or repeated
    names, a pair given twice, |rho| >= 1, and a matrix that is not positive definite.
    """
    correlation = np.eye(len(names))
    tied: set[tuple[int, int]] = set()
    for members, spearman in groups:
        if unknown := [name for name in members if name not in names]:
            raise LawError(f"{unknown[0]!r} is not a random input; random are: {', '.join(names) or 'none'}", "of")
        if len(members) < 2 or len(set(members)) != len(members):
            raise LawError(f"a dependence needs two or more different inputs, found {list(members)}", "of")
        for pair in combinations(sorted(map(list(names).index, members)), 2):
            if not (math.isfinite(spearman) and -1.0 < spearman < 1.0):
                raise LawError(f"spearman must lie strictly between -1 and 1, found {spearman:g}", "spearman")
            if pair in tied:
                one, other = (names[k] for k in pair)
                raise LawError(f"the dependence of {one} and {other} is given twice", "of")
            tied.add(pair)
            correlation[pair] = correlation[pair[::-1]] = 2.0 * math.sin(math.pi * spearman / 6.0)
    if not np.any(correlation - np.eye(len(names))):
        return None
    _factor(names, correlation)
    return correlation


def make_joint(names: Sequence[str], laws: Sequence[Law], dependences: Sequence[Dependence]) -> Joint:
    """Inputs with the dependences of a study.

    Raises LawError (keys "of", "spearman", "kendall", "dof", "copula") where they cannot hold.

    >>> from uqsphere.uq.law import make_law
    >>> law = make_law("normal", {"mean": 0.0, "sd": 1.0})
    >>> made = make_joint(("a", "b", "c"), (law,) * 3, [Dependence(of=("a", "c"), kendall=0.5, copula="clayton")])
    >>> made.groups[0].copula.theta, made.correlation is None
    (2.0, True)
    """
    gaussian = [(tie.of, _spearman(tie)) for tie in dependences if tie.copula == "gaussian"]
    groups = []
    for tie in dependences:
        if tie.copula == "gaussian":
            continue
        if len(set(tie.of)) != len(tie.of):
            raise LawError(f"a dependence needs two or more different inputs, found {list(tie.of)}", "of")
        copula = make_copula(tie.copula, len(tie.of), spearman=tie.spearman, kendall=tie.kendall, dof=tie.dof)
        groups.append(Group(members=tie.of, copula=copula))
    correlation = correlation_from_spearman(names, gaussian) if gaussian else None
    return Joint(names=tuple(names), laws=tuple(laws), correlation=correlation, groups=tuple(groups))


def _spearman(tie: Dependence) -> float:
    """Spearman's rho of a Gaussian dependence that may be given by Kendall's tau."""
    if tie.spearman is not None:
        return tie.spearman
    if tie.kendall is None or not -1.0 < tie.kendall < 1.0:
        raise LawError(f"kendall must lie strictly between -1 and 1, found {tie.kendall}", "kendall")
    return 6.0 / math.pi * math.asin(0.5 * math.sin(0.5 * math.pi * tie.kendall))
