"""Restitution of alumina spheres on an aluminium alloy: measured, and by the law of yielding
contacts with no fit.

    python -m docs.figures.restitution docs/figures/restitution.svg

prints the table of docs/measurements.md and draws the figure.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics import contact
from uqsphere.mechanics.rigs import wave_loss
from uqsphere.mechanics.yielding import FLOW, Face, metal_onset

if TYPE_CHECKING:
    from docs.figures.canvas import Picture

Array = npt.NDArray[np.float64]

#: speeds [m/s] and restitution of 5 mm alumina spheres on a thick plate: points digitised in the
#: public repository nilot-pal/Particle-breakage-models; material, speeds and values are those of
#: Kharaz and Gorham, Phil. Mag. Lett. 80 (2000) 549, of which the abstract was seen
SPEEDS: Final = np.array(
    [0.456, 0.641, 0.984, 1.385, 1.829, 2.316, 3.033, 3.463, 3.822, 3.980, 5.430, 5.846]
)
MEASURED: Final = np.array(
    [0.834, 0.799, 0.762, 0.728, 0.699, 0.681, 0.649, 0.631, 0.622, 0.616, 0.587, 0.576]
)
#: alumina: E [Pa], nu, density [kg/m³], radius [m]; alloy: E [Pa], nu, density [kg/m³], yield
#: strength [Pa]
ALUMINA: Final = (360e9, 0.22, 3890.0, 2.5e-3)
ALLOY: Final = (70e9, 0.35, 2700.0, 310e6)


def computed(
    speeds: Array, *, flow: float = FLOW, pile_up: float = 8.0 / 3.0, waves: bool = False
) -> Array:
    """Restitution at `speeds` [m/s] by (R23) of docs/theory.md.

    flow: hardness over yield strength; 0 makes hardness and onset the same, which is Thornton's law
    with pile_up = 1. waves: less the energy that an elastic blow would radiate into the plate,
    (R14), which is an upper bound.
    """
    E, nu, density, radius = ALUMINA
    plate_E, plate_nu, plate_density, strength = ALLOY
    modulus = contact.reduced_modulus(E, nu, plate_E, plate_nu)
    mass = contact.sphere_mass(radius, density)
    every = np.ones_like(speeds)
    onset = metal_onset(strength, plate_nu) * every
    face = Face(
        onset=onset,
        hardness=flow * strength * every if flow else onset,
        pile_up=pile_up * every,
        modulus=np.asarray(modulus * every),
        effective_radius=radius * every,
    )
    found = face.restitution(face.depth_of_energy(0.5 * mass * speeds**2))
    if not waves:
        return found
    shear = np.sqrt(plate_E / (2.0 * (1.0 + plate_nu) * plate_density))
    lost = wave_loss(contact.hertz_constant(modulus, radius), mass, speeds, plate_density, shear)
    return np.asarray(np.sqrt(found**2 - lost))


def restitution_figure() -> Picture:
    """Measured points and three laws over the speed."""
    from docs.figures.canvas import BLUE, GREY, ORANGE, RED, Picture, new_figure

    figure, (panel,) = new_figure(3.4)
    v = np.geomspace(0.3, 8.0, 200)
    panel.plot(v, computed(v), color=BLUE, label="perfect plasticity, H = 2.84 Y, C = 8/3")
    panel.plot(
        v,
        computed(v, waves=True),
        color=BLUE,
        linestyle=":",
        label="... less waves in the plate, at most",
    )
    panel.plot(v, computed(v, pile_up=2.0), color=ORANGE, linestyle="--", label="C = 2, no pile-up")
    panel.plot(
        v,
        computed(v, flow=0.0, pile_up=1.0),
        color=RED,
        linestyle="-.",
        label="Thornton, H at onset",
    )
    panel.plot(SPEEDS, MEASURED, color=GREY, linestyle="none", marker="o", label="measured")
    panel.set_xscale("log")
    panel.set_xticks([0.5, 1.0, 2.0, 5.0], ["0.5", "1", "2", "5"])
    panel.set_xticks([], minor=True)
    panel.set_xlabel("speed [m/s]")
    panel.set_ylabel("restitution")
    panel.set_ylim(0.0, 1.0)
    panel.legend(loc="lower left")
    return Picture(
        name="restitution",
        title="Alumina spheres of 5 mm on an aluminium alloy",
        figure=figure,
        finding=(
            "With the yield strength alone, nothing fitted, the law lies within 3 % of the "
            "measured restitution."
        ),
    )


def main() -> None:
    """Print the table and write the figure to the file named."""
    from docs.figures.canvas import render, style

    columns = (
        SPEEDS,
        MEASURED,
        computed(SPEEDS),
        computed(SPEEDS, waves=True),
        computed(SPEEDS, flow=0.0, pile_up=1.0),
    )
    print(
        "| speed m/s | measured | law | less waves, at most | Thornton, H at onset "
        "|\n|---|---|---|---|---|"
    )
    for row in zip(*columns, strict=True):
        print("| " + " | ".join(f"{value:.3f}" for value in row) + " |")
    with style():
        Path(sys.argv[1]).write_text(render(restitution_figure()), encoding="utf-8")


if __name__ == "__main__":
    main()
