"""What a laboratory reads off its tests: real records, faults put into clean ones, files as they come, calibration."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from report_folders import html_errors

from tests.campaigns.inverse import Made, make_test, peak_coverage, rig_of, scene_of_test
from uqsphere.arrays import Array
from uqsphere.cli import main
from uqsphere.records.inverse import Rig
from uqsphere.records.laboratory import Reading, calibrate, read_test
from uqsphere.records.pulse import Bar
from uqsphere.records.record import Wiring, make_record, mend
from uqsphere.records.table import RecordError, Table, beside, read_table
from uqsphere.runner.deterministic import history_of, history_summary
from uqsphere.study import load_study

REAL = os.environ.get("UQSPHERE_RECORDS", "")
real = pytest.mark.skipif(not REAL, reason="UQSPHERE_RECORDS names no folder of real records")
#: what the Rae and others bars are, as their authors published them
TITANIUM = {"bars.E": 110e9, "bars.density": 4430.0, "bars.nu": 0.33, "bars.diameter": 0.05}
ROCK = {"sphere.E": 52e9, "sphere.nu": 0.25, "sphere.radius": 0.018, "sphere.density": 2650.0}


@pytest.fixture(scope="module")
def clean() -> Made:
    return make_test(scene_of_test(), noise=1e-6, offset=1e-5, rng=np.random.default_rng(2))


def four(made: Made) -> Table:
    """Two gauges a bar: a little bending, in noise of their own."""
    time, first, second = made.table.values.T
    rng = np.random.default_rng(4)
    gauges = [1.03 * first, 0.97 * first, 0.98 * second, 1.02 * second]
    gauges = [one + 1e-6 * rng.normal(size=len(time)) for one in gauges]
    return Table(names=("time", "A1", "A2", "B1", "B2"), units=("s", "", "", "", ""),
                 values=np.column_stack([time, *gauges]))  # fmt: skip


def read_back(made: Made, table: Table, polarity: str = "auto") -> Reading:
    columns = {name: float(column[0]) for name, column in made.scene.columns.items()}
    record = mend(make_record(table, 2), polarity)
    return read_test(record, rig_of(made.scene), columns, sphere=False)


def test_a_clean_test_has_its_forces_and_energies(clean: Made) -> None:
    read = read_back(clean, four(clean))
    truth = clean.forces(read.forces.time + read.faces.pulse.begin - clean.begin)
    for face, true in zip("AB", truth, strict=True):
        peak = read.peaks[face]
        assert not peak.doubts
        assert peak.low < true.max() < peak.high
        assert abs(peak.value / true.max() - 1.0) < 0.03
    whole = read.energies[1]
    assert 0.0 < whole.absorbed < 0.2 * whole.incident
    assert read.withheld == ("the specimen is said to be no sphere",)


def changed(table: Table, column: int, change: object) -> Table:
    values = table.values.copy()
    values[:, column] = change(values[:, column], values[:, 0])  # type: ignore[operator]
    return replace(table, values=values)


def spike(at: float, size: float, samples: int = 1) -> object:
    def put(values: np.ndarray, time: np.ndarray) -> np.ndarray:
        k = int(np.searchsorted(time, at))
        values[k : k + samples] += size
        return values

    return put


def burst(values: np.ndarray, time: np.ndarray) -> np.ndarray:
    inside = (time > 60e-6) & (time < 75e-6)
    return np.where(inside, values + 1.5e-4 * np.sin(2.0 * np.pi * time / 3e-6), values)


# fault: column, what is done to it, words of a change (None: refused or doubted)
FAULTS: dict[str, tuple[int, object, str]] = {
    "spike on the peak of the incident wave": (1, spike(300e-6, -5e-3), "a spike"),
    "spike on the reflected wave": (2, spike(600e-6, 4e-4, 2), "a spike"),
    "spike at the largest force": (3, spike(565e-6, -2e-4), "a spike"),
    "spike in both gauges of a bar": (4, spike(565e-6, -6e-4, 3), "a spike"),
    "spike of five samples": (3, spike(540e-6, 3e-3, 5), "a spike"),
    "spike at the foot": (1, spike(201e-6, 2e-4), "a spike"),
    "trigger noise of three samples": (1, spike(30e-6, -9e-4, 3), "a spike"),
    "trigger noise that lasts": (1, burst, "noise of the trigger"),
    "trigger noise in a receiving gauge": (3, burst, "noise of the trigger"),
    "an offset": (2, lambda v, t: v + 5e-5, "a baseline of"),
    "drift": (3, lambda v, t: v + 0.012 * t, "a drift of"),
    "drift of an incident gauge": (1, lambda v, t: v - 0.05 * t, "a drift of"),
    "one gauge wired the other way": (2, lambda v, t: -v, "the sign is turned"),
    "a receiving gauge wired the other way": (4, lambda v, t: -v, "the sign is turned"),
    "a dead incident gauge": (1, lambda v, t: 1e-6 * np.random.default_rng(1).normal(size=len(t)), "left out"),
    "a dead receiving gauge": (4, lambda v, t: np.zeros(len(t)), "stand alone"),
    "a weak gauge": (3, lambda v, t: 0.1 * v, "left out"),
    "gaps of five samples": (3, lambda v, t: np.where(np.arange(len(t)) % 200 < 5, np.nan, v), "samples are filled"),
    "one clipped gauge": (3, lambda v, t: np.maximum(v, 0.7 * v.min()), "is clipped"),
    "a clipped incident gauge": (1, lambda v, t: np.maximum(v, 0.8 * v.min()), "is clipped"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_mended_and_told_of(clean: Made, fault: str) -> None:
    column, change, words = FAULTS[fault]
    read = read_back(clean, changed(four(clean), column, change))
    assert any(words in note for note in read.notes), read.notes
    truth = clean.forces(read.forces.time + read.faces.pulse.begin - clean.begin)
    for face, true in zip("AB", truth, strict=True):
        peak = read.peaks[face]
        slack = 0.01 * true.max()
        assert peak.low - slack < true.max() < peak.high + slack, (face, peak, true.max())
        # of one gauge alone nobody knows the bending
        assert peak.doubts or abs(peak.value / true.max() - 1.0) < (0.07 if "gauge" in fault else 0.04)


# with one gauge a bar nothing can stand for it: doubted or refused, never silent
ALONE: dict[str, tuple[int, object, str]] = {
    "clipped receiving gauge": (2, lambda v, t: np.maximum(v, 0.7 * v.min()), "at least this"),
    "a wrong gain": (2, lambda v, t: 2.0 * v, "the other face bears"),
    "clipped incident gauge": (1, lambda v, t: np.maximum(v, 0.7 * v.min()), "is clipped"),
    "a dead gauge": (2, lambda v, t: 1e-6 * np.random.default_rng(1).normal(size=len(t)), "no wave"),
    "a long gap in the incident wave": (1, lambda v, t: np.where((t > 250e-6) & (t < 290e-6), np.nan, v), "missing"),
    "beyond what it bears": (1, lambda v, t: v, "such a specimen can bear"),
}  # fmt: skip


@pytest.mark.parametrize("fault", ALONE)
def test_what_cannot_be_mended_is_doubted_or_refused(clean: Made, fault: str) -> None:
    column, change, words = ALONE[fault]
    columns = {name: float(values[0]) for name, values in clean.scene.columns.items()}
    try:
        record = mend(make_record(changed(clean.table, column, change), 2))
        bound = 1000.0 if "beyond" in fault else math.inf
        read = read_test(record, rig_of(clean.scene), columns, sphere=False, bound=bound)
        said = " ".join(read.peaks["B"].doubts)
    except RecordError as error:
        said = str(error)
    assert words in said


def test_peaks_are_inside_their_intervals_as_often_as_they_say() -> None:
    many = 40
    for share in peak_coverage(many).values():
        assert share > 0.95 - 4.0 * math.sqrt(0.95 * 0.05 / many)


def test_an_elastic_sphere_is_not_seen_where_there_is_none(clean: Made) -> None:
    columns = {name: float(values[0]) for name, values in clean.scene.columns.items()}
    rig = rig_of(clean.scene)
    record = mend(make_record(clean.table, 2))
    seen = read_test(record, rig, columns)
    assert seen.inverse is not None
    assert not seen.withheld
    # a crushable column: the force stops growing at half its largest
    strain = record.strain.copy()
    yields = np.maximum(strain[:, 1], 0.5 * strain[:, 1].min())
    delay = round((rig.receiving_gauge - rig.incident_gauge) / rig.bar.wave_speed / record.step)
    strain[:, 0] += np.roll(yields - strain[:, 1], -delay)
    strain[:, 1] = yields
    read = read_test(replace(record, strain=strain), rig, columns | {"sphere.E": 1e9})
    assert read.inverse is None
    assert "GPa" in " ".join(read.withheld)


# --- files as they come --------------------------------------------------------------------------------

STEP = 8e-7
ROWS = [(3e-3 + STEP * k, 1e-3 * (k * k % 17), -2e-3 * k) for k in range(60)]


def lines_of(between: str, comma: bool = False) -> str:
    text = "\n".join(between.join(f"{value:.9e}" for value in row) for row in ROWS)
    return text.replace(".", ",") if comma else text


def sheet() -> bytes:
    cells = ['<c r="A1" t="s"><v>0</v></c><c r="C1" t="s"><v>1</v></c><c r="D1" t="s"><v>1</v></c>']
    cells += ["".join(f'<c r="{letter}{k + 2}"><v>{value!r}</v></c>' for letter, value in zip("ACD", row, strict=True))
              for k, row in enumerate(ROWS)]  # fmt: skip
    space = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    rows = "".join(f"<row>{row}</row>" for row in cells)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as book:
        book.writestr(
            "xl/worksheets/sheet1.xml", f'<worksheet xmlns="{space}"><sheetData>{rows}</sheetData></worksheet>'
        )
        book.writestr(
            "xl/sharedStrings.xml", f'<sst xmlns="{space}"><si><t>time [s]</t></si><si><t>U [V]</t></si></sst>'
        )
    return stream.getvalue()


def raw() -> str:
    """Metadata beside the numbers, begin and step of the clock above them, as LANL's .raw."""
    numbers = [(-5e-5, -5e-5), (STEP, STEP), *((row[1], row[2]) for row in ROWS)]
    said = ["Test Date\t12/1/2006", "System ID\tHE", "Gain\t200", *["\t"] * 60]
    head = "Test\tValue\tIncident [V]\tTransmitted [V]\n"
    return head + "\n".join(f"{text}\t{a!r}\t{b!r}" for text, (a, b) in zip(said, numbers, strict=False))


FILES: dict[str, tuple[bytes, tuple[str, ...]]] = {
    "quoted lines, CR alone, decimal comma": (
        ('"Starttime;22.03.2016"\r"Kanal;DMS 1,0m (0.A1);DMS 2 (0.A2);"\r"Zeit;Signal;Signal;"\r"s;V;V;"\r\r'
         + "\r".join(f'"{line}"' for line in lines_of(";", True).split("\n"))).encode(), ("s", "V", "V")),
    "separator at the end": (
        ("Samplerate;1250000 Hz\r\n\r\nChannel;A1;A2;\r\ns;V;V;\r\n" + lines_of(";").replace("\n", ";\r\n")).encode(),
        ("s", "V", "V")),
    "metadata beside the numbers": (
        "\n".join((f'"Sample Interval",{STEP},s,' if k == 1 else '"Record Length",60,,' if k == 0 else ",,,") + line
                  for k, line in enumerate(lines_of(",").split("\n"))).encode(), ("", "", "")),
    "a spreadsheet with an empty column": (sheet(), ("s", "V", "V")),
    "metadata beside, clock above": (raw().encode(), ("s", "V", "V")),
    "no time, a sample rate": (
        ("# Sampling rate: 1250 kHz\nU1 [V]\tU2 [V]\n" + "\n".join(f"{a!r}\t{b!r}" for _, a, b in ROWS)).encode(),
        ("s", "V", "V")),
}  # fmt: skip


@pytest.mark.parametrize("kind", FILES)
def test_a_file_is_read_as_it_comes(tmp_path: Path, kind: str) -> None:
    data, units = FILES[kind]
    path = tmp_path / "record.csv"
    path.write_bytes(data)
    table = read_table(path)
    assert table.units == units
    assert table.values.shape == (60, 3)
    assert np.abs(np.diff(table.values[:, 0]) / STEP - 1.0).max() < 1e-6
    assert np.allclose(table.values[:, 1:], np.array(ROWS)[:, 1:], rtol=1e-8, atol=0.0)


def test_columns_by_number_and_gauges_of_a_bar(clean: Made) -> None:
    table = four(clean)
    named = make_record(table, 2, columns=["time", "A1+A2", "B1+B2"])
    counted = make_record(table, 2, columns=["1", "2+3", "4+5"])
    assert (named.strain == counted.strain).all()
    assert named.bars == ((0, 1), (2, 3))
    with pytest.raises(RecordError, match="a number from 1 to 5 names one too"):
        make_record(table, 2, columns=["1", "2", "6"])
    both = make_record(replace(table, units=("s", "V", "V", "V", "V")), 2,
                       wiring=[Wiring(excitation=5.0), Wiring(excitation=10.0)])  # fmt: skip
    assert np.allclose(both.strain[:, 2], 0.2 * table.values[:, 3])


def test_channels_in_files_of_their_own_have_one_clock(clean: Made) -> None:
    time, first, second = clean.table.values.T
    one, two = (Table(names=("t", name), units=("s", ""), values=np.column_stack([time, values])[:last])
                for name, values, last in (("a", first, None), ("b", second, -7)))  # fmt: skip
    both = beside(one, two)
    assert both.names == ("t", "a", "b")
    assert (both.values == clean.table.values[:-7]).all()
    assert "the longer one is cut" in both.notes[-1]
    for wrong in (two.values[:, 0] + 1e-4, 1.5 * two.values[:, 0]):
        other = replace(two, values=np.column_stack([wrong, two.values[:, 1]]))
        with pytest.raises(RecordError, match="do not go together"):
            beside(one, other)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="a system without pipes")
def test_a_pipe_or_a_device_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    for path in (tmp_path / "pipe.csv", Path(os.devnull)):
        with pytest.raises(RecordError, match="not a regular file"):
            read_table(path)


# --- calibration, unequal bars, the command ------------------------------------------------------------


def shot(speed: float, gain: tuple[float, float]) -> tuple[Table, Rig]:
    """Bars in touch: one wave passes both gauges."""
    bar = Bar(radius=0.02, wave_speed=4900.0, nu=0.3)
    time = 5e-7 * np.arange(3000)
    wave = np.clip(np.minimum(time - 100e-6, 350e-6 - time) / 30e-6, 0.0, 1.0)
    strain = (
        -0.5
        * 8.0
        / speed
        * np.stack([wave / gain[0], np.interp(time - 1.6 / speed, time, wave, left=0.0) / gain[1]], axis=1)
    )
    strain += 1e-6 * np.random.default_rng(3).normal(size=strain.shape)
    table = Table(names=("t", "a", "b"), units=("s", "", ""), values=np.column_stack([time, strain]))
    return table, Rig(bar=bar, incident_gauge=0.9, receiving_gauge=0.7)  # fmt: skip


def test_a_shot_without_a_specimen_gives_speed_and_gains() -> None:
    table, rig = shot(5020.0, (1.04, 0.97))
    found = calibrate(mend(make_record(table, 2)), rig, striker_speed=8.0)
    assert abs(found.wave_speed / 5020.0 - 1.0) < 1e-3
    assert abs(found.gains[0] / 1.04 - 1.0) < 5e-3
    assert abs(found.gains[1] / 0.97 - 1.0) < 5e-3
    broken = mend(make_record(changed(table, 2, lambda v, t: v * np.cos(3e4 * t)), 2))
    with pytest.raises(RecordError, match="only"):
        calibrate(broken, rig)


def test_unequal_bars_have_forces_equilibrium_and_energies_and_no_sphere(clean: Made) -> None:
    columns = {name: float(values[0]) for name, values in clean.scene.columns.items()}
    rig, record = rig_of(clean.scene), mend(make_record(clean.table, 2))
    alike = read_test(record, rig, columns)
    soft = 0.4 * columns["bars.E"] * math.pi * rig.bar.radius**2
    read = read_test(record, replace(rig, receiving_bar=rig.bar), columns, receiving=soft)
    assert "two equal bars" in read.withheld[0]
    assert read.inverse is None
    assert read.balance == 0.0
    # the gauge of a bar with 0.4 of the stiffness says 0.4 of the force, and of the energy that goes on
    assert read.peaks["B"].value == pytest.approx(0.4 * alike.peaks["B"].value, rel=1e-9)
    assert alike.energies is not None
    assert read.energies is not None
    for own, other in zip(read.energies, alike.energies, strict=True):
        assert own.incident == other.incident
        assert own.transmitted == pytest.approx(0.4 * other.transmitted, rel=1e-9)


def test_an_end_called_absorbing_is_warned_of(clean: Made) -> None:
    columns = {name: float(values[0]) for name, values in clean.scene.columns.items()}
    record = mend(make_record(clean.table, 2))
    rig = replace(rig_of(clean.scene), absorbing_length=0.5)
    assert any("called absorbing" in note for note in read_test(record, rig, columns, sphere=False).notes)


STUDY = """\
title = "cylinders"
seed = 1
[sphere]
E = "52 GPa"
nu = 0.25
density = "2650 kg/m3"
radius = "18 mm"
[bars]
E = "110 GPa"
nu = 0.33
density = "4430 kg/m3"
diameter = "50 mm"
incident_length = "2.5 m"
receiving_length = "2.5 m"
receiving_end = "free"
[striker]
speed = "10 m/s"
length = "0.25 m"
[analysis]
quantities = ["p_max"]
"""


def test_a_folder_of_tests_in_one_call(clean: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "tests"
    folder.mkdir()
    for name, table in (("one", four(clean)), ("two", changed(four(clean), 3, spike(565e-6, -5e-3)))):
        lines = [",".join(table.names), *(",".join(f"{value:.9g}" for value in row) for row in table.values)]
        (folder / f"{name}.csv").write_text("\n".join(lines), encoding="utf-8")
    (folder / "three.csv").write_bytes(b"%PDF-1.7")
    c = {name: float(values[0]) for name, values in clean.scene.columns.items()}
    text = (STUDY.replace('"110 GPa"', f'"{c["bars.E"]} Pa"').replace('"4430 kg/m3"', f'"{c["bars.density"]} kg/m3"')
            .replace('"50 mm"', f'"{c["bars.diameter"]} m"').replace('"18 mm"', '"10 mm"')
            .replace('incident_length = "2.5 m"\nreceiving_length = "2.5 m"\nreceiving_end = "free"', "infinite = true")
            )  # fmt: skip
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    asked = ["records", str(folder), "--study", str(tmp_path / "study.toml"), "--incident-gauge", "0.75 m",
             "--receiving-gauge", "0.6 m", "--specimen", "other", "--out", str(tmp_path / "out")]  # fmt: skip
    assert main(asked) == 0
    said = capsys.readouterr().out
    assert "refused" in said
    assert "this is a PDF" in said
    with open(tmp_path / "out" / "tests.csv", encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["test"] for row in rows] == ["one.csv", "two.csv"]
    assert {"diameter_mm", "force_kN", "modulus_GPa", "outcome"} < rows[0].keys()
    assert abs(float(rows[1]["force_kN"]) / float(rows[0]["force_kN"]) - 1.0) < 0.01
    assert "three.csv" in (tmp_path / "out" / "index.html").read_text("utf-8")
    page = (tmp_path / "out" / "two" / "sheet.html").read_text("utf-8")
    assert "is taken out" in page
    assert page.count("<svg") == 2
    assert html_errors(page) == []


@real
def test_real_records_agree_with_what_their_authors_published(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    asked = ["records", REAL, "--study", str(tmp_path / "study.toml"), "--gauge-factor", "1.99", "--excitation", "5",
             "--amplification", "400", "--incident-gauge", "1.25 m", "--receiving-gauge", "1 m", "--specimen", "other",
             "--correct-dispersion", "--json"]  # fmt: skip
    assert main(asked) == 0
    found = {test["file"]: test for test in json.loads(capsys.readouterr().out)["tests"]}
    with open(Path(REAL) / "published.csv", encoding="utf-8", newline="") as stream:
        published = list(csv.DictReader(stream))
    assert len(published) == 7
    for row in published:
        peak = found[row["record"]]["largest_force"]["B"]
        assert not peak["doubts"]
        assert abs(peak["value"] * 1e-3 / float(row["peak_force_kN_strength_times_area"]) - 1.0) < 0.03
        # the energy of a cylinder that holds is a small difference of large ones
        energy = found[row["record"]]["energy"]["whole"]
        assert abs(energy["absorbed"] - float(row["absorbed_energy_J"])) < 0.06 * energy["incident"]
    # bars, gains and units of the other files are others: they are read, doubted or refused, none ends in an error
    assert found["lanl_cu.raw"]["kind"] == "refused"
    assert found["essai80.txt"]["largest_force"]["B"]["doubts"]
    for name in ("shpbcalc.CSV", "tektronix_ch1.csv", "lanl_cu.raw", "essai80.txt"):
        assert len(read_table(Path(REAL) / name).values) > 600


def put(first: int, samples: int, size: float) -> Callable[[Array, int], Array]:
    def change(values: Array, peak: int) -> Array:
        values[peak + first : peak + first + samples] += size * abs(values[peak])
        return values

    return change


#: of a gauge in volts and the sample of its wave's peak; gauges 1 and 2 are on the incident bar
REAL_FAULTS: dict[str, tuple[int, Callable[[Array, int], Array]]] = {
    "spike on the incident peak": (1, put(0, 1, -3.0)),
    "three samples beside it": (2, put(-30, 3, 0.5)),
    "spike on the reflected wave": (1, put(600, 2, 0.6)),
    "spike on the force": (3, put(0, 1, -0.8)),
    "five samples on the rise": (3, put(-20, 5, 2.0)),
    "spike at the foot": (2, put(-250, 1, 0.2)),
    "trigger": (1, put(-1000, 3, 0.8)),
    "offset": (2, lambda v, k: v + 0.05 * abs(v[k])),
    "drift": (3, lambda v, k: v + 0.1 * abs(v[k]) * np.arange(len(v)) / len(v)),
    "drift of the incident bar": (1, lambda v, k: v - 0.2 * abs(v[k]) * np.arange(len(v)) / len(v)),
    "turned": (2, lambda v, k: -v),
    "turned at the other bar": (4, lambda v, k: -v),
    "dead": (1, lambda v, k: 5e-3 * np.random.default_rng(1).normal(size=len(v))),
    "dead, without noise": (4, lambda v, k: 0.0 * v),
    "weak": (3, lambda v, k: 0.1 * v),
    "gaps": (3, lambda v, k: np.where(np.arange(len(v)) % 200 < 5, np.nan, v)),
    "clipped": (3, lambda v, k: np.clip(v, -0.7 * abs(v).max(), 0.7 * abs(v).max())),
    "clipped at the incident bar": (1, lambda v, k: np.clip(v, -0.8 * abs(v).max(), 0.8 * abs(v).max())),
    "came off": (
        3,
        lambda v, k: np.where(np.arange(len(v)) < k - 40, v, np.where(np.arange(len(v)) % 300 < 150, -5.12, 3.0)),
    ),
    "at the end of its range": (4, lambda v, k: np.where(np.arange(len(v)) < k - 60, v, 5.12)),
}


@real
@pytest.mark.parametrize("fault", REAL_FAULTS)
def test_no_fault_in_a_real_record_is_wrong_and_silent(fault: str) -> None:
    volts = Wiring(gauge_factor=1.99, excitation=5.0, amplification=400.0)
    bar = Bar(radius=0.025, wave_speed=math.sqrt(110e9 / 4430.0), nu=0.33)
    rig = Rig(bar=bar, incident_gauge=1.25, receiving_gauge=1.0, incident_length=2.5, receiving_length=2.5,
              correct_dispersion=True)  # fmt: skip
    column, change = REAL_FAULTS[fault]
    for name in ("TaQu_006", "TaQu_001", "CaMa_SHPB_003", "SeeSst_SHPB_002", "SaLi_SHPB_003"):
        table = read_table(next(Path(REAL).glob(f"{name}*")))
        clean = read_test(mend(make_record(table, 2, wiring=volts)), rig, TITANIUM, sphere=False)
        first = clean.faces.pulse.begin - table.values[0, 0] + float(clean.faces.step * np.argmax(clean.faces.incident))
        later = (rig.incident_gauge + rig.receiving_gauge) / bar.wave_speed
        at = first if column < 3 else first + later
        values = table.values.copy()
        values[:, column] = change(values[:, column].copy(), round(at / clean.faces.step))
        read = read_test(mend(make_record(replace(table, values=values), 2, wiring=volts)), rig, TITANIUM, sphere=False)
        peak, true = read.peaks["B"], clean.peaks["B"].value
        assert peak.doubts or peak.low < true < peak.high or abs(peak.value / true - 1.0) < 0.07, name


@real
def test_a_rock_cylinder_is_no_elastic_sphere() -> None:
    volts = Wiring(gauge_factor=1.99, excitation=5.0, amplification=400.0)
    record = mend(make_record(read_table(Path(REAL) / "TaQu_003_Ti25_40b_Al12b_0_001.txt"), 2, wiring=volts))
    bar = Bar(radius=0.025, wave_speed=math.sqrt(110e9 / 4430.0), nu=0.33)
    rig = Rig(bar=bar, incident_gauge=1.25, receiving_gauge=1.0, incident_length=2.5, receiving_length=2.5)
    read = read_test(record, rig, TITANIUM | ROCK)
    assert read.inverse is None
    assert not read.broke


def test_an_elastic_contact_beyond_yield_is_told_of(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(STUDY.replace("[striker]", 'yield_strength = "790 MPa"\n[striker]'), encoding="utf-8")
    for speed, told in (("0.02 m/s", False), ("10 m/s", True)):
        summary = history_summary(history_of(load_study(path, [f'striker.speed="{speed}"'])))
        assert any("faces beside it yield" in text for _, text in summary["lines"]) == told
