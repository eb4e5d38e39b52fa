"""The pages of `uqsphere fit` and `uqsphere feed`: a brief of what is asked, then the evidence, from what is stored."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from uqsphere.feed.answers import Answer, FeedEntry
from uqsphere.feed.fit import FitEntry, Interval, Posterior
from uqsphere.feed.tests import Specimens
from uqsphere.report.blocks import Block, Table
from uqsphere.report.figures.canvas import Picture, inline, render, shorten
from uqsphere.report.figures.feed import classes_plot, parameters_plot, probability_plot, product_plot, size_plot
from uqsphere.report.page import new_environment
from uqsphere.store import csv_text

#: most cautions of a brief
_CAUTIONS: Final = 3
#: rows of the table of tested sizes
_MOST_SIZES: Final = 12
_SURE: Final = "from memory, not checked at the source"
#: what is on the pages from memory: found on the page, and said there
_MARKED: Final = (
    ("ratio", f"E_max/E50 = 4 is called Rocky's default {_SURE}."),
    ("jk", f"The range of the drop-weight test, 0.1 to 2.5 kWh/t and 13 to 63 mm, is {_SURE}."),
)


@dataclass(frozen=True, kw_only=True)
class Headline:
    """One answer of the brief: a question, a number with its unit, a note, and the verdict of a target."""

    question: str
    big: str
    unit: str
    note: str
    verdict: str = ""
    reason: str = ""


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of the evidence."""

    anchor: str
    heading: str
    blocks: tuple[Block, ...] = field(default_factory=tuple)


def _n(value: float | None, factor: float = 1.0) -> str:
    """Three digits, without powers of ten where people would not use them."""
    if value is None:
        return "–"
    number = value * factor if abs(value) > 1e-12 else 0.0
    return f"{number:.3g}" if abs(number) < 1e3 or abs(number) >= 1e6 else f"{number:.0f}"


def _ends(low: float | None, high: float | None, factor: float) -> str:
    return "–" if low is None or high is None else f"{_n(low, factor)} to {_n(high, factor)}"


def _interval(one: Interval, factor: float = 1.0) -> str:
    return one.reason or "–" if one.value is None else f"{_n(one.value, factor)} ({_ends(one.low, one.high, factor)})"


# --- the brief ------------------------------------------------------------------------------------------------


def _headline(question: str, answer: Answer, factor: float, unit: str) -> Headline:
    if answer.value is None:
        return Headline(question=question, big="–", unit="", note=answer.reason)
    own, big = _ends(answer.low, answer.high, factor), _n(answer.value, factor)
    lots = own if answer.lot_low is None else _ends(answer.lot_low, answer.lot_high, factor)
    if own == f"{big} to {big}":
        return Headline(question=question, big=big, unit=unit, note="The same in every draw.")
    note = f"95 %: {own}{'' if lots == own else f', {lots} in a lot'}."
    return Headline(question=question, big=big, unit=unit, note=note)


def _feed_brief(entry: FeedEntry) -> dict[str, Any]:
    goal, broken = entry.goal, _headline("Share of the feed broken", entry.broken, 100.0, "%")
    if goal is not None:
        why = "; ".join(goal.reasons)
        reason = f"At least {100 * goal.broken:.3g} %, {100 * goal.at_least:.3g} % sure. {_begun(why)}"
        broken = Headline(**{**vars(broken), "verdict": goal.verdict, "reason": reason.strip()})
    answers = [
        broken,
        _headline("P80 of the product", entry.p80, 1e3, "mm"),
        _headline("Given to the particles", entry.energy, 1.0 / 3600.0, "kWh/t"),
    ]
    beyond = [one for one in entry.classes if one.extrapolated and one.mass > 0.0]
    heaviest = max(beyond or entry.classes, key=lambda one: one.mass * (one.broken.ignorance or 0.0))
    reason = "Beyond the tested sizes" if beyond else "Where the feed weighs most on what is not known"
    measure = (f"Tests at {_n(heaviest.size, 1e3)} mm", f"{reason}.")
    return {
        "answers": answers, "measure": measure, "drivers": _drivers(entry.broken), "cautions": _first(entry.warnings),
        "made_up": entry.made_up,
        "footer": " · ".join([*entry.of.values(), _blows(entry.blows), f"{entry.draws} draws", entry.hash[:8]]),
    }  # fmt: skip


def _blows(count: int) -> str:
    return "one blow" if count == 1 else f"{count} blows"


def _drivers(answer: Answer) -> list[tuple[str, float]]:
    """Shares of the variance of the share broken."""
    if answer.scatter is None or answer.ignorance is None:
        return []
    parts = {"Ignorance": answer.ignorance**2, "Scatter": answer.scatter**2}
    total = sum(parts.values())
    return sorted(((name, part / total) for name, part in parts.items()), key=lambda p: -p[1]) if total > 0.0 else []


def _first(texts: Iterable[str]) -> list[str]:
    return [f"{_begun(shorten(text, 180)).rstrip('.')}." for text in texts if "made up" not in text][:_CAUTIONS]


def _begun(text: str) -> str:
    return text[:1].upper() + text[1:]


def _fit_brief(entry: FitEntry) -> dict[str, Any]:
    sizes = [entry.sizes[k] for k in sorted({0, len(entry.sizes) // 2, len(entry.sizes) - 1})] if entry.sizes else []
    answers = [
        Headline(
            question=f"Breaks half at {_n(one.diameter, 1e3)} mm ({one.tests} tests)",
            big=_n(one.half.value), unit="J/kg",
            note=f"95 %: {_ends(one.half.low, one.half.high, 1.0)}." if one.half.value is not None else one.half.reason,
        )
        for one in sizes
    ]  # fmt: skip
    untold = [name for part in entry.parameters.values() for name, one in part.items() if not one.told]
    names = ", ".join(dict.fromkeys(untold))
    measure = ("More of the same", "Every parameter is told.")
    if untold:
        measure = (f"Tests that tell {names}", "As wide as its prior so far.")
    tests = "" if entry.tests is None else f"{entry.tests.particles} particles, {entry.tests.broke} broke · "
    return {
        "answers": answers, "measure": measure, "drivers": [], "cautions": _first(entry.warnings),
        "made_up": entry.made_up, "footer": f"{tests}law {entry.law}, size {entry.size}, {entry.method}",
    }  # fmt: skip


# --- the evidence ---------------------------------------------------------------------------------------------


def _fit_parts(entry: FitEntry, posterior: Posterior, tests: Specimens | None, feed: FeedEntry | None) -> list[Part]:
    pictures = [] if tests is None else [
        ("Tests and law", probability_plot(tests, posterior)), ("Size", size_plot(tests, posterior, feed)),
        *((("Parameters", parameters_plot(posterior, entry)),) if entry.parameters else ()),
    ]  # fmt: skip
    blocks = [Block(heading=heading, picture=picture) for heading, picture in pictures]
    sizes = tuple(
        (_n(one.diameter, 1e3), str(one.tests), str(one.broke), _interval(one.E50), _interval(one.half),
         _interval(one.slope), "; ".join(f"{law} {_interval(low)}" for law, low in one.low_tail.items()))
        for one in entry.sizes[:: max(1, -(-len(entry.sizes) // _MOST_SIZES))]
    )  # fmt: skip
    head = ("mm", "tests", "broke", "E50 [J/kg]", "breaks half [J/kg]", "-d ln E50/d ln d", "breaks 1 % [J/kg]")
    note = "E50 is the median of e* = e/(1 - e/E_max): with a bound E_max half of the particles break below it."
    note += f" {len(sizes)} of {len(entry.sizes)} sizes." if len(sizes) < len(entry.sizes) else ""
    parameters = tuple(
        (f"{law}: {name}", one.unit, _interval(one.posterior), f"{one.sd:.2g}",
         "flat" if one.prior is None else f"{one.prior[1]:.2g}", "yes" if one.told else "no: as wide as the prior")
        for law, part in entry.parameters.items() for name, one in part.items()
    )  # fmt: skip
    laws = tuple(
        (
            one.name,
            f"{one.log_likelihood:.2f}",
            "–" if one.loo is None else f"{one.loo:.2f}",
            f"{one.weight:.2f}",
            one.words,
        )
        for one in entry.laws
    )
    good = entry.goodness
    fits = (
        good.reason
        or f"distance {_n(good.distance)}, of {good.series} made-up series {_n(good.p_value, 100.0)} % lie farther"
    )
    remarks = (*(f"{text[:1].upper()}{text[1:]}." for text in entry.warnings), f"Goodness of fit: {fits}.")
    remarks += (_MARKED[0][1],) if entry.ratio == 4.0 else ()
    return [
        Part(anchor="tests", heading="What the tests tell", blocks=(
            *blocks,
            Block(heading="By size", table=Table(caption="Energies by size", header=head, rows=sizes, note=note)),
            Block(heading="Parameters, posterior and prior", table=Table(
                caption="sd of the logarithm", rows=parameters,
                header=("parameter", "unit", "median (95 %)", "sd", "prior sd", "told"))),
            Block(heading="Laws compared", remarks=remarks, kind="notes", table=Table(
                caption="The same tests", rows=laws, header=("law", "ln likelihood", "left-one-out", "weight", ""))),
        )),
    ]  # fmt: skip


def _feed_parts(entry: FeedEntry) -> list[Part]:
    pictures = [("Share broken by class", classes_plot(entry))]
    pictures += [("Product", product_plot(entry))] if entry.curve else []
    blocks = [Block(heading=heading, picture=picture) for heading, picture in pictures]
    named = (("share broken", entry.broken, 100.0, "%"), ("never broken", entry.never, 100.0, "%"),
             ("expected blows", entry.expected_blows, 1.0, ""), ("t10 of what breaks", entry.t10, 100.0, "%"),
             ("P80", entry.p80, 1e3, "mm"), ("P50", entry.p50, 1e3, "mm"), ("F80/P80", entry.reduction, 1.0, ""),
             ("fines", entry.fines, 100.0, "%"),
             ("given to the particles", entry.energy, 1.0 / 3600.0, "kWh/t"))  # fmt: skip
    rows = tuple(
        (name, unit, _n(a.value, f), _ends(a.low, a.high, f), _ends(a.lot_low, a.lot_high, f), _n(a.ignorance, f),
         _n(a.scatter, f), a.reason)
        for name, a, f, unit in named
    )  # fmt: skip
    head = ("answer", "unit", "mean", "95 %: ignorance", "95 %: a lot", "sd: ignorance", "sd: scatter", "")
    classes = tuple(
        (f"{_n(one.lower, 1e3)} to {_n(one.upper, 1e3)}{' *' if one.extrapolated else ''}", _n(one.mass, 100.0),
         _n(one.particles), _interval(one.E50), _n(one.broken.value, 100.0),
         _ends(one.broken.low, one.broken.high, 100.0), _ends(one.broken.lot_low, one.broken.lot_high, 100.0),
         _n(one.blows.value))
        for one in entry.classes
    )  # fmt: skip
    class_head = ("class [mm]", "mass [%]", "particles", "E50 [J/kg]", "broken [%]", "ignorance", "a lot", "blows")
    numbers = tuple((name, _interval(one), entry.sources.get(name, "")) for name, one in entry.product.items())
    remarks = tuple(f"{_begun(text)}." for text in entry.warnings)
    remarks += (f"The curve: {entry.curve_law}, {entry.sources.get('t_n', '')}.",) if entry.curve else ()
    remarks += (_MARKED[1][1],) if entry.form == "jk" and entry.curve else ()
    if entry.spectrum_error:
        remarks += (f"The spectrum is sampled: ± {entry.spectrum_error:.1g} of the share broken.",)
    return [
        Part(anchor="feed", heading="The feed", blocks=(
            *blocks,
            Block(heading="Answers", table=Table(caption="Scatter and ignorance apart", header=head, rows=rows)),
            Block(heading="By class", remarks=remarks, table=Table(
                caption="* beyond the tested sizes", header=class_head, rows=classes)),
            Block(heading="The product’s numbers", kind="notes", table=Table(
                caption="In SI", header=("number", "median (95 %)", "from"), rows=numbers)),
        )),
    ]  # fmt: skip


def page_files(title: str, kind: str, brief: dict[str, Any], parts: Sequence[Part]) -> dict[str, str]:
    """The page and the files of its figures, by their names."""
    from markupsafe import Markup

    files: dict[str, str] = {}

    def drawn(picture: Picture) -> Any:
        svg = render(picture)
        files[f"figures/{picture.name}.svg"] = svg
        if picture.header:
            files[f"figures/{picture.name}.csv"] = csv_text(picture.header, [
                ["" if cell is None else cell for cell in row] for row in picture.rows
            ])  # fmt: skip
        # the one text that is not escaped: made of escaped parts by the XML writer
        return Markup(inline(svg, picture.name))

    environment = new_environment()
    environment.filters["drawn"] = drawn
    shown = {**brief, "title": shorten(title, 200) or "Untitled study", "kind": kind, "chapters": parts, "version": "",
             "margin_boxes": ""}  # fmt: skip
    return {"report.html": environment.get_template("feed.html").render(shown) + "\n", **files}


def fit_page(entry: FitEntry, posterior: Posterior, tests: Specimens) -> dict[str, str]:
    """report.html of a fit with the files of its figures: name -> text."""
    return page_files(
        entry.title, "fit of single particles", _fit_brief(entry), _fit_parts(entry, posterior, tests, None)
    )


def feed_page(entry: FeedEntry, fitted: FitEntry, posterior: Posterior, tests: Specimens | None) -> dict[str, str]:
    """report.html of a feed with the files of its figures: name -> text; without tests their figures are left out."""
    parts = [*_feed_parts(entry), *_fit_parts(fitted, posterior, tests, entry)]
    return page_files(entry.title, "feed", _feed_brief(entry), parts)
