"""Beyond variance and what drives failure, from samples that are there already: no further evaluations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from uqsphere.arrays import Array
from uqsphere.results import Fields
from uqsphere.runner.evaluate import Work
from uqsphere.runner.limits import state_of, tie_strength
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.runner.questions.indices import Sensitivity, Shared, normal_halves
from uqsphere.runner.questions.shapley import TASK, orders_at
from uqsphere.runner.schedule import REPLICATES
from uqsphere.study import Limit, limit_of, strength_name
from uqsphere.uq import (
    Estimate,
    Law,
    LimitState,
    Sample,
    absent,
    finite,
    from_replicates,
    random_generator,
    score_of,
    tails,
    without,
)
from uqsphere.uq.beyond_variance import delta_estimates, pawn_estimates
from uqsphere.uq.failure_indices import (
    explained_share,
    given_failure,
    held_open,
    indicator_indices,
    score_gradients,
    specimens_for_probability,
    specimens_for_share,
    sway_estimates,
    too_few,
)
from uqsphere.uq.fitting import count_tests
from uqsphere.uq.indices import Blocks, sampled_indices

if TYPE_CHECKING:
    from uqsphere.uq.shapley import SubsetDesign


#: samples of each replicate that delta, PAWN, and the drivers of failure rest on at most
DELTA_POINTS, PAWN_POINTS, POINTS = 2048, 512, 8192
#: base points of each replicate of a paired design
PAIRS = 2048
#: what the contribution of one input is to be brought below: of the variance, or of the probability
WANTED = 0.1
#: quantiles over which a random model factor is averaged
FACTORS = 32
_H = 1e-3

_VARIANCE = (
    "After n tests S/n of today's variance is left, S the input's share alone: n = S/0.1. Assumed: the scatter of the "
    "law is ignorance of one number, which tests find without error of their own, and the input acts by itself."
)
_PROBABILITY = (
    "After n tests the standard error of the input's mean is sd/sqrt(n), which moves the probability by its sway over "
    "sqrt(n): n = (sway/(0.1 p))^2. Assumed: tests scatter as the law says, only its centre is estimated, and the "
    "probability answers in proportion."
)


@dataclass(frozen=True, kw_only=True)
class Drivers:
    """Tables by quantity and by limit, as results.json has them."""

    quantities: dict[str, Fields] = field(default_factory=dict)
    limits: dict[str, Fields] = field(default_factory=dict)


def find_drivers(work: Work, sampled: Sampled, shared: Shared) -> Drivers:
    """Delta, PAWN and what to measure first for every quantity; for every limit what drives missing its aim.

    `shared` has the pairs of runs of the indices.
    """
    if not work.scene_names:
        return Drivers()
    sample = sampled.rows.head(POINTS).whole()
    quantities = {
        quantity: {
            **_distances(work, sample, quantity),
            "measure_first": _measure_variance(work, shared.sensitivity[quantity]),
        }
        for quantity in work.quantities
    }
    limits: dict[str, Fields] = {}
    for limit in work.study.limits if sample.count > 1 else ():
        state = state_of(work, limit, sample)
        chance = _missing(limit, state)
        driving: Fields = {
            "probability": float(chance.mean()),
            **_indices(work, limit, shared),
            "explained": explained_share(chance),
            "given_failure": _given_failure(work, limit, sample, state, chance),
        }
        measured = _measure_probability(work, limit, sample, state, chance)
        limits[limit.name] = {"drivers": driving, "measure_first": measured}
    return Drivers(quantities=quantities, limits=limits)


def _distances(work: Work, sample: Sample, quantity: str) -> Fields:
    """Delta and PAWN of every input for a quantity; censored values count as the end of the record."""
    names = work.scene_names
    x, y = sample.inputs[:, :, : len(names)], sample.answer(quantity)
    delta = delta_estimates(x[:, :DELTA_POINTS], y[:, :DELTA_POINTS])
    pawn = pawn_estimates(x[:, :PAWN_POINTS], y[:, :PAWN_POINTS], seed=work.study.seed)
    tables = {"delta": dict(zip(names, delta, strict=True)), "pawn": dict(zip(names, pawn.inputs, strict=True))}
    return {**tables, "pawn_threshold": finite(pawn.threshold)}


def _observed(law: Law | float) -> int | None:
    """How many observations a law was made from, where it was."""
    return count_tests(law) if isinstance(law, Law) and (law.data or law.draws) else None


def _measure_variance(work: Work, found: Sensitivity) -> Fields:
    """Inputs by what the variance would fall if they were known, with the tests that make their share small."""
    first = found.kucherenko.get("first") or found.first
    known = {name: (e, e.value) for name, e in first.items() if e.value is not None}
    rows = [
        {
            "input": name,
            "share": e,
            "tests": specimens_for_share(max(0.0, value), WANTED),
            "observations": _observed(work.study.random[name]),
        }
        for name, (e, value) in sorted(known.items(), key=lambda item: -item[1][1])
    ]
    reason = "" if rows else next((e.reason for e in first.values() if e.reason), "no index is known")
    return {"of": "variance", "wanted": WANTED, "method": _VARIANCE, "rows": rows, "reason": reason}


# --- limits ---------------------------------------------------------------------------------------------


def _missing(limit: Limit, state: LimitState) -> Array:
    """Probability of missing the aim given the inputs, (R, n)."""
    below, above = tails(state)
    return above if limit.aim == "break" else below


def _chances(work: Work, limit: Limit, values: Array, scores: Array | None) -> Array:
    """Probability of missing the aim at values of any shape, given the scores (..., d) of the model's inputs."""
    names = work.scene_names
    factors = np.array([limit.model_factor if not isinstance(limit.model_factor, Law) else 1.0])
    if isinstance(limit.model_factor, Law):
        factors = limit.model_factor.ppf((np.arange(FACTORS) + 0.5) / FACTORS)
    flat = values.reshape(values.shape[0], -1)
    state = LimitState(demands=flat, strength=limit.strength)
    if scores is not None:
        state = tie_strength(work, limit, state, names, scores.reshape(*flat.shape, len(names)))
    found = np.zeros_like(flat)
    for factor in factors:
        found += _missing(limit, replace(state, demands=flat * factor)) / factors.size
    return np.clip(found.reshape(values.shape), 0.0, 1.0)


def _indices(work: Work, limit: Limit, shared: Shared) -> Fields:
    """First and total indices of missing the aim, or Shapley effects and Kucherenko's where inputs are tied."""
    names, k = work.scene_names, work.quantities.index(limit.quantity)

    def named(*orders: str, **found: Sequence[Estimate]) -> dict[str, dict[str, Estimate]]:
        return {order: dict(zip(every, found[order], strict=False)) for order in orders}

    def refused(reason: str) -> Fields:
        nothing = [absent(reason, "pairs of runs, strength integrated", 0)] * len(names)
        return {"of": "missing the aim", **named("first", "total", first=nothing, total=nothing)}

    every, depends = names, work.all_inputs.tied()
    if isinstance(limit.model_factor, Law) and f"limits.{limit.name}.model_factor" in depends:
        return refused("the model factor depends on other variables, and its share cannot be told from theirs")
    design, runs = shared.subsets, shared.pairs
    if runs is None:
        return refused("no pairs of runs were evaluated, which these indices rest on")
    values, failed = runs.values[:, :PAIRS, :, k], runs.failed[:, :PAIRS]
    count = failed.shape[1]
    tied = isinstance(limit.strength, Law) and strength_name(limit.name) in depends
    scores = without(_scores(work, design, count), failed) if tied else None
    chance = _chances(work, limit, without(values, failed), scores)
    about: Fields = {"of": "the probability of missing the aim given the inputs"}
    if design is not None:
        from uqsphere.uq.shapley import shapley_estimates

        reason = too_few(chance if chance.mean() <= 0.5 else 1.0 - chance)
        if reason:
            nothing = refused(reason)
            kucherenko = dict.fromkeys(("first", "total"), nothing["first"])
            return {**nothing, "shapley": nothing["first"], "kucherenko": kucherenko}
        orders = orders_at(work, design, failed)
        found = held_open(shapley_estimates(design, chance, orders), chance, chance.shape[0] * count)
        nothing = refused("inputs depend on each other: read the Shapley effects")
        return {**nothing, **about, **named("shapley", **found), "kucherenko": named("first", "total", **found)}
    if tied or isinstance(limit.model_factor, Law):
        plain = sampled_indices(chance, Blocks(inputs_count=len(names)))
        return {**about, **named("first", "total", first=plain.first, total=plain.total)}
    if isinstance(limit.strength, Law):
        every = (*names, strength_name(limit.name))
    found = held_open(indicator_indices(chance), chance, chance.shape[0] * count)
    return {"of": "missing the aim", **named("first", "total", **found)}


def _scores(work: Work, subsets: SubsetDesign | None, count: int) -> Array:
    """Dependent normal scores (R, count, rows, d) of a paired design: made again, since they are not kept."""
    from uqsphere.uq.shapley import subset_scores

    seed, names = work.study.seed, work.scene_names
    if subsets is not None:
        inputs = work.all_inputs.only(names)
        return np.stack(
            [subset_scores(subsets, inputs, count=count, seed=seed, task=TASK, replicate=r) for r in range(REPLICATES)]
        )
    blocks = Blocks(inputs_count=len(names))
    return np.stack([blocks.mix(*halves) for halves in normal_halves(work, 0, count, blocks)])


# --- what the inputs look like where the aim is missed ----------------------------------------------------


def _given_failure(work: Work, limit: Limit, sample: Sample, state: LimitState, chance: Array) -> Fields:
    """Mean, sd and 5, 50, 95 % quantiles of every input given that the aim is missed, beside those of its law."""
    laws = dict(zip(work.drawn.names, work.drawn.laws, strict=True))
    columns = {name: sample.inputs[:, :, k] for k, name in enumerate(work.drawn.names)}
    if isinstance(limit.strength, Law):
        laws[strength_name(limit.name)] = limit.strength
        columns[strength_name(limit.name)] = _strengths(work, limit, limit.strength, state, chance)
    table: Fields = {}
    for name, values in columns.items():
        if limit_of(name) not in (None, limit.name):
            continue
        found = given_failure(values, chance)
        law = laws[name]
        quantiles = law.ppf(np.array(list(found.quantiles)))
        table[name] = {
            "mean": found.mean,
            "sd": found.sd,
            "quantiles": found.quantiles,
            "law": {
                "mean": finite(law.mean()),
                "sd": finite(law.sd()),
                "quantiles": dict(zip(found.quantiles, quantiles.tolist(), strict=True)),
            },
        }
    return table


def _strengths(work: Work, limit: Limit, law: Law, state: LimitState, chance: Array) -> Array:
    """A strength drawn at every point from its law given the inputs and that the aim is missed."""
    from scipy.special import ndtri

    generator = random_generator(seed=work.study.seed, task=f"target.{limit.name}")
    # the tail that misses the aim, cut at a random share of it; never exactly none
    tail = np.maximum(generator.random(chance.shape) * chance, 1e-300)
    score = np.asarray(ndtri(np.minimum(tail, 1.0 - 1e-16)))
    score = -score if limit.aim == "break" else score
    return law.from_normal(state.score_drawn(score))


# --- what to measure first ------------------------------------------------------------------------------


def _measure_probability(work: Work, limit: Limit, sample: Sample, state: LimitState, chance: Array) -> Fields:
    """Variables by what their means' uncertainty does to the probability, with the tests that make it small."""
    p = float(chance.mean())
    about: Fields = {"of": "probability", "wanted": WANTED, "method": _PROBABILITY, "rows": [], "reason": ""}
    if not 0.0 < p < 1.0:
        return {**about, "reason": "no sample decides: all miss the aim, or none"}
    names = work.drawn.names
    scores = work.drawn.scores(sample.scores.reshape(-1, len(names)))
    gradients = score_gradients(work.drawn, scores).reshape(sample.scores.shape)
    sways = dict(zip(names, sway_estimates(chance, gradients, _tied_moves(limit, state, len(names))), strict=True))
    laws: dict[str, Law | float] = dict(zip(names, work.drawn.laws, strict=True))
    if isinstance(limit.strength, Law) and not limit.strength.is_steps:
        moved = (_at_score(limit, state, -_H) - _at_score(limit, state, _H)) / (2.0 * _H)
        rows = moved.mean(axis=1)
        sways[strength_name(limit.name)] = from_replicates(rows, "difference of the strength's law", chance.size)
        laws[strength_name(limit.name)] = limit.strength
    sways = {n: e for n, e in sways.items() if limit_of(n) in (None, limit.name)}
    total = sum((e.value or 0.0) ** 2 for e in sways.values())
    rows_found = [
        {
            "input": name,
            "sway": e,
            "share": (e.value or 0.0) ** 2 / total if total > 0.0 else 0.0,
            # of a probability near 1 it is the other side that there is to know
            "tests": specimens_for_probability(e.value or 0.0, min(p, 1.0 - p), WANTED),
            "observations": _observed(laws[name]),
        }
        for name, e in sorted(sways.items(), key=lambda item: -abs(item[1].value or 0.0))
        if e.value is not None
    ]
    return {**about, "probability": p, "rows": rows_found}


def _at_score(limit: Limit, state: LimitState, step: float) -> Array:
    """Probability of missing the aim when the demand's score in the strength's law is moved by `step`."""
    from scipy.special import ndtr

    assert isinstance(limit.strength, Law)
    score = score_of(limit.strength.cdf(state.demands), limit.strength.sf(state.demands))
    score = state.score_given_inputs(score + step)
    return np.asarray(ndtr(-score if limit.aim == "break" else score))


def _tied_moves(limit: Limit, state: LimitState, d: int) -> Array | None:
    """What a tied strength adds to the derivative: it stays with the input that is left where it was."""
    if state.tie is None and state.shift is None:
        return None
    found = np.zeros((*state.demands.shape, d))
    if state.tie is not None:
        for k, column in enumerate(state.tie.of):
            step = np.zeros(len(state.tie.of))
            step[k] = _H
            lower, upper = (
                _missing(limit, replace(state, tie=replace(state.tie, given=state.tie.given + sign * step)))
                for sign in (-1.0, 1.0)
            )
            found[:, :, column] = (lower - upper) / (2.0 * _H)
    elif state.shift is not None:
        for column, weight in enumerate(state.weights):
            if weight:
                lower, upper = (
                    _missing(limit, replace(state, shift=state.shift + sign * weight * _H)) for sign in (-1.0, 1.0)
                )
                found[:, :, column] = (lower - upper) / (2.0 * _H)
    return found
