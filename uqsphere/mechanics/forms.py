"""Required and optional keys of every table of a scene, by its kind; studies require a few more."""

import re
from collections.abc import Mapping

from .rigs import RIGS

_STRUCK = {
    "thick": "E nu; density",
    "plate": "E nu density thickness; width",
    "bar": "E nu density diameter; length end",
    "mass": "E nu mass; density",
}
#: by table and kind: required keys, alternatives separated by a bar; after the semicolon, optional
#: keys that not every kind of the table has
FORMS = {
    "sphere": {"": "E nu density radius"},
    "insert": {"": "E"},
    "bars": {
        "": "E nu density diameter incident_length receiving_length",
        "infinite": "E nu density diameter; incident_length receiving_length",
    },
    "striker": {
        "": "speed length; E density diameter",
        "pulse.duration": "speed; length E density diameter",
        "measured": "",
    },
    "pulse": {
        "rectangular": "; duration",
        "half_sine": "; duration",
        "step": "",
        "trapezoid": "rise fall; duration",
        "ramp": "rise; duration",
        "two_peak": "t1 level1 t2 level2; duration valley",
        "measured": "; gain",
    },
    "rig": {name: "speed|drop_height; angle" for name, rig in RIGS.items() if rig.sphere_moves},
    "target": _STRUCK,
    "anvil": _STRUCK,
    "other": {"": "E nu density radius"},
    "hammer": {
        "": "E nu mass speed|drop_height; density face_radius",
        "ball": "E nu density diameter speed|drop_height",
    },
    "rod": {"": "E nu density diameter; length"},
    "platens": {"": "E nu force|displacement"},
    "contact": {"hertz": "", "plastic": "; onset_pressure hardness pile_up"},
}


def kinds_of(
    rig: str, shape: str, *, timed: bool, infinite: bool, options: Mapping[str, object]
) -> dict[str, str]:
    """The kind of every table that has several.

    timed : whether the pulse duration is given, and does not follow from the striker's length.
    options : words of a study, see `Scene`.
    """
    striker = ""
    if shape == "measured":
        striker = "measured"
    elif timed or shape == "step":
        striker = "pulse.duration"
    return {
        **{table: str(options.get(f"{table}.kind", "thick")) for table in ("target", "anvil")},
        "hammer": str(options.get("hammer.shape", "")),
        "contact": str(options.get("contact.law", "hertz")),
        "bars": "infinite" if infinite else "",
        "pulse": shape,
        "rig": rig,
        "striker": striker,
    }


def keys_of(text: str) -> list[str]:
    """Every key of a form.

    >>> keys_of("E nu force|displacement; speed")
    ['E', 'nu', 'force', 'displacement', 'speed']
    """
    return re.findall(r"\w+", text)


def needs_of(text: str) -> list[list[str]]:
    """Required keys of a form, each with its alternatives.

    >>> needs_of("E nu force|displacement; speed")
    [['E'], ['nu'], ['force', 'displacement']]
    """
    return [need.split("|") for need in text.partition(";")[0].split()]
