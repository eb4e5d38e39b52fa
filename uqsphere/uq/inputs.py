"""Several inputs together: their laws, and the Gaussian copula that ties them.

The copula is given by the Pearson correlation of the normal scores; a Spearman rank correlation rho_S
becomes 2 sin(pi rho_S / 6) (Pearson 1907; exact for the Gaussian copula).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uqsphere.uq.families import Array
from uqsphere.uq.laws import Law, LawError, from_normal

__all__ = ["Inputs", "conditional_normal", "correlation_from_spearman", "physical_from_normal", "to_physical"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Inputs:
    """Named laws in a fixed order; `correlation` (d, d) of their normal scores, None if independent."""

    names: tuple[str, ...]
    laws: tuple[Law, ...]
    correlation: Array | None = None

    def __post_init__(self) -> None:
        if len(self.names) != len(self.laws) or len(set(self.names)) != len(self.names):
            raise LawError(f"{len(self.laws)} laws need as many different names, found {list(self.names)}")
        if self.correlation is not None:
            _factor(self.names, np.asarray(self.correlation, dtype=float))


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


def physical_from_normal(inputs: Inputs, normals: Array) -> Array:
    """Independent standard normals (n, d) -> inputs (n, d) in SI, with marginals and copula in force."""
    normals = np.asarray(normals, dtype=float)
    if inputs.correlation is not None:
        normals = normals @ _factor(inputs.names, inputs.correlation).T
    physical = np.empty_like(normals)
    for column, law in enumerate(inputs.laws):
        physical[:, column] = from_normal(law, normals[:, column])
    return physical


def to_physical(inputs: Inputs, uniforms: Array) -> Array:
    """Independent uniforms (n, d) in the open unit interval -> inputs (n, d) in SI.

    >>> from uqsphere.uq.laws import make_law
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
