"""`run --dask`: the same answers as on one machine, with a worker killed."""

import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from uqsphere.cli import main
from uqsphere.results import open_run

STUDY = """
title = "A product"
seed = 1
[inputs]
a = { dist = "normal", mean = 1.0, sd = 0.1 }
k = 2.0
c = 1.0
[outputs]
names = ["y"]
[limits.high]
quantity = "y"
strength = 6.0
target = 0.1
[margins]
solve = "k"
between = [1.0, 20.0]
[analysis]
budget = { evaluations = 12000 }
accuracy = { mean = 0.1, quantile = 0.2, sobol = 0.2, probability = 0.3 }
"""
MODEL = 'def f(x):\n    return {"y": x["a"] * x["k"] * x["c"]}\n'


@pytest.fixture
def cluster() -> Iterator[Any]:
    distributed = pytest.importorskip("distributed")
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": ":0"}
    with distributed.LocalCluster(**options) as cluster:
        yield cluster


@pytest.fixture(autouse=True)
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(STUDY)
    Path("box.py").write_text(MODEL)


def kill_a_busy_one(cluster: Any) -> threading.Thread:
    """Kill the first worker that has something to do."""

    def kill() -> None:
        while True:
            for address, worker in dict(cluster.scheduler.workers).items():
                if worker.processing:
                    nannies = cluster.workers.values()
                    nanny = next(nanny for nanny in nannies if nanny.worker_address == address)
                    os.kill(nanny.pid, signal.SIGKILL)
                    return
            time.sleep(0.01)

    thread = threading.Thread(target=kill, daemon=True)
    thread.start()
    return thread


def answers(folder: str) -> Any:
    return open_run(folder).results.answers


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_answers_of_a_cluster_that_loses_a_worker_are_those_of_one_machine(cluster: Any) -> None:
    words = ("run", "s.toml", "--model", "box.py:f")
    assert main([*words, "-j", "1", "--out", "here"]) == 0
    killed = kill_a_busy_one(cluster)
    assert main([*words, "--dask", cluster.scheduler_address, "--out", "there"]) == 0
    assert not killed.is_alive()
    assert answers("there") == answers("here")


def test_the_impact_model_is_not_sent_to_a_cluster(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new", "granite"]) == 0
    assert main(["run", "granite.toml", "--dask", "tcp://127.0.0.1:1"]) == 2
    assert "distributes the model runs of a black box" in capsys.readouterr().err


def test_a_file_of_another_kind_is_no_scheduler_file(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("distributed")
    assert main(["new", "ishigami"]) == 0
    words = ["run", "ishigami.toml", "--model", "ishigami.py:ishigami"]
    assert main([*words, "--dask", "ishigami.py"]) == 2
    assert "--dask: no scheduler at ishigami.py (" in capsys.readouterr().err
