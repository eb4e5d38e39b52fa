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
    figures,
    force_band,
    fracture,
    granted,
    hardest_scene,
    limit_surface,
    method,
    origins,
    pair_figures,
    progress,
    sections,
    swings,
)
from uqsphere.report.blocks import Block, Chapter
from uqsphere.report.contents import Contents
from uqsphere.report.fragility_family import (
    family_figure,
    family_finding,
    family_name,
    family_table,
    lognormal_remarks,
)
from uqsphere.report.margin_parts import parts_finding, parts_table
from uqsphere.report.strength_plot import fitted_tests, probability_plot, tests_table
from uqsphere.report.wording import begin, call, capital, limit_name, powers, symbol

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


def _fragility(contents: Contents, name: str) -> Block:
    return Block(
        heading=f"Fragility of {limit_name(name)}",
        finding=decision.fragility_finding(contents, name),
        picture=decision.fragility_figure(contents, name),
        table=sections.margins_table(contents, name),
        remarks=lognormal_remarks(contents, name),
        files=("tables/margins.csv", "tables/fragility.csv"),
    )


def _family(contents: Contents, name: str) -> list[Block]:
    if not contents.results["margins"][name].get("family"):
        return []
    return [
        Block(
            heading=f"Fragility of {limit_name(name)} over {family_name(contents, name)}",
            finding=family_finding(contents, name),
            picture=family_figure(contents, name),
            table=family_table(contents, name),
        )
    ]


def _distribution(contents: Contents, name: str) -> Block:
    single = figures.single_value(contents, name)
    finding = f"One value: {single}." if single else _without_name(figures.distribution_finding(contents, name))
    return Block(
        heading=begin(name, call(name)),
        finding=finding,
        picture=figures.distribution_figure(contents, name),
        table=sections.quantity_table(contents, name),
        appendix=not single,
        files=("tables/quantities.csv",),
    )


def _without_name(finding: str) -> str:
    """A finding under a heading that names its subject."""
    return capital(finding.partition(": ")[2])


def _decided(contents: Contents) -> list[str]:
    """Quantities whose distribution is the figure of the decision: where no fragility was asked for."""
    if contents.results["margins"]:
        return []
    return _of_limits(contents) or list(contents.results["quantities"])[:1]


def _of_limits(contents: Contents) -> list[str]:
    """Quantities that have a limit, each once."""
    found = dict.fromkeys(limit["quantity"] for limit in contents.results["limits"].values())
    return [name for name in found if name in contents.results["quantities"]]


def decision_chapter(contents: Contents) -> Chapter:
    """Fragility with operating point and target; else the demand against the strength."""
    blocks = [_fragility(contents, name) for name in contents.results["margins"]]
    blocks += [block for name in contents.results["margins"] for block in _family(contents, name)]
    blocks += [_distribution(contents, name) for name in _decided(contents)]
    blocks.append(granted.granted_block(contents))
    return Chapter(anchor="decision", heading="The decision", short="Decision", blocks=tuple(blocks))


def margins_chapter(contents: Contents) -> Chapter:
    """How far the strength is from the demand, where the margin goes, and how it would be missed."""
    limits, blocks = contents.results["limits"], []
    if limits:
        blocks.append(
            Block(
                heading="Strength over demand",
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
        heading = f"What the margin of {limit_name(name)} is made of"
        blocks.append(Block(heading=heading, finding=parts_finding(contents, name) if parts else "", table=parts))
    if contents.results.get("fracture"):
        blocks.append(
            Block(
                heading="Fracture",
                finding=fracture.fracture_finding(contents),
                picture=fracture.interplay_figure(contents),
                table=fracture.fracture_table(contents),
                files=("tables/fracture.csv",),
            )
        )
    shown = _decided(contents)
    blocks += [_distribution(contents, name) for name in _of_limits(contents) if name not in shown]
    for name in limits:
        way = "keep" if drivers.mostly_missed(limits[name]) else "miss"
        heading = f"The likeliest way to {way} the aim of {limit_name(name)}"
        blocks += [
            Block(
                heading=f"Where the margin of {limit_name(name)} goes",
                finding=swings.waterfall_finding(contents, name),
                picture=swings.waterfall_figure(contents, name),
                table=swings.waterfall_table(contents, name),
                appendix=True,
            ),
            Block(
                heading=f"On which side of {limit_name(name)} the samples lie",
                finding=limit_surface.surface_finding(contents, name),
                picture=limit_surface.surface_figure(contents, name),
            ),
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
            heading, picture = f"The tests behind the strength of {limit_name(name)}", probability_plot(known)
            blocks.append(Block(heading=heading, finding=picture.finding, picture=picture, table=tests_table(known)))
    return Chapter(anchor="margins", heading="Margins", short="Margins", blocks=tuple(blocks))


# --- what drives it, what to measure ----------------------------------------------------------------------


def _indices(contents: Contents, name: str) -> Block:
    entry = contents.results["sensitivity"][name]
    picture = figures.sensitivity_figure(contents, name)
    remarks = [powers(str(entry.get("check", {}).get("text") or ""))] if picture is not None else []
    hidden = len(figures.ranked(entry)) - figures.MOST_INPUTS
    if hidden > 0:
        remarks.append(f"The figure shows the {figures.MOST_INPUTS} largest; {hidden} more are in the table.")
    return Block(
        heading=symbol(name),
        finding=figures.sensitivity_finding(contents, name),
        picture=picture,
        table=sections.index_table(contents, name) or drivers.shapley_table(contents, name),
        remarks=tuple(text for text in remarks if text),
        appendix=picture is not None,
        files=("tables/sensitivity.csv",),
    )


def _beyond_indices(contents: Contents, name: str) -> list[Block]:
    """Pairs, groups, swings, and distances between whole laws."""
    return [
        Block(
            heading=f"{symbol(name)}: which inputs act together",
            finding=pair_figures.pair_finding(contents, name),
            picture=pair_figures.pair_figure(contents, name),
            table=pair_figures.pair_table(contents, name),
            appendix=True,
            files=("tables/sensitivity.csv",),
        ),
        Block(
            heading=f"{symbol(name)}: groups of inputs",
            finding=pair_figures.group_finding(contents, name),
            picture=pair_figures.group_figure(contents, name),
            table=pair_figures.group_table(contents, name),
            appendix=True,
            files=("tables/sensitivity.csv",),
        ),
        Block(
            heading=f"{symbol(name)}: how far each input moves it",
            finding=swings.tornado_finding(contents, name) if swings.swings(contents, name) else "",
            picture=swings.tornado_figure(contents, name),
            table=swings.tornado_table(contents, name),
            appendix=True,
        ),
        Block(
            heading=f"{symbol(name)} beyond its variance",
            finding=drivers.distances_finding(contents, name),
            table=drivers.distances_table(contents, name),
            appendix=True,
            files=("tables/drivers.csv",),
        ),
    ]


def drivers_chapter(contents: Contents) -> Chapter:
    """What drives each limit, then each quantity, those of the limits first."""
    blocks = []
    for name, limit in contents.results["limits"].items():
        table = drivers.failure_table(contents, name) if limit.get("drivers") else None
        if table is not None:
            blocks.append(
                Block(
                    heading=f"Missing the aim of {limit_name(name)}",
                    finding=drivers.failure_finding(contents, name),
                    table=table,
                    files=("tables/drivers.csv",),
                )
            )
    for name in dict.fromkeys(
        [*(q for q in _of_limits(contents) if q in contents.results["sensitivity"]), *contents.results["sensitivity"]]
    ):
        blocks += [_indices(contents, name), *_beyond_indices(contents, name)]
    return Chapter(
        anchor="drivers",
        heading="What drives it",
        short="What drives it",
        blocks=tuple(blocks),
        remark=directions.drivers_remark(contents),
    )


def measure_chapter(contents: Contents) -> Chapter:
    """What to measure next, for every limit and every quantity."""
    blocks = []
    for kind in ("limits", "sensitivity"):
        for name, entry in contents.results[kind].items():
            first = entry.get("measure_first")
            words = limit_name(name) if kind == "limits" else symbol(name)
            caption = (
                f"What better known laws are worth, {words}"
                if kind == "limits"
                else f"What the variance of {words} would lose"
            )
            table = drivers.measure_table(first, caption)
            if table is not None:
                blocks.append(
                    Block(
                        heading=f"What to measure first for {words}",
                        finding=drivers.measure_finding(first),
                        table=table,
                        remarks=(str(first["method"]), *directions.measure_remarks(contents, name, kind)),
                        files=("tables/drivers.csv",),
                    )
                )
    return Chapter(
        anchor="measure",
        heading="What to measure next",
        short="What to measure",
        blocks=tuple(blocks),
        remark="From the samples that are there, without further evaluations.",
    )


# --- the quantities, and how they were computed ------------------------------------------------------------


def quantities_chapter(contents: Contents) -> Chapter:
    """Distributions that were not shown above, the force over time, and the hardest scene in its bars and inside."""
    shown = {*_decided(contents), *_of_limits(contents)}
    blocks = [_distribution(contents, name) for name in contents.results["quantities"] if name not in shown]
    blocks.append(
        Block(
            heading="Force over time",
            finding=force_band.force_band_finding(contents),
            picture=force_band.force_band_figure(contents),
            table=force_band.hardest_table(contents),
            appendix=True,
            files=("tables/courses.csv",) if contents.courses is not None else (),
        )
    )
    bars, inside = hardest_scene.bars_figure(contents), hardest_scene.stress_inside_figure(contents)
    blocks.append(
        Block(
            heading="What the bars see of the hardest scene followed",
            finding=bars.finding if bars else "",
            picture=bars,
        )
    )
    heading = "Stress inside the sphere in the hardest scene"
    blocks.append(Block(heading=heading, finding=inside.finding if inside else "", picture=inside))
    return Chapter(
        anchor="quantities",
        heading="The quantities in full",
        short="Quantities",
        blocks=tuple(blocks),
        remark="Figures: drawn from up to 16 384 stored samples. Numbers: from all evaluations.",
    )


def computed_chapter(contents: Contents) -> Chapter:
    """Validity, model, methods, accuracy, convergence and speed."""
    missed = tuple(str(text) for text in contents.results["accuracy"]["missed"])[:200]
    steps, speed = progress.convergence_figure(contents), progress.speed_figure(contents)
    blocks = [
        Block(
            heading="Validity of the model",
            table=method.checks_table(contents) if contents.results["validity"] else None,
            kind="checks notes",
            files=("tables/validity.csv",),
        ),
        *(
            Block(
                heading=f"Validity of the model at the answer for {limit_name(name)}",
                table=method.answer_checks_table(contents, name),
                kind="checks notes",
            )
            for name in contents.results["margins"]
        ),
        Block(
            heading="The paper’s formulas as printed, and corrected",
            table=method.paper_table(contents),
            kind="notes",
            files=("tables/paper.csv",),
        ),
        Block(
            heading="Model chosen",
            finding=f"The model is {contents.results['model']['chosen']}: {contents.results['model']['why']}.",
            table=method.model_table(contents),
            appendix=True,
        ),
        Block(heading="Plan and account", table=method.plan_table(contents), kind="notes"),
        Block(heading="Methods", table=method.methods_table(contents), kind="notes"),
        Block(
            heading="What was asked, what was reached",
            finding=progress.progress_finding(contents),
            table=method.accuracy_table(contents),
            remarks=tuple(f"Not reached: {powers(text)}" for text in missed),
            kind="brief",
        ),
        Block(
            heading="Error against evaluations",
            finding=progress.course_finding(contents, 0),
            picture=steps,
            remarks=(
                "Errors are half-widths of 95 % intervals over what the study asks for; for polynomial chaos the share "
                "of the variance that it leaves unexplained. Below the dashed line the accuracy is reached.",
            )
            if steps is not None
            else (),
            files=("tables/speed_error.csv",),
        ),
        Block(
            heading="Speed against error of each method",
            finding=progress.course_finding(contents, 1) if speed is not None else "",
            picture=speed,
            files=("tables/speed_error.csv", "manifest.json"),
        ),
    ]
    return Chapter(
        anchor="computed",
        heading="How it was computed, and how far to believe it",
        short="How far to believe it",
        blocks=tuple(blocks),
    )


def inputs_chapter(contents: Contents) -> Chapter:
    """Inputs with their laws and sources."""
    dependence = tuple(origins.dependence_texts(contents))
    fixed = origins.fixed_table(contents)
    blocks = (
        Block(
            heading="Random inputs",
            table=origins.inputs_table(contents) if contents.results["inputs"] else None,
            remarks=dependence,
            kind="notes",
            files=("tables/inputs.csv",),
        ),
        Block(heading="Fixed numbers", table=fixed, kind="notes"),
    )
    return Chapter(anchor="inputs", heading="Inputs and their sources", short="Inputs", blocks=blocks)


#: the page from top to bottom, between the verdict and the appendix
CHAPTERS: Final[tuple[Callable[[Contents], Chapter], ...]] = (
    decision_chapter,
    margins_chapter,
    drivers_chapter,
    measure_chapter,
    quantities_chapter,
    computed_chapter,
    inputs_chapter,
)
