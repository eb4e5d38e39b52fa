"""What the weakest link would say of the largest principal tension, beside the hoop tension that it takes.

python -m tests.campaigns.links

For the spheres of two studies: the uniform tension over p_0 that is as dangerous as the field, by the hoop tension, by
the largest principal tension over the whole volume, and by that beyond some distance from the rims of the contacts;
the share of the flaws' danger that lies within that distance; and the force of even odds that would follow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.criteria import AUERBACH
from uqsphere.mechanics.stress import Load, series_stress, surface_stress

Array = npt.NDArray[np.float64]

#: depth over the contact radius down to which the series is summed; between it and the surface it is interpolated
_SHALLOW: Final = 0.01
#: distance from the rim, over the contact radius, within which a flaw counts as one of the rim
ZONE: Final = 1.0


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Equivalent tensions over p_0, by the hoop tension and by the largest principal tension.

    hoop, principal, beyond : over the whole volume, and of the principal one beyond `ZONE` a from the rims;
    surface_hoop, surface_principal : over the surface; in_zone : share of ∫ sigma_1^m dV that lies within `ZONE` a.
    """

    hoop: float
    principal: float
    beyond: float
    surface_hoop: float
    surface_principal: float
    in_zone: float


@dataclass(frozen=True, kw_only=True)
class Sections:
    """depth (d,), angle (t,) over the quarter section, and hoop and largest principal stress over p_0, (d, t)."""

    depth: Array
    angle: Array
    hoop: Array
    principal: Array


def principal_field(contact_ratio: float, nu: float, count: int = 60) -> Sections:
    """Both stresses on a grid that is fine below the surface and around the rim of the contact."""
    a, rim = contact_ratio, math.asin(contact_ratio)
    near = np.geomspace(1e-4 * a, 1.0, count)
    outside, inside = rim + near * (0.5 * math.pi - rim), rim - np.geomspace(1e-4 * a, 1.0, count // 2) * rim
    angle = np.unique(np.concatenate([inside, [rim], outside]).clip(0.0, 0.5 * math.pi))
    depth = np.geomspace(_SHALLOW * a, 1.0, count)
    load = Load.balanced(a)
    rows = [series_stress(1.0 - d, angle, load, nu, tolerance=1e-7) for d in depth]
    top = surface_stress(angle, load, nu)
    return Sections(
        depth=np.concatenate([[0.0], depth]),
        angle=angle,
        hoop=np.stack([top.azimuthal, *(row.azimuthal for row in rows)]),
        principal=np.stack([top.tension, *(row.tension for row in rows)]),
    )


@dataclass(frozen=True, kw_only=True)
class Case:
    """A sphere of a study that is pressed until half of its kind split: p_0 [Pa], radius [m], E, E* [Pa], K_Ic."""

    name: str
    nu: float
    modulus: float
    pressure: float
    radius: float
    E: float
    reduced: float
    toughness: float


#: the spheres of two shipped studies at the strength of their contact; moduli those of their core tension; the
#: toughness is a common value for the rock, from memory
CASES: Final = (
    Case(name="granite", nu=0.25, modulus=10.0, pressure=4.0e9, radius=0.01, E=52e9, reduced=44.7e9, toughness=1.2e6),
    Case(name="limestone", nu=0.25, modulus=8.0, pressure=2.5e9, radius=0.008, E=60e9, reduced=50.1e9, toughness=1.0e6),
)
_RATIOS: Final = (0.02, 0.05, 0.1, 0.15)


def force_at(pressure: float, radius: float, reduced: float) -> float:
    """The contact force [N] of a pressure p_0 between flat ends, theory (15) turned round."""
    return (math.pi * pressure) ** 3 * radius**2 / (6.0 * reduced**2)


def even_odds(case: Case, ratios: Array, principal: Array, hoop: float) -> float:
    """p_0 [Pa] at which the principal tension is as dangerous as the hoop tension at the case's own p_0, at most.

    Below the smallest of the contact ratios it is not followed: there the pressure of that ratio is returned.

    `principal` (k,) over p_0 at contact ratios (k,), interpolated in logarithms; `hoop` over p_0 at the case's.
    """
    pressures = np.asarray(ratios) * 2.0 * case.reduced / math.pi
    danger = np.log(pressures * np.asarray(principal))
    return float(np.exp(np.interp(math.log(case.pressure * hoop), danger, np.log(pressures))))


def main() -> None:
    """Print the table of docs/theory.md, section 10."""
    for case in CASES:
        ratio = 0.5 * math.pi * case.pressure / case.reduced
        at = compare_links(principal_field(ratio, case.nu), ratio, case.modulus)
        few = [compare_links(principal_field(r, case.nu), r, case.modulus).principal for r in _RATIOS]
        pressure = even_odds(case, np.array(_RATIOS), np.array(few), at.hoop)
        ring = AUERBACH * case.toughness**2 * case.radius / case.E
        forces = [force_at(p, case.radius, case.reduced) for p in (case.pressure, pressure)]
        print(f"{case.name}: a/r {ratio:.3f}, m {case.modulus:g}")
        print(f"  volume: hoop {at.hoop:.5f}, principal {at.principal:.5f}, beyond the zone {at.beyond:.5f} p_0")
        print(f"  effective volume: principal over hoop {(at.principal / at.hoop) ** case.modulus:.2g}, "
              f"in the zone {at.in_zone:.8f}")  # fmt: skip
        print(f"  surface: hoop {at.surface_hoop:.5f}, principal {at.surface_principal:.5f} p_0")
        print(f"  force: hoop {forces[0]:.4g} N, principal at most {forces[1]:.4g} N; ring crack {ring:.4g} N")


def _refined(points: Array, parts: int = 4) -> Array:
    share = np.arange(parts) / parts
    return np.append((points[:-1, None] + share * np.diff(points)[:, None]).ravel(), points[-1])


def compare_links(field: Sections, contact_ratio: float, modulus: float) -> Comparison:
    """The integrals of both stresses, by the trapezoidal rule on a grid four times as fine."""
    from scipy.interpolate import RegularGridInterpolator

    depth, angle = _refined(field.depth), _refined(field.angle)
    at = np.stack(np.meshgrid(depth, angle, indexing="ij"), axis=-1)
    hoop, principal = (
        RegularGridInterpolator((field.depth, field.angle), np.asarray(part))(at)
        for part in (field.hoop, field.principal)
    )
    radius = 1.0 - depth
    ring = _weights(angle) * np.sin(angle)
    volume = 3.0 * np.outer(_weights(depth) * radius**2, ring)
    rim = np.array([contact_ratio, math.sqrt(1.0 - contact_ratio**2)])
    away = np.hypot(np.outer(radius, np.sin(angle)) - rim[0], np.outer(radius, np.cos(angle)) - rim[1])
    beyond = np.where(away > ZONE * contact_ratio, principal, 0.0)
    whole, far = _equivalent(principal, volume, modulus), _equivalent(beyond, volume, modulus)
    return Comparison(
        hoop=_equivalent(hoop, volume, modulus),
        principal=whole,
        beyond=far,
        surface_hoop=_equivalent(hoop[0], ring, modulus),
        surface_principal=_equivalent(principal[0], ring, modulus),
        in_zone=1.0 - (far / whole) ** modulus,
    )


def _weights(points: Array) -> Array:
    step = np.diff(points)
    return np.asarray(0.5 * (np.append(step, 0.0) + np.append(0.0, step)), dtype=float)


def _equivalent(stress: Array, weight: Array, modulus: float) -> float:
    largest = float(stress.max())
    total = float(np.sum(weight * np.maximum(stress / largest, 0.0) ** modulus))
    return float(largest * total ** (1.0 / modulus))


if __name__ == "__main__":
    main()
