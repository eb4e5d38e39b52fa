"""How the questions of a run spend its budget: stages, shares, and when an accuracy is given up.

Questions work by these numbers, and the forecast and the plan read them: nothing heavy is loaded here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from uqsphere.study.document import FURTHER
from uqsphere.uq.estimate import REPLICATES as REPLICATES
from uqsphere.uq.rare import LOOKS

if TYPE_CHECKING:
    from uqsphere.study import Study

#: how far a forecast must lie beyond the budget before it is acted on: half-widths are uncertain by a fifth
CAUTION: Final = 1.5


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """The stages of a question, in rows of each replicate where not said otherwise.

    Attributes
    ----------
    first, least : rows of the first stage, and where the budget has no room for them; fewer are not worth it
    judged : rows from which on the course of an error tells what an accuracy would take
    most : the most
    share : of the budget, or of what is left of it, that the question may take
    """

    first: int = 0
    least: int = 0
    judged: int = 0
    most: int = 0
    share: float = 1.0


#: the first look at the impact model, rows in all: one of so many evaluations of the budget (`share`) is one of it at
#: the most, and cheaper models are compared on no fewer than `least`
PILOT: Final = Schedule(first=512, least=64, share=1 / 8)
#: distributions and probabilities; the share where indices are still to come
SAMPLING: Final = Schedule(first=128, least=2, judged=512, share=0.7)
#: evaluations that sampling begins with; its stages double
FIRST_SAMPLE: Final = REPLICATES * SAMPLING.first
#: base points of Sobol' indices, and of Shapley effects
INDICES: Final = Schedule(first=64, least=32, judged=128)
SHAPLEY: Final = Schedule(first=64, least=16, judged=128)
#: scenes of a table of scaled numbers (`most`), and points that it is asked for to each of the model, at first and at
#: the most (`judged`)
TABLE: Final = Schedule(first=32, judged=1024, most=8192)
#: evaluations of a limit that sampling leaves open, and the share of what is left that all limits may take
RARE: Final = Schedule(least=3000, most=100_000, share=0.5)
#: evaluations for the design points of a limit whose probability is known
DESIGN_POINT: Final = 1000
#: curves over a free scalar: the look, points at so many values (`most`); then points at each of `CURVE_VALUES`, more
#: where the budget of all curves allows, and the most; the same where one value serves all; scenes checked at an answer
LOOK: Final = Schedule(first=2, most=9)
CURVE: Final = Schedule(first=4, least=2, most=64, share=0.1)
CURVE_VALUES: Final = 40
FREE_CURVE: Final = Schedule(first=64, least=8, most=1024)
CHECKED: Final = 128
#: rows that are followed to their fracture: those whose first loading is, specimens drawn from them, and values and
#: rows of the curve of all limits together
FRACTURE: Final = Schedule(first=512, least=8, share=0.05)
SPECIMENS: Final = 64
FRACTURE_CURVE: Final = Schedule(first=64, most=17)
#: rows of a sample for strengths that are carried from their tests, the first ones of it, and their share of the budget
CARRIED: Final = Schedule(first=1024, share=0.2)
#: the curve of one carrier: with the sample and the margins less than half of the budget
CARRIED_CURVE: Final = Schedule(share=0.05)
#: rows on which the ways to break are judged, and the values of a free scalar and rows at each of them, which are made
#: before the sample where they are no larger a share of the budget
WAYS: Final = Schedule(first=512)
WAYS_CURVE: Final = Schedule(first=16, most=25, share=1 / 16)
#: rows around the study that let its page answer for other settings, in all, beside as many of the budget
SLIDERS: Final = Schedule(first=2048, least=512, share=1 / 16)
#: runs of the one design of an expensive model: those that are timed, the fewest, the most
SURROGATE: Final = Schedule(first=32, least=8, judged=128, most=1024)
#: inputs from which on `auto` begins with a screening of a black box; its trajectories, of which 32 tell the largest
#: effect of a smooth model to about a fifth
MANY: Final = 50
MORRIS: Final = Schedule(first=32, least=4, share=0.25)
#: rows that a model which scatters by itself answers several times
REPEATED: Final = Schedule(least=8, most=64, share=0.2)
#: rows of a field: a smooth one is known to 1e-4 of its variance from 128
FIELD: Final = Schedule(first=128, least=32)
#: calls of an expensive model for one limit whose probability its design does not show, at the most
LEARNED: Final = Schedule(most=200)
#: variables of a limit that is learned, at the most: in more a Gaussian process does not follow it by so few calls
MOST_LEARNED: Final = 10
#: its runs over inputs and a free scalar: the fewest that a curve is drawn from, and the most
ALONG: Final = Schedule(first=32, most=256)


def pilot_points(budget: int) -> int:
    """Points of the pilot: fewer where the budget is small, so that the pilot takes no more than a third of it.

    >>> [pilot_points(budget) for budget in (100, 1000, 4096, 2_000_000)]
    [8, 64, 512, 512]
    """
    return min(PILOT.first, 1 << max(3, int(budget * PILOT.share).bit_length() - 1))


def least_learned(variables: int, looks: int = LOOKS) -> int:
    """Calls that learning takes beside runs that are known: its first points, two more than variables, and its looks.

    >>> least_learned(5), least_learned(6, looks=1)
    (22, 14)
    """
    return variables + 2 + looks * variables


def more_to_come(study: Study) -> bool:
    """Whether anything is left to be evaluated for once distributions and probabilities are known."""
    analysis = study.analysis
    if not study.random or not study.black_box:
        return bool(study.random)
    named = set(analysis.methods) & {"form", "importance", "subset", *FURTHER}
    return bool(named or analysis.fields or analysis.samples_indices or study.margins or analysis.tolerance_intervals)
