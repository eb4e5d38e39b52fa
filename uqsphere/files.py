"""Reading what a stranger may have written: plain files only, of a size that is looked at before anything is read.

A result folder can come from anywhere.  Nothing in it is followed out of it (links), waited for (pipes,
devices), run (no pickle, no import) or believed to be as small as it says.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final

from uqsphere.arrays import Cells
from uqsphere.errors import AccessError, FolderError, UsageError

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

#: what a JSON document holds
Json = Any
#: bytes of a JSON document, of a stored array, and of anything else
LARGEST_DOCUMENT: Final = 64 << 20
LARGEST_ARRAY: Final = 1 << 30
#: entries of a result folder
MOST_FILES: Final = 200_000
#: folders that a result folder has
FOLDERS: Final = ("evaluations", "tables", "figures", "export", "services")
#: of which these hold what is not the run's own, but made from it, or another run's
_OTHERS: Final = ("export", "services")
#: columns of a stored table: numbers, counts and flags
_COLUMNS: Final = frozenset(("<f8", "<i8", "|u1", "|b1"))
_DEVICES: Final = frozenset(
    (
        "con",
        "prn",
        "aux",
        "nul",
        "conin$",
        "conout$",
        *(f"{port}{k}" for port in ("com", "lpt") for k in "123456789¹²³"),
    )
)


class TooLarge(UsageError):
    """A file is larger than what is read of its kind."""


def is_device_name(name: str) -> bool:
    """Whether some system takes this file name for a device, or drops its end: the same answer on every system.

    >>> is_device_name("nul.csv"), is_device_name("tests."), is_device_name("null.csv")
    (True, True, False)
    """
    return name.partition(".")[0].rstrip(" ").lower() in _DEVICES or name.endswith((".", " "))


def read_whole(path: Path, largest: int = LARGEST_DOCUMENT) -> bytes:
    """The content of a regular file that is no link and not larger than `largest` bytes.

    Raises FolderError for a link, a folder, a pipe or a device, or a file that is too large; AccessError where the
    system refuses, or there is no such file.
    """
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        if path.is_symlink():
            raise FolderError(f"{path} is a link: a result folder holds plain files")
        with open(path, "rb", opener=lambda path, _: os.open(path, flags)) as stream:
            kind = os.fstat(stream.fileno())
            if not stat.S_ISREG(kind.st_mode):
                raise FolderError(f"{path} is not a plain file")
            if kind.st_size > largest:
                raise FolderError(f"{path} has {kind.st_size:,} bytes; at most {largest:,} are read")
            return stream.read(largest)
    except (OSError, ValueError) as error:
        reason = "there is no such file" if isinstance(error, FileNotFoundError) else getattr(error, "strerror", "")
        raise AccessError(f"{path}: {reason or error}") from error


@contextlib.contextmanager
def open_given(path: Path, largest: int) -> Iterator[BinaryIO]:
    """A file that the user named, open for reading: plain, or a link to a plain one, of at most `largest` bytes.

    Raises AccessError for a pipe or a device, and where the system refuses or there is no such file; UsageError for a
    folder, and a file that is larger.
    """
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        kind = os.stat(path)
        if stat.S_ISDIR(kind.st_mode):
            raise UsageError(f"{path}: this is a folder; give the file inside it")
        if not stat.S_ISREG(kind.st_mode):
            raise AccessError(f"{path}: this is not a regular file")
        handle = os.open(path, flags)
    except FileNotFoundError:
        raise AccessError(f"{path}: there is no such file") from None
    except (OSError, ValueError) as error:
        raise AccessError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    with os.fdopen(handle, "rb") as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > largest:
            raise TooLarge(f"{path}: it has {size / 2**20:,.0f} MiB, and {largest / 2**20:,.0f} MiB are read at most")
        yield stream


def read_given(path: Path, largest: int) -> bytes:
    """The content of a file that the user named; raises as `open_given`."""
    with open_given(path, largest) as stream:
        try:
            return stream.read(largest)
        except OSError as error:
            raise AccessError(f"{path}: cannot be read: {error.strerror or error}") from None


def _constant(text: str) -> float:
    raise ValueError(f"found {text}, which no run writes")


def _integer(text: str) -> int:
    if len(text) > 20:
        raise ValueError("an integer has more than 20 digits")
    return int(text)


def _float(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"found {text[:40]}, which is beyond floating point")
    return value


def load_document(path: Path) -> Json:
    """The content of a JSON file of a result folder: finite numbers, text that can be written again.

    Raises FolderError where it is missing, damaged, no plain file, or not JSON.
    """
    try:
        data = read_whole(path)
    except AccessError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            raise FolderError(f"{path.parent} is not a result folder: it has no {path.name}") from error
        raise
    try:
        found = json.loads(data.decode("utf-8"), parse_constant=_constant, parse_int=_integer, parse_float=_float)
        json.dumps(found, ensure_ascii=False).encode("utf-8")  # a lone surrogate can be read and not written
    except (ValueError, RecursionError) as error:
        raise FolderError(f"{path} is damaged: {error}") from error
    return found


def array_of(data: bytes) -> npt.NDArray[np.float64]:
    """The array of an .npy file of float64; nothing is allocated that the bytes do not hold.

    Raises ValueError for anything but a whole array of little-endian float64 in C order.
    """
    found = chunk_of(data)
    if found.dtype.names is not None:
        raise ValueError(f"found an array of {found.dtype}")
    return found


def chunk_of(data: bytes) -> Cells:
    """The array of an .npy file of float64, or of rows of plain numbers with names; sizes as with `array_of`.

    Raises ValueError for anything but a whole array in C order of what a run stores.
    """
    import io

    import numpy as np

    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        if version != (1, 0):
            raise ValueError(f"found version {version} of the array format")
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
    except Exception as error:  # the header is text that numpy parses: it can fail in any way
        raise ValueError(f"the header of the array cannot be read: {error}") from error
    if fortran or not (dtype == np.dtype("<f8") or _is_plain_table(dtype)):
        raise ValueError(f"found an array of {dtype}")
    if any(length < 0 for length in shape) or dtype.itemsize * math.prod(shape) != len(data) - stream.tell():
        raise ValueError(f"found {len(data) - stream.tell():,} bytes for an array of shape {shape}")
    return np.frombuffer(data, dtype=dtype, offset=stream.tell()).reshape(shape).copy()


def _is_plain_table(dtype: np.dtype[Any]) -> bool:
    """Whether an array has named columns of the kinds that a run stores, one after the other and without gaps."""
    import numpy as np

    if dtype.names is None or dtype.itemsize == 0:
        return False
    columns = [(name, dtype[name].base, dtype[name].shape) for name in dtype.names]
    return dtype == np.dtype(columns) and all(base.str in _COLUMNS for _, base, _ in columns)


def digest_of(path: Path) -> str:
    """SHA-256 of a plain file; raises as `read_whole`."""
    return hashlib.sha256(read_whole(path, LARGEST_ARRAY)).hexdigest()


def refuse_links(folder: Path) -> None:
    """Refuse a result folder one of whose parts leads out of it.

    Raises FolderError for a folder inside it that is a link or no folder, and a lock that is no plain file.
    """
    services = folder / "services"
    inner = sorted(services.iterdir()) if services.is_dir() and not services.is_symlink() else []
    for path in (*(folder / name for name in FOLDERS), *inner):
        if path.is_symlink() or (path.exists() and not path.is_dir()):
            raise FolderError(f"{path} is not a plain folder: it could lead out of {folder}")
    for name in (".lock", "log.jsonl"):
        path = folder / name
        if path.is_symlink() or (path.exists() and not path.is_file()):
            raise FolderError(f"{path} is not a plain file: it could lead out of {folder}")


def plain_files(folder: Path) -> Iterator[Path]:
    """Every file of a result folder and of the folders inside it that a run writes, in order of their names.

    Raises FolderError for links, pipes and devices, and for more entries than a run ever writes.
    """
    refuse_links(folder)
    seen = 0
    for place in (folder, *(folder / name for name in FOLDERS if name not in _OTHERS)):
        if not place.is_dir():
            continue
        with os.scandir(place) as entries:
            found = sorted(entries, key=lambda entry: entry.name) if _counted(place) else []
        for entry in found:
            seen += 1
            if seen > MOST_FILES:
                raise FolderError(f"{folder} has more than {MOST_FILES:,} files")
            if entry.is_dir(follow_symlinks=False):
                continue
            if not entry.is_file(follow_symlinks=False):
                raise FolderError(f"{entry.path} is not a plain file")
            yield Path(entry.path)


def _counted(place: Path) -> bool:
    """Look at the number of entries before they are sorted."""
    with os.scandir(place) as entries:
        for number, _ in enumerate(entries):
            if number >= MOST_FILES:
                raise FolderError(f"{place} has more than {MOST_FILES:,} files")
    return True
