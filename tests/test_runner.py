"""A run from study to results.json: its shape, its determinism, and what it does where a study is awkward."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from conftest import BOX

import uqsphere
from uqsphere.errors import FolderError, TooManyFailures
from uqsphere.results import SpeedRow
from uqsphere.runner.campaign import Accuracy, campaign, evaluations_needed, out_of_reach, speed_rows_of
from uqsphere.runner.evaluate import Ledger, OutOfBudget, Work
from uqsphere.runner.finished import Run
from uqsphere.runner.schedule import CAUTION
from uqsphere.study import Study

NUMBER = {"type": ["number", "null"]}
ESTIMATE = {
    "type": "object",
    "required": ["value", "low", "high", "std_error", "method", "evaluations"],
    "properties": {
        "value": NUMBER, "low": NUMBER, "high": NUMBER, "std_error": NUMBER, "method": {"type": "string"},
        "evaluations": {"type": "integer", "minimum": 0}, "reason": {"type": "string", "minLength": 1},
    },
    "additionalProperties": False,
    "if": {"properties": {"value": {"type": "null"}}},
    "then": {"required": ["reason"]},
}  # fmt: skip


def table_of(entry: Any) -> dict[str, Any]:
    return {"type": "object", "additionalProperties": entry}


def record(properties: dict[str, Any], *, more: bool = True) -> dict[str, Any]:
    return {"type": "object", "required": list(properties), "properties": properties, "additionalProperties": more}


TEXT = {"type": "string"}
COUNT = {"type": "integer", "minimum": 0}
#: the shape that the contract fixes; more keys are allowed
SCHEMA = record({
    "schema_version": {"const": 1},
    "study": record({"title": TEXT, "hash": {"type": "string", "pattern": "^[0-9a-f]{64}$"}, "seed": COUNT}),
    "versions": table_of(TEXT),
    "inputs": table_of(record({"dist": TEXT, "mean": NUMBER, "sd": NUMBER, "unit": TEXT}, more=False)),
    "quantities": table_of(record({
        "unit": TEXT, "mean": ESTIMATE, "sd": ESTIMATE, "quantiles": table_of(ESTIMATE), "censored_share": ESTIMATE})),
    "sensitivity": table_of(record({
        "first": table_of(ESTIMATE), "total": table_of(ESTIMATE),
        "surrogate": record({"kind": {"type": ["string", "null"]}, "error": NUMBER, "evaluations": COUNT})})),
    "limits": table_of(record({
        "exceedance": ESTIMATE, "miss": ESTIMATE, "reliability_index": NUMBER, "margin": table_of(ESTIMATE),
        "design_point": {"type": ["object", "null"]}, "governing_inputs": {"type": ["object", "null"]},
        "met": {"type": ["boolean", "null"]}})),
    "margins": table_of(record({
        "solve": TEXT, "values": table_of(ESTIMATE),
        "curve": {"type": "array", "items": {"type": "array", "items": {"type": "number"},
                                             "minItems": 4, "maxItems": 4}}})),
    "model": record({
        "chosen": TEXT, "why": TEXT, "measured_error": table_of(NUMBER), "evaluations": table_of(COUNT),
        "failures": COUNT}),
    "validity": {"type": "array", "items": record({
        "check": TEXT, "share": {"type": "number", "minimum": 0, "maximum": 1}, "worst": NUMBER, "text": TEXT})},
    "speed_error": {"type": "array", "items": record({
        "method": TEXT, "quantity": TEXT, "evaluations": COUNT, "error": {"type": "number"}, "error_kind": TEXT})},
    "accuracy": record({"met": {"type": "boolean"}, "missed": {"type": "array", "items": TEXT}}),
})  # fmt: skip


def refuse_constant(name: str) -> None:
    raise AssertionError(f"{name} in the results")


def stored(folder: Path) -> dict[str, bytes]:
    """Everything that must not depend on how a run came about."""
    paths = [folder / "results.json", folder / "samples.npy", *sorted((folder / "tables").iterdir())]
    return {path.name: path.read_bytes() for path in paths}


def checked(run: Run) -> dict[str, Any]:
    """The results as they were written, after a look at their shape."""
    text = (run.folder / "results.json").read_text(encoding="utf-8")
    results: dict[str, Any] = json.loads(text, parse_constant=refuse_constant)
    jsonschema.validate(results, SCHEMA)
    assert results == json.loads(json.dumps(run.results.document()))
    return results


# --- shape and sense ------------------------------------------------------------------------------


def test_results_have_the_shape_of_the_contract(finished: Path) -> None:
    run = uqsphere.open_run(finished)
    results = checked(run)
    assert set(results["quantities"]) == set(results["sensitivity"]) == {"p_max", "contact_time"}
    assert set(results["inputs"]) == {"sphere.E", "sphere.radius", "striker.speed", "limits.crushing.strength"}
    assert set(results["limits"]["crushing"]["margin"]) == {"median", "0.05", "0.95"}
    assert list(results["margins"]["crushing"]["values"]) == ["0.1", "0.5", "0.9"]
    manifest = json.loads((finished / "manifest.json").read_text())
    assert len(manifest["speed_error_seconds"]) == len(results["speed_error"])
    assert manifest["evaluations"] == sum(results["model"]["evaluations"].values())
    assert "seconds" not in json.dumps(results)


def test_frames_of_a_run(finished: Path) -> None:
    run = uqsphere.open_run(finished)
    samples = run.samples()
    assert {"sphere.E", "p_max", "contact_time", "status", "censored_contact_time"} <= set(samples.columns)
    assert samples["p_max"].mean() == pytest.approx(run.results.quantities["p_max"].mean.value, rel=1e-3)
    assert set(run.indices()["order"]) == {"first", "total"}
    assert set(run.limits()["limit"]) == {"crushing"}
    assert run.margins()["exceedance"].tolist() == [0.1, 0.5, 0.9]


def test_damaged_tables_and_samples_are_told(finished_copy: Path) -> None:
    run = uqsphere.open_run(finished_copy)
    (finished_copy / "tables" / "sensitivity.csv").unlink()
    (finished_copy / "tables" / "limits.csv").write_bytes(b"")
    for damage in (b"", b"junk", (finished_copy / "samples.npy").read_bytes()[:-9]):
        (finished_copy / "samples.npy").write_bytes(damage)
        with pytest.raises(FolderError):
            run.samples()
    for read in (run.indices, run.limits):
        with pytest.raises(FolderError):
            read()


# --- determinism ----------------------------------------------------------------------------------


def test_an_executor_does_not_change_a_byte(study_from: Callable[..., Study], tmp_path: Path) -> None:
    study = study_from("analysis.accuracy.quantile=0.01", "analysis.budget.evaluations=60_000", quick=True)
    alone = uqsphere.run(study, out=tmp_path / "alone")
    with ThreadPoolExecutor(2) as pool:
        shared = uqsphere.run(study, out=tmp_path / "shared", executor=pool)
    assert stored(alone.folder) == stored(shared.folder)
    assert alone.results.quantities["p_max"].mean.evaluations > 16_384  # more than one chunk


# --- awkward studies ------------------------------------------------------------------------------


def test_contacts_that_outlast_the_record_are_censored(study_from: Callable[..., Study], tmp_path: Path) -> None:
    study = study_from('bars.incident_end="absorbing"', 'bars.receiving_end="absorbing"', 'model.horizon="60 us"',
                       'analysis.methods=["sobol"]')  # fmt: skip
    results = checked(uqsphere.run(study, out=tmp_path / "r"))
    entry = results["quantities"]["contact_time"]
    assert entry["censored_share"]["value"] == 1.0
    for estimate in entry["quantiles"].values():
        assert estimate["value"] is None
        assert "cens" in estimate["reason"] or "record" in estimate["reason"]
    assert not any("contact_time: quantile" in text for text in results["accuracy"]["missed"])
    assert all(e["value"] is None for e in results["sensitivity"]["contact_time"]["total"].values())
    assert results["quantities"]["p_max"]["censored_share"]["value"] == 0.0
    assert results["quantities"]["p_max"]["quantiles"]["0.5"]["value"] > 0.0


#: a sphere that is wider than its bar in a few per cent of the rows
WIDE = ('sphere.radius={dist="normal", mean="5 mm", sd="0.5 mm", lower="3 mm", upper="7 mm"}',)


def test_abort_ends_at_the_first_failure(study_from: Callable[..., Study], tmp_path: Path) -> None:
    with pytest.raises(TooManyFailures, match=r"failed.*outside the domain") as caught:
        uqsphere.run(study_from(*WIDE, quick=True), out=tmp_path / "r")
    assert caught.value.exit_code == 4
    with pytest.raises(TooManyFailures):  # nor does a second attempt pass
        uqsphere.run(study_from(*WIDE, quick=True), out=tmp_path / "r")


def test_bound_counts_failures_both_ways(study_from: Callable[..., Study], tmp_path: Path) -> None:
    study = study_from(*WIDE, 'analysis.on_failure="bound"', quick=True)
    results = checked(uqsphere.run(study, out=tmp_path / "r"))
    samples = uqsphere.open_run(tmp_path / "r").samples()
    failed = float((samples["status"] != 0).mean())
    assert 0.01 < failed < 0.05
    assert results["model"]["failures"] > 0
    limit = results["limits"]["crushing"]["exceedance"]
    assert limit["high"] - limit["low"] >= 0.9 * failed
    assert samples.loc[samples["status"] != 0, "p_max"].isna().all()


def test_drop_gives_up_above_one_per_cent(study_from: Callable[..., Study], tmp_path: Path) -> None:
    with pytest.raises(TooManyFailures, match="more than 1 %"):
        uqsphere.run(study_from(*WIDE, 'analysis.on_failure="drop"', quick=True), out=tmp_path / "r")
    rare = 'sphere.radius={dist="normal", mean="5 mm", sd="0.4 mm", lower="3 mm", upper="7 mm"}'
    results = checked(uqsphere.run(study_from(rare, 'analysis.on_failure="drop"', quick=True), out=tmp_path / "few"))
    share = results["model"]["failures"] / sum(results["model"]["evaluations"].values())
    assert 0.0 < share < 0.01
    limit = results["limits"]["crushing"]["exceedance"]
    assert limit["low"] < limit["value"] < limit["high"]


FIXED = ('sphere.E="60 GPa"', 'sphere.radius="5 mm"', 'striker.speed="5 m/s"', 'limits.crushing.strength="6 GPa"')


def test_a_study_without_scatter_is_evaluated_once(
    small_text: str, study_from: Callable[..., Study], tmp_path: Path
) -> None:
    start, end = small_text.index("[[dependence]]"), small_text.index("[analysis]")
    study = study_from(*FIXED, text=small_text[:start] + small_text[end:])
    results = checked(uqsphere.run(study, out=tmp_path / "r"))
    direct = uqsphere.evaluate(study, {}, ("p_max",), tolerance=1e-4)["p_max"][0]
    assert results["quantities"]["p_max"]["mean"]["value"] == pytest.approx(direct, rel=1e-12)
    assert results["sensitivity"]["p_max"]["first"] == {}
    assert results["limits"]["crushing"]["exceedance"]["value"] == float(direct > 6e9)
    assert results["model"]["evaluations"]["full"] <= 4


LIMIT = 'limits.%s={ quantity="p_max", strength={ dist="weibull", mean="6 GPa", modulus=12 }, aim="%s", target=%r }'


def test_the_verdict_follows_the_interval(study_from: Callable[..., Study], tmp_path: Path) -> None:
    limits = [LIMIT % each for each in (("far", "survive", 0.5), ("near", "survive", 1e-4), ("broken", "break", 0.5))]
    run = uqsphere.run(study_from(*limits, quick=True), out=tmp_path / "r")
    found = {name: run.results.document()["limits"][name] for name in ("far", "near", "broken")}
    miss = found["far"]["miss"]
    assert 1e-4 < miss["low"] < miss["high"] < 0.5
    assert [limit["met"] for limit in found.values()] == [True, False, False]
    assert not run.met
    # to break and to survive are complements
    assert found["broken"]["exceedance"]["value"] == found["far"]["exceedance"]["value"] == miss["value"]
    assert found["broken"]["miss"]["value"] == pytest.approx(1.0 - miss["value"], rel=1e-12)
    assert found["broken"]["margin"] == found["far"]["margin"]
    # dependence between an input and a strength is no obstacle to indices
    assert all(e["value"] is not None for e in run.results.document()["sensitivity"]["p_max"]["first"].values())
    within = LIMIT % ("far", "survive", miss["value"])
    undecided = uqsphere.run(study_from(within, *limits[1:], quick=True), out=tmp_path / "u")
    assert undecided.results.limits["far"].met is None


def test_dependent_inputs_get_no_classical_indices(study_from: Callable[..., Study], tmp_path: Path) -> None:
    study = study_from('dependence=[{of=["sphere.E", "striker.speed"], spearman=0.4}]', quick=True)
    results = checked(uqsphere.run(study, out=tmp_path / "r"))
    for order in ("first", "total"):
        for estimate in results["sensitivity"]["p_max"][order].values():
            assert estimate["value"] is None
            assert "sphere.E" in estimate["reason"]


@pytest.mark.parametrize("budget", [3_000, 9_000])
def test_the_budget_of_evaluations_is_kept_and_told(
    study_from: Callable[..., Study], tmp_path: Path, budget: int
) -> None:
    study = study_from(f"analysis.budget.evaluations={budget}", "analysis.accuracy.quantile=0.001", quick=True)
    results = checked(uqsphere.run(study, out=tmp_path / "r"))
    assert sum(results["model"]["evaluations"].values()) <= budget
    assert results["accuracy"]["met"] is False
    assert "evaluations" in results["accuracy"]["stopped_by"].values()
    assert any("quantile" in text for text in results["accuracy"]["missed"])


def test_a_time_budget_is_recorded(study_from: Callable[..., Study], tmp_path: Path) -> None:
    study = study_from("analysis.accuracy.quantile=0.0001", "analysis.budget.evaluations=2_000_000", quick=True)
    run = uqsphere.run(study, out=tmp_path / "r", seconds=1e-3)
    assert run.manifest.stopped_by_time is True
    assert "time" in checked(run)["accuracy"]["stopped_by"].values()


@pytest.mark.parametrize(("density", "chosen"), [("20 kg/m3", "massless"), ("8000 kg/m3", "full")])
def test_auto_measures_and_says_why(
    study_from: Callable[..., Study], tmp_path: Path, density: str, chosen: str
) -> None:
    study = study_from(f'sphere.density="{density}"', 'model.fidelity="auto"', "bars.infinite=true",
                       'striker.length="0.6 m"', 'analysis.quantities=["p_max"]', 'analysis.methods=["sobol"]',
                       "model.tolerance=1e-5", *(f"analysis.accuracy.{k}=0.2" for k in ("mean", "quantile", "sobol",
                       "probability")))  # fmt: skip
    model = checked(uqsphere.run(study, out=tmp_path / "r"))["model"]
    assert model["chosen"] == chosen
    assert "standard deviation" in model["why"]
    assert model["measured_error"]["p_max"] < 0.04


def test_probabilities_close_to_one_keep_their_own_key(study_from: Callable[..., Study], tmp_path: Path) -> None:
    study = study_from("analysis.quantiles=[0.5, 0.9999999, 0.99999999]", quick=True)
    results = checked(uqsphere.run(study, out=tmp_path / "r"))
    assert list(results["quantities"]["p_max"]["quantiles"]) == ["0.5", "0.9999999", "0.99999999"]


def test_a_model_factor_multiplies_the_demand(tmp_path: Path) -> None:
    text = BOX + '[limits.high]\nquantity = "y"\nstrength = 0.8\nmodel_factor = 1.25\n'
    (tmp_path / "s.toml").write_text(text)
    found = uqsphere.run(
        uqsphere.load_study(tmp_path / "s.toml"), out=tmp_path / "r", model=lambda rows: {"y": rows["x1"]}
    )
    exceeded = found.results.document()["limits"]["high"]["exceedance"]
    assert exceeded["value"] == pytest.approx(1.0 - 0.8 / 1.25, abs=0.01)


# --- the loop of a run: why it ends, what it gives up, and the forecast and the caution around that


@pytest.mark.parametrize("rate", [0.5, 0.7, 1.0, 1.2])
def test_a_power_law_is_forecast_exactly(rate: float) -> None:
    course = [(n, 3.0 * n**-rate) for n in (1000, 2000, 4000)]
    exact = (3.0 / 1e-5) ** (1.0 / rate)
    assert evaluations_needed(course, 1e-5) == pytest.approx(exact, rel=1e-9)


def test_courses_of_errors_that_follow_no_power_law_are_forecast() -> None:
    """Errors that do not fall are taken for random sampling; what is reached needs nothing more; none is no error."""
    assert evaluations_needed([(1000, 0.1), (4000, 0.2)], 0.1) == pytest.approx(16_000)
    assert evaluations_needed([(1000, 0.1), (4000, 0.05)], 0.06) == 4000
    assert math.isinf(evaluations_needed([(1000, math.inf), (2000, math.inf)], 0.01))


def test_nothing_is_given_up_on_one_look_or_within_caution() -> None:
    course = [(1000, 0.1), (4000, 0.05)]
    needed = evaluations_needed(course, 0.01)
    assert out_of_reach(course[-1:], 0.01, 0.0) is None
    assert out_of_reach(course, 0.01, needed / CAUTION * 1.001) is None
    given_up = out_of_reach(course, 0.01, needed / CAUTION * 0.999)
    assert given_up.needed == 100_000
    assert "about 100,000 evaluations" in given_up.text


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
