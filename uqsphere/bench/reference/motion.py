"""The reference: one scene at a time, by a method of its own, to about 1e-15.

It solves theory (9) for the full model, with every pulse and every end of the bars, and answers all quantities
that `uqsphere.mechanics.integrator.solve` answers.  It is slow (a tenth of a second to ten seconds a scene) and it
says so when a scene would take more steps than it may: no answer rather than a doubtful one.

Steps are those of `uqsphere.bench.reference.steps`.  A step ends where the pulse, or a reflection of it, jumps or
bends, and begins there in powers of the root of time.  Waves that come back are read off the steps on which they
left.  A face that lets go needs no search: as x goes to zero x^(3/2) loses its smoothness, so the steps shorten
towards that moment by themselves, and the crossing is read off the last one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.bench.reference.events import Course, faded, largest, loss
from uqsphere.bench.reference.steps import NODES, POINTS, TAIL, chebyshev, collocate
from uqsphere.mechanics.scene import Scene

__all__ = ["Problem", "Unaffordable", "follow", "problem_of"]

Array = npt.NDArray[Any]
Long = np.longdouble

#: forces below this share of the largest end the record on infinite bars
_TAIL_SHARE: Final = Long("0.01")
#: tail of the coefficients that the choice of the next step aims at
_AIM: Final = 0.1 * TAIL
#: reflections weaker than this are not worth a step's end
_FAINT: Final = 1e-19
#: what the largest state so far counts beside that of the step, when its error is judged
_MEMORY: Final = 0.01
_MOST_JUMPS: Final = 20_000


class Unaffordable(RuntimeError):
    """The scene needs more steps, or has more reflections, than the reference may take."""


@dataclass(frozen=True, kw_only=True)
class Problem:
    """One scene in scaled variables, theory (8) to (10), in extended precision.

    breaks (m + 1,), cubics (m, 4), frequency: the pulse.  trips, ends (2,): round trips and reflection
    coefficients of the bars.  record: its end, infinite for the rule of infinite bars.
    """

    mass: Any
    breaks: Array
    cubics: Array
    frequency: Any
    trips: Array
    ends: Array
    record: Any

    def pulse(self, times: Array) -> Array:
        """f_in at times that lie between two neighbouring breaks, ends included."""
        middle = 0.5 * (times[0] + times[-1])
        piece = int(np.searchsorted(self.breaks, middle, side="right")) - 1
        if piece >= len(self.cubics):
            return np.zeros_like(times)
        if self.frequency > 0.0:
            return np.asarray(np.sin(self.frequency * times))
        local = times - self.breaks[piece]
        c = self.cubics[piece]
        return np.asarray(c[0] + local * (c[1] + local * (c[2] + local * c[3])))

    @property
    def first_echo(self) -> Any:
        """Time at which the first reflected wave is back; infinite if none is."""
        return np.where(self.ends != 0.0, self.trips, Long(np.inf)).min()


def problem_of(scene: Scene, row: int) -> Problem:
    """One row of a scene in scaled variables, from its columns by the formulas of the theory."""
    c = {name: Long(column[row]) for name, column in scene.columns.items()}
    bar = (1 - c["bars.nu"] ** 2) / c["bars.E"]
    modulus = 1 / ((1 - c["sphere.nu"] ** 2) / c["sphere.E"] + (0 if scene.rigid_contact else bar))
    radius = 1 / (1 / c["sphere.radius"] + 1 / c.get("bars.end_radius", Long(np.inf)))
    pi = Long(4) * np.arctan(Long(1))
    impedance = np.sqrt(c["bars.density"] * c["bars.E"]) * pi * c["bars.diameter"] ** 2 / 4
    speed = c["striker.speed"]
    stiffness = modulus * np.sqrt(radius) * 4 / 3
    approach = (impedance * speed / (2 * stiffness)) ** (Long(2) / 3)
    time = 2 * approach / speed
    trips = scene.round_trips[row].astype(Long) / time
    ends = scene.reflections[row].astype(Long)
    pulse = scene.pulse
    return Problem(
        mass=4 * pi / 3 * c["sphere.radius"] ** 3 * c["sphere.density"] / (impedance * time),
        breaks=pulse.breaks[row].astype(Long) / time,
        cubics=pulse.coefficients[row].astype(Long) * time ** np.arange(4),
        frequency=Long(pulse.frequency[row]) * time,
        trips=np.where(ends != 0.0, trips, Long(np.inf)),
        ends=ends,
        record=Long(scene.record_end[row]) / time,
    )


def _jumps(problem: Problem, most: Any) -> list[tuple[Any, bool]]:
    """Ends of steps that are due before `most`: time, and whether a wave comes back there."""
    reach: list[list[Any]] = []
    for trip, end in zip(problem.trips, problem.ends, strict=True):
        weight, shift = 1.0, Long(0)
        shifts: list[Any] = []
        while weight > _FAINT and shift < most and len(shifts) < _MOST_JUMPS:
            shifts.append(shift)
            weight, shift = weight * abs(float(end)), shift + trip
        reach.append(shifts)
    if len(reach[0]) * len(reach[1]) > 50 * _MOST_JUMPS:
        raise Unaffordable("too many reflections")
    edges = [Long(0), *(edge for edge in problem.breaks[1:] if np.isfinite(edge))]
    times = sorted(
        (one + two + edge, bool(one + two > 0)) for one in reach[0] for two in reach[1] for edge in edges
        if 0 < one + two + edge < most
    )  # fmt: skip
    found: list[tuple[Any, bool]] = []
    for time, echo in times:
        if found and time - found[-1][0] < 1e-15 * time:
            found[-1] = (found[-1][0], found[-1][1] or echo)
        else:
            found.append((time, echo))
    if len(found) > _MOST_JUMPS:
        raise Unaffordable("too many reflections")
    return found


def _returning(course: Course, starts: list[Any], bar: int, times: Array, trip: Any) -> Array:
    """g_A (bar 0) or k_B (bar 1) one round trip before `times`."""
    left = times - trip
    span = left[-1] - left[0]
    inside = np.clip(left, left[0] + 1e-6 * span, left[-1] - 1e-6 * span)
    pieces = np.searchsorted(np.array(starts), inside, side="right") - 1
    values = np.empty_like(times)
    for index in np.unique(pieces):
        here = pieces == index
        piece = course.pieces[index]
        values[here] = chebyshev(piece.share(left[here])) @ piece.waves[:, bar]
    return values


def follow(problem: Problem, *, budget: int = 20_000) -> Course:
    """Integrate one scene over its record.

    Raises
    ------
    Unaffordable
        If that takes more than `budget` steps.
    """
    course = Course()
    starts: list[Any] = []
    jumps = _jumps(problem, min(problem.record, Long(1e9) if np.isinf(problem.record) else problem.record))
    shortest = problem.trips.min()
    pulse_end = problem.breaks[-1]
    time, state, sizes, power, at_jump = Long(0), np.zeros(3, dtype=Long), np.zeros(3, dtype=Long), 4, 0
    length = Long(1e-3) * min(Long(1), np.sqrt(problem.mass), problem.breaks[1])
    known = np.zeros(4, dtype=Long)
    refused, worst = 0, np.inf
    for _ in range(budget):
        jump, echo = jumps[at_jump] if at_jump < len(jumps) else (problem.record, False)
        left = jump - time
        length = min(length, shortest)
        length = left if length > 0.99 * left else (left / 2 if length > left / 2 else length)
        times = time + length * np.append(Long(0), POINTS) ** power
        push = np.zeros((NODES + 1, 2), dtype=Long)
        push[:, 0] = problem.pulse(times)
        for bar in range(2):
            if problem.ends[bar] != 0 and times[NODES // 2] > problem.trips[bar]:
                push[:, bar] += problem.ends[bar] * _returning(course, starts, bar, times, problem.trips[bar])
        guess = np.tile(state, (NODES, 1))
        if course.pieces and power == 1 and course.pieces[-1].power == 1 and length < 1.2 * course.pieces[-1].length:
            guess = chebyshev(course.pieces[-1].share(times[1:])) @ course.pieces[-1].states
        scales = _MEMORY * sizes
        if not course.pieces:  # face B follows face A at first with a power too high for any step
            scales = push[-1, 0] * np.array([length, length, Long(1)])
        piece = collocate(state, guess, push, time, length, power, problem.mass, scales)
        tail = np.inf if piece is None else piece.tail
        if piece is None or (tail > TAIL and not (refused > 3 and tail > 0.1 * worst and tail < 100 * TAIL)):
            refused, worst = refused + 1, tail
            length = length * max(0.1, min(0.7, (_AIM / tail) ** (power / NODES) if tail < 1.0 else 0.1))
            if length < 1e-18 * (1 + time):
                raise Unaffordable("the step has become too short")
            continue
        refused, worst = 0, np.inf
        course.end, course.lost = loss(course, piece, max(known[0], known[1]))
        course.tail = max(course.tail, tail)
        course.pieces.append(piece)
        starts.append(piece.start)
        known = largest(piece, course.end, known)
        course.x_max, course.difference, course.energy = max(known[0], known[1]), known[2], known[3]
        if time < problem.first_echo:
            course.x_first = course.x_max
        if course.lost is not None:
            return course
        if np.isinf(problem.record) and time >= pulse_end:
            gone = faded(piece, _TAIL_SHARE ** (Long(2) / 3) * course.x_max)
            if gone is not None:
                course.end = gone
                return course
        state = piece.states.sum(axis=0)
        sizes = np.maximum(sizes, np.abs(state))
        grown = length * min(3.0, 0.9 * (_AIM / piece.expected) ** (power / NODES))
        if length == left:
            if at_jump >= len(jumps):
                return course
            time, at_jump, power = jump, at_jump + 1, 2 if echo else 1
            length = grown if power == 1 else min(grown, 0.05 * grown)
        else:
            time, power, length = time + length, 1, grown
    raise Unaffordable(f"more than {budget} steps")
