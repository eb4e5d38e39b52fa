"""One self-contained page from a finished run: figures inlined, no script, nothing fetched."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from uqsphere.quantities import reading_units
from uqsphere.report import canvas, method
from uqsphere.report.blocks import Block, Chapter
from uqsphere.report.canvas import Picture
from uqsphere.report.chapters import build_chapters
from uqsphere.report.contents import Contents, read_contents
from uqsphere.report.glance import glances
from uqsphere.report.glossary import words_used
from uqsphere.report.margin_verdict import margin_verdicts
from uqsphere.report.sheet import loosened, margin_boxes, unbroken
from uqsphere.report.tables import Table
from uqsphere.report.units import units_of
from uqsphere.report.verdict import cautions, verdicts
from uqsphere.runner.sums import write_sums
from uqsphere.store import csv_text, write_atomically

if TYPE_CHECKING:
    from jinja2 import Environment

__all__ = ["MOST_BYTES", "build_report", "new_environment"]

#: a page is never larger than this
MOST_BYTES: Final = 3_000_000
#: of which the figures take up this much; what is beyond stays a file of its own
MOST_INLINED: Final = 2_200_000
#: characters of one text on the page; a study may hold megabytes
LONGEST: Final = 1500


def build_report(folder: Path) -> Path:
    """Write figures/*.svg and report.html of a finished run, from what is stored there.

    Parameters
    ----------
    folder : result folder of `uqsphere.run`

    Returns
    -------
    Path
        The page.

    Raises
    ------
    FolderError
        When the folder holds no finished run, or is damaged.
    AccessError
        When a file cannot be written.
    """
    contents = read_contents(folder)
    with reading_units(units_of(contents.results, courses=contents.courses)):
        return _build(folder, contents)


def _build(folder: Path, contents: Contents) -> Path:
    chapters = _distinct(build_chapters(contents))
    written = []
    for block in _blocks(chapters):
        if block.picture is not None and block.picture.header:
            table = csv_text(block.picture.header, block.picture.rows)
            written.append(f"figures/{block.picture.name}.csv")
            write_atomically(folder / written[-1], table)
    drawn = {b.picture.name: canvas.render(b.picture) for b in _blocks(chapters) if b.picture is not None}
    for name, svg in drawn.items():
        write_atomically(folder / "figures" / f"{name}.svg", svg)
    page = folder / "report.html"
    write_atomically(page, _page(contents, chapters, drawn))
    write_sums(folder, ["report.html", *written, *(f"figures/{name}.svg" for name in drawn)], keep=True)
    return page


def _blocks(chapters: Sequence[Chapter]) -> Iterator[Block]:
    for chapter in chapters:
        yield from chapter.blocks


def _distinct(chapters: Sequence[Chapter]) -> list[Chapter]:
    """The same chapters without empty blocks, their pictures with names that do not fall together.

    Names are cut to what files allow, so that two long ones may be the same.
    """
    taken: set[str] = set()
    found = []
    for chapter in chapters:
        blocks = []
        for block in chapter.blocks:
            if block.empty:
                continue
            if block.picture is not None:
                name, number = block.picture.name, 1
                while name in taken:
                    number += 1
                    name = f"{block.picture.name}-{number}"
                taken.add(name)
                block = replace(block, picture=replace(block.picture, name=name))
            blocks.append(block)
        found.append(replace(chapter, blocks=tuple(blocks)))
    return found


def _plain(value: Any) -> Any:
    """What a template sets: no control characters, and not endless; drawings pass as they are."""
    if type(value) is not str:
        return value
    return unbroken(canvas.shorten(value, LONGEST))


def _loose(value: str) -> Any:
    """A cell of a table of very many columns: its intervals may part after their "to", so that no column is cut off."""
    from markupsafe import Markup, escape

    return Markup(escape(loosened(_plain(value))))


def new_environment() -> Environment:
    """Templates that escape every text and refuse what is not there, with what all pages share."""
    from jinja2 import Environment, FunctionLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=FunctionLoader(_own_text), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True, finalize=_plain,
    )  # fmt: skip
    environment.globals["style"] = Markup(_own_text("style.css"))
    environment.filters["loose"] = _loose
    return environment


def _own_text(name: str) -> str:
    return resources.files("uqsphere.report").joinpath(name).read_text("utf-8")


def _page(contents: Contents, chapters: Sequence[Chapter], figures_drawn: dict[str, str]) -> str:
    """The text of the page; the figures that it has no room for stay files."""
    from markupsafe import Markup, escape

    room = MOST_INLINED

    def drawn(picture: Picture) -> Any:
        nonlocal room
        element = canvas.inline(figures_drawn[picture.name], picture.name)
        room -= len(element.encode())
        if room < 0:
            return f"The figure is in figures/{picture.name}.svg: the page would become too large with it."
        # the one text that is not escaped: made of escaped parts by the XML writer
        return Markup(element)

    appendix: list[tuple[Table, str]] = []
    numbers: dict[int, int] = {}
    figure_numbers: dict[str, int] = {}
    for k, block in enumerate(_blocks(chapters)):
        if block.appendix and block.table is not None:
            appendix.append((block.table, f"block-{k + 1}"))
            numbers[k] = len(appendix)
        if block.picture is not None:
            figure_numbers[block.picture.name] = len(figure_numbers) + 1
    title = canvas.shorten(str(contents.results["study"]["title"]), 300) or "Untitled study"
    shown = {
        "title": title,
        "margin_boxes": Markup(margin_boxes(title, contents.manifest)),
        "numbers_of": _numbers_of,
        "verdicts": [*margin_verdicts(contents), *verdicts(contents)],
        "glances": glances(contents),
        "cautions": cautions(contents),
        "chapters": chapters,
        "appendix": appendix,
        "numbers": numbers,
        "figure_numbers": figure_numbers,
        "repeat": method.repeat_rows(contents),
        "commands": [Markup(escape(canvas.shorten(line, LONGEST))) for line in method.commands(contents)],
        "version": contents.results["versions"].get("uqsphere", ""),
        "black_box": contents.black_box,
    }

    def set_page(draw: Callable[[Picture], Any], words: Sequence[tuple[str, str]]) -> str:
        order = iter(range(sum(1 for _ in _blocks(chapters))))
        environment = new_environment()
        environment.filters["drawn"] = draw
        template = environment.get_template("template.html")
        return template.render(shown, words=words, next_block=lambda: next(order))

    # set first without figures, to see which words are used
    plain = set_page(lambda picture: f"{picture.title} {picture.finding}", ())
    return set_page(drawn, words_used(plain)) + "\n"


def _numbers_of(block: Block) -> tuple[str, ...]:
    """The files that hold the numbers of the picture of a block."""
    assert block.picture is not None
    return (f"figures/{block.picture.name}.csv",) if block.picture.header else block.files
