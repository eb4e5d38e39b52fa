"""What a record is made of: steps of mending, signals about zero, and their first waves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from uqsphere.arrays import Array, Flags, Places
from uqsphere.errors import UsageError

#: no wave of a bar is shorter [s]
SHORTEST: Final = 1e-6
#: part of the longest excursion that a first wave lasts: trigger bursts are shorter
_LASTS: Final = 0.25
#: most samples on either side of a running median
_LONGEST_MEDIAN: Final = 40


@dataclass(frozen=True, kw_only=True)
class Change:
    """What a step of mending changed; `size` is a strain, or the time of a shift [s]."""

    step: str
    signal: str
    text: str
    size: float | None = None


class Changes(list[Change]):
    """The steps of mending in their order."""

    def add(self, step: str, signal: str, text: str, size: float | None = None) -> None:
        """Add a step; its text begins with the name of the signal."""
        if signal:
            text = f"{signal}: {text}"
        self.append(Change(step=step, signal=signal, text=text, size=size))


@dataclass(frozen=True, kw_only=True)
class Wave:
    """The first wave of a signal, by samples.

    foot, end : first and last sample; half, falling : first and last sample above half its top.
    rising : samples from a tenth to half of the top.
    peak : top of the smoothed signal, above 0; sign : +1 for tension.
    ended : whether the signal returns to rest.
    """

    foot: int
    half: int
    falling: int
    end: int
    rising: int
    peak: float
    sign: float
    ended: bool

    @property
    def lead(self) -> int:
        """Samples before the foot that belong to the wave."""
        return max(2, round(0.2 * self.rising))

    @property
    def start(self) -> int:
        """The first sample that belongs to the wave."""
        return max(self.foot - self.lead, 0)


@dataclass(frozen=True, kw_only=True)
class Signal:
    """The strain (n,) of one bar or one wave about its rest, compression negative.

    known : (n,) whether a sample is known.
    noise : standard deviation of a sample at rest, correlated over `memory` samples.
    offset : standard deviation of the baseline.
    spread : (n,) half the difference between the gauges of a bar; 0 for one gauge.
    single : whether a bar has one working gauge, which does not show bending.
    """

    name: str
    strain: Array
    known: Flags
    noise: float
    offset: float
    spread: Array
    wave: Wave
    memory: float = 1.0
    single: bool = False


def runs(same: Flags) -> tuple[Places, Places]:
    """First places and lengths of the runs of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8)))
    return edges[::2], edges[1::2] - edges[::2]


def smooth(values: Array, samples: int) -> Array:
    """Running means over so many samples."""
    if samples < 2:
        return values
    return np.convolve(values, np.full(samples, 1.0 / samples), mode="same")


class Stay(NamedTuple):
    """The first stay of a smoothed signal above a share of its largest value, by samples."""

    smoothed: Array
    first: int
    last: int
    rising: int


def first_stay(values: Array, step: float, share: float, name: str) -> Stay:
    """The first long stay of a signal above a share of its largest value.

    Trigger bursts swing within a few microseconds: running medians remove them.

    Raises UsageError for a signal that stays nowhere.
    """
    half = min(3 * round(SHORTEST / step), _LONGEST_MEDIAN)
    width = max(1, round(2.0 * SHORTEST / step))
    smoothed = smooth(median_filter(values, 2 * half + 1, mode="nearest"), width)
    size = np.abs(smoothed)
    begins, lengths = runs(size > share * float(size.max()))
    if lengths.max(initial=0) < 3:
        raise UsageError(f"{name}: no wave rises above the noise before it")
    chosen = int(np.argmax(lengths >= max(3.0, _LASTS * lengths.max())))
    first, last = int(begins[chosen]), int(begins[chosen] + lengths[chosen]) - 1
    upward = math.copysign(1.0, smoothed[first]) * smoothed
    top = float(upward[first : last + 1].max())
    foot = int(np.flatnonzero(upward[:first] < 0.2 * share * top).max(initial=0))
    return Stay(smoothed, first, last, first - foot)


def first_wave(values: Array, step: float, noise: float, name: str) -> Wave:
    """The first wave of a signal about zero.

    Raises UsageError for a signal that does not rise above its noise at rest.
    """
    stay = first_stay(values, step, 0.5, name)
    half, falling, rising = stay.first, stay.last, stay.rising
    width = max(1, round(2.0 * SHORTEST / step))
    if not float(np.abs(stay.smoothed).max()) > 5.0 * noise / math.sqrt(width):
        raise UsageError(f"{name}: no wave rises above the noise before it")
    sign = math.copysign(1.0, stay.smoothed[half])
    top = float((sign * stay.smoothed[half : falling + 1]).max())
    width = max(width, rising // 5 + 1)
    upward = sign * smooth(values, width)
    level = max(0.01 * top, 4.0 * noise / math.sqrt(width))
    before = np.flatnonzero(upward[:half] < level)
    behind = falling + np.flatnonzero(upward[falling:] < max(0.02 * top, level))
    foot, end = int(before.max(initial=-1)) + 1, int(behind.min(initial=len(values) - 1))
    return Wave(
        foot=foot,
        half=half,
        falling=falling,
        end=end,
        rising=rising,
        peak=top,
        sign=sign,
        ended=len(behind) > 0,
    )
