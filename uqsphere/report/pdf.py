"""The page as a typeset document, by WeasyPrint, which is an optional extra."""

from __future__ import annotations

import io
import logging
import re
from pathlib import Path
from typing import Any, Final

from uqsphere.errors import UsageError
from uqsphere.store import write_atomically

__all__ = ["build_pdf", "check_pdf", "typeset"]

#: what a browser takes from the theme and a typesetter does not know
_VARIABLE: Final = re.compile(r"var\(--[a-z]+, (#[0-9a-f]{6})\)")
_LACKING: Final = "the PDF needs the extra: pip install 'uqsphere[pdf]'"
#: page numbers, and what the screen alone needs left out
_SHEET: Final = """
@page { size: A4; margin: 16mm 15mm 18mm;
  @bottom-right { content: counter(page) " / " counter(pages); font: 8pt "DejaVu Sans", sans-serif; } }
:root { color-scheme: light; }
html, body { background: #ffffff; color: #000000; }
.skip { display: none; }
nav a::after { content: " " target-counter(attr(href), page); }
/* the typesetter parts a floating figure from its caption */
figure { float: none; }
.scroll, .drawing { overflow: visible; }
/* beside a figure that floats all the same a table would go to the next page as a whole */
.scroll { clear: both; }
figure svg { min-width: 0; max-width: 100%; width: 165mm; }
table { font-size: 8pt; }
th, td { min-width: 0 !important; padding-right: 6pt; overflow-wrap: anywhere; }
"""


def check_pdf() -> None:
    """Refuse before anything is written where the extra, or a library of the system that it needs, is missing.

    Raises
    ------
    UsageError
        With what to install.
    """
    try:
        import weasyprint  # noqa: F401
    except ImportError as error:
        raise UsageError(_LACKING) from error
    except OSError as error:
        raise UsageError(
            f"the PDF needs Pango, a library of the system that WeasyPrint sets texts with: {error}"
        ) from error


def build_pdf(folder: Path) -> Path:
    """Typeset report.html of a folder as report.pdf; nothing is fetched.

    Raises
    ------
    UsageError
        Where the extra is missing.
    AccessError
        When the file cannot be written.
    """
    check_pdf()
    text = _VARIABLE.sub(r"\1", (folder / "report.html").read_text(encoding="utf-8"))
    # the typesetter's remarks on styles of the screen are nobody's business
    log = logging.getLogger("weasyprint")
    before = log.level
    log.setLevel(logging.ERROR)
    try:
        buffer = io.BytesIO()
        typeset(text).write_pdf(buffer, uncompressed_pdf=False)
    finally:
        log.setLevel(before)
    path = folder / "report.pdf"
    write_atomically(path, buffer.getvalue())
    return path


def typeset(text: str) -> Any:
    """The page laid out on paper, a `weasyprint.Document`: chapters in the list on the first pages have their page."""
    from weasyprint import CSS, HTML
    from weasyprint.urls import URLFetcher

    # nothing of a page lies outside it: its pictures are data of its own
    inside = URLFetcher(allowed_protocols=("data",))
    return HTML(string=text, url_fetcher=inside, media_type="print").render(stylesheets=[CSS(string=_SHEET)])
