"""The run folder: evaluations stored once, everything else recomputable from them.

Every file is written beside its place, flushed to disk and moved there in one step, so that a reader sees
the old file or the new one and nothing between.  A stored chunk carries the checksum of its content in its
name; one that does not match is not used.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import io
import json
import os
import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import uqsphere
from uqsphere.errors import AccessError, FolderError
from uqsphere.files import LARGEST_ARRAY, array_of, load_document, read_whole, refuse_links

__all__ = ["CHUNK_NAME", "Store", "open_store", "read_json", "write_atomically", "write_json"]

#: name of a stored chunk: its key and the first 16 digits of the checksum of its content
CHUNK_NAME = re.compile(r"(?P<key>[a-z0-9.-]+)_(?P<digest>[0-9a-f]{16})\.npy")
_MARK = "study.resolved.json"


def _mode() -> int:
    """Permissions of a finished file: others may read it where the user's own mask lets them."""
    mask = os.umask(0o077)
    os.umask(mask)
    return 0o644 & ~mask


#: looked at once: the mask belongs to the process, and asking for it sets it
_MODE = _mode()


@contextlib.contextmanager
def _system_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = "no space left on the device" if error.errno == errno.ENOSPC else error.strerror or str(error)
        raise AccessError(f"{path}: {reason}") from error


def write_atomically(path: Path, content: bytes | str) -> None:
    """Write a file so that it is there whole or not at all.

    Raises
    ------
    AccessError
        When the system refuses; nothing is left behind.
    """
    data = content.encode() if isinstance(content, str) else content
    with _system_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.chmod(temporary, _MODE)
            os.replace(temporary, path)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            raise


def write_json(path: Path, content: Any) -> None:
    """Write JSON with sorted layout kept as given, one trailing newline, and no NaN or infinity."""
    write_atomically(path, json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def read_json(path: Path) -> Any:
    """Read a JSON file of a result folder.

    Raises
    ------
    FolderError
        When it is missing, damaged or not JSON.
    """
    return load_document(path)


@dataclass(frozen=True, kw_only=True)
class Store:
    """An open result folder; `lock` is held as long as the process lives or until `close`."""

    folder: Path
    lock: Any

    def close(self) -> None:
        """Give the folder free."""
        self.lock.release()

    def load(self, key: str) -> npt.NDArray[np.float64] | None:
        """The stored chunk of a key, or None if there is none that is whole."""
        for path in sorted((self.folder / "evaluations").glob(f"{key}_*.npy")):
            match = CHUNK_NAME.fullmatch(path.name)
            if match is None or match["key"] != key or path.is_symlink():
                continue
            data = read_whole(path, LARGEST_ARRAY)
            if hashlib.sha256(data).hexdigest()[:16] == match["digest"]:
                with contextlib.suppress(ValueError):
                    return array_of(data)
        return None

    def save(self, key: str, values: npt.NDArray[np.float64]) -> None:
        """Store a chunk once, for good."""
        buffer = io.BytesIO()
        np.save(buffer, values, allow_pickle=False)
        data = buffer.getvalue()
        digest = hashlib.sha256(data).hexdigest()[:16]
        write_atomically(self.folder / "evaluations" / f"{key}_{digest}.npy", data)

    def forget(self) -> None:
        """Remove every stored evaluation, for a fresh start."""
        for path in (self.folder / "evaluations").glob("*.npy"):
            with _system_errors(path):
                path.unlink()


def _leftover(path: Path) -> bool:
    """Whether a file is what a run leaves that was killed before it had put its mark into the folder."""
    return path.name == ".lock" or path.name.startswith((f".{_MARK}.", ".study.toml."))


def _check_owner(folder: Path, study_hash: str, model: str | None, fresh: bool) -> None:
    """Refuse a folder with evaluations that are not those of this study and this model."""
    with _system_errors(folder):
        marked = (folder / _MARK).is_file()
        foreign = folder.is_dir() and not marked and not all(_leftover(path) for path in folder.iterdir())
    if foreign:
        raise FolderError(f"{folder} exists and is not a result folder: choose another with --out")
    if not marked:
        return
    found = read_json(folder / _MARK)
    if not isinstance(found, dict) or found.get("hash") != study_hash:
        raise FolderError(f"{folder} holds the run of another study: choose another folder with --out, or remove it")
    if found.get("model_digest") != model and not fresh:
        raise FolderError(
            f"{folder} holds evaluations of another model than the one given now, or of an earlier state of it: "
            "run with --fresh to evaluate again, or choose another folder with --out"
        )


def _written_by(folder: Path) -> str | None:
    """The version that began the run of a marked folder."""
    if not (folder / _MARK).is_file():
        return None
    return str(read_json(folder / _MARK).get("written_by", ""))


def open_store(
    folder: Path, resolved: dict[str, Any], text: str, study_hash: str, *, fresh: bool = False, model: str | None = None
) -> Store:
    """Create a result folder, or take up the one that is there.

    Parameters
    ----------
    resolved, text, study_hash : what the study means, its file as given, and the hash of its meaning.
    fresh : drop the evaluations of an earlier run of the same study.
    model : what tells one black box from another (a digest of its source); None for the impact model.

    Raises
    ------
    FolderError
        When the folder belongs to another study, to nobody's run, or to a process that is at work on it.
    AccessError
        When the system refuses to create or write it.
    """
    from filelock import FileLock, Timeout

    with _system_errors(folder):
        occupied = folder.exists() and not folder.is_dir()
    if occupied:
        raise FolderError(f"{folder} is not a folder")
    refuse_links(folder)
    _check_owner(folder, study_hash, model, fresh)
    with _system_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / ".lock", timeout=0)
    with _system_errors(folder):
        try:
            lock.acquire()
        except Timeout as error:  # an OSError itself, so it must not get to the outer block
            raise FolderError(f"{folder} is locked: another run is at work on it") from error
    store = Store(folder=folder, lock=lock)
    try:
        # once more, now that nobody else can change it
        _check_owner(folder, study_hash, model, fresh)
        if fresh or _written_by(folder) not in (None, uqsphere.__version__):
            # what another version computed is not mixed with what this one will
            store.forget()
        mark = {"hash": study_hash, "written_by": uqsphere.__version__, **resolved}
        write_json(folder / _MARK, mark if model is None else {**mark, "model_digest": model})
        write_atomically(folder / "study.toml", text)
    except BaseException:
        store.close()
        raise
    return store
