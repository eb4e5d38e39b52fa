"""Runs side by side: decisions, settings that differ, and answers that changed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from uqsphere.arrays import Array, Names
from uqsphere.errors import UsageError
from uqsphere.quantities import format_probability, format_value
from uqsphere.results import Run
from uqsphere.results.types import InputEntry, Kind, Range
from uqsphere.uq import LEVEL_TEXT

from .format import DASH, change_text, ends_of, label, meaning, plain_name, value
from .sentences import DecisionText

if TYPE_CHECKING:
    import pandas as pd

#: answers that are probabilities, indices, free numbers, of quantities, and all that are compared
PROBABILITIES = (Kind.EXCEEDANCE_PROBABILITY, Kind.FAILURE_PROBABILITY, Kind.MODE_SHARE)
INDICES = (Kind.SOBOL_FIRST, Kind.SOBOL_TOTAL)
NUMBERS = (Kind.MARGIN, Kind.NUMBER_TO_USE)
OF_QUANTITIES = (Kind.MEAN, Kind.SD, Kind.QUANTILE)
COMPARED = (*PROBABILITIES, *OF_QUANTITIES, *NUMBERS, Kind.SAFETY_FACTOR, *INDICES)
#: relative change that is worth a line, and such lines at most
WORTH, MOST = 1e-3, 20


class _Change(NamedTuple):
    """An answer of all runs.

    ends : value, low and high of each run (3, n); nan where there is none
    change : the largest against the first run, of the run `most`
    """

    subject: str
    answer: Kind
    at: str
    unit: str
    ends: Array
    change: float
    most: int
    significant: bool


def compare(runs: Sequence[Run], names: Names) -> pd.DataFrame:
    """Answers of several runs side by side, the largest significant change first.

    Columns: subject, answer, at, unit, for each run NAME its value; change, the largest against the
    first run, over its value (of a probability over its target, if it has one; of an index the
    difference; never over less than the half-width of its interval, nor, of a mean or a quantile,
    than the standard deviation); significant, whether the values differ by more than their
    intervals.

    Raises UsageError for fewer than two runs.
    """
    import pandas as pd

    rows = [(*row[:4], *row.ends[0], row.change, row.significant) for row in _changes(runs)]
    return pd.DataFrame(
        rows, columns=["subject", "answer", "at", "unit", *names, "change", "significant"]
    )


def _changes(runs: Sequence[Run]) -> list[_Change]:
    """What `compare` lists, in its order."""
    if len(runs) < 2:
        raise UsageError("compare takes at least two runs: uqsphere compare BEFORE AFTER")
    answers = []
    for run in runs:
        rows = (row for row in run.results.answers if row.answer in COMPARED)
        # margins of different free numbers are different answers
        answers.append({(row.subject, row.answer, str(row.at), row.unit): row for row in rows})
    limits = runs[0].results.study.limits
    targets = {f"limits.{name}": entry.target for name, entry in limits.items() if entry.has_target}
    changes = []
    for place in sorted({*chain(*answers)}):
        subject, answer, *_ = place
        ends = ends_of(rows.get(place, Range()) for rows in answers)
        values, low, high = ends
        half_widths = 0.5 * np.nan_to_num(high - low)
        scale = max(abs(values[0]), half_widths[0])
        if answer in INDICES:
            scale = 1.0
        elif answer in OF_QUANTITIES:
            deviation = runs[0].results.get(subject, Kind.SD).value
            scale = max(scale, deviation or 0.0)
        elif answer in PROBABILITIES:
            scale = targets.get(subject) or max(scale, 1e-12)
        difference = values - values[0]
        # a value of exactly 0 has no scale: each change of it is a whole one
        relative = np.nan_to_num(difference / scale if scale else np.sign(difference))
        most = int(abs(relative).argmax())
        significant = abs(difference[most]) > math.hypot(half_widths[0], half_widths[most])
        changes.append(_Change(*place, ends, relative[most], most, bool(significant)))
    return sorted(changes, key=lambda row: (not row.significant, -abs(row.change)))


def comparison_text(runs: Sequence[Run], names: Names) -> str:
    """Decisions, settings that differ, and the answers that changed most, as text."""
    changes = _changes(runs)
    named = list(zip(names, runs, strict=True))
    lines = [f"{name}: {run.results.study.title}" for name, run in named]
    lines += _decisions(named)
    settings = list(_settings(named))
    if settings:
        lines += ["", "settings that differ:", *(f"  {text}" for text in settings)]
    moved = [
        row
        for row in changes
        # a limit's failure probability is that of exceedance, or its complement
        if abs(row.change) > WORTH
        and (row.answer != Kind.FAILURE_PROBABILITY or row.at not in ("", "together"))
    ]
    sure = [row for row in moved if row.significant]
    if sure:
        lines += ["", "answers that changed:", *(f"  {_text(row, runs)}" for row in sure[:MOST])]
    if len(sure) > MOST:
        lines.append(f"  ... {len(sure) - MOST} more; --csv has all")
    if len(moved) > len(sure):
        lines.append(
            f"{len(moved) - len(sure)} more changed by less than their {LEVEL_TEXT} intervals"
        )
    if not any(np.isfinite(row.ends[0]).sum() > 1 for row in changes):
        lines.append("the runs have no answer in common: compare runs of one study")
    elif not moved:
        lines.append("no answer changed by more than 0.1 %")
    return "\n".join(lines)


def _decisions(named: Sequence[tuple[str, Run]]) -> Iterator[str]:
    """For each aim, the number to use, the verdict and what governs, run by run."""
    for aim in dict.fromkeys(chain.from_iterable(run.decisions for _, run in named)):
        yield ""
        yield f"to {aim}:"
        for name, run in named:
            decision = run.decisions.get(aim)
            if not decision:
                yield f"  {name}: no limit"
                continue
            text = DecisionText(run.results, decision)
            governing = plain_name(decision.governing)
            yield f"  {name}: {text.use}; {decision.verdict}; {governing} governs"
            yield f"    {text.broken}"


def _settings(named: Sequence[tuple[str, Run]]) -> Iterator[str]:
    """What --set changed, and inputs that differ from those of the first run."""
    common = set.intersection(*(set(run.results.study.overrides) for _, run in named))
    for name, run in named:
        changed = [text for text in run.results.study.overrides if text not in common]
        if changed:
            yield f"--set {'; '.join(changed)} ({name})"
    for name, run in named[1:]:
        for path, entry in run.results.inputs.items():
            before = named[0][1].results.inputs.get(path)
            if not before or (before.mean, before.sd) != (entry.mean, entry.sd):
                yield f"{path}: {_input(before, path)} -> {_input(entry, path)} ({name})"


def _input(entry: InputEntry | None, path: str) -> str:
    if not entry:
        return DASH
    mean = value(entry.mean, path, 4)
    if not entry.sd:
        return mean
    return f"{mean} ± {value(entry.sd, path)}"


def _text(row: _Change, runs: Sequence[Run]) -> str:
    """An answer of every run, and its largest change."""
    free = runs[0].results.study.free
    texts = []
    ends = row.ends.T.tolist()
    for x, *_ in ends:
        text = f"{x:.4g}"
        if not math.isfinite(x):
            text = DASH
        elif row.answer in OF_QUANTITIES:
            text = format_value(x, row.subject)
        elif row.answer in NUMBERS and free:
            text = format_value(x, free.quantity)
        elif row.answer in PROBABILITIES:
            text = format_probability(x)
        texts.append(text)
    change = f"{row.change:+.2g}"
    if row.answer not in INDICES:
        change = change_text(ends[0], ends[row.most])
    title = label(row.subject)
    if title == row.subject:
        title = meaning(title)
    title = f"{title}, {row.answer.replace('_', ' ')} {row.at}".rstrip()
    return f"{title}: {' -> '.join(texts)} ({change})"
