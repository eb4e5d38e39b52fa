"""What a margin is made of, as a table: safety factors, partial factors, scatter, ignorance, error, and the bars."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from uqsphere.report import event
from uqsphere.report.contents import Contents
from uqsphere.report.margin_verdict import down, reserve
from uqsphere.report.tables import Table, cell
from uqsphere.report.wording import (
    input_name,
    limit_name,
    listed,
    number_text,
    plain_percent,
    probability_range,
    rounded,
    value_text,
)

__all__ = ["parts_finding", "parts_table"]


def parts_finding(contents: Contents, name: str) -> str:
    """How far the value lies from the median of fracture, and to whom that is owed."""
    entry = contents.results["margins"][name]
    value, fitted = entry.get("value") or {}, entry.get("lognormal") or {}
    middle = (entry["values"].get("0.5") or {}).get("value") or (fitted.get("median") or {}).get("value")
    shares = (entry.get("lost_to") or {}).get("shares")
    if not value.get("value") or not middle or not shares:
        return ""
    subject = contents.subject(entry["solve"])
    factor = middle / value["value"]
    if not factor > 0.0:
        # a scalar of either sign has no factors
        return ""
    lost = listed([
        f"{math.exp(share * math.log(factor)):.2f} ({input_name(n)})"
        for n, share in sorted(shares.items(), key=lambda item: -item[1])
        if abs(math.exp(share * math.log(factor)) - 1.0) >= 0.005
    ])  # fmt: skip
    return (
        f"Half of the specimens of {limit_name(name)} break at {value_text(middle, subject)}; between that and "
        f"{event.answer_text(contents, name)} lies a factor of {factor:.2f}, made up of {lost}."
    )


def _factor(limit: Mapping[str, Any]) -> str:
    """What strength over demand is called: safe above 1 where the sphere is to survive, short where it is to break."""
    return "safety factor" if limit["aim"] == "survive" else "strength over demand (above 1: short of breaking)"


def _likeliest(limit: Mapping[str, Any]) -> str:
    return "failure" if limit["aim"] == "survive" else "survival"


def parts_table(contents: Contents, name: str) -> Table | None:
    """Everything that is known of a margin beside its curve; None for a folder of an earlier version."""
    entry, limit = contents.results["margins"][name], contents.results["limits"][name]
    if "factors" not in entry:
        return None
    subject, quantity = contents.subject(entry["solve"]), limit["quantity"]
    rows: list[tuple[str, str]] = []
    factor = reserve(contents, entry, limit)
    if factor is not None:
        word = "reserve" if factor >= 1.0 else "shortfall (reserve below 1)"
        told = down(factor) if factor >= 1.0 else f"{factor:.3g}"
        rows.append((f"{word} in {input_name(entry['solve'])}: the answer against the planned value", told))
    factors = entry["factors"]
    if "medians" in factors:
        of = factors["fractiles_of"]
        rows += [
            (
                f"{_factor(limit)} as planned: median strength over median demand",
                _ranged(contents, name, factors["medians"], 0.5),
            ),
            (
                f"{_factor(limit)} as planned: {plain_percent(of['strength'])} fractile of the strength over "
                f"{plain_percent(of['demand'])} fractile of the demand (each by itself, without their dependence)",
                _ranged(contents, name, factors["fractiles"], of["demand"]),
            ),
        ]
    for key, part in (entry.get("lost_to") or {}).get("partial", {}).items():
        strength = key.endswith(".strength")
        own = quantity if strength else key
        fractile = "5 %" if limit["aim"] == "survive" else "95 %"
        what = (
            f"its {fractile} fractile over its value at the likeliest {_likeliest(limit)}"
            if strength
            else f"its value at the likeliest {_likeliest(limit)} over its median"
        )
        values = (part["characteristic"], part["design"]) if strength else (part["design"], part["characteristic"])
        text = f"{part['factor']:.3f} ({value_text(values[0], own)} over {value_text(values[1], own)})"
        rows.append((f"at the answer, partial factor of {input_name(key)}: {what}", text))
    split = entry.get("split", {})
    for key, words in (
        ("scatter", "scatter from specimen to specimen, in the probability already"),
        ("ignorance", "uncertainty of the answer from few tests"),
        ("numerical", "uncertainty of the answer from computing"),
    ):
        if split.get(key) is not None:
            rows.append((f"{words} (standard deviation of its logarithm)", number_text(f"{split[key]:#.2g}")))
    opened = entry.get("ignorance") or {}
    if "laws" in opened:
        ends = [_three(opened[end], subject) if opened[end] is not None else "beyond the range" for end in
                ("low", "high")]  # fmt: skip
        rows.append((f"{input_name(entry['solve'])} that the tests leave open (95 %)", " to ".join(ends)))
        if opened.get("mean_law") is not None:
            rows.append(
                (
                    f"{input_name(entry['solve'])} with the mean over all laws that the tests allow",
                    _three(opened["mean_law"], subject),
                )
            )
    standing = limit.get("ignorance") or {}
    if standing.get("miss"):
        rows.append(("probability of missing the aim that the tests leave open", probability_range(*standing["miss"])))
    at = f"{event.event(contents.results, name)} with a probability of {plain_percent(entry['probability'])}"
    caption = f"Margin of {limit_name(name)}; the answer is where {at}"
    note = (
        "Partial factors have no interval: they are where a search for the likeliest fracture ended. Standard "
        "deviations and what the tests leave open are uncertainties themselves."
    )
    note += _two_medians(limit, factors)
    return Table(caption=caption, header=("", "value"), rows=tuple(rows), note=note) if rows else None


def _two_medians(limit: Mapping[str, Any], factors: Mapping[str, Any]) -> str:
    """Why the median margin is another number than the safety factor on medians; empty where both read the same."""
    median = limit["margin"].get("median")
    if not median or median["value"] is None or "medians" not in factors:
        return ""
    # in as many digits as the margin is known to
    off = factors["medians"] - median["value"]
    moved = {key: None if median[key] is None else median[key] + off for key in ("value", "low", "high")}
    margin, medians = rounded(median), rounded(moved)
    if margin == medians:
        return ""
    return (
        f" The median margin, {margin}, is the middle of strength over demand taken case by case; {medians} is the "
        "middle strength over the middle demand. The two part where a law is skewed, or where strength and demand "
        "depend on each other."
    )


def _three(value: float, subject: str) -> str:
    """A value of which three digits count, with the zeros among them."""
    return rounded({"value": value, "low": None, "high": None}, subject, 3)


def _ranged(contents: Contents, name: str, factor: float, fractile: float) -> str:
    """A safety factor with the relative interval of the demand under it; the strength over it is exact by its law."""
    limit = contents.resolved["limits"][name]
    demand = contents.results["quantities"].get(limit["quantity"], {}).get("quantiles", {}).get(f"{fractile:g}")
    if limit["model_factor"] != 1.0 or not demand or not demand["value"] or not demand["low"] or not demand["high"]:
        return f"{factor:.3g} (no interval: the demand has none of its own)"
    low, high = sorted((factor * demand["value"] / demand["high"], factor * demand["value"] / demand["low"]))
    return cell({"value": factor, "low": low, "high": high})
