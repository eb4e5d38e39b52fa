"""Files that a user names: plain ones only, of a size that is looked at before anything is read."""

import os
import stat
import tomllib
from pathlib import Path
from typing import Any

from uqsphere.errors import AccessError, UsageError, as_text

#: what a JSON document holds
Json = Any


class TooLarge(UsageError):
    """A file is larger than what is read of its kind."""


def packaged(file: str) -> Json:
    """The content of a TOML file of this package, by its path in it."""
    return tomllib.loads(Path(__file__).parent.joinpath(file).read_text("utf-8"))


def read_given(path: Path, largest: int) -> bytes:
    """The content of a file that the user named: plain, or a link to a plain one, of at most
    `largest` bytes.

    Raises AccessError for a pipe or a device, and where the system refuses or there is no such
    file; UsageError for a folder, and a file that is larger.
    """
    name = as_text(path)
    try:
        kind = os.stat(path).st_mode
        if stat.S_ISDIR(kind):
            raise UsageError(f"{name}: this is a directory. Give the file inside it")
        if not stat.S_ISREG(kind):
            raise AccessError(f"{name}: this is not a regular file")
        flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        with os.fdopen(os.open(path, flags), "rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            if size > largest:
                raise TooLarge(
                    f"{name}: the file has {size / 2**20:,.0f} MiB; at most "
                    f"{largest / 2**20:,.0f} MiB are read"
                )
            return stream.read(largest)
    except FileNotFoundError:
        raise AccessError(f"{name}: there is no such file") from None
    except (OSError, ValueError) as error:
        raise AccessError(
            f"{name}: cannot be read: {getattr(error, 'strerror', None) or error}"
        ) from None
