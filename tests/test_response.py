"""A response corrected by rows that it has not seen: the error, the interval, shares, and what lies beyond the rows."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

import uqsphere
from tests.campaigns.coverage import CoverageModel, coverage_models
from uqsphere.arrays import Array
from uqsphere.cli.run import Progress
from uqsphere.given.answers import given_answers
from uqsphere.mechanics.history import FieldView
from uqsphere.report import build_report
from uqsphere.report.brief import summary_of
from uqsphere.report.contents import read_contents
from uqsphere.runner.evaluate import Ledger, Work, draw
from uqsphere.runner.questions.fields import find_courses
from uqsphere.study import Study
from uqsphere.uq.estimate import Estimate, absent
from uqsphere.uq.expansion import Chaos, Piece, chaos_indices, fit_chaos, germ_points, held, predict
from uqsphere.uq.expansion.expansion import Border
from uqsphere.uq.expansion.shares import law_shares
from uqsphere.uq.joint import Joint
from uqsphere.uq.law import make_law
from uqsphere.uq.points import sobol_points
from uqsphere.uq.response import Response, answered, cross_fit, group_shares, half_width, index_shares, pair_shares
from uqsphere.uq.surrogate import response_from

MODELS = {model.name: model for model in coverage_models()}
NORMAL = ("normal", "normal")


def fitted(name: str, n: int, seed: int = 3) -> tuple[CoverageModel, Array, Array]:
    model = MODELS[name]
    u = sobol_points(dimension=model.dimension, count=n, seed=seed, task="dear", replicate=0)
    points = germ_points(np.asarray(ndtri(u)), model.germs)
    return model, points, model.function(u)


def test_every_row_is_compared_with_a_response_that_has_not_seen_it() -> None:
    model, points, outputs = fitted("ishigami", 64)
    response = cross_fit(points, outputs, model.germs)[0]
    spoiled = outputs.copy()
    spoiled[17] += 100.0
    other = cross_fit(points, spoiled, model.germs)[0]
    assert other.levels[17] == response.levels[17]
    assert other.residuals[17] == pytest.approx(response.residuals[17] + 100.0)
    assert sorted(np.bincount(response.folds)) == [8] * 8


def test_the_error_of_a_response_is_that_of_runs_left_out() -> None:
    model, points, outputs = fitted("kinked", 64)
    rough = cross_fit(points, outputs, model.germs)[0]
    assert rough.error >= float(np.var(rough.residuals) / np.var(outputs)) * 0.9
    assert not rough.usable
    assert rough.reason.startswith("refused: it leaves")
    smooth = cross_fit(points, outputs.mean() + points[:, 0] + points[:, 1] ** 2, model.germs)[0]
    assert smooth.usable
    assert smooth.error < 1e-20


def test_rows_elsewhere_fit_a_response_that_its_own_rows_correct() -> None:
    """y = (1 + s) x + s, s in [-1, 1]: of rows along s and rows at s = 0.5, the response at 0.5."""
    rng = np.random.default_rng(5)
    points = rng.uniform(-1.0, 1.0, (48, 2))
    points[:24, 1] = 0.5
    outputs = (1.0 + points[:, 1]) * points[:, 0] + points[:, 1]
    own = np.arange(48) < 24
    section = cross_fit(points, outputs, ("uniform",) * 2)[0].of_rows(own).held(0.5)
    assert section.germs == ("uniform",)
    assert section.count == 24
    assert section.error < 1e-20
    x = np.linspace(-1.0, 1.0, 5)[:, None]
    np.testing.assert_allclose(section.at(x), 1.5 * x[:, 0] + 0.5, atol=1e-12)


@pytest.mark.parametrize("kind", ["axis", "score", "upper", "lower"])
def test_two_pieces_keep_their_border_where_an_input_is_held(kind: str) -> None:
    rng = np.random.default_rng(2)
    terms = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 1], [0, 0, 2], [1, 0, 1]])
    pieces = tuple(Piece(coefficients=rng.normal(size=5), multi_indices=terms, transform=None) for _ in range(2))
    germs = ("uniform", "normal", "uniform")
    axis, count = (2, 0) if kind == "axis" else (0, 10)
    border = Border(kind=kind, axis=axis, at=0.1, weights=rng.normal(size=count) if kind == "score" else None)
    whole = Chaos(pieces=pieces, border=border, germs=germs, cross_validation_error=0.0, samples=9, solver="")
    x = rng.uniform(-1.0, 1.0, (200, 2))
    for value in (-0.6, 0.4):
        there = np.column_stack([x, np.full(200, value)])
        np.testing.assert_allclose(predict(held(whole, value), x), predict(whole, there), atol=1e-12)


def test_an_interval_that_few_rows_carry_knows_that_they_are_few() -> None:
    """Of n normal influences it is Student's; one row that moves everything leaves two degrees of freedom."""
    rng = np.random.default_rng(1)
    hits = []
    for _ in range(400):
        values = rng.normal(size=12)
        hits.append(abs(float(values.mean())) <= half_width(values))
    assert 0.92 <= np.mean(hits) <= 0.98
    lone = np.zeros(64)
    lone[0] = 1.0
    assert half_width(lone) == pytest.approx(4.2 / 64.0, rel=0.05)


def test_a_constant_output_has_no_shares() -> None:
    _, points, _ = fitted("kinked", 32)
    constant: Response = cross_fit(points, np.full(32, 3.0), MODELS["kinked"].germs)[0]
    assert constant.usable
    assert all(e.value is None for row in index_shares(constant).values() for e in row)


# --- shares of the variance -----------------------------------------------------------------------------


def test_shares_of_a_straight_line_are_exact() -> None:
    points = 2.0 * sobol_points(dimension=2, count=32, seed=1, task="line", replicate=0) - 1.0
    one = cross_fit(points, 3.0 + 2.0 * points[:, 0] + points[:, 1], ("uniform",) * 2)[0]
    found = index_shares(one)
    for order in ("first", "total"):
        assert [e.value for e in found[order]] == pytest.approx([0.8, 0.2], abs=1e-12)
        assert max(e.half_width for e in found[order]) < 1e-9


def test_numerator_and_denominator_are_corrected_by_the_same_rows() -> None:
    """Noise that no input makes is in the variance, and in the share of none; what is left may be that of any input."""
    model, points, outputs = fitted("ishigami", 128)
    one = cross_fit(points, outputs, model.germs)[0]
    noise = np.random.default_rng(1).normal(0.0, 0.15 * float(outputs.std()), 128)
    rough = replace(one, outputs=outputs + noise, residuals=one.residuals + noise, error=0.0225)
    found = index_shares(rough)
    for j in range(3):
        e = found["first"][j]
        assert e.low <= model.first[j] / 1.0225 <= e.high
    assert found["first"][1].high - found["first"][1].value >= 0.0225  # what is left may be any input's


def test_pairs_and_groups_are_shares_like_those_of_one_input() -> None:
    model, points, outputs = fitted("ishigami", 128)
    one = cross_fit(points, outputs, model.germs)[0]
    pair = pair_shares(one, [(0, 2), (0, 1)])
    closed, total = group_shares(one, [[0, 2], [1]])
    single = index_shares(one)
    for group, one in ((closed[1], single["first"][1]), (total[1], single["total"][1])):
        assert (group.value, group.low, group.high) == pytest.approx((one.value, one.low, one.high), rel=1e-13)
    truth = model.total[0] - model.first[0]
    assert pair[0].value == pytest.approx(truth, abs=1e-3)
    assert _hold([pair[0]], truth) == _hold([closed[0]], 1.0 - model.first[1]) == [True]


def test_shares_of_a_fit_with_a_kink_do_not_run_away() -> None:
    model, points, outputs = fitted("kinked", 128, seed=2000)
    chaos = fit_chaos(points, outputs, model.germs)
    assert chaos.border is not None
    assert chaos.cross_validation_error < 1e-6
    shares = np.array([law_shares(chaos, [[j] for j in range(4)], k) for k in range(3)])
    truth = np.array([model.first, model.total]).T
    assert np.abs(shares - truth).max() < 0.03  # half of it at most in ten designs; a control that is not gated: 0.4
    found = chaos_indices([chaos])
    told = np.array([[e.value for e in found[order]] for order in ("first", "total")]).T
    assert np.abs(told - truth).max() < 0.03


# --- beyond the rows --------------------------------------------------------------------------------------


def normals(count: int, seed: int, dimension: int = 2) -> Array:
    return np.asarray(ndtri(sobol_points(dimension=dimension, count=count, seed=seed, task="design", replicate=0)))


def response_of(function: Callable[[Array], Array], points: Array, germs: tuple[str, ...] = NORMAL) -> Response:
    return cross_fit(points, function(points), germs)[0]


def bump(z: Array) -> Array:
    """x + 1/(1 + c²) of a Cauchy c: 1/9 of its variance is that of c."""
    c = np.tan(np.pi * (ndtr(z[:, 0]) - 0.5))
    return np.asarray(z[:, 1] + 1.0 / (1.0 + c * c))


def _hold(found: list[Estimate], truth: float) -> list[bool]:
    return [e.low is not None and e.high is not None and e.low <= truth <= e.high for e in found]


def test_shares_of_an_output_that_levels_off_are_held() -> None:
    """Shares of c between 1/9 and what the response says: without drawing in, 31 % of the intervals of these held."""
    hits, used = [], 0
    for seed in (71, 72, 97, 101, 137):
        one = response_of(bump, normals(64, seed))
        if not one.usable:
            continue
        used += 1
        found, (closed, _) = index_shares(one, seed), group_shares(one, [[0], [1]], seed)
        hits += _hold([found["first"][0], found["total"][0], closed[0]], 1.0 / 9.0)
        hits += _hold([found["first"][1], closed[1]], 8.0 / 9.0)
        hits += _hold(pair_shares(one, [(0, 1)], seed), 0.0)
    assert used >= 2
    assert np.mean(hits) >= 0.7


def test_shares_of_a_variance_that_is_not_known_are_not_given() -> None:
    one = response_of(lambda z: z[:, 1] + z[:, 0] ** 2, normals(32, 21))
    large = np.concatenate([normals(1024, seed) for seed in range(16)])
    told = answered(one, large, (16, 1024), np.random.default_rng(1), ())
    assert told.spread is None
    gone = replace(told.description, sd=absent("it does not converge", "surrogate", 32))
    found = replace(told, description=gone).shares(index_shares(one))
    assert {e.reason for row in found.values() for e in row} == {"the variance that it is a share of is not known"}


def test_answers_of_given_tables_reach_inwards_too() -> None:
    """tanh(2 a) + b of normal inputs, 100 rows of its own: what holds for designed runs holds for these."""
    law = make_law("normal", {"mean": 0.0, "sd": 1.0})
    laws = Joint(names=("a", "b"), laws=(law, law))
    hits, used = [], 0
    for seed in (1, 3, 14, 21, 25, 32, 33, 34):
        scores = np.random.default_rng(seed).standard_normal((100, 2))
        one = response_from(scores, np.tanh(2.0 * scores[:, 0]) + scores[:, 1], NORMAL)
        if not one.usable:
            continue
        used += 1
        found = given_answers(one, laws, None, quantiles=(), seed=1, task="levels off")
        hits += _hold([found[order]["a"].whole for order in ("first", "total")], 0.388477)
        hits += _hold([found["statistics"]["sd"].whole], 1.0 / math.sqrt(1.0 - 0.388477))
    assert used >= 2
    assert np.mean(hits) >= 0.8


# --- runs that are ended early say so, keep what is there, and go on to the same answers; forces over time


def test_an_early_end_reports_what_is_there_and_goes_on(study_from: Callable[..., Study], tmp_path: Path) -> None:
    study = study_from("analysis.accuracy.quantile=0.02", "analysis.accuracy.sobol=0.01", quick=True)
    chunks = 0

    def count(stage: str, done: int, total: int) -> None:
        nonlocal chunks
        chunks += 1

    run = uqsphere.run(study, out=tmp_path / "r", progress=count, stop=lambda: chunks >= 2)
    assert run.manifest.interrupted is True
    assert chunks == 2
    assert "run was interrupted" in build_report(run.folder).read_text(encoding="utf-8")
    assert run.results.quantities["p_max"].mean.value is not None
    assert summary_of(read_contents(run.folder)).splitlines()[1].startswith("The run was interrupted")
    whole = uqsphere.run(study, out=tmp_path / "whole")
    resumed = uqsphere.run(study, out=tmp_path / "r")
    assert resumed.manifest.interrupted is False
    assert resumed.manifest.evaluations_reused > 0
    for name in ("results.json", "courses.json", "tables/courses.csv"):
        assert (resumed.folder / name).read_bytes() == (whole.folder / name).read_bytes()


def test_an_end_before_anything_is_there_is_an_interruption(study_from: Callable[..., Study], tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        uqsphere.run(study_from(quick=True), out=tmp_path / "r", stop=lambda: True)
    assert not (tmp_path / "r" / "results.json").exists()


def test_an_early_end_of_an_expensive_model_answers_by_the_runs_that_are_there(tmp_path: Path) -> None:
    """A stage that is cut short is not counted, whether of a surrogate or of runs that none can use."""
    path = tmp_path / "study.toml"
    path.write_text(
        """seed = 2
[inputs]
x1 = { dist = "uniform", lower = 0.0, upper = 1.0 }
x2 = { dist = "uniform", lower = 0.0, upper = 1.0 }
[outputs]
names = ["smooth", "rough"]
[analysis]
quantities = ["smooth", "rough"]
cost = "1 s"
budget = { evaluations = 600, time = "1 h" }
accuracy = { mean = 1e-9, quantile = 1e-9, sobol = 1e-9 }
""",
        encoding="utf-8",
    )
    study = uqsphere.load_study(path)
    rows = 0

    def box(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        nonlocal rows
        rows += len(x["x1"])
        wave = np.sin(97.0 * x["x1"]) * np.sin(83.0 * x["x2"])
        return {"smooth": np.exp(x["x1"] * x["x2"]), "rough": np.sign(wave)}

    run = uqsphere.run(study, out=tmp_path / "r", model=box, stop=lambda: rows >= 90)
    assert run.manifest.interrupted is True
    assert run.results.accuracy.stopped_by["sampling"] == "time"
    means = {name: entry["mean"] for name, entry in run.results.document()["quantities"].items()}
    assert (means["smooth"]["evaluations"], means["rough"]["evaluations"]) == (64, 64)
    assert means["smooth"]["method"].startswith("surrogate")
    resumed = uqsphere.run(study, out=tmp_path / "r", model=box)
    whole = uqsphere.run(study, out=tmp_path / "whole", model=box)
    assert resumed.manifest.interrupted is False
    assert (resumed.folder / "results.json").read_bytes() == (whole.folder / "results.json").read_bytes()


def test_a_run_with_margins_that_is_resumed_evaluates_nothing(tmp_path: Path) -> None:
    """The design point at a margin too, which is that of another study."""
    path = tmp_path / "study.toml"
    path.write_text(
        """[inputs]
a = { dist = "normal", mean = 1.0, sd = 0.3 }
b = { dist = "uniform", lower = -1.0, upper = 1.0 }
[outputs]
names = ["y"]
[limits.l]
quantity = "y"
strength = 2.5
[margins]
solve = "a"
between = [0.5, 3.0]
for_probability = [0.1]
[analysis]
methods = ["qmc"]
budget = { evaluations = 60_000 }
accuracy = { mean = 0.01, quantile = 0.05, sobol = 0.05, probability = 0.2 }
""",
        encoding="utf-8",
    )
    study, rows = uqsphere.load_study(path), 0

    def box(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        nonlocal rows
        rows += len(x["a"])
        return {"y": x["a"] + 0.3 * x["b"] ** 2}

    first = uqsphere.run(study, out=tmp_path / "r", model=box)
    assert "factors" in first.results.document()["margins"]["l"]
    done = rows
    again = uqsphere.run(study, out=tmp_path / "r", model=box)
    assert rows == done + 1  # a stored row, to see that it is the same
    assert again.results.document() == first.results.document()


def test_the_band_of_forces_holds_the_largest_forces(study_from: Callable[..., Study], tmp_path: Path) -> None:
    study = study_from('analysis.quantities=["P_max"]', "analysis.accuracy.quantile=0.05", quick=True)
    run = uqsphere.run(study, out=tmp_path / "r")
    courses = json.loads((run.folder / "courses.json").read_text(encoding="utf-8"))
    low, middle, high = (np.maximum(courses["force_a"][p], courses["force_b"][p]) for p in ("0.05", "0.5", "0.95"))
    assert np.all(low <= middle)
    assert np.all(middle <= high)
    assert courses["time"] == sorted(courses["time"])
    largest = run.samples()["P_max"]
    # peaks of single scenes lie at or above the quantiles taken instant by instant
    assert middle.max() <= 1.02 * largest.median()
    hardest = max(max(courses["hardest"]["force_a"]), max(courses["hardest"]["force_b"]))
    assert largest.quantile(0.9) < hardest <= 1.001 * largest.max()
    # the stress inside and the field in the bars are those of the same scene
    contact, view = courses["hardest"]["contact"], FieldView.from_document(courses["hardest"]["bars"])
    radius = courses["hardest"]["inputs"]["sphere.radius"]
    # theory (14), (15): P = (2/3) pi a² p_0
    force = 2.0 / 3.0 * np.pi * (contact["ratio"] * radius) ** 2 * contact["pressure"]
    assert hardest <= 1.0001 * force
    assert hardest == pytest.approx(force, rel=0.02)
    assert view.stress.shape == (190, 150)
    report = build_report(run.folder).read_text(encoding="utf-8")
    for heading in ("The row that is loaded hardest", "Inputs of the row that is loaded hardest"):
        assert heading in report
    for name in ("bars-hardest", "stress-hardest"):
        lines = (run.folder / "figures" / f"{name}.csv").read_text(encoding="utf-8").splitlines()
        assert len(lines) > 1000


def test_progress_tells_the_accuracy_and_the_most_that_is_left(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = 100.0
    monkeypatch.setattr("uqsphere.cli.run.time.monotonic", lambda: now)
    progress = Progress(evaluations=40_000, seconds=600.0, asked={"mean": 0.01, "sobol": 0.02}, began=now, started=now)
    kinds = ("half-width of the mean over the standard deviation", "largest half-width of an index")
    progress.reached([{"quantity": "p_max", "error": 0.02, "error_kind": kinds[0]}])
    progress.reached([{"quantity": "p_max", "error": 0.01, "error_kind": kinds[1]}])
    now += 10.0
    progress("sampling", 10_000, 20_000)
    line = capsys.readouterr().err
    assert "sampling: 10,000 of 20,000 evaluations" in line
    assert "at most 30 s in all" in line  # 10,000 in 10 s, 40,000 allowed
    assert "error over what was asked: p_max 2" in line


def test_no_band_of_scenes_that_take_too_many_steps_to_be_kept() -> None:
    """A sphere without weight between endless bars swings tens of thousands of times: 64 of them took gigabytes."""
    slow = ('model.fidelity="full"', 'striker.speed={ dist = "lognormal", mean = "312 um/s", cov = 10.5 }')
    study = uqsphere.load_study(Path(__file__).parent.parent / "studies" / "as_printed.toml", slow)
    work = Work(study=study, store=None, ledger=Ledger(), fidelity="full", threads=1)
    sample = draw(work.all_inputs, seed=3, task="band", start=0, count=16, replicates=1)
    assert find_courses(work, sample) is None
