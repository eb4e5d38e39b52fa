"""Headings that tell the finding where there is one, after the subject that the list of contents names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from uqsphere.report import event
from uqsphere.report.contents import Contents
from uqsphere.report.drivers import first_to_measure, told_from_none
from uqsphere.report.figures import ranked
from uqsphere.report.granted import turns
from uqsphere.report.wording import (
    begin,
    call,
    capital,
    input_name,
    limit_name,
    plain_percent,
    rounded,
    share_text,
    short_input,
    symbol,
    the_input,
)

__all__ = [
    "accuracy_heading",
    "checks_heading",
    "demand_heading",
    "distribution_heading",
    "failure_heading",
    "family_heading",
    "fracture_heading",
    "fragility_heading",
    "granted_heading",
    "indices_heading",
    "measure_heading",
    "parts_heading",
    "swings_heading",
]


def _told(subject: str, finding: str) -> str:
    return f"{subject}: {finding}" if finding else subject


def fragility_heading(contents: Contents, name: str) -> str:
    """Where the curve reaches the accepted probability, or one half where none was accepted."""
    entry = contents.results["margins"][name]
    subject = f"Fragility of {limit_name(name)}"
    if (entry.get("value") or {}).get("value") is not None and entry.get("probability"):
        return f"{subject}: {plain_percent(entry['probability'])} at {event.answer_text(contents, name)}"
    middle = entry["values"].get("0.5")
    if not middle or middle["value"] is None:
        return subject
    return f"{subject}: one half at {rounded(middle, contents.subject(entry['solve']))}"


def family_heading(contents: Contents, name: str) -> str:
    """Between which values one half breaks over the family."""
    entry = contents.results["margins"][name]
    family = entry["family"]
    subject = f"Fragility of {limit_name(name)} over {input_name(family['path'])}"
    known = [m["values"]["0.5"] for m in family["members"] if (m["values"].get("0.5") or {}).get("value") is not None]
    if len(known) < 2:
        return subject
    first, last = (rounded(e, contents.subject(entry["solve"])) for e in (known[0], known[-1]))
    return f"{subject}: one half at {first} to {last}"


def demand_heading(contents: Contents) -> str:
    """The median margin of one limit or of two."""
    limits = contents.results["limits"]
    known = {name: limit["margin"].get("median") for name, limit in limits.items()}
    told = [(name, e) for name, e in known.items() if e and e["value"] is not None]
    if not told or len(limits) > 2:
        return "Strength over demand"
    texts = [(limit_name(name, 20), rounded(e, digits=3)) for name, e in told]
    if len({text for _, text in texts}) == 1:
        return f"Strength over demand: {texts[0][1]} in the median case"
    return "Strength over demand: " + ", ".join(f"{text} for {name}" for name, text in texts)


def parts_heading(contents: Contents, name: str) -> str:
    """What takes the largest part of a margin at the answer."""
    shares = (contents.results["margins"][name].get("lost_to") or {}).get("shares") or {}
    largest = max(shares, key=lambda key: shares[key], default=None)
    finding = "" if largest is None else f"{100.0 * shares[largest]:.0f} % by {the_input(largest)}"
    return _told(f"What the margin of {limit_name(name)} is made of", finding)


def fracture_heading(contents: Contents) -> str:
    """When it breaks in the median."""
    found = contents.results.get("fracture") or {}
    median = (found.get("time") or {}).get("median")
    if median is None or median["value"] is None:
        return "Fracture"
    return f"Fracture: in the median after {rounded(median, 'contact_time', 3)}"


def distribution_heading(contents: Contents, name: str) -> str:
    """Between which values nine cases of ten lie."""
    entry = contents.results["quantities"][name]
    ends = [entry["quantiles"].get(p) for p in ("0.05", "0.95")]
    finding = ""
    if all(end and end["value"] is not None for end in ends) and ends[0]["value"] < ends[1]["value"]:
        finding = " to ".join(rounded(end, name, 3) for end in ends) + " in nine cases of ten"
    return _told(begin(name, call(name)), finding)


def failure_heading(contents: Contents, name: str) -> str:
    """What decides most whether an aim is missed, of what the indices are about."""
    entry = contents.results["limits"][name].get("drivers") or {}
    table = entry.get("shapley") or entry.get("total") or {}
    known = {key: e["value"] for key, e in table.items() if e["value"] is not None}
    largest = max(known, key=lambda key: known[key], default=None)
    who = "" if largest is None or not told_from_none(table[largest]) else f"most by {the_input(largest)}"
    if who and entry.get("of") != "missing the aim":
        who += ", of the model’s inputs"
    return _told(f"Missing the aim of {limit_name(name)}", who)


def indices_heading(contents: Contents, name: str) -> str:
    """Which input drives a quantity, and how much of its variance."""
    entry = contents.results["sensitivity"].get(name) or {}
    rows = ranked(entry) if entry else []
    if not rows:
        return symbol(name)
    share = share_text(entry["first"][rows[0]])
    return f"{begin(rows[0], short_input(rows[0]))} drives {symbol(name)}: {share} of its variance by itself"


def swings_heading(contents: Contents, name: str, furthest: str) -> str:
    """Which input moves a quantity furthest."""
    return _told(f"How far each input moves {symbol(name)}", furthest and f"{short_input(furthest)} furthest")


def measure_heading(words: str, entry: Mapping[str, Any] | None) -> str:
    """Which input to measure first, where one can be told from those that do nothing."""
    first = first_to_measure(entry)
    return _told(f"What to measure first for {words}", input_name(first["input"]) if first else "")


def granted_heading(contents: Contents) -> str:
    """Whether a verdict turns on what is assumed of a strength."""
    limits = contents.results["limits"].values()
    rows = [(limit, row) for limit in limits for row in limit.get("assumed") or () if limit["target"] is not None]
    finding = ""
    if any(turns(limit, row) for limit, row in rows):
        finding = "a verdict turns on it"
    elif rows:
        finding = "no verdict turns on it"
    return _told("What the verdict takes for granted", finding)


def checks_heading(checks: Any, subject: str) -> str:
    """How many of the validity checks are broken."""
    broken = [c for c in checks if c.get("share_failure", 0.0) + c.get("share_warning", 0.0) > 0.0]
    if not checks:
        return subject
    if not broken:
        return f"{subject}: no check is broken"
    return f"{subject}: {len(broken)} of {len(checks)} checks {'is' if len(broken) == 1 else 'are'} broken somewhere"


def accuracy_heading(contents: Contents) -> str:
    """How much of the accuracy asked for was not reached: of the questions of the table, where there are any."""
    missed = len(contents.results["accuracy"]["missed"])
    rows = [row for row in contents.results["accuracy"].get("questions") or () if row["met"] is not None]
    late = sum(not row["met"] for row in rows)
    told = f"{late} of {len(rows)} not" if late else f"{missed} not" if missed else ""
    told = "all of it" if contents.results["accuracy"]["met"] else told
    return capital(_told("what was asked, what was reached", told))
