"""A word on stderr where a model takes the whole process of its run with it, which then can say nothing itself."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
from collections.abc import Iterator

__all__ = ["KILLED", "last_words"]

KILLED = (
    "uqsphere: the process of this run ended before the run did: the model ended it, or it was killed, as where memory "
    "runs out. What was evaluated is kept, and the same command goes on with it. With a time_limit in [analysis] every "
    "evaluation is made in a process of its own, whose end is a failed evaluation."
)


@contextlib.contextmanager
def last_words(text: str) -> Iterator[None]:
    """Have `text` said on stderr if this process ends inside the block without leaving it.

    A shell waits for the end of a pipe of which this process alone holds the other end.  Without a shell
    nothing is said.
    """
    shell = shutil.which("sh")
    if shell is None:
        yield
        return
    waiting = subprocess.Popen(
        [shell, "-c", 'read left || printf "%s\\n" "$1" >&2', "sh", text],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C is for the run
    )
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            waiting.communicate(b"left\n")
