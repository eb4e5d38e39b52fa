"""The tables of a study file as pydantic models: what can stand there, and what it means.

The numbers of a scene, of a black box and of strengths are read by `uqsphere.study.number`; what the tables say of each
other is looked at in `uqsphere.study.check`.  The JSON schema and docs/study-file.md are made from these models.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from functools import partial
from typing import Annotated, Any, Final, Literal, TypeVar, get_args

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, WithJsonSchema
from pydantic import model_validator as checked

from uqsphere.mechanics.criteria import CRITERIA, PARAMETERS
from uqsphere.study.fault import Fault, Place, one_of, shown, suggestion
from uqsphere.study.number import plain_quantity, value_of
from uqsphere.units import Quantity

#: what loads the sphere, and the tables that belong to each rig
RIG_TABLES: Final[dict[str, tuple[str, ...]]] = {
    "bars": ("bars", "striker", "pulse", "insert"),
    "impact": ("target",),
    "sphere_on_sphere": ("other",),
    "drop_weight": ("hammer", "anvil"),
    "load_cell": ("hammer", "rod"),
    "platens": ("platens",),
}
#: tables whose numbers are entries of `uqsphere.quantities.INPUTS`
SCENE: Final = ("sphere", "contact", "rig", *dict.fromkeys(t for tables in RIG_TABLES.values() for t in tables))


# --- what a key can hold -------------------------------------------------------------------------------------------


def _fixed(dimension: str, meaning: str = "", lower: float = 0.0, upper: float = math.inf) -> Any:
    """The mark of a fixed number with its unit."""
    quantity = Quantity(name=dimension, symbol="", dimension=dimension, lower=lower, upper=upper,
                        meaning=f"the {meaning or dimension}")  # fmt: skip
    return BeforeValidator(partial(value_of, quantity=quantity)), WithJsonSchema({"dimension": dimension})


def _parameter(name: str) -> Any:
    part = PARAMETERS[name]
    return _fixed(part.dimension, part.meaning, part.lower, part.upper)


def _percent(raw: Any) -> Any:
    return value_of(raw, plain_quantity("share")) if isinstance(raw, str) and raw.rstrip().endswith("%") else raw


def _real(**bounds: Any) -> Any:
    """The mark of a plain number within bounds, which may be a percentage."""
    return Field(**bounds), BeforeValidator(_percent)


def _unique(values: tuple[Any, ...]) -> tuple[Any, ...]:
    if (twice := next((k for k, value in enumerate(values) if value in values[:k]), None)) is not None:
        raise Fault(f"{shown(values[twice])} is named twice", twice)
    return values


def _policy(raw: Any) -> Any:
    """One of three words, or the share of failed evaluations that is left out at most."""
    share = _percent(raw)
    if raw in POLICIES or (isinstance(share, int | float) and 0.0 < share < 1.0):
        return share
    words = ", ".join(f'"{word}"' for word in POLICIES)
    raise Fault(f'found {shown(raw)}, allowed: {words}, or the largest share to leave out, such as "5 %"')


def _several(least: int = 1, most: int = 200) -> Any:
    """The mark of a list with so many entries, each once."""
    return Field(min_length=least, max_length=most, strict=False), AfterValidator(_unique)


def key(meaning: str | None, default: Any = None, *, usual: str = "") -> Any:
    """A key: its meaning in one clause (None: that of its quantity), its default, and that in words if need be."""
    table = isinstance(default, type) and issubclass(default, BaseModel)
    held = {"default_factory": default.model_construct} if table else {"default": default}
    return Field(**held, description=meaning, json_schema_extra={"usual": usual})


def required(meaning: str) -> Any:
    """A key that must be given."""
    return Field(description=meaning, json_schema_extra={"usual": "required"})


#: a value, with its unit where it has one, or a distribution; that of a scene is known by its table and key
Num = Annotated[Any, WithJsonSchema({"dimension": "value"})]
Name = Annotated[str, Field(pattern="^[A-Za-z_][A-Za-z0-9_-]{0,63}$")]
Share = Annotated[float, *_real(gt=0.0, lt=1.0)]
POLICIES: Final = ("abort", "bound", "drop")
OnFailure = Annotated[
    str | float, BeforeValidator(_policy), WithJsonSchema({"anyOf": [{"enum": [*POLICIES]}, {"type": "number"}]})
]
Shares = Annotated[tuple[Share, ...], *_several()]
Positive = Annotated[float, *_real(gt=0.0)]
Correlation = Annotated[float, *_real(gt=-1.0, lt=1.0)]
Names = Annotated[tuple[str, ...], *_several()]
Pair = Annotated[tuple[str, ...], *_several(2, 2)]
Seconds = Annotated[float, *_fixed("time")]
Length = Annotated[float, *_fixed("length")]
_Method = Literal["auto", "qmc", "pce", "sobol", "form", "importance", "subset", "morris", "delta", "pawn", "hdmr"]
Methods = Annotated[
    tuple[_Method, ...], *_several(), BeforeValidator(lambda raw: [raw] if isinstance(raw, str) else raw)
]


class Table(BaseModel):
    """A table of a study: no key beyond those declared."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, defer_build=True, protected_namespaces=())


# --- the scene -----------------------------------------------------------------------------------------------------


class Sphere(Table):
    """The sphere."""

    material: str | None = key("name from `uqsphere list materials`: fills `E`, `nu`, `density` that are not given")
    E: Num = None
    nu: Num = None
    density: Num = None
    radius: Num = key("radius, not diameter; the sphere must fit its bars", usual="required")
    onset_pressure: Num = key(None, usual="from the material, else elastic")
    hardness: Num = key(None, usual="from the material")


class Face(Table):
    """What every body has that the sphere touches."""

    material: str | None = key("fills `E`, `nu`, `density`, `yield_strength` that are not given")
    E: Num = None
    nu: Num = None
    density: Num = None
    yield_strength: Num = key("for the validity checks, and the law of a `plastic` contact")
    onset_pressure: Num = key(None, usual="from `yield_strength`")
    hardness: Num = key(None, usual="from `yield_strength`")
    pile_up: Num = key("`a²` over `r` times the approach far beyond yield, 1 to 3", usual="8/3")


class Bars(Face):
    """Both bars, alike in material and diameter."""

    diameter: Num = key("diameter of the bars", usual="required")
    incident_length: Num = key("length of the incident bar", usual="required unless `infinite`")
    receiving_length: Num = key("length of the receiving bar", usual="required unless `infinite`")
    incident_end: Num = key('`"free"`, `"absorbing"`, `"fixed"`, or a reflection coefficient', usual='`"free"`')
    receiving_end: Num = key("the same of the receiving bar", usual='`"absorbing"`')
    end_radius: Num = key("radius of rounded ends at the sphere", usual="flat")
    infinite: bool = key("no reflections", False)
    rigid_contact: bool = key("leaves the bars out of the contact stiffness, `1/E* = (1 - nu²)/E`", False)


class Striker(Table):
    """The striker; `E`, `density` and `diameter` of one that is no piece of the bars."""

    material: str | None = key("a material of bars, for `E` and `density`", usual="that of the bars")
    speed: Num = key("speed `v_0`; the pulse has the particle speed `v_0/2`", usual="required")
    length: Num = key("gives the pulse its duration `2 l_0/c_0`", usual="required without `pulse.duration`")
    E: Num = None
    density: Num = None
    diameter: Num = None


class Pulse(Table):
    """The incident pulse; each shape has keys of its own."""

    preset: Literal["very_short", "short", "long"] | None = key("a pulse of the paper's Fig. 2, in place of `shape`")
    shape: Literal["rectangular", "trapezoid", "ramp", "half_sine", "two_peak", "step", "measured"] = key(
        "shape of the pulse", "rectangular")  # fmt: skip
    duration: Num = key("duration", usual="from the striker")
    rise: Num = key("`trapezoid`, `ramp`: rise")
    fall: Num = key("`trapezoid`: fall")
    t1: Num = key("`two_peak`: time of the first peak")
    level1: Num = key("`two_peak`: its level over `v_0/2`")
    t2: Num = key("`two_peak`: time of the second peak")
    level2: Num = key("`two_peak`: its level over `v_0/2`")
    valley: Num = key("`two_peak`: level half-way between", usual="0.75 of the lower peak")
    file: str | None = key("`measured`: table of time and strain (compression positive), a file beside the study")
    columns: Pair | None = key("`measured`: names of both columns", usual="the first two")
    units: Pair | None = key("`measured`: units of time, and of strain or volts", usual="of the headings")
    factor: float | None = key("`measured`: strain of one volt")
    gain: Num = key("`measured`: true strain over that of the record")


class Contact(Table):
    """The law of the contacts."""

    law: Literal["hertz", "plastic"] = key('`"hertz"`, or `"plastic"`: the softer body yields or crushes', "hertz")
    onset_pressure: Num = key("centre pressure at which a face begins to yield", usual="of the softer body")
    hardness: Num = key('mean pressure of a face that flows fully, or `"onset"`', usual="of the softer body")
    pile_up: Num = key("`a²` over `r` times the approach far beyond yield, 1 to 3", usual="8/3 of a metal, else 2")


class Rig(Table):
    """What loads the sphere; `speed` or `drop_height` where the sphere itself moves."""

    kind: Literal["bars", "impact", "sphere_on_sphere", "drop_weight", "load_cell", "platens"] = key(
        "what loads the sphere", "bars")  # fmt: skip
    speed: Num = key('closing speed of `impact` and `sphere_on_sphere`; a rotor\'s tip: `"1450 rpm at 0.9 m"`')
    drop_height: Num = key("in its place: height that the sphere falls from through air")
    angle: Num = key("between path and surface, above 5 deg", usual='`"90 deg"`, square on')


class Partner(Face):
    """A body that touches the sphere: [target] or [anvil], [other], [hammer], [rod], [platens] or [insert]."""

    kind: Literal["thick", "plate", "bar", "mass"] | None = key(
        'target, anvil: `"thick"`, a `"plate"` that bends, end of a `"bar"`, `"mass"`', usual='`"thick"`')  # fmt: skip
    thickness: Num = key("plate, insert: thickness", usual="required for a plate")
    width: Num = key("plate: width, for the check of its edges")
    mass: Num = key("mass, hammer: its mass", usual="required, or a ball")
    diameter: Num = key("bar, rod, ball: diameter", usual="required")
    length: Num = key("bar, rod: length; a bar without it returns nothing", usual="required for a rod")
    end: Num = key("bar, rod: far end, as the ends of bars", usual='`"free"`')
    face_radius: Num = key("target, anvil, hammer: radius of a rounded face", usual='`"flat"`')
    radius: Num = key("other: radius of the other sphere", usual="required")
    shape: Literal["ball"] | None = key('hammer: `"ball"`: mass and `face_radius` follow from the `diameter`')
    speed: Num = key("hammer: speed at the sphere; platens: speed of the crosshead")
    drop_height: Num = key("hammer: height that it falls from, in place of `speed`")
    gauge: Length | None = key("rod: distance of the gauge from the sphere, for `history`")
    force: Num = key("platens: largest force")
    displacement: Num = key("platens: largest approach of both contacts, in place of `force`")
    loading_rate: Num = key("platens: loading rate, in place of `speed`")
    machine_stiffness: Num = key("platens: stiffness of the machine in series", usual="rigid")


_FACE: Final = "density yield_strength onset_pressure hardness pile_up"
#: by table and kind: what it needs (one of both, where a bar stands between), and what else it takes (* anything)
FORMS: Final[dict[str, tuple[str, str]]] = {
    "sphere": ("E nu density radius", "*"), "insert": ("E", "nu yield_strength thickness"),
    "bars": ("E nu density diameter incident_length receiving_length", "*"),
    "bars infinite": ("E nu density diameter", "*"),
    "striker": ("speed", "*"), "striker timed": ("speed length", "*"), "striker measured": ("", "E density diameter"),
    "pulse rectangular": ("", "duration"), "pulse half_sine": ("", "duration"), "pulse step": ("", ""),
    "pulse trapezoid": ("rise fall", "duration"), "pulse ramp": ("rise", "duration"),
    "pulse two_peak": ("t1 level1 t2 level2", "duration valley"),
    "pulse measured": ("file", "columns units factor gain"),
    "rig impact": ("speed|drop_height", "angle"), "rig sphere_on_sphere": ("speed|drop_height", "angle"),
    "target thick": ("E nu", f"{_FACE} face_radius"),
    "target plate": ("E nu density thickness", f"{_FACE} width face_radius"),
    "target bar": ("E nu density diameter", f"{_FACE} length end face_radius"),
    "target mass": ("E nu mass", f"{_FACE} face_radius"),
    "hammer": ("E nu mass speed|drop_height", f"{_FACE} face_radius"),
    "hammer ball": ("E nu density diameter speed|drop_height", _FACE),
    "other": ("E nu density radius", _FACE), "rod": ("E nu density diameter length", f"{_FACE} end gauge"),
    "platens": ("E nu force|displacement", f"{_FACE} speed loading_rate machine_stiffness"),
}  # fmt: skip


class Gauge(Table):
    """A strain gauge: its bar, and its distance from the sphere [m]."""

    bar: Literal["incident", "receiving", "rod"] = required('`"rod"` in a load cell')
    position: Length = required("distance from the sphere")


class ModelChoice(Table):
    """Which mechanics, and how precisely; `horizon` [s]."""

    fidelity: Literal["full", "massless", "linear"] = key('`"full"`; of the paper: `"massless"`, `"linear"`', "full")
    tolerance: Annotated[float, *_real(ge=1e-12, le=1e-2)] = key("relative error of the integration", 1e-6)
    first_loading_only: bool = key("end the record when the first reflected wave is back", False)
    whole_record: bool = key("go on after the first loss of contact, to the horizon (bars)", False)
    horizon: Seconds | None = key("latest end of the record", usual="eight round trips of the longer bar")
    compare_with_paper: bool = key("adds the paper's printed massless formulas and the corrected ones", False)


# --- limits and what is asked --------------------------------------------------------------------------------------


class LimitTable(Table):
    """A strength, and the quantity or criterion that is held against it."""

    quantity: str | None = key("a quantity of `uqsphere list quantities`", usual="required, or `criterion`")
    criterion: Literal[*CRITERIA] | None = key("in its place: one of `uqsphere list criteria`")  # type: ignore[valid-type]
    strength: Num = required("value, distribution, or a file with tests or draws")
    strength_is: Literal["hertz", "pressure"] | None = key(
        '`"hertz"`: computed from a force by Hertz; `"pressure"`: the true one', usual="required if `plastic`"
    )
    aim: Literal["survive", "break"] = key("the quantity must stay below the strength, or exceed it", "survive")
    target: Share | None = key('largest accepted failure probability, `0.01` or `"1 %"`')
    model_factor: Num = key("factor on the quantity for what the model leaves out; may scatter", 1.0, usual="`1`")
    fracture: bool | None = key("whether exceeding it breaks the sphere", usual="by the quantity")
    energy_is: Literal["contact", "sphere", "input"] | None = key(
        "of `specific_energy`: stored in both bodies, in the sphere, or offered", usual="required but for bars"
    )
    modulus: Annotated[float, *_parameter("modulus")] | None = key("of a weakest link", usual="that of the strength")
    reference_volume: Annotated[float, *_parameter("reference_volume")] | None = key("volume of a volume strength")
    reference_area: Annotated[float, *_parameter("reference_area")] | None = key("area of a surface strength")
    largest_energy: Annotated[float, *_parameter("largest_energy")] | None = key("upper bound of a fracture energy")
    rate_0: Annotated[float, *_parameter("rate_0")] | None = key("strain rate at which a slow strength is doubled")

    @checked(mode="after")
    def _one_demand(self) -> LimitTable:
        if self.quantity is None and self.criterion is None:
            raise Fault('quantity is missing: add quantity = "p_max", say, or a criterion', "quantity")
        if self.quantity is not None and self.criterion is not None:
            raise Fault("quantity and criterion both say what is compared: leave one of them out", "quantity")
        if self.energy_is is not None and self.criterion != "specific_energy":
            raise Fault("energy_is belongs to the criterion specific_energy: leave it out", "energy_is")
        return self


class Discrete(Table):
    """A distribution of some values, each by its weight."""

    dist: Literal["discrete"]
    values: Annotated[tuple[Any, ...], Field(strict=False)]
    weights: Annotated[tuple[float, ...], Field(strict=False)] | None = None


class Observations(Table):
    """A distribution from a file beside the study: a column, crushing tests of spheres, or the draws of a fit."""

    dist: Literal["empirical"] | None = key("may be left out where a file is named")
    file: str | None = key("CSV or .xlsx beside the study")
    draws: str | None = key(
        "in its place: draws of a fit, with columns `distribution` (lognormal or weibull), `scale`, `shape`, and if "
        "need be `least`, `bound`, `tests`, and their `diameter` with a `size_exponent`")  # fmt: skip
    decimal: Literal[".", ","] | None = key("decimal mark, where a column can be read both ways")
    column: str | None = key("column of observations, in the quantity itself")
    unit: str | None = key("its unit", usual="that of the heading")
    force: str | None = key("in place of `column`: forces at which spheres broke between platens")
    force_unit: str | None = key("unit of the forces", usual="that of the heading")
    diameter: str | None = key("column of their diameters, or one length", usual="required with `force`")
    diameter_unit: str | None = key("unit of the diameters", usual="that of the heading")
    rate: str | None = key("column of loading rates, with their unit in the heading")
    platens: Any = key('what it was measured between: `"bars"`, `"rigid"`, a material, or `E` and `nu`', "bars")
    censored: str | None = key("column of flags: 1 for a test stopped before a failure (right-censored)")
    count: str | None = key("column of numbers of equal tests", usual="one a row")
    modulus: Positive | None = key("Weibull modulus of the tests that is known; then few failures, or none, are enough")
    fit: str | None = key("`kde`, `steps`, or a distribution", usual="`weibull` of forces, else `kde`")
    unbiased: bool = key("takes the bias of few tests out of the modulus or the scatter", False)
    synthetic: bool = key("the observations are synthetic, so that no verdict is established by them", False)
    lower: Any = None
    upper: Any = None


class Dependence(Table):
    """One rank correlation, Spearman's or Kendall's, for every pair of the names; `dof` of a Student t copula."""

    of: Annotated[tuple[str, ...], *_several(2, 1_000)] = required("random numbers, two or more")
    spearman: Correlation | None = key("Spearman's rank correlation; or `kendall`", usual="required")
    kendall: Correlation | None = key("Kendall's rank correlation, in its place")
    copula: Literal["gaussian", "student_t"] = key('`"gaussian"`, or `"student_t"` with `dof`', "gaussian")
    dof: Annotated[float, *_real(ge=1.0, le=1000.0)] | None = key("degrees of freedom of a `student_t`")

    @checked(mode="after")
    def _one_strength(self) -> Dependence:
        if self.spearman is not None and self.kendall is not None:
            raise Fault("spearman is given too: one of them says how strong the dependence is", "kendall")
        if self.spearman is None and self.kendall is None:
            raise Fault("spearman is missing: add a rank correlation between -1 and 1, or kendall in its place")
        if self.copula == "student_t" and self.dof is None:
            raise Fault("dof is missing: a Student t copula needs its degrees of freedom, 4 say")
        if self.copula != "student_t" and self.dof is not None:
            raise Fault(f'dof belongs to copula = "student_t", the copula here is {shown(self.copula)}', "dof")
        return self


class Accuracy(Table):
    """Half-widths of the 95 % intervals: mean and quantile over sd, sobol absolute, probability relative."""

    mean: Positive = 0.005
    quantile: Positive = 0.02
    sobol: Positive = 0.02
    probability: Positive = 0.05


class Budget(Table):
    """Where a run stops at the latest; `time` [s]."""

    evaluations: Annotated[int, Field(gt=0)] = 2_000_000
    time: Seconds = 600.0


class Analysis(Table):
    """What is asked, how precisely, and at what cost; `cost` and `time_limit` [s] of one black-box evaluation."""

    quantities: Names = key(
        "what is answered to the accuracy below; quantities of limits are described beside", (),
        usual='`["p_max", "contact_duration"]`; outputs of a black box')  # fmt: skip
    accuracy: Accuracy = key(
        "half-widths of 95 % intervals: mean and quantile over the standard deviation, sobol absolute, probability "
        "relative", Accuracy)  # fmt: skip
    budget: Budget = key("the latest end of the run", Budget, usual='`{ evaluations = 2_000_000, time = "10 min" }`')
    quantiles: Shares = key("probabilities of the quantiles", (0.01, 0.05, 0.5, 0.95, 0.99))
    methods: Methods = key(f"`auto`, or some of {one_of(f'`{m}`' for m in get_args(_Method)[1:])}", ("auto",))
    second_order: bool = key("Sobol' indices of all pairs of inputs as well", False)
    failure_modes: Literal["all", "given"] = key(
        '`"all"`: a rock is judged by failure modes without a limit too, by library strengths', "all")  # fmt: skip
    on_failure: OnFailure = key(
        'failed evaluations: `"bound"` counts each once as exceeding and once as not; `"drop"` leaves out up to 1 %, '
        'a share such as `"5 %"` up to that', "abort")  # fmt: skip
    cost: Seconds | None = key("time of one evaluation of a black box", usual="measured")
    time_limit: Seconds | None = key("longest time of one evaluation of a black box; a longer one has failed")

    @property
    def policy(self) -> str:
        """What becomes of failed evaluations: abort, bound or drop."""
        return self.on_failure if isinstance(self.on_failure, str) else "drop"

    @property
    def drop_limit(self) -> float:
        """The largest share of failed evaluations that is left out."""
        return 0.01 if isinstance(self.on_failure, str) else self.on_failure


class MarginsTable(Table):
    """The inverse question: at which value of one number is a failure probability reached?"""

    solve: str = required('the free number: `"striker.speed"`, `"limits.NAME.strength"`')
    between: Annotated[tuple[Any, ...], *_several(2, 2)] = required("lowest and highest value")
    for_probability: Shares = key("probabilities that the quantity exceeds the strength", (0.01, 0.1, 0.5, 0.9, 0.99))


class Outputs(Table):
    """What a black box answers."""

    names: Annotated[tuple[Name, ...], *_several()] = key('names of the outputs, `["y"]`', (), usual="required")


class Document(Table):
    """A study file."""

    title: str = key("heading of the report; not part of the study's hash", "", usual="the file's name")
    seed: Annotated[int, Field(ge=0)] = key("the same seed gives the same answers", 0)
    sphere: Sphere = key(None, Sphere)
    bars: Bars = key(None, Bars)
    striker: Striker = key(None, Striker)
    pulse: Pulse = key(None, Pulse)
    contact: Contact = key(None, Contact)
    rig: Rig = key(None, Rig)
    target: Partner = key(None, Partner)
    anvil: Partner = key(None, Partner)
    other: Partner = key(None, Partner)
    hammer: Partner = key(None, Partner)
    rod: Partner = key(None, Partner)
    platens: Partner = key(None, Partner)
    insert: Partner = key(None, Partner)
    model: ModelChoice = key(None, ModelChoice)
    inputs: Annotated[dict[Name, Num], Field(max_length=1000)] = {}
    outputs: Outputs = key(None, Outputs)
    limits: Annotated[dict[Name, LimitTable], Field(max_length=50)] = {}
    dependence: Annotated[tuple[Dependence, ...], Field(max_length=100, strict=False)] = ()
    gauges: Annotated[tuple[Gauge, ...], Field(max_length=20, strict=False)] = ()
    analysis: Analysis = key(None, Analysis)
    margins: MarginsTable | None = None


# --- what pydantic finds, in the words of a study ------------------------------------------------------------------

_FOUND: Final = {
    "string_type": "where a text in quotes is required", "bool_type": "where true or false is required",
    "int_type": "where a whole number is required", "float_type": "where a number is required",
    "tuple_type": "where an array is required", "dict_type": "where a table is required",
    "model_type": "where a table is required",
    "greater_than": "it must be above {gt:g}", "greater_than_equal": "it must be at least {ge:g}",
    "less_than": "it must be below {lt:g}", "less_than_equal": "it must be at most {le:g}",
    "string_pattern_mismatch": "a name takes up to 64 letters, digits, _ and -, and begins with a letter",
    "too_short": "{min_length} or more are required", "too_long": "at most {max_length} are allowed",
}  # fmt: skip
Kind = TypeVar("Kind", bound=Table)


def faults_of(kind: type[Table], error: ValidationError) -> list[tuple[Place, str]]:
    """Every fault that pydantic found in a table; a key that may have been misspelt in it is not missed as well."""
    found = error.errors(include_url=False)
    misspelt = {fault["loc"][:-1] for fault in found if fault["type"] == "extra_forbidden"}
    above = {fault["loc"][:n] for fault in found for n in range(len(fault["loc"]))}
    faults = []
    for fault in found:
        place = tuple(part for part in fault["loc"] if part != "[key]")
        # a list is not short where its entries are faulty
        missed = fault["type"] == "missing" and place[:-1] in misspelt
        if not missed and not (fault["type"] == "too_short" and place in above):
            faults.append(((*place, *getattr(fault.get("ctx", {}).get("error"), "at", ())), _text(kind, fault, place)))
    return faults


def declared(kind: type[Kind], raw: Mapping[str, Any]) -> Kind:
    """A table inside another one; raises Fault for the first that is wrong with it."""
    try:
        return kind.model_validate(dict(raw))
    except ValidationError as error:
        place, message = faults_of(kind, error)[0]
        raise Fault(message, *place) from None


def _text(table: Any, fault: Any, place: Place) -> str:
    for part in place[:-1]:
        table = _table_in(table.model_fields[part].annotation) or table if part in table.model_fields else table
    kind, name, context = fault["type"], str(place[-1]) if place else "", fault.get("ctx", {})
    found = f"found {shown(fault['input'])}"
    if kind == "value_error":
        return str(context["error"])
    if kind == "missing":
        return f"{name} is missing: {table.model_fields[name].description.replace('`', '')}"
    if kind == "extra_forbidden":
        near = suggestion(name, table.model_fields) or f"; known here: {one_of(table.model_fields)}"
        return f"unknown key {shown(name)}{near}"
    if kind == "literal_error":
        words = re.findall(r"'([^']*)'", context["expected"])
        return f"{found}, allowed: {one_of(words)}{suggestion(fault['input'], words)}"
    if kind.startswith("too_"):
        found = f"found {context['actual_length'] or 'too many'} {name}"
    return f"{found}, {_FOUND.get(kind, 'which cannot stand here').format(**context)}"


def _table_in(annotation: Any) -> Any:
    """The table that a key holds, one or several; None for a value."""
    if isinstance(annotation, type) and issubclass(annotation, Table):
        return annotation
    return next((found for part in get_args(annotation) if (found := _table_in(part))), None)
