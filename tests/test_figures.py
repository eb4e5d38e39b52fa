"""The figures: well-formed, without numbers that are none, and without labels that overlap, whatever the names."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.text import Text
from report_folders import estimate, limit, put, with_pairs, write_folder

from uqsphere.report import history_figure, xt_figure
from uqsphere.report.claims import ranked, shares_claim
from uqsphere.report.contents import read_contents
from uqsphere.report.figures import limits
from uqsphere.report.figures.canvas import Picture, inline, render, spread, style
from uqsphere.report.figures.convergence import Series, _labelled, convergence_figure, speed_figure
from uqsphere.report.figures.distributions import distribution_figure
from uqsphere.report.figures.fragility import fragility_figure, margin_figure
from uqsphere.report.figures.indices import group_figure, pair_figure, sensitivity_figure
from uqsphere.report.figures.limits import _to_the_ends, surface_figure
from uqsphere.report.figures.scene import force_band_figure
from uqsphere.report.figures.swings import tornado_figure, waterfall_figure

LONG = "Schwingungsdämpferhalterungsverschraubungsvorspannkraft"
SMALL_FIGURE = 300_000
#: side of a numeral that browsers and measuring fonts may differ by [px]
SLACK = 1.0


def few_misses(contents: Any, name: str) -> Picture | None:
    """The samples of a limit with so few misses that a page leaves the picture out."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(limits, "_TELLING", 0)
        return surface_figure(contents, name)


DRAWINGS: dict[str, Callable[[Any], Picture | None]] = {
    "distribution": lambda c: distribution_figure(c, next(iter(c.results.quantities))),
    "sensitivity": lambda c: sensitivity_figure(c, next(iter(c.results.quantities))),
    "margin": margin_figure,
    "fragility": lambda c: fragility_figure(c, next(iter(c.results.limits))),
    "convergence": convergence_figure,
    "speed": speed_figure,
    "pairs": lambda c: pair_figure(c, next(iter(c.results.quantities))),
    "groups": lambda c: group_figure(c, next(iter(c.results.quantities))),
    "tornado": lambda c: tornado_figure(c, next(iter(c.results.quantities))),
    "waterfall": lambda c: waterfall_figure(c, next(iter(c.results.limits))),
    "surface": lambda c: few_misses(c, next(iter(c.results.limits))),
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
    assert any(element.tag.endswith("desc") and element.text for element in root)
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
    censored = 0.0 if kind in ("tornado", "surface") else 0.2
    folder = write_folder(tmp_path, quantities=names, inputs=inputs, limits=limits, censored=censored)
    contents = read_contents(with_pairs(folder))
    picture = DRAWINGS[kind](contents)
    assert picture is not None
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


@pytest.mark.parametrize(
    "margin", [(1.2, 1.21, 1.22), (0.5, 0.99, 1.01), (0.3, 4.0, 40.0), (2.0, 2.0, 2.0), (1.1, 2.0, None)]
)
def test_margin_keeps_its_labels_apart(
    tmp_path: Path, drawn: Callable[[Picture], list[tuple[str, Any]]], margin: tuple[float | None, ...]
) -> None:
    entry = limit(0.01, 0.02, True)
    entry["margin"] = {
        k: estimate(v, 1e-4, "unbounded") for k, v in zip(("0.05", "median", "0.95"), margin, strict=True)
    }
    contents = read_contents(write_folder(tmp_path, limits={"x": entry}))
    picture = margin_figure(contents)
    assert picture is not None
    assert_apart(drawn(picture))
    assert ("unbounded" in picture.finding) == (margin[2] is None)


def test_margins_that_span_decades_stand_on_a_logarithmic_axis(
    tmp_path: Path, drawn: Callable[[Picture], list[tuple[str, Any]]]
) -> None:
    """As of limestone in three ways: one margin of 10 to 32 squashed those of 1.2 to 4."""

    def figure(name: str, *spans: tuple[float, float, float]) -> Picture:
        entries = {}
        for k, span in enumerate(spans):
            margin = {key: estimate(v, 1e-4, "") for key, v in zip(("0.05", "median", "0.95"), span, strict=True)}
            entries[f"x{k}"] = {**limit(0.01, 0.02, True), "margin": margin}
        found = margin_figure(read_contents(write_folder(tmp_path / name, limits=entries)))
        assert found is not None
        assert_apart(drawn(found))
        return found

    wide = figure("wide", (1.24, 1.67, 2.25), (1.59, 2.56, 4.11), (9.88, 17.8, 32.3), (0.629, 0.629, 0.629))
    axes = wide.figure.axes[0]
    assert axes.get_xscale() == "log"
    assert axes.get_xlim()[0] < 0.629 < 32.3 < axes.get_xlim()[1]
    assert figure("narrow", (0.6, 1.67, 2.25), (1.59, 2.56, 4.11)).figure.axes[0].get_xscale() == "linear"
    # of demands that are next to nothing
    assert np.isfinite(figure("endless", (2e-10, 1.0, 1e304)).figure.axes[0].get_xlim()).all()


def test_a_planned_point_beyond_the_axis_is_an_arrow_and_no_flat_curve(tmp_path: Path) -> None:
    """A probability of 1e-16 is not drawn as one of 1e-6."""
    folder = write_folder(tmp_path, limits={"x": limit(3.9e-16, 0.01, True, half=1e-17)})
    contents = read_contents(folder)
    curve = [list(point) for point in contents.results.margins["x"].curve]
    low = [[point[0], 1e-30, 1e-31, 1e-29] for point in curve[:6]]
    contents = put(contents, {"results/margins/x/curve": [*low, *curve[6:]]})
    picture = fragility_figure(contents, "x")
    assert picture is not None
    axes = picture.figure.axes[0]
    marks = [line for line in axes.lines if line.get_marker() in ("D", "v", "^")]
    assert [line.get_marker() for line in marks] == ["v"]
    drawn = max(axes.lines, key=lambda line: len(line.get_xdata()))
    assert min(drawn.get_ydata()) < axes.get_ylim()[0]
    assert marks[0].get_ydata()[0] == pytest.approx(axes.get_ylim()[0])


def test_of_two_methods_for_one_question_the_better_is_labelled_and_none_below_the_axis() -> None:
    def series(method: str, error: float, quantity: str = "p_max") -> Series:
        return Series(
            method=method, quantity=quantity, kind="mean", asked=0.01, points=((10.0, 1.0, 9.0), (20.0, 2.0, error))
        )

    plain, controlled, tiny = series("sampled", 0.5), series("controlled", 0.1), series("sampled", 1e-9, "a_max")
    assert _labelled([plain, controlled, tiny]) == [controlled]


def test_errors_far_below_what_was_asked_leave_the_others_their_room(tmp_path: Path) -> None:
    contents = read_contents(write_folder(tmp_path))
    contents = put(contents, {f"results/speed_error/{len(contents.results.speed_error) - 1}/error": 1e-14})
    picture = convergence_figure(contents)
    assert picture is not None
    axes = picture.figure.axes[0]
    assert axes.get_ylim()[0] == pytest.approx(1e-3)
    assert "not shown: 1 below 0.001" in [text.get_text() for text in axes.get_legend().get_texts()]


def test_a_band_that_is_drawn_on_keeps_its_width() -> None:
    middles = np.array([40.0, 50.0, 60.0])
    band = np.array([[1.9, 2.0, 2.2], [2.45, 2.5, 2.55], [2.8, 3.0, 3.4]])
    places, found = _to_the_ends(middles, band, np.array([30.0, 90.0]))
    assert places.tolist() == [30.0, 40.0, 50.0, 60.0, 90.0]
    assert found[0] == pytest.approx([1.4, 1.5, 1.7])
    assert found[-1] == pytest.approx([4.3, 4.5, 4.9])


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


def test_bars_are_sorted_and_the_largest_is_named(tmp_path: Path) -> None:
    inputs = ("sphere.nu", "sphere.E", "striker.speed")
    folder = write_folder(tmp_path, inputs=inputs)
    contents = read_contents(folder)
    assert ranked(contents.results.sensitivity["p_max"]) == list(inputs)
    first, total = (f"results/sensitivity/p_max/{order}/striker.speed" for order in ("first", "total"))
    contents = put(contents, {first: estimate(0.7), total: estimate(0.9)})
    assert ranked(contents.results.sensitivity["p_max"])[0] == "striker.speed"
    finding = shares_claim(contents.results, "p_max").text
    assert finding.startswith("Speed of the striker drives 90 % with its interactions (70 % alone) of the variance")


def test_areas_of_a_density_are_shares(tmp_path: Path) -> None:
    contents = read_contents(write_folder(tmp_path, quantities=("contact_time",), censored=0.25))
    picture = distribution_figure(contents, "contact_time")
    assert picture is not None
    axes = picture.figure.axes[0]
    width = float(np.diff(axes.get_xlim())[0])
    (bar,) = [p for p in axes.patches if p.get_hatch()]
    assert bar.get_width() * bar.get_height() / width == pytest.approx(0.25)
    heights, edges, _ = axes.patches[0].get_data()
    # the last thousandth on either side lies outside the drawing
    assert np.sum(heights * np.diff(edges)) / width == pytest.approx(0.75, abs=0.01)


@given(st.lists(st.floats(0.0, 10.0), min_size=1, max_size=10))
@settings(max_examples=50, deadline=None)
def test_spread_keeps_a_gap_order_and_the_ends(wanted: list[float]) -> None:
    places = spread(wanted, 1.0, 0.0, 10.0)
    order = np.argsort(wanted, kind="stable")
    steps = np.diff(np.array(places)[order])
    assert np.all(steps >= 1.0 - 1e-9)
    assert min(places) >= -1e-9
    assert max(places) <= 10.0 + 1e-9


@pytest.fixture(scope="module")
def scene_and_history() -> tuple[Any, Any]:
    from uqsphere.mechanics.history import trace
    from uqsphere.mechanics.scene import Scene

    numbers = {
        "sphere.E": 52e9,
        "sphere.nu": 0.25,
        "sphere.radius": 0.01,
        "sphere.density": 2650.0,
        "bars.E": 210e9,
        "bars.nu": 0.3,
        "bars.density": 7850.0,
        "bars.diameter": 0.04,
        "bars.incident_length": 1.5,
        "bars.receiving_length": 1.5,
        "bars.incident_end": 1.0,
        "bars.receiving_end": 1.0,
        "striker.speed": 1.0,
        "striker.length": 0.4,
    }
    scene = Scene(columns={name: np.array([value]) for name, value in numbers.items()})
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


def test_xt_diagram_shows_arrival_and_reflections(
    scene_and_history: tuple[Any, Any], drawn: Callable[[Picture], list[tuple[str, Any]]]
) -> None:
    from uqsphere.report.figures.history import draw_xt

    scene, history = scene_and_history
    text = "".join(check_svg(xt_figure(scene, history)).itertext())
    trip = 3.0 / np.sqrt(210e9 / 7850.0) * 1e3
    assert f"back after {trip:.4g} ms" in text
    assert "incident bar, free end" in text
    picture = draw_xt(scene, history)
    assert_apart(drawn(picture))
    first = picture.figure.axes[0].lines[0]
    assert first.get_xdata()[-1] == 0.0
    assert first.get_ydata()[-1] == 0.0
