"""The design behind sampled Sobol' indices: which columns of two or three independent halves a block takes from which.

A design has two independent halves A and B (N, d) and blocks mixed from them: AB_u is A with the columns u of B,
BA_u is B with the columns u of A; Owen's estimator adds AC_u, with the columns of a third half C.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.sampling import sobol_points

__all__ = ["Blocks", "Outputs", "uniform_halves"]


@dataclass(frozen=True, kw_only=True)
class Blocks:
    """The blocks of a design: A, AB_1 ... AB_d, B, then BA_1 ... BA_d (`second`), AB_g of groups, AC_j (`third`).

    Evaluations for each base point: d + 2, and d more for second order, one more for each group, and d more for
    the third half C of Owen's estimator, which also takes the blocks of second order.

    >>> Blocks(inputs_count=3).count, Blocks(inputs_count=3, second=True, groups=((0, 1),)).count
    (5, 9)
    """

    inputs_count: int
    second: bool = False
    groups: tuple[tuple[int, ...], ...] = ()
    third: bool = False

    def __post_init__(self) -> None:
        if self.third and not self.second:
            raise ValueError("the third half is used with the blocks of second order: set second as well")
        for group in self.groups:
            if not group or len(set(group)) != len(group) or not all(0 <= k < self.inputs_count for k in group):
                raise ValueError(f"a group names inputs from 0 to {self.inputs_count - 1}, each once; found {group}")

    @property
    def count(self) -> int:
        """Evaluations for each base point."""
        d = self.inputs_count
        return d + 2 + d * self.second + len(self.groups) + d * self.third

    @property
    def halves(self) -> int:
        """Independent halves that the design is mixed from."""
        return 3 if self.third else 2

    def mix(self, *halves: Array) -> Array:
        """Blocks (N, count, d) of halves A, B (and C), (N, d) each; of uniforms or of what they are mapped to.

        >>> rows = Blocks(inputs_count=2, second=True).mix(np.array([[1.0, 2.0]]), np.array([[3.0, 4.0]]))
        >>> rows[0].tolist()
        [[1.0, 2.0], [3.0, 2.0], [1.0, 4.0], [3.0, 4.0], [1.0, 4.0], [3.0, 2.0]]
        """
        d = self.inputs_count
        if len(halves) != self.halves or any(half.shape != halves[0].shape or half.shape[1] != d for half in halves):
            raise ValueError(f"{self.halves} halves (N, {d}) are due, found {[half.shape for half in halves]}")
        a, b = halves[:2]
        inputs = np.arange(d)
        blocks = np.repeat(a[:, None, :], self.count, axis=1)
        blocks[:, inputs + 1, inputs] = b
        blocks[:, d + 1] = b
        at = d + 2
        if self.second:
            blocks[:, at : at + d] = b[:, None, :]
            blocks[:, at + inputs, inputs] = a
            at += d
        for group in self.groups:
            blocks[:, at, list(group)] = b[:, list(group)]
            at += 1
        if self.third:
            blocks[:, at + inputs, inputs] = halves[2]
        return blocks

    def split(self, outputs: Array) -> Outputs:
        """The outputs (R, N, count) by block, about their common mean; refuses what is not finite."""
        d = self.inputs_count
        outputs = np.asarray(outputs, dtype=float)
        if outputs.ndim != 3 or outputs.shape[2] != self.count or outputs.shape[1] < 2 or outputs.shape[0] < 2:
            raise ValueError(f"outputs must have shape (R, N, {self.count}), R >= 2, N >= 2; found {outputs.shape}")
        if not np.isfinite(outputs).all():
            bad = int((~np.isfinite(outputs)).sum())
            raise ValueError(f"{bad} outputs are not finite: indices of them mean nothing; drop those rows first")
        base = outputs[:, :, [0, d + 1]]
        centre, largest = float(base.mean()), float(np.abs(base).max())
        varies = bool(np.ptp(base) > 1e-14 * largest)
        # Scaled by a power of two, which is exact, so that outputs of 1e300 have squares.
        scale = 2.0 ** -np.frexp(np.abs(base - centre).max())[1] if varies and np.isfinite(centre) else 1.0
        y = (outputs - centre) * scale
        at = d + 2
        ba = y[:, :, at : at + d] if self.second else None
        at += d * self.second
        groups = y[:, :, at : at + len(self.groups)]
        at += len(self.groups)
        return Outputs(
            a=y[:, :, :1],
            ab=y[:, :, 1 : d + 1],
            b=y[:, :, d + 1 : d + 2],
            ba=ba,
            groups=groups,
            ac=y[:, :, at:] if self.third else None,
            varies=varies,
            evaluations=outputs.size,
        )


@dataclass(frozen=True, kw_only=True)
class Outputs:
    """Centred outputs by block: a, b (R, N, 1), ab, ba, ac (R, N, d) and groups (R, N, G)."""

    a: Array
    b: Array
    ab: Array
    ba: Array | None
    groups: Array
    ac: Array | None
    varies: bool
    evaluations: int


def uniform_halves(
    blocks: Blocks, *, count: int, seed: int, task: str, replicate: int, start: int = 0
) -> tuple[Array, ...]:
    """Uniform halves A, B (and C), (count, d) each, of one replicate; `start` continues the same design.

    They are the columns of one scrambled Sobol' sequence, so that all halves together are evenly spread.
    """
    d = blocks.inputs_count
    points = sobol_points(
        dimension=blocks.halves * d, count=count, start=start, seed=seed, task=task, replicate=replicate
    )
    return tuple(points[:, k * d : (k + 1) * d] for k in range(blocks.halves))
