"""The long table of answers: one row an answer, SI units, with its 95 % interval and where it comes
from.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

from uqsphere.quantities import lookup
from uqsphere.uq import Estimate

from .types import OF_QUANTITY, Answer, Kind

if TYPE_CHECKING:
    import pandas as pd

#: rows as an analysis makes them
Rows = Iterator[Answer]
#: columns of answers.csv and of `Run.answers`
COLUMNS = tuple(Answer.model_fields)


def estimate_row(
    subject: str, answer: str, estimate: Estimate, at: float | str = "", **origin: Any
) -> Answer:
    """A row of an estimate, with its runs; one without a value leaves its reason as the note."""
    low, high = estimate.outer
    return number_row(
        subject,
        answer,
        at,
        estimate.value,
        estimate.low,
        estimate.high,
        low_unseen=low,
        high_unseen=high,
        std_error=estimate.std_error,
        method=estimate.method,
        note=estimate.reason or "",
        **origin,
    )


def number_row(
    subject: str,
    answer: str,
    at: float | str,
    value: float | None,
    low: float | None = None,
    high: float | None = None,
    **origin: Any,
) -> Answer:
    """A row of plain numbers, with further columns; what is not finite is left empty.

    The unit is that of the kind of answer, or of the quantity; others are given.
    """
    kind = Kind(answer)
    unit = kind.unit
    if unit == OF_QUANTITY:
        unit = lookup(subject).unit
    cells = {"unit": unit, "low_unseen": low, "high_unseen": high} | origin
    return Answer(subject=subject, answer=kind, at=at, value=value, low=low, high=high, **cells)


def frame_of(rows: Iterable[Answer]) -> pd.DataFrame:
    """Rows as a table with the columns in their order; empty numbers are nan."""
    import pandas as pd

    table = pd.DataFrame([row.model_dump(mode="json") for row in rows], columns=list(COLUMNS))
    numbers = ["value", "low", "high", "low_unseen", "high_unseen", "std_error"]
    return table.astype(dict.fromkeys(numbers, float))


def answers_csv(rows: Iterable[Answer]) -> str:
    """Rows as the text of answers.csv."""
    return csv_text(COLUMNS, (row.model_dump(mode="json").values() for row in rows))


def csv_text(names: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A table as CSV, in Python's shortest digits; None is an empty cell."""
    # not by pandas: a run that keeps its results in a folder would import it for nothing else
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows(rows)
    return text.getvalue()
