"""What a slow black box has answered, in one SQLite file, so that no answer is computed twice.

SQLite sees to a process that is killed while it writes and to two runs that write at once.  Each
record ends with a checksum of its key and its answer; a record that does not match counts as not
stored.  A file that is no database, or cannot be written, ends the run with an error: what it has
stored by then is there for the next.
"""

import contextlib
import hashlib
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from uqsphere.arrays import Array, Flags, Names
from uqsphere.errors import AccessError, as_text

_TABLE = "CREATE TABLE IF NOT EXISTS answers (key BLOB PRIMARY KEY, answer BLOB) WITHOUT ROWID"
#: seconds that another run is waited for
_WAIT = 30.0
#: bytes of a key, and of the checksum at the end of a record
_CHECKSUM = 16


class Cache:
    """Answers of a black box by `black_box.identity_of` it, its inputs and their numbers, and its
    outputs.

    damaged : records so far whose checksum did not match; they are not used.

    Every method raises AccessError where the cache cannot be used.
    """

    damaged = 0

    def __init__(self, path: Path, model: bytes, inputs: Names, outputs: Names) -> None:
        self.path = path
        self._outputs = len(outputs)
        self._about = hashlib.blake2b(repr((model, inputs, outputs)).encode()).digest()
        with self._access():
            if path.is_symlink():
                raise sqlite3.Error("it is a link, which is not followed")
            self._database = sqlite3.connect(path, timeout=_WAIT)
            self._database.text_factory = bytes  # a text is no answer, whatever its letters
            # what a killed process has written stays; what a power cut damages is found by the
            # check, and by the checksums
            execute = self._database.execute
            execute("PRAGMA synchronous = OFF")
            execute(_TABLE)
            state = execute("PRAGMA quick_check(1)").fetchone()[0]
            if state != b"ok":
                raise sqlite3.Error(f"it is damaged: {state.decode(errors='replace')}")

    @contextlib.contextmanager
    def _access(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            raise AccessError(
                f"{as_text(self.path)} cannot be used ({as_text(error)}). --fresh starts without it"
            ) from error

    def _digest(self, *parts: bytes) -> bytes:
        return hashlib.blake2b(b"".join(parts), key=self._about, digest_size=_CHECKSUM).digest()

    def _keys(self, rows: Array) -> list[bytes]:
        """What rows (n, inputs) are stored by."""
        numbers = np.ascontiguousarray(rows + 0.0, "<f8")  # + 0.0: -0 is 0
        return [self._digest(row.tobytes()) for row in numbers]

    def read(self, rows: Array) -> tuple[Array, Flags]:
        """Of rows (n, inputs) the answers that are stored, (m, outputs), and whether each row is,
        (n,).
        """
        answers = []
        stored = np.zeros(len(rows), bool)
        size = 8 * self._outputs
        query = "SELECT answer FROM answers WHERE key = ?"
        with self._access():
            if self._database.execute("SELECT 1 FROM answers LIMIT 1").fetchone():
                for place, key in enumerate(self._keys(rows)):
                    for (record,) in self._database.execute(query, (key,)):
                        answer = record[:size] if isinstance(record, bytes) else b""
                        if record != answer + self._digest(key, answer):
                            self.damaged += 1
                            continue
                        answers.append(answer)
                        stored[place] = True
        return np.frombuffer(b"".join(answers), "<f8").reshape(-1, self._outputs), stored

    def write(self, rows: Array, answers: Array) -> None:
        """Store answers (n, outputs) to rows (n, inputs)."""
        values = [row.tobytes() for row in np.asarray(answers, "<f8")]
        records = [
            (key, answer + self._digest(key, answer))
            for key, answer in zip(self._keys(rows), values, strict=True)
        ]
        with self._access(), self._database:
            self._database.executemany("INSERT OR REPLACE INTO answers VALUES (?, ?)", records)

    def close(self) -> None:
        """Let go of the file."""
        self._database.close()
