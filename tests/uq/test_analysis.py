"""Analyses of arrays and tables: names count, units cancel, one engine, laws of every origin,
results as tables.
"""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

import uqsphere
from uqsphere import Study, analysis
from uqsphere.errors import UsageError
from uqsphere.uq.foreign import as_law
from uqsphere.uq.interop import joint_to_chaospy, load_chaospy

LAWS = {"a": stats.norm(), "b": stats.uniform(-1.0, 2.0), "c": stats.norm()}
RNG = np.random.default_rng(3)
FRAME = pd.DataFrame(
    {"a": RNG.normal(size=200), "b": RNG.uniform(-1.0, 1.0, 200), "c": RNG.normal(size=200)}
)
OUTPUT = FRAME["a"] + 3.0 * FRAME["b"] ** 2


def values(found: analysis.Answers) -> dict[str, float]:
    return {f"{order} {name}": e.value for order, row in found.items() for name, e in row.items()}


@settings(max_examples=3, deadline=None)
@given(st.permutations("abc"), st.permutations(range(200)))
def test_columns_and_rows_go_by_their_names(columns: list[str], rows: list[int]) -> None:
    truth = values(analysis.sobol_indices(FRAME, OUTPUT, LAWS))
    moved, answers = FRAME[list(columns)], OUTPUT.iloc[rows]
    assert values(analysis.sobol_indices(moved, answers, LAWS)) == truth
    assert values(analysis.sobol_indices(FRAME.to_numpy(), OUTPUT.to_numpy(), LAWS)) == truth
    series = {"a": FRAME["a"], **{name: FRAME[name].iloc[rows] for name in "cb"}}
    made = analysis.chaos(series, answers.to_frame(), LAWS)
    assert made.predict(moved).value == pytest.approx(OUTPUT, abs=1e-9)
    assert made.predict(moved.iloc[rows]).value == pytest.approx(answers, abs=1e-9)
    assert made.germs_at(moved).tolist() == made.germs_at(FRAME).tolist()
    assert made.inside(moved).all()
    study = uqsphere.Study(inputs=LAWS, outputs="y")
    found = uqsphere.evaluate(
        study, moved.iloc[rows], model=lambda v: pd.DataFrame({"y": v["a"] + 3.0 * v["b"] ** 2})
    )
    assert found.index.tolist() == rows
    assert found["y"].reindex(FRAME.index).tolist() == OUTPUT.tolist()
    run = uqsphere.analyse(study, moved.assign(y=OUTPUT).iloc[rows])
    assert run.sobol("y")["total"].to_dict() == pytest.approx(
        {k: truth[f"total {k}"] for k in "abc"}, abs=1e-9
    )
    strengths, stopped = FRAME["a"].abs().head(20), FRAME["c"].head(20) > 1.0
    fits = [analysis.weibull_fit(strengths, flags) for flags in (stopped, stopped.sort_values())]
    assert fits[0].to_frame().equals(fits[1].to_frame())


def test_a_model_that_answers_with_a_series_is_read_by_its_index() -> None:
    def shuffled(row: dict[str, np.ndarray]) -> pd.Series:
        return pd.Series(3.0 - row["a"]).sample(frac=1.0, random_state=1)

    found, plain = (
        analysis.failure_probability(model, {"a": stats.norm()}, evaluations=6000)
        for model in (shuffled, lambda row: 3.0 - row["a"])
    )
    assert found.probability == plain.probability
    assert repr(found).startswith("<Failure: 0.0013")


@pytest.mark.parametrize(
    ("x", "y", "says"),
    [
        (FRAME[["a", "b"]], OUTPUT, "'c' is missing"),
        (FRAME.assign(d=1.0), OUTPUT, "'d' is no input"),
        (pd.concat([FRAME, FRAME[["a"]]], axis=1), OUTPUT, "'a' is there twice"),
        (FRAME, OUTPUT.iloc[:100], "index of y is not that"),
        (FRAME, OUTPUT.set_axis(range(1, 201)), "index of y is not that"),
        ({**FRAME, "b": FRAME["b"].head(100)}, OUTPUT, "index of the column 'b' is not that"),
        (FRAME.to_numpy()[:, :2], OUTPUT.to_numpy(), r"rows of shape \(n, 3\)"),
        (FRAME, OUTPUT.where(OUTPUT < 2.0), "finite"),
        (FRAME.astype(str) + "x", OUTPUT, "no columns of numbers"),
    ],
)
def test_what_does_not_go_together_is_refused(x: Any, y: Any, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        analysis.sobol_indices(x, y, LAWS)


def noisy(unit: float, n: int = 96) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    x = rng.normal(size=(n, 3))
    return x, unit * np.exp(0.3 * x[:, 0] + 0.2 * x[:, 1] * x[:, 2] + 0.05 * rng.normal(size=n))


NORMALS = {name: stats.norm() for name in "abc"}


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_half_widths_of_predictions_scale_with_the_output(unit: float) -> None:
    one, other = (analysis.chaos(*noisy(k), NORMALS).predict(RNG_ROWS) for k in (1.0, unit))
    assert other.value == pytest.approx(unit * one.value, rel=1e-8)
    assert other.high - other.low == pytest.approx(unit * (one.high - one.low), rel=1e-6)


RNG_ROWS = np.random.default_rng(9).normal(size=(400, 3))


def test_predictions_cover_and_say_what_lies_beyond_the_laws() -> None:
    x, y = noisy(1.0, 128)
    made = analysis.chaos(x, y, NORMALS)
    fresh, truth = noisy(1.0, 4000)
    _, low, high = made.predict(fresh)
    assert 0.9 <= np.mean((low <= truth) & (truth <= high)) <= 0.995
    bounded = analysis.chaos(FRAME, OUTPUT, LAWS)
    rows = {"a": [0.0, 0.0], "b": [0.5, 1.5], "c": [0.0, 0.0]}
    with pytest.raises(UsageError, match="1 of 2 rows lie beyond"):
        bounded.predict(rows)
    value = bounded.predict(rows, outside="nan").value
    assert value[0] == pytest.approx(0.75)
    assert math.isnan(value[1])


@pytest.mark.filterwarnings("ignore:`newshape`:DeprecationWarning")
def test_an_expansion_is_a_table_and_chaospys() -> None:
    made = analysis.chaos(FRAME, OUTPUT, LAWS, plain=True)
    assert made.to_frame().columns.tolist() == ["a", "b", "c", "coefficient"]
    mean, sd = made.moments()
    assert (mean, sd) == pytest.approx((1.0, math.sqrt(1.0 + 9.0 * 4.0 / 45.0)), rel=1e-9)
    theirs = made.chaospy()
    assert theirs.polynomial(*made.germs_at(FRAME).T) == pytest.approx(
        made.predict(FRAME).value, rel=1e-9
    )
    assert "terms" in repr(made)


def test_rough_outputs_have_wide_intervals() -> None:
    found = analysis.sobol_indices(FRAME, RNG.normal(size=200), LAWS)
    assert all(estimate.low < 0.02 for estimate in found["first"].values())
    assert all(estimate.high > 0.9 for estimate in found["total"].values())
    # parts of the variance mean nothing without an expansion where inputs are tied
    tied = analysis.joint(LAWS, {tuple(LAWS)[:2]: 0.5})
    with pytest.raises(UsageError, match="give more rows, or call the model"):
        analysis.sobol_indices(tied.physical(RNG.normal(size=(200, 3))), RNG.normal(size=200), tied)


# --- rows that do not follow what is declared -----------------------------------------------------


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda x: x.assign(a=1000.0 * x["a"]), "a thousand times too large"),
        (lambda x: x.rename(columns={"a": "b", "b": "a"}), "seem to be swapped"),
        (lambda x: x.assign(a=0.9 * x["c"] + 0.436 * x["a"]), "depend on each other"),
        (lambda x: x.assign(b=x["b"] + 3.0), "cannot come from its distribution"),
    ],
)
def test_one_check_of_rows_at_every_door_names_the_likely_cause(change: Any, cause: str) -> None:
    rows = change(FRAME)
    for door in (analysis.chaos, analysis.sobol_indices):
        with pytest.raises(UsageError, match=cause):
            door(rows, OUTPUT, LAWS)
    study = uqsphere.Study(inputs=LAWS, outputs="y")
    with pytest.raises(UsageError, match=cause):
        uqsphere.analyse(study, rows.assign(y=OUTPUT))


def test_a_typo_in_a_limit_function_is_refused_after_four_calls() -> None:
    calls = []

    def limit(row: dict[str, Any]) -> Any:
        calls.append(len(row["a"]))
        return row["typo"]

    with pytest.raises(UsageError, match="KeyError"):
        analysis.failure_probability(limit, LAWS)
    assert len(calls) == 4


def test_labelled_arrays_go_by_their_names() -> None:
    xarray = pytest.importorskip("xarray")
    truth = values(analysis.sobol_indices(FRAME, OUTPUT, LAWS))
    array = xarray.DataArray(
        FRAME[["c", "b", "a"]].to_numpy(), dims=("row", "v"), coords={"v": ["c", "b", "a"]}
    )
    outputs = xarray.DataArray(OUTPUT.to_numpy(), dims="row")
    for rows in (array, array.T, xarray.Dataset.from_dataframe(FRAME)):
        assert values(analysis.sobol_indices(rows, outputs, LAWS)) == pytest.approx(truth)
    data = xarray.Dataset({"y": outputs})
    assert values(analysis.sobol_indices(array, data, LAWS)) == pytest.approx(truth)
    with pytest.raises(UsageError, match="a coordinate that names its columns"):
        analysis.chaos(array.drop_vars("v"), outputs, LAWS)


def test_masked_and_complex_numbers_are_refused() -> None:
    with pytest.raises(UsageError, match="complex"):
        analysis.chaos(FRAME, OUTPUT + 1j, LAWS)
    masked = np.ma.masked_array(FRAME.to_numpy(), mask=False)
    with pytest.raises(UsageError, match="masked"):
        analysis.chaos(masked, OUTPUT, LAWS)
    with pytest.raises(UsageError, match="masked"):
        analysis.chaos(FRAME, np.ma.masked_array(OUTPUT, mask=False), LAWS)


@pytest.mark.parametrize(
    ("column", "says"),
    [
        (np.arange("2020-01-01", "2021-01-01", dtype="M8[D]"), "dates or durations"),
        (np.arange(366).astype("m8[h]"), "dates or durations"),
        (pd.Series(pd.date_range("2020", periods=366, tz="UTC")), "not 'Timestamp'"),
        (np.array([np.timedelta64(3, "h")] * 366, dtype=object), "dates or durations"),
        (np.array([0.5 + 1j] * 366, dtype=object), "complex"),
    ],
)
def test_dates_and_durations_are_no_numbers(column: Any, says: str) -> None:
    """NumPy turns them into days or nanoseconds."""
    x = column[:64]
    y = np.linspace(0.0, 1.0, 64)
    law = {"a": {"dist": "uniform", "lower": 0, "upper": 1}}
    study = Study(inputs=law, outputs="y")

    def identity(rows: dict[str, np.ndarray]) -> np.ndarray:
        return rows["a"]

    calls: list[Callable[[], object]] = [
        lambda: analysis.chaos(y[:, None], x, law),
        lambda: analysis.chaos({"a": x}, y, law),
        lambda: analysis.joint({"a": x}),
        lambda: analysis.weibull_fit(x),
        lambda: analysis.weibull_fit(y + 1.0, counts=x),
        lambda: analysis.fragility(identity, law, levels={"v": x}, strength=1.0),
        lambda: uqsphere.analyse(study, pd.DataFrame({"a": y, "y": x})),
        lambda: uqsphere.analyse(study, pd.DataFrame({"a": x, "y": y})),
        lambda: uqsphere.evaluate(study, {"a": x}, model=identity),
    ]
    for call in calls:
        with pytest.raises(UsageError, match=says):
            call()


def test_masked_answers_are_no_numbers() -> None:
    """What lies under a mask counted as an answer, or as an observation."""
    data = np.ma.masked_greater(np.linspace(0.0, 1.0, 16), 0.9)
    with pytest.raises(UsageError, match="masked"):
        analysis.joint({"a": data})
    law = {"a": {"dist": "normal", "mean": 0, "sd": 1}}
    risk = analysis.failure_probability(
        lambda rows: np.ma.masked_less(3.0 - rows["a"], 0.0), law, evaluations=2000
    )
    assert risk.probability.value is None


def test_tests_are_as_many_as_a_table_may_have() -> None:
    with pytest.raises(UsageError, match="at most 2,000,000 tests"):
        analysis.weibull_fit([1.0, 2.0], counts=[1e9, 1e9])


def test_an_expansion_is_sampled_and_kept_in_a_file(tmp_path: Any) -> None:
    made = analysis.chaos(FRAME.set_index(FRAME.index + 7), OUTPUT.to_numpy(), LAWS)
    made.save(tmp_path / "y.expansion")
    again = analysis.Expansion.load(tmp_path / "y.expansion")
    assert again.sample(5, seed=1).equals(made.sample(5, seed=1))
    # y = a + 3 b²: mean 1, median by simulation
    draws = RNG.normal(size=10**6) + 3.0 * RNG.uniform(-1.0, 1.0, 10**6) ** 2
    assert made.quantiles([0.1, 0.5]) == pytest.approx(np.quantile(draws, [0.1, 0.5]), abs=0.02)
    rows = FRAME.set_index(FRAME.index + 7).head(3)
    assert made.predict(rows).to_frame().index.tolist() == [7, 8, 9]
    # a Series is one row, whose index is its name
    assert made.predict(rows.loc[8]).to_frame().index.tolist() == [8]
    for content in (b"nothing", pickle.dumps(made.names), b'{"class": "system"}', b"[1, 2]"):
        (tmp_path / "other").write_bytes(content)
        with pytest.raises(UsageError, match="does not hold an expansion"):
            analysis.Expansion.load(tmp_path / "other")


def test_the_file_of_an_expansion_keeps_laws_of_all_kinds_and_dependence(tmp_path: Any) -> None:
    # polynomials of their own, of few values, and of a law of SciPy; an expansion of ln y
    laws = analysis.joint(
        {
            "a": {"dist": "beta", "alpha": 2.0, "beta": 3.0, "lower": 0.0, "upper": 1.0},
            "b": stats.gamma(3.0),
            "c": RNG.integers(0, 3, 96).astype(float),
        },
        {("a", "b"): 0.3},
    )
    rows = laws.physical(RNG.normal(size=(96, 3)))
    made = analysis.chaos(rows, np.exp(rows[:, 0] + 0.1 * rows[:, 1]), laws)
    made.save(tmp_path / "y.json")
    again = analysis.Expansion.load(tmp_path / "y.json")
    assert again.fit.log
    assert np.array_equal(again.predict(rows[:5]).high, made.predict(rows[:5]).high)
    assert again.indices() == made.indices()
    chaospy = load_chaospy()
    odd = analysis.joint({"a": chaospy.Cauchy(), "b": stats.norm()})
    rows = odd.physical(RNG.normal(size=(64, 2)))
    with pytest.raises(UsageError, match="cannot keep the functions"):
        analysis.chaos(rows, rows[:, 1], odd).save(tmp_path / "y.json")


def test_failure_probability_of_tied_inputs_that_fail_and_raise() -> None:
    tied = analysis.joint({"r": stats.norm(7.0, 1.0), "s": stats.norm(2.0, 1.0)}, {("r", "s"): 0.5})
    rho = 2.0 * math.sin(math.pi * 0.5 / 6.0)
    truth = stats.norm.sf(5.0 / math.sqrt(2.0 - 2.0 * rho))
    found = analysis.failure_probability(lambda row: {"g": row["r"] - row["s"]}, tied, seed=1)
    assert found.probability.low <= truth <= found.probability.high
    assert found.sure
    assert found.to_frame().loc[0, "value"] == found.probability.value

    def strict(row: dict[str, np.ndarray]) -> np.ndarray:
        if (row["r"] < 0.0).any():
            raise RuntimeError("no such radius")
        return row["r"] - 1.4

    radius = analysis.failure_probability(strict, {"r": stats.norm(2.0, 0.3)}, evaluations=6000)
    assert radius.probability.low <= stats.norm.cdf(-2.0) <= radius.probability.high
    with pytest.raises(UsageError, match="nan at"):
        analysis.failure_probability(
            strict, {"r": stats.norm(2.0, 0.3)}, evaluations=6000, on_failure="refuse"
        )
    with pytest.raises(UsageError, match="one output is required"):
        analysis.failure_probability(lambda row: {"a": row["r"], "b": row["r"]}, tied)


def test_a_fragility_curve_with_its_levels() -> None:
    curve = analysis.fragility(
        lambda row: row["v"] * np.exp(0.2 * row["z"]),
        {"z": stats.norm()},
        levels={"v": np.geomspace(0.5, 3.0, 13)},
        strength=stats.lognorm(0.15, scale=1.5),
    )
    assert curve.values[0.5].value == pytest.approx(1.5, rel=1e-3)
    assert curve.level(0.5) == curve.values[0.5]
    assert curve.level(0.1).value == pytest.approx(
        1.5 * math.exp(-0.25 * stats.norm.ppf(0.9)), rel=1e-3
    )
    with pytest.raises(UsageError, match="between 0 and 1, found 2"):
        curve.level(2)
    with pytest.raises(UsageError, match="one free input is required, found v, w"):
        analysis.fragility(lambda row: row["v"], {}, levels={"v": [1], "w": [1]}, strength=1.0)
    assert curve.to_frame().shape == (13, 4)
    with pytest.raises(UsageError, match="z is free"):
        analysis.fragility(
            lambda row: row["z"], {"z": stats.norm()}, levels={"z": [1.0, 2.0]}, strength=1.0
        )


def test_strengths_are_fitted_from_tests_some_of_them_stopped_or_alike() -> None:
    assert analysis.weibull_fit([0.62, 0.81, 0.93, 1.02, 1.1, 1.21]).failures == 6
    assert analysis.lognormal_fit([0.62, 0.81, 0.93], [False, False, False]).tests == 3
    assert analysis.weibull_fit([0.62, 0.81], counts=[3, 2]) == analysis.weibull_fit(
        [0.62] * 3 + [0.81] * 2
    )


# --- distributions that people have ---------------------------------------------------------------


def test_new_distributions_of_scipy_and_observations_are_laws() -> None:
    x = np.random.default_rng(2).normal(3.0, 0.5, 300)
    p = np.array([0.01, 0.5, 0.99])
    assert as_law(stats.Normal(mu=3.0, sigma=0.5)).ppf(p) == pytest.approx(
        stats.norm(3.0, 0.5).ppf(p), rel=1e-9
    )
    assert as_law(stats.Uniform(a=1.0, b=3.0)).ppf(p) == pytest.approx(1.0 + 2.0 * p)
    assert as_law(x.tolist()).mean() == pytest.approx(x.mean())
    for wrong, says in (
        (stats.norm, "freeze a law"),
        (stats.gaussian_kde(x), "give observations"),
        (3.0, "give a law"),
        (np.zeros((3, 3)), "observations"),
        ({"dist": "empirical", "values": [1, 2, 3]}, "must be a number"),
    ):
        with pytest.raises(ValueError, match=says):
            as_law(wrong)


def test_a_problem_of_salib_is_a_set_of_inputs() -> None:
    problem = {
        "num_vars": 2,
        "names": ["a", "b"],
        "bounds": [[0.0, 2.0], [1.0, 0.1]],
        "dists": ["unif", "norm"],
    }
    made = analysis.joint(problem)
    assert made.names == ("a", "b")
    assert [law.mean() for law in made.laws] == pytest.approx([1.0, 1.0])
    with pytest.raises(UsageError, match="known: unif"):
        analysis.joint(problem | {"dists": ["unif", "cauchy"]})


def test_a_joint_law_goes_over_to_chaospy_and_its_parts_come_back() -> None:
    chaospy = load_chaospy()
    laws = {"x": stats.norm(1.0, 2.0), "y": stats.gumbel_r(0.0, 1.0), "z": stats.beta(2, 3)}
    theirs = joint_to_chaospy(analysis.joint(laws, {("x", "y"): 0.6}))
    drawn = theirs.sample(4000, seed=1)
    assert stats.spearmanr(drawn[0], drawn[1]).statistic == pytest.approx(0.6, abs=0.05)
    with pytest.raises(UsageError, match="give each number its own law"):
        analysis.joint({"a": chaospy.J(chaospy.Normal(), chaospy.Uniform())})
    with pytest.raises(UsageError, match="no Student t copula"):
        joint_to_chaospy(analysis.joint(laws, {("x", "y"): 0.6}, copula="student_t", dof=4.0))
