"""The order of the page: one list of chapters, each a function from what is stored to its blocks.

A new figure or table is a `Block` in the function of its chapter; a new chapter is an entry of `CHAPTERS`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from uqsphere.report import (
    decision,
    directions,
    drivers,
    fracture,
    granted,
    headings,
    limit_surface,
    sections,
    swings,
)
from uqsphere.report.blocks import Block, Chapter
from uqsphere.report.closing import (
    computed_chapter,
    inputs_chapter,
    methods_chapter,
    others_chapter,
    quantities_chapter,
)
from uqsphere.report.contents import Contents
from uqsphere.report.energy_curve import energy_block
from uqsphere.report.fragility_family import (
    family_figure,
    family_finding,
    family_table,
    lognormal_remarks,
)
from uqsphere.report.margin_parts import parts_finding, parts_table
from uqsphere.report.strength_plot import fitted_tests, probability_plot, tests_table
from uqsphere.report.subjects import (
    beyond_blocks,
    decided,
    distribution_block,
    has_indices,
    indices_block,
    measure_block,
    of_limits,
)
from uqsphere.report.wording import limit_name

__all__ = ["CHAPTERS", "build_chapters"]


def build_chapters(contents: Contents) -> list[Chapter]:
    """The chapters that have something to say, in the order of the page."""
    found = []
    for build in CHAPTERS:
        chapter = build(contents)
        if any(not block.empty for block in chapter.blocks):
            found.append(chapter)
    return found


# --- the decision and its margins -----------------------------------------------------------------------


def _twin(contents: Contents, name: str) -> str:
    """An earlier limit whose curve over the free scalar is the same; empty where there is none."""
    margins = contents.results["margins"]
    earlier = list(margins)[: list(margins).index(name)]
    own = margins[name]
    same = (n for n in earlier if margins[n]["solve"] == own["solve"] and margins[n]["curve"] == own["curve"])
    return next((n for n in same if margins[n]["values"].keys() == own["values"].keys() and own["curve"]), "")


def _fragility(contents: Contents, name: str) -> Block:
    twin = _twin(contents, name)
    if twin:
        # the target is another one, and so is the answer; the values and their curve stand there already
        return Block(
            heading=headings.fragility_heading(contents, name),
            finding=f"The curve and its values are those of {limit_name(twin)}; the target is another one.",
            picture=decision.fragility_figure(contents, name),
            table=sections.margins_table(contents, name, only_own=True),
            files=("tables/margins.csv", "tables/fragility.csv"),
        )
    return Block(
        heading=headings.fragility_heading(contents, name),
        finding=decision.fragility_finding(contents, name),
        picture=decision.fragility_figure(contents, name),
        table=sections.margins_table(contents, name),
        remarks=lognormal_remarks(contents, name),
        files=("tables/margins.csv", "tables/fragility.csv"),
    )


def _family(contents: Contents, name: str) -> list[Block]:
    if not contents.results["margins"][name].get("family"):
        return []
    if _twin(contents, name):
        return []
    return [
        Block(
            heading=headings.family_heading(contents, name),
            finding=family_finding(contents, name),
            picture=family_figure(contents, name),
            table=family_table(contents, name),
        )
    ]


def decision_chapter(contents: Contents) -> Chapter:
    """Fragility with operating point and target; else the demand against the strength."""
    blocks = [_fragility(contents, name) for name in contents.results["margins"]]
    blocks += [block for name in contents.results["margins"] for block in energy_block(contents, name)]
    blocks += [block for name in contents.results["margins"] for block in _family(contents, name)]
    blocks += [distribution_block(contents, name) for name in decided(contents)]
    blocks.append(granted.granted_block(contents, headings.granted_heading(contents)))
    return Chapter(anchor="decision", heading="The decision", short="Decision", blocks=tuple(blocks))


def _same_tests(contents: Contents, one: str, other: str) -> bool:
    """Whether two limits rest on the same law, fitted to the same tests."""
    laws = [contents.resolved["random"].get(f"limits.{name}.strength") for name in (one, other)]
    units = [contents.results["limits"][name]["quantity"] for name in (one, other)]
    return bool(laws[0] == laws[1] and units[0] == units[1])


def _sides(contents: Contents, name: str) -> Block:
    """The samples on both sides of a limit; left out where too few lie on one of them for a picture."""
    picture = limit_surface.surface_figure(contents, name)
    finding = limit_surface.surface_finding(contents, name) if picture is not None else ""
    return Block(heading=f"On which side of {limit_name(name)} the samples lie", finding=finding, picture=picture)


def margins_chapter(contents: Contents) -> Chapter:
    """How far the strength is from the demand, where the margin goes, and how it would be missed."""
    limits, blocks = contents.results["limits"], []
    if limits:
        blocks.append(
            Block(
                heading=headings.demand_heading(contents),
                finding=" ".join(
                    decision.margin_finding(name, limit["margin"], limit["aim"]) for name, limit in limits.items()
                ),
                picture=decision.margin_figure(contents),
                table=sections.limits_table(contents),
                appendix=True,
                files=("tables/limits.csv",),
            )
        )
    for name in contents.results["margins"]:
        parts = parts_table(contents, name)
        heading = headings.parts_heading(contents, name)
        blocks.append(Block(heading=heading, finding=parts_finding(contents, name) if parts else "", table=parts))
    if contents.results.get("fracture"):
        blocks.append(
            Block(
                heading=headings.fracture_heading(contents),
                finding=fracture.fracture_finding(contents),
                picture=fracture.interplay_figure(contents),
                table=fracture.fracture_table(contents),
                remarks=fracture.interplay_remarks(contents),
                files=("tables/fracture.csv",),
            )
        )
    shown = decided(contents)
    blocks += [distribution_block(contents, name) for name in of_limits(contents) if name not in shown]
    for name in limits:
        way = "keep" if drivers.mostly_missed(limits[name]) else "miss"
        heading = f"The likeliest way to {way} the aim of {limit_name(name)}"
        blocks += [
            Block(
                heading=swings.waterfall_heading(contents, name),
                finding=swings.waterfall_finding(contents, name),
                picture=swings.waterfall_figure(contents, name),
                table=swings.waterfall_table(contents, name),
                appendix=True,
            ),
            _sides(contents, name),
            Block(
                heading=heading,
                finding=drivers.design_finding(contents, name) if drivers.design_table(contents, name) else "",
                table=drivers.design_table(contents, name),
            ),
            Block(
                heading=f"Inputs where {limit_name(name)} is missed",
                table=drivers.given_failure_table(contents, name),
                files=("tables/drivers.csv",),
            ),
        ]
        known = fitted_tests(contents, name)
        if known is not None:
            twin = next((n for n in limits if _same_tests(contents, n, name)), name)
            if twin != name:
                heading = f"The tests behind the strength of {limit_name(name)}"
                blocks.append(Block(heading=heading, finding=f"The tests and the law are those of {limit_name(twin)}."))
                continue
            heading, picture = f"The tests behind the strength of {limit_name(name)}", probability_plot(known)
            blocks.append(Block(heading=heading, finding=picture.finding, picture=picture, table=tests_table(known)))
    return Chapter(anchor="margins", heading="Margins", short="Margins", blocks=tuple(blocks))


# --- what drives it, what to measure ----------------------------------------------------------------------


def drivers_chapter(contents: Contents) -> Chapter:
    """What drives each limit, then each quantity, those of the limits first."""
    blocks = []
    for name, limit in contents.results["limits"].items():
        table = drivers.failure_table(contents, name) if limit.get("drivers") else None
        if table is not None:
            blocks.append(
                Block(
                    heading=headings.failure_heading(contents, name),
                    finding=drivers.failure_finding(contents, name),
                    table=table,
                    files=("tables/drivers.csv",),
                )
            )
    for name in [q for q in of_limits(contents) or contents.results["quantities"] if has_indices(contents, q)]:
        blocks += [indices_block(contents, name), *beyond_blocks(contents, name)]
    return Chapter(
        anchor="drivers",
        heading="What drives it",
        short="What drives it",
        blocks=tuple(blocks),
        remark=directions.drivers_remark(contents),
    )


def measure_chapter(contents: Contents) -> Chapter:
    """What to measure next, for every limit and its quantity; for every quantity where there is no limit."""
    asked = of_limits(contents) or list(contents.results["sensitivity"])
    blocks = [measure_block(contents, "limits", name) for name in contents.results["limits"]]
    blocks += [measure_block(contents, "sensitivity", name) for name in asked if has_indices(contents, name)]
    return Chapter(
        anchor="measure",
        heading="What to measure next",
        short="What to measure",
        blocks=tuple(blocks),
        remark="From the samples that are there, without further evaluations.",
    )


#: the page from top to bottom, between the verdict and the appendix
CHAPTERS: Final[tuple[Callable[[Contents], Chapter], ...]] = (
    decision_chapter,
    margins_chapter,
    drivers_chapter,
    measure_chapter,
    quantities_chapter,
    computed_chapter,
    inputs_chapter,
    others_chapter,
    methods_chapter,
)
