"""The files of data that a study names, kept in the result folder so that its study can be run again there."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any, Final

from uqsphere.errors import FolderError, UqsphereError
from uqsphere.files import FOLDERS, LARGEST_ARRAY, is_device_name, read_given, read_whole
from uqsphere.store import write_atomically
from uqsphere.study import Study

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
        found = list(_names(tomllib.loads(text)))
    except (tomllib.TOMLDecodeError, RecursionError):
        return []
    return [name for name in dict.fromkeys(_tidied(name) for name in found) if _is_kept(name)]


def _tidied(name: str) -> str:
    """The same path with / and without steps on the spot."""
    return "/".join(part for part in name.replace("\\", "/").split("/") if part != ".") if name[:1] != "/" else ""


def _is_kept(name: str) -> bool:
    parts = name.split("/")
    plain = all(_PART.fullmatch(part) and part.isprintable() and not is_device_name(part) for part in parts)
    taken = len(parts) > 1 and (parts[0].lower() in FOLDERS or "." in parts[0])
    return plain and not taken and len(name) <= _MOST_LETTERS and parts[-1].lower().endswith(_SUFFIXES)


def _leads_out(folder: Path, name: str) -> bool:
    """Whether a folder on the way to a kept file is a link."""
    return any((folder / parent).is_symlink() for parent in PurePosixPath(name).parents)


def _names(node: Any) -> Iterator[str]:
    for key, value in node.items() if isinstance(node, dict) else enumerate(node):
        if isinstance(value, (dict, list)):
            yield from _names(value)
        elif key in _KEYS and isinstance(value, str):
            yield value


def keep_data(study: Study, folder: Path) -> None:
    """Copy the data files of a study into its result folder.

    Raises
    ------
    AccessError
        When one cannot be written.
    FolderError
        When a folder that it would lie in is a link.
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
