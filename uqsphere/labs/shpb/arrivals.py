"""When the three waves pass the gauges, compared with the gauge distances and wave speeds given."""

import math
from typing import NamedTuple

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import UsageError

from .mending import Record, Signal, note, runs, smooth

#: share of the peak at which an arrival is read, and the time [s] over which it is averaged: to
#: doubt distances, and to shift a steep wave
_SURE, _FINE = (0.15, 8e-6), (0.05, 2e-6)
#: shares of the predicted delay by which a wave may come early, and late
_EARLY, _LATE = 0.02, 0.10
#: time by which the transit and softness of a specimen may delay the transmitted wave [s]
_SOFT = 50e-6
#: a wave is steep that rises within this share of its delay
_STEEP = 0.05


class Arrivals(NamedTuple):
    """Samples of first touch in the reflected and the transmitted wave at their gauges.

    doubt_a, doubt_b : why the distance to a face is doubted, empty without a doubt.
    speed_ratio : wave speed that the reflected wave shows over that of the bar; 1 without a doubt.
    """

    to_a: float
    to_b: float
    doubt_a: str = ""
    doubt_b: str = ""
    speed_ratio: float = 1.0


class _Delay(NamedTuple):
    """Predicted and recorded delay of a wave in samples; NaN for an arrival that is not seen.

    signal : of the gauge that the wave passes; ways : from this gauge to its face, there and back.
    """

    wave: str
    signal: Signal
    ways: int
    predicted: float
    seen: float

    @property
    def late(self) -> float:
        """Samples by which the wave is later than predicted."""
        return self.seen - self.predicted


def find_arrivals(record: Record) -> Arrivals:
    """The arrivals of a record; a steep wave that comes a little early is shifted.

    Raises UsageError for exchanged columns, and for arrivals that fit another wave speed.
    """
    incident = record.incident
    receiving = record.receiving
    wave = incident.wave
    step = incident.step
    if record.document.record.aligned:
        return Arrivals(record.reflected.wave.start, receiving.wave.start)
    back, there = _delays(record, *_SURE)
    steep = wave.rising
    if there.seen < -steep:
        raise UsageError(
            f"{receiving.name}: its wave comes {-there.seen * step * 1e6:.4g} us before the "
            "incident wave. Are the columns exchanged?"
        )
    doubt_a = _doubt(back, steep, 5.0)
    speed_ratio = 1.0
    if doubt_a:
        doubt_a += " (or another E or density)"
        speed_ratio = back.predicted / max(back.seen, 1.0)
    soft = 0.5 * (wave.falling - wave.half) + _SOFT / step
    doubt_b = _doubt(there, steep, soft)
    if doubt_b:
        other = there.predicted / max(there.seen, 1.0)
        if doubt_a and abs(other - speed_ratio) < abs(speed_ratio - 1.0) / 3.0:
            raise UsageError(
                f"both arrivals fit a wave speed of {speed_ratio * incident.bar.wave_speed:.4g} "
                f"m/s, not {incident.bar.wave_speed:.4g} m/s: E, density or both distances are "
                f"wrong ({doubt_a}; {doubt_b})"
            )
        # no force acts before first touch: the incident wave is at another place
        if there.late < 0.0:
            doubt_a = doubt_a or doubt_b
    if doubt_a or doubt_b or steep >= _STEEP * back.predicted:
        to_b = wave.start + there.predicted
        if doubt_b:  # a wave whose distance is wrong begins at its own foot
            to_b = receiving.wave.foot - receiving.wave.lead
        return Arrivals(wave.start + back.predicted, to_b, doubt_a, doubt_b, speed_ratio)
    arrivals = []
    for delay in _delays(record, *_FINE):
        shift = 0.0
        if -_EARLY * delay.predicted - 3.0 <= delay.late < -max(1.0, 1e-6 / step):
            shift = delay.late
            note(
                delay.signal,
                "time shift",
                f"the {delay.wave} wave is shifted by {-shift * step * 1e6:.3g} us: it comes "
                "earlier than the gauge distances predict",
                shift * step,
            )
        arrivals.append(wave.start + (delay.predicted + shift))
    return Arrivals(arrivals[0], arrivals[1])


def _delays(record: Record, share: float, window: float) -> tuple[_Delay, _Delay]:
    """The delays of the reflected and the transmitted wave, by a share and a time such as
    `_SURE`."""
    incident = record.incident
    receiving = record.receiving
    wave = incident.wave
    step = incident.step
    passage = incident.bar.passage
    width = max(1, round(window / step))

    def level(signal: Signal) -> float:
        """The strain at which a wave is there: a share of its peak, or above its noise."""
        return max(share * signal.wave.peak, 5.0 * signal.noise / math.sqrt(width))

    pressing = -smooth(incident.strain, width)
    high = level(incident)
    first = _crossing(pressing, high, max(wave.foot - 2 * wave.rising - 5, 0), wave.falling)
    size = np.abs(smooth(record.reflected.strain, width))
    begin = 0
    if record.shared:
        # the first excursion of either sign behind the end of the incident wave
        low = np.flatnonzero(pressing[wave.falling :] < high)
        begin = wave.falling + low.min(initial=len(size)) + 1
    there = -smooth(receiving.strain, width)
    reflected = _crossing(size, high, begin, len(size)) - first
    transmitted = _crossing(there, level(receiving), 0, receiving.wave.falling + 1) - first
    way = passage + receiving.bar.passage
    return (
        _Delay("reflected", record.reflected, 2, 2.0 * passage / step, reflected),
        _Delay("transmitted", receiving, 1, way / step, transmitted),
    )


def _crossing(values: Array, level: float, begin: int, end: int) -> float:
    """First place in [begin, end) from which three values are above a level, NaN without one."""
    begins, lengths = runs(values[begin:end] > level)
    lasting = begins[lengths >= 3]
    return begin + lasting[0] if len(lasting) else math.nan


def _doubt(delay: _Delay, steep: float, late: float) -> str:
    """Why a delay does not fit the distance of its gauge, and which one fits; empty if it does.

    steep : samples in which the wave rises; late : by which it may be late beside this.
    """
    early = -(_EARLY * delay.predicted + 0.5 * steep + 3.0)
    if not (delay.late < early or delay.late > late + _LATE * delay.predicted + 2.0 * steep):
        return ""
    side = "early" if delay.late < 0.0 else "late"
    signal = delay.signal
    bar = signal.bar
    late_by = delay.late * signal.step
    fits = bar.gauge + late_by * bar.wave_speed / delay.ways
    would = "no distance of this gauge fits"
    if fits > 0.0:
        would = f"{fits:.4g} m would fit"
    return (
        f"the {delay.wave} wave comes {abs(late_by) * 1e6:.4g} us too {side} for a gauge at "
        f"{bar.gauge:.4g} m; {would}"
    )
