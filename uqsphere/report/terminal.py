"""The brief for the terminal: what stands on the sheet in at most thirty lines, then where the rest is."""

from __future__ import annotations

from typing import Final

from uqsphere.console import plain, screen_width, table, wrap, writable
from uqsphere.quantities import reading_units
from uqsphere.report.brief import Answer, Brief, make_brief
from uqsphere.report.contents import Contents, units_of
from uqsphere.report.phrases import loud, rounded, short_share, two

#: lines that the answers take at most
LINES: Final = 30
#: quantities that get a line
_QUANTITIES: Final = 4


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
        for name, entry in list(contents.results.quantities.items())[:_QUANTITIES]:
            ends = [entry.quantiles[p] for p in ("0.05", "0.95") if p in entry.quantiles]
            within = f", nine in ten {' to '.join(rounded(end, name, 3) for end in ends)}" if len(ends) == 2 else ""
            found.append(f"{name}: mean {rounded(entry.mean, name, 3)}, sd {rounded(entry.sd, name, 2)}{within}")
    return found
