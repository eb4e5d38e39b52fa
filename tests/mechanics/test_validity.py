"""Validity checks: each trips where it should, keeps quiet where it should, and says so with
numbers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import EXAMPLE, example

from uqsphere.mechanics.closed_form import solve_closed
from uqsphere.mechanics.integrator import solve as dynamics
from uqsphere.mechanics.rigs import sphere_body
from uqsphere.mechanics.scene import Scene
from uqsphere.mechanics.validity import ADVICE, RULES, Measures, ValidityCheck, check_validity
from uqsphere.mechanics.yielding import Face

BASE = EXAMPLE | {
    "bars.yield_strength": 2.5e9,
    "bars.receiving_end": 0.0,
    "striker.length": 0.8,
    "striker.speed": 0.5,
    "pulse.rise": 50e-6,
    "pulse.fall": 50e-6,
}
#: infinite bars, told how long they are: waves would be back after 580 us, 193 us in the receiving
#: bar
SHORT = {"infinite": True, "horizon": 570e-6, "bars_receiving_length": 0.5}


def scene_with(shape: str = "trapezoid", rows: int = 1, **changes: object) -> Scene:
    # not a number stands for a column that is not given
    gone = [name.replace("_", ".", 1) for name, value in changes.items() if value is np.nan]
    given = {name: value for name, value in changes.items() if value is not np.nan}
    return example(shape, rows, numbers={k: v for k, v in BASE.items() if k not in gone}, **given)


def checks(scene: Scene, **values: object) -> dict[str, ValidityCheck]:
    """Checks of a scene; `values` replace answers, so that thresholds can be met exactly."""
    answers = dynamics.solve(scene, tolerance=1e-6)
    if values:
        changed = {
            name: np.broadcast_to(np.asarray(v, float), len(scene)) for name, v in values.items()
        }
        answers = replace(answers, values={**answers.values, **changed})
    return {check.check: check for check in check_validity(scene, answers)}


def test_every_rule_is_answered_in_order():
    found = checks(scene_with(sphere_onset_pressure=3e9, sphere_hardness=6e9))
    asked = [
        rule.name
        for rule in RULES.values()
        if rule.law != "plastic" and "striker" in (rule.movers or ("striker",))
    ]
    # no inserts, no plate, and bars that are not taken as infinite
    apart = ("insert_thickness", "before_reflection", "thin_plate", "plate_edge")
    assert list(found) == [name for name in dict.fromkeys(asked) if name not in apart]
    for check in found.values():
        assert 0.0 <= check.share <= 1.0
        assert bool(check.text) == (check.share > 0.0)


def test_every_rule_has_a_measure():
    assert {name for name in vars(Measures) if not name.startswith("_")} == RULES.keys()
    assert ADVICE.keys() <= RULES.keys()


@pytest.mark.parametrize(
    ("name", "quantity", "ok", "warning", "failure"),
    [
        ("small_contact", "a_max", 0.00199, 0.00201, 0.00301),
        ("contact_on_bar_end", "a_max", 0.00399, 0.00401, None),
        ("bar_yield_contact", "p_max", 1.614 * 2.5e9, 1.616 * 2.5e9, None),
        ("force_balance", "force_imbalance", 0.0499, 0.101, None),
        # 2 r/sqrt(E/rho) = 4.515 us
        ("quasi_static_sphere", "rise_time", 4.01 * 4.515e-6, 3.99 * 4.515e-6, 2.99 * 4.515e-6),
    ],
)
def test_thresholds_of_the_answers(name, quantity, ok, warning, failure):
    scene = scene_with()
    assert checks(scene, **{quantity: ok})[name].grade == 0
    found = checks(scene, **{quantity: warning})[name]
    assert found.shares[1:] == (1.0, 0.0)
    if failure is not None:
        found = checks(scene, **{quantity: failure})[name]
        assert found.shares[1:] == (0.0, 1.0)


def test_what_yields_is_told_with_what_the_static_law_says():
    """The bars begin at c(nu) Y, the sphere at its onset; pressure and dent come from the force
    alone.
    """
    soft = scene_with(
        bars_yield_strength=1.15e9, bars_nu=0.2, sphere_onset_pressure=1.5e9, sphere_hardness=3e9
    )
    found = checks(soft, p_max=2e9, P_max=4000.0)
    assert found["bar_yield_contact"].worst == pytest.approx(
        2.0 / (1.15 * 1.295 * np.exp(0.736 * 0.2))
    )
    assert found["sphere_yield_contact"].worst == pytest.approx(2.0 / 1.5)
    scales = soft.scales
    for name, body in (
        ("bar_yield_contact", soft.struck.body),
        ("sphere_yield_contact", sphere_body(soft.columns)),
    ):
        face = Face(
            **body._asdict(), modulus=scales.modulus, effective_radius=scales.effective_radius
        )
        press = face.pressed(face.depth_at(np.array([4000.0])))
        pressure, depth = press.p_max[0] / 1e9, 1e6 * press.dent_left[0]
        estimate = f"p_max up to {pressure:.3g} GPa, indentation {depth:.2g} um"
        assert estimate in found[name].text


@pytest.mark.parametrize(
    ("name", "changes", "grade", "worst"),
    [
        # rho c0 v0/2 = 20.3 MPa per m/s
        ("bar_yield_pulse", {"bars_yield_strength": 10.1e6}, 2, 1.00498),
        ("bar_yield_pulse", {"bars_yield_strength": 10.2e6}, 0, 0.99513),
        # bar radius/c0 = 3.8668 us
        ("one_dimensional_bars", {"pulse_rise": 19e-6}, 2, 4.9136),
        ("one_dimensional_bars", {"pulse_fall": 19e-6}, 2, 4.9136),
        ("one_dimensional_bars", {"pulse_rise": 19.5e-6}, 0, 5.0429),
        ("one_dimensional_bars", {"shape": "half_sine", "pulse_duration": 38e-6}, 2, 4.9136),
        ("one_dimensional_bars", {"shape": "half_sine", "pulse_duration": 39e-6}, 0, 5.0429),
        ("one_dimensional_bars", {"shape": "rectangular"}, 1, 0.0),
        ("force_level", {}, 1, 0.46581),
        ("force_level", {"infinite": True, "pulse_duration": 1.4e-3}, 0, 2.1082),
        # infinite bars of 1.5 m: the wave would be back after 580 us
        ("before_reflection", {"infinite": True, "horizon": 590e-6}, 1, 590 / 580.0246),
        ("before_reflection", {"infinite": True, "horizon": 570e-6}, 0, 570 / 580.0246),
        # a short receiving bar counts where its end reflects
        ("before_reflection", {**SHORT, "bars_receiving_end": 0.0}, 0, 570 / 580.0246),
        ("before_reflection", {**SHORT, "bars_receiving_end": 1.0}, 1, 3 * 570 / 580.0246),
    ],
)
def test_checks_of_the_scene(name, changes, grade, worst):
    found = checks(scene_with(**changes))[name]
    assert found.grade == grade
    assert found.share == float(grade > 0)
    assert found.worst == pytest.approx(worst, rel=1e-4)


def test_a_check_without_its_data_has_no_number():
    found = checks(scene_with(bars_yield_strength=np.nan))
    for name in ("bar_yield_contact", "bar_yield_pulse"):
        assert found[name].grade == 0
        assert found[name].worst is None
    # reflected waves are part of the model
    assert "before_reflection" not in found
    lengths = {"bars_incident_length": np.nan, "bars_receiving_length": np.nan}
    assert checks(scene_with(infinite=True, **lengths))["before_reflection"].worst is None


def test_two_peaks_count_with_their_higher_level():
    peaks = {"pulse_t1": 60e-6, "pulse_level1": 1.0, "pulse_t2": 150e-6, "pulse_level2": 1.5}
    found = checks(scene_with(shape="two_peak", **peaks))
    single = checks(scene_with())["bar_yield_pulse"].worst
    assert found["bar_yield_pulse"].worst == pytest.approx(1.5 * single, rel=1e-12)
    assert found["one_dimensional_bars"].worst == pytest.approx(60.0 / 3.8668, rel=1e-4)


def test_massless_answers_are_judged_by_the_mass_number():
    scene = scene_with(shape="rectangular", infinite=True)
    heavy = scene_with(shape="rectangular", infinite=True, sphere_density=2e5)
    light = {
        check.check: check for check in check_validity(scene, solve_closed(scene, "massless"))
    }["force_balance"]
    worse = {
        check.check: check for check in check_validity(heavy, solve_closed(heavy, "massless"))
    }["force_balance"]
    full = checks(scene)["force_balance"]
    assert 0.3 < light.worst / full.worst < 3.0
    assert worse.worst > 3.0 * light.worst


def test_shares_of_a_mixed_batch():
    scene = scene_with(rows=5, sphere_nu=np.array([0.25, 0.25, 0.25, 0.25, 0.7]))
    found = checks(scene, a_max=np.array([0.001, 0.0025, 0.0025, 0.0031, np.nan]))["small_contact"]
    # the fifth row has no answer and does not count
    assert found.shares == (0.0, 0.5, 0.25)
    assert found.share == 0.75
    assert found.worst == pytest.approx(0.31, rel=1e-12)
    # those beyond the limit that is named
    assert found.text.startswith("25 % of the samples")
    assert "0.31" in found.text
    # the threshold of the grade that the worst row reaches, not the mildest one
    assert "0.31 (limit 0.3)" in found.text
    milder = checks(scene, a_max=np.array([0.001, 0.0025, 0.0025, 0.0029, np.nan]))
    assert "0.29 (limit 0.2)" in milder["small_contact"].text


def test_a_number_that_few_rows_reach_is_told_with_what_most_keep():
    widths = np.full(100, 0.0021)
    scene = scene_with(rows=100)
    assert "in 95 %" not in checks(scene, a_max=widths)["small_contact"].text
    widths[:3] = 0.0161
    text = checks(scene, a_max=widths)["small_contact"].text
    assert text == (
        "3 % of the samples: the contact is not small, a/r up to 1.61 (0.21 in 95 % of the "
        "samples; limit 0.3)"
    )


def test_the_share_of_rows_outside_the_range_of_a_criterion():
    scene = scene_with(rows=4)
    found = dynamics.solve(scene, tolerance=1e-6)
    found = replace(
        found, values={**found.values, "a_max": np.array([0.001, 0.0025, 0.0029, 0.0035])}
    )
    *_, check = check_validity(scene, found, ("core_tension",))
    assert check.share == 0.25
    assert check.text.startswith("25 % of the samples")
    # only what lies outside is named, with the value furthest out
    assert check.text.endswith("equal forces), a/r = 0.35: the value at the table edge is used")


def test_no_answer_at_all():
    found = checks(scene_with(sphere_nu=0.7))
    assert all(check.grade == 0 and check.worst is None for check in found.values())


def test_an_endless_step_has_no_infinite_number():
    found = checks(scene_with(shape="step", infinite=True, horizon=1e-3))["force_level"]
    assert (found.grade, found.worst) == (0, None)
    assert "inf" not in found.text
