"""Control variates in a run: used where they pay, refused where they do not, and right either way."""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import uqsphere
from tests.campaigns.auto import compare
from tests.campaigns.auto import main as print_table
from uqsphere.runner.evaluate import Ledger, Work
from uqsphere.runner.fidelity import Candidate, first_look
from uqsphere.runner.finished import Run
from uqsphere.runner.multifidelity import HOPEFUL, WORTHWHILE, Plan, propose, weigh
from uqsphere.study import Study

Build = Callable[..., Study]

#: a long rectangular pulse in infinite bars: the massless model is off by a constant almost, and costs nothing
LONG = (
    "bars.infinite=true", 'striker.length="0.6 m"', 'model.fidelity="auto"', "model.tolerance=1e-6",
    'analysis.quantities=["p_max"]', 'analysis.methods=["qmc", "sobol"]', "analysis.quantiles=[0.05, 0.5, 0.95]",
    "analysis.accuracy.mean=0.01", "analysis.accuracy.quantile=0.01", "analysis.accuracy.sobol=0.01",
    "analysis.accuracy.probability=0.05", "analysis.budget.evaluations=2000000",
)  # fmt: skip


def estimates(run: Run) -> dict[str, dict[str, Any]]:
    found = {}
    for name, entry in run.results.document()["quantities"].items():
        found.update({f"{name}.mean": entry["mean"], f"{name}.sd": entry["sd"]})
        found.update({f"{name}.{p}": estimate for p, estimate in entry["quantiles"].items()})
    for name, entry in run.results.document()["limits"].items():
        found[name] = entry["miss"]
    for name, entry in run.results.document()["sensitivity"].items():
        found.update({f"{name}.{order}.{k}": e for order in ("first", "total") for k, e in entry[order].items()})
    return found


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory, small_text: str) -> tuple[Run, Run]:
    """The same study with its own choice and with the full model, on other points."""
    folder = tmp_path_factory.mktemp("pair")
    path = folder / "study.toml"
    path.write_text(small_text, encoding="utf-8")
    auto = uqsphere.run(uqsphere.load_study(path, LONG), out=folder / "auto", threads=1)
    full = uqsphere.load_study(path, [*LONG, 'model.fidelity="full"', "seed=77"])
    return auto, uqsphere.run(full, out=folder / "full", threads=1)


def test_it_is_used_where_it_pays(pair: tuple[Run, Run]) -> None:
    model, full = pair[0].results.document()["model"], pair[1].results.document()["model"]
    assert model["chosen"] == "full"
    assert model["control"]["used"]
    assert model["control"]["fidelity"] == "massless"
    assert "is used as a control variate" in model["control"]["text"]
    assert "is used as a control variate" in model["control"]["indices"]
    # evaluations of full, and all at their counted cost, against what sampling alone did take
    cost = model["considered"]["massless"]["cost"]
    assert model["evaluations"]["full"] < 0.6 * full["evaluations"]["full"]
    assert model["evaluations"]["full"] + cost * model["evaluations"]["massless"] < 0.8 * full["evaluations"]["full"]
    assert 0.2 < model["saved"]["cost_share"] < 1.0
    assert pair[0].results.accuracy.met


def test_its_answers_are_those_of_the_full_model(pair: tuple[Run, Run]) -> None:
    one, other = (estimates(run) for run in pair)
    assert one.keys() == other.keys()
    for name, a in one.items():
        b = other[name]
        assert abs(a["value"] - b["value"]) <= 4.0 * np.hypot(a["std_error"], b["std_error"]), name
    # and not those of the massless one, which is off by much more than the intervals
    error = pair[0].results.model.considered["massless"].error["p_max"]
    mean, sd = one["p_max.mean"], one["p_max.sd"]
    assert error * sd["value"] > 20.0 * mean["std_error"]


def test_the_course_names_the_method(pair: tuple[Run, Run]) -> None:
    methods = {row["method"] for row in pair[0].results.document()["speed_error"]}
    assert "randomised quasi-Monte Carlo, controlled by massless" in methods
    assert "controlled by" in estimates(pair[0])["p_max.mean"]["method"]


def test_it_does_not_depend_on_threads_executor_or_interruption(
    pair: tuple[Run, Run], study_from: Build, tmp_path: Path
) -> None:
    study = study_from(*LONG)
    known = (pair[0].folder / "results.json").read_bytes()
    again = uqsphere.run(study, out=tmp_path / "two", threads=2)
    assert (again.folder / "results.json").read_bytes() == known
    for path in sorted((again.folder / "evaluations").iterdir())[::2]:
        path.unlink()
    with ThreadPoolExecutor(2) as pool:
        resumed = uqsphere.run(study, out=tmp_path / "two", executor=pool)
    assert (resumed.folder / "results.json").read_bytes() == known
    assert resumed.manifest.evaluations_reused > 0
    assert "seconds" not in json.dumps(resumed.results.document())


def test_a_count_gains_where_the_models_agree_on_the_threshold(
    study_from: Build, small_text: str, tmp_path: Path
) -> None:
    # a fixed strength leaves a count, and only a cheap model put on the full one's line exceeds it in the same rows
    start, end = small_text.index("[[dependence]]"), small_text.index("[analysis]")
    text = small_text[:start] + small_text[end:]
    fixed = (*LONG, 'limits.crushing.strength="6.1 GPa"', 'analysis.methods=["qmc"]')
    auto = uqsphere.run(study_from(*fixed, text=text), out=tmp_path / "auto", threads=1)
    full = uqsphere.run(study_from(*fixed, 'model.fidelity="full"', text=text), out=tmp_path / "full", threads=1)
    one, other = (run.results.document()["limits"]["crushing"]["miss"] for run in (auto, full))
    assert "controlled" in one["method"]
    assert 0.001 < one["value"] < 0.999
    assert abs(one["value"] - other["value"]) <= 4.0 * np.hypot(one["std_error"], other["std_error"])
    # errors at equal evaluations of full, from the fall that plain sampling shows at the least
    assert one["std_error"] < 0.5 * other["std_error"] * np.sqrt(other["evaluations"] / one["evaluations"])


def test_it_is_not_tried_where_the_pilot_shows_no_hope(study_from: Build, tmp_path: Path) -> None:
    # contact_time jumps by whole swings of a mass that the cheap model does not have
    study = study_from('model.fidelity="auto"', 'analysis.methods=["qmc"]')
    model = uqsphere.run(study, out=tmp_path / "r").results.document()["model"]
    assert not model["control"]["used"]
    assert "considered and not tried" in model["control"]["text"]
    assert "contact_time" in model["control"]["text"]
    assert model["saved"]["full_evaluations"] == 0
    assert model["evaluations"]["massless"] == 256


def test_a_trial_that_saves_nothing_says_so(study_from: Build, tmp_path: Path) -> None:
    # a short pulse ends in the middle of the swings, and points feel the phase at which it does
    study = study_from(*LONG, 'striker.length="0.1 m"', 'sphere.density="100 kg/m3"', 'analysis.methods=["qmc"]',
                       'analysis.quantities=["alpha_max"]', 'limits.crushing.quantity="alpha_max"',
                       'limits.crushing.strength={dist="weibull", mean="60 um", modulus=12}',
                       "analysis.accuracy.quantile=0.02")  # fmt: skip
    model = uqsphere.run(study, out=tmp_path / "r").results.document()["model"]
    assert not model["control"]["used"]
    assert "saves nothing" in model["control"]["text"]
    assert model["saved"]["full_evaluations"] == 0


def test_the_budget_holds(study_from: Build, tmp_path: Path) -> None:
    study = study_from(*LONG, "analysis.budget.evaluations=30000", "analysis.budget.exhaust=true")
    model = uqsphere.run(study, out=tmp_path / "r").results.document()["model"]
    assert sum(model["evaluations"].values()) <= 30000
    assert "budget" in model["control"]["text"]


# --- the decision by itself -----------------------------------------------------------------------


def plan(cost: float, ratio: int) -> Plan:
    return Plan(
        candidate=Candidate(fidelity="massless", error={}, worst={}, correlation={"q": 0.99}, calibration={},
                            cost=cost, fits=False),
        ratio=ratio,
    )  # fmt: skip


@pytest.mark.parametrize("ratio", [1.01, 3.0, 40.0])
def test_equal_intervals_never_pay(ratio: float) -> None:
    assert not weigh(plan(0.01, 4), {"q": ratio}, {"q": ratio}, 4096)[0]


@pytest.mark.parametrize(("cost", "pays"), [(0.01, True), (0.5, False)])
def test_what_is_narrow_pays_unless_it_is_expensive(cost: float, pays: bool) -> None:
    # three times too wide without, accurate with it: 4.3 times the evaluations against 1 + 16 cost of them
    found, within, without = weigh(plan(cost, 16), {"q": 3.0}, {"q": 0.9}, 4096)
    assert found is pays
    assert within == 4096
    assert without == pytest.approx(4096 * 3.0 ** (4 / 3), rel=0.05)
    assert (within * (1.0 + 16 * cost) <= WORTHWHILE * 4096 * 3.0 ** (4 / 3)) is pays


def test_a_quantity_that_the_control_spoils_counts() -> None:
    assert weigh(plan(0.01, 4), {"q": 3.0}, {"q": 0.9}, 4096)[0]
    assert not weigh(plan(0.01, 4), {"q": 3.0}, {"q": 0.9, "other": 3.0}, 4096)[0]


def test_the_proposal_follows_correlation_and_cost(study_from: Build) -> None:
    found = first_look(Work(study=study_from(*LONG), store=None, ledger=Ledger(), fidelity="full", threads=1))
    proposed = propose(found)
    assert proposed.plan is not None
    assert proposed.plan.candidate.fidelity == "massless"
    assert proposed.plan.ratio >= 8
    assert proposed.plan.row_cost <= 1.7
    assert HOPEFUL < 1.0


# --- the table ------------------------------------------------------------------------------------


def test_the_table_of_choices(study_from: Build, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study_from()
    quick = ('model.fidelity="auto"', 'analysis.methods=["qmc"]', 'analysis.quantities=["p_max"]',
             "analysis.accuracy.quantile=0.5", "bars.infinite=true")  # fmt: skip
    found = compare(tmp_path / "study.toml", quick)
    assert found.farthest < 4.0
    assert found.full.evaluations.keys() - {"ways"} == {"full"}
    assert min(found.seconds) > 0.0
    assert print_table([str(tmp_path / "study.toml"), *(f"--set={setting}" for setting in quick)]) == 0
    printed = capsys.readouterr().out
    assert "chosen" in printed
    assert "study: " in printed
