"""The law of a contact from a slow test: made-up records give back what they were made with, bad ones say why not."""

import json

import numpy as np
import pytest

from uqsphere.cli import main
from uqsphere.mechanics.yielding import Face
from uqsphere.records.loading import Loading, fit_contact, read_loading
from uqsphere.records.table import RecordError

#: samples that were shuffled
ORDER = np.random.default_rng(9).permutation(116)
TRUE = {"onset": 0.85e9, "hardness": 1.7e9, "pile_up": 2.0, "modulus": 45e9}


def made(rng, *, top=20.0, count=120, noise=1e-7, force_noise=3e-4, compliance=0.0) -> Loading:
    """Loaded to `top` times the force of first yield and let go, with noise of displacement [m] and force (share)."""
    face = Face(**{k: np.array([v]) for k, v in TRUE.items()}, effective_radius=np.array([0.01]))
    largest = face.onset_force[0] * top
    force = largest * np.concatenate([np.linspace(0, 1, count // 2), np.linspace(1, 0, count // 2)])
    wide = Face(**{k: np.full(count // 2, v) for k, v in TRUE.items()}, effective_radius=np.full(count // 2, 0.01))
    depth = wide.depth_at(force[: count // 2])
    back = depth[-1] - face.recovery(depth[[-1]]) * (1.0 - np.cbrt((force[count // 2 :] / largest) ** 2))
    approach = np.concatenate([depth, back]) * face.onset_approach[0]
    read = force + rng.normal(0.0, force_noise * largest, count)
    return Loading(displacement=2 * approach + 3e-6 + compliance * force + rng.normal(0.0, noise, count), force=read)


def test_a_record_without_noise_gives_the_law_back():
    quiet = made(np.random.default_rng(1), noise=0.0, force_noise=0.0, compliance=1e-9)
    fit = fit_contact(quiet, diameter=0.02, compliance=1e-9)
    for name, value in TRUE.items():
        assert getattr(fit, name).value == pytest.approx(value, rel=1e-4)
    assert fit_contact(quiet, diameter=0.02, compliance=1e-9, pile_up=2.0).hardness.value == pytest.approx(
        1.7e9, rel=1e-4
    )


def test_the_intervals_cover():
    """Of 30 records with noise; 95 % of the intervals should hold the true number, 4 standard errors are 16 %."""
    rng, held = np.random.default_rng(20), dict.fromkeys(TRUE, 0)
    for _ in range(30):
        fit = fit_contact(made(rng), diameter=0.02)
        for name, value in TRUE.items():
            held[name] += getattr(fit, name).low <= value <= getattr(fit, name).high
    assert min(held.values()) >= 0.79 * 30, held


def write(tmp_path, loading: Loading, header="displacement [um],force [kN]"):
    rows = [f"{1e6 * d:.6f},{1e-3 * f:.9f}" for d, f in zip(loading.displacement, loading.force, strict=True)]
    (tmp_path / "slow.csv").write_text("\n".join([header, *rows]) + "\n")
    return tmp_path / "slow.csv"


def test_the_command_prints_the_lines_of_a_study(tmp_path, capsys):
    path = write(tmp_path, made(np.random.default_rng(3)))
    assert main(["fit-contact", str(path), "--diameter", "20 mm", "--platens", "maraging_steel"]) == 0
    told = capsys.readouterr().out
    assert '[contact]\nlaw = "plastic"\nonset_pressure = "0.8' in told
    assert main(["fit-contact", str(path), "--diameter", "20 mm", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["hardness"]["low"] < 1.7e9 < found["hardness"]["high"]
    assert not [note for note in found["notes"] if "--pile-up" in note]
    noisy = write(tmp_path, made(np.random.default_rng(2), noise=1e-6))
    assert main(["fit-contact", str(noisy), "--diameter", "20 mm"]) == 0
    assert "hardly tells hardness from pile-up" in capsys.readouterr().err


@pytest.mark.parametrize(("change", "said"), [
    (lambda one: Loading(displacement=one.displacement[:60], force=one.force[:60]), "not unloaded"),
    (lambda one: Loading(displacement=one.displacement, force=-np.abs(one.force)), "never positive"),
    (lambda one: Loading(displacement=-one.displacement, force=one.force), "does not grow"),
    (lambda one: Loading(displacement=one.displacement[::4], force=one.force[::4]), "samples above"),
    (lambda one: Loading(displacement=-one.displacement + 2e-6 * np.sin(np.arange(116.0)), force=one.force),
     "does not grow"),
    (lambda one: Loading(displacement=one.displacement[ORDER], force=one.force[ORDER]), "in the order"),
    (lambda one: Loading(displacement=one.displacement, force=one.force + 0.1 * one.force.max()),
     "no law of a contact follows"),
    (lambda one: Loading(displacement=one.displacement, force=np.minimum(one.force, 0.7 * one.force.max())),
     "most at 100% of the largest"),
])  # fmt: skip
def test_what_is_no_test_is_refused(change, said):
    with pytest.raises(RecordError, match=said):
        fit_contact(change(made(np.random.default_rng(2), count=116)), diameter=0.02)


def test_an_elastic_test_has_no_onset():
    with pytest.raises(RecordError, match="hardly beyond Hertz"):
        fit_contact(made(np.random.default_rng(2), top=0.8, noise=1e-8), diameter=0.02)


def test_a_drift_is_told(tmp_path, capsys):
    one = made(np.random.default_rng(3))
    asked = ["fit-contact", str(write(tmp_path, one)), "--diameter", "20 mm"]
    assert main(asked) == 0
    assert "alike" not in capsys.readouterr().err
    drift = np.concatenate([np.zeros(60), np.linspace(1e-6, 2e-6, 60)])
    write(tmp_path, Loading(displacement=one.displacement + drift, force=one.force))
    assert main(asked) == 0
    assert "neighbouring residuals are alike" in capsys.readouterr().err


def test_units_may_end_the_names_and_platens_are_bars_or_plates(tmp_path, capsys):
    one = made(np.random.default_rng(3))
    text = "displacement_um,force_kN\n"
    text += "".join(f"{1e6 * d:.9g},{1e-3 * p:.9g}\n" for d, p in zip(one.displacement, one.force, strict=True))
    (tmp_path / "test.csv").write_text(text)
    found = {}
    for platens in ("rigid", "hard_4340", "tungsten_carbide"):
        asked = ["fit-contact", str(tmp_path / "test.csv"), "--diameter", "20 mm", "--json", "--platens", platens]
        assert main(asked) == 0
        found[platens] = json.loads(capsys.readouterr().out)["sphere_modulus"]["value"]
    # the softer the platens, the stiffer the sphere
    assert found["rigid"] < found["tungsten_carbide"] < found["hard_4340"]


def test_numbers_of_another_unit_are_doubted(tmp_path, capsys):
    path = write(tmp_path, made(np.random.default_rng(3)), header="displacement [um],force [N]")
    assert main(["fit-contact", str(path), "--diameter", "20 mm"]) == 0
    told = capsys.readouterr().err
    assert told.count("is unusual") == 2
    assert "are the units, those of the force and of the displacement, and the diameter right?" in " ".join(
        told.split()
    )


def test_a_hardness_that_is_not_told_says_so(tmp_path, capsys):
    path = write(tmp_path, made(np.random.default_rng(4), top=2.2, count=400, noise=1e-7))
    assert main(["fit-contact", str(path), "--diameter", "20 mm"]) == 0
    assert "# not told by this test" in capsys.readouterr().out


def test_faults_of_a_file_are_located(tmp_path, capsys):
    path = write(tmp_path, made(np.random.default_rng(3)), header="displacement,force [kN]")
    with pytest.raises(RecordError, match="no unit"):
        read_loading(path)
    path.write_text(path.read_text().replace("displacement,", "displacement [um],").replace("\n3", "\nx3", 1))
    assert main(["fit-contact", str(path), "--diameter", "20 mm"]) == 2
    assert main(["fit-contact", str(path), "--diameter", "20"]) == 2
    told = capsys.readouterr().err
    assert "slow.csv: line 8: found 'x3" in told
    assert "--diameter" in told
    write(tmp_path, made(np.random.default_rng(3)))
    with pytest.raises(RecordError, match="the column 'way' is not in the file"):
        read_loading(path, columns=["way", "force"])
