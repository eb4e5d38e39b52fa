"""The design of a test: closed forms, single scenes computed directly, what binds, the command."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
import pytest

import uqsphere
from uqsphere.cli import main
from uqsphere.mechanics.bars import wave_speed
from uqsphere.mechanics.closed_form import loading_time
from uqsphere.mechanics.design import (
    CONSTRAINTS,
    Rig,
    binding,
    break_on_ramp,
    first_return,
    ramp_scene,
    shortest_striker,
    usages,
)
from uqsphere.mechanics.history import trace
from uqsphere.mechanics.outputs import Path as LoadingPath
from uqsphere.mechanics.scene import Scene
from uqsphere.planning import Plan, judge_points, plan_blow, plan_test, request_of, subject_of
from uqsphere.study import Study, load_study

EXACT, SOLVER = 1e-12, 2e-4
STUDIES = Path(uqsphere.__file__).parent.parent / "studies"
GRANITE = STUDIES / "granite_10mm_test.toml"
#: a second way to break, by about the same force
CORE = ('limits.core={criterion="core_tension", strength={dist="weibull", mean="32 MPa", modulus=10}}',)
FORCE = [LoadingPath(over="force")]
Array = npt.NDArray[np.float64]


def force_at_pressure(pressure: float, modulus: float, radius: float) -> float:
    """Hertz: p_0 = (6 P E*²/(pi³ r²))^(1/3), solved for P."""
    return math.pi**3 * radius**2 * pressure**3 / (6.0 * modulus**2)


def columns(count: int = 1, **changed: Any) -> dict[str, Array]:
    """Granite of 10 mm between steel bars of 20 mm, `count` rows."""
    values = {"sphere.E": 52e9, "sphere.nu": 0.25, "sphere.radius": 0.005, "sphere.density": 2650.0, "bars.E": 210e9,
              "bars.nu": 0.3, "bars.density": 7850.0, "bars.diameter": 0.02, "striker.speed": 1.0,
              "bars.yield_strength": 2e9, **changed}  # fmt: skip
    return {name: np.broadcast_to(np.asarray(value, dtype=float), (count,)) for name, value in values.items()}


# --- closed forms ---------------------------------------------------------------------------------


def test_a_massless_sphere_under_a_step_breaks_when_the_closed_form_says() -> None:
    speeds = np.array([0.5, 1.0, 4.0])
    scene = ramp_scene(columns(3, **{"striker.speed": speeds}), np.zeros(3))
    strengths = np.array([[800.0], [1400.0]])
    found = break_on_ramp(scene, ["P_max"], FORCE, strengths, fidelity="massless", tolerance=1e-9)
    share = strengths[:, 0] / scene.scales.force[:, None]
    time = scene.scales.time[:, None] * loading_time(share ** (2.0 / 3.0))
    np.testing.assert_allclose(found.time, time, rtol=1e-7)
    np.testing.assert_allclose(found.force, np.broadcast_to(strengths[:, 0], (3, 2)), rtol=1e-7)
    assert np.abs(found.imbalance).max() == 0.0
    speed = wave_speed(210e9, 7850.0)
    np.testing.assert_allclose(shortest_striker(scene, found, 0.0), 0.5 * speed * time, rtol=1e-7)
    used = usages(scene, found, Rig(length=0.1, first_return=1e-4))
    np.testing.assert_allclose(used["reflection"], time / 1e-4, rtol=1e-7)
    np.testing.assert_allclose(used["length"], speed * time / 0.2, rtol=1e-7)
    # followed to 12 t_c a step has built up all of P_0 but some 1e-8
    np.testing.assert_allclose(used["speed"], share, rtol=1e-7)


def test_a_light_sphere_breaks_like_a_massless_one() -> None:
    scene = ramp_scene(columns(1, **{"sphere.density": 0.01}), np.zeros(1))
    found = break_on_ramp(scene, ["P_max"], FORCE, np.array([[3e3]]), tolerance=1e-8)
    share = float(3e3 / scene.scales.force[0])
    time = float(scene.scales.time[0] * loading_time(share ** (2.0 / 3.0)))
    assert found.time[0, 0] == pytest.approx(time, rel=1e-3)
    assert found.imbalance[0, 0] < 0.02


def test_bounds_that_follow_from_the_speed_alone() -> None:
    speeds = np.array([20.0, 60.0, 150.0])
    scene = ramp_scene(columns(3, **{"striker.speed": speeds}), np.full(3, 20e-6))
    used = usages(scene, break_on_ramp(scene, ["P_max"], FORCE, np.array([[2e3]])), Rig(length=0.4, round_trip=4e-4))
    Z = math.sqrt(210e9 * 7850.0)
    np.testing.assert_allclose(used["pulse_yield"][:, 0], 0.5 * Z * speeds / 2e9, rtol=EXACT)
    end = 0.8 / wave_speed(210e9, 7850.0) + 10e-6
    np.testing.assert_allclose(used["striker"][:, 0], end / 4e-4, rtol=EXACT)
    modulus, radius = scene.scales.modulus[0], 0.005
    onset = force_at_pressure(1.295 * math.exp(0.736 * 0.3) * 2e9, modulus, radius)
    np.testing.assert_allclose(used["contact_yield"] ** 3, 2e3 / onset, rtol=1e-6)
    # a law of the contact that has the dent is no bound on it
    breaks = break_on_ramp(scene, ["P_max"], FORCE, np.array([[2e3]]))
    dented = usages(scene, breaks, Rig(length=0.4, round_trip=4e-4, dents=True))
    assert np.isnan(dented["contact_yield"]).all()


def test_a_stiffer_striker_makes_a_stronger_pulse_and_stays_longer() -> None:
    steel, heavy = columns(), {**columns(), "striker.E": np.array([400e9]), "striker.density": np.array([15000.0])}
    used = {}
    for name, given in (("same", steel), ("heavy", heavy)):
        scene = ramp_scene(given, np.zeros(1))
        breaks = break_on_ramp(scene, ["P_max"], FORCE, np.array([[2e3]]))
        used[name] = usages(scene, breaks, Rig(length=0.4, round_trip=4e-4))
    ratio = math.sqrt(400e9 * 15000.0 / (210e9 * 7850.0))
    assert used["heavy"]["pulse_yield"] == pytest.approx(used["same"]["pulse_yield"] * 2.0 * ratio / (1.0 + ratio))
    assert used["heavy"]["speed"] == pytest.approx(used["same"]["speed"] * (1.0 + ratio) / (2.0 * ratio), rel=2e-2)
    assert used["heavy"]["striker"] > 2.0 * used["same"]["striker"]


def test_what_binds_is_what_is_used_most() -> None:
    used = {name: np.full((1, 3), 0.1) for name in CONSTRAINTS}
    used["equilibrium"] = np.array([[0.9, 1.2, np.nan]])
    used["speed"] = np.array([[0.5, 0.5, 1.3]])
    used["striker"] = np.array([[0.2, 1.1, 7.0]])
    binds, kept = binding(used)
    assert [list(CONSTRAINTS)[k] for k in binds[0]] == ["equilibrium", "equilibrium", "speed"]
    assert kept.tolist() == [[True, False, False]]
    used["speed"] = np.full((1, 3), np.nan)
    assert binding(used)[0].tolist() == [[-1, -1, -1]]
    assert not binding(used)[1].any()


def test_an_end_that_absorbs_returns_nothing() -> None:
    lengths = {"bars.incident_length": 2.0, "bars.receiving_length": 1.0, "striker.length": 0.4}
    ends = {"bars.incident_end": 1.0, "bars.receiving_end": 0.0}
    speed = float(wave_speed(210e9, 7850.0))
    real = Scene(columns=columns(**lengths, **ends))
    assert first_return(real) == pytest.approx((4.0 / speed, 4.0 / speed))
    assert first_return(Scene(columns=columns(**lengths), infinite=True))[0] == pytest.approx(2.0 / speed)
    assert first_return(Scene(columns=columns(**{"striker.length": 0.4}), infinite=True)) == (math.inf, math.inf)


# --- single scenes, computed directly -------------------------------------------------------------


def load(*overrides: str) -> Study:
    return load_study(GRANITE, list(overrides))


@pytest.fixture(scope="module")
def plan() -> Plan:
    study = load()
    return plan_test(study, request_of(study, speeds=(0.3, 8.0), rises=(0.0, 80e-6), grid=(30, 9), lengths=(0.4, 1.0)))


def directly(found: Plan, speed: float, rise: float, length: float, place: int) -> tuple[float, float, float]:
    """Time, imbalance and first return of the real scene: its finite pulse, its bars with reflections, traced.

    The time is that at which the larger force first comes to the strength, infinite where it does not.
    """
    subject = found.subject
    given = {**subject.columns, "striker.speed": speed, "striker.length": length, "pulse.rise": rise}
    scene = Scene(columns={name: np.array([value]) for name, value in given.items()}, shape="ramp",
                  first_loading_only=True)  # fmt: skip
    course = trace(scene, 0, tolerance=1e-7, points=5001)
    strength = subject.strengths[place, 0]
    level = force_at_pressure(strength, scene.scales.modulus[0], scene.scales.effective_radius[0])
    larger = np.maximum(course.force_a, course.force_b)
    above = np.flatnonzero(larger >= level)
    if len(above) == 0:
        return math.inf, math.nan, float(scene.first_echo[0])
    k = int(above[0])
    share = (level - larger[k - 1]) / (larger[k] - larger[k - 1])
    apart = [abs(course.force_a[j] - course.force_b[j]) for j in (k - 1, k)]
    time = course.time[k - 1] + share * (course.time[k] - course.time[k - 1])
    return float(time), float((apart[0] + share * (apart[1] - apart[0])) / level), float(scene.first_echo[0])


def keeps(found: Plan, speed: float, rise: float, length: float, place: int) -> bool:
    """Whether a scene computed directly keeps reflection, length, equilibrium and speed; its bars are elastic here."""
    time, apart, back = directly(found, speed, rise, length, place)
    c = found.subject.columns
    pulse_falls = 2.0 * length / float(wave_speed(c["bars.E"], c["bars.density"])) + 0.5 * rise
    return time < min(back, pulse_falls) and apart <= found.request.level


def test_edges_of_the_window_are_where_single_scenes_change(plan: Plan) -> None:
    tried = 0
    for chart in plan.charts:
        for window in chart.windows:
            if window.rise not in plan.listed[::2] or window.kind != "quantile":
                continue
            for speed, name, outwards in ((window.low, window.below, 0.995), (window.high, window.above, 1.005)):
                if name is None:
                    continue
                tried += 1
                at = (window.rise, chart.length, plan.subject.place)
                assert keeps(plan, speed / outwards, *at), (window, chart.length)
                assert not keeps(plan, speed * outwards, *at), (window, chart.length)
    assert tried >= 6


def test_points_of_the_map_are_single_scenes(plan: Plan) -> None:
    tried = {"kept": 0, "broken": 0}
    for r, s, place in ((0, 4, 9), (0, 18, 9), (4, 18, 0), (4, 24, 18), (8, 10, 9), (8, 22, 18), (2, 28, 0)):
        time, apart, _ = directly(plan, plan.speeds[s], plan.rises[r], 0.4, place)
        if math.isfinite(time):
            tried["broken"] += 1
            assert plan.breaks.time[r, s, place] == pytest.approx(time, rel=SOLVER)
            assert plan.breaks.imbalance[r, s, place] == pytest.approx(apart, abs=5e-4)
        kept = bool(plan.charts[0].kept[r, s, place])
        tried["kept"] += kept
        assert kept == keeps(plan, plan.speeds[s], plan.rises[r], 0.4, place)
    assert tried["broken"] >= 4
    assert 1 <= tried["kept"] <= 6


def test_the_least_striker_is_just_long_enough(plan: Plan) -> None:
    r, s, place = 4, 16, plan.subject.place
    least = float(plan.shortest[r, s, place])
    time, _, _ = directly(plan, plan.speeds[s], plan.rises[r], 1.001 * least, place)
    assert time == pytest.approx(plan.breaks.time[r, s, place], rel=SOLVER)
    short, _, _ = directly(plan, plan.speeds[s], plan.rises[r], 0.9 * least, place)
    assert short == math.inf


def test_a_ramp_opens_what_a_step_leaves_narrow(plan: Plan) -> None:
    def widest(rise: float) -> float:
        of = [w.high / w.low for w in plan.charts[1].windows if w.kind == "quantile" and w.rise == rise]
        return max(of, default=1.0)

    assert widest(float(plan.rises[-2])) > 2.0 * widest(0.0)
    # under a step the forces are in balance near 1 m/s alone; under a ramp far beyond, and for the batch as well
    request = request_of(load(), lengths=(1.0,))
    speeds = np.array([0.8, 0.95, 1.2, 1.5, 3.2, 5.0, 1.5, 3.0, 5.0])
    _, _, (used,) = judge_points(plan.subject, request, speeds, np.repeat([0.0, 80e-6], [6, 3]))
    kept = binding(used)[1]
    assert kept[:, plan.subject.place].tolist() == [False, True, True, True, False, False, True, True, True]
    assert kept[6:][:, plan.subject.batch].all()


def test_windows_of_the_batch_hold_for_every_specimen_of_it(plan: Plan) -> None:
    windows = [(k, w) for k, chart in enumerate(plan.charts) for w in chart.windows if w.kind == "batch"]
    ends = np.array([(w.low, w.high) for _, w in windows]).ravel()
    _, _, judged = judge_points(plan.subject, plan.request, ends, np.repeat([w.rise for _, w in windows], 2))
    whole = [binding(used)[1][:, plan.subject.batch].all(axis=1).reshape(-1, 2) for used in judged]
    assert len(windows) > 3
    assert all(whole[k][n].all() for n, (k, _) in enumerate(windows))


def test_a_tighter_balance_and_a_shorter_striker_keep_less(plan: Plan) -> None:
    short, long = plan.charts
    others = list(CONSTRAINTS).index("striker")
    assert np.all(long.kept | ~short.kept | (long.binds == others))
    assert long.kept.sum() > short.kept.sum()
    request = request_of(load(), speeds=(0.3, 8.0), rises=(0.0, 80e-6), lengths=(1.0,), level=0.05)
    speeds, rises = (axis.ravel() for axis in np.meshgrid(plan.speeds, plan.rises))
    _, _, (used,) = judge_points(plan.subject, request, speeds, rises)
    tight = binding(used)[1].reshape(long.kept.shape)
    assert np.all(long.kept | ~tight)
    assert tight.sum() < long.kept.sum()


def test_the_earlier_of_two_limits_breaks_the_sphere() -> None:
    both, one = load(*CORE), load()
    alone = subject_of(one)
    assert subject_of(both).strengths.shape == (19, 2)
    assert alone.strengths.shape == (19, 1)
    request = request_of(both, speeds=(1.0, 2.0))
    speeds, rises = np.array([1.0, 3.0]), np.array([20e-6, 40e-6])
    _, together, _ = judge_points(subject_of(both), request, speeds, rises)
    _, contact, _ = judge_points(alone, request, speeds, rises)
    early = np.where(np.isnan(together.time), np.inf, together.time)
    assert np.all(early <= np.where(np.isnan(contact.time), np.inf, contact.time))


def test_defaults_come_from_the_study() -> None:
    request = request_of(load())
    assert request.speeds == pytest.approx((0.2, 20.0))
    assert request.lengths == (1.0,)
    assert request.rises == pytest.approx((0.0, 200e-6))
    margins = load_study(STUDIES / "granite.toml")
    assert request_of(margins).speeds == (0.05, 20.0)
    fixed = load("limits.crushing.strength=4 GPa")
    assert len(subject_of(fixed).fractiles) == 1
    assert subject_of(fixed).batch == (0,)
    assert subject_of(load(), 0.3).fractiles[subject_of(load(), 0.3).place] == 0.3


def test_a_model_factor_divides_the_strength() -> None:
    found = subject_of(load("limits.crushing.model_factor=1.25"))
    np.testing.assert_allclose(found.strengths * 1.25, subject_of(load()).strengths, rtol=EXACT)


# --- the command ----------------------------------------------------------------------------------


def test_the_command_writes_tables_figure_and_document(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = ["plan", str(GRANITE), "--speed", "0.5,50 m/s", "--rise", "0,80", "--length", "20cm,0.4", "--grid", "9x4",
             "--out", str(tmp_path), "--json"]  # fmt: skip
    assert main(given) == 0
    content = json.loads(capsys.readouterr().out)
    assert [chart["length"] for chart in content["charts"]] == [0.2, 0.4]
    assert content["speeds"][0] == pytest.approx(0.5)
    assert content["rises"][-1] == pytest.approx(80e-6)
    assert {Path(name).name for name in content["written"]} == {"plan.csv", "windows.csv", "plan-1.svg", "plan-2.svg"}
    with open(tmp_path / "plan.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 9 * 4
    chart = content["charts"][1]
    for k, row in enumerate(rows[36:]):
        r, s = divmod(k, 9)
        assert row["binding"] == chart["binding"][r][s]
        assert row["binding"] in content["constraints"]
        assert bool(int(row["kept"])) == chart["kept"][r][s]
        used = {name: float(row[f"used_{name}"]) for name in CONSTRAINTS if row[f"used_{name}"]}
        assert (max(used.values()) <= 1.0) == chart["kept"][r][s]
        if used["speed"] <= 1.0:
            assert max(used, key=lambda name: used[name]) == row["binding"]
        else:
            assert row["binding"] == "speed"
            assert row["fracture_time [s]"] == ""
    text = "".join(ElementTree.parse(tmp_path / "plan-2.svg").getroot().itertext())
    assert "striker speed [m/s]" in text
    assert "striker of 0.4 m" in text


def test_the_table_in_the_terminal_names_what_binds(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", str(GRANITE), "--grid", "12x3", "--imbalance", "0.05", "--rise", "20,60"]) == 0
    text = capsys.readouterr().out
    assert "length / equilibrium" in text
    assert f"equilibrium: {CONSTRAINTS['equilibrium']}" in text
    assert "at most 0.05 of the larger force" in text


WRONG = {
    "--speed 0,3": "above 0", "--speed 3,1": "lower above 0 and first", "--speed 1": "two values",
    "--speed 1,2,3": "two values", "--speed a,b": "--speed", "--speed 1mm,2mm": "--speed", "--speed nan,2": "--speed",
    "--rise=-1,5": "--rise", "--rise 5,5": "two values", "--length 0": "--length", "--length 1,2,3,4,5,6,7": "1 to 6",
    "--imbalance 0": "--imbalance", "--imbalance nan": "--imbalance", "--quantile 1": "--quantile",
    "--grid 60": "--grid", "--grid 1x5": "2 to 400", "--grid 9999x9999": "2 to 400", "--grid -3x5": "--grid",
}  # fmt: skip


@pytest.mark.parametrize("options", WRONG)
def test_wrong_ranges_are_refused(options: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", str(GRANITE), *options.split(" ", 1)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert WRONG[options] in printed.err


@pytest.mark.parametrize(
    ("study", "overrides", "words"),
    [
        ("ishigami", (), "black box"),
        ("as_printed", ('pulse={shape="half_sine"}',), "half_sine pulse"),
        ("granite_10mm_test", ("limits.crushing.fracture=false",), "no limit"),
        ("granite_10mm_test", ('pulse.duration="100 us"',), "--length"),
    ],
)
def test_studies_that_cannot_be_planned_are_refused(
    study: str, overrides: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    options = [word for text in overrides for word in ("--set", text)]
    assert main(["plan", str(STUDIES / f"{study}.toml"), *options]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert words in printed.err


def test_a_study_without_limits_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = GRANITE.read_text("utf-8")
    begin, end = text.index("[limits.crushing]"), text.index("[analysis]")
    path = tmp_path / "bare.toml"
    path.write_text(text[:begin] + text[end:], encoding="utf-8")
    assert main(["plan", str(path)]) == 2
    assert "give the study a limit" in capsys.readouterr().err


@pytest.mark.parametrize(("rig", "path"), [
    ('kind = "impact"\nspeed = "5 m/s"\n[target]\nmaterial = "steel"', "rig.speed"),
    ('kind = "platens"\n[platens]\nmaterial = "steel"\nforce = "4 kN"', "platens.force"),
])  # fmt: skip
def test_another_rig_is_planned_along_its_one_number(rig: str, path: str, tmp_path: Path) -> None:
    """Spheres break where their force passes the median strength, 5 kN, and all from its 95 % fractile on."""
    file = tmp_path / "study.toml"
    file.write_text(f"""[sphere]
material = "limestone"
radius = "10 mm"
[rig]
{rig}
[limits.force]
quantity = "P_max"
strength = {{ dist = "normal", mean = "5 kN", sd = "0.5 kN" }}
""")
    found = plan_blow(load_study(file), count=400)
    assert found.path == path
    starts = [found.first(where) for where in (found.breaks, found.share == 1.0)]
    at = [float(np.interp(one, found.values, found.force)) for one in starts if one is not None]
    assert at == pytest.approx([5e3, 5e3 + 1.645 * 500.0], rel=0.02)
    assert main(["plan", str(file), "--out", str(tmp_path / "out"), "--json"]) == 0
    assert (tmp_path / "out" / "plan.csv").is_file()
    assert main(["plan", str(file), "--speed", "1,2"]) == 2


def test_a_true_pressure_above_the_hardness_is_never_reached() -> None:
    bare = [f"bars.insert_{key}=null" for key in ("E", "yield_strength", "thickness")]
    plans = {}
    for meaning in ("hertz", "pressure"):
        changed = [*bare, "bars.material=steel", f"limits.crushing.strength_is={meaning}"]
        study = load_study(STUDIES / "granite_10mm_test.toml", changed)
        plans[meaning] = plan_test(study, request_of(study, rises=(0.0, 100e-6), grid=(12, 3)))
    assert plans["hertz"].charts[0].windows
    assert not plans["pressure"].charts[0].windows
    # strength of 4.05 GPa by Hertz, onset c(nu) Y of the library's steel
    over = plans["hertz"].over_onset[0, -1, plans["hertz"].subject.place]
    assert over == pytest.approx(4.049e9 / (1.295 * math.exp(0.736 * 0.29) * 834e6), rel=0.02)
