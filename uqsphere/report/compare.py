"""Runs side by side: decisions, settings that differ, and answers that changed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from uqsphere.errors import UsageError
from uqsphere.quantities import format_probability, format_value
from uqsphere.report.format import DASH, label, meaning, value
from uqsphere.report.sentences import decision_text, plain_name
from uqsphere.results import Run
from uqsphere.results.types import InputEntry, Kind

if TYPE_CHECKING:
    import pandas as pd

#: answers that are probabilities, indices, and all that are compared
PROBABILITIES = (Kind.EXCEEDANCE_PROBABILITY, Kind.FAILURE_PROBABILITY, Kind.MODE_SHARE)
INDICES = (Kind.SOBOL_FIRST, Kind.SOBOL_TOTAL)
OF_QUANTITIES = (Kind.MEAN, Kind.SD, Kind.QUANTILE)
COMPARED = (*PROBABILITIES, *OF_QUANTITIES, Kind.MARGIN, Kind.SAFETY_FACTOR, *INDICES)
#: relative change that is worth a line
WORTH = 1e-3


def compare(runs: Sequence[Run], names: Sequence[str]) -> pd.DataFrame:
    """Answers of several runs side by side, the largest significant change first.

    Columns: subject, answer, at, unit, for each run NAME its value; change, the largest against the
    first run, over its value (of a probability over its target, if it has one); significant,
    whether the values differ by more than their intervals.

    Raises UsageError for fewer than two runs.
    """
    if len(runs) < 2:
        raise UsageError("compare takes at least two runs: uqsphere compare BEFORE AFTER")
    keys = ["subject", "answer", "at"]
    tables = list[Any]()
    for number, run in enumerate(runs):
        table = run.answers[run.answers["answer"].isin(COMPARED)]
        table = table.assign(at=table["at"].map(str)).set_index(keys)
        tables.append(table[["unit", "value", "low", "high"]].add_suffix(f"_{number}"))
    merged = tables[0].join(tables[1:], how="outer").reset_index()
    values, low, high = (
        merged[[f"{end}_{number}" for number in range(len(runs))]].to_numpy()
        for end in ("value", "low", "high")
    )
    limits = runs[0].results.study.limits
    targets = {f"limits.{name}": entry.target for name, entry in limits.items() if entry.has_target}
    # of an index the change itself, of a probability over its target
    scale = merged["value_0"].abs()
    chances = merged["answer"].isin(PROBABILITIES)
    scale[chances] = merged["subject"].map(targets).fillna(scale.clip(lower=1e-12))[chances]
    scale[merged["answer"].isin(INDICES)] = 1.0
    scale = scale.where(scale > 0.0).to_numpy()[:, None]
    width = np.nan_to_num(high - low)
    difference = values[:, 1:] - values[:, :1]
    outside = abs(difference) > 0.5 * np.hypot(width[:, :1], width[:, 1:])
    relative = np.nan_to_num(difference / scale)
    most = np.arange(len(merged)), abs(relative).argmax(axis=1)
    merged = merged.rename(columns={"unit_0": "unit"})
    merged = merged.assign(change=relative[most], significant=outside[most])
    merged["size"] = merged["change"].abs()
    merged[list(names)] = values
    merged = merged.sort_values(["significant", "size"], ascending=False, kind="stable")
    shown: pd.DataFrame = merged[[*keys, "unit", *names, "change", "significant"]]
    return shown.reset_index(drop=True)


def comparison_text(runs: Sequence[Run], names: Sequence[str], most: int = 20) -> str:
    """Decisions, settings that differ, and the answers that changed most, as text."""
    table = compare(runs, names)
    lines = [f"{name}: {run.results.study.title}" for name, run in zip(names, runs, strict=True)]
    lines += _decisions(runs, names)
    settings = _settings(runs, names)
    if settings:
        lines += ["", "settings that differ:", *(f"  {text}" for text in settings)]
    moved = table[table["change"].abs() > WORTH]
    sure = moved[moved["significant"]]
    unsure = moved[~moved["significant"]]
    if not sure.empty:
        lines += ["", "answers that changed:"]
        lines += [f"  {_answer(row, runs, names)}" for _, row in sure.head(most).iterrows()]
    if len(sure) > most:
        lines.append(f"  ... {len(sure) - most} more; --csv has all")
    if len(unsure):
        lines.append(f"{len(unsure)} more changed by less than their 95 % intervals")
    if table[list(names)].notna().sum(axis=1).max() < 2:
        lines.append("the runs have no answer in common: compare runs of one study")
    elif moved.empty:
        lines.append("no answer changed by more than 0.1 %")
    return "\n".join(lines)


def _decisions(runs: Sequence[Run], names: Sequence[str]) -> list[str]:
    """For each aim, the number to use, the verdict and what governs, run by run."""
    lines = []
    for aim in dict.fromkeys(chain.from_iterable(run.decisions for run in runs)):
        lines += ["", f"to {aim}:"]
        for name, run in zip(names, runs, strict=True):
            decision = run.decisions.get(aim)
            if decision is None:
                lines.append(f"  {name}: no limit")
                continue
            text = decision_text(run.results, decision)
            governing = plain_name(decision.governing)
            lines.append(f"  {name}: {text.use}; {text.verdict}; {governing} governs")
            lines.append(f"    {text.broken}")
    return lines


def _settings(runs: Sequence[Run], names: Sequence[str]) -> list[str]:
    """What --set changed, and inputs that differ from those of the first run."""
    lines = list[str]()
    first = runs[0].results
    for name, run in zip(names, runs, strict=True):
        if run.results.study.overrides and run.results.study.overrides != first.study.overrides:
            lines.append(f"--set {'; '.join(run.results.study.overrides)} ({name})")
    for name, run in zip(names[1:], runs[1:], strict=True):
        for path, entry in run.results.inputs.items():
            before = first.inputs.get(path)
            if before is None or (before.mean, before.sd) != (entry.mean, entry.sd):
                lines.append(f"{path}: {_input(before, path)} -> {_input(entry, path)} ({name})")
    return lines


def _input(entry: InputEntry | None, path: str) -> str:
    if entry is None:
        return DASH
    mean = value(entry.mean, path, 4)
    if not entry.sd:
        return mean
    return f"{mean} ± {value(entry.sd, path)}"


def _answer(row: Any, runs: Sequence[Run], names: Sequence[str]) -> str:
    subject = row["subject"]
    kind = row["answer"]
    free = runs[0].results.study.free
    quantity = ""
    texts = []
    if kind in OF_QUANTITIES:
        quantity = subject
    elif kind == Kind.MARGIN and free is not None:
        quantity = free.path
    for name in names:
        text = DASH
        if math.isfinite(row[name]):
            text = f"{row[name]:.4g}"
            if quantity:
                text = format_value(row[name], quantity)
            elif kind in PROBABILITIES:
                text = format_probability(row[name])
        texts.append(text)
    title = label(subject)
    if title == subject:
        title = meaning(subject)
    title = f"{title}, {kind.replace('_', ' ')} {row['at']}".rstrip()
    return f"{title}: {' -> '.join(texts)} ({100.0 * row['change']:+.3g} %)"
