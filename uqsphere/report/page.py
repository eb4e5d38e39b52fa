"""The page of a run: what results.json holds, in one template, with figures by matplotlib.

The page computes nothing: every number is in the results.
"""

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup, escape

from uqsphere.results.folder import read_results, write_files
from uqsphere.results.types import Results

from . import sentences, tables
from .figures import Picture, pictures_of
from .format import capital, keep_units, meaning, unexplained

#: figures of the row below the decision
FRONT: tuple[str, ...] = ("density-1", "density-2", "sobol")
#: files beside the page that it links to, where they are
LINKED = ("answers.csv", "samples.csv", "results.json", "study.toml")


def write_page(folder: Path) -> Path:
    """Write report.html and the figures of a results directory, from what is stored there.

    Raises FolderError where it holds no results, AccessError where it cannot be written.
    """
    write_files(folder, page_files(read_results(folder), os.listdir(folder)))
    return folder / "report.html"


def page_files(results: Results, names: Sequence[str]) -> dict[str, str]:
    """The page of a run and its figures, by the names of their files; it links to `names`."""
    pictures = pictures_of(results)
    header = '<?xml version="1.0" encoding="utf-8"?>\n'
    figures = {f"figures/{name}.svg": header + picture.svg for name, picture in pictures.items()}
    html = render(
        "page.html",
        title=results.study.title,
        results=results,
        sentences=sentences,
        tables=tables,
        pictures=pictures,
        first=[name for name in FRONT if name in pictures],
        files=[*(name for name in LINKED if name in names), *figures],
    )
    return {"report.html": html, **figures}


def run_html(results: Results) -> str:
    """Decisions, figures and tables of a run, for a notebook's cell."""
    drawn = pictures_of(results)
    return render(
        "notebook.html",
        title=results.study.title,
        tables=(tables.limits(results), tables.quantities(results), tables.indices(results)),
        pictures={name: drawn[name] for name in ("fragility", *FRONT) if name in drawn},
        decisions=sentences.decision_texts(results),
        failed=sentences.failed_texts(results),
    )


def render(template: str, **variables: Any) -> str:
    """A template of this package as HTML in which units keep their numbers."""
    from jinja2 import Environment, PackageLoader

    environment = Environment(
        loader=PackageLoader("uqsphere", "report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    for filter in (_cell, _linked, _inline, capital, meaning, unexplained):
        environment.filters[filter.__name__.strip("_")] = filter
    html = environment.get_template(template).render(**variables)
    # texts only: the places of a path have blanks too
    return re.sub(r">[^<]+<", lambda text: keep_units(text[0]), html)


# --- HTML -----------------------------------------------------------------------------------------


def _cell(text: str) -> Markup:
    """A text of a table; an estimate with its interval below it, both unbroken."""
    parts = re.fullmatch(r"(-?\d\S*(?: %)?) \((-?\d\S* to [^)]+)\)(.*)", text)
    if parts:
        stacked = Markup('<span class="v">{}</span><br><small class="v soft">{}</small>')
        return stacked.format(parts[1] + parts[3], parts[2])
    if len(text) < 24:
        return Markup('<span class="v">{}</span>').format(text)
    return _linked(text)


def _linked(text: str) -> Markup:
    """A text whose DOIs are links."""
    # with pairs of brackets, as in 10.1016/S0301-7516(98)00005-2
    pattern = (
        r"(?:https://doi\.org/|doi:?\s?)?\b(10\.\d{4,9}/(?:[^\s,;()]|\([^\s()]*\))+[^\s,;().])"
    )
    return Markup(
        re.sub(pattern, r'<a href="https://doi.org/\1">doi:\1</a>', str(escape(text)))
    )  # the pattern has no character that is escaped


def _inline(picture: Picture, name: str, screen: str = "") -> Markup:
    """An SVG with alternative text, and ids of its own: several stand in one page."""
    text = re.sub(r'(\bid="|url\(#|href="#)', rf"\1{name}-", picture.svg)
    head = f'<svg role="img" aria-label="{escape(picture.text)}" '
    if screen:
        head = head.replace("<svg", f'<svg class="{screen}"', 1)
    return Markup(text.replace("<svg ", head, 1))
