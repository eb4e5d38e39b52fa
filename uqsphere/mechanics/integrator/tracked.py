"""What the integrator follows of a row, by the numbers of its columns: the one list of it.

A new answer of a row needs

    here      a field of `LANE` to follow it by, or, for a largest value, a number before `KINDS`;
              a field of `ANSWER`; if it costs time a bit `WANT_` (and the length of theirs, and
              `WANT_ALL`), and an entry of `WISHES`
    records   its start in `begin`, its answer in `finish`; for a largest value `no_later_peak`, by
              which a record ends once it cannot grow
    events    what follows it in `after_step`; for a largest value of both faces `_both`,
              `_may_grow` and `OF_BOTH`
    outside   `closed_form` for scenes that it answers in place of the integrator; ``outputs.toml``
              and a formula in `outputs`, which reads it by its name (`answer_columns`), and
              `outputs._LACKING` for scenes without it
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

import numpy as np

from uqsphere.arrays import Array

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

#: what is integrated: theory (9), the linear contact of the paper's section 4, no mass
FULL, LINEAR, MASSLESS = range(3)


class End(IntEnum):
    """What ends a step: its series, the record, a contact that is lost or found, a face that
    changes its branch.
    """

    SERIES = 0
    RECORD = 1
    CONTACT = 2
    BRANCH = 3


#: status of a row; of one that is not done the first
GOES_ON = -1
OK, DOMAIN, TOO_LONG_PULSE, STUCK, CROWDED, FULL_ROOM, NOT_FINITE = range(7)
NEVER_CLOSES, STILL_PRESSED = 11, 12

# what the caller wants beside the largest approaches, as bits; that of a largest value is 1 << (its
# tracker - 1)
(
    WANT_RISE,
    WANT_DIFFERENCE,
    WANT_ENERGY,
    WANT_SHARE,
    WANT_MEAN,
    WANT_DURATION,
    WANT_CONTACT,
    WANT_CARRIED,
    WANT_MOTION,
) = (1 << k for k in range(9))
#: all answers
WANT_ALL = (1 << 8) - 1
#: what reads all steps of a row again
WHOLE_PATH = WANT_RISE | WANT_MOTION
#: what the end of the record decides
TO_THE_END = WANT_DURATION | WANT_CONTACT

# largest values of a row so far: of each face's approach (of both where faces are alike), of the
# difference of the forces, of the stored energy, of the sphere's share of it and of the mean force
FACE_A, FACE_B, DIFFERENCE, ENERGY, SHARE, MEAN, KINDS = range(7)
#: what a row comes to, scaled, one field a line; of faces A and B each where it has two numbers
ANSWER = np.dtype(
    [
        ("status", "i8"),  # OK if it has answers
        ("steps", "i8"),  # taken
        ("x", "f8", 2),  # largest approach
        ("x_first", "f8", 2),  # that before the first echo
        ("other", "f8", 2),  # force of the other face at the peak of this one
        ("carried", "f8", 2),  # integral of the squared force
        ("end_speed", "f8", 2),  # at the end, of what stands at the pole
        ("sphere_speed", "f8"),  # at the end
        ("difference", "f8"),  # largest, of the forces
        ("mean_force", "f8"),  # largest
        ("stored", "f8"),  # largest energy
        ("stored_sphere", "f8"),  # largest share of the sphere in it
        ("duration", "f8"),  # impulse over peak of the mean force
        ("counted", "f8"),  # time up to which that impulse counts
        ("contact", "f8"),  # first loss of contact, or the end of the record
        ("contact_censored", "f8"),  # 1 for the end of the record
        ("blur", "f8"),  # how far the error of the approach moves it
        ("grazed", "f8"),  # when an approach was faint before it; then the doubt (`look_closer`)
        ("parting", "f8"),  # last loss of contact
        ("rise", "f8"),  # from a tenth to nine tenths of the largest force
        ("ended", "f8"),  # end of the record
        ("unloadings", "f8"),  # how often a face that yields was unloaded
        ("touches", "f8"),  # how often contact was regained before the largest approach
    ]
)
#: what has to be wanted for an answer that costs time, by its column
WISHES = {
    "difference": WANT_DIFFERENCE,
    "stored": WANT_ENERGY,
    "contact": WANT_CONTACT,
    "contact_censored": WANT_CONTACT,
    "rise": WANT_RISE,
    "carried_a": WANT_CARRIED,
    "carried_b": WANT_CARRIED,
    "mean_force": WANT_MEAN,
    "stored_sphere": WANT_SHARE,
    "parting": WANT_CONTACT,
    "duration": WANT_DURATION | WANT_MEAN,
}

# law of a face of its own, for both faces of a row (`faces`): onset x_y, softening b, pile-up C,
# factor of x^(3/2), sphere's share of the energy
LAW_ONSET, LAW_SOFTENING, LAW_PILE_UP, LAW_STIFFNESS, LAW_SHARE, LAWS = range(6)
# what stands at a row's poles: zeta, 1/mu_i, U_A and -U_B at the start, 1 or 0 where nothing stands
POLE_GIVES, POLE_LIGHTNESS, POLE_SPEED, POLE_THERE, POLES = range(5)

#: forces below this share of the largest end the record on infinite bars
TAIL_SHARE = 0.01


#: a step that is kept
STEP = np.dtype(
    [
        ("began", "f8"),  # t_c; its start
        ("holds", "f8"),  # t_c; how much of its series holds
        ("unit", "f8"),  # t_c; the unit of its powers
        ("crest", "f8"),  # largest approach in it at most; force, where faces have laws
        ("wave", "f8", (2, TERMS)),  # waves that left: f - P/Z at A, -(h + P/Z) at B; keep
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
#: over their scale (theory, section 4); "bits" count faces
LANE = np.dtype(
    [
        # the row
        ("number", "i8"),  # its number, -1 for an idle lane; enter, leave
        ("place_in_order", "i8"),  # its place among the rows asked for; march
        ("count", "i8"),  # steps taken; keep
        ("attempts", "i8"),  # steps tried again; holds
        ("fate", "i8"),  # status it leaves with, or -1; enter, holds, turn, judge, jump
        ("mass", "f8"),  # mu; enter
        ("quickest", "f8"),  # how quickly the lightest body answers a force; enter
        ("end", "f8"),  # t_c; end of the record at the latest; enter
        ("pulse_end", "f8"),  # t_c; end of the incident pulse; enter
        ("back", "f8"),  # t_c; when the first echo is back; enter
        ("reflect", "f8", 2),  # reflection coefficients of the far ends; enter
        ("trips", "f8", 2),  # t_c; round trips, inf without echo; enter
        # the step
        ("time", "f8"),  # t_c; where it starts; turn
        ("proposed", "f8"),  # t_c; what to try next; enter, try_step, holds, turn, jump
        ("stop", "f8"),  # t_c; next jump of the waves, or the end; enter, jump
        ("touching", "i8"),  # 1 where it starts from a touch; enter, move_on
        ("single", "i8"),  # 1: an echo is read from one step; enter, holds, move_on
        ("why", "i8"),  # what ends it, see End; choose, after_step
        ("side", "i8"),  # at which face; after_step
        ("switched", "i8"),  # bits: faces on the wrong branch; choose
        # the waves
        ("frequency", "f8"),  # 1/t_c; of a half sine, 0 for a cubic piece; enter_piece
        ("offset", "f8"),  # t_c; where the piece of the pulse begins; enter_piece
        ("cubic", "f8", 4),  # coefficients of the piece in powers of t; enter_piece
        ("steady", "f8"),  # what runs in for ever, -1 while it may change; enter, jump
        ("head", "i8", 2),  # number in `queue` of the next jump of a bar; next_break
        ("tail", "i8", 2),  # behind that of the last one; reflect_break
        ("first", "i8", 2),  # first step an echo is read from, -1: none; echo_steps
        ("last", "i8", 2),  # last one; echo_steps
        # the faces: law, branch, and what stands at the pole
        ("by_law", "i8"),  # 1 where a force is no longer x^(3/2); enter, move_on
        # what is followed
        ("low", "f8"),  # approach below which the record ends, -inf: none; try_step, after_step
        ("near", "f8"),  # approach below which a contact may be lost; try_step
        ("faint", "f8"),  # error of an approach; try_step
        ("peak", "f8", KINDS),  # largest values so far, see KINDS; after_step
        ("touched", "f8", 2),  # 1 once a face has touched; after_step
        ("x_first", "f8", 2),  # deepest before the first echo; after_step, move_on
        ("other", "f8", 2),  # force of the other face at a face's peak; after_step
        ("carried", "f8", 2),  # integrals of the squared forces; after_step
        ("impulse", "f8"),  # integral of the mean force; after_step
        ("duration", "f8"),  # t_c; impulse over peak of the mean force; note_duration
        ("counted", "f8"),  # t_c; up to when it counts; note_duration
        ("counted_peak", "f8"),  # the peak that it counts; note_duration
        ("lost", "f8"),  # t_c; first loss of contact; after_step
        ("grazed", "f8"),  # t_c; when an approach was first faint before it; after_step
        ("blur", "f8"),  # t_c; how far the error of the approach moves it; after_step
        ("parted", "f8"),  # t_c; last loss of contact; move_on
        ("ended", "f8"),  # t_c; end of the record; after_step, leave
        ("touches", "f8"),  # contacts found again; move_on
        ("chatter", "f8"),  # those before the largest approach; after_step
        ("unloadings", "f8"),  # of faces that yield; switch
    ]
)
#: fields of a lane that do not begin at zero
_AT_START = {
    "number": -1,
    "fate": GOES_ON,
    "trips": np.inf,
    "proposed": 1e30,
    "touching": 1,
    "steady": -1.0,
    **dict.fromkeys(("lost", "ended", "parted", "duration", "grazed"), np.nan),
}
_LANE, _FACE, _SERIES = LANES, PAIR, (TERMS, PAIR)
#: all lanes, and columns that go through vector instructions: (LANES,) of lanes; (PAIR,) of faces,
#: the faces A of all lanes first
STATE = np.dtype(
    [
        ("lane", LANE, LANES),  # what goes lane by lane
        # the row
        ("inverse_mu", "f8", _LANE),  # 1/mu, 0 without mass; enter
        # the step
        ("h", "f8", _FACE),  # t_c; length of the trial step; try_step, read_echo
        ("before", "f8", _FACE),  # last term of x or U but one, over its scale; reach
        ("last", "f8", _FACE),  # last one; reach
        ("late", "f8", _FACE),  # larger one of x; reach
        ("circle", "f8", _FACE),  # theta in which the series of x holds; reach
        ("theta", "f8", _FACE),  # share of it that is taken; reach, choose, keep_roots
        ("error", "f8", _LANE),  # error allowed in one step; enter, change_branch, keep, move_on
        ("size", "f8", _FACE),  # scale of x; enter, move_on
        ("u_size", "f8", _LANE),  # of u; enter, move_on
        ("free_size", "f8", _FACE),  # of U; enter, move_on
        ("wrong_allowed", "f8", _LANE),  # impulse by which a root may be off; try_step, choose
        # the waves
        ("queue", "f8", (2, LANES, QUEUE)),  # t_c; jumps under way in the bars; reflect_break
        ("echo", "f8", (WAVE, PAIR)),  # wave that comes back at Chebyshev points; read_echo
        ("returns", "f8", _FACE),  # factor of it, twice R, 0 without echo; read_echo
        ("negligible", "f8", _FACE),  # terms of it that may be left out; read_echo
        ("degrees", "f8", (WAVE, PAIR)),  # its Chebyshev coefficients; fit_echoes
        ("misfit", "f8", _FACE),  # its last two terms; fit_echoes
        # the faces: law, branch, and what stands at the pole
        ("stiffness", "f8", _FACE),  # factor of x^(3/2) before anything yields; new_faces
        ("onset", "f8", _FACE),  # approach at which it yields, inf: never; new_faces
        ("softening", "f8", _FACE),  # b of (C3); new_faces
        ("pile_up", "f8", _FACE),  # C of (C6); new_faces
        ("chi", "f8", _FACE),  # share of the sphere in the stored energy; new_faces
        ("unit_force", "f8", _FACE),  # force at the onset; new_faces
        ("spring", "f8", _FACE),  # factor of x^(3/2) above the dent, 0 on virgin loading; switch
        ("dent", "f8", _FACE),  # x_r; let_go
        ("largest", "f8", _FACE),  # x_m, deepest so far or the onset; let_go, press_deeper
        ("peak_force", "f8", _FACE),  # force there; let_go
        ("hertz", "f8", _FACE),  # force = hertz x y + by_x x + by_root y + by_log l + constant,
        ("by_x", "f8", _FACE),  # y = sqrt(x + shift), l = ln(y + base); switch
        ("by_root", "f8", _FACE),
        ("by_log", "f8", _FACE),
        ("constant", "f8", _FACE),
        ("shift", "f8", _FACE),
        ("base", "f8", _FACE),
        ("start", "f8", _FACE),  # terms of that without x or y, at the start; start_series
        ("inverse", "f8", _FACE),  # 1/(y + base) there, 0 without logarithm; start_series
        ("half", "f8", _FACE),  # 1/(2 y) there; expand
        ("turned_at", "f8", _FACE),  # t_c; when the branch was last found wrong; holds
        ("turns", "f8", _FACE),  # how often at that time; holds
        ("gives", "f8", _FACE),  # zeta, 1 for a bar; enter
        ("lightness", "f8", _FACE),  # 1/mu_i of a body that moves freely; enter
        ("there", "f8", _FACE),  # 0 where nothing stands at the pole; enter
        ("side_sign", "f8", _FACE),  # +1 at A, -1 at B; march_rows
        # the series of the step, in powers of theta
        ("x", "f8", _SERIES),  # approaches above the dents; turn, expand
        ("u", "f8", _SERIES),  # speed of the sphere, in both columns; turn, expand
        ("free", "f8", _SERIES),  # U_A, -U_B; turn, expand
        ("push", "f8", _SERIES),  # 2 f, -2 h; incident, fit_echoes
        ("root", "f8", _SERIES),  # y; expand
        ("first_root", "f8", _FACE),  # y at the start; roots
        ("first_beside", "f8", _FACE),  # beside at the start; roots
        ("squares", "f8", _FACE),  # sums of y[i] y[k-i], 0 < i < k; sums
        ("products", "f8", _FACE),  # sums of beside[i] y[k-i]; sums
        ("force", "f8", _SERIES),  # expand
        ("beside", "f8", _SERIES),  # x, or on virgin loading k times the terms of l; expand
        ("wrong", "f8", _FACE),  # error of the force by its root at the step's end; keep_roots
        ("excess", "f8", _LANE),  # impulse of that over what is allowed; keep_roots
        ("at", "f8", (POINTS + 1, PAIR)),  # approaches at equal distances; survey
        ("rate", "f8", (POINTS + 1, PAIR)),  # their derivatives by theta; survey
        ("top", "f8", _FACE),  # bound of an approach above; survey
        ("floor", "f8", _FACE),  # and below; survey
        # room to work on one lane
        ("work", "f8", WAVE),  # values of an echo; read_echo
        ("now", "f8", 5),  # x_1, x_2, u, U_A, -U_B after a touch; step_from_touch
        ("trial", "f8", 5),  # those at which slopes are taken; step_from_touch
        ("slope", "f8", 5),  # their derivatives; slopes
        ("at_touch", "f8", 5),  # the derivatives at the touch; step_from_touch
        ("mean", "f8", 5),  # those over a Runge-Kutta step; step_from_touch
        ("cell_end", "f8", (2, CELLS)),  # t_c; ends of the cells of waves under way; records
        ("cells", "i8", 2),  # how many of them; records
        ("cell_wave", "f8", (2, CELLS)),  # the waves in them at most; records
        ("cell", "i8", 2),  # the one that acts now, of each bar; records
        ("cell_shift", "f8", 2),  # t_c; round trips since it was bounded; records
        ("cell_weight", "f8", 2),  # what the reflections have left of it; records
        # of all rows, from march_rows
        ("blank", LANE, 1),  # a lane before a row enters it
        ("mode", "i8"),  # FULL, LINEAR or MASSLESS
        ("wanted", "i8"),  # bits WANT_*
        ("ring", "i8"),  # steps that are read again, a power of two
        ("capacity", "i8"),  # steps there is room for
        ("has_laws", "i8"),  # 1 where faces differ or may yield
        ("rigged", "i8"),  # 1 where other partners than bars stand at the poles
        ("stop_at_loss", "i8"),  # 1 where the record of bars may end at a loss of contact
        ("share", "f8"),  # of the largest approach, below which a record ends in infinite bars
        ("lanes", "i8"),  # LANES, as a number that the compiler does not know
        ("tolerance", "f8"),  # of this look at the rows
        ("requested", "f8"),  # of the answers
        ("local", "f8"),  # error allowed in one step
        ("closer", "f8"),  # share of it once a face has yielded
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
