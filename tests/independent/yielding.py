"""A second integrator of faces that yield: DOP853 with events, for infinite bars; slow, and of another method.

It follows the table of states (C14) face by face, with the closed forms of the law written out anew, and carries the
work of the bar ends along, so that the balance of energy (C15) can be held against it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

SPRING, VIRGIN, FREE = range(3)


@dataclass(kw_only=True)
class Law:
    """One face, scaled: onset x_y, b, C, factor of x^1.5; its state, largest approach and dent."""

    onset: float
    b: float
    pile_up: float
    stiffness: float = 1.0
    state: int = SPRING
    largest: float = 0.0
    dent: float = 0.0
    spring: float = 1.0
    unloadings: int = 0

    def __post_init__(self) -> None:
        self.largest, self.spring = self.onset, self.stiffness

    def ratios(self, x: float) -> tuple[float, float, float]:
        """L, A, W of (C5) to (C7) at x/x_y >= 1."""
        z, b, c = x / self.onset, self.b, self.pile_up
        y = math.sqrt(z)
        if b == 0.0:
            return 1 + 1.5 * (z - 1), 1 + c * (z - 1), 0.4 + (z - 1) + 0.75 * (z - 1) ** 2
        log = math.log1p((y - 1) / b)
        force = 1 + 1.5 * (1 + b) * (z - 1) - 3 * b * b * (y - 1 - (b - 1) * log)
        g = 5.0 if c == 1.0 else min(5.0, c * b * b / ((c - 1) * (1 + b)))
        area = 1 + c * (z - 1) - 2 * (c - 1) * g * (y - 1 - (g - 1) * math.log1p((y - 1) / g))
        rest = (z - (b - 1) ** 2) * log - (z - 1) / 2 + (b - 1) * (y - 1)
        work = 0.4 + (z - 1) + 0.75 * (1 + b) * (z - 1) ** 2
        return force, area, work - 3 * b * b * (2 / 3 * (z**1.5 - 1) - (z - 1) - (b - 1) * rest)

    def force(self, x: float) -> float:
        """q at x in the present state."""
        if self.state == FREE or x <= self.dent:
            return 0.0
        if self.state == SPRING:
            return self.spring * (x - self.dent) ** 1.5
        return self.stiffness * self.onset**1.5 * self.ratios(max(x, self.onset))[0]

    def unload(self, x: float) -> None:
        """Virgin loading ends at x."""
        force, area, _ = self.ratios(x)
        self.largest, self.state = x, SPRING
        recovered = self.onset * force / math.sqrt(area)
        self.dent, self.spring = x - recovered, self.stiffness * self.onset**1.5 * force / recovered**1.5
        self.unloadings += 1

    def energy(self, x: float) -> float:
        """Stored and plastic, over P_0 alpha_c."""
        reached = x if self.state == VIRGIN else self.largest
        if reached == self.onset:
            return self.stiffness * 0.4 * max(x, 0.0) ** 2.5
        force, area, work = self.ratios(reached)
        unit = self.stiffness * self.onset**2.5
        plastic = unit * (work - 0.4 * force**2 / math.sqrt(area))
        stored = 0.4 * self.force(x) * (x - self.dent)
        if self.state == VIRGIN:
            stored = 0.4 * unit * force**2 / math.sqrt(area)
        return plastic + stored


@dataclass(kw_only=True)
class Course:
    """Where a scene ended: time, faces, the work of the bars, what is in the sphere, and the largest forces."""

    time: float
    faces: list[Law]
    work: float
    energy: float
    largest: list[float] = field(default_factory=list)


def follow(
    mu: float,
    pulse: Callable[[float], float],
    breaks: list[float],
    horizon: float,
    faces: list[Law],
    rtol: float = 1e-12,
) -> Course:
    """Integrate (9) with faces that yield from rest to the first loss of contact, or to the horizon."""
    state = np.zeros(4)
    largest = [0.0, 0.0]
    ends = [*sorted(t for t in breaks if 0.0 < t < horizon), horizon]
    for begin, end in pairwise([0.0, *ends]):
        time = begin
        while time < end:
            rates = _rates(mu, pulse, faces)
            now = rates(0.5 * (time + min(end, time + 1e-9)), state)
            for k, face in enumerate(faces):
                if face.state == VIRGIN and now[k] < -1e-10:
                    face.unload(state[k])
                elif face.state == SPRING and now[k] > 1e-10 and state[k] >= face.largest * (1 - 1e-12):
                    face.state = VIRGIN
            events, meanings = _events(mu, pulse, faces)
            way = solve_ivp(
                _rates(mu, pulse, faces), (time, end), state, method="DOP853", rtol=rtol, atol=rtol * 1e-2,
                events=events, first_step=min(1e-6, end - time),
            )  # fmt: skip
            for k in range(2):
                largest[k] = max(largest[k], float(way.y[k].max()))
            time, state = float(way.t[-1]), way.y[:, -1].copy()
            if way.status != 1:
                break
            met = next(i for i, found in enumerate(way.t_events) if len(found))
            k, what = meanings[met]
            if what == "lost":
                return Course(time=time, faces=faces, work=state[3], energy=_inside(mu, faces, state), largest=largest)
            if what == "yields":
                faces[k].state = VIRGIN
                state[k] = faces[k].largest
            else:
                faces[k].unload(state[k])
    return Course(time=horizon, faces=faces, work=state[3], energy=_inside(mu, faces, state), largest=largest)


def _inside(mu: float, faces: list[Law], state: np.ndarray) -> float:
    return 0.5 * mu * state[2] ** 2 + sum(face.energy(state[k]) for k, face in enumerate(faces))


def _rates(mu, pulse, faces):
    def rates(t, y):
        q = [face.force(y[k]) for k, face in enumerate(faces)]
        wave = pulse(t)
        work = q[0] * (2 * wave - q[0]) - q[1] * q[1]
        return [2 * wave - q[0] - y[2], y[2] - q[1], (q[0] - q[1]) / mu, work]

    return rates


def _events(mu, pulse, faces):
    rates = _rates(mu, pulse, faces)
    events, meanings = [], []
    for k, face in enumerate(faces):
        if face.state == SPRING:
            # armed a little above the largest approach: a turn leaves the state there
            over = face.largest * (1 + 1e-13)
            events.append(lambda t, y, k=k, over=over: y[k] - over)
            events[-1].direction = 1
            meanings.append((k, "yields"))
            events.append(lambda t, y, k=k, dent=face.dent: y[k] - dent if t > 1e-6 else 1.0)
            events[-1].direction = -1
            meanings.append((k, "lost"))
        elif face.state == VIRGIN:
            events.append(lambda t, y, k=k: rates(t, y)[k])
            events[-1].direction = -1
            meanings.append((k, "turns"))
    for event in events:
        event.terminal = True
    return events, meanings
