"""The files of data that a study names, kept in the result folder so that its study can be run again there."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from uqsphere.errors import UqsphereError
from uqsphere.files import is_device_name, read_whole
from uqsphere.store import write_atomically
from uqsphere.study import Study

__all__ = ["keep_data", "kept_data", "named_files"]

#: keys of a study whose value is the name of a file
_KEYS: Final = ("file", "receiving_damper")
#: names that are kept: beside the study itself, and none that a run writes
_NAME: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_ .-]{0,195}\.(csv|tsv|txt)", re.IGNORECASE)


def named_files(text: str) -> list[str]:
    """Names of the data files in a study's text that lie beside it, each once; none where the text is no study."""
    try:
        found = list(_names(tomllib.loads(text)))
    except (tomllib.TOMLDecodeError, RecursionError):
        return []
    return [name for name in dict.fromkeys(found) if _NAME.fullmatch(name) and not is_device_name(name)]


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
    """
    for name in named_files(study.text):
        source = study.path.parent / name
        if source.resolve().is_file() and source.resolve() != (folder / name).resolve():
            write_atomically(folder / name, source.read_bytes())


def kept_data(text: str, folder: Path) -> dict[str, bytes]:
    """What is kept of the data files of a study's text, by name; what cannot be read safely is left out."""
    found = {}
    for name in named_files(text):
        try:
            found[name] = read_whole(folder / name)
        except UqsphereError:
            continue
    return found
