"""What the integrator follows of a row, by the numbers of its columns: the one list of it.

A new one is a tracker (followed by `events.after_step`), an answer (written by `events.finish`, and by
`uqsphere.mechanics.closed_form` where there is a closed form) and an entry of `SCALED`, which formulas of quantities
read (`uqsphere.mechanics.outputs`).
"""

from __future__ import annotations

import numpy as np

from uqsphere.arrays import Array

#: for functions that only compiled code calls: no way in from Python needs to be compiled
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
#: highest power of a series; four square roots take the 16th root
ORDER = 16
TERMS = ORDER + 1
#: rows that advance together, and columns of what exists at both faces
LANES = 16
PAIR = 2 * LANES

#: status of a row
OK, DOMAIN, TOO_LONG_PULSE, STUCK, CROWDED, FULL, NOT_FINITE = range(7)

# what the caller wants beside the largest approaches, as bits; that of a largest value is 1 << (its tracker - 1)
WANT_RISE, WANT_DIFFERENCE, WANT_ENERGY, WANT_WIDTH, WANT_CONTACT = (1 << k for k in range(5))
WANT_ALL = WANT_RISE | WANT_DIFFERENCE | WANT_ENERGY | WANT_WIDTH | WANT_CONTACT

# trackers of a lane while its row runs: the first KINDS are the largest values found so far
(FACE_A, FACE_B, DIFFERENCE, ENERGY, TOUCHED_A, TOUCHED_B, LOST, X_FIRST, ENDED, LOSS_RATE, DEPTH,
 NEAREST, UNLOADINGS, TRACKS) = range(14)  # fmt: skip
KINDS = ENERGY + 1
#: flag of a step in which a contact may be lost or found, or the record may end; the others are 1 << kind
SOMETHING = 1 << KINDS
#: flag of a step in which a face may begin or end to yield
SWITCHES = 2 << KINDS

# answers of a row, scaled: approach, force difference, energy, times; width and rise with their thresholds a little
# lower, then a little higher; largest approach of each face that has yielded (0: none), how often one was unloaded
(ANSWER_X_MAX, ANSWER_X_FIRST, ANSWER_DIFFERENCE, ANSWER_ENERGY, ANSWER_CONTACT, ANSWER_CONTACT_CENSORED,
 ANSWER_WIDTH, ANSWER_WIDTH_CENSORED, ANSWER_RISE, ANSWER_END, ANSWER_LOSS_RATE, ANSWER_DEPTH,
 ANSWER_NEAREST, ANSWER_WIDTHS, _, ANSWER_RISES, _, ANSWER_YIELD, _, ANSWER_UNLOADINGS,
 ANSWERS) = range(21)  # fmt: skip
#: what formulas of quantities read of a row's answers, scaled: name -> column, and what has to be wanted for it
SCALED = {
    "x_max": (ANSWER_X_MAX, 0),
    "x_first": (ANSWER_X_FIRST, 0),
    "difference": (ANSWER_DIFFERENCE, WANT_DIFFERENCE),
    "stored": (ANSWER_ENERGY, WANT_ENERGY),
    "contact": (ANSWER_CONTACT, WANT_CONTACT),
    "contact_censored": (ANSWER_CONTACT_CENSORED, WANT_CONTACT),
    "width": (ANSWER_WIDTH, WANT_WIDTH),
    "width_censored": (ANSWER_WIDTH_CENSORED, WANT_WIDTH),
    "rise": (ANSWER_RISE, WANT_RISE),
    "ended": (ANSWER_END, 0),
}

# the law of a face that yields, see `uqsphere.mechanics.integrator.faces`: numbers of a lane's face
(DENT, SHIFT, SPRING, BY_X, BY_ROOT, BY_LOG, CONSTANT, BASE, LARGEST, PEAK, ONSET, SOFTENING, PILE_UP,
 STIFFNESS) = range(14)  # fmt: skip
NUMBERS = 14
# ... and of a row, for both faces: onset x_y, softening b, pile-up C, factor of x^(3/2)
LAW_ONSET, LAW_SOFTENING, LAW_PILE_UP, LAW_STIFFNESS = range(4)

#: forces below this share of the largest end the record on infinite bars
TAIL_SHARE = 0.01
#: parts into which a step is divided before an event in it is refined
POINTS = 4


def empty_answers(rows: int) -> Array:
    """Room for the answers of `rows` rows, not a number until a row is done."""
    return np.full((rows, ANSWERS), np.nan)
