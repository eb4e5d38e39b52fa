"""Pages of finished runs: words, sheets and bytes of brief and evidence as a table, and pictures of both.

    python -m tests.campaigns.pages runs/granite runs/limestone_margin --pictures pictures

Pictures are of brief and page at every width, light and dark, by Chromium, and of the brief's sheet by `pdftoppm`.
"""

from __future__ import annotations

import html
import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any, Final

from tests.campaigns import options, table, tell
from uqsphere.report import build_report
from uqsphere.report.page import build_brief, typeset

CHROMIUM: Final = next((p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), "")
#: widths [px] of a small telephone, a telephone, a tablet and a desk
WIDTHS: Final = (320, 400, 768, 1280)
#: words of a sentence; words that have another name, and negations of negations
MOST_WORDS: Final = 25
OTHERS: Final = r"\b(scenes|specimens|of the cases|not (un|im)\w+able)\b"
#: a window of Chromium without a head is no narrower than this [px]
_NARROWEST: Final = 500


def plain(text: str) -> str:
    """A text with one kind of space."""
    return " ".join(re.sub("[\u00a0\u202f]", " ", text).split())


def read(page: str) -> str:
    """What is read on a page: its drawings once, without tags, styles and scripts."""
    once = re.sub(r'<svg class="(paper|narrow)".*?</svg>|<desc.*?</desc>|<title.*?</title>', "", page, flags=re.DOTALL)
    bare = re.sub(r"<(style|script)\b.*?</\1>|<[^>]*>", " ", once, flags=re.DOTALL)
    return plain(html.unescape(bare))


def printed(document: Any) -> str:
    """The text of a typeset document."""
    boxes = (box for page in document.pages for box in page._page_box.descendants())
    return plain(" ".join(getattr(box, "text", "") for box in boxes))


def words(text: str) -> int:
    """Words with a letter in them."""
    return len(re.findall(r"\S*[^\W\d_]\S*", text))


def hard_sentences(page: str) -> list[str]:
    """Sentences of a page of more than 25 words, titles of books apart, and those with a word that has another name.

    A row is one evaluation, a sphere the body, a test one that was measured, a scene what a study describes.
    """
    bare = re.sub(r"<(style|script|pre)\b.*?</\1>|<svg.*?</svg>", "", page, flags=re.DOTALL)
    found = []
    for _, inner in re.findall(r"<(p|li|dd|figcaption|caption|td|h[1-4])\b[^>]*>(.*?)</\1>", bare, re.DOTALL):
        text = plain(html.unescape(re.sub(r"<[^>]+>", " ", inner)))
        for sentence in re.split(r"(?<=[.!?;])\s+", text):
            book = re.search(r"\b(19|20)\d\d\b", text)
            if (words(sentence) > MOST_WORDS and not book) or re.search(OTHERS, sentence):
                found.append(sentence)
    return found


def row(folder: Path) -> tuple[str, ...]:
    """Words and sheets of the brief; sheets, words and kilobytes of the page as it is printed."""
    sheet, page = build_brief(folder), build_report(folder)
    text = sheet.read_text("utf-8")
    whole = typeset(page.read_text("utf-8"))
    counts = (words(read(text)), len(typeset(text, "").pages), words(printed(whole)), len(whole.pages))
    return (folder.name, *map(str, counts), f"{page.stat().st_size / 1e3:.0f}")


def shoot(page: Path, out: Path, width: int, height: int, *, dark: bool = False) -> None:
    """A picture of a page as wide as asked for: a frame where the window cannot be so narrow."""
    with tempfile.TemporaryDirectory() as temporary:
        shown = page.resolve()
        if width < _NARROWEST:
            shown = Path(temporary) / "frame.html"
            shown.write_text(f'<body style="margin:0"><iframe src="{page.resolve().as_uri()}" '
                             f'style="border:0;width:{width}px;height:{height}px"></iframe>')  # fmt: skip
        command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
                   f"--user-data-dir={temporary}/profile", f"--screenshot={out}", "--virtual-time-budget=6000",
                   f"--blink-settings=preferredColorScheme={0 if dark else 1}",
                   f"--window-size={max(width, _NARROWEST)},{height}"]  # fmt: skip
        subprocess.run([*command, shown.as_uri()], capture_output=True, timeout=120, check=True)


def pictures(folder: Path, out: Path) -> None:
    """Brief and page at every width, the brief in the dark and on paper."""
    for name, heights in (("brief", (2200, 1900, 1300, 900)), ("report", (9000, 7000, 4000, 3000))):
        for width, height in zip(WIDTHS, heights, strict=True):
            shoot(folder / f"{name}.html", out / f"{folder.name}-{name}-{width}.png", width, height)
        shoot(folder / f"{name}.html", out / f"{folder.name}-{name}-dark.png", WIDTHS[-1], heights[-1], dark=True)
    if sheet := shutil.which("pdftoppm"):
        pdf = build_brief(folder, pdf=True)
        subprocess.run([sheet, "-r", "80", "-png", "-singlefile", pdf, out / f"{folder.name}-brief-a4"], check=True)


def main() -> None:
    given = options(__doc__, words=(), pictures=Path)
    rows = []
    for folder in map(Path, given.words):
        rows.append(row(folder))
        tell(" ".join(rows[-1]))
        if given.pictures:
            given.pictures.mkdir(parents=True, exist_ok=True)
            pictures(folder, given.pictures)
    print(table(("study", "brief: words", "sheets", "page: words", "sheets", "kB"), rows))


if __name__ == "__main__":
    main()
