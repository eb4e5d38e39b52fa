"""What a verdict takes for granted of a strength, and what the probability would be without it.

The demands are those that were sampled; the strength is held against them by another law, or without its assumed
dependence on the inputs.  Nothing is evaluated again.  For a strength that is given as a law it is also told how many
tests of such a law would settle whether the target is kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.runner.curves import law_curves
from uqsphere.runner.evaluate import Work
from uqsphere.runner.limits import LimitAnswer, state_of, told_by_runs
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.study import Limit
from uqsphere.uq.estimate import Estimate
from uqsphere.uq.fitting import is_fitted, laws_of_more_tests
from uqsphere.uq.law import Law, LawError, make_law, mean, sd
from uqsphere.uq.limit_state import LimitState, miss, target_met
from uqsphere.uq.points import random_generator

__all__ = ["MOST_TESTS", "few_rows", "fewest_tests", "find_assumed", "is_decided", "other_family", "with_scatter"]

Array = npt.NDArray[np.float64]

#: by how much the scatter of a strength, or its modulus, is taken otherwise
FIFTH: Final = 0.2
#: laws that are tried for every number of tests, and points of each replicate that they are tried on
LAWS: Final = 200
FEW: Final = 32
#: more tests than this are not asked of anybody
MOST_TESTS: Final = 5000
#: logits beyond this are those of 0 and 1
_FAR: Final = 700.0


def find_assumed(work: Work, sampled: Sampled) -> dict[str, dict[str, Any]]:
    """For every limit with a random strength: `assumed` rows and `tests_to_settle`, as plain JSON.

    A row names what is assumed (`dependence`, `modulus`, `cov`, `law`), what is `taken` and what is put `instead`,
    and has the probability of missing the aim that follows (`miss`, an EST) and whether the target is then `met`.
    """
    found: dict[str, dict[str, Any]] = {}
    for limit in work.study.limits:
        answer = sampled.limits.get(limit.name)
        if not isinstance(limit.strength, Law) or answer is None or answer.miss.value is None:
            continue
        state = state_of(work, limit, sampled.sample)
        rows = [*_independence(work, limit, answer, state), *_shapes(limit, limit.strength, answer, state)]
        found[limit.name] = {"assumed": rows}
        settled = _tests_to_settle(work, limit, limit.strength, few_rows(state))
        if settled is not None:
            found[limit.name]["tests_to_settle"] = settled
    return found


# --- the probability without an assumption ---------------------------------------------------------------


def _row(limit: Limit, answer: LimitAnswer, state: LimitState, other: LimitState, **about: Any) -> dict[str, Any]:
    told = told_by_runs(miss(other, limit.aim), other, "miss", limit.aim)
    found = _against(answer.miss, miss(state, limit.aim), told)
    met = None if limit.target is None or found.value is None else target_met(found, limit.target)
    return {**about, "miss": found.as_dict(), "met": met}


def _logit(p: float) -> float:
    return math.inf if p >= 1.0 else -math.inf if p <= 0.0 else math.log(p) - math.log1p(-p)


def _probability(logit: float) -> float:
    return 1.0 / (1.0 + math.exp(-max(-_FAR, min(_FAR, logit))))


def _against(answer: Estimate, same: Estimate, other: Estimate) -> Estimate:
    """The probability by another strength; put right by what these rows are off, where the run knows its answer better.

    The uncertainty of the answer and that of the rows are then added.
    """
    known = [e for e in (answer, same, other) if e.value is not None and e.low is not None and e.high is not None]
    if len(known) < 3 or answer.value == same.value:
        return other
    logits = [(_logit(e.low or 0.0), _logit(e.value or 0.0), _logit(1.0 if e.high is None else e.high)) for e in known]
    if not np.isfinite(logits).all() or logits[0][2] - logits[0][0] >= logits[1][2] - logits[1][0]:
        return other
    value = logits[2][1] + logits[0][1] - logits[1][1]
    half = [math.hypot(*(abs(row[end] - row[1]) for row in logits)) for end in (0, 2)]
    low, middle, high = (_probability(x) for x in (value - half[0], value, value + half[1]))
    return replace(other, value=middle, low=low, high=high, std_error=0.25 * (high - low),
                   method=f"{other.method}, put right by the answer's own method")  # fmt: skip


def _independence(work: Work, limit: Limit, answer: LimitAnswer, state: LimitState) -> list[dict[str, Any]]:
    """The same demands against the strength's own law, where the study ties the strength to inputs."""
    if state.tie is None and state.shift is None:
        return []
    own = f"limits.{limit.name}.strength"
    groups = [group for group in work.study.dependence if own in group.of]
    others = list(dict.fromkeys(name for group in groups for name in group.of if name != own))
    alone = replace(state, shift=None, tie=None, remaining_sd=1.0, weights=())
    return [_row(limit, answer, state, alone, assumption="dependence", **{"with": others})]


def _shapes(limit: Limit, law: Law, answer: LimitAnswer, state: LimitState) -> list[dict[str, Any]]:
    """Another scatter about the same mean, and another family with the same mean and scatter."""
    rows = []
    # what a fitted law does not know of its scatter, its tests tell
    for factor in () if is_fitted(law) else (1.0 - FIFTH, 1.0 + FIFTH):
        found = with_scatter(law, factor)
        if found is not None:
            what, taken, instead, other = found
            about = {"assumption": what, "taken": taken, "instead": instead}
            rows.append(_row(limit, answer, state, replace(state, strength=other), **about))
    another = other_family(law)
    if another is not None:
        about = {"assumption": "law", "taken": law.kind, "instead": another.kind}
        rows.append(_row(limit, answer, state, replace(state, strength=another), **about))
    return rows


def with_scatter(law: Law, factor: float) -> tuple[str, float, float, Law] | None:
    """A law with the same mean and its modulus, or coefficient of variation, times a factor; None where it has none.

    Returns
    -------
    str, float, float, Law
        `modulus` or `cov`, what it is, what it becomes, and the law.

    >>> weibull = make_law("weibull", {"mean": 4.0, "modulus": 12.0})
    >>> what, taken, instead, other = with_scatter(weibull, 0.5)
    >>> what, taken, instead, round(mean(other), 12)
    ('modulus', 12.0, 6.0, 4.0)
    """
    own = law.parameters
    try:
        if law.kind == "weibull":
            threshold, modulus = own["threshold"], own["modulus"]
            centre = threshold + own["scale"] * math.gamma(1.0 + 1.0 / modulus)
            given = {"mean": centre, "modulus": factor * modulus, "threshold": threshold}
            return "modulus", modulus, _plain(factor * modulus), make_law("weibull", given, *_bounds(law))
        if law.kind not in ("normal", "lognormal", "gamma", "gumbel", "beta"):
            return None
        centre, scatter = _moments(law)
        given = {"mean": centre, "sd": factor * scatter}
        cov = scatter / centre
        return "cov", _plain(cov), _plain(factor * cov), make_law(law.kind, given, *_bounds(law))
    except (LawError, OverflowError, ZeroDivisionError):
        return None


def other_family(law: Law) -> Law | None:
    """The lognormal law with the same mean and scatter, for a lognormal the Weibull one; None where there is none.

    >>> round(sd(other_family(make_law("weibull", {"mean": 4.0, "modulus": 12.0}))), 3)
    0.405
    """
    if law.kind not in ("normal", "lognormal", "weibull", "gamma", "gumbel"):
        return None
    try:
        centre, scatter = _moments(law)
        if not (centre > 0.0 and 0.0 < scatter < centre):
            return None
        if law.kind != "lognormal":
            return make_law("lognormal", {"mean": centre, "sd": scatter}, *_bounds(law))
        return make_law("weibull", {"mean": centre, "modulus": _modulus(scatter / centre)}, *_bounds(law))
    except (LawError, OverflowError, ZeroDivisionError):
        return None


def _plain(value: float) -> float:
    """Without the last digits, which are rounding."""
    return float(f"{value:.12g}")


def _modulus(cov: float) -> float:
    """Weibull modulus with a coefficient of variation below 1."""
    from scipy.optimize import brentq

    def gap(m: float) -> float:
        return math.lgamma(1.0 + 2.0 / m) - 2.0 * math.lgamma(1.0 + 1.0 / m) - math.log1p(cov**2)

    return float(brentq(gap, 0.9, 2.0 / cov + 2.0))


def _moments(law: Law) -> tuple[float, float]:
    """Mean and standard deviation before truncation, but for a law that its bounds belong to."""
    bare = law if law.kind == "beta" else replace(law, lower=-math.inf, upper=math.inf)
    return float(mean(bare)), float(sd(bare))


def _bounds(law: Law) -> tuple[float | None, float | None]:
    return (
        None if math.isinf(law.lower) else law.lower,
        None if math.isinf(law.upper) else law.upper,
    )


# --- how many tests would settle the target --------------------------------------------------------------


def few_rows(state: LimitState, each: int = FEW) -> LimitState:
    """The first points of each replicate."""
    keep = slice(0, each)
    return replace(
        state, demands=state.demands[:, keep], shift=None if state.shift is None else state.shift[:, keep],
        tie=None if state.tie is None else replace(state.tie, given=state.tie.given[:, keep]),
        censored=None if state.censored is None else state.censored[:, keep],
        failed=None if state.failed is None else state.failed[:, keep],
    )  # fmt: skip


def fewest_tests(decided: Callable[[int], bool], known: int) -> int | None:
    """The least number of tests above `known` with which something is decided, to 5 %; None above `MOST_TESTS`.

    >>> fewest_tests(lambda tests: tests >= 40, 3)
    40
    """
    low, high = known, max(2 * known, 6)
    while not decided(high):
        low, high = high, 2 * high
        if high > MOST_TESTS:
            return None
    while high - low > max(1, low // 20):
        middle = (low + high) // 2
        low, high = (low, middle) if decided(middle) else (middle, high)
    return high


def _tests_to_settle(work: Work, limit: Limit, law: Law, few: LimitState) -> dict[str, Any] | None:
    """How many tests of a strength that is given as a law would put the target outside of what they leave open.

    The tests are taken to come out as the law says, with it at their largest likelihood; None where that is not known.
    """
    if is_fitted(law) or limit.target is None or law.parameters.get("threshold", 0.0) != 0.0:
        return None

    def decided(tests: int) -> bool:
        generator = random_generator(seed=work.study.seed, task=f"tests {limit.name} {tests}")
        return is_decided(law_curves([few], laws_of_more_tests(law, tests, LAWS, generator))[:, 0], limit)

    try:
        tests = fewest_tests(decided, 3)
    except LawError:
        return None
    if tests is None:
        reason = f"more than {MOST_TESTS} tests: it is too close to call"
        return {"tests": None, "confidence": 0.95, "reason": reason}
    return {"tests": tests, "confidence": 0.95}


def is_decided(exceeded: Sequence[float] | Array, limit: Limit) -> bool:
    """Whether nineteen of twenty laws put the probability of missing the aim on one side of the target."""
    assert limit.target is not None
    p = np.asarray(exceeded, dtype=float)
    low, high = np.quantile(p if limit.aim == "survive" else 1.0 - p, [0.025, 0.975])
    return bool(high < limit.target or low > limit.target)
