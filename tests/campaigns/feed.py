"""Coverage of what tests of single particles leave open, and simulation-based calibration.

    python -m tests.campaigns.feed coverage --series 200     # three designs, so many series each
    python -m tests.campaigns.feed calibration --series 200  # truths drawn from the priors, ranks in ten bins
    python -m tests.campaigns.feed choice --series 400       # how often the right law has the larger likelihood

Many series are fitted side by side: the same likelihood, maximum and ensemble as in `uqsphere.feed.infer`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import numpy as np

from tests.campaigns import options
from uqsphere.arrays import Array
from uqsphere.feed import laws
from uqsphere.feed.infer import PRIORS, Request, draw
from uqsphere.feed.likelihood import (
    WALKERS,
    Evidence,
    Model,
    Prior,
    effective_size,
    ensemble,
    evidence_of,
    hill_at,
    log_likelihood,
    maximise,
)
from uqsphere.feed.tests import Specimens, make_specimens

TRUTH = {"e_inf": 60.0, "d0": 0.006, "phi": 1.1, "sigma": 0.55, "gamma": 4.0}
#: a feed: sizes [m], mass shares, energy of a blow [J/kg], blows
FEED = (np.array([0.004, 0.007, 0.012, 0.018]), np.array([0.2, 0.3, 0.3, 0.2]), 80.0, 3)
STEPS, BURN = 320, 60


def fresh(d: Array, p: dict[str, float], rng: np.random.Generator, ratio: float = 4.0) -> Array:
    """First fracture energies."""
    at = {**p, "median": laws.median_energy("tavares", d, p), "ratio": ratio}
    return laws.LAWS["lognormal"].quantile(rng.random(d.size), at)


def one_size(p: dict[str, float], rng: np.random.Generator) -> Specimens:
    """Twenty particles of 10 mm pressed until they break or, two in ten, to a stop; no bound of the law."""
    e = fresh(np.full(20, 0.01), p, rng, math.inf)
    stop = np.where(np.arange(20) % 5 == 4, 1.1 * float(laws.median_energy("tavares", 0.01, p)), np.inf)
    return make_specimens(np.full(20, 0.01), np.minimum(e, stop), broke=e <= stop)


def sizes(p: dict[str, float], rng: np.random.Generator) -> Specimens:
    """Twelve particles of each of four sizes, those that outlast 1.5 E50 stopped there."""
    d = np.repeat([0.002, 0.005, 0.01, 0.02], 12)
    e, stop = fresh(d, p, rng), 1.5 * laws.median_energy("tavares", d, p)
    return make_specimens(d, np.minimum(e, stop), broke=e <= stop)


def blows(p: dict[str, float], rng: np.random.Generator) -> Specimens:
    """Sixty particles of three sizes, hit with 0.3 to 1 E50 until they break, six times at the most."""
    d = np.repeat([0.005, 0.01, 0.02], 20)
    offered = np.tile([0.3, 0.5, 0.7, 1.0], 15) * laws.median_energy("tavares", d, p)
    broken = fresh(d, p, rng)[:, None] <= offered[:, None] * laws.thresholds(p["gamma"], 6)[1:]
    broke = broken.any(axis=1)
    last = np.where(broke, broken.argmax(axis=1) + 1, 6)
    counts = np.stack([np.where(broke, last - 1, last), np.where(broke, 1, 0)], axis=1)
    # the first blow broke it: one row
    first = counts[:, 0] == 0
    counts[first] = [1, 0]
    return Specimens(diameter=d, energies=np.where(counts > 0, offered[:, None], 0.0), counts=counts, broke=broke,
                     exact=np.zeros(60, dtype=bool), weight=np.ones(60))  # fmt: skip


def posterior(model: Model, told: Evidence, start: Array, rng: np.random.Generator) -> Array:
    """Draws (R, n, d) of every series."""

    def value(x: Array) -> Array:
        return log_likelihood(model, told, x) + model.log_prior(x)

    mode, curved, _ = maximise(value, np.repeat(start[None], len(told.weight), axis=0))
    hill = hill_at(mode, curved)
    x = hill.draw(WALKERS, rng)
    x = np.where(np.isfinite(value(x))[..., None], x, mode[:, None] + 1e-3 * rng.standard_normal(x.shape))
    chain = ensemble(value, x, STEPS + BURN, rng, hill)[BURN:]
    worth = [effective_size(chain[:, [k]]).min() for k in range(0, len(mode), max(1, len(mode) // 10))]
    print(f"  effective size of a tenth of the series: {min(worth):.0f} to {max(worth):.0f}")
    return np.asarray(chain.transpose(1, 0, 2, 3).reshape(len(mode), -1, mode.shape[1])[:, ::8])


def quantities(model: Model, x: Array, at: Sequence[float]) -> dict[str, Array]:
    """What is looked at, (R, n) each, of logarithms (R, n, d)."""
    p = model.parameters(x)
    found = {f"E50({1e3 * d:g} mm)": model.at(np.array([[[d]]]), p)["median"][..., 0] for d in at}
    found |= {name: p[name][..., 0] for name in ("sigma", "gamma", "phi") if name in p}
    d, mass, energy, count = FEED
    u = laws.thresholds(p.get("gamma", np.full((*x.shape[:2], 1), TRUTH["gamma"]))[..., 0], count)[..., -1:]
    share = laws.broken_share("lognormal", u * energy, model.at(d[None, None], p))
    found["share broken of a feed"] = share @ mass
    return found


def _model(gamma: bool, **own: Prior) -> Model:
    names = ("e_inf", "d0", "phi", "sigma", *(("gamma",) if gamma else ()))
    known = {**PRIORS, "e_inf": Prior(centre=math.log(60.0), sd=5.0), **own}
    return Model(law="lognormal", size="tavares", ratio=4.0, priors={name: known[name] for name in names})


def coverage(series: int, seed: int) -> None:
    """Share of series whose 95 % interval holds the truth."""
    rng, pooled = np.random.default_rng(seed), dict[str, list[bool]]()
    held = dict[str, list[bool]]()
    truth = TRUTH | {"E50": float(laws.median_energy("tavares", 0.01, TRUTH))}
    for k in range(series):
        request = Request(law="lognormal", size="class", ratio=math.inf, seed=seed + k)
        found = np.exp(draw(one_size(TRUTH, rng), request, 2000).x)
        for name, column, value in zip(("E50(10 mm)", "sigma"), found.T, (truth["E50"], 0.55), strict=True):
            low, high = np.quantile(column, [0.025, 0.975])
            held.setdefault(name, []).append(bool(low <= value <= high))
    _told("one size, exact pivots", held, pooled)
    for title, make, at in (("sizes, censored", sizes, (0.002, 0.005, 0.01, 0.02)),
                            ("go/no-go, repeated blows", blows, (0.005, 0.01, 0.02))):  # fmt: skip
        model = _model(make is blows)
        told = evidence_of([make(TRUTH, rng) for _ in range(series)], None if make is blows else TRUTH["gamma"])
        start = np.log([TRUTH[name] for name in model.names])
        found = quantities(model, posterior(model, told, start, rng), at)
        right = quantities(model, start[None, None], at)
        held = {}
        for name, values in found.items():
            low, high = np.quantile(values, [0.025, 0.975], axis=1)
            held[name] = ((low <= right[name][0, 0]) & (right[name][0, 0] <= high)).tolist()
        _told(title, held, pooled)
    print("pooled: " + ", ".join(f"{name} {100 * np.mean(part):.1f} % of {len(part)}" for name, part in pooled.items()))


def _told(title: str, held: dict[str, list[bool]], pooled: dict[str, list[bool]]) -> None:
    print(f"{title}: " + ", ".join(f"{name} {100 * np.mean(part):.1f}" for name, part in held.items()), flush=True)
    for name, part in held.items():
        kind = "E50" if name.startswith("E50") else name
        if kind in ("E50", "sigma", "share broken of a feed"):
            pooled.setdefault(kind, []).extend(part)
            pooled.setdefault("all", []).extend(part)


def calibration(series: int, seed: int) -> None:
    """Ranks of truths that were drawn from the priors among the draws: ten bins, chi-squared of nine degrees."""
    from scipy.stats import chi2

    rng = np.random.default_rng(seed)
    own = {"e_inf": Prior(centre=math.log(60.0), sd=0.5)}
    for title, make, at in (("sizes, censored", sizes, (0.005, 0.02)), ("go/no-go, repeated", blows, (0.005, 0.02))):
        model = _model(make is blows, **own)
        priors = list(model.priors.values())
        x = np.array([[p.centre + p.sd * rng.standard_normal() for p in priors] for _ in range(series)])
        drawn = [{"gamma": 4.0, **dict(zip(model.names, np.exp(row).tolist(), strict=True))} for row in x]
        told = evidence_of([make(p, rng) for p in drawn], None if make is blows else 4.0)
        found = quantities(model, posterior(model, told, np.array([p.centre for p in priors]), rng), at)
        right = quantities(model, x[:, None], at)
        for name, values in found.items():
            rank = (values < right[name]).mean(axis=1)
            counts = np.histogram(rank, bins=np.linspace(0.0, 1.0 + 1e-9, 11))[0]
            p_value = float(chi2.sf(((counts - series / 10) ** 2 / (series / 10)).sum(), 9))
            print(f"{title}: {name}: {' '.join(map(str, counts))}, p {p_value:.2f}", flush=True)


def choice(series: int, seed: int) -> None:
    """How often the right one of lognormal and Weibull has the larger likelihood, by the number of tests."""
    names, p = ("lognormal", "weibull"), {"median": 100.0, "sigma": 0.6, "ratio": math.inf, "modulus": 2.1375 / 0.6}
    rng = np.random.default_rng(seed)
    for n in (20, 30, 50, 100):
        right = 0
        for truth in names:
            made = [make_specimens(np.full(n, 0.01), laws.LAWS[truth].quantile(rng.random(n), p))
                    for _ in range(series // 2)]  # fmt: skip
            told, score = evidence_of(made, None), {}
            for name in names:
                key = laws.LAWS[name].keys[0]
                model = Model(law=name, size="class", ratio=math.inf, classes=(0.01,),
                              priors={"e50_1": Prior(), key: Prior()})  # fmt: skip
                start = np.tile([math.log(100.0), math.log(p[key])], (len(made), 1))
                at, _, _ = maximise(lambda x, model=model, told=told: log_likelihood(model, told, x), start)
                score[name] = log_likelihood(model, told, at[:, None])[:, 0]
            other = names[1 - names.index(truth)]
            right += int((score[truth] > score[other]).sum())
        print(f"n = {n}: {100 * right / (series // 2 * 2):.0f} %", flush=True)


PARTS = {"coverage": coverage, "calibration": calibration, "choice": choice}


def main() -> None:
    chosen = options(__doc__, words=PARTS, series=200, seed=1)
    begin = time.process_time()
    for part in chosen.words or PARTS:
        PARTS[part](chosen.series, chosen.seed)
    print(f"{time.process_time() - begin:.0f} s of CPU")


if __name__ == "__main__":
    main()
