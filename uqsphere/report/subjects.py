"""The blocks of one quantity: its distribution, its indices, and what lies beyond them."""

from __future__ import annotations

from uqsphere.report import directions, drivers, figures, pair_figures, sections, swings
from uqsphere.report.blocks import Block
from uqsphere.report.contents import Contents
from uqsphere.report.headings import distribution_heading, indices_heading, measure_heading, swings_heading
from uqsphere.report.wording import capital, limit_name, mathematical, powers, symbol

__all__ = [
    "beyond_blocks",
    "decided",
    "distribution_block",
    "has_indices",
    "indices_block",
    "measure_block",
    "of_limits",
]


def distribution_block(contents: Contents, name: str) -> Block:
    """The distribution of a quantity, its numbers in the appendix."""
    single = figures.single_value(contents, name)
    finding = f"One value: {single}." if single else _without_name(figures.distribution_finding(contents, name))
    return Block(
        heading=distribution_heading(contents, name),
        finding=finding,
        picture=figures.distribution_figure(contents, name),
        table=sections.quantity_table(contents, name),
        appendix=not single,
        files=("tables/quantities.csv",),
        remarks=figures.overlap_remarks(contents, name),
    )


def _without_name(finding: str) -> str:
    """A finding under a heading that names its subject."""
    return capital(finding.partition(": ")[2])


def decided(contents: Contents) -> list[str]:
    """Quantities whose distribution is the figure of the decision: where no fragility was asked for."""
    if contents.results["margins"]:
        return []
    return of_limits(contents) or list(contents.results["quantities"])[:1]


def of_limits(contents: Contents) -> list[str]:
    """Quantities that have a limit, each once."""
    found = dict.fromkeys(limit["quantity"] for limit in contents.results["limits"].values())
    return [name for name in found if name in contents.results["quantities"]]


def indices_block(contents: Contents, name: str) -> Block:
    """What drives a quantity."""
    entry = contents.results["sensitivity"][name]
    picture = figures.sensitivity_figure(contents, name)
    remarks = [powers(str(entry.get("check", {}).get("text") or ""))] if picture is not None else []
    hidden = len(figures.ranked(entry)) - figures.MOST_INPUTS
    if hidden > 0:
        remarks.append(f"The figure shows the {figures.MOST_INPUTS} largest; {hidden} more are in the table.")
    return Block(
        heading=indices_heading(contents, name),
        finding=figures.sensitivity_finding(contents, name),
        picture=picture,
        table=sections.index_table(contents, name) or drivers.shapley_table(contents, name),
        remarks=tuple(text for text in remarks if text),
        appendix=picture is not None,
        files=("tables/sensitivity.csv",),
    )


def beyond_blocks(contents: Contents, name: str) -> list[Block]:
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
            heading=swings_heading(contents, name, swings.furthest(contents, name)),
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


def has_indices(contents: Contents, name: str) -> bool:
    """Whether anything was asked about what drives a quantity."""
    return name in contents.results["sensitivity"]


def measure_block(contents: Contents, kind: str, name: str) -> Block:
    """What to measure first, for a limit (`kind` "limits") or for a quantity ("sensitivity")."""
    first = contents.results[kind][name].get("measure_first")
    limit = kind == "limits"
    words = limit_name(name) if limit else symbol(name)
    caption = f"What better known laws are worth, {words}" if limit else f"What the variance of {words} would lose"
    table = drivers.measure_table(first, caption)
    heading = measure_heading(words, first)
    if table is None or first is None:
        return Block(heading=heading)
    method = str(first["method"])
    if (first.get("probability") or 0.0) > 0.5:
        method = method.replace("(0.1 p))^2", "(0.1 p))^2, p the smaller side of the probability", 1)
    return Block(
        heading=heading,
        finding=drivers.measure_finding(first),
        table=table,
        remarks=(mathematical(method), *directions.measure_remarks(contents, name, kind)),
        files=("tables/drivers.csv",),
    )
