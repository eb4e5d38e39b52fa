"""The terminal's summary of a run, in 40 lines."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from uqsphere.report.format import (
    DASH,
    estimate,
    label,
    meaning,
    mode_rows,
    paper_cells,
    probability,
    short,
    table_of,
    value,
)
from uqsphere.report.sentences import (
    NO_LIMIT,
    STOPPED,
    damage_modes,
    decision_texts,
    exceedance_name,
    listed,
)
from uqsphere.results.types import Kind, Results

#: lines at most, rows of each table, and columns of indices
LINES, ROWS, COLUMNS = 40, 8, 3


def summary(results: Results, width: int = 79) -> str:
    """The summary as text of at most 40 lines."""
    lines = textwrap.wrap(results.study.title, width)
    for decision in decision_texts(results):
        lines.append("")
        for text in decision.lines():
            lines += textwrap.wrap(text, width)
    if not results.study.limits:
        lines += ["", *textwrap.wrap(NO_LIMIT, width)]
        for check in results.checks:
            if check.grade == "failure":
                lines += textwrap.wrap(f"Check failed: {check.text}", width)
    lines += _modes(results, width)
    lines += _paper(results, width)
    lines += _quantities(results, width)
    lines += _indices(results, width)
    accuracy = results.accuracy
    tail = f"{accuracy.runs:,} model runs, {accuracy.seconds:.3g} s; {STOPPED[accuracy.stopped]}"
    for reached in accuracy.reached[-1:]:
        if reached.error is not None:
            tail += f" (largest error / tolerance {reached.error:.2g})"
    lines += ["", *textwrap.wrap(tail, width)]
    if len(lines) > LINES:
        lines = [*lines[: LINES - 1], "... the rest is in the report"]
    return "\n".join(lines)


def _modes(results: Results, width: int) -> list[str]:
    free, rows = results.study.free, []
    for row in mode_rows(results):
        cells = [label(row.subject), probability(row.exceedance), row.beta()]
        if free is not None:
            best = getattr(row.best, "value", None)
            cells += [row.number(free.path), value(best, free.path)]
        rows.append(cells)
    if not rows:
        return []
    head = ["failure mode", exceedance_name(results).lower(), "beta"]
    if free is not None:
        head += ["to use", "best estimate"]
    lines = ["", *table(head, rows[:ROWS], width)]
    if results.study.modes:
        lines.append("* assumed: library strength, not measured on this rock")
    damage = damage_modes(results)
    if damage:
        lines += textwrap.wrap(f"damage, not counted as fracture: {listed(damage)}", width)
    return lines


def _quantities(results: Results, width: int) -> list[str]:
    answers, rows = table_of(results), []
    for name, entry in results.study.quantities.items():
        low, _, high = entry.range
        ends = DASH
        if low is not None:
            ends = f"{value(low, name)} to {value(high, name)}"
        rows.append((short(entry.meaning), estimate(answers.get(name, Kind.MEAN), name), ends))
    return ["", *table(("quantity", "mean", "5-95 % range"), rows[:ROWS], width)]


def _indices(results: Results, width: int) -> list[str]:
    answers = table_of(results)
    names = [name for name in results.study.quantities if answers.where(name, Kind.SOBOL_TOTAL)]
    names = names[:COLUMNS]
    if not names:
        return []
    rows = []
    for row in sorted(
        answers.where(names[0], Kind.SOBOL_TOTAL), key=lambda row: -(row.value or 0.0)
    ):
        cells = [meaning(str(row.at), results.inputs)]
        for name in names:
            total = answers.get(name, Kind.SOBOL_TOTAL, row.at)
            cells.append(DASH)
            if total is not None and total.value is not None:
                cells[-1] = f"{total.value:.3f}"
        if set(cells[1:]) != {DASH}:
            rows.append(cells)
    if not rows:
        return []
    return ["", *table(("Sobol' index, total", *names), rows[:ROWS], width)]


def _paper(results: Results, width: int) -> list[str]:
    rows = [(row.name, *paper_cells(row)) for row in results.paper]
    if not rows:
        return []
    return ["", *table(("formula of the paper", "printed", "corrected"), rows, width)]


def table(head: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> list[str]:
    """Columns side by side; the first one gives way where the terminal is narrow."""
    cells = [head, *rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    room = width - sum(widths[1:]) - 2 * (len(widths) - 1)
    widths[0] = max(min(widths[0], room), 8)
    lines = []
    for row in cells:
        first = row[0] if len(row[0]) <= widths[0] else f"{row[0][: widths[0] - 1]}…"
        texts = [text.ljust(w) for text, w in zip((first, *row[1:]), widths, strict=True)]
        lines.append("  ".join(texts).rstrip())
    return lines
