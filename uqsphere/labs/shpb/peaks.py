"""The largest force of a record, from the samples around it.

A flat top gives its mean.  Any other top gives the largest running mean over as few samples as its
noise allows, or a parabola over a third of the top where that is no higher.  No value is above the
smoothed samples: a parabola overshoots where a ramp meets a plateau.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import savgol_filter
from scipy.special import ndtri

from uqsphere.arrays import Array

NORMAL: Final = 1.959964
#: samples above 80 % of the largest force without which a record is too slow
_FEW_ON_TOP: Final = 8
#: share of the largest force to which the force falls before the record ends
_FALLEN: Final = 0.9
#: noise of a running mean over the largest force that is small enough
_QUIET: Final = 0.004
#: share of the largest force within which a top is flat, and by which its mean line may bend
_FLAT, _BEND = 0.01, 0.005


@dataclass(frozen=True, kw_only=True)
class Peak:
    """The largest force [N], its 95 % interval, its time after first touch [s], and its doubts."""

    value: float
    low: float
    high: float
    time: float
    doubts: tuple[str, ...] = ()


class Peaks(dict[str, Peak]):
    """Largest forces by face, "A", "B" and "mean"; only faces that are known."""

    def doubt(self, faces: Iterable[str], text: str, *ends: float) -> None:
        """Add a doubt to faces and widen their intervals to `ends` [N]; an empty text adds none."""
        for face in faces:
            if text and face in self:
                peak = self[face]
                self[face] = replace(
                    peak,
                    doubts=(*peak.doubts, text),
                    low=min((peak.low, *ends)),
                    high=max((peak.high, *ends)),
                )


@dataclass(frozen=True, kw_only=True)
class Force:
    """A force (n,) [N] over time (n,) [s] with its standard deviation (n,) [N].

    noise : part of the standard deviation that differs from sample to sample [N], correlated over
    `memory` samples.
    """

    time: Array
    force: Array
    sd: Array
    noise: float
    memory: float

    def part(self, zone: slice) -> Force:
        """The samples of a slice."""
        return replace(self, time=self.time[zone], force=self.force[zone], sd=self.sd[zone])

    def scatter(self, samples: float) -> float:
        """Standard deviation [N] of the mean of so many neighbouring samples, from noise alone."""
        return self.noise * math.sqrt(min(1.0, self.memory / samples))


@dataclass(frozen=True, kw_only=True)
class _Top:
    """An estimate of the largest force: value and scatter [N], and its sample."""

    value: float
    scatter: float
    at: int


def largest_force(course: Force) -> Peak:
    """The largest force of a record with its 95 % interval and doubts."""
    force, noise = course.force, course.noise
    medians = median_filter(force, 5, mode="nearest")
    highest = int(np.argmax(medians))
    first, behind = _stretch(medians, 0.8 * float(medians[highest]), highest)
    count = behind - first
    width = min(max(5, 2 * (count // 6) + 1), len(force) - 1 + len(force) % 2)
    top = _flat_top(course, count, width)
    lost = 0.0
    if top is None:
        samples = _samples_of_mean(course, float(medians[highest]), width)
        top = _highest_mean(course, samples)
        # what a mean over twice as many samples misses, this one may miss too
        lost = max(top.value - _highest_mean(course, 2 * samples + 1).value, 0.0)
        parabola = _parabola(course, medians, width)
        if top.value - 2.0 * top.scatter - _QUIET * top.value < parabola.value < top.value:
            top = parabola
    systematic = max(float(course.sd[top.at]) ** 2 - noise**2, 0.0)
    half = NORMAL * math.sqrt(systematic + top.scatter**2)
    high, doubts = top.value + half + lost, []
    single = float(force.max())
    if single > top.value + 5.0 * noise + 0.05 * top.value:
        doubts.append(
            f"isolated samples reach {single * 1e-3:.4g} kN, their neighbours do not (spike?)"
        )
        high = max(high, single)
    if count < _FEW_ON_TOP:
        doubts.append(f"its top has {count} samples: the record is too slow for it")
        high = max(high, single)
    last = float(medians[-width:].mean())
    if highest >= len(force) - max(3, width // 2) or last > _FALLEN * top.value:
        doubts.append("the force is largest where the record ends: it is at least this")
        high = math.inf
    return Peak(
        value=top.value,
        low=top.value - half,
        high=high,
        time=float(course.time[top.at]),
        doubts=tuple(doubts),
    )


def _stretch(values: Array, level: float, at: int) -> tuple[int, int]:
    """First sample, and the sample behind the last, of the stretch around `at` above a level."""
    low = np.flatnonzero(values < level)
    before, behind = low[low < at], low[low > at]
    first = int(before[-1]) + 1 if len(before) else 0
    return first, int(behind[0]) if len(behind) else len(values)


def _means(force: Array, samples: int) -> Array:
    """Running means over an odd number of samples, of medians of three."""
    padded = np.pad(median_filter(force, 3, mode="nearest"), samples // 2, mode="edge")
    return np.convolve(padded, np.full(samples, 1.0 / samples), mode="valid")


def _samples_of_mean(course: Force, level: float, width: int) -> int:
    """The odd number of samples whose mean is quiet enough, at most a third of `width`."""
    most = max(3, 2 * (width // 6) + 1)
    wanted = course.memory * (course.noise / (_QUIET * level)) ** 2
    return int(min(max(3, 2 * (min(wanted, 1e9) // 2) + 1), most))


def _highest_mean(course: Force, samples: int) -> _Top:
    """The highest running mean, less what the highest of several equal ones exceeds them by."""
    samples = min(samples, len(course.force) - 1 + len(course.force) % 2)
    means = _means(course.force, samples)
    return _without_luck(course, means, samples, course.scatter(samples))


def _parabola(course: Force, medians: Array, width: int) -> _Top:
    """The highest point of parabolas through `width` samples, fitted twice."""
    curve = savgol_filter(savgol_filter(medians, width, 2), width, 2)
    # the middle of a parabola through `width` samples has 9/4 of the variance of their mean
    return _without_luck(course, curve, width, course.scatter(width / 2.25))


def _without_luck(course: Force, curve: Array, samples: int, scatter: float) -> _Top:
    """The top of a curve, less the mean excess of the largest of m equal values (Blom)."""
    at = int(np.argmax(curve))
    near = float((curve > curve[at] - 2.0 * scatter).sum())
    equal = 1.0 + near / (samples * max(1.0, course.memory / samples))
    excess = scatter * float(ndtri((equal - 0.375) / (equal + 0.25)))
    return _Top(value=float(curve[at]) - excess, scatter=scatter, at=at)


def _flat_top(course: Force, count: int, width: int) -> _Top | None:
    """The mean of a flat top, None for a top that is not flat, or too noisy to tell.

    Flat: half of the top or more lies within a percent, and a parabola through it does not bend
    beyond the noise.
    """
    samples = max(3, 2 * (width // 6) + 1)
    means = _means(course.force, samples)
    at = int(np.argmax(means))
    top = float(means[at])
    first, behind = _stretch(means, top - max(5.0 * course.scatter(samples), _FLAT * top), at)
    inner = slice(first + samples // 2, behind - samples // 2)
    number = inner.stop - inner.start
    if number <= 0.5 * count or number < 5:
        return None
    flat = course.force[inner]
    fitted = np.polynomial.polynomial.polyfit(np.linspace(-1.0, 1.0, number), flat, 2)
    slope, bend = float(fitted[1]), float(fitted[2])
    scatter = course.scatter(number)
    # variances of slope and bend: 3 and 45/4 of that of the mean
    unlikely = slope**2 / 3.0 + bend**2 / 11.25 > 6.0 * scatter**2
    if unlikely and abs(slope) + abs(bend) > _BEND * top:
        return None
    if math.sqrt(11.25) * scatter > _FLAT * top:
        return None
    return _Top(value=float(flat.mean()), scatter=scatter, at=inner.start + number // 2)
