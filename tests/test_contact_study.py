"""The table [contact] of a study: what it takes, what it refuses, and which pressure a strength is."""

from pathlib import Path

import numpy as np
import pytest

from uqsphere.errors import StudyError, UsageError
from uqsphere.mechanics.criteria import in_the_test
from uqsphere.mechanics.outputs import at_force, columns_of
from uqsphere.model import cheaper_fidelities, check_quantities, evaluate, scene_of, solve_scene
from uqsphere.runner.api import run
from uqsphere.runner.deterministic import compare_with_paper
from uqsphere.runner.fidelity import out_of_reach
from uqsphere.study import load_study

BASE = """
[sphere]
E = "52 GPa"
nu = 0.25
density = "2650 kg/m3"
radius = "10 mm"
[bars]
E = "205 GPa"
nu = 0.3
density = "7850 kg/m3"
yield_strength = "1000 MPa"
diameter = "40 mm"
infinite = true
[striker]
speed = "0.5 m/s"
length = "0.8 m"
[limits.crushing]
quantity = "p_max"
strength = "4 GPa"
strength_is = "pressure"
[contact]
law = "plastic"
"""


def load(tmp_path: Path, *settings: str, text: str = BASE):
    (tmp_path / "study.toml").write_text(text)
    return load_study(tmp_path / "study.toml", settings)


def faces(study, **columns):
    return scene_of(study, {name.replace("__", "."): np.array(values) for name, values in columns.items()}, None).faces


def test_the_softer_body_gives_all_three_numbers(tmp_path):
    study = load(tmp_path, "sphere.onset_pressure='1.5 GPa'", "sphere.hardness='4 GPa'")
    found = faces(study, bars__yield_strength=[0.8e9, 1.2e9])
    assert found.onset == pytest.approx([1.295 * np.exp(0.736 * 0.3) * 0.8e9, 1.5e9])
    assert found.hardness == pytest.approx([2.84 * 0.8e9, 4e9])
    assert found.pile_up == pytest.approx([8.0 / 3.0, 2.0])


def test_what_contact_gives_goes_first_and_inserts_stand_for_the_bars(tmp_path):
    study = load(tmp_path, "contact.hardness='3 GPa'", "bars.insert_E='550 GPa'", "bars.insert_nu=0.22",
                 "bars.insert_yield_strength='1.2 GPa'")  # fmt: skip
    found, scales = faces(study), scene_of(study, {}, 1).scales
    assert found.onset == pytest.approx(1.295 * np.exp(0.736 * 0.22) * 1.2e9)
    assert found.hardness == pytest.approx(3e9)
    assert 1.0 / scales.modulus == pytest.approx((1 - 0.25**2) / 52e9 + (1 - 0.22**2) / 550e9)
    assert scales.impedance == pytest.approx(np.sqrt(205e9 * 7850.0) * np.pi * 0.02**2)


def test_thornton_has_its_hardness_at_the_onset_in_every_row(tmp_path):
    study = load(tmp_path, "contact.pile_up=1", "contact.onset_pressure={ dist='normal', mean='1.5 GPa', cov=0.1 }")
    found = faces(study, contact__onset_pressure=[1.2e9, 1.9e9])
    assert np.array_equal(found.hardness, found.onset)
    assert np.array_equal(found.softening, [0.0, 0.0])


def test_a_study_without_contact_is_what_it_was(tmp_path):
    plain = load(tmp_path, text=BASE.replace("[contact]", "").replace('law = "plastic"', ""))
    hertz = load(tmp_path, "contact.law=hertz", "contact.pile_up=2")
    assert plain.hash == hertz.hash
    assert not any(key.startswith("contact") for key in plain.options)
    assert scene_of(plain, {}, 1).faces is None
    assert hertz.warnings == ('contact.pile_up: not used: it belongs to law = "plastic"',)
    for settings, law in (
        (("contact.law=hertz", "contact.dynamics=path"), "plastic"),
        (("contact.blows=3",), "damage"),
    ):
        (warning,) = load(tmp_path, *settings).warnings
        assert f'not used: it belongs to law = "{law}"' in warning


def test_a_study_without_scatter_misses_no_accuracy(tmp_path):
    study = load(tmp_path, "model.horizon='3 ms'", "analysis.quantities=['dent']", "limits.crushing=null")
    assert not run(study, out=tmp_path / "run").results.accuracy.missed


@pytest.mark.parametrize("asked", ["analysis.quantities=['dent']", "limits.crushing.quantity=damage"])
def test_what_elastic_bars_do_not_have_is_refused_with_the_law_that_has_it(tmp_path, asked):
    settings = ("contact.law=hertz", "limits.crushing.strength=0.5", "limits.crushing.strength_is=null", asked)
    text = BASE if "limits" in asked else BASE.replace("[limits.crushing]", "[limits.other]")
    study = load(tmp_path, *(settings if "limits" in asked else (settings[0], asked)), text=text)
    with pytest.raises(UsageError, match=r"the rig bars has no (dent|damage) here: .* law = .* is due"):
        check_quantities(study)


@pytest.mark.parametrize(
    ("meant", "quantity"), [("hertz", "p_hertz"), ("pressure", "p_max")], ids=["by a force", "true"]
)
def test_a_strength_says_which_pressure_it_is(tmp_path, meant, quantity):
    assert load(tmp_path, f"limits.crushing.strength_is={meant}").limits[0].quantity == quantity
    assert load(tmp_path, f"limits.crushing.strength_is={meant}", "contact.law=hertz").limits[0].quantity == "p_max"


def test_it_has_no_default_where_a_face_yields(tmp_path):
    with pytest.raises(StudyError) as raised:
        load(tmp_path, text=BASE.replace('strength_is = "pressure"', ""))
    (problem,) = raised.value.problems
    assert problem.path == "limits.crushing.strength_is"
    assert "\n" not in problem.message  # file, line, column and key at the head of every line


@pytest.mark.parametrize(("settings", "path", "said"), [
    (("contact.hardness='1 GPa'",), "contact.hardness", "give a hardness of 1.615 GPa or more"),
    (("sphere.hardness='1 GPa'",), "sphere.onset_pressure", "missing beside the hardness"),
    (("limits.crushing.quantity=p_hertz",), "limits.crushing.strength_is", 'strength_is = "hertz"'),
    (("sphere.onset_pressure='3 GPa'", "sphere.hardness='0.5 GPa'"), "sphere.hardness", "cannot flow at less than"),
    (("bars.onset_pressure='3 GPa'", "bars.hardness='1 GPa'"), "bars.hardness", "cannot flow at less than its onset"),
    (("contact.hardness='200 GPa'",), "contact.hardness", 'law = "hertz"'),
    (("contact.hardness='0 GPa'",), "contact.hardness", "above 0"),
    (("contact.hardness='-2 GPa'",), "contact.hardness", "above 0"),
    (("contact.onset_pressure='nan GPa'",), "contact.onset_pressure", "nan"),
    (("contact.pile_up=1.05", "contact.hardness='1.62 GPa'"), "contact.pile_up", "pile_up = 1.197 or more"),
    (("contact.pile_up=3.5",), "contact.pile_up", "from 1 to 3"),
    (("contact.law=soft",), "contact.law", "allowed"),
    (("model.fidelity=linear",), "model.fidelity", "no law of the contact"),
    (("bars.rigid_contact=true",), "bars.rigid_contact", "rigid bars do not yield"),
    (("sphere.onset_pressure='1 GPa'",), "sphere.hardness", "hardness is missing"),
    (("bars.insert_nu=0.2",), "bars.insert_nu", "insert_E is missing"),
    (("bars.insert_material='tungsten'",), "bars.insert_material", "did you mean 'tungsten_carbide'"),
    (("bars.insert_E='500 GPa'", "bars.rigid_contact=true"), "bars.insert_E", "rigid_contact"),
    (("limits.crushing.quantity=P_max", "limits.crushing.strength='5 kN'"), "limits.crushing.strength_is",
     "not on P_max"),
    (("contact.law=damage", "contact.fracture_energy='50 J/kg'"), "contact.gamma", "gamma is missing"),
    (("contact.law=damage", "contact.gamma=9", "contact.fracture_energy='50 J/kg'"), "contact.gamma", "from 2 to 8"),
    (("contact.law=damage", "contact.gamma=5", "contact.fracture_energy={ same_as='limits.crushing.strength' }"),
     "contact.fracture_energy.same_as", "no limit on a specific energy"),
    (("contact.law=damage", "contact.gamma=5", "contact.fracture_energy='5 J/kg'", "contact.blows=0"),
     "contact.blows", "from 1 to 1000"),
])  # fmt: skip
def test_bad_numbers_are_refused_with_the_way_out(tmp_path, settings, path, said):
    with pytest.raises(StudyError) as raised:
        load(tmp_path, *settings)
    assert {problem.path: problem.message for problem in raised.value.problems}.get(path, "").find(said) >= 0


def test_a_law_without_its_numbers_is_refused(tmp_path):
    text = BASE.replace('yield_strength = "1000 MPa"\n', "")
    with pytest.raises(StudyError, match=r"give bars\.yield_strength, bars\.insert_yield_strength or contact"):
        load(tmp_path, text=text)
    with pytest.raises(StudyError, match="hardness is missing"):
        load(tmp_path, "contact.onset_pressure='1 GPa'", text=text)
    study = load(tmp_path, "contact.onset_pressure='1 GPa'", "contact.hardness=onset", "contact.pile_up=2", text=text)
    assert faces(study).softening == pytest.approx(1.0)


def test_rows_without_a_law_have_status_1(tmp_path):
    scene = scene_of(load(tmp_path), {"contact.hardness": np.array([1e9, 2e9, 1e12])}, None)
    assert scene.status.tolist() == [1, 0, 1]


def test_the_law_at_the_end_is_a_fidelity_of_its_own(tmp_path):
    """Bars of 1 GPa under granite: the static law errs by less than 1 % in the pressure and far less in the force."""
    study = load(tmp_path, "model.horizon='3 ms'")
    quantities = ("p_max", "p_hertz", "P_max", "dent", "plastic_work", "energy")
    speeds = {"striker.speed": np.array([0.01, 0.3, 0.6])}
    path, end = (evaluate(study, speeds, quantities, fidelity=name) for name in ("full", "elastic"))
    assert path["p_max"][2] < 0.8 * path["p_hertz"][2]
    assert (end["p_max"] / path["p_max"]).between(1.0 - 1e-9, 1.01).all()
    assert path["dent"][0] == end["dent"][0] == 0.0
    for name in ("P_max", "energy"):
        assert end[name][0] == pytest.approx(path[name][0], rel=1e-6)
    elastic = load(tmp_path, "model.horizon='3 ms'", "contact.dynamics=elastic")
    assert evaluate(elastic, speeds, quantities)["p_max"].tolist() == end["p_max"].tolist()
    assert cheaper_fidelities(study) == ("massless", "elastic")
    assert cheaper_fidelities(elastic) == ("massless",)


def test_a_strength_above_the_hardness_is_out_of_reach(tmp_path):
    """Bars of 1 GPa have a hardness of 2.84 GPa: a strength of 4 GPa is never reached, which a break cannot be."""
    for settings, grade in (((), 1), (("limits.crushing.aim=break",), 3), (("limits.crushing.strength='2 GPa'",), 0)):
        study = load(tmp_path, *settings)
        (check,) = out_of_reach(study, scene_of(study, {}, 3))
        assert [check.share_information, check.share_warning, check.share_failure].count(1.0) == (grade > 0)
        assert {1: check.share_information, 3: check.share_failure, 0: 1.0}[grade] == 1.0
    assert out_of_reach(load(tmp_path, "contact.law=hertz"), scene_of(load(tmp_path, "contact.law=hertz"), {}, 3)) == []


def test_the_paper_is_no_comparison_for_what_yields_or_does_not_move(tmp_path):
    with pytest.raises(StudyError, match=r"model.compare_with_paper: the paper knows Hertz alone"):
        load(tmp_path, "model.compare_with_paper=true")
    still = load(tmp_path, "model.compare_with_paper=true", "contact.law='hertz'", "striker.speed='1e-12 m/s'")
    with pytest.raises(UsageError, match=r"model.compare_with_paper: leave it out; at the means .* too many steps"):
        compare_with_paper(still)


def test_the_rim_has_the_tension_of_the_force_on_its_own_circle_and_a_crushed_pole_at_most_that_of_hertz(tmp_path):
    """(1 - 2 nu) P/(2 pi a²) holds for every load that is alike around the axis; 16 % less by the true p_max."""
    names, speed = ("edge_tension", "P_max", "a_max", "p_hertz", "p_max"), {"striker.speed": np.array([0.5])}
    found = evaluate(load(tmp_path, "model.horizon='3 ms'"), speed, names)
    rim = 0.5 * found["P_max"] / (2.0 * np.pi * np.square(found["a_max"]))
    assert found["edge_tension"].to_numpy() == pytest.approx(rim.to_numpy(), rel=1e-12)
    assert (found["edge_tension"] > 1.1 * 0.5 / 3.0 * found["p_max"]).all()
    crushed = load(tmp_path, "model.horizon='3 ms'", "sphere.onset_pressure='1 GPa'", "sphere.hardness='2 GPa'")
    found = evaluate(crushed, speed, names)
    assert found["edge_tension"].to_numpy() == pytest.approx(0.5 / 3.0 * found["p_hertz"].to_numpy(), rel=1e-12)


@pytest.mark.parametrize(("onset", "aim", "strength", "verdict"), [
    ("1 GPa", "break", "100 MPa", "not established"), ("1 GPa", "break", "2 GPa", "not met"),
    ("4 GPa", "break", "100 MPa", "met"), ("1 GPa", "survive", "2 GPa", "met"),
])  # fmt: skip
def test_a_bound_establishes_no_break(tmp_path, onset, aim, strength, verdict):
    text = (
        BASE.partition("[limits.crushing]")[0]
        + f"""
[limits.rim]
criterion = "edge_tension"
strength = {{ dist = "weibull", mean = "{strength}", modulus = 12 }}
aim = "{aim}"
target = 0.01
[contact]
law = "plastic"
"""
    )
    study = load(tmp_path, "model.horizon='3 ms'", f"sphere.onset_pressure='{onset}'", "sphere.hardness='5 GPa'",
                 text=text)  # fmt: skip
    limit = run(study, out=tmp_path / "run").results.limits["rim"]
    assert limit.verdict == verdict
    assert (verdict == "not established") == ("upper bound" in str(limit.reasons))


PRESSED = """
[sphere]
E = "60 GPa"
nu = 0.25
density = "2700 kg/m3"
radius = "10 mm"
onset_pressure = "0.85 GPa"
hardness = "1.7 GPa"
[rig]
kind = "platens"
[platens]
E = "210 GPa"
nu = 0.3
density = "7850 kg/m3"
force = "8 kN"
[contact]
law = "plastic"
"""


def test_a_test_between_platens_is_what_the_rig_of_platens_says(tmp_path):
    """The poles of a sphere are crushed in its test as well: the same state by two ways, and the energy back to it."""
    scene = scene_of(load(tmp_path, text=PRESSED), {}, 1)
    names = ("p_max", "a_max", "core_tension", "energy", "energy_sphere", "plastic_work")
    known = solve_scene(scene, "full", tolerance=1e-9, threads=1, quantities=names).values
    asked = {"platen_E": 210e9, "platen_nu": 0.3}
    for carrier, own in enumerate(("P_max", "energy_sphere")):
        columns = {**columns_of(scene), "P_max": np.array([8e3]), "energy_sphere": known["energy_sphere"]}
        force, state = in_the_test(columns, {"carrier": float(carrier), **asked}, yields=True)
        assert force == pytest.approx([8e3], rel=1e-12), own
        found = at_force(force, state)
        for name in names:
            assert found[name] == pytest.approx(known[name], rel=1e-9), name
    # Hertz's poles are pressed on a smaller circle and take less
    elastic = at_force(np.array([8e3]), in_the_test(columns, {"carrier": 0.0, **asked})[1])
    assert elastic["core_tension"] > 1.2 * known["core_tension"]
    assert elastic["energy_sphere"] < 0.7 * known["energy_sphere"]
