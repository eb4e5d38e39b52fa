"""A second integrator of one scene, (R3): a sphere with a partner at each pole; DOP853 with events, slow.

`strike` follows the table of states (C14) face by face, carries along what partners of an impedance take off, so that
the balances of energy and momentum (R8), (R9) can be held against it, and ends where the bodies part.  `strike_rod` has
the echoes of a rod ahead, with elastic faces: round trip by round trip, each with what the ones before sent back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

from tests.independent.yielding import FREE, SPRING, VIRGIN, Law


@dataclass(kw_only=True)
class Pole:
    """What stands at a pole, scaled: zeta, mu_i (inf: does not move by itself), V_i(0), the law of the face."""

    gives: float = 0.0
    mass: float = math.inf
    speed: float = 0.0
    law: Law | None = None


@dataclass(kw_only=True)
class Blow:
    """Answers of `strike`, of faces (A, B) where there are two; scaled."""

    parting: float
    first_loss: float
    speeds: np.ndarray
    impulse: np.ndarray
    carried: np.ndarray
    largest: list[float] = field(default_factory=lambda: [0.0, 0.0])
    force: list[float] = field(default_factory=lambda: [0.0, 0.0])
    other: list[float] = field(default_factory=lambda: [0.0, 0.0])
    losses: int = 0
    mean: float = 0.0
    difference: float = 0.0


# state: x_A, x_B, u, U_A, U_B, then the integrals of zeta q² and of q at both faces
def _rates(mu: float, poles: list[Pole]) -> Any:
    def rates(t: float, y: np.ndarray) -> list[float]:
        q = [pole.law.force(y[k]) if pole.law else 0.0 for k, pole in enumerate(poles)]
        a, b = poles
        return [
            y[3] - a.gives * q[0] - y[2] if a.law else 0.0,
            y[2] - b.gives * q[1] - y[4] if b.law else 0.0,
            (q[0] - q[1]) / mu,
            -q[0] / a.mass,
            q[1] / b.mass,
            a.gives * q[0] ** 2,
            b.gives * q[1] ** 2,
            q[0],
            q[1],
        ]

    return rates


def _events(rates: Any, poles: list[Pole], begin: float) -> tuple[list[Any], list[tuple[int, str]]]:
    events, meanings = [], []

    def add(k: int, what: str, direction: int, value: Any) -> None:
        value.direction, value.terminal = direction, True
        events.append(value)
        meanings.append((k, what))

    for k, pole in enumerate(poles):
        law = pole.law
        if law is None:
            continue
        if law.state == VIRGIN:
            add(k, "turns", -1, lambda t, y, k=k: rates(t, y)[k])
            continue
        if law.state == FREE:
            add(k, "touches", 1, lambda t, y, k=k, dent=law.dent: y[k] - dent if t > begin + 1e-12 else -1.0)
            continue
        over = law.largest * (1 + 1e-13)
        add(k, "yields", 1, lambda t, y, k=k, over=over: y[k] - over if over < math.inf else -1.0)
        add(k, "lost", -1, lambda t, y, k=k, dent=law.dent: y[k] - dent if t > begin + 1e-7 else 1.0)
    return events, meanings


def strike(mu: float, speed: float, poles: list[Pole], rtol: float = 1e-12, horizon: float = 1e4) -> Blow:
    """Integrate (R3) from first touch to parting."""
    y = np.array([0.0, 0.0, speed, poles[0].speed, poles[1].speed, 0.0, 0.0, 0.0, 0.0])
    found, time, first = Blow(parting=math.nan, first_loss=math.nan, speeds=y, impulse=y, carried=y), 0.0, math.nan
    rates = _rates(mu, poles)

    def forces(state: np.ndarray) -> list[float]:
        return [pole.law.force(state[k]) if pole.law else 0.0 for k, pole in enumerate(poles)]

    def note(way: Any) -> None:
        """Largest values along a piece of the way: at a few points of every step, then closely around the best."""
        grid = np.unique(np.concatenate([np.linspace(a, b, 9) for a, b in pairwise(way.t)]))
        q = np.array([forces(state) for state in way.sol(grid).T])
        tops = {"A": lambda q: q[0], "B": lambda q: q[1], "mean": lambda q: 0.5 * (q[0] + q[1]),
                "difference": lambda q: abs(q[0] - q[1])}  # fmt: skip
        for name, top in tops.items():
            best = int(np.argmax(top(q.T)))
            low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
            close = minimize_scalar(lambda t, top=top: -top(forces(way.sol(t))), bounds=(low, high), method="bounded",
                                    options={"xatol": 1e-9 * (high - low)})  # fmt: skip
            at = max((grid[best], float(close.x), low, high), key=lambda t: top(forces(way.sol(t))))
            state = way.sol(at)
            now = forces(state)
            if name in ("mean", "difference"):
                setattr(found, name, max(getattr(found, name), top(now)))
            elif top(now) > found.force["AB".index(name)]:
                k = "AB".index(name)
                found.force[k], found.other[k], found.largest[k] = now[k], now[1 - k], float(state[k])

    while time < horizon:
        for k, pole in enumerate(poles):
            law, now = pole.law, rates(time, y)[k]
            if law and law.state == VIRGIN and now < -1e-10:
                law.unload(y[k])
            elif law and law.state == SPRING and now > 1e-10 and y[k] >= law.largest * (1 - 1e-12):
                law.state = VIRGIN
        open_ = [pole.law is None or y[k] <= pole.law.dent + 1e-13 for k, pole in enumerate(poles)]
        gaps = [_rates(mu, [Pole(**{**vars(p), "law": p.law and Law(onset=1e9, b=1.0, pile_up=1.0)}) for p in poles])(
            time, np.where(np.arange(9) < 2, -1.0, y))[k] for k in range(2)]  # fmt: skip
        if time > 0.0 and all(open_) and max(gaps) <= 1e-13:
            break
        events, meanings = _events(rates, poles, time)
        way = solve_ivp(rates, (time, horizon), y, method="DOP853", rtol=rtol, atol=rtol * 1e-2, events=events,
                        first_step=1e-6, dense_output=True)  # fmt: skip
        note(way)
        time, y = float(way.t[-1]), way.y[:, -1].copy()
        if way.status != 1:
            break
        for (k, what), times in zip(meanings, way.t_events, strict=True):
            if not len(times) or abs(times[-1] - time) > 1e-13 * (1 + time):
                continue
            law = poles[k].law
            if what == "lost":
                law.state, y[k] = FREE, law.dent
                found.losses += 1
                first = time if math.isnan(first) else first
            elif what == "touches":
                law.state, y[k] = SPRING, law.dent
            elif what == "yields":
                law.state, y[k] = VIRGIN, law.largest
            else:
                law.unload(y[k])
    found.parting, found.first_loss = time, first
    found.speeds, found.carried, found.impulse = y[2:5], y[5:7], y[7:9]
    return found


def strike_rod(
    mu: float,
    start: tuple[float, float],
    weight: float,
    zeta: float,
    kappa: float,
    echo: tuple[float, float],
    end: float,
) -> tuple[list[float], float, np.ndarray]:
    """A blow on a rod of finite length: largest q at A and B, first loss of contact, (x_A, x_B, u, U_A) at `end`.

    start: speeds of sphere and weight; weight: mu_A, inf where nothing stands at A; echo: round trip and reflection.
    """
    trip, reflection = echo
    pieces: list[Any] = []

    def returned(t: float, n: int) -> float:
        """What the far end sends back in round trip n: h(t) = R (zeta q_B + h)(t - T)."""
        if n == 0:
            return 0.0
        push = kappa * max(pieces[n - 1](t - trip)[1], 0.0) ** 1.5
        return reflection * (zeta * push + returned(t - trip, n - 1))

    def rates(t: float, y: np.ndarray) -> list[float]:
        a, b = max(y[0], 0.0) ** 1.5, kappa * max(y[1], 0.0) ** 1.5
        there = 0.0 if math.isinf(weight) else 1.0
        return [
            there * (y[3] - y[2]),
            y[2] - zeta * b - 2.0 * returned(t, len(pieces)),
            (there * a - b) / mu,
            -there * a / weight,
        ]

    losses = [lambda t, y, k=k: y[k] if t > 1e-3 else 1.0 for k in ((1,) if math.isinf(weight) else (0, 1))]
    for loss in losses:
        loss.direction = -1  # type: ignore[attr-defined]
    state, largest, first = np.array([0.0, 0.0, *start]), [0.0, 0.0], math.inf
    for begin in np.arange(0.0, end, trip):
        until = min(begin + trip, end)
        way = solve_ivp(rates, (begin, until), state, method="DOP853", rtol=1e-11, atol=1e-14, events=losses,
                        dense_output=True, max_step=0.02)  # fmt: skip
        pieces.append(way.sol)
        state = way.y[:, -1]
        first = min([first, *(float(times[0]) for times in way.t_events if len(times))])
        fine = way.sol(np.linspace(begin, until, 20_001))
        for k, factor in enumerate((1.0, kappa)):
            largest[k] = max(largest[k], factor * float(np.maximum(fine[k], 0.0).max()) ** 1.5)
    return largest, first, state
