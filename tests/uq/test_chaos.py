"""Expansions: exact on polynomials and products, chaospy's numbers, errors that are told, intervals
that scale.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ndtri

from tests.campaigns.chaos import MODELS, checked, design, relative_error
from tests.campaigns.intervals import coverage_models, far_event_model
from tests.campaigns.zoo import MODELS as ZOO
from tests.campaigns.zoo import all_truths
from uqsphere import analysis
from uqsphere.uq.chaos.basis import (
    germ_points,
    germs_of,
    grown,
    hyperbolic_indices,
    nested,
    rows_of,
)
from uqsphere.uq.chaos.expansion import Chaos
from uqsphere.uq.chaos.fit import fit_chaos
from uqsphere.uq.corrected import Corrected, indices_of
from uqsphere.uq.estimate import distances
from uqsphere.uq.interop import load_chaospy
from uqsphere.uq.law import Law, make_law
from uqsphere.uq.points import sobol_points
from uqsphere.uq.response import Response, cross_fit, unseen

LAWS = {
    "normal": make_law("normal", {"mean": 1.0, "sd": 2.0}),
    "uniform": make_law("uniform", {}, 0.0, 3.0),
    "lognormal": make_law("lognormal", {"mean": 2.0, "cov": 0.2}),
    "beta": make_law("beta", {"alpha": 2.0, "beta": 3.0}, 0.0, 1.0),
    "gumbel": make_law("gumbel", {"mean": 5.0, "sd": 1.0}),
    "truncated": make_law("normal", {"mean": 0.0, "sd": 1.0}, -1.0, 2.0),
    "triangular": make_law("triangular", {"mode": 0.3}, 0.0, 1.0),
}


def drawn(laws: list[Law], n: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Germ points and physical rows (n, d)."""
    z = ndtri(sobol_points(dimension=len(laws), count=n, seed=seed, task="test chaos", replicate=0))
    return germ_points(z, germs_of(laws)), np.column_stack(
        [law.from_normal(z[:, k]) for k, law in enumerate(laws)]
    )


@pytest.mark.parametrize("name", LAWS)
def test_polynomials_of_a_germ_are_orthonormal(name: str) -> None:
    germs = germs_of([LAWS[name]])
    z = np.linspace(-8.0, 8.0, 4001)
    weights = np.exp(-0.5 * z * z)
    rows = rows_of(germs, germ_points(z[:, None], germs), np.arange(5)[:, None])
    assert np.allclose(rows * (weights / weights.sum()) @ rows.T, np.eye(5), atol=2e-5)


def test_sets_are_nested_and_growth_keeps_them_whole() -> None:
    terms, sizes = nested(3, 0.75, 5, 400) or (None, None)
    assert len(terms) == sizes[-1]
    for k, size in enumerate(sizes, start=1):
        assert set(map(tuple, terms[:size])) == set(map(tuple, hyperbolic_indices(3, k, 0.75, 400)))
    assert hyperbolic_indices(10, 6, 1.0, 100) is None
    more = grown(np.array([[0, 0], [2, 1]]), np.array([1.0, 1.0]), 15, 50)
    held = set(map(tuple, more))
    assert {(1, 0), (0, 1), (1, 1), (2, 0)} <= held
    assert all(
        tuple(np.subtract(row, np.eye(2, dtype=int)[j])) in held
        for row in held
        for j in range(2)
        if row[j]
    )


@pytest.mark.parametrize("name", LAWS)
def test_a_polynomial_of_a_law_is_exact_from_few_rows(name: str) -> None:
    points, x = drawn([LAWS[name]] * 2, 60)
    germs = germs_of([LAWS[name]] * 2)
    s = np.log(x) if name == "lognormal" else x
    y = 1.0 + s[:, 0] - 2.0 * s[:, 1] ** 2 + 0.5 * s[:, 0] * s[:, 1]
    fit = fit_chaos(points, y, germs)
    assert fit.cross_validation_error < 1e-12
    assert not fit.log
    mean, sd = fit.integrals.mean, fit.integrals.sd
    many, rows = drawn([LAWS[name]] * 2, 1 << 14, seed=7)
    t = np.log(rows) if name == "lognormal" else rows
    truth = 1.0 + t[:, 0] - 2.0 * t[:, 1] ** 2 + 0.5 * t[:, 0] * t[:, 1]
    assert np.allclose(fit.predict(many), truth, atol=1e-6 * sd)
    assert mean == pytest.approx(truth.mean(), abs=5e-3 * sd)
    assert sd == pytest.approx(truth.std(), rel=0.01)


def test_a_product_of_lognormals_is_exact_with_its_moments_and_indices() -> None:
    """Sulfur-like: nine factors, 256 rows; (exp(s²) - 1)/(exp(S) - 1) and its total."""
    s = 2.0 * np.array([0.14, 0.14, 0.04, 0.2, 0.2, 0.26, 0.14, 0.2, 0.06])
    laws = [make_law("lognormal", {"log_mean": 0.0, "log_sd": float(one)}) for one in s]
    points, x = drawn(laws, 256)
    fit = fit_chaos(points, x.prod(axis=1), germs_of(laws))
    found, whole = fit.integrals, float((s**2).sum())
    assert fit.log
    assert fit.cross_validation_error < 1e-20
    assert found.shares[0] == pytest.approx(np.expm1(s**2) / math.expm1(whole), abs=1e-9)
    assert found.shares[1] == pytest.approx(
        np.expm1(s**2) * np.exp(whole - s**2) / math.expm1(whole), abs=1e-9
    )
    assert found.mean == pytest.approx(math.exp(0.5 * whole), rel=1e-9)
    assert found.sd == pytest.approx(math.exp(0.5 * whole) * math.sqrt(math.expm1(whole)), rel=1e-9)
    for row in indices_of(cross_fit(points, x.prod(axis=1), germs_of(laws))[0]).values():
        assert max(e.half_width for e in row) < 1e-3


def test_a_logarithm_with_interactions_is_integrated_to_what_is_asked() -> None:
    # ln y = 0.5 z1 - 0.2 z2 + 0.1 z1 z2
    terms = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
    fit = Chaos(
        coefficients=np.array([0.0, 0.5, -0.2, 0.1]),
        multi_indices=terms,
        germs=("normal", "normal"),
        log=True,
        bounds=(-20.0, 20.0),
        cross_validation_error=0.0,
        samples=9,
    )
    found = fit.integrals
    z, w = np.polynomial.hermite_e.hermegauss(60)
    w = w / w.sum()
    y = np.exp(0.5 * z[:, None] - 0.2 * z[None, :] + 0.1 * np.outer(z, z))
    mean = w @ y @ w
    variance = w @ y**2 @ w - mean**2
    first = [(w @ (y @ w) ** 2 - mean**2) / variance, (w @ (w @ y) ** 2 - mean**2) / variance]
    assert found.error <= 2e-3
    assert found.shares[0] == pytest.approx(first, abs=3e-3)
    assert found.shares[1] == pytest.approx([1.0 - first[1], 1.0 - first[0]], abs=3e-3)
    assert (found.mean, found.sd) == pytest.approx((mean, math.sqrt(variance)), rel=2e-4)


@pytest.mark.parametrize("name", ["borehole", "Ishigami", "flood", "cantilever", "wing weight"])
def test_benchmarks_keep_their_errors_and_report_them(name: str) -> None:
    most = {
        "borehole": 1e-6,
        "Ishigami": 1e-9,
        "flood": 3e-4,
        "cantilever": 1e-6,
        "wing weight": 1e-5,
    }[name]
    model = MODELS[name]
    points, (unseen_points, truth) = design(model, 128, 1), checked(model)
    fit = fit_chaos(points, model(points), model.germs)
    error = relative_error(fit.predict(unseen_points), truth)
    assert error < most
    assert error < 30.0 * max(fit.cross_validation_error, 1e-24)


def test_what_no_polynomial_fits_says_so() -> None:
    rng = np.random.default_rng(1)
    fit = fit_chaos(rng.standard_normal((64, 3)), rng.standard_normal(64), ("normal",) * 3)
    assert fit.cross_validation_error > 0.5
    constant = fit_chaos(rng.standard_normal((16, 2)), np.full(16, 7.0), ("normal", "normal"))
    assert constant.constant
    assert constant.integrals.mean == 7.0
    with pytest.raises(ValueError, match="not finite"):
        fit_chaos(np.zeros((8, 1)), np.array([1.0] * 7 + [np.nan]), ("normal",))
    with pytest.raises(ValueError, match="need points"):
        fit_chaos(np.zeros((3, 1)), np.zeros(3), ("normal",))


@pytest.mark.parametrize("size", [1e-280, 1e280])
def test_units_cancel(size: float) -> None:
    points, x = drawn([LAWS["normal"], LAWS["uniform"]], 64)
    y = x[:, 0] + x[:, 1] ** 2 * x[:, 0]
    one, other = (
        fit_chaos(points, k * y, germs_of([LAWS["normal"], LAWS["uniform"]])) for k in (1.0, size)
    )
    assert other.coefficients / size == pytest.approx(one.coefficients, rel=1e-9, abs=1e-12)
    assert other.integrals.shares[1] == pytest.approx(one.integrals.shares[1], rel=1e-9)


# --- chaospy --------------------------------------------------------------------------------------


#: numpoly 1.2 on numpy 2.1 and later
OLD = pytest.mark.filterwarnings("ignore:`newshape`:DeprecationWarning")


@OLD
@pytest.mark.parametrize("log", [False, True])
def test_chaospy_has_the_same_values_moments_and_indices(log: bool) -> None:
    chaospy = load_chaospy()
    laws = [LAWS["normal"], LAWS["uniform"], LAWS["normal"]]
    points, x = drawn(laws, 80)
    y = 3.0 + x[:, 0] + x[:, 1] ** 2 * x[:, 2] + 0.1 * x[:, 2] ** 3
    fit = fit_chaos(points, np.exp(0.02 * y) if log else y, germs_of(laws), plain=not log)
    made = fit.chaospy()
    assert made.of_logarithm == fit.log == log
    values = made.polynomial(*points.T)
    truth = np.log(fit.predict(points)) if log else fit.predict(points)
    assert values == pytest.approx(truth, rel=1e-10)
    assert sum(c * p for c, p in zip(made.coefficients, made.expansion, strict=True))(
        *points.T
    ) == pytest.approx(values)
    plain = Chaos(
        coefficients=fit.coefficients,
        multi_indices=fit.multi_indices,
        germs=fit.germs,
        cross_validation_error=0.0,
        samples=80,
    )
    own = plain.integrals
    assert float(chaospy.E(made.polynomial, made.germs)) == pytest.approx(own.mean, rel=1e-12)
    assert float(chaospy.Std(made.polynomial, made.germs)) == pytest.approx(own.sd, rel=1e-12)
    assert chaospy.FirstOrderSobol(made.expansion, made.coefficients) == pytest.approx(
        own.shares[0], abs=2e-15
    )
    assert chaospy.TotalOrderSobol(made.expansion, made.coefficients) == pytest.approx(
        own.shares[1], abs=2e-15
    )


@OLD
def test_forty_inputs_go_over_to_chaospy() -> None:
    terms = np.concatenate(
        [np.zeros((1, 40), dtype=int), np.eye(40, dtype=int), 2 * np.eye(40, dtype=int)]
    )
    fit = Chaos(
        coefficients=np.arange(81.0),
        multi_indices=terms,
        germs=("normal",) * 40,
        cross_validation_error=0.0,
        samples=200,
    )
    made = fit.chaospy()
    x = np.random.default_rng(1).standard_normal((5, 40))
    assert made.polynomial(*x.T) == pytest.approx(fit.predict(x), rel=1e-12)
    assert fit.to_frame().shape == (81, 41)


# --- corrected by rows ----------------------------------------------------------------------------


def test_half_widths_know_a_lone_row_from_many() -> None:
    even = np.tile([1.0, -1.0], 50)
    lone = np.zeros(100)
    lone[0] = 10.0
    assert distances(even) == pytest.approx([1.98 / math.sqrt(100.0)] * 2, rel=0.02)
    down, up = distances(lone)
    assert up > down > 2.0 * distances(even)[0] * lone.std() / even.std()


def corrected(response: Response, seed: int) -> Corrected:
    """The answers of a response with a table of 16 times 512 points."""
    d = len(response.germs)
    many = [
        sobol_points(dimension=d, count=512, seed=seed, task="many", replicate=r) for r in range(16)
    ]
    points = germ_points(ndtri(np.concatenate(many)), response.germs).reshape(16, 512, -1)
    return Corrected(response=response, table=response.table(points), lost=np.empty((8, 0)))


@pytest.mark.slow
@pytest.mark.parametrize("model", coverage_models(), ids=lambda model: model.name)
def test_few_rows_answer_with_intervals_that_hold(model) -> None:
    hits, n = [], 128
    for seed in range(2):
        u = sobol_points(dimension=model.dimension, count=n, seed=seed, task="few", replicate=0)
        response = cross_fit(germ_points(ndtri(u), model.germs), model.function(u), model.germs)[0]
        if not response.usable:
            continue
        found = corrected(response, seed).describe(tuple(model.quantiles))
        assert unseen(n) in found.mean.method
        pairs = [
            (found.mean, model.mean),
            (found.sd, model.sd),
            *((found.quantiles[p], q) for p, q in model.quantiles.items()),
        ]
        shares = indices_of(response)
        pairs += [
            (e, t)
            for order in ("first", "total")
            for e, t in zip(shares[order], getattr(model, order), strict=True)
        ]
        hits += [
            e.value is None or e.low - 1e-9 * model.sd <= t <= e.high + 1e-9 * model.sd
            for e, t in pairs
        ]
    assert not hits or np.mean(hits) >= 0.9


def test_a_far_event_that_no_row_shows_is_said_and_not_held() -> None:
    model = far_event_model()
    rng, says = np.random.default_rng(0), 0
    while not says:
        u = rng.random((128, 2))
        if u[:, 0].max() < 0.9976:
            response = cross_fit(
                germ_points(ndtri(u), model.germs), model.function(u), model.germs
            )[0]
            found = indices_of(response)["first"][0]
            says += 1
    assert response.usable
    assert "rarer than about 0.023 (3 in 128 runs) is not in it" in found.method
    assert found.high < model.first[0] or found.low > model.first[0]
    # a probability has ends that allow for it
    answers = corrected(response, 0)
    beyond = answers.probability(
        rows=(response.outputs > 30.0) * 1.0,
        left_out=(response.levels > 30.0) * 1.0,
        lost=np.empty(0),
        table=lambda residual: (answers.table + residual > 30.0) * 1.0,
    )
    assert beyond.value is None
    low, high = beyond.outer
    assert low == 0.0
    assert high > 0.0023
    assert (beyond.low, beyond.high) == (low, high)


def zoo_response(name: str, runs: int, seed: int) -> Response:
    """The response of a model of the zoo to the design of a slow run."""
    study = ZOO[name].study(seed)
    joint = study.inputs()
    points = sobol_points(
        dimension=len(joint.names), count=runs, seed=seed, task="slow", replicate=0
    )
    germs = germs_of(joint.laws)
    return cross_fit(germ_points(ndtri(points), germs), ZOO[name].rows(points), germs)[0]


@pytest.mark.parametrize("seed", [1, 3, 5, 7])
def test_an_expansion_that_runs_away_does_not_take_the_variance(seed: int) -> None:
    # one fold had 90 times the standard deviation of the rows, and 0.189 was stated as 0.0002
    response = zoo_response("kink", 256, seed)
    found = indices_of(response)["first"][1]
    assert found.low - 0.01 <= 0.18904 <= found.high + 0.01
    assert found.value == pytest.approx(0.18904, abs=0.05)
    assert found.high - found.low < 0.4
    sds = [response.integrals[k].sd for k in response.trusted]
    assert max(sds) < 1.5 * response.outputs.std()


def test_an_index_is_not_the_noise_of_its_correction() -> None:
    # largest errors of total indices had the median 0.11: half of what was left went to each of
    # them, and the correction was taken whole
    truths, errors = all_truths()["Morokoff"], []
    for seed in (100, 101, 102):
        totals = indices_of(zoo_response("Morokoff", 64, seed))["total"]
        places = zip(ZOO["Morokoff"].inputs, totals, strict=True)
        errors.append(
            max(abs(index.value - truths[f"total {name}"].value) for name, index in places)
        )
    assert np.median(errors) < 0.07


@pytest.mark.slow
def test_a_plateau_keeps_its_quantiles() -> None:
    # the median was read off residuals that were spread over the whole table
    held = []
    for seed in range(1, 6):
        answers = corrected(zoo_response("epidemic", 256, seed), seed)
        median = answers.quantile(0.5)
        held.append(median.low <= 0.016787 <= median.high)
    assert sum(held) >= 4


@pytest.mark.slow
def test_a_probability_is_not_exact_where_no_row_changes_sides() -> None:
    # 0.10136 (0.10069 to 0.10204) from 64 runs for 0.1
    widths, held = [], []
    threshold = all_truths()["spill"]["strength 0.1"].value
    for seed in range(1, 5):
        response = zoo_response("spill", 64, seed)
        answers = corrected(response, seed)
        found = answers.probability(
            rows=(response.outputs > threshold) * 1.0,
            left_out=(response.levels > threshold) * 1.0,
            lost=np.empty(0),
            table=lambda residual, a=answers: (a.table + residual > threshold) * 1.0,
        )
        widths.append(found.half_width)
        held.append(found.low <= 0.1 <= found.high)
    assert min(widths) > 0.005
    assert all(held)


def test_a_variance_without_an_end_has_no_interval_of_zero_width() -> None:
    answers = corrected(zoo_response("heavy", 256, 1), 1)
    sd = answers.sd()
    assert sd.high is None
    assert "heavy tail" in sd.reason
    assert sd.low < 69.6


def test_rows_of_a_fold_that_is_held_stay() -> None:
    # a fold without the largest input differs from all others: it was left out with its rows, and
    # 1.127 (1.115 to 1.138) was stated for 1.158
    response = zoo_response("ramp", 64, 6)
    assert len(response.trusted) < 8
    sd = corrected(response, 6).sd()
    assert sd.low <= all_truths()["ramp"]["sd"].value <= sd.high
    assert sd.half_width < 1.5


def largest_error(name: str, order: str, seed: int) -> float:
    """Of the indices of an order of 64 rows of a model of the zoo."""
    found = indices_of(zoo_response(name, 64, seed))[order]
    truths = [all_truths()[name][f"{order} {label}"].value for label in ZOO[name].inputs]
    return max(abs(row.value - truth) for row, truth in zip(found, truths, strict=True))


def test_an_index_of_folds_that_its_interval_holds_is_theirs() -> None:
    # a correction that was called significant, within the interval, was off by 0.26
    assert largest_error("Ishigami, mixed laws", "total", 3) < 0.07


@pytest.mark.parametrize("seed", [5, 6])
def test_first_indices_by_blocks_where_expansions_leave_more_than_they_explain(seed: int) -> None:
    # the expansions had them 0.19 and 0.25 off
    assert largest_error("discontinuous", "first", seed) < 0.1


@pytest.mark.parametrize("count", [16, 128])
@pytest.mark.parametrize("power", [3, 4])
def test_expansions_without_a_finite_variance_are_held(count: int, power: int) -> None:
    # their variances were infinite, and the median of infinite ones no number
    z = ndtri(sobol_points(dimension=2, count=count, seed=0, task="runs away"))
    outputs = np.exp(z[:, 0] ** power)
    (response,) = cross_fit(z, outputs, ("normal", "normal"))
    assert np.isfinite(response.levels).all()
    assert response.error == 1.0
    for shares in indices_of(response).values():
        assert all(0.0 <= share.low <= share.high <= 1.0 for share in shares)


@pytest.mark.parametrize("lowest", [0.0, 2.0])
def test_outputs_whose_squares_are_zero_have_what_others_have(lowest: float) -> None:
    # what may be wrong beyond their rows was no number
    z = ndtri(sobol_points(dimension=2, count=64, seed=0, task="tiny"))
    outputs = 1e-170 * (np.exp(z[:, 0]) - lowest)
    tiny, others = (cross_fit(z, y, ("normal", "normal"))[0] for y in (outputs, 1e170 * outputs))
    np.testing.assert_allclose(tiny.beyond, others.beyond, rtol=0.1, atol=1e-6)


def test_the_mean_of_an_exact_expansion_is_that_of_its_terms() -> None:
    # by the points of the table 4.0892 to 4.0898 was stated for 4.0900
    mean = corrected(zoo_response("gears", 64, 2), 2).mean()
    assert mean.value == pytest.approx(all_truths()["gears"]["mean"].value, abs=2e-5)
    assert mean.half_width < 2e-5


def test_a_fold_that_is_hard_to_integrate_is_one_of_eight() -> None:
    # the largest error of all folds was added to every interval: ±0.021 here
    found = indices_of(zoo_response("piston", 160, 1))["first"][0]
    truth = all_truths()["piston"]["first x1"].value
    assert found.low < truth < found.high
    assert found.half_width < 0.012


def test_forty_inputs_of_which_three_matter() -> None:
    response = zoo_response("3 of 40", 256, 1)
    assert response.error < 1e-20
    assert response.trusted == tuple(range(8))
    first = [estimate.value for estimate in indices_of(response)["first"]]
    assert first == pytest.approx([0.4, 0.0, 0.2, *[0.0] * 37], abs=1e-9)


@pytest.mark.parametrize("name", ["levels", "gears"])
def test_the_degree_in_an_input_is_below_the_number_of_its_values(name: str) -> None:
    response = zoo_response(name, 128, 1)
    found = indices_of(response)["first"]
    for k, label in enumerate(ZOO[name].inputs):
        truth = all_truths()[name][f"first {label}"].value
        assert found[k].low - 1e-3 <= truth <= found[k].high + 1e-3
        assert found[k].value == pytest.approx(truth, abs=0.02)


def test_observations_with_few_values_do_not_alias() -> None:
    # on the rows the eighth power of a switch is a straight line of it: 0.00 and 1.00 were stated
    rng = np.random.default_rng(1)
    level = rng.integers(1, 6, 160).astype(float)
    switch = rng.integers(0, 2, 160).astype(float)
    rows = np.column_stack([level, switch])
    with pytest.warns(UserWarning, match="150 of 160 rows repeat another"):
        found = analysis.sobol_indices(
            rows, level + 3.0 * switch, {"level": level, "switch": switch}
        )
    assert found["first"]["level"].value == pytest.approx(8.0 / 17.0, abs=0.06)
    assert found["first"]["switch"].value == pytest.approx(9.0 / 17.0, abs=0.06)


def test_where_all_folds_run_away_the_output_is_expanded_in_scores() -> None:
    # no fold was trusted, and total indices had no value
    response = zoo_response("kink", 64, 1)
    assert len(response.trusted) > 4
    totals, truths = indices_of(response)["total"], all_truths()["kink"]
    for name, estimate in zip(("a", "b", "c"), totals, strict=True):
        assert estimate.value == pytest.approx(truths[f"total {name}"].value, abs=0.15)
