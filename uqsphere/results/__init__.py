"""What a run answers: one long table, kept in a folder of few files, and opened again."""

from .answers import COLUMNS
from .run import Run, open_run

__all__ = ["COLUMNS", "Run", "open_run"]
