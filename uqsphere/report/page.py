"""The page of a run: what results.json holds, in one template, with figures by matplotlib.

The page computes nothing: every number and every word of judgement is in the results.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import partial
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uqsphere.report import figures
from uqsphere.report.format import estimate, find, label, meaning, of, probability, short, value
from uqsphere.results.folder import read_results, write_files

if TYPE_CHECKING:
    from markupsafe import Markup

Results = Mapping[str, Any]
#: limits and quantities that get figures of their own; the tables have all of them
MOST_FIGURES = 6
MOST_ROWS = 16


def page(results: Results) -> str:
    """The page of a run as one self-contained HTML text."""
    html, _ = _rendered(results)
    return html


def write_page(folder: Path) -> Path:
    """Write report.html and the figures of a result folder, from what is stored there.

    Raises FolderError where the folder holds no results, AccessError where it cannot be written.
    """
    html, drawn = _rendered(read_results(folder))
    header = '<?xml version="1.0" encoding="utf-8"?>\n'
    files = {"report.html": html, **{f"figures/{name}.svg": header + text for name, text in drawn.items()}}
    write_files(folder, files)
    return folder / "report.html"


def _rendered(results: Results) -> tuple[str, dict[str, str]]:
    from jinja2 import Environment
    from markupsafe import Markup

    drawn = dict(_figures(results))
    template = resources.files("uqsphere.report").joinpath("page.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters["stacked"] = _stacked
    html = environment.from_string(template).render(
        study=results["study"], verdicts=_verdicts(results), modes=_modes(results), quantities=_quantities(results),
        indices=_indices(results), margins=_margins(results), checks=results["checks"], accuracy=_accuracy(results),
        inputs=_inputs(results), fixed=_inputs(results, fixed=True), design=_design_points(results),
        assumptions=_assumptions(results), fracture=_fracture(results), versions=results["versions"],
        dependence=_dependence(results), missing=_missing(results),
        figures={name: Markup(_own_ids(text, name)) for name, text in drawn.items()}, meaning=meaning,
    )  # fmt: skip
    return html, drawn


def _stacked(text: str) -> Markup:
    """An estimate with its interval below it, none of them broken in the middle."""
    from markupsafe import Markup

    found = re.fullmatch(r"(.*?) \((.+ to .+?)\)(.*)", text)
    if found is None:
        return Markup('<span class="v">{}</span>').format(text) if len(text) < 20 else Markup("{}").format(text)
    return Markup('<span class="v">{}</span><br><small class="v soft">{}</small>').format(found[1] + found[3], found[2])


def _own_ids(text: str, name: str) -> str:
    """An SVG whose ids are of its own: several stand in one page."""
    text = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", text)
    text = re.sub(r'(xlink:)?href="#([^"]+)"', rf'\1href="#{name}-\2"', text)
    return text.replace("<svg ", '<svg role="img" aria-hidden="true" ', 1)


def _figures(results: Results) -> list[tuple[str, str]]:
    """Names and SVG texts of all figures that there are."""
    drawn = []
    if results["study"]["free"] and any(row["answer"] == "curve" for row in results["answers"]):
        drawn.append(("fragility", figures.svg(lambda axes: figures.draw_fragility(axes, results), height=3.6)))
    for number, name in enumerate(list(results["study"]["quantities"])[:MOST_FIGURES]):
        drawn.append(
            (
                f"density-{number + 1}",
                figures.svg(partial(figures.draw_density, results=results, quantity=name), 3.25, 2.3),
            )
        )
        known = [row for row in of(results["answers"], name, "sobol_total") if row["value"] is not None]
        if known:
            height = 1.0 + 0.32 * min(len(known), 12)
            drawn.append(
                (
                    f"sobol-{number + 1}",
                    figures.svg(partial(figures.draw_sobol, results=results, quantity=name), 3.25, height),
                )
            )
    if len([row for row in results["accuracy"]["reached"] if row["error"]]) > 1:
        drawn.append(("convergence", figures.svg(lambda axes: figures.draw_convergence(axes, results), 3.25, 2.0)))
    return drawn


def _verdicts(results: Results) -> list[dict[str, Any]]:
    """Verdicts by what they say: limits judged together share one."""
    found: dict[tuple[Any, ...], dict[str, Any]] = {}
    for name, verdict in results["verdicts"].items():
        key = verdict["headline"], verdict["detail"], verdict["aim"]
        if key in found:
            found[key]["limits"].append(name)
        else:
            found[key] = {**verdict, "limits": [name]}
    return list(found.values())


def _subjects(results: Results) -> list[tuple[str, Mapping[str, Any]]]:
    study = results["study"]
    own = [(f"limits.{name}", entry) for name, entry in study["limits"].items()]
    return own + [(f"modes.{name}", entry) for name, entry in study["modes"].items()]


def _modes(results: Results) -> list[dict[str, str]]:
    """The table of limits and failure modes."""
    rows, answers = [], results["answers"]
    free = results["study"]["free"]
    for subject, entry in _subjects(results):
        index = find(answers, subject, "reliability_index")
        target = entry["target"]
        margin = None
        if free is not None:
            own = [v for v in results["verdicts"].values() if v["target"] is not None]
            wanted = target if target is not None else own[0]["target"] if own else None
            if wanted is not None:
                at = wanted if entry["aim"] == "survive" else 1.0 - wanted
                margin = next((r for r in of(answers, subject, "margin") if _close(r["at"], at)), None)
        tests = find(answers, subject, "failure_probability", "tests")
        rows.append({
            "name": label(subject), "mode": entry["mode"], "aim": entry["aim"],
            "p": probability(find(answers, subject, "exceedance_probability")),
            "missed": probability(find(answers, subject, "failure_probability")) if entry["aim"] == "break" else "",
            "tests": "" if tests is None else f"{probability({**tests, 'value': tests['low']}).split(' (')[0]} to "
                     f"{probability({**tests, 'value': tests['high']}).split(' (')[0]}",
            "index": "–" if index is None else f"{index['value']:.2f}",
            "margin": "–" if margin is None else estimate(margin, free["path"], 3),
            "strength": entry["strength"]["text"],
            "source": (f"{entry['tests']} tests" if entry["tests"] else "study") if not entry["assumed"] else
                      "library, not this rock",
        })  # fmt: skip
    return rows


def _close(one: Any, other: float) -> bool:
    return isinstance(one, float) and abs(one - other) <= 1e-9


def _quantities(results: Results) -> list[dict[str, Any]]:
    """Distributions: one row a quantity, with its caution where a check says that it does not hold."""
    rows, answers = [], results["answers"]
    for number, (name, entry) in enumerate(results["study"]["quantities"].items()):
        quantiles = {row["at"]: row for row in of(answers, name, "quantile")}
        unknown = [row["note"] for row in quantiles.values() if row["value"] is None and row["note"]]
        rows.append({
            "name": name, "meaning": short(entry["meaning"]), "definition": entry["meaning"].partition(": ")[2],
            "number": number + 1, "mean": estimate(find(answers, name, "mean"), name),
            "sd": estimate(find(answers, name, "sd"), name, 3),
            "quantiles": {p: estimate(row, name) for p, row in quantiles.items()},
            "caution": unknown[0] if unknown else "",
            "strengths": [n for n, e in results["study"]["limits"].items() if e["quantity"] == name],
        })  # fmt: skip
    return rows


def _indices(results: Results) -> dict[str, Any]:
    """First-order and total Sobol' indices: a row an input, the largest total first, and two columns a quantity."""
    answers, columns, largest = results["answers"], [], dict[str, float]()
    methods = {"chaos": "from polynomial chaos, corrected by model runs", "pairs": "from pairs of model runs"}
    for number, (name, entry) in enumerate(results["study"]["quantities"].items()):
        total = of(answers, name, "sobol_total")
        if total:
            columns.append({"name": name, "number": number + 1, "meaning": short(entry["meaning"]),
                            "method": methods.get(entry["method_of_indices"], ""),
                            "note": next((row["note"] for row in total if row["value"] is None), "")})  # fmt: skip
        for row in total:
            largest[row["at"]] = max(largest.get(row["at"], -1.0), row["value"] if row["value"] is not None else -1.0)
    ranked = sorted(largest, key=lambda at: -largest[at])
    rows = [(meaning(at, results["inputs"]), [estimate(find(answers, column["name"], f"sobol_{order}", at), "", 3)
                                              for column in columns for order in ("first", "total")])
            for at in ranked[:MOST_ROWS]]  # fmt: skip
    return {"columns": columns, "rows": rows, "more": max(len(ranked) - MOST_ROWS, 0)}


def _margins(results: Results) -> list[dict[str, Any]]:
    """The free number at the probabilities that were asked for, of the study's own limits."""
    free = results["study"]["free"]
    if free is None:
        return []
    tables = []
    for name in results["study"]["limits"]:
        rows = [row for row in of(results["answers"], f"limits.{name}", "margin") if isinstance(row["at"], float)]
        if rows:
            tables.append(
                {
                    "name": name,
                    "rows": [
                        (
                            probability({"value": r["at"], "low": None, "high": None, "note": ""}),
                            estimate(r, free["path"]),
                        )
                        for r in rows
                    ],
                }
            )
    return tables


def _assumptions(results: Results) -> list[tuple[str, str, str]]:
    """Failure probabilities with something taken otherwise."""
    rows = []
    for subject, _ in _subjects(results):
        for row in of(results["answers"], subject, "failure_probability"):
            if isinstance(row["at"], str) and row["at"].startswith("assumed: "):
                rows.append((label(subject), row["at"].removeprefix("assumed: "), probability(row)))
    return rows


def _design_points(results: Results) -> list[dict[str, Any]]:
    """The most probable failure of every limit, and what drives its failure probability."""
    tables = []
    for subject, entry in _subjects(results):
        if entry["assumed"]:
            continue
        points = {row["at"]: row for row in of(results["answers"], subject, "design_point")}
        drivers = sorted(of(results["answers"], subject, "driver"), key=lambda row: -abs(row["value"] or 0.0))
        rows = []
        for row in drivers[:8]:
            name, point = row["at"], points.get(row["at"])
            unit_name = entry["quantity"] if name.endswith(".strength") else name
            change = "–" if row["value"] is None else f"{100.0 * row['value']:+.2g}"
            at = (
                "–"
                if point is None or (name.endswith(".strength") and entry["tests"])
                else value(point["value"], unit_name)
            )
            rows.append((meaning(name, results["inputs"]), change, at))
        if rows:
            tables.append({"name": label(subject), "rows": rows, "breaks": entry["aim"] == "break"})
    return tables


def _fracture(results: Results) -> list[tuple[str, str]]:
    """Fracture by any limit: its probability, the share of each, and the state in which it comes."""
    answers = results["answers"]
    found = find(answers, "fracture", "exceedance_probability")
    if found is None:
        return []
    rows = [("fracture probability by any limit of the study", probability(found))]
    rows += [(f"broken by {row['at']} first", probability(row)) for row in of(answers, "fracture", "mode_share")]
    for name, quantity in (("time", "contact_duration"), ("force", "P_max")):
        row = find(answers, "fracture", f"{name}_at_fracture", 0.5)
        if row is not None:
            rows.append((f"{name} at fracture, median", estimate(row, quantity)))
    return rows


def _accuracy(results: Results) -> dict[str, Any]:
    accuracy = results["accuracy"]
    stopped = {"accurate": "as accurate as required", "budget": "the budget of model runs ended it",
               "time": "the time budget ended it", "no gain": "more runs would not have made it more accurate",
               "interrupted": "it was interrupted"}  # fmt: skip
    return {
        "runs": f"{accuracy['runs']:,}", "reused": accuracy["reused"], "seconds": f"{accuracy['seconds']:.3g}",
        "stopped": stopped.get(accuracy["stopped"], accuracy["stopped"]),
        "reached": [(f"{row['runs']:,}", "–" if row["error"] is None else f"{row['error']:.2g}")
                    for row in accuracy["reached"]],
        "missed": [f"{meaning(m['subject'])}, {m['answer'].replace('_', ' ')}: half-width {m['reached']:.2g}, required "
                   f"{m['required']:.2g}" for m in accuracy["missed"] if m["reached"] is not None],
        "required": accuracy["required"],
    }  # fmt: skip


def _missing(results: Results) -> str:
    """What a failure probability is of: a sphere that must break fails where it does not."""
    aims = {entry["aim"] for _, entry in _subjects(results)}
    if "break" not in aims:
        return "Failure probability"
    return "P(not broken)" if aims == {"break"} else "Failure probability (of not breaking, where that is the aim)"


def _dependence(results: Results) -> list[str]:
    """What depends on what, and how strongly."""
    ties = results["study"].get("dependence", ())
    return [f"{' and '.join(meaning(name, results['inputs']) for name in tie['of'])}: {tie['text']}" for tie in ties]


def _inputs(results: Results, *, fixed: bool = False) -> list[tuple[str, ...]]:
    """Random inputs with their distribution and 5–95 % range, or the fixed ones; sources that nobody checked say so."""
    rows: list[tuple[str, ...]] = []
    for name, entry in results["inputs"].items():
        if entry["fixed"] is not fixed:
            continue
        source = entry["source"] if entry["source_checked"] else f"{entry['source']} (source not checked)"
        middle = value(entry["mean"], name, 4)
        if fixed:
            rows.append((meaning(name, results["inputs"]), middle, source))
        else:
            ends = f"{value(entry['p05'], name)} to {value(entry['p95'], name)}"
            rows.append(
                (
                    meaning(name, results["inputs"]),
                    entry["distribution"],
                    middle,
                    value(entry["sd"], name),
                    ends,
                    source,
                )
            )
    return rows
