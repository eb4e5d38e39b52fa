"""What a result folder keeps beside its answers: the data files that the study names, so that it can be run again
there, and SHA256SUMS, the checksums of what a run has written, in the format that `sha256sum -c` reads.  And these
answers themselves, once they are there.

Chunks of evaluations are not listed: each carries its checksum in its name.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath
from typing import Final

from uqsphere.errors import AccessError, FolderError, UqsphereError
from uqsphere.files import FOLDERS, LARGEST_ARRAY, digest_of, is_device_name, read_given, read_whole
from uqsphere.results import Manifest, Results
from uqsphere.results.tables import tables
from uqsphere.store import Store, write_atomically, write_json
from uqsphere.study import Study

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


# --- all that a finished run has

#: files of a folder beside its tables, where they are there
_FILES: Final = ("manifest.json", "results.json", "study.resolved.json", "study.toml", "samples.json", "samples.npy",
                 "courses.json", "sliders.json", "tables/courses.csv", "fields.nc", "tables/fields.csv")  # fmt: skip


def write_results(store: Store, results: Results, manifest: Manifest) -> None:
    """Tables, manifest.json and results.json, each written whole; results.json last, as the sign of the end."""
    found = tables(results)
    for name, text in found.items():
        write_atomically(store.folder / "tables" / name, text)
    write_json(store.folder / "manifest.json", manifest.document())
    write_json(store.folder / "results.json", results.document())
    data = named_files(read_whole(store.folder / "study.toml").decode("utf-8", "replace"))
    there = [name for name in (*_FILES, *data) if (store.folder / name).is_file()]
    write_sums(store.folder, [*(f"tables/{name}" for name in found), *there])
