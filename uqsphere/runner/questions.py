"""Every accuracy that a run was asked for: what was reached, and what the rest would take."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final

from uqsphere.runner.stopping import Cost, Missed, rounded
from uqsphere.runner.work import Work
from uqsphere.uq.estimates import Estimate

if TYPE_CHECKING:
    from uqsphere.runner.results import Findings
    from uqsphere.runner.sensitivity import Sensitivity

__all__ = ["SMALL", "questions"]

SMALL: Final = "so small that nothing hangs on it: no accuracy is pursued"


def questions(work: Work, found: Findings, missed: Sequence[Missed]) -> list[dict[str, Any]]:
    """A row for every question: quantity, question, asked, reached, met, evaluations, needed, and the sentence.

    `reached` is the half-width of the 95 % interval in the unit of what was asked; `met` is None where nothing hangs
    on it.  `needed` and the sentence are those of the accuracies that were `missed`; `needed` is None where it is not
    known of one of them.
    """
    rows = []
    for quantity, question, asked, reached, evaluations, told, exempt in _asked(work, found, missed):
        known = [one.cost.needed for one in told if one.cost.needed is not None]
        late = bool(told) or reached is None or reached > asked
        rows.append(
            {
                "quantity": quantity,
                "question": question,
                "asked": asked,
                "reached": reached,
                "met": None if late and not told and exempt else not late,
                "evaluations": evaluations,
                "needed": max(known) if known and len(known) == len(told) else None,
                "text": "; ".join(one.text for one in told) if told else (exempt if late else ""),
            }
        )
    return rows


_Row = tuple[str, str, float, float | None, int | None, Sequence[Missed], str]


def _asked(work: Work, found: Findings, missed: Sequence[Missed]) -> Iterator[_Row]:
    """What is asked, what of it was missed, and why a shortfall without a sentence is none."""
    asked = work.study.analysis.accuracy
    told: defaultdict[tuple[str, str], list[Missed]] = defaultdict(list)
    for one in missed:
        told[one.subject, one.kind].append(one)
    for name, described in found.sampled.descriptions.items():
        if not described.scale > 0.0:
            continue
        counted = [e for p, e in described.quantiles.items() if p not in described.exempt]
        if described.mean.value is not None:
            yield (name, f"mean, over {described.scale_name}", asked.mean, *_worst([described.mean], described.scale),
                   told[name, "mean"], "")  # fmt: skip
        if counted:
            yield (name, f"worst quantile, over {described.scale_name}", asked.quantile,
                   *_worst(counted, described.scale), told[name, "quantile"], "")  # fmt: skip
    for name, indices in found.sensitivity.items():
        refused = indices.text if not indices.missed else ""
        yield (name, "worst index", asked.sobol, *_worst(_indices(indices), 1.0), told[name, "indices"], refused)
    for name, limit in found.sampled.limits.items():
        for which in ("exceedance", "miss") if limit.aim == "break" else ("miss",):
            estimate: Estimate = getattr(limit, which)
            said = "of missing the aim" if which == "miss" else "of exceedance"
            reached = _worst([estimate], estimate.value or math.nan)
            yield (f"limits.{name}", f"probability {said}, over itself", asked.probability, *reached,
                   told[f"limits.{name}", which], SMALL if limit.beneath(which) else "")  # fmt: skip
    for name, margin in found.margins.items():
        for at, band in {"": margin.band, **margin.bands}.items():
            if band is not None:
                curve = _curve(name, at, "band", band.missed(), band.table()["needed"])
                yield (curve.subject, "band of the curve, over the smaller side", band.asked, band.half_width,
                       band.course[-1].evaluations, [curve] * bool(band.missed()), "")  # fmt: skip
        for at, steps in {"": margin.coarse, **margin.steps}.items():
            if steps is not None:
                curve = _curve(name, at, "steps", steps.missed(), rounded(steps.needed))
                yield (curve.subject, "largest step of the curve, in normal scores", steps.asked, steps.step,
                       steps.evaluations, [curve], "")  # fmt: skip


def _curve(name: str, at: str, kind: str, text: str, needed: int | None) -> Missed:
    """What is said of the curve of a limit, or of one of its family."""
    subject, head = (f"margins.{name} at {at}", f"{name}: at {at}") if at else (f"margins.{name}", name)
    return Missed(subject=subject, kind=kind, said=f"margins {head}: {text}", cost=Cost(needed=needed))


def _worst(estimates: Sequence[Estimate], scale: float) -> tuple[float | None, int | None]:
    """The largest half-width over a scale, and the evaluations behind it; None where there is no answer."""
    known = [(e.half_width / scale, e.evaluations) for e in estimates if e.value is not None and scale > 0.0]
    known = [pair for pair in known if math.isfinite(pair[0])]
    return max(known, default=(None, None))


def _indices(found: Sensitivity) -> list[Estimate]:
    rows = [found.first, found.total, found.second, found.group_first, found.group_total, found.shapley]
    return [e for row in (*rows, *found.kucherenko.values()) for e in row.values()]
