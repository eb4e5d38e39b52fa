"""What the drawings of the documentation share: one style, and the way from a figure to the text of
an SVG.
"""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, GREY, FAINT = "#1b1f24", "#6b7280", "#d6d9de"
BLUE, ORANGE, RED = "#0072b2", "#e69f00", "#d55e00"


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A figure with its title and, in a sentence, what it shows."""

    name: str
    title: str
    figure: Figure
    finding: str


@contextlib.contextmanager
def style() -> Iterator[None]:
    """The settings of the report's figures."""
    import matplotlib

    from uqsphere.report.figures import INK, STYLE

    with matplotlib.rc_context({"text.color": INK}, STYLE):
        yield


def new_figure(height: float, rows: int = 1, **how: Any) -> tuple[Figure, list[Axes]]:
    """A figure of the page's width with so many panels below each other."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, height), layout="constrained")
    return figure, list(figure.subplots(rows, squeeze=False, **how).flat)


def render(picture: Picture) -> str:
    """The SVG of a picture, its finding as the description."""
    picture.figure.suptitle(picture.title, x=0.01, ha="left", fontsize=10)
    text = io.StringIO()
    picture.figure.savefig(
        text, format="svg", metadata={"Date": None, "Creator": None, "Description": picture.finding}
    )
    return re.sub(
        r'\bd="[^"]*"', lambda found: re.sub(r"(\d+\.\d)\d+", r"\1", found[0]), text.getvalue()
    )
