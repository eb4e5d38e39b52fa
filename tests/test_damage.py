"""Damage by blows: (C16) and (C17) against quadrature, and a sphere that is struck until it breaks."""

import numpy as np
import pytest
from scipy.integrate import quad
from test_contact_study import BASE, load

from uqsphere.mechanics.damage import damage_of, energy_share, peak_damage
from uqsphere.model import evaluate

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


def settings(energy: float, blows: int) -> tuple[str, ...]:
    return tuple(part.format(energy if "energy" in part else blows) for part in DAMAGE)


def test_equal_blows_wear_a_sphere_out(tmp_path):
    """Blow by blow by hand: E* and E_f shrink by what (C17) says, until the force would pass its peak."""
    sound = load(tmp_path, "contact.law=hertz", "model.horizon='3 ms'", "striker.length='4 m'")
    first = evaluate(sound, {"striker.speed": [0.5]}, ("specific_energy_sphere", "P_max"))
    offered = float(first["specific_energy_sphere"][0])
    weak, strong = 2.0 * offered, 40.0 * offered
    for energy, broken in ((0.5 * offered, True), (weak, True), (strong, False)):
        study = load(tmp_path, *settings(energy, 6))
        found = evaluate(study, {"striker.speed": [0.5]}, ("broke_at", "P_max", "specific_energy_sphere"))
        assert bool(found["censored"][0]) is not broken
        if energy < offered:
            assert found["broke_at"][0] == 1.0
            assert found["P_max"][0] == pytest.approx(first["P_max"][0], rel=1e-12)
        elif broken:
            assert 1.0 < found["broke_at"][0] <= 6.0
        else:
            assert found["broke_at"][0] == 6.0
            d = damage_of(offered / strong, 5.0)
            two = evaluate(load(tmp_path, *settings(strong, 2)), {"striker.speed": [0.5]}, ("P_max",))
            nu, E, bar = 0.25, 52e9, (1 - 0.3**2) / 205e9
            left = 1.0 / ((1 - nu**2) / E + bar) * (1.0 - d)
            softer = (1 - nu**2) / (1.0 / left - bar)
            by_hand = evaluate(sound, {"striker.speed": [0.5], "sphere.E": [softer]}, ("P_max",))
            assert two["P_max"][0] == pytest.approx(by_hand["P_max"][0], rel=1e-6)


def test_without_damage_no_blow_is_counted(tmp_path):
    text = BASE.replace('"p_max"', '"broke_at"').replace('"4 GPa"', "3").replace('strength_is = "pressure"', "")
    study = load(tmp_path, *settings(50.0, 5), text=text)
    assert study.limits[0].quantity == "broke_at"
