"""What each command does that begins with data of the user's, lists what there is, or looks at this installation."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from uqsphere.console import answer, screen_width, table
from uqsphere.quantities import INPUTS, OUTPUTS, format_value
from uqsphere.study import shipped_studies
from uqsphere.units import UNITS

#: what a list holds, an entry a line
Rows = list[dict[str, object]]


def command_analyse(chosen: argparse.Namespace) -> int:
    """Analyse a table of runs."""
    from uqsphere.given import analyse_runs, known_laws, read_data
    from uqsphere.given.page import analysis_page, analysis_text, study_text

    def names(text: str) -> list[str]:
        return [name.strip() for name in text.split(",") if name.strip()]

    data = read_data(chosen.data, names(chosen.inputs), names(chosen.outputs))
    known = None if chosen.laws is None else known_laws(chosen.laws, data.inputs)
    found, surrogates = analyse_runs(data, known=known)
    if chosen.out is not None:
        from uqsphere.store import write_outputs

        files: dict[str, bytes | str] = {
            "analysis.json": json.dumps(found, indent=1, allow_nan=False) + "\n",
            "inputs.toml": study_text(found),
            **analysis_page(found, data),
            **{f"surrogate-{k + 1}.npz": surrogates[name].content()
               for k, name in enumerate(data.outputs) if name in surrogates},
        }  # fmt: skip
        write_outputs(chosen.out, files)
    kept = " surrogates," if surrogates else ""
    where = f"\n\nwritten to {chosen.out}: report.html, analysis.json,{kept} and inputs.toml to begin a study with"
    return answer(chosen, found, lambda: analysis_text(found) + ("" if chosen.out is None else where))


def _materials() -> tuple[Rows, str]:
    from uqsphere.materials import library

    content = []
    rows: list[tuple[str, ...] | str] = []
    for kind, materials in library().items():
        for name, material in materials.items():
            rows.append(f"{kind}: {name}")
            for key, entry in material.properties.items():
                ends = {} if entry.range is None else {"low": entry.range[0], "high": entry.range[1]}
                content.append({"kind": kind, "material": name, "property": key, "value": entry.value, "cov": entry.cov,
                                **ends, **entry.further, "source": entry.source,
                                "source_seen": entry.seen})  # fmt: skip
                path = f"{kind}.{key}"
                known = path if path in INPUTS else "p_max" if key.endswith("strength") else ""
                shown = format_value(entry.value, known) if known else f"{entry.value:.4g}"
                scatter = f"{100.0 * entry.cov:.0f} %" if entry.cov is not None else "-"
                rows.append((key, shown, scatter, entry.source + ("" if entry.seen else " (not seen)")))
    return content, table(("material", "value", "cov", "source"), rows, screen_width())


def _models() -> tuple[Rows, str]:
    rows = [
        ("massless", "no mass of the sphere (mu = 0); closed form for a rectangle or step on infinite bars"),
        ("linear", "linear spring of the secant stiffness in place of the Hertz contact"),
        ("elastic", "forces by Hertz; what yields follows from the largest of them (contact.dynamics)"),
        ("full", "Hertz contact at both faces, mass of the sphere, waves and reflections in the bars"),
        ("auto", "the cheapest of these whose measured error is small against the accuracy asked for"),
    ]
    content: Rows = [{"fidelity": name, "meaning": text} for name, text in rows]
    return content, table(("fidelity", "meaning"), rows, screen_width())


def _quantities() -> tuple[Rows, str]:
    content: Rows = [{"name": e.name, "unit": e.unit, "shown_in": e.display or e.unit, "meaning": e.meaning}
                     for e in OUTPUTS.values()]  # fmt: skip
    rows = [(e.name, e.display or e.unit or "-", e.meaning) for e in OUTPUTS.values()]
    return content, table(("quantity", "unit", "meaning"), rows, screen_width())


def _criteria() -> tuple[Rows, str]:
    from uqsphere.mechanics.criteria import CRITERIA, PARAMETERS

    content: Rows = []
    rows = []
    for name, entry in CRITERIA.items():
        unit = next(iter(UNITS[entry.dimension]))
        keys = {key: PARAMETERS[key].meaning for key in (*entry.parameters, *entry.optional)}
        content.append({"criterion": name, "quantity": entry.quantity, "unit": unit, "meaning": entry.meaning,
                        "formula": entry.formula, "strength": entry.strength, "range": entry.range_text,
                        "source": entry.source, "required": list(entry.parameters), "parameters": keys})  # fmt: skip
        takes = ", ".join(key if key in entry.parameters else f"({key})" for key in keys)
        rows.append((name, entry.formula, unit, takes or "-", entry.range_text, entry.source))
    return content, table(("criterion", "demand", "unit", "takes", "range", "source"), rows, screen_width(), named=True)


def _templates() -> tuple[Rows, str]:
    """The studies that `uqsphere new` writes, each with its title."""
    content: Rows = []
    for name, path in shipped_studies().items():
        given = tomllib.loads(path.read_text("utf-8"))
        kind = "model of your own" if "inputs" in given else "services" if "service" in given else "impact"
        content.append({"template": name, "kind": kind, "title": str(given.get("title", ""))})
    rows = [(str(row["template"]), str(row["kind"]), str(row["title"])) for row in content]
    return content, table(("template", "kind", "title"), rows, screen_width(), named=True)


def command_list(chosen: argparse.Namespace) -> int:
    """What there is to choose from."""
    lists = {"materials": _materials, "models": _models, "quantities": _quantities, "criteria": _criteria,
             "templates": _templates}  # fmt: skip
    content, text = lists[chosen.what]()
    return answer(chosen, content, text)


def command_bench(chosen: argparse.Namespace) -> int:
    """Measure speed against error, or hold the model against published measurements."""
    from uqsphere.bench import run_bench
    from uqsphere.bench.measured import run_measured

    folder = chosen.out or Path("bench-results")
    content = (
        run_measured(folder)
        if chosen.measured
        else run_bench(folder, quick=chosen.quick, notice=lambda text: print(text, file=sys.stderr, flush=True))
    )
    text = content.pop("text")
    return answer(chosen, content, f"{text}\n\nwritten to {folder}")


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


def examine() -> dict[str, Any]:
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
    from uqsphere.bench import integrators_differ

    error = integrators_differ()
    return error < 1e-6, f"two integrators differ by {error:.1e} of the largest approach in a scene"
