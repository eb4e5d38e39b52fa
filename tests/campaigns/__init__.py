"""Evidence: measurements too long for a test, each run by `python -m tests.campaigns.NAME` (docs/validation.md)."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from typing import Any


def table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table in Markdown."""
    return "\n".join("| " + " | ".join(map(str, row)) + " |" for row in [header, ["---"] * len(header), *rows])


def tell(text: str) -> None:
    """Progress, which is not the result."""
    print(text, file=sys.stderr, flush=True)
