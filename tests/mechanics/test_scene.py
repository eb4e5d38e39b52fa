"""Scenes: what is refused, the status of every violation, scales and their change under a change of
units.
"""

from __future__ import annotations

import numpy as np
import pytest
from scenes import EXAMPLE
from scenes import example as granite

from uqsphere.mechanics.scene import STATUS, Scene

EXACT = 1e-12


def test_infinite_bars_need_neither_lengths_nor_ends():
    columns = {k: np.array([v]) for k, v in EXAMPLE.items() if not k.endswith(("_length", "_end"))}
    scene = Scene(columns=columns, infinite=True)
    assert scene.status.tolist() == [0]
    assert np.isinf(scene.first_echo).all()
    assert np.isinf(scene.record_end).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"shape": "triangle"}, "unknown pulse shape"),
        ({"shape": "trapezoid"}, "missing: pulse.rise, pulse.fall"),
        ({"shape": "two_peak"}, "missing: pulse.t1, pulse.level1, pulse.t2, pulse.level2"),
        ({"shape": "step", "infinite": True}, "needs a horizon"),
        ({"horizon": 0.0}, "horizon must be positive"),
        ({"horizon": float("nan")}, "horizon must be positive"),
        ({"horizon": np.inf}, "finite"),
        ({"sphere_colour": 1.0}, "unknown columns: sphere.colour"),
    ],
)
def test_a_structure_without_meaning_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        granite(**changes)


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({}, 0),
        *(
            ({name.replace(".", "_", 1): value}, 1)
            for name in EXAMPLE
            for value in (np.nan, np.inf)
        ),
        *(
            ({name.replace(".", "_", 1): 0.0}, 1)
            for name in EXAMPLE
            if not name.endswith(("_end", ".nu"))
        ),
        ({"sphere_nu": 0.5}, 1),
        ({"sphere_nu": -1.0}, 1),
        ({"bars_nu": 0.5}, 1),
        ({"bars_incident_end": 1.01}, 1),
        ({"bars_receiving_end": -1.01}, 1),
        ({"sphere_radius": 0.0201}, 1),  # wider than the bar
        ({"sphere_radius": 0.02}, 0),
        ({"bars_end_radius": np.inf}, 0),
        ({"bars_end_radius": 0.0}, 1),
        ({"pulse_duration": 0.0}, 1),
        ({"bars_yield_strength": np.nan}, 0),  # serves a check only
        ({"striker_length": 1.6}, 2),  # the striker is still on the bar
        ({"striker_length": 1.5}, 0),
        ({"striker_length": 1.6, "bars_incident_end": 0.0}, 0),  # nothing comes back
        ({"striker_length": 1.6, "infinite": True}, 0),
        ({"shape": "trapezoid", "pulse_rise": 200e-6, "pulse_fall": 200e-6}, 1),  # no plateau left
        ({"shape": "trapezoid", "pulse_rise": 20e-6, "pulse_fall": 20e-6}, 0),
    ],
)
def test_status_of_every_violation(changes, code):
    scene = granite(**changes)
    assert scene.status.tolist() == [code]
    assert code in STATUS


def test_a_bad_row_does_not_touch_the_others():
    scene = granite(rows=3, sphere_nu=np.array([0.25, 0.6, 0.25]))
    assert scene.status.tolist() == [0, 1, 0]
    assert scene.scales.time[0] == scene.scales.time[2] == granite().scales.time[0]


def test_scales_by_hand():
    scales = granite().scales
    # P_0 = Z v0/2, alpha_c = (P_0/beta)^(2/3), t_c = 2 alpha_c/v0: the stiffness at alpha_c over Z
    # is 1/t_c
    np.testing.assert_allclose(scales.force, 0.5 * scales.impedance, rtol=EXACT)
    np.testing.assert_allclose(
        scales.hertz_constant * np.sqrt(scales.approach) / scales.impedance,
        1.0 / scales.time,
        rtol=EXACT,
    )
    np.testing.assert_allclose(scales.mass, 4.0 / 3.0 * np.pi * 0.01**3 * 2650.0, rtol=EXACT)
    # the Zener number: 1/mu = 2^(1/3) lam^(-5/3)
    zener = scales.hertz_constant**0.4 * scales.mass**0.6 / scales.impedance
    np.testing.assert_allclose(
        1.0 / scales.mass_number, 2.0 ** (1 / 3) * zener ** (-5 / 3), rtol=EXACT
    )


def test_record_end():
    trip = float(granite().round_trips[0, 0])
    longer = granite(bars_receiving_length=2.0)
    assert longer.record_end[0] == pytest.approx(8.0 * trip * 2.0 / 1.5, rel=EXACT)
    assert granite(horizon=1e-3).record_end[0] == 1e-3
    assert granite(first_loading_only=True).record_end[0] == pytest.approx(trip, rel=EXACT)
    # the incident bar swallows its wave: the first one back comes from the receiving bar
    late = granite(first_loading_only=True, bars_incident_end=0.0, bars_receiving_length=2.0)
    assert late.record_end[0] == pytest.approx(trip * 2.0 / 1.5, rel=EXACT)
