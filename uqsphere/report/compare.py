"""Runs side by side: what was set otherwise, which answers moved, and by how much."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from uqsphere.errors import UsageError
from uqsphere.report.format import estimate, probability
from uqsphere.results import Run

if TYPE_CHECKING:
    import pandas as pd

#: answers that are probabilities
PROBABILITIES = ("exceedance_probability", "failure_probability", "mode_share")
#: answers that are compared
COMPARED = (
    *PROBABILITIES,
    "mean",
    "sd",
    "quantile",
    "margin",
    "safety_factor",
    "sobol_first",
    "sobol_total",
)


def compare(runs: Sequence[Run], names: Sequence[str]) -> pd.DataFrame:
    """Answers of several runs, merged: the first run against each other one, the largest practical
    change first.

    Columns: subject, answer, at, then for each run NAME its value; change, the largest over the
    first run's value (of a probability over its target where there is one), and significant,
    whether that change lies outside the interval of the difference.

    Raises UsageError for fewer than two runs.
    """

    if len(runs) < 2:
        raise UsageError("compare takes two runs at least: uqsphere compare BEFORE AFTER")
    keys = ["subject", "answer", "at"]
    tables: list[Any] = []
    for number, run in enumerate(runs):
        table = run.answers[run.answers["answer"].isin(COMPARED)].copy()
        table["at"] = table["at"].map(str)
        tables.append(table.set_index(keys)[["value", "low", "high"]].add_suffix(f"_{number}"))
    merged = tables[0].join(tables[1:], how="outer").reset_index()
    limits = runs[0].results.study.limits
    targets = {f"limits.{name}": entry.target for name, entry in limits.items() if entry.has_target}
    changes, significant = [], []
    for _, row in merged.iterrows():
        largest, sure = 0.0, False
        for k in range(1, len(runs)):
            change, outside = _change(row, k, targets.get(row["subject"]))
            if abs(change) > abs(largest):
                largest, sure = change, outside
        changes.append(largest)
        significant.append(sure)
    merged["change"], merged["significant"] = changes, significant
    for number, name in enumerate(names):
        merged[name] = merged[f"value_{number}"]
    order = merged["change"].abs().sort_values(ascending=False, kind="stable").index
    found: pd.DataFrame = merged.loc[order, [*keys, *names, "change", "significant"]].reset_index(
        drop=True
    )
    return found


def _change(row: Any, k: int, target: float | None) -> tuple[float, bool]:
    """Relative change of an answer from the first run to the k-th, and whether it is outside the
    interval.
    """
    before, after = row["value_0"], row[f"value_{k}"]
    if not (math.isfinite(before) and math.isfinite(after)):
        return 0.0, False
    difference = after - before
    scale = abs(before)
    if row["answer"] in PROBABILITIES:
        scale = target or max(abs(before), 1e-12)
    elif row["answer"].startswith("sobol"):
        scale = 1.0
    half = math.hypot(
        *(
            0.5 * (row[f"high_{n}"] - row[f"low_{n}"]) if math.isfinite(row[f"high_{n}"]) else 0.0
            for n in (0, k)
        )
    )
    return (difference / scale if scale > 0.0 else 0.0), abs(difference) > half


def comparison_text(runs: Sequence[Run], names: Sequence[str], most: int = 20) -> str:
    """What was set otherwise, and the answers that moved most, as text."""
    table = compare(runs, names)
    lines = [
        f"{name}: {run.results.study.title}"
        + "".join(f"\n  set: {s}" for s in run.results.study.overrides)
        for name, run in zip(names, runs, strict=True)
    ]
    lines += [f"  {text}" for text in _inputs_changed(runs, names)]
    moved = table[table["change"].abs() > 1e-3]
    lines.append("")
    for _, row in moved.head(most).iterrows():
        at = f" {row['at']}" if row["at"] else ""
        texts = [_text(row, name) for name in names]
        sure = "" if row["significant"] else ", inside the intervals"
        lines.append(
            f"{row['subject']} {row['answer'].replace('_', ' ')}{at}: {' -> '.join(texts)} "
            f"({100.0 * row['change']:+.3g} %{sure})"
        )
    if len(moved) > most:
        lines.append(f"... {len(moved) - most} more; --csv has all")
    if table[list(names)].notna().sum(axis=1).max() < 2:
        lines.append(
            "the runs have no answer in common: runs of one study with something set otherwise "
            "are compared"
        )
    elif moved.empty:
        lines.append("no answer moved by more than 0.1 %")
    return "\n".join(lines)


def _text(row: Any, name: str) -> str:
    entry = {
        "value": None if math.isnan(row[name]) else row[name],
        "low": None,
        "high": None,
        "note": "",
    }
    if row["answer"] in PROBABILITIES:
        return probability(entry)
    quantity = row["subject"] if row["answer"] in ("mean", "sd", "quantile") else ""
    return estimate(entry, quantity)


def _inputs_changed(runs: Sequence[Run], names: Sequence[str]) -> list[str]:
    from uqsphere.report.format import value

    lines = []
    first = runs[0].results.inputs
    for name, run in zip(names[1:], runs[1:], strict=True):
        for path, entry in run.results.inputs.items():
            before = first.get(path)
            if before is None or (before.mean, before.sd) != (entry.mean, entry.sd):
                texts = [
                    "–" if e is None else f"{value(e.mean, path)} ± {value(e.sd, path)}"
                    for e in (before, entry)
                ]
                lines.append(f"{path}: {texts[0]} -> {texts[1]} ({name})")
    return lines
