"""The material library: complete, plausible, sourced; and its loader refuses what is not."""

from __future__ import annotations

from uqsphere.files import packaged
from uqsphere.materials import FURTHER, library, materials_of
from uqsphere.quantities import INPUTS


def test_every_value_is_plausible_and_sourced() -> None:
    for kind in ("sphere", "bars", "plates"):
        for name, material in materials_of(kind).items():
            assert material.title
            needed = ("E", "nu", "density", *(("yield_strength",) if kind == "bars" else ()))
            assert set(needed) <= set(material.properties), name
            for key, value in material.properties.items():
                assert 0.0 < value.cov < (0.7 if key == "fracture_energy" else 0.5), (name, key)
                assert len(value.source) > 10, (name, key)
                assert value.value > 0.0
                assert isinstance(value.seen, bool)
                assert key == "tensile_strength" or set(value.further) == set(
                    FURTHER.get(key, ())
                ), (name, key)
                if (quantity := INPUTS.get(f"{kind}.{key}")) is not None:
                    low, high = quantity.plausible
                    assert low <= value.value <= high, (name, key)


def test_every_material_has_a_name_of_its_own() -> None:
    tables = packaged("materials.toml")
    assert [*library()] == [name for materials in tables.values() for name in materials]
    assert {material.kind for material in library().values()} == {*tables}


def test_strengths_are_in_order() -> None:
    for material in materials_of("sphere").values():
        values = {key: item.value for key, item in material.properties.items()}
        if {"tensile_strength", "compressive_strength"} <= set(values):
            assert values["tensile_strength"] < values["compressive_strength"] < values["E"]


def test_strengths_that_may_be_assumed_have_a_range() -> None:
    for name, material in materials_of("sphere").items():
        found = material.properties
        assumed = {"contact_strength", "fracture_toughness", "fracture_energy"} & found.keys()
        assumed |= (
            {"tensile_strength"}
            if "volume" in getattr(found.get("tensile_strength"), "further", {})
            else set()
        )
        for key in assumed if material.rock else ():
            low, high = found[key].range or (0.0, 0.0)
            assert (
                0.2 * found[key].value < low < found[key].value < high < 4.0 * found[key].value
            ), (name, key)
