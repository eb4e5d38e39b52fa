"""What each part of a run is likely to evaluate, and the most, before anything is evaluated.

The likely numbers are those at which the shipped studies reach their accuracy.  They cannot know how rough the model
is or how rare a failure: that is what the most is for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final

from uqsphere.study import Study
from uqsphere.uq.distribution import Law

__all__ = ["FIRST_SAMPLE", "Part", "base_rows", "forecast"]

#: evaluations that sampling begins with; its stages double
FIRST_SAMPLE: Final = 2_048
#: quantities that jump where a contact is lost one oscillation earlier: sampling is slow on them
ROUGH: Final = ("contact_time", "pulse_width", "rise_time", "loading_rate")
#: Student's t of sixteen replicates
_T: Final = 2.13
#: factor that quasi-random points save of quantiles: of the impact model, and of a black box, of which nothing is known
_GAIN: Final = (6.0, 3.0)
#: probability that a limit of fixed strength is taken to have, where it has no target above it
_CHANCE: Final = 0.05
#: share of the budget that sampling may take, and from where on an accuracy beyond it is given up
_SHARE, _JUDGED, _CAUTION = 0.7, 8_192, 1.5
#: evaluations of the first look at the impact model, those timed of a black box
_PILOT, _TIMED = 768, 32
#: base points of the indices: of the first stage in all replicates; for outputs that jump, likely and most
_FIRST_BASE, _ROUGH_BASE, _ROUGHEST = 1_024, 16_000, 80_000
#: cheaper models that a control variate evaluates for each full one, at the most
_CONTROL: Final = 32
#: curves: the look and the first rows, those of each value asked for, the share of the budget they may take
_CURVE, _VALUE, _CURVES = 2_848, 256, 0.1
_CURVE_MOST: Final = 288 + 3 * 2_560
#: a rare limit: its search, and the most
_RARE, _RARE_MOST = 6_000, 100_000
#: runs that a surrogate of a smooth model is content with: for up to five inputs, and beyond; the most
_RUNS, _RUNS_MANY, RUNS_MOST = 64, 256, 1_024


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
    gain = _GAIN[1] if study.black_box else _GAIN[0]
    # the mean of smooth outputs is known long before its quantiles, the root of the points ahead
    mean = (_T / max(analysis.accuracy.mean, 1e-50)) ** (4.0 / 3.0)
    counted = 0.0
    if any(not isinstance(limit.strength, Law) for limit in study.limits):
        # a row tells only on which side of a fixed strength it lies
        counted = (_T / max(analysis.accuracy.probability, 1e-50)) ** 2 * (1.0 - _CHANCE) / _CHANCE
    return max(plain / gain, mean, counted), max(plain, counted)


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
    room = _SHARE * budget
    if likely > _CAUTION * room and not study.analysis.budget.exhaust:
        # the accuracy is given up as soon as it is seen to be out of reach
        return Part(name="sampling", likely=_stage(_JUDGED, room), most=_stage(room, room))
    return Part(name="sampling", likely=_stage(likely, room), most=_stage(2.0 * plain, room))


def _sensitivity(study: Study) -> tuple[float, float]:
    """Evaluations of the indices, likely and most: with a surrogate as control variate their first stage is enough."""
    analysis, blocks = study.analysis, base_rows(study)
    if not {"auto", "sobol"} & set(analysis.methods):
        return 0.0, 0.0
    finer = _finer(analysis.accuracy.sobol)
    most = max(_FIRST_BASE, _ROUGHEST * finer**2)
    if any(name in ROUGH for name in analysis.quantities):
        return blocks * max(float(_FIRST_BASE), _ROUGH_BASE * finer**2), blocks * most
    helped = {"auto", "pce"} & set(analysis.methods)
    # the first stage has been enough for half a per cent
    base = _FIRST_BASE * max(1.0, 0.5 * finer) ** 1.2 if helped else 4 * _FIRST_BASE * finer**1.2
    return blocks * max(float(_FIRST_BASE), base), blocks * most


def _margins(study: Study, budget: float) -> tuple[float, float]:
    """Evaluations of the curves: the look, rows at forty values, more at the values asked for."""
    margins = study.margins
    if margins is None or not study.limits:
        return 0.0, 0.0
    curves = 1 + (len(margins.family.values) if margins.family else 0)
    still = margins.solve.startswith("limits.")
    asked = len(margins.for_probability) * len(study.limits)
    values = 0 if still else _VALUE * asked
    look = 1_024 if still else _CURVE
    share = _CURVES * budget if math.isfinite(budget) else 0.0
    # a curve takes its first rows, and each value its first ones, whatever the share
    least = curves * ((1_024 if still else _CURVE_MOST) + values)
    likely = curves * (1.5 * look + 2.0 * values)
    return likely, max(share, float(least))


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
        add("pilot", _PILOT, 2 * _PILOT)
    elif "auto" in analysis.methods and analysis.cost is None:
        add("pilot", _TIMED, _TIMED)
    if surrogate:
        runs = _RUNS if len(study.random) <= 5 else _RUNS_MANY
        wide = study.margins is not None and not study.margins.solve.startswith("limits.")
        add("surrogate", 2 * runs if wide else runs, RUNS_MOST + (256 if wide else 0))
    else:
        sampling = _sampling(study, budget)
        add("sampling", sampling.likely, sampling.most)
        if not study.black_box and study.model.fidelity in ("auto", "full"):
            add("cheaper model beside sampling", 0, _CONTROL * sampling.likely)
        rare = [limit for limit in study.limits if limit.target is not None and limit.target < 1e-4]
        searched = {"auto", "form", "importance", "subset"} & set(analysis.methods)
        if study.limits and study.random and searched:
            add("rare events", _RARE * len(rare) + 100 * len(study.limits), _RARE_MOST * len(study.limits))
    if analysis.tolerance_intervals:
        add("tolerance intervals", analysis.tolerance_intervals.runs, analysis.tolerance_intervals.runs)
    if not surrogate:
        add("margins", *_margins(study, end))
        if not study.black_box and study.limits:
            add("fracture", 0, 16 * 512)
        if study.random:
            add("sensitivity", *_sensitivity(study))
    return tuple(found)
