"""The public function of rows: a table of inputs in, a table of quantities out."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from decimal import Decimal
from numbers import Real
from typing import Any, Final

import numpy as np
import pandas as pd

from uqsphere.errors import UsageError, as_text
from uqsphere.models.black_box import BlackBox
from uqsphere.models.model import Model
from uqsphere.quantities import INPUTS, OUTPUTS, format_value
from uqsphere.study import Study

#: how far outside its usual range a single number is worth a warning
_FAR: Final = 10.0


def evaluate(
    study: Study,
    frame: Any,
    quantities: str | Sequence[str] | None = None,
    tolerance: float | None = None,
    threads: int | None = 1,
    model: str | BlackBox | None = None,
) -> pd.DataFrame:
    """Quantities of n scenes, or outputs of a model of one's own at n rows.

    frame : a DataFrame, or a mapping of names to arrays (n,), Series or numbers: numbers of the scene by their dotted
        paths, or inputs of the black box, in SI, in any order. A DataFrame has every random input of the study; what a
        mapping leaves out stands at the study's mean. Several Series are matched by their index. A Series by itself is
        one row, its index the names.
    quantities : names of `uqsphere.quantities.OUTPUTS` and of demands of the study's limits, or outputs of the black
        box; those of the study if None.
    tolerance : relative error of every quantity, 1e-12 to 1e-2; the study's if None.
    threads : all processors if None. No answer depends on it.
    model : "FILE.py:FUNCTION" or function, the black box of a black-box study.

    Returns a DataFrame with the index of `frame`: a column for each quantity (SI, NaN where a row has no answer) and
    `censored`, whether any of them is a lower bound, since the record ended first.

    Raises UsageError for an unknown, missing or repeated name, a column that has no numbers, an unknown quantity, a
    wrong tolerance; ModelError when the model raises or returns something of the wrong form. Warns of a number far
    outside its usual range (is the unit right?), and of rows without an answer.
    """
    if not isinstance(study, Study):
        raise UsageError(f"evaluate takes a study of uqsphere.load_study, found {type(study).__name__}")
    names = list((quantities,) if isinstance(quantities, str) else quantities or study.analysis.quantities)
    outputs = study.outputs if study.black_box else (*OUTPUTS, *study.demands)
    _check_names("output" if study.black_box else "quantity", names, outputs)
    if tolerance is not None and not (isinstance(tolerance, Real) and 1e-12 <= tolerance <= 1e-2):
        raise UsageError(f"tolerance must lie between 1e-12 and 1e-2, not {tolerance!r}")
    table = _table(study, frame)
    if not study.black_box:
        _warn_of_unusual(table)
    with Model(study, model, threads=threads, tolerance=tolerance) as opened:
        answers = opened.evaluate(list(table.columns), table.to_numpy(float), names)
    if not answers.good.all():
        count = int((~answers.good).sum())
        warnings.warn(f"{count} of {len(table)} rows have no answer; the first: {answers.note}", stacklevel=2)
    found = pd.DataFrame(answers.values, columns=names, index=table.index)
    found["censored"] = np.asarray(answers.censored.any(axis=1))
    return found


def _check_names(kind: str, names: Sequence[str], allowed: Sequence[str]) -> None:
    """Refuse names that are unknown or repeated."""
    for name in names:
        if name not in allowed:
            raise UsageError(f"unknown {kind} {as_text(name, 60)!r} (allowed: {', '.join(allowed)})")
        if names.count(name) > 1:
            raise UsageError(f"the {kind} {name!r} is there {names.count(name)} times")


def _table(study: Study, frame: Any) -> pd.DataFrame:
    """The rows that a caller gave, as numbers by the names of inputs."""
    if isinstance(frame, pd.Series):
        frame = frame.to_frame().T
    if not isinstance(frame, (pd.DataFrame, Mapping)):
        raise UsageError(f"rows are a DataFrame or a dict of arrays by name, not {type(frame).__name__}")
    names, means = list(frame), list(study.at_means())
    tables = {"pulse", "contact", *(name.partition(".")[0] for name in means)}
    _check_names("input", names, means if study.black_box else [n for n in INPUTS if n.partition(".")[0] in tables])
    if isinstance(frame, pd.DataFrame):
        if missing := [name for name in study.random if name not in names]:
            raise UsageError(
                f"the column {missing[0]!r} is missing: a table has every random input of the study "
                f"({', '.join(study.random)}); a dict leaves the others at the study's means"
            )
        table = frame
    else:
        labels = [value.index for value in frame.values() if isinstance(value, pd.Series)]
        one = pd.RangeIndex(1) if not any(map(np.ndim, frame.values())) else None
        try:
            table = pd.DataFrame(dict(frame), index=labels[0] if labels else one)
        except ValueError as error:
            raise UsageError(f"all columns must have the same shape (n,): {as_text(error, 120)}") from error
        if any(len(own.symmetric_difference(table.index)) for own in labels):
            raise UsageError("the Series have different indices: give them by to_numpy() where the order is right")
    for name, column in table.items():
        for cell in () if column.dtype.kind in "fiub" else column:
            if not isinstance(cell, Real | Decimal | None):
                raise UsageError(f"{name}: numbers in SI are needed, not {type(cell).__name__}")
    return table.astype(float)


def _warn_of_unusual(table: pd.DataFrame) -> None:
    """Warn where the median of a column lies outside the usual range, or any number by more than a factor of ten."""
    for name, column in table.items():
        low, high = INPUTS[str(name)].plausible
        known = column[np.isfinite(column)]
        far, median = known[(known < low / _FAR) | (known > high * _FAR)], known.median()
        if len(far) or median < low or median > high:
            value = f"{far.iloc[0] if len(far) else median:g} {INPUTS[str(name)].unit}".rstrip()
            usual = f"{format_value(low, str(name))} to {format_value(high, str(name))}"
            warnings.warn(f"{name} = {value} is unusual (usual: {usual}); numbers are in SI: is the unit right?",
                          stacklevel=3)  # fmt: skip
