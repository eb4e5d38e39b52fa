"""Tables and sentences on what drives failure, on indices beyond variance, and on what to measure first."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from uqsphere.report.blocks import Table, cell, index_cell, thousands
from uqsphere.report.claims import _side, specimens
from uqsphere.report.contents import Contents
from uqsphere.report.phrases import (
    ABSENT,
    absent_reason,
    capital,
    input_name,
    limit_name,
    listed,
    number_text,
    powers,
    symbol,
    two_digits,
    value_text,
)
from uqsphere.results import IndexEntry, LimitEntry, MeasureEntry, SharesEntry
from uqsphere.results.entries import Est, Ests

if TYPE_CHECKING:
    pass


def _by_value(table: Ests) -> list[str]:
    return sorted(table, key=lambda name: -float(table[name].value or 0.0))


def _known(table: Ests | None) -> list[str]:
    """Names with a value, the largest first."""
    return [name for name in _by_value(table or {}) if (table or {})[name].value is not None]


# --- quantities -----------------------------------------------------------------------------------------


def _shared_rows(entry: SharesEntry) -> tuple[tuple[str, ...], ...]:
    both = entry.kucherenko
    return tuple(
        (
            input_name(n),
            index_cell(entry.shapley[n]),
            index_cell(both.first.get(n)),
            index_cell(both.total.get(n)),
        )
        for n in _by_value(entry.shapley)
    )


_SHARED = ("input", "Shapley effect", "Kucherenko, first", "Kucherenko, total")


def shapley_table(contents: Contents, quantity: str) -> Table | None:
    """Shapley effects and Kucherenko's indices, where inputs depend on each other."""
    entry = contents.results.sensitivity.get(quantity, IndexEntry())
    if not entry.shapley:
        return None
    return Table(
        caption=f"Shares of dependent inputs in the variance of {symbol(quantity)}, with 95 % intervals",
        header=_SHARED,
        rows=_shared_rows(entry),
    )


def distances_table(contents: Contents, quantity: str) -> Table | None:
    """Borgonovo's delta and PAWN."""
    entry = contents.results.sensitivity.get(quantity, IndexEntry())
    delta, pawn = entry.delta, entry.pawn
    names = _known(delta)
    if not names:
        return None
    threshold = entry.pawn_threshold
    idle = "" if threshold is None else f"; without any effect PAWN stays below {number_text(f'{threshold:.2g}')}"
    return Table(
        caption=f"How far an input moves the whole law of {symbol(quantity)}{idle}",
        header=("input", "Borgonovo’s δ", "PAWN"),
        rows=tuple((input_name(n), index_cell(delta[n]), index_cell(pawn.get(n))) for n in names),
    )


def distances_finding(contents: Contents, quantity: str) -> str:
    """Which input moves the whole law of a quantity most; empty where that is not known."""
    delta = contents.results.sensitivity.get(quantity, IndexEntry()).delta
    names = _known(delta)
    if not names:
        return ""
    words = capital(input_name(names[0])) if names[0] != input_name(names[0]) else names[0]
    return f"{words} moves the whole law of {symbol(quantity)} most: Borgonovo’s δ is {index_cell(delta[names[0]])}."


# --- failure --------------------------------------------------------------------------------------------


def failure_table(contents: Contents, name: str) -> Table | None:
    """Indices of missing the aim of a limit."""
    entry = contents.results.limits[name].drivers
    if not entry:
        return None
    caption = f"Indices of {entry.of}, {limit_name(name)}, with 95 % intervals"
    if entry.shapley:
        return Table(caption=caption, header=_SHARED, rows=_shared_rows(entry))
    names = _known(entry.total)
    if not names:
        return None
    rows = tuple((input_name(n), index_cell(entry.first.get(n)), index_cell(entry.total[n])) for n in names)
    return Table(caption=caption, header=("input", "first (alone)", "total (with interactions)"), rows=rows)


def told_from_none(estimate: Est) -> bool:
    """Whether an index is above zero by more than its interval."""
    return estimate.low is None or float(estimate.low) > 0.0


def failure_finding(contents: Contents, name: str) -> str:
    """Which input drives failure, or why that is not known."""
    entry = contents.results.limits[name].drivers
    table = entry.shapley or entry.total or {}
    names = _known(table)
    if not names:
        reason = next((absent_reason(e) for e in table.values()), "nothing was computed")
        return f"What drives missing the aim is not known: {reason}."
    kind = "Shapley effect" if entry.shapley else "total index"
    largest = f"{input_name(names[0])} ({kind} {index_cell(table[names[0]])})"
    whole = entry.of == "missing the aim"
    text = f"What drives it most: {largest}." if whole else f"Of the model’s inputs, what moves it most: {largest}."
    if not told_from_none(table[names[0]]):
        text = f"No input is told from one that does nothing; the largest index is that of {largest}."
    explained = entry.explained.value
    if explained is None or explained >= 0.9999:
        return text
    who = "The model’s inputs" if whole else "All of them"
    share = two_digits(explained)
    return f"{text} {who} together decide {share} of whether the aim is missed, the rest is left to the strength."


def given_failure_table(contents: Contents, name: str) -> Table | None:
    """Inputs where the aim is missed, beside their laws."""
    entry = (contents.results.limits[name].drivers).given_failure or {}
    rows = []
    for variable, found in entry.items():
        if found.mean.value is None:
            continue
        subject = contents.subject(variable)
        law = found.law
        rows.append(
            (
                input_name(variable),
                # four digits: with more the table is wider than the page
                cell(found.mean, subject, digits=4),
                cell(found.quantiles["0.05"], subject, digits=4),
                cell(found.quantiles["0.95"], subject, digits=4),
                value_text(law.mean, subject),
                _range(law.quantiles["0.05"], law.quantiles["0.95"], subject),
            )
        )
    if not rows:
        return None
    return Table(
        caption=f"The inputs where the aim of {limit_name(name)} is missed, with 95 % intervals",
        header=("input", "mean there", "5 % there", "95 % there", "mean of the law", "5 to 95 % of the law"),
        rows=tuple(rows),
        note="What belongs to the law is exact.",
    )


def _range(low: float, high: float, subject: str) -> str:
    return f"{value_text(low, subject)} to {value_text(high, subject)}"


# --- what to measure first ------------------------------------------------------------------------------


def measure_table(entry: MeasureEntry | None, caption: str) -> Table | None:
    """Inputs by what knowing them better is worth, with the number of specimens."""
    if not entry or not entry.rows:
        return None
    probability = entry.of == "probability"
    rows: list[tuple[str, ...]] = []
    # one power of ten for the whole column
    largest = max((abs(row.sway.value or 0.0) for row in entry.rows), default=0.0) if probability else 0.0
    power = math.floor(math.log10(largest)) if 0.0 < largest < 0.1 else 0
    for row in entry.rows:
        seen = row.observations
        count = specimens(entry, row)
        tests = (thousands(count) if count else "none") + ("" if seen is None else f" (the law rests on {seen})")
        if probability:
            rows.append(
                (
                    input_name(row.input),
                    cell(_scaled(row.sway, 10.0**-power)),
                    two_digits(row.part),
                    tests,
                )
            )
        else:
            rows.append((input_name(row.input), index_cell(row.effect), tests))
    wanted = f"{100.0 * entry.wanted:g} %"
    if probability:
        header: tuple[str, ...] = (
            "input",
            "change of the probability per standard deviation"
            + (f" [{powers(f'1e{power}').removeprefix('1 × ')}]" if power else ""),
            "share in its uncertainty",
            f"tests in all until its error moves {_side(entry)} by {wanted} of its value",
        )
    else:
        header = ("input", "share of the variance", f"tests in all until {wanted} of today’s variance is left to it")
    note = (
        "Shares and numbers of tests rise with the square of the change, and have twice its relative interval."
        if probability
        else "Numbers of tests rise with the share, and have its relative interval."
    )
    return Table(caption=caption, header=header, rows=tuple(rows), note=note)


def _scaled(estimate: Est, factor: float) -> Est:
    """An estimate times a number."""
    return Est.of(*(None if end is None else factor * end for end in (estimate.value, estimate.low, estimate.high)))


def design_table(contents: Contents, name: str) -> Table | None:
    """The design point of a limit: the likeliest values at which its aim is missed; None where there is none."""
    limit = contents.results.limits[name]
    point = limit.design_point
    if not point:
        return None
    shares = limit.governing_inputs or {}
    rows = []
    for key in sorted(point, key=lambda k: -float(shares.get(k, 0.0))):
        share = two_digits(float(shares[key])) if key in shares else ABSENT
        mean = contents.results.inputs[key].mean if key in contents.results.inputs else None
        subject = contents.subject(key)
        usual = ABSENT if mean is None else value_text(mean, subject)
        rows.append((input_name(key), value_text(point[key], subject), usual, share))
    return Table(
        caption=f"Design point of {limit_name(name)}",
        header=("input", "value there", "mean", "importance factor"),
        rows=tuple(rows),
        note="No intervals: the point is where a search ended, not an estimate from samples; the means are exact.",
    )


def mostly_missed(limit: LimitEntry) -> bool:
    """Whether the aim of a limit is missed in more than half of the cases."""
    return bool((limit.miss.value or 0.0) > 0.5)


def design_finding(contents: Contents, name: str) -> str:
    """What the search for the design point found, in sentences."""
    limit = contents.results.limits[name]
    reason = limit.design_point_reason
    if not limit.design_point:
        return f"No design point: {reason}." if reason else ""
    # where most samples miss the aim the point lies on the way to those that keep it
    which = "keep" if mostly_missed(limit) else "miss"
    text = f"Of all combinations of inputs that {which} the aim this is the likeliest; factors are its squared "
    text += "direction cosines in standard normal space."
    if (limit.design_points or 0) > 1:
        text += f" {limit.design_points} such points were found, of which this is the nearest."
    return text


# --- Which way an input works on the load and on breakage, said where the two differ.

#: an interval of an index that is narrower shows as a line
_VISIBLE: Final = 0.004


def tied_inputs(contents: Contents, limit: str) -> list[tuple[str, float | None]]:
    """Inputs that the strength of a limit depends on, with their rank correlation where it is one number."""
    own = f"limits.{limit}.strength"
    found = []
    for group in contents.resolved.dependence:
        if own in group.of:
            rank = group.spearman if group.spearman is not None else group.kendall
            found += [(name, rank) for name in group.of if name != own]
    return found


def measure_remarks(contents: Contents, name: str, kind: str) -> tuple[str, ...]:
    """That a change of an input is told with the strength left where it was; none where they are independent."""
    names = [n for n, _ in tied_inputs(contents, name)] if kind == "limits" else []
    if not names:
        return ()
    return (
        f"The change owed to {listed([input_name(n) for n in names])} is that of a mean known better, with the "
        "strength of every specimen left where it was: it shows the way of the load. That the strength goes with it "
        "from specimen to specimen, which decides at which end of it the spheres break, is not in that number.",
    )


def drivers_remark(contents: Contents) -> str:
    """How to read the chapter of what drives it."""
    violin = " A violin shows where an index is likely to lie, the whisker its 95 % interval."
    return (
        f"{_three_questions(contents)} The first index is the share of the variance that an input causes alone, the "
        "total one includes its interactions." + (violin if _bulges(contents) else "")
    ).strip()


def _bulges(contents: Contents) -> bool:
    """Whether a figure of indices has a violin that can be seen."""
    return any(
        not entry.shapley and any(_wide(e) for e in (*entry.first.values(), *entry.total.values()))
        for entry in contents.results.sensitivity.values()
    )


def _wide(estimate: Est) -> bool:
    low, high = estimate.low, estimate.high
    return estimate.value is not None and low is not None and high is not None and high - low > _VISIBLE


def _three_questions(contents: Contents) -> str:
    """Which question the shares of an input answer, and where the strength stands in each; empty without limits."""
    limits = contents.results.limits
    if not limits or not any(f"limits.{name}.strength" in contents.resolved.random for name in limits):
        return ""
    names = listed([limit_name(name, 30) for name in limits])
    return (
        "Shares answer three different questions. Of the load (the quantity itself): the strength has no part in it. "
        f"Of the probability as planned ({names}): the strength counts as an input, by importance factors at the "
        "likeliest failure, or, with indices of the model’s inputs, is averaged over and has no share. Of the margin: "
        "the same factors as of the probability, but at the value that the target allows and not as planned."
    )
