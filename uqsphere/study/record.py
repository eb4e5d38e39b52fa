"""The pulse of a clean record: time and strain, or volts with a factor, as smooth cubics.

Mending (offsets, spikes, dispersion, windows) is the work of `uqsphere shpb records`, which writes such a file.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from uqsphere.mechanics.pulses import MeasuredPulse
from uqsphere.study.document import Draft, Pulse
from uqsphere.study.fault import Fault, shown
from uqsphere.study.observed import opened
from uqsphere.units import UNITS

#: root mean square over the peak that the cubics may leave, and pieces at most
_FINE, _PIECES = 5e-4, 64
#: share of the peak that both ends may have, and from which on the pulse counts
_ENDS, _COUNTS = 0.1, 0.003
_ROUGH: Final = "uqsphere shpb records cuts, mends and writes such a file"


def measured_pulse(table: Pulse, draft: Draft) -> MeasuredPulse:
    """The pulse of the file that [pulse] names: least-squares cubics, their joints by Dierckx; raises Fault."""
    from scipy.interpolate import PPoly, generate_knots, make_lsq_spline

    with opened(str(table.file), draft) as found:
        columns = table.columns or tuple(found.headings[:2])
        if len(columns) != 2:
            raise Fault(f"found {len(columns)} column: time, then strain or volts are required", "columns")
        time_unit, unit = table.units or (None, None)
        volts = unit in UNITS["voltage"] or (unit is None and found.unit_of(columns[1], "voltage") is not None)
        time = found.numbers(columns[0], "time", time_unit)
        strain = (table.factor or 1.0) * found.numbers(columns[1], "voltage" if volts else "strain", unit)
        found.refuse("", "the time must rise from row to row", np.diff(time, prepend=-np.inf) <= 0.0)
    if volts and table.factor is None:
        raise Fault("factor is missing: the strain of one volt, such as factor = 1e-3", "factor")
    notes = list(found.notes)
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
    if len(inside) < 8:
        raise Fault(f"found {len(inside)} samples of a pulse, 8 or more are required", "file")
    first, last = max(int(inside[0]) - 1, 0), min(int(inside[-1]) + 1, len(strain) - 1)
    for k, end in ((first, "begins"), (last, "ends")):
        if abs(strain[k]) > _ENDS * peak:
            said = f"{shown(table.file)}: the pulse {end} at {strain[k] / peak:.0%} of its peak: cut it out at rest"
            raise Fault(f"{said}; {_ROUGH}", "file")
    time, level = time[first : last + 1] - time[first], strain[first : last + 1] / peak
    # from 0 to 0
    level[[0, -1]], weight = 0.0, np.ones(len(level))
    weight[[0, -1]] = 1e3
    *_, knots = generate_knots(time, level, w=weight, k=3, s=len(level) * _FINE**2, nest=_PIECES + 7)
    spline = make_lsq_spline(time, level, knots, 3, weight)
    if (misfit := float(np.abs(level - spline(time)).max())) > 0.02:
        said = f"its cubics leave {misfit:.2g} of the peak: sharp edges are rounded, or the record is noisy"
        notes.append(f"{said}; {_ROUGH}")
    for note in notes:
        draft.warn(("pulse", "file"), f"{shown(table.file)}: {note}")
    fine = np.linspace(0.0, time[-1], 2000)
    curve = spline(fine)
    top = float(curve.max())
    rise = fine[int(np.argmax(curve >= 0.9 * top))] - fine[int(np.argmax(curve >= 0.1 * top))]
    cubics = PPoly.from_spline((spline.t, spline.c, 3)).c[::-1, 3:-3].T / top
    cubics[0, 0] = 0.0
    return MeasuredPulse(breaks=tuple(knots[3:-3].tolist()), coefficients=tuple(map(tuple, cubics.tolist())),
                         peak=peak * top, rise=float(rise))  # fmt: skip
