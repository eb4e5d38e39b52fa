"""The kernel over the whole range of inputs: against the reference, and against itself at a closer tolerance.

    uqsphere bench --sweep 2000 --reference

A row is wrong and silent if it has an answer and a quantity is off by more than five times the tolerance; a row of
status 7 has two answers, of which one has to be right, or the times of events lie between them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.bench.hard_scenes import Design, as_inputs, rows_of
from uqsphere.mechanics.integrator.solve import Answers, solve
from uqsphere.mechanics.scene import STATUS, Scene, answered
from uqsphere.quantities import OUTPUTS

__all__ = ["Comparison", "Wrong", "against_itself", "against_reference", "as_document", "join", "table"]

Array = npt.NDArray[np.float64]

#: an error may be this many times the tolerance that was asked for
ALLOWED: Final = 5.0
#: rows that the kernel is given at once
_BATCH: Final = 8192


@dataclass(frozen=True, kw_only=True)
class Wrong:
    """A row that is wrong: inputs, status, similarity numbers, and (found, expected, error over tolerance).

    With status 0 it is silent; with status 7 it said that it was not sure, but neither of its answers is right, and no
    time lies between them.
    """

    inputs: dict[str, Any]
    status: int
    mu: float
    theta: float
    quantities: dict[str, tuple[float, float, float]]
    note: str


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Errors of n rows over the tolerance, (n, quantities), NaN where there is nothing to compare.

    `status` (n,) are those of the kernel at `tolerance`; `judged` (n,) says where the other side has an answer;
    `mu`, `theta` (n,); `steps` (n,) of the kernel.
    """

    names: tuple[str, ...]
    errors: Array
    status: npt.NDArray[np.int64]
    judged: npt.NDArray[np.bool_]
    mu: Array
    theta: Array
    steps: npt.NDArray[np.int64]
    wrong: tuple[Wrong, ...]
    tolerance: float
    judge: str

    @property
    def silent(self) -> tuple[Wrong, ...]:
        """Rows that are wrong and do not say so."""
        return tuple(row for row in self.wrong if row.status == 0)


#: quantities that follow from others row by row: their errors are those of the pressure
_DERIVED: Final = frozenset(
    {"core_tension", "equatorial_tension", "hiramatsu_oka_tension", "subsurface_shear", "ring_crack_toughness"}
)


def _names(answers: Answers) -> tuple[str, ...]:
    return tuple(name for name in OUTPUTS if name in answers.values and name not in _DERIVED)


#: times of events, of which an undecided row has an earlier and a later one
_TIMES: Final = frozenset({"contact_time", "pulse_width", "rise_time"})
#: one set of answers: values by name, and which times were cut off by the record's end (None: not known)
_Answer = tuple[Mapping[str, Any], Mapping[str, Any] | None]


def _answers(found: Answers, rows: Any) -> list[_Answer]:
    """The answers of some rows; two where a row is undecided."""
    sets: list[_Answer] = [
        (
            {name: value[rows] for name, value in found.values.items()},
            {name: flag[rows] for name, flag in found.censored.items()},
        )
    ]
    if found.others:
        sets.append(({name: value[rows] for name, value in found.others.items()}, None))
    return sets


def _error(name: str, found: _Answer, truth: _Answer, tolerance: float) -> Array:
    """Error of one quantity over the tolerance.

    It is relative, but for the force imbalance, a difference of two forces over the largest: absolute.  A time
    that one side says was cut off by the record's end and the other says was not differs without bound, unless
    both times agree.
    """
    value, expected = np.asarray(found[0][name]), np.asarray(truth[0][name])
    with np.errstate(all="ignore"):
        error = np.abs(value - expected) / (1.0 if name == "force_imbalance" else np.abs(expected)) / tolerance
    error = np.where(value == expected, 0.0, error)
    if found[1] is not None and truth[1] is not None and name in truth[1]:
        error = np.where((found[1][name] != truth[1][name]) & (error > ALLOWED), np.inf, error)
    return np.asarray(error)


def _errors(names: Sequence[str], found: Sequence[_Answer], truths: Sequence[_Answer], tolerance: float) -> Array:
    """Errors over the tolerance, last axis the quantities; of an undecided row, those of the nearer answer.

    Between the two answers of an undecided row there may be more: a time between them is none of its errors.
    """
    columns = []
    for name in names:
        error = np.fmin.reduce([_error(name, one, truth, tolerance) for one in found for truth in truths])
        if len(found) > 1 and name in _TIMES:
            ends = np.stack([np.asarray(one[0][name]) for one in found])
            for truth in truths:
                expected = np.asarray(truth[0][name])
                error = np.where((ends.min(axis=0) <= expected) & (expected <= ends.max(axis=0)), 0.0, error)
        columns.append(error)
    return np.stack(columns, axis=-1)


def _wrong(scene: Scene, row: Any, found: Answers, errors: Array, expected: Mapping[str, Any], note: str = "") -> Wrong:
    names = _names(found)
    return Wrong(
        inputs=as_inputs(scene, row),
        status=int(found.status[row]),
        mu=float(scene.scales.mass_number[row]),
        theta=float(scene.scales.pulse_number[row]),
        quantities={
            name: (float(found.values[name][row]), float(expected[name]), float(error))
            for name, error in zip(names, errors, strict=True)
            if not error <= ALLOWED
        },
        note=note,
    )


def _compare(plan: Design, start: int, count: int, tolerance: float, judge: str, parts: Any) -> Comparison:
    """Put the answers of every scene of a slice together; `parts` yields (scene, places, answers, errors, judged,
    wrong)."""
    count = len(plan.order[start : start + count])
    names: tuple[str, ...] = ()
    errors = np.empty((count, 0))
    status, steps = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    judged = np.zeros(count, dtype=bool)
    mu, theta = np.zeros(count), np.zeros(count)
    wrong: list[Wrong] = []
    for scene, places, answers, found, known, off in parts:
        if not names:
            names = _names(answers)
            errors = np.full((count, len(names)), np.nan)
        errors[places], judged[places] = found, known
        status[places], steps[places] = answers.status, answers.steps
        mu[places], theta[places] = scene.scales.mass_number, scene.scales.pulse_number
        wrong += off
    return Comparison(names=names, errors=errors, status=status, judged=judged, mu=mu, theta=theta, steps=steps,
                      wrong=tuple(wrong), tolerance=tolerance, judge=judge)  # fmt: skip


def against_itself(
    plan: Design,
    *,
    start: int = 0,
    count: int | None = None,
    tolerance: float = 1e-6,
    closer: float = 1e-8,
    quantities: Collection[str] | None = None,
) -> Comparison:
    """The kernel at `tolerance` against the kernel at `closer`, rows [start, start + count) of a design."""

    def parts(begin: int, size: int) -> Any:
        for scene, places in rows_of(plan, begin, size):
            found = solve(scene, tolerance=tolerance, quantities=quantities)
            truth = solve(scene, tolerance=closer, quantities=quantities)
            # a judge that is not sure itself is heard where the row is not sure either
            known = answered(found.status) & ((truth.status == 0) | (found.status == truth.status))
            known &= answered(truth.status)
            every = slice(None)
            errors = _errors(_names(found), _answers(found, every), _answers(truth, every), tolerance)
            errors[~known] = np.nan
            off = [
                _wrong(scene, row, found, errors[row], {name: truth.values[name][row] for name in truth.values})
                for row in np.flatnonzero(known & ~(errors <= ALLOWED).all(axis=1))
            ]
            yield scene, places, found, errors, known, off

    count = len(plan) - start if count is None else count
    slices = range(start, start + count, _BATCH)
    sizes = [min(_BATCH, start + count - begin) for begin in slices]
    judge = f"the kernel at {closer:g}"
    return join([
        _compare(plan, begin, size, tolerance, judge, parts(begin, size))
        for begin, size in zip(slices, sizes, strict=True)
    ])  # fmt: skip


def against_reference(
    plan: Design,
    *,
    start: int = 0,
    count: int | None = None,
    tolerance: float = 1e-6,
    budget: int = 3000,
    quantities: Collection[str] | None = None,
) -> Comparison:
    """The kernel at `tolerance` against the reference, rows [start, start + count) of a design.

    A scene that would take the reference more than `budget` steps is not judged.
    """
    from uqsphere.bench.reference import Unaffordable, refer

    def parts(size: int) -> Any:
        for scene, places in rows_of(plan, start, size):
            found = solve(scene, tolerance=tolerance, quantities=quantities)
            names = _names(found)
            errors, known = np.full((len(scene), len(names)), np.nan), np.zeros(len(scene), dtype=bool)
            off = []
            for row in np.flatnonzero(scene.status == 0):
                try:
                    truth = refer(scene, int(row), budget=budget)
                except Unaffordable:
                    continue
                known[row] = True
                if not answered(found.status[row]):
                    continue
                errors[row] = _errors(names, _answers(found, row), [(truth.values, truth.censored)], tolerance)
                if not (errors[row] <= ALLOWED).all():
                    note = f"reference: {truth.steps} steps, tail {truth.tail:.0e}"
                    if truth.dips:
                        at, depth = min(truth.dips, key=lambda dip: abs(dip[1]))
                        note += f", nearest miss {depth:.1e} of the largest approach at {at!r} s"
                    off.append(_wrong(scene, row, found, errors[row], truth.values, note))
            yield scene, places, found, errors, known, off

    count = len(plan) - start if count is None else count
    return _compare(plan, start, count, tolerance, "the reference", parts(count))


def join(comparisons: Sequence[Comparison]) -> Comparison:
    """Slices of one comparison as one."""
    first = comparisons[0]

    def stack(name: str) -> Any:
        return np.concatenate([getattr(one, name) for one in comparisons])

    return Comparison(
        names=first.names, errors=stack("errors"), status=stack("status"), judged=stack("judged"), mu=stack("mu"),
        theta=stack("theta"), steps=stack("steps"), tolerance=first.tolerance, judge=first.judge,
        wrong=tuple(wrong for one in comparisons for wrong in one.wrong),
    )  # fmt: skip


def table(found: Comparison) -> str:
    """The comparison as text: errors over the tolerance by quantity, rows by status, wrong and silent rows."""
    compared = found.judged & answered(found.status)
    sides = f"kernel at {found.tolerance:g} against {found.judge}"
    lines = [
        f"{len(found.status)} scenes, {sides}; {int(compared.sum())} compared",
        "",
        "| error over tolerance | median | 99.9 % | worst | rows above 5 |",
        "|---|---|---|---|---|",
    ]
    errors = found.errors[compared]
    for name, column in zip(found.names, errors.T, strict=True):
        if len(column):
            middle, high = np.quantile(column, [0.5, 0.999], method="higher")
            above = int((~(column <= ALLOWED)).sum())
            lines.append(f"| `{name}` | {middle:.1e} | {high:.2g} | {column.max():.2g} | {above} |")
    lines += ["", "| status | rows | not judged | mu | theta | meaning |", "|---|---|---|---|---|---|"]
    for code in np.unique(found.status):
        here = found.status == code
        mu, theta = found.mu[here], found.theta[here]
        lines.append(
            f"| {code} | {int(here.sum())} | {int((here & ~found.judged).sum())} | {mu.min():.0e} to {mu.max():.0e} | "
            f"{theta.min():.0e} to {theta.max():.0e} | {STATUS[int(code)]} |"
        )
    flagged = len(found.wrong) - len(found.silent)
    lines += ["", f"wrong and silent: {len(found.silent)} rows; undecided, and beside both answers: {flagged} rows"]
    for wrong in sorted(found.wrong, key=lambda row: row.status):
        listed = ", ".join(f"{name} {error:.2g}" for name, (_, _, error) in wrong.quantities.items())
        which = f"status {wrong.status}, mu {wrong.mu:.3g}, theta {wrong.theta:.3g}, {wrong.inputs['shape']}"
        lines.append(f"- {which}: {listed}{'; ' if wrong.note else ''}{wrong.note}")
        if wrong.status == 0:
            lines.append(f"  {wrong.inputs}")
    return "\n".join(lines)


def as_document(found: Comparison) -> dict[str, Any]:
    """The comparison for JSON: errors over the tolerance by quantity (null: not compared), statuses, wrong rows."""
    return {
        "judge": found.judge,
        "tolerance": found.tolerance,
        "errors_over_tolerance": {
            name: [float(e) if np.isfinite(e) else None for e in column]
            for name, column in zip(found.names, found.errors.T, strict=True)
        },
        "status": found.status.tolist(),
        "wrong_and_silent": [asdict(row) for row in found.silent],
        "undecided_and_wrong": [asdict(row) for row in found.wrong if row.status != 0],
    }
