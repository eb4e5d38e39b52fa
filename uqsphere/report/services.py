"""What the page of a study says of its services: a verdict and a chapter each; their own pages have the rest."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from uqsphere.quantities import reading_units
from uqsphere.report.blocks import Block, Chapter, Verdict
from uqsphere.report.contents import Contents, units_of
from uqsphere.report.figures.canvas import shorten
from uqsphere.report.margins import margin_verdicts
from uqsphere.report.tables import checks_table, limits_table, margins_table
from uqsphere.report.verdict import cautions, verdicts


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
                found.append(replace(verdict, heading=f"{shorten(name, 40)}: {verdict.heading}"))
    return found


def service_chapters(contents: Contents) -> list[Chapter]:
    """A chapter for every service: its answers, what weakens them, and where its own page is."""
    chapters = []
    for name, own in contents.services.items():
        with _read_as_its_own(own):
            blocks = (
                Block(heading=f"Limits of the service {name}", table=limits_table(own)),
                *(
                    Block(heading=f"How far {name} may go, {limit}", table=margins_table(own, limit))
                    for limit in own.results.margins
                ),
                Block(heading=f"Before you rely on {name}", remarks=tuple(cautions(own))),
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
