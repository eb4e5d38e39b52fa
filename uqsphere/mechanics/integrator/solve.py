"""The impact of a bar on a sphere held between two bars: all quantities of interest of a batch of scenes.

The equations are theory (3) in the scaled variables of theory (9):

    x_1' = 2 f - q(x_1) - u      x_2' = u - q(x_2) - 2 h      mu u' = q(x_1) - q(x_2)

with q(x) = max(x, 0)^(3/2) (`full`), max(x, 0) (`linear`), or mu = 0 (`massless`), f and h the waves that run
towards the sphere, theory (4) and (5).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics import bars, contact
from uqsphere.mechanics.integrator.tracked import (
    ANSWER_CONTACT,
    ANSWER_DEPTH,
    ANSWER_LOSS_RATE,
    ANSWER_NEAREST,
    ANSWER_RISE,
    ANSWER_RISES,
    ANSWER_WIDTH,
    ANSWER_WIDTHS,
    ANSWER_X_MAX,
    FULL,
    NOT_FINITE,
    WANT_ALL,
)
from uqsphere.mechanics.outputs import OUTPUTS, Answers, answers_of, wishes
from uqsphere.mechanics.scene import STATUS, UNDECIDED, Scene, answered

__all__ = [
    "CLOSEST",
    "MODES",
    "Motion",
    "Scaled",
    "integrate",
    "jumping",
    "march_rows",
    "motion",
    "refine",
    "scaled_arguments",
    "solve",
    "thread_count",
    "to_repeat",
]

# --- Answers that deserve a second look: which rows are integrated again more closely, and which have two answers.

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


def to_repeat(
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


def _moved_far(before: Array, after: Array, tolerance: float) -> npt.NDArray[np.bool_]:
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


def refine(
    march: March, block: Rows, tolerance: float, answers: Array, others: Array, status: Rows, steps: Rows, *,
    peak_only: bool = False,
) -> None:  # fmt: skip
    """Look closer at the doubtful rows of a block that has been integrated, until they are certain or have two answers.

    answers, others (n, ANSWERS), status, steps (n,) are brought up to date; undecided rows get the status for it.
    With `peak_only` nothing beyond the largest approach is asked for.
    """
    looks = to_repeat(answers, status, steps, block, tolerance, peak_only)
    while looks:
        factor, rows = looks.pop(0)
        closer = max(_FINEST, factor * tolerance)
        before = answers[rows].copy()
        answers[rows], status[rows], steps[rows] = march(rows, closer, None)
        grazes = _other_ends(answers[rows], tolerance)
        # a row with two answers stays one, however closely it is looked at
        still = _moved_far(before, answers[rows], tolerance) & (status[rows] == 0) & (grazes == 0.0).all(axis=1)
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


#: fidelities the integrator knows, and the number it knows them by
MODES: Final[dict[str, int]] = {"full": 0, "linear": 1, "massless": 2}
#: rows that one call of the kernel takes: enough to fill its lanes, few enough to share between threads
_BLOCK = 512
#: steps a row may take, tried in turn, so that memory stays small for the many rows that need few
_CAPACITIES = (1024, 16_384, 262_144)
#: error allowed in one step over the tolerance: for most quantities; where the difference of the forces is asked
#: for; where the record ends in the tail of the force.  Measured: every quantity then keeps the tolerance
_LOCAL, _LOCAL_DIFFERENCE, _LOCAL_TAIL = 1.0, 0.05, 0.1


@dataclass(frozen=True, kw_only=True)
class Motion:
    """One integrated scene: what anything between first touch and the end of the motion can be computed from.

    Attributes
    ----------
    scene : Scene
    row : int
        Which of its rows.
    start, length : (m,) arrays
        Of the steps, over t_c.
    states : (m, 3, k) array
        x_1, x_2 and u on every step: coefficients in ascending powers of the share of the step that has passed.
    end : float
        End of the motion over t_c, which may lie inside the last step.
    fidelity : str
        `full`, `linear` or `massless`.
    returning : function of (m,) times [s] to (m,) velocities [m/s], optional
        The wave that comes back to face B, where the end is more than a number (`uqsphere.mechanics.damper`).
    """

    scene: Scene
    row: int
    start: Array
    length: Array
    states: Array
    end: float
    fidelity: str = "full"
    returning: Callable[[Array], Array] | None = None

    @property
    def unit(self) -> float:
        """t_c [s], in which start, length and end are given."""
        return float(self.scene.scales.time[self.row])

    @property
    def horizon(self) -> float:
        """End of the motion [s]."""
        return self.end * self.unit

    @property
    def wave_speed(self) -> float:
        """c0 of the bars [m/s]."""
        columns = self.scene.columns
        return float(bars.wave_speed(columns["bars.E"][self.row], columns["bars.density"][self.row]))

    @property
    def impedance(self) -> float:
        """Z of the bars [kg/s]."""
        return float(self.scene.scales.impedance[self.row])

    @property
    def section(self) -> float:
        """F0 of the bars [m²]."""
        return float(bars.section(self.scene.columns["bars.diameter"][self.row]))

    @property
    def pulse_end(self) -> float:
        """Time at which the incident pulse is over at face A [s]; infinite for a step."""
        return float(self.scene.pulse.end[self.row])

    def round_trip(self, bar: int) -> float:
        """Round trip of a bar (0 incident, 1 receiving) [s]; infinite where it has no length."""
        return float(self.scene.round_trips[self.row, bar])

    def reflection(self, bar: int) -> float:
        """Velocity reflection coefficient of a bar's far end, where it is a number."""
        return float(self.scene.reflections[self.row, bar])

    def echoes(self, bar: int) -> bool:
        """Whether anything comes back from a bar's far end."""
        return self.reflection(bar) != 0.0 or (bar == 1 and self.returning is not None)

    def states_at(self, times: Array) -> Array:
        """Approaches at A, B [m], velocity of the sphere [m/s] at `times` [s], (m, 3); 0 before first touch."""
        scales, row = self.scene.scales, self.row
        s = times / scales.time[row]
        n = np.clip(np.searchsorted(self.start, s, side="right") - 1, 0, len(self.start) - 1)
        share = ((s - self.start[n]) / self.length[n])[:, None]
        coefficients = self.states[n]
        total = coefficients[:, :, -1]
        for k in range(coefficients.shape[2] - 2, -1, -1):
            total = total * share + coefficients[:, :, k]
        units = np.array([scales.approach[row], scales.approach[row], 0.5 * self.scene.columns["striker.speed"][row]])
        return np.where((s >= 0.0)[:, None], total * units, 0.0)

    def force_at(self, approach: Array) -> Array:
        """Contact force [N] at an approach [m]: Hertz, or the secant stiffness beta sqrt(alpha_c) of `linear`."""
        scales = self.scene.scales
        if self.fidelity == "linear":
            return np.asarray(scales.force[self.row] / scales.approach[self.row] * np.maximum(approach, 0.0))
        return np.asarray(contact.hertz_force(approach, scales.hertz_constant[self.row]))

    def forces_at(self, times: Array) -> Array:
        """Contact forces at A and B [N] at `times` [s], (m, 2)."""
        return self.force_at(self.states_at(times)[:, :2])

    def pressure_at(self, force: Any) -> Any:
        """Contact pressure p_0 [Pa] at a contact force [N]."""
        scales = self.scene.scales
        return contact.pressure_at_force(force, scales.modulus[self.row], scales.effective_radius[self.row])


def thread_count(threads: int | None = None) -> int:
    """Threads to use: what is asked for, or the processors this process may run on."""
    if threads is not None:
        if threads < 1:
            raise ValueError(f"threads must be at least 1, found {threads}")
        return threads
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)))
    return max(1, os.cpu_count() or 1)


def scaled_arguments(scene: Scene, rows: npt.NDArray[np.int64]) -> dict[str, Any]:
    """What the kernel needs of `rows`, in scaled variables."""
    time = scene.scales.time[rows]
    pulse = scene.pulse
    echoing = scene.reflections[rows] != 0.0
    breaks = pulse.breaks[rows] / time[:, None]
    powers = time[:, None] ** np.arange(4)
    duration = np.where(np.isfinite(breaks[:, -1]), breaks[:, -1], 1.0)
    return {
        "mass": scene.scales.mass_number[rows],
        "ends": scene.reflections[rows],
        "round_trips": np.where(echoing, scene.round_trips[rows] / time[:, None], np.inf),
        "breaks": breaks,
        "coefficients": np.ascontiguousarray(pulse.coefficients[rows] * powers[:, None, :]),
        "frequencies": pulse.frequency[rows] * time,
        "horizon": scene.record_end[rows] / time,
        "pulse_end": breaks[:, -1].copy(),
        "level": 0.1 * np.minimum(1.0, duration),
        "graze": np.zeros(len(rows)),
    }


def march_rows(
    arguments: dict[str, Any],
    order: npt.NDArray[np.int64],
    mode: int,
    tolerance: float,
    stop_at_loss: bool,
    answers: Array,
    status: npt.NDArray[np.int64],
    steps: npt.NDArray[np.int64],
    keep: int = 0,
    wanted: int = WANT_ALL,
    asked: float = 0.0,
) -> tuple[Array, Array, Array] | None:
    """Run the kernel on rows `order`, with more room for those that run out of it.

    answers (n, ANSWERS), status (n,) and steps (n,) are written at those rows.  keep = 1 keeps the steps of the last
    of them and returns start, length and states of `Motion`.
    """
    from uqsphere.mechanics.integrator.kernel import march
    from uqsphere.mechanics.integrator.step import TERMS

    share = _LOCAL_DIFFERENCE if wanted & 2 else _LOCAL
    if wanted & (8 | 16) and not np.isfinite(arguments["horizon"]).all():
        share = min(share, _LOCAL_TAIL)
    # in the full model the velocity, the stiffest of the three states, keeps the steps shorter than the approaches need
    local = share * tolerance * (1.0 if mode == MODES["full"] else 0.1)
    kept_steps = None
    for capacity in _CAPACITIES:
        room = capacity if keep else 0
        kept = (np.zeros(room), np.zeros(room), np.zeros((room, 3, TERMS)))
        march(
            mode,
            wanted,
            arguments["mass"],
            arguments["ends"],
            arguments["round_trips"],
            arguments["breaks"],
            arguments["coefficients"],
            arguments["frequencies"],
            arguments["horizon"],
            arguments["pulse_end"],
            arguments["level"],
            arguments["graze"],
            local,
            asked,
            stop_at_loss,
            capacity,
            answers,
            status,
            order,
            steps,
            *kept,
        )
        if keep:
            taken = int(steps[order[-1]])
            kept_steps = kept[0][:taken], kept[1][:taken], kept[2][:taken]
        order = order[status[order] == FULL]
        if len(order) == 0:
            break
    return kept_steps


@dataclass(frozen=True, kw_only=True)
class Scaled:
    """Scaled answers (n, ANSWERS) of `uqsphere.mechanics.integrator.tracked`, status (n,) and steps (n,) of n rows.

    What was not asked for may be NaN.  `others` (n, ANSWERS): the other answer where the status is 7.
    """

    answers: Array
    others: Array
    status: npt.NDArray[np.int64]
    steps: npt.NDArray[np.int64]


def integrate(
    scene: Scene,
    *,
    fidelity: str = "full",
    tolerance: float = 1e-6,
    threads: int | None = None,
    quantities: Collection[str] | None = None,
) -> Scaled:
    """Integrate a batch in scaled variables; what `quantities` does not name is not followed."""
    from uqsphere.mechanics.integrator.tracked import empty_answers

    status = scene.status.copy()
    rows = np.flatnonzero(status == 0)
    answers, others = empty_answers(len(scene)), empty_answers(len(scene))
    steps = np.zeros(len(scene), dtype=np.int64)
    if len(rows) == 0:
        return Scaled(answers=answers, others=others, status=status, steps=steps)
    wanted = wishes(quantities, scene.demands)
    arguments = scaled_arguments(scene, rows)
    inner, inner_others = empty_answers(len(rows)), empty_answers(len(rows))
    inner_status = np.zeros(len(rows), dtype=np.int64)
    inner_steps = np.zeros(len(rows), dtype=np.int64)
    blocks = [np.arange(begin, min(begin + _BLOCK, len(rows))) for begin in range(0, len(rows), _BLOCK)]
    mode = MODES[fidelity]

    def march(order: Rows, closer: float, graze: Array | None = None) -> tuple[Array, Rows, Rows]:
        given = {name: column[order] for name, column in arguments.items()}
        if graze is not None:
            given["graze"] = graze
        found, its_status, its_steps = empty_answers(len(order)), np.zeros_like(order), np.zeros_like(order)
        march_rows(given, np.arange(len(order)), mode, closer, True, found, its_status, its_steps, wanted=wanted,
               asked=tolerance)  # fmt: skip
        return found, its_status, its_steps

    def run(block: Rows) -> None:
        inner[block], inner_status[block], inner_steps[block] = march(block, tolerance)
        refine(march, block, tolerance, inner, inner_others, inner_status, inner_steps,
               peak_only=wanted == 0)  # fmt: skip

    workers = min(thread_count(threads), len(blocks))
    if workers == 1:
        for block in blocks:
            run(block)
    else:
        run(blocks[0][:0])  # compile, or load, once before the threads ask for it
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(run, blocks))
    answers[rows], status[rows], steps[rows], others[rows] = inner, inner_status, inner_steps, inner_others
    return Scaled(answers=answers, others=others, status=status, steps=steps)


def motion(scene: Scene, row: int, *, fidelity: str = "full", tolerance: float = 1e-6) -> Motion:
    """The motion of one scene on to the horizon, contacts lost and found again included.

    Raises
    ------
    ValueError
        If the row lies outside the domain or cannot be integrated; the message is that of its status.
    """
    _check_request(fidelity, tolerance)
    status = scene.status[[row]].copy()
    if status[0] == 0:
        from uqsphere.mechanics.integrator.tracked import ANSWER_END, empty_answers

        answers, steps = empty_answers(1), np.zeros(1, dtype=np.int64)
        only = np.zeros(1, dtype=np.int64)
        found = march_rows(
            scaled_arguments(scene, np.array([row])),
            only,
            MODES[fidelity],
            tolerance,
            False,
            answers,
            status,
            steps,
            keep=1,
        )
        if status[0] == 0 and found is not None:
            start, length, states = found
            end = float(answers[0, ANSWER_END])
            return Motion(scene=scene, row=row, start=start, length=length, states=states, end=end, fidelity=fidelity)
    raise ValueError(f"row {row} has no motion: {STATUS[int(status[0])]}")


def _check_request(fidelity: str, tolerance: float) -> None:
    if fidelity not in MODES:
        raise ValueError(f"unknown fidelity {fidelity!r} (allowed: {', '.join(MODES)})")
    if not 1e-12 <= tolerance <= 1e-2:
        raise ValueError(f"tolerance must lie between 1e-12 and 1e-2, found {tolerance!r}")


def solve(
    scene: Scene,
    *,
    fidelity: str = "full",
    tolerance: float = 1e-6,
    threads: int | None = None,
    quantities: Collection[str] | None = None,
) -> Answers:
    """Quantities of interest of n scenes by integrating the equations of motion.

    Parameters
    ----------
    scene : Scene
    fidelity : str
        `full`, `linear` (a spring of the secant stiffness beta sqrt(alpha_c) in place of the Hertz contact) or
        `massless` (mu = 0).
    tolerance : float
        Relative error asked for in every quantity, 1e-12 to 1e-2.
    threads : int, optional
        Threads; all processors of this process if None.  The answers do not depend on it.
    quantities : collection of str, optional
        Names of `uqsphere.mechanics.outputs.OUTPUTS`; all if None.  What is not asked for is not computed.

    Returns
    -------
    Answers
        With NaN and a status for rows outside the domain; never a number that was not computed.
    """
    _check_request(fidelity, tolerance)
    if quantities is not None and (unknown := set(quantities) - set(OUTPUTS) - set(scene.demands)):
        raise ValueError(f"unknown quantities {', '.join(sorted(unknown))} (allowed: {', '.join(OUTPUTS)})")
    found = integrate(scene, fidelity=fidelity, tolerance=tolerance, threads=threads, quantities=quantities)
    linear = fidelity == "linear"
    solved = answers_of(scene, found.answers, found.status, found.steps, linear=linear, quantities=quantities)
    if not (found.status == UNDECIDED).any():
        return solved
    other = answers_of(scene, found.others, found.status, found.steps, linear=linear, quantities=quantities)
    undecided = (solved.status == UNDECIDED) & (other.status == UNDECIDED)
    # one of the two answers alone is no answer
    status = np.where((solved.status == UNDECIDED) & ~undecided, NOT_FINITE, solved.status)
    values = {name: np.where(answered(status), value, np.nan) for name, value in solved.values.items()}
    others = {name: np.where(undecided, value, np.nan) for name, value in other.values.items()}
    return replace(solved, values=values, others=others, status=status)
