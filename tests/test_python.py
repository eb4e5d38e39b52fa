"""The Python interface: studies from texts and tables, what a notebook shows of a run, figures into given axes."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from report_folders import limit, write_folder

import uqsphere
from uqsphere.errors import StudyError, UsageError
from uqsphere.study.text import toml_text

TABLES = {
    "title": 'A sum, "quoted" \u00e9',
    "seed": 3,
    "inputs": {
        "x": {"dist": "normal", "mean": np.float64(0.0), "sd": 1.0},
        "y": {"dist": "uniform", "lower": 0, "upper": 1},
    },
    "outputs": {"names": ["z"]},
    "limits": {"high": {"quantity": "z", "strength": 2.5, "aim": "survive", "target": 0.05}},
    "analysis": {"budget": {"evaluations": 4000, "time": "1 min"}, "ways": "given"},
}


@pytest.fixture(autouse=True)
def closed_figures() -> Iterator[None]:
    from matplotlib import pyplot

    pyplot.switch_backend("Agg")
    yield
    pyplot.close("all")


def test_a_study_is_the_same_from_a_file_a_text_and_tables(tmp_path: Path) -> None:
    text = toml_text(TABLES)
    path = tmp_path / "sum.toml"
    path.write_text(text, encoding="utf-8")
    studies = [uqsphere.load_study(path), uqsphere.load_study(text=text), uqsphere.load_study(TABLES)]
    assert len({study.hash for study in studies}) == 1
    assert {study.title for study in studies} == {TABLES["title"]}
    assert repr(studies[2]) == "<Study 'A sum, \"quoted\" \u00e9': 2 random inputs, limits high, black box>"
    moved = uqsphere.load_study(TABLES, ("limits.high.strength=3",))
    assert moved.hash != studies[0].hash


@pytest.mark.parametrize(
    "value", ["a\tb\n\x00\x7f\\ \U0001f600", "", -1.5e-300, True, [1, [2.0, "x"]], {"a b": {"": 1}}, 10**18]
)
def test_what_tables_hold_is_read_again(value: object) -> None:
    assert tomllib.loads(toml_text({"k": value, "t": {"k": value}})) == {"k": value, "t": {"k": value}}


def test_what_no_study_can_hold_is_refused_with_its_place() -> None:
    with pytest.raises(UsageError, match=r"inputs\.x\.mean: found NoneType"):
        uqsphere.load_study({"inputs": {"x": {"dist": "normal", "mean": None}}})
    with pytest.raises(StudyError, match=r"study\.toml.*inputs\.x"):
        uqsphere.load_study({**TABLES, "inputs": {"x": {"dist": "gauss"}}})


def test_a_notebook_goes_from_tables_to_figures(tmp_path: Path) -> None:
    from matplotlib import pyplot

    run = uqsphere.run(uqsphere.load_study(TABLES), out=tmp_path / "r", model=lambda rows: {"z": rows["x"] + rows["y"]})
    assert repr(run).startswith(f"<Run in {str(tmp_path / 'r')!r}: high 0.0")
    shown = run._repr_html_()
    assert "<td>high</td>" in shown
    assert "A sum, &quot;quoted&quot;" in shown
    given = pyplot.figure().add_subplot()
    axes = run.plot.histogram("z", ax=given)
    assert axes is given
    assert sum(bar.get_width() * bar.get_height() for bar in axes.patches) == pytest.approx(1.0)
    drawn = run.plot.indices()
    named = zip(drawn.get_yticklabels(), drawn.patches, strict=True)
    bars = {text.get_text(): bar.get_width() for text, bar in named}
    # variances 1 and 1/12
    assert bars["x"] == pytest.approx(12 / 13, abs=0.02)
    with pytest.raises(UsageError, match=r"no quantity 'q' \(there are: z\)"):
        run.plot.histogram("q")
    with pytest.raises(UsageError, match="no limit with margins"):
        run.plot.fragility()


def test_a_fragility_curve_is_drawn_in_the_units_of_the_page(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, limits={"x": limit(0.01, 0.02, True)})
    axes = uqsphere.open_run(folder).plot.fragility()
    entry = uqsphere.open_run(folder).results.margins["x"]
    x, p = axes.lines[0].get_data()
    assert np.asarray(p).tolist() == [point.probability for point in entry.curve]
    assert np.asarray(x).tolist() == [point.value for point in entry.curve]
    assert axes.get_xlabel().startswith(entry.solve)


def test_the_public_names_are_shown() -> None:
    assert dir(uqsphere) == sorted([*uqsphere.__all__, "__version__"])


@pytest.mark.parametrize(("law", "names", "key"), [
    ('{ dist = "frechet", shape = 1e-3, scale = 1.0 }', '["y"]', "inputs.x.*beyond floating point"),
    ("1.0", "[]", "outputs.names"),
])  # fmt: skip
def test_what_overflows_or_has_no_output_is_a_fault_of_its_key(law: str, names: str, key: str) -> None:
    text = f"[inputs]\nx = {law}\n[outputs]\nnames = {names}\n[analysis]\naccuracy = {{ mean = 0.1 }}\n"
    with pytest.raises(StudyError, match=key):
        uqsphere.load_study(text=text)
