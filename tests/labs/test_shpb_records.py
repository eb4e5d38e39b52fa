"""Records of a test with known forces: every fault mended, doubted or refused, never wrong and
sound.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from uqsphere.cli import main
from uqsphere.errors import UsageError
from uqsphere.labs.shpb.document import RecordDocument
from uqsphere.labs.shpb.mending import load_record
from uqsphere.labs.shpb.recorder import read_recorded
from uqsphere.labs.shpb.sheet import rows
from uqsphere.labs.shpb.waves import Reading, read_test
from uqsphere.mechanics.bars import correct

E, DENSITY, DIAMETER, LENGTH, GAUGE_A, GAUGE_B = 200e9, 7850.0, 0.02, 1.5, 0.75, 0.6
C0, EA = (E / DENSITY) ** 0.5, E * np.pi * DIAMETER**2 / 4.0
STEP, PEAK = 0.5e-6, 25e3
INC, REC = "incident [strain]", "receiving [strain]"
BARS: dict[str, Any] = {
    "incident_bar": {
        "E": "200 GPa",
        "density": "7850 kg/m3",
        "diameter": "20 mm",
        "length": "1.5 m",
        "gauge": "0.75 m",
    },
    "receiving_bar": {"gauge": "0.6 m"},
}


def waves(noise: float = 1e-6, seed: int = 1, rise: float = 20e-6) -> pd.DataFrame:
    """Time [us] and strains of both gauges: a pulse of 120 us, a force of 25 kN at both faces;
    compression negative.

    Waves change their shape on their way by the first mode of the bars.
    """
    time = np.arange(0.0, 900e-6, STEP)
    first, back = (
        150e-6,
        round(2.0 * GAUGE_A / C0 / STEP),
    )  # foot of the incident wave at its gauge, way back

    def moved(wave: np.ndarray, way: float) -> np.ndarray:
        return correct(wave, STEP, way, radius=0.5 * DIAMETER, wave_speed=C0, nu=0.3)

    def force(t: np.ndarray) -> np.ndarray:
        return np.where(
            (t > 0.0) & (t < 120e-6), PEAK * np.sin(np.pi * np.clip(t / 120e-6, 0.0, 1.0)) ** 2, 0.0
        )

    shape = np.clip((time - first) / rise, 0.0, 1.0) * np.clip(
        (120e-6 + first - time) / rise, 0.0, 1.0
    )
    incident = moved(800e-6 * np.sin(0.5 * np.pi * shape) ** 2, LENGTH - GAUGE_A)
    at_face = np.concatenate([np.zeros(back), moved(incident, GAUGE_A)[:-back]])
    reflected = moved(force(time - first - back * STEP) / EA - at_face, GAUGE_A)
    receiving = moved(-force(time - first - (GAUGE_A + GAUGE_B) / C0) / EA, GAUGE_B)
    rng = np.random.default_rng(seed)
    both = (v + noise * rng.standard_normal(len(time)) for v in (-incident - reflected, receiving))
    return pd.DataFrame(dict(zip(("time [us]", INC, REC), (time * 1e6, *both), strict=True)))


def read(folder: Path, frame: pd.DataFrame, **changes: Any) -> Reading:
    frame.to_csv(folder / "record.csv", index=False)
    tables = {
        name: {**BARS.get(name, {}), **changes.get(name, {})}
        for name in {*BARS, *changes, "record"}
    }
    tables["record"] = {"file": "record.csv", **changes.get("record", {})}
    document = RecordDocument(**tables)
    return read_test(load_record(document, folder))


def steps(test: Reading) -> list[str]:
    return [change.step for change in test.changes]


def check_sound(test: Reading, share: float = 0.03) -> None:
    """Every number without a doubt is right, and inside its interval (widened by the error of a
    smoothed top).
    """
    for peak in test.peaks.values():
        if not peak.doubts:
            assert peak.value == pytest.approx(PEAK, rel=share)
            assert peak.low - 0.01 * PEAK <= PEAK <= peak.high + 0.01 * PEAK


def test_a_clean_record(tmp_path: Path) -> None:
    test = read(tmp_path, waves())
    assert set(test.peaks) == {"A", "B", "mean"}
    assert not any(peak.doubts for peak in test.peaks.values())
    assert not test.withheld
    check_sound(test, 0.015)
    assert test.touch == pytest.approx(150e-6 + GAUGE_A / C0, abs=6e-6)
    assert test.peaks["B"].time == pytest.approx(60e-6, abs=6e-6)
    assert test.energies is not None
    # the work of the force: velocities of the faces are c0 (eps_r - eps_i) and -c0 eps_t
    assert test.energies["incident"] == pytest.approx(
        EA * C0 * STEP * float(np.square(test.pulse).sum()), rel=1e-3
    )
    assert test.balanced is not None
    assert test.balanced > 0.9


@pytest.mark.slow
def test_intervals_hold_the_force_in_most_of_many_records(tmp_path: Path) -> None:
    inside = 0
    for seed in range(40):
        rng = np.random.default_rng(1000 + seed)
        frame = waves(noise=4e-6, seed=seed)
        frame["incident [strain]"] *= 1.0 + 0.01 * rng.standard_normal()
        frame["receiving [strain]"] *= 1.0 + 0.01 * rng.standard_normal()
        peak = read(tmp_path, frame).peaks["B"]
        inside += peak.low <= PEAK <= peak.high
    assert inside >= 34


def spiked(frame: pd.DataFrame) -> None:
    for at, size in ((620, 3e-3), (905, -2e-3), (100, 1e-3)):
        frame.loc[at, "receiving [strain]"] += size
    frame.loc[700:702, "incident [strain]"] += 2e-3


def drifted(frame: pd.DataFrame) -> None:
    frame["receiving [strain]"] += 60e-6 + 40e-6 * frame["time [us]"] / 900.0


def turned(frame: pd.DataFrame) -> None:
    frame["incident [strain]"] *= -1.0


def triggered(frame: pd.DataFrame) -> None:
    frame.loc[40:44, "incident [strain]"] += np.array([1, -1, 1, -1, 1]) * 9e-4


@pytest.mark.parametrize(
    ("fault", "step", "text"),
    [
        (spiked, "spikes", "3 spikes"),
        (drifted, "baseline", "receiving: a baseline of 6"),
        (drifted, "drift", "microstrain/ms"),
        (turned, "sign", "incident"),
        (triggered, "spikes", "incident"),
    ],
)
def test_mended_in_named_steps_that_print_what_they_changed(
    fault: Any, step: str, text: str, tmp_path: Path
) -> None:
    frame = waves()
    fault(frame)
    test = read(tmp_path, frame)
    assert any(change.step == step and text in change.text for change in test.changes), test.changes
    assert not test.peaks["B"].doubts
    check_sound(test)


def test_waves_of_stout_bars_are_moved_to_the_faces(tmp_path: Path) -> None:
    frame = waves(rise=6e-6, noise=1e-7)
    moved, raw = read(tmp_path, frame), read(tmp_path, frame, record={"dispersion": False})
    time = moved.forces["A"].time
    truth = PEAK * np.sin(np.pi * np.clip(time / 120e-6, 0.0, 1.0)) ** 2
    inside = (time > 20e-6) & (time < 100e-6)
    off, before = (np.abs(t.forces["A"].force - truth)[inside].max() / PEAK for t in (moved, raw))
    assert off < 0.25 * before
    assert before > 0.1
    assert "dispersion" in steps(moved)


def scaled(name: str, factor: float) -> Any:
    return lambda f: f.assign(**{name: factor * f[name]})


def late(name: str, samples: int) -> Any:
    return lambda f: f.assign(**{name: np.roll(f[name], samples)})


#: what happens to a record or is text of it: frame, keys, and words of the doubt or refusal; empty
#: where it is mended
FAULTS: dict[str, tuple[Any, dict[str, Any], str]] = {
    "sign of one bar": (scaled(INC, -1.0), {}, ""),
    "sign of the other": (scaled(REC, -1.0), {}, ""),
    "sign of both": (lambda f: f * [1.0, -1.0, -1.0], {}, ""),
    "columns exchanged": (
        None,
        {"record": {"incident": REC, "receiving": INC}},
        "columns exchanged",
    ),
    "gauges exchanged": (
        None,
        {"incident_bar": {"gauge": "0.6 m"}, "receiving_bar": {"gauge": "0.75 m"}},
        "would fit",
    ),
    **{
        f"gain A {k}": (scaled(INC, k), {}, "times the impulse")
        for k in (0.25, 0.5, 0.9, 1.5, 2.0, 4.0)
    },
    **{
        f"gain B {k}": (scaled(REC, k), {}, "times the impulse")
        for k in (0.25, 0.5, 0.9, 1.5, 2.0, 4.0)
    },
    "gain of both": (
        lambda f: f * [1.0, 2.0, 2.0],
        {"record": {"striker_speed": "8.1 m/s"}},
        "a striker of 16",
    ),
    "strain as microstrain": (
        None,
        {"incident_bar": {"unit": "microstrain"}},
        "microstrain' ?|unit",
    ),
    "microstrain as strain": (lambda f: f * [1.0, 1e6, 1e6], {}, "no elastic bar bears"),
    "one bar in percent": (None, {"receiving_bar": {"unit": "%"}}, "times the impulse"),
    "time in ms": (
        lambda f: f.rename(columns={"time [us]": "t"}),
        {"record": {"time_unit": "ms"}},
        "passes|unit",
    ),
    "diameter of one bar": (None, {"receiving_bar": {"diameter": "25 mm"}}, "times the impulse"),
    **{
        f"gauge A {d}": (None, {"incident_bar": {"gauge": d}}, "0.7[45]|impulse")
        for d in ("0.5 m", "0.65 m", "0.9 m", "1.1 m")
    },
    **{
        f"gauge B {d}": (None, {"receiving_bar": {"gauge": d}}, "0.6|impulse")
        for d in ("0.4 m", "0.5 m", "0.7 m", "1 m")
    },
    **{
        f"E {k}": (None, {"incident_bar": {"E": f"{k} GPa"}}, "wave speed|another E")
        for k in (70, 120, 150, 170)
    },
    "E too high": (None, {"incident_bar": {"E": "300 GPa"}}, "faces differ|impulse|would fit"),
    "clock of one bar early": (late(REC, -100), {}, "too early"),
    "clock of one bar late": (late(REC, 60), {}, "impulse|apart"),
    "late drift of A": (
        lambda f: f.assign(**{INC: f[INC] + 3e-4 * np.clip(f["time [us]"] / 900.0 - 0.2, 0, 1)}),
        {},
        "impulse",
    ),
    "step of A": (
        lambda f: f.assign(**{INC: f[INC] + 2e-4 * (f["time [us]"] > 450.0)}),
        {},
        "impulse",
    ),
    "clipped top of B": (
        lambda f: f.assign(**{REC: np.maximum(f[REC], -0.6 * PEAK / EA)}),
        {},
        "at least this",
    ),
    "clipped top of A": (lambda f: f.assign(**{INC: np.maximum(f[INC], -5e-4)}), {}, "not known"),
    "sampled too slowly": (lambda f: f.iloc[::24], {}, "too slow|required"),
    "ends on the top": (
        lambda f: f.iloc[: round((150 + 1e6 * (GAUGE_A + GAUGE_B) / C0 + 58) * 1e-6 / STEP)],
        {},
        "largest where the record ends|required",
    ),
    "ends on the rise": (lambda f: f.iloc[:950], {}, "at least this|required"),
    "begins inside the wave": (lambda f: f.iloc[340:], {}, "too early"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_no_fault_is_wrong_and_silent(name: str, tmp_path: Path) -> None:
    change, keys, words = FAULTS[name]
    frame = waves()
    try:
        test = read(tmp_path, frame if change is None else change(frame), **keys)
    except UsageError as error:
        text, peaks = str(error), []
    else:
        peaks = list(test.peaks.values())
        text = " ".join((*test.withheld, *(doubt for peak in peaks for doubt in peak.doubts)))
    assert re.search(words, text)
    assert bool(words) == (not peaks or any(peak.doubts for peak in peaks))
    off = [abs(peak.value / PEAK - 1.0) for peak in peaks]
    assert all(peak.doubts or one < 0.06 for peak, one in zip(peaks, off, strict=True))
    if "unit" not in text and "a striker" not in text:
        assert not peaks or min(off) < 0.06 or any(peak.low <= PEAK <= peak.high for peak in peaks)


def test_a_small_error_of_time_is_shifted(tmp_path: Path) -> None:
    test = read(tmp_path, waves(), incident_bar={"gauge": "0.76 m"})
    shift = [change for change in test.changes if change.step == "time shift"]
    assert shift
    assert shift[0].size == pytest.approx(-2.0 * 0.01 / C0, abs=2e-6)
    check_sound(test)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("receiving", [1.0, -1.0])
def test_three_waves_take_their_sign_from_the_incident_one(
    sign: float, receiving: float, tmp_path: Path
) -> None:
    frame = waves()
    at = round((150e-6 + 1.3 * GAUGE_A / C0) / STEP)
    wave = frame["incident [strain]"].to_numpy().copy()
    frame["reflected [strain]"] = sign * np.where(
        np.arange(len(wave)) > at, wave, 1e-7 * np.arange(len(wave)) % 3e-7
    )
    frame["incident [strain]"] = sign * np.where(np.arange(len(wave)) > at, 0.0, wave)
    frame["receiving [strain]"] *= receiving
    names = {name: f"{name} [strain]" for name in ("incident", "reflected", "receiving")}
    test = read(tmp_path, frame, record=names)
    assert not test.peaks["A"].doubts
    check_sound(test)


def test_waves_that_were_cut_out_are_moved_to_the_faces_too(tmp_path: Path) -> None:
    """A short wave of stout bars is lower at its gauge than at the face."""
    frame = waves(rise=8e-6, noise=1e-7)
    begins = [
        round(t / STEP)
        for t in (145e-6, 145e-6 + 2.0 * GAUGE_A / C0, 145e-6 + (GAUGE_A + GAUGE_B) / C0)
    ]
    sources = ("incident [strain]", "incident [strain]", "receiving [strain]")
    cut = {
        name: frame[source].to_numpy()[begin : begin + 290]
        for name, source, begin in zip(
            ("I [strain]", "R [strain]", "T [strain]"), sources, begins, strict=True
        )
    }
    names = {
        "incident": "I [strain]",
        "reflected": "R [strain]",
        "receiving": "T [strain]",
        "aligned": True,
    }
    moved, raw = (
        read(
            tmp_path,
            pd.DataFrame({"time [us]": 0.5 * np.arange(290), **cut}),
            record={**names, "dispersion": disperses},
        )
        for disperses in (True, False)
    )
    assert "dispersion" in steps(moved)
    truth = PEAK * np.sin(np.pi * np.clip((moved.forces["A"].time - 5e-6) / 120e-6, 0.0, 1.0)) ** 2
    off, before = (
        np.abs(test.forces["A"].force - truth[: len(test.forces["A"].force)])[40:200].max() / PEAK
        for test in (moved, raw)
    )
    assert off < 0.5 * before
    for peak in moved.peaks.values():
        assert peak.value == pytest.approx(PEAK, rel=0.07)
        assert peak.low < PEAK < peak.high


def test_two_gauges_of_a_bar_and_a_dead_one(tmp_path: Path) -> None:
    frame, other = waves(), waves(seed=7)
    frame["second"] = other["receiving [strain]"] * 1.05
    columns = {"incident": "incident [strain]", "receiving": ["receiving [strain]", "second"]}
    test = read(tmp_path, frame, record=columns)
    assert "gauges" in steps(test)
    assert test.peaks["B"].value == pytest.approx(1.025 * PEAK, rel=0.015)
    frame["second"] = 1e-7 * np.random.default_rng(3).standard_normal(len(frame))
    frame.loc[900:1000, "second"] += 5e-6
    test = read(tmp_path, frame, record=columns)
    assert any("left out" in change.text for change in test.changes)
    check_sound(test)


@pytest.mark.parametrize(
    ("heading", "factor"),
    [("Time/ms", 1e-3), ("time_ms", 1e-3), ("t in ms", 1e-3), ("t, us", 1.0), ("Zeit (s)", 1e-6)],
)
def test_units_of_headings(heading: str, factor: float, tmp_path: Path) -> None:
    frame = waves().rename(
        columns={"time [us]": heading, "incident [strain]": "I/με", "receiving [strain]": "T/µε"}
    )
    frame[heading] *= factor
    frame[["I/με", "T/µε"]] *= 1e6
    test = read(tmp_path, frame)
    check_sound(test)
    text = " ".join(change.text for change in test.changes)
    assert "is strain in με" in text
    assert f"is in {heading.rstrip(')')[-2:].strip(' (')}" in text


def test_a_unit_that_is_taken_is_printed_and_a_time_in_another_is_refused(tmp_path: Path) -> None:
    frame = waves().rename(columns={"time [us]": "t"})
    with pytest.raises(UsageError, match="another unit"):
        read(tmp_path, frame)
    frame["t"] *= 1e-3  # milliseconds: 0.9 s of record
    with pytest.raises(UsageError, match=r"passes of the incident bar.*record\.time_unit"):
        read(tmp_path, frame)
    test = read(tmp_path, frame, record={"time_unit": "ms"})
    check_sound(test)
    frame["t"] *= 1e-3
    assert any("seconds are taken" in change.text for change in read(tmp_path, frame).changes)


def test_noise_alone_is_refused(tmp_path: Path) -> None:
    frame = waves(noise=2e-4)
    frame["receiving [strain]"] = 1e-5 * np.random.default_rng(5).standard_normal(len(frame))
    with pytest.raises(
        UsageError, match=r"no wave rises above the noise|no force at the receiving face"
    ):
        read(tmp_path, frame)


def test_gaps_uneven_steps_and_too_few_digits(tmp_path: Path) -> None:
    frame = waves().drop(index=[300, 301, 650, 651, 652])
    test = read(tmp_path, frame)
    assert any("missing samples are filled" in change.text for change in test.changes)
    check_sound(test)
    frame = waves()
    frame["time [us]"] = frame["time [us]"].round(0)
    test = read(tmp_path, frame)
    assert any("too few digits" in change.text for change in test.changes)
    check_sound(test)


def test_channels_without_a_time_column(tmp_path: Path) -> None:
    frame = waves().rename(columns={INC: "incident", REC: "receiving"})
    frame[["receiving"]].to_csv(tmp_path / "b.csv", index=False)
    record = {"more_files": ["b.csv"], "sample_interval": "0.5 us"}
    check_sound(read(tmp_path, frame[["incident"]], record=record), 0.015)


@pytest.mark.parametrize(
    "metadata",
    [
        "Sample rate: 2 MHz",
        "sampling rate 2000 KS/s",
        "Samplerate: 2000000\nMode: single",
        "# Sampling interval = 0.5 us",
        "Sample time: .5 us",
        "Sample time: 12.05.2024, 10:30\nSample rate: 2 MHz",
    ],
)
def test_metadata_have_the_clock_of_a_file_without_a_time(metadata: str, tmp_path: Path) -> None:
    text = waves()[[INC, REC]].to_csv(index=False)
    (tmp_path / "record.csv").write_text(f"{metadata}\n{text}")
    document = RecordDocument(**BARS, record={"file": "record.csv"})
    test = read_test(load_record(document, tmp_path))
    assert "no time column: a sample every 0.5 us" in [change.text for change in test.changes]
    check_sound(test, 0.015)


def test_a_long_gap_is_lost_and_not_filled(tmp_path: Path) -> None:
    test = read(tmp_path, waves().drop(index=[300, *range(1400, 1440)]))
    texts = " ".join(change.text for change in test.changes)
    assert "2 missing samples are filled" in texts
    assert "80 samples lie in gaps" in texts


def test_files_that_are_no_records(tmp_path: Path) -> None:
    frame = waves()
    with pytest.raises(UsageError, match="sample_interval"):
        read(tmp_path, frame[[INC, REC, INC]].sample(frac=1, random_state=1))
    with pytest.raises(UsageError, match="the bridge is required"):
        read(tmp_path, frame, incident_bar={"unit": "V"})
    with pytest.raises(UsageError, match="column 'x' is not in"):
        read(tmp_path, frame, record={"incident": "x", "receiving": "y"})


def test_volts_of_a_bridge(tmp_path: Path) -> None:
    factor = 4.0 / (2.0 * 2.0 * 5.0 * 400.0)
    frame = waves().rename(columns={"incident [strain]": "I (mV)", "receiving [strain]": "T (mV)"})
    frame[["I (mV)", "T (mV)"]] /= factor * 1e-3
    bridge = {"gauge_factor": 2.0, "active_arms": 2.0, "excitation": 5.0, "amplification": 400.0}
    check_sound(read(tmp_path, frame, incident_bar=bridge))
    frame[["I (mV)", "T (mV)"]] *= factor / (
        4.0 / (2.0 * 5.0)
    )  # one arm, nothing amplified, a gauge factor of 2
    check_sound(read(tmp_path, frame, incident_bar={"excitation": 5.0}))


@pytest.mark.parametrize(("polarity", "sign"), [("tension", 1.0), ("compression", -1.0)])
def test_a_polarity_that_is_given_is_taken(polarity: str, sign: float, tmp_path: Path) -> None:
    """The sign of compression in the file is what it is text to be, and a wave that then pulls is
    refused.
    """
    frame = waves() * [1.0, sign, sign]
    check_sound(read(tmp_path, frame, record={"polarity": polarity}), 0.015)
    with pytest.raises(UsageError, match="is tension"):
        read(tmp_path, frame * [1.0, -1.0, -1.0], record={"polarity": polarity})


def test_columns_of_a_recorders_sheet_end_where_they_like(tmp_path: Path) -> None:
    from openpyxl import Workbook

    book, path = Workbook(), tmp_path / "t.xlsx"
    book.active.append(["time [s]", "a [V]", "b [V]"])
    for k in range(100):
        book.active.append(
            [1e-6 * k, 0.1 * k, 0.2 * k]
            if k < 40
            else [1e-6 * k, 0.1 * k]
            if k < 90
            else [None, 0.1 * k]
        )
    book.save(path)
    table, _ = read_recorded(path)
    assert table.headings == ["time [s]", "a [V]", "b [V]"]
    assert len(table) == 100
    assert table.rows[-1] == ["", "9.9", ""]


@pytest.mark.parametrize(
    ("text", "headings", "above"),
    [
        (
            "Samplerate;10000 Hz\nCH;A;B;\ns;V;V;\n"
            + "".join(f"{k},0;{k},5;0,25\n" for k in range(80)),
            ["CH [s]", "A [V]", "B [V]"],
            "Samplerate",
        ),
        (
            "".join(f" {k}.0  {k}.5 0.25\n" for k in range(80)),
            ["column 1", "column 2", "column 3"],
            "",
        ),
        (
            "time volts\n" + "".join(f"{k},0 {k},5 0,25\n" for k in range(80)),
            ["column 1", "column 2", "column 3"],
            "time volts",
        ),
        (
            "t, x, y\n" + "".join(f"{k}, {k}.5, 0.25\n" for k in range(80)),
            ["t", "x", "y"],
            "",
        ),
        (
            "t x y flag\n" + "".join(f"{k}.0 {k}.5 0.25 ok\n" for k in range(80)),
            ["t", "x", "y", "flag"],
            "",
        ),
        (
            '"t;x;x"\r' + "".join(f'"{k}.0;{k}.5;0.25"\r' for k in range(80)),
            ["t", "2 x", "3 x"],
            "",
        ),
        (
            "# t [ms],x,y\n#\n" + "".join(f"{k}.0,{k}.5,0.25\n" for k in range(80)),
            ["t [ms]", "x", "y"],
            "#",
        ),
        (
            "t/ms\tx µε\ty\n" + "".join(f"{k}\t{k}.5\t0.25\n" for k in range(79)) + "79\t79.5\n",
            ["t/ms", "x µε", "y"],
            "",
        ),
    ],
)
def test_what_a_recorder_writes(text: str, headings: list[str], above: str, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(text, encoding="utf-8", newline="")
    table, metadata = read_recorded(tmp_path / "t.csv")
    assert table.headings == headings
    assert above in metadata
    assert table.numbers(1).tolist() == list(range(80))
    assert table.numbers(2)[-1] == 79.5
    assert table.numbers(3, blank=True)[0] == 0.25
    table.check()


def test_the_rows_of_the_sheet_are_the_numbers_of_the_test(tmp_path: Path) -> None:
    test = read(tmp_path, waves())
    shown = {name.partition(",")[0]: value for name, value, _ in rows(test)}
    assert test.energies is not None
    for name, value in (
        ("largest force at A", test.peaks["A"].value * 1e-3),
        ("largest force at B", test.peaks["B"].value * 1e-3),
        ("energy absorbed", test.energies["absorbed"]),
        ("loading rate", test.loading_rate * 1e-9),
        ("first touch", test.touch * 1e6),
    ):
        assert float(shown[name].split()[0]) == pytest.approx(value, rel=1e-3), name
    assert shown["first touch"] == f"{test.touch * 1e6:.1f} us"
    # half the rise of sin² from a quarter of its length to its half: 12.5 kN in 30 us
    assert test.loading_rate == pytest.approx(12.5e3 / 30e-6, rel=0.05)


def test_the_sheet_the_forces_and_the_pulse(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    waves().to_csv(tmp_path / "one.csv", index=False)
    text = (
        'title = "A <b>test</b>"\n[incident_bar]\nE = "200 GPa"\ndensity = "7850 '
        'kg/m3"\ndiameter = "20 mm"\n'
        'length = "1.5 m"\ngauge = "0.75 m"\n[receiving_bar]\ngauge = "0.6 m"\n[record]\nfile = '
        '"one.csv"\n'
    )
    (tmp_path / "one.toml").write_text(text)
    assert (
        main(
            [
                "shpb",
                "records",
                str(tmp_path / "one.toml"),
                "--out",
                str(tmp_path / "out"),
                "--json",
            ]
        )
        == 0
    )
    content = json.loads(capsys.readouterr().out)
    assert content["forces"]["B"]["sound"]
    page = (tmp_path / "out/sheet.html").read_text()
    assert "A &lt;b&gt;test" in page
    assert "two waves" in page
    assert "<svg" in page
    pulse = pd.read_csv(tmp_path / "out/pulse.csv")
    assert pulse["strain [microstrain]"][lambda strain: strain > 400.0].median() == pytest.approx(
        800.0, abs=8.0
    )
    assert abs(pulse["strain [microstrain]"].iloc[-1]) < 20.0
    forces = pd.read_csv(tmp_path / "out/forces.csv")
    assert forces["B [kN]"].max() == pytest.approx(25.0, rel=0.03)
    (tmp_path / "two.toml").write_text(text.replace("one.csv", "none.csv"))
    assert main(["shpb", "records", str(tmp_path / "two.toml")]) == 6
    (tmp_path / "three.toml").write_text(text.replace("[record]", "[record]\nfoo = 1"))
    assert main(["shpb", "records", str(tmp_path / "three.toml")]) == 2
    assert "record.foo" in capsys.readouterr().err
    (tmp_path / "again.toml").write_text(text)
    both = [str(tmp_path / name) for name in ("one.toml", "again.toml")]
    assert main(["shpb", "records", *both, "--out", str(tmp_path / "many")]) == 0
    assert "again.toml: the record of one.toml: one test" in capsys.readouterr().err
    assert len((tmp_path / "many/tests.csv").read_text().splitlines()) == 3
    assert main(["shpb", "records", both[0], both[0]]) == 0
    assert "one.toml: the record of one.toml: one test" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["shpb", "nothing"])


def test_input_files_of_one_name_have_an_output_folder_each(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A campaign has a folder a day, and a `shot1.toml` in each."""
    text = (
        '[incident_bar]\nE = "200 GPa"\ndensity = "7850 kg/m3"\ndiameter = "20 mm"\n'
        'length = "1.5 m"\ngauge = "0.75 m"\n[receiving_bar]\ngauge = "0.6 m"\n[record]\nfile = '
        '"one.csv"\n[specimen]\nname = '
    )
    places = ["monday/shot1.toml", "tuesday/shot1.toml", "tuesday/shot2.toml"]
    for place in places:
        path = tmp_path / place
        path.parent.mkdir(exist_ok=True)
        waves().to_csv(path.with_name("one.csv"), index=False)
        path.write_text(f'{text}"{place}"\n')
    files = [str(tmp_path / place) for place in places]
    assert main(["shpb", "records", *files, "--out", str(tmp_path / "out")]) == 0
    names = [*places[:2], "shot2"]
    assert pd.read_csv(tmp_path / "out/tests.csv")["test"].tolist() == names
    for name, place in zip(names, places, strict=True):
        assert place in (tmp_path / "out" / name / "sheet.html").read_text()


def test_the_shipped_record(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = Path(__file__).parents[2] / "studies/lab_gauge_records.toml"
    assert main(["shpb", "records", str(study), "--json"]) == 0
    forces = json.loads(capsys.readouterr().out)["forces"]
    # what is doubted of one face is not the width of the interval beside the mean
    ((of_a,), (of_mean,)) = (forces[face]["doubts"] for face in ("A", "mean"))
    assert of_a.startswith("poorly determined: its 95 % interval is ±19%")
    assert of_mean == f"A: {of_a}"
    # the scene that it was computed from bears 2.5 to 2.8 kN when it breaks
    assert forces["B"]["low"] < 2.7e3 < forces["B"]["high"]


def test_an_excitation_may_have_its_unit() -> None:
    from pydantic import ValidationError

    from uqsphere.labs.shpb.document import BarTable

    bar = {"gauge": "0.1 m", "E": "200 GPa", "density": "7850 kg/m3", "diameter": "20 mm"}
    for given in ("5 V", "5000 mV", 5.0):
        assert BarTable.model_validate({**bar, "excitation": given}).excitation == 5.0
    with pytest.raises(ValidationError, match="unknown unit 'kg' for a voltage"):
        BarTable.model_validate({**bar, "excitation": "5 kg"})
