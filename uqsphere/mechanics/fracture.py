"""Time of fracture: the first instant at which a demand reaches its strength during the loading.

Demands increase with the peak contact force so far, some with the peak stored energy so far, also
if contacts yield.  A strength is therefore a level of force or energy, and fracture is the first
time at which the motion reaches it, within the evaluation window of the quantities of interest.
Criteria with a rate effect use one rate per sample, that of the whole window.
"""

from collections.abc import Sequence
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polyval

from uqsphere.arrays import Array, Function, Places, quiet

from .closed_form import solve_closed
from .criteria import CRITERIA, Demands, Parameters, demand
from .integrator.solve import Motion, check_request, motions
from .integrator.tracked import ORDER, TERMS
from .outputs import OUTPUTS, Columns, columns_of, columns_of_press
from .roots import bisect
from .scene import Partner, Scene, answered

#: halvings that refine a crossing within a part of a step, to 2^-49 of the step
_HALVINGS = 45
_SHARES = np.arange(1, ORDER + 1) / ORDER
_POWERS = _SHARES[None, :] ** np.arange(TERMS)[:, None]
#: rows whose motions are kept in memory together
_BLOCK_ROWS = 256


class LoadingPath(NamedTuple):
    """How a fracture quantity follows the loading.

    over: it increases with the peak `force` or `energy` so far.  criterion: the criterion whose
    formula it is; None for the force or energy itself, to a `power`.  parameters: of the criterion
    without `rate_0`, whose factor is one number per sample.  early: only the time before the first
    reflected wave counts.
    """

    over: str
    criterion: str | None = None
    parameters: Parameters = MappingProxyType({})
    early: bool = False
    power: float = 1.0


#: the elastic-equivalent pressure is proportional to the cube root of the force
_FORCE_POWERS = {"p_hertz": 1.0 / 3.0}
_BY_CRITERION = {quantity: key for key, c in CRITERIA.items() for quantity in (c.quantity, *c.also)}


def path_of(quantity: str, demands: Demands = MappingProxyType({})) -> LoadingPath | None:
    """How a quantity or a demand follows the loading; None if it does not mean fracture, or says
    nothing of its moment, as the impact energy, which does not increase during the loading.

    >>> path_of("p_max").over, path_of("specific_energy").over, path_of("contact_duration")
    ('force', 'energy', None)
    """
    if quantity in demands:
        key, parameters = demands[quantity]
        if not CRITERIA[key].follows:
            return None
        kept = {name: value for name, value in parameters.items() if name != "rate_0"}
        return LoadingPath(over=CRITERIA[key].follows, criterion=key, parameters=kept)
    entry = OUTPUTS.get(quantity)
    if entry is None or not entry.fracture or not entry.follows:
        return None
    return LoadingPath(
        over=entry.follows,
        criterion=_BY_CRITERION.get(quantity),
        early=entry.early,
        power=_FORCE_POWERS.get(quantity, 1.0),
    )


class Fractures(NamedTuple):
    """Fracture of n specimens by L criteria.

    times (n, L): first time at which each criterion reaches its strength [s], as if the sphere
        survived the others; infinite if it does not.
    first (n,): the criterion that is reached first; -1 if there is none, and NaN below.
    time, force, energy (n,): time of fracture [s], the larger contact force [N], the energy stored
        in both contacts [J].
    """

    times: Array
    first: Places
    time: Array
    force: Array
    energy: Array


def first_fractures(
    scene: Scene,
    shares: Array,
    paths: Sequence[LoadingPath],
    *,
    fidelity: str = "full",
    tolerance: float = 1e-5,
) -> Fractures:
    """Fracture of n specimens, one for each row: the first instant at which it reaches a strength.

    shares (n, L): strength over the peak demand; at 1 and above the strength is not reached, at 0
    and below at first touch.  paths: how the L criteria follow the loading.  fidelity: `full`,
    `linear` or `massless`.  A specimen whose row cannot be integrated does not break.

    Raises ValueError for another shape of shares, and as `integrator.solve`: without a motion there
        is no time of fracture.
    """
    check_request(scene, fidelity, tolerance)
    if shares.shape != (len(scene), len(paths)):
        raise ValueError(
            f"shares must have the shape ({len(scene)}, {len(paths)}), not {shares.shape}"
        )
    # time, force and energy at each crossing
    crossings = np.full((3, *shares.shape), np.nan)
    crossings[0] = np.inf
    loaded = np.flatnonzero((scene.status == 0) & (shares < 1.0).any(axis=1))
    # the motion up to the peak energy goes on beyond the peak force
    followed = "energy" if any(path.over == "energy" for path in paths) else "P_max"
    for begin in range(0, len(loaded), _BLOCK_ROWS):
        moved = motions(
            scene,
            loaded[begin : begin + _BLOCK_ROWS],
            fidelity=fidelity,
            tolerance=tolerance,
            quantities=(followed,),
        )
        courses = {motion.row: _course(motion) for motion in moved if isinstance(motion, Motion)}
        for at, path in enumerate(paths):
            rows = np.array([row for row in courses if shares[row, at] < 1.0], int)
            if len(rows):
                crossings[:, rows, at] = _cross(
                    scene, rows, [courses[row] for row in rows], path, shares[rows, at]
                )
    return _first_of(crossings)


def _first_of(crossings: Array) -> Fractures:
    """Fracture by the criterion that is reached first: times, forces and energies (3, n, L) at
    which each one is.
    """
    first = np.argmin(crossings[0], axis=1)
    time, force, energy = crossings[:, np.arange(len(first)), first]
    none = np.isinf(time)
    return Fractures(
        times=crossings[0],
        first=np.where(none, -1, first),
        time=np.where(none, np.nan, time),
        force=force,
        energy=energy,
    )


def static_fractures(
    scene: Scene, shares: Array, paths: Sequence[LoadingPath], *, fidelity: str = "full"
) -> Fractures:
    """Fracture of n specimens of a rig without a motion, between platens or under a weight on a
    massless sphere; arguments as of `first_fractures`.

    All forces rise together, and the energy with them, so that the criterion that needs the least
    share of the peak force is reached first.  Times are NaN.
    """
    answers = solve_closed(scene, fidelity, ("P_max", "energy"))
    peaks = {"force": answers.values["P_max"], "energy": answers.values["energy"]}
    # share of the peak force, force and energy at each crossing
    crossings = np.full((3, *shares.shape), np.nan)
    crossings[0] = np.inf
    for at, path in enumerate(paths):
        rows = np.flatnonzero(answered(answers.status) & (shares[:, at] < 1.0))
        force, energy = (peak[rows] for peak in peaks.values())
        stored = partial(_stored_share, scene.struck, rows, force)
        wanted = np.clip(shares[rows, at], 0.0, 1.0)
        level = _levels(scene, rows, path, peaks[path.over][rows], wanted)
        if path.over == "energy":
            level = _where_reached(stored, level)
        crossings[:, rows, at] = level, level * force, stored(level) * energy
    found = _first_of(crossings)
    timeless = np.full_like(found.time, np.nan)
    return found._replace(times=np.where(found.times < np.inf, np.nan, np.inf), time=timeless)


def _stored_share(struck: Partner, rows: Places, peak: Array, share: Array) -> Array:
    """Share of the peak energy at a share (n,) of the peak force (n,) [N]."""
    if struck.face is None:
        return share ** (5.0 / 3.0)
    face = struck.face.at(rows)
    most, now = (face.pressed(face.depth_at(force)).stored for force in (peak, share * peak))
    return now / most


def _where_reached(rising: Function, level: Array) -> Array:
    """Places (n,) in [0, 1] at which a function that rises reaches levels (n,)."""
    return bisect(lambda place: rising(place) < level, 0.0, 1.0, _HALVINGS)[1]


class _Course(NamedTuple):
    """One row's motion in scaled variables.

    start, length (m,): of the steps.  series (2, m, 2, 17): coefficients of the approaches, and of
    the drive: the approach, whose 3/2 power is the Hertz force, or the force itself for contacts
    that yield, differ or are linear.  times (16 m,): of the nodes, which divide every step into 16
    parts.  peaks: peak `force` and peak `energy` so far, (16 m,) each.  deepest (1 + 16 m, 2): peak
    approaches before each node, and in the end.  linear: whether the contacts are.
    """

    start: Array
    length: Array
    series: Array
    times: Array
    peaks: dict[str, Array]
    deepest: Array
    linear: bool


def _course(motion: Motion) -> _Course:
    """The course of one motion up to contact loss, or until no larger force or energy can occur."""
    states = forces = motion.states[:, :2]
    if motion.forces is not None:
        forces = motion.forces
    series = np.stack([states, forces])
    # values at the nodes, (16 m, 2)
    approach, drive = np.maximum(series @ _POWERS, 0.0).swapaxes(2, 3).reshape(2, -1, 2)
    deepest = np.maximum.accumulate(approach, axis=0)
    linear = motion.fidelity == "linear"
    loads = _loads(motion.scene, np.array([motion.row]), drive, approach, deepest, linear)
    return _Course(
        start=motion.start,
        length=motion.length,
        series=series,
        times=(motion.start[:, None] + motion.length[:, None] * _SHARES).ravel(),
        peaks={name: np.maximum.accumulate(load) for name, load in loads.items()},
        deepest=np.vstack([np.zeros(2), deepest]),
        linear=linear,
    )


@quiet
def _loads(
    scene: Scene, rows: Places, drive: Array, approach: Array, deepest: Array, linear: bool
) -> dict[str, Array]:
    """Larger contact force and energy of both contacts in scaled variables, (...) of rows (...);
    drive, approach, deepest: of both contacts (..., 2), see `_Course`.

    The energy is (2/5) sum x^(5/2), theory (18), or (2/5) q (x - x_r), (C10), if contacts yield or
    differ; that of springs, whose force is the approach, is q x/2.
    """
    largest = drive.max(axis=-1)
    if scene.by_hertz and not linear:
        energy = 0.4 * (np.square(approach) * np.sqrt(approach)).sum(axis=-1)
        return {"force": largest**1.5, "energy": energy}
    share = 0.5 if linear else 0.4
    energy = np.zeros_like(largest)
    unit = scene.scales.approach[rows]
    for pole, partner in enumerate(scene.partners):
        if partner is None:
            continue
        above = approach[..., pole]
        if partner.face is not None:
            face = partner.face.at(rows)
            depth = deepest[..., pole] * unit / face.onset_approach
            dent = (depth - face.recovery(depth)) * face.onset_approach / unit
            above = above - np.where(depth > 1.0, dent, 0.0)
        energy = energy + share * drive[..., pole] * np.maximum(above, 0.0)
    return {"force": largest, "energy": energy}


def _levels(scene: Scene, rows: Places, path: LoadingPath, top: Array, share: Array) -> Array:
    """Fraction of the peak force or energy, `top` (n,) [SI], at which the demand is `share` (n,) of
    its peak.
    """
    if path.criterion is None:
        return share ** (1.0 / path.power)
    criterion = CRITERIA[path.criterion]
    columns = columns_of(scene, rows)
    struck = scene.struck
    face = None if struck.face is None else struck.face.at(rows)

    def demand_at(value: Array) -> Array:
        pressed = {"energy": value}
        if path.over == "force":
            pressed = {"P_max": value}
            if face is not None:
                state = face.pressed(face.depth_at(value))
                pressed = columns_of_press(state, struck.takes[rows]) | pressed
        return demand(criterion, Columns({**columns, **pressed}), path.parameters)

    return _where_reached(lambda part: demand_at(part * top), share * demand_at(top))


def _cross(
    scene: Scene, rows: Places, courses: Sequence[_Course], path: LoadingPath, shares: Array
) -> Array:
    """Time [s], larger force [N] and energy [J] at the first crossing of rows, (3, n)."""
    scales = scene.scales
    time = scales.time[rows]
    force = scales.force[rows]
    units = {"force": force, "energy": force * scales.approach[rows]}
    peaks = [course.peaks[path.over] for course in courses]
    if path.early:
        echoes = zip(peaks, courses, scene.first_echo[rows] / time, strict=True)
        peaks = [peak[: max(np.searchsorted(c.times, echo), 1)] for peak, c, echo in echoes]
    top = np.array([peak[-1] for peak in peaks])
    level = top * _levels(scene, rows, path, units[path.over] * top, np.clip(shares, 0.0, 1.0))
    levels = zip(peaks, level, strict=True)
    at = np.array([np.searchsorted(peak[:-1], value) for peak, value in levels])
    steps = list(zip(courses, at // ORDER, strict=True))
    start, length = np.transpose([(c.start[k], c.length[k]) for c, k in steps])
    # (17, 2, n, 2)
    series = np.moveaxis(np.array([c.series[:, k] for c, k in steps]), (3, 1), (0, 1))
    before = np.stack([c.deepest[k] for c, k in zip(courses, at, strict=True)])

    def moment(share: Array) -> dict[str, Array]:
        """Larger force and energy (n,) at a fraction (n,) of the steps."""
        approach, drive = np.maximum(polyval(share[:, None], series, tensor=False), 0.0)
        deepest = np.maximum(before, approach)
        return _loads(scene, rows, drive, approach, deepest, courses[0].linear)

    high = _SHARES[at % ORDER]
    _, high = bisect(
        lambda share: moment(share)[path.over] < level, high - 1.0 / ORDER, high, _HALVINGS
    )
    reached = moment(high)
    instant = (start + high * length) * time
    return np.stack([instant, *(unit * reached[name] for name, unit in units.items())])
