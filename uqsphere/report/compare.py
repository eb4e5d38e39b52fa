"""Runs side by side: decisions, settings that differ, and answers that changed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any

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
COMPARED = (
    *PROBABILITIES,
    Kind.MEAN,
    Kind.SD,
    Kind.QUANTILE,
    Kind.MARGIN,
    Kind.SAFETY_FACTOR,
    *INDICES,
)
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
    tables: list[Any] = []
    for number, run in enumerate(runs):
        table = run.answers[run.answers["answer"].isin(COMPARED)].copy()
        table["at"] = table["at"].map(str)
        if number:
            table = table.drop(columns="unit")
        kept = [name for name in ("unit", "value", "low", "high") if name in table]
        renamed = {name: f"{name}_{number}" for name in ("value", "low", "high")}
        tables.append(table.set_index(keys)[kept].rename(columns=renamed))
    merged = tables[0].join(tables[1:], how="outer").reset_index()
    limits = runs[0].results.study.limits
    targets = {f"limits.{name}": entry.target for name, entry in limits.items() if entry.has_target}
    changes, significant = [], []
    for _, row in merged.iterrows():
        pairs = [_change(row, k, targets.get(row["subject"])) for k in range(1, len(runs))]
        change, outside = max(pairs, key=lambda pair: abs(pair[0]))
        changes.append(change)
        significant.append(outside)
    merged["change"], merged["significant"] = changes, significant
    for number, name in enumerate(names):
        merged[name] = merged[f"value_{number}"]
    order = merged.assign(size=merged["change"].abs())
    order = order.sort_values(["significant", "size"], ascending=False, kind="stable")
    columns = [*keys, "unit", *names, "change", "significant"]
    ordered: pd.DataFrame = order[columns].reset_index(drop=True)
    return ordered


def _change(row: Any, k: int, target: float | None) -> tuple[float, bool]:
    """Relative change of an answer from the first run to the k-th, and whether it is outside the
    interval of the difference.
    """
    before, after = row["value_0"], row[f"value_{k}"]
    if not (math.isfinite(before) and math.isfinite(after)):
        return 0.0, False
    scale = abs(before)
    if row["answer"] in PROBABILITIES:
        scale = target or max(abs(before), 1e-12)
    elif row["answer"] in INDICES:
        scale = 1.0
    widths = [row[f"high_{number}"] - row[f"low_{number}"] for number in (0, k)]
    half = 0.5 * math.hypot(*(width for width in widths if math.isfinite(width)))
    change, outside = after - before, abs(after - before) > half
    if scale > 0.0:
        return change / scale, outside
    return 0.0, outside


def comparison_text(runs: Sequence[Run], names: Sequence[str], most: int = 20) -> str:
    """Decisions, settings that differ, and the answers that changed most, as text."""
    table = compare(runs, names)
    lines = [f"{name}: {run.results.study.title}" for name, run in zip(names, runs, strict=True)]
    lines += _decisions(runs, names)
    settings = _settings(runs, names)
    if settings:
        lines += ["", "settings that differ:", *(f"  {text}" for text in settings)]
    moved = table[table["change"].abs() > WORTH]
    sure, unsure = moved[moved["significant"]], moved[~moved["significant"]]
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
    lines, first = list[str](), runs[0].results
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
    subject = label(row["subject"])
    if subject == row["subject"]:
        subject = meaning(subject)
    kind = str(row["answer"]).replace("_", " ")
    at = f" {row['at']}".rstrip()
    texts = " -> ".join(_number(row, name, runs) for name in names)
    return f"{subject}, {kind}{at}: {texts} ({100.0 * row['change']:+.3g} %)"


def _number(row: Any, name: str, runs: Sequence[Run]) -> str:
    """A value of the table with its unit."""
    number = row[name]
    if math.isnan(number):
        return DASH
    if row["answer"] in PROBABILITIES:
        return format_probability(number)
    quantity, free = "", runs[0].results.study.free
    if row["answer"] in (Kind.MEAN, Kind.SD, Kind.QUANTILE):
        quantity = row["subject"]
    elif row["answer"] == Kind.MARGIN and free is not None:
        quantity = free.path
    if quantity:
        return format_value(number, quantity)
    return f"{number:.4g}"
