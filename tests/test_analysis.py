"""Analyses of plain arrays, surrogates as objects, and what goes over to SALib, chaospy and xarray."""

from __future__ import annotations

import gc
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import uqsphere
from uqsphere import analysis
from uqsphere.errors import AccessError, UsageError
from uqsphere.uq.estimate import Estimate
from uqsphere.uq.interop import joint_to_chaospy

RNG = np.random.default_rng
ANGLE = stats.uniform(-np.pi, 2.0 * np.pi)
ANGLES = {"a": ANGLE, "b": ANGLE, "c": ANGLE}
#: of Ishigami's function with a = 7, b = 0.1 (T. Homma, A. Saltelli, Rel. Eng. & System Safety 52, 1996, 1)
FIRST, TOTAL = (0.3139, 0.4424, 0.0), (0.5576, 0.4424, 0.2437)


def ishigami(rows: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    a, b, c = (rows[name] for name in "abc")
    return {"y": np.sin(a) + 7.0 * np.sin(b) ** 2 + 0.1 * c**4 * np.sin(a)}


def rows_of(n: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    x = RNG(seed).uniform(-np.pi, np.pi, (n, 3))
    return x, ishigami(dict(zip("abc", x.T, strict=True)))["y"]


def holds(estimate: Estimate, truth: float, room: float = 0.0) -> bool:
    return estimate.low - room <= truth <= estimate.high + room


@pytest.fixture(scope="module")
def surrogate() -> analysis.Surrogate:
    return analysis.chaos(*rows_of(256), ANGLES, plain=True)


def test_an_expansion_answers_with_intervals_that_hold(surrogate: analysis.Surrogate) -> None:
    x, y = rows_of(2000, seed=2)
    x, y = x[(inside := (np.abs(x) < 3.05).all(axis=1))], y[inside]
    value, low, high = surrogate.predict(x)
    assert np.mean((low <= y) & (y <= high)) >= 0.93
    assert np.abs(value - y).max() < 0.5
    assert np.array_equal(value, surrogate.predict(dict(zip("abc", x.T, strict=True))).value)
    found = surrogate.indices()
    for order, truth in (("first", FIRST), ("total", TOTAL)):
        assert all(holds(found[order][name], t, 2e-3) for name, t in zip("abc", truth, strict=True))


def test_the_module_shows_what_is_public() -> None:
    assert dir(analysis) == sorted(analysis.__all__)


def test_points_beyond_the_rows_are_refused_with_the_input(surrogate: analysis.Surrogate) -> None:
    with pytest.raises(UsageError, match=r"b = 4 lies outside of -3\.1"):
        surrogate.predict({"a": 0.0, "b": 4.0, "c": 0.0})
    rows = np.array([[0.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.5, 0.0, 0.0]])
    with pytest.raises(UsageError, match=r"row 1 of 3, from 0: b = 4 .*; 1 rows of 3 lie outside"):
        surrogate.predict(rows)
    assert surrogate.inside(rows).tolist() == [True, False, True]
    assert surrogate.predict(rows[surrogate.inside(rows)]).value.shape == (2,)
    with pytest.raises(UsageError, match="c is missing"):
        surrogate.predict({"a": 0.0, "b": 0.0})
    tied = analysis.joint({"u": stats.norm(), "v": stats.norm()}, {("u", "v"): 0.95})
    x = tied.physical(RNG(3).normal(size=(200, 2)))
    made = analysis.chaos(x, x.sum(axis=1), tied)
    assert made.predict([[1.0, 1.0]]).value[0] == pytest.approx(2.0)
    with pytest.raises(UsageError, match="u = 1, v = -1: no row lies so far"):
        made.predict([[1.0, -1.0]])


def test_a_surrogate_is_saved_without_pickle_and_read_bit_by_bit(tmp_path: Path) -> None:
    inputs = {"a": stats.gumbel_r(1.0, 0.2), "b": stats.beta(2, 3)}
    x = np.column_stack([law.rvs(200, random_state=RNG(4)) for law in inputs.values()])
    made = analysis.chaos(x, x[:, 0] * (1.0 + x[:, 1]) ** 3, inputs, plain=True)
    polynomial = made.to_chaospy()
    assert polynomial(*made.germs(x[:50]).T) == pytest.approx(made.predict(x[:50]).value, abs=1e-12)
    path = made.save(tmp_path / "s.npz")
    with np.load(path, allow_pickle=False) as stored:
        assert str(stored["document"]).startswith("{")
    again = uqsphere.load_surrogate(path)
    for one, other in zip(made.predict(x[:50]), again.predict(x[:50]), strict=True):
        assert np.array_equal(one, other)
    assert repr(again) == repr(made)
    path.write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(UsageError, match="holds no surrogate"):
        uqsphere.load_surrogate(path)
    with pytest.raises(AccessError):
        uqsphere.load_surrogate(tmp_path / "none.npz")


def test_a_joint_law_goes_over_to_chaospy() -> None:
    laws = {"x": stats.norm(1.0, 2.0), "y": stats.gumbel_r(0.0, 1.0), "z": stats.beta(2, 3)}
    for ties in (None, {("x", "y"): 0.6}):
        mine = analysis.joint(laws, ties)
        theirs = joint_to_chaospy(mine)
        x = mine.physical(RNG(6).normal(size=(50, 3)))
        if ties is None:
            np.testing.assert_allclose(
                theirs.pdf(x.T), np.prod([law.pdf(c) for law, c in zip(mine.laws, x.T, strict=True)], 0)
            )
        drawn = theirs.sample(4000, seed=1)
        assert stats.spearmanr(drawn[0], drawn[1]).statistic == pytest.approx(0.6 if ties else 0.0, abs=0.05)
    with pytest.raises(UsageError, match="no copula of this form"):
        joint_to_chaospy(analysis.joint(laws, {("x", "y"): 0.6}, copula="clayton"))


@pytest.mark.parametrize("second", [False, True])
def test_salib_finds_the_same_indices_on_our_design(second: bool, surrogate: analysis.Surrogate) -> None:
    from SALib.analyze import sobol

    laws = {name: {"dist": "uniform", "lower": -np.pi, "upper": np.pi} for name in "abc"}
    study = uqsphere.load_study({"inputs": laws, "outputs": {"names": ["y"]}})
    design = study.to_salib(2048, second=second)
    y = ishigami(dict(zip("abc", design.rows.T, strict=True)))["y"]
    found = sobol.analyze(design.problem, y, calc_second_order=second, num_resamples=20, seed=1)
    for order, key in (("first", "S1"), ("total", "ST")):
        for k, estimate in enumerate(surrogate.indices()[order].values()):
            assert holds(estimate, found[key][k], found[f"{key}_conf"][k])
    if second:
        assert found["S2"][0, 2] == pytest.approx(0.2437, abs=0.03)


def test_a_run_without_a_folder_says_what_salib_makes_of_its_rows() -> None:
    laws = dict.fromkeys("abc", ANGLE)
    study = uqsphere.load_study({"inputs": laws, "outputs": {"names": ["y"]},
                                 "analysis": {"budget": {"evaluations": 8_000}, "cost": "1 us"}})  # fmt: skip
    run = uqsphere.run(study, ishigami)
    folder = run.folder
    assert repr(run) == "<Run: y>"
    assert "SALib's estimators on the same rows agree on 6" in run.results.sensitivity["y"].check.text
    assert set(run.quantities()["statistic"]) >= {"mean", "sd"}
    found = run.surrogate(rows=300)
    assert found.predict([[0.1, 0.2, 0.3]]).value[0] == pytest.approx(
        ishigami({"a": 0.1, "b": 0.2, "c": 0.3})["y"], abs=0.3
    )
    xarray = pytest.importorskip("xarray")
    rows = run.to_xarray()
    assert isinstance(rows, xarray.Dataset)
    assert rows["y"].dims == ("chain", "draw")
    assert rows.attrs["inference_library"] == "uqsphere"
    frame = uqsphere.evaluate(study, {"a": [0.1, 0.2]}, model=ishigami)
    due = ishigami({"a": np.array([0.1, 0.2]), "b": np.zeros(2), "c": np.zeros(2)})["y"]
    assert frame["y"].to_numpy() == pytest.approx(due)
    with pytest.raises(UsageError, match="unknown input 'q'"):
        uqsphere.evaluate(study, {"q": 1.0}, model=ishigami)
    assert folder.is_dir()
    del run
    gc.collect()
    assert not folder.exists()


def test_shares_of_tied_inputs_are_those_of_a_linear_model() -> None:
    tied = analysis.joint({"u": stats.norm(), "v": stats.norm()}, {("u", "v"): 0.5})
    x = tied.physical(RNG(8).normal(size=(300, 2)))
    y = x @ [1.0, 2.0]
    r = float(tied.correlation[0, 1])
    whole = 5.0 + 4.0 * r
    # A. B. Owen, C. Prieur, SIAM/ASA J. Uncertainty Quantification 5, 2017, 986, two inputs
    expected = (1.0 * (1 - r**2 / 2) + 2.0 * r + 4.0 * r**2 / 2) / whole
    assert holds(analysis.shapley_effects(x, y, tied)["u"], expected, 5e-3)
    first = analysis.kucherenko_indices(x, y, tied)["first"]["u"]
    assert holds(first, (1.0 + 2.0 * r) ** 2 / whole, 5e-3)
    with pytest.raises(UsageError, match="depend on each other"):
        analysis.sobol_indices(x, y, tied)


def test_moment_free_indices_of_rows() -> None:
    x, y = rows_of(2048, seed=9)
    ranks = analysis.rank_indices(x, y, "abc")
    assert all(holds(ranks[name], truth, 0.05) for name, truth in zip("abc", FIRST, strict=True))
    delta = analysis.delta_indices(x, y, ANGLES)
    # their order: E. Borgonovo, Rel. Eng. & System Safety 92, 2007, 771
    assert delta["b"].value > delta["a"].value > delta["c"].value > 0.05
    pawn, threshold = analysis.pawn_indices(x, np.sin(x[:, 0]))
    assert pawn["x1"].value > threshold > pawn["x2"].value * 0.5


def test_a_failure_probability_of_tied_inputs() -> None:
    tied = analysis.joint({"u": stats.norm(), "v": stats.norm()}, {("u", "v"): 0.6})
    truth = stats.norm.cdf(-3.5 / np.sqrt(2.0 + 2.0 * tied.correlation[0, 1]))
    for evaluations in (150, 20_000):
        found = analysis.failure_probability(lambda r: 3.5 + r["u"] + r["v"], tied, evaluations=evaluations)
        assert holds(found.probability, truth, 0.02 * truth), found
        assert found.design_point["u"] == pytest.approx(-1.75, abs=0.05)
        assert found.sure


def test_a_fragility_curve_of_two_lognormal_laws() -> None:
    found = analysis.fragility(
        lambda r: r["v"] * r["k"], {"k": stats.lognorm(0.1)}, free="v", levels=np.linspace(0.5, 2.0, 13),
        strength=stats.lognorm(0.2), evaluations=26_000,
    )  # fmt: skip
    assert found.values[0.5].value == pytest.approx(1.0, abs=1e-3)
    assert found.lognormal.dispersion.value == pytest.approx(np.hypot(0.1, 0.2), rel=5e-3)
    with pytest.raises(UsageError, match="free and cannot scatter"):
        analysis.fragility(lambda r: r["v"], {"v": stats.norm()}, free="v", levels=[1.0, 2.0], strength=1.0)


def blocks_of(page: str) -> list[str]:
    text = (Path(uqsphere.__file__).parent.parent / "docs" / page).read_text("utf-8")
    return [part.partition("```")[0] for part in text.split("```python\n")[1:]]


def test_the_borehole_from_laws_to_figures(capsys: pytest.CaptureFixture[str]) -> None:
    from matplotlib import pyplot

    pyplot.switch_backend("Agg")
    ours, theirs = blocks_of("borehole.md")
    assert sum(map(bool, ours.splitlines())) <= 26
    known: dict[str, object] = {}
    exec(ours.replace("50_000", "8_000").replace("rows=512", "rows=60"), known)
    pyplot.close("all")
    assert holds(known["run"].results.sensitivity["flow"].first["rw"], 0.6594, 0.01)  # type: ignore[attr-defined]
    assert "Failure(probability=Estimate(value=0.00015" in capsys.readouterr().out
    if find_spec("openturns"):
        exec(theirs, {})
