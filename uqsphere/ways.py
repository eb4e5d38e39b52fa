"""By which way a study is answered: by sampling, or through a surrogate, as the cost of an evaluation has it."""

from __future__ import annotations

from dataclasses import dataclass

from uqsphere.study import Study

__all__ = ["CHEAP", "FIRST_SAMPLE", "FITS", "OVERHEAD", "Way", "choose_way"]

#: evaluations that sampling begins with, and that a surrogate of a smooth model is content with
FIRST_SAMPLE = 2_048
_RUNS = 256
#: seconds that a surrogate takes besides the runs of the model: at all, and for the fits of each quantity
OVERHEAD, FITS = 5.0, 5.0
#: cost of an evaluation below which a model is cheap in any case [s]: timed row by row, a vectorised one seems dearer
#: than it is, and sampling answers more than a surrogate does
CHEAP = 1e-3
#: quantities that jump where a contact is lost one oscillation earlier: sampling is slow on them
_ROUGH = ("contact_time", "pulse_width", "rise_time", "loading_rate")


def _rows(study: Study) -> int:
    """Evaluations for a base point of the indices: of all subsets, or of random orders, where inputs are tied."""
    d = len(study.random)
    if not any(sum(name in study.random for name in group.of) > 1 for group in study.dependence):
        return d + 2 + (d if study.analysis.second_order else 0) + len(study.analysis.groups)
    return 2**d if d <= 10 else 3 * d - 1


def _finer(asked: float) -> float:
    """How much finer than 1 % is asked for; beyond any budget it is all the same."""
    return 0.01 / max(asked, 1e-50)


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
    sampling = 65_536 * _finer(asked.quantile) ** 1.5 * (2.0 if rough else 1.0)
    blocks = _rows(study)
    sensitivity = blocks * (80_000 * _finer(asked.sobol) ** 2 if rough else 4_096 * _finer(asked.sobol) ** 1.2)
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
    is taken above the crossover c = o/(n - m), but not below a millisecond, or where the budget has no room for
    sampling at all.
    """
    analysis = study.analysis
    cost = analysis.cost if cost is None else cost
    seconds = analysis.budget.time if seconds is None else seconds
    planned = round(_sampling(study))
    affordable = analysis.budget.evaluations
    if cost and cost * affordable > seconds:
        affordable = int(seconds / cost)
    overhead = OVERHEAD + FITS * len(analysis.quantities)
    # sampling ends with the budget, whatever accuracy it was forecast to take more for
    crossover = max(overhead / max(min(planned, analysis.budget.evaluations) - _RUNS, 1), CHEAP)

    def way(surrogate: bool, why: str) -> Way:
        return Way(surrogate=surrogate, why=why, sampling=planned, runs=_RUNS, crossover=crossover,
                   affordable=affordable)  # fmt: skip

    if not study.random:
        return way(False, "the model has no random input")
    if not study.black_box:
        return way(False, "the impact model is so cheap that sampling takes less time than a surrogate")
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
