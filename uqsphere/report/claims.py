"""What a run found, worded once: terminal, page, headings and comparison choose among claims and set them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from uqsphere.report.assumptions import beyond_bars
from uqsphere.report.blocks import thousands
from uqsphere.report.contents import subject_of
from uqsphere.report.phrases import (
    at_most,
    begin,
    call,
    capital,
    event,
    input_name,
    limit_name,
    listed,
    of_limit,
    plain_percent,
    rounded,
    safe_side,
    share_text,
    short_input,
    solved_name,
    symbol,
    value_text,
)
from uqsphere.results import IndexEntry, LimitEntry, MeasureEntry, MeasureRow, Results
from uqsphere.results.entries import Est, Ests
from uqsphere.results.margins import MarginOpenEntry

#: what a claim is about: the answer of an inverse question, strength over demand, how a quantity is distributed, who
#: owns its variance, and what to measure first
Topic = Literal["answer", "demand", "distribution", "shares", "measure"]


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A finding, worded once: a heading sets `short`, a line `first`, a paragraph `text` or, under its name, `told`.

    Attributes
    ----------
    topic, subject : what it is about, and of which limit or quantity.
    level : whether it answers what was asked, tells something that was found, or that it is not known.
    head : whom it speaks of, which is left out where that stands above; may be empty.
    body : the finding itself, without a full stop.
    more : what is to be said further: clauses, which go on after a semicolon, and sentences, with a full stop.
    short : a few words for a heading; empty where nothing is known.
    estimate : the number that it rests on.
    """

    topic: Topic
    subject: str
    level: Literal["answer", "finding", "not known"] = "finding"
    head: str = ""
    body: str
    more: tuple[str, ...] = ()
    short: str = ""
    estimate: Est = field(default_factory=Est)

    @property
    def first(self) -> str:
        """The finding in one sentence."""
        return f"{self._begun}."

    @property
    def text(self) -> str:
        """All of it."""
        return self._ended(self._begun)

    @property
    def told(self) -> str:
        """All of it, where the head stands above."""
        return self._ended(capital(self.body))

    @property
    def _begun(self) -> str:
        return f"{self.head}: {self.body}" if self.head else self.body

    def _ended(self, text: str) -> str:
        for part in self.more:
            text += f". {part.rstrip('.')}" if part.endswith(".") else f"; {part}"
        return f"{text}."


def claims(results: Results) -> list[Claim]:
    """All that is claimed of a run, in the order in which it is asked for."""
    found: list[Claim | None] = [answer_claim(results, name) for name in results.margins]
    found += [demand_claim(name, limit) for name, limit in results.limits.items()]
    found += [distribution_claim(results, name) for name in results.quantities]
    found += [shares_claim(results, name) for name in results.sensitivity]
    found += [measure_claim(f"limits.{name}", limit.measure_first) for name, limit in results.limits.items()]
    found += [measure_claim(name, entry.measure_first) for name, entry in results.sensitivity.items()]
    return [claim for claim in found if claim is not None]


# --- strength over demand -------------------------------------------------------------------------------


def margin_word(limit: LimitEntry) -> str:
    """Margin, or shortfall where a demand is to reach a strength and in the median does not."""
    return "Shortfall" if _short_of(limit) else "Margin"


def _short_of(limit: LimitEntry) -> bool:
    median = limit.margin["median"].value
    return limit.aim == "break" and median is not None and median > 1.0


def demand_claim(name: str, limit: LimitEntry) -> Claim:
    """How many times the demand the strength is, or why that is not known; a shortfall where the aim is to break."""
    margin = limit.margin
    known = {key: rounded(e, digits=3) for key, e in _known(margin).items()}
    absent = next((e for e in margin.values() if e.value is None), None)
    reason = "" if absent is None else str(absent.reason or "the strength is zero")
    own = f"Limit {limit_name(name)}"
    if not known:
        body = f"there is no margin: {reason or 'the strength is zero'}"
        return Claim(topic="demand", subject=name, level="not known", head=own, body=body)
    if len(known) == 3 and len(set(known.values())) == 1:
        told = f"{known['median']} times the demand"
    elif len(known) == 3:
        told = (
            f"{known['median']} times the demand in the median case, and between {known['0.05']} and "
            f"{known['0.95']} times it in nine cases of ten"
        )
    else:
        words = {"median": "in the median case", "0.05": "at the 5 % end", "0.95": "at the 95 % end"}
        told = "; ".join(f"{value} times the demand {words[key]}" for key, value in known.items()) + f" ({reason})"
    return Claim(
        topic="demand",
        subject=name,
        head=own,
        body=f"short of it, the strength is still {told}" if _short_of(limit) else f"the strength is {told}",
        more=("The load would have to be that many times as large to break it.",) if _short_of(limit) else (),
        short=known.get("median", ""),
        estimate=margin["median"],
    )


def _known(margin: Ests) -> Ests:
    """The quantiles of a margin that have a value, the lowest first."""
    return {key: margin[key] for key in ("0.05", "median", "0.95") if key in margin and margin[key].value is not None}


# --- how a quantity is distributed ------------------------------------------------------------------------


def distribution_claim(results: Results, quantity: str) -> Claim:
    """Between which values the cases lie."""
    entry = results.quantities[quantity]
    median, low, high = (entry.quantiles.get(p, Est()) for p in ("0.5", "0.05", "0.95"))
    share = entry.censored_share.value or 0.0
    own = begin(quantity, call(quantity))
    ends = [rounded(end, quantity) for end in (low, high) if end.value is not None]
    more: list[str] = []
    short = ""
    if share >= 1.0:
        body = "no sample ends within its record, so that only a lower bound is known"
        return Claim(topic="distribution", subject=quantity, level="not known", head=own, body=body)
    if median.value is None:
        body = f"the median is not known ({median.reason})"
    else:
        body = f"half of the cases lie below {rounded(median, quantity)}"
        body += f", and nine in ten between {ends[0]} and {ends[1]}" if len(ends) == 2 else ""
    if share > 0.0:
        more.append(
            f"In {plain_percent(share)} of the cases it outlasts the record; these are known as lower bounds only."
        )
    if len(ends) == 2 and low.number < high.number:
        short = " to ".join(rounded(end, quantity, 3) for end in (low, high)) + " in nine cases of ten"
    return Claim(
        topic="distribution", subject=quantity, head=own, body=body, more=tuple(more), short=short, estimate=median
    )


# --- who owns the variance --------------------------------------------------------------------------------


def ranked(entry: IndexEntry | None) -> list[str]:
    """Inputs with an index, the most important first: by the total index where interactions are seen."""
    if not entry:
        return []
    known = [n for n, e in entry.total.items() if e.value is not None and entry.first[n].value is not None]
    order = entry.total if any(_interacts(entry, name) for name in known) else entry.first
    return sorted(known, key=lambda name: -float(order[name].value or 0.0))


def shares_claim(results: Results, quantity: str) -> Claim:
    """Which inputs drive a quantity, with numbers."""
    entry = results.sensitivity.get(quantity, IndexEntry())
    rows, name = ranked(entry), symbol(quantity)
    if not rows:
        return _shared_claim(entry, quantity)
    acting = any(_interacts(entry, n) for n in rows)
    parts = [_driver(entry, n, acting) for n in rows[:3] if n == rows[0] or _seen(entry.total[n])]
    more = ["next " + listed([f"{words} with {share}" for words, share in parts[1:]])] if len(parts) > 1 else []
    if not acting:
        few = any(_exceeds(entry, n) for n in rows)
        seen = "that are seen add at most 1 % to an input" if few else "are not seen above the intervals"
        more.append(f"Interactions {seen}.")
    lead = begin(rows[0], parts[0][0])
    return Claim(
        topic="shares",
        subject=quantity,
        body=f"{lead} drives {parts[0][1]} of the variance of {name}",
        more=tuple(more),
        short=f"{lead} drives {name}: {share_text(entry.first[rows[0]])} of its variance by itself",
        estimate=entry.first[rows[0]],
    )


def _shared_claim(entry: IndexEntry, quantity: str) -> Claim:
    """Who owns the variance where inputs depend on each other, or why nothing is known of it."""
    known = {n: e for n, e in entry.shapley.items() if e.value is not None}
    if not known:
        reason = next((str(e.reason) for e in entry.shapley.values()), "") or entry.check.text
        reason = (reason or "no indices were computed").rstrip(".")
        body = f"What drives {symbol(quantity)} is not known: {reason}"
        return Claim(topic="shares", subject=quantity, level="not known", body=body)
    order = sorted(known, key=lambda n: -known[n].number)[:3]
    shares = [f"{short_input(n)} ({100.0 * known[n].number:.0f} %)" for n in order]
    whose = f"the variance of {symbol(quantity)} belongs to {listed(shares)}"
    body = f"Inputs depend on each other; by Shapley effects {whose}"
    return Claim(topic="shares", subject=quantity, body=body, estimate=known[order[0]])


def _seen(estimate: Est) -> bool:
    return (estimate.low or 0.0) > 0.0 and estimate.number > 0.005


def _interacts(entry: IndexEntry, name: str) -> bool:
    """Whether the total index is larger than the first by more than the intervals and by what matters."""
    first, total = entry.first[name], entry.total[name]
    return _exceeds(entry, name) and total.number - first.number > 0.01


def _exceeds(entry: IndexEntry, name: str) -> bool:
    """Whether the total index is larger than the first by more than the intervals."""
    first, total = entry.first[name], entry.total[name]
    return first.high is not None and total.low is not None and bool(total.low > first.high)


def _driver(entry: IndexEntry, name: str, acting: bool) -> tuple[str, str]:
    """An input in words, and its share of the variance; with its interactions where any input has them."""
    first, total = share_text(entry.first[name]), share_text(entry.total[name])
    if acting:
        return short_input(name), f"{total} with its interactions ({first} alone)"
    return short_input(name), first


# --- what to measure first --------------------------------------------------------------------------------


def specimens(entry: MeasureEntry, row: MeasureRow) -> int | None:
    """Specimens after which the mean of an input leaves the smaller side of a probability known as wanted.

    What is stored counts to a tenth, say, of the probability itself: of one near 1 any single specimen tells that,
    and nothing is learnt about how near it is.

    >>> row = MeasureRow(input="x", tests=1, share=1.0, sway=Est.of(1.83149e-4))
    >>> specimens(MeasureEntry(of="probability", wanted=0.1, probability=1.0 - 4.45344e-5), row)
    1692
    """
    p, sway = entry.probability, row.sway.value
    if entry.of != "probability" or p is None or not 0.5 < p < 1.0 or sway is None:
        return row.tests
    return max(1, math.ceil((float(sway) / (float(entry.wanted) * (1.0 - float(p)))) ** 2))


def first_to_measure(entry: MeasureEntry | None) -> MeasureRow | None:
    """The row of the input that is worth most, None where no input can be told from one that does nothing.

    Of several inputs that do nothing one always comes first, by chance: three standard errors let hardly any pass.
    """
    for row in entry.rows if entry is not None else ():
        found = row.effect
        if abs(found.value or 0.0) > 3.0 * (found.std_error or 0.0):
            return row
    return None


def _side(entry: MeasureEntry) -> str:
    """Of which probability a tenth, say, is to be known."""
    return "the probability to the contrary" if (entry.probability or 0.0) > 0.5 else "the probability"


def measure_claim(subject: str, entry: MeasureEntry) -> Claim | None:
    """Which input to measure first, and how often; None where nothing is known of it."""
    if not entry.rows:
        return None
    first, wanted = first_to_measure(entry), f"{100.0 * entry.wanted:g} %"
    if first is None:
        of = "moves the probability" if entry.of == "probability" else "has a part in the variance"
        body = f"No input is worth measuring by itself: none {of} by more than chance would show"
        return Claim(topic="measure", subject=subject, level="not known", body=body)
    count = specimens(entry, first) or 0
    tests = thousands(count) + f" test{'s' if count != 1 else ''}"
    seen = first.observations
    over = f", {thousands(count - seen)} more than there are" if seen and count > seen else ""
    more: tuple[str, ...] = ()
    if entry.of == "probability":
        body = f"{_side(entry)} itself is known to {wanted} (one standard error) after {tests} of it in all{over}, if "
        body += "only its mean is unknown"
        more = ("how many settle the target is another question, and stands in the verdict",)
    else:
        body = f"after {tests} its part in the variance is {wanted} of today’s whole variance"
    own = input_name(first.input)
    return Claim(
        topic="measure",
        subject=subject,
        head=f"Measure {own} first",
        body=body,
        more=more,
        short=own,
        estimate=first.effect,
    )


# --- the answer of an inverse question --------------------------------------------------------------------


def _stricter(results: Results, name: str, *, most: bool) -> str:
    """Which way to break asks for more than a limit does, with a strength that is assumed; empty where none does."""
    limit, entry = results.limits[name], results.margins[name]
    assert limit.target is not None
    judged = [one for v in results.verdicts if (v.aim, v.target) == (limit.aim, limit.target) for one in v.judged]
    assumed = {one.name: one.answer for one in judged if one.assumed and one.answer is not None}
    # without a curve no value was looked for
    missed = [one for one in judged if one.assumed and one.curve and one.answer is None]
    nowhere = [one.name for one in missed if one.miss.number > limit.target]
    if not any(one.name == name for one in judged):
        return ""
    if nowhere:
        return f"by {nowhere[0]}, with a strength assumed from the library, no value between the bounds"
    if not assumed:
        return ""
    worst = min(assumed, key=lambda called: assumed[called] if most else -assumed[called])
    if (assumed[worst] < entry.value.number) is not most:
        return ""
    value = safe_side(Est.of(assumed[worst]), subject_of(results, entry.solve), at_most=most, digits=2)
    return f"by {worst}, with a strength assumed from the library, {'at most' if most else 'at least'} {value}"


def answer_claim(results: Results, name: str) -> Claim | None:
    """At most or at least how much keeps the aim of a limit; None where it has no target."""
    entry, limit = results.margins.get(name), results.limits.get(name)
    if not entry or not entry.value or limit is None or limit.target is None:
        return None
    value, solve = entry.value, entry.solve
    subject = subject_of(results, solve)
    survive = limit.aim == "survive"
    chance = plain_percent(limit.target if survive else 1.0 - limit.target)
    share = f"at most {chance}" if survive else f"{chance} or more"
    aim = f"{event(results, name)} with a probability of {share}{of_limit(results, name)}"
    if value.value is None:
        # that there is none may be said only where the whole range was looked at
        if str(value.reason).startswith("no value between"):
            body = f"No {input_name(solve)} between the bounds of the study is such that {aim}: {value.reason}"
        else:
            body = f"At which {input_name(solve)} {aim} is not known: {value.reason}"
        return Claim(topic="answer", subject=name, level="not known", body=body, estimate=value)
    most = at_most(entry, limit.aim)
    word = "at most" if most else "at least"
    opened = entry.ignorance
    known = safe_side(value, subject, at_most=most)
    more = []
    if opened.sure is not None:
        # what the tests leave open comes first: the value by their fitted law is exact in nothing but the computation
        sure = safe_side(Est.of(opened.sure), subject, at_most=most, digits=3)
        body = (
            f"{word} {sure} to be {plain_percent(opened.confidence)} sure (one-sided) that {aim}, the value to keep to"
        )
        more.append(f"{word} {known} by the law fitted to the {_tests(opened)}{_open_range(opened, subject)}")
    else:
        body = f"{word} {known}, so that {aim}"
        if opened and opened.reason is None:
            confidence = plain_percent(opened.confidence)
            more.append(f"{_tests(opened)} are too few to be {confidence} sure of any value looked at")
    beyond = beyond_bars(entry, subject)
    if beyond is not None:
        more.append(f"{known} is the answer for elastic bars: {beyond.text}")
    stricter = _stricter(results, name, most=most)
    if stricter:
        more.append(stricter)
    own = solved_name(results, solve)
    return Claim(
        topic="answer",
        subject=name,
        level="answer",
        head=own,
        body=body,
        more=tuple(more),
        short=known,
        estimate=value,
    )


def _open_range(opened: MarginOpenEntry, subject: str) -> str:
    """Between which values the tests leave the answer, two-sided."""
    if opened.low is None or opened.high is None:
        return ""
    low, high = (value_text(end, subject, 3) for end in (opened.low, opened.high))
    return f", which leave open {low} to {high} (95 %)"


def _tests(opened: MarginOpenEntry) -> str:
    stopped = opened.stopped
    return f"{opened.tests} tests" + (f" ({stopped} of them stopped before failure)" if stopped else "")
