"""Whether a result folder is whole: checksums of what is stored, and some of it computed again."""

from __future__ import annotations

import contextlib
import platform
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

import uqsphere
from uqsphere.black_box import model_digest
from uqsphere.console import plain, table
from uqsphere.errors import FolderError, UsageError
from uqsphere.files import LARGEST_ARRAY, plain_files, read_whole, refuse_links
from uqsphere.results.entries import Resolved, read_resolved
from uqsphere.store import PART_END, Store, read_chunk

if TYPE_CHECKING:
    from uqsphere.runner.api import Repeated
    from uqsphere.runner.finished import Run

#: verdicts
WHOLE, DAMAGED, UNFINISHED, FICKLE = "whole", "damaged", "unfinished", "not deterministic"
_HEADLINES: Final = {
    WHOLE: "whole: everything stored is as it was written",
    DAMAGED: "DAMAGED",
    UNFINISHED: "not finished, and what is stored is whole",
    FICKLE: "as it was written; THE MODEL IS NOT DETERMINISTIC",
}
#: differences between machines or versions of packages that are no damage, relative to the study's tolerance
_SLACK: Final = 10.0


@dataclass(kw_only=True)
class Verification:
    """What was found in a result folder; it grows while the folder is looked at.

    Attributes
    ----------
    faults, notes : sentences
    files, chunks : how many files have a checksum, and how many chunks of evaluations there are
    keys : of the chunks that are whole
    repeated : chunks that were evaluated again
    fickle : those of them for which the model gives other answers each time
    results : "the same" or "different" where the results were repeated from the evaluations
    """

    folder: Path
    finished: bool
    faults: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    files: int = 0
    chunks: int = 0
    keys: list[str] = field(default_factory=list)
    repeated: list[Repeated] = field(default_factory=list)
    fickle: list[str] = field(default_factory=list)
    results: str | None = None
    services: dict[str, Verification] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """Whole, damaged, unfinished, or of a model that is not deterministic: the worst of run and services."""
        if self.faults or any(own.verdict == DAMAGED for own in self.services.values()):
            return DAMAGED
        return FICKLE if self.fickle else (WHOLE if self.finished else UNFINISHED)

    def document(self) -> dict[str, object]:
        """The same as plain values."""
        kept = {key: value for key, value in asdict(self).items() if key not in ("finished", "keys", "services")}
        nested = {"services": {name: own.document() for name, own in self.services.items()}} if self.services else {}
        return {**kept, "folder": str(self.folder), "verdict": self.verdict, **nested}


def verify_folder(folder: Path, *, chunks: int = 3, seed: int = 0, model: str | None = None) -> Verification:
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

    Raises FolderError when the folder is no result folder at all, and UsageError for a model that is not the one of
    the run.
    """
    if not folder.is_dir():
        raise FolderError(f"{folder} is not a result folder")
    refuse_links(folder)
    if not (folder / "study.resolved.json").exists() and not (folder / "results.json").exists():
        raise FolderError(f"{folder} is not a result folder")
    found = Verification(folder=folder, finished=(folder / "results.json").is_file())
    try:
        _look(found)
        if not found.finished:
            found.notes.append("the run has not finished: run the study again to go on with it")
        elif found.faults:
            found.notes.append("nothing was evaluated again, since what is stored is damaged")
        else:
            _repeat(found, chunks, seed, model)
    except FolderError as error:
        found.faults.append(str(error))
    return found


# --- checksums --------------------------------------------------------------------------------------


def _look(found: Verification) -> None:
    """Checksums of files and chunks."""
    from uqsphere.store import compare_sums, read_sums

    for path in plain_files(found.folder):
        if path.parent.name != "evaluations" or path.suffix != ".npy" or path.name.startswith("."):
            continue
        found.chunks += 1
        if read_chunk(path) is None:
            found.faults.append(f"evaluations/{path.name} is damaged: run the study again, which evaluates it anew")
        else:
            found.keys.append(path.stem.rpartition("_")[0])
    found.keys.sort()
    stored = read_sums(found.folder)
    if stored is not None:
        found.files = len(stored)
        found.faults += compare_sums(found.folder, stored)
    elif found.finished:
        found.notes.append("there are no checksums of files (SHA256SUMS): only chunks and results were looked at")


# --- once more --------------------------------------------------------------------------------------


def _repeat(found: Verification, chunks: int, seed: int, model: str | None) -> None:
    """Tables against results, results against evaluations, evaluations against the model."""
    from uqsphere.runner.api import private_folder, rehearse, stored_study
    from uqsphere.runner.finished import open_run
    from uqsphere.runner.workers import Engine
    from uqsphere.store import kept_data

    folder = found.folder
    run = open_run(folder)
    for name in run.results.services:
        found.services[name] = verify_folder(folder / "services" / name, chunks=chunks, seed=seed)
    _compare_tables(found, run)
    resolved = read_resolved(folder)
    if resolved.hash != run.results.study.hash:
        raise FolderError("results.json and study.resolved.json belong to different studies")
    if resolved.written_by != uqsphere.__version__:
        made = f"the run was made by uqsphere {resolved.written_by}, and this is {uqsphere.__version__}"
        found.notes.append(f"{made}: nothing was evaluated again")
        return
    text = read_whole(folder / "study.toml").decode("utf-8", "replace")
    with contextlib.ExitStack() as opened:
        place = Path(opened.enter_context(private_folder()))
        home, again = place / "study", place / "run"
        home.mkdir()
        study = stored_study(text, resolved.document(), home, kept_data(text, folder))
        engine = Engine(model=_reference(study.black_box, resolved, model))
        opened.callback(engine.close)
        if study.black_box and engine.model is None:
            found.notes.append(
                "nothing was evaluated again: this is a black box, and its model was not given with --model"
            )
            chunks = 0
        store = Store(folder=folder, lock=None)
        store.look()
        chosen, services = _draw(found.keys, chunks, seed), run.results.services
        rehearsal, missing = rehearse(store, study, chosen, again, engine, services)
        found.repeated = list(rehearsal.repeated)
        if engine.model is not None and not all(entry.same for entry in found.repeated):
            # once more: answers that differ from each other say nothing of the folder
            second, _ = rehearse(store, study, chosen, place / "twice", engine, services)
            digests = {entry.chunk: entry.digest for entry in second.repeated}
            found.fickle = [entry.chunk for entry in found.repeated if entry.digest != digests.get(entry.chunk)]
        if found.fickle:
            again = place / "stored"
            rehearse(store, study, frozenset(), again, engine, services)
        unused = len(set(found.keys) - rehearsal.used)
        _compare(found, run, study.model.tolerance, missing, unused, again)


def _compare_tables(found: Verification, run: Run) -> None:
    """The tables against results.json."""
    from uqsphere.results.tables import tables

    for name, text in tables(run.results).items():
        path = found.folder / "tables" / name
        if not path.is_file() or read_whole(path).decode("utf-8", "replace") != text:
            found.faults.append(f"tables/{name} is not what results.json says")


def _compare(found: Verification, run: Run, tolerance: float, missing: str | None, unused: int, again: Path) -> None:
    """Whether the run made once more in the folder `again` says the same; `missing` is what it lacked to get there."""
    manifest, moved = run.manifest, _moved(run)
    if moved:
        found.notes.append(
            f"made with another {', '.join(moved)}: answers are compared within the study's tolerance, and results are "
            "not repeated bit for bit"
        )
    for entry in found.repeated:
        if not entry.same and entry.chunk not in found.fickle:
            text = f"the evaluations {entry.chunk} come out differently, by up to {entry.difference:.2g} of a number"
            within = entry.difference < _SLACK * tolerance * bool(moved)
            (found.notes if within else found.faults).append(text + ", within the tolerance of the study" * within)
    if found.fickle:
        found.notes.append(
            "the model gives other answers to the same rows each time, so that no run of it can be repeated: say "
            "[model] stochastic = true"
        )
    if missing and (manifest.stopped_by_time or manifest.interrupted):
        who = "the time budget" if manifest.stopped_by_time else "the user"
        found.notes.append(f"{who} stopped this run, so that its results cannot be repeated from the start")
    elif missing:
        found.faults.append(f"the evaluations {missing} are missing: run the study again")
    elif not moved:
        _compare_files(found, again)
    if unused and not missing:
        found.notes.append(f"{unused} stored chunks are not used by the results")


def _moved(run: Run) -> list[str]:
    """In what the packages and the machine of a run differ from these; where in nothing, every bit must be the same."""
    from uqsphere.runner.results import versions

    now = {"system": platform.system(), "machine": platform.machine()}
    moved = [name for name, version in versions().items() if run.results.versions.get(name) != version]
    return moved + [key for key, value in now.items() if run.manifest.platform.get(key) != value]


def _compare_files(found: Verification, again: Path) -> None:
    """What the rehearsal wrote against what is stored, byte for byte."""
    found.results = "the same"
    for name in ("results.json", "samples.json", "samples.npy"):
        # a study without a rig of its own has no samples
        stored, made = (
            read_whole(path, LARGEST_ARRAY) if path.is_file() else None for path in (found.folder / name, again / name)
        )
        if stored != made:
            found.faults.append(f"{name} does not follow from the stored evaluations")
            found.results = "different"


def _reference(needed: bool, resolved: Resolved, model: str | None) -> str | None:
    """The model that was given, once it is known to be the one of the run."""
    if model is not None and not needed:
        raise UsageError("--model serves black-box studies; this run is one of an impact scene")
    if model is not None and model_digest(model) != resolved.model_digest:
        raise UsageError(f"{model} is not the model of this run, or was changed since: it was not run")
    return model


def _draw(keys: list[str], count: int, seed: int) -> frozenset[str]:
    import numpy as np

    from uqsphere.runner.expensive import COST

    whole = [key for key in keys if key != COST and not PART_END.search(key)]
    order = np.random.default_rng(seed).permutation(len(whole))
    return frozenset(whole[k] for k in order[:count])


# --- for people -------------------------------------------------------------------------------------


def verify_text(found: Verification) -> str:
    """The verdict for the terminal."""
    again = "none"
    if found.repeated:
        rows, same = sum(entry.rows for entry in found.repeated), sum(entry.same for entry in found.repeated)
        again = f"{len(found.repeated)} ({rows:,} rows), {same} of them the same to the last bit"
    looked = [
        ("files with a checksum", f"{found.files:,}"),
        ("chunks of evaluations", f"{found.chunks:,}"),
        ("chunks evaluated again", again),
        ("results repeated from the evaluations", found.results or "no"),
    ]
    headline = f"{plain(str(found.folder))}: {_HEADLINES[found.verdict]}"
    parts = [headline, "", table(("looked at", "found"), looked)]
    parts += [f"- {plain(text)}" for text in found.faults]
    parts += [f"note: {plain(text)}" for text in found.notes]
    nested = [f"\n\nservice {plain(name)}: {verify_text(own)}" for name, own in found.services.items()]
    return "".join(("\n".join(parts), *nested))
