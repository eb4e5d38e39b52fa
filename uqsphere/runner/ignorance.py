"""Scatter and ignorance: how far the answers move over the laws that a few tests allow.

A law fitted to n tests enters every answer as if it were known.  Here it is replaced by others that the same tests
allow (`uqsphere.uq.fitting`): a strength in its integral, an input of the model by weighting the rows that were
evaluated already.  Nothing is evaluated again.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.runner.evaluate import Work
from uqsphere.runner.limits import LimitAnswer, state_of
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.study import Limit
from uqsphere.uq.fitting import count_tests, is_fitted, possible_densities, possible_tails
from uqsphere.uq.joint import conditional_normal, tied_names
from uqsphere.uq.law import Law, LawError, cdf, is_steps
from uqsphere.uq.limit_state import shifted_tails, strength_tails
from uqsphere.uq.points import random_generator
from uqsphere.uq.sample import Sample

__all__ = ["find_ignorance"]

Array = npt.NDArray[np.float64]

#: laws that are tried in place of every fitted one
LAWS: Final = 400
#: rows of the sample that they are tried on
ROWS: Final = 8192
#: weighted rows must be worth this share of as many without weights, for all but this share of the laws: the ends of
#: a range are those of the farthest laws, and rows that hardly reach them make it too narrow (normal laws of 4, 6 and 8
#: observations: 0.65, 0.79 and 0.92 of Student's interval of the mean, worth 0.02, 0.08 and 0.15)
LEAST_WORTH: Final = 0.1
FAR: Final = 0.1


class _Unanswerable(Exception):
    """Why the ignorance cannot be told."""


def _generator(work: Work, name: str) -> np.random.Generator:
    """The same laws wherever an input is asked for."""
    return random_generator(seed=work.study.seed, task=f"ignorance {name}")


def _weights(work: Work, name: str, law: Law, x: Array) -> Array:
    """Weights (laws, rows) that turn rows drawn from one law into rows of the others, with mean 1 each."""
    drawn, others = possible_densities(law, x, LAWS, _generator(work, name))
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = others / drawn
    weights = np.where(np.isfinite(weights), weights, 0.0)
    total = weights.mean(axis=1, keepdims=True)
    worth = (weights.sum(axis=1) ** 2 / np.maximum((weights**2).sum(axis=1), 1e-300)) / x.size
    if float(np.quantile(worth, FAR)) < LEAST_WORTH or (total <= 0.0).any():
        raise _Unanswerable("the tests leave open laws that lie too far from the rows that were sampled")
    return np.asarray(weights / total)


def _fitted(work: Work, names: tuple[str, ...]) -> dict[str, Law]:
    """Those of the inputs that were fitted to tests."""
    laws = dict(zip(work.all_inputs.names, work.all_inputs.laws, strict=True))
    return {name: laws[name] for name in names if is_fitted(laws[name])}


def _refuse_dependent(work: Work, names: Iterable[str]) -> None:
    """Inputs that depend on each other cannot be weighted one by one; a strength may depend on them."""
    tied = tied_names(work.drawn)
    for name in names:
        if name in tied:
            raise _Unanswerable(f"{name} depends on other inputs, and the tests say nothing of their dependence")


def _columns(fitted: dict[str, Law], sample: Sample) -> dict[str, Array]:
    return {name: sample.input(name).ravel() for name in fitted}


def _spread(values: Array) -> list[float]:
    low, high = np.quantile(values, [0.025, 0.975])
    return [float(low), float(high)]


def _about(fitted: dict[str, Law]) -> list[dict[str, Any]]:
    return [
        {"input": name, "fit": "kde" if law.kind == "empirical" else law.kind, "tests": count_tests(law)}
        for name, law in fitted.items()
    ]


@dataclass(frozen=True, kw_only=True)
class _Moving:
    """One limit on the rows that are kept, with the laws that may take the place of the fitted ones.

    `weights` (laws, rows) and `scores`, changes (laws, rows) of the shift of a strength tied to the inputs, by input;
    `strengths`, tails (laws, rows) in place of the strength's; `offset` puts the logit on these rows right by what
    all rows gave.
    """

    strength: Law | float
    demands: Array
    shift: Array | None
    remaining_sd: float
    weights: dict[str, Array]
    scores: dict[str, Array]
    strengths: tuple[Array, Array] | None
    offset: float

    def exceedance(self, names: Iterable[str], *, with_strength: bool) -> Array:
        """Probability of exceeding (LAWS,) with the laws of some inputs, and of the strength, replaced."""
        found = np.empty(LAWS)
        inputs = [name for name in names if name in self.weights]
        for k in range(LAWS):
            weight = np.prod([self.weights[name][k] for name in inputs], axis=0) if inputs else np.ones(1)
            shift = self.shift
            for name in inputs:
                if shift is not None and name in self.scores:
                    shift = shift + self.scores[name][k]
            if with_strength and self.strengths is not None:
                below, above = self.strengths[0][k], self.strengths[1][k]
                if shift is not None:
                    below, above = shifted_tails(below, above, shift, self.remaining_sd)
            else:
                below, above = strength_tails(self.strength, self.demands, shift, self.remaining_sd)
            logit = _logit(float((weight * below).mean()), float((weight * above).mean())) + self.offset
            found[k] = 1.0 / (1.0 + math.exp(-logit)) if logit > -700.0 else 0.0
        return found


def _logit(below: float, above: float) -> float:
    if below <= 0.0 or above <= 0.0:
        return math.inf if above <= 0.0 else -math.inf
    return math.log(below) - math.log(above)


def _moving(work: Work, limit: Limit, answer: LimitAnswer, sample: Sample, fitted: dict[str, Law]) -> _Moving:
    """Raises _Unanswerable, LawError."""
    from scipy.special import ndtri

    key = f"limits.{limit.name}.strength"
    inputs = {name: law for name, law in fitted.items() if name != key}
    _refuse_dependent(work, inputs)
    state = state_of(work, limit, sample)
    if state.tie is not None:
        raise _Unanswerable("another than the Gaussian copula ties the strength to inputs")
    keep = ~state.broken.ravel()
    columns = {name: column[keep] for name, column in _columns(inputs, sample).items()}
    weights = {name: _weights(work, name, law, columns[name]) for name, law in inputs.items()}
    shift, scores = None, {}
    if state.shift is not None:
        shift = state.shift.ravel()[keep]
        ties = dict(zip(work.drawn.names, conditional_normal(work.all_inputs, key, work.drawn.names)[0], strict=True))
        for name, law in inputs.items():
            if ties[name]:
                # nine normal scores out a kernel density has nothing more to say
                before = np.clip(ndtri(cdf(law, columns[name])), -9.0, 9.0)
                after = possible_tails(law, columns[name], LAWS, _generator(work, name))[0]
                scores[name] = ties[name] * (np.clip(ndtri(after), -9.0, 9.0) - before)
    demands = state.demands.ravel()[keep]
    strengths = None
    if isinstance(limit.strength, Law) and key in fitted:
        at = np.nextafter(demands, -math.inf) if is_steps(limit.strength) else demands
        strengths = possible_tails(limit.strength, at, LAWS, _generator(work, key))
    below, above = strength_tails(limit.strength, demands, shift, state.remaining_sd)
    value = answer.exceedance.value
    offset = 0.0 if value is None else _logit(value, 1.0 - value) - _logit(float(below.mean()), float(above.mean()))
    return _Moving(
        strength=limit.strength, demands=demands, shift=shift, remaining_sd=state.remaining_sd, weights=weights,
        scores=scores, strengths=strengths, offset=offset if math.isfinite(offset) else 0.0,
    )  # fmt: skip


def _of_limit(work: Work, limit: Limit, answer: LimitAnswer, sample: Sample) -> dict[str, Any] | None:
    """Where the probability of one limit may lie, all fitted laws together and each alone."""
    key = f"limits.{limit.name}.strength"
    own = (*work.scene_names, f"limits.{limit.name}.model_factor", key)
    fitted = _fitted(work, tuple(name for name in own if name in work.all_inputs.names))
    if not fitted or answer.exceedance.value is None:
        return None
    about = _about(fitted)
    try:
        moving = _moving(work, limit, answer, sample, fitted)
    except (_Unanswerable, LawError) as error:
        return {"from": about, "reason": str(error)}
    together = moving.exceedance(fitted, with_strength=key in fitted)
    missed = together if limit.aim == "survive" else 1.0 - together
    low, high = _spread(missed)
    met = None
    if limit.target is not None and (high < limit.target or low > limit.target):
        met = high < limit.target
    alone = {}
    if len(fitted) > 1:
        for name in fitted:
            one = moving.exceedance([name], with_strength=name == key)
            alone[name] = _spread(one if limit.aim == "survive" else 1.0 - one)
    return {
        "from": about,
        "laws": LAWS,
        "exceedance": _spread(together),
        "miss": [low, high],
        "miss_mean": float(missed.mean()),
        "alone": alone,
        "met": met,
    }


def _of_quantity(work: Work, weights: dict[str, Array], values: Array, whole: npt.NDArray[np.bool_]) -> dict[str, Any]:
    """Where mean and quantiles of one quantity may lie."""
    kept = values.ravel()[whole]
    order = np.argsort(kept, kind="stable")
    ordered = kept[order]
    weight = np.prod(list(weights.values()), axis=0)[:, whole]
    weight /= weight.sum(axis=1, keepdims=True)
    running = np.cumsum(weight[:, order], axis=1)
    quantiles = {}
    for p in work.study.analysis.quantiles:
        at = np.minimum((running < p).sum(axis=1), ordered.size - 1)
        quantiles[f"{p:.15g}"] = _spread(ordered[at])
    return {"mean": _spread(weight @ kept), "quantiles": quantiles}


def find_ignorance(work: Work, sampled: Sampled) -> tuple[dict[str, Any], dict[str, Any]]:
    """What the tests leave open: (by limit, by quantity), of those that hang on a law fitted to tests.

    Each is a table ready for results.json: 95 % ranges over the laws that the tests allow, or a reason.
    """
    sample = sampled.sample.head(max(1, ROWS // sampled.sample.replicates))
    limits = {}
    for limit in work.study.limits:
        found = _of_limit(work, limit, sampled.limits[limit.name], sample)
        if found is not None:
            limits[limit.name] = found
    fitted = _fitted(work, work.scene_names)
    if not fitted:
        return limits, {}
    try:
        _refuse_dependent(work, list(fitted))
        columns = _columns(fitted, sample)
        weights = {name: _weights(work, name, law, columns[name]) for name, law in fitted.items()}
    except (_Unanswerable, LawError) as error:
        return limits, {q: {"from": _about(fitted), "reason": str(error)} for q in work.quantities}
    quantities = {}
    for quantity in work.quantities:
        values = sample.answer(quantity)
        whole = ~(sample.failed | sample.late(quantity)).ravel() & np.isfinite(values).ravel()
        if whole.sum() > 1:
            about = {"from": _about(fitted), "laws": LAWS}
            quantities[quantity] = {**about, **_of_quantity(work, weights, values, whole)}
    return limits, quantities
