"""The answers of a run for the terminal: a table of what was asked, and what to be cautious about."""

from __future__ import annotations

from typing import Any

from uqsphere.console import bar, plain, table
from uqsphere.quantities import format_estimate
from uqsphere.report.event import at_most, safe_side
from uqsphere.report.granted import instead_text, verdict_word
from uqsphere.report.margin_verdict import margin_answer, subject_of

__all__ = ["summary_of"]

#: inputs of a quantity or limit that get a line
_MOST = 6


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
                f"between {_share(low)} and {_share(high)}{also}"
            )
    found += [*_assumed(results), *_answer_checks(results)]
    missed = results["accuracy"]["missed"]
    if missed:
        found.append(f"{len(missed)} accuracies were not reached, among them {plain(missed[0])}")
    return found


def _assumed(results: dict[str, Any]) -> list[str]:
    """What the probability of each limit would be without what is assumed of its strength."""
    found = []
    for name, limit in results["limits"].items():
        for row in limit.get("assumed") or ():
            if row["miss"]["value"] is None:
                continue
            turned = limit["target"] is not None and row["met"] != limit["met"]
            if row["assumption"] == "dependence" or (turned and row["assumption"] != "law"):
                word = f": target {verdict_word(row['met'])}" if limit["target"] is not None else ""
                found.append(
                    f"limit {plain(name)}: {plain(instead_text(row))} the probability of missing it would be "
                    f"{row['miss']['value']:.3g}{word}"
                )
    return found


def _answer(results: dict[str, Any], name: str) -> str:
    """The answer of an inverse question, rounded to the safe side as everywhere."""
    entry = results["margins"][name]
    most = at_most(entry, results["limits"][name]["aim"])
    return safe_side(entry["value"], subject_of(results, entry["solve"]), at_most=most)


def _answer_checks(results: dict[str, Any]) -> list[str]:
    """Where the model does not hold at the answers of inverse questions."""
    return [
        f"at the answer for {plain(name)}, {entry['solve']} {_answer(results, name)}: {plain(check['text'])}"
        for name, entry in results["margins"].items()
        for told in [entry.get("validity") or {}]
        for check in told.get("checks", ())
        if check["check"].startswith("bar_yield") and check["share"] > 0.0
    ]


def _share(probability: float) -> str:
    """Two figures of a probability; close to 1 of what is missing, so that 0.9999 does not read as certain."""
    if 0.99 <= probability < 1.0:
        return f"1 - {1.0 - probability:.2g}"
    return f"{probability:.2g}"


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
        ("t10", "median product fineness t10", "t10"),
    ):
        if key in found:
            rows.append((words if key == "t10" else f"{words} at fracture", _estimate(found[key]["median"], like)))
    if found.get("reason"):
        rows.append(("not known further", plain(found["reason"])))
    return rows


def _verdicts(results: dict[str, Any]) -> list[str]:
    """A line for every limit: the verdict in words first, then probability, target and margin."""
    rows = []
    for name, limit in results["limits"].items():
        words = {True: "met", False: "NOT MET", None: "undecided"}
        verdict = words[limit["met"]] if limit["target"] is not None else "no target"
        target = f"{limit['target']:g}" if limit["target"] is not None else "-"
        rows.append(
            (verdict, name, limit["aim"], _estimate(limit["miss"]), target, _estimate(limit["margin"]["median"]))
        )
    header = ("verdict", "limit", "aim", "probability of missing it (95 %)", "target", "median margin")
    return [table(header, rows), ""] if rows else []


def _first_reason(texts: list[str]) -> str:
    return next((text for text in texts if text), "")


def _specimens(count: int) -> str:
    return f"{count:,} specimen{'' if count == 1 else 's'}"


def _governing(results: dict[str, Any]) -> list[str]:
    """What each limit hangs on, and what to measure first."""
    rows: list[tuple[str, ...]] = []
    for name, limit in results["limits"].items():
        called, shares = name, limit.get("governing_inputs") or {}
        for key in sorted(shares, key=lambda key: -shares[key])[:_MOST]:
            rows.append((called, key, f"{shares[key]:6.1%}", bar(shares[key])))
            called = ""
        first = (limit.get("measure_first") or {}).get("rows") or []
        if first:
            rows.append((called, "measure first", first[0]["input"], _specimens(first[0]["tests"])))
    return [table(("limit", "hangs on", "share", ""), rows), ""] if rows else []


def _drivers(results: dict[str, Any]) -> list[str]:
    """Shares of the variance as bars, the largest first; Shapley effects where inputs depend on each other."""
    rows: list[tuple[str, ...]] = []
    absent = []
    for quantity, entry in results["sensitivity"].items():
        shared = entry.get("shapley") or {}
        order = shared or entry["total"]
        known = sorted((n for n in order if order[n]["value"] is not None), key=lambda n: -order[n]["value"])
        if not known:
            reason = _first_reason([str(e.get("reason") or "") for e in order.values()])
            absent.append(f"{quantity}: what drives it is not known ({plain(reason)})" if reason else "")
        for place, name in enumerate(known[:_MOST]):
            first = "-" if shared else _estimate(entry["first"][name])
            rows.append(
                (quantity if place == 0 else "", name, bar(order[name]["value"]), _estimate(order[name]), first)
            )
        if len(known) > _MOST:
            rows.append(("", f"({len(known) - _MOST} more)", "", "", ""))
    header = ("quantity", "input", "share of the variance", "total index or Shapley effect", "first-order index")
    parts = [table(header, rows), ""] if rows else []
    found = [text for text in absent if text]
    return [*parts, *found, ""] if found else parts


def _over_energy(results: dict[str, Any]) -> list[str]:
    """The curves over the specific energy: values, median and dispersion, or why there are none."""
    rows: list[tuple[str, ...]] = []
    for name, entry in results["margins"].items():
        found = entry.get("against")
        if not found:
            continue
        if found.get("reason"):
            rows.append((name, "", f"none ({plain(found['reason'])})"))
        rows += [(name, f"{float(p):g}", _estimate(e, found["quantity"])) for p, e in found["values"].items()]
        fitted = found.get("lognormal") or {}
        if fitted.get("median"):
            rows.append((name, "median of the lognormal curve", _estimate(fitted["median"], found["quantity"])))
            rows.append((name, "dispersion", _estimate(fitted["dispersion"])))
    return [table(("limit", "probability of exceedance", "at specific energy"), rows), ""] if rows else []


def summary_of(results: dict[str, Any]) -> str:
    """The answers of a run for the terminal: verdicts, what they hang on, quantities, drivers, margins, cautions."""
    from uqsphere.runner.results import savings

    answers = [plain(text) for name in results["margins"] if (text := margin_answer(results, name))]
    parts = [plain(results["study"]["title"]), "", *answers, *([""] if answers else [])]
    parts += [*_verdicts(results), *_governing(results)]
    broken = _fracture_rows(results.get("fracture") or {})
    if broken:
        parts += [table(("fracture", "value (95 % interval)"), broken), ""]
    rows: list[tuple[str, ...]] = []
    for name, entry in results["quantities"].items():
        rows.append((name, "mean", _estimate(entry["mean"], name)))
        rows.append(("", "standard deviation", _estimate(entry["sd"], name)))
        rows += [("", f"{100 * float(p):.12g} % quantile", _estimate(e, name)) for p, e in entry["quantiles"].items()]
        if entry["censored_share"]["value"]:
            rows.append(("", "censored share", _estimate(entry["censored_share"])))
    parts += [table(("quantity", "statistic", "value (95 % interval)"), rows), "", *_drivers(results)]
    rows = [
        (name, f"{float(p):g}", _estimate(e, subject_of(results, entry["solve"])))
        for name, entry in results["margins"].items()
        for p, e in entry["values"].items()
    ]
    if rows:
        solve = next(iter(results["margins"].values()))["solve"]
        parts += [table(("limit", "probability of exceedance", f"at {solve}"), rows), ""]
    parts += _over_energy(results)
    cautions = _cautions(results)
    if cautions:
        parts += ["before you rely on it:", *(f"- {text}" for text in cautions), ""]
    model = results["model"]
    parts.append(f"model: {model['chosen']} ({plain(model['why'])})")
    parts += [f"{label}: {plain(text)}" for label, text in savings(model)]
    counts = ", ".join(f"{number:,} {name}" for name, number in model["evaluations"].items())
    parts.append(f"evaluations: {counts}; failed: {model['failures']:,}")
    return "\n".join(parts)
