"""Columns of a table that others give exactly: copies and linear combinations, which no analysis can tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uqsphere.uq.families import Array

__all__ = ["Combination", "combinations"]

#: what is left of a column over its standard deviation, below which others give it: files keep seven figures and more
_LEFT = 1e-6
#: rows beyond the columns that take part, from which on a combination is no accident of few rows
_SPARE = 5
#: columns that are named
_NAMED = 6


@dataclass(frozen=True, kw_only=True)
class Combination:
    """Column `column` = `constant` + the sum of `factors` times the columns `of`."""

    column: int
    of: tuple[int, ...]
    factors: tuple[float, ...]
    constant: float

    def text(self, names: Sequence[str]) -> str:
        """In words, with the names of all columns."""
        name = names[self.column]
        if len(self.of) == 1:
            return f"{name} tells the same as {names[self.of[0]]}: leave one of them out"
        signed = [(self.constant, "")] if self.constant else []
        signed += [(factor, names[j]) for j, factor in zip(self.of, self.factors, strict=True)]
        formula = " ".join(_term(*term) for term in signed[:_NAMED]).removeprefix("+ ")
        more = f" and {len(signed) - _NAMED} terms more" if len(signed) > _NAMED else ""
        return (
            f"{name} is an exact linear combination of other columns, {name} = {formula}{more}: leave one of them out, "
            "since nothing tells what each of them does"
        )


def _term(factor: float, name: str) -> str:
    """A signed term of a sum, without a factor of one."""
    size = f"{abs(factor):.4g}"
    parts = ["-" if factor < 0.0 else "+", *([] if size == "1" and name else [size]), name]
    return " ".join(part for part in parts if part)


def combinations(x: Array) -> list[Combination]:
    """Columns of x (n, d) that those before them give exactly; columns that do not vary are left out.

    >>> x = np.random.default_rng(1).normal(size=(50, 2))
    >>> found = combinations(np.column_stack([x, x[:, 0] + 2.0 * x[:, 1]]))
    >>> found[0].column, found[0].of, [round(factor, 6) for factor in found[0].factors]
    (2, (0, 1), [1.0, 2.0])
    """
    found = []
    kept: list[int] = []
    spread, centre = x.std(axis=0), x.mean(axis=0)
    basis: list[Array] = []
    for k in range(x.shape[1]):
        if not (np.isfinite(spread[k]) and spread[k] > 1e-14 * abs(centre[k])):
            continue
        column = (x[:, k] - centre[k]) / spread[k]
        left = column.copy()
        for _ in range(2):  # a second time for what rounding left
            for q in basis:
                left -= (q @ left) * q
        size = float(np.linalg.norm(left))
        if size > _LEFT * float(np.linalg.norm(column)):
            basis.append(left / size)
            kept.append(k)
        elif len(x) >= len(kept) + 1 + _SPARE:
            scaled = (x[:, kept] - centre[kept]) / spread[kept]
            weights = np.linalg.lstsq(scaled, column, rcond=None)[0]
            of = [(j, float(w * spread[k] / spread[j])) for j, w in zip(kept, weights, strict=True) if abs(w) > 1e-5]
            constant = float(centre[k] - sum(factor * centre[j] for j, factor in of))
            found.append(
                Combination(
                    column=k,
                    of=tuple(j for j, _ in of),
                    factors=tuple(factor for _, factor in of),
                    constant=constant if abs(constant) > 1e-5 * spread[k] else 0.0,
                )
            )
    return found
