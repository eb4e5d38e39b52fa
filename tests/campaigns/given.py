"""Models whose runs come from inputs that depend on each other, or whose laws no family fits; their answers are known.

Outputs are quadratic forms of normal scores, y = c + b·z + z·A z, so that conditional means are quadratic as well and
every closed effect Var(E[y | z_u]) follows in closed form; Shapley effects and Kucherenko's indices are sums of those.

    python -m tests.campaigns.given [--quick]
    python -m tests.campaigns.given --runs 12     runs of a model whose inputs are tied, beside brute force
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import combinations
from typing import Any, Final

import numpy as np
from scipy.special import ndtr, ndtri
from scipy.stats import qmc

import uqsphere
from tests.campaigns import options, table, tell
from tests.campaigns.coverage import CoverageModel, CoverageRow, Hit, Tally, coverage_hit, coverage_models, summary
from uqsphere.arrays import Array
from uqsphere.given import Data, analyse_runs
from uqsphere.uq.estimate import Estimate
from uqsphere.uq.joint import Dependence, Joint, conditional_scores, make_copula, make_joint
from uqsphere.uq.law import Law, make_law
from uqsphere.uq.points import random_generator

_QUANTILES: Final = (0.05, 0.5, 0.95)


@dataclass(frozen=True)
class GivenModel:
    """A model of inputs (n, d) -> (n,), the inputs as they are drawn, and its exact answers.

    `indices` has "first" and "total", and "shapley" where inputs depend on each other.  `transform` makes the inputs
    of the table from those drawn, where no law of this package has them.
    """

    name: str
    inputs: Joint
    function: Callable[[Array], Array]
    mean: float
    sd: float
    quantiles: Mapping[float, float]
    indices: Mapping[str, tuple[float, ...]]
    transform: Callable[[Array], Array] | None = None


def shares_of(closed: Mapping[tuple[int, ...], float], d: int) -> dict[str, tuple[float, ...]]:
    """Shapley effects and Kucherenko's indices from the closed effects Var(E[y | x_u]) of all subsets of d inputs."""
    every = tuple(range(d))
    variance = closed[every]

    def effect(i: int) -> float:
        others = [j for j in every if j != i]
        return sum(
            (closed[tuple(sorted((*u, i)))] - closed[u]) / (d * math.comb(d - 1, size))
            for size in range(d)
            for u in combinations(others, size)
        )

    return {
        "shapley": tuple(effect(i) / variance for i in every),
        "first": tuple(closed[(i,)] / variance for i in every),
        "total": tuple(1.0 - closed[tuple(j for j in every if j != i)] / variance for i in every),
    }


def closed_effects(correlation: Array, linear: Array, square: Array) -> dict[tuple[int, ...], float]:
    """Var(E[b·z + z·A z | z_u]) of normal scores with a correlation (d, d), for every subset u; A symmetric.

    With z = W z_u + rest the conditional mean is (W'b)·z_u + z_u·(W'A W) z_u, of variance b'Σb + 2 tr((BΣ)²).
    """
    d = len(linear)
    found: dict[tuple[int, ...], float] = {(): 0.0}
    for size in range(1, d + 1):
        for u in combinations(range(d), size):
            within = correlation[np.ix_(u, u)]
            weights = correlation[:, u] @ np.linalg.inv(within)
            slope, form = weights.T @ linear, weights.T @ square @ weights
            found[u] = float(slope @ within @ slope + 2.0 * np.trace(form @ within @ form @ within))
    return found


#: normal inputs in the tables: z times the second plus the first
_CENTRE, _SCALE = 3.0, 0.4


def _normals(names: int, ties: list[Dependence]) -> Joint:
    law = make_law("normal", {"mean": _CENTRE, "sd": _SCALE})
    return make_joint([f"x{k + 1}" for k in range(names)], [law] * names, ties)


def _scores(x: Array) -> Array:
    return np.asarray((x - _CENTRE) / _SCALE)


def _spearman(correlation: float) -> float:
    return 6.0 / math.pi * math.asin(0.5 * correlation)


def _linear_tied() -> GivenModel:
    """A sum of four normals, two with correlation 0.7, two with -0.5."""
    weights = np.array([1.0, 0.6, 0.8, 0.3])
    correlation = np.eye(4)
    correlation[0, 1] = correlation[1, 0] = 0.7
    correlation[2, 3] = correlation[3, 2] = -0.5
    inputs = _normals(4, [Dependence(of=("x1", "x2"), spearman=_spearman(0.7)),
                          Dependence(of=("x3", "x4"), spearman=_spearman(-0.5))])  # fmt: skip
    closed = closed_effects(correlation, weights, np.zeros((4, 4)))
    sd = math.sqrt(closed[0, 1, 2, 3])
    quantiles = {p: 10.0 + sd * _normal_score(p) for p in _QUANTILES}
    return GivenModel("linear, Gaussian ties", inputs, lambda x: np.asarray(10.0 + _scores(x) @ weights), 10.0, sd,
                      quantiles, shares_of(closed, 4))  # fmt: skip


def _normal_score(p: float) -> float:
    return float(ndtri(p))


#: quantiles of the product below: four randomisations of 2^21 points of a Sobol' sequence, which agree on these digits
_PRODUCT: Final = (-1.5465, 0.4487, 3.298)


def _product_tied() -> GivenModel:
    """y = z1 z2 + z3, correlation 0.6 of z1 and z2 and 0.5 of z2 and z3."""
    correlation = np.array([[1.0, 0.6, 0.0], [0.6, 1.0, 0.5], [0.0, 0.5, 1.0]])
    square = np.zeros((3, 3))
    square[0, 1] = square[1, 0] = 0.5
    linear = np.array([0.0, 0.0, 1.0])
    inputs = _normals(3, [Dependence(of=("x1", "x2"), spearman=_spearman(0.6)),
                          Dependence(of=("x2", "x3"), spearman=_spearman(0.5))])  # fmt: skip

    def function(x: Array) -> Array:
        z = _scores(x)
        return np.asarray(z[:, 0] * z[:, 1] + z[:, 2])

    closed = closed_effects(correlation, linear, square)
    quantiles = dict(zip(_QUANTILES, _PRODUCT, strict=True))
    return GivenModel("product, Gaussian ties", inputs, function, 0.6, math.sqrt(closed[0, 1, 2]), quantiles,
                      shares_of(closed, 3))  # fmt: skip


def _root(below: Callable[[float], float], p: float) -> float:
    """Where a probability that rises is p, by bisection."""
    low, high = -20.0, 20.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if below(middle) < p else (low, middle)
    return 0.5 * (low + high)


@lru_cache(maxsize=4)
def _pair(kind: str, spearman: float, one: float, other: float) -> tuple[Array, Array]:
    """Values and weights (n, n) of one z1 + other z2 on the midpoints of a grid, z1 and z2 tied by a copula."""

    copula = make_copula(kind, 2, spearman=spearman)
    nodes, weights = np.polynomial.legendre.leggauss(160)
    z, w = np.asarray(ndtri(0.5 * (nodes + 1.0))), 0.5 * weights
    known = np.repeat(z, z.size)[:, None]
    second = conditional_scores(copula, (0,), known, np.tile(z, z.size)[:, None])[:, 0].reshape(z.size, -1)
    return one * z[:, None] + other * second, w[:, None] * w[None, :]


def _linear_archimedean(kind: str) -> GivenModel:
    """A sum of three normals, two of them with rank correlation 0.6 by Clayton's or Gumbel's copula.

    Both are exchangeable, so that a second integral with the weights changed over gives what the other input owns.
    """

    weights = (1.0, 0.6, 0.7)
    spearman = 0.6
    variances = []
    for one, other in (weights[:2], weights[1::-1]):
        values, chance = _pair(kind, spearman, one, other)
        given = (values * chance).sum(axis=1) / chance.sum(axis=1)
        variances.append(float((given**2 * chance.sum(axis=1)).sum()))
    values, chance = _pair(kind, spearman, *weights[:2])
    both, rest = float((values**2 * chance).sum()), weights[2] ** 2
    closed = {(): 0.0, (0,): variances[0], (1,): variances[1], (2,): rest, (0, 1): both, (0, 2): variances[0] + rest,
              (1, 2): variances[1] + rest, (0, 1, 2): both + rest}  # fmt: skip

    def below(y: float) -> float:
        return float((ndtr((y - values) / weights[2]) * chance).sum())

    inputs = _normals(3, [Dependence(of=("x1", "x2"), spearman=spearman, copula=kind)])
    quantiles = {p: _root(below, p) for p in _QUANTILES}
    return GivenModel(f"linear, {kind.capitalize()} tie", inputs, lambda x: np.asarray(_scores(x) @ weights), 0.0,
                      math.sqrt(closed[0, 1, 2]), quantiles, shares_of(closed, 3))  # fmt: skip


#: half the distance of two humps, and the standard deviation of each
_APART, _HUMP = 1.5, 0.4


def _humps() -> GivenModel:
    """A sum of an input with two humps, whose law no family fits, and two normals."""

    weights = np.array([1.0, 0.7, 0.4])
    own = np.array([_APART**2 + _HUMP**2, 1.0, 1.0]) * weights**2
    rest = math.sqrt(_HUMP**2 + float(own[1:].sum()))

    def below(y: float) -> float:
        return 0.5 * float(ndtr((y - _APART) / rest) + ndtr((y + _APART) / rest))

    def humps(x: Array) -> Array:
        z = _scores(x)
        side = np.where(z[:, 3] < 0.0, -_APART, _APART)
        return np.column_stack([side + _HUMP * z[:, 0], x[:, 1:3]])

    def function(x: Array) -> Array:
        return np.asarray(weights[0] * x[:, 0] + _scores(x[:, 1:]) @ weights[1:])

    shares = tuple((own / own.sum()).tolist())
    quantiles = {p: _root(below, p) for p in _QUANTILES}
    indices = {"first": shares, "total": shares}
    return GivenModel("two humps, kernel density", _normals(4, []), function, 0.0, math.sqrt(float(own.sum())),
                      quantiles, indices, humps)  # fmt: skip


#: every model by its name, made when it is asked for
BUILT: Final[dict[str, Callable[[], GivenModel]]] = {
    "linear, Gaussian ties": _linear_tied,
    "product, Gaussian ties": _product_tied,
    "linear, Clayton tie": partial(_linear_archimedean, "clayton"),
    "linear, Gumbel tie": partial(_linear_archimedean, "gumbel"),
    "two humps, kernel density": _humps,
}


# --- Whether the intervals of `analyse` hold the truth: repetitions on analytical models, runs drawn at random.

#: smooth, with true zeros and kinks, linear, and of eight inputs with three families; then dependent inputs, and one
#: whose law no family fits
MODELS: Final = (
    "ishigami", "g-function", "linear", "borehole", "linear, Gaussian ties", "product, Gaussian ties",
    "linear, Clayton tie", "linear, Gumbel tie", "two humps, kernel density",
)  # fmt: skip
SIZES: Final = (100, 400)
#: repetitions of a cell, from this seed on
REPETITIONS: Final = 200
FIRST_SEED: Final = 1000
#: share of the tables of a model that have to give an answer for it to be counted
_FEWEST: Final = 0.05
_WAYS: Final = {False: "laws fitted", True: "laws known"}


def _independent(model: CoverageModel) -> GivenModel:
    """A model of the coverage table with laws that its inputs could have in a study."""
    laws = [
        make_law("normal", {"mean": 3.0, "sd": 0.4}) if germ == "normal" else make_law("uniform", {}, -1.0, 4.0)
        for germ in model.germs
    ]
    inputs = Joint(names=tuple(f"x{j + 1}" for j in range(model.dimension)), laws=tuple(laws))

    def function(x: Array) -> Array:
        return model.function(np.column_stack([law.cdf(x[:, k]) for k, law in enumerate(laws)]))

    indices = {"first": model.first, "total": model.total}
    return GivenModel(model.name, inputs, function, model.mean, model.sd, model.quantiles, indices)


def model_of(name: str) -> GivenModel:
    """A model by its name."""
    if name in BUILT:
        return BUILT[name]()
    return _independent({model.name: model for model in coverage_models()}[name])


def _way(model: GivenModel, known: bool) -> str:
    """What the cells of a model are pooled with."""
    if model.transform is not None:
        return "kernel density"
    if "shapley" not in model.indices:
        return _WAYS[known]
    return f"{_WAYS[known]}, inputs dependent"


_KINDS: Final = {"shapley": "Shapley effect", "first": "first index", "total": "total index"}


def _answers(model: GivenModel, found: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any], float]]:
    """(kind, of what, estimate, truth) of everything that an analysis prints."""
    chaos, output = found["sensitivity"]["y"]["chaos"], found["outputs"]["y"]
    truths = {"mean": model.mean, "sd": model.sd, **{f"{p:g}": truth for p, truth in model.quantiles.items()}}
    for what, truth in truths.items():
        kind = what if what in ("mean", "sd") else f"quantile {what}"
        alone = output[what] if what in output else output["quantiles"][what]
        yield f"{kind}, runs alone", "y", alone, truth
        if output["expansion"] is not None:
            yield kind, "y", output["expansion"][what]["whole"], truth
    for j, truth in enumerate(model.indices["first"]):
        yield "first index, by ranks", f"x{j + 1}", found["sensitivity"]["y"]["ranks"][f"x{j + 1}"], truth
    for order, row in model.indices.items():
        # where the dependence was not seen, Sobol' indices are printed, and they are not Kucherenko's
        for j, truth in enumerate(row):
            if order in chaos:
                yield _KINDS[order], f"x{j + 1}", chaos[order][f"x{j + 1}"]["whole"], truth


def _runs(model: GivenModel, n: int, seed: int) -> Data:
    """Independent draws of the inputs."""
    generator = random_generator(seed=seed, task=f"given runs {model.name} {n}")
    x = model.inputs.physical(generator.standard_normal((n, len(model.inputs.names))))
    if model.transform is not None:
        x = model.transform(x)
    names = tuple(f"x{j + 1}" for j in range(x.shape[1]))
    return Data(inputs=names, outputs=("y",), x=x, y=model.function(x)[:, None])


def _repeat(model: GivenModel, n: int, known: bool, seed: int) -> tuple[list[Hit], bool, bool]:
    """What one table of runs answers, whether the expansion was used, and whether a disagreement was told.

    The analysis draws anew for every table: with one seed its designs would be off by the same amount in all of them,
    and a cell would count that one draw many times.
    """
    found = analyse_runs(_runs(model, n, seed), known=model.inputs if known else None, seed=seed)[0]
    hits = []
    for kind, what, entry, truth in _answers(model, found):
        if entry["value"] is None:
            continue
        keys = ("value", "low", "high", "std_error", "method", "evaluations")
        estimate = Estimate(**{key: entry[key] for key in keys})
        hits.append(coverage_hit(kind, _way(model, known), model.name, what, n, estimate, truth))
    sensitivity = found["sensitivity"]["y"]
    return hits, bool(sensitivity["chaos"]["usable"]), bool(sensitivity["disagree"])


def given_rows(
    *,
    repetitions: int,
    models: Sequence[str] = MODELS,
    sizes: Sequence[int] = SIZES,
    known: Sequence[bool] = (False, True),
    first_seed: int = 0,
    notice: Callable[[str], None] = lambda text: None,
) -> list[CoverageRow]:
    """Cells of tables of random runs: what the runs tell alone, and by an expansion where it passes its check.

    How often the expansion was used, and how often runs and expansion were said to disagree, goes to `notice`.
    """
    tally = Tally()
    for name in models:
        model = model_of(name)
        for n in sizes:
            for which in known:
                if which and model.transform is not None:
                    continue
                used = apart = 0
                for seed in range(first_seed, first_seed + repetitions):
                    hits, usable, disagree = _repeat(model, n, which, seed)
                    tally.add(hits)
                    used, apart = used + usable, apart + disagree
                told = f"expansion used {used} of {repetitions}, disagreement {apart}"
                notice(f"{name}, {n} runs, {_WAYS[which]}: {told}")
    return tally.rows()


def given_text(rows: Sequence[CoverageRow], told: Sequence[str]) -> str:
    """The table as Markdown, what lies outside of what is due, and how often there was an expansion.

    An answer that fewer than a twentieth of the tables of a model give is left out: what was told says how many had an
    expansion.
    """
    most: dict[tuple[str, int], int] = {}
    for row in rows:
        most[row.model, row.points] = max(row.repetitions, most.get((row.model, row.points), 0))
    rows = [row for row in rows if row.repetitions >= _FEWEST * most[row.model, row.points]]
    return "\n".join([
        "How often the nominal 95 % intervals of `uqsphere analyse` hold the truth: runs drawn at random, laws and "
        f"dependence fitted to the same runs.\n\n{summary(rows)}\n", *(f"- {line}" for line in told),
    ])  # fmt: skip


# --- Runs of a model whose inputs depend on each other: a sum in both orders of its equal inputs, and the borehole.

_TIED_SUM: Final = [Dependence(of=("a", "b"), spearman=0.6)]
_TIED_BOREHOLE: Final = [Dependence(of=("rw", "Kw"), spearman=0.6), Dependence(of=("Hu", "Hl"), spearman=0.5),
                         Dependence(of=("Tu", "Tl", "L"), spearman=0.4)]  # fmt: skip


@dataclass(frozen=True)
class TiedModel:
    """A model of tied inputs (n, d) -> (n,), and the limit that it is not to exceed."""

    name: str
    names: tuple[str, ...]
    laws: tuple[Law, ...]
    ties: list[Dependence]
    function: Callable[[Array], Array]
    limit: float


def _tied_models() -> list[TiedModel]:
    from tests.campaigns.chaos import MODELS as CHAOS

    normals, borehole = (make_law("normal", {"mean": 0.0, "sd": 1.0}),) * 3, CHAOS["borehole"]
    names = ("rw", "r", "Tu", "Hu", "Tl", "Hl", "L", "Kw")
    return [
        TiedModel("a + b + 0.3 c", ("a", "b", "c"), normals, _TIED_SUM, lambda x: x @ np.array([1.0, 1.0, 0.3]), 3.0),
        TiedModel("0.3 c + b + a", ("c", "b", "a"), normals, _TIED_SUM, lambda x: x @ np.array([0.3, 1.0, 1.0]), 3.0),
        TiedModel("borehole", names, borehole.laws, _TIED_BOREHOLE, borehole.function, 160.0),
    ]


def _brute(model: TiedModel, power: int = 18) -> dict[str, Any]:
    """Answers by 2^power Sobol' points, and every closed effect by as many pairs that share the inputs of a subset."""
    joint = make_joint(model.names, model.laws, model.ties)
    d, correlation = len(joint.names), joint.correlation
    assert correlation is not None
    uniforms = qmc.Sobol(2 * d, seed=7).random_base2(power)
    first, second = (np.asarray(ndtri(part)) for part in np.split(uniforms, 2, axis=1))

    def answers(z: Array) -> Array:
        y = model.function(np.column_stack([law.from_normal(z[:, k]) for k, law in enumerate(joint.laws)]))
        return np.stack([y, y > model.limit])

    z = first @ np.linalg.cholesky(correlation).T
    own = answers(z)
    mean, closed = own.mean(axis=1, keepdims=True), []
    for u in (u for size in range(d + 1) for u in combinations(range(d), size)):
        rest = [k for k in range(d) if k not in u]
        slopes = np.linalg.solve(correlation[np.ix_(u, u)], correlation[np.ix_(u, rest)])
        left = correlation[np.ix_(rest, rest)] - correlation[np.ix_(rest, u)] @ slopes
        moved = z.copy()
        moved[:, rest] = z[:, u] @ slopes + second[:, rest] @ np.linalg.cholesky(left).T
        there = answers(moved)
        # each form is exact at its own end
        low, high = (
            ((own - mean) * (there - mean)).mean(axis=1),
            own.var(axis=1) - 0.5 * ((own - there) ** 2).mean(axis=1),
        )
        closed.append((u, np.where(low < 0.5 * own.var(axis=1), low, high) if u else np.zeros(2)))
    shares = [shares_of({u: float(value[k]) for u, value in closed}, d) for k in range(2)]
    found = {
        "mean": {"y": float(mean[0, 0])},
        "sd": {"y": float(own[0].std())},
        "probability": {"y": float(mean[1, 0])},
    }
    for p in _QUANTILES:
        found[f"quantile {p:g}"] = {"y": float(np.quantile(own[0], p))}
    found |= {order: dict(zip(model.names, values, strict=True)) for order, values in shares[0].items()}
    return {**found, "Shapley effect of failure": dict(zip(model.names, shares[1]["shapley"], strict=True))}


def _run_of(model: TiedModel, seed: int) -> tuple[dict[str, dict[str, Any]], dict[str, float]]:
    """What a run prints, as `_brute` has it, and the shares that its failure hangs on."""
    study = uqsphere.load_study({
        "seed": seed, "inputs": dict(zip(model.names, model.laws, strict=True)), "outputs": {"names": ["y"]},
        "limits": {"high": {"quantity": "y", "strength": model.limit}},
        "dependence": [{"of": list(tie.of), "spearman": tie.spearman} for tie in model.ties],
        "analysis": {"cost": "1 us", "budget": {"evaluations": 100_000}, "quantiles": list(_QUANTILES)},
    })  # fmt: skip
    found = uqsphere.run(study, lambda x: {"y": model.function(np.column_stack([x[n] for n in model.names]))}).results
    y, shares, limit = found.quantities["y"], found.sensitivity["y"], found.limits["high"]
    told = {"mean": {"y": y.mean}, "sd": {"y": y.sd}, "probability": {"y": limit.miss}, "shapley": shares.shapley,
            **{f"quantile {p:g}": {"y": y.quantiles[f"{p:g}"]} for p in _QUANTILES},
            "first": shares.kucherenko.first, "total": shares.kucherenko.total,
            "Shapley effect of failure": limit.drivers.shapley}  # fmt: skip
    return told, dict(limit.governing_inputs or {})


def tied_text(runs: int) -> str:
    """How often the intervals of so many runs of each model hold what brute force says, and what failure hangs on."""
    rows, lines = [], []
    for model in _tied_models():
        truth = _brute(model)
        told = [_run_of(model, seed) for seed in range(1, 1 + runs)]
        tell(model.name)
        for kind, values in truth.items():
            cells = [(e, value) for one, _ in told for name, value in values.items()
                     if (e := one[kind].get(name)) is not None and e.value is not None]  # fmt: skip
            held = sum(e.low <= value <= e.high for e, value in cells)
            width = float(np.mean([0.5 * (e.high - e.low) for e, _ in cells])) if cells else math.nan
            rows.append((model.name, kind, f"{held} of {len(cells)}", f"{width:.2g}"))
        for name in model.names:
            shares = [shares.get(name, math.nan) for _, shares in told]
            lines.append(
                (
                    model.name,
                    name,
                    f"{min(shares):.3f} to {max(shares):.3f}",
                    f"{truth['shapley'][name]:.3f}",
                    f"{truth['Shapley effect of failure'][name]:.3f}",
                )
            )
    header = ("model", "input", "failure hangs on", "Shapley effect of the output", "of failure")
    return f"{table(('model', 'answer', 'held', 'half-width'), rows)}\n\n{table(header, lines)}"


def main(arguments: Sequence[str] | None = None) -> int:
    """All models with fitted laws; `--quick` has two of them, a few repetitions and the smaller size."""
    asked = options("coverage of the intervals of `uqsphere analyse`", arguments, quick=False,
                    repetitions=REPETITIONS, runs=int)  # fmt: skip
    if asked.runs:
        print(tied_text(asked.runs))
        return 0
    told: list[str] = []

    def notice(line: str) -> None:
        told.append(line)
        tell(line)

    few: dict[str, Any] = {"repetitions": 2, "models": ("linear", "linear, Gaussian ties"), "sizes": SIZES[:1]}
    rows = given_rows(**(few if asked.quick else {"repetitions": asked.repetitions}), known=(False,),
                      first_seed=FIRST_SEED, notice=notice)  # fmt: skip
    print(given_text(rows, told))
    return 0


if __name__ == "__main__":
    sys.exit(main())
