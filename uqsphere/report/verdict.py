"""The verdict of a run in words: the answer with its uncertainty, the margin, what it hangs on, what limits it."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from uqsphere.model import status_text
from uqsphere.quantities import OUTPUTS
from uqsphere.report.assumptions import (
    answer_breaches,
    bearing,
    beyond_bars,
    breach,
    broken_words,
    check_name,
    extrapolation_cautions,
    granted_cautions,
    granted_line,
    grave,
    judged_cautions,
    reach_cautions,
    short_probability,
    verdict_word,
    warned,
)
from uqsphere.report.blocks import Verdict
from uqsphere.report.claims import (
    answer_claim,
    demand_claim,
    distribution_claim,
    first_to_measure,
    margin_word,
    measure_claim,
    shares_claim,
)
from uqsphere.report.contents import Contents
from uqsphere.report.drivers import mostly_missed
from uqsphere.report.figures.canvas import shorten
from uqsphere.report.figures.distributions import single_value
from uqsphere.report.margins import no_common_value, settling_text, tests_text
from uqsphere.report.phrases import (
    absent_reason,
    answer_text,
    begin,
    breaks,
    call,
    capital,
    estimate_text,
    event,
    failures_text,
    input_name,
    limit_name,
    listed,
    missing,
    outward,
    plain_percent,
    probability_range,
    probability_text,
    rounded,
    shortfalls,
    symbol,
    value_text,
    without_failed,
)
from uqsphere.results import LimitEntry, MeasureEntry, Results
from uqsphere.results.entries import Est
from uqsphere.results.verdicts import JudgedEntry
from uqsphere.uq.failure_indices import BY_DIRECTION, BY_INFORMATION


def verdicts(contents: Contents) -> list[Verdict]:
    """One verdict per limit; for a study without limits one per quantity."""
    limits = contents.results.limits
    if limits:
        return [_limit_verdict(contents, name, limit) for name, limit in limits.items()]
    return [_quantity_verdict(contents, name) for name in contents.results.quantities]


def _limit_verdict(contents: Contents, name: str, limit: LimitEntry) -> Verdict:
    word = limit.word
    to_break = limit.aim == "break"
    what = f"Probability of missing {limit_name(name)}" if to_break else f"Probability of {limit_name(name)}"
    fracture = breaks(contents.results, name)
    if fracture:
        what = capital(f"{_as_planned(contents, name)}{missing(contents.results, name)} with a probability of")
    answer = f"{what}{' ' if fracture else ': '}{_headline(limit.miss)}"
    if not contents.resolved.random and limit.exceedance.value is not None:
        kept = "" if limit.exceedance.value > 0.5 else "not "
        answer = f"Limit {limit_name(name)} is {kept}exceeded in the one scene of a study without scatter"
    if limit.miss.value is None:
        answer += f" ({absent_reason(limit.miss)})"
    if limit.target is not None:
        allowed = plain_percent(limit.target)
        answer += (f", at most {allowed} allowed" if fracture else f", target at most {allowed}") + f": {word}."
    else:
        answer += "; no target was set."
    relation = "stays below" if to_break else "exceeds"
    aim = "the aim is to break it" if to_break else "the aim is to survive"
    article = "the " if limit.quantity in OUTPUTS else ""
    factor = contents.resolved.limits[name].model_factor
    demand = call(limit.quantity) + ("" if factor == 1.0 else ", times its model factor,")
    note = f"That is the probability that {article}{demand} {relation} {_strength(contents, name)}; {aim}."
    return Verdict(
        word=word,
        heading=shorten(name, 80),
        note=note,
        lines=tuple(
            line
            for line in (
                answer,
                reasons_text(limit),
                ways_text(contents.results, name),
                _uncertainty(contents, limit, verdict_word(limit.met) if limit.target is not None else word),
                granted_line(contents, name),
                _hangs_on(contents, limit),
                _by_reflections(contents, name),
            )
            if line
        ),
    )


def reasons_text(limit: LimitEntry) -> str:
    """Why the verdict is what it is, where the probability alone does not say it."""
    return "".join(f"{capital(reason.text)}. " for reason in limit.reasons).rstrip()


def ways_text(results: Results, name: str) -> str:
    """By which ways to break a limit was judged beside its own, in sentences; empty where that is all."""
    limit = results.limits[name]
    found = next((one for one in results.verdicts if (one.aim, one.target) == (limit.aim, limit.target)), None)
    if found is None or not any(one.name == name for one in found.judged):
        return ""
    others = [
        f"{limit_name(one.name)} ({_chance_of(one)})" for one in found.judged if not one.assumed and one.name != name
    ]
    assumed = [f"{one.name} ({_chance_of(one)})" for one in found.judged if one.assumed]
    text = f"Judged together with {listed(others)}. " if others else ""
    if assumed:
        text += "With strengths assumed from the library, which decide nothing alone, the aim is missed by "
        text += f"{listed(assumed)}. "
    for called, why in found.not_judged.items():
        text += f"{capital(called)} is not judged: {why}. "
    return text.rstrip()


def _chance_of(one: JudgedEntry) -> str:
    """How likely a way by itself misses the aim, an assumed one over the range of its strength."""
    own = plain_percent(float(f"{one.miss.value or 0.0:.2g}"))
    return own if one.range is None else f"{own}, {probability_range(*one.range)} over the range of its strength"


def _as_planned(contents: Contents, name: str) -> str:
    """Where the study stands with the scalar that its margin solves for."""
    entry = contents.results.margins.get(name)
    here = None if entry is None else contents.at_mean(entry.solve)
    if entry is None or here is None:
        return ""
    return f"as planned, at {value_text(here, contents.subject(entry.solve))}, "


def _by_reflections(contents: Contents, name: str) -> str:
    """How much of the breakage reflected waves bring; empty where they bring little, or several limits share it."""
    found = contents.results.fracture
    whole, first = found.union, found.first_loading
    if found.limits != (name,) or not whole.value or first.value is None:
        return ""
    share = 1.0 - first.value / whole.value
    if share < 0.1:
        return ""
    return (
        f"Reflected waves bring {100.0 * share:.0f} % of the breakage: in the first loading, before the first of them "
        f"is back, the sphere breaks with a probability of {short_probability(first)}."
    )


def _uncertainty(contents: Contents, limit: LimitEntry, word: str) -> str:
    """How far the probability is known: first by the tests, where there are any, then by the computation alone."""
    opened = ignorance_text(contents, limit)
    if opened and limit.ignorance.known:
        (low, high), met = limit.ignorance.miss, limit.ignorance.met
        by_tests = _against(limit, *outward(low, high), "undecided" if met is None else "met" if met else "not met")
        opened = ignorance_text(contents, limit, by_tests)
        return f"Its uncertainty: {opened[:1].lower()}{opened[1:]} {capital(_computed(contents, limit, word))}"
    text = f"Its uncertainty: {_computed(contents, limit, word)}"
    given = "The laws of the inputs and the strength are taken as given: the real uncertainty is larger."
    return f"{text} {opened or (given if contents.resolved.random else '')}".rstrip()


def _computed(contents: Contents, limit: LimitEntry, word: str) -> str:
    """What the computation leaves open, which is not all that is."""
    low, high = limit.miss.low, limit.miss.high
    if low is None or high is None or not contents.resolved.random:
        return "the computation adds none."
    whole = _headline(limit.miss) == probability_text(limit.miss)
    text = "the interval is that of the computation alone (95 %)"
    text = text if whole else f"the computation alone leaves {_ends(limit.miss)} (95 %)"
    if word == "undecided":
        return text + "; the interval reaches across the target: more evaluations would decide it."
    return text + ("" if limit.ignorance.known else _against(limit, low, high, word)) + "."


def _against(limit: LimitEntry, low: float, high: float, word: str) -> str:
    """How far a range of probabilities stays off the target, in a clause."""
    target = limit.target
    if target and word == "met" and 0.0 < high < target:
        return f", at least {_times(target / high)} times below the target"
    if target and word == "not met" and low > target:
        return f", at least {_times(low / target)} times the target"
    return ""


def _headline(miss: Est) -> str:
    """A probability that is known better than anybody asks in three digits alone; its interval is in the next line."""
    value, low, high = miss.value, miss.low, miss.high
    if value is None or low is None or high is None or not 0.0 < high - low < 0.02 * min(value, 1.0 - value):
        return probability_text(miss)
    if value > 0.99:
        return plain_percent(value)
    if value < 1e-4:
        return rounded(miss, digits=3)
    return rounded(Est.of(100.0 * value, 100.0 * low, 100.0 * high), digits=3) + " %"


def _ends(miss: Est) -> str:
    """The ends of an interval, as the answer above has them."""
    text = probability_text(miss)
    inside = re.search(r"\((.*)\)(.*)$", text)
    return text if inside is None else inside[1] + inside[2]


def _times(ratio: float) -> str:
    """A ratio of at least 1, never rounded up."""
    digits = 1 if ratio < 10.0 else 0
    return f"{math.floor(ratio * 10**digits) / 10**digits:,.{digits}f}".replace(",", "\u202f")


def ignorance_text(contents: Contents, limit: LimitEntry, against: str = "") -> str:
    """What the tests behind the laws leave open, in sentences; empty where no law was fitted to tests.

    `against` says in a clause how far that stays off the target.
    """
    opened = limit.ignorance
    if not opened:
        return ""
    sources = listed([f"{input_name(entry.input)} ({entry.tests} tests)" for entry in opened.fitted])
    if opened.reason is not None:
        return f"What the tests of {sources} leave open is not known: {opened.reason}."
    low, high = opened.miss
    text = f"The tests of {sources} leave open a probability of {probability_range(low, high)} (95 %){against}"
    if limit.target is not None and opened.met is None:
        text += ", on both sides of the target: more tests would decide it"
    text += "."
    if opened.alone:
        widest = max(opened.alone, key=lambda name: _stretch(opened.alone[name]))
        text += f" Most of that is owed to {input_name(widest)}."
    return text


def _stretch(ends: Sequence[float]) -> float:
    """Width of a range of probabilities in normal scores."""
    from scipy.special import ndtri

    low, high = (min(max(end, 1e-300), 1.0 - 1e-16) for end in ends)
    return float(ndtri(high) - ndtri(low))


def _strength(contents: Contents, name: str) -> str:
    found = contents.resolved.limits[name].strength
    if found == "random":
        return "the strength"
    return value_text(float(found), contents.results.limits[name].quantity)


def _hangs_on(contents: Contents, limit: LimitEntry) -> str:
    if not contents.resolved.random:
        return "It hangs on nothing that scatters: no number of the study is random."
    governing = limit.governing_inputs
    text = "It hangs on: "
    if governing:
        order = sorted(governing, key=lambda n: -governing[n])
        kept = [n for n in order if governing[n] >= 0.05][:3] or order[:1]
        text += listed([f"{input_name(n)} ({100.0 * governing[n]:.0f} %)" for n in kept])
        if limit.governing_inputs_method == BY_INFORMATION:
            text += ", by how much a failure tells of each; failures lie in several directions. "
        elif limit.governing_inputs_method == BY_DIRECTION:
            text += ", by the direction from the middle of all cases to that of the failures. "
        else:
            likeliest, whole = ("success", "keep") if mostly_missed(limit) else ("failure", "miss")
            text += f", by their importance factors in the likeliest {likeliest}"
            ways = int(limit.design_points or 1)
            text += f", of {ways} ways to {whole} the aim; the others may hang on other inputs. " if ways > 1 else ". "
    else:
        text += "no failure, or nothing else, was seen, so the governing inputs are not known. "
    return text + shares_claim(contents.results, limit.quantity).text if not governing else text.rstrip()


def _quantity_verdict(contents: Contents, name: str) -> Verdict:
    single = single_value(contents, name)
    if single:
        text = f"{begin(name, call(name))}: {single}, in the one scene of a study without scatter."
        return Verdict(word="answer", heading=symbol(name), lines=(text,))
    return Verdict(
        word="answer",
        heading=symbol(name),
        lines=(distribution_claim(contents.results, name).text, shares_claim(contents.results, name).text),
    )


def cautions(contents: Contents) -> list[str]:
    """Everything that weakens the answer, the gravest first; empty if nothing does."""
    results = contents.results
    found = _failures(contents)
    found += granted_cautions(contents)
    found += reach_cautions(contents)
    for check in grave(contents):
        found.append(
            f"Outside the model's validity: {breach(check, 'failure')}. {capital(bearing(contents, check.check))}."
        )
    found += _warnings(contents, found)
    for name, entry in results.quantities.items():
        share = entry.censored_share
        if share.value:
            most = "All" if share.value == 1.0 else probability_text(share) + " of the"
            found.append(
                f"{most} samples of {symbol(name)} outlast their record: they are lower bounds, and mean and standard "
                "deviation are those restricted to the record."
            )
    if contents.manifest.interrupted:
        found.append("The run was interrupted: these are the answers up to there, and the same command goes on.")
    elif contents.manifest.stopped_by_time:
        found.append("The time budget stopped the run before the accuracy asked for was reached everywhere.")
    elif "evaluations" in results.accuracy.stopped_by.values():
        found.append(_out_of_budget(contents))
    found += extrapolation_cautions(contents)
    missed = _missed([str(text) for text in results.accuracy.missed])
    if missed and limits_are_accurate(results):
        missed[0] += " The probabilities that the verdict rests on are as accurate as asked."
    found += missed
    found += [str(text) for text in results.warnings]
    return found + judged_cautions(contents)


def _warnings(contents: Contents, said: Sequence[str]) -> list[str]:
    """The checks that warn as planned, those of one effect together; an effect that was said is not said again."""
    groups: dict[str, list[str]] = {}
    for check in warned(contents):
        groups.setdefault(capital(bearing(contents, check.check)), []).append(breach(check, "warning"))
    known = [text for does, texts in groups.items() if any(f"{does}." in other for other in said) for text in texts]
    found = [f"Validity warning, as planned: {listed(known)}, to the same effect as at the answer."] if known else []
    return found + [
        f"Validity warning: {listed(texts)}. {does}."
        for does, texts in groups.items()
        if not any(f"{does}." in other for other in said)
    ]


def _out_of_budget(contents: Contents) -> str:
    """That the budget ended it: used up, or given up before because the rest of it could not have sufficed."""
    budget = contents.resolved.analysis.budget.evaluations
    spent = sum(contents.results.model.evaluations.values())
    text = "The budget of evaluations ended the run before the accuracy asked for was reached everywhere"
    if spent < 0.9 * budget:
        text += ": what was left of it would not have been enough, and was not spent"
    return text + "."


def limits_are_accurate(results: Results) -> bool:
    """Whether there are limits, and none of their probabilities is stored as less accurate than asked."""
    asked = [row for row in results.accuracy.questions if str(row.quantity).startswith("limits.")]
    known = all(limit.miss.value is not None for limit in results.limits.values())
    return bool(asked) and known and all(row.met is not False for row in asked)


def _missed(texts: list[str]) -> list[str]:
    """What was not as accurate as asked, in full if it is short; the full list stands further down."""
    if len(texts) <= 4:
        told = "; ".join(shortfalls(texts, len(texts)))
        return [f"Accuracy asked for but not reached: {told}."] if texts else []
    counts: dict[str, int] = {}
    for text in texts:
        subject = text.partition(": ")[0]
        counts[subject] = counts.get(subject, 0) + 1
    named = [f"{shorten(subject, 40)} ({count})" for subject, count in list(counts.items())[:8]]
    more = "" if len(counts) <= 8 else " and others"
    return [
        f"Accuracy asked for but not reached in {len(texts)} places: {', '.join(named)}{more}; see what was asked, "
        "what was reached."
    ]


def _failures(contents: Contents) -> list[str]:
    model = contents.results.model
    if not model.failures:
        return []
    reasons = [
        f"{number} because {status_text(int(code), contents.black_box)}"
        for code, number in model.failure_reasons.items()
    ]
    policy = {"bound": "counted once as exceeding and once as not", "drop": "left out", "abort": "the run ends there"}
    how = policy[contents.resolved.analysis.on_failure]
    text = f"{failures_text(model.failures)} ({how})"
    return [text + (": " + "; ".join(reasons) if reasons else "") + f". {capital(without_failed(contents.results))}."]


# --- The questions that are asked of every report first, each with its answer in a line.


@dataclass(frozen=True, kw_only=True)
class Glance:
    """A question, its answer, and the anchor of the chapter that says more."""

    question: str
    answer: str
    anchor: str


def glances(contents: Contents) -> list[Glance]:
    """What is asked first: how far may one go, how much margin, what drives it, what to measure, is it valid."""
    limits = contents.results.limits
    several = len(limits) > 1
    found: list[tuple[int, Glance]] = []
    for name, limit in limits.items():
        own = f" ({limit_name(name, 30)})" if several else ""
        to_break = limit.aim == "break"
        if name in contents.results.margins:
            solve = contents.results.margins[name].solve
            mean = "mean " if solve in contents.resolved.random else ""
            question = f"{'Least' if to_break else 'Largest'} {mean}{input_name(solve)}{own}"
            answer = allowed_value(contents, name)
            found.append((to_break, Glance(question=question, answer=answer, anchor="decision")))
        word, answer = margin_word(limit), demand_claim(name, limit).told
        found.append((3 + (word != "Margin"), Glance(question=f"{word}{own}", answer=answer, anchor="margins")))
        answer = _measure_limit(contents, name)
        found.append((6, Glance(question=f"Measure next{own}", answer=answer, anchor="measure")))
    if not limits:
        asked = (e.measure_first for e in contents.results.sensitivity.values() if e.measure_first)
        answer = _measure(next(asked, MeasureEntry()))
        found.append((6, Glance(question="Measure next", answer=answer, anchor="measure")))
    quantities = dict.fromkeys(limit.quantity for limit in limits.values())
    for name in [q for q in quantities if q in contents.results.sensitivity]:
        found.append((5, Glance(question="Main driver", answer=_driver(contents, name), anchor="drivers")))
    if contents.results.validity:
        found.append((7, Glance(question="Model valid?", answer=_valid(contents), anchor="computed")))
    found.append((2, Glance(question="All aims together", answer=no_common_value(contents), anchor="decision")))
    return [glance for _, glance in sorted(found, key=lambda pair: pair[0]) if glance.answer]


def allowed_value(contents: Contents, name: str) -> str:
    """The safest of the values asked for, where no target decides; with one the answer has a box of its own."""
    limit, entry = contents.results.limits[name], contents.results.margins[name]
    known = {float(p): e for p, e in entry.values.items() if e.value is not None}
    if not known or answer_claim(contents.results, name) is not None:
        return ""
    p = min(known) if limit.aim == "survive" else max(known)
    alone = "" if known[p].low is None else " (interval of the computation alone)"
    text = f"{estimate_text(known[p], entry.solve)}{alone}: there {event(contents.results, name)} "
    text += f"with a probability of {plain_percent(p)}"
    at_p = entry.model_copy(update={"value": known[p], "probability": p})
    beyond = beyond_bars(at_p, contents.subject(entry.solve))
    return f"{text}; {beyond.text}." if beyond is not None else f"{text}."


def _driver(contents: Contents, quantity: str) -> str:
    """What drives the probability of the limits of a quantity, and the quantity itself."""
    parts = []
    for name, limit in contents.results.limits.items():
        shares = limit.governing_inputs or {}
        if limit.quantity == quantity and shares:
            first = max(shares, key=lambda n: float(shares[n]))
            several = limit.governing_inputs_method == BY_INFORMATION
            share = f"{100.0 * float(shares[first]):.0f} %"
            ways = int(limit.design_points or 1)
            ways_text = f" in the likeliest of {ways} ways" if ways > 1 else ""
            whole = f"{share} of what its failures tell" if several else f"importance factor {share}{ways_text}"
            parts.append(f"Of the probability of {limit_name(name)}, which decides: {input_name(first)} ({whole}).")
    # the largest share alone: the next ones stand in the chapter
    load = shares_claim(contents.results, quantity).first
    return " ".join([*parts, f"Of the load alone: {load}"])


def _measure(entry: MeasureEntry) -> str:
    """Which input first, and how many specimens it takes."""
    claim, first = measure_claim("", entry), first_to_measure(entry)
    if claim is None or first is None:
        return claim.text if claim is not None else ""
    return f"{begin(first.input, claim.short)}: {claim.told[:1].lower()}{claim.told[1:]}"


def _measure_limit(contents: Contents, name: str) -> str:
    """What settles the target first, then which input is worth most."""
    limit, entry = contents.results.limits[name], contents.results.margins.get(name)
    text = tests_text(entry, limit, contents) if entry else settling_text(contents, limit)
    first = first_to_measure(limit.measure_first)
    if not text:
        return _measure(limit.measure_first)
    if first is not None and first.input != f"limits.{name}.strength":
        text += f"Of the laws, that of {input_name(first.input)} is worth most."
    return text.strip()


def _valid(contents: Contents) -> str:
    """Whether an assumption of the model is broken, as planned and at the answers, and which.

    How often, and what it does, stands in the cautions, and there alone.
    """
    grades = (("No: outside the model’s validity: ", grave(contents)), ("With warnings: ", warned(contents)))
    start, planned = next(((words, broken) for words, broken in grades if broken), ("", []))
    where: dict[str, list[str]] = {}
    if planned:
        where[listed([broken_words(c) for c in planned])] = ["as planned"]
    for name, broken in answer_breaches(contents):
        text = listed([broken_words(c) for c in broken])
        where.setdefault(text, []).append(f"at {answer_text(contents, name)}")
    if not where:
        return _unbroken(contents)
    plain = list(where.values()) == [["as planned"]]
    found = "; ".join(text if plain else f"{text}, {listed(places)}" for text, places in where.items())
    told = start + found if planned else f"{_unbroken(contents)} At the answers: {found}"
    return f"{told}. How often, and what that does to the answer, stands under “Before you rely on it”."


def _unbroken(contents: Contents) -> str:
    """That no assumption of the model is broken where the study stands, as far as that was checked."""
    unknown = [c for c in contents.results.validity if c.worst is None]
    if unknown:
        return f"As far as checked; not checked: {listed([check_name(c.check) for c in unknown])}."
    return f"Yes: all {len(contents.results.validity)} checks are passed in every sample."
