"""The stress inside the sphere once more by finite elements, which share nothing with the series
but the load.

A quarter of the section through the axis, between axis and equator, is meshed by quadratic elements
in distance from the centre and angle from the axis: rings of nine-node quadrilaterals, finer
towards the surface and towards the rim of the contact, and six-node triangles around the centre.
Lengths are over the sphere's radius, stresses over p_0.

python -m tests.independent.elements docs/figures/stress-elements.svg
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    pass

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

#: the case of the picture and of docs/validation.md
CONTACT_RATIO: Final = 0.2
NU: Final = 0.25
#: what is left out of the comparison: this far from the rim, over the contact radius, and from the
#: centre, over r
RIM_ZONE: Final = 0.1
CENTRE_ZONE: Final = 0.01
#: meshes that `main` compares: rings, and the finest step over the contact radius
MESHES: Final = ((16, 0.05), (24, 0.04), (40, 0.02), (56, 0.015))
#: natural coordinates of the nine nodes, row by row
_NINE: Final = tuple((x, y) for y in (-1.0, 0.0, 1.0) for x in (-1.0, 0.0, 1.0))


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """nodes (n, 2) across and along the axis; quads (k, 9) and triangles (j, 6) of node numbers.

    `surface` (s, 3): nodes of the element edges on the surface, in the order of the angle.
    """

    nodes: Array
    quads: Index
    triangles: Index
    surface: Index


@dataclass(frozen=True, kw_only=True)
class Field:
    """Stress at points of the elements, over p_0: place (m, 2), and (sigma_rho, sigma_z, sigma_phi,
    tau) (m, 4).
    """

    place: Array
    stress: Array

    @property
    def tension(self) -> Array:
        """The largest principal stress, (m,)."""
        across, along, around, shear = self.stress.T
        return np.asarray(
            np.maximum(0.5 * (across + along) + np.hypot(0.5 * (across - along), shear), around),
            dtype=float,
        )


def _edges(count: int, first: float, length: float) -> Array:
    """0 … length in `count` steps that grow by one factor from about `first` on."""
    if count * first >= length:
        return np.linspace(0.0, length, count + 1)
    low, high = 1.0 + 1e-9, 10.0
    for _ in range(80):
        growth = 0.5 * (low + high)
        total = first * (growth**count - 1.0) / (growth - 1.0)
        low, high = (low, growth) if total > length else (growth, high)
    steps = growth ** np.arange(count)
    return np.concatenate([[0.0], np.cumsum(steps) * length / steps.sum()])


def make_mesh(contact_ratio: float, count: int = 40, finest: float = 2e-3) -> Mesh:
    """`count` rings and as many sectors outside the contact, as many inside, from steps of `finest`
    a on.

    >>> make_mesh(0.2, 8, 0.05).quads.shape
    (112, 9)
    """
    rim, first = math.asin(contact_ratio), finest * contact_ratio
    inner = _edges(count, first, rim)
    outer = _edges(count, first, 0.5 * math.pi - rim)
    angle = _halved(np.concatenate([(rim - inner)[::-1], rim + outer[1:]]))
    depth = _edges(count, first, 1.0)
    radius = _halved(1.0 - depth[::-1])[2:]
    rows, columns = len(radius), len(angle)
    # the ring nearest to the centre is one of triangles: its inner nodes are half-way, and one in
    # the centre
    radius = np.concatenate([[0.5 * radius[0]], radius])
    rows += 1
    grid = np.arange(rows * columns).reshape(rows, columns)
    nodes = np.stack(
        [np.outer(radius, np.sin(angle)).ravel(), np.outer(radius, np.cos(angle)).ravel()], axis=1
    )
    centre = len(nodes)
    nodes = np.vstack([nodes, [[0.0, 0.0]]])
    quads = [
        grid[i : i + 3, j : j + 3].ravel()
        for i in range(1, rows - 2, 2)
        for j in range(0, columns - 2, 2)
    ]
    triangles = [
        (centre, grid[1, j + 2], grid[1, j], grid[0, j + 2], grid[1, j + 1], grid[0, j])
        for j in range(0, columns - 2, 2)
    ]
    surface = [grid[-1, j : j + 3] for j in range(0, columns - 2, 2)]
    nodes[np.abs(nodes) < 1e-15] = 0.0
    return Mesh(
        nodes=nodes, quads=np.array(quads), triangles=np.array(triangles), surface=np.array(surface)
    )


def _halved(edges: Array) -> Array:
    """Edges with the middle between each two."""
    return np.sort(np.concatenate([edges, 0.5 * (edges[1:] + edges[:-1])]))


def _nine(x: Array, y: Array) -> tuple[Array, Array]:
    """Shape functions (points, 9) and their derivatives (points, 2, 9) of the quadrilateral."""

    def line(t: Array) -> tuple[Array, Array]:
        value = np.stack([0.5 * t * (t - 1.0), 1.0 - t * t, 0.5 * t * (t + 1.0)], axis=1)
        return value, np.stack([t - 0.5, -2.0 * t, t + 0.5], axis=1)

    (fx, dx), (fy, dy) = line(x), line(y)
    pairs = [(int(u) + 1, int(v) + 1) for u, v in _NINE]
    value = np.stack([fx[:, i] * fy[:, j] for i, j in pairs], axis=1)
    slope = np.stack(
        [
            np.stack([part[:, i] * other[:, j] for i, j in pairs], axis=1)
            for part, other in ((dx, fy), (fx, dy))
        ],
        axis=1,
    )
    return value, slope


def _six(x: Array, y: Array) -> tuple[Array, Array]:
    """The same of the triangle (0, 0), (1, 0), (0, 1), then the middles of its sides: (points, 6),
    (points, 2, 6).
    """
    w = 1.0 - x - y
    value = np.stack(
        [w * (2 * w - 1), x * (2 * x - 1), y * (2 * y - 1), 4 * w * x, 4 * x * y, 4 * w * y], axis=1
    )
    none = np.zeros_like(x)
    to_x = np.stack([1 - 4 * w, 4 * x - 1, none, 4 * (w - x), 4 * y, -4 * y], axis=1)
    to_y = np.stack([1 - 4 * w, none, 4 * y - 1, -4 * x, 4 * x, 4 * (w - y)], axis=1)
    return value, np.stack([to_x, to_y], axis=1)


def _square(nodes: int) -> tuple[Array, Array, Array]:
    points, weights = np.polynomial.legendre.leggauss(nodes)
    x, y = (part.ravel() for part in np.meshgrid(points, points))
    return x, y, np.outer(weights, weights).ravel()


def _triangle() -> tuple[Array, Array, Array]:
    """Points and weights exact to degree 4 (Dunavant, Int. J. Numer. Methods Eng. 21, 1985,
    1129).
    """
    a, b = 0.445948490915965, 0.091576213509771
    x = np.array([a, 1 - 2 * a, a, b, 1 - 2 * b, b])
    y = np.array([a, a, 1 - 2 * a, b, b, 1 - 2 * b])
    return x, y, 0.5 * np.repeat([0.223381589678011, 0.109951743655322], 3)


def _strains(
    nodes: Array, elements: Index, shape: tuple[Array, Array]
) -> tuple[Array, Array, Array]:
    """Strain from displacements (k, points, 4, 2 per node), places (k, points, 2) and areas per
    unit (k, points).
    """
    value, slope = shape
    corners = nodes[elements]
    place = np.einsum("pa,kad->kpd", value, corners)
    jacobian = np.einsum("pia,kad->kpid", slope, corners)
    change = np.linalg.solve(jacobian, np.broadcast_to(slope, (len(elements), *slope.shape)))
    strain = np.zeros((*place.shape[:2], 4, 2 * elements.shape[1]))
    strain[..., 0, 0::2] = change[:, :, 0]
    strain[..., 1, 1::2] = change[:, :, 1]
    strain[..., 2, 0::2] = value / place[..., :1]
    strain[..., 3, 0::2], strain[..., 3, 1::2] = change[:, :, 1], change[:, :, 0]
    return strain, place, np.abs(np.linalg.det(jacobian))


def _stiffness(nu: float) -> Array:
    """Stress from strain for E = 1, (4, 4): sigma_rho, sigma_z, sigma_phi, tau."""
    lame, shear = nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), 0.5 / (1.0 + nu)
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = lame + 2.0 * shear * np.eye(3)
    matrix[3, 3] = shear
    return matrix


def _load(
    mesh: Mesh, contact_ratio: float, pressure: Callable[[Array], Array] | None = None
) -> Array:
    """Forces on the nodes under sqrt(1 - (sin t/a)²), or a pressure over sin t, (2 n,); per radian
    around the axis.
    """
    points, weights = np.polynomial.legendre.leggauss(16)
    value = np.stack(
        [0.5 * points * (points - 1.0), 1.0 - points**2, 0.5 * points * (points + 1.0)], axis=1
    )
    slope = np.stack([points - 0.5, -2.0 * points, points + 0.5], axis=1)
    corners = mesh.nodes[mesh.surface]
    place, along = (
        np.einsum("pa,kad->kpd", value, corners),
        np.einsum("pa,kad->kpd", slope, corners),
    )
    sine = place[..., 0] / np.hypot(place[..., 0], place[..., 1])
    hertz = np.sqrt(np.maximum(1.0 - (sine / contact_ratio) ** 2, 0.0))
    size = hertz if pressure is None else pressure(sine)
    # the inward normal times the element of length
    inward = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    forces = np.einsum("kp,kpd,pa->kad", size * place[..., 0] * weights, inward, value)
    total = np.zeros_like(mesh.nodes)
    np.add.at(total, mesh.surface, forces)
    return total.ravel()


def solve_elements(
    contact_ratio: float, nu: float, mesh: Mesh, *, pressure: Callable[[Array], Array] | None = None
) -> Field:
    """Stress at the 2 x 2 points of every quadrilateral, where that of quadratic elements is most
    accurate.

    `pressure` over the sine of the angle takes the place of Hertz's.

    Raises
    ------
    ValueError
        For a Poisson ratio at which the displacements alone do not give the stress, or a/r outside
        (0, 1).
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import spsolve

    if not (-1.0 < nu < 0.5 and 0.0 < contact_ratio < 1.0):
        raise ValueError(
            f"found nu = {nu} and a/r = {contact_ratio}: they must lie in (-1, 0.5) and (0, 1)"
        )
    law, size = _stiffness(nu), 2 * len(mesh.nodes)
    parts: list[tuple[Array, Index, Index]] = []
    x, y, w = _square(4)
    tx, ty, tw = _triangle()
    for elements, shape, weight in (
        (mesh.quads, _nine(x, y), w),
        (mesh.triangles, _six(tx, ty), tw),
    ):
        strain, place, area = _strains(mesh.nodes, elements, shape)
        local = np.einsum(
            "kp,kpsi,st,kptj->kij",
            area * place[..., 0] * weight,
            strain,
            law,
            strain,
            optimize=True,
        )
        dof = np.stack([2 * elements, 2 * elements + 1], axis=2).reshape(len(elements), -1)
        rows, columns = (
            np.broadcast_to(part, local.shape).ravel()
            for part in (dof[:, :, None], dof[:, None, :])
        )
        parts.append((local.ravel(), rows, columns))
    values, rows, columns = (np.concatenate([part[k] for part in parts]) for k in range(3))
    matrix = coo_matrix((values, (rows, columns)), shape=(size, size)).tocsc()
    free = np.zeros((len(mesh.nodes), 2), dtype=bool)
    # a node that no element has carries nothing
    free[np.unique(np.concatenate([mesh.quads.ravel(), mesh.triangles.ravel()]))] = True
    # nothing moves across the axis, nothing moves along it on the equator
    free[mesh.nodes[:, 0] < 1e-14, 0] = False
    free[mesh.nodes[:, 1] < 1e-14, 1] = False
    kept = np.flatnonzero(free.ravel())
    displacement = np.zeros(size)
    displacement[kept] = spsolve(matrix[kept][:, kept], _load(mesh, contact_ratio, pressure)[kept])
    x, y, _ = _square(2)
    strain, place, _ = _strains(mesh.nodes, mesh.quads, _nine(x, y))
    dof = np.stack([2 * mesh.quads, 2 * mesh.quads + 1], axis=2).reshape(len(mesh.quads), -1)
    stress = np.einsum("st,kpti,ki->kps", law, strain, displacement[dof], optimize=True)
    return Field(place=place.reshape(-1, 2), stress=stress.reshape(-1, 4))


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Series and elements at the same points.

    place (m, 2); series and elements (m,) the largest principal stress over p_0; difference (m,) of
    the two over the larger of its size there and the core tension; core : that tension over p_0.
    """

    place: Array
    series: Array
    elements: Array
    difference: Array
    core: float

    @property
    def worst(self) -> float:
        """The largest difference."""
        return float(np.abs(self.difference).max())

    @property
    def median(self) -> float:
        """The median of its size."""
        return float(np.median(np.abs(self.difference)))


def compare(
    contact_ratio: float = CONTACT_RATIO, nu: float = NU, count: int = 40, finest: float = 2e-3
) -> Comparison:
    """Both fields at the points of the elements, outside the zones at the rim and at the centre."""
    from tests.campaigns.stress_series import Load, series_stress
    from uqsphere.mechanics.stress import core_ratio

    found = solve_elements(contact_ratio, nu, make_mesh(contact_ratio, count, finest))
    rim = np.array([contact_ratio, math.sqrt(1.0 - contact_ratio**2)])
    radius = np.hypot(*found.place.T)
    away = np.hypot(*(found.place - rim).T) > RIM_ZONE * contact_ratio
    kept = away & (radius > CENTRE_ZONE)
    place, tension, radius = found.place[kept], found.tension[kept], radius[kept]
    angle = np.arctan2(place[:, 0], place[:, 1])
    series = np.empty(len(place))
    load = Load.balanced(contact_ratio)
    # near the surface the series is long: points of like depth are summed together
    order = np.argsort(1.0 - radius)
    for some in np.array_split(order, 24):
        series[some] = series_stress(
            np.minimum(radius[some], 1.0), angle[some], load, nu, tolerance=1e-9
        ).tension
    core = float(core_ratio(contact_ratio, nu))
    scale = np.maximum(np.abs(series), core)
    return Comparison(
        place=place,
        series=series,
        elements=tension,
        difference=(tension - series) / scale,
        core=core,
    )


def main() -> None:
    """Print the differences at every mesh."""
    for count, first in MESHES:
        found = compare(count=count, finest=first)
        print(
            f"{count} rings, {len(found.place):,} points: worst {found.worst:.2g}, median "
            f"{found.median:.2g}"
        )


if __name__ == "__main__":
    main()
