"""What weakens an answer, each in a sentence with its effect: what turns a verdict first, then what nobody knows the
effect of, then what moves it, by how far.

The directions of broken checks are those of theory section 9; how far an answer moves is never known, or the model
would have it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final

from uqsphere.quantities import OUTPUTS
from uqsphere.report.contents import Contents
from uqsphere.report.phrases import (
    breaks,
    capital,
    law_name,
    listed,
    plain_percent,
    share,
    short_input,
    symbol,
    value_text,
)
from uqsphere.results import AssumedEntry, CheckEntry, LimitEntry, MarginEntry, QuantityEntry, Results
from uqsphere.study import strength_name

#: what a check finds where it is broken
_FOUND: Final = {
    "small_contact": "the contact is not small against the sphere",
    "contact_on_bar_end": "the contact is not small against the bar’s end",
    "bar_yield_contact": "the bars yield under the sphere",
    "sphere_yield_contact": "the sphere crushes at its poles",
    "plastic_range": "a face yields far beyond what its law was compared with",
    "deep_dent": "a dent changes the curvature of a face",
    "insert_thickness": "the inserts are thin beside the contact",
    "reachable": "a strength lies above the hardness, which no pressure exceeds",
    "broken_by_damage": "the sphere breaks by the law of damage",
    "bar_yield_pulse": "the pulse makes the bars yield",
    "force_balance": "the two contact forces differ",
    "quasi_static_sphere": "waves cross the sphere too few times while the force rises",
    "one_dimensional_bars": "the pulse is sharper than one-dimensional waves carry",
    "pressure_shape": "the pressure over the contact is flatter than Hertz’s",
    "face_yield": "the struck face yields",
    "thin_plate": "the plate is not as thin as its theory has it",
    "plate_edge": "the bending wave is back from the plate’s edge",
    "gravity": "weights are not small beside the force",
    "drag": "the air slows the fall",
    "oblique": "the path is far from square to the surface",
    "wave_loss": "a thick target carries energy off as waves",
    "one_dimensional_rod": "the force rises faster than one-dimensional waves in the rod carry",
    "carried_far": "the strength was measured on a contact of another stiffness",
    "carried_size": "the strength was measured on spheres of another size",
    "carried_rate": "the strength was measured at another rate",
    "one_sided_field": "the forces at the poles differ where the contact is large",
    "before_reflection": "reflected waves are back before the record ends",
}
#: demands of the contact itself, which fall where its circle widens
_PRESSURES: Final = frozenset(name for name, entry in OUTPUTS.items() if entry.place in ("contact", "rim")) - {
    "p_hertz"
}
#: demands that rise with the force
_LOADS: Final = frozenset(name for name, entry in OUTPUTS.items() if entry.follows)
#: what is read off the forces of both faces, each for itself
_EITHER_FACE: Final = frozenset(name for name, entry in OUTPUTS.items() if entry.place not in ("core", "below"))
#: check -> demands that are lower in truth than computed: a face that yields, or a crushed cap, widens the contact;
#: a bar that yields carries less than the elastic pulse
_LOWER: Final = {
    "bar_yield_contact": _PRESSURES,
    "face_yield": _PRESSURES,
    "sphere_yield_contact": _PRESSURES,
    "bar_yield_pulse": _LOADS,
}
#: check -> what it means where it moves the answer the other way
_MORE: Final = {
    "broken_by_damage": "more break than stated",
    "reachable": "more break if it was computed from a force by Hertz (strength_is)",
}
#: a share of the rows below this is not told
_TOLD: Final = 0.01
#: tests of an input from which on what they leave open of a quantity is told by its interval alone
_FEW_TESTS: Final = 10
#: log odds below which another assumption moves nothing that counts
_MOVES: Final = math.log(1.2)
#: ranks: what turns a verdict, what nobody knows the effect of, what moves an answer, what was not reached
_TURNS, _UNKNOWN, _MOVED, _LEFT = range(4)


@dataclass(frozen=True, kw_only=True, order=True)
class Caution:
    """A sentence on what weakens the answers: by rank, then by how far it moves them in log odds."""

    rank: int
    nearer: float = 0.0
    text: str
    made_up: bool = False

    @property
    def moves(self) -> bool:
        """Whether it may move an answer that was asked for."""
        return self.rank < _LEFT


def check_words(check: str) -> str:
    """What is found where a validity check is broken."""
    return _FOUND.get(check, check.replace("_", " "))


def deciding_limits(results: Results) -> list[str]:
    """The limits that mean fracture; all of them where none does, as in a black box."""
    return [name for name in results.limits if breaks(results, name)] or list(results.limits)


def cautions(parts: Mapping[str, Contents], called: Mapping[tuple[str, str], str]) -> list[Caution]:
    """What weakens the answers of a study and of its services, the gravest first; empty where nothing does.

    Parameters
    ----------
    parts : the contents by the name of a service, "" of the study itself
    called : what each limit of a part is called on the page
    """
    found: dict[Caution, list[str]] = {}
    for part, contents in parts.items():
        names = {name: called.get((part, name), name) for name in deciding_limits(contents.results)}
        for caution in (*_of_limits(contents, names), *_of_checks(contents, names), *_of_run(contents)):
            found.setdefault(caution, []).append(part)
    # what holds for all parts is told of none
    return [
        replace(caution, text=capital(f"{', '.join(of)}: {caution.text}" if len(of) < len(parts) else caution.text))
        for caution, of in sorted(found.items())
    ]


# --- assumptions and tests ------------------------------------------------------------------------------


def _of_limits(contents: Contents, names: Mapping[str, str]) -> Iterator[Caution]:
    """What other assumptions, tests that are few or made up, and ways that nobody judged do to limits."""
    limits = contents.results.limits
    for name, called in names.items():
        head = f"{called.lower()}: " if len(names) > 1 else ""
        for caution in (*_moved(limits[name]), *_extrapolated(contents, name, limits[name])):
            yield replace(caution, text=head + caution.text)
    made_up = sorted({strength_name(name) for name in names} & set(contents.resolved.made_up))
    if made_up:
        tests = dict.fromkeys(contents.tests[key] for key in made_up if key in contents.tests)
        told = listed([text.partition(" (")[0] for text in tests] or ["tests"])
        yield Caution(rank=_TURNS, nearer=-math.inf, text=f"the {told} are made up.", made_up=True)
    yield from _unjudged(contents, names)


def _unjudged(contents: Contents, names: Mapping[str, str]) -> Iterator[Caution]:
    """Ways to break that no limit is on and nothing judges beside."""
    limits, verdicts = contents.results.limits, contents.results.verdicts
    beside = any(v.not_judged or any(w.assumed for w in v.judged) for v in verdicts)
    places = {OUTPUTS[q].place for n in names if (q := limits[n].quantity) in OUTPUTS}
    left = [words for place, words in (("rim", "ring cracks"), ("core", "core tension")) if place not in places]
    if not contents.black_box and not beside and places and left:
        yield Caution(rank=_UNKNOWN, text=f"{listed(left)} {'are' if 'ring cracks' in left else 'is'} not judged.")


def log_odds(p: float) -> float:
    """Logarithm of the odds, kept finite."""
    p = min(max(p, 1e-12), 1.0 - 1e-12)
    return math.log(p / (1.0 - p))


def _to(limit: LimitEntry, other: float, text: str) -> Caution:
    """How far another probability of missing the aim is from the limit's own, and whether it turns the verdict."""
    miss, target = limit.miss.number, limit.target
    turns = target is not None and (other > target) != (miss > target)
    return Caution(rank=_TURNS if turns else _MOVED, nearer=-abs(log_odds(other) - log_odds(miss)), text=text)


def _moved(limit: LimitEntry) -> Iterator[Caution]:
    """How far other assumptions, and few tests, move the probability of missing an aim.

    Of what is assumed in one way, such as several Weibull moduli, what moves it furthest is told.
    """
    miss, target = limit.miss.value, limit.target
    if miss is None:
        return
    furthest: dict[str, Caution] = {}
    for entry in limit.assumed:
        other = entry.miss.value
        if other is None or share(other) == share(miss):
            continue
        told = _to(limit, other, "")
        over = (", over target" if other > miss else ", within target") if told.rank == _TURNS else ""
        told = replace(told, text=f"{share(other, target)} {assumption(entry)}{over}.")
        if -told.nearer > _MOVES and told < furthest.get(entry.assumption, Caution(rank=_LEFT, text="")):
            furthest[entry.assumption] = told
    yield from furthest.values()
    if limit.ignorance.known and limit.ignorance.fitted:
        high, tests = float(limit.ignorance.miss[1]), sum(entry.tests for entry in limit.ignorance.fitted)
        if high > miss and share(high) != share(miss):
            yield _to(limit, high, f"{tests} tests leave up to {share(high, target)} open.")


def assumption(entry: AssumedEntry) -> str:
    """What is put in place of what is assumed of a strength, as a clause."""
    taken, instead = entry.taken, entry.instead
    if entry.assumption == "dependence":
        return "if strength and stiffness are independent"
    if isinstance(taken, str) or isinstance(instead, str) or taken is None or instead is None:
        return f"with a {law_name(str(instead))} strength, not {law_name(str(taken))}"
    if entry.assumption == "modulus":
        return f"with Weibull modulus {instead:.2g}, not {taken:.2g}"
    return f"with {100.0 * instead:.2g} % scatter of strength, not {100.0 * taken:.2g} %"


def _extrapolated(contents: Contents, name: str, limit: LimitEntry) -> Iterator[Caution]:
    """An answer that rests on strengths outside of what was tested."""
    key = strength_name(name)
    law, margin = contents.resolved.random.get(key), contents.results.margins.get(name)
    if law is None or not law.data or margin is None or margin.value.value is None:
        return
    partial = margin.lost_to.partial.get(key)
    if partial is None or min(law.data) <= partial.design <= max(law.data):
        return
    low, high = (value_text(end, limit.quantity, 2) for end in (min(law.data), max(law.data)))
    rests = value_text(partial.design, limit.quantity, 2)
    yield Caution(rank=_UNKNOWN, text=f"answer at {rests}; tests broke at {low.split()[0]} to {high}.")


# --- checks of the model ----------------------------------------------------------------------------------


def _of_checks(contents: Contents, names: Mapping[str, str]) -> Iterator[Caution]:
    """Broken checks, those of one effect together; what moves no answer is left to the table of checks."""
    groups: dict[str, list[str]] = {}
    shares = _shares(contents, names)
    for check in sorted(shares, key=lambda name: -max(shares[name])):
        planned, there = shares[check]
        effect = _effect(contents, check, names)
        if max(planned, there) < _TOLD or not effect:
            continue
        places = [("", planned)] if planned >= _TOLD else []
        places += [("at the answer ", there)] if there > max(2.0 * planned, _TOLD) else []
        often = ", ".join(where + _two_digits(part) for where, part in places)
        groups.setdefault(effect, []).append(f"{check_words(check)} ({often})")
    for effect, texts in groups.items():
        others = len(texts) - 1
        more = f", {others} more fail{'s' if others == 1 else ''}" if others else ""
        yield Caution(rank=_UNKNOWN, nearer=-1.0, text=f"{texts[0]}{more}: {effect}.")


def _shares(contents: Contents, names: Mapping[str, str]) -> dict[str, tuple[float, float]]:
    """By check the share of the rows in which it is broken as planned, and at the answers of inverse questions."""
    found = {c.check: (c.share_failure + c.share_warning, 0.0) for c in contents.results.validity}
    for margin in (contents.results.margins[name] for name in names if name in contents.results.margins):
        for check in margin.validity.checks:
            planned, there = found.get(check.check, (0.0, 0.0))
            found[check.check] = planned, max(there, _broken_at(margin, check))
    return found


def _broken_at(margin: MarginEntry, check: CheckEntry) -> float:
    """Share broken at an answer; that of bars that yield is known of all rows of the curve, not of a hundred."""
    known = margin.bars.yields_at.get(format(margin.probability, ".15g")) if margin.probability else None
    if check.check == "bar_yield_contact" and known is not None:
        return float(known)
    return check.share_failure + check.share_warning


def _effect(contents: Contents, check: str, names: Mapping[str, str]) -> str:
    """What a broken check does to the answers; empty where it moves none of them."""
    if check in _MORE:
        return _MORE[check]
    quantities = {name: contents.results.limits[name].quantity for name in names}
    lower = [name for name, quantity in quantities.items() if quantity in _LOWER.get(check, frozenset())]
    if lower:
        by = f" by {listed([names[n].lower() for n in lower])}" if len(names) > 1 else ""
        return f"fewer break{by} than stated"
    followed = contents.results.model.chosen != "massless"
    if check == "force_balance" and followed and quantities and set(quantities.values()) <= _EITHER_FACE:
        return ""
    return "effect unknown"


# --- the run itself ---------------------------------------------------------------------------------------


def cut_off(contents: Contents) -> str:
    """What ended a run before it was done, which is said before anything else; empty for one that was done."""
    if contents.manifest.interrupted:
        return "The run was interrupted; the same command goes on."
    accuracy, budget = contents.results.accuracy, contents.resolved.analysis.budget
    late = bool(accuracy.missed) or any(row.met is False for row in accuracy.questions)
    if contents.manifest.stopped_by_time or (late and "time" in accuracy.stopped_by.values()):
        return f"The time budget of {budget.time:g} s ended the run; a longer one goes on."
    by_count = late and "evaluations" in accuracy.stopped_by.values()
    return f"The budget of {budget.evaluations:,} evaluations ended the run; a larger one goes on." if by_count else ""


def _of_run(contents: Contents) -> Iterator[Caution]:
    """Rows that failed, records that end too soon, accuracies that were not reached."""
    results, model = contents.results, contents.results.model
    if model.failures:
        part = _two_digits(model.failures / max(sum(model.evaluations.values()), 1))
        how = {"bound": "counted once as exceeding and once as not", "drop": "left out", "abort": "the run ends there"}
        text = f"{model.failures:,} evaluations failed ({part}): {how[contents.resolved.analysis.on_failure]}."
        yield Caution(rank=_UNKNOWN, nearer=-2.0, text=text)
    for name, entry in results.quantities.items():
        yield from _of_quantity(name, entry)
    late = [row for row in results.accuracy.questions if row.met is False]
    if missed := len(late) or len(results.accuracy.missed):
        of_limits = any(row.quantity.startswith("limits.") for row in late)
        text = f"{missed} numbers are less accurate than asked."
        yield Caution(rank=_UNKNOWN if of_limits else _LEFT, text=text)
    for text in results.warnings:
        yield Caution(rank=_LEFT, nearer=1.0, text=text if text.endswith(".") else f"{text}.")


def _of_quantity(name: str, entry: QuantityEntry) -> Iterator[Caution]:
    """Records that end before a quantity is known, and few tests that it rests on."""
    if entry.censored_share.value:
        text = f"in {_two_digits(entry.censored_share.value)} of the rows {symbol(name)} outlasts its record"
        yield Caution(rank=_LEFT, text=f"{text}: a lower bound there.")
    opened = entry.ignorance
    if opened and min(source.tests for source in opened.fitted) < _FEW_TESTS:
        tests = ", ".join(f"{source.tests} tests of {short_input(source.input)}" for source in opened.fitted)
        ends = " to ".join(value_text(end, name, 2) for end in opened.mean)
        left = opened.reason or f"they leave its mean open from {ends}"
        yield Caution(rank=_UNKNOWN, text=f"the answers on {symbol(name)} rest on {tests}: {left}.")


def _two_digits(part: float) -> str:
    return plain_percent(float(f"{part:.2g}"))
