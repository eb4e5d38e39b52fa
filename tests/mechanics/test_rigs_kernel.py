"""The integrator for every rig, (R3): a second integrator, balances, limits and symmetries, on
scaled scenes.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from threading import Thread
from typing import Any

import numpy as np
import pytest

from tests.independent.motion import FREE, Law, Motion, Pole, march
from uqsphere.mechanics.closed_form import solve_closed
from uqsphere.mechanics.field import field_at
from uqsphere.mechanics.history import trace
from uqsphere.mechanics.integrator import tracked
from uqsphere.mechanics.integrator.solve import (
    Task,
    look_closer,
    march_rows,
    motion,
    scaled_arguments,
    solve,
    task_of,
)
from uqsphere.mechanics.outputs import answers_from
from uqsphere.mechanics.scene import Scene

#: (R3) of one scene: mu, speed of the sphere, and of both poles zeta, mu_i, speed V_i, kappa,
#: onset, b, C, round trip and far end of a rod; a pole that is not named is free
RIGID: dict[str, float] = {
    "zeta": 0.0,
    "mu": math.inf,
    "V": 0.0,
    "kappa": 1.0,
    "onset": math.inf,
    "b": 1.0,
    "C": 1.0,
    "trip": math.inf,
    "end": 0.0,
}
Row = dict[str, Any]


def rig(mu: float = 1.0, speed: float = 0.0, A: Row | None = None, B: Row | None = None) -> Row:
    return {
        "mu": mu,
        "speed": speed,
        "poles": [None if pole is None else {**RIGID, **pole} for pole in (A, B)],
    }


def arguments(rows: list[Row]) -> tracked.Rows:
    """What the kernel takes, of scaled rigs without incoming waves."""
    n = len(rows)
    trips, ends = np.full((n, 2), np.inf), np.zeros((n, 2))
    poles = np.zeros((n, 2), tracked.POLE)
    poles["stiffness"], poles["onset"] = 1.0, math.inf
    for i, row in enumerate(rows):
        for k, pole in enumerate(row["poles"]):
            if pole is None:
                continue
            here = poles[i, k]
            here["there"], here["speed"] = 1.0, (1 - 2 * k) * pole["V"]
            here["gives"], here["lightness"] = pole["zeta"], 1.0 / pole["mu"]
            here["stiffness"], here["chi"] = pole["kappa"], 0.5
            here["onset"], here["softening"], here["pile_up"] = pole["onset"], pole["b"], pole["C"]
            trips[i, k], ends[i, k] = pole["trip"], pole["end"]
    return tracked.Rows(
        mass=np.array([row["mu"] for row in rows]),
        reflections=ends,
        round_trips=trips,
        breaks=np.zeros((n, 1)),
        coefficients=np.zeros((n, 0, 4)),
        frequencies=np.zeros(n),
        record_end=np.full(n, np.inf),
        poles=poles,
        speed=np.array([row["speed"] for row in rows]),
    )


#: all answers of other rigs than bars
TASK = Task(
    mode=tracked.FULL,
    wanted=tracked.WANT_ALL,
    tolerance=1e-8,
    requested=1e-8,
    has_laws=True,
    rigged=True,
    stop_at_loss=False,
)


def kernel(rows: list[Row], tolerance: float = 1e-8) -> Any:
    task = replace(TASK, tolerance=tolerance, requested=tolerance)
    answers, _ = march_rows(arguments(rows), task)
    return answers


def second(row: Row, rtol: float = 1e-12, **record: Any) -> Motion:
    poles = [
        Pole()
        if pole is None
        else Pole(
            gives=pole["zeta"],
            mass=pole["mu"],
            speed=pole["V"],
            law=Law(onset=pole["onset"], b=pole["b"], pile_up=pole["C"], stiffness=pole["kappa"]),
            trip=pole["trip"],
            end=pole["end"],
        )
        for pole in row["poles"]
    ]
    return march(row["mu"], row["speed"], (poles[0], poles[1]), rtol=rtol, **record)


SCENES = {
    "thick": rig(speed=1.0, B={}),
    "plate": rig(speed=1.0, B={"zeta": 0.5}),
    "mass": rig(mu=1.5, speed=1.0, B={"mu": 3.0}),
    "chatter": rig(mu=1 / 7, A={"mu": 1.0, "V": 1.0}, B={"kappa": 0.072}),
    "load cell": rig(mu=0.0206, A={"mu": 1.0, "V": 1.0}, B={"zeta": 0.14, "kappa": 1.18}),
    "anvil": rig(mu=0.3, A={"mu": 1.0, "V": 1.0}, B={"mu": 5.0, "kappa": 3.0}),
    "plate yields": rig(speed=1.0, B={"zeta": 0.2, "onset": 0.15, "b": 3.0, "C": 2.0}),
    "one face yields": rig(
        mu=0.05, A={"mu": 1.0, "V": 1.0, "onset": 0.1, "b": 2.0, "C": 8 / 3}, B={"zeta": 0.1}
    ),
    "both yield": rig(
        mu=0.2,
        A={"mu": 1.0, "V": 1.0, "onset": 0.2, "b": 0.0, "C": 1.0},
        B={"kappa": 0.5, "onset": 0.3, "b": 3.69, "C": 8 / 3},
    ),
}


@pytest.mark.parametrize("row", SCENES.values(), ids=SCENES)
def test_a_second_integrator_of_another_method_agrees(row: Row) -> None:
    (answers,), other = kernel([row]), second(row)
    assert answers["status"] == 0
    for k, pole in enumerate(other.poles):
        if pole.law is not None:
            at = other.peak(lambda rows, k=k: rows[2 + k])[1]
            assert answers["x"][k] == pytest.approx(at[k], rel=1e-7)
            assert answers["other"][k] == pytest.approx(at[3 - k], abs=1e-6)
            assert answers["carried"][k] * pole.gives == pytest.approx(other.state[5 + k], rel=1e-7)
    mean = other.top(lambda rows: 0.5 * (rows[2] + rows[3]))
    assert answers["mean_force"] == pytest.approx(mean, rel=1e-7)
    assert answers["duration"] == pytest.approx(other.state[7:9].mean() / mean, rel=1e-7)
    difference = other.top(lambda rows: np.abs(rows[2] - rows[3]))
    assert answers["difference"] == pytest.approx(difference, rel=1e-7)
    assert answers["contact"] == pytest.approx(other.first_loss, rel=1e-7)
    assert answers["parting"] == pytest.approx(other.end, rel=2e-7)
    speeds = np.array([answers["sphere_speed"], *answers["end_speed"]])
    assert speeds == pytest.approx(other.state[2:5], abs=1e-7)


STEEL = {"E": 210e9, "nu": 0.3, "density": 7850.0}


@pytest.mark.parametrize("end", [1.0, -1.0, 0.4])
@pytest.mark.parametrize("kind", ["impact", "load_cell"])
def test_echoes_of_a_rod_agree_with_a_second_integrator(kind: str, end: float) -> None:
    """Waves that come back while the sphere is pressed, many times: (R3) as an equation with
    delay.
    """
    table = "target" if kind == "impact" else "rod"
    numbers = {"sphere.E": 60e9, "sphere.nu": 0.25, "sphere.radius": 0.01, "sphere.density": 2600.0}
    numbers |= {
        f"{table}.{key}": value
        for key, value in (STEEL | {"diameter": 0.02, "length": 0.04, "end": end}).items()
    }
    if kind == "impact":
        numbers |= {"rig.speed": 3.0}
    else:
        numbers |= {
            f"hammer.{key}": value for key, value in (STEEL | {"mass": 0.05, "speed": 2.0}).items()
        }
    scene = Scene(
        columns={key: np.array([value]) for key, value in numbers.items()},
        rig=kind,
        options={"target.kind": "bar"} if kind == "impact" else {},
        horizon=4e-4,
    )
    found = motion(scene, 0, tolerance=1e-10)
    scales, rod = scene.scales, scene.partners[1]
    behind, unit = scene.partners[0], float(scales.time[0])
    ahead = Pole(
        gives=float(scales.force[0] / (rod.impedance[0] * scales.speed[0])),
        end=end,
        trip=float(rod.round_trip[0]) / unit,
        law=Law(stiffness=float(rod.hertz_constant[0] / scales.hertz_constant[0])),
    )
    weight = (
        Pole()
        if behind is None
        else Pole(
            law=Law(),
            speed=1.0,
            mass=float(behind.mass[0] * scales.speed[0] / (scales.force[0] * unit)),
        )
    )
    other = march(
        float(scales.mass_number[0]),
        1.0 if behind is None else 0.0,
        (weight, ahead),
        stop="end",
        jumps=np.arange(ahead.trip, found.end, ahead.trip).tolist(),
        record=found.end,
    )
    largest = [other.top(lambda rows, k=k: rows[2 + k]) for k in (0, 1)]
    times = np.linspace(0.0, found.horizon, 20_001)
    pushes = found.forces_at(times).max(axis=0) / scales.force[0]
    assert pushes == pytest.approx(np.array(largest), rel=2e-6)
    at_end = found.states_at(np.array([found.horizon]))[0]
    units = np.array([scales.approach[0], scales.approach[0], scales.speed[0]])
    kept = slice(1 if behind is None else 0, 3)
    assert (at_end / units)[kept] == pytest.approx(other.state[:3][kept], abs=2e-7)
    answers = solve(scene, tolerance=1e-9, quantities=("time_to_first_loss", "P_max"))
    # a sphere that leaves a rod with a free end once is not met again: the record ends there
    first_loss = other.first_loss if other.losses else found.end
    assert answers.values["time_to_first_loss"][0] == pytest.approx(first_loss * unit, rel=1e-7)
    assert answers.values["P_max"][0] == pytest.approx(max(largest) * scales.force[0], rel=2e-6)


def test_the_record_of_a_rod_goes_on_until_its_echo_has_acted() -> None:
    """Both gaps, 72 and 23 um, are open when the fixed end's echo arrives, and closed by it.

    145.89 N by this integrator and by two others (spectral collocation; Runge and Kutta's method
    with stored waves); a record that ended as the echo arrived had 99.44 N.
    """
    numbers = {
        "sphere.E": 21.571890e9,
        "sphere.nu": 0.2663573,
        "sphere.density": 3770.6199,
        "sphere.radius": 2.01585768e-3,
        "hammer.E": 110.408936e9,
        "hammer.nu": 0.3,
        "hammer.mass": 28.5177243e-3,
        "hammer.speed": 0.815950944,
        "rod.E": 19.568113e9,
        "rod.nu": 0.28,
        "rod.density": 5196.7146,
        "rod.diameter": 4.46724274e-3,
        "rod.length": 3.94736107,
        "rod.end": -1.0,
    }
    scene = Scene(
        columns={name: np.array([value]) for name, value in numbers.items()}, rig="load_cell"
    )
    found = solve(scene, tolerance=1e-8, quantities=("P_max", "loaded_time"))
    assert found.values["P_max"][0] == pytest.approx(145.89, rel=5e-5)
    # the echo comes after 4.0684 ms; its largest force follows at 4.2893 ms
    assert found.values["loaded_time"][0] > 4.2893e-3
    assert found.record[0] >= found.values["loaded_time"][0] + 2.0 * scene.round_trips[0, 1]


@pytest.mark.parametrize(
    "row",
    [
        rig(mu=0.02, A={"mu": 1.0, "V": 1.0}, B={"zeta": 1.5, "trip": 60.0, "end": -1.0}),
        rig(mu=0.3, A={"mu": 1.0, "V": 1.0}, B={"zeta": 0.8, "trip": 15.0, "end": -0.9}),
        rig(mu=1.0, speed=1.0, B={"zeta": 1.2, "trip": 12.0, "end": -1.0}),
        rig(mu=1.0, speed=1.0, B={"zeta": 0.7, "trip": 9.0, "end": -0.4}),
        rig(mu=0.3, A={"mu": 1.0, "V": 1.0}, B={"zeta": 0.8, "trip": 15.0, "end": 1.0}),
        # the sphere follows the rod, whose free end holds the gap open
        rig(mu=0.02, A={"mu": 1.0, "V": 1.0}, B={"zeta": 0.14, "trip": 2.6, "end": 1.0}),
        rig(mu=0.3, A={"mu": 1.0, "V": 1.0}, B={"zeta": 0.5, "trip": 1.0, "end": 1.0}),
    ],
)
def test_nothing_follows_the_record_of_a_rod(row: Row) -> None:
    """Against a second integrator, which follows the bodies for eight more round trips."""
    found = kernel([row])[0]
    pole = row["poles"][1]
    record = float(found["ended"]) + 8.0 * pole["trip"]
    jumps = np.arange(pole["trip"], record, pole["trip"]).tolist()
    other = second(row, stop="end", record=record, jumps=jumps)
    for k, one in enumerate(other.poles):
        if one.law is not None:
            largest = other.top(lambda rows, k=k: rows[k])
            assert found["x"][k] == pytest.approx(largest, rel=1e-7)
    impulse = other.state[7:9].mean() / found["mean_force"]
    assert found["duration"] == pytest.approx(impulse, rel=1e-6)


@pytest.mark.parametrize(
    "row",
    [
        rig(mu=0.3, A={"mu": 1.0, "V": 1.0}, B={"zeta": 0.8, "trip": 2.6, "end": 0.7}),
        rig(mu=0.02, A={"mu": 1.0, "V": 1.0}, B={"zeta": 0.5, "trip": 2.6, "end": 0.5}),
    ],
)
def test_a_gap_that_echoes_hold_open_for_a_time_is_closed_in_the_end(row: Row) -> None:
    """The rod comes to rest, and the sphere that follows it strikes it again after ten round trips;
    against a second integrator, which goes through all of them.
    """
    found = kernel([row])[0]
    trip = row["poles"][1]["trip"]
    assert found["parting"] > found["contact"] + 8.0 * trip
    record = float(found["parting"]) + 2.0 * trip
    jumps = np.arange(trip, record, trip).tolist()
    other = second(row, 1e-10, stop="end", record=record, jumps=jumps)
    speeds = np.array([found["sphere_speed"], *found["end_speed"]])
    assert speeds == pytest.approx(other.state[2:5], abs=1e-6)
    last = [
        piece.times[0]
        for piece in other.pieces
        if all(law is None or law.state == FREE for law in piece.laws)
    ]
    pressed = [piece for piece in other.pieces if piece.times[0] < last[-1]]
    before = found["parting"] * (1.0 - 1e-6)
    assert max(piece.times[-1] for piece in pressed) >= before
    for k in (0, 1):
        assert found["x"][k] == pytest.approx(other.top(lambda rows, k=k: rows[k]), rel=1e-7)


def test_a_flight_of_a_million_round_trips_takes_few_steps() -> None:
    """Far ends that lose little of a wave hold a gap open for long; a free one may for ever."""
    ends = (1.0, 1.0 - 1e-9, 1.0 - 1e-6, 1.0 - 1e-4, 0.99, 0.9, -0.9, -1.0)
    weight = {"mu": 1.0, "V": 1.0}
    rows = [
        rig(mu=mu, A=weight, B={"zeta": zeta, "trip": trip, "end": end})
        for mu, zeta, trip, end in itertools.product(
            (0.02, 0.3), (0.14, 0.5), (0.5, 1.0, 2.6, 3.1), ends
        )
    ]
    found = kernel(rows, 1e-4)
    assert (found["status"] == tracked.OK).all()
    assert found["steps"].max() < 1e-3 * found["parting"].max()


def test_the_largest_values_of_a_light_sphere_on_a_rod_need_not_wait_until_it_rests() -> None:
    """Trapped between hammer and rod it is pressed again and again, ever more softly: nothing but
    its end would take a million steps, and more than there are.
    """
    weight = {"mu": 1.0, "V": 1.0}
    numbers = ((0.2455, 1.615, 0.3473), (0.0095, 1.886, 0.3198), (0.05, 1.7, 0.575))
    rows = [
        rig(mu=mu, A=weight, B={"zeta": zeta, "trip": trip, "end": 0.9, "kappa": 1.18})
        for mu, zeta, trip in numbers
    ]
    peaks = tracked.WANT_DIFFERENCE | tracked.WANT_ENERGY | tracked.WANT_MEAN
    found, _ = march_rows(arguments(rows), replace(TASK, tolerance=1e-6, wanted=peaks))
    assert (found["status"] == tracked.OK).all()
    # the last one parts within a few thousand steps
    whole = kernel(rows[2:], 1e-6)
    assert found["steps"][2] < 0.5 * whole["steps"][0]
    for name in ("x", "difference", "stored", "mean_force"):
        assert found[name][2].tolist() == whole[name][0].tolist()


def test_the_time_to_parting_of_a_rod_does_not_go_by_the_tolerance() -> None:
    # a sphere that an echo leaves next to no speed meets the rod again after thousands of round
    # trips: 760 t_c at one look with 1e-6, 18,613 with 1e-8
    ahead = {"zeta": 2.275769, "kappa": 9.429947, "trip": 4.223297, "end": 0.546734}
    row = arguments([rig(mu=0.4858285, A={"mu": 1.0, "V": 1.0}, B=ahead)])
    task = replace(TASK, wanted=tracked.WANT_CONTACT)
    found, closer = (look_closer(row, replace(task, tolerance=each))[0] for each in (1e-6, 1e-9))
    assert found["regained"] > 0.0
    assert found["parting"] == pytest.approx(closer["parting"], rel=1e-5)
    assert found["grazes"] == 0.0


def test_largest_values_end_a_record_whose_weight_has_gone_for_good() -> None:
    # a heavy sphere stays pressed to the rod for 64 round trips, the weight has sprung back
    ahead = {"zeta": 1.684359, "kappa": 0.0470224, "trip": 10.010469, "end": 0.546667}
    row = arguments([rig(mu=9.49954, A={"mu": 1.0, "V": 1.0}, B=ahead)])
    peaks, _ = march_rows(row, replace(TASK, tolerance=1e-6, wanted=0))
    whole, _ = march_rows(row, replace(TASK, tolerance=1e-6, wanted=tracked.WANT_CONTACT))
    assert peaks["x"].tolist() == whole["x"].tolist()
    assert peaks["ended"][0] < 0.1 * whole["ended"][0]


@pytest.mark.parametrize("end", [0.97, 0.9999, 1.0 - 1e-6])
def test_the_history_of_a_rod_passes_round_trips_without_contact_as_its_answers_do(
    end: float,
) -> None:
    """Up to a million of them; the gap follows the sphere and the end of the rod all the while, as
    the waves in the rod have it.
    """
    numbers = {
        "sphere.E": 95e9,
        "sphere.nu": 0.08,
        "sphere.density": 2650.0,
        "sphere.radius": 5e-3,
        "hammer.E": 208e9,
        "hammer.nu": 0.29,
        "hammer.mass": 67e-3,
        "hammer.speed": 1.98,
        "rod.E": 208e9,
        "rod.nu": 0.29,
        "rod.density": 7850.0,
        "rod.diameter": 20e-3,
        "rod.length": 0.29,
        "rod.end": end,
    }
    scene = Scene(
        columns={name: np.array([value]) for name, value in numbers.items()}, rig="load_cell"
    )
    course = trace(scene, tolerance=1e-8, points=50)
    # a history is one look: closer ones move the parting of a sphere that next to nothing moves
    task = replace(task_of(scene, "full", 1e-8), requested=1e-8)
    look, _ = march_rows(scaled_arguments(scene, np.array([0])), task)
    found = answers_from(scene, tracked.answer_columns(look), linear=False, quantities=None)
    assert course.horizon == pytest.approx(found.record[0], rel=1e-7)
    assert course.horizon > 100.0 * scene.first_echo[0]
    assert len(course.motion.start) < 1000
    lost = [change.time for change in course.changes if change.kind == "lost"]
    assert max(lost) == pytest.approx(found.values["loaded_time"][0], rel=1e-7)
    # behind the joints of steps and waves, one after the other round trip and beside each other
    early = np.linspace(0.0, 20.0 * scene.first_echo[0], 200)
    at = np.sort(np.concatenate([early, np.linspace(0.0, 0.99 * course.horizon, 200)])) + 1e-8
    step = 1e-9
    ahead, behind = (course.motion.states_at(at + way * step)[:, 1] for way in (1.0, -1.0))
    closing = course.motion.states_at(at)[:, 2] - field_at(course.motion, "receiving", 0.0, at)[1]
    assert (ahead - behind) / (2.0 * step) == pytest.approx(closing, abs=1e-4)


@pytest.mark.parametrize(
    "row",
    [
        # no time passes between two echoes, a force has no scale, yielding begins at once
        rig(speed=1.0, B={"zeta": 1.0, "trip": 0.0, "end": 1.0}),
        rig(speed=1.0, B={"kappa": math.inf}),
        rig(speed=1.0, B={"onset": 0.0, "b": 2.0, "C": 2.0}),
        # a series that is no number
        rig(mu=0.0, speed=1.0, B={}),
        rig(mu=math.nan, speed=1.0, B={}),
        rig(speed=1e300, B={}),
    ],
)
def test_a_lane_that_cannot_take_its_step_is_given_up(row: Row) -> None:
    """It tried for ever, or had an approach of zero; the rows beside it keep their answers."""
    whole = rig(speed=1.0, B={"zeta": 0.5})
    answers: list[Any] = []
    given_up = Thread(target=lambda: answers.extend(kernel([whole, row, whole])), daemon=True)
    given_up.start()
    given_up.join(60.0)
    assert not given_up.is_alive()
    assert [answer["status"] for answer in answers] == [tracked.OK, tracked.STUCK, tracked.OK]
    assert np.isnan(answers[1]["x"]).all()
    assert answers[0]["x"].tolist() == answers[2]["x"].tolist() == kernel([whole])[0]["x"].tolist()


def test_the_bodies_never_close() -> None:
    found = kernel([rig(speed=-1.0, B={}), rig(A={"mu": 1.0}, B={}), rig(speed=1.0, B={"V": 2.0})])
    assert found["status"].tolist() == [tracked.NEVER_CLOSES] * 3


def test_a_record_that_ends_while_pressed_has_no_answer() -> None:
    given = arguments([rig(speed=1.0, B={})])
    given.record_end[:] = 1.0
    answers, _ = march_rows(given, replace(TASK, tolerance=1e-6))
    assert answers["status"][0] == tracked.STILL_PRESSED


def random_rigs(count: int, seed: int) -> list[Row]:
    """Weights, free spheres and yielding faces of every kind, without order."""
    rng = np.random.default_rng(seed)
    rows = []
    for _ in range(count):
        poles = []
        for _ in range(2):
            pole = {**RIGID, "kappa": 10.0 ** rng.uniform(-1, 1)}
            if rng.random() < 0.5:
                ratio = rng.uniform(1.3, 4.0)
                pole |= {"onset": 10.0 ** rng.uniform(-2, 0), "C": 2.0, "b": 2.0 * ratio - 1.0}
            pole |= [
                {},
                {"zeta": 10.0 ** rng.uniform(-2, 0)},
                {"mu": 10.0 ** rng.uniform(-0.5, 2)},
            ][rng.integers(3)]
            poles.append(pole)
        if rng.random() < 0.3:
            rows.append(rig(speed=1.0, mu=1.0, B=poles[1]))
        else:
            rows.append(
                rig(
                    mu=10.0 ** rng.uniform(-2, 1),
                    A={**poles[0], "mu": 1.0, "zeta": 0.0, "V": 1.0},
                    B=poles[1],
                )
            )
    return rows


def test_energy_and_momentum_of_random_rigs() -> None:
    """(R8) and (R9): what the bodies lose is carried off or is plastic; nothing is stored after
    parting.
    """
    rows, tolerance = random_rigs(500, 3), 1e-7
    found = kernel(rows, tolerance)
    assert (found["status"] == 0).all()
    for row, answers in zip(rows, found, strict=True):
        speeds = np.array([answers["sphere_speed"], *answers["end_speed"]])
        before = np.array(
            [row["speed"], *(0.0 if pole is None else pole["V"] for pole in row["poles"])]
        )
        masses = [row["mu"], *(math.inf if pole is None else pole["mu"] for pole in row["poles"])]
        lost, change = 0.0, 0.0
        for mass, old, new in zip(masses, before, speeds, strict=True):
            if mass < math.inf:
                lost += 0.5 * mass * (old * old - new * new)
                change += mass * (new - old)
        for k, pole in enumerate(row["poles"]):
            if pole is not None:
                law = Law(
                    onset=pole["onset"], b=pole["b"], pile_up=pole["C"], stiffness=pole["kappa"]
                )
                lost -= pole["zeta"] * answers["carried"][k]
                deepest = answers["x"][k]
                if deepest > pole["onset"]:
                    law.unload(deepest)
                    lost -= law.energy(law.dent)
        assert abs(lost) < 10.0 * tolerance
        if all(
            pole is None or (pole["mu"] < math.inf and pole["zeta"] == 0.0) for pole in row["poles"]
        ):
            assert abs(change) < 10.0 * tolerance


def test_mirrored_rigs_have_mirrored_answers() -> None:
    for row in random_rigs(12, 5):
        mirror = {
            **row,
            "speed": -row["speed"],
            "poles": [pole and {**pole, "V": -pole["V"]} for pole in row["poles"]],
        }
        mirror["poles"].reverse()
        one, other = kernel([row, mirror], 1e-7)
        for name in ("x", "carried", "other"):
            assert one[name] == pytest.approx(other[name][::-1], rel=1e-9, abs=1e-12)
        for name in ("contact", "parting", "stored", "mean_force"):
            assert one[name] == pytest.approx(other[name], rel=1e-8)
        assert one["sphere_speed"] == pytest.approx(-other["sphere_speed"], abs=1e-9)


def test_blows_that_yield_agree_with_their_closed_form() -> None:
    """300 spheres on thick metals, most of them far beyond yield, against (R23) with its own
    quadrature of times.
    """
    draw = np.random.default_rng(7)
    columns = {
        "sphere.E": 10.0 ** draw.uniform(9.5, 11.6, 300),
        "sphere.nu": draw.uniform(0.05, 0.4, 300),
        "sphere.radius": 10.0 ** draw.uniform(-3.5, -1.3, 300),
        "sphere.density": draw.uniform(1e3, 8e3, 300),
        "target.E": 10.0 ** draw.uniform(9.5, 11.7, 300),
        "target.nu": draw.uniform(0.1, 0.4, 300),
        "target.yield_strength": 10.0 ** draw.uniform(8.0, 9.7, 300),
        "rig.speed": 10.0 ** draw.uniform(-2.0, 2.0, 300),
    }
    scene = Scene(columns=columns, rig="impact", contact_law="plastic")
    asked = (
        "P_max",
        "p_max",
        "time_to_first_loss",
        "rise_time",
        "energy",
        "restitution",
        "a_max",
        "contact_duration",
    )
    closed, found = (
        solve_closed(scene, quantities=asked),
        solve(scene, tolerance=1e-6, quantities=asked),
    )
    assert (closed.status == 0).all()
    assert (found.status == 0).all()
    for name in asked:
        np.testing.assert_allclose(found.values[name], closed.values[name], rtol=3e-6, err_msg=name)
