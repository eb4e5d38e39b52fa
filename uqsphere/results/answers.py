"""The long table of answers: one row an answer, SI units, with its 95 % interval and where it comes
from.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Final, Required, TypedDict, Unpack

from uqsphere.results.types import Answer, Kind
from uqsphere.uq import Estimate

if TYPE_CHECKING:
    import pandas as pd

#: columns of answers.csv and of `Run.answers`
COLUMNS: Final = tuple(Answer.model_fields)


class Origin(TypedDict, total=False):
    """Unit of an answer and where it comes from."""

    unit: Required[str]
    method: str
    runs: int
    note: str


class Answers:
    """Rows of answers, looked up by subject, answer and place."""

    def __init__(self, rows: Iterable[Answer] = ()) -> None:
        self.rows = list(rows)
        #: rows by subject and answer, of the first so many
        self.places: dict[tuple[str, str], list[Answer]] = {}
        self.seen = 0

    def __iadd__(self, other: Answers) -> Answers:
        self.rows += other.rows
        return self

    def __iter__(self) -> Iterator[Answer]:
        return iter(self.rows)

    def add(
        self,
        subject: str,
        answer: str,
        at: float | str,
        estimate: Estimate,
        *,
        unit: str,
        runs: int,
    ) -> None:
        """An estimate; one without a value leaves its reason as the note."""
        low_unseen, high_unseen = estimate.outer
        self.rows.append(
            Answer(
                subject=subject,
                answer=Kind(answer),
                at=at if isinstance(at, str) else float(at),
                value=estimate.value,
                low=estimate.low,
                high=estimate.high,
                low_unseen=low_unseen,
                high_unseen=high_unseen,
                std_error=estimate.std_error,
                unit=unit,
                method=estimate.method,
                runs=runs,
                note=estimate.reason or "",
            )
        )

    def row(
        self,
        subject: str,
        answer: str,
        at: float | str,
        value: float | None,
        low: float | None = None,
        high: float | None = None,
        **origin: Unpack[Origin],
    ) -> None:
        """A row of plain numbers; what is not finite is left empty."""
        self.rows.append(
            Answer(
                subject=subject,
                answer=Kind(answer),
                at=at if isinstance(at, str) else float(at),
                value=value,
                low=low,
                high=high,
                low_unseen=low,
                high_unseen=high,
                **origin,
            )
        )

    def get(self, subject: str, answer: str, at: float | str = "") -> Answer | None:
        """The row of an answer, None where there is none."""
        return next((row for row in self.where(subject, answer) if row.at == at), None)

    def where(self, subject: str, answer: str) -> list[Answer]:
        """All rows of an answer, in the order of their places."""
        for row in self.rows[self.seen :]:
            self.places.setdefault((row.subject, row.answer), []).append(row)
        self.seen = len(self.rows)
        return self.places.get((subject, answer), [])

    def frame(self) -> pd.DataFrame:
        """The table as pandas has it; empty numbers are nan."""
        return frame_of(self.rows)


def frame_of(rows: Sequence[Answer]) -> pd.DataFrame:
    """Rows as a table with the columns in their order."""
    import pandas as pd

    table = pd.DataFrame(
        [{**vars(row), "answer": row.answer.value} for row in rows], columns=list(COLUMNS)
    )
    numbers = ["value", "low", "high", "low_unseen", "high_unseen", "std_error"]
    table[numbers] = table[numbers].astype(float)
    return table


def answers_csv(rows: Sequence[Answer]) -> str:
    """Rows as the text of answers.csv."""
    cells = ({**vars(row), "answer": row.answer.value} for row in rows)
    return csv_text(COLUMNS, ([row[name] for name in COLUMNS] for row in cells))


def csv_text(names: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A table as CSV, in Python's shortest digits; None is an empty cell."""
    # not by pandas: a run that keeps its results in a folder would import it for nothing else
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows(rows)
    return text.getvalue()
