"""Answers that deserve a second look: which rows are integrated again more closely, and which have two answers."""

from __future__ import annotations

from collections.abc import Callable

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
from uqsphere.mechanics.scene import UNDECIDED

__all__ = ["CLOSEST", "doubtful", "jumping", "settle"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]
#: integrates rows to a tolerance, with what `graze` of the kernel is for them: answers, status and steps of the rows
March = Callable[[Rows, float, Array | None], tuple[Array, Rows, Rows]]

#: steps after which the errors of single steps may have added up ; the largest approach alone they leave within a
#: twentieth of the tolerance after up to 18,000 steps (`tests/test_hard_cases.py`)
_MANY_STEPS = 1_000
#: change of a time over that of its threshold, both relative, that is no longer smooth
_JUMP = 100.0
#: sharpness of a loss of contact of which a look at 1e-4 of the tolerance is close enough
_CLEAN = 5e-3
#: smallest share of the tolerance that a row is looked at with, and the smallest tolerance
CLOSEST, _FINEST = 1e-6, 1e-13
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


def _other_times(answers: Array) -> Array:
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
    peak_only: bool = False,
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
    long = (steps[block] > _MANY_STEPS) & (not peak_only)
    doubtful = np.isfinite(found[:, ANSWER_NEAREST]) | long | jumping(found, tolerance)
    sharpness = np.where(doubtful, np.fmin(sharpness, 0.5), sharpness)
    # where no look can decide, one that is close enough for a clean loss will do
    hovering = found[:, ANSWER_NEAREST] <= tolerance * found[:, ANSWER_X_MAX]
    sharpness = np.where(hovering, np.fmax(sharpness, _CLEAN), sharpness)
    done = status[block] == 0
    groups = []
    for low, high, factor in ((1e-2, 3.0, 1e-2), (1e-4, 1e-2, 1e-4), (0.0, 1e-4, CLOSEST)):
        rows = block[done & (sharpness >= low) & (sharpness < high)]
        if len(rows):
            groups.append((factor, rows))
    return groups


def _unsettled(before: Array, after: Array, tolerance: float) -> npt.NDArray[np.bool_]:
    """Rows whose largest approach or end of contact a closer look has changed by so much that it takes another."""
    moved = np.zeros(len(after), dtype=bool)
    for column in (ANSWER_X_MAX, ANSWER_CONTACT):
        with np.errstate(invalid="ignore"):
            change = np.abs(after[:, column] - before[:, column])
            moved |= change > _SETTLED * tolerance * np.abs(after[:, column])
    return moved


def _other_ends(answers: Array, tolerance: float) -> Array:
    """What `graze` of the kernel gives the other answers of rows that the tolerance does not decide, else 0; (n, 2).

    Undecided is a row in which a face leaves by less than the tolerance of the largest approach (contact may go on:
    second column), or comes as close to leaving or lingers there (contact may be lost sooner: first column).
    """
    bound = tolerance * answers[:, ANSWER_X_MAX] * (1.0 + 1e-9)
    with np.errstate(invalid="ignore"):
        nearly, barely = answers[:, ANSWER_NEAREST] <= bound, answers[:, ANSWER_DEPTH] <= bound
    return np.stack([np.where(nearly, bound, 0.0), np.where(barely, -bound, 0.0)], axis=1)


def _farther(answers: Array, one: Array, other: Array) -> npt.NDArray[np.bool_]:
    """Rows (n,) whose end of contact is _farther from that of `answers` in `other` than in `one`, or only there."""
    with np.errstate(invalid="ignore"):
        ends = [np.abs(side[:, ANSWER_CONTACT] - answers[:, ANSWER_CONTACT]) for side in (one, other)]
    return np.asarray(np.nan_to_num(ends[1], nan=-1.0) > np.nan_to_num(ends[0], nan=-1.0))


def settle(
    march: March, block: Rows, tolerance: float, answers: Array, others: Array, status: Rows, steps: Rows, *,
    peak_only: bool = False,
) -> None:  # fmt: skip
    """Look closer at the doubtful rows of a block that has been integrated, until they are certain or have two answers.

    answers, others (n, ANSWERS), status, steps (n,) are brought up to date; undecided rows get the status for it.
    With `peak_only` nothing beyond the largest approach is asked for.
    """
    looks = doubtful(answers, status, steps, block, tolerance, peak_only)
    while looks:
        factor, rows = looks.pop(0)
        closer = max(_FINEST, factor * tolerance)
        before = answers[rows].copy()
        answers[rows], status[rows], steps[rows] = march(rows, closer, None)
        grazes = _other_ends(answers[rows], tolerance)
        # a row with two answers stays one, however closely it is looked at
        still = _unsettled(before, answers[rows], tolerance) & (status[rows] == 0) & (grazes == 0.0).all(axis=1)
        if closer > _FINEST and factor > CLOSEST and still.any():
            looks.append((max(0.01 * factor, CLOSEST), rows[still]))
            rows, grazes = rows[~still], grazes[~still]
        for graze in grazes.T:
            _other_answers(march, rows, closer, graze, answers, others, status)
        jumps = rows[jumping(answers[rows], closer) & (status[rows] == 0)]
        others[jumps] = _other_times(answers[jumps])
        status[jumps] = UNDECIDED


def _other_answers(
    march: March, rows: Rows, closer: float, graze: Array, answers: Array, others: Array, status: Rows
) -> None:
    """Integrate rows whose `graze` is not 0 with it, and keep what differs most from their answers."""
    chosen = (graze != 0.0) & ((status[rows] == 0) | (status[rows] == UNDECIDED))
    rows = rows[chosen]
    if len(rows) == 0:
        return
    found, found_status, _ = march(rows, closer, graze[chosen])
    kept = (status[rows] == 0) | _farther(answers[rows], others[rows], found)
    others[rows[kept]] = found[kept]
    status[rows] = np.where(found_status == 0, UNDECIDED, found_status)
