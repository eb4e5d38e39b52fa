"""Numbers as text: one formatter for terminal, page, CSV notes and compare."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uqsphere.quantities import (
    format_estimate,
    format_probability,
    format_probability_estimate,
    format_share,
    format_value,
    round_conservative,
)


@pytest.mark.parametrize(
    ("value", "low", "high", "text"),
    [
        # no failure, and only failures, in a sample: what the interval says
        (0.0, 0.0, 3 / 4096, "below 0.074 %"),
        (1.0, 1.0 - 3 / 4096, 1.0, "above 99.926 %"),
        (0.0, 0.0, 0.0, "0 %"),
        (1.0, 1.0, 1.0, "100 %"),
        # no value: never "below 100 %"
        (None, 0.9998, 1.0, "above 99.98 %"),
        (None, 0.99995, 1.0, "above 99.995 %"),
        (None, 0.0, 1e-5, "below 0.001 %"),
        (None, 0.2, 0.4, "20 % to 40 %"),
        (None, 0.0, 1.0, "not known"),
        (None, None, None, "not known"),
        (0.5, None, None, "50 %"),
        (0.02017, 0.0199, 0.0204, "2.02 % (1.99 to 2.04 %)"),
        (0.99, 0.98, 0.9998, "99 % (98 to 99.98 %)"),
        # next to 100 %: to the first digit of the width, or of what the upper end lacks
        (0.99904, 0.99897, 0.99911, "99.90 % (99.90 to 99.91 %)"),
        (0.99904, 0.999035, 0.999045, "99.904 % (99.903 to 99.904 %)"),
        (0.996, 0.991, 0.9999, "99.60 % (99.10 to 99.99 %)"),
        (1 - 2.6e-6, 1 - 3.1e-6, 1 - 2.1e-6, "99.9997 % (99.9997 to 99.9998 %)"),
        (0.99916, None, None, "99.92 %"),
        # all ends to one digit
        (3.9e-6, 3.88e-6, 3.96e-6, "0.000390 % (0.000388 to 0.000396 %)"),
    ],
)
def test_probabilities_with_their_intervals(
    value: float | None, low: float | None, high: float | None, text: str
) -> None:
    assert format_probability_estimate(value, low, high) == text


def test_a_probability_and_its_interval_read_alike() -> None:
    """Headline (one text) and table (with interval) say the same of a bound."""
    for value, low, high in ((0.0, 0.0, 7.3e-4), (1.0, 0.9998, 1.0), (None, 0.9998, 1.0)):
        assert format_probability(value, high, low) == format_probability_estimate(value, low, high)


def test_no_probability_is_rounded_to_none_or_all() -> None:
    for p in (1e-300, 1e-9, 0.9999, 0.99999999, 1.0 - 1e-16):
        assert format_probability(p) not in ("0 %", "100 %")


def test_a_bound_of_a_probability_is_rounded_outwards() -> None:
    for bound in np.geomspace(1e-8, 0.9, 200).tolist():
        text = format_probability(None, bound).removeprefix("below ")
        read = float(text.removesuffix(" %")) * (0.01 if text.endswith("%") else 1.0)
        assert bound * (1.0 - 1e-9) <= read <= bound * 1.101


def test_conservative_values_never_pass_the_bound() -> None:
    rng = np.random.default_rng(5)
    for value in 10.0 ** rng.uniform(-6.0, 3.0, 300):
        down, text = round_conservative(value, "striker.speed", safe_above=False)
        up, _ = round_conservative(value, "striker.speed", safe_above=True)
        assert down <= value * (1.0 + 1e-9)
        assert up >= value * (1.0 - 1e-9)
        assert up - down <= 0.101 * value
        # what is shown is the rounded number itself
        number, unit = text.split()
        assert unit == "m/s"
        assert float(number) == pytest.approx(down, rel=1e-12)


def test_round_numbers_stay_as_they_are() -> None:
    for least in (False, True):
        assert round_conservative(0.12, "striker.speed", safe_above=least)[1] == "0.12 m/s"
        text = round_conservative(0.65 + 1e-16, "striker.speed", safe_above=least)[1]
        assert text == "0.65 m/s"
    assert round_conservative(0.0, "striker.speed", safe_above=True) == (0.0, "0 m/s")


def test_estimates_have_the_digits_of_their_interval() -> None:
    assert (
        format_estimate(2.55412e9, 2.5502e9, 2.5581e9, "p_max") == "2.5541 (2.5502 to 2.5581) GPa"
    )
    # an interval that rounds to the value says nothing more
    assert format_estimate(2.5e9, 2.4999999e9, 2.5000001e9, "p_max", 4) == "2.500 GPa"
    assert format_estimate(0.25, None, 0.3) == "0.25"
    assert format_estimate(1.0, -math.inf, 2.0) == "1 (-inf to 2)"
    assert format_value(math.inf, "bars.end_radius") == "inf mm"


def test_ratios_above_one_are_percentages_too() -> None:
    assert [format_probability(value) for value in (1.0, 1.3, 2.5)] == ["100 %", "130 %", "250 %"]


def test_a_probability_next_to_one_is_written_out() -> None:
    for nines in range(2, 7):
        text = format_probability(1.0 - 10.0**-nines)
        assert text == f"99{'.' * (nines > 2)}{'9' * (nines - 2)} %"
        assert format_share(1.0 - 10.0**-nines) == text
    assert format_probability(math.nextafter(1.0, 0.0)) == "above 99.9999 %"
    assert (format_share(0.0123), format_share(1.0 - 1e-9)) == ("1.23 %", "99.9999999 %")
