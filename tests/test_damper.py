"""An end whose impedance depends on frequency: against numbers, against mass and dashpot as a differential equation."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import EXAMPLE
from scipy.integrate import solve_ivp

import uqsphere
from uqsphere.cli import main
from uqsphere.errors import StudyError, UsageError
from uqsphere.mechanics.bars import correct, disperse, phase_speed, surface_factors
from uqsphere.mechanics.damper import Damper, _reflect, _weights, damper_from_impedance
from uqsphere.mechanics.field import field_at
from uqsphere.mechanics.history import trace
from uqsphere.mechanics.scene import Scene

BASE = EXAMPLE | {
    "sphere.density": 7650.0, "bars.incident_length": 0.6, "bars.receiving_length": 0.5, "bars.receiving_end": 0.4,
    "striker.length": 0.2,
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
    plain = trace(scene_with(), tolerance=1e-8)
    assert abs(found.first_peak.pressure / plain.first_peak.pressure - 1.0) > 1e-6


def test_a_table_that_foresees_is_refused():
    with pytest.raises(ValueError, match="not causal"):
        trace(scene_with(), damper=mass_and_dashpot(-1.0))


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


# --- dispersion: Bancroft's table, the limits of long and short waves, an independent equation, packets, the way back


EXACT = 1e-12

#: c/c0 over d/wavelength and Poisson's ratio, D. Bancroft, Phys. Rev. 59, 588 (1941), table I
RATIOS = (0.10, 0.15, 0.20, 0.25, 0.30, 0.35, 0.40)
BANCROFT = {
    0.05: (0.99994, 0.99986, 0.99975, 0.99961, 0.99944, 0.99924, 0.99901),
    0.10: (0.99975, 0.99943, 0.99899, 0.99843, 0.99774, 0.99694, 0.99602),
    0.15: (0.99941, 0.99868, 0.99766, 0.99638, 0.99482, 0.99302, 0.99097),
    0.20: (0.99890, 0.99754, 0.99568, 0.99333, 0.99054, 0.98732, 0.98373),
    0.25: (0.99816, 0.99591, 0.99287, 0.98909, 0.98466, 0.97967, 0.97418),
    0.30: (0.99710, 0.99362, 0.98899, 0.98337, 0.97691, 0.96979, 0.96214),
    0.40: (0.99323, 0.98569, 0.97627, 0.96559, 0.95410, 0.94218, 0.93007),
    0.50: (0.98296, 0.96771, 0.95133, 0.93479, 0.91854, 0.90277, 0.88758),
    0.60: (0.94487, 0.92436, 0.90502, 0.88681, 0.86964, 0.85341, 0.83806),
    0.70: (0.86493, 0.85471, 0.84201, 0.82841, 0.81466, 0.80110, 0.78792),
    0.80: (0.79306, 0.78893, 0.78202, 0.77332, 0.76357, 0.75330, 0.74284),
    1.00: (0.70196, 0.70058, 0.69768, 0.69344, 0.68814, 0.68203, 0.67537),
    1.40: (0.62836, 0.62623, 0.62361, 0.62048, 0.61687, 0.61284, 0.60844),
    2.00: (0.60080, 0.59707, 0.59326, 0.58932, 0.58524, 0.58101, 0.57664),
}
#: the same table's limit of short waves
SHORT = (0.60213, 0.59491, 0.58804, 0.58148, 0.57516, 0.56903, 0.56307)
STEEL = {"radius": 0.01, "wave_speed": 5172.0, "nu": 0.29}


@pytest.mark.parametrize("column", range(len(RATIOS)), ids=[f"nu={nu}" for nu in RATIOS])
def test_phase_speed_against_bancroft(column: int) -> None:
    lengths = np.array(list(BANCROFT))
    published = np.array([row[column] for row in BANCROFT.values()])
    assert np.abs(phase_speed(np.pi * lengths, RATIOS[column]) - published).max() < 3e-5


def rayleigh_speed(nu: float) -> float:
    """Speed of Rayleigh's wave over c0: the root x = (c/c_T)² of x³ - 8 x² + (24 - 16 eta) x - 16 (1 - eta) = 0."""
    eta = 0.5 * (1.0 - 2.0 * nu) / (1.0 - nu)
    roots = np.roots([1.0, -8.0, 24.0 - 16.0 * eta, -16.0 * (1.0 - eta)])
    real = roots[np.abs(roots.imag) < 1e-9].real
    return float(np.sqrt(0.5 / (1.0 + nu) * real[(real > 0.0) & (real < 1.0)][0]))


def test_short_waves_are_rayleighs() -> None:
    for nu, published in zip(RATIOS, SHORT, strict=True):
        assert abs(rayleigh_speed(nu) - published) < 3e-5
    # the curvature of the surface dies out as 1/k
    far = np.array([20.0, 40.0, 60.0])
    gaps = np.abs(phase_speed(far, 0.3) - rayleigh_speed(0.3))
    assert gaps[-1] < 1e-3
    assert (np.diff(gaps) < 0.0).all()


def test_long_waves_are_those_of_the_thin_bar() -> None:
    k = np.array([0.02, 0.05, 0.1])
    for nu in (0.1, 0.3, 0.49):
        loss = 1.0 - phase_speed(k, nu)
        # Rayleigh and Love: 1 - nu² k²/4, the next term is of the order of k^4
        assert np.abs(loss / (0.25 * np.square(nu * k)) - 1.0).max() < 0.02
    assert phase_speed(0.0, 0.3)[0] == 1.0


@pytest.mark.parametrize("nu", [0.1, 0.29, 0.4])
def test_mean_stress_obeys_momentum(nu: float) -> None:
    # k sigma = rho omega v and v = c eps in the mean of the section: M_2 = (c/c0)², whatever the profile
    k = np.array([0.2, 0.7, 1.3, 1.841, 2.5, 5.0])
    speed = phase_speed(k, nu)
    strain, stress = surface_factors(k, speed, nu)
    assert np.abs(stress - np.square(speed)).max() < 1e-9
    long, _ = surface_factors(np.array([1e-3]), phase_speed([1e-3], nu), nu)
    assert abs(long[0] - 1.0) < 1e-6
    # the surface is strained less than the middle
    assert (strain[:3] > 1.0).all()


def test_correct_then_disperse_gives_the_input_back() -> None:
    rng = np.random.default_rng(3)
    for samples in (999, 1024):
        wave = rng.normal(size=samples) * 1e-4  # noise of every frequency is the hardest input
        for surface in (True, False):
            seen = disperse(wave, 5e-7, 0.75, surface=surface, **STEEL)
            again = correct(seen, 5e-7, 0.75, surface=surface, **STEEL)
            assert np.abs(again - wave).max() < 1e-10 * np.abs(wave).max()
            back = disperse(correct(wave, 5e-7, 0.75, surface=surface, **STEEL), 5e-7, 0.75, surface=surface, **STEEL)
            assert np.abs(back - wave).max() < 1e-10 * np.abs(wave).max()


def test_a_packet_travels_with_the_group_velocity() -> None:
    nu, radius, c0, step, distance = 0.29, 0.01, 5172.0, 1e-7, 0.8
    k = 1.0
    around = np.array([k - 1e-4, k + 1e-4])
    frequency = around * phase_speed(around, nu)
    group = (frequency[1] - frequency[0]) / (around[1] - around[0]) * c0
    omega = float(k * phase_speed([k], nu)[0]) * c0 / radius
    time = step * np.arange(16384)
    packet = np.exp(-np.square((time - 4e-4) / 8e-5)) * np.cos(omega * time)
    later = correct(packet, step, distance, radius=radius, wave_speed=c0, nu=nu, surface=False)
    centre = [float((time * wave**2).sum() / (wave**2).sum()) for wave in (packet, later)]
    delay = distance / group - distance / c0
    assert delay > 1e-5
    assert abs(centre[1] - centre[0] - delay) < 0.01 * delay


def test_impulse_is_kept_and_a_sharp_edge_rings() -> None:
    time = 1e-6 * np.arange(1024)
    wave = np.where((time > 2e-4) & (time < 4e-4), -1e-4, 0.0)
    seen = disperse(wave, 1e-6, 1.0, surface=False, **STEEL)
    assert abs(seen.sum() - wave.sum()) < EXACT
    assert np.abs(seen).max() > 1.05e-4
