"""`uqsphere.evaluate`: a table of inputs in, a table of quantities out."""

import warnings
from collections.abc import Mapping
from dataclasses import replace
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from uqsphere.arrays import Names
from uqsphere.errors import UsageError
from uqsphere.quantities import INPUTS, format_value
from uqsphere.study import Study
from uqsphere.uq.surrogate import columns_of, index_of

from .black_box import BlackBox
from .model import Model
from .scene import checked_rows

if TYPE_CHECKING:
    import pandas as pd

#: how far outside its usual range a single number is worth a warning
_FAR = 10.0
#: the highest grade of a check
_FAILURE = 3
#: most rows whose validity is checked
_CHECKED = 4096


def evaluate(
    study: Study,
    frame: Any,
    quantities: str | Names | None = None,
    tolerance: float | None = None,
    threads: int | None = 1,
    model: str | BlackBox | None = None,
) -> "pd.DataFrame":
    """Evaluate the impact model, or your own model, at n samples.

    Parameters
    ----------
    study : Study
        What is evaluated.
    frame : DataFrame or mapping
        Names to arrays (n,), Series or numbers: numbers of the scene by their dotted paths, or
        inputs of the black box, in SI, in any order.  A DataFrame needs every random input of the
        study; a mapping takes omitted ones at the study's mean.  Several Series are matched by
        their index.
    quantities : str or sequence of str, optional
        Names of `uqsphere.quantities.OUTPUTS` and of demands of the study's limits, or outputs of
        the black box (default: those of the study).
    tolerance : float, optional
        Relative error of every quantity, 1e-12 to 1e-2 (default: the study's).
    threads : int or None
        Number of threads; None for all processors.  Results do not depend on it.
    model : str or callable, optional
        "FILE.py:FUNCTION" or a function, the black box of a black-box study.

    Returns
    -------
    DataFrame
        With the index of `frame`: a column for each quantity [SI], NaN where a row has no answer,
        and `censored`, whether any of them is a lower bound because the evaluation window ended.

    Raises
    ------
    UsageError
        An unknown, missing or repeated name, a column that is not numeric, or a wrong tolerance.
    ModelError
        The model raised, or returned something of the wrong form.

    Warns
    -----
    UserWarning
        A value far outside its usual range, rows without an answer, and samples outside the
        validity range of the impact model (`uqsphere.mechanics.validity`).
    """
    import pandas as pd

    if not isinstance(study, Study):
        raise UsageError(
            f"study must be a Study, as load_study returns it, not {type(study).__name__}"
        )
    if not isinstance(frame, pd.DataFrame | Mapping):
        raise UsageError(
            f"frame must be a DataFrame or a dict of arrays by name, not {type(frame).__name__}"
        )
    if tolerance is not None:
        if not (isinstance(tolerance, Real) and 1e-12 <= tolerance <= 1e-2):
            raise UsageError(f"tolerance must be between 1e-12 and 1e-2, not {tolerance!r}")
        study = replace(study, model=study.model.model_copy(update={"tolerance": tolerance}))
    names = list(frame)
    columns = list(quantities or study.analysis.quantities)
    if isinstance(quantities, str):
        columns = [quantities]
    with Model(study, model, threads=threads) as opened:
        opened.check_names(names, columns)
        missing = [name for name in study.random if name not in names]
        if isinstance(frame, pd.DataFrame) and missing:
            raise UsageError(
                f"the column {missing[0]!r} is missing. A DataFrame needs every random input of "
                f"the study ({', '.join(study.random)}); a dict takes the others at their means"
            )
        rows = columns_of(frame, names) if names else np.zeros((1, 0))
        for name, column in zip(names, rows.T, strict=True):
            low, high = (-np.inf, np.inf) if study.black_box else INPUTS[name].plausible
            far = column[(column < low / _FAR) | (column > high * _FAR)]
            if far.size:
                warnings.warn(
                    f"{name} = {far[0]:g} {INPUTS[name].unit} is unusual (usual: "
                    f"{format_value(low, name)} to {format_value(high, name)}). Values are in SI; "
                    "is the unit right?",
                    stacklevel=2,
                )
        answers = opened.evaluate(names, rows, columns)
    if not answers.good.all():
        warnings.warn(
            f"{(~answers.good).sum()} of {len(rows)} rows have no answer; the first: "
            f"{answers.note}",
            stacklevel=2,
        )
    if not study.black_box:
        for check in checked_rows(study, names, rows[:_CHECKED], columns):
            if check.grade == _FAILURE:
                warnings.warn(
                    f"outside the validity range of the model: {check.text}", stacklevel=2
                )
    table = pd.DataFrame(answers.values, columns=columns, index=index_of(frame))
    return table.assign(censored=np.asarray(answers.censored.any(axis=1)))
