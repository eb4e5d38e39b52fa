"""A number of a study in SI: a fixed value, a distribution that a table describes, or what a file
beside it tells.

Such a file has a column of observations, crushing tests, draws of a fit, or the pulse of a record.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import field, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from uqsphere.arrays import Array, Duo, Flags, Places, frozen
from uqsphere.documents import (
    WORDS,
    Fault,
    TomlTable,
    declared,
    one_of,
    suggestion,
    unknown,
    within,
)
from uqsphere.errors import UqsphereError
from uqsphere.mechanics.bars import END_COEFFICIENTS
from uqsphere.mechanics.pulses import MeasuredPulse, measured_pulse
from uqsphere.quantities import INPUTS, format_bounds, format_value, plain_quantity
from uqsphere.tables import Table, read_table, unit_in_heading
from uqsphere.units import UNITS, Quantity, likely_unit, parse_value, shown
from uqsphere.uq import Law, LawError, discrete_law, make_law
from uqsphere.uq.families import DIMENSIONAL, FAMILIES, family_named
from uqsphere.uq.fitting import (
    MOST_TESTS,
    STRENGTHS,
    fitted_law,
    law_of_draws,
    law_of_known_modulus,
    make_tests,
    outliers,
)
from uqsphere.uq.forms import LOGNORMAL, WEIBULL

if TYPE_CHECKING:
    from .document import PulseTable
    from .study import Draft

#: what tests of spheres have
TESTS = {
    "force": Quantity(name="force", dimension="force", meaning="the force"),
    "diameter": Quantity(name="diameter", dimension="length", display="mm", meaning="the diameter"),
    "rate": Quantity(name="rate", dimension="loading_rate", meaning="the rate", closed=True),
}
#: a share of a law outside what has a meaning that is worth a warning
NOTABLE = 1e-6
#: fewer observations than these are worth a warning
_FEW = 10
#: keys that a column or tests need, with an example
_EXAMPLES = {"file": "tests.csv", "column": "strength", "force": "F", "diameter": "D"}
#: a fit less likely than this is worth a warning
_UNLIKELY = 0.01

#: ratio of the diameters of tests and sphere beyond which no law of size was tested
FARTHEST_SIZE = 1.5


@frozen
class Tested:
    """Crushing tests of spheres behind a strength: what was measured, and the law of the force at
    failure.

    diameter: the mean one [m], to which `law` belongs.  forces [N], diameters [m]: of every test.
    platens: E [Pa], infinite if rigid, and nu.  sphere: as `uqsphere.mechanics.crushing` takes it.
    law: of the force at failure of a sphere of `diameter`.  exponent: that force goes with the
    diameter to this power.  The draws of a lab have a diameter and an exponent, and the smallest
    and largest of the tested diameters.
    """

    diameter: float
    forces: tuple[float, ...] = ()
    diameters: tuple[float, ...]
    platens: Duo = (math.inf, 0.3)
    sphere: Mapping[str, float] = field(default_factory=dict)
    law: Law | None = None
    exponent: float

    def beyond(self, diameter: float) -> float:
        """Ratio, at least 1, of a diameter [m] to the nearest size that was tested."""
        sizes = self.diameters or (self.diameter,)
        return max(diameter / max(sizes), min(sizes) / diameter, 1.0)


def mean_of(value: Law | float) -> float:
    """A number, or the mean of its law before truncation."""
    return value.nominal_mean() if isinstance(value, Law) else float(value)


@frozen
class Number:
    """A number in SI: value or law, whether its data are synthetic, tests behind it."""

    value: float | Law
    synthetic: bool = False
    tested: Tested | None = None

    @property
    def mean(self) -> float:
        """The value, or the mean of its law."""
        return mean_of(self.value)


@cache
def numbers_of(table: str) -> dict[str, Quantity]:
    """The numbers that a table of a scene can have, by their keys; those of inserts stand among
    those of the bars.
    """
    start = {"insert": "bars.insert_"}.get(table, f"{table}.")
    return {
        name.removeprefix(start): entry
        for name, entry in INPUTS.items()
        if name.startswith(start) and not name.startswith(f"{start}insert_")
    }


def value_of(raw: object, quantity: Quantity, *, bounded: bool = True) -> float:
    """SI value of a fixed number; raises Fault where it is none, or outside the bounds of its
    meaning.
    """
    if isinstance(raw, str) and quantity.name.endswith(("_end", ".end")):
        if raw not in END_COEFFICIENTS:
            raise Fault(unknown("end", raw, [*END_COEFFICIENTS, "a number from -1 to 1"]))
        return END_COEFFICIENTS[raw]
    value = parse_value(raw, quantity.dimension, likely_unit(raw, quantity))
    if bounded and not quantity.allows(value):
        raise Fault(f"{format_bounds(quantity)}, not {shown(raw)}")
    return value


def number_of(raw: object, quantity: Quantity, draft: "Draft") -> Number:
    """Value or law of what a file has; warns of what is unusual, and raises Fault."""
    if not isinstance(raw, Mapping):
        number = Number(value=value_of(raw, quantity))
    elif "file" in raw or "draws" in raw or raw.get("dist") in ("empirical", "discrete"):
        number = _law_of_data(raw, quantity, draft)
    else:
        number = _member(raw, quantity)
    warn_unusual(number.mean, quantity, draft)
    if isinstance(number.value, Law):
        _check_law(number.value, quantity, draft)
    return number


def warn_unusual(value: float, quantity: Quantity, draft: "Draft") -> None:
    """Warn of a value (SI) outside the usual range of its quantity."""
    if not quantity.plausible[0] <= value <= quantity.plausible[1]:
        text, low, high = (format_value(v, quantity.name) for v in (value, *quantity.plausible))
        draft.warn(f"{text} is unusual (usual: {low} to {high}). Is the unit right?", holds="unit")


def _member(raw: Mapping[str, Any], quantity: Quantity) -> Number:
    """The law of a table with `dist`, and its parameters in SI; raises Fault."""
    kind = raw.get("dist")
    if kind is None:
        raise Fault(
            'a table of a number needs a distribution or a file. Add, for example, dist = "normal"'
            f" (known: {one_of(FAMILIES)}){suggestion(next(iter(raw), ''), ['dist'])}"
        )
    family = family_named(str(kind))
    if not family:
        near = suggestion(WORDS["synonyms"].get(str(kind), ""), FAMILIES)
        raise Fault(f"{unknown('distribution', kind, FAMILIES)}{near}", "dist")
    keys = (*family.keys, "lower", "upper")
    for key in raw:
        if key not in ("dist", *keys):
            raise Fault(
                f"{shown(key)} is not a parameter of the distribution {family.name}, which takes "
                f"{one_of(keys)}{suggestion(WORDS['synonyms'].get(key, key), keys)}",
                key,
            )
    parameters = {}
    for key in keys:
        if key not in raw:
            continue
        entry = quantity if key in DIMENSIONAL else plain_quantity(quantity.name)
        if key not in ("mean", "mode", "lower", "upper") and entry.dimension != "number":
            entry = replace(entry, plausible=(0.0, math.inf))
        with within(key):
            parameters[key] = value_of(raw[key], entry, bounded=False)
    bounds = parameters.pop("lower", None), parameters.pop("upper", None)
    try:
        return Number(value=make_law(family.name, parameters, *bounds))
    except LawError as error:
        message = str(error)
        if quantity.unit and error.key in ("", *DIMENSIONAL):
            message += f" (numbers in {quantity.unit})"
        raise Fault(message, *raw.keys() & {error.key}) from None


def _check_law(law: Law, quantity: Quantity, draft: "Draft") -> None:
    """Refuse a law outside what has a meaning; warn of wide ones, of those cut off, and of tails
    without a meaning.
    """
    name = quantity.name
    centre = law.nominal_mean()
    ends = {"lower": law.lower, "upper": law.upper}
    if not quantity.allows(centre):
        raise Fault(
            f"the mean of the distribution is {format_value(centre, name)}, but "
            f"{format_bounds(quantity)}"
        )
    for key, end in ends.items():
        if law.family.bounded and not quantity.lower <= end <= quantity.upper:
            raise Fault(f"{format_bounds(quantity)}, not {format_value(end, name)}", key)
    cov = law.given.get("cov", 0.0)
    if law.mean():
        cov = max(law.sd() / abs(law.mean()), cov)
    if cov > 1.0:
        text = f"the coefficient of variation is {cov:.3g}. Is that intended?"
        if "cov" in law.given:
            text += ' Write 15 % as "15 %" or 0.15'
        draft.warn(text)
    mean = law.given.get("mean")
    if mean is not None and not law.lower <= mean <= law.upper:
        key, side = ("lower", "below") if mean < law.lower else ("upper", "above")
        draft.warn(
            f"the mean {format_value(mean, name)} lies {side} the bound "
            f"{format_value(ends[key], name)}: only a tail of the distribution is sampled",
            key,
        )
    low = quantity.lower
    if quantity.closed:
        low = np.nextafter(low, -np.inf)
    outside = law.cdf(low) + law.sf(quantity.upper)
    if outside > NOTABLE:
        effect = ""
        if name in INPUTS:
            effect = "These samples count as failed model runs. "
        draft.warn(
            f"{100.0 * outside:.2g} % of the distribution lies outside the valid range "
            f"({format_bounds(quantity)}). {effect}Truncate it with lower or upper"
        )


# --- tables of data -------------------------------------------------------------------------------


def fraction(raw: Any) -> float:
    """A fraction between 0 and 1, plain or in percent; raises Fault."""
    value = value_of(raw, plain_quantity("share"))
    if 0.0 < value < 1.0:
        return value
    hint = ""
    if 1.0 <= value < 100.0 and "%" not in str(raw):
        hint = f'; did you mean "{value:g} %"?'
    raise Fault(
        f'must be a fraction above 0 and below 1, such as 0.02 or "2 %", not {shown(raw)}{hint}'
    )


def percent(raw: Any) -> Any:
    if isinstance(raw, str) and raw.rstrip().endswith("%"):
        return value_of(raw, plain_quantity("share"))
    return raw


_Above = Annotated[float, Field(gt=0.0)]
#: a number above zero, or a percentage of such
Positive = Annotated[_Above, BeforeValidator(percent, json_schema_input_type=_Above | str)]


class Discrete(TomlTable):
    """A distribution of some values, each by its weight."""

    dist: Literal["discrete"]
    values: list[Any]
    weights: list[float] | None = None


#: keys that go with draws, forces of tests, and a column
_TAKEN = {
    "draws": "unit",
    "column": "file unit censored count modulus fit unbiased lower upper",
    "force": (
        "file force_unit diameter diameter_unit rate platens censored count modulus fit unbiased"
    ),
}


class Observations(TomlTable):
    """A distribution from a file beside the study: a column, crushing tests of spheres, or the
    draws of a fit.
    """

    dist: Literal["empirical"] | None = None
    """may be omitted with a file"""
    file: str | None = None
    """CSV or .xlsx beside the study"""
    draws: str | None = None
    """alternative to `file`: posterior samples of a fit with the columns `distribution` (lognormal
    or weibull), `scale`, `shape`; optional: `least` (smallest possible strength), `bound` (median
    over the largest possible strength; 0: no largest), `tests` (their number), `diameter`,
    `size_exponent`, and the `smallest` and `largest` diameter tested"""
    sheet: str | None = None
    """sheet of a workbook (default: the first that is not empty)"""
    decimal: Literal[".", ","] | None = None
    """decimal mark, if a column can be read both ways"""
    column: str | None = None
    """column of observations of the quantity"""
    unit: str | None = None
    """its unit, if the heading has none"""
    force: str | None = None
    """alternative to `column`: forces at which spheres broke between platens"""
    force_unit: str | None = None
    """unit of the forces, if the heading has none"""
    diameter: str | None = None
    """required with `force`: column of diameters, or one length"""
    diameter_unit: str | None = None
    """unit of the diameters, if the heading has none"""
    rate: str | None = None
    """column of loading rates, with the unit in the heading"""
    platens: Any = "bars"
    """platens of the tests: `"bars"`, `"rigid"`, a material, or `E` and `nu`"""
    censored: str | None = None
    """column of flags: 1 for a test stopped before failure (right-censored)"""
    count: str | None = None
    """column with the number of equal tests (default: one per row)"""
    modulus: Annotated[Positive, Field(ge=0.1, le=1e3)] | None = None
    """known Weibull modulus; then few failures, or none, suffice"""
    fit: str | None = None
    """`kde`, `steps`, `weibull`, `lognormal`, `normal`, `frechet`, `gumbel`, `exponential`,
    `rayleigh`, `gamma` or `beta` (default: `weibull` of forces, else `kde`)"""
    unbiased: bool = False
    """correct the bias of few tests: in a Weibull modulus, in the scatter of a lognormal fit"""
    synthetic: bool = False
    """synthetic data, which cannot establish a verdict"""
    lower: Any = None
    upper: Any = None

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        kind = "column"
        if self.draws is not None:
            kind = "draws"
        elif self.column is None and (self.force or self.diameter):
            kind = "force"
        usable = {"dist", "decimal", "sheet", "synthetic", kind, *_TAKEN[kind].split()}
        for key in sorted(self.model_fields_set - usable):
            raise Fault(f"{key} is not used with {kind} = …. Remove one of them", key)
        return self


@contextmanager
def opened(table: Any, draft: "Draft", key: str = "file") -> Iterator[Table]:
    """The cells of a file in the study's folder that a key of a table names; at the end all faults
    that were noted of it are one Fault.
    """
    name = str(getattr(table, key))
    home = draft.folder.resolve()
    relative = Path(name)
    if not name.isprintable():
        raise Fault(
            f"the file name {json.dumps(name)[:80]} has a control character: \\t in double quotes "
            "is a tab. Write / in place of \\",
            key,
        )
    try:
        path = (home / relative).resolve()
        if relative.anchor or ".." in relative.parts:
            raise Fault(
                f"{key} must be a relative path inside the study's folder, not {shown(name)}", key
            )
        if not path.is_relative_to(home):
            raise Fault(
                f"{shown(name)} is a link to a file outside the study's folder. Copy the file", key
            )
        if not path.exists():
            near = suggestion(name, [item.name for item in home.glob("*") if item.exists()])
            raise Fault(f"there is no file {shown(name)} beside the study{near}", key)
        draft.files[relative.as_posix()] = path
        decimal = getattr(table, "decimal", None)
        cells = read_table(path, decimal=decimal or "", sheet=table.sheet or "")
        yield cells
        cells.finish()
    except Fault as fault:
        raise Fault(str(fault), fault.key or key) from None
    except (UqsphereError, OSError, RuntimeError, ValueError) as error:
        reason = str(error).rpartition(": ")[2]
        raise Fault(f"{shown(name)} cannot be read as a file: {reason}", key) from None


# --- distributions --------------------------------------------------------------------------------


def is_tests(raw: Any) -> bool:
    """Whether a strength is written as forces at which spheres broke."""
    return (
        isinstance(raw, Mapping)
        and ("force" in raw or "diameter" in raw)
        and not {"column", "draws"} & set(raw)
    )


def _law_of_data(raw: Mapping[str, Any], quantity: Quantity, draft: "Draft") -> Number:
    """The distribution of weighted values, of a column, or of draws; raises Fault."""
    if raw.get("dist") == "discrete":
        if draft.place.startswith("limits."):
            raise Fault(
                "a strength or a model factor needs a density or a column of observations; "
                "discrete is for inputs",
                "dist",
            )
        weighted = declared(Discrete, raw)
        with within("values"):
            values = [value_of(value, quantity) for value in weighted.values]
        return Number(value=discrete_law(values, weighted.weights))
    table = declared(Observations, raw)
    if table.draws is not None:
        return _drawn(table, quantity, draft)
    if is_tests(raw):
        raise Fault(
            "forces at failure are used only for the strength of a limit of the impact model",
            "force",
        )
    cells, lines, columns, stopped = observations(table, draft, column=quantity)
    bounds = [
        None if end is None else value_of(end, quantity, bounded=False)
        for end in (table.lower, table.upper)
    ]
    warn_of_rows(table, cells, lines, columns["column"], stopped, draft)
    return Number(value=fit(columns["column"], stopped, table, bounds), synthetic=table.synthetic)


#: distributions of draws: whether each is a Weibull distribution
_KINDS = {"lognormal": False, "weibull": True}
#: columns of draws and their dimensions; an empty one is that of the strength
_DRAWN = {
    "least": "",
    "scale": "",
    "shape": "number",
    "bound": "number",
    "tests": "number",
    "synthetic": "number",
    "size_exponent": "number",
    "diameter": "length",
    "smallest": "length",
    "largest": "length",
}


def _drawn(table: Observations, quantity: Quantity, draft: "Draft") -> Number:
    """The mean of the distributions that a fit allows, each a draw of its parameters."""
    columns = {}
    with opened(table, draft, "draws") as cells:
        kinds = cells.flags("distribution", "draws", one_of(_KINDS), _KINDS)
        for key, its_dimension in _DRAWN.items():
            dimension = its_dimension or quantity.dimension
            bare = [unit_in_heading(heading, dimension)[0] for heading in cells.headings]
            columns[key] = np.zeros(len(cells))
            if key in ("scale", "shape", *bare):
                unit = None if its_dimension else table.unit
                columns[key] = cells.numbers(key, dimension, unit, key="draws")
        least, scale, shape, bound, *_ = columns.values()
        cells.refuse(
            "draws",
            "scale and shape must be above 0, least at least 0, bound at least 0 and below 1",
            ~((scale > 0.0) & (shape > 0.0) & (least >= 0.0) & (bound >= 0.0) & (bound < 1.0)),
        )
    draws = np.column_stack([np.where(kinds, WEIBULL, LOGNORMAL), least, scale, shape, bound])
    tested = None
    first = {key: float(column[0]) for key, column in columns.items()}
    if first["diameter"] > 0.0:
        sizes = first["smallest"], first["largest"]
        tested = Tested(
            diameter=first["diameter"],
            exponent=float(columns["size_exponent"].mean()),
            diameters=sizes if 0.0 < sizes[0] <= sizes[1] else (),
        )
    return Number(
        value=law_of_draws(draws.tolist(), int(first["tests"])),
        synthetic=table.synthetic or first["synthetic"] > 0.0,
        tested=tested,
    )


def observations(
    table: Observations, draft: "Draft", **asked: Quantity
) -> tuple[Table, Places, dict[str, Array], Flags]:
    """Tests of a file by the keys that name its columns: the table, the line of each test, columns
    and stops (n,).

    A row is as many tests as its count says; a key that the table lacks has no column.  Raises
    Fault.
    """
    for key in ("file", *asked):
        if getattr(table, key) is None and key in _EXAMPLES:
            raise Fault(f'{key} is missing. Add it, for example {key} = "{_EXAMPLES[key]}"')
    columns = {}
    with opened(table, draft) as cells:
        for key, quantity in asked.items():
            name = getattr(table, key)
            unit = getattr(table, f"{key}_unit", table.unit)
            if key == "diameter" and name[:1].isdigit():
                with within(key):
                    columns[key] = np.full(len(cells), value_of(name, quantity))
            elif name is not None:
                values = columns[key] = cells.numbers(name, quantity.dimension, unit, key=key)
                wrong = ~(quantity.allows(values) | np.isnan(values))
                cells.refuse(key, format_bounds(quantity), wrong)
        stopped = np.zeros(len(cells), bool)
        many = np.ones(len(cells))
        if table.censored is not None:
            stopped = cells.flags(table.censored, "censored", "0 or 1 (1: stopped)")
        if table.count is not None:
            many = cells.numbers(table.count, key="count")
        cells.refuse("count", "count must be a positive integer", (many < 1.0) | (many % 1.0 > 0.0))
        cells.refuse("count", "at most two million tests are allowed", np.cumsum(many) > MOST_TESTS)
    times = many.astype(int)
    columns = {key: column.repeat(times) for key, column in columns.items()}
    return cells, cells.lines.repeat(times), columns, stopped.repeat(times)


def fit(
    data: Array,
    stopped: Flags,
    table: Observations,
    bounds: Sequence[float | None] = (None, None),
    *,
    slope: float = 1.0,
) -> Law:
    """The law of some observations; raises Fault.  `slope`: they are forces to this power, which
    have the modulus.
    """
    modulus = table.modulus
    if not modulus and (len(data) < 2 or stopped.all()):
        reason = f"all {len(data)} tests are right-censored"
        if len(data) < 2:
            reason = f"the file has {len(data)} observation"
        raise Fault(
            f"{reason}; a fit needs at least two failures, or a known Weibull modulus (modulus = "
            "…)",
            "file",
        )
    failures = data[~stopped].tolist()
    censored = data[stopped].tolist()
    try:
        if modulus:
            modulus /= slope
            return law_of_known_modulus(failures, table.fit, censored=censored, modulus=modulus)
        return fitted_law(failures, table.fit, *bounds, censored=censored, unbiased=table.unbiased)
    except LawError as error:
        key = error.key if error.key in ("fit", "lower", "upper") else "file"
        raise Fault(str(error), key) from None


def warn_of_rows(
    table: Observations, cells: Table, lines: Places, x: Array, stopped: Flags, draft: "Draft"
) -> None:
    """Warn of what the reader notes, of few observations (n,) that stand in `lines`, outliers, a
    shape of no fit; and of a modulus that they contradict, which holds the verdict.
    """
    notes = list(cells.notes)
    far = [
        f"line {lines[k]} ({ratio:.3g} times the median)"
        for k, ratio in outliers(x, ~stopped).items()
    ]
    if far:
        notes.append(
            f"{cells.name}: {', '.join(far[:5])}: far from the other rows. Is the decimal point "
            "right?"
        )
    if (~stopped).sum() >= 6:
        with suppress(ValueError):
            tests = make_tests(x, stopped)
            p = max(tests.probability_of(law) for law in STRENGTHS.values())
            if p < _UNLIKELY:
                notes.append(
                    f"{cells.name}: neither a Weibull nor a lognormal distribution fits (p = "
                    f"{p:.2g}). Are rows mixed or faulty?"
                )
            if table.modulus:
                low, high = tests.fit(draws=1000).shape_interval
                if not low <= table.modulus <= high:
                    draft.warn(
                        f"{cells.name}: the observations have a modulus of {low:.3g} to {high:.3g}"
                        f", not {table.modulus:g}. Is it that of this rock?",
                        "modulus",
                        holds="plausibility",
                    )
    if len(x) < _FEW:
        notes.append(
            f"only {len(x)} observations: the epistemic uncertainty is large. Use at least {_FEW}"
        )
    for text in notes:
        draft.warn(text, "file")


# --- the pulse of a clean record ------------------------------------------------------------------

_MENDED = "To cut and mend a record, use uqsphere shpb records"


def pulse_of(table: "PulseTable", draft: "Draft") -> MeasuredPulse:
    """The pulse of a file of time and strain, or volts with a factor; raises Fault.  Mending is the
    lab's.
    """
    with opened(table, draft) as cells:
        columns = table.columns or cells.headings[:2]
        if len(columns) != 2:
            raise Fault(
                "a column of time and one of strain or volts are required, not "
                f"{len(columns)} column",
                "columns",
            )
        time_unit, unit = table.units or (None, None)
        heading = cells.headings[cells.place(columns[1], "voltage")]
        volts = (unit or unit_in_heading(heading, "voltage")[1]) in UNITS["voltage"]
        time = cells.numbers(columns[0], "time", time_unit)
        dimension = "voltage" if volts else "strain"
        strain = (table.factor or 1.0) * cells.numbers(columns[1], dimension, unit)
        cells.refuse(
            "", "the time must increase from row to row", np.diff(time, prepend=-np.inf) <= 0.0
        )
    if volts and not table.factor:
        raise Fault(
            "factor, the strain of one volt, is missing. Add it, for example factor = 1e-3",
            "factor",
        )
    if not volts and table.factor:
        raise Fault(
            "factor is used only with a column of volts; this one is a strain. Remove factor",
            "factor",
        )
    notes = list(cells.notes)
    if -strain.min() > strain.max():
        strain = -strain
        notes.append("the largest strain is negative: its sign is changed, compression is positive")
    try:
        pulse, misfit = measured_pulse(time, strain)
    except ValueError as error:
        raise Fault(f"{error}. {_MENDED}", "file") from None
    if misfit > 0.02:
        notes.append(
            f"the fitted pulse deviates by {100.0 * misfit:.2g} % of the peak: sharp edges are "
            f"rounded, or the record is noisy. {_MENDED}"
        )
    for note in notes:
        draft.warn(f"{shown(table.file)}: {note}", "file")
    return pulse
