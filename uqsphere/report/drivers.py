"""Tables on what drives quantities and failure, on indices beyond variance, and on what to measure first."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from uqsphere.report.blocks import Table, cell, index_cell, thousands
from uqsphere.report.contents import Contents
from uqsphere.report.figures.canvas import shorten
from uqsphere.report.phrases import ABSENT, input_name, limit_name, number_text, powers, symbol, two_digits, value_text
from uqsphere.results import IndexEntry, MeasureEntry, MeasureRow, SharesEntry
from uqsphere.results.entries import Est, Ests

_ALONE = ("input", "first (alone)", "total (with interactions)")


def _largest_first(table: Ests | None) -> list[str]:
    """Names with a value, the largest first."""
    known = [name for name, entry in (table or {}).items() if entry.value is not None]
    return sorted(known, key=lambda name: -(table or {})[name].number)


def _table(
    caption: str,
    header: tuple[str, ...],
    names: Iterable[str],
    *columns: Ests,
    note: str = "",
    words: Callable[[str], str] = input_name,
) -> Table | None:
    """A row of indices for each name; None without any."""
    rows = tuple((words(name), *(index_cell(column.get(name)) for column in columns)) for name in names)
    return Table(caption=caption, header=header, rows=rows, note=note) if rows else None


def ranked(entry: IndexEntry) -> list[str]:
    """Inputs with an index, the most important first: by the total index where interactions are seen."""
    known = [n for n, e in entry.total.items() if e.value is not None and entry.first[n].value is not None]

    def interacts(name: str) -> bool:
        # by more than the intervals, and by what matters
        first, total = entry.first[name], entry.total[name]
        apart = first.high is not None and total.low is not None and total.low > first.high
        return apart and total.number - first.number > 0.01

    order = entry.total if any(map(interacts, known)) else entry.first
    return sorted(known, key=lambda name: -(order[name].value or 0.0))


def _shared(caption: str, entry: IndexEntry | SharesEntry) -> Table | None:
    """Shapley effects and Kucherenko's indices, where inputs depend on each other."""
    names, both = sorted(entry.shapley, key=lambda name: -(entry.shapley[name].value or 0.0)), entry.kucherenko
    header = ("input", "Shapley effect", "Kucherenko, first", "Kucherenko, total")
    return _table(caption, header, names, entry.shapley, both.first, both.total)


# --- quantities -----------------------------------------------------------------------------------------


def index_table(contents: Contents, quantity: str) -> Table | None:
    """First and total indices with intervals, or the shares of inputs that depend on each other."""
    entry = contents.results.sensitivity.get(quantity, IndexEntry())
    caption = f"Sobol’ indices of {symbol(quantity)} with 95 % intervals"
    found = _table(caption, _ALONE, ranked(entry), entry.first, entry.total, note=entry.check.text)
    caption = f"Shares of dependent inputs in the variance of {symbol(quantity)}, with 95 % intervals"
    return found or _shared(caption, entry)


def pair_table(contents: Contents, quantity: str) -> Table | None:
    """Indices of pairs with intervals, the largest first."""
    pairs = contents.results.sensitivity.get(quantity, IndexEntry()).second
    rows = tuple((*map(input_name, name.split("|", 1)), index_cell(pairs[name])) for name in _largest_first(pairs))
    caption = f"Second-order indices of {symbol(quantity)} with 95 % intervals"
    return Table(caption=caption, header=("input", "with", "share of the variance"), rows=rows) if rows else None


def group_table(contents: Contents, quantity: str) -> Table | None:
    """Indices of groups with intervals."""
    groups = contents.results.sensitivity.get(quantity, IndexEntry()).groups
    caption = f"Indices of groups of inputs, {symbol(quantity)}, with 95 % intervals"
    header = ("group", "by themselves (closed)", "with interactions (total)")
    return _table(caption, header, groups.total, groups.first, groups.total, words=lambda name: shorten(name, 60))


def distances_table(contents: Contents, quantity: str) -> Table | None:
    """Borgonovo's delta and PAWN."""
    entry = contents.results.sensitivity.get(quantity, IndexEntry())
    threshold = entry.pawn_threshold
    idle = "" if threshold is None else f"; without any effect PAWN stays below {number_text(f'{threshold:.2g}')}"
    caption = f"How far an input moves the whole law of {symbol(quantity)}{idle}"
    return _table(caption, ("input", "Borgonovo’s δ", "PAWN"), _largest_first(entry.delta), entry.delta, entry.pawn)


# --- failure --------------------------------------------------------------------------------------------


def failure_table(contents: Contents, name: str) -> Table | None:
    """Indices of missing the aim of a limit."""
    entry = contents.results.limits[name].drivers
    if not entry:
        return None
    caption = f"Indices of {entry.of}, {limit_name(name)}, with 95 % intervals"
    return _shared(caption, entry) or _table(caption, _ALONE, _largest_first(entry.total), entry.first, entry.total)


def given_failure_table(contents: Contents, name: str) -> Table | None:
    """Inputs where the aim is missed, beside their laws."""
    rows = []
    for variable, found in (contents.results.limits[name].drivers.given_failure or {}).items():
        if found.mean.value is None:
            continue
        subject, law = contents.subject(variable), found.law
        low, high = (value_text(law.quantiles[p], subject) for p in ("0.05", "0.95"))
        there = (found.mean, found.quantiles["0.05"], found.quantiles["0.95"])
        # four digits: with more the table is wider than the page
        cells = [cell(one, subject, digits=4) for one in there]
        rows.append((input_name(variable), *cells, value_text(law.mean, subject), f"{low} to {high}"))
    if not rows:
        return None
    return Table(
        caption=f"The inputs where the aim of {limit_name(name)} is missed, with 95 % intervals",
        header=("input", "mean there", "5 % there", "95 % there", "mean of the law", "5 to 95 % of the law"),
        rows=tuple(rows),
        note="What belongs to the law is exact.",
    )


# --- what to measure first ------------------------------------------------------------------------------


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


def measure_table(entry: MeasureEntry | None, caption: str) -> Table | None:
    """Inputs by what knowing them better is worth, with the number of specimens."""
    if not entry or not entry.rows:
        return None
    probability = entry.of == "probability"
    # one power of ten for the whole column
    largest = max((abs(row.sway.value or 0.0) for row in entry.rows), default=0.0) if probability else 0.0
    power = math.floor(math.log10(largest)) if 0.0 < largest < 0.1 else 0
    rows: list[tuple[str, ...]] = []
    for row in entry.rows:
        seen, count, sway = row.observations, specimens(entry, row), row.sway
        tests = (thousands(count) if count else "none") + ("" if seen is None else f" (the law rests on {seen})")
        ends = (None if end is None else 10.0**-power * end for end in (sway.value, sway.low, sway.high))
        parts = (cell(Est.of(*ends)), two_digits(row.part)) if probability else (index_cell(row.effect),)
        rows.append((input_name(row.input), *parts, tests))
    wanted = f"{100.0 * entry.wanted:g} %"
    header: tuple[str, ...] = (
        "input",
        "share of the variance",
        f"tests in all until {wanted} of today’s variance is left to it",
    )
    note = "Numbers of tests rise with the share, and have its relative interval."
    if probability:
        scale = f" [{powers(f'1e{power}').removeprefix('1 × ')}]" if power else ""
        side = "the probability to the contrary" if (entry.probability or 0.0) > 0.5 else "the probability"
        moves = f"tests in all until its error moves {side} by {wanted} of its value"
        change = f"change of the probability per standard deviation{scale}"
        header = ("input", change, "share in its uncertainty", moves)
        note = "Shares and numbers of tests rise with the square of the change, and have twice its relative interval."
    return Table(caption=caption, header=header, rows=tuple(rows), note=note)


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
