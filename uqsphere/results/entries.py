"""The documents of a result folder: what they are made of, and those beside results.json.

Every table of a document is a frozen `Entry`.  A key that a run did not write has no place in `document()` either, so
that what is read and written again keeps its keys; keys that nothing here names are kept beside them.
"""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, NamedTuple, Self, TypeAlias, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    StrictBool,
    StrictFloat,
    StrictInt,
    StrictStr,
    StringConstraints,
    ValidationError,
    WrapSerializer,
    model_validator,
)

from uqsphere.errors import FolderError
from uqsphere.files import Json, load_document
from uqsphere.uq import Estimate

if TYPE_CHECKING:
    from uqsphere.mechanics.validity import Check


#: an entry while it is made, before its fields are checked
Fields: TypeAlias = dict[str, object]

# --- what the entries are made of -----------------------------------------------------------------------


def _be_share(key: str) -> str:
    if not (re.fullmatch(r"\d(?:\.\d+)?(?:e-\d+)?", key) and 0.0 < float(key) < 1.0):
        raise ValueError(f"{key[:60]!r} is no share between 0 and 1")
    return key


#: a number, whole or not as it was written
Number = StrictInt | StrictFloat
Count = Annotated[int, Field(strict=True, ge=0)]
Share = Annotated[StrictInt | StrictFloat, Field(ge=0.0, le=1.0)]
Name = Annotated[str, StringConstraints(strict=True, min_length=1, max_length=5000)]
#: a probability as a key, "0.05"; two numbers that differ have two keys, also close to 1
ShareKey = Annotated[
    StrictStr,
    BeforeValidator(lambda key: f"{key:.15g}" if isinstance(key, float) else key),
    AfterValidator(_be_share),
]
Aim = Literal["survive", "break"]


class Entry(BaseModel):
    """A table of a stored document."""

    model_config = ConfigDict(
        frozen=True,
        extra="allow",
        allow_inf_nan=False,
        defer_build=True,
        protected_namespaces=(),
        validate_by_name=True,
    )

    def document(self) -> dict[str, Json]:
        """Plain JSON values, with the keys that were given."""
        return self.model_dump(mode="json", by_alias=True, exclude_unset=True)


class Part(Entry):
    """A table that may be absent: it is empty then, and false; `NEEDS` names what it has where it is there."""

    NEEDS: ClassVar[tuple[str, ...]] = ()

    def __bool__(self) -> bool:
        return bool(self.model_fields_set)

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if self:
            lacking = [name for name in self.NEEDS if name not in self.model_fields_set]
            if lacking:
                raise ValueError(f"it lacks {', '.join(lacking)}")
        return self


_Content = TypeVar("_Content")


def _nothing_for_null(content: object) -> object:
    return {} if content is None else content


def _null_for_nothing(part: object, write: SerializerFunctionWrapHandler) -> object:
    return write(part) if part else None


#: a part that is absent, or null in the document
Maybe = Annotated[_Content, BeforeValidator(_nothing_for_null), WrapSerializer(_null_for_nothing)]


class Est(Part):
    """A number with its 95 % interval; an absent answer has value None and a reason."""

    NEEDS = ("value", "low", "high", "std_error", "method", "evaluations")

    value: Number | None = None
    low: Number | None = None
    high: Number | None = None
    std_error: Number | None = None
    method: StrictStr = ""
    evaluations: Number = 0
    reason: StrictStr | None = None

    @model_validator(mode="before")
    @classmethod
    def _told(cls, content: object) -> object:
        return content.as_dict() if isinstance(content, Estimate) else content

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.low is not None and self.high is not None and self.low > self.high:
            raise ValueError("its interval ends before it begins")
        return self

    @classmethod
    def of(cls, value: float | None, low: float | None = None, high: float | None = None) -> Self:
        """A number with its interval, of which nothing else is known."""
        return cls(value=value, low=low, high=high, std_error=None, method="", evaluations=0)

    @property
    def number(self) -> float:
        """The value, where it is known to be there."""
        assert self.value is not None
        return float(self.value)


def _be_probability(estimate: Est) -> Est:
    # its interval may go a little beyond by rounding
    if estimate.value is not None and not 0.0 <= estimate.value <= 1.0:
        raise ValueError(f"found {estimate.value}, no probability")
    return estimate


Probability = Annotated[Est, AfterValidator(_be_probability)]
Ests = dict[Name, Est]
Quantiles = dict[ShareKey, Est]
Range = tuple[Number, Number]


class CurvePoint(NamedTuple):
    """A value of the free scalar, the probability of exceeding there, and its 95 % interval."""

    value: Number
    probability: Share
    low: Number
    high: Number


Curve = tuple[CurvePoint, ...]
#: the status of a failed evaluation, as a key
Status = Annotated[StrictStr, StringConstraints(pattern=r"^-?\d{1,6}$")]


class CheckEntry(Part):
    """A validity check: shares of the samples in each grade; `share` counts warnings and failures."""

    NEEDS = ("check", "share", "worst", "text")

    check: StrictStr = ""
    share: Share = 0.0
    share_information: Share = 0.0
    share_warning: Share = 0.0
    share_failure: Share = 0.0
    worst: Number | None = None
    text: StrictStr = ""

    @classmethod
    def of(cls, row: Check) -> Self:
        """A check of the mechanics."""
        return cls(share=row.share_warning + row.share_failure, **asdict(row))


class CarriedEntry(Part):
    """A strength carried from its test by each carrier: the free number at the target, `solve`, or where nothing is
    solved for the probability of missing the aim; the carriers with the lowest and the highest number; by each carrier
    the probability of missing the aim as planned, whether the target is met, and the free number at every probability
    of exceeding that is asked for."""

    NEEDS = ("force", "energy", "centre", "lowest", "highest")

    solve: StrictStr = ""
    force: Maybe[Est] = Field(default_factory=Est)
    energy: Maybe[Est] = Field(default_factory=Est)
    centre: Maybe[Est] = Field(default_factory=Est)
    lowest: StrictStr = ""
    highest: StrictStr = ""
    miss: dict[Name, Probability] = Field(default_factory=dict)
    met: dict[Name, StrictBool | None] = Field(default_factory=dict)
    values: dict[Name, Quantiles] = Field(default_factory=dict)

    def by_carrier(self) -> dict[str, Est]:
        """What each carrier answers."""
        return {"force": self.force, "energy": self.energy, "centre": self.centre}

    def safe(self, aim: Aim) -> str:
        """The carrier on the safe side: to survive the least number that is allowed, to break the largest; of the
        probabilities of missing the aim the largest."""
        return self.lowest if self.solve and aim == "survive" else self.highest


# --- manifest, study and samples --------------------------------------------------------------------------


class ExecutorEntry(Part):
    """Where the rows were evaluated."""

    NEEDS = ("kind", "workers", "why")

    kind: StrictStr = ""
    workers: Count = 0
    why: StrictStr = ""
    seconds_per_evaluation: Number | None = None


class PricesEntry(Part):
    """What an evaluation costs, and where the choice between sampling and a surrogate turns."""

    cost_seconds_per_evaluation: Number | None = None
    crossover_seconds_per_evaluation: Number | None = None
    balance_seconds_per_evaluation: Number | None = None
    affordable_evaluations: Number | None = None


class Manifest(Entry):
    """The content of manifest.json: versions, platform, counts and times, which may differ between two runs."""

    versions: dict[Name, StrictStr] = Field(default_factory=dict)
    platform: dict[Name, StrictStr] = Field(default_factory=dict)
    seed: Count | None = None
    hash: StrictStr = ""
    evaluations: Count = 0
    evaluations_reused: Count = 0
    seconds: dict[Name, Number] = Field(default_factory=dict)
    speed_error_seconds: tuple[Number, ...] = ()
    stopped_by_time: StrictBool = False
    interrupted: StrictBool = False
    executor: Maybe[ExecutorEntry] = Field(default_factory=ExecutorEntry)
    finished: StrictStr = ""
    damaged_chunks: tuple[StrictStr, ...] = ()
    plan: Maybe[PricesEntry] = Field(default_factory=PricesEntry)


class LawTable(Entry):
    """A law as study.resolved.json has it."""

    dist: StrictStr
    parameters: dict[Name, Number]
    given: dict[Name, Number]
    lower: Number | None
    upper: Number | None
    data: tuple[Number, ...]
    draws: tuple[tuple[Number, ...], ...] = ()
    censored: tuple[StrictBool | Number, ...] = ()


class LimitTable(Entry):
    """A limit as study.resolved.json has it."""

    quantity: StrictStr
    aim: Aim
    target: Share | None
    strength: Number | Literal["random"]
    model_factor: Number | Literal["random"]


class AccuracyTable(Entry):
    """Half-widths of the 95 % intervals that were asked for."""

    mean: Number | None = None
    quantile: Number | None = None
    sobol: Number | None = None
    probability: Number | None = None
    curve: Number = 0.02


class BudgetTable(Entry):
    """What the run may take."""

    evaluations: Count
    time: Number


class AnalysisTable(Entry):
    """What the study asks for."""

    quantities: tuple[StrictStr, ...]
    on_failure: Literal["abort", "bound", "drop"]
    accuracy: AccuracyTable
    budget: BudgetTable
    rows_per_call: Count | None = None
    at_once: Count = 1
    time_limit: Number | None = None


class SourceTable(Entry):
    """Where a value of the library comes from, and whether the source was seen."""

    text: StrictStr
    seen: StrictBool


class TieTable(Entry):
    """Variables that depend on each other."""

    of: Annotated[tuple[StrictStr, ...], Field(min_length=1)]
    copula: StrictStr
    spearman: Number | None = None
    kendall: Number | None = None
    dof: Number | None = None


class Resolved(Entry):
    """The content of study.resolved.json: SI, every default explicit."""

    title: StrictStr = ""
    hash: StrictStr = ""
    seed: Count | None = None
    written_by: StrictStr = ""
    kind: Literal["scene", "black box"]
    fixed: dict[Name, Number]
    random: dict[Name, LawTable]
    options: dict[Name, Json] = Field(default_factory=dict)
    materials: dict[Name, StrictStr] = Field(default_factory=dict)
    sources: dict[Name, SourceTable] = Field(default_factory=dict)
    limits: dict[Name, LimitTable]
    dependence: tuple[TieTable, ...] = ()
    analysis: AnalysisTable
    overrides: tuple[StrictStr, ...] = ()
    made_up: tuple[StrictStr, ...] = ()
    model_reference: StrictStr | None = None
    model_digest: StrictStr | None = None


class SampleNames(Entry):
    """The content of samples.json: the names of the columns."""

    inputs: tuple[StrictStr, ...]
    quantities: tuple[StrictStr, ...]


# --- sliders.json: what a page needs to answer for other sizes, speeds and stiffnesses without a run --------


class AxisEntry(Entry):
    """An input of the fitted rows: its value, or the `logarithm` of it, is middle + half · x with x in [-1, 1]."""

    name: Name
    logarithm: StrictBool
    middle: Number
    half: Number


class SliderEntry(Entry):
    """A number that may be moved between `low` and `high` (SI); the study has it at `base`.

    At every one of the `nodes`, ascending values of the number, the rows of the sample have the centre and the spread
    that its law then has: of the logarithm, half the way from the quantile at 16 % to that at 84 %.
    """

    name: Name
    low: Number
    high: Number
    base: Number
    nodes: tuple[Number, ...]
    centres: tuple[Number, ...]
    spreads: tuple[Number, ...]


class SurfaceEntry(Entry):
    """ln of a quantity as the sum of coefficients times products of powers of the inputs' x, in the order of the axes.

    `error` is what 95 % of rows that the fit has not seen keep to, in ln.
    """

    powers: tuple[tuple[Count, ...], ...]
    coefficients: tuple[Number, ...]
    error: Number


class WayEntry(Entry):
    """A way to break with an assumed strength: its laws at the weak end, in the middle and at the strong end.

    `scales`: where a strength hangs on a slider, the logarithm of what it is multiplied by at the slider's nodes.
    """

    quantity: Name
    laws: tuple[LawTable, LawTable, LawTable]
    scales: dict[Name, tuple[Number, ...]] = Field(default_factory=dict)


class Sliders(Entry):
    """Sliders, surfaces by quantity, and assumed ways by their names; where there are none, `reason` says why."""

    reason: StrictStr = ""
    evaluations: Count = 0
    axes: tuple[AxisEntry, ...] = ()
    sliders: tuple[SliderEntry, ...] = ()
    surfaces: dict[Name, SurfaceEntry] = Field(default_factory=dict)
    rough: dict[Name, StrictStr] = Field(default_factory=dict)
    ways: dict[Name, WayEntry] = Field(default_factory=dict)


# --- reading --------------------------------------------------------------------------------------------

_Entry = TypeVar("_Entry", bound=Entry)

#: pydantic's name of a fault -> what is said of it
_SAID = {
    "missing": "it is missing",
    "string_type": "a text is due",
    "bool_type": "true or false is due",
    "dict_type": "a table is due",
    "model_type": "a table is due",
    "model_attributes_type": "a table is due",
    "tuple_type": "a list is due",
    "int_type": "a number is due",
    "float_type": "a number is due",
}
#: steps of a place that name an alternative of pydantic's, not a key
_ALTERNATIVES = frozenset({"int", "float", "bool", "str", "Est", "[key]", "constrained-int", "constrained-float"})


def read_entry(path: Path, kind: type[_Entry]) -> _Entry:
    """A document of a result folder.

    Raises FolderError when it is missing, damaged or not what a run writes.
    """
    return checked_entry(path, load_document(path), kind)


def checked_entry(path: Path, content: object, kind: type[_Entry]) -> _Entry:
    """What was read from a file, with its fault in one sentence where it is not what a run writes."""
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        raise FolderError(f"{path} is not what a run writes: {fault_of(error)}") from None
    except RecursionError:
        raise FolderError(f"{path} is not what a run writes: it is nested too deep") from None


def fault_of(error: ValidationError) -> str:
    """The first fault of a document: its place, and what is due there."""
    fault = error.errors(include_url=False, include_context=False)[0]
    steps = [step for step in fault["loc"] if step not in _ALTERNATIVES]
    place = "".join(f"[{step}]" if isinstance(step, int) else f".{str(step)[:60]}" for step in steps)
    said = _SAID.get(fault["type"], fault["msg"].removeprefix("Value error, "))
    return f"{place.removeprefix('.')}: {said}" if place else said


def read_manifest(folder: Path) -> Manifest:
    """manifest.json of a result folder."""
    return read_entry(folder / "manifest.json", Manifest)


def read_resolved(folder: Path) -> Resolved:
    """study.resolved.json of a result folder."""
    return read_entry(folder / "study.resolved.json", Resolved)


# --- answers of inverse questions ---------------------------------------------------------------------------


class LognormalEntry(Part):
    """The lognormal curve beside a computed one, or why there is none."""

    NEEDS = ("median", "dispersion")

    median: Maybe[Est] = Field(default_factory=Est)
    dispersion: Maybe[Est] = Field(default_factory=Est)
    rising: StrictBool | None = None
    largest_gap: Number = 0.0
    largest_gap_at: Number = 0.0
    reason: StrictStr | None = None


class BandEntry(Part):
    """How well a curve is known."""

    NEEDS = ("half_width", "asked", "evaluations")

    half_width: Number = 0.0
    asked: Number = 0.0
    evaluations: Count = 0
    needed: Number | None = None


class MemberEntry(Entry):
    """A curve at another value of another number."""

    value: Number
    values: Quantiles
    curve: Curve
    lognormal: Maybe[LognormalEntry] = Field(default_factory=LognormalEntry)
    reason: StrictStr | None = None
    band: Maybe[BandEntry] = Field(default_factory=BandEntry)


class FamilyEntry(Part):
    """Curves at other values of another number."""

    NEEDS = ("path", "members")

    path: StrictStr = ""
    members: tuple[MemberEntry, ...] = ()


class AgainstEntry(Part):
    """The curve over another quantity than the free scalar."""

    NEEDS = ("quantity", "unit", "values", "curve")

    quantity: StrictStr = ""
    unit: StrictStr = ""
    values: Quantiles = Field(default_factory=dict)
    curve: Curve = ()
    lognormal: Maybe[LognormalEntry] = Field(default_factory=LognormalEntry)
    reason: StrictStr | None = None


class FractilesOf(Part):
    """Which fractiles a factor is the ratio of."""

    NEEDS = ("strength", "demand")

    strength: Share = 0.0
    demand: Share = 0.0


class FactorsEntry(Part):
    """Strength over demand: of their medians, and of two fractiles."""

    medians: Number = 0.0
    fractiles: Number = 0.0
    fractiles_of: Maybe[FractilesOf] = Field(default_factory=FractilesOf)
    reason: StrictStr | None = None


class PartialFactor(Entry):
    """An input at the design point, its characteristic value, and their ratio."""

    design: Number
    characteristic: Number
    factor: Number


class LostEntry(Part):
    """Which inputs a margin is lost to: importance factors and partial factors."""

    shares: dict[Name, Number] = Field(default_factory=dict)
    partial: dict[Name, PartialFactor] = Field(default_factory=dict)
    reason: StrictStr | None = None


class MarginOpenEntry(Part):
    """What few tests leave open of the value; `sure` holds with the confidence given."""

    tests: Count = 0
    stopped: Count = 0
    laws: Count = 0
    low: Number | None = None
    high: Number | None = None
    sure: Number | None = None
    confidence: Share = 0.0
    mean_law: Number | None = None
    sd_log: Number | None = None
    beyond: Number | None = None
    reason: StrictStr | None = None


class MoreTestsEntry(Part):
    """How many more tests decide the target, and how many give the value."""

    tests: Count = 0
    known_to: Number = 0.0
    to_know_the_value: Count | None = None
    to_settle: Count | None = None
    reason: StrictStr | None = None


class SplitEntry(Part):
    """Standard deviations of the logarithm of the value, by where they come from."""

    scatter: Number | None = None
    ignorance: Number | None = None
    numerical: Number | None = None


class BarsEntry(Part):
    """When the bars yield: by the pulse, and under the contact."""

    yield_strength: Number = 0.0
    pulse_stress: Number = 0.0
    pulse_elastic: StrictBool = True
    pulse_value: Number | None = None
    contact_probability: Number = 0.0
    contact: Maybe[Est] = Field(default_factory=Est)
    reason: StrictStr | None = None
    yields_at: dict[ShareKey, Share] = Field(default_factory=dict)
    contact_everywhere: StrictStr | None = None


class ValidityAtEntry(Part):
    """Validity checks at the answer, and the medians of force and energy there."""

    NEEDS = ("value", "samples", "checks")

    value: Number = 0.0
    samples: Count = 0
    checks: tuple[CheckEntry, ...] = ()
    medians: dict[Name, Number] = Field(default_factory=dict)


class MarginEntry(Entry):
    """Values of the free scalar at probabilities of exceeding a limit, the curve, and what the margin is made of."""

    solve: StrictStr
    unit: StrictStr
    values: Quantiles
    curve: Curve
    lognormal: Maybe[LognormalEntry] = Field(default_factory=LognormalEntry)
    family: Maybe[FamilyEntry] = Field(default_factory=FamilyEntry)
    against: Maybe[AgainstEntry] = Field(default_factory=AgainstEntry)
    band: Maybe[BandEntry] = Field(default_factory=BandEntry)
    probability: Number | None = None
    value: Maybe[Est] = Field(default_factory=Est)
    factors: Maybe[FactorsEntry] = Field(default_factory=FactorsEntry)
    lost_to: Maybe[LostEntry] = Field(default_factory=LostEntry)
    ignorance: Maybe[MarginOpenEntry] = Field(default_factory=MarginOpenEntry)
    more_tests: Maybe[MoreTestsEntry] = Field(default_factory=MoreTestsEntry)
    split: Maybe[SplitEntry] = Field(default_factory=SplitEntry)
    bars: Maybe[BarsEntry] = Field(default_factory=BarsEntry)
    validity: Maybe[ValidityAtEntry] = Field(default_factory=ValidityAtEntry)
    also: Ests = Field(default_factory=dict)
