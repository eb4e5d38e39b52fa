"""From tests to the posterior of the fracture energy, and its draws as a strength.

Every specimen says that its first fracture energy lies in (lo, hi], or what it is: ln f(e), or
ln(P(hi) - P(lo)) from the tail that both lie in.  Parameters enter by their logarithms.  Sampler:
importance sampling from Student's t, whose mean and covariance follow the draws of the round before
(O. Cappé, A. Guillin, J.-M. Marin, C. P. Robert, J. Comput. Graph. Stat. 13 (2004) 907), with
truncated weights while it adapts (E. L. Ionides, same journal 17 (2008) 295).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array, Values
from uqsphere.errors import UsageError
from uqsphere.labs.comminution import laws
from uqsphere.labs.comminution.document import ComminutionDocument
from uqsphere.labs.comminution.tests import Specimens
from uqsphere.labs.files import csv_text

#: priors of logarithms (mean, sd): 95 % of phi in 0.41 to 2.4 and of gamma in 2.0 to 7.9, the
#: published ranges; the modulus is that of a Weibull law whose lognormal fit has such a sigma
PRIORS: Final = {
    "phi": (0.0, 0.45),
    "d0": (math.log(0.005), 1.0),
    "sigma": (math.log(0.6), 0.5),
    "modulus": (math.log(2.1375 / 0.6), 0.5),
    "gamma": (math.log(4.0), 0.35),
}
_FLAT: Final = (0.0, math.inf)
#: rounds of the sampler that adapt, most that are kept, degrees of freedom of its proposals
_ADAPTING, _MOST, _FREEDOM = 6, 24, 5.0
#: effective number that draws must reach to be believed
EFFECTIVE: Final = 1000.0
#: fewer tests than this choose between lognormal and Weibull too often wrongly: both are averaged
#: by their scores
FEW: Final = 50
#: ratio to the tested sizes beyond which a strength is extrapolated
UNTESTED: Final = 1.19
#: nodes of ln gamma between which bounds of repeated blows are interpolated
_GAMMAS: Final = np.linspace(math.log(0.5), math.log(50.0), 93)


@dataclass(frozen=True, kw_only=True)
class Model:
    """The parameters of one law by the names of their logarithms, with their priors (mean, sd)."""

    law: str
    size: str
    ratio: float
    priors: Mapping[str, tuple[float, float]]
    classes: tuple[float, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names in the order of the columns."""
        return tuple(self.priors)

    def median(self, p: Mapping[str, Values], diameter: Values) -> Array:
        """E50 [J/kg] of parameters (not logarithms) at diameters; they broadcast."""
        if self.size == "class":
            place = np.abs(np.log(np.asarray(diameter)[..., None] / np.array(self.classes))).argmin(
                axis=-1
            )
            each = np.stack([np.asarray(p[f"e50_{k + 1}"]) for k in range(len(self.classes))])
            first = (
                each[place] if each.ndim == 1 else np.moveaxis(each[place.ravel(), ..., 0], 0, -1)
            )
            return np.asarray(first)
        lead = "C" if self.size == "power" else "e_inf"
        return laws.median_energy(self.size, diameter, p[lead], p["phi"], p.get("d0", math.nan))


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """Draws (D,) of a law and its size effect; of an average the laws stand in proportion to their
    weights.

    law : (D,) index into `models`; parameters : by name, NaN where a draw's law has none; the
    damage exponent `gamma` has its prior where the tests say nothing of it.
    """

    models: tuple[Model, ...]
    law: Array
    parameters: Mapping[str, Array]
    tested: tuple[float, float]
    tests: int

    def __len__(self) -> int:
        return len(self.law)

    def thin(self, count: int) -> Posterior:
        """About so many draws, evenly."""
        rows = np.unique(np.linspace(0, len(self) - 1, min(count, len(self))).astype(int))
        return replace(
            self,
            law=self.law[rows],
            parameters={name: v[rows] for name, v in self.parameters.items()},
        )

    def median(self, diameter: Values) -> Array:
        """E50 (D, m) [J/kg] at diameters (m,)."""
        return self._each(np.atleast_1d(diameter), lambda model, p, d, _: model.median(p, d), 0.0)

    def broken(self, energy: Values, diameter: Values) -> Array:
        """Share (D, m) that one blow of an energy, (m,) or (D, m), breaks at diameters (m,)."""
        return self._each(
            np.atleast_1d(diameter),
            lambda model, p, d, e: laws.broken_share(
                model.law, e, model.median(p, d), p[laws.LAWS[model.law]], model.ratio
            ),
            energy,
        )

    def energy_at(self, share: Values, diameter: Values) -> Array:
        """The energy (D, m) [J/kg] that breaks a share, (m,) or (D, m), at diameters (m,)."""
        return self._each(
            np.atleast_1d(diameter),
            lambda model, p, d, q: laws.energy_at(
                model.law, q, model.median(p, d), p[laws.LAWS[model.law]], model.ratio
            ),
            share,
        )

    def _each(self, diameter: Array, ask: Callable[..., Array], values: Values) -> Array:
        values = np.broadcast_to(np.asarray(values, dtype=float), (len(self), len(diameter)))
        found = np.empty((len(self), len(diameter)))
        for k, model in enumerate(self.models):
            rows = np.flatnonzero(self.law == k)
            p = {name: self.parameters[name][rows, None] for name in model.names}
            found[rows] = ask(model, p, diameter, values[rows])
        return found

    def strength_csv(self, diameter: float) -> str:
        """Draws of the strength of particles of one size [m], as a study reads them.

        Distribution, scale, shape, bound; number of tests; the size that they hold for, the local
        power of the size law, and the tested sizes.
        """
        median = self.median(diameter)[:, 0]
        step = self.median(1.01 * diameter) / self.median(diameter / 1.01)
        exponent = np.log(step)[:, 0] / math.log(1.01**2)
        bounded = np.array([model.law == "lognormal" for model in self.models])[
            self.law.astype(int)
        ]
        none = np.full(len(self), np.nan)
        modulus = self.parameters.get("modulus", none)
        shape = np.where(bounded, self.parameters.get("sigma", none), 0.6 * modulus)
        smallest, largest = self.tested
        columns: dict[str, Any] = {
            "distribution": np.where(bounded, "lognormal", "weibull"),
            "scale [J/kg]": np.where(bounded, median, median / math.log(2.0) ** (1.0 / shape)),
            "shape": shape,
            "bound": bounded / self.models[0].ratio,
            "tests": self.tests,
            "diameter [mm]": diameter * 1e3,
            "size_exponent": exponent * (self.models[0].size != "class"),
            "smallest [mm]": smallest * 1e3,
            "largest [mm]": largest * 1e3,
        }
        rows = [np.broadcast_to(column, len(self)) for column in columns.values()]
        return csv_text(tuple(columns), rows)


@dataclass(frozen=True, kw_only=True)
class Fit:
    """The posterior with what is to be said of it; `content` is plain JSON."""

    posterior: Posterior
    content: dict[str, Any]


# --- likelihood -----------------------------------------------------------------------------------


def log_likelihoods(
    model: Model, tests: Specimens, gamma: float | None
) -> Callable[[Array], Array]:
    """A function from logarithms of parameters (..., d) to log likelihoods (..., s) of
    specimens.
    """
    from scipy.special import log_ndtr

    if not tests.repeated.any():
        low, high = tests.bounds(np.array(4.0))
    elif gamma is not None:
        low, high = tests.bounds(np.array(gamma))
    else:
        low, high = tests.bounds(np.exp(_GAMMAS))
        with np.errstate(divide="ignore"):
            log_low, log_high = np.log(low), np.log(high)
    exact = tests.exact & tests.broke
    step = _GAMMAS[1] - _GAMMAS[0]

    def between(x: Array, y: Array) -> Array:
        """Interpolated bounds; 0 and inf stay what they are."""
        at = np.clip((x - _GAMMAS[0]) / step, 0.0, len(_GAMMAS) - 1.001)
        k = at.astype(int)
        part = (at - k)[..., None]
        with np.errstate(invalid="ignore"):
            return np.where(
                np.isfinite(y[k]), np.exp(y[k] + part * (y[k + 1] - y[k])), np.exp(y[k])
            )

    def log_rest(h: Array) -> Array:
        return np.where(h < 1.0, np.log(-np.expm1(-h)), np.log1p(-np.exp(-np.maximum(h, 1.0))))

    def known(e: Array, median: Array, p: Mapping[str, Array]) -> Array:
        """ln f(e)."""
        if model.law == "weibull":
            last = laws.hazard(e, median, p["modulus"])
            return np.asarray(np.log(0.6 * p["modulus"] * last / e) - last)
        z, top = laws.standard(e, median, p["sigma"], model.ratio), model.ratio * median
        found = (
            -0.5 * z * z - np.log(p["sigma"] * math.sqrt(2.0 * math.pi) * e) - np.log1p(-e / top)
        )
        return np.where(e < top, found, -np.inf)

    def inside(lo: Array, hi: Array, median: Array, p: Mapping[str, Array]) -> Array:
        """ln(P(hi) - P(lo))."""
        if model.law == "weibull":
            first, last = (laws.hazard(e, median, p["modulus"]) for e in (lo, hi))
            return np.where(
                np.isposinf(first), -np.inf, -first + log_rest(np.maximum(last - first, 0.0))
            )
        a, z = (laws.standard(e, median, p["sigma"], model.ratio) for e in (lo, hi))
        # the normal law is even: both ends in the lower tail
        upper = a + z > 0.0
        larger, smaller = log_ndtr(np.where(upper, -a, z)), log_ndtr(np.where(upper, -z, a))
        return np.where(
            np.isneginf(larger), -np.inf, larger + log_rest(np.maximum(larger - smaller, 0.0))
        )

    def value(x: Array) -> Array:
        p = {name: np.exp(x[..., k, None]) for k, name in enumerate(model.names)}
        median = model.median(p, tests.diameter)
        lo, hi = low, high
        if low.ndim > 1:
            g = x[..., model.names.index("gamma")]
            lo, hi = between(g, log_low), between(g, log_high)
        found = np.empty(median.shape)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            if exact.any():
                found[..., exact] = known(hi[..., exact], median[..., exact], p)
            if not exact.all():
                found[..., ~exact] = inside(
                    lo[..., ~exact], hi[..., ~exact], median[..., ~exact], p
                )
        return np.asarray(tests.weight * found)

    return value


def model_of(law: str, asked: ComminutionDocument, tests: Specimens) -> Model:
    """The parameters of a law with their priors; of one size the scatter's is flat, which is exact
    there.
    """
    want, sizes = asked.tests, tests.sizes
    size = want.size if len(sizes) > 1 else "class"
    largest = tests.diameter >= 0.75 * tests.diameter.max()
    middle = float(np.average(np.log(tests.last[largest]), weights=tests.weight[largest]))
    if size == "class":
        found = {f"e50_{k + 1}": _FLAT for k in range(len(sizes))}
    else:
        known = {**PRIORS, "e_inf": (middle, 5.0), "C": _FLAT}
        found = {name: known[name] for name in laws.SIZES[size]}
    shape = laws.LAWS[law]
    found[shape] = PRIORS[shape] if len(sizes) > 1 else _FLAT
    if want.gamma == "fit" and tests.repeated.any():
        found["gamma"] = PRIORS["gamma"]
    own = {name: (one.log_mean, one.log_sd) for name, one in want.prior.items() if name in found}
    return Model(
        law=law,
        size=size,
        ratio=want.ratio,
        priors={**found, **own},
        classes=sizes if size == "class" else (),
    )


# --- sampling -------------------------------------------------------------------------------------


def sample(
    model: Model, tests: Specimens, gamma: float | None, rng: np.random.Generator, draws: int
) -> dict[str, Any]:
    """Draws (n, d) of the posterior, its mode, and the effective number of draws that their weights
    leave.
    """
    each = log_likelihoods(model, tests, gamma)
    centre = np.array([mean for mean, _ in model.priors.values()])
    sd = np.array([sd for _, sd in model.priors.values()])

    def value(x: Array) -> Array:
        prior = -0.5 * np.square(np.where(np.isinf(sd), 0.0, (x - centre) / sd)).sum(axis=-1)
        with np.errstate(invalid="ignore"):
            found = each(x).sum(axis=-1) + prior
        return np.where((np.abs(x) < 60.0).all(axis=-1) & ~np.isnan(found), found, -np.inf)

    mode, covariance = _mode(model, tests, value)
    middle, d, n = mode, len(mode), 1 << 12
    points, logs, effective = np.empty((0, d)), np.empty(0), 0.0
    for turn in range(_ADAPTING + _MOST):
        root = np.linalg.cholesky(covariance + 1e-12 * np.eye(d))
        z = rng.standard_normal((n, d)) * np.sqrt(_FREEDOM / rng.chisquare(_FREEDOM, (n, 1)))
        x = middle + z @ root.T
        density = -0.5 * (_FREEDOM + d) * np.log1p(np.square(z).sum(axis=1) / _FREEDOM)
        log = value(x) - density + np.log(np.diag(root)).sum()
        weight = np.exp(log - log.max())
        if turn < _ADAPTING:
            weight = np.minimum(weight, math.sqrt(n) * weight.mean())
            middle, covariance = (
                np.average(x, axis=0, weights=weight),
                np.atleast_2d(np.cov(x.T, aweights=weight)),
            )
            continue
        points, logs = np.concatenate([points, x]), np.concatenate([logs, log])
        weight = np.exp(logs - logs.max())
        effective = float(weight.sum() ** 2 / np.square(weight).sum())
        if effective > max(draws, EFFECTIVE):
            break
    taken = np.searchsorted(
        np.cumsum(weight), (np.arange(draws) + rng.random()) / draws * weight.sum()
    )
    return {
        "draws": points[rng.permutation(np.minimum(taken, len(points) - 1))],
        "each": each,
        "effective": effective,
        "log_likelihood": float(each(mode).sum()),
    }


def _mode(model: Model, tests: Specimens, value: Callable[[Array], Array]) -> tuple[Array, Array]:
    """The mode (d,) of the posterior, and about its covariance (d, d): 1 where the tests say
    nothing.
    """
    from scipy.optimize import minimize

    x = np.array([mean for mean, _ in model.priors.values()])
    lead = np.array([name in ("e_inf", "C") or name.startswith("e50_") for name in model.names])
    x[model.names.index(laws.LAWS[model.law])] = PRIORS[laws.LAWS[model.law]][0]
    x[lead] = np.median(np.log(tests.last))
    tried = x + np.linspace(-10.0, 10.0, 161)[:, None] * lead
    x = tried[int(np.argmax(value(tried)))]

    def loss(y: Array) -> float:
        return min(-float(value(y)), 1e15)

    near = minimize(loss, x, method="Nelder-Mead", options={"maxiter": 4000}).x
    found = minimize(loss, near, method="BFGS")
    return np.asarray(found.x), np.asarray(found.hess_inv)


# --- the fit --------------------------------------------------------------------------------------


def _overlap(tests: Specimens) -> bool:
    """Whether some particle survived more than broke another of its size, was hit again, or told
    its own energy.
    """
    groups = [np.abs(np.log(tests.diameter / size)) < 0.006 for size in tests.sizes]
    pairs = [(tests.last[near & ~tests.broke], tests.last[near & tests.broke]) for near in groups]
    crossed = [
        survived.max(initial=0.0) >= broken.min(initial=np.inf) for survived, broken in pairs
    ]
    return bool((tests.repeated | (tests.exact & tests.broke)).any() or any(crossed))


def fit(tests: Specimens, asked: ComminutionDocument) -> Fit:
    """The posterior of the tests, and what is to be said of it.

    Raises UsageError for tests of which nothing follows: without a prior any law without scatter
        agrees with them.
    """
    want = asked.tests
    if not _overlap(tests) and not {"sigma", "modulus"} & set(want.prior):
        raise UsageError(
            "no particle survived an energy that broke another one of its size: such tests do "
            "not show "
            "how strengths scatter; test more between those energies, or give a prior of sigma and "
            "modulus"
        )
    names = ("lognormal", "weibull") if want.law == "average" else (want.law,)
    gamma = want.gamma if isinstance(want.gamma, float) else None
    models = [model_of(law, asked, tests) for law in names]
    chains, scores, about = [], [], {}
    for k, (law, model) in enumerate(zip(names, models, strict=True)):
        rng = np.random.default_rng([asked.seed, 731, k])
        done = sample(model, tests, gamma, rng, asked.draws)
        chains.append(done["draws"])
        # leave-one-out by importance: 1/mean(1/p) of every specimen
        each = np.exp(np.minimum(-done["each"](chains[k]) / tests.weight, 600.0))
        scores.append(float(-np.log(np.mean(each, axis=0)) @ tests.weight))
        about[law] = {
            "log_likelihood": done["log_likelihood"],
            "loo": scores[k],
            "effective": done["effective"],
            "settled": done["effective"] > EFFECTIVE,
        }
    weights = np.exp(np.array(scores) - max(scores))
    weights /= weights.sum()
    ends = np.round(np.cumsum(weights) * asked.draws).astype(int)
    law_of = np.repeat(np.arange(len(names)), np.diff(ends, prepend=0))
    rng = np.random.default_rng([asked.seed, 733])
    order = rng.permutation(len(law_of))
    every = dict.fromkeys(name for model in models for name in model.names)
    parameters = {name: np.full(len(law_of), np.nan) for name in every}
    for k, (model, rows) in enumerate(zip(models, chains, strict=True)):
        own = np.flatnonzero(law_of == k)
        for j, name in enumerate(model.names):
            parameters[name][own] = np.exp(
                rows[np.linspace(0, len(rows) - 1, len(own)).astype(int), j]
            )
    if "gamma" not in parameters:
        mean, sd = PRIORS["gamma"]
        drawn = np.exp(mean + sd * rng.standard_normal(len(law_of)))
        parameters["gamma"] = np.full(len(law_of), gamma) if gamma is not None else drawn
    posterior = Posterior(
        models=tuple(models),
        law=law_of[order],
        tested=(float(tests.diameter.min()), float(tests.diameter.max())),
        parameters={name: v[order] for name, v in parameters.items()},
        tests=int(tests.weight.sum()),
    )
    return _described(
        posterior, about, dict(zip(names, weights.tolist(), strict=True)), tests, asked
    )


def quantiles(values: Array) -> dict[str, float]:
    """Median and 95 % interval of draws."""
    low, value, high = np.quantile(values[np.isfinite(values)], [0.025, 0.5, 0.975])
    return {"value": float(value), "low": float(low), "high": float(high)}


def _described(
    posterior: Posterior,
    about: dict[str, Any],
    weights: dict[str, float],
    tests: Specimens,
    asked: ComminutionDocument,
) -> Fit:
    warnings = list(tests.notes)
    parameters, priors = (
        {},
        {name: prior for model in posterior.models for name, prior in model.priors.items()},
    )
    for name, values in posterior.parameters.items():
        sd = priors.get(name, PRIORS.get(name, _FLAT))[1]
        own = float(np.nanstd(np.log(values)))
        parameters[name] = {
            **quantiles(values),
            "prior_sd": None if math.isinf(sd) else sd,
            "sd": own,
        }
        if name in priors and not math.isinf(sd) and own > 0.7 * sd:
            warnings.append(f"these tests do not determine {name}: it keeps its prior")
    sizes = []
    for size in tests.sizes[:200]:
        near = np.abs(np.log(tests.diameter / size)) < 0.006
        half, hundredth = (
            posterior.energy_at(0.5, size)[:, 0],
            posterior.energy_at(0.01, size)[:, 0],
        )
        step = np.log(posterior.median(size * 1.01) / posterior.median(size / 1.01))[:, 0] / 0.0199
        sizes.append(
            {
                "diameter": size,
                "tests": int(tests.weight[near].sum()),
                "broke": int(tests.weight[near & tests.broke].sum()),
                "breaks_half": quantiles(half),
                "E50": quantiles(posterior.median(size)[:, 0]),
                "breaks_1_percent": quantiles(hundredth),
                "slope": quantiles(-step),
            }
        )
    if len(about) > 1:
        gap = about["lognormal"]["loo"] - about["weibull"]["loo"]
        if abs(gap) > 2.0:
            better = "lognormal" if gap > 0.0 else "weibull"
            warnings.append(
                f"the {better} law predicts these tests better (log score by {abs(gap):.1f})"
            )
        elif tests.weight.sum() < FEW:
            warnings.append(
                "too few tests to choose between lognormal and Weibull: both are averaged"
            )
    for law, one in about.items():
        if not one["settled"]:
            warnings.append(
                f"{law}: the draws did not settle (effective number {one['effective']:.0f})"
            )
    if asked.tests.synthetic:
        warnings.append("the tests are synthetic data: no number here is of a rock")
    content = {
        "title": asked.title,
        "seed": asked.seed,
        "law": asked.tests.law,
        "size": posterior.models[0].size,
        "ratio": asked.tests.ratio if math.isfinite(asked.tests.ratio) else None,
        "tests": {
            "specimens": len(tests.weight),
            "particles": int(tests.weight.sum()),
            "broke": int(tests.weight[tests.broke].sum()),
            "exact": int(tests.weight[tests.exact & tests.broke].sum()),
            "repeated": int(tests.repeated.sum()),
            "diameters": list(posterior.tested),
        },
        "laws": {law: {**one, "weight": weights[law]} for law, one in about.items()},
        "parameters": parameters,
        "sizes": sizes,
        "warnings": warnings,
    }
    return Fit(posterior=posterior, content=content)
