"""Speed against error on this machine, beside general integrators set up as a good user would: as tables (Markdown), as
JSON, and as two figures."""

from __future__ import annotations

import json
import math
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib import metadata
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import FolderError
from uqsphere.files import Json
from uqsphere.mechanics import closed_form
from uqsphere.mechanics.integrator import solve as dynamics
from uqsphere.mechanics.integrator import tracked as layout
from uqsphere.mechanics.integrator.solve import scaled_arguments
from uqsphere.mechanics.scene import Scene
from uqsphere.store import write_outputs

if TYPE_CHECKING:
    from uqsphere.report.figures.canvas import Picture


#: granite of 20 mm between long steel bars of 40 mm; mu and theta are set by density and striker
NUMBERS: Final = {
    "sphere.E": 52e9,
    "sphere.nu": 0.25,
    "sphere.radius": 10e-3,
    "sphere.density": 2650.0,
    "bars.E": 210e9,
    "bars.nu": 0.3,
    "bars.density": 7850.0,
    "bars.diameter": 40e-3,
    "striker.speed": 1.0,
    "striker.length": 1.0,
}


@dataclass(frozen=True, kw_only=True)
class BenchScene:
    """Rows of one scene, the quantities that are asked for, and what the scene is."""

    name: str
    scene: Scene
    quantities: tuple[str, ...]
    text: str


def scattered_scene(count: int, *, mu: float = 3e-3, theta: float = 3.0, seed: int = 0) -> Scene:
    """Infinite bars, rectangular pulse, lognormal scatter of E, radius and speed (10, 2, 10 %) about mu and theta."""
    rng = np.random.default_rng(seed)
    columns = {name: np.full(count, number) for name, number in NUMBERS.items()}
    for name, scatter in (("sphere.E", 0.1), ("sphere.radius", 0.02), ("striker.speed", 0.1)):
        columns[name] = columns[name] * np.exp(scatter * rng.standard_normal(count))
    centre = Scene(columns={name: np.array([number]) for name, number in NUMBERS.items()}, infinite=True).scales
    columns["sphere.density"] *= mu / centre.mass_number[0]
    columns["striker.length"] *= theta / centre.pulse_number[0]
    return Scene(columns=columns, infinite=True)


def _granite(count: int) -> Scene:
    """Rows of the shipped granite study, drawn from its own distributions."""
    from uqsphere.model import scene_of
    from uqsphere.runner.evaluate import draw
    from uqsphere.study import load_study, shipped_studies

    study = load_study(shipped_studies()["granite"])
    names = tuple(name for name in study.random if not name.startswith("limits."))
    points = draw(study.inputs().only(names), seed=1, task="bench", start=0, count=count, replicates=1)
    return scene_of(study, {name: points.inputs[0, :, k] for k, name in enumerate(names)}, count)


def bench_scenes(count: int) -> list[BenchScene]:
    """Scenes A and B of the benchmark with `count` rows each."""
    return [
        BenchScene(
            name="A",
            scene=scattered_scene(count),
            quantities=("p_max",),
            text="infinite bars, rectangular pulse, mu = 3e-3, theta = 3, lognormal scatter",
        ),
        BenchScene(
            name="B",
            scene=_granite(count),
            quantities=("p_max", "contact_time"),
            text="the granite study: bars of 1.5 m, trapezoid, free and absorbing far end",
        ),
    ]


# --- general integrators ------------------------------------------------------------------------------------


#: methods of scipy.integrate.solve_ivp
METHODS: Final = ("DOP853", "LSODA", "Radau")
#: time over t_c after which no peak can follow the pulse of scene A: the energy that is left lies below the peak's
AFTER: Final = 0.6


def _pulse(arguments: Mapping[str, Array], row: int, time: float) -> float:
    breaks, coefficients = arguments["breaks"][row], arguments["coefficients"][row]
    piece = int(np.searchsorted(breaks, time, side="right")) - 1
    if not 0 <= piece < len(coefficients):
        return 0.0
    z = time - breaks[piece]
    c = coefficients[piece]
    return float(c[0] + z * (c[1] + z * (c[2] + z * c[3])))


def _stops(arguments: Mapping[str, Array], row: int, horizon: float) -> list[float]:
    """Times at which a solution has to be taken up anew: jumps of the pulse and of what comes back, round trips."""
    breaks = [float(b) for b in arguments["breaks"][row] if 0.0 < b < horizon]
    times = set(breaks)
    for trip in arguments["round_trips"][row]:
        if np.isfinite(trip):
            for k in range(1, int(horizon / trip) + 1):
                times |= {k * trip, *(k * trip + b for b in breaks)}
    return [0.0, *sorted(t for t in times if t < horizon), horizon]


def _leaves(face: int) -> Callable[[float, Array], float]:
    """The event that a face loses contact."""

    def leaves(t: float, y: Array) -> float:
        return float(y[face])

    leaves.terminal = True  # type: ignore[attr-defined]
    leaves.direction = -1.0  # type: ignore[attr-defined]
    return leaves


def _solve_row(
    arguments: Mapping[str, Array], row: int, method: str, tolerance: float, contact: bool
) -> tuple[float, float]:
    """Largest approach and time of the first loss of contact (or end of the record) of one row, scaled."""
    from scipy.integrate import solve_ivp

    mu = float(arguments["mass"][row])
    trips, ends = arguments["round_trips"][row], arguments["ends"][row]
    horizon = float(arguments["horizon"][row])
    horizon = horizon if np.isfinite(horizon) else float(arguments["pulse_end"][row]) + AFTER
    pieces: list[tuple[float, Callable[[float], Array]]] = []

    def force(face: int, time: float) -> float:
        """Force at an earlier time, from the dense output of the piece that holds it."""
        dense = next(sol for begin, sol in reversed(pieces) if time >= begin)
        return float(max(dense(time)[face], 0.0) ** 1.5)

    def f(time: float, inside: tuple[float, float] = (0.0, np.inf)) -> float:
        back = time - trips[0]
        value = _pulse(arguments, row, min(max(time, inside[0]), inside[1]))
        return value + (ends[0] * (f(back) - force(0, back)) if back > 0.0 else 0.0)

    def h(time: float) -> float:
        back = time - trips[1]
        return float(ends[1] * (force(1, back) + h(back))) if back > 0.0 else 0.0

    peak, lost = 0.0, horizon
    state = np.zeros(3)
    stops = _stops(arguments, row, horizon)
    for begin, end in pairwise(stops):
        if end - begin < 1e-12:
            continue
        inside = (begin + 1e-13 * (1 + end), end - 1e-13 * (1 + end))

        def slope(t: float, y: Array, inside: tuple[float, float] = inside) -> list[float]:
            p1, p2 = max(y[0], 0.0) ** 1.5, max(y[1], 0.0) ** 1.5
            return [2.0 * f(t, inside) - p1 - y[2], y[2] - p2 - 2.0 * h(t), (p1 - p2) / mu]

        events = [_leaves(0), _leaves(1)] if contact and begin > 0.0 else None
        solve: Any = solve_ivp
        found = solve(slope, (begin, end), state, method=method, events=events, dense_output=True,
                          rtol=tolerance, atol=0.01 * tolerance)  # fmt: skip
        pieces.append((begin, found.sol))
        peak = max(peak, _largest(found, slope, 0), _largest(found, slope, 1))
        state = found.y[:, -1]
        if found.status == 1:
            lost = float(found.t[-1])
            break
    return peak, lost


def _largest(found: Any, slope: Callable[[float, Array], list[float]], face: int) -> float:
    """The largest approach at a face on one piece, from the roots of its rate on the dense output."""
    from scipy.optimize import brentq

    rates = np.array([slope(t, y)[face] for t, y in zip(found.t, found.y.T, strict=True)])
    tops = [brentq(lambda t: slope(t, found.sol(t))[face], found.t[k], found.t[k + 1], xtol=1e-10)
            for k in np.flatnonzero((rates[:-1] > 0.0) & (rates[1:] < 0.0))]  # fmt: skip
    return max([float(found.y[face].max()), *(float(found.sol(top)[face]) for top in tops)])


def solve_scipy(scene: Scene, rows: int, method: str, tolerance: float, *, contact: bool) -> Array:
    """Largest approach and contact time (rows, 2), scaled, by solve_ivp."""
    arguments = scaled_arguments(scene, np.arange(rows))
    return np.array([_solve_row(arguments, row, method, tolerance, contact) for row in range(rows)])


def describe_machine() -> dict[str, Json]:
    """Processor, processors this process may use, Python and packages; nothing that names a machine or a user."""
    model = platform.processor() or platform.machine()
    cpu = Path("/proc/cpuinfo")
    if cpu.is_file():
        names = [
            line.split(":", 1)[1].strip() for line in cpu.read_text().splitlines() if line.startswith("model name")
        ]
        model = names[0] if names else model
    packages = {name: metadata.version(name) for name in ("numpy", "scipy", "numba", "llvmlite")}
    return {"processor": model, "processors": dynamics.thread_count(None), "system": platform.system(),
            "python": platform.python_version(), "packages": packages}  # fmt: skip


_READY = """
import time; begin = time.perf_counter()
from uqsphere.bench import scattered_scene
from uqsphere.mechanics.integrator.solve import integrate
integrate(scattered_scene(16), quantities=("p_max",))
print(time.perf_counter() - begin)
"""
_MEMORY = """
import sys, resource
from pathlib import Path
import numpy as np
from uqsphere.bench import scattered_scene
from uqsphere.mechanics.integrator.solve import solve
rows, chunk, done = int(sys.argv[1]), 65536, 0
best = 0.0
while done < rows:
    size = min(chunk, rows - done)
    best = max(best, float(solve(scattered_scene(size, seed=done), quantities=("p_max",)).values["p_max"].max()))
    done += size
kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
status = Path("/proc/self/status")
if status.is_file():  # there the number above would hold what the parent process once held
    kilobytes = next(int(line.split()[1]) for line in status.read_text().splitlines() if line.startswith("VmHWM"))
print(kilobytes / 1024.0)
"""


def _child(program: str, *arguments: str) -> float:
    done = subprocess.run([sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=True)
    return float(done.stdout)


def ready_seconds() -> float:
    """Wall seconds in which a new process imports, loads the compiled code and solves 16 rows."""
    return min(_child(_READY) for _ in range(2))


def memory_of(rows: int) -> float:
    """Largest resident memory [MB] of a process that solves `rows` rows of scene A in chunks, as a run does."""
    return _child(_MEMORY, str(rows))


def massless_rate(rows: int = 200_000) -> float:
    """Rows of the massless closed form per second and core: the largest pressure of scene A."""
    theta = scattered_scene(rows).scales.pulse_number
    return rows / _best_time(lambda: closed_form.loading_approach(theta), 7)


# --- Speed against error, side by side in one process: contenders take turns, the best of several rounds counts.
# Times are processor seconds of one thread.  Errors are relative, against the compiled integrator at its tightest
# tolerance, which is itself compared with a Runge-Kutta method of order 8, of another family.


TIGHTEST: Final = 1e-12
_COLUMNS: Final = {"p_max": layout.ANSWER_X_MAX, "contact_time": layout.ANSWER_CONTACT}


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One contender at one tolerance on one scene: processor seconds per row and relative errors."""

    scene: str
    contender: str
    tolerance: float | None
    rows: int
    seconds_per_row: float
    median: float
    worst: float
    quantity: str


def _best_time(run: Callable[[], object], rounds: int, clock: Callable[[], float] = time.process_time) -> float:
    """The least seconds of several rounds."""
    best = math.inf
    for _ in range(rounds):
        begin = clock()
        run()
        best = min(best, clock() - begin)
    return best


def _entries(
    chosen: BenchScene, contender: str, tolerance: float | None, answers: Array, exact: Array, seconds: float
) -> list[Entry]:
    """answers, exact: columns x_max and contact time."""
    found = []
    for k, name in enumerate(chosen.quantities):
        ratio = answers[:, k] / exact[: len(answers), k]
        # the pressure goes with the root of the approach
        error = np.abs((np.sqrt(np.maximum(ratio, 0.0)) if name == "p_max" else ratio) - 1.0)
        found.append(
            Entry(
                scene=chosen.name, contender=contender, tolerance=tolerance, rows=len(answers),
                seconds_per_row=seconds / len(answers), median=float(np.median(error)), worst=float(error.max()),
                quantity=name,
            )
        )  # fmt: skip
    return found


def _scaled(chosen: BenchScene, found: dynamics.Scaled) -> Array:
    return found.answers[:, [_COLUMNS[name] for name in chosen.quantities]]


def measure_scene(chosen: BenchScene, *, tolerances: list[float], rounds: int, slow_rows: int) -> list[Entry]:
    """Every contender on one scene; the slow ones on the first `slow_rows` rows."""
    scene, quantities = chosen.scene, chosen.quantities
    exact = _scaled(chosen, dynamics.integrate(scene, tolerance=TIGHTEST, quantities=quantities))
    entries: list[Entry] = []

    def ours(fidelity: str, tolerance: float) -> dynamics.Scaled:
        return dynamics.integrate(scene, fidelity=fidelity, tolerance=tolerance, threads=1, quantities=quantities)

    ours("full", 1e-6)

    def turn(fidelity: str, tolerance: float) -> tuple[str, float | None, Callable[[], Array]]:
        return fidelity, tolerance, lambda: _scaled(chosen, ours(fidelity, tolerance))

    turns = [turn("full", tolerance) for tolerance in tolerances]
    for fidelity in ("linear", "massless"):
        if fidelity == "massless" and closed_form.closed_form_applies(scene, fidelity):
            turns.append((fidelity, None, lambda: closed_form.scaled_answers(scene)["x_max"][:, None]))
        else:
            turns.append(turn(fidelity, 1e-6))
    for name, tolerance, run in turns:
        seconds = _best_time(run, rounds)
        entries += _entries(chosen, name, tolerance, run(), exact, seconds)
    contact = "contact_time" in quantities
    for method in METHODS:
        for t in (1e-3, 1e-6, 1e-9, 1e-12) if method == "DOP853" else (1e-3, 1e-6, 1e-9):
            rows = slow_rows if method != "Radau" else max(1, slow_rows // 4)
            begin = time.process_time()
            answers = solve_scipy(scene, rows, method, t, contact=contact)
            seconds = time.process_time() - begin
            entries += _entries(chosen, f"solve_ivp {method}", t, answers[:, : len(quantities)], exact, seconds)
    return entries


def reference_gap(entries: list[Entry], scene: str) -> dict[str, float]:
    """Largest relative difference of two integrators of different families at 1e-12, by quantity, on one scene."""
    at = [e for e in entries if (e.scene, e.contender, e.tolerance) == (scene, "solve_ivp DOP853", TIGHTEST)]
    return {entry.quantity: entry.worst for entry in at}


def ratio_at_error(entries: list[Entry], scene: str, quantity: str, rival: str, error: float) -> float | None:
    """How many times as fast `full` is as a rival, both at the same median error; None beyond what was measured.

    Between measured points the time is a straight line over the error, both as logarithms.
    """
    times = []
    for contender in (rival, "full"):
        points = sorted(
            (max(e.median, 1e-16), e.seconds_per_row)
            for e in entries
            if (e.scene, e.contender, e.quantity) == (scene, contender, quantity)
        )
        errors = np.log([point[0] for point in points])
        if len(points) == 0 or not errors[0] - 1e-9 <= np.log(error) <= errors[-1] + 1e-9:
            return None
        times.append(float(np.exp(np.interp(np.log(error), errors, np.log([point[1] for point in points])))))
    return times[0] / times[1]


def cost_tables(*, largest: int, rounds: int) -> dict[str, list[tuple[float, float]]]:
    """Microseconds a row of `full` at 1e-6, p_max alone, against rows, threads (wall time), mu and theta."""

    def cost(scene: Scene, threads: int = 1, wall: bool = False) -> float:
        seconds = _best_time(lambda: dynamics.integrate(scene, threads=threads, quantities=("p_max",)), rounds,
                             time.perf_counter if wall else time.process_time)  # fmt: skip
        return seconds / len(scene) * 1e6

    counts = [10**k for k in range(1, 8) if 10**k <= largest]
    return {
        "rows": [(float(n), cost(scattered_scene(n))) for n in counts],
        "threads": [
            (float(k), cost(scattered_scene(20_000), k, wall=True)) for k in range(1, dynamics.thread_count(None) + 1)
        ],
        "mu": [(mu, cost(scattered_scene(256, mu=mu))) for mu in 10.0 ** np.arange(-6.0, 3.0)],
        "theta": [(theta, cost(scattered_scene(256, theta=theta))) for theta in 10.0 ** np.arange(-3.0, 3.0)],
    }


def integrators_differ() -> float:
    """Relative difference in the largest approach of our integrator and one of scipy's, on a row of scene A."""
    scene = scattered_scene(1)
    ours = float(dynamics.integrate(scene, tolerance=1e-8, quantities=("p_max",)).answers[0, layout.ANSWER_X_MAX])
    other = float(solve_scipy(scene, 1, "DOP853", 1e-10, contact=False)[0, 0])
    return abs(ours - other) / abs(other)


# --- The benchmark as tables (Markdown), as JSON, and as two figures.

SCHEMA_VERSION: Final = 1
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
    return [
        {"scene": scene, "quantity": quantity, "rival": rival, "error": error, "aim": aim,
         "times_as_fast": ratio_at_error(list(entries), scene, quantity, rival, error)}
        for scene, quantity, rival, error, aim in COMPARED
    ]  # fmt: skip


def _rows(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return ["| " + " | ".join(row) + " |" for row in (header, ["---"] * len(header), *rows)]


def bench_text(content: dict[str, Json], entries: Sequence[Entry]) -> str:
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
            (e.contender, "-" if e.tolerance is None else f"{e.tolerance:.0e}", e.quantity,
             f"{e.seconds_per_row * 1e6:,.3g} us", f"{e.median:.1e}", f"{e.worst:.1e}", str(e.rows))
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
        panel.set(xscale="log", yscale="log", xlabel="median relative error of p_max (more accurate to the right)",
                  ylabel="seconds per million rows, one core")  # fmt: skip
        # written as in the tables: the style knows no mathematical notation
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_formatter(lambda value, _: f"{value:g}")
            axis.set_minor_formatter(lambda value, _: "")
        panel.grid(True, which="major")
        panel.invert_xaxis()
        panel.set_title(f"Scene {scene}")
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return Picture(
        name="speed_error", title="Speed against error", figure=figure,
        finding="At every error the compiled integrator costs a small share of what general integrators cost.",
    )  # fmt: skip


def run_bench(folder: Path, *, quick: bool, notice: Callable[[str], None]) -> dict[str, Json]:
    """Measure speed against error on this machine and write bench.json, bench.md and figures/*.svg to `folder`.

    Raises FolderError when the folder holds something that is no benchmark.
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
        drawn = render(speed_error_figure(entries))
    write_outputs(folder / "figures", {"speed_error.svg": drawn})
    document = json.dumps(content, indent=1, allow_nan=False) + "\n"
    write_outputs(folder, {"bench.md": text + "\n", "bench.json": document})
    return {**content, "text": text}
