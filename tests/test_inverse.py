"""From records back to forces: exact without noise, inside the stated intervals with it, fracture found."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from tests.campaigns.inverse import Made, coverage, make_test, read_back, rig_of, scene_of_test
from uqsphere.cli import main
from uqsphere.mechanics.bars import disperse
from uqsphere.records.inverse import Rig, at_faces, forces_of
from uqsphere.records.laboratory import read_test
from uqsphere.records.record import make_record, mend
from uqsphere.records.table import RecordError, Table

STUDY = """\
title = "a test"
seed = 1
[sphere]
E = "40 GPa"
nu = 0.25
density = "2650 kg/m3"
radius = "10 mm"
[bars]
E = "190 GPa"
nu = 0.3
density = "8000 kg/m3"
diameter = "25 mm"
infinite = true
[striker]
speed = "1 m/s"
length = "0.4 m"
[analysis]
quantities = ["p_max"]
"""


@pytest.fixture(scope="module")
def clean() -> Made:
    return make_test(scene_of_test())


def test_forces_without_noise_are_those_of_the_scene(clean: Made) -> None:
    faces, found = read_back(clean, 1e-4, departure=True)
    truth = clean.forces(faces.time + faces.pulse.begin - clean.begin)
    for force, true in zip((found.forces.force_a, found.forces.force_b), truth, strict=True):
        # an instant between two samples, read by a cubic
        assert np.abs(force - true).max() < 5e-3 * true.max()
    for force, true in zip((found.fitted_a, found.fitted_b), truth, strict=True):
        assert np.abs(force - true).max() < 2e-3 * true.max()
    assert found.held
    assert abs(found.stiffness.modulus / clean.modulus - 1.0) < 1e-3
    assert found.stiffness.low < clean.modulus < found.stiffness.high


def test_energy_of_the_waves_is_that_of_the_contacts(clean: Made) -> None:
    # what the incident wave brings and the others do not take away is in the contacts and the sphere
    faces, _ = read_back(clean, 1e-4)
    c = {name: float(column[0]) for name, column in clean.scene.columns.items()}
    speed = math.sqrt(c["bars.E"] / c["bars.density"])
    flow = c["bars.E"] * 0.25 * math.pi * c["bars.diameter"] ** 2 * speed * faces.step
    brought = flow * (np.square(faces.incident) - np.square(faces.reflected) - np.square(faces.transmitted)).cumsum()
    truth = clean.forces(faces.time + faces.pulse.begin - clean.begin)
    beta = float(clean.scene.scales.hertz_constant[0])
    stored = sum(0.4 * beta * (np.maximum(force, 0.0) / beta) ** (5.0 / 3.0) for force in truth)
    mass = float(clean.scene.scales.mass[0])
    velocity = np.cumsum(truth[0] - truth[1]) * faces.step / mass
    assert np.abs(brought - stored - 0.5 * mass * velocity**2).max() < 0.01 * brought.max()


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    # 200 repetitions: python -m tests.campaigns.inverse; here so many that a wrong variance shows
    found = coverage(8, seed=7)
    for face in "AB":
        share = found["forces"][face]
        assert abs(share["share"] - 0.95) < 4.0 * max(share["std_error"], 0.002)
    assert found["modulus"]["share"] > 0.95 - 4.0 * math.sqrt(0.95 * 0.05 / 8)
    assert 0.25 < found["modulus"]["score_sd"] < 2.0
    assert abs(found["modulus"]["mean_ratio"] - 1.0) < 0.01


def test_more_noise_and_a_less_certain_gain_widen_the_intervals() -> None:
    made = make_test(scene_of_test(), noise=1e-6, rng=np.random.default_rng(1))
    record = mend(make_record(made.table, 2), "tension")
    faces = at_faces(record, rig_of(made.scene))
    columns = {name: float(column[0]) for name, column in made.scene.columns.items()}
    plain, gained = forces_of(faces, columns), forces_of(faces, columns, 0.05)
    at = int(plain.force_a.argmax())
    wider = math.sqrt(gained.sd_a[at] ** 2 - plain.sd_a[at] ** 2)
    assert abs(wider - 0.05 * plain.force_a[at]) < 1e-6 * wider
    scale = columns["bars.E"] * 0.25 * math.pi * columns["bars.diameter"] ** 2
    # two samples of noise at A while both waves are known, one at B
    assert 1.2 * scale * 1e-6 < plain.sd_a[0] < 1.5 * scale * 1e-6
    assert plain.sd_a[-1] < plain.sd_a[0]
    assert 0.8 * scale * 1e-6 < plain.sd_b[0] < 1.1 * scale * 1e-6


@pytest.mark.parametrize("moment", [130e-6])
def test_the_end_of_the_elastic_contact_is_found(moment: float) -> None:
    made = make_test(
        scene_of_test(), noise=1e-6, gain_sd=0.01, offset=1e-5, rng=np.random.default_rng(3), fracture=moment
    )
    faces, found = read_back(made, 0.01, departure=True)
    true = moment - (faces.pulse.begin - made.begin)
    end = found.departure
    assert not found.held
    assert end.earliest - 5e-6 <= true <= end.latest
    assert abs(end.time - true) < 12e-6
    force = made.forces(np.array([moment]))[1][0]
    assert abs(end.force_b[0] / force - 1.0) < 0.2
    assert found.stiffness.low < made.modulus < found.stiffness.high


def test_an_elastic_test_is_not_called_broken() -> None:
    for seed in range(2):
        made = make_test(scene_of_test(), noise=2e-6, gain_sd=0.01, rng=np.random.default_rng(seed))
        assert read_back(made, 0.01, departure=True)[1].held


def test_dispersion_between_gauges_and_faces_is_undone(clean: Made) -> None:
    rig = rig_of(clean.scene)
    time, first, second = clean.table.values.T
    bar = {"radius": rig.bar.radius, "wave_speed": rig.bar.wave_speed, "nu": rig.bar.nu}
    step = float(time[1] - time[0])
    split = int(np.searchsorted(time, clean.begin + 1.9 * rig.incident_gauge / rig.bar.wave_speed))
    going, coming = (
        np.where(np.arange(len(time)) < split, first, 0.0),
        np.where(np.arange(len(time)) < split, 0.0, first),
    )
    room = np.zeros(2000)

    def seen(wave: np.ndarray, distance: float) -> np.ndarray:
        padded = np.concatenate([room, wave, np.full(1000, wave[-1]), np.linspace(wave[-1], 0.0, 1000)])
        return disperse(padded, step, distance, **bar)[2000 : 2000 + len(wave)]

    gauge_a = seen(going, rig.incident_gauge) + seen(coming, -rig.incident_gauge)
    gauge_b = seen(second, -rig.receiving_gauge)
    values = np.column_stack([time, gauge_a, gauge_b])
    table = Table(names=clean.table.names, units=clean.table.units, values=values)
    record = mend(make_record(table, 2), "tension")
    columns = {name: float(column[0]) for name, column in clean.scene.columns.items()}
    errors = {}
    for corrected in (False, True):
        own = Rig(bar=rig.bar, incident_gauge=rig.incident_gauge, receiving_gauge=rig.receiving_gauge,
                  correct_dispersion=corrected)  # fmt: skip
        faces = at_faces(record, own)
        force = forces_of(faces, columns)
        shift = faces.pulse.begin - clean.begin
        true = clean.forces(force.time + shift)
        errors[corrected] = float(np.abs(force.force_a - true[0]).max() / true[0].max())
    assert errors[True] < 0.01
    assert errors[False] > 4.0 * errors[True]


def test_three_waves_of_their_own_gauges_say_the_same(clean: Made) -> None:
    rig = rig_of(clean.scene)
    time, first, second = clean.table.values.T
    split = np.searchsorted(time, clean.begin + 1.9 * rig.incident_gauge / rig.bar.wave_speed)
    before = np.arange(len(time)) < split
    values = np.column_stack([time, np.where(before, first, 0.0), np.where(before, 0.0, first), second])
    table = Table(names=("t", "i", "r", "t3"), units=("s", "", "", ""), values=values)
    three = at_faces(mend(make_record(table, 3), "tension"), rig)
    two = at_faces(mend(make_record(clean.table, 2), "tension"), rig)
    count = min(len(two.incident), len(three.incident))
    assert not three.shared
    assert np.abs(three.reflected[:count] - two.reflected[:count]).max() < 1e-9
    assert np.abs(three.transmitted[:count] - two.transmitted[:count]).max() < 1e-12


def test_what_cannot_be_read_back_is_refused(clean: Made) -> None:
    record = mend(make_record(clean.table, 2), "tension")
    bar = rig_of(clean.scene).bar
    near = Rig(bar=bar, incident_gauge=0.3, receiving_gauge=0.6)
    faces = at_faces(record, near)
    assert faces.merged
    assert "overlap at the incident gauge" in faces.notes[-1]
    # the transmitted wave is not touched by that: the force at B stands alone
    read = read_test(record, near, {name: float(column[0]) for name, column in clean.scene.columns.items()})
    assert "overlap" in read.peaks["A"].doubts[0]
    assert not read.peaks["B"].doubts
    assert abs(read.peaks["B"].value / float(clean.forces(read.forces.time)[1].max()) - 1.0) < 0.03
    assert (read.energies, read.balanced, read.inverse) == (None, None, None)
    with pytest.raises(RecordError, match="must sit on its bar"):
        Rig(bar=bar, incident_gauge=2.0, receiving_gauge=0.6, incident_length=1.5)
    with pytest.raises(RecordError, match=r"ends before the wave|samples are left"):
        at_faces(record, Rig(bar=bar, incident_gauge=2.0, receiving_gauge=0.6))
    short = at_faces(record, Rig(bar=bar, incident_gauge=0.75, receiving_gauge=0.6, receiving_length=1.0))
    assert len(short.time) * short.step < 2.0 * 0.4 / bar.wave_speed + 1e-6
    assert any("mix in" in note for note in short.notes)


def write_test(folder: Path, fracture: float | None = None) -> list[str]:
    made = make_test(
        scene_of_test(), noise=1e-6, gain_sd=0.01, offset=1e-5, rng=np.random.default_rng(3), fracture=fracture
    )
    lines = ["time [us],incident [ue],receiving [ue]"]
    lines += [",".join(f"{1e6 * value:.7g}" for value in row) for row in made.table.values]
    (folder / "test.csv").write_text("\n".join(lines), encoding="utf-8")
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    return [str(folder / "test.csv"), "--study", str(folder / "study.toml"), "--incident-gauge", "0.75 m",
            "--receiving-gauge", "0.6 m"]  # fmt: skip


def test_the_command_says_what_the_test_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = write_test(tmp_path, fracture=160e-6)
    assert main(["records", *arguments, "--json", "--out", str(tmp_path / "out")]) == 0
    content = json.loads(capsys.readouterr().out)
    modulus = content["reduced_modulus"]
    assert modulus["low"] < 4.38244361e10 < modulus["high"]
    assert content["elastic_throughout"] is False
    assert content["departure"]["force_b"]["low"] < content["departure"]["force_b"]["value"]
    lines = (tmp_path / "out" / "forces.csv").read_text().splitlines()
    assert len(lines) == content["samples"] + 1
    assert lines[0].startswith("time [s],force_a [N],force_b [N]")
    for name in ("forces.svg", "record.svg"):
        assert (tmp_path / "out" / name).read_text().startswith("<?xml")


def test_the_command_shows_one_pulse(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, _, study = write_test(tmp_path)[:3]
    columns = ["--columns", "time,incident"]
    assert main(["records", path, *columns, "--study", study, "--out", str(tmp_path / "out"), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert abs(content["striker_speed"] - 1.0) < 0.05
    assert (tmp_path / "out" / "record.svg").is_file()
    assert (
        main(["records", path, *columns, "--correct-dispersion", "--incident-gauge", "0.75 m", "--study", study]) == 0
    )
    assert "microstrain" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--gain-sd", "2"], "--gain-sd must lie"),
        (["--gauge-factor", "0"], "--gauge-factor must be above zero"),
        (["--incident-gauge", "0.75"], "--incident-gauge"),
        (["--window", "3 ms"], "--window takes begin and end"),
        (["--columns", "time,force"], "not in the file"),
        (["--columns", "time,incident", "--correct-dispersion", "--incident-gauge", "0 m"], "--incident-gauge"),
    ],
)
def test_wrong_use_of_the_command_is_an_error_of_use(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str], words: str
) -> None:
    assert main(["records", *write_test(tmp_path), *more]) == 2
    assert words in capsys.readouterr().err


def test_a_record_without_a_study_or_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_test(tmp_path)[0]
    assert main(["records", path]) == 2
    assert "--study" in capsys.readouterr().err
    assert main(["records", str(tmp_path / "none.csv")]) == 2
    assert "no such file" in capsys.readouterr().err
