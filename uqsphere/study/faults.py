"""Collecting the faults of a study: where each stands in the table, what it says, what is left to check."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from uqsphere.errors import Problem
from uqsphere.units import bare_number

#: what TOML can hold: numbers, texts, dates, lists and tables
Raw = Any
#: The way to a value: keys and array indices from the top of the file, ``("dependence", 0, "of")``.
Place = tuple[str | int, ...]

#: More faults than this are counted, not listed.
MOST_PROBLEMS = 100


class Misplaced(ValueError):
    """A fault of one part of a value: `at` is the way to it."""

    def __init__(self, message: str, *at: int | str) -> None:
        super().__init__(message)
        self.at: Place = tuple(part for part in at if part != "")


@dataclass(frozen=True, kw_only=True)
class Findings:
    """The faults and warnings met so far: the one thing that grows while a study is read.

    `folder` is the study's own, outside of which no file is read.
    """

    folder: Path = Path()
    faults: list[tuple[Place, str]] = field(default_factory=list)
    spoiled: set[Place] = field(default_factory=set)
    warnings: list[str] = field(default_factory=list)

    def add(self, place: Place, message: str) -> None:
        """Note a fault; whatever stands at `place` is spoiled, and its absence is no further fault."""
        self.faults.append((place, message))
        self.spoiled.add(place)

    def lack(self, place: Place, message: str) -> None:
        """Note that something is missing, unless what stands there was faulty."""
        if self.clean(place):
            self.add(place, message)

    def warn(self, place: Place, message: str) -> None:
        """Note something that a user should know and that does not stop the study."""
        self.warnings.append(f"{render_place(place)}: {message}" if place else message)

    @contextmanager
    def noting(self, place: Place) -> Iterator[None]:
        """Note a fault of something at `place` that is raised inside, and go on behind."""
        try:
            yield
        except Misplaced as error:
            self.add((*place, *error.at), str(error))

    def touched(self, place: Place) -> bool:
        """Whether `place`, or something around it, was faulty already."""
        return any(place[:length] in self.spoiled for length in range(1, len(place) + 1))

    def clean(self, place: Place) -> bool:
        """Whether nothing at, around or below `place` was faulty."""
        return not self.touched(place) and not any(other[: len(place)] == place for other in self.spoiled)

    def problems(self, positions: Mapping[Place, tuple[int, int]], overridden: Sequence[Place] = ()) -> list[Problem]:
        """Every fault with its line and column: that of the value, or of the nearest thing around it."""
        found: list[Problem] = []
        for place, message in dict.fromkeys(self.faults):
            if any(place[: len(other)] == other for other in overridden):
                message = f"{message} (set from outside the file)"
            line, column = next(
                (positions[place[:length]] for length in range(len(place), 0, -1) if place[:length] in positions),
                (1, 1),
            )
            found.append(Problem(line=line, column=column, path=render_place(place), message=message))
        found.sort()
        if len(found) > MOST_PROBLEMS:
            # The remark stands where the first fault stands that is not listed, after those that are.
            last, left_out = found[MOST_PROBLEMS - 1], found[MOST_PROBLEMS]
            column = max(left_out.column, last.column + 1) if left_out.line == last.line else left_out.column
            said = f"… and {len(found) - MOST_PROBLEMS} more faults from here on"
            more = Problem(line=left_out.line, column=column, path="", message=said)
            found = [*found[:MOST_PROBLEMS], more]
        return found


def render_place(place: Place) -> str:
    """A place as it is written in messages.

    >>> render_place(("dependence", 0, "of"))
    'dependence[0].of'
    >>> render_place(("sphere", "a b"))
    'sphere."a b"'
    """
    text = ""
    for part in place:
        if isinstance(part, int):
            text += f"[{part}]"
            continue
        bare = part.replace("_", "a").replace("-", "a")
        plain = part if bare.isascii() and bare.isalnum() else shown(part)
        text += f".{plain}" if text else plain
    return text


def shown(value: object, longest: int = 60) -> str:
    """A value of the file as it would be written there, shortened.

    >>> shown("10 mm"), shown(True), shown([1, 2]), shown({})
    ('"10 mm"', 'true', 'an array', 'a table')
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        text = value if len(value) <= longest else value[: longest - 1] + "…"
        return json.dumps(text, ensure_ascii=False)
    if isinstance(value, (int, float)):
        # An integer of thousands of digits cannot be turned into text at all.
        if isinstance(value, int) and abs(value) >= 1 << 64:
            return "an integer of more than 64 bits"
        return bare_number(value)
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, (list, tuple)):
        return "an array"
    return "a date or a time"


def suggestion(found: str, allowed: Iterable[str]) -> str:
    """``; did you mean 'x'?`` where one of the allowed names is near enough, else nothing.

    >>> suggestion("sped", ["speed", "length"])
    "; did you mean 'speed'?"
    """
    near = nearest(found, allowed)
    return f"; did you mean '{near}'?" if near else ""


def unknown(what: str, found: object, known: Iterable[str], most: int | None = None) -> str:
    """That a name is none of those known, which are listed, with the one that was meant.

    >>> print(unknown("rig", "bar", ["bars", "impact"]))
    unknown rig "bar", known: bars or impact; did you mean 'bars'?
    """
    names = list(known)
    return f"unknown {what} {shown(found)}, known: {one_of(names[:most])}{suggestion(str(found), names)}"


def nearest(found: str, allowed: Iterable[str]) -> str | None:
    """The allowed name that is most like what was found, if one is near enough."""
    from difflib import get_close_matches

    # difflib is quadratic in the length: a monster of a key gets no suggestion.
    if len(found) > 64:
        return None
    names = sorted(set(allowed))
    if near := get_close_matches(found, names, n=1, cutoff=0.6):
        return near[0]
    folded = {name.casefold(): name for name in names}
    near = get_close_matches(found.casefold(), list(folded), n=1, cutoff=0.6)
    return folded[near[0]] if near else None


def one_of(names: Iterable[str]) -> str:
    """The allowed names as text: ``a, b or c``."""
    listed = list(names)
    return listed[0] if len(listed) == 1 else f"{', '.join(listed[:-1])} or {listed[-1]}"
