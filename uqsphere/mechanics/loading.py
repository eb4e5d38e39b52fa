"""How the quantities that a sphere can break by follow its loading: with the force or with the energy so far."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

from uqsphere.mechanics.criteria import CRITERIA, Demands

__all__ = ["PATHS", "Path", "path_of"]


@dataclass(frozen=True, kw_only=True)
class Path:
    """How a quantity follows the loading.

    Attributes
    ----------
    over : str
        `force` or `energy`: the quantity rises with the largest one so far.
    criterion : str or None
        Key of `CRITERIA` whose formula it is; None for the force or energy itself.
    parameters : mapping of str to float
        Those of the criterion without `rate_0`, whose factor is one number per sample.
    early : bool
        Only what comes before the first reflected wave counts.
    """

    over: str
    criterion: str | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    early: bool = False


#: quantities of interest whose exceedance can mean fracture
PATHS: Final[dict[str, Path]] = {
    "P_max": Path(over="force"),
    "first_peak": Path(over="force", criterion="contact_pressure", early=True),
    "energy": Path(over="energy"),
    **{
        entry.quantity: Path(over="energy" if name == "specific_energy" else "force", criterion=name)
        for name, entry in CRITERIA.items()
        if entry.quantity is not None
    },
}


def path_of(quantity: str, demands: Demands = MappingProxyType({})) -> Path | None:
    """How a quantity or the demand of a criterion follows the loading; None where its exceedance is no fracture.

    >>> path_of("p_max").over, path_of("specific_energy").over, path_of("contact_time")
    ('force', 'energy', None)
    """
    if quantity not in demands:
        return PATHS.get(quantity)
    name, parameters = demands[quantity]
    kept = {key: value for key, value in parameters.items() if key != "rate_0"}
    return Path(over="energy" if name == "specific_energy" else "force", criterion=name, parameters=kept)
