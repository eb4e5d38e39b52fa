"""The answers of a run for the terminal: a table of what was asked, and what to be cautious about."""

from __future__ import annotations

from typing import Any

from uqsphere.console import plain, table
from uqsphere.quantities import format_estimate

__all__ = ["summary_of"]


def _estimate(entry: dict[str, Any], name: str = "") -> str:
    if entry["value"] is None:
        return f"- ({entry.get('reason', 'not known')})"
    low = entry["low"] if entry["low"] is not None else entry["value"]
    high = entry["high"] if entry["high"] is not None else entry["value"]
    return format_estimate(entry["value"], low, high, name)


def _cautions(results: dict[str, Any]) -> list[str]:
    """What weakens the answers, as the report says it at length."""
    found = []
    if results["model"]["failures"]:
        found.append(f"{results['model']['failures']:,} evaluations failed")
    for check in results["validity"]:
        for grade, share in (
            ("failure", check.get("share_failure", 0.0)),
            ("warning", check.get("share_warning", 0.0)),
        ):
            if share:
                found.append(f"{grade}: {plain(check['text'])}")
                break
    for name, limit in results["limits"].items():
        opened = limit.get("ignorance")
        if opened and "reason" not in opened:
            tests = ", ".join(f"{plain(entry['input'])}: {entry['tests']}" for entry in opened["from"])
            low, high = opened["miss"]
            undecided = limit["target"] is not None and opened["met"] is None
            also = ", on both sides of the target" if undecided else ""
            found.append(
                f"limit {plain(name)}: over the laws that the tests allow ({tests}) the probability of missing it lies "
                f"between {low:.2g} and {high:.2g}{also}"
            )
    missed = results["accuracy"]["missed"]
    if missed:
        found.append(f"{len(missed)} accuracies were not reached, among them {plain(missed[0])}")
    return found


def _fracture_rows(found: dict[str, Any]) -> list[tuple[str, ...]]:
    """Probability of fracture, which limit comes first, and the median state in which it comes."""
    if not found:
        return []
    rows: list[tuple[str, ...]] = [("probability over the record", _estimate(found["union"]))]
    if "first_loading" in found:
        rows.append(("probability in the first loading", _estimate(found["first_loading"])))
    if len(found["limits"]) > 1:
        rows += [
            (f"share in which {plain(n)} comes first", _estimate(e)) for n, e in found.get("governed_by", {}).items()
        ]
    for key, words, like in (
        ("time", "median time", "contact_time"),
        ("energy", "median energy in the contacts", "energy"),
        ("imbalance", "median difference of the forces", "force_imbalance"),
    ):
        if key in found:
            rows.append((f"{words} at fracture", _estimate(found[key]["median"], like)))
    if found.get("reason"):
        rows.append(("not known further", plain(found["reason"])))
    return rows


def summary_of(results: dict[str, Any]) -> str:
    """The answers of a run for the terminal."""
    from uqsphere.runner.results import savings

    parts = [plain(results["study"]["title"]), ""]
    rows: list[tuple[str, ...]] = []
    for name, limit in results["limits"].items():
        verdict = (
            {True: "met", False: "NOT MET", None: "undecided"}[limit["met"]]
            if limit["target"] is not None
            else "no target"
        )
        target = f"{limit['target']:g}" if limit["target"] is not None else "-"
        rows.append(
            (name, limit["aim"], _estimate(limit["miss"]), target, verdict, _estimate(limit["margin"]["median"]))
        )
    if rows:
        parts += [
            table(("limit", "aim", "probability of missing it (95 %)", "target", "verdict", "median margin"), rows),
            "",
        ]
    broken = _fracture_rows(results.get("fracture") or {})
    if broken:
        parts += [table(("fracture", "value (95 % interval)"), broken), ""]
    rows = []
    for name, entry in results["quantities"].items():
        rows.append((name, "mean", _estimate(entry["mean"], name)))
        rows.append(("", "standard deviation", _estimate(entry["sd"], name)))
        rows += [("", f"{100 * float(p):.12g} % quantile", _estimate(e, name)) for p, e in entry["quantiles"].items()]
        if entry["censored_share"]["value"]:
            rows.append(("", "censored share", _estimate(entry["censored_share"])))
    parts += [table(("quantity", "statistic", "value (95 % interval)"), rows), ""]
    rows = [
        (quantity, name, _estimate(entry["first"][name]), _estimate(entry["total"][name]))
        for quantity, entry in results["sensitivity"].items()
        for name in entry["first"]
        if not entry.get("shapley")
    ]
    if rows:
        parts += [table(("quantity", "input", "first-order index", "total index"), rows), ""]
    rows = [
        (quantity, name, _estimate(effect), *(_estimate(entry["kucherenko"][o][name]) for o in ("first", "total")))
        for quantity, entry in results["sensitivity"].items()
        for name, effect in entry.get("shapley", {}).items()
    ]
    if rows:
        header = ("quantity", "input", "Shapley effect", "Kucherenko, first", "Kucherenko, total")
        parts += [table(header, rows), ""]
    rows = [
        (name, f"{float(p):g}", _estimate(e, entry["solve"]))
        for name, entry in results["margins"].items()
        for p, e in entry["values"].items()
    ]
    if rows:
        solve = next(iter(results["margins"].values()))["solve"]
        parts += [table(("limit", "probability of exceedance", f"at {solve}"), rows), ""]
    cautions = _cautions(results)
    if cautions:
        parts += ["before you rely on it:", *(f"- {text}" for text in cautions), ""]
    model = results["model"]
    parts.append(f"model: {model['chosen']} ({plain(model['why'])})")
    parts += [f"{label}: {plain(text)}" for label, text in savings(model)]
    counts = ", ".join(f"{number:,} {name}" for name, number in model["evaluations"].items())
    parts.append(f"evaluations: {counts}; failed: {model['failures']:,}")
    return "\n".join(parts)
