"""The brief: one sheet that says what may be done, how sure that is, which way of breaking governs, what to measure.

Everything on it is read off the stored answers; nothing is computed but where curves cross, and how many spheres would
tell two ways of breaking apart.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from uqsphere.console import plain, screen_width, table, wrap, writable
from uqsphere.quantities import OUTPUTS, display_unit, reading_units
from uqsphere.report.cautions import Caution, cautions, cut_off, deciding_limits
from uqsphere.report.contents import Contents, law_of, units_of
from uqsphere.report.figures.canvas import shorten
from uqsphere.report.phrases import (
    breaks,
    capital,
    counted,
    limit_name,
    listed,
    loud,
    plain_percent,
    rounded,
    share,
    short_input,
    short_share,
    two,
    unit_text,
)
from uqsphere.results import LimitEntry, MarginEntry, Results
from uqsphere.study import limit_of, strength_name

#: the ways of breaking by the place where each begins, `uqsphere.quantities.Quantity.place`, as `study.Way` calls them
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
    def of(self) -> str:
        """Its service, as a question ends."""
        return f", {self.service}" if self.service else ""

    @property
    def misses(self) -> list[float]:
        """The probabilities of missing the aim, by every way that is judged; of one not seen its bound too."""
        unseen = [mode.high for mode in self.modes if mode.miss == 0.0 and mode.high]
        return [mode.miss for mode in self.modes if mode.miss is not None] + unseen

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
    ended: str = ""
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
        used = (
            (f"* {self.asked}", self.forces),
            ("† strength assumed", any(mode.assumed for mode in self.modes)),
        )
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


def share_span(values: Sequence[float], target: float | None) -> str:
    """A range of shares in per cent."""
    low, high = min(values), max(values)
    if high < 1e-3 or low > 0.999:
        return share(high if high < 1e-3 else low)[:-2]
    if low > 0.0 and high <= _SAME * low:
        return share(values[0], target)[:-2]
    return f"{'0' if low < 1e-3 else share(low)[:-2]}–{'100' if high > 0.999 else share(high)[:-2]}"


# --- from the results -----------------------------------------------------------------------------------------


def make_brief(contents: Contents) -> Brief:
    """The brief of a finished run."""
    results, manifest = contents.results, contents.manifest
    parts = contents.parts
    answers = tuple(_answers(parts))[:_ANSWERS]
    called = {(answer.service, mode.limit): mode.name for answer in answers for mode in answer.modes if mode.limit}
    drivers, driven = _driven_by(parts, answers, called)
    rows = sum(sum(part.results.model.evaluations.values()) for part in parts.values())
    chosen = ", ".join(dict.fromkeys(part.results.model.chosen for part in parts.values()))
    kind = "user’s model" if contents.black_box else f"impact model ({chosen})"
    model = f"{kind} · {rows:,} rows".replace(",", "\u202f")
    version = f"uqsphere {results.versions.get('uqsphere', '')}".strip()
    footer = (str(results.study.hash)[:8], str(manifest.finished)[:10], version, model)
    return Brief(
        title=shorten(str(results.study.title), 200) or "Untitled study", answers=answers, drivers=drivers,
        driven=driven, measure=_next_measurement(parts, answers),
        cautions=tuple(cautions(parts, called)), ended=cut_off(contents), model=model,
        footer=" · ".join(text for text in footer if text),
    )  # fmt: skip


def _driven_by(
    parts: Mapping[str, Contents], answers: Sequence[Answer], called: Mapping[tuple[str, str], str]
) -> tuple[tuple[tuple[str, float], ...], str]:
    """The two inputs with the largest shares in what decides, and what that is called."""
    drivers, driven = next((found for part in parts.values() if (found := _drivers(part.results))[0]), ((), ""))
    words = shorten(next((name for (_, limit), name in called.items() if limit == driven), driven), 40).lower()
    rivals = len(next((a.modes for a in answers if any(m.limit == driven for m in a.modes)), ())) > 1
    return drivers, f"{words} alone" if rivals else words


def _leading(results: Results) -> str | None:
    """The limit of the study itself that is most likely missed, of those that mean fracture."""
    names = deciding_limits(results)
    known = {n: v for n in names if (v := results.limits[n].miss.value) is not None}
    return max(known, key=lambda name: known[name]) if known else next(iter(names), None)


def _answers(parts: dict[str, Contents]) -> Iterator[Answer]:
    """One answer for every aim of the limits of every part, a quantity each where there are none.

    What an answer before has given in the same words, reasons and what is planned, is not told twice.
    """
    said: set[str] = set()
    for service, contents in parts.items():
        groups: dict[str, dict[str, LimitEntry]] = {}
        for name, limit in contents.results.limits.items():
            groups.setdefault(limit.aim, {})[name] = limit
        several = len(parts) > 1 or len(groups) > 1
        with reading_units(units_of(contents.results)):
            found = [_limit_answer(contents, group, service, several=several) for group in groups.values()]
            for answer in found or _quantity_answers(contents):
                planned, dot, rest = answer.note.partition(". ")
                fresh = tuple(reason for reason in answer.reasons if reason not in said)
                note = rest if dot and service + planned in said else answer.note
                said |= {*answer.reasons, service + planned}
                again = ("As above.",) if answer.reasons and not fresh else fresh
                yield replace(answer, reasons=again, note=note)


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
        note = f"Nine in ten lie between {two(min(told))} and {two(max(told))}." if len(set(told)) == 2 else ""
        yield Answer(question=question, big=two(median.value * factor), unit=unit_text(unit), note=note)


def _axis(contents: Contents, entry: MarginEntry | None) -> Axis | None:
    """The scalar that is solved for; where none is, the load of the rig, so that a share has a place."""
    path = next((path for path in _AXES if contents.at_mean(path)), "") if entry is None else entry.solve
    if not path:
        return None
    unit, factor = display_unit(contents.subject(path))
    words = _AXES.get(path) or shorten(short_input(path), 40)
    return Axis(path=path, words=words, unit=unit_text(unit), factor=factor, planned=contents.at_mean(path))


def _place_of(limit: LimitEntry, name: str) -> tuple[str, str]:
    """Where in the sphere a limit breaks it, "" of energy, and the way's words, "" where its own name serves."""
    criterion = limit.quantity.partition(".")[0]
    quantity = OUTPUTS.get(criterion)
    if quantity is None:
        return "core" if "tension" in criterion or "link" in criterion else "", name
    place = "" if quantity.follows == "energy" else quantity.place
    return place, PLACES.get(place, "") if place or quantity.follows == "energy" else ""


def _mode(contents: Contents, name: str, limit: LimitEntry) -> Mode:
    """The way of breaking that a limit of the study is on."""
    place, words = _place_of(limit, name)
    around = [limit.miss.value, *(entry.miss.value for entry in limit.assumed)]
    around += list(limit.ignorance.miss) if limit.ignorance.known else []
    around += [limit.miss.high] if limit.miss.value == 0.0 else []
    known = [float(value) for value in around if value is not None]
    mode = Mode(
        limit=name, name=words or shorten(name, 40), place=place, miss=limit.miss.value,
        low=min(known, default=None), high=max(known, default=None), broken=limit.exceedance.value,
        reason="" if limit.miss.value is not None else shorten(str(limit.miss.reason or ""), 120),
    )  # fmt: skip
    margin = contents.results.margins.get(name)
    if margin is None:
        return mode
    medians = margin.validity.medians
    return replace(
        mode, curve=tuple((float(p.value), float(p.probability)) for p in margin.curve), at_target=margin.value.value,
        sure=margin.ignorance.sure, force=medians.get("P_max"), energy=medians.get("specific_energy"),
        asked=margin.probability,
    )  # fmt: skip


def _modes(contents: Contents, deciding: dict[str, LimitEntry], first: LimitEntry) -> Iterator[Mode]:
    """The ways of breaking of the study's own limits at the share of the target, and those that are judged beside."""
    survive, target = first.aim == "survive", first.target
    own = [_mode(contents, name, limit) for name, limit in deciding.items()]
    names = [mode.name for mode in own]
    for mode in own:
        if names.count(mode.name) > 1:
            mode = replace(mode, name=f"{mode.name}, {shorten(mode.limit, 30)}")
        level = mode.asked if target is None else target if survive else 1.0 - target
        if mode.asked is not None and level is not None and not math.isclose(mode.asked, level):
            # read off its curve where it was solved for another share
            mode = replace(mode, at_target=crossing(mode.curve, level), sure=None, force=None, energy=None)
        yield mode
    yield from _judged_beside(contents.results, survive, target)


def _judged_beside(results: Results, survive: bool, target: float | None) -> Iterator[Mode]:
    """The ways whose strength is the library's, and those that cannot be judged."""
    judged = next((v for v in results.verdicts if (v.aim == "survive", v.target) == (survive, target)), None)
    if judged is None:
        return
    for way in (way for way in judged.judged if way.assumed):
        low, high = way.range or (None, None)
        name, miss = capital(way.name), way.miss.value
        yield Mode(
            limit="", name=name, place=next((p for p, n in PLACES.items() if n == name), "rim"), miss=miss, low=low,
            high=high, broken=miss if miss is None or survive else 1.0 - miss, at_target=way.answer, assumed=True,
            curve=tuple((float(x), float(p)) for x, p in way.curve),
        )  # fmt: skip
    for name, why in judged.not_judged.items():
        yield Mode(limit="", name=capital(name), place="", miss=None, reason=f"not judged: {why}")


def _limit_answer(contents: Contents, group: dict[str, LimitEntry], service: str, *, several: bool) -> Answer:
    """The answer of limits with one aim: their ways of breaking are its rivals."""
    results = contents.results
    deciding = {name: limit for name, limit in group.items() if name in deciding_limits(results)} or group
    # the target of one limit holds for all that stand beside it without one
    first = next((limit for limit in deciding.values() if limit.target is not None), next(iter(deciding.values())))
    modes = sorted(_modes(contents, deciding, first), key=lambda mode: -(-1.0 if mode.miss is None else mode.miss))
    verdict, reasons, vetoed = _judged(deciding)
    answer = Answer(
        question="", big="", unit="", note="", verdict=verdict, reasons=reasons,
        vetoed=vetoed, target=first.target, aim=first.aim, modes=tuple(modes), service=service,
        checks=tuple(_check(name, limit) for name, limit in group.items() if name not in deciding),
        carried=_carried(deciding.values()),
        axis=_axis(contents, next((results.margins[n] for n in deciding if n in results.margins), None)),
        fracture=any(breaks(results, name) for name in deciding),
    )  # fmt: skip
    return _with_tests(contents, (_solved(answer) if several else None) or _shares(answer))


def _carried(limits: Iterable[LimitEntry]) -> tuple[float, ...]:
    """The numbers solved for by every carrier of a strength that was measured elsewhere (SI)."""
    known = [e for one in limits if one.carried and one.carried.solve for e in one.carried.by_carrier().values()]
    return tuple(float(e.value) for e in known if e.value is not None)


def _check(name: str, limit: LimitEntry) -> str:
    """A limit that does not mean fracture, with how often it is exceeded, and its verdict where it has a target."""
    often = "not known" if limit.miss.value is None else share(limit.miss.value, limit.target)
    word = "" if limit.target is None else f" ({limit.word}: at most {plain_percent(limit.target)})"
    return f"{limit_name(name, 30)} {'missed' if limit.aim == 'break' else 'exceeded'}: {often}{word}"


def crossing(curve: Sequence[tuple[float, float]], probability: float) -> float | None:
    """Where a curve of (value, probability) has a probability; None where it does not reach it."""
    for (x0, p0), (x1, p1) in pairwise(curve):
        if min(p0, p1) <= probability <= max(p0, p1) and p0 != p1:
            return x0 + (x1 - x0) * (probability - p0) / (p1 - p0)
    return None


def _solved(answer: Answer) -> Answer | None:
    """The answer with the number solved for as what is set large; None where there is none for its target."""
    axis, target, survive = answer.axis, answer.target, answer.aim == "survive"
    if axis is None or target is None or not solved_for(answer):
        return None
    must = f"{plain_percent(target)} may break" if survive else f"{plain_percent(1.0 - target)} must break"
    told = ranged(answer)
    # a range of what may be is no range of what is allowed
    within = ", somewhere in" if "–" in told else ""
    note = f"Planned: {given(axis)}. " if axis.planned else ""
    best = next(((m.name, m.at_target) for m in answer.modes if m.at_target is not None and not m.assumed), None)
    if survive and best is not None and len(answer.modes) > 1:
        note += f"By {best[0].lower()} alone: {two(best[1] * axis.factor)} {axis.unit}."
    if (left_out := _not_sought(answer)) and beyond_reach(answer) is None:
        note += f" {capital(left_out)} left out."
    question = f"{'Highest' if survive else 'Least'} {axis.words}{answer.of} ({must}){within}"
    reasons = answer.reasons or _as_planned(answer)
    return replace(answer, question=question, big=told, unit=axis.unit, note=note, reasons=reasons)


def _as_planned(answer: Answer) -> tuple[str, ...]:
    """Why a target is not met where nothing else is said: the share as planned."""
    if answer.verdict != "not met" or not answer.misses:
        return ()
    what = "break" if answer.aim == "survive" else "are left whole"
    return (f"As planned, {share(max(answer.misses), answer.target)} {what}.",)


def _shares(answer: Answer) -> Answer:
    """The answer with the share broken as what is set large, and the number solved for beside it."""
    axis, target, survive = answer.axis, answer.target, answer.aim == "survive"
    question = "Share broken" if survive else "Share left whole"
    if not answer.fracture:
        question = f"Share {'beyond' if survive else 'short of'} the limit"
    question += f" at the planned {given(axis)}" if axis and axis.planned else ""
    question += answer.of
    big, unit = (share_span(answer.misses, target), "%") if answer.misses else ("not known", "")
    note = "No target was set." if target is None else f"Target: at most {plain_percent(target)}."
    return replace(answer, question=question, big=big, unit=unit, note=note, second=_second(answer))


def _second(answer: Answer) -> tuple[str, str, str] | None:
    """The number solved for, with where and by which ways, as it stands beside the share; None where there is none."""
    axis, target, asked = answer.axis, answer.target, {mode.asked for mode in answer.modes if mode.asked is not None}
    if axis is None or not solved_for(answer) or (target is None and len(asked) != 1):
        return None
    where = "at the target" if target is not None else f"where {plain_percent(next(iter(asked)))} break"
    # where not all that are judged have a number
    known = [mode.name.lower() for mode in answer.modes if mode.at_target is not None]
    by = "by way of breaking" if len(known) > 1 else ""
    if _ends_without(answer) and beyond_reach(answer) is None:
        by = f"by {listed(known)} alone"
    elif left_out := _not_sought(answer):
        by = f"{left_out} left out"
    return f"{capital(axis.words)} {where}", f"{ranged(answer)}\u00a0{axis.unit}", by


def _not_sought(answer: Answer) -> str:
    """The ways that are judged as planned alone, for which the budget left no rows along the number solved for."""
    return listed([m.name.lower() for m in answer.modes if m.assumed and m.at_target is None and not m.curve])


def _ends_without(answer: Answer) -> list[float | None]:
    """Bounds of the number that ways would need which miss the target as planned and for which none was solved.

    The end of the curve of such a way, which misses the target even there, or what is planned where it has none.
    """
    planned = answer.axis.planned if answer.axis else None
    lacking = [
        m for m in answer.modes if m.at_target is None and m.miss is not None and m.miss > (answer.target or 0.0)
    ]
    return [m.curve[0 if answer.aim == "survive" else -1][0] if m.curve else planned for m in lacking]


def beyond_reach(answer: Answer) -> float | None:
    """A bound (SI) of the number that some way of breaking would need, where none was solved for it; else None.

    To survive the number lies below, to break above.
    """
    ends = _ends_without(answer)
    known = [end for end in ends if end is not None] + (solved_for(answer) if ends else [])
    return None if not known else min(known) if answer.aim == "survive" else max(known)


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


def solved_for(answer: Answer) -> list[float]:
    """The numbers solved for, by every way of breaking, what is 95 % sure, and every carrier (SI)."""
    return [*(v for mode in answer.modes for v in (mode.at_target, mode.sure) if v is not None), *answer.carried]


#: verdicts from the one that stops everything
_ORDER: Final = ("not met", "not established", "undecided", "met")


def _judged(group: dict[str, LimitEntry]) -> tuple[str, tuple[str, ...], bool]:
    """The verdict of limits with one aim and its reasons, the worst of theirs; whether it would be met but for them."""
    words = {name: limit.word for name, limit in group.items() if limit.target is not None}
    if not words:
        return "", (), False
    worst = min(words.values(), key=_ORDER.index)
    reasons = [reason.text for name, word in words.items() if word == worst for reason in group[name].reasons]
    told = tuple(f"{text[:1].upper()}{text[1:]}." for text in dict.fromkeys(reasons))[:3]
    return worst, told, worst == "not established" and all(limit.met for limit in group.values())


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
    shares = {n: float(v) for n, v in (results.limits[name].governing_inputs or {}).items()} if name else {}
    if name is None:
        tables = {q: {n: e.value for n, e in entry.first.items() if e.value is not None}
                  for q, entry in results.sensitivity.items()}  # fmt: skip
        name, shares = next((found for found in tables.items() if found[1]), ("", {}))
    order = sorted(shares, key=lambda n: -shares[n])[:2]
    kept = ((_driver(n), shares[n]) for k, n in enumerate(order) if shares[n] > (0.02 if k else 0.005))
    return tuple(kept), name


def _driver(name: str) -> str:
    """An input in a word or two: a strength, a model factor, or a number of the scene."""
    if limit_of(name):
        return name.rpartition(".")[2].replace("_", " ")
    return _DRIVERS.get(name) or shorten(short_input(name), 40)


def _next_measurement(parts: dict[str, Contents], answers: Sequence[Answer]) -> tuple[str, str] | None:
    """The one measurement that can change the verdict."""
    found = (
        *(_between_rivals(answer) for answer in answers),
        *(one for part in parts.values() for one in _of_numbers(part.results)),
    )
    if any(found):
        return next(one for one in found if one)
    met = answers and all(answer.verdict == "met" for answer in answers)
    return ("None needed", "The target is met.") if met else None


def _of_strength(results: Results) -> Iterator[tuple[str, str]]:
    """How many tests settle a target, then how many give the value."""
    deciding = deciding_limits(results)
    for name in deciding:
        limit, settle, called = results.limits[name], results.limits[name].tests_to_settle, limit_name(name, 30)
        if settle and settle.tests and limit.met is not False and limit.word != "met":
            said = f"They settle the target of {called} ({plain_percent(float(settle.confidence))} sure)."
            yield f"{counted(settle.tests, 'test')} of strength", said
    for name in [name for name in deciding if name in results.margins]:
        margin, more, called = results.margins[name], results.margins[name].more_tests, limit_name(name, 30)
        if more.to_settle:
            said = f"They settle the target of {called}, if they fall as those before."
            yield f"{counted(int(more.to_settle), 'more test')} of strength", said
        if more.to_know_the_value and more.known_to and more.to_know_the_value <= _MOST_TESTS:
            what = _AXES.get(margin.solve, "answer") + (f" of {called}" if len(deciding) > 1 else "")
            said = f"They give the {what} to within {plain_percent(float(more.known_to))}."
            yield f"{counted(int(more.to_know_the_value), 'test')} of strength", said


def _of_numbers(results: Results) -> Iterator[tuple[str, str]]:
    """Tests of strengths, then what to measure for a probability."""
    yield from _of_strength(results)
    leading = _leading(results)
    rows = results.limits[leading].measure_first.rows if leading is not None else ()
    if rows and rows[0].tests <= _MOST_TESTS:
        yield (
            f"{counted(rows[0].tests, 'test')} of {_driver(rows[0].input)}",
            "What is assumed of it moves the answer most.",
        )


def _between_rivals(answer: Answer) -> tuple[str, str] | None:
    """How many spheres, struck where, rule out the harsher ways of breaking, while the mildest leaves them whole.

    The mildest is one whose strength the study has.  Ways without a curve count where the study stands.  Of all places
    where at most `_MOST_SPHERES` do, that which rules out most ways; then the fewest spheres; then the surest of none.
    """
    axis, known = answer.axis, [mode for mode in answer.modes if mode.broken is not None]
    own = [mode for mode in known if not mode.assumed]
    if axis is None or answer.aim != "survive" or not own:
        return None
    mild = min(own, key=_least_broken)
    places = {x for mode in known for x, _ in mode.curve}.union(filter(None, [axis.planned]))
    found = [one for x in sorted(places) for one in _ruled_out(mild, known, axis, x)]
    if not found:
        return None
    (_, fewest, _), where, names = max(found, key=lambda one: one[0])
    place = f"the planned {given(axis)}" if where == axis.planned else f"{two(where * axis.factor)} {axis.unit}"
    stands = ("the larger share", "the lower number")[bool(solved_for(answer))]
    said = f"None broken rules out {listed(names[:3])} (95 % sure); else {stands} holds."
    return f"{-fewest:.0f} spheres at {place}".rstrip(), said


def _least_broken(mode: Mode) -> float:
    return mode.broken or 0.0


def _ruled_out(
    mild: Mode, rivals: Sequence[Mode], axis: Axis, x: float
) -> Iterator[tuple[tuple[float, float, float], float, list[str]]]:
    """At one place: how many ways some spheres rule out, with how few, how sure none breaks by the mildest; by name."""
    base = _broken_at(mild, axis, x)
    harsh = {m.name: p for m in rivals if (p := _broken_at(m, axis, x)) is not None and p > _SAME * (base or 0.0)}
    for least in sorted(set(harsh.values())) if base is not None else ():
        count = max(math.ceil(math.log(_RULED_OUT) / math.log1p(-min(least, 1.0 - 1e-12))), _FEWEST)
        chance = (1.0 - (base or 0.0)) ** count
        if count <= _MOST_SPHERES and chance >= _FAIR:
            out = [m.name.lower() for m in rivals if harsh.get(m.name, 0.0) >= least]
            yield (float(len(out)), -float(count), chance), x, out


def _broken_at(mode: Mode, axis: Axis, x: float) -> float | None:
    """The share that a way breaks at a value of the free scalar; None where it is not known."""
    if axis.planned is not None and x == axis.planned:
        return mode.broken
    if len(mode.curve) < 2 or not mode.curve[0][0] <= x <= mode.curve[-1][0]:
        return None
    return float(np.interp(x, [v for v, _ in mode.curve], [p for _, p in mode.curve]))


# --- the brief for the terminal -----------------------------------------------------------------------------


#: lines that the answers take at most
LINES: Final = 30


def summary_of(contents: Contents, width: int | None = None) -> str:
    """The answers of a run for the terminal: the brief, and a line for each of the first quantities.

    No line is longer than `width` columns (those of the terminal where it is None).
    """
    columns = screen_width() if width is None else width
    brief = make_brief(contents)
    texts = [
        brief.title,
        *[brief.ended] * bool(brief.ended),
        *(line for answer in brief.answers for line in _answer(answer)),
    ]
    texts += _ways(brief, columns)
    shares = ", ".join(f"{name} {100.0 * part:.0f} %" for name, part in brief.drivers)
    texts += [f"what drives it: {shares} (for {brief.driven})"] if shares else []
    texts += [f"next measurement: {brief.measure[0]}. {brief.measure[1]}"] if brief.measure else []
    texts += ["cautions:"] * bool(brief.first_cautions)
    texts += [f"{k}. {text}" for k, text in enumerate(brief.first_cautions, 1)]
    lines, last = [part for text in texts for part in _set(text, columns)], _set(brief.model, columns)
    room = LINES - len(lines) - len(last)
    told = [part for text in _quantities(contents) for part in _set(text, columns)] if brief.modes else []
    return writable("\n".join([*lines[: LINES - len(last)], *told[: max(room, 0)], *last]))


def _set(text: str, width: int) -> list[str]:
    """The lines of a text; a table is one already."""
    spaced = text.replace("\u00a0", " ").replace("\u202f", " ")
    return spaced.split("\n") if "\n" in spaced else wrap(plain(spaced), width).split("\n")


def _answer(answer: Answer) -> list[str]:
    """A question with its answer, the verdict with its reasons, and what is solved for."""
    lines = [f"{answer.question}: {answer.big} {answer.unit}. {answer.note}".replace(" . ", ". ")]
    if answer.second is not None:
        lines.append(" ".join(part for part in (f"{answer.second[0]}: {answer.second[1]}", answer.second[2]) if part))
    if answer.verdict:
        would = ", would be met" if answer.vetoed else ""
        why = f" ({' '.join(answer.reasons).rstrip('.')})" if answer.reasons else ""
        lines.append(f"verdict: {loud(answer.verdict)}{would}{why}")
    return [*lines, *(f"Check, no fracture: {text}" for text in answer.checks)]


def _ways(brief: Brief, width: int) -> list[str]:
    """The ways of breaking with their probabilities, and force and energy where a share breaks."""
    (unit, factor), columns = brief.force_unit, 4 if brief.forces else 2
    rows: list[tuple[str, ...] | str] = []
    shown = [answer for answer in brief.answers if answer.modes]
    for answer in shown:
        rows += [answer.group] if len(shown) > 1 else []
        for mode in answer.modes:
            chance = mode.reason or "not judged"
            if mode.miss is not None:
                chance = short_share(mode.miss, answer.target).replace("\u00a0", " ")
            force, energy = ("-" if v is None else two(v * f) for v, f in ((mode.force, factor), (mode.energy, 1.0)))
            beside = ("", "") if mode.miss is None else (force, energy)
            rows.append((mode.name + "†" * mode.assumed, chance, *beside)[:columns])
    if not rows:
        return []
    header = ("way of breaking" if brief.fracture else "limit", "share", f"{unit}*", "J/kg*")[:columns]
    return [table(header, rows, width), *([", ".join(brief.legend)] if brief.legend else [])]


def _quantities(contents: Contents) -> list[str]:
    """Mean, scatter and the middle nine cases of ten of the first quantities."""
    found = []
    with reading_units(units_of(contents.results)):
        # quantities that get a line
        for name, entry in list(contents.results.quantities.items())[:4]:
            ends = [entry.quantiles[p] for p in ("0.05", "0.95") if p in entry.quantiles]
            within = f", nine in ten {' to '.join(rounded(end, name, 3) for end in ends)}" if len(ends) == 2 else ""
            found.append(f"{name}: mean {rounded(entry.mean, name, 3)}, sd {rounded(entry.sd, name, 2)}{within}")
    return found
