"""Tables and sentences on what drives failure, on indices beyond variance, and on what to measure first."""

from __future__ import annotations

import math

from uqsphere.report.blocks import Table, cell, index_cell, thousands
from uqsphere.report.contents import Contents
from uqsphere.report.phrases import ABSENT, input_name, limit_name, number_text, powers, symbol, two_digits, value_text
from uqsphere.results import IndexEntry, MeasureEntry, MeasureRow, SharesEntry
from uqsphere.results.entries import Est, Ests


def _by_value(table: Ests) -> list[str]:
    return sorted(table, key=lambda name: -float(table[name].value or 0.0))


def _known(table: Ests | None) -> list[str]:
    """Names with a value, the largest first."""
    return [name for name in _by_value(table or {}) if (table or {})[name].value is not None]


# --- the order of inputs, and how often to measure them ------------------------------------------------


def ranked(entry: IndexEntry | None) -> list[str]:
    """Inputs with an index, the most important first: by the total index where interactions are seen."""
    if not entry:
        return []
    known = [n for n, e in entry.total.items() if e.value is not None and entry.first[n].value is not None]
    order = entry.total if any(_interacts(entry, name) for name in known) else entry.first
    return sorted(known, key=lambda name: -float(order[name].value or 0.0))


def _interacts(entry: IndexEntry, name: str) -> bool:
    """Whether the total index is larger than the first by more than the intervals and by what matters."""
    first, total = entry.first[name], entry.total[name]
    return _exceeds(entry, name) and total.number - first.number > 0.01


def _exceeds(entry: IndexEntry, name: str) -> bool:
    """Whether the total index is larger than the first by more than the intervals."""
    first, total = entry.first[name], entry.total[name]
    return first.high is not None and total.low is not None and bool(total.low > first.high)


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


def _side(entry: MeasureEntry) -> str:
    """Of which probability a tenth, say, is to be known."""
    return "the probability to the contrary" if (entry.probability or 0.0) > 0.5 else "the probability"


# --- quantities -----------------------------------------------------------------------------------------


def _shared_rows(entry: SharesEntry) -> tuple[tuple[str, ...], ...]:
    both = entry.kucherenko
    return tuple(
        (input_name(n), index_cell(entry.shapley[n]), index_cell(both.first.get(n)), index_cell(both.total.get(n)))
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
            rows.append((input_name(row.input), cell(_scaled(row.sway, 10.0**-power)), two_digits(row.part), tests))
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


# --- Which way an input works on the load and on breakage, said where the two differ.


def index_table(contents: Contents, quantity: str) -> Table | None:
    """First and total indices with intervals."""
    entry = contents.results.sensitivity.get(quantity)
    names = ranked(entry)
    if not names or entry is None:
        return None
    rows = [(input_name(n), index_cell(entry.first[n]), index_cell(entry.total[n])) for n in names]
    return Table(
        caption=f"Sobol’ indices of {symbol(quantity)} with 95 % intervals",
        header=("input", "first (alone)", "total (with interactions)"),
        rows=tuple(rows),
        note=entry.check.text,
    )
