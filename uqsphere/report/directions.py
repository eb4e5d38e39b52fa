"""Which way an input works on the load and on breakage, said where the two differ."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from uqsphere.report.contents import Contents
from uqsphere.report.wording import input_name, limit_name, listed, short_input, symbol

if TYPE_CHECKING:
    from uqsphere.report.limit_surface import Sides

__all__ = ["drivers_remark", "measure_remarks", "opposed", "tied_inputs"]


def tied_inputs(contents: Contents, limit: str) -> list[tuple[str, float | None]]:
    """Inputs that the strength of a limit depends on, with their rank correlation where it is one number."""
    own = f"limits.{limit}.strength"
    found = []
    for group in contents.resolved.get("dependence", []):
        if own in group["of"]:
            rank = group.get("spearman") if group.get("spearman") is not None else group.get("kendall")
            found += [(name, rank) for name in group["of"] if name != own]
    return found


def opposed(contents: Contents, limit: str, sides: Sides, where: float) -> str:
    """Why the aim is missed at the end of an input where the load is smaller, if it is; `where` is the upper share."""
    rank = next((r for name, r in tied_inputs(contents, limit) if name == sides.name), None)
    entry = contents.results["limits"][limit]
    ranks = np.array([np.argsort(np.argsort(v)) for v in (sides.x, sides.demand)], dtype=float)
    rises = float(np.corrcoef(ranks)[0, 1]) > 0.0
    hard_above = rises == (entry["aim"] == "survive")
    if rank is None or hard_above == (where >= 0.5):
        return ""
    words = short_input(sides.name)
    way = "larger" if rises else "smaller"
    follows = "rise" if rank > 0.0 else "fall"
    return (
        f" A larger {words} makes {symbol(entry['quantity'])} {way}, yet the misses lie at the other end: the study "
        f"takes the strength to {follows} with it (rank correlation {rank:g}), and that outweighs the load."
    )


def measure_remarks(contents: Contents, name: str, kind: str) -> tuple[str, ...]:
    """That a change of an input is told with the strength left where it was; none where they are independent."""
    names = [n for n, _ in tied_inputs(contents, name)] if kind == "limits" else []
    if not names:
        return ()
    return (
        f"The change owed to {listed([input_name(n) for n in names])} is that of a mean known better, with the "
        "strength of every specimen left where it was: it shows the way of the load. That the strength goes with it "
        "from specimen to specimen, which decides at which end of it the spheres break, is not in that number.",
    )


def drivers_remark(contents: Contents) -> str:
    """How to read the chapter of what drives it."""
    return (
        f"{_three_questions(contents)} The first index is the share of the variance that an input causes alone, the "
        "total one includes its interactions. A violin shows where an index is likely to lie, the whisker its 95 % "
        "interval."
    ).strip()


def _three_questions(contents: Contents) -> str:
    """Which question the shares of an input answer, and where the strength stands in each; empty without limits."""
    limits = contents.results["limits"]
    if not limits or not any(f"limits.{name}.strength" in contents.resolved["random"] for name in limits):
        return ""
    names = listed([limit_name(name, 30) for name in limits])
    return (
        "Shares answer three different questions. Of the load (the quantity itself): the strength has no part in it. "
        f"Of the probability as planned ({names}): the strength counts as an input, by importance factors at the "
        "likeliest failure, or, with indices of the model’s inputs, is averaged over and has no share. Of the margin: "
        "the same factors as of the probability, but at the value that the target allows and not as planned."
    )
