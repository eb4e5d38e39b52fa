"""From tests to the posterior: priors, draws, what the tests tell, how laws compare, and how well one fits.

The answer is the posterior; the largest likelihood serves comparison, for it runs away where tests do not bound the
size law (E_inf to 0, d0 to inf).  One size whose tests are complete or were stopped keeps the exact pivots of
`uqsphere.uq.fitting`, which are the posterior of a prior 1/sigma.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.feed import laws
from uqsphere.feed.fit import (
    DRAWS,
    UNITS,
    CountsEntry,
    FitEntry,
    GoodnessEntry,
    Interval,
    LawEntry,
    ParameterEntry,
    Posterior,
    SizeEntry,
)
from uqsphere.feed.likelihood import (
    WALKERS,
    Evidence,
    Hill,
    Model,
    Prior,
    bounds,
    effective_size,
    ensemble,
    evidence_of,
    hill_at,
    hill_of,
    in_cells,
    log_likelihood,
    maximise,
    split_r_hat,
    terms,
)
from uqsphere.feed.tests import Specimens
from uqsphere.uq import random_generator
from uqsphere.uq.fitting import SAME, STRENGTHS, fitted_parameters, make_tests, pivots

#: priors of logarithms: phi in 0.41 to 2.4 and gamma in 2.0 to 7.9 by 95 %, the published ranges; sigma 0.23 to 1.6;
#: d0 0.7 to 36 mm; the modulus is that of a Weibull law whose lognormal fit has such a sigma, 2.1375/sigma
PRIORS: Final = {
    "phi": Prior(centre=0.0, sd=0.45),
    "d0": Prior(centre=math.log(0.005), sd=1.0),
    "sigma": Prior(centre=math.log(0.6), sd=0.5),
    "modulus": Prior(centre=math.log(2.1375 / 0.6), sd=0.5),
    "gamma": Prior(centre=math.log(4.0), sd=0.35),
}
#: scatter of ln E_inf around the median of the largest sizes, and of ln(d W_min) around a tenth of the median e d
_WIDE, _LEAST_WIDE, _LEAST = 5.0, 1.0, 0.1
#: independent ensembles at once; steps thrown away, and turns of them from which the hill learns; of a stretch, at most
_ENSEMBLES, _BURN, _TURNS, _STRETCH, _MOST_STEPS = 4, 40, 2, 200, 3000
#: what chains must reach to be believed
R_HAT, EFFECTIVE = 1.01, 1000.0
#: effective size that chains go on to: the Monte Carlo error of an end of an interval is then 4 % of a scatter
_ENOUGH: Final = 4000.0
#: particles of a series whose pivots are simulated: the simulation is of every one of them, 4000 times
_MOST_PIVOTS: Final = 1000
#: tests do not tell a number whose posterior is wider than this share of its prior
_UNTOLD: Final = 0.7
#: fewer tests than this choose between lognormal and Weibull too often wrongly (nine of ten right): both are averaged
FEW: Final = 50
#: a difference of log scores that words are spent on: a ratio of e² in likelihood
_WORTH_WORDS: Final = 2.0
#: candidates of the importance sample behind a log score, and the fewest that they must be worth
_CANDIDATES, _LEAST_WORTH = 2000, 50.0
#: made-up series behind a goodness of fit, cells and rounds of the Turnbull estimate, most specimens it is made for
_SERIES, _CELLS, _ROUNDS, _MOST = 199, 60, 60, 400


@dataclass(frozen=True, kw_only=True)
class Request:
    """What is fitted.

    law : a name of `laws.LAWS`, or "average" of lognormal and weibull;  size : of `laws.SIZES`
    ratio : E_max/E50 of the lognormal law;  gamma : its value, or None where tests or the prior tell it
    priors : in place of those of `PRIORS`
    """

    law: str = "average"
    size: str = "tavares"
    ratio: float = laws.RATIO
    gamma: float | None = None
    priors: Mapping[str, Prior] = field(default_factory=dict)
    seed: int = 0
    title: str = ""
    made_up: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawn:
    """The posterior of one law: logarithms (n, d) by the names of its model, and how they were drawn."""

    model: Model
    x: Array
    mode: Array
    method: str
    r_hat: Mapping[str, float]
    effective: Mapping[str, float]

    @property
    def settled(self) -> bool:
        """Whether its chains may be believed."""
        few = min(self.effective.values(), default=math.inf) <= EFFECTIVE
        return max(self.r_hat.values(), default=1.0) < R_HAT and not few


def fit(tests: Specimens, request: Request, draws: int = DRAWS) -> tuple[Posterior, FitEntry]:
    """Posterior of a law and its size effect, and what is to be said of it.

    Raises ValueError for a size law that the law does not have.
    """
    names = ("lognormal", "weibull") if request.law == "average" else (request.law,)
    if request.size == "weakest_link" and names != ("weibull",):
        raise ValueError('size = "weakest_link" belongs to law = "weibull"')
    few, cell = in_cells(tests)
    if request.law == "vogel_peukert":
        request = replace(request, size="power")
    drawn = [draw(few, replace(request, law=name), draws) for name in names]
    compared = compare(few, request)
    weights = _weights(names, compared)
    shares, ratio = [weights[name] for name in names], None if math.isinf(request.ratio) else request.ratio
    for k, one in enumerate(compared):
        # a lognormal law that was compared is the one asked for by its bound
        if one.law in names and (one.law != "lognormal" or one.ratio == ratio):
            compared[k] = one.model_copy(update={"weight": weights[one.law]})
    posterior = _joined(drawn, shares, tests, request, draws)
    counted = CountsEntry(
        specimens=len(tests), particles=tests.particles, broke=int(tests.weight[tests.broke].sum()),
        exact=int(tests.weight[tests.exact & tests.broke].sum()), repeated=int(tests.repeated.sum()), cell=cell,
    )  # fmt: skip
    entry = FitEntry(
        law=request.law, size=request.size, ratio=ratio,
        tested=posterior.tested, classes=posterior.classes, title=request.title, seed=request.seed,
        made_up=request.made_up, tests=counted, method=drawn[0].method,
        converged=all(one.settled for one in drawn),
        parameters={one.model.law: _parameters(one, few, request) for one in drawn},
        sizes=tuple(_size(posterior, tests, size) for size in tests.sizes[:200]), laws=tuple(compared),
        goodness=_goodness(few, drawn[int(np.argmax(shares))], request),
    )  # fmt: skip
    return posterior, entry.model_copy(update={"warnings": tuple(_warnings(entry, tests))})


# --- the model of a request -------------------------------------------------------------------------------


def model_of(tests: Specimens, request: Request) -> Model:
    """The parameters that are looked for, with their priors."""
    classes = tests.sizes if request.size == "class" else ()
    energy, weight = tests.last, tests.weight
    largest = tests.diameter >= 0.75 * tests.diameter.max()
    found: dict[str, Prior] = {}
    if request.law == "vogel_peukert":
        middle = math.log(_LEAST * float(np.median(energy * tests.diameter)))
        found = {"f_mat": Prior(), "threshold": Prior(centre=middle, sd=_LEAST_WIDE)}
    elif request.size == "class":
        found = {f"e50_{k + 1}": Prior() for k in range(len(classes))}
    else:
        at_large = float(np.average(np.log(energy[largest]), weights=weight[largest]))
        known = {**PRIORS, "e_inf": Prior(centre=at_large, sd=_WIDE), "C": Prior()}
        found = {name: known[name] for name in laws.SIZES[request.size]}
    if request.law != "vogel_peukert":
        found |= {name: PRIORS[name] for name in laws.LAWS[request.law].keys}
        if request.gamma is None and tests.repeated.any():
            found["gamma"] = PRIORS["gamma"]
    priors = {name: request.priors.get(name, prior) for name, prior in found.items()}
    return Model(law=request.law, size=request.size, ratio=request.ratio, priors=priors, classes=classes)


def start_of(model: Model, tests: Specimens, told: Evidence) -> Array:
    """Logarithms (d,) to begin with: the centres of the priors, and what brings the medians to the energies.

    What was survived again and again lies above its last energy, and a bounded law must hold it: all medians are moved
    to where the likelihood is largest.
    """
    logs, weight = np.log(tests.last), tests.weight
    centre = {name: prior.centre for name, prior in model.priors.items()}
    if model.law == "vogel_peukert":
        # below every particle that broke
        reached = (tests.last * tests.diameter)[tests.broke]
        centre["threshold"] = min(centre["threshold"], math.log(0.5 * float(reached.min())))
        centre["f_mat"] = -float(np.average(logs + np.log(tests.diameter), weights=weight))
    elif model.size == "class":
        place = np.abs(np.log(tests.diameter[:, None] / np.array(model.classes))).argmin(axis=1)
        for k in range(len(model.classes)):
            centre[f"e50_{k + 1}"] = float(np.average(logs[place == k], weights=weight[place == k]))
    else:
        lead = laws.SIZES[model.size][0]
        one = {name: np.exp(value) for name, value in {**centre, lead: 0.0}.items()}
        centre[lead] = float(
            np.average(logs - np.log(laws.median_energy(model.size, tests.diameter, one)), weights=weight)
        )
    start = np.array([centre[name] for name in model.names])
    leads = [name == "f_mat" or name in ("e_inf", "C") or name.startswith("e50_") for name in model.names]
    tried = start + np.linspace(-3.0, 5.0, 33)[:, None] * np.array(leads)
    return np.asarray(tried[int(np.argmax(log_likelihood(model, told, tried[None])[0]))])


# --- draws ------------------------------------------------------------------------------------------------


def draw(tests: Specimens, request: Request, draws: int) -> Drawn:
    """The posterior of one law: by pivots where they are exact, else by ensembles that go on until they settle."""
    model = model_of(tests, request)
    if _is_exact(tests, model, request):
        return _by_pivots(tests, model, request, draws)
    told = evidence_of([tests], request.gamma, model.classes)

    def value(x: Array) -> Array:
        return log_likelihood(model, told, x) + model.log_prior(x)

    mode, curved, _ = maximise(value, start_of(model, tests, told)[None])
    rng = random_generator(seed=request.seed, task=f"fit {request.law}")
    four = np.ones(_ENSEMBLES)
    hill = hill_at(four[:, None] * mode, four[:, None, None] * curved)
    chain = ensemble(value, _inside(value, hill, rng), _BURN, rng, hill)
    for _ in range(_TURNS):
        hill = hill_of(chain[_BURN // 2 :])
        chain = ensemble(value, chain[-1], _BURN, rng, hill)
    kept = np.empty((0, *chain.shape[1:]))
    names, sizes = model.names, np.array(tests.sizes)
    while len(kept) < _MOST_STEPS:
        last = kept[-1] if len(kept) else chain[-1]
        kept = np.concatenate([kept, ensemble(value, last, _STRETCH, rng, hill)])
        looked = np.concatenate([kept, _log_medians(model, kept, sizes[[0, -1]])], axis=-1)
        r_hat, effective = split_r_hat(looked), effective_size(looked)
        if r_hat.max() < R_HAT and effective.min() > _ENOUGH:
            break
    keys = (*names, "E50 smallest", "E50 largest")[: looked.shape[-1]]
    flat = kept.reshape(-1, len(names))
    return Drawn(
        model=model, x=flat[np.linspace(0, len(flat) - 1, draws).astype(int)], mode=mode[0], method="ensemble",
        r_hat=dict(zip(keys, r_hat.tolist(), strict=True)), effective=dict(zip(keys, effective.tolist(), strict=True)),
    )  # fmt: skip


def _inside(value: Callable[[Array], Array], hill: Hill, rng: np.random.Generator) -> Array:
    """Walkers (R, W, d) about a mode, those drawn where nothing can be at the mode itself and a hair beside."""
    x = hill.draw(WALKERS, rng)
    outside = ~np.isfinite(value(x))
    return np.where(outside[..., None], hill.mode[:, None] + 1e-3 * (x - hill.mode[:, None]), x)


def _log_medians(model: Model, x: Array, sizes: Array) -> Array:
    """ln E50 (..., sizes) of logarithms (..., d); none of a law without a size law."""
    if not laws.LAWS[model.law].sized:
        return np.empty((*x.shape[:-1], 0))
    return np.asarray(np.log(model.at(sizes, model.parameters(x))["median"]))


def _is_exact(tests: Specimens, model: Model, request: Request) -> bool:
    """Whether pivots are exact: one size, no bound of the law, tests complete or stopped, priors those of the house."""
    plain = model.law == "weibull" or (model.law == "lognormal" and math.isinf(model.ratio))
    own = {"sigma", "modulus", "C", "e_inf"} & set(request.priors)
    alone = len(tests.sizes) == 1 and not tests.repeated.any() and model.size != "weakest_link"
    failures = int(tests.weight[tests.broke].sum())
    broken = tests.last[tests.broke]
    distinct = failures > 1 and bool(np.ptp(broken) > SAME * broken.max())
    few = tests.particles <= _MOST_PIVOTS
    return plain and not own and alone and few and bool((tests.exact | ~tests.broke).all()) and distinct


def _by_pivots(tests: Specimens, model: Model, request: Request, draws: int) -> Drawn:
    """Exact draws at one size; what a size law has beside E50 comes from its priors."""
    strength = STRENGTHS[model.law]
    times = tests.weight.astype(int)
    series = make_tests(np.repeat(tests.last, times), np.repeat(~tests.broke, times))
    best = fitted_parameters(series, strength)
    rng = random_generator(seed=request.seed, task=f"fit {model.law}")
    centre, inverse = pivots(strength, series.failed, draws, rng)
    normal = model.law == "lognormal"
    location = best["log_mean"] if normal else math.log(best["scale"])
    spread = best["log_sd"] if normal else 1.0 / best["modulus"]
    scatter, place = spread * inverse, location - spread * centre
    own = {"sigma": np.log(scatter)} if normal else {"modulus": -np.log(0.6 * scatter)}
    median = place if normal else place + scatter * math.log(math.log(2.0))
    columns: dict[str, Array] = {}
    for name, prior in model.priors.items():
        if name in own:
            columns[name] = own[name]
        elif name not in ("e_inf", "C") and not name.startswith("e50_"):
            columns[name] = prior.centre + prior.sd * rng.standard_normal(draws)
    lead = model.names[0]
    one = {name: np.exp(column) for name, column in {**columns, lead: np.zeros(draws)}.items()}
    unit = np.zeros(draws) if model.size == "class" else np.log(laws.median_energy(model.size, tests.sizes[0], one))
    columns[lead] = median - unit
    x = np.column_stack([columns[name] for name in model.names])
    return Drawn(model=model, x=x, mode=np.median(x, axis=0), method="exact pivots", r_hat={}, effective={})


def _weights(names: tuple[str, ...], compared: list[LawEntry]) -> dict[str, float]:
    """Shares of the laws in an average, by their leave-one-out log scores, else by likelihood."""
    if len(names) == 1:
        return {names[0]: 1.0}
    best = {one.law: one for one in compared if one.name in names}
    scores = np.array([best[name].loo if best[name].loo is not None else best[name].log_likelihood for name in names])
    shares = np.exp(scores - scores.max())
    return dict(zip(names, (shares / shares.sum()).tolist(), strict=True))


def _joined(drawn: list[Drawn], weights: list[float], tests: Specimens, request: Request, draws: int) -> Posterior:
    """Draws of all laws by their shares, and gamma from its value or its prior where no specimen was hit twice."""
    counts = np.floor(np.cumsum([0.0, *weights]) / sum(weights) * draws + 0.5).astype(int)
    counts = np.diff(counts)
    names = dict.fromkeys(name for one in drawn for name in one.model.names)
    columns: dict[str, list[Array]] = {name: [] for name in names}
    for one, count in zip(drawn, counts, strict=True):
        rows = np.linspace(0, len(one.x) - 1, count).astype(int)
        p = {name: np.exp(one.x[rows, k]) for k, name in enumerate(one.model.names)}
        for name, column in columns.items():
            column.append(p.get(name, np.full(count, np.nan)))
    found = {name: np.concatenate(parts) for name, parts in columns.items()}
    which: npt.NDArray[np.str_] = np.repeat([one.model.law for one in drawn], counts)
    if "gamma" not in found:
        prior = request.priors.get("gamma", PRIORS["gamma"])
        rng = random_generator(seed=request.seed, task="fit gamma")
        spread = np.exp(prior.centre + prior.sd * rng.standard_normal(draws))
        found["gamma"] = spread if request.gamma is None else np.full(draws, request.gamma)
    return Posterior(law=request.law, size=request.size, ratio=request.ratio, draws=found, which=which,
                     tested=(tests.sizes[0], tests.sizes[-1]), classes=drawn[0].model.classes)  # fmt: skip


# --- what the tests tell ----------------------------------------------------------------------------------


def _interval(values: Array) -> Interval:
    return Interval.of(values, "the law of the draws has no such number")


def _parameters(one: Drawn, tests: Specimens, request: Request) -> dict[str, ParameterEntry]:
    told = evidence_of([tests], request.gamma, one.model.classes)
    top, _, settled = maximise(lambda x: log_likelihood(one.model, told, x), one.mode[None])
    found = {}
    for k, (name, prior) in enumerate(one.model.priors.items()):
        sd = float(one.x[:, k].std())
        r_hat, effective = one.r_hat.get(name), one.effective.get(name)
        sure = r_hat is None or (r_hat < R_HAT and (effective or 0.0) > EFFECTIVE)
        said = f"the chains have not settled: R-hat {r_hat:.3f}, effective size {effective:.0f}" if not sure else ""
        found[name] = ParameterEntry(
            unit=UNITS.get(name, "J/kg"), posterior=_interval(np.exp(one.x[:, k])) if sure else Interval(reason=said),
            likelihood=float(np.exp(top[0, k])) if settled[0] else None, sd=sd,
            prior=(math.exp(prior.centre), prior.sd) if math.isfinite(prior.sd) else None,
            told=not math.isfinite(prior.sd) or sd <= _UNTOLD * prior.sd, r_hat=r_hat, effective=effective,
        )  # fmt: skip
    return found


def _size(posterior: Posterior, tests: Specimens, size: float) -> SizeEntry:
    near = np.abs(np.log(tests.diameter / size)) <= 0.01
    tail = posterior.energy_at(0.01, size)
    tails = {name: _interval(tail[posterior.which == name]) for name in dict.fromkeys(posterior.which.tolist())}
    sized = any(laws.LAWS[name].sized for name in tails)
    return SizeEntry(
        diameter=size, tests=int(tests.weight[near].sum()), broke=int(tests.weight[near & tests.broke].sum()),
        E50=_interval(posterior.median(size)) if sized else Interval(reason="the law has no E50 of its own"),
        half=_interval(posterior.energy_at(0.5, size)),
        slope=_interval(posterior.slope(size)) if sized else Interval(value=1.0, low=1.0, high=1.0), low_tail=tails,
    )  # fmt: skip


def _warnings(entry: FitEntry, tests: Specimens) -> list[str]:
    """What a reader must know, one sentence each."""
    found = []
    for law, parameters in entry.parameters.items():
        found += [f"{name} ({law}): {one.posterior.reason}" for name, one in parameters.items() if one.posterior.reason]
        untold = " and ".join(name for name, one in parameters.items() if not one.told)
        if untold:
            found.append(f"these tests do not tell {untold} ({law}): the posterior is about as wide as the prior")
        if any(one.likelihood is None for one in parameters.values()):
            found.append(f"the largest likelihood of the {law} law runs away: without priors the tests do not bound it")
    if tests.particles < FEW:
        found += _few(entry, tests.particles)
    if entry.tests is not None and entry.tests.cell:
        found.append(f"{len(tests):,} specimens were gathered in cells of {entry.tests.cell:.1%} of size and energy")
    return found


def _few(entry: FitEntry, number: int) -> list[str]:
    """What fewer tests than `FEW` are worth."""
    ends = [(size.half.low, size.half.high) for size in entry.sizes]
    factors = sorted(math.sqrt(high / low) for low, high in ends if low and high)
    found = []
    if factors:
        said = f"{number} test{'' if number == 1 else 's'}: the energy that breaks half is known to a factor"
        found.append(f"{said} {factors[0]:.2f}" + (f" to {factors[-1]:.2f}" if len(factors) > 1 else ""))
    if entry.law == "average":
        return [*found, "the energy that breaks 1 % depends on the law: both are given"]
    alone = f"low tails of the {entry.law} law alone are not to be relied on"
    return [*found, f'fewer than {FEW} tests choose no law: {alone}; law = "average" carries both']


# --- how laws compare -------------------------------------------------------------------------------------


def compare(tests: Specimens, request: Request) -> list[LawEntry]:
    """Lognormal, truncated, Weibull and Vogel-Peukert on the same tests, the best first by its score."""
    asked = request.ratio if math.isfinite(request.ratio) else laws.RATIO
    size = "power" if request.size == "weakest_link" else request.size
    candidates = [("lognormal", "lognormal", math.inf), ("truncated", "lognormal", asked),
                  ("weibull", "weibull", math.inf), ("vogel_peukert", "vogel_peukert", math.inf)]  # fmt: skip
    if math.isfinite(request.ratio):
        # by its short name goes the law that the study asks for
        candidates = [("plain lognormal", "lognormal", math.inf), ("lognormal", "lognormal", asked), *candidates[2:]]
    found = []
    for name, law, ratio in candidates:
        one = replace(request, law=law, ratio=ratio, size=request.size if law == "weibull" else size)
        model = model_of(tests, one)
        told = evidence_of([tests], request.gamma, model.classes)
        reached, loo = _scores(model, told, start_of(model, tests, told), request.seed)
        bound = ratio if law == "lognormal" and math.isfinite(ratio) else None
        found.append(LawEntry(name=name, law=law, ratio=bound, log_likelihood=reached, loo=loo))
    return _worded(found)


def _worded(found: list[LawEntry]) -> list[LawEntry]:
    """The laws with what their difference of scores is worth saying; nothing up to `_WORTH_WORDS`."""
    top = max(one.log_likelihood for one in found)
    best = max((one.loo for one in found if one.loo is not None), default=math.nan)
    for k, one in enumerate(found):
        behind, lost = top - one.log_likelihood, math.inf if one.loo is None else best - one.loo
        if behind > _WORTH_WORDS and lost > _WORTH_WORDS:
            score = f" and {lost:.1f} in leave-one-out score" if one.loo is not None else ""
            words = f"{one.name} fits worse by {behind:.1f} in ln likelihood{score}"
            found[k] = one.model_copy(update={"words": words})
    return found


def _largest(model: Model, told: Evidence, start: Array) -> float:
    """Largest ln likelihood from a start (1, d); a threshold lies at a wall, where only a simplex finds it."""
    top, _, _ = maximise(lambda x: log_likelihood(model, told, x), start)
    best = float(log_likelihood(model, told, top[:, None])[0, 0])
    if laws.LAWS[model.law].sized:
        return best
    from scipy.optimize import minimize

    def lost(x: Array) -> float:
        # ln likelihood of what cannot be, as a simplex takes it
        return min(-float(log_likelihood(model, told, x[None, None])[0, 0]), 1e12)

    found = minimize(lost, start[0], method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-10, "maxiter": 1000})
    return max(best, -float(found.fun))


def _scores(model: Model, told: Evidence, start: Array, seed: int) -> tuple[float, float | None]:
    """Largest ln likelihood, and the leave-one-out log score by importance sampling about the posterior's mode."""

    def posterior(x: Array) -> Array:
        return log_likelihood(model, told, x) + model.log_prior(x)

    mode, curved, _ = maximise(posterior, start[None])
    best = _largest(model, told, mode)
    rng = random_generator(seed=seed, task=f"score {model.law} {model.ratio:g}")
    hill = hill_at(mode, curved)
    x = hill.draw(_CANDIDATES, rng)
    exact, between = (part[0] for part in terms(model, told, x))
    with np.errstate(invalid="ignore"):
        weight = (posterior(x) - hill.log_density(x))[0]
        weight = np.exp(weight - weight[np.isfinite(weight)].max())
        weight = np.where(np.isfinite(weight), weight, 0.0)
    if weight.sum() ** 2 / (weight**2).sum() < _LEAST_WORTH:
        return best, None
    score = 0.0
    for part, times in ((exact, told.exact_weight[0]), (between, told.weight[0])):
        if part.shape[1]:
            with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
                inverse = np.where(weight[:, None] > 0.0, np.exp(-part) * weight[:, None], 0.0).sum(axis=0)
                score += float((times * (math.log(weight.sum()) - np.log(inverse))).sum())
    return best, score if math.isfinite(score) else None


# --- how well one fits ------------------------------------------------------------------------------------


def _goodness(tests: Specimens, one: Drawn, request: Request) -> GoodnessEntry:
    """Parametric bootstrap of the distance between the law at its mode and the Turnbull estimate."""
    if len(tests) > _MOST:
        return GoodnessEntry(reason=f"more than {_MOST} distinct tests: the distance is not taken")
    if tests.particles < 3:
        return GoodnessEntry(reason="fewer than three tests")
    gamma = request.gamma
    priors = {name: prior for name, prior in one.model.priors.items() if name != "gamma"}
    keep = [k for k, name in enumerate(one.model.names) if name != "gamma"]
    if len(keep) < len(one.model.names):
        gamma = float(np.exp(one.mode[one.model.names.index("gamma")]))
    model, mode = replace(one.model, priors=priors), one.mode[keep]
    rng = random_generator(seed=request.seed, task="goodness of fit")
    times, whole = tests.weight.astype(int), tests
    if times.sum() <= 2 * _MOST:  # every particle a specimen: the scatter of a made-up series is that of particles
        whole = replace(tests.at(np.repeat(np.arange(len(tests)), times)), weight=np.ones(int(times.sum())))
    drawn = _again(model, mode, whole, 4.0 if gamma is None else gamma, _SERIES, rng)
    told = evidence_of([whole, *drawn], 4.0 if gamma is None else gamma, model.classes)

    def value(x: Array) -> Array:
        return log_likelihood(model, told, x) + model.log_prior(x)

    places, _, _ = maximise(value, np.repeat(mode[None], _SERIES + 1, axis=0))
    distances = _distances(model, told, places)
    p_value = (1 + int((distances[1:] >= distances[0]).sum())) / (_SERIES + 1)
    return GoodnessEntry(distance=float(distances[0]), p_value=p_value, series=_SERIES)


def _again(
    model: Model, mode: Array, tests: Specimens, gamma: float, count: int, rng: np.random.Generator
) -> list[Specimens]:
    """Made-up series of the same design: the same sizes, stops and blows, other particles."""
    p = {name: value[0] for name, value in model.parameters(mode[None]).items()}
    at = model.at(tests.diameter[None, None], {name: np.array([value]) for name, value in p.items()})
    flat = {name: np.broadcast_to(value, (1, 1, len(tests)))[0, 0] for name, value in at.items()}
    law, found = laws.LAWS[model.law], []
    if law.sized:
        reached = laws.survivor_bound(tests.energies, tests.counts, gamma)
    else:
        least = flat["threshold"] / tests.diameter
        reached = least + laws.excess_after(tests.energies, tests.counts, least)
    for _ in range(count):
        e = law.quantile(rng.random(len(tests)), flat)
        energies, broke = tests.energies.copy(), e <= reached
        measured = tests.exact & (tests.counts.sum(axis=1) == 1)
        stopped = measured & ~tests.broke
        broke = np.where(measured, ~stopped | (e <= reached), broke)
        energies[:, 0] = np.where(measured & broke, e, energies[:, 0])
        found.append(replace(tests, energies=energies, broke=broke))
    return found


def _distances(model: Model, told: Evidence, x: Array) -> Array:
    """Largest difference (R,) between the uniform law and the Turnbull estimate of u = P(e), on `_CELLS` cells."""
    p, law = model.parameters(x[:, None, :]), laws.LAWS[model.law]
    exact = np.exp(law.below(told.exact[:, None], model.at(told.exact_at[:, None], p)))[:, 0]
    at = model.at(told.at[:, None], p)
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = [np.exp(law.below(part, at))[:, 0] for part in bounds(model, told, at)]
    first = np.concatenate([exact, ends[0]], axis=1)
    last = np.concatenate([exact, np.where(told.survived, 1.0, ends[1])], axis=1)
    weight = np.concatenate([told.exact_weight, told.weight], axis=1)
    weight = np.broadcast_to(weight, first.shape)
    edges = np.arange(_CELLS) / _CELLS
    inside = (edges + 1.0 / _CELLS > first[..., None]) & (edges < last[..., None])
    own = edges == (np.minimum(np.floor(first * _CELLS), _CELLS - 1) / _CELLS)[..., None]
    covers = np.where(inside.any(axis=-1, keepdims=True), inside, own).astype(float)
    share = np.full((len(x), _CELLS), 1.0 / _CELLS)
    for _ in range(_ROUNDS):
        mass = np.maximum(covers @ share[..., None], 1e-300)[..., 0]
        share = share * ((weight / mass)[:, None, :] @ covers)[:, 0]
        share /= share.sum(axis=-1, keepdims=True)
    return np.asarray(np.abs(np.cumsum(share, axis=-1) - (edges + 1.0 / _CELLS)).max(axis=-1))
