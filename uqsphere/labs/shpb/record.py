"""A record from its files: strains over even time, mended in named steps.

read · spikes · clipped · baseline · drift · sign · gauges.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from uqsphere.errors import UsageError
from uqsphere.labs.shpb.columns import Traces, read_traces
from uqsphere.labs.shpb.document import RecordDocument
from uqsphere.labs.shpb.mending import about_rest, cut_out, joined, rest_of, without_faults
from uqsphere.labs.shpb.signals import Changes, Signal, Stay, first_stay, first_wave

#: passes of the incident bar that no pulse lasts
_PASSES: Final = 12.0
#: share of the largest strain by which the incident wave is found, however large echoes are later
_INCIDENT: Final = 0.2


@dataclass(frozen=True, kw_only=True)
class Record:
    """Mended signals over even time: `start` and `step` [s].

    reflected : None where the incident gauge records both waves.
    """

    start: float
    step: float
    incident: Signal
    receiving: Signal
    changes: Changes
    reflected: Signal | None = None


def load_record(document: RecordDocument, folder: Path) -> Record:
    """The record of an input file, read and mended.

    Raises UsageError for columns, units or a clock that cannot be, and for a signal without a wave
        or a rest.
    """
    changes, asked = Changes(), document.record
    traces = read_traces(document, folder, changes)
    step = traces.step
    mend = partial(without_faults, step=step, changes=changes)
    by_role = {role: [*map(mend, gauges)] for role, gauges in traces.by_role.items()}
    stays = [
        first_stay(trace.strain - rest_of(trace.strain), step, _INCIDENT, trace.name)
        for trace in by_role["incident"]
    ]
    limits = _limits(document, stays, step)
    polarity = {"auto": 0.0, "tension": 1.0, "compression": -1.0}[asked.polarity]
    signals: dict[str, Signal] = {}
    pressing = 0.0  # sign of the incident wave in the file
    for role, gauges in by_role.items():
        end, turned, names = None, list[Signal](), list[str]()
        if role == "receiving":
            end = max(min(stay.first - 2 * stay.rising for stay in stays), 0)
        for trace in gauges:
            if asked.aligned:
                signal = cut_out(trace, step, changes)
            else:
                signal = about_rest(trace, step, (end, limits[role]), changes)
            # one sign a bar: a reflected wave has the sign of its incident gauge
            sign = polarity or -signal.wave.sign
            if role == "reflected":
                sign = polarity or -pressing
            if role == "incident" and not turned:
                pressing = -sign
            if sign < 0.0:
                names.append(signal.name)
            passing = replace(signal.wave, sign=signal.wave.sign * sign)
            turned.append(replace(signal, strain=signal.strain * sign, wave=passing))
        if names and not polarity:
            text = "compression is positive in the file; the sign is changed"
            changes.add("sign", ", ".join(names), text)
        signals[role] = joined(turned, step, limits[role], changes)
    if asked.window is not None:
        signals["incident"] = _in_window(signals["incident"], asked.window, traces)
    return Record(start=traces.start, step=step, changes=changes, **signals)


def _limits(document: RecordDocument, stays: Sequence[Stay], step: float) -> dict[str, float]:
    """Sample before which the first wave of a signal begins, the first echo of a far end, from the
    waves of the incident gauges.

    Raises UsageError for a pulse longer than any striker gives.
    """
    bar, behind = document.incident_bar, document.receiving_bar
    limits = dict.fromkeys(("incident", "reflected", "receiving"), math.inf)
    passage = (bar.length or math.inf) / bar.wave_speed
    passes = min(stay.last - stay.first + 1 for stay in stays) * step / passage
    if passes > _PASSES:
        raise UsageError(
            f"the pulse lasts {passes:.0f} passes of the incident bar. Is the time in another unit "
            "(record.time_unit)?"
        )
    if not document.record.aligned:
        delay = bar.gauge / bar.wave_speed + behind.gauge / behind.wave_speed + behind.echo
        first = min(stay.first for stay in stays)
        limits["receiving"] = first + delay / step
        limits["incident"] = first + 2.0 * passage / step
    return limits


def _in_window(signal: Signal, window: tuple[float, float], traces: Traces) -> Signal:
    """An incident signal whose wave stands between two given times [s]."""
    begin, end = (round((time - traces.start) / traces.step) for time in window)
    if not 0 <= begin < end < len(signal.strain):
        raise UsageError("record.window must be [begin, end] within the record")
    inside = np.zeros(len(signal.strain))
    inside[begin : end + 1] = signal.strain[begin : end + 1]
    wave = first_wave(inside, traces.step, signal.noise, signal.name)
    return replace(signal, wave=replace(wave, foot=begin, end=end))
