"""The pulse of a clean record: time and strain, or volts with a factor, as smooth cubics.

Mending (offsets, spikes, dispersion, windows) is the work of `uqsphere shpb records`, which writes such a file.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.mechanics.pulses import MeasuredPulse
from uqsphere.study.document import Pulse
from uqsphere.study.draft import Draft
from uqsphere.study.fault import Fault, shown
from uqsphere.study.observed import inside_folder, opened
from uqsphere.units import UNITS

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

#: largest misfit over the peak that a cubic may leave, pieces at most, samples that a piece needs
_FINE, _PIECES, _SAMPLES = 2e-3, 64, 4
#: share of the peak that both ends may have, and from which on the pulse counts
_ENDS, _COUNTS = 0.1, 0.003
_ROUGH: Final = "uqsphere shpb records cuts, mends and writes such a file"


def measured_pulse(table: Pulse, draft: Draft) -> MeasuredPulse:
    """The pulse of the file that [pulse] names; raises Fault."""
    assert table.file is not None
    with opened(table.file, draft) as found:
        columns = table.columns or tuple(found.headings[:2])
        if len(columns) != 2:
            raise Fault(f"found {len(columns)} column: time, then strain or volts are required", "columns")
        time_unit, unit = table.units or (None, None)
        dimension, factor = "strain", table.factor or 1.0
        if unit in UNITS["voltage"] or (unit is None and found.unit_of(columns[1], "voltage")):
            dimension = "voltage"
        time = found.numbers(columns[0], "time", time_unit)
        strain = factor * found.numbers(columns[1], dimension, unit)
        found.refuse("", "the time must rise from row to row", np.diff(time, prepend=-np.inf) <= 0.0)
    if dimension == "voltage" and table.factor is None:
        raise Fault("factor is missing: the strain of one volt, such as factor = 1e-3", "factor")
    notes = list(found.notes)
    if len(time) < 8:
        raise Fault(f"found {len(time)} samples, 8 or more are required", "file")
    if -strain.min() > strain.max():
        strain = -strain
        notes.append("the largest strain is negative: compression is taken as positive")
    peak = float(strain.max())
    if strain.min() < -_ENDS * peak:
        said = f"{shown(table.file)}: the strain turns to tension, {strain.min() / peak:.0%} of its peak"
        raise Fault(f"{said}: cut the reflected wave off; {_ROUGH}", "file")
    # noise swings to both sides: what lies below zero ahead of the pulse says how far it goes above
    noise = -1.5 * strain[: int(np.argmax(strain > _ENDS * peak))].min(initial=0.0)
    inside = np.flatnonzero(np.abs(strain) > max(_COUNTS * peak, noise))
    first, last = max(int(inside[0]) - 1, 0), min(int(inside[-1]) + 1, len(strain) - 1)
    for k, end in ((first, "begins"), (last, "ends")):
        if abs(strain[k]) > _ENDS * peak:
            said = f"{shown(table.file)}: the pulse {end} at {strain[k] / peak:.0%} of its peak: cut it out at rest"
            raise Fault(f"{said}; {_ROUGH}", "file")
    cubics, misfit = _cubics(time[first : last + 1] - time[first], strain[first : last + 1] / peak)
    if misfit > 0.02:
        said = f"its cubics leave {misfit:.2g} of the peak: sharp edges are rounded, or the record is noisy"
        notes.append(f"{said}; {_ROUGH}")
    fine = np.linspace(0.0, cubics.x[-1], 2000)
    level = cubics(fine)
    top = float(level.max())
    rise = fine[int(np.argmax(level >= 0.9 * top))] - fine[int(np.argmax(level >= 0.1 * top))]
    digest = hashlib.sha256(inside_folder(table.file, draft, "file").read_bytes()).hexdigest()
    for note in notes:
        draft.warn(("pulse", "file"), f"{shown(table.file)}: {note}")
    return MeasuredPulse(
        breaks=tuple(cubics.x.tolist()), coefficients=tuple(map(tuple, (cubics.c[::-1].T / top).tolist())),
        peak=peak * top, rise=float(rise), source=table.file, digest=digest, notes=tuple(notes),
    )  # fmt: skip


def _cubics(time: Array, level: Array) -> tuple[PPoly, float]:
    """Smooth cubics from 0 to 0, and their largest misfit: the worst piece is halved in turn."""
    from scipy.interpolate import PPoly, make_lsq_spline

    level = level.copy()
    level[[0, -1]] = 0.0
    weight = np.ones(len(level))
    weight[[0, -1]] = 1e3
    joints = np.linspace(0.0, time[-1], 5)
    while True:
        spline = make_lsq_spline(time, level, np.concatenate([[0.0] * 3, joints, [time[-1]] * 3]), 3, weight)
        misfit = np.abs(level - spline(time))
        piece = np.clip(np.searchsorted(joints, time, side="right") - 1, 0, len(joints) - 2)
        worst = np.zeros(len(joints) - 1)
        np.maximum.at(worst, piece, misfit)
        # a piece is halved only if both halves keep their samples
        splits = (worst > _FINE) & (np.bincount(piece, minlength=len(worst)) >= 2 * _SAMPLES)
        if len(joints) > _PIECES or not splits.any():
            break
        k = int(np.argmax(np.where(splits, worst, 0.0)))
        joints = np.insert(joints, k + 1, 0.5 * (joints[k] + joints[k + 1]))
    cubics = PPoly(PPoly.from_spline((spline.t, spline.c, 3)).c[:, 3:-3], joints)
    cubics.c[-1, 0] = 0.0
    return cubics, float(misfit.max())
