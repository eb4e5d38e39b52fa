"""Whether a result folder is whole: checksums, tables, and evaluations done again."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import uqsphere
from uqsphere.cli import main
from uqsphere.cli.verify import verify_folder, verify_text
from uqsphere.errors import FolderError, UsageError
from uqsphere.runner.api import stored_study
from uqsphere.store import kept_data, named_files, read_sums

MODEL = "def f(x):\n    return {'y': x['x1'] + 0.1 * x['x2']}\n"
STUDY = """\
seed = 3
[inputs]
x1 = { dist = "uniform", lower = 0.0, upper = 1.0 }
x2 = { dist = "empirical", file = "tests.csv", column = "load, N", fit = "kde" }
[outputs]
names = ["y"]
[limits.high]
quantity = "y"
strength = 0.9
[analysis]
quantiles = [0.5]
accuracy = { mean = 0.1, quantile = 0.2, sobol = 0.3, probability = 0.5 }
budget = { evaluations = 6000, time = "1 min" }
"""


@pytest.fixture(scope="module")
def box_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a black-box study of its own, its model, its observations, and the finished run in `run`."""
    place = tmp_path_factory.mktemp("box")
    (place / "ball.toml").write_text(STUDY)
    (place / "model.py").write_text(MODEL)
    rows = "\n".join(f'{0.1 * k * k:.6f},"x"' for k in range(1, 30))
    (place / "tests.csv").write_text(f'"load, N",remark\n{rows}\n')
    uqsphere.run(uqsphere.load_study(place / "ball.toml"), out=place / "run", model=f"{place / 'model.py'}:f")
    return place


@pytest.fixture
def box(box_run: Path, tmp_path: Path) -> Path:
    """A copy to damage."""
    return Path(shutil.copytree(box_run, tmp_path / "box"))


def forged(folder: Path, name: str, data: bytes) -> None:
    """Change a file and enter its checksum, as a person could who knows how."""
    (folder / name).write_bytes(data)
    lines = [line.split("  ") for line in (folder / "SHA256SUMS").read_text().splitlines()]
    sums = {path: digest for digest, path in lines} | {name: hashlib.sha256(data).hexdigest()}
    (folder / "SHA256SUMS").write_text("".join(f"{digest}  {path}\n" for path, digest in sorted(sums.items())))


# --- whole ----------------------------------------------------------------------------------------


def test_a_whole_run_is_called_whole_and_stays_untouched(box: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in (box / "run").rglob("*")}
    found = verify_folder(box / "run", chunks=4, model=f"{box / 'model.py'}:f")
    assert (found.verdict, found.faults, found.results) == ("whole", [], "the same")
    assert len(found.repeated) == 4
    assert all(entry.same for entry in found.repeated)
    assert {path: path.stat().st_mtime_ns for path in (box / "run").rglob("*")} == before
    assert "whole" in verify_text(found)


def test_what_an_evaluation_cost_is_no_evaluation(box: Path) -> None:
    """A time never comes out the same: a whole run would be called damaged for it."""
    stored = {path.name.rpartition("_")[0] for path in (box / "run" / "evaluations").glob("*.npy")}
    assert "cost" in stored
    found = verify_folder(box / "run", chunks=len(stored), model=f"{box / 'model.py'}:f")
    assert (found.verdict, found.faults) == ("whole", [])
    assert {entry.chunk for entry in found.repeated} == stored - {"cost"}


def test_no_code_is_run_without_a_model(box: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uqsphere.runner.remote.load_black_box", None)
    found = verify_folder(box / "run")
    assert (found.verdict, found.repeated, found.results) == ("whole", [], "the same")
    assert any("--model" in note for note in found.notes)


def test_another_model_is_not_run(box: Path) -> None:
    (box / "model.py").write_text(MODEL + "raise SystemExit\n")
    with pytest.raises(UsageError, match="not run"):
        verify_folder(box / "run", model=f"{box / 'model.py'}:f")


def test_every_evaluation_of_a_scene_is_evaluated_again(finished: Path) -> None:
    found = verify_folder(finished, chunks=1000)
    assert (found.verdict, found.results, found.notes) == ("whole", "the same", [])
    stored = {path.name.rpartition("_")[0] for path in (finished / "evaluations").glob("*.npy")}
    assert {entry.chunk for entry in found.repeated} == stored
    assert any(chunk.startswith("pilot.") for chunk in stored)


def test_a_changed_flag_is_found(finished: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(finished, tmp_path / "r"))
    path = next((folder / "evaluations").glob("pilot.full.0.*"))
    table = np.load(path)
    table["steps"][7] += 1
    np.save(path, table)
    key = path.name.rpartition("_")[0]
    path.rename(path.with_name(f"{key}_{hashlib.sha256(path.read_bytes()).hexdigest()[:16]}.npy"))
    (fault,) = verify_folder(folder, chunks=1000).faults
    assert f"{key} come out differently" in fault


def test_the_checksums_are_those_of_sha256sum(box: Path) -> None:
    done = subprocess.run(["sha256sum", "--quiet", "--check", "SHA256SUMS"], cwd=box / "run", check=False)
    assert done.returncode == 0
    sums = read_sums(box / "run")
    assert sums is not None
    assert {"results.json", "manifest.json", "study.toml", "samples.npy", "tables/quantities.csv"} <= set(sums)


def test_the_report_enters_its_own_files(box: Path) -> None:
    assert main(["report", str(box / "run"), "--json"]) == 0
    sums = read_sums(box / "run")
    assert sums is not None
    assert {"report.html", "figures/distribution-y.svg"} <= set(sums)
    assert verify_folder(box / "run").verdict == "whole"


# --- damaged --------------------------------------------------------------------------------------


def test_changed_bytes_and_missing_files_are_found(box: Path) -> None:
    changed = ("results.json", "manifest.json", "study.toml", "tables/quantities.csv", "samples.npy")
    for name in changed:
        path = box / "run" / name
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 1
        path.write_bytes(bytes(data))
    missing = ("samples.json", "tables/limits.csv")
    for name in missing:
        (box / "run" / name).unlink()
    found = verify_folder(box / "run")
    assert found.verdict == "damaged"
    assert {f"{name} has been changed since it was written" for name in changed} <= set(found.faults)
    assert {f"{name} is missing" for name in missing} <= set(found.faults)


def test_a_damaged_chunk_is_named_and_a_missing_one_too(box: Path) -> None:
    paths = sorted((box / "run" / "evaluations").iterdir())
    data = paths[0].read_bytes()
    paths[0].write_bytes(data[:-1])
    found = verify_folder(box / "run")
    assert [fault for fault in found.faults if paths[0].name in fault]
    paths[0].unlink()
    (fault,) = verify_folder(box / "run").faults
    assert paths[0].name.rpartition("_")[0] in fault
    assert "missing" in fault


def test_evaluations_that_were_changed_with_their_checksum_are_found(box: Path) -> None:
    path = next((box / "run" / "evaluations").glob("sampling.0.0.*.npy"))
    values = np.load(path)
    values[0, 0] += 1e-9
    np.save(path, values)
    data = path.read_bytes()
    key = path.name.rpartition("_")[0]
    path.rename(path.with_name(f"{key}_{hashlib.sha256(data).hexdigest()[:16]}.npy"))
    count = len(list((box / "run" / "evaluations").iterdir()))
    model = f"{box / 'model.py'}:f"
    assert verify_folder(box / "run", chunks=0, model=model).verdict == "damaged"  # by the results
    found = verify_folder(box / "run", chunks=count, model=model)
    assert any(f"{key} come out differently" in fault for fault in found.faults)


@pytest.mark.parametrize("name", ["results.json", "study.toml", "tables/limits.csv", "samples.npy"])
def test_a_forgery_with_a_fitting_checksum_is_found(box: Path, name: str) -> None:
    path = box / "run" / name
    changes = {"results.json": (b'"value": 0.', b'"value": 1.'), "study.toml": (b"upper = 1.0", b"upper = 1.1")}
    if name == "samples.npy":
        values = np.load(path)
        values[3, 0] *= 1.001
        np.save(path, values)
        data = path.read_bytes()
    else:
        before, after = changes.get(name, (b"miss", b"mist"))
        data = path.read_bytes().replace(before, after, 1)
        assert data != path.read_bytes()
    forged(box / "run", name, data)
    assert verify_folder(box / "run").verdict == "damaged"


def test_a_checksum_outside_the_folder_is_refused(box: Path) -> None:
    secret = box / "secret"
    secret.write_text("x")
    sums = box / "run" / "SHA256SUMS"
    sums.write_text(sums.read_text() + f"{'0' * 64}  ../secret\n")
    (fault,) = verify_folder(box / "run").faults
    assert "SHA256SUMS is damaged" in fault


def test_exit_codes_and_json(box: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(box / "run"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == "whole"
    (box / "run" / "samples.json").unlink()
    assert main(["verify", str(box / "run"), "--json"]) == 5
    captured = capsys.readouterr()
    assert json.loads(captured.out)["verdict"] == "damaged"
    assert "damaged" in captured.err
    assert main(["verify", str(box)]) == 5
    assert main(["verify", str(box / "run"), "--chunks", "-1"]) == 2


# --- neither --------------------------------------------------------------------------------------


def test_a_run_that_has_not_finished(box: Path) -> None:
    (box / "run" / "results.json").unlink()
    (box / "run" / "SHA256SUMS").unlink()
    found = verify_folder(box / "run")
    assert (found.verdict, found.faults) == ("unfinished", [])
    with pytest.raises(FolderError, match="not a result folder"):
        verify_folder(box)


def test_a_run_of_another_version_is_not_evaluated_again(box: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uqsphere, "__version__", "999")
    found = verify_folder(box / "run", model=f"{box / 'model.py'}:f")
    assert (found.verdict, found.repeated) == ("whole", [])
    assert any("made by uqsphere" in note for note in found.notes)


@pytest.mark.parametrize(("key", "who"), [("stopped_by_time", "time budget"), ("interrupted", "user")])
def test_a_run_that_was_stopped_is_no_damage(box: Path, key: str, who: str) -> None:
    manifest: dict[str, Any] = json.loads((box / "run" / "manifest.json").read_text()) | {key: True}
    forged(box / "run", "manifest.json", json.dumps(manifest).encode())
    sorted((box / "run" / "evaluations").glob("sampling*"))[-1].unlink()
    found = verify_folder(box / "run")
    assert found.verdict == "whole"
    assert any(f"{who} stopped this run" in note for note in found.notes)


# --- the stored study -----------------------------------------------------------------------------


def test_a_stored_study_reads_nothing_beside_itself(box: Path, tmp_path: Path) -> None:
    text = (box / "run" / "study.toml").read_text()
    resolved = json.loads((box / "run" / "study.resolved.json").read_text())
    (tmp_path / "a").mkdir()
    study = stored_study(text, resolved, tmp_path / "a", kept_data(text, box / "run"))
    assert study.hash == resolved["hash"]
    assert study.title == "ball"
    (tmp_path / "b").mkdir()
    with pytest.raises(FolderError, match="there is no file"):
        stored_study(text, resolved, tmp_path / "b")
    with pytest.raises(FolderError, match="of its own folder only"):
        stored_study(text.replace("tests.csv", "../tests.csv"), resolved, tmp_path / "b")
    assert not (tmp_path / "tests.csv").exists()


def test_the_data_of_a_study_is_kept_beside_it(box: Path) -> None:
    assert (box / "run" / "tests.csv").read_bytes() == (box / "tests.csv").read_bytes()
    assert "tests.csv" in (box / "run" / "SHA256SUMS").read_text()
    assert kept_data((box / "run" / "study.toml").read_text(), box / "run").keys() == {"tests.csv"}


@pytest.mark.parametrize(
    "name",
    ["../x.csv", "/x.csv", "tables/x.csv", "Evaluations/x.csv", "results.json", "results.json/x.csv", ".x.csv",
     "a/.x.csv", "nul.csv", "a/nul.csv", "a/../x.csv", "x.py", "-x.csv", "c:x.csv", "a\u202eb.csv", "a\\u001bb.csv",
     "a//x.csv"],
)  # fmt: skip
def test_only_plain_files_of_data_beside_a_study_are_kept(name: str) -> None:
    assert named_files(f'[limits.a.strength]\nfile = "{name}"\n') == []
    assert named_files("not toml") == []
    assert named_files('[[a]]\nfile = "b.csv"\n[pulse]\nfile = "b.csv"') == ["b.csv"]


@pytest.mark.parametrize(
    "name", ["data/x.csv", "a/b/x.CSV", "my tests (1).csv", "Prüfung.dat", "./x.tsv", "data\\\\x.csv"]
)
def test_files_below_a_study_are_kept(name: str) -> None:
    kept = name.removeprefix("./").replace("\\\\", "/")
    assert named_files(f'[limits.a.strength]\nfile = "{name}"\n') == [kept]


def test_data_in_a_folder_of_its_own_is_kept_and_verified(box: Path) -> None:
    import shutil

    home = box / "deeper"
    (home / "my data").mkdir(parents=True)
    shutil.move(box / "tests.csv", home / "my data" / "Prüfung 1.csv")
    text = (box / "run" / "study.toml").read_text().replace("tests.csv", "my data/Prüfung 1.csv")
    (home / "box.toml").write_text(text, encoding="utf-8")
    model = f"{box / 'model.py'}:f"
    run = uqsphere.run(uqsphere.load_study(home / "box.toml"), out=home / "run", model=model).folder
    (home / "my data" / "Prüfung 1.csv").unlink()
    assert "my data/Prüfung 1.csv" in (run / "SHA256SUMS").read_text("utf-8")
    found = verify_folder(run, model=model)
    assert (found.verdict, found.faults) == ("whole", [])
    (run / "my data").rename(home / "elsewhere")
    (run / "my data").symlink_to(home / "elsewhere")
    assert kept_data(text, run) == {}
    assert verify_folder(run, model=model).verdict == "damaged"
    (home / "my data" / "Prüfung 1.csv").write_bytes((home / "elsewhere" / "Prüfung 1.csv").read_bytes())
    with pytest.raises(FolderError, match="link"):
        uqsphere.run(uqsphere.load_study(home / "box.toml"), out=run, model=model)
