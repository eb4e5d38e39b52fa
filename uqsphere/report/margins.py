"""The answer to an inverse question in three lines: at most or at least how much, what it hangs on, what would help."""

from __future__ import annotations

import math
from dataclasses import replace

from uqsphere.quantities import format_value
from uqsphere.report.assumptions import beyond_bars, reach_note
from uqsphere.report.blocks import Table, Verdict, cell
from uqsphere.report.claims import Claim, answer_claim
from uqsphere.report.contents import Contents
from uqsphere.report.figures.canvas import shorten
from uqsphere.report.phrases import (
    answer_text,
    at_most,
    capital,
    event,
    input_name,
    limit_name,
    listed,
    number_text,
    plain_percent,
    probability_range,
    rounded,
    safe_side,
    two_digits,
    value_text,
)
from uqsphere.results import LimitEntry
from uqsphere.results.entries import Est
from uqsphere.results.margins import BarsEntry, FactorsEntry, MarginEntry


def margin_verdicts(contents: Contents) -> list[Verdict]:
    """One answer for every limit with a target of a study that asks for margins."""
    found: list[Verdict] = []
    said = ""
    for name in contents.results.margins:
        answer = answer_claim(contents.results, name)
        if answer is None:
            continue
        entry, limit = contents.results.margins[name], contents.results.limits[name]
        lines = (
            *_headed(answer, entry, contents),
            _reserve(contents, entry, limit),
            _lost(contents, entry, limit),
            _next(entry, limit, contents, said),
        )
        said = lines[-1]
        found.append(
            Verdict(
                word="answer",
                heading=f"{shorten(name, 60)}: {shorten(input_name(entry.solve), 60)}",
                lines=tuple(line for line in lines if line),
            )
        )
    if found:
        found[-1] = replace(found[-1], note=reach_note(contents))
    return found


def _headed(claim: Claim, entry: MarginEntry, contents: Contents) -> tuple[str, str]:
    """The answer, with what the bars stand if that lies below it, and the rest of what is claimed."""
    sure = entry.ignorance.sure
    told = entry.value if sure is None else entry.value.model_copy(update={"value": sure})
    beyond = beyond_bars(entry.model_copy(update={"value": told}), contents.subject(entry.solve))
    more = list(claim.more)
    if more and beyond is not None and sure is None:
        # the head has it already
        more[-1] = f"{claim.short} is the answer for elastic bars"
    head = claim.first.rstrip(".") + (f"; {beyond.clause}" if beyond is not None else "")
    return f"{head}.", capital("; ".join(more)) + "." if more else ""


def no_common_value(contents: Contents) -> str:
    """That no value of the free scalar meets the aims of all limits, or which do; empty with fewer than two aims."""
    most: list[tuple[float, str]] = []
    least: list[tuple[float, str]] = []
    for name, entry in contents.results.margins.items():
        limit, value = contents.results.limits[name], entry.value.value
        if value is not None and limit.target is not None:
            (most if at_most(entry, limit.aim) else least).append((float(value), name))
    if not most or not least:
        return ""
    top, bottom = min(most), max(least)
    ends = [answer_text(contents, name) for _, name in (top, bottom)]
    what = input_name(next(iter(contents.results.margins.values())).solve)
    names = limit_name(top[1]), limit_name(bottom[1])
    if bottom[0] <= top[0]:
        return f"From {ends[1]} to {ends[0]} the aims of {names[1]} and {names[0]} are both reached."
    return (
        f"No {what} reaches both aims: {names[0]} needs at most {ends[0]}, {names[1]} at least {ends[1]}; in between "
        "neither is reached."
    )


def reserve(contents: Contents, entry: MarginEntry, limit: LimitEntry) -> float | None:
    """Factor by which the free scalar may move before the target is reached; below 1 where it is missed."""
    here, value = contents.at_mean(entry.solve), entry.value.value
    if here is None or value is None or not (here > 0.0 and value > 0.0):
        return None
    return float(value / here if at_most(entry, limit.aim) else here / value)


def _reserve(contents: Contents, entry: MarginEntry, limit: LimitEntry) -> str:
    """How far the study stands from the answer."""
    factor = reserve(contents, entry, limit)
    here = contents.at_mean(entry.solve)
    if factor is None or here is None:
        return ""
    what, subject = input_name(entry.solve), contents.subject(entry.solve)
    most = at_most(entry, limit.aim)
    planned = f"The study stands at {value_text(here, subject)}"
    if factor < 1.0:
        way = "too high" if most else "too low"
        return f"{planned}: {way} by a factor of {up(1.0 / factor)} in {what}, a shortfall."
    opened = entry.ignorance.sure
    sure = None if opened is None else (opened / here if most else here / opened)
    text = f"{planned}: a reserve of {down(factor)} in {what}"
    if sure is not None:
        text += f", {down(sure)} to be sure" if sure >= 1.0 else ", none to be sure"
    return text + "."


def down(ratio: float) -> str:
    """A ratio in three digits, never more than it is."""
    return f"{math.floor(100.0 * ratio + 1e-9) / 100.0:.2f}" if ratio < 100.0 else f"{math.floor(ratio)}"


def up(ratio: float) -> str:
    """A ratio in three digits, never less than it is."""
    return f"{math.ceil(100.0 * ratio - 1e-9) / 100.0:.2f}" if ratio < 100.0 else f"{math.ceil(ratio)}"


def _lost(contents: Contents, entry: MarginEntry, limit: LimitEntry) -> str:
    """What the margin is lost to, how specimens scatter, and how far the value is known."""
    text = ""
    what = input_name(entry.solve)
    shares = entry.lost_to.shares
    target = limit.target or 0.0
    chance = plain_percent(target if limit.aim == "survive" else 1.0 - target)
    if shares:
        order = [n for n in sorted(shares, key=lambda n: -shares[n]) if shares[n] >= 0.02][:3]
        text = (
            f"Between half of the specimens and {chance}, the margin is lost to "
            + listed([f"{input_name(n)} ({100.0 * shares[n]:.0f} %)" for n in order])
            + ". "
        )
    split = entry.split
    if split.scatter is not None:
        text += (
            f"From specimen to specimen the {what} that breaks it scatters by {two_digits(split.scatter)}: that "
            f"is in the {chance} already, and no error of the answer. "
        )
    if split.ignorance is not None:
        text += f"Few tests leave the answer uncertain by {two_digits(split.ignorance)} (standard deviation)"
        if split.numerical is not None:
            text += f", the computation by {100.0 * split.numerical:.1g} %"
        text += ". "
    elif split.numerical is not None:
        text += (
            f"The computation leaves the answer uncertain by {100.0 * split.numerical:.1g} % (standard deviation); "
            "how well the law of the strength is known is not in that. "
        )
    return text.strip()


def _next(entry: MarginEntry, limit: LimitEntry, contents: Contents, said: str) -> str:
    """What more tests would bring, and what the bars allow where the answer before has not said it already."""
    text = tests_text(entry, limit, contents)
    bars = bars_text(entry.bars, entry, contents) if entry.bars else ""
    return (text + ("" if bars in said else bars)).strip()


def tests_text(entry: MarginEntry, limit: LimitEntry, contents: Contents) -> str:
    """How many tests settle whether the target is kept, then how many the value itself would take."""
    tests = entry.more_tests
    here = contents.at_mean(entry.solve)
    planned = "" if here is None else f" at the planned {value_text(here, contents.subject(entry.solve))}"
    text = ""
    if tests.to_settle == 0:
        word = "kept" if limit.met else "missed"
        text = f"The {tests.tests} tests settle with 95 % confidence that the target is {word}{planned}. "
    elif tests.to_settle:
        text = f"About {tests.to_settle} more tests of the strength, {tests.to_settle + tests.tests} in all, "
        text += f"would settle with 95 % confidence whether the target is kept{planned}. "
    elif tests.reason:
        text = f"Whether the target is kept{planned} is too close to call: {tests.reason.partition(':')[0]}. "
    if tests.to_know_the_value:
        text += (
            f"To know the {input_name(entry.solve)} itself to {plain_percent(tests.known_to)} (95 % half-width) "
            f"would take about {tests.to_know_the_value} more tests"
        )
        # counted as everywhere else on the page
        text += f", {tests.to_know_the_value + tests.tests} in all. " if tests.tests else ". "
    return text or settling_text(contents, limit, planned)


def settling_text(contents: Contents, limit: LimitEntry, planned: str = "") -> str:
    """How many tests of a strength that is given as a law would show that the target is kept."""
    settled = limit.tests_to_settle
    if not settled:
        return ""
    if settled.tests is None:
        return f"Whether the target is kept{planned} is too close to be settled by tests of the strength. "
    word = "kept or missed" if limit.met is None else "kept" if limit.met else "missed"
    return (
        f"If the assumed law of the strength is right, about {settled.tests} tests of it in all would show "
        f"with {plain_percent(settled.confidence)} confidence that the target is {word}{planned}. "
    )


#: what keeps a flat elastic under the sphere: theory section "Contacts that yield", (C1)
DUE = "harder bars, inserts, thinner bars or a shorter pulse would keep them elastic"


def bars_text(bars: BarsEntry, entry: MarginEntry, contents: Contents) -> str:
    """Where the bars stop being elastic, what comes first said first."""
    subject = contents.subject(entry.solve)
    strength = number_text(format_value(bars.yield_strength, "bars.yield_strength"))
    contact, value = bars.contact, None
    rising = entry.curve[-1][1] >= entry.curve[0][1]
    chance = plain_percent(bars.contact_probability)
    if contact and contact.value is not None:
        value = safe_side(contact, subject, at_most=rising, digits=3)
        text = f"The bars (yield strength {strength}) yield under the sphere in more than {chance} of the cases "
        text += f"{'from' if rising else 'below'} {value}"
        text += f" on: {DUE}" if beyond_bars(entry, subject) is not None else " on"
    elif bars.contact_everywhere == "yields":
        text = (
            f"The bars (yield strength {strength}) yield under the sphere in more than {chance} of the cases over the "
        )
        text += f"whole curve: {DUE}"
    elif bars.contact_everywhere == "elastic":
        text = f"The bars (yield strength {strength}) stay elastic under the sphere over the whole curve"
    else:
        text = f"Whether the bars (yield strength {strength}) yield under the sphere is not known"
    if bars.pulse_value is not None:
        return f"{text}; the pulse alone leaves them elastic up to {value_text(bars.pulse_value, subject, 3)}."
    return f"{text}; the pulse as planned {'leaves them elastic' if bars.pulse_elastic else 'makes them yield'}."


# --- What a margin is made of, as a table: safety factors, partial factors, scatter, ignorance, error, and the bars.


def parts_finding(contents: Contents, name: str) -> str:
    """How far the value lies from the median of fracture, and to whom that is owed."""
    entry = contents.results.margins[name]
    value, fitted = entry.value, entry.lognormal
    middle = entry.values.get("0.5", Est()).value or fitted.median.value
    shares = entry.lost_to.shares
    if not value.value or not middle or not shares:
        return ""
    subject = contents.subject(entry.solve)
    factor = middle / value.value
    if not factor > 0.0:
        # a scalar of either sign has no factors
        return ""
    lost = listed([
        f"{math.exp(share * math.log(factor)):.2f} ({input_name(n)})"
        for n, share in sorted(shares.items(), key=lambda item: -item[1])
        if abs(math.exp(share * math.log(factor)) - 1.0) >= 0.005
    ])  # fmt: skip
    return (
        f"Half of the specimens of {limit_name(name)} break at {value_text(middle, subject)}; between that and "
        f"{answer_text(contents, name)} lies a factor of {factor:.2f}, made up of {lost}."
    )


def _factor(limit: LimitEntry) -> str:
    """What strength over demand is called: safe above 1 where the sphere is to survive, short where it is to break."""
    return "safety factor" if limit.aim == "survive" else "strength over demand (above 1: short of breaking)"


def _likeliest(limit: LimitEntry) -> str:
    return "failure" if limit.aim == "survive" else "survival"


def parts_table(contents: Contents, name: str) -> Table | None:
    """Everything that is known of a margin beside its curve; None for a folder of an earlier version."""
    entry, limit = contents.results.margins[name], contents.results.limits[name]
    if "factors" not in entry.model_fields_set:
        return None
    subject = contents.subject(entry.solve)
    rows: list[tuple[str, str]] = []
    factor = reserve(contents, entry, limit)
    if factor is not None:
        word = "reserve" if factor >= 1.0 else "shortfall (reserve below 1)"
        told = down(factor) if factor >= 1.0 else f"{factor:.3g}"
        rows.append((f"{word} in {input_name(entry.solve)}: the answer against the planned value", told))
    factors = entry.factors
    if factors.medians:
        of = factors.fractiles_of
        rows += [
            (
                f"{_factor(limit)} as planned: median strength over median demand",
                _ranged(contents, name, factors.medians, 0.5),
            ),
            (
                f"{_factor(limit)} as planned: {plain_percent(of.strength)} fractile of the strength over "
                f"{plain_percent(of.demand)} fractile of the demand (each by itself, without their dependence)",
                _ranged(contents, name, factors.fractiles, of.demand),
            ),
        ]
    rows += _partial_rows(entry, limit)
    split = entry.split
    for spread, words in (
        (split.scatter, "scatter from specimen to specimen, in the probability already"),
        (split.ignorance, "uncertainty of the answer from few tests"),
        (split.numerical, "uncertainty of the answer from computing"),
    ):
        if spread is not None:
            rows.append((f"{words} (standard deviation of its logarithm)", number_text(f"{spread:#.2g}")))
    opened = entry.ignorance
    if opened.laws:
        ends = [_three(end, subject) if end is not None else "beyond the range" for end in (opened.low, opened.high)]
        rows.append((f"{input_name(entry.solve)} that the tests leave open (95 %)", " to ".join(ends)))
        if opened.mean_law is not None:
            rows.append(
                (
                    f"{input_name(entry.solve)} with the mean over all laws that the tests allow",
                    _three(opened.mean_law, subject),
                )
            )
    standing = limit.ignorance
    if standing.known:
        rows.append(("probability of missing the aim that the tests leave open", probability_range(*standing.miss)))
    at = f"{event(contents.results, name)} with a probability of {plain_percent(entry.probability or 0.0)}"
    caption = f"Margin of {limit_name(name)}; the answer is where {at}"
    note = (
        "Partial factors have no interval: they are where a search for the likeliest fracture ended. Standard "
        "deviations and what the tests leave open are uncertainties themselves."
    )
    note += _two_medians(limit, factors)
    return Table(caption=caption, header=("", "value"), rows=tuple(rows), note=note) if rows else None


def _partial_rows(entry: MarginEntry, limit: LimitEntry) -> list[tuple[str, str]]:
    """The partial factors at the answer."""
    rows = []
    for key, part in entry.lost_to.partial.items():
        strength = key.endswith(".strength")
        own = limit.quantity if strength else key
        fractile = "5 %" if limit.aim == "survive" else "95 %"
        what = (
            f"its {fractile} fractile over its value at the likeliest {_likeliest(limit)}"
            if strength
            else f"its value at the likeliest {_likeliest(limit)} over its median"
        )
        values = (part.characteristic, part.design) if strength else (part.design, part.characteristic)
        text = f"{part.factor:.3f} ({value_text(values[0], own)} over {value_text(values[1], own)})"
        rows.append((f"at the answer, partial factor of {input_name(key)}: {what}", text))
    return rows


def _two_medians(limit: LimitEntry, factors: FactorsEntry) -> str:
    """Why the median margin is another number than the safety factor on medians; empty where both read the same."""
    median = limit.margin["median"]
    if median.value is None or not factors.medians:
        return ""
    # in as many digits as the margin is known to
    off = factors.medians - median.value
    moved = Est.of(*(None if end is None else end + off for end in (median.value, median.low, median.high)))
    margin, medians = rounded(median), rounded(moved)
    if margin == medians:
        return ""
    return (
        f" The median margin, {margin}, is the middle of strength over demand taken case by case; {medians} is the "
        "middle strength over the middle demand. The two part where a law is skewed, or where strength and demand "
        "depend on each other."
    )


def _three(value: float, subject: str) -> str:
    """A value of which three digits count, with the zeros among them."""
    return rounded(Est.of(value), subject, 3)


def _ranged(contents: Contents, name: str, factor: float, fractile: float) -> str:
    """A safety factor with the relative interval of the demand under it; the strength over it is exact by its law."""
    limit = contents.resolved.limits[name]
    quantity = contents.results.quantities.get(limit.quantity)
    demand = quantity.quantiles.get(f"{fractile:g}", Est()) if quantity is not None else Est()
    if limit.model_factor != 1.0 or not demand.value or not demand.low or not demand.high:
        return f"{factor:.3g} (no interval: the demand has none of its own)"
    low, high = sorted((factor * demand.value / demand.high, factor * demand.value / demand.low))
    return cell(Est.of(factor, low, high))
