"""Computes `tables.json` anew from the series: ``python -m uqsphere.mechanics.stress.make_tables`` (minutes)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.stress.axis import equatorial_hoop, largest_hoop, largest_shear, load_on_axis
from uqsphere.mechanics.stress.rim import rim_integrals
from uqsphere.mechanics.stress.tables import chebyshev_fit, chebyshev_nodes
from uqsphere.mechanics.stress.weakest_link import hoop_field, surface_integrals, volume_integrals

Array = npt.NDArray[np.float64]

__all__ = ["SHAPES", "exact", "make", "pack"]

#: number of polynomials in a/r, nu and m, and what one unit of the written whole numbers is worth
SHAPES: Final[dict[str, tuple[int, ...]]] = {
    "core": (28, 64), "core_depth": (28, 64), "shear": (26, 8), "shear_depth": (26, 8), "equator": (22, 12),
    "volume": (38, 20, 34), "surface": (38, 20, 34), "rim": (24, 16, 20),
}  # fmt: skip
_UNITS: Final = {2: 1e-10, 3: 2e-9}


def exact(name: str, contact_ratio: float, nu: float, load: Array | None = None) -> float:
    """The value that a table in a/r and nu holds, from the series; `load` of `load_on_axis`, if at hand."""
    load = load_on_axis(contact_ratio) if load is None else load
    if name == "equator":
        return equatorial_hoop(load, nu) / contact_ratio**2
    value, place = (largest_hoop if name.startswith("core") else largest_shear)(load, contact_ratio, nu)
    return (1.0 - place) / contact_ratio if name.endswith("depth") else value


def _two_way(name: str) -> Array:
    ratios, poisson = chebyshev_nodes(SHAPES[name])
    loads = [load_on_axis(float(ratio)) for ratio in ratios]
    return np.array(
        [
            [exact(name, float(ratio), float(nu), load) for nu in poisson]
            for ratio, load in zip(ratios, loads, strict=True)
        ]
    )


def _three_way() -> dict[str, Array]:
    shape = SHAPES["volume"]
    ratios, poisson, moduli = chebyshev_nodes(shape)
    values = {name: np.empty(shape) for name in ("volume", "surface")}
    for i, ratio in enumerate(ratios):
        field = hoop_field(float(ratio), nodes=18, growth=1.45)
        for j, nu in enumerate(poisson):
            values["volume"][i, j] = volume_integrals(field, float(nu), moduli)
            values["surface"][i, j] = surface_integrals(field, float(nu), moduli)
    return values | {"rim": _rim()}


def _rim() -> Array:
    ratios, poisson, moduli = chebyshev_nodes(SHAPES["rim"])
    return np.array([[rim_integrals(float(ratio), float(nu), moduli) for nu in poisson] for ratio in ratios])


def pack(values: Array) -> dict[str, Any]:
    """A table as JSON holds it: whole numbers of one unit, rows without the zeros at their end."""
    unit = _UNITS[values.ndim]
    whole = np.rint(chebyshev_fit(values) / unit).astype(np.int64)
    rows = [np.trim_zeros(row, "b").tolist() for row in whole.reshape(-1, values.shape[-1])]
    return {"shape": list(values.shape), "unit": unit, "rows": rows}


def make(path: Path) -> None:
    """Compute every table and write them to `path`, one row of coefficients per line."""
    values = {name: _two_way(name) for name, shape in SHAPES.items() if len(shape) == 2} | _three_way()
    entries = []
    for name in SHAPES:
        packed = pack(values[name])
        rows = ",\n".join(json.dumps(row, separators=(",", ":")) for row in packed.pop("rows"))
        head = ", ".join(f"{json.dumps(key)}: {json.dumps(value)}" for key, value in packed.items())
        entries.append(f'{json.dumps(name)}: {{{head}, "rows": [\n{rows}]}}')
    path.write_text("{" + ",\n".join(entries) + "}\n", encoding="utf-8")


if __name__ == "__main__":
    make(Path(__file__).parent / "tables.json")
