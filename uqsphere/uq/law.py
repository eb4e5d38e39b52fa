"""The law itself: probabilities, quantiles, density and moments, exact in both tails.

A truncated law is evaluated from whichever tail is the smaller one, so that a normal law cut off ten
standard deviations out keeps all its digits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq import empirical
from uqsphere.uq.families import FAMILIES, LAWS, LawError, LawKind, canonical

__all__ = [
    "LAWS",
    "Law",
    "LawError",
    "LawKind",
    "cdf",
    "from_normal",
    "germs_of",
    "goodness_of_fit",
    "is_steps",
    "isf",
    "make_law",
    "mean",
    "median",
    "nominal_mean",
    "pdf",
    "ppf",
    "sd",
    "sf",
    "steps_kept",
    "tail_orders",
    "truncated_mass",
]


@dataclass(frozen=True, kw_only=True)
class Law:
    """A probability law in SI: kind, canonical parameters, and the bounds between which it is in force.

    `lower` and `upper` truncate, or are the bounds of uniform, loguniform, triangular and beta laws.
    `data` are the sorted observations of an empirical law (kept when a family was fitted to them); `censored` are
    those that are known only to be larger than this.
    An empirical law has the parameter `bandwidth`: of the Gaussian kernel, 0 for the step function.
    Make one with `make_law`, which validates.
    """

    kind: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    lower: float = -math.inf
    upper: float = math.inf
    data: tuple[float, ...] = ()
    censored: tuple[float, ...] = ()


def steps_kept(law: Law) -> Array:
    """Observations of a step law inside its truncation."""
    values = np.asarray(law.data)
    return values[(values >= law.lower) & (values <= law.upper)]


def is_steps(law: Law) -> bool:
    return law.kind == "empirical" and law.parameters["bandwidth"] == 0.0


def _is_truncated(law: Law) -> bool:
    """Whether the bounds cut anything off, or may; those of a bounded family are its own."""
    return (law.lower > -math.inf or law.upper < math.inf) and not LAWS[law.kind].bounded


def truncated_mass(law: Law) -> float:
    """Probability between the bounds before truncation."""
    return _window(law)[4]


def _tails(law: Law, x: Array) -> tuple[Array, Array]:
    """(P(X <= x), P(X > x)) of the law before truncation."""
    if law.kind == "empirical":
        from scipy.special import ndtr

        score = empirical.kernel_score(law.data, law.parameters["bandwidth"], x)
        return np.asarray(ndtr(score)), np.asarray(ndtr(-score))
    return _family_tail(law, x, upper=False), _family_tail(law, x, upper=True)


def _family_tail(law: Law, x: Array, *, upper: bool) -> Array:
    """One tail of a parametric law before truncation."""
    family = FAMILIES[law.kind]
    location, scale, shapes = family.resolve(law.parameters, law.lower, law.upper)
    if family.logarithmic:
        x = np.log(np.maximum(x, 0.0))
    y = (x - location) / scale
    return family.sf(y, shapes) if upper else family.cdf(y, shapes)


def _base_inverse(law: Law, p: Array, q: Array) -> Array:
    """x from its lower (p) and upper (q) tail before truncation, through the smaller of the two."""
    if law.kind == "empirical":
        from scipy.special import ndtri

        score = np.where(p <= 0.5, ndtri(p), -ndtri(q))
        return empirical.kernel_from_score(law.data, law.parameters["bandwidth"], score)
    family = FAMILIES[law.kind]
    location, scale, shapes = family.resolve(law.parameters, law.lower, law.upper)
    y = np.empty_like(p)
    below = p <= 0.5
    y[below] = family.ppf(p[below], shapes)
    y[~below] = family.isf(q[~below], shapes)
    x = location + scale * y
    return np.exp(x) if family.logarithmic else x


def _window(law: Law) -> tuple[float, float, float, float, float]:
    """(F, S) at the lower bound, (F, S) at the upper bound, and the mass between them."""
    if is_steps(law):
        return 0.0, 1.0, 1.0, 0.0, steps_kept(law).size / len(law.data)
    if not _is_truncated(law):
        return 0.0, 1.0, 1.0, 0.0, 1.0
    below_a, above_a, below_b, above_b = 0.0, 1.0, 1.0, 0.0
    with np.errstate(divide="ignore", over="ignore"):
        if law.lower > -math.inf:
            below_a, above_a = (float(tail[0]) for tail in _tails(law, np.array([law.lower])))
        if law.upper < math.inf:
            below_b, above_b = (float(tail[0]) for tail in _tails(law, np.array([law.upper])))
    if above_a < 0.5:
        mass = above_a - above_b
    elif below_b < 0.5:
        mass = below_b - below_a
    else:
        mass = 1.0 - below_a - above_b
    return below_a, above_a, below_b, above_b, mass


def _both(law: Law, x: Array) -> tuple[Array, Array]:
    """(P(X <= x), P(X > x)) of the law in force."""
    values = np.asarray(x, dtype=float)
    if is_steps(law):
        kept = steps_kept(law)
        below = empirical.steps_share_below(kept, values)
        return below, (kept.size - np.searchsorted(kept, values, side="right")) / kept.size
    below_a, above_a, below_b, above_b, mass = _window(law)
    with np.errstate(divide="ignore", over="ignore"):
        below, above = _tails(law, values)
    if not _is_truncated(law):
        return below, above
    # Differences are taken between tails of the smaller kind: no digits are lost far out.
    lower_side = below <= 0.5
    p = np.where(lower_side, below - below_a, above_a - above) / mass
    q = np.where(lower_side, below_b - below, above - above_b) / mass
    inside = (values >= law.lower) & (values <= law.upper)
    p = np.where(inside, np.clip(p, 0.0, 1.0), np.where(values < law.lower, 0.0, 1.0))
    q = np.where(inside, np.clip(q, 0.0, 1.0), np.where(values < law.lower, 1.0, 0.0))
    unknown = np.isnan(values)
    return np.where(unknown, np.nan, p), np.where(unknown, np.nan, q)


def cdf(law: Law, x: Array) -> Array:
    """P(X <= x) of the law in force, to full relative accuracy in the lower tail; any shape."""
    if law.kind in FAMILIES and not _is_truncated(law):
        with np.errstate(divide="ignore", over="ignore"):
            return _family_tail(law, np.asarray(x, dtype=float), upper=False)
    return _both(law, x)[0]


def sf(law: Law, x: Array) -> Array:
    """P(X > x) of the law in force, to full relative accuracy in the upper tail; any shape."""
    if law.kind in FAMILIES and not _is_truncated(law):
        with np.errstate(divide="ignore", over="ignore"):
            return _family_tail(law, np.asarray(x, dtype=float), upper=True)
    return _both(law, x)[1]


def _inverse(law: Law, p: Array, q: Array) -> Array:
    """x from p and q = 1 - p, each exact where it is small."""
    if is_steps(law):
        return empirical.steps_ppf(steps_kept(law), p)
    with np.errstate(divide="ignore", over="ignore"):
        if not _is_truncated(law):
            x = _base_inverse(law, p, q)
        else:
            below_a, _, _, above_b, mass = _window(law)
            lower = below_a + p * mass if below_a < 0.5 else 1.0 - (above_b + q * mass)
            upper = above_b + q * mass if above_b < 0.5 else 1.0 - (below_a + p * mass)
            x = _base_inverse(law, lower, upper)
    return np.clip(x, law.lower, law.upper)


def ppf(law: Law, p: Array) -> Array:
    """Quantile function: x with P(X <= x) = p, exact for small p; p in [0, 1], any shape."""
    p = np.asarray(p, dtype=float)
    return _inverse(law, p, 1.0 - p)


def isf(law: Law, q: Array) -> Array:
    """Upper quantile: x with P(X > x) = q, exact for small q; q in [0, 1], any shape."""
    q = np.asarray(q, dtype=float)
    return _inverse(law, 1.0 - q, q)


def from_normal(law: Law, z: Array) -> Array:
    """x with the same probability below it as the standard normal z has, exact in both tails; any shape.

    >>> law = Law(kind="gumbel", parameters={"location": 0.0, "scale": 1.0})
    >>> bool(np.allclose(sf(law, from_normal(law, np.array([9.0]))), 1.1285884059538408e-19, rtol=1e-12))
    True
    """
    from scipy.special import ndtr

    z = np.asarray(z, dtype=float)
    if law.kind in ("normal", "lognormal") and not _is_truncated(law):
        location, scale, _ = FAMILIES[law.kind].resolve(law.parameters, law.lower, law.upper)
        x = location + scale * z
        return np.exp(x) if law.kind == "lognormal" else x
    return _inverse(law, np.asarray(ndtr(z)), np.asarray(ndtr(-z)))


def pdf(law: Law, x: Array) -> Array:
    """Density of the law in force; a step law has none and raises LawError.  Any shape."""
    values = np.asarray(x, dtype=float)
    if is_steps(law):
        raise LawError('a law with fit = "steps" has no density', "fit")
    with np.errstate(divide="ignore", over="ignore"):
        if law.kind == "empirical":
            density = empirical.kernel_density(law.data, law.parameters["bandwidth"], values)
        else:
            family = FAMILIES[law.kind]
            location, scale, shapes = family.resolve(law.parameters, law.lower, law.upper)
            known = np.isfinite(values) & (values > 0.0) if family.logarithmic else np.isfinite(values)
            safe = np.where(known, values, 1.0)
            y = ((np.log(safe) if family.logarithmic else safe) - location) / scale
            density = family.pdf(y, shapes) / scale / (safe if family.logarithmic else 1.0)
            density = np.where(known, density, 0.0)
    inside = (values >= law.lower) & (values <= law.upper)
    return np.where(inside, density / _window(law)[4], 0.0)


def median(law: Law) -> float:
    """Median of the law in force."""
    return float(ppf(law, np.array([0.5]))[0])


def nominal_mean(law: Law) -> float:
    """Mean before truncation, in closed form; the median before truncation where there is no mean."""
    if law.kind == "empirical":
        return math.fsum(law.data) / len(law.data)
    if law.kind == "lognormal":
        return math.exp(law.parameters["log_mean"] + 0.5 * law.parameters["log_sd"] ** 2)
    if law.kind == "loguniform":
        return (law.upper - law.lower) / math.log(law.upper / law.lower)
    family = FAMILIES[law.kind]
    location, scale, shapes = family.resolve(law.parameters, law.lower, law.upper)
    standard = family.mean(shapes)
    if not math.isfinite(standard):
        standard = float(family.ppf(np.array([0.5]), shapes)[0])
    return location + scale * standard


def _missing(law: Law, order: int) -> float | None:
    """nan or ±inf where the moment of this order does not exist for the law in force."""
    low, high = (found <= order for found in tail_orders(law))
    if low and high:
        return math.nan if order == 1 else math.inf
    if low or high:
        return math.inf if high or order == 2 else -math.inf
    return None


def tail_orders(law: Law) -> tuple[float, float]:
    """Order from which on the law in force has no moments, of its lower and of its upper tail; inf where it has all."""
    if law.kind == "empirical":
        return math.inf, math.inf
    family = FAMILIES[law.kind]
    shapes = family.resolve(law.parameters, law.lower, law.upper)[2]
    return (
        family.heavy_lower(shapes) if math.isinf(law.lower) else math.inf,
        family.heavy_upper(shapes) if math.isinf(law.upper) else math.inf,
    )


def _moments(law: Law) -> tuple[float, float]:
    """Mean and standard deviation in force: ∫ Q(Φ(z))^k φ(z) dz by the trapezoidal rule.

    The integrand is smooth and dies out faster than exponentially at both ends, where the trapezoidal
    rule converges geometrically.
    """
    if is_steps(law):
        kept = steps_kept(law)
        return float(np.mean(kept)), float(np.std(kept))
    z = np.linspace(-37.0, 37.0, 37 * 128 + 1)
    weights = np.exp(-0.5 * z * z)
    weights /= weights.sum()
    x = from_normal(law, z)
    # Far out a tail probability times a small mass can underflow; those nodes weigh nothing anyway.
    weights, x = weights[np.isfinite(x)], x[np.isfinite(x)]
    centre = float(weights @ x)
    return centre, math.sqrt(float(weights @ (x - centre) ** 2))


def mean(law: Law) -> float:
    """Mean of the law in force; nan or ±inf where there is none."""
    missing = _missing(law, 1)
    if missing is not None:
        return missing
    if not _is_truncated(law):
        return nominal_mean(law)
    return _moments(law)[0]


def sd(law: Law) -> float:
    """Standard deviation of the law in force; nan or inf where there is none."""
    without_mean, missing = _missing(law, 1), _missing(law, 2)
    if without_mean is not None or missing is not None:
        return math.nan if without_mean is not None else math.inf
    if law.kind in ("normal", "lognormal") and not _is_truncated(law):
        if law.kind == "normal":
            return law.parameters["sd"]
        return nominal_mean(law) * math.sqrt(math.expm1(law.parameters["log_sd"] ** 2))
    if law.kind != "empirical" and not FAMILIES[law.kind].logarithmic and not _is_truncated(law):
        family = FAMILIES[law.kind]
        _, scale, shapes = family.resolve(law.parameters, law.lower, law.upper)
        return scale * family.sd(shapes)
    return _moments(law)[1]


# --- Probability laws: made from what a study gives, and checked.
# What a law can be asked (probabilities, quantiles, moments) is in `distribution` and offered here too.
# Nothing imports scipy.stats before a family is fitted to observations or a fit is judged.

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
