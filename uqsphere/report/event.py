"""What a limit's event is called: one name, in whichever way the aim puts it."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

from uqsphere.quantities import display_unit
from uqsphere.report.contents import Contents
from uqsphere.report.wording import begin, input_name, limit_name, rounded

__all__ = ["answer_text", "at_most", "breaks", "event", "missing", "of_limit", "safe_side", "solved_name"]


def at_most(entry: Mapping[str, Any], aim: str) -> bool:
    """Whether the aim is reached below the value (at most) or above it (at least)."""
    curve = entry["curve"]
    rising = bool(curve[-1][1] >= curve[0][1])
    return rising == (aim == "survive")


def answer_text(contents: Contents, name: str) -> str:
    """The answer of a limit's inverse question as it is given everywhere: rounded to the safe side."""
    entry = contents.results["margins"][name]
    most = at_most(entry, contents.results["limits"][name]["aim"])
    return safe_side(entry["value"], contents.subject(entry["solve"]), at_most=most)


def breaks(results: Mapping[str, Any], name: str) -> bool:
    """Whether exceeding a limit means that the sphere breaks.

    A limit that the study leaves out of fracture still does where its aim is to break: nothing else is to be broken.
    """
    found = results.get("fracture") or {}
    left_out = name in found.get("left_out", ()) and results["limits"][name]["aim"] == "break"
    return name in found.get("limits", ()) or left_out


def event(results: Mapping[str, Any], name: str) -> str:
    """Exceeding a limit as a clause."""
    return "the sphere breaks" if breaks(results, name) else f"{limit_name(name)} is exceeded"


def missing(results: Mapping[str, Any], name: str) -> str:
    """Missing the aim of a limit as a clause."""
    if results["limits"][name]["aim"] == "survive":
        return event(results, name)
    return "the sphere is left whole" if breaks(results, name) else f"{limit_name(name)} is not exceeded"


def of_limit(results: Mapping[str, Any], name: str) -> str:
    """The limit's name in brackets behind its event, where there are several limits."""
    return f" (limit {limit_name(name)})" if breaks(results, name) and len(results["limits"]) > 1 else ""


def solved_name(results: Mapping[str, Any], solve: str) -> str:
    """The free scalar in words, with a capital letter; of one that scatters it is the mean that is solved for."""
    return f"Mean {input_name(solve)}" if solve in results["inputs"] else begin(solve, input_name(solve))


def safe_side(estimate: Mapping[str, Any], name: str, *, at_most: bool, digits: int = 4) -> str:
    """A limit in the digits that its interval supports, rounded to the safe side and never past the value.

    >>> known = {"value": 0.65852, "low": 0.6573, "high": 0.6597}
    >>> safe_side(known, "striker.speed", at_most=True), safe_side(known, "striker.speed", at_most=False)
    ('0.658 m/s', '0.659 m/s')
    """
    text = rounded(estimate, name, digits)
    found = re.match(r"(−?)(\d+(?:\.(\d+))?)(?![\d.]| ×)", text)
    value = estimate["value"]
    if found is None or value is None:
        return text
    # in the unit that the text is in: a prefix may differ from the one that is usual for the name
    shown = float(found[2]) * (-1.0 if found[1] else 1.0)
    scaled = value * display_unit(name)[1]
    if shown == 0.0 or not scaled:
        return text
    power = round(math.log10(abs(shown / scaled)))
    scaled *= 10.0 ** (3 * round(power / 3))
    decimals = len(found[3] or "")
    step = 10.0**-decimals
    if not found[3]:
        step = 10.0 ** (len(found[2]) - len(found[2].rstrip("0")))
    if at_most and shown > scaled * (1.0 + 1e-9):
        shown -= step
    elif not at_most and shown < scaled * (1.0 - 1e-9):
        shown += step
    return f"{shown:.{decimals}f}".replace("-", "−") + text[found.end() :]
