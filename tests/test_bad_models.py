"""Models that fail, end their process, never answer, or answer out of all scale: told of, no silent nonsense."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import uqsphere
from uqsphere.black_box import load_black_box
from uqsphere.cli import main
from uqsphere.cli.run import Progress, Silence
from uqsphere.errors import ModelError, ModelRaised, UsageError
from uqsphere.model import answer_black_box
from uqsphere.runner.campaign import NO_NUMBER, Cost, cost_of, out_of_reach
from uqsphere.runner.questions.indices import lost_designs
from uqsphere.study import Study, load_study
from uqsphere.uq.estimate import from_replicates

Rows = dict[str, np.ndarray[Any, np.dtype[np.float64]]]

STUDY = """
seed = 3
[inputs]
a = { dist = "normal", mean = 0.0, sd = 1.0 }
b = { dist = "uniform", lower = -1.0, upper = 1.0 }
[outputs]
names = ["y"]
[analysis]
methods = ["qmc", "sobol", "pce"]
on_failure = "bound"
accuracy = { mean = 0.02, quantile = 0.05, sobol = 0.05, probability = 0.2 }
budget = { evaluations = 20_000 }
"""


def smooth(rows: Rows) -> Rows:
    return {"y": rows["a"] + 2.0 * rows["b"] + 0.3 * rows["a"] * rows["b"]}


def failing(share: float) -> Callable[[Rows], Rows]:
    """The model without an answer in that share of the law of b."""
    return lambda rows: {"y": np.where(rows["b"] > 1.0 - 2.0 * share, np.nan, smooth(rows)["y"])}


def written(folder: Path) -> Study:
    (folder / "s.toml").write_text(STUDY, "utf-8")
    return load_study(folder / "s.toml")


def run(box: Callable[[Rows], Rows], out: Path) -> dict[str, Any]:
    return dict(uqsphere.run(written(out.parent), out=out, model=box).results.document())


# --- failures -------------------------------------------------------------------------------------------


def test_indices_of_a_model_that_fails_often_are_refused(tmp_path: Path) -> None:
    """A smooth surrogate would go on through where the model has no answer, and the pairs that are left agree."""
    results = run(failing(0.2), tmp_path / "r")
    for order in ("first", "total"):
        for estimate in results["sensitivity"]["y"][order].values():
            assert estimate["value"] is None
            assert "20 % of the evaluations failed" in estimate["reason"]
    missed = [text for text in results["accuracy"]["missed"] if text.startswith("y: indices")]
    assert len(missed) == 1


def test_an_output_that_fails_often_takes_no_indices_from_another(tmp_path: Path) -> None:
    study = load_study(text=STUDY.replace('["y"]', '["y", "z"]'))
    results = uqsphere.run(study, model=lambda rows: {"z": failing(0.2)(rows)["y"], **smooth(rows)}).results
    shares = results.sensitivity["y"]
    variance = 1.0 + 4.0 / 3.0 + 0.09 / 3.0  # of a + 2 b + 0.3 a b
    for order, truth in (("first", 1.0 / variance), ("total", 1.03 / variance)):
        found = getattr(shares, order)["a"]
        assert found.low <= truth <= found.high
        assert found.value == pytest.approx(truth, abs=0.01)
    assert "20 % of the evaluations failed" in results.sensitivity["z"].first["a"].reason
    assert next(text for text in results.accuracy.missed if "indices" in text).startswith("z: indices: none")


def test_the_share_that_designs_can_lose() -> None:
    failed = np.zeros((4, 1000), dtype=bool)
    failed[:, :10] = True
    assert lost_designs(failed) == ""
    failed[0, 10] = True
    assert "other laws" in lost_designs(failed)


def test_what_failed_evaluations_leave_open_is_not_promised(tmp_path: Path) -> None:
    """The wide interval of a quantile is made by the failures: more of the same evaluations would not narrow it."""
    missed = run(failing(0.1), tmp_path / "r")["accuracy"]["missed"]
    quantiles = [text for text in missed if "quantile 0.5:" in text]
    assert len(quantiles) == 1
    assert "no further ones would narrow it" in quantiles[0]
    assert "would reach it" not in quantiles[0]


# --- scale ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("power", [-1000, -400, 0, 400, 1000])
def test_intervals_have_the_scale_of_their_values(power: int) -> None:
    values = np.array([1.0, 2.0, 4.0, 1.5])
    plain, scaled = from_replicates(values, "mean", 4), from_replicates(np.ldexp(values, power), "mean", 4)
    for key in ("value", "low", "high", "std_error"):
        assert getattr(scaled, key) == math.ldexp(getattr(plain, key), power)


@pytest.mark.parametrize("power", [-900, 990])
def test_a_run_has_the_answers_of_its_scale(power: int, tmp_path: Path) -> None:
    def scaled(rows: Rows) -> Rows:
        return {"y": np.ldexp(smooth(rows)["y"], power)}

    plain, found = (run(box, tmp_path / name) for name, box in (("plain", smooth), ("scaled", scaled)))
    for key in ("mean", "sd"):
        for end in ("value", "low", "high"):
            expected = plain["quantities"]["y"][key][end]
            assert math.ldexp(found["quantities"]["y"][key][end], -power) == pytest.approx(expected, rel=1e-9)
    total = {name: e["value"] for name, e in plain["sensitivity"]["y"]["total"].items()}
    assert {n: e["value"] for n, e in found["sensitivity"]["y"]["total"].items()} == pytest.approx(total, abs=1e-6)


# --- models that raise, end, or never come back ---------------------------------------------------------


def test_an_exception_is_told_with_its_place(tmp_path: Path) -> None:
    def bad(rows: Rows) -> Rows:
        raise RuntimeError("no convergence")

    study = written(tmp_path)
    line = bad.__code__.co_firstlineno + 1
    with pytest.raises(ModelRaised, match=rf"no convergence \(test_bad_models.py, line {line}\)"):
        answer_black_box(study, ("a", "b"), np.zeros((2, 2)), ("y",), bad)


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("def f(rows):\n    return np.linalg.inv(np.zeros((2, 2)))\n", "LinAlgError: Singular matrix (own.py, line 3)"),
        ("def f(rows):\n    return json.loads('{')\n", "(own.py, line 3)"),
        ("def f():\n    return 1\n", "takes 0 positional arguments but 1 was given"),
    ],
)
def test_the_place_of_an_exception_is_in_the_users_own_file(body: str, said: str, tmp_path: Path) -> None:
    """Not in the library that raised it, and not where the model is called from."""
    (tmp_path / "own.py").write_text(f"import json, numpy as np\n{body}", "utf-8")
    box = load_black_box(f"{tmp_path / 'own.py'}:f")
    with pytest.raises(ModelRaised) as raised:
        answer_black_box(written(tmp_path), ("a", "b"), np.zeros((2, 2)), ("y",), box)
    assert str(raised.value).endswith(said)


def test_a_model_that_fails_on_loading_is_told_with_its_place(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text("import math\nlimit = math.squareroot(2.0)\n", "utf-8")
    with pytest.raises(ModelError, match=r"AttributeError on loading: .*\(own.py, line 2\)$"):
        uqsphere.run(written(tmp_path), out=tmp_path / "r", model=f"{tmp_path / 'own.py'}:f")


def test_a_model_that_never_answers_is_told_of(capsys: pytest.CaptureFixture[str]) -> None:
    progress = Progress(seconds=20.0)
    silence = Silence(progress, 20.0)
    progress("model", 8, 8)
    capsys.readouterr()
    silence.look(progress.heard + 1e6)
    assert capsys.readouterr().err == ""  # nothing is being evaluated: the run is at its own work
    progress("model", 1, 8)
    silence.look(progress.heard)
    capsys.readouterr()
    silence.look(progress.heard + 29.0)
    assert capsys.readouterr().err == ""
    silence.look(progress.heard + 31.0)
    text = capsys.readouterr().err
    assert "the time budget of 20 s is over" in text
    assert "for 31 s" in text
    silence.look(progress.heard + 60.0)
    assert capsys.readouterr().err == ""
    silence.look(progress.heard + 63.0)
    assert "for 63 s" in capsys.readouterr().err


def test_a_model_that_was_as_slow_before_is_left_in_peace(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 1000.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    progress = Progress(quiet=True, heard=now)
    silence = Silence(progress, 1e6)
    now += 50.0
    progress("model", 1, 8)
    silence.look(now)
    silence.look(now + 140.0)
    assert capsys.readouterr().err == ""
    silence.look(now + 160.0)
    assert "for 160 s" in capsys.readouterr().err


# --- the width of a terminal ----------------------------------------------------------------------------


@pytest.mark.parametrize("width", [60, 80, 120])
@pytest.mark.parametrize(
    "command", [["check", "studies/granite.toml"], ["list", "materials"], ["list", "criteria"], ["list", "quantities"],
                ["list", "models"]]
)  # fmt: skip
def test_tables_fit_the_terminal(
    command: list[str], width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.chdir(Path(__file__).parent.parent)
    assert main(command) == 0
    assert max(map(len, capsys.readouterr().out.split("\n"))) <= width


def test_a_budget_of_no_time_is_no_interruption(tmp_path: Path) -> None:
    """Nobody pressed Ctrl-C: exit code 2 with what to change, not 130."""
    (tmp_path / "slow.py").write_text(
        "import time\ndef f(rows):\n    time.sleep(0.01)\n    return {'y': rows['a']}\n", "utf-8"
    )
    text = STUDY.replace('methods = ["qmc", "sobol", "pce"]\n', "rows_per_call = 1\n")
    (tmp_path / "s.toml").write_text(text, "utf-8")
    with pytest.raises(UsageError, match="time budget ended"):
        uqsphere.run(load_study(tmp_path / "s.toml"), out=tmp_path / "r", model=f"{tmp_path}/slow.py:f", seconds=1e-3)


# --- moments that do not exist ---------------------------------------------------------------------------

CAUCHY = '{ dist = "student_t", dof = 1, location = 0, scale = 1 }'


def heavy(law: str, box: Callable[[Rows], Rows], out: Path, evaluations: int = 20_000) -> dict[str, Any]:
    """A run in which a has that law and b is standard normal."""
    text = STUDY.replace('{ dist = "normal", mean = 0.0, sd = 1.0 }', law)
    text = text.replace('{ dist = "uniform", lower = -1.0, upper = 1.0 }', '{ dist = "normal", mean = 0, sd = 1 }')
    (out.parent / "s.toml").write_text(text.replace("20_000", str(evaluations)), "utf-8")
    return dict(uqsphere.run(load_study(out.parent / "s.toml"), out=out, model=box).results.document())


def added(rows: Rows) -> Rows:
    return {"y": rows["a"] + rows["b"]}


def indices_of(results: dict[str, Any]) -> list[dict[str, Any]]:
    return [estimate for order in ("first", "total") for estimate in results["sensitivity"]["y"][order].values()]


def test_a_cauchy_input_leaves_neither_mean_nor_indices(tmp_path: Path) -> None:
    results = heavy(CAUCHY, added, tmp_path / "r", 9_000)
    found = results["quantities"]["y"]
    for estimate in (found["mean"], found["sd"], *indices_of(results)):
        assert estimate["value"] is None
        assert "does not exist: a has no moments from order 1 on" in estimate["reason"]
    # no evaluations would give what is not there, and quantiles exist
    assert not [text for text in results["accuracy"]["missed"] if "mean" in text or "indices" in text]
    assert found["quantiles"]["0.95"]["low"] < 6.45 < found["quantiles"]["0.95"]["high"]


def test_a_law_without_variance_keeps_its_mean(tmp_path: Path) -> None:
    """Student's t with 2 degrees of freedom: the sample has a standard deviation, and the law has none."""
    results = heavy(CAUCHY.replace("dof = 1", "dof = 2"), added, tmp_path / "r", 9_000)
    found = results["quantities"]["y"]
    assert found["mean"]["low"] < 0.0 < found["mean"]["high"]
    assert "no moments from order 2 on" in found["sd"]["reason"]
    assert all(estimate["value"] is None for estimate in indices_of(results))


def test_indices_hold_what_a_variance_without_fourth_moments_leaves_open(tmp_path: Path) -> None:
    """Fréchet with shape 2.5: variance Γ(0.2) - Γ(0.6)², of which every sample shows another part."""
    results = heavy('{ dist = "frechet", shape = 2.5, scale = 1 }', added, tmp_path / "r", 9_000)
    variance = math.gamma(0.2) - math.gamma(0.6) ** 2
    for order in ("first", "total"):
        a, b = (results["sensitivity"]["y"][order][name] for name in ("a", "b"))
        assert a["low"] < variance / (1.0 + variance) < a["high"]
        assert b["low"] < 1.0 / (1.0 + variance) < b["high"]


def test_a_bounded_function_of_a_cauchy_input_has_all_its_moments(tmp_path: Path) -> None:
    results = heavy(CAUCHY, lambda rows: {"y": np.tanh(rows["a"]) + rows["b"]}, tmp_path / "r", 9_000)
    found = results["quantities"]["y"]
    assert found["mean"]["value"] is not None
    # the mean of tanh² of a Cauchy variable, by quadrature
    grid = (np.arange(1_000_000) + 0.5) / 1_000_000
    variance = 1.0 + float(np.mean(np.tanh(np.tan(np.pi * (grid - 0.5))) ** 2))
    assert found["sd"]["low"] < math.sqrt(variance) < found["sd"]["high"]
    assert all(estimate["value"] is not None for estimate in indices_of(results))


def test_one_over_a_normal_is_given_no_mean_though_no_law_says_so(tmp_path: Path) -> None:
    """Its order is 1, and samples tell that of a law with a mean, 1.05, from it as little."""
    with np.errstate(divide="ignore"):
        results = heavy(
            '{ dist = "normal", mean = 0, sd = 1 }', lambda rows: {"y": 1.0 / (rows["a"] + 1e-12)}, tmp_path / "r"
        )
    reason = results["quantities"]["y"]["mean"]["reason"]
    assert reason.startswith("not to be told from samples: large values are as frequent")
    assert not [text for text in results["accuracy"]["missed"] if text.startswith("y: mean")]
    assert all(estimate["value"] is None for estimate in indices_of(results))


def test_few_runs_of_a_cauchy_output_have_no_mean_either(tmp_path: Path) -> None:
    found = heavy(CAUCHY, added, tmp_path / "r", 400)["quantities"]["y"]
    assert found["mean"]["value"] is None
    assert found["sd"]["value"] is None


# --- few samples that carry the variance -----------------------------------------------------------------


def test_indices_of_a_rare_step_cover_or_are_refused(tmp_path: Path) -> None:
    """Its replicates agree that no pair was seen together, which is no index of zero."""
    rare = run(lambda rows: {"y": (smooth(rows)["y"] > 3.9).astype(float)}, tmp_path / "r")
    # first-order index of b: the variance of P(y = 1 | b) over that of y, by the normal law at every b
    b = (np.arange(20_000) + 0.5) / 10_000 - 1.0
    chance = np.array([0.5 * math.erfc(z / math.sqrt(2.0)) for z in (3.9 - 2.0 * b) / (1.0 + 0.3 * b)])
    first = float(chance.var() / (chance.mean() * (1.0 - chance.mean())))
    found = rare["sensitivity"]["y"]
    for estimate, truth in ((found["first"]["b"], first), (found["total"]["a"], 1.0 - first)):
        assert estimate["value"] is None or estimate["low"] < truth < estimate["high"]
    assert all(estimate["value"] is None or estimate["value"] >= 0.0 for estimate in indices_of(rare))
    (tmp_path / "n").mkdir()
    never = run(lambda rows: {"y": (smooth(rows)["y"] > 9.0).astype(float)}, tmp_path / "n" / "r")
    assert all(estimate["value"] is None for estimate in indices_of(never))


def test_many_inputs_have_indices_within_a_small_budget(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """More inputs than an expansion of 256 points takes: it is fitted to more."""
    monkeypatch.setattr("uqsphere.runner.questions.indices.FITS", 2)
    laws = "\n".join(f'x{k} = {{ dist = "uniform", lower = -1, upper = 1 }}' for k in range(1, 66))
    accuracy = "accuracy = { mean = 0.001, quantile = 0.01, sobol = 0.05 }"
    text = f'[inputs]\n{laws}\n[outputs]\nnames = ["y"]\n[analysis]\nbudget = {{ evaluations = 13_000 }}\n{accuracy}\n'
    (tmp_path / "s.toml").write_text(text, "utf-8")
    results = uqsphere.run(
        load_study(tmp_path / "s.toml"), out=tmp_path / "r", model=lambda rows: {"y": rows["x1"] + 2.0 * rows["x2"]}
    ).results.document()
    first = results["sensitivity"]["y"]["first"]
    assert first["x1"]["value"] == pytest.approx(0.2, abs=1e-6)
    assert first["x2"]["value"] == pytest.approx(0.8, abs=1e-6)
    assert first["x65"]["value"] == pytest.approx(0.0, abs=1e-6)


def test_a_rough_output_has_indices_where_the_budget_is_short_of_the_first_design(tmp_path: Path) -> None:
    laws = "\n".join(f'x{k} = {{ dist = "uniform", lower = 0, upper = 1 }}' for k in range(1, 4))
    budget = 'budget = { evaluations = 7_000 }\nmethods = ["sobol", "pce"]'
    (tmp_path / "s.toml").write_text(f'[inputs]\n{laws}\n[outputs]\nnames = ["y"]\n[analysis]\n{budget}\n', "utf-8")

    def chequered(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {"y": np.sign(np.sin(97.0 * x["x1"]) * np.sin(83.0 * x["x2"])) + x["x3"]}

    found = uqsphere.run(load_study(tmp_path / "s.toml"), out=tmp_path / "r", model=chequered).results.document()
    assert sum(found["model"]["evaluations"].values()) <= 7_000
    total, first = (found["sensitivity"]["y"][order] for order in ("total", "first"))
    assert total["x1"]["evaluations"] == 16 * 32 * 5
    assert total["x1"]["low"] < 12.0 / 13.0 < total["x1"]["high"]
    assert first["x3"]["low"] < 1.0 / 13.0 < first["x3"]["high"]


# --- accuracies out of reach -----------------------------------------------------------------------------


def test_no_number_of_evaluations_is_named_that_nobody_could_make() -> None:
    course = [(1000, 1e9), (2000, 0.7e9)]
    assert cost_of(course) == Cost(f" ({NO_NUMBER})")
    assert out_of_reach(course, 1.0, 1e4) == Cost(f" (given up: {NO_NUMBER})")
