"""What the numbers of a benchmark were measured on, and what a process of its own needs to start and to hold."""

from __future__ import annotations

import platform
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.bench.rivals import METHODS, solve_scipy
from uqsphere.bench.scenes import BenchScene, scattered_scene
from uqsphere.mechanics import closed_form
from uqsphere.mechanics.integrator import solve as dynamics
from uqsphere.mechanics.integrator import tracked as layout
from uqsphere.mechanics.scene import Scene


def describe_machine() -> dict[str, object]:
    """Processor, processors this process may use, Python and packages; nothing that names a machine or a user."""
    from uqsphere.mechanics.integrator.solve import thread_count

    model = platform.processor() or platform.machine()
    cpu = Path("/proc/cpuinfo")
    if cpu.is_file():
        names = [
            line.split(":", 1)[1].strip() for line in cpu.read_text().splitlines() if line.startswith("model name")
        ]
        model = names[0] if names else model
    packages = {}
    for name in ("numpy", "scipy", "numba", "llvmlite"):
        try:
            packages[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            packages[name] = "absent"
    return {
        "processor": model,
        "processors": thread_count(None),
        "system": platform.system(),
        "python": platform.python_version(),
        "packages": packages,
    }


_READY = """
import time; begin = time.perf_counter()
from uqsphere.bench.scenes import scattered_scene
from uqsphere.mechanics.integrator.solve import integrate
integrate(scattered_scene(16), quantities=("p_max",))
print(time.perf_counter() - begin)
"""
_MEMORY = """
import sys, resource
from pathlib import Path
import numpy as np
from uqsphere.bench.scenes import scattered_scene
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
    from uqsphere.bench.scenes import scattered_scene
    from uqsphere.mechanics.closed_form import loading_approach

    theta = scattered_scene(rows).scales.pulse_number
    best = np.inf
    for _ in range(7):
        begin = time.process_time()
        loading_approach(theta)
        best = min(best, time.process_time() - begin)
    return float(rows / best)


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


def _part(scene: Scene, rows: int) -> Scene:
    columns = {name: column[:rows] for name, column in scene.columns.items()}
    return Scene(columns=columns, shape=scene.shape, infinite=scene.infinite)


def _best_time(run: Callable[[], object], rounds: int) -> float:
    best = np.inf
    for _ in range(rounds):
        begin = time.process_time()
        run()
        best = min(best, time.process_time() - begin)
    return float(best)


def _pressure_error(x: Array, exact: Array) -> Array:
    """Relative error of p_max, which goes with the root of the approach."""
    return np.abs(np.sqrt(np.maximum(x, 0.0) / exact) - 1.0)


def _entries(
    chosen: BenchScene, contender: str, tolerance: float | None, answers: Array, exact: Array, seconds: float
) -> list[Entry]:
    """answers, exact: columns x_max and contact time."""
    found = []
    for k, name in enumerate(chosen.quantities):
        truth = exact[: len(answers), k]
        error = _pressure_error(answers[:, k], truth) if name == "p_max" else np.abs(answers[:, k] / truth - 1.0)
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
            turns.append((fidelity, None, lambda: closed_form.scaled_answers(scene)[:, :1]))
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
        clock = time.perf_counter if wall else time.process_time
        best = np.inf
        for _ in range(rounds):
            begin = clock()
            dynamics.integrate(scene, threads=threads, quantities=("p_max",))
            best = min(best, clock() - begin)
        return float(best / len(scene) * 1e6)

    counts = [10**k for k in range(1, 8) if 10**k <= largest]
    return {
        "rows": [(float(n), cost(scattered_scene(n))) for n in counts],
        "threads": [(float(k), cost(scattered_scene(20_000), k, wall=True)) for k in range(1, _threads() + 1)],
        "mu": [(mu, cost(scattered_scene(256, mu=mu))) for mu in 10.0 ** np.arange(-6.0, 3.0)],
        "theta": [(theta, cost(scattered_scene(256, theta=theta))) for theta in 10.0 ** np.arange(-3.0, 3.0)],
    }


def _threads() -> int:
    return dynamics.thread_count(None)
