"""What tests say, for the command line: the pulse of one gauge, forces from two bars, a folder of tests, a calibration
shot, and the law of a contact that yields, from a slow test on a sphere between two platens."""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol

from uqsphere.cli.studies import number_of
from uqsphere.console import answer, plain, table
from uqsphere.errors import UsageError

if TYPE_CHECKING:
    from uqsphere.records.inverse import Rig
    from uqsphere.records.laboratory import Calibration, Reading
    from uqsphere.records.loading import ContactFit
    from uqsphere.records.pulse import Bar
    from uqsphere.records.record import Record, Wiring
    from uqsphere.study import Study


class Found(Protocol):
    """A number with its 95 % interval."""

    @property
    def value(self) -> float: ...
    @property
    def low(self) -> float: ...
    @property
    def high(self) -> float: ...


#: ends of the names of records, in a folder
_ENDINGS: Final = (".csv", ".txt", ".tsv", ".dat", ".asd", ".raw", ".xlsx")
#: records of a folder, and notes on one that are printed
_MOST, _NOTES = 1000, 12


def _window(text: str | None) -> tuple[float | None, float | None]:
    parts = [] if text is None else text.split(",")
    if len(parts) not in (0, 2):
        raise UsageError(f'--window takes begin and end, such as "100 us,420 us", found {text!r}')
    begin, end = (number_of(part, "time", "--window") for part in parts) if parts else (None, None)
    return begin, end


def _wirings(chosen: argparse.Namespace, signals: int) -> list[Wiring]:
    """How each signal becomes strain; of two numbers the first is the incident bar's."""
    from uqsphere.records.record import Wiring

    numbers: dict[str, list[float]] = {}
    for name in ("gauge_factor", "amplification", "active_arms", "excitation"):
        option = f"--{name.replace('_', '-')}"
        try:
            found = [float(part) for part in str(getattr(chosen, name)).split(",")]
        except ValueError:
            raise UsageError(f"{option} takes a number, or one for each bar, such as 200,500") from None
        if len(found) > 2 or not all(0.0 < value < math.inf or name == "excitation" for value in found):
            raise UsageError(f"{option} must be above zero, one number or two, found {getattr(chosen, name)}")
        numbers[name] = [found[0]] * (signals - 1) + found[-1:]
    return [
        Wiring(unit=chosen.unit, time_unit=chosen.time_unit, **{name: each[k] for name, each in numbers.items()})
        for k in range(signals)
    ]


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """What is wrong with a record, as what is wrong with the command."""
    from uqsphere.records.table import RecordError

    try:
        yield
    except RecordError as error:
        text = str(error).removeprefix(f"{path.name}: ")
        raise UsageError(f"{path}: {text}") from None


def columns_named(chosen: argparse.Namespace) -> list[str]:
    return [name.strip() for name in chosen.columns.split(",")] if chosen.columns else []


def command_records(chosen: argparse.Namespace) -> int:
    """The pulse of a record, or forces, energies, stiffness and the end of the elastic contact of a test or of many."""
    from uqsphere.study import load_study

    if not 0.0 <= chosen.gain_sd < 1.0:
        raise UsageError(f"--gain-sd must lie from 0 to below 1, found {chosen.gain_sd}")
    study = None if chosen.study is None else load_study(chosen.study, chosen.overrides)
    if study is not None and study.black_box:
        raise UsageError("records need a scene with sphere and bars; this study is a black box")
    if chosen.pdf:
        from uqsphere.report.lab import check_paper

        check_paper()
    path = chosen.record
    if chosen.beside and (path.is_dir() or chosen.calibration is not None):
        raise UsageError("--with adds channels to one record: it goes with no folder and no --calibration")
    with reading(path):
        shot = _calibration(chosen, study)
        if path.is_dir():
            return _folder(chosen, study, shot)
        said = _said(chosen, path, study, shot)
    written = _write(chosen.out, said.files()) if chosen.out is not None else []
    more = len(said.notes) - _NOTES
    _note(chosen, [*said.notes[:_NOTES], *[f"and {more} more, in --json and on the sheet"] * (more > 0)])
    return answer(chosen, {**said.content, "written": written}, lambda: table(said.header, said.rows), written)


def _note(chosen: argparse.Namespace, notes: Sequence[str]) -> None:
    """Notes on stderr, where the answer is no document that has them."""
    if not chosen.json:
        print("".join(f"note: {plain(note)}\n" for note in notes), end="", file=sys.stderr)


@dataclass(frozen=True, kw_only=True)
class _Said:
    """What a record says: the JSON document, the rows of the table, and the files that can be written."""

    content: dict[str, object]
    notes: Sequence[str]
    header: tuple[str, ...]
    rows: list[tuple[str, ...]]
    files: Callable[[], dict[str, str | bytes]]


def _write(folder: Path, files: Mapping[str, str | bytes]) -> list[str]:
    from uqsphere.store import write_outputs

    return [str(path) for path in write_outputs(folder, files)]


def _read(chosen: argparse.Namespace, path: Path, study: Study | None) -> Record:
    """The record, mended, with one signal for every bar or wave."""
    from uqsphere.records.record import make_record, mend
    from uqsphere.records.table import beside, read_table

    columns = columns_named(chosen)
    interval = number_of(chosen.sample_interval, "time", "--sample-interval") if chosen.sample_interval else 0.0
    read = read_table(path, interval)
    for other in chosen.beside:
        read = beside(read, read_table(other, interval))
    signals = (len(columns) or len(read.names)) - 1
    if signals > 1 and study is None:
        raise UsageError(
            f"{path.name} has {signals} signals: name the study with sphere and bars by --study, or the one "
            "that is the pulse by --columns TIME,SIGNAL"
        )
    if signals in (4, 6) and not columns:
        signals //= 2  # two gauges a bar
    signals = min(max(signals, 1), 3)
    return mend(make_record(read, signals, wiring=_wirings(chosen, signals), columns=columns), chosen.polarity)


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


def _other_bar(text: str | None, columns: Mapping[str, float]) -> tuple[Bar, float] | None:
    """Another receiving bar and its E A [N]."""
    if text is None:
        return None
    units = {"E": "pressure", "density": "density", "diameter": "length"}
    given = {key: columns[f"bars.{key}"] for key in units}
    for part in text.split(","):
        key, _, value = (piece.strip() for piece in part.partition("="))
        if key not in units:
            raise UsageError('--receiving-bar takes E, density and diameter, such as "E=72 GPa, density=2810 kg/m3"')
        given[key] = number_of(value, units[key], "--receiving-bar")
        if not given[key] > 0.0:
            raise UsageError(f"--receiving-bar: {key} must be above zero")
    bar = _bar({f"bars.{key}": value for key, value in given.items()} | {"bars.nu": columns["bars.nu"]})
    return bar, given["E"] * math.pi * bar.radius**2


def _rig(chosen: argparse.Namespace, columns: Mapping[str, float], study: Study) -> tuple[Rig, float | None]:
    """Bars and gauges, and E A of a receiving bar that is another."""
    from uqsphere.records.inverse import Rig

    infinite = bool(study.options["bars.infinite"])
    gauges, lengths, silent = {}, {}, math.inf
    for bar in ("incident", "receiving"):
        gauges[bar] = number_of(getattr(chosen, f"{bar}_gauge"), "length", f"--{bar}-gauge")
        length = columns.get(f"bars.{bar}_length", math.inf)
        # an end that sends nothing back leaves the record undisturbed
        absorbs = columns.get(f"bars.{bar}_end", 1.0) == 0.0
        lengths[bar] = math.inf if infinite or absorbs else length
        if absorbs and not infinite:
            silent = min(silent, length - gauges[bar])
    other = _other_bar(chosen.receiving_bar, columns)
    rig = Rig(bar=_bar(columns), incident_gauge=gauges["incident"], receiving_gauge=gauges["receiving"],
              incident_length=lengths["incident"], receiving_length=lengths["receiving"], absorbing_length=silent,
              correct_dispersion=chosen.correct_dispersion,
              receiving_bar=other[0] if other else None)  # fmt: skip
    return rig, other[1] if other else None


def _calibration(chosen: argparse.Namespace, study: Study | None) -> Calibration | None:
    """What the shot without a specimen says of bars and gauges."""
    from uqsphere.records.laboratory import calibrate

    if chosen.calibration is None:
        return None
    if study is None:
        raise UsageError("--calibration needs --study with the bars, and the gauges' distances")
    rig, other = _rig(chosen, _numbers(study), study)
    if other is not None:
        raise UsageError("--calibration is for two equal bars: it goes without --receiving-bar")
    speed = number_of(chosen.striker_speed, "speed", "--striker-speed") if chosen.striker_speed else 0.0
    return calibrate(_read(chosen, chosen.calibration, study), rig, speed)


def _said(chosen: argparse.Namespace, path: Path, study: Study | None, shot: Calibration | None) -> _Said:
    record = _read(chosen, path, study)
    if record.strain.shape[1] < 2 or study is None:
        return _pulse(chosen, path, record, study)
    return _test(chosen, path, record, study, shot)


def _pulse(chosen: argparse.Namespace, path: Path, record: Record, study: Study | None) -> _Said:
    from uqsphere.records.pulse import cut_pulse, fit_pulse
    from uqsphere.records.table import read_bytes

    begin, end = _window(chosen.window)
    distance = number_of(chosen.incident_gauge, "length", "--incident-gauge")
    columns = None if study is None else _numbers(study)
    bar = None
    if chosen.correct_dispersion:
        if columns is None or not distance > 0.0:
            raise UsageError("--correct-dispersion needs --study with the bars, and --incident-gauge")
        bar = _bar(columns)
    cut = cut_pulse(record, bar=bar, distance=distance if bar else 0.0, begin=begin, end=end)
    pulse = fit_pulse(cut, path.name, hashlib.sha256(read_bytes(path)).hexdigest())
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
        rows.append(("striker speed that it stands for", f"{speed:.4g} m/s"))

    def files() -> dict[str, str | bytes]:
        from uqsphere.report.lab import pulse_figure

        return {"record.svg": pulse_figure(record, cut, pulse)}

    content: dict[str, object] = {
        "kind": "pulse", "file": path.name, "peak_strain": pulse.peak, "duration": pulse.duration,
        "rise": pulse.rise, "begin": cut.begin, "step": record.step, "noise": float(record.noise[0]),
        "noise_modes": pulse.noise, "band_share": cut.inside, "pieces": len(pulse.breaks) - 1, "striker_speed": speed,
        "notes": list(pulse.notes), "changes": _changes(record),
    }  # fmt: skip
    return _Said(content=content, notes=pulse.notes, header=("what", "value"), rows=rows, files=files)


def _changes(record: Record) -> list[dict[str, object]]:
    """What mending changed, with sample, time [s] and size [strain] where they are known."""
    keys = ("step", "signal", "sample", "time", "size", "text")
    return [{key: getattr(one, key) for key in keys if getattr(one, key) is not None} for one in record.changes]


def _test(chosen: argparse.Namespace, path: Path, record: Record, study: Study, shot: Calibration | None) -> _Said:
    from uqsphere.records.laboratory import read_test

    columns = _numbers(study)
    if shot is not None:
        columns["bars.E"] = columns["bars.density"] * shot.wave_speed**2
        gains = [shot.gains[0]] * (record.strain.shape[1] - 1) + [shot.gains[1]]
        record = replace(record, strain=record.strain * gains, noise=record.noise * gains,
                         offset=record.offset * gains, spread=record.spread * gains)  # fmt: skip
    rig, receiving = _rig(chosen, columns, study)
    bound = number_of(chosen.bound, "force", "--bound") if chosen.bound else math.inf
    read = read_test(record, rig, columns, gain_sd=chosen.gain_sd, window=_window(chosen.window), receiving=receiving,
                     sphere=chosen.specimen == "sphere", bound=bound)  # fmt: skip
    content, rows = _answers(read, columns)
    content = {"kind": "test", "file": path.name, "samples": len(read.forces.time), "step": read.faces.step,
               "end": float(read.forces.time[-1]), **content,
               "bar_speed": rig.bar.wave_speed, "diameter": 2.0 * columns["sphere.radius"],
               "changes": _changes(record)}  # fmt: skip
    notes = [*(shot.notes if shot else ()), *read.notes]
    content["notes"] = notes
    header = ("what", "value", "95 % interval")

    def files() -> dict[str, str | bytes]:
        from uqsphere.report.lab import forces_figure, lab_sheet, printed, pulse_figure
        from uqsphere.store import csv_text

        force = read.forces
        names = ["time [s]", "force_a [N]", "force_b [N]", "force_mean [N]", "difference_over_largest [-]"]
        apart = (force.force_a - force.force_b) / read.peaks["mean"].value
        courses = [force.time, force.force_a, force.force_b, 0.5 * (force.force_a + force.force_b), apart]
        for face in "AB":
            names += [f"force_{face.lower()}_{side} [N]" for side in ("low", "high")]
            courses += force.interval(face)
        if read.inverse is not None:
            names += ["model_a [N]", "model_b [N]"]
            courses += [read.inverse.fitted_a, read.inverse.fitted_b]
        lines = [[float(course[k]) for course in courses] for k in range(len(force.time))]
        pulse = read.inverse.pulse if read.inverse is not None else None
        figures = [forces_figure(read), pulse_figure(record, read.faces.pulse, pulse)]
        page = lab_sheet(path.name, header, rows, notes, figures)
        found: dict[str, str | bytes] = {"forces.csv": csv_text(names, lines), "forces.svg": figures[0],
                                         "record.svg": figures[1], "sheet.html": page}  # fmt: skip
        return {**found, **({"sheet.pdf": printed(page)} if chosen.pdf else {})}

    return _Said(content=content, notes=notes, header=header, rows=rows, files=files)


def three(found: Found) -> Sequence[float]:
    """Value and the ends of its interval."""
    return found.value, found.low, found.high


def ends(numbers: Sequence[float]) -> dict[str, float]:
    return dict(zip(("value", "low", "high"), numbers, strict=True))


def _young(reduced: Sequence[float], soft: float, nu: float) -> list[float] | None:
    """E of the sphere (Pa) by reduced moduli and the compliance `soft` [1/Pa] of what it is pressed with."""
    rest = [1.0 / modulus - soft for modulus in reduced]
    return [(1.0 - nu**2) / compliance for compliance in rest] if min(rest) > 0.0 else None


def number_row(what: str, unit: str, factor: float, numbers: Sequence[float]) -> tuple[str, ...]:
    """A row of the table: value, low and high (SI) in a unit of 1/factor."""
    value, low, high = (f"{number * factor:.4g}" for number in numbers)
    return what, f"{value} {unit}", f"{low} to {high} {unit}"


def _answers(read: Reading, columns: Mapping[str, float]) -> tuple[dict[str, object], list[tuple[str, ...]]]:
    """The numbers of the JSON document and the rows of the table."""
    largest, rows = {}, []
    waves = {"A": "largest force at A, two waves", "B": "largest force at B, one wave",
             "mean": "largest mean of both, three waves"}  # fmt: skip
    for face, peak in read.peaks.items():
        largest[face] = {"time": peak.time, **ends(three(peak)), "doubts": list(peak.doubts)}
        rows.append(number_row(f"{waves[face]}, at {peak.time * 1e6:.4g} us", "kN", 1e-3, three(peak)))
        rows += [("  doubted", doubt, "") for doubt in peak.doubts]
    energies = dict(zip(("to_largest", "whole"), read.energies or (), strict=False))
    for what, energy in energies.items():
        parts = f"{energy.incident:.4g} J in, {energy.reflected:.3g} back, {energy.transmitted:.3g} on"
        said = "in all" if what == "whole" else "up to the largest force"
        rows.append((f"energy absorbed, {said}", f"{energy.absorbed:.4g} J", parts))
    if read.balance is not None:
        balanced = "never" if read.balanced is None else f"{read.balanced * 1e6:.4g} us"
        rows.append(("forces first within 5 % of their mean", balanced,
                     f"{read.balance:.0%} of the time from half the force to the largest"))  # fmt: skip
    rows.append(("loading rate", f"{read.loading_rate * 1e-9:.4g} kN/us", ""))
    rows.append(("for the camera: first touch", f"{read.touch * 1e6:.8g} us of the record",
                 f"the largest force {read.peaks['B'].time * 1e6:.4g} us later"))  # fmt: skip
    model, more = _of_the_sphere(read, columns)
    content: dict[str, object] = {
        "largest_force": largest, "energy": {
            what: {key: getattr(one, key) for key in ("incident", "reflected", "transmitted", "absorbed")}
            for what, one in energies.items()
        }, "balanced_from": read.balanced, "balanced_share": read.balance,
        "loading_rate": read.loading_rate, "first_touch": read.touch, **model, "withheld": list(read.withheld),
    }  # fmt: skip
    return content, [*rows, *more, *(("withheld", text, "") for text in read.withheld)]


def _of_the_sphere(read: Reading, columns: Mapping[str, float]) -> tuple[dict[str, object], list[tuple[str, ...]]]:
    """Stiffness and the end of the elastic contact, where an elastic sphere explains the record."""
    found = read.inverse
    if found is None:
        names = ("reduced_modulus", "sphere_modulus", "gains", "misfit", "elastic_throughout", "departure")
        return dict.fromkeys(names), []
    stiff, end = found.stiffness, found.departure
    reduced = (stiff.modulus, stiff.low, stiff.high)
    rows = [number_row("reduced modulus E*", "GPa", 1e-9, reduced)]
    young = _young(reduced, (1.0 - columns["bars.nu"] ** 2) / columns["bars.E"], columns["sphere.nu"])
    if young is not None:
        rows.append(number_row("E of the sphere that gives it", "GPa", 1e-9, young))
    rows.append(("misfit over noise", f"{stiff.misfit:.3g}", ""))
    departure = None
    if end is None:
        rows.append(("elastic contact", "held to the end of the record", ""))
    else:
        rows.append(number_row("elastic contact ends", "us", 1e6, (end.time, end.earliest, end.latest)))
        said = "candidate for fracture" if read.broke else "no fracture"
        rows += [number_row(f"force at {face} there, {said}", "kN", 1e-3, force)
                 for face, force in (("A", end.force_a), ("B", end.force_b))]  # fmt: skip
        departure = {
            "time": end.time, "earliest": end.earliest, "latest": end.latest, "excess": end.excess,
            "force_a": ends(end.force_a), "force_b": ends(end.force_b),
            "candidate": read.broke,
        }  # fmt: skip
    return {
        "reduced_modulus": {**ends(reduced), "std_error": stiff.std_error},
        "sphere_modulus": None if young is None else ends(young),
        "gains": {"incident": stiff.gain_a, "receiving": stiff.gain_b},
        "misfit": stiff.misfit, "elastic_throughout": found.held, "departure": departure,
    }, rows  # fmt: skip


# --- many tests ----------------------------------------------------------------------------------------


def _folder(chosen: argparse.Namespace, study: Study | None, shot: Calibration | None) -> int:
    """Every record of a folder: a table that the tests of a study read, and a page with a sheet of each."""
    from uqsphere.records.table import RecordError
    from uqsphere.report.lab import tests_page
    from uqsphere.store import csv_text

    paths = sorted(path for path in chosen.record.iterdir() if path.suffix.lower() in _ENDINGS)
    if not paths or len(paths) > _MOST:
        raise UsageError(f"{chosen.record} has {len(paths)} records ({', '.join(_ENDINGS)}), from 1 to {_MOST} are due")
    if study is None:
        raise UsageError("a folder of tests needs --study with sphere and bars")
    tests: list[dict[str, object]] = []
    rows: list[tuple[str, ...]] = []
    lines: list[list[object]] = []
    written: list[str] = []
    for path in paths:
        try:
            said = _said(chosen, path, study, shot)
        except (RecordError, UsageError) as error:
            text = str(error).removeprefix(f"{path.name}: ")
            tests.append({"kind": "refused", "file": path.name, "why": text})
            rows.append((path.name, "refused", text))
            continue
        if chosen.out is not None:
            written += _write(chosen.out / path.stem, said.files())
        tests.append(said.content)
        line, row = _line(said.content)
        rows.append(row)
        lines += [line] if line else []
    header = ("test", "largest force at B", "noted")
    if chosen.out is not None:
        head = ["test", "diameter_mm", "force_kN", "force_low_kN", "force_high_kN", "modulus_GPa", "stopped", "outcome",
                "absorbed_J", "rate_kN_per_us", "doubted"]  # fmt: skip
        stems = [path.stem for path in paths]
        page = tests_page(chosen.record.name, header, rows, stems)
        written += _write(chosen.out, {"tests.csv": csv_text(head, lines), "index.html": page})
    document = {"kind": "folder", "tests": tests, "written": written}
    return answer(chosen, document, lambda: table(header, rows), written[-2:])


def _line(content: Mapping[str, object]) -> tuple[list[object], tuple[str, ...]]:
    """A test as a line of tests.csv, empty for a pulse, and as a row of the table."""
    if content["kind"] != "test":
        return [], (str(content["file"]), "", "a pulse alone")
    largest, energy, end = content["largest_force"], content["energy"], content["departure"]
    assert isinstance(largest, dict)
    assert isinstance(energy, dict)
    peak = largest["B"]
    broke = isinstance(end, dict) and bool(end["candidate"])
    force = end["force_b"] if broke and isinstance(end, dict) else peak
    doubts = "; ".join(peak["doubts"])
    held = content["elastic_throughout"]
    outcome = "broke" if broke else "survived" if held else ""
    modulus = content["reduced_modulus"]
    line = [content["file"], float(str(content["diameter"])) * 1e3, *(force[key] * 1e-3 for key in
            ("value", "low", "high")), modulus["value"] * 1e-9 if isinstance(modulus, dict) else "", 1 if held else 0,
            outcome, energy["whole"]["absorbed"] if energy else "", float(str(content["loading_rate"])) * 1e-9,
            doubts]  # fmt: skip
    changes = content["changes"]
    assert isinstance(changes, list)
    mended = sum(one["step"] not in ("read", "sign", "baseline", "gauges") for one in changes)
    said = [f"doubted: {doubts}"] * bool(doubts) + [f"{mended} samples or stretches mended"] * bool(mended)
    value = f"{peak['value'] * 1e-3:.4g} kN ({peak['low'] * 1e-3:.4g} to {peak['high'] * 1e-3:.4g})"
    return line, (str(content["file"]), value, "; ".join(said))


def command_fit_contact(chosen: argparse.Namespace) -> int:
    """Onset, hardness and pile-up of a slow test, as the lines of a study."""
    from uqsphere.materials import library
    from uqsphere.mechanics.yielding import metal_onset
    from uqsphere.records.loading import fit_contact, read_loading

    diameter = number_of(chosen.diameter, "length", "--diameter", above=0.0)
    machine = chosen.machine_stiffness
    stiffness = math.inf if machine is None else number_of(machine, "stiffness", "--machine-stiffness", above=0.0)
    if not 0.0 <= chosen.nu < 0.5:
        raise UsageError(f"--nu {chosen.nu:g}: it lies from 0 to below 0.5")
    if chosen.pile_up is not None and not 1.0 <= chosen.pile_up <= 3.0:
        raise UsageError(f"--pile-up {chosen.pile_up:g}: it lies from 1 to 3")
    known = {**library()["bars"], **library()["plates"]}
    if chosen.platens != "rigid" and chosen.platens not in known:
        raise UsageError(f"--platens: found {chosen.platens!r}, allowed: rigid, {', '.join(known)}")
    with reading(chosen.record):
        units = (chosen.displacement_unit, chosen.force_unit)
        loading = read_loading(chosen.record, columns=columns_named(chosen), units=units)
        fit = fit_contact(loading, diameter=diameter, compliance=1.0 / stiffness, pile_up=chosen.pile_up)
    notes, soft = list(loading.notes), 0.0
    if chosen.platens != "rigid":
        bar = {key: entry.value for key, entry in known[chosen.platens].properties.items()}
        soft = (1.0 - bar["nu"] ** 2) / bar["E"]
        onset = float(metal_onset(bar.get("yield_strength", math.inf), bar["nu"]))
        if fit.onset.high > onset / 1.3:
            notes.append(f"the platens yield from {onset / 1e9:.3g} GPa on: what was fitted may be theirs")
    return _answer_fit(chosen, fit, soft, notes)


def _answer_fit(chosen: argparse.Namespace, fit: ContactFit, soft: float, notes: list[str]) -> int:
    """The numbers of a fit with their intervals; `soft` [1/Pa] is what the platens add to the compliance."""
    from uqsphere.quantities import INPUTS, format_value

    named = {"onset_pressure": fit.onset, "hardness": fit.hardness, "pile_up": fit.pile_up}
    young = _young(three(fit.modulus), soft, chosen.nu)
    document = {
        "kind": "contact", "file": chosen.record.name, **{name: ends(three(part)) for name, part in named.items()},
        "reduced_modulus": ends(three(fit.modulus)), "sphere_modulus": None if young is None else ends(young),
        "depth": fit.depth, "dent": fit.dent, "misfit": fit.misfit, "samples": fit.samples, "notes": notes,
    }  # fmt: skip
    if fit.hardness.open:
        notes.append("the test does not tell the hardness: press harder")
    elif chosen.pile_up is None and fit.hardness.high - fit.hardness.low > fit.hardness.value:
        notes.append("the test hardly tells hardness from pile-up: --pile-up narrows the hardness (2 where a sphere "
                     "crushes, 2.667 where a metal flows)")  # fmt: skip
    if fit.alike:
        notes.append(f"neighbouring residuals are alike (correlation {fit.alike:.2g}): the record has what no law of a "
                     "contact has, as a drift or a hold at the largest force, and the intervals do not hold that: "
                     "take it out")  # fmt: skip
    for name, part, key in (("onset", fit.onset, "contact.onset_pressure"), ("modulus E*", fit.modulus, "sphere.E")):
        low, high = INPUTS[key].plausible
        if not low <= part.value <= high:
            found, *usual = (format_value(number, key) for number in (part.value, low, high))
            notes.append(f"the {name} of {found} is unusual (usual: {usual[0]} to {usual[1]}): are the units, those of "
                         "the force and of the displacement, and the diameter right?")  # fmt: skip
    _note(chosen, notes)
    rows = [
        number_row("onset pressure", "GPa", 1e-9, three(fit.onset)),
        number_row("hardness", "GPa", 1e-9, three(fit.hardness)),
        number_row("pile-up", "", 1.0, three(fit.pile_up)),
        number_row("reduced modulus E*", "GPa", 1e-9, three(fit.modulus)),
        *([] if young is None else [number_row("E of the sphere that gives it", "GPa", 1e-9, young)]),
        ("pressed to, over first yield", f"{fit.depth:.3g}", ""), ("dent", f"{1e6 * fit.dent:.3g} um", ""),
        ("misfit of the displacement", f"{1e6 * fit.misfit:.2g} um", f"{fit.samples} samples"),
    ]  # fmt: skip
    end = "  # not told by this test" * fit.hardness.open
    lines = ["", "[contact]", 'law = "plastic"', f'onset_pressure = "{fit.onset.value / 1e9:.4g} GPa"',
             f'hardness = "{fit.hardness.value / 1e9:.4g} GPa"{end}', f"pile_up = {fit.pile_up.value:.4g}"]  # fmt: skip
    return answer(chosen, document, "\n".join([table(("what", "value", "95 % interval"), rows), *lines]))
