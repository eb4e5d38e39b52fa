"""A second integrator of every scene, (9), (R3), (C14): a sphere with a partner at each pole; slow,
of another method.

SciPy's DOP853 with events follows faces that yield, part and touch again; waves that leave the
faces are kept at Chebyshev points of every step and come back from far ends.  The law of a face is
written out anew, answers are read off the steps.  Nothing is shared with the product but the
inputs.  Everything is scaled.
"""

from __future__ import annotations

import copy
import math
from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, minimize_scalar

from uqsphere.mechanics.scene import Scene

Array = npt.NDArray[np.float64]
SPRING, VIRGIN, FREE = range(3)
#: looks at a step, and Chebyshev points of a step with the weights of their polynomial
LOOKS: Final = 25
NODES: Final = 0.5 - 0.5 * np.cos(np.pi * np.arange(10) / 9.0)
_WEIGHTS: Final = np.array([0.5, *[(-1.0) ** k for k in range(1, 9)], -0.5])
#: reflections weaker than this are not worth a step's end; most jumps of a scene
_FAINT, _MOST_JUMPS = 1e-17, 20_000


class Unaffordable(RuntimeError):
    """The scene needs more steps, or has more reflections, than this integrator may take."""


@dataclass(kw_only=True)
class Law:
    """One face: onset x_y, b, C, factor of x^1.5; its state, largest approach and dent."""

    onset: float = 1e9
    b: float = 0.0
    pile_up: float = 1.0
    stiffness: float = 1.0
    state: int = SPRING
    largest: float = 0.0
    dent: float = 0.0
    spring: float = 1.0
    unloadings: int = 0
    pressed: bool = False

    def __post_init__(self) -> None:
        self.largest, self.spring = self.onset, self.stiffness

    def ratios(self, x: Any, m: Any = math) -> tuple[Any, Any, Any]:
        """L, A, W of (C5) to (C7) at x/x_y >= 1."""
        z, b, c = x / self.onset, self.b, self.pile_up
        y = m.sqrt(z)
        if b == 0.0:
            return 1 + 1.5 * (z - 1), 1 + c * (z - 1), 0.4 + (z - 1) + 0.75 * (z - 1) ** 2
        log = m.log1p((y - 1) / b)
        force = 1 + 1.5 * (1 + b) * (z - 1) - 3 * b * b * (y - 1 - (b - 1) * log)
        g = 5.0 if c == 1.0 else min(5.0, c * b * b / ((c - 1) * (1 + b)))
        area = 1 + c * (z - 1) - 2 * (c - 1) * g * (y - 1 - (g - 1) * m.log1p((y - 1) / g))
        rest = (z - (b - 1) ** 2) * log - (z - 1) / 2 + (b - 1) * (y - 1)
        work = 0.4 + (z - 1) + 0.75 * (1 + b) * (z - 1) ** 2
        return force, area, work - 3 * b * b * (2 / 3 * (z**1.5 - 1) - (z - 1) - (b - 1) * rest)

    def force(self, x: float) -> float:
        """q at x in the present state."""
        if self.state == FREE or x <= self.dent:
            return 0.0
        if self.state == SPRING:
            above = x - self.dent
            return self.spring * above * math.sqrt(above)
        return float(self.stiffness * self.onset**1.5 * self.ratios(max(x, self.onset))[0])

    def course(self, x: Array) -> tuple[Array, Array]:
        """q and the stored energy (C10) at approaches (n,) in the present state."""
        if self.state == VIRGIN:
            ratio, area, _ = self.ratios(np.maximum(x, self.onset), np)
            unit = self.stiffness * self.onset**1.5
            return unit * ratio, 0.4 * unit * self.onset * ratio**2 / np.sqrt(area)
        above = np.maximum(x - self.dent, 0.0) * (self.state == SPRING)
        return self.spring * above**1.5, 0.4 * self.spring * above**2.5

    def unload(self, x: float) -> None:
        """Virgin loading ends at x."""
        force, area, _ = self.ratios(x)
        self.largest, self.state = x, SPRING
        recovered = self.onset * force / math.sqrt(area)
        self.dent, self.spring = (
            x - recovered,
            self.stiffness * self.onset**1.5 * force / recovered**1.5,
        )
        self.unloadings += 1

    def plastic(self, x: float) -> float:
        """Work lost by a face pressed to x, (C12)."""
        if x <= self.onset:
            return 0.0
        force, area, work = self.ratios(x)
        return float(self.stiffness * self.onset**2.5 * (work - 0.4 * force**2 / math.sqrt(area)))

    def energy(self, x: float) -> float:
        """Stored and plastic at x."""
        reached = x if self.state == VIRGIN else self.largest
        return self.plastic(reached) + float(self.course(np.array([x]))[1][0])


@dataclass(kw_only=True)
class Pole:
    """What stands at a pole: zeta, mu_i (inf: does not move by itself), V_i(0), law of the face; of
    a bar the round trip and the reflection coefficient of its far end."""

    gives: float = 0.0
    mass: float = math.inf
    speed: float = 0.0
    law: Law | None = None
    trip: float = math.inf
    end: float = 0.0


#: a function of rows (6, n) of a piece
Kind = Callable[[Array], Array]


@dataclass(frozen=True, kw_only=True, eq=False)
class Piece:
    """A stretch of the motion in which no face changes its state, with looks at it.

    times (n,); rows (6, n) : x_A, x_B, q_A, q_B, stored energy, the larger approach above its dent.
    """

    sol: Callable[[Any], Array]
    laws: tuple[Law | None, Law | None]
    times: Array

    @cached_property
    def rows(self) -> Array:
        """Rows at the looks."""
        return self.at(self.times)

    def at(self, times: Array) -> Array:
        """Rows at times (n,): (6, n)."""
        x = self.sol(times)[:2]
        each = [
            law.course(x[k]) if law else (0.0 * times, 0.0 * times)
            for k, law in enumerate(self.laws)
        ]
        above = np.max([x[k] - law.dent for k, law in enumerate(self.laws) if law], axis=0)
        return np.stack([x[0], x[1], each[0][0], each[1][0], each[0][1] + each[1][1], above])

    def top(self, of: Kind, look: int) -> tuple[float, float]:
        """The largest value of a function of the rows about a look, and its time."""
        low, high = self.times[max(look - 1, 0)], self.times[min(look + 1, len(self.times) - 1)]
        close = minimize_scalar(
            lambda t: -float(of(self.at(np.array([t])))[0]),
            bounds=(low, high),
            method="bounded",
            options={"xatol": 1e-9 * (high - low)},
        )
        times = np.array([close.x, self.times[look]])
        values = of(self.at(times))
        return float(values.max()), float(times[int(values.argmax())])


@dataclass(kw_only=True)
class Motion:
    """A motion from first touch on: `end`, the face that let go first or None and when, when faces
    let go, the last state.

    state : x_A, x_B, u, U_A, U_B, integrals of zeta q² and of q at both faces, and of the work of
        incoming waves.
    """

    pieces: list[Piece] = field(default_factory=list)
    poles: tuple[Pole, Pole]
    end: float = 0.0
    lost: int | None = None
    first_loss: float = math.nan
    losses: list[float] = field(default_factory=list)
    state: Array = field(default_factory=lambda: np.zeros(10))
    steps: int = 0

    def top(self, of: Kind, until: float = math.inf) -> float:
        """Largest value of a function of the rows before a time."""
        return self.peak(of, until)[0]

    def peak(self, of: Kind, until: float = math.inf) -> tuple[float, Array]:
        """The largest value and the rows there, by golden sections about the best looks."""
        best, rows = -math.inf, np.zeros(6)
        looks = [
            (float(values[i]), i, piece)
            for piece, values in self._looks(of, until)
            for i in _tops(values)
        ]
        looks.sort(key=lambda look: -look[0])
        for value, i, piece in looks[:8]:
            if value < looks[0][0] - 1e-3 * abs(looks[0][0]):
                break
            found, time = piece.top(of, i)
            if found > best:
                best, rows = found, piece.at(np.array([time]))[:, 0]
        return best, rows

    def _looks(self, of: Kind, until: float) -> list[tuple[Piece, Array]]:
        return [
            (piece, of(piece.rows))
            for piece in self.pieces
            if piece.times[0] < until * (1.0 - 1e-12)
        ]

    def crossing(self, of: Kind, level: float, since: float = -math.inf) -> float:
        """First time from `since` on at which a function of the rows reaches a level; NaN if it
        never does.
        """
        for piece, values in self._looks(of, math.inf):
            later = piece.times >= since * (1.0 - 1e-14)
            # between two looks a top may be above the level, where one course falls as another
            # rises
            near = [
                i
                for i in _tops(values)
                if later[i] and level - 0.1 * abs(level) < values[i] < level
            ]
            tops = [(*piece.top(of, i), i) for i in near]
            found = [
                (time, piece.times[max(i - 1, 0)]) for value, time, i in tops if value >= level
            ]
            if (seen := np.flatnonzero((values >= level) & later)).size:
                found.append((piece.times[seen[0]], piece.times[max(seen[0] - 1, 0)]))
            if found:
                high, low = min(found)
                low = max(low, min(since, high))
                if of(piece.at(np.array([low])))[0] >= level:
                    return float(low)
                return float(
                    brentq(
                        lambda t, p=piece: of(p.at(np.array([t])))[0] - level, low, high, xtol=1e-15
                    )
                )
        return math.nan


def _tops(values: Array) -> Any:
    """Places of local maxima, ends included."""
    around = np.concatenate([[-math.inf], values, [-math.inf]])
    return np.flatnonzero((values >= around[:-2]) & (values >= around[2:]))


def _still(t: float, middle: float) -> float:
    return 0.0


def march(
    mu: float,
    speed: float,
    poles: tuple[Pole, Pole],
    *,
    pulse: Callable[[float, float], float] = _still,
    jumps: list[float] | None = None,
    record: float = 1e4,
    stop: str = "parting",
    fade: float = math.inf,
    budget: int = 20_000,
    rtol: float = 1e-11,
) -> Motion:
    """Integrate one scene.  Between bars mu = 0 is the massless sphere: one force at both faces,
    and the approach of each grows by half of what the bars' ends close.

    pulse : incoming wave at A, of the time and of a time inside of the step; jumps : where steps
        end.
    stop : "loss" of the first face, "parting" for good, or "end" of the record.
    fade : from here on the motion also ends where both forces stay below 1 % of the largest.

    Raises Unaffordable for more than `budget` steps.
    """
    a, b = poles
    motion, laws = Motion(poles=poles), [pole.law for pole in poles]
    y, time, calls, peak = np.zeros(10), 0.0, 0, 0.0
    y[2:5] = speed, a.speed, b.speed
    starts, lengths, waves = [], [], []
    middle = 0.0

    def back(k: int, t: float) -> float:
        """What the far end of bar k sends back at t: the wave that left its face one round trip
        before.
        """
        pole = poles[k]
        if pole.end == 0.0 or middle <= pole.trip:
            return 0.0
        n = bisect_right(starts, t - pole.trip + 1e-9 * (middle - t)) - 1
        off = (t - pole.trip - starts[n]) / lengths[n] - NODES
        if (off == 0.0).any():
            return pole.end * float(waves[n][k][off == 0.0][0])
        share = _WEIGHTS / off
        return pole.end * float(share @ waves[n][k] / share.sum())

    def rates(t: float, y: Array) -> tuple[float, ...]:
        nonlocal calls
        calls += 1
        if calls > 16 * budget:
            raise Unaffordable(f"more than {budget} steps")
        q, r = (law.force(y[k]) if law else 0.0 for k, law in enumerate(laws))
        ahead, behind = pulse(t, middle) + back(0, t), back(1, t)
        if mu == 0.0:
            closes = ahead - behind - q
            return (closes, closes, 0.0, 0.0, 0.0, q * q, q * q, q, q, 2.0 * q * (ahead - behind))
        return (
            y[3] + 2.0 * ahead - a.gives * q - y[2] if a.law else 0.0,
            y[2] - b.gives * r - 2.0 * behind - y[4] if b.law else 0.0,
            (q - r) / mu,
            -q / a.mass,
            r / b.mass,
            a.gives * q * q,
            b.gives * r * r,
            q,
            r,
            2.0 * (q * ahead - r * behind),
        )

    for until in [*(jump for jump in jumps or [] if jump < record), record]:
        while time < until:
            middle = 0.5 * (time + until)
            now = rates(time, y)
            for k, law in enumerate(laws):
                if law and law.state == VIRGIN and now[k] < -1e-10:
                    law.unload(float(y[k]))
                elif (
                    law
                    and law.state == SPRING
                    and now[k] > 1e-10
                    and y[k] >= law.largest * (1 - 1e-12)
                ):
                    law.state = VIRGIN
            ahead, behind = pulse(time, middle) + back(0, time), back(1, time)
            closing = max(
                (y[3] + 2.0 * ahead - y[2]) * (a.law is not None),
                (y[2] - 2.0 * behind - y[4]) * (b.law is not None),
            )
            apart = all(law is None or y[k] <= law.dent + 1e-13 for k, law in enumerate(laws))
            if stop == "parting" and time > 0.0 and apart and closing <= 1e-13:
                return _ended(motion, time, y, calls)
            events, meanings = _events(rates, laws)
            if time >= fade:
                peak = max(peak, motion.top(lambda rows: rows[2:4].max(axis=0)))
                events.append(_faded(laws, 0.9 * peak))
            with np.errstate(all="ignore"):
                way = solve_ivp(
                    rates,
                    (time, until),
                    y,
                    method="DOP853",
                    rtol=rtol,
                    atol=1e-4 * rtol,
                    events=events,
                    first_step=min(1e-6, until - time),
                    dense_output=True,
                )
            if way.status < 0:
                raise Unaffordable(way.message)
            time, y, met = float(way.t[-1]), way.y[:, -1].copy(), []
            if way.status == 1:
                met = [
                    meaning
                    for meaning, seen in zip(meanings, way.t_events, strict=False)
                    if len(seen) and abs(seen[-1] - time) <= 1e-13 * (1 + time)
                ]
            faded = way.status == 1 and not met
            if mu == 0.0:  # of two events at one time SciPy tells the first
                met = [(k, what) for k in (0, 1) for _, what in met[:1]]
            times = np.unique(
                np.concatenate([np.linspace(t, u, LOOKS) for t, u in pairwise(way.t)])
            )
            for k, law in enumerate(laws):  # a fall that is over before the end of a step
                if law and law.state == SPRING and law.pressed:
                    gap = way.sol(times)[k] - law.dent
                    pressed = np.maximum.accumulate(gap[:-1]) > 1e-6 * gap.max()
                    low = np.flatnonzero((gap[1:] < -1e-12 * gap.max()) & pressed) + 1
                    if len(low) and times[low[0]] < time:
                        ends = times[low[0] - 1], times[low[0]]
                        time = float(
                            brentq(
                                lambda t, k=k, law=law, sol=way.sol: sol(t)[k] - law.dent,
                                *ends,
                                xtol=1e-15,
                            )
                        )
                        times, y, met, faded = (
                            np.append(times[times < time], time),
                            way.sol(time),
                            [(k, "lost")] if mu > 0.0 else [(0, "lost"), (1, "lost")],
                            False,
                        )
            motion.pieces.append(
                Piece(sol=way.sol, laws=(copy.copy(laws[0]), copy.copy(laws[1])), times=times)
            )
            if a.end != 0.0 or b.end != 0.0:
                for t, u in pairwise([*way.t[way.t < time], time]):
                    at = t + (u - t) * NODES
                    x = way.sol(at)
                    q, r = (law.course(x[k])[0] if law else 0.0 * at for k, law in enumerate(laws))
                    ahead_of = np.array([pulse(s, 0.5 * (t + u)) + back(0, s) for s in at])
                    waves.append(
                        (ahead_of - a.gives * q, np.array([back(1, s) for s in at]) + b.gives * r)
                    )
                    starts.append(t)
                    lengths.append(u - t)
            for k, what in met:
                law = laws[k]
                assert law is not None
                if what == "lost":
                    motion.losses.append(time)
                    if motion.lost is None:
                        motion.lost, motion.first_loss = k, time
                    if stop == "loss":
                        return _ended(motion, time, y, calls)
                    law.state, y[k] = FREE, law.dent
                elif what == "touches":
                    law.state, y[k] = SPRING, law.dent
                elif what == "yields":
                    law.state, y[k] = VIRGIN, law.largest
                else:
                    law.unload(float(y[k]))
            if faded:
                return _ended(motion, time, y, calls)
    return _ended(motion, record, y, calls)


def _ended(motion: Motion, time: float, y: Array, calls: int) -> Motion:
    motion.end, motion.state, motion.steps = time, y, calls // 16
    return motion


def _events(rates: Any, laws: list[Law | None]) -> tuple[list[Any], list[tuple[int, str]]]:
    """Events of the faces in their states, and what each means for which face."""
    events: list[Any] = []
    meanings = []

    def add(k: int, what: str, direction: int, value: Any) -> None:
        value.direction, value.terminal = direction, True
        events.append(value)
        meanings.append((k, what))

    for k, law in enumerate(laws):
        if law is None:
            continue
        if law.state == VIRGIN:
            add(k, "turns", -1, lambda t, y, k=k: rates(t, y)[k])
        elif law.state == FREE:
            add(k, "touches", 1, lambda t, y, k=k, dent=law.dent: y[k] - dent)
        else:
            add(k, "yields", 1, lambda t, y, k=k, over=law.largest * (1 + 1e-13): y[k] - over)
            add(k, "lost", -1, lambda t, y, k=k, law=law: _above(law, y[k], max(y[0], y[1])))
    return events, meanings


def _above(law: Law, x: float, largest: float) -> float:
    """Approach above the dent of a face that was pressed; 1 of one that was not yet."""
    law.pressed = law.pressed or x - law.dent > max(1e-9 * abs(largest), 1e-11)
    return x - law.dent if law.pressed else 1.0


def _faded(laws: list[Law | None], peak: float) -> Any:
    """The event that both approaches above the dents are below what 1 % of a force takes."""
    level = quiet(laws, peak)

    def above(t: float, y: Array) -> float:
        return max(y[k] - law.dent for k, law in enumerate(laws) if law) - level

    above.terminal, above.direction = True, -1  # type: ignore[attr-defined]
    return above


def quiet(laws: Any, peak: float) -> float:
    """Approach above the dents below which no force can be more than 1 % of the largest: the
    stiffer face's.
    """
    return float((0.01 * peak / max(law.spring for law in laws if law)) ** (2.0 / 3.0))


# --- a row of a scene of two bars, and its answers in SI


@dataclass(frozen=True, kw_only=True)
class Reference:
    """Answers of one row [SI]; `censored` for time_to_first_loss; steps taken."""

    values: Mapping[str, float]
    censored: Mapping[str, bool]
    steps: int
    motion: Motion


def jumps_of(edges: list[float], trips: list[float], ends: list[float], most: float) -> list[float]:
    """Times before `most` at which a pulse, or a reflection of it, jumps or bends."""
    reach: list[list[float]] = []
    for trip, end in zip(trips, ends, strict=True):
        weight, shifts = 1.0, [0.0]
        while (
            end != 0.0
            and weight * abs(end) > _FAINT
            and shifts[-1] + trip < most
            and len(shifts) < _MOST_JUMPS
        ):
            weight *= abs(end)
            shifts.append(shifts[-1] + trip)
        reach.append(shifts)
    if len(reach[0]) * len(reach[1]) * len(edges) > _MOST_JUMPS:
        raise Unaffordable("too many reflections")
    times = sorted(one + two + edge for one in reach[0] for two in reach[1] for edge in edges)
    kept = [time for before, time in pairwise([0.0, *times]) if time - before > 1e-13 * time]
    return [time for time in kept if 0.0 < time < most]


def refer(
    scene: Scene,
    row: int = 0,
    *,
    until: float = math.inf,
    budget: int = 20_000,
    rtol: float = 1e-11,
    massless: bool = False,
) -> Reference:
    """Answers of one row of a scene of two bars, by the formulas of the theory.

    until : end of a record [s] that goes on behind the first loss of contact; without it the record
        ends at the first loss.
    massless : whether mu = 0.

    Raises ValueError for a row outside the domain, Unaffordable for one that takes more than
        `budget` steps.
    """
    if scene.status[row] != 0:
        raise ValueError(f"row {row} lies outside the domain of the model")
    c = {name: float(column[row]) for name, column in scene.columns.items()}
    bar = 0.0 if scene.rigid_contact else (1 - c["bars.nu"] ** 2) / c["bars.E"]
    modulus = 1 / ((1 - c["sphere.nu"] ** 2) / c["sphere.E"] + bar)
    radius = 1 / (1 / c["sphere.radius"] + 1 / c.get("bars.end_radius", math.inf))
    mass = 4 * math.pi / 3 * c["sphere.radius"] ** 3 * c["sphere.density"]
    impedance = math.sqrt(c["bars.density"] * c["bars.E"]) * math.pi * c["bars.diameter"] ** 2 / 4
    force = 0.5 * impedance * c["striker.speed"]
    unit = (force / (4 / 3 * modulus * math.sqrt(radius))) ** (2 / 3)
    second = 2 * unit / c["striker.speed"]

    def hertz(x: float) -> float:
        return 2 / math.pi * modulus * math.sqrt(unit * x / radius)

    yields = scene.contact_law == "plastic"
    p_y = c["contact.onset_pressure"] if yields else hertz(1e9)
    hardness, pile_up = (c["contact.hardness"], c["contact.pile_up"]) if yields else (p_y, 1.0)
    softening = pile_up * hardness / p_y - 1.0
    law = Law(
        onset=radius * (math.pi * p_y / (2 * modulus)) ** 2 / unit,
        b=softening if softening > 1e-12 else 0.0,
        pile_up=pile_up,
    )
    trips, ends = (
        [float(t) / second for t in scene.round_trips[row]],
        [float(e) for e in scene.reflections[row]],
    )
    poles = tuple(
        Pole(gives=1.0, law=copy.copy(law), trip=trip, end=end)
        for trip, end in zip(trips, ends, strict=True)
    )
    breaks = scene.pulse.breaks[row] / second
    cubics, frequency = (
        scene.pulse.coefficients[row] * second ** np.arange(4),
        float(scene.pulse.frequency[row]),
    )

    def pulse(t: float, middle: float) -> float:
        piece = bisect_right(breaks, middle) - 1
        if piece >= len(cubics):
            return 0.0
        if frequency > 0.0:
            return math.sin(frequency * second * t)
        z, k = t - breaks[piece], cubics[piece]
        return float(k[0] + z * (k[1] + z * (k[2] + z * k[3])))

    record = min(float(scene.record_end[row]), until) / second
    endless = math.isinf(record)
    jumps = jumps_of(
        [0.0, *(float(edge) for edge in breaks[1:] if math.isfinite(edge))],
        trips,
        ends,
        min(record, 1e9),
    )
    motion = march(
        0.0 if massless else float(mass / (impedance * second)),
        0.0,
        (poles[0], poles[1]),
        pulse=pulse,
        jumps=jumps,
        record=min(record, 1e9),
        stop="loss" if math.isinf(until) else "end",
        fade=float(breaks[-1]) if endless else math.inf,
        budget=budget,
        rtol=rtol,
    )

    def larger(rows: Array) -> Array:
        return np.maximum(rows[2], rows[3])

    def peak_of(x: float) -> dict[str, float]:
        """Centre pressure, a² over r_eff alpha_c, dent and plastic work of a face pressed to x,
        (C8), (C11), (C12).
        """
        if x <= law.onset:
            return {
                "centre": p_y * math.sqrt(x / law.onset),
                "dent": 0.0,
                "plastic": 0.0,
                "area": x,
            }
        ratio, area, _ = law.ratios(x)
        mean = 2.0 / 3.0 * p_y * ratio / area
        rest = (hardness - mean) * (hardness - p_y) / (hardness - 2.0 / 3.0 * p_y)
        return {
            "centre": hardness - rest,
            "area": area * law.onset,
            "plastic": law.plastic(x),
            "dent": x - law.onset * ratio / math.sqrt(area),
        }

    top, end, lost = motion.top(larger), motion.end, motion.lost
    level = quiet([pole.law for pole in poles], top)
    faded = (
        motion.crossing(lambda rows: -rows[5], -level, since=float(breaks[-1]))
        if endless
        else math.nan
    )
    if not math.isnan(faded):
        end, lost = faded, None
    echo = min(
        [trip for trip, reflects in zip(trips, ends, strict=True) if reflects != 0.0],
        default=math.inf,
    )
    deepest = [motion.top(lambda rows, k=k: rows[k]) for k in (0, 1)]
    early = max(motion.top(lambda rows, k=k: rows[k], echo) for k in (0, 1))
    parts = [peak_of(x) for x in deepest]
    # a difference counts up to the first loss of contact after the largest force
    topmost = motion.crossing(larger, (1.0 - 1e-9) * top)
    counted = min((at for at in motion.losses if at > topmost), default=math.inf)
    if scene.whole_record:
        counted = math.inf
    apart = motion.top(lambda rows: np.abs(rows[2] - rows[3]), counted)
    rise = second * (motion.crossing(larger, 0.9 * top) - motion.crossing(larger, 0.1 * top))
    energy = force * unit * motion.top(lambda rows: rows[4])
    values = {
        "p_max": max(part["centre"] for part in parts),
        "P_max": force * top,
        "alpha_max": unit * max(deepest),
        "dent": unit * max(part["dent"] for part in parts),
        "plastic_work": force * unit * sum(part["plastic"] for part in parts),
        "time_to_first_loss": second * (end if lost is None else motion.first_loss),
        "rise_time": rise,
        "loading_rate": 0.8 * force * top / rise,
        "first_peak": peak_of(early)["centre"],
        "force_imbalance": apart / top,
        "energy": energy,
        "specific_energy": energy / mass,
        "a_max": math.sqrt(radius * unit * max(part["area"] for part in parts)),
    }
    return Reference(
        values=values,
        censored={"time_to_first_loss": lost is None},
        steps=motion.steps,
        motion=motion,
    )
