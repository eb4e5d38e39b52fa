"""A fault of a study file: where it is, and the words in which it is told."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from difflib import get_close_matches

from uqsphere.errors import as_text
from uqsphere.units import bare_number

Place = tuple[str | int, ...]


class Fault(ValueError):
    """A fault of one part of a value: `at` is the way to it."""

    def __init__(self, message: str, *at: str | int) -> None:
        super().__init__(message)
        self.at: Place = tuple(part for part in at if part != "")


@contextmanager
def within(*at: str | int) -> Iterator[None]:
    """A fault inside lies on the way `at`."""
    try:
        yield
    except Fault as error:
        raise Fault(str(error), *at, *error.at) from None


def path_of(place: Place) -> str:
    """A place as users write it.

    >>> path_of(("dependence", 0, "of"))
    'dependence[0].of'
    """
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).removeprefix(".")


def shown(value: object, longest: int = 60) -> str:
    """A value of a file as its message shows it."""
    if isinstance(value, Mapping | list | tuple):
        return "a table" if isinstance(value, Mapping) else "an array"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return bare_number(value)
    if isinstance(value, str):
        return json.dumps(as_text(value, longest), ensure_ascii=False)
    return f"a {type(value).__name__}"


def one_of(words: Iterable[str]) -> str:
    """Words as a list in a sentence.

    >>> one_of(["a", "b", "c"])
    'a, b or c'
    """
    *first, last = list(words) or ["none"]
    return f"{', '.join(first)} or {last}" if first else last


def suggestion(word: object, known: Iterable[str]) -> str:
    """A hint at the known word that was likely meant."""
    near = get_close_matches(str(word)[:80], list(known), n=1)
    return f"; did you mean '{near[0]}'?" if near else ""


def unknown(what: str, word: object, known: Iterable[str]) -> str:
    """The message for a word that is none of those known."""
    names = list(known)
    return f"unknown {what} {shown(word)}, known: {one_of(names[:40])}{suggestion(word, names)}"
