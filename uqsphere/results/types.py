"""What a run tells, declared once: results.json is `Results`, a row of answers.csv is an `Answer`.

Numbers are in SI units; one that does not exist is None.  A decision holds values and codes;
sentences are made of them in `uqsphere.report`.
"""

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import Annotated, Any, Final, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict


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

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


# --- answers --------------------------------------------------------------------------------------


#: unit of the answers that have that of their quantity
OF_QUANTITY: Final = "the quantity's"


class Kind(StrEnum):
    """Every kind of answer, and what it means."""

    def __new__(cls, *texts: str) -> Self:
        """A kind from its word, subject, meaning, place and unit."""
        kind = str.__new__(cls, texts[0])
        kind._value_, kind.subject, kind.meaning, kind.at, kind.unit = texts
        return kind

    #: what it is an answer on: quantity, limit, fracture, or run
    subject: str
    #: in words
    meaning: str
    #: what the column `at` holds, empty where it holds nothing
    at: str
    #: of the value: a unit, or whose unit it is
    unit: str

    MEAN = "mean", "quantity", "mean", "", OF_QUANTITY
    SD = "sd", "quantity", "standard deviation", "", OF_QUANTITY
    QUANTILE = "quantile", "quantity", "quantile", "probability", OF_QUANTITY
    CENSORED_SHARE = (
        "censored_share",
        "quantity",
        "share of the rows that are right-censored: the record ends too early",
        "",
        "1",
    )
    SOBOL_FIRST = "sobol_first", "quantity", "first-order Sobol' index", "input", "1"
    SOBOL_TOTAL = "sobol_total", "quantity", "total Sobol' index", "input", "1"
    SOBOL_SECOND = (
        "sobol_second",
        "quantity",
        "second-order Sobol' index",
        "both inputs, with a comma",
        "1",
    )
    EXCEEDANCE_PROBABILITY = (
        "exceedance_probability",
        "limit",
        "probability that the demand exceeds the strength",
        "",
        "1",
    )
    FAILURE_PROBABILITY = (
        "failure_probability",
        "limit",
        "failure probability: of exceedance for the aim survive, of its complement for break",
        "empty, what is assumed otherwise, or of a decision: together",
        "1",
    )
    RELIABILITY_INDEX = (
        "reliability_index",
        "limit",
        "reliability index of the failure probability",
        "",
        "1",
    )
    SAFETY_FACTOR = (
        "safety_factor",
        "limit",
        "median of strength over demand; of a decision, number to use over planned value",
        "what it compares",
        "1",
    )
    NUMBER_TO_USE = (
        "number_to_use",
        "decision",
        "free number that keeps every target under every doubt",
        "key of the free number",
        "the free number's",
    )
    CURVE = "curve", "limit", "probability of exceedance along the free number", "free number", "1"
    MARGIN = (
        "margin",
        "limit",
        "free number at a probability of exceedance",
        "probability",
        "the free number's",
    )
    DESIGN_POINT = (
        "design_point",
        "limit",
        "most probable point of failure (FORM)",
        "variable",
        "the variable's",
    )
    DRIVER = (
        "driver",
        "limit",
        "change of the failure probability per standard deviation of an input",
        "variable",
        "1",
    )
    MODE_SHARE = (
        "mode_share",
        "fracture",
        "share of the fractures in which this limit is exceeded first",
        "limit",
        "1",
    )
    TIME_AT_FRACTURE = "time_at_fracture", "fracture", "quantile of the time", "probability", "s"
    FORCE_AT_FRACTURE = "force_at_fracture", "fracture", "quantile of the force", "probability", "N"
    ENERGY_AT_FRACTURE = (
        "energy_at_fracture",
        "fracture",
        "quantile of the energy",
        "probability",
        "J",
    )
    MORRIS = "morris", "quantity", "Morris: mean absolute elementary effect", "input", OF_QUANTITY
    DELTA = "delta", "quantity", "Borgonovo's delta", "input", "1"
    PAWN = "pawn", "quantity", "PAWN: median Kolmogorov-Smirnov distance", "input", "1"
    ERROR = "error", "run", "largest error / tolerance", "model runs", "1"


class Answer(Part):
    """One row of answers.csv: a number with its 95 % interval."""

    subject: str
    """a quantity, limits.NAME, modes.NAME (assumed strength), decision.AIM, fracture, or run"""
    answer: Kind
    """kind of answer"""
    at: float | str = ""
    """place of the answer, by its kind"""
    value: Finite = None
    """the estimate; none where there is no answer"""
    low: Finite = None
    """lower end of the 95 % interval"""
    high: Finite = None
    """upper end of the 95 % interval"""
    low_unseen: Finite = None
    """lower end that also allows for what no model run shows, and for model runs that failed"""
    high_unseen: Finite = None
    """upper end that also allows for what no model run shows, and for model runs that failed"""
    std_error: Finite = None
    """standard error, where the interval rests on one"""
    unit: str
    """SI unit"""
    method: str = ""
    """how it was estimated"""
    runs: int = 0
    """model runs behind it"""
    note: str = ""
    """why there is no value or interval, or what to read it with"""


class Range(Part):
    """A number with its interval."""

    value: Finite = None
    low: Finite = None
    high: Finite = None
    note: str = ""
    """why there is no value, or what it is of where model runs failed"""


# --- the study ------------------------------------------------------------------------------------


class FreeNumber(Part):
    """The free number of [margins]."""

    path: str
    """dotted key, for example striker.speed"""
    quantity: str
    """quantity that it has the unit of: its key, or the demand on a strength"""
    meaning: str
    planned: Finite
    """its value in the study"""
    low: float
    """lower end of its curve, margins.between where no rows fail"""
    high: float
    """upper end of its curve"""
    unit: str
    """unit that the page shows it in"""


class Strength(Part):
    """A strength as a distribution."""

    text: str
    """in words"""
    unit: str
    """unit that the page shows it in"""
    median: Finite
    p05: Finite
    """5 % quantile"""
    p95: Finite
    """95 % quantile"""
    density: Sequence[Sequence[Finite]] | None = None
    """values and their densities"""


class LimitEntry(Part):
    """A limit of the study, or a failure mode with a strength of the library."""

    mode: str
    """failure mode"""
    quantity: str
    """quantity that is held against the strength"""
    aim: Aim
    target: float
    """largest failure probability that is accepted; by default the least of the same aim"""
    has_target: bool
    """whether the study gives this target"""
    allowable: float
    """probability of exceedance at the target"""
    criterion: str | None
    fracture: bool
    """whether exceeding it means that the sphere breaks"""
    assumed: bool
    """whether the strength is the library's"""
    tests: int | None
    """number of tests behind the strength"""
    strength: Strength
    source: str
    source_checked: bool = True
    """whether the source itself was read"""
    test_points: Sequence[Sequence[float]] | None = None
    """tests on the axis of the free number: values, shares broken, 1 if right-censored"""
    platens: str = ""
    """platens of the tests"""
    size_law: str = ""
    """how the strength follows the size of the sphere"""


class QuantityEntry(Part):
    """A quantity whose distribution is answered."""

    meaning: str
    unit: str
    """unit that the page shows it in"""
    range: tuple[Finite, Finite, Finite]
    """5 %, 50 % and 95 % quantiles"""
    method_of_indices: IndexMethod
    density: Sequence[Sequence[Finite]] | None
    """values and their densities"""
    onset: Finite = None
    """of a contact pressure: where the first contact starts to yield, at the means"""
    expansion_error: Finite = None
    """share of the variance that the polynomial chaos leaves at runs that it was not fitted to"""
    held_out: Sequence[Sequence[float]] | None = None
    """some of these runs: outputs, and what the chaos predicts"""


class InputEntry(Part):
    """An input, fixed or random."""

    meaning: str
    unit: str
    """unit that the page shows it in"""
    source: str
    source_checked: bool
    """whether the source itself was read"""
    mean: Finite
    sd: Finite
    p05: Finite
    p95: Finite
    fixed: bool
    distribution: str


class DependenceEntry(Part):
    """A dependence between random variables."""

    of: list[str]
    text: str


class StudyEntry(Part):
    """The study as the user gave it."""

    title: str
    hash: str
    """SHA-256 of the study's meaning"""
    kind: str
    """rig, or black box"""
    seed: int
    description: list[str]
    """two lines: what was studied, and its strengths"""
    free: FreeNumber | None
    overrides: list[str]
    """what --set changed"""
    warnings: list[str]
    quantities: dict[str, QuantityEntry]
    limits: dict[str, LimitEntry]
    modes: dict[str, LimitEntry]
    """failure modes with assumed strengths"""
    not_judged: dict[str, str]
    """failure modes that are not judged, and why"""
    dependence: list[DependenceEntry]


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


MarginNote = Literal["", "everywhere", "nowhere", "too few rows"]


class Doubt(Part):
    """One thing that the number to use rests on: a row of the certificate."""

    code: DoubtCode
    subject: str
    """the limit or failure mode, limits.NAME or modes.NAME"""
    option: str = ""
    """what is taken otherwise: a distribution, a carrier, a law"""
    target: float
    """failure probability that is accepted here"""
    margin: Finite
    """free number at the target under this doubt, with the other failure modes"""
    margin_note: MarginNote = ""
    """why there is no margin: the target is kept everywhere, or nowhere, or too few rows tell"""
    at_number: Range = Range()
    """failure probability at the number to use"""
    at_plan: Range = Range()
    """failure probability at the plan"""
    governs: bool = False
    """whether most failures at the number to use are by it"""
    sets: bool = False
    """whether the number to use is this margin; of several such, the one that governs"""
    counts: bool = True
    """whether it counts as fracture; damage is shown only"""
    joint: bool = False
    """whether its probabilities include the other failure modes"""
    tests: int | None = None
    """number of tests behind the strength"""


CaveatCode = Literal[
    "assumed strength",
    "model range",
    "size",
    "unit",
    "plausibility",
    "rate",
    "criterion range",
    "synthetic tests",
]


class Caveat(Part):
    """Why a verdict is not established."""

    code: CaveatCode
    subject: str
    """check, key, limit or failure mode that it is about"""
    value: Finite = None
    """what was reached or written"""
    bound: Finite = None
    """what is allowed or usual"""
    text: str = ""
    """words of the check or warning"""


class LibraryRange(Part):
    """What a strength of the library leaves open: of the failure mode that governs, else of that
    whose weak end leaves a more conservative number.
    """

    mode: str
    weak: Finite
    """number to use at the weak end of the library's range"""
    strong: Finite
    """number to use at the strong end"""
    mean_strengths: tuple[float, float]
    """mean strengths at the weak and the strong end"""


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
    "include the rate",
    "mend the model",
]


class Remedy(Part):
    """What to do next, for the doubt that governs."""

    code: RemedyCode
    subject: str = ""
    """limit, failure mode, key or check that it is about"""
    at_best: Finite = None
    """number to use once this doubt is gone"""
    gains: list[TestsGain] = []
    """number to use by number of tests"""


class Use(Part):
    """The number to use."""

    path: str
    """dotted key of the free number"""
    value: float
    """conservative value"""
    safe_end: Literal["largest", "smallest"]
    """whether it is the largest or the smallest value to use"""
    planned: Finite
    safety_factor: Finite
    """rounded number to use over planned value, or its inverse; below 1 without margin"""
    best: Range
    """best estimate, and its range by all doubts"""


class EvidenceEntry(Part):
    """What the study's crushing tests say of a strength of the library."""

    mode: str
    tests: int
    """number of tests"""
    weak: float
    """probability of the tests by the weak end of its range"""
    middle: float
    """probability of the tests by its middle"""
    strong: float
    """probability of the tests by the strong end of its range"""
    refuted: bool
    """whether the mode is left out: refuted by the strong end too"""
    raised: float
    """factor on the weak end that the tests leave"""


class Decision(Part):
    """The decision for one aim: survive or break."""

    aim: Aim
    limits: list[str]
    """limits of the study that it decides on"""
    modes: list[str] = []
    """failure modes with assumed strengths behind it"""
    verdict: VerdictWord
    target: Finite
    """failure probability that is accepted"""
    governing: str
    """limit or failure mode that governs, limits.NAME, modes.NAME"""
    use: Use | None
    """number to use; none without [margins] or where none is safe"""
    blocked_by: str = ""
    """limit or mode that is over its target everywhere"""
    own: Doubt | None = None
    """what sets the number to use by the study's own limits only, which is its margin"""
    safe_above: bool | None = None
    """whether larger values of the free number are safer; none where the limits differ in that"""
    probability: Range
    """failure probability at the plan, by the study's limits"""
    all_modes: Range | None = None
    """failure probability at the plan, by all failure modes"""
    curve: list[CurvePoint] = []
    """failure probability by all failure modes"""
    band: list[CurvePoint] = []
    """failure probability over the strengths that the tests allow"""
    doubts: list[Doubt] = []
    caveats: list[Caveat] = []
    library: LibraryRange | None = None
    next: Remedy

    @property
    def together(self) -> Range:
        """The failure probability at the plan by all that adds up."""
        return self.all_modes or self.probability

    @property
    def adds_up(self) -> bool:
        """Whether its limits and failure modes add up; else each is judged by itself."""
        return any(doubt.joint for doubt in self.doubts)


# --- checks, accuracy, and the whole --------------------------------------------------------------


class CheckEntry(Part):
    """A check of the model's range, of the inputs or of the answers."""

    name: str
    text: str
    share: float
    """share of the rows that breach it"""
    grade: Grade
    effect: str = ""
    """effect on the answers, and what to do"""


class PaperRow(Part):
    """A number of the paper as printed, beside the corrected one."""

    name: str
    printed: Finite
    corrected: Finite
    unit: str
    note: str = ""
    """what is wrong in the printed equation"""


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
    stopped: Stop
    """why the run ended"""
    inaccurate: list[Shortfall]
    runs: int
    """model runs, those that were taken from the cache included"""
    reused: int
    """model runs that were taken from the cache"""
    seconds: float
    """run time [s]"""


class Results(Part):
    """Everything that a run tells: results.json."""

    schema_version: Literal[4] = 4
    study: StudyEntry
    inputs: dict[str, InputEntry]
    answers: list[Answer]
    decisions: list[Decision] = []
    evidence: list[EvidenceEntry] = []
    """what crushing tests say of strengths of the library"""
    checks: list[CheckEntry]
    paper: list[PaperRow] = []
    """the paper's numbers beside the corrected ones"""
    accuracy: AccuracyEntry
    versions: dict[str, str]

    @property
    def entries(self) -> dict[str, LimitEntry]:
        """Limits of the study, and failure modes beside them, by their subject."""
        limits = {f"limits.{name}": entry for name, entry in self.study.limits.items()}
        return limits | {f"modes.{name}": entry for name, entry in self.study.modes.items()}

    def get(self, subject: str, answer: Kind, at: float | str = "") -> Answer | Range:
        """The row of an answer; an empty range where there is none."""
        return next((row for row in self.where(subject, answer) if row.at == at), Range())

    def where(self, subject: str, answer: Kind) -> list[Answer]:
        """All rows of an answer, in the order of their places."""
        return [row for row in self.answers if row.subject == subject and row.answer == answer]

    def to_json(self) -> str:
        """The text of results.json."""
        return self.model_dump_json(indent=1) + "\n"
