"""The account of a run: beside each part what was planned and what it took, and why they differ where they do much."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from uqsphere.forecast import CHEAPER, forecast
from uqsphere.runner.stopping import INDEX_KIND, MEAN_KIND, MISS_KIND, QUANTILE_KIND
from uqsphere.runner.work import Work

if TYPE_CHECKING:
    from uqsphere.runner.results import Findings

__all__ = ["FACTOR", "account"]

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
