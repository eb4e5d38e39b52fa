"""The benchmark as one page: what is measured, as tables (Markdown), as JSON, and as two figures."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from uqsphere.bench.measure import (
    Entry,
    cost_tables,
    describe_machine,
    massless_rate,
    measure_scene,
    memory_of,
    ratio_at_error,
    ready_seconds,
    reference_gap,
)
from uqsphere.bench.scenes import bench_scenes
from uqsphere.errors import FolderError
from uqsphere.store import write_outputs

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from uqsphere.report.figures.canvas import Picture

SCHEMA_VERSION: Final = 1


def run_bench(folder: Path, *, quick: bool, notice: Callable[[str], None]) -> dict[str, Any]:
    """Measure speed against error on this machine and write bench.json, bench.md and figures/*.svg to `folder`.

    Raises
    ------
    FolderError
        When the folder holds something that is no benchmark.
    """
    from uqsphere.report.figures.canvas import render, style

    if folder.exists() and any(folder.iterdir()) and not (folder / "bench.json").is_file():
        raise FolderError(f"{folder} is not empty and holds no benchmark: choose another with --out")
    tolerances = [10.0**-k for k in (range(4, 13, 2) if quick else range(3, 13))]
    rounds, slow, rows = (2, 2, 512) if quick else (5, 8, 4096)
    entries, scenes = [], []
    for chosen in bench_scenes(rows):
        notice(f"scene {chosen.name}: {chosen.text}")
        found = measure_scene(chosen, tolerances=tolerances, rounds=rounds, slow_rows=slow)
        entries += found
        gap = reference_gap(found, chosen.name)
        scenes.append({"name": chosen.name, "text": chosen.text, "reference_gap": gap})
    notice("cost against rows, threads, mu and theta")
    cost = cost_tables(largest=10_000 if quick else 1_000_000, rounds=rounds)
    notice("memory and start of a process of its own")
    many = 200_000 if quick else 10_000_000
    best = min(e.seconds_per_row for e in entries if (e.scene, e.contender) == ("A", "full"))
    limits = {
        "memory of 10 million rows of A [MB]" if not quick else "memory of 200,000 rows of A [MB]": {
            "found": memory_of(many), "aim": "below 1,000"},
        "kernel ready in a new process [s]": {"found": ready_seconds(), "aim": "below 1.5"},
        "massless closed form, million rows a second and core": {"found": massless_rate() / 1e6, "aim": "10"},
        "scene A at the loosest tolerance [us a row]": {"found": best * 1e6, "aim": "5"},
    }  # fmt: skip
    content = {
        "schema_version": SCHEMA_VERSION, "quick": quick, "machine": describe_machine(), "scenes": scenes,
        "entries": [asdict(entry) for entry in entries], "ratios": ratios(entries), "cost": cost, "limits": limits,
    }  # fmt: skip
    text = bench_text(content, entries)
    with style():
        pictures = [speed_error_figure(entries), cost_figure(cost)]
        write_outputs(folder / "figures", {f"{picture.name}.svg": render(picture) for picture in pictures})
    document = json.dumps(content, indent=1, allow_nan=False) + "\n"
    write_outputs(folder, {"bench.md": text + "\n", "bench.json": document})
    return {**content, "text": text}


# --- The benchmark as tables (Markdown), as JSON, and as two figures.

#: what is compared with what: scene, quantity, rival, error, and the aim
COMPARED: Final = (
    ("A", "p_max", "solve_ivp DOP853", 1e-8, 1000.0),
    ("A", "p_max", "solve_ivp LSODA", 1e-6, None),
    ("A", "p_max", "solve_ivp Radau", 1e-8, None),
    ("B", "p_max", "solve_ivp DOP853", 1e-8, 300.0),
    ("B", "contact_time", "solve_ivp DOP853", 1e-8, 300.0),
)


def ratios(entries: Sequence[Entry]) -> list[dict[str, object]]:
    """How many times as fast `full` is at equal median error, with the aims."""
    found = []
    for scene, quantity, rival, error, aim in COMPARED:
        value = ratio_at_error(list(entries), scene, quantity, rival, error)
        found.append(
            {"scene": scene, "quantity": quantity, "rival": rival, "error": error, "times_as_fast": value, "aim": aim}
        )
    return found


def _rows(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return ["| " + " | ".join(row) + " |" for row in (header, ["---"] * len(header), *rows)]


def _time(seconds: float) -> str:
    micro = seconds * 1e6
    return f"{micro:,.3g} us" if micro < 1000.0 else f"{micro / 1000.0:,.3g} ms"


def bench_text(content: dict[str, Any], entries: Sequence[Entry]) -> str:
    """The whole benchmark in Markdown."""
    machine = content["machine"]
    packages = ", ".join(f"{name} {version}" for name, version in machine["packages"].items())
    lines = [
        "# Speed against error",
        "",
        f"{machine['processor']}, {machine['processors']} processors, {machine['system']}, Python {machine['python']}; "
        f"{packages}.",
        "Processor time of one thread, contenders in turn, the best of several rounds. Errors are relative, over the "
        "rows of the scene, against the compiled integrator at 1e-12.",
        "",
    ]
    for scene in content["scenes"]:
        lines += [f"## Scene {scene['name']}: {scene['text']}", ""]
        gaps = ", ".join(f"{name} {gap:.1g}" for name, gap in scene["reference_gap"].items())
        lines += [f"It and a Runge-Kutta method of order 8 at 1e-12 differ by at most: {gaps}.", ""]
        listed = [
            (e.contender, "-" if e.tolerance is None else f"{e.tolerance:.0e}", e.quantity, _time(e.seconds_per_row),
             f"{e.median:.1e}", f"{e.worst:.1e}", str(e.rows))
            for e in entries if e.scene == scene["name"]
        ]  # fmt: skip
        header = ("contender", "tolerance", "quantity", "time a row", "median error", "worst", "rows")
        lines += [*_rows(header, listed), ""]
    lines += ["## Ratios in this run, per core, at equal median error", ""]
    rows = [
        (r["scene"], r["quantity"], r["rival"], f"{r['error']:.0e}",
         "not measured" if r["times_as_fast"] is None else f"{r['times_as_fast']:,.3g}",
         "-" if r["aim"] is None else f"{r['aim']:,.0f}")
        for r in content["ratios"]
    ]  # fmt: skip
    lines += [*_rows(("scene", "quantity", "rival", "error", "times as fast", "aim"), rows), ""]
    lines += ["## Cost", ""]
    for name, points in content["cost"].items():
        lines.append(f"- {name}: " + ", ".join(f"{at:g} → {cost:,.3g} us" for at, cost in points))
    lines += ["", "Microseconds a row of scene A (for mu and theta, around the other number of scene A), p_max, 1e-6;"]
    lines += ["wall time for threads, processor time otherwise.", ""]
    found = [(name, f"{limit['found']:,.3g}", limit["aim"]) for name, limit in content["limits"].items()]
    lines += _rows(("what", "found", "aim"), found)
    return "\n".join(lines)


def _plain_ticks(panel: Axes) -> None:
    """Powers of ten as they are written in the tables; the style knows no mathematical notation."""
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.set_minor_formatter(lambda value, _: "")


def speed_error_figure(entries: Sequence[Entry]) -> Picture:
    """Error on one axis, seconds per million rows on the other, one panel per scene."""
    from uqsphere.report.figures.canvas import BLUE, GREEN, GREY, MARKS, ORANGE, PURPLE, RED, Picture, new_figure

    colours = {
        "full": BLUE, "linear": PURPLE, "massless": GREEN, "solve_ivp DOP853": RED,
        "solve_ivp LSODA": ORANGE, "solve_ivp Radau": GREY,
    }  # fmt: skip
    scenes = sorted({e.scene for e in entries})
    figure, axes = new_figure(3.6 * len(scenes), rows=len(scenes))
    for panel, scene in zip(axes, scenes, strict=True):
        for k, (contender, colour) in enumerate(colours.items()):
            points = [
                (max(e.median, 1e-15), 1e6 * e.seconds_per_row)
                for e in entries
                if (e.scene, e.contender, e.quantity) == (scene, contender, "p_max")
            ]
            if not points:
                continue
            errors, seconds = zip(*sorted(points), strict=True)
            panel.plot(errors, seconds, color=colour, marker=MARKS[k % len(MARKS)], markersize=4.5, label=contender)
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.invert_xaxis()
        panel.set_xlabel("median relative error of p_max (more accurate to the right)")
        panel.set_ylabel("seconds per million rows, one core")
        panel.set_title(f"Scene {scene}")
        _plain_ticks(panel)
        panel.grid(True, which="major")
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return Picture(
        name="speed_error", title="Speed against error", figure=figure,
        finding="At every error the compiled integrator costs a small share of what general integrators cost.",
    )  # fmt: skip


def cost_figure(cost: dict[str, list[tuple[float, float]]]) -> Picture:
    """Microseconds a row against number of rows, mass number and pulse number."""
    from uqsphere.report.figures.canvas import BLUE, Picture, new_figure

    names = {"rows": "rows in one call", "mu": "mass number mu", "theta": "pulse number theta"}
    figure, axes = new_figure(7.2, rows=len(names))
    for panel, (name, label) in zip(axes, names.items(), strict=True):
        at, micro = zip(*cost[name], strict=True)
        panel.plot(at, micro, color=BLUE, marker="o", markersize=4.5)
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_xlabel(label)
        panel.set_ylabel("us a row, one core")
        _plain_ticks(panel)
        panel.grid(True, which="major")
    return Picture(
        name="cost", title="What a row costs", figure=figure,
        finding="Light spheres and long pulses cost most, because their oscillation has to be followed.",
    )  # fmt: skip
