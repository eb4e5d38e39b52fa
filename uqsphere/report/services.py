"""What the page of a study says of its services: a verdict and a chapter each; their own pages have the rest."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from uqsphere.quantities import reading_units
from uqsphere.report.blocks import Block, Chapter, Table, Verdict, cell
from uqsphere.report.contents import Contents, units_of
from uqsphere.report.figures.canvas import shorten
from uqsphere.report.margins import margin_verdicts
from uqsphere.report.phrases import input_name, limit_name
from uqsphere.report.tables import checks_table, limits_table, margins_table
from uqsphere.report.verdict import cautions, verdicts
from uqsphere.results import NO_RIG


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
    finding = (
        "The strength comes from tests between platens. Whether a sphere breaks by the force on its contact, by the "
        "energy in it or by the tension at its centre is not settled: to survive the least answer counts, to break the "
        "largest."
    )
    return Block(
        heading="Carried from the tests",
        finding=finding if rows else "",
        table=Table(caption="Answers by each carrier", header=header, rows=tuple(rows)) if rows else None,
    )


@contextmanager
def _read_as_its_own(contents: Contents) -> Iterator[None]:
    """Units as on the page of the service itself."""
    with reading_units(units_of(contents.results, courses=contents.courses)):
        yield


def service_verdicts(contents: Contents) -> list[Verdict]:
    """The verdicts of every service, by its name."""
    found = []
    for name, own in contents.services.items():
        with _read_as_its_own(own):
            for verdict in (*margin_verdicts(own), *verdicts(own)):
                own_name = verdict.heading.startswith(f"{name}:")
                heading = verdict.heading if own_name else f"{shorten(name, 40)}: {verdict.heading}"
                found.append(replace(verdict, heading=heading))
    return found


def all_cautions(contents: Contents) -> list[str]:
    """What weakens the answers of the study and of its services."""
    found = [] if contents.results.rig == NO_RIG else cautions(contents)
    for name, own in contents.services.items():
        with _read_as_its_own(own):
            found += [f"{shorten(name, 40)}: {text}" for text in cautions(own)]
    return found


def service_chapters(contents: Contents) -> list[Chapter]:
    """A chapter for every service: its answers, its checks, and where its own page is."""
    chapters = []
    for name, own in contents.services.items():
        with _read_as_its_own(own):
            blocks = (
                Block(heading=f"Limits of the service {name}", table=limits_table(own)),
                *(
                    Block(heading=f"How far {name} may go, {limit}", table=margins_table(own, limit))
                    for limit in own.results.margins
                ),
                carried_block(own),
                Block(heading=f"Validity in {name}", table=checks_table(own), kind="checks notes"),
            )
        chapters.append(
            Chapter(
                anchor=f"service-{name}",
                heading=f"Service {name}",
                short=name,
                blocks=blocks,
                remark=f"Its own page, with figures and drivers: services/{name}/report.html.",
            )
        )
    return chapters
