"""How far an answer reaches: where its bars yield, where the tests end, and for which scene it holds."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from uqsphere.quantities import OUTPUTS
from uqsphere.report.bearing import bearing, check_name
from uqsphere.report.contents import Contents, law_of
from uqsphere.report.event import answer_text, of_limit, safe_side
from uqsphere.report.wording import call, capital, input_name, limit_name, listed, plain_percent, rounded, value_text
from uqsphere.uq.law import ppf

__all__ = [
    "answer_breaches",
    "answer_checks",
    "beyond_bars",
    "cases_text",
    "extrapolation_cautions",
    "judged_cautions",
    "reach_cautions",
    "reach_note",
    "yields_at",
]

#: a share of the cases below this is none
_NEVER = 1e-6
#: what a broken check says of a scene
_FOUND = {
    "bar_yield_contact": "the bars yield under the sphere",
    "bar_yield_pulse": "the pulse makes the bars yield",
    "small_contact": "the contact is not small against the sphere",
    "contact_on_bar_end": "the contact is not small against the bar’s end",
    "force_balance": "the two contact forces differ",
    "quasi_static_sphere": "waves cross the sphere too few times while the force rises",
}
#: demands at the rim of a contact, and inside the sphere
_RIM = frozenset({"edge_tension", "ring_crack_toughness"})
_CORE = frozenset({"core_tension", "centre_tension", "equatorial_tension", "hiramatsu_oka_tension"})


def yields_at(entry: Mapping[str, Any], p: str) -> float | None:
    """Share of the cases in which the bars yield under the contact at the value of a probability asked for."""
    found = (entry.get("bars") or {}).get("yields_at") or {}
    share = found.get(p)
    return None if share is None else float(share)


def _rising(entry: Mapping[str, Any]) -> bool:
    return bool(entry["curve"][-1][1] >= entry["curve"][0][1])


def beyond_bars(entry: Mapping[str, Any], subject: str) -> str:
    """What is to be said of a value at which the bars are no longer elastic, in a clause; empty where they are."""
    bars = entry.get("bars") or {}
    value = (entry.get("value") or {}).get("value")
    contact = bars.get("contact") or {}
    if value is None:
        return ""
    if bars.get("contact_everywhere") == "yields":
        share = yields_at(entry, format(entry["probability"], ".15g"))
        return f"the bars yield under the sphere there{_cases(share)}"
    ends = [e for e in (contact.get("value"), bars.get("pulse_value")) if e is not None]
    passed = [e for e in ends if (value > e) == _rising(entry) and value != e]
    if not passed:
        return ""
    first = min(passed) if _rising(entry) else max(passed)
    share = yields_at(entry, format(entry["probability"], ".15g"))
    contacts = first == contact.get("value")
    does = f"they yield under the sphere{_cases(share)}" if contacts else "the pulse makes them yield"
    told = contact if contacts else {"value": first, "low": None, "high": None}
    stand = safe_side(told, subject, at_most=_rising(entry), digits=3)
    return f"that lies beyond what these bars stand ({stand}): there {does}"


def _cases(share: float | None) -> str:
    return "" if share is None else f" {cases_text(share)}"


def cases_text(share: float) -> str:
    """In how many of the cases something happens; what is computed of a law alone may be too small to be said.

    >>> cases_text(0.0341), cases_text(2.8e-28), cases_text(1.0 - 1e-14)
    ('in 3.4 % of the cases', 'in none of the cases', 'in all cases')
    >>> cases_text(0.99868)
    'in 99.86 % of the cases'
    """
    if share < _NEVER:
        return "in none of the cases"
    if share > 1.0 - _NEVER:
        return "in all cases"
    # two digits, which must not make all of nearly all
    return f"in {plain_percent(share if share > 0.99 else float(f'{share:.2g}'))} of the cases"


def answer_checks(entry: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The checks at the answer of an inverse question, with the share of the curve's own cases where it is known.

    A check follows a hundred scenes or so; how often the bars yield is known better, of all cases of the curve, and
    is told with one number everywhere.
    """
    found: list[Mapping[str, Any]] = []
    for check in (entry.get("validity") or {}).get("checks", ()):
        share = yields_at(entry, format(entry["probability"], ".15g"))
        if check["check"] != "bar_yield_contact" or share is None or not check["share"]:
            found.append(check)
            continue
        text = re.sub(r"^in (all|[\d.]+ % of the) scenes", cases_text(share), str(check["text"]))
        rounded_share = {} if text == check["text"] else {"share_warning": float(f"{share:.2g}")}
        found.append({**check, **rounded_share, "text": text})
    return found


def answer_breaches(contents: Contents) -> list[tuple[str, list[Mapping[str, Any]]]]:
    """Limit and the checks that are broken at the answer of its inverse question."""
    found = []
    for name, entry in contents.results["margins"].items():
        told = entry.get("validity") or {}
        broken = [c for c in told.get("checks", ()) if c.get("share_failure", 0.0) + c.get("share_warning", 0.0) > 0.0]
        if broken:
            found.append((name, broken))
    return found


def breach_text(contents: Contents, name: str, check: Mapping[str, Any]) -> str:
    """A broken check at the answer of a limit, with its share: of the curve's own cases where it is known of them."""
    entry = contents.results["margins"][name]
    share = check.get("share_failure", 0.0) + check.get("share_warning", 0.0)
    if check["check"] == "bar_yield_contact":
        known = yields_at(entry, format(entry["probability"], ".15g"))
        share = share if known is None else known
    words = _FOUND.get(check["check"], check_name(check["check"]))
    return f"{words} ({cases_text(share)})"


def reach_cautions(contents: Contents) -> list[str]:
    """Where the model does not hold at the answer of an inverse question, and what that does to it."""
    found = []
    for name, broken in answer_breaches(contents):
        entry = contents.results["margins"][name]
        which = f"{input_name(entry['solve'])} {answer_text(contents, name)}{of_limit(contents.results, name)}"
        said: dict[str, list[str]] = {}
        for check in broken:
            said.setdefault(bearing(contents, check["check"], only=name), []).append(breach_text(contents, name, check))
        whole = " ".join(f"{capital(listed(texts))}. {capital(does)}." for does, texts in said.items())
        found.append(f"At the answer, {which}: {whole[:1].lower()}{whole[1:]}")
    return found


# --- strengths beyond the tests ------------------------------------------------------------------------


def extrapolation_cautions(contents: Contents) -> list[str]:
    """Limits whose verdict or answer rests on strengths outside of what was tested."""
    found = []
    for name, limit in contents.results["limits"].items():
        key = f"limits.{name}.strength"
        data = (contents.resolved["random"].get(key) or {}).get("data") or []
        if not data:
            continue
        quantity = limit["quantity"]
        weakest, strongest = min(data), max(data)
        parts = []
        margin = contents.results["margins"].get(name) or {}
        design = ((margin.get("lost_to") or {}).get("partial") or {}).get(key, {}).get("design")
        value = (margin.get("value") or {}).get("value")
        if design is not None and value is not None and not weakest <= design <= strongest:
            at = answer_text(contents, name)
            parts.append(f"the answer {at} rests on strengths about {value_text(design, quantity, 3)}")
        given = ((limit.get("drivers") or {}).get("given_failure") or {}).get(key) or {}
        mean = (given.get("mean") or {}).get("value")
        if mean is not None and limit["aim"] == "survive" and mean < weakest:
            parts.append(f"the verdict as planned rests on strengths about {value_text(mean, quantity, 3)}")
        if parts:
            ends = f"{value_text(weakest, quantity, 3)} to {value_text(strongest, quantity, 3)}"
            found.append(
                f"Beyond the tests of {limit_name(name)}: the {len(data)} specimens that broke did so at {ends}; "
                f"{', '.join(parts)}. There the fitted law is extrapolated."
            )
    return found


# --- what is judged, and for which scene ---------------------------------------------------------------


def judged_cautions(contents: Contents) -> list[str]:
    """That only what has a limit is judged."""
    if contents.black_box or not (contents.results.get("fracture") or {}).get("limits"):
        return []
    judged = list(
        dict.fromkeys(contents.results["limits"][n]["quantity"] for n in contents.results["fracture"]["limits"])
    )
    names = listed([f"the {call(n)}" if n in OUTPUTS else n for n in judged])
    others = [
        *(() if set(judged) & _RIM else ("chips at the rim of a contact",)),
        *(() if set(judged) & _CORE else ("splits from its core",)),
    ]
    if not others:
        return []
    return [
        f"Fracture is judged by {names} alone. Whether the sphere {' or '.join(others)} before that is not judged: no "
        "limit of the study says at which stress it does."
    ]


def reach_note(contents: Contents) -> str:
    """For which scene the answers hold: sizes and speeds that were sampled, and whether strength knows of size."""
    if contents.black_box:
        return ""
    text = "The speed is that of the striker of this rig, not that of a sphere that falls or is thrown." * any(
        entry["solve"] == "striker.speed" for entry in contents.results["margins"].values()
    )
    radius = _span(contents, "sphere.radius")
    if radius:
        text += (
            f" The answers hold for a sphere of radius {radius}, between these bars, with this pulse: another size, "
        )
        text += "bar or pulse needs a run of its own."
    if _size_free(contents):
        text += " The strength does not change with the size of the sphere in this study."
    return text.strip()


def _span(contents: Contents, name: str) -> str:
    law = law_of(contents.resolved, name)
    if law is None:
        fixed = contents.resolved["fixed"].get(name)
        return "" if fixed is None else value_text(float(fixed), name, 4)
    low, high = (float(x) for x in ppf(law, np.array([0.001, 0.999])))
    ends = [rounded({"value": v, "low": None, "high": None}, name, 3) for v in (low, high)]
    return " to ".join(ends)


def _size_free(contents: Contents) -> bool:
    """Whether no strength is tied to the sphere's size, by a dependence or by a criterion that counts flaws."""
    limits = contents.results["limits"]
    if not any(f"limits.{name}.strength" in contents.resolved["random"] for name in limits):
        return False
    tied = any("sphere.radius" in group["of"] for group in contents.resolved.get("dependence", []))
    plain = all(limit["quantity"] in OUTPUTS and "weakest" not in limit["quantity"] for limit in limits.values())
    return not tied and plain
