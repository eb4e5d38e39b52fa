"""The brief: one sheet that says what may be done, how sure that is, which way of breaking governs, what to measure.

Everything on it is read off the stored answers; nothing is computed but where curves cross, and how many spheres would
tell two ways of breaking apart.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from uqsphere.quantities import OUTPUTS, display_unit, reading_units
from uqsphere.report.contents import Contents, law_of, units_of
from uqsphere.report.figures.canvas import shorten
from uqsphere.report.phrases import breaks, limit_name, plain_percent, short_input, unit_text
from uqsphere.results import NO_RIG, LimitEntry, Results
from uqsphere.results.margins import MarginEntry
from uqsphere.results.verdicts import AssumedEntry, JudgedEntry
from uqsphere.study.axis import limit_of, strength_name

#: words of the brief for where a sphere breaks, by `uqsphere.units.Quantity.place`, and how its curve is drawn
PLACES: Final = {
    "contact": "Contact pressure",
    "rim": "Edge crack",
    "core": "Core splitting",
    "below": "Shear below contact",
    "": "Energy",
}
#: where the ways of breaking that are judged by default break
_PLACE_OF_WAY: Final = {
    "contact pressure": "contact",
    "ring crack": "rim",
    "core tension": "core",
    "fracture energy": "",
}
#: numbers that are solved for, and drivers, in as few words as tell them
_AXES: Final = {"striker.speed": "striker speed", "rig.speed": "speed", "rig.drop_height": "drop",
                "hammer.drop_height": "drop", "striker.specific_energy": "striker energy"}  # fmt: skip
_DRIVERS: Final = {"sphere.E": "stiffness", "sphere.radius": "radius", "sphere.nu": "Poisson ratio", **_AXES}
#: ends of a range closer than this are one number
_SAME: Final = 1.2
#: chance that none of some spheres breaks by a rival way, below which that way is ruled out
_RULED_OUT: Final = 0.05
#: ... while none breaks with this chance at least if the milder way is true
_FAIR: Final = 0.7
#: fewest spheres that are asked for: of fewer, one odd sphere or one blow that went wrong would decide
_FEWEST: Final = 5
#: most answers and cautions on a sheet
_ANSWERS, _CAUTIONS = 3, 3


@dataclass(frozen=True, kw_only=True)
class Mode:
    """One way of breaking: its probability as planned with a range, its curve, and what it asks for at the target.

    curve: values of the free scalar and probabilities of breaking, ascending; at_target in units of that scalar, where
    the share `asked` breaks: that of the target, or where there is none the smallest that was asked for; force [N] and
    energy [J/kg] are the medians there.
    """

    limit: str
    name: str
    place: str
    miss: float | None
    low: float | None = None
    high: float | None = None
    broken: float | None = None
    curve: tuple[tuple[float, float], ...] = ()
    at_target: float | None = None
    sure: float | None = None
    force: float | None = None
    energy: float | None = None
    asked: float | None = None
    assumed: bool = False
    reason: str = ""


@dataclass(frozen=True, kw_only=True)
class Axis:
    """The scalar that is solved for: its name in words, its unit, what one SI unit is in it, and the planned value."""

    path: str
    words: str
    unit: str
    factor: float
    planned: float | None


@dataclass(frozen=True, kw_only=True)
class Answer:
    """One question with its answer, as it is set."""

    question: str
    big: str
    unit: str
    note: str
    second: tuple[str, str, str] | None
    verdict: str
    reasons: tuple[str, ...]
    vetoed: bool
    target: float | None
    aim: str
    modes: tuple[Mode, ...]
    axis: Axis | None
    service: str = ""
    carried: tuple[float, ...] = ()
    tests: tuple[tuple[float, float], ...] = ()
    left_whole: int = 0
    made_up: bool = False
    checks: tuple[str, ...] = ()

    @property
    def level(self) -> float | None:
        """The share broken at the target."""
        return None if self.target is None else self.target if self.aim == "survive" else 1.0 - self.target


@dataclass(frozen=True, kw_only=True)
class Brief:
    """What stands on the sheet."""

    title: str
    answers: tuple[Answer, ...]
    drivers: tuple[tuple[str, float], ...]
    driven: str
    measure: tuple[str, str] | None
    cautions: tuple[str, ...]
    footer: str


# --- numbers --------------------------------------------------------------------------------------------------


def two(value: float, digits: int = 2) -> str:
    """Two digits, without powers of ten where people would not use them.

    >>> two(0.6627), two(13.4), two(148.0), two(0.0998), two(1.996)
    ('0.66', '13', '150', '0.10', '2.0')
    """
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    places = digits - 1 - math.floor(math.log10(abs(value)))
    shown = round(value, places)
    places = digits - 1 - math.floor(math.log10(abs(shown)))
    return f"{shown:.{max(places, 0)}f}" if abs(shown) < 1e6 else f"{shown:.1e}"


def share(value: float, target: float | None = None) -> str:
    r"""A share in per cent with two digits; three where two would equal the target though the number does not.

    >>> [share(p, 0.01).replace("\u00a0", " ") for p in (0.0020161, 0.010494, 4e-5, 0.99996, 0.147)]
    ['0.20 %', '1.05 %', 'under 0.1 %', 'over 99.9 %', '15 %']
    """
    if value < 1e-3:
        return "under 0.1\u00a0%" if value > 0.0 else "0\u00a0%"
    if value > 0.999:
        return "over 99.9\u00a0%"
    text = two(100.0 * value)
    if target is not None and text == two(100.0 * target) and abs(value - target) > 1e-9 * target:
        text = two(100.0 * value, 3)
    return f"{text}\u00a0%"


def span(values: Sequence[float], *, safe_is_low: bool = True) -> str:
    """A range of numbers with two digits each, or its safe end where they are within a fifth.

    >>> span([0.38, 0.66]), span([12.9, 13.1]), span([12.9, 13.9], safe_is_low=False)
    ('0.38–0.66', '13', '14')
    """
    low, high = min(values), max(values)
    if low > 0.0 and high <= _SAME * low:
        return two(low if safe_is_low else high)
    return f"{two(low)}–{two(high)}"


def given(axis: Axis) -> str:
    """The planned value as a study file has it, with its unit."""
    assert axis.planned is not None
    return f"{axis.planned * axis.factor:.3g}\u00a0{axis.unit}".rstrip()


def share_span(values: Sequence[float], target: float | None) -> tuple[str, str]:
    """A range of shares as a number and its unit."""
    low, high = min(values), max(values)
    if high < 1e-3 or low > 0.999:
        return share(high if high < 1e-3 else low)[:-2], "%"
    if low > 0.0 and high <= _SAME * low:
        return share(values[0], target)[:-2], "%"
    ends = ["0" if low < 1e-3 else share(low)[:-2], "100" if high > 0.999 else share(high)[:-2]]
    return "–".join(ends), "%"


# --- from the results -----------------------------------------------------------------------------------------


def make_brief(contents: Contents) -> Brief:
    """The brief of a finished run."""
    results, parts = contents.results, _parts(contents)
    answers = tuple(_all_answers(parts))[:_ANSWERS]
    drivers, driven = next((found for part in parts.values() if (found := _drivers(part.results))[0]), ((), ""))
    manifest = contents.manifest
    rows = sum(sum(part.results.model.evaluations.values()) for part in parts.values())
    chosen = ", ".join(dict.fromkeys(part.results.model.chosen for part in parts.values()))
    footer = " · ".join(
        text
        for text in (
            str(results.study.hash)[:8],
            str(manifest.finished)[:10],
            f"uqsphere {results.versions.get('uqsphere', '')}".strip(),
            "user’s model" if contents.black_box else f"impact model ({chosen})",
            f"{rows:,} rows".replace(",", "\u202f"),
            "strength integrated" if any(part.results.limits for part in parts.values()) else "",
        )
        if text
    )
    return Brief(
        title=shorten(str(results.study.title), 200) or "Untitled study",
        answers=answers,
        drivers=drivers,
        driven=shorten(driven, 40),
        measure=_next_measurement(parts, answers),
        cautions=tuple(shorten(text, 220) for text in _cautions(parts, answers))[:_CAUTIONS],
        footer=footer,
    )


def _parts(contents: Contents) -> dict[str, Contents]:
    """The rig's own answers, where it has one, and those of the services by their names."""
    own = {} if contents.results.rig == NO_RIG else {"": contents}
    return {**own, **contents.services}


def _all_answers(parts: dict[str, Contents]) -> Iterator[Answer]:
    for name, part in parts.items():
        with reading_units(units_of(part.results)):
            yield from _answers(part, name, several=len(parts) > 1)


def _deciding(results: Results, names: Iterable[str]) -> list[str]:
    """Those of some limits that mean fracture; all of them where none does, as in a black box."""
    found = list(names)
    return [name for name in found if breaks(results, name)] or found


def _leading(results: Results) -> str | None:
    """The limit of the study itself that is most likely missed, of those that mean fracture."""
    names = _deciding(results, results.limits)
    known = {n: v for n in names if (v := results.limits[n].miss.value) is not None}
    return max(known, key=lambda name: known[name]) if known else next(iter(names), None)


def _answers(contents: Contents, service: str, *, several: bool) -> Iterator[Answer]:
    """One answer for every aim of the limits; a quantity each where there are none."""
    limits = contents.results.limits
    if not limits:
        yield from _quantity_answers(contents)
        return
    groups: dict[str, dict[str, LimitEntry]] = {}
    for name, limit in limits.items():
        groups.setdefault(limit.aim, {})[name] = limit
    for group in groups.values():
        yield _limit_answer(contents, group, service, several=several or len(groups) > 1)


def _quantity_answers(contents: Contents) -> Iterator[Answer]:
    for name, entry in contents.results.quantities.items():
        unit, factor = display_unit(name)
        median = entry.quantiles.get("0.5")
        if median is None or median.value is None:
            continue
        ends = [entry.quantiles[p].value for p in ("0.05", "0.95") if p in entry.quantiles]
        told = [value * factor for value in ends if value is not None]
        note = f"{two(min(told))} to {two(max(told))} in nine cases of ten." if len(told) == 2 else ""
        words = OUTPUTS[name].meaning if name in OUTPUTS else shorten(name, 40)
        yield Answer(
            question=f"{words[:1].upper()}{words[1:]}, median", big=two(median.value * factor), unit=unit_text(unit),
            note=note, second=None, verdict="", reasons=(), vetoed=False, target=None, aim="survive", modes=(),
            axis=None,
        )  # fmt: skip


def _axis(contents: Contents, entry: MarginEntry | None) -> Axis | None:
    if entry is None:
        return None
    subject = contents.subject(entry.solve)
    unit, factor = display_unit(subject)
    words = _AXES.get(entry.solve) or shorten(short_input(entry.solve), 40)
    planned = contents.at_mean(entry.solve)
    return Axis(path=entry.solve, words=words, unit=unit_text(unit), factor=factor, planned=planned)


def _mode(contents: Contents, name: str, limit: LimitEntry, margin: MarginEntry | None) -> Mode:
    quantity = OUTPUTS.get(limit.quantity.partition(".")[0])
    criterion = limit.quantity.partition(".")[0]
    place = quantity.place if quantity is not None else "core" if "tension" in criterion or "link" in criterion else ""
    assumed = [e.miss.value for e in limit.assumed if e.miss.value is not None]
    if limit.ignorance.known:
        assumed += [float(end) for end in limit.ignorance.miss]
    around = [v for v in (limit.miss.value, *assumed) if v is not None]
    broken = limit.exceedance.value
    words = PLACES.get(place, "") if quantity is not None else name
    if quantity is not None and quantity.follows == "energy":
        place, words = "", PLACES[""]
    return Mode(
        limit=name,
        name=words or shorten(name, 40),
        place=place,
        miss=limit.miss.value,
        low=min(around) if around else None,
        high=max(around) if around else None,
        broken=broken,
        curve=() if margin is None else tuple((float(p.value), float(p.probability)) for p in margin.curve),
        at_target=None if margin is None or not margin.value else margin.value.value,
        sure=None if margin is None else margin.ignorance.sure,
        force=None if margin is None else margin.validity.medians.get("P_max"),
        energy=None if margin is None else margin.validity.medians.get("specific_energy"),
        asked=None if margin is None else margin.probability,
        reason="" if limit.miss.value is not None else shorten(str(limit.miss.reason or ""), 120),
    )


def _limit_answer(contents: Contents, group: dict[str, LimitEntry], service: str, *, several: bool) -> Answer:
    """The answer of limits with one aim: their ways of breaking are its rivals."""
    results = contents.results
    margins = results.margins
    deciding = {name: group[name] for name in _deciding(results, group)}
    # the target of one limit holds for all that stand beside it without one
    first = next((limit for limit in deciding.values() if limit.target is not None), next(iter(deciding.values())))
    level = None if first.target is None else first.target if first.aim == "survive" else 1.0 - first.target
    modes = _told_apart([_mode(contents, name, limit, margins.get(name)) for name, limit in deciding.items()])
    modes = [mode if level is None else _at_level(mode, level) for mode in modes]
    carried = tuple(value for limit in deciding.values() for value in _carried(limit))
    judged = next((v for v in results.verdicts if (v.aim, v.target) == (first.aim, first.target)), None)
    modes += [_assumed(way) for way in judged.judged if way.assumed] if judged is not None else []
    if judged is not None:
        modes += [
            Mode(limit=n, name=n, place="", miss=None, reason=f"not judged: {why}")
            for n, why in judged.not_judged.items()
        ]
    modes.sort(key=lambda mode: -(mode.miss if mode.miss is not None else -1.0))
    verdict, reasons = _judged(deciding)
    answer = Answer(
        question="", big="", unit="", note="", second=None, verdict=verdict, reasons=reasons,
        vetoed=verdict == "not established" and all(limit.met for limit in deciding.values()),
        target=first.target, aim=first.aim, modes=tuple(modes), service=service, carried=carried,
        axis=_axis(contents, next((margins[n] for n in deciding if n in margins), None)),
        checks=tuple(_check(name, limit) for name, limit in group.items() if name not in deciding),
    )  # fmt: skip
    fracture = any(breaks(results, name) for name in deciding)
    return _with_tests(contents, _worded(answer, fracture=fracture, several=several))


def _at_level(mode: Mode, level: float) -> Mode:
    """A mode at the share broken that the target allows, read off its curve where it was solved for another share."""
    if mode.asked is None or math.isclose(mode.asked, level):
        return mode
    there = crossing(mode.curve, level)
    return replace(mode, at_target=there, sure=None, force=None, energy=None)


def crossing(curve: Sequence[tuple[float, float]], probability: float) -> float | None:
    """Where a curve of (value, probability) has a probability; None where it does not reach it."""
    for (x0, p0), (x1, p1) in pairwise(curve):
        if min(p0, p1) <= probability <= max(p0, p1) and p0 != p1:
            return x0 + (x1 - x0) * (probability - p0) / (p1 - p0)
    return None


def _check(name: str, limit: LimitEntry) -> str:
    """A limit that does not mean fracture, with how often it is exceeded, and its verdict where it has a target."""
    often = "not known" if limit.miss.value is None else share(limit.miss.value, limit.target)
    word = "" if limit.target is None else f" ({limit.word}: at most {plain_percent(limit.target)})"
    return f"{limit_name(name, 30)} {'missed' if limit.aim == 'break' else 'exceeded'}: {often}{word}"


def _worded(answer: Answer, *, fracture: bool, several: bool) -> Answer:
    """The answer with its question, its large number and what stands beside it."""
    axis, target, survive, service = answer.axis, answer.target, answer.aim == "survive", answer.service
    solved = [v * axis.factor for v in solved_for(answer)] if axis else []
    of, allowed = (f", {service}" if service else ""), "No target was set."
    if target is not None:
        allowed = f"Target: at most {plain_percent(target)}."
    misses = [m.miss for m in answer.modes if m.miss is not None]
    if several and axis is not None and solved and target is not None:
        must = f"{plain_percent(target)} may break" if survive else f"{plain_percent(1.0 - target)} must break"
        planned = f"Planned: {given(axis)}. " if axis.planned else ""
        best = next((m.at_target for m in answer.modes if m.at_target is not None and not m.assumed), None)
        return replace(
            answer,
            question=f"{'Highest' if survive else 'Least'} {axis.words}{of} ({must})",
            big=span(solved, safe_is_low=survive),
            unit=axis.unit,
            note=planned + (f"Best estimate {two(best * axis.factor)} {axis.unit}." if best is not None else ""),
        )
    broken = ("Share broken" if survive else "Share left whole") if fracture else "Share beyond the limit"
    at = f" at the planned {given(axis)}" if axis and axis.planned else ""
    big, unit = share_span(misses, target) if misses else ("not known", "")
    second = None
    asked = {mode.asked for mode in answer.modes if mode.asked is not None}
    if axis is not None and solved and (target is not None or len(asked) == 1):
        where = "at the target" if target is not None else f"where {plain_percent(next(iter(asked)))} break"
        words = f"{axis.words[:1].upper()}{axis.words[1:]} {where}"
        value = f"{span(solved, safe_is_low=survive)}\u00a0{axis.unit}"
        second = (words, value, "by way of breaking" if len(answer.modes) > 1 else "")
    return replace(answer, question=f"{broken}{at}{of}", big=big, unit=unit, note=allowed, second=second)


def solved_for(answer: Answer) -> list[float]:
    """The numbers solved for, by every way of breaking, what is 95 % sure, and every carrier (SI)."""
    return [*(v for mode in answer.modes for v in (mode.at_target, mode.sure) if v is not None), *answer.carried]


def asked_note(answers: Sequence[Answer]) -> str:
    """Where force and energy of the ways of breaking are taken: at the targets, or where a share breaks."""
    shown = [(answer, mode) for answer in answers for mode in answer.modes if mode.force is not None]
    if all(answer.target is not None for answer, _ in shown):
        return "at the target"
    shares = {mode.asked for _, mode in shown if mode.asked is not None}
    return f"where {plain_percent(next(iter(shares)))} break" if len(shares) == 1 else "at the smallest share asked"


def _carried(limit: LimitEntry) -> list[float]:
    """What is solved for with the same strength carried from its test by force, energy and tension at the centre."""
    if not limit.carried or not limit.carried.solve:
        return []
    return [float(e.value) for e in limit.carried.by_carrier().values() if e.value is not None]


def _assumed(way: JudgedEntry) -> Mode:
    """A way of breaking whose strength is the library's."""
    low, high = way.range or (None, None)
    return Mode(
        limit="", name=f"{way.name[:1].upper()}{way.name[1:]}, assumed", place=_PLACE_OF_WAY.get(way.name, "rim"),
        miss=way.miss.value, low=low, high=high, broken=way.miss.value, at_target=way.answer, assumed=True,
        curve=tuple((float(x), float(p)) for x, p in way.curve),
    )  # fmt: skip


def _told_apart(modes: list[Mode]) -> list[Mode]:
    """Modes of one name go by their limits."""
    names = [mode.name for mode in modes]
    return [replace(m, name=f"{m.name}, {shorten(m.limit, 30)}") if names.count(m.name) > 1 else m for m in modes]


#: verdicts from the one that stops everything
_ORDER: Final = ("not met", "not established", "undecided", "met")


def _judged(group: dict[str, LimitEntry]) -> tuple[str, tuple[str, ...]]:
    """The verdict of limits with one aim and its reasons: the worst of theirs."""
    words = {name: limit.word for name, limit in group.items() if limit.target is not None}
    if not words:
        return "", ()
    worst = min(words.values(), key=_ORDER.index)
    reasons = [reason.text for name, word in words.items() if word == worst for reason in group[name].reasons]
    return worst, tuple(f"{text[:1].upper()}{text[1:]}." for text in dict.fromkeys(reasons))[:3]


def _with_tests(contents: Contents, answer: Answer) -> Answer:
    """The answer with the tests of its first strength that has any, each where the fitted law puts it on the curve."""
    for mode in answer.modes:
        law = contents.resolved.random.get(strength_name(mode.limit))
        fitted = law_of(contents.resolved, strength_name(mode.limit)) if law is not None else None
        if law is None or fitted is None or not law.data or len(mode.curve) < 2:
            continue
        x, p = (np.array(column) for column in zip(*mode.curve, strict=True))
        order = np.argsort(p)
        failed = sorted(float(v) for v in law.data)
        count = len(failed) + len(law.censored or ())
        places = np.interp(fitted.cdf(np.array(failed)), p[order], x[order], left=np.nan, right=np.nan)
        points = [(float(v), (k + 0.7) / (count + 0.4)) for k, v in enumerate(places) if math.isfinite(v)]
        made_up = strength_name(mode.limit) in contents.resolved.made_up
        return replace(answer, tests=tuple(points), left_whole=count - len(failed), made_up=made_up)
    return answer


def _drivers(results: Results) -> tuple[tuple[tuple[str, float], ...], str]:
    """The two inputs with the largest shares in what decides, and of what."""
    name = _leading(results)
    if name is None:
        for quantity, entry in results.sensitivity.items():
            shares = {n: e.value for n, e in entry.first.items() if e.value is not None}
            if shares:
                return _largest(shares), quantity
        return (), ""
    found = results.limits[name].governing_inputs or {}
    return _largest({n: float(v) for n, v in found.items()}), name


def _largest(shares: dict[str, float]) -> tuple[tuple[str, float], ...]:
    order = sorted(shares, key=lambda n: -shares[n])[:2]
    words = {n: "strength" if limit_of(n) else _DRIVERS.get(n) or shorten(short_input(n), 40) for n in order}
    return tuple((words[n], float(shares[n])) for n in order if shares[n] > 0.005)


def _next_measurement(parts: dict[str, Contents], answers: Sequence[Answer]) -> tuple[str, str] | None:
    """The one measurement that can change the verdict."""
    for answer in answers:
        found = _between_rivals(answer)
        if found is not None:
            return found
    for part in parts.values():
        found = _of_strength(part.results)
        if found is not None:
            return found
    return None


def _of_strength(results: Results) -> tuple[str, str] | None:
    """How many tests settle a target or give the value, or what to measure for a probability."""
    deciding = _deciding(results, results.limits)
    for name in deciding:
        limit = results.limits[name]
        settle = limit.tests_to_settle
        if settle and settle.tests and limit.met is not False:
            said = f"They settle the target of {shorten(name, 30)} ({plain_percent(float(settle.confidence))} sure)."
            return f"{settle.tests} tests of strength", said
    for name in [name for name in deciding if name in results.margins]:
        more = results.margins[name].more_tests
        if more and more.to_settle:
            said = f"They settle the target of {shorten(name, 30)}, if they fall as those before."
            return f"{int(more.to_settle)} more tests of strength", said
        if more and more.to_know_the_value and more.known_to:
            said = f"They give the value to {plain_percent(float(more.known_to))}."
            return f"{int(more.to_know_the_value)} tests of strength", said
    leading = _leading(results)
    entry = None if leading is None else results.limits[leading].measure_first
    if not entry or not entry.rows:
        return None
    row = entry.rows[0]
    what = "strength" if limit_of(row.input) else _DRIVERS.get(row.input) or shorten(short_input(row.input), 40)
    return f"{row.tests} tests of {what}", "What is assumed of it moves the share broken most."


def _between_rivals(answer: Answer) -> tuple[str, str] | None:
    """How many spheres, struck where, rule out the harsher ways of breaking, while the milder leaves them whole."""
    curves = {m.name: m for m in answer.modes if len(m.curve) > 3}
    if answer.axis is None or len(curves) < 2:
        return None
    grid = np.unique(np.concatenate([[x for x, _ in m.curve] for m in curves.values()]))
    table = {name: np.interp(grid, [x for x, _ in m.curve], [p for _, p in m.curve]) for name, m in curves.items()}
    middle = {name: float(np.interp(0.5, p, grid)) for name, p in table.items() if p[0] < 0.5 < p[-1]}
    if len(middle) < 2:
        return None
    mild = max(middle, key=lambda n: middle[n])
    rivals = [n for n in middle if n != mild and middle[n] < middle[mild] / _SAME]
    if not rivals:
        return None
    harsh = np.max([table[n] for n in rivals], axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        count = np.ceil(np.log(_RULED_OUT) / np.log1p(-np.clip(harsh, 1e-12, 1.0 - 1e-12)))
    count = np.maximum(count, _FEWEST)
    chance = (1.0 - table[mild]) ** count
    if not (chance >= _FAIR).any():
        return None
    # the fewest spheres, and of as many where the milder way most likely leaves them whole
    best = int(np.argmin(np.where(chance >= _FAIR, count - chance, np.inf)))
    spheres, where = int(count[best]), f"{two(float(grid[best]) * answer.axis.factor)} {answer.axis.unit}"
    out = [n for n in rivals if (1.0 - table[n][best]) ** spheres <= _RULED_OUT]
    names = " and ".join(n.lower().removesuffix(", assumed") for n in out[:2])
    said = f"None broken rules out {names} (95 % sure)."
    return f"{spheres} spheres at {where}", said


def _cautions(parts: dict[str, Contents], answers: Sequence[Answer]) -> Iterator[str]:
    """What moves the answers most, the largest first: assumptions, then what few tests leave open, then checks."""
    named = [(answer, mode) for answer in answers for mode in answer.modes if mode.limit]
    found: list[tuple[float, str]] = []
    for answer, mode in named:
        own = " ".join(text for text in (answer.service, mode.name.lower() if answer.service else mode.name) if text)
        limit = parts[answer.service].results.limits[mode.limit]
        found += [(moved, f"{own}: {text}" if len(named) > 1 else text) for moved, text in _moved(limit)]
    yield from dict.fromkeys(f"{text[:1].upper()}{text[1:]}" for _, text in sorted(found, key=lambda one: -one[0]))
    for part in parts.values():
        for check in part.results.validity:
            if check.share_failure + check.share_warning > 0.01:
                yield check.text[:1].upper() + check.text[1:].rstrip(".") + "."


def _moved(limit: LimitEntry) -> Iterator[tuple[float, str]]:
    """How far other assumptions, and few tests, move the probability of missing an aim, in log odds, and in words.

    Of what is assumed in one way, such as several Weibull moduli, what moves it furthest is told.
    """
    miss, target = limit.miss.value, limit.target
    if miss is None:
        return
    furthest: dict[str, tuple[float, str]] = {}
    for entry in limit.assumed:
        other = entry.miss.value
        if other is None or share(other) == share(miss):
            continue
        crosses = target is not None and (other > target) != (miss > target)
        moved = abs(_log_odds(other) - _log_odds(miss)) + (1e3 if crosses else 0.0)
        if moved > max(math.log(_SAME), furthest.get(entry.assumption, (0.0, ""))[0]):
            over = ", over target" if crosses and other > miss else ""
            furthest[entry.assumption] = moved, f"{share(other, target)} {_assumption(entry)}{over}."
    yield from furthest.values()
    if limit.ignorance.known and limit.ignorance.fitted:
        high = float(limit.ignorance.miss[1])
        if high > miss and share(high) != share(miss):
            tests = sum(entry.tests for entry in limit.ignorance.fitted)
            yield abs(_log_odds(high) - _log_odds(miss)), f"{tests} tests leave up to {share(high, target)} open."


def _log_odds(p: float) -> float:
    p = min(max(p, 1e-12), 1.0 - 1e-12)
    return math.log(p / (1.0 - p))


def _assumption(entry: AssumedEntry) -> str:
    """What is put in place of what is assumed of a strength."""
    taken, instead = entry.taken, entry.instead
    if entry.assumption == "dependence":
        return "if strength and stiffness are independent"
    if isinstance(taken, str) or isinstance(instead, str) or taken is None or instead is None:
        return f"with a {instead} strength, not {taken}"
    if entry.assumption == "modulus":
        return f"with Weibull modulus {instead:.2g}, not {taken:.2g}"
    return f"with {100.0 * instead:.2g} % scatter of strength, not {100.0 * taken:.2g} %"
