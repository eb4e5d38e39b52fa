"""An expansion as an object: values with intervals at rows of inputs, terms, moments, indices, and
chaospy's objects.

The value is that of the expansion of all n rows.  With r_i what row i differs from the expansion
that has not seen it, and s(x) the standard error of a new answer by least squares, in units of the
noise,

    |y - value| <= q s(x),      s(x)² = slope(x)² (1 + p(x)' (P'P)⁻¹ p(x))

with q the ceil(level (n + 1))-th of the |r_i|/s_i (J. Lei et al., J. Am. Stat. Assoc. 113, 2018,
1094).  The slope is 1, or |value| where ln y was expanded: half-widths scale with the output.  It
holds for points drawn as the rows were.
"""

import json
import math
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from uqsphere.arrays import Array, Duo, Flags, Names, Pair, bundle, is_labelled
from uqsphere.errors import UsageError

from .chaos.basis import MOST_STEPS, Germ, Germs, germ_points, germs_of, values_of
from .chaos.expansion import Chaos, ChaospyObjects
from .chaos.fit import constant_fit, fit_chaos
from .corrected import indices_of
from .estimate import LEVEL, Estimate
from .families import Family, family_of
from .joint import Copula, Joint
from .law import Law
from .points import random_generator
from .response import Fold, Response, cross_fit
from .rows import as_table, beyond, numbers_in
from .shapley import dependent_shares

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from pandas import DataFrame


@bundle
class Prediction:
    """What an expansion says of n points.

    value, low, high : the value, and between which the model's answer lies, (n,) each
    index : the index of the rows; None where they have none
    """

    value: Array
    low: Array
    high: Array
    index: Any

    def __iter__(self) -> Iterator[Array]:
        return iter((self.value, self.low, self.high))

    def to_frame(self) -> "DataFrame":
        """The columns value, low and high, by the index of the rows."""
        from pandas import DataFrame

        columns = {"value": self.value, "low": self.low, "high": self.high}
        return DataFrame(columns, index=self.index)


def columns_of(rows: Any, names: Names) -> Array:
    """Points (n, d) of an array in the order of the names, or of a table or mapping whose columns
    go by them.

    Raises UsageError for missing, unknown and repeated columns, and for what is no finite number.
    """
    rows = as_table(rows, names)
    if hasattr(rows, "columns") or isinstance(rows, Mapping):
        labels = list(map(str, getattr(rows, "columns", rows)))
        wrong = [f"{n!r} is missing" for n in names if n not in labels]
        wrong += [f"{n!r} is no input" for n in labels if n not in names]
        wrong += [f"{n!r} is there twice" for n in labels if labels.count(n) > 1]
        if wrong:
            raise UsageError(f"column {wrong[0]}; the inputs are {', '.join(names)}")
        index = index_of(rows)
        columns = []
        for name in names:
            column = _series(rows[name])
            if hasattr(column, "reindex") and not column.index.equals(index):
                column = in_order_of(column, index, f"the column {name!r}")
            columns.append(np.atleast_1d(numbers_in(column, f"column {name!r}")))
        try:
            rows = np.column_stack(np.broadcast_arrays(*columns))
        except ValueError as error:
            sizes = ", ".join(str(column.size) for column in columns)
            raise UsageError(f"the columns differ in length: {sizes}") from error
    x = numbers_in(rows, "an array of rows")
    if x.ndim != 2 or x.shape[1] != len(names):
        raise UsageError(f"rows of shape (n, {len(names)}) are required, found {x.shape}")
    if not np.isfinite(x).all():
        column, row = np.argwhere(~np.isfinite(x.T))[0].tolist()
        raise UsageError(f"column {names[column]!r} has no finite number in row {row + 1}")
    return x


def each_once(rows: Array, values: Array) -> Pair:
    """Different rows, in the order of their first, and the mean of what each has; a warning where
    some repeat.
    """
    different, first, place = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    if len(different) == len(rows):
        return rows, values
    warnings.warn(
        f"{len(rows) - len(different)} of {len(rows)} rows repeat another: each of the "
        f"{len(different)} different rows counts once, with the mean of its answers",
        stacklevel=4,
    )
    sums = np.zeros((len(different), *values.shape[1:]))
    np.add.at(sums, place.ravel(), values)
    order = np.argsort(first)
    return different[order], (sums.T / np.bincount(place.ravel())).T[order]


def index_of(rows: Any, names: Names = ()) -> Any:
    """The index of a table of pandas, or that of the first Series of a mapping; None without
    one.
    """
    tables = [as_table(rows, names)]
    if isinstance(rows, Mapping) and not hasattr(rows, "data_vars"):
        tables = [_series(column) for column in rows.values()]
    return next((table.index for table in tables if hasattr(table, "iloc")), None)


def _series(column: Any) -> Any:
    if is_labelled(column):
        return column.to_series()
    return column


def in_order_of(column: Any, index: Any, name: str) -> Any:
    """A Series in the order of an index that has the same labels, each once.  Raises UsageError for
    any other.
    """
    if not (len(set(index)) == len(index) == len(column) and set(index) == set(column.index)):
        raise UsageError(
            f"the index of {name} is not that of the rows: give it by to_numpy() where the order "
            "is right"
        )
    return column.reindex(index)


def _points(joint: Joint, germs: Germs, x: Array) -> Array:
    """Germ points (n, d) at rows (n, d).  Raises UsageError for a step function, whose germ is not
    known.
    """
    for name, law in zip(joint.names, joint.laws, strict=True):
        if law.is_steps:
            raise UsageError(
                f"{name} is discrete: an expansion needs a density; run a study, which calls the "
                "model"
            )
    return germ_points(joint.marginal_scores(x), germs)


def _with_few_values(law: Law) -> Law:
    """The step function of observations with few different values, such as those of a switch; else
    the law itself.

    Rows that repeat the observations lie on the steps, where a smooth law has next to nothing.
    """
    values = len(set(law.data))
    if law.family.name != "empirical" or not 1 < values <= min(MOST_STEPS, len(law.data) // 2):
        return law
    return replace(law, parameters={**law.parameters, "bandwidth": 0.0})


@bundle
class Expansion:
    """The polynomial chaos of one output.

    Attributes
    ----------
    joint : names and laws of the d inputs, and what ties them
    fit : the expansion of all rows, in the germs of the laws: `fit.coefficients`,
        `fit.multi_indices`, `fit.log`
    response : expansions without a fold of the rows, for errors and intervals
    """

    joint: Joint
    fit: Chaos
    response: Response

    def __repr__(self) -> str:
        return (
            f"<Expansion in {', '.join(self.names)}: {len(self.coefficients)} terms, leaves "
            f"{self.response.error:.2g} of the variance>"
        )

    def _repr_html_(self) -> str:
        """What it is, and its ten largest terms, for a notebook."""
        terms = self.to_frame()
        largest = abs(self.coefficients).argsort()[::-1][:10]
        return f"<p>{repr(self)[1:-1]}</p>{terms.iloc[largest].to_html(index=False)}"

    @property
    def names(self) -> tuple[str, ...]:
        return self.joint.names

    @property
    def coefficients(self) -> Array:
        """Coefficients (P,) of the terms; of ln y where `fit.log`."""
        return self.fit.coefficients

    @property
    def multi_indices(self) -> Any:
        """Degrees (P, d) of the terms in each germ."""
        return self.fit.multi_indices

    def inside(self, rows: Any) -> Flags:
        """Which rows (n,) lie where the laws of the inputs do."""
        outside = map(beyond, columns_of(rows, self.names).T, self.joint.laws)
        return np.asarray(~np.any([*outside], axis=0))

    def germs_at(self, rows: Any) -> Array:
        """Values (n, d) of the germs at rows, at which the polynomial of `chaospy` gives the output
        (or ln of it).
        """
        points = self._points(columns_of(rows, self.names))
        return np.column_stack(list(map(values_of, self.fit.germs, points.T)))

    def predict(self, rows: Any, level: float = LEVEL, *, outside: str = "raise") -> Prediction:
        """What the model would answer to rows, with the interval that holds the answer at this
        level.

        Parameters
        ----------
        rows : table or mapping by the inputs' names, or array (n, d), in the inputs' own units
        level : share of points, drawn as the rows were, whose answer lies in its interval
        outside : for rows beyond the laws' support "nan", or "raise" a UsageError

        Returns
        -------
        Prediction
            Values and ends, (n,); ends are infinite where there are too few rows for the level.
        """
        if not 0.0 < level < 1.0 or outside not in ("raise", "nan"):
            raise UsageError(
                f"level must lie in (0, 1) and outside be raise or nan; found {level}, {outside!r}"
            )
        x = columns_of(rows, self.names)
        inside = self.inside(x)
        if outside == "raise" and not inside.all():
            raise UsageError(
                f"{(~inside).sum()} of {len(x)} rows lie beyond the laws of the inputs: see "
                "outside = 'nan'"
            )
        points = self._points(x)
        value = self.fit.predict(points)
        half = np.full(len(x), math.inf)
        inverse, scores = self._scores
        rank = math.ceil(level * (scores.size + 1))
        if rank <= scores.size:
            leverage = _leverage(inverse, self.fit.rows(points))
            half = scores[rank - 1] * (self._slope(value) * np.sqrt(1.0 + leverage))
        value = np.where(inside, value, np.nan)
        return Prediction(
            value=value, low=value - half, high=value + half, index=index_of(rows, self.names)
        )

    def _points(self, x: Array) -> Array:
        return _points(self.joint, self.fit.germs, x)

    def _slope(self, value: Array) -> Array:
        """What the output moves by where the fitted polynomial moves by one."""
        if self.fit.log:
            return np.abs(value)
        return np.ones_like(value)

    @cached_property
    def _scores(self) -> Pair:
        """(P'P)⁻¹ of the rows, and what each of them is off by, over its standard error without
        itself, by size.
        """
        rows = self.fit.rows(self.response.points)
        inverse: Any = np.linalg.pinv(rows @ rows.T)
        leverage = np.minimum(_leverage(inverse, rows), 1.0 - 1e-9)
        error = self._slope(self.response.levels) * np.sqrt(1.0 / (1.0 - leverage))
        return inverse, np.sort(np.abs(self.response.residuals) / np.maximum(error, 1e-300))

    # --- what it says of the output ---------------------------------------------------------------

    def moments(self) -> Duo:
        """Mean and standard deviation of the expansion, for independent inputs."""
        moments = self.fit.integrals
        return moments.mean, moments.sd

    def sample(self, count: int, *, seed: int = 0) -> "DataFrame":
        """Rows of the inputs, drawn from their joint distribution, and the expansion's values there
        as `output`.
        """
        from pandas import DataFrame

        rng = random_generator(seed, "expansion")
        x = self.joint.physical(rng.standard_normal((count, len(self.names))))
        rows = DataFrame(x, columns=self.names)
        return rows.assign(output=self.fit.predict(self._points(x)))

    def quantiles(self, p: "ArrayLike", *, count: int = 1 << 17, seed: int = 0) -> Array:
        """Quantiles of the expansion's values at probabilities, of so many draws of the inputs."""
        draws = self.sample(count, seed=seed)["output"].to_numpy()
        return np.asarray(np.quantile(draws, np.asarray(p, float)), float)

    def save(self, path: str | Path) -> None:
        """Write the expansion to a file (JSON), for `Expansion.load`."""
        Path(path).write_text(json.dumps(self, default=_stored), encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> "Expansion":
        """The expansion that `save` wrote.  The file holds numbers and names: none of it is run.

        Raises UsageError for a file that does not hold an expansion.
        """
        try:
            loaded = json.loads(Path(path).read_text(encoding="utf-8"), object_hook=_restored)
        except (ValueError, KeyError, TypeError) as error:
            raise UsageError(f"{path} does not hold an expansion: {error}") from error
        if not isinstance(loaded, cls):
            raise UsageError(f"{path} does not hold an expansion")
        return loaded

    def indices(self) -> dict[str, dict[str, Estimate]]:
        """{"first", "total"} by input, with intervals; Kucherenko's, and {"shapley"}, where inputs
        are tied.
        """
        if self.joint.dependent:
            shares = dependent_shares(self.response, self.joint)
        else:
            shares = indices_of(self.response)
        return {order: dict(zip(self.names, row, strict=True)) for order, row in shares.items()}

    def to_frame(self) -> "DataFrame":
        """The terms: one row each with the degree in every input and the coefficient."""
        return self.fit.to_frame(self.names)

    def chaospy(self) -> ChaospyObjects:
        """The expansion as chaospy's polynomial, basis, coefficients and germs; of ln y where the
        log was taken.
        """
        return self.fit.chaospy()


def _leverage(inverse: Any, rows: Array) -> Array:
    return np.asarray(np.einsum("pn,pq,qn->n", rows, inverse, rows))


def fit_expansion(x: Array, y: Array, joint: Joint, *, plain: bool = False, seed: int) -> Expansion:
    """The expansion of y (n,) at rows x (n, d) drawn by the joint law; `seed` of the order in which
    rows are dealt.

    It is of the kind that the folds agree on.  Where the rows contradict its variance, the
    expansion of a fold that can be trusted, else the mean, is in its place.
    """
    order = random_generator(seed, "chaos rows").permutation(len(y))
    x = x[order]
    y = y[order]
    germs = germs_of(map(_with_few_values, joint.laws))
    points = _points(joint, germs, x)
    independent = not joint.dependent
    response = cross_fit(points, y, germs, plain=plain, independent=independent)[0]
    # where folds with logarithms run away, that of all rows would as well
    plain = not any(response.folds[k].fit.log for k in response.trusted)
    fit = fit_chaos(points, y, response.germs, plain=plain)
    if independent and not response.allows(fit):
        fit = constant_fit(y, response.germs)
        if response.trusted:
            fit = response.folds[response.trusted[0]].fit
    return Expansion(joint=joint, fit=fit, response=response)


# --- the file of an expansion ---------------------------------------------------------------------


def _stored(part: Any) -> Any:
    """A part of an expansion as JSON has it."""
    if isinstance(part, np.ndarray):
        return {"class": "array", "dtype": part.dtype.str, "values": part.tolist()}
    if isinstance(part, Family):
        return {"class": "Family", "name": part.name}
    if isinstance(part, Germ):  # its table and its recurrence follow from its distribution
        return {"class": "Germ", "law": part.law}
    name = type(part).__name__
    if name not in PARTS:
        raise UsageError(f"a file cannot keep the functions of {part}: give its parameters")
    return {"class": name} | {each.name: getattr(part, each.name) for each in fields(part)}


#: parts of an expansion by the name that its file has for them
PARTS: Mapping[str, Any] = {
    "array": lambda dtype, values: np.array(values, dtype),
    "Family": family_of,
    "Germ": lambda law: germs_of([law])[0],
    **{part.__name__: part for part in (Chaos, Copula, Expansion, Fold, Joint, Law, Response)},
}


def _restored(part: dict[str, Any]) -> Any:
    """A part of an expansion from what JSON has of it."""
    name = part.pop("class", None)
    if name is None:
        return part
    return PARTS[name](**{key: _tuples(value) for key, value in part.items()})


def _tuples(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(map(_tuples, value))
    return value
