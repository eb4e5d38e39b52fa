"""The page of a run: what results.json holds, in one template, with figures by matplotlib.

The page computes nothing: every number and every word of judgement is in the results.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import partial
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uqsphere.quantities import lookup
from uqsphere.report import figures
from uqsphere.report.format import (
    Mode,
    Results,
    estimate,
    failure_modes,
    find,
    index,
    meaning,
    of,
    probability,
    short,
    value,
    verdicts,
)
from uqsphere.results.folder import read_results, write_files

if TYPE_CHECKING:
    from markupsafe import Markup

#: a number without an interval
_BARE = {"low": None, "high": None, "note": ""}
#: limits and quantities that get figures of their own; the tables have all of them
MOST_FIGURES = 6
MOST_ROWS, MOST_INPUTS = 16, 40


def page(results: Results) -> str:
    """The page of a run as one self-contained HTML text."""
    html, _ = _rendered(results)
    return html


def write_page(folder: Path) -> Path:
    """Write report.html and the figures of a result folder, from what is stored there.

    Raises FolderError where the folder holds no results, AccessError where it cannot be written.
    """
    html, drawn = _rendered(read_results(folder).model_dump(mode="json"))
    header = '<?xml version="1.0" encoding="utf-8"?>\n'
    files = {
        "report.html": html,
        **{f"figures/{name}.svg": header + text for name, text in drawn.items()},
    }
    write_files(folder, files)
    return folder / "report.html"


def _rendered(results: Results) -> tuple[str, dict[str, str]]:
    from jinja2 import Environment
    from markupsafe import Markup

    drawn = _figures(results)
    template = resources.files("uqsphere.report").joinpath("page.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters["stacked"] = _stacked
    html = environment.from_string(template).render(
        study=results["study"],
        verdicts=verdicts(results),
        modes=_modes(results),
        quantities=_quantities(results),
        indices=_indices(results),
        margins=_margins(results),
        checks=results["checks"],
        accuracy=_accuracy(results),
        inputs=_inputs(results),
        fixed=_fixed(results),
        drivers=_drivers(results),
        assumptions=_assumptions(results),
        fracture=_fracture(results),
        versions=results["versions"],
        dependence=_dependence(results),
        missing=_missing(results),
        meaning=meaning,
        figures={name: Markup(_embedded(text, name, alt)) for name, (alt, text) in drawn.items()},
    )
    return html, {name: text for name, (_, text) in drawn.items()}


def _stacked(text: str) -> Markup:
    """An estimate with its interval below it, none of them broken in the middle."""
    from markupsafe import Markup

    found = re.fullmatch(r"(.*?) \((.+ to .+?)\)(.*)", text)
    if found is None:
        return (
            Markup('<span class="v">{}</span>').format(text)
            if len(text) < 24
            else Markup("{}").format(text)
        )
    return Markup('<span class="v">{}</span><br><small class="v soft">{}</small>').format(
        found[1] + found[3], found[2]
    )


def _embedded(text: str, name: str, alt: str) -> str:
    """An SVG with a text for who cannot see it, and ids of its own: several stand in one page."""
    from markupsafe import escape

    text = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", text)
    text = re.sub(r'(xlink:)?href="#([^"]+)"', rf'\1href="#{name}-\2"', text)
    return text.replace("<svg ", f'<svg role="img" aria-label="{escape(alt)}" ', 1)


def _figures(results: Results) -> dict[str, tuple[str, str]]:
    """By name, what each figure shows in words, and its SVG text."""
    answers, drawn = results["answers"], dict[str, tuple[str, str]]()
    free = results["study"]["free"]
    if free and any(row["answer"] == "curve" for row in answers):
        alt = f"Fragility: probability over {free['meaning']}"
        drawn["fragility"] = (
            alt,
            figures.svg(partial(figures.draw_fragility, results=results), 5.0, 3.3),
        )
    for number, (name, entry) in enumerate(
        list(results["study"]["quantities"].items())[:MOST_FIGURES], 1
    ):
        draw = partial(figures.draw_density, results=results, quantity=name)
        drawn[f"density-{number}"] = (
            f"Density of {short(entry['meaning'])}",
            figures.svg(draw, 3.25, 2.3),
        )
        known = [row for row in of(answers, name, "sobol_total") if row["value"] is not None]
        if known:
            draw = partial(figures.draw_sobol, results=results, quantity=name)
            alt = f"Sobol’ indices of {short(entry['meaning'])}"
            drawn[f"sobol-{number}"] = (
                alt,
                figures.svg(draw, 3.25, 1.0 + 0.32 * min(len(known), 12)),
            )
    if len([row for row in results["accuracy"]["reached"] if row["error"]]) > 1:
        draw = partial(figures.draw_convergence, results=results)
        drawn["convergence"] = (
            "Largest error over tolerance, against model runs",
            figures.svg(draw, 3.25, 2.0),
        )
    return drawn


def _modes(results: Results) -> list[dict[str, str]]:
    """The table of limits and failure modes."""
    rows, answers = [], results["answers"]
    path = (results["study"]["free"] or {}).get("path", "")
    for mode in failure_modes(results):
        entry = mode.entry
        tests = find(answers, mode.subject, "failure_probability", "tests")
        ends = (
            []
            if tests is None
            else [probability({**_BARE, "value": tests[end]}) for end in ("low", "high")]
        )
        sources = {"assumed": "library, not this rock", "tests": f"{entry.get('tests')} tests"}
        rows.append(
            {
                "name": mode.name,
                "mode": entry.get("mode", "together"),
                "demand": short(lookup(entry["quantity"]).meaning) if entry else "",
                "p": probability(mode.fracture),
                "tests": " to ".join(ends),
                "missed": probability(find(answers, mode.subject, "failure_probability"))
                if entry.get("aim") == "break"
                else "",
                "index": "–" if mode.index is None else f"{mode.index:.2f}",
                "margin": "not in the range"
                if mode.margin and mode.margin["value"] is None
                else estimate(mode.margin, path, 3),
                "strength": entry["strength"]["text"] if entry else "–",
                "source": next((text for key, text in sources.items() if entry[key]), "study")
                if entry
                else "–",
            }
        )
    return rows


def _quantities(results: Results) -> list[dict[str, Any]]:
    """Distributions: one row a quantity, with its caution where a check says that it does not
    hold.
    """
    rows, answers = [], results["answers"]
    for number, (name, entry) in enumerate(results["study"]["quantities"].items()):
        quantiles = {row["at"]: row for row in of(answers, name, "quantile")}
        unknown = [
            row["note"] for row in quantiles.values() if row["value"] is None and row["note"]
        ]
        rows.append(
            {
                "name": name,
                "meaning": short(entry["meaning"]),
                "definition": entry["meaning"].partition(": ")[2],
                "number": number + 1,
                "mean": estimate(find(answers, name, "mean"), name),
                "sd": estimate(find(answers, name, "sd"), name, 3),
                "quantiles": {p: estimate(row, name) for p, row in quantiles.items()},
                "caution": unknown[0] if unknown else "",
                "strengths": [
                    n for n, e in results["study"]["limits"].items() if e["quantity"] == name
                ],
            }
        )
    return rows


def _indices(results: Results) -> dict[str, Any]:
    """First-order and total Sobol' indices: a row an input, the largest total first, and two
    columns a quantity.
    """
    answers, columns, largest = results["answers"], [], dict[str, float]()
    methods = {
        "chaos": "from polynomial chaos corrected by model runs",
        "pairs": "from pairs of model runs",
    }
    for number, (name, entry) in enumerate(results["study"]["quantities"].items()):
        total = of(answers, name, "sobol_total")
        if total:
            columns.append(
                {
                    "name": name,
                    "number": number + 1,
                    "meaning": short(entry["meaning"]),
                    "method": methods.get(entry["method_of_indices"], ""),
                    "note": next((row["note"] for row in total if row["value"] is None), ""),
                }
            )
        for row in total:
            largest[row["at"]] = max(
                largest.get(row["at"], -1.0), row["value"] if row["value"] is not None else -1.0
            )
    ranked = sorted(largest, key=lambda at: -largest[at])
    rows = [
        (
            meaning(at, results["inputs"]),
            [
                index(find(answers, column["name"], f"sobol_{order}", at))
                for column in columns
                for order in ("first", "total")
            ],
        )
        for at in ranked[:MOST_ROWS]
    ]
    return {"columns": columns, "rows": rows, "more": max(len(ranked) - MOST_ROWS, 0)}


def _margins(results: Results) -> dict[str, Any] | None:
    """The free number at the probabilities that were asked for, a column for each of the study's
    own limits.
    """
    free, answers = results["study"]["free"], results["answers"]
    names = [
        name
        for name in results["study"]["limits"]
        if free and any(row["value"] is not None for row in of(answers, f"limits.{name}", "margin"))
    ]
    at = sorted(
        {
            row["at"]
            for name in names
            for row in of(answers, f"limits.{name}", "margin")
            if isinstance(row["at"], float)
        }
    )
    rows = []
    for p in at:
        found = [find(answers, f"limits.{name}", "margin", p) for name in names]
        rows.append(
            (probability({**_BARE, "value": p}), [estimate(row, free["path"]) for row in found])
        )
    return {"names": names, "rows": rows} if rows else None


def _assumptions(results: Results) -> list[tuple[str, str, str]]:
    """Failure probabilities with something taken otherwise."""
    return [
        (mode.name, row["at"].removeprefix("assumed: "), probability(row))
        for mode in failure_modes(results)
        for row in of(results["answers"], mode.subject, "failure_probability")
        if str(row["at"]).startswith("assumed: ")
    ]


def _drivers(results: Results) -> dict[str, Any] | None:
    """What drives each failure probability, a column a mode, and the most probable failure by the
    study's limits.
    """
    answers, inputs = results["answers"], results["inputs"]
    changes: dict[str, dict[str, float]] = {}
    modes = []
    for mode in failure_modes(results):
        moved = {row["at"]: row["value"] or 0.0 for row in of(answers, mode.subject, "driver")}
        if any(moved.values()):
            modes.append(mode)
            for name, change in moved.items():
                changes.setdefault("" if name.endswith(".strength") else name, {})[mode.name] = (
                    100.0 * change
                )
    points = [
        (mode, {row["at"]: row["value"] for row in of(answers, mode.subject, "design_point")})
        for mode in modes
    ]
    points = [(mode, known) for mode, known in points if known]

    def at(mode: Mode, known: Mapping[str, float | None], name: str) -> str:
        if name:
            return value(known.get(name), name)
        strength = known.get(f"{mode.subject}.strength")
        return value(None if mode.entry["tests"] else strength, mode.entry["quantity"])

    ranked = sorted(changes, key=lambda name: -max(map(abs, changes[name].values())))[:MOST_ROWS]
    rows = [
        (
            meaning(name, inputs) if name else "strength of the mode",
            [
                f"{changes[name][mode.name]:+.2g}" if mode.name in changes[name] else "–"
                for mode in modes
            ],
            [at(mode, known, name) for mode, known in points],
        )
        for name in ranked
    ]
    heads = [
        mode.name + (": P(not broken)" if mode.entry["aim"] == "break" else "") for mode in modes
    ]
    return (
        {"modes": heads, "points": [mode.name for mode, _ in points], "rows": rows}
        if rows
        else None
    )


def _fracture(results: Results) -> list[tuple[str, str]]:
    """Fracture by any limit: its probability, the share of each, and the state in which it
    comes.
    """
    answers = results["answers"]
    found = find(answers, "fracture", "exceedance_probability")
    if found is None:
        return []
    rows = [("fracture probability by any limit of the study", probability(found))]
    rows += [
        (f"broken by {row['at']} first", probability(row))
        for row in of(answers, "fracture", "mode_share")
    ]
    for name, quantity in (("time", "contact_duration"), ("force", "P_max")):
        row = find(answers, "fracture", f"{name}_at_fracture", 0.5)
        if row is not None:
            rows.append((f"{name} at fracture, median", estimate(row, quantity)))
    return rows


def _accuracy(results: Results) -> dict[str, Any]:
    accuracy = results["accuracy"]
    stopped = {
        "accurate": "as accurate as required",
        "budget": "the budget of model runs ended it",
        "time": "the time budget ended it",
        "no gain": "more runs would not have made it more accurate",
        "interrupted": "it was interrupted",
    }
    return {
        "runs": f"{accuracy['runs']:,}",
        "reused": accuracy["reused"],
        "seconds": f"{accuracy['seconds']:.3g}",
        "stopped": stopped.get(accuracy["stopped"], accuracy["stopped"]),
        "reached": [
            (f"{row['runs']:,}", "–" if row["error"] is None else f"{row['error']:.2g}")
            for row in accuracy["reached"]
        ],
        "missed": [
            f"{meaning(m['subject'])}, {m['answer'].replace('_', ' ')}: half-width "
            f"{m['reached']:.2g}, required "
            f"{m['required']:.2g}"
            for m in accuracy["inaccurate"]
            if m["reached"] is not None
        ],
        "required": accuracy["required"],
    }


def _missing(results: Results) -> str:
    """What a failure probability is of: a sphere that must break fails where it does not."""
    aims = {mode.entry["aim"] for mode in failure_modes(results) if mode.entry}
    if "break" not in aims:
        return "Failure probability"
    return (
        "P(not broken)"
        if aims == {"break"}
        else "Failure probability (of not breaking, where that is the aim)"
    )


def _dependence(results: Results) -> list[str]:
    """What depends on what, and how strongly."""
    ties = results["study"].get("dependence", ())
    return [
        f"{' and '.join(meaning(name, results['inputs']) for name in tie['of'])}: {tie['text']}"
        for tie in ties
    ]


def _inputs(results: Results) -> Sequence[tuple[str, ...]]:
    """Random inputs: name, distribution, mean, standard deviation, 5–95 % range and source."""
    return [
        (
            meaning(name, results["inputs"]),
            entry["distribution"],
            value(entry["mean"], name, 4),
            value(entry["sd"], name),
            f"{value(entry['p05'], name)} to {value(entry['p95'], name)}",
            _source(entry),
        )
        for name, entry in results["inputs"].items()
        if not entry["fixed"]
    ][:MOST_INPUTS]


def _fixed(results: Results) -> dict[str, list[tuple[str, str]]]:
    """Fixed inputs, name and value, by their source."""
    found: dict[str, list[tuple[str, str]]] = {}
    for name, entry in [item for item in results["inputs"].items() if item[1]["fixed"]][
        :MOST_INPUTS
    ]:
        row = meaning(name, results["inputs"]), value(entry["mean"], name, 4)
        found.setdefault(_source(entry), []).append(row)
    return found


def _source(entry: Mapping[str, Any]) -> str:
    return str(entry["source"]) + ("" if entry["source_checked"] else " (source not checked)")
