"""Runs side by side: decisions, settings that differ, and answers that changed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from uqsphere.errors import UsageError
from uqsphere.quantities import format_probability, format_value
from uqsphere.report.format import DASH, change_text, label, meaning, value
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
KEYS = ["subject", "answer", "at"]
#: relative change that is worth a line
WORTH = 1e-3


def compare(runs: Sequence[Run], names: Sequence[str]) -> pd.DataFrame:
    """Answers of several runs side by side, the largest significant change first.

    Columns: subject, answer, at, unit, for each run NAME its value; change, the largest against the
    first run, over its value (of a probability over its target, if it has one; of an index the
    difference; never over less than the half-width of its interval); significant, whether the
    values differ by more than their intervals.

    Raises UsageError for fewer than two runs.
    """
    table = _merged(runs)
    values = {f"value_{number}": name for number, name in enumerate(names)}
    shown: pd.DataFrame = table[[*KEYS, "unit", *values, "change", "significant"]]
    return shown.rename(columns=values).reset_index(drop=True)


def _merged(runs: Sequence[Run]) -> pd.DataFrame:
    """The table of `compare`, with value_K, low_K and high_K of run K, and `most`, the run with the
    largest change.
    """
    if len(runs) < 2:
        raise UsageError("compare takes at least two runs: uqsphere compare BEFORE AFTER")
    tables = list[Any]()
    for number, run in enumerate(runs):
        table = run.answers[run.answers["answer"].isin(COMPARED)]
        table = table.assign(at=table["at"].map(str)).set_index(KEYS)
        tables.append(table[["unit", "value", "low", "high"]].add_suffix(f"_{number}"))
    merged = tables[0].join(tables[1:], how="outer").reset_index()
    values, low, high = (
        merged[[f"{end}_{number}" for number in range(len(runs))]].to_numpy()
        for end in ("value", "low", "high")
    )
    width = np.nan_to_num(high - low)
    limits = runs[0].results.study.limits
    targets = {f"limits.{name}": entry.target for name, entry in limits.items() if entry.has_target}
    scale = merged["value_0"].abs().clip(lower=0.5 * width[:, 0])
    chances = merged["answer"].isin(PROBABILITIES)
    scale[chances] = merged["subject"].map(targets).fillna(scale.clip(lower=1e-12))[chances]
    scale[merged["answer"].isin(INDICES)] = 1.0
    difference = values[:, 1:] - values[:, :1]
    outside = abs(difference) > 0.5 * np.hypot(width[:, :1], width[:, 1:])
    # a value of exactly 0 has no scale: each change of it is a whole one
    relative = np.nan_to_num(difference / scale.where(scale > 0.0, np.inf).to_numpy()[:, None])
    zero = (scale == 0.0).to_numpy()
    relative[zero] = np.nan_to_num(np.sign(difference[zero]))
    most = abs(relative).argmax(axis=1)
    rows = np.arange(len(merged))
    merged = merged.rename(columns={"unit_0": "unit"}).assign(
        change=relative[rows, most], significant=outside[rows, most], most=most + 1
    )
    merged["size"] = merged["change"].abs()
    ranked: pd.DataFrame = merged.sort_values(
        ["significant", "size"], ascending=False, kind="stable"
    )
    return ranked


def comparison_text(runs: Sequence[Run], names: Sequence[str], most: int = 20) -> str:
    """Decisions, settings that differ, and the answers that changed most, as text."""
    table = _merged(runs)
    lines = [f"{name}: {run.results.study.title}" for name, run in zip(names, runs, strict=True)]
    lines += _decisions(runs, names)
    settings = _settings(runs, names)
    if settings:
        lines += ["", "settings that differ:", *(f"  {text}" for text in settings)]
    # a limit's failure probability is that of exceedance, or its complement
    again = (table["answer"] == Kind.FAILURE_PROBABILITY) & (table["at"] == "")
    moved = table[(table["size"] > WORTH) & ~again]
    sure = moved[moved["significant"]]
    if not sure.empty:
        lines += ["", "answers that changed:"]
        lines += [f"  {_answer(row, runs)}" for _, row in sure.head(most).iterrows()]
    if len(sure) > most:
        lines.append(f"  ... {len(sure) - most} more; --csv has all")
    if len(moved) > len(sure):
        count = len(moved) - len(sure)
        lines.append(f"{count} more changed by less than their 95 % intervals")
    if table.filter(regex="^value_").notna().sum(axis=1).max() < 2:
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
    common = set(first.study.overrides).intersection(*(run.results.study.overrides for run in runs))
    for name, run in zip(names, runs, strict=True):
        changed = [text for text in run.results.study.overrides if text not in common]
        if changed:
            lines.append(f"--set {'; '.join(changed)} ({name})")
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


def _answer(row: Any, runs: Sequence[Run]) -> str:
    """An answer of every run, and its largest change."""
    subject = row["subject"]
    kind = row["answer"]
    free = runs[0].results.study.free
    quantity = ""
    if kind in OF_QUANTITIES:
        quantity = subject
    elif kind == Kind.MARGIN and free is not None:
        quantity = free.path
    texts = []
    for number in range(len(runs)):
        x = row[f"value_{number}"]
        text = DASH
        if math.isfinite(x):
            text = f"{x:.4g}"
            if quantity:
                text = format_value(x, quantity)
            elif kind in PROBABILITIES:
                text = format_probability(x)
        texts.append(text)
    change = f"{row['change']:+.2g}"
    if kind not in INDICES:
        before, after = (
            [row[f"{end}_{number}"] for end in ("value", "low", "high")]
            for number in (0, row["most"])
        )
        change = change_text(before, after)
    title = label(subject)
    if title == subject:
        title = meaning(subject)
    title = f"{title}, {kind.replace('_', ' ')} {row['at']}".rstrip()
    return f"{title}: {' -> '.join(texts)} ({change})"
