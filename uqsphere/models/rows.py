"""Rows of answers, and the states that a row can be in."""

import numpy as np

from uqsphere.arrays import Array, Flags, Names, Places, frozen

#: status of a row that a black box has no answer to; 1 to 5 are those of the impact model
FAILED = 6
#: inputs that a note names
_MOST_NAMED = 6


class Interrupted(Exception):
    """`stop` was true between two calls of the model. What a slow black box has answered is in the
    cache.
    """


class NoAnswer(Exception):
    """A call of a black box has no answer: what happened."""


class Died(NoAnswer):
    """The process that it ran in ended."""


@frozen
class EvaluatedRows:
    """Answers of n rows.

    values : (n, q), SI, in the order of the columns that were requested; NaN where a row failed.
    censored : (n, q); the value is a lower bound, since the record ended first.
    status : (n,); 0 for an answer, else a code of `mechanics.scene.STATUS` or `FAILED`.
    note : what happened at the first row that failed, and where; empty if none failed.
    """

    values: Array
    censored: Flags
    status: Places
    note: str

    @property
    def good(self) -> Flags:
        """Which rows have an answer, (n,)."""
        return np.asarray(self.status == 0)


def where_of(names: Names, row: Array) -> str:
    """The inputs (d,) of a row, in words.

    >>> where_of(("a", "b"), np.array([1.0, 0.25]))
    'at a = 1, b = 0.25'
    """
    shown = [f"{name} = {value:.6g}" for name, value in zip(names, row.tolist(), strict=True)]
    if not shown:
        return "in the only row"
    text = f"at {', '.join(shown[:_MOST_NAMED])}"
    if len(shown) > _MOST_NAMED:
        text += f" and {len(shown) - _MOST_NAMED} more inputs"
    return text
