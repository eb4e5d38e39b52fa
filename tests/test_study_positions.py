"""Positions of a TOML text: complete, and pointing at what they name; caps before the text is parsed."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_broken_studies import BASE

from uqsphere.errors import StudyError
from uqsphere.mechanics.criteria import CRITERIA, demand
from uqsphere.model import answer_scene
from uqsphere.quantities import lookup
from uqsphere.study import Study, load_study
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


# --- distributions from a CSV of the user's tests: read in SI, and only from the study's own folder


Load = Callable[..., Study]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def with_stiffness(new: str) -> Study:
        assert BASE.count(LOGNORMAL) == 1
        (tmp_path / "study.toml").write_text(BASE.replace(LOGNORMAL, new))
        return load_study(tmp_path / "study.toml")

    return with_stiffness


EMPIRICAL = 'E = { dist = "empirical", file = "tests.csv", column = "E", unit = "GPa", fit = "steps" }'
LOGNORMAL = 'E = { dist = "lognormal", mean = "52 GPa", cov = 0.12 }'


def test_empirical_law_from_a_csv(load: Load, tmp_path: Path) -> None:
    (tmp_path / "tests.csv").write_bytes("\ufeffE , name\r\n50, a\r\n\r\n54,b\r\n58.5,c\r\n".encode())
    law = load(EMPIRICAL).random["sphere.E"]
    assert law.data == pytest.approx((50e9, 54e9, 58.5e9), rel=1e-12)
    (tmp_path / "sub").mkdir()
    (tmp_path / "tests.csv").rename(tmp_path / "sub" / "t.csv")
    (tmp_path / "tests.csv").symlink_to(tmp_path / "sub" / "t.csv")
    fitted = EMPIRICAL.replace('fit = "steps"', 'fit = "lognormal"')
    assert load(fitted).random["sphere.E"].family.name == "lognormal"


@pytest.mark.parametrize(
    ("change", "csv", "says"),
    [
        (('"tests.csv"', '"/etc/passwd"'), "E\n1\n2\n", "own folder only"),
        (('"tests.csv"', '"../tests.csv"'), "E\n1\n2\n", "own folder only"),
        (('"tests.csv"', '"C:\\\\tests.csv"'), "E\n1\n2\n", "own folder only"),
        (('"tests.csv"', '"https://example.org/t.csv"'), "E\n1\n2\n", "own folder only"),
        (('"tests.csv"', '"link.csv"'), "E\n1\n2\n", "leaves the study's folder"),
        (('"tests.csv"', '"test.csv"'), "E\n1\n2\n", "did you mean 'tests.csv'"),
        (('"tests.csv"', '"."'), "E\n1\n2\n", "cannot be read as a file"),
        (('"tests.csv"', "3"), "E\n1\n2\n", "found 3, where a text in quotes is due"),
        (("", ""), "F,e\n1,2\n2,3\n", "column \"E\" is not in"),
        (("", ""), "E,E\n1,2\n2,3\n", "twice or more"),
        (("", ""), "E\n1\nx\n", "tests.csv:3: found \"x\""),
        (("", ""), "E\n1\ninf\n", "finite number is due"),
        (("", ""), "E,F\n1,2\n,3\n", "finite number is due"),
        (("", ""), "E\n1\n", "found 1 value"),
        (("", ""), "E\n1\n1\n", "no scatter|scatter"),
        (("", ""), "", "is empty"),
        (("", ""), "E\n" + "1\n2\n" * 300_000, "larger than 1 MiB"),
        (("", ""), b"E\n\xff\n", "not UTF-8"),
        ((', unit = "GPa"', ""), "E\n1\n2\n", "unit of the column is missing"),
        (('"GPa"', '"mm"'), "E\n1\n2\n", "sphere.E.unit: found \"mm\""),
        (('"steps"', '"stepps"'), "E\n1\n2\n", "sphere.E.fit"),
        (('"steps"', "3"), "E\n1\n2\n", "sphere.E.fit"),
        ((', column = "E"', ""), "E\n1\n2\n", "column is missing"),
        ((', column = "E"', ', column = "E", mean = "5 GPa"'), "E\n1\n2\n", "sphere.E.mean"),
    ],
)  # fmt: skip
def test_empirical_law_refused(
    load: Load, tmp_path: Path, change: tuple[str, str], csv: str | bytes, says: str
) -> None:
    (tmp_path / "tests.csv").write_bytes(csv if isinstance(csv, bytes) else csv.encode())
    outside = tmp_path.parent / f"{tmp_path.name}-outside.csv"
    outside.write_text("E\n1\n2\n")
    (tmp_path / "link.csv").symlink_to(outside)
    with pytest.raises(StudyError, match=says) as caught:
        load(EMPIRICAL.replace(*change) if change[0] else EMPIRICAL)
    assert len(caught.value.problems) == 1


# --- criteria in a study: what is understood, what is refused, and what the model then answers ----


SCENE = """
[sphere]
material = "granite"
radius = { dist = "normal", mean = "10 mm", cov = 0.02 }
[bars]
material = "maraging_steel"
diameter = "40 mm"
infinite = true
[striker]
speed = "1 m/s"
length = "0.4 m"
[limits.split]
"""
WEIBULL = 'strength = { dist = "weibull", scale = "40 MPa", modulus = 9 }\n'
VOLUME = 'criterion = "weakest_link_volume"\nreference_volume = "1 cm3"\n'


def study(limit: str, tmp_path: Path) -> Study:
    path = tmp_path / "study.toml"
    path.write_text(SCENE + limit, encoding="utf-8")
    return load_study(path)


def test_a_criterion_without_parameters_is_its_quantity(tmp_path: Path) -> None:
    limit = study('criterion = "ring_crack"\nstrength = "1.2 MPa.sqrt(m)"\n', tmp_path).limits[0]
    assert (limit.quantity, limit.criterion, limit.strength) == ("ring_crack_toughness", None, 1.2e6)
    other = study('quantity = "ring_crack_toughness"\nstrength = "1.2 MPa.sqrt(m)"\n', tmp_path)
    assert other.limits[0] == limit


def test_the_modulus_is_that_of_the_strength(tmp_path: Path) -> None:
    found = study(VOLUME + WEIBULL, tmp_path)
    assert found.limits[0].parameters == {"modulus": 9.0, "reference_volume": pytest.approx(1e-6)}
    assert found.limits[0].quantity == "weakest_link_volume.split"
    assert "weakest_link_volume.split" in found.analysis.quantities
    assert lookup("weakest_link_volume.split").unit == "Pa"
    same = study(VOLUME + "modulus = 9\n" + WEIBULL, tmp_path)
    assert same.hash == found.hash
    assert study(VOLUME.replace("1 cm3", "2 cm3") + WEIBULL, tmp_path).hash != found.hash


def test_a_strength_that_is_no_weibull_law_is_worth_a_word(tmp_path: Path) -> None:
    assert not study(VOLUME + WEIBULL, tmp_path).warnings
    found = study(VOLUME + 'modulus = 9\nstrength = "40 MPa"\n', tmp_path)
    assert any("weakest link" in text for text in found.warnings)


@pytest.mark.parametrize(
    ("limit", "words"),
    [
        ('criterion = "weakest_link"\n' + WEIBULL, 'unknown criterion "weakest_link"'),
        ('criterion = "core_tension"\nquantity = "p_max"\n' + WEIBULL, "leave one of them out"),
        ('criterion = "weakest_link_volume"\n' + WEIBULL, "reference_volume is missing"),
        (VOLUME + 'strength = "40 MPa"\n', "modulus is missing"),
        (VOLUME + "modulus = 8\n" + WEIBULL, "the strength has the modulus 9"),
        (VOLUME + "modulus = 0.5\n" + WEIBULL, "Weibull modulus m must lie between 1"),
        (VOLUME + 'reference_area = "1 cm2"\n' + WEIBULL, "takes no reference_area"),
        (VOLUME.replace("1 cm3", "0 cm3") + WEIBULL, "must be above 0"),
        (VOLUME.replace("1 cm3", "1 cm2") + WEIBULL, "unknown unit 'cm2' for a volume"),
        ('quantity = "p_max"\nmodulus = 8\n' + WEIBULL, "modulus belongs to a criterion"),
        ('criterion = "subsurface_shear"\nrate_0 = "200 1/s"\n' + WEIBULL, "takes no rate_0"),
        (VOLUME + WEIBULL.replace("MPa", "kN"), "unknown unit 'kN' for a pressure"),
    ],
)
def test_what_is_wrong_is_said_once(limit: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=words) as caught:
        study(limit, tmp_path)
    assert str(caught.value).count("\n") < 4


def test_a_black_box_has_no_criterion(tmp_path: Path) -> None:
    path = tmp_path / "box.toml"
    path.write_text('[inputs]\nx = 1.0\n[outputs]\nnames = ["y"]\n[limits.high]\ncriterion = "core_tension"\n'
                    "strength = 1.0\n", encoding="utf-8")  # fmt: skip
    with pytest.raises(StudyError, match="belongs to the impact model"):
        load_study(path)


@pytest.mark.parametrize("fidelity", ["massless", "full"])
def test_the_model_answers_the_demand(fidelity: str, tmp_path: Path) -> None:
    limits = VOLUME + WEIBULL + '[limits.rate]\ncriterion = "core_tension"\nrate_0 = "200 1/s"\n' + WEIBULL
    found = study(limits, tmp_path)
    names = ["p_max", "P_max", "a_max", "loading_rate", "weakest_link_volume.split", "core_tension.rate"]
    radius = np.array([[0.009], [0.011]])
    values = answer_scene(found, ["sphere.radius"], radius, names, fidelity=fidelity).values
    columns = dict(zip(names, values.T, strict=True)) | {"sphere.radius": radius[:, 0]}
    columns |= {name: np.full(2, found.at_means()[name]) for name in ("sphere.nu", "sphere.E")}
    wanted = demand(CRITERIA["weakest_link_volume"], columns, {"modulus": 9.0, "reference_volume": 1e-6})
    assert columns["weakest_link_volume.split"] == pytest.approx(wanted, rel=1e-12)
    assert columns["core_tension.rate"] == pytest.approx(
        demand(CRITERIA["core_tension"], columns, {"rate_0": 200.0}), rel=1e-5
    )
    # what a demand needs is followed although nobody asked for it
    alone = answer_scene(found, ["sphere.radius"], radius, ["core_tension.rate"], fidelity=fidelity).values
    assert alone[:, 0] == pytest.approx(columns["core_tension.rate"], rel=1e-5)
