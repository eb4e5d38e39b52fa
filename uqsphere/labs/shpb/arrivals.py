"""When the three waves pass the gauges, compared with the gauge distances and wave speeds given."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import UsageError
from uqsphere.labs.shpb.document import RecordDocument
from uqsphere.labs.shpb.record import Record
from uqsphere.labs.shpb.signals import Changes, Signal, Wave, smooth

#: share of the peak at which an arrival is read, and the time [s] over which it is averaged: to
#: doubt distances, and to shift a steep wave
_SURE, _FINE = (0.15, 8e-6), (0.05, 2e-6)
#: shares of the predicted delay by which a wave may come early, and late
_EARLY, _LATE = 0.02, 0.10
#: time by which the transit and softness of a specimen may delay the transmitted wave [s]
_SOFT: Final = 50e-6
#: a wave is steep that rises within this share of its delay
_STEEP: Final = 0.05


@dataclass(frozen=True, kw_only=True)
class Arrivals:
    """Delays of the reflected and the transmitted wave behind the incident one, in samples.

    doubt_a, doubt_b : why the distance to a face is doubted, empty without a doubt.
    speed_ratio : wave speed that the reflected wave shows over that of the bar; 1 without a doubt.
    """

    reflected: float
    transmitted: float
    doubt_a: str = ""
    doubt_b: str = ""
    speed_ratio: float = 1.0


@dataclass
class _Delay:
    """Predicted and recorded delay of a wave in samples; None for an arrival that is not seen."""

    wave: str
    predicted: float
    seen: int | None = None

    @property
    def late(self) -> float:
        """Samples by which the wave is later than predicted; 0 for a wave that is not seen."""
        return 0.0 if self.seen is None else self.seen - self.predicted


def find_arrivals(record: Record, document: RecordDocument, changes: Changes) -> Arrivals:
    """The arrivals of a record; a steep wave that comes a little early is shifted.

    Raises UsageError for exchanged columns, and for arrivals that fit another wave speed.
    """
    if document.record.aligned:
        start = record.incident.wave.start
        reflected = record.reflected or record.incident
        return Arrivals(
            reflected=reflected.wave.start - start,
            transmitted=record.receiving.wave.start - start,
        )
    bar, behind, step = document.incident_bar, document.receiving_bar, record.step
    wave, receiving = record.incident.wave, record.receiving
    back = _Delay("reflected", 2.0 * bar.gauge / bar.wave_speed / step)
    passage = bar.gauge / bar.wave_speed + behind.gauge / behind.wave_speed
    there = _Delay("transmitted", passage / step)
    _look(record, back, there, *_SURE)
    steep = float(wave.rising)
    if there.seen is not None and there.seen < -steep:
        raise UsageError(
            f"{receiving.name}: its wave comes {-there.seen * step * 1e6:.4g} us before the "
            "incident wave. Are the columns exchanged?"
        )
    fits = 0.5 * (back.seen or 0) * step * bar.wave_speed
    doubt_a = _doubt(back, _tolerance(back, steep, 5.0), step, (bar.gauge, fits))
    speed_ratio = 1.0
    if doubt_a:
        doubt_a += " (or another E or density)"
        speed_ratio = back.predicted / max(back.seen or 0, 1)
    soft = 0.5 * (wave.falling - wave.half) + _SOFT / step
    fits = ((there.seen or 0) * step - bar.gauge / bar.wave_speed) * behind.wave_speed
    doubt_b = _doubt(there, _tolerance(there, steep, soft), step, (behind.gauge, fits))
    if doubt_b:
        other = there.predicted / max(there.seen or 0, 1)
        if doubt_a and abs(other - speed_ratio) < abs(speed_ratio - 1.0) / 3.0:
            raise UsageError(
                f"both arrivals fit a wave speed of {speed_ratio * bar.wave_speed:.4g} m/s, not "
                f"{bar.wave_speed:.4g} m/s: E, density or both distances are wrong "
                f"({doubt_a}; {doubt_b})"
            )
        # no force acts before first touch: the incident wave is at another place
        if there.late < 0.0:
            doubt_a = doubt_a or doubt_b
    if doubt_a or doubt_b or steep >= _STEEP * back.predicted:
        return Arrivals(
            reflected=back.predicted,
            transmitted=there.predicted,
            doubt_a=doubt_a,
            doubt_b=doubt_b,
            speed_ratio=speed_ratio,
        )
    _look(record, back, there, *_FINE)
    reflected = record.reflected or record.incident
    return Arrivals(
        reflected=back.predicted + _shift(back, reflected.name, step, changes),
        transmitted=there.predicted + _shift(there, receiving.name, step, changes),
    )


def _look(record: Record, back: _Delay, there: _Delay, share: float, window: float) -> None:
    """Note when the waves are seen, by a share and a time such as `_SURE` (in place)."""
    width = max(1, round(window / record.step))
    incident, receiving = record.incident, record.receiving
    wave = incident.wave
    level = _level(incident, share, width)
    pressing = -smooth(incident.strain, width)
    first = _crossing(pressing, level, max(wave.foot - 2 * wave.rising - 5, 0), wave.falling)
    if first is None:
        return
    seen_back = None
    if record.reflected is not None:
        size = np.abs(smooth(record.reflected.strain, width))
        seen_back = _crossing(size, level, 0, len(size))
    else:
        # the first excursion of either sign behind the end of the incident wave
        low = np.flatnonzero(pressing[wave.falling :] < level)
        if len(low):
            begin = wave.falling + int(low[0]) + 1
            seen_back = _crossing(np.abs(pressing), level, begin, len(pressing))
    level = _level(receiving, share, width)
    pressing = -smooth(receiving.strain, width)
    seen_there = _crossing(pressing, level, 0, receiving.wave.falling + 1)
    for delay, seen in ((back, seen_back), (there, seen_there)):
        delay.seen = seen
        if seen is not None:
            delay.seen = seen - first


def _level(signal: Signal, share: float, width: int) -> float:
    """The strain at which a wave is there: a share of its peak, or above its noise."""
    return max(share * signal.wave.peak, 5.0 * signal.noise / math.sqrt(width))


def _crossing(values: Array, level: float, begin: int, end: int) -> int | None:
    """First place in [begin, end) from which three values are above a level."""
    above = values[begin:end] > level
    first = np.flatnonzero(above[:-2] & above[1:-1] & above[2:])
    return begin + int(first[0]) if len(first) else None


def _tolerance(delay: _Delay, steep: float, late: float) -> tuple[float, float]:
    """Samples by which a wave may be early (negative) and late."""
    early = -(_EARLY * delay.predicted + 0.5 * steep + 3.0)
    return early, late + _LATE * delay.predicted + 2.0 * steep


def _doubt(
    delay: _Delay, tolerance: tuple[float, float], step: float, distance: tuple[float, float]
) -> str:
    """Why a delay does not fit the gauge distance; `distance`: given, and fitting [m]."""
    early, late = tolerance
    if early <= delay.late <= late:
        return ""
    given, fitting = distance
    would = "no distance of this gauge fits"
    if fitting > 0.0:
        would = f"{fitting:.4g} m would fit"
    side = "early" if delay.late < 0.0 else "late"
    return (
        f"the {delay.wave} wave comes {abs(delay.late) * step * 1e6:.4g} us too {side} for a "
        f"gauge at {given:.4g} m; {would}"
    )


def _shift(delay: _Delay, name: str, step: float, changes: Changes) -> float:
    """Samples by which a steep wave is taken earlier than its distance predicts, 0 or less."""
    early = -_EARLY * delay.predicted - 3.0
    if not early <= delay.late < -max(1.0, 1e-6 / step):
        return 0.0
    changes.add(
        "time shift",
        name,
        f"the {delay.wave} wave is shifted by {-delay.late * step * 1e6:.3g} us: it comes earlier "
        "than the gauge distances predict",
        delay.late * step,
    )
    return delay.late


def undisturbed(wave: Wave, delay: float) -> tuple[int, int]:
    """Samples after first touch between which incident and reflected wave do not overlap.

    delay : samples between the two waves at the incident gauge; infinite with a gauge for each.
    """
    if not math.isfinite(delay) or wave.end - wave.start <= delay:
        return 0, 1 << 60
    return math.ceil(wave.end - wave.start - delay + 0.05 * delay), int(delay)
