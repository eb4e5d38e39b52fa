"""Where physics meets probability: rows to rows, by the impact model or by a black box."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import uqsphere
from uqsphere.black_box import load_black_box, model_digest
from uqsphere.errors import AccessError, UqsphereError, UsageError
from uqsphere.mechanics.integrator import solve as dynamics
from uqsphere.mechanics.outputs import absent_in
from uqsphere.mechanics.scene import Scene
from uqsphere.model import STATUS_NOT_FINITE, answer_black_box, evaluate, scene_of
from uqsphere.quantities import OUTPUTS
from uqsphere.study import Study

QUANTITIES = ("p_max", "contact_time", "energy", "force_imbalance")

BOX = """\
title = "box"
seed = 1
[inputs]
a = { dist = "uniform", lower = 0.0, upper = 1.0 }
b = 3.0
[outputs]
names = ["y", "z"]
"""


@pytest.fixture
def study(study_from: Callable[..., Study]) -> Study:
    return study_from()


@pytest.fixture
def box_study(study_from: Callable[..., Study]) -> Study:
    return study_from(text=BOX)


def spread(n: int) -> dict[str, np.ndarray]:
    generator = np.random.default_rng(7)
    return {
        "sphere.E": generator.uniform(40e9, 80e9, n),
        "striker.speed": generator.uniform(3.0, 7.0, n),
        "sphere.radius": generator.uniform(4.5e-3, 5.5e-3, n),
    }


# --- the impact model -----------------------------------------------------------------------------


def test_evaluate_is_the_mechanics_at_the_means(study: Study) -> None:
    values = spread(5)
    frame = evaluate(study, values, QUANTITIES, tolerance=1e-6)
    columns = {name: np.full(5, number) for name, number in study.at_means().items()} | values
    direct = dynamics.solve(Scene(columns=columns), tolerance=1e-6)
    for name in QUANTITIES:
        assert frame[name].to_numpy().tobytes() == direct.values[name].tobytes()
    assert list(frame.columns) == [*QUANTITIES, "status", "censored"]
    assert (frame["status"] == 0).all()


def test_every_quantity_has_a_column(study: Study) -> None:
    scene = scene_of(study, {})
    names = tuple(name for name in OUTPUTS if not absent_in(scene, name))
    assert {"p_max", "mean_force_max", "energy_sphere"} <= set(names)
    assert {"t10", "restitution", "dent"}.isdisjoint(names)
    frame = evaluate(study, {}, names, tolerance=1e-4)
    assert frame.shape == (1, len(names) + 2)
    assert np.isfinite(frame.to_numpy(dtype=float)).all()


def test_scalars_spread_over_the_rows(study: Study) -> None:
    frame = evaluate(study, {"striker.speed": [4.0, 5.0], "sphere.E": 60e9}, tolerance=1e-4)
    same = evaluate(study, {"striker.speed": np.array([4.0, 5.0]), "sphere.E": np.full(2, 60e9)}, tolerance=1e-4)
    assert frame.equals(same)
    assert frame["p_max"][1] > frame["p_max"][0]


@pytest.mark.parametrize("empty", [{"striker.speed": []}, {"striker.speed": [], "sphere.E": 60e9}])
def test_no_rows_give_no_rows(study: Study, empty: dict[str, Any]) -> None:
    assert evaluate(study, empty, QUANTITIES).shape == (0, len(QUANTITIES) + 2)


@pytest.mark.parametrize(
    ("column", "bad"),
    [("sphere.E", -1.0), ("sphere.E", np.nan), ("sphere.nu", 0.5), ("sphere.radius", 7e-3), ("striker.speed", 0.0),
     ("striker.speed", np.inf), ("sphere.density", 0.0)],
)  # fmt: skip
def test_a_row_without_meaning_has_a_status_and_no_number(study: Study, column: str, bad: float) -> None:
    good = study.at_means()[column]
    frame = evaluate(study, {column: [good, bad, good]}, QUANTITIES, tolerance=1e-4)
    assert frame["status"].tolist() == [0, 1, 0]
    assert frame.loc[1, list(QUANTITIES)].isna().all()
    assert not frame.loc[1, "censored"]
    assert frame.loc[0, list(QUANTITIES)].equals(frame.loc[2, list(QUANTITIES)])


@pytest.mark.parametrize(
    ("values", "options", "message"),
    [
        ({"sphere.colour": [1.0]}, {}, "sphere.colour"),
        ({"limits.crushing.strength": [1.0]}, {}, "limits.crushing.strength"),
        ({"sphere.E": [1.0, 2.0], "striker.speed": [1.0, 2.0, 3.0]}, {}, "differ in length"),
        ({"sphere.E": [], "striker.speed": [1.0, 2.0]}, {}, "differ in length"),
        ({"sphere.E": [[1.0, 2.0]]}, {}, "shape"),
        ({}, {"quantities": ("p_min",)}, "p_min"),
        ({}, {"fidelity": "best"}, "best"),
        ({}, {"tolerance": 0.0}, "tolerance"),
        ({}, {"tolerance": float("nan")}, "tolerance"),
        ({}, {"threads": 0}, "threads"),
    ],
)
def test_wrong_questions_are_refused(study: Study, values: Any, options: Any, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        evaluate(study, values, **options)


def test_the_face_is_the_same_from_outside(study: Study) -> None:
    assert uqsphere.evaluate is evaluate
    trace = uqsphere.history(study)
    peak = evaluate(study, {}, ("p_max",), tolerance=1e-8)["p_max"][0]
    assert max(trace.pressure_a.max(), trace.pressure_b.max()) == pytest.approx(peak, rel=1e-3)


# --- black boxes ----------------------------------------------------------------------------------


def ask(study: Study, box: Any, n: int = 4) -> Any:
    return answer_black_box(study, ("a",), np.linspace(0.1, 0.9, n)[:, None], ("y", "z"), box)


def test_a_black_box_gets_its_inputs_and_the_fixed_ones(box_study: Study) -> None:
    def box(inputs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        assert {name: column.dtype for name, column in inputs.items()} == {"a": np.float64, "b": np.float64}
        return {"z": inputs["b"], "y": inputs["a"], "more": inputs["a"]}

    found = ask(box_study, box)
    np.testing.assert_array_equal(found.values, np.stack([np.linspace(0.1, 0.9, 4), np.full(4, 3.0)], axis=1))
    assert found.status.tolist() == [0, 0, 0, 0]
    assert not found.censored.any()


def test_a_black_box_cannot_change_the_points(box_study: Study) -> None:
    rows = np.linspace(0.1, 0.9, 4)[:, None]

    def box(inputs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        inputs["a"] *= 0.0
        return {"y": inputs["a"], "z": inputs["a"]}

    answer_black_box(box_study, ("a",), rows, ("y", "z"), box)
    np.testing.assert_array_equal(rows[:, 0], np.linspace(0.1, 0.9, 4))


def leave(inputs: Any) -> Any:
    sys.exit(0)


@pytest.mark.parametrize(
    ("box", "message"),
    [
        (lambda i: {"y": i["a"]}, "no 'z'"),
        (lambda i: {}, "nothing"),
        (lambda i: i["a"], "must return a dict"),
        (lambda i: None, "must return a dict"),
        (lambda i: {"y": i["a"], "z": i["a"][:2]}, r"shape \(4,\).*found \(2,\)"),
        (lambda i: {"y": i["a"], "z": 1.0}, r"shape \(4,\).*found \(\)"),
        (lambda i: {"y": i["a"], "z": i["a"][:, None]}, r"found \(4, 1\)"),
        (lambda i: {"y": i["a"], "z": ["a", "b", "c", "d"]}, "not an array of numbers"),
        (lambda i: {"y": i["a"], "z": i["a"] + 1j}, "complex"),
        (lambda i: 1 / 0, "ZeroDivisionError"),
        (leave, "SystemExit"),
    ],
)
def test_a_black_box_that_answers_wrongly(box_study: Study, box: Any, message: str) -> None:
    with pytest.raises(UqsphereError, match=message):
        ask(box_study, box)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_an_answer_that_is_not_finite_is_a_failed_row(box_study: Study, bad: float) -> None:
    found = ask(box_study, lambda i: {"y": np.where(i["a"] > 0.5, bad, 1.0), "z": i["a"]})
    assert found.status.tolist() == [0, 0, STATUS_NOT_FINITE, STATUS_NOT_FINITE]
    assert np.isnan(found.values[2:]).all()
    assert np.isfinite(found.values[:2]).all()


def test_prints_go_to_stderr(box_study: Study, capsys: pytest.CaptureFixture[str]) -> None:
    def box(inputs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        print("chatter")
        return {"y": inputs["a"], "z": inputs["a"]}

    ask(box_study, box)
    print("result")
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("result\n", "chatter\n")


def test_threads_give_stdout_back(box_study: Study, capsys: pytest.CaptureFixture[str]) -> None:
    """The second thread begins while the first is inside, and ends after it."""
    inside, ended = threading.Event(), threading.Event()

    def first(inputs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        assert inside.wait(10)
        return {"y": inputs["a"], "z": inputs["a"]}

    def second(inputs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        inside.set()
        assert ended.wait(10)
        print("chatter")
        return {"y": inputs["a"], "z": inputs["a"]}

    stdout = sys.stdout
    one, two = (threading.Thread(target=ask, args=(box_study, box)) for box in (first, second))
    one.start()
    two.start()
    one.join()
    ended.set()
    two.join()
    assert sys.stdout is stdout
    assert capsys.readouterr() == ("", "chatter\n")


def test_a_black_box_study_needs_its_model(box_study: Study) -> None:
    with pytest.raises(UsageError, match="--model"):
        ask(box_study, None)
    with pytest.raises(UsageError, match="black box"):
        evaluate(box_study, {})


def test_load_black_box_loads_the_function(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "model.py"
    file.write_text("print('loading')\ndef f(inputs):\n    return {'y': 2 * inputs['a']}\n")
    box = load_black_box(f"{file}:f")
    assert box({"a": np.array([1.5])})["y"].tolist() == [3.0]
    assert capsys.readouterr() == ("", "loading\n")


@pytest.mark.parametrize("reference", ["model.py", "model.txt:f", "model.py:", "model.py:not a name", ":f", ""])
def test_malformed_references_are_refused(reference: str) -> None:
    with pytest.raises(UsageError, match=r"FILE\.py:FUNCTION"):
        load_black_box(reference)


def test_models_that_cannot_be_had(tmp_path: Path) -> None:
    with pytest.raises(AccessError, match="does not exist"):
        load_black_box(f"{tmp_path / 'none.py'}:f")
    with pytest.raises(AccessError):
        model_digest(f"{tmp_path / 'none.py'}:f")
    file = tmp_path / "model.py"
    for text, kind, message in (
        ("x = 1\n", UsageError, "no function 'f'"),
        ("f = 1\n", UsageError, "no function 'f'"),
        ("1 / 0\n", UqsphereError, "ZeroDivisionError"),
        ("def f(:\n", UqsphereError, "SyntaxError"),
        ("import sys\nsys.exit(0)\n", UqsphereError, "SystemExit"),
    ):
        file.write_text(text)
        with pytest.raises(kind, match=message):
            load_black_box(f"{file}:f")


def test_digests_tell_models_apart(tmp_path: Path) -> None:
    file = tmp_path / "model.py"
    file.write_text("def f(x): return 1\ndef g(x): return 2\n")
    first = model_digest(f"{file}:f")
    assert first == model_digest(f"{file}:f")
    assert first != model_digest(f"{file}:g")
    file.write_text("def f(x): return 3\n")
    assert first != model_digest(f"{file}:f")
    assert model_digest(leave) == model_digest(leave) != model_digest(lambda x: x)
