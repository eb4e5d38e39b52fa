"""The tables of a run: what the page shows whole, and the terminal in part."""

import itertools
import re
from collections.abc import Iterable, Iterator, Sequence
from math import inf
from typing import NamedTuple

import numpy as np

from uqsphere.mechanics.failure_modes import FAILURE_MODES
from uqsphere.quantities import format_share
from uqsphere.results.types import (
    Answer,
    Decision,
    Doubt,
    FreeNumber,
    InputEntry,
    Kind,
    LimitEntry,
    MarginNote,
    PaperRow,
    Results,
)
from uqsphere.uq import LEVEL_TEXT

from .format import (
    DASH,
    capital,
    estimate,
    index,
    label,
    meaning,
    probability,
    source_text,
    title_of,
    value,
    value_range,
)
from .pictures import ranked_inputs
from .sentences import (
    METHODS,
    DecisionText,
    all_together,
    as_event,
    doubt_text,
    exceedance_name,
    joint_event,
    limit_notes,
    probability_at_target,
)

#: texts of a row
Row = Sequence[str]
#: rows of a table, and of a table of inputs
MOST_ROWS, MOST_INPUTS = 16, 40
#: the text of a doubt without a margin, of several the first
_WITHOUT_MARGIN: dict[MarginNote, str] = {
    "nowhere": "none",
    "too few rows": "not known",
    "": DASH,
    "everywhere": "whole range",
}


class PageTable(NamedTuple):
    """A table: caption, heads, rows of texts, rows that are marked, and a note on it; shown if it
    has rows.
    """

    caption: str = ""
    head: Row = ()
    rows: Sequence[Row] = ()
    marked: Sequence[int] = ()
    note: str = ""


def columns(rows: Sequence[Row], width: float = inf) -> list[str]:
    """Rows of texts as lines of a terminal, heads first; where that is narrow, heads are broken
    and, if that is not enough, the texts of the first column.

    >>> columns([("input", "mean of it"), ("Young's modulus", "52 GPa")], 18)
    ['input       mean', '            of it', "Young's     52 GPa", 'modulus']
    """
    table = list(zip(*rows, strict=True))
    widths = [max(map(len, column)) for column in table]
    room = width - 2 * (len(table) - 1)
    if sum(widths) > room:
        for k, (head, *cells) in enumerate(table):
            widths[k] = max(map(len, [*cells, *_pieces(head)]))
        least = max(len(piece.rstrip()) for text in table[0] for piece in _pieces(text))
        widths[0] = max(min(widths[0], int(room) - sum(widths[1:])), least)
    lines = []
    for row in rows:
        broken = [_broken(text, w) for text, w in zip(row, widths, strict=True)]
        for line in itertools.zip_longest(*broken, fillvalue=""):
            padded = (f"{text:{w}}" for text, w in zip(line, widths, strict=True))
            lines.append("  ".join(padded).rstrip())
    return lines


#: where a line may break: behind a blank, and between the names in a key
_BREAK = r"(?<= )|(?<=[._])(?=[A-Za-z])"


def _pieces(text: str) -> list[str]:
    """A text in parts between which a line may break."""
    return re.split(_BREAK, text)


def _broken(text: str, width: int) -> list[str]:
    """A text in lines of a width."""
    return [line.rstrip() for line in re.findall(rf"(.{{1,{width}}} ?)(?:{_BREAK}|$)", text)]


# --- decisions ------------------------------------------------------------------------------------


def certificate(results: Results, decision: Decision) -> PageTable:
    """What a decision rests on: a row a doubt, the conservative ones first."""
    free = results.study.free
    sign = 1.0
    if decision.safe_above:
        sign = -1.0

    def order(doubt: Doubt) -> float:
        if doubt.margin is not None:
            return sign * doubt.margin
        return inf if doubt.margin_note == "everywhere" else -inf

    doubts = sorted(decision.doubts, key=order)[:MOST_ROWS]
    number = DecisionText(results, decision).number
    rows = []
    for doubt in doubts:
        margin = _WITHOUT_MARGIN[doubt.margin_note]
        if doubt.margin is not None:
            margin = number(doubt.margin)
        at = (
            probability_at_target(decision.aim, p, doubt.target)
            for p in (doubt.at_number, doubt.at_plan)
        )
        rows.append((f"{label(doubt.subject)}: {doubt_text(doubt)}", margin, *at))
    name = exceedance_name(results)
    marked = [k for k, doubt in enumerate(doubts) if doubt.governs]
    note = "bold: governs"
    failures = "failures"
    if free:
        note = f"margins rounded to the safe side; {note}"
        failures += " at the number"
    if marked and any(doubt.counts for doubt in doubts[: marked[0]]):
        note += f", as most {failures} are by it"
    if any(doubt.code == "assumed strength" for doubt in doubts):
        note += "; * strength assumed, from the library"
    head = ["limit and what is open", f"{name} at the plan"]
    if not free:
        rows = [(row[0], row[-1]) for row in rows]
    else:
        head[1:1] = f"{free.meaning} at the target", f"{name} at the number to use"
    return PageTable(f"To {decision.aim}", head, rows, marked, note)


def limits(results: Results) -> PageTable:
    """One line a limit or failure mode, and one for those of an aim together."""
    entries = results.entries
    free = results.study.free
    head = ["limit", f"{exceedance_name(results)} at the plan", "β"]
    notes = ["bold: governs", "β: reliability index, the normal quantile of 1 - probability"]
    if free:
        head += [f"best estimate of the {free.meaning}", f"{free.meaning} to use", "range"]
        notes.append(
            "best estimate: each limit by itself; to use: by all of them, considering what is "
            "open, which gives the range and what governs"
        )
    rows = list[Row]()
    aims = [entry.aim for entry in entries.values()]
    decisions = {decision.aim: decision for decision in results.decisions}
    for subject, entry in entries.items():
        p = probability(results.get(subject, Kind.EXCEEDANCE_PROBABILITY))
        beta = results.get(subject, Kind.RELIABILITY_INDEX)
        cells = [label(subject), p, DASH]
        if beta.value is not None:
            cells[2] = f"{beta.value:.2f}"
        if free:
            cells += [DASH, "", ""]
            if entry.aim in decisions:
                cells[3] = _best_estimate(results, subject, entry, free)
                if aims.count(entry.aim) == 1:
                    cells[4:] = _number_to_use(results, decisions[entry.aim])
        strength = f"{meaning(entry.quantity)}: {entry.strength.text}"
        rows.append((*cells, strength, _strength_source(entry)))
    for decision in results.decisions:
        if aims.count(decision.aim) > 1:
            rows += _joint_rows(results, decision)
    governing = {decision.governing for decision in results.decisions}
    notes += limit_notes(results)
    modes = FAILURE_MODES.values()
    notes += [f"{mode.name}: {mode.gloss}" for mode in modes if mode.name in results.study.modes]
    if any(entry.platens for entry in entries.values()):
        notes.append(
            "strengths from forces: tests and impact share E and size of the sphere, and the two "
            "scatter together; the probability does not follow from demand and strength apart"
        )
    return PageTable(
        "Limits and failure modes",
        (*head, "demand: strength", "source of the strength"),
        rows,
        marked=[k for k, subject in enumerate(entries) if subject in governing],
        note="; ".join(notes),
    )


def _best_estimate(results: Results, subject: str, entry: LimitEntry, free: FreeNumber) -> str:
    """The free number at the target by one limit alone, without what is open."""
    curve = results.where(subject, Kind.CURVE)
    if not curve:
        return DASH
    row = results.get(subject, Kind.MARGIN, entry.allowable)
    if row.value is not None:
        return value(row.value, free.quantity)
    above = [(point.value or 0.0) > entry.allowable for point in curve]
    crossings = np.count_nonzero(np.diff(above))
    if crossings:
        return "several values" if crossings > 1 else DASH
    return f"outside {value(free.low, free.quantity)} to {value(free.high, free.quantity)}"


def _number_to_use(results: Results, decision: Decision) -> list[str]:
    """The number to use of a decision, and its range; or why there is none."""
    use = decision.use
    if use:
        text = DecisionText(results, decision)
        return [text.number(use.value), text.span(use.best.low, use.best.high)]
    notes = {doubt.margin_note for doubt in decision.doubts}
    return [next((text for note, text in _WITHOUT_MARGIN.items() if note in notes), DASH), DASH]


def _joint_rows(results: Results, decision: Decision) -> Iterator[Row]:
    """The study's own limits together, and all failure modes, with their numbers to use."""
    text = DecisionText(results, decision)
    use = decision.use
    own = decision.own
    free = results.study.free
    if own and own.margin is not None and decision.all_modes:
        p = probability(as_event(decision.aim, decision.probability))
        yield "your own limits", p, "", "", text.number(own.margin), "", "", ""
    if use and free:
        together, p = "each by itself", ""
        if decision.adds_up:
            together = all_together(decision)
            p = probability(joint_event(decision))
        best = value(use.best.value, free.quantity)
        if len(results.decisions) > 1:
            together += f", to {decision.aim}"
        yield together, p, "", best, *_number_to_use(results, decision), "", ""


def _strength_source(entry: LimitEntry) -> str:
    source = entry.source
    if entry.assumed:
        source = "library, not this rock"
        if not entry.source_checked:
            source += ", source not checked"
    elif entry.tests:
        source = f"{entry.tests} tests"
    return "; ".join(filter(None, (source, entry.platens, entry.size_law)))


def fracture(results: Results) -> PageTable:
    """Fracture by any limit: its probability, the first failure mode, and the state at fracture."""
    broken = results.where("fracture", Kind.EXCEEDANCE_PROBABILITY)
    rows = [("fracture probability", probability(row)) for row in broken]
    by_mode = results.where("fracture", Kind.MODE_SHARE)
    for row in by_mode:
        text = estimate(row)
        if row.value is not None:
            text = probability(row)
        rows.append((f"first failure mode: {row.at}", text))
    medians = {Kind.TIME_AT_FRACTURE: "contact_duration", Kind.FORCE_AT_FRACTURE: "P_max"}
    rows += [
        (f"{row.answer.replace('_', ' ')}, median", estimate(row, medians[row.answer]))
        for row in results.answers
        if row.answer in medians and row.at == 0.5
    ]
    return PageTable(
        "Fracture by any limit of the study",
        ("", "value"),
        rows,
        note="time and force: of the spheres that break at the plan, at the moment of fracture; "
        "those that would bear more are not among them",
    )


# --- distributions and sensitivity ----------------------------------------------------------------


def quantities(results: Results) -> PageTable:
    """Distributions: one row a quantity."""
    rows = []
    quantiles = (row for row in results.answers if row.answer == Kind.QUANTILE)
    places = dict.fromkeys(float(row.at) for row in quantiles)
    for name in results.study.quantities:
        mean = estimate(results.get(name, Kind.MEAN), name)
        sd = estimate(results.get(name, Kind.SD), name, 3)
        cells = (estimate(results.get(name, Kind.QUANTILE, p), name) for p in places)
        rows.append((title_of(name), mean, sd, *cells))
    return PageTable(
        "Distributions at the plan",
        ("quantity", "mean", "sd", *map(format_share, places)),
        rows,
        note=f"with {LEVEL_TEXT} sampling intervals",
    )


def with_indices(results: Results) -> list[str]:
    """Quantities that have Sobol' indices."""
    return [name for name in results.study.quantities if results.where(name, Kind.SOBOL_TOTAL)]


def indices(results: Results) -> PageTable:
    """First-order and total Sobol' indices: a row an input, the largest total first."""
    names = with_indices(results)
    ranked = ranked_inputs(results, names)
    orders = list(itertools.product(names, (Kind.SOBOL_FIRST, Kind.SOBOL_TOTAL)))
    rows = []
    for at in ranked[:MOST_ROWS]:
        cells = (index(results.get(name, kind, at)) for name, kind in orders)
        rows.append((meaning(at), *cells))
    if results.study.dependence and not ranked:
        rows.append(("none: tied inputs have no Sobol’ indices", *[DASH] * len(orders)))
    methods = {METHODS[results.study.quantities[name].method_of_indices] for name in names}
    note = (
        "first order S: the input by itself; total T: with its interactions; "
        f"{LEVEL_TEXT} intervals"
    )
    if len(ranked) > MOST_ROWS:
        note += f"; {len(ranked) - MOST_ROWS} more inputs are in answers.csv"
    heads = itertools.product(map(meaning, names), "ST")
    return PageTable(
        f"Sobol’ indices {', '.join(sorted(methods - {''}))}".strip(),
        ("input", *map(", ".join, heads)),
        rows,
        note=note,
    )


def margins(results: Results) -> PageTable:
    """The free number at the probabilities that were asked for, a column a limit of the study."""
    free = results.study.free
    if not free:
        return PageTable()
    asked = dict[str, list[float]]()
    for name in results.study.limits:
        for row in results.where(f"limits.{name}", Kind.MARGIN):
            if isinstance(row.at, float) and row.value is not None:
                asked.setdefault(name, []).append(row.at)
    body = []
    for p in sorted({*itertools.chain(*asked.values())}):
        margins = (results.get(f"limits.{name}", Kind.MARGIN, p) for name in asked)
        body.append((format_share(p), *(estimate(row, free.quantity) for row in margins)))
    return PageTable(
        f"{capital(free.meaning)} for given {exceedance_name(results)}",
        ("probability", *asked),
        body,
    )


def drivers(results: Results) -> Iterator[PageTable]:
    """Sensitivity of each failure probability, the largest change first, and design points: a
    column a limit.
    """
    largest = dict[str, float]()
    changes = {}
    points = dict[str, dict[str, str]]()
    for subject, entry in results.entries.items():
        # failure is to stay whole where the aim is to break
        per_cent = -100.0 if entry.aim == "break" else 100.0
        rows = results.where(subject, Kind.DRIVER)
        moved = {_variable(row): per_cent * (row.value or 0.0) for row in rows}
        if not any(moved.values()):
            continue
        changes[label(subject)] = {name: _points(x) for name, x in moved.items()}
        for name, x in moved.items():
            largest[name] = max(largest.get(name, 0.0), abs(x))
        for row in results.where(subject, Kind.DESIGN_POINT):
            name = _variable(row)
            text = value(row.value, name or entry.quantity)
            if not name and entry.tests:  # in terms of the test force
                text = DASH
            points.setdefault(label(subject), {})[name] = text
    ranked = sorted(largest, key=largest.__getitem__, reverse=True)[:MOST_ROWS]
    shift = "percentage points per standard deviation shift of the input's mean"
    for columns, caption, note in (
        (changes, f"Sensitivity of the {exceedance_name(results)}", shift),
        (points, "Most probable failure (design point)", ""),
    ):
        body = []
        for name in ranked:
            head = meaning(name) if name else "strength"
            body.append((head, *(column.get(name, DASH) for column in columns.values())))
        if columns:
            yield PageTable(caption, ("input", *columns), body, note=note)


def _points(change: float) -> str:
    """A change in percentage points, to two digits; 0 where a probability is certain."""
    if abs(change) < 1e-12:
        return "0"
    return f"{change:+.2g}".replace("e-0", "e-")


def _variable(row: Answer) -> str:
    """The input of a row; empty for the strength of a limit, a row that all limits share."""
    name = str(row.at)
    if name.endswith(".strength"):
        return ""
    return name


def paper_rows(lines: Iterable[PaperRow]) -> Iterator[Row]:
    """Names of the paper's numbers, each as printed and corrected, and what is wrong as printed."""
    for line in lines:
        printed, corrected = (
            DASH if number is None else f"{number:.4g} {line.unit}".rstrip()
            for number in (line.printed, line.corrected)
        )
        yield line.name, printed, corrected, line.note


def paper(results: Results) -> PageTable:
    """The paper's numbers as printed, beside the corrected ones."""
    return PageTable(
        "The paper’s formulas, as printed and corrected",
        ("formula of the paper", "printed", "corrected", "what is wrong as printed"),
        [*paper_rows(results.paper)],
    )


# --- inputs ---------------------------------------------------------------------------------------


def random_inputs(results: Results) -> PageTable:
    """Random inputs: distribution, mean, standard deviation, 5–95 % range and source."""
    rows = []
    for name, entry in results.inputs.items():
        if not entry.fixed:
            span = value_range(entry.p05, entry.p95, name)
            title, mean, source = _input(name, entry)
            rows.append((title, entry.distribution, mean, value(entry.sd, name), span, source))
    return PageTable(
        "Random inputs",
        ("input", "distribution", "mean", "sd", "5–95 % range", "source"),
        rows[:MOST_INPUTS],
    )


def fixed_inputs(results: Results) -> PageTable:
    """Fixed inputs, those of one source together."""
    rows = [_input(name, entry) for name, entry in results.inputs.items() if entry.fixed]
    sources = [source for *_, source in rows]
    rows.sort(key=lambda row: sources.index(row[-1]))
    return PageTable("Fixed inputs", ("input", "value", "source"), rows[:MOST_INPUTS])


def _input(name: str, entry: InputEntry) -> tuple[str, str, str]:
    """An input's meaning, mean and source."""
    return (
        meaning(name),
        value(entry.mean, name, 4),
        source_text(entry.source, entry.source_checked),
    )
