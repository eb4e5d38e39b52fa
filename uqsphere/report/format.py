"""Answers as text: one formatter for values, estimates and probabilities, for page, terminal and
figures alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from uqsphere.quantities import (
    format_estimate,
    format_index,
    format_probability_estimate,
    format_value,
    lookup,
)

Row = Mapping[str, Any]
Results = Mapping[str, Any]


def find(rows: Sequence[Row], subject: str, answer: str, at: float | str = "") -> Row | None:
    """The row of an answer, None where there is none."""
    return next(
        (r for r in rows if r["subject"] == subject and r["answer"] == answer and r["at"] == at),
        None,
    )


def of(rows: Sequence[Row], subject: str, answer: str) -> list[Row]:
    """All rows of an answer."""
    return [row for row in rows if row["subject"] == subject and row["answer"] == answer]


def verdicts(results: Results) -> list[tuple[str, Mapping[str, Any]]]:
    """Limits with their verdict, those that say the same together; those without a target where
    none has one.
    """
    known = results["verdicts"]
    groups: dict[tuple[str, str], list[str]] = {}
    for name, one in ({n: v for n, v in known.items() if v["target"] is not None} or known).items():
        groups.setdefault((one["headline"], one["detail"]), []).append(name)
    return [(", ".join(names), known[names[0]]) for names in groups.values()]


@dataclass(frozen=True, kw_only=True)
class Mode:
    """A limit, a failure mode beside it, or all of them together (no `entry`): rows of the answers
    that stand side by side, `index` being the reliability index and `margin` the free number at the
    target."""

    subject: str
    name: str
    entry: Mapping[str, Any]
    fracture: Row | None
    index: float | None
    margin: Row | None


def failure_modes(results: Results) -> list[Mode]:
    """Limits of the study, failure modes beside them, and all together where there are several."""
    study, answers, modes = results["study"], results["answers"], list[Mode]()
    for kind in ("limits", "modes"):
        for name, entry in study[kind].items():
            subject = f"{kind}.{name}"
            rows = (row for row in of(answers, subject, "margin") if isinstance(row["at"], float))
            margin = next(
                (row for row in rows if abs(row["at"] - entry["allowable"]) <= 1e-9), None
            )
            modes.append(
                Mode(
                    subject=subject,
                    name=label(subject),
                    entry=entry,
                    margin=margin,
                    fracture=find(answers, subject, "exceedance_probability"),
                    index=(find(answers, subject, "reliability_index") or {}).get("value"),
                )
            )
    joint = all_together(results)
    if joint is not None:
        modes.append(
            Mode(
                subject="",
                name="all together",
                entry={},
                fracture=joint["probability"],
                index=joint["reliability_index"]["value"],
                margin=joint.get("margin"),
            )
        )
    return modes


def all_together(results: Results) -> Mapping[str, Any] | None:
    """What the failure modes say together: the first verdict that rests on several."""
    return next(
        (verdict["all_modes"] for _, verdict in verdicts(results) if verdict.get("all_modes")), None
    )


def value(number: float | None, name: str, digits: int = 3) -> str:
    """A number of a quantity with its unit; a dash where there is none.

    >>> value(2.5541e9, "p_max"), value(None, "p_max")
    ('2.55 GPa', '–')
    """
    return "–" if number is None else format_value(number, name, digits)


def estimate(row: Row | None, name: str = "", most: int = 4) -> str:
    """Value (low to high) with the unit; a dash with the reason where there is no value.

    >>> estimate({"value": 0.5, "low": 0.49, "high": 0.51, "note": ""})
    '0.500 (0.490 to 0.510)'
    """
    if row is None:
        return "–"
    if row["value"] is None:
        return f"– ({row['note']})" if row["note"] else "–"
    return format_estimate(row["value"], row["low"], row["high"], name, most)


def index(row: Row | None) -> str:
    """A Sobol' index with its interval, to three decimals.

    >>> small = {"value": 4e-5, "low": 0.0, "high": 9e-5}
    >>> index({"value": 0.98412, "low": 0.981, "high": 0.987}), index(small)
    ('0.984 (0.981 to 0.987)', '0.000')
    """
    if row is None or row["value"] is None:
        return "–"
    return format_index(row["value"], row["low"], row["high"])


def probability(row: Row | None) -> str:
    """A probability in per cent with its interval; an upper bound where nothing was seen.

    >>> probability({"value": 0.02017, "low": 0.0199, "high": 0.0204, "note": ""})
    '2.02 % (1.99 to 2.04 %)'
    >>> probability({"value": None, "low": 0.0, "high": 1e-5, "note": "too few"})
    'below 1e-05'
    """
    if row is None:
        return "–"
    if row["value"] is None and row["low"] is None and row["high"] is None:
        return "–"
    return format_probability_estimate(row["value"], row["low"], row["high"])


def meaning(name: str, inputs: Mapping[str, Any] | None = None) -> str:
    """What a number is called by people.

    >>> meaning("limits.crushing.strength")
    'strength (crushing)'
    """
    if name.startswith("limits."):
        limit, _, part = name.removeprefix("limits.").rpartition(".")
        return f"{part.replace('_', ' ')} ({limit.removesuffix(' (assumed)')})"
    if inputs and name in inputs:
        return short(str(inputs[name]["meaning"]))
    return short(lookup(name).meaning)


def short(text: str) -> str:
    """What a quantity is called, without what it is made of.

    >>> short("equivalent contact duration: impulse over peak")
    'equivalent contact duration'
    """
    return text.partition(":")[0]


def label(subject: str) -> str:
    """A limit or failure mode by its own name.

    >>> label("limits.crushing"), label("modes.ring crack")
    ('crushing', 'ring crack (assumed)')
    """
    kind, _, name = subject.partition(".")
    return f"{name} (assumed)" if kind == "modes" else name or subject
