"""The account of a run: beside each part what was planned and what it took, and why they differ where they do much."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.quantities import format_value
from uqsphere.results import FractureEntry, GivenFailureEntry, PartEntry, QuestionRow, Results, SpeedRow
from uqsphere.results.entries import Curve, Est
from uqsphere.results.margins import MarginEntry, MemberEntry
from uqsphere.runner.campaign import INDEX_KIND, MEAN_KIND, MISS_KIND, QUANTILE_KIND, Cost, Missed, rounded
from uqsphere.runner.evaluate import Work
from uqsphere.runner.forecast import forecast
from uqsphere.uq.estimate import Estimate

if TYPE_CHECKING:
    from uqsphere.runner.questions.margins import MarginAnswer
    from uqsphere.runner.results import Findings
    from uqsphere.study.document import Accuracy as Accuracies
    from uqsphere.uq.describe import Description

#: factor between planned and taken from which on a reason is given
FACTOR: Final = 2.0
#: what sampling answers, by how the names of its errors begin
_ANSWERS: Final = {QUANTILE_KIND: "The worst quantile", MEAN_KIND: "The mean", MISS_KIND: "The probability"}


@dataclass(frozen=True, kw_only=True)
class _Part:
    """What a part was likely to evaluate and what it took, of a run that found this."""

    name: str
    likely: int
    taken: int
    found: Findings
    planned: bool
    surrogate: bool

    @property
    def more(self) -> bool:
        return self.taken > self.likely

    @property
    def ended(self) -> str:
        """Why its stages ended before the accuracy was reached."""
        stop = self.found.stops.get("sensitivity" if self.name == "sensitivity" else "sampling", "")
        return {
            "evaluations": "the next stage would have passed the budget",
            "time": "the time was over, or the run was stopped",
            "out of reach": "what is left was seen to be out of the budget's reach and given up",
            "failures": "rows without an answer ended it",
        }.get(stop, "")

    def why(self) -> str:
        """Why it took much more or less than was likely, in a sentence; nothing where it did not."""
        if max(self.likely, 1) <= FACTOR * max(self.taken, 1) and max(self.taken, 1) <= FACTOR * max(self.likely, 1):
            return ""
        if self.planned and not self.surrogate and self.name != "surrogate" and not self.likely:
            return "A surrogate was not good enough, and the model was sampled."
        if self.name in _WHY:
            return _WHY[self.name](self)
        return "Nothing was left for it." if not self.taken else ""


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
        part = _Part(name=name, likely=likely, taken=taken.get(name, 0), found=found, planned=planned,
                     surrogate=surrogate)  # fmt: skip
        rows.append(PartEntry(part=name, likely=likely, most=most, taken=part.taken, why=part.why()))
    return tuple(rows)


def _of_stages(part: _Part) -> str:
    if part.more:
        late = f"; it ended since {part.ended}" if part.ended else ""
        return f"{_slowest(part)} took more points than a smooth, nearly normal quantity does{late}."
    if part.ended:
        return f"It ended early: {part.ended}."
    if not part.taken:
        return "No runs were paired for the indices." if part.name == "sensitivity" else "Nothing was sampled."
    return "The quantities are smoother than was assumed, and their errors fell faster."


def _slowest(part: _Part) -> str:
    """The answer of a part with the largest error over its standard deviation, as it is called."""
    told = {INDEX_KIND: "The indices"} if part.name == "sensitivity" else _ANSWERS
    last = {
        (row.quantity, head): float(row.error or 0.0)
        for row in part.found.history
        for head in told
        if row.error_kind.startswith(head)
    }
    if not last:
        return "It"
    quantity, head = max(last, key=lambda key: last[key])
    return f"{told[head]} of {quantity.removeprefix('limits.')}"


def _of_rare_events(part: _Part) -> str:
    if not part.more:
        return "Sampling had the probabilities well enough already."
    if any(row.method in ("importance sampling", "subset simulation") for row in part.found.history):
        return "A probability was too small for plain sampling, and its failures were searched for."
    return "The search for the design points took more than the least that it can."


def _of_surrogate(part: _Part) -> str:
    if not part.surrogate:
        return "The surrogate was found too rough, and no more runs were made for it."
    if not part.more:
        early = f"It ended early: {part.ended}." if part.ended else ""
        return early or "The model is smoother than was assumed, and fewer runs gave the accuracy."
    if any(one.kind == "surrogate" for one in part.found.sampled.missed):
        return "What is too rough for a surrogate took the runs that the budget had room for."
    return "The model is less smooth than was assumed, and the surrogate needed more runs."


def _of_margins(part: _Part) -> str:
    if part.more:
        return "The bands, or the values asked for, took more rows than the first ones, or a demand jumps."
    return "The first rows were enough." if part.taken else "No curve was computed."


_WHY: Final[dict[str, Callable[[_Part], str]]] = {
    "pilot": lambda part: "The first runs of the model were timed." if part.more else _FEWER_MODELS,
    "sampling": _of_stages,
    "sensitivity": _of_stages,
    "rare events": _of_rare_events,
    "surrogate": _of_surrogate,
    "margins": _of_margins,
    "fracture": lambda _: (
        "The moment of fracture takes rows of the full model, at the value planned or along the load."
    ),
}
_FEWER_MODELS: Final = "Fewer models were compared than there are."


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
    asked = work.study.analysis.accuracy
    rows: list[QuestionRow] = []
    for name, described in found.sampled.descriptions.items():
        rows += _of_description(name, described, asked, told)
    for name, indices in found.sensitivity.items() if math.isfinite(asked.sobol) else ():
        refused = indices.text if not indices.missed else ""
        reached = _worst(indices.estimates(), 1.0)
        rows.append(_row(name, "worst index", asked.sobol, reached, told[name, "indices"], refused))
    for name, limit in found.sampled.limits.items() if math.isfinite(asked.probability) else ():
        for which in ("exceedance", "miss") if limit.aim == "break" else ("miss",):
            estimate: Estimate = getattr(limit, which)
            said = "of missing the aim" if which == "miss" else "of exceedance"
            reached = _worst([estimate], estimate.value or math.nan)
            late, exempt = told[f"limits.{name}", which], NO_MATTER if limit.beneath(which) else ""
            rows.append(
                _row(f"limits.{name}", f"probability {said}, over itself", asked.probability, reached, late, exempt)
            )
    for name, margin in found.margins.items():
        rows += _of_curves(name, margin)
    return tuple(rows)


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


def _of_description(
    name: str, described: Description, asked: Accuracies, told: Mapping[tuple[str, str], list[Missed]]
) -> Iterator[QuestionRow]:
    if not described.scale > 0.0:
        return
    scale, over = described.scale, described.scale_name
    if described.mean.value is not None and math.isfinite(asked.mean):
        reached = _worst([described.mean], scale)
        yield _row(name, f"mean, over {over}", asked.mean, reached, told.get((name, "mean"), []))
    counted = [e for p, e in described.quantiles.items() if p not in described.exempt]
    if counted and math.isfinite(asked.quantile):
        reached = _worst(counted, scale)
        yield _row(name, f"worst quantile, over {over}", asked.quantile, reached, told.get((name, "quantile"), []))


def _of_curves(name: str, margin: MarginAnswer) -> Iterator[QuestionRow]:
    for at, band in {"": margin.band, **margin.bands}.items():
        if band is not None:
            curve = _curve(name, at, "band", band.missed(), band.table()["needed"])
            reached = band.half_width, band.evaluations
            text = "band of the curve, over the smaller side"
            yield _row(curve.subject, text, band.asked, reached, [curve] * bool(band.missed()))
    for at, steps in {"": margin.coarse, **margin.steps}.items():
        if steps is not None:
            curve = _curve(name, at, "steps", steps.missed(), rounded(steps.needed))
            text = "largest step of the curve, in normal scores"
            yield _row(curve.subject, text, steps.asked, (steps.step, steps.evaluations), [curve])


def _curve(name: str, at: str, kind: str, text: str, needed: int | None) -> Missed:
    """What is said of the curve of a limit, or of one of its family."""
    subject, head = (f"margins.{name} at {at}", f"{name}: at {at}") if at else (f"margins.{name}", name)
    return Missed(subject=subject, kind=kind, said=f"margins {head}: {text}", cost=Cost(needed=needed))


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
    rows: list[tuple[str, SpeedRow]] = []

    def add(part: str, quantity: str, kind: str, estimates: Iterable[Est], scale: float | None = 1.0) -> None:
        known = [e for e in estimates if e.value is not None and e.low is not None]
        if not known or not scale or not scale > 0.0:
            return
        worst = max(known, key=_half)
        if _half(worst) > 0.0:
            row = SpeedRow(
                method=worst.method,
                quantity=quantity,
                evaluations=int(worst.evaluations),
                error=_half(worst) / scale,
                error_kind=kind,
            )
            rows.append((part, row))

    for name, margin in results.margins.items():
        for at, curve in _curves(margin):
            add("margins", f"margins.{name}{at}", _VALUE, curve.values.values(), _spread(curve.curve))
    _add_fracture(add, results.fracture)
    for name, entry in results.sensitivity.items():
        add("drivers", name, _DELTA, entry.delta.values())
        add("drivers", name, _PAWN, entry.pawn.values())
    for name, limit in results.limits.items():
        drivers = limit.drivers
        add("drivers", f"limits.{name}", _MISSING, [*drivers.first.values(), *drivers.total.values()])
        add("drivers", f"limits.{name}", _MISSING, [drivers.explained])
        means = [_over(one) for one in (drivers.given_failure or {}).values()]
        add("drivers", f"limits.{name}", _THERE, means)
    return rows


def _add_fracture(add: Callable[..., None], fracture: FractureEntry) -> None:
    """The rows of fracture by any limit; of one limit its probability and its curve are the limit's own."""
    several = len(fracture.limits) > 1
    for key, estimate in (("union", fracture.union if several else Est()), ("first_loading", fracture.first_loading)):
        if estimate:
            add("fracture", f"fracture.{key}", _FRACTURE, [estimate], estimate.value)
    if fracture.curve:
        add("fracture", "fracture.curve", _VALUE, fracture.values.values(), _spread(fracture.curve))
    if several:
        add("fracture", "fracture.governed_by", _SHARE, fracture.governed_by.values())
    for name, found in fracture.states().items():
        low, high = (found.quantiles[p].value if p in found.quantiles else None for p in ("0.05", "0.95"))
        if name != "specific_energy" and low is not None and high is not None:
            add("fracture", f"fracture.{name}", _MEDIAN, [found.median], (float(high) - float(low)) / _APART)


def _half(estimate: Est) -> float:
    return 0.5 * float((estimate.high or 0.0) - (estimate.low or 0.0))


def _curves(entry: MarginEntry) -> Iterator[tuple[str, MarginEntry | MemberEntry]]:
    """The curve of a limit, and those of its family, by what is added to its name."""
    yield "", entry
    family = entry.family
    for member in family.members:
        yield f" at {family.path} {format_value(member.value, family.path)}", member


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
