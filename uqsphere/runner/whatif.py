"""What if: how the answers move where something is taken otherwise, on the rows that are there.

A law fitted to n tests enters every answer as if it were known: here others that the same tests allow take its place.
A strength is held against the demands by another law, or without its assumed dependence on the inputs.  And how many
tests would settle what these leave undecided.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Places
from uqsphere.results import LimitOpenEntry
from uqsphere.results.entries import Fields, MarginOpenEntry
from uqsphere.runner.axis_rows import AxisRows
from uqsphere.runner.evaluate import Work
from uqsphere.runner.limits import LimitAnswer, state_of, told_by_runs
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.study import Limit, spaced, strength_name
from uqsphere.uq import NORMAL, Estimate, Law, LawError, LimitState, Sample, miss, random_generator, target_met
from uqsphere.uq.fitting import count_tests, is_fitted, laws_of_more_tests, possible_laws, possible_tails
from uqsphere.uq.whatif import (
    MOST_TESTS,
    WhatIf,
    curves_under,
    fewest_tests,
    importance_weights,
    is_decided,
    logit,
    probability_of_logit,
    root,
    roots,
    sides,
)

#: laws in place of every fitted one, and rows of the sample that they are tried on
LAWS: Final = 400
ROWS: Final = 8192
#: laws for the range of a value and its sure end.  Twenty tests of limestone, eight seeds each: one standard error of
#: the sure end is 5 % of the value (0.08 of the range) with 200 laws, 2.5 % with 800, 1.1 % with these
MANY_LAWS: Final = 4000
#: laws for every number of tests, rows of each replicate, and values of the free scalar
FEW_LAWS: Final = 200
FEW_ROWS: Final = 32
VALUES: Final = 25
#: laws for the range of a curve
TRIED: Final = 40
#: nine normal scores out a kernel density has nothing more to say
FURTHEST_SCORE: Final = 9.0
#: by how much the scatter of a strength, or its modulus, is taken otherwise
FIFTH: Final = 0.2
#: confidence with which a value is sure, and the half-width of the 95 % range, relative, within which it is known
SURE: Final = 0.95
KNOWN: Final = 0.05
TOO_CLOSE: Final = f"more than {MOST_TESTS} tests: it is too close to call"


def _generator(work: Work, name: str) -> np.random.Generator:
    """The same laws wherever a variable is asked for."""
    return random_generator(seed=work.study.seed, task=f"ignorance {name}")


def _laws_of(work: Work, limit: Limit, strength: Law, count: int) -> list[Law]:
    """Laws that the tests behind a strength allow.  Raises LawError where it is not known which."""
    return possible_laws(strength, count, _generator(work, strength_name(limit.name)))


def probabilities_by_tests(work: Work, limit: Limit, states: Sequence[LimitState]) -> Array | None:
    """Between which ends (2, J) the probability lies at J states by the laws of a strength that its tests allow.

    None where it was not fitted to tests, or these do not tell.
    """
    if not (isinstance(limit.strength, Law) and is_fitted(limit.strength)):
        return None
    try:
        laws = _laws_of(work, limit, limit.strength, TRIED)
    except LawError:
        return None
    # one law in fifty may leave the range
    return np.asarray(np.quantile(curves_under(states, laws), [0.02, 0.98], axis=0))


def _missing(exceeded: Array, limit: Limit) -> Array:
    return exceeded if limit.aim == "survive" else 1.0 - exceeded


# --- other laws that the tests allow -----------------------------------------------------------------------


def find_ignorance(work: Work, sampled: Sampled) -> tuple[dict[str, LimitOpenEntry], dict[str, Fields]]:
    """What the tests leave open: (by limit, by quantity), of those that hang on a law fitted to tests.

    Each is a table ready for results.json: 95 % ranges over the laws that the tests allow, or a reason.
    """
    laws = zip(work.all_inputs.names, work.all_inputs.laws, strict=True)
    every = {name: law for name, law in laws if is_fitted(law)}
    sample = sampled.sample.head(max(1, ROWS // sampled.sample.replicates)).whole()
    limits = {}
    for limit in work.study.limits:
        own = (*work.scene_names, f"limits.{limit.name}.model_factor", strength_name(limit.name))
        fitted = {name: every[name] for name in own if name in every}
        if fitted and sampled.limits[limit.name].exceedance.value is not None:
            opened = _limit_left_open(work, limit, sampled.limits[limit.name], sample, fitted)
            limits[limit.name] = LimitOpenEntry.model_validate({"from": _about(fitted), **opened})
    fitted = {name: every[name] for name in work.scene_names if name in every}
    if not fitted:
        return limits, {}
    try:
        weights = _weights(work, fitted, sample)
    except LawError as error:
        return limits, {q: {"from": _about(fitted), "reason": str(error)} for q in work.quantities}
    together = np.prod(list(weights.values()), axis=0).reshape(LAWS, -1)
    quantities: dict[str, Fields] = {}
    for quantity in work.quantities:
        values = sample.answer(quantity)
        known = (np.isfinite(values) & ~sample.late(quantity)).ravel()
        if known.sum() > 1:
            open_ = _quantity_left_open(work, together[:, known], values.ravel()[known])
            quantities[quantity] = {"from": _about(fitted), "laws": LAWS, **open_}
    return limits, quantities


def _about(fitted: dict[str, Law]) -> list[Fields]:
    return [{"input": name, "fit": law.fit, "tests": count_tests(law)} for name, law in fitted.items()]


def _weights(work: Work, fitted: dict[str, Law], sample: Sample) -> dict[str, Array]:
    """Weights (laws, R, n) of the rows under other laws of each input.  Raises LawError where there are none."""
    found = {}
    for name, law in fitted.items():
        if name in work.drawn.tied():
            # a strength may depend on inputs, these are weighted one by one
            raise LawError(f"{name} depends on other inputs, and the tests say nothing of their dependence", name)
        column = sample.input(name)
        weights = importance_weights(law, column.ravel(), LAWS, _generator(work, name))
        if weights is None:
            raise LawError("the tests leave open laws that lie too far from the rows that were sampled", name)
        found[name] = weights.reshape(LAWS, *column.shape)
    return found


def _spread(values: Array) -> list[float]:
    low, high = np.quantile(values, [0.025, 0.975])
    return [float(low), float(high)]


def _quantity_left_open(work: Work, weight: Array, values: Array) -> Fields:
    """Where mean and quantiles of one quantity may lie, by the weights (laws, rows) of its values (rows,)."""
    order = np.argsort(values, kind="stable")
    ordered = values[order]
    weight = weight / weight.sum(axis=1, keepdims=True)
    running = np.cumsum(weight[:, order], axis=1)
    quantiles = {}
    for p in work.study.analysis.quantiles:
        at = np.minimum((running < p).sum(axis=1), ordered.size - 1)
        quantiles[f"{p:.15g}"] = _spread(ordered[at])
    return {"mean": _spread(weight @ values), "quantiles": quantiles}


def _limit_left_open(work: Work, limit: Limit, answer: LimitAnswer, sample: Sample, fitted: dict[str, Law]) -> Fields:
    """Where the probability of one limit may lie, all fitted laws together and each alone."""
    try:
        exceedance = _under_laws(work, limit, answer, sample, fitted)
    except LawError as error:
        return {"reason": str(error)}
    together = exceedance(list(fitted))
    missed, met = _missing(together, limit), None
    if limit.target is not None and is_decided(missed, limit.target):
        met = _spread(missed)[1] < limit.target
    return {
        "laws": LAWS,
        "exceedance": _spread(together),
        "miss": _spread(missed),
        "miss_mean": float(missed.mean()),
        "alone": {name: _spread(_missing(exceedance([name]), limit)) for name in (fitted if len(fitted) > 1 else ())},
        "met": met,
    }


def _shifts(work: Work, strength: str, inputs: Mapping[str, Law], sample: Sample) -> dict[str, Array]:
    """What a strength that hangs on inputs moves by (LAWS, R, n), in normal scores, under other laws of each."""
    from scipy.special import ndtri

    weights = work.all_inputs.regression(strength, work.drawn.names)[0]
    ties, shifts = dict(zip(work.drawn.names, weights, strict=True)), {}
    for name in (name for name in inputs if ties[name]):
        column = sample.input(name)
        after = possible_tails(inputs[name], column.ravel(), LAWS, _generator(work, name))[0]
        scores = [ndtri(inputs[name].cdf(column)), ndtri(after).reshape(LAWS, *column.shape)]
        before, scores_after = (np.clip(one, -FURTHEST_SCORE, FURTHEST_SCORE) for one in scores)
        shifts[name] = ties[name] * (scores_after - before)
    return shifts


def _tails(work: Work, law: Law, name: str, state: LimitState) -> tuple[Array, Array]:
    """Both tails (LAWS, R, n) of other laws of a strength at the demands."""
    at = np.nextafter(state.demands, -math.inf) if law.is_steps else state.demands
    below, above = possible_tails(law, at.ravel(), LAWS, _generator(work, name))
    return below.reshape(LAWS, *at.shape), above.reshape(LAWS, *at.shape)


def _under_laws(
    work: Work, limit: Limit, answer: LimitAnswer, sample: Sample, fitted: dict[str, Law]
) -> Callable[[Sequence[str]], Array]:
    """Probability of exceeding (LAWS,) with the laws of some variables replaced by those that their tests allow."""
    key = strength_name(limit.name)
    state = state_of(work, limit, sample)
    if state.tie is not None:
        raise LawError("another than the Gaussian copula ties the strength to inputs", key)
    inputs = {name: law for name, law in fitted.items() if name != key}
    weights = _weights(work, inputs, sample)
    shifts = {} if state.shift is None else _shifts(work, key, inputs, sample)
    tails = _tails(work, fitted[key], key, state) if key in fitted else None
    value = answer.exceedance.value
    offset = math.nan if value is None else logit(value, 1.0 - value) - logit(*sides(state))

    def exceedance(names: Sequence[str]) -> Array:
        weighted, moved = ([one[name] for name in names if name in one] for one in (weights, shifts))
        whatifs = _each_law(weighted, moved, tails if key in names else None)
        logits = [logit(*sides(state, whatif)) for whatif in whatifs]
        return np.array([probability_of_logit(x + (offset if math.isfinite(offset) else 0.0)) for x in logits])

    return exceedance


def _each_law(weights: Sequence[Array], shifts: Sequence[Array], tails: tuple[Array, Array] | None) -> Iterator[WhatIf]:
    """The first, the second, ... of the other laws of some variables together."""
    for k in range(LAWS):
        yield WhatIf(
            strength=tails and (tails[0][k], tails[1][k]),
            weights=np.prod([one[k] for one in weights], axis=0) if weights else None,
            shift=np.sum([one[k] for one in shifts], axis=0) if shifts else None,
        )


# --- other laws of a strength that is given -----------------------------------------------------------------


def find_assumed(work: Work, sampled: Sampled) -> dict[str, Fields]:
    """For every limit with a random strength: `assumed` rows and `tests_to_settle`, as plain JSON.

    A row names what is assumed (`dependence`, `modulus`, `cov`, `law`), what is `taken` and what is put `instead`,
    and has the probability of missing the aim that follows (`miss`, an EST) and whether the target is then `met`.
    """
    found: dict[str, Fields] = {}
    for limit in work.study.limits:
        answer = sampled.limits.get(limit.name)
        if not isinstance(limit.strength, Law) or answer is None or answer.miss.value is None:
            continue
        state = state_of(work, limit, sampled.sample)
        rows = [_row(limit, answer, state, one, about) for one, about in _assumptions(work, limit, state)]
        found[limit.name] = {"assumed": rows}
        settled = _tests_to_settle(work, limit, limit.strength, sampled.sample)
        if settled is not None:
            found[limit.name]["tests_to_settle"] = settled
    return found


def _assumptions(work: Work, limit: Limit, state: LimitState) -> list[tuple[WhatIf, Fields]]:
    """What may be taken otherwise: no tie, another scatter about the same mean, another family with both the same."""
    found: list[tuple[WhatIf, Fields]] = []
    law = limit.strength
    assert isinstance(law, Law)
    if state.tie is not None or state.shift is not None:
        own = strength_name(limit.name)
        groups = [group for group in work.study.dependence if own in group.of]
        others = list(dict.fromkeys(name for group in groups for name in group.of if name != own))
        found.append((WhatIf(untied=True), {"assumption": "dependence", "with": others}))
    # what a fitted law does not know of its scatter, its tests tell
    for factor in () if is_fitted(law) else (1.0 - FIFTH, 1.0 + FIFTH):
        other = law.with_scatter(factor)
        if other is not None:
            what, taken, instead, changed = other
            found.append((WhatIf(strength=changed), {"assumption": what, "taken": taken, "instead": instead}))
    another = law.kin()
    if another is not None:
        about: Fields = {"assumption": "law", "taken": law.family.name, "instead": another.family.name}
        found.append((WhatIf(strength=another), about))
    return found


def _row(limit: Limit, answer: LimitAnswer, state: LimitState, whatif: WhatIf, about: Fields) -> Fields:
    other = whatif.of(state)
    told = told_by_runs(miss(other, limit.aim), other, "miss", limit.aim)
    found = _against(answer.miss, miss(state, limit.aim), told)
    met = None if limit.target is None or found.value is None else target_met(found, limit.target)
    return {**about, "miss": found, "met": met}


def _against(answer: Estimate, same: Estimate, other: Estimate) -> Estimate:
    """The probability by another strength; put right by what these rows are off, where the run knows its answer better.

    The uncertainty of the answer and that of the rows are then added.
    """
    if answer.value == same.value:
        return other
    rows = []
    for one in (answer, same, other):
        ends = [math.nan if end is None else end for end in (one.low, one.value, one.high)]
        if not all(0.0 < end < 1.0 for end in ends):
            return other
        rows.append([math.log(end) - math.log1p(-end) for end in ends])
    if rows[0][2] - rows[0][0] >= rows[1][2] - rows[1][0]:
        return other
    value = rows[2][1] + rows[0][1] - rows[1][1]
    half = [math.hypot(*(abs(row[end] - row[1]) for row in rows)) for end in (0, 2)]
    low, middle, high = (probability_of_logit(x) for x in (value - half[0], value, value + half[1]))
    return replace(other, value=middle, method=f"{other.method}, put right by the answer's own method").spanning(
        low, high
    )


# --- how many tests would settle the target -----------------------------------------------------------------


def _tests_to_settle(work: Work, limit: Limit, law: Law, sample: Sample) -> Fields | None:
    """How many tests of a strength that is given as a law would put the target outside of what they leave open."""
    if is_fitted(law) or limit.target is None or law.parameters.get("threshold", 0.0) != 0.0:
        return None
    try:
        tests = _fewest(work, limit, law, sample, "tests", 3)
    except LawError:
        return None
    return {"tests": tests, "confidence": SURE, **({"reason": TOO_CLOSE} if tests is None else {})}


def _decided(work: Work, limit: Limit, sample: Sample) -> Callable[[Sequence[Law]], bool]:
    """Whether laws of the strength agree on which side of the target the limit is, by few rows."""
    assert limit.target is not None
    state, target = state_of(work, limit, sample.head(FEW_ROWS)), limit.target
    return lambda laws: is_decided(_missing(curves_under([state], laws)[:, 0], limit), target)


def _fewest(work: Work, limit: Limit, law: Law, sample: Sample, task: str, known: int) -> int | None:
    """The least number of tests above those known that decide the target if they come out as a law says."""
    decided = _decided(work, limit, sample)

    def simulated(tests: int) -> bool:
        generator = random_generator(seed=work.study.seed, task=f"{task} {limit.name} {tests}")
        return decided(laws_of_more_tests(law, tests, FEW_LAWS, generator))

    return fewest_tests(simulated, known)


def _more_tests(work: Work, sampled: Sampled, limit: Limit, strength: Law, spread: float | None) -> Fields:
    """How many more tests decide the target as planned, and how many give a value with this spread to within `KNOWN`.

    Both take it that further tests come out as those so far: the answer is the size of the effort, no promise.
    """
    tests = count_tests(strength)
    found: Fields = {"tests": tests, "known_to": KNOWN}
    if spread is not None:
        # the range shrinks with the root of the number of tests
        found["to_know_the_value"] = max(0, math.ceil(tests * (NORMAL * spread / KNOWN) ** 2) - tests)
    if limit.target is None:
        return found
    if _decided(work, limit, sampled.sample)(_laws_of(work, limit, strength, FEW_LAWS)):
        return {**found, "to_settle": 0}
    in_all = _fewest(work, limit, strength, sampled.sample, "more tests", tests)
    if in_all is None:
        return {**found, "to_settle": None, "reason": TOO_CLOSE}
    return {**found, "to_settle": in_all - tests}


# --- the value of a free scalar under other laws ----------------------------------------------------------


def margin_left_open(
    work: Work,
    sampled: Sampled,
    limit: Limit,
    rows: AxisRows,
    value: Estimate,
    *,
    probability: float,
    rising: bool,
) -> Fields:
    """What the tests of a strength leave open of the value at a probability, and how many more would tell.

    Empty where the strength was not fitted to tests; `rows` are those of the curve.
    """
    strength = limit.strength
    if not (isinstance(strength, Law) and is_fitted(strength)):
        return {}
    try:
        if value.value is None:
            left = MarginOpenEntry(reason=value.reason)
        else:
            laws = _laws_of(work, limit, strength, MANY_LAWS)
            left = _value_range(limit, strength, laws, rows, value.value, probability, rising)
        return {"ignorance": left, "more_tests": _more_tests(work, sampled, limit, strength, left.sd_log)}
    except LawError as error:
        return {"ignorance": MarginOpenEntry(reason=str(error))}


def _value_range(
    limit: Limit, strength: Law, laws: Sequence[Law], rows: AxisRows, value: float, probability: float, rising: bool
) -> MarginOpenEntry:
    """Where the value at a probability may lie over laws that the tests allow, which is sure, and the mean law's."""
    low, high = rows.grid[0], rows.grid[-1]
    logarithmic, values = low > 0.0, spaced(low, high, VALUES)
    places = np.log(values) if logarithmic else np.array(values)
    states = rows.states(limit, values, FEW_ROWS)

    def under(some: Sequence[Law]) -> Array:
        def curves_at(j: int, which: Places) -> Array:
            return curves_under([states[j]], [some[k] for k in which])[:, 0]

        return roots(places, curves_at, len(some), probability, rising)

    def told(place: float) -> float | None:
        place += shift
        if not math.isfinite(place):
            return None
        return math.exp(place) if logarithmic else float(place)

    # on these few rows the law itself answers a little differently: what is known better is kept
    own = float(under([strength])[0])
    shift = 0.0 if not math.isfinite(own) else (math.log(value) if logarithmic else value) - own
    found = under(laws)
    safe = 1.0 - SURE if (limit.aim == "survive") == rising else SURE
    ends = np.quantile(found, [0.025, 0.975, safe], method="nearest").tolist()
    known = found[np.isfinite(found)]
    return MarginOpenEntry(
        tests=count_tests(strength),
        stopped=len(strength.censored),
        laws=len(laws),
        low=told(ends[0]),
        high=told(ends[1]),
        sure=told(ends[2]),
        confidence=SURE,
        mean_law=told(root(places, lambda j: float(curves_under([states[j]], laws).mean()), probability, rising)),
        sd_log=float(np.std(known, ddof=1)) if logarithmic and known.size > 0.9 * len(laws) else None,
        beyond=float(1.0 - known.size / len(laws)),
    )
