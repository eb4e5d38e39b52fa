"""The largest force of a record, from the samples around it.

A flat top gives its mean.  Any other top gives the largest running mean over as few samples as its
noise allows, and what this mean misses by a mean over twice as many.  No value is above the
smoothed samples: a parabola overshoots where a ramp meets a plateau.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.special import ndtri

from uqsphere.arrays import Array
from uqsphere.uq import student

#: half of an interval over its standard deviation
NORMAL = student(math.inf)
#: samples above 80 % of the largest force without which a record is too slow
_FEW_ON_TOP = 8
#: share of the largest force to which the force falls before the record ends
_FALLEN = 0.9
#: noise of a running mean over the largest force that is small enough
_QUIET = 0.004
#: share of the largest force within which a top is flat, and by which its mean line may bend
_FLAT, _BEND = 0.01, 0.005


class Peak(NamedTuple):
    """The largest force [N], its 95 % interval, its time after first touch [s], and its doubts."""

    value: float
    low: float
    high: float
    time: float
    doubts: tuple[str, ...]


class Peaks(dict[str, Peak]):
    """Largest forces by face, "A", "B" and "mean"; only faces that are known."""

    def doubt(self, face: str, text: str, *ends: float) -> None:
        """Add a doubt to a face and widen its interval to `ends` [N]; an empty text adds none."""
        if text and face in self:
            peak = self[face]
            self[face] = peak._replace(
                doubts=(*peak.doubts, text),
                low=min((peak.low, *ends)),
                high=max((peak.high, *ends)),
            )


class Force(NamedTuple):
    """A force (n,) [N] over time (n,) [s] with its standard deviation (n,) [N].

    noise : part of the standard deviation that differs from sample to sample [N], correlated over
    `memory` samples.
    """

    time: Array
    force: Array
    sd: Array
    noise: float
    memory: float

    def part(self, zone: slice) -> "Force":
        """The samples of a slice."""
        return self._replace(time=self.time[zone], force=self.force[zone], sd=self.sd[zone])

    def scatter(self, samples: float) -> float:
        """Standard deviation [N] of the mean of so many neighbouring samples, from noise alone."""
        return self.noise * math.sqrt(min(1.0, self.memory / samples))

    def medians(self, samples: int) -> Array:
        """Running medians [N]."""
        return median_filter(self.force, samples, mode="nearest")

    def means(self, samples: int) -> Array:
        """Running means [N] over an odd number of samples, of medians of three."""
        return uniform_filter1d(self.medians(3), samples, mode="nearest")


class _Top(NamedTuple):
    """An estimate of the largest force: value, its ends without noise, scatter [N]; its sample."""

    value: float
    low: float
    high: float
    scatter: float
    at: int


def largest_force(course: Force) -> Peak:
    """The largest force of a record with its 95 % interval and doubts."""
    medians = course.medians(5)
    highest = int(np.argmax(medians))
    level = medians[highest]
    single = course.force.max()
    first, behind = stretch(medians, 0.8 * level, highest)
    count = behind - first
    width = max(5, 2 * (count // 6) + 1)
    most = max(3, 2 * (width // 6) + 1)
    top = _flat_top(course, count, most) or _pointed_top(course, level, most)
    systematic = max(course.sd[top.at] ** 2 - course.noise**2, 0.0)
    half = NORMAL * math.sqrt(systematic + top.scatter**2)
    high = top.high + half
    doubts = []
    if single > top.value + 5.0 * course.noise + 0.05 * top.value:
        doubts.append(
            f"isolated samples reach {single * 1e-3:.4g} kN but their neighbours do not (spike?)"
        )
    if count < _FEW_ON_TOP:
        doubts.append(f"its top has only {count} samples: the sampling rate is too slow")
    if doubts:
        high = max(high, single)
    last = medians[-width:].mean()
    if highest >= len(medians) - max(3, width // 2) or last > _FALLEN * top.value:
        doubts.append("the force is largest where the record ends: the true peak is at least this")
        high = math.inf
    return Peak(top.value, top.low - half, high, course.time[top.at], tuple(doubts))


def stretch(values: Array, level: float, at: int) -> tuple[int, int]:
    """First sample, and the sample behind the last, of the stretch around `at` above a level."""
    low = np.flatnonzero(values < level)
    before = low[low < at]
    behind = low[low > at]
    return before.max(initial=-1) + 1, behind.min(initial=len(values))


def _pointed_top(course: Force, level: float, most: int) -> _Top:
    """The top of a force that is round or sharp, from running means over n and 2n samples.

    n is odd and makes the mean quiet enough, beside the level of the top, but is at most `most`.
    What the mean over n misses is all of their difference at a sharp top, where it grows with n,
    and a third of it at a round one, where it grows with n² (L. F. Richardson, 1927).  The middle
    of both is the value, never above the highest median of three samples; they are its ends.
    """
    wanted = course.memory * (course.noise / (_QUIET * level)) ** 2
    samples = max(3, 2 * int(min(wanted, most) // 2) + 1)
    means = course.means(samples)
    at = int(np.argmax(means))
    highest = means.max()
    missed = max(highest - course.means(2 * samples + 1).max(), 0.0)
    # the largest of m equal means exceeds them by luck (Blom)
    scatter = course.scatter(samples)
    near = (means > highest - 2.0 * scatter).sum()
    equal = 1.0 + near / max(samples, course.memory)
    value = highest - scatter * ndtri((equal - 0.375) / (equal + 0.25))
    ends = (value + missed / 3.0, value + missed)
    value = min(value + 2.0 / 3.0 * missed, course.medians(3).max())
    # means over n and 2n share half of their samples
    scatter *= math.sqrt((4.0 / 3.0) ** 2 + (1.0 / 3.0) ** 2)
    return _Top(value, min(value, ends[0]), max(value, ends[1]), scatter, at)


def _flat_top(course: Force, count: int, samples: int) -> _Top | None:
    """The mean of a flat top, None for a top that is not flat, or too noisy to tell.

    Flat: half of the top or more lies within a percent, and a parabola through it does not bend
    beyond the noise.
    """
    means = course.means(samples)
    at = int(np.argmax(means))
    top = means[at]
    first, behind = stretch(means, top - max(5.0 * course.scatter(samples), _FLAT * top), at)
    inner = slice(first + samples // 2, behind - samples // 2)
    number = inner.stop - inner.start
    if number <= 0.5 * count or number < 5:
        return None
    flat = course.force[inner]
    places = np.linspace(-1.0, 1.0, number)
    _, slope, bend = np.polynomial.polynomial.polyfit(places, flat, 2)
    scatter = course.scatter(number)
    # variances of slope and bend: 3 and 45/4 of that of the mean
    unlikely = slope**2 / 3.0 + bend**2 / 11.25 > 6.0 * scatter**2
    bends = unlikely and abs(slope) + abs(bend) > _BEND * top
    if bends or math.sqrt(11.25) * scatter > _FLAT * top:
        return None
    value = flat.mean()
    return _Top(value, value, value, scatter, inner.start + number // 2)
