"""The account of a run: beside each part what was planned and what it took, and why they differ where they do much."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.quantities import format_value
from uqsphere.results import Curve, FractureEntry, GivenFailureEntry, MarginEntry, MemberEntry, Results, SpeedRow
from uqsphere.results.entries import Est
from uqsphere.runner.campaign import INDEX_KIND, MEAN_KIND, MISS_KIND, QUANTILE_KIND, Cost, Missed, rounded
from uqsphere.runner.evaluate import Work
from uqsphere.runner.forecast import CHEAPER, forecast
from uqsphere.uq.estimate import Estimate

if TYPE_CHECKING:
    from uqsphere.runner.questions.indices import Sensitivity
    from uqsphere.runner.results import Findings

__all__ = [
    "FACTOR",
    "FURTHER",
    "SMALL",
    "account",
    "further_rows",
    "questions",
]

#: factor between planned and taken from which on a reason is given
FACTOR: Final = 2.0
#: parts beside which a cheaper model may be evaluated, and what that is called
_CHEAPER: Final = dict(zip(("sampling", "sensitivity"), CHEAPER, strict=True))
#: what sampling answers, by how the names of its errors begin
_ANSWERS: Final = {QUANTILE_KIND: "The worst quantile", MEAN_KIND: "The mean", MISS_KIND: "The probability"}


def account(work: Work, found: Findings, *, planned: bool, surrogate: bool, affordable: int) -> list[dict[str, Any]]:
    """Every part with the evaluations that were likely, the most, and those taken, for results.json.

    Parameters
    ----------
    work : the run, its ledger closed for every part.
    found : what the run found: why its stages ended.
    planned, surrogate : whether it was to be answered through a surrogate, and whether it was.
    affordable : evaluations that the budget had room for.
    """
    parts = {part.name: part for part in forecast(work.study, affordable, planned)}
    taken = {name: sum(spent.values()) for name, spent in work.ledger.parts.items()}
    # models beside the one that was chosen are no samples of their own
    for name, called in _CHEAPER.items():
        by = work.ledger.parts.get(name, {})
        beside = sum(n for fidelity, n in by.items() if fidelity not in _answering(found))
        if beside:
            taken[name] -= beside
            taken[called] = beside
    names = [*parts, *(name for name in taken if name not in parts and taken[name])]
    rows = []
    for name in names:
        part, spent = parts.get(name), taken.get(name, 0)
        likely, most = (part.likely, part.most) if part else (0, 0)
        row = {"part": name, "likely": likely, "most": most, "taken": spent}
        rows.append({**row, "why": _why(name, likely, spent, found, planned=planned, surrogate=surrogate)})
    return rows


def _answering(found: Findings) -> tuple[str, ...]:
    """The models that the rows of sampling themselves were answered by."""
    chosen = found.pilot.chosen
    return (chosen,) if found.pilot.fallback is None else (chosen, "full")


def _why(name: str, likely: int, taken: int, found: Findings, *, planned: bool, surrogate: bool) -> str:
    """Why a part took much more or less than was likely, in a sentence; nothing where it did not."""
    if max(likely, 1) <= FACTOR * max(taken, 1) and max(taken, 1) <= FACTOR * max(likely, 1):
        return ""
    more = taken > likely
    if planned and not surrogate and name != "surrogate" and not likely:
        return "A surrogate was not good enough, and the model was sampled."
    stop = found.stops.get("sensitivity" if name == "sensitivity" else "sampling", "")
    ended = {
        "evaluations": "the next stage would have passed the budget",
        "time": "the time was over, or the run was stopped",
        "out of reach": "what is left was seen to be out of the budget's reach and given up",
        "failures": "rows without an answer ended it",
    }.get(stop, "")
    if name in _CHEAPER.values():
        text = found.sampled.control.text if name == _CHEAPER["sampling"] else found.index_control.text
        return f"{text}." if text and taken else "A control variate was tried." if taken else "None was worth a trial."
    if name in ("sampling", "sensitivity"):
        if more:
            late = f"; it ended since {ended}" if ended else ""
            worst = _slowest(found, name)
            return f"{worst} took more points than a smooth, nearly normal quantity does{late}."
        if ended:
            return f"It ended early: {ended}."
        if not taken:
            return "No runs were paired for the indices." if name == "sensitivity" else "Nothing was sampled."
        return "The quantities are smoother than was assumed, and their errors fell faster."
    if name == "rare events":
        if more:
            searched = any(row["method"] in ("importance sampling", "subset simulation") for row in found.history)
            if searched:
                return "A probability was too small for plain sampling, and its failures were searched for."
            return "The search for the design points took more than the least that it can."
        return "Sampling had the probabilities well enough already."
    if name == "surrogate":
        if not surrogate:
            return "The surrogate was found too rough, and no more runs were made for it."
        if ended and not more:
            return f"It ended early: {ended}."
        if more and any(one.kind == "surrogate" for one in found.sampled.missed):
            return "What is too rough for a surrogate took the runs that the budget had room for."
        if more:
            return "The model is less smooth than was assumed, and the surrogate needed more runs."
        return "The model is smoother than was assumed, and fewer runs gave the accuracy."
    if name == "margins":
        if more:
            return "The bands, or the values asked for, took more rows than the first ones, or a demand jumps."
        return "The first rows were enough." if taken else "No curve was computed."
    if name == "fracture":
        return "The moment of fracture takes rows of the full model, at the value planned or along the load."
    if name == "pilot":
        return "Fewer models were compared than there are." if not more else "The first runs of the model were timed."
    return "Nothing was left for it." if not taken else ""


def _slowest(found: Findings, name: str) -> str:
    """The answer of a part with the largest error over its standard deviation, as it is called."""
    told = {INDEX_KIND: "The indices"} if name == "sensitivity" else _ANSWERS
    last = {
        (row["quantity"], head): float(row["error"])
        for row in found.history
        for head in told
        if row["error_kind"].startswith(head)
    }
    if not last:
        return "It"
    quantity, head = max(last, key=lambda key: last[key])
    return f"{told[head]} of {quantity.removeprefix('limits.')}"


# --- Every accuracy that a run was asked for: what was reached, and what the rest would take.

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

    def add(part: str, quantity: str, kind: str, estimates: Iterable[Est | None], scale: float | None = 1.0) -> None:
        known = [e for e in estimates if e is not None and e.value is not None and e.low is not None]
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
    if results.fracture is not None:
        _add_fracture(add, results.fracture)
    for name, entry in results.sensitivity.items():
        add("drivers", name, _DELTA, entry.delta.values())
        add("drivers", name, _PAWN, entry.pawn.values())
    for name, limit in results.limits.items():
        drivers = limit.drivers
        if drivers is not None:
            add("drivers", f"limits.{name}", _MISSING, [*drivers.first.values(), *drivers.total.values()])
            add("drivers", f"limits.{name}", _MISSING, [drivers.explained])
            means = [_over(one) for one in (drivers.given_failure or {}).values()]
            add("drivers", f"limits.{name}", _THERE, means)
    return rows


def _add_fracture(add: Callable[..., None], fracture: FractureEntry) -> None:
    """The rows of fracture by any limit; of one limit its probability and its curve are the limit's own."""
    several = len(fracture.limits) > 1
    for key, estimate in (("union", fracture.union if several else None), ("first_loading", fracture.first_loading)):
        if estimate is not None:
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
    if family is None:
        return
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


def _over(described: GivenFailureEntry) -> Est | None:
    """The mean of an input over its standard deviation."""
    mean, sd = described.mean, described.sd.value if described.sd is not None else None
    if not sd or mean.value is None or mean.low is None or mean.high is None:
        return None
    return mean.model_copy(update={"value": mean.value / sd, "low": mean.low / sd, "high": mean.high / sd})
