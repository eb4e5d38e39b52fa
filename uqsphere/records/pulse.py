"""The incident pulse of a record: found, cut out, corrected for dispersion, and put into few smooth cubics."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.interpolate import PPoly, make_lsq_spline

from uqsphere.arrays import Array
from uqsphere.mechanics.bars import first_mode, transfer
from uqsphere.mechanics.pulses import MeasuredPulse
from uqsphere.records.record import Record, Wiring, first_wave, make_record, mend
from uqsphere.records.table import RecordError, read_bytes, read_table

#: samples of a pulse, at the least
_FEWEST: Final = 30
#: cubics, at the most, and samples of each, at the least
_MOST_PIECES, _SAMPLES = 64, 5
#: misfit over the peak that is not worth a further cubic where there is no noise
_FINE: Final = 2e-4
#: what is taken in before the foot of the rise and behind that of the fall, over the way from there to half the peak
_FEET: Final = 0.2
#: share of the peak below which a pulse is over
_OVER: Final = 0.02
#: how a window is asked for, on the command line and in a study
WINDOW: Final = '--window "BEGIN us,END us" (in a study pulse.window)'


@dataclass(frozen=True, kw_only=True)
class Bar:
    """What the dispersion of a bar depends on: radius [m], wave speed c0 [m/s], Poisson's ratio."""

    radius: float
    wave_speed: float
    nu: float


@dataclass(frozen=True, kw_only=True)
class CutPulse:
    """The pulse as samples.

    step : time between samples [s].
    strain : (n,) array; compression above zero, from rest to rest.
    begin : time of the first sample in the record [s].
    noise, memory : standard deviation of a sample, and samples over which it is correlated.
    corrected : distance over which the dispersion was corrected [m], 0 for not at all.
    inside : share of the energy inside the band in which the correction holds, 1 without one.
    """

    step: float
    strain: Array
    begin: float
    noise: float
    memory: float
    notes: tuple[str, ...]
    corrected: float = 0.0
    inside: float = 1.0


def cut_pulse(record: Record, *, bar: Bar | None = None, distance: float = 0.0, begin: float | None = None,
              end: float | None = None) -> CutPulse:  # fmt: skip
    """The incident pulse of a record that has its baseline and sign.

    bar, distance : Bar, float; with a bar: dispersion is corrected from the gauge, on the surface, to the face a
    `distance` [m] away.
    begin, end : times of the record [s] between which the pulse stands; found by itself if not given.

    Raises RecordError where no pulse is found, a part of it is missing, or it has fewer than 30 samples.
    """
    values, noise = -record.strain[:, 0], float(record.noise[0])
    notes, memory = list(record.notes), float(record.memory[0])
    time = record.time
    first = last = 0
    if begin is None or end is None:
        wave = first_wave(values, record.step, noise)
        if wave.sign < 0.0:
            raise RecordError("the first wave of the record does not press: there is no incident pulse")
        if not wave.ended:
            raise RecordError(
                "the record begins or ends inside the pulse: its end is not at the level of its beginning; "
                f"{WINDOW} takes what is there of it"
            )
        lead, tail = (max(2, round(_FEET * length)) for length in (wave.rising, wave.end - wave.falling))
        first, last = max(wave.foot - lead, 0), min(wave.end + tail, len(values) - 2)
    if begin is not None:
        first = int(np.searchsorted(time, begin))
    if end is not None:
        last = int(np.searchsorted(time, end, side="right")) - 1
    if not 0 <= first < last < len(values):
        raise RecordError(
            f"the window of the pulse lies outside the record, or is empty: the record has {time[0] * 1e6:.6g} to "
            f"{time[-1] * 1e6:.6g} us"
        )
    record.refuse_held(0, first, last, "inside the pulse")
    if last - first + 1 < _FEWEST:
        raise RecordError(
            f"the pulse has {last - first + 1} samples, {_FEWEST} at least are needed: if this is not the pulse, "
            f"{WINDOW} says where it stands"
        )
    inside = 1.0
    if bar is not None and distance > 0.0:
        values, first, last, inside = _corrected(values, first, last, record.step, bar, distance, notes)
        # of white noise the band holds this share
        share = min(1.0, 1.8 * first_mode(bar.nu).limit(bar.radius, bar.wave_speed) * record.step * memory)
        noise, memory = noise * np.sqrt(share), memory / share
    strain = values[first : last + 1].copy()
    return CutPulse(step=record.step, strain=strain, begin=float(time[0] + first * record.step), noise=float(noise),
                    memory=memory, notes=tuple(notes),
                    corrected=distance if bar is not None else 0.0, inside=inside)  # fmt: skip


def carried(wave: Array, step: float, bar: Bar, distance: float) -> tuple[Array, npt.NDArray[np.complex128]]:
    """A wave that is at rest at both ends, a distance [m] along its way, and what its spectrum was multiplied with."""
    factor = transfer(len(wave), step, distance, radius=bar.radius, wave_speed=bar.wave_speed, nu=bar.nu)
    limit = first_mode(bar.nu).limit(bar.radius, bar.wave_speed)
    # what lies beyond the band is noise with an unknown lag, and the factor of the surface is at its largest there
    beyond = np.clip((np.fft.rfftfreq(len(wave), step) / limit - 0.8) / 0.2, 0.0, 1.0)
    factor = factor * (0.5 + 0.5 * np.cos(np.pi * beyond))
    return np.fft.irfft(np.fft.rfft(wave) * factor, len(wave)), factor


def _corrected(values: Array, first: int, last: int, step: float, bar: Bar, distance: float,
               notes: list[str]) -> tuple[Array, int, int, float]:  # fmt: skip
    """The wave at the face: the window alone is carried there, with room for what dispersion moves."""
    room = max(64, round(4.0 * bar.radius / bar.wave_speed / step * (1.0 + distance / bar.radius / 20.0)))
    # the tail that dispersion has drawn out belongs to the wave, the next wave does not
    other = np.flatnonzero(np.abs(values[last + 1 : last + 1 + room]) > 0.25 * np.abs(values[first : last + 1]).max())
    first, last = max(first - room, 0), min(last + (int(other[0]) // 2 if len(other) else room), len(values) - 1)
    wave = np.zeros(3 * (last - first + 1) + 4 * room)
    place = slice(2 * room, 2 * room + last - first + 1)
    wave[place] = values[first : last + 1]
    # a wave cut off its record begins and ends at rest
    ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(room // 4) + 0.5) / (room // 4))
    wave[place.start : place.start + len(ramp)] *= ramp
    wave[place.stop - len(ramp) : place.stop] *= ramp[::-1]
    there, _ = carried(wave, step, bar, distance)
    limit = first_mode(bar.nu).limit(bar.radius, bar.wave_speed)
    energy, frequency = np.square(np.abs(np.fft.rfft(wave))), np.fft.rfftfreq(len(wave), step)
    inside = float(energy[frequency <= limit].sum() / energy.sum())
    notes.append(
        f"dispersion over {distance:.4g} m is corrected up to {limit / 1e3:.4g} kHz, where {inside:.4%} of the energy "
        "is; what is above is left out"
    )
    moved = values.copy()
    moved[first : last + 1] = there[place]
    peak = float(np.abs(there[place]).max())
    above = np.flatnonzero(np.abs(there[place]) > _OVER * peak)
    high, low = (np.flatnonzero(there[place] > share * peak) for share in (0.5, 0.1))
    # what is below that share on the way up and down belongs to the wave as well
    lead, tail = max(2, int(high[0] - low[0])), max(2, int(low[-1] - high[-1]))
    return moved, first + max(int(above[0]) - lead, 0), first + min(int(above[-1]) + tail, last - first), inside


def fit_pulse(cut: CutPulse, source: str = "", digest: str = "") -> MeasuredPulse:
    """Least-squares cubics, as few as leave the noise alone: where the misfit is largest a piece is halved.

    The curve has continuous slope and curvature, and is zero at both ends.

    Raises RecordError where the curve does not rise above zero.
    """
    place = cut.step * np.arange(len(cut.strain))
    length, size = float(place[-1]), float(np.abs(cut.strain).max())
    strain = cut.strain.copy()
    strain[[0, -1]] = 0.0
    weight = np.ones(len(strain))
    weight[[0, -1]] = 1e3
    joints = np.linspace(0.0, length, 5)
    allowed = max(1.05 * cut.noise, _FINE * size)
    while True:
        knots = np.concatenate([[0.0] * 3, joints, [length] * 3])
        spline = make_lsq_spline(place, strain, knots, 3, weight)
        misfit = np.square(strain - spline(place))
        piece = np.clip(np.searchsorted(joints, place, side="right") - 1, 0, len(joints) - 2)
        loss, count = np.bincount(piece, misfit), np.bincount(piece)
        # a piece with less than its noise needs no further joint
        gain = np.where((count >= 2 * _SAMPLES) & (loss / count > np.square(allowed)), loss, 0.0)
        if len(joints) > _MOST_PIECES or not (gain > 0.0).any():
            break
        worst = int(np.argmax(gain))
        joints = np.insert(joints, worst + 1, 0.5 * (joints[worst] + joints[worst + 1]))
    left = float(np.sqrt(misfit[1:-1].mean()))
    curve = PPoly.from_spline((spline.t, spline.c, 3))
    fine = np.linspace(0.0, length, 20 * len(joints) + 1)
    level = spline(fine)
    peak = float(level.max())
    if not peak > 0.0:
        raise RecordError("the pulse does not press: its compression is nowhere above zero")
    ascending = curve.c[::-1].T[3:-3] / peak  # the pieces of no length at both ends
    ascending[0, 0] = 0.0
    high, low = np.argmax(level >= 0.9 * peak), np.argmax(level >= 0.1 * peak)
    notes = [*cut.notes, f"{len(joints) - 1} cubics follow the record to {left / peak:.2g} of its peak"]
    if left > 1.5 * allowed:
        notes.append("the record moves faster than its cubics can: its sharpest edges are rounded")
    return MeasuredPulse(
        breaks=tuple(float(joint) for joint in joints),
        coefficients=tuple(tuple(float(c) for c in row) for row in ascending), peak=peak,
        noise=float(cut.noise * np.sqrt(cut.memory * cut.step / length) / peak), rise=float(fine[high] - fine[low]),
        source=source, digest=digest, notes=tuple(notes),
    )  # fmt: skip


def measured_pulse(path: str | Path, *, wiring: Wiring | None = None, columns: Sequence[str] = (),
                   bar: Bar | None = None, distance: float = 0.0, begin: float | None = None,
                   end: float | None = None, polarity: str = "auto") -> MeasuredPulse:  # fmt: skip
    """The pulse of a file with time and one signal: read, mended, cut, corrected and fitted.

    `polarity`: ``auto`` takes the first wave as compression, ``tension`` a record that is positive in tension,
    ``compression`` one that is positive in compression.

    Raises RecordError as `read_table`, `make_record`, `mend`, `cut_pulse` and `fit_pulse`.
    """
    path = Path(path)
    record = mend(make_record(read_table(path), 1, wiring=wiring, columns=columns), polarity)
    cut = cut_pulse(record, bar=bar, distance=distance, begin=begin, end=end)
    return fit_pulse(cut, path.name, hashlib.sha256(read_bytes(path)).hexdigest())
