"""What a table of the report is: a caption, a header and rows of texts."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uqsphere.report.figures.canvas import Picture
from uqsphere.report.phrases import ABSENT, MOST_DIGITS, absent_reason, estimate_text, number_text, probability_text
from uqsphere.results.entries import Est


@dataclass(frozen=True, kw_only=True)
class Table:
    """A caption, a header and rows of texts; the first column heads its row; why numbers have no interval."""

    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


def cell(estimate: Est | None, name: str = "", *, probability: bool = False, digits: int = MOST_DIGITS) -> str:
    """An estimate with its interval and unit, or a dash and the reason why it is absent; None was never asked for."""
    if estimate is None:
        return ABSENT
    if estimate.value is None:
        return f"{ABSENT} ({absent_reason(estimate)})"
    return probability_text(estimate) if probability else estimate_text(estimate, name, digits)


def index_cell(estimate: Est | None) -> str:
    """An index, a share of one, to four places: further ones change no ranking.

    >>> index_cell(Est.of(0.0719853, 0.0719754, 0.0719953))
    '0.0720'
    """
    if estimate is None or estimate.value is None or estimate.low is None or estimate.high is None:
        return cell(estimate)
    value, low, high = estimate.value, estimate.low, estimate.high
    if high - low >= 1e-4:
        # what is small keeps the digits of its interval, and no more than four places
        places = min(4, max(0, 1 - math.floor(math.log10(0.5 * (high - low)))))
        texts = [f"{round(v, places) + 0.0:.{places}f}".replace("-", "−") for v in (value, low, high)]
        return f"{texts[0]} ({texts[1]} to {texts[2]})"
    if abs(value) < 5e-5:
        return "below 0.0001"
    # rounding must not make a share of nearly all into all
    return f"{math.floor(1e4 * value) / 1e4:.4f}" if 0.99 < value < 1.0 else number_text(f"{value:.4f}")


def thousands(number: float) -> str:
    """A count with narrow spaces between its thousands.

    >>> thousands(16384).replace("\u202f", " ")
    '16 384'
    """
    return f"{number:,.0f}".replace(",", "\u202f")


# --- What a page is made of: chapters of blocks, each a heading with its picture, table and remarks.


@dataclass(frozen=True, kw_only=True)
class Block:
    """A heading with its picture, table and remarks; what is absent is left out.

    `files` are the files of the result folder that hold the numbers; `kind` is the style of the table: "notes" has a
    last column of text, "checks notes" grades in the second, "brief" a short last column.
    """

    heading: str
    picture: Picture | None = None
    table: Table | None = None
    remarks: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    kind: str = ""

    @property
    def empty(self) -> bool:
        """Whether there is nothing under the heading."""
        return not (self.picture or (self.table and self.table.rows) or self.remarks)


@dataclass(frozen=True, kw_only=True)
class Chapter:
    """A part of the page: its anchor, its heading, its blocks, a last remark.

    An annex is closed on the screen until it is asked for, and printed in full reports alone.
    """

    anchor: str
    heading: str
    blocks: tuple[Block, ...]
    remark: str = ""
    annex: bool = False
