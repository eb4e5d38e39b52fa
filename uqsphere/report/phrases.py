"""Numbers and findings in words, every number rounded to what its interval supports; the tables and blocks of them."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Final

from uqsphere.quantities import OUTPUTS, display_unit, format_estimate, format_value, lookup
from uqsphere.report.contents import Contents
from uqsphere.report.figures.canvas import Picture, clean, shorten
from uqsphere.results import Est, MarginEntry, Results
from uqsphere.uq.families import family_stored

#: digits of a number on the page that has an interval: more are known of some, and read by nobody
MOST_DIGITS: Final = 5

ABSENT: Final = "–"
#: a width of 0.1 is not to count as 0.0999999
_ROUND: Final = 1e-9
#: nor two hundredths of a per cent, computed as a difference to one, as three
_COUNTED: Final = 1e-6
_UNITS: Final = {"um": "µm", "us": "µs", "uJ": "µJ", "kg/m3": "kg/m³"}
_SUPERSCRIPT: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_POWER: Final = re.compile(r"(?<=\d)e([+-]?\d+)")


def unit_text(unit: str) -> str:
    """A unit as people write it."""
    return _UNITS.get(unit, unit)


def number_text(text: str) -> str:
    """A formatted number with a true minus and powers of ten.

    >>> number_text("-1.5e-07 um")
    '−1.5 × 10⁻⁷ µm'
    """
    number, space, unit = text.partition(" ")
    return re.sub(r"(?<!\w)-(?=\d)", "−", _tens(number)) + space + unit_text(unit)


def value_text(value: float | None, name: str = "", digits: int = 4) -> str:
    """A plain value (SI) of a named quantity."""
    return ABSENT if value is None else number_text(format_value(value, name, digits))


def capital(text: str) -> str:
    """The text with a capital letter, but for the path of a number."""
    path = "." in text.partition(" ")[0][:-1]
    return text if path else text[:1].upper() + text[1:]


def law_name(kind: str) -> str:
    """A family of laws as it is written."""
    family = family_stored(kind)
    return kind if family is None else family.label


def begin(name: str, words: str) -> str:
    """The words of a name at the start of a sentence; a name of the user's own keeps its letters."""
    return words if words == shorten(name, 80) else capital(words)


def call(name: str) -> str:
    """How a quantity is called in a sentence: its meaning and its name."""
    meaning = lookup(name).meaning
    return shorten(name, 80) if meaning == name else f"{meaning} ({symbol(name)})"


def symbol(name: str, length: int = 60) -> str:
    """The name of a quantity as the study file has it."""
    return shorten(name, length)


def limit_name(name: str, length: int = 60) -> str:
    """A limit's own name, as a quotation."""
    return f"“{shorten(name, length)}”"


def input_name(name: str) -> str:
    """A random or fixed number of the study in words."""
    parts = name.split(".")
    if parts[0] == "limits" and len(parts) > 2:
        return f"{parts[-1].replace('_', ' ')} of {limit_name('.'.join(parts[1:-1]))}"
    if name == "specific_energy":
        # the axis of a fragility curve: its meaning in full stands among the quantities
        return "specific energy"
    meaning = lookup(name).meaning
    return shorten(meaning, 80)


def short_input(name: str) -> str:
    """The same, without what one knows anyway, for bars and lists."""
    words = input_name(name)
    return re.sub(r"^(.*) \(.*\)$", r"\1", words)


def powers(text: str) -> str:
    """A text with powers of ten in place of exponents, ``2.6e-09``.

    >>> powers("it leaves 2.6e-09 of the variance")
    'it leaves 2.6 × 10⁻⁹ of the variance'
    """
    return re.sub(r"(?<![\w.-])(\d[\d.]*e[+-]?\d+)\b", lambda m: _tens(m[1]), text)


#: signs of formulas as they are typed, and as they are set
_SIGNS: Final = (
    (re.compile(r"\bsqrt\((\w)\)"), r"√\1"),
    (re.compile(r"\bsqrt\("), "√("),
    (re.compile(r"\^(\d+)"), lambda m: str(m[1]).translate(_SUPERSCRIPT)),
    (re.compile(r"<="), "≤"),
    (re.compile(r">="), "≥"),
    (re.compile(r"\+/?-"), "±"),
    (re.compile(r"\brho\b"), "ρ"),
    (re.compile(r"\bnu\b"), "ν"),
)


def mathematical(text: str) -> str:
    """A text of the program with the signs of formulas in place of their names in code.

    >>> mathematical("0.005 <= a/r <= 0.3, 0 <= nu <= 0.5, a wave, at sqrt(E/rho), n = (sway/(0.1 p))^2, sd/sqrt(n)")
    '0.005 ≤ a/r ≤ 0.3, 0 ≤ ν ≤ 0.5, a wave, at √(E/ρ), n = (sway/(0.1 p))², sd/√n'
    """
    text = powers(text)
    for found, sign in _SIGNS:
        text = found.sub(sign, text)
    return text


def _tens(text: str) -> str:
    return _POWER.sub(lambda m: " × 10" + str(int(m[1])).translate(_SUPERSCRIPT), text)


def estimate_text(estimate: Est, name: str = "", digits: int = MOST_DIGITS) -> str:
    """Value and interval with unit; a dash for an absent answer, whose reason `absent_reason` gives.

    What is known beyond `digits` digits stands alone: nobody reads what comes after.

    >>> estimate_text(Est.of(1.75143e9, 1.75142e9, 1.75144e9), "p_max")
    '1.7514 GPa'
    """
    value, low, high = estimate.value, estimate.low, estimate.high
    if value is None:
        return ABSENT
    if low is None or high is None:
        return value_text(value, name)
    if not low < high:
        return value_text(value, name, digits)
    if high - low < _last_place(value, digits):
        return rounded(Est.of(value), name, digits)
    text = format_estimate(value, low, high, name, digits)
    if re.fullmatch(r"(\S+) \(\1 to \1\)( .*)?", text):
        return rounded(Est.of(value), name, digits)
    body, end, unit = text.rpartition(")")
    body = re.sub(r"(?<![\w.])-(?=\d)", "−", _tens(body + end))
    return f"{body} {unit_text(unit.strip())}".rstrip()


def _last_place(value: float, digits: int) -> float:
    """What one stands for in the last of so many digits of a value."""
    return 10.0 ** (math.floor(math.log10(abs(value)) + _ROUND) + 1 - digits) if value else 0.0


def absent_reason(estimate: Est) -> str:
    """Why an answer is absent, or an empty text."""
    return "" if estimate.value is not None else clean(str(estimate.reason or "no reason is stored"))


def probability_text(estimate: Est) -> str:
    """A probability with its interval, in per cent unless it is tiny.

    >>> probability_text(Est.of(0.0075, 0.0071, 0.0079))
    '0.750 (0.710 to 0.790) %'
    >>> probability_text(Est.of(1.46e-7, 0.0, 1.2e-4))
    '1.5 × 10⁻⁷ (0 % to 0.012 %)'
    """
    value, low, high = estimate.value, estimate.low, estimate.high
    if value is None:
        return ABSENT
    if low is None or high is None:
        return plain_percent(value)
    if value == 0.0 and low == 0.0:
        return f"none seen, at most {plain_percent(high)}"
    if value == 1.0 and high == 1.0 and low < 1.0:
        return f"all seen, at least {plain_percent(low)}"
    if _lost(value, low, high):
        own, least, most = (plain_percent(float(f"{p:.2g}")) for p in (value, low, high))
        return f"{own} ({least} to {most})"
    if high < 1e-4:
        return estimate_text(estimate)
    # close to one the digits that count are those of what is missing
    digits = MOST_DIGITS if not 0.99 < value < 1.0 else 3 - math.floor(math.log10(1.0 - value))
    return estimate_text(Est.of(100.0 * value, 100.0 * low, 100.0 * high), digits=digits) + " %"


def _lost(value: float, low: float, high: float) -> bool:
    """Whether a probability above zero would read as zero in the digits that its interval supports."""
    if not low < high or not value > 0.0:
        return False
    step = 10.0 ** (math.floor(math.log10(0.5 * (high - low)) + _ROUND) - 1)
    return value < 0.5 * step or 0.0 < low < 0.5 * step


def probability_range(low: float, high: float) -> str:
    """Two probabilities between which another lies.

    >>> probability_range(1.5331809e-06, 0.0123)
    '1.5 × 10⁻⁶ to 1.3 %'
    >>> probability_range(0.99901, 0.9999997)
    '99.901 % to 99.99997 %'
    """
    return " to ".join(plain_percent(end) for end in outward(low, high))


def outward(low: float, high: float) -> tuple[float, float]:
    """The ends of a range of probabilities in two figures, none of them further in than it is.

    Whoever divides a target by what is printed then finds no more than the page says.

    >>> outward(3.14e-7, 0.0010382)
    (3.1e-07, 0.0011)
    """
    return _two_figures(low, up=False), _two_figures(high, up=True)


def _two_figures(p: float, *, up: bool) -> float:
    """A probability to two figures, rounded one way; close to one, of what is missing to it."""
    if 0.99 < p < 1.0:
        return 1.0 - _two_figures(1.0 - p, up=not up)
    if not 0.0 < p < 1.0:
        return p
    step = 10.0 ** (math.floor(math.log10(p) + _ROUND) - 1)
    whole = math.ceil(p / step - _COUNTED) if up else math.floor(p / step + _COUNTED)
    return float(f"{whole * step:.2g}")


def plain_percent(value: float) -> str:
    """A share without interval, in per cent: four digits at most, and never 100 % for less than all."""
    if 0.99 < value < 1.0:
        digits = max(0, 1 - math.floor(math.log10(100.0 * (1.0 - value))))
        text = f"{math.floor(100.0 * value * 10.0**digits + _ROUND) / 10.0**digits:.{digits}f}"
        return text.rstrip("0").rstrip(".") + " %"
    if 0.0 < value < 1e-4:
        return number_text(f"{value:.2g}")
    return number_text(f"{100.0 * value:.3g}") + " %"


def rounded(estimate: Est, name: str = "", digits: int = 4) -> str:
    """The value alone, to what its interval supports and at most `digits` digits.

    >>> rounded(Est.of(4.0004e9, 3.9986e9, 4.0021e9), "p_max")
    '4.000 GPa'
    """
    if estimate.value is None:
        return ABSENT
    digits = _supported(estimate, digits)
    unit, factor = display_unit(name) if name else ("", 1.0)
    scaled = estimate.value * factor
    if abs(scaled) >= 10.0**digits and abs(scaled) < 1e6:
        # zeros before the point are no digits that the interval must support
        text = f"{round(scaled, digits - 1 - math.floor(math.log10(abs(scaled)))):.0f}"
    else:
        text = f"{scaled:#.{digits}g}".removesuffix(".").replace(".e", "e")
    return number_text(f"{text} {unit}".rstrip())


def _supported(estimate: Est, most: int) -> int:
    """Digits of a value that its interval supports."""
    value, low, high = estimate.value, estimate.low, estimate.high
    if not value or low is None or high is None or not low < high:
        return most
    supported = 1 + math.floor(math.log10(abs(value))) - math.floor(math.log10(0.5 * (high - low)) + _ROUND)
    return max(1, min(most, supported))


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
    if text == "100":
        # nearly all is not all
        text = f"{math.floor(1000.0 * value) / 10.0:.1f}"
    if target is not None and text == two(100.0 * target) and abs(value - target) > 1e-9 * target:
        text = two(100.0 * value, 3)
    return f"{text}\u00a0%"


def short_share(value: float, target: float | None = None) -> str:
    r"""The same for a table, where signs stand for words.

    >>> short_share(4e-5).replace("\u00a0", " "), short_share(0.99996).replace("\u00a0", " ")
    ('<0.1 %', '>99.9 %')
    """
    return share(value, target).replace("under ", "<").replace("over ", ">")


def two_digits(value: float) -> str:
    """A share in per cent with two digits, and as many more as tell it from the whole.

    >>> two_digits(0.0123), two_digits(0.9979), two_digits(1.52)
    ('1.2 %', '99.8 %', '152 %')
    """
    percent = 100.0 * value
    if percent < 99.5:
        return number_text(f"{percent:.2g}") + " %"
    decimals = 1 if percent < 99.95 else 2 if percent < 99.995 else 0
    return f"{percent:.{decimals}f} %"


def share_text(estimate: Est) -> str:
    """A Sobol' index as a share of the variance, rounded to what its interval supports.

    >>> share_text(Est.of(0.9574, 0.9522, 0.9626))
    '95.7 %'
    >>> share_text(Est.of(1.02, 0.93, 1.12))
    'nearly all'
    """
    value, low, high = estimate.value, estimate.low, estimate.high
    if value is None:
        return ABSENT
    if value > 0.995 and low is not None:
        return "nearly all"
    if low is None or high is None:
        return f"{100.0 * value:.2g} %"
    half = 50.0 * (high - low)
    decimals = min(1, max(0, -math.floor(math.log10(half) + _ROUND))) if half > 0.0 else 1
    if abs(value) < 0.005 * 10.0**-decimals:
        return "less than 0.1 %" if decimals else "less than 1 %"
    return number_text(f"{100.0 * value:.{decimals}f}") + " %"


def loud(verdict: str) -> str:
    """A verdict as the terminal sets it: what is not as it should be in capitals.

    >>> loud("not met"), loud("met"), loud("no target")
    ('NOT MET', 'met', 'no target')
    """
    return verdict.upper() if verdict.startswith("not ") else verdict


def counted(count: int, word: str) -> str:
    """A count with its word.

    >>> counted(1, "more test"), counted(20, "sphere")
    ('1 more test', '20 spheres')
    """
    return f"{count} {word}{'' if count == 1 else 's'}"


def listed(words: list[str]) -> str:
    """a, b and c."""
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1] if words else ""


# --- What a limit's event is called: one name, in whichever way the aim puts it.


def at_most(entry: MarginEntry, aim: str) -> bool:
    """Whether the aim is reached below the value (at most) or above it (at least)."""
    curve = entry.curve
    rising = bool(curve[-1][1] >= curve[0][1])
    return rising == (aim == "survive")


def answer_text(contents: Contents, name: str) -> str:
    """The answer of a limit's inverse question as it is given everywhere: rounded to the safe side."""
    entry = contents.results.margins[name]
    most = at_most(entry, contents.results.limits[name].aim)
    return safe_side(entry.value, contents.subject(entry.solve), at_most=most)


def breaks(results: Results, name: str) -> bool:
    """Whether exceeding a limit means that the sphere breaks.

    A limit that the study leaves out of fracture still does where its aim is to break: nothing else is to be broken.
    """
    found = results.fracture
    left_out = name in found.left_out and results.limits[name].aim == "break"
    judged = any(one.name == name and not one.assumed for verdict in results.verdicts for one in verdict.judged)
    # where no answer on fracture could be had, what is asked of the quantity tells
    quantity = OUTPUTS.get(results.limits[name].quantity.partition(".")[0])
    alone = not (found.limits or found.left_out) and quantity is not None and quantity.fracture
    return name in found.limits or left_out or judged or alone


def safe_side(estimate: Est, name: str, *, at_most: bool, digits: int = 4) -> str:
    """A limit in the digits that its interval supports, rounded to the safe side and never past the value.

    >>> known = Est.of(0.65852, 0.6573, 0.6597)
    >>> safe_side(known, "striker.speed", at_most=True), safe_side(known, "striker.speed", at_most=False)
    ('0.658 m/s', '0.659 m/s')
    """
    value, digits = estimate.value, _supported(estimate, digits)
    unit, factor = display_unit(name)
    scaled = 0.0 if value is None else value * factor
    if not 1e-4 <= abs(scaled) < 1e6:
        return rounded(estimate, name, digits)
    places = digits - 1 - math.floor(math.log10(abs(scaled)) + _ROUND)
    steps = scaled * 10.0**places
    whole = math.floor(steps * (1.0 + math.copysign(_ROUND, steps))) if at_most else math.ceil(
        steps * (1.0 - math.copysign(_ROUND, steps))
    )  # fmt: skip
    return number_text(f"{whole * 10.0**-places:.{max(places, 0)}f} {unit}".rstrip())


# --- what a page is made of: tables of texts, blocks with their pictures, chapters --------------------------


@dataclass(frozen=True, kw_only=True)
class Table:
    """A caption, a header and rows of texts; the first column heads its row; why numbers have no interval."""

    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


def cell(estimate: Est | None, name: str = "", *, probability: bool = False, digits: int = MOST_DIGITS) -> str:
    """An estimate with its interval and unit, or a dash and the reason why it is absent; None was never asked for."""
    if estimate is None:
        return ABSENT
    if estimate.value is None:
        return f"{ABSENT} ({absent_reason(estimate)})"
    return probability_text(estimate) if probability else estimate_text(estimate, name, digits)


def index_cell(estimate: Est | None) -> str:
    """An index, a share of one, to four places: further ones change no ranking.

    >>> index_cell(Est.of(0.0719853, 0.0719754, 0.0719953))
    '0.0720'
    """
    if estimate is None or estimate.value is None or estimate.low is None or estimate.high is None:
        return cell(estimate)
    value, low, high = estimate.value, estimate.low, estimate.high
    if high - low >= 1e-4:
        # what is small keeps the digits of its interval, and no more than four places
        places = min(4, max(0, 1 - math.floor(math.log10(0.5 * (high - low)))))
        texts = [f"{round(v, places) + 0.0:.{places}f}".replace("-", "−") for v in (value, low, high)]
        return f"{texts[0]} ({texts[1]} to {texts[2]})"
    if abs(value) < 5e-5:
        return "below 0.0001"
    # rounding must not make a share of nearly all into all
    return f"{math.floor(1e4 * value) / 1e4:.4f}" if 0.99 < value < 1.0 else number_text(f"{value:.4f}")


def thousands(number: float) -> str:
    """A count with narrow spaces between its thousands.

    >>> thousands(16384).replace("\u202f", " ")
    '16 384'
    """
    return f"{number:,.0f}".replace(",", "\u202f")


@dataclass(frozen=True, kw_only=True)
class Block:
    """A heading with its picture, table and remarks; what is absent is left out.

    `files` are the files of the result folder that hold the numbers; `kind` is the style of the table: "notes" has a
    last column of text, "checks notes" grades in the second, "brief" a short last column.
    """

    heading: str
    picture: Picture | None = None
    table: Table | None = None
    remarks: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    kind: str = ""

    @property
    def empty(self) -> bool:
        """Whether there is nothing under the heading."""
        return not (self.picture or (self.table and self.table.rows) or self.remarks)


@dataclass(frozen=True, kw_only=True)
class Chapter:
    """A part of the page: its anchor, its heading, its blocks, a last remark.

    An annex is closed on the screen until it is asked for, and printed in full reports alone.
    """

    anchor: str
    heading: str
    blocks: tuple[Block, ...]
    remark: str = ""
    annex: bool = False
