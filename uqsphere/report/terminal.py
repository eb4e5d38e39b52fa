"""The terminal's summary of a run, in 40 lines."""

import textwrap
from collections.abc import Iterable, Sequence

from uqsphere.results.types import Kind, Results

from . import tables
from .format import estimate, keep_units, meaning, value_range
from .sentences import NO_LIMIT, accuracy_text, decision_texts, exceedance_name, limit_notes
from .tables import Row

#: lines at most, rows of each table, and columns of indices
LINES, ROWS, COLUMNS = 40, 8, 3


def summary(results: Results, width: int = 79) -> str:
    """The summary as text of at most 40 lines."""
    texts = [results.study.title]
    for decision in decision_texts(results):
        texts += ["", *decision.lines()]
    if not results.study.limits:
        texts += ["", NO_LIMIT]
        texts += [f"Check failed: {c.text}" for c in results.checks if c.grade == "failure"]
    lines = [
        *_wrapped(texts, width),
        *_columns(_limits(results), width),
        *_wrapped(["; ".join(limit_notes(results))], width),
        *_columns(_paper(results), width),
        *_columns(_quantities(results), width),
        *_columns(_indices(results), width),
        *_wrapped(["", accuracy_text(results.accuracy)], width),
    ]
    if len(lines) > LINES:
        lines = [*lines[: LINES - 1], "... the rest is in the report"]
    return "\n".join(lines)


def _wrapped(texts: Iterable[str], width: int) -> list[str]:
    """Texts, each from a new line, in which units keep their numbers."""
    lines = []
    for text in texts:
        wrapped = textwrap.wrap(keep_units(text), width) or [""]
        lines += [line.replace("\N{NO-BREAK SPACE}", " ") for line in wrapped]
    return lines


def _columns(rows: Sequence[Row], width: int) -> list[str]:
    """A table, heads first, below an empty line; nothing without rows."""
    if len(rows) < 2:
        return []
    return ["", *tables.columns(rows, width)]


def _limits(results: Results) -> list[Row]:
    head = ["failure mode", exceedance_name(results), "beta"]
    if results.study.free:
        head += ["best estimate", "to use"]
    return [head, *(row[: len(head)] for row in tables.limits(results).rows[: ROWS + 2])]


def _paper(results: Results) -> list[Row]:
    paper = tables.paper(results)
    return [row[:3] for row in (paper.head, *paper.rows)]


def _quantities(results: Results) -> Sequence[Row]:
    rows = [("quantity", "mean", "5-95 % range")]
    for name, entry in results.study.quantities.items():
        mean = estimate(results.get(name, Kind.MEAN), name)
        low, _, high = entry.range
        rows.append((meaning(name), mean, value_range(low, high, name)))
    return rows[: ROWS + 1]


def _indices(results: Results) -> list[Row]:
    names = tables.with_indices(results)
    rows: list[Row] = [("Sobol' index, total", *names[:COLUMNS])]
    for first, *cells in tables.indices(results).rows[:ROWS]:
        totals = cells[1 : 2 * COLUMNS : 2]
        rows.append((first, *(total.partition(" ")[0] for total in totals)))
    return rows
