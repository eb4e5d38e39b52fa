"""What a run found, and its account: beside each part what was planned and what it took, and why they differ."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.quantities import format_value
from uqsphere.results import (
    AnalysisEntry,
    FractureEntry,
    GivenFailureEntry,
    PartEntry,
    QuestionRow,
    Results,
    SpeedRow,
    ToleranceEntry,
)
from uqsphere.results.entries import CarriedEntry, CheckEntry, Curve, Est
from uqsphere.runner.campaign import INDEX_KIND, MEAN_KIND, MISS_KIND, QUANTILE_KIND, Cost, Missed
from uqsphere.runner.evaluate import Work
from uqsphere.runner.forecast import forecast
from uqsphere.uq.estimate import Estimate

if TYPE_CHECKING:
    from uqsphere.runner.drivers import Drivers
    from uqsphere.runner.fidelity import Pilot
    from uqsphere.runner.questions.distributions import Sampled
    from uqsphere.runner.questions.indices import Sensitivity
    from uqsphere.runner.questions.margins import MarginAnswer
    from uqsphere.runner.similarity import Tabled
    from uqsphere.runner.verdict import Evidence, Unsure
    from uqsphere.study.document import Accuracy as Accuracies


@dataclass(frozen=True, kw_only=True)
class Findings:
    """All that a run found, before it is written down."""

    pilot: Pilot
    sampled: Sampled
    sensitivity: dict[str, Sensitivity]
    drivers: Drivers
    tabled: Tabled
    margins: dict[str, MarginAnswer] = field(default_factory=dict)
    tolerance: dict[str, ToleranceEntry] = field(default_factory=dict)
    analyses: dict[str, AnalysisEntry] = field(default_factory=dict)
    stops: dict[str, str] = field(default_factory=dict)
    evidence: Evidence | None = None
    fracture: FractureEntry | None = None
    carried: Mapping[str, CarriedEntry] = field(default_factory=dict)
    far: Sequence[CheckEntry] = ()
    unsure: Unsure | None = None


#: factor between planned and taken from which on a reason is given
FACTOR: Final = 2.0
#: what sampling answers, by how the names of its errors begin
_ANSWERS: Final = {QUANTILE_KIND: "The worst quantile", MEAN_KIND: "The mean", MISS_KIND: "The probability"}
#: why stages end before the accuracy is reached
_ENDED: Final = {
    "evaluations": "the next stage would have passed the budget",
    "time": "the time was over, or the run was stopped",
    "out of reach": "what is left was seen to be out of the budget's reach and given up",
    "failures": "rows without an answer ended it",
}
_SEARCHES: Final = ("importance sampling", "subset simulation")
_MOMENT: Final = "The moment of fracture takes rows of the full model, at the value planned or along the load."
#: why a part takes less than was likely, and why it takes more
_REASONS: Final = {
    "pilot": ("Fewer models were compared than there are.", "The first runs of the model were timed."),
    "sampling": ("The quantities are smoother than was assumed, and their errors fell faster.", ""),
    "sensitivity": ("Fewer runs were paired for the indices than was assumed.", ""),
    "surrogate": ("The model is smoother than was assumed, and fewer runs gave the accuracy.",
                  "The model is less smooth than was assumed, and the surrogate needed more runs."),
    "rare events": ("Sampling had the probabilities well enough already.",
                    "The search for the design points took more than the least that it can."),
    "margins": ("The first rows were enough.",
                "The bands, or the values asked for, took more rows than the first ones, or a demand jumps."),
    "fracture": (_MOMENT, _MOMENT),
}  # fmt: skip


def account(work: Work, found: Findings, *, planned: bool, surrogate: bool, affordable: int) -> tuple[PartEntry, ...]:
    """Every part with the evaluations that were likely, the most, and those taken.

    Parameters
    ----------
    work : the run, its ledger closed for every part.
    found : what the run found: why its stages ended.
    planned, surrogate : whether it was to be answered through a surrogate, and whether it was.
    affordable : evaluations that the budget had room for.
    """
    parts = {part.name: part for part in forecast(work.study, affordable, planned)}
    taken = {name: sum(spent.values()) for name, spent in work.ledger.parts.items()}
    rows = []
    for name in [*parts, *(name for name in taken if name not in parts and taken[name])]:
        likely, most = (parts[name].likely, parts[name].most) if name in parts else (0, 0)
        spent, why = taken.get(name, 0), ""
        if max(likely, spent, 1) > FACTOR * max(min(likely, spent), 1):
            why = _why(name, work, found, more=spent > likely, surrogate=surrogate)
            if planned and not surrogate and not likely and name != "surrogate":
                why = "A surrogate was not good enough, and the model was sampled."
            elif not (why or spent):
                why = "Nothing was left for it."
        rows.append(PartEntry(part=name, likely=likely, most=most, taken=spent, why=why))
    return tuple(rows)


def _why(part: str, work: Work, found: Findings, *, more: bool, surrogate: bool) -> str:
    """Why a part took much more or less than was likely, in a sentence; nothing where that is not known."""
    ended = _ENDED.get(found.stops.get("sensitivity" if part == "sensitivity" else "sampling", ""), "")
    staged = part in ("sampling", "sensitivity")
    if staged and more:
        late = f"; it ended since {ended}" if ended else ""
        return f"{_slowest(part, work.ledger.rows)} took more points than a smooth, nearly normal quantity does{late}."
    if part == "surrogate" and not surrogate:
        return "The surrogate was found too rough, and no more runs were made for it."
    if (staged or part == "surrogate") and not more and ended:
        return f"It ended early: {ended}."
    if part == "rare events" and more and any(row.method in _SEARCHES for row in work.ledger.rows):
        return "A probability was too small for plain sampling, and its failures were searched for."
    return _REASONS.get(part, ("", ""))[more]


def _slowest(part: str, history: Sequence[SpeedRow]) -> str:
    """The answer of a part with the largest error over its standard deviation, as it is called."""
    told = {INDEX_KIND: "The indices"} if part == "sensitivity" else _ANSWERS
    last = {
        (row.quantity, head): float(row.error or 0.0)
        for row in history
        for head in told
        if row.error_kind.startswith(head)
    }
    if not last:
        return "It"
    quantity, head = max(last, key=lambda key: last[key])
    return f"{told[head]} of {quantity.removeprefix('limits.')}"


# --- Every accuracy that a run was asked for: what was reached, and what the rest would take.

NO_MATTER: Final = "so small that nothing hangs on it: no accuracy is pursued"


def questions(work: Work, found: Findings, missed: Sequence[Missed]) -> tuple[QuestionRow, ...]:
    """A row for every accuracy: asked, reached, met, the evaluations behind it, those needed, and the sentence.

    `reached` is the half-width of the 95 % interval in the unit of what was asked; `met` is None where nothing hangs
    on it.  `needed` and the sentence are those of the accuracies that were `missed`; `needed` is None where it is not
    known of one of them.
    """
    told: defaultdict[tuple[str, str], list[Missed]] = defaultdict(list)
    for one in missed:
        told[one.subject, one.kind].append(one)
    rows = [
        _row(name, question, wanted, _worst(estimates, scale), told[name, kind], exempt)
        for name, question, kind, wanted, estimates, scale, exempt in _pursued(work.study.analysis.accuracy, found)
        if math.isfinite(wanted)
    ]
    for name, margin in found.margins.items():
        rows += _of_curves(name, margin)
    return tuple(rows)


def _pursued(
    asked: Accuracies, found: Findings
) -> Iterator[tuple[str, str, str, float, Sequence[Estimate], float, str]]:
    """Of what, what it is called, its kind, what is asked, the estimates, their scale, and why a shortfall is none."""
    for name, described in found.sampled.descriptions.items():
        scale, over = described.scale, described.scale_name
        counted = [e for p, e in described.quantiles.items() if p not in described.exempt]
        if scale > 0.0 and described.mean.value is not None:
            yield name, f"mean, over {over}", "mean", asked.mean, [described.mean], scale, ""
        if scale > 0.0 and counted:
            yield name, f"worst quantile, over {over}", "quantile", asked.quantile, counted, scale, ""
    for name, indices in found.sensitivity.items():
        refused = "" if indices.missed else indices.text
        yield name, "worst index", "indices", asked.sobol, indices.estimates(), 1.0, refused
    words = {"exceedance": "exceedance", "miss": "missing the aim"}
    for name, limit in found.sampled.limits.items():
        for which in limit.pursued:
            estimate: Estimate = getattr(limit, which)
            question = f"probability of {words[which]}, over itself"
            exempt, scale = NO_MATTER * limit.beneath(which), estimate.value or math.nan
            yield f"limits.{name}", question, which, asked.probability, [estimate], scale, exempt


def _row(
    quantity: str,
    question: str,
    asked: float,
    reached: tuple[float | None, int | None],
    told: Sequence[Missed],
    exempt: str = "",
) -> QuestionRow:
    """One accuracy; `exempt` says why a shortfall without a sentence is none."""
    known = [one.cost.needed for one in told if one.cost.needed is not None]
    width, evaluations = reached
    late = bool(told) or width is None or width > asked
    return QuestionRow(
        quantity=quantity,
        question=question,
        asked=asked,
        reached=width,
        met=None if late and not told and exempt else not late,
        evaluations=evaluations,
        needed=max(known) if known and len(known) == len(told) else None,
        text="; ".join(one.text for one in told) if told else (exempt if late else ""),
    )


def _of_curves(name: str, margin: MarginAnswer) -> Iterator[QuestionRow]:
    """The bands of the curve of a limit and of those of its family."""
    for at, band in {"": margin.band, **margin.bands}.items():
        if band is None:
            continue
        subject, head = (f"margins.{name} at {at}", f"{name}: at {at}") if at else (f"margins.{name}", name)
        told = [
            Missed(subject=subject, kind="band", said=f"margins {head}: {text}",
                   cost=Cost(needed=band.table()["needed"]))
            for text in [band.missed()] if text
        ]  # fmt: skip
        question = "band of the curve, over the smaller side"
        yield _row(subject, question, band.asked, (band.half_width, band.evaluations), told)


def _worst(estimates: Sequence[Estimate], scale: float) -> tuple[float | None, int | None]:
    """The largest half-width over a scale, and the evaluations behind it; None where there is no answer."""
    known = [(e.half_width / scale, e.evaluations) for e in estimates if e.value is not None and scale > 0.0]
    known = [pair for pair in known if math.isfinite(pair[0])]
    return max(known, default=(None, None))


# --- Rows of the speed-error table for the answers that no stage pursues: they have the error that they come out with.

#: what each kind of error is called, and the accuracy of the study that it is measured by
FURTHER: Final[dict[str, str]] = {
    "half-width of the worst value over the spread of the curve": "quantile",
    "half-width of the probability of fracture over itself": "probability",
    "largest half-width of a share of the limits": "sobol",
    "half-width of the worst median at fracture over its spread": "quantile",
    "largest half-width of Borgonovo's delta": "sobol",
    "largest half-width of PAWN": "sobol",
    "largest half-width of an index of missing the aim": "sobol",
    "half-width of the worst mean of an input where the aim is missed, over its standard deviation": "mean",
}
_VALUE, _FRACTURE, _SHARE, _MEDIAN, _DELTA, _PAWN, _MISSING, _THERE = FURTHER
#: one standard deviation to either side of a median, and what the 5 and 95 % quantiles lie apart in those
_LOW, _HIGH, _APART = 0.1587, 0.8413, 3.29


def further_rows(results: Results) -> list[tuple[str, SpeedRow]]:
    """(part of the run, row) for every answer of results.json that has an interval and no course."""
    rows = []
    for part, quantity, kind, estimates, scale in _further(results):
        known = [e for e in estimates if e.value is not None and e.low is not None]
        worst = max(known, key=_half, default=None)
        if worst is not None and scale and scale > 0.0 and _half(worst) > 0.0:
            error, evaluations = _half(worst) / scale, int(worst.evaluations)
            rows.append((part, SpeedRow(method=worst.method, quantity=quantity, evaluations=evaluations, error=error,
                                        error_kind=kind)))  # fmt: skip
    return rows


def _further(results: Results) -> Iterator[tuple[str, str, str, Iterable[Est], float | None]]:
    """Part, quantity, kind, the estimates whose worst tells the error, and its scale."""
    for name, margin in results.margins.items():
        yield "margins", f"margins.{name}", _VALUE, margin.values.values(), _spread(margin.curve)
        path = margin.family.path
        for member in margin.family.members:
            called = f"margins.{name} at {path} {format_value(member.value, path)}"
            yield "margins", called, _VALUE, member.values.values(), _spread(member.curve)
    yield from _of_fracture(results.fracture)
    for name, entry in results.sensitivity.items():
        yield "drivers", name, _DELTA, entry.delta.values(), 1.0
        yield "drivers", name, _PAWN, entry.pawn.values(), 1.0
    for name, limit in results.limits.items():
        drivers = limit.drivers
        means = [_over(one) for one in (drivers.given_failure or {}).values()]
        of_limit = ((_MISSING, [*drivers.first.values(), *drivers.total.values()]), (_MISSING, [drivers.explained]),
                    (_THERE, means))  # fmt: skip
        yield from (("drivers", f"limits.{name}", kind, estimates, 1.0) for kind, estimates in of_limit)


def _of_fracture(fracture: FractureEntry) -> Iterator[tuple[str, str, str, Iterable[Est], float | None]]:
    """The same of fracture by any limit; of one limit its probability and its curve are the limit's own."""
    several = len(fracture.limits) > 1
    for key, estimate in (("union", fracture.union if several else Est()), ("first_loading", fracture.first_loading)):
        yield "fracture", f"fracture.{key}", _FRACTURE, [estimate], estimate.value
    yield "fracture", "fracture.curve", _VALUE, fracture.values.values(), _spread(fracture.curve)
    if several:
        yield "fracture", "fracture.governed_by", _SHARE, fracture.governed_by.values(), 1.0
    for name, found in fracture.states().items():
        low, high = (found.quantiles[p].value if p in found.quantiles else None for p in ("0.05", "0.95"))
        if name != "specific_energy" and low is not None and high is not None:
            yield "fracture", f"fracture.{name}", _MEDIAN, [found.median], (float(high) - float(low)) / _APART


def _half(estimate: Est) -> float:
    return 0.5 * float((estimate.high or 0.0) - (estimate.low or 0.0))


def _spread(curve: Curve) -> float | None:
    """Half of what lies between the two values a standard deviation to either side; None where it does not rise so."""
    if len(curve) < 2:
        return None
    values, probabilities = (np.array([row[k] for row in curve], dtype=float) for k in (0, 1))
    if probabilities[0] > probabilities[-1]:
        values, probabilities = values[::-1], probabilities[::-1]
    if not probabilities[0] <= _LOW < _HIGH <= probabilities[-1]:
        return None
    order = np.argsort(probabilities, kind="stable")
    low, high = np.interp([_LOW, _HIGH], probabilities[order], values[order])
    return 0.5 * abs(float(high - low))


def _over(described: GivenFailureEntry) -> Est:
    """The mean of an input over its standard deviation."""
    mean, sd = described.mean, described.sd.value
    if not sd or mean.value is None or mean.low is None or mean.high is None:
        return Est()
    return mean.model_copy(update={"value": mean.value / sd, "low": mean.low / sd, "high": mean.high / sd})
