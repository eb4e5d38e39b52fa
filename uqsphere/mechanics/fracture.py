"""Time of fracture: the first instant at which a demand reaches its strength during the loading.

Demands increase with the peak contact force so far, some with the peak stored energy so far, also
if contacts yield.  A strength is therefore a level of force or energy, and fracture is the first
time at which the motion reaches it, within the evaluation window of the quantities of interest.
Criteria with a rate effect use one rate per sample, that of the whole window.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.polynomial.polynomial import polyval

from uqsphere.arrays import Array, Flags, Places
from uqsphere.mechanics.criteria import CRITERIA, demand
from uqsphere.mechanics.integrator.solve import Motion, motions
from uqsphere.mechanics.integrator.tracked import ORDER, TERMS
from uqsphere.mechanics.outputs import Columns, LoadingPath, columns_of, pressed_to
from uqsphere.mechanics.roots import bisect
from uqsphere.mechanics.scene import Scene

#: halvings that refine a crossing within a part of a step, to 2^-49 of the step
_HALVINGS: Final = 45
_SHARES: Final = np.arange(1, ORDER + 1) / ORDER
_POWERS: Final = _SHARES[None, :] ** np.arange(TERMS)[:, None]
#: rows whose motions are kept in memory together
_BLOCK_ROWS: Final = 256


@dataclass(frozen=True, kw_only=True)
class Fractures:
    """Fracture of n specimens by L criteria.

    times (n, L): first time at which each criterion reaches its strength [s], as if the sphere
        survived the others; infinite if it does not.
    first (n,): the criterion that is reached first; -1 if there is none, and NaN below.
    time, force, energy (n,): time of fracture [s], the larger contact force [N], the energy stored
        in both contacts [J].
    imbalance (n,): difference of the contact forces at fracture over the peak force so far.
    early (n,): whether fracture precedes the first reflected wave.
    """

    times: Array
    first: Places
    time: Array
    force: Array
    energy: Array
    imbalance: Array
    early: Flags


@dataclass(frozen=True, kw_only=True)
class _Course:
    """One row's motion in scaled variables.

    start, length (m,): of the steps.  states (m, 2, 17): coefficients of the approaches.  times (16
    m,): of the nodes, which divide every step into 16 parts.  force, energy (16 m,): peak drive and
    peak energy so far; the drive is the approach, whose 3/2 power is the Hertz force, or the force
    itself for contacts that yield or differ.  forces (m, 2, 17), deepest (16 m, 2): coefficients of
    such forces, and peak approaches so far.
    """

    start: Array
    length: Array
    states: Array
    times: Array
    force: Array
    energy: Array
    forces: Array | None = None
    deepest: Array | None = None

    def along(self, over: str) -> Array:
        if over == "force":
            return self.force
        return self.energy


def _values(states: Array, share: Array) -> Array:
    """Approaches (..., 2), at least 0, at a fraction (...) of steps (..., 2, 17)."""
    return np.maximum(polyval(share[..., None], np.moveaxis(states, -1, 0), tensor=False), 0.0)


def _stored(approach: Array) -> Array:
    """Energy of both contacts in scaled variables, theory (18): (2/5) sum x^(5/2)."""
    return np.asarray(0.4 * (np.square(approach) * np.sqrt(approach)).sum(axis=-1))


def _stored_by_law(
    scene: Scene, rows: Places, push: Array, approach: Array, deepest: Array
) -> Array:
    """Energy of contacts that yield or differ: (2/5) q (x - x_r), (C10), (...) of rows (...)."""
    total = np.zeros(push.shape[:-1])
    unit = scene.scales.approach[rows]
    for pole, partner in enumerate(scene.partners):
        if partner is None:
            continue
        above = approach[..., pole]
        if partner.face is not None:
            face = partner.face.at(rows)
            with np.errstate(all="ignore"):
                largest = deepest[..., pole] * unit / face.onset_approach
                if (largest > 1.0).any():
                    dent = (largest - face.recovery(largest)) * face.onset_approach / unit
                    above = above - np.where(largest > 1.0, dent, 0.0)
        total = total + 0.4 * push[..., pole] * np.maximum(above, 0.0)
    return total


def _nodes(states: Array) -> Array:
    """Values of (m, 2, 17) coefficients at the nodes, (16 m, 2)."""
    return np.maximum(states @ _POWERS, 0.0).transpose(0, 2, 1).reshape(-1, 2)


def _course(motion: Motion) -> _Course:
    """The course of one motion up to contact loss, or until no larger force or energy can occur."""
    # contact may be lost within the last step
    inside = motion.start < motion.end
    start, states = motion.start[inside], motion.states[inside, :2]
    length = np.minimum(motion.length[inside], motion.end - start)
    cut = (length / motion.length[inside])[:, None, None] ** np.arange(states.shape[2])
    approach = _nodes(states * cut)
    times = (start[:, None] + length[:, None] * _SHARES).ravel()
    forces, deepest = None, None
    drive, energy = approach, _stored(approach)
    if motion.forces is not None:
        forces, deepest = motion.forces[inside] * cut, np.maximum.accumulate(approach, axis=0)
        drive = _nodes(forces)
        energy = _stored_by_law(motion.scene, np.array([motion.row]), drive, approach, deepest)
    return _Course(
        start=start,
        length=length,
        states=states * cut,
        times=times,
        force=np.maximum.accumulate(drive.max(axis=1)),
        energy=np.maximum.accumulate(energy),
        forces=forces,
        deepest=deepest,
    )


def _demands(scene: Scene, rows: Places, path: LoadingPath, value: Array) -> Array:
    """The demand at a force [N] or a stored energy [J] of each row."""
    if path.criterion is None:
        return value**path.power
    pressed = {"energy": value}
    if path.over != "energy":
        pressed = {"P_max": value, **pressed_to(scene, rows, value)}
    columns = Columns({**columns_of(scene, rows), **pressed})
    return demand(CRITERIA[path.criterion], columns, path.parameters)


def _levels(scene: Scene, rows: Places, path: LoadingPath, top: Array, share: Array) -> Array:
    """Fraction of the peak force or energy, `top` (n,) [SI], at which the demand is `share` (n,) of
    its peak.
    """
    wanted = share * _demands(scene, rows, path, top)
    if path.criterion is None:
        return share ** (1.0 / path.power)
    low, high = np.zeros(len(rows)), np.ones(len(rows))
    return bisect(
        lambda part: _demands(scene, rows, path, part * top) < wanted, low, high, _HALVINGS
    )[1]


def first_fractures(
    scene: Scene,
    shares: Array,
    paths: Sequence[LoadingPath],
    *,
    rows: Places | None = None,
    fidelity: str = "full",
    tolerance: float = 1e-5,
) -> Fractures:
    """Fracture of n specimens: the first instant at which each reaches a strength.

    shares (n, L): strength over the peak demand; at 1 and above the strength is not reached, at 0
    and below at first touch.  paths: how the L criteria follow the loading.  rows (n,): the row of
    the scene that loads each specimen (default: its own).  fidelity: `full` or `massless`.  A
    specimen whose row cannot be integrated does not break.

    Raises ValueError for another shape of shares, or another fidelity.
    """
    if fidelity not in ("full", "massless"):
        raise ValueError(f"fidelity must be 'full' or 'massless' for fracture, not {fidelity!r}")
    rows = np.arange(len(scene)) if rows is None else np.asarray(rows)
    n = len(rows)
    if shares.shape != (n, len(paths)):
        raise ValueError(f"shares must have the shape ({n}, {len(paths)}), not {shares.shape}")
    # time, force, energy and imbalance at each crossing
    found = np.full((4, *shares.shape), np.nan)
    found[0] = np.inf
    loaded = np.unique(rows[(scene.status[rows] == 0) & (shares < 1.0).any(axis=1)])
    followed = ("P_max",)
    if any(path.over == "energy" for path in paths):
        followed = ("energy",)
    follow = partial(motions, fidelity=fidelity, tolerance=tolerance, quantities=followed)
    for begin in range(0, len(loaded), _BLOCK_ROWS):
        moved = follow(scene, loaded[begin : begin + _BLOCK_ROWS])
        courses_of = {
            motion.row: _course(motion)
            for motion in moved
            if isinstance(motion, Motion) and len(motion.start)
        }
        here = np.isin(rows, list(courses_of))
        for at, path in enumerate(paths):
            picked = np.flatnonzero(here & (shares[:, at] < 1.0))
            if len(picked):
                courses = [courses_of[int(row)] for row in rows[picked]]
                found[:, picked, at] = _cross(
                    scene, rows[picked], courses, path, shares[picked, at]
                )
    return _first(found, scene.first_echo[rows])


def _first(found: Array, first_echo: Array) -> Fractures:
    """The crossing (4, n, L) that comes first for each specimen."""
    governing = np.argmin(found[0], axis=1)
    time, force, energy, imbalance = found[:, np.arange(len(governing)), governing]
    none = np.isinf(time)
    return Fractures(
        times=found[0],
        first=np.where(none, -1, governing),
        time=np.where(none, np.nan, time),
        force=force,
        energy=energy,
        imbalance=imbalance,
        early=~none & (time < first_echo),
    )


def _cross(
    scene: Scene, rows: Places, courses: Sequence[_Course], path: LoadingPath, shares: Array
) -> Array:
    """Time [s], larger force [N], energy [J], imbalance at the first crossing of rows, (4, n)."""
    scales = scene.scales
    unit = scales.time[rows]
    tops = _tops(courses, path, scene.first_echo[rows] / unit)
    # the Hertz force is the 3/2 power of its drive, the approach
    power = 1.5 if courses[0].forces is None else 1.0
    if path.over == "force":
        peak, exponent = scales.force[rows] * tops**power, power
    else:
        peak, exponent = scales.force[rows] * scales.approach[rows] * tops, 1.0
    at_level = _levels(scene, rows, path, peak, np.clip(shares, 0.0, 1.0))
    levels = tops * at_level ** (1.0 / exponent)
    at = np.array(
        [
            min(int(np.searchsorted(c.along(path.over), level)), len(c.times) - 1)
            for c, level in zip(courses, levels, strict=True)
        ]
    )
    moment = _moment(scene, rows, courses, at)

    def below(share: Array) -> Flags:
        drive, energy = moment(share)
        if path.over == "force":
            return np.asarray(drive.max(axis=1) < levels)
        return np.asarray(energy < levels)

    high = _SHARES[at % ORDER]
    _, high = bisect(below, high - 1.0 / ORDER, high, _HALVINGS)
    drive, energy = moment(high)
    step = at // ORDER
    begin = _picked([c.start for c in courses], step)
    length = _picked([c.length for c in courses], step)
    before = np.where(at > 0, _picked([c.force for c in courses], at - 1), 0.0)
    push = drive**power
    largest = np.maximum(before**power, push.max(axis=1))
    with np.errstate(invalid="ignore"):
        imbalance = np.where(largest > 0.0, np.abs(push[:, 0] - push[:, 1]) / largest, 0.0)
    return np.stack(
        [
            (begin + high * length) * unit,
            scales.force[rows] * push.max(axis=1),
            scales.force[rows] * scales.approach[rows] * energy,
            imbalance,
        ]
    )


def _picked(columns: Sequence[Array], at: Places) -> Array:
    """Entry `at` (n,) of each of n columns."""
    return np.stack([column[k] for column, k in zip(columns, at, strict=True)])


def _tops(courses: Sequence[_Course], path: LoadingPath, first_echo: Array) -> Array:
    """Peak drive or energy of each course, of an `early` path before the first reflected wave."""
    tops = []
    for course, echo in zip(courses, first_echo, strict=True):
        last = len(course.times)
        if path.early:
            last = int(np.searchsorted(course.times, echo))
        tops.append(course.along(path.over)[max(last - 1, 0)])
    return np.array(tops)


def _moment(
    scene: Scene, rows: Places, courses: Sequence[_Course], at: Places
) -> Callable[[Array], tuple[Array, Array]]:
    """Function of fractions (n,) of the steps of nodes `at`: drives (n, 2), energies (n,)."""
    step = at // ORDER
    states = _picked([c.states for c in courses], step)
    if courses[0].forces is None:

        def of_hertz(share: Array) -> tuple[Array, Array]:
            approach = _values(states, share)
            return approach, _stored(approach)

        return of_hertz
    forces = _picked([c.forces for c in courses if c.forces is not None], step)
    before = _picked([c.deepest for c in courses if c.deepest is not None], at - 1)
    deepest = np.where(at[:, None] > 0, before, 0.0)

    def of_laws(share: Array) -> tuple[Array, Array]:
        approach, push = _values(states, share), _values(forces, share)
        return push, _stored_by_law(scene, rows, push, approach, np.maximum(deepest, approach))

    return of_laws
