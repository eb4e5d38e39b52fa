"""Rows around the study, so that a page can answer for other speeds, sizes and stiffnesses without a run.

Numbers that people move are drawn between ends together with all that scatters, the full model answers, and ln of every
demand becomes one polynomial of their logarithms.  Rows that it has not seen say how far it may be off.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.errors import UqsphereError
from uqsphere.model import is_answered, scene_of
from uqsphere.quantities import INPUTS
from uqsphere.results.entries import AxisEntry, SliderEntry, Sliders, SurfaceEntry, WayEntry
from uqsphere.runner.evaluate import Ledger, Work
from uqsphere.runner.evidence import with_ways
from uqsphere.runner.fidelity import solved
from uqsphere.runner.schedule import SLIDERS
from uqsphere.study import SPEED, Study, Way, law_json, spaced, ways_of, with_number
from uqsphere.uq import Law, LawError, sobol_points
from uqsphere.uq.expansion.germs import Indices, hyperbolic_indices, orthonormal_values, products
from uqsphere.uq.expansion.solvers import solve_rows

if TYPE_CHECKING:
    from uqsphere.runner.questions.margins import MarginAnswer

#: what people move first, in this order: the load, then sizes, then stiffness
_LOADS: Final = (SPEED, "rig.speed", "rig.drop_height", "hammer.speed", "hammer.drop_height")
_OTHERS: Final = ("sphere.radius", "bars.diameter", "target.thickness", "target.mass", "hammer.mass", "other.radius",
                  "rod.diameter", "sphere.E")  # fmt: skip
#: most sliders on a page
_MOST: Final = 5
#: ratio of an end to the study's number: a load, and anything else; a load reaches its answers by `_BEYOND`
_WIDE, _NEAR, _BEYOND, _FARTHEST = 2.0, 1.3, 1.2, 5.0
#: values at which the law of a number is told, to both sides
_NODES: Final = 9
#: quantile beyond which the rows of a law that stays in place are not covered
_TAIL: Final = 1e-5
#: highest degree, share of the rows that judge, and the quantile of their errors that is told
_DEGREE, _UNSEEN, _LEVEL = 6, 0.25, 0.95
#: an error in ln demand beyond which a surface tells nothing, and the share of rows that may lack an answer
_ROUGH, _LOST = 0.15, 0.01
#: normal score of the ends of a law that is moved
_FAR: Final = 4.0


def find_sliders(work: Work, margins: Mapping[str, MarginAnswer]) -> Sliders:
    """The sliders of a study and the surfaces of its limits' demands, with the reason where there are none."""
    study = work.study
    if study.black_box:
        return Sliders(reason="a model of your own is asked by a run alone")
    if not study.limits:
        return Sliders(reason="the study has no limits")
    count = min(SLIDERS.first, int(SLIDERS.share * study.analysis.budget.evaluations))
    if count < SLIDERS.least or work.ledger.stopped_by_time or work.ledger.interrupted:
        return Sliders(reason="the run was too short for it")
    try:
        sliders = _sliders(study, margins)
        if not sliders:
            return Sliders(reason="none of its numbers can be moved")
        wide, ways = with_ways(study)
        axes = _axes(study, sliders)
        values, points = _drawn(study, axes, count)
        scene = scene_of(wide, values, count)
        quantities = tuple(dict.fromkeys(limit.quantity for limit in wide.limits))
        # as the courses of a few scenes they are no evaluations of the study's budget
        beside = replace(work, ledger=Ledger())
        found = solved(beside, "sliders", scene, quantities, tolerance=max(study.model.tolerance, 1e-6))
    except (UqsphereError, LawError) as error:
        return Sliders(reason=str(error))
    surfaces, rough = {}, {}
    good = is_answered(found.status)
    for name in quantities:
        late = found.censored.get(name)
        fitted = _surface(points, found.values[name], good if late is None else good & ~late)
        if isinstance(fitted, str):
            rough[name] = fitted
        else:
            surfaces[name] = fitted
    return Sliders(evaluations=count, axes=axes, sliders=tuple(sliders), surfaces=surfaces, rough=rough,
                   ways=_ways(study, ways.assumed, sliders, surfaces))  # fmt: skip


def _sliders(study: Study, margins: Mapping[str, MarginAnswer]) -> list[SliderEntry]:
    """The numbers that can be moved: what is solved for, the load, sizes and stiffness."""
    means, axis = study.at_means(), None if study.margins is None else study.margins.axis
    free = axis.path if axis is not None and axis.kind == "number" else ""
    # the speed of a record is its own
    taken = {SPEED} if study.record is not None else set()
    found = []
    for name in dict.fromkeys([free, *_LOADS, *_OTHERS]):
        if name in taken or not (base := means.get(name, 0.0)) > 0.0:
            continue
        answers = [e.value / base for m in margins.values() for e in m.values.values() if e.value and name == free]
        wide = _WIDE if name == free or name in _LOADS else _NEAR
        reached = [1.0 / wide, wide, *_reached(answers)]
        entry = _slider(study, name, base, (min(reached) * base, max(reached) * base))
        found += [] if entry is None else [entry]
    return found[:_MOST]


def _reached(answers: Sequence[float]) -> list[float]:
    """Ratios to the study's number that a slider goes to, to show what was solved for."""
    near = [ratio for ratio in answers if 1.0 / _FARTHEST < ratio < _FARTHEST]
    return [end for ratio in near for end in (ratio / _BEYOND, ratio * _BEYOND)]


def _slider(study: Study, name: str, base: float, ends: tuple[float, float]) -> SliderEntry | None:
    """One number with the law that it has at every node; None where its law has no mean to move, or may be negative."""
    low, high = max(ends[0], INPUTS[name].lower), min(ends[1], INPUTS[name].upper)
    nodes = sorted({*spaced(low, base, _NODES), *spaced(base, high, _NODES)})
    centres, spreads = [], []
    for node in nodes:
        try:
            law = with_number(study, name, node).random.get(name)
        except LawError:
            return None
        below = middle = above = least = node
        if law is not None:
            below, middle, above, least = law.from_normal(np.array([-1.0, 0.0, 1.0, -_FAR])).tolist()
        if not least > 0.0 or not math.isfinite(above):
            return None
        centres.append(math.log(middle))
        spreads.append(0.5 * math.log(above / below))
    return SliderEntry(name=name, low=low, high=high, base=base, nodes=tuple(nodes), centres=tuple(centres),
                       spreads=tuple(spreads))  # fmt: skip


def _axes(study: Study, sliders: Sequence[SliderEntry]) -> tuple[AxisEntry, ...]:
    """What the rows are drawn over: the sliders with the scatter at their ends, and all else that scatters."""
    ends = []
    for one in sliders:
        spread = _FAR * one.spreads[0], _FAR * one.spreads[-1]
        ends.append((one.name, True, one.centres[0] - spread[0], one.centres[-1] + spread[1]))
    for name, law in study.random.items():
        if all(one.name != name for one in sliders):
            low, high = (float(end[0]) for end in (law.ppf(np.array([_TAIL])), law.isf(np.array([_TAIL]))))
            ends.append((name, True, math.log(low), math.log(high)) if low > 0.0 else (name, False, low, high))
    return tuple(
        AxisEntry(name=name, logarithm=logarithm, middle=0.5 * (low + high), half=0.5 * (high - low))
        for name, logarithm, low, high in ends
        if high > low or any(one.name == name for one in sliders)
    )


def _drawn(study: Study, axes: Sequence[AxisEntry], count: int) -> tuple[dict[str, Array], Array]:
    """Values (n,) of every axis by name, and the points (n, d) in [-1, 1] that they are drawn at."""
    unit = sobol_points(dimension=len(axes), count=count, start=0, seed=study.seed, task="sliders", replicate=0)
    points, values = 2.0 * unit - 1.0, {}
    for axis, column in zip(axes, points.T, strict=True):
        value = axis.middle + axis.half * column
        values[axis.name] = np.exp(value) if axis.logarithm else value
    return values, points


def _surface(points: Array, values: Array, known: Flags) -> SurfaceEntry | str:
    """The polynomial of ln values (n,) at points (n, d), the degree chosen by rows unseen; or why there is none."""
    known = known & np.isfinite(values)
    if known.mean() < 1.0 - _LOST or (values[known] <= 0.0).any():
        return f"the model answers {100.0 * known.mean():.3g} % of the settings"
    points, logs = points[known], np.log(values[known])
    seen = int((1.0 - _UNSEEN) * len(logs))
    best: tuple[float, Indices, Array] | None = None
    for degree in range(1, _DEGREE + 1):
        indices = hyperbolic_indices(points.shape[1], degree, 1.0, seen // 4)
        if indices is None:
            break
        tables = [orthonormal_values("uniform", points[:, k], degree) for k in range(points.shape[1])]
        rows = products(tables, indices)
        unseen = logs[seen:] - solve_rows(rows[:, :seen], logs[:seen]) @ rows[:, seen:]
        error = float(np.quantile(np.abs(unseen), _LEVEL))
        if best is None or error < best[0]:
            best = error, indices, solve_rows(rows, logs)
    if best is None or best[0] > _ROUGH:
        return "it is too rough for a polynomial"
    return _as_powers(*best)


def _as_powers(error: float, indices: Indices, coefficients: Array) -> SurfaceEntry:
    """Products of orthonormal Legendre polynomials as products of powers; what changes nothing is left out."""
    degree = int(indices.max(initial=0))
    # coefficients of the powers 0, 1, ... of every polynomial
    turn = [
        math.sqrt(2.0 * k + 1.0) * np.polynomial.legendre.leg2poly(np.eye(degree + 1)[k]) for k in range(degree + 1)
    ]
    sums: dict[tuple[int, ...], float] = {}
    for row, coefficient in zip(indices.tolist(), coefficients.tolist(), strict=True):
        for powers in itertools.product(*(range(k % 2, k + 1, 2) for k in row)):
            part = coefficient * math.prod(turn[k][p] for k, p in zip(row, powers, strict=True))
            sums[powers] = sums.get(powers, 0.0) + float(part)
    kept = {powers: value for powers, value in sums.items() if abs(value) > 1e-3 * error / len(sums)}
    return SurfaceEntry(
        powers=tuple(kept), coefficients=tuple(float(f"{value:.9g}") for value in kept.values()), error=error
    )


def _ways(
    study: Study, ways: Sequence[Way], sliders: Sequence[SliderEntry], surfaces: Mapping[str, SurfaceEntry]
) -> dict[str, WayEntry]:
    """The assumed ways whose demands have a surface, with how their strengths follow the size of the sphere."""
    found = {}
    sizes = [one for one in sliders if one.name == "sphere.radius"]
    for way in ways:
        base, scales = way.limit.strength, dict[str, list[float]]()
        if way.limit.quantity not in surfaces or not isinstance(base, Law):
            continue
        for slider in sizes:
            scale = []
            for node in slider.nodes:
                moved = ways_of(with_number(study, slider.name, node)).assumed
                other = next(one.limit.strength for one in moved if one.called == way.called)
                assert isinstance(other, Law)
                scale.append(math.log(other.median() / base.median()))
            if any(scale):
                scales[slider.name] = scale
        laws = [law_json(law, {}) for law in (way.weak, base, way.strong)]
        found[way.called] = WayEntry.model_validate({"quantity": way.limit.quantity, "laws": laws, "scales": scales})
    return found
