"""When a sphere breaks: the first moment at which a criterion's course over the loading reaches its strength.

Nearly every criterion is a rising function of the largest contact force so far, the others of the energy stored so
far.  A strength is therefore a level of force or energy, and the fracture the first time at which the motion comes
to it.  What the record of the quantities of interest holds is held here too: the loading ends with the first loss of
contact.  Criteria that grow their strength with the rate take the one rate of the sample, that of the whole record.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags, Places
from uqsphere.mechanics.criteria import CRITERIA, demand
from uqsphere.mechanics.integrator.solve import Motion, motions
from uqsphere.mechanics.outputs import Columns, Path, columns_of
from uqsphere.mechanics.scene import Scene

#: parts of a step of the integrator that are looked at before a crossing is refined, as many as its series has powers;
#: halvings that refine it, to 2^-49 of the step
_PARTS: Final = 16
_HALVINGS: Final = 45
_SHARES: Final = np.arange(1, _PARTS + 1) / _PARTS
_POWERS: Final = _SHARES[None, :] ** np.arange(17)[:, None]
#: rows whose motions are held in memory together
_BLOCK: Final = 256


@dataclass(frozen=True, kw_only=True)
class Fractures:
    """Fracture of n specimens by L criteria.

    Attributes
    ----------
    times : (n, L) array
        First time at which each criterion reaches its strength [s], as if the sphere held the others; infinite where
        it does not.
    first : (n,) array of int
        The criterion that is reached first; -1 where none is, and the numbers below are NaN.
    time, force, energy, imbalance : (n,) arrays
        At the first: time [s], the larger contact force [N], energy stored in both contacts [J], and the difference
        of the two forces at that moment over the largest force so far.
    early : (n,) array of bool
        Whether it comes before the first reflected wave is back.
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
    """One row's motion in scaled variables: start and length (m,), approaches (m, 2, 17), and its nodes.

    `times` (16 m,) of the nodes, which divide every step into 16 parts, `force` and `energy` (16 m,) the largest
    approach and the largest energy so far.
    """

    start: Array
    length: Array
    states: Array
    times: Array
    force: Array
    energy: Array

    def along(self, over: str) -> Array:
        return self.force if over == "force" else self.energy


def _values(states: Array, share: Array) -> Array:
    """Approaches (..., 2) at a share (...) of the steps with the coefficients (..., 2, 17); never negative."""
    total = states[..., -1]
    for k in range(states.shape[-1] - 2, -1, -1):
        total = total * share[..., None] + states[..., k]
    return np.maximum(total, 0.0)


def _stored(approach: Array) -> Array:
    """Energy of both contacts in scaled variables, theory (17): (2/5) sum x^(5/2)."""
    return np.asarray(0.4 * (np.square(approach) * np.sqrt(approach)).sum(axis=-1))


def _course(motion: Motion) -> _Course:
    """The course of one motion, which ends where contact is lost or no larger force or energy can come."""
    # contact may be lost inside the last step
    inside = motion.start < motion.end
    start, states = motion.start[inside], motion.states[inside, :2]
    length = np.minimum(motion.length[inside], motion.end - start)
    states = states * (length / motion.length[inside])[:, None, None] ** np.arange(states.shape[2])
    approach = np.maximum(states @ _POWERS, 0.0).transpose(0, 2, 1).reshape(-1, 2)
    return _Course(
        start=start,
        length=length,
        states=states,
        times=(start[:, None] + length[:, None] * _SHARES).ravel(),
        force=np.maximum.accumulate(approach.max(axis=1)),
        energy=np.maximum.accumulate(_stored(approach)),
    )


def _demands(scene: Scene, rows: Places, path: Path, value: Array) -> Array:
    """The demand at a force [N] or a stored energy [J] of each row."""
    if path.criterion is None:
        return value
    columns = Columns({**columns_of(scene, rows), "energy" if path.over == "energy" else "P_max": value})
    return demand(CRITERIA[path.criterion], columns, path.parameters)


def _levels(scene: Scene, rows: Places, path: Path, top: Array, share: Array) -> Array:
    """Share of the largest force or energy, `top` (n,) in SI, at which the demand is `share` (n,) of its largest."""
    wanted = share * _demands(scene, rows, path, top)
    low, high = np.zeros(len(rows)), np.ones(len(rows))
    if path.criterion is None:
        return np.asarray(share)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        below = _demands(scene, rows, path, middle * top) < wanted
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return high


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

    Parameters
    ----------
    scene : Scene
        k rows.
    shares : (n, L) array
        Strength over the largest demand of the record; 1 and above is not reached, 0 and below at first touch.
    paths : L of Path
        How the criteria follow the loading.
    rows : (n,) array of int, optional
        The row of the scene that a specimen is loaded by; each by its own if None.
    fidelity : str
        `full` or `massless`.
    tolerance : float
        Relative error of the integration.
    threads : int, optional

    Returns
    -------
    Fractures
        A specimen whose row cannot be integrated reaches nothing.

    Raises
    ------
    ValueError
        If shares is not (n, L), or the fidelity has no Hertz contact.
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
    follow = partial(motions, fidelity=fidelity, tolerance=tolerance, threads=threads, quantities=followed)
    for begin in range(0, len(loaded), _BLOCK):
        moved = follow(scene, loaded[begin : begin + _BLOCK])
        known = {one.row: _course(one) for one in moved if isinstance(one, Motion) and len(one.start)}
        here = np.isin(rows, list(known))
        for at, path in enumerate(paths):
            picked = np.flatnonzero(here & (shares[:, at] < 1.0))
            if len(picked):
                courses = [known[int(row)] for row in rows[picked]]
                found[:, picked, at] = _cross(scene, rows[picked], courses, path, shares[picked, at])
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


def _cross(scene: Scene, rows: Places, courses: Sequence[_Course], path: Path, shares: Array) -> Array:
    """Time [s], larger force [N], stored energy [J] and imbalance at the first crossing of each row, (4, n)."""
    scales = scene.scales
    unit = scales.time[rows]
    last = [
        int(np.searchsorted(c.times, e)) if path.early else len(c.times)
        for c, e in zip(courses, scene.first_echo[rows] / unit, strict=True)
    ]
    tops = np.array([c.along(path.over)[max(end - 1, 0)] for c, end in zip(courses, last, strict=True)])
    to_si = scales.force[rows] * (tops**1.5 if path.over == "force" else scales.approach[rows] * tops)
    at_level = _levels(scene, rows, path, to_si, np.clip(shares, 0.0, 1.0))
    levels = tops * (at_level ** (2.0 / 3.0) if path.over == "force" else at_level)
    at = np.array(
        [
            min(int(np.searchsorted(c.along(path.over), level)), len(c.times) - 1)
            for c, level in zip(courses, levels, strict=True)
        ]
    )
    step = at // _PARTS
    states = np.stack([c.states[k] for c, k in zip(courses, step, strict=True)])
    high = _SHARES[at % _PARTS]
    low = high - 1.0 / _PARTS
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        approach = _values(states, middle)
        below = (approach.max(axis=1) if path.over == "force" else _stored(approach)) < levels
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    approach = _values(states, high)
    begin = np.array([c.start[k] for c, k in zip(courses, step, strict=True)])
    length = np.array([c.length[k] for c, k in zip(courses, step, strict=True)])
    before = np.array([c.force[k - 1] if k else 0.0 for c, k in zip(courses, at, strict=True)])
    push = approach**1.5
    largest = np.maximum(before**1.5, push.max(axis=1))
    with np.errstate(invalid="ignore"):
        imbalance = np.where(largest > 0.0, np.abs(push[:, 0] - push[:, 1]) / largest, 0.0)
    return np.stack(
        [
            (begin + high * length) * unit,
            scales.force[rows] * push.max(axis=1),
            scales.force[rows] * scales.approach[rows] * _stored(approach),
            imbalance,
        ]
    )
