"""What each part of a run is likely to evaluate, and the most, before anything is evaluated.

The likely numbers are those at which the shipped studies reach their accuracy.  They cannot know how rough the model
is or how rare a failure: that is what the most is for.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Final, TypedDict

from uqsphere.errors import UsageError
from uqsphere.mechanics.criteria import CARRIERS
from uqsphere.mechanics.rigs import RIGS
from uqsphere.model import cheaper_fidelities, scene_of
from uqsphere.quantities import INPUTS, format_value, lookup
from uqsphere.runner.schedule import (
    ALONG,
    CARRIED,
    CAUTION,
    CHECKED,
    CURVE,
    CURVE_VALUES,
    DESIGN_POINT,
    FIRST_SAMPLE,
    FRACTURE,
    FRACTURE_CURVE,
    FREE_CURVE,
    INDICES,
    LEARNED,
    LOOK,
    MANY,
    MOST_LEARNED,
    PILOT,
    RARE,
    REPLICATES,
    SAMPLING,
    SPECIMENS,
    SURROGATE,
    TABLE,
    WAYS,
    WAYS_CURVE,
    least_learned,
    more_to_come,
    pilot_points,
)
from uqsphere.study import Limit, Study, means_fracture
from uqsphere.study.document import FURTHER
from uqsphere.study.faults import one_of
from uqsphere.uq import Law

#: Student's t of sixteen replicates
_T: Final = 2.13
#: factor that the first sample's quasi-random points save of quantiles: of the impact model, and of a black box, of
#: which nothing is known.  It grows with the root of the points, since half-widths fall with their power 3/4
_GAIN: Final = (2.0, 0.5)
#: probability that a limit of fixed strength is taken to have, where it has no target above it
_CHANCE: Final = 0.05
#: base points of the indices for outputs that jump, at the most
_ROUGHEST: Final = 200_000
#: curves: the look and twice the first rows, thrice at the most; seven times where a strength is fixed, of which a row
#: tells on which side it lies alone; the design point and the checks at the answer of each limit
_LOOK, _ROWS = REPLICATES * LOOK.first * LOOK.most, REPLICATES * CURVE.first * CURVE_VALUES
_CURVE, _CURVE_MOST, _CURVE_FIXED, _ANSWER = (*(_LOOK + k * _ROWS for k in (2, 3, 7)), DESIGN_POINT + CHECKED)
#: the part in which the ways to break are judged
JUDGED: Final = "ways to break"


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of a run: its name, the evaluations it is likely to take, and the most."""

    name: str
    likely: int
    most: int


def base_rows(study: Study) -> int:
    """Evaluations for a base point of the indices: of all subsets, or of random orders, where inputs are tied."""
    d = len(study.random)
    if not any(sum(name in study.random for name in group.of) > 1 for group in study.dependence):
        return d + 2 + (d if study.analysis.second_order else 0) + len(study.analysis.groups)
    return 2**d if d <= 10 else 3 * d - 1


def _counted(study: Study) -> float:
    """Points that a limit of fixed strength takes, of which a row tells only on which side it lies."""
    return (_T / max(study.analysis.accuracy.probability, 1e-50)) ** 2 * (1.0 - _CHANCE) / _CHANCE


def _sampling(study: Study, budget: float) -> tuple[float, float]:
    """Points that sampling takes for its quantiles, for an output near normal, in its stages; the most where the model
    is rough, or the accuracy is pursued as far as the budget goes.

    n = (t sqrt(p (1 - p))/(phi(z_p) e))^2 for the half-width e over the standard deviation by plain Monte Carlo.
    """
    analysis, normal, plain = study.analysis, NormalDist(), 1.0
    for p in analysis.quantiles:
        plain = max(plain, p * (1.0 - p) / normal.pdf(normal.inv_cdf(p)) ** 2)
    plain *= (_T / max(analysis.accuracy.quantile, 1e-50)) ** 2
    # n = plain/gain with a gain that is itself a multiple of the root of n
    first = _GAIN[1] if study.black_box else _GAIN[0]
    smooth = (plain * math.sqrt(FIRST_SAMPLE) / first) ** (2.0 / 3.0)
    # the mean of smooth outputs is known long before its quantiles, the root of the points ahead
    mean = (_T / max(analysis.accuracy.mean, 1e-50)) ** (4.0 / 3.0)
    counted = _counted(study) if _fixed(study) else 0.0
    # what the budget has too few rows to count is searched for
    counted = 0.0 if "auto" in analysis.methods and counted > budget else counted
    likely, most = max(min(smooth, plain), mean, counted), 2.0 * max(plain, counted)
    room = (SAMPLING.share if more_to_come(study) else 1.0) * budget
    if likely > CAUTION * room and not analysis.budget.exhaust:
        # the accuracy is given up as soon as it is seen to be out of reach
        likely, most = REPLICATES * SAMPLING.judged, room
    stages = []
    for points in (likely, most):
        steps = max(0, round(math.log2(max(points, 1.0) / FIRST_SAMPLE))) if math.isfinite(points) else 49
        while steps and FIRST_SAMPLE * 2**steps > room:
            steps -= 1
        stages.append(FIRST_SAMPLE * 2.0**steps)
    return stages[0], stages[1]


def _fixed(study: Study) -> bool:
    """Whether a limit has a strength that does not scatter."""
    return any(not isinstance(limit.strength, Law) for limit in study.limits)


def rough_quantities(study: Study) -> tuple[str, ...]:
    """Quantities whose indices may take several times what is likely: how rough they are shows with the first rows."""
    sampled = study.random and not study.black_box and study.analysis.samples_indices
    return tuple(name for name in study.analysis.quantities if lookup(name).rough) if sampled else ()


def _sensitivity(study: Study) -> tuple[float, float]:
    """Evaluations of the indices, likely and most: with a surrogate as control variate their first stage is enough."""
    analysis, blocks, first = study.analysis, base_rows(study), REPLICATES * INDICES.first
    if not analysis.samples_indices or not study.random:
        return 0.0, 0.0
    # how much finer than 1 % is asked for; beyond any budget it is all the same
    finer = 0.01 / max(analysis.accuracy.sobol, 1e-50)
    most = max(first, _ROUGHEST * finer**2)
    if rough := max((lookup(name).rough for name in rough_quantities(study)), default=0):
        # a table of the scaled numbers takes the place of so many pairs, where the inputs act through few
        likely = min(blocks * rough * finer**2, blocks * first + 2 * TABLE.most)
        return max(float(blocks * first), likely), blocks * most
    helped = {"auto", "pce"} & set(analysis.methods)
    # the first stage has been enough for half a per cent
    base = first * max(1.0, 0.5 * finer) ** 1.2 if helped else 4 * first * finer**1.2
    return blocks * max(float(first), base), blocks * most


def _curves(study: Study) -> int:
    """Curves of every limit: the study's own, and those of a family."""
    margins = study.margins
    return 0 if margins is None else 1 + (len(margins.family.values) if margins.family else 0)


def _margins(study: Study, budget: float) -> tuple[float, float]:
    """Evaluations of the curves: the look, rows at forty values, and what is found out at the answers."""
    curves, still = _curves(study), not _moves(study)
    if not curves or not study.limits:
        return 0.0, 0.0
    answers = float(_ANSWER * len(study.limits))
    likely = (
        curves * (1.5 * REPLICATES * FREE_CURVE.first if still else _CURVE_FIXED if _fixed(study) else _CURVE) + answers
    )
    # a curve takes its first rows whatever the share
    least = curves * (REPLICATES * FREE_CURVE.first if still else _CURVE_MOST) + answers
    if not math.isfinite(budget):
        return likely, max(likely, least)
    most = max(CURVE.share * budget, least)
    return min(likely, most), most


def _pilot(study: Study, budget: float) -> tuple[int, int]:
    """Evaluations of the first look: the full model on all its points, what it is compared with on half of them."""
    points = 1 if not study.random else pilot_points(int(min(budget, 1e9)))
    if points == 1:
        return 1, 1
    half, asked = points // 2, study.model.fidelity
    # the cheaper models, and the full one at a closer tolerance where neither is taken
    others = (len(cheaper_fidelities(study)) + 1 if points >= PILOT.least else 1) if asked == "auto" else 1
    return points + others * half, points + others * half


def _rare(study: Study, budget: float) -> tuple[float, float]:
    """Evaluations for the limits: the design points of each, and the search for those that are rare."""
    limits = study.limits
    searched = {"auto", "form", "importance", "subset"} & set(study.analysis.methods)
    if not (limits and study.random and searched):
        return 0.0, 0.0
    share = (RARE.share if more_to_come(study) else 1.0) * budget / len(limits)
    beyond = "auto" in study.analysis.methods and _counted(study) > budget
    rare = sum(
        (limit.target is not None and limit.target < 1e-4) or (beyond and not isinstance(limit.strength, Law))
        for limit in limits
    )
    design = DESIGN_POINT if share >= DESIGN_POINT else 0
    # a search goes on to twice the least that is worth beginning
    return rare * min(2 * RARE.least, share) + (len(limits) - rare) * design, len(limits) * min(RARE.most, share)


def fracture_limits(study: Study) -> tuple[Limit, ...]:
    """The limits of a study whose exceedance breaks the sphere."""
    from uqsphere.mechanics.outputs import path_of

    if study.black_box or study.options.get("contact.law") == "damage":
        # blows before the last leave no path from first touch
        return ()
    known = (limit for limit in study.limits if limit.fracture is not False)
    return tuple(limit for limit in known if path_of(limit.quantity, study.demands) is not None)


def reflected(study: Study) -> bool:
    """Whether waves come back from the ends of the bars, so that the first loading is a part of the record alone."""
    ends = [f"bars.{bar}_end" for bar in ("incident", "receiving")]
    echoes = any(study.at_means().get(end, 0.0) or end in study.random for end in ends)
    return echoes and not study.options.get("bars.infinite") and not study.model.first_loading_only


def _fracture(study: Study, budget: float) -> tuple[float, float]:
    """Evaluations for the moment of fracture, the first loading, and the curve of all limits that break the sphere."""
    limits = fracture_limits(study)
    if not limits:
        return 0.0, 0.0
    room, worth = FRACTURE.share * budget, FRACTURE.share * budget >= REPLICATES * FRACTURE.least
    specimens, early = ((min(REPLICATES * n, room) if worth else 0.0) for n in (SPECIMENS, FRACTURE.first))
    likely = specimens + (early if reflected(study) else 0.0)
    most = likely + (early if study.model.fidelity != "full" else 0.0)
    if len(limits) > 1:
        along = REPLICATES * FRACTURE_CURVE.first * FRACTURE_CURVE.most if _moves(study) else 0
        # that any of them is exceeded may itself be rare
        likely, most = likely + along, most + along + min(RARE.most, RARE.share * budget)
    return likely, most


def _carriers(study: Study, budget: float) -> tuple[float, float]:
    """Evaluations of strengths that were measured elsewhere: a sample, and a curve by each carrier."""
    count = sum(limit.platens is not None for limit in study.limits)
    if not count:
        return 0.0, 0.0
    rows = min(REPLICATES * CARRIED.first, CARRIED.share * budget)
    curves = len(CARRIERS) if _moves(study) else 0
    return rows + curves * _CURVE, rows + curves * _CURVE_MOST


def _moves(study: Study) -> bool:
    """Whether margins are asked over a number that moves the demands."""
    return study.margins is not None and study.margins.axis.moves_rows


def _ways(study: Study) -> tuple[float, float]:
    """Evaluations on which all ways to break are judged, here and along the free scalar."""
    if study.black_box or not any(means_fracture(limit) for limit in study.limits):
        return 0.0, 0.0
    rows, along = float(REPLICATES * WAYS.first if study.random else 1), 0.0
    if _moves(study):
        along = float(REPLICATES * WAYS_CURVE.first * WAYS_CURVE.most)
    # where contacts yield the rows are answered a second time
    return rows + along, 2.0 * rows + along


def _begins(study: Study) -> bool:
    """Whether a run may begin with what everything else rests on: replicates, or a screening of many inputs."""
    return study.black_box and (study.model.stochastic or len(study.random) >= MANY)


def _surrogate_runs(inputs: int) -> int:
    """Runs that a surrogate of a smooth model is content with: twice the terms of a quadratic, in whole stages.

    >>> [_surrogate_runs(inputs) for inputs in (1, 5, 10)]
    [64, 64, 256]
    """
    stages = math.log2((inputs + 1) * (inputs + 2) / SURROGATE.first)
    return SURROGATE.first << max(1, math.ceil(stages))


def _planned(study: Study, budget: float, surrogate: bool) -> Iterator[tuple[str, float, float]]:
    """Name, likely and most evaluations of every part, as if nothing had been spent before it."""
    analysis = study.analysis
    # runs of a black box are timed, for its cost to decide
    timed = SURROGATE.first if "auto" in analysis.methods and analysis.cost is None else 0
    first = (timed, timed) if study.black_box else _pilot(study, budget)
    yield "pilot", *first
    if surrogate:
        runs, wide = _surrogate_runs(len(study.random)), _moves(study)
        # of one design, the first of which are those that were timed
        yield "surrogate", (2 * runs if wide else runs) - first[0], SURROGATE.most + (ALONG.most if wide else 0)
    else:
        yield "sampling", *_sampling(study, budget)
        yield "rare events", *_rare(study, budget)
    if analysis.tolerance_intervals:
        yield "tolerance intervals", analysis.tolerance_intervals.runs, analysis.tolerance_intervals.runs
    if set(analysis.methods) & set(FURTHER) or analysis.fields or _begins(study):
        from uqsphere.runner.questions.further import planned_analyses

        yield from ((name, count, count) for name, count in planned_analyses(study))
    if not surrogate:
        yield "margins", *_margins(study, budget)
        yield "carriers", *_carriers(study, budget)
        yield "fracture", *_fracture(study, budget)
        yield "sensitivity", *_sensitivity(study)
        yield JUDGED, *_ways(study)


def forecast(study: Study, budget: int | None = None, surrogate: bool = False) -> tuple[Part, ...]:
    """Parts of a run and what each is likely to evaluate.

    Parameters
    ----------
    study : Study
    budget : evaluations that are affordable; None: as if there were no end to them.
    surrogate : whether the study is answered through a surrogate.
    """
    if not study.random and not study.limits:
        return (Part(name="sampling", likely=1, most=1),)
    end = math.inf if budget is None else float(budget)
    found: list[Part] = []
    left = end
    for name, likely, most in _planned(study, end, surrogate):
        affordable = round(min(likely, max(left, 0.0)))
        highest = round(min(most, end, 1e18))
        left -= affordable
        if highest:
            found.append(Part(name=name, likely=affordable, most=max(highest, affordable)))
    return tuple(found)


# --- By which way a study is answered: by sampling, or through a surrogate, as the cost of an evaluation has it.

#: seconds that a surrogate takes besides the runs of the model: at all, and for the fits of each quantity
OVERHEAD, FITS = 5.0, 5.0
#: cost of an evaluation below which a model is cheap in any case [s]: timed row by row, a vectorised one seems to take
#: longer than it does, and sampling answers more than a surrogate does
CHEAP = 1e-3


@dataclass(frozen=True, kw_only=True)
class Way:
    """By which way a study is answered.

    Attributes
    ----------
    surrogate : whether through a surrogate; else by sampling
    why : in a clause without seconds
    sampling, runs : evaluations that sampling, and that a surrogate, are forecast to take
    crossover : cost of an evaluation above which the surrogate is taken [s]
    balance : cost above which the surrogate takes less time [s], which may be less
    affordable : evaluations that the budget allows
    """

    surrogate: bool
    why: str
    sampling: int
    runs: int
    crossover: float
    balance: float
    affordable: int


def choose_way(study: Study, cost: float | None = None, seconds: float | None = None) -> Way:
    """The cheaper way, by the cost of an evaluation.

    Parameters
    ----------
    study : Study
    cost : seconds of an evaluation; None: `analysis.cost`, and where that is not given either, no cost is known.
    seconds : time budget in place of the study's.

    With n evaluations by sampling, m by a surrogate and its overhead o the two take n c and m c + o: the surrogate
    is taken above the crossover c = o/(n - m), but not below a millisecond, or where the budget has no room for
    sampling at all.
    """
    analysis = study.analysis
    cost = analysis.cost if cost is None else cost
    seconds = analysis.budget.time if seconds is None else seconds
    # what verdicts rest on besides is the same by either way
    planned = sum(part.likely for part in forecast(study) if part.name != JUDGED)
    runs = sum(part.likely for part in forecast(study, surrogate=True))
    affordable = analysis.budget.evaluations
    if cost and cost * affordable > seconds:
        affordable = max(int(seconds / cost), 1)
    overhead = OVERHEAD + FITS * len(analysis.quantities)
    # sampling ends with the budget, whatever accuracy it was forecast to take more for
    balance = overhead / max(min(planned, analysis.budget.evaluations) - runs, 1)
    crossover = max(balance, CHEAP)

    way = Way(surrogate=False, why=_why_sampled(study), sampling=planned, runs=runs, crossover=crossover,
              balance=balance, affordable=affordable)  # fmt: skip
    if not way.why:
        way = _by_cost(way, cost)
    if way.surrogate and affordable < analysis.budget.evaluations:
        room = (f"; budget.time, {_two(seconds)} s, has room for {affordable:,} of the "
                f"{analysis.budget.evaluations:,} evaluations of the budget")  # fmt: skip
        way = replace(way, why=way.why + room)
    return way


def _why_sampled(study: Study) -> str:
    """Why a study is sampled whatever an evaluation costs, or an empty text."""
    if not study.random:
        return "the model has no random input"
    if not study.black_box:
        return "the impact model is so cheap that sampling takes less time than a surrogate"
    return "" if "auto" in study.analysis.methods else "the study lists its methods"


def _by_cost(way: Way, cost: float | None) -> Way:
    """The way that the cost of an evaluation decides, and why."""
    if way.affordable < FIRST_SAMPLE:
        why = f"the budget has no room for the {FIRST_SAMPLE:,} evaluations that sampling begins with"
        return replace(way, surrogate=True, why=why)
    if cost is None:
        return replace(way, why="the cost of an evaluation is not known")
    told = f"sampling is forecast to take {way.sampling:,} evaluations, a surrogate some {way.runs}"
    if cost > way.crossover:
        why = f"{told} and the time of its fits, which is less at this cost of an evaluation"
        return replace(way, surrogate=True, why=why)
    dear = "a model of a millisecond or less is sampled, which answers more, in any case"
    return replace(
        way, why=f"{told}, but {dear if cost > way.balance else 'its fits take longer than sampling so cheap a model'}"
    )


def room_of(study: Study, way: Way) -> list[str]:
    """What the budget of an expensive model has room for beside its design, and what not, with the way out."""
    if not way.surrogate or not study.limits:
        return []
    # one run is made twice, to see whether the model answers alike
    half, small, found = (way.affordable - 1) // 2, "small probabilities", []
    variables = len(study.random) + sum(isinstance(limit.model_factor, Law) for limit in study.limits)
    learns, least = variables < MOST_LEARNED, least_learned(variables)
    if _moves(study) and study.margins is not None:
        # beside the design, and what its limits are left to be learned by
        more = (least_learned(variables + 1, looks=1) + least * len(study.limits)) * learns
        fewest, path = ALONG.first + more, study.margins.axis.path
        found.append(
            f"margins over {path}: up to {min(half, ALONG.most):,} evaluations"
            + ", of which those are learned from that tell most of a probability that no surrogate shows" * learns
            if half >= fewest
            else f"margins over {path}: no room; {_raised(study, way, 2 * fewest + 1)}"
        )
    if variables > MOST_LEARNED:
        return [*found, f"{small}: bounds alone, since more than {MOST_LEARNED} variables are too many to learn them"]
    if half < least:
        return [*found, f"{small}: bounds alone; {_raised(study, way, 2 * least + 1)}"]
    most = min(half, LEARNED.most)
    return [*found, f"{small}: {least} to {most} evaluations for each limit that the design does not show"]


def _raised(study: Study, way: Way, count: int) -> str:
    """What to raise for a number of evaluations: the time where it has no room for those of the budget."""
    analysis, told = study.analysis, f"raise analysis.budget to {count} evaluations at least"
    if way.affordable == analysis.budget.evaluations or not analysis.cost:
        return told
    late = f"raise analysis.budget.time to {_two(analysis.cost * count)} s at least"
    return late if count <= analysis.budget.evaluations else f"{told}, and {late.removeprefix('raise ')}"


# --- What a run will cost, estimated before anything heavy is loaded.

#: seconds per step of the compiled integrator on one processor, as the shipped studies show it
_STEP_SECONDS = 0.5e-6
#: seconds to start and to write the report; those of a limit beside its evaluations, and of each of its curves
_START, _LIMIT, _CURVE_PLAN = 4.0, 1.0, 2.5
#: steps that a closed form is as expensive as, and times t_c for which a blow with two contacts is followed
_STEPS_CLOSED, _TOUCHES = 2.0, 10.0
#: parts whose seconds are told
_TOLD = 3


def _scene_numbers(study: Study) -> dict[str, float | None]:
    """mu, theta and the steps an evaluation takes, at the means; of a blow without bars the speed at which the bodies
    close square to the face [m/s]."""
    from uqsphere.mechanics.scene import STATUS

    scene = scene_of(study, {}, 1)
    mu, theta, time = (
        float(column[0]) for column in (scene.scales.mass_number, scene.scales.pulse_number, scene.scales.time)
    )
    if study.rig != "bars":
        if code := int(scene.status[0]):
            raise _no_scene(study, STATUS[code])
        rig = RIGS[study.rig]
        # closed forms take as long as a few steps; a light sphere rattles between its two contacts
        steps = _STEPS_CLOSED if rig.contacts == 1 or not rig.blow else 60.0 + _TOUCHES * math.sqrt(3.0 / mu)
        speed = float(scene.closing_speed[0]) if rig.blow else None
        return {"mu": mu, "theta": None, "steps": steps, "speed": speed}
    record = float(scene.record_end[0]) / time
    # contact is usually lost after about two round trips; infinite bars are followed for about 7 t_c
    if study.options["bars.infinite"]:
        record = min(record, (theta if math.isfinite(theta) else record) + 7.0)
    else:
        record = min(record, 2.0 * float(scene.round_trips[0].max()) / time)
    if not 0.0 < mu < math.inf or not theta > 0.0 or not math.isfinite(record):
        raise _no_scene(study, "its numbers are beyond floating point")
    phase = record * math.sqrt(3.0 * math.sqrt(min(1.0, theta)) / mu)
    return {"mu": mu, "theta": theta if math.isfinite(theta) else None, "steps": 60.0 + phase}


def _no_scene(study: Study, why: str) -> UsageError:
    """That there is no scene at the means, with the number that is farthest from the middle of what is usual."""

    def distance(name: str) -> float:
        low, high = INPUTS[name].plausible
        usual = 0.0 < low < high < math.inf and means[name] > 0.0
        return abs(math.log(means[name] / low / high * means[name])) / math.log(high / low) if usual else 0.0

    means = study.at_means()
    name = max(means, key=distance)
    said = f"of its numbers {format_value(means[name], name)} here is the least usual"
    return UsageError(f"{name}: the scene at its means cannot be computed: {why}; {said}")


class PlannedPart(TypedDict, total=False):
    """A part of a run in its plan; `seconds` where they are known."""

    part: str
    likely: int
    most: int
    seconds: float


class Plan(TypedDict, total=False):
    """What `uqsphere check --json` says of a run to come; `scene` has the scaled numbers at the means."""

    evaluations: int
    processors: int
    seconds: float | None
    scene: dict[str, float | None] | None
    most: int
    parts: list[PlannedPart]
    way: str | None
    why: str
    room: list[str]
    services: dict[str, Plan]
    crossover_seconds_per_evaluation: float
    balance_seconds_per_evaluation: float


def plan_run(study: Study) -> Plan:
    """Evaluations and seconds that a run will take, roughly, and by which way.

    Seconds are None for a black box whose cost is not given, and so is its way where the cost decides.
    """
    services = {name: plan_run(service) for name, service in study.services.items()}
    if study.rig == "none":
        return {"services": services}
    way = choose_way(study)
    parts = forecast(study, way.affordable, way.surrogate)
    told = study.analysis.cost is not None or "auto" not in study.analysis.methods
    known = not study.black_box or told or way.surrogate
    plan: Plan = {
        "evaluations": int(min(sum(part.likely for part in parts), way.affordable)),
        "processors": _processors(),
        "seconds": None,
        "scene": None,
        "most": min(sum(part.most for part in parts), way.affordable),
        "parts": [{"part": part.name, "likely": part.likely, "most": part.most} for part in parts],
        "way": ("surrogate" if way.surrogate else "sampling") if known else None,
        "why": way.why if known else "the first runs of the model are timed, and that decides",
    }
    if room := room_of(study, way):
        plan["room"] = room
    if services:
        plan["services"] = services
    if study.black_box:
        _time_black_box(study, plan, way)
    else:
        _time_scene(study, plan)
    return plan


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _time_scene(study: Study, plan: Plan) -> None:
    """Give the plan of an impact its scaled numbers and its seconds."""
    numbers, limits = _scene_numbers(study), len(study.limits)
    plan["scene"] = {name: number for name, number in numbers.items() if name != "steps"}
    beside = {"rare events": _LIMIT * limits, "margins": _CURVE_PLAN * limits * _curves(study)}
    _time_parts(plan, (numbers["steps"] or 0.0) * _STEP_SECONDS / plan["processors"], beside)
    plan["seconds"] = round(_START + sum(part["seconds"] for part in plan["parts"]), 1)


def _time_black_box(study: Study, plan: Plan, way: Way) -> None:
    """Give the plan of a black box where the choice turns, and its seconds where the cost of an evaluation is given."""
    plan["crossover_seconds_per_evaluation"] = float(f"{way.crossover:.2g}")
    plan["balance_seconds_per_evaluation"] = float(f"{way.balance:.2g}")
    cost = study.analysis.cost
    if cost is not None:
        overhead = OVERHEAD + FITS * len(study.analysis.quantities) if way.surrogate else OVERHEAD
        plan["seconds"] = round(plan["evaluations"] * cost + overhead, 1)
        _time_parts(plan, cost, {})


def _time_parts(plan: Plan, each: float, beside: Mapping[str, float]) -> None:
    """Give every part its seconds, at so many for an evaluation and so many beside its evaluations."""
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


def plan_text(study: Study, plan: Plan) -> str:
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
    ]
    if len(told) > 1:
        lines.append(f"of which: {'; '.join(told)}")
    lines.append(f"time: {_time_text(study, plan)}")
    longest = sorted((p for p in plan["parts"] if p.get("seconds")), key=lambda p: -p["seconds"])[:_TOLD]
    if longest:
        lines.append("most of it: " + ", ".join(f"{p['part']} {_two(p['seconds'])} s" for p in longest))
    lines.append(f"way: {plan['way'] or 'not known yet'}: {plan['why']}")
    lines += [f"room: {one}" for one in plan.get("room", ())]
    if study.black_box:
        crossover, balance = plan["crossover_seconds_per_evaluation"], plan["balance_seconds_per_evaluation"]
        text = f"crossover: above {crossover:g} s an evaluation a surrogate is taken, below it sampling"
        sooner = f" (it takes less time above {balance:g} s already, but answers less)" if balance < crossover else ""
        lines.append(text + sooner)
    return "\n".join(lines)


def _time_text(study: Study, plan: Plan) -> str:
    if plan["seconds"] is None:
        return "depends on the model that is given with --model"
    if study.black_box:
        return f"about {plan['seconds']:,.0f} s, one evaluation after the other"
    return f"about {plan['seconds']:.0f} s on {plan['processors']} processors (20 s more to compile at first)"
