"""Energy and impulse, theory (6) and (7), from the waves and forces of a history: nothing gets
lost.
"""

from __future__ import annotations

import numpy as np
import pytest
from scenes import example as scene_with

from tests.energies import balance_of
from uqsphere.mechanics import contact
from uqsphere.mechanics.field import arriving, leaving
from uqsphere.mechanics.history import rod_record
from uqsphere.mechanics.integrator import solve as dynamics
from uqsphere.mechanics.scene import Scene

NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)


class Balance:
    """Both balances of a scene at any time, by quadrature over the integrator's own steps."""

    def __init__(self, scene: Scene, tolerance: float, fidelity: str = "full") -> None:
        self.scene, self.fidelity = scene, fidelity
        self.motion = dynamics.motion(scene, 0, fidelity=fidelity, tolerance=tolerance)
        self.unit = float(scene.scales.time[0])
        self.end = self.motion.end * self.unit

    def integrals(self, begin: float, end: float) -> np.ndarray:
        """∫ f_in, g_A, k_B and their squares; Gauss on every step and between the kinks that come
        back.
        """
        begin = max(begin, 0.0)
        if end <= begin:
            return np.zeros((2, 3))
        trips = self.scene.round_trips[0]
        starts = self.motion.start * self.unit
        # the waves have the kinks of the forces one round trip ago besides those of the present
        cuts = np.concatenate([starts, starts + trips[0], starts + trips[1], [begin, end]])
        cuts = np.unique(cuts[(cuts >= begin) & (cuts <= end)])
        half = 0.5 * np.diff(cuts)
        times = (cuts[:-1] + half)[:, None] + half[:, None] * NODES
        weights = (half[:, None] * WEIGHTS).ravel()
        at = times.ravel()
        incident = arriving(self.motion, 0, at)
        leaving_a, leaving_b = (leaving(self.motion, bar, at) for bar in (0, 1))
        earlier = leaving(self.motion, 0, at - trips[0])
        back = self.scene.reflections[0, 0] * earlier * (at > trips[0])
        courses = np.stack([incident - back, leaving_a, leaving_b])
        return np.stack([courses @ weights, courses**2 @ weights])

    def errors(self, time: float) -> tuple[float, float]:
        """Errors of impulse and energy at `time` [s], over the impulse and energy of the pulse."""
        scales = self.scene.scales
        (R_1, R_3), (T_1, T_3) = self.scene.reflections[0], self.scene.round_trips[0]
        whole = self.integrals(0.0, time)
        early_a, early_b = (
            self.integrals(0.0, time - T_1)[:, 1],
            self.integrals(0.0, time - T_3)[:, 2],
        )
        alpha_1, alpha_2, w = self.motion.states_at(np.array([time]))[0]
        Z, M, beta = scales.impedance[0], scales.mass[0], scales.hertz_constant[0]
        if self.fidelity == "linear":
            stiffness = scales.force[0] / scales.approach[0]
            stored = 0.5 * stiffness * (max(alpha_1, 0.0) ** 2 + max(alpha_2, 0.0) ** 2)
        else:
            stored = contact.contact_energy(alpha_1, beta) + contact.contact_energy(alpha_2, beta)
        given = Z * whole[:, 0]
        waves_1 = whole[:, 1] - np.array([R_1, R_1**2]) * early_a
        waves_3 = whole[:, 2] - np.array([R_3, R_3**2]) * early_b
        impulse = M * w + Z * (waves_1[0] + waves_3[0])
        energy = stored + 0.5 * M * w**2 + Z * (waves_1[1] + waves_3[1])
        return impulse / given[0] - 1.0, energy / given[1] - 1.0


SCENES = {
    "granite": {},
    "slow": {"striker_speed": 0.05},
    "unequal bars": {
        "bars_receiving_length": 0.97,
        "striker_length": 0.25,
        "sphere_density": 7000.0,
    },
    "heavy sphere": {"sphere_density": 2e5, "striker_length": 0.1},
    "half sine": {"shape": "half_sine"},
    "trapezoid": {"shape": "trapezoid", "pulse_rise": 25e-6, "pulse_fall": 40e-6},
    "absorbing": {"bars_receiving_end": 0.0},
    "fixed and half": {"bars_incident_end": -1.0, "bars_receiving_end": 0.4},
}


@pytest.mark.parametrize("name", list(SCENES))
def test_impulse_and_energy_balance(name):
    tolerance = 1e-8
    balance = Balance(scene_with(**SCENES[name]), tolerance)
    trip = float(balance.scene.round_trips[0].min())
    for time in (0.4 * trip, 1.3 * trip, 2.6 * trip, balance.end):
        impulse, energy = balance.errors(min(time, balance.end))
        assert abs(impulse) < 10.0 * tolerance, (name, time)
        assert abs(energy) < 10.0 * tolerance, (name, time)


@pytest.mark.parametrize("fidelity", ["linear", "massless"])
def test_the_other_models_keep_the_balance(fidelity):
    balance = Balance(scene_with(), 1e-8, fidelity)
    impulse, energy = balance.errors(balance.end)
    assert abs(impulse) < 1e-7
    assert abs(energy) < 1e-7


# --- the same of every rig and law, as `history` shows it -----------------------------------------

STEEL = {"E": 205e9, "nu": 0.29, "density": 7850.0}
BALL = {"sphere.E": 60e9, "sphere.nu": 0.25, "sphere.radius": 0.008, "sphere.density": 2600.0}


def rig_scene(rig: str, options: dict[str, str | bool] | None = None, **numbers: float) -> Scene:
    columns = {**BALL, **{name.replace("__", "."): value for name, value in numbers.items()}}
    return Scene(
        columns={n: np.array([v]) for n, v in columns.items()}, rig=rig, options=options or {}
    )


def steel(table: str, **more: float) -> dict[str, float]:
    return {f"{table}__{key}": value for key, value in {**STEEL, **more}.items()}


RIG_SCENES = {
    "impact": rig_scene("impact", rig__speed=3.6, **steel("target")),
    "plate": rig_scene(
        "impact", {"target.kind": "plate"}, rig__speed=3.0, **steel("target", thickness=0.012)
    ),
    "drop_weight": rig_scene(
        "drop_weight", hammer__speed=0.5, hammer__mass=0.5, **steel("hammer"), **steel("anvil")
    ),
    "load_cell": rig_scene(
        "load_cell",
        hammer__speed=2.0,
        hammer__mass=0.07,
        **steel("hammer"),
        **steel("rod", diameter=0.02, length=1.5),
    ),
}


@pytest.mark.parametrize("name", RIG_SCENES)
def test_energy_of_a_blow_is_where_it_is_said_to_be(name: str) -> None:
    found = dynamics.motion(RIG_SCENES[name], 0, tolerance=1e-9)
    balance = balance_of(found, np.linspace(0.0, found.horizon, 20_001))
    held = float((balance.kinetic + balance.stored.sum(axis=0)).max())
    assert np.abs(balance.residual).max() < 1e-6 * held
    assert balance.force[:, -1] == pytest.approx(0.0, abs=1e-6 * balance.force.max())


def test_a_face_that_yields_keeps_its_dent_and_its_work() -> None:
    scene = scene_with("trapezoid", pulse_rise=25e-6, pulse_fall=25e-6, striker_speed=0.5)
    columns = {
        **scene.columns,
        "contact.onset_pressure": np.array([1.35e9]),
        "contact.hardness": np.array([2.4e9]),
    }
    columns["contact.pile_up"] = np.array([8.0 / 3.0])
    law = {"contact_law": "plastic"}
    found = dynamics.motion(Scene(columns=columns, shape="trapezoid", **law), 0, tolerance=1e-9)
    balance = balance_of(found, np.linspace(0.0, found.horizon, 40_001))
    assert (np.diff(balance.dent, axis=1) >= 0.0).all()
    assert (np.diff(balance.plastic, axis=1) >= -1e-15).all()
    assert balance.dent[:, -1].min() > 1e-6
    held = float((balance.stored + balance.plastic).sum(axis=0).max())
    assert np.abs(balance.residual).max() < 2e-5 * held


def test_the_gauge_of_a_rod_sees_the_force_at_the_face_later() -> None:
    found = dynamics.motion(RIG_SCENES["load_cell"], 0, tolerance=1e-9)
    speed, section = np.sqrt(205e9 / 7850.0), np.pi * 0.01**2
    times = np.linspace(0.0, 0.9 * 2.0 * 1.3 / speed, 500)
    strain = rod_record(found, 0.2, times + 0.2 / speed).strain
    inside = times + 0.2 / speed < 2.0 * 1.5 / speed - 0.2 / speed
    inside &= times <= found.horizon  # behind it no force is known
    due = -found.forces_at(times)[:, 1] / (205e9 * section)
    np.testing.assert_allclose(strain[inside], due[inside], rtol=1e-9, atol=1e-15)
    with pytest.raises(ValueError, match="must be on the rod"):
        rod_record(found, 2.0, times)
