"""What a run will cost, estimated before anything heavy is loaded."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from typing import Any

from uqsphere.errors import UsageError
from uqsphere.model import scene_of
from uqsphere.runner.forecast import CHEAPER, forecast, rough_quantities
from uqsphere.runner.ways import FITS, OVERHEAD, choose_way
from uqsphere.study import Study
from uqsphere.study.faults import one_of

__all__ = ["plan_run", "plan_text"]

#: seconds per step of the compiled integrator on one processor, as the shipped studies show it
_STEP_SECONDS = 0.5e-6
#: seconds to start and to write the report; those of a limit beside its evaluations, and of each of its curves
_START, _LIMIT, _CURVE = 4.0, 1.0, 2.5
#: parts whose seconds are told
_DEAREST = 3


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


def plan_run(study: Study) -> dict[str, Any]:
    """Evaluations and seconds that a run will take, roughly, and by which way.

    Seconds are None for a black box whose cost is not given, and so is its way where the cost decides.
    """
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    way = choose_way(study)
    parts = forecast(study, way.affordable, way.surrogate)
    evaluations = min(sum(part.likely for part in parts), way.affordable)
    cost = study.analysis.cost
    known = not study.black_box or cost is not None or way.surrogate or "auto" not in study.analysis.methods
    plan: dict[str, Any] = {"evaluations": int(evaluations), "processors": processors, "seconds": None, "scene": None}
    # a row of a cheaper model costs a fraction of one of the chosen model: it is no part of the sum
    plan["most"] = min(sum(part.most for part in parts if part.name not in CHEAPER), way.affordable)
    plan["cheaper"] = min(sum(part.most for part in parts if part.name in CHEAPER), way.affordable)
    plan["parts"] = [{"part": part.name, "likely": part.likely, "most": part.most} for part in parts]
    plan["way"] = ("surrogate" if way.surrogate else "sampling") if known else None
    plan["why"] = way.why if known else "the first runs of the model are timed, and that decides"
    if study.black_box:
        plan["crossover_seconds_per_evaluation"] = float(f"{way.crossover:.2g}")
        plan["balance_seconds_per_evaluation"] = float(f"{way.balance:.2g}")
        overhead = OVERHEAD + FITS * len(study.analysis.quantities) if way.surrogate else OVERHEAD
        plan["seconds"] = None if cost is None else round(evaluations * cost + overhead, 1)
        if cost is not None:
            _time_parts(plan, cost, {})
    if not study.black_box:
        numbers = _scene_numbers(study)
        plan["scene"] = {"mu": numbers["mu"], "theta": numbers["theta"]}
        steps = numbers["steps"] or 0.0
        _time_parts(plan, steps * _STEP_SECONDS / processors, _beside(study))
        plan["seconds"] = round(_START + sum(part["seconds"] for part in plan["parts"]), 1)
    return plan


def _beside(study: Study) -> dict[str, float]:
    """Seconds that parts take beside their evaluations."""
    limits, margins = len(study.limits), study.margins
    curves = 0 if margins is None else 1 + (len(margins.family.values) if margins.family else 0)
    return {"rare events": _LIMIT * limits, "margins": _CURVE * limits * curves}


def _time_parts(plan: dict[str, Any], each: float, beside: Mapping[str, float]) -> None:
    """Give every part its seconds, at so many for an evaluation."""
    for part in plan["parts"]:
        part["seconds"] = round(part["likely"] * each + beside.get(part["part"], 0.0), 1)


def _three(number: int) -> int:
    """A forecast to three digits, which is more than it is good for.

    >>> _three(234_772)
    235000
    """
    return int(float(f"{number:.3g}"))


def _two(seconds: float) -> str:
    """Two digits, without an exponent that nobody reads."""
    return f"{seconds:.2g}" if seconds < 100.0 else f"{float(f'{seconds:.2g}'):,.0f}"


def plan_text(study: Study, plan: Mapping[str, Any]) -> str:
    """The plan for the terminal."""
    likely, most = _three(plan["evaluations"]), _three(plan["most"])
    lines = [f"evaluations: about {likely:,}, at most {most:,}"]
    rough = rough_quantities(study)
    if rough and most > likely:
        lines[0] += f" (several times the first where {one_of(rough)} is rough)"
    told = [
        f"{part['part']} {_three(part['likely']):,}"
        + (f" to {_three(part['most']):,}" if part["most"] > part["likely"] else "")
        for part in plan["parts"]
        if part["part"] not in CHEAPER
    ]
    if len(told) > 1:
        lines.append(f"of which: {'; '.join(told)}")
    if plan["cheaper"]:
        lines.append(
            f"besides: up to {_three(plan['cheaper']):,} of a cheaper model, if the pilot finds that it saves time"
        )
    if plan["seconds"] is None:
        lines.append("time: depends on the model that is given with --model")
    elif study.black_box:
        lines.append(f"time: about {plan['seconds']:,.0f} s, one evaluation after the other")
    else:
        about = f"{plan['seconds']:.0f} s on {plan['processors']} processors"
        lines.append(f"time: about {about} (20 s more to compile at first)")
    dear = sorted((p for p in plan["parts"] if p.get("seconds")), key=lambda p: -p["seconds"])[:_DEAREST]
    if dear:
        lines.append("most of it: " + ", ".join(f"{p['part']} {_two(p['seconds'])} s" for p in dear))
    lines.append(f"way: {plan['way'] or 'not known yet'}: {plan['why']}")
    if study.black_box:
        crossover = plan["crossover_seconds_per_evaluation"]
        balance = plan["balance_seconds_per_evaluation"]
        text = f"crossover: above {crossover:g} s an evaluation a surrogate is taken, below it sampling"
        if balance < crossover:
            text += f" (it takes less time above {balance:g} s already, but answers less)"
        lines.append(text)
    return "\n".join(lines)
