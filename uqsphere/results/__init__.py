"""What a run answers: one long table, kept in a folder of few files, and opened again."""

from .answers import COLUMNS, Answers
from .run import Run, open_run

__all__ = ["COLUMNS", "Answers", "Run", "open_run"]
