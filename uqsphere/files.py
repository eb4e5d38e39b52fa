"""Files that a user names: plain ones only, of a size that is looked at before anything is read."""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from uqsphere.errors import AccessError, UsageError, as_text

#: what a JSON document holds
Json = Any


class TooLarge(UsageError):
    """A file is larger than what is read of its kind."""


@contextlib.contextmanager
def open_given(path: Path, largest: int) -> Iterator[BinaryIO]:
    """A file that the user named, open for reading: plain, or a link to a plain one, of at most
    `largest` bytes.

    Raises AccessError for a pipe or a device, and where the system refuses or there is no such
    file; UsageError for a folder, and a file that is larger.
    """
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        kind = os.stat(path)
        if stat.S_ISDIR(kind.st_mode):
            raise UsageError(f"{as_text(path)}: this is a directory. Give the file inside it")
        if not stat.S_ISREG(kind.st_mode):
            raise AccessError(f"{as_text(path)}: this is not a regular file")
        handle = os.open(path, flags)
    except FileNotFoundError:
        raise AccessError(f"{as_text(path)}: there is no such file") from None
    except (OSError, ValueError) as error:
        raise AccessError(
            f"{as_text(path)}: cannot be read: {getattr(error, 'strerror', None) or error}"
        ) from None
    with os.fdopen(handle, "rb") as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > largest:
            raise TooLarge(
                f"{as_text(path)}: the file has {size / 2**20:,.0f} MiB; at most "
                f"{largest / 2**20:,.0f} MiB are read"
            )
        yield stream


def read_given(path: Path, largest: int) -> bytes:
    """The content of a file that the user named; raises as `open_given`."""
    with open_given(path, largest) as stream:
        try:
            return stream.read(largest)
        except OSError as error:
            raise AccessError(
                f"{as_text(path)}: cannot be read: {error.strerror or error}"
            ) from None
