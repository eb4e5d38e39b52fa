"""The order of the page: the evidence behind the brief, then the annexes, each a function of what is stored.

A new figure or table is a block in the function of its chapter; a new chapter is an entry of `CHAPTERS`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Final

from uqsphere.quantities import reading_units
from uqsphere.report import tables
from uqsphere.report.contents import Contents, units_of
from uqsphere.report.figures import fragility, scene
from uqsphere.report.figures.canvas import Picture
from uqsphere.report.figures.distributions import (
    convergence_figure,
    distribution_figure,
    field_figure,
    sensitivity_figure,
    speed_figure,
)
from uqsphere.report.figures.history import loop_figure
from uqsphere.report.phrases import (
    ABSENT,
    Block,
    Chapter,
    Table,
    begin,
    breaks,
    call,
    cell,
    index_cell,
    input_name,
    limit_name,
    symbol,
)
from uqsphere.results import AnalysisEntry


def _block(
    heading: str,
    table: Table | None = None,
    *files: str,
    picture: Picture | None = None,
    kind: str = "",
    remark: str = "",
) -> Block:
    """A block whose numbers are in these tables of the run."""
    paths = tuple(f"tables/{name}.csv" for name in files)
    remarks = (remark,) if remark else ()
    return Block(heading=heading, picture=picture, table=table, remarks=remarks, files=paths, kind=kind)


def of_limits(contents: Contents) -> list[str]:
    """Quantities that have a limit, each once."""
    found = dict.fromkeys(limit.quantity for limit in contents.results.limits.values())
    return [name for name in found if name in contents.results.quantities]


def _twin(contents: Contents, name: str) -> str:
    """An earlier limit whose curve over the free scalar is the same; empty where there is none."""
    margins = contents.results.margins
    own, earlier = margins[name], list(margins)[: list(margins).index(name)]
    same = (n for n in earlier if margins[n].solve == own.solve and margins[n].curve == own.curve)
    return next((n for n in same if margins[n].values.keys() == own.values.keys() and own.curve), "")


# --- the evidence: what stands open behind the brief ------------------------------------------------------


def evidence_blocks(contents: Contents) -> Iterator[Block]:
    """Curves, tests and drivers as figures; then values, assumptions, limits and broken checks as tables."""
    yield from _curves(contents)
    yield from _tests(contents)
    for name in (of_limits(contents) or list(contents.results.sensitivity))[:2]:
        yield _block(f"What drives {symbol(name)}", None, "sensitivity", picture=sensitivity_figure(contents, name))
    yield _block("Force over time", None, "courses", picture=scene.force_band_figure(contents))
    yield _block("What is assumed of the strength", tables.granted_table(contents))
    yield carried_block(contents)
    if contents.results.limits:
        yield _block("Limits", tables.limits_table(contents), "limits")
    broken = tables.checks_table(contents, broken=True)
    yield _block("Checks of the model that are broken", broken, kind="checks notes")


def _curves(contents: Contents, *, fracture: bool = True) -> Iterator[Block]:
    """Share broken over the free scalar with the values asked for; without one, load against strength.

    With `fracture` off those of limits that break nothing, such as yield of the bars.
    """
    results = contents.results
    for name, margin in results.margins.items():
        if (not results.fracture or breaks(results, name)) is not fracture:
            continue
        twin = _twin(contents, name)
        heading = f"Share {'broken by' if fracture else 'over'} {limit_name(name)}"
        table = tables.margins_table(contents, name, only_own=bool(twin))
        picture = fragility.fragility_figure(contents, name)
        yield _block(heading, table, "margins", "fragility", picture=picture)
        if margin.family and not twin:
            heading = f"{limit_name(name)} over {input_name(margin.family.path)}"
            yield _block(heading, picture=fragility.family_figure(contents, name))
    if fracture and not results.margins:
        for name in _drawn(contents):
            yield _block(begin(name, call(name)), picture=distribution_figure(contents, name))


def _drawn(contents: Contents) -> list[str]:
    """Quantities whose distributions stand among the evidence."""
    return [] if contents.results.margins else (of_limits(contents) or list(contents.results.quantities))[:3]


def _tests(contents: Contents) -> Iterator[Block]:
    """The tests behind the strengths, each series once, with what they measured and whether they are made up."""
    seen: list[tuple[object, str]] = []
    for name, limit in contents.results.limits.items():
        own = f"limits.{name}.strength"
        known, key = fragility.fitted_tests(contents, name), (contents.resolved.random.get(own), limit.quantity)
        if known is None or key in seen:
            continue
        seen.append(key)
        told = contents.tests.get(own, f"{known.fit.tests} tests")
        remark = f"{told}{', made up' if own in contents.resolved.made_up else ''}."
        yield _block(f"Tests behind {limit_name(name)}", picture=fragility.probability_plot(known), remark=remark)


def carried_block(contents: Contents) -> Block:
    """What strengths measured elsewhere answer by each carrier; empty where there are none."""
    rows = []
    for name, limit in contents.results.limits.items():
        carried = limit.carried
        if not carried:
            continue
        subject = contents.subject(carried.solve)
        cells = [cell(entry, subject, probability=not carried.solve) for entry in carried.by_carrier().values()]
        what = input_name(carried.solve) if carried.solve else "probability of missing the aim"
        rows.append((limit_name(name), what, *cells, carried.safe(limit.aim) or ABSENT))
    header = ("limit", "what", "by force", "by energy", "by centre", "safe end")
    caption = "Answers by what carries the strength from its test: force, energy in the sphere, tension at its centre"
    return _block("Carried from the tests", Table(caption=caption, header=header, rows=tuple(rows)) if rows else None)


# --- the annexes ------------------------------------------------------------------------------------------


def inputs_blocks(contents: Contents) -> Iterator[Block]:
    """Inputs with their laws and sources."""
    table = tables.inputs_table(contents) if contents.results.inputs else None
    random = _block("Random inputs", table, "inputs", kind="notes")
    yield replace(random, remarks=tuple(tables.dependence_texts(contents)))
    yield _block("Fixed numbers", tables.fixed_table(contents), kind="notes")


def fracture_blocks(contents: Contents) -> Iterator[Block]:
    """Fracture by any limit, and what margins are made of."""
    results = contents.results
    picture = fragility.interplay_figure(contents) if results.fracture else None
    yield _block("Fracture by any limit", fragility.fracture_table(contents), "fracture", picture=picture)
    yield from _curves(contents, fracture=False)
    for name in results.margins:
        yield from fragility.energy_block(contents, name)
    for name, margin in results.margins.items():
        if margin.family and not _twin(contents, name):
            yield _block(f"Family of {limit_name(name)}", fragility.family_table(contents, name))
        yield _block(f"What the margin of {limit_name(name)} is made of", tables.parts_table(contents, name))
    for name in results.limits:
        yield _block(f"Likeliest miss of {limit_name(name)}", tables.design_table(contents, name))
        table = tables.given_failure_table(contents, name)
        yield _block(f"Inputs where {limit_name(name)} is missed", table, "drivers")
        known = fragility.fitted_tests(contents, name)
        fit = None if known is None else fragility.tests_table(known)
        yield _block(f"Law fitted to the tests of {limit_name(name)}", fit)


def quantities_blocks(contents: Contents) -> Iterator[Block]:
    """How every quantity is distributed."""
    for name in contents.results.quantities:
        picture = None if name in _drawn(contents) else distribution_figure(contents, name)
        yield _block(begin(name, call(name)), tables.quantity_table(contents, name), "quantities", picture=picture)


def drivers_blocks(contents: Contents) -> Iterator[Block]:
    """Indices of failure and of every quantity in all kinds, and what better known inputs are worth."""
    results = contents.results
    for name in results.limits:
        yield _block(f"Missing {limit_name(name)}", tables.failure_table(contents, name), "drivers")
    shown = (of_limits(contents) or list(results.sensitivity))[:2]
    for name in results.sensitivity:
        words, picture = symbol(name), None if name in shown else sensitivity_figure(contents, name)
        yield _block(f"Indices of {words}", tables.index_table(contents, name), "sensitivity", picture=picture)
        yield _block(f"{words}: pairs of inputs", tables.pair_table(contents, name), "sensitivity")
        yield _block(f"{words}: groups of inputs", tables.group_table(contents, name), "sensitivity")
        yield _block(f"{words} beyond its variance", tables.distances_table(contents, name), "drivers")
    asked = {limit_name(name): entry.measure_first for name, entry in results.limits.items()}
    asked |= {symbol(name): entry.measure_first for name, entry in results.sensitivity.items()}
    for words, entry in asked.items():
        table = tables.measure_table(entry, f"What better known inputs are worth, {words}")
        yield _block(f"What to measure first for {words}", table, "drivers")


def screening_blocks(contents: Contents) -> Iterator[Block]:
    """Effects of one input at a time, those that move a quantity furthest first, and a model's own scatter."""
    entry, own = (contents.results.analyses.get(name, AnalysisEntry()) for name in ("morris", "replicates"))
    for quantity, split in own.values.items():
        caption = f"Scatter of {symbol(quantity)} where a row is evaluated again, and by its inputs, 95 % intervals"
        parts = [part for row in split.values() for part in row.items()]
        rows = tuple((of, cell(one, "" if of.startswith("share") else quantity)) for of, one in parts)
        table = Table(caption=caption, header=("of", "estimate"), rows=rows)
        yield _block(f"What the model itself adds to {symbol(quantity)}", table, "analyses")
    for quantity, found in entry.values.items():
        names = sorted(found, key=lambda name: -(found[name]["mean absolute effect"].value or 0.0))
        columns = tuple(found[names[0]])
        lines = tuple((input_name(n), *(cell(found[n][column], quantity) for column in columns)) for n in names)
        caption = f"Change of {symbol(quantity)} as one input crosses half of its law (Morris), with 95 % intervals"
        table = Table(caption=caption, header=("input", *columns), rows=lines)
        yield _block(f"Screening of {symbol(quantity)}", table, "analyses")
    if entry.reason:
        yield _block("Screening", remark=f"No input was screened: {entry.reason}.")


def fields_blocks(contents: Contents) -> Iterator[Block]:
    """Answers that are vectors: their bands, indices over places, and indices of all places together."""
    entry = contents.results.analyses.get("fields", AnalysisEntry())
    for name, stored in contents.fields.items():
        found = entry.values.get(name, {})
        names = sorted(found, key=lambda n: -(found[n]["aggregated total"].value or 0.0))
        rows = tuple((input_name(n), *map(index_cell, found[n].values())) for n in names)
        answer = stored.answer
        note = (
            f"{answer.components} principal components from {len(answer.rows)} rows leave {answer.truncated:.2g} of "
            f"the variance, with their expansions {answer.error:.2g}; the intervals hold both."
        )
        caption = f"Share of the variance of {name} over all its places, with 95 % intervals"
        table = Table(caption=caption, header=("input", "alone", "with interactions"), rows=rows, note=note)
        picture = field_figure(name, stored, over_time=contents.courses is not None)
        block = _block(f"{name} as a whole", table if rows else None, picture=picture, remark="" if rows else note)
        yield replace(block, files=("fields.nc", "tables/fields.csv"))
    if entry.reason:
        yield _block("Fields", remark=f"No field is answered: {entry.reason}.")


def scene_blocks(contents: Contents) -> Iterator[Block]:
    """The row that is loaded hardest: its inputs, its bars, the stress inside its sphere."""
    yield _block("Inputs of the row that is loaded hardest", scene.hardest_table(contents))
    yield _block("How its contact yields", picture=loop_figure(contents))
    yield _block("Stress in its bars", picture=scene.bars_figure(contents))
    yield _block("Stress inside its sphere", picture=scene.stress_inside_figure(contents))


def computed_blocks(contents: Contents) -> Iterator[Block]:
    """Validity, the model that was chosen, and what of the accuracy asked for was reached."""
    yield _block("Checks of the model", tables.checks_table(contents), "validity", kind="checks notes")
    for name in contents.results.margins:
        table = tables.answer_checks_table(contents, name)
        yield _block(f"Checks at the answer for {limit_name(name)}", table, kind="checks notes")
    words = "The paper’s formulas as printed, and corrected"
    yield _block(words, tables.paper_table(contents), "paper", kind="notes")
    yield _block(f"Model chosen: {contents.results.model.chosen}", tables.model_table(contents))
    yield _block("Accuracy asked and reached", tables.accuracy_table(contents), kind="brief")
    yield _block("Plan and account", tables.plan_table(contents), kind="notes")
    yield _block("Methods", tables.methods_table(contents), kind="notes")
    yield _block("Error against evaluations", None, "speed_error", picture=convergence_figure(contents))
    picture, files = speed_figure(contents), ("tables/speed_error.csv", "manifest.json")
    yield Block(heading="Speed against error of each method", picture=picture, files=files)


#: anchor, heading and blocks of a chapter
Part = tuple[str, str, Callable[[Contents], Iterator[Block]]]
#: the page from top to bottom, behind the brief; all but the first are annexes
CHAPTERS: Final[tuple[Part, ...]] = (
    ("evidence", "Evidence", evidence_blocks),
    ("inputs", "Inputs and their sources", inputs_blocks),
    ("fracture", "Fracture and margins", fracture_blocks),
    ("quantities", "Quantities", quantities_blocks),
    ("drivers", "What drives it, what to measure", drivers_blocks),
    ("screening", "One input at a time", screening_blocks),
    ("fields", "Answers over time or place", fields_blocks),
    ("scene", "The row that is loaded hardest", scene_blocks),
    ("computed", "How it was computed", computed_blocks),
)


def build_chapters(contents: Contents, parts: Sequence[Part] = CHAPTERS) -> list[Chapter]:
    """The chapters that have something to say, in the order of the page."""
    found = []
    for anchor, heading, blocks in parts:
        made = tuple(block for block in blocks(contents) if not block.empty)
        if made:
            found.append(Chapter(anchor=anchor, heading=heading, blocks=made, annex=anchor != "evidence"))
    return found


def service_chapters(contents: Contents) -> list[Chapter]:
    """A chapter for every service: its answers, its checks, and where its own page is."""
    chapters = []
    for name, own in contents.services.items():
        with reading_units(units_of(own.results, courses=own.courses)):
            blocks = [
                _block(
                    f"Share broken by {limit_name(limit)}",
                    tables.margins_table(own, limit),
                    picture=fragility.fragility_figure(own, limit),
                )
                for limit in own.results.margins
            ]
            blocks += [_block(f"Limits of {name}", tables.limits_table(own)), carried_block(own)]
            broken = tables.checks_table(own, broken=True)
            blocks.append(_block(f"Checks that are broken in {name}", broken, kind="checks notes"))
        remark = f"Its own page, with figures and drivers: services/{name}/report.html."
        heading = f"Service {name}"
        chapters.append(Chapter(anchor=f"service-{name}", heading=heading, blocks=tuple(blocks), remark=remark))
    return chapters
