"""Expensive black boxes: answered through a surrogate with few runs, and never by a smooth lie."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

import uqsphere
from tests.campaigns.coverage import coverage_models, expensive_rows
from uqsphere.cli import main
from uqsphere.errors import StudyError, TooManyFailures, UsageError
from uqsphere.report.brief import summary_of
from uqsphere.report.contents import read_contents
from uqsphere.runner import remote
from uqsphere.runner.campaign import Cost, cost_of
from uqsphere.runner.forecast import CHEAP, choose_way, plan_run, plan_text
from uqsphere.runner.surrogates import blocks_of_runs
from uqsphere.study import Study
from uqsphere.uq.describe import describe
from uqsphere.uq.expansion import fit_outputs
from uqsphere.uq.points import sobol_points
from uqsphere.uq.sample import Sample

MODELS = {model.name: model for model in coverage_models()}
EXPENSIVE = """
seed = 5
[inputs]
x1 = { dist = "uniform", lower = -3.141592653589793, upper = 3.141592653589793 }
x2 = { dist = "uniform", lower = -3.141592653589793, upper = 3.141592653589793 }
x3 = { dist = "uniform", lower = -3.141592653589793, upper = 3.141592653589793 }
[outputs]
names = ["y"]
[limits.high]
quantity = "y"
strength = 10.0
target = 0.5
[analysis]
cost = "10 s"
budget = { time = "2 h" }
accuracy = { mean = 0.005, quantile = 0.05, sobol = 0.01, probability = 0.1 }
"""
TRUTH = MODELS["ishigami"]


class Counted:
    """A model that counts its rows: what an expensive one is paid for."""

    def __init__(self, function: Callable[[dict[str, np.ndarray]], np.ndarray]) -> None:
        self.function = function
        self.rows = 0

    def __call__(self, x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        self.rows += len(x["x1"])
        return {"y": self.function(x)}


def ishigami(x: dict[str, np.ndarray]) -> np.ndarray:
    return np.sin(x["x1"]) + 7.0 * np.sin(x["x2"]) ** 2 + 0.1 * x["x3"] ** 4 * np.sin(x["x1"])


def chequered(x: dict[str, np.ndarray]) -> np.ndarray:
    """Steps that no polynomial follows: mean 4 more than the waves underneath."""
    return np.sin(x["x2"]) + np.where(np.sin(7.0 * x["x1"]) * np.sin(9.0 * x["x2"]) > 0.0, 8.0, 0.0)


@pytest.fixture
def ask(study_from: Callable[..., Study], tmp_path: Path) -> Callable[..., Any]:
    def run(model: Any, *overrides: str, out: str = "r", **more: Any) -> Any:
        return uqsphere.run(study_from(*overrides, text=EXPENSIVE), out=tmp_path / out, model=model, **more)

    return run


def holds(estimate: dict[str, Any], truth: float) -> bool:
    return bool(estimate["low"] - 1e-9 <= truth <= estimate["high"] + 1e-9)


# --- runs -----------------------------------------------------------------------------------------------------


def test_an_expensive_smooth_model_is_answered_with_a_few_hundred_runs(ask) -> None:
    box = Counted(ishigami)
    found = ask(box)
    results = found.results.document()
    assert box.rows <= 256 + 1  # one row is evaluated twice, which is not counted
    assert results["model"]["evaluations"] == {"black box": box.rows - 1}
    assert results["plan"]["way"] == "surrogate"
    assert results["accuracy"]["met"]
    entry, indices = results["quantities"]["y"], results["sensitivity"]["y"]
    assert abs(entry["mean"]["value"] - TRUTH.mean) < 0.005 * TRUTH.sd
    assert abs(entry["sd"]["value"] - TRUTH.sd) < 0.01 * TRUTH.sd
    # no run outlasts a record, and no more runs than these say so
    assert entry["censored_share"]["evaluations"] == entry["mean"]["evaluations"] <= box.rows
    assert entry["censored_share"]["high"] == pytest.approx(1.0 - 0.05 ** (1.0 / entry["mean"]["evaluations"]))
    for p, truth in TRUTH.quantiles.items():
        assert abs(entry["quantiles"][f"{p:g}"]["value"] - truth) < 0.05 * TRUTH.sd
    for j, name in enumerate(("x1", "x2", "x3")):
        assert abs(indices["first"][name]["value"] - TRUTH.first[j]) < 0.01
        assert abs(indices["total"][name]["value"] - TRUTH.total[j]) < 0.01
    x = 2.0 * np.pi * (sobol_points(dimension=3, count=2**18, seed=1, task="truth", replicate=0) - 0.5)
    share = float(np.mean(ishigami({"x1": x[:, 0], "x2": x[:, 1], "x3": x[:, 2]}) > 10.0))
    assert abs(results["limits"]["high"]["miss"]["value"] - share) < 0.1 * share
    assert results["limits"]["high"]["met"] is True
    # the account names every quantity, and seconds are not in the results
    kinds = {row["error_kind"] for row in results["speed_error"]}
    assert {"largest half-width of an index", "half-width of the mean over the standard deviation"} <= kinds
    assert any("runs left out" in kind for kind in kinds)
    assert len(found.manifest.speed_error_seconds) == len(results["speed_error"])
    assert found.manifest.plan.cost_seconds_per_evaluation == 10.0
    assert "seconds" not in json.dumps(results["plan"])


def test_every_accuracy_that_is_missed_has_a_cost_of_its_own(ask) -> None:
    accuracy = "analysis.accuracy={ mean = 5e-4, quantile = 0.001, sobol = 1e-4, probability = 0.001 }"
    missed = ask(Counted(ishigami), accuracy, "analysis.budget.evaluations=200").results.accuracy.missed
    told = [text for text in missed if text.startswith("y: quantile")]
    widths = [float(re.findall(r"half-width ([0-9.e-]+)", text)[0]) for text in told]
    costs = [int(re.findall(r"about ([0-9,]+) evaluations", text)[0].replace(",", "")) for text in told]
    assert len(told) > 2
    assert len(set(costs)) == len(told)
    assert costs[int(np.argmin(widths))] == min(costs)


def test_a_rough_model_is_not_answered_by_a_smooth_lie(ask) -> None:
    box = Counted(chequered)
    results = ask(box, "analysis.budget.evaluations=600").results.document()
    # what the budget has room for: the limit, which no run exceeds, gets what the design leaves
    assert 512 <= box.rows - 2 <= 600  # without the rows that are evaluated once more
    assert results["plan"]["way"] == "sampling"
    assert "too rough" in results["plan"]["why"]
    assert "(a constant from " in results["plan"]["why"]
    assert results["sensitivity"]["y"]["first"]["x1"]["value"] is None
    assert holds(results["quantities"]["y"]["mean"], 4.0)
    assert not results["accuracy"]["met"]
    assert any("evaluations" in text for text in results["accuracy"]["missed"])


def test_a_rough_model_is_sampled_where_the_budget_has_room(ask) -> None:
    box = Counted(chequered)
    results = ask(box, "analysis.budget.evaluations=9000", "analysis.budget.time='100 h'").results.document()
    assert box.rows <= 9000
    assert results["plan"]["way"] == "sampling"
    assert "is sampled" in results["plan"]["why"]
    mean = results["quantities"]["y"]["mean"]
    assert mean["evaluations"] >= 2048
    assert holds(mean, 4.0)
    assert any("would reach it" in text for text in results["accuracy"]["missed"])


MIXED = (
    EXPENSIVE.replace('names = ["y"]', 'names = ["y", "z"]').replace(
        "[analysis]", '[analysis]\nquantities = ["y", "z"]'
    )
    + '[limits.rough]\nquantity = "z"\nstrength = 4.5\n'
)


def both(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {"y": ishigami(x), "z": chequered(x)}


@pytest.mark.parametrize("runs", [16, 32, 64, 256])
def test_intervals_by_the_runs_of_a_rough_output_cover(runs: int) -> None:
    """Blocks of one sequence as replicates: of an output too rough for its evenness they are as good as independent."""
    truths = {"mean": 0.5, "sd": math.sqrt(0.25 + 1.0 / 12.0)}
    hits = dict.fromkeys(truths, 0)
    for seed in range(300):
        u = sobol_points(dimension=3, count=runs, seed=seed, task="expensive", replicate=0)[None]
        values = (np.sin(300.0 * u[..., 0]) * np.sin(270.0 * u[..., 1]) + u[..., 2])[..., None]
        found = describe(blocks_of_runs(Sample.at("abc", u, u).with_answers("y", values)).answer("y"))
        for name, truth in truths.items():
            estimate = getattr(found, name)
            hits[name] += estimate.low <= truth <= estimate.high
    assert all(0.91 * 300 <= count <= 0.99 * 300 for count in hits.values())


def test_what_surrogates_reached_is_kept_where_sampling_does_not(
    study_from: Callable[..., Study], tmp_path: Path
) -> None:
    overrides = ("analysis.budget.evaluations=4500", "analysis.budget.time='100 h'", "analysis.accuracy.mean=5e-4")
    results = uqsphere.run(study_from(*overrides, text=MIXED), out=tmp_path / "r", model=both).results.document()
    assert results["plan"]["way"] == "sampling"
    y, z = results["quantities"]["y"], results["quantities"]["z"]
    assert y["mean"]["method"].startswith("surrogate")
    assert y["mean"]["high"] - y["mean"]["low"] < 0.001 * y["sd"]["value"]
    assert holds(y["mean"], TRUTH.mean)
    assert not z["mean"]["method"].startswith("surrogate")
    assert z["mean"]["evaluations"] >= 2048
    missed = results["accuracy"]["missed"]
    assert any(text.startswith("z: mean") for text in missed)
    assert not any(text.startswith("y: mean") for text in missed)


def test_more_budget_takes_no_margin_and_no_design_point_from_a_surrogate(
    study_from: Callable[..., Study], tmp_path: Path
) -> None:
    text = MIXED + '[margins]\nsolve = "limits.high.strength"\nbetween = [6.0, 14.0]\n'
    study = study_from("analysis.budget.evaluations=2700", "analysis.budget.time='100 h'", text=text)
    results = uqsphere.run(study, out=tmp_path / "r", model=both).results.document()
    assert results["plan"]["way"] == "sampling"
    # it was searched for on the surrogate, which sampling has no room for
    assert results["limits"]["high"]["design_point_reason"] == "no search for a design point converged"
    assert results["limits"]["rough"]["design_point_reason"] == "no search for a design point was made"
    # sampling has no room for a curve
    assert not results["margins"]["rough"]["curve"]
    at = results["margins"]["high"]["values"]["0.1"]
    x = 2.0 * np.pi * (sobol_points(dimension=3, count=2**18, seed=1, task="truth", replicate=0) - 0.5)
    values = ishigami({"x1": x[:, 0], "x2": x[:, 1], "x3": x[:, 2]})
    assert at["low"] <= float(np.quantile(values, 0.9)) <= at["high"]
    assert sum(results["model"]["evaluations"].values()) <= 2700
    assert "the model is sampled" in results["plan"]["why"]


FAR = '[limits.far]\nquantity = "z"\nstrength = { dist = "normal", mean = 12.0, sd = 0.5 }\n'


def test_a_probability_that_few_runs_carry_is_bounded_only(study_from: Callable[..., Study], tmp_path: Path) -> None:
    study = study_from("analysis.budget.evaluations=24", text=MIXED + FAR + "target = 1e-7\n")
    found = uqsphere.run(study, out=tmp_path / "r", model=both).results.document()["limits"]["far"]
    # the spread of these runs about their own mean would have said 1e-7 at most
    x = 2.0 * np.pi * (np.random.default_rng(1).random((10**6, 3)) - 0.5)
    truth = float(ndtr((chequered({"x1": x[:, 0], "x2": x[:, 1]}) - 12.0) / 0.5).mean())
    assert found["miss"]["value"] is None
    assert "few of them carry it" in found["miss"]["reason"]
    assert found["miss"]["low"] <= truth <= found["miss"]["high"]
    assert found["miss"]["high"] < 0.2
    assert found["met"] is None
    assert found["exceedance"]["value"] is None


def test_what_is_assumed_of_a_strength_is_bounded_only_where_few_runs_carry_it(
    study_from: Callable[..., Study], tmp_path: Path
) -> None:
    text = EXPENSIVE.replace("strength = 10.0", 'strength = { dist = "normal", mean = 16.0, sd = 1.2 }')
    study = study_from("analysis.budget.evaluations=300", text=text)
    found = uqsphere.run(study, out=tmp_path / "r", model=lambda x: {"y": ishigami(x)}).results.document()["limits"][
        "high"
    ]
    # 1.77e-3, found by active learning: 64 runs said 8e-3 to 1e-2 of the strength with more or less scatter
    assert found["miss"]["value"] == pytest.approx(1.77e-3, rel=0.2)
    assert len(found["assumed"]) == 3
    for row in found["assumed"]:
        assert "few of them carry it" in row["miss"]["reason"]


def test_what_active_learning_leaves_of_a_rough_limit_rests_on_all_runs(
    study_from: Callable[..., Study], tmp_path: Path
) -> None:
    results = uqsphere.run(
        study_from("analysis.budget.evaluations=460", text=MIXED + FAR), out=tmp_path / "r", model=both
    ).results.document()
    runs = results["quantities"]["z"]["mean"]["evaluations"]
    far = results["limits"]["far"]
    assert runs > 128
    assert any("active learning" in text for text in far["checks"])
    assert far["margin"]["median"]["evaluations"] == runs
    if not far["miss"]["method"].startswith("active"):
        assert far["miss"]["evaluations"] == runs


def test_runs_made_for_a_rough_output_serve_the_surrogates_of_the_others(
    study_from: Callable[..., Study], tmp_path: Path
) -> None:
    asked = "analysis.accuracy={ mean = 1e-7, quantile = 1e-4, sobol = 1e-9, probability = 1e-4 }"
    study = study_from("analysis.budget.evaluations=300", asked, text=MIXED)
    results = uqsphere.run(study, out=tmp_path / "r", model=both).results.document()
    y, z = results["quantities"]["y"], results["quantities"]["z"]
    assert y["mean"]["method"].startswith("surrogate")
    assert y["mean"]["evaluations"] == z["mean"]["evaluations"] > 256
    assert results["limits"]["high"]["miss"]["evaluations"] == y["mean"]["evaluations"]
    assert holds(y["mean"], TRUTH.mean)


def test_a_step_is_answered_within_its_interval(ask) -> None:
    box = Counted(lambda x: np.where(x["x1"] + 0.3 * x["x2"] > 0.5, 5.0, 0.0) + 0.1 * x["x3"])
    results = ask(box, "analysis.budget.evaluations=250").results.document()
    # P(x1 + 0.3 x2 > 0.5) of x uniform on (-pi, pi): the offset alone counts, by symmetry
    assert holds(results["quantities"]["y"]["mean"], 5.0 * (0.5 - 0.5 / (2.0 * np.pi)))


def test_two_runs_agree_and_one_that_is_resumed_evaluates_nothing(ask, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uqsphere.uq.response.fit_outputs", fit_outputs)
    few = "analysis.budget.evaluations=64"
    first, again = ask(Counted(ishigami), few), ask(Counted(ishigami), few, out="other")
    assert first.results.document() == again.results.document()
    box = Counted(ishigami)
    box.function = ishigami
    resumed = ask(box, few)
    assert box.rows == 1  # a stored row, to see that it is the same
    assert resumed.results.document() == first.results.document()


def test_a_cost_that_is_measured_is_kept_with_the_run(ask, monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock says 20 s an evaluation at first, and nothing the second time."""
    ticks = iter(range(0, 10**9, 20))
    monkeypatch.setattr(remote.time, "perf_counter", lambda: float(next(ticks)))
    text = ("analysis.budget.time='3 h'", "analysis.budget.evaluations=3000")
    no_cost = EXPENSIVE.replace('cost = "10 s"\n', "")
    monkeypatch.setitem(globals(), "EXPENSIVE", no_cost)
    box = Counted(ishigami)
    first = ask(box, *text)
    cost = first.manifest.plan.cost_seconds_per_evaluation
    # the rows are timed one by one, each for one tick
    assert cost == pytest.approx(20.0)
    assert first.results.plan.way == "surrogate"
    assert box.rows <= 3.0 * 3600.0 / cost
    monkeypatch.setattr(remote.time, "perf_counter", lambda: 0.0)
    resumed = ask(Counted(ishigami), *text)
    assert resumed.manifest.plan.cost_seconds_per_evaluation == cost
    assert resumed.results.document() == first.results.document()


def test_a_cheap_model_is_sampled(ask, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(globals(), "EXPENSIVE", EXPENSIVE.replace('cost = "10 s"', 'cost = "0.000001 s"'))
    results = ask(Counted(ishigami), "analysis.budget.evaluations=20000").results.document()
    assert results["plan"]["way"] == "sampling"
    assert results["quantities"]["y"]["mean"]["evaluations"] >= 2048


def test_budgets_below_the_smallest_designs(ask) -> None:
    box = Counted(ishigami)
    results = ask(box, "analysis.budget.time='205 s'").results.document()
    assert box.rows == 20 + 1
    assert results["quantities"]["y"]["mean"]["value"] is not None
    assert not results["accuracy"]["met"]
    for seconds in (70, 5):  # seven runs, and not even one
        with pytest.raises(UsageError, match="smallest design takes 8"):
            ask(Counted(ishigami), f"analysis.budget.time='{seconds} s'", out=f"none{seconds}")


def test_rows_without_an_answer_are_left_out_where_the_study_says_so(ask) -> None:
    def without(share: float) -> Counted:
        edge = (2.0 * share - 1.0) * np.pi
        return Counted(lambda x: np.where(x["x1"] < edge, np.nan, x["x1"] + x["x2"]))

    results = ask(without(0.02), "analysis.on_failure='drop'").results.document()
    assert results["plan"]["way"] == "surrogate"
    assert results["model"]["failures"] > 0
    # that of the rows with an answer is 0.02 pi: the surrogate goes on where the others have none
    assert abs(results["quantities"]["y"]["mean"]["value"]) < 0.002 * np.pi
    overrides = ("analysis.on_failure='bound'", "analysis.budget.evaluations=100")
    assert ask(without(0.1), *overrides, out="b").results.plan.way == "sampling"
    # few rows hold more than 1 % by chance, and not so many
    with pytest.raises(TooManyFailures, match=r"of 32 evaluations failed .*too many to leave out"):
        ask(without(0.2), "analysis.on_failure='drop'", out="many")


@pytest.mark.parametrize(("cost", "policy"), [("10 s", "drop"), ("1 us", "bound")])
def test_an_output_without_an_answer_leaves_the_others_of_its_row(
    study_from: Callable[..., Study], tmp_path: Path, cost: str, policy: str
) -> None:
    """Two outputs, one of them without an answer in 3 % of the rows: the other is told as if all were there."""
    text = EXPENSIVE.replace('names = ["y"]', 'names = ["y", "z"]').replace('cost = "10 s"', f'cost = "{cost}"')
    text = text.replace('time = "2 h"', "evaluations = 4096").replace(
        "mean = 0.005, quantile = 0.05, sobol = 0.01, ", ""
    )
    study, told = study_from(text=f'{text}on_failure = "{policy}"\n'), []
    for edge in (-4.0, -2.95):

        def model(x: dict[str, np.ndarray], edge: float = edge) -> dict[str, np.ndarray]:
            return {"y": x["x1"] + x["x2"] + 9.0, "z": np.where(x["x1"] < edge, np.nan, x["x3"])}

        told.append(uqsphere.run(study, out=tmp_path / f"{edge}", model=model).results)
    first, then = told
    assert then.model.failures > first.model.failures == 0
    assert then.quantities["y"] == first.quantities["y"]
    assert then.limits["high"].exceedance == first.limits["high"].exceedance


def test_a_model_that_scatters_by_itself_is_told_apart_from_its_inputs(
    study_from: Callable[..., Study], tmp_path: Path
) -> None:
    """y = x1 + x2/2 + noise: shares of the variance 1, 1/4 and 0.36 of 1.61."""
    text = PLANE.replace("mean = 0.02", "mean = 0.05").replace("[inputs]", "[model]\nstochastic = true\n[inputs]")
    text = text.replace("strength = 14.0", "strength = 12.0").replace("second_order = true", "")
    rng = np.random.default_rng(2)

    def model(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {"y": x["x1"] + 0.5 * x["x2"] + rng.normal(0.0, 0.6, len(x["x1"]))}

    truths = {"sd by the model": 0.6, "sd by the inputs": 1.25**0.5, "share of the variance": 0.36 / 1.61}
    for cost, count in (("10 s", 600), ("1 us", 30_000)):
        study = study_from(f"analysis.budget.evaluations={count}", "analysis.budget.time='99 h'",
                           text=text.replace("10 s", cost))  # fmt: skip
        results = uqsphere.run(study, out=tmp_path / cost[:2], model=model).results
        split = results.analyses["replicates"].values["y"]["the model's own scatter"]
        for name, truth in truths.items():
            assert holds(split[name].model_dump(), truth)
        assert holds(results.sensitivity["y"].total["x1"].model_dump(), 1.0 / 1.61)
        assert holds(results.quantities["y"].sd.model_dump(), 1.61**0.5)
        assert "learning" not in results.limits["high"].miss.method
    with pytest.raises(StudyError, match="leave it out"):
        study_from("model.stochastic=true")


def test_many_inputs_are_screened_before_anything_else(study_from: Callable[..., Study], tmp_path: Path) -> None:
    laws = "\n".join(f'x{k} = {{ dist = "uniform", lower = -1.0, upper = 1.0 }}' for k in range(50))
    text = re.sub(r"(?s)\[inputs\].*\[outputs\]", f"[inputs]\n{laws}\n[outputs]", EXPENSIVE)
    more = ("analysis.budget.evaluations=1000", "analysis.budget.time='99 h'")
    plain = study_from(*more, text=re.sub(r"(?s)\[limits\.high\].*\[analysis\]", "[analysis]", text))
    results = uqsphere.run(plain, out=tmp_path / "r", model=lambda x: {"y": 3.0 * x["x7"] + x["x9"]}).results
    effects = results.analyses["morris"].values["y"]
    ranked = sorted(effects, key=lambda name: -effects[name]["mean absolute effect"].number)
    assert ranked[:2] == ["x7", "x9"]
    assert effects["x0"]["mean absolute effect"].value == 0.0
    # what does nothing is left out of the fits: two inputs are an exact plane from the first 32 runs
    assert results.sensitivity["y"].surrogate.error < 1e-12
    assert holds(results.sensitivity["y"].total["x7"].model_dump(), 0.9)
    assert results.quantities["y"].mean.evaluations <= 64
    assert plan_run(study_from(*more, text=text))["room"][0].startswith("small probabilities: bounds alone")


def test_dependent_inputs_have_no_classical_indices(ask, monkeypatch: pytest.MonkeyPatch) -> None:
    tied = EXPENSIVE + '[[dependence]]\nof = ["x1", "x2"]\nspearman = 0.5\n'
    monkeypatch.setitem(globals(), "EXPENSIVE", tied)
    results = ask(Counted(lambda x: x["x1"] + x["x2"]), "analysis.budget.evaluations=64").results.document()
    assert results["sensitivity"]["y"]["first"]["x1"]["value"] is None
    # Var(x1 + x2) = 2 V (1 + rho), of uniforms with Spearman's (and so Pearson's) rho
    assert results["quantities"]["y"]["sd"]["value"] == pytest.approx(np.pi * np.sqrt(2.0 / 3.0 * 1.5), rel=5e-3)


# --- limits, margins, pairs -------------------------------------------------------------------------------------

PLANE = """
seed = 5
[inputs]
x1 = { dist = "normal", mean = 10.0, sd = 1.0 }
x2 = { dist = "normal", mean = 0.0, sd = 1.0 }
[outputs]
names = ["y"]
[limits.high]
quantity = "y"
strength = 14.0
[analysis]
cost = "10 s"
second_order = true
groups = { both = ["x1", "x2"] }
budget = { evaluations = 300, time = "3 h" }
accuracy = { mean = 0.02, quantile = 0.1, sobol = 0.02, probability = 0.1 }
"""


def plane(x: dict[str, np.ndarray]) -> np.ndarray:
    """A plane that twists: variance 1, and 1/4 of the product."""
    return x["x1"] + 0.5 * (x["x1"] - 10.0) * x["x2"]


def test_a_probability_that_no_run_shows_is_learned(ask, monkeypatch: pytest.MonkeyPatch) -> None:
    # the limit goes by the name of its quantity, whose mean is asked for to more than any run gives
    text = PLANE.replace("[limits.high]", "[limits.y]").replace("mean = 0.02", "mean = 1e-7")
    monkeypatch.setitem(globals(), "EXPENSIVE", text)
    box = Counted(lambda x: x["x1"] + 0.1 * x["x2"])
    results = ask(box).results.document()
    limit = results["limits"]["y"]
    truth = float(ndtr(-4.0 / np.sqrt(1.01)))
    assert box.rows <= 300
    assert limit["miss"]["method"].startswith("active learning")
    assert holds(limit["miss"], truth)
    assert limit["miss"]["value"] == pytest.approx(truth, rel=0.1)
    assert limit["modes"] == 1
    point = limit["design_point"]
    assert point["x1"] + 0.1 * point["x2"] == pytest.approx(14.0, abs=0.01)
    (mean,) = (row for row in results["accuracy"]["questions"] if row["question"].startswith("mean"))
    assert mean["met"] is False
    # what was learned of the limit is no answer to what the mean of its quantity would take
    assert "active learning" not in mean["text"]
    assert mean["needed"] > mean["evaluations"]


def test_a_limit_is_learned_although_its_quantity_is_too_rough(ask, monkeypatch: pytest.MonkeyPatch) -> None:
    """RP57 of the black-box reliability challenge: the largest of branches that no expansion follows."""
    from tests.campaigns.rare import problem

    entry = problem("RP57")
    text = PLANE.replace("mean = 10.0", "mean = 0.0").replace("strength = 14.0", 'strength = 0.0\naim = "break"')
    text = text.replace("second_order = true", "").replace('groups = { both = ["x1", "x2"] }', "")
    monkeypatch.setitem(globals(), "EXPENSIVE", text.replace("evaluations = 300", "evaluations = 200"))
    run = ask(Counted(lambda x: entry.function(np.column_stack([x["x1"], x["x2"]]))))
    assert summary_of(read_contents(run.folder)).splitlines()[1].startswith("The budget of 200 evaluations ended the")
    miss = run.results.limits["high"].miss
    assert miss.method.startswith("active learning")
    assert miss.low <= entry.reference <= miss.high
    assert miss.number == pytest.approx(entry.reference, rel=0.1)


def test_a_design_point_on_a_surrogate_is_confirmed_by_a_run(ask, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(globals(), "EXPENSIVE", PLANE.replace("14.0", "11.0"))
    results = ask(Counted(plane)).results.document()
    limit, found = results["limits"]["high"], results["sensitivity"]["y"]
    point = {name: np.array([value]) for name, value in limit["design_point"].items()}
    assert float(plane(point)[0]) == pytest.approx(11.0, abs=1e-3)
    assert any("the model gives 11" in text for text in limit["checks"])
    # pairs and groups come off the surrogate too: Var = 1 + 1/4, the product alone 1/4
    assert holds(found["second"]["x1|x2"], 0.2)
    assert found["second"]["x1|x2"]["value"] == pytest.approx(0.2, abs=0.01)
    assert holds(found["groups"]["first"]["both"], 1.0)


@pytest.mark.parametrize(("solve", "shift"), [("limits.high.strength", 10.0), ("x1", 11.0)])
def test_margins_of_an_expensive_model(ask, monkeypatch: pytest.MonkeyPatch, solve: str, shift: float) -> None:
    """y = x1 + 0.1 x2: a strength, or a mean, at which it is exceeded with 10, 50 and 90 %."""
    from scipy.special import ndtri

    text = PLANE.replace("14.0", "11.0") + f'[margins]\nsolve = "{solve}"\nbetween = [6.0, 16.0]\n'
    monkeypatch.setitem(globals(), "EXPENSIVE", text + "for_probability = [0.1, 0.5, 0.9]\n")
    box = Counted(lambda x: x["x1"] + 0.1 * x["x2"])
    values = ask(box).results.document()["margins"]["high"]["values"]
    assert box.rows <= 300
    side = -1.0 if solve.startswith("limits") else 1.0
    for p, found in values.items():
        truth = shift + side * np.sqrt(1.01) * float(ndtri(float(p)))
        assert found["value"] == pytest.approx(truth, abs=0.03)


def test_a_margin_that_no_surrogate_shows_is_learned(ask, monkeypatch: pytest.MonkeyPatch) -> None:
    """The case of the validation, two outputs of five inputs and 150 runs: where the kinked one exceeds 6 with 1 %."""
    from tests.campaigns.rare import MARGIN_CASE, MARGIN_TRUTH, margin_model

    monkeypatch.setitem(globals(), "EXPENSIVE", MARGIN_CASE.format(seed=2, runs=150))
    calls: list[int] = []

    def model(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        calls.append(len(x["a"]))
        return margin_model(x)

    found = ask(model).results.margins["high"].values["0.01"]
    assert sum(calls) <= 151
    assert holds(found.model_dump(), MARGIN_TRUTH)
    assert found.value == pytest.approx(MARGIN_TRUTH, rel=0.03)
    assert found.high - found.low < 0.2 * MARGIN_TRUTH


def test_runs_of_a_margin_serve_the_study_itself(ask, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ishigami's function with a = 7 free from 3 to 12: of 96 runs a third lies along a."""
    inputs = "".join(f'x{k} = {{ dist = "uniform", lower = -3.14159, upper = 3.14159 }}\n' for k in (1, 2, 3))
    text = (
        f'seed = 4\n[inputs]\n{inputs}a = 7.0\n[outputs]\nnames = ["y"]\n[limits.high]\nquantity = "y"\n'
        'strength = 12.0\naim = "survive"\n[margins]\nsolve = "a"\nbetween = [3.0, 12.0]\n'
        'for_probability = [0.1]\n[analysis]\ncost = "10 s"\nbudget = { evaluations = 96, time = "9 h" }\n'
    )
    monkeypatch.setitem(globals(), "EXPENSIVE", text)
    box = Counted(lambda x: np.sin(x["x1"]) * (1.0 + 0.1 * x["x3"] ** 4) + x["a"] * np.sin(x["x2"]) ** 2)
    results = ask(box).results
    assert box.rows <= 97
    mean = results.quantities["y"].mean
    assert holds(mean.model_dump(), 3.5)
    assert 0.5 * (mean.high - mean.low) < 0.12


def test_a_family_that_no_surrogate_draws_is_told(
    ask, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = PLANE.replace("14.0", "11.0") + '[margins]\nsolve = "limits.high.strength"\nbetween = [6.0, 16.0]\n'
    monkeypatch.setitem(globals(), "EXPENSIVE", text + 'family = { path = "x1", values = [9.0, 11.0] }\n')
    results = ask(Counted(plane)).results.document()
    assert "margins high: the curves over x1 are not drawn off a surrogate" in results["accuracy"]["missed"]
    assert main(["report", str(tmp_path / "r")]) == 0


# --- the plan -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("10", "unit"),
        ('"-1 s"', "above 0"),
        ('"0 s"', "above 0"),
        ('"3 m"', "time"),
        ("true", "number"),
        ('"soon"', "number"),
    ],
)
def test_a_cost_that_is_none_is_refused(study_from: Callable[..., Study], value: str, message: str) -> None:
    with pytest.raises(StudyError, match=r"analysis\.cost") as caught:
        study_from(text=EXPENSIVE.replace('"10 s"', value))
    assert message in str(caught.value)


def test_the_cost_of_the_impact_model_is_not_asked(study_from: Callable[..., Study]) -> None:
    with pytest.raises(StudyError, match=r"analysis\.cost.*black box"):
        study_from("analysis.cost='10 s'")


def test_the_plan_says_the_way_and_the_crossover(study_from: Callable[..., Study]) -> None:
    expensive = plan_run(study_from(text=EXPENSIVE))
    assert expensive["way"] == "surrogate"
    # three smooth inputs: the first fit is likely enough, which a run of this study takes too
    assert expensive["evaluations"] == 64
    assert expensive["most"] >= 256
    assert expensive["seconds"] == pytest.approx(10.0 * expensive["evaluations"] + 10.0, abs=20.0)
    assert "most of it: surrogate 640 s\n" in plan_text(study_from(text=EXPENSIVE), expensive)
    study = study_from(text=EXPENSIVE.replace('cost = "10 s"\n', ""))
    unknown = plan_run(study)
    assert unknown["way"] is None
    assert unknown["seconds"] is None
    way = choose_way(study, 1e-9)
    assert not way.surrogate
    assert choose_way(study, 1.01 * way.crossover).surrogate
    assert not choose_way(study, 0.99 * way.crossover).surrogate
    assert way.crossover == CHEAP
    short = choose_way(study_from("analysis.budget.evaluations=5000", text=EXPENSIVE), 1e-9)
    assert short.crossover * (5000 - short.runs) == pytest.approx(10.0)


def test_listed_methods_and_the_impact_model_are_sampled(study_from: Callable[..., Study]) -> None:
    assert not choose_way(study_from("analysis.methods=['sobol']", text=EXPENSIVE)).surrogate
    assert plan_run(study_from())["way"] == "sampling"


def test_what_a_missed_accuracy_would_take() -> None:
    assert cost_of([]) == cost_of([(100, 0.5)]) == Cost()
    # halved by four times as many: four times as many again
    assert cost_of([(100, 4.0), (400, 2.0)]) == Cost(" (about 1,600 evaluations would reach it)", 1600)


# --- the statistics -------------------------------------------------------------------------------------------


def test_intervals_of_the_surrogate_way_cover() -> None:
    rows = [r for r in expensive_rows(repetitions=4, models=("ishigami", "product"), sizes=(64,)) if not r.exact]
    assert {"mean", "sd", "quantile 0.95", "first index", "total index"} <= {r.kind for r in rows}
    assert np.mean([r.covered for r in rows]) > 0.9
    with pytest.raises(ValueError, match="unknown model"):
        expensive_rows(repetitions=1, models=("nothing",))
    with pytest.raises(ValueError, match="sizes double"):
        expensive_rows(repetitions=1, sizes=(48,))
