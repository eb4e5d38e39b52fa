"""Public questions and bug reports on what this package does, each with its right value; and their
siblings.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import uqsphere
from uqsphere import analysis as A
from uqsphere.errors import StudyError, UsageError
from uqsphere.study import Study, load_study

U, N = stats.uniform(), stats.norm()
X = np.random.default_rng(5).uniform(size=(40, 2))
AB = {"a": U, "b": U}
PLATENS = """
[sphere]
E = "%s"
nu = 0.3
density = "7850 kg/m3"
radius = "%s"
[rig]
kind = "%s"
"""


def box(model: Callable[[Any], Any], inputs: dict[str, Any], **keys: Any) -> Any:
    return uqsphere.run(
        Study(inputs=inputs, outputs="y", seed=1, **keys), lambda x: {"y": model(x)}
    )


def indices(run: Any, order: str) -> dict[str, Any]:
    table = run.answers[run.answers.answer == f"sobol_{order}"].set_index("at")
    return dict(table.iterrows())


# --- right values ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("limit", "inputs", "right"),
    [
        # five of seven inputs idle; linear; two regions; nothing survives
        (
            lambda r: 0.8 * r["wall"] - r["pit"],
            {
                **{f"n{k}": N for k in range(5)},
                "wall": stats.norm(12.7, 0.3175),
                "pit": stats.lognorm(0.25, 0, 4.5),
            },
            5.97714e-4,
        ),
        (
            lambda r: 4.0 - r["a"] - r["b"],
            {"a": N, "b": N},
            float(stats.norm.sf(4.0 / math.sqrt(2.0))),
        ),
        (
            lambda r: np.minimum(
                np.where(r["x"] > 3.5, 4 - r["x"], 0.85 - 0.1 * r["x"]),
                np.where(r["y"] > 2, 0.5 - 0.1 * r["y"], 2.3 - r["y"]),
            ),
            {"x": N, "y": N},
            3.19579e-5,
        ),
        (lambda r: r["x"] - 5000.0, {"x": N}, 1.0),
        (lambda r: 3.9 - r["n"] - r["u"], {"n": stats.randint(1, 4), "u": U}, 1 / 30),
    ],
)
def test_failure_probabilities(limit: Any, inputs: Any, right: float) -> None:
    found = A.failure_probability(limit, inputs, seed=0).probability
    assert found.low <= right <= found.high
    if right == 1.0:
        assert found.reason == "no survival was reached; its probability is below 4.2e-14"


@pytest.mark.parametrize(
    ("limit", "truth"),
    [
        (lambda r: np.full(len(r["a"]), np.nan), 1.0),
        (lambda r: np.where(r["a"] > 2.0, np.nan, 5.0), float(stats.norm.sf(2.0))),
        (lambda r: np.where(r["b"] > 3.0, np.nan, 3.5 - r["b"]), float(stats.norm.sf(3.0))),
        (
            lambda r: np.where(r["a"] > 3.7, np.nan, 4.2 - r["b"]),
            float(stats.norm.sf(3.7) + stats.norm.sf(4.2)),
        ),
    ],
)
def test_rows_without_an_answer_are_never_survival(limit: Any, truth: float) -> None:
    found = A.failure_probability(limit, {"a": N, "b": N}).probability
    assert found.low < truth < 1.005 * found.high


def test_a_ball_on_a_flat_by_the_book() -> None:
    """a_max and p_max of two textbook balls; the shortest study of platens is valid as it
    stands.
    """
    face = '[%s]\nE = "%%s"\nnu = 0.3\ndensity = "7850 kg/m3"\n'
    rows = PLATENS % ("1 GPa", "8 mm", "platens") + face % "platens" + 'force = "%s"\n'
    found = uqsphere.evaluate(
        load_study(text=rows % ("1000 TPa", "188.49556 N")), {}, ("p_max", "a_max")
    )
    assert found["a_max"][0] == pytest.approx(1.00964e-3, rel=5e-6)
    assert found["p_max"][0] == pytest.approx(88.2904e6, rel=5e-6)
    steel = load_study(
        text=rows.replace("1 GPa", "200 GPa").replace("8 mm", "25 mm") % ("200 GPa", "500 N")
    )
    run = uqsphere.run(steel)
    assert run.answers.set_index(["subject", "answer"])["value"]["p_max", "mean"] == pytest.approx(
        1.23188e9, rel=5e-6
    )
    radius = (3.0 / (4.0 * math.pi * 7850.0)) ** (1.0 / 3.0)
    text = (
        PLATENS % ("200 GPa", f"{radius} m", "impact")
        + f'speed = "{math.sqrt(2 * 9.81 * 0.5)} m/s"\n'
    )
    drop = load_study(text=text + face % "target" % "200 GPa")
    fell = uqsphere.evaluate(drop, {}, ("P_max", "p_max", "time_to_first_loss")).iloc[0]
    for name, right in (
        ("P_max", 65.8227e3),
        ("p_max", 5.40464e9),
        ("time_to_first_loss", 175.061e-6),
    ):
        assert fell[name] == pytest.approx(right, rel=5e-5)


def test_a_constant_output_has_no_scatter_and_no_indices() -> None:
    run = box(lambda x: 192.53 + 0.0 * x["a"], {"a": U, "b": U})
    assert run.answers.set_index("answer")["value"]["sd"] == 0.0
    assert all(
        math.isnan(row["value"]) and "does not vary" in row["note"]
        for row in indices(run, "first").values()
    )


def test_groups_are_refused_by_name_and_copies_share_the_effect() -> None:
    with pytest.raises(StudyError, match=r"analysis\.groups: unknown key"):
        Study(inputs={"a": U}, outputs="y", analysis={"groups": {"G": ["a"]}})
    uniform, rho = stats.uniform(0, 10), 0.99999
    joint = A.joint({"x1": uniform, "x2": uniform, "x3": uniform}, {("x1", "x3"): rho})
    r, z = 2.0 * math.sin(math.pi / 6.0 * rho), np.random.default_rng(1).normal(size=(400, 3))
    z[:, 2] = r * z[:, 0] + math.sqrt(1.0 - r * r) * z[:, 2]
    x = 10.0 * stats.norm.cdf(z)
    found = A.sobol_indices(x, x.sum(axis=1) + 100.0, joint)
    for order, right in (
        ("shapley", (0.4, 0.2, 0.4)),
        ("first", (0.8, 0.2, 0.8)),
        ("total", (0.0, 0.2, 0.0)),
    ):
        assert [e.value for e in found[order].values()] == pytest.approx(right, abs=2e-3)


# --- discrete inputs ------------------------------------------------------------------------------


def test_a_discrete_input_has_its_indices_and_probability() -> None:
    law = {"dist": "discrete", "values": [1, 2, 3], "weights": [1, 2, 1]}
    run = box(
        lambda x: x["n"] + x["u"],
        {"n": law, "u": U},
        limits={"high": {"quantity": "y", "strength": 3.5}},
    )
    truth = (1 / 2) / (1 / 2 + 1 / 12)
    assert indices(run, "first")["n"]["low"] <= truth <= indices(run, "first")["n"]["high"]
    assert run.probability("high")["low"] < 1 / 8 < run.probability("high")["high"]
    assert run.samples["n"].isin([1.0, 2.0, 3.0]).all()


def test_a_discrete_uniform_of_other_packages_is_one() -> None:
    import chaospy

    for given in (
        stats.randint(1, 4),
        chaospy.DiscreteUniform(1, 3),
        {"dist": "discrete", "values": [1, 2, 3]},
    ):
        (law,) = A.joint({"n": given}).laws
        assert law.data == (1.0, 2.0, 3.0)
        study = Study(inputs={"n": given, "u": U}, outputs="y")
        assert study.random["n"].data == (1.0, 2.0, 3.0)


# --- each refusal by its own reason ---------------------------------------------------------------

REFUSED: dict[str, tuple[Callable[[], object], str]] = {
    "binomial": (
        lambda: A.joint({"n": stats.binom(3, 0.3)}),
        "discrete, and its values are not equally probable",
    ),
    "shares as weights": (
        lambda: A.joint({"n": {"dist": "discrete", "values": [1, 2], "weights": [0.5, 0.5]}}),
        "whole numbers",
    ),
    "one value": (lambda: A.joint({"n": {"dist": "discrete", "values": [1, 1]}}), "no scatter"),
    "a discrete strength": (
        lambda: Study(
            inputs={"a": U},
            outputs="y",
            limits={"l": {"quantity": "y", "strength": {"dist": "discrete", "values": [1, 2]}}},
        ),
        "discrete is for inputs",
    ),
    "expansion of a discrete input": (
        lambda: A.chaos(X, X[:, 0], {"a": stats.randint(0, 3), "b": U}),
        "is discrete",
    ),
    "swapped bounds": (
        lambda: A.joint({"x": {"dist": "uniform", "lower": 5518.0, "upper": 5408.0}}),
        "must be below",
    ),
    "overflow": (
        lambda: A.joint({"x": {"dist": "lognormal", "log_mean": 500, "log_sd": 270}}),
        "floating point",
    ),
    "negative logarithm": (
        lambda: A.joint({"x": {"dist": "loguniform", "lower": -1, "upper": 10}}),
        "positive",
    ),
    "impossible ties": (
        lambda: A.joint(
            dict.fromkeys("abc", N), {("a", "b"): 0.9, ("b", "c"): 0.9, ("a", "c"): -0.9}
        ),
        "not positive definite",
    ),
    "one name twice": (
        lambda: A.joint({"num_vars": 2, "names": ["a", "a"], "bounds": [[0, 1], [0, 1]]}),
        "different",
    ),
    "fewer names": (
        lambda: A.joint({"num_vars": 3, "names": ["a", "b"], "bounds": [[0, 1]] * 3}),
        "num_vars is 3",
    ),
    "groups": (
        lambda: A.joint(
            {"num_vars": 2, "names": ["a", "b"], "groups": ["g", "g"], "bounds": [[0, 1]] * 2}
        ),
        "groups of SALib",
    ),
    "no model": (lambda: A.failure_probability(3, AB), "a model is a function"),
    "raises everywhere": (lambda: A.failure_probability(lambda r: r["c"], AB), "KeyError: 'c'"),
    "text": (lambda: A.failure_probability(lambda r: "x", AB), "real numbers"),
    "complex": (lambda: A.failure_probability(lambda r: 1j * r["a"], AB), "real numbers"),
    "no accuracy": (
        lambda: A.failure_probability(lambda r: r["a"], AB, accuracy=math.nan),
        "accuracy",
    ),
    "strength nan": (
        lambda: A.fragility(lambda r: r["a"], AB, levels={"v": [1, 2]}, strength=math.nan),
        "strength",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_refusal_says_its_reason(name: str) -> None:
    call, reason = REFUSED[name]
    with pytest.raises((UsageError, StudyError), match=reason):
        call()


def test_rows_that_repeat_count_once() -> None:
    y = X[:, 0] + 5.0 * X[:, 1] + X[:, 0] ** 2
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        once = A.sobol_indices(X, y, AB)
    with pytest.warns(UserWarning, match="80 of 120 rows repeat another: each of the 40"):
        thrice = A.sobol_indices(np.repeat(X, 3, axis=0), np.repeat(y, 3), AB)
    assert thrice["first"]["a"].value == pytest.approx(once["first"]["a"].value, abs=1e-6)
    assert thrice["first"]["a"].evaluations == 40
    study = Study(inputs=AB, outputs="y")
    rows = uqsphere.design(study, 64)
    rows = rows.assign(y=np.exp(rows["a"]) + np.sin(40.0 * rows["b"]))
    with pytest.warns(UserWarning, match="64 of 128 rows repeat another"):
        twice = uqsphere.analyse(study, pd.concat([rows, rows]))
    assert twice.answers.equals(uqsphere.analyse(study, rows).answers)
    with pytest.raises(UsageError, match="'a': 7 cannot come from its distribution"):
        uqsphere.analyse(study, rows.assign(a=rows["a"].where(rows.index > 0, 7.0)))
    with pytest.raises(UsageError, match="complex numbers"):
        uqsphere.analyse(study, rows.assign(y=rows["y"] + 1j))
    with pytest.raises(UsageError, match="found bool"):
        A.failure_probability(lambda r: r["a"] > 0.5, AB)


@pytest.mark.parametrize("mask", [[0, 0, 0, 0, 1], [1, 0, 0, 0, 0]])
def test_masked_and_complex_tests_are_refused(mask: list[int]) -> None:
    """sherpa #695, astropy #17401: a mask that is dropped counts the masked tests."""
    values = [410.0, 455.0, 489.0, 520.0, 9000.0]
    with pytest.raises(UsageError, match="masked"):
        A.weibull_fit(np.ma.array(values, mask=mask))
    with pytest.raises(UsageError, match="complex"):
        A.weibull_fit(np.array(values) + 1j)
    fit = A.weibull_fit(values[:4])
    assert fit.failures == 4
    assert fit.shape == pytest.approx(13.680813, rel=1e-6)
    assert fit.scale == pytest.approx(486.9947, rel=1e-6)


# --- figures, checks and rows of the caller -------------------------------------------------------


@pytest.mark.parametrize(
    "settings", [{"text.usetex": True}, {"axes.facecolor": "none", "font.size": 40.0}]
)
def test_figures_do_not_depend_on_settings_of_the_user(settings: dict[str, Any]) -> None:
    """dipc-cc/hubbard #96, plotypus #67: usetex in a matplotlibrc on a machine without LaTeX."""
    import matplotlib as mpl

    from uqsphere.report.figures import pictures_of

    run = box(lambda x: x["a"] + x["b"], AB)
    plain = pictures_of(run.results)
    with mpl.rc_context(settings):
        assert pictures_of(run.results) == plain
    # what a caller sets himself holds in his own axes
    with mpl.rc_context({"font.size": 40.0}):
        assert run.plot.density("y").xaxis.label.get_size() == 40.0


def press(force: str) -> Study:
    """A soft ball between steel platens."""
    text = PLATENS % ("5 GPa", "10 mm", "platens")
    platens = f'[platens]\nmaterial = "steel"\nforce = "{force}"\n[contact]\nlaw = "hertz"\n'
    return load_study(text=text + platens)


def test_a_contact_beyond_the_sphere_is_told_beside_the_number() -> None:
    """lammps #4180, lethe #764: a/r above 1 stands on the terminal, and `evaluate` warns."""
    from uqsphere.report.terminal import summary

    run = uqsphere.run(press("3 MN"))
    assert "Check failed: all samples: the contact is not small, a/r up to 1.6" in " ".join(
        summary(run.results).split()
    )
    with pytest.warns(UserWarning, match="the contact is not small, a/r up to 1.6"):
        found = uqsphere.evaluate(press("3 MN"), {}, ("p_max", "a_max"))
    assert found["p_max"][0] == pytest.approx(5.506e9, rel=1e-3)
    assert found["a_max"][0] == pytest.approx(16.13e-3, rel=1e-3)
    # a small contact has no such word, neither there nor here
    small = uqsphere.run(press("100 N"))
    assert "Check failed" not in summary(small.results)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        uqsphere.evaluate(press("100 N"), {})


@pytest.mark.parametrize(("levels", "steps", "seed"), [(5, 2, 0), (4, 2, 1), (4, 3, 2)])
def test_observed_inputs_of_few_values_have_their_indices(
    levels: int, steps: int, seed: int
) -> None:
    """SALib #341, Ax #2398: a switch and a level; exact for independent additive inputs."""
    rng = np.random.default_rng(seed)
    level = rng.integers(1, levels + 1, 160).astype(float)
    switch = rng.integers(0, steps, 160).astype(float)
    x, y = np.c_[level, switch], level + 3.0 * switch
    with pytest.warns(UserWarning, match="repeat another"):
        first = A.sobol_indices(x, y, {"level": level, "switch": switch})["first"]
    share = level.var() / (level.var() + 9.0 * switch.var())
    assert first["level"].value == pytest.approx(share, abs=1e-9)
    assert first["switch"].value == pytest.approx(1.0 - share, abs=1e-9)
    few = np.minimum(x, [3.0, 1.0])
    with (
        pytest.warns(UserWarning, match="repeat another"),
        pytest.raises(UsageError, match="8 different rows, not 6"),
    ):
        A.sobol_indices(few, few.sum(axis=1), {"level": few[:, 0], "switch": few[:, 1]})


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        (lambda x: 0.5 * x, "does not follow its distribution"),
        (lambda x: 0.001 * x, "a thousand times too small"),
        (lambda x: x + 0.5, "cannot come from its distribution"),
        (lambda x: np.c_[x[:, 0], x[:, 0]], "depend on each other"),
    ],
)
def test_rows_that_do_not_follow_the_law_are_refused_at_both_doors(rows: Any, reason: str) -> None:
    """SALib #549, #495, UncertainSCI #100: rows on half of the range gave 0.01 for 0.59."""
    x = rows(np.random.default_rng(1).uniform(size=(300, 2)))
    y = x[:, 0] ** 3 + np.sqrt(x[:, 1])
    with pytest.raises(UsageError, match=reason):
        A.sobol_indices(x, y, AB)
    frame = pd.DataFrame(x, columns=["a", "b"]).assign(y=y)
    with pytest.raises(UsageError, match=reason):
        uqsphere.analyse(Study(inputs=AB, outputs="y"), frame)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda study: uqsphere.sample(study, -1), "count must be a whole number from 0 on"),
        (lambda study: uqsphere.sample(study, 2.5), "count must be a whole number"),
        (lambda study: uqsphere.design(study, "8"), "count must be a whole number"),
        (lambda study: uqsphere.to_salib(study, 0), "count must be a whole number from 1 on"),
        (lambda study: uqsphere.run(study, len, seconds=-1), "seconds must be a positive number"),
        (lambda study: uqsphere.run(study, len, seconds=math.nan), "seconds must be a positive"),
        (lambda study: uqsphere.run(study, len, seconds="5 s"), "seconds must be a positive"),
    ],
)
def test_numbers_of_a_caller_are_numbers(call: Any, says: str) -> None:
    """A negative time ended a run at its least rows; others raised what NumPy or SciPy say."""
    study = Study(inputs=AB, outputs="y")
    with pytest.raises(UsageError, match=says):
        call(study)
    assert len(uqsphere.sample(study, np.int64(3))) == 3
    assert len(uqsphere.design(study, 0)) == 0


def test_one_override_is_a_text() -> None:
    tables = {"inputs": {"a": 1.0}, "outputs": {"names": ["y"]}}
    assert uqsphere.load_study(tables, "inputs.a=2").fixed == {"a": 2.0}
