"""The brief: one sheet that says what may be done, how sure that is, which way of breaking governs, what to measure.

Everything on it is read off the stored answers; nothing is computed but where curves cross, and how many spheres would
tell two ways of breaking apart.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from uqsphere.quantities import OUTPUTS, display_unit, reading_units
from uqsphere.report.cautions import Caution, cautions, deciding_limits
from uqsphere.report.contents import Contents, law_of, units_of
from uqsphere.report.figures.canvas import shorten
from uqsphere.report.phrases import (
    breaks,
    capital,
    counted,
    limit_name,
    listed,
    plain_percent,
    share,
    short_input,
    two,
    unit_text,
)
from uqsphere.results import NO_RIG, LimitEntry, Results
from uqsphere.results.margins import MarginEntry
from uqsphere.results.verdicts import JudgedEntry
from uqsphere.study.axis import limit_of, strength_name

#: the ways of breaking by the place where each begins, `uqsphere.quantities.Quantity.place`, as `study.ways` calls them
PLACES: Final = {
    "contact": "Contact pressure",
    "rim": "Ring crack",
    "core": "Core tension",
    "below": "Shear below contact",
    "": "Fracture energy",
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
#: more tests than these nobody makes for the last digit of a number
_MOST_TESTS: Final = 200
#: spheres that are struck at most to tell ways of breaking apart
_MOST_SPHERES: Final = 20
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
    second: tuple[str, str, str] | None = None
    verdict: str = ""
    reasons: tuple[str, ...] = ()
    vetoed: bool = False
    target: float | None = None
    aim: str = "survive"
    modes: tuple[Mode, ...] = ()
    axis: Axis | None = None
    service: str = ""
    carried: tuple[float, ...] = ()
    tests: tuple[tuple[float, float], ...] = ()
    left_whole: int = 0
    made_up: bool = False
    fracture: bool = True
    checks: tuple[str, ...] = ()

    @property
    def level(self) -> float | None:
        """The share broken at the target."""
        return None if self.target is None else self.target if self.aim == "survive" else 1.0 - self.target

    @property
    def group(self) -> str:
        """What stands above its ways of breaking where there are several answers."""
        if not self.fracture:
            return "To stay below" if self.aim == "survive" else "To exceed: share short of it"
        name = self.service[:1].upper() + self.service[1:] or ("To survive" if self.aim == "survive" else "To break")
        return name + (": share left whole" if self.aim == "break" else "")


@dataclass(frozen=True, kw_only=True)
class Brief:
    """What stands on the sheet."""

    title: str
    answers: tuple[Answer, ...]
    drivers: tuple[tuple[str, float], ...] = ()
    driven: str = ""
    measure: tuple[str, str] | None = None
    cautions: tuple[Caution, ...] = ()
    model: str = ""
    footer: str = ""

    @property
    def modes(self) -> tuple[Mode, ...]:
        """The ways of breaking of all answers."""
        return tuple(mode for answer in self.answers for mode in answer.modes)

    @property
    def force_unit(self) -> tuple[str, float]:
        """The unit in which the forces read well, and what a newton is in it."""
        large = max((mode.force for mode in self.modes if mode.force is not None), default=0.0) >= 1000.0
        return ("kN", 1e-3) if large else ("N", 1.0)

    @property
    def forces(self) -> bool:
        """Whether force and energy of any way are known."""
        return any(mode.force is not None for mode in self.modes)

    @property
    def asked(self) -> str:
        """Where force and energy of the ways are taken: at the targets, or where a share breaks."""
        shown = [(answer, mode) for answer in self.answers for mode in answer.modes if mode.force is not None]
        if all(answer.target is not None for answer, _ in shown):
            return "at the target"
        shares = {mode.asked for _, mode in shown if mode.asked is not None}
        return f"where {plain_percent(next(iter(shares)))} break" if len(shares) == 1 else "at the smallest share asked"

    @property
    def legend(self) -> tuple[str, ...]:
        """What the signs of the ways mean, as far as they are used."""
        used = ((f"* {self.asked}", self.forces), ("† strength assumed", any(mode.assumed for mode in self.modes)))
        return tuple(text for text, seen in used if seen)

    @property
    def fracture(self) -> bool:
        """Whether the limits mean fracture, which those of a black box do not."""
        return all(answer.fracture for answer in self.answers)

    @property
    def first_cautions(self) -> tuple[str, ...]:
        """As many as stand on the sheet, of those that move an answer; the page has all."""
        # that tests are made up stands among the reasons already
        told = any(answer.made_up and answer.reasons for answer in self.answers)
        found = [caution.text for caution in self.cautions if caution.moves and not (told and caution.made_up)]
        return tuple(found[: _CAUTIONS if len(self.answers) < 2 else _CAUTIONS - 1])


# --- numbers --------------------------------------------------------------------------------------------------


def span(values: Sequence[float], *, safe_is_low: bool = True) -> str:
    """A range of numbers with two digits each, or its safe end where they are within a fifth.

    The safe end has a third digit where two would leave the safe side by more than half a per cent.

    >>> span([0.38, 0.66]), span([12.9, 13.1]), span([12.9, 13.9], safe_is_low=False), span([0.597, 0.793])
    ('0.38–0.66', '12.9', '14', '0.597–0.79')
    """
    low, high = min(values), max(values)
    safe, sign = (low, 1.0) if safe_is_low else (high, -1.0)
    told = two(safe)
    if sign * (float(told) - safe) > 5e-3 * abs(safe):
        told = two(safe, 3)
    if low > 0.0 and high <= _SAME * low:
        return told
    return f"{told}–{two(high)}" if safe_is_low else f"{two(low)}–{told}"


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
    answers = _told_once(tuple(_all_answers(parts))[:_ANSWERS])
    called = {(answer.service, mode.limit): mode.name for answer in answers for mode in answer.modes if mode.limit}
    drivers, driven = next((found for part in parts.values() if (found := _drivers(part.results))[0]), ((), ""))
    manifest = contents.manifest
    measure = _next_measurement(parts, answers)
    if measure is None and answers and all(answer.verdict == "met" for answer in answers):
        measure = ("None needed", "The target is met.")
    rows = sum(sum(part.results.model.evaluations.values()) for part in parts.values())
    chosen = ", ".join(dict.fromkeys(part.results.model.chosen for part in parts.values()))
    kind = "user’s model" if contents.black_box else f"impact model ({chosen})"
    model = [kind, f"{rows:,} rows".replace(",", "\u202f")]
    version = f"uqsphere {results.versions.get('uqsphere', '')}".strip()
    footer = [str(results.study.hash)[:8], str(manifest.finished)[:10], version, *model]
    return Brief(
        title=shorten(str(results.study.title), 200) or "Untitled study",
        answers=answers,
        drivers=drivers,
        driven=shorten(next((name for (_, limit), name in called.items() if limit == driven), driven), 40).lower(),
        measure=measure,
        cautions=tuple(cautions(parts, called)),
        model=" · ".join(model),
        footer=" · ".join(text for text in footer if text),
    )


def _told_once(answers: tuple[Answer, ...]) -> tuple[Answer, ...]:
    """The answers without reasons that one before them gives in the same words, as far as another one is left."""
    said: set[str] = set()
    found = []
    for answer in answers:
        fresh = tuple(reason for reason in answer.reasons if reason not in said)
        said |= set(answer.reasons)
        found.append(replace(answer, reasons=fresh or answer.reasons))
    return tuple(found)


def _parts(contents: Contents) -> dict[str, Contents]:
    """The rig's own answers, where it has one, and those of the services by their names."""
    own = {} if contents.results.rig == NO_RIG else {"": contents}
    return {**own, **contents.services}


def _all_answers(parts: dict[str, Contents]) -> Iterator[Answer]:
    for name, part in parts.items():
        with reading_units(units_of(part.results)):
            yield from _answers(part, name, several=len(parts) > 1)


def _leading(results: Results) -> str | None:
    """The limit of the study itself that is most likely missed, of those that mean fracture."""
    names = deciding_limits(results)
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
        mean, median = entry.mean, entry.quantiles.get("0.5", entry.mean)
        median = median if median.value is not None else mean
        words = OUTPUTS[name].meaning if name in OUTPUTS else shorten(name, 40)
        question = f"{words[:1].upper()}{words[1:]}{', median' if contents.resolved.random else ''}"
        if median.value is None:
            why = shorten(str(median.reason or mean.reason or ""), 120)
            yield Answer(question=question, big="not known", unit="", note=f"{capital(why)}.")
            continue
        ends = [entry.quantiles[p].value for p in ("0.05", "0.95") if p in entry.quantiles]
        told = [value * factor for value in ends if value is not None]
        note = f"Nine in ten lie between {two(min(told))} and {two(max(told))}." if len(told) == 2 else ""
        yield Answer(question=question, big=two(median.value * factor), unit=unit_text(unit), note=note)


def _axis(contents: Contents, entry: MarginEntry | None) -> Axis | None:
    """The scalar that is solved for; where none is, the load of the rig, so that a share has a place."""
    path = next((path for path in _AXES if contents.at_mean(path)), "") if entry is None else entry.solve
    if not path:
        return None
    unit, factor = display_unit(contents.subject(path))
    words = _AXES.get(path) or shorten(short_input(path), 40)
    return Axis(path=path, words=words, unit=unit_text(unit), factor=factor, planned=contents.at_mean(path))


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
    deciding = {name: limit for name, limit in group.items() if name in deciding_limits(results)} or group
    # the target of one limit holds for all that stand beside it without one
    first = next((limit for limit in deciding.values() if limit.target is not None), next(iter(deciding.values())))
    level = None if first.target is None else first.target if first.aim == "survive" else 1.0 - first.target
    modes = _told_apart([_mode(contents, name, limit, margins.get(name)) for name, limit in deciding.items()])
    modes = [mode if level is None else _at_level(mode, level) for mode in modes]
    carried = tuple(value for limit in deciding.values() for value in _carried(limit))
    judged = next((v for v in results.verdicts if (v.aim, v.target) == (first.aim, first.target)), None)
    modes += (
        [_assumed(way, survive=first.aim == "survive") for way in judged.judged if way.assumed]
        if judged is not None
        else []
    )
    if judged is not None:
        modes += [
            Mode(limit="", name=capital(n), place="", miss=None, reason=f"not judged: {why}")
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
    answer = replace(answer, fracture=any(breaks(results, name) for name in deciding))
    return _with_tests(contents, _worded(answer, several=several))


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


def _worded(answer: Answer, *, several: bool) -> Answer:
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
        told = ranged(answer)
        # a range of what may be is no range of what is allowed
        within = ", somewhere in" if "–" in told else ""
        best = next((m for m in answer.modes if m.at_target is not None and not m.assumed), None)
        alone = ""
        if survive and best is not None and best.at_target is not None and len(answer.modes) > 1:
            alone = f"By {best.name.lower()} alone: {two(best.at_target * axis.factor)} {axis.unit}."
        why = f"As planned, {share(max(misses, default=0.0), target)} {'break' if survive else 'are left whole'}."
        return replace(
            answer,
            question=f"{'Highest' if survive else 'Least'} {axis.words}{of} ({must}){within}",
            big=told,
            unit=axis.unit,
            note=planned + alone,
            reasons=answer.reasons or ((why,) if answer.verdict == "not met" and misses else ()),
        )
    broken = (
        ("Share broken" if survive else "Share left whole")
        if answer.fracture
        else f"Share {_beyond(answer.aim)} the limit"
    )
    at = f" at the planned {given(axis)}" if axis and axis.planned else ""
    big, unit = share_span(misses, target) if misses else ("not known", "")
    second = None
    asked = {mode.asked for mode in answer.modes if mode.asked is not None}
    if axis is not None and solved and (target is not None or len(asked) == 1):
        where = "at the target" if target is not None else f"where {plain_percent(next(iter(asked)))} break"
        words = f"{axis.words[:1].upper()}{axis.words[1:]} {where}"
        value = f"{ranged(answer)}\u00a0{axis.unit}"
        second = (words, value, _by(answer))
    return replace(answer, question=f"{broken}{at}{of}", big=big, unit=unit, note=allowed, second=second)


def _beyond(aim: str) -> str:
    return "beyond" if aim == "survive" else "short of"


def _without(answer: Answer) -> list[Mode]:
    """The ways of breaking that miss the target as planned, and for which no number was solved."""
    return [m for m in answer.modes if m.at_target is None and m.miss is not None and m.miss > (answer.target or 0.0)]


def beyond_reach(answer: Answer) -> float | None:
    """A bound (SI) of the number that some way of breaking would need, where none was solved for it; else None.

    To survive the number lies below, to break above: the end of the curve of that way, which misses the target even
    there, or what is planned where its curve is not known.
    """
    survive, planned = answer.aim == "survive", answer.axis.planned if answer.axis else None
    ends = [m.curve[0 if survive else -1][0] if m.curve else planned for m in _without(answer)]
    known = [end for end in ends if end is not None] + (solved_for(answer) if ends else [])
    return None if not known else min(known) if survive else max(known)


def ranged(answer: Answer) -> str:
    """The range of the number solved for over all ways of breaking; open at its safe end where one has no number."""
    assert answer.axis is not None
    survive, factor, end = answer.aim == "survive", answer.axis.factor, beyond_reach(answer)
    told = span([v * factor for v in solved_for(answer)], safe_is_low=survive)
    if end is None:
        return told
    first, _, last = told.partition("–")
    bound, other = two(end * factor), (last or first) if survive else first
    if survive:
        return f"under {bound}" if other == bound else f"under {bound}–{other}"
    return f"over {bound}" if other == bound else f"{other}–over {bound}"


def _by(answer: Answer) -> str:
    """By which ways the number was solved for, where not all that are judged have one."""
    known = [mode.name.lower() for mode in answer.modes if mode.at_target is not None]
    if _without(answer) and beyond_reach(answer) is None:
        return f"by {listed(known)} alone"
    return "by way of breaking" if len(known) > 1 else ""


def solved_for(answer: Answer) -> list[float]:
    """The numbers solved for, by every way of breaking, what is 95 % sure, and every carrier (SI)."""
    return [*(v for mode in answer.modes for v in (mode.at_target, mode.sure) if v is not None), *answer.carried]


def _carried(limit: LimitEntry) -> list[float]:
    """What is solved for with the same strength carried from its test by force, energy and tension at the centre."""
    if not limit.carried or not limit.carried.solve:
        return []
    return [float(e.value) for e in limit.carried.by_carrier().values() if e.value is not None]


def _assumed(way: JudgedEntry, *, survive: bool) -> Mode:
    """A way of breaking whose strength is the library's."""
    low, high = way.range or (None, None)
    miss = way.miss.value
    broken = miss if miss is None or survive else 1.0 - miss
    return Mode(
        limit="", name=capital(way.name), place=next((p for p, n in PLACES.items() if n == capital(way.name)), "rim"),
        miss=miss, low=low, high=high, broken=broken, at_target=way.answer, assumed=True,
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
    return tuple((_driver(n), float(shares[n])) for k, n in enumerate(order) if shares[n] > (0.02 if k else 0.005))


def _driver(name: str) -> str:
    """An input in a word or two: a strength, a model factor, or a number of the scene."""
    if limit_of(name):
        return name.rpartition(".")[2].replace("_", " ")
    return _DRIVERS.get(name) or shorten(short_input(name), 40)


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
    deciding = deciding_limits(results)
    for name in deciding:
        limit = results.limits[name]
        settle = limit.tests_to_settle
        if settle and settle.tests and limit.met is not False and limit.word != "met":
            said = f"They settle the target of {limit_name(name, 30)} ({plain_percent(float(settle.confidence))} sure)."
            return f"{counted(settle.tests, 'test')} of strength", said
    for name in [name for name in deciding if name in results.margins]:
        more = results.margins[name].more_tests
        if more and more.to_settle:
            said = f"They settle the target of {limit_name(name, 30)}, if they fall as those before."
            return f"{counted(int(more.to_settle), 'more test')} of strength", said
        if more and more.to_know_the_value and more.known_to and more.to_know_the_value <= _MOST_TESTS:
            solve = results.margins[name].solve
            of = f" of {limit_name(name, 30)}" if len(deciding) > 1 else ""
            said = f"They give the {_AXES.get(solve, 'answer')}{of} to within {plain_percent(float(more.known_to))}."
            return f"{counted(int(more.to_know_the_value), 'test')} of strength", said
    leading = _leading(results)
    entry = None if leading is None else results.limits[leading].measure_first
    if not entry or not entry.rows:
        return None
    row = entry.rows[0]
    if row.tests > _MOST_TESTS:
        return None
    return f"{counted(row.tests, 'test')} of {_driver(row.input)}", "What is assumed of it moves the answer most."


def _between_rivals(answer: Answer) -> tuple[str, str] | None:
    """How many spheres, struck where, rule out the harsher ways of breaking, while the mildest leaves them whole.

    The mildest is one whose strength the study has.  Ways without a curve count where the study stands.  Of all places
    where at most `_MOST_SPHERES` do, that which rules out most ways; then the fewest spheres; then the surest of none.
    """
    axis, known = answer.axis, [mode for mode in answer.modes if mode.broken is not None]
    own = [mode for mode in known if not mode.assumed]
    if axis is None or answer.aim != "survive" or not own:
        return None
    mild = min(own, key=lambda mode: mode.broken or 0.0)
    rivals = [mode for mode in known if mode is not mild]
    places = sorted({x for mode in known for x, _ in mode.curve} | ({axis.planned} if axis.planned else set()))
    best: tuple[tuple[float, float, float], float, list[Mode]] | None = None
    for x in places:
        base = _broken_at(mild, axis, x)
        harsh = {m.name: p for m in rivals if (p := _broken_at(m, axis, x)) is not None and p > _SAME * (base or 0.0)}
        for least in sorted(set(harsh.values())) if base is not None else ():
            count = max(math.ceil(math.log(_RULED_OUT) / math.log1p(-min(least, 1.0 - 1e-12))), _FEWEST)
            chance = (1.0 - (base or 0.0)) ** count
            if count > _MOST_SPHERES or chance < _FAIR:
                continue
            out = [m for m in rivals if harsh.get(m.name, 0.0) >= least]
            score = (float(len(out)), -float(count), chance)
            if best is None or score > best[0]:
                best = score, x, out
    if best is None:
        return None
    (_, fewest, _), where, out = best
    names = listed([mode.name.lower() for mode in out[:3]])
    said = f"None broken rules out {names} (95 % sure)."
    place = (
        f"the planned {given(axis)}" if where == axis.planned else f"{two(where * axis.factor)} {axis.unit}".rstrip()
    )
    return f"{-fewest:.0f} spheres at {place}", said


def _broken_at(mode: Mode, axis: Axis, x: float) -> float | None:
    """The share that a way breaks at a value of the free scalar; None where it is not known."""
    if axis.planned is not None and x == axis.planned:
        return mode.broken
    if len(mode.curve) < 2 or not mode.curve[0][0] <= x <= mode.curve[-1][0]:
        return None
    return float(np.interp(x, [v for v, _ in mode.curve], [p for _, p in mode.curve]))
