"""What a study takes from files beside it: distributions of columns and draws, and a measured pulse."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array, Flags, Places
from uqsphere.documents import Fault, Place, declared, one_of, shown, suggestion, within
from uqsphere.errors import AccessError, UsageError
from uqsphere.mechanics.pulses import MeasuredPulse, measured_pulse
from uqsphere.quantities import INPUTS
from uqsphere.study.document import Discrete, Draft, Observations, Pulse
from uqsphere.study.number import Number, value_of
from uqsphere.study.study import Tested
from uqsphere.tables import Table, TableError, read_table, unit_in_heading
from uqsphere.units import UNITS, Quantity
from uqsphere.uq import Law, LawError, discrete_law
from uqsphere.uq.fitting import STRENGTHS, fitted_law, law_of_draws, make_tests, outliers, probability_of
from uqsphere.uq.observed import LOGNORMAL, WEIBULL

#: fewer observations than these are worth a warning
_FEW: Final = 10
#: keys that a column or tests need, with an example
_EXAMPLES: Final = {"file": "tests.csv", "column": "strength", "force": "F", "diameter": "D"}
#: a fit less likely than this is worth a warning
_UNLIKELY: Final = 0.01


@contextmanager
def opened(name: str, draft: Draft, key: str = "file", decimal: str | None = None) -> Iterator[Table]:
    """The table of a file in the study's folder; at the end all faults that were noted of it are one Fault."""
    home, given = draft.folder.resolve(), Path(name)
    try:
        path = (home / given).resolve()
        if given.drive or given.root or ".." in given.parts or not path.is_relative_to(home):
            raise Fault(f"found {shown(name)}: a study reads files of its own folder only, by a relative path", key)
        if not path.exists():
            near = suggestion(name, [item.name for item in home.iterdir()])
            raise Fault(f"there is no file {shown(name)} beside the study{near}", key)
        draft.files[given.as_posix()] = path
        found = read_table(path, decimal=decimal or "")
        yield found
        found.finish()
    except TableError as fault:
        raise Fault(str(fault), key if key == "draws" else fault.key or key) from None
    except Fault:
        raise
    except (AccessError, UsageError, OSError, RuntimeError, ValueError):
        raise Fault(f"{shown(name)} cannot be read as a file", key) from None


@contextmanager
def _blamed(*keys: str, otherwise: str) -> Iterator[None]:
    """Turns the fault of a law into one at the key that is to blame, if it is one of these."""
    try:
        yield
    except LawError as error:
        raise Fault(error.message, error.key if error.key in keys else otherwise) from None


# --- distributions -------------------------------------------------------------------------------------------------


def is_tests(raw: Any) -> bool:
    """Whether a strength is written as forces at which spheres broke."""
    return isinstance(raw, Mapping) and ("force" in raw or "diameter" in raw) and not {"column", "draws"} & set(raw)


def law_of_data(raw: Mapping[str, Any], quantity: Quantity, draft: Draft, place: Place) -> Number:
    """The distribution of weighted values, of a column, or of draws; raises Fault."""
    if raw.get("dist") == "discrete":
        if place[0] == "limits":
            raise Fault("a strength has a density, or is a column of observations: discrete is for inputs", "dist")
        weighted = declared(Discrete, raw)
        with within("values"):
            values = [value_of(one, quantity) for one in weighted.values]
        with _blamed("values", "weights", otherwise=""):
            return Number(value=discrete_law(values, weighted.weights))
    table = declared(Observations, raw)
    if table.draws is not None:
        return _drawn(table.draws, table, quantity, draft)
    if is_tests(raw):
        raise Fault("forces at failure belong to the strength of a limit of the impact model", "force")
    found, rows, columns, stopped = observations(table, draft, column=quantity.dimension)
    bounds = [None if end is None else value_of(end, quantity, bounded=False) for end in (table.lower, table.upper)]
    warn_of_rows(found, rows, columns["column"], stopped, draft, place)
    law = fit(columns["column"], stopped, table, table.fit, *bounds)
    return Number(value=law, synthetic=table.synthetic)


def _drawn(name: str, table: Observations, quantity: Quantity, draft: Draft) -> Number:
    """The mean of the distributions that a fit allows, each a draw of its parameters."""
    kinds, columns = {"lognormal": LOGNORMAL, "weibull": WEIBULL}, {}
    dimensions = {"scale": quantity.dimension, "least": quantity.dimension, "diameter": "length"}
    with opened(name, draft, "draws", table.decimal) as found:
        words = found.texts("distribution", "draws")
        found.refuse("draws", f"distribution: {one_of(kinds)} is required", np.array([w not in kinds for w in words]))
        for key in ("least", "scale", "shape", "bound", "tests", "diameter", "size_exponent"):
            dimension = dimensions.get(key, "number")
            needed = key in ("scale", "shape") or any(unit_in_heading(h, dimension)[0] == key for h in found.headings)
            unit = table.unit if dimension == quantity.dimension else None
            columns[key] = found.numbers(key, dimension, unit, key="draws") if needed else np.zeros(len(found))
        least, scale, shape, bound, tests, size, exponent = columns.values()
        wrong = ~((scale > 0.0) & (shape > 0.0) & (least >= 0.0) & (bound >= 0.0) & (bound < 1.0))
        found.refuse("draws", "scale and shape above 0, least from 0, bound from 0 to below 1 are required", wrong)
    draws = np.column_stack([[kinds[word] for word in words], least, scale, shape, bound])
    tested = Tested(diameter=float(size[0]), exponent=float(exponent.mean())) if size[0] > 0.0 else None
    return Number(value=law_of_draws(draws.tolist(), int(tests[0])), synthetic=table.synthetic, tested=tested)


def observations(table: Observations, draft: Draft, **dimensions: str) -> tuple[Table, Places, dict[str, Array], Flags]:
    """Tests of a file by the keys that name its columns: the table, the row of each test, columns and stops (n,).

    A row is as many tests as its count says; a key that the table lacks has no column.  Raises Fault.
    """
    for key in ("file", *dimensions):
        if getattr(table, key) is None and key in _EXAMPLES:
            raise Fault(f'{key} is missing: add {key} = "{_EXAMPLES[key]}"')
    columns = {}
    with opened(str(table.file), draft, decimal=table.decimal) as found:
        for key, dimension in dimensions.items():
            name, unit = getattr(table, key), getattr(table, "unit" if key == "column" else f"{key}_unit", None)
            if key == "diameter" and name[:1].isdigit():
                columns[key] = np.full(len(found), value_of(name, INPUTS["bars.diameter"]))
            elif name is not None:
                columns[key] = found.numbers(name, dimension, unit, key=key)
        stopped = np.zeros(len(found), dtype=bool)
        if table.censored is not None:
            stopped = found.flags(table.censored, "censored", meant="0 or 1 (1: stopped)")
        many = np.ones(len(found)) if table.count is None else found.numbers(table.count, key="count")
        found.refuse("count", "counts are whole numbers from 1 on", (many < 1.0) | (many % 1.0 > 0.0))
        found.refuse("count", "more than two million tests", np.cumsum(many) > 2e6)
        for key in columns.keys() & {"force", "diameter"}:
            found.refuse(key, f"the {key} must be above 0", columns[key] <= 0.0)
    rows = np.repeat(np.arange(len(found)), many.astype(int))
    return found, rows, {key: column[rows] for key, column in columns.items()}, stopped[rows]


def fit(data: Array, stopped: Flags, table: Observations, kind: str | None, lower: float | None = None,
        upper: float | None = None, *, slope: float = 1.0) -> Law:  # fmt: skip
    """The law of some observations; raises Fault.  `slope`: they are forces to this power, which have the modulus."""
    modulus = None if table.modulus is None else table.modulus / slope
    if modulus is None and (len(data) < 2 or stopped.all()):
        said = f"all {len(data)} tests were stopped" if len(data) > 1 else f"found {len(data)} observation"
        raise Fault(f"{said}: two failures or more are required, or a known Weibull modulus: modulus = …", "file")
    with _blamed("fit", "lower", "upper", otherwise="file"):
        return fitted_law(data[~stopped].tolist(), kind, lower, upper, censored=data[stopped].tolist(),
                          unbiased=table.unbiased, modulus=modulus)  # fmt: skip


def warn_of_rows(found: Table, rows: Places, x: Array, stopped: Flags, draft: Draft, place: Place) -> None:
    """Warn of what the reader notes, of few observations (n,) that stand in `rows`, outliers, a shape of no fit."""
    said = list(found.notes)
    if far := outliers(x, ~stopped):
        lines = [f"line {found.lines[rows[k]]} ({ratio:.3g} times the median)" for k, ratio in [*far.items()][:5]]
        said.append(f"{found.name}: {', '.join(lines)}: far from the other rows; a slip of the decimal point?")
    if (~stopped).sum() >= 6:
        with suppress(ValueError):
            tests = make_tests(x, stopped)
            if (p := max(probability_of(tests, law) for law in STRENGTHS.values())) < _UNLIKELY:
                said.append(f"{found.name}: neither a Weibull nor a lognormal distribution fits (p = {p:.2g}): mixed "
                            "or faulty rows?")  # fmt: skip
    if len(x) < _FEW:
        said.append(f"{len(x)} observations: what so few leave open is large; {_FEW} or more are a start")
    for text in said:
        draft.warn((*place, "file"), text)


# --- the pulse of a clean record ------------------------------------------------------------------------------------

_MENDED: Final = "uqsphere shpb records cuts, mends and writes such a file"


def pulse_of(table: Pulse, draft: Draft) -> MeasuredPulse:
    """The pulse of a file of time and strain, or volts with a factor; raises Fault.  Mending is the lab's."""
    with opened(str(table.file), draft) as found:
        columns = table.columns or tuple(found.headings[:2])
        if len(columns) != 2:
            raise Fault(f"found {len(columns)} column: time, then strain or volts are required", "columns")
        time_unit, unit = table.units or (None, None)
        volts = unit in UNITS["voltage"] or (unit is None and found.unit_of(columns[1], "voltage") is not None)
        time = found.numbers(columns[0], "time", time_unit)
        strain = (table.factor or 1.0) * found.numbers(columns[1], "voltage" if volts else "strain", unit)
        found.refuse("", "the time must rise from row to row", np.diff(time, prepend=-np.inf) <= 0.0)
    if volts and table.factor is None:
        raise Fault("factor is missing: the strain of one volt, such as factor = 1e-3", "factor")
    notes = list(found.notes)
    if -strain.min() > strain.max():
        strain = -strain
        notes.append("the largest strain is negative: compression is taken as positive")
    try:
        pulse, misfit = measured_pulse(time, strain)
    except ValueError as error:
        raise Fault(f"{error}; {_MENDED}", "file") from None
    if misfit > 0.02:
        said = f"its cubics leave {misfit:.2g} of the peak: sharp edges are rounded, or the record is noisy"
        notes.append(f"{said}; {_MENDED}")
    for note in notes:
        draft.warn(("pulse", "file"), f"{shown(table.file)}: {note}")
    return pulse
