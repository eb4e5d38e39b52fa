"""The fragility over the specific energy: drawn and told as the one over the speed is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from uqsphere.report import decision, sections
from uqsphere.report.blocks import Block
from uqsphere.report.contents import Contents
from uqsphere.report.figures import slug
from uqsphere.report.fragility_family import lognormal_remarks
from uqsphere.report.wording import limit_name

__all__ = ["energy_block"]


def _seen_so(contents: Contents, name: str, against: dict[str, Any]) -> Contents:
    """The contents as if the energy were what the margins of this limit are solved for."""
    own = {**contents.results["margins"], name: {**against, "solve": against["quantity"]}}
    return replace(contents, results={**contents.results, "margins": own})


def energy_block(contents: Contents, name: str) -> list[Block]:
    """The block of a limit; none where no curve over the energy was asked for."""
    against = contents.results["margins"][name].get("against")
    if not against:
        return []
    heading = f"Fragility of {limit_name(name)} over the specific energy"
    if against.get("reason"):
        return [Block(heading=heading, finding=f"No curve can be given: {against['reason']}.")]
    view = _seen_so(contents, name, against)
    picture = decision.fragility_figure(view, name)
    return [
        Block(
            heading=heading,
            finding=decision.fragility_finding(view, name),
            picture=picture and replace(picture, name=slug("fragility-energy", name), title=heading),
            table=sections.margins_table(view, name),
            remarks=(
                *lognormal_remarks(view, name),
                "Every specimen is struck with the speed that imposes just this energy on it, as in a drop-weight "
                "test: what the energy scatters by at one speed has no part in the curve.",
            ),
            files=("tables/margins.csv", "tables/fragility_energy.csv"),
        )
    ]
