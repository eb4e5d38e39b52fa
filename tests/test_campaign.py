"""The loop of a run: why it ends, what it gives up, and the forecast and the caution around that."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import pytest

from uqsphere.results import SpeedRow
from uqsphere.runner.campaign import Accuracy, campaign, evaluations_needed, out_of_reach, speed_rows_of
from uqsphere.runner.evaluate import Ledger, OutOfBudget, Work
from uqsphere.runner.schedule import CAUTION
from uqsphere.study import Study


@pytest.mark.parametrize("rate", [0.5, 0.7, 1.0, 1.2])
def test_a_power_law_is_forecast_exactly(rate: float) -> None:
    course = [(n, 3.0 * n**-rate) for n in (1000, 2000, 4000)]
    exact = (3.0 / 1e-5) ** (1.0 / rate)
    assert evaluations_needed(course, 1e-5) == pytest.approx(exact, rel=1e-9)


def test_errors_that_do_not_fall_are_taken_for_random_sampling() -> None:
    assert evaluations_needed([(1000, 0.1), (4000, 0.2)], 0.1) == pytest.approx(16_000)


def test_an_accuracy_that_is_reached_needs_nothing_more() -> None:
    assert evaluations_needed([(1000, 0.1), (4000, 0.05)], 0.06) == 4000


def test_nothing_is_given_up_on_one_look_or_within_caution() -> None:
    course = [(1000, 0.1), (4000, 0.05)]
    needed = evaluations_needed(course, 0.01)
    assert out_of_reach(course[-1:], 0.01, 0.0) is None
    assert out_of_reach(course, 0.01, needed / CAUTION * 1.001) is None
    given_up = out_of_reach(course, 0.01, needed / CAUTION * 0.999)
    assert given_up is not None
    assert given_up.needed == 100_000
    assert "about 100,000 evaluations" in given_up.text


def test_a_hopeless_width_is_forecast_as_infinite_not_as_an_error() -> None:
    assert math.isinf(evaluations_needed([(1000, math.inf), (2000, math.inf)], 0.01))


# --- the loop -----------------------------------------------------------------------------------------


@dataclass
class Falling:
    """A question whose errors fall with powers of its evaluations: doubled from 1,000 on."""

    work: Work
    rates: dict[str, float]
    asked: float = 1.0
    size: int = 0
    judged: int = 2_000
    stages: list[int] = field(default_factory=list)
    late: int = 10**9

    def advance(self, room: float) -> bool:
        more = self.size or 1_000
        if more > room:
            return False
        if self.size + more > self.late:
            raise OutOfBudget
        self.size += more
        self.work.ledger.evaluations["full"] = self.size
        self.stages.append(self.size)
        return True

    def _ratios(self) -> dict[str, float]:
        return {name: 100.0 * (self.size / 1_000) ** -rate / self.asked for name, rate in self.rates.items()}

    def lacking(self) -> dict[Accuracy, float]:
        return {Accuracy(name, "mean"): ratio for name, ratio in self._ratios().items() if ratio > 1.0}

    def errors(self) -> list[SpeedRow]:
        return [row for n, e in self._ratios().items() for row in speed_rows_of("falling", n, self.size, e, "error")]


@pytest.fixture
def work(study_from: Callable[..., Study]) -> Callable[[int], Work]:
    def made(evaluations: int, exhaust: bool = False) -> Work:
        study = study_from()
        budget = replace(study.analysis.budget, evaluations=evaluations, exhaust=exhaust)
        study = replace(study, analysis=replace(study.analysis, budget=budget))
        return Work(study=study, store=None, ledger=Ledger(), fidelity="full")

    return made


def test_a_campaign_ends_with_the_accuracy(work: Callable[..., Work]) -> None:
    question = Falling(work(10**6), {"a": 1.0, "b": 1.1})
    course = campaign(question.work, question)
    assert course.stopped == "accuracy"
    assert question.size == 128_000
    # the errors of every stage are those of the run
    assert [row.evaluations for row in question.work.ledger.rows if row.quantity == "a"] == question.stages


def test_a_campaign_keeps_to_its_share_of_the_budget(work: Callable[..., Work]) -> None:
    question = Falling(work(100_000, exhaust=True), {"a": 0.5})
    assert campaign(question.work, question, share=0.5).stopped == "evaluations"
    assert question.size == 32_000


def test_what_is_out_of_reach_is_given_up_once_all_that_is_left_is(work: Callable[..., Work]) -> None:
    alone = Falling(work(100_000), {"a": 0.5})
    course = campaign(alone.work, alone)
    assert (course.stopped, alone.size) == ("out of reach", 4_000)
    assert course.cost(Accuracy("a", "mean")).needed == 740_000
    # one that can be reached is waited for
    both = Falling(work(150_000), {"a": 0.5, "b": 1.0})
    course = campaign(both.work, both)
    assert (course.stopped, both.size) == ("out of reach", 128_000)
    # and nothing is given up where the budget is to be used up
    spent = Falling(work(100_000, exhaust=True), {"a": 0.5})
    assert campaign(spent.work, spent).stopped == "evaluations"


def test_a_campaign_that_is_cut_off_keeps_what_is_there(work: Callable[..., Work]) -> None:
    question = Falling(work(10**6), {"a": 0.9}, late=8_000)
    assert campaign(question.work, question).stopped == "time"
    assert question.stages == [1_000, 2_000, 4_000, 8_000]
