"""Rows from elsewhere: tables read by the names of their columns, and the one check that rows
follow the distributions and the dependence of the inputs.
"""

import math
from itertools import combinations
from typing import Any

import numpy as np

from uqsphere.arrays import Array, Flags, Names, as_numbers, is_labelled
from uqsphere.errors import UsageError

from .joint import Joint
from .law import Law

#: chance at which rows of the right distribution are rejected, by input and by pair of inputs
CHANCE = 1e-6
#: rows below which a distribution cannot be told from another one
LEAST_ROWS = 16
#: factors between units that are mistaken for each other, by name
UNITS = {
    1e-9: "1e9 times too large",
    1e-6: "a million times too large",
    1e-3: "a thousand times too large (mm for m, MPa for GPa)",
    1e-2: "a hundred times too large (per cent for a share)",
    0.1: "ten times too large",
    10.0: "ten times too small",
    1e2: "a hundred times too small",
    1e3: "a thousand times too small (m for mm, GPa for MPa)",
    1e6: "a million times too small",
    1e9: "1e9 times too small",
    180.0 / math.pi: "in radians where degrees are expected",
    math.pi / 180.0: "in degrees where radians are expected",
}


#: answers between whose sizes fourth powers, of which the scatter of a variance is made, are
#: numbers
SMALLEST_ANSWER, LARGEST_ANSWER = 1e-75, 1e75


def too_small(values: Array) -> bool:
    """Whether the scatter of answers (n,) vanishes in floating point."""
    return bool(np.abs(values).max(initial=0.0) < SMALLEST_ANSWER and np.ptp(values) > 0.0)


def as_table(rows: Any, names: Names) -> Any:
    """A labelled array or data set of xarray, or a Series of one row, as a DataFrame by the inputs'
    names; anything else as it is.

    Raises UsageError for a labelled array without these labels.
    """
    rows = _of_data_set(rows)
    if hasattr(rows, "to_frame") and hasattr(rows, "index"):
        return rows.to_frame().T  # a Series: one row, its index the names
    if not is_labelled(rows) or len(rows.dims) != 2:
        return rows
    for dimension, other in (rows.dims, rows.dims[::-1]):
        if dimension in rows.coords and set(map(str, rows.coords[dimension].values)) == set(names):
            return rows.transpose(other, dimension).to_pandas()
    raise UsageError(
        f"a labelled array needs a coordinate that names its columns: {', '.join(names)}; found "
        f"dimensions {', '.join(map(str, rows.dims))}"
    )


def _of_data_set(cells: Any) -> Any:
    """A data set of xarray as a DataFrame, anything else as it is."""
    if hasattr(cells, "data_vars"):
        return cells.to_dataframe()[[*cells.data_vars]]
    return cells


def as_answers(y: Any) -> Any:
    """Answers as a Series where they have labels, else as an array.

    Raises UsageError for several columns.
    """
    y = _of_data_set(y)
    if is_labelled(y):
        y = y.to_series() if len(y.dims) == 1 else np.asarray(y)
    if hasattr(y, "columns"):
        if y.shape[1] != 1:
            raise UsageError(f"y is one output, found the columns {', '.join(map(str, y.columns))}")
        y = y.iloc[:, 0]
    return y


def numbers_in(cells: Any, what: str) -> Array:
    """The real numbers of a column that a message calls `what`; UsageError where it has others."""
    try:
        return as_numbers(cells)
    except (TypeError, ValueError) as error:
        raise UsageError(f"no columns of numbers ({what}): {error}") from error


def check_rows(x: Array, joint: Joint) -> None:
    """Refuse rows (n, d) that do not follow the distributions of the inputs and their dependence.

    A value beyond a distribution is refused at any number of rows; 16 rows or more are tested by
    Kolmogorov and Smirnov and by the correlations of their normal scores, each at one in a million.
    The message names the likely cause: another unit, or swapped columns.
    """
    for k, (name, law) in enumerate(zip(joint.names, joint.laws, strict=True)):
        column = x[:, k]
        far = np.flatnonzero(beyond(column, law))
        if far.size and not law.is_steps:
            raise UsageError(
                f"column {name!r}: {column[far[0]]:g} cannot come from its distribution, "
                f"{law!r}: {far.size} of {len(x)} rows lie beyond it{_cause(x, joint, k)}"
            )
        if not _follows(column, law):
            raise UsageError(
                f"column {name!r} does not follow its distribution, {law!r}{_cause(x, joint, k)}"
            )
    n = len(x)
    if n < LEAST_ROWS or any(law.is_steps for law in joint.laws):
        return
    # independent normals, once what ties the inputs is taken out of them
    normals = joint.normals(x)
    varies = np.flatnonzero(np.ptp(normals, axis=0) > 0.0).tolist()
    for j, i in sorted(combinations(varies, 2), key=lambda pair: pair[1]):
        r = np.corrcoef(normals[:, i], normals[:, j])[0, 1]
        # Fisher's transformation
        score = math.atanh(min(abs(r), 1.0 - 1e-12)) * math.sqrt(n - 3)
        if math.erfc(score / math.sqrt(2.0)) < CHANCE:
            declared = "beyond their declared dependence" if joint.dependent else "undeclared"
            raise UsageError(
                f"the columns {joint.names[j]!r} and {joint.names[i]!r} depend on each other: "
                f"correlation {r:.2f} of {n} rows, {declared}; declare it in [[dependence]] "
                "(or `joint`), or draw rows as declared"
            )


def beyond(column: Array, law: Law) -> Flags:
    """Which values cannot come from a distribution."""
    return np.minimum(*law.tails(column)) <= 0.0


def _follows(column: Array, law: Law) -> bool:
    """Whether values may come from a distribution; few rows and few different values always may."""
    from scipy.stats import kstest

    if law.is_steps:
        return True
    if beyond(column, law).any():
        return False
    if len(column) < LEAST_ROWS or 2 * len(np.unique(column)) <= len(column):
        return True
    return bool(kstest(law.cdf(column), "uniform").pvalue >= CHANCE)


def _cause(x: Array, joint: Joint, place: int) -> str:
    """Why a column may not follow its distribution; empty where nothing explains it."""
    column = x[:, place]
    law = joint.laws[place]
    if len(x) >= LEAST_ROWS:
        for other, name in enumerate(joint.names):
            swapped = other != place and _follows(column, joint.laws[other])
            if swapped and _follows(x[:, other], law):
                return f"; the columns {joint.names[place]!r} and {name!r} seem to be swapped"
        for factor, text in UNITS.items():
            if _follows(column * factor, law):
                return f"; its values seem to be {text}: give them in the unit of the distribution"
    return "; rows are drawn from the distributions of the inputs, as `design` and `sample` do"
