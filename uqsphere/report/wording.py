"""Numbers and findings in words: every number with its unit, rounded to what its interval supports."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, Final

from uqsphere.quantities import display_unit, format_estimate, format_value, lookup
from uqsphere.report.canvas import clean, shorten

__all__ = [
    "ABSENT",
    "MOST_DIGITS",
    "Estimate",
    "absent_reason",
    "begin",
    "call",
    "capital",
    "estimate_text",
    "failures_text",
    "input_name",
    "law_name",
    "limit_name",
    "listed",
    "mathematical",
    "number_text",
    "outward",
    "powers",
    "probability_range",
    "probability_text",
    "rounded",
    "share_text",
    "short_input",
    "symbol",
    "the_input",
    "two_digits",
    "unit_text",
    "value_text",
    "without_failed",
]

#: digits of a number on the page that has an interval: more are known of some, and read by nobody
MOST_DIGITS: Final = 5
#: an EST of results.json
Estimate = Mapping[str, Any]

ABSENT: Final = "–"
#: what an answer of a run in which evaluations failed is: without them, and by a surrogate
_WITHOUT_FAILED: Final = (
    "mean, standard deviation and indices are those of the others, and another matter than the whole model's wherever "
    "failing has to do with the inputs"
)
_GOES_ON: Final = (
    "mean, standard deviation and indices are those of a surrogate fitted to the others, which goes on where the model "
    "has no answer"
)
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
    number = _POWER.sub(lambda m: " × 10" + str(int(m[1])).translate(_SUPERSCRIPT), number)
    return re.sub(r"(?<!\w)-(?=\d)", "−", number) + space + unit_text(unit)


def value_text(value: float | None, name: str = "", digits: int = 4) -> str:
    """A plain value (SI) of a named quantity."""
    return ABSENT if value is None else number_text(format_value(value, name, digits))


def capital(text: str) -> str:
    """The text with a capital letter."""
    return text[:1].upper() + text[1:]


#: families named after people
_PEOPLE: Final = {"weibull": "Weibull", "gumbel": "Gumbel", "frechet": "Fréchet", "student_t": "Student’s t"}


def law_name(kind: str) -> str:
    """A family of laws as it is written."""
    return _PEOPLE.get(kind, kind.replace("_", " "))


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


def the_input(name: str) -> str:
    """The same within a sentence; a name of the user's own has no article."""
    words = input_name(name)
    return words if words == shorten(name, 80) else f"the {words}"


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


def estimate_text(estimate: Estimate, name: str = "", digits: int = MOST_DIGITS) -> str:
    """Value and interval with unit; a dash for an absent answer, whose reason `absent_reason` gives.

    What is known beyond `digits` digits stands alone: nobody reads what comes after.

    >>> estimate_text({"value": 1.75143e9, "low": 1.75142e9, "high": 1.75144e9}, "p_max")
    '1.7514 GPa'
    """
    value, low, high = estimate["value"], estimate["low"], estimate["high"]
    if value is None:
        return ABSENT
    if low is None or high is None:
        return value_text(value, name)
    if not low < high:
        return value_text(value, name, digits)
    if high - low < _last_place(value, digits):
        return rounded({"value": value, "low": None, "high": None}, name, digits)
    text = format_estimate(value, low, high, name, digits)
    if re.fullmatch(r"(\S+) \(\1 to \1\)( .*)?", text):
        return rounded({"value": value, "low": None, "high": None}, name, digits)
    body, end, unit = text.rpartition(")")
    body = re.sub(r"(?<![\w.])-(?=\d)", "−", _tens(body + end))
    return f"{body} {unit_text(unit.strip())}".rstrip()


def _last_place(value: float, digits: int) -> float:
    """What one stands for in the last of so many digits of a value."""
    return 10.0 ** (math.floor(math.log10(abs(value)) + _ROUND) + 1 - digits) if value else 0.0


def absent_reason(estimate: Estimate) -> str:
    """Why an answer is absent, or an empty text."""
    return "" if estimate["value"] is not None else clean(str(estimate.get("reason") or "no reason is stored"))


def probability_text(estimate: Estimate) -> str:
    """A probability with its interval, in per cent unless it is tiny.

    >>> probability_text({"value": 0.0075, "low": 0.0071, "high": 0.0079})
    '0.750 (0.710 to 0.790) %'
    >>> probability_text({"value": 1.46e-7, "low": 0.0, "high": 1.2e-4})
    '1.5 × 10⁻⁷ (0 % to 0.012 %)'
    """
    value, low, high = estimate["value"], estimate["low"], estimate["high"]
    if value is None:
        return ABSENT
    if low is None or high is None:
        return _percent(value)
    if value == 0.0 and low == 0.0:
        return f"none seen, at most {_percent(high)}"
    if value == 1.0 and high == 1.0 and low < 1.0:
        return f"all seen, at least {_percent(low)}"
    if _lost(value, low, high):
        return (
            f"{_percent(float(f'{value:.2g}'))} ({_percent(float(f'{low:.2g}'))} to {_percent(float(f'{high:.2g}'))})"
        )
    if high < 1e-4:
        return estimate_text(estimate)
    # close to one the digits that count are those of what is missing
    digits = MOST_DIGITS if not 0.99 < value < 1.0 else 3 - math.floor(math.log10(1.0 - value))
    return estimate_text({"value": 100.0 * value, "low": 100.0 * low, "high": 100.0 * high}, digits=digits) + " %"


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
    return " to ".join(_percent(end) for end in outward(low, high))


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


def _percent(value: float) -> str:
    """Four digits at most, and never 100 % for less than all."""
    if value > 0.99 and value < 1.0:
        digits = max(0, 1 - math.floor(math.log10(100.0 * (1.0 - value))))
        text = f"{math.floor(100.0 * value * 10.0**digits + _ROUND) / 10.0**digits:.{digits}f}"
        return text.rstrip("0").rstrip(".") + " %"
    if 0.0 < value < 1e-4:
        return number_text(f"{value:.2g}")
    return number_text(f"{100.0 * value:.3g}") + " %"


def plain_percent(value: float) -> str:
    """A share without interval, in per cent."""
    return _percent(value)


def rounded(estimate: Estimate, name: str = "", digits: int = 4) -> str:
    """The value alone, to what its interval supports and at most `digits` digits.

    >>> rounded({"value": 4.0004e9, "low": 3.9986e9, "high": 4.0021e9}, "p_max")
    '4.000 GPa'
    """
    value, low, high = estimate["value"], estimate["low"], estimate["high"]
    if value is None:
        return ABSENT
    if low is not None and high is not None and low < high and value != 0.0:
        supported = 1 + math.floor(math.log10(abs(value))) - math.floor(math.log10(0.5 * (high - low)) + _ROUND)
        digits = max(1, min(digits, supported))
    unit, factor = display_unit(name) if name else ("", 1.0)
    scaled = value * factor
    if abs(scaled) >= 10.0**digits and abs(scaled) < 1e6:
        # zeros before the point are no digits that the interval must support
        text = f"{round(scaled, digits - 1 - math.floor(math.log10(abs(scaled)))):.0f}"
    else:
        text = f"{scaled:#.{digits}g}".removesuffix(".").replace(".e", "e")
    return number_text(f"{text} {unit}".rstrip())


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


def share_text(estimate: Estimate) -> str:
    """A Sobol' index as a share of the variance, rounded to what its interval supports.

    >>> share_text({"value": 0.9574, "low": 0.9522, "high": 0.9626})
    '95.7 %'
    >>> share_text({"value": 1.02, "low": 0.93, "high": 1.12})
    'nearly all'
    """
    value, low, high = estimate["value"], estimate["low"], estimate["high"]
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


def failures_text(count: int) -> str:
    """How many evaluations failed.

    >>> failures_text(1), failures_text(1200)
    ('1 evaluation failed', '1,200 evaluations failed')
    """
    return f"{count:,} evaluation{'' if count == 1 else 's'} failed"


def without_failed(results: Mapping[str, Any]) -> str:
    """What the answers of a run in which evaluations failed are."""
    quantities = results["quantities"]
    names = [name for name, entry in quantities.items() if entry["mean"]["method"].startswith("surrogate")]
    if not names:
        return _WITHOUT_FAILED
    if len(names) == len(quantities):
        return _GOES_ON
    return f"of {listed([symbol(name) for name in names])} {_GOES_ON}; of the rest {_WITHOUT_FAILED}"


def listed(words: list[str]) -> str:
    """a, b and c."""
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1] if words else ""
