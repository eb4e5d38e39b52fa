"""What a run will cost, estimated before anything heavy is loaded."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Any

from uqsphere.model import scene_of
from uqsphere.study import Study

__all__ = ["FIRST_SAMPLE", "Way", "choose_way", "plan_run"]

#: seconds per step of the compiled integrator on one processor, as the shipped studies show it
_STEP_SECONDS = 0.5e-6
#: evaluations that sampling begins with, and that a surrogate of a smooth model is content with
FIRST_SAMPLE = 2_048
_RUNS = 256
#: seconds that a surrogate takes besides the runs of the model: at all, and for the fits of each quantity
_OVERHEAD, _FITS = 5.0, 5.0
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
    phase = record * math.sqrt(3.0 * math.sqrt(min(1.0, theta)) / mu)
    return {"mu": mu, "theta": theta if math.isfinite(theta) else None, "steps": 60.0 + phase}


def _rows(study: Study) -> int:
    """Evaluations for a base point of the indices: of all subsets, or of random orders, where inputs are tied."""
    d = len(study.random)
    if not any(sum(name in study.random for name in group.of) > 1 for group in study.dependence):
        return d + 2 + (d if study.analysis.second_order else 0) + len(study.analysis.groups)
    return 2**d if d <= 10 else 3 * d - 1


@dataclass(frozen=True, kw_only=True)
class Way:
    """By which way a study is answered.

    Attributes
    ----------
    surrogate : whether through a surrogate; else by sampling
    why : in a clause without seconds
    sampling, runs : evaluations that sampling, and that a surrogate, are forecast to take
    crossover : cost of an evaluation above which the surrogate takes less time [s]
    affordable : evaluations that the budget allows
    """

    surrogate: bool
    why: str
    sampling: int
    runs: int
    crossover: float
    affordable: int


def _sampling(study: Study) -> float:
    """Evaluations that sampling takes for the accuracies asked for, whatever the budget.

    The sizes are those at which the shipped studies reach their accuracy: quantiles to 1 % of the standard
    deviation take some 65,000 points, twice as many for quantities that jump; indices to 0.01 some 4,000 base
    points, and twenty times as many where a quantity jumps.
    """
    if not study.random and not study.limits:
        return 1.0
    analysis, asked = study.analysis, study.analysis.accuracy
    rough = any(name in _ROUGH for name in analysis.quantities)
    sampling = 65_536 * (0.01 / asked.quantile) ** 1.5 * (2.0 if rough else 1.0)
    blocks = _rows(study)
    sensitivity = blocks * (80_000 * (0.01 / asked.sobol) ** 2 if rough else 4_096 * (0.01 / asked.sobol) ** 1.2)
    margins = 20_000 if study.margins is not None else 0
    planned: float = max(float(FIRST_SAMPLE), sampling) + max(1_024.0 * blocks, sensitivity) + margins
    return planned + (analysis.tolerance_intervals.runs if analysis.tolerance_intervals else 0)


def choose_way(study: Study, cost: float | None = None, seconds: float | None = None) -> Way:
    """The cheaper way, by the cost of an evaluation.

    Parameters
    ----------
    study : Study
    cost : seconds of an evaluation; None: `analysis.cost`, and where that is not given either, no cost is known.
    seconds : time budget in place of the study's.

    With n evaluations by sampling, m by a surrogate and its overhead o the two take n c and m c + o: the surrogate
    is taken above the crossover c = o/(n - m), or where the budget has no room for sampling at all.
    """
    analysis = study.analysis
    cost = analysis.cost if cost is None else cost
    seconds = analysis.budget.time if seconds is None else seconds
    planned = round(_sampling(study))
    affordable = analysis.budget.evaluations
    if cost and cost * affordable > seconds:
        affordable = int(seconds / cost)
    overhead = _OVERHEAD + _FITS * len(analysis.quantities)
    crossover = overhead / max(planned - _RUNS, 1)

    def way(surrogate: bool, why: str) -> Way:
        return Way(surrogate=surrogate, why=why, sampling=planned, runs=_RUNS, crossover=crossover,
                   affordable=affordable)  # fmt: skip

    if not study.random:
        return way(False, "the model has no random input")
    if not study.black_box:
        return way(False, "the impact model takes microseconds a row: sampling takes less time than a surrogate")
    if "auto" not in analysis.methods:
        return way(False, "the study lists its methods")
    if affordable < FIRST_SAMPLE:
        return way(True, f"the budget has no room for the {FIRST_SAMPLE:,} evaluations that sampling begins with")
    if cost is None:
        return way(False, "the cost of an evaluation is not known")
    forecast = f"sampling is forecast to take {planned:,} evaluations, a surrogate some {_RUNS}"
    if cost > crossover:
        return way(True, f"{forecast} and a time for its fits that this model would be sampled no longer in")
    return way(False, f"{forecast}, but its fits would take longer than sampling so cheap a model")


def plan_run(study: Study) -> dict[str, Any]:
    """Evaluations and seconds that a run will take, roughly, and by which way.

    Seconds are None for a black box whose cost is not given, and so is its way where the cost decides.
    """
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    way = choose_way(study)
    planned = way.runs if way.surrogate else way.sampling
    evaluations = min(planned, way.affordable)
    if planned > 1 and not way.surrogate:
        evaluations = round(evaluations, -3)
    cost = study.analysis.cost
    known = not study.black_box or cost is not None or way.surrogate or "auto" not in study.analysis.methods
    plan: dict[str, Any] = {"evaluations": int(evaluations), "processors": processors, "seconds": None, "scene": None}
    plan["way"] = ("surrogate" if way.surrogate else "sampling") if known else None
    plan["why"] = way.why if known else "the first runs of the model are timed, and that decides"
    if study.black_box:
        plan["crossover_seconds_per_evaluation"] = float(f"{way.crossover:.2g}")
        overhead = _OVERHEAD + _FITS * len(study.analysis.quantities) if way.surrogate else _OVERHEAD
        plan["seconds"] = None if cost is None else round(evaluations * cost + overhead, 1)
    if not study.black_box:
        numbers = _scene_numbers(study)
        plan["scene"] = {"mu": numbers["mu"], "theta": numbers["theta"]}
        steps = numbers["steps"] or 0.0
        plan["seconds"] = round(4.0 + evaluations * steps * _STEP_SECONDS / processors, 1)
    return plan
