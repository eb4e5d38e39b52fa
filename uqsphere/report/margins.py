"""The answer to an inverse question in three lines: at most or at least how much, what it hangs on, what would help."""

from __future__ import annotations

import math

from uqsphere.report.blocks import Table, cell
from uqsphere.report.contents import Contents
from uqsphere.report.phrases import (
    at_most,
    input_name,
    limit_name,
    number_text,
    plain_percent,
    probability_range,
    rounded,
    value_text,
)
from uqsphere.results import LimitEntry
from uqsphere.results.entries import Est
from uqsphere.results.margins import MarginEntry


def reserve(contents: Contents, entry: MarginEntry, limit: LimitEntry) -> float | None:
    """Factor by which the free scalar may move before the target is reached; below 1 where it is missed."""
    here, value = contents.at_mean(entry.solve), entry.value.value
    if here is None or value is None or not (here > 0.0 and value > 0.0):
        return None
    return float(value / here if at_most(entry, limit.aim) else here / value)


def down(ratio: float) -> str:
    """A ratio in three digits, never more than it is."""
    return f"{math.floor(100.0 * ratio + 1e-9) / 100.0:.2f}" if ratio < 100.0 else f"{math.floor(ratio)}"


def up(ratio: float) -> str:
    """A ratio in three digits, never less than it is."""
    return f"{math.ceil(100.0 * ratio - 1e-9) / 100.0:.2f}" if ratio < 100.0 else f"{math.ceil(ratio)}"


# --- What a margin is made of, as a table: safety factors, partial factors, scatter, ignorance, error, and the bars.


def _factor(limit: LimitEntry) -> str:
    """What strength over demand is called: safe above 1 where the sphere is to survive, short where it is to break."""
    return "safety factor" if limit.aim == "survive" else "strength over demand (above 1: short of breaking)"


def _likeliest(limit: LimitEntry) -> str:
    return "failure" if limit.aim == "survive" else "survival"


def parts_table(contents: Contents, name: str) -> Table | None:
    """Everything that is known of a margin beside its curve; None for a folder of an earlier version."""
    entry, limit = contents.results.margins[name], contents.results.limits[name]
    if "factors" not in entry.model_fields_set:
        return None
    subject = contents.subject(entry.solve)
    rows: list[tuple[str, str]] = []
    factor = reserve(contents, entry, limit)
    if factor is not None:
        word = "reserve" if factor >= 1.0 else "shortfall (reserve below 1)"
        told = down(factor) if factor >= 1.0 else f"{factor:.3g}"
        rows.append((f"{word} in {input_name(entry.solve)}: the answer against the planned value", told))
    factors = entry.factors
    if factors.medians:
        of = factors.fractiles_of
        rows += [
            (
                f"{_factor(limit)} as planned: median strength over median demand",
                _ranged(contents, name, factors.medians, 0.5),
            ),
            (
                f"{_factor(limit)} as planned: {plain_percent(of.strength)} fractile of the strength over "
                f"{plain_percent(of.demand)} fractile of the demand (each by itself, without their dependence)",
                _ranged(contents, name, factors.fractiles, of.demand),
            ),
        ]
    rows += _partial_rows(entry, limit)
    split = entry.split
    for spread, words in (
        (split.scatter, "scatter from sphere to sphere, in the probability already"),
        (split.ignorance, "uncertainty of the answer from few tests"),
        (split.numerical, "uncertainty of the answer from computing"),
    ):
        if spread is not None:
            rows.append((f"{words} (standard deviation of its logarithm)", number_text(f"{spread:#.2g}")))
    opened = entry.ignorance
    if opened.laws:
        ends = [_three(end, subject) if end is not None else "beyond the range" for end in (opened.low, opened.high)]
        rows.append((f"{input_name(entry.solve)} that the tests leave open (95 %)", " to ".join(ends)))
        if opened.mean_law is not None:
            rows.append(
                (
                    f"{input_name(entry.solve)} with the mean over all laws that the tests allow",
                    _three(opened.mean_law, subject),
                )
            )
    standing = limit.ignorance
    if standing.known:
        rows.append(("probability of missing the aim that the tests leave open", probability_range(*standing.miss)))
    caption = f"Margin of {limit_name(name)}; the answer is where {plain_percent(entry.probability or 0.0)} exceed it"
    return Table(caption=caption, header=("", "value"), rows=tuple(rows)) if rows else None


def _partial_rows(entry: MarginEntry, limit: LimitEntry) -> list[tuple[str, str]]:
    """The partial factors at the answer."""
    rows = []
    for key, part in entry.lost_to.partial.items():
        strength = key.endswith(".strength")
        own = limit.quantity if strength else key
        fractile = "5 %" if limit.aim == "survive" else "95 %"
        what = (
            f"its {fractile} fractile over its value at the likeliest {_likeliest(limit)}"
            if strength
            else f"its value at the likeliest {_likeliest(limit)} over its median"
        )
        values = (part.characteristic, part.design) if strength else (part.design, part.characteristic)
        text = f"{part.factor:.3f} ({value_text(values[0], own)} over {value_text(values[1], own)})"
        rows.append((f"at the answer, partial factor of {input_name(key)}: {what}", text))
    return rows


def _three(value: float, subject: str) -> str:
    """A value of which three digits count, with the zeros among them."""
    return rounded(Est.of(value), subject, 3)


def _ranged(contents: Contents, name: str, factor: float, fractile: float) -> str:
    """A safety factor with the relative interval of the demand under it; the strength over it is exact by its law."""
    limit = contents.resolved.limits[name]
    quantity = contents.results.quantities.get(limit.quantity)
    demand = quantity.quantiles.get(f"{fractile:g}", Est()) if quantity is not None else Est()
    if limit.model_factor != 1.0 or not demand.value or not demand.low or not demand.high:
        return f"{factor:.3g} (no interval: the demand has none of its own)"
    low, high = sorted((factor * demand.value / demand.high, factor * demand.value / demand.low))
    return cell(Est.of(factor, low, high))
