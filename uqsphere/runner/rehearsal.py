"""A finished run once more from its stored evaluations, with some of them evaluated again.

The run's own code is run on a store that gives out what is stored, except for the chunks that were chosen:
those are missing to it, are evaluated as the run would, and compared with what is stored.  Everything else
goes to a private folder that is gone afterwards.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, cast

import numpy as np

from uqsphere.arrays import Cells
from uqsphere.black_box import model_digest
from uqsphere.errors import FolderError, StudyError, UsageError
from uqsphere.files import Json, read_whole
from uqsphere.results import Results
from uqsphere.store import Store
from uqsphere.study import Study, load_study

if TYPE_CHECKING:
    from uqsphere.runner.workers import Engine


@dataclass(frozen=True, kw_only=True)
class Repeated:
    """A chunk that was evaluated again: `difference` is the largest one, relative to the larger of both numbers.

    `digest` tells what came out this time.
    """

    chunk: str
    rows: int
    same: bool
    difference: float
    digest: str


class Absent(Exception):
    """The run needs a chunk that is not stored whole."""


@dataclass(kw_only=True)
class Rehearsal:
    """The store of a run that is repeated: reads `source`, writes nothing there."""

    folder: Path
    source: Store
    chosen: frozenset[str]
    used: set[str] = field(default_factory=set)
    damaged: list[str] = field(default_factory=list)
    repeated: list[Repeated] = field(default_factory=list)
    #: what was used and repeated is known to this process alone
    shared: ClassVar[bool] = False

    def look(self) -> None:
        """What is stored stays as it was."""

    def load(self, key: str) -> Cells | None:
        """The stored chunk, or None for one that is to be evaluated again."""
        found = self.source.load(key)
        if found is None:
            raise Absent(key)
        self.used.add(key)
        return None if key in self.chosen else found

    def keys(self, beginning: str) -> list[str]:
        """None: a run that has finished needs no parts of a chunk."""
        return []

    def drop(self, keys: Sequence[str]) -> None:
        """Nothing is stored here, so that nothing is in the way."""

    def take_over(self) -> None:
        """The folder is the study's own."""

    def save(self, key: str, values: Cells, *, durable: bool = True) -> None:
        """Compare what was evaluated now with what is stored; a part of a chunk waits for the rest."""
        if key not in self.chosen:
            return
        stored = self.source.load(key)
        if stored is None:
            raise Absent(key)
        now = np.ascontiguousarray(values).tobytes()
        same = stored.dtype == values.dtype and stored.tobytes() == now
        difference = 0.0 if same else _difference(stored, values)
        digest = hashlib.sha256(now).hexdigest()
        self.repeated.append(Repeated(chunk=key, rows=len(stored), same=same, difference=difference, digest=digest))


def _difference(a: Cells, b: Cells) -> float:
    if a.dtype != b.dtype or a.shape != b.shape:
        return float("inf")
    if a.dtype.names is not None:
        return max(_difference(a[name].astype(float), b[name].astype(float)) for name in a.dtype.names)
    if bool((np.isnan(a) != np.isnan(b)).any()):
        return float("inf")
    scale = np.maximum(np.abs(a), np.abs(b))
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = np.where(scale > 0.0, np.abs(a - b) / scale, 0.0)
    return float(np.nanmax(relative, initial=0.0))


# --- the stored study -------------------------------------------------------------------------------


def stored_study(
    text: str, resolved: Mapping[str, Json], place: Path, data: Mapping[str, bytes] | None = None
) -> Study:
    """The study of a result folder, read from its text and from nothing else.

    Parameters
    ----------
    text, resolved : content of study.toml and of study.resolved.json.
    place : a private folder.
    data : content of the data files that are kept, by name (`uqsphere.runner.kept.kept_data`): they go there.

    Raises
    ------
    FolderError
        When the text is no study, or not the one of the resolved numbers.
    """
    path = place / "study.toml"
    path.write_text(text, encoding="utf-8")
    try:
        for name, content in (data or {}).items():
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            (place / name).write_bytes(content)
        study = load_study(path, tuple(resolved.get("overrides", ())))
    except (StudyError, UsageError, ValueError, OSError, RecursionError) as error:
        raise FolderError(f"the stored study cannot be read again: {error}") from error
    if study.hash != resolved.get("hash"):
        raise FolderError("study.toml is not the study that study.resolved.json was made from")
    return replace(study, title=str(resolved.get("title", study.title)))


# --- the run once more --------------------------------------------------------------------------------


def rehearse(
    source: Store,
    study: Study,
    chosen: frozenset[str],
    place: Path,
    engine: Engine,
    services: Mapping[str, Results] | None = None,
) -> tuple[Rehearsal, str]:
    """Repeat a run from its chunks, evaluating by `engine`, its services as they are; what it writes lies in `place`.

    Returns
    -------
    Rehearsal, str
        What was read and compared; the key of the chunk that is missing, or an empty text for a whole run.
    """
    from threadpoolctl import threadpool_limits

    from uqsphere.runner.analyse import analyse
    from uqsphere.runner.evaluate import Ledger, Work

    store = Rehearsal(folder=place, source=source, chosen=chosen)
    # a rehearsal has what an analysis asks of a store, and no more
    standing_in = cast(Store, store)
    digest = None if engine.model is None else model_digest(engine.model)
    work = Work(
        study=study,
        store=standing_in,
        ledger=Ledger(),
        fidelity="full",
        model=engine.model,
        digest=digest,
        engine=engine,
        services=services or {},
    )
    # what a run has in its folder before it begins
    place.mkdir()
    for name in ("study.toml", "study.resolved.json"):
        (place / name).write_bytes(read_whole(source.folder / name))
    try:
        with threadpool_limits(limits=1, user_api="blas"):
            analyse(work, standing_in)
    except Absent as error:
        return store, str(error)
    return store, ""


def private_folder() -> tempfile.TemporaryDirectory[str]:
    """A folder that only this user can enter, gone when it is closed."""
    return tempfile.TemporaryDirectory(prefix="uqsphere-")
