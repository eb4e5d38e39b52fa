"""What stands behind a verdict: its reasons, the ways to break that it was judged by, what it takes for granted."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, StrictBool, StrictStr, model_validator

from uqsphere.results.entries import Aim, Count, Entry, Name, Number, Part, Probability, Share

Code = Literal["a", "b", "c", "d", "e", "f", "together"]
Word = Literal["met", "not met", "undecided", "not established"]


class ReasonEntry(Entry):
    """Why a verdict is what it is, in a clause.

    Not established: `a` the static contact law, `b` the carriers, `c` an assumed strength, `d` what the tests leave
    open, `e` a check of the model that fails, `f` tests that are made up.  `together`: the limit by itself has another.
    """

    code: Code
    text: StrictStr


class JudgedEntry(Entry):
    """A way to break by itself: the probability that it misses the aim, and the free scalar at the target's.

    `assumed`: its strength is the library's, of `source`; `range` are the probabilities over the strength's 95 %, and
    `curve` holds values of the free scalar with the probability that the strength is exceeded there.
    """

    name: StrictStr
    quantity: StrictStr
    assumed: StrictBool
    miss: Probability
    range: tuple[Share, Share] | None = None
    answer: Number | None = None
    source: StrictStr = ""
    seen: StrictBool | None = None
    curve: tuple[tuple[Number, Share], ...] = ()


class VerdictEntry(Entry):
    """A verdict on fracture for an aim and its target: of all ways judged together, `miss` by the study's own limits.

    `governing` is the one that asks most, `answer` the free scalar `solve` that keeps the aim by the study's limits.
    """

    aim: Aim
    target: Share | None
    verdict: Word | None
    reasons: tuple[ReasonEntry, ...]
    miss: Probability
    judged: tuple[JudgedEntry, ...]
    not_judged: dict[Name, StrictStr]
    governing: StrictStr
    solve: StrictStr = ""
    answer: Number | None = None


class AssumedEntry(Entry):
    """An assumption on a strength, and the probability of missing the aim with another in its place."""

    assumption: Literal["dependence", "modulus", "cov", "law"]
    taken: Number | StrictStr | None = None
    instead: Number | StrictStr | None = None
    others: tuple[StrictStr, ...] = Field(default=(), alias="with")
    miss: Probability
    met: StrictBool | None

    @model_validator(mode="after")
    def _whole(self) -> Self:
        due = {"dependence": list, "law": str}.get(self.assumption, float)
        for value in (self.taken, self.instead):
            fits = {list: value is None, str: isinstance(value, str), float: isinstance(value, (int, float))}[due]
            if not fits:
                raise ValueError(f"found {value!r}, which is no {self.assumption}")
        return self


class SettlingEntry(Part):
    """How many tests of a strength would settle whether the target is kept."""

    NEEDS = ("tests", "confidence")

    tests: Count | None = None
    confidence: Share = 0.0
    reason: StrictStr | None = None
