"""Analyses of plain arrays: what the runs of this package do, for rows and models of one's own.

Three ways of calling, always in this order:

* of rows that are there: `f(x, y, inputs)` with x (n, d), y (n,) and the laws of the inputs;
* of a model that is called: `f(model, inputs)`, the model taking a dict of name -> (n,) and giving (n,);
* of observations: `f(values)`.

`inputs` maps names to laws: of this package, their tables as in a study (`{"dist": "normal", "mean": 0, "sd": 1}`),
or frozen distributions of scipy.stats or chaospy; `joint` ties them.  Every number comes as an `Estimate` with its 95 %
interval; units are those of what is given.  All raise UsageError for arrays that do not go together, values that are
not finite, and laws that cannot be made.

>>> import numpy as np
>>> from scipy import stats
>>> inputs = {"a": stats.norm(), "b": stats.norm()}
>>> x = np.random.default_rng(1).normal(size=(200, 2))
>>> found = sobol_indices(x, x[:, 0] + 2.0 * x[:, 1], inputs)
>>> round(found["first"]["b"].value, 6)
0.8
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.errors import UsageError
from uqsphere.given.answers import variance_shares
from uqsphere.uq import (
    Dependence,
    Estimate,
    Joint,
    LimitState,
    beyond_variance,
    curve,
    random_generator,
    sobol_points,
    tails,
    tolerance,
)
from uqsphere.uq.curve import LognormalCurve
from uqsphere.uq.estimate import REPLICATES
from uqsphere.uq.fitting import STRENGTHS, StrengthFit, fit_strength, make_tests
from uqsphere.uq.foreign import LawLike, as_law, joint_of
from uqsphere.uq.surrogate import Surrogate, fit_surrogate, load_surrogate

__all__ = [
    "Failure",
    "Fragility",
    "chaos",
    "delta_indices",
    "failure_probability",
    "fragility",
    "joint",
    "kucherenko_indices",
    "load_surrogate",
    "lognormal_fit",
    "pawn_indices",
    "rank_indices",
    "shapley_effects",
    "sobol_indices",
    "tolerance_interval",
    "weibull_fit",
]


def __dir__() -> list[str]:
    return sorted(__all__)


#: named laws, or what `joint` made of them
Inputs: TypeAlias = Joint | Mapping[str, LawLike]
#: dict of name -> (n,) in, (n,) out
Model: TypeAlias = Callable[[dict[str, Array]], npt.ArrayLike]
#: indices of every input by their order: {"first": {"a": Estimate, ...}, ...}
Indices: TypeAlias = dict[str, dict[str, Estimate]]

#: evaluations up to which a model is dear: active learning in place of sampling
_DEAR: Final = 1000


@contextlib.contextmanager
def _refusing() -> Iterator[None]:
    """What laws and arrays refuse is a fault of the caller; one thread of linear algebra, as in a run."""
    from threadpoolctl import threadpool_limits

    try:
        with threadpool_limits(limits=1, user_api="blas"):
            yield
    except ValueError as error:
        raise UsageError(str(error)) from error


def joint(
    laws: Mapping[str, LawLike], spearman: Mapping[tuple[str, ...], float] | None = None, *, copula: str = "gaussian"
) -> Joint:
    """Named laws that depend on each other.

    Parameters
    ----------
    laws : mapping of name to law
    spearman : mapping of names to their rank correlation, which holds for every pair of the names
    copula : "gaussian", "student_t", "clayton", "gumbel", "frank" or "joe", as in a study's `[[dependence]]`

    >>> joint({"a": {"dist": "normal", "mean": 0, "sd": 1}, "b": {"dist": "normal", "mean": 0, "sd": 1}},
    ...       {("a", "b"): 0.6}).dependent
    True
    """
    with _refusing():
        ties = [Dependence(of=tuple(of), spearman=value, copula=copula) for of, value in (spearman or {}).items()]
        return joint_of(laws, ties)


def _joint(inputs: Inputs) -> Joint:
    with _refusing():
        return joint_of(inputs)


def _arrays(x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[Array, Array]:
    with _refusing():
        rows, values = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if rows.ndim != 2 or values.shape != rows.shape[:1]:
        raise UsageError(f"x (n, d) and y (n,) are due, found {rows.shape} and {values.shape}")
    if not (np.isfinite(rows).all() and np.isfinite(values).all()):
        raise UsageError("x and y must be finite: leave rows without an answer out")
    return rows, values


# --- rows that are there ----------------------------------------------------------------------------------------


def chaos(x: npt.ArrayLike, y: npt.ArrayLike, inputs: Inputs, *, plain: bool = False, seed: int = 0) -> Surrogate:
    """A sparse polynomial chaos expansion of y (n,) at rows x (n, d), with intervals, indices and its own domain.

    Bases, solvers and transforms compete by their error on rows left out (G. Blatman, B. Sudret, J. Comput. Phys. 230,
    2011, 2345; docs/theory.md); eight fits, each without an eighth of the rows, tell what it is off by.

    Parameters
    ----------
    x, y : (n, d) rows drawn from the laws of the inputs, and (n,) answers, n at least 16 and 4 (d + 1)
    inputs : mapping of name to law, in the order of the columns of x, or a `Joint`
    plain : expand y itself, in one piece: what `Surrogate.to_chaospy` takes
    seed : of the order in which rows are dealt into folds

    Returns
    -------
    Surrogate
        With `predict`, `indices`, `save`, `to_chaospy`; `response.usable` and `response.error` say how good it is.
    """
    rows, values = _arrays(x, y)
    order = random_generator(seed=seed, task="chaos rows").permutation(len(values))
    with _refusing():
        return fit_surrogate(rows[order], values[order], _joint(inputs), plain=plain)


def _usable(x: npt.ArrayLike, y: npt.ArrayLike, inputs: Inputs, seed: int) -> Surrogate:
    found = chaos(x, y, inputs, seed=seed)
    if not found.response.usable:
        raise UsageError(f"no indices from these rows: {found.response.reason}; give more, or use rank_indices")
    return found


def sobol_indices(x: npt.ArrayLike, y: npt.ArrayLike, inputs: Inputs, *, seed: int = 0) -> Indices:
    """First and total Sobol' indices of independent inputs, {"first": {input: Estimate}, "total": ...}.

    By an expansion whose residuals correct them (docs/theory.md).  Raises UsageError besides where the expansion
    leaves more than 5 % of the variance, and for inputs that depend on each other.
    """
    found = _usable(x, y, inputs, seed)
    with _refusing():
        return found.indices()


def shapley_effects(x: npt.ArrayLike, y: npt.ArrayLike, inputs: Inputs, *, seed: int = 0) -> dict[str, Estimate]:
    """Shapley effects of inputs that may depend on each other: shares of the variance that sum to 1.

    All subsets on the expansion (E. Song, B. L. Nelson, J. Staum, SIAM/ASA J. Uncertainty Quantification 4, 2016,
    1060), with what the expansion lacks.  Raises UsageError as `sobol_indices`.
    """
    return _shares(x, y, inputs, seed)["shapley"]


def kucherenko_indices(x: npt.ArrayLike, y: npt.ArrayLike, inputs: Inputs, *, seed: int = 0) -> Indices:
    """First and total indices of inputs that depend on each other; a total may lie below its first.

    S. Kucherenko, S. Tarantola, P. Annoni, Computer Physics Communications 183, 2012, 937; by the expansion, as
    `shapley_effects`.
    """
    found = _shares(x, y, inputs, seed)
    return {order: found[order] for order in ("first", "total")}


def _shares(x: npt.ArrayLike, y: npt.ArrayLike, inputs: Inputs, seed: int) -> Indices:
    found = _usable(x, y, inputs, seed)
    with _refusing():
        answers = variance_shares(found.response, _joint(inputs), None, seed, "analysis")
    return {order: {name: answer.whole for name, answer in row.items()} for order, row in answers.items()}


def _dealt(x: npt.ArrayLike, y: npt.ArrayLike, names: Sequence[str] | None) -> tuple[Array, Array, list[str]]:
    """Rows as (R, n/R, d) and (R, n/R): what is left over is left out."""
    rows, values = _arrays(x, y)
    n = len(values) // REPLICATES
    kept = n * REPLICATES
    called = [f"x{k + 1}" for k in range(rows.shape[1])] if names is None else list(names)
    if len(called) != rows.shape[1]:
        raise UsageError(f"{rows.shape[1]} names are due, found {len(called)}")
    return rows[:kept].reshape(REPLICATES, n, -1), values[:kept].reshape(REPLICATES, n), called


def delta_indices(x: npt.ArrayLike, y: npt.ArrayLike, inputs: Sequence[str] | None = None) -> dict[str, Estimate]:
    """Borgonovo's delta of every input: how far fixing it shifts the law of y, 0 to 1.

    E. Borgonovo, Reliability Engineering & System Safety 92, 2007, 771.  From 256 independent rows x (n, d), y (n,) on;
    fewer are absent estimates.  `inputs` are names (or a mapping by them); laws are not needed.
    """
    rows, values, names = _dealt(x, y, None if inputs is None else list(inputs))
    with _refusing():
        return dict(zip(names, beyond_variance.delta_estimates(rows, values), strict=True))


def pawn_indices(
    x: npt.ArrayLike, y: npt.ArrayLike, inputs: Sequence[str] | None = None, *, seed: int = 0
) -> tuple[dict[str, Estimate], float]:
    """PAWN of every input, and the value below which an input without any effect stays in 95 of 100 cases.

    F. Pianosi, T. Wagener, Environmental Modelling & Software 67, 2015, 1.  Rows as of `delta_indices`.
    """
    rows, values, names = _dealt(x, y, None if inputs is None else list(inputs))
    with _refusing():
        found = beyond_variance.pawn_estimates(rows, values, seed=seed)
    return dict(zip(names, found.inputs, strict=True)), found.threshold


def rank_indices(
    x: npt.ArrayLike, y: npt.ArrayLike, inputs: Sequence[str] | None = None, *, seed: int = 0
) -> dict[str, Estimate]:
    """First-order index of every input by sorting the rows, without an expansion or a law.

    F. Gamboa, P. Gremaud, T. Klein, A. Lagnoux, Bernoulli 28, 2022, 2345.  Independent rows x (n, d), y (n,).
    """
    rows, values = _arrays(x, y)
    names = [f"x{k + 1}" for k in range(rows.shape[1])] if inputs is None else list(inputs)
    generator = random_generator(seed=seed, task="rank indices")
    with _refusing():
        return dict(zip(names, beyond_variance.rank_indices(rows, values, generator), strict=True))


# --- a model that is called -------------------------------------------------------------------------------------


def _called(model: Model, given: Joint, x: Array) -> Array:
    """The model's answers (n,) to points (n, d)."""
    columns = {name: np.ascontiguousarray(x[:, k]) for k, name in enumerate(given.names)}
    found = model(columns)
    if isinstance(found, Mapping):
        if len(found) != 1:
            raise UsageError(f"the model answers {', '.join(found)}: one output is due")
        found = next(iter(found.values()))
    values = np.asarray(found, dtype=float)
    if values.shape != (len(x),):
        raise UsageError(f"the model must answer {len(x)} rows with ({len(x)},) values, found {values.shape}")
    return values


@dataclass(frozen=True, kw_only=True)
class Failure:
    """The probability that the limit function is negative.

    `sure`: whether independent searches agree, so that the interval may be believed; `warning` says why not.
    `design_point`: the most probable failure, by input in its own unit; empty where none was found.
    """

    probability: Estimate
    sure: bool
    warning: str
    design_point: Mapping[str, float]


def failure_probability(
    limit: Model, inputs: Inputs, *, evaluations: int = 30_000, accuracy: float = 0.015, seed: int = 0
) -> Failure:
    """Probability of limit(rows) < 0 for inputs of these laws, dependent or not.

    Design points, subset simulation and importance sampling that certify each other (docs/theory.md); kriging that
    learns where to look next with up to 1,000 evaluations.

    Parameters
    ----------
    limit : callable, dict of name -> (n,) in, (n,) out; NaN is refused
    inputs : mapping of name to law, or a `Joint`
    evaluations : the most that may be spent
    accuracy : half-width of the 95 % interval over the probability at which it ends
    """
    from uqsphere.uq.rare.active import learn_probability
    from uqsphere.uq.rare.auto import find_probability
    from uqsphere.uq.rare.problem import FailedEvaluation, LimitFunction, Spent

    given = _joint(inputs)
    function = LimitFunction(function=lambda z: _called(limit, given, given.physical(z)), dimension=len(given.names))
    try:
        with _refusing():
            if evaluations <= _DEAR:
                learned = learn_probability(function, seed=seed, budget=evaluations, accuracy=accuracy)
                probability, warning, design = learned.estimate, learned.warning, learned.design
            else:
                found = find_probability(function, seed=seed, accuracy=accuracy, budget=evaluations)
                probability, design = found.estimate, found.design
                warning = "" if found.agreed else "; ".join(found.checks)
    except FailedEvaluation as error:
        raise UsageError(str(error)) from error
    except Spent as error:
        raise UsageError(f"{evaluations} evaluations are too few for {len(given.names)} inputs") from error
    nearest = None if design is None or not design.points else design.points[0].point
    at = {} if nearest is None else dict(zip(given.names, given.physical(nearest[None, : len(given.names)])[0].tolist(),
                                             strict=True))  # fmt: skip
    return Failure(probability=probability, sure=not warning, warning=warning, design_point=at)


@dataclass(frozen=True, kw_only=True)
class Fragility:
    """A fragility curve: `curve` (K, 4) of level, probability and its ends; `values` are levels by probability.

    `lognormal` is the nearest lognormal curve with its gap, None where there is none.
    """

    curve: Array
    values: Mapping[float, Estimate]
    lognormal: LognormalCurve | None


def fragility(
    model: Model,
    inputs: Inputs,
    *,
    free: str,
    levels: npt.ArrayLike,
    strength: LawLike | float,
    probabilities: Sequence[float] = (0.05, 0.5, 0.95),
    evaluations: int = 100_000,
    seed: int = 0,
) -> Fragility:
    """Probability that the model's answer exceeds a strength, over levels of one more input.

    The strength is integrated exactly, and the same points serve every level, so that the curve is smooth.

    Parameters
    ----------
    model : callable, dict of name -> (n,), the free one among them, in, (n,) out
    inputs : mapping of name to law, or a `Joint`: what scatters besides
    free : name of the input that is set to the levels
    levels : (K,) increasing values of it
    strength : law, or the strength itself, in the unit of the answer
    probabilities : at which the level is wanted
    evaluations : spent on all levels together
    """
    given = _joint(inputs)
    if free in given.names:
        raise UsageError(f"{free} is free and cannot scatter besides")
    grid = np.asarray(levels, dtype=float)
    with _refusing():
        law = float(strength) if isinstance(strength, (int, float)) else as_law(strength)
        count = max(evaluations // (REPLICATES * max(grid.size, 1)), 8)
        points = np.concatenate([_normals(len(given.names), count, replicate, seed) for replicate in range(REPLICATES)])
        x = given.physical(points)
        rows = []
        for level in grid:
            answers = _called(partial(_at_level, model, free, float(level)), given, x)
            if not np.isfinite(answers).all():
                raise UsageError(f"the model has no finite answer at {free} = {level:g}")
            state = LimitState(demands=answers.reshape(REPLICATES, count), strength=law)
            rows.append(tails(state)[0].mean(axis=1))
        table, spent = np.array(rows), grid.size * len(x)
        found = curve.fragility(grid, table, probabilities, samples=count, evaluations=spent)
        near = curve.fit_lognormal_curve(grid, table, evaluations=spent)
    return Fragility(
        curve=np.array(found.curve), values=found.values, lognormal=None if isinstance(near, str) else near
    )


def _at_level(model: Model, free: str, level: float, columns: dict[str, Array]) -> npt.ArrayLike:
    """The model's answers with its free input at a level."""
    n = len(next(iter(columns.values())))
    return model({**columns, free: np.full(n, level)})


def _normals(dimension: int, count: int, replicate: int, seed: int) -> Array:
    from scipy.special import ndtri

    points = sobol_points(dimension=dimension, count=count, seed=seed, task="fragility", replicate=replicate)
    return np.asarray(ndtri(points))


# --- observations -----------------------------------------------------------------------------------------------


def weibull_fit(values: npt.ArrayLike, stopped: npt.ArrayLike | None = None) -> StrengthFit:
    """The two-parameter Weibull law of strengths (n,), some of whose tests were stopped before failure (n,).

    Largest likelihood, the factor that takes its bias out, and intervals of 95 % that hold for any n (D. R. Thoman,
    L. J. Bain, C. E. Antle, Technometrics 11, 1969, 445; ISO 20501): `shape` the modulus, `scale` in the values' unit.
    """
    with _refusing():
        return fit_strength(make_tests(values, stopped), STRENGTHS["weibull"])


def lognormal_fit(values: npt.ArrayLike, stopped: npt.ArrayLike | None = None) -> StrengthFit:
    """The lognormal law of strengths (n,), as `weibull_fit`: `shape` is the sd of the logarithm, `scale` the median."""
    with _refusing():
        return fit_strength(make_tests(values, stopped), STRENGTHS["lognormal"])


def tolerance_interval(
    values: npt.ArrayLike, *, coverage: float = 0.95, confidence: float = 0.95
) -> tolerance.ToleranceLimits:
    """Limits between which at least the share `coverage` of the law lies, at least with this confidence, for any law.

    Order statistics of independent values (n,) (S. S. Wilks, Ann. Math. Statist. 12, 1941, 91): `upper`, `lower`, and
    `between`; absent with a reason where n is too small (59, and 93 for both, at 95 % and 95 %).
    """
    found = np.asarray(values, dtype=float)
    if found.ndim != 1 or not np.isfinite(found).all():
        raise UsageError(f"finite values (n,) are due, found an array of shape {found.shape}")
    with _refusing():
        return tolerance.tolerance_limits(found, coverage=coverage, confidence=confidence)
