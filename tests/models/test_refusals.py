"""Every refusal of models has its own reason: another cause at the same door is told otherwise."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from uqsphere import evaluate
from uqsphere.errors import AccessError, ModelError, UsageError
from uqsphere.models.model import Model
from uqsphere.models.scene import check_scene, scene_of
from uqsphere.study import Study, load_study

TEXT = """
[inputs]
a = { dist = "normal", mean = 0.0, sd = 1.0 }
b = 2.0
[outputs]
names = ["y", "z"]
"""
BOX = load_study(text=TEXT)
LIMITED = load_study(text=TEXT + "[analysis]\ntime_limit = '1 s'\n")
PRESS = load_study(
    text="""
[sphere]
material = "granite"
radius = "5 mm"
[rig]
kind = "platens"
[platens]
material = "steel"
force = "500 N"
"""
)


def good(x: Any) -> Any:
    return {"y": x["a"], "z": x["b"]}


def answered(returned: Callable[[Any], Any]) -> Callable[[], object]:
    """Calls of a model with two rows each."""
    return lambda: evaluate(BOX, {"a": np.zeros(128)}, ["y", "z"], model=returned)


def rows(*arguments: Any, **keys: Any) -> Callable[[], object]:
    return lambda: evaluate(*arguments, **{"model": good, **keys})


def raising(x: Any) -> Any:
    raise ValueError("too large")


def with_quantity(name: str) -> Study:
    text = f'{PRESS.text}[analysis]\nquantities = ["{name}"]\n'
    return load_study(text=text)


#: a refused call, its words, and a call that is refused at the same door otherwise
REASONS: dict[str, tuple[Callable[[], object], str, Callable[[], object]]] = {
    "raises": (answered(raising), "the model raised ValueError", answered(lambda x: 3)),
    "one array": (
        answered(lambda x: x["a"]),
        "the model must return a dict with 'y', 'z', or an array",
        answered(lambda x: {"y": x["a"]}),
    ),
    "an output less": (
        answered(lambda x: {"y": x["a"]}),
        "the model returned 'y', but no 'z'",
        answered(lambda x: {"y": x["a"], "z": x["a"][:0]}),
    ),
    "rows less": (
        answered(lambda x: {"y": x["a"], "z": x["a"][:0]}),
        "the model's 'z' must have shape (2,)",
        answered(lambda x: {"y": x["a"], "z": "z"}),
    ),
    "a number for all": (
        answered(lambda x: {"y": x["a"], "z": 1.0}),
        "Wrap a function of one row with numpy.vectorize",
        answered(lambda x: {"y": x["a"], "z": x["a"][:0]}),
    ),
    "complex": (
        answered(lambda x: {"y": x["a"], "z": 1j * x["b"]}),
        "its type is complex. Return the real part",
        answered(lambda x: {"y": x["a"], "z": np.array(["z"] * len(x["a"]))}),
    ),
    "text": (
        answered(lambda x: {"y": x["a"], "z": np.array(["z"] * len(x["a"]))}),
        "its type is <U1",
        answered(lambda x: {"y": x["a"], "z": 1j * x["b"]}),
    ),
    "not finite": (
        answered(lambda x: {"y": x["a"], "z": np.nan * x["b"]}),
        "the model returned z = nan",
        answered(lambda x: {"y": x["a"], "z": 1e200 * x["b"]}),
    ),
    "too large": (
        answered(lambda x: {"y": x["a"], "z": 1e200 * x["b"]}),
        "z = 2e+200, too large",
        answered(lambda x: {"y": x["a"], "z": np.nan * x["b"]}),
    ),
    "no model": (
        lambda: Model(BOX),
        "a black-box study needs a model",
        lambda: Model(PRESS, good),
    ),
    "a model of a scene": (
        lambda: Model(PRESS, good),
        "a user model needs a black-box study",
        lambda: Model(BOX),
    ),
    "an executor of a scene": (
        lambda: Model(PRESS, executor=object()),
        "an executor takes the model runs of a black box",
        lambda: Model(PRESS, good),
    ),
    "a limit elsewhere": (
        lambda: Model(LIMITED, good, executor=object()),
        "Remove analysis.time_limit or the executor",
        lambda: Model(BOX, good, executor=object()),
    ),
    "an executor that is none": (
        lambda: Model(BOX, good, executor=object()),
        "executor must provide submit(); object does not",
        lambda: Model(LIMITED, good, executor=object()),
    ),
    "threads": (
        lambda: Model(BOX, good, threads=0),
        "threads must be a positive integer, not 0",
        lambda: Model(BOX, "box.txt:f", threads=1),
    ),
    "a reference of another form": (
        lambda: Model(BOX, "box.txt:f"),
        "the model must be FILE.py:FUNCTION",
        lambda: Model(BOX, "nothing.py:f"),
    ),
    "a file that is not there": (
        lambda: Model(BOX, "nothing.py:f"),
        "nothing.py: there is no such file",
        lambda: Model(BOX, "nothing.py"),
    ),
    "an input that is not there": (
        rows(BOX, {"c": [1.0]}),
        "unknown input 'c'",
        rows(BOX, {"a": ["c"]}),
    ),
    "an output that is not there": (
        rows(BOX, {"a": [1.0]}, "w"),
        "unknown output 'w'",
        rows(BOX, {"w": [1.0]}),
    ),
    "an output twice": (
        rows(BOX, {"a": [1.0]}, ["y", "y"]),
        "the output 'y' is given 2 times",
        rows(BOX, {"a": [1.0]}, ["x", "y"]),
    ),
    "a frame without a random input": (
        rows(BOX, pd.DataFrame({"b": [1.0]})),
        "the column 'a' is missing",
        rows(BOX, pd.DataFrame({"a": ["x"], "b": [1.0]})),
    ),
    "rows that are no table": (
        rows(BOX, [1.0]),
        "frame must be a DataFrame or a dict of arrays by name, not list",
        rows("BOX", {"a": [1.0]}),
    ),
    "a study that is none": (
        rows("BOX", {"a": [1.0]}),
        "study must be a Study, as load_study returns it, not str",
        rows(BOX, [1.0]),
    ),
    "a tolerance of one": (
        rows(BOX, {"a": [1.0]}, tolerance=1.0),
        "tolerance must be between 1e-12 and 1e-2",
        rows(BOX, {"a": [1.0]}, threads=-1),
    ),
    "a number of another scene": (
        lambda: scene_of(PRESS, {"sphere.E2": np.ones(1)}),
        "'sphere.E2' is not an input of a scene",
        lambda: evaluate(PRESS, {"sphere.E": [1.0]}, "pmax"),
    ),
    "a quantity of another rig": (
        lambda: check_scene(with_quantity("restitution")),
        "the rig platens has no restitution here",
        lambda: evaluate(PRESS, {}, "restitutio"),
    ),
}


@pytest.mark.parametrize("name", REASONS)
def test_another_cause_is_not_told_in_the_same_words(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    call, words, other = REASONS[name]
    monkeypatch.chdir(tmp_path)
    texts = []
    for refused in (call, other):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with pytest.raises((UsageError, ModelError, AccessError, UserWarning)) as caught:
                refused()
        texts.append(str(caught.value))
    assert words in texts[0]
    assert words not in texts[1]
