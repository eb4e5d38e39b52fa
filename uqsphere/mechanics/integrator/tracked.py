"""What the integrator follows of a row, by the numbers of its columns: the one list of it.

A new answer of a row needs

    here      a field of `LANE` to follow it by, or, for a largest value, a number before `KINDS`,
              and its bit in `OF_BOTH`; a field of `ANSWER`; if it costs time a bit `WANT_` (and the
              length of theirs, and `WANT_ALL`), and an entry of `WISHES`; an entry of `_AT_START`
              unless it begins at zero
    records   its answer in `finish`; for a largest value `no_later_peak`, by which a record ends
              once it cannot grow
    events    what follows it in `after_step`; for a largest value of both faces `_both` and
              `_bound`
    outside   `closed_form` for scenes that it answers in place of the integrator; ``outputs.toml``
              and a formula in `outputs`, which reads it by its name (`answer_columns`), and
              `outputs.absent_in` for scenes without it
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from uqsphere.arrays import Array, Places

#: highest power of a series; four square roots take the 16th root
ORDER = 16
TERMS = ORDER + 1
#: rows that advance together (1 is allowed), and columns of what exists at both faces
LANES = 16
PAIR = 2 * LANES
#: parts into which a step is divided before an event in it is refined
POINTS = 4
#: points over a step at which a wave that comes back is read
WAVE = 12
#: room for jumps that are under way in each bar
QUEUE = 2048
#: parts of a round trip in which the waves under way are bounded (`records`)
CELLS = 512

#: answers of a row that another look may change: first and last losses of contact and durations,
#: where contact nearly is or is not lost; all of them, peaks too, where it is so often
GRAZES, RATTLES = 1.0, 2.0
#: what is integrated: theory (9), the linear contact of the paper's section 4, no mass
FULL, LINEAR, MASSLESS = range(3)


class End(IntEnum):
    """What ends a step: its series or a jump of the waves, the record, a contact that is lost, one
    that is found, a face that changes its branch.
    """

    SERIES = 0
    RECORD = 1
    LOST = 2
    TOUCHED = 3
    BRANCH = 4


#: status of a row; of one that is not done the first, of one to be tried with more room the last
GOES_ON = -1
OK, DOMAIN, TOO_LONG_PULSE, STUCK, CROWDED, TOO_MANY_STEPS, NOT_FINITE, FULL_ROOM = range(8)
NEVER_CLOSES, STILL_PRESSED = 11, 12

# what the caller wants beside the largest approaches, as bits; that of a largest value is 1 << (its
# tracker - 1)
(
    WANT_RISE,
    WANT_DIFFERENCE,
    WANT_ENERGY,
    WANT_SPHERE_ENERGY,
    WANT_MEAN,
    WANT_DURATION,
    WANT_CONTACT,  # losses of contact
    WANT_AFTER,  # speeds behind an impact, and the energy sent out
    WANT_PARTING,  # that last one
    WANT_MOTION,
) = (1 << k for k in range(10))
#: all answers
WANT_ALL = (1 << 9) - 1
#: what reads all steps of a row again
WHOLE_PATH = WANT_RISE | WANT_MOTION
#: largest values of functions of both faces
OF_BOTH = WANT_DIFFERENCE | WANT_ENERGY | WANT_SPHERE_ENERGY | WANT_MEAN
#: what a loss of contact decides
BY_LOSS = WANT_DURATION | WANT_CONTACT | WANT_DIFFERENCE

# largest values of a row so far: of each face's approach (of both where faces are alike), of the
# difference of the forces, of the stored energy, of the sphere's share of it and of the mean force
FACE_A, FACE_B, DIFFERENCE, ENERGY, SPHERE_ENERGY, MEAN, KINDS = range(7)


def _fields(kind: str, shape: Any, *names: str) -> Iterator[tuple[str, str, Any]]:
    """Fields of one kind and shape, () for a number, of a type of records."""
    return ((name, kind, shape) for name in names)


#: what a row comes to, scaled, one field a line; of faces A and B each where it has two numbers
ANSWER = np.dtype(
    [
        *_fields(
            "f8",
            2,
            "x",  # largest approach
            "x_first",  # that before the first echo
            "other",  # force of the other face at the peak of this one
            "carried",  # integral of the squared force
            "end_speed",  # at the end, of what stands at the pole
        ),
        *_fields(
            "f8",
            (),
            "sphere_speed",  # at the end
            "difference",  # largest, of the forces, up to the first loss after the largest force
            "mean_force",  # largest
            "stored",  # largest energy
            "stored_sphere",  # largest share of the sphere in it
            "duration",  # impulse over peak of the mean force
            "counted",  # time up to which that impulse counts
            "contact",  # first loss of contact, or the end of the record
            "contact_censored",  # 1 for the end of the record
            "blur",  # how far the error of the approach moves it
            "grazed",  # when an approach was faint before it; 0: its error may undo the loss
            "grazes",  # 0, or why another look may differ: GRAZES, RATTLES; look_closer
            "parting",  # last loss of contact
            "parting_blur",  # how far errors move it; inf where they may bring another contact
            "rise",  # from a tenth to nine tenths of the largest force
            "ended",  # end of the record
            "unloadings",  # how often a face that yields was unloaded
            "touches",  # how often contact was regained before the largest approach
            "regained",  # before any largest value; of a rig before its end
        ),
        ("status", "i8"),  # OK if it has answers
        ("steps", "i8"),  # taken
    ]
)
#: what has to be wanted for an answer that costs time, by its column
WISHES = {
    "difference": WANT_DIFFERENCE,
    "stored": WANT_ENERGY,
    "contact": WANT_CONTACT,
    "contact_censored": WANT_CONTACT,
    "rise": WANT_RISE,
    **dict.fromkeys(("leaving", "parting_speed", "carried_a", "carried_b"), WANT_AFTER),
    "mean_force": WANT_MEAN,
    "stored_sphere": WANT_SPHERE_ENERGY,
    "parting": WANT_CONTACT | WANT_PARTING,
    "duration": WANT_DURATION | WANT_MEAN,
}

#: what stands at a pole of a row, and the law of the face there (`faces`)
POLE = np.dtype(
    [
        *_fields(
            "f8",
            (),
            "there",  # 1, or 0 where nothing stands
            "gives",  # zeta
            "lightness",  # 1/mu_i
            "speed",  # U_A or -U_B at the start
            "stiffness",  # factor of x^(3/2)
            "chi",  # share of the sphere in the energy
            "onset",  # x_y
            "softening",  # b
            "pile_up",  # C
        )
    ]
)


class Rows(NamedTuple):
    """What is to be integrated, n rows in scaled variables.

    mass (n,): mu.  reflections, round_trips (n, 2): R and T of the two bars (T infinite: none).
    breaks, coefficients, frequencies: the pulse in scaled time.  record_end (n,): at the latest,
    inf for the rule of infinite bars.  poles (n, 2): `POLE`.  speed (n,): u at the start.
    Whether faces are alike and elastic, or stand on two bars, is in the state (`has_laws`,
    `rigged`).  In other rigs than bars no pulse comes in, and one far end at most sends waves back.
    """

    mass: Array
    reflections: Array
    round_trips: Array
    breaks: Array
    coefficients: Array
    frequencies: Array
    record_end: Array
    poles: Any
    speed: Array

    def at(self, rows: Places | slice) -> Rows:
        """Some of the rows."""
        return Rows._make(column[rows] for column in self)


#: `steady_level` while the incoming wave may still change: until the pulse is over, and for ever
#: where echoes come back
CHANGING = -1.0
#: forces below this share of the largest end the record on infinite bars
TAIL_SHARE = 0.01
#: errors of single steps that add up where they go either way: 100 in ten thousand steps
ADDED_UP = 100.0


#: a step that is read again
STEP = np.dtype(
    [
        ("began", "f8"),  # t_c; its start
        ("holds", "f8"),  # t_c; how much of its series holds
        ("unit", "f8"),  # t_c; the unit of its powers
        ("crest", "f8"),  # largest approach in it at most; force, where faces have laws
        ("wave", "f8", (TERMS, 2)),  # waves that left: f - P/Z at A, -(h + P/Z) at B; keep
        ("path", "f8", (2, TERMS)),  # approaches above the dents
        ("spring", "f8", 2),  # stiffness of the faces; 0 on virgin loading
        ("dent", "f8", 2),  # dents of the faces
    ]
)
#: a step of a motion that is asked for
PATH = np.dtype(
    [
        ("start", "f8"),  # t_c
        ("length", "f8"),  # t_c
        ("series", "f8", (5, TERMS)),  # x_1, x_2, u, q_1, q_2 in powers of the share of it
    ]
)

#: what the kernel knows of the row in a lane, one field a line: its unit if it has one, what it is,
#: and which function writes it.  Times over t_c, approaches over alpha_c, forces over P_c, speeds
#: over their scale (theory, section 4)
LANE = np.dtype(
    [
        *_fields(
            "i8",
            (),
            # the row
            "number",  # its number, -1 for an idle lane; enter, leave
            "place_in_order",  # its place among the rows asked for; march
            "count",  # steps taken; keep
            "attempts",  # steps tried since the time last rose; holds, go_on
            "fate",  # status it leaves with, or -1; enter, holds, go_on
            # the step
            "from_touch",  # 1 where it starts from a touch; enter, move_on
            "one_step_echo",  # 1: an echo is read from one step; enter, length_again, move_on
            "ended_by",  # what ends it, see End; choose, after_step
            "side",  # at which face; after_step
            # the faces: law, branch, and what stands at the pole
            "by_law",  # 1 where a force is no longer x^(3/2); enter, switch
        ),
        *_fields(
            "f8",
            (),
            # the row
            "mass",  # mu; enter
            "quickest",  # how quickly the lightest body answers a force; enter
            "record_end",  # t_c; at the latest; enter
            "pulse_end",  # t_c; end of the incident pulse; enter
            "first_echo",  # t_c; when the first echo is back; enter
            # the step
            "time",  # t_c; where it starts; go_on, leap
            "proposed",  # t_c; what to try next; enter, try_length, holds, propose, jump
            "next_jump",  # t_c; next jump of the waves, or the end; jump, leap
            # the waves
            "frequency",  # 1/t_c; of a half sine, 0 for a cubic piece; enter_piece
            "offset",  # t_c; where the piece of the pulse begins; enter_piece
            "steady_level",  # f from now on for ever, or CHANGING; enter, jump
            # what is followed
            "record_level",  # approach below which the record ends, 0: none; end_in_tail
            "loss_level",  # approach below which a contact may be lost; set_loss_level
            "faint",  # error of an approach; set_loss_level
            "impulse",  # integral of the mean force; after_step
            "duration",  # t_c; impulse over peak of the mean force; note_loading
            "counted",  # t_c; up to when it counts; note_loading
            "counted_peak",  # the peak that it counts; note_loading
            "difference",  # largest of the forces up to when it counts; note_loading
            "counted_force",  # the largest force by which it does; note_loading
            "lost",  # t_c; first loss of contact; after_step
            "grazed",  # t_c; when an approach was first faint before it, or 0; note_loss
            "blur",  # t_c; how far the error of the approach moves it; note_loss
            "parted",  # t_c; last loss of contact; note_loss
            "parted_blur",  # t_c; how far the error of the approach moves it; note_loss
            "retouches",  # contacts found again; move_on
            "retouches_at_value",  # those before a largest value; after_step
            "retouches_at_peak",  # those before the largest approach; after_step
            "unloadings",  # of faces that yield; switch
        ),
        *_fields(
            "i8",
            2,
            # the waves
            "head",  # number in `queue` of the next jump of a bar; next_break
            "tail",  # behind that of the last one; reflect_break
            "first",  # first step an echo is read from, -1: none; echo_steps
            "last",  # last one; echo_steps
        ),
        *_fields(
            "f8",
            2,
            # the row
            "reflect",  # reflection coefficients of the far ends; set_up_face
            "trips",  # t_c; round trips, inf without echo; set_up_face
            # what is followed
            "was_pressed",  # 1 once above what is faint; set_up_face, note_approaches
            "x_first",  # deepest before the first echo; move_on
            "other",  # force of the other face at a face's peak; note_approaches
            "carried",  # integrals of the squared forces; after_step
        ),
        ("cubic", "f8", 4),  # coefficients of the piece in powers of t; enter_piece
        ("peak", "f8", KINDS),  # largest values so far, see KINDS; after_step
    ]
)
#: fields of a lane that do not begin at zero
_AT_START = {
    "number": -1,
    "fate": GOES_ON,
    "trips": np.inf,
    "proposed": 1e30,
    "from_touch": 1,
    "steady_level": CHANGING,
    **dict.fromkeys(("lost", "parted", "duration", "grazed"), np.nan),
}
#: all lanes, and columns that go through vector instructions: (LANES,) of lanes; (PAIR,) of faces,
#: the faces A of all lanes first
STATE = np.dtype(
    [
        *_fields(
            "f8",
            LANES,
            # the row
            "inverse_mu",  # 1/mu, 0 without mass; enter
            # the step
            "error",  # error allowed in one step; enter, switch, go_on
            "u_size",  # scale of u; enter, widen_scales
            "wrong_allowed",  # impulse by which a root may be off; allow_root
            "excess",  # impulse of `wrong` over what is allowed; shorten_to_roots
        ),
        *_fields(
            "f8",
            PAIR,
            # the step
            "h",  # t_c; length of the trial step; try_length, echo_steps
            "theta",  # share of h that is taken; reach, step_from_touch, choose, shorten_to_roots
            "size",  # scale of x; set_up_face, widen_scales
            "free_size",  # scale of U; set_up_face, widen_scales
            # the waves
            "returns",  # factor of an echo, twice R, 0 without echo; read_echo
            "negligible",  # Chebyshev terms of an echo that may be left out; read_echo
            "misfit",  # the last two of them; fit_echoes
            # the faces: law, branch, and what stands at the pole
            "stiffness",  # factor of x^(3/2) before anything yields; new_face
            "onset",  # approach at which it yields, inf: never; new_face
            "softening",  # b of (C3); new_face
            "pile_up",  # C of (C6); new_face
            "chi",  # share of the sphere in the stored energy; new_face
            "unit_force",  # force at the onset; new_face
            "spring",  # factor of x^(3/2) above the dent, 0 on virgin loading; switch
            "dent",  # x_r; let_go
            "largest",  # x_m, deepest so far or the onset; let_go, press_deeper
            "peak_force",  # force there; let_go
            "hertz",  # force = hertz x y + by_x x + by_root y + by_log l + constant,
            "by_x",  # y = sqrt(x + shift), l = ln(y + base); switch
            "by_root",
            "by_log",
            "constant",
            "shift",
            "base",
            "start",  # terms of that without x or y, at the start; start_series
            "inverse",  # 1/(y + base) there, 0 without logarithm; start_series
            "half",  # 1/(2 y) there; expand
            "switched_at",  # t_c; when the branch was last found wrong; change_branch
            "switches",  # how often at that time; change_branch
            "gives",  # zeta, 1 for a bar; set_up_face
            "lightness",  # 1/mu_i of a body that moves freely; set_up_face
            "there",  # 0 where nothing stands at the pole; set_up_face
            "presses",  # 0 where nothing will press any more; energy_left
            "side_sign",  # +1 at A, -1 at B; march_rows
            # the series of the step, in powers of theta
            "first_root",  # y at the start; roots
            "first_beside",  # beside at the start; roots
            "squares",  # sums of y[i] y[k-i], 0 < i < k; sums
            "products",  # sums of beside[i] y[k-i]; sums
            "wrong",  # error of the force by its root at the step's end; shorten_to_roots
            "top",  # bound of an approach above; survey
            "floor",  # and below; survey
            "u_at_end",  # u at the end of the step; survey, end_sooner
            "step_impulse",  # of the forces over the step, over h; survey, end_sooner
        ),
        *_fields(
            "f8",
            (TERMS, PAIR),
            # the series of the step, in powers of theta
            "x",  # approaches above the dents; set_up_face, move_on, expand
            "u",  # speed of the sphere, in both columns; set_up_face, move_on, expand
            "free",  # U_A, -U_B; set_up_face, move_on, expand
            "push",  # 2 f, -2 h; incident, fit_echoes
            "root",  # y; expand
            "force",  # expand
            "beside",  # x, or on virgin loading k times the terms of l; expand
        ),
        ("lane", LANE, LANES),  # what goes lane by lane
        ("queue", "f8", (2, LANES, QUEUE)),  # t_c; jumps under way in the bars; reflect_break
        ("echo", "f8", (WAVE, PAIR)),  # wave that comes back at Chebyshev points; read_echo
        ("degrees", "f8", (WAVE, PAIR)),  # its Chebyshev coefficients; fit_echoes
        ("at", "f8", (POINTS + 1, PAIR)),  # approaches at equal distances; survey
        ("rate", "f8", (POINTS + 1, PAIR)),  # their derivatives by theta; survey
        *_fields(
            "f8",
            5,
            # room to work on one lane
            "now",  # x_1, x_2, u, U_A, -U_B after a touch; step_from_touch
            "trial",  # those at which slopes are taken; step_from_touch
            "slope",  # their derivatives; slopes
            "at_touch",  # the derivatives at the touch; step_from_touch
            "mean",  # those over a Runge-Kutta step; step_from_touch
        ),
        *_fields(
            "i8",
            (),
            # of all rows, from march_rows
            "mode",  # FULL, LINEAR or MASSLESS
            "wanted",  # bits WANT_*
            "ring",  # steps that are read again, a power of two
            "capacity",  # steps there is room for
            "has_laws",  # 1 where faces differ or may yield
            "rigged",  # 1 where other partners than bars stand at the poles
            "stop_at_loss",  # 1 where the record of bars may end at a loss of contact
            "lanes",  # LANES, as a number that the compiler does not know
        ),
        *_fields(
            "f8",
            (),
            # of all rows, from march_rows
            "tail",  # share of the largest approach, below which a record ends in infinite bars
            "tolerance",  # of this look at the rows
            "requested",  # of the answers
            "local",  # error allowed in one step
            "yielded_share",  # share of it once a face has yielded
        ),
        ("cell_end", "f8", (2, CELLS)),  # t_c; ends of the cells of waves under way; records
        ("cells", "i8", 2),  # how many of them; records
        ("cell_wave", "f8", (2, CELLS)),  # the waves in them at most; records
        ("cell", "i8", 2),  # the one that acts now, of each bar; records
        ("cell_shift", "f8", 2),  # t_c; round trips since it was bounded; records
        ("cell_weight", "f8", 2),  # what the reflections have left of it; records
        ("blank", LANE, 1),  # a lane before a row enters it
    ]
)


def empty_lanes() -> Any:
    """One STATE (1,) of blank lanes and zeros, which begins where a line of the processor's cache
    does.
    """
    line = 64
    room = np.zeros(STATE.itemsize + line, np.uint8)
    state = room[-room.ctypes.data % line :][: STATE.itemsize].view(STATE)
    for name, value in _AT_START.items():
        state["blank"][name] = value
    state["lane"] = state["blank"]
    return state


def empty_answers(rows: int) -> Any:
    """Room for the answers of `rows` rows, not numbers until a row is done."""
    answers = np.zeros(rows, ANSWER)
    for name in set(ANSWER.names or ()) - {"status", "steps"}:
        answers[name] = np.nan
    return answers


def answer_columns(answers: Any) -> dict[str, Array]:
    """Columns (n,) of answers by name, those of faces with `_a` and `_b`; `x_max` and `x_first` are
    the larger ones of both faces.
    """
    columns = {"x_max": answers["x"].max(axis=1), "end_speed": answers["sphere_speed"]}
    for name in ANSWER.names or ():
        column = answers[name]
        if column.ndim == 1:
            columns[name] = column
        else:
            columns[f"{name}_a"], columns[f"{name}_b"] = column.T
    return columns | {"x_first": answers["x_first"].max(axis=1)}
