"""Damage: (C16) and (C17) against quadrature, in closed form, against a second integrator, and blow by blow."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from test_contact_study import BASE, load

from tests.independent.rigs import Pole, strike
from tests.independent.yielding import Wearing, follow
from uqsphere.mechanics.closed_form import closed_form_rows, solve_blow
from uqsphere.mechanics.integrator.solve import solve
from uqsphere.mechanics.outputs import after_blows
from uqsphere.mechanics.scene import BROKEN, Scene
from uqsphere.mechanics.yielding import damage_of, energy_share, peak_damage

DAMAGE = ("contact.law=damage", "contact.gamma=5", "contact.fracture_energy='{} J/kg'", "model.horizon='3 ms'",
          "contact.blows={}", "striker.length='4 m'")  # fmt: skip


@pytest.mark.parametrize("gamma", [2.0, 3.4, 5.0, 8.0])
def test_the_energy_of_a_damage_is_the_work_of_the_softening_law(gamma):
    def work(x):
        # over s with x = s², where nothing is singular
        return quad(lambda s: 2.0 * (1.0 - s ** (2.0 * gamma)) * s**4, 0.0, x**0.5, epsabs=1e-15, epsrel=1e-13)[0]

    for d in (0.05, 0.23, 0.5, 1.0):
        share = work(d ** (1.0 / gamma)) / work(1.0)
        assert energy_share(d, gamma) == pytest.approx(share, rel=1e-12)
        # at d = 1 the force is nothing, and the energy says little of the damage
        assert damage_of(share, gamma) == pytest.approx(d, abs=1e-12 if d < 1.0 else 1e-7)
    x = np.linspace(0.0, 1.0, 100_001)
    top = x[np.argmax((1.0 - x**gamma) * x**1.5)]
    assert peak_damage(gamma) == pytest.approx(top**gamma, abs=1e-3)


STEEL = {"E": 210e9, "nu": 0.3, "density": 7850.0}


def rock(rig: str, speeds: list[float], energy: float, **tables: dict[str, float]) -> Scene:
    """Limestone of 20 mm with gamma = 5 and a fracture energy [J/kg]."""
    numbers = {"sphere.E": 60e9, "sphere.nu": 0.25, "sphere.radius": 0.01, "sphere.density": 2600.0}
    numbers |= {"contact.gamma": 5.0, "contact.fracture_energy": energy}
    numbers |= {f"{table}.{key}": value for table, part in tables.items() for key, value in part.items()}
    columns = {name: np.full(len(speeds), number) for name, number in numbers.items()}
    mover = {"impact": "rig.speed", "bars": "striker.speed"}.get(rig, "hammer.speed")
    return Scene(columns=columns | {mover: np.array(speeds)}, rig=rig, contact_law="damage", infinite=True)


QUANTITIES = ("P_max", "p_max", "alpha_max", "energy", "specific_energy_sphere", "contact_time", "damage", "rise_time",
              "plastic_work")  # fmt: skip


def test_a_blow_in_closed_form_is_what_the_integrator_finds_and_what_tavares_says():
    given = rock("impact", [0.5, 1.0, 2.0, 3.0, 5.0], 20.0, target=STEEL)
    assert closed_form_rows(given).all()
    integrated, closed = solve(given, tolerance=1e-9, quantities=QUANTITIES), solve_blow(given, QUANTITIES)
    for name in QUANTITIES:
        assert integrated.values[name] == pytest.approx(closed.values[name], rel=5e-9), name
    # the sphere's share of what the blow offers does the damage, (C17)
    share = given.partners[1].share * 0.5 * np.square(given.columns["rig.speed"]) / 20.0
    assert closed.values["damage"] == pytest.approx(damage_of(share, 5.0), rel=1e-10)
    assert closed.values["specific_energy_sphere"] == pytest.approx(share * 20.0, rel=1e-10)


def test_a_sphere_whose_force_passes_its_peak_has_broken():
    given = rock("impact", [5.0, 9.0, 40.0], 20.0, target=STEEL)
    assert closed_form_rows(given).tolist() == [True, False, False]
    found = solve(given, tolerance=1e-9, quantities=("P_max", "damage", "contact_time"))
    law, broken = given.partners[1].face, np.array([False, True, True])
    peak = law.force(law.peak) * law.onset_force
    assert found.values["P_max"][broken] == pytest.approx(peak[broken], rel=1e-9)
    assert found.values["damage"][broken] == pytest.approx(float(peak_damage(5.0)), rel=1e-8)
    assert found.status.tolist() == [0, 0, 0]
    assert found.censored["contact_time"].tolist() == broken.tolist()
    # faster blows break it sooner, and none has a rebound
    assert found.values["contact_time"][1] > found.values["contact_time"][2]
    assert solve(given, quantities=("P_max", "restitution")).status.tolist() == [0, BROKEN, BROKEN]
    static = solve(replace(given, contact_dynamics="elastic"), quantities=("P_max", "damage"))
    assert static.values["P_max"] == pytest.approx(found.values["P_max"], rel=1e-6)
    pressed = rock("platens", [0.1], 20.0, platens={**STEEL, "force": 2.0 * float(peak[0])})
    assert solve_blow(pressed, ("P_max", "damage")).values["damage"] == pytest.approx(float(peak_damage(5.0)))


def test_a_second_integrator_of_another_method_agrees():
    """Bars and a weight on a sphere, with damage in the motion; and the balances of energy."""
    bars = rock("bars", [0.2, 0.4], 60.0, bars={**STEEL, "diameter": 0.04}, striker={"length": 1.0})
    weight = rock("drop_weight", [1.0, 2.5], 40.0, hammer={**STEEL, "mass": 0.05}, anvil={**STEEL, "E": 70e9})
    for scene in (bars, weight):
        found, scales = solve(scene, tolerance=1e-9, quantities=("P_max", "damage", "contact_time")), scene.scales
        assert (found.status == 0).all()
        for row in range(2):
            laws = [
                Wearing(critical=one.face.critical[row] / scales.approach[row], gamma=5.0,
                        stiffness=one.hertz_constant[row] / scales.hertz_constant[row])
                for one in scene.partners
            ]  # fmt: skip
            mu, forces = float(scales.mass_number[row]), found.values["P_max"][row] / scales.force[row]
            if scene is bars:
                theta = float(scales.pulse_number[row])
                way = follow(mu, lambda t, theta=theta: float(t < theta), [theta], 300.0, laws)
                assert way.energy == pytest.approx(way.work, rel=1e-9)
                largest = way.largest
            else:
                poles = [Pole(mass=1.0, speed=1.0, law=laws[0]), Pole(law=laws[1])]
                blow = strike(mu, 0.0, poles)
                kinetic = 0.5 * mu * blow.speeds[0] ** 2 + 0.5 * blow.speeds[1] ** 2
                assert kinetic + sum(law.energy(0.0) for law in laws) == pytest.approx(0.5, rel=1e-9)
                largest, loss = blow.largest, blow.first_loss * scales.time[row]
                assert found.values["contact_time"][row] == pytest.approx(loss, rel=1e-7)
            damage = [(x / law.critical) ** 5.0 for x, law in zip(largest, laws, strict=True)]
            assert found.values["damage"][row] == pytest.approx(max(damage), rel=1e-7)
            pushes = [w.stiffness * (1 - d) * x**1.5 for x, d, w in zip(largest, damage, laws, strict=True)]
            assert forces == pytest.approx(max(pushes), rel=1e-7)


def test_blows_leave_less_to_the_next_until_one_breaks_the_sphere():
    """By hand: every blow meets E* and E_f times what those before have left, and (C17) says what it takes."""
    given = rock("impact", [1.5, 3.0, 5.0, 9.0], 20.0, target=STEEL)
    given = replace(given, blows=12)
    found = after_blows(given, lambda scene, names: _blow(scene, names), ("P_max", "broke_at"))
    for row, speed in enumerate(given.columns["rig.speed"]):
        left, blow, chi = 1.0, 0, float(given.partners[1].share[row])
        while blow < 12:
            blow += 1
            share = (1.0 - left * (1.0 - chi)) * 0.5 * speed**2 / (20.0 * left)
            done = float(damage_of(share, 5.0))
            if done >= peak_damage(5.0):
                break
            left *= 1.0 - done
        assert found.values["broke_at"][row] == blow
        assert bool(found.censored["broke_at"][row]) == bool(done < peak_damage(5.0))
    assert found.values["broke_at"].tolist() == sorted(found.values["broke_at"], reverse=True)
    assert not found.censored["broke_at"][2:].any()
    assert found.censored["broke_at"][0]


def _blow(scene, names):
    closed = closed_form_rows(scene).all()
    return solve_blow(scene, names) if closed else solve(scene, quantities=names)


def test_without_damage_no_blow_is_counted(tmp_path):
    text = BASE.replace('"p_max"', '"broke_at"').replace('"4 GPa"', "3").replace('strength_is = "pressure"', "")
    study = load(tmp_path, *(part.format(50.0 if "energy" in part else 5) for part in DAMAGE), text=text)
    assert study.limits[0].quantity == "broke_at"
