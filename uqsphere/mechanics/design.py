"""What a test must keep to if a sphere is to break in it as wanted, and how much of each bound it uses up.

The sphere shall break before a reflected wave is back and before the pulse begins to fall, with the forces at its two
faces in balance and with elastic bars.  Up to the first of these two times the loading knows neither the striker's
length nor that of the bars.  One motion under a ramp that rises and then stays, in bars that send nothing back, hence
serves every length: it gives the time of fracture, and the lengths only say whether that is soon enough.

Every bound is a usage: what is found over what is allowed, above 1 broken.  The largest of them binds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags, Places
from uqsphere.mechanics import bars, contact
from uqsphere.mechanics.criteria import Demands
from uqsphere.mechanics.fracture import first_fractures
from uqsphere.mechanics.integrator import solve as dynamics
from uqsphere.mechanics.outputs import Path
from uqsphere.mechanics.pulses import striker_steps
from uqsphere.mechanics.rigs import softest_partner
from uqsphere.mechanics.scene import Scene, answered

#: bounds of a test in the order in which ties are decided, and what it means that one is broken
CONSTRAINTS: Final[dict[str, str]] = {
    "speed": "the force stays too small, or a contact that yields has a hardness below the strength, however long "
    "striker and bars are",
    "reflection": "a reflected wave is back before the sphere breaks",
    "length": "the pulse falls before the sphere breaks, or the striker is too short for the ramp",
    "equilibrium": "the forces at the two faces differ too much when the sphere breaks",
    "pulse_yield": "the pulse makes the bars yield",
    "contact_yield": "the bars yield under the sphere before it breaks",
    "striker": "the pulse is longer than the round trip of the incident bar: the striker is still on it",
}
#: t_c after the end of the ramp for which the force is followed: 1 - P/P_0 is then about e^(-18), theory (14)
_LASTING: Final = 12.0


@dataclass(frozen=True, kw_only=True)
class Breaks:
    """Fracture of n scenes at m strengths under a ramp that never ends; every array (n, m), NaN where none comes.

    share: strength over the largest demand, of the limit that is nearest to being reached; NaN where the scene could
    not be computed.  limit: the one that is reached first, -1 for none.  At fracture: time [s], the larger contact
    force [N], imbalance, the difference of the forces over the largest so far.
    """

    share: Array
    limit: Places
    time: Array
    force: Array
    imbalance: Array


@dataclass(frozen=True, kw_only=True)
class Rig:
    """What a test is held against.

    length: of the striker [m]; fall: time in which the pulse falls [s]; level: largest difference of the two forces at
    fracture, over the largest so far; first_return: of a reflected wave at the sphere [s], may be infinite; round_trip:
    of the incident bar [s], within which the striker has to leave it, infinite if its end sends nothing back; dents:
    whether the bars may yield under the sphere.
    """

    length: float
    fall: float = 0.0
    level: float = 0.1
    first_return: float = np.inf
    round_trip: float = np.inf
    dents: bool = False

    def __post_init__(self) -> None:
        for name, value in (("length", self.length), ("level", self.level)):
            if not 0.0 < value < np.inf:
                raise ValueError(f"{name} must be positive and finite, found {value!r}")
        if not 0.0 <= self.fall < np.inf:
            raise ValueError(f"fall must not be negative, found {self.fall!r} s")


def first_return(scene: Scene) -> tuple[float, float]:
    """First return of a reflected wave at the sphere and the incident bar's share in it, of row 0 [s].

    An end that is known to absorb sends nothing back.  Bars taken as infinite send nothing back in the model, in the
    laboratory they do: their lengths, where they are given, count here.
    """
    ends = [float(scene.column(f"bars.{bar}_end", 1.0)[0]) for bar in ("incident", "receiving")]
    trips = [float(trip) if end != 0.0 else np.inf for trip, end in zip(scene.round_trips[0], ends, strict=True)]
    return min(trips), trips[0]


def ramp_scene(
    columns: Mapping[str, Array],
    rise: Array,
    *,
    rigid_contact: bool = False,
    demands: Demands = MappingProxyType({}),
    law: str = "hertz",
) -> Scene:
    """n scenes under a pulse that rises linearly over `rise` (n,) [s] and stays, in bars without reflections.

    columns: numbers of the scenes, SI; those of the pulse and the striker's length are left aside.  The others: see
    `Scene`.  What yields is read off the largest force: motions that yield until the ramp's end take minutes a map.
    ValueError if a scene has no meaning.
    """
    kept = {name: column for name, column in columns.items() if not name.startswith("pulse.")}
    kept.pop("striker.length", None)
    unending = {**kept, "pulse.rise": rise, "pulse.duration": np.ones_like(rise)}
    scales = Scene(columns=unending, shape="ramp", infinite=True, horizon=1.0).scales
    if not np.isfinite(scales.time).all():
        raise ValueError("a scene of the plan has no meaning: sizes, moduli, densities and speeds must be positive")
    horizon = float(np.max(rise + _LASTING * scales.time))
    unending["pulse.duration"] = np.full_like(rise, 4.0 * horizon)
    return Scene(columns=unending, shape="ramp", infinite=True, rigid_contact=rigid_contact, horizon=horizon,
                 demands=demands, contact_law=law, contact_dynamics="elastic")  # fmt: skip


def break_on_ramp(
    scene: Scene,
    quantities: Sequence[str],
    paths: Sequence[Path],
    strengths: Array,
    *,
    fidelity: str = "full",
    tolerance: float = 1e-5,
    threads: int | None = None,
) -> Breaks:
    """Where and how n scenes of `ramp_scene` break, at m strengths of L limits.

    quantities, paths: what each limit holds against its strength, and how that follows the loading (`outputs.path_of`);
    strengths (m, L): SI, over the model factor; a criterion with an effect of rate takes the rate of the whole rise.
    """
    n, m = len(scene), len(strengths)
    found = dynamics.solve(scene, fidelity=fidelity, tolerance=tolerance, threads=threads, quantities=quantities)
    demand = np.stack([found.values[name] for name in quantities], axis=1)
    with np.errstate(all="ignore"):
        shares = strengths[None, :, :] / demand[:, None, :]
    shares[~answered(found.status)] = np.nan
    rows = np.repeat(np.arange(n), m)
    flat = np.where(np.isnan(shares), np.inf, shares).reshape(n * m, -1)
    broken = first_fractures(scene, flat, paths, rows=rows, fidelity=fidelity, tolerance=tolerance, threads=threads)
    lost = (flat < 1.0).any(axis=1) & (broken.first < 0)
    nearest = np.where(lost, np.nan, np.where(np.isnan(shares).any(axis=2).ravel(), np.nan, flat.min(axis=1)))
    return Breaks(
        share=nearest.reshape(n, m),
        limit=broken.first.reshape(n, m),
        time=broken.time.reshape(n, m),
        force=broken.force.reshape(n, m),
        imbalance=broken.imbalance.reshape(n, m),
    )


def shortest_striker(scene: Scene, breaks: Breaks, fall: float) -> Array:
    """Least length of the striker [m] whose pulse is still at its height when the sphere breaks, (n, m).

    A pulse of width t_i at half height stays up to t_i + (rise - fall)/2, and has a height at all where
    t_i >= (rise + fall)/2; t_i = 2 l_0/c_s.
    """
    rise = scene.columns["pulse.rise"][:, None]
    E, density = (scene.columns.get(f"striker.{key}", scene.columns[f"bars.{key}"]) for key in ("E", "density"))
    width = np.maximum(breaks.time - 0.5 * (rise - fall), 0.5 * (rise + fall))
    return np.asarray(0.5 * bars.wave_speed(E, density)[:, None] * width)


def usages(scene: Scene, breaks: Breaks, rig: Rig) -> dict[str, Array]:
    """What each bound of `CONSTRAINTS` is used up to, (n, m) each: above 1 broken, NaN where it says nothing.

    A sphere that does not break says nothing of the bounds on how it breaks, and bars whose yield strength is not
    given none of theirs.

    >>> import numpy as np
    >>> columns = {"sphere.E": 52e9, "sphere.nu": 0.25, "sphere.radius": 0.005, "sphere.density": 2650.0,
    ...            "bars.E": 210e9, "bars.nu": 0.3, "bars.density": 7850.0, "bars.diameter": 0.02, "striker.speed": 1.0}
    >>> scene = ramp_scene({name: np.array([value]) for name, value in columns.items()}, np.array([0.0]))
    >>> breaks = break_on_ramp(scene, ["P_max"], [Path(over="force")], np.array([[2e3], [1e4]]))
    >>> found = usages(scene, breaks, Rig(length=0.4))
    >>> [name for name in found if found[name][0, 0] < 1.0], bool(found["speed"][0, 1] > 1.0)
    (['speed', 'reflection', 'length', 'equilibrium', 'striker'], True)
    """
    c = scene.columns
    shape = breaks.share.shape

    def wide(values: Array) -> Array:
        return np.broadcast_to(np.asarray(values)[:, None], shape)

    E, density = (c.get(f"striker.{key}", c[f"bars.{key}"]) for key in ("E", "density"))
    width = 2.0 * rig.length / bars.wave_speed(E, density)
    level, steps = np.ones(len(scene)), np.ones(len(scene))
    if scene.striker_ratio is not None:
        levels, _ = striker_steps(scene.striker_ratio)
        level, steps = levels[:, 0], (levels > 0.0).sum(axis=1)
    strength = scene.column("bars.yield_strength")
    strength = np.where(strength > 0.0, strength, np.nan)
    stress = level * bars.pulse_stress(c["striker.speed"], c["bars.E"], c["bars.density"])
    end = 0.5 * (c["pulse.rise"] + rig.fall) + steps * width
    return {
        "speed": breaks.share,
        "reflection": breaks.time / rig.first_return,
        "length": shortest_striker(scene, breaks, rig.fall) / rig.length,
        "equilibrium": breaks.imbalance / rig.level,
        "pulse_yield": wide(stress / strength),
        "contact_yield": np.full(shape, np.nan) if rig.dents else over_onset(scene, breaks),
        "striker": wide(end / rig.round_trip),
    }


def over_onset(scene: Scene, breaks: Breaks) -> Array:
    """Pressure by Hertz when the sphere breaks over the onset of bars or inserts, (n, m); nan where none is known."""
    onset = softest_partner(scene).onset
    scales = scene.scales
    pressure = contact.pressure_at_force(breaks.force, scales.modulus[:, None], scales.effective_radius[:, None])
    over: Array = pressure / np.where(np.isfinite(onset), onset, np.nan)[:, None]
    return over


def binding(used: Mapping[str, Array]) -> tuple[Places, Flags]:
    """The constraint that binds, its place in `used` (-1: not computed), and whether every one is kept; (n, m) each.

    What binds is what is used the most; a sphere that cannot be broken is named so before anything else.
    """
    stacked = np.stack(list(used.values()))
    largest = np.where(np.isnan(stacked), -np.inf, stacked)
    which = np.where(used["speed"] > 1.0, list(used).index("speed"), largest.argmax(axis=0))
    failed = np.isnan(used["speed"])
    return np.where(failed, -1, which), ~failed & (largest <= 1.0).all(axis=0)
