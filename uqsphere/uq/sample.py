"""The one table of rows: where the points of a design lie, and the answers there."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from uqsphere.arrays import Array, Cells, Flags, Names, Places, frozen

_ROWS = ("scores", "inputs", "answers", "censored", "status")


@frozen
class Sample:
    """R replicates of n rows, each an independent randomisation of the same design; without scatter
    R = n = 1.

    Attributes
    ----------
    names : the D random variables, in the order of the columns; behind them numbers that move
    scores, inputs : their independent standard normals and their physical values [SI], (R, n, D)
        each; numbers that move have values alone
    quantities : the q answers, in the order of the columns; none before the rows are evaluated
    answers, censored : values [SI], and whether they outlast the record, (R, n, q) each
    status : the model's code of each row (R, n)
    """

    names: Names
    scores: Array
    inputs: Array
    quantities: Names
    answers: Array
    censored: Flags
    status: Places

    @classmethod
    def at(cls, names: Names, scores: Array, inputs: Array) -> "Sample":
        """Points that are not evaluated yet."""
        shape = scores.shape[:2]
        none = np.empty((*shape, 0))
        return cls(
            names=tuple(names),
            scores=scores,
            inputs=inputs,
            quantities=(),
            answers=none,
            censored=none.astype(bool),
            status=np.zeros(shape, int),
        )

    @property
    def replicates(self) -> int:
        """Randomisations."""
        return len(self.scores)

    @property
    def count(self) -> int:
        """Rows of each replicate."""
        return len(self.scores[0])

    @property
    def size(self) -> int:
        """Rows in all."""
        return self.replicates * self.count

    @property
    def failed(self) -> Flags:
        """Whether an answer of a row is missing (R, n)."""
        return self.status.astype(bool)

    def input(self, name: str) -> Array:
        """Physical values (R, n) of a random variable."""
        return self.inputs[:, :, self.names.index(name)]

    def answer(self, quantity: str) -> Array:
        """Values (R, n) of a quantity."""
        return self.answers[:, :, self.quantities.index(quantity)]

    def late(self, quantity: str) -> Flags:
        """Whether a quantity outlasts the record, (R, n)."""
        return self.censored[:, :, self.quantities.index(quantity)]

    def outputs(self, quantity: str) -> Array:
        """Values (R n,) of a quantity, nan where there is none: a failed row may still have
        others.
        """
        values = self.answer(quantity)
        return np.where(self.failed & ~np.isfinite(values), np.nan, values).ravel()

    def knows(self, quantity: str) -> bool:
        """Whether a quantity is a plain number in every row."""
        odd = self.late(quantity) | ~np.isfinite(self.answer(quantity))
        return not (odd.any() or self.failed.any())

    def with_answers(self, quantities: Names, answers: Array, **flags: Any) -> "Sample":
        """The same points with answers (R, n, q); `censored` and `status` are zero unless given."""
        zero = {"censored": np.zeros(answers.shape, bool), "status": np.zeros_like(self.status)}
        return replace(self, quantities=tuple(quantities), answers=answers, **(zero | flags))

    def with_room(self, count: int) -> "Sample":
        """The same rows in arrays of `count` rows of each replicate; those behind have no content
        until `fill`.
        """

        def longer(cells: Cells) -> Cells:
            room = np.empty((cells.shape[0], count, *cells.shape[2:]), cells.dtype)
            room[:, : self.count] = cells
            return room

        return self._each(longer)

    def fill(self, start: int, part: "Sample") -> None:
        """Put the rows of a part in the place of rows of every replicate, from the `start`-th
        on.
        """
        for name in _ROWS:
            getattr(self, name)[:, start : start + part.count] = getattr(part, name)

    def join(self, *others: "Sample") -> "Sample":
        """This sample and the rows that continue every replicate."""
        parts = self, *others
        joined: dict[str, Any] = {}
        for name in _ROWS:
            joined[name] = np.concatenate([getattr(part, name) for part in parts], axis=1)
        return replace(self, **joined)

    def head(self, count: int) -> "Sample":
        """The first rows of every replicate."""
        return self.where(slice(count))

    def in_blocks(self, count: int) -> "Sample":
        """The rows of one replicate as those of `count` replicates."""
        return self._each(lambda cells: cells.reshape(count, -1, *cells.shape[2:]))

    def where(self, which: Flags | Places | slice) -> "Sample":
        """Some rows of every replicate, by flags (n,), their places or a slice of these."""
        return self._each(lambda cells: cells[:, which])

    def _each(self, change: Callable[[Cells], Cells]) -> "Sample":
        changed: dict[str, Any] = {name: change(getattr(self, name)) for name in _ROWS}
        return replace(self, **changed)
