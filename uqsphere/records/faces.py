"""From gauges to faces: the three waves at the sphere, on one time axis, with their noise.

The incident gauge stands a distance d_1 before face A, the receiving gauge d_3 behind face B.  The incident wave
reaches A d_1/c0 after its gauge, the reflected wave left A d_1/c0 before it, the transmitted wave left B d_3/c0
before its own.
Of one gauge that sees incident and reflected wave both, the first must be over before the second arrives.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.dispersion import first_mode, transfer
from uqsphere.records.mending import Record
from uqsphere.records.pulse import Bar, CutPulse, cut_pulse
from uqsphere.records.reading import RecordError

__all__ = ["Faces", "Rig", "at_faces"]

Array = npt.NDArray[np.float64]

#: samples at the faces, at the least
_FEWEST: Final = 50


@dataclass(frozen=True, kw_only=True)
class Rig:
    """Bars and gauges.

    Attributes
    ----------
    bar : Bar
    incident_gauge, receiving_gauge : float
        Distances from the sphere [m].
    incident_length, receiving_length : float
        Of the bars [m]; infinite where nothing comes back.
    correct_dispersion : bool
    """

    bar: Bar
    incident_gauge: float
    receiving_gauge: float
    incident_length: float = math.inf
    receiving_length: float = math.inf
    correct_dispersion: bool = False

    def __post_init__(self) -> None:
        for name in ("incident", "receiving"):
            gauge, length = getattr(self, f"{name}_gauge"), getattr(self, f"{name}_length")
            if not 0.0 <= gauge < math.inf or gauge > length:
                raise RecordError(
                    f"the {name} gauge, {gauge:.4g} m from the sphere, must sit on its bar of {length:.4g} m"
                )

    @property
    def undisturbed(self) -> float:
        """Time after first touch up to which no wave from a far end mixes with those at the gauges [s]."""
        spans = (self.incident_length - self.incident_gauge, self.receiving_length - self.receiving_gauge)
        return 2.0 * min(spans) / self.bar.wave_speed


@dataclass(frozen=True, kw_only=True)
class Faces:
    """Strains of the three waves at the faces, tension positive, on one time axis.

    Attributes
    ----------
    step : float
        Time between samples [s]; the first is the begin of the incident wave at face A.
    incident, reflected, transmitted : (n,) arrays
    noise, memory, offset : (3,) arrays
        Of the three: standard deviation of a sample, samples over which it is correlated, standard deviation of the
        baseline.
    known : int
        Samples of the incident wave; it is taken as over behind them.
    shared : bool
        Incident and reflected wave come from one gauge, and share gain and baseline.
    pulse : CutPulse
        The incident wave as samples.
    """

    step: float
    incident: Array
    reflected: Array
    transmitted: Array
    noise: Array
    memory: Array
    offset: Array
    known: int
    shared: bool
    pulse: CutPulse
    notes: tuple[str, ...]

    @property
    def time(self) -> Array:
        """Time since the incident wave reached face A, (n,) [s]."""
        return np.asarray(self.step * np.arange(len(self.incident)), dtype=float)


def _read_at(values: Array, place: float, count: int) -> tuple[Array, float]:
    """`count` samples from a place between samples on, by cubics through four, and what that does to white noise."""
    whole = math.floor(place)
    x = place - whole
    weights = np.array([-x * (x - 1) * (x - 2) / 6, (x + 1) * (x - 1) * (x - 2) / 2, -(x + 1) * x * (x - 2) / 2,
                        (x + 1) * x * (x - 1) / 6])  # fmt: skip
    padded = np.concatenate([np.full(2, values[0]), values, np.full(4, values[-1])])
    base = whole + 2
    if base < 1 or base + count + 2 > len(padded):
        raise RecordError("the record ends before the wave that is looked for")
    found = sum(weight * padded[base - 1 + k : base - 1 + k + count] for k, weight in enumerate(weights))
    return np.asarray(found), float(np.sqrt(np.square(weights).sum()))


def _carried(values: Array, step: float, bar: Bar, distance: float) -> tuple[Array, float]:
    """A whole signal as it was, or will be, a distance along its way, and what that does to white noise."""
    room = max(256, len(values) // 8)
    # the signal need not end at rest: it is led back to zero behind its end
    tail = values[-1] * (0.5 + 0.5 * np.cos(np.pi * (np.arange(room) + 1.0) / room))
    wave = np.concatenate([np.zeros(room), values, tail, np.zeros(room)])
    factor = transfer(len(wave), step, distance, radius=bar.radius, wave_speed=bar.wave_speed, nu=bar.nu)
    limit = first_mode(bar.nu).limit(bar.radius, bar.wave_speed)
    frequency = np.fft.rfftfreq(len(wave), step)
    factor = factor * (0.5 + 0.5 * np.cos(np.pi * np.clip((frequency / limit - 0.8) / 0.2, 0.0, 1.0)))
    there = np.fft.irfft(np.fft.rfft(wave) * factor, len(wave))
    return there[room : room + len(values)], float(np.sqrt(np.square(np.abs(factor)).mean()))


def at_faces(record: Record, rig: Rig, *, begin: float | None = None, end: float | None = None) -> Faces:
    """The three waves at the faces.

    Parameters
    ----------
    record : Record
        With baseline and sign; two signals (gauge of the incident bar, gauge of the receiving bar) or three (incident,
        reflected and transmitted wave, each alone).
    rig : Rig
    begin, end : float, optional
        Times in the record between which the incident wave passes its gauge [s].

    Raises
    ------
    RecordError
        Where waves overlap at a gauge, a part is missing, or fewer than 50 samples are left.
    """
    signals = record.strain.shape[1]
    shared = signals == 2
    if signals not in (2, 3):
        raise RecordError(f"found {signals} signals; two (one gauge per bar) or three waves are due")
    bar, step = rig.bar, record.step
    notes: list[str] = []
    distance = rig.incident_gauge if rig.correct_dispersion else 0.0
    cut = cut_pulse(record, bar=bar if distance else None, distance=distance, begin=begin, end=end)
    first = (cut.begin - record.start) / step
    delay = 2.0 * rig.incident_gauge / bar.wave_speed / step
    if shared and len(cut.strain) - 1 > delay * (1.0 + 1e-9):
        raise RecordError(
            f"incident and reflected wave overlap at the incident gauge: the pulse lasts "
            f"{(len(cut.strain) - 1) * step * 1e6:.4g} us, and {delay * step * 1e6:.4g} us lie between the two at "
            f"{rig.incident_gauge:.4g} m from the sphere; shorten the pulse or set the gauge further back"
        )
    behind = first + (rig.incident_gauge + rig.receiving_gauge) / bar.wave_speed / step
    length = len(record.strain)
    count = int(min(length - 3 - (first + delay), length - 3 - behind))
    if math.isfinite(rig.undisturbed):
        within = int(rig.undisturbed / step)
        if within < count:
            notes.append(
                f"waves from the far ends mix in after {rig.undisturbed * 1e6:.4g} us: what is later is left out"
            )
            count = within
    if count < _FEWEST:
        raise RecordError(f"{max(count, 0)} samples are left behind first touch, {_FEWEST} at least are needed")
    grown = np.ones(3)
    waves = []
    for k, (place, way) in enumerate(((first + delay, -rig.incident_gauge), (behind, -rig.receiving_gauge)), start=1):
        values = record.strain[:, min(k, signals - 1) if not shared else k - 1]
        if rig.correct_dispersion:
            values, grown[k] = _carried(_alone(values, first + delay if k == 1 and shared else 0.0), step, bar, way)
        wave, spread = _read_at(values, place, count)
        grown[k] *= spread
        waves.append(wave)
        if record.held[int(place) : int(place) + count].any():
            raise RecordError("samples are missing in the reflected or transmitted wave, more than can be filled")
    # behind its window the incident wave is known until the reflected one comes to the same gauge
    last = min(count, int(delay)) if shared else count
    incident = np.zeros(count)
    values = record.strain[:, 0]
    if rig.correct_dispersion:
        values, grown[0] = _carried(_before(values, first + delay if shared else length), step, bar, rig.incident_gauge)
    incident[:last] = values[round(first) : round(first) + last]
    channels = [0, 0, 1] if shared else [0, 1, 2]
    noise, memory = record.noise[channels] * grown, record.memory[channels] / np.square(grown)
    return Faces(
        step=step, incident=incident, reflected=waves[0], transmitted=waves[1], noise=noise, memory=memory,
        offset=record.offset[channels], known=last, shared=shared, pulse=cut, notes=(*cut.notes, *notes),
    )  # fmt: skip


def _before(values: Array, last: float) -> Array:
    """The signal without the wave that comes after `last`."""
    left = values.copy()
    left[int(last) + 1 :] = 0.0
    return left


def _alone(values: Array, first: float) -> Array:
    """The signal without the wave that passed before `first`."""
    cut = int(first)
    if cut <= 0:
        return values
    left = values.copy()
    left[:cut] = 0.0
    return left
