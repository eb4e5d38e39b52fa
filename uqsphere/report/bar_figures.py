"""What the bars see of one scene as figures and tables: gauge signals, and forces by wave analysis."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.field import BARS, last_time
from uqsphere.mechanics.gauges import BarForces, bar_forces, force_imbalance, gauge_strain
from uqsphere.mechanics.history import equilibrium, shown_time
from uqsphere.quantities import display_unit
from uqsphere.report import canvas
from uqsphere.report.canvas import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, RED, Picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from uqsphere.mechanics.gauges import GaugeRecord
    from uqsphere.mechanics.history import History

__all__ = [
    "draw_forces",
    "draw_gauges",
    "force_rows",
    "gauge_rows",
    "wave_forces",
]

Array = npt.NDArray[np.float64]

#: gauges with a panel of their own; further ones are in the table
_PANELS: Final = 5
#: instants of the tables
_ROWS: Final = 4000
_LEVEL: Final = 0.05


def _micro(value: float) -> str:
    return f"{value * 1e6:.4g} us"


# --- gauges -------------------------------------------------------------------------------------------


def draw_gauges(history: History) -> Picture:
    """Signals of the gauges in microstrain over microseconds, what arrives when, and where waves overlap."""
    records = history.gauges[:_PANELS]
    end = min(shown_time(history), *(float(record.time[-1]) for record in records))
    begin = min(float(record.time[0]) for record in records)
    with canvas.style():
        figure, axes = canvas.new_figure(1.0 + 1.9 * len(records), rows=len(records), sharex=True)
        for place, record in zip(axes, records, strict=True):
            keep = record.time <= end
            time, strain = record.time[keep], record.strain[keep]
            place.plot(time * 1e6, strain * 1e6, color=BLUE, linewidth=1.2)
            place.axhline(0.0, color=GREY, linewidth=0.6)
            low, high = min(strain.min(), 0.0), max(strain.max(), 0.0)
            room = max(high - low, 1e-12)
            place.set_ylim((low - 0.08 * room) * 1e6, (high + 0.3 * room) * 1e6)
            for overlap in record.overlaps:
                stop = min(overlap.end, end)
                place.axvspan(overlap.begin * 1e6, stop * 1e6, color=ORANGE, alpha=0.22, linewidth=0.0)
            _arrivals(place, history, record, begin, end)
            place.set_ylabel("strain [10⁻⁶]")
            place.set_title(f"{record.bar} bar, {record.position:.4g} m from the sphere", fontsize=9.5)
            place.grid()
        axes[-1].set_xlim(begin * 1e6, end * 1e6)
        axes[-1].set_xlabel("time since first touch [µs]")
        if any(record.overlaps for record in records):
            figure.suptitle("shaded: two waves at the gauge at once", x=0.02, ha="left", fontsize=8.5)
    return Picture(name="gauges", title="Signals of the strain gauges", finding=gauges_finding(history), figure=figure)


def gauges_finding(history: History) -> str:
    """Extremes and overlaps of every gauge, in sentences."""
    parts = []
    for record in history.gauges:
        low, high = record.strain.min() * 1e6, record.strain.max() * 1e6
        text = f"The gauge on the {record.bar} bar, {record.position:.4g} m from the sphere, shows {low:.4g} to "
        text += f"{high:.4g} microstrain."
        for overlap in record.overlaps:
            text += f" From {_micro(overlap.begin)} to {_micro(overlap.end)} it sees the {overlap.first} wave and "
            text += ("the reflected one" if overlap.second == "reflected" else overlap.second) + " at once."
        parts.append(text)
    return " ".join(parts)


def _arrivals(axes: Axes, history: History, record: GaugeRecord, begin: float, end: float) -> None:
    """When which wave comes first, as words along the top."""
    motion = history.motion
    number = BARS.index(record.bar)
    delay, trip = record.position / motion.wave_speed, motion.round_trip(number)
    marks = [(-delay, "incident")] if number == 0 else []
    marks.append((delay, "reflected" if number == 0 else "transmitted"))
    if motion.echoes(number):
        marks.append((trip - delay, "its return"))
    before, line = -math.inf, 0
    for time, word in marks:
        if not begin <= time < end:
            continue
        # words of waves that come close upon one another go below each other
        line = line + 1 if time - before < 0.13 * (end - begin) else 0
        before = time
        axes.axvline(time * 1e6, color=GREY, linewidth=0.7, linestyle=":")
        axes.annotate(word, (time * 1e6, 1.0), xycoords=("data", "axes fraction"), xytext=(3, -3 - 11 * line),
                      textcoords="offset points", va="top", fontsize=8.5, color=INK)  # fmt: skip


def gauge_rows(history: History) -> tuple[list[str], list[list[Any]]]:
    """Heading and rows of gauges.csv: time [us] on an even grid, and the strain of every gauge [1e-6]."""
    motion = history.motion
    begin = min(float(record.time[0]) for record in history.gauges)
    end = min(float(last_time(motion, record.bar, record.position)) for record in history.gauges)
    times = np.linspace(begin, end, _ROWS)
    columns = [times, *(gauge_strain(motion, record.bar, record.position, times) for record in history.gauges)]
    heading = ["time [us]", *(f"{record.name} [microstrain]" for record in history.gauges)]
    return heading, (np.stack(columns, axis=1) * 1e6).tolist()


# --- forces -------------------------------------------------------------------------------------------


def wave_forces(history: History) -> tuple[BarForces | None, str]:
    """Forces from the first gauge of each bar; None with the reason where they cannot be had."""
    first: dict[str, float] = {}
    for record in history.gauges:
        first.setdefault(record.bar, record.position)
    missing = [bar for bar in BARS if bar not in first]
    if missing:
        return None, f"no gauge on the {' and the '.join(missing)} bar"
    try:
        return bar_forces(history.motion, first["incident"], first["receiving"]), ""
    except ValueError as error:
        return None, str(error)


def draw_forces(history: History) -> Picture:
    """Forces at both faces by one, two and three waves beside those of the contacts, and their imbalance."""
    found, reason = wave_forces(history)
    end = found.end if found is not None else min(history.record_end, shown_time(history))
    times = np.linspace(0.0, end, 1500)
    exact = history.motion.forces_at(times)
    unit, scale = display_unit("P_max")
    balance = equilibrium(history, _LEVEL)
    with canvas.style():
        figure, (above, below) = canvas.new_figure(5.2, rows=2, sharex=True, height_ratios=[2, 1])
        above.plot(times * 1e6, exact[:, 0] * scale, color=GREY, linewidth=4.0, alpha=0.5, label="contact A")
        above.plot(times * 1e6, exact[:, 1] * scale, color=ORANGE, linewidth=4.0, alpha=0.4, label="contact B")
        if found is not None:
            for course, colour, line, name in ((found.two_wave, BLUE, "-", "two waves"),
                                               (found.one_wave, RED, "--", "one wave"),
                                               (found.three_wave, GREEN, ":", "three waves")):  # fmt: skip
                above.plot(found.time * 1e6, course * scale, color=colour, linestyle=line, linewidth=1.3, label=name)
        above.set_ylabel(f"force [{unit}]")
        above.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=5, borderpad=0.0, columnspacing=1.0,
                     handlelength=1.8)  # fmt: skip
        above.grid()
        below.semilogy(times[1:] * 1e6, np.maximum(force_imbalance(exact[1:, 0], exact[1:, 1]), 1e-5), color=PURPLE)
        below.axhline(_LEVEL, color=INK, linewidth=0.8, linestyle="--")
        below.axvspan(balance.until * 1e6, end * 1e6, color=GREY, alpha=0.10, linewidth=0.0)
        if balance.lasting is not None:
            below.axvline(balance.lasting * 1e6, color=GREEN, linewidth=1.0)
        below.set_ylim(1e-4, 3.0)
        below.set_yticks([1e-4, 1e-3, 1e-2, 1e-1, 1.0], ["0.0001", "0.001", "0.01", "0.1", "1"])
        below.minorticks_off()
        below.set_ylabel("imbalance R")
        below.set_xlabel("time at the faces since first touch [µs]")
        below.grid()
        below.set_xlim(0.0, end * 1e6)
        figure.suptitle(canvas.wrap(_forces_finding(history, found, reason), 105, lines=3), x=0.02, ha="left",
                        fontsize=8.5)  # fmt: skip
    return Picture(name="forces", title="Forces at both faces as the gauges give them",
                   finding=_forces_finding(history, found, reason), figure=figure)  # fmt: skip


def _forces_finding(history: History, found: BarForces | None, reason: str) -> str:
    text = f"Records are clean up to {_micro(found.end)} at the faces." if found else f"No wave analysis: {reason}."
    balance = equilibrium(history, _LEVEL)
    share = f"{_LEVEL:.0%} of their mean"
    if balance.first is None:
        return f"{text} Up to the first loading's largest force the two forces never agree within {share}."
    text += f" The two forces agree within {share} first after {_micro(balance.first)}"
    if balance.lasting is None:
        return f"{text}, but not for good up to the first loading's largest force at {_micro(balance.until)}."
    return f"{text}, and from {_micro(balance.lasting)} on up to the first loading's largest force (grey: after it)."


def force_rows(history: History) -> tuple[list[str], list[list[Any]]] | None:
    """Heading and rows of bar_forces.csv; None where the gauges allow no wave analysis."""
    found, _ = wave_forces(history)
    if found is None:
        return None
    exact = history.motion.forces_at(found.time)
    columns = [found.time * 1e6, found.one_wave, found.two_wave, found.three_wave, exact[:, 0], exact[:, 1],
               force_imbalance(exact[:, 0], exact[:, 1])]  # fmt: skip
    heading = ["time at the faces [us]", "one wave (B) [N]", "two waves (A) [N]", "three waves [N]", "contact A [N]",
               "contact B [N]", "imbalance [-]"]  # fmt: skip
    return heading, np.stack(columns, axis=1).tolist()
