"""The error family: one exit code each, and a message a user can act on."""

import sys
from dataclasses import dataclass
from operator import index
from typing import SupportsIndex


def as_text(value: object, longest: int = 300) -> str:
    """The text of anything from outside as one short line that can be printed; raises nothing but
    KeyboardInterrupt.

    >>> as_text("a\\x1b[2J  b"), as_text("x" * 1000, 5)
    ('a?[2J b', 'xxxx…')
    """
    try:
        # what comes behind is not looked at: the blanks between words alone could be megabytes
        text = str(value)[: 64 * longest]
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        return f"(its text cannot be had: {type(error).__name__})"
    text = "".join(mark if mark.isprintable() else "?" for mark in " ".join(text.split()))
    if len(text) > longest:
        return f"{text[: longest - 1]}…"
    return text


def tell(text: object) -> None:
    """Print a note for the user: the standard output is for answers."""
    print(text, file=sys.stderr, flush=True)


class UqsphereError(Exception):
    """Base of every error that uqsphere raises on purpose."""

    exit_code = 1


class UsageError(UqsphereError):
    """A command or a function was called with something it cannot take."""

    exit_code = 2


def whole(value: SupportsIndex, name: str, least: int = 0) -> int:
    """A whole number that a caller gives; UsageError for any other, and for a smaller one.

    >>> whole(2.5, "count")
    Traceback (most recent call last):
    ...
    uqsphere.errors.UsageError: count must be a whole number from 0 on, not 2.5
    """
    try:
        number = index(value)
    except TypeError:
        number = least - 1
    if number < least:
        raise UsageError(f"{name} must be a whole number from {least} on, not {value!r}")
    return number


def path_of(*parts: str | int) -> str:
    """A place as users write it: keys, numbers of entries, and places inside of these.

    >>> path_of("dependence", 0, "of"), path_of("limits.high", "", "values[1]")
    ('dependence[0].of', 'limits.high.values[1]')
    """
    path = ""
    for part in parts:
        if part != "":
            path += f"[{part}]" if isinstance(part, int) else f".{part}"
    return path.replace(".[", "[").removeprefix(".")


class Fault(ValueError):
    """A fault of one part of what was given: `key` is the way to it, as users write it."""

    def __init__(self, message: str, *at: str | int) -> None:
        super().__init__(message)
        self.key = path_of(*at)


@dataclass(frozen=True, kw_only=True, order=True)
class Problem:
    """One fault of an input file, with the line where it stands, from 1."""

    line: int
    path: str
    message: str

    def render(self, file: object) -> str:
        """``file:line: path: message``, without the file where there is none, and without the path
        where the file as a whole is meant.
        """
        parts = [self.path, self.message]
        if file:
            parts = [f"{as_text(file)}:{self.line}", *parts]
        return ": ".join(filter(None, parts))


class StudyError(UsageError):
    """A study or another input file cannot be used; carries the faults that were found."""

    def __init__(self, file: object, problems: list[Problem]) -> None:
        self.problems = sorted(problems)
        super().__init__("\n".join(problem.render(file) for problem in self.problems))


class TooManyFailures(UqsphereError):
    """More evaluations failed than the study's policy lets pass."""

    exit_code = 4


class ModelError(UqsphereError):
    """The user model failed, or returned something of the wrong form."""

    exit_code = 4


class ModelRaised(ModelError):
    """The user model raised an exception; one of its rows may be the cause."""


class ExecutorLost(UqsphereError):
    """The executor of the user went away; what was answered by then is stored."""

    exit_code = 7


class FolderError(UqsphereError):
    """A result folder is locked, belongs to another study, or is damaged."""

    exit_code = 5


class AccessError(UqsphereError):
    """The operating system refused to read or write (disk full, permission, missing file)."""

    exit_code = 6
