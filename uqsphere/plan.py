"""What a run will cost, estimated before anything heavy is loaded."""

from __future__ import annotations

import math
import os
from typing import Any

from uqsphere.errors import UsageError
from uqsphere.model import scene_of
from uqsphere.study import Study

__all__ = ["plan_run"]

#: seconds per step of the compiled integrator on one processor, as the shipped studies show it
_STEP_SECONDS = 0.5e-6
#: quantities that jump where a contact is lost one oscillation earlier: sampling is slow on them
_ROUGH = ("contact_time", "pulse_width", "rise_time", "loading_rate")


def _scene_numbers(study: Study) -> dict[str, float | None]:
    """mu, theta and the steps an evaluation takes, at the means."""
    scene = scene_of(study, {}, 1)
    mu = float(scene.scales.mass_number[0])
    theta = float(scene.scales.pulse_number[0])
    time = float(scene.scales.time[0])
    record = float(scene.record_end[0]) / time
    # contact is usually lost after about two round trips; infinite bars are followed for about 7 t_c
    if study.options["bars.infinite"]:
        record = min(record, (theta if math.isfinite(theta) else record) + 7.0)
    else:
        record = min(record, 2.0 * float(scene.round_trips[0].max()) / time)
    if not 0.0 < mu < math.inf or not theta > 0.0 or not math.isfinite(record):
        raise UsageError("the scene at its means cannot be computed: its numbers are beyond floating point")
    phase = record * math.sqrt(3.0 * math.sqrt(min(1.0, theta)) / mu)
    return {"mu": mu, "theta": theta if math.isfinite(theta) else None, "steps": 60.0 + phase}


def _rows(study: Study) -> int:
    """Evaluations for a base point of the indices: of all subsets, or of random orders, where inputs are tied."""
    d = len(study.random)
    if not any(sum(name in study.random for name in group.of) > 1 for group in study.dependence):
        return d + 2 + (d if study.analysis.second_order else 0) + len(study.analysis.groups)
    return 2**d if d <= 10 else 3 * d - 1


def _finer(asked: float) -> float:
    """How much finer than 1 % is asked for; beyond any budget it is all the same."""
    return 0.01 / max(asked, 1e-50)


def plan_run(study: Study) -> dict[str, Any]:
    """Evaluations and seconds that a run will take, roughly; seconds None for a black box.

    The sizes are those at which the shipped studies reach their accuracy: quantiles to 1 % of the standard
    deviation take some 65,000 points, twice as many for quantities that jump; indices to 0.01 some 4,000 base
    points, and twenty times as many where a quantity jumps.
    """
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    asked = study.analysis.accuracy
    d = len(study.random)
    if d == 0 and not study.limits:
        evaluations = 1
    else:
        rough = any(name in _ROUGH for name in study.analysis.quantities)
        sampling = 65_536 * _finer(asked.quantile) ** 1.5 * (2.0 if rough else 1.0)
        analysis = study.analysis
        blocks = _rows(study)
        sensitivity = blocks * (80_000 * _finer(asked.sobol) ** 2 if rough else 4_096 * _finer(asked.sobol) ** 1.2)
        margins = 20_000 if study.margins is not None else 0
        planned = max(2_048.0, sampling) + max(1_024.0 * blocks, sensitivity) + margins
        planned += analysis.tolerance_intervals.runs if analysis.tolerance_intervals else 0
        evaluations = round(min(planned, study.analysis.budget.evaluations), -3)
    plan: dict[str, Any] = {"evaluations": int(evaluations), "processors": processors, "seconds": None, "scene": None}
    if not study.black_box:
        numbers = _scene_numbers(study)
        plan["scene"] = {"mu": numbers["mu"], "theta": numbers["theta"]}
        steps = numbers["steps"] or 0.0
        plan["seconds"] = round(4.0 + evaluations * steps * _STEP_SECONDS / processors, 1)
    return plan
