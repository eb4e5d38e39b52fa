"""Histories: the example of theory section 3, contacts lost and found again, waves, jumps,
pressures.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scenes import example as granite

from tests.mechanics.test_answers_agree import random_scene
from uqsphere.mechanics import contact
from uqsphere.mechanics.closed_form import massless_approach
from uqsphere.mechanics.history import find_changes, trace
from uqsphere.mechanics.integrator import solve as dynamics

TOLERANCE = 1e-9


@pytest.fixture(scope="module")
def example():
    """Granite between two free bars: theory section 3."""
    return granite(), trace(granite(), tolerance=TOLERANCE)


def test_the_example_of_the_theory(example):
    scene, history = example
    assert history.first_peak.pressure == pytest.approx(3.0208635e9, rel=1e-7)
    assert history.first_peak.time == pytest.approx(728e-6, abs=1e-6)
    assert history.changes[0].time == pytest.approx(1.52195874e-3, rel=1e-7)
    assert (history.changes[0].face, history.changes[0].kind) == ("B", "lost")
    # the first loading alone: 2.554 GPa, before the reflected wave is back
    early = trace(replace(scene, first_loading_only=True), tolerance=TOLERANCE)
    assert early.first_peak.pressure == pytest.approx(2.5543e9, abs=5e4)
    assert early.first_peak.time < scene.first_echo[0]
    assert early.horizon == pytest.approx(float(scene.first_echo[0]), rel=1e-12)


def test_a_history_agrees_with_the_quantities(example):
    scene, history = example
    answers = dynamics.solve(scene, tolerance=TOLERANCE).values
    record = history.time <= history.record_end
    assert history.record_end == pytest.approx(answers["time_to_first_loss"][0], rel=10 * TOLERANCE)
    assert history.first_peak.pressure == pytest.approx(answers["p_max"][0], rel=10 * TOLERANCE)
    assert history.first_peak.force == pytest.approx(answers["P_max"][0], rel=10 * TOLERANCE)
    # the instants of the peaks are among those listed, so that the largest listed value is the peak
    largest = max(history.pressure_a[record].max(), history.pressure_b[record].max())
    assert largest == pytest.approx(history.first_peak.pressure, rel=1e-12)
    assert (history.mass_number, history.pulse_number) == (
        scene.scales.mass_number[0],
        scene.scales.pulse_number[0],
    )
    assert history.horizon == pytest.approx(float(scene.record_end[0]), rel=1e-12)


def test_contacts_are_lost_and_found_in_turn(example):
    _, history = example
    assert len(history.changes) > 4
    for face, approach in (("A", history.approach_a), ("B", history.approach_b)):
        own = [change for change in history.changes if change.face == face]
        assert [change.kind for change in own] == [
            ("lost", "found")[k % 2] for k in range(len(own))
        ]
        # between two changes of a face its approach has the sign that they say
        edges = [0.0, *(change.time for change in own), history.horizon]
        for k, (begin, end) in enumerate(pairwise(edges)):
            inside = (history.time > begin * (1 + 1e-9)) & (history.time < end * (1 - 1e-9))
            assert ((approach[inside] > 0.0) == (k % 2 == 0)).all()
    times = [change.time for change in history.changes]
    assert times == sorted(times)
    assert np.isin(times, history.time).all()


def test_a_lost_face_is_met_again_and_pressed_harder():
    """A 20 mm striker: a face is lost after 60 us, and the wave that comes back presses harder."""
    history = trace(granite(striker_length=0.02, bars_receiving_end=0.0), tolerance=TOLERANCE)
    assert [change.kind for change in history.changes[:2]] == ["lost", "found"]
    before = history.time < history.changes[0].time
    earlier = max(history.pressure_a[before].max(), history.pressure_b[before].max())
    assert history.first_peak.pressure > 1.4 * earlier
    after = history.time > history.record_end
    largest = max(history.pressure_a[after].max(), history.pressure_b[after].max())
    assert history.later_peak.pressure == pytest.approx(largest, rel=1e-12)
    assert history.later_peak.time > history.record_end


def test_jumps_stand_twice_with_both_values(example):
    scene, history = example
    end = float(scene.pulse.end[0])
    first, second = np.flatnonzero(history.time == end)
    assert second == first + 1
    assert history.incident[first] - history.incident[second] == pytest.approx(0.5, rel=1e-12)
    assert history.approach_a[first] == history.approach_a[second]
    # the front of the pulse, reflected, is back after one round trip: g_A starts with v0/2
    first, second = np.flatnonzero(history.time == scene.round_trips[0, 0])
    assert history.incident[second] - history.incident[first] == pytest.approx(0.5, rel=1e-12)


def test_the_instants_asked_for_do_not_change_the_answer(example):
    scene, history = example
    coarse = trace(scene, tolerance=TOLERANCE, points=2)
    assert coarse.changes == history.changes
    assert coarse.first_peak == history.first_peak
    assert len(coarse.time) < len(history.time)
    shared = np.isin(history.time, coarse.time)
    assert shared.sum() >= len(coarse.time) - 2
    assert (np.diff(history.time) >= 0.0).all()
    assert (history.time[0], history.time[-1]) == (0.0, history.horizon)


def test_pressure_over_the_contact(example):
    _, history = example
    peak = int(np.argmax(history.pressure_b))
    radius = float(
        contact.contact_radius(history.approach_b[peak], history.motion.scales.effective_radius)
    )
    field = history.pressure_over_contact([0.0, 0.6 * radius, radius, 1.01 * radius], "B")
    assert field.shape == (len(history.time), 4)
    np.testing.assert_allclose(field[:, 0], history.pressure_b, rtol=1e-12)
    np.testing.assert_allclose(
        field[peak] / history.pressure_b[peak], [1.0, 0.8, 0.0, 0.0], atol=1e-7
    )
    apart = history.approach_b < 0.0
    assert apart.any()
    assert (field[apart] == 0.0).all()


def test_massless_history_is_the_closed_form():
    scene = granite(infinite=True)
    history = trace(scene, fidelity="massless", tolerance=1e-10)
    s = history.time / scene.scales.time[0]
    expected = massless_approach(s, scene.scales.pulse_number[0]) * scene.scales.approach[0]
    np.testing.assert_allclose(history.approach_a, expected, atol=1e-9 * scene.scales.approach[0])
    np.testing.assert_array_equal(history.approach_a, history.approach_b)
    # the sphere moves with the mean of the bar ends: f while the pulse lasts, not at all after it
    before = history.time < scene.pulse.end[0]
    np.testing.assert_allclose(history.velocity[before], 0.5, rtol=1e-12)
    assert (history.velocity[history.time > scene.pulse.end[0]] == 0.0).all()
    assert history.changes == ()
    assert history.later_peak is None
    assert history.record_end == history.horizon


def test_a_massless_sphere_moves_with_the_mean_of_the_bar_ends():
    history = trace(granite(), fidelity="massless", tolerance=1e-8)
    ends = (history.incident + history.leaving_a, history.leaving_b + history.returning)
    np.testing.assert_allclose(history.velocity, 0.5 * (ends[0] + ends[1]), atol=1e-12)
    assert np.abs(history.returning).max() > 0.1
    np.testing.assert_array_equal(history.force_a, history.force_b)


def test_first_touch_is_no_loss():
    for density in (100.0, 2650.0, 1e5):
        scene = granite(infinite=True, sphere_density=density, striker_length=2.0)
        motion = dynamics.motion(scene, 0, tolerance=1e-6)
        changes = find_changes(motion, tolerance=1e-6)
        assert all(change.time > 0.1 * scene.scales.time[0] for change in changes)


def test_what_cannot_be_traced_is_refused():
    with pytest.raises(ValueError, match="must be at least 2"):
        trace(granite(), points=1)
    with pytest.raises(ValueError, match="outside the domain"):
        trace(granite(sphere_nu=0.7))
    with pytest.raises(ValueError, match="unknown fidelity"):
        trace(granite(), fidelity="auto")
    with pytest.raises(IndexError):
        trace(granite(), 1)


@pytest.mark.parametrize("law", ["hertz", "plastic"])
@pytest.mark.parametrize(
    ("rig", "kind"), [("bars", "infinite"), ("load_cell", ""), ("impact", "plate")]
)
def test_contacts_are_lost_when_the_answers_say(rig: str, kind: str, law: str) -> None:
    """A face that has yielded is lost at its dent, where its approach is not zero; and bodies that
    part for good lose their last contact at the end.
    """
    scene = random_scene(rig, kind, law)
    name = "time_to_first_loss" if rig == "bars" else "loaded_time"
    answers = dynamics.solve(scene, tolerance=1e-8, quantities=(name,))
    rows = np.flatnonzero(answers.status == 0)[:6]
    for row in rows.tolist():
        path = dynamics.motion(scene, row, tolerance=1e-8)
        changes = find_changes(path, tolerance=1e-8)
        lost = [change.time for change in changes if change.kind == "lost"]
        if rig == "impact":
            assert {change.face for change in changes} == {"B"}  # there is no body at A
        if rig != "bars":
            assert max(lost) == pytest.approx(answers.values[name][row], rel=1e-6)
        elif not answers.censored[name][row]:
            assert lost[0] == pytest.approx(answers.values[name][row], rel=1e-6)
        for face in "AB":
            kinds = [change.kind for change in changes if change.face == face]
            assert all(one != following for one, following in pairwise(kinds))
