"""The material library: complete, plausible, sourced; and its loader refuses what is not."""

from __future__ import annotations

import pytest

from uqsphere.materials import KINDS, LibraryError, library, load_library, material_names
from uqsphere.quantities import INPUTS

GOOD = """\
[sphere.rock]
title = "Rock"
E = { value = "50 GPa", cov = 0.1, source = "X, 1990", seen = true, note = "dry" }
nu = { value = 0.25, cov = 0.1, source = "X, 1990", seen = false }
density = { value = "2.65 g/cm3", cov = 0.01, source = "X, 1990", seen = false }
fracture_toughness = { value = 1.5, unit_note = "MPa m^0.5", cov = 0.1, source = "X, 1990", seen = false }
"""


def test_materials_that_studies_rely_on() -> None:
    assert set(material_names("sphere")) >= {
        "granite", "limestone", "marble", "sandstone", "basalt", "quartzite", "magnetite_ore",
        "soda_lime_glass", "alumina",
    }  # fmt: skip
    assert set(material_names("bars")) >= {"steel", "maraging_steel", "aluminium", "titanium", "pmma"}


def test_every_value_is_plausible_and_sourced() -> None:
    for kind in KINDS:
        for name, material in library()[kind].items():
            assert material.name == name
            assert material.title
            for key, value in material.properties.items():
                assert 0.0 < value.cov < (0.7 if key == "fracture_energy" else 0.5), (name, key)
                assert len(value.source) > 10, (name, key)
                if (quantity := INPUTS.get(f"{kind}.{key}")) is not None:
                    low, high = quantity.plausible
                    assert low <= value.value <= high, (name, key)


def test_strengths_are_in_order() -> None:
    for material in library()["sphere"].values():
        values = {key: item.value for key, item in material.properties.items()}
        if {"tensile_strength", "compressive_strength"} <= set(values):
            assert values["tensile_strength"] < values["compressive_strength"] < values["E"]


def test_strengths_that_may_be_assumed_have_a_range() -> None:
    for material in library()["sphere"].values():
        found = material.properties
        assumed = {"contact_strength", "fracture_toughness", "fracture_energy"} & found.keys()
        assumed |= {"tensile_strength"} if "volume" in getattr(found.get("tensile_strength"), "further", {}) else set()
        for key in assumed if material.rock else ():
            low, high = found[key].range or (0.0, 0.0)
            assert 0.2 * found[key].value < low < found[key].value < high < 4.0 * found[key].value, (material.name, key)


def test_values_are_si() -> None:
    rock = load_library(GOOD)["sphere"]["rock"]
    assert rock.properties["E"].value == 50e9
    assert rock.properties["density"].value == pytest.approx(2650.0, rel=1e-15)
    assert rock.properties["fracture_toughness"].value == 1.5e6
    assert rock.properties["E"].seen
    assert not rock.properties["nu"].seen
    assert rock.properties["E"].note == "dry"


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('"50 GPa"', "50", "no unit"),
        ('"50 GPa"', '"50 mm"', "unknown unit"),
        ('"50 GPa"', '"-50 GPa"', "not possible"),
        ("value = 0.25", "value = 0.5", "not possible"),
        ("value = 0.25", "value = nan", "not a finite number"),
        ("cov = 0.01", "cov = -0.01", "cov"),
        ("cov = 0.01", "cov = true", "cov"),
        ("cov = 0.01", 'cov = "1 %"', "cov"),
        ("seen = true", 'seen = "yes"', "seen"),
        ('"X, 1990", seen = true', '"", seen = true', "source"),
        ('title = "Rock"', "", "title"),
        ('note = "dry"', 'notes = "dry"', "unknown key"),
        ("value = 1.5,", "value = 1.5, low = 1.6, high = 2.0,", "ends of a range"),
        ("value = 1.5,", "value = 1.5, high = 2.0,", "ends of a range"),
        ('title = "Rock"', 'title = "Rock"\nrock = 1', "true or false"),
        ('title = "Rock"', 'title = "Rock"\nfracture_energy = { value = "9 J/kg", size = "2", exponent = 1.0, '
         'cov = 0.5, source = "X", seen = false }', "fracture_energy.size"),
        ("nu = {", "poisson = {", "unknown property"),
        ("[sphere.rock]", "[spheres.rock]", "unknown kind"),
        ('unit_note = "MPa m^0.5"', 'unit_note = "MPa"', "unit_note"),
        ("nu = { value = 0.25, cov = 0.1, source = \"X, 1990\", seen = false }", "nu = 0.25", "a table"),
        ("[sphere.rock]", "[sphere.rock", "not valid TOML"),
    ],
)  # fmt: skip
def test_loader_refuses(old: str, new: str, says: str) -> None:
    assert GOOD.count(old) == 1
    with pytest.raises(LibraryError, match=says):
        load_library(GOOD.replace(old, new))


def test_all_faults_at_once() -> None:
    with pytest.raises(LibraryError) as caught:
        load_library(GOOD.replace('"50 GPa"', "50").replace("seen = true", "seen = 1").replace("0.25", "0.7"))
    assert len(str(caught.value).splitlines()) == 3
