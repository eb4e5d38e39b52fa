"""Every accuracy that a run was asked for: what was reached, and what the rest would take."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final

from uqsphere.runner.work import Work
from uqsphere.uq.estimates import Estimate

if TYPE_CHECKING:
    from uqsphere.runner.results import Findings
    from uqsphere.runner.sensitivity import Sensitivity

__all__ = ["SMALL", "questions"]

SMALL: Final = "so small that nothing hangs on it: no accuracy is pursued"
#: the number of evaluations that a sentence about a missed accuracy names
_NEEDED: Final = re.compile(r"(?:about|take|\() ?([\d,]+) evaluations")


def questions(work: Work, found: Findings, missed: Sequence[str]) -> list[dict[str, Any]]:
    """A row for every question: quantity, question, asked, reached, met, evaluations, needed, and the sentence.

    `reached` is the half-width of the 95 % interval in the unit of what was asked; `met` is None where nothing hangs
    on it.  `needed` and the sentence are those of the accuracies that were `missed`.
    """
    rows = []
    for quantity, question, asked, reached, evaluations, start, exempt in _asked(work, found):
        told = [text for text in missed if text.startswith(start)]
        numbers = [int(number.replace(",", "")) for text in told for number in _NEEDED.findall(text)]
        late = bool(told) or reached is None or reached > asked
        rows.append(
            {
                "quantity": quantity,
                "question": question,
                "asked": asked,
                "reached": reached,
                "met": None if late and not told and exempt else not late,
                "evaluations": evaluations,
                "needed": max(numbers) if told and numbers else None,
                "text": "; ".join(told) if told else (exempt if late else ""),
            }
        )
    return rows


_Row = tuple[str, str, float, float | None, int | None, str, str]


def _asked(work: Work, found: Findings) -> Iterator[_Row]:
    """What is asked, and the beginning of the sentence that says it was missed."""
    asked = work.study.analysis.accuracy
    for name, one in found.sampled.descriptions.items():
        if not one.scale > 0.0:
            continue
        counted = [e for p, e in one.quantiles.items() if p not in one.exempt]
        if one.mean.value is not None:
            yield (name, "mean, over the standard deviation", asked.mean, *_worst([one.mean], one.scale),
                   f"{name}: mean", "")  # fmt: skip
        if counted:
            yield (name, "worst quantile, over the standard deviation", asked.quantile, *_worst(counted, one.scale),
                   f"{name}: quantile", "")  # fmt: skip
    for name, indices in found.sensitivity.items():
        given = _indices(indices)
        refused = indices.text if not indices.missed else ""
        yield (name, "worst index", asked.sobol, *_worst(given, 1.0), f"{name}: indices", refused)
    for name, limit in found.sampled.limits.items():
        for which in ("exceedance", "miss") if limit.aim == "break" else ("miss",):
            estimate: Estimate = getattr(limit, which)
            said = "of missing the aim" if which == "miss" else "of exceedance"
            reached = _worst([estimate], estimate.value or math.nan)
            yield (f"limits.{name}", f"probability {said}, over itself", asked.probability, *reached,
                   f"limit {name}: {which}", SMALL if limit.beneath(which) else "")  # fmt: skip
    for name, margin in found.margins.items():
        for at, band in ([("", margin.band)] if margin.band else []) + list(margin.bands.items()):
            last, where = band.course[-1], f"at {at}: " if at else ""
            yield (f"margins.{name}{' at ' * bool(at)}{at}", "band of the curve, over the smaller side", band.asked,
                   last.half_width, last.evaluations, f"margins {name}: {where}the band", "")  # fmt: skip
        for at, coarse in ([("", margin.coarse)] if margin.coarse else []) + list(margin.steps.items()):
            where = f"at {at}: " if at else ""
            yield (f"margins.{name}{' at ' * bool(at)}{at}", "largest step of the curve, in normal scores",
                   coarse.asked, coarse.step, coarse.evaluations, f"margins {name}: {where}the steps", "")  # fmt: skip


def _worst(estimates: Sequence[Estimate], scale: float) -> tuple[float | None, int | None]:
    """The largest half-width over a scale, and the evaluations behind it; None where there is no answer."""
    known = [(e.half_width / scale, e.evaluations) for e in estimates if e.value is not None and scale > 0.0]
    known = [pair for pair in known if math.isfinite(pair[0])]
    return max(known, default=(None, None))


def _indices(found: Sensitivity) -> list[Estimate]:
    rows = [found.first, found.total, found.second, found.group_first, found.group_total, found.shapley]
    return [e for row in (*rows, *found.kucherenko.values()) for e in row.values()]
