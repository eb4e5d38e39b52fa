"""One page for one test, and one for many: what was measured, what doubts it, what was mended, and the pictures."""

from __future__ import annotations

import html
import re
from collections.abc import Sequence
from typing import Final

from uqsphere.report.figures.canvas import inline

#: one sheet of paper, figures side by side below the table
_STYLE = """
body { font: 10pt/1.35 "DejaVu Sans", sans-serif; max-width: 190mm; margin: 6mm auto; padding: 0 4mm; }
h1 { font-size: 14pt; margin: 0 0 2mm; } h2 { font-size: 10.5pt; margin: 3mm 0 1mm; }
table { border-collapse: collapse; font-size: 8.5pt; } td, th { padding: 1px 8px 1px 0; text-align: left; }
th { border-bottom: 1px solid #666; } ul { margin: 0; padding-left: 5mm; font-size: 7.5pt; }
.figures { display: flex; gap: 3mm; } .figures div { width: 50%; } svg { width: 100%; height: auto; }
@page { size: A4; margin: 10mm; }
"""
#: a colour of the theme, and what it is on paper
_THEMED: Final = re.compile(r"var\(--[a-z]+, (#[0-9a-f]{6})\)")
#: notes that fit on the sheet
_NOTES = 16


def _table(header: Sequence[str], rows: Sequence[Sequence[str]], links: Sequence[str] = ()) -> str:
    cells = "".join(f"<th>{html.escape(cell)}</th>" for cell in header)
    lines = [f"<tr>{cells}</tr>"]
    for k, row in enumerate(rows):
        texts = [html.escape(cell) for cell in row]
        wide = len(texts) == 3 and not texts[2] and " " in texts[1]
        if k < len(links) and links[k]:
            texts[0] = f'<a href="{html.escape(links[k])}">{texts[0]}</a>'
        if wide:
            lines.append(f'<tr><td>{texts[0]}</td><td colspan="2">{texts[1]}</td></tr>')
            continue
        lines.append("<tr>" + "".join(f"<td>{text}</td>" for text in texts) + "</tr>")
    return "<table>" + "\n".join(lines) + "</table>"


def _page(title: str, body: str) -> str:
    name = html.escape(title)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{name}</title><style>{_STYLE}</style>'
        f"</head><body><h1>{name}</h1>\n{body}\n</body></html>\n"
    )


def lab_sheet(
    name: str, header: Sequence[str], rows: Sequence[Sequence[str]], notes: Sequence[str], figures: Sequence[str]
) -> str:
    """HTML text: the sheet of one test.

    Parameters
    ----------
    name : str
        Of the record.
    header, rows : sequences of str
        The table of answers.
    notes : sequence of str
        What was read and mended.
    figures : sequence of str
        SVG texts.
    """
    said = [f"<li>{html.escape(note)}</li>" for note in notes[:_NOTES]]
    if len(notes) > _NOTES:
        said.append(f"<li>and {len(notes) - _NOTES} more</li>")
    # a sheet is paper: it has the colours of paper, not of a theme
    papers = [_THEMED.sub(r"\1", inline(svg, f"figure{k}")) for k, svg in enumerate(figures)]
    drawn = "".join(f"<div>{svg}</div>" for svg in papers)
    body = [_table(header, rows), f'<div class="figures">{drawn}</div>', "<h2>Read and mended</h2>"]
    return _page(f"Test {name}", "\n".join([*body, "<ul>", *said, "</ul>"]))


def tests_page(name: str, header: Sequence[str], rows: Sequence[Sequence[str]], stems: Sequence[str]) -> str:
    """HTML text: the tests of a folder, each with its sheet."""
    links = ["" if row[1] in ("", "refused") else f"{stem}/sheet.html" for row, stem in zip(rows, stems, strict=True)]
    return _page(f"Tests of {name}", _table(header, rows, links))
