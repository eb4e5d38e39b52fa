"""Where physics meets probability: a study becomes a function from rows of inputs to rows of answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.black_box import BlackBox, call_black_box, load_black_box
from uqsphere.errors import ModelError, UsageError, told
from uqsphere.materials import library
from uqsphere.quantities import INPUTS, OUTPUTS, format_value
from uqsphere.study import Study

if TYPE_CHECKING:
    import pandas as pd

    from uqsphere.mechanics.outputs import Answers
    from uqsphere.mechanics.scene import Scene


#: fidelities in the order of their cost
FIDELITIES = ("massless", "linear", "full")
#: status of a row whose black box gave a number that is not finite
STATUS_NOT_FINITE = 6
#: why only one scene over time can have a damper against frequency
NO_DAMPER = (
    "bars.receiving_damper, an impedance against frequency, is followed by history alone: for a run, give the end as a "
    "number, receiving_end"
)
#: inputs that are named where an evaluation has no answer
_MOST_NAMED = 6
#: status of a row for which a black box raised, took longer than its limit of time, or ended its process
STATUS_RAISED, STATUS_TIME, STATUS_DIED = 8, 9, 10
_BOX_STATUS = {
    STATUS_NOT_FINITE: "the model gave a number that is not finite",
    STATUS_RAISED: "the model raised an exception",
    STATUS_TIME: "the model took longer than analysis.time_limit",
    STATUS_DIED: "the model ended the process it ran in",
}
#: a row with one of these has numbers
ANSWERED = frozenset({0})
#: how a row was answered: by the fidelity asked for, by `full` in its place, or by `full` after it had failed
ROUTE_ASKED, ROUTE_FULL, ROUTE_BOTH = 0, 1, 2


def is_answered(status: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Whether rows of a status carry numbers.

    >>> is_answered([0, 3]).tolist()
    [True, False]
    """
    given = np.asarray(status)
    found = np.zeros(given.shape, dtype=bool)
    for code in ANSWERED:  # several times faster than isin, for every row of a run
        found |= given == code
    return found


@dataclass(frozen=True, kw_only=True)
class EvaluatedRows:
    """Rows that were evaluated, n of them.

    Values and censored flags (n, q) in the order of the quantities asked, status (n,), and by which route each
    row was answered (n,): all by the fidelity asked for if None.  note: what was said of the first row that failed.
    """

    values: Array
    censored: npt.NDArray[np.bool_]
    status: npt.NDArray[np.int64]
    route: npt.NDArray[np.int64] | None = None
    note: str = ""

    @property
    def good(self) -> npt.NDArray[np.bool_]:
        """Which rows have an answer, (n,)."""
        return is_answered(self.status)

    @property
    def known(self) -> Array:
        """Values (n, q), nan where a row has none."""
        return np.where(self.good[:, None], self.values, np.nan)

    @property
    def routes(self) -> npt.NDArray[np.int64]:
        """The route of every row, (n,)."""
        return np.zeros(len(self.status), dtype=np.int64) if self.route is None else self.route


def scene_of(
    study: Study, values: Mapping[str, Array], rows: int | None = None, *, over_frequency: bool = False
) -> Scene:
    """The scenes of a study with `values` (dotted path -> (n,) SI) in place, the rest at its mean.

    A damper against frequency is refused, unless `over_frequency` says that the caller sees to it.
    """
    from uqsphere.mechanics.scene import Scene

    if study.receiving_damper is not None and not over_frequency:
        raise UsageError(NO_DAMPER)

    unknown = [name for name in values if name not in INPUTS]
    if unknown:
        raise UsageError(f"{unknown[0]!r} is not a number of a scene (allowed: {', '.join(INPUTS)})")
    n = rows if rows is not None else (len(np.atleast_1d(next(iter(values.values())))) if values else 1)
    columns = {name: np.full(n, number) for name, number in study.at_means().items()}
    for name, column in values.items():
        columns[name] = np.broadcast_to(np.asarray(column, dtype=float), (n,))
    columns |= {name: np.full(n, value) for name, value in _library_onset(study).items()}
    if study.record is not None:
        # f_in = -c0 eps: the amplitude of a measured pulse goes with the wave speed and the gain of each row
        gain = columns.get("pulse.gain", np.ones(n))
        columns["striker.speed"] = 2.0 * np.sqrt(columns["bars.E"] / columns["bars.density"]) * study.record.peak * gain
    return Scene(
        columns=columns,
        rig=study.rig,
        options={name: str(word) for name, word in study.options.items()},
        shape=str(study.options.get("pulse.shape", "rectangular")),
        infinite=bool(study.options.get("bars.infinite")),
        rigid_contact=bool(study.options.get("bars.rigid_contact")),
        first_loading_only=study.model.first_loading_only,
        horizon=study.model.horizon,
        demands=study.demands,
        contact_law=str(study.options.get("contact.law", "hertz")),
        contact_dynamics="elastic" if study.options.get("contact.dynamics") == "elastic" else "path",
        hardness_at_onset=study.options.get("contact.hardness") == "onset",
        record=study.record,
    )


def check_range(study: Study) -> None:
    """Refuse a range of the free scalar at whose ends the scene at its means has no answer."""
    if study.margins is None or study.black_box:
        return
    from uqsphere.mechanics.scene import STATUS

    axis = study.margins.axis
    name = axis.path
    if name not in INPUTS:
        return
    for value in (axis.low, axis.high):
        code = int(scene_of(study, {name: np.array([value])}).status[0])
        if code:
            raise UsageError(f"margins.between: {format_value(value, name)} for {name}: {STATUS[code]}")


def check_quantities(study: Study) -> None:
    """Refuse a quantity that the scene of a study does not have, with the reason."""
    if study.black_box or study.rig == "none":
        return
    from uqsphere.mechanics.outputs import absent_in

    scene = scene_of(study, {})
    asked = dict.fromkeys(study.analysis.quantities, "analysis.quantities")
    asked |= {limit.quantity: f"limits.{limit.name}.quantity" for limit in study.limits if limit.quantity not in asked}
    for name, place in asked.items():
        if why := absent_in(scene, name):
            raise UsageError(f"{place}: the rig {study.rig} has no {name} here: {why}; leave it out")


def _library_onset(study: Study) -> dict[str, float]:
    """Onset and hardness that the library has of a sphere, for the check of a contact that is taken for elastic."""
    given = {**study.fixed, **study.random}
    if "sphere" not in study.materials or "sphere.onset_pressure" in given or "contact.law" in study.options:
        return {}
    known = library()["sphere"][study.materials["sphere"]].properties
    names = ("onset_pressure", "hardness")
    return {f"sphere.{name}": known[name].value for name in names} if set(names) <= known.keys() else {}


def cheaper_fidelities(study: Study) -> tuple[str, ...]:
    """The fidelities that may stand for `full` in a study: no spring where faces yield or another rig stands."""
    law = study.options.get("contact.law", "hertz")
    if study.rig != "bars":
        return ("massless",)
    if law == "hertz":
        return "massless", "linear"
    return ("massless",)


def solve_scene(
    scene: Scene, fidelity: str, *, tolerance: float, threads: int | None, quantities: Sequence[str] | None
) -> Answers:
    """Answers of one fidelity for all rows of a scene: in closed form where there is one, else integrated."""
    from uqsphere.mechanics import closed_form
    from uqsphere.mechanics.integrator import solve as dynamics

    if scene.rig != "bars":
        return _solve_rig(scene, fidelity, tolerance=tolerance, threads=threads, quantities=quantities)
    if closed_form.closed_form_applies(scene, fidelity):
        return closed_form.solve_closed(scene, fidelity, quantities)
    return dynamics.solve(scene, fidelity=fidelity, tolerance=tolerance, threads=threads, quantities=quantities)


def _solve_rig(
    scene: Scene, fidelity: str, *, tolerance: float, threads: int | None, quantities: Sequence[str] | None
) -> Answers:
    """The same for a rig other than bars: what has a closed form needs no integrator, row by row."""
    from uqsphere.mechanics import closed_form
    from uqsphere.mechanics.integrator import solve as dynamics
    from uqsphere.mechanics.outputs import merged_answers

    if fidelity == "massless" and closed_form.light_sphere_applies(scene):
        return closed_form.solve_light(scene, quantities)
    closed = closed_form.closed_form_rows(scene)
    if closed.all():
        return closed_form.solve_blow(scene, quantities)
    parts = {False: np.flatnonzero(~closed), True: np.flatnonzero(closed)}
    rest = dynamics.solve(
        scene.at(parts[False]), fidelity=fidelity, tolerance=tolerance, threads=threads, quantities=quantities
    )
    if len(parts[True]) == 0:
        return rest
    return merged_answers(
        (parts[False], rest), (parts[True], closed_form.solve_blow(scene.at(parts[True]), quantities))
    )


def _solve(
    scene: Scene, quantities: Sequence[str], fidelity: str, tolerance: float, threads: int | None
) -> EvaluatedRows:
    """The same as a table with a column per quantity."""
    answers = solve_scene(scene, fidelity, tolerance=tolerance, threads=threads, quantities=quantities)
    none = np.zeros(len(scene), dtype=bool)
    return EvaluatedRows(
        values=np.stack([answers.values[name] for name in quantities], axis=1),
        censored=np.stack([answers.censored.get(name, none) for name in quantities], axis=1),
        status=answers.status,
    )


def answer_scene(
    study: Study,
    names: Sequence[str],
    rows: Array,
    quantities: Sequence[str],
    *,
    fidelity: str = "full",
    tolerance: float = 1e-6,
    threads: int | None = None,
) -> EvaluatedRows:
    """Answers of n rows by the impact model.

    Parameters
    ----------
    names : d dotted paths that the columns of `rows` belong to.
    rows : (n, d) array, SI.
    quantities : q names of `uqsphere.quantities.OUTPUTS`.
    fidelity, tolerance, threads : see `uqsphere.mechanics.integrator.solve`.
    """
    if len(rows) == 0:
        return _no_rows(quantities)

    scene = scene_of(study, {name: rows[:, k] for k, name in enumerate(names)}, len(rows))
    return _solve(scene, quantities, fidelity, tolerance, threads)


def answer_black_box(
    study: Study,
    names: Sequence[str],
    rows: Array,
    outputs: Sequence[str],
    box: BlackBox | None,
    needed: Sequence[str] | None = None,
) -> EvaluatedRows:
    """Answers of n rows by the user's own model, in one call.

    Parameters
    ----------
    names : d names of inputs that the columns of `rows` (n, d) belong to; the others are the study's fixed numbers.
    outputs : q outputs of the model.
    needed : the outputs without which a row has failed, all if None; numbers of a failed row are then kept where they
        are finite.

    Raises ModelError when the model raises or returns something of the wrong form.
    """
    if len(rows) == 0:
        return _no_rows(outputs)
    if box is None:
        raise UsageError("a black box is run with --model FILE.py:FUNCTION, in Python with model=")
    given = {name: np.full(len(rows), value) for name, value in study.fixed.items()}
    given |= {name: np.array(rows[:, k]) for k, name in enumerate(names)}
    inputs = np.stack(list(given.values()), axis=1)
    found = call_black_box(box, given)
    if not isinstance(found, Mapping):
        raise ModelError(f"the model must return a dict of output name -> array, found {told(type(found).__name__)}")
    due = [needed is None or name in needed for name in outputs]
    values = _outputs(_unfolded(found, outputs), dict(zip(outputs, due, strict=True)), len(rows))
    known: npt.NDArray[np.bool_] = np.isfinite(values)
    finite = np.all(known[:, due], axis=1)
    note = ""
    if not finite.all():
        at = int(np.argmin(finite))
        k = next(k for k, must in enumerate(due) if must and not known[at, k])
        note = f"{outputs[k]} = {values[at, k]:g} {where_of(list(given), inputs[at])}"
    return EvaluatedRows(
        values=np.where(known if needed is not None else np.reshape(finite, (-1, 1)), values, np.nan),
        censored=np.zeros(values.shape, dtype=bool),
        status=np.where(finite, 0, STATUS_NOT_FINITE),
        note=note,
    )


def place_names(field: str, places: int) -> tuple[str, ...]:
    """Names of the columns that a field with so many places is stored in.

    >>> place_names("force", 2)
    ('force[0]', 'force[1]')
    """
    return tuple(f"{field}[{k}]" for k in range(places))


def _unfolded(found: Mapping[str, npt.ArrayLike], outputs: Sequence[str]) -> Mapping[str, npt.ArrayLike]:
    """What a model returned, with the columns of its fields (n, places) under the names of `place_names`."""
    asked = dict.fromkeys(name.partition("[")[0] for name in outputs if name.endswith("]"))
    if not asked:
        return found
    answer = dict(found)
    for name in asked:
        places = sum(output.partition("[")[0] == name for output in outputs)
        shape = np.shape(found[name]) if name in found else ()
        if len(shape) != 2 or shape[1] != places:
            raise ModelError(f"the model's {name!r} must have the shape (rows, {places}) of a field, found {shape}")
        answer.update(zip(place_names(name, places), np.ma.filled(np.ma.asarray(found[name], float), np.nan).T,
                          strict=True))  # fmt: skip
    return answer


def _no_rows(quantities: Sequence[str]) -> EvaluatedRows:
    empty = np.zeros((0, len(quantities)))
    return EvaluatedRows(values=empty, censored=empty.astype(bool), status=np.zeros(0, dtype=np.int64))


def _outputs(found: Mapping[str, npt.ArrayLike], due: Mapping[str, bool], count: int) -> Array:
    """The outputs of the model as (count, q) numbers."""
    try:
        return np.stack([_output(found, name, count, must) for name, must in due.items()], axis=1)
    except ModelError:
        raise
    except Exception as error:  # a mapping of the model's own answers as it likes
        raise ModelError(f"what the model returned cannot be read: {type(error).__name__}: {told(error)}") from error


def _output(found: Mapping[str, npt.ArrayLike], name: str, count: int, due: bool) -> Array:
    """One output of the model as (count,) numbers; NaN where one that is not due was not returned."""
    if name not in found:
        if not due:
            return np.full(count, np.nan)
        keys = [f"'{told(key, 60)}'" for key in islice(found, _MOST_NAMED)]
        raise ModelError(f"the model returned no {name!r} (it returned {', '.join(keys) or 'nothing'})")
    given = found[name]
    try:
        if np.iscomplexobj(given):
            raise TypeError("found complex numbers")
        # what a masked array hides is no answer
        column: Array = np.ma.filled(np.ma.asarray(given, dtype=float), np.nan)
    except Exception as error:  # numpy asks the objects themselves, which answer as they like
        raise ModelError(f"the model's {name!r} is not an array of numbers: {told(error)}") from error
    if column.shape != (count,):
        due_shape = f"shape ({count},), one number for each row of its inputs"
        places = column.shape[1] if column.ndim == 2 and len(column) == count else 0
        hint = f"; an answer at many places is a field: analysis.fields.{name} = {places}" if places > 1 else ""
        raise ModelError(f"the model's {name!r} must have {due_shape}, found {column.shape}{hint}")
    return column


def where_of(names: Sequence[str], row: Array) -> str:
    """The inputs (d,) of an evaluation, in words.

    >>> where_of(("a", "b"), np.array([1.0, 0.25]))
    'at a = 1, b = 0.25'
    """
    found = [f"{name} = {value:.6g}" for name, value in zip(names, row.tolist(), strict=False)]
    more = f" and {len(found) - _MOST_NAMED} more inputs" if len(found) > _MOST_NAMED else ""
    return f"at {', '.join(found[:_MOST_NAMED])}{more}"


def evaluate(
    study: Study,
    values: Mapping[str, npt.ArrayLike],
    quantities: Sequence[str] = ("p_max",),
    fidelity: str = "full",
    tolerance: float = 1e-8,
    threads: int | None = None,
    model: str | BlackBox | None = None,
) -> pd.DataFrame:
    """Quantities of interest of n scenes, or outputs of a model of one's own at n rows.

    Parameters
    ----------
    values : mapping of dotted path to (n,) array
        In SI; the rest of the scene stands at its mean.
    quantities : names of `uqsphere.quantities.OUTPUTS`
    fidelity : full, massless or linear
    tolerance : relative error of every quantity
    threads : all processors if None; the answers do not depend on it
    model : the black box of a black-box study, "FILE.py:FUNCTION" or a function, called here once

    Returns
    -------
    pandas.DataFrame
        n rows; a column per quantity in SI (NaN where the row failed), `status` (0 ok, else a code of
        `uqsphere.mechanics.scene.STATUS`) and `censored` (whether any quantity asked for is a lower bound).

    Raises
    ------
    UsageError
        For an unknown quantity, fidelity or number of the scene, and a black-box study without its model.
    ModelError
        When the model raises or returns something of the wrong form.
    """
    import pandas as pd

    quantities = (quantities,) if isinstance(quantities, str) else quantities
    if study.black_box:
        return _evaluate_box(study, values, quantities, model)
    if model is not None:
        raise UsageError("a model of one's own answers black-box studies; this one describes an impact scene")
    for name in quantities or ("",):
        if name not in OUTPUTS:
            said = f"unknown quantity {name!r}" if name else "no quantity is asked for"
            raise UsageError(f"{said} (allowed: {', '.join(OUTPUTS)})")
    if fidelity not in FIDELITIES:
        raise UsageError(f"unknown fidelity {fidelity!r} (allowed: {', '.join(FIDELITIES)}; auto is for runs)")
    names, rows = _rows_of(values)
    try:
        found = answer_scene(study, names, rows, quantities, fidelity=fidelity, tolerance=tolerance, threads=threads)
    except ValueError as error:
        raise UsageError(str(error)) from error
    frame = pd.DataFrame({name: found.values[:, k] for k, name in enumerate(quantities)})
    frame["status"] = found.status
    frame["censored"] = np.asarray(found.censored.any(axis=1), dtype=bool)
    return frame


def _evaluate_box(
    study: Study, values: Mapping[str, npt.ArrayLike], quantities: Sequence[str], model: str | BlackBox | None
) -> pd.DataFrame:
    """Outputs of a black box at rows whose other inputs stand at their means."""
    import pandas as pd

    means = study.at_means()
    for name in values:
        if name not in means:
            raise UsageError(f"unknown input {name!r} (allowed: {', '.join(means)})")
    outputs = study.outputs if tuple(quantities) == ("p_max",) and "p_max" not in study.outputs else tuple(quantities)
    for name in outputs:
        if name not in study.outputs:
            raise UsageError(f"unknown output {name!r} (allowed: {', '.join(study.outputs)})")
    names, rows = _rows_of({name: values.get(name, mean) for name, mean in means.items()})
    box = load_black_box(model) if isinstance(model, str) else model
    found = answer_black_box(study, names, rows, outputs, box)
    frame = pd.DataFrame(found.values, columns=list(outputs))
    return frame.assign(status=found.status, censored=False)


def _rows_of(values: Mapping[str, npt.ArrayLike]) -> tuple[list[str], Array]:
    """Names, and columns of one length side by side (n, d); a single number stands in every row."""
    columns = {name: np.atleast_1d(np.asarray(column, dtype=float)) for name, column in values.items()}
    for name, column in columns.items():
        if column.ndim != 1:
            raise UsageError(f"{name} must have shape (n,), found {column.shape}")
    lengths = {len(column) for column in columns.values()}
    if len(lengths - {1}) > 1:
        raise UsageError(f"the columns of values differ in length: {sorted(lengths)}")
    n = next(iter(lengths - {1}), 1)
    if not columns:
        return [], np.zeros((n, 0))
    return list(columns), np.stack([np.broadcast_to(column, (n,)) for column in columns.values()], axis=1)


def status_text(code: int, black_box: bool) -> str:
    """What a row's status means, in words."""
    if black_box:
        return _BOX_STATUS.get(code, f"status {code}")
    from uqsphere.mechanics.scene import STATUS

    return STATUS.get(code, f"status {code}")
