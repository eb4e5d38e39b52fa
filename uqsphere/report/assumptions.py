"""What a broken assumption of the model does to the answer: in which direction it moves it, or that this is not known.

The directions are those of theory section 9; how far an answer moves is never known, or the model would have it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.mechanics.validity import RULES
from uqsphere.quantities import OUTPUTS, lookup
from uqsphere.report.blocks import Block, Table, cell
from uqsphere.report.contents import Contents, law_of
from uqsphere.report.phrases import (
    answer_text,
    breaks,
    call,
    capital,
    input_name,
    law_name,
    limit_name,
    listed,
    missing,
    number_text,
    of_limit,
    plain_percent,
    probability_range,
    rounded,
    safe_side,
    value_text,
)
from uqsphere.results import LimitEntry
from uqsphere.results.entries import CheckEntry, Est
from uqsphere.results.margins import MarginEntry
from uqsphere.results.verdicts import AssumedEntry

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
    "bar_yield_pulse": "the pulse makes the bars yield",
    "force_balance": "the two contact forces differ",
    "quasi_static_sphere": "waves cross the sphere too few times while the force rises",
    "one_dimensional_bars": "the pulse is sharper than one-dimensional waves carry",
    "pressure_shape": "the pressure over the contact is flatter than Hertz’s",
    "face_yield": "what stands at a pole yields under the sphere",
    "thin_plate": "the plate is not as thin as its theory has it",
    "plate_edge": "the bending wave is back from the plate’s edge",
    "gravity": "weights are not small beside the force",
    "drag": "the air slows the fall",
    "oblique": "the path is far from square to the surface",
    "wave_loss": "a thick target carries energy off as waves",
    "one_dimensional_rod": "the force rises faster than one-dimensional waves in the rod carry",
    "carried_far": "the strength was measured on a contact of another stiffness",
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
#: check -> demands that are lower in truth than computed, and why
_LOWER: Final = {
    **dict.fromkeys(
        ("bar_yield_contact", "face_yield"),
        (_PRESSURES, "a dent widens the contact, so that the true pressure is lower than computed"),
    ),
    "sphere_yield_contact": (
        _PRESSURES,
        "a crushed cap widens the contact, so that the true pressure is lower than computed",
    ),
    "bar_yield_pulse": (
        _LOADS,
        "a bar that yields carries less than the elastic pulse, so that the true load is lower",
    ),
}


#: names that take a hyphen
_NAMES: Final = {"quasi_static_sphere": "quasi-static sphere", "one_dimensional_bars": "one-dimensional bars"}


def check_name(check: str) -> str:
    """A validity check in words."""
    return _NAMES.get(check, check.replace("_", " "))


def grave(contents: Contents) -> list[CheckEntry]:
    """Checks that fail in some samples."""
    return [c for c in contents.results.validity if c.share_failure > 0.0]


def warned(contents: Contents) -> list[CheckEntry]:
    """Checks that warn in some samples and fail in none."""
    return [c for c in contents.results.validity if c not in grave(contents) and c.share_warning > 0.0]


def broken_words(check: CheckEntry) -> str:
    """What is found where a check is broken, without how often."""
    return _FOUND.get(check.check, check_name(check.check))


def at_fracture(check: CheckEntry) -> bool:
    """Whether a check is of the specimens that break, at the moment they do."""
    return "specimens that break" in check.text


def breach(check: CheckEntry, grade: str) -> str:
    """What is found, and in which share of what."""
    # at fracture the check is of those that break, which its text says
    whom = "the specimens that break" if at_fracture(check) else "the samples"
    words = broken_words(check)
    text = plain_percent(getattr(check, f"share_{grade}"))
    rule = next((r for r in RULES if r.name == check.check), None)
    milder = check.share_information
    if rule is not None and rule.information is not None and grade == "warning" and milder > 0.0:
        # the check's own text counts both grades
        both = plain_percent(float(f"{milder + check.share_warning:.3g}"))
        return f"{words} (beyond {rule.warning:g} in {text} of {whom}, beyond {rule.information:g} in {both})"
    return f"{words} ({text} of {whom})"


def _probability(contents: Contents, name: str) -> str:
    """What the probability of a limit is of, with its name where there are several."""
    results = contents.results
    if not breaks(results, name):
        return f"of missing {limit_name(name, 30)}"
    own = f" ({limit_name(name, 30)})" if len(results.limits) > 1 else ""
    return f"that {missing(results, name)}{own}"


def bearing(contents: Contents, check: str, only: str = "") -> str:
    """Whether a broken check moves the probabilities of the limits, and in which direction, in a sentence.

    Parameters
    ----------
    contents : the run
    check : name of a rule of `uqsphere.mechanics.validity`
    only : the one limit that is of interest; all if empty

    Returns
    -------
    str
        Without a full stop at its end; of the quantities where there is no limit.
    """
    limits = {n: limit for n, limit in contents.results.limits.items() if only in ("", n)}
    followed = contents.results.model.chosen != "massless"
    lower, why = _LOWER.get(check, (frozenset(), ""))
    said: dict[str, list[str]] = {}
    for name, limit in limits.items():
        if limit.quantity in lower:
            text = "is smaller than stated" if limit.aim == "survive" else "is larger than stated"
        elif check == "force_balance" and followed and limit.quantity in _EITHER_FACE:
            text = "does not move: the model follows both faces"
        else:
            text = "may move, in which direction is not known"
        said.setdefault(text, []).append(_probability(contents, name))
    parts = [f"the probability {listed(names)} {text}" for text, names in said.items()]
    if any(limit.quantity in lower for limit in limits.values()):
        return f"{why}: {'; '.join(parts)}, by how much is not known"
    if limits:
        return "; ".join(parts)
    if lower & set(contents.results.quantities):
        return f"{why}, by how much is not known"
    return "in which direction that moves the answers is not known"


# --- How far an answer reaches: where its bars yield, where the tests end, and for which scene it holds.

#: a share of the cases below this is none
_NEVER = 1e-6


def yields_at(entry: MarginEntry, p: str) -> float | None:
    """Share of the cases in which the bars yield under the contact at the value of a probability asked for."""
    found = entry.bars.yields_at
    share = found.get(p)
    return None if share is None else float(share)


def _rising(entry: MarginEntry) -> bool:
    return bool(entry.curve[-1][1] >= entry.curve[0][1])


@dataclass(frozen=True, kw_only=True)
class BeyondBars:
    """That a value lies beyond what the bars stand: in a clause, and what they do there."""

    clause: str
    there: str = ""

    @property
    def text(self) -> str:
        return f"{self.clause}: there {self.there}" if self.there else self.clause


def beyond_bars(entry: MarginEntry, subject: str) -> BeyondBars | None:
    """What is to be said of a value at which the bars are no longer elastic; None where they are."""
    bars = entry.bars
    value = entry.value.value
    contact = bars.contact
    if value is None:
        return None
    if bars.contact_everywhere == "yields":
        share = yields_at(entry, format(entry.probability, ".15g"))
        return BeyondBars(clause=f"the bars yield under the sphere there{_cases(share)}")
    ends = [e for e in (contact.value, bars.pulse_value) if e is not None]
    passed = [e for e in ends if (value > e) == _rising(entry) and value != e]
    if not passed:
        return None
    first = min(passed) if _rising(entry) else max(passed)
    share = yields_at(entry, format(entry.probability, ".15g"))
    contacts = first == contact.value
    does = f"they yield under the sphere{_cases(share)}" if contacts else "the pulse makes them yield"
    told = contact if contacts else Est.of(first)
    stand = safe_side(told, subject, at_most=_rising(entry), digits=3)
    return BeyondBars(clause=f"that lies beyond what these bars stand ({stand})", there=does)


def _cases(share: float | None) -> str:
    return "" if share is None else f" {cases_text(share)}"


def cases_text(share: float) -> str:
    """In how many of the cases something happens; what is computed of a law alone may be too small to be said.

    >>> cases_text(0.0341), cases_text(2.8e-28), cases_text(1.0 - 1e-14)
    ('in 3.4 % of the cases', 'in none of the cases', 'in all cases')
    >>> cases_text(0.99868)
    'in 99.86 % of the cases'
    """
    if share < _NEVER:
        return "in none of the cases"
    if share > 1.0 - _NEVER:
        return "in all cases"
    # two digits, which must not make all of nearly all
    return f"in {plain_percent(share if share > 0.99 else float(f'{share:.2g}'))} of the cases"


def answer_checks(entry: MarginEntry) -> list[CheckEntry]:
    """The checks at the answer of an inverse question, with the share of the curve's own cases where it is known.

    A check follows a hundred scenes or so; how often the bars yield is known better, of all cases of the curve, and
    is told with one number everywhere.
    """
    found: list[CheckEntry] = []
    for check in entry.validity.checks:
        share = yields_at(entry, format(entry.probability, ".15g"))
        if check.check != "bar_yield_contact" or share is None or not check.share:
            found.append(check)
            continue
        text = re.sub(r"^in (all|[\d.]+ % of the) scenes", cases_text(share), str(check.text))
        rounded_share = {} if text == check.text else {"share_warning": float(f"{share:.2g}")}
        found.append(check.model_copy(update={**rounded_share, "text": text}))
    return found


def answer_breaches(contents: Contents) -> list[tuple[str, list[CheckEntry]]]:
    """Limit and the checks that are broken at the answer of its inverse question."""
    found = []
    for name, entry in contents.results.margins.items():
        told = entry.validity
        broken = [c for c in told.checks if c.share_failure + c.share_warning > 0.0]
        if broken:
            found.append((name, broken))
    return found


def breach_text(contents: Contents, name: str, check: CheckEntry) -> str:
    """A broken check at the answer of a limit, with its share: of the curve's own cases where it is known of them."""
    entry = contents.results.margins[name]
    share = check.share_failure + check.share_warning
    if check.check == "bar_yield_contact":
        known = yields_at(entry, format(entry.probability, ".15g"))
        share = share if known is None else known
    return f"{broken_words(check)} ({cases_text(share)})"


def reach_cautions(contents: Contents) -> list[str]:
    """Where the model does not hold at the answer of an inverse question, and what that does to it."""
    found = []
    for name, broken in answer_breaches(contents):
        entry = contents.results.margins[name]
        which = f"{input_name(entry.solve)} {answer_text(contents, name)}{of_limit(contents.results, name)}"
        said: dict[str, list[str]] = {}
        for check in broken:
            said.setdefault(bearing(contents, check.check, only=name), []).append(breach_text(contents, name, check))
        whole = " ".join(f"{capital(listed(texts))}. {capital(does)}." for does, texts in said.items())
        found.append(f"At the answer, {which}: {whole[:1].lower()}{whole[1:]}")
    return found


# --- strengths beyond the tests ------------------------------------------------------------------------


def extrapolation_cautions(contents: Contents) -> list[str]:
    """Limits whose verdict or answer rests on strengths outside of what was tested."""
    found = []
    for name, limit in contents.results.limits.items():
        key = f"limits.{name}.strength"
        if key not in contents.resolved.random or not contents.resolved.random[key].data:
            continue
        data = contents.resolved.random[key].data
        quantity = limit.quantity
        weakest, strongest = min(data), max(data)
        parts = []
        margin = contents.results.margins.get(name)
        partial = margin.lost_to.partial.get(key) if margin is not None and margin.value.value is not None else None
        if partial is not None and not weakest <= partial.design <= strongest:
            at = answer_text(contents, name)
            parts.append(f"the answer {at} rests on strengths about {value_text(partial.design, quantity, 3)}")
        given = (limit.drivers.given_failure or {}).get(key)
        mean = given.mean.value if given is not None else None
        if mean is not None and limit.aim == "survive" and mean < weakest:
            parts.append(f"the verdict as planned rests on strengths about {value_text(mean, quantity, 3)}")
        if parts:
            ends = f"{value_text(weakest, quantity, 3)} to {value_text(strongest, quantity, 3)}"
            found.append(
                f"Beyond the tests of {limit_name(name)}: the {len(data)} specimens that broke did so at {ends}; "
                f"{', '.join(parts)}. There the fitted law is extrapolated."
            )
    return found


# --- what is judged, and for which scene ---------------------------------------------------------------


def judged_cautions(contents: Contents) -> list[str]:
    """That only what has a limit is judged."""
    if contents.black_box or not contents.results.fracture.limits:
        return []
    judged = list(dict.fromkeys(contents.results.limits[n].quantity for n in contents.results.fracture.limits))
    names = listed([f"the {call(n)}" if n in OUTPUTS else n for n in judged])
    places = {lookup(name).place for name in judged}
    others = [
        *(() if "rim" in places else ("chips at the rim of a contact",)),
        *(() if "core" in places else ("splits from its core",)),
    ]
    if not others:
        return []
    return [
        f"Fracture is judged by {names} alone. Whether the sphere {' or '.join(others)} before that is not judged: no "
        "limit of the study says at which stress it does."
    ]


def reach_note(contents: Contents) -> str:
    """For which scene the answers hold: sizes and speeds that were sampled, and whether strength knows of size."""
    if contents.black_box:
        return ""
    text = "The speed is that of the striker of this rig, not that of a sphere that falls or is thrown." * any(
        entry.solve == "striker.speed" for entry in contents.results.margins.values()
    )
    radius = _span(contents, "sphere.radius")
    where, other = ("in this machine", " or machine")
    if contents.results.rig == "bars":
        where, other = ("between these bars, with this pulse", ", bar or pulse")
    if radius:
        text += (
            f" The answers hold for a sphere of radius {radius}, {where}: another size{other} needs a run of its own."
        )
    if _size_free(contents):
        text += " The strength does not change with the size of the sphere in this study."
    return text.strip()


def _span(contents: Contents, name: str) -> str:
    law = law_of(contents.resolved, name)
    if law is None:
        fixed = contents.resolved.fixed.get(name)
        return "" if fixed is None else value_text(float(fixed), name, 4)
    low, high = (float(x) for x in law.ppf(np.array([0.001, 0.999])))
    ends = [rounded(Est.of(v), name, 3) for v in (low, high)]
    return " to ".join(ends)


def _size_free(contents: Contents) -> bool:
    """Whether no strength is tied to the sphere's size, by a dependence or by a criterion that counts flaws."""
    limits = contents.results.limits
    if not any(f"limits.{name}.strength" in contents.resolved.random for name in limits):
        return False
    tied = any("sphere.radius" in group.of for group in contents.resolved.dependence)
    plain = all(limit.quantity in OUTPUTS and "weakest" not in limit.quantity for limit in limits.values())
    return not tied and plain


# --- What the verdict takes for granted: the probability without it, as a table, and the sentence for the first page.

#: a probability beyond which its digits are not told
_SURE = 0.999999


def verdict_word(met: bool | None) -> str:
    """Whether a target is kept, in a word."""
    return {True: "met", False: "not met", None: "undecided"}[met]


def short_probability(miss: Est) -> str:
    """A probability in three digits at most, without its interval."""
    value, low, high = miss.value, miss.low, miss.high
    if value is None or value == 0.0 or value > 0.99:
        return plain_percent(value or 0.0)
    if value < 1e-4:
        return rounded(miss, digits=2)
    return rounded(Est.of(*(None if end is None else 100.0 * end for end in (value, low, high))), digits=3) + " %"


def _rank(contents: Contents, row: AssumedEntry) -> str:
    """The rank correlation of a strength with the inputs of a row, where one number stands for all."""
    groups = contents.resolved.dependence
    told = {
        f"{name} {rank:g}"
        for group in groups
        for name, rank in (("Spearman", group.spearman), ("Kendall", group.kendall))
        if rank is not None and set(row.others) & set(group.of)
    }
    return next(iter(told)) if len(told) == 1 else ""


def instead_text(row: AssumedEntry) -> str:
    """What is put in place of what is assumed, as a clause that begins a sentence."""
    if row.assumption == "dependence":
        return f"without the assumed dependence of the strength on {listed([input_name(n) for n in row.others])}"
    if not isinstance(row.instead, float | int) or not isinstance(row.taken, float | int):
        return f"with a {law_name(str(row.instead))} law of the strength, of the same mean and scatter"
    what = "Weibull modulus of the strength" if row.assumption == "modulus" else "scatter of the strength"
    if row.assumption == "modulus":
        return f"with a {what} of {row.instead:.3g} instead of {row.taken:.3g}"
    return f"with a {what} of {100.0 * row.instead:.3g} % instead of {100.0 * row.taken:.3g} %"


def _consequence(limit: LimitEntry, row: AssumedEntry) -> str:
    text = short_probability(row.miss)
    if limit.target is None:
        return text
    word = {True: "target met", False: "target missed", None: "undecided"}[row.met]
    return f"{text} ({word})"


def granted_line(contents: Contents, name: str) -> str:
    """What the probability would be without the assumption that matters most, and by another tail; empty if none."""
    limit = contents.results.limits[name]
    rows = [row for row in limit.assumed or () if row.miss.value is not None]
    parts = []
    for row in rows:
        if row.assumption == "dependence":
            own = f" ({_rank(contents, row)})" if _rank(contents, row) else ""
            parts.append(f"{capital(instead_text(row))}{own} it would be {_consequence(limit, row)}.")
    shapes = [row for row in rows if row.assumption in ("modulus", "cov")]
    if shapes:
        worst = max(shapes, key=lambda row: row.miss.number)
        parts.append(f"{capital(instead_text(worst))} it would be {_consequence(limit, worst)}.")
    return " ".join(parts)


def turns(limit: LimitEntry, row: AssumedEntry) -> bool:
    """Whether the verdict on a limit turns on an assumption; on a law's family only where that loses the target."""
    if limit.target is None or row.miss.value is None or row.met == limit.met:
        return False
    return row.assumption != "law" or limit.met is True


def granted_cautions(contents: Contents) -> list[str]:
    """Assumptions on which a verdict turns."""
    found = []
    for name, limit in contents.results.limits.items():
        for row in limit.assumed or ():
            if not turns(limit, row):
                continue
            own = f" on {limit_name(name)}" if len(contents.results.limits) > 1 else ""
            source = "; the dependence is an assumption of the study" if row.assumption == "dependence" else ""
            found.append(
                f"The verdict{own} turns on an assumption: {instead_text(row)} the probability that "
                f"{missing(contents.results, name)} would be {short_probability(row.miss)}, at most "
                f"{plain_percent(limit.target or 0.0)} is allowed: {verdict_word(row.met)}{source}."
            )
    return found


def granted_table(contents: Contents) -> Table | None:
    """Every assumption about a strength, what is put instead, and the probability and verdict that follow."""
    limits = contents.results.limits
    several, rows = len(limits) > 1, []
    for name, limit in limits.items():
        own = (limit_name(name),) if several else ()
        known = [row for row in limit.assumed or () if row.miss.value is not None]
        opened = limit.ignorance
        if not known and not opened.known:
            continue
        rows.append((*own, "as the study has it", cell(limit.miss, probability=True), _word(limit, limit.met)))
        if opened.known:
            tests = listed([f"{entry.tests} tests" for entry in opened.fitted])
            text = probability_range(*opened.miss)
            rows.append((*own, f"by all laws that the {tests} allow (95 %)", text, _word(limit, opened.met)))
        rows += [(*own, instead_text(row), _chance(row.miss), _word(limit, row.met)) for row in known]
    if not rows:
        return None
    header = (*(("limit",) if several else ()), "what is assumed", "probability of missing the aim", "target")
    return Table(caption="What the verdict takes for granted of the strength", header=header, rows=tuple(rows))


def _chance(miss: Est) -> str:
    """A probability with its interval; how many nines one has is of no use beyond six."""
    low = miss.low
    return f"more than {plain_percent(_SURE)}" if low is not None and low > _SURE else cell(miss, probability=True)


def granted_block(contents: Contents, heading: str) -> Block:
    """The table under its heading; empty where nothing is assumed of a strength."""
    table = granted_table(contents)
    files = ("tables/limits.csv",) if table else ()
    return Block(heading=heading, table=table, files=files)


def _word(limit: LimitEntry, met: bool | None) -> str:
    return number_text(verdict_word(met)) if limit.target is not None else "no target"
