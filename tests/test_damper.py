"""An end whose impedance depends on frequency: against numbers, against mass and dashpot as a differential equation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import uqsphere
from uqsphere.cli import main
from uqsphere.errors import StudyError, UsageError
from uqsphere.mechanics.damper import Damper, _reflect, _weights, damper_from_impedance
from uqsphere.mechanics.field import field_at
from uqsphere.mechanics.gauges import wave_energies
from uqsphere.mechanics.history import trace
from uqsphere.mechanics.scene import Scene

BASE = {
    "sphere.E": 52e9, "sphere.nu": 0.25, "sphere.radius": 0.01, "sphere.density": 7650.0,
    "bars.E": 210e9, "bars.nu": 0.3, "bars.density": 7850.0, "bars.diameter": 0.04,
    "bars.incident_length": 0.6, "bars.receiving_length": 0.5,
    "bars.incident_end": 1.0, "bars.receiving_end": 0.4, "striker.length": 0.2, "striker.speed": 1.0,
}  # fmt: skip
C0 = np.sqrt(210e9 / 7850.0)
Z = 7850.0 * C0 * np.pi * 0.02**2
FREQUENCY = np.linspace(50.0, 2e6, 20_000)
#: time constant of a mass on the bar, and dashpot over the bar's impedance
TAU, DASHPOT = 40e-6, 0.5


def scene_with(**changes: float) -> Scene:
    return Scene(columns={k: np.array([v]) for k, v in {**BASE, **changes}.items()}, horizon=1.2e-3)


def mass_and_dashpot(sign: float = 1.0) -> Damper:
    return damper_from_impedance(FREQUENCY, Z * (DASHPOT + sign * 2j * np.pi * FREQUENCY * TAU), Z)


@pytest.mark.parametrize("R", [0.4, -1.0, 1.0])
def test_a_number_given_as_a_table_is_that_number(R):
    scene = scene_with(**{"bars.receiving_end": R})
    number = trace(scene, tolerance=1e-9)
    table = trace(scene, damper=Damper(frequency=FREQUENCY, coefficient=np.full(FREQUENCY.shape, R, dtype=complex)))
    times = np.linspace(0.0, 1.2e-3, 700)
    one, other = (found.motion.states_at(times) for found in (number, table))
    assert (np.abs(other - one) / np.abs(one).max(axis=0)).max() < 2e-6
    assert table.record_end == pytest.approx(number.record_end, rel=1e-6)
    for bar in ("incident", "receiving"):
        seen = [field_at(found.motion, bar, 0.2, times[20:]).stress for found in (number, table)]
        near = np.abs(seen[1] - seen[0]) < 1e-6 * np.abs(seen[0]).max()
        # an instant at a front of the pulse is on either side of it
        assert near.mean() > 0.995


def test_a_wave_that_mass_and_dashpot_send_back():
    """m v' + c v = Z (2 k - v) for the face, h = v - k, by an integrator of differential equations."""
    step = 1e-7
    times = step * np.arange(12_000)

    def wave(t):
        return np.sin(np.pi * np.clip(t / 400e-6, 0.0, 1.0)) ** 2

    face = solve_ivp(lambda t, v: (2.0 * wave(t) - (1.0 + DASHPOT) * v) / TAU, (0.0, times[-1]), [0.0], rtol=1e-10,
                     atol=1e-12, dense_output=True, max_step=2e-6)  # fmt: skip
    expected = face.sol(times)[0] - wave(times)
    damper = mass_and_dashpot()
    found = _reflect(damper, _weights(damper, step, len(times)), wave(times))
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_sphere_and_damper_are_coupled():
    """The far end obeys its own equation of motion in the field that the coupled solution leaves."""
    found = trace(scene_with(), damper=mass_and_dashpot())
    times = np.linspace(0.0, 1.15e-3, 40_001)
    end = field_at(found.motion, "receiving", 0.5, times)
    force = -end.stress * np.pi * 0.02**2
    # m (v(t) - v(0)) = ∫ force - c v: the impulse, which needs no derivative
    impulse = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(times) * (force[1:] + force[:-1]))])
    given = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(times) * (end.velocity[1:] + end.velocity[:-1]))])
    np.testing.assert_allclose(
        impulse - DASHPOT * Z * given, TAU * Z * end.velocity, atol=2e-5 * TAU * Z * np.abs(end.velocity).max()
    )
    # and energy is lost in the dashpot alone
    assert wave_energies(found.motion, 1.1e-3).absorbed > -1e-9
    plain = trace(scene_with(), tolerance=1e-8)
    assert abs(found.first_peak.pressure / plain.first_peak.pressure - 1.0) > 1e-6


def test_a_table_that_foresees_is_refused():
    with pytest.raises(ValueError, match="not causal"):
        trace(scene_with(), damper=mass_and_dashpot(-1.0))


@pytest.mark.parametrize(
    ("frequency", "coefficient", "words"),
    [
        ([1.0], [0.0], "at least 2"),
        ([1.0, 2.0], [0.0], "one length"),
        ([2.0, 1.0], [0.0, 0.0], "ascend"),
        ([0.0, 1.0], [0.0, 0.0], "positive"),
        ([1.0, 2.0], [0.0, np.nan], "finite"),
        ([1.0, 2.0], [0.0, 1.1], "more than it gets"),
    ],
)
def test_wrong_tables_are_refused(frequency, coefficient, words):
    with pytest.raises(ValueError, match=words):
        Damper(frequency=np.array(frequency), coefficient=np.array(coefficient, dtype=complex))


def test_what_a_damper_does_not_go_with():
    with pytest.raises(ValueError, match="must not be negative"):
        damper_from_impedance([1.0, 2.0], [-1.0, 1.0], Z)
    with pytest.raises(ValueError, match="full model"):
        trace(scene_with(), fidelity="linear", damper=mass_and_dashpot())
    endless = Scene(columns=scene_with().columns, infinite=True)
    with pytest.raises(ValueError, match="infinite bars have none"):
        trace(endless, damper=mass_and_dashpot())
    with pytest.raises(ValueError, match="too light"):
        trace(scene_with(**{"sphere.density": 1e-6}), damper=mass_and_dashpot())


# --- in a study ---------------------------------------------------------------------------------------


@pytest.fixture
def damped(small_text, tmp_path):
    """A study with a mass of 50 g on a matched dashpot at its end."""
    lines = [line for line in small_text.splitlines() if not line.startswith("receiving_end")]
    text = "\n".join([*lines, ""]).replace("[bars]", '[bars]\nreceiving_damper = "damper.csv"')
    rows = [f"{f:.6g},4500,{2 * np.pi * f * 0.05:.8g}" for f in np.linspace(100.0, 1e6, 3000)]
    (tmp_path / "damper.csv").write_text("\n".join(["frequency,impedance_real,impedance_imag", *rows, ""]))
    return text.replace("[model]", '[model]\nhorizon = "300 us"')


def test_history_follows_a_damper_and_a_run_refuses_it(study_from, damped, tmp_path, capsys):
    study = study_from(text=damped)
    assert "receiving_damper" in study.resolved()
    found = uqsphere.history(study)
    assert found.motion.returning is not None
    assert any("history alone" in warning for warning in study.warnings)
    with pytest.raises(UsageError, match="as a number, receiving_end"):
        uqsphere.evaluate(study, {"striker.speed": np.array([5.0])}, quantities=("p_max",))
    path = tmp_path / "study.toml"
    assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 2
    assert not (tmp_path / "out").exists()
    assert main(["history", str(path)]) == 0
    capsys.readouterr()


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (('bars.receiving_end="free"',), "given twice"),
        (("bars.infinite=true",), "no far end"),
        (('bars.receiving_damper="../damper.csv"',), "own folder"),
        (('bars.receiving_damper="other.csv"',), "no file"),
        (("bars.receiving_damper=3",), "a text in quotes is due"),
    ],
)
def test_wrong_dampers_of_a_study_are_refused(study_from, damped, overrides, words):
    with pytest.raises(StudyError, match=words):
        study_from(*overrides, text=damped)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("frequency,impedance_real\n1,2\n3,4\n", "not in"),
        ("frequency,impedance_real,impedance_imag\n5,1,0\n4,1,0\n", "ascend"),
        ("frequency,impedance_real,impedance_imag\n5,1,0\n6,-1,0\n", "below 0"),
        ("frequency,impedance_real,impedance_imag\n5,1,0\n6,x,0\n", "finite number"),
    ],
)
def test_wrong_tables_of_a_study_are_refused(study_from, damped, tmp_path, content, words):
    (tmp_path / "damper.csv").write_text(content)
    with pytest.raises(StudyError, match=words):
        study_from(text=damped)
