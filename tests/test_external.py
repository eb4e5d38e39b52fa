"""Models that are programs or servers: what their file declares, one call for each row, and what goes wrong."""

from __future__ import annotations

import json
import re
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import numpy as np
import pytest
from conftest import SMALL

import uqsphere
from uqsphere.black_box import load_black_box, model_digest
from uqsphere.cli.studies import server_of
from uqsphere.errors import AccessError, ModelError, StudyError, UsageError

#: prints, writes a CSV and JSON; fails where x is above 2, and hangs below -2
SOLVER = """\
import json, sys, time
x, word = open("in.txt").read().split()
x = float(x)
if x > 2.0:
    sys.exit("no convergence")
if x < -2.0:
    time.sleep(60)
print("step 1: y = 0.0")
print(f"step 2: y = {x * x:.17e}".replace("e", "D"))
open("out.csv", "w").write(f"t, u\\n0, 1.0\\n1, {x + 1.0!r}\\n")
json.dump({"nodes": [{"u": 0.0}, {"u": 2.0 * x}]}, open("out.json", "w"))
"""

DECLARED = """\
[model]
command = [PYTHON, "solver.py", "{{x:.3f}}"]
template = "in.template"
input = "in.txt"
depends = ["solver.py"]
time_limit = "TIME"
scratch = "runs"
[model.outputs]
y = { pattern = 'y = (\\S+)' }
u = { file = "out.csv", column = "u" }
first = { file = "out.csv", column = "u", row = 0 }
w = { file = "out.json", path = "nodes.1.u" }
"""


STUDY = """\
title = "program"
seed = 1
[inputs]
x = { dist = "uniform", lower = -1.0, upper = 1.0 }
[outputs]
names = ["u"]
[analysis]
cost = "1 s"
budget = { evaluations = 40 }
"""


def declared(folder: Path, *changes: tuple[str, str], limit: str = "20 s") -> str:
    text = DECLARED.replace("PYTHON", json.dumps(sys.executable)).replace("TIME", limit)
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "solver.py").write_text(SOLVER)
    (folder / "in.template").write_text("{{x}} {{ x:.2e }}\n")
    (folder / "model.toml").write_text(text)
    return str(folder / "model.toml")


def test_every_output_is_found_and_no_folder_stays(tmp_path: Path) -> None:
    model = load_black_box(declared(tmp_path))
    x = np.array([0.1, -1.5])
    found = model({"x": x})
    assert found["y"] == pytest.approx(x**2, rel=1e-15)
    assert found["u"].tolist() == (x + 1.0).tolist()
    assert found["first"].tolist() == [1.0, 1.0]
    assert found["w"].tolist() == (2.0 * x).tolist()
    assert list((tmp_path / "runs").iterdir()) == []


def test_a_run_that_fails_is_told_and_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = load_black_box(declared(tmp_path, ('scratch = "runs"', 'scratch = "runs"\ntries = 2')))
    found = model({"x": np.array([1.0, 3.0])})
    assert np.isnan(found["y"]).tolist() == [False, True]
    told = capsys.readouterr().err
    assert told.count("ended with 1: no convergence; kept in ") == 2
    kept = sorted((tmp_path / "runs").iterdir())
    assert len(kept) == 2
    assert (kept[0] / "in.txt").read_text() == "3.0 3.00e+00\n"
    assert (kept[0] / "stderr").read_text().strip() == "no convergence"


def test_a_run_that_hangs_is_ended(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = load_black_box(declared(tmp_path, limit="0.5 s"))
    assert np.isnan(model({"x": np.array([-3.0])})["y"]).all()
    assert "took longer than model.time_limit, 0.5 s" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("y = (", "z = (", "y is not in stdout: nothing matches"),
        ('column = "u" }', 'column = "v" }', 'no column "v" (there is t or u)'),
        ("nodes.1.u", "nodes.5.u", "w is not in out.json: list index out of range"),
        ("out.json", "none.json", "none.json: there is no such file"),
        ('"solver.py", ', '"missing.py", ', "ended with 2"),
    ],
)
def test_what_is_not_there_is_named(
    old: str, new: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = load_black_box(declared(tmp_path, (old, new)))
    assert np.isnan(model({"x": np.array([1.0])})["y"]).all()
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(("mark", "told"), [("{{z}}", "there is no input 'z', but x"), ("{{x:q}}", "Unknown format")])
def test_a_mark_that_cannot_be_filled_ends_the_run(mark: str, told: str, tmp_path: Path) -> None:
    model = load_black_box(declared(tmp_path, ("{{x:.3f}}", mark)))
    with pytest.raises(ModelError, match=re.escape(told)):
        model({"x": np.array([1.0])})
    assert list((tmp_path / "runs").iterdir()) == []


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("command = ", "comand = ", "command"),
        ('time_limit = "20 s"', "time_limit = 20", "model.time_limit"),
        ("(\\S+)", "\\S+", "a group in parentheses marks the number"),
        ("(\\S+)", "(\\S+", "no regular expression"),
        ("pattern", 'column = "y", pattern', "one of pattern, column or path is due"),
        ("[model.outputs]", 'server = "http://localhost:1"\n[model.outputs]', "one of them is due"),
    ],
)
def test_a_faulty_declaration_is_refused_at_its_place(old: str, new: str, told: str, tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"model\.toml:\d+:\d+: ") as caught:
        load_black_box(declared(tmp_path, (old, new)))
    assert told in str(caught.value)


def test_no_outputs_and_no_file(tmp_path: Path) -> None:
    (tmp_path / "model.toml").write_text('[model]\ncommand = ["x"]\n')
    with pytest.raises(StudyError, match="an entry for each output is due"):
        load_black_box(str(tmp_path / "model.toml"))
    with pytest.raises(AccessError, match="does not exist"):
        load_black_box(str(tmp_path / "other.toml"))


def test_what_a_program_depends_on_is_its_identity(tmp_path: Path) -> None:
    reference = declared(tmp_path)
    before = model_digest(reference)
    assert model_digest(reference) == before
    (tmp_path / "solver.py").write_text(SOLVER + "\n")
    other = model_digest(reference)
    (tmp_path / "in.template").write_text("{{x}} 1\n")
    assert len({before, other, model_digest(reference)}) == 3


def test_a_study_runs_a_program_in_processes(tmp_path: Path) -> None:
    reference = declared(tmp_path)
    (tmp_path / "study.toml").write_text(STUDY)
    run = uqsphere.run(uqsphere.load_study(tmp_path / "study.toml"), model=reference, out=tmp_path / "r", threads=2)
    mean = run.results.document()["quantities"]["u"]["mean"]
    assert mean["low"] <= 1.0 <= mean["high"]
    assert mean["value"] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (json.dumps(sys.executable), '"no-such-solver"', "model.command: no-such-solver cannot be started"),
        ("y = (", "z = (", "model.outputs: y is not in stdout: nothing matches"),
        ("out.json", "none.json", "model.outputs: none.json: there is no such file"),
        ("{{x:.3f}}", "{{z}}", "there is no input 'z', but x"),
    ],
)
def test_a_declaration_that_no_run_can_follow_ends_the_study_at_once(
    old: str, new: str, told: str, tmp_path: Path
) -> None:
    reference = declared(tmp_path, (old, new))
    (tmp_path / "study.toml").write_text(STUDY)
    with pytest.raises(ModelError, match=re.escape(told)):
        uqsphere.run(uqsphere.load_study(tmp_path / "study.toml"), model=reference, out=tmp_path / "r", threads=1)
    assert len(list((tmp_path / "runs").iterdir())) <= 2 * 2  # two of each process


# --- servers


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    path = tmp_path_factory.mktemp("served") / "small.toml"
    path.write_text(SMALL)
    with server_of(uqsphere.load_study(path), 0) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://localhost:{server.server_address[1]}"
        server.shutdown()


def client(folder: Path, address: str, *changes: tuple[str, str]) -> str:
    text = f"""\
[model]
server = "{address}"
name = "impact"
inputs = ["E", "r", "v"]
answers = ["p_max", "contact_time"]
config = {{ tolerance = 1e-6 }}
"""
    for old, new in changes:
        text = text.replace(old, new)
    (folder / "server.toml").write_text(text)
    return str(folder / "server.toml")


def test_the_served_model_is_the_model(address: str, tmp_path: Path) -> None:
    rows = {"E": np.array([55e9, 60e9]), "r": np.array([5e-3, 4.9e-3]), "v": np.array([5.0, 4.0])}
    found = load_black_box(client(tmp_path, address))(rows)
    (tmp_path / "small.toml").write_text(SMALL)
    names = ("sphere.E", "sphere.radius", "striker.speed")
    frame = uqsphere.evaluate(
        uqsphere.load_study(tmp_path / "small.toml"), dict(zip(names, rows.values(), strict=True)),
        ("p_max", "contact_time"), tolerance=1e-6,
    )  # fmt: skip
    for name in ("p_max", "contact_time"):
        assert found[name].tolist() == frame[name].tolist()


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('"impact"', '"forward"', "there is no model 'forward', but 'impact'"),
        ('"E", "r", "v"', '"E", "r"', "impact takes 3 inputs, 2 are named"),
        ('"p_max", "contact_time"', '"p_max"', "gave 2 outputs, 1 are named"),
        ('"E", "r", "v"', '"E", "r", "w"', "'w', which is no input of the study"),
        ("1e-6", '"x"', "could not convert"),
    ],
)
def test_a_server_is_quoted(old: str, new: str, told: str, address: str, tmp_path: Path) -> None:
    model = load_black_box(client(tmp_path, address, (old, new)))
    with pytest.raises(ModelError) as caught:
        model({"E": np.array([55e9]), "r": np.array([5e-3]), "v": np.array([5.0])})
    assert told in str(caught.value)


def test_a_server_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="does not answer"):
        load_black_box(client(tmp_path, "http://localhost:1"))({name: np.ones(1) for name in "Erv"})
    with pytest.raises(StudyError, match="an address such as"):
        load_black_box(client(tmp_path, "ftp://localhost"))


def test_what_a_server_says_of_itself(address: str) -> None:
    def ask(path: str, **document: object) -> dict[str, object]:
        data = json.dumps(document).encode() if document else None
        return dict(json.load(urlopen(Request(address + path, data), timeout=60)))

    assert ask("/Info") == {"protocolVersion": 1.0, "models": ["impact"]}
    assert ask("/InputSizes", name="impact") == {"inputSizes": [3]}
    assert ask("/OutputSizes", name="impact") == {"outputSizes": [2]}
    assert ask("/ModelInfo", name="impact") == {
        "support": {"Evaluate": True, "Gradient": False, "ApplyJacobian": False, "ApplyHessian": False}
    }
    for path, document in (("/Gradient", {"name": "impact"}), ("/Evaluate", {"name": "impact", "input": [[1.0]]})):
        with pytest.raises(HTTPError) as caught:
            ask(path, **document)
        assert caught.value.code == 400
        assert "error" in json.load(caught.value)


def test_a_study_that_cannot_be_served(tmp_path: Path) -> None:
    (tmp_path / "box.toml").write_text(
        '[inputs]\nx = { dist = "normal", mean = 0.0, sd = 1.0 }\n[outputs]\nnames = ["y"]\n'
    )
    with pytest.raises(UsageError, match="a study of the impact model"):
        server_of(uqsphere.load_study(tmp_path / "box.toml"), 0)
