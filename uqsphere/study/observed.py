"""Distributions of data: weighted values, a column of a file, draws of a fit; and whether the file is plausible."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.errors import AccessError, UsageError
from uqsphere.files import is_device_name
from uqsphere.study.document import Discrete, Observations, declared
from uqsphere.study.draft import Draft
from uqsphere.study.fault import Fault, Place, one_of, shown, suggestion, within
from uqsphere.study.number import Number, value_of
from uqsphere.study.study import Tested
from uqsphere.tables import Table, TableError, read_table
from uqsphere.units import UNITS, Quantity
from uqsphere.uq import Law, LawError, discrete_law
from uqsphere.uq.fitting import STRENGTHS, fitted_law, law_of_draws, make_tests, probability_of

#: fewer observations than these are worth a warning
_FEW: Final = 10
#: usual 0.9 P/D² of brittle spheres [Pa]
_TENSION: Final = (2e5, 5e8)
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
        return Number(value=_made(discrete_law, values, weighted.weights, blame=("values", "weights")))
    table = declared(Observations, raw)
    if table.draws is not None:
        return _drawn(table.draws, table, quantity, draft)
    if is_tests(raw):
        raise Fault("forces at failure belong to the strength of a limit of the impact model", "force")
    file, column = required(table, file="tests.csv", column="strength")
    found = open_table(file, draft, "file", table.decimal)
    with noted(found):
        data = found.numbers(column, quantity.dimension, table.unit, key="column")
        stopped, many = flags_and_counts(found, table)
    bounds = [None if end is None else value_of(end, quantity, bounded=False) for end in (table.lower, table.upper)]
    warn_of_rows(found, data, stopped, many, draft, place)
    law = fit(np.repeat(data, many), np.repeat(stopped, many), table, table.fit, *bounds)
    return Number(value=law, synthetic=table.synthetic)


def _drawn(name: str, table: Observations, quantity: Quantity, draft: Draft) -> Number:
    """The mean of the distributions that a fit allows, each a draw of its parameters."""
    from uqsphere.uq.observed import LOGNORMAL, WEIBULL

    found = open_table(name, draft, "draws", table.decimal)
    kinds = {"lognormal": LOGNORMAL, "weibull": WEIBULL}
    heads = [heading.split(" ")[0] for heading in found.headings]

    def numbers(name: str, dimension: str = "number", unit: str | None = None) -> Array:
        needed = name in heads or name in ("scale", "shape")
        return found.numbers(name, dimension, unit, key="draws") if needed else np.zeros(len(found))

    with noted(found, "draws"):
        words = found.texts("distribution", "draws")
        found.refuse("draws", f"distribution: {one_of(kinds)} is required", np.array([w not in kinds for w in words]))
        scale, least = (numbers(name, quantity.dimension, table.unit) for name in ("scale", "least"))
        shape, bound, tests, exponent = (numbers(name) for name in ("shape", "bound", "tests", "size_exponent"))
        size = numbers("diameter", "length")
        wrong = ~((scale > 0.0) & (shape > 0.0) & (least >= 0.0) & (bound >= 0.0) & (bound < 1.0))
        found.refuse("draws", "scale and shape above 0, least from 0, bound from 0 to below 1 are required", wrong)
    kind = np.array([kinds[word] for word in words])
    law = law_of_draws(np.column_stack([kind, least, scale, shape, bound]).tolist(), int(tests[0]))
    tested = Tested(diameter=float(size[0]), exponent=float(exponent.mean())) if size[0] > 0.0 else None
    return Number(value=law, synthetic=table.synthetic, tested=tested)


# --- files ---------------------------------------------------------------------------------------------------------


def inside_folder(name: str, draft: Draft, key: str) -> Path:
    """The file as a real path, links followed; raises Fault at `key` unless it lies in the study's folder."""
    posix = PurePosixPath(name.replace("\\", "/"))
    if not name or len(name) > 255 or "\0" in name or ":" in name or posix.is_absolute() or ".." in posix.parts:
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


def open_table(name: str, draft: Draft, key: str, decimal: str | None = None) -> Table:
    """The table of a file of the study; raises Fault at `key`."""
    path = inside_folder(name, draft, key)
    try:
        return read_table(path, decimal=decimal or "")
    except TableError as error:
        raise Fault(str(error), key) from None
    except (AccessError, UsageError):
        raise Fault(f"{shown(name)} cannot be read as a file", key) from None


@contextmanager
def noted(table: Table, key: str = "file") -> Iterator[None]:
    """Turns the faults of a table into one Fault, all that were noted inside together."""
    try:
        yield
        table.finish()
    except TableError as fault:
        raise Fault(str(fault), key if key == "draws" else fault.key or key) from None


def required(table: Observations, **examples: str) -> list[str]:
    """Some keys of a table; raises Fault, with an example, for the first that it lacks."""
    for key, example in examples.items():
        if getattr(table, key) is None:
            raise Fault(f'{key} is missing: add {key} = "{example}"')
    return [getattr(table, key) for key in examples]


def flags_and_counts(found: Table, table: Observations) -> tuple[Flags, Any]:
    """Which rows are tests that were stopped, and how many equal tests each row stands for."""
    n = len(found)
    stopped = np.zeros(n, dtype=bool)
    if table.censored is not None:
        stopped = found.flags(table.censored, "censored", meant="0 or 1 (1: stopped)")
    many = np.ones(n) if table.count is None else found.numbers(table.count, key="count")
    found.refuse("count", "counts are whole numbers from 1 on", (many < 1.0) | (many % 1.0 != 0.0))
    found.refuse("count", "more than two million tests", np.cumsum(many) > 2e6)
    return stopped, np.where(np.isfinite(many), many, 1.0).clip(1.0, 2e6).astype(int)


def fit(data: Array, stopped: Flags, table: Observations, kind: str | None, lower: float | None = None,
        upper: float | None = None, *, slope: float = 1.0) -> Law:  # fmt: skip
    """The law of some observations; raises Fault.  `slope`: they are forces to this power, which have the modulus."""
    modulus = None if table.modulus is None else table.modulus / slope
    if modulus is None and (len(data) < 2 or stopped.all()):
        said = f"all {len(data)} tests were stopped" if len(data) > 1 else f"found {len(data)} observation"
        raise Fault(f"{said}: two failures or more are required, or a known Weibull modulus: modulus = …", "file")
    return _made(fitted_law, data[~stopped].tolist(), kind, lower, upper, censored=data[stopped].tolist(),
                 unbiased=table.unbiased, modulus=modulus, blame=("fit", "lower", "upper"),
                 otherwise="file")  # fmt: skip


def _made(make: Callable[..., Law], *given: Any, blame: tuple[str, ...], otherwise: str = "", **more: Any) -> Law:
    """A law; raises Fault at the key that is to blame, if it is one of these."""
    try:
        return make(*given, **more)
    except LawError as error:
        raise Fault(error.message, error.key if error.key in blame else otherwise) from None


def modulus_of(law: object) -> float | None:
    """The Weibull modulus of a strength, fitted or known beforehand; None where it has none."""
    if not isinstance(law, Law):
        return None
    drawn = {(draw[0], draw[3]) for draw in law.draws} if law.family.name == "draws" else ()
    return next(iter(drawn))[1] if len(drawn) == 1 and law.draws[0][0] else law.parameters.get("modulus")


# --- whether the numbers of a file are plausible -------------------------------------------------------------------


def warn_of_rows(found: Table, data: Array, stopped: Flags, many: Any, draft: Draft, place: Place) -> None:
    """Warn of what the file itself and its scatter say: notes of the reader, few tests, rows apart, an unlikely fit."""
    said = [*found.notes, *(f"{found.name}: {odd}" for odd in _unusual_rows(data, stopped, many, found.lines))]
    if many.sum() < _FEW:
        said.append(f"{many.sum()} observations: what so few leave open is large; {_FEW} or more are a start")
    for text in said:
        draft.warn((*place, "file"), text)


def _unusual_rows(data: Array, stopped: Flags, many: Array, lines: list[int]) -> Iterator[str]:
    """What is odd about observations (n,): rows far from the rest of the logarithms, a shape that no fit has."""
    x = np.log(np.where(data > 0.0, data, 1.0))
    if (~stopped & (data > 0.0)).sum() < 6:
        return
    middle = np.median(x[~stopped])
    deviation = 1.4826 * np.median(np.abs(x[~stopped] - middle))
    # a Weibull law's lower tail is exponential in the logarithm: of n rows the lowest lies some ln n away
    apart = np.flatnonzero(~stopped & (np.abs(x - middle) > max(_APART, math.log(len(x))) * deviation))
    if deviation > 0.0 and 0 < len(apart) <= max(1, len(data) // 10):
        rows = ", ".join(f"line {lines[k]} ({math.exp(x[k] - middle):.3g} times the median)" for k in apart[:5])
        yield f"{rows}: far from the other rows; a slip of the decimal point?"
    try:
        tests = make_tests(data, stopped, many)
    except ValueError:
        return
    p = max(probability_of(tests, law) for law in STRENGTHS.values())
    if p < _UNLIKELY:
        yield f"neither a Weibull nor a lognormal distribution fits (p = {p:.2g}): mixed or faulty rows?"


def warn_of_tests(
    table: Observations, force: Array, diameter: Array, radius: float, draft: Draft, place: Place
) -> None:
    """Warn of forces [N] and diameters [m] that no sphere has, with the unit that would make them usual."""

    def usual(dimension: str, given: str | None, units: str, low: float, value: float, high: float) -> str:
        """A hint at the units by which a value would lie between two others."""
        scale = value / UNITS[dimension].get(given or "", math.nan)
        likely = [u for u in units.split() if u != given and low < scale * UNITS[dimension][u] < high]
        return f": is the unit {one_of(likely)}?" if likely else ""

    off = diameter / (2.0 * radius)
    far = (off > 3.0) | (off < 1.0 / 3.0)
    if far.any():
        hint = usual("length", table.diameter_unit, "um mm cm m", 0.5, float(np.median(off)), 2.0)
        draft.warn((*place, "diameter"), f"{table.file}: {far.sum()} of {len(off)} diameters are more than three times "
                   f"off the sphere's, the first {1e3 * diameter[int(np.argmax(far))]:.4g} mm{hint}")  # fmt: skip
    typical, (low, high) = float(np.median(0.9 * force / np.square(diameter))), _TENSION
    if not low <= typical <= high:
        hint = "" if far.all() else usual("force", table.force_unit, "N kN MN", low, typical, high)
        value = f"{typical / 1e9:.3g} GPa" if typical > 1e9 else f"{typical / 1e6:.3g} MPa"
        draft.warn((*place, "force"), f"0.9 P/D² of {table.file} is {value}, usual are {low / 1e6:g} to {high / 1e6:g} "
                   f"MPa{hint or ': are the units right?'}")  # fmt: skip
