"""The analysis of a table of runs for the terminal, as a page with figures, and as the beginning of a study."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.console import screen_width, table, wrap, writable
from uqsphere.errors import told as safe
from uqsphere.given import Data, Document
from uqsphere.quantities import format_estimate
from uqsphere.report.brief import Answer, Brief
from uqsphere.report.feed import page_files, told_cautions
from uqsphere.report.figures.canvas import BLUE, GREY, INK, Picture, new_figure, shorten, slug, style
from uqsphere.report.figures.distributions import draw_indices
from uqsphere.report.phrases import Block, Chapter, Table, cell, index_cell, two
from uqsphere.results import Est
from uqsphere.study.limits import valid_name
from uqsphere.study.resolve import RESERVED

#: outputs whose mean is set large, inputs of a figure, bars of a histogram
_LARGE, _ROWS, _BINS = 3, 24, 40
#: pairs from which on a list of all would say nothing to anybody
_MANY: Final = 30
#: a unit behind a name; characters of a name that is made; the largest rank correlation that is written
_UNIT: Final = re.compile(r"\s*[\[(][^\])]*[\])]\s*$")
_LONGEST: Final = 40
_STRONGEST: Final = 0.9999
#: what is called by which name
_ORDERS: Final = {"shapley": "Shapley effect", "first": "first", "total": "total"}

Show = Callable[[Document], str]
Rows = list[tuple[str, ...]]


def _shown(estimate: Document) -> str:
    if estimate["value"] is None:
        reason = "too few runs" if "too few" in estimate["reason"] else estimate["reason"]
        return f"- ({reason})"
    return format_estimate(estimate["value"], estimate["low"], estimate["high"])


def _share(estimate: Document) -> str:
    """A share of 1: what is known beyond six decimals is of no use to anybody."""
    if estimate["value"] is None or estimate["high"] - estimate["low"] > 2e-6:
        return _shown(estimate)
    return f"{estimate['value'] + 0.0:.6f}"


def _est(entry: Document) -> Est:
    return Est.model_validate(entry)


# --- the tables -----------------------------------------------------------------------------------------------


def _inputs(found: Document) -> tuple[tuple[str, ...], Rows, list[str]]:
    """Header and rows of the laws, and what is to be said of them."""
    rows: Rows = []
    said = []
    for name, entry in found["inputs"].items():
        if entry["chosen"] is None:
            same = entry["fixed"]
            row = ("-", "", "", "", "", "") if same is None else ("fixed", "", f"{same:.5g}", "", "", "")
        else:
            others = [f"{kind} {weight:.0%}" for kind, weight in entry["weights"].items() if kind != entry["chosen"]]
            said += [f"{name} may also be {', '.join(others[:3])}"] * bool(others)
            ends = [entry[f"{what}_left_open"] for what in ("mean", "sd")]
            opened = [f"{end[0]:.4g} to {end[1]:.4g}" if end else "-" for end in ends]
            row = (entry["chosen"], f"{entry['fits'][0]['p_value']:.2g}", f"{entry['mean']:.5g}", opened[0],
                   f"{entry['sd']:.4g}", opened[1])  # fmt: skip
        rows.append((name, *row))
    header: tuple[str, ...] = ("input", "law", "fit (p)", "mean", "left open (95 %)", "sd: scatter", "left open (95 %)")
    if found["laws"] == "known":
        header, rows = ("input", "law", "fit (p)", "mean", "sd: scatter"), [(*row[:4], row[5]) for row in rows]
        said = ["fit (p): how often runs drawn from the law would lie as far from it"]
    else:
        said += [
            "fit (p): how often runs of the law itself would lie as far from it; below 0.01 it is refused",
            f"left open: what {found['rows']:,} runs do not know of the law, its family included; more runs narrow it, "
            "not the scatter",
        ]
    return header, rows, said + [f"{name}: {one['reason']}" for name, one in found["inputs"].items() if one["reason"]]


def _dependence(found: Document) -> list[str]:
    """Which inputs depend on each other, or are given by others."""
    parts, tied = [], [pair for pair in found["dependence"] if pair["dependent"]]
    for pair in tied[:_MANY]:
        copula = pair.get("copula")
        taken = "" if copula in (None, "gaussian") else f", taken for a {copula.capitalize()} copula"
        said = f"{' and '.join(pair['of'])} depend on each other: rank correlation {_share(pair['spearman'])}{taken}"
        parts.append(said)
    if len(tied) > _MANY:
        parts.append(f"and {len(tied) - _MANY} pairs more")
    parts += found["combinations"][:_MANY]
    if not tied and found["dependence"]:
        parts.append("no two inputs depend on each other beyond chance")
    return parts


def _statistics(entry: Document, show: Show) -> Rows:
    """Statistics of one output: by the runs alone, and by the expansion."""
    alone = {"mean": ("mean", entry["mean"]), "sd": ("standard deviation", entry["sd"])}
    alone |= {p: (f"{100.0 * float(p):g} % quantile", e) for p, e in entry["quantiles"].items()}
    more = entry["expansion"]
    return [
        (label, show(one), "-" if more is None else show(more[key]["whole"])) for key, (label, one) in alone.items()
    ]


def _indices(entry: Document, show: Show, share: Show) -> Rows:
    """Shares of the variance of one output: by ranks, and every kind that the expansion has."""
    chaos = entry["chaos"]
    kinds = [chaos[order] for order in _ORDERS if order in chaos]
    # an expansion knows inputs that vary alone
    return [
        (source, show(estimate), *(share(kind[source]["whole"]) if source in kind else "-" for kind in kinds))
        for source, estimate in entry["ranks"].items()
    ]


def _index_header(entry: Document) -> tuple[str, ...]:
    orders = (f"{called}, by expansion" for order, called in _ORDERS.items() if order in entry["chaos"])
    return ("drivers", "first, by ranks (95 %)", *orders)


def _expansion(found: Document, name: str) -> str:
    """What the intervals of an expansion hold."""
    chaos = found["sensitivity"][name]["chaos"]
    entries = [e for order in _ORDERS for e in chaos.get(order, {}).values() if e["surrogate"]["value"] is not None]
    text = f"expansion: {chaos['reason']}"
    if not entries:
        return text
    own = max(0.5 * (e["surrogate"]["high"] - e["surrogate"]["low"]) for e in entries)
    text = f"{text}; its own error moves no index by more than {own:.1g}"
    if found["laws"] == "known":
        return text
    opened = max(e["left_open"] for e in entries)
    return (
        f"{text}, what the runs leave open of the laws by up to {opened:.1g}, and the intervals hold both. Where the "
        "laws are known, give them: --laws STUDY.toml"
    )


# --- the terminal ---------------------------------------------------------------------------------------------


def analysis_text(found: Document, width: int | None = None) -> str:
    """The analysis for the terminal: no line is longer than `width` columns, those of the terminal where it is None."""
    columns = screen_width() if width is None else width
    header, laws, said = _inputs(found)
    parts = [f"{found['rows']:,} rows", "", table(header, laws, columns), *said, *_dependence(found), ""]
    expanded = any(entry["expansion"] is not None for entry in found["outputs"].values())
    statistics: list[tuple[str, ...] | str] = []
    for name, entry in found["outputs"].items():
        statistics += [name, *(row if expanded else row[:2] for row in _statistics(entry, _shown))]
    ways = ("by the runs alone (95 %)", "by the expansion (95 %)") if expanded else ("value (95 % interval)",)
    parts += [table(("output", *ways), statistics, columns), ""]
    parts.append(_drivers_text(found, columns))
    for name, entry in found["sensitivity"].items():
        chaos = entry["chaos"]
        parts += ["", f"{name}: {_expansion(found, name)}"]
        parts += [f"{name}: {note}" for note in [*found["outputs"][name]["notes"], *chaos.get("notes", ())]]
        if entry["disagree"]:
            parts.append(
                f"{name}: WARNING: runs and expansion disagree by more than chance: {'; '.join(entry['disagree'])}. "
                "The laws, or what is said of the dependence, are wrong, or the runs were not drawn independently; "
                "believe neither before that is settled"
            )
    # a text of one line is a sentence, one of several a table
    return writable("\n".join(text if "\n" in text else wrap(text, columns) for text in parts))


def _drivers_text(found: Document, columns: int) -> str:
    """Indices of every output; tables of those without an expansion have columns less."""
    texts = []
    tables: dict[tuple[str, ...], list[tuple[str, ...] | str]] = {}
    for name, entry in found["sensitivity"].items():
        reasons = {estimate.get("reason") for estimate in entry["ranks"].values()}
        if len(reasons) == 1 and None not in reasons:
            texts.append(wrap(f"{name}: no index by ranks: {reasons.pop()}", columns))
        else:
            tables.setdefault(_index_header(entry), []).extend([name, *_indices(entry, _shown, _share)])
    return "\n\n".join([*texts, *(table(header, rows, columns) for header, rows in tables.items())])


# --- the page -------------------------------------------------------------------------------------------------


def analysis_page(found: Document, data: Data) -> dict[str, str]:
    """report.html of an analysis with the files of its figures: name -> text."""
    header, laws, said = _inputs(found)
    table = Table(caption="Laws", header=header, rows=tuple(laws))
    inputs = Block(heading="Laws and dependence", table=table, remarks=(*said, *_dependence(found)))
    parts = [
        Chapter(anchor="drivers", heading="What drives the outputs",
                blocks=tuple(_drivers(found, k, name) for k, name in enumerate(data.outputs))),
        Chapter(anchor="outputs", heading="The outputs",
                blocks=tuple(_output(found, data, k, name) for k, name in enumerate(data.outputs))),
        Chapter(anchor="inputs", heading="The inputs", blocks=(inputs,)),
    ]  # fmt: skip
    return page_files("analysis of given data", _brief(found, data), parts)


def _shares(found: Document, name: str) -> tuple[dict[str, Est], dict[str, Est], tuple[str, str]]:
    """Two kinds of shares of an output's variance, by input: of the expansion where there is one, else by ranks."""
    entry = found["sensitivity"][name]
    chaos, ranks = entry["chaos"], {source: _est(one) for source, one in entry["ranks"].items()}
    if not chaos["usable"]:
        return ranks, ranks, ("by ranks", "by ranks")
    kinds = ("first", "shapley") if chaos["kind"] == "dependent" else ("first", "total")
    one, other = ({source: _est(e["whole"]) for source, e in chaos[kind].items()} for kind in kinds)
    return one, other, ("alone (first)", "Shapley effect" if "shapley" in kinds else "with interactions (total)")


def _brief(found: Document, data: Data) -> Brief:
    answers = []
    for name in data.outputs[:_LARGE]:
        entry = found["outputs"][name]
        best = entry["mean"] if entry["expansion"] is None else entry["expansion"]["mean"]["whole"]
        low, high = (entry["quantiles"][p]["value"] for p in ("0.05", "0.95"))
        note = "" if None in (low, high) else f"Nine of ten runs: {two(low)} to {two(high)}."
        big = "not known" if best["value"] is None else two(best["value"], 3)
        answers.append(Answer(question=f"{shorten(name, 40)}, mean", big=big, unit="", note=note))
    known = _shares(found, data.outputs[0])[1]
    shares = sorted(((e.number, source) for source, e in known.items() if e.value is not None), reverse=True)
    drivers = tuple((shorten(source, 30), min(value, 1.0)) for value, source in shares[:2] if value > 0.0)
    laws, measure = "laws given", ("More runs", "They narrow what is left open of indices and quantiles.")
    if found["laws"] != "known":
        laws = "laws fitted to the runs"
        measure = ("Laws of the inputs", "Where they are known, give them: --laws STUDY.toml.")
    return Brief(
        title=f"{found['rows']:,} runs of {', '.join(data.outputs)}",
        answers=tuple(answers),
        drivers=drivers if sum(value for _, value in drivers) <= 1.0 else drivers[:1],
        driven=shorten(data.outputs[0], 40),
        measure=measure,
        cautions=told_cautions(_told(found)),
        footer=f"{found['rows']:,} runs · {len(data.inputs)} inputs · {laws}".replace(",", "\u202f"),
    )


def _told(found: Document) -> list[str]:
    """What is to be said of the outputs and of their expansions."""
    told = [text for entry in found["outputs"].values() for text in entry["notes"]]
    for name, entry in found["sensitivity"].items():
        refused = [] if entry["chaos"]["usable"] else [entry["chaos"]["reason"]]
        told += [f"{shorten(name, 30)}: {text}" for text in (*entry["disagree"], *refused)]
    return told


def _index(entry: Document) -> str:
    return index_cell(_est(entry))


def _drivers(found: Document, number: int, name: str) -> Block:
    one, other, words = _shares(found, name)
    names = sorted(other, key=lambda source: -(other[source].value or 0.0))
    drawn = [source for source in names if one[source].value is not None and other[source].value is not None][:_ROWS]
    picture = None
    if drawn:
        labels = {source: shorten(source, 40) for source in drawn}
        figure = draw_indices(drawn, labels, one, other, f"share of the variance of {shorten(name, 40)}", words)
        picture = Picture(
            name=slug("drivers", str(number + 1), name), title=f"What drives {shorten(name, 60)}", figure=figure,
            header=("input", *(f"{word}, {end}" for word in words for end in ("value", "low", "high"))),
            rows=tuple((s, *(v for e in (one[s], other[s]) for v in (e.value, e.low, e.high))) for s in drawn),
        )  # fmt: skip
    entry = found["sensitivity"][name]
    rows = _indices(entry, _index, _index)
    rows.sort(key=lambda row: (*names, row[0]).index(row[0]))
    table = Table(caption=f"Shares of the variance of {name}", header=_index_header(entry), rows=tuple(rows))
    return Block(heading=name, picture=picture, table=table, remarks=(_expansion(found, name),))


def _output(found: Document, data: Data, number: int, name: str) -> Block:
    values = data.y[:, number]
    rows = _statistics(found["outputs"][name], lambda estimate: cell(_est(estimate)))
    header = ("number", "by the runs alone", "by the expansion")
    table = Table(caption=f"{name}, with 95 % intervals", header=header, rows=tuple(rows))
    return Block(heading=name, picture=_histogram(values[np.isfinite(values)], number, name), table=table)


def _histogram(values: Array, number: int, name: str) -> Picture | None:
    if len(values) < 2 or not np.ptp(values) > 0.0:
        return None
    counts, edges = np.histogram(values, bins=min(_BINS, max(8, len(values) // 10)))
    with style():
        figure, (axes,) = new_figure(2.6)
        axes.stairs(counts, edges, fill=True, color=BLUE, alpha=0.35)
        axes.stairs(counts, edges, color=BLUE)
        axes.axvline(float(values.mean()), color=INK, linewidth=1.2)
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        axes.set_xlabel(shorten(name, 60))
        axes.set_ylabel("runs")
    return Picture(
        name=slug("output", str(number + 1), name), title=f"Runs by {shorten(name, 60)}, their mean as a line",
        figure=figure, header=("from", "to", "runs"),
        rows=tuple(zip(edges[:-1].tolist(), edges[1:].tolist(), counts.tolist(), strict=True)),
    )  # fmt: skip


# --- a study --------------------------------------------------------------------------------------------------


def study_text(found: Document) -> str:
    """The inputs as a black-box study would have them, to go on with; names that a study cannot have are changed."""
    called = _study_names([*found["inputs"], *found["outputs"]])
    lines = ["# laws fitted to given data; a study with these inputs runs with --model FILE.py:FUNCTION"]
    lines += [f"# {name} stands for the column {safe(column, 80)}" for column, name in called.items() if name != column]
    lines += ["", "[inputs]"]
    given = set()
    for column, entry in found["inputs"].items():
        name = called[column]
        if entry.get("fixed") is not None:
            lines.append(f"{name} = {entry['fixed']!r}")
            continue
        if entry["chosen"] in (None, "kde", "empirical"):
            lines.append(f"# {name}: {safe(entry['reason'])}; give it as an empirical law with its own CSV")
            continue
        given.add(column)
        keys = ", ".join(f"{key} = {value!r}" for key, value in entry["parameters"].items())
        lines.append(f'{name} = {{ dist = "{entry["chosen"]}", {keys} }}')
    for pair in found["dependence"]:
        if pair["dependent"] and given.issuperset(pair["of"]):
            names = ", ".join(f'"{called[column]}"' for column in pair["of"])
            # a study refuses inputs that give each other
            rank = min(max(pair["spearman"]["value"], -_STRONGEST), _STRONGEST)
            lines += ["", "[[dependence]]", f"of = [{names}]", f"spearman = {rank:.4f}"]
            if pair.get("copula") not in (None, "gaussian"):
                lines.append(f'copula = "{pair["copula"]}"')
    names = ", ".join(f'"{called[column]}"' for column in found["outputs"])
    return "\n".join([*lines, "", "[outputs]", f"names = [{names}]", ""])


def _study_names(columns: Sequence[str]) -> dict[str, str]:
    """Names that a study takes, each once, for columns: their own where they are such, else without unit and signs.

    >>> _study_names(["E [GPa]", "b", "E", "%"])
    {'b': 'b', 'E': 'E', 'E [GPa]': 'E_2', '%': 'column'}
    """
    called = {column: column for column in columns if valid_name(column) and column not in RESERVED}
    for column in columns:
        if column in called:
            continue
        name = "".join(c if valid_name(f"a{c}") else "_" for c in _UNIT.sub("", column)[:_LONGEST])
        stem = name if name.strip("_-") and valid_name(name) and name not in RESERVED else "column"
        name, number = stem, 1
        while name in called.values():
            number += 1
            name = f"{stem}_{number}"
        called[column] = name
    return called
