"""Two runs side by side: what was changed, which answers moved, by how much, and whether more than chance.

The interval of a difference comes from the intervals of both answers, which need not be symmetric (Zou and
Donner 2008, Statistics in Medicine 27:1693-1702, doi:10.1002/sim.3095): for independent estimates a and b with
intervals (l_a, u_a) and (l_b, u_b), b - a lies between

    b - a - sqrt((b - l_b)² + (u_a - a)²)   and   b - a + sqrt((u_b - b)² + (a - l_a)²).

Two runs with one seed share their random numbers.  Their difference then scatters less than that, so that
what is called significant is so all the more.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Final

import numpy as np
from pydantic import Field

from uqsphere.console import plain, screen_width, table, wrap, writable
from uqsphere.files import Json
from uqsphere.quantities import display_unit, lookup, reading_units, unit_that_reads
from uqsphere.report.cautions import assumption
from uqsphere.report.contents import Contents, read_contents
from uqsphere.report.figures import canvas
from uqsphere.report.page import DRAW, MOST_INLINED, margin_boxes, page_environment
from uqsphere.report.phrases import (
    ABSENT,
    Block,
    Table,
    begin,
    call,
    estimate_text,
    limit_name,
    loud,
    number_text,
    probability_text,
    rounded,
    symbol,
    thousands,
)
from uqsphere.results import Results
from uqsphere.results.entries import Entry, Est, Manifest, Resolved, read_resolved
from uqsphere.store import write_outputs
from uqsphere.uq import NORMAL, finite

_LEVEL: Final = 0.05
#: what is said of an answer in two runs: it moved, perhaps, not to be seen, the same in every bit, not known
SURE, PERHAPS, NONE, SAME, UNKNOWN = "changed", "perhaps", "not seen", "the same", "not known"


class Change(Entry):
    """One answer of two runs: `section` and `name` say which.

    `difference` is after minus before in SI, with its 95 % interval `low`, `high`; `relative` is it over the
    value before; `significance` the two-sided probability of so large a difference by chance.  `subject` is the name
    whose unit it has, empty for a plain number; `chance` says that it is read as a probability.
    """

    section: str
    name: str
    statistic: str
    unit: str = ""
    before: Est
    after: Est = Est()
    difference: float | None = None
    low: float | None = None
    high: float | None = None
    relative: float | None = None
    significance: float | None = None
    verdict: str = ""
    subject: str = Field(default="", exclude=True)
    chance: bool = Field(default=False, exclude=True)

    @property
    def reads(self) -> str:
        """The name whose unit it is read in; empty for a plain number."""
        return self.subject if self.unit else ""

    @property
    def key(self) -> tuple[str, str, str]:
        """Which answer it is."""
        return self.name, self.section, self.statistic

    def told(self, say: Callable[[Est, str], str] | None = None) -> tuple[str, str, str, str]:
        """Before, after, difference with its interval, and that in per cent of what was; signs for what is not."""
        chance, say = self.chance and say is None, say or estimate_text
        before, after = (probability_text(e) if chance else say(e, self.reads) for e in (self.before, self.after))
        difference = estimate_text(Est.of(self.difference, self.low, self.high), self.reads)
        difference = "none" if self.difference == 0.0 else difference
        if self.relative is None or self.section == "sensitivity":
            return before, after, difference, ABSENT
        return before, after, difference, number_text(f"{100.0 * self.relative:+.3g}") + " %"


class Cause(Entry):
    """What was changed in the study."""

    what: str
    before: str
    after: str


class LimitPair(Entry):
    """Whether a limit was met by its own probability, and the verdict on it, before and after."""

    limit: str
    before: bool | None
    after: bool | None
    verdict_before: str
    verdict_after: str
    target_before: float | None
    target_after: float | None


class Side(Entry):
    """One of the two runs."""

    folder: str
    title: str
    hash: str
    seed: int
    version: str | None
    model: str
    evaluations: int
    seconds: float | None


class Comparison(Entry):
    """What differs between two finished runs."""

    schema_version: int
    before: Side
    after: Side
    same_study: bool
    identical: bool
    causes: tuple[Cause, ...]
    limits: tuple[LimitPair, ...]
    changes: tuple[Change, ...]
    compared: int
    changed: int
    perhaps: int
    only_before: tuple[str, ...]
    only_after: tuple[str, ...]
    page: str = ""
    services: dict[str, Comparison] = Field(default_factory=dict)


def difference_interval(
    a: tuple[float, float, float], b: tuple[float, float, float]
) -> tuple[float, float, float, float]:
    """b - a of two independent estimates (value, low, high): difference, low, high, and its significance.

    The significance takes the half of the interval that points towards zero for 1.96 standard errors.

    >>> [round(x, 3) for x in difference_interval((1.0, 0.97, 1.03), (1.1, 1.06, 1.14))]
    [0.1, 0.05, 0.15, 0.0]
    """
    difference = b[0] - a[0]
    below = math.hypot(b[0] - b[1], a[2] - a[0])
    above = math.hypot(b[2] - b[0], a[0] - a[1])
    towards = below if difference > 0.0 else above
    if difference == 0.0:
        significance = 1.0
    elif towards == 0.0:
        significance = 0.0
    else:
        significance = math.erfc(NORMAL * abs(difference) / towards / math.sqrt(2.0))
    return difference, difference - below, difference + above, significance


def judge_together(significances: list[float | None]) -> list[str]:
    """A verdict on each of many differences, by Holm (1979): all that are called changed are so at 95 % together.

    Alone, one in twenty differences would be called so by chance; those that only pass alone are called perhaps.

    >>> judge_together([0.001, 0.04, 0.5, None])
    ['changed', 'perhaps', 'not seen', 'not known']
    """
    known = sorted((p, k) for k, p in enumerate(significances) if p is not None)
    verdicts = [UNKNOWN if p is None else (PERHAPS if p < _LEVEL else NONE) for p in significances]
    for rank, (p, k) in enumerate(known):
        if not p < _LEVEL / (len(known) - rank):
            break
        verdicts[k] = SURE
    return verdicts


# --- answers ------------------------------------------------------------------------------------------


def _answers(results: Results) -> Iterator[Change]:
    """Every answer of a run, as what was before."""
    missing = "probability of missing the aim"
    for name, limit in results.limits.items():
        own = partial(Change, section="limits", name=f"limits.{name}")
        yield own(statistic=missing, chance=True, before=limit.miss)
        for row in limit.assumed:
            yield own(statistic=f"{missing} {assumption(row)}", chance=True, before=row.miss)
        if limit.aim == "break":  # else it is the same number
            yield own(statistic="probability of exceeding the strength", before=limit.exceedance)
        for key, estimate in limit.margin.items():
            words = "median" if key == "median" else f"{100 * float(key):g} %"
            yield own(statistic=f"strength over demand, {words}", before=estimate)
    for name, entry in results.quantities.items():
        own = partial(Change, section="quantities", name=name)
        united = partial(own, unit=entry.unit, subject=name)
        yield united(statistic="mean", before=entry.mean)
        yield united(statistic="standard deviation", before=entry.sd)
        for p, estimate in entry.quantiles.items():
            yield united(statistic=f"{100.0 * float(p):.12g} % quantile", before=estimate)
        yield own(statistic="censored share", chance=True, before=entry.censored_share)
    for name, margin in results.margins.items():
        own = partial(Change, section="margins", name=f"limits.{name}", unit=margin.unit, subject=margin.solve)
        for p, estimate in margin.values.items():
            yield own(statistic=f"{margin.solve} at {100.0 * float(p):.12g} % exceedance", before=estimate)
    for name, indices in results.sensitivity.items():
        kinds = {"first index": indices.first, "total index": indices.total}
        for kind, found in ({"Shapley effect": indices.shapley} if indices.shapley else kinds).items():
            for variable, estimate in found.items():
                yield Change(section="sensitivity", name=name, statistic=f"{kind} of {variable}", before=estimate)


def _difference(before: Est, after: Est) -> dict[str, float | None]:
    """Difference, low, high, relative difference and significance; empty where one of the two is not known."""
    a, b = ((side.value, side.low, side.high) for side in (before, after))
    if None in a or None in b:
        return {}
    difference, low, high, significance = difference_interval(a, b)  # type: ignore[arg-type]
    relative = difference / abs(before.number) if before.value else math.inf
    # two exact answers that agree are no evidence of anything
    return {"difference": difference, "low": low, "high": high, "relative": finite(relative),
            "significance": None if low == high == 0.0 else significance}  # fmt: skip


def _changes(before: Results, after: Results) -> tuple[list[Change], list[tuple[str, ...]]]:
    """Answers that both runs have, and the names of those that one has alone."""
    first, second = ({answer.key: answer for answer in _answers(results)} for results in (before, after))
    shared = [key for key, a in first.items() if key in second and second[key].unit == a.unit]
    found = [_difference(first[key].before, second[key].before) for key in shared]
    verdicts = judge_together([told.get("significance") for told in found])
    changes = []
    for key, told, verdict in zip(shared, found, verdicts, strict=True):
        same = told.get("difference") == 0.0 and told["significance"] is None
        more = {**told, "after": second[key].before, "verdict": SAME if same else verdict}
        changes.append(first[key].model_copy(update=more))
    alone = [tuple(f"{key[0]}: {key[2]}" for key in side if key not in shared) for side in (first, second)]
    return changes, alone


# --- what was changed -----------------------------------------------------------------------------------

#: parts of study.resolved.json that say how a run is looked at, not what is asked
_APART: Final = ("hash", "title", "written_by", "order", "sources", "overrides", "model_reference", "model_digest")
_ABSENT: Final = object()


def _flat(node: Json, place: str = "") -> Iterator[tuple[str, Json]]:
    """Every leaf with its path; a law is a leaf, and so is a list."""
    if isinstance(node, Mapping) and "dist" not in node:
        for key, value in node.items():
            yield from _flat(value, f"{place}.{key}" if place else str(key))
    else:
        yield place, node


def _causes(before: Resolved, after: Resolved) -> list[Cause]:
    """What of the study differs: inputs first (fixed or random), then the rest."""
    found = []
    sides: list[dict[str, Json]] = []
    for resolved in (before, after):
        document = resolved.document()
        numbers = {f"input {k}": v for k, v in {**document["fixed"], **document["random"]}.items()}
        rest = {k: v for k, v in document.items() if k not in (*_APART, "fixed", "random")}
        sides.append({**numbers, **dict(_flat(rest))})
    for key in sorted(set(sides[0]) | set(sides[1]), key=lambda k: (not k.startswith("input "), k)):
        a, b = (side.get(key, _ABSENT) for side in sides)
        if a != b:
            name = key.removeprefix("input ")
            found.append(Cause(what=name, before=_said(a, name), after=_said(b, name)))
    if before.model_digest != after.model_digest:
        found.append(Cause(what="the black box", before=str(before.model_digest), after=str(after.model_digest)))
    if before.written_by != after.written_by:
        found.append(Cause(what="version of uqsphere", before=before.written_by, after=after.written_by))
    return found


def _said(value: Json, name: str) -> str:
    """A number, a law or an option in words."""
    if value is _ABSENT:
        return "absent"
    if isinstance(value, Mapping) and "dist" in value:
        parts = [f"{key} {number:.6g}" for key, number in (value["given"] or value["parameters"]).items()]
        parts += [f"{key} {value[key]:.6g}" for key in ("lower", "upper") if value[key] is not None]
        parts += [f"{len(value['data'])} observations"] if value["data"] else []
        base = lookup(name).unit
        return f"{value['dist']}: {', '.join(parts)}" + (f" ({base})" if base else "")
    if isinstance(value, (list, dict)):
        return ", ".join(map(str, value))
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return {True: "yes", False: "no", None: "none"}.get(value, str(value))
    plain_number = "." not in name or name.startswith(("limits.", "analysis.", "model."))
    unit, factor = ("", 1.0) if plain_number else display_unit(name)
    return f"{value * factor:.6g} {unit}".rstrip()


# --- both together --------------------------------------------------------------------------------------


def compare_folders(before: Path, after: Path) -> Comparison:
    """What differs between two finished runs; raises FolderError where one is none, or is damaged."""
    from uqsphere.runner.finished import open_run

    folders = before, after
    runs = [open_run(folder) for folder in folders]
    first, second = (run.results for run in runs)
    resolved = [read_resolved(folder) for folder in folders]
    changes, alone = _changes(first, second)
    sides = [
        Side(
            folder=str(folder), title=run.results.study.title, hash=run.results.study.hash, seed=run.results.study.seed,
            version=run.results.versions.get("uqsphere"), model=run.results.model.chosen,
            evaluations=run.manifest.evaluations, seconds=run.manifest.seconds.get("total"),
        )
        for folder, run in zip(folders, runs, strict=True)
    ]  # fmt: skip
    pairs = [(name, limit, second.limits[name]) for name, limit in first.limits.items() if name in second.limits]
    shared = [name for name in first.services if name in second.services]
    return Comparison(
        schema_version=1, before=sides[0], after=sides[1], same_study=first.study.hash == second.study.hash,
        identical=first.model_copy(update={"versions": {}}) == second.model_copy(update={"versions": {}}),
        causes=tuple(_causes(*resolved)),
        limits=tuple(
            LimitPair(limit=name, before=a.met, after=b.met, verdict_before=a.word, verdict_after=b.word,
                      target_before=a.target, target_after=b.target) for name, a, b in pairs
        ),
        changes=tuple(changes), compared=sum(c.significance is not None for c in changes),
        changed=sum(c.verdict == SURE for c in changes), perhaps=sum(c.verdict == PERHAPS for c in changes),
        only_before=alone[0], only_after=alone[1],
        services={name: compare_folders(*(folder / "services" / name for folder in folders)) for name in shared},
    )  # fmt: skip


# --- for the terminal -------------------------------------------------------------------------------------


def _units(changes: Iterable[Change]) -> dict[str, str]:
    """The unit in which each quantity of both runs is read; spreads follow what they are the spread of."""
    values: dict[str, list[float]] = {}
    for change in changes:
        name = change.reads
        if name and change.statistic != "standard deviation" and lookup(name).display:
            known = [float(side.value) for side in (change.before, change.after) if side.value is not None]
            values.setdefault(name, []).extend(known)
    return {name: unit_that_reads(name, found) for name, found in values.items()}


def headline(found: Comparison) -> str:
    """What came of it, in a sentence or two."""
    if found.identical:
        return "Both runs have the same answers, to the last digit."
    perhaps = f", and {found.perhaps} more perhaps" if found.perhaps else ""
    said = f"Of {found.compared} answers {found.changed} changed significantly{perhaps}."
    flipped = [entry.limit for entry in found.limits if entry.verdict_before != entry.verdict_after]
    if flipped:
        said += f" The verdict on {', '.join(flipped)} is another one."
    return said


def comparison_text(found: Comparison, width: int | None = None) -> str:
    """The comparison for the terminal, no line longer than `width` columns (the terminal's where it is None)."""
    with reading_units(_units(found.changes)):
        text = writable("\n".join(_parts(found, screen_width() if width is None else width)))
    nested = (f"\n\nservice {name}: {comparison_text(own, width)}" for name, own in found.services.items())
    return "".join((text, *nested))


def _parts(found: Comparison, width: int) -> list[str]:
    """The tables of a comparison, and what stands between them."""
    rows: list[tuple[str, ...]] = [(key, *(str(getattr(side, key)) for side in (found.before, found.after)))
                                   for key in ("folder", "title", "seed", "version", "evaluations")]  # fmt: skip
    parts = [wrap(headline(found), width, ""), "", table(("", "before", "after"), rows, width), ""]
    rows = [(c.what, canvas.shorten(c.before, 70), canvas.shorten(c.after, 70)) for c in found.causes]
    changed = ["changed in the study", table(("what", "before", "after"), rows, width)]
    parts += [*(changed if rows else ["nothing was changed in the study"]), ""]
    rows = [(e.limit, loud(e.verdict_before), loud(e.verdict_after)) for e in found.limits]
    parts += [table(("limit", "verdict before", "verdict after"), rows, width), ""] if rows else []
    # intervals of both sides stand there where there is room; that of the difference always does
    wide = _changes_table(found.changes, estimate_text, " (95 %)", None)
    fits = max(map(len, wide.split("\n"))) <= width
    parts.append(wide if fits else _changes_table(found.changes, rounded, "", width))
    for lone, side in ((found.only_before, "before"), (found.only_after, "after")):
        if lone:
            parts.append(wrap(f"only {side}: {'; '.join(lone[:12])}{' ...' if len(lone) > 12 else ''}", width))
    if found.perhaps:
        words = f'"perhaps": significant at 95 % taken alone; of {found.compared} answers about '
        parts.append(wrap(f"{words}{0.05 * found.compared:.0f} would be so by chance", width))
    return [*parts, f"page: {plain(found.page)}"] if found.page else parts


def _changes_table(changes: Iterable[Change], say: Callable[[Est, str], str], interval: str, width: int | None) -> str:
    """Both sides of every answer as `say` says them, the difference, and whether it is more than chance."""
    rows: list[tuple[str, ...] | str] = []
    name = ""
    for change in changes:
        rows += [change.name] if change.name != name else []
        name = change.name
        before, after, difference, share = change.told(say)
        both = difference if share == ABSENT or change.difference == 0.0 else f"{difference}, {share}"
        rows.append((change.statistic, before, after, both, change.verdict))
    header = ("answer", f"before{interval}", f"after{interval}", "difference (95 %)", "change")
    return table(header, rows, width)


# --- figures -----------------------------------------------------------------------------------------------


def _moved(changes: Iterable[Change]) -> list[Change]:
    """The surest relative differences that are known to some degree, those of limits first."""
    known = (c for c in changes if c.section != "sensitivity" and c.relative is not None)
    rows = [c for c in known if c.verdict in (SURE, PERHAPS)]
    # rows of the figure of what moved
    return sorted(rows, key=lambda c: (c.section != "limits", c.significance, -abs(c.relative or 0.0)))[:14]


def moved_picture(changes: Iterable[Change]) -> canvas.Picture | None:
    """Relative differences that are known to some degree with their intervals, the surest; None where nothing moved."""
    rows = _moved(changes)
    if not rows:
        return None
    ends = np.array([[c.difference, c.low, c.high] for c in rows], dtype=float)
    ends *= 100.0 / np.array([[abs(c.before.number)] for c in rows])
    with canvas.style():
        figure, (axes,) = canvas.new_figure(1.2 + 0.42 * len(rows))
        axes.axvline(0.0, color=canvas.GREY, linewidth=0.8)
        for k, (row, (value, low, high)) in enumerate(zip(rows, ends, strict=True)):
            axes.plot([low, high], [k, k], color=canvas.INK, linewidth=1.2, marker="|", markersize=7)
            face = canvas.BLUE if row.verdict == SURE else canvas.PAPER
            axes.plot(value, k, marker="o", markersize=7, color=canvas.BLUE, markerfacecolor=face)
            right = value >= 0.0
            canvas.note(axes, row.told()[3], (high if right else low, k), (6 if right else -6, 0), va="center",
                        ha="left" if right else "right", fontsize=8.5)  # fmt: skip
        canvas.name_rows(axes, [canvas.wrap(f"{row.name}: {row.statistic}", 34) for row in rows], -0.6)
        axes.margins(x=0.22)
        axes.set_xlabel("difference, in per cent of the value before")
        marks = [canvas.mark(canvas.BLUE, "changed", marker="o", linestyle="")]
        if any(row.verdict == PERHAPS for row in rows):
            marks.append(canvas.mark(canvas.BLUE, "perhaps", marker="o", markerfacecolor=canvas.PAPER, linestyle=""))
        canvas.legend_above(axes, 3, [*marks, canvas.mark(canvas.INK, "95 % interval", marker="|")], 1.6)
    return canvas.Picture(name="moved", title="What moved", figure=figure)


def fragility_picture(before: Contents, after: Contents, name: str) -> canvas.Picture | None:
    """Both fragility curves of a limit with their bands."""
    from uqsphere.report.figures.fragility import draw_curve, on_paper, probability_axis, solved_label

    entries = [contents.results.margins[name] for contents in (before, after)]
    solve = entries[0].solve
    if any(len(entry.curve) < 2 or entry.solve != solve for entry in entries):
        return None
    sides = (entries[0], canvas.BLUE, "-", "before"), (entries[1], canvas.ORANGE, "--", "after")
    with canvas.style():
        figure, (axes,) = canvas.new_figure(3.6)
        for entry, colour, line, word in sides:
            curve = np.array(entry.curve, dtype=float)
            curve = curve[on_paper(curve[:, 1], 1e-5)]
            draw_curve(axes, curve, display_unit(solve)[1], colour, 1e-6, linestyle=line, label=word)
        probability_axis(axes)
        canvas.frame(axes, x=solved_label(before, solve), y="probability of exceeding the strength")
        canvas.legend_above(axes, 3, line=1.6)
    title = f"Fragility of {limit_name(name)}, before and after"
    return canvas.Picture(name=canvas.slug("fragility", name), title=title, figure=figure)


# --- the comparison as one self-contained page: figures inlined, no script, nothing fetched ------------------

#: rows of the page's longest table
MOST_ROWS: Final = 400


def write_page(before: Path, after: Path, found: Comparison, out: Path) -> Path:
    """Write the page of `compare_folders`, and beside it one for each service.

    `out`: a file that ends in .html or .htm, or a folder, where it is compare.html.  Raises FolderError for a damaged
    folder, and where another's file or a link stands where the page is to be.
    """
    page = out if out.suffix.lower() in (".html", ".htm") else out / "compare.html"
    for name, own in found.services.items():
        beside = page.with_name(f"{page.stem}-{name}.html")
        write_page(before / "services" / name, after / "services" / name, own, beside)
    contents = read_contents(before), read_contents(after)
    first, second = (one.results for one in contents)
    shared = [name for name in first.quantities if name in second.quantities]
    laws = [Block(heading=begin(name, call(name)), table=_table(found, "quantities", name)) for name in shared]
    indices = [Block(heading=symbol(name), table=_table(found, "sensitivity", name))
               for name in shared if name in first.sensitivity and name in second.sensitivity]  # fmt: skip
    margins = [
        Block(heading=f"Fragility of {limit_name(name)}", picture=fragility_picture(*contents, name),
              table=_table(found, "margins", f"limits.{name}"))
        for name in first.margins if name in second.margins
    ]  # fmt: skip
    text = _page(found, {"laws": laws, "indices": indices, "margins": margins})
    return write_outputs(page.parent, {page.name: text})[0]


#: what a table of a section is about
_SUBJECTS: Final = {
    "quantities": "{name}",
    "sensitivity": "Indices of {name}",
    "margins": "Margins, {name}",
    "limits": "Limits",
}


def _table(found: Comparison, section: str, name: str) -> Table:
    """Before, after and difference of every answer of a section."""
    chosen = [c for c in found.changes if c.section == section and (not name or c.name == name)][:MOST_ROWS]
    # a caption of its own: it names the region for those who cannot see what stands above it
    caption = f"{_SUBJECTS[section].format(name=name)}: before, after, and after minus before, with 95 % intervals"
    header = ("answer", "before", "after", "difference", "in per cent", "change")
    return Table(caption=caption, header=header, rows=tuple((c.statistic, *c.told(), c.verdict) for c in chosen))


def _limits(found: Comparison) -> list[dict[str, str]]:
    """One box per limit: its verdict before and after, and its probability."""
    boxes = []
    for entry in found.limits:
        miss = next(c for c in found.changes if c.name == f"limits.{entry.limit}" and c.section == "limits")
        before, after, *_ = miss.told()
        line = f"Probability of missing its aim: {before} before, {after} after."
        if miss.verdict not in (SURE, PERHAPS) and miss.difference is not None:
            line += " No difference is seen above the intervals."
        words = {"before": entry.verdict_before, "after": entry.verdict_after}
        boxes.append({"name": canvas.shorten(entry.limit, 80), **words, "line": line})
    return boxes


def _page(found: Comparison, parts: Mapping[str, list[Block]]) -> str:
    """The text of the page."""
    from markupsafe import Markup

    room, taken = MOST_INLINED, list[str]()

    def placed(picture: canvas.Picture) -> str:
        nonlocal room
        # p_max and P_max are drawn under the same name
        taken.append(picture.name)
        element = canvas.inline(canvas.render(picture), f"{picture.name}-{len(taken)}")
        room -= len(element.encode())
        # the one text that is not escaped: made of escaped parts by the XML writer
        return Markup(element) if room >= 0 else "The figure is left out: the page would become too large with it."

    environment = page_environment()
    DRAW.set(placed)
    template = environment.from_string(resources.files("uqsphere.report").joinpath("compare.html").read_text("utf-8"))
    sides = found.before, found.after
    keys = {"folder": "folder", "title": "title", "hash": "study", "seed": "seed", "version": "uqsphere",
            "model": "model", "evaluations": "evaluations"}  # fmt: skip
    runs = []
    for key, words in keys.items():
        values = (getattr(side, key) for side in sides)
        texts = (ABSENT if v is None else thousands(v) if isinstance(v, int) else str(v) for v in values)
        runs.append((words, *texts))
    moved = moved_picture(found.changes)
    title = " / ".join(dict.fromkeys(side.title for side in sides))
    causes = tuple((c.what, c.before, c.after) for c in found.causes[:MOST_ROWS])
    sides_of = ("before", "after")
    return template.render(
        version="", title=title, margin_boxes=Markup(margin_boxes(title, Manifest())), headline=headline(found),
        causes=Table(caption="What was changed in the study", header=("number or choice", *sides_of), rows=causes),
        runs=Table(caption="The two runs", header=("", *sides_of), rows=tuple(runs)), boxes=_limits(found),
        moved=Block(heading="What moved", picture=moved) if moved else None, limits=_table(found, "limits", ""),
        alone=[("before", found.only_before[:200]), ("after", found.only_after[:200])], compared=found.compared,
        same_seed=found.before.seed == found.after.seed, parts=parts,
    ) + "\n"  # fmt: skip
