"""What a slow black box has answered, in one SQLite file, so that no row is evaluated twice.

A cache may be lost at any time without changing an answer: whatever is wrong with its file, rows are evaluated anew and
a note says why. SQLite sees to a process that is killed while it writes and to two runs that write at once; each record
carries a checksum against damage.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sqlite3
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.models.rows import Code, EvaluatedRows

#: marks the file as ours, and the form of its records
_MARKS: Final = {"application_id": 0x75715370, "user_version": 1}
_TABLE: Final = "CREATE TABLE answers (key BLOB PRIMARY KEY, record BLOB) WITHOUT ROWID"
#: seconds that another run is waited for
_WAIT: Final = 30.0


class Cache:
    """Answers of the black box of a study, by its digest, names and numbers of the inputs, names of the outputs.

    Keys depend on no order of the inputs, nor on which of them a study scatters. `note` is told what is wrong.
    """

    def __init__(
        self, path: Path, digest: str, inputs: Sequence[str], outputs: Sequence[str], note: Callable[[str], None]
    ) -> None:
        self.path, self._outputs, self._note = path, len(outputs), note
        self._order = sorted(range(len(inputs)), key=lambda k: inputs[k])
        self._about = hashlib.blake2b(json.dumps([digest, sorted(inputs), list(outputs)]).encode()).digest()
        self._database: sqlite3.Connection | None = None
        with self._guarded():
            self._open()

    def _open(self) -> None:
        """Raises ValueError for what is no cache; sqlite3.DatabaseError for what is no database."""
        if self.path.is_symlink():
            raise ValueError("it is a link")
        database = sqlite3.connect(self.path, timeout=_WAIT, isolation_level=None, check_same_thread=False)
        self._database = database
        # what a killed process has written stays; what a power cut damages is evaluated anew
        database.execute("PRAGMA synchronous = OFF")
        if content := [text for (text,) in database.execute("SELECT sql FROM sqlite_master")]:
            marks = {name: database.execute(f"PRAGMA {name}").fetchone()[0] for name in _MARKS}
            if marks != _MARKS or content != [_TABLE]:  # a view in its place may never come to an end
                raise ValueError("it is no cache of this version")
            if (state := database.execute("PRAGMA quick_check(1)").fetchone()[0]) != "ok":
                raise ValueError(f"it is damaged: {state}")
        else:
            database.execute("BEGIN IMMEDIATE")
            database.execute(_TABLE.replace("TABLE", "TABLE IF NOT EXISTS"))
            for name, mark in _MARKS.items():
                database.execute(f"PRAGMA {name} = {mark}")
            database.execute("COMMIT")

    @contextlib.contextmanager
    def _guarded(self) -> Iterator[None]:
        """Start another file where this one is damaged or foreign; store nothing where none can be written."""
        try:
            yield
        except (sqlite3.Error, ValueError) as error:
            self.close()  # which takes back what was begun
            aside = self.path.with_name(f"{self.path.name}.damaged")
            try:
                if isinstance(error, sqlite3.OperationalError):
                    raise error  # a full disk, a folder that cannot be written, a lock: the file is as it should be
                os.replace(self.path, aside)
                self.path.with_name(f"{self.path.name}-journal").unlink(missing_ok=True)
                self._open()
                self._note(
                    f"{self.path} was not used ({error}): it is {aside.name} now, and its rows are evaluated anew"
                )
            except (OSError, sqlite3.Error, ValueError) as reason:
                self.close()
                self._note(f"{self.path} cannot be used ({reason}): evaluated rows are not stored")

    def _keys(self, rows: Array) -> Iterator[bytes]:
        for row in np.ascontiguousarray(rows[:, self._order] + 0.0, dtype="<f8"):  # + 0.0: -0 is 0
            yield hashlib.blake2b(row.tobytes(), key=self._about, digest_size=16).digest()

    def read(self, rows: Array) -> tuple[EvaluatedRows, Flags]:
        """Of rows (n, inputs) the answers that are stored, (m, outputs), and whether each row is, (n,)."""
        contents: list[bytes] = []
        stored = np.zeros(len(rows), dtype=bool)
        with self._guarded():
            if self._database is not None and self._database.execute("SELECT 1 FROM answers LIMIT 1").fetchone():
                for k, key in enumerate(self._keys(rows)):
                    for (record,) in self._database.execute("SELECT record FROM answers WHERE key = ?", (key,)):
                        check, content = bytes(record[:4]), bytes(record[4:])
                        stored[k] = check == _checksum(content + key) and len(content) == 1 + 8 * self._outputs
                        if stored[k]:
                            contents.append(content)
                        else:
                            self._note(f"{self.path} has damaged rows, which are evaluated anew")
        values = np.frombuffer(b"".join(content[1:] for content in contents), dtype="<f8")
        status = np.array([content[0] for content in contents], dtype=np.int64)
        return EvaluatedRows.plain(values.reshape(-1, self._outputs), status), stored

    def write(self, rows: Array, answers: EvaluatedRows) -> None:
        """Store answers; rows that took too long or ended their process are tried again another time."""
        records, values = [], np.asarray(answers.values, dtype="<f8")
        for key, row, code in zip(self._keys(rows), values, answers.status.tolist(), strict=True):
            if code not in (Code.TIME_OVER, Code.DIED):
                content = bytes([code]) + row.tobytes()
                records.append((key, _checksum(content + key) + content))
        if self._database is not None and records:
            with self._guarded():
                self._database.execute("BEGIN IMMEDIATE")
                self._database.executemany("INSERT OR REPLACE INTO answers VALUES (?, ?)", records)
                self._database.execute("COMMIT")

    def close(self) -> None:
        """Let go of the file."""
        if self._database is not None:
            with contextlib.suppress(sqlite3.Error):
                self._database.close()
        self._database = None


def _checksum(content: bytes) -> bytes:
    return zlib.crc32(content).to_bytes(4, "little")
