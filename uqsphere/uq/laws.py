"""Probability laws: made from what a study gives, and checked.

What a law can be asked (probabilities, quantiles, moments) is in `distribution` and offered here too.
Nothing imports scipy.stats before a family is fitted to observations or a fit is judged.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from uqsphere.uq import empirical
from uqsphere.uq.distribution import (
    Law,
    cdf,
    from_normal,
    is_steps,
    isf,
    mean,
    median,
    nominal_mean,
    pdf,
    ppf,
    sd,
    sf,
    steps_kept,
    truncated_mass,
)
from uqsphere.uq.specification import LAWS, LawError, LawKind, canonical

__all__ = [
    "LAWS",
    "Law",
    "LawError",
    "LawKind",
    "cdf",
    "from_normal",
    "germs_of",
    "goodness_of_fit",
    "isf",
    "make_law",
    "mean",
    "median",
    "nominal_mean",
    "pdf",
    "ppf",
    "sd",
    "sf",
]

_LEAST_MASS = 1e-290  # a truncation that leaves less cannot be told from nothing in floating point


def make_law(
    kind: str,
    given: Mapping[str, float],
    lower: float | None = None,
    upper: float | None = None,
    data: Sequence[float] = (),
    fit: str | None = None,
    censored: Sequence[float] = (),
    unbiased: bool = False,
) -> Law:
    """A law from the keys of a study's table (SI).

    `given` holds one of the alternative key sets of ``LAWS[kind]``; `fit` ("kde", "steps" or a family)
    and `data` belong to the empirical law, and so do `censored`, observations that are known only to be larger, and
    `unbiased`, which takes the bias out of a fitted scatter; both need a Weibull or lognormal fit.

    Raises
    ------
    LawError
        With the offending key, what was found and what is allowed.

    >>> law = make_law("lognormal", {"mean": 52e9, "cov": 0.12})
    >>> round(nominal_mean(law) / 1e9, 12)
    52.0
    """
    specification = LAWS.get(kind)
    if specification is None:
        raise LawError(f"unknown distribution {kind!r}; known: {', '.join(LAWS)}", "dist")
    for key, bound in (("lower", lower), ("upper", upper)):
        if bound is not None and math.isnan(bound):
            raise LawError(f"{key} is not a number", key)
    a = -math.inf if lower is None else float(lower)
    b = math.inf if upper is None else float(upper)
    if not a < b:
        raise LawError(f"lower ({a:g}) must be below upper ({b:g})", "lower")
    if kind == "empirical":
        told = len(censored) > 0 or unbiased
        law = _strength(a, b, data, fit, censored, unbiased) if told else _empirical(given, a, b, data, fit)
    else:
        if len(data) or fit is not None:
            raise LawError(f"data and fit belong to an empirical law, not to {kind}", "fit")
        law = Law(kind=kind, parameters=canonical(kind, given, a, b), lower=a, upper=b)
    return _checked(law)


def _checked(law: Law) -> Law:
    """The law, once it is known to have mass, a finite centre, and scatter that floating point can hold."""
    try:
        centre = nominal_mean(law)
    except OverflowError:
        centre = math.inf
    if not math.isfinite(centre):
        raise LawError(f"these parameters of {law.kind} give numbers beyond floating point", "")
    if _plain(law, centre):
        return law
    with np.errstate(over="ignore"):
        mass = truncated_mass(law)
        if not mass > _LEAST_MASS:
            bounds = f"[{law.lower:g}, {law.upper:g}]"
            key = "lower" if math.isfinite(law.lower) else "upper"
            raise LawError(f"the truncation {bounds} leaves no mass of the {law.kind} law", key)
        ends = steps_kept(law)[[0, -1]] if is_steps(law) else ppf(law, np.array([0.25, 0.75]))
    low, high = float(ends[0]), float(ends[1])
    if not (math.isfinite(low) and math.isfinite(high)):
        raise LawError(f"these parameters of {law.kind} give numbers beyond floating point", "")
    if not high > low:
        raise LawError("the law has no scatter: give the number itself where a fixed value is meant", "dist")
    return law


def _plain(law: Law, centre: float) -> bool:
    """Whether a normal, lognormal or beta law is sound by closed forms that need no special functions.

    What is not plainly so is looked at closely, which loads them; `uqsphere check` is quick without.
    """
    if law.kind == "beta":
        a, b = law.parameters["alpha"], law.parameters["beta"]
        width = law.upper - law.lower
        scatter = width * math.sqrt(a * b / (a + b + 1.0)) / (a + b)
        return math.isfinite(width) and scatter > 1e-9 * max(abs(centre), abs(law.lower), abs(law.upper))
    if law.kind == "normal":
        location, scale = law.parameters["mean"], law.parameters["sd"]
        low, high, scatter = law.lower, law.upper, scale
    elif law.kind == "lognormal" and law.parameters["log_sd"] < 5.0:
        location, scale = law.parameters["log_mean"], law.parameters["log_sd"]
        low = math.log(law.lower) if law.lower > 0.0 else -math.inf
        high = math.log(law.upper) if law.upper > 0.0 else -math.inf
        scatter = scale * centre
    else:
        return False
    if not scale > 1e-12 * abs(location):
        return False
    mass = 0.5 * (
        math.erfc((low - location) / (scale * math.sqrt(2.0))) - math.erfc((high - location) / (scale * math.sqrt(2.0)))
    )
    return mass > 0.1 and math.isfinite(scatter) and scatter > 1e-9 * abs(centre)


def _strength(
    a: float, b: float, data: Sequence[float], fit: str | None, censored: Sequence[float], unbiased: bool
) -> Law:
    """A law fitted to strength tests: without the bias of few tests, or with tests that ended without a failure."""
    from uqsphere.uq.weibull import KINDS, fitted_parameters, make_tests

    if fit not in KINDS:
        why = "the bias can be taken out of" if unbiased else "tests that were stopped need"
        raise LawError(f'{why} a fit = "weibull" or "lognormal" alone; found {fit or "kde"}', "fit")
    try:
        tests = make_tests([*data, *censored], [False] * len(data) + [True] * len(censored))
    except ValueError as error:
        raise LawError(str(error), "column") from None
    parameters = canonical(fit, fitted_parameters(tests, fit, unbiased=unbiased), a, b)
    return Law(kind=fit, parameters=parameters, lower=a, upper=b, data=tuple(sorted(data)),
               censored=tuple(sorted(censored)))  # fmt: skip


def _empirical(given: Mapping[str, float], a: float, b: float, data: Sequence[float], fit: str | None) -> Law:
    if given:
        key = next(iter(given))
        raise LawError(f"an empirical law takes file, column, fit, lower and upper; found {key!r}", key)
    how = fit or "kde"
    allowed = ("kde", "steps", *empirical.FITTED)
    if how not in allowed:
        raise LawError(f"unknown fit {how!r}; allowed: {', '.join(allowed)}", "fit")
    values = np.sort(np.asarray(data, dtype=float))
    if values.ndim != 1 or values.size < 2:
        raise LawError(f"an empirical law needs at least 2 observations, found {values.size}", "file")
    if not np.isfinite(values).all():
        raise LawError("the observations hold values that are not finite numbers", "column")
    if values[0] == values[-1]:
        raise LawError(f"all {values.size} observations are equal: there is no scatter", "column")
    observations = tuple(values.tolist())
    if how in ("kde", "steps"):
        if how == "kde" and values.size > empirical.MOST_KERNELS:
            most = empirical.MOST_KERNELS
            raise LawError(f'{values.size} observations: use fit = "steps" above {most}', "fit")
        width = empirical.bandwidth(values) if how == "kde" else 0.0
        return Law(kind="empirical", parameters={"bandwidth": width}, lower=a, upper=b, data=observations)
    if how in ("uniform", "loguniform"):
        a = float(values[0]) if math.isinf(a) else a
        b = float(values[-1]) if math.isinf(b) else b
    if LAWS[how].bounded and not (math.isfinite(a) and math.isfinite(b)):
        raise LawError(f"{how} needs lower and upper", "lower" if math.isinf(a) else "upper")
    if not a < b:
        raise LawError(f"lower ({a:g}) must be below upper ({b:g})", "lower")
    try:
        parameters = empirical.fit_family(how, values, a, b)
        checked = canonical(how, parameters, a, b)
    except ValueError as error:
        raise LawError(f"{how} does not fit the observations: {error}", "fit") from None
    return Law(kind=how, parameters=checked, lower=a, upper=b, data=observations)


def goodness_of_fit(law: Law) -> dict[str, float]:
    """Kolmogorov distance of the observations from the law in force: {"distance", "p_value", "observations"}.

    The p-value takes the law as given beforehand; with parameters fitted to the same observations it is
    too large, and says only that a small one is bad.  Raises LawError for a law without observations.
    """
    if not law.data:
        raise LawError("the law was not made from observations", "")
    if law.censored:
        from uqsphere.uq.weibull import fit_strength, make_tests

        found = fit_strength(make_tests([*law.data, *law.censored], [0] * len(law.data) + [1] * len(law.censored)),
                             law.kind)  # fmt: skip
        return {"distance": found.distance, "p_value": found.p_value, "observations": float(found.tests)}
    values = np.asarray(law.data)
    values = values[(values >= law.lower) & (values <= law.upper)]
    n = values.size
    below = cdf(law, values)
    above_step = np.searchsorted(values, values, side="right") / n
    below_step = np.searchsorted(values, values, side="left") / n
    left = cdf(law, np.nextafter(values, -math.inf)) if is_steps(law) else below
    distance = float(max(np.max(above_step - below), np.max(left - below_step), 0.0))
    p_value = empirical.kolmogorov_p_value(distance, n)
    return {"distance": distance, "p_value": p_value, "observations": float(n)}


def germs_of(laws: Iterable[Law]) -> tuple[str, ...]:
    """What an expansion is in: "uniform" (Legendre polynomials) for laws between bounds, else "normal" (Hermite)."""
    return tuple("uniform" if LAWS[law.kind].bounded else "normal" for law in laws)
