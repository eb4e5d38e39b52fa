"""The run folder: evaluations stored once, everything else recomputable from them.

Every file is written beside its place, flushed to disk and moved there in one step, so that a reader sees
the old file or the new one and nothing between.  A stored chunk carries the checksum of its content in its
name; one that does not match is not used.  The folder keeps the data files that the study names, so that it can be run
again there, and SHA256SUMS, the checksums of what a run has written, in the format that `sha256sum -c` reads.
"""

from __future__ import annotations

import contextlib
import csv
import errno
import hashlib
import io
import json
import os
import re
import tempfile
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np

import uqsphere
from uqsphere.arrays import Cells
from uqsphere.errors import AccessError, FolderError, UqsphereError
from uqsphere.files import (
    FOLDERS,
    LARGEST_ARRAY,
    Json,
    chunk_of,
    digest_of,
    is_device_name,
    load_document,
    read_given,
    read_whole,
    refuse_links,
)

if TYPE_CHECKING:
    from filelock import FileLock

    from uqsphere.study import Study

#: name of a stored chunk: its key and the first 16 digits of the checksum of its content
CHUNK_NAME = re.compile(r"(?P<key>[a-z0-9.-]+)_(?P<digest>[0-9a-f]{16})\.npy")
#: how the key of a part of a chunk ends: its first row, and the one after its last
PART_END = re.compile(r"\.p(\d+)-(\d+)$")
#: what a killed process leaves of a file it was writing
_HALF = re.compile(r"\.(?:[\w.-]+\.(?:npy|json|csv|toml|svg|html|pdf)|SHA256SUMS)\.[a-z0-9_]{8}")
#: what a formula begins with, wide forms included
_FORMULA = "=+-@\t\r\n＝＋－＠"
_MARK = "study.resolved.json"
#: list of the files that commands have written into a folder of the user's
_WRITTEN = ".uqsphere-files"
#: says why a study cannot extend the one that a folder holds, from what both mean; empty if it can
Extension = Callable[[dict[str, Json], dict[str, Json]], str]


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


def write_atomically(path: Path, content: bytes | str, *, durable: bool = True) -> None:
    """Write a file so that it is there whole or not at all.

    durable : wait until it is on the disk, so that it outlasts the machine and not only the process.

    Raises AccessError when the system refuses; nothing is left behind.
    """
    data = content.encode() if isinstance(content, str) else content
    with _system_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                if durable:
                    os.fsync(file.fileno())
            os.chmod(temporary, _MODE)
            os.replace(temporary, path)
            if durable:
                _sync_folder(path.parent)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            raise


def _sync_folder(folder: Path) -> None:
    """Have the names in a folder on disk too, where the system knows how."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # a file system that cannot
            raise
    finally:
        os.close(handle)


def write_json(path: Path, content: Json) -> None:
    """Write JSON with sorted layout kept as given, one trailing newline, and no NaN or infinity."""
    write_atomically(path, json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def write_outputs(folder: Path, files: Mapping[str, bytes | str]) -> list[Path]:
    """Write what a command was asked for into a folder of the user's; the paths written.

    A file that is there already is replaced where it is as an earlier command wrote it, which a list of checksums in
    the folder tells: what somebody else wrote, or has changed since, is not lost.

    Raises FolderError where a link or such a file is in the way; nothing is written then; AccessError when the system
    refuses.
    """
    contents = {name: text.encode() if isinstance(text, str) else text for name, text in files.items()}
    digests = {name: hashlib.sha256(data).hexdigest() for name, data in contents.items()}
    if folder.is_symlink():
        raise FolderError(f"{folder} is a link: name the folder itself with --out")
    known = _written(folder)
    for name, digest in digests.items():
        path = folder / name
        if path.is_symlink() or (path.exists() and digest_of(path) not in (digest, known.get(name))):
            raise FolderError(
                f"{path} is there already, and is not what a command of uqsphere wrote: remove it, or choose another "
                "place with --out"
            )
    for name, data in contents.items():
        write_atomically(folder / name, data)
    listed = sorted((known | digests).items())
    write_atomically(folder / _WRITTEN, "".join(f"{digest}  {name}\n" for name, digest in listed))
    return [folder / name for name in contents]


def _written(folder: Path) -> dict[str, str]:
    """Checksums of the files that commands have written into a folder, by name."""
    if not (folder / _WRITTEN).exists() and not (folder / _WRITTEN).is_symlink():
        return {}
    lines = read_whole(folder / _WRITTEN).decode("utf-8", "replace").splitlines()
    return {name: digest for digest, _, name in (line.partition("  ") for line in lines)}


def csv_text(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """CSV text; a text that a spreadsheet would take for a formula is quoted with an apostrophe."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow([plain_cell(name) for name in header])
    for row in rows:
        writer.writerow([_cell(value) for value in row])
    return buffer.getvalue()


def plain_cell(text: str) -> str:
    """A text that no spreadsheet takes for a formula.

    >>> plain_cell("=1+1"), plain_cell("a=1")
    ("'=1+1", 'a=1')
    """
    return "'" + text if text[:1] in _FORMULA and text else text


def _cell(value: object) -> object:
    if isinstance(value, str):
        return plain_cell(value)
    return repr(value) if isinstance(value, float) else value


def read_chunk(path: Path) -> Cells | None:
    """The array of a stored chunk; None where its content is not what its name says.

    Raises AccessError where the system refuses, or there is no such file; a place of the disk that cannot be read holds
    no chunk.
    """
    match = CHUNK_NAME.fullmatch(path.name)
    try:
        data = read_whole(path, LARGEST_ARRAY)
    except AccessError as error:
        if not isinstance(error.__cause__, OSError) or error.__cause__.errno != errno.EIO:
            raise
        return None
    if match is not None and hashlib.sha256(data).hexdigest()[:16] == match["digest"]:
        with contextlib.suppress(ValueError):
            return chunk_of(data)
    return None


@dataclass(frozen=True, kw_only=True)
class Store:
    """An open result folder; `lock` is held as long as the process lives or until `close`.

    `damaged` names the chunks that were found and could not be used; `mark` is what has to be written into the folder
    before it is that of the study which extends another.
    """

    folder: Path
    lock: Json
    damaged: list[str] = field(default_factory=list)
    mark: dict[str, Json] = field(default_factory=dict)
    index: dict[str, list[str]] = field(default_factory=dict)
    #: whether another process can store here what is seen after `look`
    shared: ClassVar[bool] = True

    def close(self) -> None:
        """Give the folder free."""
        self.lock.release()

    def look(self) -> None:
        """Take note of what is stored; nothing is changed."""
        self.index.clear()
        place = self.folder / "evaluations"
        with _system_errors(place):
            names = sorted(os.listdir(place)) if place.is_dir() and not place.is_symlink() else []
        for name in names:
            match = CHUNK_NAME.fullmatch(name)
            if match is not None:
                self.index.setdefault(match["key"], []).append(name)

    def take_in(self, damaged: Iterable[str]) -> None:
        """Take note of what another process has stored, and of what it found damaged."""
        self.damaged[:] = sorted({*self.damaged, *damaged})
        self.look()

    def tidy(self) -> None:
        """Remove what a killed process left half written."""
        for room in (self.folder / "evaluations", self.folder, self.folder / "tables", self.folder / "figures"):
            if not room.is_symlink() and room.is_dir():
                for path in room.glob(".*"):
                    if _HALF.fullmatch(path.name):
                        with contextlib.suppress(OSError):
                            path.unlink()

    def load(self, key: str) -> Cells | None:
        """The stored chunk of a key, or None if there is none that is whole."""
        for name in self.index.get(key, []):
            path = self.folder / "evaluations" / name
            if path.is_symlink():
                continue
            try:
                found = read_chunk(path)
            except AccessError as error:
                if isinstance(error.__cause__, FileNotFoundError):
                    continue
                raise
            if found is not None:
                return found
            if name not in self.damaged:
                self.damaged.append(name)
        return None

    def keys(self, beginning: str) -> list[str]:
        """The keys of stored chunks that begin so."""
        return [key for key in self.index if key.startswith(beginning)]

    def save(self, key: str, values: Cells, *, durable: bool = True) -> None:
        """Store a chunk once, for good; `durable` as in `write_atomically`."""
        buffer = io.BytesIO()
        np.save(buffer, values, allow_pickle=False)
        data = buffer.getvalue()
        name = f"{key}_{hashlib.sha256(data).hexdigest()[:16]}.npy"
        write_atomically(self.folder / "evaluations" / name, data, durable=durable)
        names = self.index.setdefault(key, [])
        if name not in names:
            names.append(name)

    def drop(self, keys: Sequence[str]) -> None:
        """Remove chunks whose content is stored elsewhere by now."""
        for key in keys:
            for name in self.index.pop(key, []):
                path = self.folder / "evaluations" / name
                with _system_errors(path):
                    path.unlink(missing_ok=True)

    def take_over(self) -> None:
        """Make the folder that of the study at work, where it has been that of the one it extends."""
        if self.mark:
            write_json(self.folder / _MARK, self.mark["mark"])
            write_atomically(self.folder / "study.toml", self.mark["text"])
            self.mark.clear()

    def forget(self) -> None:
        """Remove every stored evaluation, for a fresh start."""
        self.index.clear()
        for path in (self.folder / "evaluations").glob("*.npy"):
            with _system_errors(path):
                path.unlink()


def _check_extension(folder: Path, found: Json, resolved: dict[str, Json], extension: Extension | None) -> None:
    """Refuse the folder of another study unless that may be extended."""
    if extension is None or not isinstance(found, dict):
        raise FolderError(
            f"{folder} holds the run of another study: choose another folder with --out, or remove it; a study "
            "that asks more of the same inputs goes on with --extend"
        )
    if why := extension(found, resolved):
        raise FolderError(f"{folder} holds a run that this study cannot extend: {why}")
    if found.get("written_by") != uqsphere.__version__:
        raise FolderError(
            f"{folder} was written by another version, whose run cannot be extended: choose another --out"
        )


def _check_owner(
    folder: Path,
    study_hash: str,
    resolved: dict[str, Json],
    model: str | None,
    fresh: bool,
    extension: Extension | None,
) -> bool:
    """Refuse a folder whose evaluations are of no use to this study and this model; whether it is to be extended."""
    # what a run leaves that was killed before it had put its mark into the folder
    begun = (".lock", f".{_MARK}.", ".study.toml.")
    with _system_errors(folder):
        marked = (folder / _MARK).is_file()
        foreign = folder.is_dir() and not marked and not all(path.name.startswith(begun) for path in folder.iterdir())
    if foreign:
        raise FolderError(f"{folder} exists and is not a result folder: choose another with --out")
    if not marked:
        return False
    found = load_document(folder / _MARK)
    another = not isinstance(found, dict) or found.get("hash") != study_hash
    if another:
        _check_extension(folder, found, resolved, extension)
    if found.get("model_digest") != model and not fresh:
        with _system_errors(folder):  # a model that failed at its first row leaves nothing to lose
            place = folder / "evaluations"
            names = os.listdir(place) if place.is_dir() else []
            in_use = (folder / "results.json").exists() or any(map(CHUNK_NAME.fullmatch, names))
        if in_use:
            raise FolderError(
                f"{folder} holds evaluations of another model than the one given now, or of an earlier state of it: "
                "run with --fresh to evaluate again, or choose another folder with --out"
            )
    return another


def _locked(folder: Path) -> FileLock:
    """The lock of a folder, taken; FolderError where another process has it."""
    from filelock import FileLock, Timeout

    lock = FileLock(folder / ".lock", timeout=0)
    with _system_errors(folder):
        try:
            lock.acquire()
        except Timeout as error:  # an OSError itself, so it must not get to the outer block
            raise FolderError(f"{folder} is locked: another run is at work on it") from error
    return lock


def open_store(
    folder: Path,
    resolved: dict[str, Json],
    text: str,
    study_hash: str,
    *,
    fresh: bool = False,
    model: str | None = None,
    extension: Extension | None = None,
) -> Store:
    """Create a result folder, or take up the one that is there.

    Parameters
    ----------
    resolved, text, study_hash : what the study means, its file as given, and the hash of its meaning.
    fresh : drop the evaluations of an earlier run of the same study.
    model : what tells one black box from another (a digest of its source); None for the impact model.
    extension : what decides whether the study may take over the evaluations of another one that the folder holds;
        none may if None.  The folder stays that of the other study until `Store.take_over`.

    Raises FolderError when the folder belongs to another study, to nobody's run, or to a process that is at work on it;
    AccessError when the system refuses to create or write it.
    """
    with _system_errors(folder):
        occupied = folder.exists() and not folder.is_dir()
    if occupied:
        raise FolderError(f"{folder} is not a folder")
    refuse_links(folder)
    _check_owner(folder, study_hash, resolved, model, fresh, extension)
    with _system_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    store = Store(folder=folder, lock=_locked(folder))
    try:
        # once more, now that nobody else can change it
        extended = _check_owner(folder, study_hash, resolved, model, fresh, extension)
        mark = load_document(folder / _MARK) if (folder / _MARK).is_file() else None
        if fresh or (mark and mark.get("written_by") != uqsphere.__version__):
            # what another version computed is not mixed with what this one will
            store.forget()
        store.look()
        store.tidy()
        mark = {"hash": study_hash, "written_by": uqsphere.__version__, **resolved}
        store.mark.update(mark=mark if model is None else {**mark, "model_digest": model}, text=text)
        if not extended:
            store.take_over()
    except BaseException:
        store.close()
        raise
    return store


# --- data files -----------------------------------------------------------------------------------------

#: keys of a study whose value is the name of a file
_KEYS: Final = ("file", "receiving_damper")
#: a part of a path: what every system takes for a name, and a line of SHA256SUMS can hold
_PART: Final = re.compile(r"""[^\W-][^\x00-\x1f\x7f-\x9f/\\:*?"<>|]*""")
_MOST_LETTERS: Final = 200
_SUFFIXES: Final = (".csv", ".tsv", ".txt", ".dat")


def named_files(text: str) -> list[str]:
    """Data files in a study's text that lie beside it or below, each once, with /; none where the text is no study.

    A run writes files of its own into the folders of `uqsphere.files.FOLDERS`: nothing is kept there.
    """
    try:
        found = [name.replace("\\", "/") for name in _names(tomllib.loads(text)) if name[:1] != "/"]
    except (tomllib.TOMLDecodeError, RecursionError):
        return []
    tidied = ("/".join(part for part in name.split("/") if part != ".") for name in found)
    return [name for name in dict.fromkeys(tidied) if _is_kept(name)]


def _is_kept(name: str) -> bool:
    parts = name.split("/")
    plain = all(_PART.fullmatch(part) and part.isprintable() and not is_device_name(part) for part in parts)
    taken = len(parts) > 1 and (parts[0].lower() in FOLDERS or "." in parts[0])
    return plain and not taken and len(name) <= _MOST_LETTERS and parts[-1].lower().endswith(_SUFFIXES)


def _leads_out(folder: Path, name: str) -> bool:
    """Whether a folder on the way to a kept file is a link."""
    return any((folder / parent).is_symlink() for parent in PurePosixPath(name).parents)


def _names(node: dict[str, object] | list[object]) -> Iterator[str]:
    for key, value in node.items() if isinstance(node, dict) else enumerate(node):
        if isinstance(value, (dict, list)):
            yield from _names(value)
        elif key in _KEYS and isinstance(value, str):
            yield value


def keep_data(study: Study, folder: Path) -> None:
    """Copy the data files of a study into its result folder.

    Raises AccessError when one cannot be written; FolderError when a folder that it would lie in is a link.
    """
    for name in named_files(study.text):
        source = study.path.parent / name
        if _leads_out(folder, name):
            raise FolderError(f"{folder / name} lies behind a link: it could lead out of {folder}")
        if source.resolve().is_file() and source.resolve() != (folder / name).resolve():
            write_atomically(folder / name, read_given(source, LARGEST_ARRAY))


def kept_data(text: str, folder: Path) -> dict[str, bytes]:
    """What is kept of the data files of a study's text, by name; what cannot be read safely is left out."""
    found = {}
    for name in named_files(text):
        if _leads_out(folder, name):
            continue
        try:
            found[name] = read_whole(folder / name)
        except UqsphereError:
            continue
    return found


# --- checksums -------------------------------------------------------------------------------------------

NAME: Final = "SHA256SUMS"
_LINE: Final = re.compile(r"""([0-9a-f]{64})  (\w[^\x00-\x1f\x7f-\x9f\\:*?"<>|]{0,199})""")
_MOST_BYTES: Final = 1 << 22


def write_sums(folder: Path, names: Iterable[str], *, keep: bool = False) -> None:
    """Enter the files `names` (relative, with /) of a result folder; `keep` leaves the other lines as they are."""
    sums = {}
    if keep:
        try:
            sums = read_sums(folder) or {}
        except FolderError:
            return  # what is damaged stays as it is, for `verify` to tell
        if not sums:
            return
    sums |= {name: digest_of(folder / name) for name in names}
    write_atomically(folder / NAME, "".join(f"{sums[name]}  {name}\n" for name in sorted(sums)))


def read_sums(folder: Path) -> dict[str, str] | None:
    """Checksums by name; None where the folder has none (an older version, or a run that has not finished).

    Raises FolderError when the file is not what a run writes, or names a file outside the folder.
    """
    try:
        text = read_whole(folder / NAME, _MOST_BYTES).decode("utf-8")
    except AccessError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            return None
        raise
    except UnicodeDecodeError as error:
        raise FolderError(f"{folder / NAME} is damaged: {error}") from error
    sums = {}
    for number, line in enumerate(text.removesuffix("\n").split("\n"), 1):
        match = _LINE.fullmatch(line)
        if match is None or ".." in match[2].split("/") or not match[2].isprintable():
            raise FolderError(f"{folder / NAME} is damaged: line {number} is no checksum of a file inside the folder")
        sums[match[2]] = match[1]
    return sums


def compare_sums(folder: Path, sums: dict[str, str]) -> list[str]:
    """What is missing or was changed since it was entered, in sentences."""
    faults = []
    for name, digest in sums.items():
        path = folder / name
        inside = path.resolve().is_relative_to(folder.resolve())
        try:
            found = digest_of(path) if inside else ""
        except AccessError as error:
            if not isinstance(error.__cause__, FileNotFoundError):
                raise
            faults.append(f"{name} is missing")
            continue
        if found != digest:
            faults.append(f"{name} has been changed since it was written" if inside else f"{name} is a link")
    return faults
