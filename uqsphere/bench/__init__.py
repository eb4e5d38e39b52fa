"""The command `bench`: speed against error on this machine, beside general integrators."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from uqsphere.errors import FolderError

__all__ = ["SCHEMA_VERSION", "run_bench"]

SCHEMA_VERSION: Final = 1


def run_bench(folder: Path, *, quick: bool, notice: Callable[[str], None]) -> dict[str, Any]:
    """Measure speed against error on this machine and write bench.json, bench.md and figures/*.svg to `folder`.

    Raises
    ------
    FolderError
        When the folder holds something that is no benchmark.
    """
    from uqsphere.bench.machine import STEP_WORK, describe_machine, massless_rate, memory_of, peak_rate, ready_seconds
    from uqsphere.bench.measure import cost_tables, measure_scene, reference_gap
    from uqsphere.bench.scenes import bench_scenes
    from uqsphere.bench.tables import bench_text, cost_figure, ratios, speed_error_figure
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
    rate, best = peak_rate(), min(e.seconds_per_row for e in entries if (e.scene, e.contender) == ("A", "full"))
    limits = {
        "memory of 10 million rows of A [MB]" if not quick else "memory of 200,000 rows of A [MB]": {
            "found": memory_of(many), "aim": "below 1,000"},
        "kernel ready in a new process [s]": {"found": ready_seconds(), "aim": "below 1.5"},
        "massless closed form, million rows a second and core": {"found": massless_rate() / 1e6, "aim": "10"},
        "scene A at the loosest tolerance [us a row]": {"found": best * 1e6, "aim": "5"},
    }  # fmt: skip
    if rate is not None:
        limits["series arithmetic of one step and row at the machine's rate [us]"] = {
            "found": STEP_WORK / rate * 1e6, "aim": "-"}  # fmt: skip
    content = {
        "schema_version": SCHEMA_VERSION, "quick": quick, "machine": describe_machine(), "scenes": scenes,
        "entries": [asdict(entry) for entry in entries], "ratios": ratios(entries), "cost": cost, "limits": limits,
    }  # fmt: skip
    text = bench_text(content, entries)
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    with style():
        for picture in (speed_error_figure(entries), cost_figure(cost)):
            (folder / "figures" / f"{picture.name}.svg").write_text(render(picture), encoding="utf-8")
    (folder / "bench.md").write_text(text + "\n", encoding="utf-8")
    (folder / "bench.json").write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return {**content, "text": text}
