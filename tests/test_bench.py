"""The benchmark: rivals that solve the same problem, ratios that mean what they say, files that can be read."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.campaigns import sweep
from uqsphere.bench import (
    METHODS,
    Entry,
    bench_scenes,
    bench_text,
    describe_machine,
    ratio_at_error,
    ratios,
    run_bench,
    scattered_scene,
    solve_scipy,
    speed_error_figure,
)
from uqsphere.errors import FolderError
from uqsphere.mechanics.integrator.solve import integrate
from uqsphere.mechanics.integrator.tracked import ANSWER_CONTACT, ANSWER_X_MAX
from uqsphere.report.figures.canvas import render, style


def entry(contender: str, seconds: float, error: float, **others: str) -> Entry:
    return Entry(
        scene=others.get("scene", "A"), contender=contender, tolerance=1e-6, rows=8, seconds_per_row=seconds,
        median=error, worst=10.0 * error, quantity="p_max",
    )  # fmt: skip


def test_scene_a_lies_where_it_is_said_to_lie() -> None:
    scales = scattered_scene(4000).scales
    assert np.median(scales.mass_number) == pytest.approx(3e-3, rel=0.02)
    assert np.median(scales.pulse_number) == pytest.approx(3.0, rel=0.02)


@pytest.mark.parametrize("method", METHODS)
def test_general_integrators_find_what_ours_finds(method: str) -> None:
    tolerance = 1e-6
    for chosen in bench_scenes(2):
        contact = "contact_time" in chosen.quantities
        if contact and method != "DOP853":  # the others take the same way, and much longer
            continue
        ours = integrate(chosen.scene, tolerance=1e-10, quantities=chosen.quantities).answers
        found = solve_scipy(chosen.scene, 1, method, tolerance, contact=contact)
        assert found[0, 0] == pytest.approx(ours[0, ANSWER_X_MAX], rel=50.0 * tolerance)
        if contact:
            assert found[0, 1] == pytest.approx(ours[0, ANSWER_CONTACT], rel=50.0 * tolerance)


def test_ratios_are_read_at_equal_error() -> None:
    ours = [entry("full", 10e-6, 1e-6), entry("full", 30e-6, 1e-10)]
    rival = [entry("solve_ivp DOP853", 1e-3, 1e-4), entry("solve_ivp DOP853", 4e-3, 1e-8)]
    # on straight lines of logarithms: 2 ms and 10 us at 1e-6
    assert ratio_at_error(ours + rival, "A", "p_max", "solve_ivp DOP853", 1e-6) == pytest.approx(200.0)
    assert ratio_at_error(ours + rival, "A", "p_max", "solve_ivp DOP853", 1e-12) is None
    assert ratio_at_error(ours, "A", "p_max", "solve_ivp LSODA", 1e-6) is None
    assert {r["rival"] for r in ratios(ours + rival)} >= {"solve_ivp DOP853"}


def test_tables_and_figures_can_be_read() -> None:
    entries = [entry("full", 10e-6, 1e-6), entry("massless", 1e-7, 1e-3), entry("full", 20e-6, 1e-8, scene="B")]
    cost = {
        "rows": [(10.0, 50.0), (100.0, 20.0)],
        "mu": [(1e-3, 20.0)],
        "theta": [(1.0, 10.0)],
        "threads": [(1.0, 9.0)],
    }
    content = {
        "machine": describe_machine(), "ratios": ratios(entries), "cost": cost,
        "limits": {"memory [MB]": {"found": 300.0, "aim": "below 1,000"}},
        "scenes": [{"name": "A", "text": "infinite bars", "reference_gap": {"p_max": 1e-12}}],
    }  # fmt: skip
    text = bench_text(content, entries)
    assert "| massless |" in text
    assert "not measured" in text
    with style():
        assert "seconds per million rows" in render(speed_error_figure(entries))


def test_the_machine_is_described_without_naming_anybody() -> None:
    described = json.dumps(describe_machine())
    assert Path.home().name not in described or Path.home().name in ("", "root")
    assert "/" not in json.loads(described)["python"]


def test_a_folder_of_something_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(FolderError, match="no benchmark"):
        run_bench(tmp_path, quick=True, notice=lambda text: None)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_the_sweep_from_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert sweep.main(["3", "--seed", "4"]) == 0
    assert "wrong and silent: 0 rows" in capsys.readouterr().out
