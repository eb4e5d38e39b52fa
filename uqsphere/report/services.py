"""What the page of a study says of its services: a chapter each; their own pages have the rest."""

from __future__ import annotations

from uqsphere.quantities import reading_units
from uqsphere.report.blocks import Block, Chapter, Table, cell
from uqsphere.report.contents import Contents, units_of
from uqsphere.report.figures.fragility import fragility_figure
from uqsphere.report.phrases import input_name, limit_name
from uqsphere.report.tables import checks_table, limits_table, margins_table


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
        rows.append((limit_name(name), what, *cells, carried.safe(limit.aim) or "–"))
    header = ("limit", "what", "by force", "by energy", "by centre", "safe end")
    caption = "Answers by what carries the strength from its test: force, energy in the sphere, tension at its centre"
    table = Table(caption=caption, header=header, rows=tuple(rows)) if rows else None
    return Block(heading="Carried from the tests", table=table)


def service_chapters(contents: Contents) -> list[Chapter]:
    """A chapter for every service: its answers, its checks, and where its own page is."""
    chapters = []
    for name, own in contents.services.items():
        with reading_units(units_of(own.results, courses=own.courses)):
            blocks = (
                *(
                    Block(
                        heading=f"Share broken by {limit_name(limit)}",
                        picture=fragility_figure(own, limit),
                        table=margins_table(own, limit),
                    )
                    for limit in own.results.margins
                ),
                Block(heading=f"Limits of {name}", table=limits_table(own)),
                carried_block(own),
                Block(
                    heading=f"Checks that are broken in {name}",
                    table=checks_table(own, broken=True),
                    kind="checks notes",
                ),
            )
        remark = f"Its own page, with figures and drivers: services/{name}/report.html."
        chapters.append(Chapter(anchor=f"service-{name}", heading=f"Service {name}", blocks=blocks, remark=remark))
    return chapters
