"""The answers of a run for the terminal: a table of what was asked, and what to be cautious about."""

from __future__ import annotations

import re
from typing import Final

from uqsphere.console import bar, plain, screen_width, table, wrap, writable
from uqsphere.quantities import format_value, reading_units
from uqsphere.report.assumptions import answer_checks, instead_text, turns, verdict_word
from uqsphere.report.claims import claims, first_to_measure, specimens
from uqsphere.report.contents import subject_of, units_of
from uqsphere.report.phrases import (
    MOST_DIGITS,
    SUBJECTS,
    at_most,
    estimate_text,
    failures_text,
    loud,
    plain_percent,
    probability_range,
    probability_text,
    rounded,
    safe_side,
    shortfalls,
    without_failed,
)
from uqsphere.results import FractureEntry, Results
from uqsphere.results.entries import Est

#: inputs of a quantity or limit that get a line
_MOST: Final = 6
#: sentences about accuracies that were not reached
_NAMED: Final = 24
#: tests of an input from which on what they leave open of a quantity is told on the page alone
_FEW_TESTS: Final = 10
#: columns of a bar, and decimals of the indices beside it: the first that fits the screen is taken
_SHAPES: Final = ((20, MOST_DIGITS), (20, 4), (12, 4), (8, 4), (8, 3))


def _estimate(entry: Est, name: str = "") -> str:
    """As the page has it, with the reason where there is no answer."""
    return estimate_text(entry, name) if entry.value is not None else _absent(entry)


def _chance(entry: Est) -> str:
    return probability_text(entry) if entry.value is not None else _absent(entry)


def _absent(entry: Est) -> str:
    return f"- ({entry.reason or 'not known'})"


def _cautions(results: Results) -> list[str]:
    """What weakens the answers, as the report says it at length."""
    found = []
    if results.model.failures:
        failed, whole = results.model.failures, sum(results.model.evaluations.values())
        share = plain_percent(float(f"{failed / max(whole, 1):.2g}"))
        found.append(f"{failures_text(failed)}, {share} of all: {plain(without_failed(results))}")
    for check in results.validity:
        if check.share_failure or check.share_warning:
            found.append(f"{'failure' if check.share_failure else 'warning'}: {plain(check.text)}")
    for name, limit in results.limits.items():
        opened = limit.ignorance
        if opened.known:
            tests = ", ".join(f"{plain(entry.input)}: {entry.tests}" for entry in opened.fitted)
            undecided = limit.target is not None and opened.met is None
            also = ", on both sides of the target" if undecided else ""
            found.append(
                f"limit {plain(name)}: over the laws that the tests allow ({tests}) the probability of missing it lies "
                f"between {probability_range(*opened.miss).replace(' to ', ' and ')}{also}"
            )
    found += [*_left_open(results), *_assumed(results), *_answer_checks(results)]
    missed = results.accuracy.missed
    if len(missed) > 1:
        found.append(f"{len(missed)} accuracies were not reached:")
    sentences = shortfalls(missed, SUBJECTS)
    found += [f"not reached: {plain(text)}" for text in sentences[:_NAMED]]
    if len(sentences) > _NAMED:
        found.append("not reached: more, which the report names")
    return found


def _left_open(results: Results) -> list[str]:
    """What few tests of the inputs leave open of the quantities, which their intervals do not hold."""
    found = []
    for name, entry in results.quantities.items():
        opened = entry.ignorance
        if not opened or min(source.tests for source in opened.fitted) >= _FEW_TESTS:
            continue
        tests = ", ".join(f"{plain(source.input)}: {source.tests}" for source in opened.fitted)
        if opened.reason is not None:
            text = f"is not in its intervals: {opened.reason}"
        else:
            low, high = (plain(format_value(end, name, 3)) for end in opened.mean)
            text = f"puts its mean between {low} and {high}"
        found.append(f"{plain(name)}: what the tests leave open ({tests}) {text}")
    return found


def _assumed(results: Results) -> list[str]:
    """What the probability of each limit would be without what is assumed of its strength."""
    found = []
    for name, limit in results.limits.items():
        for row in limit.assumed or ():
            if row.miss.value is None:
                continue
            if row.assumption == "dependence" or turns(limit, row):
                word = f": target {verdict_word(row.met)}" if limit.target is not None else ""
                found.append(
                    f"limit {plain(name)}: {plain(instead_text(row))} the probability of missing it would be "
                    f"{plain_percent(row.miss.value)}{word}"
                )
    return found


def _answer(results: Results, name: str) -> str:
    """The answer of an inverse question, rounded to the safe side as everywhere."""
    entry = results.margins[name]
    most = at_most(entry, results.limits[name].aim)
    return safe_side(entry.value, subject_of(results, entry.solve), at_most=most)


def _answer_checks(results: Results) -> list[str]:
    """Where the model does not hold at the answers of inverse questions."""
    return [
        f"at the answer for {plain(name)}, {entry.solve} {_answer(results, name)}: {plain(check.text)}"
        for name, entry in results.margins.items()
        for check in answer_checks(entry)
        if check.check.startswith("bar_yield") and check.share > 0.0
    ]


def _fracture_rows(found: FractureEntry) -> list[tuple[str, ...]]:
    """Probability of fracture, which limit comes first, and the median state in which it comes."""
    if not found:
        return []
    rows: list[tuple[str, ...]] = [("probability over the record", _chance(found.union))]
    if found.first_loading:
        rows.append(("probability in the first loading", _chance(found.first_loading)))
    if len(found.limits) > 1:
        rows += [(f"share in which {plain(n)} comes first", _chance(e)) for n, e in found.governed_by.items()]
    states = found.states()
    for key, words, like in (
        ("time", "median time", "contact_time"),
        ("energy", "median energy in the contacts", "energy"),
        ("imbalance", "median difference of the forces", "force_imbalance"),
        ("t10", "median product fineness t10", "t10"),
    ):
        if key in states:
            rows.append((words if key == "t10" else f"{words} at fracture", _estimate(states[key].median, like)))
    if found.reason:
        rows.append(("not known further", plain(found.reason)))
    return rows


def _verdicts(results: Results, width: int) -> list[str]:
    """A line for every limit: the verdict in words first, then probability, target and margin."""
    texts: list[str] = []
    # the interval of the margin stands there where there is room for it
    for said, limited in ((estimate_text, None), (rounded, width)):
        rows = []
        for name, limit in results.limits.items():
            verdict = loud(limit.word)
            target = plain_percent(limit.target) if limit.target is not None else "-"
            margin = limit.margin["median"]
            shown = "-" if margin.value is None else said(margin)
            rows.append((verdict, name, limit.aim, _chance(limit.miss), target, shown))
        header = ("verdict", "limit", "aim", "probability of a miss (95 %)", "target", "median margin")
        texts = [table(header, rows, limited)] if rows else []
        if max((len(line) for text in texts for line in text.split("\n")), default=0) <= width:
            break
    texts += [
        wrap(f"no margin of {name}: {limit.margin['median'].reason or 'not known'}", width)
        for name, limit in results.limits.items()
        if limit.margin["median"].value is None
    ]
    texts += [
        wrap(plain(f"{name}, {limit.word}: {reason.text}"), width)
        for name, limit in results.limits.items()
        for reason in limit.reasons
    ]
    return [*texts, "", *_ways(results, width)] if texts else []


def _ways(results: Results, width: int) -> list[str]:
    """The ways to break that were judged beside the limits of the study, and those that could not be."""
    rows: list[tuple[str, ...] | str] = []
    texts: dict[str, None] = {}
    for entry in results.verdicts:
        assumed = [one for one in entry.judged if one.assumed]
        if assumed:
            rows.append(f"to {entry.aim}")
        for one in assumed:
            answer = "-" if one.answer is None else format_value(one.answer, subject_of(results, entry.solve), 3)
            ends = "-" if one.range is None else probability_range(*one.range)
            chance = plain_percent(float(f"{one.miss.value or 0.0:.2g}"))
            rows.append((one.name, chance, ends, *((answer,) if entry.solve else ())))
        for called, why in entry.not_judged.items():
            texts[wrap(f"not judged: {called}: {why}", width)] = None
    at = next((entry.solve for entry in results.verdicts if entry.solve), "")
    header = ("strength assumed", "probability of a miss", "over its range (95 %)", *((f"at {at}",) if at else ()))
    found = [*([table(header, rows, width)] if rows else []), *texts]
    return [*found, ""] if found else []


def _carried(results: Results, width: int) -> list[str]:
    """What strengths measured elsewhere answer by each carrier, and which of them is on the safe side."""
    rows: list[tuple[str, ...] | str] = []
    for name, limit in results.limits.items():
        carried = limit.carried
        if not carried:
            continue
        rows.append(f"limit {name}, {carried.solve or 'probability of a miss'}")
        safe = carried.safe(limit.aim)
        for carrier, entry in carried.by_carrier().items():
            text = _estimate(entry, subject_of(results, carried.solve)) if carried.solve else _chance(entry)
            rows.append((f"by {carrier}", text, f"the safe end, to {limit.aim}" if carrier == safe else ""))
    return [table(("carried from the tests", "value (95 % interval)", ""), rows, width), ""] if rows else []


def _also(results: Results, width: int) -> list[str]:
    """The answers of inverse questions in other numbers: a drop as a speed, and what the blow offers."""
    texts = []
    for name, entry in results.margins.items():
        other = [f"{plain(path)} {_estimate(number, path)}" for path, number in entry.also.items()]
        if other:
            texts.append(wrap(f"the answer for {plain(name)} in other numbers: {'; '.join(other)}", width))
    return [*texts, ""] if texts else []


def _first_reason(texts: list[str]) -> str:
    return next((text for text in texts if text), "")


def _governing(results: Results, width: int) -> list[str]:
    """What each limit hangs on, and what to measure first."""
    rows: list[tuple[str, ...] | str] = []
    advice = []
    for name, limit in results.limits.items():
        shares = limit.governing_inputs or {}
        ways = limit.design_points or 1
        one = f", the likeliest of {ways} ways" if ways > 1 else ""
        rows += [f"limit {name}{one}"] if shares else []
        for key in sorted(shares, key=lambda key: -shares[key])[:_MOST]:
            rows.append((key, f"{shares[key]:6.1%}".replace("%", " %"), bar(shares[key])))
        measured = limit.measure_first
        first = first_to_measure(measured)
        if first is not None:
            tests, known = specimens(measured, first) or 0, plain_percent(measured.wanted)
            side = " to the contrary" if (measured.probability or 0.0) > 0.5 else ""
            count = f"{tests:,} test{'' if tests == 1 else 's'} in all to know the probability{side} to {known}"
            advice.append(wrap(f"to measure first for {name}: {first.input} ({count})", width))
        elif measured.rows:
            why = "the mean of none moves the probability by more than chance would show"
            advice.append(wrap(f"to measure first for {name}: no input ({why})", width))
    parts = [table(("hangs on", " share", ""), rows, width)] if rows else []
    return [*parts, *advice, ""] if parts or advice else []


def _drivers(results: Results, width: int) -> list[str]:
    """Shares of the variance as bars, the largest first; Shapley effects where inputs depend on each other."""
    texts: list[str] = []
    for length, decimals in _SHAPES:
        texts = _driver_tables(results, length, decimals, None)
        if max((len(line) for text in texts for line in text.split("\n")), default=0) <= width:
            break
    else:
        texts = _driver_tables(results, *_SHAPES[-1], width)
    absent = []
    for quantity, entry in results.sensitivity.items():
        order = entry.shapley or entry.total
        if not any(e.value is not None for e in order.values()):
            reason = _first_reason([str(e.reason or "") for e in order.values()])
            if reason:
                absent.append(wrap(f"{quantity}: what drives it is not known ({plain(reason)})", width))
    return [*texts, *absent, *([""] if absent else [])]


def _driver_tables(results: Results, length: int, decimals: int, width: int | None) -> list[str]:
    """One table of indices for all quantities, with bars of so many columns."""
    rows: list[tuple[str, ...] | str] = []
    kinds = set()
    for quantity, entry in results.sensitivity.items():
        shared = entry.shapley
        order = shared or entry.total
        known = sorted((n for n in order if order[n].value is not None), key=lambda n: -order[n].number)
        if not known:
            continue
        kinds.add("Shapley effect" if shared else "total index")
        rows.append(quantity)
        for name in known[:_MOST]:
            total = _index(order[name], decimals)
            first = "-" if shared else _index(entry.first[name], decimals)
            rows.append((name, bar(order[name].number, length), total, first))
        if len(known) > _MOST:
            rest = len(known) - _MOST
            rows.append(
                (
                    f"{rest} {'other' if rest == 1 else 'others'}",
                    "",
                    f"at most {_index(order[known[_MOST]], decimals)}",
                    "",
                )
            )
    if not rows:
        return []
    if kinds == {"Shapley effect"}:
        rows = [row if isinstance(row, str) else row[:3] for row in rows]
    header = ("variance from", "", " or ".join(sorted(kinds, reverse=True)), "first-order index")
    return [table(header[: 3 if kinds == {"Shapley effect"} else 4], rows, width), ""]


def _over_energy(results: Results, width: int) -> list[str]:
    """The curves over the specific energy: values, median and dispersion, or why there are none."""
    rows: list[tuple[str, ...] | str] = []
    for name, entry in results.margins.items():
        found = entry.against
        if not found:
            continue
        rows.append(name)
        if found.reason:
            rows.append(("", f"none ({found.reason})"))
        rows += [(plain_percent(float(p)), _estimate(e, found.quantity)) for p, e in found.values.items()]
        fitted = found.lognormal
        if fitted.median:
            rows.append(("median of the lognormal curve", _estimate(fitted.median, found.quantity)))
            rows.append(("dispersion", _estimate(fitted.dispersion)))
    return [table(("probability of exceedance", "at specific energy"), rows, width), ""] if rows else []


def _index(entry: Est, decimals: int) -> str:
    """As the page has it, in at most so many decimals; nobody reads more of a share."""
    if entry.value is None:
        return _absent(entry)
    text = estimate_text(entry)
    if len(max(re.findall(r"\.(\d+)", text), key=len, default="")) <= decimals and "×" not in text:
        return text
    known = [number for number in (entry.value, entry.low, entry.high) if number is not None]
    numbers = [f"{round(number, decimals) + 0.0:.{decimals}f}".replace("-", "−") for number in known]
    return numbers[0] if len(set(numbers)) == 1 else f"{numbers[0]} ({numbers[1]} to {numbers[2]})"


def summary_of(results: Results, width: int | None = None) -> str:
    """The answers of a run for the terminal: verdicts, what they hang on, quantities, drivers, margins, cautions; then
    those of every service.

    No line is longer than `width` columns (those of the terminal where it is None); numbers and units are those of
    the page.
    """
    texts = []
    for part in results.parts.values():
        with reading_units(units_of(part)):
            texts.append(writable("\n".join(_parts(part, screen_width() if width is None else width))))
    return "\n\n".join(texts)


def _parts(results: Results, width: int) -> list[str]:
    answers = [wrap(claim.text, width) for claim in claims(results) if claim.topic == "answer"]
    parts = [wrap(results.study.title, width, ""), "", *answers, *([""] if answers else [])]
    parts += [
        *_verdicts(results, width),
        *_also(results, width),
        *_carried(results, width),
        *_governing(results, width),
    ]
    broken = _fracture_rows(results.fracture)
    if broken:
        parts += [table(("fracture", "value (95 % interval)"), broken, width), ""]
    parts += [*_quantities(results, width), *_drivers(results, width)]
    parts += _margins(results, width)
    parts += _over_energy(results, width)
    cautions = _cautions(results)
    if cautions:
        parts += ["before you rely on it:", *(wrap(f"- {text}", width) for text in cautions), ""]
    model = results.model
    counts = ", ".join(f"{number:,} {name}" for name, number in model.evaluations.items())
    last = [
        f"model: {model.chosen} ({model.why})",
        *(f"{label}: {text}" for label, text in model.savings()),
        f"evaluations: {counts}; failed: {model.failures:,}",
    ]
    return [*parts, *(wrap(text, width) for text in last)]


def _quantities(results: Results, width: int) -> list[str]:
    """Mean, spread and quantiles of what was asked for."""
    rows: list[tuple[str, ...] | str] = []
    for name, entry in results.quantities.items():
        rows += [name, ("mean", _estimate(entry.mean, name)), ("standard deviation", _estimate(entry.sd, name))]
        rows += [(f"{100 * float(p):.12g} % quantile", _estimate(e, name)) for p, e in entry.quantiles.items()]
        if entry.censored_share.value:
            rows.append(("censored share", _chance(entry.censored_share)))
    return [table(("quantity", "value (95 % interval)"), rows, width), ""]


def _margins(results: Results, width: int) -> list[str]:
    """The free scalar at every probability of fracture that was asked for."""
    rows: list[tuple[str, ...] | str] = []
    for name, entry in results.margins.items():
        rows += [name] if len(results.margins) > 1 and entry.values else []
        subject = subject_of(results, entry.solve)
        rows += [(plain_percent(float(p)), _estimate(e, subject)) for p, e in entry.values.items()]
    if not rows:
        return []
    names, solve = list(results.margins), next(iter(results.margins.values())).solve
    of = f" of {names[0]}" if len(names) == 1 else ""
    return [table((f"probability of exceedance{of}", f"at {solve}"), rows, width), ""]
