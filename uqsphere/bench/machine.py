"""What the numbers of a benchmark were measured on, and what a process of its own needs to start and to hold."""

from __future__ import annotations

import platform
import subprocess
import sys
import time
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from uqsphere.mechanics.integrator.compiled import compiled
from uqsphere.mechanics.integrator.step import ORDER, PAIR, TERMS
from uqsphere.mechanics.integrator.vectors import products, row

__all__ = [
    "STEP_WORK",
    "describe_machine",
    "massless_rate",
    "memory_of",
    "peak_rate",
    "ready_seconds",
    "vector_work",
]


def describe_machine() -> dict[str, Any]:
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
    for name in ("numpy", "scipy", "numba", "llvmlite", "heyoka"):
        try:
            packages[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            packages[name] = "absent (extra: bench)" if name == "heyoka" else "absent"
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
    from uqsphere.mechanics.closed_form import largest_approach

    theta = scattered_scene(rows).scales.pulse_number
    best = np.inf
    for _ in range(7):
        begin = time.process_time()
        largest_approach(theta)
        best = min(best, time.process_time() - begin)
    return float(rows / best)


def peak_rate() -> float | None:
    """Multiplications with an addition that one core does in a second on vectors held in its first cache."""
    from importlib.util import find_spec

    if find_spec("numba") is None:
        return None

    vector_work(10)
    rounds, best = 20_000, np.inf
    for _ in range(7):
        begin = time.process_time()
        operations = vector_work(rounds)
        best = min(best, (time.process_time() - begin) / operations)
    return float(1.0 / best)


# --- A loop of nothing but the integrator's own sums, to measure how near the integrator comes to the machine.

#: multiplications with an addition that the series of one step of one row needs: root and force at both faces
STEP_WORK = 2 * sum((k + 1) // 2 + k + 1 for k in range(ORDER + 1))


@compiled()
def vector_work(rounds: int) -> int:
    """Do `rounds` of the longest sum; the number of multiplications with an addition."""
    a, b, out = np.full((TERMS, PAIR), 0.5), np.full((TERMS, PAIR), 0.25), np.zeros((1, PAIR))
    for _ in range(rounds):
        products(a, b, ORDER, 0, TERMS, row(out, 0, 0))
    return rounds * TERMS * PAIR + int(out[0, 0] < 0.0)
