"""SHA256SUMS: the checksums of what a run has written, in the format that `sha256sum -c` reads.

Chunks of evaluations are not listed: each carries its checksum in its name.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from uqsphere.errors import AccessError, FolderError
from uqsphere.files import digest_of, read_whole
from uqsphere.store import write_atomically

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

    Raises
    ------
    FolderError
        When the file is not what a run writes, or names a file outside the folder.
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
