"""What a laboratory reads off one test: largest forces with what doubts them, energies, equilibrium, and the fit of an
elastic sphere where it fits; bar speed and gains from a calibration shot.

One, two and three waves: P_B = -E_b F_0 eps_t, P_A = -E_b F_0 (eps_i + eps_r), and their mean.  Energies follow from
the waves, W = E_b F_0 c0 ∫ eps² dt (G. T. Gray III, ASM Handbook 8, 2000, from memory).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import savgol_filter
from scipy.special import ndtri

from uqsphere.arrays import Array
from uqsphere.mechanics import bars
from uqsphere.records.inverse import Faces, Forces, Inverse, Rig, at_faces, forces_of, invert
from uqsphere.records.record import Record, first_wave
from uqsphere.records.table import RecordError
from uqsphere.uq.estimate import NORMAL

#: share of the largest force above which its top stands, and part of the top that one parabola follows
_TOP, _PART = 0.8, 3
#: share by which single samples, the gauges of a bar, or both faces may differ at the largest force before it is
#: doubted: real rock tests that agree with their authors within 3 % show up to 0.09
_DOUBT: Final = 0.25
_SINGLE: Final = 0.05
#: difference of the forces over their mean that counts as equilibrium
_BALANCE: Final = 0.05
#: what an elastic sphere may leave unexplained of the largest transmitted wave, how far its E* may lie from that of
#: the study, and how much more force a broken sphere may bear, before nothing is said of it
_UNEXPLAINED, _FAR, _AFTER = 0.05, 4.0, 1.3
#: share of a pulse about its middle that is a plateau
_PLATEAU: Final = 0.5


@dataclass(frozen=True, kw_only=True)
class Peak:
    """The largest force at a face [N] with its 95 % interval, its time after first touch [s], and what doubts it."""

    time: float
    value: float
    low: float
    high: float
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Energies:
    """Energies of the waves up to a time [J]; `absorbed` stays between the bars."""

    incident: float
    reflected: float
    transmitted: float

    @property
    def absorbed(self) -> float:
        """What the incident wave brings and the others do not take away."""
        return self.incident - self.reflected - self.transmitted


@dataclass(frozen=True, kw_only=True)
class Reading:
    """One test.

    `peaks` at A by two waves, at B by one, and of their mean by three; `energies` to the largest force at B, and to the
    end, None (as what follows) where incident and reflected wave are not told apart; `balanced` the time from which the
    forces first agree within 5 % of their mean [s], None for never, and `balance` the share of the time from half the
    largest force to it in which they do; `inverse` is None where no elastic sphere explains the record, and `broke`
    whether the end of its elastic contact can be its fracture; `withheld` says why not.
    """

    faces: Faces
    forces: Forces
    peaks: Mapping[str, Peak]
    energies: tuple[Energies, ...] | None
    balanced: float | None
    balance: float | None
    loading_rate: float
    inverse: Inverse | None
    broke: bool
    withheld: tuple[str, ...]
    touch: float
    notes: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """What a shot without a specimen says: wave speed of the bars [m/s], and factors to the strains of both gauges."""

    wave_speed: float
    gains: tuple[float, float]
    notes: tuple[str, ...]


def _follow(force: Array) -> tuple[Array, int]:
    """The force by parabolas over a third of its top, and how many samples one of them follows."""
    at = int(np.argmax(force))
    low = np.flatnonzero(force < _TOP * force[at])
    before, behind = low[low < at], low[low > at]
    top = (int(behind[0]) if len(behind) else len(force)) - (int(before[-1]) if len(before) else 0)
    width = min(max(5, 2 * (top // (2 * _PART)) + 1), len(force) - 1 + len(force) % 2)
    return savgol_filter(force, width, 2), width


def _peak(forces: Forces, faces: Faces, face: str, scales: tuple[float, float]) -> Peak:
    """The largest force at a face, or of their mean, from its top and not from its highest sample."""
    own = [part * one for part, one in zip((scales[0], scales[0], scales[1]), faces.noise, strict=True)]
    force, sd, noises = {
        "A": (forces.force_a, forces.sd_a, own[:2]),
        "B": (forces.force_b, forces.sd_b, own[2:]),
        "mean": (0.5 * (forces.force_a + forces.force_b), 0.5 * np.hypot(forces.sd_a, forces.sd_b),
                 [0.5 * one for one in own]),
    }[face]  # fmt: skip
    memory = float({"A": faces.memory[:2], "B": faces.memory[2:], "mean": faces.memory}[face].max())
    # a single sample that no step of mending took out must not set the width of the top
    curve, width = _follow(median_filter(force, 5, mode="nearest"))
    curve = savgol_filter(force, width, 2)
    at = int(np.argmax(curve))
    value = float(curve[at])
    noise = math.hypot(*noises)
    # the middle of a parabola through `width` samples has 9/4 of the variance of their mean
    kept = noise * math.sqrt(min(1.0, 2.25 * memory / width))
    # of several places that might as well be the top the highest is found too high, by Blom's mean of the largest of m
    rivals = 1.0 + float((curve > value - 2.0 * kept).sum()) / (width * max(1.0, memory / width))
    value -= kept * float(ndtri((rivals - 0.375) / (rivals + 0.25)))
    spread = NORMAL * math.hypot(math.sqrt(max(float(sd[at]) ** 2 - noise**2, 0.0)), kept)
    low, high, doubts = value - spread, value + spread, []
    highest = float(force.max())
    if highest > value + 5.0 * noise + _SINGLE * value:
        doubts.append(f"single samples reach {highest * 1e-3:.4g} kN, which those around them do not bear out")
        high = max(high, highest)
    if at >= len(force) - max(3, width // 2):
        doubts.append("the force is at its largest where the record ends: it is at least this")
        high = max(high, 2.0 * scales[0] * float(np.abs(faces.incident).max()))
    if faces.merged and face != "B":
        doubts.append("incident and reflected wave overlap at the incident gauge: it is not known")
    bent = faces.spread[at] * scales[1]
    if face == "B" and bent > _DOUBT * value:
        doubts.append(f"the gauges of the receiving bar differ by {2.0 * bent / value:.0%} there")
    if face == "B" and (bent > _DOUBT * value or faces.alone[1]):
        low, high = low - bent, high + bent
    return Peak(time=float(forces.time[at]), value=value, low=low, high=high, doubts=tuple(doubts))


def _doubted(peaks: dict[str, Peak], incident: float, bound: float) -> dict[str, Peak]:
    """The peaks held against each other, the wave that made them, and what the specimen can bear."""
    a, b = peaks["A"], peaks["B"]
    found = dict(peaks)
    for face, own, other in (("A", a, b), ("B", b, a)):
        doubts, low, high = list(own.doubts), own.low, own.high
        apart = own.low > other.high or own.high < other.low
        if apart and abs(own.value - other.value) > _DOUBT * max(own.value, other.value):
            doubts.append(f"the other face bears {other.value * 1e-3:.4g} kN: gauges, gains or one wave are wrong")
            low, high = min(low, other.low), max(high, other.high)
        if own.low > 2.0 * incident:
            doubts.append(f"an incident wave of {incident * 1e-3:.4g} kN cannot press with more than twice as much")
            low = min(low, 2.0 * incident)
        if own.low > bound:
            doubts.append(f"it is beyond the {bound * 1e-3:.4g} kN that such a specimen can bear")
            low = min(low, bound)
        found[face] = replace(own, doubts=tuple(doubts), low=low, high=high)
    return found


def read_test(record: Record, rig: Rig, columns: Mapping[str, float], *, gain_sd: float = 0.01,
              window: tuple[float | None, float | None] = (None, None), receiving: float | None = None,
              sphere: bool = True, bound: float = math.inf) -> Reading:  # fmt: skip
    """Forces, energies and equilibrium of a test, and stiffness and end of the elastic contact where a sphere fits.

    record : mended, of two signals or three; see `at_faces`.
    columns : numbers of the scene, SI.
    gain_sd : relative standard deviation of the gain of each gauge.
    window : times of the record between which the incident wave passes its gauge [s]; found by itself where None.
    receiving : E A of the receiving bar [N], where it is another than the incident bar.
    sphere : whether the specimen is the sphere of the study.
    bound : force that no such specimen bears [N].

    Raises RecordError as `at_faces`.
    """
    faces = at_faces(record, rig, begin=window[0], end=window[1])
    scale = columns["bars.E"] * float(bars.section(columns["bars.diameter"]))
    behind = scale if receiving is None else receiving
    forces = forces_of(faces, columns, gain_sd, receiving)
    peaks = {face: _peak(forces, faces, face, (scale, behind)) for face in ("A", "B", "mean")}
    if not peaks["B"].low > 0.0:
        raise RecordError("no force at the receiving face rises above the noise of the record")
    peaks = _doubted(peaks, math.inf if faces.merged else scale * float(faces.pulse.strain.max()), bound)
    top = int(np.searchsorted(forces.time, peaks["B"].time))
    flow = tuple(part * faces.step for part in (scale * rig.bar.wave_speed, behind * rig.behind.wave_speed))
    energies = None if faces.merged else tuple(
        Energies(incident=flow[0] * float(np.square(faces.incident[:last]).sum()),
                 reflected=flow[0] * float(np.square(faces.reflected[:last]).sum()),
                 transmitted=flow[1] * float(np.square(faces.transmitted[:last]).sum()))
        for last in (top + 1, len(forces.time))
    )  # fmt: skip
    said = (
        "the specimen is said to be no sphere" if not sphere
        else "the model of the sphere has two equal bars: of unequal ones forces, equilibrium and energies are said"
        if receiving is not None
        else "incident and reflected wave overlap at the incident gauge" if faces.merged else ""
    )  # fmt: skip
    inverse, broke, withheld = (None, False, (said,)) if said else _fitted(faces, forces, columns, gain_sd)
    balanced, balance, rate = _balance(forces, peaks["B"].value, top)
    return Reading(
        faces=faces, forces=forces, peaks=peaks, energies=energies,
        balanced=None if faces.merged else balanced,
        balance=None if faces.merged else balance, loading_rate=rate, inverse=inverse, broke=broke, withheld=withheld,
        touch=faces.pulse.begin + rig.incident_gauge / rig.bar.wave_speed,
        notes=inverse.notes if inverse is not None else faces.notes,
    )  # fmt: skip


def _balance(forces: Forces, largest: float, top: int) -> tuple[float | None, float, float]:
    """Time from which the forces first agree [s], share of the rise in which they do, and loading rate [N/s]."""
    width = _follow(median_filter(forces.force_b, 5, mode="nearest"))[1]
    curve_a, curve_b = savgol_filter(forces.force_a, width, 2), savgol_filter(forces.force_b, width, 2)
    half = min(int(np.argmax(curve_b > 0.5 * largest)), top)
    mean = 0.5 * (curve_a + curve_b)
    even = (np.abs(curve_a - curve_b) <= 2.0 * _BALANCE * np.abs(mean)) & (mean > 0.1 * largest)
    step = float(forces.time[1] - forces.time[0])
    rise = max(float(forces.time[top] - forces.time[half]), step)
    first = float(forces.time[np.argmax(even)]) if even.any() else None
    return first, float(even[half : top + 1].mean()), 0.5 * largest / rise


def _fitted(faces: Faces, forces: Forces, columns: Mapping[str, float],
            gain_sd: float) -> tuple[Inverse | None, bool, tuple[str, ...]]:  # fmt: skip
    """The fit of an elastic sphere, whether it can have broken where that ends, or why nothing is taken from it."""
    try:
        found = invert(faces, columns, gain_sd=gain_sd)
    except RecordError as error:
        return None, False, (str(error),)
    stiff, end, withheld = found.stiffness, found.departure, []
    if stiff.unexplained > _UNEXPLAINED:
        withheld.append(
            f"the contact of an elastic sphere leaves {stiff.unexplained:.0%} of the wave unexplained (misfit "
            f"{stiff.misfit:.3g} times the noise)"
        )
    if not 1.0 / _FAR < stiff.modulus / stiff.expected < _FAR:
        withheld.append(f"its E* of {stiff.modulus * 1e-9:.4g} GPa is far from the {stiff.expected * 1e-9:.4g} GPa of "
                        "the study")  # fmt: skip
    if withheld or end is None:
        return (None if withheld else found), False, tuple(withheld)
    later = float(median_filter(forces.force_b, 5, mode="nearest")[forces.time > end.time].max(initial=0.0))
    if later <= _AFTER * end.force_b[2]:
        return found, True, ()
    said = f"behind the end of its elastic contact the specimen bears {later * 1e-3:.4g} kN: it did not break there"
    return found, False, (said,)


def calibrate(record: Record, rig: Rig, striker_speed: float = 0.0) -> Calibration:
    """Wave speed and gains from a shot without a specimen.

    One signal: the incident bar alone, whose free end sends the wave back.  Two: both bars in touch; the wave goes
    through.  With the speed of a striker of the bar's own section and material, the plateau should be v/(2 c0).

    Raises RecordError where the second passage of the wave is not found.
    """
    first = -record.strain[:, 0]
    wave = first_wave(first, record.step, float(record.noise[0]))
    through = record.strain.shape[1] > 1
    far = -record.strain[:, 1] if through else -first
    way = rig.incident_gauge + rig.receiving_gauge if through else 2.0 * rig.incident_gauge
    expected = way / rig.bar.wave_speed / record.step
    shape = first[wave.foot : wave.end + 1]
    lags = np.arange(int(0.8 * expected), int(1.25 * expected) + 1)
    lags = lags[wave.foot + lags + len(shape) <= len(far)]
    if len(lags) < 3 or not expected > 10.0:
        raise RecordError("the calibration shot ends before its wave passes a second time, or its gauges are too near")
    alike = np.array([float(shape @ far[wave.foot + lag : wave.foot + lag + len(shape)]) for lag in lags])
    best = int(np.clip(np.argmax(alike), 1, len(lags) - 2))
    bend = alike[best - 1] - 2.0 * alike[best] + alike[best + 1]
    lag = float(lags[best]) + (0.5 * float(alike[best - 1] - alike[best + 1]) / float(bend) if bend < 0.0 else 0.0)
    speed = way / (lag * record.step)
    again = far[wave.foot + int(lags[best]) :][: len(shape)]
    likeness = float(alike[best]) / math.sqrt(float(np.square(shape).sum() * np.square(again).sum()))
    if likeness < 0.9:
        raise RecordError(
            f"the second passage of the calibration wave is only {likeness:.0%} like the first: bars that do not touch "
            "well, or a specimen between them?"
        )
    ratio = math.sqrt(float(np.square(shape).sum() / np.square(again).sum()))
    gain, notes = 1.0, [f"the shot gives a wave speed of {speed:.5g} m/s over {way:.4g} m"]
    if striker_speed > 0.0:
        middle = shape[int(len(shape) * 0.5 * (1.0 - _PLATEAU)) : int(len(shape) * 0.5 * (1.0 + _PLATEAU))]
        gain = 0.5 * striker_speed / speed / float(np.median(middle))
        notes.append(f"a striker of the bar's material at {striker_speed:.4g} m/s: strains times {gain:.4g}")
    gains = (gain, gain * ratio if through else gain)
    if through:
        notes.append(
            f"the receiving gauge shows {1.0 / ratio:.4g} of the incident one: its strains times {gains[1]:.4g}"
        )
    return Calibration(wave_speed=speed, gains=gains, notes=tuple(notes))
