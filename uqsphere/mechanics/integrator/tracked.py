"""What the integrator follows of a row, by the numbers of its columns: the one list of it.

A new one is a tracker (followed by `events.after_step`), an answer (written by `events.finish`, and
by `uqsphere.mechanics.closed_form` where there is a closed form) and an entry of `SCALED`, which
formulas of quantities read (`uqsphere.mechanics.outputs`).
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array

#: highest power of a series; four square roots take the 16th root
ORDER: Final = 16
TERMS: Final = ORDER + 1
#: rows that advance together (1 is allowed), and columns of what exists at both faces
LANES: Final = 16
PAIR: Final = 2 * LANES
#: parts into which a step is divided before an event in it is refined
POINTS: Final = 4
#: points over a step at which a wave that comes back is read
WAVE: Final = 12
#: room for jumps that are under way in each bar; rows of working space that `step.follow_slow`
#: needs
QUEUE, SLOW_ROOM = 2048, 10
#: parts of a round trip in which the waves under way are bounded (`records`)
CELLS: Final = 512

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


#: status of a row
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
) = (1 << k for k in range(8))
WANT_ALL = (1 << 8) - 1
#: what the end of the record decides
TO_THE_END = WANT_DURATION | WANT_CONTACT

# largest values of a row so far: of each face's approach (of both where faces are alike), of the
# difference of the forces, of the stored energy, of the sphere's share of it and of the mean force
FACE_A, FACE_B, DIFFERENCE, ENERGY, SHARE, MEAN, KINDS = range(7)
#: flag of a step in which a contact may be lost or found, or the record may end; the others are 1
#: << kind
SOMETHING = 1 << KINDS

# answers of a row, scaled: approach, force difference, energy, times; of faces A and B each:
# largest approach, that before the first echo, force of the other face at the peak of this one,
# integral of its squared force; largest mean force and sphere's share of the stored energy; last
# parting; speeds of sphere, A and B at the end; how often a face that yields was unloaded, and how
# often contact was regained before the largest approach; impulse over peak of the mean force; time
# up to which that impulse counts
(
    ANSWER_X_MAX,
    ANSWER_X_FIRST,
    ANSWER_DIFFERENCE,
    ANSWER_ENERGY,
    ANSWER_CONTACT,
    ANSWER_CONTACT_CENSORED,
    ANSWER_RISE,
    ANSWER_END,
    ANSWER_GRAZED,
    ANSWER_FACES,
    _,
    ANSWER_FIRSTS,
    _,
    ANSWER_OTHERS,
    _,
    ANSWER_CARRIED,
    _,
    ANSWER_MEAN,
    ANSWER_SHARE,
    ANSWER_PARTING,
    ANSWER_SPEED,
    ANSWER_SPEEDS,
    _,
    ANSWER_UNLOADINGS,
    ANSWER_TOUCHES,
    ANSWER_DURATION,
    ANSWER_BLUR,
    ANSWER_COUNTED,
    ANSWERS,
) = range(29)
#: what formulas of quantities read of a row's answers, scaled: name -> column, and what has to be
#: wanted for it
SCALED = {
    "x_max": (ANSWER_X_MAX, 0),
    "x_first": (ANSWER_X_FIRST, 0),
    "difference": (ANSWER_DIFFERENCE, WANT_DIFFERENCE),
    "stored": (ANSWER_ENERGY, WANT_ENERGY),
    "contact": (ANSWER_CONTACT, WANT_CONTACT),
    "contact_censored": (ANSWER_CONTACT_CENSORED, WANT_CONTACT),
    "rise": (ANSWER_RISE, WANT_RISE),
    "ended": (ANSWER_END, 0),
    "x_a": (ANSWER_FACES, 0),
    "x_b": (ANSWER_FACES + 1, 0),
    "x_first_a": (ANSWER_FIRSTS, 0),
    "x_first_b": (ANSWER_FIRSTS + 1, 0),
    "force_b_at_a": (ANSWER_OTHERS, 0),
    "force_a_at_b": (ANSWER_OTHERS + 1, 0),
    "carried_a": (ANSWER_CARRIED, WANT_CARRIED),
    "carried_b": (ANSWER_CARRIED + 1, WANT_CARRIED),
    "mean_force": (ANSWER_MEAN, WANT_MEAN),
    "stored_sphere": (ANSWER_SHARE, WANT_SHARE),
    "parting": (ANSWER_PARTING, WANT_CONTACT),
    "end_speed": (ANSWER_SPEED, 0),
    "end_speed_a": (ANSWER_SPEEDS, 0),
    "end_speed_b": (ANSWER_SPEEDS + 1, 0),
    "unloadings": (ANSWER_UNLOADINGS, 0),
    "touches": (ANSWER_TOUCHES, 0),
    "duration": (ANSWER_DURATION, WANT_DURATION | WANT_MEAN),
    "grazed": (ANSWER_GRAZED, 0),
}

# law of a face of its own, for both faces of a row (`faces`): onset x_y, softening b, pile-up C,
# factor of x^(3/2), sphere's share of the energy
LAW_ONSET, LAW_SOFTENING, LAW_PILE_UP, LAW_STIFFNESS, LAW_SHARE, LAWS = range(6)
# what stands at a row's poles: zeta, 1/mu_i, U_A and -U_B at the start, 1 or 0 where nothing stands
RIG_GIVES, RIG_LIGHTNESS, RIG_SPEED, RIG_THERE, RIGS = range(5)

#: forces below this share of the largest end the record on infinite bars
TAIL_SHARE = 0.01


def _fields(
    shape: tuple[int, ...], names: str, kind: str = "f8"
) -> list[tuple[str, str, tuple[int, ...]]]:
    return [(name, kind, shape) for name in names.split()]


#: a step that is kept: when it began, how much of its series holds, the unit of its powers, the
#: largest approach (force, where faces have laws) in it at most; waves that left the faces,
#: approaches, spring and dent of the faces
STEP: Final = np.dtype(
    [
        *_fields((), "began holds unit crest"),
        *_fields((2, TERMS), "wave path"),
        *_fields((2,), "spring dent"),
    ]
)
#: a step of a motion that is asked for: start, length; x_1, x_2, u, q_1, q_2 in powers of the share
#: of it
PATH: Final = np.dtype([("start", "f8"), ("length", "f8"), ("series", "f8", (5, TERMS))])

#: what the kernel knows of the rows in its lanes; per lane (LANES,), per face (PAIR,): those of
#: face A first.  What is not a multiple of a vector stands last
LANE: Final = np.dtype(
    [
        # the row (-1: none) and its place in the order; steps taken and tried, what becomes of it;
        # what its step may have met (bits), what ended it (End), at which face; whether an echo is
        # read from a single step, the forces follow laws of the faces; faces (bits) on the wrong
        # branch
        *_fields(
            (LANES,),
            "row place_in_order count attempts fate flags why side single by_law switched",
            "i8",
        ),
        # mu, 1/mu, mu or inf without mass; how quickly the lightest body answers; error allowed in
        # one step; end of the record, of the pulse where the tail counts; round trip; the wave that
        # stays, or -1
        *_fields(
            (LANES,), "mass inverse_mu inertia quickest error end pulse_end fades back steady"
        ),
        # time, length of the trial step, share of it that is taken, length to try next, next jump;
        # 1 where it starts from a touch, is on the slow motion; when that is looked for next
        *_fields((LANES,), "time h theta proposed stop touching on_slow calm"),
        # approaches below which the record ends, a contact may be lost, its error may decide;
        # bounds and doubts of a step
        *_fields((LANES,), "low near faint crest alarm misfit crosses unfit place_of at_u rate_u"),
        # pulse: its piece (frequency, offset, cubic); far ends: reflection, round trip; jumps under
        # way; steps of the echo
        *_fields((LANES,), "frequency offset"),
        *_fields((4, LANES), "cubic"),
        *_fields((2, LANES), "reflect trips"),
        *_fields((2, LANES, QUEUE), "queue"),
        *_fields((2, LANES), "head tail first last", "i8"),
        # scales of x_1, u, x_2, U_A, -U_B
        *_fields((5, LANES), "size"),
        # what is followed: largest values; whether a face has touched, its largest approach before
        # the first echo, force of the other at its peak, integral of its squared force; first loss,
        # end, last parting, unloadings, touches in all and before the peak, impulse of the mean
        # force, duration; when an approach first is faint, how far its error moves the loss
        *_fields((KINDS, LANES), "peak"),
        *_fields((2, LANES), "touched x_first other carried"),
        *_fields(
            (LANES,),
            "lost ended parted unloadings touches chatter impulse duration grazed blur "
            "counted counted_peak",
        ),
        # the law of a face (`faces`), and what stands at its pole: zeta, 1/mu_i, 1 or 0 where
        # nothing does
        *_fields(
            (PAIR,),
            (
                "dent shift spring by_x by_root by_log constant base largest peak_force onset "
                "softening pile_up"
            ),
        ),
        *_fields((PAIR,), "stiffness chi unit_force hertz gives lightness there"),
        # the series of a step: approaches, sqrt, forces, 2 f and -2 h, U_A and -U_B, logarithm; the
        # sphere's speed
        *_fields((TERMS, PAIR), "x root force push free log"),
        *_fields((TERMS, LANES), "u"),
        # approaches, derivatives and half the second ones at equal distances over the step
        *_fields((POINTS + 1, PAIR), "at rate bow"),
        # largest approaches known, bounds of those in a step and where they lie; turns at one time;
        # room for recurrences
        *_fields(
            (PAIR,),
            "known top place bent width value slope bend wrong turned_at turns half inverse start",
        ),
        # room
        *_fields((9, PAIR), "room"),
        *_fields((3, LANES), "reach left left_slope"),
        *_fields((4, WAVE), "work"),
        *_fields((TERMS, SLOW_ROOM), "slow"),
        *_fields((2, CELLS), "cell_end cell_wave"),
        # the step of one lane that is searched: its series, values and slopes, where its faces are
        # pressed deepest
        *_fields((TERMS, 2), "piece"),
        *_fields((2, 2, POINTS + 1), "grid"),
        *_fields((2,), "places"),
        # of all rows: what is integrated and wanted, steps that are read again; whether faces have
        # laws, other partners than bars stand at the poles, the record of bars ends at the first
        # loss, paths are stored, are given out
        *_fields((), "mode wanted ring capacity has_laws rigged stop_at_loss store keeping", "i8"),
        # tolerance, error allowed in one step, share of it once a face has yielded, tolerance of
        # the answers, tail's share
        *_fields((), "tolerance local closer requested share"),
    ]
)


def empty_lanes() -> Any:
    """One tracked.LANE (1,) of zeros, which begins where a line of the processor's cache does."""
    line = 64
    room = np.zeros(LANE.itemsize + line, np.uint8)
    return room[-room.ctypes.data % line :][: LANE.itemsize].view(LANE)


def empty_answers(rows: int) -> Array:
    """Room for the answers of `rows` rows, not a number until a row is done."""
    return np.full((rows, ANSWERS), np.nan)
