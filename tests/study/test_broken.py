"""Studies that are broken, one way each or several at once: exit code, place and first line of the
message.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import pytest
from study_base import BASE, BLACK_BOX

from uqsphere.errors import StudyError
from uqsphere.study import load_study


class Broken(NamedTuple):
    """A broken study: its content, the line where the first fault is due, what it says, and how
    many faults.
    """

    name: str
    content: bytes
    line: int | None
    says: tuple[str, ...]
    count: int


def file(
    name: str, content: str | bytes, *says: str, at: str | None = "", count: int = 1
) -> Broken:
    data = content if isinstance(content, bytes) else content.encode()
    before, found, _ = data.partition((at or "").encode()) if at else (b"", b"-", b"")
    assert found, f"{name}: {at!r} is not in the text"
    return Broken(name, data, None if at is None else before.count(b"\n") + 1, says, count)


def one(
    name: str,
    old: str,
    new: str,
    *says: str,
    at: str | None = "-",
    count: int = 1,
    base: str = BASE,
) -> Broken:
    assert base.count(old) == 1, f"{name}: {old!r} stands {base.count(old)} times in the base"
    return file(name, base.replace(old, new), *says, at=new if at == "-" else at, count=count)


CELL = """\
sphere = { material = "quartz", radius = "5 mm" }
rig = { kind = "load_cell" }
hammer = { shape = "ball", diameter = "25.4 mm", material = "bearing_steel", drop_height = "0.2 m" }
rod = { material = "hard_4340", diameter = "20 mm", length = "1.5 m", gauge = "0.2 m" }
limits = { one = { criterion = "specific_energy", energy_is = "contact", strength = "60 J/kg" } }
"""
SHAPE = 'shape = "trapezoid"\nrise = "25 us"\nfall = "25 us"'
RADIUS = 'radius = { dist = "normal", mean = "10 mm", sd = "0.15 mm", lower = "9 mm" }'
STRENGTH = 'strength = { dist = "weibull", mean = "4 GPa", modulus = 12 }'
SPEED = 'speed = { dist = "normal", mean = "0.5 m/s", cov = 0.02 }'
DEEP = "[" * 40 + "1" + "]" * 40

CASES = [
    # the file as such
    file("empty", b"", "neither a scene", "uqsphere new"),
    file("blanks alone", " \n\n\t\n", "neither a scene"),
    file("a comment alone", "# nothing\n", ":1: the study has neither a scene", "nor a black box"),
    file("bytes that are not text", b'title = "\xff\xfe"\n', "0xff is not UTF-8"),
    file("UTF-16", 'title = "x"'.encode("utf-16"), "0xff is not UTF-8", "save the file as UTF-8"),
    file("a NUL", 'title = "x"\nseed = \0 1\n', "NUL byte", at="seed"),
    file("brackets without end", f"seed = 1\nx = {DEEP}\n", 'unknown key "x"', at="x ="),
    file("tables without end", "x = " + "{a=" * 3000 + "1" + "}" * 3000, "nested"),
    file("dots without end", ".".join("a" * 5000) + " = 1\n", "dotted key", "12"),
    one(
        "strange keys of a table",
        "tolerance = 1e-6",
        '"m[0]" = 2\n"m[1]" = 3',
        'unknown key "m[0]"',
        at="[model]",
        count=2,
    ),
    file("an integer without end", "seed = " + "9" * 5000, "4300 digits"),
    # syntax
    one(
        "a quantity without quotes",
        'length = "0.8 m"',
        "length = 0.8 m",
        "not valid TOML",
        '"0.8 m"',
    ),
    one(
        "a word without quotes", 'shape = "trapezoid"', "shape = trapezoid", "quotes", '"trapezoid"'
    ),
    one("a key twice", "nu = 0.25", "nu = 0.25\nnu = 0.3", "written twice", at="nu = 0.3"),
    one("a table twice", "[pulse]", "[striker]", "striker twice; this is", at="[striker]\nshape"),
    one("lone returns", "[pulse]\n", "[pulse]\r", "save the file with line feeds", at="[pulse]"),
    one("a text without end", '"40 mm"', '"40 mm', "does not end on its line", at="diameter = "),
    # numbers that are none
    one("not a number", "nu = 0.25", "nu = nan", "sphere.nu", "nan is not a finite number"),
    one(
        "infinity in a table",
        "cov = 0.12",
        "cov = inf",
        "sphere.E.cov",
        "inf is not a finite number",
    ),
    one(
        "more than 64 bits",
        "seed = 7",
        "seed = 99999999999999999999",
        "must be less than 9223372036854775808",
    ),
    one(
        "a length without its unit",
        '"40 mm"',
        "40",
        "bars.diameter",
        "no unit",
        'such as "40 mm" (units: m',
    ),
    one("a length in SI without its unit", '"40 mm"', "0.04", 'such as "0.04 m" (units: m'),
    one(
        "a scatter without its unit",
        '"0.15 mm"',
        "0.15",
        "sphere.radius.sd",
        'such as "0.15 mm" (units: m',
        at="radius = {",
    ),
    one(
        "a density in grams without its unit",
        "nu = 0.25",
        "nu = 0.25\ndensity = 2.65",
        'such as "2.65 g/cm3" (units: kg/m3',
        at="density = 2.65",
    ),
    one(
        "a strength in SI without its unit",
        '"4 GPa"',
        "4000000000.0",
        "strength.mean: 4e9 has no unit",
        'such as "4e9 Pa"',
        at="strength = {",
    ),
    one(
        "a stiffness in MPa without its unit",
        '"52 GPa"',
        "52000.0",
        "sphere.E.mean: 52000 has",
        '"52000 MPa"',
        at="E = {",
    ),
    one(
        "a stiffness as text without its unit",
        'mean = "52 GPa"',
        'mean = "52"',
        "sphere.E.mean",
        'Write "52 GPa"',
    ),
    one(
        "a decimal comma", '"40 mm"', '"0,04 m"', "bars.diameter", "decimal comma", 'Write "0.04 m"'
    ),
    one("a unit of something else", '"40 mm"', '"40 GPa"', "unknown unit 'GPa' for a length", "mm"),
    one("a unit where none is due", "nu = 0.25", 'nu = "0.25 m"', "plain number", "the unit 'm'"),
    one("a boolean for a number", "nu = 0.25", "nu = true", "sphere.nu", "not true"),
    one(
        "an array for a number",
        '"40 mm"',
        '["40 mm"]',
        "bars.diameter: must be a",
        "not an array",
    ),
    one(
        "a date for a number",
        '"40 mm"',
        "1979-05-27",
        "bars.diameter: must be a number with a unit, not a date",
    ),
    one("a negative length", '"40 mm"', '"-40 mm"', 'must be above 0 mm, not "-40 mm"'),
    one("Poisson ratio of a half", "nu = 0.25", "nu = 0.5", "sphere.nu", "between -1 and 0.5"),
    one(
        "an end that is none",
        'incident_end = "free"',
        'incident_end = "fre"',
        "did you mean 'free'?",
    ),
    one(
        "an end beyond its range", 'incident_end = "free"', "incident_end = 1.5", "between -1 and 1"
    ),
    # keys and words
    one(
        "an unknown key",
        'length = "0.8 m"',
        'lenght = "0.8 m"',
        "unknown key",
        "did you mean 'length'?",
    ),
    one("an unknown table", "[model]", "[modle]", "unknown key", "did you mean 'model'?"),
    one(
        "an unknown material",
        '"granite"\nE',
        '"granit"\nE',
        "unknown material",
        "'granite'?",
        at='"granit"',
    ),
    one("a material of the other kind", '"maraging_steel"', '"basalt"', "is a material for sphere"),
    one("an unknown shape", SHAPE, 'shape = "square"', '"square"', "rectangular", at='"square"'),
    one(
        "a record that is not there",
        '[striker]\nspeed = { dist = "normal", mean = "0.5 m/s", cov = 0.02 }\n'
        'length = "0.8 m"\n\n[pulse]\n' + SHAPE,
        '[pulse]\nshape = "measured"\nfile = "p.csv"',
        'there is no file "p.csv" beside the study',
        at='"p.csv"',
    ),
    one(
        "a key of another shape",
        SHAPE,
        'rise = "1 us"',
        'is not a key of [pulse] with "rectangular"',
    ),
    one("a word for a flag", "tolerance = 1e-6", 'first_loading_only = "yes"', "true or false"),
    one(
        "two ends of the record",
        "tolerance = 1e-6",
        "first_loading_only = true\nwhole_record = true",
        "contradict each other. Remove one of them",
        at="whole_record",
    ),
    one(
        "an unknown fidelity",
        "tolerance = 1e-6",
        'fidelity = "fast"',
        "must be 'full', 'massless' or 'linear'",
    ),
    # distributions
    one(
        "a table without dist",
        '{ dist = "lognormal", mean',
        "{ mean",
        'needs a distribution or a file. Add, for example, dist = "normal"',
        at="E = {",
    ),
    one(
        "an unknown distribution",
        '"lognormal"',
        '"log-normal"',
        'unknown distribution "log-normal"',
        "'lognormal'?",
    ),
    one(
        "a key of another distribution",
        "cov = 0.12",
        "cov = 0.12, modulus = 3",
        "is not a parameter of the distribution lognormal",
        "sd",
        at="E = {",
    ),
    one("sd and cov", "cov = 0.12", 'cov = 0.12, sd = "1 GPa"', "sphere.E", at="E = {"),
    one("no scatter", "cov = 0.12", "cov = 0.0", "sphere.E.cov", "must be positive", at="E = {"),
    one(
        "a number in the wrong unit",
        'mean = "52 GPa"',
        'mean = "52 mm"',
        "sphere.E.mean",
        "unknown unit",
    ),
    one("truncation without mass", 'lower = "9 mm"', 'lower = "5 m"', "leaves no mass"),
    one(
        "bounds out of order",
        RADIUS,
        'radius = { dist = "uniform", lower = "9 mm", upper = "8 mm" }',
        "must be below upper",
    ),
    one(
        "a law of impossible values",
        "nu = 0.25",
        'nu = { dist = "uniform", lower = 0.1, upper = 0.6 }',
        "sphere.nu.upper",
        "between -1 and 0.5",
    ),
    one(
        "a law with an impossible mean",
        '"0.5 m/s", cov = 0.02',
        '"-0.5 m/s", cov = 0.02',
        "must be above 0",
    ),
    # what is missing
    one("no radius", RADIUS, "", "sphere.radius: radius is missing", at="[sphere]"),
    one(
        "no striker",
        f'[striker]\n{SPEED}\nlength = "0.8 m"',
        "",
        "requires a table [striker]. Add it",
        at="title",
    ),
    one("no stiffness", 'material = "maraging_steel"', "", "E is missing", at="[bars]", count=3),
    one("no length", 'receiving_length = "1.5 m"', "", "infinite = true", at="[bars]"),
    # numbers that do not go together
    one(
        "a sphere larger than its bar",
        '"40 mm"',
        '"19 mm"',
        "exceeds the bar diameter; bars.diameter must be at least 20 mm",
        at=RADIUS,
    ),
    one("a pulse longer than the round trip", '"0.8 m"', '"1.6 m"', "round trip", "absorbing"),
    one("a trapezoid without width", 'rise = "25 us"', 'rise = "900 us"', "exceeds the width"),
    one(
        "two peaks out of order",
        SHAPE,
        'shape = "two_peak"\nt1 = "90 us"\nlevel1 = 1\nt2 = "50 us"\nlevel2 = 1',
        "must come before the second",
        at='t2 = "50 us"',
    ),
    one(
        "a step without end",
        SHAPE,
        'shape = "step"',
        "longer than the round trip",
        "absorbing",
        count=2,
    ),
    # limits
    one("an unknown quantity", 'quantity = "p_max"', 'quantity = "pmax"', "did you mean 'p_max'?"),
    one("a strength in newton", STRENGTH, 'strength = "4 kN"', "unknown unit 'kN' for a pressure"),
    one("no strength", STRENGTH, "", "strength is missing", at="[limits.crushing]"),
    one("a target of one", "target = 0.01", "target = 1.0", "must be a fraction above 0"),
    one("a limit with a strange name", "[limits.crushing]", '[limits."a/b"]', "letters, digits"),
    # dependence
    one(
        "an unknown name",
        '"sphere.E", "limits',
        '"sphere.e", "limits',
        "did you mean 'sphere.E'?",
        at='of = ["sphere.e"',
    ),
    one(
        "a fixed number depends",
        '"sphere.E", "limits',
        '"sphere.nu", "limits',
        "is a fixed number",
        at='of = ["sphere.nu"',
    ),
    one("a perfect correlation", "spearman = 0.6", "spearman = 1.0", "must be less than 1"),
    one(
        "another copula",
        "spearman = 0.6",
        'spearman = 0.6\ncopula = "gausian"',
        "did you mean 'gaussian'?",
        at="copula",
    ),
    one(
        "two strengths",
        "spearman = 0.6",
        "spearman = 0.6\nkendall = 0.4",
        "spearman or kendall",
        at="kendall",
    ),
    one(
        "no strength of dependence",
        "spearman = 0.6",
        'copula = "gaussian"',
        "spearman or kendall",
        at="[[dependence]]",
    ),
    one(
        "a t copula without freedom",
        "spearman = 0.6",
        'spearman = 0.6\ncopula = "student_t"',
        "for example 4",
        at="[[dependence]]",
    ),
    one(
        "freedom of a stranger",
        "spearman = 0.6",
        "spearman = 0.6\ndof = 4.0",
        "is used only with copula",
        at="dof",
    ),
    one(
        "two copulas for one name",
        "spearman = 0.6",
        'spearman = 0.6\n[[dependence]]\nof = ["sphere.radius", "sphere.E"]\ncopula = '
        '"student_t"\ndof = '
        "4.0\nkendall = 0.2",
        "more than one dependence",
        at='of = ["sphere.radius',
    ),
    one(
        "a pair twice",
        "spearman = 0.6",
        (
            'spearman = 0.6\n[[dependence]]\nof = ["limits.crushing.strength", '
            '"sphere.E"]\nspearman '
            "= 0.2"
        ),
        "given twice",
        at='of = ["limits',
    ),
    one(
        "not positive definite",
        'of = ["sphere.E", "limits.crushing.strength"]\nspearman = 0.6',
        'of = ["sphere.E", "sphere.radius", "striker.speed"]\nspearman = -0.7',
        "not positive definite",
        at="spearman = -0.7",
    ),
    # analysis and margins
    one(
        "a measure of later",
        "quantiles = [0.05, 0.5]",
        'measures = ["active"]',
        "must be 'morris', 'delta' or 'pawn'",
    ),
    one("a quantile of two", "[0.05, 0.5]", "[0.05, 2]", "quantiles[1]", "must be a fraction"),
    one(
        "a budget of nothing",
        "quantiles = [0.05, 0.5]",
        "budget = { evaluations = 0 }",
        "must be greater than 0",
    ),
    one(
        "a tolerance of one",
        "tolerance = 1e-6",
        "tolerance = 1.0",
        "must be less than or equal to 0.01",
    ),
    one("a negative seed", "seed = 7", "seed = -7", "must be greater than or equal to 0"),
    one(
        "solve for a word", 'solve = "striker.speed"', 'solve = "striker.sped"', "'striker.speed'?"
    ),
    one(
        "between out of order",
        '["0.05 m/s", "20 m/s"]',
        '["20 m/s", "2 m/s"]',
        "must be [low, high], not",
    ),
    # several at once, and black boxes
    file(
        "three faults at once",
        BASE.replace("seed", "sead").replace('"40 mm"', "40").replace("0.6", "2"),
        "did you mean 'seed'?",
        at="sead",
        count=3,
    ),
    one(
        "a scene and a black box",
        "[model]",
        "[inputs]\nx = 1.0\n[model]",
        "describes a scene",
        at="[sphere]",
        count=5,
    ),
    file("a unit in a black box", BLACK_BOX.replace("2.0", '"2 mm"'), "plain number", at="x2"),
    file(
        "no outputs", BLACK_BOX.replace('names = ["y"]', ""), "names of the outputs", at="[outputs]"
    ),
    file("no inputs", '[outputs]\nnames = ["y"]\n', "[inputs] is missing"),
    file(
        "an output that is not one",
        BLACK_BOX + '[limits.g]\nquantity = "z"\nstrength = 0\n',
        'unknown quantity "z"',
        "known: y",
        at='quantity = "z"',
    ),
    # rigs
    file(
        "rig: gauges[0].position",
        CELL + 'gauges = [{ bar = "rod", position = {} }]',
        "6: gauges[0].position: must be a number with a unit, not a table",
        at=None,
    ),
    one(
        "rig: rod.gauge",
        'gauge = "0.2 m"',
        'gauge = "2 m"',
        "4: rod.gauge: the distance from the sphere must be at most 1.5 m",
        at=None,
        base=CELL,
    ),
    one(
        "rig: limits.one.energy_is",
        'energy_is = "contact", ',
        "",
        "5: limits.one.energy_is: energy_is is missing",
        at=None,
        base=CELL,
    ),
    one(
        "rig: hammer.drop_height",
        'drop_height = "0.2 m"',
        'drop_height = "0.2 m", speed = "1 m/s"',
        "3: hammer.drop_height: give only one of speed or drop_height",
        at=None,
        base=CELL,
    ),
    one(
        "rig: hammer.mass",
        'shape = "ball"',
        'shape = "ball", mass = "1 kg"',
        "3: hammer.mass: mass is not a key of [hammer]",
        at=None,
        base=CELL,
    ),
    one(
        "rig: anvil",
        'radius = "5 mm" }',
        'radius = "5 mm" }\nanvil = { material = "steel" }',
        "2: anvil: table [anvil] is used only with rig.kind",
        at=None,
        base=CELL,
    ),
    one(
        "rig: rod.length",
        'length = "1.5 m", ',
        "",
        "4: rod.length: length is missing",
        at=None,
        base=CELL,
    ),
    one(
        "rig: rod.thickness",
        'diameter = "20 mm", length',
        'thickness = "2 mm", diameter = "20 mm", length',
        "4: rod.thickness: unknown key",
        at=None,
        base=CELL,
    ),
    one(
        "rig: limits.one.strength",
        '"60 J/kg"',
        '"60 J"',
        "5: limits.one.strength: unknown unit",
        at=None,
        base=CELL,
    ),
    file(
        "rig: contact.hardness",
        CELL + 'contact = { law = "plastic", hardness = "1 GPa", onset_pressure = "2 GPa" }',
        "6: contact.hardness: ",
        at=None,
    ),
    # keys and values of earlier studies: refused once, with the way out
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_broken_study(case: Broken, tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_bytes(case.content)
    with pytest.raises(StudyError) as caught:
        load_study(path)
    error, first = caught.value, caught.value.problems[0]
    assert error.exit_code == 2
    assert case.line in (None, first.line), str(error)
    shown = str(error).splitlines()[0]
    assert shown.startswith(f"{path}:{first.line}: "), shown
    for words in case.says:
        assert words in shown, (words, shown)
    assert len(error.problems) == case.count, str(error)
    for jargon in (
        "pydantic",
        "https://",
        "Traceback",
        "Input should",
        "validation error",
        "type=",
        "None",
    ):
        assert jargon not in str(error), str(error)


def test_the_base_is_in_order(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    for text in (BASE, BLACK_BOX):
        path.write_text(text)
        assert load_study(path).warnings == ()


def test_a_key_of_the_kind_without_a_name_is_told_without_it(tmp_path: Path) -> None:
    text = BASE.replace(SHAPE, 'shape = "measured"\nfile = "p.csv"')
    with pytest.raises(StudyError) as caught:
        load_study(tmp_path / "study.toml", text=text)
    assert 'length is not a key of [striker] with "measured". Remove it' in str(caught.value)
