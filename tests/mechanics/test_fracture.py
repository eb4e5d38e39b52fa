"""Fracture on the loading path: crossing times in closed form, the state there, and whole runs with
several limits.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import ENDLESS, example

import uqsphere
from uqsphere.mechanics import contact
from uqsphere.mechanics.closed_form import loading_time, solve_closed
from uqsphere.mechanics.criteria import CRITERIA, demand
from uqsphere.mechanics.fracture import LoadingPath, first_fractures, path_of, static_fractures
from uqsphere.mechanics.history import trace
from uqsphere.mechanics.integrator.solve import Motion, motions, solve
from uqsphere.mechanics.scene import Scene
from uqsphere.results.types import Kind
from uqsphere.study import load_study

FORCE, ENERGY = LoadingPath(over="force"), LoadingPath(over="energy")


def scene(rows: int = 1, shape: str = "rectangular", **settings: Any) -> Scene:
    return example(shape, rows, **settings)


# --- crossing times -------------------------------------------------------------------------------


def test_massless_step_in_closed_form() -> None:
    """Under a step a sphere without mass reaches the approach x alpha_c at t_c s(x), theory section
    4.
    """
    x = np.array([0.05, 0.1, 0.5, 0.9, 0.99])
    one = scene(len(x), "step", infinite=True, horizon=0.02)
    largest = solve(one, fidelity="massless", tolerance=1e-10, quantities=("P_max", "energy"))
    scales = one.scales
    force = scales.force * x**1.5
    energy = 2.0 * 0.4 * scales.force * scales.approach * x**2.5
    shares = np.stack([force / largest.values["P_max"], energy / largest.values["energy"]], axis=1)
    exact = scales.time * loading_time(x)
    for column, path in enumerate((FORCE, ENERGY)):
        found = first_fractures(
            one, shares[:, [column]], [path], fidelity="massless", tolerance=1e-10
        )
        np.testing.assert_allclose(found.times[:, 0], exact, rtol=1e-7)
        np.testing.assert_allclose(found.force, force, rtol=1e-7)
        np.testing.assert_allclose(found.energy, energy, rtol=1e-7)
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
    # the peak is evaluated at sixteen points of a step, whose length is the integrator's
    assert errors[2] < 1e-4
    assert errors[2] < errors[0]


def test_against_the_history_of_the_scene() -> None:
    """The same moments read off a history on a fine grid, which shares neither the search nor the
    levels.
    """
    one = scene()
    history = trace(one, points=40_001)
    kept = history.time <= history.record_end
    time, a, b = history.time[kept], history.force_a[kept], history.force_b[kept]
    largest = np.maximum.accumulate(np.maximum(a, b))
    for share in (0.2, 0.6, 0.9, 0.999):
        k = int(np.argmax(largest >= share * largest[-1]))
        found = first_fractures(one, np.array([[share]]), [FORCE], tolerance=1e-9)
        assert found.time[0] == pytest.approx(time[k], abs=2.0 * np.diff(time).max())
    # theory section 3: the first loading reaches 2.554 of 3.021 GPa, the rest comes with the reload
    fine = [
        first_fractures(one, np.array([[q]]), [path_of("p_max") or FORCE]).time[0]
        for q in (0.84, 0.85)
    ]
    assert fine[0] < one.first_echo[0] < fine[1]


@pytest.mark.parametrize(
    "name", ["core_tension", "subsurface_shear", "ring_crack", "centre_tension", "edge_tension"]
)
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
    assert np.isnan([found.time[2], found.force[2], found.energy[2]]).all()


def test_what_comes_with_the_reload_is_no_first_peak() -> None:
    one = scene(1)
    early = path_of("first_peak")
    assert early is not None
    found = first_fractures(one, np.array([[0.999]]), [early])
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
    bounded = ("specific_impact_energy", {"largest_energy": 900.0})
    assert path_of("energy.x", {"energy.x": bounded}) is None
    assert path_of("time_to_first_loss") is None
    assert path_of("alpha_max") is None
    rated = path_of("core_tension.x", {"core_tension.x": ("core_tension", {"rate_0": 200.0})})
    assert rated == LoadingPath(over="force", criterion="core_tension")


@pytest.mark.parametrize("law", ["hertz", "plastic"])
def test_between_platens_the_least_share_of_the_force_is_first(law: str) -> None:
    """Energies on the way are those of a press with that force; it has no times."""
    shares = np.array([[0.7, 0.3], [0.3, 0.7], [0.5, np.inf], [np.inf, 1.0]])
    numbers = {name: value for name, value in ENDLESS.items() if name.startswith("sphere.")}
    numbers |= {"sphere.onset_pressure": 1e9, "sphere.hardness": 2e9}
    numbers |= {"platens.E": 210e9, "platens.nu": 0.3, "platens.force": 4e3}

    def press(force: Any) -> Scene:
        changed = numbers | {"platens.force": force}
        return example(rows=len(shares), numbers=changed, rig="platens", contact_law=law)

    full = solve_closed(press(4e3), quantities=("energy",)).values["energy"]
    found = static_fractures(press(4e3), shares, [FORCE, ENERGY])
    assert found.first.tolist() == [1, 0, 0, -1]
    assert np.isnan(found.time).all()
    broken = found.first >= 0
    again = solve_closed(press(np.where(broken, found.force, 1.0)), quantities=("energy",))
    np.testing.assert_allclose(found.energy[broken], again.values["energy"][broken], rtol=1e-9)
    np.testing.assert_allclose(found.force[[1, 2]], np.array([0.3, 0.5]) * 4e3, rtol=1e-12)
    np.testing.assert_allclose(found.energy[0], 0.3 * full[0], rtol=1e-9)


def test_a_massless_sphere_under_a_weight_breaks_as_a_light_one_does() -> None:
    """Of a sphere a ten-thousandth as heavy as the weight the motion finds nearly the same."""
    numbers = {name: value for name, value in ENDLESS.items() if name.startswith("sphere.")}
    for table in ("hammer", "anvil"):
        numbers |= {f"{table}.E": 210e9, f"{table}.nu": 0.3}
    numbers |= {"hammer.mass": 100.0, "hammer.speed": 0.3}
    shares = np.array([[0.9, 0.5], [0.4, 0.5]])
    weight = example(rows=2, numbers=numbers, rig="drop_weight")
    moving = first_fractures(weight, shares, [FORCE, ENERGY])
    static = static_fractures(weight, shares, [FORCE, ENERGY], fidelity="massless")
    assert static.first.tolist() == moving.first.tolist() == [1, 0]
    np.testing.assert_allclose(static.force, moving.force, rtol=0.02)
    np.testing.assert_allclose(static.energy, moving.energy, rtol=0.04)


def test_where_faces_yield_the_path_is_that_of_the_law():
    """At the moment found the force is that of the level: by the law, or by Hertz's third power."""
    numbers = ENDLESS | {
        "bars.E": 205e9,
        "bars.yield_strength": 1e9,
        "striker.speed": 0.5,
        "striker.length": 0.8,
    }
    one = example(numbers=numbers, infinite=True, contact_law="plastic")
    answers = solve(one, tolerance=1e-9, threads=1, quantities=("P_max", "p_max", "energy")).values
    face, top = one.struck.face, answers["P_max"]
    assert face is not None
    whole = face.pressed(face.depth_at(top))
    for share in (0.5, 0.97):
        paths = [path_of(name) or FORCE for name in ("P_max", "p_hertz", "p_max", "energy")]
        single = [
            first_fractures(one, np.array([[share]]), [path], tolerance=1e-9) for path in paths
        ]
        force, hertz, true, energy = single
        assert force.force[0] == pytest.approx(share * top[0], rel=1e-5)
        assert hertz.force[0] == pytest.approx(share**3 * top[0], rel=1e-5)
        pressed = face.pressed(face.depth_at(true.force))
        assert pressed.p_max[0] == pytest.approx(share * whole.p_max[0], rel=1e-5)
        assert energy.energy[0] == pytest.approx(share * answers["energy"][0], rel=1e-5)
        assert true.time[0] < hertz.time[0] < force.time[0]


def test_a_linear_contact_breaks_along_its_own_course() -> None:
    """The force at the moment found is the level of the linear model's own peak."""
    many = scene(4)
    largest = solve(many, fidelity="linear", tolerance=1e-8, quantities=("P_max", "energy"))
    shares = np.array([[0.3], [0.6], [0.9], [0.99]])
    for name, path in (("P_max", FORCE), ("energy", ENERGY)):
        found = first_fractures(many, shares, [path], fidelity="linear", tolerance=1e-8)
        reached = found.force if name == "P_max" else found.energy
        np.testing.assert_allclose(reached, shares[:, 0] * largest.values[name], rtol=1e-4)


def test_a_run_of_the_linear_model_tells_the_force_at_which_its_spheres_break(
    tmp_path: Path,
) -> None:
    text = """
        sphere = { E = "52 GPa", nu = 0.25, radius = "10 mm", density = "2650 kg/m3" }
        bars = { material = "maraging_steel", diameter = "40 mm", infinite = true }
        striker = { length = "0.4 m", speed = { dist = "normal", mean = "1 m/s", cov = 0.02 } }
        contact.law = "hertz"
        model.fidelity = "linear"
        limits.force = { quantity = "P_max", aim = "survive", target = 0.01, strength = {
            dist = "uniform", lower = "6.4 kN", upper = "6.5 kN" } }
        limits.late = { quantity = "p_max", aim = "survive", target = 0.01, strength = {
            dist = "uniform", lower = "2.9 GPa", upper = "3.1 GPa" }, strength_is = "hertz" }
        analysis.accuracy = { mean = 0.1, quantile = 0.2, sobol = 0.2, probability = 0.1 }
        """
    study = load_study(tmp_path / "study.toml", text=text.replace("= {\n            ", "= { "))
    results = uqsphere.run(study).results
    forces = [row.value or 0.0 for row in results.where("fracture", Kind.FORCE_AT_FRACTURE)]
    assert len(forces) == 3
    assert all(6400.0 <= force <= 6500.0 for force in forces)


#: a sphere whose numbers are all fixed, and which breaks by its strengths
FIXED = """
sphere = { E = "60 GPa", nu = 0.25, radius = "8 mm", density = "2600 kg/m3" }
rig = { kind = "impact", speed = "3 m/s" }
target = { kind = "thick", material = "steel" }
contact.law = "hertz"
limits.pressure = { quantity = "p_max", aim = "survive", strength = { \
    dist = "lognormal", mean = "2.5 GPa", cov = 0.2 } }
limits.core = { quantity = "core_tension", aim = "survive", strength = { \
    dist = "lognormal", mean = "24 MPa", cov = 0.2 } }
"""


def test_a_sphere_whose_numbers_are_all_fixed_breaks_by_its_strengths(tmp_path: Path) -> None:
    study = load_study(tmp_path / "study.toml", text=FIXED)
    results = uqsphere.run(study).results
    [broken] = results.where("fracture", Kind.EXCEEDANCE_PROBABILITY)
    each = [
        results.get(f"limits.{name}", Kind.EXCEEDANCE_PROBABILITY).value or 0.0
        for name in ("pressure", "core")
    ]
    assert broken.value == pytest.approx(1.0 - (1.0 - each[0]) * (1.0 - each[1]), rel=1e-9)
    shares = [row.value for row in results.where("fracture", Kind.MODE_SHARE)]
    assert sum(share or 0.0 for share in shares) == pytest.approx(1.0)
    assert all(row.value for row in results.where("fracture", Kind.TIME_AT_FRACTURE))


def test_spheres_that_cannot_be_followed_tell_nothing_of_their_fracture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every third sphere without a motion, once counted as broken at once, by nothing."""
    study = load_study(tmp_path / "study.toml", text=FIXED)
    whole = uqsphere.run(study).results

    def some(scene: Scene, rows: Any, **settings: Any) -> list[Motion | int]:
        moved = motions(scene, rows, **settings)
        return [3 if row % 3 == 0 else found for row, found in zip(rows, moved, strict=True)]

    monkeypatch.setattr("uqsphere.mechanics.fracture.motions", some)
    results = uqsphere.run(study).results
    shares = [row.value or 0.0 for row in results.where("fracture", Kind.MODE_SHARE)]
    assert sum(shares) == pytest.approx(1.0)
    for kind in (Kind.TIME_AT_FRACTURE, Kind.FORCE_AT_FRACTURE, Kind.ENERGY_AT_FRACTURE):
        pairs = zip(results.where("fracture", kind), whole.where("fracture", kind), strict=True)
        for row, before in pairs:
            assert row.value == pytest.approx(before.value, rel=0.1)
            assert row.runs < before.runs


def test_a_run_without_a_motion_tells_what_breaks_and_not_when(tmp_path: Path) -> None:
    text = """
        sphere = { E = "60 GPa", nu = 0.25, radius = "8 mm", density = "2600 kg/m3" }
        rig.kind = "drop_weight"
        hammer.mass = "0.5 kg"
        hammer.material = "steel"
        hammer.drop_height = { dist = "normal", mean = "12 mm", cov = 0.04 }
        anvil = { kind = "thick", material = "steel" }
        contact.law = "hertz"
        model.fidelity = "massless"
        limits.force = { quantity = "P_max", aim = "survive", strength = "1.8 kN" }
        limits.pressure = { quantity = "p_max", aim = "survive", strength = "2.4 GPa" }
        analysis.budget.evaluations = 256
        """
    results = uqsphere.run(load_study(tmp_path / "study.toml", text=text)).results
    [broken] = results.where("fracture", Kind.EXCEEDANCE_PROBABILITY)
    assert 0.0 < (broken.value or 0.0) < 1.0
    assert sum(row.value or 0.0 for row in results.where("fracture", Kind.MODE_SHARE)) == 1.0
    for kind in (Kind.FORCE_AT_FRACTURE, Kind.ENERGY_AT_FRACTURE):
        assert all(row.value for row in results.where("fracture", kind))
    for row in results.where("fracture", Kind.TIME_AT_FRACTURE):
        assert row.value is None
        assert "course over time" in row.note
