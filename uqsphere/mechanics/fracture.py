"""When a sphere breaks: the first moment at which a criterion's course over the loading reaches its
strength.

Nearly every criterion is a rising function of the largest contact force so far, the others of the
energy stored so far; where faces yield too, for below its largest approach a face presses less than
it did there.  A strength is therefore a level of force or energy, and the fracture the first time
at which the motion comes to it.  What the record of the quantities of interest holds is held here
too: the loading ends with the first loss of contact.  Criteria that grow their strength with the
rate take the one rate of the sample, that of the whole record.
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
from uqsphere.mechanics.outputs import Columns, Path, columns_of, pressed_to
from uqsphere.mechanics.roots import bisect
from uqsphere.mechanics.scene import Scene

#: halvings that refine a crossing in one of the parts of a step, as many as its series has powers:
#: to 2^-49 of the step
_HALVINGS: Final = 45
_SHARES: Final = np.arange(1, ORDER + 1) / ORDER
_POWERS: Final = _SHARES[None, :] ** np.arange(TERMS)[:, None]
#: rows whose motions are held in memory together
_BLOCK: Final = 256


@dataclass(frozen=True, kw_only=True)
class Fractures:
    """Fracture of n specimens by L criteria.

    times (n, L): first time at which each criterion reaches its strength [s], as if the sphere held
    the others; infinite where it does not.  first (n,): the criterion that is reached first; -1
    where none is, and the numbers below are NaN: time [s], the larger contact force [N], energy
    stored in both contacts [J], and imbalance, the difference of the two forces at that moment over
    the largest so far.  early (n,): whether it comes before the first reflected wave is back.
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
    """One row's motion in scaled variables: start and length (m,), approaches (m, 2, 17), and its
    nodes.

    `times` (16 m,) of the nodes, which divide every step into 16 parts, `force` and `energy` (16
    m,) the largest drive and the largest energy so far.  What drives is the approach, whose 3/2
    power is the force of Hertz, or the force itself where faces have laws of their own: `forces`
    (m, 2, 17), and `deepest` (16 m, 2) the largest approaches so far.
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
        return self.force if over == "force" else self.energy


def _values(states: Array, share: Array) -> Array:
    """Approaches (..., 2) at a share (...) of the steps with the coefficients (..., 2, 17); never
    negative.
    """
    found = polyval(share[..., None], np.moveaxis(states, -1, 0), tensor=False)
    return np.maximum(found, 0.0)


def _stored(approach: Array) -> Array:
    """Energy of both contacts in scaled variables, theory (17): (2/5) sum x^(5/2)."""
    return np.asarray(0.4 * (np.square(approach) * np.sqrt(approach)).sum(axis=-1))


def _held(scene: Scene, rows: Places, push: Array, approach: Array, deepest: Array) -> Array:
    """Energy of both contacts where faces have laws of their own: (2/5) q (x - x_r), (C10), (...)
    of rows (...).
    """
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
    """The course of one motion, which ends where contact is lost or no larger force or energy can
    come.
    """
    # contact may be lost inside the last step
    inside = motion.start < motion.end
    start, states = motion.start[inside], motion.states[inside, :2]
    length = np.minimum(motion.length[inside], motion.end - start)
    cut = (length / motion.length[inside])[:, None, None] ** np.arange(states.shape[2])
    approach = _nodes(states * cut)
    times = (start[:, None] + length[:, None] * _SHARES).ravel()
    if motion.forces is None:
        return _Course(
            start=start,
            length=length,
            states=states * cut,
            times=times,
            force=np.maximum.accumulate(approach.max(axis=1)),
            energy=np.maximum.accumulate(_stored(approach)),
        )
    forces = motion.forces[inside] * cut
    push, deepest = _nodes(forces), np.maximum.accumulate(approach, axis=0)
    held = _held(motion.scene, np.array([motion.row]), push, approach, deepest)
    return _Course(
        start=start,
        length=length,
        states=states * cut,
        times=times,
        forces=forces,
        deepest=deepest,
        force=np.maximum.accumulate(push.max(axis=1)),
        energy=np.maximum.accumulate(held),
    )


def _demands(scene: Scene, rows: Places, path: Path, value: Array) -> Array:
    """The demand at a force [N] or a stored energy [J] of each row."""
    if path.criterion is None:
        return value**path.power
    pressed = (
        {"energy": value}
        if path.over == "energy"
        else {"P_max": value, **pressed_to(scene, rows, value)}
    )
    columns = Columns({**columns_of(scene, rows), **pressed})
    return demand(CRITERIA[path.criterion], columns, path.parameters)


def _levels(scene: Scene, rows: Places, path: Path, top: Array, share: Array) -> Array:
    """Share of the largest force or energy, `top` (n,) in SI, at which the demand is `share` (n,)
    of its largest.
    """
    wanted = share * _demands(scene, rows, path, top)
    if path.criterion is None:
        return np.asarray(share if path.power == 1.0 else share ** (1.0 / path.power))
    low, high = np.zeros(len(rows)), np.ones(len(rows))
    return bisect(
        lambda part: _demands(scene, rows, path, part * top) < wanted, low, high, _HALVINGS
    )[1]


def first_fractures(
    scene: Scene,
    shares: Array,
    paths: Sequence[Path],
    *,
    rows: Places | None = None,
    fidelity: str = "full",
    tolerance: float = 1e-5,
    threads: int | None = None,
) -> Fractures:
    """The moment at which each of n specimens first reaches a strength.

    shares (n, L): strength over the largest demand of the record; 1 and above is not reached, 0 and
    below at first touch. paths: how the L criteria follow the loading.  rows (n,): the row of the
    scene that loads a specimen; its own if None. fidelity: `full` or `massless`.  A specimen whose
    row cannot be integrated reaches nothing.  ValueError if shares is not (n, L), or the fidelity
    has no Hertz contact.
    """
    if fidelity not in ("full", "massless"):
        raise ValueError(f"fracture needs the fidelity full or massless, found {fidelity!r}")
    rows = np.arange(len(scene)) if rows is None else np.asarray(rows)
    n = len(rows)
    if shares.shape != (n, len(paths)):
        raise ValueError(f"shares must be ({n}, {len(paths)}), found {shares.shape}")
    # time, force, energy and imbalance at each crossing
    found = np.full((4, *shares.shape), np.nan)
    found[0] = np.inf
    loaded = np.unique(rows[(scene.status[rows] == 0) & (shares < 1.0).any(axis=1)])
    followed = ("energy",) if any(path.over == "energy" for path in paths) else ("P_max",)
    follow = partial(
        motions, fidelity=fidelity, tolerance=tolerance, threads=threads, quantities=followed
    )
    for begin in range(0, len(loaded), _BLOCK):
        moved = follow(scene, loaded[begin : begin + _BLOCK])
        known = {
            one.row: _course(one) for one in moved if isinstance(one, Motion) and len(one.start)
        }
        here = np.isin(rows, list(known))
        for at, path in enumerate(paths):
            picked = np.flatnonzero(here & (shares[:, at] < 1.0))
            if len(picked):
                courses = [known[int(row)] for row in rows[picked]]
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
    scene: Scene, rows: Places, courses: Sequence[_Course], path: Path, shares: Array
) -> Array:
    """Time [s], larger force [N], stored energy [J] and imbalance at the first crossing of each
    row, (4, n).
    """
    scales = scene.scales
    unit = scales.time[rows]
    last = [
        int(np.searchsorted(c.times, e)) if path.early else len(c.times)
        for c, e in zip(courses, scene.first_echo[rows] / unit, strict=True)
    ]
    tops = np.array(
        [c.along(path.over)[max(end - 1, 0)] for c, end in zip(courses, last, strict=True)]
    )
    # the force over its drive: that of Hertz goes with the 3/2 power of the approach
    power = 1.5 if courses[0].forces is None else 1.0
    to_si = scales.force[rows] * (
        tops**power if path.over == "force" else scales.approach[rows] * tops
    )
    at_level = _levels(scene, rows, path, to_si, np.clip(shares, 0.0, 1.0))
    levels = tops * (at_level ** (1.0 / power) if path.over == "force" else at_level)
    at = np.array(
        [
            min(int(np.searchsorted(c.along(path.over), level)), len(c.times) - 1)
            for c, level in zip(courses, levels, strict=True)
        ]
    )
    moment = _moment(scene, rows, courses, at)

    def below(share: Array) -> Flags:
        drive, energy = moment(share)
        return np.asarray((drive.max(axis=1) if path.over == "force" else energy) < levels)

    high = _SHARES[at % ORDER]
    _, high = bisect(below, high - 1.0 / ORDER, high, _HALVINGS)
    drive, energy = moment(high)
    step = at // ORDER
    begin = np.array([c.start[k] for c, k in zip(courses, step, strict=True)])
    length = np.array([c.length[k] for c, k in zip(courses, step, strict=True)])
    before = np.array([c.force[k - 1] if k else 0.0 for c, k in zip(courses, at, strict=True)])
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


def _moment(
    scene: Scene, rows: Places, courses: Sequence[_Course], at: Places
) -> Callable[[Array], tuple[Array, Array]]:
    """What drives both faces (n, 2), and the energy in both (n,), at shares (n,) of the steps of
    the nodes `at`.
    """
    step = at // ORDER
    states = np.stack([c.states[k] for c, k in zip(courses, step, strict=True)])
    if courses[0].forces is None:

        def of_hertz(share: Array) -> tuple[Array, Array]:
            approach = _values(states, share)
            return approach, _stored(approach)

        return of_hertz
    forces = np.stack(
        [c.forces[k] for c, k in zip(courses, step, strict=True) if c.forces is not None]
    )
    none = np.zeros(2)
    deepest = np.stack(
        [
            c.deepest[k - 1] if k else none
            for c, k in zip(courses, at, strict=True)
            if c.deepest is not None
        ]
    )

    def of_laws(share: Array) -> tuple[Array, Array]:
        approach, push = _values(states, share), _values(forces, share)
        return push, _held(scene, rows, push, approach, np.maximum(deepest, approach))

    return of_laws
