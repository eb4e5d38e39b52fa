"""Fragility over the specific energy that is imposed: the rows of a curve over the speed, ordered by their energy.

Comminution asks for the probability that a particle breaks at a given specific energy, as a drop-weight test finds it
that gives every particle the same energy per mass (L. M. Tavares and R. P. King, Int. J. Miner. Process. 54, 1998, 1).
The energy in the contacts is an answer, not an input: it scatters at a given speed.  So every specimen is struck here
with the speed that imposes just the energy asked for, as far as its own rows and a polynomial of all rows tell.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.quantities import lookup
from uqsphere.runner.curve_rows import CurveRows, judge_of
from uqsphere.study import Limit
from uqsphere.uq.estimate import Estimate
from uqsphere.uq.fragility import LognormalCurve, fit_lognormal_curve
from uqsphere.uq.limit_state import tails
from uqsphere.uq.margins import fragility
from uqsphere.uq.row_fit import RowFit, fit_rows

__all__ = ["EnergyCurve", "energy_curve", "energy_table", "not_known"]

Array = npt.NDArray[np.float64]

#: energies at which the curve is drawn
ENERGIES: Final = 40
#: rows that correct the polynomial at an energy, in steps of the curve on either side
REACH: Final = 4.0


@dataclass(frozen=True, kw_only=True)
class EnergyCurve:
    """Curve [[energy, probability, low, high], ...] (J/kg), its values by probability, the lognormal curve beside it.

    `reason`: why there is none.
    """

    quantity: str
    curve: list[list[float]] = field(default_factory=list)
    values: Mapping[float, Estimate] = field(default_factory=dict)
    lognormal: LognormalCurve | str = ""
    reason: str = ""


def not_known(quantity: str, reason: str) -> EnergyCurve:
    """No curve, and why."""
    return EnergyCurve(quantity=quantity, lognormal=reason, reason=reason)


def energy_curve(rows: CurveRows | None, limit: Limit, quantity: str, probabilities: Sequence[float]) -> EnergyCurve:
    """The fragility of a limit over `quantity`, a positive answer that rises with the free scalar of the rows.

    P(e) is the mean over the inputs of the probability that the strength is below D(e, z), where D is the demand of a
    specimen with the inputs z at the value of the scalar at which the quantity is e.  D is fitted to the rows; what
    that is off by near e, the rows tell whose own quantity is near it (local lines in ln e).
    """
    if rows is None or rows.still:
        return not_known(quantity, "the demands are not known in full at every speed, so that rows cannot be ordered")
    if not rows.knows(quantity):
        return not_known(quantity, f"{quantity} is not known in full in every row")
    found = _Energies.of(rows, limit, quantity)
    if isinstance(found, str):
        return not_known(quantity, found)
    grid = found.grid()
    if grid is None:
        return not_known(quantity, f"{quantity} does not rise with the free number")
    table = found.table(grid)
    work = rows.work
    told = fragility(grid, table, probabilities, samples=rows.samples, evaluations=work.ledger.total)
    error = work.study.model.tolerance
    lognormal = fit_lognormal_curve(grid, table, evaluations=work.ledger.total)
    if not isinstance(lognormal, str):
        median, dispersion = (_no_closer(estimate, error) for estimate in (lognormal.median, lognormal.dispersion))
        lognormal = replace(lognormal, median=median, dispersion=dispersion)
    values = {p: _no_closer(estimate, error) for p, estimate in told.values.items()}
    return EnergyCurve(quantity=quantity, curve=told.curve, values=values, lognormal=lognormal)


def _no_closer(estimate: Estimate, error: float) -> Estimate:
    """The estimate with an interval that is no narrower than the energies are integrated to, relative.

    A limit on the energy itself has no scatter left in its curve.
    """
    if estimate.value is None or estimate.low is None or estimate.high is None:
        return estimate
    reach = error * abs(estimate.value)
    return replace(
        estimate, low=min(estimate.low, estimate.value - reach), high=max(estimate.high, estimate.value + reach)
    )


@dataclass(frozen=True, kw_only=True)
class _Energies:
    """Rows with their energies and demands, each by the value of the scalar they belong to, and D(e, z)."""

    rows: CurveRows
    limit: Limit
    energies: list[Array]
    demands: list[Array]
    fit: RowFit

    @classmethod
    def of(cls, rows: CurveRows, limit: Limit, quantity: str) -> _Energies | str:
        """The rows of a curve in this order, or why they do not go."""
        own = [sample.answer(quantity) for sample in rows.rows.values()]
        demands = [sample.answer(limit.quantity) for sample in rows.rows.values()]
        if not all(bool((energies > 0.0).all()) for energies in own):
            return f"{quantity} is zero in some rows"
        fit = fit_rows(own, [sample.scores for sample in rows.rows.values()], demands)
        return cls(rows=rows, limit=limit, energies=own, demands=demands, fit=fit)

    def grid(self) -> Array | None:
        """Energies in equal ratios between the medians at the two ends of the scalar's values; None if they fall."""
        order = np.argsort(list(self.rows.rows))
        low, high = (float(np.median(self.energies[int(order[at])])) for at in (0, -1))
        return np.geomspace(low, high, ENERGIES) if high > low * (1.0 + 1e-9) else None

    def table(self, grid: Array) -> Array:
        """Probabilities (J, R) at the energies, every replicate by itself."""
        rows, judge = self.rows, judge_of(self.rows.work, self.limit)
        basis = self.fit.basis(rows.points.scores)
        fitted = np.array(
            [rows.expected(self.fit, judge, rows.points, self.fit.predict(e, basis), e)[0].mean(axis=1) for e in grid]
        )
        p = fitted.mean(axis=1)
        side = np.maximum(p * (1.0 - p), 1e-12)
        places, missed = self._missed(grid, side)
        corrections = _lines(places, missed, np.log(grid), REACH)
        corrected = fitted + side[:, None] * corrections
        # what lines of half the reach answer differently is common to the replicates: their spread does not show it
        bent = side * (corrections - _lines(places, missed, np.log(grid), 0.5 * REACH)).mean(axis=1)
        near = np.ones(2 * int(REACH) + 1)
        hidden = np.convolve(bent**2, near, "same") / np.convolve(np.ones(bent.size), near, "same")
        own = corrected.var(axis=1, ddof=1) / corrected.shape[1]
        wider = np.sqrt((own + hidden) / np.where(own > 0.0, own, np.inf) + (own <= 0.0))[:, None]
        middle = corrected.mean(axis=1, keepdims=True)
        return np.asarray(np.clip(middle + (corrected - middle) * wider, 0.0, 1.0))

    def _missed(self, grid: Array, side: Array) -> tuple[Array, Array]:
        """Logarithms of the rows' own energies (R, N), and what the polynomial is off by there, over the side."""
        judge, places, missed = judge_of(self.rows.work, self.limit), [], []
        everything = zip(self.rows.rows.items(), self.energies, self.demands, strict=True)
        for (value, points), energies, demands in everything:
            ours = self.fit.predict_rows(energies, self.fit.basis(points.scores))
            expected = self.rows.expected(self.fit, judge, points, ours, value)[0]
            below, above = tails(judge(points, demands, value))
            own = below / np.where(below + above > 0.0, below + above, 1.0)
            place = np.log(energies)
            places.append(place)
            missed.append((own - expected) / np.interp(place, np.log(grid), side))
        return np.concatenate(places, axis=1), np.concatenate(missed, axis=1)


def _lines(places: Array, found: Array, at: Array, steps: float) -> Array:
    """Values (J, R) at J equally spaced places of straight lines through what is found (R, N) within so many steps."""
    reach = steps * float(at[1] - at[0])
    answers = np.zeros((at.size, places.shape[0]))
    for j, place in enumerate(at):
        away = (places - place) / reach
        near = np.maximum(0.0, 1.0 - np.abs(away))
        total, first, second = near.sum(axis=1), (near * away).sum(axis=1), (near * away**2).sum(axis=1)
        spread = total * second - first**2
        level = ((near * found).sum(axis=1) * second - (near * away * found).sum(axis=1) * first) / np.where(
            spread > 1e-9 * total**2, spread, np.inf
        )
        answers[j] = level
    return answers


def energy_table(found: EnergyCurve, lognormal: dict[str, Any]) -> dict[str, Any]:
    """A curve over the energy for results.json."""
    return {
        "quantity": found.quantity,
        "unit": lookup(found.quantity).unit,
        "values": {f"{p:.15g}": estimate.as_dict() for p, estimate in found.values.items()},
        "curve": [list(point) for point in found.curve],
        "lognormal": lognormal,
        **({"reason": found.reason} if found.reason else {}),
    }
