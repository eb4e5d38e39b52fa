"""Models that end, hang, fork, print, return or raise what no model should: told of by code 4, or without harm."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Any

import pytest

import uqsphere
from uqsphere.cli import main
from uqsphere.errors import ModelError, TooManyFailures
from uqsphere.runner import workers

STUDY = """
seed = 3
[inputs]
a = { dist = "normal", mean = 0.0, sd = 1.0 }
[outputs]
names = ["y"]
[analysis]
methods = ["qmc"]
cost = "1 us"
quantiles = [0.5]
accuracy = { mean = 1.0, quantile = 2.0, sobol = 2.0, probability = 2.0 }
budget = { evaluations = 2_100 }
"""

HEAD = """
import ctypes, os, subprocess, sys, time
import numpy as np

class Hostile:
    def __str__(self): raise RuntimeError("no text")
    __repr__ = __array__ = __float__ = __len__ = __str__

class Silly(Exception):
    def __str__(self): raise RuntimeError("no text")

class Odd(dict):
    def __getitem__(self, key): raise OSError("odd")

def good(rows):
    return {"y": rows["a"]}

"""

#: what stands in the function, and what is said of it; answers of a wrong shape or kind are tried in test_model.py
FAULTY = {
    "exit": ("exit(0)", "SystemExit: 0"),
    "ends": ("os._exit(0)", "exit code 0"),
    "segfault": ("ctypes.string_at(0)", "SIGSEGV"),
    "killed": ("os.kill(os.getpid(), 9)", "SIGKILL), as where memory runs out"),
    "memory": ("np.ones(1 << 45)", "MemoryError"),
    "interrupts": ("raise KeyboardInterrupt", "the model raised KeyboardInterrupt"),
    "recursion": ("return f(rows)", "RecursionError"),
    "input": ("input()", "EOFError"),
    "long": ("raise ValueError('\\x1b[2J' + 'x' * 10_000_000)", "ValueError: ?[2Jxxx"),
    "no text": ("raise Silly", "Silly: (its text cannot be had: RuntimeError)"),
    "huge": ("return {'y': [10**400] * len(rows['a'])}", "is not an array of numbers"),
    "keys": ("return {Hostile(): 1.0, '\\x1b[2J' * 10_000: 2.0}", "returned no 'y' (it returned '(its text cannot"),
    "mapping": ("return Odd(y=1.0)", "cannot be read: OSError: odd"),
    "closes": ("os.closerange(3, 99)", "its process ended with"),
    "writes": ("[os.write(k, b'junk' * 99) for k in range(3, 20) if not os.set_blocking(k, False)]", ""),
}

#: what does no harm
HARMLESS = {
    "fork": "os.fork()",
    "daemon": "subprocess.Popen(['sleep', '3599'], start_new_session=True)",
    "children": "os.system('echo noise'); ctypes.CDLL(None).puts(b'noise'); print('noise')",
    "leaves": "os.chdir('/')",
}


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(workers, "LIVES", 2)
    monkeypatch.setenv("UQSPHERE_TEST", str(tmp_path))
    (tmp_path / "s.toml").write_text(STUDY, "utf-8")
    return tmp_path


def write(place: Path, body: str) -> str:
    (place / "own.py").write_text(f"{HEAD}\ndef f(rows):\n    {body}\n    return good(rows)\n", "utf-8")
    return "own.py:f"


def left_behind(place: Path) -> list[str]:
    """Processes that were started, by whom ever, in a test that has `place`."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):
            if f"UQSPHERE_TEST={place}\0".encode() in entry.read_bytes():
                found.append(entry.parent.name)
    return found


@pytest.mark.parametrize("name", FAULTY)
def test_a_faulty_model_is_told_of(place: Path, name: str, capfd: pytest.CaptureFixture[str]) -> None:
    body, said = FAULTY[name]
    reference = write(place, body)
    assert main(["run", "s.toml", "--model", reference, "--out", "r", "--json", "-j", "1"]) == 4
    out, err = capfd.readouterr()
    assert out == ""
    assert said in err
    assert all(c.isprintable() or c == "\n" for c in err)
    assert len(err) < 8000  # a traceback of the process, with the paths of its files
    assert not (place / "r" / "results.json").exists()


def test_a_faulty_model_is_told_of_through_the_door_of_python(place: Path) -> None:
    body, said = FAULTY["segfault"]
    with pytest.raises((ModelError, TooManyFailures)) as raised:
        uqsphere.run(uqsphere.load_study(place / "s.toml"), out=place / "door", model=write(place, body), threads=1)
    assert said in str(raised.value)
    assert not (place / "door" / "results.json").exists()


@pytest.mark.parametrize("name", HARMLESS)
def test_a_model_that_does_more_than_answer_harms_nothing(
    place: Path, name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    study = uqsphere.load_study(place / "s.toml")
    reference = write(place, HARMLESS[name])
    expected = uqsphere.run(study, out=place / "good", model=lambda rows: {"y": rows["a"]}).results.document()
    found = uqsphere.run(study, out=place / "door", model=reference, threads=1).results.document()
    assert found["quantities"] == expected["quantities"]
    out, err = capfd.readouterr()
    assert out == ""
    assert ("the model f forked a process" in err) == (name == "fork")
    assert ("noise" in err) == (name == "children")
    assert left_behind(place) == []


def test_what_a_function_prints_is_no_answer(place: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The same in this process, where C holds back what it has printed."""
    import ctypes

    def noisy(rows: dict[str, Any]) -> dict[str, Any]:
        print("noise")
        os.system("echo noise")
        ctypes.CDLL(None).puts(b"noise")
        return {"y": rows["a"]}

    uqsphere.run(uqsphere.load_study(place / "s.toml"), out=place / "r", model=noisy)
    ctypes.CDLL(None).fflush(None)
    out, err = capfd.readouterr()
    assert out == ""
    assert err.count("noise") % 3 == 0 < err.count("noise")


def test_a_function_that_forks_goes_on_alone(place: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """A child that comes back would write into the same folder."""
    processes = set()

    def forks(rows: dict[str, Any]) -> dict[str, Any]:
        if os.fork() == 0:
            return {"y": rows["a"] + 1e9}
        os.wait()
        processes.add(os.getpid())
        return {"y": rows["a"]}

    uqsphere.run(uqsphere.load_study(place / "s.toml"), out=place / "r", model=forks)
    assert processes == {os.getpid()}
    assert capfd.readouterr().err.count("forks forked a process that came back") <= 1


@pytest.mark.parametrize(("body", "said"), [("os._exit(0)", "ended their process"), ("time.sleep(99)", "time_limit")])
def test_a_model_that_never_answers_ends_a_run_that_lets_rows_fail(
    place: Path, body: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers, "HUNG", 3)
    overrides = ('analysis.on_failure="bound"', 'analysis.time_limit="0.1 s"')
    study = uqsphere.load_study(place / "s.toml", overrides)
    with pytest.raises((ModelError, TooManyFailures)) as raised:
        uqsphere.run(study, out=place / "r", model=write(place, body), threads=1)
    assert said in str(raised.value)
    assert raised.value.exit_code == 4


def test_a_model_that_hangs_ends_with_the_time_budget(
    place: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Without a limit of time nothing else ends it; what was answered before is kept."""
    monkeypatch.setattr(workers, "PATIENCE", 0.2)
    reference = write(place, "time.sleep(3600)")
    assert main(["run", "s.toml", "--model", reference, "--budget", "1 s"]) == 4
    assert "does not come back" in capfd.readouterr().err
    assert left_behind(place) == []


def test_a_file_that_ends_the_process_on_loading(place: Path) -> None:
    (place / "own.py").write_text("import os\nos._exit(0)\n", "utf-8")
    with pytest.raises(ModelError, match=r"own\.py:f on loading: its process ended with exit code 0"):
        uqsphere.run(uqsphere.load_study(place / "s.toml"), out=place / "r", model="own.py:f")
    assert not (place / "r").exists()


def test_verify_tells_a_model_that_is_not_deterministic_from_damage(
    place: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    # at once where the row that is evaluated twice shows it
    reference = write(place, "return {'y': rows['a'] + np.random.default_rng().normal(size=len(rows['a']))}")
    assert main(["run", "s.toml", "--model", reference, "--out", "once", "-j", "1"]) == 4
    assert "the model is not deterministic: the same row gives" in capfd.readouterr().err
    # and where it does not, by verify
    noise = "np.random.default_rng().normal(size=len(rows['a']))"
    reference = write(place, f"return {{'y': rows['a'] + {noise} * (np.arange(len(rows['a'])) < len(rows['a']) - 1)}}")
    assert main(["run", "s.toml", "--model", reference, "--out", "r", "-j", "1"]) == 0
    capfd.readouterr()
    assert main(["verify", "r", "--model", reference, "--chunks", "2"]) == 4
    out, err = capfd.readouterr()
    assert "THE MODEL IS NOT DETERMINISTIC" in out
    assert "damaged" not in out
    assert "is not deterministic: r is not damaged" in err
    # what lies in the file's surroundings has changed: the same twice now, and not as stored
    (place / "shift").write_text("0")
    reference = write(place, "return {'y': rows['a'] + float(open('shift').read())}")
    assert main(["run", "s.toml", "--model", reference, "--out", "s", "-j", "1"]) == 0
    (place / "shift").write_text("1")
    assert main(["verify", "s", "--model", reference, "--chunks", "2"]) == 5
    assert "come out differently" in capfd.readouterr().out
