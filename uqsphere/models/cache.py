"""What a slow black box has answered, in one SQLite file, so that no row is evaluated twice.

A cache may be lost at any time without changing an answer: whatever is wrong with its file, rows are evaluated anew and
`notes` says why. SQLite sees to a process that is killed while it writes and to two runs that write at once; each
record carries a checksum against damage.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sqlite3
import struct
import time
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags, Places
from uqsphere.models.rows import DIED, TIME_OVER

#: marks the file as ours, and the form of its records
_APPLICATION: Final = 0x75715370
_VERSION: Final = 1
#: seconds of answers that are gathered before they are written, and that another run is waited for
_GATHERED: Final = 1.0
_WAIT: Final = 30.0


class Cache:
    """Answers of black boxes by what asks for them: model, names and numbers of the inputs, names of the outputs."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[str] = []
        self._database: sqlite3.Connection | None = None
        self._pending: list[tuple[bytes, bytes]] = []
        self._written = time.monotonic()
        self._open()

    def _open(self) -> None:
        if self.path.is_symlink() or (self.path.exists() and not self.path.is_file()):
            self._without(f"{self.path} is no plain file: nothing is stored there")
            return
        for attempt in range(2):
            try:
                self._database = self._connected()
                return
            except sqlite3.OperationalError as error:
                self._without(f"{self.path} cannot be used ({error}): evaluated rows are not stored")
                return
            except (sqlite3.DatabaseError, ValueError) as error:
                if attempt or not self._set_aside(str(error)):
                    self._without(f"{self.path} is damaged: evaluated rows are not stored")
                    return

    def _connected(self) -> sqlite3.Connection:
        """Raises ValueError for a database of something else; sqlite3.DatabaseError for a file that is none."""
        database = sqlite3.connect(self.path, timeout=_WAIT, isolation_level=None, check_same_thread=False)
        try:
            if database.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
                marks = [
                    database.execute(f"PRAGMA {name}").fetchone()[0] for name in ("application_id", "user_version")
                ]
                if marks != [_APPLICATION, _VERSION]:
                    raise ValueError("it is no cache of this version")
                database.execute("SELECT key, record FROM answers LIMIT 1").fetchone()
            else:
                database.execute("BEGIN IMMEDIATE")
                database.execute("CREATE TABLE IF NOT EXISTS answers (key BLOB PRIMARY KEY, record BLOB) WITHOUT ROWID")
                database.execute(f"PRAGMA application_id = {_APPLICATION}")
                database.execute(f"PRAGMA user_version = {_VERSION}")
                database.execute("COMMIT")
        except BaseException:
            database.close()
            raise
        return database

    def _without(self, note: str) -> None:
        """Go on without a file."""
        if self._database is not None:
            with contextlib.suppress(sqlite3.Error):
                self._database.close()
        self._database = None
        self._pending.clear()
        self.notes.append(note)

    def _set_aside(self, why: str) -> bool:
        """Rename a file that cannot be used; whether that was possible."""
        aside = self.path.with_name(f"{self.path.name}.damaged")
        try:
            os.replace(self.path, aside)
            self.path.with_name(f"{self.path.name}-journal").unlink(missing_ok=True)
        except OSError:
            return False
        self.notes.append(f"{self.path} was not used ({why}); it is now {aside.name}, and its rows are evaluated anew")
        return True

    def _broken(self, error: sqlite3.Error) -> None:
        """A file that could be opened, and now cannot be read or written."""
        if isinstance(error, sqlite3.OperationalError):
            self._without(f"{self.path}: {error}; evaluated rows are no longer stored")
            return
        if self._database is not None:
            with contextlib.suppress(sqlite3.Error):
                self._database.close()
        self._database = None
        if self._set_aside(str(error)):
            self._open()
        else:
            self._without(f"{self.path} is damaged: evaluated rows are not stored")

    def __len__(self) -> int:
        if self._database is None:
            return 0
        with contextlib.suppress(sqlite3.Error):
            return int(self._database.execute("SELECT count(*) FROM answers").fetchone()[0])
        return 0

    @property
    def empty(self) -> bool:
        """Whether nothing can be read."""
        if self._database is None:
            return True
        try:
            return self._database.execute("SELECT 1 FROM answers LIMIT 1").fetchone() is None
        except sqlite3.Error:
            return False

    def read(self, keys: Sequence[bytes], outputs: int) -> tuple[Array, Places, Flags]:
        """Stored answers (n, outputs), status (n,), and which rows are stored, (n,)."""
        values, status = np.full((len(keys), outputs), np.nan), np.zeros(len(keys), dtype=np.int64)
        stored, damaged = np.zeros(len(keys), dtype=bool), 0
        self.flush()
        if self._database is None:
            return values, status, stored
        try:
            for k, key in enumerate(keys):
                found = self._database.execute("SELECT record FROM answers WHERE key = ?", (key,)).fetchone()
                if found is None:
                    continue
                record = found[0]
                size = 5 + 8 * outputs
                intact = isinstance(record, bytes) and len(record) == size
                if not intact or zlib.crc32(record[4:] + key) != struct.unpack("<I", record[:4])[0]:
                    damaged += 1
                    continue
                status[k], stored[k] = record[4], True
                values[k] = np.frombuffer(record, dtype="<f8", offset=5)
        except sqlite3.Error as error:
            self._broken(error)
        if damaged:
            self.notes.append(f"{self.path}: {damaged} damaged rows are evaluated anew")
        return values, status, stored

    def write(self, keys: Sequence[bytes], values: Array, status: Places) -> None:
        """Store answers; rows that took too long or ended their process are tried again another time."""
        for key, row, code in zip(keys, np.ascontiguousarray(values, dtype="<f8"), status.tolist(), strict=True):
            if code not in (TIME_OVER, DIED):
                content = bytes([code]) + row.tobytes()
                self._pending.append((key, struct.pack("<I", zlib.crc32(content + key)) + content))
        if time.monotonic() - self._written > _GATHERED:
            self.flush()

    def flush(self) -> None:
        """Write what was gathered."""
        self._written = time.monotonic()
        if self._database is None or not self._pending:
            self._pending.clear()
            return
        try:
            self._database.execute("BEGIN IMMEDIATE")
            self._database.executemany("INSERT OR REPLACE INTO answers VALUES (?, ?)", self._pending)
            self._database.execute("COMMIT")
        except sqlite3.Error as error:
            with contextlib.suppress(sqlite3.Error):
                if self._database.in_transaction:
                    self._database.execute("ROLLBACK")
            self._broken(error)
        self._pending.clear()

    def forget(self, why: str) -> None:
        """Drop everything that is stored."""
        self._pending.clear()
        if self._database is not None:
            try:
                self._database.execute("DELETE FROM answers")
            except sqlite3.Error as error:
                self._broken(error)
        self.notes.append(why)

    def close(self) -> None:
        """Write what was gathered and let go of the file."""
        self.flush()
        if self._database is not None:
            self._database.close()
        self._database = None


def keys_of(digest: str, names: Sequence[str], rows: Array, outputs: Sequence[str]) -> list[bytes]:
    """Keys of rows (n, d) of a model; independent of the order of names, and of which of them a study scatters."""
    order = sorted(range(len(names)), key=lambda k: names[k])
    about = json.dumps([digest, [names[k] for k in order], list(outputs)]).encode()
    base = hashlib.blake2b(about, digest_size=16)
    sorted_rows = np.ascontiguousarray(rows[:, order] + 0.0, dtype="<f8")  # + 0.0: -0 is 0
    keys = []
    for row in sorted_rows:
        digester = base.copy()
        digester.update(row.tobytes())
        keys.append(digester.digest())
    return keys
