"""The tables of the answers: quantities, indices, limits, margins."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from uqsphere.report import event, reach
from uqsphere.report.contents import Contents
from uqsphere.report.figures import ranked
from uqsphere.report.tables import Table, cell, index_cell
from uqsphere.report.wording import (
    ABSENT,
    begin,
    input_name,
    limit_name,
    plain_percent,
    probability_range,
    symbol,
    value_text,
)

#: quantities that the end of the record can cut short
_RECORDED = frozenset({"contact_time", "pulse_width"})

__all__ = [
    "Table",
    "index_table",
    "limits_table",
    "margins_table",
    "quantity_table",
]


def quantity_table(contents: Contents, quantity: str) -> Table:
    """Mean, standard deviation, quantiles and censored share with their intervals."""
    entry = contents.results["quantities"][quantity]
    mean, sd = entry["mean"]["value"], entry["sd"]["value"]
    spread = cell(entry["sd"], quantity)
    if mean is not None and sd is not None and sd < 1e-9 * abs(mean):
        spread = "none seen"
    rows = [("mean", cell(entry["mean"], quantity)), ("standard deviation", spread)]
    if spread != "none seen" or entry["censored_share"]["value"]:
        rows += [(f"{100.0 * float(p):g} % quantile", cell(e, quantity)) for p, e in entry["quantiles"].items()]
    if entry["censored_share"]["value"] or quantity in _RECORDED:
        rows.append(("share that outlasts the record", cell(entry["censored_share"], probability=True)))
    return Table(
        caption=f"{symbol(quantity)}: values with 95 % intervals",
        header=("", "value (95 % interval)"),
        rows=tuple(rows),
    )


def index_table(contents: Contents, quantity: str) -> Table | None:
    """First and total indices with intervals."""
    entry = contents.results["sensitivity"].get(quantity)
    names = ranked(entry)
    if not names or entry is None:
        return None
    rows = [(input_name(n), index_cell(entry["first"][n]), index_cell(entry["total"][n])) for n in names]
    return Table(
        caption=f"Sobol’ indices of {symbol(quantity)} with 95 % intervals",
        header=("input", "first (alone)", "total (with interactions)"),
        rows=tuple(rows),
    )


def limits_table(contents: Contents) -> Table:
    """Probabilities, reliability index and margin of every limit."""
    rows: list[tuple[str, ...]] = []
    for name, limit in contents.results["limits"].items():
        index = limit["reliability_index"]
        low, high = limit.get("reliability_index_interval") or (None, None)
        beta = ABSENT if index is None else cell({"value": index, "low": low, "high": high})
        rows += [
            (limit_name(name), "probability of exceeding the strength", cell(limit["exceedance"], probability=True)),
            (
                limit_name(name),
                f"probability of missing the aim ({limit['aim']})",
                cell(limit["miss"], probability=True),
            ),
            (limit_name(name), "reliability index", beta),
        ]
        opened = limit.get("ignorance")
        if opened:
            text = ABSENT if "reason" in opened else probability_range(*opened["miss"]) + " (95 %)"
            rows.append((limit_name(name), "probability of missing the aim that the tests leave open", text))
        words = {"median": "margin, median", "0.05": "margin, 5 %", "0.95": "margin, 95 %"}
        rows += [(limit_name(name), words.get(k, k), cell(e)) for k, e in limit["margin"].items()]
        rows += _design_rows(name, limit)
    return Table(caption="Limits with 95 % intervals", header=("limit", "", "value (95 % interval)"), rows=tuple(rows))


def _design_rows(name: str, limit: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """How many ways there are to miss the aim, and what the methods say; a design point has a table of its own."""
    rows: list[tuple[str, ...]] = []
    if not limit.get("design_point") and limit.get("design_point_reason"):
        rows.append((limit_name(name), "design point", f"{ABSENT} ({limit['design_point_reason']})"))
    if limit.get("modes"):
        rows.append((limit_name(name), "separate ways to miss the aim", str(limit["modes"])))
    return rows + [(limit_name(name), "check", str(text)) for text in limit.get("checks") or ()]


def margins_table(contents: Contents, name: str, *, only_own: bool = False) -> Table:
    """Values of the free scalar at the probabilities asked for, or at the one of the limit's target alone."""
    entry = contents.results["margins"][name]
    solve = entry["solve"]
    subject = contents.subject(solve)
    what = event.event(contents.results, name) + event.of_limit(contents.results, name)
    header = ["probability", "value (95 % interval of the computation alone)"]
    opened, decisive = entry.get("ignorance") or {}, format(entry.get("probability") or 0.0, ".15g")
    tested = opened.get("low") is not None and opened.get("high") is not None
    yields = bool((entry.get("bars") or {}).get("yields_at"))
    header[1:1] = ["what the tests leave open (95 %)"] if tested else []
    header += ["bars yield under the sphere"] if yields else []
    rows = []
    for p, e in entry["values"].items():
        if only_own and p != decisive:
            continue
        row = [plain_percent(float(p)), cell(e, subject)]
        if tested:
            ends = f"{value_text(opened['low'], subject, 3)} to {value_text(opened['high'], subject, 3)}"
            row[1:1] = [ends if p == decisive else ABSENT]
        if yields:
            share = reach.yields_at(entry, p)
            row.append(ABSENT if share is None else reach.cases_text(share))
        rows.append(tuple(row))
    return Table(
        caption=f"{begin(solve, input_name(solve))} at which {what} with a given probability",
        header=tuple(header),
        rows=tuple(rows),
    )
