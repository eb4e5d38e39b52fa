"""Positions of a TOML text: complete, and pointing at what they name; caps before the text is parsed."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uqsphere.errors import StudyError
from uqsphere.study.faults import Place
from uqsphere.study.text import MOST_DOTS, MOST_NESTING, locate, parse_text

STUDIES = sorted((Path(__file__).parent.parent / "studies").glob("*.toml"))

TRICKY = (
    """\
# µ in a comment
"ein µ" = "µ", 'single.dot' = 1
""".replace(", 'single.dot'", "\n'single.dot'")
    + """\
a.b.c = { d = [1, { e = "µ µ", f = 2 }], "g h".i = 3 }
[ sphere . E ]
mean = '''
  [not.a.table]
'''   # comment
[[dependence]]
of = ["a",
      "b", # comment
      "c"]
[[dependence]]
of = []
[dependence.inner]
x = 1
[[dependence.list]]
y = 1
[[dependence.list]]
y = 2
"""
)


def places(node: Any, place: Place = ()) -> list[Place]:
    """Every place of a parsed text, found without tree-sitter."""
    pairs = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    return [found for key, value in pairs for found in ((*place, key), *places(value, (*place, key)))]


@pytest.mark.parametrize("text", [TRICKY, *(path.read_text() for path in STUDIES)], ids=lambda text: text[:20])
def test_every_place_is_found_and_named_there(text: str) -> None:
    found = locate(text)
    lines = text.split("\n")
    expected = places(tomllib.loads(text))
    assert expected
    for place in expected:
        line, column = found[place]
        rest = lines[line - 1][column - 1 :]
        name = place[-1]
        if isinstance(name, int):
            # An array element begins here, or an array of tables has its header here.
            assert rest[:1] in set("\"'[{0123456789")
        elif not rest.startswith("["):
            assert rest.lstrip("\"'").startswith(name)


def test_known_positions() -> None:
    found = locate(TRICKY)
    assert found[("ein µ",)] == (2, 1)
    assert found[("a", "b", "c", "d", 1, "f")] == (4, 32)
    assert found[("a", "b", "c", "g h", "i")] == (4, 48)
    assert found[("sphere", "E")] == (5, 1)
    assert found[("sphere", "E", "mean")] == (6, 1)
    assert found[("dependence", 0, "of", 2)] == (12, 7)
    assert found[("dependence", 1)] == (13, 1)
    assert found[("dependence", 1, "inner", "x")] == (16, 1)
    assert found[("dependence", 1, "list", 1, "y")] == (20, 1)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(text=st.text(st.sampled_from("ab.=\"[]{}, \n1µ#'\\"), max_size=60))
def test_any_text_has_positions(text: str) -> None:
    rows = text.split("\n")
    for line, column in locate(text).values():
        assert 1 <= line <= len(rows)
        assert 1 <= column <= len(rows[line - 1]) + 1


def fault(text: str) -> StudyError:
    with pytest.raises(StudyError) as caught:
        parse_text(text, Path("study.toml"))
    assert len(caught.value.problems) == 1
    return caught.value


def test_depth_is_capped_at_the_cap() -> None:
    for depth in (MOST_NESTING, MOST_NESTING + 1):
        text = "x = " + "[" * depth + "]" * depth
        if depth <= MOST_NESTING:
            assert "x" in parse_text(text, Path("study.toml"))
        else:
            assert fault(text).problems[0].column == 5 + MOST_NESTING
    assert parse_text(".".join("a" * (MOST_DOTS + 1)) + " = 1", Path("study.toml"))
    assert "dotted key" in str(fault(".".join("a" * (MOST_DOTS + 2)) + " = 1"))
    assert "dotted key" in str(fault("[" + ".".join("a" * (MOST_DOTS + 2)) + "]"))


@pytest.mark.parametrize(
    "text",
    [
        'x = "' + "[" * 40 + '"',
        "x = '" + "{" * 40 + "'",
        'x = """\n' + "[" * 40 + '\n"" \\""" ""]"""',
        "x = '''\n" + "[" * 40 + "'''",
        "# " + "[" * 40 + "\nx = 1",
        'x = """a""""' + "\n# " + "[" * 40,
        "x = [" + "0.5, " * 500 + "]",
        "\n".join(f"x{number} = [1.5]" for number in range(50)),
    ],
)  # fmt: skip
def test_brackets_and_dots_that_nest_nothing(text: str) -> None:
    assert parse_text(text, Path("study.toml")) == tomllib.loads(text)


@pytest.mark.parametrize("hidden", ['"]]]]"', "']]]]'", '"""]]]]"""', "'''\n]]]]'''", "# ]]]]\n"])
def test_closing_brackets_in_strings_hide_no_depth(hidden: str) -> None:
    comma = "" if hidden.startswith("#") else ","
    text = "x = " + f"[{hidden}{comma}" * (MOST_NESTING + 1) + "1" + "]" * (MOST_NESTING + 1)
    assert "nested" in str(fault(text))


@pytest.mark.parametrize("piece", ['"', "'", "#", "\\", '"""\\', "'''", "[", ".", "a.", "{", '\\"""'])
def test_hostile_repetition_ends_soon(piece: str) -> None:
    # A scan that went back over its text would not come to an end within the life of this test.
    fault("x = " + piece * (400_000 // len(piece)) + "\0")
