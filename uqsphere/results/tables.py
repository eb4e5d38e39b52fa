"""The answers of a run as CSV tables, from what results.json holds alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

from uqsphere.results import AssumedEntry, FractureEntry, MeasureEntry, QuantityEntry, Results
from uqsphere.results.entries import Est
from uqsphere.store import csv_text

#: a row of cells; header and rows by name
Row: TypeAlias = list[object]
Tables: TypeAlias = dict[str, tuple[Sequence[str], Sequence[Sequence[object]]]]

_ESTIMATE = ("value", "low", "high", "std_error", "method", "evaluations", "reason")


def _row(estimate: Est) -> Row:
    return ["" if (value := getattr(estimate, key)) is None else value for key in _ESTIMATE]


def _driver_rows(results: Results) -> list[Row]:
    """Delta and PAWN of the quantities, indices of missing the aim of the limits, sways and tests of both."""
    rows: list[Row] = []
    for name, entry in results.sensitivity.items():
        sets = [("delta", entry.delta), ("pawn", entry.pawn)]
        rows += [[name, what, n, *_row(e), ""] for what, table in sets for n, e in table.items()]
        rows += _measured(name, entry.measure_first)
    for name, limit in results.limits.items():
        orders = limit.drivers.orders()
        rows += [[name, what, n, *_row(e), ""] for what, table in orders for n, e in table.items()]
        rows += _measured(name, limit.measure_first)
    return rows


def _measured(name: str, found: MeasureEntry) -> list[Row]:
    return [[name, "sway" if r.sway else "share", r.input, *_row(r.effect), r.tests] for r in found.rows]


def _tolerance_rows(name: str, entry: QuantityEntry) -> list[Row]:
    """Rows of the tolerance limits of a quantity: upper and lower as values, both sides as the ends of an interval."""
    limits = entry.tolerance
    if not limits:
        return []
    method = f"tolerance limit, {limits.coverage:g} with confidence {limits.confidence:g}"
    low, high = limits.between or (None, None)
    places = {
        "upper tolerance limit": (limits.upper, None, None),
        "lower tolerance limit": (limits.lower, None, None),
        "tolerance interval": (None, low, high),
    }
    return [
        [name, entry.unit, what, *_row(Est(value=value, low=low, high=high, std_error=None, method=method,
                                           evaluations=limits.runs, reason=limits.reason))]
        for what, (value, low, high) in places.items()
    ]  # fmt: skip


def _fracture_rows(found: FractureEntry) -> list[Row]:
    """Probabilities of fracture, shares by limit and by order, and the state at fracture: what, of which, unit, EST."""
    whole = {"union": found.union, "first_loading": found.first_loading, "over_record": found.over_record}
    rows = [[what, "", "", *_row(e)] for what, e in whole.items() if e]
    rows += [["governed_by", name, "", *_row(e)] for name, e in found.governed_by.items()]
    rows += [["order", " > ".join(entry.limits), "", *_row(entry.share)] for entry in found.order]
    rows += [
        [what, f"q{p}", entry.unit, *_row(e)]
        for what, entry in found.states().items()
        if what != "t10"
        for p, e in entry.quantiles.items()
    ]
    return rows


def _instead(row: AssumedEntry) -> str:
    """What is put in place of what a probability takes for granted."""
    if row.assumption == "dependence":
        return f"miss, strength independent of {' and '.join(row.others)}"
    told = row.instead if isinstance(row.instead, str) else f"{row.instead:.6g}"
    return f"miss, {row.assumption} of the strength {told}"


def _quantity_rows(results: Results) -> list[Row]:
    rows = []
    for name, entry in results.quantities.items():
        rows += [[name, entry.unit, what, *_row(e)] for what, e in (("mean", entry.mean), ("sd", entry.sd))]
        rows.append([name, "", "censored_share", *_row(entry.censored_share)])
        rows += [[name, entry.unit, f"q{p}", *_row(e)] for p, e in entry.quantiles.items()]
        rows += _tolerance_rows(name, entry)
    return rows


def _limit_rows(results: Results) -> list[Row]:
    rows = []
    for name, limit in results.limits.items():
        rows += [[name, what, *_row(e)] for what, e in (("exceedance", limit.exceedance), ("miss", limit.miss))]
        rows += [[name, f"margin {which}", *_row(e)] for which, e in limit.margin.items()]
        rows += [[name, _instead(row), *_row(row.miss)] for row in limit.assumed]
    return rows


def _values(of: Row, values: Mapping[str, Est]) -> list[Row]:
    """The values of a curve at its probabilities."""
    return [[*of, p, *_row(e)] for p, e in values.items()]


def _verdict_rows(results: Results) -> list[Row]:
    """Every way to break that an aim was judged by: its probability of missing it, and the free scalar it asks for."""
    return [
        [
            entry.aim, "" if entry.target is None else entry.target, entry.verdict or "", one.name, one.assumed,
            "" if one.answer is None else one.answer, *(one.range or ("", "")), *_row(one.miss),
        ]
        for entry in results.verdicts
        for one in entry.judged
    ]  # fmt: skip


def _margin_tables(results: Results) -> Tables:
    """Values at the probabilities asked for, and the curves; over the energy too where that was asked for."""
    margins = results.margins
    over = {name: entry.against for name, entry in margins.items() if entry.against}
    values = [row for name, entry in margins.items() for row in _values([name, entry.solve, entry.unit], entry.values)]
    values += [row for name, entry in over.items() for row in _values([name, entry.quantity, entry.unit], entry.values)]
    curves: list[Row] = [[name, *point] for name, entry in margins.items() for point in entry.curve]
    family: tuple[str, ...] = ()
    if any(entry.family for entry in margins.values()):
        family = ("family", "family_value")
        # the curves of the study itself have no value of a family
        values, curves = ([[*row, "", ""] for row in rows] for rows in (values, curves))
        for name, entry in margins.items():
            for member in entry.family.members:
                of = [entry.family.path, member.value]
                values += [[*row, *of] for row in _values([name, entry.solve, entry.unit], member.values)]
                curves += [[name, *point, *of] for point in member.curve]
    curves += [["any", *point, *("" for _ in family)] for point in results.fracture.curve]
    found: Tables = {
        "margins": (("limit", "solve", "unit", "exceedance", *_ESTIMATE, *family), values),
        "fragility": (("limit", "value", "probability", "low", "high", *family), curves),
    }
    if over:
        points = [[name, entry.quantity, entry.unit, *point] for name, entry in over.items() for point in entry.curve]
        found["fragility_energy"] = (("limit", "over", "unit", "value", "probability", "low", "high"), points)
    return found


def _index_rows(results: Results) -> list[Row]:
    return [
        [quantity, order, name, *_row(estimate)]
        for quantity, entry in results.sensitivity.items()
        for order, table in entry.orders()
        for name, estimate in table.items()
    ]


def _analysis_rows(results: Results) -> list[Row]:
    return [
        [analysis, quantity, of, statistic, *_row(estimate)]
        for analysis, entry in results.analyses.items()
        for quantity, table in entry.values.items()
        for of, columns in table.items()
        for statistic, estimate in columns.items()
    ]


def tables(results: Results) -> dict[str, str]:
    """CSV tables by file name."""
    return {f"{name}.csv": csv_text(header, rows) for name, (header, rows) in table_cells(results).items()}


def table_cells(results: Results) -> Tables:
    """Header and rows of every table by its name; what is not known is an empty text."""
    inputs = [[n, e.dist, e.mean, e.sd, e.unit] for n, e in results.inputs.items()]
    checks = [[c.check, c.share, c.worst, c.text] for c in results.validity]
    speed = [[r.method, r.quantity, r.evaluations, r.error, r.error_kind] for r in results.speed_error]
    found: Tables = {
        "inputs": (("input", "distribution", "mean", "sd", "unit"), inputs),
        "quantities": (("quantity", "unit", "statistic", *_ESTIMATE), _quantity_rows(results)),
        "sensitivity": (("quantity", "order", "input", *_ESTIMATE), _index_rows(results)),
        "drivers": (("of", "statistic", "input", *_ESTIMATE, "tests"), _driver_rows(results)),
        "limits": (("limit", "statistic", *_ESTIMATE), _limit_rows(results)),
        **_margin_tables(results),
        "validity": (("check", "share", "worst", "text"), checks),
        "speed_error": (("method", "quantity", "evaluations", "error", "error_kind"), speed),
    }
    if results.verdicts:
        header = ("aim", "target", "verdict", "way", "assumed", "answer", "range_low", "range_high", *_ESTIMATE)
        found["verdicts"] = (header, _verdict_rows(results))
    if results.fracture:
        found["fracture"] = (("statistic", "of", "unit", *_ESTIMATE), _fracture_rows(results.fracture))
    if results.analyses:
        found["analyses"] = (("analysis", "quantity", "of", "statistic", *_ESTIMATE), _analysis_rows(results))
    if results.paper:
        found["paper"] = (
            ("quantity", "unit", "as_printed", "corrected", "full", "note"),
            [[p.quantity, p.unit, p.as_printed, p.corrected, p.full, p.note] for p in results.paper],
        )
    return found
