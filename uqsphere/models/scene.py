"""Where physics meets probability: a study and rows of its inputs become a scene, a scene columns of answers."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.errors import UsageError, told
from uqsphere.materials import library
from uqsphere.models.rows import EvaluatedRows, where_of
from uqsphere.quantities import INPUTS, OUTPUTS, format_value
from uqsphere.study import Study

if TYPE_CHECKING:
    import pandas as pd

    from uqsphere.mechanics.outputs import Answers
    from uqsphere.mechanics.scene import Scene
    from uqsphere.models.black_box import BlackBox

#: how far outside its usual range a single number is worth a warning
_FAR = 10.0


def scene_of(study: Study, values: Mapping[str, Array], rows: int | None = None) -> Scene:
    """The scenes of a study with `values` (dotted path -> (n,), SI) in place, the rest at its mean.

    rows : n, where `values` does not tell.

    Raises UsageError for a name that is no number of a scene.
    """
    from uqsphere.mechanics.scene import Scene

    if unknown := [name for name in values if name not in INPUTS]:
        raise UsageError(f"{unknown[0]!r} is not a number of a scene (allowed: {', '.join(INPUTS)})")
    n = rows if rows is not None else max((np.size(column) for column in values.values()), default=1)
    columns = {name: np.full(n, number) for name, number in study.at_means().items()}
    columns |= {name: np.broadcast_to(np.asarray(column, dtype=float), (n,)) for name, column in values.items()}
    columns |= {name: np.full(n, value) for name, value in _library_onset(study).items()}
    if study.record is not None:
        # f_in = -c0 eps: the amplitude of a measured pulse goes with the wave speed and the gain of each row
        gain = columns.get("pulse.gain", np.ones(n))
        columns["striker.speed"] = 2.0 * np.sqrt(columns["bars.E"] / columns["bars.density"]) * study.record.peak * gain
    options = study.options
    return Scene(
        columns=columns,
        rig=study.rig,
        options={name: str(word) for name, word in options.items()},
        shape=str(options.get("pulse.shape", "rectangular")),
        infinite=bool(options.get("bars.infinite")),
        rigid_contact=bool(options.get("bars.rigid_contact")),
        first_loading_only=study.model.first_loading_only,
        whole_record=study.model.whole_record,
        horizon=study.model.horizon,
        demands=study.demands,
        contact_law=str(options.get("contact.law", "hertz")),
        hardness_at_onset=options.get("contact.hardness") == "onset",
        record=study.record,
    )


def _library_onset(study: Study) -> dict[str, float]:
    """Onset and hardness that the library has of a sphere, for the check of a contact that is taken for elastic."""
    given = {**study.fixed, **study.random}
    if "sphere" not in study.materials or "sphere.onset_pressure" in given or "contact.law" in study.options:
        return {}
    properties = library()["sphere"][study.materials["sphere"]].properties
    names = ("onset_pressure", "hardness")
    return {f"sphere.{name}": properties[name].value for name in names} if set(names) <= properties.keys() else {}


def check_range(study: Study) -> None:
    """Refuse a range of the free number at whose ends the scene at its means has no answer.

    Raises UsageError with the end and the reason.
    """
    if study.margins is None or study.black_box:
        return
    from uqsphere.mechanics.scene import STATUS

    axis = study.margins.axis
    if axis.path not in INPUTS:
        return
    for value in (axis.low, axis.high):
        code = int(scene_of(study, {axis.path: np.array([value])}).status[0])
        if code:
            text = f"{format_value(value, axis.path)} for {axis.path}: {STATUS[code]}"
            raise UsageError(f"margins.between: {text}")


def check_quantities(study: Study) -> None:
    """Refuse a quantity that the rig of a study does not have.

    Raises UsageError with the place in the study and the reason.
    """
    if study.black_box:
        return
    from uqsphere.mechanics.outputs import absent_in

    scene = scene_of(study, {})
    requested = {limit.quantity: f"limits.{limit.name}.quantity" for limit in study.limits}
    requested |= dict.fromkeys(study.analysis.quantities, "analysis.quantities")
    for name, place in requested.items():
        if why := absent_in(scene, name):
            raise UsageError(f"{place}: the rig {study.rig} has no {name} here: {why}; leave it out")


def solve_scene(
    scene: Scene,
    fidelity: str = "full",
    *,
    tolerance: float = 1e-6,
    threads: int | None = None,
    quantities: Sequence[str] | None = None,
) -> Answers:
    """Answers of n scenes: in closed form where that is exact for the fidelity, else by integration.

    fidelity : "full"; "massless", a sphere without mass; "linear", a contact that is a spring (both: bars only, but for
        a weight that falls on a massless sphere).
    tolerance : relative error of every quantity.
    threads : all processors if None. No answer depends on it.
    quantities : names of `uqsphere.quantities.OUTPUTS` or demands of the scene; all if None.
    """
    from uqsphere.mechanics import closed_form
    from uqsphere.mechanics.integrator import solve as dynamics
    from uqsphere.mechanics.outputs import merged_answers

    def integrated(part: Scene) -> Answers:
        return dynamics.solve(part, fidelity=fidelity, tolerance=tolerance, threads=threads, quantities=quantities)

    if scene.rig == "bars":
        if closed_form.closed_form_applies(scene, fidelity):
            return closed_form.solve_closed(scene, fidelity, quantities)
        return integrated(scene)
    if fidelity == "massless" and closed_form.light_sphere_applies(scene):
        return closed_form.solve_light(scene, quantities)
    exact: Flags = closed_form.closed_form_rows(scene)
    if exact.all():
        return closed_form.solve_blow(scene, quantities)
    if not exact.any():
        return integrated(scene)
    rest, closed = np.flatnonzero(~exact), np.flatnonzero(exact)
    return merged_answers(
        (rest, integrated(scene.at(rest))), (closed, closed_form.solve_blow(scene.at(closed), quantities))
    )


def evaluate_scene(
    study: Study,
    names: Sequence[str],
    rows: Array,
    columns: Sequence[str],
    *,
    tolerance: float | None = None,
    threads: int | None = None,
) -> EvaluatedRows:
    """Answers of the impact model to rows (n, d).

    names : d dotted paths, the columns of `rows`; the other numbers of the scene are those of the study.
    columns : q quantities, or demands of the study's limits.
    tolerance : the study's if None.

    Raises UsageError where the scene or the request contradicts itself.
    """
    from uqsphere.mechanics.scene import STATUS, answered

    if len(rows) == 0:
        return EvaluatedRows.plain(np.zeros((0, len(columns))))
    fidelity = study.model.fidelity if study.model.fidelity in ("massless", "linear") else "full"
    tolerance = study.model.tolerance if tolerance is None else tolerance
    try:
        scene = scene_of(study, {name: rows[:, k] for k, name in enumerate(names)}, len(rows))
        answers = solve_scene(scene, fidelity, tolerance=tolerance, threads=threads, quantities=tuple(columns))
    except ValueError as error:
        raise UsageError(str(error)) from error
    good = np.asarray(answered(answers.status))
    status = np.where(good, 0, answers.status)
    none, note = np.zeros(len(rows), dtype=bool), ""
    if not good.all():
        first = int(np.argmin(good))
        note = f"{STATUS[int(status[first])]} {where_of(names, rows[first])}"
    values = np.stack([answers.values[name] for name in columns], axis=1)
    return EvaluatedRows(
        values=np.where(good[:, None], values, np.nan),
        censored=np.stack([answers.censored.get(name, none) for name in columns], axis=1),
        status=status,
        note=note,
    )


# --- the public function ---------------------------------------------------------------------------------------------


def evaluate(
    study: Study,
    frame: Any,
    quantities: str | Sequence[str] | None = None,
    tolerance: float | None = None,
    threads: int | None = 1,
    model: str | BlackBox | None = None,
) -> pd.DataFrame:
    """Quantities of n scenes, or outputs of a model of one's own at n rows.

    Parameters
    ----------
    frame : pandas.DataFrame, or mapping of name to array (n,), Series or number
        Numbers of the scene by their dotted paths, or inputs of the black box, in SI. Names are what counts, not the
        order. A DataFrame has every random input of the study; what a mapping leaves out stands at the study's mean.
        Several Series are matched by their index. A Series by itself is one row, its index the names.
    quantities : str or sequence of str
        Names of `uqsphere.quantities.OUTPUTS` and of demands of the study's limits, or outputs of the black box; those
        of the study if None.
    tolerance : float
        Relative error of every quantity, 1e-12 to 1e-2; the study's if None.
    threads : int
        All processors if None. No answer depends on it.
    model : "FILE.py:FUNCTION" or function
        The black box of a black-box study.

    Returns
    -------
    pandas.DataFrame
        The index of `frame`; a column for each quantity (SI, NaN where a row has no answer) and `censored`: whether any
        of them is a lower bound, since the record ended first.

    Raises
    ------
    UsageError
        For an unknown, missing or repeated name, a column that has no numbers, an unknown quantity, a wrong tolerance.
    ModelError
        When the model raises or returns something of the wrong form.

    Warns
    -----
    UserWarning
        For a number far outside its usual range (is the unit right?), and for rows without an answer.
    """
    import pandas as pd

    from uqsphere.models.model import open_model

    names = ((quantities,) if isinstance(quantities, str) else quantities) or study.analysis.quantities
    allowed = study.outputs if study.black_box else (*OUTPUTS, *study.demands)
    for name in names:
        if name not in allowed:
            kind = "output" if study.black_box else "quantity"
            raise UsageError(f"unknown {kind} {told(name, 60)!r} (allowed: {', '.join(allowed)})")
        if list(names).count(name) > 1:
            raise UsageError(f"{name!r} is asked for twice")
    if tolerance is not None and not 1e-12 <= tolerance <= 1e-2:
        raise UsageError(f"tolerance must lie between 1e-12 and 1e-2, not {tolerance!r}")
    columns, index = _columns_of(study, frame)
    if not study.black_box:
        _warn_of_unusual(columns)
    rows = np.stack([*columns.values()], axis=1) if columns else np.zeros((len(index), 0))
    with open_model(study, model, threads=threads, tolerance=tolerance) as opened:
        answers = opened.evaluate(tuple(columns), rows, tuple(names))
    if not answers.good.all():
        count = int((~answers.good).sum())
        warnings.warn(f"{count} of {len(rows)} rows have no answer; the first: {answers.note}", stacklevel=2)
    table = pd.DataFrame(answers.values, columns=list(names), index=index)
    table["censored"] = np.asarray(answers.censored.any(axis=1))
    return table


def _columns_of(study: Study, frame: Any) -> tuple[dict[str, Array], Any]:
    """Columns (n,) by name in the order of `frame`, and its index."""
    import pandas as pd

    index: Any = None
    if isinstance(frame, pd.Series):
        frame = pd.DataFrame([frame.to_numpy()], columns=frame.index)
    if isinstance(frame, pd.DataFrame):
        names, values, index = list(frame.columns), [frame.iloc[:, k] for k in range(frame.shape[1])], frame.index
        if missing := [name for name in study.random if name not in names]:
            raise UsageError(
                f"the column {missing[0]!r} is missing: a table has every random input of the study "
                f"({', '.join(study.random)}); a dict leaves the others at the study's means"
            )
    elif isinstance(frame, Mapping):
        names, values = list(frame), list(frame.values())
        index = next((value.index for value in values if isinstance(value, pd.Series)), None)
    else:
        raise UsageError(f"rows are a DataFrame or a dict of arrays by name, not {type(frame).__name__}")
    means = study.at_means()
    tables = {"pulse", "contact", *(name.partition(".")[0] for name in means)}
    allowed = means if study.black_box else [name for name in INPUTS if name.partition(".")[0] in tables]
    columns: dict[str, Array] = {}
    for name, value in zip(names, values, strict=True):
        if name not in allowed:
            raise UsageError(f"unknown input {told(name, 60)!r} (allowed: {', '.join(allowed)})")
        if name in columns:
            raise UsageError(f"the column {name!r} is there {names.count(name)} times")
        if isinstance(value, pd.Series) and not value.index.equals(index):
            if not (value.index.is_unique and index.is_unique and set(value.index) == set(index)):
                raise UsageError(f"the Series {name!r} has another index than the Series before it")
            value = value.reindex(index)
        if np.asarray(value).dtype.kind not in "fiubO":
            raise UsageError(f"{name}: numbers in SI are needed, not {np.asarray(value).dtype}")
        try:
            columns[name] = np.asarray(value, dtype=float)
        except (TypeError, ValueError) as error:
            raise UsageError(f"{name}: numbers in SI are needed: {told(error, 120)}") from error
    shapes = {column.shape for column in columns.values()} - {()}
    n = len(index) if index is not None else next((shape[0] for shape in shapes), 1)
    if shapes - {(n,)}:
        raise UsageError(f"all columns must have the same shape (n,), not {' and '.join(map(str, sorted(shapes)))}")
    return {name: np.broadcast_to(column, (n,)) for name, column in columns.items()}, (
        pd.RangeIndex(n) if index is None else index
    )


def _warn_of_unusual(columns: Mapping[str, Array]) -> None:
    """Warn where the median of a column lies outside the usual range, or any number by more than a factor of ten."""
    for name, column in columns.items():
        low, high = INPUTS[name].plausible
        known = column[np.isfinite(column)]
        if known.size == 0:
            continue
        far = known[(known < low / _FAR) | (known > high * _FAR)]
        median = float(np.median(known))
        if far.size or not low <= median <= high:
            value = float(far[0]) if far.size else median
            unit = INPUTS[name].unit
            warnings.warn(
                f"{name} = {f'{value:g} {unit}'.rstrip()} is unusual (usual: {format_value(low, name)} to "
                f"{format_value(high, name)}); numbers are in SI: is the unit right?",
                stacklevel=3,
            )
