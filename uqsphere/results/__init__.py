"""What a run answers: one long table, kept in a folder of few files, and opened again."""

from uqsphere.results.answers import COLUMNS, Answers
from uqsphere.results.run import Run, open_run

__all__ = ["COLUMNS", "Answers", "Run", "open_run"]
