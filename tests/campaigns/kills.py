"""Runs that are killed at random, and whether anything is lost: bytes of the answers, and what is evaluated twice.

``python -m tests.campaigns.kills local --times 200 --out FOLDER`` kills the run itself with SIGKILL, at random moments,
until it has finished, again and again; ``dask`` kills workers of a cluster of this machine while a run goes on.
A model that writes down every call is what shows what was evaluated.
``scale --sleep 0.005`` runs a black box whose rows take a while and no processor with one, two, four and eight workers:
whether the answers are the same bytes, and how much sooner they are there.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

STUDY = """\
title = "killed"
seed = 3
[inputs]
x1 = {{ dist = "uniform", lower = 0.0, upper = 1.0 }}
x2 = {{ dist = "normal", mean = 0.0, sd = 1.0 }}
[outputs]
names = ["y"]
[limits.high]
quantity = "y"
strength = 4.0
[analysis]
methods = ["sobol"]
{limit}quantiles = [0.5]
accuracy = {{ mean = 0.1, quantile = 0.1, sobol = 0.5, probability = 0.5 }}
"""
#: a call is one line of its file when it begins, and one when it ends; appended, so that processes share the file
MODEL = """\
import hashlib, os, time
import numpy as np
LOG = os.path.join(os.path.dirname(os.path.abspath(__file__)), "calls.log")

def tell(text):
    with open(LOG, "ab", buffering=0) as log:
        log.write(text.encode())

def f(inputs):
    rows = np.stack([inputs["x1"], inputs["x2"]], axis=1)
    name = hashlib.sha256(rows.tobytes()).hexdigest()[:16]
    tell(f"begin {{name}} {{len(rows)}} {{os.getpid()}}\\n")
    time.sleep({sleep} * len(rows))
    value = rows[:, 0] + rows[:, 1] ** 2
    tell(f"end {{name}} {{len(rows)}} {{os.getpid()}}\\n")
    return {{"y": value}}
"""


@dataclass(kw_only=True)
class Campaign:
    """What killing came to.

    `repeated` counts rows whose answer was stored and that were evaluated again; `unstored` those whose call had ended
    when the run was killed and whose answer had not reached its file; `cut` those whose call was cut.
    """

    kills: int = 0
    runs: int = 0
    unequal: int = 0
    repeated: int = 0
    unstored: int = 0
    cut: int = 0
    evaluations: int = 0
    codes: list[int] = field(default_factory=list)


def write_case(folder: Path, sleep: float, *, processes: bool = False) -> Path:
    """A black box that writes down its calls, and its study; `sleep` is what a row takes.

    processes : have it evaluated in processes of its own, which a limit of time needs however cheap a row is.
    """
    folder.mkdir(parents=True, exist_ok=True)
    limit = 'time_limit = "1 min"\n' if processes else ""
    (folder / "killed.toml").write_text(STUDY.format(limit=limit), encoding="utf-8")
    (folder / "killed.py").write_text(MODEL.format(sleep=sleep), encoding="utf-8")
    return folder


def answers_of(folder: Path) -> str:
    """One digest of everything that must not depend on how a run came about."""
    digest = hashlib.sha256()
    for path in [folder / "results.json", folder / "samples.npy", *sorted((folder / "tables").iterdir())]:
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def calls_of(case: Path) -> tuple[dict[str, int], dict[str, int], dict[str, int]]:
    """Calls begun and calls ended, by the rows they were made with, and how many rows those are."""
    begun: dict[str, int] = {}
    ended: dict[str, int] = {}
    rows: dict[str, int] = {}
    log = case / "calls.log"
    for line in log.read_text().splitlines() if log.exists() else []:
        kind, name, count, _ = line.split()
        table = begun if kind == "begin" else ended
        table[name] = table.get(name, 0) + 1
        rows[name] = int(count)
    return begun, ended, rows


def _command(case: Path, *more: str) -> list[str]:
    model = f"{case / 'killed.py'}:f"
    run = ["run", str(case / "killed.toml"), "--model", model, "--out", str(case / "results"), *more]
    return [sys.executable, "-m", "uqsphere", *run]


def _clear(case: Path) -> None:
    shutil.rmtree(case / "results", ignore_errors=True)
    (case / "calls.log").unlink(missing_ok=True)


def _whole(case: Path, *more: str) -> tuple[str, float, int]:
    """Answers of a run that nobody disturbs, its seconds, and its evaluations."""
    _clear(case)
    began = time.monotonic()
    subprocess.run(_command(case, *more), check=True, capture_output=True)
    _, ended, rows = calls_of(case)
    return answers_of(case / "results"), time.monotonic() - began, sum(rows[name] * n for name, n in ended.items())


def _stored(case: Path) -> int:
    """Rows in the chunk files of a result folder; parts of a chunk that is whole by now count once."""
    import numpy as np

    files = {path.name.rsplit("_", 1)[0]: path for path in (case / "results" / "evaluations").glob("*.npy")}
    bases = {key: re.sub(r"\.p\d+-\d+$", "", key) for key in files}
    return sum(len(np.load(files[key])) for key, base in bases.items() if base == key or base not in files)


def kill_runs(case: Path, times: int, *, seed: int = 1, jobs: str = "2") -> Campaign:
    """Kill a run at random moments until it finishes, begin a new one, and so on, for a number of kills.

    Answers are held against those of a run that nobody disturbs.  After each kill the rows that are stored are counted:
    with the calls that had ended by then this says what had been evaluated and not stored.
    """
    rng, found = random.Random(seed), Campaign()
    whole, seconds, evaluations = _whole(case, "-j", jobs)
    _clear(case)
    lost = 0
    while True:
        began, fresh = time.monotonic(), not (case / "calls.log").exists()
        process = subprocess.Popen(_command(case, "-j", jobs), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            code = process.wait(timeout=rng.uniform(0.0, seconds) if found.kills < times else None)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.wait()
            found.kills += 1
            _settle(case)
            begun, ended, rows = calls_of(case)
            lost = sum(rows[name] * n for name, n in ended.items()) - _stored(case)
            continue
        if fresh:  # the machine may be busier than it was, or less: moments are drawn from the life of the last run
            seconds = time.monotonic() - began
        found.runs += 1
        found.codes.append(code)
        begun, ended, rows = calls_of(case)
        made = sum(rows[name] * n for name, n in ended.items())
        found.evaluations += made
        found.cut += sum(rows[name] * (n - ended.get(name, 0)) for name, n in begun.items())
        # rows whose answers were stored are among the stored ones once: whatever ended more than once and was not lost
        found.unstored += lost
        found.repeated += max(0, made - evaluations - lost)
        found.unequal += int(code != 0 or answers_of(case / "results") != whole)
        if found.kills >= times:
            return found
        lost = 0
        _clear(case)


def _settle(case: Path) -> None:
    """Wait until workers whose run was killed have gone: they end when their input does."""
    before = -1
    for _ in range(100):
        size = (case / "calls.log").stat().st_size if (case / "calls.log").exists() else 0
        if size == before:
            return
        before = size
        time.sleep(0.05)


def kill_workers(case: Path, times: int, *, workers: int = 2, seed: int = 1) -> Campaign:
    """Kill workers of a local cluster while runs go on, for a number of kills."""
    from distributed import LocalCluster

    import uqsphere
    from uqsphere.runner.cluster import dask_cluster

    rng, found = random.Random(seed), Campaign()
    whole, seconds, evaluations = _whole(case)
    study = uqsphere.load_study(case / "killed.toml")
    with contextlib.ExitStack() as opened:
        executor = opened.enter_context(dask_cluster("local", workers))
        cluster: LocalCluster = executor.client.cluster
        while found.kills < times:
            _clear(case)
            with _killing(cluster, rng, found, times, 0.3 * seconds):
                uqsphere.run(study, out=case / "results", model=f"{case / 'killed.py'}:f", executor=executor)
            found.runs += 1
            found.codes.append(0)
            begun, ended, rows = calls_of(case)
            made = sum(rows[name] * n for name, n in ended.items())
            found.evaluations += made
            found.unstored += made - evaluations
            found.cut += sum(rows[name] * (n - ended.get(name, 0)) for name, n in begun.items())
            found.unequal += int(answers_of(case / "results") != whole)
    return found


@contextlib.contextmanager
def _killing(cluster: object, rng: random.Random, found: Campaign, times: int, pause: float) -> Iterator[None]:
    """A thread that kills a worker now and then."""
    over = threading.Event()

    def kill() -> None:
        while not over.wait(rng.uniform(0.2 * pause, pause)):
            alive = [w.pid for w in getattr(cluster, "workers", {}).values() if getattr(w, "pid", None)]
            if alive and found.kills < times:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(rng.choice(alive), signal.SIGKILL)
                    found.kills += 1

    thread = threading.Thread(target=kill, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


# --- more workers ---------------------------------------------------------------------------------


@contextlib.contextmanager
def _workers(count: int, dask: bool) -> Iterator[Any]:
    if dask:
        from uqsphere.runner.cluster import dask_cluster

        with dask_cluster("local", count) as executor:
            yield executor
        return
    from uqsphere.runner.workers import LocalWorkers

    pool = LocalWorkers(count)
    try:
        yield pool
    finally:
        pool.close()


def scale(folder: Path, counts: Sequence[int], *, sleep: float, dask: bool = False) -> list[dict[str, Any]]:
    """Run the same study with each number of workers; they are started, and have loaded what they need, before.

    Returns
    -------
    list of dict
        Per number of workers the seconds of the run, its stages, evaluations,
        and the digest of the answers.
    """
    import uqsphere
    from uqsphere.study import load_study

    quick, case = write_case(folder / "quick", 0.0), write_case(folder / "case", sleep)
    rows = []
    for count in counts:
        with _workers(count, dask) as executor:
            for place in (quick, case):  # the first to have everybody awake
                shutil.rmtree(place / "results", ignore_errors=True)
                began = time.perf_counter()
                run = uqsphere.run(load_study(place / "killed.toml"), out=place / "results",
                                   model=f"{place / 'killed.py'}:f", executor=executor)  # fmt: skip
                seconds = time.perf_counter() - began
        rows.append({"workers": count, "seconds": seconds, "evaluations": run.manifest.evaluations,
                     "stages": run.manifest.seconds, "answers": answers_of(run.folder)})  # fmt: skip
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a campaign as JSON; exit code 1 if anything was lost or differed."""
    parser = argparse.ArgumentParser(description="runs and workers that are killed at random")
    parser.add_argument("which", choices=("local", "dask", "scale"))
    parser.add_argument("--times", type=int, default=200)
    parser.add_argument("--sleep", type=float, default=0.0005, help="seconds that a row takes")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", default="2", help="processes of a local run, or workers of the cluster")
    parser.add_argument("--processes", action="store_true", help="local runs evaluate in processes of their own")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4, 8], help="how many each (scale)")
    parser.add_argument("--dask", action="store_true", help="workers of a Dask cluster on this machine (scale)")
    parser.add_argument("--out", type=Path, required=True, help="a folder to work in")
    chosen = parser.parse_args(arguments)
    if chosen.which == "scale":
        rows = scale(chosen.out.resolve(), chosen.workers, sleep=chosen.sleep, dask=chosen.dask)
        print(json.dumps(rows, indent=1))
        return int(len({row["answers"] for row in rows}) > 1)
    case = write_case(chosen.out.resolve(), chosen.sleep, processes=chosen.processes)
    if chosen.which == "local":
        found = kill_runs(case, chosen.times, seed=chosen.seed, jobs=chosen.jobs)
    else:
        found = kill_workers(case, chosen.times, workers=int(chosen.jobs), seed=chosen.seed)
    print(json.dumps(asdict(found)))
    return int(found.unequal > 0 or found.repeated > 0 or any(found.codes))


if __name__ == "__main__":
    sys.exit(main())
