"""The law of a face that yields: the table of docs/theory.md, limits, balances."""

import math
from pathlib import Path

import numpy as np
import pytest
from scenes import EXAMPLE

from uqsphere.mechanics.scene import Scene
from uqsphere.mechanics.yielding import Face, metal_onset
from uqsphere.models.scene import solve_scene

THETA = Path(__file__).parent / "data" / "face_law.csv"


def face(b: float, pile_up: float, onset: float = 1e9) -> Face:
    hardness = (1.0 + b) * onset / pile_up
    return Face(
        onset=np.array([onset]),
        hardness=np.array([hardness]),
        pile_up=np.array([pile_up]),
        modulus=np.array([45e9]),
        effective_radius=np.array([0.01]),
    )


def restitution(law: Face, z: np.ndarray) -> np.ndarray:
    """Coefficient of restitution of an impact to the depth z, without waves."""
    state = law.pressed(z)
    return np.sqrt(state.stored / (state.stored + state.dissipated))


def table() -> np.ndarray:
    return np.genfromtxt(THETA, delimiter=",", names=True)


@pytest.mark.parametrize("row", table(), ids=lambda row: f"b={row['b']:.3g} z={row['z']:g}")
def test_the_law_has_the_values_of_its_table(row):
    law = face(float(row["b"]), 8.0 / 3.0 if 2.6 < row["C"] < 2.7 else float(row["C"]))
    z = np.array([row["z"]])
    unit = law.onset_force * law.onset_approach
    state = law.pressed(z)
    found = {
        "L": law.force(z),
        "A": law.area(z),
        "W": law.work(z),
        "alpha_e": law.recovery(z),
        "D": state.dissipated / unit,
        "p_m": state.p_mean / law.onset,
        "p_0": state.p_max / law.onset,
        "e": restitution(law, z),
    }
    for name, value in found.items():
        assert value[0] == pytest.approx(row[name], rel=2e-9), name


@pytest.mark.parametrize(
    ("z", "e"), [(1.5, 0.959026475555), (4.0, 0.772048646978), (30.0, 0.468045828767)]
)
def test_thornton_has_his_closed_form(z, e):
    law = face(0.0, 1.0)
    rho = math.sqrt(0.4 / law.work(np.array([z]))[0])
    closed = (
        math.sqrt(1.2 * math.sqrt(3.0))
        * math.sqrt(1.0 - rho**2 / 6.0)
        * (rho / (rho + 2.0 * math.sqrt(1.2 - rho**2 / 5.0))) ** 0.25
    )
    assert restitution(law, np.array([z]))[0] == pytest.approx(closed, rel=1e-12)
    assert closed == pytest.approx(e, rel=1e-11)


@pytest.mark.parametrize("pile_up", [1.0, 1.5, 2.0, 8.0 / 3.0, 2.9])
@pytest.mark.parametrize("ratio", [1.0, 1.6, 2.0, 4.0, 40.0])
def test_what_a_face_takes_grows_with_its_depth(pile_up, ratio):
    law = face(pile_up * ratio - 1.0, pile_up)
    z = np.geomspace(0.01, 1e6, 4001)
    state = law.pressed(z)
    for name in ("P_max", "a_max", "p_mean", "p_max", "dissipated", "stored", "dent_left"):
        values = getattr(state, name)
        assert np.all(np.diff(values) >= -1e-13 * values[1:]), name
    assert np.all(state.dent_left <= state.alpha_max)
    assert np.all(state.p_max <= law.hardness * (1.0 + 1e-14))
    slope = np.gradient(law.force(z), z)
    smooth = np.abs(np.log(z)) > 0.02  # b = 0 has a bend at onset
    smooth[[0, -1]] = False
    assert slope[smooth] == pytest.approx(law.slope(z)[smooth], rel=2e-4)
    back = law.depth_at(state.P_max)
    assert back == pytest.approx(z, rel=1e-12)


def test_work_is_the_integral_of_force():
    from scipy.integrate import quad

    for b, pile_up in ((0.0, 1.0), (0.5, 1.5), (3.0, 2.0), (80.0, 8.0 / 3.0)):
        law = face(b, pile_up)
        for z in (1.01, 2.0, 50.0):
            beyond = quad(
                lambda x, law=law: float(law.force(np.array([x]))[0]),
                1.0,
                z,
                epsabs=0.0,
                epsrel=1e-13,
            )[0]
            assert law.work(np.array([z]))[0] == pytest.approx(0.4 + beyond, rel=1e-12)


def test_hardness_without_end_is_hertz():
    """The force for any pile-up; area and dent without pile-up.  (C12) is no limit: its p_0 tends
    to p_m + p_y/3.
    """
    z = np.array([1.5, 4.0, 25.0])
    assert face(1e7, 2.0).force(z) == pytest.approx(z**1.5, rel=1e-5)
    law = face(1e7, 1.0)
    assert law.onset_force == pytest.approx(
        4.0 / 3.0 * 45e9 * math.sqrt(0.01) * law.onset_approach**1.5
    )
    assert np.all(law.pressed(z).dent_left < 1e-4 * z * law.onset_approach)


def test_far_beyond_onset_restitution_falls_as_johnson_says():
    """e² -> 1.2 (1 + b)/sqrt(C) z^(-1/2): Johnson, Contact Mechanics (11.46), for C = 2."""
    law, z = face(3.0, 2.0), np.array([1e8])
    assert restitution(law, z)[0] ** 2 == pytest.approx(1.2 * 4.0 / math.sqrt(2.0) * 1e-4, rel=2e-2)


def test_metal_begins_to_yield_at_sixteen_tenths_of_its_strength():
    assert metal_onset(np.array([1.9e9]), 0.3) == pytest.approx(3.069e9, rel=1e-3)


@pytest.mark.parametrize("rig", ["platens", "bars"])
def test_a_row_that_never_yields_beside_one_that_does_is_hertz(rig: str) -> None:
    numbers = EXAMPLE | {"sphere.hardness": 6e9}
    if rig == "platens":
        numbers = {name: x for name, x in numbers.items() if name.startswith("sphere")}
        numbers |= {"platens.E": 210e9, "platens.nu": 0.3, "platens.force": 5e3}
    columns = {name: np.full(2, value) for name, value in numbers.items()}
    elastic = solve_scene(Scene(columns=columns, rig=rig))
    columns["sphere.onset_pressure"] = np.array([1e9, np.inf])
    mixed = solve_scene(Scene(columns=columns, rig=rig, contact_law="plastic"))
    assert mixed.status.tolist() == [0, 0]
    for name, values in elastic.values.items():
        assert mixed.values[name][1] == pytest.approx(values[1], rel=1e-6), name
    assert mixed.values["p_max"][0] < elastic.values["p_max"][0]
