"""What `uqsphere history` says and draws of the bars: signals, forces, fields, as tables, pictures and lines."""

from __future__ import annotations

import base64
import csv
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb

import uqsphere
from uqsphere.cli import main
from uqsphere.errors import StudyError
from uqsphere.mechanics.field import field_at
from uqsphere.mechanics.gauges import gauge_strain
from uqsphere.mechanics.history import view_field
from uqsphere.report.figures.canvas import inline, render
from uqsphere.report.figures.history import draw_forces, draw_gauges, force_rows, wave_forces
from uqsphere.report.figures.scene import draw_field
from uqsphere.runner.deterministic import history_summary

GAUGES = ('[[gauges]]\nbar = "incident"\nposition = "0.25 m"\n[[gauges]]\nbar = "receiving"\nposition = "150 mm"\n'
          '[[gauges]]\nbar = "incident"\nposition = "50 mm"\n')  # fmt: skip


@pytest.fixture(scope="module")
def written(tmp_path_factory, small_text):
    """The folder that `history` writes, the document it prints, and the history itself."""
    folder = tmp_path_factory.mktemp("bars")
    path = folder / "study.toml"
    path.write_text(small_text + GAUGES, encoding="utf-8")
    return folder, path, uqsphere.history(uqsphere.load_study(path))


def table(path: Path) -> dict[str, np.ndarray]:
    rows = list(csv.reader(io.StringIO(path.read_text("utf-8"))))
    return {name: np.array([float(row[k]) for row in rows[1:]]) for k, name in enumerate(rows[0])}


def test_the_files_and_what_is_in_them(written, capsys):
    folder, path, history = written
    assert main(["history", str(path), "--out", str(folder / "out"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    names = {Path(name).name for name in document["written"]}
    assert {"gauges.csv", "gauges.svg", "bar_forces.csv", "forces.svg", "field.csv", "field.svg"} <= names
    signals = table(folder / "out" / "gauges.csv")
    assert list(signals) == ["time [us]", "incident 250 mm [microstrain]", "receiving 150 mm [microstrain]",
                             "incident 50 mm [microstrain]"]  # fmt: skip
    times = signals["time [us]"] * 1e-6
    np.testing.assert_allclose(
        signals["receiving 150 mm [microstrain]"],
        gauge_strain(history.motion, "receiving", 0.15, times) * 1e6,
        atol=1e-3,
    )
    field = table(folder / "out" / "field.csv")
    there = field["place [m]"] > 0.0
    expected = field_at(history.motion, "receiving", field["place [m]"][there], field["time [us]"][there] * 1e-6)
    # a front within the rounding of the table's microseconds is on one side or the other
    close = np.abs(field["stress [MPa]"][there] - expected.stress * 1e-6) < 1e-6 * np.abs(expected.stress).max()
    assert close.mean() > 0.999
    forces = table(folder / "out" / "bar_forces.csv")
    scale = forces["contact A [N]"].max()
    np.testing.assert_allclose(forces["two waves (A) [N]"], forces["contact A [N]"], atol=1e-6 * scale)
    np.testing.assert_allclose(forces["one wave (B) [N]"], forces["contact B [N]"], atol=1e-6 * scale)
    assert document["equilibrium"]["level"] == 0.05
    assert document["gauges"][2]["overlaps"][0]["second"] == "reflected"
    assert document["first_tension"]["incident"]["position"] == pytest.approx(0.1, rel=1e-3)


def test_python_has_the_gauges(written):
    history = written[2]
    assert [(record.bar, record.position) for record in history.gauges] == [
        ("incident", 0.25), ("receiving", 0.15), ("incident", 0.05),
    ]  # fmt: skip
    assert all(np.isfinite(record.strain).all() for record in history.gauges)


def test_the_lines_tell_the_overlap(written):
    lines = history_summary(written[2])["lines"]
    overlaps = [text for name, text in lines if name == "overlap at the gauge incident 50 mm"]
    assert overlaps[0].startswith("incident wave and reflected")
    assert dict(lines)["first tension in the incident bar"].endswith("from the sphere")


def test_pictures_have_their_words(written):
    history = written[2]
    for draw, words in (
        (
            draw_gauges,
            ("incident bar, 0.25 m", "receiving bar, 0.15 m", "reflected", "transmitted", "[µs]"),
        ),
        (draw_forces, ("two waves", "contact B", "imbalance R")),
        (
            lambda found: draw_field(view_field(found)),
            ("axial stress [MPa]", "VII", "VIII", "X", "XI", "V", "incident"),
        ),
    ):
        svg = render(draw(history))
        assert all(f">{word}" in svg or word in svg for word in words), draw
        assert "mathdefault" not in svg
        assert svg == render(draw(history))
        assert len(re.findall("nan", svg)) == 0


def test_gauges_that_allow_no_wave_analysis_say_why(study_from, small_text):
    one = small_text + '[[gauges]]\nbar = "incident"\nposition = "50 mm"\n'
    history = uqsphere.history(study_from(text=one))
    assert force_rows(history) is None
    assert "no gauge on the receiving bar" in draw_forces(history).finding
    both = one + '[[gauges]]\nbar = "receiving"\nposition = "50 mm"\n'
    found, reason = wave_forces(uqsphere.history(study_from(text=both)))
    assert found is None
    assert "overlaps with its reflection" in reason


def test_endless_bars_without_lengths_have_no_gauge_of_their_own(study_from, small_text, tmp_path):
    lines = [line for line in small_text.splitlines() if "_length" not in line and "_end =" not in line]
    text = "\n".join([*lines, ""]).replace("[bars]", "[bars]\ninfinite = true")
    study = study_from(text=text)
    history = uqsphere.history(study)
    assert history.gauges == ()
    from uqsphere.report.figures.history import write_history

    names = {path.name for path in write_history(history, study, tmp_path)}
    assert "gauges.svg" not in names
    assert "field.svg" in names
    placed = uqsphere.history(study_from(text=text + GAUGES))
    assert len(placed.gauges) == 3


def test_gauges_do_not_change_the_hash(study_from, small_text):
    assert study_from(text=small_text + GAUGES).hash == study_from().hash
    assert "gauges" in study_from(text=small_text + GAUGES).resolved()
    assert "gauges" not in study_from().resolved()


@pytest.mark.parametrize(
    ("gauge", "words"),
    [
        ('bar = "left"\nposition = "1 mm"', "allowed: incident or receiving"),
        ('bar = "incdent"\nposition = "1 mm"', "did you mean 'incident'"),
        ('bar = 3\nposition = "1 mm"', "found 3"),
        ('bar = "incident"', "position is missing"),
        ('position = "1 mm"', "bar is missing"),
        ('bar = "incident"\nposition = "1 kg"', "unknown unit"),
        ('bar = "incident"\nposition = "-1 mm"', "must be above 0"),
        ('bar = "incident"\nposition = 0.1', "unit"),
        ('bar = "incident"\nposition = "0.5 m"', "beyond the far end of the incident bar"),
        ('bar = "incident"\nposition = "1 mm"\nplace = 3', "unknown key"),
        ('bar = "incident"\nposition = "1 mm"\n[[gauges]]\nbar = "incident"\nposition = "1 mm"', "named twice"),
        ("\n[[gauges]]\n".join(['bar = "incident"\nposition = "1 mm"'] * 21), "at most 20"),
    ],
)
def test_wrong_gauges_of_a_study_are_refused(study_from, small_text, gauge, words):
    with pytest.raises(StudyError, match=words):
        study_from(text=f"{small_text}[[gauges]]\n{gauge}\n")


def test_a_black_box_has_no_gauges(study_from, box_text):
    with pytest.raises(StudyError, match=r"\[gauges\] belongs to a scene"):
        study_from(text=box_text + GAUGES)


def _light(colour: np.ndarray) -> float:
    """Relative luminance of WCAG 2.2."""
    linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def test_the_picture_of_the_bars_survives_the_way_into_a_page(written):
    picture = draw_field(view_field(written[2]))
    text = inline(render(picture), "field")
    found = re.findall(r'<image[^>]* href="([^"]*)"', text)
    assert found
    for address in found:
        kind, _, data = address.partition(",")
        assert kind == "data:image/png;base64"
        assert base64.b64decode(data.strip(), validate=True).startswith(b"\x89PNG")
    # a name is read on the darkest stress: what shows through its ground leaves it the contrast of a text
    names = picture.figure.axes[0].texts
    assert {name.get_text() for name in names} >= {"incident", "VII"}
    for name in names:
        ground = np.array(to_rgb(name.get_bbox_patch().get_facecolor()))
        seen = name.get_bbox_patch().get_alpha() * ground + (1 - name.get_bbox_patch().get_alpha()) * np.zeros(3)
        assert _light(seen) + 0.05 >= 4.5 * (_light(np.array(to_rgb(name.get_color()))) + 0.05)
    # a finding first: the range of the stress
    assert picture.finding.startswith("The bars carry between −")
