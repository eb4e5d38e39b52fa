"""Seeded damage to texts, bytes and JSON documents: the same seed gives the same damage on every machine."""

from __future__ import annotations

import copy
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

__all__ = ["damage_bytes", "damage_json", "damage_text"]

Generator = np.random.Generator

#: what a parser of studies has to think about
WORDS = [
    *("0", "-0", "1", "-1", "1e308", "1e-308", "5e-324", "9223372036854775807", "-9223372036854775808", "1e400", "nan"),
    *("inf", "-inf", "0x7f", "1_000", "true", "false", '""', '"0"', '"1 m/s"', '"1e300 GPa"', '"-3 mm"', '"10 min"'),
    *('"nan GPa"', '"1e-320 m"', '"auto"', '"full"', '"massless"', '"linear"', '"free"', '"fixed"', '"break"', "[]"),
    *("{}", "[[]]", "{ a = 1 }", '{ dist = "normal", mean = 1, sd = 1 }', '{ dist = "normal", mean = 0, cov = 1 }'),
    *('{ dist = "uniform", lower = 0, upper = 0 }', '{ dist = "uniform", lower = -1e308, upper = 1e308 }'),
    *('{ dist = "lognormal", mean = 1, cov = 1e9 }', '{ dist = "weibull", mean = 1, modulus = 1e-3 }', "1979-05-27"),
    *('{ dist = "beta", alpha = 1e-300, beta = 1e300, lower = 0, upper = 1 }', "07:32:00", "[1, 2", '"""', "'''", "#"),
    *('{ dist = "empirical", file = "tests.csv", column = "x" }', '{ dist = "empirical", file = "/etc/passwd" }'),
    *('{ dist = "empirical", file = "../x.csv", column = "x" }', '{ dist = "empirical", file = "NUL", column = "x" }'),
    *('{ dist = "frechet", shape = 0.1, scale = 1 }', '{ dist = "student_t", dof = 0.5, location = 0, scale = 1 }'),
    *(
        "sphere",
        "bars",
        "striker",
        "pulse",
        "model",
        "limits",
        "dependence",
        "analysis",
        "margins",
        "inputs",
        "outputs",
    ),
    *("E", "nu", "radius", "density", "material", "diameter", "speed", "length", "shape", "rise", "fall", "target"),
    *("quantity", "strength", "aim", "of", "spearman", "kendall", "copula", "dof", "quantities", "accuracy", "budget"),
    *(
        "quantiles",
        "methods",
        "on_failure",
        "solve",
        "between",
        "for_probability",
        "lower",
        "upper",
        "mean",
        "sd",
        "cov",
    ),
    *("\\u202e", "\\u0000", "\x1b[31m", "\u2028", "\ufeff", "=cmd()", "<script>", "a.b.c.d.e.f.g.h", '"a\\nb"', "\r"),
]
_TOKEN = re.compile(r'"[^"\n]*"|[A-Za-z_][\w-]*|[-+]?[\d.][\w.+-]*|[\[\]{}=,.#\n]')

NUMBERS: list[Any] = [
    *(0, -1, 1, 2**63, -(2**63), 10**400, 0.0, -0.0, 1e308, -1e308, 5e-324, float("nan"), float("inf")),
    *(
        True,
        False,
        None,
        "",
        "x",
        "\x1b[2J",
        "=1+1",
        "<script>alert(1)</script>",
        "\ud800",
        "\u202e",
        "a" * 5000,
        [],
        {},
    ),
    *([[]], {"value": 1}, {"": None}, [None], [1, "a"], {"std_error": 1}),
]


def _pick(generator: Generator, choices: Sequence[Any]) -> Any:
    return choices[int(generator.integers(len(choices)))]


def damage_bytes(data: bytes, generator: Generator) -> bytes:
    """One to three flips, cuts, doublings or insertions."""
    out = bytearray(data)
    for _ in range(int(generator.integers(1, 4))):
        at = int(generator.integers(len(out) + 1))
        length = int(generator.integers(1, 40))
        kind = int(generator.integers(6))
        if kind == 0 and out:
            out[min(at, len(out) - 1)] ^= 1 << int(generator.integers(8))
        elif kind == 1:
            del out[at : at + length]
        elif kind == 2:
            out[at:at] = out[at : at + length] * int(generator.integers(1, 4))
        elif kind == 3:
            out[at:at] = generator.integers(0, 256, size=length, dtype=np.uint8).tobytes()
        elif kind == 4:
            del out[at:]
        elif out:
            out[min(at, len(out) - 1)] = int(generator.integers(256))
    return bytes(out)


def damage_text(text: str, others: Sequence[str], generator: Generator) -> str:
    """One to four changes that mostly leave the syntax alone: words, values, lines, pieces of other studies."""
    for _ in range(int(generator.integers(1, 5))):
        lines = text.split("\n")
        kind = int(generator.integers(7))
        at = int(generator.integers(len(lines)))
        if kind <= 2:
            tokens = list(_TOKEN.finditer(text))
            if tokens:
                token = _pick(generator, tokens)
                new = _pick(generator, WORDS) if kind < 2 else _pick(generator, tokens).group()
                text = text[: token.start()] + new + text[token.end() :]
            continue
        if kind == 3:
            head, equals, _ = lines[at].partition("=")
            lines[at] = f"{head}{equals} {_pick(generator, WORDS)}" if equals else lines[at]
        elif kind == 4:
            del lines[at]
        elif kind == 5:
            lines.insert(int(generator.integers(len(lines))), lines[at])
        else:
            donor = _pick(generator, others).split("\n")
            start = int(generator.integers(len(donor)))
            lines[at:at] = donor[start : start + int(generator.integers(1, 8))]
        text = "\n".join(lines)
    return text


def _places(node: Any, found: list[tuple[Any, Any]]) -> list[tuple[Any, Any]]:
    for key, value in node.items() if isinstance(node, dict) else enumerate(node):
        found.append((node, key))
        if isinstance(value, (dict, list)):
            _places(value, found)
    return found


def damage_json(document: Any, generator: Generator) -> Any:
    """One or two entries anywhere in a document taken out, renamed, or replaced by what does not belong there."""
    for _ in range(int(generator.integers(1, 3))):
        places = _places(document, []) if isinstance(document, (dict, list)) else []
        if not places:
            return _pick(generator, NUMBERS)
        parent, key = _pick(generator, places)
        kind = int(generator.integers(5))
        if kind == 0:
            del parent[key]
        elif kind == 1 and isinstance(parent, dict):
            parent[str(_pick(generator, NUMBERS))] = parent.pop(key)
        elif kind == 2:
            other, name = _pick(generator, places)
            value = other[name] if (name in other if isinstance(other, dict) else name < len(other)) else None
            parent[key] = copy.deepcopy(value)
        else:
            parent[key] = copy.deepcopy(_pick(generator, NUMBERS))  # the next damage may go into it
    return document
