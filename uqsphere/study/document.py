"""The tables of a study file as pydantic models: words, and numbers with their units or
distributions.

The numbers of a scene are declared in `uqsphere.quantities.INPUTS`; what the tables say of each
other is checked in `uqsphere.study.check`.  The JSON schema and docs/study-file.md follow from all
three.
"""

import math
import re
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    SkipValidation,
    WithJsonSchema,
    create_model,
)
from pydantic import model_validator as checked

from uqsphere.arrays import Values
from uqsphere.documents import Fault, TomlTable
from uqsphere.mechanics.bars import END_COEFFICIENTS
from uqsphere.mechanics.criteria import CRITERIA, PARAMETERS
from uqsphere.mechanics.pulses import PRESETS, SHAPES
from uqsphere.mechanics.rigs import DEFAULT_RIG, RIGS
from uqsphere.units import UNITS, Quantity, shown
from uqsphere.uq.families import FAMILIES

from .values import Observations, Positive, fraction, numbers_of, value_of

#: values of the free number of [margins]
VALUES = 25
#: what loads the sphere, and the tables that belong to each rig
RIG_TABLES = {
    name: (*rig.tables, "insert") if rig.by_wave else rig.tables for name, rig in RIGS.items()
}
#: tables that have numbers of `uqsphere.quantities.INPUTS`
SCENE = ("sphere", "contact", "rig", *dict.fromkeys(chain(*RIG_TABLES.values())))


# --- what a key can hold --------------------------------------------------------------------------


def _fixed_schema(dimension: str) -> dict[str, Any]:
    """JSON schema of a fixed number: a text with a unit, or a plain number where there is no
    unit.
    """
    if dimension == "number":
        return {"type": ["number", "string"]}
    units = "|".join(map(re.escape, UNITS[dimension]))
    if dimension == "speed":
        units += "|rpm.+"
    return {"type": "string", "pattern": rf"^\s*[+-]?[\d._]+([eE][+-]?\d+)?\s*({units})\s*$"}


def _fixed(name: str) -> Any:
    """The mark of a fixed number with its unit: a parameter of a criterion, or any number of a
    dimension.
    """
    number = PARAMETERS.get(name) or Quantity(name=name, dimension=name, meaning=name)
    quantity = replace(number, meaning=f"the {number.meaning}")
    return BeforeValidator(partial(value_of, quantity=quantity)), WithJsonSchema(
        _fixed_schema(number.dimension)
    )


def _unique(values: tuple[Any, ...]) -> tuple[Any, ...]:
    for k, value in enumerate(values):
        if value in values[:k]:
            raise Fault(f"{shown(value)} is named twice", k)
    return values


def _several(least: int = 1, most: int = 200) -> Any:
    """The mark of a list with so many entries, each once."""
    return Field(min_length=least, max_length=most, strict=False), AfterValidator(_unique)


def _policy(raw: Any) -> Any:
    """A word, or a fraction of the model runs."""
    if isinstance(raw, str) and "%" not in raw:
        return raw
    return fraction(raw)


Aim = Literal["survive", "break"]
Policy = Literal["abort", "bound", "drop"]
#: a value, with its unit where it has one, or a distribution
Num = Annotated[Any, WithJsonSchema({"type": ["number", "string", "object"]})]
Name = Annotated[str, Field(pattern="^[A-Za-z_][A-Za-z0-9_-]{0,63}$")]
_Part = Annotated[float, Field(gt=0.0, lt=1.0)]
Share = Annotated[float, BeforeValidator(fraction, json_schema_input_type=_Part | str)]
Shares = Annotated[tuple[Share, ...], *_several()]
Correlation = Annotated[float, Field(gt=-1.0, lt=1.0)]
Pair = Annotated[tuple[str, ...], *_several(2, 2)]
Seconds = Annotated[float, *_fixed("time")]
Length = Annotated[float, *_fixed("length")]


# --- the scene ------------------------------------------------------------------------------------


class Body(TomlTable):
    """What touches the sphere, or the sphere itself."""

    material: str | None = None
    """name of `uqsphere list materials`, for the numbers that are omitted"""


class Bars(Body):
    """Both bars, alike in material and diameter."""

    infinite: bool = False
    """infinitely long bars: no reflected waves"""
    rigid_contact: bool = False
    """rigid bars in the contact stiffness, `1/E* = (1 - nu²)/E`"""


class PulseTable(TomlTable):
    """The incident pulse; each shape has keys of its own."""

    preset: Literal[*PRESETS] | None = None  # type: ignore[valid-type]
    """a pulse of the paper's Fig. 2, in place of `shape`"""
    shape: Literal[*SHAPES, "measured"] = "rectangular"  # type: ignore[valid-type]
    """shape of the pulse"""
    file: str | None = None
    """`measured`: file beside the study with columns of time and strain (compression positive)"""
    sheet: str | None = None
    """`measured`: sheet of a workbook (default: the first with data)"""
    columns: Pair | None = None
    """`measured`: column names of time and signal (default: the first two)"""
    units: Pair | None = None
    """`measured`: units of time, and of strain or volts (default: those of the headings)"""
    factor: Positive | None = None
    """`measured`: strain of one volt"""


class ContactTable(TomlTable):
    """The law of the contacts."""

    law: Literal["hertz", "plastic"] | None = None
    """`"hertz"`, or `"plastic"`: the softer body yields or crushes (default: `"plastic"` if the
    study or the library has an onset of yield)"""


class RigTable(TomlTable):
    """What loads the sphere; `speed` or `drop_height` where the sphere itself moves."""

    kind: Literal[*RIGS] = DEFAULT_RIG  # type: ignore[valid-type]
    """what loads the sphere"""


class Struck(Body):
    """A target or an anvil."""

    kind: Literal["thick", "plate", "bar", "mass"] = "thick"
    """a plate bends; a bar is struck at its end"""


class Hammer(Body):
    """A weight that falls."""

    shape: Literal["ball"] | None = None
    """hammer: for a `"ball"`, mass and `face_radius` follow from the `diameter`"""


class Rod(Body):
    """A long rod that a sphere rests on."""

    gauge: Length | None = None
    """rod: distance of the gauge from the sphere, for `history`"""


class Gauge(TomlTable):
    """A strain gauge: its bar, and its distance from the sphere [m]."""

    bar: Literal["incident", "receiving", "rod"]
    """`"incident"`, `"receiving"`, or `"rod"` of a load cell"""
    position: Length
    """distance from the sphere"""


class ModelChoice(TomlTable):
    """Which mechanics, and how precisely; `horizon` [s]."""

    fidelity: Literal["full", "massless", "linear"] = "full"
    """`"full"`; of the paper: `"massless"`, `"linear"`"""
    tolerance: Annotated[float, Field(ge=1e-12, le=1e-2)] = 1e-6
    """relative error of the integration"""
    first_loading_only: bool = False
    """end the evaluation window when the first reflected wave returns to the sphere"""
    whole_record: bool = False
    """evaluate up to the horizon, including later impacts of the loose sphere (bars)"""
    horizon: Seconds | None = None
    """latest end of the evaluation window (default: eight round trips of the longer bar)"""
    compare_with_paper: bool = False
    """print the paper's formulas as printed beside the corrected ones"""


# --- limits and what is asked ---------------------------------------------------------------------


class LimitTable(TomlTable):
    """A limit state: a demand (quantity or criterion) and its strength."""

    quantity: str | None = None
    """a quantity of `uqsphere list quantities`"""
    criterion: Literal[*CRITERIA] | None = None  # type: ignore[valid-type]
    """alternative: one of `uqsphere list criteria`"""
    strength: Num
    """value, distribution, or a file with tests or draws"""
    strength_is: Literal["hertz", "pressure"] | None = None
    """required if `plastic`: `"hertz"`, computed from a force by Hertz, or `"pressure"`, a true
    pressure"""
    aim: Aim = "survive"
    """`"survive"`: the demand must stay below the strength; `"break"`: it must exceed it"""
    target: Share | None = None
    """largest accepted failure probability, `0.01` or `"1 %"`"""
    model_factor: Num = 1.0
    """multiplies the demand; above 1, the particle breaks earlier; may be random"""
    fracture: bool | None = None
    """whether exceedance breaks the sphere (default: that of the quantity)"""
    energy_is: Literal["contact", "sphere", "input"] | None = None
    """energy of `specific_energy` (required except for bars): stored in both contacts, in the
    sphere, or the impact energy"""
    modulus: Annotated[float, *_fixed("modulus")] | None = None
    """Weibull modulus of a weakest link, unless the strength has it"""
    reference_volume: Annotated[float, *_fixed("reference_volume")] | None = None
    """volume under tension that a volume strength refers to"""
    reference_area: Annotated[float, *_fixed("reference_area")] | None = None
    """surface area that a surface strength refers to"""
    largest_energy: Annotated[float, *_fixed("largest_energy")] | None = None
    """upper bound of the fracture energy"""
    rate_0: Annotated[float, *_fixed("rate_0")] | None = None
    """strain rate at which the quasi-static strength doubles"""

    @checked(mode="after")
    def _one_demand(self) -> Self:
        if (self.quantity is None) == (self.criterion is None):
            raise Fault(
                'exactly one of quantity and criterion is required, for example quantity = "p_max"',
                "quantity",
            )
        if self.energy_is and self.criterion != "specific_energy":
            raise Fault(
                "energy_is is used only with the criterion specific_energy. Remove it", "energy_is"
            )
        return self


def _named(raw: Any) -> Any:
    """The limits by their names; a key of one without a name is told once for all of them."""
    if isinstance(raw, dict):
        for key, table in raw.items():
            if not isinstance(table, dict):
                raise Fault(f"must be a table with a name, [limits.NAME], not {shown(table)}", key)
    return raw


_KEYS = {"lower", "upper"}.union(*(family.keys for family in FAMILIES.values()))
_of_laws: dict[str, Any] = {
    "dist": (Literal[*FAMILIES] | Annotated[str, Field(pattern=r"^scipy\.\w+$")], None),
    **dict.fromkeys(("values", "weights"), (tuple[float | str, ...], None)),
    **dict.fromkeys(sorted(_KEYS), (float | str, None)),
}
#: what the schema says of a distribution in a table
Distribution: Any = create_model(
    "Distribution", __base__=Observations, __cls_kwargs__={"extra": "allow"}, **_of_laws
)


def _with_numbers(table: str) -> tuple[Any, TomlTable]:
    """A table with the numbers of the scene that it can have, which `check.tables` reads: a word
    where one stands for it, fixed, or a law; and what it is by default.
    """
    words: Any = Words.model_fields[table].annotation
    numbers = dict[str, Any]()
    for name, quantity in numbers_of(table).items():
        fixed = Annotated[Any, WithJsonSchema(_fixed_schema(quantity.dimension))]
        kinds = Distribution | fixed
        if name.endswith("end"):
            kinds |= Literal[*END_COEFFICIENTS]
        elif name.endswith("face_radius"):
            kinds |= Literal["flat"]
        numbers[name] = (
            SkipValidation[kinds],  # type: ignore[misc, valid-type]
            Field(default=None, description=quantity.meaning),
        )
    kind = create_model(
        table.capitalize(),
        __base__=words,
        __doc__=words.__doc__,
        # no source in which docstrings would be looked for, at length
        __cls_kwargs__={"use_attribute_docstrings": False},
        **numbers,
    )
    return kind, kind.model_construct()


class DependenceTable(TomlTable):
    """One rank correlation, Spearman's or Kendall's, for every pair of the names; `dof` of a
    Student t copula.
    """

    of: Annotated[tuple[str, ...], *_several(2, 1_000)]
    """two or more random numbers"""
    spearman: Correlation | None = None
    """Spearman's rank correlation (this or `kendall` is required)"""
    kendall: Correlation | None = None
    """Kendall's rank correlation"""
    copula: Literal["gaussian", "student_t"] = "gaussian"
    """`"gaussian"`, or `"student_t"` with `dof`"""
    dof: Annotated[float, Field(ge=1.0, le=1000.0)] | None = None
    """degrees of freedom of `student_t`"""


class AccuracyTable(TomlTable):
    """Half-widths of the 95 % intervals: mean and quantile over sd, sobol absolute, probability
    relative.
    """

    mean: Positive = 0.005
    quantile: Positive = 0.02
    sobol: Positive = 0.02
    probability: Positive = 0.05


class Budget(TomlTable):
    """Upper limits on model runs and run time; `time` [s]."""

    evaluations: Annotated[int, Field(gt=0, lt=2**63)] = 2_000_000
    time: Seconds = 600.0


class Analysis(TomlTable):
    """Requested quantities, their accuracy and the budget; `cost` and `time_limit` [s] of one
    black-box model run.
    """

    quantities: Annotated[tuple[str, ...], *_several()] = ()
    """computed to this accuracy (default: `p_max` and `contact_duration`, or all outputs of a black
    box)"""
    accuracy: AccuracyTable = AccuracyTable.model_construct()
    """half-widths of 95 % intervals; mean and quantile divided by the standard deviation,
    probability relative: `{ mean = 0.005, quantile = 0.02, sobol = 0.02, probability = 0.05 }`"""
    budget: Budget = Budget.model_construct()
    """upper limits: `{ evaluations = 2_000_000, time = "10 min" }`"""
    quantiles: Shares = (0.01, 0.05, 0.5, 0.95, 0.99)
    """probabilities of the quantiles"""
    measures: Annotated[tuple[Literal["morris", "delta", "pawn"], ...], *_several()] = ()
    """sensitivity measures of SALib in addition to Sobol' indices: `morris`, `delta`, `pawn`"""
    second_order: bool = False
    """also Sobol' indices of all pairs of inputs"""
    failure_modes: Literal["all", "given"] = "all"
    """`all`: also modes without a limit, with library strengths"""
    damage_counts: bool = False
    """a ring crack, which damages the surface, counts as fracture (glass, catalysts)"""
    on_failure: Annotated[
        Policy | _Part, BeforeValidator(_policy, json_schema_input_type=Policy | _Part | str)
    ] = "abort"
    """failed model runs: `"bound"`, the interval covers both outcomes; `"drop"`, up to 1 % are
    dropped, or up to a percentage such as `"5 %"`"""
    cost: Seconds | None = None
    """run time of one black-box model run (default: measured)"""
    time_limit: Seconds | None = None
    """time limit of one black-box model run; loading the model has as long, at least ten
    minutes"""

    @property
    def policy(self) -> str:
        """What becomes of failed evaluations: abort, bound or drop."""
        if isinstance(self.on_failure, str):
            return self.on_failure
        return "drop"


def limit_of(path: str) -> str | None:
    """The limit that a strength or a model factor belongs to; None for a number of the scene.

    >>> limit_of("limits.crushing.strength"), limit_of("striker.speed")
    ('crushing', None)
    """
    limit = re.fullmatch(r"limits\.(.+)\..+", path)
    return limit[1] if limit else None


class Margins(TomlTable):
    """The inverse problem: at which value of one number is a failure probability reached?

    The number is one of the scene or of a black box, the mean of its law where it scatters, or the
    mean strength of a limit, all its values in proportion; of a `Study` it lies between two values
    in SI.
    """

    solve: str
    """the free number: `"striker.speed"`, `"limits.NAME.strength"`"""
    between: Annotated[tuple[Any, ...], *_several(2, 2)]
    """lowest and highest value"""
    for_probability: Shares = (0.01, 0.1, 0.5, 0.9, 0.99)
    """probabilities that the quantity exceeds the strength"""

    @property
    def limit(self) -> str | None:
        """The limit whose strength is free; else the answers of the model depend on the number."""
        return limit_of(self.solve)

    def values_at(self, shares: Values) -> Values:
        """The values a share of the way from the lowest to the highest: in ratios where all are
        positive, else in steps.

        >>> margins = Margins(solve="striker.speed", between=(0.1, 10.0))
        >>> margins.values_at(np.array([0.0, 0.5, 1.0])).round(12).tolist()
        [0.1, 1.0, 10.0]
        """
        low, high = self.between
        if low > 0.0:
            return np.clip(low * (high / low) ** shares, low, high)
        return low + (high - low) * shares

    def shares_of(self, values: Values) -> Values:
        """The share of the way at which values lie."""
        low, high = self.between
        if low > 0.0:
            return np.log(values / low) / math.log(high / low)
        return (values - low) / (high - low)

    def grid(self, count: int = VALUES) -> list[float]:
        """`count` values from one end to the other."""
        values: list[float] = self.values_at(np.linspace(0.0, 1.0, count)).tolist()
        return values


class Outputs(TomlTable):
    """The outputs of a black box."""

    names: Annotated[tuple[Name, ...], *_several()] = ()
    """names of the outputs, `["y"]`; required"""


class Words(TomlTable):
    """A study file, without the numbers of the scene, whose tables `Document` completes."""

    title: str = ""
    """heading of the report (default: the file's name); not part of the study's hash"""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """the same seed gives the same answers"""
    sphere: Body
    bars: Bars
    striker: Body
    pulse: PulseTable
    contact: ContactTable
    rig: RigTable
    target: Struck
    anvil: Struck
    other: Body
    hammer: Hammer
    rod: Rod
    platens: Body
    insert: Body
    model: ModelChoice = ModelChoice.model_construct()
    inputs: dict[Name, Num] = Field(default={}, max_length=1000)
    outputs: Outputs = Outputs.model_construct()
    limits: Annotated[dict[Name, LimitTable], BeforeValidator(_named)] = Field(
        default={}, max_length=200
    )
    dependence: Annotated[tuple[DependenceTable, ...], Field(max_length=100, strict=False)] = ()
    gauges: Annotated[tuple[Gauge, ...], Field(max_length=20, strict=False)] = ()
    analysis: Analysis = Analysis.model_construct()
    margins: Margins | None = None


#: the tables of the scene: their words stand above, their numbers are those of `INPUTS`
_scene: dict[str, Any] = {name: _with_numbers(name) for name in SCENE}
Document = create_model("Document", __base__=Words, __doc__="A study file.", **_scene)


# --- the schema -----------------------------------------------------------------------------------


def json_schema() -> dict[str, Any]:
    """JSON schema of a study file (draft 2020-12) for editors: scene and black box, with units and
    meanings.

    It says less than the reader: how numbers go together, only `load_study` knows.
    """
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **Document.model_json_schema(),
        "anyOf": [{"required": ["sphere"]}, {"required": ["inputs", "outputs"]}],
    }
