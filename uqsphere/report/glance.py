"""The questions that are asked of every report first, each with its answer in a line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from uqsphere.report import event, reach
from uqsphere.report.bearing import broken_words, check_name, grave, warned
from uqsphere.report.contents import Contents
from uqsphere.report.decision import margin_finding, margin_word
from uqsphere.report.drivers import first_to_measure, measure_finding
from uqsphere.report.figures import sensitivity_finding
from uqsphere.report.margin_verdict import at_most, no_common_value, settling_text, tests_text
from uqsphere.report.wording import (
    capital,
    estimate_text,
    input_name,
    limit_name,
    listed,
    plain_percent,
    the_input,
    value_text,
)
from uqsphere.uq.failure_indices import BY_INFORMATION

__all__ = ["Glance", "allowed_value", "glances"]


@dataclass(frozen=True, kw_only=True)
class Glance:
    """A question, its answer, and the anchor of the chapter that says more."""

    question: str
    answer: str
    anchor: str


def glances(contents: Contents) -> list[Glance]:
    """What is asked first: how far may one go, how much margin, what drives it, what to measure, is it valid."""
    limits, found = contents.results["limits"], []
    several = len(limits) > 1
    for name, limit in limits.items():
        own = f" ({limit_name(name, 30)})" if several else ""
        if name in contents.results["margins"]:
            solve = contents.results["margins"][name]["solve"]
            word = "Least" if limit["aim"] == "break" else "Largest"
            mean = "mean " if solve in contents.resolved["random"] else ""
            question = f"{word} {mean}{input_name(solve)}{own}"
            found.append(Glance(question=question, answer=allowed_value(contents, name), anchor="decision"))
        text = margin_finding(name, limit["margin"], limit["aim"])
        answer = capital(text.partition(": ")[2] if ": " in text else text)
        found.append(Glance(question=f"{margin_word(limit)}{own}", answer=answer, anchor="margins"))
        found.append(Glance(question=f"Measure next{own}", answer=_measure_limit(contents, name), anchor="measure"))
    if not limits:
        for entry in contents.results["sensitivity"].values():
            if entry.get("measure_first"):
                found.append(Glance(question="Measure next", answer=_measure(entry["measure_first"]), anchor="measure"))
                break
    quantities = dict.fromkeys(limit["quantity"] for limit in limits.values())
    for name in [q for q in quantities if q in contents.results["sensitivity"]]:
        found.append(Glance(question="Main driver", answer=_driver(contents, name), anchor="drivers"))
    if contents.results["validity"]:
        found.append(Glance(question="Model valid?", answer=_valid(contents), anchor="computed"))
    found.append(Glance(question="All aims together", answer=no_common_value(contents), anchor="decision"))
    kept = [glance for glance in found if glance.answer]
    order = ("Largest", "Least", "All aims", "Margin", "Shortfall", "Main driver", "Measure next", "Model valid?")
    return sorted(kept, key=lambda g: next(k for k, word in enumerate(order) if g.question.startswith(word)))


def allowed_value(contents: Contents, name: str) -> str:
    """How far the free scalar may go: where the accepted probability is reached, of those asked for."""
    limit, entry = contents.results["limits"][name], contents.results["margins"][name]
    known = {float(p): e for p, e in entry["values"].items() if e["value"] is not None}
    if not known:
        return ""
    absent = [float(p) for p, e in entry["values"].items() if e["value"] is None]
    survive = limit["aim"] == "survive"
    target = limit["target"]
    accepted = None if target is None else (target if survive else 1.0 - target)
    # on the safe side of what is accepted; without a target the safest that was asked for
    safe = {p: e for p, e in known.items() if accepted is not None and (p <= accepted if survive else p >= accepted)}
    p = (max(safe) if survive else min(safe)) if safe else (min(known) if survive else max(known))
    alone = "" if known[p]["low"] is None else " (interval of the computation alone)"
    text = f"{estimate_text(known[p], entry['solve'])}{alone}: there {event.event(contents.results, name)} "
    text += f"with a probability of {plain_percent(p)}"
    if accepted is not None and not safe and any((q <= accepted) if survive else (q >= accepted) for q in absent):
        text += f", {'more' if survive else 'less'} than the target {'allows' if survive else 'needs'} "
        text += f"({plain_percent(accepted)}); where that is reached is not known"
    elif accepted is not None and not safe:
        text += f", more than the target allows ({plain_percent(accepted)}); no smaller probability was asked for"
        if not survive:
            text = (
                text.replace(", more than", ", less than").replace("no smaller", "no larger").replace("allows", "needs")
            )
    elif accepted is not None and p == accepted:
        text += ", the target"
    opened = entry.get("ignorance") or {}
    subject = contents.subject(entry["solve"])
    if opened.get("sure") is not None and p == entry.get("probability"):
        # what is known of the tests comes first: the interval above holds the error of the computation alone
        word = "at most" if at_most(entry, limit["aim"]) else "at least"
        most = at_most(entry, limit["aim"])
        sure = event.safe_side({"value": opened["sure"], "low": None, "high": None}, subject, at_most=most, digits=3)
        ends = [value_text(opened[end], subject, 3) if opened[end] is not None else "beyond" for end in ("low", "high")]
        text = (
            f"{capital(word)} {sure} to be {plain_percent(opened['confidence'])} "
            f"sure; the {opened['tests']} tests leave open {' to '.join(ends)} (95 %), by the law fitted to them {text}"
        )
    beyond = reach.beyond_bars({**entry, "value": known[p], "probability": p}, subject)
    return f"{text}; {beyond}." if beyond else f"{text}."


def _driver(contents: Contents, quantity: str) -> str:
    """What drives the probability of the limits of a quantity, and the quantity itself."""
    parts = []
    for name, limit in contents.results["limits"].items():
        shares = limit.get("governing_inputs") or {}
        if limit["quantity"] == quantity and shares:
            first = max(shares, key=lambda n: float(shares[n]))
            several = limit.get("governing_inputs_method") == BY_INFORMATION
            share = f"{100.0 * float(shares[first]):.0f} %"
            ways = int(limit.get("design_points") or 1)
            ways_text = f" in the likeliest of {ways} ways" if ways > 1 else ""
            whole = f"{share} of what its failures tell" if several else f"importance factor {share}{ways_text}"
            parts.append(f"Of the probability of {limit_name(name)}, which decides: {input_name(first)} ({whole}).")
    load = sensitivity_finding(contents, quantity)
    if not (contents.results["sensitivity"].get(quantity) or {}).get("shapley"):
        # the largest share alone: the next ones stand in the chapter
        load = load.partition(";")[0].partition(" Interactions ")[0].rstrip(".") + "."
    return " ".join([*parts, f"Of the load alone: {load}"])


def _measure(entry: Mapping[str, Any] | None) -> str:
    """Which input first, and how many specimens it takes."""
    rows = (entry or {}).get("rows") or []
    if not rows or entry is None:
        return ""
    text, first = measure_finding(entry).removeprefix("Measure ").replace(" first:", ":", 1), first_to_measure(entry)
    own = first is not None and not the_input(first["input"]).startswith("the ")
    return text if own else capital(text)


def _measure_limit(contents: Contents, name: str) -> str:
    """What settles the target first, then which input is worth most."""
    limit, entry = contents.results["limits"][name], contents.results["margins"].get(name)
    text = tests_text(entry, limit, contents) if entry else settling_text(contents, limit)
    first = first_to_measure(limit.get("measure_first"))
    if not text:
        return _measure(limit.get("measure_first"))
    if first is not None and first["input"] != f"limits.{name}.strength":
        text += f"Of the laws, that of {input_name(first['input'])} is worth most."
    return text.strip()


def _valid(contents: Contents) -> str:
    """Whether an assumption of the model is broken, as planned and at the answers, and which.

    How often, and what it does, stands in the cautions, and there alone.
    """
    grades = (("No: outside the model’s validity: ", grave(contents)), ("With warnings: ", warned(contents)))
    start, planned = next(((words, broken) for words, broken in grades if broken), ("", []))
    where: dict[str, list[str]] = {}
    if planned:
        where[listed([broken_words(c) for c in planned])] = ["as planned"]
    for name, broken in reach.answer_breaches(contents):
        text = listed([broken_words(c) for c in broken])
        where.setdefault(text, []).append(f"at {event.answer_text(contents, name)}")
    if not where:
        return _unbroken(contents)
    plain = list(where.values()) == [["as planned"]]
    found = "; ".join(text if plain else f"{text}, {listed(places)}" for text, places in where.items())
    told = start + found if planned else f"{_unbroken(contents)} At the answers: {found}"
    return f"{told}. How often, and what that does to the answer, stands under “Before you rely on it”."


def _unbroken(contents: Contents) -> str:
    """That no assumption of the model is broken where the study stands, as far as that was checked."""
    unknown = [c for c in contents.results["validity"] if c["worst"] is None]
    if unknown:
        return f"As far as checked; not checked: {listed([check_name(c['check']) for c in unknown])}."
    return f"Yes: all {len(contents.results['validity'])} checks are passed in every sample."
