"""The one adaptive loop of a run, and what an accuracy that it misses would take.

A question is answered in stages.  After each the campaign looks at what is still less accurate than asked, forecasts
from the course of its error what it would take, and goes on until everything is accurate, the budget or the time is
over, or the rest is out of the budget's reach.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from uqsphere.files import Json
from uqsphere.results import AnalysisEntry, CheckEntry, FractureEntry, SpeedRow, ToleranceEntry
from uqsphere.results.entries import CarriedEntry, Sliders
from uqsphere.runner.evaluate import OutOfBudget, Work
from uqsphere.runner.schedule import CAUTION
from uqsphere.units import told_apart

if TYPE_CHECKING:
    from uqsphere.runner.drivers import Drivers
    from uqsphere.runner.evidence import Early, Evidence
    from uqsphere.runner.fidelity import Pilot
    from uqsphere.runner.questions.distributions import Sampled
    from uqsphere.runner.questions.indices import Sensitivity
    from uqsphere.runner.questions.margins import MarginAnswer
    from uqsphere.runner.similarity import Tabled
    from uqsphere.runner.verdict import Unsure

#: slowest and fastest fall of an error with the number of points that a forecast believes in
SLOWEST, FASTEST = 0.5, 1.2
#: a fall that was followed over less than this factor of points says little: the usual one is taken if it is faster
LONG, USUAL = 4.0, 0.75
#: evaluations beyond which a forecast names no number: nobody makes so many
MOST_NAMED = 1e12
#: how errors are called in the speed-error table; what two of them are over follows
INDEX_KIND: Final = "largest half-width of an index"
MEAN_KIND: Final = "half-width of the mean over "
QUANTILE_KIND: Final = "half-width of the worst quantile over "
MISS_KIND: Final = "half-width of the miss probability over itself"
NO_NUMBER: Final = "no number of evaluations that could be made would reach it"


class Accuracy(NamedTuple):
    """What is asked: of a quantity or "limits.NAME" its mean, a quantile (`at` its probability), indices, ..."""

    subject: str
    kind: str
    at: float | None = None


@dataclass(frozen=True)
class Cost:
    """What an accuracy would take: as it is said after what was missed, and in evaluations where a number is known."""

    text: str = ""
    needed: int | None = None


@dataclass(frozen=True, kw_only=True)
class Missed:
    """An accuracy that was asked for and not reached, in words, and what it would take.

    `subject` is a quantity or "limits.NAME"; `kind` what of it: "mean", "quantile" (`at` its probability), "indices",
    "exceedance", "miss", or "surrogate" where one is refused.
    """

    subject: str
    kind: str
    said: str
    cost: Cost = Cost()
    at: float | None = None

    @property
    def accuracy(self) -> Accuracy:
        """What was asked."""
        return Accuracy(self.subject, self.kind, self.at)

    @property
    def text(self) -> str:
        """The sentence that people are told."""
        return self.said + self.cost.text


class Question(Protocol):
    """What a run is asked, and how far it has come with it: answered in stages by `campaign`.

    `size` counts the evaluations that the answer rests on, `judged` those from which on its course tells what an
    accuracy would take.
    """

    @property
    def size(self) -> int: ...
    @property
    def judged(self) -> int: ...
    def advance(self, room: float) -> bool:
        """One stage more, within so many evaluations; False where none is wanted or has room."""
        ...

    def lacking(self) -> Mapping[Accuracy, float]:
        """Half-width over what is asked of all that is not as accurate yet, inf where there is no answer."""
        ...

    def errors(self) -> list[SpeedRow]:
        """The errors that the stage has reached."""
        ...


@dataclass(kw_only=True)
class Course:
    """How far from what was asked each accuracy was after every stage, why the stages ended, and what was given up.

    `stopped` is "accuracy", "evaluations", "time", "out of reach", or "failures".
    """

    ratios: dict[Accuracy, list[tuple[int, float]]] = field(default_factory=dict)
    given_up: dict[Accuracy, Cost] = field(default_factory=dict)
    stopped: str = "accuracy"

    def note(self, size: int, lacking: Mapping[Accuracy, float]) -> None:
        """What a stage leaves to be done."""
        for accuracy, ratio in lacking.items():
            self.ratios.setdefault(accuracy, []).append((size, ratio))

    def hopeless(self, lacking: Mapping[Accuracy, float], judged: int, affordable: float) -> bool:
        """Whether all that a stage lacks, as far as it has a number, is out of reach."""
        finite = [accuracy for accuracy, ratio in lacking.items() if math.isfinite(ratio)]
        self.given_up = {}
        for accuracy in finite:
            late = [point for point in self.ratios[accuracy] if point[0] >= judged]
            if (cost := out_of_reach(late, 1.0, affordable)) is not None:
                self.given_up[accuracy] = cost
        return bool(finite) and len(self.given_up) == len(finite)

    def cost(self, accuracy: Accuracy) -> Cost:
        """What an accuracy that was missed would take."""
        return self.given_up.get(accuracy) or cost_of(self.ratios.get(accuracy, ()))


def speed_rows_of(method: str, quantity: str, evaluations: int, error: float | None, kind: str) -> list[SpeedRow]:
    """The row of one error; none where it is no number."""
    if error is None or not math.isfinite(error):
        return []
    return [
        SpeedRow(method=method, quantity=quantity, evaluations=int(evaluations), error=float(error), error_kind=kind)
    ]


def campaign(work: Work, question: Question, share: float = 1.0) -> Course:
    """Answer a question by as many stages as its accuracies take and a share of the budget, and the time, allow."""
    budget, course = work.study.analysis.budget, Course()
    while True:
        room = budget.evaluations * share - work.ledger.total
        try:
            if not question.advance(room):
                course.stopped = "evaluations"
                return course
        except OutOfBudget:
            course.stopped = "time"
            return course
        work.tell(question.errors())
        lacking = {a: ratio for a, ratio in question.lacking().items() if work.study.analysis.pursues(a.kind)}
        if not lacking:
            return course
        course.note(question.size, lacking)
        room = budget.evaluations * share - work.ledger.total
        if not budget.exhaust and course.hopeless(lacking, question.judged, question.size + room):
            course.stopped = "out of reach"
            return course
        if work.out_of_time:
            course.stopped = "time"
            return course


# --- what an accuracy would take ------------------------------------------------------------------------


def evaluations_needed(course: Sequence[tuple[int, float]], asked: float) -> float:
    """Evaluations at which a half-width would reach `asked`, from its course [(evaluations, half-width), ...].

    Power law through the first and the last point, its exponent kept within what random and smooth
    quasi-random sampling show.

    >>> round(evaluations_needed([(1000, 0.1), (4000, 0.05)], 0.01))
    100000
    """
    n, width = course[-1]
    if width <= asked:
        return float(n)
    first, wide = course[0]
    rate = SLOWEST
    if len(course) > 1 and wide > width > 0.0:
        rate = min(max(math.log(wide / width) / math.log(n / first), SLOWEST), FASTEST)
    if len(course) > 1 and n < LONG * first:
        # half-widths themselves are uncertain by a fifth, as standard deviations of sixteen replicates are
        rate = max(rate, USUAL)
    return float(n * (width / asked) ** (1.0 / rate))


def out_of_reach(course: Sequence[tuple[int, float]], asked: float, affordable: float) -> Cost | None:
    """What an accuracy that is given up would take, or None while the budget may still reach it."""
    if len(course) < 2:
        return None
    needed = evaluations_needed(course, asked)
    if needed <= CAUTION * affordable:
        return None
    if needed > MOST_NAMED:
        return Cost(f" (given up: {NO_NUMBER})")
    number = rounded(needed)
    text = f"given up: it would take about {number:,} evaluations, and {int(affordable):,} are affordable"
    return Cost(f" ({text})", number)


def cost_of(course: Sequence[tuple[int, float]]) -> Cost:
    """What an accuracy that was missed would take, from the course of its half-width over what is asked; or nothing.

    >>> cost_of([(1000, 10.0), (4000, 5.0)])
    Cost(text=' (about 100,000 evaluations would reach it)', needed=100000)
    """
    if not course or not math.isfinite(course[-1][1]) or course[-1][1] <= 1.0:
        return Cost()
    needed = evaluations_needed(course, 1.0)
    if needed > MOST_NAMED:
        return Cost(f" ({NO_NUMBER})")
    return Cost(f" (about {rounded(needed):,} evaluations would reach it)", rounded(needed))


def indices_missed(quantity: str, width: float | None, asked: float, why: str = "", cost: Cost = Cost()) -> Missed:
    """That the indices of a quantity have a half-width above what is asked, or that there are none; and `why`."""
    found = "none" if width is None else f"half-width {told_apart(width, asked)}"
    said = f"{quantity}: indices: {found}, asked {asked:g}{why}"
    return Missed(subject=quantity, kind="indices", said=said, cost=cost)


def rounded(value: float) -> int:
    """A number of evaluations to two digits; beyond any budget where it is not finite."""
    if not math.isfinite(value):
        return 10**12
    digits = max(0, math.floor(math.log10(max(value, 1.0))) - 1)
    return int(round(value / 10**digits) * 10**digits)


# --- all that a run found ------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Findings:
    """All that a run found, before it is written down."""

    pilot: Pilot
    sampled: Sampled
    sensitivity: dict[str, Sensitivity]
    drivers: Drivers
    tabled: Tabled
    margins: dict[str, MarginAnswer] = field(default_factory=dict)
    tolerance: dict[str, ToleranceEntry] = field(default_factory=dict)
    analyses: dict[str, AnalysisEntry] = field(default_factory=dict)
    stops: dict[str, str] = field(default_factory=dict)
    early: Callable[[], Early | None] | None = None
    evidence: Evidence | None = None
    fracture: FractureEntry | None = None
    carried: Mapping[str, CarriedEntry] = field(default_factory=dict)
    far: Sequence[CheckEntry] = ()
    unsure: Unsure | None = None
    #: what the page shows beside answers: what its sliders work with, and how contact forces go over time
    sliders: Sliders | None = None
    courses: dict[str, Json] | None = None

    @property
    def curves_tabled(self) -> list[Tabled]:
        """The tables beside the rows of curves: limits that share their rows share one."""
        bands = [band for one in self.margins.values() for band in (one.band, *one.bands.values()) if band is not None]
        return list({id(band.tabled): band.tabled for band in bands}.values())
