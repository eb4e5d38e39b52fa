"""Do the 95 % intervals of a run hold the truth, model by model?

The models are public: those of `tests.campaigns.chaos` (sources there) and those below, each with
its kind.  A cell is one model, one size and one seed, run through `uqsphere.run` as a slow model of
so many model runs, or as a cheap one.  Truths are closed forms where a model has them, and else 16
scrambled Sobol' samples of 2^16 rows, whose spread is allowed for three times.

    python -m tests.campaigns.zoo [MODEL...] [--sizes 64 256] [--seeds 10] [--cheap] [--random]
        [--truths]

`--random` analyses independent random rows (`uqsphere.analyse`) in place of a run's own, which fill
the space evenly: intervals are those of random rows, since one design cannot tell what it gains.
Printed for each kind of answer, and for each model: the share of the intervals that hold, the
median half-width (of moments and quantiles over the standard deviation, of probabilities over the
truth), and the share of the answers that are absent.  `--truths` computes the truths anew.
"""

from __future__ import annotations

import json
import math
import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd
from scipy.special import ndtri
from scipy.stats import qmc

import uqsphere
from tests.campaigns import chaos, options, table, tell
from uqsphere import Study
from uqsphere.arrays import Array
from uqsphere.errors import TooManyFailures, UsageError

TRUTHS: Final = Path(__file__).with_name("zoo.json")
#: replicates of a truth, their rows, and the base points of their indices
REPLICATES, ROWS, PAIRS = 16, 1 << 16, 1 << 13
QUANTILES: Final = (0.05, 0.5, 0.95)
#: probabilities of exceedance, of which the limits are the quantiles
TAILS: Final = (0.1, 0.01, 0.001)
#: standard errors of a truth that a cell is allowed
ALLOWED: Final = 3.0
CHEAP: Final = 0

Columns = Mapping[str, Array]


@dataclass(frozen=True, kw_only=True)
class ZooModel:
    """A public model of independent inputs, or of inputs with a dependence.

    Attributes
    ----------
    kind : smooth, kink, jump, plateau, tail, rare, constant, many, few, copula or failing
    inputs : laws by name, as a study takes them
    function : columns of the inputs to the output; nan where a row fails
    source : where the model is from
    dependence : as a study takes it
    exact : truths in closed form, by answer and place
    """

    name: str
    kind: str
    inputs: Mapping[str, Any]
    function: Callable[[Columns], Array]
    source: str
    dependence: Sequence[Mapping[str, Any]] = ()
    exact: Mapping[str, float] = field(default_factory=dict)

    def study(self, seed: int, **further: Any) -> Study:
        """The study of the model with the quantiles of the campaign."""
        analysis = {"quantiles": list(QUANTILES), **further.pop("analysis", {})}
        if self.kind == "failing":
            analysis["on_failure"] = "10 %"
        dependence = {"dependence": list(self.dependence)} if self.dependence else {}
        return Study(
            inputs=dict(self.inputs),
            outputs="y",
            seed=seed,
            analysis=analysis,
            **dependence,
            **further,
        )

    def rows(self, uniforms: Array) -> Array:
        """Outputs (n,) at uniforms (n, d)."""
        joint = self.study(0).inputs()
        values = joint.physical(ndtri(np.clip(uniforms, 1e-16, 1.0 - 1e-16)))
        return self.function(dict(zip(joint.names, values.T, strict=True)))


def _uniform(lower: float = 0.0, upper: float = 1.0) -> dict[str, Any]:
    return {"dist": "uniform", "lower": lower, "upper": upper}


def _normal(mean: float = 0.0, sd: float = 1.0) -> dict[str, Any]:
    return {"dist": "normal", "mean": mean, "sd": sd}


def _each(law: Mapping[str, Any], count: int) -> dict[str, Any]:
    return {f"x{k}": law for k in range(1, count + 1)}


def _stacked(x: Columns) -> Array:
    return np.stack([*x.values()], axis=1)


# --- models that the campaign of expansions does not have ----------------------------------------


def _oakley(x: Columns) -> Array:
    a, b = x["x1"], x["x2"]
    return 5.0 + a + b + 2.0 * np.cos(a) + 2.0 * np.sin(b)


def _spill(x: Columns, at: float = 1.0, when: float = 40.0) -> Array:
    """Concentration at a place and a time after two spills into a channel."""
    mass, rate, place, second = x["M"], x["D"], x["L"], x["tau"]

    def part(after: Array, off: Array) -> Array:
        since = np.maximum(after, 1e-9)
        spread = mass / np.sqrt(4.0 * np.pi * rate * since) * np.exp(-(off**2) / (4 * rate * since))
        return np.where(after > 0.0, spread, 0.0)

    both = part(np.full(len(mass), when), np.full(len(mass), at)) + part(when - second, at - place)
    return math.sqrt(4.0 * np.pi) * both


_SPILL: Final = {
    "M": {"dist": "triangular", "lower": 7.0, "upper": 13.0, "mode": 10.0},
    "D": {"dist": "beta", "alpha": 2.0, "beta": 3.0, "lower": 0.02, "upper": 0.12},
    "L": _uniform(0.01, 3.0),
    "tau": _uniform(30.01, 30.295),
}


def _epidemic(x: Columns) -> Array:
    """Peak share of the infected in a Kermack-McKendrick epidemic that begins with one percent."""
    ratio = x["beta"] / x["gamma"]
    susceptible = 0.99 * x["s"]
    reproduction = np.maximum(ratio * susceptible, 1.0)
    peak = 0.01 + susceptible - (1.0 + np.log(reproduction)) / np.maximum(ratio, 1e-9)
    return np.where(ratio * susceptible > 1.0, peak, 0.01)


def _morokoff(x: Columns) -> Array:
    values = _stacked(x)
    d = values.shape[1]
    return (1.0 + 1.0 / d) ** d * np.prod(values ** (1.0 / d), axis=1)


def _bratley(x: Columns) -> Array:
    products = np.cumprod(_stacked(x), axis=1)
    signs = (-1.0) ** np.arange(1, products.shape[1] + 1)
    return products @ signs


def _bratley_truth() -> dict[str, float]:
    """Indices by Gauss's rule of two points an input, which is exact: the function is linear in
    each of its inputs.
    """
    nodes = 0.5 + np.array([-0.5, 0.5]) / math.sqrt(3.0)
    names = [f"x{k}" for k in range(1, 6)]
    grid = np.meshgrid(*[nodes] * len(names), indexing="ij")
    columns = {name: column.ravel() for name, column in zip(names, grid, strict=True)}
    y = _bratley(columns).reshape(grid[0].shape)
    truths = {}
    for k, name in enumerate(names):
        others = tuple(j for j in range(len(names)) if j != k)
        truths[f"first {name}"] = float(y.mean(axis=others).var() / y.var())
        truths[f"total {name}"] = float(y.var(axis=k).mean() / y.var())
    return truths


def _moon(x: Columns) -> Array:
    a, b, c = x["x1"], x["x2"], x["x3"]
    return a + b + 3.0 * a * c


def _webster(x: Columns) -> Array:
    return x["A"] ** 2 + x["B"] ** 3


def _levitan(x: Columns) -> Array:
    values = _stacked(x)
    weights = 2.0 ** -np.arange(values.shape[1])
    rates = 4.0 * weights
    return np.exp(values @ rates) - np.prod(np.expm1(rates) / rates)


def _park(x: Columns) -> Array:
    a, b, c, d = x["x1"], x["x2"], x["x3"], x["x4"]
    return 2.0 / 3.0 * np.exp(a + b) - d * np.sin(c) + c


def _lim(x: Columns) -> Array:
    a, b = x["x1"], x["x2"]
    ab = (30.0 + 5.0 * a * np.sin(5.0 * a)) * (4.0 + np.exp(-5.0 * b)) - 100.0
    return ab / 6.0


def _g_star(x: Columns) -> Array:
    """Shifted and bent g-function."""
    weights = np.array([0.0, 0.5, 3.0, 9.0, 99.0])
    shifts = np.array([0.42, 0.17, 0.83, 0.31, 0.66])
    moved = _stacked(x) + shifts
    turned = np.abs(2.0 * (moved - np.floor(moved)) - 1.0) ** 0.7
    return np.prod((1.7 * turned + weights) / (1.0 + weights), axis=1)


def _kink(x: Columns) -> Array:
    return np.maximum(x["a"], x["b"]) * x["c"]


def _heavy(x: Columns) -> Array:
    return x["a"] * x["b"] + x["c"]


def _heavy_truth() -> dict[str, float]:
    """Moments and indices of a b + c with ln a ~ N(0, 4), ln b ~ N(0, 1/4), c ~ N(0, 1)."""
    a, b = math.expm1(4.0), math.expm1(0.25)
    square = math.exp(4.25)
    variance = square * (a + b + a * b) + 1.0
    return {
        "mean": math.exp(2.125),
        "sd": math.sqrt(variance),
        "first a": square * a / variance,
        "first b": square * b / variance,
        "first c": 1.0 / variance,
        "total a": square * a * (1.0 + b) / variance,
        "total b": square * b * (1.0 + a) / variance,
        "total c": 1.0 / variance,
    }


def _rare(x: Columns) -> Array:
    return x["a"] + 0.5 * x["b"] + np.where(x["c"] > 3.09, 50.0, 0.0)


def _island(x: Columns) -> Array:
    inside = (x["a"] + 1.6) ** 2 + (x["b"] - 1.6) ** 2 < 0.16
    return np.where(inside, 5.0, 0.3 * x["a"] - 0.2 * x["b"])


def _step(x: Columns) -> Array:
    return x["a"] + 0.4 * x["b"] + np.where(x["a"] + x["c"] > 0.5, 3.0, 0.0)


def _plateau(x: Columns) -> Array:
    return np.clip(x["a"] + 0.5 * x["b"] * x["c"], -0.2, 1.0)


def _near_constant(x: Columns) -> Array:
    return 1e6 + 1e-3 * _oakley(x)


def _few_of_forty(x: Columns) -> Array:
    return x["x1"] + x["x2"] * x["x3"] + 0.5 * x["x3"] ** 2


def _mixed_ishigami(x: Columns) -> Array:
    return np.sin(x["x1"]) + 7.0 * np.sin(x["x2"]) ** 2 + 0.05 * x["x3"] ** 4 * np.sin(x["x1"])


def _levels(x: Columns) -> Array:
    return x["level"] + 3.0 * x["switch"]


def _gears(x: Columns) -> Array:
    return x["gear"] ** 1.5 * np.exp(0.3 * x["speed"]) / (1.0 + x["load"])


def _failing(x: Columns) -> Array:
    y = np.exp(0.3 * x["x1"]) + x["x2"] * x["x3"]
    # rows fail here and there, as those of a solver that does not converge
    return np.where(np.modf(1e3 * np.abs(x["x1"]))[0] < 0.03, np.nan, y)


def _welch(x: Columns) -> Array:
    v = _stacked(x)
    y = 5.0 * v[:, 11] / (1.0 + v[:, 0]) + 5.0 * (v[:, 3] - v[:, 19]) ** 2 + v[:, 4]
    y += 40.0 * v[:, 18] ** 3 - 5.0 * v[:, 18] + 0.05 * v[:, 1] + 0.08 * v[:, 2]
    y += -0.03 * v[:, 5] + 0.03 * v[:, 6] - 0.09 * v[:, 8] - 0.01 * v[:, 9] - 0.07 * v[:, 10]
    y += 0.25 * v[:, 12] ** 2 - 0.04 * v[:, 13] + 0.06 * v[:, 14] - 0.01 * v[:, 16]
    return y - 0.03 * v[:, 17]


def _currin(x: Columns) -> Array:
    a, b = x["x1"], x["x2"]
    top = 2300.0 * a**3 + 1900.0 * a**2 + 2092.0 * a + 60.0
    low = 100.0 * a**3 + 500.0 * a**2 + 4.0 * a + 20.0
    return -np.expm1(-0.5 / np.maximum(b, 1e-12)) * top / low


def _branin(x: Columns) -> Array:
    a, b = x["x1"], x["x2"]
    well = b - 5.1 / (4.0 * np.pi**2) * a**2 + 5.0 / np.pi * a - 6.0
    return well**2 + 10.0 * (1.0 - 0.125 / np.pi) * np.cos(a) + 10.0


def _gramacy(x: Columns) -> Array:
    return x["x1"] * np.exp(-(x["x1"] ** 2) - x["x2"] ** 2)


def _environment(x: Columns) -> Array:
    return np.maximum(x["a"], 0.0) ** 2 + 0.3 * x["b"]


def _ratio(x: Columns) -> Array:
    return x["load"] / np.maximum(x["strength"], 0.2)


_HALF: Final = _uniform(-0.5, 0.5)
_BETA: Final = {"dist": "beta", "alpha": 2.0, "beta": 5.0, "lower": 0.0, "upper": 1.0}
_LEVELS: Final = {"dist": "discrete", "values": [1, 2, 3, 4, 5]}
_SWITCH: Final = {"dist": "discrete", "values": [0, 1]}
_KINK_LAWS: Final = {
    "a": {"dist": "gumbel", "mean": 11.154, "sd": 2.565},
    "b": _normal(11.0, 2.0),
    "c": {"dist": "lognormal", "mean": 1.0, "cov": 0.1},
}

_OWN: Final = (
    ZooModel(
        name="Oakley",
        kind="smooth",
        inputs=_each(_normal(), 2),
        function=_oakley,
        source="Oakley and O'Hagan, Biometrika 89, 2002, 769",
    ),
    ZooModel(
        name="spill",
        kind="smooth",
        inputs=_SPILL,
        function=_spill,
        source="Bliznyuk et al., J. Comput. Graph. Stat. 17, 2008, 270",
    ),
    ZooModel(
        name="spill, early",
        kind="jump",
        inputs={**_SPILL, "tau": _uniform(30.01, 50.0)},
        function=_spill,
        source="Bliznyuk et al. 2008; the second spill may come after the time",
    ),
    ZooModel(
        name="epidemic",
        kind="plateau",
        inputs={
            "beta": {"dist": "lognormal", "mean": 0.3, "cov": 0.4},
            "gamma": {"dist": "gamma", "shape": 9.0, "scale": 0.2 / 9.0},
            "s": {"dist": "beta", "alpha": 8.0, "beta": 2.0, "lower": 0.0, "upper": 1.0},
        },
        function=_epidemic,
        source="Kermack and McKendrick, Proc. R. Soc. A 115, 1927, 700",
    ),
    ZooModel(
        name="Morokoff",
        kind="smooth",
        inputs=_each(_uniform(), 6),
        function=_morokoff,
        source="Morokoff and Caflisch, J. Comput. Phys. 122, 1995, 218",
    ),
    ZooModel(
        name="Bratley",
        kind="smooth",
        inputs=_each(_uniform(), 5),
        function=_bratley,
        exact=_bratley_truth(),
        source="Bratley, Fox and Niederreiter, ACM Trans. Model. Comput. Simul. 2, 1992, 195",
    ),
    ZooModel(
        name="Moon",
        kind="smooth",
        inputs=_each(_uniform(), 3),
        function=_moon,
        source="Moon, thesis, Ohio State University, 2010",
    ),
    ZooModel(
        name="Webster",
        kind="smooth",
        inputs={"A": _uniform(1.0, 10.0), "B": _normal(2.0, 1.0)},
        function=_webster,
        source="Webster, Tatang and McRae, MIT report 4, 1996",
    ),
    ZooModel(
        name="Levitan",
        kind="tail",
        inputs=_each(_uniform(), 4),
        function=_levitan,
        source="Levitan et al., J. Comput. Phys. 75, 1988, 28",
    ),
    ZooModel(
        name="Park",
        kind="copula",
        inputs={
            "x1": _BETA,
            "x2": {"dist": "triangular", "lower": 0.0, "upper": 1.0, "mode": 0.3},
            "x3": _normal(0.5, 0.2),
            "x4": {"dist": "weibull", "scale": 0.5, "modulus": 3.0},
        },
        dependence=({"of": ["x1", "x2"], "spearman": 0.6}, {"of": ["x3", "x4"], "spearman": -0.4}),
        function=_park,
        source="Park, thesis, University of Illinois, 1991",
    ),
    ZooModel(
        name="Lim",
        kind="smooth",
        inputs=_each(_BETA, 2),
        function=_lim,
        source="Lim et al., Canad. J. Statist. 30, 2002, 109",
    ),
    ZooModel(
        name="G*",
        kind="kink",
        inputs=_each(_uniform(), 5),
        function=_g_star,
        source="Saltelli et al., Comput. Phys. Commun. 181, 2010, 259",
    ),
    ZooModel(
        name="kink",
        kind="kink",
        inputs=_KINK_LAWS,
        function=_kink,
        source="largest of two loads times a model factor; laws of the portal frame, JCSS 2001",
    ),
    ZooModel(
        name="heavy",
        kind="tail",
        inputs={
            "a": {"dist": "lognormal", "log_mean": 0.0, "log_sd": 2.0},
            "b": {"dist": "lognormal", "log_mean": 0.0, "log_sd": 0.5},
            "c": _normal(),
        },
        function=_heavy,
        exact=_heavy_truth(),
        source="products of lognormals, Crow and Shimizu, Lognormal Distributions, 1988",
    ),
    ZooModel(
        name="rare region",
        kind="rare",
        inputs={"a": _normal(), "b": _normal(), "c": _normal()},
        function=_rare,
        source="indicator of a rare event, Glasserman, Monte Carlo Methods, 2004, section 4.6",
    ),
    ZooModel(
        name="island",
        kind="rare",
        inputs={"a": _normal(), "b": _normal()},
        function=_island,
        source="island of failure, Katafygiotis and Zuev, Probab. Eng. Mech. 23, 2008, 208",
    ),
    ZooModel(
        name="jump",
        kind="jump",
        inputs={"a": _normal(), "b": _normal(), "c": _normal()},
        function=_step,
        source="Heaviside step, Gerstner and Griebel, Computing 71, 2003, 65",
    ),
    ZooModel(
        name="plateau",
        kind="plateau",
        inputs={"a": _normal(), "b": _normal(), "c": _normal()},
        function=_plateau,
        source="a clipped response, Genz, in: Numerical Integration, 1987, 337",
    ),
    ZooModel(
        name="near-constant",
        kind="constant",
        inputs=_each(_normal(), 2),
        function=_near_constant,
        source="Oakley and O'Hagan 2002, a thousandth of it on a million",
    ),
    ZooModel(
        name="3 of 40",
        kind="many",
        inputs=_each(_normal(), 40),
        function=_few_of_forty,
        source="quadratic form in three of forty inputs, Blatman and Sudret 2011",
    ),
    ZooModel(
        name="Ishigami, mixed laws",
        kind="smooth",
        inputs={
            "x1": _normal(0.0, 1.3),
            "x2": {"dist": "triangular", "lower": -math.pi, "upper": math.pi, "mode": 0.0},
            "x3": _uniform(-math.pi, math.pi),
        },
        function=_mixed_ishigami,
        source="Ishigami and Homma 1990, b of Sobol' and Levitan 1999",
    ),
    ZooModel(
        name="levels",
        kind="few",
        inputs={"level": _LEVELS, "switch": _SWITCH},
        function=_levels,
        source="two discrete inputs, SALib issue 341",
        exact={"first level": 8.0 / 17.0, "first switch": 9.0 / 17.0},
    ),
    ZooModel(
        name="gears",
        kind="few",
        inputs={"gear": _LEVELS, "speed": _normal(), "load": _uniform()},
        function=_gears,
        source="mixed discrete and continuous inputs, Ax issue 2398",
    ),
    ZooModel(
        name="failing rows",
        kind="failing",
        inputs=_each(_normal(), 3),
        function=_failing,
        source="hidden constraints, Le Digabel and Wild, Optim. Eng. 25, 2024, 1125",
    ),
    ZooModel(
        name="Welch",
        kind="many",
        inputs=_each(_HALF, 20),
        function=_welch,
        source="Welch et al., Technometrics 34, 1992, 15",
    ),
    ZooModel(
        name="Currin",
        kind="smooth",
        inputs=_each(_uniform(), 2),
        function=_currin,
        source="Currin et al., J. Amer. Statist. Assoc. 86, 1991, 953",
    ),
    ZooModel(
        name="Branin",
        kind="smooth",
        inputs={"x1": _uniform(-5.0, 10.0), "x2": _uniform(0.0, 15.0)},
        function=_branin,
        source="Dixon and Szego, Towards Global Optimisation 2, 1978",
    ),
    ZooModel(
        name="Gramacy",
        kind="smooth",
        inputs=_each(_uniform(-2.0, 6.0), 2),
        function=_gramacy,
        source="Gramacy and Lee, J. Amer. Statist. Assoc. 103, 2008, 1119",
    ),
    ZooModel(
        name="ramp",
        kind="kink",
        inputs={"a": _normal(), "b": _normal()},
        function=_environment,
        source="the positive part of a normal, Gerstner and Griebel 2003",
    ),
    ZooModel(
        name="load over strength",
        kind="copula",
        inputs={
            "load": {"dist": "gumbel", "mean": 1.0, "sd": 0.3},
            "strength": {"dist": "lognormal", "mean": 2.0, "cov": 0.2},
        },
        dependence=({"of": ["load", "strength"], "spearman": 0.5},),
        function=_ratio,
        source="Melchers and Beck, Structural Reliability, 2018, section 1.4",
    ),
)

_KINDS: Final = {
    "dyke": "plateau",
    "g-function": "kink",
    "discontinuous": "jump",
    "product": "tail",
    "damped oscillator": "tail",
}


def _of_chaos(name: str) -> ZooModel:
    model = chaos.MODELS[name]
    names = [f"x{k}" for k in range(1, len(model.laws) + 1)]
    return ZooModel(
        name=name,
        kind=_KINDS.get(name, "smooth"),
        inputs=dict(zip(names, model.laws, strict=True)),
        function=lambda x: np.asarray(model.function(np.stack([x[n] for n in names], axis=1))),
        source="tests/campaigns/chaos.py",
    )


#: name -> model
MODELS: Final = {model.name: model for model in (*map(_of_chaos, chaos.MODELS), *_OWN)}


# --- truths ---------------------------------------------------------------------------------------


class Truth(NamedTuple):
    """A number that a run is held against, and its standard error."""

    value: float
    error: float


def truths_of(model: ZooModel) -> dict[str, Truth]:
    """Every truth by answer and place, such as "quantile 0.05", "above 0.1" and "first x1".

    The key "strength P" has the value that is exceeded with probability P.
    """
    names = [*model.study(0).random]
    found: dict[str, list[float]] = {}

    def note(key: str, value: float) -> None:
        found.setdefault(key, []).append(value)

    samples = []
    for replicate in range(REPLICATES):
        points = qmc.Sobol(len(names), seed=1000 + replicate).random(ROWS)
        y = model.rows(points)
        samples.append(np.sort(y[np.isfinite(y)]))
    pooled = np.sort(np.concatenate(samples))
    strengths = {p: float(f"{np.quantile(pooled, 1.0 - p):.6g}") for p in TAILS}
    for y in samples:
        note("mean", float(y.mean()))
        note("sd", float(y.std()))
        for p in QUANTILES:
            note(f"quantile {p:g}", float(np.quantile(y, p)))
        for p, strength in strengths.items():
            note(f"above {p:g}", float((y > strength).mean()))
    if not model.dependence and model.kind != "failing":
        for replicate in range(REPLICATES):
            _indices(model, names, 2000 + replicate, note)
    truths = {}
    for key, values in found.items():
        error = float(np.std(values, ddof=1)) / math.sqrt(len(values))
        truths[key] = Truth(float(np.mean(values)), error)
    truths |= {key: Truth(value, 0.0) for key, value in model.exact.items()}
    truths |= {f"strength {p:g}": Truth(value, 0.0) for p, value in strengths.items()}
    return truths


def _indices(
    model: ZooModel, names: Sequence[str], seed: int, note: Callable[[str, float], None]
) -> None:
    """First and total indices of one randomisation (Saltelli et al. 2010, Jansen 1999)."""
    d = len(names)
    points = qmc.Sobol(2 * d, seed=seed).random(PAIRS)
    one, other = points[:, :d], points[:, d:]
    a, b = model.rows(one), model.rows(other)
    centre = 0.5 * (a.mean() + b.mean())
    variance = 0.5 * float(((a - centre) ** 2 + (b - centre) ** 2).mean())
    for k, name in enumerate(names):
        mixed = one.copy()
        mixed[:, k] = other[:, k]
        changed = model.rows(mixed)
        note(f"first {name}", float(((b - centre) * (changed - a)).mean()) / variance)
        note(f"total {name}", 0.5 * float(((a - changed) ** 2).mean()) / variance)


def all_truths() -> dict[str, dict[str, Truth]]:
    """The stored truths."""
    stored = json.loads(TRUTHS.read_text(encoding="utf-8"))
    return {
        name: {key: Truth(*pair) for key, pair in truths.items()} for name, truths in stored.items()
    }


def write_truths(names: Sequence[str]) -> None:
    """Compute the truths of some models, and store them beside the others."""
    stored = all_truths() if TRUTHS.exists() else {}
    for name in names:
        began = time.process_time()
        stored[name] = truths_of(MODELS[name])
        tell(f"{name}: {time.process_time() - began:.1f} CPU s")
        rounded = {
            each: {key: [float(f"{v:.14g}"), float(f"{e:.2g}")] for key, (v, e) in truths.items()}
            for each, truths in stored.items()
        }
        TRUTHS.write_text(json.dumps(rounded, indent=0) + "\n", encoding="utf-8")


# --- cells ----------------------------------------------------------------------------------------


class Hit(NamedTuple):
    """One answer of one cell: whether it holds, and its half-width over the scale of its kind."""

    model: str
    size: int
    kind: str
    held: bool | None
    held_with_unseen: bool | None
    width: float


def analysed(model: ZooModel, study: Study, size: int) -> uqsphere.Run:
    """The analysis of `size` independent random rows."""
    joint = study.inputs()
    rng = np.random.default_rng((study.seed, size))
    columns = joint.physical(rng.standard_normal((size, len(joint.names)))).T
    rows = dict(zip(joint.names, columns, strict=True))
    return uqsphere.analyse(study, pd.DataFrame({**rows, "y": model.function(rows)}))


def cell(
    model: ZooModel, truths: Mapping[str, Truth], size: int, seed: int, *, random: bool = False
) -> list[Hit]:
    """The answers of one run: a slow model of `size` model runs, or a cheap one; or of so many
    random rows.
    """
    analysis: dict[str, Any] = {}
    if size != CHEAP and not random:
        analysis = {"cost": "10 s", "budget": {"evaluations": size, "time": "100 h"}}
    limits = {
        f"p{p:g}".replace(".", "_"): {
            "quantity": "y",
            "strength": truths[f"strength {p:g}"].value,
            "aim": "survive",
        }
        for p in TAILS
    }
    # a limit is a number, which the study takes for one of its quantity
    study = model.study(seed, limits=limits, analysis=analysis)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            if random:
                run = analysed(model, study, size)
            else:
                run = uqsphere.run(study, lambda x: {"y": model.function(x)})
            answers = run.results.answers
        except (TooManyFailures, UsageError) as refused:
            tell(f"  {model.name}, {size} runs, seed {seed}: {refused}")
            answers = []
    rows = {(row.subject, row.answer.value, row.at): row for row in answers}
    hits = []

    def hold(kind: str, place: tuple[str, str, Any], truth: Truth, scale: float) -> None:
        row = rows.get(place)
        if row is None or (row.low is None and row.high is None):
            hits.append(Hit(model.name, size, kind, None, None, math.inf))
            return
        slack = ALLOWED * truth.error + 1e-9 * abs(truth.value)
        outer = row.low_unseen, row.high_unseen
        held = [
            (low is None or low - slack <= truth.value)
            and (high is None or truth.value <= high + slack)
            for low, high in ((row.low, row.high), outer)
        ]
        width = math.inf
        if row.low is not None and row.high is not None:
            width = 0.5 * (row.high - row.low) / scale
        if not held[0]:
            text = f"{kind} {place[2]} {row.value} ({row.low} to {row.high}), {truth.value:.6g}"
            tell(f"  {model.name}, {size} runs, seed {seed}: {text}")
        hits.append(Hit(model.name, size, kind, held[0], held[1], width))

    sd = truths["sd"].value
    hold("mean", ("y", "mean", ""), truths["mean"], sd)
    hold("sd", ("y", "sd", ""), truths["sd"], sd)
    for p in QUANTILES:
        hold(f"q{100 * p:g}", ("y", "quantile", p), truths[f"quantile {p:g}"], sd)
    for (name, _), p in zip(limits.items(), TAILS, strict=True):
        place = f"limits.{name}", "failure_probability", ""
        hold(f"P={p:g}", place, truths[f"above {p:g}"], p)
    for order in ("first", "total"):
        for name in study.random:
            if (truth := truths.get(f"{order} {name}")) is not None:
                hold(order, ("y", f"sobol_{order}", name), truth, 1.0)
    return hits


def _row(label: Sequence[Any], hits: Sequence[Hit]) -> list[str]:
    answered = [hit for hit in hits if hit.held is not None]
    width = float(np.median([hit.width for hit in answered])) if answered else math.nan
    held = f"{sum(bool(hit.held) for hit in answered)} of {len(answered)}"
    outer = str(sum(bool(hit.held_with_unseen) for hit in answered))
    share = 100.0 * sum(bool(hit.held) for hit in answered) / max(len(answered), 1)
    absent = 100.0 * (1.0 - len(answered) / max(len(hits), 1))
    row = [*map(str, label), held, f"{share:.0f}" if answered else "-", outer, f"{width:.2g}"]
    return [*row, f"{absent:.0f}"]


def tables_text(hits: Sequence[Hit]) -> str:
    """The table by kind of answer, then that by model and kind."""
    header = ["held", "%", "with unseen", "median half-width", "absent, %"]
    sizes = list(dict.fromkeys(hit.size for hit in hits))
    kinds = list(dict.fromkeys(hit.kind for hit in hits))
    apart = {name for name, model in MODELS.items() if model.kind in ("rare", "tail")}
    by_kind, by_model = [], []
    for size in sizes:
        for kind in kinds:
            for label, rare in (("all but tails and rare regions", False), ("those", True)):
                some = [h for h in hits if h[1:3] == (size, kind) and (h.model in apart) == rare]
                if some:
                    by_kind.append(_row([size or "cheap", kind, label], some))
    for name in dict.fromkeys(hit.model for hit in hits):
        for kind in kinds:
            some = [h for h in hits if h.model == name and h.kind == kind]
            if some:
                by_model.append(_row([name, MODELS[name].kind, kind], some))
    first = table(["runs", "answer", "models", *header], by_kind)
    return f"{first}\n\n{table(['model', 'kind', 'answer', *header], by_model)}"


def main(arguments: Sequence[str] | None = None) -> int:
    given = options(
        __doc__,
        arguments,
        words=(),
        sizes=[64, 256],
        seeds=10,
        first=1,
        cheap=False,
        random=False,
        truths=False,
    )
    names = given.words or [*MODELS]
    if given.truths:
        write_truths(names)
        return 0
    truths, hits = all_truths(), list[Hit]()
    sizes = [CHEAP] if given.cheap else given.sizes
    for name in names:
        began = time.process_time()
        for size in sizes:
            for seed in range(given.first, given.first + given.seeds):
                hits += cell(MODELS[name], truths[name], size, seed, random=given.random)
        cost = (time.process_time() - began) / (len(sizes) * given.seeds)
        tell(f"{name}: {cost:.2f} CPU s a run")
    print(tables_text(hits))
    return 0


if __name__ == "__main__":
    sys.exit(main())
