"""What a run tells, declared once: results.json is `Results`, a row of answers.csv is an `Answer`.

Numbers are in SI units; one that does not exist is None.  A decision holds values and codes;
sentences are made of them in `uqsphere.report`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import StrEnum
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal, NamedTuple

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

#: version of results.json
SCHEMA_VERSION: Final = 3


def _finite(number: Any) -> Any:
    return None if isinstance(number, float) and not math.isfinite(number) else number


#: a number; what is not finite is None
Finite = Annotated[float | None, BeforeValidator(_finite)]
Aim = Literal["survive", "break"]
IndexMethod = Literal["", "chaos", "pairs"]
VerdictWord = Literal["met", "not met", "undecided", "not established", "no target"]
#: why a run ended; empty while it goes on
Stop = Literal["", "accurate", "budget", "cap", "time", "interrupted", "no gain"]
Grade = Literal["ok", "note", "warning", "failure"]


class Part(BaseModel):
    """A part of the results: frozen, without further keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


# --- answers --------------------------------------------------------------------------------------


class Kind(StrEnum):
    """Every kind of answer; `KINDS` says what each means."""

    MEAN = "mean"
    SD = "sd"
    QUANTILE = "quantile"
    CENSORED_SHARE = "censored_share"
    SOBOL_FIRST = "sobol_first"
    SOBOL_TOTAL = "sobol_total"
    SOBOL_SECOND = "sobol_second"
    SHAPLEY = "shapley"
    EXCEEDANCE_PROBABILITY = "exceedance_probability"
    FAILURE_PROBABILITY = "failure_probability"
    RELIABILITY_INDEX = "reliability_index"
    SAFETY_FACTOR = "safety_factor"
    CURVE = "curve"
    MARGIN = "margin"
    DESIGN_POINT = "design_point"
    DRIVER = "driver"
    MODE_SHARE = "mode_share"
    TIME_AT_FRACTURE = "time_at_fracture"
    FORCE_AT_FRACTURE = "force_at_fracture"
    ENERGY_AT_FRACTURE = "energy_at_fracture"
    MORRIS = "morris"
    DELTA = "delta"
    PAWN = "pawn"
    HDMR = "hdmr"
    ERROR = "error"


class KindEntry(NamedTuple):
    """What a kind of answer is.

    subject : what it is an answer on: quantity, limit, fracture, or run
    meaning : in words
    at : what the column `at` holds, empty where it holds nothing
    unit : of the value: a unit, or whose unit it is
    """

    subject: str
    meaning: str
    at: str
    unit: str


#: what each kind of answer means
KINDS: Final[Mapping[Kind, KindEntry]] = MappingProxyType(
    {
        Kind.MEAN: KindEntry("quantity", "mean", "", "the quantity's"),
        Kind.SD: KindEntry("quantity", "standard deviation", "", "the quantity's"),
        Kind.QUANTILE: KindEntry("quantity", "quantile", "probability", "the quantity's"),
        Kind.CENSORED_SHARE: KindEntry(
            "quantity",
            "share of the rows that are right-censored: the record ends too early",
            "",
            "1",
        ),
        Kind.SOBOL_FIRST: KindEntry("quantity", "first-order Sobol' index", "input", "1"),
        Kind.SOBOL_TOTAL: KindEntry("quantity", "total Sobol' index", "input", "1"),
        Kind.SOBOL_SECOND: KindEntry(
            "quantity", "second-order Sobol' index", "both inputs, with a comma", "1"
        ),
        Kind.SHAPLEY: KindEntry("quantity", "Shapley effect (dependent inputs)", "input", "1"),
        Kind.EXCEEDANCE_PROBABILITY: KindEntry(
            "limit", "probability that the demand exceeds the strength", "", "1"
        ),
        Kind.FAILURE_PROBABILITY: KindEntry(
            "limit",
            "failure probability: of exceedance for the aim survive, of its complement for break",
            "empty, or what is assumed otherwise",
            "1",
        ),
        Kind.RELIABILITY_INDEX: KindEntry(
            "limit", "reliability index of the failure probability", "", "1"
        ),
        Kind.SAFETY_FACTOR: KindEntry(
            "limit", "median strength over median demand", "what it compares", "1"
        ),
        Kind.CURVE: KindEntry(
            "limit", "probability of exceedance along the free number", "free number", "1"
        ),
        Kind.MARGIN: KindEntry(
            "limit",
            "free number at a probability of exceedance",
            "probability, or what is assumed otherwise",
            "the free number's",
        ),
        Kind.DESIGN_POINT: KindEntry(
            "limit", "most probable point of failure (FORM)", "variable", "the variable's"
        ),
        Kind.DRIVER: KindEntry(
            "limit",
            "change of the failure probability per standard deviation of an input",
            "variable",
            "1",
        ),
        Kind.MODE_SHARE: KindEntry(
            "fracture", "share of the fractures in which this limit is exceeded first", "limit", "1"
        ),
        Kind.TIME_AT_FRACTURE: KindEntry("fracture", "quantile of the time", "probability", "s"),
        Kind.FORCE_AT_FRACTURE: KindEntry("fracture", "quantile of the force", "probability", "N"),
        Kind.ENERGY_AT_FRACTURE: KindEntry(
            "fracture", "quantile of the energy", "probability", "J"
        ),
        Kind.MORRIS: KindEntry("quantity", "Morris: mean absolute elementary effect", "input", "1"),
        Kind.DELTA: KindEntry("quantity", "Borgonovo's delta", "input", "1"),
        Kind.PAWN: KindEntry("quantity", "PAWN: median Kolmogorov-Smirnov distance", "input", "1"),
        Kind.HDMR: KindEntry("quantity", "total index by RS-HDMR", "input", "1"),
        Kind.ERROR: KindEntry("run", "largest error / tolerance", "model runs", "1"),
    }
)


class Answer(Part):
    """One row of answers.csv: a number with its 95 % interval."""

    subject: str = Field(
        description="a quantity, limits.NAME, modes.NAME (assumed strength), fracture, or run"
    )
    answer: Kind = Field(description="kind of answer")
    at: float | str = Field(default="", description="place of the answer, by its kind")
    value: Finite = Field(default=None, description="the estimate; none where there is no answer")
    low: Finite = Field(default=None, description="lower end of the 95 % interval")
    high: Finite = Field(default=None, description="upper end of the 95 % interval")
    low_unseen: Finite = Field(
        default=None, description="lower end that also allows for what no model run shows"
    )
    high_unseen: Finite = Field(
        default=None, description="upper end that also allows for what no model run shows"
    )
    std_error: Finite = Field(
        default=None, description="standard error, where the interval rests on one"
    )
    unit: str = Field(description="SI unit")
    method: str = Field(default="", description="how it was estimated")
    runs: int = Field(default=0, description="model runs behind it")
    note: str = Field(
        default="", description="why there is no value or interval, or what to read it with"
    )


class Range(Part):
    """A number with its interval."""

    value: Finite = None
    low: Finite = None
    high: Finite = None
    note: str = Field(default="", description="why there is no value")


# --- the study ------------------------------------------------------------------------------------


class FreeNumber(Part):
    """The free number of [margins]."""

    path: str = Field(description="dotted key, for example striker.speed")
    meaning: str
    planned: Finite = Field(description="its value in the study")
    low: float = Field(description="lower end of margins.between")
    high: float = Field(description="upper end of margins.between")
    unit: str = Field(description="unit that the page shows it in")


class Strength(Part):
    """A strength as a distribution."""

    text: str = Field(description="in words")
    unit: str = Field(description="unit that the page shows it in")
    median: Finite
    p05: Finite = Field(description="5 % quantile")
    p95: Finite = Field(description="95 % quantile")
    density: Sequence[Sequence[Finite]] | None = Field(
        default=None, description="values and their densities"
    )


class LimitEntry(Part):
    """A limit of the study, or a failure mode with a strength of the library."""

    mode: str = Field(description="failure mode")
    quantity: str = Field(description="quantity that is held against the strength")
    aim: Aim
    target: float = Field(
        description="largest failure probability that is accepted; without one of its own the "
        "least of the limits with the same aim"
    )
    has_target: bool = Field(description="whether the study gives this target")
    allowable: float = Field(description="probability of exceedance at the target")
    criterion: str | None
    fracture: bool = Field(description="whether exceeding it means that the sphere breaks")
    assumed: bool = Field(description="whether the strength is the library's")
    tests: int | None = Field(description="number of tests behind the strength")
    strength: Strength
    source: str
    source_checked: bool = Field(default=True, description="whether the source itself was read")
    test_points: Sequence[Sequence[float]] | None = Field(
        default=None,
        description="tests on the axis of the free number: values, shares broken, 1 if "
        "right-censored",
    )
    platens: str = Field(default="", description="platens of the tests")
    size_law: str = Field(default="", description="how the strength follows the size of the sphere")


class QuantityEntry(Part):
    """A quantity whose distribution is answered."""

    meaning: str
    unit: str = Field(description="unit that the page shows it in")
    range: tuple[Finite, Finite, Finite] = Field(description="5 %, 50 % and 95 % quantiles")
    method_of_indices: IndexMethod
    density: Sequence[Sequence[Finite]] | None = Field(description="values and their densities")
    onset: Finite = Field(
        default=None,
        description="of a contact pressure: where the first contact starts to yield, at the means",
    )
    expansion_error: Finite = Field(
        default=None,
        description="share of the variance that the polynomial chaos does not explain, at model "
        "runs that it was not fitted to",
    )
    held_out: Sequence[Sequence[float]] | None = Field(
        default=None, description="some of these runs: outputs, and what the chaos predicts"
    )


class InputEntry(Part):
    """An input, fixed or random."""

    meaning: str
    unit: str = Field(description="unit that the page shows it in")
    source: str
    source_checked: bool = Field(description="whether the source itself was read")
    mean: Finite
    sd: Finite
    p05: Finite
    p95: Finite
    fixed: bool
    distribution: str


class CorrelationEntry(Part):
    """Correlation of two quantities over the sample."""

    of: list[str]
    value: float


class DependenceEntry(Part):
    """A dependence between random variables."""

    of: list[str]
    text: str


class StudyEntry(Part):
    """The study as the user gave it."""

    title: str
    hash: str = Field(description="SHA-256 of the study's meaning")
    kind: str = Field(description="rig, or black box")
    seed: int
    description: list[str] = Field(description="two lines: what was studied, and its strengths")
    free: FreeNumber | None
    overrides: list[str] = Field(description="what --set changed")
    warnings: list[str]
    quantities: dict[str, QuantityEntry]
    limits: dict[str, LimitEntry]
    modes: dict[str, LimitEntry] = Field(description="failure modes with assumed strengths")
    not_judged: dict[str, str] = Field(description="failure modes that are not judged, and why")
    dependence: list[DependenceEntry]
    correlations: list[CorrelationEntry] = Field(
        default=[], description="correlation of the quantities of interest, in pairs"
    )


# --- decisions ------------------------------------------------------------------------------------


class CurvePoint(Part):
    """Failure probability at one value of the free number."""

    at: float
    value: Finite
    low: Finite = None
    high: Finite = None


DoubtCode = Literal[
    "computation", "tests", "distribution", "contact law", "carrier", "tie", "assumed strength"
]


MarginNote = Literal["", "everywhere", "nowhere"]


class Doubt(Part):
    """One thing that the number to use rests on: a row of the certificate."""

    code: DoubtCode
    subject: str = Field(description="the limit or failure mode, limits.NAME or modes.NAME")
    option: str = Field(
        default="", description="what is taken otherwise: a distribution, a carrier, a law"
    )
    target: float = Field(description="failure probability that is accepted here")
    margin: Finite = Field(
        description="free number at the target under this doubt, with the other failure modes"
    )
    margin_note: MarginNote = Field(
        default="", description="why there is no margin: the target is kept everywhere, or nowhere"
    )
    at_number: Range = Field(
        default=Range(), description="failure probability at the number to use"
    )
    at_plan: Range = Field(default=Range(), description="failure probability at the plan")
    governs: bool = Field(default=False, description="whether the number to use is this margin")
    counts: bool = Field(
        default=True, description="whether it counts as fracture; damage is shown only"
    )
    tests: int | None = Field(default=None, description="number of tests behind the strength")


CaveatCode = Literal[
    "assumed strength", "model range", "size", "unit", "plausibility", "synthetic tests"
]


class Caveat(Part):
    """Why a verdict is not established."""

    code: CaveatCode
    subject: str = Field(description="check, key, limit or failure mode that it is about")
    value: Finite = Field(default=None, description="what was reached or written")
    bound: Finite = Field(default=None, description="what is allowed or usual")
    text: str = Field(default="", description="words of the check or warning")


class LibraryRange(Part):
    """What a strength of the library, which governs, leaves open."""

    mode: str
    middle: Finite = Field(description="number to use with the strength at its middle")
    weak: Finite = Field(description="number to use at the weak end of the library's range")
    strong: Finite = Field(description="number to use at the strong end")
    own: Finite = Field(description="number to use by the study's own limits only")


class TestsGain(Part):
    """What a number of tests would buy."""

    tests: int
    low: Finite
    median: Finite
    high: Finite


RemedyCode = Literal[
    "nothing",
    "set a target",
    "change the plan",
    "tighten the accuracy",
    "widen the range",
    "measure the strength",
    "test more",
    "test the lower tail",
    "yielding contacts",
    "check the input",
    "replace the synthetic tests",
    "leave the model's range",
]


class Remedy(Part):
    """What to do next, for the doubt that governs."""

    code: RemedyCode
    subject: str = Field(
        default="", description="limit, failure mode, key or check that it is about"
    )
    at_best: Finite = Field(default=None, description="number to use once this doubt is gone")
    gains: list[TestsGain] = Field(default=[], description="number to use by number of tests")


class Use(Part):
    """The number to use."""

    path: str = Field(description="dotted key of the free number")
    value: float = Field(description="conservative value")
    safe_end: Literal["largest", "smallest"] = Field(
        description="whether it is the largest or the smallest value to use"
    )
    planned: Finite
    safety_factor: Finite = Field(description="number to use over planned value, or its inverse")
    best: Range = Field(description="best estimate, and its range by all doubts")


class EvidenceEntry(Part):
    """What the study's crushing tests say of a strength of the library."""

    mode: str
    tests: int = Field(description="number of tests")
    weak: float = Field(description="probability of the tests by the weak end of its range")
    middle: float = Field(description="probability of the tests by its middle")
    strong: float = Field(description="probability of the tests by the strong end of its range")
    refuted: bool = Field(description="whether the mode is left out: refuted by the strong end too")
    raised: float = Field(description="factor on the weak end that the tests leave")


class Decision(Part):
    """The decision for one aim: survive or break."""

    aim: Aim
    limits: list[str] = Field(description="limits of the study that it decides on")
    modes: list[str] = Field(
        default=[], description="failure modes with assumed strengths behind it"
    )
    verdict: VerdictWord
    target: Finite = Field(description="failure probability that is accepted")
    governing: str = Field(
        description="limit or failure mode that governs, limits.NAME, modes.NAME"
    )
    use: Use | None = Field(
        description="number to use; none without [margins] or where none is safe"
    )
    blocked_by: str = Field(
        default="", description="limit or mode that is over its target everywhere"
    )
    own: Finite = Field(default=None, description="number to use by the study's own limits only")
    probability: Range = Field(description="failure probability at the plan, by the study's limits")
    all_modes: Range | None = Field(
        default=None, description="failure probability at the plan, by all failure modes"
    )
    curve: list[CurvePoint] = Field(
        default=[], description="failure probability by all failure modes"
    )
    band: list[CurvePoint] = Field(
        default=[], description="failure probability over the strengths that the tests allow"
    )
    doubts: list[Doubt] = []
    caveats: list[Caveat] = []
    library: LibraryRange | None = None
    next: Remedy


# --- checks, accuracy, and the whole --------------------------------------------------------------


class CheckEntry(Part):
    """A check of the model's range, of the inputs or of the answers."""

    name: str
    text: str
    share: float = Field(description="share of the rows that breach it")
    grade: Grade
    effect: str = Field(default="", description="effect on the answers, and what to do")


class PaperRow(Part):
    """A number of the paper as printed, beside the corrected one."""

    name: str
    printed: Finite
    corrected: Finite
    unit: str
    note: str = Field(default="", description="what is wrong in the printed equation")


class Reached(Part):
    """Largest error / tolerance after a number of model runs."""

    runs: int
    error: Finite


class Shortfall(Part):
    """An answer that is less accurate than required."""

    subject: str
    answer: str
    required: float
    reached: Finite


class AccuracyEntry(Part):
    """What accuracy was required and reached, and what it cost."""

    required: dict[str, float]
    reached: list[Reached]
    stopped: Stop = Field(description="why the run ended")
    inaccurate: list[Shortfall]
    runs: int = Field(description="model runs, those that were taken from the cache included")
    reused: int = Field(description="model runs that were taken from the cache")
    seconds: float = Field(description="run time [s]")


class Results(Part):
    """Everything that a run tells: results.json."""

    schema_version: Literal[3] = SCHEMA_VERSION
    study: StudyEntry
    inputs: dict[str, InputEntry]
    answers: list[Answer]
    decisions: list[Decision] = []
    evidence: list[EvidenceEntry] = Field(
        default=[], description="what crushing tests say of strengths of the library"
    )
    checks: list[CheckEntry]
    paper: list[PaperRow] = Field(
        default=[], description="the paper's numbers beside the corrected ones"
    )
    accuracy: AccuracyEntry
    versions: dict[str, str]

    def to_json(self) -> str:
        """The text of results.json."""
        return self.model_dump_json(indent=1) + "\n"
