"""What a broken assumption of the model does to the answer: in which direction it moves it, or that this is not known.

The directions are those of theory section 9; how far an answer moves is never known, or the model would have it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from uqsphere.mechanics.validity import RULES
from uqsphere.report import event
from uqsphere.report.contents import Contents
from uqsphere.report.wording import limit_name, listed, plain_percent

__all__ = ["bearing", "breach", "check_name", "grave", "warned"]

#: what a check finds where it is broken
_FOUND: Final = {
    "small_contact": "the contact is not small against the sphere",
    "contact_on_bar_end": "the contact is not small against the bar’s end",
    "bar_yield_contact": "the bars yield under the sphere",
    "bar_yield_pulse": "the pulse makes the bars yield",
    "force_balance": "the two contact forces differ",
    "quasi_static_sphere": "waves cross the sphere too few times while the force rises",
    "one_dimensional_bars": "the pulse is sharper than one-dimensional waves carry",
    "before_reflection": "reflected waves are back before the record ends",
}
#: demands of the contact itself, which fall where its circle widens
_PRESSURES: Final = frozenset({"p_max", "first_peak", "edge_tension", "ring_crack_toughness"})
#: demands that rise with the force
_LOADS: Final = _PRESSURES | {
    "P_max", "energy", "specific_energy", "centre_tension", "core_tension", "equatorial_tension",
    "hiramatsu_oka_tension", "subsurface_shear", "alpha_max", "a_max",
}  # fmt: skip
#: what is read off the forces of both faces, each for itself
_EITHER_FACE: Final = _PRESSURES | {
    "P_max", "alpha_max", "a_max", "contact_time", "pulse_width", "rise_time", "loading_rate", "energy",
    "specific_energy", "force_imbalance",
}  # fmt: skip
#: check -> demands that are lower in truth than computed, and why
_LOWER: Final = {
    "bar_yield_contact": (_PRESSURES, "a dent widens the contact, so that the true pressure is lower than computed"),
    "bar_yield_pulse": (
        _LOADS,
        "a bar that yields carries less than the elastic pulse, so that the true load is lower",
    ),
}


#: names that take a hyphen
_NAMES: Final = {"quasi_static_sphere": "quasi-static sphere", "one_dimensional_bars": "one-dimensional bars"}


def check_name(check: str) -> str:
    """A validity check in words."""
    return _NAMES.get(check, check.replace("_", " "))


def grave(contents: Contents) -> list[Mapping[str, Any]]:
    """Checks that fail in some samples."""
    return [c for c in contents.results["validity"] if c.get("share_failure", 0.0) > 0.0]


def warned(contents: Contents) -> list[Mapping[str, Any]]:
    """Checks that warn in some samples and fail in none."""
    return [c for c in contents.results["validity"] if c not in grave(contents) and c.get("share_warning", 0.0) > 0.0]


def broken_words(check: Mapping[str, Any]) -> str:
    """What is found where a check is broken, without how often."""
    return _FOUND.get(check["check"], check_name(check["check"]))


def breach(check: Mapping[str, Any], grade: str) -> str:
    """What is found, and in which share of what."""
    # at fracture the check is of those that break, which its text says
    whom = "the specimens that break" if "specimens that break" in str(check["text"]) else "the samples"
    words = broken_words(check)
    text = plain_percent(check[f"share_{grade}"])
    rule = next((r for r in RULES if r.name == check["check"]), None)
    milder = check.get("share_information", 0.0)
    if rule is not None and rule.information is not None and grade == "warning" and milder > 0.0:
        # the check's own text counts both grades
        both = plain_percent(float(f"{milder + check['share_warning']:.3g}"))
        return f"{words} (beyond {rule.warning:g} in {text} of {whom}, beyond {rule.information:g} in {both})"
    return f"{words} ({text} of {whom})"


def _probability(contents: Contents, name: str) -> str:
    """What the probability of a limit is of, with its name where there are several."""
    results = contents.results
    if not event.breaks(results, name):
        return f"of missing {limit_name(name, 30)}"
    own = f" ({limit_name(name, 30)})" if len(results["limits"]) > 1 else ""
    return f"that {event.missing(results, name)}{own}"


def bearing(contents: Contents, check: str, only: str = "") -> str:
    """Whether a broken check moves the probabilities of the limits, and in which direction, in a sentence.

    Parameters
    ----------
    contents : the run
    check : name of a rule of `uqsphere.mechanics.validity`
    only : the one limit that is of interest; all if empty

    Returns
    -------
    str
        Without a full stop at its end; of the quantities where there is no limit.
    """
    limits = {n: limit for n, limit in contents.results["limits"].items() if only in ("", n)}
    followed = contents.results["model"]["chosen"] != "massless"
    lower, why = _LOWER.get(check, (frozenset(), ""))
    said: dict[str, list[str]] = {}
    for name, limit in limits.items():
        if limit["quantity"] in lower:
            text = "is smaller than stated" if limit["aim"] == "survive" else "is larger than stated"
        elif check == "force_balance" and followed and limit["quantity"] in _EITHER_FACE:
            text = "does not move: the model follows both faces"
        else:
            text = "may move, in which direction is not known"
        said.setdefault(text, []).append(_probability(contents, name))
    parts = [f"the probability {listed(names)} {text}" for text, names in said.items()]
    if any(limit["quantity"] in lower for limit in limits.values()):
        return f"{why}: {'; '.join(parts)}, by how much is not known"
    if limits:
        return "; ".join(parts)
    if lower & set(contents.results["quantities"]):
        return f"{why}, by how much is not known"
    return "in which direction that moves the answers is not known"
