"""Records: every way a recorder can write them, what is mended and what is refused, pulses, and the study over them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import uqsphere
from uqsphere.errors import StudyError
from uqsphere.mechanics.bars import disperse
from uqsphere.mechanics.pulses import build_pulse, pulse_value
from uqsphere.records.pulse import Bar, measured_pulse
from uqsphere.records.record import Wiring, make_record, mend
from uqsphere.records.table import RecordError, Table, read_table

STEP, NOISE, PEAK = 5e-7, 1e-6, 1.2e-4
TIME = STEP * np.arange(1600)
SHAPE = build_pulse("trapezoid", [200e-6], {"rise": [30e-6], "fall": [40e-6]})
IDEAL = -PEAK * pulse_value(SHAPE, 0, TIME - 150e-6)


def noisy(seed: int = 1, size: float = NOISE) -> np.ndarray:
    return IDEAL + size * np.random.default_rng(seed).normal(size=len(TIME))


def text_of(values: np.ndarray, *, time: np.ndarray = TIME, head: str = "time [s],strain", between: str = ",",
            comma: bool = False, end: str = "\n") -> str:  # fmt: skip
    lines = [head] if head else []
    lines += [between.join(f"{x:.9g}" for x in row) for row in np.column_stack([time, values])]
    text = end.join(lines) + end
    return text.replace(".", ",") if comma else text


def write(folder: Path, text: str, encoding: str = "utf-8") -> Path:
    path = folder / "pulse.csv"
    path.write_bytes(text.encode(encoding))
    return path


@pytest.mark.parametrize(
    ("options", "encoding"),
    [
        ({}, "utf-8"),
        ({"end": "\r\n"}, "utf-8"),
        ({"end": "\r\n"}, "utf-8-sig"),
        ({"end": "\r"}, "utf-8"),
        ({"between": "\t", "head": "time [s]\tstrain"}, "utf-8"),
        ({"between": "\t", "head": "Zeit [s]\tDehnung", "comma": True}, "utf-8"),
        ({"between": ";", "head": "Zeit [s];Dehnung", "comma": True, "end": "\r\n"}, "utf-8"),
        ({"between": "  ", "head": "# time strain"}, "utf-8"),
        ({"head": ""}, "utf-8"),
        ({"head": "Recorder 7\nChannel A, B\nµ,x\ntime,strain\n[s],[strain]"}, "latin-1"),
        ({}, "utf-16"),
    ],
)
def test_however_it_is_written_the_numbers_are_the_same(tmp_path: Path, options: dict[str, str], encoding: str) -> None:
    values = noisy()
    table = read_table(write(tmp_path, text_of(values, **options), encoding))
    assert table.values.shape == (len(TIME), 2)
    assert np.allclose(table.values[:, 1], values, rtol=1e-8, atol=0.0)
    record = make_record(table)
    assert abs(record.step - STEP) < 1e-6 * STEP


def test_units_of_the_heading_and_of_the_study() -> None:
    values = np.column_stack([TIME * 1e6, noisy() * 1e6])
    table = Table(names=("t", "eps"), units=("us", "µε"), values=values)
    record = make_record(table)
    assert abs(record.step / STEP - 1.0) < 1e-9
    assert np.allclose(record.strain[:, 0], noisy())
    volts = Table(names=("t", "u"), units=("us", "mV"), values=values)
    with pytest.raises(RecordError, match="supply of the bridge"):
        make_record(volts)
    wiring = Wiring(gauge_factor=2.1, excitation=5.0, amplification=100.0, active_arms=2.0)
    strain = make_record(volts, wiring=wiring).strain[:, 0]
    assert np.allclose(strain, 1e-3 * 4.0 * values[:, 1] / (2.1 * 5.0 * 100.0 * 2.0))
    with pytest.raises(RecordError, match="allowed: s, ms, us"):
        make_record(Table(names=("t", "u"), units=("ticks", ""), values=values))
    with pytest.raises(RecordError, match="is its time in another unit"):
        make_record(Table(names=("t", "u"), units=("", ""), values=values))
    with pytest.raises(RecordError, match="is it in microstrain or volts"):
        make_record(Table(names=("t", "u"), units=("us", ""), values=values))


REFUSED = {
    "empty": ("", "no table of numbers"),
    "a picture": ("\x89PNG\0\0", "NUL byte"),
    "a PDF": ("%PDF-1.7\n1,2\n", "this is a PDF"),
    "an archive": ("PK\x03\x04nothing", "cannot be read"),
    "one row": ("time,U\n0.0,1.0\n", "1 rows"),
    "an empty column": ("time,U\n" + "".join(f"{k},\n" for k in range(60)), "one column only"),
    "words": ("time,strain\nbegin,end\n", "no table of numbers"),
    "one column": ("strain\n" + "1.0\n" * 50, "one column only"),
    "three samples": ("0,0\n1e-6,0\n2e-6,1e-4\n", "a record has 20 at least"),
    "a word inside": (text_of(noisy()).replace("\n", "\nbroken,1\n", 700).replace("\nbroken,1\n", "\n", 600),
                      "where a number is due"),
    "a row with three cells": (text_of(noisy()) + "9e-4,1,2\n", "line 1602 has 3 columns, the lines before have 2"),
    "a column too many": (text_of(np.column_stack([noisy(), noisy(2)]), head="time [s],incident,transmitted"),
                          r"found 3 columns \(time, incident, transmitted\), too many"),
    "no wave": (text_of(1e-6 * np.random.default_rng(1).normal(size=len(TIME))), "no wave"),
    "the same everywhere": (text_of(np.zeros(len(TIME))), "every sample is the same"),
    "clipped": (text_of(np.maximum(noisy(), -1e-4)), "is clipped at -0.0001"),
    "begins inside": (text_of(noisy()[420:], time=TIME[420:]), "begins or ends inside"),
    "ends inside": (text_of(noisy()[:600], time=TIME[:600]), "begins or ends inside"),
    "a gap inside": (text_of(np.delete(noisy(), slice(500, 600)), time=np.delete(TIME, slice(500, 600))),
                     "samples are missing inside the pulse"),
    "time runs back": (text_of(noisy(), time=np.where(TIME > 6e-4, TIME - 3e-4, TIME)), "time runs backwards"),
    "mostly missing": (text_of(np.where(np.arange(1600) % 3 == 0, noisy(), np.nan)), "are no numbers"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_used_is_refused_and_says_why(tmp_path: Path, name: str) -> None:
    text, words = REFUSED[name]
    with pytest.raises(RecordError, match=words):
        measured_pulse(write(tmp_path, text))


def test_a_file_that_is_not_there_or_too_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RecordError, match="no such file"):
        read_table(tmp_path / "none.csv")
    with pytest.raises(RecordError, match="this is a folder"):
        read_table(tmp_path)
    path = write(tmp_path, text_of(noisy()))
    monkeypatch.setattr("uqsphere.records.table.LARGEST_RECORD", 1000)
    with pytest.raises(RecordError, match="MiB"):
        read_table(path)


def uneven() -> tuple[np.ndarray, np.ndarray]:
    time = TIME + 0.2 * STEP * np.random.default_rng(5).uniform(-1.0, 1.0, len(TIME))
    return time, -PEAK * pulse_value(SHAPE, 0, time - 150e-6) + noisy() - IDEAL


MENDED = {
    "as it is": (text_of(noisy()), None),
    "wrong polarity": (text_of(-noisy()), "the sign is turned"),
    "an offset": (text_of(noisy() + 2e-5), "a baseline of "),
    "gaps of a few samples": (text_of(np.where(np.isin(np.arange(1600), [3, 500, 501, 502, 900]), np.nan, noisy())),
                              "5 missing samples are filled"),
    "rows left out": (text_of(np.delete(noisy(), [400, 401, 700]), time=np.delete(TIME, [400, 401, 700])),
                      "3 missing samples are filled"),
    "a long gap behind": (text_of(np.delete(noisy(), slice(1100, 1200)), time=np.delete(TIME, slice(1100, 1200))),
                          "100 samples lie in gaps"),
    "uneven steps": (text_of(uneven()[1], time=uneven()[0]), "steps of time are uneven"),
    "time with few digits": (text_of(noisy(), time=np.round(TIME, 6)), "too few digits"),
    "rows without time": (text_of(noisy(), time=np.where(np.arange(1600) == 1500, np.nan, TIME)),
                          "1 rows without a time"),
    "no baseline before": (text_of(np.roll(noisy(), -295)), "taken from the end of the record"),
}  # fmt: skip


@pytest.mark.parametrize("name", MENDED)
def test_what_can_be_mended_is_and_says_so(tmp_path: Path, name: str) -> None:
    text, words = MENDED[name]
    found = measured_pulse(write(tmp_path, text))
    if words is not None:
        assert any(words in note for note in found.notes), found.notes
    assert abs(found.peak / PEAK - 1.0) < 0.025
    # the impulse does not care for the noise on the peak: trapezoid of 200 us at half height
    step = found.duration / 4000
    mean = found.peak * pulse_value(found.pulse(1, {}), 0, step * (np.arange(4000) + 0.5)).sum() * step
    assert abs(mean / (PEAK * 200e-6) - 1.0) < 0.01


def test_ten_million_rows_are_thinned() -> None:
    rng = np.random.default_rng(2)
    time = np.arange(10_000_000) * 1e-10
    values = np.empty((len(time), 2))
    values[:, 0] = time
    values[:, 1] = -PEAK * pulse_value(SHAPE, 0, time - 150e-6) + 1e-6 * rng.normal(size=len(time))
    record = mend(make_record(Table(names=("t", "e"), units=("s", "strain"), values=values)))
    assert len(record.strain) == 400_000
    assert any("10,000,000 samples are thinned to 400,000" in note for note in record.notes)
    assert abs(record.noise[0] - 1e-6 / 5.0) < 2e-8


def test_noise_and_its_memory_are_found() -> None:
    rng = np.random.default_rng(4)
    white = rng.normal(size=40_000)
    slow = np.convolve(white, np.ones(8) / np.sqrt(8.0), mode="same")
    time = 1e-7 * np.arange(40_000)
    for noise, memory in ((white, 1.0), (slow, 8.0)):
        values = 1e-6 * noise
        values[30_000:34_000] -= 1e-4
        record = mend(make_record(Table(names=("t", "e"), units=("s", ""), values=np.column_stack([time, values]))))
        assert abs(record.noise[0] / 1e-6 - 1.0) < 0.05
        assert abs(record.memory[0] / memory - 1.0) < 0.25


def test_the_curve_follows_a_smooth_record_to_its_last_digits(tmp_path: Path) -> None:
    half_sine = -PEAK * np.where((TIME > 1e-4) & (TIME < 3e-4), np.sin(np.pi * (TIME - 1e-4) / 2e-4) ** 2, 0.0)
    found = measured_pulse(write(tmp_path, text_of(half_sine)))
    shown = pulse_value(found.pulse(1, {}), 0, np.linspace(0.0, found.duration, 2001)[:-1])
    assert abs(found.peak / PEAK - 1.0) < 1e-3
    assert abs(shown.max() - 1.0) < 1e-3
    pulse = found.pulse(1, {})
    # slope and curvature are continuous at the joints
    h = np.diff(pulse.breaks[0])[:-1]
    c = pulse.coefficients[0]
    left = c[:-1, 1] + 2 * c[:-1, 2] * h + 3 * c[:-1, 3] * h**2
    assert np.abs(left - c[1:, 1]).max() < 1e-9 * np.abs(c[:, 1]).max()


def test_dispersion_is_undone(tmp_path: Path) -> None:
    # a wave that is known at the sphere, as a gauge 1 m before it would show it
    smooth = np.convolve(IDEAL, np.hanning(41) / np.hanning(41).sum(), mode="same")
    bar = {"radius": 0.02, "wave_speed": 5172.0, "nu": 0.29}
    long = np.concatenate([np.zeros(1000), smooth, np.zeros(1000)])
    seen = disperse(long, STEP, 1.0, **bar)
    time = STEP * np.arange(len(long))
    assert np.abs(seen - long).max() > 0.02 * PEAK
    path = write(tmp_path, text_of(seen, time=time))
    found = measured_pulse(path, bar=Bar(**bar), distance=1.0)
    plain = measured_pulse(path)
    places = np.linspace(0.0, found.duration, 1500)
    shown = found.peak * pulse_value(found.pulse(1, {}), 0, places)
    lags = STEP * np.arange(-200, 200) * 0.25
    wanted = -np.array([np.interp(places + lag + time[1000] + 150e-6, time, long) for lag in lags])
    assert np.abs(wanted - shown).max(axis=1).min() < 0.01 * PEAK
    raw = plain.peak * pulse_value(plain.pulse(1, {}), 0, places)
    assert np.abs(wanted - raw).max(axis=1).min() > 0.015 * PEAK
    assert any("energy is" in note for note in found.notes)


def test_noise_modes_have_the_variance_of_white_noise(tmp_path: Path) -> None:
    found = measured_pulse(write(tmp_path, text_of(noisy())))
    length = found.duration
    assert abs(found.noise * found.peak / (NOISE * np.sqrt(STEP / length)) - 1.0) < 0.2
    moved = found.pulse(3, {"pulse.noise_1": np.array([0.0, 1.0, -1.0])})
    middle = np.array([0.5 * length])
    at = [float(pulse_value(moved, row, middle)[0]) for row in range(3)]
    assert abs(at[1] - at[0] - np.sqrt(2.0) * found.noise) < 1e-3 * found.noise
    assert abs(at[1] + at[2] - 2.0 * at[0]) < 1e-12
    # the first mode of many records scatters as it says
    mode = np.sqrt(2.0) * np.sin(np.pi * np.linspace(0.0, 1.0, round(length / STEP)))
    drawn = np.random.default_rng(9).normal(size=(4000, len(mode))) * NOISE
    assert abs((drawn @ mode / len(mode)).std() / (found.noise * found.peak) - 1.0) < 0.2


STUDY = """\
title = "measured"
seed = 3
[sphere]
material = "granite"
radius = "10 mm"
[bars]
material = "maraging_steel"
diameter = "40 mm"
infinite = true
[pulse]
shape = "measured"
file = "pulse.csv"
[analysis]
quantities = ["p_max"]
"""


def study_of(folder: Path, text: str, *more: str) -> uqsphere.Study:
    write(folder, text)
    path = folder / "study.toml"
    path.write_text(STUDY, encoding="utf-8")
    return uqsphere.load_study(path, list(more))


def test_a_record_drives_the_model_as_its_ideal_pulse_does(tmp_path: Path) -> None:
    study = study_of(tmp_path, text_of(IDEAL), "pulse.gain=1.0")
    asked = ("p_max", "P_max", "force_imbalance", "energy")
    found = uqsphere.evaluate(study, {}, asked)
    speed = 2.0 * np.sqrt(study.at_means()["bars.E"] / study.at_means()["bars.density"]) * PEAK
    (tmp_path / "ideal.toml").write_text(
        STUDY.replace('shape = "measured"\nfile = "pulse.csv"',
                      'shape = "trapezoid"\nrise = "30 us"\nfall = "40 us"\nduration = "200 us"')
        + f'[striker]\nspeed = "{speed:.12g} m/s"\n', encoding="utf-8")  # fmt: skip
    ideal = uqsphere.evaluate(uqsphere.load_study(tmp_path / "ideal.toml"), {}, asked)
    for name in asked:
        assert abs(found[name][0] / ideal[name][0] - 1.0) < 3e-3, name
    # the gain is an input: force follows it
    twice = uqsphere.evaluate(study, {"pulse.gain": [1.0, 1.1]}, ("P_max",))["P_max"]
    assert 1.1 < twice[1] / twice[0] < 1.1**1.6
    stiffer = uqsphere.evaluate(study, {"bars.E": np.array([1.0, 1.21]) * study.at_means()["bars.E"]}, ("p_max",))
    assert stiffer["p_max"][1] > 1.05 * stiffer["p_max"][0]  # the same strain is a faster wave


def test_the_integrators_follow_the_cubics_alike(tmp_path: Path) -> None:
    from uqsphere.bench import solve_scipy
    from uqsphere.mechanics.integrator.solve import solve
    from uqsphere.model import scene_of

    study = study_of(tmp_path, text_of(noisy()))
    scene = scene_of(study, {"sphere.E": np.array([4e10, 5e10])})
    tight = solve(scene, tolerance=1e-10, quantities=("p_max",)).values["p_max"]
    loose = solve(scene, tolerance=1e-6, quantities=("p_max",)).values["p_max"]
    assert np.abs(loose / tight - 1.0).max() < 5e-6
    other = scene.scales.force * solve_scipy(scene, 2, "DOP853", 1e-10, contact=False)[:, 0] ** 1.5
    force = solve(scene, tolerance=1e-8, quantities=("P_max",)).values["P_max"]
    assert np.abs(other / force - 1.0).max() < 5e-8


def test_what_a_measured_study_says_of_itself(tmp_path: Path) -> None:
    study = study_of(tmp_path, text_of(noisy()), "pulse.noise=true", 'pulse.gain={ dist="normal", mean=1.0, sd=0.02 }')
    assert list(study.random) == ["pulse.gain", *(f"pulse.noise_{j}" for j in range(1, 7))]
    assert study.record is not None
    assert "striker.speed" not in study.fixed
    resolved = study.resolved()
    assert resolved["record"]["source"] == "pulse.csv"
    assert any("cubics follow the record" in text for text in study.warnings)
    other = study_of(tmp_path, text_of(noisy(7)), "pulse.noise=true", 'pulse.gain={ dist="normal", mean=1.0, sd=0.02 }')
    assert other.hash != study.hash
    frame = uqsphere.evaluate(study, {"pulse.noise_1": np.array([-3.0, 0.0, 3.0])}, ("p_max",))
    assert frame["p_max"].is_monotonic_increasing


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ('pulse.file="../pulse.csv"', "files of its own folder only"),
        ('pulse.unit="furlong"', "allowed: strain"),
        ("pulse.correct_dispersion=true", "gauge_distance"),
        ('pulse.gauge_distance="-1 m"', "must be above 0"),
        ('striker.speed="1 m/s"', "leave it out"),
        ('pulse.window=["3 ms"]', "two are due"),
        ('pulse.window=["3 ms", "4 ms"]', "window of the pulse lies outside"),
        ('pulse.rise="1 us"', "does not belong to a measured pulse"),
        ("pulse.gauge_factor=-2.0", "a number above 0 is due"),
        ('pulse.columns=["time", "force"]', "is not in the file"),
        ('pulse.polarity="left"', "auto, tension or compression"),
    ],
)
def test_faults_of_a_measured_study_have_a_place(tmp_path: Path, change: str, words: str) -> None:
    with pytest.raises(StudyError, match=words):
        study_of(tmp_path, text_of(noisy()), change)


def test_a_pulse_longer_than_the_round_trip_is_refused(tmp_path: Path) -> None:
    lengths = ("bars.infinite=false", 'bars.incident_length="0.3 m"', 'bars.receiving_length="1 m"')
    with pytest.raises(StudyError, match="longer than the round trip"):
        study_of(tmp_path, text_of(noisy()), *lengths)


def test_sign_is_left_where_the_study_says_what_it_is(tmp_path: Path) -> None:
    path = write(tmp_path, text_of(-noisy()))
    assert measured_pulse(path, polarity="compression").peak > 0.9 * PEAK
    with pytest.raises(RecordError, match="does not press"):
        measured_pulse(path, polarity="tension")
    assert mend(make_record(read_table(path))).strain.min() < -0.9 * PEAK
