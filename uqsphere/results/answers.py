"""The long table of answers: one row an answer, SI units, with its 95 % interval and where it comes
from.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from uqsphere.uq import Estimate

if TYPE_CHECKING:
    import pandas as pd

#: columns of answers.csv and of `Run.answers`
COLUMNS: Final = (
    "subject",
    "answer",
    "at",
    "value",
    "low",
    "high",
    "std_error",
    "unit",
    "method",
    "runs",
    "note",
)

Row = dict[str, Any]


@dataclass(kw_only=True)
class Answers:
    """Rows of answers, looked up by subject, answer and place."""

    rows: list[Row] = field(default_factory=list)
    #: rows by subject and answer, of the first so many
    places: dict[tuple[str, str], list[Row]] = field(
        default_factory=dict, repr=False, compare=False
    )
    seen: int = field(default=0, repr=False, compare=False)

    def __iadd__(self, other: Answers) -> Answers:
        self.rows += other.rows
        return self

    def __iter__(self) -> Iterator[Row]:
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
        self.row(
            subject,
            answer,
            at,
            estimate.value,
            estimate.low,
            estimate.high,
            estimate.std_error,
            unit=unit,
            method=estimate.method,
            runs=runs,
            note=estimate.reason or "",
        )

    def row(
        self,
        subject: str,
        answer: str,
        at: float | str,
        value: float | None,
        low: float | None = None,
        high: float | None = None,
        std_error: float | None = None,
        *,
        unit: str,
        method: str = "",
        runs: int = 0,
        note: str = "",
    ) -> None:
        """A row of plain numbers; what is not finite is left empty."""
        numbers = [
            None if x is None or not math.isfinite(x) else float(x)
            for x in (value, low, high, std_error)
        ]
        place = at if isinstance(at, str) else float(at)
        self.rows.append(
            dict(
                zip(
                    COLUMNS,
                    (subject, answer, place, *numbers, unit, method, runs, note),
                    strict=True,
                )
            )
        )

    def get(self, subject: str, answer: str, at: float | str = "") -> Row | None:
        """The row of an answer, None where there is none."""
        return next((row for row in self.where(subject, answer) if row["at"] == at), None)

    def where(self, subject: str, answer: str) -> list[Row]:
        """All rows of an answer, in the order of their places."""
        for row in self.rows[self.seen :]:
            self.places.setdefault((row["subject"], row["answer"]), []).append(row)
        self.seen = len(self.rows)
        return self.places.get((subject, answer), [])

    def frame(self) -> pd.DataFrame:
        """The table as pandas has it; empty numbers are nan."""
        return frame_of(self.rows)


def frame_of(rows: list[Row]) -> pd.DataFrame:
    """Rows as a table with the columns in their order."""
    import pandas as pd

    table = pd.DataFrame(rows, columns=list(COLUMNS))
    numbers = ["value", "low", "high", "std_error"]
    table[numbers] = table[numbers].astype(float)
    return table


def as_json(value: object) -> Any:
    """A value as JSON holds it: NaN and infinity never appear, arrays and mappings are plain."""
    if isinstance(value, Mapping):
        return {str(key): as_json(own) for key, own in value.items()}
    if hasattr(value, "tolist"):
        return as_json(value.tolist())
    if isinstance(value, (list, tuple)):
        return [as_json(own) for own in value]
    if isinstance(value, bool) or value is None or isinstance(value, (str, int)):
        return value
    number = float(value)  # type: ignore[arg-type]
    return number if math.isfinite(number) else None
