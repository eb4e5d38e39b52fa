"""Fracture on the loading path: crossing times in closed form, the state there, and whole runs with several limits."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import CLOSED, log_peak, middle, spread
from scenes import ENDLESS, example
from scipy.special import ndtr, owens_t

import uqsphere
from uqsphere.mechanics import contact
from uqsphere.mechanics.closed_form import loading_time
from uqsphere.mechanics.criteria import CRITERIA, demand
from uqsphere.mechanics.fracture import first_fractures
from uqsphere.mechanics.history import trace
from uqsphere.mechanics.integrator.solve import solve
from uqsphere.mechanics.outputs import PATHS, path_of
from uqsphere.mechanics.outputs import Path as LoadingPath
from uqsphere.mechanics.scene import Scene
from uqsphere.mechanics.validity import check_at_fracture
from uqsphere.report import build_report
from uqsphere.report.brief import summary_of
from uqsphere.report.contents import read_contents
from uqsphere.results.tables import tables

FORCE, ENERGY = LoadingPath(over="force"), LoadingPath(over="energy")


def scene(rows: int = 1, shape: str = "rectangular", **settings: Any) -> Scene:
    return example(shape, rows, **settings)


# --- crossing times ---------------------------------------------------------------------------------------


def test_massless_step_in_closed_form() -> None:
    """Under a step a sphere without mass reaches the approach x alpha_c at t_c s(x), theory section 4."""
    x = np.array([0.05, 0.1, 0.5, 0.9, 0.99])
    one = scene(len(x), "step", infinite=True, horizon=0.02)
    largest = solve(one, fidelity="massless", tolerance=1e-10, quantities=("P_max", "energy"))
    scales = one.scales
    force = scales.force * x**1.5
    energy = 2.0 * 0.4 * scales.force * scales.approach * x**2.5
    shares = np.stack([force / largest.values["P_max"], energy / largest.values["energy"]], axis=1)
    exact = scales.time * loading_time(x)
    for column, path in enumerate((FORCE, ENERGY)):
        found = first_fractures(one, shares[:, [column]], [path], fidelity="massless", tolerance=1e-10)
        np.testing.assert_allclose(found.times[:, 0], exact, rtol=1e-7)
        np.testing.assert_allclose(found.force, force, rtol=1e-7)
        np.testing.assert_allclose(found.energy, energy, rtol=1e-7)
        assert np.abs(found.imbalance).max() < 1e-12
    both = first_fractures(one, shares, [FORCE, ENERGY], fidelity="massless", tolerance=1e-10)
    np.testing.assert_allclose(both.times[:, 0], both.times[:, 1], rtol=1e-6)


def test_refining_the_integration_converges() -> None:
    rng = np.random.default_rng(3)
    many, shares = scene(6), rng.uniform(0.1, 1.0, (6, 1))
    exact = first_fractures(many, shares, [FORCE], tolerance=1e-12)
    errors = []
    for tolerance in (1e-3, 1e-6, 1e-9):
        found = first_fractures(many, shares, [FORCE], tolerance=tolerance)
        errors.append(float(np.abs(found.time / exact.time - 1.0).max()))
    assert errors[1] < 2e-4
    assert errors[2] < 1e-5  # what is left is the peak, looked for at sixteen places of a step
    assert errors[2] < errors[0]


def test_against_the_history_of_the_scene() -> None:
    """The same moments read off a history on a fine grid, which shares neither the search nor the levels."""
    one = scene()
    history = trace(one, points=40_001)
    kept = history.time <= history.record_end
    time, a, b = history.time[kept], history.force_a[kept], history.force_b[kept]
    largest = np.maximum.accumulate(np.maximum(a, b))
    for share in (0.2, 0.6, 0.9, 0.999):
        k = int(np.argmax(largest >= share * largest[-1]))
        found = first_fractures(one, np.array([[share]]), [FORCE], tolerance=1e-9)
        assert found.time[0] == pytest.approx(time[k], abs=2.0 * np.diff(time).max())
        assert found.imbalance[0] == pytest.approx(abs(a[k] - b[k]) / largest[k], abs=2e-3)
        assert bool(found.early[0]) == bool(time[k] < one.first_echo[0])
    # theory section 3: the first loading reaches 2.554 of 3.021 GPa, the rest comes with the reload
    fine = [first_fractures(one, np.array([[q]]), [path_of("p_max") or FORCE]).early[0] for q in (0.84, 0.85)]
    assert fine == [True, False]


@pytest.mark.parametrize("name", ["core_tension", "subsurface_shear", "ring_crack", "centre_tension", "edge_tension"])
def test_the_criterion_equals_its_strength_at_fracture(name: str) -> None:
    many = scene(4)
    quantity = CRITERIA[name].quantity
    assert quantity is not None
    largest = solve(many, quantities=(quantity,)).values[quantity]
    shares = np.array([[0.3], [0.6], [0.9], [0.99]])
    path = path_of(quantity)
    assert path is not None
    found = first_fractures(many, shares, [path], tolerance=1e-8)
    scales = many.scales
    columns = {
        **many.columns,
        "P_max": found.force,
        "p_max": contact.pressure_at_force(found.force, scales.modulus, scales.effective_radius),
        "a_max": contact.contact_radius(
            contact.approach_at_force(found.force, scales.hertz_constant), scales.effective_radius
        ),
    }
    np.testing.assert_allclose(demand(CRITERIA[name], columns), shares[:, 0] * largest, rtol=3e-4)


def test_the_first_of_several_governs() -> None:
    many = scene(3)
    shares = np.array([[0.5, 0.4], [0.4, 0.5], [1.2, 1.0]])
    found = first_fractures(many, shares, [FORCE, FORCE])
    assert found.first.tolist() == [1, 0, -1]
    assert np.isinf(found.times[2]).all()
    assert np.isnan([found.time[2], found.force[2], found.energy[2], found.imbalance[2]]).all()


def test_what_comes_with_the_reload_is_no_first_peak() -> None:
    one = scene(1)
    early = path_of("first_peak")
    assert early is not None
    found = first_fractures(one, np.array([[0.999]]), [early])
    assert found.early[0]
    late = first_fractures(one, np.array([[0.999]]), [path_of("p_max") or FORCE])
    assert found.time[0] < one.first_echo[0] < late.time[0]


def test_a_strength_of_zero_breaks_at_first_touch() -> None:
    found = first_fractures(scene(), np.array([[0.0]]), [path_of("core_tension") or FORCE])
    assert 0.0 <= found.time[0] < 1e-6


def test_rows_outside_the_domain_reach_nothing() -> None:
    two = Scene(columns={**scene(2).columns, "sphere.radius": np.array([0.01, 0.03])})
    found = first_fractures(two, np.full((2, 1), 0.5), [FORCE])
    assert found.first.tolist() == [0, -1]


def test_every_demand_has_a_path_but_what_breaks_nothing() -> None:
    for entry in CRITERIA.values():
        # what a blow offers is no demand that rises along its course
        if entry.quantity is not None and entry.follows:
            assert path_of(entry.quantity) is not None
    assert path_of("specific_impact_energy") is None
    assert path_of("contact_time") is None
    assert path_of("alpha_max") is None
    rated = path_of("core_tension.x", {"core_tension.x": ("core_tension", {"rate_0": 200.0})})
    assert rated == LoadingPath(over="force", criterion="core_tension")


def test_balance_judged_at_fracture() -> None:
    check = check_at_fracture(np.array([0.01, 0.06, 0.2, np.nan]), np.array([2.0, 1.0, 1.0, 9.0]))
    assert (check.share_information, check.share_warning, check.worst) == (0.25, 0.25, 0.2)
    assert "in 50 % of the spheres that break" in check.text
    fine = check_at_fracture(np.array([0.01]), np.ones(1))
    assert fine.grade == 0
    assert "at most 0.01" in fine.text
    assert check_at_fracture(np.array([np.nan]), np.ones(1)).worst is None


# --- whole runs -------------------------------------------------------------------------------------------

TWO = (
    'title = "Two ways to break, everything lognormal"\nseed = 5\n'
    + (CLOSED % (0.1, 0.05, 0.1)).replace("30 ms", "8 ms")
    + """\
[limits.pressure]
quantity = "p_max"
strength = { dist = "lognormal", mean = "PRESSURE GPa", cov = 0.1 }
[limits.force]
quantity = "P_max"
strength = { dist = "lognormal", mean = "FORCE kN", cov = 0.15 }
TIE
[analysis]
quantities = ["p_max"]
methods = METHODS
budget = { evaluations = EVALUATIONS, time = "5 min" }
accuracy = { mean = 0.02, quantile = 0.05, sobol = 0.2, probability = 0.03 }
"""
)


FIXED = """
[sphere]
E = "52 GPa"
nu = 0.25
radius = "10 mm"
density = "2650 kg/m3"
[bars]
E = "200 GPa"
nu = 0.3
density = "7850 kg/m3"
yield_strength = "0.8 GPa"
diameter = "40 mm"
infinite = true
[striker]
speed = "0.5 m/s"
length = "0.8 m"
[limits.force]
quantity = "P_max"
strength = "1 kN"
"""


def exact_union(pressure: float, force: float, tie: float = 0.0) -> float:
    """1 - P(both strengths hold): the logarithms of strength over demand are two normals, by Owen (1956)."""
    impedance = math.pi * 0.03**2 * math.sqrt(210e9 * 7850.0)
    log_force = math.log(0.5 * impedance) + middle(1.0, 0.1)
    v = spread(0.1) ** 2
    first = math.sqrt((v + 4.0 * v + 4.0 * spread(0.05) ** 2) / 9.0 + v)
    second = math.sqrt(v + spread(0.15) ** 2)
    rho = (v / 3.0 + tie * spread(0.1) * spread(0.15)) / (first * second)
    h = (middle(pressure, 0.1) - log_peak((0.1, 0.05, 0.1))) / first
    k = (middle(force, 0.15) - log_force) / second
    root = math.sqrt(1.0 - rho**2)
    both = 0.5 * (ndtr(h) + ndtr(k)) - owens_t(h, (k - rho * h) / (h * root)) - owens_t(k, (h - rho * k) / (k * root))
    return float(1.0 - both)


def closed_run(
    folder: Path, pressure: str, force: str, tie: str = "", methods: str = '["qmc"]', most: int = 60_000
) -> dict[str, Any]:
    path = folder / "two.toml"
    text = TWO.replace("PRESSURE", pressure).replace("FORCE", force).replace("TIE", tie).replace("METHODS", methods)
    text = text.replace("EVALUATIONS", f"{most}")
    path.write_text(text, encoding="utf-8")
    return uqsphere.run(uqsphere.load_study(path), out=folder / "r").results.document()


def test_union_of_a_run_in_closed_form(tmp_path: Path) -> None:
    found = closed_run(tmp_path, "7.2", "75")["fracture"]
    union, exact = found["union"], exact_union(7.2e9, 75e3)
    assert abs(union["value"] - exact) < 4.0 * union["std_error"] + 1e-3 * exact
    assert union["std_error"] < 0.02 * exact
    # infinite bars: nothing comes back
    assert found["first_loading"] == found["union"] == found["over_record"]


def test_tied_strengths_of_a_run_in_closed_form(tmp_path: Path) -> None:
    tie = '[[dependence]]\nof = ["limits.pressure.strength", "limits.force.strength"]\nspearman = 0.8\n'
    union = closed_run(tmp_path, "7.2", "75", tie)["fracture"]["union"]
    exact = exact_union(7.2e9, 75e3, 2.0 * math.sin(math.pi * 0.8 / 6.0))
    assert abs(union["value"] - exact) < 4.0 * union["std_error"] + 1e-3 * exact
    assert abs(exact - exact_union(7.2e9, 75e3)) > 8.0 * union["std_error"]


def test_a_rare_union_goes_on_in_normal_space(tmp_path: Path) -> None:
    union = closed_run(tmp_path, "11.8", "155", methods='"auto"')["fracture"]["union"]
    exact = exact_union(11.8e9, 155e3)
    assert exact < 1e-4
    assert "importance" in union["method"]
    assert abs(union["value"] - exact) < 4.0 * union["std_error"] + 1e-2 * exact
    assert union["low"] > 0.9 * exact


def test_strengths_tied_by_another_copula_are_refused_with_the_reason(tmp_path: Path) -> None:
    tie = (
        '[[dependence]]\nof = ["limits.pressure.strength", "limits.force.strength"]\n'
        'copula = "clayton"\nkendall = 0.5\n'
    )
    found = closed_run(tmp_path, "7.2", "75", tie, most=4_000)
    assert found["fracture"]["union"]["value"] is None
    assert "copula that is not Gaussian" in found["fracture"]["reason"]


MORE = """
[limits.core]
criterion = "core_tension"
strength = { dist = "weibull", mean = "70 MPa", modulus = 8 }
[limits.yield]
quantity = "p_max"
strength = "2.4 GPa"
fracture = false
[limits.long]
quantity = "contact_time"
strength = "1 ms"
"""


@pytest.fixture(scope="module")
def several(tmp_path_factory: pytest.TempPathFactory, small_text: str) -> uqsphere.Run:
    folder = tmp_path_factory.mktemp("several")
    path = folder / "several.toml"
    margins = '[margins]\nsolve = "striker.speed"\nbetween = ["1 m/s", "12 m/s"]\nfor_probability = [0.1, 0.5]\n'
    text = small_text.replace("evaluations = 30_000", "evaluations = 60_000")
    path.write_text(text.replace("[analysis]", MORE + "[analysis]") + margins, encoding="utf-8")
    run = uqsphere.run(uqsphere.load_study(path), out=folder / "r")
    build_report(run.folder)
    return run


def test_the_answers_of_a_run_fit_together(several: uqsphere.Run) -> None:
    results = several.results.document()
    found = results["fracture"]
    assert found["limits"] == ["crushing", "core"]
    assert found["left_out"] == ["yield", "long"]
    single = [results["limits"][name]["exceedance"]["value"] for name in found["limits"]]
    union = found["union"]["value"]
    assert max(single) < union < sum(single)
    assert sum(e["value"] for e in found["governed_by"].values()) == pytest.approx(1.0, abs=1e-9)
    for name, probability in zip(found["limits"], single, strict=True):
        assert found["governed_by"][name]["low"] * union <= probability
    assert sum(entry["share"]["value"] for entry in found["order"]) == pytest.approx(1.0, abs=1e-9)
    assert 0.0 < found["first_loading"]["value"] < union


def test_first_loading_is_what_the_specimens_show(several: uqsphere.Run) -> None:
    """The record cut at the first echo, and the moments of fracture: two ways that share no step."""
    found = several.results.document()["fracture"]
    share, ratio = found["share_in_first_loading"], found["first_loading"]["value"] / found["union"]["value"]
    assert abs(share["value"] - ratio) < 4.0 * share["std_error"]


def test_the_balance_of_forces_is_judged_at_fracture(several: uqsphere.Run) -> None:
    check = next(c for c in several.results.document()["validity"] if c["check"] == "force_balance")
    assert "fracture" in check["text"] or "breaks" in check["text"]
    assert check["worst"] >= several.results.fracture.imbalance.quantiles["0.95"].value


def test_the_union_over_the_speed_lies_above_each_limit(several: uqsphere.Run) -> None:
    found = several.results.document()["fracture"]
    curve = {point[0]: point[1] for point in found["curve"]}
    assert len(curve) >= 5
    for name in found["limits"]:
        for value, p, *_ in several.results.document()["margins"][name]["curve"]:
            if value in curve:
                assert curve[value] >= p - 1e-9
    assert found["values"]["0.5"]["value"] < several.results.margins["crushing"].values["0.5"].value


def test_fracture_in_report_tables_and_summary(several: uqsphere.Run) -> None:
    page = (several.folder / "report.html").read_text("utf-8")
    assert "share of fractures in which" in page
    assert (several.folder / "figures" / "interplay.svg").is_file()
    table = tables(several.results)["fracture.csv"]
    assert "governed_by,core" in table
    assert "time,q0.5,s" in table
    assert "any," in tables(several.results)["fragility.csv"]
    assert "Core tension" in summary_of(read_contents(several.folder))


def test_one_limit_is_its_own_union(finished: Path) -> None:
    results = uqsphere.open_run(finished).results.document()
    found = results["fracture"]
    assert found["union"] == results["limits"]["crushing"]["exceedance"]
    assert found["governed_by"]["crushing"]["value"] == 1.0


def test_a_small_budget_leaves_the_union_and_says_so(tmp_path: Path, small_text: str) -> None:
    path = tmp_path / "few.toml"
    path.write_text(small_text.replace("evaluations = 30_000", "evaluations = 4_500"), encoding="utf-8")
    found = uqsphere.run(uqsphere.load_study(path), out=tmp_path / "r").results.document()["fracture"]
    assert found["union"]["value"] > 0.0
    assert "budget" in found["reason"]


def test_a_sphere_without_scatter_breaks_at_its_force(tmp_path: Path) -> None:
    path = tmp_path / "fixed.toml"
    path.write_text(FIXED, encoding="utf-8")
    found = uqsphere.run(uqsphere.load_study(path), out=tmp_path / "r").results.document()["fracture"]
    assert found["union"]["value"] == 1.0
    assert found["force"]["median"]["value"] == pytest.approx(1000.0, rel=1e-4)


def test_where_faces_yield_the_path_is_that_of_the_law():
    """At the moment found the force is that of the level: by the law, or by Hertz's third power."""
    numbers = ENDLESS | {"bars.E": 205e9, "bars.yield_strength": 1e9, "striker.speed": 0.5, "striker.length": 0.8}
    one = example(numbers=numbers, infinite=True, contact_law="plastic")
    answers = solve(one, tolerance=1e-9, threads=1, quantities=("P_max", "p_max", "energy")).values
    top, whole = answers["P_max"], one.faces.pressed(one.faces.depth_at(answers["P_max"]))
    for share in (0.5, 0.97):
        paths = [PATHS[name] for name in ("P_max", "p_hertz", "p_max", "energy")]
        single = [first_fractures(one, np.array([[share]]), [path], tolerance=1e-9) for path in paths]
        force, hertz, true, energy = single
        assert force.force[0] == pytest.approx(share * top[0], rel=1e-5)
        assert hertz.force[0] == pytest.approx(share**3 * top[0], rel=1e-5)
        pressed = one.faces.pressed(one.faces.depth_at(true.force))
        assert pressed.centre[0] == pytest.approx(share * whole.centre[0], rel=1e-5)
        assert energy.energy[0] == pytest.approx(share * answers["energy"][0], rel=1e-5)
        assert true.time[0] < hertz.time[0] < force.time[0]
