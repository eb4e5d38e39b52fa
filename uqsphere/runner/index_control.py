"""A cheap fidelity as a control variate of the Sobol' indices, and what control variates and fallback saved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.runner.evaluate import Work
from uqsphere.runner.fidelity import Pilot
from uqsphere.runner.multifidelity import Control, Plan, needed, verdict, weigh
from uqsphere.uq.control import controlled_indices
from uqsphere.uq.estimate import Estimate

Flags = npt.NDArray[np.bool_]
Indices = dict[str, list[Estimate]]
#: outputs (R, n, d + 2, q) and failures (R, n) of base points `start` to `start + count`, by work, key, start, count
Design = Callable[[Work, str, int, int], tuple[Array, Flags]]

#: fall of the half-widths of indices of smooth quantities with the points, in the shipped studies 0.85 to 1
RATE = 0.9


@dataclass(frozen=True, kw_only=True)
class IndexControl:
    """The state of the control.

    `values` of the cheap model are (R, m, d + 2, q); `used` is None before it was tried; `taken` counts the
    evaluations of the full model so far, `forecast` those that it would have taken alone.
    """

    plan: Plan | None = None
    text: str = ""
    used: bool | None = None
    values: Array | None = None
    taken: int = 0
    forecast: int = 0

    def rows(self, count: int) -> int:
        """Evaluations for each one of the full model that a further stage takes."""
        return count * (1 + self.plan.ratio if self.used and self.plan is not None else 1)


def width(indices: Indices) -> float:
    """The largest half-width; 0 where no index is answered."""
    return max((e.half_width for row in indices.values() for e in row if e.value is not None), default=0.0)


def sharpen(
    work: Work,
    control: IndexControl,
    design: Design,
    values: Array,
    failed: Flags,
    plain: dict[str, Indices],
    lacking: list[str],
) -> tuple[IndexControl, dict[str, Indices]]:
    """The indices of every quantity after a stage, with the help of the cheap model where it pays.

    It is tried at the first stage that leaves some quantity (`lacking`) short of the accuracy asked for, and kept
    to the end if it pays.

    Raises
    ------
    OutOfBudget
        When the time is over before the cheap model has been evaluated.
    """
    plan = control.plan
    if plan is None or control.used is False or (control.used is None and not lacking):
        return control, plain
    n = values.shape[1]
    have = 0 if control.values is None else control.values.shape[1]
    more = plan.ratio * n - have
    rows = more * len(values) * values.shape[2]
    if work.ledger.total + rows > work.study.analysis.budget.evaluations:
        return IndexControl(used=False, text="a control variate was not tried: the budget does not allow it"), plain
    cheap = replace(work, fidelity=plan.candidate.fidelity, fallback=None, spare=True)
    fresh, bad = design(cheap, f"index_control.{have}", have, more)
    if failed.any() or bad.any():
        text = f"{plan.candidate.fidelity} is not used as a control variate: some rows have no answer"
        return IndexControl(used=False, text=text), plain
    many = fresh if control.values is None else np.concatenate([control.values, fresh], axis=1)
    method = f"pick and freeze, controlled by {plan.ratio} times as many {plan.candidate.fidelity}"
    found = {
        name: controlled_indices(values[..., k], many[:, :n, :, k], many[..., k], method=method)
        for k, name in enumerate(work.quantities)
    }
    size = int(np.prod(values.shape[:3]))
    control = replace(control, values=many, taken=size)
    if control.used is None:
        asked = work.study.analysis.accuracy.sobol
        before = {name: width(plain[name]) / asked for name in lacking}
        after = {name: width(indices) / asked for name, indices in found.items()}
        gain = {name: ratio / max(after[name], 1e-9) for name, ratio in before.items()}
        pays, within, without = weigh(plan, before, after, size, RATE)
        text = verdict(plan, pays, gain, size, within, without)
        control = replace(control, used=pays, text=text, forecast=without)
    elif lacking:
        before = {name: width(plain[name]) / work.study.analysis.accuracy.sobol for name in lacking}
        control = replace(control, forecast=round(needed(before, size, RATE)))
    return control, found if control.used else plain


# --- what is reported -----------------------------------------------------------------------------


def report_of(work: Work, pilot: Pilot, control: Control, indices: IndexControl) -> dict[str, Any]:
    """What was considered, which share fell back, and what was saved, for results.json."""
    considered = {
        c.fidelity: {
            "error": c.error,
            "worst": c.worst,
            "correlation": c.correlation,
            "cost": c.cost,
            "fits": c.fits,
            "mixed_error": c.mixed_error,
            "fallback_share": c.fallback_share,
        }
        for c in pilot.candidates
    }
    used = [c.plan for c in (control, indices) if c.used and c.plan is not None]
    fallback, saved = _fallback_saved(work, pilot) if pilot.fallback is not None else (None, _saved(control, indices))
    return {
        "considered": considered,
        "fallback_share": fallback,
        "control": {
            "used": bool(used),
            "fidelity": used[0].candidate.fidelity if used else None,
            "ratio": used[0].ratio if used else None,
            "gain": control.gain,
            "text": control.text,
            "indices": indices.text,
        },
        "saved": saved,
        "undecided": work.ledger.undecided,
    }


def _fallback_saved(work: Work, pilot: Pilot) -> tuple[float | None, dict[str, Any]]:
    """The share of the rows after the pilot that was left to `full`, and what the others saved."""
    spared = work.ledger.evaluations.get(pilot.chosen, 0) - pilot.evaluations.get(pilot.chosen, 0)
    by_full = work.ledger.fallback
    rows = spared + by_full
    if rows == 0:
        return None, {"full_evaluations": 0, "cost_share": 0.0, "text": "nothing was evaluated after the pilot"}
    cost = {c.fidelity: c.cost for c in pilot.candidates}[pilot.chosen]
    share = 1.0 - (by_full + spared * cost) / rows
    text = f"{spared:,} evaluations of full are spared, {_per_cent(share)} of the cost after the pilot"
    return by_full / rows, {"full_evaluations": spared, "cost_share": share, "text": text}


def _saved(control: Control, indices: IndexControl) -> dict[str, Any]:
    """What control variates saved, against the forecast of what sampling alone would have taken."""
    taken = forecast = 0
    cost = 0.0
    if control.used and control.plan is not None and control.forecast and control.sample is not None:
        size = control.sample.status.size // control.plan.ratio
        taken, forecast, cost = size, control.forecast, size * control.plan.row_cost
    if indices.used and indices.plan is not None:
        taken, forecast = taken + indices.taken, forecast + indices.forecast
        cost += indices.taken * indices.plan.row_cost
    if not forecast:
        return {"full_evaluations": 0, "cost_share": 0.0, "text": "nothing is saved"}
    share = 1.0 - cost / forecast
    if share <= 0.0:
        text = f"nothing is saved: sampling alone would have taken some {forecast:,} evaluations of full"
        return {"full_evaluations": 0, "cost_share": 0.0, "text": text}
    text = (
        f"{taken:,} evaluations of full in place of some {forecast:,} that sampling alone was forecast to take, "
        f"{_per_cent(share)} of their cost"
    )
    return {"full_evaluations": forecast - taken, "cost_share": share, "text": text}


def _per_cent(share: float) -> str:
    return f"{100.0 * share:.0f} %"
