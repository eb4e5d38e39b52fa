"""What the records of a test say, for the command line: the pulse of one gauge, or forces from two bars."""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from uqsphere.console import plain, table
from uqsphere.errors import UsageError
from uqsphere.quantities import format_value
from uqsphere.units import UnitError, parse_value

if TYPE_CHECKING:
    from uqsphere.records.inverse import Inverse
    from uqsphere.records.loading import ContactFit
    from uqsphere.records.pulse import Bar
    from uqsphere.records.record import Record
    from uqsphere.study import Study


def _value(text: str, dimension: str, option: str) -> float:
    try:
        return parse_value(text.strip(), dimension)
    except UnitError as error:
        raise UsageError(f"{option}: {error}") from None


def _window(text: str | None) -> tuple[float | None, float | None]:
    if text is None:
        return None, None
    parts = text.split(",")
    if len(parts) != 2:
        raise UsageError(f'--window takes begin and end, such as "100 us,420 us", found {text!r}')
    begin, end = (_value(part, "time", "--window") for part in parts)
    return begin, end


def command_records(chosen: argparse.Namespace) -> int:
    """The pulse of a record, or forces, stiffness and the end of the elastic contact of a test."""
    from uqsphere.records.table import RecordError
    from uqsphere.study import load_study

    for name in ("gauge_factor", "amplification", "active_arms"):
        if not 0.0 < getattr(chosen, name) < math.inf:
            raise UsageError(f"--{name.replace('_', '-')} must be above zero, found {getattr(chosen, name)}")
    if not 0.0 <= chosen.gain_sd < 1.0:
        raise UsageError(f"--gain-sd must lie from 0 to below 1, found {chosen.gain_sd}")
    study = None if chosen.study is None else load_study(chosen.study, chosen.overrides)
    if study is not None and study.black_box:
        raise UsageError("records need a scene with sphere and bars; this study is a black box")
    try:
        record, signals = _read(chosen)
        said = _pulse(chosen, record, study) if signals < 2 or study is None else _test(chosen, record, study)
    except RecordError as error:
        text = str(error).removeprefix(f"{chosen.record.name}: ")
        raise UsageError(f"{chosen.record}: {text}") from None
    written = _write(chosen.out, said.files()) if chosen.out is not None else []
    if chosen.json:
        print(json.dumps({**said.content, "written": written}, indent=2, allow_nan=False))
    else:
        for note in said.notes:
            print(f"note: {plain(note)}", file=sys.stderr)
        print("\n".join([table(said.header, said.rows), *(f"wrote {path}" for path in written)]))
    return 0


@dataclass(frozen=True, kw_only=True)
class _Said:
    """What a record says: the JSON document, the rows of the table, and the files that can be written."""

    content: dict[str, object]
    notes: Sequence[str]
    header: tuple[str, ...]
    rows: list[tuple[str, ...]]
    files: Callable[[], dict[str, str]]


def _write(folder: Path, files: Mapping[str, str]) -> list[str]:
    from uqsphere.store import write_atomically

    for name, text in files.items():
        write_atomically(folder / name, text)
    return [str(folder / name) for name in files]


def _read(chosen: argparse.Namespace) -> tuple[Record, int]:
    """The record with its baseline and sign, and how many signals it has."""
    from uqsphere.records.record import Wiring, make_record, mend
    from uqsphere.records.table import read_table

    wiring = Wiring(unit=chosen.unit, gauge_factor=chosen.gauge_factor, excitation=chosen.excitation,
                    amplification=chosen.amplification, active_arms=chosen.active_arms,
                    time_unit=chosen.time_unit)  # fmt: skip
    columns = [name.strip() for name in chosen.columns.split(",")] if chosen.columns else []
    read = read_table(chosen.record)
    signals = (len(columns) or len(read.names)) - 1
    if signals > 1 and chosen.study is None:
        raise UsageError(
            f"{chosen.record.name} has {signals} signals: name the study with sphere and bars by --study, or the one "
            "that is the pulse by --columns TIME,SIGNAL"
        )
    if signals == 4 and not columns:
        signals = 2  # two gauges a bar
    return mend(make_record(read, min(max(signals, 1), 3), wiring=wiring, columns=columns), chosen.polarity), signals


def _numbers(study: Study) -> dict[str, float]:
    from uqsphere.model import scene_of

    return {name: float(column[0]) for name, column in scene_of(study, {}, 1).columns.items()}


def _bar(columns: Mapping[str, float]) -> Bar:
    from uqsphere.records.pulse import Bar
    from uqsphere.records.table import RecordError

    if not 0.0 <= columns["bars.nu"] < 0.5:
        raise RecordError("the dispersion of bars is known for Poisson ratios from 0 to below 0.5")
    return Bar(radius=0.5 * columns["bars.diameter"], nu=columns["bars.nu"],
               wave_speed=math.sqrt(columns["bars.E"] / columns["bars.density"]))  # fmt: skip


def _pulse(chosen: argparse.Namespace, record: Record, study: Study | None) -> _Said:
    from uqsphere.records.pulse import cut_pulse, fit_pulse

    begin, end = _window(chosen.window)
    distance = _value(chosen.incident_gauge, "length", "--incident-gauge")
    columns = None if study is None else _numbers(study)
    bar = None
    if chosen.correct_dispersion:
        if columns is None or not distance > 0.0:
            raise UsageError("--correct-dispersion needs --study with the bars, and --incident-gauge")
        bar = _bar(columns)
    cut = cut_pulse(record, bar=bar, distance=distance if bar else 0.0, begin=begin, end=end)
    pulse = fit_pulse(cut, chosen.record.name, hashlib.sha256(chosen.record.read_bytes()).hexdigest())
    speed = None if columns is None else 2.0 * math.sqrt(columns["bars.E"] / columns["bars.density"]) * pulse.peak
    noise = f"{record.noise[0] * 1e6:.3g} microstrain, correlated over {record.memory[0]:.2g} samples"
    rows: list[tuple[str, ...]] = [
        ("peak strain", f"{pulse.peak * 1e6:.5g} microstrain"),
        ("duration", f"{pulse.duration * 1e6:.5g} us, from {cut.begin * 1e6:.5g} us on"),
        ("rise, 10 to 90 %", f"{pulse.rise * 1e6:.4g} us"),
        ("noise of a sample", noise),
        ("noise of each mode of the pulse", f"{pulse.noise:.2g} of its peak"),
    ]
    if speed is not None:
        rows.append(("striker speed that it stands for", format_value(speed, "striker.speed")))

    def files() -> dict[str, str]:
        from uqsphere.report.figures.records import pulse_figure

        return {"record.svg": pulse_figure(record, cut, pulse)}

    content: dict[str, object] = {
        "kind": "pulse", "file": chosen.record.name, "peak_strain": pulse.peak, "duration": pulse.duration,
        "rise": pulse.rise, "begin": cut.begin, "step": record.step, "noise": float(record.noise[0]),
        "noise_modes": pulse.noise, "band_share": cut.inside, "pieces": len(pulse.breaks) - 1, "striker_speed": speed,
        "notes": list(pulse.notes),
    }  # fmt: skip
    return _Said(content=content, notes=pulse.notes, header=("what", "value"), rows=rows, files=files)


def _test(chosen: argparse.Namespace, record: Record, study: Study) -> _Said:
    from uqsphere.records.inverse import Rig, at_faces, invert

    columns = _numbers(study)
    infinite = bool(study.options["bars.infinite"])

    def length(bar: str) -> float:
        # an end that sends nothing back leaves the record undisturbed
        silent = columns.get(f"bars.{bar}_end", 1.0) == 0.0
        return math.inf if infinite or silent else columns.get(f"bars.{bar}_length", math.inf)

    rig = Rig(
        bar=_bar(columns), incident_gauge=_value(chosen.incident_gauge, "length", "--incident-gauge"),
        receiving_gauge=_value(chosen.receiving_gauge, "length", "--receiving-gauge"),
        incident_length=length("incident"), receiving_length=length("receiving"),
        correct_dispersion=chosen.correct_dispersion,
    )  # fmt: skip
    begin, end = _window(chosen.window)
    faces = at_faces(record, rig, begin=begin, end=end)
    found = invert(faces, columns, gain_sd=chosen.gain_sd)

    def files() -> dict[str, str]:
        from uqsphere.report.figures.records import forces_figure, pulse_figure
        from uqsphere.store import csv_text

        force = found.forces
        limits = [limit for face in "AB" for limit in force.interval(face)]
        head = ["time [s]", "force_a [N]", "force_b [N]", "force_a_low [N]", "force_a_high [N]", "force_b_low [N]",
                "force_b_high [N]", "model_a [N]", "model_b [N]"]  # fmt: skip
        courses = [force.time, force.force_a, force.force_b, *limits, found.fitted_a, found.fitted_b]
        lines = [[float(course[k]) for course in courses] for k in range(len(force.time))]
        return {"forces.csv": csv_text(head, lines), "forces.svg": forces_figure(faces, found),
                "record.svg": pulse_figure(record, faces.pulse, found.pulse)}  # fmt: skip

    content, rows = _answers(found, columns)
    content = {"kind": "test", "file": chosen.record.name, "samples": len(found.forces.time), "step": faces.step,
               "end": float(found.forces.time[-1]), **content}  # fmt: skip
    header = ("what", "value", "95 % interval")
    return _Said(content=content, notes=found.notes, header=header, rows=rows, files=files)


def _row(what: str, unit: str, factor: float, numbers: Sequence[float]) -> tuple[str, ...]:
    """A row of the table: value, low and high (SI) in a unit of 1/factor."""
    value, low, high = (f"{number * factor:.4g}" for number in numbers)
    return what, f"{value} {unit}", f"{low} to {high} {unit}"


def _answers(found: Inverse, columns: Mapping[str, float]) -> tuple[dict[str, object], list[tuple[str, ...]]]:
    """The numbers of the JSON document and the rows of the table."""
    stiff, forces, end = found.stiffness, found.forces, found.departure
    keys, rows = ("value", "low", "high"), []
    largest = {}
    for face, fitted, measured in (("A", found.fitted_a, forces.force_a), ("B", found.fitted_b, forces.force_b)):
        at = int(abs(fitted).argmax() if found.held else measured.argmax())
        numbers = [float(course[at]) for course in (measured, *forces.interval(face))]
        largest[face] = {"time": float(forces.time[at]), **dict(zip(keys, numbers, strict=True))}
        rows.append(_row(f"largest force at {face}, at {forces.time[at] * 1e6:.4g} us", "kN", 1e-3, numbers))
    reduced = (stiff.modulus, stiff.low, stiff.high)
    rows.append(_row("reduced modulus E*", "GPa", 1e-9, reduced))
    bar = (1.0 - columns["bars.nu"] ** 2) / columns["bars.E"]
    rest = [1.0 / value - bar for value in reduced]
    modulus = None
    if min(rest) > 0.0:
        young = [(1.0 - columns["sphere.nu"] ** 2) / value for value in rest]
        modulus = dict(zip(keys, young, strict=True))
        rows.append(_row("E of the sphere that gives it", "GPa", 1e-9, young))
    rows.append(("misfit over noise", f"{stiff.misfit:.3g}", ""))
    if end is None:
        rows.append(("elastic contact", "held to the end of the record", ""))
    else:
        rows.append(_row("elastic contact ends", "us", 1e6, (end.time, end.earliest, end.latest)))
        rows += [
            _row(f"force at {face} there, candidate for fracture", "kN", 1e-3, force)
            for face, force in (("A", end.force_a), ("B", end.force_b))
        ]
    departure = None if end is None else {
        "time": end.time, "earliest": end.earliest, "latest": end.latest, "excess": end.excess,
        "force_a": dict(zip(keys, end.force_a, strict=True)), "force_b": dict(zip(keys, end.force_b, strict=True)),
    }  # fmt: skip
    content: dict[str, object] = {
        "largest_force": largest,
        "reduced_modulus": {**dict(zip(keys, reduced, strict=True)), "std_error": stiff.std_error},
        "sphere_modulus": modulus, "gains": {"incident": stiff.gain_a, "receiving": stiff.gain_b},
        "misfit": stiff.misfit, "elastic_throughout": found.held, "departure": departure, "notes": list(found.notes),
    }  # fmt: skip
    return content, rows


# --- a slow test between platens ------------------------------------------------------------------------


def command_fit_contact(chosen: argparse.Namespace) -> int:
    """Onset, hardness and pile-up of a slow test, as the lines of a study."""
    from uqsphere.materials import library
    from uqsphere.mechanics.yielding import metal_onset
    from uqsphere.records.loading import fit_contact, read_loading
    from uqsphere.records.table import RecordError

    diameter = _value(chosen.diameter, "length", "--diameter")
    stiffness = math.inf
    if chosen.machine_stiffness is not None:
        stiffness = _value(chosen.machine_stiffness, "stiffness", "--machine-stiffness")
    if not diameter > 0.0 or not stiffness > 0.0:
        raise UsageError("--diameter and --machine-stiffness must be above zero")
    if not 0.0 <= chosen.nu < 0.5 or (chosen.pile_up is not None and not 1.0 <= chosen.pile_up <= 3.0):
        raise UsageError("--nu must lie from 0 to below 0.5, --pile-up from 1 to 3")
    known = library()["bars"]
    if chosen.platens != "rigid" and chosen.platens not in known:
        raise UsageError(f"--platens: found {chosen.platens!r}, allowed: rigid, {', '.join(known)}")
    columns = [name.strip() for name in chosen.columns.split(",")] if chosen.columns else []
    try:
        loading = read_loading(chosen.record, columns=columns, units=(chosen.displacement_unit, chosen.force_unit))
        fit = fit_contact(loading, diameter=diameter, compliance=1.0 / stiffness, pile_up=chosen.pile_up)
    except RecordError as error:
        text = str(error).removeprefix(f"{chosen.record.name}: ")
        raise UsageError(f"{chosen.record}: {text}") from None
    notes, soft = list(loading.notes), 0.0
    if chosen.platens != "rigid":
        bar = {key: entry.value for key, entry in known[chosen.platens].properties.items()}
        soft = (1.0 - bar["nu"] ** 2) / bar["E"]
        if fit.onset.high > (onset := float(metal_onset(bar["yield_strength"], bar["nu"]))) / 1.3:
            notes.append(f"the platens yield from {onset / 1e9:.3g} GPa on: what was fitted may be theirs")
    _print_fit(chosen, fit, soft, notes)
    return 0


def _print_fit(chosen: argparse.Namespace, fit: ContactFit, soft: float, notes: Sequence[str]) -> None:
    """The numbers of a fit with their intervals; `soft` [1/Pa] is what the platens add to the compliance."""
    named = {"onset_pressure": fit.onset, "hardness": fit.hardness, "pile_up": fit.pile_up}
    keys = ("value", "low", "high")
    rest = [1.0 / number - soft for number in (fit.modulus.value, fit.modulus.low, fit.modulus.high)]
    young = [(1.0 - chosen.nu**2) / number for number in rest] if min(rest) > 0.0 else None
    if chosen.json:
        content = {name: {key: getattr(part, key) for key in keys} for name, part in named.items()}
        reduced = {key: getattr(fit.modulus, key) for key in keys}
        print(json.dumps({
            "kind": "contact", "file": chosen.record.name, **content, "reduced_modulus": reduced,
            "sphere_modulus": None if young is None else dict(zip(keys, young, strict=True)),
            "depth": fit.depth, "dent": fit.dent, "misfit": fit.misfit, "samples": fit.samples, "notes": list(notes),
        }, indent=2, allow_nan=False))  # fmt: skip
        return
    for note in notes:
        print(f"note: {plain(note)}", file=sys.stderr)
    rows = [_row(name.replace("_", " "), "GPa", 1e-9, [getattr(named[name], key) for key in keys]) for name in
            ("onset_pressure", "hardness")]  # fmt: skip
    rows.append(_row("pile-up", "", 1.0, [getattr(fit.pile_up, key) for key in keys]))
    rows.append(_row("reduced modulus E*", "GPa", 1e-9, [getattr(fit.modulus, key) for key in keys]))
    if young is not None:
        rows.append(_row("E of the sphere that gives it", "GPa", 1e-9, young))
    rows.append(("pressed to, over first yield", f"{fit.depth:.3g}", ""))
    rows.append(("dent", f"{1e6 * fit.dent:.3g} um", ""))
    rows.append(("misfit of the displacement", f"{1e6 * fit.misfit:.2g} um", f"{fit.samples} samples"))
    print(table(("what", "value", "95 % interval"), rows))
    print(f'\n[contact]\nlaw = "plastic"\nonset_pressure = "{fit.onset.value / 1e9:.4g} GPa"')
    print(f'hardness = "{fit.hardness.value / 1e9:.4g} GPa"\npile_up = {fit.pile_up.value:.4g}')
