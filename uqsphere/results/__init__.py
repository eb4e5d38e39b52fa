"""The answers of a run as results.json holds them: a frozen `Entry` for every table of it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar, Literal, Self

from pydantic import Field, StrictBool, StrictInt, StrictStr, model_validator

from uqsphere.results.entries import (
    Aim,
    CarriedEntry,
    Count,
    Curve,
    Entry,
    Ests,
    Maybe,
    Name,
    Number,
    Part,
    Probability,
    Quantiles,
    Range,
    Share,
    ShareKey,
    Status,
    read_entry,
)
from uqsphere.results.entries import CheckEntry as CheckEntry
from uqsphere.results.entries import Est as Est
from uqsphere.results.entries import Fields as Fields
from uqsphere.results.entries import Manifest as Manifest
from uqsphere.results.entries import MarginEntry as MarginEntry

# --- study and inputs -----------------------------------------------------------------------------------


class StudyMark(Entry):
    """Which study it is."""

    title: StrictStr
    hash: StrictStr
    seed: Count


class InputEntry(Entry):
    """A random input: its law in force."""

    dist: StrictStr
    mean: Number | None
    sd: Number | None
    unit: StrictStr


# --- quantities -----------------------------------------------------------------------------------------


class ToleranceEntry(Part):
    """Tolerance limits of a quantity; `between` bounds both sides at once."""

    NEEDS = ("coverage", "confidence", "runs", "upper", "lower")

    coverage: Number = 0.0
    confidence: Number = 0.0
    runs: Count = 0
    upper: Number | None = None
    lower: Number | None = None
    between: Range | None = None
    orders: tuple[StrictInt, StrictInt] | None = None
    attained: Range | None = None
    reason: StrictStr | None = None


class TestsEntry(Entry):
    """A law that was fitted to tests."""

    input: StrictStr
    fit: StrictStr = ""
    tests: Count


class QuantityOpenEntry(Part):
    """What few tests leave open of a quantity: 95 % ranges over the laws that they allow, or a reason."""

    fitted: tuple[TestsEntry, ...] = Field(default=(), alias="from")
    reason: StrictStr | None = None
    laws: Count = 0
    mean: Range = (0.0, 0.0)
    quantiles: dict[Name, Range] = Field(default_factory=dict)


class QuantityEntry(Entry):
    """Mean, standard deviation and quantiles of a quantity."""

    unit: StrictStr
    mean: Est
    sd: Est
    quantiles: Quantiles
    censored_share: Probability
    tolerance: Maybe[ToleranceEntry] = Field(default_factory=ToleranceEntry)
    ignorance: Maybe[QuantityOpenEntry] = Field(default_factory=QuantityOpenEntry)


# --- indices --------------------------------------------------------------------------------------------


class OrderEntry(Part):
    """Estimates of first and of total order, by input or by group."""

    first: Ests = Field(default_factory=dict)
    total: Ests = Field(default_factory=dict)


class SurrogateEntry(Part):
    """The surrogate of a quantity: the share of the variance that it leaves, and from how many evaluations."""

    kind: StrictStr | None = None
    error: Number | None = None
    evaluations: Count = 0
    usable: StrictBool | None = None
    reason: StrictStr | None = None
    degree: Count | None = None
    terms: Count | None = None


class AgreementEntry(Part):
    """Whether sampling and surrogate agree on the indices."""

    agree: StrictBool | None = None
    text: StrictStr = ""
    sampled: OrderEntry = Field(default_factory=OrderEntry)
    chaos: OrderEntry = Field(default_factory=OrderEntry)


class MeasureRow(Entry):
    """An input that could be measured: `sway` of a probability by its mean, or `share` of a variance, and the tests
    that make it small."""

    input: StrictStr
    sway: Maybe[Est] = Field(default_factory=Est)
    share: Number | Est
    tests: Count
    observations: Count | None = None

    @property
    def effect(self) -> Est:
        """What not knowing the input does: the sway of a probability, else the share of a variance."""
        found = self.sway or self.share
        assert isinstance(found, Est)
        return found

    @property
    def part(self) -> float:
        """The share as a number."""
        return self.share.number if isinstance(self.share, Est) else float(self.share)


class MeasureEntry(Part):
    """What to measure first, the most telling input first."""

    of: StrictStr = ""
    wanted: Number = 0.0
    method: StrictStr = ""
    rows: tuple[MeasureRow, ...] = ()
    reason: StrictStr = ""
    probability: Number | None = None

    @model_validator(mode="after")
    def _measured(self) -> Self:
        if self.of == "probability" and not all(row.sway for row in self.rows):
            raise ValueError("a row lacks sway")
        if self.of != "probability" and any(not isinstance(row.share, Est) for row in self.rows):
            raise ValueError("the share of a row is no estimate")
        return self


class SharesEntry(Part):
    """First and total indices of the same inputs; where inputs depend on each other, what takes their place.

    Of missing an aim, `of` says what is shared and `probability` how likely that is.
    """

    NEEDS = ("first", "total")

    probability: Number | None = None
    of: StrictStr = ""
    first: Ests = Field(default_factory=dict)
    total: Ests = Field(default_factory=dict)
    second: Ests = Field(default_factory=dict)
    groups: OrderEntry = Field(default_factory=OrderEntry)
    shapley: Ests = Field(default_factory=dict)
    kucherenko: OrderEntry = Field(default_factory=OrderEntry)

    @model_validator(mode="after")
    def _paired(self) -> Self:
        if set(self.first) != set(self.total):
            raise ValueError("first and total are of different inputs")
        if self.shapley:
            if not self.kucherenko:
                raise ValueError("it lacks kucherenko")
            if any(set(row) != set(self.shapley) for row in (self.kucherenko.first, self.kucherenko.total)):
                raise ValueError("shapley and kucherenko are of different inputs")
        return self

    def orders(self) -> Iterator[tuple[str, Ests]]:
        """Every set of indices by its order, as tables name them."""
        yield "first", self.first
        yield "total", self.total
        if "second" in self.model_fields_set:
            yield "second", self.second
        for prefix, pair in (("group", self.groups), ("kucherenko", self.kucherenko)):
            if prefix == "kucherenko" and self.shapley:
                yield "shapley", self.shapley
            if pair and (prefix == "group" or self.shapley):
                kept = (order for order in OrderEntry.model_fields if order in pair.model_fields_set)
                yield from ((f"{prefix} {order}", getattr(pair, order)) for order in kept)


class IndexEntry(SharesEntry):
    """What drives a quantity."""

    estimators: StrictStr = ""
    surrogate: SurrogateEntry = Field(default_factory=SurrogateEntry)
    check: AgreementEntry = Field(default_factory=AgreementEntry)
    delta: Ests = Field(default_factory=dict)
    pawn: Ests = Field(default_factory=dict)
    pawn_threshold: Number | None = None
    measure_first: Maybe[MeasureEntry] = Field(default_factory=MeasureEntry)


class LawSummary(Entry):
    """Mean, standard deviation and quantiles of a law."""

    mean: Number | None = None
    sd: Number | None = None
    quantiles: dict[ShareKey, Number]


class GivenFailureEntry(Entry):
    """An input where the aim is missed, beside its law."""

    mean: Est
    sd: Maybe[Est] = Field(default_factory=Est)
    quantiles: Quantiles
    law: LawSummary


class LimitDriversEntry(SharesEntry):
    """What drives missing the aim of a limit."""

    explained: Maybe[Est] = Field(default_factory=Est)
    given_failure: dict[Name, GivenFailureEntry] | None = None


# --- verdicts -------------------------------------------------------------------------------------------

Code = Literal["a", "b", "c", "d", "e", "f", "together"]
Word = Literal["met", "not met", "undecided", "not established"]


class ReasonEntry(Entry):
    """Why a verdict is what it is, in a clause.

    Not established: `a` the static contact law, `b` the carriers, `c` an assumed strength, `d` what the tests leave
    open, `e` a check of the model that fails, `f` tests that are made up.  `together`: the limit by itself has another.
    """

    code: Code
    text: StrictStr


class JudgedEntry(Entry):
    """A way to break by itself: the probability that it misses the aim, and the free scalar at the target's.

    `assumed`: its strength is the library's, of `source`; `range` are the probabilities over the strength's 95 %, and
    `curve` holds values of the free scalar with the probability that the strength is exceeded there.
    """

    name: StrictStr
    quantity: StrictStr
    assumed: StrictBool
    miss: Probability
    range: tuple[Share, Share] | None = None
    answer: Number | None = None
    source: StrictStr = ""
    seen: StrictBool | None = None
    curve: tuple[tuple[Number, Share], ...] = ()


class VerdictEntry(Entry):
    """A verdict on fracture for an aim and its target: of all ways judged together, `miss` by the study's own limits.

    `governing` is the one that asks most, `answer` the free scalar `solve` that keeps the aim by the study's limits.
    """

    aim: Aim
    target: Share | None
    verdict: Word | None
    reasons: tuple[ReasonEntry, ...]
    miss: Probability
    judged: tuple[JudgedEntry, ...]
    not_judged: dict[Name, StrictStr]
    governing: StrictStr
    solve: StrictStr = ""
    answer: Number | None = None


class AssumedEntry(Entry):
    """An assumption on a strength, and the probability of missing the aim with another in its place."""

    assumption: Literal["dependence", "modulus", "cov", "law"]
    taken: Number | StrictStr | None = None
    instead: Number | StrictStr | None = None
    others: tuple[StrictStr, ...] = Field(default=(), alias="with")
    miss: Probability
    met: StrictBool | None

    @model_validator(mode="after")
    def _whole(self) -> Self:
        due = {"dependence": list, "law": str}.get(self.assumption, float)
        for value in (self.taken, self.instead):
            fits = {list: value is None, str: isinstance(value, str), float: isinstance(value, (int, float))}[due]
            if not fits:
                raise ValueError(f"found {value!r}, which is no {self.assumption}")
        return self


class SettlingEntry(Part):
    """How many tests of a strength would settle whether the target is kept."""

    NEEDS = ("tests", "confidence")

    tests: Count | None = None
    confidence: Share = 0.0
    reason: StrictStr | None = None


# --- limits ---------------------------------------------------------------------------------------------


class LimitOpenEntry(Part):
    """What few tests leave open of the probability of missing the aim, all laws together and each by itself."""

    NEEDS = ("fitted",)

    fitted: tuple[TestsEntry, ...] = Field(default=(), alias="from")
    reason: StrictStr | None = None
    laws: Count = 0
    exceedance: Range | None = None
    miss: tuple[Share, Share] = (0.0, 1.0)
    miss_mean: Number | None = None
    alone: dict[Name, tuple[Share, Share]] = Field(default_factory=dict)
    met: StrictBool | None = None

    @model_validator(mode="after")
    def _told(self) -> Self:
        lacking = {"miss", "alone", "met"} - self.model_fields_set
        if self and "reason" not in self.model_fields_set and lacking:
            raise ValueError(f"it lacks {', '.join(sorted(lacking))}")
        return self

    @property
    def known(self) -> bool:
        """Whether there are such tests, and the ranges that they leave open are known."""
        return bool(self) and self.reason is None


class LimitEntry(Entry):
    """A limit: probabilities of exceeding it and of missing its aim, margin and design point."""

    quantity: StrictStr
    aim: Aim
    target: Share | None
    exceedance: Probability
    miss: Probability
    reliability_index: Number | None
    reliability_index_interval: tuple[Number | None, Number | None] | None = None
    margin: Ests
    design_point: dict[Name, Number] | None
    design_point_reason: StrictStr | None = None
    design_points: Count | None = None
    modes: Count | None = None
    checks: tuple[StrictStr, ...] = ()
    governing_inputs: dict[Name, Number] | None
    governing_inputs_method: StrictStr | None = None
    met: StrictBool | None
    verdict: Word | None = None
    reasons: tuple[ReasonEntry, ...] = ()
    ignorance: Maybe[LimitOpenEntry] = Field(default_factory=LimitOpenEntry)
    assumed: tuple[AssumedEntry, ...] = ()
    tests_to_settle: Maybe[SettlingEntry] = Field(default_factory=SettlingEntry)
    drivers: Maybe[LimitDriversEntry] = Field(default_factory=LimitDriversEntry)
    measure_first: Maybe[MeasureEntry] = Field(default_factory=MeasureEntry)
    carried: Maybe[CarriedEntry] = Field(default_factory=CarriedEntry)

    @property
    def word(self) -> str:
        """The verdict on it as people read it; of a run that judged it by its own probability alone, that."""
        own = {True: "met", False: "not met", None: "undecided"}[self.met]
        return "no target" if self.target is None else self.verdict or own

    @model_validator(mode="after")
    def _whole(self) -> Self:
        lacking = [key for key in ("median", "0.05", "0.95") if key not in self.margin]
        if lacking:
            raise ValueError(f"its margin lacks {', '.join(lacking)}")
        low, high = self.reliability_index_interval or (None, None)
        if low is not None and high is not None and low > high:
            raise ValueError("the interval of its reliability index ends before it begins")
        return self


# --- fracture -------------------------------------------------------------------------------------------


class LimitsOrder(Entry):
    """An order in which limits are reached, and how common it is."""

    limits: tuple[StrictStr, ...]
    share: Est


class StateEntry(Part):
    """A number at the moment of fracture."""

    NEEDS = ("unit", "median", "quantiles")

    unit: StrictStr = ""
    median: Maybe[Est] = Field(default_factory=Est)
    quantiles: Quantiles = Field(default_factory=dict)


class FractureEntry(Part):
    """Fracture by any limit: probabilities, what governs, and the state at fracture."""

    NEEDS = ("limits", "union")

    #: the numbers of the state at fracture, as they are listed
    STATE: ClassVar = ("time", "force", "energy", "specific_energy", "imbalance", "t10")

    limits: tuple[StrictStr, ...] = ()
    left_out: tuple[StrictStr, ...] = ()
    union: Maybe[Probability] = Field(default_factory=Est)
    over_record: Maybe[Probability] = Field(default_factory=Est)
    first_loading: Maybe[Probability] = Field(default_factory=Est)
    reason: StrictStr | None = None
    governed_by: dict[Name, Est] = Field(default_factory=dict)
    order: tuple[LimitsOrder, ...] = ()
    time: Maybe[StateEntry] = Field(default_factory=StateEntry)
    force: Maybe[StateEntry] = Field(default_factory=StateEntry)
    energy: Maybe[StateEntry] = Field(default_factory=StateEntry)
    specific_energy: Maybe[StateEntry] = Field(default_factory=StateEntry)
    imbalance: Maybe[StateEntry] = Field(default_factory=StateEntry)
    t10: Maybe[StateEntry] = Field(default_factory=StateEntry)
    share_in_first_loading: Maybe[Est] = Field(default_factory=Est)
    specimens: Count = 0
    distinct_rows: Count = 0
    lost_share: Number = 0.0
    check: Maybe[CheckEntry] = Field(default_factory=CheckEntry)
    solve: StrictStr = ""
    values: Quantiles = Field(default_factory=dict)
    curve: Curve = ()

    def states(self) -> dict[str, StateEntry]:
        """The numbers at the moment of fracture that are known."""
        found = {name: getattr(self, name) for name in self.STATE}
        return {name: entry for name, entry in found.items() if entry}


# --- model, plan, accuracy ------------------------------------------------------------------------------


class CandidateEntry(Entry):
    """A cheaper fidelity on the pilot, by quantity."""

    error: dict[Name, Number | None]
    worst: dict[Name, Number | None] = Field(default_factory=dict)
    correlation: dict[Name, Number | None]
    cost: Number
    fits: StrictBool | None = None
    mixed_error: dict[Name, Number | None] = Field(default_factory=dict)
    fallback_share: Number | None = None


class ControlEntry(Part):
    """The control variate."""

    used: StrictBool = False
    fidelity: StrictStr | None = None
    ratio: Number | None = None
    gain: dict[Name, Number | None] = Field(default_factory=dict)
    text: StrictStr = ""
    indices: StrictStr = ""
    margins: StrictStr = ""


class SavedEntry(Part):
    """What cheaper fidelities saved."""

    full_evaluations: Number = 0
    cost_share: Number = 0.0
    text: StrictStr = ""


#: the rig of a study that has none of its own
NO_RIG = "none"


class ModelEntry(Entry):
    """The fidelity that was taken, and what was evaluated."""

    chosen: StrictStr
    why: StrictStr
    measured_error: dict[Name, Number | None]
    evaluations: dict[Name, Count]
    failures: Count
    failure_reasons: dict[Status, Count] = Field(default_factory=dict)
    numbers: dict[Name, Number | None] = Field(default_factory=dict)
    considered: dict[Name, CandidateEntry] = Field(default_factory=dict)
    fallback_share: Share | None = None
    control: ControlEntry = Field(default_factory=ControlEntry)
    saved: SavedEntry = Field(default_factory=SavedEntry)
    undecided: Count = 0

    def savings(self) -> list[tuple[str, str]]:
        """What cheaper fidelities did for the run, for people: (label, text) rows."""
        left = "" if self.fallback_share is None else f"{100.0 * self.fallback_share:.3g} % of the rows"
        control, saved = self.control, self.saved.text if self.saved.full_evaluations else ""
        told = {"left to full": left, "control variate": control.text, "control variate, indices": control.indices,
                "control variate, margins": control.margins, "saved": saved}  # fmt: skip
        return [(label, text) for label, text in told.items() if text]


class PartEntry(Entry):
    """A part of the run: evaluations that were likely, the most, and those taken."""

    part: StrictStr
    likely: Count
    most: Count
    taken: Count


class PlanEntry(Part):
    """Sampling or a surrogate, and the account of the evaluations."""

    way: StrictStr = ""
    why: StrictStr = ""
    sampling_evaluations: Number = 0
    surrogate_evaluations: Number = 0
    parts: tuple[PartEntry, ...] = ()


class SpeedRow(Entry):
    """An error after so many evaluations."""

    method: StrictStr
    quantity: StrictStr
    evaluations: Count
    error: Number | None
    error_kind: StrictStr


class QuestionRow(Entry):
    """An accuracy: what was asked, what was reached, and what the rest would take."""

    quantity: StrictStr
    question: StrictStr
    asked: Number
    reached: Number | None
    met: StrictBool | None
    evaluations: Count | None
    needed: Number | None
    text: StrictStr


class AccuracyEntry(Entry):
    """Whether the accuracies asked for were reached."""

    met: StrictBool
    missed: tuple[StrictStr, ...]
    stopped_by: dict[Name, StrictStr] = Field(default_factory=dict)
    questions: tuple[QuestionRow, ...] = ()


class PaperRow(Entry):
    """A number as printed in the paper, by the corrected formula, and by the full model."""

    quantity: StrictStr
    unit: StrictStr
    as_printed: Number | None
    corrected: Number | None
    full: Number | None
    note: StrictStr


class AnalysisEntry(Entry):
    """An analysis that the study asked for by name: estimates by quantity, row and column, or why there are none."""

    values: dict[Name, dict[Name, Ests]] = Field(default_factory=dict)
    reason: StrictStr = ""


# --- the documents --------------------------------------------------------------------------------------


class Results(Entry):
    """The content of results.json."""

    schema_version: StrictInt = 1
    study: StudyMark
    versions: dict[Name, StrictStr]
    inputs: dict[Name, InputEntry]
    quantities: dict[Name, QuantityEntry]
    sensitivity: dict[Name, IndexEntry]
    limits: dict[Name, LimitEntry]
    margins: dict[Name, MarginEntry]
    fracture: Maybe[FractureEntry] = Field(default_factory=FractureEntry)
    analyses: dict[Name, AnalysisEntry] = Field(default_factory=dict)
    verdicts: tuple[VerdictEntry, ...] = ()
    model: ModelEntry
    validity: tuple[CheckEntry, ...]
    plan: PlanEntry = Field(default_factory=PlanEntry)
    speed_error: tuple[SpeedRow, ...]
    accuracy: AccuracyEntry
    warnings: tuple[StrictStr, ...] = ()
    paper: tuple[PaperRow, ...] = ()
    rig: StrictStr = "bars"
    services: dict[Name, Results] = Field(default_factory=dict)

    @property
    def parts(self) -> dict[str, Results]:
        """The rig's own answers by an empty name, where it has one, and those of every service."""
        return {**({} if self.rig == NO_RIG else {"": self}), **self.services}

    @model_validator(mode="after")
    def _belonging(self) -> Self:
        strange = [name for name in self.margins if name not in self.limits]
        if strange:
            raise ValueError(f"margins of {strange[0][:60]}: there is no such limit")
        return self


def read_results(folder: Path) -> Results:
    """results.json of a result folder."""
    return read_entry(folder / "results.json", Results)
