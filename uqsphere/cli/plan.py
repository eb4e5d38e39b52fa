"""`uqsphere plan STUDY`: the window of a test in the terminal, as JSON, as tables and as figures."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Final

from uqsphere.cli.studies import number_of, study_of
from uqsphere.console import answer, plain, table
from uqsphere.errors import UsageError
from uqsphere.quantities import format_value
from uqsphere.uq import finite

if TYPE_CHECKING:
    from uqsphere.planning import Chart, Plan, Window
    from uqsphere.study import Study

#: most points of a map in one direction, and striker lengths
_MOST_POINTS: Final = 400
_MOST_LENGTHS: Final = 6
#: how the sides of a window and the kinds of specimen are called
_RANGE: Final = "range"


def _range(text: str | None, dimension: str, unit: str, option: str, *, zero: bool) -> tuple[float, float] | None:
    if text is None:
        return None
    found = [number_of(part, dimension, option, unit=unit) for part in text.split(",")]
    if len(found) != 2 or not found[0] < found[1] or found[0] < 0.0 or (found[0] == 0.0 and not zero):
        least = "0" if zero else "above 0"
        raise UsageError(f"{option} takes two values, the lower {least} and first, found {text!r}")
    return found[0], found[1]


def _lengths(text: str | None) -> list[float] | None:
    if text is None:
        return None
    found = sorted({number_of(part, "length", "--length", unit="m") for part in text.split(",")})
    if not 1 <= len(found) <= _MOST_LENGTHS or found[0] <= 0.0:
        raise UsageError(f"--length takes 1 to {_MOST_LENGTHS} lengths above 0, found {text!r}")
    return found


def _grid(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,4})x(\d{1,4})", text.lower(), re.ASCII)
    if found is None:
        raise UsageError(f"--grid takes speeds x ramps, such as 60x41, found {text!r}")
    speeds, ramps = int(found[1]), int(found[2])
    if not (2 <= speeds <= _MOST_POINTS and 2 <= ramps <= _MOST_POINTS):
        raise UsageError(f"--grid takes 2 to {_MOST_POINTS} points in each direction, found {text!r}")
    return speeds, ramps


def command_plan(chosen: argparse.Namespace) -> int:
    """Speeds, ramps and lengths at which a sphere breaks before a reflection, in equilibrium, between elastic bars."""
    speeds = _range(chosen.speed, "speed", "m/s", "--speed", zero=False)
    rises = _range(chosen.rise, "time", "us", "--rise", zero=True)
    lengths, grid = _lengths(chosen.length), _grid(chosen.grid)
    for name, value in (("--imbalance", chosen.imbalance), ("--quantile", chosen.quantile)):
        if not 0.0 < value < 1.0:
            raise UsageError(f"{name} must lie between 0 and 1, found {value:g}")
    study = study_of(chosen)
    if not study.black_box and study.rig != "bars":
        return _plan_blow(study, chosen, grid[0])
    from uqsphere.planning import plan_test, request_of

    request = request_of(study, speeds=speeds, rises=rises, lengths=lengths, level=chosen.imbalance,
                         quantile=chosen.quantile, grid=grid)  # fmt: skip
    try:
        found = plan_test(study, request)
    except ValueError as error:
        raise UsageError(str(error)) from None
    written = _write(chosen.out, found, study.title) if chosen.out is not None else []
    document = {**plan_document(found, study.title), "written": written}
    return answer(chosen, document, lambda: _text(found), written)


def _plan_blow(study: Study, chosen: argparse.Namespace, count: int) -> int:
    """The plan of a rig that is moved by one number."""
    from uqsphere.planning import plan_blow
    from uqsphere.store import csv_text, write_outputs

    for name in ("speed", "rise", "length"):
        if getattr(chosen, name) is not None:
            raise UsageError(f"--{name} belongs to a test between bars; here between of [margins] gives the range")
    found = plan_blow(study, quantile=chosen.quantile, count=count)
    starts = {"quantile": found.first(found.breaks), "batch": found.first(found.share == 1.0)}
    content: dict[str, object] = {
        "title": study.title, "path": found.path, "limits": [limit.name for limit in found.limits],
        "quantile": found.quantile, "starts": starts, "values": found.values.tolist(), "force": found.force.tolist(),
        "breaks": found.breaks.tolist(), "share": found.share.tolist(), "grade": found.grade.tolist(),
        "check": list(found.check),
    }  # fmt: skip
    written = []
    if chosen.out is not None:
        columns = (found.values, found.force, found.share, found.grade)
        rows = [[*map(float, row), check] for *row, check in zip(*columns, found.check, strict=True)]
        head = [f"{found.path} [SI]", "P_max [N]", "share_of_strengths", "grade", "check"]
        written = [str(path) for path in write_outputs(chosen.out, {"plan.csv": csv_text(head, rows)})]
    said = {name: "nowhere in the range" if value is None else f"from {format_value(value, found.path)}"
            for name, value in starts.items()}  # fmt: skip
    lines = [("the sphere breaks by", ", ".join(limit.name for limit in found.limits)),
             (f"at quantile {found.quantile:g} of the strength", said["quantile"]),
             ("at 5 to 95 % of it", said["batch"])]  # fmt: skip
    # values of a rig's one number that are listed
    points = [
        (format_value(float(found.values[k]), found.path), format_value(float(found.force[k]), "P_max"),
         f"{100.0 * found.share[k]:.0f} %", found.check[k] or ("no answer" if found.grade[k] < 0 else "-"))
        for k in range(0, count, max(count // 12, 1))
    ]  # fmt: skip
    blocks = [f"{plain(study.title)}: what breaks the sphere, all else at its mean", table(("what", "value"), lines),
              table((found.path, "force", "spheres that break", "the model warns of"), points)]  # fmt: skip
    return answer(chosen, {**content, "written": written}, "\n\n".join(blocks), written)


# --- what is found, as JSON and text --------------------------------------------------------------


def plan_document(found: Plan, title: str) -> dict[str, object]:
    """A plan as plain JSON, SI.

    `binding` (ramps x speeds) names the constraint that binds for the specimen asked for, `kept` tells whether it keeps
    them all, `share` how much of the batch does.
    """
    from uqsphere.mechanics.design import CONSTRAINTS

    subject, request, names = found.subject, found.request, list(CONSTRAINTS)
    at, batch = subject.place, list(subject.batch)
    return {
        "title": title,
        "limits": {
            limit.name: {"quantity": limit.quantity, "strength": float(subject.strengths[at, k]),
                         "strength_low": float(subject.strengths[0, k]),
                         "strength_high": float(subject.strengths[-1, k])}
            for k, limit in enumerate(subject.limits)
        },
        "quantile": request.quantile,
        "batch": [float(subject.fractiles[k]) for k in batch],
        "imbalance": request.level,
        "fidelity": subject.fidelity,
        "first_return": finite(subject.first_return),
        "not_checked": ["pulse_yield", "contact_yield"] if not _knows_yield(found) else [],
        "constraints": dict(CONSTRAINTS),
        "speeds": found.speeds.tolist(),
        "rises": found.rises.tolist(),
        "shortest_striker": [[finite(value) for value in row] for row in found.shortest[:, :, at]],
        "charts": [
            {
                "length": chart.length,
                "windows": [_window(window) for window in chart.windows],
                "in_the_way": [{"specimens": kind, "rise": rise, "constraint": name}
                               for (kind, rise), name in chart.nearest.items()],
                "binding": [[names[k] if k >= 0 else None for k in row] for row in chart.binds[:, :, at]],
                "kept": chart.kept[:, :, at].tolist(),
                "share": chart.kept[:, :, batch].mean(axis=2).tolist(),
            }
            for chart in found.charts
        ],
    }  # fmt: skip


def _knows_yield(found: Plan) -> bool:
    return found.subject.columns.get("bars.yield_strength", 0.0) > 0.0


def _window(window: Window) -> dict[str, float | str | None]:
    return {"specimens": window.kind, "rise": window.rise, "low": window.low, "high": window.high,
            "below": window.below, "above": window.above}  # fmt: skip


def _cells(chart: Chart, kind: str, rise: float) -> tuple[str, str, str]:
    """The widest window of one ramp, what ends it and how many there are, or what is in the way."""
    windows = [window for window in chart.windows if window.kind == kind and window.rise == rise]
    if not windows:
        return "none", chart.nearest[kind, rise], "0"
    widest = max(windows, key=lambda window: window.high / window.low)
    ends = f"{widest.below or _RANGE} / {widest.above or _RANGE}"
    return f"{widest.low:.4g} to {widest.high:.4g}", ends, str(len(windows))


def _yield_notes(found: Plan) -> Iterator[str]:
    """What is to be said of bars that yield, or of which it is not known."""
    if not _knows_yield(found):
        yield "note: the yield strength of the bars is not given, so that they are not known to stay elastic"
    over = max(filter(math.isfinite, found.over_onset[:, :, found.subject.place].flat), default=0.0)
    if found.subject.dents and over > 1.0:
        yield (f"note: when the sphere breaks the pressure by Hertz is up to {over:.3g} times the onset of yield of "
               "bars or inserts: dents stay, and the forces take them into account")  # fmt: skip


def _text(found: Plan) -> str:
    from uqsphere.mechanics.design import CONSTRAINTS

    subject, request = found.subject, found.request
    scatter = len(subject.batch) > 1
    lines = [("the sphere breaks by", ", ".join(
        f"{limit.name} ({format_value(float(subject.strengths[subject.place, k]), limit.quantity)})"
        for k, limit in enumerate(subject.limits)
    ))]  # fmt: skip
    lines.append(("specimen shown", f"quantile {request.quantile:g} of the strength" if scatter else "the only one"))
    lines.append(("|P_A - P_B| at fracture", f"at most {request.level:.3g} of the larger force"))
    back = subject.first_return
    lines.append(("first reflected wave", f"after {back * 1e6:.4g} us" if math.isfinite(back) else "none comes"))
    blocks = [table(("what", "value"), lines), *_yield_notes(found)]
    head = ["ramp [us]", "widest window [m/s]", "ends by, below / above", "windows"]
    if scatter:
        head += ["for 5 to 95 % of the strengths", "ends by", "windows"]
    seen = set()
    for chart in found.charts:
        rows = []
        for rise in found.listed:
            cells = list(_cells(chart, "quantile", rise))
            if scatter:
                cells += _cells(chart, "batch", rise)
            rows.append([f"{rise * 1e6:.4g}", *cells])
            seen |= {name for name in CONSTRAINTS if any(name in cell for cell in cells)}
        blocks.append(f"striker of {chart.length:.4g} m\n" + table(head, rows))
    blocks.append("\n".join(f"{name}: {words}" for name, words in CONSTRAINTS.items() if name in seen))
    return "\n\n".join(blocks)


# --- files ----------------------------------------------------------------------------------------


def _write(folder: Path, found: Plan, title: str) -> list[str]:
    from uqsphere.planning import plan_figure
    from uqsphere.store import csv_text, write_outputs

    windows = [
        [chart.length, *("" if value is None else value for value in _window(window).values())]
        for chart in found.charts
        for window in chart.windows
    ]
    head = ["striker_length [m]", "specimens", "rise [s]", "speed_low [m/s]", "speed_high [m/s]", "below", "above"]
    files = {"plan.csv": csv_text(*_points(found)), "windows.csv": csv_text(head, windows)}
    for k in range(len(found.charts)):
        files[f"plan{'' if len(found.charts) == 1 else f'-{k + 1}'}.svg"] = plan_figure(found, k, title)
    return [str(path) for path in write_outputs(folder, files)]


def _points(found: Plan) -> tuple[list[str], list[list[float | str]]]:
    """Header and rows of every point of the map, for the specimen that is asked for; what is not known is empty."""
    from uqsphere.mechanics.design import CONSTRAINTS

    subject, names, breaks = found.subject, list(CONSTRAINTS), found.breaks
    at, batch = subject.place, list(subject.batch)
    head = ["striker_length [m]", "speed [m/s]", "rise [s]", "kept", "share_of_strengths", "binding",
            *(f"used_{name}" for name in names), "pressure_over_onset", "limit", "fracture_time [s]",
            "fracture_force [N]", "imbalance", "wave_transits", "shortest_striker [m]"]  # fmt: skip

    def cell(value: float) -> float | str:
        return float(value) if math.isfinite(value) else ""

    rows: list[list[float | str]] = []
    for chart in found.charts:
        share = chart.kept[:, :, batch].mean(axis=2)
        for (r, rise), (s, speed) in product(enumerate(found.rises), enumerate(found.speeds)):
            place, limit = int(chart.binds[r, s, at]), int(breaks.limit[r, s, at])
            parts = (breaks.time, breaks.force, breaks.imbalance, found.transits, found.shortest)
            rows.append(
                [chart.length, float(speed), float(rise), int(chart.kept[r, s, at]), float(share[r, s]),
                 names[place] if place >= 0 else "", *(cell(chart.used[name][r, s, at]) for name in names),
                 cell(found.over_onset[r, s, at]), subject.limits[limit].name if limit >= 0 else "",
                 *(cell(part[r, s, at]) for part in parts)]
            )  # fmt: skip
    return head, rows
