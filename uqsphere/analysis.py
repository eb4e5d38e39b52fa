"""Analyses of plain arrays and tables: what the runs of this package do, for rows and models of
one's own.

* of rows that are there: `f(x, y, inputs)` with x (n, d) or a table by the inputs' names, y (n,),
    and their laws;
* of a model that is called: `f(model, inputs)`, the model taking a dict of name -> (n,) and giving
    (n,);
* of strengths from tests: `f(values, stopped)`.

`inputs` maps names to laws: of this package, their tables as in a study (`{"dist": "normal",
"mean": 0, "sd": 1}`), distributions of scipy.stats or chaospy, observations, or a problem dict of
SALib; `joint` ties them.  Every number is an `Estimate` with its 95 % interval; results have
`to_frame()`; units are those of what is given.  All raise UsageError for arrays that do not go
together, values that are not finite, and laws that cannot be made.

>>> import numpy as np
>>> from scipy import stats
>>> inputs = {"a": stats.norm(), "b": stats.norm()}
>>> x = np.random.default_rng(1).normal(size=(200, 2))
>>> indices = sobol_indices(x, x[:, 0] + 2.0 * x[:, 1], inputs)
>>> round(indices["first"]["b"].value, 6)
0.8
"""

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from uqsphere.arrays import Array, Pair, as_numbers, frozen, one_thread, special
from uqsphere.errors import UsageError, as_text
from uqsphere.models.black_box import by_index
from uqsphere.uq import Dependence, Estimate, Joint, LimitState, curve, rare, sobol_points
from uqsphere.uq.estimate import REPLICATES
from uqsphere.uq.fitting import STRENGTHS, StrengthFit, make_tests
from uqsphere.uq.foreign import LawLike, as_law, joint_of
from uqsphere.uq.rows import (
    LARGEST_ANSWER,
    SMALLEST_ANSWER,
    as_answers,
    check_rows,
    numbers_in,
    too_small,
)
from uqsphere.uq.surrogate import (
    Expansion,
    columns_of,
    each_once,
    fit_expansion,
    in_order_of,
    index_of,
)

if TYPE_CHECKING:
    from pandas import DataFrame

__all__ = [
    "Answers",
    "Expansion",
    "Failure",
    "Fragility",
    "chaos",
    "failure_probability",
    "fragility",
    "joint",
    "lognormal_fit",
    "sobol_indices",
    "weibull_fit",
]

#: named laws, a problem dict of SALib, or what `joint` made of them
Inputs: TypeAlias = Joint | Mapping[str, LawLike]
#: dict of name -> (n,) in, (n,) out
Model: TypeAlias = Callable[[dict[str, Array]], Any]


@contextlib.contextmanager
def _refusing() -> Iterator[None]:
    """What laws and arrays refuse is a fault of the caller; one thread of linear algebra, as in a
    run.
    """
    try:
        with one_thread():
            yield
    except (ValueError, TypeError) as error:
        raise UsageError(str(error)) from error


class Answers(dict[Any, Any]):
    """Estimates by name or probability; indices by order, then input."""

    def __repr__(self) -> str:
        return self.to_frame()[["order", "name", "value", "low", "high"]].to_string(index=False)

    def to_frame(self) -> "DataFrame":
        """One row for each estimate: order and name, value, low, high, std_error, evaluations,
        method, reason.
        """
        from pandas import DataFrame

        columns = ["order", "name", "value", "low", "high", "std_error"]
        columns += ["evaluations", "method", "reason"]
        rows = []
        for key, content in self.items():
            order, estimates = (key, content) if isinstance(content, dict) else ("", {key: content})
            rows += [
                {"order": order, "name": name, **vars(estimate)}
                for name, estimate in estimates.items()
            ]
        return DataFrame(rows, columns=columns)


def joint(
    laws: Mapping[str, LawLike],
    spearman: Mapping[tuple[str, ...], float] | None = None,
    *,
    copula: str = "gaussian",
    dof: float | None = None,
) -> Joint:
    """Named laws that depend on each other.

    Parameters
    ----------
    laws : law of each input by its name
    spearman : rank correlation by names, for every pair of them
    copula : "gaussian" or "student_t"
    dof : degrees of freedom of a Student t copula

    Returns
    -------
    The joint law, which every analysis takes in place of a mapping of laws.

    Raises
    ------
    UsageError
        For laws that cannot be made, and correlations that cannot hold together.

    >>> normal = {"dist": "normal", "mean": 0, "sd": 1}
    >>> joint({"a": normal, "b": normal},
    ...       {("a", "b"): 0.6}).dependent
    True
    """
    with _refusing():
        ties = [
            Dependence(of=tuple(of), spearman=rho, copula=copula, dof=dof)
            for of, rho in (spearman or {}).items()
        ]
        return joint_of(laws, ties)


def _arrays(x: Any, y: Any, laws: Joint) -> Pair:
    """x (n, d) in the order of the inputs and y (n,), matched by names and by index."""
    rows = columns_of(x, laws.names)
    y = as_answers(y)
    if hasattr(y, "reindex"):
        index = index_of(x, laws.names)
        if index is None:
            index = range(len(rows))
        y = in_order_of(y, index, "y")
    values = numbers_in(y, "y")
    if values.shape != rows.shape[:1]:
        raise UsageError(f"x (n, d) and y (n,) are required, found {rows.shape} and {values.shape}")
    if not np.isfinite(values).all():
        raise UsageError("y must be finite: leave rows without an answer out")
    if too_small(values) or np.abs(values).max(initial=0.0) > LARGEST_ANSWER:
        raise UsageError(
            f"y must lie between {SMALLEST_ANSWER:g} and {LARGEST_ANSWER:g}: give it in another "
            "unit"
        )
    check_rows(rows, laws)
    return each_once(rows, values)


# --- rows that are there --------------------------------------------------------------------------


def chaos(x: Any, y: Any, inputs: Inputs, *, plain: bool = False, seed: int = 0) -> Expansion:
    """A sparse polynomial chaos expansion, with intervals, indices and chaospy's objects.

    Sets of terms and the logarithm of y compete by their error on rows left out; eight fits, each
    without an eighth of the rows, estimate its error: `response.error`, `response.reason`.

    Parameters
    ----------
    x : rows (n, d) drawn from the laws of the inputs, by their names or in their order, n >= 16
    y : answers (n,)
    inputs : mapping of name to law, or a `Joint`
    plain : expand y itself, never its logarithm
    seed : of the order in which rows are split into folds

    Returns
    -------
    The expansion in the units of x and y.

    Raises
    ------
    UsageError
        For arrays that do not go together, values that are not finite, too few rows, and rows that
        do not follow the laws.

    Source
    ------
    G. Blatman, B. Sudret, J. Comput. Phys. 230, 2011, 2345 (sparse expansions by regression);
    docs/theory.md section 11.

    >>> x = np.random.default_rng(1).normal(size=(64, 1))
    >>> expansion = chaos(x, x[:, 0] ** 2, {"a": {"dist": "normal", "mean": 0, "sd": 1}})
    >>> expansion.predict({"a": [3.0]}).value.round(6).tolist()
    [9.0]
    """
    with _refusing():
        laws = joint_of(inputs)
        rows, values = _arrays(x, y, laws)
        return fit_expansion(rows, values, laws, plain=plain, seed=seed)


def sobol_indices(x: Any, y: Any, inputs: Inputs, *, seed: int = 0) -> Answers:
    """Sobol' indices from rows that are there, by an expansion whose residuals correct them.

    An event rarer than 3/n, which n rows cannot show, is in no interval: the method of every
    estimate says so.

    Parameters
    ----------
    x : rows (n, d) drawn from the laws of the inputs, by their names or in their order, n >= 16
    y : answers (n,)
    inputs : mapping of name to law, or a `Joint`
    seed : of the order in which rows are split into folds

    Returns
    -------
    {"first": {input: Estimate}, "total": {input: Estimate}}; of inputs that depend on each other
    Kucherenko's indices, and {"shapley": ...}.

    Raises
    ------
    UsageError
        As `chaos`, and for dependent inputs whose expansion leaves more than 25 % of the variance.

    Source
    ------
    I. M. Sobol', Math. Comput. Simul. 55, 2001, 271; S. Kucherenko, S. Tarantola, P. Annoni,
    Comput. Phys. Commun. 183, 2012, 937; A. B. Owen, SIAM/ASA J. Uncertain. Quantif. 2, 2014, 245.
    """
    expansion = chaos(x, y, inputs, seed=seed)
    if expansion.joint.dependent and not expansion.response.usable:
        raise UsageError(
            f"no indices from these rows: {expansion.response.reason}; give more rows, or call the "
            "model"
        )
    with _refusing():
        return Answers(expansion.indices())


# --- a model that is called -----------------------------------------------------------------------


#: rows that tell whether a model that raises does so at every row
PROBES = 3


def _called(model: Model, columns: dict[str, Array], probed: bool = False) -> Array:
    """The model's answers (n,), in halves where it raises; a row at which it raises is nan.

    probed : whether it is known to answer some row by itself.

    Raises UsageError for what is no model, answers in another form, or raises at each of a few
        rows.
    """
    if not callable(model):
        raise UsageError(
            f"a model is a function of a dict of name -> (n,), not {type(model).__name__}"
        )
    n = len(next(iter(columns.values())))

    def of_rows(start: int, end: int) -> Array:
        part = {name: column[start:end] for name, column in columns.items()}
        return _called(model, part, probed=True)

    try:
        return _checked(model(columns), n)
    except UsageError:
        raise
    except Exception as error:
        if n == 1 and probed:
            return np.array([np.nan])
        places = np.linspace(0, n - 1, PROBES).astype(int)
        if not probed and not any(np.isfinite(of_rows(k, k + 1)).any() for k in places):
            raise UsageError(
                f"the model raises at each of {PROBES} rows: {type(error).__name__}: "
                f"{as_text(error)}"
            ) from error
        return np.concatenate([of_rows(0, n // 2), of_rows(n // 2, n)])


def _checked(answers: Any, n: int) -> Array:
    """What a model answered to n rows as (n,) real numbers."""
    if isinstance(answers, Mapping) or hasattr(answers, "columns"):
        names = list(answers)
        if len(names) != 1:
            raise UsageError(
                f"the model answers {', '.join(map(str, names))}: one output is required"
            )
        answers = answers[names[0]]
    cells = np.asanyarray(by_index(answers, n))
    if cells.dtype.kind not in "fiu":
        raise UsageError(f"the model must answer with real numbers, found {cells.dtype}")
    values = np.ma.filled(cells.astype(float), np.nan)
    if values.shape != (n,):
        raise UsageError(f"the model must answer {n} rows with ({n},) values, found {values.shape}")
    return values


def _shown(e: Estimate) -> str:
    text = "no value"
    if e.value is not None:
        text = f"{e.value:.4g}"
    if e.low is None or e.high is None:
        return text
    return f"{text} ({e.low:.4g} to {e.high:.4g})"


@frozen
class Failure:
    """The probability that the limit function is negative.

    `sure`: whether independent searches agree, so that the interval may be believed; `warning` says
    why not. `design_point`: the most probable failure, by input in its own unit; empty where none
    was found.
    """

    probability: Estimate
    sure: bool
    warning: str
    design_point: Mapping[str, float]

    def __repr__(self) -> str:
        return (
            f"<Failure: {_shown(self.probability)}, {'sure' if self.sure else 'not sure'}, "
            f"{self.probability.evaluations:,} model runs>"
        )

    def to_frame(self) -> "DataFrame":
        """One row: the probability, whether it is sure, the warning, and the design point by
        input.
        """
        frame = Answers(failure_probability=self.probability).to_frame()
        point = {f"design_point.{name}": value for name, value in self.design_point.items()}
        return frame.assign(sure=self.sure, warning=self.warning, **point)


def failure_probability(
    limit: Model,
    inputs: Inputs,
    *,
    evaluations: int = 30_000,
    accuracy: float = 0.015,
    on_failure: str = "bound",
    seed: int = 0,
) -> Failure:
    """Probability of limit(rows) < 0 for inputs of these laws, dependent or not.

    Design points, subset simulation and importance sampling certify each other.  With fewer than
    5,000 evaluations and up to ten inputs, kriging answers, corrected by fresh calls; nothing is
    sure then.  A tenth of the evaluations is a plain sample: `high_unseen` of the probability also
    allows for failures that no search has aimed at.  The model is not called beyond 9 standard
    deviations.

    Parameters
    ----------
    limit : dict of name -> (n,) in, (n,) out
    inputs : mapping of name to law, or a `Joint`
    evaluations : the most that may be spent
    accuracy : half-width of the 95 % interval over the probability at which it ends
    on_failure : rows that are nan, or raise, count into the ends ("bound") or raise UsageError
        ("refuse")
    seed : of all random numbers

    Returns
    -------
    The probability with its interval, whether it is sure, and the design point in the inputs'
    units.

    Raises
    ------
    UsageError
        For a limit function that raises or answers in another form, and as `on_failure` says.

    Source
    ------
    R. Rackwitz, B. Fiessler, Comput. Struct. 9, 1978, 489 (design points); S. K. Au, J. L. Beck,
    Probab. Eng. Mech. 16, 2001, 263 (subset simulation); N. Kurtz, J. Song, Struct. Saf. 42, 2013,
    35 (mixtures); B. Echard, N. Gayton, M. Lemaire, Struct. Saf. 33, 2011, 145 (kriging).

    >>> normal = {"dist": "normal", "mean": 0, "sd": 1}
    >>> risk = failure_probability(lambda rows: 4.0 - rows["a"], {"a": normal})
    >>> risk.sure, f"{risk.probability.value:.1e}", round(risk.design_point["a"], 3)
    (True, '3.2e-05', 4.0)
    """
    if not (accuracy > 0.0 and evaluations >= 1):
        raise UsageError(
            f"accuracy and evaluations must be positive, found {accuracy} and {evaluations}"
        )
    if on_failure not in ("refuse", "bound"):
        raise UsageError(f"on_failure must be refuse or bound here, found {on_failure!r}")
    with _refusing():
        laws = joint_of(inputs)

        def function(z: Array) -> Array:
            values = _called(limit, dict(zip(laws.names, laws.physical(z).T.copy(), strict=True)))
            if on_failure == "refuse" and np.isnan(values).any():
                raise UsageError(
                    f"the limit function is nan at {np.isnan(values).sum()} of {len(z)} points"
                )
            return values

        search = rare.failure_probability(
            rare.Evaluator(function, len(laws.names), budget=evaluations, seed=seed),
            accuracy=accuracy,
        )
    point = {}
    for nearest in search.points[:1]:
        numbers = laws.physical(nearest.point[None])[0].tolist()
        point = dict(zip(laws.names, numbers, strict=True))
    return Failure(
        probability=search.estimate, sure=search.sure, warning=search.warning, design_point=point
    )


@frozen
class Fragility:
    """A fragility curve: `curve` (K, 4) of level, probability and its ends; `values` are the levels
    at 5, 50 and 95 %.

    `shares` (K, R) are the probabilities of R replicates of `samples` points each.
    """

    curve: Array
    values: Mapping[float, Estimate]
    shares: Array
    samples: int

    def level(self, probability: float) -> Estimate:
        """The level at which the probability of exceedance is this one, between 0 and 1; absent
        where the curve does not pass through it.
        """
        if not 0.0 < probability < 1.0:
            raise UsageError(f"a probability lies between 0 and 1, found {probability}")
        levels = self.curve[:, 0]
        fitted = curve.fragility(levels, self.shares, [probability], samples=self.samples)
        return fitted.values[probability]

    def __repr__(self) -> str:
        levels = "; ".join(
            f"{100.0 * p:g} % at {_shown(level)}" for p, level in self.values.items()
        )
        return f"<Fragility at {len(self.curve)} levels: {levels}>"

    def to_frame(self) -> "DataFrame":
        """The curve: level, value, low, high."""
        from pandas import DataFrame

        return DataFrame(self.curve, columns=["level", "value", "low", "high"])


def fragility(
    model: Model,
    inputs: Inputs,
    *,
    levels: Mapping[str, ArrayLike],
    strength: LawLike | float,
    evaluations: int = 100_000,
    seed: int = 0,
) -> Fragility:
    """Probability that the model's answer exceeds a strength, over levels of one more input.

    The strength is integrated exactly, and the same points serve every level, so that the curve is
    smooth.

    Parameters
    ----------
    model : dict of name -> (n,) in, (n,) out
    inputs : mapping of name to law, or a `Joint`
    levels : {name: values (K,), increasing} of the input that is set to them
    strength : law, or the strength itself, in the unit of the answer
    evaluations : spent on all levels together
    seed : of the points

    Returns
    -------
    The curve; `level(p)` is the level at another probability.

    Raises
    ------
    UsageError
        For several free inputs, levels that do not increase, and a model without a finite answer.

    >>> curve = fragility(
    ...     lambda rows: rows["speed"] + rows["a"],
    ...     {"a": {"dist": "normal", "mean": 0, "sd": 1}},
    ...     levels={"speed": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]},
    ...     strength=4.0,
    ... )
    >>> round(curve.level(0.5).value, 2)
    4.0
    """
    with _refusing():
        if len(levels) != 1:
            raise UsageError(f"one free input is required, found {', '.join(levels) or 'none'}")
        laws, (free, values) = joint_of(inputs), *levels.items()
        grid = as_numbers(values)
        if free in laws.names:
            raise UsageError(f"{free} is free and cannot scatter besides")
        law = float(strength) if isinstance(strength, int | float) else as_law(strength)
        if isinstance(law, float) and not math.isfinite(law):
            raise UsageError(f"the strength must be a finite number or a law, found {law}")
        count = max(evaluations // (REPLICATES * max(grid.size, 1)), 8)
        points = [
            sobol_points(len(laws.names), count, seed=seed, task="fragility", replicate=r)
            for r in range(REPLICATES)
        ]
        x = laws.physical(special.ndtri(np.concatenate(points)))
        columns = dict(zip(laws.names, x.T.copy(), strict=True))
        rows = []
        for level in grid:
            answers = _called(model, {**columns, free: np.full(len(x), level)})
            if not np.isfinite(answers).all():
                raise UsageError(f"the model has no finite answer at {free} = {level:g}")
            state = LimitState(demands=answers.reshape(REPLICATES, count), strength=law)
            rows.append(state.tails()[0].mean(axis=1))
        shares = np.array(rows)
        fitted = curve.fragility(grid, shares, (0.05, 0.5, 0.95), samples=count)
        return Fragility(
            curve=np.array(fitted.curve)[:, :4], values=fitted.values, shares=shares, samples=count
        )


# --- strengths from tests -------------------------------------------------------------------------


def weibull_fit(
    values: ArrayLike, stopped: ArrayLike | None = None, counts: ArrayLike | None = None
) -> StrengthFit:
    """The two-parameter Weibull law of strengths, by the largest likelihood.

    Parameters
    ----------
    values : strengths (n,), positive, in any unit
    stopped : whether a test was stopped before failure (n,), none by default
    counts : how many equal tests each value stands for (n,), 1 by default

    Returns
    -------
    `shape` the modulus, `unbiased` the modulus without its bias, `scale` (63.2 %) in the values'
    unit, with 95 % intervals that hold for any n.

    Raises
    ------
    UsageError
        For values that are no strengths, and fewer than two different failures.

    Source
    ------
    D. R. Thoman, L. J. Bain, C. E. Antle, Technometrics 11, 1969, 445.

    >>> fit = weibull_fit([0.62, 0.81, 0.93, 1.02, 1.1, 1.21, 1.3], [0, 0, 0, 0, 0, 0, 1])
    >>> round(fit.shape, 2), round(fit.scale, 3)
    (4.66, 1.108)
    """
    return _fitted(values, stopped, counts, "weibull")


def lognormal_fit(
    values: ArrayLike, stopped: ArrayLike | None = None, counts: ArrayLike | None = None
) -> StrengthFit:
    """The lognormal law of strengths, by the largest likelihood.

    Parameters, errors and intervals are those of `weibull_fit`.

    Returns
    -------
    `shape` the standard deviation of the logarithm, `scale` the median in the values' unit.

    >>> round(lognormal_fit([1.0, 2.0, 4.0]).scale, 6)
    2.0
    """
    return _fitted(values, stopped, counts, "lognormal")


def _fitted(values: Any, stopped: Any, counts: Any, family: str) -> StrengthFit:
    columns = {"stopped": stopped, "counts": counts}
    for name, column in columns.items():
        if hasattr(values, "reindex") and hasattr(column, "reindex"):
            columns[name] = in_order_of(column, values.index, name)
    with _refusing():
        return make_tests(values, **columns).fit(STRENGTHS[family])
