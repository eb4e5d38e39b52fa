"""Coverage of the intervals of a field, with all components that it takes and with one alone.

    python -m tests.campaigns.fields

The field y(t) = exp(a/2) sin(pi t) + b² cos(pi t) + a b t has two inputs that are uniform from -1 to 1; its means and
indices are those of Gauss's rule, its quantiles those of a million Sobol' points.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from tests.campaigns import options
from uqsphere.arrays import Array
from uqsphere.uq import fields
from uqsphere.uq.expansion import germ_points
from uqsphere.uq.fields import Band, answer_field
from uqsphere.uq.points import sobol_points

_GERMS = ("uniform", "uniform")
_T = np.linspace(0.0, 1.0, 50)
_LEVELS = (0.05, 0.5, 0.95)


def field(x: Array) -> Array:
    """Answers (n, m) at inputs (n, 2)."""
    a, b = x[:, :1], x[:, 1:]
    return np.asarray(np.exp(0.5 * a) * np.sin(np.pi * _T) + b**2 * np.cos(np.pi * _T) + a * b * _T)


def truth() -> dict[str, Array]:
    """Mean (m,), quantiles (3, m), first and total indices (2, m), aggregated ones (2, 1)."""
    nodes, weights = np.polynomial.legendre.leggauss(30)
    w = weights / 2.0
    grid = field(np.stack(np.meshgrid(nodes, nodes, indexing="ij"), axis=-1).reshape(-1, 2)).reshape(30, 30, -1)
    mean = np.einsum("i,j,ijm->m", w, w, grid)
    variance = np.einsum("i,j,ijm->m", w, w, (grid - mean) ** 2)
    alone = np.array(
        [w @ (np.einsum("j,ijm->im", w, grid) - mean) ** 2, w @ (np.einsum("i,ijm->jm", w, grid) - mean) ** 2]
    )
    total = variance - alone[::-1]
    rows = field(2.0 * sobol_points(dimension=2, count=1 << 20, seed=0, task="fields truth", replicate=0) - 1.0)
    return {
        "mean": mean, "quantiles": np.quantile(rows, _LEVELS, axis=0), "first": alone / variance,
        "total": total / variance, "aggregated first": (alone.sum(axis=1) / variance.sum())[:, None],
        "aggregated total": (total.sum(axis=1) / variance.sum())[:, None],
    }  # fmt: skip


def covered(rows: int, seed: int, exact: dict[str, Array]) -> dict[str, float]:
    """Share of each kind of interval of one design that holds the truth, and the share of the variance that is left."""
    uniforms = sobol_points(dimension=2, count=rows, seed=seed, task="fields campaign", replicate=0)
    points = germ_points(ndtri(uniforms), _GERMS)
    found = answer_field(points, field(points), _GERMS, _LEVELS, seed=seed)
    pairs = {"aggregated first": found.aggregated_first, "aggregated total": found.aggregated_total}
    bands: dict[str, Band] = {name: getattr(found, name) for name in ("mean", "quantiles", "first", "total")}
    for name, pair in pairs.items():
        columns = (np.array([[getattr(e, end)] for e in pair], dtype=float) for end in ("value", "low", "high"))
        bands[name] = Band(**dict(zip(("value", "low", "high"), columns, strict=True)))
    answer = {
        name: float(np.mean((b.low <= exact[name] + 1e-9) & (b.high >= exact[name] - 1e-9)))
        for name, b in bands.items()
    }
    return {**answer, "left": found.error}


def main() -> None:
    """Print the table."""
    asked = options("Coverage of the intervals of a field", designs=40, rows=[64, 128])
    exact, every = truth(), fields.MOST_COMPONENTS
    print("| components | rows | " + " | ".join([*exact, "variance left"]) + " |\n|" + "---|" * 9)
    for most in (every, 2, 1):
        fields.MOST_COMPONENTS = most  # type: ignore[misc]
        for rows in asked.rows:
            found = [covered(rows, seed, exact) for seed in range(asked.designs)]
            means = {name: np.mean([one[name] for one in found]) for name in found[0]}
            cells = [f"{100.0 * share:.1f} %" for name, share in means.items() if name != "left"]
            print(f"| {most} at most | {rows} | " + " | ".join([*cells, f"{means['left']:.1g}"]) + " |", flush=True)


if __name__ == "__main__":
    main()
