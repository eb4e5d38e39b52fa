"""Required and optional keys of every table of a scene, by its kind; studies require a few more."""

import re
from collections.abc import Mapping

from uqsphere.files import packaged

from .rigs import RIGS

#: forms by table and kind, as explained in forms.toml
FORMS: dict[str, dict[str, str]] = packaged("mechanics/forms.toml")
FORMS["anvil"] = FORMS["target"]
FORMS["rig"] = {name: "speed|drop_height; angle" for name, rig in RIGS.items() if rig.sphere_moves}


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
