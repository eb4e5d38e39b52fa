"""Whether a result folder is whole: checksums of what is stored, and some of it computed again."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import uqsphere
from uqsphere.console import plain, table
from uqsphere.errors import FolderError, UsageError
from uqsphere.files import LARGEST_ARRAY, chunk_of, plain_files, read_whole, refuse_links
from uqsphere.results import Results
from uqsphere.results.entries import Resolved, read_resolved
from uqsphere.store import CHUNK_NAME, PART_END, Store

if TYPE_CHECKING:
    from uqsphere.runner.rehearsal import Repeated

__all__ = ["verify_folder", "verify_text"]

#: verdicts
WHOLE, DAMAGED, UNFINISHED = "whole", "damaged", "unfinished"
#: differences between machines or versions of packages that are no damage, relative to the study's tolerance
_SLACK: Final = 10.0


def verify_folder(folder: Path, *, chunks: int = 3, seed: int = 0, model: str | None = None) -> dict[str, Any]:
    """Look at everything that is stored; nothing in the folder is changed.

    1. Every file against SHA256SUMS, every chunk against the checksum in its name, tables against results.json.
    2. The run is repeated from its chunks, `chunks` of which, drawn by `seed`, are evaluated again; results,
       tables and samples must come out as stored.

    Parameters
    ----------
    folder : result folder
    chunks : how many stored chunks to evaluate again.
    seed : which ones.
    model : "FILE.py:FUNCTION" of a black-box study; without it nothing of such a study is evaluated again.

    Returns
    -------
    dict
        `verdict` (whole, damaged, unfinished), `faults` and `notes` in sentences, counts, and `repeated`.

    Raises
    ------
    FolderError
        When the folder is no result folder at all.
    UsageError
        For a model that is not the one of the run.
    """
    if not folder.is_dir():
        raise FolderError(f"{folder} is not a result folder")
    refuse_links(folder)
    if not (folder / "study.resolved.json").exists() and not (folder / "results.json").exists():
        raise FolderError(f"{folder} is not a result folder")
    faults: list[str] = []
    notes: list[str] = []
    counts = _look(folder, faults, notes)
    finished = (folder / "results.json").is_file()
    found: dict[str, Any] = {"folder": str(folder), "verdict": WHOLE, **counts, "repeated": [], "results": None}
    if not finished:
        notes.append("the run has not finished: run the study again to go on with it")
    elif not faults:
        from uqsphere.runner.rehearsal import private_folder

        with private_folder() as place:
            try:
                _repeat(folder, Path(place), found, faults, notes, (chunks, seed, model))
            except FolderError as error:
                faults.append(str(error))
    else:
        notes.append("nothing was evaluated again, since what is stored is damaged")
    found |= {"faults": faults, "notes": notes}
    found["verdict"] = DAMAGED if faults else (WHOLE if finished else UNFINISHED)
    found.pop("keys")
    return found


# --- checksums --------------------------------------------------------------------------------------


def _look(folder: Path, faults: list[str], notes: list[str]) -> dict[str, Any]:
    """Checksums of files and chunks; the counts, and the keys of the chunks that are whole."""
    from uqsphere.runner.sums import compare_sums, read_sums

    sums: dict[str, str] = {}
    keys: list[str] = []
    chunks = 0
    try:
        for path in plain_files(folder):
            if path.parent.name != "evaluations" or path.suffix != ".npy" or path.name.startswith("."):
                continue
            chunks += 1
            key = _whole_chunk(path)
            if key is None:
                faults.append(f"evaluations/{path.name} is damaged: run the study again, which evaluates it anew")
            else:
                keys.append(key)
        stored = read_sums(folder)
        if stored is not None:
            sums = stored
            faults += compare_sums(folder, sums)
        elif (folder / "results.json").is_file():
            notes.append("there are no checksums of files (SHA256SUMS): only chunks and results were looked at")
    except FolderError as error:
        faults.append(str(error))
    return {"files": len(sums), "chunks": chunks, "keys": sorted(keys)}


def _whole_chunk(path: Path) -> str | None:
    """The key of a chunk whose content matches its name."""
    match = CHUNK_NAME.fullmatch(path.name)
    if match is None:
        return None
    data = read_whole(path, LARGEST_ARRAY)
    if hashlib.sha256(data).hexdigest()[:16] != match["digest"]:
        return None
    try:
        chunk_of(data)
    except ValueError:
        return None
    return match["key"]


# --- once more --------------------------------------------------------------------------------------


def _repeat(
    folder: Path, place: Path, found: dict[str, Any], faults: list[str], notes: list[str], asked: tuple[int, int, Any]
) -> None:
    """Tables against results, results against evaluations, evaluations against the model."""
    from uqsphere.results.tables import tables
    from uqsphere.runner.datafiles import kept_data
    from uqsphere.runner.finished import open_run
    from uqsphere.runner.rehearsal import rehearse, stored_study

    run = open_run(folder)
    for name, text in tables(run.results).items():
        path = folder / "tables" / name
        if not path.is_file() or read_whole(path).decode("utf-8", "replace") != text:
            faults.append(f"tables/{name} is not what results.json says")
    resolved = _resolved(folder, run.results)
    text = read_whole(folder / "study.toml").decode("utf-8", "replace")
    study_place, run_place = place / "study", place / "run"
    study_place.mkdir()
    run_place.mkdir()
    study = stored_study(text, resolved.document(), study_place, kept_data(text, folder))
    if resolved.written_by != uqsphere.__version__:
        notes.append(
            f"the run was made by uqsphere {resolved.written_by}, and this is {uqsphere.__version__}: "
            "nothing was evaluated again"
        )
        return
    chunks, seed, model = asked
    box = _black_box(study.black_box, resolved, model)
    if study.black_box and box is None:
        notes.append("nothing was evaluated again: this is a black box, and its model was not given with --model")
        chunks = 0
    chosen = _draw(found["keys"], chunks, seed)
    store = Store(folder=folder, lock=None)
    store.look()
    rehearsal, missing = rehearse(store, study, chosen, run_place, box)
    found["repeated"] = [asdict(entry) for entry in rehearsal.repeated]
    same_place = _same_place(run, notes)
    for entry in rehearsal.repeated:
        _judge(entry, same_place, study.model.tolerance, faults, notes)
    if missing and (run.manifest.stopped_by_time or run.manifest.interrupted):
        who = "the time budget" if run.manifest.stopped_by_time else "the user"
        notes.append(f"{who} stopped this run, so that its results cannot be repeated from the start")
    elif missing:
        faults.append(f"the evaluations {missing} are missing: run the study again")
    elif same_place:
        _compare_files(folder, run_place, found, faults)
    unused = len(set(found["keys"]) - rehearsal.used)
    if unused and not missing:
        notes.append(f"{unused} stored chunks are not used by the results")


def _resolved(folder: Path, results: Results) -> Resolved:
    resolved = read_resolved(folder)
    if resolved.hash != results.study.hash:
        raise FolderError("results.json and study.resolved.json belong to different studies")
    return resolved


def _black_box(needed: bool, resolved: Resolved, model: str | None) -> Any:
    """The model that was given, once it is known to be the one of the run."""
    if model is None:
        return None
    if not needed:
        raise UsageError("--model serves black-box studies; this run is one of an impact scene")
    from uqsphere.model import load_black_box, model_digest

    if model_digest(model) != resolved.model_digest:
        raise UsageError(f"{model} is not the model of this run, or was changed since: it was not run")
    return load_black_box(model)


def _draw(keys: list[str], count: int, seed: int) -> frozenset[str]:
    import numpy as np

    from uqsphere.runner.price import COST

    whole = [key for key in keys if key != COST and not PART_END.search(key)]
    order = np.random.default_rng(seed).permutation(len(whole))
    return frozenset(whole[k] for k in order[:count])


def _same_place(run: Any, notes: list[str]) -> bool:
    """Whether the run was made by these packages on a machine of this kind, so that every bit must be the same."""
    from uqsphere.runner.results import versions

    now = {"system": platform.system(), "machine": platform.machine()}
    then = run.manifest.platform
    moved = [key for key, value in now.items() if then.get(key) != value]
    changed = [name for name, version in versions().items() if run.results.versions.get(name) != version]
    if moved or changed:
        notes.append(
            f"made with another {', '.join([*changed, *moved])}: answers are compared within the study's tolerance, "
            "and results are not repeated bit for bit"
        )
    return not moved and not changed


def _judge(entry: Repeated, same_place: bool, tolerance: float, faults: list[str], notes: list[str]) -> None:
    if entry.same:
        return
    text = f"the evaluations {entry.chunk} come out differently now, by up to {entry.difference:.2g} of a number"
    if not same_place and entry.difference <= _SLACK * tolerance:
        notes.append(f"{text}, within the tolerance of the study")
    else:
        faults.append(text)


def _compare_files(folder: Path, again: Path, found: dict[str, Any], faults: list[str]) -> None:
    """What the rehearsal wrote against what is stored, byte for byte."""
    before = len(faults)
    for name in ("results.json", "samples.json", "samples.npy"):
        path = folder / name
        if not path.is_file() or read_whole(path, LARGEST_ARRAY) != (again / name).read_bytes():
            faults.append(f"{name} does not follow from the stored evaluations")
    found["results"] = "the same" if len(faults) == before else "different"


# --- for people -------------------------------------------------------------------------------------


def verify_text(found: Mapping[str, Any]) -> str:
    """The verdict for the terminal."""
    headline = {
        WHOLE: "whole: everything stored is as it was written",
        DAMAGED: "DAMAGED",
        UNFINISHED: "not finished, and what is stored is whole",
    }[found["verdict"]]
    rows = [
        ("files with a checksum", f"{found['files']:,}"),
        ("chunks of evaluations", f"{found['chunks']:,}"),
        ("chunks evaluated again", _repeated(found["repeated"])),
        ("results repeated from the evaluations", found["results"] or "no"),
    ]
    parts = [f"{plain(str(found['folder']))}: {headline}", "", table(("looked at", "found"), rows)]
    parts += [f"- {plain(text)}" for text in found["faults"]]
    parts += [f"note: {plain(text)}" for text in found["notes"]]
    return "\n".join(parts)


def _repeated(entries: list[Mapping[str, Any]]) -> str:
    if not entries:
        return "none"
    rows, same = sum(entry["rows"] for entry in entries), sum(bool(entry["same"]) for entry in entries)
    return f"{len(entries)} ({rows:,} rows), {same} of them the same to the last bit"
