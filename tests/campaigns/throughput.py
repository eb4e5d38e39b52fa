"""Evaluations per second through the runner beside the bare kernel, memory and what is stored.

Run with ``python -m tests.campaigns.throughput STUDY.toml --evaluations 10_000_000 --out FOLDER``.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from uqsphere.model import answer_scene
from uqsphere.runner.chunks import CHUNK
from uqsphere.runner.evaluate import Ledger, Work, draw, evaluate_sample
from uqsphere.runner.fidelity import first_look
from uqsphere.runner.schedule import REPLICATES
from uqsphere.store import open_store
from uqsphere.study import Study, load_study

#: rows that are drawn and evaluated at once, 16 replicates together
STAGE = 1 << 18


@dataclass(frozen=True, kw_only=True)
class Throughput:
    """What a number of evaluations took: seconds, evaluations per second, bytes.

    `bare` is the kernel called with rows that are there already, for as many of them as fit into one stage; `drawing`
    is what the points take, which any use of the kernel has to pay; `runner` is everything.  `overhead` is in time of
    the processor, all threads together, which other work on the machine does not lengthen much; `outside` is by the
    clock: time that was neither drawing nor in the model, waits for the disk included, over the time in the model.
    `peaks` are the largest memory after each eighth of the evaluations.
    """

    study: str
    fidelity: str
    evaluations: int
    bare_per_second: float
    runner_per_second: float
    drawing_seconds: float
    runner_seconds: float
    overhead: float
    outside: float
    peak_memory: int
    peaks: tuple[int, ...]
    stored: int


def peak_memory() -> int:
    """Largest memory that this process has had, in bytes; 0 where the system does not say."""
    try:
        import resource
    except ImportError:
        return 0
    found = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(found if sys.platform == "darwin" else 1024 * found)


def measure(study: Study, evaluations: int, folder: Path, *, threads: int | None = None) -> Throughput:
    """Draw and evaluate rows as the sampling of a run does, stage by stage, stored as they come.

    The kernel is timed by itself before and after, on the rows of the first stage, so that a machine whose speed
    drifts does not count for or against the runner.
    """
    store = open_store(folder, study.resolved(), study.text, study.hash, fresh=True)
    try:
        work = Work(study=study, store=store, ledger=Ledger(), fidelity="full", threads=threads)
        pilot = first_look(work)
        work = replace(work, fidelity=pilot.chosen, fallback=pilot.fallback)
        count = max(1, min(STAGE, evaluations) // REPLICATES)

        def bare() -> tuple[float, float]:
            """Seconds of an evaluation, by the clock and of the processor."""
            rows = draw(work.drawn, seed=study.seed, task="sampling", start=0, count=count).inputs
            rows = rows[:, :, : len(work.scene_names)].reshape(REPLICATES * count, -1)
            began, used = time.perf_counter(), time.process_time()
            for first in range(0, len(rows), CHUNK):  # its best use: what a call works on fits into the cache
                some = rows[first : first + CHUNK]
                answer_scene(study, work.scene_names, some, work.quantities, fidelity=work.fidelity,
                             threads=threads, tolerance=study.model.tolerance, fallback=work.fallback)  # fmt: skip
            return (time.perf_counter() - began) / len(rows), (time.process_time() - used) / len(rows)

        bare()  # what is compiled or loaded on first use
        before, start, peaks = bare(), 0, [peak_memory()]
        drawing = drawing_used = 0.0
        inside = work.engine.seconds
        began, used = time.perf_counter(), time.process_time()
        while start * REPLICATES < evaluations:
            some = min(count, -(-evaluations // REPLICATES) - start)
            drew, drew_used = time.perf_counter(), time.process_time()
            points = draw(work.drawn, seed=study.seed, task="sampling", start=start, count=some)
            drawing += time.perf_counter() - drew
            drawing_used += time.process_time() - drew_used
            evaluate_sample(work, f"sampling.{start}", points)
            start += some
            if 8 * start * REPLICATES >= len(peaks) * evaluations:
                peaks.append(peak_memory())
        seconds, used = time.perf_counter() - began, time.process_time() - used
        inside = work.engine.seconds - inside
        after = bare()
    finally:
        store.close()
    done = start * REPLICATES
    return Throughput(
        study=study.title,
        fidelity=work.fidelity,
        evaluations=done,
        bare_per_second=2.0 / (before[0] + after[0]),
        runner_per_second=done / seconds,
        drawing_seconds=drawing,
        runner_seconds=seconds,
        overhead=(used - drawing_used) / done * 2.0 / (before[1] + after[1]) - 1.0,
        outside=(seconds - drawing - inside) / inside,
        peak_memory=peak_memory(),
        peaks=tuple(peaks[1:]),
        stored=sum(path.stat().st_size for path in (folder / "evaluations").iterdir()),
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the measurement as JSON."""
    parser = argparse.ArgumentParser(description="evaluations per second through the runner and of the bare kernel")
    parser.add_argument("study", type=Path)
    parser.add_argument("--evaluations", type=int, default=10_000_000)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--set", dest="overrides", action="append", default=[])
    chosen = parser.parse_args(arguments)
    study = load_study(chosen.study, chosen.overrides)
    print(json.dumps(asdict(measure(study, chosen.evaluations, chosen.out, threads=chosen.threads)), indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
