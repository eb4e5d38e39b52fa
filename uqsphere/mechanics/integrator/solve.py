"""A sphere between two bars, or any two partners: all quantities of interest of a batch of scenes.

The equations are theory (3) in the scaled variables of theory (9), and (R3) for the other rigs:

    x_1' = 2 f - zeta_A q_1 + U_A - u      x_2' = u - zeta_B q_2 - 2 h - U_B      mu u' = q_1 - q_2
    mu_A U_A' = -q_1                       mu_B U_B' = q_2

with q = max(x, 0)^(3/2) (`full`), max(x, 0) (`linear`), or mu = 0 (`massless`), f and h the waves
that run towards the sphere, theory (4) and (5); between bars zeta = 1 and U = 0.  Faces that differ
or yield have laws of their own (`uqsphere.mechanics.integrator.faces`).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property, partial
from typing import Any, TypeVar

import numpy as np
from numpy.polynomial.polynomial import polyval

from uqsphere.arrays import Array, Flags, Places, Values, frozen
from uqsphere.mechanics import bars, contact
from uqsphere.mechanics.outputs import OUTPUTS, SceneAnswers, answers_from, wishes
from uqsphere.mechanics.scene import STATUS, Scales, Scene

from . import tracked
from .tracked import Rows

Result = TypeVar("Result")

#: fidelities the integrator knows, and the number it knows them by
MODES: dict[str, int] = {
    "full": tracked.FULL,
    "linear": tracked.LINEAR,
    "massless": tracked.MASSLESS,
}
#: rows that one call of the kernel takes: enough to fill its lanes, few enough to share between
#: threads
_BLOCK = 512
#: steps of a row that there is room for, tried one after another, so that memory stays small for
#: the many rows that need few; powers of two, from 16,384 on each twice the one before.  Only steps
#: that are read again need room: how many a row may take is `kernel.LIMIT`
_CAPACITIES = (1024, *(16_384 << k for k in range(5)))
#: error allowed in one step over the tolerance: for most quantities; where a difference of forces
#: or of speeds is asked for; where the record ends in the tail of the force; once a face has
#: yielded, for the end of contact.  Measured by the sweep, each quantity asked for alone: each then
#: keeps the tolerance
_LOCAL, _LOCAL_DIFFERENCE, _LOCAL_TAIL, _LOCAL_YIELDED = 0.25, 0.05, 0.1, 0.1


@frozen
class Motion:
    """One integrated scene: what anything between first touch and the end of the motion can be
    computed from.

    start, length (m,): of the steps, over t_c; states (m, 3, k): x_1, x_2 and u on every step,
    coefficients in ascending powers of the share of the step that has passed; forces (m, 2, k): the
    same of both forces over P_c, where they do not follow from the approach alone.  end: over t_c,
    where the last step ends.  Behind a step at whose end every face is open, round trips of a
    rod may be left out: each repeats the echoes of the last one times R (`records`).
    """

    scene: Scene
    row: int
    start: Array
    length: Array
    states: Array
    end: float
    fidelity: str = "full"
    forces: Array | None = None

    @cached_property
    def scales(self) -> Scales:
        """Scale factors of the row, numbers."""
        return self.scene.scales.at(self.row)

    @property
    def unit(self) -> float:
        """t_c [s], in which start, length and end are given."""
        return float(self.scales.time)

    @property
    def horizon(self) -> float:
        """End of the motion [s]."""
        return self.end * self.unit

    @property
    def material(self) -> list[float]:
        """E [Pa] and density [kg/m³] of the bars, or of the rod ahead of the sphere."""
        table = self.scene.partners[1].table
        return [float(column[self.row]) for column in self.scene.numbers(table, "E density")]

    @property
    def wave_speed(self) -> float:
        """c0 of the bars [m/s]."""
        return float(bars.wave_speed(*self.material))

    @property
    def pulse_end(self) -> float:
        """Time at which the incident pulse is over at face A [s]; infinite for a step."""
        return float(self.scene.pulse.end[self.row])

    def round_trip(self, bar: int) -> float:
        """Round trip of a bar (0 incident, 1 receiving) [s]; infinite where it has no length."""
        return float(self.scene.round_trips[self.row, bar])

    def bar_length(self, bar: int) -> float:
        """Length of a bar [m]; infinite where it has none."""
        return 0.5 * self.wave_speed * self.round_trip(bar)

    def echo(self, bar: int) -> float:
        """Round trip of a bar whose far end sends a wave back [s]; else infinite."""
        return float(self.scene.echoes[self.row, bar])

    @cached_property
    def _leapt(self) -> Flags:
        """Whether round trips are left out behind a step, (m,)."""
        gaps = self.start[1:] - self.start[:-1] - self.length[:-1]
        return np.append(gaps * self.unit > 0.5 * self.echo(1), False)

    def _step_at(self, s: Array) -> Places:
        """Numbers (n,) of the steps in or behind which times over t_c lie."""
        return np.clip(np.searchsorted(self.start, s, side="right") - 1, 0, len(self.start) - 1)

    def _at(self, series: Array, s: Array) -> Array:
        """Series (m, k, terms) of the steps at times over t_c, (n, k), scaled; 0 before first
        touch.
        """
        n = self._step_at(s)
        theta = ((s - self.start[n]) / self.length[n])[:, None]
        found = polyval(theta, np.moveaxis(series[n], 2, 0), tensor=False)
        return np.where((s >= 0.0)[:, None], found, 0.0)

    def _scaled_states(self, s: Array) -> Array:
        """States (n, 3) at times over t_c, scaled.

        In round trips that are left out the sphere moves evenly, and the gap at the rod by that and
        by the echoes of the last round trip times R, R², ...
        """
        found = self._at(self.states, s)
        n = self._step_at(s)
        begin = self.start[n] + self.length[n]
        inside = np.flatnonzero(self._leapt[n] & (s > begin))
        if len(inside) == 0:
            return found
        n = n[inside]
        begin = begin[inside]
        trip = self.echo(1) / self.unit
        reflects = float(self.scene.reflections[self.row, 1])
        trips, rest = np.divmod(s[inside] - begin, trip)
        whole = np.rint((self.start[n + 1] - begin) / trip)
        returned = trips / whole  # R + R² + ..., over the sum of all round trips
        if reflects < 1.0:
            returned = (1.0 - reflects**trips) / (1.0 - reflects**whole)
        gap, before, then = (
            self._scaled_states(at)[:, 1] for at in (begin, begin - trip, begin - trip + rest)
        )
        evenly = found[inside, 2] * trip
        opened = self.states[n + 1, 1, 0] - gap - evenly * whole
        found[inside, 1] = gap + evenly * trips + opened * returned
        evenly *= rest / trip
        found[inside, 1] += evenly + (then - before - evenly) * reflects ** (trips + 1.0)
        return found

    def states_at(self, times: Array) -> Values:
        """Approaches at A, B [m], velocity of the sphere [m/s] at `times` [s], (m, 3); 0 before
        first touch.
        """
        approach = self.scales.approach
        units = np.array([approach, approach, self.scales.speed])
        return self._scaled_states(times / self.unit) * units

    def forces_at(self, times: Array) -> Values:
        """Contact forces at A and B [N] at `times` [s], (m, 2)."""
        scales = self.scales
        if self.forces is not None:
            return np.maximum(self._at(self.forces, times / self.unit), 0.0) * scales.force
        approach = self.states_at(times)[:, :2]
        if self.fidelity == "linear":  # the secant stiffness beta sqrt(alpha_c)
            return scales.force / scales.approach * np.maximum(approach, 0.0)
        return contact.hertz_force(approach, scales.hertz_constant)

    def pressure_at(self, force: Values, pole: int = 0) -> Values:
        """Centre pressure p_0 [Pa] of a face at a contact force [N]; the largest so far where the
        face yields.
        """
        partner = self.scene.partners[pole]
        if partner is None:
            return np.zeros_like(force)
        if partner.face is not None:
            law = partner.face.at(self.row)
            return law.pressed(law.depth_at(np.asarray(force))).p_max
        return contact.pressure_at_force(
            force, partner.modulus[self.row], partner.effective_radius[self.row]
        )


def thread_count(threads: int | None = None) -> int:
    """Threads to use: what is asked for, or the processors this process may run on."""
    if threads is not None:
        if threads < 1:
            raise ValueError(f"threads must be at least 1, found {threads}")
        return threads
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def scaled_arguments(scene: Scene, rows: Places) -> Rows:
    """What the kernel needs of `rows`, in scaled variables."""
    scales = scene.scales.at(rows)
    time = scales.time
    pulse = scene.pulse
    powers = time[:, None] ** np.arange(4)
    poles = np.zeros((len(rows), 2), tracked.POLE)
    poles["stiffness"] = 1.0
    poles["onset"] = np.inf
    for side, partner in enumerate(scene.partners):
        if partner is None:
            continue
        pole = poles[:, side]
        pole["there"] = 1.0
        pole["gives"] = scales.force / (partner.impedance[rows] * scales.speed)
        pole["lightness"] = scales.force * time / (partner.mass[rows] * scales.speed)
        pole["speed"] = (1 - 2 * side) * scene.start[rows, 1 + side] / scales.speed
        pole["stiffness"] = partner.hertz_constant[rows] / scales.hertz_constant
        pole["chi"] = partner.share[rows]
        if partner.face is not None:
            face = partner.face.at(rows)
            pole["onset"] = face.onset_approach / scales.approach
            pole["softening"] = np.where(np.abs(face.softening) < 1e-12, 0.0, face.softening)
            pole["pile_up"] = face.pile_up
    return Rows(
        mass=scales.mass_number,
        reflections=scene.reflections[rows],
        round_trips=scene.echoes[rows] / time[:, None],
        breaks=pulse.breaks[rows] / time[:, None],
        coefficients=np.ascontiguousarray(pulse.coefficients[rows] * powers[:, None, :]),
        frequencies=pulse.frequency[rows] * time,
        record_end=scene.record_end[rows] / time,
        poles=poles,
        speed=scene.start[rows, 0] / scales.speed,
    )


@frozen
class Task:
    """What is asked of rows that share their structure; every field is one of `tracked.STATE`.

    mode: FULL, LINEAR or MASSLESS.  wanted: bits `tracked.WANT_*`.  tolerance: of the integration.
    requested: of the answers, where `tolerance` is closer.  has_laws: whether faces differ or may
    yield.  rigged: whether other partners than bars stand at the poles.  stop_at_loss: whether the
    record of bars may end at a loss of contact.
    """

    mode: int
    wanted: int
    tolerance: float
    requested: float = 0.0
    has_laws: bool
    rigged: bool
    stop_at_loss: bool


def task_of(
    scene: Scene, fidelity: str, tolerance: float, quantities: Collection[str] | None = None
) -> Task:
    """What is asked of the rows of a scene; quantities: all if None."""
    wanted = wishes(quantities, scene.demands)
    if scene.by_hertz:
        wanted &= ~tracked.WANT_SPHERE_ENERGY
    return Task(
        mode=MODES[fidelity],
        wanted=wanted,
        tolerance=tolerance,
        has_laws=not scene.by_hertz,
        rigged=not scene.by_wave,
        stop_at_loss=scene.by_wave and not scene.whole_record,
    )


def _local_errors(task: Task, finite: bool) -> tuple[float, float]:
    """The error allowed in one step, and the share of it that is left once a face has yielded.

    finite: whether all records end at a horizon.  Between bars those of a scene all do, or none
    (`Scene.record_end`): no row depends on those beside it.
    """
    over_tolerance = yielded = _LOCAL
    if task.wanted & (tracked.WANT_DIFFERENCE | tracked.WANT_AFTER):
        over_tolerance = _LOCAL_DIFFERENCE
    if not task.rigged:
        if finite:
            yielded = _LOCAL_YIELDED
        elif task.wanted & tracked.BY_LOSS:
            over_tolerance = min(over_tolerance, _LOCAL_TAIL)
    # in the full model the velocity, the stiffest of the three states, keeps the steps shorter than
    # the approaches need
    local = over_tolerance * task.tolerance
    if task.mode != tracked.FULL:
        local *= 0.1
    return local, min(1.0, yielded / over_tolerance)


def march_rows(rows: Rows, task: Task) -> tuple[Any, list[Any]]:
    """Run the kernel on all of `rows`, with more room for those that run out of it.

    Returns the answers (n,), of the type `tracked.ANSWER`, and of a motion that is wanted the steps
    of every row, (m,) of the type `tracked.PATH`.
    """
    from .kernel import march

    wanted = task.wanted
    local, yielded_share = _local_errors(task, bool(np.isfinite(rows.record_end).all()))
    power = 2.0 / 3.0
    if task.mode == tracked.LINEAR:
        power = 1.0
    echoing = bool(np.isfinite(rows.round_trips).any())
    answers = tracked.empty_answers(len(rows.mass))
    order = np.arange(len(answers))
    paths = [np.empty(0, tracked.PATH)] * len(answers)
    settings = vars(task) | {
        "local": local,
        "yielded_share": yielded_share,
        "tail": tracked.TAIL_SHARE**power,
        "lanes": tracked.LANES,
        "side_sign": np.repeat([1.0, -1.0], tracked.LANES),
        **dict.fromkeys(("size", "u_size", "free_size", "wrong_allowed"), 1.0),
    }
    for capacity in _CAPACITIES:
        state = tracked.empty_lanes()
        for name, value in settings.items():
            state[name] = value
        state["capacity"] = capacity
        # how many steps are read again: all that there is room for, or the last one alone
        state["ring"] = capacity if wanted & tracked.WHOLE_PATH or echoing else 1
        # not set to anything: only the pages of steps that are taken ever cost memory.  With room
        # for a power of two of steps all lanes would share a few lines of the processor's cache
        past = np.empty((tracked.LANES, capacity + 8), tracked.STEP)
        series = np.zeros(
            (len(order), capacity if wanted & tracked.WANT_MOTION else 0), tracked.PATH
        )
        march(rows, order, state, past, series, answers)
        if wanted & tracked.WANT_MOTION:
            for row, path in zip(order.tolist(), series, strict=True):
                paths[row] = path[: answers["steps"][row]].copy()
        order = order[answers["status"][order] == tracked.FULL_ROOM]
        if len(order) == 0:
            break
    answers["status"][order] = tracked.TOO_MANY_STEPS
    return answers, paths


def integrate(scene: Scene, task: Task, *, threads: int | None = None) -> Any:
    """Scaled answers (n,), of the type `tracked.ANSWER`, of a batch."""
    answers = tracked.empty_answers(len(scene))
    answers["status"] = scene.status
    rows = np.flatnonzero(scene.status == 0)
    if len(rows):
        size = _BLOCK
        if thread_count(threads) == 1:  # lanes run empty, and rows are looked at again, only once
            size = len(rows)
        looked = _by_blocks(
            partial(look_closer, task=task), scaled_arguments(scene, rows), size, threads
        )
        answers[rows] = np.concatenate(looked)
    return answers


def motion(scene: Scene, row: int, *, fidelity: str = "full", tolerance: float = 1e-6) -> Motion:
    """The motion of one scene on to the horizon, contacts lost and found again included.

    ValueError, with the message of its status, if the row lies outside the domain or cannot be
    integrated.
    """
    found: Motion | int = int(scene.status[row])
    if found == 0:
        whole = replace(scene, whole_record=True)
        (found,) = motions(whole, np.array([row]), fidelity=fidelity, tolerance=tolerance)
    if isinstance(found, Motion):
        return found
    raise ValueError(f"row {row} has no motion: {STATUS[found]}")


def motions(
    scene: Scene,
    rows: Places,
    *,
    fidelity: str = "full",
    tolerance: float = 1e-6,
    threads: int | None = None,
    quantities: Collection[str] | None = None,
) -> list[Motion | int]:
    """The motions of some rows inside the domain, or the status of those that cannot be integrated.

    They end with the record of the scene, or once none of the `quantities` can change any more.
    Raises ValueError as `solve`.
    """
    check_request(scene, fidelity, tolerance)
    task = task_of(scene, fidelity, tolerance, quantities)
    task = replace(task, wanted=task.wanted | tracked.WANT_MOTION)
    # a call keeps room for all steps of its rows, which fill the lanes of the kernel
    marched = _by_blocks(
        partial(march_rows, task=task), scaled_arguments(scene, rows), tracked.LANES, threads
    )
    courses: list[Motion | int] = []
    for answers, paths in marched:
        for answer, path in zip(answers, paths, strict=True):
            course: Motion | int = int(answer["status"])
            if course == tracked.OK:
                course = Motion(
                    scene=scene,
                    row=int(rows[len(courses)]),
                    start=path["start"],
                    length=path["length"],
                    states=path["series"][:, :3],
                    forces=path["series"][:, 3:] if task.has_laws else None,
                    end=float(answer["ended"]),
                    fidelity=fidelity,
                )
            courses.append(course)
    return courses


def _by_blocks(
    run: Callable[[Rows], Result],
    rows: Rows,
    size: int,
    threads: int | None,
) -> list[Result]:
    """What a function makes of rows, in blocks of so many, by threads."""

    def run_on(block: slice) -> Result:
        return run(rows.at(block))

    blocks = [slice(begin, begin + size) for begin in range(0, len(rows.mass), size)]
    workers = min(thread_count(threads), len(blocks))
    if workers <= 1:
        return list(map(run_on, blocks))
    run_on(slice(0, 0))  # compile, or load, once before the threads ask for it
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(run_on, blocks))


def has_motion(scene: Scene, fidelity: str) -> bool:
    """Whether the equations of motion are those of the rig of a scene; else its answers are in
    closed form alone.
    """
    return scene.by_wave or (fidelity == "full" and not scene.setup.by_press)


def check_request(scene: Scene, fidelity: str, tolerance: float) -> None:
    """Raise ValueError where the equations of motion are not to be integrated."""
    if fidelity not in MODES:
        raise ValueError(f"unknown fidelity {fidelity!r} (allowed: {', '.join(MODES)})")
    if not scene.by_wave and fidelity != "full":
        raise ValueError(
            f"the fidelity {fidelity!r} is one of the rig bars: rig {scene.rig!r} needs 'full'"
        )
    if not has_motion(scene, fidelity):
        raise ValueError(
            "between platens nothing moves: their answers are static, without an integrator"
        )
    if fidelity == "linear" and scene.struck.face is not None:
        raise ValueError(
            "a linear contact does not yield: choose the fidelity full or massless, or [contact] "
            "law hertz"
        )
    if not 1e-12 <= tolerance <= 1e-2:
        raise ValueError(f"tolerance must lie between 1e-12 and 1e-2, found {tolerance!r}")


def solve(
    scene: Scene,
    *,
    fidelity: str = "full",
    tolerance: float = 1e-6,
    threads: int | None = None,
    quantities: Collection[str] | None = None,
) -> SceneAnswers:
    """Quantities of interest of n scenes by integrating the equations of motion.

    fidelity: `full`, `linear` (a spring of the secant stiffness beta sqrt(alpha_c) in place of the
    Hertz contact; not where faces yield) or `massless` (mu = 0), both between bars alone.
    tolerance: relative error asked for in every quantity, 1e-12 to 1e-2.  threads: all processors
    of this process if None; the answers do not depend on it. quantities: names of `outputs.OUTPUTS`
    or demands; what is not asked for is not computed.  Rows outside the domain have NaN and a
    status.
    """
    check_request(scene, fidelity, tolerance)
    if quantities is not None and (unknown := set(quantities) - set(OUTPUTS) - set(scene.demands)):
        raise ValueError(
            f"unknown quantities {', '.join(sorted(unknown))} (allowed: {', '.join(OUTPUTS)})"
        )
    task = task_of(scene, fidelity, tolerance, quantities)
    columns = tracked.answer_columns(integrate(scene, task, threads=threads))
    return answers_from(scene, columns, linear=fidelity == "linear", quantities=quantities)


def later_loading(scene: Scene, *, tolerance: float = 1e-4) -> Array:
    """Largest force up to the horizon over that of the record, (n,): above 1 the loose sphere
    strikes one bar harder than it is squeezed in the record.

    NaN where a row has no answer; 1 where the record leaves nothing out: that of other rigs ends
    when no contact can follow, and the others are cut as the study says.  A row followed to the
    horizon costs 3 to 75 times as much: a run looks at its first 512.
    """
    if scene.rig != "bars" or scene.infinite or scene.first_loading_only or scene.whole_record:
        return np.where(scene.status == 0, 1.0, np.nan)
    peaks = [
        solve(
            replace(scene, whole_record=whole),
            tolerance=tolerance,
            quantities=("P_max",),
        ).values["P_max"]
        for whole in (False, True)
    ]
    return np.maximum(peaks[1] / peaks[0], 1.0)


# --- rows that are integrated again ---------------------------------------------------------------

#: steps after which the errors of single steps may have added up.  Where no wave comes back they
#: leave the largest approach within a twentieth of the tolerance after up to 18,000 steps
#: (`tests/mechanics/test_hard_cases.py`); between echoes it was 27 tolerances off after 1,300
_MANY_STEPS = 1_000
#: share of its tolerance that a row is integrated again with, and the smallest tolerance: 450
#: roundings of a double
_CLOSER, _FINEST = 1e-2, 1e-13
#: tolerances by which an error of the approach may move the first loss of contact; where its time
#: is asked for, a first look leaves a third of one
_FIRM, _FIRST_LOOK = 10.0, 30.0
#: share of the sphere's speed by which two looks differ where their motions have parted: far above
#: any tolerance, far below another blow; what it decides is one look more
_ASTRAY = 1e-2
#: share of the closing speed below which a speed behind an impact has a closer look: it errs by up
#: to a tenth of a tolerance of the closing speed
_SLOW = 0.2
#: answers that are compared at two tolerances; not a number where not wanted
_COMPARED = {"x_a", "x_b", "difference", "stored", "mean_force", "duration"}


def look_closer(rows: Rows, task: Task) -> Any:
    """Answers of `march_rows`; of rows in which they may be worse than the tolerance of the task,
    those of another look, a hundred times closer than the last one, until a look settles them.

    There are four reasons for another look, and what the last one leaves of the first three is the
    row's `grazes`, else 0:

    undecided   an error may decide whether contact is lost, or move the first loss, or the last one
                of a rig, by more than `_FIRM` tolerances: GRAZES
    counted     a duration counts contacts behind the first loss, and differs by as much from that
                of one look more: GRAZES
    compared    many steps, or contacts that were found again, have added errors up, and any answer
                differs by as much between the last two looks: RATTLES
    slow        little is left of the closing speed, and the tolerance is one of what is left
    """
    wanted = task.wanted
    task = replace(task, requested=task.tolerance)
    answers, _ = march_rows(rows, task)
    answers["grazes"] = 0.0
    # many steps add errors up, and each contact that is found again throws the sphere by its own
    compared = answers["steps"] > _MANY_STEPS
    echoing = np.asarray(np.isfinite(rows.round_trips).any(axis=1))
    if not wanted & ~(tracked.WANT_DURATION | tracked.WANT_MEAN):
        compared &= echoing
    compared |= answers["regained"] > 0.0
    counted = (answers["contact_censored"] == 0.0) & (answers["counted"] > answers["contact"])
    counted &= wanted & tracked.WANT_DURATION != 0 and not task.rigged
    enough = _close_enough(rows, answers, task)
    again = np.flatnonzero(
        compared | counted | _undecided(answers, task) | (task.tolerance > enough)
    )
    while len(again) and task.tolerance > _FINEST:
        task = replace(task, tolerance=max(_CLOSER * task.tolerance, _FINEST))
        before = answers[again]
        look, _ = march_rows(rows.at(again), task)
        # a row that has no room for so many steps keeps the answers that it has, and is marked
        done = look["status"] == tracked.OK
        answers[again[done]] = look[done]
        differs = _differences(before, look, task)
        largest = np.fmax.reduce([np.zeros(len(again)), *differs.values()])
        # a record that goes on to its horizon may have missed a blow where it is not known how the
        # sphere moves at the end
        speed = look["sphere_speed"]
        astray = np.abs(speed - before["sphere_speed"]) > _ASTRAY * np.abs(speed)
        astray &= echoing[again] & (look["ended"] >= rows.record_end[again] * (1.0 - 1e-12))
        undecided = _undecided(answers[again], task)
        counted[again] &= ~done | (differs["duration"] > _FIRM)
        grazes = tracked.GRAZES * (undecided | counted[again])
        rattles = compared[again] & (~done | (largest > _FIRM))
        answers["grazes"][again] = np.where(rattles, tracked.RATTLES, grazes)
        unlike = compared[again] & ((largest > 1.0) | astray)
        again = again[done & (undecided | unlike | (task.tolerance > enough[again]))]
    return answers


def _undecided(answers: Any, task: Task) -> Flags:
    """Rows in which an error may decide on the first loss of contact, or in rigs on the last one,
    or move it too far, and something that is wanted depends on it.
    """
    asked = task.wanted & tracked.WANT_CONTACT
    blur = answers["blur"]
    last = answers["parting_blur"]
    if asked and task.tolerance == task.requested:
        blur = _FIRST_LOOK * blur
        last = _FIRM * last  # it is a bound: one tolerance
    if task.stop_at_loss:
        asked = task.wanted & tracked.BY_LOSS
    lost = np.nan_to_num(answers["contact"])
    # a loss that may be none at all has `grazed` 0, so that it moves by all of its time
    moved = np.fmax(lost - answers["grazed"], blur)
    most = _FIRM * task.requested
    too_far: Flags = (moved > most * lost) & (asked != 0)
    if task.wanted & tracked.WANT_PARTING and task.rigged:
        too_far |= last > most * answers["parting"]
    return too_far


def _close_enough(rows: Rows, answers: Any, task: Task) -> Array:
    """The tolerance (n,) at which speeds behind an impact, of which little may be left, keep that
    of the task; infinite where none is wanted.
    """
    behind, ahead = answers["end_speed"].T
    parting = ahead - answers["sphere_speed"]
    left = np.abs(np.where(rows.poles["there"][:, 0] > 0.0, behind, parting))
    wanted = answers["status"] == tracked.OK
    wanted &= task.rigged and task.wanted & tracked.WANT_AFTER != 0
    return np.where(wanted, left * task.requested / _SLOW, np.inf)


def _differences(before: Any, after: Any, task: Task) -> dict[str, Array]:
    """Tolerances that were asked for by which answers of two looks differ, by name; not a number
    where both are zero or not wanted.
    """
    names = _COMPARED
    if task.rigged and task.wanted & tracked.WANT_CONTACT:
        names = names | {"parting"}
    earlier, later = map(tracked.answer_columns, (before, after))
    with np.errstate(divide="ignore", invalid="ignore"):
        return {name: np.abs(later[name] / earlier[name] - 1.0) / task.requested for name in names}
