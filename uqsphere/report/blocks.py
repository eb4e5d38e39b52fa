"""What a page is made of: chapters of blocks, each a heading with its finding, picture, table and remarks."""

from __future__ import annotations

from dataclasses import dataclass

from uqsphere.report.canvas import Picture
from uqsphere.report.tables import Table

__all__ = ["Block", "Chapter"]


@dataclass(frozen=True, kw_only=True)
class Block:
    """A heading with its finding, picture, table and remarks; what is absent is left out.

    `appendix` moves the table to the end of the page, with links there and back; `files` are the files of the
    result folder that hold the numbers; `kind` is the style of the table: "notes" has a last column of text,
    "checks notes" grades in the second, "brief" a short last column.
    """

    heading: str
    finding: str = ""
    picture: Picture | None = None
    table: Table | None = None
    remarks: tuple[str, ...] = ()
    appendix: bool = False
    files: tuple[str, ...] = ()
    kind: str = ""

    @property
    def empty(self) -> bool:
        """Whether there is nothing under the heading."""
        return not (self.finding or self.picture or self.table or self.remarks)


@dataclass(frozen=True, kw_only=True)
class Chapter:
    """A part of the page: its anchor, its heading, its words in the list of contents, its blocks, a last remark."""

    anchor: str
    heading: str
    short: str
    blocks: tuple[Block, ...]
    remark: str = ""
