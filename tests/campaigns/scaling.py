"""One, two, four and eight workers: whether the answers are the same bytes, and how much sooner they are there.

``python -m tests.campaigns.scaling --out FOLDER`` runs a black box whose rows take a while and no processor, so that a
machine with two of them can serve eight workers; with local processes, or with ``--dask`` over the loopback device.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from tests.campaigns.kills import answers_of, write_case
from uqsphere.runner.workers import LocalWorkers
from uqsphere.study import load_study

__all__ = ["measure"]


@contextlib.contextmanager
def _workers(count: int, dask: bool) -> Iterator[Any]:
    if dask:
        from uqsphere.runner.cluster import dask_cluster

        with dask_cluster("local", count) as executor:
            yield executor
        return
    pool = LocalWorkers(count)
    try:
        yield pool
    finally:
        pool.close()


def measure(folder: Path, counts: Sequence[int], *, sleep: float, dask: bool = False) -> list[dict[str, Any]]:
    """Run the same study with each number of workers; they are started, and have loaded what they need, before.

    Returns
    -------
    list of dict
        Per number of workers the seconds of the run, its stages, evaluations,
        and the digest of the answers.
    """
    import uqsphere

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
    """Print the measurement as JSON; exit code 1 if the answers differ."""
    parser = argparse.ArgumentParser(description="runs with one, two, four and eight workers")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4, 8])
    parser.add_argument("--sleep", type=float, default=0.005, help="seconds that a row takes")
    parser.add_argument("--dask", action="store_true", help="workers of a Dask cluster on this machine")
    parser.add_argument("--out", type=Path, required=True, help="a folder to work in")
    chosen = parser.parse_args(arguments)
    rows = measure(chosen.out.resolve(), chosen.workers, sleep=chosen.sleep, dask=chosen.dask)
    for row in rows:
        row["speed"] = rows[0]["seconds"] / row["seconds"]
    print(json.dumps(rows, indent=1))
    return int(len({row["answers"] for row in rows}) > 1)


if __name__ == "__main__":
    sys.exit(main())
