"""Limits and failure modes: demand against strength at the sampled points, the strength integrated
exactly; and fracture by any limit of the study: how likely, by which mode first, and in what state
of loading.

The moment of fracture is read off the loading of a few hundred spheres, drawn with their strengths
from those that break.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.models.scene import fractures_of
from uqsphere.results.answers import Rows, estimate_row, number_row
from uqsphere.study import Limit, limit_of
from uqsphere.uq import Estimate, Law, LimitState, Sample, exact, from_replicates, score_of
from uqsphere.uq.estimate import absent, count_bound, lost_share, share
from uqsphere.uq.limit_state import (
    make_union,
    reliability_index,
    residual_correlation,
    weighted_quantile,
)

from .design import Design, demands_of
from .tables import Tables, input_rows

#: points of a replicate that the drivers rest on at most, and the step of a score for derivatives
MOST_POINTS, STEP = 2048, 1e-3


def limits(tables: Tables) -> Rows:
    """Fracture and failure probability, reliability index and strength over demand of every
    limit.
    """
    design = tables.design
    for limit in design.judged.limits:
        subject = limit.subject
        runs = tables.runs
        failed = exceeded = failure(tables, limit)
        if limit.subject in tables.rare:
            runs += tables.rare[limit.subject].estimate.evaluations
        if limit.aim != "survive":
            exceeded = failed.complement()
        yield estimate_row(subject, "exceedance_probability", exceeded, runs=runs)
        yield estimate_row(subject, "failure_probability", failed, runs=runs)
        index, high, low = map(reliability_index, (failed.value, *failed.outer))
        if index is not None:
            yield number_row(
                subject, "reliability_index", "", index, low, high, method=failed.method, runs=runs
            )
        ratio = state_of(design, limit, tables.sample).safety_factor()
        yield estimate_row(subject, "safety_factor", ratio, "strength over demand", runs=runs)


def failure(tables: Tables, limit: Limit) -> Estimate:
    """The failure probability of a limit: of missing its aim."""
    design = tables.design
    column = limit.column
    state = state_of(design, limit, tables.sample)
    sampled = state.failure_of_aim(limit.aim)
    if limit.subject in tables.rare:
        searched = tables.rare[limit.subject].estimate
        lost = lost_share(state.broken)
        if lost:
            searched = _of_answered(searched, state, lost)
        return _searched(searched, sampled, lost * (state.on_failure != "bound"))
    constant = not design.variables and tables.sample.knows(column)
    if constant and sampled.value is not None:
        return exact(sampled.value)
    return tables.probability(
        column,
        sampled,
        lambda sample: failure_given_inputs(state_of(design, limit, sample), limit),
    )


def _of_answered(searched: Estimate, state: LimitState, lost: float) -> Estimate:
    """The answer of a search where rows of the sample failed: a probability of the runs that
    answered, as that of the sample is.

    A search has what fails and answers, over all runs.  It draws where failures are, and does not
    know how many rows fail elsewhere: their share, `lost` at most, is that of the sample.  Where
    they count ("bound") the interval holds it.
    """
    least, most = searched.by_answered
    in_search = (searched.high or 1.0) - (most or 1.0)
    low = (least or 0.0) / lost_share(~state.broken)
    high = min((most or 1.0) / (1.0 - lost), 1.0)
    unseen = ((searched.high_unseen or 1.0) - in_search) / (1.0 - lost)
    of_answered = replace(
        searched,
        value=searched.value and searched.value / (1.0 - state.broken.mean()),
        low=low,
        high=high,
        low_unseen=searched.outer[0],
        high_unseen=min(unseen, 1.0),
        answered=(low, high),
    )
    if state.on_failure != "bound":
        return of_answered
    return replace(
        of_answered,
        low=searched.low,
        high=min(high + lost, 1.0),
        high_unseen=min(unseen + lost, 1.0),
    )


def _searched(searched: Estimate, sampled: Estimate, lost: float = 0.0) -> Estimate:
    """The answer of a search, beside that of the plain sample: failures that the search did not aim
    at are no more probable than a sample without them allows, nor those of `lost` rows that were
    left out.  Where the sample by itself allows for less than the search, it answers.
    """
    missed = count_bound(sampled.evaluations)
    low, high = sampled.outer
    most = min((high or 1.0) + missed, 1.0)
    least, largest = sampled.by_answered
    largest = min((largest or 1.0) + missed, 1.0)
    if searched.value and (sampled.low or 0.0) > (searched.high or 1.0):
        # the sample has met failures that the search missed
        return sampled.holding(searched)
    if not searched.value or 0.5 * largest < searched.reducible:
        # such a search knows no more than the sample does
        if sampled.value:
            low = max((low or 0.0) - missed, 0.0)
            return replace(
                sampled,
                low=low,
                high=most,
                low_unseen=None,
                high_unseen=None,
                answered=(max((least or 0.0) - missed, 0.0), largest),
            )
        high = sampled.high or 1.0
        if not searched.value or searched.value >= high:
            # chains that met no failure bound nothing: they may have gone another way
            reason = (
                f"no failure in {sampled.evaluations} samples; the probability is below {high:.2g}"
            )
            searched = absent(reason, searched.method, searched.evaluations, below=high)
        return replace(searched, high=high, high_unseen=sampled.high_unseen)
    unseen = min((searched.high or 1.0) + missed, searched.high_unseen or 1.0)
    return replace(searched, high_unseen=min(unseen + lost, 1.0))


def failure_given_inputs(state: LimitState, limit: Limit) -> np.ndarray:
    """Probability (R, n) that a limit misses its aim given the inputs."""
    below, above = state.tails()
    return above if limit.aim == "break" else below


def sign_of(limit: Limit) -> float:
    """-1 for a limit that must break, else 1."""
    return -1.0 if limit.aim == "break" else 1.0


def state_of(design: Design, limit: Limit, sample: Sample) -> LimitState:
    """Demands of a limit at points against its strength, with the dependence between the two."""
    state = LimitState(
        demands=demands_of(limit, sample),
        strength=limit.resistance,
        censored=sample.late(limit.column),
        on_failure=design.analysis.policy,
    )
    name = limit.strength_name
    if not design.study.dependence or name not in design.joint.names:
        return state
    scores = design.drawn.scores(sample.scores)
    return replace(state, tie=design.joint.tie(name, design.variables, scores))


# --- drivers -----------------------------------------------------------------------------------


def drivers(tables: Tables) -> Rows:
    """What drives the failure probability of every limit: its change per standard deviation that
    the centre of an input, or of the strength, is moved by.

    Failure has the conditional probability T = P(failure | inputs), F_S(demand) or its complement,
    the strength being integrated.
    """
    design = tables.design
    names = design.variables
    if not names:
        return
    sample = tables.sample.head(MOST_POINTS)
    scores = design.drawn.scores(sample.scores).reshape(-1, len(names))
    gradients = design.drawn.score_gradients(scores).reshape(sample.scores.shape)
    for limit in design.judged.limits:
        state = state_of(design, limit, sample)
        subject = limit.subject
        moved = np.zeros(gradients.shape)
        tie = state.tie
        # a strength that depends on an input stays where it was while the input moves
        for step, column in zip(STEP * np.eye(len(tie.columns)), tie.columns, strict=True):
            below, above = (
                failure_given_inputs(replace(state, tie=replace(tie, scores=at)), limit)
                for at in (tie.scores - step, tie.scores + step)
            )
            moved[:, :, column] = (below - above) / (2.0 * STEP)
        changes = change_per_sd(failure_given_inputs(state, limit), gradients, moved)
        for name, estimate in zip(names, changes, strict=True):
            if limit_of(name) in (None, limit.name):
                yield estimate_row(subject, "driver", estimate, name, runs=tables.runs)
        law = state.strength
        if isinstance(law, Law) and not law.is_steps:
            score = score_of(*law.tails(state.demands))
            low, high = (
                special.ndtr(sign_of(limit) * tie.conditional_score(score + step)).mean(axis=1)
                for step in (-STEP, STEP)
            )
            change = from_replicates((low - high) / (2.0 * STEP), "difference", tables.runs)
            yield estimate_row(subject, "driver", change, limit.strength_name, runs=tables.runs)


def change_per_sd(
    probabilities: Array, gradients: Array, moved: Array | float = 0.0
) -> list[Estimate]:
    """Change of the failure probability per standard deviation that an input's centre is moved by.

    For T (R, n) and gradients (R, n, d) of `Joint.score_gradients` it is E[T g_i], by the density
    that moves with the law's centre in normal scores, everything that ties inputs staying as it is;
    T is taken about its mean, which changes nothing but the noise.  `moved` (R, n, d) adds what a
    strength that is tied to the inputs does meanwhile.
    """
    about = probabilities - probabilities.mean()
    rows = (about[:, :, None] * gradients + moved).mean(axis=1)
    return [from_replicates(row, "derivative of the density", probabilities.size) for row in rows.T]


# --- fracture by any limit ------------------------------------------------------------------------

#: spheres of each replicate whose loading is followed, of the first so many points
SPECIMENS, SPHERES = 16, 512
METHOD = "spheres that break, along their loading"
#: what is told of the moment of fracture, and its quantiles
STATE, QUANTILES = ("time", "force", "energy"), (0.05, 0.5, 0.95)
TIMELESS = "a closed form gives the peaks of this loading, not its course over time"


def fracture(tables: Tables, judged: Mapping[frozenset[str], Estimate]) -> Rows:
    """Probability of fracture by any limit, the share of each mode, and time and force at
    fracture.

    judged : the probability that a decision has, by the names of the limits that it is of
    """
    design = tables.design
    limits = _each_once(design.fracture)
    if len(limits) < 2 or design.study.black_box:
        return
    sample = tables.sample.head(SPHERES)
    generator = design.generator("fracture")
    union = make_union(
        [state_of(design, limit, sample) for limit in limits],
        common_factor(design, limits),
        generator,
    )
    exceeded = judged.get(frozenset(limit.name for limit in limits))
    exceeded = exceeded or union.state.failure_of_aim("survive")
    yield estimate_row("fracture", "exceedance_probability", exceeded, runs=tables.runs)
    drawn = union.draw_breaking(SPECIMENS, generator)
    if drawn is None:
        yield from _not_known("no sphere of the sample can break", limits)
        return
    shape = drawn.rows.shape
    flat = (np.arange(shape[0])[:, None] * sample.count + drawn.rows).ravel()
    names, rows = input_rows(sample)
    fractures = fractures_of(
        design.judged,
        names,
        rows[flat],
        [limit.quantity for limit in limits],
        drawn.shares.reshape(len(limits), -1).T,
    )
    if isinstance(fractures, str):
        yield from _not_known(fractures, limits)
        return
    # spheres that could not be followed are left out, as many of each replicate
    lost = fractures.first.reshape(shape) < 0
    followed = np.flatnonzero(~lost.all(axis=1))
    if len(followed) < 2:
        yield from _not_known("too few of the spheres that break can be followed", limits)
        return
    count = shape[1] - lost[followed].sum(axis=1).max()
    places = np.argsort(lost[followed], axis=1, kind="stable")[:, :count]
    weights = drawn.weights[followed]
    weights /= weights.mean()

    def of_followed(column: Any) -> Any:
        return np.take_along_axis(column.reshape(shape)[followed], places, axis=1)

    first = of_followed(fractures.first)
    for k, limit in enumerate(limits):
        by_mode = share(first == k, METHOD, weights=weights)
        yield estimate_row("fracture", "mode_share", by_mode, limit.name, runs=first.size)
    for name in STATE:
        values = of_followed(getattr(fractures, name))
        for p in QUANTILES:
            estimate = absent(TIMELESS, METHOD, 0)
            if np.isfinite(values).all():
                estimate = weighted_quantile(values, weights, p, METHOD, first.size)
            yield estimate_row("fracture", f"{name}_at_fracture", estimate, p, runs=first.size)


def _not_known(reason: str, limits: Sequence[Limit]) -> Rows:
    """The rows of what is not known of the moment of fracture, with the reason."""
    nothing = absent(reason, METHOD, 0)
    for limit in limits:
        yield estimate_row("fracture", "mode_share", nothing, limit.name)
    for name in STATE:
        for p in QUANTILES:
            yield estimate_row("fracture", f"{name}_at_fracture", nothing, p)


def _each_once(limits: Sequence[Limit]) -> list[Limit]:
    """The limits that count as fracture, one for each strength: a sphere that must not break below
    one speed and must above another has one strength.
    """
    once = []
    strengths = []
    for limit in limits:
        strength = (limit.quantity, limit.strength, limit.model_factor)
        if limit.fracture is not False and strength not in strengths:
            once.append(limit)
            strengths.append(strength)
    return once


def common_factor(design: Design, limits: Sequence[Limit]) -> Array:
    """Cholesky factor of the correlation that strengths have with each other, given all that is
    drawn.
    """
    place_of = design.joint.names.index
    correlation = design.joint.correlation
    covariance = np.eye(len(limits))
    names = [limit.strength_name for limit in limits]
    random = [k for k, name in enumerate(names) if name in design.joint.names]
    if not design.joint.dependent or len(random) < 2:
        return covariance
    at = [place_of(names[k]) for k in random]
    drawn = [*map(place_of, design.variables)]
    across = correlation[np.ix_(drawn, at)]
    explained = across.T @ np.linalg.solve(correlation[np.ix_(drawn, drawn)], across)
    covariance[np.ix_(random, random)] = correlation[np.ix_(at, at)] - explained
    return residual_correlation(covariance)
