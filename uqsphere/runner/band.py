"""How well a curve along a free scalar is known: the course of its band, and what one that is too wide would take."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.results import SpeedRow
from uqsphere.runner.campaign import evaluations_needed, rounded
from uqsphere.runner.curve_rows import half_widths
from uqsphere.units import told_apart

__all__ = ["ASKED", "KIND", "METHOD", "Band", "Stage", "stage_of"]

Array = npt.NDArray[np.float64]

#: half-width of the band over the smaller side of the probability that is asked of every curve
ASKED: Final = 0.06
KIND: Final = "half-width of the band over the smaller side of its probability"
METHOD: Final = "rows along the free scalar, beside a polynomial of them"
#: a course that was followed over this factor of evaluations, and fell by less than their power, does not fall
LONG, FLAT = 4.0, 0.25


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A curve after some rows: all `evaluations`, the largest half-width, the rows at the value that has it (`there`),
    those at all values wider than asked (`wide`), and the seconds since the run began."""

    evaluations: int
    half_width: float
    there: int
    wide: int
    seconds: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Band:
    """The course of a band, and what ended it: nothing, `budget`, `time` or `most` (rows at a value).

    `most` is the largest number of rows that one value is given, `share` the evaluations that the curve was allowed
    over the budget of the study; `method` is how its values were found.
    """

    course: tuple[Stage, ...]
    ended: str = ""
    most: int = 0
    share: float = 0.0
    asked: float = ASKED
    method: str = METHOD

    @property
    def half_width(self) -> float:
        return self.course[-1].half_width

    def needed(self) -> float | None:
        """Evaluations of the curve at which its band would be as narrow as asked; None where it does not fall.

        More rows go to the values that need them alone, so the law of half-widths is taken for the worst of them.
        """
        last = self.course[-1]
        if last.half_width <= self.asked:
            return float(last.evaluations)
        earlier = [(s.there, s.half_width) for s in self.course[:-1] if 0 < s.there < last.there]
        if earlier:
            first, wide = earlier[0]
            if last.there >= LONG * first and last.half_width > wide * (first / last.there) ** FLAT:
                return None
        factor = evaluations_needed([*earlier[:1], (last.there, last.half_width)], self.asked) / last.there
        return last.evaluations + (factor - 1.0) * last.wide

    def missed(self) -> str:
        """What is said of a band that is wider than asked: what it reached, and what it would take; or nothing."""
        last = self.course[-1]
        if last.half_width <= self.asked:
            return ""
        head = (
            f"the band of the curve: half-width {told_apart(last.half_width, self.asked)} of the smaller side of its "
            f"probability, asked {self.asked:g}"
        )
        needed = self.needed()
        if needed is None:
            return f"{head} (it has not fallen as evaluations do it: how many would reach it is not known)"
        text = f"about {rounded(needed):,} evaluations of the curve would reach it"
        worst = last.there * (1.0 + (needed - last.evaluations) / max(last.wide, 1))
        if worst > self.most:
            return f"{head} ({text}, but no value is given more than {self.most:,})"
        if self.ended == "time":
            return f"{head} ({text}; the time was over, or the run was stopped)"
        if self.share > 0.0:
            text += f", which a budget of about {rounded(needed / self.share):,} has room for"
        return f"{head} ({text})"

    def table(self) -> dict[str, Any]:
        """The entry of results.json."""
        last, needed = self.course[-1], self.needed()
        return {
            "half_width": last.half_width,
            "asked": self.asked,
            "evaluations": last.evaluations,
            "needed": None if needed is None else rounded(needed),
        }

    def rows(self, name: str) -> list[SpeedRow]:
        """Rows of the speed-error table."""
        return [
            SpeedRow(
                method=self.method,
                quantity=f"margins.{name}",
                evaluations=stage.evaluations,
                error=stage.half_width,
                error_kind=KIND,
            )
            for stage in self.course
        ]


def stage_of(curve: Array, counts: Array, least: float, evaluations: int, seconds: float = 0.0) -> Stage:
    """A curve (J, R) with `counts` (J,) rows at its values, where the smaller side is not below `least`."""
    widths, side = half_widths(curve)
    widths = np.where(side >= least, widths, 0.0)
    at = int(np.argmax(widths))
    return Stage(
        evaluations=evaluations, half_width=float(widths[at]), there=int(counts[at]),
        wide=int(counts[widths > ASKED].sum()), seconds=seconds,
    )  # fmt: skip
