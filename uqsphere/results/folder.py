"""A result folder: few files, written whole or not at all, with checksums; nothing in it is followed or run."""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from filelock import FileLock, Timeout

from uqsphere.errors import AccessError, FolderError

SUMS: Final = "SHA256SUMS"
RESULTS: Final = "results.json"
#: files that a run may have written; another folder is not written into
OWN: Final = frozenset({"study.toml", RESULTS, "answers.csv", "samples.csv", "report.html", "figures", "log.txt", SUMS,
                        "cache.sqlite", "cache.sqlite-journal", ".lock", "history.csv"})  # fmt: skip
#: bytes of a results.json that is read
LARGEST: Final = 64 << 20


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """The folder, made if it is new and locked against another run.

    Raises FolderError where it is no result folder or another run has it, AccessError where the system refuses.
    """
    try:
        if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
            raise FolderError(f"{folder} is no folder: choose another one with --out")
        folder.mkdir(parents=True, exist_ok=True)
        strange = sorted(entry.name for entry in folder.iterdir() if entry.name not in OWN)
        if strange:
            raise FolderError(f"{folder} holds {strange[0]!r}, which is of no run: choose another folder with --out")
        lock = FileLock(folder / ".lock", timeout=0)
        with lock:
            yield
    except Timeout:
        raise FolderError(f"{folder} is in use by another run") from None
    except OSError as error:
        raise AccessError(f"{folder}: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            (folder / ".lock").unlink()


def write_files(folder: Path, files: Mapping[str, str | bytes]) -> None:
    """Write files whole: each beside its place first, then moved there; the checksums are the last.

    Raises AccessError where the system refuses (a full disk, no permission): what stood there before stands.
    """
    try:
        for name, content in files.items():
            _write(folder / name, content)
        names = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
        kept = [name for name in names if name not in (SUMS, ".lock", "log.txt") and not name.startswith("cache.")]
        sums = "".join(f"{hashlib.sha256((folder / name).read_bytes()).hexdigest()}  {name}\n" for name in kept)
        _write(folder / SUMS, sums)
    except OSError as error:
        raise AccessError(f"{folder}: {error.strerror or error}") from error


def _write(path: Path, content: str | bytes) -> None:
    path.parent.mkdir(exist_ok=True)
    handle, beside = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content.encode("utf-8") if isinstance(content, str) else content)
        os.chmod(beside, 0o644)
        os.replace(beside, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(beside)
        raise


def clear(folder: Path) -> None:
    """Remove what an earlier run left, its cache too."""
    for name in OWN - {".lock"}:
        path = folder / name
        if path.is_symlink() or path.is_file():
            path.unlink()
        elif path.is_dir():
            shutil.rmtree(path)


def read_results(folder: Path) -> dict[str, Any]:
    """The results.json of a folder.

    Raises FolderError where there is none, or it is damaged or of another schema; AccessError where it cannot be read.
    """
    path = folder / RESULTS
    try:
        if path.is_symlink() or not path.is_file():
            raise FolderError(f"{folder} holds no {RESULTS}: it is no result folder of this version")
        if path.stat().st_size > LARGEST:
            raise FolderError(f"{path} is larger than any run writes")
        results = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise AccessError(f"{path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise FolderError(f"{path} is damaged: {type(error).__name__}") from None
    if not isinstance(results, dict) or results.get("schema_version") != 2:
        raise FolderError(f"{path} is of another schema: run the study again")
    return results


def damaged_files(folder: Path) -> list[str]:
    """Files whose checksum differs from `SHA256SUMS`, or that are missing; empty where the folder is whole."""
    try:
        lines = (folder / SUMS).read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        raise FolderError(f"{folder} holds no {SUMS}: it is no result folder, or an unfinished one") from None
    wrong = []
    for line in lines:
        digest, _, name = line.partition("  ")
        path = folder / name
        whole = path.is_file() and not path.is_symlink() and folder.resolve() in path.resolve().parents
        if not whole or hashlib.sha256(path.read_bytes()).hexdigest() != digest:
            wrong.append(name)
    return wrong


class Log:
    """Lines of a run's log, each with its time (UTC)."""

    def __init__(self, path: Path | None) -> None:
        self.path = path

    def write(self, text: str) -> None:
        """One line; a log that cannot be written stops nothing."""
        if self.path is None:
            return
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
        with contextlib.suppress(OSError), self.path.open("a", encoding="utf-8") as stream:
            stream.write(f"{now} {' '.join(text.split())}\n")
