"""One self-contained page from a finished run: figures inlined, no script, nothing fetched."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from uqsphere.report import canvas, decision, drivers, figures, progress, sections
from uqsphere.report.canvas import Picture
from uqsphere.report.contents import Contents, read_contents
from uqsphere.report.verdict import cautions, verdicts
from uqsphere.report.wording import begin, call, capital, limit_name, symbol
from uqsphere.runner.sums import write_sums
from uqsphere.store import write_atomically

if TYPE_CHECKING:
    from jinja2 import Environment

__all__ = ["MOST_BYTES", "Block", "build_report", "new_environment", "page_style"]

#: a page is never larger than this
MOST_BYTES: Final = 3_000_000
#: of which the figures take up this much; what is beyond stays a file of its own
MOST_INLINED: Final = 2_200_000
#: characters of one text on the page; a study may hold megabytes
LONGEST: Final = 1500


_UNIT: Final = re.compile(r"(?<=\d) (?=%|[µmkMG]?(?:Pa|N|m|s|J)\b|m/s|kg/m)")


@dataclass(frozen=True, kw_only=True)
class Block:
    """A heading with its finding, picture, table and remarks; what is absent is left out."""

    heading: str
    finding: str = ""
    picture: Picture | None = None
    table: sections.Table | None = None
    remarks: tuple[str, ...] = ()


def build_report(folder: Path) -> Path:
    """Write figures/*.svg and report.html of a finished run, from what is stored there.

    Parameters
    ----------
    folder : result folder of `uqsphere.runner.run`

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
    parts = _parts(contents)
    drawn = {
        block.picture.name: canvas.render(block.picture)
        for blocks in parts.values()
        for block in blocks
        if block.picture is not None
    }
    for name, svg in drawn.items():
        write_atomically(folder / "figures" / f"{name}.svg", svg)
    page = folder / "report.html"
    write_atomically(page, _page(contents, parts, drawn))
    write_sums(folder, ["report.html", *(f"figures/{name}.svg" for name in drawn)], keep=True)
    return page


def _parts(contents: Contents) -> dict[str, list[Block]]:
    """The blocks of every section."""
    return _distinct(
        {
            "distributions": [_distribution(contents, name) for name in contents.results["quantities"]],
            "sensitivity": [_sensitivity(contents, name) for name in contents.results["sensitivity"]],
            "margins": _margins(contents),
            "drivers": _drivers(contents),
            "convergence": _convergence(contents),
        }
    )


def _distinct(parts: dict[str, list[Block]]) -> dict[str, list[Block]]:
    """The same blocks with pictures whose names, cut to what files allow, do not fall together."""
    from dataclasses import replace

    taken: set[str] = set()
    for blocks in parts.values():
        for k, block in enumerate(blocks):
            if block.picture is None:
                continue
            name, number = block.picture.name, 1
            while name in taken:
                number += 1
                name = f"{block.picture.name}-{number}"
            taken.add(name)
            blocks[k] = replace(block, picture=replace(block.picture, name=name))
    return parts


def _distribution(contents: Contents, name: str) -> Block:
    single = figures.single_value(contents, name)
    finding = f"One value: {single}." if single else _without_name(figures.distribution_finding(contents, name))
    return Block(
        heading=begin(name, call(name)),
        finding=finding,
        picture=figures.distribution_figure(contents, name),
        table=sections.quantity_table(contents, name),
    )


def _without_name(finding: str) -> str:
    """A finding under a heading that names its subject."""
    return capital(finding.partition(": ")[2])


def _sensitivity(contents: Contents, name: str) -> Block:
    entry = contents.results["sensitivity"][name]
    picture = figures.sensitivity_figure(contents, name)
    remarks = [str(entry.get("check", {}).get("text") or "")] if picture is not None else []
    hidden = len(figures.ranked(entry)) - figures.MOST_INPUTS
    if hidden > 0:
        remarks.append(f"The figure shows the {figures.MOST_INPUTS} largest; {hidden} more are in the table.")
    finding = figures.sensitivity_finding(contents, name)
    return Block(
        heading=symbol(name),
        finding=finding,
        picture=picture,
        table=sections.index_table(contents, name) or drivers.shapley_table(contents, name),
        remarks=tuple(text for text in remarks if text),
    )


def _drivers(contents: Contents) -> list[Block]:
    """What drives each limit, what moves the laws of the quantities, and what to measure first."""
    blocks = []
    for name, limit in contents.results["limits"].items():
        if not limit.get("drivers"):
            continue
        called, first = limit_name(name), limit.get("measure_first")
        blocks += [
            Block(
                heading=f"Missing the aim of {called}",
                finding=drivers.failure_finding(contents, name),
                table=drivers.failure_table(contents, name),
            ),
            Block(heading=f"Inputs where {called} is missed", table=drivers.given_failure_table(contents, name)),
            Block(
                heading=f"What to measure first for {called}",
                finding=drivers.measure_finding(first),
                table=drivers.measure_table(first, f"What better known laws are worth, {called}"),
            ),
        ]
    for name, entry in contents.results["sensitivity"].items():
        first = entry.get("measure_first")
        blocks += [
            Block(heading=f"{symbol(name)} beyond its variance", table=drivers.distances_table(contents, name)),
            Block(
                heading=f"What to measure first for {symbol(name)}",
                finding=drivers.measure_finding(first),
                table=drivers.measure_table(first, f"What the variance of {symbol(name)} would lose"),
            ),
        ]
    return [block for block in blocks if block.table is not None]


def _margins(contents: Contents) -> list[Block]:
    limits = contents.results["limits"]
    if not limits:
        return []
    found = " ".join(decision.margin_finding(name, limit["margin"]) for name, limit in limits.items())
    blocks = [
        Block(
            heading="Strength over demand",
            finding=found,
            picture=decision.margin_figure(contents),
            table=sections.limits_table(contents),
        )
    ]
    for name in limits:
        table = drivers.design_table(contents, name)
        if table is not None:
            heading = f"The likeliest way to miss the aim of {limit_name(name)}"
            blocks.append(Block(heading=heading, finding=drivers.design_finding(contents, name), table=table))
    for name in contents.results["margins"]:
        blocks.append(
            Block(
                heading=f"Fragility of {limit_name(name)}",
                finding=decision.fragility_finding(contents, name),
                picture=decision.fragility_figure(contents, name),
                table=sections.margins_table(contents, name),
            )
        )
    return blocks


def _convergence(contents: Contents) -> list[Block]:
    steps, speed = progress.convergence_figure(contents), progress.speed_figure(contents)
    blocks = [
        Block(heading="Error against evaluations", finding=progress.progress_finding(contents), picture=steps),
        Block(
            heading="Speed against error of each method",
            finding="The same errors over the seconds since the start, the methods running one after the other.",
            picture=speed,
        ),
    ]
    return [block for block in blocks if block.picture is not None] or blocks[:1]


def _plain(value: Any) -> Any:
    """What a template sets: no control characters, and not endless; drawings pass as they are."""
    if type(value) is not str:
        return value
    # a number stays with its unit at the end of a line
    return _UNIT.sub("\u00a0", canvas.shorten(value, LONGEST))


def new_environment() -> Environment:
    """Templates that escape every text and refuse what is not there."""
    from jinja2 import Environment, StrictUndefined

    return Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, finalize=_plain
    )


def page_style() -> str:
    """The style sheet of the report, for pages that look like it."""
    text = resources.files("uqsphere.report").joinpath("template.html").read_text("utf-8")
    return text.partition("<style>")[2].partition("</style>")[0]


def _page(contents: Contents, parts: dict[str, list[Block]], figures_drawn: dict[str, str]) -> str:
    from markupsafe import Markup

    room = MOST_INLINED

    def drawn(picture: Picture) -> Any:
        nonlocal room
        element = canvas.inline(figures_drawn[picture.name], picture.name)
        room -= len(element.encode())
        if room < 0:
            return f"The figure is in figures/{picture.name}.svg: the page would become too large with it."
        # the one text that is not escaped: made of escaped parts by the XML writer
        return Markup(element)

    environment = new_environment()
    environment.filters["drawn"] = drawn
    template = environment.from_string(resources.files("uqsphere.report").joinpath("template.html").read_text("utf-8"))
    return (
        template.render(
            title=canvas.shorten(str(contents.results["study"]["title"]), 300) or "Untitled study",
            verdicts=verdicts(contents),
            cautions=cautions(contents),
            parts=parts,
            checks=sections.checks_table(contents),
            paper=sections.paper_table(contents),
            model=sections.model_table(contents),
            inputs=sections.inputs_table(contents),
            fixed=sections.fixed_table(contents),
            dependence=sections.dependence_texts(contents),
            accuracy=sections.accuracy_table(contents),
            missed=[str(text) for text in contents.results["accuracy"]["missed"]][:200],
            repeat=sections.repeat_rows(contents),
            commands=sections.commands(contents),
            version=contents.results["versions"].get("uqsphere", ""),
            black_box=contents.black_box,
        )
        + "\n"
    )
