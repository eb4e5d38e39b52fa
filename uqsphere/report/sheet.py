"""What paper has beside the page: number, title and day of the run in the margins, lines that keep numbers whole."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

from uqsphere.report.canvas import APOSTROPHE, shorten

__all__ = ["loosened", "margin_boxes", "unbroken"]

#: letters of a title in the margin
_LONGEST: Final = 90
#: letters of an interval that is kept on one line: a longer one would not fit a narrow column
_WHOLE: Final = 34

_UNIT: Final = re.compile(r"(?<=[\d)]) (?=%|[µmkMG]?(?:Pa|N|m|s|J)\b|m/s|kg/m)")
_POWER: Final = re.compile(r"(?<=\d) × (?=10)")
_INTERVAL: Final = re.compile(r"\([−\d][^()]* to [^()]*\)")
_QUOTED: Final = re.compile(r'(?<![\w=])"([^"=\n]{1,200})"(?!\w)')
_COMMAS: Final = re.compile(r"(?<![\w.,])\d{1,3}(?:,\d{3})+(?![\w,]|\.\d)")


def unbroken(text: str) -> str:
    """The text with one kind of thousands, and numbers that stay on one line with their powers, units and intervals.

    >>> unbroken("1,234 runs, 1.2 × 10⁻⁴ (1.1 × 10⁻⁴ to 1.3 × 10⁻⁴)").replace("\u00a0", "~").replace("\u202f", "_")
    '1_234 runs, 1.2~×~10⁻⁴ (1.1~×~10⁻⁴~to~1.3~×~10⁻⁴)'
    >>> unbroken("1.447 (1.445 to 1.449) %").replace("\u00a0", "~")
    '1.447 (1.445~to~1.449)~%'
    >>> unbroken('the bar\\'s end, "steels, 1976"')
    'the bar’s end, “steels, 1976”'
    """
    text = _QUOTED.sub("“\\1”", APOSTROPHE.sub("’", text))
    text = _COMMAS.sub(lambda found: found[0].replace(",", "\u202f"), text)
    text = _UNIT.sub("\u00a0", _POWER.sub("\u00a0×\u00a0", text))
    return _INTERVAL.sub(lambda found: found[0].replace(" ", "\u00a0") if len(found[0]) <= _WHOLE else found[0], text)


def loosened(text: str) -> str:
    """The same with a place to part the line within each interval, after its "to".

    >>> loosened("1.2\u00a0mm (1.1\u00a0to\u00a01.3)\u00a0mm").replace("\u00a0", "~")
    '1.2~mm (1.1~to 1.3)~mm'
    """
    return text.replace("\u00a0to\u00a0", "\u00a0to ")


def margin_boxes(title: str, manifest: Mapping[str, Any]) -> str:
    """The style sheet of the margins of paper; the day is that of the run, where its manifest has one."""
    day = str(manifest.get("finished", ""))[:10]
    left = f"content: {_quoted(shorten(title, _LONGEST))}"
    right = f"content: {_quoted('run of ' + day)}" if day else "content: none"
    face = 'font: 8pt system-ui, "DejaVu Sans", sans-serif; color: #444444'
    return (
        f"@page {{ @top-left {{ {left}; {face}; width: 75%; }} @top-right {{ {right}; {face}; }}\n"
        f'  @bottom-right {{ content: counter(page) " / " counter(pages); {face}; }} }}\n'
        "@page :first { @top-left { content: none; } }\n"
    )


def _quoted(text: str) -> str:
    """A text as a string of a style sheet, in which nothing but letters, numerals and spaces stands for itself."""
    return '"' + "".join(c if c.isalnum() or c == " " else f"\\{ord(c):x} " for c in text) + '"'
