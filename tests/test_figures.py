"""The figures: well-formed, without numbers that are none, and without labels that overlap, whatever the names."""

from __future__ import annotations

import base64
import csv
import io
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.text import Text
from report_folders import limit, put, with_pairs, write_folder
from scenes import example

import uqsphere
from uqsphere.cli import main
from uqsphere.errors import StudyError
from uqsphere.mechanics.field import field_at, gauge_strain
from uqsphere.mechanics.history import view_field
from uqsphere.report import history_figure, xt_figure
from uqsphere.report.contents import read_contents
from uqsphere.report.figures.canvas import Picture, inline, render, style
from uqsphere.report.figures.distributions import (
    convergence_figure,
    distribution_figure,
    sensitivity_figure,
    speed_figure,
)
from uqsphere.report.figures.fragility import fragility_figure
from uqsphere.report.figures.history import draw_forces, draw_gauges, force_rows, wave_forces
from uqsphere.report.figures.scene import draw_field, force_band_figure
from uqsphere.runner.deterministic import history_summary

LONG = "Schwingungsdämpferhalterungsverschraubungsvorspannkraft"
SMALL_FIGURE = 300_000
#: side of a numeral that browsers and measuring fonts may differ by [px]
SLACK = 1.0


DRAWINGS: dict[str, Callable[[Any], Picture | None]] = {
    "distribution": lambda c: distribution_figure(c, next(iter(c.results.quantities))),
    "sensitivity": lambda c: sensitivity_figure(c, next(iter(c.results.quantities))),
    "fragility": lambda c: fragility_figure(c, next(iter(c.results.limits))),
    "convergence": convergence_figure,
    "speed": speed_figure,
    "force band": force_band_figure,
}


def check_svg(text: str) -> ElementTree.Element:
    """The root of an SVG that is small, well-formed and free of numbers that are none."""
    root = ElementTree.fromstring(text)
    assert len(text) < SMALL_FIGURE
    for element in root.iter():
        for key, value in element.attrib.items():
            if key in ("d", "x", "y", "transform", "points", "width", "height", "viewBox"):
                assert not re.search(r"(?i)nan|inf", value), (element.tag, key, value[:80])
    assert any(element.tag.endswith("title") and element.text for element in root)
    return root


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> Callable[[Picture], list[tuple[str, Any]]]:
    """Draws a picture and gives the texts with the boxes [px] in which they were drawn."""
    texts: list[Text] = []
    original = Text.draw

    def record(self: Text, renderer: Any) -> None:
        if self.get_visible() and self.get_text().strip():
            texts.append(self)
        original(self, renderer)

    def draw(picture: Picture) -> list[tuple[str, Any]]:
        texts.clear()
        with style(), monkeypatch.context() as patch:
            patch.setattr(Text, "draw", record)
            renderer: Any = picture.figure.canvas.get_renderer()  # type: ignore[attr-defined]
            picture.figure.draw(renderer)
            # the box of an annotation takes in its arrow, so the text's own is asked for
            boxes = {id(t): (t.get_text(), Text.get_window_extent(t, renderer)) for t in texts}
        whole = picture.figure.bbox
        for words, box in boxes.values():
            assert box.x0 >= whole.x0 - SLACK, words
            assert box.x1 <= whole.x1 + SLACK, words
            assert box.y0 >= whole.y0 - SLACK, words
            assert box.y1 <= whole.y1 + SLACK, words
        return list(boxes.values())

    return draw


def assert_apart(boxes: list[tuple[str, Any]]) -> None:
    for k, (words, box) in enumerate(boxes):
        for others, other in boxes[k + 1 :]:
            across = min(box.x1, other.x1) - max(box.x0, other.x0)
            up = min(box.y1, other.y1) - max(box.y0, other.y0)
            assert across <= 0.0 or up <= SLACK, f"{words!r} overlaps {others!r}"


@pytest.mark.parametrize("kind", list(DRAWINGS))
@pytest.mark.parametrize("length", [30, 300])
def test_labels_stand_apart_and_inside_at_any_length(
    tmp_path: Path, drawn: Callable[[Picture], list[tuple[str, Any]]], kind: str, length: int
) -> None:
    word = (LONG * 6)[:length]
    inputs = ("striker.speed", *(f"{word} {k}" for k in range(19)))
    names = (f"{word}q", f"{word}r", f"{word}s")
    limits = {f"{word}{k}": limit(0.0075, 0.01, True, quantity=names[0]) for k in range(3)}
    folder = write_folder(tmp_path, quantities=names, inputs=inputs, limits=limits, censored=0.2)
    contents = read_contents(with_pairs(folder))
    picture = DRAWINGS[kind](contents)
    boxes = drawn(picture)
    assert len(boxes) > 3
    assert_apart(boxes)
    svg = render(picture)
    check_svg(svg)
    check_svg(inline(svg, picture.name))


@pytest.mark.parametrize("aim", ["survive", "break"])
@pytest.mark.parametrize("miss", [1e-5, 0.0099, 0.97])
def test_fragility_keeps_its_labels_apart(
    tmp_path: Path, drawn: Callable[[Picture], list[tuple[str, Any]]], aim: str, miss: float
) -> None:
    limits = {"x": limit(miss, 0.01, None, aim=aim, half=1e-6)}
    picture = fragility_figure(read_contents(write_folder(tmp_path, limits=limits)), "x")
    assert picture is not None
    assert_apart(drawn(picture))


def test_a_planned_point_beyond_the_axis_is_an_arrow_and_no_flat_curve(tmp_path: Path) -> None:
    """A probability of 1e-16 is not drawn as one of 1e-6."""
    folder = write_folder(tmp_path, limits={"x": limit(3.9e-16, 0.01, True, half=1e-17)})
    contents = read_contents(folder)
    curve = [list(point) for point in contents.results.margins["x"].curve]
    low = [[point[0], 1e-30, 1e-31, 1e-29] for point in curve[:6]]
    contents = put(contents, {"results/margins/x/curve": [*low, *curve[6:]]})
    picture = fragility_figure(contents, "x")
    axes = picture.figure.axes[0]
    marks = [line for line in axes.lines if line.get_marker() in ("D", "v", "^")]
    assert [line.get_marker() for line in marks] == ["v"]
    drawn = max(axes.lines, key=lambda line: len(line.get_xdata()))
    assert min(drawn.get_ydata()) < axes.get_ylim()[0]
    assert marks[0].get_ydata()[0] == pytest.approx(axes.get_ylim()[0])


def test_errors_far_below_what_was_asked_leave_the_others_their_room(tmp_path: Path) -> None:
    contents = read_contents(write_folder(tmp_path))
    contents = put(contents, {f"results/speed_error/{len(contents.results.speed_error) - 1}/error": 1e-14})
    picture = convergence_figure(contents)
    axes = picture.figure.axes[0]
    assert axes.get_ylim()[0] == pytest.approx(1e-3)
    assert "not shown: 1 below 0.001" in [text.get_text() for text in axes.get_legend().get_texts()]


def test_dollars_and_markup_are_drawn_as_they_stand(tmp_path: Path) -> None:
    name = "<b>$\\frac{1}{$ & \x00"
    folder = write_folder(tmp_path, quantities=(name,), limits={name: limit(0.01, 0.02, True, quantity=name)})
    contents = read_contents(with_pairs(folder))
    for kind, draw in DRAWINGS.items():
        picture = draw(contents)
        assert picture is not None
        root = check_svg(render(picture))
        assert kind == "force band" or "<b>$\\frac{1}{$ &" in "".join(root.itertext())


def test_settings_of_the_user_neither_matter_nor_change(tmp_path: Path) -> None:
    import matplotlib

    contents = read_contents(write_folder(tmp_path, limits={"x": limit(0.01, 0.02, True)}))

    def text() -> str:
        picture = distribution_figure(contents, "p_max")
        assert picture is not None
        return render(picture)

    plain = text()
    with matplotlib.rc_context({"font.size": 30.0, "svg.fonttype": "path", "axes.grid": True}):
        before = dict(matplotlib.rcParams)
        assert text() == plain
        assert dict(matplotlib.rcParams) == before


def test_areas_of_a_density_are_shares(tmp_path: Path) -> None:
    contents = read_contents(write_folder(tmp_path, quantities=("contact_time",), censored=0.25))
    picture = distribution_figure(contents, "contact_time")
    axes = picture.figure.axes[0]
    width = float(np.diff(axes.get_xlim())[0])
    (bar,) = [p for p in axes.patches if p.get_hatch()]
    assert bar.get_width() * bar.get_height() / width == pytest.approx(0.25)
    heights, edges, _ = axes.patches[0].get_data()
    # the last thousandth on either side lies outside the drawing
    assert np.sum(heights * np.diff(edges)) / width == pytest.approx(0.75, abs=0.01)


@pytest.fixture(scope="module")
def scene_and_history() -> tuple[Any, Any]:
    from uqsphere.mechanics.history import trace

    scene = example()
    return scene, trace(scene, tolerance=1e-6)


def test_history_shows_the_peak_and_the_end_of_contact(
    scene_and_history: tuple[Any, Any], drawn: Callable[[Picture], list[tuple[str, Any]]]
) -> None:
    from uqsphere.report.figures.history import draw_history

    _, history = scene_and_history
    svg = history_figure(history)
    root = check_svg(svg)
    text = "".join(root.itertext())
    # the worked example of docs/theory.md: 3.0208635 GPa, 1.52195874 ms
    assert "3.021 GPa" in text
    assert "at 1.522 ms" in text
    assert history_figure(history) == svg
    assert_apart(drawn(draw_history(history)))


def test_xt_diagram_shows_ends_and_when_waves_are_back(scene_and_history: tuple[Any, Any]) -> None:
    from uqsphere.report.figures.history import draw_xt

    _, history = scene_and_history
    text = "".join(check_svg(xt_figure(history)).itertext())
    assert "incident bar, free end" in text
    axes = draw_xt(history).figure.axes[0]
    lines = [np.array(line.get_data(), dtype=float) for line in axes.lines]
    # the front of the pulse reaches the sphere at time zero, and its reflection a round trip later
    assert any((line[:, 0] == 0.0).all() and (np.diff(line) < 0.0).all() for line in lines)
    trip = 3.0 / np.sqrt(210e9 / 7850.0) * 1e6
    assert any(line[0, 0] == 0.0 and abs(line[1, 0] - trip) < 1e-6 * trip for line in lines)


# --- what `uqsphere history` says and draws of the bars: signals, forces, fields, as tables, pictures and lines


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
    series = {f"{name}.{kind}" for name in ("history", "gauges") for kind in ("csv", "svg")}
    assert series | {"bar_forces.csv", "forces.svg", "field.csv", "xt.svg", "stress.svg"} <= names
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


def test_the_lines_tell_the_overlap(written):
    lines = history_summary(written[2])["lines"]
    overlaps = [text for name, text in lines if name == "overlap at the gauge incident 50 mm"]
    assert overlaps[0].startswith("incident wave and reflected")
    assert dict(lines)["first tension in the incident bar"].endswith("from the sphere")


def test_pictures_have_their_words(written):
    history = written[2]
    for draw, words in (
        (draw_gauges, ("incident bar, 0.25 m", "receiving bar, 0.15 m", "reflected", "transmitted", "[µs]")),
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


def test_xt_diagram_shows_the_gauges(written):
    from uqsphere.report.figures.history import draw_xt

    axes = draw_xt(written[2]).figure.axes[0]
    upright = [line.get_xdata()[0] for line in axes.lines if len(set(line.get_xdata())) == 1]
    assert {-0.25, -0.05, 0.15} <= set(upright)
    assert [text.get_text() for text in axes.texts].count("gauge") == 3


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

    names = {path.name for path in write_history(history, tmp_path)}
    assert "gauges.svg" not in names
    assert "xt.svg" in names
    placed = uqsphere.history(study_from(text=text + GAUGES))
    assert len(placed.gauges) == 3


def test_gauges_do_not_change_the_hash(study_from, small_text):
    assert study_from(text=small_text + GAUGES).hash == study_from().hash
    assert "gauges" in study_from(text=small_text + GAUGES).resolved()
    assert "gauges" not in study_from().resolved()


@pytest.mark.parametrize(
    ("gauge", "words"),
    [
        ('bar = "left"\nposition = "1 mm"', "allowed: incident, receiving or rod"),
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
