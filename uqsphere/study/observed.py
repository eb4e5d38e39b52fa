"""Distributions of data: weighted values, a column of a file, draws of a fit; and whether the file is plausible."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array, Flags, Places
from uqsphere.errors import AccessError, UsageError
from uqsphere.files import is_device_name
from uqsphere.quantities import INPUTS
from uqsphere.study.document import Discrete, Draft, Observations, declared
from uqsphere.study.fault import Fault, Place, one_of, shown, suggestion, within
from uqsphere.study.number import Number, value_of
from uqsphere.study.study import Tested
from uqsphere.tables import Table, TableError, read_table, unit_in_heading
from uqsphere.units import UNITS, Quantity
from uqsphere.uq import Law, LawError, discrete_law
from uqsphere.uq.fitting import STRENGTHS, fitted_law, law_of_draws, make_tests, probability_of
from uqsphere.uq.observed import LOGNORMAL, WEIBULL

#: fewer observations than these are worth a warning
_FEW: Final = 10
#: keys that a column or tests need, with an example
_EXAMPLES: Final = {"file": "tests.csv", "column": "strength", "force": "F", "diameter": "D"}
#: usual 0.9 P/D² of brittle spheres [Pa]
_TENSION: Final = (2e5, 5e8)
#: units that a file may have been in
_UNITS: Final = ("um", "mm", "cm", "m", "N", "kN", "MN")
#: a row as many robust deviations from the rest of the logarithms is told, and a fit less likely than this
_APART, _UNLIKELY = 5.0, 0.01


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


# --- files ---------------------------------------------------------------------------------------------------------


def inside_folder(name: str, draft: Draft, key: str) -> Path:
    """The file as a real path, links followed; raises Fault at `key` unless it lies in the study's folder."""
    posix = PurePosixPath(name.replace("\\", "/"))
    if ":" in name or posix.is_absolute() or ".." in posix.parts:
        raise Fault(f"found {shown(name)}: a study reads files of its own folder only, by a relative path", key)
    if any(is_device_name(part) for part in posix.parts):
        raise Fault(f"found {shown(name)}: some system takes that for a device; rename the file", key)
    try:
        home = draft.folder.resolve()
        path = (home / name).resolve()
        there, beside = path.exists(), [item.name for item in home.iterdir()] if home.is_dir() else []
    except (OSError, RuntimeError, ValueError):
        raise Fault(f"found {shown(name)}, which cannot be read", key) from None
    if not path.is_relative_to(home):
        raise Fault(f"{shown(name)} is a link that leaves the study's folder", key)
    if not there:
        raise Fault(f"there is no file {shown(name)} beside the study{suggestion(name, beside)}", key)
    draft.files[posix.as_posix()] = path
    return path


@contextmanager
def opened(name: str, draft: Draft, key: str = "file", decimal: str | None = None) -> Iterator[Table]:
    """The table of a file of the study; at the end all faults that were noted of it are raised as one Fault."""
    path = inside_folder(name, draft, key)
    try:
        found = read_table(path, decimal=decimal or "")
        yield found
        found.finish()
    except TableError as fault:
        raise Fault(str(fault), key if key == "draws" else fault.key or key) from None
    except (AccessError, UsageError):
        raise Fault(f"{shown(name)} cannot be read as a file", key) from None


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
        for key in [key for key in ("force", "diameter") if key in columns]:
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


@contextmanager
def _blamed(*keys: str, otherwise: str) -> Iterator[None]:
    """Turns the fault of a law into one at the key that is to blame, if it is one of these."""
    try:
        yield
    except LawError as error:
        raise Fault(error.message, error.key if error.key in keys else otherwise) from None


def modulus_of(law: object) -> float | None:
    """The Weibull modulus of a strength, fitted or known beforehand; None where it has none."""
    if not isinstance(law, Law):
        return None
    kinds = {(draw[0], draw[3]) for draw in law.draws}
    return kinds.pop()[1] if len(kinds) == 1 and law.draws[0][0] == WEIBULL else law.parameters.get("modulus")


# --- whether the numbers of a file are plausible -------------------------------------------------------------------


def warn_of_rows(found: Table, rows: Places, x: Array, stopped: Flags, draft: Draft, place: Place) -> None:
    """Warn of what a file and the scatter of its observations (n,) say, which stand in `rows`.

    Notes of the reader, few tests, rows far from the rest of the logarithms, a shape that no fit has.
    """
    said, failed = list(found.notes), ~stopped & (x > 0.0)
    if failed.sum() >= 6:
        away = np.log(x[failed])
        away = away - np.median(away)
        # a Weibull law's lower tail is exponential in the logarithm: of n rows the lowest lies some ln n away
        reach = 1.4826 * np.median(np.abs(away)) * max(_APART, math.log(len(x)))
        apart = np.flatnonzero(np.abs(away) > reach)
        if reach > 0.0 and 0 < len(apart) <= max(1, len(x) // 10):
            lines = [found.lines[row] for row in rows[failed][apart]]
            far = ", ".join(f"line {line} ({math.exp(a):.3g} times the median)"
                            for line, a in zip(lines[:5], away[apart], strict=False))  # fmt: skip
            said.append(f"{found.name}: {far}: far from the other rows; a slip of the decimal point?")
        with suppress(ValueError):
            tests = make_tests(x, stopped)
            if (p := max(probability_of(tests, law) for law in STRENGTHS.values())) < _UNLIKELY:
                said.append(f"{found.name}: neither a Weibull nor a lognormal distribution fits (p = {p:.2g}): mixed "
                            "or faulty rows?")  # fmt: skip
    if len(x) < _FEW:
        said.append(f"{len(x)} observations: what so few leave open is large; {_FEW} or more are a start")
    for text in said:
        draft.warn((*place, "file"), text)


def warn_of_tests(
    table: Observations, force: Array, diameter: Array, radius: float, draft: Draft, place: Place
) -> None:
    """Warn of forces [N] and diameters [m] that no sphere has, with the unit that would make them usual."""

    def hint(value: float, units: dict[str, float], given: str | None, low: float, high: float) -> str:
        scale = value / units.get(given or "", math.nan)
        likely = [unit for unit in _UNITS if low < scale * units.get(unit, 0.0) < high]
        return f": is the unit {one_of(likely)}?" if likely else ": are the units right?"

    off = diameter / (2.0 * radius)
    far = (off > 3.0) | (off < 1.0 / 3.0)
    typical, (low, high) = float(np.median(0.9 * force / np.square(diameter))), _TENSION
    if far.any():
        unit = hint(float(np.median(off)), UNITS["length"], table.diameter_unit, 0.5, 2.0)
        draft.warn((*place, "diameter"), f"{table.file}: {far.sum()} of {len(off)} diameters are more than three times "
                   f"off the sphere's, the first {1e3 * diameter[int(np.argmax(far))]:.4g} mm{unit}")  # fmt: skip
    elif not low <= typical <= high:
        unit = hint(typical, UNITS["force"], table.force_unit, low, high)
        value = f"{typical / 1e9:.3g} GPa" if typical > 1e9 else f"{typical / 1e6:.3g} MPa"
        draft.warn((*place, "force"), f"0.9 P/D² of {table.file} is {value}, usual are {low / 1e6:g} to {high / 1e6:g} "
                   f"MPa{unit}")  # fmt: skip
