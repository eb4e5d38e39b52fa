"""The paper's formulas as printed: they must stay wrong in the way the errata say, and be reported
so.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scenes import ENDLESS, example
from scipy.integrate import quad
from scipy.optimize import brentq

from uqsphere.mechanics import as_printed
from uqsphere.mechanics.closed_form import loading_time, relaxing_approach, solve_closed
from uqsphere.mechanics.integrator import solve as dynamics
from uqsphere.mechanics.pulses import measured_pulse
from uqsphere.mechanics.scene import Scene
from uqsphere.results.paper import paper_row

SCENE = example(numbers=ENDLESS, infinite=True)


@pytest.fixture(scope="module")
def table():
    return {row.quantity: row for row in as_printed.compare_with_paper(SCENE)}


def test_where_6_715_comes_from():
    """Twice the time to 0.8904 alpha_max; the integral as it is printed, with x³/2, makes it
    4.726.
    """
    assert 4.0 * loading_time(0.8904) == pytest.approx(as_printed.DURATION_FACTOR, abs=1e-3)
    literal, _ = quad(lambda x: 1.0 / (1.0 - 0.5 * x**3), 0.0, 1.0)
    assert 4.0 * literal == pytest.approx(4.726, abs=1e-3)


def test_times_of_the_printed_force_curve():
    """Against the curve itself: alpha^(3/2) by (3.9)."""

    def force(t):
        return float(as_printed.approach(t, 1.0, 1.0)) ** 1.5

    assert as_printed.equivalent_duration(1.0) == pytest.approx(quad(force, 0.0, 1.0)[0], rel=1e-9)
    low, high = (
        brentq(lambda t: force(t) - 0.1, 0.0, 0.5),
        brentq(lambda t: force(t) - 0.9, 0.0, 0.5),
    )
    assert as_printed.rise_time(1.0) == pytest.approx(high - low, rel=1e-10)
    assert force(1.1) == 0.0


def test_the_missing_factor_two_after_the_pulse():
    """Printed, the approach falls as if twice the time had passed."""
    printed = as_printed.approach_after_pulse(3.0, 0.7, 1.0, 1.0)
    assert printed == pytest.approx(float(relaxing_approach(0.7, 6.0)), rel=1e-12)


def test_peaks_are_those_of_an_endless_step(table):
    scales = SCENE.scales
    step = replace(
        SCENE,
        shape="step",
        horizon=60.0 * float(scales.time[0]),
        columns={k: v for k, v in SCENE.columns.items() if k != "striker.length"},
    )
    endless = solve_closed(step, "massless").values
    for name in ("p_max", "P_max", "alpha_max", "a_max"):
        assert table[name].printed == pytest.approx(endless[name][0], rel=1e-12)
        assert table[name].printed > table[name].corrected
    assert table["P_max"].printed == pytest.approx(float(scales.force[0]), rel=1e-12)


def test_values_of_the_table(table):
    full = dynamics.solve(SCENE, tolerance=1e-8).values
    closed = solve_closed(SCENE, "massless").values
    for name in ("p_max", "P_max", "alpha_max", "a_max", "contact_duration", "rise_time"):
        assert table[name].full == full[name][0]
        assert table[name].corrected == closed[name][0]
    # contact is not lost within the record, whatever (3.8) says
    assert math.isnan(table["time_to_first_loss"].corrected)
    assert math.isnan(table["time_to_first_loss"].full)
    assert "not over within the evaluation window" in table["time_to_first_loss"].note
    half = table["mean_pressure_at_half_approach"]
    assert half.printed == pytest.approx(table["p_max"].printed / 3.0, rel=1e-12)
    assert half.corrected == pytest.approx(
        table["p_max"].corrected * 2.0 / 3.0 * math.sqrt(0.5), rel=1e-12
    )


def test_the_linear_plateau_is_printed_twice_too_high(table):
    row = table["linear_plateau"]
    assert row.printed == pytest.approx(2.0 * row.corrected, rel=1e-12)
    assert row.full == pytest.approx(row.corrected, rel=1e-6)


def test_a_light_sphere_confirms_the_corrected_values():
    """With mu -> 0 the full model meets the corrected column, and not the printed one."""
    columns = {**SCENE.columns, "sphere.density": np.array([20.0])}
    found = as_printed.compare_with_paper(replace(SCENE, columns=columns))
    rows = {row.quantity: row for row in found}
    for name in (
        "p_max",
        "approach_at_t_c",
        "approach_after_pulse",
        "linear_plateau",
        "mean_pressure",
    ):
        assert rows[name].full == pytest.approx(rows[name].corrected, rel=1e-2)
        assert abs(rows[name].printed / rows[name].full - 1.0) > 0.2


def test_other_pulses_and_finite_bars_are_compared_with_the_rectangle():
    finite = {
        "bars.incident_length": 1.5,
        "bars.receiving_length": 1.5,
        "bars.incident_end": 1.0,
        "bars.receiving_end": 1.0,
        "pulse.rise": 25e-6,
        "pulse.fall": 25e-6,
    }
    columns = {**SCENE.columns, **{name: np.array([value]) for name, value in finite.items()}}
    rows = {
        r.quantity: r
        for r in as_printed.compare_with_paper(Scene(columns=columns, shape="trapezoid"))
    }
    assert rows["p_max"].corrected == pytest.approx(
        solve_closed(SCENE, "massless").values["p_max"][0], rel=1e-12
    )
    assert rows["p_max"].full > 1.1 * rows["p_max"].corrected  # the reload
    assert math.isfinite(rows["time_to_first_loss"].full)


def test_a_measured_pulse_is_compared_with_the_rectangle_of_its_length():
    time = np.linspace(0.0, 200e-6, 401)
    record, _ = measured_pulse(time, 1e-4 * np.sin(math.pi * time / time[-1]))
    numbers = {name: value for name, value in ENDLESS.items() if name != "striker.length"}
    scene = example("measured", numbers=numbers, infinite=True, record=record)
    rows = {row.quantity: row for row in as_printed.compare_with_paper(scene)}
    assert rows["p_max"].full < rows["p_max"].corrected < rows["p_max"].printed


def test_numbers_are_shown_in_the_units_people_read(table):
    row = paper_row(table["p_max"])
    assert (row.name, row.unit) == ("peak contact pressure", "GPa")
    assert row.printed == pytest.approx(1e-9 * table["p_max"].printed, rel=1e-12)
    assert row.corrected == pytest.approx(1e-9 * table["p_max"].corrected, rel=1e-12)
    assert f"full model: {1e-9 * table['p_max'].full:.4g} GPa" in row.note
    assert paper_row(table["time_to_first_loss"]).corrected is None


def test_a_row_without_meaning_is_refused():
    columns = {**SCENE.columns, "sphere.nu": np.array([0.7])}
    with pytest.raises(ValueError, match="outside the domain"):
        as_printed.compare_with_paper(replace(SCENE, columns=columns))


def test_no_approach_of_the_full_model_after_the_end_of_its_motion():
    short = replace(SCENE, horizon=0.5 * float(SCENE.scales.time[0]))
    rows = {row.quantity: row for row in as_printed.compare_with_paper(short)}
    assert math.isnan(rows["approach_at_t_c"].full)
    assert math.isnan(rows["approach_after_pulse"].full)


@pytest.mark.slow
def test_a_study_prints_the_comparison_in_its_run_and_its_history(tmp_path, capsys):
    import uqsphere
    from uqsphere.cli import main
    from uqsphere.report.history import history_rows

    command = ["run", "studies/as_printed.toml", "--set", "analysis.budget.evaluations=512"]
    main([*command, "--out", str(tmp_path / "with")])
    terminal = capsys.readouterr().out
    rows = {row.name: row for row in uqsphere.open_run(tmp_path / "with").results.paper}
    peak = rows["peak contact pressure"]
    assert peak.unit == "GPa"
    assert peak.printed > peak.corrected > 0.0
    assert f"{peak.printed:.4g} GPa" in terminal
    assert f"{peak.corrected:.4g} GPa" in terminal
    study = uqsphere.load_study("studies/as_printed.toml")
    texts = dict(history_rows(uqsphere.history(study)))
    assert f"printed {peak.printed:.4g} GPa" in texts["paper: peak contact pressure"]

    main([*command, "--set", "model.compare_with_paper=false", "--out", str(tmp_path / "without")])
    assert f"{peak.printed:.4g} GPa" not in capsys.readouterr().out
    assert uqsphere.open_run(tmp_path / "without").results.paper == []
