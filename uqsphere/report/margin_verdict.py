"""The answer to an inverse question in three lines: at most or at least how much, what it hangs on, what would help."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from uqsphere.quantities import format_value
from uqsphere.report import canvas
from uqsphere.report.contents import Contents
from uqsphere.report.verdict import Verdict
from uqsphere.report.wording import capital, input_name, limit_name, listed, number_text, plain_percent, rounded

__all__ = ["at_most", "margin_answer", "margin_verdicts", "subject_of"]


def at_most(entry: Mapping[str, Any], aim: str) -> bool:
    """Whether the aim is reached below the value (at most) or above it (at least)."""
    curve = entry["curve"]
    rising = bool(curve[-1][1] >= curve[0][1])
    return rising == (aim == "survive")


def subject_of(results: Mapping[str, Any], solve: str) -> str:
    """The name whose unit the free scalar has: a strength has that of its limit's quantity."""
    parts = solve.split(".")
    own = results["limits"].get(parts[1]) if len(parts) == 3 else None
    return str(own["quantity"]) if own and parts[2] == "strength" else solve


def margin_answer(results: Mapping[str, Any], name: str) -> str:
    """At most or at least how much keeps the aim of a limit, in a sentence; empty where it has no target."""
    entry, limit = results["margins"].get(name), results["limits"].get(name)
    if not entry or not entry.get("value") or limit is None or limit["target"] is None:
        return ""
    value, solve = entry["value"], entry["solve"]
    subject = subject_of(results, solve)
    safe = limit["aim"] == "survive"
    chance = plain_percent(limit["target"] if safe else 1.0 - limit["target"])
    aim = f"a probability of fracture of at most {chance}" if safe else f"a probability of fracture of {chance} or more"
    if value["value"] is None:
        # that there is none may be said only where the whole range was looked at
        if str(value["reason"]).startswith("no value between"):
            return f"No {input_name(solve)} between the bounds of the study gives {aim}: {value['reason']}."
        return f"Which {input_name(solve)} gives {aim} is not known: {value['reason']}."
    word = "at most" if at_most(entry, limit["aim"]) else "at least"
    text = f"{capital(input_name(solve))}: {word} {rounded(value, subject)} for {aim} (limit {limit_name(name)})"
    opened = entry.get("ignorance") or {}
    if opened.get("sure") is not None:
        sure = number_text(format_value(opened["sure"], subject, 3))
        text += f"; {word} {sure} to be {plain_percent(opened['confidence'])} sure of it, with {_tests(opened)}"
    elif opened and "reason" not in opened:
        text += (
            f"; {_tests(opened)} are too few to be {plain_percent(opened['confidence'])} sure of any value looked at"
        )
    return text + "."


def _tests(opened: Mapping[str, Any]) -> str:
    stopped = opened.get("stopped", 0)
    return f"{opened['tests']} tests" + (f" ({stopped} of them stopped before failure)" if stopped else "")


def margin_verdicts(contents: Contents) -> list[Verdict]:
    """One answer for every limit with a target of a study that asks for margins."""
    found = []
    for name in contents.results["margins"]:
        answer = margin_answer(contents.results, name)
        if not answer:
            continue
        entry, limit = contents.results["margins"][name], contents.results["limits"][name]
        lines = (answer, _lost(contents, entry, limit), _next(entry, limit, contents))
        found.append(
            Verdict(
                word="answer",
                heading=f"{canvas.shorten(name, 60)}: {canvas.shorten(input_name(entry['solve']), 60)}",
                lines=tuple(line for line in lines if line),
            )
        )
    return found


def _lost(contents: Contents, entry: Mapping[str, Any], limit: Mapping[str, Any]) -> str:
    """What the margin is lost to, and how the uncertainty of the value splits."""
    text = ""
    shares = (entry.get("lost_to") or {}).get("shares")
    if shares:
        order = [n for n in sorted(shares, key=lambda n: -shares[n]) if shares[n] >= 0.02][:3]
        chance = plain_percent(limit["target"] if limit["aim"] == "survive" else 1.0 - limit["target"])
        text = (
            f"Between half of the specimens and {chance}, the margin is lost to "
            + listed([f"{input_name(n)} ({100.0 * shares[n]:.0f} %)" for n in order])
            + ". "
        )
    split = entry.get("split") or {}
    words = {"scatter": "scatter from specimen to specimen", "ignorance": "few tests", "numerical": "computing"}
    known = [f"{100.0 * split[part]:.2g} % by {word}" for part, word in words.items() if split.get(part) is not None]
    if known:
        text += f"The {input_name(entry['solve'])} at fracture is uncertain by {listed(known)} (standard deviations)."
    return text.strip()


def _next(entry: Mapping[str, Any], limit: Mapping[str, Any], contents: Contents) -> str:
    """What more tests would bring, and what the bars allow."""
    text = ""
    tests = entry.get("more_tests") or {}
    here = contents.at_mean(entry["solve"])
    planned = "" if here is None else f" at the planned {format_value(here, contents.subject(entry['solve']))}"
    if tests.get("to_settle") == 0:
        word = "kept" if limit["met"] else "missed"
        text = f"The {tests['tests']} tests settle that the target is {word}{planned}. "
    elif tests.get("to_settle"):
        text = f"About {tests['to_settle']} more tests would settle whether the target is kept{planned}. "
    elif tests.get("reason"):
        text = f"Whether the target is kept{planned} is too close to call: {tests['reason'].partition(':')[0]}. "
    if tests.get("to_know_the_value"):
        text += f"About {tests['to_know_the_value']} more would give the value to {plain_percent(tests['known_to'])}. "
    bars = entry.get("bars")
    return (text + (bars_text(bars, entry, contents) if bars else "")).strip()


def bars_text(bars: Mapping[str, Any], entry: Mapping[str, Any], contents: Contents) -> str:
    """Where the bars stop being elastic."""
    subject = contents.subject(entry["solve"])
    strength = number_text(format_value(bars["yield_strength"], "bars.yield_strength"))
    parts = []
    if bars.get("pulse_value") is not None:
        parts.append(f"in the pulse up to {number_text(format_value(bars['pulse_value'], subject, 3))}")
    elif bars["pulse_elastic"]:
        parts.append("in the pulse as planned")
    contact = bars.get("contact")
    if contact and contact["value"] is not None:
        word = "up to" if entry["curve"][-1][1] >= entry["curve"][0][1] else "from"
        chance = plain_percent(1.0 - bars["contact_probability"])
        parts.append(f"under the sphere {word} {rounded(contact, subject)} ({chance} of the cases)")
    elif bars.get("contact_everywhere") == "elastic":
        parts.append("under the sphere over the whole curve")
    if not parts:
        return f"The bars (yield strength {strength}) yield over the whole curve."
    text = f"The bars (yield strength {strength}) stay elastic {' and '.join(parts)}"
    if bars.get("contact_everywhere") == "yields":
        text += ", and yield locally under the sphere over the whole curve"
    value = (entry.get("value") or {}).get("value")
    if contact and contact["value"] is not None and value is not None:
        first = contact["value"] < value
        if first == (entry["curve"][-1][1] >= entry["curve"][0][1]):
            text += ", which is reached before the value above: harder or thicker bars are due"
    return text + "."
