"""The benchmark of the uncertainty engine: what it counts is right, what it writes can be read and is kept."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.campaigns import overhead, rough, study_runs, surrogates, uncertainty
from tests.campaigns.chaos import Measured
from tests.campaigns.coverage import CoverageRow, reference
from tests.campaigns.uncertainty import PARTS, Part, run_uncertainty, study_figure, surrogate_figure
from uqsphere.errors import FolderError, UsageError
from uqsphere.report.figures.canvas import render, style
from uqsphere.study import load_study, shipped_studies
from uqsphere.uq.expansion import chaos_moments, fit_chaos, judge, predict


def silent(text: str) -> None:
    """Progress that nobody reads."""


# --- the command and its folder -------------------------------------------------------------------


def test_a_folder_of_something_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(FolderError, match="no such benchmark"):
        uncertainty.main(["--quick", "--out", str(tmp_path)])
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    with pytest.raises(FolderError, match="no such benchmark"):
        run_uncertainty(tmp_path / "mine.txt", parts=["rough"], quick=True, notice=silent)


@pytest.mark.parametrize("text", ["{", "[]", '{"parts": 3}', '{"parts": {}, "schema_version": 99}'])
def test_a_damaged_benchmark_is_not_written_over(tmp_path: Path, text: str) -> None:
    (tmp_path / "uq.json").write_text(text, encoding="utf-8")
    with pytest.raises(FolderError, match=r"uq\.json"):
        run_uncertainty(tmp_path, parts=["rough"], quick=True, notice=silent)
    assert (tmp_path / "uq.json").read_text(encoding="utf-8") == text


def test_a_part_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="'colour'"):
        uncertainty.main(["chaos", "colour", "--out", str(tmp_path / "new")])
    assert not (tmp_path / "new").exists()
    with pytest.raises(UsageError, match="studies"):
        run_uncertainty(tmp_path, parts=[""], quick=True, notice=silent)


def fits(rival: bool) -> list[dict[str, Any]]:
    """Three fits: one better than its rival, one worse, one that hides its error."""
    found = []
    for model, true, reported, theirs in (("a", 1e-6, 2e-6, 1e-4), ("b", 1e-3, 1e-3, 5e-4), ("c", 1e-2, 1e-3, 1e-1)):
        found.append(asdict(Measured(
            model=model, samples=64, seed=1, true=true, reported=reported, seconds=0.2, chosen="least angles, identity",
            rival_true=theirs if rival else None, rival_seconds=2.0 if rival else None,
        )))  # fmt: skip
    return found


def cells() -> list[dict[str, Any]]:
    """Two cells of a kind, one of them too low."""
    return [
        asdict(CoverageRow(kind="mean", way="sampling", model=model, answer="y", points=128, repetitions=1000,
                           covered=covered, width=1.1, error=1e-3))
        for model, covered in (("one", 0.96), ("two", 0.90))
    ]  # fmt: skip


def test_parts_are_measured_one_by_one_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = dict(PARTS)
    answers = {
        "chaos": {"checked": 100, "peer": "1.0", "fits": fits(True)},
        "coverage": {"cells": cells(), "pooled": []},
    }
    for name, content in answers.items():
        part = Part(title=real[name].title, measure=lambda quick, notice, found=content: found, text=real[name].text,
                    figures=real[name].figures)  # fmt: skip
        monkeypatch.setitem(uncertainty.PARTS, name, part)
    out = tmp_path / "uq"
    assert uncertainty.main(["coverage", "--quick", "--out", str(out)]) == 0
    elsewhere = {"processor": "another", "system": "Linux", "python": "3.12", "packages": {"numpy": "2.0"}}
    monkeypatch.setattr(uncertainty, "_machine", lambda: elsewhere)
    found = run_uncertainty(out, parts=["chaos"], quick=False, notice=silent)
    assert list(found["parts"]) == ["chaos", "coverage"]
    stored = json.loads((out / "uq.json").read_text(encoding="utf-8"))
    assert stored == {key: value for key, value in found.items() if key != "text"}
    assert [stored["parts"][name]["quick"] for name in ("chaos", "coverage")] == [False, True]
    text = (out / "uq.md").read_text(encoding="utf-8")
    assert text == found["text"] + "\n"
    assert "another, Linux, Python 3.12; numpy 2.0." in text
    assert "another" not in text.split("uncertainty coverage`")[1]
    assert " On " in text.split("uncertainty coverage`")[1].split("\n")[0]
    assert "| 64 | 2 | 2 | 3 |" in text
    assert "| c | 1 | 0 | 1 | 0.1 |" in text
    assert "Lowest of 2 cells: 90.0%" in text
    assert "Pooled between 93.5% and 97%: 0 of 1 kinds" in text
    assert str(tmp_path) not in (out / "uq.json").read_text(encoding="utf-8") + text
    assert {path.name for path in (out / "figures").iterdir()} == {"chaos.svg", "coverage.svg"}


def test_without_the_peer_nothing_stands_beside() -> None:
    content = {"checked": 100, "fits": fits(False)}
    text = PARTS["chaos"].text(content)
    assert "Nothing stands beside it" in text
    assert "| 64 | 0 | 0 | 0 |" in text
    with style():
        (picture,) = PARTS["chaos"].figures(content)
        assert "nearer to the truth" not in render(picture)


# --- overhead -------------------------------------------------------------------------------------


def test_indices_of_the_five_input_models_are_those_of_many_points() -> None:
    for model in overhead.five_inputs():
        assert model.dimension == 5
        found = reference(model, count=2**13, replicates=8)
        for order, truths in (("first", model.first), ("total", model.total)):
            for (value, error), truth in zip(found[order], truths, strict=True):
                assert abs(value - truth) <= 5.0 * error + 1e-9, (model.name, order)


def test_sampling_goes_on_until_every_index_is_known() -> None:
    model = overhead.five_inputs()[0]
    run = overhead.ours(model, 3)
    assert run["half_width"] <= overhead.ASKED
    # the intervals are those of 95 %: the largest of ten errors lies within a few half-widths
    assert 0.0 < run["error"] < 3.0 * run["half_width"]
    assert run["evaluations"] % (16 * 64 * 7) == 0
    assert run["seconds"] > 0.0
    theirs = overhead.peer(model, 3, 1024)
    assert theirs["evaluations"] == 7 * 1024
    assert theirs["error"] < 0.02


def test_the_table_names_the_slowest() -> None:
    run = {"evaluations": 1024.0, "half_width": 1e-3, "error": 5e-4, "worst_error": 1e-3, "model_seconds": 0.01}
    models = [{"model": "m", "inputs": 5, "seeds": 3, "uqsphere": {**run, "seconds": 0.25},
               "SALib": {**run, "seconds": 1.5}}]  # fmt: skip
    text = overhead.text({"asked": 0.002, "due": 1.0, "models": models})
    assert "Slowest median: 0.250 s" in text
    assert overhead.figures({}) == []


# --- surrogates -----------------------------------------------------------------------------------


def test_granite_says_whether_it_came_as_far_as_is_due() -> None:
    known = [{"points": 128, "seed": seed, "error": error, "reported": reported, "usable": True, "terms": 10,
              "solver": "s", "transform": "identity"}
             for seed, error, reported in ((1, 2e-3, 1e-3), (2, 1e-6, 1e-6), (3, 1e-3, 1e-6))]  # fmt: skip
    content = {"study": "granite", "quantity": "p_max", "inputs": ["sphere.E"], "held_out": 64, "due": 1e-5,
               "scatter": 0.07, "fits": known}  # fmt: skip
    text = surrogates.text(content)
    assert "Below 1e-05 from 128 evaluations: 1 of 3 fits." in text
    assert "Of the 2 others 1 report" in text
    assert "| 128 | 1.0e-03 | 1.0e-06 | 2.0e-03 | 1.0e-06 | 2 of 3 |" in text
    with style():
        assert "reported by the fit" in render(surrogate_figure(content))


# --- the rough output -----------------------------------------------------------------------------


def test_plain_least_squares_finds_a_polynomial_and_refuses_too_many_terms() -> None:
    points = np.random.default_rng(4).standard_normal((40, 2))
    outputs = 2.0 + points[:, 0] + 0.5 * (points[:, 1] ** 2 - 1.0)
    chaos = rough.plain_chaos(points, outputs, 2)
    assert predict(chaos, points) == pytest.approx(outputs, abs=1e-12)
    assert chaos_moments(chaos) == pytest.approx((2.0, math.sqrt(1.5)), rel=1e-12)
    found, values = rough._answers_of(chaos)
    assert found["first striker.speed"] == pytest.approx(2.0 / 3.0)
    assert found["total striker.length"] == pytest.approx(1.0 / 3.0)
    assert found["quantile 0.5"] == pytest.approx(float(np.median(values)))
    with pytest.raises(ValueError, match="more terms than"):
        rough.plain_chaos(points[:10], outputs[:10], 9)


def test_the_contact_time_jumps_and_the_engine_sees_it(tmp_path: Path) -> None:
    from uqsphere.runner.evaluate import draw

    path = tmp_path / "grazing.toml"
    path.write_text(rough.study_text(20_000), encoding="utf-8")
    study = load_study(path)
    lengths = np.array([0.130, 0.133])
    below, above = rough._times(study, np.stack([np.full(2, 5.0), lengths], axis=1))
    assert above > 1.2 * below
    assert below < rough.LEVEL * 1e-6 < above
    points = draw(study.inputs().only(("striker.speed", "striker.length")), seed=5, task="test", start=0,
                  count=192, replicates=1)  # fmt: skip
    times = rough._times(study, points.inputs[0])
    true = float((times > rough.LEVEL * 1e-6).mean())
    found, _ = rough._answers_of(rough.plain_chaos(points.scores[0], times, 4))
    assert abs(found["probability"] / true - 1.0) > 0.1
    assert not judge(fit_chaos(points.scores[0], times, ("normal", "normal"))).usable


# --- studies --------------------------------------------------------------------------------------


def test_a_study_tells_what_it_reached_of_what_was_asked() -> None:
    run = study_runs._run(shipped_studies()["ishigami"], 20_000)
    assert 0 < run["evaluations"] <= 20_000
    assert {s["asked"] for s in run["series"]} == {0.002, 0.02, 0.05, 0.005}
    assert not run["met"]
    text = study_runs.text({"runs": [run]})
    assert "- ishigami: y: quantile 0.01: half-width" in text
    assert "| ishigami | y | largest half-width of an index | pick and freeze |" in text
    with style():
        for column, label in enumerate(("model evaluations", "seconds since the start")):
            assert label in render(study_figure({"runs": [run]}, column))


def test_every_part_has_a_title_and_stands_in_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        uncertainty.main(["--help"])
    told = "".join(capsys.readouterr().out.split())
    assert ",".join(PARTS) in told
