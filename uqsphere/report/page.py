"""The page of a run: what results.json holds, in one template, with figures by matplotlib.

The page computes nothing: every number is in the results.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uqsphere.quantities import format_probability, format_value
from uqsphere.report import figures
from uqsphere.report.figures import Picture
from uqsphere.report.format import (
    DASH,
    ModeRow,
    capital,
    complement,
    estimate,
    index,
    keep_units,
    label,
    meaning,
    mode_rows,
    paper_cells,
    probability,
    short,
    table_of,
    value,
)
from uqsphere.report.sentences import (
    METHODS,
    NO_LIMIT,
    STOPPED,
    as_event,
    check_text,
    damage_modes,
    decision_texts,
    doubt_text,
    evidence_texts,
    exceedance_name,
    listed,
    shortfall_text,
)
from uqsphere.results.folder import read_results, write_files
from uqsphere.results.types import Decision, Doubt, InputEntry, Kind, Range, Results

if TYPE_CHECKING:
    from markupsafe import Markup

#: quantities on the first screen, those with pictures, and rows of a table
FIRST, MOST_PICTURES = 2, 6
MOST_ROWS, MOST_INPUTS, MOST_SHORTFALLS = 16, 40, 8
#: files beside the page that it links to, where they are
LINKED = ("answers.csv", "samples.csv", "results.json", "study.toml")


@dataclass(frozen=True, kw_only=True)
class PageTable:
    """A table of the page: caption, heads, rows of texts, and the rows that are marked."""

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    marked: Sequence[int] = field(default=())
    note: str = ""


def page(results: Results, files: Sequence[str] = ()) -> str:
    """The page of a run as one self-contained HTML text, with links to `files` beside it."""
    return _render(results, _pictures(results), files)


def write_page(folder: Path) -> Path:
    """Write report.html and the figures of a results directory, from what is stored there.

    Raises FolderError where it holds no results, AccessError where it cannot be written.
    """
    names = [name for name in LINKED if (folder / name).is_file()]
    write_files(folder, page_files(read_results(folder), names))
    return folder / "report.html"


def page_files(results: Results, names: Sequence[str]) -> dict[str, str]:
    """The page of a run and its figures, by the names of their files; it links to `names`."""
    pictures = _pictures(results)
    figures = {f"figures/{name}.svg": picture.svg for name, picture in pictures.items()}
    linked = [*(name for name in LINKED if name in names), *figures]
    header = '<?xml version="1.0" encoding="utf-8"?>\n'
    page = _render(results, pictures, linked)
    return {"report.html": page, **{name: header + svg for name, svg in figures.items()}}


def notebook_html(results: Results) -> str:
    """Decisions, figures and tables of a run, for a notebook's cell."""
    pictures = _pictures(results)
    return render(
        "notebook.html",
        title=results.study.title,
        decisions=decision_texts(results),
        no_limit=NO_LIMIT,
        pictures=pictures,
        first=_first(results, pictures),
        limits=_limits(results),
        quantities=_quantities(results),
        indices=_indices(results),
    )


def render(template: str, **variables: Any) -> str:
    """A template of this package as HTML in which units keep their numbers."""
    from jinja2 import Environment, PackageLoader

    environment = Environment(
        loader=PackageLoader("uqsphere", "report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"cell": _cell, "linked": _linked, "inline": _inline}
    html = environment.get_template(template).render(**variables)
    # texts only: the places of a path have blanks too
    return re.sub(r">[^<]+<", lambda text: keep_units(text[0]), html)


def _render(results: Results, pictures: dict[str, Picture], files: Sequence[str]) -> str:
    study, accuracy = results.study, results.accuracy
    margins = [_margins(results), _fracture(results), *_drivers(results)]
    return render(
        "page.html",
        title=study.title,
        study=study,
        decisions=decision_texts(results),
        no_limit=NO_LIMIT,
        chart=[name for name in pictures if name.startswith("fragility")],
        first=_first(results, pictures),
        pictures=pictures,
        certificates=[_certificate(results, decision) for decision in results.decisions],
        limits=_limits(results),
        quantities=_quantities(results),
        notes=_quantity_notes(results),
        indices=_indices(results),
        checks=results.checks,
        check_text=check_text,
        assumptions=_assumptions(results),
        evidence=evidence_texts(results),
        margins=[table for table in margins if table is not None],
        paper=_paper(results),
        accuracy=accuracy,
        stopped=STOPPED[accuracy.stopped],
        reached=_reached(results),
        shortfalls=list(map(shortfall_text, accuracy.inaccurate[:MOST_SHORTFALLS])),
        inputs=_random_inputs(results),
        fixed=_fixed_inputs(results),
        dependence=_dependence(results),
        versions=results.versions,
        files=files,
    )


# --- HTML -----------------------------------------------------------------------------------------


def _cell(text: str) -> Markup:
    """A text of a table; an estimate with its interval below it, both unbroken."""
    from markupsafe import Markup

    parts = re.fullmatch(r"(.*?) \((.+ to .+?)\)(.*)", text)
    if parts is not None:
        stacked = Markup('<span class="v">{}</span><br><small class="v soft">{}</small>')
        return stacked.format(parts[1] + parts[3], parts[2])
    if len(text) < 24:
        return Markup('<span class="v">{}</span>').format(text)
    return _linked(text)


def _linked(text: str) -> Markup:
    """A text whose DOIs are links."""
    from markupsafe import Markup, escape

    pattern = r"(?:https://doi\.org/|doi:?\s?)?\b(10\.\d{4,9}/[^\s,;)]+[^\s,;).])"
    return Markup(
        re.sub(pattern, r'<a href="https://doi.org/\1">doi:\1</a>', str(escape(text)))
    )  # the pattern has no character that is escaped


def _inline(picture: Picture, name: str, screen: str = "") -> Markup:
    """An SVG with alternative text, and ids of its own: several stand in one page."""
    from markupsafe import Markup, escape

    text = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', picture.svg)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", text)
    text = re.sub(r'(xlink:)?href="#([^"]+)"', rf'\1href="#{name}-\2"', text)
    head = f'<svg role="img" aria-label="{escape(picture.text)}" '
    if screen:
        head = head.replace("<svg", f'<svg class="{screen}"', 1)
    return Markup(text.replace("<svg ", head, 1))


# --- pictures -------------------------------------------------------------------------------------


def _pictures(results: Results) -> dict[str, Picture]:
    """The figures of a run by name."""
    charts = figures.fragility_pictures(results)
    pictures = dict(zip(("fragility", "fragility-narrow"), charts, strict=False))
    quantities = list(results.study.quantities)
    drawn = {
        f"density-{number}": figures.density_picture(results, name)
        for number, name in enumerate(quantities[:MOST_PICTURES], 1)
    }
    drawn["sobol"] = figures.sobol_picture(results, quantities[:FIRST])
    drawn["convergence"] = figures.convergence_picture(results)
    return pictures | {name: picture for name, picture in drawn.items() if picture is not None}


def _first(results: Results, pictures: dict[str, Picture]) -> list[str]:
    """Pictures of the row below the decision."""
    names = [f"density-{k}" for k in range(1, FIRST + 1)]
    return [name for name in (*names, "sobol") if name in pictures]


# --- tables ---------------------------------------------------------------------------------------


def _certificate(results: Results, decision: Decision) -> PageTable | None:
    """What the number to use rests on: a row a doubt, the conservative ones first."""
    free = results.study.free
    if free is None or not decision.doubts:
        return None
    sign = 1.0
    if decision.use is not None and decision.use.safe_end == "smallest":
        sign = -1.0

    def order(doubt: Doubt) -> float:
        if doubt.margin is not None:
            return sign * doubt.margin
        if doubt.margin_note == "everywhere":
            return math.inf
        return -math.inf

    notes = {"everywhere": "whole range", "nowhere": "none", "": DASH}
    rows, marked = list[Sequence[str]](), list[int]()
    for doubt in sorted(decision.doubts, key=order)[:MOST_ROWS]:
        margin = notes[doubt.margin_note]
        if doubt.margin is not None:
            margin = value(doubt.margin, free.path)
        if doubt.governs:
            marked.append(len(rows))
        events = (as_event(decision, p) for p in (doubt.at_number, doubt.at_plan))
        rows.append(
            (f"{label(doubt.subject)}: {doubt_text(doubt)}", margin, *map(probability, events))
        )
    name = exceedance_name(results).lower()
    return PageTable(
        caption=f"To {decision.aim}",
        head=(
            "limit and what is open",
            f"{free.meaning} at the target",
            f"{name} at the number to use",
            f"{name} at the plan",
        ),
        rows=rows,
        marked=marked,
        note="bold: governs; * strength assumed, from the library",
    )


def _limits(results: Results) -> PageTable | None:
    """One line a limit or failure mode."""
    rows, free = mode_rows(results), results.study.free
    if not rows:
        return None
    head = ["limit (demand)", f"{exceedance_name(results).lower()} at the plan", "β"]
    if free is not None:
        meaning = free.meaning
        head += [f"{meaning} to use", "best estimate", "range by what is open"]
    body = []
    for row in rows:
        cells = [
            f"{label(row.subject)}: {short(_meaning(row))}",
            probability(row.exceedance),
            row.beta(),
        ]
        if free is not None:
            best = DASH
            if row.best is not None:
                best = "outside margins.between"
                if row.best.value is not None:
                    best = value(row.best.value, free.path)
            cells += [row.number(free.path), best, row.span(free.path)]
        body.append((*cells, row.entry.strength.text, _strength_source(row)))
    governing = {decision.governing for decision in results.decisions}
    notes = ["bold: governs"]
    if free is not None:
        notes[:0] = [
            "to use: with all that is open and the other failure modes",
            "best estimate: this limit by itself",
        ]
    if results.study.modes:
        notes.append("* strength assumed, from the library")
    damage = damage_modes(results)
    if damage:
        notes.append(f"damage, not counted as fracture: {listed(damage)}")
    return PageTable(
        caption="Limits and failure modes",
        head=(*head, "strength", "its source"),
        rows=body,
        marked=[k for k, row in enumerate(rows) if row.subject in governing],
        note="; ".join(notes),
    )


def _meaning(row: ModeRow) -> str:
    return meaning(row.entry.quantity)


def _strength_source(row: ModeRow) -> str:
    entry = row.entry
    source = entry.source
    if entry.assumed:
        source = "library, not this rock"
        if not entry.source_checked:
            source += ", source not checked"
    elif entry.tests:
        source = f"{entry.tests} tests"
    more = [text for text in (entry.platens, entry.size_law) if text]
    return "; ".join([source, *more])


def _quantities(results: Results) -> PageTable:
    """Distributions: one row a quantity."""
    answers, rows = table_of(results), []
    names = list(results.study.quantities)
    places: dict[float, None] = {}
    for name in names:
        for row in answers.where(name, Kind.QUANTILE):
            places[float(row.at)] = None
    for name, entry in results.study.quantities.items():
        quantiles = [estimate(answers.get(name, Kind.QUANTILE, p), name) for p in places]
        mean = estimate(answers.get(name, Kind.MEAN), name)
        sd = estimate(answers.get(name, Kind.SD), name, 3)
        rows.append((figures.title_of(name, entry), mean, sd, *quantiles))
    return PageTable(
        caption="Distributions at the plan",
        head=("quantity", "mean", "sd", *(f"{100.0 * p:g} %" for p in places)),
        rows=rows,
        note="with 95 % sampling intervals",
    )


def _quantity_notes(results: Results) -> list[str]:
    """What quantities are, how they are correlated, and how well their expansions fit."""
    notes = []
    for entry in results.study.quantities.values():
        definition = entry.meaning.partition(": ")[2]
        if definition:
            notes.append(f"{capital(short(entry.meaning))}: {definition}.")
    for tie in results.study.correlations[:1]:
        names = " and ".join(meaning(name) for name in tie.of)
        notes.append(f"Correlation of {names}: {tie.value:.3f}.")
    errors = []
    for name, entry in results.study.quantities.items():
        if entry.expansion_error is not None:
            errors.append(f"{meaning(name)} {format_probability(entry.expansion_error)}")
    if errors:
        notes.append(
            "Share of the variance that the polynomial chaos does not explain, at model runs that "
            f"it was not fitted to: {', '.join(errors)}; the answers are corrected for it."
        )
    return notes


def _indices(results: Results) -> PageTable | None:
    """First-order and total Sobol' indices: a row an input, the largest total first."""
    answers, largest = table_of(results), dict[str, float]()
    columns = [name for name in results.study.quantities if answers.where(name, Kind.SOBOL_TOTAL)]
    for name in columns:
        for row in answers.where(name, Kind.SOBOL_TOTAL):
            at = str(row.at)
            largest.setdefault(at, -1.0)
            if row.value is not None:
                largest[at] = max(largest[at], row.value)
    if not columns:
        return None
    ranked = sorted(largest, key=lambda at: -largest[at])
    body = []
    for at in ranked[:MOST_ROWS]:
        cells = [
            index(answers.get(name, kind, at))
            for name, kind in itertools.product(columns, (Kind.SOBOL_FIRST, Kind.SOBOL_TOTAL))
        ]
        body.append((meaning(at, results.inputs), *cells))
    methods = {METHODS[results.study.quantities[name].method_of_indices] for name in columns}
    note = "first order S: the input by itself; total T: with its interactions; 95 % intervals"
    if len(ranked) > MOST_ROWS:
        note += f"; {len(ranked) - MOST_ROWS} more inputs are in answers.csv"
    names = [short(results.study.quantities[name].meaning) for name in columns]
    heads = map(", ".join, itertools.product(names, "ST"))
    return PageTable(
        caption=f"Sobol’ indices {', '.join(sorted(methods - {''}))}".strip(),
        head=("input", *heads),
        rows=body,
        note=note,
    )


def _assumptions(results: Results) -> PageTable | None:
    """Fracture probabilities under other assumptions, one at a time."""
    rows, answers = [], table_of(results)
    for mode in mode_rows(results):
        for row in answers.where(mode.subject, Kind.FAILURE_PROBABILITY):
            if str(row.at).startswith("assumed: "):
                what = str(row.at).removeprefix("assumed: ")
                event = Range(value=row.value, low=row.low, high=row.high, note=row.note)
                if mode.entry.aim == "break":
                    event = complement(event)
                rows.append((label(mode.subject), what, probability(event)))
    if not rows:
        return None
    return PageTable(
        caption=f"{exceedance_name(results)} under other assumptions, one at a time",
        head=("limit", "assumed", exceedance_name(results).lower()),
        rows=rows,
    )


def _margins(results: Results) -> PageTable | None:
    """The free number at the probabilities that were asked for, a column a limit of the study."""
    free, answers = results.study.free, table_of(results)
    if free is None:
        return None
    names, places = [], set[float]()
    for name in results.study.limits:
        rows = [
            row for row in answers.where(f"limits.{name}", Kind.MARGIN) if row.value is not None
        ]
        if rows:
            names.append(name)
            places |= {row.at for row in rows if isinstance(row.at, float)}
    body = []
    for p in sorted(places):
        cells = [
            estimate(answers.get(f"limits.{name}", Kind.MARGIN, p), free.path) for name in names
        ]
        body.append((format_probability(p), *cells))
    if not body:
        return None
    return PageTable(
        caption=f"{capital(free.meaning)} for given {exceedance_name(results).lower()}",
        head=("probability", *names),
        rows=body,
    )


def _drivers(results: Results) -> list[PageTable]:
    """Sensitivity of each failure probability, and design points."""
    answers, inputs = table_of(results), results.inputs
    changes: dict[str, dict[str, float]] = {}
    modes = []
    for mode in mode_rows(results):
        moved = {str(row.at): row.value or 0.0 for row in answers.where(mode.subject, Kind.DRIVER)}
        if any(moved.values()):
            modes.append(mode)
            for name, change in moved.items():
                key = name
                if name.endswith(".strength"):
                    key = ""
                changes.setdefault(key, {})[mode.subject] = 100.0 * change
    if not changes:
        return []
    ranked = sorted(changes, key=lambda name: -max(map(abs, changes[name].values())))[:MOST_ROWS]
    drivers, points = [], []
    pointed = [mode for mode in modes if answers.where(mode.subject, Kind.DESIGN_POINT)]
    for name in ranked:
        head = "strength"
        if name:
            head = meaning(name, inputs)
        texts = {subject: f"{change:+.2g}" for subject, change in changes[name].items()}
        drivers.append((head, *(texts.get(mode.subject, DASH) for mode in modes)))
        points.append((head, *(_design_point(results, mode, name) for mode in pointed)))
    tables = [
        PageTable(
            caption="Sensitivity of the failure probability",
            head=("input", *(label(mode.subject) for mode in modes)),
            rows=drivers,
            note="percentage points per standard deviation shift of the input's mean",
        )
    ]
    if pointed:
        heads = [label(mode.subject) for mode in pointed]
        tables.append(
            PageTable(
                caption="Most probable failure (design point)", head=("input", *heads), rows=points
            )
        )
    return tables


def _design_point(results: Results, mode: ModeRow, name: str) -> str:
    places = {
        str(row.at): row.value for row in table_of(results).where(mode.subject, Kind.DESIGN_POINT)
    }
    if name:
        return value(places.get(name), name)
    if mode.entry.tests:  # in terms of the test force
        return DASH
    return value(places.get(f"{mode.subject}.strength"), mode.entry.quantity)


def _fracture(results: Results) -> PageTable | None:
    """Fracture by any limit: its probability, the first failure mode, and the state at fracture."""
    answers = table_of(results)
    joint = answers.get("fracture", Kind.EXCEEDANCE_PROBABILITY)
    if joint is None:
        return None
    rows = [("fracture probability, any limit of the study", probability(joint))]
    for row in answers.where("fracture", Kind.MODE_SHARE):
        rows.append((f"first failure mode: {row.at}", probability(row)))
    for kind, name, quantity in (
        (Kind.TIME_AT_FRACTURE, "time", "contact_duration"),
        (Kind.FORCE_AT_FRACTURE, "force", "P_max"),
    ):
        median = answers.get("fracture", kind, 0.5)
        if median is not None:
            rows.append((f"{name} at fracture, median", estimate(median, quantity)))
    return PageTable(caption="Fracture by any limit of the study", head=("", ""), rows=rows)


def _paper(results: Results) -> PageTable | None:
    """The paper's numbers as printed, beside the corrected ones."""
    if not results.paper:
        return None
    rows = [(row.name, *paper_cells(row), row.note) for row in results.paper]
    return PageTable(
        caption="The paper’s formulas, as printed and corrected",
        head=("formula", "as printed", "corrected", "what is wrong as printed"),
        rows=rows,
    )


def _reached(results: Results) -> PageTable:
    rows = []
    for row in results.accuracy.reached:
        error = DASH
        if row.error is not None:
            error = f"{row.error:.2g}"
        rows.append((f"{row.runs:,}", error))
    return PageTable(
        caption="Convergence: largest error / tolerance",
        head=("model runs", "error / tolerance"),
        rows=rows,
    )


def _dependence(results: Results) -> list[str]:
    """What depends on what, and how strongly."""
    texts = []
    for tie in results.study.dependence:
        names = " and ".join(meaning(name, results.inputs) for name in tie.of)
        texts.append(f"{capital(names)}: {tie.text}")
    return texts


def _random_inputs(results: Results) -> PageTable | None:
    """Random inputs: distribution, mean, standard deviation, 5–95 % range and source."""
    rows = []
    for name, entry in results.inputs.items():
        if not entry.fixed:
            ends = f"{value(entry.p05, name)} to {value(entry.p95, name)}"
            mean, sd = value(entry.mean, name, 4), value(entry.sd, name)
            rows.append(
                (meaning(name, results.inputs), entry.distribution, mean, sd, ends, _source(entry))
            )
    if not rows:
        return None
    return PageTable(
        caption="Random inputs",
        head=("input", "distribution", "mean", "sd", "5–95 % range", "source"),
        rows=rows[:MOST_INPUTS],
    )


def _fixed_inputs(results: Results) -> PageTable | None:
    """Fixed inputs by their source."""
    by_source: dict[str, list[tuple[str, str]]] = {}
    for name, entry in results.inputs.items():
        if entry.fixed:
            row = (meaning(name, results.inputs), _plain(entry, name))
            by_source.setdefault(_source(entry), []).append(row)
    rows = []
    for source, group in by_source.items():
        rows += [(*row, source) for row in group]
    if not rows:
        return None
    return PageTable(
        caption="Fixed inputs", head=("input", "value", "source"), rows=rows[:MOST_INPUTS]
    )


def _plain(entry: InputEntry, name: str) -> str:
    if entry.mean is None:
        return DASH
    return format_value(entry.mean, name, 4)


def _source(entry: InputEntry) -> str:
    if entry.source_checked:
        return entry.source
    return f"{entry.source} (source not checked)"
