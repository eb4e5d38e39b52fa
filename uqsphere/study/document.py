"""The tables of a study file, each declared once.

From a declaration follow how its table is read and what is said of its faults, the schema for editors and the tables
of docs/study-file.md (both in `uqsphere.study.reference`), and, where nothing else enters, the frozen noun itself.
Numbers that can scatter are taken as they come: `uqsphere.study.numbers` reads them where their quantity is known.
How values go together is asked in `uqsphere.study.resolve`, where a fault in one part does not hide those of others.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from typing import Annotated, Any, Final, get_args, get_origin

from pydantic import ConfigDict, Field, Strict, TypeAdapter, ValidationError, ValidationInfo
from pydantic.dataclasses import dataclass
from pydantic_core import core_schema

from uqsphere.mechanics.criteria import CRITERIA, PARAMETERS
from uqsphere.mechanics.pulses import PRESETS
from uqsphere.study.faults import Findings, Place, nearest, one_of, shown, suggestion
from uqsphere.study.numbers import fixed_value
from uqsphere.units import UNITS, Quantity, bare_number
from uqsphere.uq.joint import COPULAS, LEAST_DOF, MOST_DOF

__all__ = [
    "MOST_GAUGES",
    "SCENE",
    "Accuracy",
    "Analysis",
    "BarsTable",
    "Budget",
    "Dependence",
    "Document",
    "FamilyTable",
    "Gauge",
    "LimitTable",
    "MarginsTable",
    "ModelChoice",
    "OutputsTable",
    "ProductTable",
    "PulseTable",
    "SphereTable",
    "StrikerTable",
    "ToleranceRequest",
    "declared",
    "read_document",
]

Node = dict[str, Any]

#: tables of a scene whose numbers are entries of `uqsphere.quantities.INPUTS`
SCENE: Final = ("sphere", "bars", "striker", "pulse", "product")
FIDELITIES: Final = ("auto", "massless", "linear", "full")
METHODS: Final = ("qmc", "pce", "sobol", "form", "importance", "subset")
SHAPES: Final = ("rectangular", "trapezoid", "ramp", "half_sine", "two_peak", "step", "measured")
#: gauges of one scene, groups of inputs, members of any other list
MOST_GAUGES: Final = 20
_MOST_LISTED: Final = 200
#: rows of one stored chunk, `uqsphere.runner.chunks`
_MOST_ROWS: Final = 16_384
_MOST_SUGGESTIONS: Final = 50


# --- what a key can hold ----------------------------------------------------------------------------

Text = Annotated[str, Strict()]
Flag = Annotated[bool, Strict()]
Whole = Annotated[int, Strict()]
Real = Annotated[float, Strict()]
#: a number of the scene as the file has it: a number, a text with a unit, or the table of a distribution
Number = Any


class Misplaced(ValueError):
    """A fault of one part of a value: `at` is the way to it."""

    def __init__(self, message: str, *at: int | str) -> None:
        super().__init__(message)
        self.at = at


@dataclasses.dataclass(frozen=True)
class Check:
    """A mark on a type: `look` gives the value that stands, and raises ValueError for what cannot.

    `schema` says the same to editors: beside what the type says or, where `first` has it looked at before the type, in
    its place.
    """

    look: Callable[[Any], Any]
    schema: Callable[[], Node] = dict
    first: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> core_schema.CoreSchema:
        if self.first:
            return core_schema.no_info_before_validator_function(self.look, handler(source))
        return core_schema.no_info_after_validator_function(self.look, handler(source))

    def __get_pydantic_json_schema__(self, core: core_schema.CoreSchema, handler: Any) -> Node:
        return {**({} if self.first else handler(core)), **self.schema()}


@dataclasses.dataclass(frozen=True)
class Fixed:
    """A mark on a float: a fixed number with its unit in the file, in SI in the noun."""

    quantity: Quantity

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> core_schema.CoreSchema:
        return core_schema.with_info_plain_validator_function(self.read)

    def __get_pydantic_json_schema__(self, core: core_schema.CoreSchema, handler: Any) -> Node:
        return {"dimension": self.quantity.dimension}

    def read(self, raw: Any, info: ValidationInfo[Any]) -> Any:
        """SI value of what a file has; what Python gives is in SI already."""
        return raw if info.context is None else fixed_value(raw, self.quantity)


def within(low: float, high: float = math.inf, *, closed: bool = False) -> Check:
    """A number between two bounds, which are excluded unless `closed`."""
    if high == math.inf:
        due = f"from {low:g} upwards" if closed else f"above {low:g}"
    else:
        due = f"from {low:g} to {high:g}" if closed else f"between {low:g} and {high:g}, both excluded,"

    def look(value: float) -> float:
        if not (low <= value <= high if closed else low < value < high):
            raise ValueError(f"found {bare_number(value)}, a number {due} is due")
        return value

    least, most = ("minimum", "maximum") if closed else ("exclusiveMinimum", "exclusiveMaximum")
    return Check(look, lambda: {least: low} | ({} if high == math.inf else {most: high}))


def among(words: Sequence[str] | Callable[[], Iterable[str]]) -> Check:
    """One of some words, which are looked up only where they are needed if they are given as a function."""

    def known() -> list[str]:
        return list(words() if callable(words) else words)

    def look(value: Any) -> Any:
        if not isinstance(value, str):
            raise ValueError(f"found {shown(value)}, a word is due: {one_of(known())}")
        if value not in known():
            raise ValueError(f"found {shown(value)}, allowed: {one_of(known())}{suggestion(value, known())}")
        return value

    return Check(look, lambda: {"enum": known()}, first=True)


def _signal_units() -> Iterable[str]:
    from uqsphere.records.record import SIGNAL_UNITS

    return SIGNAL_UNITS


def several(least: int, what: str, most: int = _MOST_LISTED) -> Check:
    """A list with so many entries, each once."""

    def look(values: tuple[Any, ...]) -> tuple[Any, ...]:
        for index, value in enumerate(values):
            if value in values[:index]:
                raise Misplaced(f"{shown(value)} is named twice", index)
        if not least <= len(values) <= most:
            due = f"{least} or more are due" if len(values) < least else f"at most {most:,} are allowed"
            raise ValueError(f"found {len(values)} {what}, {due}")
        return values

    return Check(look, lambda: {"minItems": least})


def _in_order(values: tuple[float, ...]) -> tuple[float, ...]:
    if not 1 <= len(values) <= _MOST_LISTED:
        raise ValueError(f"found {len(values)} numbers, from 1 to {_MOST_LISTED} are due")
    return tuple(sorted(set(values)))


def _methods(value: Any) -> Any:
    """The word "auto" as a list."""
    if value != "auto" and not isinstance(value, (list, tuple)):
        hint = f'; write methods = ["{value}"]' if value in METHODS else ""
        raise ValueError(f'found {shown(value)}: "auto" or a list of {one_of(METHODS)} is due{hint}')
    return ("auto",) if value == "auto" else value


def _methods_schema() -> Node:
    return {"anyOf": [{"const": "auto"}, {"const": ["auto"]}, {"type": "array", "items": {"enum": list(METHODS)}}]}


def _together(values: tuple[str, ...]) -> tuple[str, ...]:
    if "auto" in values and len(values) > 1:
        raise Misplaced('"auto" stands alone', values.index("auto"))
    return values


def _fixed(dimension: str, symbol: str, lower: float = 0.0, display: str = "") -> Fixed:
    return Fixed(Quantity(name=dimension, symbol=symbol, dimension=dimension, lower=lower, display=display,
                          meaning=f"the {dimension}"))  # fmt: skip


def _window(values: tuple[float, ...]) -> tuple[float, ...]:
    if len(values) != 2:
        raise ValueError(f"found {len(values)} values, two are due: begin and end of the pulse in the record")
    if not values[0] < values[1]:
        raise ValueError(f"found {values[0]:g} s and {values[1]:g} s: the begin must come first")
    return values


Share = Annotated[Real, within(0.0, 1.0)]
Positive = Annotated[Real, within(0.0)]
Correlation = Annotated[Real, within(-1.0, 1.0)]
Shares = Annotated[tuple[Share, ...], Check(_in_order, lambda: {"minItems": 1})]
Names = Annotated[tuple[Text, ...], several(1, "names")]
Seconds = Annotated[float, _fixed("time", "t")]
#: an instant of a record, which may begin before 0
Instant = Annotated[float, _fixed("time", "t", -math.inf)]
Length = Annotated[float, _fixed("length", "d", display="m")]
Methods = Annotated[
    tuple[Annotated[Text, among((*METHODS, "auto"))], ...],
    several(1, "methods"),
    Check(_together),
    Check(_methods, _methods_schema, first=True),
]


def key(meaning: str, default: Any = None, *, default_is: str = "", due: str = "") -> Any:
    """A key of a table.

    meaning : one clause, for the reference and for editors
    default_is : the default in words, where its value does not say it
    due : the key must be given: what to add where it is missing
    """
    return Field(default=default, description=meaning, json_schema_extra={"default_is": default_is, "due": due})


# --- the tables -------------------------------------------------------------------------------------

#: no key beyond those declared
_CLOSED: Final = ConfigDict(extra="forbid", defer_build=True)


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class SphereTable:
    """The sphere."""

    material: Text | None = key(
        "name from `uqsphere list materials`; fills `E`, `nu`, `density` that are not given", default_is="none"
    )
    E: Number = key("Young's modulus", default_is="from the material")
    nu: Number = key("Poisson ratio, below 0.5", default_is="from the material")
    density: Number = key("density", default_is="from the material")
    radius: Number = key(
        "radius, not diameter; the sphere must fit its bars", due='add radius = "10 mm", half the diameter'
    )


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class BarsTable:
    """Both bars, alike in material and diameter."""

    material: Text | None = key("fills `E`, `nu`, `density`, `yield_strength` that are not given", default_is="none")
    E: Number = key("as for the sphere", default_is="from the material")
    nu: Number = key("as for the sphere", default_is="from the material")
    density: Number = key("as for the sphere", default_is="from the material")
    yield_strength: Number = key("only for the validity checks", default_is="from the material")
    diameter: Number = key("diameter of the bars", due='add diameter = "40 mm"')
    incident_length: Number = key(
        "length; with `infinite` it serves a validity check alone", default_is="required unless `infinite`"
    )
    receiving_length: Number = key("the same for the receiving bar", default_is="required unless `infinite`")
    incident_end: Number = key(
        'far end: `"free"`, `"absorbing"`, `"fixed"`, or a reflection coefficient from -1 (fixed) to 1 (free)',
        default_is='`"free"`',
    )
    receiving_end: Number = key("the same for the receiving bar", default_is='`"absorbing"`')
    receiving_damper: Text | None = key(
        "in place of `receiving_end`: a CSV beside the study with the columns `frequency` [Hz], `impedance_real` and "
        "`impedance_imag` [kg/s] of the far end",
        default_is="none",
    )
    end_radius: Number = key("radius of rounded ends at the sphere", default_is="flat")
    infinite: Flag = key("no reflections", False)
    rigid_contact: Flag = key("leaves the bars out of the contact stiffness, `1/E* = (1 - nu²)/E`", False)


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class StrikerTable:
    """The striker."""

    speed: Number = key("striker speed `v_0`; the pulse has the particle speed `v_0/2`", default_is="required")
    length: Number = key(
        "gives the pulse its duration `2 l_0/c_0`; not needed with `pulse.duration` or a step", default_is="required"
    )
    material: Text | None = key("a material of the bars, for `E` and `density`", default_is="that of the bars")
    E: Number = key("of a striker that is no piece of the bars", default_is="that of the bars")
    density: Number = key("of a striker that is no piece of the bars", default_is="that of the bars")
    diameter: Number = key("of a striker that is no piece of the bars", default_is="that of the bars")


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class PulseTable:
    """The incident pulse; `uqsphere.study.scene.PULSE_KEYS` says which keys go with which shape."""

    preset: Annotated[Text, among(tuple(PRESETS))] | None = key("a pulse of the paper's Fig. 2, in place of shape")
    shape: Annotated[Text, among(SHAPES)] = key("shape of the incident pulse", "rectangular")
    duration: Number = None
    rise: Number = None
    fall: Number = None
    t1: Number = None
    level1: Number = None
    t2: Number = None
    level2: Number = None
    valley: Number = None
    file: Text | None = key("record beside the study, with columns of time and strain")
    columns: tuple[Text, ...] = key("names of the columns: time, then strain", ())
    time_unit: Annotated[Text, among(tuple(UNITS["time"]))] | None = key("unit of the time")
    unit: Annotated[Text, among(_signal_units)] | None = key("unit of the signal")
    gauge_factor: Positive | None = key("of the gauges")
    excitation: Positive | None = key("supply of the bridge [V]")
    amplification: Positive | None = key("of the signal")
    active_arms: Positive | None = key("1 quarter, 2 half bridge, 2 (1 + nu) with gauges across")
    polarity: Annotated[Text, among(("auto", "tension", "compression"))] | None = key("what is positive in the record")
    window: Annotated[tuple[Instant, ...], Check(_window)] | None = key("begin and end of the pulse in the record")
    correct_dispersion: Flag | None = key("carry the wave from the gauge to the sphere")
    gauge_distance: Length | None = key("distance of the gauge from the sphere")
    gain: Number = None
    noise: Flag | None = key("the noise of the record becomes random inputs")


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class ProductTable:
    """How fine the product of crushing is."""

    A: Number = key('largest `t10`, a share with its unit: `"55 %"`', due='add A = "55 %"')
    b: Number = key('how fast `t10` rises with the specific energy, such as `"0.8 t/kWh"`', due='add b = "0.8 t/kWh"')


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class Gauge:
    """A strain gauge: its bar, and its distance from the sphere [m]."""

    bar: Annotated[Text, among(("incident", "receiving"))] = key(
        '`"incident"` or `"receiving"`', due='add bar = "incident"'
    )
    position: Length = key(
        "distance from the sphere, a length within the bar", due='add the distance from the sphere, position = "0.75 m"'
    )


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class ModelChoice:
    """Which mechanics, and how precisely; `horizon` [s]."""

    fidelity: Annotated[Text, among(FIDELITIES)] = key(
        '`"massless"`, `"linear"`, `"full"`, or the cheapest that is accurate enough, with `full` in rows where it is '
        "not",
        "auto",
    )
    tolerance: Annotated[Real, within(1e-12, 1e-2, closed=True)] = key(
        "relative error of the integration, in every quantity asked for; 1e-12 to 1e-2", 1e-6
    )
    first_loading_only: Flag = key("end the record when the first reflected wave is back", False)
    horizon: Seconds | None = key(
        "end of the record, a time",
        default_is="eight round trips of the longer bar; infinite bars: the pulse is over and both forces are below "
        "1 % of the largest",
    )
    compare_with_paper: Flag = key(
        "adds a table: the paper's printed massless formulas beside the corrected ones and the full model", False
    )


def _parameter(name: str) -> Fixed:
    """A parameter of a criterion, as `uqsphere.mechanics.criteria.PARAMETERS` has it."""
    part = PARAMETERS[name]
    return Fixed(Quantity(name=name, symbol=name, dimension=part.dimension, lower=part.lower, upper=part.upper,
                          meaning=f"the {part.meaning}"))  # fmt: skip


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class LimitTable:
    """A strength, and the quantity or criterion that is held against it."""

    quantity: Text | None = key("a quantity of `uqsphere list quantities`", default_is="required, or `criterion`")
    criterion: Annotated[Text, Check(lambda name: name, lambda: {"enum": list(CRITERIA)})] | None = key(
        "in place of `quantity`: a criterion of `uqsphere list criteria`, for the impact model", default_is="none"
    )
    modulus: Annotated[float, _parameter("modulus")] | None = key(
        "Weibull modulus of a weakest link; a strength that is a Weibull law has it already",
        default_is="that of the strength",
    )
    reference_volume: Annotated[float, _parameter("reference_volume")] | None = key(
        "volume on which the strength was measured", default_is="required by `weakest_link_volume`"
    )
    reference_area: Annotated[float, _parameter("reference_area")] | None = key(
        "area on which the strength was measured",
        default_is="required by `weakest_link_surface`, `weakest_link_rim`",
    )
    largest_energy: Annotated[float, _parameter("largest_energy")] | None = key(
        "`specific_energy`: upper bound of the fracture energy, whose law is then an upper-truncated lognormal",
        default_is="none",
    )
    rate_0: Annotated[float, _parameter("rate_0")] | None = key(
        "strain rate at which the strength has doubled: strengths in tension then grow with the rate of each sample",
        default_is="none",
    )
    strength: Number = key(
        "what it is held against: value or distribution, in the unit of the quantity",
        due='add a number such as "4 GPa", or a distribution',
    )
    aim: Annotated[Text, among(("survive", "break"))] = key(
        '`"survive"`: the quantity must stay below the strength; `"break"`: it must exceed it', "survive"
    )
    model_factor: Number = key(
        "factor on the quantity for what the model leaves out; value or distribution", default_is="`1`"
    )
    target: Share | None = key("largest accepted probability of missing the aim, between 0 and 1", default_is="none")
    fracture: Flag | None = key(
        "whether exceeding it breaks the sphere: `true` for criteria, pressures, tensions, forces and energies; "
        "`false` for one that is no fracture, say bars that must stay elastic",
        default_is="by the quantity",
    )


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class Dependence:
    """One rank correlation, Spearman's or Kendall's, for every pair of the names; `dof` of a Student t copula."""

    of: Annotated[tuple[Text, ...], several(2, "names", 1_000)] = key(
        "two or more names of random variables", (), due="add the names of two or more random inputs"
    )
    spearman: Correlation | None = key(
        "Spearman's rank correlation, between -1 and 1; or `kendall` in its place", default_is="required"
    )
    copula: Annotated[Text, among(COPULAS)] = key(
        f"how they depend: {one_of([f'`{shown(name)}`' for name in COPULAS])}", "gaussian"
    )
    kendall: Correlation | None = key("Kendall's rank correlation, between -1 and 1", default_is="none")
    dof: Annotated[Real, Check(lambda value: value, lambda: {"minimum": LEAST_DOF, "maximum": MOST_DOF})] | None = key(
        "degrees of freedom of a Student t copula, 1 to 1000; required there, and for no other", default_is="none"
    )


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class Accuracy:
    """Half-widths of the 95 % intervals asked for: mean and quantile over sd, sobol absolute, probability relative."""

    mean: Positive = 0.002
    quantile: Positive = 0.01
    sobol: Positive = 0.01
    probability: Positive = 0.05


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class Budget:
    """Where a run stops at the latest; `time` [s].

    `exhaust` spends all of it on an accuracy that is out of its reach; else such an accuracy is given up.
    """

    evaluations: Annotated[Whole, within(0.0)] = 2_000_000
    time: Seconds = 600.0
    exhaust: Flag = False


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class ToleranceRequest:
    """Distribution-free limits from independent runs: the share that they hold, with which confidence.

    `runs` are by default the fewest that give a two-sided interval.
    """

    coverage: Share = 0.95
    confidence: Share = 0.95
    runs: Annotated[Whole, within(0.0)] = 0


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class Analysis:
    """What is asked, how precisely, and at what cost.

    `cost` is what one evaluation of a black box takes [s]; None: it is measured.  `rows_per_call` rows go into one
    call of a black box, by their number if None; `time_limit` [s] ends an evaluation, none if None.
    """

    quantities: Names = key(
        "what is answered; quantities of limits are added",
        (),
        default_is='those of the limits, else `["p_max", "contact_time"]`',
    )
    accuracy: Accuracy = key(
        "half-widths of the 95 % intervals: mean and quantile relative to the standard deviation (half the 16-84 % "
        "range where it has none), sobol absolute, probability relative",
        Accuracy(),
    )
    budget: Budget = key(
        "where the run stops at the latest; see below for `exhaust`",
        Budget(),
        default_is='`{ evaluations = 2_000_000, time = "10 min", exhaust = false }`',
    )
    quantiles: Shares = key("between 0 and 1", (0.01, 0.05, 0.5, 0.95, 0.99))
    methods: Methods = key(
        f"or a list of {one_of([f'`{shown(name)}`' for name in METHODS])}", ("auto",), default_is='`"auto"`'
    )
    cost: Seconds | None = key(
        'what one evaluation of a black box takes, such as `"10 s"`; see below', default_is="measured"
    )
    on_failure: Annotated[Text, among(("abort", "bound", "drop"))] = key(
        'failed evaluations: `"abort"` at the first; `"bound"` counts each once as exceeding and once as not; '
        '`"drop"` leaves them out, up to 1 % (below 1,000 evaluations: what chance makes of 1 %)',
        "abort",
    )
    second_order: Flag = key("indices of all pairs of inputs as well", False)
    groups: Mapping[Text, Names] = key(
        "indices of inputs taken together, each group by a name of yours", {}, default_is="none"
    )
    tolerance_intervals: ToleranceRequest | None = key(
        "distribution-free limits: `coverage` and `confidence`, both 0.95 unless given, and `runs`, by default the "
        "fewest that give a two-sided interval",
        default_is="none",
    )
    rows_per_call: Annotated[Whole, within(1, _MOST_ROWS, closed=True)] | None = key(
        "rows in one call of a black box: [cluster.md](cluster.md)", default_is="by their number"
    )
    time_limit: Seconds | None = key(
        "longest time of one evaluation of a black box; one that takes longer has failed", default_is="none"
    )


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class FamilyTable:
    """Another number of the scene, and values of it."""

    path: Text | None = None
    values: tuple[Any, ...] | None = None


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class MarginsTable:
    """The inverse question."""

    solve: Text | None = key('the number that is free, such as `"striker.speed"`', default_is="required")
    between: tuple[Any, ...] | None = key("two values with units, in order", default_is="required")
    for_probability: Shares = key("probabilities that the quantity exceeds the strength", (0.01, 0.1, 0.5, 0.9, 0.99))
    for_survival: Shares | None = key(
        "probabilities of survival, added to those: 0.99 asks for a probability of fracture of 0.01",
        default_is="none",
    )
    for_fracture: Shares | None = key("probabilities of fracture, added as they are", default_is="none")
    family: FamilyTable | None = key(
        "a curve at each of some `values` of another number of the scene, its `path`", default_is="none"
    )
    bars_elastic: Flag = key(
        "also the value at which the bars yield, in the pulse and under the sphere in 1 % of the cases; told in any "
        "case where `p_max` is asked for",
        False,
    )
    against: Text | None = key(
        '`"specific_energy"`: every curve also over the specific energy imposed on the sphere', default_is="none"
    )


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class OutputsTable:
    """What a black box answers."""

    names: tuple[Text, ...] = key("names of the outputs", ())


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class Document:
    """A study file."""

    title: Text = key("heading of the report; not part of the study's hash", "", default_is="the file's name")
    seed: Annotated[Whole, within(0.0, closed=True)] = key("whole number; the same seed gives the same answers", 0)
    sphere: SphereTable | None = None
    bars: BarsTable | None = None
    striker: StrikerTable | None = None
    pulse: PulseTable | None = None
    product: ProductTable | None = None
    model: ModelChoice | None = None
    inputs: Mapping[Text, Number] | None = None
    outputs: OutputsTable | None = None
    limits: Mapping[Text, LimitTable] = Field(default_factory=dict)
    dependence: tuple[Dependence, ...] = ()
    gauges: tuple[Gauge, ...] = ()
    analysis: Analysis = Analysis()
    margins: MarginsTable | None = None


# --- reading ----------------------------------------------------------------------------------------

#: pydantic's name of a fault -> what is due there
_DUE: Final = {
    "string_type": "a text in quotes",
    "bool_type": "true or false",
    "int_type": "a whole number",
    "float_type": "a number",
    "tuple_type": "an array",
    "mapping_type": "a table",
    "dict_type": "a table",
    "dataclass_type": "a table",
    "dataclass_exact_type": "a table",
}


def read_document(data: dict[str, Any], findings: Findings) -> Document:
    """The tables of the file, without those parts that were faulty; each fault is noted."""
    adapter = TypeAdapter(Document)
    left = deepcopy(data)
    document = Document()
    # Taking a faulty part out can bring up one fault more at the most per level, so that a few turns do.
    for _ in range(8):
        try:
            document = adapter.validate_python(left, context=True)
            break
        except ValidationError as error:
            faults = error.errors(include_url=False)
        for count, fault in enumerate(faults):
            place: Place = tuple(fault["loc"])
            if not findings.touched(place):
                _note(fault, place, findings, suggest=count < _MOST_SUGGESTIONS)
            _take_out(left, place)
    _note_missing(document, data, (), findings)
    return document


def declared(table: Any) -> dict[str, Any]:
    """The keys of a table and what is declared of each."""
    return dict(table.__pydantic_fields__)


def known_keys(place: Place) -> list[str]:
    """The keys that the table at `place` can hold."""
    kind: Any = Document
    named = False
    for part in place:
        # an entry of a mapping or a list goes by a name of the user's, or by number: the table above says what it is
        if named or kind is None:
            named = False
            continue
        annotation = declared(kind)[part].annotation if part in declared(kind) else None
        named = get_origin(annotation) in (tuple, Mapping)
        kind = next(_kinds(annotation), None)
    return [] if kind is None else list(declared(kind))


def _kinds(annotation: Any) -> Iterator[Any]:
    """The tables that a type is made of."""
    if isinstance(annotation, type) and dataclasses.is_dataclass(annotation):
        yield annotation
    for part in get_args(annotation):
        yield from _kinds(part)


def _note(fault: Any, place: Place, findings: Findings, *, suggest: bool) -> None:
    """Note one fault that pydantic found."""
    kind, found, name = fault["type"], fault["input"], str(place[-1])
    if kind == "value_error":
        error = fault["ctx"]["error"]
        findings.add((*place, *getattr(error, "at", ())), str(error))
    elif kind == "unexpected_keyword_argument":
        keys = known_keys(place[:-1])
        near = suggestion(name, keys) if suggest else ""
        findings.add(place, f"unknown key {shown(name)}{near or f'; known here: {one_of(keys)}'}")
        # The key that was meant is not missing: it is misspelt, which has been said.
        meant = nearest(name, keys) if suggest else None
        findings.spoiled.update([(*place[:-1], meant)] if meant else [])
    elif kind in _DUE:
        findings.add(place, f"found {shown(found)}, where {_DUE[kind]} is due")
    else:
        findings.add(place, f"found {shown(found)}, which cannot stand here")


def _note_missing(table: Any, raw: Any, place: Place, findings: Findings) -> None:
    """Note every key that must be given and is not, here and in the tables below."""
    if isinstance(table, Mapping):
        parts = [(name, value) for name, value in table.items() if dataclasses.is_dataclass(value)]
    elif isinstance(table, tuple):
        parts = [(index, value) for index, value in enumerate(table) if dataclasses.is_dataclass(value)]
    else:
        parts = [(name, getattr(table, name)) for name in declared(table)]
        for name, entry in declared(table).items():
            due = (entry.json_schema_extra or {}).get("due")
            if due and name not in raw and findings.clean((*place, name)):
                findings.add((*place, name), f"{name} is missing: {due}")
    for part, value in parts:
        below = _child(raw, part)
        if isinstance(below, (dict, list)) and (isinstance(value, (Mapping, tuple)) or dataclasses.is_dataclass(value)):
            _note_missing(value, below, (*place, part), findings)


def _take_out(data: Any, place: Place) -> None:
    """Remove what stands at `place`; an array goes as a whole with one faulty element of it."""
    node = data
    for depth, part in enumerate(place[:-1]):
        child = _child(node, part)
        if isinstance(child, list) and depth + 2 == len(place):
            index = place[-1]
            if part in ("dependence", "gauges") and isinstance(index, int):
                child[index] = {}
            elif isinstance(node, dict):
                node.pop(part, None)
            return
        node = child
    if isinstance(node, dict):
        node.pop(place[-1], None)


def _child(node: Any, part: str | int) -> Any:
    if isinstance(node, dict):
        return node.get(part)
    return node[part] if isinstance(node, list) and isinstance(part, int) and part < len(node) else None
