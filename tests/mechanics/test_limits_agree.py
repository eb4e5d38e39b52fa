"""Models and studies that must meet in a limit, all seen through study files and evaluate()."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from uqsphere.model import evaluate
from uqsphere.study import Study

INFINITE = ("bars.infinite=true",)
Build = Callable[..., Study]


def column(study: Study, name: str, fidelity: str = "full", tolerance: float = 1e-9) -> float:
    return float(evaluate(study, {}, (name,), fidelity=fidelity, tolerance=tolerance)[name][0])


def test_linear_is_the_secant_of_full(study_from: Build) -> None:
    """Both springs carry P_0 at alpha_c: under a long pulse the forces end at the same place."""
    study = study_from(*INFINITE, 'pulse={shape="step"}', 'model.horizon="2 ms"', 'sphere.density="20 kg/m3"')
    full, linear = (column(study, "P_max", fidelity) for fidelity in ("full", "linear"))
    assert linear == pytest.approx(full, rel=0.05)
    assert linear != full
    assert column(study, "alpha_max", "linear") == pytest.approx(column(study, "alpha_max", "full"), rel=0.05)


def test_infinite_bars_are_long_bars_before_the_first_echo(study_from: Build) -> None:
    long = study_from('bars.incident_length="50 m"', 'bars.receiving_length="50 m"', 'model.horizon="3 ms"')
    infinite = study_from(*INFINITE, 'model.horizon="3 ms"')
    names = ("p_max", "first_peak", "force_imbalance", "energy", "rise_time", "pulse_width")
    one, two = (evaluate(study, {}, names, tolerance=1e-9) for study in (long, infinite))
    for name in names:
        assert one[name][0] == pytest.approx(two[name][0], rel=1e-7), name


def test_bars_that_reflect_nothing_are_infinite(study_from: Build) -> None:
    ends = ('bars.incident_end="absorbing"', 'bars.receiving_end="absorbing"', 'model.horizon="500 us"')
    dull = study_from(*ends)
    infinite = study_from(*INFINITE, 'model.horizon="500 us"')
    for name in ("p_max", "energy", "force_imbalance"):
        assert column(dull, name) == pytest.approx(column(infinite, name), rel=1e-12), name


def test_the_first_loading_ends_at_the_echo(study_from: Build) -> None:
    whole = study_from()
    first = study_from("model.first_loading_only=true")
    frame = evaluate(first, {}, ("p_max", "first_peak"), tolerance=1e-9)
    assert frame["p_max"][0] == frame["first_peak"][0] == pytest.approx(column(whole, "first_peak"), rel=1e-7)


OTHER_UNITS = (
    ("52 GPa", "52000 MPa"), ("60 GPa", "60000 MPa"), ("5 mm", "5000 um"), ("0.05 mm", "50 um"),
    ("2650 kg/m3", "2.65 g/cm3"), ("200 GPa", "2e11 Pa"), ("1500 MPa", "1.5 GPa"), ("12 mm", "1.2 cm"),
    ("0.4 m", "400 mm"), ("5 m/s", "18 km/h"), ("0.1 m", "10 cm"), ("6 GPa", "0.006 TPa"), ("10 min", "600 s"),
)  # fmt: skip


def test_a_change_of_units_changes_nothing(study_from: Build, small_text: str) -> None:
    changed = small_text
    for one, other in OTHER_UNITS:
        changed = changed.replace(f'"{one}"', f'"{other}"')
    assert changed.count("GPa") == 1  # the yield strength
    first, second = study_from(), study_from(text=changed)
    assert first.at_means().keys() == second.at_means().keys()
    for name, value in first.at_means().items():
        assert second.at_means()[name] == pytest.approx(value, rel=1e-12), name
    names = ("p_max", "contact_time", "energy", "loading_rate")
    one, two = (evaluate(study, {}, names, tolerance=1e-9) for study in (first, second))
    for name in names:
        assert two[name][0] == pytest.approx(one[name][0], rel=1e-9), name
    strengths = [study.limits[0].strength for study in (first, second)]
    assert [law.parameters.keys() for law in strengths].count(strengths[0].parameters.keys()) == 2
    for key, value in strengths[0].parameters.items():
        assert strengths[1].parameters[key] == pytest.approx(value, rel=1e-12)
