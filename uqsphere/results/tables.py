"""The answers of a run as CSV tables, and those that are vectors as NetCDF too.

fields.nc (NetCDF 3, any program reads it) and tables/fields.csv hold, of a field NAME over the dimension NAME_place:
NAME_place [s, or a number], NAME_mean, NAME_quantile (level), NAME_first and NAME_total (input), each of these with
_low and _high, the ends of its 95 % interval, and NAME_row, the model's own answers (row).
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import FolderError
from uqsphere.files import read_whole
from uqsphere.results import AssumedEntry, FractureEntry, MeasureEntry, QuantityEntry, Results
from uqsphere.results.entries import Est, MarginEntry
from uqsphere.store import csv_text, write_atomically
from uqsphere.uq.fields import Band, FieldAnswer

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


def _values(of: Row, values: Mapping[str, Est], family: Row) -> list[Row]:
    """The values of a curve at its probabilities, with what it is of in a family."""
    return [[*of, p, *_row(e), *family] for p, e in values.items()]


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


def _of_family(name: str, entry: MarginEntry) -> tuple[list[Row], list[Row]]:
    """Values and points of the curves of a family."""
    values: list[Row] = []
    curves: list[Row] = []
    for member in entry.family.members:
        of: Row = [entry.family.path, member.value]
        values += _values([name, entry.solve, entry.unit], member.values, of)
        curves += [[name, *point, *of] for point in member.curve]
    return values, curves


def _margin_tables(results: Results) -> Tables:
    """Values at the probabilities asked for, and the curves; over the energy too where that was asked for."""
    margins = results.margins
    over = {name: entry.against for name, entry in margins.items() if entry.against}
    family = ("family", "family_value") * any(entry.family for entry in margins.values())
    # the curves of the study itself have no value of a family
    blank: Row = [""] * len(family)
    values = [row for n, e in margins.items() for row in _values([n, e.solve, e.unit], e.values, blank)]
    values += [row for n, e in over.items() for row in _values([n, e.quantity, e.unit], e.values, blank)]
    curves: list[Row] = [[name, *point, *blank] for name, entry in margins.items() for point in entry.curve]
    for name, entry in margins.items():
        more = _of_family(name, entry)
        values, curves = values + more[0], curves + more[1]
    curves += [["any", *point, *blank] for point in results.fracture.curve]
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


# --- answers that are vectors -------------------------------------------------------------------------------


#: bytes of a file that is read: rows and intervals of a few fields of 10,000 places
_LARGEST: Final = 1 << 28
_BANDS: Final = ("mean", "quantiles", "first", "total")
_DIMENSIONS: Final = {"mean": (), "quantiles": ("level",), "first": ("input",), "total": ("input",)}


@dataclass(frozen=True, kw_only=True, eq=False)
class Stored:
    """An answer, its places (m,), and the inputs that it has indices of; none where these depend on each other."""

    answer: FieldAnswer
    places: Array
    inputs: tuple[str, ...]


def save_fields(folder: Path, found: Mapping[str, Stored]) -> None:
    """Write both files."""
    (folder / "tables").mkdir(exist_ok=True)
    write_atomically(folder / "fields.nc", as_netcdf(found))
    header = ("field", "place", "statistic", "of", "value", "low", "high")
    write_atomically(folder / "tables" / "fields.csv", csv_text(list(header), _rows(found)))


def _rows(found: Mapping[str, Stored]) -> list[tuple[str | float, ...]]:
    lines: list[tuple[str | float, ...]] = []
    for name, one in found.items():
        for kind in _BANDS:
            for of, value, low, high in _lines(one, kind):
                columns = (one.places.tolist(), value.tolist(), low.tolist(), high.tolist())
                lines += [(name, place, kind, of, *ends) for place, *ends in zip(*columns, strict=True)]
    return lines


def _lines(one: Stored, kind: str) -> list[tuple[str, Array, Array, Array]]:
    """What a band is of, and its three lines (m,) each."""
    band: Band = getattr(one.answer, kind)
    if kind == "mean":
        return [("", band.value, band.low, band.high)]
    names = [f"{level:g}" for level in one.answer.levels] if kind == "quantiles" else list(one.inputs)
    return [(of, band.value[k], band.low[k], band.high[k]) for k, of in enumerate(names)]


def as_netcdf(found: Mapping[str, Stored]) -> bytes:
    """The content of fields.nc."""
    from scipy.io import netcdf_file

    held = io.BytesIO()
    file: Any  # attributes of the file are set as those of the object
    with netcdf_file(held, "w") as file:
        one = next(iter(found.values()))
        file.fields, file.inputs = " ".join(found), " ".join(one.inputs)
        file.createDimension("level", len(one.answer.levels))
        file.createVariable("level", "f8", ("level",))[:] = one.answer.levels
        if one.inputs:
            file.createDimension("input", len(one.inputs))
        for name, stored in found.items():
            place, row, answer = f"{name}_place", f"{name}_row", stored.answer
            file.createDimension(place, len(stored.places))
            file.createDimension(row, len(answer.rows))
            file.createVariable(place, "f8", (place,))[:] = stored.places
            rows = file.createVariable(row, "f8", (row, place))
            rows[:] = answer.rows
            rows.components, rows.truncated, rows.error = answer.components, answer.truncated, answer.error
            for kind in _BANDS if stored.inputs else _BANDS[:2]:
                for end in fields(Band):
                    suffix = "" if end.name == "value" else f"_{end.name}"
                    variable = file.createVariable(f"{name}_{kind}{suffix}", "f8", (*_DIMENSIONS[kind], place))
                    variable[:] = getattr(getattr(answer, kind), end.name)
        file.flush()
        return held.getvalue()


def read_fields(folder: Path) -> dict[str, Stored]:
    """What fields.nc holds, but for aggregated indices, which results.json has; empty where there is none.

    Raises FolderError for a file that is not what a run writes.
    """
    path = folder / "fields.nc"
    if not path.is_file():
        return {}
    from scipy.io import netcdf_file

    file: Any
    try:
        with netcdf_file(io.BytesIO(read_whole(path, _LARGEST)), "r", mmap=False) as file:
            return {name: _read(file, name) for name in file.fields.decode().split()}
    except (ValueError, TypeError, KeyError, AttributeError, IndexError, OverflowError, MemoryError) as error:
        raise FolderError(f"{path} is not what a run writes") from error


def _read(file: Any, name: str) -> Stored:
    def numbers(variable: str) -> Array:
        return np.array(file.variables[variable][:], dtype=float)

    def band(kind: str) -> Band:
        if f"{name}_{kind}" not in file.variables:
            nothing = np.zeros((0, len(places)))
            return Band(value=nothing, low=nothing, high=nothing)
        return Band(value=numbers(f"{name}_{kind}"), low=numbers(f"{name}_{kind}_low"),
                    high=numbers(f"{name}_{kind}_high"))  # fmt: skip

    rows, places = file.variables[f"{name}_row"], numbers(f"{name}_place")
    answer = FieldAnswer(
        rows=numbers(f"{name}_row"), levels=tuple(numbers("level").tolist()),
        mean=band("mean"), quantiles=band("quantiles"), first=band("first"), total=band("total"),
        aggregated_first=[], aggregated_total=[], components=int(rows.components), truncated=float(rows.truncated),
        error=float(rows.error),
    )  # fmt: skip
    return Stored(answer=answer, places=places, inputs=tuple(file.inputs.decode().split()))
