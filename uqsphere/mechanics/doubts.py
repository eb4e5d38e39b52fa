"""Answers that deserve a second look: which rows are integrated again more closely, and which have two answers."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.layout import (
    ANSWER_CONTACT,
    ANSWER_DEPTH,
    ANSWER_LOSS_RATE,
    ANSWER_NEAREST,
    ANSWER_RISE,
    ANSWER_RISES,
    ANSWER_WIDTH,
    ANSWER_WIDTHS,
    ANSWER_X_MAX,
)

__all__ = ["CLOSEST", "doubtful", "jumping", "other_ends", "other_times", "unsettled"]

Array = npt.NDArray[np.float64]

#: steps after which the errors of single steps may have added up
_MANY_STEPS = 1_000
#: change of a time over that of its threshold, both relative, that is no longer smooth
_JUMP = 100.0
#: smallest share of the tolerance that a row is looked at with
CLOSEST = 1e-6
#: a look a hundred times closer may change an answer by this many tolerances: what is left is below one
_SETTLED = 30.0


def jumping(answers: Array, tolerance: float) -> npt.NDArray[np.bool_]:
    """Whether width or rise time of rows change by far more than a threshold does that is moved a little."""
    jumps = np.zeros(len(answers), dtype=bool)
    for main, sides in ((ANSWER_WIDTH, ANSWER_WIDTHS), (ANSWER_RISE, ANSWER_RISES)):
        for side in range(2):
            with np.errstate(invalid="ignore"):
                moved = np.abs(answers[:, sides + side] - answers[:, main])
                jumps |= moved > _JUMP * tolerance * np.abs(answers[:, main])
    return jumps


def other_times(answers: Array) -> Array:
    """The answers with width and rise time as they are on the other side of the jump, (n, ANSWERS)."""
    others = answers.copy()
    for main, sides in ((ANSWER_WIDTH, ANSWER_WIDTHS), (ANSWER_RISE, ANSWER_RISES)):
        moved = np.abs(answers[:, sides : sides + 2] - answers[:, [main]])
        side = np.where(moved[:, 0] > moved[:, 1], sides, sides + 1)
        others[:, main] = answers[np.arange(len(answers)), side]
    return others


def doubtful(
    answers: Array,
    status: npt.NDArray[np.int64],
    steps: npt.NDArray[np.int64],
    block: npt.NDArray[np.int64],
    tolerance: float,
) -> list[tuple[float, npt.NDArray[np.int64]]]:
    """Rows of a block whose end of contact has to be looked at more closely: (share of the tolerance, rows).

    An error of tolerance x_max in the approach moves the end of contact by that over the rate at which the
    face leaves; where this is more than the tolerance of the time itself, or where a face nearly left, the row is
    integrated again.
    """
    found = answers[block]
    with np.errstate(all="ignore"):
        sharpness = found[:, ANSWER_LOSS_RATE] * found[:, ANSWER_CONTACT] / found[:, ANSWER_X_MAX]
    # what else deserves a closer look: a face that nearly left, a threshold that is nearly missed, a long motion
    doubtful = np.isfinite(found[:, ANSWER_NEAREST]) | (steps[block] > _MANY_STEPS) | jumping(found, tolerance)
    sharpness = np.where(doubtful, np.fmin(sharpness, 0.5), sharpness)
    done = status[block] == 0
    groups = []
    for low, high, factor in ((1e-2, 3.0, 1e-2), (1e-4, 1e-2, 1e-4), (0.0, 1e-4, CLOSEST)):
        rows = block[done & (sharpness >= low) & (sharpness < high)]
        if len(rows):
            groups.append((factor, rows))
    return groups


def unsettled(before: Array, after: Array, tolerance: float) -> npt.NDArray[np.bool_]:
    """Rows whose largest approach or end of contact a closer look has changed by so much that it takes another."""
    moved = np.zeros(len(after), dtype=bool)
    for column in (ANSWER_X_MAX, ANSWER_CONTACT):
        with np.errstate(invalid="ignore"):
            change = np.abs(after[:, column] - before[:, column])
            moved |= change > _SETTLED * tolerance * np.abs(after[:, column])
    return moved


def other_ends(answers: Array, tolerance: float) -> Array:
    """What `graze` of the kernel gives the other answer of rows that the tolerance does not decide, else 0; (n,).

    Undecided is a row in which a face leaves by less than the tolerance of the largest approach, or comes as close
    to leaving: whether contact is lost there cannot be said.
    """
    bound = tolerance * answers[:, ANSWER_X_MAX]
    with np.errstate(invalid="ignore"):
        nearly, barely = answers[:, ANSWER_NEAREST] <= bound, answers[:, ANSWER_DEPTH] <= bound
    return np.where(nearly, bound, np.where(barely, -bound, 0.0)) * (1.0 + 1e-9)
