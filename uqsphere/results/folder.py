"""A result folder: few files, written whole or not at all, with checksums; nothing in it is
followed or run.

It has one owner, the first line of its checksums: the scene of a study, whose run and history may
stand side by side, or the command that wrote it and its input.  What has another owner is not
written over.
"""

import contextlib
import datetime
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

from filelock import FileLock, Timeout

from uqsphere.errors import AccessError, FolderError, UqsphereError, as_text
from uqsphere.files import read_given

from .types import Results

SUMS = "SHA256SUMS"
RESULTS = "results.json"
#: files without a checksum
UNLISTED = {SUMS, ".lock", "log.txt", "cache.sqlite", "cache.sqlite-journal"}
#: files that a run may have written; another folder is not written into
OWN = UNLISTED | {
    "study.toml",
    "files",
    RESULTS,
    "answers.csv",
    "samples.csv",
    "report.html",
    "figures",
    "history.csv",
    "gauges.csv",
}
#: what `uqsphere history` may have written beside a run
HISTORY = {
    "history.csv",
    "gauges.csv",
    *(f"figures/{name}.svg" for name in ("forces", "pressures", "gauges", "xt")),
}
#: what a folder begins with in which files wait until all are written
PART = ".part-"
#: what the line of checksums begins with that has the owner, and `Study.scene`, which owns runs and
#: histories
_OWNER, _SCENE = "# ", "scene "
#: what the owner of a sweep begins with
_SWEEP = "uqsphere sweep,"
_AGAIN = "Run the study again with --fresh"
#: bytes of a results.json that is read
LARGEST = 64 << 20


@contextlib.contextmanager
def _accessing(path: Path) -> Iterator[None]:
    """Raise AccessError where the system refuses what is done with a path."""
    try:
        yield
    except OSError as error:
        raise AccessError(f"{as_text(path)}: {error.strerror or error}") from error


def owner_by_command(command: str, file: Path) -> str:
    """The owner of what a command, or the commands of a lab, write of an input file, which is told
    by its name: a project may be moved.
    """
    return as_text(f"uqsphere {command}, {file.resolve().name}")


def owner_of(folder: Path) -> str:
    """The owner of a folder; empty where nothing was written there."""
    return _listed(folder).get("", "").removeprefix(_OWNER)


def check_kind(folder: Path, owner: str) -> None:
    """Raise FolderError where another command has written into a folder, or it is none; scenes are
    told apart by `uqsphere.propagation.check_owner`.
    """
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise FolderError(f"{as_text(folder)} is not a directory. Choose another with --out")
    before = owner_of(folder)
    if not before and (folder / RESULTS).exists():
        before = _SCENE
    if before in ("", owner) or (before.startswith(_SCENE) and owner.startswith(_SCENE)):
        return
    held = f"results of {before}"
    if before.startswith(_SCENE):
        held = "a run" if (folder / RESULTS).exists() else "a history"
    raise FolderError(f"{as_text(folder)} holds {held}. Choose another directory with --out")


@contextlib.contextmanager
def locked(folder: Path, owner: str) -> Iterator[None]:
    """The folder, made if it is new and locked against another command.

    Raises FolderError where another command owns or has it, or a run or history would stand beside
        files of the user's; AccessError where the system refuses.
    """
    with _accessing(folder):
        check_kind(folder, owner)
        folder.mkdir(parents=True, exist_ok=True)
        found = {name for name in os.listdir(folder) if not name.startswith(PART)}
        # a study or a page of the user's own may have the name of ours
        strange = found - (UNLISTED if found.isdisjoint((SUMS, RESULTS)) else OWN)
        if strange and owner.startswith(_SCENE):
            raise FolderError(
                f"{as_text(folder)} contains {min(strange)!r}, which uqsphere did not write. "
                "Choose another directory with --out"
            )
        lock = FileLock(folder / ".lock", timeout=0)
        try:
            lock.acquire()
        except Timeout:
            raise FolderError(f"{as_text(folder)} is in use by another run") from None
    try:
        if owner.startswith(_SCENE):
            for left in folder.glob(f"{PART}*"):  # of a run that was killed
                shutil.rmtree(left, ignore_errors=True)
        yield
    finally:
        with contextlib.suppress(OSError):
            (folder / ".lock").unlink()
        lock.release()


def write_files(folder: Path, files: Mapping[str, str | bytes], owner: str = "") -> None:
    """Write files whole: all of them beside their places first, then moved there; the checksums are
    the first, so that what a killed process has moved is known to be its own.  With a run or a
    history, files of the one before that are not written again are removed.

    owner : whose the folder is from now on (default: the one before)

    Raises FolderError where a file was not written here, or the folder is another command's;
    AccessError where the system refuses (a full disk, no permission); the files before are then
    unchanged.
    """
    before = sums_of(folder)
    stale = set[str]()
    if owner:
        check_kind(folder, owner)
    owner = owner or owner_of(folder)
    if RESULTS in files:
        stale = before.keys() - HISTORY
    elif not HISTORY.isdisjoint(files):
        stale = before.keys() & HISTORY
    sums = {name: digest for name, digest in before.items() if name not in stale}
    contents = {
        name: text.encode() if isinstance(text, str) else text for name, text in files.items()
    }
    sums |= {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()}
    for name in contents.keys() - before.keys():
        if os.path.lexists(folder / name):
            raise FolderError(
                f"{as_text(folder / name)} exists, and uqsphere did not write it. Move it, or "
                "choose another directory with --out"
            )
    listed = f"{_OWNER}{owner}\n" if owner else ""
    listed += "".join(f"{digest}  {name}\n" for name, digest in sorted(sums.items()))
    contents = {SUMS: listed.encode(), **contents}
    with _accessing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(
            dir=folder, prefix=PART, ignore_cleanup_errors=True
        ) as part:
            for number, (name, content) in enumerate(contents.items()):
                parents = [path for path in (folder / name).parents if folder in path.parents]
                for link in filter(Path.is_symlink, parents):
                    raise FolderError(
                        f"{as_text(link)} is a link, which is not followed. Remove it"
                    )
                Path(part, f"{number}").write_bytes(content)
            for number, name in enumerate(contents):
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                os.replace(Path(part, f"{number}"), folder / name)
            for name in before.keys() - sums.keys():
                if _is_inside(folder, name):
                    (folder / name).unlink()


def _is_inside(folder: Path, name: str) -> bool:
    """Whether a name is that of a plain file in a folder, without links on the way."""
    path = folder / name
    plain = path.is_file() and not path.is_symlink()
    return plain and folder.resolve() in path.resolve().parents


def read_checked(folder: Path, name: str) -> bytes:
    """A file of a results directory, as it was written.

    Raises FolderError where there is none or its checksum differs, AccessError where it cannot be
    read.
    """
    path = folder / name
    with _accessing(path):
        if not _is_inside(folder, name):
            raise FolderError(f"{as_text(folder)} does not contain {name}")
        content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != sums_of(folder).get(name):
        raise FolderError(f"{as_text(path)} is not as it was written. {_AGAIN}")
    return content


def sums_of(folder: Path) -> dict[str, str]:
    """Checksums by file; none where there is no such list."""
    return {name: digest for name, digest in _listed(folder).items() if name}


def _listed(folder: Path) -> dict[str, str]:
    """Checksums by file, and without a name the line of the owner."""
    sums = {}
    with contextlib.suppress(UqsphereError, ValueError):
        for line in read_given(folder / SUMS, LARGEST).decode().splitlines():
            digest, _, name = line.partition("  ")
            sums[name] = digest
    return sums


def clear(folder: Path) -> None:
    """Remove what an earlier run left, its cache too."""
    for name in OWN - {".lock"}:
        path = folder / name
        if path.is_symlink() or path.is_file():
            path.unlink()
        elif path.is_dir():
            shutil.rmtree(path)


def read_results(folder: Path) -> Results:
    """The results.json of a folder.

    Raises FolderError where there is none, or it is damaged or of another schema; AccessError where
        it cannot be read.
    """
    path = folder / RESULTS
    if path.is_file() and path.stat().st_size > LARGEST:
        raise FolderError(f"{as_text(path)} is larger than any run writes")
    content = read_checked(folder, RESULTS)
    try:
        return Results.model_validate_json(content)
    except ValueError:
        known = Results.model_fields["schema_version"].default
        raise FolderError(
            f"{as_text(path)} is of another version: {_writer(content)}, and schema {known} is "
            f"read here. {_AGAIN}, or open it with the version that wrote it"
        ) from None


def _writer(content: bytes) -> str:
    """What wrote a results.json that cannot be read here, as far as it says."""
    try:
        written = json.loads(content)
        version = as_text(written["versions"]["uqsphere"], 40)
        return f"uqsphere {version} wrote schema {as_text(written['schema_version'], 40)}"
    except (LookupError, TypeError, ValueError):
        return "it does not say what wrote it"


def damaged_files(folder: Path) -> list[str]:
    """Files whose checksum differs from `SHA256SUMS`, that are missing, cannot be read, or have
    none; empty where the folder is whole.  Of a sweep, those of its points too.

    The log and the cache of answers have no checksum here, nor what may stand beside the files of a
    lab.  Raises FolderError without checksums.
    """
    sums = sums_of(folder)
    if not sums:
        raise FolderError(
            f"{as_text(folder)} does not contain {SUMS}: it is not a results directory, or an "
            "unfinished one"
        )
    wrong = []
    for name in sums:
        try:
            read_checked(folder, name)
        except FolderError:
            wrong.append(as_text(name))
        except AccessError as error:
            wrong.append(str(error))
    owner = owner_of(folder)
    if owner.startswith(_SWEEP):
        for path in sorted(folder.glob(f"*/{SUMS}")):
            wrong += [f"{path.parent.name}/{name}" for name in damaged_files(path.parent)]
    if owner and not owner.startswith(_SCENE):
        return wrong
    with _accessing(folder):
        for path in sorted(folder.rglob("*")):
            name = path.relative_to(folder).as_posix()
            if not path.is_dir() and name not in sums.keys() | UNLISTED:
                wrong.append(f"{as_text(name)} (has no checksum)")
    return wrong


def write_log(folder: Path | None, text: str) -> None:
    """Add a line to the log of a run with the time (UTC); nothing without a folder, or where a link
    or no plain file stands in its place.  A log that cannot be written stops nothing.
    """
    if not folder:
        return
    path = folder / "log.txt"
    if path.is_symlink() or (path.exists() and not path.is_file()):
        return
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
    with contextlib.suppress(OSError), path.open("a", encoding="utf-8") as stream:
        stream.write(f"{now} {' '.join(text.split())}\n")
