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
NEVER_CLOSES, STILL_PRESSED = 11, 12

# what the caller wants beside the largest approaches, as bits; that of a largest value is 1 << (its tracker - 1)
(WANT_RISE, WANT_DIFFERENCE, WANT_ENERGY, WANT_SHARE, WANT_MEAN, WANT_DURATION, WANT_CONTACT,
 WANT_CARRIED) = (1 << k for k in range(8))  # fmt: skip
WANT_ALL = (1 << 8) - 1

# trackers of a lane while its row runs: the first KINDS are the largest values found so far, of each face's approach
# (of both where faces are alike), of the difference of the forces, of the stored energy, of the sphere's share of it
# and of the mean force; then what the other face's force was at a face's peak
(FACE_A, FACE_B, DIFFERENCE, ENERGY, SHARE, MEAN, TOUCHED_A, TOUCHED_B, LOST, X_FIRST, _, ENDED, LOSS_RATE,
 UNLOADINGS, OTHER, _, PARTED, TOUCHES, CHATTER, CARRIED, _, PUSHED, DURATION,
 TRACKS) = range(24)  # fmt: skip
KINDS = MEAN + 1
#: flag of a step in which a contact may be lost or found, or the record may end; the others are 1 << kind
SOMETHING = 1 << KINDS

# answers of a row, scaled: approach, force difference, energy, times; of faces A and B each: largest approach, that
# before the first echo, force of the other face at the peak of this one, integral of its squared force; largest mean
# force and sphere's share of the stored energy; last parting; speeds of sphere, A and B at the end; how often a face
# that yields was unloaded, and how often contact was regained before the largest approach; impulse over peak of the
# mean force
(ANSWER_X_MAX, ANSWER_X_FIRST, ANSWER_DIFFERENCE, ANSWER_ENERGY, ANSWER_CONTACT, ANSWER_CONTACT_CENSORED,
 ANSWER_RISE, ANSWER_END, ANSWER_LOSS_RATE, ANSWER_FACES, _, ANSWER_FIRSTS, _, ANSWER_OTHERS, _,
 ANSWER_CARRIED, _, ANSWER_MEAN, ANSWER_SHARE, ANSWER_PARTING, ANSWER_SPEED, ANSWER_SPEEDS, _,
 ANSWER_UNLOADINGS, ANSWER_TOUCHES, ANSWER_DURATION,
 ANSWERS) = range(27)  # fmt: skip
#: what formulas of quantities read of a row's answers, scaled: name -> column, and what has to be wanted for it
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
}

# the law of a face of its own, see `uqsphere.mechanics.integrator.faces`: numbers of a lane's face
(DENT, SHIFT, SPRING, BY_X, BY_ROOT, BY_LOG, CONSTANT, BASE, LARGEST, PEAK, ONSET, SOFTENING, PILE_UP,
 STIFFNESS, CHI, UNIT, HERTZ, NUMBERS) = range(18)  # fmt: skip
# ... and of a row, for both faces: onset x_y, softening b, pile-up C, factor of x^(3/2), sphere's share of the energy
LAW_ONSET, LAW_SOFTENING, LAW_PILE_UP, LAW_STIFFNESS, LAW_SHARE, LAWS = range(6)
# what stands at a row's poles: zeta, 1/mu_i, U_A and -U_B at the start, 1 or 0 where nothing stands
RIG_GIVES, RIG_LIGHTNESS, RIG_SPEED, RIG_THERE, RIGS = range(5)

#: what is kept of a step: when it began, how much of its series holds, the unit of its powers, what it reached at most
BEGAN, HOLDS, UNIT_OF, CREST, KEPT = range(5)

#: forces below this share of the largest end the record on infinite bars
TAIL_SHARE = 0.01
#: parts into which a step is divided before an event in it is refined
POINTS = 4


def empty_answers(rows: int) -> Array:
    """Room for the answers of `rows` rows, not a number until a row is done."""
    return np.full((rows, ANSWERS), np.nan)
