"""Several inputs together: their laws, and the copulas that tie them.

The Gaussian copula is given by the Pearson correlation of the normal scores; a Spearman rank correlation rho_S
becomes 2 sin(pi rho_S / 6) (Pearson 1907; exact for the Gaussian copula).  Any number of groups with other copulas
stand beside it; an input belongs to one of them at most.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.elliptical import Copula, Tie, conditional_scores, dependent_scores, make_copula, members_of
from uqsphere.uq.law import Law, LawError

__all__ = [
    "Dependence",
    "Group",
    "Inputs",
    "blocks_of",
    "conditional_normal",
    "correlation_from_spearman",
    "make_inputs",
    "normal_scores",
    "physical_from_normal",
    "physical_from_scores",
    "rest_given",
    "strength_tie",
    "sub_inputs",
    "tied_names",
    "to_physical",
]


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
class Inputs:
    """Named laws in a fixed order; `correlation` (d, d) of their normal scores, None if no two are tied so.

    `groups` are tied by other copulas; their members have no correlation here.
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


def _check_groups(inputs: Inputs) -> None:
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


def normal_scores(inputs: Inputs, normals: Array) -> Array:
    """Independent standard normals (n, d) -> dependent normal scores (n, d)."""
    normals = np.asarray(normals, dtype=float)
    if inputs.correlation is not None:
        normals = normals @ _factor(inputs.names, inputs.correlation).T
    if inputs.groups:
        normals = normals.copy()
        for group in inputs.groups:
            at = [inputs.names.index(name) for name in group.members]
            normals[:, at] = dependent_scores(group.copula, normals[:, at])
    return normals


def physical_from_scores(inputs: Inputs, scores: Array) -> Array:
    """Dependent normal scores (n, d) -> inputs (n, d) in SI: the marginals alone."""
    physical = np.empty_like(scores)
    for column, law in enumerate(inputs.laws):
        physical[:, column] = law.from_normal(scores[:, column])
    return physical


def physical_from_normal(inputs: Inputs, normals: Array) -> Array:
    """Independent standard normals (n, d) -> inputs (n, d) in SI, with marginals and copulas in force."""
    return physical_from_scores(inputs, normal_scores(inputs, normals))


def to_physical(inputs: Inputs, uniforms: Array) -> Array:
    """Independent uniforms (n, d) in the open unit interval -> inputs (n, d) in SI.

    >>> from uqsphere.uq.law import make_law
    >>> two = Inputs(names=("a", "b"), laws=(make_law("normal", {"mean": 1.0, "sd": 0.1}),
    ...                                      make_law("uniform", {}, 0.0, 2.0)))
    >>> to_physical(two, np.array([[0.5, 0.25]])).round(12).tolist()
    [[1.0, 0.5]]
    """
    from scipy.special import ndtri

    return physical_from_normal(inputs, np.asarray(ndtri(np.asarray(uniforms, dtype=float))))


def correlation_from_spearman(names: Sequence[str], groups: Sequence[tuple[tuple[str, ...], float]]) -> Array | None:
    """Correlation (d, d) of the normal scores from rank correlations that hold for every pair of a group.

    None if nothing depends on anything.  Raises LawError (keys "of", "spearman") for unknown or repeated
    names, a pair given twice, |rho| >= 1, and a matrix that is not positive definite.
    """
    position = {name: index for index, name in enumerate(names)}
    correlation = np.eye(len(names))
    tied: set[tuple[int, int]] = set()
    for members, spearman in groups:
        unknown = [name for name in members if name not in position]
        if unknown:
            known = ", ".join(names) or "none"
            raise LawError(f"{unknown[0]!r} is not a random input; random are: {known}", "of")
        if len(members) < 2 or len(set(members)) != len(members):
            raise LawError(f"a dependence needs two or more different inputs, found {list(members)}", "of")
        if not (math.isfinite(spearman) and -1.0 < spearman < 1.0):
            raise LawError(f"spearman must lie strictly between -1 and 1, found {spearman:g}", "spearman")
        indices = sorted(position[name] for name in members)
        for at, i in enumerate(indices):
            for j in indices[at + 1 :]:
                if (i, j) in tied:
                    raise LawError(f"the dependence of {names[i]} and {names[j]} is given twice", "of")
                tied.add((i, j))
                correlation[i, j] = correlation[j, i] = 2.0 * math.sin(math.pi * spearman / 6.0)
    if not np.any(correlation - np.eye(len(names))):
        return None
    _factor(names, correlation)
    return correlation


def conditional_normal(inputs: Inputs, target: str, given: Sequence[str]) -> tuple[Array, float]:
    """Normal score of `target` given the normal scores of `given`: weights (k,) and remaining sd.

    z_target | z_given is normal with mean weights · z_given and standard deviation sd; independent: 0, 1.
    """
    if inputs.correlation is None or not given:
        return np.zeros(len(given)), 1.0
    at = inputs.names.index(target)
    others = [inputs.names.index(name) for name in given]
    within = inputs.correlation[np.ix_(others, others)]
    across = inputs.correlation[others, at]
    weights = np.asarray(np.linalg.solve(within, across), dtype=np.float64)
    return weights, math.sqrt(max(0.0, 1.0 - float(across @ weights)))


# --- groups, and some inputs given others ---------------------------------------------------------------


def make_inputs(names: Sequence[str], laws: Sequence[Law], dependences: Sequence[Dependence]) -> Inputs:
    """Inputs with the dependences of a study.

    Raises LawError (keys "of", "spearman", "kendall", "dof", "copula") where they cannot hold.

    >>> from uqsphere.uq.law import make_law
    >>> law = make_law("normal", {"mean": 0.0, "sd": 1.0})
    >>> made = make_inputs(("a", "b", "c"), (law,) * 3, [Dependence(of=("a", "c"), kendall=0.5, copula="clayton")])
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
    return Inputs(
        names=tuple(names),
        laws=tuple(laws),
        correlation=correlation_from_spearman(names, gaussian) if gaussian else None,
        groups=tuple(groups),
    )


def _spearman(tie: Dependence) -> float:
    """Spearman's rho of a Gaussian dependence that may be given by Kendall's tau."""
    if tie.spearman is not None:
        return tie.spearman
    if tie.kendall is None or not -1.0 < tie.kendall < 1.0:
        raise LawError(f"kendall must lie strictly between -1 and 1, found {tie.kendall}", "kendall")
    return 6.0 / math.pi * math.asin(0.5 * math.sin(0.5 * math.pi * tie.kendall))


def sub_inputs(inputs: Inputs, names: Sequence[str]) -> Inputs:
    """Some of the inputs, with what ties them to each other."""
    at = [inputs.names.index(name) for name in names]
    correlation = None
    if inputs.correlation is not None:
        correlation = inputs.correlation[np.ix_(at, at)]
        if not np.any(correlation - np.eye(len(at))):
            correlation = None
    groups = []
    for group in inputs.groups:
        kept = [k for k, name in enumerate(group.members) if name in names]
        if len(kept) > 1:
            members = tuple(group.members[k] for k in kept)
            groups.append(Group(members=members, copula=members_of(group.copula, kept)))
    return Inputs(
        names=tuple(names), laws=tuple(inputs.laws[k] for k in at), correlation=correlation, groups=tuple(groups)
    )


def blocks_of(inputs: Inputs) -> list[tuple[tuple[int, ...], Copula]]:
    """Columns that are tied to each other, with their copula; all that are tied by the Gaussian one are one block."""
    found = [(tuple(inputs.names.index(name) for name in group.members), group.copula) for group in inputs.groups]
    if inputs.correlation is not None:
        off = np.abs(inputs.correlation - np.eye(len(inputs.names))).max(axis=1) > 0.0
        tied = tuple(int(k) for k in np.flatnonzero(off))
        if tied:
            correlation = inputs.correlation[np.ix_(tied, tied)]
            found.insert(0, (tied, Copula(kind="gaussian", size=len(tied), correlation=correlation)))
    return found


def tied_names(inputs: Inputs) -> list[str]:
    """Names that depend on another one, in order."""
    tied = {column for columns, _ in blocks_of(inputs) for column in columns}
    return [name for column, name in enumerate(inputs.names) if column in tied]


def rest_given(inputs: Inputs, given: Sequence[int], scores: Array, normals: Array) -> Array:
    """Dependent scores (n, d): columns `given` as in `scores` (n, d), the others drawn afresh given those.

    `normals` (n, d) are independent standard normals; those of the given columns are not used.
    """
    found = np.array(normals, dtype=float)
    held = set(given)
    found[:, list(given)] = scores[:, list(given)]
    for columns, copula in blocks_of(inputs):
        fixed = [k for k, column in enumerate(columns) if column in held]
        free = [column for column in columns if column not in held]
        if free:
            known = found[:, [columns[k] for k in fixed]]
            found[:, free] = conditional_scores(copula, fixed, known, normals[:, free])
    return found


def strength_tie(inputs: Inputs, target: str, drawn: Sequence[str], scores: Array) -> Tie | None:
    """What ties `target`, which is not drawn, to the drawn inputs at their dependent scores (..., d).

    None where it depends on none of them or by the Gaussian copula, for which there is `conditional_normal`.
    """
    for group in inputs.groups:
        if target not in group.members:
            continue
        known = [name for name in group.members if name in drawn]
        if not known:
            return None
        copula = members_of(group.copula, [group.members.index(name) for name in (*known, target)])
        of = tuple(list(drawn).index(name) for name in known)
        return Tie(copula=copula, given=scores[..., list(of)], of=of)
    return None
