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
from dataclasses import dataclass
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any, Final

from pydantic import Field

from uqsphere.console import plain, screen_width, table, wrap, writable
from uqsphere.quantities import display_unit, lookup, reading_units, unit_that_reads
from uqsphere.report.blocks import Block, Table
from uqsphere.report.cautions import assumption
from uqsphere.report.contents import read_contents
from uqsphere.report.figures.canvas import Picture, inline, render, shorten
from uqsphere.report.figures.compare import Change, fragility_picture, moved_picture
from uqsphere.report.page import margin_boxes, new_environment
from uqsphere.report.phrases import (
    ABSENT,
    NONE,
    PERHAPS,
    SAME,
    SURE,
    UNKNOWN,
    begin,
    call,
    estimate_text,
    limit_name,
    loud,
    number_text,
    probability_text,
    rounded,
    symbol,
)
from uqsphere.results import LimitEntry, Results
from uqsphere.results.entries import Entry, Est, Manifest, Resolved, read_resolved
from uqsphere.store import write_outputs

_LEVEL: Final = 0.05
_SCORE: Final = 1.959963984540054


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
        significance = math.erfc(_SCORE * abs(difference) / towards / math.sqrt(2.0))
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


@dataclass(frozen=True, kw_only=True)
class _Answer:
    """An answer of a run, as `Change` has it of two."""

    section: str
    name: str
    statistic: str
    unit: str = ""
    subject: str = ""
    chance: bool = False
    estimate: Est

    @property
    def key(self) -> tuple[str, str, str]:
        return self.name, self.section, self.statistic


def _limit_answers(name: str, limit: LimitEntry) -> Iterator[_Answer]:
    """Probabilities and margins of one limit."""
    own = partial(_Answer, section="limits", name=f"limits.{name}")
    missing = "probability of missing the aim"
    yield own(statistic=missing, chance=True, estimate=limit.miss)
    for row in limit.assumed:
        yield own(statistic=f"{missing} {assumption(row)}", chance=True, estimate=row.miss)
    if limit.aim == "break":  # else it is the same number
        yield own(statistic="probability of exceeding the strength", estimate=limit.exceedance)
    for key, estimate in limit.margin.items():
        words = "median" if key == "median" else f"{100 * float(key):g} %"
        yield own(statistic=f"strength over demand, {words}", estimate=estimate)


def _answers(results: Results) -> Iterator[_Answer]:
    """Every answer of a run."""
    for name, limit in results.limits.items():
        yield from _limit_answers(name, limit)
    for name, entry in results.quantities.items():
        own = partial(_Answer, section="quantities", name=name)
        united = partial(own, unit=entry.unit, subject=name if entry.unit else "")
        yield united(statistic="mean", estimate=entry.mean)
        yield united(statistic="standard deviation", estimate=entry.sd)
        for p, estimate in entry.quantiles.items():
            yield united(statistic=f"{100.0 * float(p):.12g} % quantile", estimate=estimate)
        yield own(statistic="censored share", chance=True, estimate=entry.censored_share)
    for name, margin in results.margins.items():
        own = partial(_Answer, section="margins", name=f"limits.{name}", unit=margin.unit)
        for p, estimate in margin.values.items():
            words = f"{margin.solve} at {100.0 * float(p):.12g} % exceedance"
            yield own(statistic=words, subject=margin.solve if margin.unit else "", estimate=estimate)
    for name, indices in results.sensitivity.items():
        kinds = {"first index": indices.first, "total index": indices.total}
        for kind, found in ({"Shapley effect": indices.shapley} if indices.shapley else kinds).items():
            for variable, estimate in found.items():
                yield _Answer(section="sensitivity", name=name, statistic=f"{kind} of {variable}", estimate=estimate)


def _triple(estimate: Est) -> tuple[float, float, float] | None:
    """Value and interval as numbers; an estimate without interval is exact only if it says so."""
    value, low, high = estimate.value, estimate.low, estimate.high
    return None if value is None or low is None or high is None else (float(value), float(low), float(high))


def _difference_of(before: Est, after: Est) -> tuple[float, float, float, float | None, float | None] | None:
    """Difference, low, high, relative difference and significance; None where one of the two is not known."""
    a, b = _triple(before), _triple(after)
    if a is None or b is None:
        return None
    difference, low, high, significance = difference_interval(a, b)
    relative = difference / abs(a[0]) if a[0] else None
    # two exact answers that agree are no evidence of anything
    told = None if low == high == 0.0 else significance
    return difference, low, high, relative if relative is None or math.isfinite(relative) else None, told


def _changes(before: Results, after: Results) -> tuple[list[Change], list[str], list[str]]:
    """Answers that both runs have, and the names of those that one has alone."""
    sides = [{answer.key: answer for answer in _answers(results)} for results in (before, after)]
    first, second = sides
    pairs = [(a, second[key]) for key, a in first.items() if key in second and second[key].unit == a.unit]
    found = [_difference_of(a.estimate, b.estimate) or (None,) * 5 for a, b in pairs]
    changes = []
    verdicts = judge_together([significance for *_, significance in found])
    for (a, b), told, verdict in zip(pairs, found, verdicts, strict=True):
        difference, low, high, relative, significance = told
        changes.append(
            Change(
                section=a.section,
                name=a.name,
                statistic=a.statistic,
                unit=a.unit,
                before=a.estimate,
                after=b.estimate,
                difference=difference,
                low=low,
                high=high,
                relative=relative,
                significance=significance,
                verdict=SAME if difference == 0.0 and significance is None else verdict,
                subject=a.subject,
                chance=a.chance,
            )
        )
    shared = {(c.name, c.section, c.statistic) for c in changes}
    lone = [[f"{key[0]}: {key[2]}" for key in side if key not in shared] for side in sides]
    return changes, lone[0], lone[1]


# --- what was changed -----------------------------------------------------------------------------------

#: parts of study.resolved.json that say how a run is looked at, not what is asked
_APART: Final = ("hash", "title", "written_by", "order", "sources", "overrides", "model_reference", "model_digest")


def _flat(node: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Every leaf with its path; a law is a leaf, and so is a list."""
    if isinstance(node, Mapping) and "dist" not in node:
        for key, value in node.items():
            yield from _flat(value, f"{place}.{key}" if place else str(key))
    else:
        yield place, node


def _causes(before: Resolved, after: Resolved) -> list[Cause]:
    """What of the study differs: inputs first (fixed or random), then the rest."""
    found = []
    sides: list[dict[str, Any]] = []
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


_ABSENT: Final = object()


def _said(value: Any, name: str) -> str:
    """A number, a law or an option in words."""
    if value is _ABSENT:
        return "absent"
    unit, factor = _unit_of(name)
    if isinstance(value, Mapping) and "dist" in value:
        shown = value["given"] or value["parameters"]
        parts = [f"{key} {number:.6g}" for key, number in shown.items()]
        parts += [f"{key} {value[key]:.6g}" for key in ("lower", "upper") if value[key] is not None]
        if value["data"]:
            parts.append(f"{len(value['data'])} observations")
        base = lookup(name).unit
        return f"{value['dist']}: {', '.join(parts)}" + (f" ({base})" if base else "")
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return (
            {True: "yes", False: "no", None: "none"}.get(value, str(value))
            if not isinstance(value, (list, dict))
            else ", ".join(map(str, value))
        )
    return f"{value * factor:.6g} {unit}".rstrip()


def _unit_of(name: str) -> tuple[str, float]:
    return display_unit(name) if "." in name and not name.startswith(("limits.", "analysis.", "model.")) else ("", 1.0)


# --- both together --------------------------------------------------------------------------------------


def _open(folder: Path) -> tuple[Results, Manifest, Resolved]:
    """results.json, manifest.json and study.resolved.json of a finished run."""
    from uqsphere.runner.finished import open_run

    run = open_run(folder)
    return run.results, run.manifest, read_resolved(folder)


def compare_folders(before: Path, after: Path) -> Comparison:
    """What differs between two finished runs.

    Raises
    ------
    FolderError
        When one of them is no finished run, or is damaged.
    """
    (first, manifest_a, resolved_a), (second, manifest_b, resolved_b) = _open(before), _open(after)
    changes, lone_a, lone_b = _changes(first, second)
    verdicts = [
        LimitPair(
            limit=name,
            before=limit.met,
            after=second.limits[name].met,
            verdict_before=limit.word,
            verdict_after=second.limits[name].word,
            target_before=limit.target,
            target_after=second.limits[name].target,
        )
        for name, limit in first.limits.items()
        if name in second.limits
    ]
    return Comparison(
        schema_version=1,
        before=_about(before, first, manifest_a),
        after=_about(after, second, manifest_b),
        same_study=first.study.hash == second.study.hash,
        identical=first.model_copy(update={"versions": {}}) == second.model_copy(update={"versions": {}}),
        causes=tuple(_causes(resolved_a, resolved_b)),
        limits=tuple(verdicts),
        changes=tuple(changes),
        compared=sum(c.significance is not None for c in changes),
        changed=sum(c.verdict == SURE for c in changes),
        perhaps=sum(c.verdict == PERHAPS for c in changes),
        only_before=tuple(lone_a),
        only_after=tuple(lone_b),
        services={
            name: compare_folders(before / "services" / name, after / "services" / name)
            for name in first.services
            if name in second.services
        },
    )


def _about(folder: Path, results: Results, manifest: Manifest) -> Side:
    return Side(
        folder=str(folder),
        title=results.study.title,
        hash=results.study.hash,
        seed=results.study.seed,
        version=results.versions.get("uqsphere"),
        model=results.model.chosen,
        evaluations=manifest.evaluations,
        seconds=manifest.seconds.get("total"),
    )


# --- for the terminal -------------------------------------------------------------------------------------


def difference_text(change: Change) -> str:
    """A difference with its interval, and in per cent of what it was."""
    if change.difference is None:
        return "-"
    if change.difference == 0.0:
        return "0"
    subject = change.subject
    text = estimate_text(Est.of(change.difference, change.low, change.high), subject)
    relative = change.relative
    if relative is None or change.section == "sensitivity":
        return text
    return f"{text}, {number_text(f'{100.0 * relative:+.3g}')} %"


def _units(changes: Iterable[Change]) -> dict[str, str]:
    """The unit in which each quantity of both runs is read; spreads follow what they are the spread of."""
    values: dict[str, list[float]] = {}
    for change in changes:
        name = change.subject
        if name and change.statistic != "standard deviation" and lookup(name).display:
            known = [float(side.value) for side in (change.before, change.after) if side.value is not None]
            values.setdefault(name, []).extend(known)
    return {name: unit_that_reads(name, found) for name, found in values.items()}


def headline(found: Comparison) -> str:
    """What came of it, in a sentence or two."""
    if found.identical:
        return "Both runs have the same answers, to the last digit."
    said = (
        f"Of {found.compared} answers {found.changed} changed significantly"
        + (f", and {found.perhaps} more perhaps" if found.perhaps else "")
        + "."
    )
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
    first, second = found.before, found.after
    rows = [(key, *(_plainly(getattr(side, key)) for side in (first, second)))
            for key in ("folder", "title", "seed", "version", "evaluations")]  # fmt: skip
    parts = [wrap(headline(found), width, ""), "", table(("", "before", "after"), rows, width), ""]
    if found.causes:
        rows = [(c.what, _cut(c.before), _cut(c.after)) for c in found.causes]
        parts += ["changed in the study", table(("what", "before", "after"), rows, width), ""]
    else:
        parts += ["nothing was changed in the study", ""]
    rows = [(e.limit, loud(e.verdict_before), loud(e.verdict_after)) for e in found.limits]
    if rows:
        parts += [table(("limit", "verdict before", "verdict after"), rows, width), ""]
    # intervals of both sides stand there where there is room; that of the difference always does
    wide = _changes_table(found.changes, estimate_text, "before (95 %)", "after (95 %)", None)
    fits = max(map(len, wide.split("\n"))) <= width
    parts.append(wide if fits else _changes_table(found.changes, rounded, "before", "after", width))
    for lone, side in ((found.only_before, "before"), (found.only_after, "after")):
        if lone:
            more = " ..." if len(lone) > 12 else ""
            parts.append(wrap(f"only {side}: {'; '.join(lone[:12])}{more}", width))
    if found.perhaps:
        parts.append(
            wrap(f'"perhaps": significant at 95 % taken alone; of {found.compared} answers about '
                 f"{0.05 * found.compared:.0f} would be so by chance", width)
        )  # fmt: skip
    if found.page:
        parts.append(f"page: {plain(found.page)}")
    return parts


def _plainly(value: Any) -> str:
    """Counts with a comma at the thousands; a seed is no count, but a name."""
    return ", ".join(f"{n:,} {k}" for k, n in value.items()) if isinstance(value, Mapping) else str(value)


def _changes_table(changes: Iterable[Change], said: Callable[[Est, str], str], *rest: Any) -> str:
    """Both sides of every answer as `said` says them, the difference, and whether it is more than chance."""
    before, after, width = rest
    rows: list[tuple[str, ...] | str] = []
    name = ""
    for change in changes:
        if change.name != name:
            name = change.name
            rows.append(name)
        subject = change.subject
        sides = [said(side, subject) for side in (change.before, change.after)]
        rows.append((change.statistic, *sides, difference_text(change), change.verdict))
    return table(("answer", before, after, "difference (95 %)", "change"), rows, width)


def _cut(text: str, longest: int = 70) -> str:
    return text if len(text) <= longest else text[: longest - 1] + "…"


# --- The comparison of two runs as one self-contained page: figures inlined, no script, nothing fetched.

#: bytes of figures on the page, and rows of its longest table
MOST_INLINED: Final = 550_000
MOST_ROWS: Final = 400


def write_page(before: Path, after: Path, found: Comparison, out: Path) -> Path:
    """Write the page of `uqsphere.report.compare.compare_folders`, and beside it one for each service.

    Parameters
    ----------
    before, after : the two result folders.
    found : what was found.
    out : a file that ends in .html or .htm, or a folder, where it is compare.html.

    Raises
    ------
    FolderError
        When one of the folders is damaged, or another's file or a link stands where the page is to be.
    """
    page = out if out.suffix.lower() in (".html", ".htm") else out / "compare.html"
    for name, own in found.services.items():
        beside = page.with_name(f"{page.stem}-{name}.html")
        write_page(before / "services" / name, after / "services" / name, own, beside)
    contents = read_contents(before), read_contents(after)
    shared = [name for name in contents[0].results.quantities if name in contents[1].results.quantities]
    laws = [Block(heading=begin(name, call(name)), table=_table(found, "quantities", name)) for name in shared]
    indices = [
        Block(heading=symbol(name), table=_table(found, "sensitivity", name))
        for name in shared
        if name in contents[0].results.sensitivity and name in contents[1].results.sensitivity
    ]
    margins = [
        Block(heading=f"Fragility of {limit_name(name)}", picture=picture,
              table=_table(found, "margins", f"limits.{name}"))
        for name in contents[0].results.margins
        if name in contents[1].results.margins
        for picture in (fragility_picture(*contents, name),)
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
    rows = [
        (str(c.statistic), _cell(c, c.before), _cell(c, c.after), _difference(c), _share(c), str(c.verdict))
        for c in found.changes
        if c.section == section and (not name or c.name == name)
    ]  # fmt: skip
    return Table(
        # a caption of its own: it names the region for those who cannot see what stands above it
        caption=f"{_SUBJECTS[section].format(name=name)}: before, after, and after minus before, with 95 % intervals",
        header=("answer", "before", "after", "difference", "in per cent", "change"),
        rows=tuple(rows[:MOST_ROWS]),
    )


def _cell(change: Change, side: Est) -> str:
    return probability_text(side) if change.chance else estimate_text(side, change.subject)


def _difference(change: Change) -> str:
    if change.difference is None:
        return ABSENT
    if change.difference == 0.0:
        return "none"
    return estimate_text(Est.of(change.difference, change.low, change.high), change.subject)


def _share(change: Change) -> str:
    if change.relative is None or change.section == "sensitivity":
        return ABSENT
    return number_text(f"{100.0 * change.relative:+.3g}") + " %"


def _limits(found: Comparison) -> list[dict[str, Any]]:
    """One box per limit: its verdict before and after, and its probability."""
    boxes = []
    for entry in found.limits:
        name = entry.limit
        words = entry.verdict_before, entry.verdict_after
        miss = next(c for c in found.changes if c.name == f"limits.{name}" and c.section == "limits")
        texts = [probability_text(side) for side in (miss.before, miss.after)]
        line = f"Probability of missing its aim: {texts[0]} before, {texts[1]} after."
        if miss.verdict in (SURE, PERHAPS) and miss.relative is not None:
            sign = "more" if miss.relative > 0.0 else "less"
            doubt = "" if miss.verdict == SURE else ", which may be chance"
            share = number_text(f"{100.0 * abs(miss.relative):.3g}")
            line += f" That is {share} % {sign}{doubt}."
        elif miss.difference is not None:
            line += " No difference is seen above the intervals."
        boxes.append({"name": shorten(name, 80), "before": words[0], "after": words[1], "line": line})
    return boxes


def _page(found: Comparison, parts: Mapping[str, list[Block]]) -> str:
    from markupsafe import Markup

    room, taken = MOST_INLINED, list[str]()

    def placed(picture: Picture) -> Any:
        nonlocal room
        # p_max and P_max are drawn under the same name
        taken.append(picture.name)
        element = inline(render(picture), f"{picture.name}-{len(taken)}")
        room -= len(element.encode())
        # the one text that is not escaped: made of escaped parts by the XML writer
        return Markup(element) if room >= 0 else "The figure is left out: the page would become too large with it."

    environment = new_environment()
    environment.filters["drawn"] = placed
    template = environment.from_string(resources.files("uqsphere.report").joinpath("compare.html").read_text("utf-8"))
    causes = Table(
        caption="What was changed in the study",
        header=("number or choice", "before", "after"),
        rows=tuple((c.what, c.before, c.after) for c in found.causes[:MOST_ROWS]),
    )
    moved = moved_picture(found.changes)
    runs = Table(
        caption="The two runs",
        header=("", "before", "after"),
        rows=tuple(
            (words, _shown(getattr(found.before, key)), _shown(getattr(found.after, key)))
            for key, words in (("folder", "folder"), ("title", "title"), ("hash", "study"), ("seed", "seed"),
                               ("version", "uqsphere"), ("model", "model"), ("evaluations", "evaluations"))
        ),
    )  # fmt: skip
    titles = list(dict.fromkeys(side.title for side in (found.before, found.after)))
    return (
        template.render(
            version="",
            title=" / ".join(titles),
            margin_boxes=Markup(margin_boxes(" / ".join(titles), Manifest())),
            headline=headline(found),
            boxes=_limits(found),
            causes=causes,
            moved=Block(heading="What moved", picture=moved) if moved else None,
            limits=_table(found, "limits", ""),
            parts=parts,
            runs=runs,
            alone=[("before", found.only_before[:200]), ("after", found.only_after[:200])],
            compared=found.compared,
            perhaps=found.perhaps,
            same_seed=found.before.seed == found.after.seed,
        )
        + "\n"
    )


def _shown(value: Any) -> str:
    return "–" if value is None else (f"{value:,}".replace(",", "\u202f") if isinstance(value, int) else str(value))
