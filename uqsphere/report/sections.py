"""The tables of the report, as rows of texts that the template sets."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from uqsphere.quantities import OUTPUTS, lookup
from uqsphere.report.contents import Contents
from uqsphere.report.figures import ranked
from uqsphere.report.verdict import check_name
from uqsphere.report.wording import (
    ABSENT,
    absent_reason,
    call,
    capital,
    estimate_text,
    input_name,
    limit_name,
    number_text,
    plain_percent,
    probability_range,
    probability_text,
    symbol,
    unit_text,
    value_text,
)
from uqsphere.runner.results import savings

#: quantities that the end of the record can cut short
_RECORDED = frozenset({"contact_time", "pulse_width"})

__all__ = [
    "Table",
    "accuracy_table",
    "checks_table",
    "fixed_table",
    "index_table",
    "inputs_table",
    "limits_table",
    "margins_table",
    "model_table",
    "paper_table",
    "quantity_table",
    "repeat_rows",
]


@dataclass(frozen=True, kw_only=True)
class Table:
    """A caption, a header and rows of texts; the first column heads its row."""

    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def _cell(estimate: Mapping[str, Any], name: str = "", *, probability: bool = False) -> str:
    if estimate["value"] is None:
        return f"{ABSENT} ({absent_reason(estimate)})"
    return probability_text(estimate) if probability else estimate_text(estimate, name)


def quantity_table(contents: Contents, quantity: str) -> Table:
    """Mean, standard deviation, quantiles and censored share with their intervals."""
    entry = contents.results["quantities"][quantity]
    mean, sd = entry["mean"]["value"], entry["sd"]["value"]
    spread = _cell(entry["sd"], quantity)
    if mean is not None and sd is not None and sd < 1e-9 * abs(mean):
        spread = "none seen"
    rows = [("mean", _cell(entry["mean"], quantity)), ("standard deviation", spread)]
    if spread != "none seen" or entry["censored_share"]["value"]:
        rows += [(f"{100.0 * float(p):g} % quantile", _cell(e, quantity)) for p, e in entry["quantiles"].items()]
    if entry["censored_share"]["value"] or quantity in _RECORDED:
        rows.append(("share that outlasts the record", _cell(entry["censored_share"], probability=True)))
    return Table(
        caption=f"{symbol(quantity)}: values with 95 % intervals",
        header=("", "value (95 % interval)"),
        rows=tuple(rows),
    )


def index_table(contents: Contents, quantity: str) -> Table | None:
    """First and total indices with intervals."""
    entry = contents.results["sensitivity"].get(quantity)
    names = ranked(entry)
    if not names or entry is None:
        return None
    rows = [(input_name(n), _cell(entry["first"][n]), _cell(entry["total"][n])) for n in names]
    methods = sorted({str(entry["total"][n]["method"]) for n in names})
    return Table(
        caption=f"Sobol’ indices of {symbol(quantity)} with 95 % intervals, by {' and '.join(methods)}",
        header=("input", "first (alone)", "total (with interactions)"),
        rows=tuple(rows),
    )


def limits_table(contents: Contents) -> Table:
    """Probabilities, reliability index and margin of every limit."""
    rows: list[tuple[str, ...]] = []
    for name, limit in contents.results["limits"].items():
        index = limit["reliability_index"]
        low, high = limit.get("reliability_index_interval") or (None, None)
        beta = ABSENT if index is None else _cell({"value": index, "low": low, "high": high})
        rows += [
            (limit_name(name), "probability of exceeding the strength", _cell(limit["exceedance"], probability=True)),
            (
                limit_name(name),
                f"probability of missing the aim ({limit['aim']})",
                _cell(limit["miss"], probability=True),
            ),
            (limit_name(name), "reliability index", beta),
        ]
        opened = limit.get("ignorance")
        if opened:
            text = ABSENT if "reason" in opened else probability_range(*opened["miss"]) + " (95 %)"
            rows.append((limit_name(name), "probability of missing the aim that the tests leave open", text))
        words = {"median": "margin, median", "0.05": "margin, 5 %", "0.95": "margin, 95 %"}
        rows += [(limit_name(name), words.get(k, k), _cell(e)) for k, e in limit["margin"].items()]
        rows += _design_rows(name, limit)
    return Table(caption="Limits with 95 % intervals", header=("limit", "", "value (95 % interval)"), rows=tuple(rows))


def _design_rows(name: str, limit: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """How many ways there are to miss the aim, and what the methods say; a design point has a table of its own."""
    rows: list[tuple[str, ...]] = []
    if not limit.get("design_point") and limit.get("design_point_reason"):
        rows.append((limit_name(name), "design point", f"{ABSENT} ({limit['design_point_reason']})"))
    if limit.get("modes"):
        rows.append((limit_name(name), "separate ways to miss the aim", str(limit["modes"])))
    return rows + [(limit_name(name), "check", str(text)) for text in limit.get("checks") or ()]


def margins_table(contents: Contents, name: str) -> Table:
    """Values of the free scalar at the probabilities asked for."""
    entry = contents.results["margins"][name]
    solve = entry["solve"]
    subject = contents.subject(solve)
    rows = tuple((plain_percent(float(p)), _cell(e, subject)) for p, e in entry["values"].items())
    return Table(
        caption=f"{capital(input_name(solve))} at which {limit_name(name)} is exceeded with a given probability",
        header=("probability", "value (95 % interval)"),
        rows=rows,
    )


def checks_table(contents: Contents) -> Table:
    """Validity checks, graded, with the share of the samples that break each."""
    rows = []
    for check in contents.results["validity"]:
        shares = [(grade, check.get(f"share_{grade}", 0.0)) for grade in ("failure", "warning", "information")]
        broken = [f"{plain_percent(share)} {grade}" for grade, share in shares if share > 0.0]
        grade = next((grade for grade, share in shares if share > 0.0), "ok")
        if check["worst"] is None and grade == "ok":
            grade = "not checked"
        rows.append((check_name(check["check"]), grade, ", ".join(broken) or "none", str(check["text"])))
    return Table(
        caption="Assumptions of the model, checked on a pilot sample",
        rows=tuple(rows),
        header=("assumption", "grade", "share of samples", "finding"),
    )


def paper_table(contents: Contents) -> Table | None:
    """The paper's formulas as printed beside the corrected and the full answers."""
    found = contents.results.get("paper") or []
    rows = []
    for row in found:
        name = row["quantity"] if row["quantity"] in OUTPUTS else ""
        texts = [_paper_number(row[key], name, row["unit"]) for key in ("as_printed", "corrected", "full")]
        off = ABSENT
        if row["as_printed"] is not None and row["full"]:
            off = number_text(f"{100.0 * (row['as_printed'] / row['full'] - 1.0):+.3g}") + " %"
        rows.append((str(row["quantity"]).replace("_", " ") if not name else call(name), *texts, off, str(row["note"])))
    if not rows:
        return None
    return Table(
        caption="At the means of the inputs",
        rows=tuple(rows),
        header=("quantity", "as printed", "corrected", "full model", "printed against full", "note"),
    )


#: SI unit -> a named quantity with that unit's display, for rows that are no quantity of interest
_LIKE = {"Pa": "p_max", "N": "P_max", "m": "alpha_max", "s": "contact_time", "J": "energy"}


def _paper_number(value: float | None, name: str, unit: str) -> str:
    return ABSENT if value is None else value_text(value, name or _LIKE.get(unit, ""), 5)


# --- inputs ---------------------------------------------------------------------------------------

_BARE = frozenset({"cov", "modulus", "shape", "alpha", "beta", "dof", "log_mean", "log_sd", "bandwidth"})
_WORDS = {
    "sd": "standard deviation",
    "cov": "coefficient of variation",
    "dof": "degrees of freedom",
    "log_mean": "mean of the logarithm (SI)",
    "log_sd": "standard deviation of the logarithm",
}


def _law_text(contents: Contents, name: str) -> str:
    law = contents.resolved["random"][name]
    subject = contents.subject(name)
    given = law["given"] or law["parameters"]
    parts = []
    for key, value in given.items():
        if key == "rate":
            unit = unit_text(lookup(subject).unit)
            parts.append(f"rate {value:.6g}" + (f" per {unit}" if unit else ""))
        elif isinstance(value, (int, float)):
            parts.append(
                f"{_WORDS.get(key, key)} " + (f"{value:.6g}" if key in _BARE else value_text(value, subject, 6))
            )
    bounded = law["dist"] in ("uniform", "loguniform", "triangular", "beta")
    for key, word in (
        ("lower", "from" if bounded else "cut off below"),
        ("upper", "to" if bounded else "cut off above"),
    ):
        if law[key] is not None:
            parts.append(f"{word} {value_text(law[key], subject, 6)}")
    if law["data"]:
        stopped = len(law.get("censored", ()))
        parts.append(f"{len(law['data'])} observations" + (f" and {stopped} stopped before" if stopped else ""))
    return ", ".join([str(law["dist"]).replace("_", " "), *parts])


def _source(contents: Contents, name: str) -> str:
    source = contents.resolved.get("sources", {}).get(name)
    if source is None:
        return "stated in the study"
    return str(source["text"]) + ("" if source["seen"] else " [source not seen: taken on the word of others]")


def inputs_table(contents: Contents) -> Table:
    """Random inputs with their laws; mean and standard deviation are those of the law in force."""
    rows = []
    for name, entry in contents.results["inputs"].items():
        subject = contents.subject(name)
        rows.append(
            (
                f"{input_name(name)}",
                _law_text(contents, name),
                value_text(entry["mean"], subject, 5),
                value_text(entry["sd"], subject, 4),
                _source(contents, name),
            )
        )
    return Table(
        caption="Random inputs", header=("input", "law", "mean in force", "sd in force", "source"), rows=tuple(rows)
    )


def fixed_table(contents: Contents) -> Table | None:
    """Fixed numbers and choices of the scene with their sources."""
    rows = [
        (input_name(name), value_text(value, name, 6), _source(contents, name))
        for name, value in contents.resolved["fixed"].items()
    ]
    for name, value in contents.resolved.get("options", {}).items():
        text = {True: "yes", False: "no"}.get(value, str(value)) if isinstance(value, bool) else str(value)
        rows.append(
            (name.replace(".", ": ").replace("_", " "), text.replace("_", " "), "stated in the study or default")
        )
    rows += [
        (
            f"material of the {'sphere' if part == 'sphere' else 'bars'}",
            str(material).replace("_", " "),
            "material library",
        )
        for part, material in contents.resolved.get("materials", {}).items()
    ]
    if not rows:
        return None
    return Table(caption="Fixed numbers", header=("input", "value", "source"), rows=tuple(rows))


def dependence_texts(contents: Contents) -> list[str]:
    """The rank correlations in sentences."""
    texts = []
    for group in contents.resolved.get("dependence", []):
        named = [(f"{key.capitalize()} rank correlation", group.get(key)) for key in ("spearman", "kendall")]
        strength = next((f"{word} {value:g}" for word, value in named if value is not None), "dependent")
        copula = str(group["copula"]).replace("_", " ").capitalize()
        freedom = f" with {group['dof']:g} degrees of freedom" if group.get("dof") else ""
        texts.append(f"{' and '.join(input_name(n) for n in group['of'])}: {strength}, {copula} copula{freedom}.")
    return texts


# --- what was asked, the model, how to repeat ---------------------------------------------------------


def _half(estimate: Mapping[str, Any]) -> float | None:
    if estimate["value"] is None or estimate["low"] is None or estimate["high"] is None:
        return None
    return 0.5 * float(estimate["high"] - estimate["low"])


def accuracy_table(contents: Contents) -> Table:
    """Half-widths asked and reached, one row per question."""
    asked = contents.resolved["analysis"]["accuracy"]
    rows: list[tuple[str, ...]] = []

    def add(question: str, reached: float | None, allowed: float) -> None:
        # rounding must not turn a miss into a hit
        verdict = ABSENT if reached is None else ("reached" if reached <= allowed else "not reached")
        rows.append((question, f"{allowed:g}", ABSENT if reached is None else number_text(f"{reached:.2g}"), verdict))

    for name, entry in contents.results["quantities"].items():
        sd = entry["sd"]["value"]
        widths = [w for w in map(_half, entry["quantiles"].values()) if w is not None]
        mean = _half(entry["mean"])
        add(
            f"mean of {symbol(name)}, over its standard deviation",
            mean / sd if sd and mean is not None else None,
            asked["mean"],
        )
        add(
            f"worst quantile of {symbol(name)}, over its standard deviation",
            max(widths) / sd if sd and widths else None,
            asked["quantile"],
        )
    for name, entry in contents.results["sensitivity"].items():
        found = [entry["first"], entry["total"], entry.get("shapley") or {}, *(entry.get("kucherenko") or {}).values()]
        widths = [w for table in found for w in map(_half, table.values()) if w is not None]
        kind = "Shapley effect or index" if entry.get("shapley") else "Sobol’ index"
        add(f"worst {kind} of {symbol(name)}", max(widths, default=None), asked["sobol"])
    for name, limit in contents.results["limits"].items():
        width, value = _half(limit["miss"]), limit["miss"]["value"]
        add(
            f"probability of missing {limit_name(name)}, over itself",
            width / value if width is not None and value else None,
            asked["probability"],
        )
    return Table(
        caption="Half-widths of the 95 % intervals, asked and reached",
        rows=tuple(rows),
        header=("question", "asked", "reached", ""),
    )


def model_table(contents: Contents) -> Table:
    """Model chosen, why, its measured error, its evaluations, the scene's numbers."""
    model = contents.results["model"]
    rows = [("model", str(model["chosen"])), ("why", str(model["why"]))]
    for name, error in model["measured_error"].items():
        text = (
            ABSENT + " (could not be measured)"
            if error is None
            else number_text(f"{error:.2g}") + " standard deviations"
        )
        rows.append((f"measured error of {symbol(name)}", text))
    rows += _ladder_rows(model)
    rows += [(f"evaluations, {name}", _thousands(number)) for name, number in model["evaluations"].items()]
    rows.append(("failed evaluations", _thousands(model["failures"])))
    if model.get("undecided"):
        rows.append(("evaluations with two possible answers", _thousands(model["undecided"])))
    for key, label, like in (
        ("mu_median", "mass number μ, median", ""),
        ("theta_median", "pulse number θ = t_i/t_c, median", ""),
        ("P_0_median", "force scale P_0 = Z v_0/2, median", "P_max"),
        ("t_c_median", "time scale t_c, median", "contact_time"),
    ):
        if key in model.get("numbers", {}):
            rows.append((label, value_text(model["numbers"][key], like)))
    return Table(caption="How the answers were computed", header=("", ""), rows=tuple(rows))


def _ladder_rows(model: dict[str, Any]) -> list[tuple[str, str]]:
    """What was considered beside the model that was chosen, and what the choice saved."""
    rows = []
    for name, seen in model.get("considered", {}).items():
        errors = [error for error in seen["error"].values() if error is not None]
        ties = [tie for tie in seen["correlation"].values() if tie is not None]
        text = f"costs {seen['cost']:.2g} of the full model"
        if errors:
            text = f"errs by up to {max(errors):.2g} standard deviations, {text}"
        if ties:
            text += f"; correlation with it at least {min(ties):.4g}"
        rows.append((f"considered: {name}", text))
    return rows + savings(model)


def _thousands(number: float) -> str:
    return f"{number:,.0f}".replace(",", "\u202f")


def repeat_rows(contents: Contents) -> list[tuple[str, str]]:
    """What another must know to get the same numbers."""
    results, manifest = contents.results, contents.manifest
    rows = [
        ("study", str(results["study"]["hash"])),
        ("seed", str(results["study"]["seed"])),
        ("versions", ", ".join(f"{k} {v}" for k, v in results["versions"].items())),
    ]
    if "platform" in manifest:
        rows.append(("machine", " ".join(str(v) for v in manifest["platform"].values())))
    if "evaluations" in manifest:
        again = manifest.get("evaluations_reused", 0)
        rows.append(
            (
                "evaluations",
                _thousands(manifest["evaluations"]) + (f", {_thousands(again)} of them stored before" if again else ""),
            )
        )
    total = manifest.get("seconds", {}).get("total")
    if total is not None:
        rows.append(("time", f"{total:.3g} s"))
    budget = contents.resolved["analysis"]["budget"]
    rows.append(("budget", f"{_thousands(budget['evaluations'])} evaluations, {budget['time']:g} s"))
    return rows


def commands(contents: Contents) -> Sequence[str]:
    """The commands that repeat the run from its own folder, and build this page again."""
    reference = contents.resolved.get("model_reference") or "FILE.py:FUNCTION"
    model = f" --model {shlex.quote(str(reference))}" if contents.black_box else ""
    changed = "".join(f" --set {shlex.quote(str(text))}" for text in contents.resolved.get("overrides", ()))
    return (f"uqsphere run study.toml --out again{changed}{model}", "uqsphere report .")
