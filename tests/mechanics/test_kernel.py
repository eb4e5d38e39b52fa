"""The integrator against oracles, independent integrations, and the properties it must have.

SOLVER: an error may be five times the tolerance that was asked for; EXACT: identities hold to
rounding.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import llvmlite.binding
import numba
import numpy as np
import pytest
from scenes import EXAMPLE, example, scaled_scene

from uqsphere import evaluate, load_study
from uqsphere.mechanics.integrator import (
    events,
    faces,
    flights,
    incoming,
    kernel,
    lanes,
    records,
    touch,
    tracked,
)
from uqsphere.mechanics.integrator import solve as dynamics
from uqsphere.mechanics.integrator.solve import motion, solve
from uqsphere.mechanics.integrator.tracked import LANES, STATE
from uqsphere.mechanics.outputs import SceneAnswers
from uqsphere.mechanics.scene import Scene, answered

SOLVER = 5.0
EXACT = 1e-12

REFERENCE = json.loads((Path(__file__).parent / "data" / "reference_scenes.json").read_text())


def random_scene(count: int, seed: int, *, lightest: float = 1e-4) -> Scene:
    """Finite bars of very different lengths, ends from fixed to free, mu up to 10."""
    rng = np.random.default_rng(seed)
    first = 10.0 ** rng.uniform(-0.5, 0.7, count)
    trips = np.stack([first, first * 10.0 ** rng.uniform(-1.2, 1.2, count)], axis=1)
    ends = rng.choice([-1.0, -0.4, 0.0, 0.5, 1.0], (count, 2))
    mu = 10.0 ** rng.uniform(np.log10(lightest), 1, count)
    return scaled_scene(mu, first * rng.uniform(0.05, 1.0, count), trips, ends)


def over(answers: SceneAnswers, scene: Scene, name: str) -> Any:
    """A quantity over its scale."""
    scale = {
        "alpha_max": scene.scales.approach,
        "time_to_first_loss": scene.scales.time,
        "P_max": scene.scales.force,
    }[name]
    return answers.values[name] / scale


def relative(found: Any, expected: Any) -> Any:
    return np.abs(np.asarray(found) / np.asarray(expected) - 1.0)


# ---- oracles


def test_reference_scenes_between_finite_bars() -> None:
    rows = REFERENCE["finite"]
    columns = {name: np.array([row["scene"][name] for row in rows]) for name in rows[0]["scene"]}
    found = solve(Scene(columns=columns), tolerance=1e-8)
    assert (found.status == 0).all()
    # the reference ends at the first loss, behind which the record may go on to a harder squeeze
    first = found.values["time_to_first_loss"]
    ends_there = found.record <= first * (1.0 + 1e-9)
    assert ends_there.mean() > 0.7
    # the reference is converged to about 1e-8, its times to 1e-7; its force_imbalance, a small
    # difference, to 1e-6
    for name, tolerance in (
        ("p_max", 5e-8),
        ("P_max", 5e-8),
        ("contact_time", 2e-7),
        ("force_imbalance", 5e-6),
    ):
        expected = np.array(
            [np.nan if row["answer"][name] is None else row["answer"][name] for row in rows]
        )
        known = np.isfinite(expected) & (ends_there | (name == "contact_time"))
        values = found.values["time_to_first_loss" if name == "contact_time" else name]
        assert relative(values, expected)[known].max() < tolerance, name
    lost = [row["answer"]["contact_time"] is not None for row in rows]
    assert found.censored["time_to_first_loss"].tolist() == [not one for one in lost]


def test_reference_peaks_on_infinite_bars() -> None:
    rows = REFERENCE["infinite"]
    scene = scaled_scene([row["mu"] for row in rows], [row["theta"] for row in rows])
    found = solve(scene, tolerance=1e-9)
    assert (
        relative(over(found, scene, "alpha_max"), [row["x_max"] for row in rows]).max()
        < SOLVER * 1e-9
    )


def test_first_separation_on_infinite_bars() -> None:
    scene = scaled_scene([1.0, 0.03], 3.0, horizon_in_t_c=40.0)
    found = solve(scene, tolerance=1e-9)
    assert not found.censored["time_to_first_loss"].any()
    assert (
        relative(over(found, scene, "time_to_first_loss"), [3.828559013, 28.040523689]).max() < 2e-9
    )
    assert relative(over(found, scene, "alpha_max"), [1.1250021777, 1.0058905197]).max() < 2e-10


def test_step_pulse_on_infinite_bars() -> None:
    for mu, peak, imbalance in (
        (10.0, 1.7535, None),
        (1.0, 1.1932, None),
        (0.1, 1.03297, 0.43488),
        (0.01, 1.00436, 0.16420),
        (0.001, None, 0.05880),
    ):
        scene = scaled_scene(mu, 1.0, shape="step", horizon_in_t_c=40.0)
        found = solve(scene, tolerance=1e-8)
        if peak is not None:  # the oracle is that of face A alone
            path = motion(scene, 0, tolerance=1e-8)
            powers = np.linspace(0.0, 1.0, 401)[:, None] ** np.arange(path.states.shape[2])
            at_a = (path.states[:, 0] @ powers.T).max()
            assert at_a**1.5 == pytest.approx(peak, abs=6e-5 if mu >= 1.0 else 6e-6)
            assert over(found, scene, "P_max")[0] >= at_a**1.5 * (1.0 - 1e-9)
        if imbalance is not None:
            absolute = found.values["force_imbalance"] * over(found, scene, "P_max")
            assert absolute[0] == pytest.approx(imbalance, abs=6e-6)


# ---- independent integrations


# ---- properties


def _same_bits(first: SceneAnswers, second: SceneAnswers, rows: Any) -> None:
    assert (first.status[rows] == second.status).all()
    assert (first.steps[rows] == second.steps).all()
    for name in first.values:
        assert np.array_equal(first.values[name][rows], second.values[name], equal_nan=True), name


@pytest.mark.parametrize(
    ("count", "lightest", "finite"),
    # the lightest spheres rattle through many more steps of the same kind
    [(1100, 1e-2, True), (1100, 1e-2, False), (60, 1e-4, True)],
)
def test_a_row_depends_on_nothing_but_the_row(count: int, lightest: float, finite: bool) -> None:
    scene = random_scene(count, 7, lightest=lightest)
    if not finite:
        scene = Scene(columns=scene.columns, infinite=True)
        scene = Scene(
            columns=scene.columns, infinite=True, horizon=float(8.0 * scene.scales.time[0])
        )
    together = solve(scene, tolerance=1e-4, threads=1)
    _same_bits(together, solve(scene, tolerance=1e-4, threads=3), slice(None))
    shuffled = np.random.default_rng(8).permutation(count)
    for rows in (shuffled, np.arange(count)[::-1], np.arange(13, count // 3), np.array([5])):
        part = Scene(
            columns={name: column[rows] for name, column in scene.columns.items()},
            infinite=scene.infinite,
            horizon=scene.horizon,
        )
        _same_bits(together, solve(part, tolerance=1e-4), rows)


def test_the_error_falls_with_the_tolerance_and_stays_below_it() -> None:
    drawn = random_scene(300, 11)
    loss = ("time_to_first_loss",)
    # behind the first loss a light sphere rattles for many steps, and what it does there hangs on
    # every digit: of such rows no more than the first loss is held
    look = solve(drawn, tolerance=1e-8, quantities=("p_max", *loss))
    assert (look.status == 0).all()
    ends_there = look.record <= look.values[loss[0]] * (1.0 + 1e-9)
    scene, some = drawn.at(np.flatnonzero(ends_there)), drawn.at(np.arange(0, len(drawn), 3))
    exact = solve(scene, tolerance=1e-11)
    lost = solve(some, tolerance=1e-11, quantities=loss)
    assert (exact.status == 0).all()
    assert (lost.status == 0).all()
    kept = exact.record <= exact.values[loss[0]] * (1.0 + 1e-9)
    assert kept.sum() > 100
    medians = []
    for tolerance in (1e-3, 1e-5, 1e-7, 1e-9):
        found = solve(scene, tolerance=tolerance)
        assert answered(found.status).all()
        for name in (
            "p_max",
            "first_peak",
            "contact_duration",
            "rise_time",
            "force_imbalance",
            "energy",
        ):
            error = relative(found.values[name], exact.values[name])[kept] / tolerance
            # a threshold may be reached one oscillation sooner or later: a true jump, in few rows
            assert np.quantile(error, 0.98) < SOLVER, (name, tolerance)
            assert np.median(error) < 1.0
        early = solve(some, tolerance=tolerance, quantities=loss)
        assert answered(early.status).all()
        late = relative(early.values[loss[0]], lost.values[loss[0]])
        assert np.quantile(late, 0.95) < SOLVER * tolerance
        medians.append(np.median(relative(found.values["p_max"], exact.values["p_max"])))
        assert found.steps[kept].mean() < 600
    assert (np.diff(np.log10(medians)) < -1.0).all()


@pytest.mark.parametrize("name", ["P_max", "p_max", "contact_duration", "energy", "rise_time"])
def test_a_quantity_keeps_the_tolerance_asked_for_alone(name: str) -> None:
    """Light spheres under short pulses, whose steps err the most: once 27 tolerances of P_max."""
    scene = scaled_scene(
        [7.89681367e-06, 3.76754462e-05],
        [0.01336008, 0.03411372],
        trips=[[1.14545892, 1.97480924], [2.89496254, 2.24670714]],
        ends=[[0.9, 0.3], [0.5, 0.3]],
    )
    exact = solve(scene, tolerance=1e-10, quantities=(name, "force_imbalance"))
    for tolerance in (1e-4, 1e-6, 1e-8):
        found = solve(scene, tolerance=tolerance, quantities=(name,))
        assert relative(found.values[name], exact.values[name]).max() < tolerance, name


def test_what_is_asked_for_is_what_is_answered() -> None:
    scene = random_scene(60, 12)
    every = solve(scene, tolerance=1e-7)
    for names in (
        ("p_max", "time_to_first_loss"),
        ("rise_time",),
        ("force_imbalance", "specific_energy"),
    ):
        found = solve(scene, tolerance=1e-7, quantities=names)
        assert set(found.values) == set(names)
        assert set(found.censored) == {"time_to_first_loss"} & set(names)
        for name in names:
            assert (
                np.quantile(relative(found.values[name], every.values[name]), 0.9) < SOLVER * 1e-7
            )
    with pytest.raises(ValueError, match="unknown quantities p_maximum"):
        solve(scene, quantities=("p_maximum",))


def test_steps_of_a_motion_join() -> None:
    scene = random_scene(12, 16)
    for row in range(len(scene)):
        found = motion(scene, row, tolerance=1e-6)
        gaps = found.states[:-1].sum(axis=2) - found.states[1:, :, 0]
        assert np.abs(gaps).max() < EXACT
        assert (
            np.abs(found.start[:-1] + found.length[:-1] - found.start[1:]).max() < EXACT * found.end
        )
        assert found.start[-1] + found.length[-1] == pytest.approx(found.end, rel=EXACT)


def test_motions_of_many_rows_are_those_of_each() -> None:
    scene = random_scene(40, 16)
    rows = np.random.default_rng(2).permutation(40)[: 2 * LANES + 3]
    many = dynamics.motions(replace(scene, whole_record=True), rows, threads=2)
    for row, one in zip(rows.tolist(), many, strict=True):
        alone = motion(scene, row)
        assert isinstance(one, dynamics.Motion)
        assert (one.row, one.end) == (row, alone.end)
        assert np.array_equal(one.start, alone.start)
        assert np.array_equal(one.states, alone.states)


def test_record_on_infinite_bars_ends_where_both_forces_are_small() -> None:
    scene = scaled_scene([1e-4, 1e-3, 1e-2], [0.5, 1.0, 3.0])
    exact = solve(scene, tolerance=1e-10)
    found = solve(scene, tolerance=1e-5)
    ended = exact.censored["time_to_first_loss"]
    assert ended.any()
    assert relative(found.record, exact.record).max() < SOLVER * 1e-5
    for row in np.flatnonzero(ended):
        path = motion(scene, row, tolerance=1e-10)
        last = path.states[-1, :2].sum(axis=1).max() ** 1.5
        assert last == pytest.approx(0.01 * over(exact, scene, "P_max")[row], rel=1e-7)


def test_a_loss_behind_the_end_of_the_record_is_not_looked_at_again() -> None:
    """In the last step both forces fall below 1 %, and then a face is lost, slowly."""
    given = scaled_scene([95.939, 4.8], [0.44694, 0.6], shape="half_sine")
    task = dynamics.task_of(given, "full", 1e-3)
    rows = dynamics.scaled_arguments(given, np.arange(2))
    first, _ = dynamics.march_rows(rows, replace(task, requested=1e-3))
    found = dynamics.integrate(given, task, threads=1)
    assert found["contact_censored"].tolist() == [1.0, 0.0]
    assert first["blur"][0] == 0.0 < first["blur"][1]
    assert found["steps"][0] == first["steps"][0]


def test_extremes_end_and_say_how() -> None:
    mu, theta = (
        grid.ravel()
        for grid in np.meshgrid(10.0 ** np.arange(-6.0, 3.0), 10.0 ** np.arange(-3.0, 2.0))
    )
    for tolerance in (1e-3, 1e-6):
        found = solve(scaled_scene(mu, theta), tolerance=tolerance)
        assert answered(found.status).all()
        assert np.isfinite(found.values["p_max"]).all()
    long = solve(scaled_scene([1e-3, 1.0, 100.0], [1e3, 1e3, 1e3]), tolerance=1e-6)
    assert (long.status == 0).all()
    assert (
        relative(long.values["P_max"][0], 1.0 * scaled_scene([1e-3], [1e3]).scales.force).max()
        < 1e-2
    )


# ---- rows that cannot be done


def test_a_row_without_room_has_a_status_and_no_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dynamics, "_CAPACITIES", (16,))
    found = solve(scaled_scene([1e-3, 100.0], [3.0, 1e-3]))
    assert found.status[0] == 5
    assert all(np.isnan(column[0]) for column in found.values.values())


def test_a_row_of_too_many_steps_is_not_tried_with_more_room(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried = []

    def march(rows: Any, order: Any, state: Any, made: Any, kept: Any, out: Any) -> None:
        tried.append(order.tolist())
        out["status"][order] = np.where(order == 0, tracked.TOO_MANY_STEPS, tracked.FULL_ROOM)

    monkeypatch.setattr(kernel, "march", march)
    given = scaled_scene([1.0, 2.0], 1.0)
    task = dynamics.task_of(given, "full", 1e-6)
    assert dynamics.integrate(given, task, threads=1)["status"].tolist() == [5, 5]
    assert tried == [[0, 1], *[[1]] * (len(dynamics._CAPACITIES) - 1)]


def test_too_many_reflections_have_a_status() -> None:
    scene = scaled_scene([1.0], [0.0018], [(0.002, 60.0)], [(-1.0, -1.0)])
    with pytest.raises(ValueError, match="too many reflections"):
        motion(scene, 0, tolerance=1e-3)


def test_rows_outside_the_domain_do_not_touch_the_others() -> None:
    scene = random_scene(5, 17)
    columns = {name: column.copy() for name, column in scene.columns.items()}
    columns["sphere.E"][1], columns["sphere.radius"][2], columns["pulse.duration"][3] = (
        np.nan,
        -1.0,
        1.0,
    )
    columns["bars.incident_end"][:] = 1.0
    good = solve(
        Scene(
            columns={
                **columns,
                **{
                    name: scene.columns[name]
                    for name in ("sphere.E", "sphere.radius", "pulse.duration")
                },
            }
        )
    )
    found = solve(Scene(columns=columns))
    assert found.status.tolist() == [0, 1, 1, 2, 0]
    assert np.isnan(found.values["p_max"][1:4]).all()
    assert (found.values["p_max"][[0, 4]] == good.values["p_max"][[0, 4]]).all()


def test_a_short_separation_inside_a_step_is_not_passed_over() -> None:
    """Face B lets go for less than a step: the first loss of contact is there at every
    tolerance.
    """
    numbers = {
        **EXAMPLE,
        "striker.speed": 7.415575271957043,
        "sphere.radius": 0.012421949757701448,
        "striker.length": 0.053696975229699934,
    }
    scene = Scene(columns={name: np.array([number]) for name, number in numbers.items()})
    found = [
        float(
            solve(scene, tolerance=tolerance, quantities=("time_to_first_loss",)).values[
                "time_to_first_loss"
            ][0]
        )
        for tolerance in (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-10)
    ]
    np.testing.assert_allclose(found, 193.18e-6, rtol=1e-4)


def test_a_piece_of_a_pulse_as_short_as_a_rounding_is_over_at_once() -> None:
    # its end was no stop of its own, and it lasted up to the next one: the pulse never fell
    rise = 4e-5
    scene = example("trapezoid", pulse_duration=rise, pulse_rise=rise, pulse_fall=rise)
    arguments = dynamics.scaled_arguments(scene, np.array([0]))
    task = dynamics.task_of(scene, "full", 1e-8)
    peaks = []
    for end in (arguments.breaks[:, 1], np.nextafter(arguments.breaks[:, 1], np.inf)):
        arguments.breaks[:, 2] = end
        answers, _ = dynamics.march_rows(arguments, task)
        peaks.append(answers["x"].max())
    assert peaks[1] == pytest.approx(peaks[0], rel=1e-9)


def test_every_function_is_compiled_in_one_form() -> None:
    """None is compiled twice, as numba does for a number that is written in a call; the values of
    series are those of approaches and of kept waves, arrays of two shapes.
    """
    solve(random_scene(1, 1))
    for module in (events, faces, flights, incoming, kernel, lanes, records, touch):
        for function in vars(module).values():
            if hasattr(function, "py_func") and function.overloads:
                forms = 2 if function is events.rise_of else 1
                assert len(function.overloads) <= forms, function.__name__


@pytest.mark.parametrize("name", ["_sums", "_roots", "reach", "survey", "fit_echoes_at_a"])
def test_the_hot_loops_are_vectorised(name: str) -> None:
    """A loop that LLVM leaves scalar costs a factor of four, and nothing else would say so."""
    processor = llvmlite.binding.get_host_cpu_features()
    if not processor.get("avx"):
        pytest.skip("this processor has no wide vectors")
    signature = (numba.from_dtype(STATE), numba.int64)[: 2 if name in ("_sums", "_roots") else 1]
    settings: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "_nrt": False}
    function = getattr(lanes, name)
    if name == "_sums":
        function = function(7, 8)
    made = numba.njit(signature, **settings)(function.py_func)
    text = "\n".join(made.inspect_asm().values())
    arithmetic = r"\tv(?:add|sub|mul|div|sqrt|fn?m(?:add|sub)\d+){}\b"
    wide = len(re.findall(arithmetic.format("pd") + ".*%[yz]mm", text))
    single = len(re.findall(arithmetic.format("sd"), text))
    # beside a loop whose columns may overlap for all that LLVM knows stands a scalar copy of it
    assert wide > 2 * (single + 1), (wide, single)


def test_the_fields_of_a_lane_name_functions_that_write_them() -> None:
    modules = (events, faces, flights, incoming, kernel, lanes, records, touch)
    names = {name.lstrip("_") for module in modules for name in vars(module)} | {"records"}
    text = Path(tracked.__file__).read_text()
    fields = re.findall(r"^ +\(?\"\w+\", .*; ([a-z_, ]+)$", text[text.index("\nLANE = ") :], re.M)
    assert len(fields) > 60
    for writers in fields:
        assert set(writers.split(", ")) <= names | {"march_rows"}, writers


def test_force_imbalance_does_not_depend_on_the_tolerance() -> None:
    """Nor on how long the record goes on for a squeeze that may come: it was up to 75 % off in a
    third of such rows, where the bounds had no room for the steps of a close tolerance.  Against
    the motions, up to the first loss after the largest force.
    """
    rng = np.random.default_rng(4)
    count = 24
    trip = 10.0 ** rng.uniform(0.3, 1.0, count)
    ends = np.tile([1.0, 0.0], (count, 1))
    mu = 10.0 ** rng.uniform(-4.5, -2.5, count)
    scene = scaled_scene(mu, trip * rng.uniform(0.1, 0.5, count), np.tile(trip, (2, 1)).T, ends)
    asked = {"quantities": ("force_imbalance", "P_max", "time_to_first_loss")}
    close = solve(scene, tolerance=1e-10, **asked)
    for tolerance in (1e-5, 1e-7):
        found = solve(scene, tolerance=tolerance, **asked)
        off = relative(found.values["force_imbalance"], close.values["force_imbalance"])
        assert off.max() < 2.0 * SOLVER * tolerance
    for row in range(8):
        path = motion(scene, row, tolerance=1e-9)
        times = np.linspace(0.0, 1.01 * close.record[row], 40_001)
        forces = path.forces_at(times)
        largest = forces.max(axis=1).argmax()
        lost = largest + np.argmax(forces[largest:].min(axis=1) == 0.0)
        expected = np.abs(np.diff(forces[:lost], axis=1)).max() / close.values["P_max"][row]
        assert close.values["force_imbalance"][row] == pytest.approx(expected, rel=1e-4)


@pytest.mark.filterwarnings("ignore:outside the validity range")
@pytest.mark.parametrize("name", ["glass_bead_small_bar", "granite"])
def test_force_imbalance_of_a_study_does_not_depend_on_its_tolerance(name: str) -> None:
    """Light spheres ahead of an absorbing end: by 95 and 87 % it did."""
    rows = {"striker.speed": np.linspace(0.3, 3.0, 12)}
    changes = ["bars.receiving_end=absorbing"]
    if name == "granite":
        changes.append("sphere.density=50 kg/m3")
    loose, close = (
        evaluate(
            load_study(f"studies/{name}.toml", [f"model.tolerance={tolerance}", *changes]),
            rows,
            quantities=("force_imbalance",),
        )["force_imbalance"]
        for tolerance in (1e-5, 1e-8)
    )
    assert relative(loose, close).max() < SOLVER * 1e-5
