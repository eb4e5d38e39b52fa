"""What a table of the report is: a caption, a header and rows of texts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from uqsphere.report.wording import ABSENT, absent_reason, estimate_text, probability_text

__all__ = ["Table", "cell", "thousands"]


@dataclass(frozen=True, kw_only=True)
class Table:
    """A caption, a header and rows of texts; the first column heads its row."""

    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def cell(estimate: Mapping[str, Any] | None, name: str = "", *, probability: bool = False) -> str:
    """An estimate with its interval and unit, or a dash and the reason why it is absent; None was never asked for."""
    if estimate is None:
        return ABSENT
    if estimate["value"] is None:
        return f"{ABSENT} ({absent_reason(estimate)})"
    return probability_text(estimate) if probability else estimate_text(estimate, name)


def thousands(number: float) -> str:
    """A count with narrow spaces between its thousands.

    >>> thousands(16384).replace("\u202f", " ")
    '16 384'
    """
    return f"{number:,.0f}".replace(",", "\u202f")
