"""What an installation needs to give right answers, each looked at on this machine."""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Final

from uqsphere.console import answer, screen_width, table
from uqsphere.files import Json

#: a compiler and Python's headers, by the name of the system; numpoly, which chaospy needs, is built from source
COMPILER: Final = {
    "linux": "apt install gcc python3-dev, dnf install gcc python3-devel or apk add gcc musl-dev python3-dev",
    "darwin": "xcode-select --install",
    "win32": "winget install Microsoft.VisualStudio.2022.BuildTools, with the workload for C++",
}
#: free bytes below which a run is likely to end on a full disk
_LEAST_ROOM: Final = 1 << 30


def command_doctor(chosen: argparse.Namespace) -> int:
    """Check this installation."""
    found = examine()
    rows = [(entry["check"], "ok" if entry["ok"] else "FAULT", entry["text"]) for entry in found["checks"]]
    tables = (table(("package", "version"), list(found["versions"].items()), screen_width()),
              table(("check", "", "found"), rows, screen_width()))  # fmt: skip
    answer(chosen, found, "\n\n".join(tables))
    return 0 if all(entry["ok"] for entry in found["checks"]) else 1


def examine() -> Json:
    """Versions, the machine, and checks: each with `check`, `ok` and what was found as `text`."""
    from uqsphere.mechanics.integrator.compiled import cache_folder
    from uqsphere.runner.results import versions
    from uqsphere.runner.workers import processors

    found = versions()
    missing = [name for name, version in found.items() if version == "missing"]
    lacking = f"missing: {', '.join(missing)}" if missing else "all there"
    if "chaospy" in missing:
        how = COMPILER.get(sys.platform, "install one, with the headers of Python")
        lacking += f"; chaospy needs a C compiler: {how}; then pip install chaospy. Every run works without it"
    folder = cache_folder()
    cached = str(folder) if folder else "none that is private and writable, so every process compiles"
    looks: dict[str, Callable[[], tuple[bool, str]]] = {
        "packages": lambda: (not missing, lacking), "processors": lambda: (True, f"{processors()}"),
        "cache of compiled code": lambda: (True, cached), "result folders": _folders, "free space": _room,
        "integration": _integration,
    }  # fmt: skip
    checks = []
    for check, look in looks.items():
        try:
            ok, text = look()
        except Exception as error:  # a check may fail in any way: that is what it is there to find
            ok, text = False, f"{type(error).__name__}: {error}"
        checks.append({"check": check, "ok": ok, "text": text})
    return {"versions": found, "processors": processors(), "missing": missing,
            "compiled_code_cache": str(folder) if folder else None, "checks": checks}  # fmt: skip


def _folders() -> tuple[bool, str]:
    """A chunk written here comes back, and a second run is kept out."""
    import numpy as np

    from uqsphere.errors import FolderError
    from uqsphere.store import open_store

    with tempfile.TemporaryDirectory(prefix=".uqsphere-doctor-", dir=Path.cwd()) as place:
        folder = Path(place) / "run"
        store = open_store(folder, {}, "", "0" * 64)
        try:
            values = np.arange(6.0).reshape(2, 3)
            store.save("a.0", values)
            found = store.load("a.0")
            if found is None or found.tobytes() != values.tobytes():
                return False, "what was stored in this folder did not come back"
            try:
                open_store(folder, {}, "", "0" * 64).close()
            except FolderError:
                return True, "stored, read and locked in this folder"
            return False, "locks have no effect in this folder: never run two studies into one result folder here"
        finally:
            store.close()


def _room() -> tuple[bool, str]:
    free = shutil.disk_usage(Path.cwd()).free
    return free >= _LEAST_ROOM, f"{free / 1e9:.1f} GB in this folder"


def _integration() -> tuple[bool, str]:
    """The compiled integrator against one of scipy's, on a scene of the benchmark."""
    from uqsphere.bench.rivals import scattered_scene, solve_scipy
    from uqsphere.mechanics.integrator.solve import integrate
    from uqsphere.mechanics.integrator.tracked import ANSWER_X_MAX

    scene = scattered_scene(1)
    ours = float(integrate(scene, tolerance=1e-8, quantities=("p_max",)).answers[0, ANSWER_X_MAX])
    other = float(solve_scipy(scene, 1, "DOP853", 1e-10, contact=False)[0, 0])
    error = abs(ours - other) / abs(other)
    return error < 1e-6, f"two integrators differ by {error:.1e} of the largest approach in a scene"
