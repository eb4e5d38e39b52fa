"""The pages of `uqsphere fit` and `uqsphere feed`: a brief of what is asked, then the evidence, from what is stored."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, Final

from uqsphere.feed.answers import Answer as Told
from uqsphere.feed.answers import FeedEntry
from uqsphere.feed.fit import FitEntry, Interval, Posterior
from uqsphere.feed.tests import Specimens
from uqsphere.report.blocks import Block, Chapter, Table
from uqsphere.report.brief import Answer, Brief
from uqsphere.report.cautions import Caution
from uqsphere.report.figures.canvas import Picture, inline, render, shorten
from uqsphere.report.figures.feed import classes_plot, parameters_plot, probability_plot, product_plot, size_plot
from uqsphere.report.page import set_page
from uqsphere.report.phrases import capital, counted
from uqsphere.store import csv_text

#: rows of the table of tested sizes
_MOST_SIZES: Final = 12
_SURE: Final = "from memory, not checked at the source"
#: what is on the pages from memory: found on the page, and said there
_MARKED: Final = (
    ("ratio", f"E_max/E50 = 4 is called Rocky's default {_SURE}."),
    ("jk", f"The range of the drop-weight test, 0.1 to 2.5 kWh/t and 13 to 63 mm, is {_SURE}."),
)


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


def _answer(question: str, answer: Told, factor: float, unit: str) -> Answer:
    if answer.value is None:
        return Answer(question=question, big="–", unit="", note=answer.reason)
    own, big = _ends(answer.low, answer.high, factor), _n(answer.value, factor)
    lots = own if answer.lot_low is None else _ends(answer.lot_low, answer.lot_high, factor)
    note = f"95 %: {own}{'' if lots == own else f', {lots} in a lot'}."
    return Answer(
        question=question, big=big, unit=unit, note="The same in every draw." if own == f"{big} to {big}" else note
    )


def _feed_brief(entry: FeedEntry) -> Brief:
    goal, broken = entry.goal, _answer("Share of the feed broken", entry.broken, 100.0, "%")
    if goal is not None:
        asked = f"Asked: at least {100 * goal.broken:.3g} % broken, {100 * goal.at_least:.3g} % sure."
        reasons = tuple(f"{capital(why)}." for why in goal.reasons)
        broken = replace(broken, verdict=goal.verdict, reasons=(asked, *reasons))
    p80, energy, blows = entry.p80, entry.energy, counted(entry.blows, "blow")
    answers = (
        broken, _answer("P80 of the product", p80, 1e3, "mm"),
        _answer("Given to the particles", energy, 1.0 / 3600.0, "kWh/t"),
    )  # fmt: skip
    beyond = [one for one in entry.classes if one.extrapolated and one.mass > 0.0]
    heaviest = max(beyond or entry.classes, key=lambda one: one.mass * (one.broken.ignorance or 0.0))
    reason = "Beyond the tested sizes" if beyond else "Where the feed weighs most on what is not known"
    return Brief(
        title=_title(entry.title), answers=answers, drivers=_drivers(entry.broken), driven="share of the feed broken",
        measure=(f"Tests at {_n(heaviest.size, 1e3)} mm", f"{reason}."),
        cautions=told_cautions(entry.warnings, made_up=entry.made_up),
        footer=" · ".join([*entry.of.values(), blows, f"{entry.draws} draws", entry.hash[:8]]),
    )  # fmt: skip


def _title(text: str) -> str:
    return shorten(text, 200) or "Untitled study"


def _drivers(answer: Told) -> tuple[tuple[str, float], ...]:
    """Shares of the variance of the share broken."""
    parts = {"ignorance": (answer.ignorance or 0.0) ** 2, "scatter": (answer.scatter or 0.0) ** 2}
    total = sum(parts.values())
    ranked = sorted(parts.items(), key=lambda part: -part[1])
    return tuple((name, part / total) for name, part in ranked if part > 0.02 * total) if total > 0.0 else ()


def told_cautions(texts: Iterable[str], *, made_up: bool = False) -> tuple[Caution, ...]:
    """Warnings as a brief has them, in their order; that tests are made up comes first, once."""
    first = (Caution(rank=0, text="The tests are made up: no number of this page is of a rock."),) if made_up else ()
    rest = (f"{capital(shorten(text, 180)).rstrip('.')}." for text in texts if "made up" not in text)
    return (*first, *(Caution(rank=1, text=text) for text in rest))


def _fit_brief(entry: FitEntry) -> Brief:
    sizes = [entry.sizes[k] for k in sorted({0, len(entry.sizes) // 2, len(entry.sizes) - 1})] if entry.sizes else []
    answers = tuple(
        Answer(
            question=f"Breaks half at {_n(one.diameter, 1e3)} mm ({one.tests} tests)",
            big=_n(one.half.value), unit="J/kg",
            note=f"95 %: {_ends(one.half.low, one.half.high, 1.0)}." if one.half.value is not None else one.half.reason,
        )
        for one in sizes
    )  # fmt: skip
    untold = [name for part in entry.parameters.values() for name, one in part.items() if not one.told]
    names = ", ".join(dict.fromkeys(untold))
    measure = ("More of the same", "Every parameter is told.")
    if untold:
        measure = (f"Tests that tell {names}", "As wide as its prior so far.")
    tests = "" if entry.tests is None else f"{entry.tests.particles} particles, {entry.tests.broke} broke · "
    return Brief(
        title=_title(entry.title), answers=answers, measure=measure,
        cautions=told_cautions(entry.warnings, made_up=entry.made_up),
        footer=f"{tests}law {entry.law}, size {entry.size}, {entry.method}",
    )  # fmt: skip


# --- the evidence ---------------------------------------------------------------------------------------------


def _fit_parts(entry: FitEntry, posterior: Posterior, tests: Specimens | None, feed: FeedEntry | None) -> list[Chapter]:
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
    remarks = (*(f"{capital(text)}." for text in entry.warnings), f"Goodness of fit: {fits}.")
    remarks += (_MARKED[0][1],) if entry.ratio == 4.0 else ()
    return [
        Chapter(anchor="tests", heading="What the tests tell", blocks=(
            *blocks,
            Block(heading="By size", table=Table(caption="Energies by size", header=head, rows=sizes, note=note)),
            Block(heading="Parameters, posterior and prior", table=Table(
                caption="sd of the logarithm", rows=parameters,
                header=("parameter", "unit", "median (95 %)", "sd", "prior sd", "told"))),
            Block(heading="Laws compared", remarks=remarks, kind="notes", table=Table(
                caption="The same tests", rows=laws, header=("law", "ln likelihood", "left-one-out", "weight", ""))),
        )),
    ]  # fmt: skip


def _feed_parts(entry: FeedEntry) -> list[Chapter]:
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
    remarks = tuple(f"{capital(text)}." for text in entry.warnings)
    remarks += (f"The curve: {entry.curve_law}, {entry.sources.get('t_n', '')}.",) if entry.curve else ()
    remarks += (_MARKED[1][1],) if entry.form == "jk" and entry.curve else ()
    if entry.spectrum_error:
        remarks += (f"The spectrum is sampled: ± {entry.spectrum_error:.1g} of the share broken.",)
    return [
        Chapter(anchor="feed", heading="The feed", blocks=(
            *blocks,
            Block(heading="Answers", table=Table(caption="Scatter and ignorance apart", header=head, rows=rows)),
            Block(heading="By class", remarks=remarks, table=Table(
                caption="* beyond the tested sizes", header=class_head, rows=classes)),
            Block(heading="The product’s numbers", kind="notes", table=Table(
                caption="In SI", header=("number", "median (95 %)", "from"), rows=numbers)),
        )),
    ]  # fmt: skip


def page_files(kind: str, brief: Brief, chapters: Sequence[Chapter]) -> dict[str, str]:
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

    return {"report.html": set_page({"brief": brief, "kind": kind}, chapters, drawn), **files}


def fit_page(entry: FitEntry, posterior: Posterior, tests: Specimens) -> dict[str, str]:
    """report.html of a fit with the files of its figures: name -> text."""
    return page_files("fit of single particles", _fit_brief(entry), _fit_parts(entry, posterior, tests, None))


def feed_page(entry: FeedEntry, fitted: FitEntry, posterior: Posterior, tests: Specimens | None) -> dict[str, str]:
    """report.html of a feed with the files of its figures: name -> text; without tests their figures are left out."""
    parts = [*_feed_parts(entry), *_fit_parts(fitted, posterior, tests, entry)]
    return page_files("feed", _feed_brief(entry), parts)
