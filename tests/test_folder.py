"""A results directory is written as one, and what was changed in it is found."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

import uqsphere
from uqsphere.cli import main
from uqsphere.errors import FolderError
from uqsphere.propagation import check_owner, write
from uqsphere.report import page_files, write_page
from uqsphere.results.folder import UNLISTED, damaged_files, read_results, write_files
from uqsphere.results.types import Kind
from uqsphere.study import Study

ROUGH = {"mean": 0.1, "quantile": 0.5, "sobol": 0.5, "probability": 0.5}


def study(sd: float = 1.0) -> Study:
    return Study(
        inputs={name: {"dist": "normal", "mean": 0.0, "sd": sd} for name in "ab"},
        outputs="y",
        limits={"high": {"quantity": "y", "strength": 3.0, "target": 0.1}},
        analysis={"accuracy": ROUGH},
    )


def model(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {"y": x["a"] + 2.0 * x["b"]}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "run"
    uqsphere.run(study(), model, out=folder)
    return folder


@pytest.fixture
def folder(finished: Path, tmp_path: Path) -> Path:
    return shutil.copytree(finished, tmp_path / "run")


def content(folder: Path) -> dict[str, bytes]:
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


@pytest.mark.parametrize("kind", [KeyboardInterrupt, MemoryError])
def test_a_run_that_ends_while_its_page_is_drawn_leaves_the_one_before(
    folder: Path, monkeypatch: pytest.MonkeyPatch, kind: type[BaseException]
) -> None:
    """New results beside an old page would pass for one run."""
    before = content(folder)

    def ended(*_: object) -> dict[str, str]:
        raise kind

    monkeypatch.setattr("uqsphere.report.page_files", ended)
    with pytest.raises(kind):
        uqsphere.run(study(), model, out=folder)
    after = content(folder)
    assert damaged_files(folder) == []
    if kind is KeyboardInterrupt:
        changed = {name for name in before if before[name] != after.get(name)}
        assert changed <= {"log.txt", "cache.sqlite"}
    else:  # a fault of a figure costs no results, and no page of another run stands beside them
        assert "report.html" not in after
        assert not [name for name in after if name.startswith("figures/")]


def test_a_run_leaves_no_file_of_the_run_before(folder: Path) -> None:
    write_files(folder, {"figures/density-9.svg": "<svg/>"})
    assert damaged_files(folder) == []
    uqsphere.run(study(), model, out=folder)
    assert not (folder / "figures" / "density-9.svg").exists()
    assert damaged_files(folder) == []
    write_page(folder)
    assert damaged_files(folder) == []


def test_what_history_wrote_stays_beside_a_run(folder: Path) -> None:
    history = {"history.csv": "t\n0\n", "gauges.csv": "t\n0\n", "figures/forces.svg": "<svg/>"}
    write_files(folder, history)
    uqsphere.run(study(), model, out=folder)
    assert history.keys() <= content(folder).keys()
    assert damaged_files(folder) == []


def test_history_and_labs_write_into_no_folder_of_another_study(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = Path(__file__).parents[1]
    folder = tmp_path / "run"
    shutil.copytree(root / "reports" / "granite", folder)
    before = content(folder)
    assert (
        main(["history", str(root / "studies" / "quartz_load_cell.toml"), "--out", str(folder)])
        == 5
    )
    told = capsys.readouterr()
    assert "one impact" in told.out
    assert "holds another study (changed: " in told.err
    fit = str(root / "studies" / "lab_limestone_feed.toml")
    assert main(["comminution", "fit", fit, "--out", str(folder)]) == 5
    told = capsys.readouterr()
    assert "breaks half" in told.out
    assert "holds a run. Choose another directory with --out" in told.err
    assert content(folder) == before


@pytest.mark.parametrize("owner", ["scene 0", "uqsphere shpb, a/b.toml", "uqsphere sweep, b"])
@pytest.mark.parametrize(
    ("command", "file"),
    [
        ("run", "granite.toml"),
        ("run --fresh", "granite.toml"),
        ("history", "granite.toml"),
        ("sweep --over sphere.radius=9mm", "granite.toml"),
        ("shpb records", "lab_gauge_records.toml"),
        ("comminution fit", "lab_limestone_feed.toml"),
    ],
)
def test_no_command_writes_where_another_has_written(
    owner: str, command: str, file: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A history may be replaced by a run, if it is asked."""
    history = owner.startswith("scene")
    if history and "--fresh" in command:
        return
    name = "history.csv" if history else "draws.csv"
    write_files(tmp_path, {name: "t\n0\n"}, owner)
    before = content(tmp_path)
    study = Path(__file__).parents[1] / "studies" / file
    assert main([*command.split(), str(study), "--out", str(tmp_path)]) == 5
    told = capsys.readouterr().err
    held = "history" if history else f"results of {owner}"
    assert f"{tmp_path} holds " in told
    assert held in told
    assert "with --out" in told
    assert content(tmp_path) == before


def test_run_and_history_of_one_scene_share_a_folder(tmp_path: Path) -> None:
    """Whatever else of the study differs; a lab may write again, and beside the user's files."""
    studies = Path(__file__).parents[1] / "studies"
    here = ["--out", str(tmp_path / "out")]
    granite = str(studies / "granite.toml")
    shutil.copytree(studies.parent / "reports" / "granite", tmp_path / "out")
    assert main(["history", granite, *here, "--set", "seed=1", "--set", "sphere.E.cov=0.1"]) == 0
    assert damaged_files(tmp_path / "out") == []
    assert {"history.csv", "results.json"} <= content(tmp_path / "out").keys()
    assert main(["history", granite, *here, "--set", "sphere.radius=9 mm"]) == 5
    # as an earlier version wrote it
    sums = tmp_path / "out" / "SHA256SUMS"
    sums.write_text(sums.read_text().partition("\n")[2])
    assert main(["report", str(tmp_path / "out")]) == 0
    (tmp_path / "out" / "results.json").unlink()
    check_owner(tmp_path / "out", uqsphere.load_study(granite, ["seed=2"]))
    (tmp_path / ".part-mine").mkdir(parents=True)
    for _ in range(2):
        records = str(studies / "lab_gauge_records.toml")
        assert main(["shpb", "records", records, "--out", str(tmp_path)]) == 0
    assert (tmp_path / ".part-mine").is_dir()


def test_every_change_of_a_folder_is_found(folder: Path) -> None:
    names = [name for name in content(folder) if name not in UNLISTED]
    assert len(names) > 6
    sums = (folder / "SHA256SUMS").read_text()
    for name in names:
        (folder / name).write_bytes(b"x" + (folder / name).read_bytes())
        assert damaged_files(folder) == [name]
        # with its line taken out as well
        lines = [line for line in sums.splitlines() if not line.endswith(f"  {name}")]
        (folder / "SHA256SUMS").write_text("\n".join(lines) + "\n")
        assert damaged_files(folder) == [f"{name} (has no checksum)"]
        (folder / "SHA256SUMS").write_text(sums)
        (folder / name).write_bytes((folder / name).read_bytes()[1:])
        assert damaged_files(folder) == []
    (folder / "figures" / "more.svg").write_text("<svg/>")
    assert damaged_files(folder) == ["figures/more.svg (has no checksum)"]


@pytest.mark.parametrize("kind", ["directory", "pipe", "link", "loop", "missing"])
def test_what_stands_in_the_place_of_a_file_is_found(
    folder: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = folder / "answers.csv"
    path.unlink()
    if kind == "directory":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind != "missing":
        path.symlink_to(path.name if kind == "loop" else "nowhere")
    assert damaged_files(folder) == ["answers.csv"]
    assert main(["verify", str(folder)]) == 5
    assert "damaged or missing: answers.csv" in capsys.readouterr().err


def test_a_file_that_cannot_be_read_is_listed(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    read = Path.read_bytes

    def refusing(path: Path) -> bytes:
        if path.name == "answers.csv":
            raise PermissionError(13, "Permission denied")
        return read(path)

    monkeypatch.setattr(Path, "read_bytes", refusing)
    (folder / "figures" / "more.svg").touch()
    assert main(["verify", str(folder)]) == 5
    told = capsys.readouterr().err
    assert f"missing: {folder / 'answers.csv'}: Permission denied, figures/more.svg (has" in told


def test_a_pipe_in_the_place_of_the_checksums_is_not_waited_for(folder: Path) -> None:
    (folder / "SHA256SUMS").unlink()
    os.mkfifo(folder / "SHA256SUMS")
    with pytest.raises(FolderError, match="does not contain SHA256SUMS"):
        damaged_files(folder)


def test_names_in_the_checksums_are_printed_without_control_characters(folder: Path) -> None:
    with (folder / "SHA256SUMS").open("a") as sums:
        sums.write("0  \x1b[2J\0\n")
    assert damaged_files(folder) == ["?[2J?"]


@pytest.mark.parametrize("name", ["study.toml", "report.html"])
def test_a_file_of_the_user_with_the_name_of_ours_stays(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also with --fresh, which removes what an earlier run left."""
    (tmp_path / name).write_text("mine")
    with pytest.raises(FolderError, match=f"contains '{name}', which uqsphere did not write"):
        uqsphere.run(study(), model, out=tmp_path, fresh=True)
    assert content(tmp_path) == {name: b"mine"}
    with pytest.raises(FolderError, match=f"{name} exists, and uqsphere did not write it"):
        write_files(tmp_path, {name: "ours"})
    assert content(tmp_path) == {name: b"mine"}


def test_what_a_killed_process_has_moved_is_written_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = {"report.html": "a page", "study.toml": "a study"}
    moved = []
    move = os.replace

    def killed(source: Path, place: Path) -> None:
        if len(moved) == 2:
            raise KeyboardInterrupt
        moved.append(place)
        move(source, place)

    monkeypatch.setattr(os, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        write_files(tmp_path, files)
    monkeypatch.setattr(os, "replace", move)
    assert len(content(tmp_path)) == 2
    write_files(tmp_path, files)
    assert damaged_files(tmp_path) == []


def test_samples_are_read_as_they_were_written(folder: Path) -> None:
    assert len(uqsphere.open_run(folder).samples) > 100
    text = (folder / "samples.csv").read_text()
    (folder / "samples.csv").write_text(text.replace("1", "2", 1))
    with pytest.raises(FolderError, match=r"samples\.csv is not as it was written"):
        _ = uqsphere.open_run(folder).samples
    (folder / "samples.csv").unlink()
    with pytest.raises(FolderError, match=r"does not contain samples\.csv"):
        _ = uqsphere.open_run(folder).samples


def test_another_processor_computes_the_same_but_for_rounding(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder.parent / "m.py").write_text(
        "def f(x):\n    return {'y': (1 + 1e-13) * (x['a'] + 2 * x['b'])}\n"
    )
    command = ["verify", str(folder), "--again", "--model", f"{folder.parent / 'm.py'}:f"]
    assert main(command) == 0
    assert "the answers are the same" in capsys.readouterr().out
    (folder.parent / "m.py").write_text(
        "def f(x):\n    return {'y': (1 + 1e-6) * (x['a'] + 2 * x['b'])}\n"
    )
    assert main(command) == FolderError.exit_code
    assert "the answers differ" in capsys.readouterr().err


def test_an_answer_that_appears_is_a_difference(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stored = read_results(folder)
    answers = [row for row in stored.answers if row.answer != Kind.DRIVER]
    fewer = stored.model_copy(update={"answers": answers})
    kept = {name: data for name, data in content(folder).items() if name not in UNLISTED}
    write_files(folder, kept | {"results.json": fewer.to_json()})
    (folder.parent / "m.py").write_text("def f(x):\n    return {'y': x['a'] + 2 * x['b']}\n")
    command = ["verify", str(folder), "--again", "--model", f"{folder.parent / 'm.py'}:f"]
    assert main(command) == FolderError.exit_code
    assert "not in both runs: limits.high, driver" in capsys.readouterr().err


def test_the_page_is_drawn_from_results_alone(folder: Path) -> None:
    files = page_files(read_results(folder), ["answers.csv"])
    assert "report.html" in files
    assert 'href="answers.csv"' in files["report.html"]
    assert 'href="samples.csv"' not in files["report.html"]
    assert write.write_files is write_files


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"schema_version": 3}, "uqsphere {} wrote schema 3, and schema 4 is read here"),
        ({"schema_version": 3, "versions": None}, "it does not say what wrote it"),
    ],
)
def test_results_of_an_earlier_schema_say_what_wrote_them(
    folder: Path, change: dict[str, object], says: str
) -> None:
    before = json.loads((folder / "results.json").read_text()) | change
    kept = {name: data for name, data in content(folder).items() if name not in UNLISTED}
    write_files(folder, kept | {"results.json": json.dumps(before)})
    for reads in (uqsphere.open_run, lambda place: uqsphere.run(study(), model, out=place)):
        with pytest.raises(FolderError, match=says.format(uqsphere.__version__)) as caught:
            reads(folder)
        assert "Run the study again with --fresh" in str(caught.value)
    assert uqsphere.run(study(), model, out=folder, fresh=True).decisions
