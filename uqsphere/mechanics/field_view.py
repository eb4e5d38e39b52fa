"""What a picture of the bars over place and time shows: how far it goes, the stress on a grid, and the fronts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.field import Tension, field_grid, first_tension
from uqsphere.mechanics.history import History
from uqsphere.mechanics.waves import BARS

__all__ = ["FieldView", "extent", "shown_time", "view_field"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class FieldView:
    """Stress in both bars over place and time, and what is needed to draw the fronts over it.

    Attributes
    ----------
    reach : (float, float)
        Length of the incident and of the receiving bar that is shown [m].
    begin, last : float
        First and last instant [s] since first touch.
    stress : (t, x) array
        Axial stress [Pa], tension positive, at the middles of an even grid over [begin, last] and [-reach, reach].
    wave_speed, pulse_end, record_end : float
        Speed of the waves [m/s], end of the pulse (infinite for a step) and end of the record [s].
    returns : (float, float)
        After what time a wave that leaves the sphere is back from the far end of each bar [s]; infinite if never.
    tensions : tuple of Tension
        Where and when each bar that sees any is first under tension.
    """

    reach: tuple[float, float]
    begin: float
    last: float
    stress: Array
    wave_speed: float
    pulse_end: float
    record_end: float
    returns: tuple[float, float]
    tensions: tuple[Tension, ...]

    @property
    def places(self) -> Array:
        """(x,) places [m] along the bars, the sphere at 0: between them, which is itself no bar."""
        left, right = self.reach
        edges = np.linspace(-left, right, self.stress.shape[1] + 1)
        return np.asarray(0.5 * (edges[1:] + edges[:-1]))

    @property
    def times(self) -> Array:
        """(t,) instants [s]."""
        count = self.stress.shape[0]
        return np.asarray(self.begin + (np.arange(count) + 0.5) / count * (self.last - self.begin))

    def as_document(self) -> dict[str, Any]:
        """As JSON: the stress in whole kilopascals, a text an instant; what is infinite as null."""
        return {
            "reach": list(self.reach),
            "begin": self.begin,
            "last": self.last,
            "stress_kpa": [" ".join(f"{value:.0f}" for value in row * 1e-3) for row in self.stress],
            "wave_speed": self.wave_speed,
            "pulse_end": self.pulse_end if math.isfinite(self.pulse_end) else None,
            "record_end": self.record_end,
            "returns": [value if math.isfinite(value) else None for value in self.returns],
            "tensions": [{"bar": one.bar, "position": one.position, "time": one.time} for one in self.tensions],
        }

    @classmethod
    def from_document(cls, found: Mapping[str, Any]) -> FieldView:
        """The view of `as_document`.

        Raises
        ------
        ValueError, KeyError, TypeError, AttributeError
            For what it did not write.
        """
        left, right = (float(value) for value in found["reach"])
        one, two = (math.inf if value is None else float(value) for value in found["returns"])
        view = cls(
            reach=(left, right),
            begin=float(found["begin"]),
            last=float(found["last"]),
            stress=np.array([np.array(row.split(), dtype=float) for row in found["stress_kpa"]]) * 1e3,
            wave_speed=float(found["wave_speed"]),
            pulse_end=math.inf if found["pulse_end"] is None else float(found["pulse_end"]),
            record_end=float(found["record_end"]),
            returns=(one, two),
            tensions=tuple(
                Tension(bar=str(entry["bar"]), position=float(entry["position"]), time=float(entry["time"]))
                for entry in found["tensions"]
            ),
        )
        if view.stress.ndim != 2 or not 0 < view.stress.size <= 1_000_000 or not np.isfinite(view.stress).all():
            raise ValueError("the stress must be a table of finite numbers")
        numbers = (left, right, view.begin, view.last, view.wave_speed, view.record_end)
        if not all(math.isfinite(value) for value in numbers) or not (left > 0.0 < right and view.wave_speed > 0.0):
            raise ValueError("lengths, times and the speed must be finite, lengths and speed positive")
        if not view.begin < view.last or any(one.bar not in BARS for one in view.tensions):
            raise ValueError("the times must ascend, and the bars be those of the model")
        return view


def shown_time(history: History) -> float:
    """How far pictures go in time [s]: the record, at least one round trip where something comes back."""
    solution = history.solution
    trips = [solution.round_trip(bar) for bar in (0, 1)]
    echoes = [trip for bar, trip in enumerate(trips) if solution.echoes(bar)]
    last = max(1.15 * history.record_end, 1.1 * max(echoes, default=0.0))
    if not echoes and math.isfinite(solution.pulse_end):
        last = min(last, 6.0 * solution.pulse_end)
    return min(last, history.horizon)


def extent(history: History) -> tuple[tuple[float, float], float]:
    """What a picture of the bars shows: length of each bar [m], as far as it goes, and the last instant [s]."""
    solution, last = history.solution, shown_time(history)
    trips = [solution.round_trip(bar) for bar in (0, 1) if solution.echoes(bar)]
    # the regions can be told apart up to the second return
    last = min(last, 2.2 * max(trips, default=math.inf))
    speed = solution.wave_speed
    reach = [min(0.5 * speed * solution.round_trip(bar), 1.2 * speed * last) for bar in (0, 1)]
    return (reach[0], reach[1]), last


def view_field(history: History, *, places: int = 300, times: int = 380) -> FieldView:
    """The view of a history on a grid of that many places and instants."""
    solution = history.solution
    reach, last = extent(history)
    first, second = (solution.round_trip(bar) if solution.echoes(bar) else math.inf for bar in (0, 1))
    found = (first_tension(history, bar) for bar in BARS)
    view = FieldView(
        reach=reach,
        begin=-reach[0] / solution.wave_speed,
        last=last,
        stress=np.zeros((times, places)),
        wave_speed=solution.wave_speed,
        pulse_end=solution.pulse_end,
        record_end=history.record_end,
        returns=(first, second),
        tensions=tuple(one for one in found if one is not None),
    )
    view.stress[...] = field_grid(history, view.places, view.times).stress
    return view
