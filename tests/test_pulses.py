"""Incident pulses: impulse, area, continuity, peaks, and parameters that make no pulse."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uqsphere.mechanics.pulses import DEFAULT_VALLEY, PARAMETERS, SHAPES, Pulse, build_pulse, pulse_value

EXACT = 1e-12
TWO_PEAK = {"t1": [19e-6], "level1": [1.0], "t2": [60e-6], "level2": [0.8]}


def area(pulse: Pulse, row: int = 0, moment: int = 0) -> float:
    """Gauss quadrature of g over every piece; exact for cubics, to rounding for a half sine."""
    nodes, weights = np.polynomial.legendre.leggauss(20)
    total = 0.0
    for begin, end in zip(pulse.breaks[row, :-1], pulse.breaks[row, 1:], strict=True):
        times = begin + 0.5 * (end - begin) * (nodes + 1.0)
        total += 0.5 * (end - begin) * float(weights @ (pulse_value(pulse, row, times) * times**moment))
    return total


def values(pulse: Pulse, times: list[float]) -> np.ndarray:
    return pulse_value(pulse, 0, np.array(times))


ramp_shares = st.just(0.0) | st.floats(1e-6, 1.0)


@given(st.floats(1e-6, 1e-3), ramp_shares, ramp_shares)
@settings(max_examples=60, deadline=None)
def test_rectangle_and_trapezoid_keep_the_impulse_of_the_striker(duration, rise, fall):
    ramps = {"rise": [rise * duration], "fall": [fall * duration]}
    rectangle, trapezoid = build_pulse("rectangular", [duration]), build_pulse("trapezoid", [duration], ramps)
    assert trapezoid.valid.all()
    assert area(rectangle) == pytest.approx(duration, rel=EXACT)
    assert area(trapezoid) == pytest.approx(duration, rel=1e-11)
    assert trapezoid.end[0] == pytest.approx(duration * (1.0 + 0.5 * (rise + fall)), rel=EXACT)


def test_half_sine_area_and_peak():
    pulse = build_pulse("half_sine", [80e-6])
    assert area(pulse) == pytest.approx(2.0 / np.pi * 80e-6, rel=EXACT)
    assert values(pulse, [40e-6])[0] == pytest.approx(1.0, rel=EXACT)


def test_a_trapezoid_is_half_as_high_over_its_width():
    pulse = build_pulse("trapezoid", [100e-6], {"rise": [30e-6], "fall": [10e-6]})
    # half height at 15 us and at 115 us: the width is the duration
    np.testing.assert_allclose(values(pulse, [15e-6, 115e-6]), 0.5, rtol=1e-10)
    np.testing.assert_allclose(values(pulse, [30e-6, 60e-6, 109e-6]), 1.0, rtol=EXACT)


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


def test_a_rectangle_jumps_where_it_should():
    pulse = build_pulse("rectangular", [50e-6])
    assert values(pulse, [-1e-9, 0.0, 49.999e-6, 50e-6]).tolist() == [0.0, 1.0, 1.0, 0.0]


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


def test_a_given_valley_is_met():
    pulse = build_pulse("two_peak", [100e-6], {**TWO_PEAK, "valley": [0.3]})
    assert values(pulse, [39.5e-6])[0] == pytest.approx(0.3, rel=1e-10)


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


def test_every_shape_names_its_parameters():
    assert set(PARAMETERS) == set(SHAPES)
