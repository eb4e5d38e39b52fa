"""Incident pulses: impulse, area, continuity, peaks, and parameters that make no pulse."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import EXAMPLE, example

from uqsphere.mechanics import bars
from uqsphere.mechanics.integrator import solve as dynamics
from uqsphere.mechanics.pulses import (
    DEFAULT_VALLEY,
    PRESETS,
    Pulse,
    build_pulse,
    pulse_value,
    striker_steps,
)
from uqsphere.mechanics.scene import Scene

EXACT = 1e-12
TWO_PEAK = {"t1": [19e-6], "level1": [1.0], "t2": [60e-6], "level2": [0.8]}


def area(pulse: Pulse, row: int = 0, moment: int = 0) -> float:
    """Gauss quadrature of g over every piece; exact for cubics, to rounding for a half sine."""
    nodes, weights = np.polynomial.legendre.leggauss(20)
    total = 0.0
    for begin, end in zip(pulse.breaks[row, :-1], pulse.breaks[row, 1:], strict=True):
        times = begin + 0.5 * (end - begin) * (nodes + 1.0)
        total += (
            0.5 * (end - begin) * float(weights @ (pulse_value(pulse, row, times) * times**moment))
        )
    return total


def values(pulse: Pulse, times: list[float]) -> np.ndarray:
    return pulse_value(pulse, 0, np.array(times))


ramp_shares = st.just(0.0) | st.floats(1e-6, 1.0)


@given(st.floats(1e-6, 1e-3), ramp_shares, ramp_shares)
@settings(max_examples=60, deadline=None)
def test_rectangle_and_trapezoid_keep_the_impulse_of_the_striker(duration, rise, fall):
    ramps = {"rise": [rise * duration], "fall": [fall * duration]}
    rectangle, trapezoid = (
        build_pulse("rectangular", [duration]),
        build_pulse("trapezoid", [duration], ramps),
    )
    assert trapezoid.valid.all()
    assert area(rectangle) == pytest.approx(duration, rel=EXACT)
    assert area(trapezoid) == pytest.approx(duration, rel=1e-11)
    assert trapezoid.end[0] == pytest.approx(duration * (1.0 + 0.5 * (rise + fall)), rel=EXACT)


@pytest.mark.parametrize(
    ("shape", "numbers", "times", "expected", "whole"),
    [
        ("half_sine", {}, [40e-6], [1.0], 2.0 / np.pi * 80e-6),
        # half height at 15 us and at 95 us: the width is the duration
        (
            "trapezoid",
            {"rise": [30e-6], "fall": [10e-6]},
            [15e-6, 30e-6, 89e-6, 95e-6],
            [0.5, 1, 1, 0.5],
            80e-6,
        ),
        ("rectangular", {}, [-1e-9, 0.0, 79.999e-6, 80e-6], [0, 1, 1, 0], 80e-6),
        # rises over its rise and falls at once
        (
            "ramp",
            {"rise": [60e-6]},
            [0.0, 30e-6, 60e-6, 109.9e-6, 110.1e-6],
            [0, 0.5, 1, 1, 0],
            80e-6,
        ),
        ("two_peak", TWO_PEAK | {"valley": [0.3]}, [19e-6, 39.5e-6, 60e-6], [1.0, 0.3, 0.8], None),
    ],
)
def test_a_pulse_of_80_us_takes_its_values_and_has_its_area(shape, numbers, times, expected, whole):
    pulse = build_pulse(shape, [80e-6], numbers)
    np.testing.assert_allclose(values(pulse, times), expected, rtol=1e-10, atol=1e-12)
    assert whole is None or area(pulse) == pytest.approx(whole, rel=EXACT)


@pytest.mark.parametrize(
    ("shape", "numbers"),
    [("trapezoid", {"rise": [20e-6], "fall": [30e-6]}), ("half_sine", {}), ("two_peak", TWO_PEAK)],
)
def test_smooth_shapes_are_continuous(shape, numbers):
    pulse = build_pulse(shape, [100e-6], numbers)
    for end in pulse.breaks[0]:
        before, after = values(pulse, [end - 1e-13, end + 1e-13])
        assert abs(after - before) < 1e-6
    fine = pulse_value(pulse, 0, np.linspace(0.0, 130e-6, 100_001))
    assert np.abs(np.diff(fine)).max() < 3e-4


def test_two_peaks_are_its_maxima_and_the_valley_its_minimum():
    pulse = build_pulse("two_peak", [100e-6], TWO_PEAK)
    times = np.linspace(0.0, 100e-6, 200_001)
    course = pulse_value(pulse, 0, times)
    inner = course[1:-1]
    maxima = times[1:-1][(inner > course[:-2]) & (inner >= course[2:])]
    minima = times[1:-1][(inner < course[:-2]) & (inner <= course[2:])]
    np.testing.assert_allclose(maxima, [19e-6, 60e-6], atol=2e-9)
    np.testing.assert_allclose(minima, [39.5e-6], atol=2e-9)
    levels = values(pulse, [19e-6, 60e-6, 39.5e-6])
    np.testing.assert_allclose(levels, [1.0, 0.8, DEFAULT_VALLEY * 0.8], rtol=1e-10)


def test_a_step_lasts_for_ever():
    pulse = build_pulse("step", [1e-4])
    assert np.isinf(pulse.end[0])
    assert values(pulse, [0.0, 1.0, 1e6]).tolist() == [1.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("shape", "duration", "numbers"),
    [
        ("rectangular", 0.0, {}),
        ("half_sine", -1e-6, {}),
        ("trapezoid", 50e-6, {"rise": [60e-6], "fall": [60e-6]}),
        ("trapezoid", 50e-6, {"rise": [-1e-6], "fall": [10e-6]}),
        ("two_peak", 100e-6, {**TWO_PEAK, "t2": [10e-6]}),
        ("two_peak", 50e-6, TWO_PEAK),
        ("two_peak", 100e-6, {**TWO_PEAK, "level1": [0.0]}),
        ("two_peak", 100e-6, {**TWO_PEAK, "level2": [-0.1]}),
    ],
)
def test_what_is_no_pulse_is_said(shape, duration, numbers):
    assert not build_pulse(shape, [duration], numbers).valid.any()


def test_rows_do_not_depend_on_each_other():
    ramps = {"rise": np.array([10e-6, 400e-6]), "fall": np.array([10e-6, 10e-6])}
    both = build_pulse("trapezoid", np.array([50e-6, 90e-6]), ramps)
    assert both.valid.tolist() == [True, False]
    alone = build_pulse("trapezoid", [50e-6], {"rise": [10e-6], "fall": [10e-6]})
    np.testing.assert_array_equal(both.coefficients[0], alone.coefficients[0])


# --- pulses of strikers that are no piece of the bar, ramps and the presets of the paper's Fig. 2 -


BASE = EXAMPLE | {
    "bars.incident_length": 3.0,
    "bars.receiving_length": 3.0,
    "bars.receiving_end": 0.0,
    "striker.length": 0.2,
    "striker.speed": 2.0,
}


def impact(ratio: float, cells: int, turns: int) -> np.ndarray:
    """Velocity of a bar's end over v0/2 after each cell time, by waves moved cell by cell in
    striker and bar.

    Contact carries no tension: once it would, the striker is off.
    """
    right, left = (
        np.full(cells, 1.0),
        np.full(cells, 1.0),
    )  # velocity (right + left)/2 of each cell, v0 = 1
    course, together = [], True
    for _ in range(turns * cells):
        # what arrives at the interface from the striker, nothing from the long bar: force Z_s (r -
        # v) = Z v
        arrives = right[-1]
        velocity = ratio * arrives / (1.0 + ratio)
        if together and ratio * (arrives - velocity) < -1e-12:
            together = False
        together = together and velocity > 0.0
        course.append(2.0 * velocity if together else 0.0)
        back = 2.0 * velocity - arrives if together else arrives
        free = left[0]
        right = np.concatenate([[free], right[:-1]])
        left = np.concatenate([left[1:], [back]])
    return np.array(course)


@pytest.mark.parametrize("ratio", [0.3, 1.0, 1.7, 4.0])
def test_steps_are_those_of_two_bars_that_meet(ratio):
    cells, turns = 40, 16
    found = impact(ratio, cells, turns)
    pulse = build_pulse("rectangular", [2.0 * cells], {"striker_ratio": [ratio]})
    times = np.arange(turns * cells) + 0.5
    # steps below a thousandth of the first are left out
    np.testing.assert_allclose(pulse_value(pulse, 0, times), found, atol=2.1e-3)


@pytest.mark.parametrize(
    ("rise", "fall", "fits"), [(0.8, 0.8, True), (1.0, 1.0, True), (1.2, 0.9, False)]
)
def test_ramps_of_steps_may_fill_the_width_and_no_more(
    rise: float, fall: float, fits: bool
) -> None:
    pulse = build_pulse(
        "trapezoid", [1.0], {"rise": [rise], "fall": [fall], "striker_ratio": [2.0]}
    )
    assert bool(pulse.valid[0]) is fits


@pytest.mark.parametrize("ratio", [1.0, 1.5, 3.0, 8.0])
def test_a_stiff_striker_gives_all_it_has(ratio):
    """Impulse M_s v0 and energy M_s v0²/2; in units of Z, v0/2 and one step: ratio and ratio."""
    levels, complete = striker_steps([ratio])
    assert complete[0]
    assert levels.sum() == pytest.approx(ratio, rel=6e-3)
    assert np.square(levels).sum() == pytest.approx(ratio, rel=5e-5)


def test_a_striker_like_the_bar_sends_the_plain_pulse():
    plain = example(numbers=BASE)
    own = {"striker.E": 210e9, "striker.density": 7850.0, "striker.diameter": 0.04}
    same = example(numbers=BASE | own)
    names = ("p_max", "time_to_first_loss", "force_imbalance")
    one, other = (
        dynamics.solve(scene, tolerance=1e-9, quantities=names).values for scene in (plain, same)
    )
    for name in names:
        np.testing.assert_allclose(other[name], one[name], rtol=1e-9)


def test_length_and_speed_of_sound_are_the_strikers():
    columns = {name: np.array([value]) for name, value in BASE.items()}
    columns |= {"striker.E": np.array([70e9]), "striker.density": np.array([2700.0])}
    scene = Scene(columns=columns)
    assert scene.scales.duration[0] == pytest.approx(0.4 / np.sqrt(70e9 / 2700.0))
    expected = np.sqrt(70e9 * 2700.0) / np.sqrt(210e9 * 7850.0)
    assert scene.striker_ratio[0] == pytest.approx(expected)
    assert pulse_value(scene.pulse, 0, np.array([1e-6]))[0] == pytest.approx(
        2.0 * expected / (1.0 + expected)
    )
    assert scene.pulse.end[0] == pytest.approx(0.4 / np.sqrt(70e9 / 2700.0))
    assert bars.impedance(70e9, 2700.0, 0.04) < scene.scales.impedance[0]


def test_edges_keep_the_impulse_of_the_steps():
    numbers = {"rise": [20e-6], "fall": [30e-6], "striker_ratio": [2.5]}
    pulse = build_pulse("trapezoid", [100e-6], numbers)
    times = np.linspace(0.0, pulse.end[0], 2_000_001)
    levels = striker_steps([2.5])[0]
    assert np.trapezoid(pulse_value(pulse, 0, times), times) == pytest.approx(
        levels.sum() * 100e-6, rel=1e-9
    )
    assert not build_pulse("trapezoid", [20e-6], numbers).valid[0]


def test_a_very_stiff_striker_is_refused():
    assert not build_pulse("rectangular", [1e-4], {"striker_ratio": [12.0]}).valid[0]
    with pytest.raises(ValueError, match="does not depend on the striker"):
        Scene(columns={name: np.array([1.0]) for name in [*BASE, "striker.E"]}, shape="half_sine")


def test_presets_have_the_durations_of_the_paper():
    assert [PRESETS[name][1]["duration"] for name in ("very_short", "short", "long")] == [
        24.8e-6,
        60e-6,
        400e-6,
    ]
    second = PRESETS["very_short"][1]["t2"]
    pulse = build_pulse(
        "two_peak", [24.8e-6], {key: [value] for key, value in PRESETS["very_short"][1].items()}
    )
    values = pulse_value(pulse, 0, second + np.array([-1e-6, 0.0, 1e-6]))
    assert second == 19e-6
    assert values[1] == max(values)
