"""The answers of a run as CSV tables, from the content of results.json alone."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

__all__ = ["csv_text", "plain_cell", "tables"]

#: what a formula begins with, wide forms included
_FORMULA = "=+-@\t\r\n＝＋－＠"


def csv_text(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """CSV text; a text that a spreadsheet would take for a formula is quoted with an apostrophe."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow([plain_cell(name) for name in header])
    for row in rows:
        writer.writerow([_cell(value) for value in row])
    return buffer.getvalue()


def plain_cell(text: str) -> str:
    """A text that no spreadsheet takes for a formula.

    >>> plain_cell("=1+1"), plain_cell("a=1")
    ("'=1+1", 'a=1')
    """
    return "'" + text if text[:1] in _FORMULA and text else text


def _cell(value: Any) -> Any:
    if isinstance(value, str):
        return plain_cell(value)
    return repr(value) if isinstance(value, float) else value


_ESTIMATE = ("value", "low", "high", "std_error", "method", "evaluations", "reason")


def _row(estimate: Mapping[str, Any]) -> list[Any]:
    return [estimate.get(key, "") if estimate.get(key) is not None else "" for key in _ESTIMATE]


def _index_tables(entry: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """First and total indices, those of pairs and groups, and what takes their place where inputs depend, by order."""
    found = [("first", entry["first"]), ("total", entry["total"])]
    if "second" in entry:
        found.append(("second", entry["second"]))
    found += [(f"group {order}", table) for order, table in entry.get("groups", {}).items()]
    if entry.get("shapley"):
        found.append(("shapley", entry["shapley"]))
        found += [(f"kucherenko {order}", table) for order, table in entry["kucherenko"].items()]
    return found


def _driver_rows(results: Mapping[str, Any]) -> list[list[Any]]:
    """Delta and PAWN of the quantities, indices of missing the aim of the limits, sways and tests of both."""
    rows: list[list[Any]] = []
    for kind in ("sensitivity", "limits"):
        for name, entry in results[kind].items():
            tables = [(key, entry[key]) for key in ("delta", "pawn") if kind == "sensitivity" and key in entry]
            tables += _index_tables(entry["drivers"]) if kind == "limits" and "drivers" in entry else []
            rows += [[name, what, n, *_row(e), ""] for what, table in tables for n, e in table.items()]
            for row in (entry.get("measure_first") or {}).get("rows", ()):
                what = "sway" if "sway" in row else "share"
                rows.append([name, what, row["input"], *_row(row[what]), row["tests"]])
    return rows


def _tolerance_rows(name: str, entry: Mapping[str, Any]) -> list[list[Any]]:
    """Rows of the tolerance limits of a quantity: upper and lower as values, both sides as the ends of an interval."""
    limits = entry.get("tolerance")
    if not limits:
        return []
    method = f"tolerance limit, {limits['coverage']:g} with confidence {limits['confidence']:g}"
    common = {"method": method, "evaluations": limits["runs"], "reason": limits.get("reason")}
    low, high = limits["between"] or (None, None)
    return [
        [name, entry["unit"], "upper tolerance limit", *_row({**common, "value": limits["upper"]})],
        [name, entry["unit"], "lower tolerance limit", *_row({**common, "value": limits["lower"]})],
        [name, entry["unit"], "tolerance interval", *_row({**common, "low": low, "high": high})],
    ]


def _fracture_rows(found: Mapping[str, Any]) -> list[list[Any]]:
    """Probabilities of fracture, shares by limit and by order, and the state at fracture: what, of which, unit, EST."""
    rows = [[what, "", "", *_row(found[what])] for what in ("union", "first_loading", "over_record") if what in found]
    rows += [["governed_by", name, "", *_row(e)] for name, e in found.get("governed_by", {}).items()]
    rows += [["order", " > ".join(entry["limits"]), "", *_row(entry["share"])] for entry in found.get("order", ())]
    for what in ("time", "force", "energy", "specific_energy", "imbalance"):
        entry = found.get(what, {})
        rows += [[what, f"q{p}", entry["unit"], *_row(e)] for p, e in entry.get("quantiles", {}).items()]
    return rows


def _instead(row: Mapping[str, Any]) -> str:
    """What is put in place of what a probability takes for granted."""
    if row["assumption"] == "dependence":
        return f"miss, strength independent of {' and '.join(row['with'])}"
    told = row["instead"] if isinstance(row["instead"], str) else f"{row['instead']:.6g}"
    return f"miss, {row['assumption']} of the strength {told}"


def _members(results: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any], str, Mapping[str, Any]]]:
    """Limit, its margin, the path of its family, and a member, one by one."""
    return [
        (name, entry, entry["family"]["path"], member)
        for name, entry in results["margins"].items()
        for member in (entry.get("family") or {}).get("members", ())
    ]


def tables(results: Mapping[str, Any]) -> dict[str, str]:
    """CSV tables by file name, from the content of results.json alone."""
    quantity_rows = []
    for name, entry in results["quantities"].items():
        for what in ("mean", "sd", "censored_share"):
            unit = "" if what == "censored_share" else entry["unit"]
            quantity_rows.append([name, unit, what, *_row(entry[what])])
        quantity_rows += [[name, entry["unit"], f"q{p}", *_row(e)] for p, e in entry["quantiles"].items()]
        quantity_rows += _tolerance_rows(name, entry)
    index_rows = [
        [quantity, order, name, *_row(estimate)]
        for quantity, entry in results["sensitivity"].items()
        for order, table in _index_tables(entry)
        for name, estimate in table.items()
    ]
    limit_rows = []
    for name, entry in results["limits"].items():
        limit_rows += [[name, what, *_row(entry[what])] for what in ("exceedance", "miss")]
        limit_rows += [[name, f"margin {which}", *_row(e)] for which, e in entry["margin"].items()]
        limit_rows += [[name, _instead(row), *_row(row["miss"])] for row in entry.get("assumed") or ()]
    margin_rows = [
        [name, entry["solve"], entry["unit"], p, *_row(e)]
        for name, entry in results["margins"].items()
        for p, e in entry["values"].items()
    ]
    over = [(name, entry["against"]) for name, entry in results["margins"].items() if entry.get("against")]
    margin_rows += [
        [name, entry["quantity"], entry["unit"], p, *_row(e)]
        for name, entry in over
        for p, e in entry["values"].items()
    ]
    curve_rows = [[name, *point] for name, entry in results["margins"].items() for point in entry["curve"]]
    members = _members(results)
    if members:
        # the curves of the study itself have no value of a family
        margin_rows = [[*row, "", ""] for row in margin_rows]
        margin_rows += [[name, entry["solve"], entry["unit"], p, *_row(e), path, member["value"]]
                        for name, entry, path, member in members for p, e in member["values"].items()]  # fmt: skip
        curve_rows = [[*row, "", ""] for row in curve_rows]
        curve_rows += [[name, *point, path, member["value"]]
                       for name, _, path, member in members for point in member["curve"]]  # fmt: skip
    family = ("family", "family_value") if members else ()
    inputs = [[n, e["dist"], e["mean"], e["sd"], e["unit"]] for n, e in results["inputs"].items()]
    checks = [[c["check"], c["share"], c["worst"], c["text"]] for c in results["validity"]]
    speed = [
        [r["method"], r["quantity"], r["evaluations"], r["error"], r["error_kind"]] for r in results["speed_error"]
    ]
    found = {
        "inputs": (("input", "distribution", "mean", "sd", "unit"), inputs),
        "quantities": (("quantity", "unit", "statistic", *_ESTIMATE), quantity_rows),
        "sensitivity": (("quantity", "order", "input", *_ESTIMATE), index_rows),
        "drivers": (("of", "statistic", "input", *_ESTIMATE, "tests"), _driver_rows(results)),
        "limits": (("limit", "statistic", *_ESTIMATE), limit_rows),
        "margins": (("limit", "solve", "unit", "exceedance", *_ESTIMATE, *family), margin_rows),
        "fragility": (("limit", "value", "probability", "low", "high", *family), curve_rows),
        "validity": (("check", "share", "worst", "text"), checks),
        "speed_error": (("method", "quantity", "evaluations", "error", "error_kind"), speed),
    }
    if over:
        rows = [[name, entry["quantity"], entry["unit"], *point] for name, entry in over for point in entry["curve"]]
        found["fragility_energy"] = (("limit", "over", "unit", "value", "probability", "low", "high"), rows)
    if results.get("fracture"):
        fracture = results["fracture"]
        found["fracture"] = (("statistic", "of", "unit", *_ESTIMATE), _fracture_rows(fracture))
        curve_rows += [["any", *point, *("" for _ in family)] for point in fracture.get("curve", ())]
    if results.get("paper"):
        found["paper"] = (
            ("quantity", "unit", "as_printed", "corrected", "full", "note"),
            [
                [p["quantity"], p["unit"], p["as_printed"], p["corrected"], p["full"], p["note"]]
                for p in results["paper"]
            ],
        )
    return {f"{name}.csv": csv_text(header, rows) for name, (header, rows) in found.items()}
