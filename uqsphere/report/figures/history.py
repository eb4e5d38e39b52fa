"""One scene over time as figures: forces, pressures, velocity and waves, and the x-t diagram of the bars."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.mechanics.field import BARS, BarForces, bar_forces, force_imbalance, gauge_strain, last_time
from uqsphere.mechanics.history import equilibrium, rod_length, rod_record, shown_time, view_field
from uqsphere.mechanics.rigs import RIGS
from uqsphere.mechanics.stress import outside
from uqsphere.quantities import display_unit, format_value, reading_units, unit_that_reads
from uqsphere.report.figures import canvas
from uqsphere.report.figures.scene import draw_field, field_rows, stress_image, stress_picture
from uqsphere.report.phrases import number_text
from uqsphere.store import csv_text, write_outputs

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from uqsphere.mechanics.field import GaugeRecord
    from uqsphere.mechanics.history import Balance, History
    from uqsphere.report.contents import Contents

#: places and instants of the picture of a rod
_PLACES: Final = 160


def history_figure(history: History) -> str:
    """SVG text of one scene over time: contact forces, contact pressures, sphere velocity, waves; contacts lost and
    found, the end of the record and the largest pressures are marked."""
    return canvas.render(draw_history(history))


def xt_figure(history: History) -> str:
    """SVG text of the stress in both bars over place and time, with the wave fronts, the sphere at x = 0."""
    return canvas.render(draw_xt(history))


def _thinned(history: History) -> npt.NDArray[np.int64]:
    """Instants to draw: an even choice, and every jump, which stands in two instants of one time."""
    time = history.time
    jumps = np.flatnonzero(np.diff(time) <= 0.0)
    # instants of a drawn course
    even = np.linspace(0, len(time) - 1, min(len(time), 1200)).round().astype(np.int64)
    peaks = [int(np.argmax(course)) for course in (history.force_a, history.force_b)]
    return np.unique(np.concatenate([even, jumps, jumps + 1, np.array(peaks)]))


def draw_history(history: History) -> canvas.Picture:
    """The picture of `history_figure`."""
    unit, factor = canvas.time_unit(history.horizon)
    keep = _thinned(history)
    t, end = history.time[keep] * factor, history.record_end
    panels = _panels(history)
    with canvas.style():
        figure, axes = canvas.new_figure(8.4, rows=len(panels), sharex=True)
        for place, (label, courses) in zip(axes, panels, strict=True):
            for name, course, colour, line in courses:
                place.plot(t, course[keep], color=colour, linestyle=line, linewidth=1.3, label=name)
            place.set_ylabel(label)
            place.axhline(0.0, color=canvas.GREY, linewidth=0.6)
            place.grid()
            # changes of contact with a line of their own; a sphere that rattles has more than can be told apart
            for change in history.changes[:12]:
                colour, line = (canvas.RED, ":") if change.kind == "lost" else (canvas.GREY, "-.")
                place.axvline(change.time * factor, color=colour, linewidth=0.8, linestyle=line)
            if end < history.horizon:
                place.axvspan(end * factor, history.horizon * factor, color=canvas.GREY, alpha=0.10, linewidth=0.0)
            if len(courses) > 1 and "pressure" not in label:
                canvas.legend_above(place, len(courses))
        _peaks(axes[1], history, factor)
        axes[-1].set_xlim(0.0, history.horizon * factor)
        axes[-1].set_xlabel(f"time since first touch [{unit}]")
        text = f"grey: after the record, which ends at {end * factor:.4g} {unit}"
        if history.changes:
            text += ";  dotted: contact lost,  dash-dotted: found again"
        elif end >= history.horizon:
            text = f"in contact up to the end of the record at {end * factor:.4g} {unit}"
        figure.suptitle(text, x=0.02, ha="left", fontsize=8.5)
    return canvas.Picture(name="history", title="One scene over time", figure=figure)


def _panels(history: History) -> list[tuple[str, list[tuple[str, Array, str, str]]]]:
    """What is drawn over time, by panel: label and courses, each with name, values, colour and line."""
    rig = RIGS[history.motion.scene.rig]
    (force_unit, force), (pressure_unit, pressure) = display_unit("P_max"), display_unit("p_max")
    a, b = ("incident face A", "receiving face B") if rig.name == "bars" else (f"A, {rig.behind}", f"B, {rig.ahead}")
    faces = [("a", a, canvas.BLUE, "-"), ("b", b, canvas.ORANGE, "--")][1 if rig.contacts == 1 else 0 :]
    kind = "mean pressure, ○ centre" if _yields(history) else "contact pressure"
    speeds = [("sphere", history.velocity, canvas.GREEN, "-")]
    if rig.name != "bars" and history.balance is not None:
        tables = [(rig.behind, canvas.BLUE, "-"), (rig.ahead, canvas.ORANGE, "--")]
        partners = zip(tables, history.balance.partner, strict=True)
        speeds += [(table, speed, colour, line) for (table, colour, line), speed in partners if table]
    found = [
        (f"contact force [{force_unit}]", [(n, force * getattr(history, f"force_{k}"), c, s) for k, n, c, s in faces]),
        (f"{kind}\n[{pressure_unit}]",
         [(k.upper(), pressure * getattr(history, f"pressure_{k}"), c, s) for k, _, c, s in faces]),
        ("velocity\n[m/s]" if len(speeds) > 1 else "sphere velocity\n[m/s]", speeds),
    ]  # fmt: skip
    if rig.name == "load_cell" and history.gauges:
        gauge = history.gauges[0]
        found.append(("strain at the gauge\n[µm/m]", [(gauge.name, 1e6 * gauge.strain, canvas.PURPLE, "-")]))
    if rig.name == "bars":
        waves = [
            ("towards A", history.incident, canvas.BLUE, "-"),
            ("from A", history.leaving_a, canvas.PURPLE, ":"),
            ("from B", history.leaving_b, canvas.ORANGE, "--"),
            ("towards B", history.returning, canvas.GREEN, "-."),
        ]
        found.append(("waves in the bars\n[m/s]", waves))
    return found


def _yields(history: History) -> bool:
    return history.balance is not None and bool(history.balance.dent.max() > 0.0)


def balance_picture(balance: Balance, hertz: Sequence[float]) -> canvas.Picture:
    """Force over approach with the loop of what yields, Hertz beside it, and where the energy is over time.

    `hertz` are the Hertz constants of the faces, 0 where nothing stands.
    """
    force_unit, force = display_unit("P_max")
    energy_unit = unit_that_reads("energy", [float(balance.stored.sum(axis=0).max())])
    with reading_units({"energy": energy_unit}):
        scale = display_unit("energy")[1]
    unit, factor = canvas.time_unit(float(balance.time[-1]))
    columns: dict[str, Array] = {"time [s]": balance.time}
    parts = [
        ("stored", balance.stored.sum(axis=0), canvas.BLUE, "-"),
        ("plastic", balance.plastic.sum(axis=0), canvas.RED, "-."),
        ("sphere's motion", balance.kinetic, canvas.GREEN, "--"),
        ("passed on at B", balance.passed[1], canvas.ORANGE, ":"),
    ]
    with canvas.style():
        figure, (loop, over) = canvas.new_figure(7.0, rows=2)
        for pole, (name, colour, line) in enumerate((("A", canvas.BLUE, "-"), ("B", canvas.ORANGE, "--"))):
            if not hertz[pole] > 0.0:
                continue
            approach, pressed = balance.approach[pole], balance.force[pole]
            columns |= {f"approach {name} [m]": approach, f"force {name} [N]": pressed}
            own: dict[str, Any] = {"linestyle": line, "linewidth": 1.2, "label": f"face {name}"}
            loop.plot(approach * 1e6, pressed * force, color=colour, **own)
            if pole == 1:
                x = np.linspace(0.0, float(approach.max()), 100)
                y = hertz[pole] * x**1.5 * force
                loop.plot(x * 1e6, y, color=canvas.GREY, linestyle=":", linewidth=1.2, label="Hertz")
        loop.set_xlim(left=min(0.0, 1.05e6 * float(balance.approach.max()) * -0.02))
        loop.set_ylim(0.0, 1.15 * force * float(balance.force.max()))
        canvas.frame(loop, x="approach [µm]", y=f"force [{force_unit}]")
        loop.legend(loc="upper left")
        for name, course, colour, line in parts:
            if np.abs(course).max() > 0.0:
                over.plot(balance.time * factor, course * scale, color=colour, linestyle=line, label=name)
        canvas.frame(over, x=f"time since first touch [{unit}]", y=f"energy [{energy_unit}]", grid=True, legend=4)
        loop.grid()
    columns |= {f"{name} [J]": course for name, course, _, _ in parts}
    rows = tuple(zip(*(column.tolist() for column in columns.values()), strict=True))
    return canvas.Picture(name="balance", title="Force over approach, and where the energy is", header=tuple(columns),
                          rows=rows, figure=figure)  # fmt: skip


def loop_figure(contents: Contents) -> canvas.Picture | None:
    """Force over approach of the hardest scene and where its energy is; None where no face yields."""
    from uqsphere.mechanics.history import Balance

    hardest = {} if contents.courses is None else contents.courses["hardest"]
    if "loop" not in hardest:
        return None
    balance = Balance(**{name: np.array(values, dtype=float) for name, values in hardest["loop"].items()})
    return balance_picture(balance, hardest["hertz_constants"])


def _peaks(axes: Axes, history: History, factor: float) -> None:
    """The largest pressures before and after the first loss of contact."""
    peaks = [peak for peak in (history.first_peak, history.later_peak) if peak is not None]
    scale = display_unit("p_max")[1]
    axes.set_ylim(top=1.3 * scale * max((peak.pressure for peak in peaks), default=1.0))
    for peak in peaks:
        at = peak.time * factor, peak.pressure * scale
        axes.plot(*at, marker="o", color=canvas.INK, markerfacecolor=canvas.PAPER, markersize=5)
        right = peak.time > 0.7 * history.horizon
        words = f"{format_value(peak.pressure, 'p_max')} at {peak.face}"
        canvas.note(axes, words, at, (-6 if right else 6, 5), ha="right" if right else "left", fontsize=8.5)


# --- x-t diagram --------------------------------------------------------------------------------------


def draw_xt(history: History) -> canvas.Picture:
    """Stress in both bars over place and time, the sphere at x = 0, with fronts, regions, far ends and gauges."""
    scene, words = history.motion.scene, []
    for name, end in zip(BARS, scene.reflections[history.motion.row].tolist(), strict=True):
        what = {1.0: "free", -1.0: "fixed", 0.0: "absorbing"}.get(end, number_text(f"R = {end:.3g}"))
        words.append(f"{name} bar, {'no' if scene.infinite else what} end")
    gauges = [-one.position if one.bar == BARS[0] else one.position for one in history.gauges]
    return replace(draw_field(view_field(history), gauges, "  |  ".join(words)), name="xt")


def draw_rod(history: History, length: float) -> canvas.Picture:
    """Axial stress in the rod ahead of the sphere over place and time."""
    motion, table = history.motion, history.motion.scene.partners[1]
    assert table is not None
    places = (np.arange(_PLACES) + 0.5) * length / _PLACES
    times = np.linspace(0.0, shown_time(history), _PLACES)
    strain = np.stack([rod_record(motion, float(place), times).strain for place in places], axis=1)
    stress = 1e-6 * strain * float(motion.scene.columns[f"{table.table}.E"][motion.row])
    with canvas.style():
        figure, (axes,) = canvas.new_figure(4.6)
        stress_image(axes, stress, (0.0, length, 0.0, times[-1] * 1e6), "MPa")
        for gauge in history.gauges:
            axes.axvline(gauge.position, color=canvas.INK, linestyle="--", linewidth=0.9)
        axes.set_xlabel("place along the rod, sphere at 0 [m]")
    finding = f"The wave carries up to {-float(stress.min()):.3g} MPa of compression"
    if stress.max() > 0.01 * np.abs(stress).max():
        finding += f", and {float(stress.max()):.3g} MPa of tension comes back"
    return canvas.Picture(name="xt", title="Stress in the rod over place and time", figure=figure,
                          finding=f"{finding}; dashed: gauge.")  # fmt: skip


# --- What the bars see of one scene as figures and tables: gauge signals, and forces by wave analysis.

#: instants of the tables
_ROWS: Final = 4000
_LEVEL: Final = 0.05


# --- gauges -------------------------------------------------------------------------------------------


def draw_gauges(history: History) -> canvas.Picture:
    """Signals of the gauges in microstrain over microseconds, what arrives when, and where waves overlap."""
    # gauges with a panel of their own; further ones are in the table
    records = history.gauges[:5]
    end = min(shown_time(history), *(float(record.time[-1]) for record in records))
    begin = min(float(record.time[0]) for record in records)
    with canvas.style():
        figure, axes = canvas.new_figure(1.0 + 1.9 * len(records), rows=len(records), sharex=True)
        for place, record in zip(axes, records, strict=True):
            keep = record.time <= end
            time, strain = record.time[keep], record.strain[keep]
            place.plot(time * 1e6, strain * 1e6, color=canvas.BLUE, linewidth=1.2)
            place.axhline(0.0, color=canvas.GREY, linewidth=0.6)
            low, high = min(strain.min(), 0.0), max(strain.max(), 0.0)
            room = max(high - low, 1e-12)
            place.set_ylim((low - 0.08 * room) * 1e6, (high + 0.3 * room) * 1e6)
            for overlap in record.overlaps:
                stop = min(overlap.end, end)
                place.axvspan(overlap.begin * 1e6, stop * 1e6, color=canvas.ORANGE, alpha=0.22, linewidth=0.0)
            _arrivals(place, history, record, begin, end)
            place.set_ylabel("strain [10⁻⁶]")
            place.set_title(f"{record.bar} bar, {record.position:.4g} m from the sphere", fontsize=9.5)
            place.grid()
        axes[-1].set_xlim(begin * 1e6, end * 1e6)
        axes[-1].set_xlabel("time since first touch [µs]")
        if any(record.overlaps for record in records):
            figure.suptitle("shaded: two waves at the gauge at once", x=0.02, ha="left", fontsize=8.5)
    return canvas.Picture(name="gauges", title="Signals of the strain gauges", figure=figure)


def _arrivals(axes: Axes, history: History, record: GaugeRecord, begin: float, end: float) -> None:
    """When which wave comes first, as words along the top."""
    motion, number = history.motion, BARS.index(record.bar)
    delay, trip = record.position / motion.wave_speed, motion.round_trip(number)
    marks = [(-delay, "incident"), (delay, "reflected")] if number == 0 else [(delay, "transmitted")]
    marks += [(trip - delay, "its return")] if motion.echoes(number) else []
    before, line = -math.inf, 0
    for time, word in marks:
        if begin <= time < end:
            # words of waves that come close upon one another go below each other
            line = line + 1 if time - before < 0.13 * (end - begin) else 0
            before = time
            axes.axvline(time * 1e6, color=canvas.GREY, linewidth=0.7, linestyle=":")
            canvas.note(axes, word, (time * 1e6, 1.0), (3, -3 - 11 * line), xycoords=("data", "axes fraction"),
                        va="top", fontsize=8.5, color=canvas.INK)  # fmt: skip


def gauge_rows(history: History) -> tuple[list[str], list[list[object]]]:
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
    first = {record.bar: record.position for record in reversed(history.gauges)}
    missing = [bar for bar in BARS if bar not in first]
    if missing:
        return None, f"no gauge on the {' and the '.join(missing)} bar"
    try:
        return bar_forces(history.motion, first["incident"], first["receiving"]), ""
    except ValueError as error:
        return None, str(error)


def draw_forces(history: History) -> canvas.Picture:
    """Forces at both faces by one, two and three waves beside those of the contacts, and their imbalance."""
    found, reason = wave_forces(history)
    end = found.end if found is not None else min(history.record_end, shown_time(history))
    times = np.linspace(0.0, end, 1500)
    exact = history.motion.forces_at(times)
    unit, scale = display_unit("P_max")
    balance, finding = equilibrium(history, _LEVEL), _forces_finding(history, found, reason)
    with canvas.style():
        figure, (above, below) = canvas.new_figure(5.2, rows=2, sharex=True, height_ratios=[2, 1])
        for k, (colour, name) in enumerate(((canvas.GREY, "contact A"), (canvas.ORANGE, "contact B"))):
            above.plot(times * 1e6, exact[:, k] * scale, color=colour, linewidth=4.0, alpha=0.5 - 0.1 * k, label=name)
        if found is not None:
            for course, colour, line, name in ((found.two_wave, canvas.BLUE, "-", "two waves"),
                                               (found.one_wave, canvas.RED, "--", "one wave"),
                                               (found.three_wave, canvas.GREEN, ":", "three waves")):  # fmt: skip
                above.plot(found.time * 1e6, course * scale, color=colour, linestyle=line, linewidth=1.3, label=name)
        canvas.frame(above, y=f"force [{unit}]", grid=True, legend=5)
        below.semilogy(
            times[1:] * 1e6, np.maximum(force_imbalance(exact[1:, 0], exact[1:, 1]), 1e-5), color=canvas.PURPLE
        )
        below.axhline(_LEVEL, color=canvas.INK, linewidth=0.8, linestyle="--")
        below.axvspan(balance.until * 1e6, end * 1e6, color=canvas.GREY, alpha=0.10, linewidth=0.0)
        if balance.lasting is not None:
            below.axvline(balance.lasting * 1e6, color=canvas.GREEN, linewidth=1.0)
        below.set_ylim(1e-4, 3.0)
        below.set_yticks([1e-4, 1e-3, 1e-2, 1e-1, 1.0], ["0.0001", "0.001", "0.01", "0.1", "1"])
        below.minorticks_off()
        canvas.frame(below, x="time at the faces since first touch [µs]", y="imbalance R", grid=True)
        below.set_xlim(0.0, end * 1e6)
        figure.suptitle(canvas.wrap(finding, 105, lines=3), x=0.02, ha="left", fontsize=8.5)
    title = "Forces at both faces as the gauges give them"
    return canvas.Picture(name="forces", title=title, finding=finding, figure=figure)


def _forces_finding(history: History, found: BarForces | None, reason: str) -> str:
    """Up to where records are clean, and from when on the two forces agree."""
    text = f"No wave analysis: {reason}."
    if found is not None:
        text = f"Records are clean up to {1e6 * found.end:.4g} us at the faces."
    balance, share = equilibrium(history, _LEVEL), f"{_LEVEL:.0%} of their mean"
    until = f"up to the first loading's largest force at {1e6 * balance.until:.4g} us"
    if balance.first is None:
        return f"{text} The two forces never agree within {share} {until}."
    text += f" The two forces agree within {share} first after {1e6 * balance.first:.4g} us"
    if balance.lasting is None:
        return f"{text}, but not for good {until}."
    return f"{text}, and from {1e6 * balance.lasting:.4g} us on {until} (grey: after it)."


def force_rows(history: History) -> tuple[list[str], list[list[object]]] | None:
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


# --- The files of one scene over time: its course as a table and as pictures.

#: columns of history.csv and the fields of History they come from
_COLUMNS = {
    "time [s]": "time",
    "force_a [N]": "force_a",
    "force_b [N]": "force_b",
    "pressure_a [Pa]": "pressure_a",
    "pressure_b [Pa]": "pressure_b",
    "approach_a [m]": "approach_a",
    "approach_b [m]": "approach_b",
    "sphere_velocity [m/s]": "velocity",
    "incident_wave [m/s]": "incident",
    "returning_wave [m/s]": "returning",
    "wave_leaving_a [m/s]": "leaving_a",
    "wave_leaving_b [m/s]": "leaving_b",
}


def write_history(found: History, folder: Path) -> list[Path]:
    """Table and pictures of a history in `folder`; the paths.

    history.csv, history.svg; xt.svg, field.csv; forces.svg and, where the gauges allow it, bar_forces.csv;
    gauges.csv, gauges.svg where there are gauges; stress.svg within the range of its tables.
    """
    scene, motion = found.motion.scene, found.motion
    ratio, pressure = found.hardest_contact
    nu = float(scene.columns["sphere.nu"][motion.row])
    with reading_units(units_of_history(found)):
        names, columns = _columns(found)
        contents = {
            "history.csv": csv_text(names, np.stack(columns, axis=1).tolist()),
            "history.svg": history_figure(found),
        }
        if scene.rig == "bars":
            contents |= _bar_pictures(found)
        elif math.isfinite(length := rod_length(motion)) and length > 0.0:
            contents["xt.svg"] = canvas.render(draw_rod(found, length))
        if found.balance is not None and (scene.rig != "bars" or _yields(found)):
            hertz = [0.0 if one is None else float(one.hertz_constant[motion.row]) for one in scene.partners]
            contents["balance.svg"] = canvas.render(balance_picture(found.balance, hertz))
        if not outside(ratio, nu):
            contents["stress.svg"] = canvas.render(stress_picture(ratio, nu, pressure))
        return write_outputs(folder, contents)


def units_of_history(found: History) -> dict[str, str]:
    """The units in which forces, pressures and the tension in the core of one scene read well."""
    pressure = found.hardest_contact[1]
    peaks = [peak.force for peak in (found.first_peak, found.later_peak) if peak is not None]
    return {
        "P_max": unit_that_reads("P_max", peaks),
        "p_max": unit_that_reads("p_max", [pressure]),
        # of some twentieth of the pressure
        "core_tension": unit_that_reads("core_tension", [0.05 * pressure]),
    }


def _columns(found: History) -> tuple[list[str], list[Array]]:
    """Heads and columns of history.csv."""
    bars_rig, balance = found.motion.scene.rig == "bars", found.balance
    names = [name for name in _COLUMNS if bars_rig or "wave" not in name]
    columns = [getattr(found, _COLUMNS[name]) for name in names]
    if balance is not None and (not bars_rig or _yields(found)):
        pairs = {"dent": (balance.dent, "m"), "plastic": (balance.plastic, "J"), "stored": (balance.stored, "J"),
                 "velocity": (balance.partner, "m/s")}  # fmt: skip
        names += [f"{name}_{face} [{unit}]" for name, (_, unit) in pairs.items() for face in "ab"]
        columns += [course for pair, _ in pairs.values() for course in pair]
    if not bars_rig:
        names += [f"strain, {record.name} [1]" for record in found.gauges]
        columns += [record.strain for record in found.gauges]
    return names, columns


def _bar_pictures(found: History) -> dict[str, str]:
    """What the bars see, by file name."""
    contents = {"field.csv": csv_text(*field_rows(found))}
    pictures = [draw_xt(found), draw_forces(found)]
    if found.gauges:
        contents["gauges.csv"] = csv_text(*gauge_rows(found))
        pictures.append(draw_gauges(found))
    forces = force_rows(found)
    if forces is not None:
        contents["bar_forces.csv"] = csv_text(*forces)
    return contents | {f"{picture.name}.svg": canvas.render(picture) for picture in pictures}
