"""The pages of `uqsphere fit` and `uqsphere feed`: a brief of what is asked, then the evidence, from what is stored."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from operator import attrgetter
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.console import screen_width, table, wrap, writable
from uqsphere.feed.answers import Answer as Told
from uqsphere.feed.answers import ClassEntry, FeedEntry
from uqsphere.feed.fit import FitEntry, Interval, Posterior
from uqsphere.feed.tests import Specimens
from uqsphere.report.brief import Answer, Brief
from uqsphere.report.cautions import Caution
from uqsphere.report.figures import canvas
from uqsphere.report.page import set_page
from uqsphere.report.phrases import Block, Chapter, Table, capital, counted
from uqsphere.store import csv_text

#: rows of the table of tested sizes
_MOST_SIZES: Final = 12
_SURE: Final = "from memory, not checked at the source"


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
    heaviest = _least_known(beyond or entry.classes)
    reason = "Beyond the tested sizes" if beyond else "Where the feed weighs most on what is not known"
    return Brief(
        title=_title(entry.title), answers=answers, drivers=_drivers(entry.broken), driven="share of the feed broken",
        measure=(f"Tests at {_n(heaviest.size, 1e3)} mm", f"{reason}."),
        cautions=told_cautions(entry.warnings, made_up=entry.made_up),
        footer=" · ".join([*entry.of.values(), blows, f"{entry.draws} draws", entry.hash[:8]]),
    )  # fmt: skip


def _least_known(classes: Sequence[ClassEntry]) -> ClassEntry:
    """The class that weighs most on what is not known."""
    return max(classes, key=lambda one: one.mass * (one.broken.ignorance or 0.0))


def _title(text: str) -> str:
    return canvas.shorten(text, 200) or "Untitled study"


def _drivers(answer: Told) -> tuple[tuple[str, float], ...]:
    """Shares of the variance of the share broken."""
    parts = {"ignorance": (answer.ignorance or 0.0) ** 2, "scatter": (answer.scatter or 0.0) ** 2}
    total = sum(parts.values())
    ranked = sorted(parts.items(), key=lambda part: -part[1])
    return tuple((name, part / total) for name, part in ranked if part > 0.02 * total) if total > 0.0 else ()


def told_cautions(texts: Iterable[str], *, made_up: bool = False) -> tuple[Caution, ...]:
    """Warnings as a brief has them, in their order; that tests are made up comes first, once."""
    first = (Caution(rank=0, text="The tests are made up: no number of this page is of a rock."),) if made_up else ()
    rest = (f"{capital(canvas.shorten(text, 180)).rstrip('.')}." for text in texts if "made up" not in text)
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


def fit_tables(entry: FitEntry) -> tuple[Table, Table, Table]:
    """Energies by size, parameters beside their priors, and the laws compared."""
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
        (one.name, f"{one.log_likelihood:.2f}", "–" if one.loo is None else f"{one.loo:.2f}", f"{one.weight:.2f}",
         one.words) for one in entry.laws
    )  # fmt: skip
    return (
        Table(caption="Energies by size", header=head, rows=sizes, note=note),
        Table(caption="sd of the logarithm", rows=parameters,
              header=("parameter", "unit", "median (95 %)", "sd", "prior sd", "told")),
        Table(caption="The same tests", rows=laws, header=("law", "ln likelihood", "left-one-out", "weight", "")),
    )  # fmt: skip


def _goodness(entry: FitEntry) -> str:
    found = entry.goodness
    share = f"of {found.series} made-up series {_n(found.p_value, 100.0)} % lie farther"
    return f"Goodness of fit: {found.reason or f'distance {_n(found.distance)}, {share}'}."


def fit_text(entry: FitEntry) -> str:
    """A fit for the terminal."""
    about, bound = entry.tests, "" if entry.ratio is None else f", E_max/E50 {entry.ratio:g}"
    said = f"{entry.title}: {entry.law.replace('_', '-')} law{bound}, size {entry.size}, {entry.method}"
    if about is not None:
        said += f"; {about.particles} particles, {about.broke} broke, {about.repeated} hit more than once"
    return _in_terminal(said, fit_tables(entry), [_goodness(entry)], entry.warnings)


def _in_terminal(said: str, tables: Iterable[Table], more: Sequence[str], warnings: Iterable[str]) -> str:
    width = screen_width()
    texts = [*more, *(f"note: {text}" for text in warnings)]
    blocks = [wrap(said, width), *(table(one.header, one.rows, width) for one in tables)]
    return writable("\n\n".join([*blocks, *(wrap(text, width) for text in texts)]))


def _fit_parts(entry: FitEntry, posterior: Posterior, tests: Specimens | None, feed: FeedEntry | None) -> list[Chapter]:
    pictures = () if tests is None else (probability_plot(tests, posterior), size_plot(tests, posterior, feed))
    sizes, parameters, laws = fit_tables(entry)
    remarks = (*(f"{capital(text)}." for text in entry.warnings), _goodness(entry))
    remarks += (f"E_max/E50 = 4 is called Rocky's default {_SURE}.",) if entry.ratio == 4.0 else ()
    blocks = (
        *(Block(heading=picture.title, picture=picture) for picture in pictures),
        Block(heading="By size", table=sizes),
        Block(heading="Parameters, posterior and prior", table=parameters),
        Block(heading="Laws compared", remarks=remarks, kind="notes", table=laws),
    )
    return [Chapter(anchor="tests", heading="What the tests tell", blocks=blocks)]


def answers_table(entry: FeedEntry) -> Table:
    """Every answer on a feed, with what more tests would tell and what a lot adds."""
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
    return Table(caption="Scatter and ignorance apart", header=head, rows=rows)


def feed_text(entry: FeedEntry) -> str:
    """The answers of a feed for the terminal."""
    said, goal, more = f"{entry.title}: {', '.join(entry.of.values())}; {counted(entry.blows, 'blow')}", entry.goal, []
    if goal is not None:
        why = f" ({'; '.join(goal.reasons)})" if goal.reasons else ""
        asked = f"target, at least {100 * goal.broken:.3g} % broken, {100 * goal.at_least:.3g} % sure: {goal.verdict}"
        more = [f"{asked}; its probability is {100 * goal.probability:.3g} %{why}"]
    answers = answers_table(entry)
    header, *rows = (row[:5] + row[7:] for row in (answers.header, *answers.rows))  # standard deviations: on the page
    return _in_terminal(said, [replace(answers, header=header, rows=tuple(rows))], more, entry.warnings)


def _feed_parts(entry: FeedEntry) -> list[Chapter]:
    pictures = (classes_plot(entry), *((product_plot(entry),) if entry.curve else ()))
    classes = tuple(
        (f"{_n(one.lower, 1e3)} to {_n(one.upper, 1e3)}{' *' if one.extrapolated else ''}", _n(one.mass, 100.0),
         _n(one.particles), _interval(one.E50), _n(one.broken.value, 100.0),
         _ends(one.broken.low, one.broken.high, 100.0), _ends(one.broken.lot_low, one.broken.lot_high, 100.0),
         _n(one.blows.value))
        for one in entry.classes
    )  # fmt: skip
    class_head = ("class [mm]", "mass [%]", "particles", "E50 [J/kg]", "broken [%]", "ignorance", "a lot", "blows")
    numbers = tuple((name, _interval(one), entry.sources.get(name, "")) for name, one in entry.product.items())
    curve = f"The curve: {entry.curve_law}, {entry.sources.get('t_n', '')}."
    remarks: tuple[str, ...] = (curve,) if entry.curve else ()
    if entry.form == "jk" and entry.curve:
        remarks += (f"The range of the drop-weight test, 0.1 to 2.5 kWh/t and 13 to 63 mm, is {_SURE}.",)
    if entry.spectrum_error:
        remarks += (f"The spectrum is sampled: ± {entry.spectrum_error:.1g} of the share broken.",)
    blocks = (
        *(Block(heading=picture.title, picture=picture) for picture in pictures),
        Block(heading="Answers", table=answers_table(entry)),
        Block(heading="By class", remarks=remarks,
              table=Table(caption="* beyond the tested sizes", header=class_head, rows=classes)),
        Block(heading="The product’s numbers", kind="notes",
              table=Table(caption="In SI", header=("number", "median (95 %)", "from"), rows=numbers)),
    )  # fmt: skip
    return [Chapter(anchor="feed", heading="The feed", blocks=blocks)]


def page_files(kind: str, brief: Brief, chapters: Sequence[Chapter]) -> dict[str, str]:
    """The page and the files of its figures, by their names."""
    from markupsafe import Markup

    files: dict[str, str] = {}

    def drawn(picture: canvas.Picture) -> str:
        svg = canvas.render(picture)
        files[f"figures/{picture.name}.svg"] = svg
        if picture.header:
            files[f"figures/{picture.name}.csv"] = csv_text(picture.header, [
                ["" if cell is None else cell for cell in row] for row in picture.rows
            ])  # fmt: skip
        # the one text that is not escaped: made of escaped parts by the XML writer
        return Markup(canvas.inline(svg, picture.name))

    return {"report.html": set_page({"title": brief.title, "brief": brief, "kind": kind}, chapters, drawn), **files}


def fit_page(entry: FitEntry, posterior: Posterior, tests: Specimens) -> dict[str, str]:
    """report.html of a fit with the files of its figures: name -> text."""
    return page_files("fit of single particles", _fit_brief(entry), _fit_parts(entry, posterior, tests, None))


def feed_page(entry: FeedEntry, fitted: FitEntry, posterior: Posterior, tests: Specimens | None) -> dict[str, str]:
    """report.html of a feed with the files of its figures: name -> text; without tests their figures are left out."""
    parts = [*_feed_parts(entry), *_fit_parts(fitted, posterior, tests, entry)]
    return page_files("feed", _feed_brief(entry), parts)


# --- figures of tests of particles, of what they leave open, and of a feed ----------------------------------


#: sizes with a curve of their own, draws behind a band, points of a curve
_CURVES, _DRAWS, _POINTS = 5, 400, 80
#: shares that are marked on probability paper, and its ends
_TICKS: Final = (0.001, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 0.999)
_LEAST: Final = 5e-4
_ENDS: Final = (0.025, 0.5, 0.975)
_COLOURS: Final = (canvas.BLUE, canvas.RED, canvas.GREEN, canvas.PURPLE, canvas.ORANGE, canvas.SKY)
#: levels of energy that tests without a measured energy of failure are gathered at
_LEVELS: Final = 5


def _some(posterior: Posterior) -> Posterior:
    return posterior.at(np.unique(np.linspace(0, len(posterior) - 1, _DRAWS).astype(np.int64)))


def shown_sizes(tests: Specimens) -> list[tuple[float, Specimens]]:
    """The tests by size [m]; where there are many sizes, by equal steps of ln d, each with its geometric mean."""
    sizes = tests.sizes
    if len(sizes) <= _CURVES:
        nearest = np.abs(np.log(tests.diameter[:, None] / np.array(sizes))).argmin(axis=1)
        return [(size, tests.at(nearest == k)) for k, size in enumerate(sizes)]
    edges = np.geomspace(sizes[0] * 0.999, sizes[-1] * 1.001, _CURVES + 1)
    parts = [tests.at((tests.diameter >= low) & (tests.diameter < high)) for low, high in pairwise(edges)]
    return [(float(np.exp(np.log(part.diameter).mean())), part) for part in parts if len(part)]


def kaplan_meier(tests: Specimens) -> tuple[Array, Array]:
    """Energies [J/kg] of the failures that were measured and the share broken there, midway of each step; tests that
    outlasted theirs count from there on as left.

    >>> from uqsphere.feed.tests import make_specimens
    >>> kaplan_meier(make_specimens([0.01] * 3, [10.0, 20.0, 30.0], broke=[True, False, True]))[1].round(4).tolist()
    [0.1667, 0.6667]
    """
    energy, weight = tests.last, tests.weight
    order = np.lexsort((~tests.broke, energy))
    left, alive, found = float(weight.sum()), 1.0, []
    for k in order:
        if tests.broke[k]:
            after = alive * (1.0 - weight[k] / left)
            found.append((energy[k], 1.0 - 0.5 * (alive + after)))
            alive = after
        left -= weight[k]
    points = np.array(found).reshape(-1, 2)
    return points[:, 0], points[:, 1]


def _levels(tests: Specimens) -> Iterator[tuple[float, float, float]]:
    """Energy, share broken and particles of the levels of energy that were offered once."""
    order = np.argsort(tests.last)
    for part in np.array_split(order, min(_LEVELS, len(np.unique(tests.last)))):
        weight = tests.weight[part]
        share = float((weight * tests.broke[part]).sum() / weight.sum())
        yield float(np.exp(np.log(tests.last[part]).mean())), share, float(weight.sum())


def probability_plot(tests: Specimens, posterior: Posterior) -> canvas.Picture:
    """Share broken over energy by size: tests, those that outlasted theirs, and the law with what it leaves open."""
    some, rows = _some(posterior), list[tuple[float, float, float | None, str, float]]()
    with canvas.style():
        figure, (axes,) = canvas.new_figure(4.4)
        reach = np.geomspace(0.3 * tests.last.min(), 3.0 * tests.last.max(), _POINTS)
        for k, (size, part) in enumerate(shown_sizes(tests)):
            colour, mark = _COLOURS[k % len(_COLOURS)], canvas.MARKS[k % len(canvas.MARKS)]
            low, middle, high = (
                canvas.score(one, _LEAST) for one in np.quantile(some.broken(reach, size), _ENDS, axis=0)
            )
            canvas.band(axes, reach, low, high, colour, 0.12)
            axes.plot(reach, middle, color=colour, linewidth=1.3)
            once = part.at(~part.repeated)
            measured = bool(once.exact.any())
            energy, share = kaplan_meier(once.at((once.exact | ~once.broke) & measured))
            axes.plot(energy, canvas.score(share, _LEAST), mark, color=colour, markersize=4.5,
                      label=f"{1e3 * size:.3g} mm ({part.particles})")  # fmt: skip
            rows += [(size, float(e), float(s), "measured", 1.0) for e, s in zip(energy, share, strict=True)]
            for e, s, count in () if measured or not len(once) else _levels(once):
                wide = 4.0 + 0.6 * count**0.5
                axes.plot(e, canvas.score(s, _LEAST), mark, color=colour, markerfacecolor=canvas.PAPER, markersize=wide)
                rows.append((size, e, s, "offered", count))
            left = part.at(~part.broke).last
            foot = float(canvas.score(_LEAST, _LEAST)) + 0.12 * (1 + k)
            axes.plot(left, np.full(len(left), foot), "|", color=colour, markersize=7)
            rows += [(size, float(e), None, "left whole", 1.0) for e in left]
        axes.set_yticks(canvas.score(np.array(_TICKS), _LEAST), [f"{100 * p:g}" for p in _TICKS])
        axes.set_ylim(float(canvas.score(_LEAST, _LEAST)), float(canvas.score(1.0 - _LEAST, _LEAST)))
        axes.set_ylabel("share broken [%]")
        axes.grid(True, axis="y")
        canvas.log_axis(axes, "x", float(reach[0]), float(reach[-1]))
        canvas.frame(axes, x="energy that a particle takes up [J/kg]", legend=3)
    finding = (
        "Filled: energies at failure. Open: shares broken at an energy that was offered. Ticks: particles left whole, "
        "at their last energy. Bands: 95 % of what the tests leave open."
    )
    header = ("size [m]", "energy [J/kg]", "share", "what", "particles")
    title = "Share broken over energy, by size"
    return canvas.Picture(name="tests", title=title, finding=finding, figure=figure, header=header, rows=tuple(rows))


def size_plot(tests: Specimens, posterior: Posterior, feed: FeedEntry | None) -> canvas.Picture:
    """Energy that breaks half over size, with its band, the tested range and the classes of a feed."""
    some, (low, high) = _some(posterior), posterior.tested
    classes = [] if feed is None else [one.size for one in feed.classes[:-1] if one.mass > 0.0]
    ends = (min([low, *classes]) / 1.3, max([high, *classes]) * 1.3)
    sizes = np.geomspace(*ends, _POINTS) if posterior.size != "class" else np.array(posterior.classes)
    half = np.quantile(some.energy_at(0.5, sizes), _ENDS, axis=0)
    with canvas.style():
        figure, (axes,) = canvas.new_figure(3.6)
        axes.axvspan(1e3 * low, 1e3 * high, color=canvas.FAINT, alpha=0.5, linewidth=0.0, label="sizes tested")
        canvas.band(axes, 1e3 * sizes, half[0], half[2], canvas.BLUE, 0.2, label="95 %")
        axes.plot(1e3 * sizes, half[1], color=canvas.BLUE, marker="o" if posterior.size == "class" else None)
        for size, part in shown_sizes(tests):
            energy, share = kaplan_meier(part) if part.exact.any() and not part.repeated.any() else (np.empty(0),) * 2
            if share.min(initial=1.0) < 0.5 < share.max(initial=0.0):
                at = float(np.interp(0.5, share, energy))
                axes.plot(1e3 * size, at, "o", color=canvas.INK, markerfacecolor=canvas.PAPER, markersize=6)
        if classes:
            floor = np.full(len(classes), 0.9 * float(half[0].min()))
            axes.plot(1e3 * np.array(classes), floor, "|", color=canvas.RED, markersize=10, label="classes of the feed")
        canvas.log_axis(axes, "x", 1e3 * float(sizes[0]) / 1.05, 1e3 * float(sizes[-1]) * 1.05)
        canvas.log_axis(axes, "y", 0.8 * float(half[0].min()), 1.1 * float(half[2].max()))
        canvas.frame(axes, x="diameter [mm]", y="energy that breaks half [J/kg]")
        axes.grid(True)
        canvas.legend_above(axes, 3)
    rows = tuple(zip(*(column.tolist() for column in (sizes, *half)), strict=True))
    beyond = [size for size in classes if not low / 1.19 <= size <= high * 1.19]
    finding = "Circles: medians of the tests of one size." + (
        f" {len(beyond)} classes of the feed lie beyond the tested sizes: the band there rests on the law of size."
        if beyond else ""
    )  # fmt: skip
    header, title = ("size [m]", "low [J/kg]", "median [J/kg]", "high [J/kg]"), "Energy that breaks half, over size"
    return canvas.Picture(name="size", title=title, finding=finding, figure=figure, header=header, rows=rows)


def classes_plot(entry: FeedEntry) -> canvas.Picture:
    """Share broken by class, with what more tests would tell and what a lot adds."""
    classes = [one for one in entry.classes if one.mass > 0.0][::-1]
    at = np.arange(len(classes))
    value = np.array([100.0 * (one.broken.value or 0.0) for one in classes])
    with canvas.style():
        figure, (axes,) = canvas.new_figure(3.8)
        colours = [(canvas.SKY, canvas.FAINT)[one.extrapolated] for one in classes]
        bars = axes.bar(at, value, color=colours, edgecolor=canvas.GREY, linewidth=0.6, width=0.8)
        for bar, one in zip(bars, classes, strict=True):
            bar.set_hatch("//" * one.extrapolated)
        for of, aside, colour, label in (("", -0.14, canvas.BLUE, "ignorance: more tests"),
                                         ("lot_", 0.14, canvas.RED, "and scatter of a lot")):  # fmt: skip
            both = attrgetter(f"broken.{of}low", f"broken.{of}high")
            low, high = 100.0 * np.array([both(one) for one in classes], dtype=float).T
            if np.isfinite(low).any():
                axes.vlines(at + aside, low, high, color=colour, linewidth=2.2, label=label)
        axes.set_xticks(at, [f"{1e3 * one.size:.3g}" for one in classes], rotation=45)
        canvas.frame(axes, x="size of the class [mm] (hatched: beyond the tested sizes)", y="share broken [%]")
        axes.set_ylim(0.0, 104.0)
        axes.grid(True, axis="y")
        canvas.legend_above(axes, 2)
    header = ("size [m]", "mass", "broken", "low", "high", "lot_low", "lot_high", "ignorance", "scatter")
    told = attrgetter("size", "mass", "broken.value", *(f"broken.{key}" for key in header[3:]))
    rows = tuple(map(told, entry.classes))
    finding = f"Least is known where it counts at {1e3 * _least_known(entry.classes).size:.3g} mm."
    return canvas.Picture(
        name="classes", title="Share broken by class", finding=finding, figure=figure, header=header, rows=rows
    )


def product_plot(entry: FeedEntry) -> canvas.Picture:
    """The product's curve with its band, beside the feed's."""
    sieve, feed, value, low, high = (
        np.array([getattr(one, name) for one in entry.curve]) for name in ("sieve", "feed", "value", "low", "high")
    )
    with canvas.style():
        figure, (axes,) = canvas.new_figure(3.8)
        x = 1e3 * sieve
        canvas.band(axes, x, 100.0 * low, 100.0 * high, canvas.BLUE, 0.2, label="95 %")
        axes.plot(x, 100.0 * value, color=canvas.BLUE, label="product")
        axes.plot(x, 100.0 * feed, color=canvas.GREY, linestyle="--", label="feed")
        for share, answer in ((80.0, entry.p80), (50.0, entry.p50)):
            if answer.value is not None:
                axes.plot(1e3 * answer.value, share, "o", color=canvas.INK, markerfacecolor=canvas.PAPER, markersize=6)
                canvas.note(
                    axes, f"P{share:.0f} {1e3 * answer.value:.3g} mm", (1e3 * answer.value, share), (-7, 4), ha="right"
                )
        if entry.fines_sieve is not None:
            axes.axvline(1e3 * entry.fines_sieve, color=canvas.RED, linewidth=1.0, linestyle=":", label="fines")
        canvas.log_axis(axes, "x", max(float(x[0]), 1e-3 * float(x[-1])), float(x[-1]))
        axes.set_ylim(0.0, 102.0)
        canvas.frame(axes, x="sieve [mm]", y="finer, by mass [%]")
        axes.grid(True)
        canvas.legend_above(axes, 4)
    rows = tuple(zip(*(column.tolist() for column in (sieve, feed, value, low, high)), strict=True))
    finding = "The band holds what the tests, the product's numbers and the family of the curve leave open."
    if entry.lot is not None:
        finding = finding.replace("leave open", "leave open, and the scatter of lots")
    return canvas.Picture(name="product", title="Product of the feed", finding=finding, figure=figure, rows=rows,
                          header=("sieve [m]", "feed", "product", "low", "high"))  # fmt: skip
