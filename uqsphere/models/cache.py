"""What a slow black box has answered, in one SQLite file, so that no answer is computed twice.

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
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.models.rows import EvaluatedRows

#: the one thing in the file; its text is what tells a cache of this version from another database
_TABLE: Final = "CREATE TABLE answers_2 (key BLOB PRIMARY KEY, record BLOB) WITHOUT ROWID"
#: seconds that another run is waited for
_WAIT: Final = 30.0


class Cache:
    """Answers of the black box of a study, by its digest, names and numbers of the inputs, names of the outputs.

    Keys depend on no order of the inputs, nor on which of them a study scatters. `note` is told what is wrong.
    """

    def __init__(
        self, path: Path, digest: str, inputs: Sequence[str], outputs: Sequence[str], note: Callable[[str], None]
    ) -> None:
        self.path, self._note, self._outputs = path, note, len(outputs)
        self._order = sorted(range(len(inputs)), key=lambda k: inputs[k])
        self._about = hashlib.blake2b(json.dumps([digest, sorted(inputs), list(outputs)]).encode()).digest()
        self._database: sqlite3.Connection | None = None
        try:
            try:
                self._open()
            except (sqlite3.DatabaseError, ValueError) as error:
                if isinstance(error, sqlite3.OperationalError):
                    raise  # a folder that cannot be written, a lock: the file is as it should be
                self.close()
                aside = path.with_name(f"{path.name}.damaged")
                os.replace(path, aside)
                path.with_name(f"{path.name}-journal").unlink(missing_ok=True)
                self._open()
                note(f"{path} was not used ({error}): it is {aside.name} now, and its rows are evaluated anew")
        except (OSError, sqlite3.Error, ValueError) as error:
            self._give_up(error)

    def _open(self) -> None:
        """Raises ValueError for what is no cache; sqlite3.DatabaseError for what is no database."""
        if self.path.is_symlink():
            raise ValueError("it is a link")
        self._database = database = sqlite3.connect(self.path, timeout=_WAIT, check_same_thread=False)
        # what a killed process has written stays; what a power cut damages is evaluated anew
        database.execute("PRAGMA synchronous = OFF")
        content = database.execute("SELECT sql FROM sqlite_master").fetchall()
        if not content:
            database.execute(_TABLE.replace("TABLE", "TABLE IF NOT EXISTS"))
        elif content != [(_TABLE,)]:  # a view in its place may never come to an end
            raise ValueError("it is no cache of this version")
        elif (state := database.execute("PRAGMA quick_check(1)").fetchone()[0]) != "ok":
            raise ValueError(f"it is damaged: {state}")

    def _give_up(self, why: Exception) -> None:
        self.close()
        self._note(f"{self.path} cannot be used ({why}): evaluated rows are not stored")

    def _keys(self, rows: Array) -> list[bytes]:
        """What rows (n, inputs) are stored by."""
        ordered = np.ascontiguousarray(rows[:, self._order] + 0.0, dtype="<f8")  # + 0.0: -0 is 0
        return [hashlib.blake2b(row.tobytes(), key=self._about, digest_size=16).digest() for row in ordered]

    def read(self, rows: Array) -> tuple[Array, Flags]:
        """Of rows (n, inputs) the answers that are stored, (m, outputs), and whether each row is, (n,)."""
        records = [b""] * len(rows)
        try:
            if self._database is not None and self._database.execute("SELECT 1 FROM answers_2 LIMIT 1").fetchone():
                records = [self._record(self._database, key) for key in self._keys(rows)]
        except sqlite3.Error as error:
            self._give_up(error)
        stored = np.array([record != b"" for record in records], dtype=bool)
        return np.frombuffer(b"".join(records), dtype="<f8").reshape(-1, self._outputs), stored

    def _record(self, database: sqlite3.Connection, key: bytes) -> bytes:
        """The values that are stored by a key, empty where there are none or they are damaged."""
        for (record,) in database.execute("SELECT record FROM answers_2 WHERE key = ?", (key,)):
            values = record[4:] if isinstance(record, bytes) else b""
            if len(values) == 8 * self._outputs and record == _signed(values, key):
                return values
            self._note(f"{self.path} has damaged rows, which are evaluated anew")
        return b""

    def write(self, rows: Array, answers: EvaluatedRows) -> None:
        """Store answers; rows without one are tried again another time."""
        keys, values = self._keys(rows[answers.good]), np.asarray(answers.values[answers.good], dtype="<f8")
        records = [(key, _signed(row.tobytes(), key)) for key, row in zip(keys, values, strict=True)]
        try:
            with self._database or contextlib.nullcontext() as database:
                if database is not None:
                    database.executemany("INSERT OR REPLACE INTO answers_2 VALUES (?, ?)", records)
        except sqlite3.Error as error:
            self._give_up(error)

    def close(self) -> None:
        """Let go of the file."""
        if self._database is not None:
            with contextlib.suppress(sqlite3.Error):
                self._database.close()
        self._database = None


def _signed(values: bytes, key: bytes) -> bytes:
    """Values behind a checksum of them and of their key."""
    return zlib.crc32(values + key).to_bytes(4, "little") + values
