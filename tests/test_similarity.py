"""Tables of the scaled numbers: the numbers that inputs act through, and answers that are those of the model."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

import uqsphere
from uqsphere.arrays import Array
from uqsphere.cli.verify import verify_folder
from uqsphere.runner.campaign import Course
from uqsphere.runner.evaluate import Ledger, OutOfBudget, Work, draw, evaluate_points
from uqsphere.runner.questions import indices as questions
from uqsphere.runner.questions.curves import curves_along
from uqsphere.runner.similarity import Tabled, find_numbers, integrated, make_similarity
from uqsphere.study import Study
from uqsphere.uq import Law
from uqsphere.uq.describe import controlled_probability, describe, describe_controlled
from uqsphere.uq.estimate import corrected
from uqsphere.uq.heavy_tails import FEW_CARRIERS, carriers
from uqsphere.uq.indices import Blocks, Surrogate, sampled_indices, uniform_halves
from uqsphere.uq.points import sobol_points
from uqsphere.uq.table import make_table

Build = Callable[..., Study]
STUDIES = Path(__file__).parent.parent / "studies"
ELASTIC = 'contact.law="hertz"'
TIMES = (ELASTIC, "analysis.quantities=['p_max', 'contact_time']")


def work_of(study: Study) -> Work:
    return Work(study=study, store=None, ledger=Ledger(), fidelity="full", threads=1)


def rows_of(work: Work, count: int = 2048, task: str = "test") -> Array:
    inputs = work.all_inputs.only(work.scene_names)
    return draw(inputs, seed=3, task=task, start=0, count=count, replicates=1).inputs[0]


@pytest.fixture(scope="module")
def granite() -> Work:
    return work_of(uqsphere.load_study(STUDIES / "granite.toml", TIMES))


# --- the numbers ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "settings", "count"),
    [
        ("granite", (ELASTIC,), 2),
        # the onset of yield over the modulus is a number of its own
        ("granite", (), 3),
        ("granite", (ELASTIC, 'pulse.rise={ dist = "uniform", lower = "20 us", upper = "30 us" }'), 3),
        ("granite", (ELASTIC, 'bars.E={ dist = "normal", mean = "186 GPa", cov = 0.02 }'), 3),
        (
            "granite",
            (
                ELASTIC,
                'bars.E={ dist = "normal", mean = "186 GPa", cov = 0.02 }',
                'pulse.rise={ dist = "uniform", lower = "20 us", upper = "30 us" }',
            ),
            4,
        ),
        ("gauge_records", (), 1),
        ("limestone_drop_weight", (ELASTIC,), 2),
        ("limestone_drop_weight", (), 3),
        ("quartz_load_cell", (), 2),
    ],
)
def test_inputs_act_through_few_numbers(name: str, settings: tuple[str, ...], count: int) -> None:
    work = work_of(uqsphere.load_study(STUDIES / f"{name}.toml", settings))
    found = find_numbers(work, rows_of(work))
    assert (found if isinstance(found, int) else len(found.names)) == count


def test_scenes_without_an_integrator_have_no_table(study_from: Build) -> None:
    massless = replace(work_of(study_from(quick=True)), fidelity="massless")
    assert not integrated(massless)
    assert integrated(work_of(study_from()))
    assert isinstance(make_similarity(massless), str)


def test_a_table_answers_as_the_model_where_it_answers(granite: Work) -> None:
    made = make_similarity(granite)
    assert not isinstance(made, str)
    rows = rows_of(granite, 4096)
    found, left = made.answers(granite, "test", rows)
    true = evaluate_points(granite, "true", granite.scene_names, rows).values
    off = (found - true) / true.std(axis=0)
    # late losses lie eleven standard deviations out: none is missed
    assert np.abs(off).max() < 0.75
    assert off.var(axis=0).max() < 1e-3
    assert 0 < len(left) < 0.03 * len(rows)
    assert made.table.nodes <= 8192


# --- the table by itself --------------------------------------------------------------------------


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_a_table_is_finer_where_a_function_jumps(axes: int) -> None:
    rng, calls = np.random.default_rng(axes), []

    def jump(x: Array) -> Array:
        return np.asarray(x[:, :1] + 4.0 * (x.sum(axis=1, keepdims=True) > 1.5))

    def both(x: Array) -> Array:
        calls.append(len(x))
        return np.concatenate([jump(x), jump(x) / 2.0], axis=1)

    table = make_table(rng.normal(size=(8192, axes)), both, 1, 4000)
    points = rng.normal(size=(8192, axes))
    values, known = table.at(points)
    assert sum(calls) == table.nodes <= 4000
    assert known.mean() > (0.5 if axes == 3 else 0.97)
    assert np.abs(values - jump(points))[known].max() < 1.0
    assert not table.at(points + 100.0)[1].any()


# --- many points of a cheap model, few of the real one --------------------------------------------

SLOPES, PHASES = np.array([0.21, 0.15, 0.12, 0.09]), np.array([40.0, 25.0, 0.0, 0.0])
ROUGH, RARE = 0.004, 2.0
LOG_SD = float(np.sqrt(SLOPES @ SLOPES))
SHARES = (0.01, 0.05, 0.5, 0.95, 0.99)


def below(value: float) -> float:
    """Distribution function of the expensive model: lognormal plus a sine of a phase that is uniform to e^-1000."""
    phases = (np.arange(256) + 0.5) * (2.0 * np.pi / 256)
    return float(ndtr(np.log(value - ROUGH * np.sin(phases)) / LOG_SD).mean())


MEAN = math.exp(0.5 * LOG_SD**2)
TRUTH = {
    "mean": MEAN,
    "sd": math.sqrt(MEAN**2 * math.expm1(LOG_SD**2) + 0.5 * ROUGH**2),
    **{f"{p:g}": brentq(lambda q, p=p: below(q) - p, 0.3, 3.0) for p in SHARES},
    "rare": 1.0 - below(RARE),
}


def sample(seed: int, n: int = 256, m: int = 2048) -> tuple[Array, Array, Array]:
    """An expensive model of n points in 16 replicates, and a cheap one of n and of m that lacks its swings."""
    normals = ndtri([sobol_points(dimension=4, count=m, seed=seed, task="control", replicate=r) for r in range(16)])
    cheap = np.exp(normals @ SLOPES)
    return (cheap + ROUGH * np.sin(normals @ PHASES))[:, :n], cheap[:, :n], cheap


def test_intervals_cover_the_truth() -> None:
    inside: dict[str, list[bool]] = {name: [] for name in TRUTH}
    for seed in range(60):
        rows = sample(seed)
        described = describe_controlled(*rows, quantiles=SHARES, method="controlled")
        alone = describe(rows[0], quantiles=())
        assert described.mean.std_error < alone.mean.std_error
        assert described.sd.std_error < alone.sd.std_error
        shares = [(part > RARE).mean(axis=1) for part in rows]
        rare = controlled_probability(*shares, sizes=(256, 2048), counted=True, method="controlled")
        assert rare is not None
        found = {"mean": described.mean, "sd": described.sd, "rare": rare}
        found |= {f"{p:g}": estimate for p, estimate in described.quantiles.items()}
        for name, estimate in found.items():
            inside[name].append(estimate.low <= TRUTH[name] <= estimate.high)
    # 95 % of 60 less four standard deviations of the count
    assert {
        name: sum(held) for name, held in inside.items() if sum(held) < 57 - 4.0 * math.sqrt(60 * 0.95 * 0.05)
    } == {}


def test_models_that_agree_on_every_row_may_still_disagree_on_one() -> None:
    # shares that the points hit exactly leave nothing to see: the error is that of one row and of the cells
    same = np.full(16, 0.25) + 1e-9 * np.arange(16)
    found = controlled_probability(same, same, np.full(16, 0.25), sizes=(256, 25600), counted=True, method="x")
    assert found.std_error >= 1.0 / (16 * 256)
    nothing = np.zeros(16)
    assert controlled_probability(nothing, nothing, nothing, sizes=(256, 512), counted=True, method="x") is None
    assert describe_controlled(*sample(4), quantiles=(1e-4,), method="x").quantiles[1e-4].value is None


def test_the_error_of_a_corrected_answer_is_that_of_the_difference() -> None:
    """Unrelated models add their errors, a perfect one leaves that of the many points."""
    rng = np.random.default_rng(3)
    rows, gaps = rng.normal(size=(2, 4000, 16))
    found = [corrected(*pair) for pair in zip(rows, gaps, strict=True)]
    true_error = np.std([value for value, _ in found])
    assert true_error == pytest.approx(math.sqrt(2.0) / 4.0, rel=0.05)
    assert np.sqrt(np.mean([error**2 for _, error in found])) == pytest.approx(true_error, rel=0.08)
    with pytest.raises(ValueError, match="four replicates"):
        corrected(np.ones(3), np.ones(3))


def test_indices_off_many_points_cover_and_are_narrower() -> None:
    """y = x1 + x2 where both are normal, with a jump that few points meet; the cheap model lacks a little of it."""
    blocks, held, ratio = Blocks(inputs_count=2), [], []

    def both(x: Array) -> tuple[Array, Array]:
        smooth = x[..., 0] + 8.0 * (x[..., 1] > 2.6)
        return smooth + 0.02 * np.sin(20.0 * x[..., 0]), smooth

    p = 1.0 - float(ndtr(2.6))
    jumps = 64.0 * p * (1.0 - p)
    truth = jumps / (1.0 + jumps + 2e-4)
    for seed in range(15):
        mixed = np.stack([
            blocks.mix(*ndtri(uniform_halves(blocks, count=2048, seed=seed, task="many", replicate=r)))
            for r in range(16)
        ])  # fmt: skip
        model, cheap = both(mixed)
        found = sampled_indices(model[:, :64], blocks, Surrogate(outputs=cheap[:, :64], many=cheap)).total[1]
        plain = sampled_indices(model[:, :64], blocks).total[1]
        assert found.value is not None
        held.append(found.low <= truth <= found.high)
        ratio.append(found.half_width / plain.half_width)
    assert sum(held) >= 12
    assert np.median(ratio) < 0.5


# --- in a run ---------------------------------------------------------------------------------------


def test_a_rough_quantity_is_answered_by_a_table(granite: Work) -> None:
    work = replace(granite, study=uqsphere.load_study(STUDIES / "granite.toml", (*TIMES, "seed=1001")))
    none = dict.fromkeys(work.quantities, questions.Expansion())
    question = questions.Indices(work=work, expansions=none, blocks=questions.blocks_of(work))
    assert question.advance(1e6)
    assert question.tabled.similarity is not None
    assert question.tabled.count == 2048
    total = question.found["contact_time"]["total"][2]
    # docs/validation.md: 0.0999 with 0.0006
    assert total.low < 0.0999 < total.high
    assert "table" in question.tabled.told("the indices")
    assert question.tabled.forecast > 5 * question.size
    # few of the model's own points carry the variance, many of the table's: those of its indices are not widened
    assert question.pairs is not None
    assert carriers(question.pairs.values[:, :, 0, 1].ravel()) < FEW_CARRIERS
    assert question.answer(Course()).carried["contact_time"] > FEW_CARRIERS
    assert question.advance(1e6)
    assert question.tabled.count == 4096


def test_a_table_needs_room_and_time(granite: Work, monkeypatch: pytest.MonkeyPatch) -> None:
    none = dict.fromkeys(granite.quantities, questions.Expansion())
    question = questions.Indices(work=granite, expansions=none, blocks=questions.blocks_of(granite))
    assert question.advance(20_000)
    assert question.tabled.similarity is None

    def out_of_time(_: Work) -> str:
        raise OutOfBudget

    monkeypatch.setattr("uqsphere.runner.similarity.make_similarity", out_of_time)
    question = questions.Indices(work=granite, expansions=none, blocks=questions.blocks_of(granite))
    assert question.advance(1e6)
    assert question.tabled == Tabled(text="the table of scaled numbers was cut short by the time budget")


def test_a_run_with_a_table_repeats_whatever_its_threads(tmp_path: Path) -> None:
    settings = (
        *TIMES,
        "analysis.accuracy.quantile=0.025",
        "analysis.budget.evaluations=60000",
        "analysis.methods=['qmc']",
        "limits.crushing.fracture=false",
        "margins=null",
    )
    study = uqsphere.load_study(STUDIES / "granite.toml", settings)
    runs = [uqsphere.run(study, out=tmp_path / "run", threads=1), uqsphere.run(study, out=tmp_path / "two", threads=2)]
    assert runs[0].results.model.control.used
    assert runs[0].results.model.saved.full_evaluations > 0
    assert verify_folder(tmp_path / "run").verdict == "whole"
    known = (runs[0].folder / "results.json").read_bytes()
    assert (runs[1].folder / "results.json").read_bytes() == known
    again = uqsphere.run(study, out=tmp_path / "run", threads=1)
    assert (again.folder / "results.json").read_bytes() == known
    assert again.manifest.evaluations_reused > 0
    assert not again.manifest.damaged_chunks


def test_a_curve_of_a_rough_quantity_is_answered_by_a_table(tmp_path: Path) -> None:
    """Over the striker's speed, fixed in the study, the contact time falls by stairs that no fit follows."""
    text = (STUDIES / "granite.toml").read_text(encoding="utf-8")
    text = text[: text.index("[limits.crushing]")] + text[text.index("[analysis]") :]
    limit = '[limits.long]\nquantity = "contact_time"\naim = "survive"\nstrength = '
    (tmp_path / "long.toml").write_text(
        text + limit + '{ dist = "lognormal", mean = "2000 us", cov = 0.15 }\n', encoding="utf-8"
    )
    settings = (ELASTIC, "striker.speed='0.5 m/s'", "analysis.quantities=['contact_time']")
    study = uqsphere.load_study(tmp_path / "long.toml", settings)
    work = work_of(study)
    found = curves_along(work, study.limits, most=200_000)["long"]
    assert not isinstance(found, str)
    told = found.band.tabled
    assert told.begun
    # by rows and a fit 37,408 evaluations left 0.105
    assert found.band.half_width < 0.03
    assert found.evaluations < 25_000
    assert told.forecast > 2 * found.band.evaluations
    assert "the mass number mu" in told.told("the curves")
    # a long run of the model at the value said to have even odds
    value = found.values[0.5]
    assert value.value is not None
    rows = rows_of(work, 16_384)
    there = evaluate_points(work, "true", (*work.scene_names, "striker.speed"),
                            np.column_stack([rows, np.full(len(rows), value.value)])).values[:, 0]  # fmt: skip
    assert isinstance(study.limits[0].strength, Law)
    assert float(study.limits[0].strength.cdf(there).mean()) == pytest.approx(0.5, abs=0.004)
