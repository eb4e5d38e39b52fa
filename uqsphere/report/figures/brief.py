"""The drawings of the brief, written as SVG: each for a screen, for paper and for a phone, none of them scaled.

Colours and dashes stand in the style sheet of the page, by class; here is where things lie.
"""

from __future__ import annotations

import html
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Final

import numpy as np
from scipy.special import ndtr, ndtri

from uqsphere.report.brief import Answer, Mode, beyond_reach, crossing, ranged, solved_for
from uqsphere.report.figures.canvas import clean, shorten
from uqsphere.report.phrases import counted, share

#: ends of probability paper
_LEAST, _MOST = 0.0007, 0.993
#: probability at which the name of the k-th curve stands beside it, and where else it may
_NAMED: Final = (0.6, 0.3, 0.15, 0.8, 0.05)
_LEVELS: Final = (0.9, 0.8, 0.7, 0.5, 0.4, 0.3, 0.2, 0.1, 0.05, 0.02, 0.01, 0.003)


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """What a drawing is made for: its width and height, letters of the type, and its class."""

    name: str
    width: float
    height: float
    type: float


#: the three drawings of a curve
SHEETS: Final = (
    Sheet(name="wide", width=644, height=330, type=12),
    Sheet(name="paper", width=644, height=250, type=13),
    Sheet(name="narrow", width=368, height=300, type=14),
)


#: how every kind of line, area and text is drawn on paper; the style sheet has other colours for the dark
_DRAWN: Final = {
    "grid": 'stroke="#d3d8dd"',
    "axis": 'stroke="#14181d"',
    "plan": 'stroke="#14181d"',
    "target": 'stroke="#14181d" stroke-width="1.3" stroke-dasharray="1.5 3"',
    "bar": 'stroke="#14181d" stroke-width="6"',
    "band": 'fill="#d3e1ee"',
    "curve contact": 'fill="none" stroke="#0a5a9c" stroke-width="2.4"',
    "curve core": 'fill="none" stroke="#96357a" stroke-width="2.4" stroke-dasharray="8 4"',
    "curve energy": 'fill="none" stroke="#14181d" stroke-width="2.4" stroke-dasharray="9 3 2 3"',
    "curve other": 'fill="none" stroke="#14181d" stroke-width="2.4" stroke-dasharray="3 3"',
    "test": 'fill="#ffffff" stroke="#14181d" stroke-width="1.6"',
    "over": 'fill="#14181d"',
    "soft": 'fill="#55606b"',
    "strong": 'font-weight="700"',
    "halo": 'paint-order="stroke"',
    "contact": 'fill="#0a5a9c"',
    "core": 'fill="#96357a"',
}


def _kind_of(kind: str) -> str:
    """Class and paper's attributes of a shape or a text."""
    drawn = _DRAWN.get(kind) or " ".join(_DRAWN[part] for part in kind.split() if part in _DRAWN)
    return f'class="{kind}" {drawn}'.rstrip()


def _text(x: float, y: float, words: str, *, at: str = "start", kind: str = "plain") -> str:
    return f'<text {_kind_of(kind)} x="{x:.1f}" y="{y:.1f}" text-anchor="{at}">{html.escape(clean(words))}</text>'


def _line(x1: float, y1: float, x2: float, y2: float, kind: str) -> str:
    return f'<line {_kind_of(kind)} x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"/>'


def _path(points: Sequence[tuple[float, float]], kind: str) -> str:
    return f'<path {_kind_of(kind)} d="M' + "L".join(f"{x:.1f} {y:.1f}" for x, y in points) + '"/>'


def _circle(x: float, y: float, radius: float, kind: str) -> str:
    return f'<circle {_kind_of(kind)} cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}"/>'


def _svg(sheet: Sheet, name: str, title: str, seen: str, parts: Sequence[str]) -> str:
    """A drawing with its name and what is seen on it, for those who do not see it."""
    own = f"brief-{name}-{sheet.name}"
    box = f'viewBox="0 0 {sheet.width:g} {sheet.height:g}"'
    head = f'<svg class="{sheet.name}" {box} role="img" aria-labelledby="{own}-t {own}-d" font-size="{sheet.type:g}">'
    told = (
        f'<title id="{own}-t">{html.escape(clean(title))}</title><desc id="{own}-d">{html.escape(clean(seen))}</desc>'
    )
    return head + told + "".join(parts) + "</svg>"


def _beside(paper: _Paper, x: float, y: float, words: str, *, left: bool = False, kind: str = "strong halo") -> str:
    """A text beside a place, on the side that is asked for if it has room there; none where it would cover another."""
    wide = 0.6 * paper.sheet.type * len(words)
    for side in (left, not left):
        begin = x - 6.0 - wide if side else x + 6.0
        if begin < paper.left - 2.0 or begin + wide > paper.right + 2.0 or not paper.free(begin, y, wide):
            continue
        paper.taken.append((begin, y, wide))
        return _text(x - 6 if side else x + 6, y, words, at="end" if side else "start", kind=kind)
    return ""


# --- the curve ------------------------------------------------------------------------------------------------


class _Paper:
    """Probability paper: normal scores of the share broken over the logarithm of the solved number."""

    def __init__(self, answers: Sequence[Answer], sheet: Sheet) -> None:
        axis = answers[0].axis
        assert axis is not None
        self.axis, self.sheet = axis, sheet
        self.left, self.right = 3.6 * sheet.type, sheet.width - 4.0
        self.top, self.bottom = 1.2 * sheet.type, sheet.height - 3.4 * sheet.type
        inside = [x for answer in answers for mode in answer.modes for x, p in mode.curve if _LEAST < p < _MOST]
        inside += [v for a in answers for v in ((a.axis.planned if a.axis else None), *solved_for(a)) if v]
        wide = (max(inside) / min(inside)) ** 0.03 if min(inside) > 0.0 else 1.03
        self.low, self.high = min(inside) / wide, max(inside) * wide
        self.log = self.low > 0.0
        #: where texts stand: left end, base line, length
        self.taken: list[tuple[float, float, float]] = []

    def free(self, begin: float, y: float, wide: float) -> bool:
        """Whether a line of text would cover no other one."""
        return not any(
            begin < other + length and other < begin + wide and abs(y - base) < 1.1 * self.sheet.type
            for other, base, length in self.taken
        )

    def x(self, value: float) -> float:
        low, high, at = self.low, self.high, value
        if self.log:
            low, high, at = math.log(low), math.log(high), math.log(max(value, 1e-300))
        return self.left + (self.right - self.left) * (at - low) / (high - low)

    def y(self, probability: float) -> float:
        low, high = ndtri(_LEAST), ndtri(_MOST)
        score = float(ndtri(min(max(probability, 1e-12), 1.0 - 1e-12)))
        return float(self.bottom - (self.bottom - self.top) * (score - low) / (high - low))

    def inside(self, value: float) -> bool:
        return self.low <= value <= self.high

    def curve(self, mode: Mode) -> list[tuple[float, float]]:
        """The points of a curve within the paper, dense enough for a line."""
        x = np.array([v for v, _ in mode.curve])
        p = np.clip([q for _, q in mode.curve], 1e-12, 1.0 - 1e-12)
        at = np.log(x) if self.log else x
        fine = np.linspace(at[0], at[-1], 240)
        scores = np.interp(fine, at, ndtri(p))
        kept = (scores >= ndtri(_LEAST)) & (scores <= ndtri(_MOST))
        values = np.exp(fine) if self.log else fine
        kept &= (values >= self.low) & (values <= self.high)
        return [(self.x(float(v)), self.y(float(ndtr(s)))) for v, s in zip(values[kept], scores[kept], strict=True)]

    def at(self, mode: Mode, probability: float) -> float | None:
        """Where a curve has a probability; None where it does not reach it within the paper."""
        value = crossing(mode.curve, probability)
        return value if value is not None and self.inside(value) else None


def _nice(low: float, high: float, factor: float, most: int) -> Iterator[float]:
    """Round numbers between two (SI), in the unit shown."""
    first, last = low * factor, high * factor
    if first <= 0.0:
        step = 10.0 ** math.floor(math.log10((last - first) / most))
        step *= next(m for m in (1, 2, 5, 10) if (last - first) / (m * step) <= most)
        yield from (k * step for k in range(math.ceil(first / step), math.floor(last / step) + 1))
        return
    decades = range(math.floor(math.log10(first)), math.ceil(math.log10(last)) + 1)
    for marks in ((1, 1.5, 2, 3, 5, 7), (1, 2, 5), (1, 3), (1,)):
        found = [m * 10.0**d for d in decades for m in marks if first <= m * 10.0**d <= last]
        if len(found) <= most or len(marks) == 1:
            yield from found
            return


def curve_drawings(answers: Sequence[Answer]) -> list[list[str]]:
    """Share broken over the solved number by every way of breaking, with targets, plan, answers and tests.

    One drawing for every number that is solved for, each in the sizes of `SHEETS`; beside each other in the smallest.
    """
    groups: dict[tuple[str, str], list[Answer]] = {}
    for answer in answers:
        if answer.axis is not None and any(len(mode.curve) > 1 for mode in answer.modes):
            groups.setdefault((answer.service, answer.axis.path), []).append(answer)
    # a sheet of paper with many ways has less room for curves
    ways = sum(len(answer.modes) for answer in answers)
    low = {"paper": 250.0 - 12.0 * max(ways - 4, 0), "every": 290.0 - 10.0 * max(ways - 4, 0)}
    sheets: tuple[Sheet, ...] = SHEETS if len(groups) == 1 else (replace(SHEETS[-1], name="every", type=12),)
    sheets = tuple(replace(sheet, height=max(low.get(sheet.name, sheet.height), 190.0)) for sheet in sheets)
    return [[_curve(group, sheet, k) for sheet in sheets] for k, group in enumerate(groups.values(), start=1)]


def _curve(answers: Sequence[Answer], sheet: Sheet, number: int) -> str:
    paper, size = _Paper(answers, sheet), sheet.type
    modes = list({m.name: m for a in answers for m in a.modes if len(m.curve) > 1}.values())
    parts: list[str] = []
    lines = {m.name: paper.curve(m) for m in modes}
    shown = [m for m in modes if len(lines[m.name]) > 1]
    if len(shown) > 1:
        parts.append(_band([lines[m.name] for m in shown]))
    parts += _scales(paper)
    paper.taken += _under_bars(paper, answers)
    for answer in answers:
        parts += _target(paper, answer, first=answer is answers[0])
    for mode in shown:
        parts.append(_path(lines[mode.name], f"curve {_kind(mode)}"))
    parts += _tests(paper, answers, told=number == 1)
    parts += _planned(paper, answers)
    for answer in answers:
        parts += _cross(paper, answer)
    parts += _names(paper, lines, shown)
    if answers[0].service:
        parts.append(_text(paper.left, paper.bottom + 2.9 * size, answers[0].service, kind="strong"))
    title = f"Share broken over {paper.axis.words}"
    seen = "Ways of breaking: " + ", ".join(m.name.lower() for m in shown)
    return _svg(sheet, f"curve-{number}", title, seen, parts)


def _kind(mode: Mode) -> str:
    return {"contact": "contact", "core": "core", "": "energy"}.get(mode.place, "other")


def _band(lines: Sequence[Sequence[tuple[float, float]]]) -> str:
    """What lies between the outermost of several curves."""
    y = np.linspace(min(p[1] for line in lines for p in line), max(p[1] for line in lines for p in line), 120)
    columns = [np.interp(y, [p[1] for p in line][::-1], [p[0] for p in line][::-1]) for line in lines]
    low, high = np.min(columns, axis=0), np.max(columns, axis=0)
    edge = [*zip(low.tolist(), y.tolist(), strict=True), *zip(high[::-1].tolist(), y[::-1].tolist(), strict=True)]
    return _path(edge, "band")


def _scales(paper: _Paper) -> list[str]:
    """Both axes with their numbers."""
    size, axis, parts = paper.sheet.type, paper.axis, list[str]()
    # probabilities that are marked on probability paper
    for p in (0.001, 0.01, 0.1, 0.5, 0.9, 0.99):
        y, words = paper.y(p), f"{100 * p:g}{' %' if p == 0.99 else ''}"
        parts.append(_line(paper.left, y, paper.right, y, "grid"))
        parts.append(_text(paper.left - 5, y + 0.35 * size, words, at="end", kind="soft"))
    parts.append(_line(paper.left, paper.bottom, paper.right, paper.bottom, "axis"))
    for mark in _nice(paper.low, paper.high, axis.factor, 8 if paper.sheet.width > 400 else 6):
        x = paper.x(mark / axis.factor)
        parts += [
            _line(x, paper.bottom, x, paper.bottom + 4, "axis"),
            _text(x, paper.bottom + 1.4 * size, f"{mark:g}", at="middle", kind="soft"),
        ]
    parts.append(_text(paper.right, paper.bottom + 2.9 * size, f"{axis.words}, {axis.unit}".rstrip(", "), at="end"))
    return parts


def _target(paper: _Paper, answer: Answer, *, first: bool) -> list[str]:
    parts, size = [], paper.sheet.type
    if answer.level is not None:
        y, solved = paper.y(answer.level), [paper.x(v) for v in solved_for(answer) if paper.inside(v)]
        right = not solved or max(solved) < 0.75 * paper.right
        words, planned = f"target {100 * answer.level:g} %", answer.axis.planned if answer.axis else None
        line = paper.x(planned) if planned and paper.inside(planned) else paper.left
        # clear of the line of what is planned
        start = line - 2 if line < paper.left + 0.6 * size * len(words) else paper.left - 2
        parts += [
            _line(paper.left, y, paper.right, y, "target"),
            _beside(paper, paper.right + 4 if right else start, y - 5, words, left=right, kind="halo"),
        ]
    planned = answer.axis.planned if answer.axis else None
    if first and planned is not None and paper.inside(planned):
        x = paper.x(planned)
        parts += [
            _line(x, paper.top, x, paper.bottom, "plan"),
            _beside(paper, x, paper.top + size, "planned", left=True),
        ]
    return parts


def _tests(paper: _Paper, answers: Sequence[Answer], *, told: bool) -> list[str]:
    """Every series of tests once."""
    every = {answer.tests: answer for answer in answers}.values()
    return [part for answer in every for part in _series(paper, answer, told=told)]


def _series(paper: _Paper, answer: Answer, *, told: bool) -> list[str]:
    points = [(paper.x(v), paper.y(p)) for v, p in answer.tests if paper.inside(v)]
    parts = [_circle(x, y, 3.6, "test") for x, y in points]
    # no word stands on a test
    paper.taken += [(x - 4.0, y + 0.4 * paper.sheet.type, 8.0) for x, y in points]
    if not points or not told:
        return parts
    made = "made-up " if answer.made_up else ""
    words = counted(len(answer.tests) + answer.left_whole, f"{made}test")
    places = (_beside(paper, x - 8, y + 4, words, left=True, kind="halo") for x, y in points[len(points) // 3 :])
    parts.append(next((placed for placed in places if placed), ""))
    if answer.left_whole:
        x, y = points[-1]
        parts.append(_beside(paper, x - 8, y - 6, f"{answer.left_whole} left whole →", left=True, kind="halo"))
    return parts


def _names(paper: _Paper, lines: dict[str, list[tuple[float, float]]], modes: Sequence[Mode]) -> list[str]:
    """The name of every curve beside it, where no other curve runs if there is such a place."""
    parts, size = [], paper.sheet.type
    points = [point for line in lines.values() for point in line]
    planned = paper.axis.planned
    if planned is not None and paper.inside(planned):
        points += [(paper.x(planned), y) for y in np.arange(paper.top, paper.bottom, 0.5 * size).tolist()]
    for mode, level in zip(modes, _NAMED, strict=False):
        name, placed = shorten(mode.name.lower(), 30), ""
        spots = list(_spots(paper, mode, level, 0.6 * size * len(name), points))
        for crowded in (False, True):
            for x, y, left, over in spots:
                if over <= crowded and not placed:
                    placed = _beside(paper, x, y, name, left=left, kind=f"strong halo {_kind(mode)}")
        parts.append(placed)
    return parts


def _spots(
    paper: _Paper, mode: Mode, level: float, wide: float, points: Sequence[tuple[float, float]]
) -> Iterator[tuple[float, float, bool, bool]]:
    """Where the name of a curve has room: below one that rises to the right, or above it on its left; and whether
    another curve runs there."""
    size = paper.sheet.type
    places = [(p, value) for p in (level, *_LEVELS) if (value := paper.at(mode, p)) is not None]
    for (p, value), left in product(places, (False, True)):
        x, y = paper.x(value) + (-4 if left else 4), paper.y(p) + (0.0 if left else 0.8 * size)
        begin = x - 6.0 - wide if left else x + 6.0
        if paper.left < begin and begin + wide < paper.right:
            over = any(begin < a < begin + wide and y - size < b < y + 0.3 * size for a, b in points)
            yield x, y, left, over


def _cross(paper: _Paper, answer: Answer) -> list[str]:
    """The answer on the target: a bar over all ways and carriers, its ends with the numbers that are set large."""
    axis, size, solved = paper.axis, paper.sheet.type, solved_for(answer)
    inside = [v for v in solved if paper.inside(v)]
    if not inside or answer.level is None:
        return []
    low, high, y = paper.x(min(inside)), paper.x(max(inside)), paper.y(answer.level)
    if beyond_reach(answer) is not None:
        low, high = (paper.left, high) if answer.aim == "survive" else (low, paper.right)
    first, _, last = ranged(answer).partition("–")
    low_text = _beside(paper, low, y - 6, first, left=True) if last else ""
    high_text = _beside(paper, high, y + 1.25 * size, f"{last or first} {axis.unit}")
    return [_line(low, y, max(high, low + 1.5), y, "bar"), low_text, high_text]


def _as_planned(paper: _Paper, answers: Sequence[Answer]) -> tuple[float, float, float] | None:
    """Where what is planned stands, and the least and the largest share broken there over all ways."""
    planned = answers[0].axis.planned if answers[0].axis else None
    broken = [mode.broken for answer in answers for mode in answer.modes if mode.broken is not None]
    if planned is None or not broken or not paper.inside(planned):
        return None
    return paper.x(planned), min(broken), max(broken)


def _under_bars(paper: _Paper, answers: Sequence[Answer]) -> list[tuple[float, float, float]]:
    """Lines of text that would stand on the bars of the targets and of what is planned."""
    size, found = paper.sheet.type, []
    for answer in answers:
        inside = [paper.x(v) for v in solved_for(answer) if paper.inside(v)]
        if inside and answer.level is not None:
            found.append((min(inside), paper.y(answer.level) + 0.35 * size, max(inside) - min(inside)))
    if (place := _as_planned(paper, answers)) is not None:
        x, low, high = place
        top, bottom = (min(max(paper.y(p), paper.top), paper.bottom) for p in (high, low))
        found += [(x - 2.0, y, 4.0) for y in np.arange(top, bottom, size).tolist()]
    return found


def _planned(paper: _Paper, answers: Sequence[Answer]) -> list[str]:
    """The share broken as planned: a bar over all ways, its ends with their numbers where they lie on the paper."""
    if (place := _as_planned(paper, answers)) is None:
        return []
    x, low, high = place
    low_y, high_y = (min(max(paper.y(p), paper.top), paper.bottom) for p in (low, high))
    parts = [_line(x, low_y + 1.5, x, high_y - 1.5, "bar")]
    if high > 1.2 * low and high > _LEAST:
        parts.append(_beside(paper, x + 2, high_y + (1 if high < _MOST else 2.4 * paper.sheet.type), share(high)))
    if low > _LEAST:
        under = low_y + paper.sheet.type * (1 if low < _MOST else 2)
        parts.append(_beside(paper, x + 2, min(under, paper.bottom - 4), share(low)))
    return parts


# --- ways of breaking -----------------------------------------------------------------------------------------

#: shares at the ends of the little axis
_FROM, _TO = 1e-4, 1.0


def mode_dots(mode: Mode, answer: Answer) -> str:
    """A probability as a dot on a logarithmic axis with its range, the target dotted: filled where it is missed."""
    width, height = 150.0, 26.0

    def x(p: float) -> float:
        return 6.0 + (width - 12.0) * math.log(min(max(p, _FROM), _TO) / _FROM) / math.log(_TO / _FROM)

    parts = [_line(x(p), 0, x(p), height, "grid") for p in (1e-3, 1e-2, 1e-1)]
    if answer.target is not None:
        parts.append(_line(x(answer.target), 0, x(answer.target), height, "target"))
    if mode.low is not None and mode.high is not None:
        parts.append(_line(x(mode.low), height / 2, x(mode.high), height / 2, "plan"))
    if mode.miss is not None:
        over = answer.target is not None and mode.miss > answer.target
        parts.append(_circle(x(mode.miss), height / 2, 5.5, "over" if over else "test"))
    return f'<svg viewBox="0 0 {width:g} {height:g}" aria-hidden="true">' + "".join(parts) + "</svg>"
