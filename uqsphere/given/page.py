"""The analysis of a table of runs as a page with figures: what drives each output, how it and the inputs are spread."""

from __future__ import annotations

from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.given.table import Data, Document
from uqsphere.given.text import dependence_lines, expansion_line
from uqsphere.report.blocks import Block, Chapter, Table, cell, index_cell
from uqsphere.report.brief import Answer, Brief
from uqsphere.report.feed import page_files, told_cautions
from uqsphere.report.figures.canvas import BLUE, GREY, INK, Picture, new_figure, shorten, slug, style
from uqsphere.report.figures.distributions import draw_indices
from uqsphere.report.phrases import two
from uqsphere.results.entries import Est

#: outputs whose mean is set large, inputs of a figure, bars of a histogram
_LARGE, _ROWS, _BINS = 3, 24, 40
_CALLED: Final = {"mean": "mean", "sd": "standard deviation"}


def analysis_page(found: Document, data: Data) -> dict[str, str]:
    """report.html of an analysis with the files of its figures: name -> text."""
    outputs = tuple(_output(found, data, k, name) for k, name in enumerate(data.outputs))
    parts = [
        Chapter(anchor="drivers", heading="What drives the outputs",
                blocks=tuple(_drivers(found, k, name) for k, name in enumerate(data.outputs))),
        Chapter(anchor="outputs", heading="The outputs", blocks=outputs),
        Chapter(anchor="inputs", heading="The inputs", blocks=(_inputs(found),)),
    ]  # fmt: skip
    return page_files("analysis of given data", _brief(found, data), parts)


def _est(entry: Document) -> Est:
    return Est.model_validate(entry)


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
        best = (entry["expansion"] or {}).get("mean", {}).get("whole") or entry["mean"]
        ends = [entry["quantiles"][p]["value"] for p in ("0.05", "0.95") if p in entry["quantiles"]]
        note = f"Nine of ten runs: {two(ends[0])} to {two(ends[1])}." if len(ends) == 2 and None not in ends else ""
        big = "not known" if best["value"] is None else two(best["value"], 3)
        answers.append(Answer(question=f"{shorten(name, 40)}, mean", big=big, unit="", note=note))
    known = _shares(found, data.outputs[0])[1]
    shares = sorted(((e.number, source) for source, e in known.items() if e.value is not None), reverse=True)
    drivers = tuple((shorten(source, 30), min(max(value, 0.0), 1.0)) for value, source in shares[:2] if value > 0.0)
    told = [f"{shorten(n, 30)}: {text}" for n, one in found["sensitivity"].items() for text in one["disagree"]]
    told += [text for entry in found["outputs"].values() for text in entry["notes"]]
    told += [f"{shorten(n, 30)}: {one['chaos']['reason']}" for n, one in found["sensitivity"].items()
             if not one["chaos"]["usable"]]  # fmt: skip
    laws = "laws given" if found["laws"] == "known" else "laws fitted to the runs"
    measure = (
        ("More runs", "They narrow what is left open of indices and quantiles.")
        if found["laws"] == "known"
        else ("Laws of the inputs", "Where they are known, give them: --laws STUDY.toml.")
    )
    return Brief(
        title=f"{found['rows']:,} runs of {', '.join(data.outputs)}",
        answers=tuple(answers),
        drivers=drivers if sum(value for _, value in drivers) <= 1.0 else drivers[:1],
        driven=shorten(data.outputs[0], 40),
        measure=measure,
        cautions=told_cautions(told),
        footer=f"{found['rows']:,} runs · {len(data.inputs)} inputs · {laws}".replace(",", "\u202f"),
    )


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
    ranks = found["sensitivity"][name]["ranks"]
    rows = tuple((source, index_cell(_est(ranks[source])), index_cell(one[source]), index_cell(other[source]))
                 for source in names)  # fmt: skip
    table = Table(caption=f"Shares of the variance of {name}", header=("input", "by ranks", *words), rows=rows)
    return Block(heading=name, picture=picture, table=table, remarks=(expansion_line(found, name),))


def _output(found: Document, data: Data, number: int, name: str) -> Block:
    entry, values = found["outputs"][name], data.y[:, number]
    told = entry["expansion"]
    estimates = {**{key: entry[key] for key in _CALLED}, **entry["quantiles"]}
    rows = []
    for key, estimate in estimates.items():
        label = _CALLED.get(key) or f"{100.0 * float(key):g} % quantile"
        rows.append((label, cell(_est(estimate)), "–" if told is None else cell(_est(told[key]["whole"]))))
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


def _inputs(found: Document) -> Block:
    rows = []
    for name, entry in found["inputs"].items():
        if entry["chosen"] is None:
            fixed = entry.get("fixed")
            rows.append((name, "–" if fixed is None else "fixed", "", "–" if fixed is None else f"{fixed:.5g}", ""))
            continue
        fit = f"{entry['fits'][0]['p_value']:.2g}"
        rows.append((name, entry["chosen"], fit, f"{entry['mean']:.5g}", f"{entry['sd']:.4g}"))
    header = ("input", "law", "fit (p)", "mean", "standard deviation")
    table = Table(caption="Laws", header=header, rows=tuple(rows), note="A fit below 0.01 is refused.")
    return Block(heading="Laws and dependence", table=table, remarks=tuple(dependence_lines(found)))
