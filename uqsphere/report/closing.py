"""The later chapters: quantities over time, validity, inputs, what no limit asks about, methods and convergence."""

from __future__ import annotations

from uqsphere.report import force_band, hardest_scene, method, origins, progress, reach
from uqsphere.report.blocks import Block, Chapter
from uqsphere.report.contents import Contents
from uqsphere.report.headings import accuracy_heading, checks_heading
from uqsphere.report.shortfalls import shortfalls
from uqsphere.report.subjects import (
    beyond_blocks,
    decided,
    distribution_block,
    has_indices,
    indices_block,
    measure_block,
    of_limits,
)
from uqsphere.report.wording import limit_name, powers

__all__ = ["computed_chapter", "inputs_chapter", "methods_chapter", "others_chapter", "quantities_chapter"]

#: subjects that a sentence about accuracies names; the table has every question
_SUBJECTS = 24


def others(contents: Contents) -> list[str]:
    """Quantities that no limit asks about, where there are limits."""
    asked = of_limits(contents)
    return [name for name in contents.results["quantities"] if name not in asked] if asked else []


def quantities_chapter(contents: Contents) -> Chapter:
    """The force over time, the hardest scene in its bars and inside; distributions too where there is no limit."""
    shown = {*decided(contents), *others(contents)}
    blocks = [distribution_block(contents, name) for name in contents.results["quantities"] if name not in shown]
    blocks = [] if contents.results["limits"] else blocks
    heading = "The quantities in full" if blocks else "Force and stress over time"
    blocks.append(
        Block(
            heading=force_band.force_band_heading(contents),
            finding=force_band.force_band_finding(contents),
            picture=force_band.force_band_figure(contents),
            table=force_band.hardest_table(contents),
            appendix=True,
            files=("tables/courses.csv",) if contents.courses is not None else (),
        )
    )
    bars, inside = hardest_scene.bars_figure(contents), hardest_scene.stress_inside_figure(contents)
    heading_bars = "What the bars see of the hardest scene"
    blocks.append(Block(heading=heading_bars, finding=bars.finding if bars else "", picture=bars))
    blocks.append(
        Block(
            heading="Stress inside the sphere in the hardest scene",
            finding=inside.finding if inside else "",
            picture=inside,
        )
    )
    return Chapter(
        anchor="quantities",
        heading=heading,
        short="Quantities" if heading.startswith("The quantities") else "Over time",
        blocks=tuple(blocks),
        remark="Figures: drawn from up to 16 384 stored samples. Numbers: from all evaluations.",
    )


def computed_chapter(contents: Contents) -> Chapter:
    """Validity, the model that was chosen, and what of the accuracy asked for was reached."""
    missed = shortfalls([str(text) for text in contents.results["accuracy"]["missed"]], _SUBJECTS)[:200]
    blocks = [
        Block(
            heading=checks_heading(contents.results["validity"], "Validity of the model"),
            table=method.checks_table(contents) if contents.results["validity"] else None,
            kind="checks notes",
            files=("tables/validity.csv",),
        ),
        *(
            Block(
                heading=checks_heading(
                    reach.answer_checks(contents.results["margins"][name]),
                    f"Validity of the model at the answer for {limit_name(name)}",
                ),
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
            heading=f"Model chosen: {contents.results['model']['chosen']}",
            finding=f"The model is {contents.results['model']['chosen']}: {contents.results['model']['why']}.",
            table=method.model_table(contents),
            appendix=True,
        ),
        Block(
            heading=accuracy_heading(contents),
            finding=progress.progress_finding(contents),
            table=method.accuracy_table(contents),
            remarks=tuple(f"Not reached: {powers(text)}" for text in missed),
            appendix=True,
            kind="brief",
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


def others_chapter(contents: Contents) -> Chapter:
    """Distribution, drivers and what to measure of the quantities that no limit asks about."""
    blocks = []
    for name in others(contents):
        blocks.append(distribution_block(contents, name))
        if has_indices(contents, name):
            blocks += [indices_block(contents, name), *beyond_blocks(contents, name)]
            blocks.append(measure_block(contents, "sensitivity", name))
    return Chapter(
        anchor="others",
        heading="Quantities that no limit asks about",
        short="Other quantities",
        blocks=tuple(blocks),
    )


def methods_chapter(contents: Contents) -> Chapter:
    """The plan, the methods, and how the errors fell."""
    steps, speed = progress.convergence_figure(contents), progress.speed_figure(contents)
    blocks = [
        Block(heading="Plan and account", table=method.plan_table(contents), kind="notes"),
        Block(heading="Methods", table=method.methods_table(contents), kind="notes"),
        Block(
            heading="Error against evaluations",
            finding=progress.course_finding(contents, 0),
            picture=steps,
            remarks=(
                "Errors are half-widths of 95 % intervals over what the study asks for; for polynomial chaos the share "
                "of the variance that it leaves unexplained. Below the dashed line the accuracy is reached. Rings: "
                "answers that are read off the same rows, whose accuracy no stage pursues.",
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
    return Chapter(anchor="methods", heading="Methods and convergence", short="Methods", blocks=tuple(blocks))
