"""Headings that tell the finding where there is one, after the subject that the list of contents names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

from uqsphere.report.assumptions import answer_checks, granted_block, turns
from uqsphere.report.blocks import Block, Chapter, Table, cell
from uqsphere.report.claims import (
    Claim,
    demand_claim,
    distribution_claim,
    measure_claim,
    ranked,
    shares_claim,
)
from uqsphere.report.contents import Contents
from uqsphere.report.drivers import (
    design_finding,
    design_table,
    distances_finding,
    distances_table,
    drivers_remark,
    failure_finding,
    failure_table,
    given_failure_table,
    measure_remarks,
    measure_table,
    mostly_missed,
    shapley_table,
    told_from_none,
)
from uqsphere.report.figures.convergence import convergence_figure, course_finding, progress_finding, speed_figure
from uqsphere.report.figures.distributions import distribution_figure, overlap_remarks, single_value
from uqsphere.report.figures.fragility import (
    energy_block,
    family_figure,
    family_finding,
    family_table,
    fragility_figure,
    fragility_finding,
    lognormal_remarks,
    margin_figure,
)
from uqsphere.report.figures.history import loop_figure
from uqsphere.report.figures.indices import (
    MOST_INPUTS,
    group_figure,
    group_finding,
    group_table,
    pair_figure,
    pair_finding,
    pair_table,
    sensitivity_figure,
)
from uqsphere.report.figures.limits import (
    fitted_tests,
    fracture_finding,
    fracture_table,
    interplay_figure,
    interplay_remarks,
    probability_plot,
    surface_figure,
    surface_finding,
    tests_table,
)
from uqsphere.report.figures.scene import (
    bars_figure,
    force_band_figure,
    force_band_finding,
    force_band_heading,
    hardest_table,
    stress_inside_figure,
)
from uqsphere.report.figures.swings import (
    furthest,
    swings,
    tornado_figure,
    tornado_finding,
    tornado_table,
    waterfall_figure,
    waterfall_finding,
    waterfall_heading,
    waterfall_table,
)
from uqsphere.report.margins import parts_finding, parts_table
from uqsphere.report.phrases import (
    answer_text,
    begin,
    call,
    capital,
    input_name,
    limit_name,
    mathematical,
    plain_percent,
    powers,
    rounded,
    short_input,
    shortfalls,
    symbol,
    the_input,
)
from uqsphere.report.services import carried_block
from uqsphere.report.tables import (
    accuracy_table,
    answer_checks_table,
    checks_table,
    dependence_texts,
    fixed_table,
    index_table,
    inputs_table,
    limits_table,
    margins_table,
    methods_table,
    model_table,
    paper_table,
    plan_table,
    quantity_table,
)


def _told(subject: str, finding: str) -> str:
    return f"{subject}: {finding}" if finding else subject


def fragility_heading(contents: Contents, name: str) -> str:
    """Where the curve reaches the accepted probability, or one half where none was accepted."""
    entry = contents.results.margins[name]
    subject = f"Fragility of {limit_name(name)}"
    if entry.value.value is not None and entry.probability:
        return f"{subject}: {plain_percent(entry.probability)} at {answer_text(contents, name)}"
    middle = entry.values.get("0.5")
    if not middle or middle.value is None:
        return subject
    return f"{subject}: one half at {rounded(middle, contents.subject(entry.solve))}"


def family_heading(contents: Contents, name: str) -> str:
    """Between which values one half breaks over the family."""
    entry = contents.results.margins[name]
    family = entry.family
    subject = f"Fragility of {limit_name(name)} over {input_name(family.path)}"
    known = [m.values["0.5"] for m in family.members if "0.5" in m.values and m.values["0.5"].value is not None]
    if len(known) < 2:
        return subject
    first, last = (rounded(e, contents.subject(entry.solve)) for e in (known[0], known[-1]))
    return f"{subject}: one half at {first} to {last}"


def demand_heading(contents: Contents) -> str:
    """The median margin of one limit or of two."""
    limits = contents.results.limits
    found = {name: demand_claim(name, limit).short for name, limit in limits.items()}
    texts = [(limit_name(name, 20), short) for name, short in found.items() if short]
    if not texts or len(limits) > 2:
        return "Strength over demand"
    if len({text for _, text in texts}) == 1:
        return f"Strength over demand: {texts[0][1]} in the median case"
    return "Strength over demand: " + ", ".join(f"{text} for {name}" for name, text in texts)


def parts_heading(contents: Contents, name: str) -> str:
    """What takes the largest part of a margin at the answer."""
    shares = contents.results.margins[name].lost_to.shares
    largest = max(shares, key=lambda key: shares[key], default=None)
    finding = "" if largest is None else f"{100.0 * shares[largest]:.0f} % by {the_input(largest)}"
    return _told(f"What the margin of {limit_name(name)} is made of", finding)


def fracture_heading(contents: Contents) -> str:
    """When it breaks in the median."""
    found = contents.results.fracture
    median = found.time.median
    if median.value is None:
        return "Fracture"
    return f"Fracture: in the median after {rounded(median, 'contact_time', 3)}"


def distribution_heading(contents: Contents, name: str) -> str:
    """Between which values nine cases of ten lie."""
    return _told(begin(name, call(name)), distribution_claim(contents.results, name).short)


def failure_heading(contents: Contents, name: str) -> str:
    """What decides most whether an aim is missed, of what the indices are about."""
    entry = contents.results.limits[name].drivers
    table = entry.shapley or entry.total or {}
    known = {key: e.value for key, e in table.items() if e.value is not None}
    largest = max(known, key=lambda key: known[key], default=None)
    who = "" if largest is None or not told_from_none(table[largest]) else f"most by {the_input(largest)}"
    if who and entry.of != "missing the aim":
        who += ", of the model’s inputs"
    return _told(f"Missing the aim of {limit_name(name)}", who)


def indices_heading(contents: Contents, name: str) -> str:
    """Which input drives a quantity, and how much of its variance."""
    return shares_claim(contents.results, name).short or symbol(name)


def swings_heading(contents: Contents, name: str, furthest: str) -> str:
    """Which input moves a quantity furthest."""
    return _told(f"How far each input moves {symbol(name)}", furthest and f"{short_input(furthest)} furthest")


def measure_heading(words: str, claim: Claim | None) -> str:
    """Which input to measure first, where one can be told from those that do nothing."""
    return _told(f"What to measure first for {words}", claim.short if claim is not None else "")


def granted_heading(contents: Contents) -> str:
    """Whether a verdict turns on what is assumed of a strength."""
    limits = contents.results.limits.values()
    rows = [(limit, row) for limit in limits for row in limit.assumed or () if limit.target is not None]
    finding = ""
    if any(turns(limit, row) for limit, row in rows):
        finding = "a verdict turns on it"
    elif rows:
        finding = "no verdict turns on it"
    return _told("What the verdict takes for granted", finding)


def checks_heading(contents: Contents, subject: str, name: str = "") -> str:
    """How many of the validity checks are broken: as planned, or at the answer for a limit."""
    checks = answer_checks(contents.results.margins[name]) if name else contents.results.validity
    broken = [c for c in checks if c.share_failure + c.share_warning > 0.0]
    if not checks:
        return subject
    if not broken:
        return f"{subject}: no check is broken"
    return f"{subject}: {len(broken)} of {len(checks)} checks {'is' if len(broken) == 1 else 'are'} broken somewhere"


def accuracy_heading(contents: Contents) -> str:
    """How much of the accuracy asked for was not reached: of the questions of the table, where there are any."""
    missed = len(contents.results.accuracy.missed)
    rows = [row for row in contents.results.accuracy.questions or () if row.met is not None]
    late = sum(not row.met for row in rows)
    told = f"{late} of {len(rows)} not" if late else f"{missed} not" if missed else ""
    told = "all of it" if contents.results.accuracy.met else told
    return capital(_told("what was asked, what was reached", told))


# --- The blocks of one quantity: its distribution, its indices, and what lies beyond them.


def distribution_block(contents: Contents, name: str) -> Block:
    """The distribution of a quantity, its numbers in the appendix."""
    single = single_value(contents, name)
    finding = f"One value: {single}." if single else distribution_claim(contents.results, name).told
    return Block(
        heading=distribution_heading(contents, name),
        finding=finding,
        picture=distribution_figure(contents, name),
        table=quantity_table(contents, name),
        appendix=not single,
        files=("tables/quantities.csv",),
        remarks=overlap_remarks(contents, name),
    )


def decided(contents: Contents) -> list[str]:
    """Quantities whose distribution is the figure of the decision: where no fragility was asked for."""
    if contents.results.margins:
        return []
    return of_limits(contents) or list(contents.results.quantities)[:1]


def of_limits(contents: Contents) -> list[str]:
    """Quantities that have a limit, each once."""
    found = dict.fromkeys(limit.quantity for limit in contents.results.limits.values())
    return [name for name in found if name in contents.results.quantities]


def indices_block(contents: Contents, name: str) -> Block:
    """What drives a quantity."""
    entry = contents.results.sensitivity[name]
    picture = sensitivity_figure(contents, name)
    remarks = [powers(str(entry.check.text or ""))] if picture is not None else []
    hidden = len(ranked(entry)) - MOST_INPUTS
    if hidden > 0:
        remarks.append(f"The figure shows the {MOST_INPUTS} largest; {hidden} more are in the table.")
    return Block(
        heading=indices_heading(contents, name),
        finding=shares_claim(contents.results, name).text,
        picture=picture,
        table=index_table(contents, name) or shapley_table(contents, name),
        remarks=tuple(text for text in remarks if text),
        appendix=picture is not None,
        files=("tables/sensitivity.csv",),
    )


def beyond_blocks(contents: Contents, name: str) -> list[Block]:
    """Pairs, groups, swings, and distances between whole laws."""
    return [
        Block(
            heading=f"{symbol(name)}: which inputs act together",
            finding=pair_finding(contents, name),
            picture=pair_figure(contents, name),
            table=pair_table(contents, name),
            appendix=True,
            files=("tables/sensitivity.csv",),
        ),
        Block(
            heading=f"{symbol(name)}: groups of inputs",
            finding=group_finding(contents, name),
            picture=group_figure(contents, name),
            table=group_table(contents, name),
            appendix=True,
            files=("tables/sensitivity.csv",),
        ),
        Block(
            heading=swings_heading(contents, name, furthest(contents, name)),
            finding=tornado_finding(contents, name) if swings(contents, name) else "",
            picture=tornado_figure(contents, name),
            table=tornado_table(contents, name),
            appendix=True,
        ),
        Block(
            heading=f"{symbol(name)} beyond its variance",
            finding=distances_finding(contents, name),
            table=distances_table(contents, name),
            appendix=True,
            files=("tables/drivers.csv",),
        ),
    ]


def has_indices(contents: Contents, name: str) -> bool:
    """Whether anything was asked about what drives a quantity."""
    return name in contents.results.sensitivity


def measure_block(contents: Contents, kind: str, name: str) -> Block:
    """What to measure first, for a limit (`kind` "limits") or for a quantity ("sensitivity")."""
    limit = kind == "limits"
    first = (contents.results.limits[name] if limit else contents.results.sensitivity[name]).measure_first
    words = limit_name(name) if limit else symbol(name)
    caption = f"What better known laws are worth, {words}" if limit else f"What the variance of {words} would lose"
    table = measure_table(first, caption)
    claim = measure_claim(name, first)
    heading = measure_heading(words, claim)
    if table is None or claim is None:
        return Block(heading=heading)
    method = first.method
    if (first.probability or 0.0) > 0.5:
        method = method.replace("(0.1 p))^2", "(0.1 p))^2, p the smaller side of the probability", 1)
    return Block(
        heading=heading,
        finding=claim.text,
        table=table,
        remarks=(mathematical(method), *measure_remarks(contents, name, kind)),
        files=("tables/drivers.csv",),
    )


# --- The later chapters: quantities over time, validity, inputs, what no limit asks about, methods and convergence.

#: subjects that a sentence about accuracies names; the table has every question
_SUBJECTS = 24


def others(contents: Contents) -> list[str]:
    """Quantities that no limit asks about, where there are limits."""
    asked = of_limits(contents)
    return [name for name in contents.results.quantities if name not in asked] if asked else []


def quantities_chapter(contents: Contents) -> Chapter:
    """The force over time, the hardest scene in its bars and inside; distributions too where there is no limit."""
    shown = {*decided(contents), *others(contents)}
    blocks = [distribution_block(contents, name) for name in contents.results.quantities if name not in shown]
    blocks = [] if contents.results.limits else blocks
    heading, short = ("The quantities in full", "Quantities") if blocks else ("Force and stress over time", "Over time")
    blocks.append(
        Block(
            heading=force_band_heading(contents),
            finding=force_band_finding(contents),
            picture=force_band_figure(contents),
            table=hardest_table(contents),
            appendix=True,
            files=("tables/courses.csv",) if contents.courses is not None else (),
        )
    )
    loop, bars, inside = loop_figure(contents), bars_figure(contents), stress_inside_figure(contents)
    if loop is not None:
        heading_loop = "How the contact of the hardest scene yields"
        blocks.append(Block(heading=heading_loop, finding=loop.finding, picture=loop, appendix=True))
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
        short=short,
        blocks=tuple(blocks),
        remark="Figures: drawn from up to 16 384 stored samples. Numbers: from all evaluations.",
    )


def computed_chapter(contents: Contents) -> Chapter:
    """Validity, the model that was chosen, and what of the accuracy asked for was reached."""
    missed = shortfalls([str(text) for text in contents.results.accuracy.missed], _SUBJECTS)[:200]
    blocks = [
        Block(
            heading=checks_heading(contents, "Validity of the model"),
            table=checks_table(contents) if contents.results.validity else None,
            kind="checks notes",
            files=("tables/validity.csv",),
        ),
        *(
            Block(
                heading=checks_heading(contents, f"Validity of the model at the answer for {limit_name(name)}", name),
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
        Block(
            heading=f"Model chosen: {contents.results.model.chosen}",
            finding=f"The model is {contents.results.model.chosen}: {contents.results.model.why}.",
            table=model_table(contents),
            appendix=True,
        ),
        Block(
            heading=accuracy_heading(contents),
            finding=progress_finding(contents),
            table=accuracy_table(contents),
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
    dependence = tuple(dependence_texts(contents))
    fixed = fixed_table(contents)
    blocks = (
        Block(
            heading="Random inputs",
            table=inputs_table(contents) if contents.results.inputs else None,
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


def screening_chapter(contents: Contents) -> Chapter:
    """Effects of one input at a time, those that move a quantity furthest first."""
    entry, blocks = contents.results.analyses.get("morris"), []
    for quantity, table in entry.values.items() if entry else ():
        names = sorted(table, key=lambda name: -(table[name]["mean absolute effect"].value or 0.0))
        columns = tuple(table[names[0]])
        rows = tuple((input_name(n), *(cell(table[n][column], quantity) for column in columns)) for n in names)
        told = (
            f"{capital(the_input(names[0]))} moves {symbol(quantity)} furthest when it crosses half of its law alone."
        )
        caption = f"Change of {symbol(quantity)} as one input crosses half of its law (Morris), with 95 % intervals"
        shown = Table(caption=caption, header=("input", *columns), rows=rows)
        blocks.append(Block(heading=f"Screening of {symbol(quantity)}", finding=told, table=shown,
                            files=("tables/analyses.csv",)))  # fmt: skip
    if entry and entry.reason:
        blocks.append(Block(heading="Screening", finding=f"No input was screened: {entry.reason}."))
    return Chapter(anchor="screening", heading="One input at a time", short="Screening", blocks=tuple(blocks))


def methods_chapter(contents: Contents) -> Chapter:
    """The plan, the methods, and how the errors fell."""
    steps, speed = convergence_figure(contents), speed_figure(contents)
    blocks = [
        Block(heading="Plan and account", table=plan_table(contents), kind="notes"),
        Block(heading="Methods", table=methods_table(contents), kind="notes"),
        Block(
            heading="Error against evaluations",
            finding=course_finding(contents, 0),
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
            finding=course_finding(contents, 1) if speed is not None else "",
            picture=speed,
            files=("tables/speed_error.csv", "manifest.json"),
        ),
    ]
    return Chapter(anchor="methods", heading="Methods and convergence", short="Methods", blocks=tuple(blocks))


# --- The order of the page: one list of chapters, each a function from what is stored to its blocks.
# A new figure or table is a `Block` in the function of its chapter; a new chapter is an entry of `CHAPTERS`.


#: chapters that stand open behind the brief; the others are annexes
_EVIDENCE: Final = ("decision", "margins", "quantities")


def build_chapters(contents: Contents) -> list[Chapter]:
    """The chapters that have something to say, in the order of the page."""
    found = []
    for build in CHAPTERS:
        chapter = build(contents)
        if any(not block.empty for block in chapter.blocks):
            found.append(replace(chapter, annex=chapter.anchor not in _EVIDENCE))
    return found


# --- the decision and its margins -----------------------------------------------------------------------


def _twin(contents: Contents, name: str) -> str:
    """An earlier limit whose curve over the free scalar is the same; empty where there is none."""
    margins = contents.results.margins
    earlier = list(margins)[: list(margins).index(name)]
    own = margins[name]
    same = (n for n in earlier if margins[n].solve == own.solve and margins[n].curve == own.curve)
    return next((n for n in same if margins[n].values.keys() == own.values.keys() and own.curve), "")


def _fragility(contents: Contents, name: str) -> Block:
    twin = _twin(contents, name)
    if twin:
        # the target is another one, and so is the answer; the values and their curve stand there already
        return Block(
            heading=fragility_heading(contents, name),
            finding=f"The curve and its values are those of {limit_name(twin)}; the target is another one.",
            picture=fragility_figure(contents, name),
            table=margins_table(contents, name, only_own=True),
            files=("tables/margins.csv", "tables/fragility.csv"),
        )
    return Block(
        heading=fragility_heading(contents, name),
        finding=fragility_finding(contents, name),
        picture=fragility_figure(contents, name),
        table=margins_table(contents, name),
        remarks=lognormal_remarks(contents, name),
        files=("tables/margins.csv", "tables/fragility.csv"),
    )


def _family(contents: Contents, name: str) -> list[Block]:
    if not contents.results.margins[name].family:
        return []
    if _twin(contents, name):
        return []
    return [
        Block(
            heading=family_heading(contents, name),
            finding=family_finding(contents, name),
            picture=family_figure(contents, name),
            table=family_table(contents, name),
        )
    ]


def decision_chapter(contents: Contents) -> Chapter:
    """Fragility with operating point and target; else the demand against the strength."""
    blocks = [_fragility(contents, name) for name in contents.results.margins]
    blocks += [block for name in contents.results.margins for block in energy_block(contents, name)]
    blocks += [block for name in contents.results.margins for block in _family(contents, name)]
    blocks += [distribution_block(contents, name) for name in decided(contents)]
    blocks.append(granted_block(contents, granted_heading(contents)))
    return Chapter(anchor="decision", heading="The decision", short="Decision", blocks=tuple(blocks))


def _same_tests(contents: Contents, one: str, other: str) -> bool:
    """Whether two limits rest on the same law, fitted to the same tests."""
    laws = [contents.resolved.random.get(f"limits.{name}.strength") for name in (one, other)]
    units = [contents.results.limits[name].quantity for name in (one, other)]
    return bool(laws[0] == laws[1] and units[0] == units[1])


def _sides(contents: Contents, name: str) -> Block:
    """The samples on both sides of a limit; left out where too few lie on one of them for a picture."""
    picture = surface_figure(contents, name)
    finding = surface_finding(contents, name) if picture is not None else ""
    return Block(heading=f"On which side of {limit_name(name)} the samples lie", finding=finding, picture=picture)


def _limit_blocks(contents: Contents, name: str) -> list[Block]:
    """How the aim of a limit would be missed, and the tests behind its strength."""
    limits = contents.results.limits
    way = "keep" if mostly_missed(limits[name]) else "miss"
    heading = f"The likeliest way to {way} the aim of {limit_name(name)}"
    blocks = [
        Block(
            heading=waterfall_heading(contents, name),
            finding=waterfall_finding(contents, name),
            picture=waterfall_figure(contents, name),
            table=waterfall_table(contents, name),
            appendix=True,
        ),
        _sides(contents, name),
        Block(
            heading=heading,
            finding=design_finding(contents, name) if design_table(contents, name) else "",
            table=design_table(contents, name),
        ),
        Block(
            heading=f"Inputs where {limit_name(name)} is missed",
            table=given_failure_table(contents, name),
            files=("tables/drivers.csv",),
        ),
    ]
    known = fitted_tests(contents, name)
    if known is not None:
        twin = next((n for n in limits if _same_tests(contents, n, name)), name)
        if twin != name:
            heading = f"The tests behind the strength of {limit_name(name)}"
            blocks.append(Block(heading=heading, finding=f"The tests and the law are those of {limit_name(twin)}."))
            return blocks
        heading, picture = f"The tests behind the strength of {limit_name(name)}", probability_plot(known)
        blocks.append(Block(heading=heading, finding=picture.finding, picture=picture, table=tests_table(known)))
    return blocks


def margins_chapter(contents: Contents) -> Chapter:
    """How far the strength is from the demand, where the margin goes, and how it would be missed."""
    limits, blocks = contents.results.limits, []
    if limits:
        blocks.append(
            Block(
                heading=demand_heading(contents),
                finding=" ".join(demand_claim(name, limit).text for name, limit in limits.items()),
                picture=margin_figure(contents),
                table=limits_table(contents),
                appendix=True,
                files=("tables/limits.csv",),
            )
        )
    blocks.append(carried_block(contents))
    for name in contents.results.margins:
        parts = parts_table(contents, name)
        heading = parts_heading(contents, name)
        blocks.append(Block(heading=heading, finding=parts_finding(contents, name) if parts else "", table=parts))
    if contents.results.fracture:
        blocks.append(
            Block(
                heading=fracture_heading(contents),
                finding=fracture_finding(contents),
                picture=interplay_figure(contents),
                table=fracture_table(contents),
                remarks=interplay_remarks(contents),
                files=("tables/fracture.csv",),
            )
        )
    shown = decided(contents)
    blocks += [distribution_block(contents, name) for name in of_limits(contents) if name not in shown]
    for name in limits:
        blocks += _limit_blocks(contents, name)
    return Chapter(anchor="margins", heading="Margins", short="Margins", blocks=tuple(blocks))


# --- what drives it, what to measure ----------------------------------------------------------------------


def drivers_chapter(contents: Contents) -> Chapter:
    """What drives each limit, then each quantity, those of the limits first."""
    blocks = []
    for name, limit in contents.results.limits.items():
        table = failure_table(contents, name) if limit.drivers else None
        if table is not None:
            blocks.append(
                Block(
                    heading=failure_heading(contents, name),
                    finding=failure_finding(contents, name),
                    table=table,
                    files=("tables/drivers.csv",),
                )
            )
    for name in [q for q in of_limits(contents) or contents.results.quantities if has_indices(contents, q)]:
        blocks += [indices_block(contents, name), *beyond_blocks(contents, name)]
    return Chapter(
        anchor="drivers",
        heading="What drives it",
        short="What drives it",
        blocks=tuple(blocks),
        remark=drivers_remark(contents),
    )


def measure_chapter(contents: Contents) -> Chapter:
    """What to measure next, for every limit and its quantity; for every quantity where there is no limit."""
    asked = of_limits(contents) or list(contents.results.sensitivity)
    blocks = [measure_block(contents, "limits", name) for name in contents.results.limits]
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
    screening_chapter,
    methods_chapter,
)
