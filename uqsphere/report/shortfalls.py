"""Accuracies that were not reached, as people are told them: those of one reason and one cost in one sentence."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

__all__ = ["SUBJECTS", "shortfalls"]

#: subjects that a sentence in the terminal names
SUBJECTS: Final = 6

#: a half-width with what was asked, and quantiles that too few samples lie beyond: what differs stands in the list
_HALF: Final = re.compile(r"(.+): half-width (\S+)( of [^,]+)?, asked ([^\s:;]+)(.*)")
_BAND: Final = ": the band of the curve"
_BEYOND: Final = re.compile(r"(.+): too few samples beyond the \S+ quantile(.*)")
_MOMENT: Final = re.compile(r"(.+?: (?:mean|quantile \S+)): (.*)")


def shortfalls(texts: Sequence[str], most: int) -> list[str]:
    """The sentences of `accuracy.missed` of results.json, those that differ in nothing but their subject as one.

    One names at most so many subjects, and says how many more there are; a sentence that stands alone stays as it is.

    >>> texts = [f"y: quantile {p}: half-width {w} of the standard deviation, asked 0.05 (given up)"
    ...          for p, w in ((0.05, 0.16), (0.5, 0.11), (0.95, 0.12))]
    >>> shortfalls(texts, 2)
    ['y quantile 0.05 (0.16), y quantile 0.5 (0.11) and 1 more: half-width above the 0.05 of the standard deviation that was asked (given up)']
    >>> shortfalls(["y: indices: none: a reason", "z: indices: none: a reason"], 2)
    ['y, z: indices: none: a reason']
    """  # noqa: E501
    groups: dict[str, list[tuple[str, str]]] = {}
    for text in texts:
        reason, subject = _parted(text)
        groups.setdefault(reason, []).append((subject, text))
    return [_together(reason, group, most) for reason, group in groups.items()]


def _parted(text: str) -> tuple[str, str]:
    """Reason and cost of a sentence, and what it is said of."""
    if found := _HALF.fullmatch(text):
        head, width, scale, asked, rest = found.groups(default="")
        name = head.removesuffix(_BAND)
        what = _BAND.removeprefix(": ") + ": " if name != head else ""
        return f"{what}half-width above the {asked}{scale} that was asked{rest}", f"{_subject(name)} ({width})"
    if found := _BEYOND.fullmatch(text):
        return f"too few samples beyond the quantile{found[2]}", _subject(found[1])
    if found := _MOMENT.fullmatch(text):
        return found[2], _subject(found[1])
    head, _, rest = text.partition(": ")
    return rest, head


def _subject(head: str) -> str:
    return head.replace(": ", " ")


def _together(reason: str, group: Sequence[tuple[str, str]], most: int) -> str:
    if len(group) == 1:
        return group[0][1]
    more = f" and {len(group) - most} more" if len(group) > most else ""
    return f"{', '.join(subject for subject, _ in group[:most])}{more}: {reason}"
