"""What each part of a run is likely to evaluate, and the most, before anything is evaluated.

The likely numbers are those at which the shipped studies reach their accuracy.  They cannot know how rough the model
is or how rare a failure: that is what the most is for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final

from uqsphere.quantities import lookup
from uqsphere.runner.schedule import (
    CAUTION,
    DESIGN_POINT,
    FIRST_SAMPLE,
    FRACTURE,
    FRACTURE_CURVE,
    INDICES,
    MOST_CHEAPER,
    PILOT,
    RARE,
    REPLICATES,
    SAMPLING,
    SPECIMENS,
    SURROGATE,
    pilot_points,
)
from uqsphere.study import Study
from uqsphere.uq.law import Law

__all__ = ["CHEAPER", "Part", "base_rows", "forecast", "rough_quantities"]

#: parts that evaluate a cheaper model, by the part that it may help
CHEAPER: Final = ("cheaper model beside sampling", "cheaper model beside the indices")
#: Student's t of sixteen replicates
_T: Final = 2.13
#: factor that the first sample's quasi-random points save of quantiles: of the impact model, and of a black box, of
#: which nothing is known.  It grows with the root of the points, since half-widths fall with their power 3/4
_GAIN: Final = (2.0, 0.5)
#: probability that a limit of fixed strength is taken to have, where it has no target above it
_CHANCE: Final = 0.05
#: base points of the indices for outputs that jump, at the most
_ROUGHEST: Final = 200_000
#: curves: the look and what its rows are likely to be, the same where a strength is fixed, of which a row tells on
#: which side it lies alone; the rows of each value asked for; the share of the budget that curves may take
_CURVE, _CURVE_FIXED, _VALUE, _VALUE_FIXED, _CURVES = 4_272, 18_000, 512, 6_144, 0.1
_VALUE_FIRST: Final = 256
_CURVE_MOST: Final = 288 + 3 * 2_560
#: the search of a rare limit
_RARE: Final = 6_000
#: runs that a surrogate of a smooth model is content with: for up to five inputs, and beyond
_RUNS, _RUNS_MANY = 64, 256


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


def _finer(asked: float) -> float:
    """How much finer than 1 % is asked for; beyond any budget it is all the same."""
    return 0.01 / max(asked, 1e-50)


def _points(study: Study) -> tuple[float, float]:
    """Points that sampling takes for its quantiles, likely and by plain Monte Carlo, for an output near normal.

    n = (t sqrt(p (1 - p))/(phi(z_p) e))^2 for the half-width e over the standard deviation.
    """
    analysis = study.analysis
    normal = NormalDist()
    plain = 1.0
    for p in analysis.quantiles:
        density = normal.pdf(normal.inv_cdf(p))
        plain = max(plain, p * (1.0 - p) / density**2)
    plain *= (_T / max(analysis.accuracy.quantile, 1e-50)) ** 2
    # n = plain/gain with a gain that is itself a multiple of the root of n
    first = _GAIN[1] if study.black_box else _GAIN[0]
    smooth = (plain * math.sqrt(FIRST_SAMPLE) / first) ** (2.0 / 3.0)
    # the mean of smooth outputs is known long before its quantiles, the root of the points ahead
    mean = (_T / max(analysis.accuracy.mean, 1e-50)) ** (4.0 / 3.0)
    counted = 0.0
    if any(not isinstance(limit.strength, Law) for limit in study.limits):
        # a row tells only on which side of a fixed strength it lies
        counted = (_T / max(analysis.accuracy.probability, 1e-50)) ** 2 * (1.0 - _CHANCE) / _CHANCE
    return max(min(smooth, plain), mean, counted), max(plain, counted)


def _stage(points: float, room: float) -> int:
    """The stage of sampling nearest to a number of points, within room for it; the first at the least."""
    if not math.isfinite(points):
        points = 1e18
    steps = max(0, round(math.log2(max(points, 1.0) / FIRST_SAMPLE)))
    while steps and FIRST_SAMPLE * 2**steps > room:
        steps -= 1
    return int(FIRST_SAMPLE * 2**steps)


def _sampling(study: Study, budget: int | None) -> Part:
    """Sampling; the most where the model is rough, or the accuracy is pursued as far as the budget goes."""
    likely, plain = _points(study)
    if budget is None:
        return Part(name="sampling", likely=_stage(likely, math.inf), most=_stage(2.0 * plain, math.inf))
    room = SAMPLING.share * budget
    if likely > CAUTION * room and not study.analysis.budget.exhaust:
        # the accuracy is given up as soon as it is seen to be out of reach
        return Part(name="sampling", likely=_stage(REPLICATES * SAMPLING.judged, room), most=_stage(room, room))
    return Part(name="sampling", likely=_stage(likely, room), most=_stage(2.0 * plain, room))


def rough_quantities(study: Study) -> tuple[str, ...]:
    """Quantities whose indices may take several times what is likely: how rough they are shows with the first rows."""
    sampled = study.random and not study.black_box and {"auto", "sobol"} & set(study.analysis.methods)
    return tuple(name for name in study.analysis.quantities if lookup(name).rough) if sampled else ()


def _sensitivity(study: Study) -> tuple[float, float]:
    """Evaluations of the indices, likely and most: with a surrogate as control variate their first stage is enough."""
    analysis, blocks, first = study.analysis, base_rows(study), REPLICATES * INDICES.first
    if not {"auto", "sobol"} & set(analysis.methods):
        return 0.0, 0.0
    finer = _finer(analysis.accuracy.sobol)
    most = max(first, _ROUGHEST * finer**2)
    rough = max((lookup(name).rough for name in rough_quantities(study)), default=0)
    if rough:
        return blocks * max(float(first), rough * finer**2), blocks * most
    helped = {"auto", "pce"} & set(analysis.methods)
    # the first stage has been enough for half a per cent
    base = first * max(1.0, 0.5 * finer) ** 1.2 if helped else 4 * first * finer**1.2
    return blocks * max(float(first), base), blocks * most


def _margins(study: Study, budget: float) -> tuple[float, float]:
    """Evaluations of the curves: the look, rows at forty values, more at the values asked for."""
    margins = study.margins
    if margins is None or not study.limits:
        return 0.0, 0.0
    curves = 1 + (len(margins.family.values) if margins.family else 0)
    still = not margins.axis.moves_rows
    asked = len(margins.for_probability)
    fixed = sum(not isinstance(limit.strength, Law) for limit in study.limits)
    values = 0 if still else asked * (_VALUE * (len(study.limits) - fixed) + _VALUE_FIXED * fixed)
    look = 1_536 if still else _CURVE_FIXED if fixed else _CURVE
    likely = float(curves * (look + values))
    # a curve takes its first rows, and each value its first ones, whatever the share
    first = 0 if still else _VALUE_FIRST * asked * len(study.limits)
    least = float(curves * ((1_024 if still else _CURVE_MOST) + first))
    if not math.isfinite(budget):
        return likely, max(likely, least)
    most = max(_CURVES * budget, least)
    return min(likely, most), most


def _pilot(study: Study, budget: float) -> tuple[int, int]:
    """Evaluations of the first look: the full model on all its points, what it is compared with on half of them."""
    points = 1 if not study.random else pilot_points(int(min(budget, 1e9)))
    if points == 1:
        return 1, 1
    half, asked = points // 2, study.model.fidelity
    # both cheaper models, and the full one at a closer tolerance where neither is taken
    others = (3 if points >= PILOT.least else 1) if asked == "auto" else 1
    return points + others * half, points + others * half


def _rare(study: Study, budget: float) -> tuple[float, float]:
    """Evaluations for the limits: the design points of each, and the search for those that are rare."""
    limits = study.limits
    searched = {"auto", "form", "importance", "subset"} & set(study.analysis.methods)
    if not (limits and study.random and searched):
        return 0.0, 0.0
    share = RARE.share * budget / len(limits)
    rare = sum(limit.target is not None and limit.target < 1e-4 for limit in limits)
    design = DESIGN_POINT if share >= DESIGN_POINT else 0
    return rare * min(_RARE, share) + (len(limits) - rare) * design, len(limits) * min(RARE.most, share)


def _fracture(study: Study, budget: float) -> tuple[float, float]:
    """Evaluations for the moment of fracture, the first loading, and the curve of all limits that break the sphere."""
    from uqsphere.mechanics.outputs import path_of

    limits = [limit for limit in study.limits if limit.fracture is not False]
    limits = [limit for limit in limits if path_of(limit.quantity, study.demands) is not None]
    if study.black_box or not limits:
        return 0.0, 0.0
    room, worth = FRACTURE.share * budget, FRACTURE.share * budget >= REPLICATES * FRACTURE.least
    specimens, early = ((min(REPLICATES * n, room) if worth else 0.0) for n in (SPECIMENS, FRACTURE.first))
    along = REPLICATES * FRACTURE_CURVE.first * FRACTURE_CURVE.most
    ends = [study.at_means().get(f"bars.{bar}_end", 0.0) for bar in ("incident", "receiving")]
    echoes = any(ends) or any(f"bars.{bar}_end" in study.random for bar in ("incident", "receiving"))
    returning = echoes and not study.options["bars.infinite"] and not study.model.first_loading_only
    likely = specimens + (early if returning else 0.0)
    most = likely + (early if study.model.fidelity != "full" else 0.0)
    if len(limits) > 1:
        curve = study.margins is not None and study.margins.axis.moves_rows
        likely += along if curve else 0
        # that any of them is exceeded may itself be rare
        most += (along if curve else 0) + min(RARE.most, RARE.share * budget)
    return likely, most


def forecast(study: Study, budget: int | None = None, surrogate: bool = False) -> tuple[Part, ...]:
    """Parts of a run and what each is likely to evaluate.

    Parameters
    ----------
    study : Study
    budget : evaluations that are affordable; None: as if there were no end to them.
    surrogate : whether the study is answered through a surrogate.
    """
    analysis = study.analysis
    if not study.random and not study.limits:
        return (Part(name="sampling", likely=1, most=1),)
    end = math.inf if budget is None else float(budget)
    found: list[Part] = []
    left = end

    def add(name: str, likely: float, most: float) -> None:
        nonlocal left
        affordable = round(min(likely, max(left, 0.0)))
        most = round(min(most, end, 1e18))
        left -= affordable
        if most:
            found.append(Part(name=name, likely=affordable, most=max(most, affordable)))

    if not study.black_box:
        add("pilot", *_pilot(study, end))
    elif "auto" in analysis.methods and analysis.cost is None:
        add("pilot", SURROGATE.first, SURROGATE.first)
    if surrogate:
        runs = _RUNS if len(study.random) <= 5 else _RUNS_MANY
        # the runs that are timed are the first of its design
        first = sum(part.likely for part in found)
        wide = study.margins is not None and study.margins.axis.moves_rows
        add("surrogate", (2 * runs if wide else runs) - first, SURROGATE.most + (256 if wide else 0))
    else:
        sampling = _sampling(study, budget)
        add("sampling", sampling.likely, sampling.most)
        cheaper = not study.black_box and study.model.fidelity in ("auto", "full")
        if cheaper:
            add(CHEAPER[0], 0, MOST_CHEAPER * sampling.most)
        add("rare events", *_rare(study, end))
    if analysis.tolerance_intervals:
        add("tolerance intervals", analysis.tolerance_intervals.runs, analysis.tolerance_intervals.runs)
    if not surrogate:
        add("margins", *_margins(study, end))
        add("fracture", *_fracture(study, end))
        if study.random:
            likely, most = _sensitivity(study)
            add("sensitivity", likely, most)
            if cheaper:
                add(CHEAPER[1], 0, MOST_CHEAPER * most)
    return tuple(found)
