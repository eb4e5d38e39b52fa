"""What the verdict takes for granted: the probability without it, as a table, and the sentence for the first page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from uqsphere.report.blocks import Block
from uqsphere.report.contents import Contents
from uqsphere.report.event import missing
from uqsphere.report.sections import Table
from uqsphere.report.tables import cell
from uqsphere.report.wording import (
    capital,
    input_name,
    law_name,
    limit_name,
    listed,
    number_text,
    plain_percent,
    probability_range,
    rounded,
)

__all__ = [
    "granted_block",
    "granted_cautions",
    "granted_line",
    "granted_table",
    "instead_text",
    "short_probability",
    "turns",
    "verdict_word",
]

#: a probability beyond which its digits are not told
_SURE = 0.999999


def verdict_word(met: bool | None) -> str:
    """Whether a target is kept, in a word."""
    return {True: "met", False: "not met", None: "undecided"}[met]


def short_probability(miss: Mapping[str, Any]) -> str:
    """A probability in three digits at most, without its interval."""
    value, low, high = miss["value"], miss["low"], miss["high"]
    if value is None or value == 0.0 or value > 0.99:
        return plain_percent(value or 0.0)
    if value < 1e-4:
        return rounded(miss, digits=2)
    part = {"value": 100.0 * value, "low": None if low is None else 100.0 * low,
            "high": None if high is None else 100.0 * high}  # fmt: skip
    return rounded(part, digits=3) + " %"


def _rank(contents: Contents, row: Mapping[str, Any]) -> str:
    """The rank correlation of a strength with the inputs of a row, where one number stands for all."""
    groups = contents.resolved.get("dependence", [])
    told = {
        f"{key.capitalize()} {group[key]:g}"
        for group in groups
        for key in ("spearman", "kendall")
        if group.get(key) is not None and set(row["with"]) & set(group["of"])
    }
    return next(iter(told)) if len(told) == 1 else ""


def instead_text(row: Mapping[str, Any]) -> str:
    """What is put in place of what is assumed, as a clause that begins a sentence."""
    if row["assumption"] == "dependence":
        return f"without the assumed dependence of the strength on {listed([input_name(n) for n in row['with']])}"
    if row["assumption"] == "law":
        return f"with a {law_name(row['instead'])} law of the strength, of the same mean and scatter"
    what = "Weibull modulus of the strength" if row["assumption"] == "modulus" else "scatter of the strength"
    if row["assumption"] == "modulus":
        return f"with a {what} of {row['instead']:.3g} instead of {row['taken']:.3g}"
    return f"with a {what} of {100.0 * row['instead']:.3g} % instead of {100.0 * row['taken']:.3g} %"


def _consequence(limit: Mapping[str, Any], row: Mapping[str, Any]) -> str:
    text = short_probability(row["miss"])
    if limit["target"] is None:
        return text
    word = {True: "target met", False: "target missed", None: "undecided"}[row["met"]]
    return f"{text} ({word})"


def granted_line(contents: Contents, name: str) -> str:
    """What the probability would be without the assumption that matters most, and by another tail; empty if none."""
    limit = contents.results["limits"][name]
    rows = [row for row in limit.get("assumed") or () if row["miss"]["value"] is not None]
    parts = []
    for row in rows:
        if row["assumption"] == "dependence":
            own = f" ({_rank(contents, row)})" if _rank(contents, row) else ""
            parts.append(f"{capital(instead_text(row))}{own} it would be {_consequence(limit, row)}.")
    shapes = [row for row in rows if row["assumption"] in ("modulus", "cov")]
    if shapes:
        worst = max(shapes, key=lambda row: float(row["miss"]["value"]))
        parts.append(f"{capital(instead_text(worst))} it would be {_consequence(limit, worst)}.")
    return " ".join(parts)


def turns(limit: Mapping[str, Any], row: Mapping[str, Any]) -> bool:
    """Whether the verdict on a limit turns on an assumption; on a law's family only where that loses the target."""
    if limit["target"] is None or row["miss"]["value"] is None or row["met"] == limit["met"]:
        return False
    return row["assumption"] != "law" or limit["met"] is True


def granted_cautions(contents: Contents) -> list[str]:
    """Assumptions on which a verdict turns."""
    found = []
    for name, limit in contents.results["limits"].items():
        for row in limit.get("assumed") or ():
            if not turns(limit, row):
                continue
            own = f" on {limit_name(name)}" if len(contents.results["limits"]) > 1 else ""
            source = "; the dependence is an assumption of the study" if row["assumption"] == "dependence" else ""
            found.append(
                f"The verdict{own} turns on an assumption: {instead_text(row)} the probability that "
                f"{missing(contents.results, name)} would be {short_probability(row['miss'])}, at most "
                f"{plain_percent(limit['target'])} is allowed: {verdict_word(row['met'])}{source}."
            )
    return found


def granted_table(contents: Contents) -> Table | None:
    """Every assumption about a strength, what is put instead, and the probability and verdict that follow."""
    limits = contents.results["limits"]
    several, rows = len(limits) > 1, []
    for name, limit in limits.items():
        own = (limit_name(name),) if several else ()
        known = [row for row in limit.get("assumed") or () if row["miss"]["value"] is not None]
        opened = limit.get("ignorance") or {}
        if not known and "miss" not in opened:
            continue
        rows.append((*own, "as the study has it", cell(limit["miss"], probability=True), _word(limit, limit["met"])))
        if "miss" in opened:
            tests = listed([f"{entry['tests']} tests" for entry in opened["from"]])
            text = probability_range(*opened["miss"])
            rows.append((*own, f"by all laws that the {tests} allow (95 %)", text, _word(limit, opened["met"])))
        rows += [(*own, instead_text(row), _chance(row["miss"]), _word(limit, row["met"])) for row in known]
    if not rows:
        return None
    header = (*(("limit",) if several else ()), "what is assumed", "probability of missing the aim", "target")
    return Table(caption="What the verdict takes for granted of the strength", header=header, rows=tuple(rows))


def _chance(miss: Mapping[str, Any]) -> str:
    """A probability with its interval; how many nines one has is of no use beyond six."""
    low = miss["low"]
    return f"more than {plain_percent(_SURE)}" if low is not None and low > _SURE else cell(miss, probability=True)


def granted_block(contents: Contents, heading: str) -> Block:
    """The table under its heading; empty where nothing is assumed of a strength."""
    table = granted_table(contents)
    files = ("tables/limits.csv",) if table else ()
    return Block(heading=heading, table=table, files=files)


def _word(limit: Mapping[str, Any], met: bool | None) -> str:
    return number_text(verdict_word(met)) if limit["target"] is not None else "no target"
