"""Runs that were made already: laws, dependence, outputs and drivers, and tables that are not what they should be."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from uqsphere.cli import main
from uqsphere.errors import UsageError
from uqsphere.given import analyse_data, analysis_text, read_data
from uqsphere.uq.marginals import fit_marginal, quantile_interval, rank_correlations, tied
from uqsphere.uq.ranks import rank_indices
from uqsphere.uq.sampling import random_generator


def written(path: Path, columns: dict[str, np.ndarray]) -> Path:
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")
    return path


def runs(n: int = 300, seed: int = 3) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    a, b, c = rng.lognormal(1.0, 0.4, n), rng.normal(5.0, 0.5, n), rng.weibull(8.0, n)
    return {"a": a, "b": b, "c": c, "y": 3.0 * np.log(a) + b + 0.0 * c}


# ---- marginals


@pytest.mark.parametrize(
    ("kind", "law"),
    [("normal", stats.norm(5.0, 1.0)), ("lognormal", stats.lognorm(0.8)), ("weibull", stats.weibull_min(1.7)),
     ("gumbel", stats.gumbel_r(3.0, 1.0)), ("exponential", stats.expon(scale=3.0)), ("gamma", stats.gamma(2.5))],
)  # fmt: skip
def test_the_p_value_is_even_where_the_family_is_right(kind: str, law: stats.rv_continuous) -> None:
    """Below 0.1 in a tenth of the samples, although the parameters were fitted to the same sample."""
    rng, repetitions = np.random.default_rng(1), 120
    small = 0
    for _ in range(repetitions):
        fits = fit_marginal(law.rvs(25, random_state=rng), rng)
        small += next(f.p_value for f in fits if f.law.kind == kind) < 0.1
    assert abs(small / repetitions - 0.1) < 4.0 * np.sqrt(0.09 / repetitions)


def test_many_observations_find_their_family_and_refuse_the_others() -> None:
    rng = np.random.default_rng(2)
    fits = fit_marginal(stats.weibull_min.rvs(2.0, size=4000, random_state=3), rng)
    assert fits[0].law.kind == "weibull"
    assert fits[0].p_value > 0.01
    assert all(f.p_value < 0.01 for f in fits if f.law.kind in ("normal", "lognormal", "exponential"))


@pytest.mark.parametrize("values", [[1.0, 2.0, 3.0], [1.0] * 9, [1.0, 2.0, 3.0, np.nan, 5.0]])
def test_no_law_is_fitted_to_what_has_none(values: list[float]) -> None:
    with pytest.raises(ValueError, match=r"observations"):
        fit_marginal(np.array(values), np.random.default_rng(0))


# ---- dependence, quantiles, ranks


def test_rank_correlations_cover_and_chance_is_not_taken_for_dependence() -> None:
    rng, truth = np.random.default_rng(4), 6.0 / np.pi * np.arcsin(0.6 / 2.0)
    covered = false = 0
    for _ in range(300):
        x = rng.multivariate_normal([0.0, 0.0, 0.0], [[1.0, 0.6, 0.0], [0.6, 1.0, 0.0], [0.0, 0.0, 1.0]], 50)
        pairs = rank_correlations(x)
        estimate = pairs[0][2]
        covered += estimate.low <= truth <= estimate.high
        false += any((i, j) != (0, 1) for i, j, _ in tied(pairs))
    assert covered > 0.95 * 300 - 4.0 * np.sqrt(300 * 0.0475)
    assert false < 0.01 * 300 + 4.0 * np.sqrt(300 * 0.0099)


def test_intervals_of_quantiles_cover() -> None:
    rng = np.random.default_rng(6)
    found = [quantile_interval(rng.exponential(size=60), 0.9) for _ in range(800)]
    covered = np.mean([e.low <= np.log(10.0) <= e.high for e in found])
    assert covered > 0.95 - 4.0 * np.sqrt(0.0475 / 800)
    assert quantile_interval(rng.random(10), 0.99) is None


def test_rank_indices_cover_on_a_function_that_is_known() -> None:
    """Ishigami's function: 0.3139, 0.4424 and 0."""
    rng, truth = np.random.default_rng(7), (0.31390519, 0.44241114, 0.0)
    covered = np.zeros(3)
    for _ in range(100):
        x = rng.uniform(-np.pi, np.pi, (200, 3))
        y = np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
        covered += [e.low <= t <= e.high for e, t in zip(rank_indices(x, y, rng), truth, strict=True)]
    assert (covered >= 90).all()


def test_rank_indices_say_where_they_know_nothing() -> None:
    x, rng = np.random.default_rng(0).random((30, 2)), np.random.default_rng(1)
    assert rank_indices(x, np.ones(30), rng)[0].reason == "the output does not vary"
    assert "too few" in str(rank_indices(x[:9], x[:9, 0], rng)[0].reason)
    with pytest.raises(ValueError, match="finite"):
        rank_indices(x, np.full(30, np.nan), rng)


# ---- the whole


def test_a_table_is_analysed(tmp_path: Path) -> None:
    data = read_data(written(tmp_path / "runs.csv", runs()), ["a", "b", "c"], ["y"])
    found = analyse_data(data)
    assert [found["inputs"][n]["chosen"] for n in "abc"] == ["lognormal", "normal", "weibull"]
    for name in "abc":
        low, high = found["inputs"][name]["mean_left_open"]
        assert low < found["inputs"][name]["mean"] < high
    chaos = found["sensitivity"]["y"]["chaos"]
    share = 1.44 / (1.44 + 0.25)
    assert chaos["usable"]
    assert chaos["total"]["a"]["value"] == pytest.approx(share, abs=0.06)
    assert chaos["total"]["c"]["value"] < 0.01
    ranks = found["sensitivity"]["y"]["ranks"]["a"]
    assert ranks["low"] <= share <= ranks["high"]
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert analyse_data(data) == found
    assert "polynomial chaos" in analysis_text(found)


def test_dependent_inputs_have_no_indices_of_a_polynomial_chaos(tmp_path: Path) -> None:
    columns = runs()
    columns["c"] = columns["b"] + np.random.default_rng(9).normal(0.0, 0.3, 300)
    found = analyse_data(read_data(written(tmp_path / "runs.csv", columns), ["a", "b", "c"], ["y"]))
    assert [pair["of"] for pair in found["dependence"] if pair["dependent"]] == [["b", "c"]]
    assert not found["sensitivity"]["y"]["chaos"]["usable"]
    assert "depend on each other" in found["sensitivity"]["y"]["chaos"]["reason"]


def test_noise_is_not_explained(tmp_path: Path) -> None:
    columns = runs()
    columns["y"] = np.random.default_rng(5).normal(size=300)
    chaos = analyse_data(read_data(written(tmp_path / "runs.csv", columns), ["a", "b"], ["y"]))["sensitivity"]["y"]
    assert not chaos["chaos"]["usable"]


def test_the_command_writes_the_start_of_a_study(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path / "runs.csv", runs(60))
    arguments = ["analyse", str(path), "--inputs", "a, b", "--outputs", "y"]
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 0
    study = tomllib.loads((tmp_path / "out" / "inputs.toml").read_text())
    assert set(study["inputs"]) == {"a", "b"}
    assert study["outputs"]["names"] == ["y"]
    capsys.readouterr()
    assert main([*arguments, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads((tmp_path / "out" / "analysis.json").read_text())
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "file").write_text("x")
    assert main([*arguments, "--out", str(tmp_path / "mine")]) == 5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2\n", "'y' is not there"),
        ("a,a,y\n1,1,2\n", "twice"),
        ("a,y\n1,x\n", "line|:2"),
        ("a,y\n1,\n", "finite number"),
        ("a,y\n1,inf\n", "finite number"),
        ("a,y\n1,2\n2,3\n", "at least 5"),
        ("a;y\n1;2\n", "semicolons"),
        ("", "empty"),
    ],
)
def test_a_table_that_is_not_what_it_should_be(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match=message):
        read_data(path, ["a"], ["y"])


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "bytes.csv").write_bytes(b"a,y\n\xff\xfe,1\n")
    assert main(["analyse", str(tmp_path / "none.csv"), "--inputs", "a", "--outputs", "y"]) == 6
    assert main(["analyse", str(tmp_path / "bytes.csv"), "--inputs", "a", "--outputs", "y"]) == 2


def test_seeds_are_keyed_by_the_task() -> None:
    assert random_generator(seed=0, task="analyse a").random() != random_generator(seed=0, task="analyse b").random()
