"""Units as people write them: what is meant is offered, and never another power of ten."""

from __future__ import annotations

import pytest

from uqsphere.units import UNITS, UnitError, nearest_unit, parse_value

MEANT = [
    ("KN", "force", "kN"),
    ("Kn", "force", "kN"),
    ("lbs", "force", "lbf"),
    ("lb", "force", "lbf"),
    ("kg", "force", "kgf"),
    ("newton", "force", "N"),
    ("lbs", "mass", "lb"),
    ("KG", "mass", "kg"),
    ("gpa", "pressure", "GPa"),
    ("Mpa", "pressure", "MPa"),
    ("MPA", "pressure", "MPa"),
    ("N/mm^2", "pressure", "N/mm2"),
    ("N/mm²", "pressure", "N/mm2"),
    ("kN/mm²", "pressure", "GPa"),
    ("N/m2", "pressure", "Pa"),
    ("MM", "length", "mm"),
    ("inch", "length", "in"),
    ("UM", "length", "um"),
    ("Kg/m3", "density", "kg/m3"),
    ("g/cc", "density", "g/cm3"),
    ("M/s", "speed", "m/s"),
    ("m/sec", "speed", "m/s"),
    ("KJ", "energy", "kJ"),
    ("J/KG", "specific_energy", "J/kg"),
    ("sec", "time", "s"),
    ("US", "time", "us"),
    ("degrees", "angle", "deg"),
]
#: units that are not known, and whose look-alike is another power of ten
UNKNOWN = [
    ("kips", "force"),
    ("GN", "force"),
    ("mn", "force"),
    ("Mn", "force"),
    ("MJ", "energy"),
    ("MJ/kg", "specific_energy"),
    ("Mg", "mass"),
    ("Mm", "length"),
    ("mPa", "pressure"),
    ("MV", "voltage"),
    ("Ms", "time"),
    ("ksi", "pressure"),
    ("dm", "length"),
    ("", "force"),
]


@pytest.mark.parametrize(("text", "dimension", "unit"), MEANT)
def test_another_spelling_is_offered_its_unit(text: str, dimension: str, unit: str) -> None:
    assert nearest_unit(text, dimension) == unit
    with pytest.raises(UnitError, match="did you mean") as caught:
        parse_value(f"3 {text}", dimension)
    assert f'did you mean "3 {unit}"?' in str(caught.value)
    # the way out is taken
    assert parse_value(f"3 {unit}", dimension) == pytest.approx(3.0 * UNITS[dimension][unit])


@pytest.mark.parametrize(("text", "dimension"), UNKNOWN)
def test_another_power_of_ten_is_never_offered(text: str, dimension: str) -> None:
    assert nearest_unit(text, dimension) == ""
    with pytest.raises(UnitError) as caught:
        parse_value(f"3 {text}", dimension)
    assert "did you mean" not in str(caught.value)
    # a spelling has another cause
    assert nearest_unit(next(iter(UNITS[dimension])), dimension)


def test_no_slip_of_letters_changes_the_power_of_ten() -> None:
    """Small, capital and swapped letters of every unit: the same unit, a known one, or none."""
    for dimension, units in UNITS.items():
        for unit in filter(None, units):
            for text in (unit.lower(), unit.upper(), unit.swapcase(), unit.capitalize()):
                near = nearest_unit(text, dimension)
                assert near in ("", unit, text) or units[near] == units[unit], (text, near)


@pytest.mark.parametrize(
    ("text", "meant"),
    [("1.234,5", "1234.5"), ("1,234.5", "1234.5"), ("-1.234.567,8901", "-1234567.8901")],
)
def test_a_number_with_marks_of_thousands_is_offered_without(text: str, meant: str) -> None:
    with pytest.raises(UnitError, match=f'thousands separator. Write "{meant} mm"'):
        parse_value(f"{text} mm", "length")
