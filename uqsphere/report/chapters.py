"""The order of the page: the evidence behind the brief, then the annexes, each a function of what is stored.

A new figure or table is a `Block` in the function of its chapter; a new chapter is an entry of `CHAPTERS`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

from uqsphere.report.blocks import Block, Chapter, Table, cell, index_cell
from uqsphere.report.contents import Contents
from uqsphere.report.drivers import (
    design_table,
    distances_table,
    failure_table,
    given_failure_table,
    index_table,
    measure_table,
    shapley_table,
)
from uqsphere.report.figures.convergence import convergence_figure, speed_figure
from uqsphere.report.figures.distributions import distribution_figure
from uqsphere.report.figures.fields import field_figure
from uqsphere.report.figures.fragility import energy_block, family_figure, family_table, fragility_figure
from uqsphere.report.figures.history import loop_figure
from uqsphere.report.figures.indices import group_figure, group_table, pair_table, sensitivity_figure
from uqsphere.report.figures.limits import fitted_tests, fracture_table, interplay_figure, probability_plot, tests_table
from uqsphere.report.figures.scene import bars_figure, force_band_figure, hardest_table, stress_inside_figure
from uqsphere.report.margins import parts_table
from uqsphere.report.phrases import begin, breaks, call, input_name, limit_name, symbol
from uqsphere.report.services import carried_block
from uqsphere.report.tables import (
    accuracy_table,
    answer_checks_table,
    checks_table,
    dependence_texts,
    fixed_table,
    granted_table,
    inputs_table,
    limits_table,
    margins_table,
    methods_table,
    model_table,
    paper_table,
    plan_table,
    quantity_table,
)


def of_limits(contents: Contents) -> list[str]:
    """Quantities that have a limit, each once."""
    found = dict.fromkeys(limit.quantity for limit in contents.results.limits.values())
    return [name for name in found if name in contents.results.quantities]


def _twin(contents: Contents, name: str) -> str:
    """An earlier limit whose curve over the free scalar is the same; empty where there is none."""
    margins = contents.results.margins
    earlier = list(margins)[: list(margins).index(name)]
    own = margins[name]
    same = (n for n in earlier if margins[n].solve == own.solve and margins[n].curve == own.curve)
    return next((n for n in same if margins[n].values.keys() == own.values.keys() and own.curve), "")


# --- the evidence: what stands open behind the brief ------------------------------------------------------


def evidence_chapter(contents: Contents) -> Chapter:
    """Curves, tests and drivers as figures; then values, assumptions, limits and broken checks as tables."""
    asked = of_limits(contents) or list(contents.results.sensitivity)
    blocks = [
        *_curves(contents),
        *_tests(contents),
        *(
            Block(
                heading=f"What drives {symbol(name)}",
                picture=sensitivity_figure(contents, name),
                files=("tables/sensitivity.csv",),
            )
            for name in asked[:2]
        ),
        Block(heading="Force over time", picture=force_band_figure(contents), files=("tables/courses.csv",)),
        Block(heading="What is assumed of the strength", table=granted_table(contents)),
        carried_block(contents),
    ]
    if contents.results.limits:
        blocks.append(Block(heading="Limits", table=limits_table(contents), files=("tables/limits.csv",)))
    broken = checks_table(contents, broken=True)
    blocks.append(Block(heading="Checks of the model that are broken", table=broken, kind="checks notes"))
    return Chapter(anchor="evidence", heading="Evidence", blocks=tuple(blocks))


def _curves(contents: Contents, *, fracture: bool = True) -> list[Block]:
    """Share broken over the free scalar with the values asked for; without one, load against strength.

    With `fracture` off those of limits that break nothing, such as yield of the bars.
    """
    results, blocks = contents.results, list[Block]()
    shown = [name for name in results.margins if (not results.fracture or breaks(results, name)) is fracture]
    for name in shown:
        twin = _twin(contents, name)
        blocks.append(
            Block(
                heading=f"Share {'broken by' if fracture else 'over'} {limit_name(name)}",
                picture=fragility_figure(contents, name),
                table=margins_table(contents, name, only_own=bool(twin)),
                files=("tables/margins.csv", "tables/fragility.csv"),
            )
        )
        if contents.results.margins[name].family and not twin:
            heading = f"{limit_name(name)} over {input_name(contents.results.margins[name].family.path)}"
            blocks.append(Block(heading=heading, picture=family_figure(contents, name)))
    if results.margins or not fracture:
        return blocks
    quantities = (of_limits(contents) or list(results.quantities))[:3]
    return [Block(heading=begin(name, call(name)), picture=distribution_figure(contents, name)) for name in quantities]


def _tests(contents: Contents) -> list[Block]:
    """The tests behind the strengths, each series once, with what they measured and whether they are made up."""
    blocks = []
    seen: list[tuple[object, str]] = []
    for name, limit in contents.results.limits.items():
        own = f"limits.{name}.strength"
        known, key = fitted_tests(contents, name), (contents.resolved.random.get(own), limit.quantity)
        if known is None or key in seen:
            continue
        seen.append(key)
        told = contents.tests.get(own, f"{known.fit.tests} tests")
        remark = f"{told}{', made up' if own in contents.resolved.made_up else ''}."
        heading = f"Tests behind {limit_name(name)}"
        blocks.append(Block(heading=heading, picture=probability_plot(known), remarks=(remark,)))
    return blocks


# --- the annexes ------------------------------------------------------------------------------------------


def fracture_chapter(contents: Contents) -> Chapter:
    """Fracture by any limit, and what margins are made of."""
    results = contents.results
    blocks = [
        Block(
            heading="Fracture by any limit",
            picture=interplay_figure(contents) if results.fracture else None,
            table=fracture_table(contents) if results.fracture else None,
            files=("tables/fracture.csv",),
        ),
        *_curves(contents, fracture=False),
        *(block for name in results.margins for block in energy_block(contents, name)),
    ]
    for name in results.margins:
        if results.margins[name].family and not _twin(contents, name):
            blocks.append(Block(heading=f"Family of {limit_name(name)}", table=family_table(contents, name)))
        heading = f"What the margin of {limit_name(name)} is made of"
        blocks.append(Block(heading=heading, table=parts_table(contents, name)))
    for name in results.limits:
        blocks.append(Block(heading=f"Likeliest miss of {limit_name(name)}", table=design_table(contents, name)))
        heading = f"Inputs where {limit_name(name)} is missed"
        table = given_failure_table(contents, name)
        blocks.append(Block(heading=heading, table=table, files=("tables/drivers.csv",)))
        known = fitted_tests(contents, name)
        fit = None if known is None else tests_table(known)
        blocks.append(Block(heading=f"Law fitted to the tests of {limit_name(name)}", table=fit))
    return Chapter(anchor="fracture", heading="Fracture and margins", blocks=tuple(blocks))


def quantities_chapter(contents: Contents) -> Chapter:
    """How every quantity is distributed."""
    drawn = [] if contents.results.margins else (of_limits(contents) or list(contents.results.quantities))[:3]
    blocks = [
        Block(
            heading=begin(name, call(name)),
            picture=None if name in drawn else distribution_figure(contents, name),
            table=quantity_table(contents, name),
            files=("tables/quantities.csv",),
        )
        for name in contents.results.quantities
    ]
    return Chapter(anchor="quantities", heading="Quantities", blocks=tuple(blocks))


def drivers_chapter(contents: Contents) -> Chapter:
    """Indices of failure and of every quantity, in all kinds."""
    blocks = []
    for name, limit in contents.results.limits.items():
        table = failure_table(contents, name) if limit.drivers else None
        blocks.append(Block(heading=f"Missing {limit_name(name)}", table=table, files=("tables/drivers.csv",)))
    asked = of_limits(contents) or list(contents.results.sensitivity)
    for name in contents.results.sensitivity:
        blocks += [
            Block(
                heading=f"Indices of {symbol(name)}",
                picture=None if name in asked[:2] else sensitivity_figure(contents, name),
                table=index_table(contents, name) or shapley_table(contents, name),
                files=("tables/sensitivity.csv",),
            ),
            Block(
                heading=f"{symbol(name)}: pairs of inputs",
                table=pair_table(contents, name),
                files=("tables/sensitivity.csv",),
            ),
            Block(
                heading=f"{symbol(name)}: groups of inputs",
                picture=group_figure(contents, name),
                table=group_table(contents, name),
                files=("tables/sensitivity.csv",),
            ),
            Block(
                heading=f"{symbol(name)} beyond its variance",
                table=distances_table(contents, name),
                files=("tables/drivers.csv",),
            ),
        ]
    blocks += _measured(contents)
    return Chapter(anchor="drivers", heading="What drives it, what to measure", blocks=tuple(blocks))


def _measured(contents: Contents) -> list[Block]:
    """What better known inputs are worth, for every limit and every quantity."""
    results = contents.results
    asked = {limit_name(name): entry.measure_first for name, entry in results.limits.items()}
    asked |= {symbol(name): entry.measure_first for name, entry in results.sensitivity.items()}
    return [
        Block(
            heading=f"What to measure first for {words}",
            table=measure_table(entry, f"What better known inputs are worth, {words}"),
            files=("tables/drivers.csv",),
        )
        for words, entry in asked.items()
    ]


def screening_chapter(contents: Contents) -> Chapter:
    """Effects of one input at a time, those that move a quantity furthest first, and a model's own scatter."""
    entry, blocks = contents.results.analyses.get("morris"), []
    own = contents.results.analyses.get("replicates")
    for quantity, split in own.values.items() if own else ():
        shown = Table(
            caption=f"Scatter of {symbol(quantity)} where a row is evaluated again, and by its inputs, 95 % intervals",
            header=("of", "estimate"),
            rows=tuple(
                (of, cell(one, "" if of.startswith("share") else quantity))
                for row in split.values()
                for of, one in row.items()
            ),
        )
        heading = f"What the model itself adds to {symbol(quantity)}"
        blocks.append(Block(heading=heading, table=shown, files=("tables/analyses.csv",)))
    for quantity, table in entry.values.items() if entry else ():
        names = sorted(table, key=lambda name: -(table[name]["mean absolute effect"].value or 0.0))
        columns = tuple(table[names[0]])
        rows = tuple((input_name(n), *(cell(table[n][column], quantity) for column in columns)) for n in names)
        caption = f"Change of {symbol(quantity)} as one input crosses half of its law (Morris), with 95 % intervals"
        shown = Table(caption=caption, header=("input", *columns), rows=rows)
        blocks.append(Block(heading=f"Screening of {symbol(quantity)}", table=shown, files=("tables/analyses.csv",)))
    if entry and entry.reason:
        blocks.append(Block(heading="Screening", remarks=(f"No input was screened: {entry.reason}.",)))
    return Chapter(anchor="screening", heading="One input at a time", blocks=tuple(blocks))


def fields_chapter(contents: Contents) -> Chapter:
    """Answers that are vectors: their bands, indices over places, and indices of all places together."""
    entry, blocks = contents.results.analyses.get("fields"), []
    over_time = contents.courses is not None
    values = entry.values if entry else {}
    for name, stored in contents.fields.items():
        rows = sorted(values.get(name, {}).items(), key=lambda item: -(item[1]["aggregated total"].value or 0.0))
        cells = tuple((input_name(n), *(index_cell(est) for est in columns.values())) for n, columns in rows)
        answer = stored.answer
        note = (
            f"{answer.components} principal components from {len(answer.rows)} rows leave {answer.truncated:.2g} of "
            f"the variance, with their expansions {answer.error:.2g}; the intervals hold both."
        )
        caption = f"Share of the variance of {name} over all its places, with 95 % intervals"
        table = Table(caption=caption, header=("input", "alone", "with interactions"), rows=cells, note=note)
        blocks.append(Block(heading=f"{name} as a whole", picture=field_figure(name, stored, over_time=over_time),
                            table=table if cells else None, remarks=() if cells else (note,),
                            files=("fields.nc", "tables/fields.csv")))  # fmt: skip
    if entry and entry.reason:
        blocks.append(Block(heading="Fields", remarks=(f"No field is answered: {entry.reason}.",)))
    return Chapter(anchor="fields", heading="Answers over time or place", blocks=tuple(blocks))


def scene_chapter(contents: Contents) -> Chapter:
    """The row that is loaded hardest: its inputs, its bars, the stress inside its sphere."""
    blocks = (
        Block(heading="Inputs of the row that is loaded hardest", table=hardest_table(contents)),
        Block(heading="How its contact yields", picture=loop_figure(contents)),
        Block(heading="Stress in its bars", picture=bars_figure(contents)),
        Block(heading="Stress inside its sphere", picture=stress_inside_figure(contents)),
    )
    return Chapter(anchor="scene", heading="The row that is loaded hardest", blocks=blocks)


def computed_chapter(contents: Contents) -> Chapter:
    """Validity, the model that was chosen, and what of the accuracy asked for was reached."""
    blocks = [
        Block(
            heading="Checks of the model",
            table=checks_table(contents) if contents.results.validity else None,
            kind="checks notes",
            files=("tables/validity.csv",),
        ),
        *(
            Block(
                heading=f"Checks at the answer for {limit_name(name)}",
                table=answer_checks_table(contents, name),
                kind="checks notes",
            )
            for name in contents.results.margins
        ),
        Block(
            heading="The paper’s formulas as printed, and corrected",
            table=paper_table(contents),
            kind="notes",
            files=("tables/paper.csv",),
        ),
        Block(heading=f"Model chosen: {contents.results.model.chosen}", table=model_table(contents)),
        Block(heading="Accuracy asked and reached", table=accuracy_table(contents), kind="brief"),
        Block(heading="Plan and account", table=plan_table(contents), kind="notes"),
        Block(heading="Methods", table=methods_table(contents), kind="notes"),
        Block(
            heading="Error against evaluations", picture=convergence_figure(contents), files=("tables/speed_error.csv",)
        ),
        Block(
            heading="Speed against error of each method",
            picture=speed_figure(contents),
            files=("tables/speed_error.csv", "manifest.json"),
        ),
    ]
    return Chapter(anchor="computed", heading="How it was computed", blocks=tuple(blocks))


def inputs_chapter(contents: Contents) -> Chapter:
    """Inputs with their laws and sources."""
    blocks = (
        Block(
            heading="Random inputs",
            table=inputs_table(contents) if contents.results.inputs else None,
            remarks=tuple(dependence_texts(contents)),
            kind="notes",
            files=("tables/inputs.csv",),
        ),
        Block(heading="Fixed numbers", table=fixed_table(contents), kind="notes"),
    )
    return Chapter(anchor="inputs", heading="Inputs and their sources", blocks=blocks)


#: the page from top to bottom, behind the brief
CHAPTERS: Final[tuple[Callable[[Contents], Chapter], ...]] = (
    evidence_chapter,
    inputs_chapter,
    fracture_chapter,
    quantities_chapter,
    drivers_chapter,
    screening_chapter,
    fields_chapter,
    scene_chapter,
    computed_chapter,
)


def build_chapters(contents: Contents) -> list[Chapter]:
    """The chapters that have something to say, in the order of the page."""
    found = []
    for build in CHAPTERS:
        chapter = build(contents)
        if any(not block.empty for block in chapter.blocks):
            found.append(replace(chapter, annex=build is not evidence_chapter))
    return found
