"""By which way a study is answered: by sampling, or through a surrogate, as the cost of an evaluation has it."""

from __future__ import annotations

from dataclasses import dataclass

from uqsphere.runner.forecast import forecast
from uqsphere.runner.schedule import FIRST_SAMPLE
from uqsphere.study import Study

__all__ = ["CHEAP", "FITS", "OVERHEAD", "Way", "choose_way"]

#: seconds that a surrogate takes besides the runs of the model: at all, and for the fits of each quantity
OVERHEAD, FITS = 5.0, 5.0
#: cost of an evaluation below which a model is cheap in any case [s]: timed row by row, a vectorised one seems dearer
#: than it is, and sampling answers more than a surrogate does
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
    planned = sum(part.likely for part in forecast(study))
    runs = sum(part.likely for part in forecast(study, surrogate=True))
    affordable = analysis.budget.evaluations
    if cost and cost * affordable > seconds:
        affordable = int(seconds / cost)
    overhead = OVERHEAD + FITS * len(analysis.quantities)
    # sampling ends with the budget, whatever accuracy it was forecast to take more for
    balance = overhead / max(min(planned, analysis.budget.evaluations) - runs, 1)
    crossover = max(balance, CHEAP)

    def way(surrogate: bool, why: str) -> Way:
        return Way(surrogate=surrogate, why=why, sampling=planned, runs=runs, crossover=crossover,
                   balance=balance, affordable=affordable)  # fmt: skip

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
    told = f"sampling is forecast to take {planned:,} evaluations, a surrogate some {runs}"
    if cost > crossover:
        return way(True, f"{told} and the time of its fits, which is less at this cost of an evaluation")
    if cost > balance:
        return way(False, f"{told}, but a model of a millisecond or less is sampled, which answers more, in any case")
    return way(False, f"{told}, but its fits take longer than sampling so cheap a model")
