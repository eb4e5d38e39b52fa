"""From tests to the posterior of the fracture energy, and its draws as a strength.

Every specimen bounds its first fracture energy to (low, high], or gives it: ln f(e), or
ln(P(high) - P(low)) from the tail that both ends lie in.  Parameters enter by their logarithms.
Sampler: importance sampling from Student's t, whose mean and covariance follow the draws of the
round before (O. Cappé, A. Guillin, J.-M. Marin, C. P. Robert, J. Comput. Graph. Stat. 13 (2004)
907), with truncated weights while it adapts (E. L. Ionides, same journal 17 (2008) 295).
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from uqsphere.arrays import Array, Duo, Function, Places, Values, quiet, special
from uqsphere.errors import UsageError
from uqsphere.labs.files import InputError, JsonObject, csv_text
from uqsphere.uq import ENDS

from . import laws
from .document import ComminutionDocument
from .tests import Specimens

#: priors of logarithms (mean, sd): 95 % of phi in 0.41 to 2.4 and of gamma in 2.0 to 7.9, the
#: published ranges; the modulus of a Weibull law has the scatter that sigma has
PRIORS = {
    "phi": (0.0, 0.45),
    "d0": (math.log(0.005), 1.0),
    "sigma": (math.log(0.6), 0.5),
    "modulus": (math.log(2.1375 / 0.6), 0.5),
    "gamma": (math.log(4.0), 0.35),
}
_FLAT = (0.0, math.inf)
#: rounds of the sampler that adapt, most that are kept, degrees of freedom of its proposals
_ADAPTING, _MOST, _FREEDOM = 6, 24, 5.0
#: effective number of draws below which a posterior has not converged
EFFECTIVE = 1000.0
#: number of tests below which lognormal and Weibull cannot be told apart reliably
FEW = 50
#: most sizes that are listed
_MOST_SIZES = 200
#: ratio to the tested sizes beyond which a strength is extrapolated
_UNTESTED = 1.19
SYNTHETIC = "the tests are synthetic data: the numbers describe no real rock"
#: nodes of ln gamma between which bounds of repeated blows are interpolated
_GAMMAS = np.linspace(math.log(0.5), math.log(50.0), 93)


class EnergyModel(NamedTuple):
    """The parameters of one law by the names of their logarithms, with their priors (mean, sd).

    gamma : the damage exponent where it is given.
    """

    law: str
    size: str
    ratio: float
    priors: dict[str, Duo]
    classes: tuple[float, ...] = ()
    gamma: float | None = None

    def scatter(self, p: Mapping[str, Values], diameter: Values) -> laws.Scatter:
        """Fracture energies by parameters (not logarithms) at diameters; they broadcast."""
        if self.size == "class":
            away = np.abs(np.log(diameter[..., None] / np.array(self.classes)))
            each = [p[f"e50_{k + 1}"] for k in range(len(self.classes))]
            median = np.concatenate(each, axis=-1)[..., away.argmin(axis=-1)]
        else:
            lead = p[laws.SIZES[self.size][0]]
            median = laws.median_energy(self.size, diameter, lead, p["phi"], p.get("d0", math.nan))
        return laws.Scatter(self.law, median, p[laws.LAWS[self.law]], self.ratio)


class Posterior(NamedTuple):
    """Draws (D,) of a law and its size effect; averaged laws share them by their weights.

    law : (D,) index into `models`.
    parameters : by name, NaN for a law without the parameter; the damage exponent `gamma` has its
        prior where the tests do not determine it.
    tested : smallest and largest diameter [m]; tests : number of particles.
    """

    models: list[EnergyModel]
    law: Places
    parameters: dict[str, Array]
    tested: Duo
    tests: int

    def at(self, rows: Places) -> "Posterior":
        """Some of the draws."""
        parameters = {name: values[rows] for name, values in self.parameters.items()}
        return self._replace(law=self.law[rows], parameters=parameters)

    def median(self, diameter: Values) -> Array:
        """E50 (D, m) [J/kg] at diameters (m,)."""
        return self._each(diameter, 0.0, lambda scatter, _: scatter.median)

    def broken(self, energy: Values, diameter: Values) -> Array:
        """Share (D, m) that one blow of an energy, (m,) or (D, m), breaks at diameters (m,)."""
        return self._each(diameter, energy, laws.Scatter.broken_share)

    def energy_at(self, share: Values, diameter: Values) -> Array:
        """The energy (D, m) [J/kg] that breaks a share, (m,) or (D, m), at diameters (m,)."""
        return self._each(diameter, share, laws.Scatter.energy_at)

    def _each(self, diameter: Values, values: Values, function: Callable[..., Array]) -> Array:
        """A function of scatter and value for every draw and diameter."""
        diameter = np.atleast_1d(diameter)
        answers = np.empty((len(self.law), len(diameter)))
        values = np.broadcast_to(values, answers.shape)
        for k, model in enumerate(self.models):
            rows = np.flatnonzero(self.law == k)
            p = {name: self.parameters[name][rows, None] for name in model.priors}
            answers[rows] = function(model.scatter(p, diameter), values[rows])
        return answers

    def is_untested(self, diameter: Values) -> Values:
        """Whether diameters are outside the tested ones, where a strength is extrapolated."""
        low, high = self.tested
        return (diameter < low / _UNTESTED) | (diameter > high * _UNTESTED)

    def slope(self, diameter: float) -> Array:
        """Local power (D,) of the size law."""
        step = self.median(1.01 * diameter) / self.median(diameter / 1.01)
        return np.log(step)[:, 0] / math.log(1.01**2)

    @quiet  # what is beyond floating point is refused
    def strength_csv(self, diameter: float, *, synthetic: bool = False) -> str:
        """Draws of the strength of particles of one size [m], as a study reads them.

        Distribution, scale, shape, bound; number of tests, and whether they are synthetic; the size
        that they hold for, the local power of the size law, and the tested sizes.

        Raises UsageError for moduli so small that a strength is beyond the largest number.
        """
        median = self.median(diameter)[:, 0]
        bounded = np.array([model.law == "lognormal" for model in self.models])[self.law]
        shape = self._each(diameter, 0.0, lambda scatter, _: scatter.shape)[:, 0]
        shape[~bounded] *= 0.6
        scale = np.where(bounded, median, median / math.log(2.0) ** (1.0 / shape))
        if not np.isfinite(scale).all():
            raise UsageError(
                "the fit leaves Weibull moduli down to "
                f"{np.nanmin(self.parameters['modulus']):.2g} possible, with strengths beyond the "
                "largest number: test more, or give a larger prior.modulus"
            )
        columns = {
            "distribution": np.where(bounded, "lognormal", "weibull"),
            "scale [J/kg]": scale,
            "shape": shape,
            "bound": bounded / self.models[0].ratio,
            "tests": self.tests,
            "synthetic": int(synthetic),
            "diameter [mm]": diameter * 1e3,
            "size_exponent": self.slope(diameter) * (self.models[0].size != "class"),
            "smallest [mm]": self.tested[0] * 1e3,
            "largest [mm]": self.tested[1] * 1e3,
        }
        return csv_text(columns)


class Fit(NamedTuple):
    """The posterior and its description, plain JSON."""

    posterior: Posterior
    content: JsonObject


# --- likelihood -----------------------------------------------------------------------------------


@quiet
def log_likelihoods(model: EnergyModel, tests: Specimens) -> Function:
    """A function of logarithms of parameters (..., d): log likelihoods (..., s) of specimens."""
    names = [*model.priors]
    fitted = "gamma" in names
    nodes = np.exp(_GAMMAS) if fitted else np.array([model.gamma or 4.0])
    every = tests.bounds(nodes)
    logs = np.log(every)

    def bounds(x: Array) -> Values:
        """Both ends (2, ..., s) of the first fracture energies, interpolated in ln gamma; 0 and inf
        stay."""
        if not fitted:
            return every[:, 0]
        step = _GAMMAS[1] - _GAMMAS[0]
        place = (x[..., names.index("gamma")] - _GAMMAS[0]) / step
        place = np.clip(place, 0.0, len(_GAMMAS) - 1.001)
        node = place.astype(int)
        part = (place - node)[..., None]
        ends = logs[:, node]
        inner = ends + part * (logs[:, node + 1] - ends)
        return np.exp(np.where(np.isfinite(ends), inner, ends))

    @quiet
    def value(x: Array) -> Array:
        p = {name: np.exp(x[..., k, None]) for k, name in enumerate(names)}
        scatter = model.scatter(p, tests.diameter)
        ends = bounds(x)
        exact = scatter.log_density(ends)
        likelihood: Array = np.where(tests.exact, exact, scatter.log_between(ends))
        return tests.weight * likelihood

    return value


def model_of(law: str, asked: ComminutionDocument, tests: Specimens) -> EnergyModel:
    """The parameters of a law with their priors.

    Tests of one size have a flat prior of the scatter, which makes the intervals exact.
    """
    want = asked.tests
    sizes = (*tests.sizes,)
    shape = laws.LAWS[law]
    several = len(sizes) > 1
    size = want.size if several else "class"
    if size == "class":
        priors = {f"e50_{k + 1}": _FLAT for k in range(len(sizes))}
    else:
        largest = tests.diameter >= 0.75 * tests.diameter.max()
        middle = np.average(np.log(tests.last[largest]), weights=tests.weight[largest])
        usual = {**PRIORS, "e_inf": (middle, 5.0), "C": _FLAT}
        priors = {name: usual[name] for name in laws.SIZES[size]}
    priors[shape] = PRIORS[shape] if several else _FLAT
    if want.gamma == "fit" and tests.repeated.any():
        priors["gamma"] = PRIORS["gamma"]
    for name, prior in want.prior.items():
        if name in priors:
            priors[name] = (prior.log_mean, prior.log_sd)
    gamma = None if want.gamma == "fit" else want.gamma
    return EnergyModel(law, size, want.ratio, priors, sizes, gamma)


# --- sampling -------------------------------------------------------------------------------------


def sample(
    model: EnergyModel, tests: Specimens, rng: np.random.Generator, draws: int
) -> tuple[Array, JsonObject]:
    """Draws (n, d) of the posterior, and how well the law fits and the draws converged."""
    from scipy.optimize import minimize

    each = log_likelihoods(model, tests)
    centre, sd = np.array([*model.priors.values()]).T

    @quiet
    def value(x: Array) -> Array:
        prior = -0.5 * np.square((x - centre) / sd).sum(axis=-1)
        total = each(x).sum(axis=-1) + prior
        return np.where((np.abs(x) < 60.0).all(axis=-1) & ~np.isnan(total), total, -np.inf)

    def loss(x: Array) -> float:
        return min(-float(value(x)), 1e15)

    # the mode, from the best of many energies
    shape = laws.LAWS[model.law]
    lead = np.array([name not in PRIORS for name in model.priors])
    begin = np.where(lead, np.median(np.log(tests.last)), centre)
    begin[[*model.priors].index(shape)] = PRIORS[shape][0]
    tried = begin + np.linspace(-10.0, 10.0, 161)[:, None] * lead
    values = value(tried)
    if not np.isfinite(values).any():
        raise InputError(
            f"{model.law}: no parameters agree with both tests and priors. Is a prior far out?",
            "tests.prior",
        )
    begin = tried[np.argmax(values)]
    near = minimize(loss, begin, method="Nelder-Mead", options={"maxiter": 4000}).x
    best = minimize(loss, near, method="BFGS")
    middle = best.x
    covariance = np.asarray(best.hess_inv)
    d = len(middle)
    n = 1 << 12
    points = np.empty((0, d))
    logs = np.empty(0)
    for turn in range(_ADAPTING + _MOST):
        root = np.linalg.cholesky(covariance + 1e-12 * np.eye(d))
        z = rng.standard_normal((n, d)) * np.sqrt(_FREEDOM / rng.chisquare(_FREEDOM, (n, 1)))
        x = middle + z @ root.T
        density = -0.5 * (_FREEDOM + d) * np.log1p(np.square(z).sum(axis=1) / _FREEDOM)
        log = value(x) - density + np.log(np.diag(root)).sum()
        if turn < _ADAPTING:
            weight = np.minimum(special.softmax(log), n**-0.5)
            middle = np.average(x, axis=0, weights=weight)
            covariance = np.atleast_2d(np.cov(x.T, aweights=weight))
            continue
        points = np.concatenate([points, x])
        logs = np.concatenate([logs, log])
        weight = special.softmax(logs)
        effective = 1.0 / np.square(weight).sum()
        if effective > max(draws, EFFECTIVE):
            break
    even = (np.arange(draws) + rng.random()) / draws
    taken = np.minimum(np.searchsorted(np.cumsum(weight), even), len(points) - 1)
    chain = points[rng.permutation(taken)]
    # leave-one-out by importance: 1/mean(1/p) of every specimen
    inverse = np.exp(np.minimum(-each(chain) / tests.weight, 600.0))
    return chain, {
        "log_likelihood": each(best.x).sum(),
        "loo": -np.log(np.mean(inverse, axis=0)) @ tests.weight,
        "effective": effective,
        "settled": bool(effective > EFFECTIVE),
    }


# --- the fit --------------------------------------------------------------------------------------


def _shows_scatter(tests: Specimens) -> bool:
    """Whether a particle was hit again, two gave their own energies, or one survived more than
    broke another of its size."""
    if tests.repeated.any() or len(np.unique(tests.last[tests.exact])) > 1:
        return True
    # at equal energies a scatter of none agrees with the tests as well as any: only the prior of
    # several sizes tells one, and that not where a particle broke at its own energy
    even = tests.exact | (len(tests.sizes) == 1)
    least = np.where(even, np.nextafter(tests.last, np.inf), tests.last)
    return any(
        tests.last.max(initial=0.0, where=near & ~tests.broke)
        >= least.min(initial=np.inf, where=near & tests.broke)
        for near in tests.sizes.values()
    )


def fit(tests: Specimens, asked: ComminutionDocument) -> Fit:
    """The posterior of the tests, with its description.

    Raises UsageError for tests without any scatter and no prior of it: any law without scatter
        agrees with them.
    """
    want = asked.tests
    if not _shows_scatter(tests) and not {"sigma", "modulus"} & set(want.prior):
        raise UsageError(
            "the tests do not show how strengths scatter: no particle survived an energy that "
            "broke another of its size. Test more between those energies, or give a prior of sigma "
            "and modulus"
        )
    draws = asked.draws
    models = [model_of(law, asked, tests) for law in laws.LAWS if want.law in (law, "average")]
    chains = []
    about = {}
    for k, model in enumerate(models):
        rng = np.random.default_rng([asked.seed, 731, k])
        chain, about[model.law] = sample(model, tests, rng, draws)
        chains.append(chain)
    weights = special.softmax([law["loo"] for law in about.values()])
    # the draws of all laws by their weights, in random order
    ends = np.round(np.cumsum(weights) * draws).astype(int)
    law_of = np.repeat(np.arange(len(models)), np.diff(ends, prepend=0))
    rng = np.random.default_rng([asked.seed, 733])
    order = rng.permutation(draws)
    parameters: dict[str, Array] = {}
    for k, model in enumerate(models):
        about[model.law]["weight"] = weights[k]
        places = np.flatnonzero(law_of == k)
        rows = np.linspace(0, draws - 1, len(places)).astype(int)
        for j, name in enumerate(model.priors):
            column = parameters.setdefault(name, np.full(draws, np.nan))
            column[places] = np.exp(chains[k][rows, j])
    if isinstance(want.gamma, float):
        parameters["gamma"] = np.full(draws, want.gamma)
    parameters.setdefault("gamma", rng.lognormal(*PRIORS["gamma"], draws))
    posterior = Posterior(
        models=models,
        law=law_of,
        tested=(tests.diameter.min(), tests.diameter.max()),
        parameters=parameters,
        tests=int(tests.weight.sum()),
    ).at(order)
    return Fit(posterior, _described(posterior, about, tests, asked))


# --- its description ------------------------------------------------------------------------------


def quantiles(values: Array) -> dict[str, float]:
    """Median and 95 % interval of draws."""
    value, low, high = np.quantile(values[np.isfinite(values)], [0.5, *ENDS])
    return {"value": value, "low": low, "high": high}


def _described(
    posterior: Posterior,
    about: dict[str, JsonObject],
    tests: Specimens,
    asked: ComminutionDocument,
) -> JsonObject:
    """A fit as plain JSON."""
    want = asked.tests
    weight = tests.weight
    warnings = [*tests.notes]
    fitted = {name: prior for model in posterior.models for name, prior in model.priors.items()}
    priors = PRIORS | fitted
    parameters = {}
    for name, values in posterior.parameters.items():
        _, prior_sd = priors[name]
        told = None if math.isinf(prior_sd) else prior_sd
        sd = np.nanstd(np.log(values))
        parameters[name] = {**quantiles(values), "prior_sd": told, "sd": sd}
        if name in fitted and sd > 0.7 * prior_sd:
            warnings.append(f"the tests do not determine {name}: its posterior follows the prior")
    if len(about) > 1:
        gap = about["lognormal"]["loo"] - about["weibull"]["loo"]
        if abs(gap) > 2.0:
            better = "lognormal" if gap > 0.0 else "weibull"
            warnings.append(
                f"the {better} law predicts these tests better (log score by {abs(gap):.1f})"
            )
        elif weight.sum() < FEW:
            warnings.append(
                f"fewer than {FEW} tests cannot distinguish lognormal from Weibull: both are "
                "averaged"
            )
    warnings += [
        f"{law}: the draws did not converge (effective number {done['effective']:.0f}, at least "
        f"{EFFECTIVE:.0f})"
        for law, done in about.items()
        if not done["settled"]
    ]
    if want.synthetic:
        warnings.append(SYNTHETIC)
    return {
        "title": asked.title,
        "seed": asked.seed,
        "law": want.law,
        "size": posterior.models[0].size,
        "ratio": want.ratio if math.isfinite(want.ratio) else None,
        "tests": {
            "specimens": len(weight),
            "particles": posterior.tests,
            "broke": int(weight[tests.broke].sum()),
            "exact": int(weight[tests.exact].sum()),
            "repeated": int(tests.repeated.sum()),
            "diameters": posterior.tested,
        },
        "laws": about,
        "parameters": parameters,
        "sizes": [
            {
                "diameter": size,
                "tests": int(weight[near].sum()),
                "broke": int(weight[near & tests.broke].sum()),
                "breaks_half": quantiles(posterior.energy_at(0.5, size)),
                "E50": quantiles(posterior.median(size)),
                "breaks_1_percent": quantiles(posterior.energy_at(0.01, size)),
                "slope": quantiles(-posterior.slope(size)),
            }
            for size, near in [*tests.sizes.items()][:_MOST_SIZES]
        ],
        "warnings": warnings,
    }
