"""Every refusal has its own reason: a second cause at the same door is not told in its words.

A refusal of studies or tables that no case here or in test_broken reaches is found.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from test_broken import CASES
from test_doors import BOX, SCENE, table_of

import uqsphere
from uqsphere.documents import Fault
from uqsphere.errors import StudyError, UqsphereError
from uqsphere.study import load_study
from uqsphere.tables import TableError

PRESS = """
[sphere]
E = "70 GPa"
nu = 0.22
density = "2500 kg/m3"
radius = "5 mm"
[rig]
kind = "platens"
[platens]
material = "steel"
force = "500 N"
[limits.a]
quantity = "P_max"
strength = "1 kN"
"""
#: a scene with plain strengths, between bars
PLAIN = SCENE.replace(
    '{ file = "tests.csv", force = "force", diameter = "diameter", platens = "rigid" }', '"4 GPa"'
)
PRESET = PLAIN.replace('speed = "0.5 m/s"\nlength = "0.8 m"', 'speed = "0.5 m/s"')
FORCES = 'strength = { file = "tests.csv", force = "force", diameter = "diameter" }'
GRANITE = 'material = "granite"\nradius = "10 mm"'
ENERGY = (
    'criterion = "specific_energy"\nlargest_energy = "%s"\n'
    'strength = { file = "tests.csv", force = "force", diameter = "diameter", fit = "lognormal" }'
)
Change = tuple[str, str]


def of(base: str, old: str, new: str) -> str:
    """A base with one change."""
    assert base.count(old) == 1, (old, base.count(old))
    return base.replace(old, new)


def limit(text: str, base: str = PLAIN) -> str:
    """A base with another limit."""
    return base[: base.index("[limits.")] + f"[limits.a]\n{text}\n"


def from_tests(keys: str) -> str:
    """A scene whose strength is from tests, by other keys."""
    return limit(f'quantity = "p_max"\nstrength = {{ file = "tests.csv", {keys} }}')


FD = 'force = "force", diameter = "diameter"'
COLUMN = 'a = { file = "a.csv", column = "x" }'
NORMAL = 'a = { dist = "normal", mean = 0.0, sd = 1.0 }'
MEASURED = of(
    PRESET, 'speed = "0.5 m/s"', '[pulse]\nshape = "measured"\nfile = "pulse.csv"'
).replace("[striker]\n", "")

#: a study that is refused, its words, and a study that is refused at the same door otherwise
REASONS: dict[str, tuple[str, str, str]] = {
    # check
    "an output by the name of an input": (
        BOX.replace('["y"]', '["a"]'),
        '"a" is already the name of an input',
        BOX.replace('["y"]', '["y", "y"]'),
    ),
    "a range that no numbers span": (
        PLAIN + '[margins]\nsolve = "striker.speed"\nbetween = ["1e-200 m/s", "1e200 m/s"]\n',
        "too far apart for a range of numbers",
        PLAIN + '[margins]\nsolve = "striker.speed"\nbetween = ["1e200 m/s", "1e-200 m/s"]\n',
    ),
    "a preset of another shape": (
        PRESET + '[pulse]\npreset = "short"\nshape = "ramp"\n',
        "Remove shape or preset",
        PRESET + '[pulse]\nshape = "ramp"\n',
    ),
    "linear and plastic": (
        PLAIN + '[contact]\nlaw = "plastic"\n[model]\nfidelity = "linear"\n',
        'fidelity = "linear" requires contact.law = "hertz"',
        PLAIN + '[contact]\nlaw = "plastic"\n[model]\nfidelity = "line"\n',
    ),
    "a fidelity of bars": (
        PRESS + '[model]\nfidelity = "massless"\n',
        'supports only fidelity = "full"',
        PRESS + "[model]\nfirst_loading_only = true\n",
    ),
    "a displacement beyond the sphere": (
        of(PRESS, 'force = "500 N"', 'displacement = "6 mm"'),
        "must be below the sphere radius (5 mm)",
        of(PRESS, 'force = "500 N"', 'displacement = "-6 mm"'),
    ),
    "an insert between rigid bars": (
        of(PLAIN, 'diameter = "40 mm"', 'diameter = "40 mm"\nrigid_contact = true')
        + '[insert]\nmaterial = "steel"\n',
        "leaves inserts out of the contact stiffness",
        PLAIN + '[insert]\nmaterial = "stel"\n',
    ),
    "a striker's material for a half sine": (
        of(PLAIN, "[striker]", '[striker]\nE = "70 GPa"') + '[pulse]\nshape = "half_sine"\n',
        'set pulse.shape to "rectangular", "trapezoid" or "ramp"',
        of(PLAIN, "[striker]", '[striker]\nE = "70 mm"') + '[pulse]\nshape = "half_sine"\n',
    ),
    "a plastic law of nothing": (
        of(PRESS, 'material = "steel"', 'E = "200 GPa"\nnu = 0.3') + '[contact]\nlaw = "plastic"\n',
        "needs the pressure at which a contact yields",
        of(PRESS, 'material = "steel"', 'E = "200 GPa"\nnu = 0.3')
        + '[contact]\nlaw = "plastic"\nonset_pressure = "2 GPa"\nhardness = "1 GPa"\n',
    ),
    "margins without a limit": (
        PLAIN[: PLAIN.index("[limits.")]
        + '[margins]\nsolve = "striker.speed"\nbetween = ["1 m/s", "2 m/s"]\n',
        "[margins] requires a limit",
        PLAIN + '[margins]\nsolve = "striker.sped"\nbetween = ["1 m/s", "2 m/s"]\n',
    ),
    "a gauge on a bar that is not there": (
        PRESS + '[[gauges]]\nbar = "incident"\nposition = "0.1 m"\n',
        "the rig has no incident bar",
        PLAIN + '[[gauges]]\nbar = "incident"\nposition = "2 m"\n',
    ),
    "a quantity that is not there": (
        PLAIN + '[analysis]\nquantities = ["pmax"]\n',
        "unknown quantity",
        PLAIN + '[analysis]\nquantities = ["p_max", "p_max"]\n',
    ),
    "a mean that no law of the kind has": (
        of(
            PLAIN,
            '"0.5 m/s"',
            '{ dist = "beta", mean = "0.5 m/s", sd = "0.01 m/s", lower = "0.4 m/s", '
            'upper = "0.6 m/s" }',
        )
        + '[margins]\nsolve = "striker.speed"\nbetween = ["0.5 m/s", "5 m/s"]\n',
        "striker.speed has no distribution with this mean",
        PLAIN + '[margins]\nsolve = "striker.speed"\nbetween = ["0.5 mm", "5 m/s"]\n',
    ),
    # document
    "a quantity and a criterion": (
        limit('quantity = "p_max"\ncriterion = "core_tension"\nstrength = "4 GPa"'),
        "exactly one of quantity and criterion",
        limit('quantity = "pmax"\nstrength = "4 GPa"'),
    ),
    "an energy of a pressure": (
        limit('quantity = "p_max"\nenergy_is = "sphere"\nstrength = "4 GPa"'),
        "energy_is is used only with the criterion specific_energy",
        limit('criterion = "specific_energy"\nenergy_is = "ball"\nstrength = "4 J/kg"'),
    ),
    # limits
    "a limit without a name": (
        of(PLAIN, "[limits.crushing]", "[limits]"),
        'must be a table with a name, [limits.NAME], not "p_max"',
        of(PLAIN, "[limits.crushing]", "[[limits]]"),
    ),
    "a law beside a file": (
        BOX.replace(NORMAL, 'a = { dist = "weibull", file = "a.csv", column = "x" }'),
        'named by fit, such as fit = "weibull"), not "weibull"',
        BOX.replace(NORMAL, 'a = { dist = "weibull", column = "x" }'),
    ),
    "a quantity that breaks nothing": (
        limit('quantity = "rise_time"\nfracture = true\nstrength = "1 ms"'),
        "is not a fracture quantity",
        limit('quantity = "rise_time"\nfracture = "yes"\nstrength = "1 ms"'),
    ),
    "a criterion of a black box": (
        BOX + '[limits.a]\ncriterion = "core_tension"\nstrength = 1.0\n',
        "a criterion needs the impact model",
        BOX + '[limits.a]\nquantity = "z"\nstrength = 1.0\n',
    ),
    "a meaning of another strength": (
        limit('quantity = "P_max"\nstrength_is = "hertz"\nstrength = "4 kN"'),
        "strength_is is used only with p_max and first_peak",
        limit('quantity = "P_max"\nstrength_is = "Hertz"\nstrength = "4 kN"'),
    ),
    "a strength that is not said to be a pressure": (
        PLAIN + '[contact]\nlaw = "plastic"\n',
        "strength_is is missing",
        limit('quantity = "p_max"\nstrength_is = "force"\nstrength = "4 GPa"')
        + '[contact]\nlaw = "plastic"\n',
    ),
    "tests of a true pressure": (
        limit(f'quantity = "p_max"\nstrength_is = "pressure"\n{FORCES}')
        + '[contact]\nlaw = "plastic"\n',
        "forces at failure become pressures by Hertz",
        limit(f'quantity = "p_max"\n{FORCES}') + '[contact]\nlaw = "plastic"\n',
    ),
    "a first peak by Hertz": (
        limit('quantity = "first_peak"\nstrength_is = "hertz"\nstrength = "4 GPa"')
        + '[contact]\nlaw = "plastic"\n',
        "first_peak is a true pressure",
        limit('quantity = "first_peak"\nstrength = "4 GPa"') + '[contact]\nlaw = "plastic"\n',
    ),
    "tests of a time": (
        limit(f'quantity = "contact_duration"\n{FORCES}'),
        "forces at failure do not determine contact_duration",
        limit('quantity = "contact_duration"\nstrength = "4 GPa"'),
    ),
    "energies beyond their bound": (
        limit(ENERGY % "1 J/kg"),
        "some tests exceed the largest possible",
        limit(ENERGY % "1 J"),
    ),
    "a size that no law covers": (
        of(from_tests(f'{FD}, fit = "lognormal"'), '"10 mm"', '"20 mm"'),
        "no size law covers more than 50 %",
        of(from_tests(f'{FD}, fit = "lognorm"'), '"10 mm"', '"20 mm"'),
    ),
    "a parameter without a criterion": (
        limit('quantity = "p_max"\nreference_volume = "1 mm3"\nstrength = "4 GPa"'),
        "reference_volume is used only with a criterion",
        limit('quantity = "p_max"\nreference_volume = "1 mm"\nstrength = "4 GPa"'),
    ),
    "a parameter of another criterion": (
        limit('criterion = "core_tension"\nreference_volume = "1 mm3"\nstrength = "4 MPa"'),
        "reference_volume is not a key of the criterion core_tension",
        limit('criterion = "core_tension"\nreference_volume = 1.0\nstrength = "4 MPa"'),
    ),
    "a parameter that a criterion needs": (
        limit('criterion = "weakest_link_volume"\nmodulus = 8.0\nstrength = "4 MPa"'),
        "reference_volume is missing",
        limit('criterion = "weakest_link_volume"\nreference_volume = "1 mm3"\nstrength = "4 MPa"'),
    ),
    "a weakest link without a modulus": (
        limit('criterion = "weakest_link_volume"\nreference_volume = "1 mm3"\nstrength = "4 MPa"'),
        "modulus is missing",
        limit('criterion = "weakest_link_volume"\nmodulus = 8.0\nstrength = "4 MPa"'),
    ),
    "two moduli": (
        limit(
            'criterion = "weakest_link_volume"\nreference_volume = "1 mm3"\nmodulus = 8.0\n'
            'strength = { dist = "weibull", mean = "4 MPa", modulus = 12 }'
        ),
        "modulus must be that of the strength, 12, not 8",
        limit(
            'criterion = "weakest_link_volume"\nreference_volume = "1 mm3"\nmodulus = -8.0\n'
            'strength = { dist = "weibull", mean = "4 MPa", modulus = 12 }'
        ),
    ),
    "platens of nothing": (
        from_tests(f'{FD}, platens = "steal"'),
        'must be "bars", "rigid"',
        from_tests(f'{FD}, platens = {{ E = "200 mm", nu = 0.3 }}'),
    ),
    "platens that are bars, without bars": (
        limit(f'quantity = "P_max"\n{FORCES}', PRESS),
        "this rig has no bars",
        limit(f'quantity = "P_max"\n{FORCES}', PRESS).replace(
            '"diameter" }', '"diameter", platens = "bar" }'
        ),
    ),
    # values
    "a tab in the name of a file": (
        BOX.replace(NORMAL, 'a = { file = "a\\tb.csv", column = "x" }'),
        "has a control character",
        BOX.replace(NORMAL, 'a = { file = "ab.csv", column = "x" }'),
    ),
    "forces of a black box": (
        BOX.replace(NORMAL, f'a = {{ file = "tests.csv", {FD} }}'),
        "are used only for the strength of a limit",
        BOX.replace(NORMAL, 'a = { file = "tests.csv" }'),
    ),
    "one observation": (
        BOX.replace(NORMAL, COLUMN.replace("a.csv", "one.csv")),
        "the file has 1 observation; a fit needs at least two failures",
        BOX.replace(NORMAL, COLUMN.replace("a.csv", "equal.csv")),
    ),
    "tests that were all stopped": (
        from_tests(f'{FD}, censored = "stopped"'),
        "all 10 tests are right-censored",
        from_tests(f'{FD}, censored = "stop"'),
    ),
    "volts without a factor": (
        MEASURED.replace("pulse.csv", "volts.csv"),
        "factor, the strain of one volt, is missing",
        MEASURED.replace("pulse.csv", "volts.csv").replace(
            '"volts.csv"', '"volts.csv"\nfactor = -1.0'
        ),
    ),
    "a factor of a strain": (
        MEASURED.replace('"pulse.csv"', '"pulse.csv"\nfactor = 1.0'),
        "factor is used only with a column of volts",
        MEASURED.replace('"pulse.csv"', '"pulse.csv"\nunits = ["s", "V"]'),
    ),
    "one column of a record": (
        MEASURED.replace("pulse.csv", "one.csv"),
        "a column of time and one of strain or volts are required, not 1 column",
        MEASURED.replace("pulse.csv", "tests.csv"),
    ),
    "a record that turns back": (
        MEASURED.replace("pulse.csv", "back.csv"),
        "the time must increase",
        MEASURED.replace("pulse.csv", "flat.csv"),
    ),
    "a record without a pulse": (
        MEASURED.replace("pulse.csv", "flat.csv"),
        "To cut and mend a record, use uqsphere shpb records",
        MEASURED.replace("pulse.csv", "back.csv"),
    ),
    "a key of forces with a column": (
        BOX.replace(NORMAL, COLUMN.replace(" }", ', diameter = "x" }')),
        "diameter is not used with column",
        BOX.replace(NORMAL, COLUMN.replace(" }", ', diameters = "x" }')),
    ),
    "a file outside": (
        BOX.replace(NORMAL, COLUMN.replace("a.csv", "../a.csv")),
        "must be a relative path inside the study's folder",
        BOX.replace(NORMAL, COLUMN.replace("a.csv", "b.csv")),
    ),
    "an odd unit beside another fault": (
        PLAIN.replace('"10 mm"', '"30 mm"').replace('"0.5 m/s"', '"0.2 mm/s"'),
        "striker.speed: 0.0002 m/s is unusual",
        PLAIN.replace('"10 mm"', '"30 mm"'),
    ),
    "a link to the outside": (
        BOX.replace(NORMAL, COLUMN.replace("a.csv", "link.csv")),
        "is a link to a file outside the study's folder",
        BOX.replace(NORMAL, COLUMN.replace("a.csv", "../a.csv")),
    ),
    "a folder for a file": (
        BOX.replace(NORMAL, COLUMN.replace("a.csv", "folder")),
        '"folder" cannot be read as a file',
        BOX.replace(NORMAL, COLUMN.replace("a.csv", "folders")),
    ),
    "a fit that is unknown": (
        BOX.replace(NORMAL, COLUMN.replace(" }", ', fit = "weibul" }')),
        "unknown fit 'weibul'",
        BOX.replace(NORMAL, COLUMN.replace(" }", ", fit = 1 }")),
    ),
    "a discrete strength": (
        BOX + '[limits.a]\nquantity = "y"\nstrength = { dist = "discrete", values = [1, 2] }\n',
        "discrete is for inputs",
        BOX.replace(NORMAL, 'a = { dist = "discrete", values = [1, 1] }'),
    ),
    "forces without diameters": (
        from_tests('force = "force"'),
        "diameter is missing. Add it, for example",
        from_tests('force = "force", diameter = "D"'),
    ),
    "draws of another kind": (
        BOX.replace(NORMAL, 'a = { draws = "kinds.csv" }'),
        "is not lognormal or weibull",
        BOX.replace(NORMAL, 'a = { draws = "draws.csv" }'),
    ),
    "draws without a scale": (
        BOX.replace(NORMAL, 'a = { draws = "draws.csv" }'),
        "scale and shape must be above 0",
        BOX.replace(NORMAL, 'a = { draws = "kinds.csv" }'),
    ),
    "draws with a law of size": (
        f'{BOX}[limits.a]\nquantity = "y"\nstrength = {{ draws = "sized.csv" }}\n',
        "a black box has no sphere. Remove the column size_exponent",
        f'{BOX}[limits.a]\nquantity = "y"\nstrength = {{ draws = "draws.csv" }}\n',
    ),
    "a force of nothing": (
        from_tests('force = "zero", diameter = "diameter"'),
        "the force must be above 0",
        from_tests('force = "word", diameter = "diameter"'),
    ),
    "half a test": (
        from_tests(f'{FD}, count = "half"'),
        "count must be a positive integer",
        from_tests(f'{FD}, count = "word"'),
    ),
    "tests without end": (
        from_tests(f'{FD}, count = "many"'),
        "at most two million tests are allowed",
        from_tests(f'{FD}, count = "half"'),
    ),
}
FILES = {
    "tests.csv": "\n".join(
        [
            "force [kN],diameter [mm],stopped,zero [kN],word [kN],half,many",
            *(f"{row},1,0,x,0.5,1000000" for row in table_of()[1:]),
        ]
    ),
    "a.csv": "x\n1\n2\n3\n4\n",
    "one.csv": "x\n1\n",
    "equal.csv": "x\n1\n1\n1\n",
    "pulse.csv": "t [s],e [1]\n"
    + "".join(f"{k}e-6,{min(k, 60 - k, 20) * 1e-5}\n" for k in range(61)),
    "volts.csv": "t [s],e [V]\n0,0\n1e-6,1\n2e-6,1\n3e-6,0\n",
    "back.csv": "t [s],e [1]\n0,0\n2e-6,1e-4\n1e-6,1e-4\n3e-6,0\n",
    "flat.csv": "t [s],e [1]\n0,0\n1e-6,0\n2e-6,0\n3e-6,0\n",
    "draws.csv": "distribution,scale,shape\nweibull,-1,2\n",
    "kinds.csv": "distribution,scale,shape\nnormal,1,2\n",
    "sized.csv": "distribution,scale,shape,diameter_mm,size_exponent\nweibull,1,8,20,1.5\n",
}


def written(folder: Path) -> Path:
    for name, text in FILES.items():
        (folder / name).write_text(text + "\n")
    (folder / "folder").mkdir(exist_ok=True)
    (folder / "link.csv").unlink(missing_ok=True)
    (folder / "link.csv").symlink_to(__file__)
    return folder / "study.toml"


def refusal_of(path: Path, text: str) -> str:
    with pytest.raises(StudyError) as caught:
        load_study(path, text=text)
    return str(caught.value)


@pytest.mark.parametrize("name", REASONS)
def test_another_cause_is_not_told_in_the_same_words(tmp_path: Path, name: str) -> None:
    text, words, other = REASONS[name]
    path = written(tmp_path)
    assert words in refusal_of(path, text)
    assert words not in refusal_of(path, other)


# --- tables ---------------------------------------------------------------------------------------

HEAD = "force [kN],diameter [mm]"
FROM = of(from_tests(f'{FD}, platens = "rigid"'), "[sphere]", "[sphere]")
ROWS = table_of()[1:]


def lines(*rows: str, head: str = HEAD) -> bytes:
    return "\n".join([head, *rows, *ROWS]).encode()


def book(*rows: list[Any], path: str = "book.xlsx") -> Callable[[Path], bytes]:
    """A workbook of these rows on its first sheet."""

    def made(folder: Path) -> bytes:
        from openpyxl import Workbook

        workbook = Workbook()
        workbook.active.title = "First"
        for row in rows:
            workbook.active.append(row)
        workbook.save(folder / path)
        return (folder / path).read_bytes()

    return made


def keys(*more: str) -> str:
    """The study with more keys of the file."""
    return FROM.replace('platens = "rigid"', ", ".join(['platens = "rigid"', *more]))


#: a study and its table, the words that refuse it, and another study or table that is refused
TABLES: dict[str, tuple[str, Any, str, str, Any]] = {
    "empty": (FROM, b"", "is empty", FROM, HEAD.encode()),
    "headings alone": (FROM, HEAD.encode(), "has no row below its headings", FROM, b""),
    "a cell more": (
        FROM,
        lines("6.1,20,7"),
        "more cells than headings",
        FROM,
        lines("6.1"),
    ),
    "columns without end": (
        FROM,
        ",".join(f"c{k}" for k in range(2_001)).encode() + b"\n1,2\n",
        "2,000 are read at most",
        FROM,
        ",".join(f"c{k}" for k in range(3)).encode() + b"\n1,2\n",
    ),
    "no text": (FROM, b"\0\1" * 50, "is not a text file", FROM, b"\xff" * 50),
    "an unknown unit of a name": (
        FROM,
        lines(head="force [KN],diameter [mm]"),
        "'KN' is not a unit of this column",
        FROM,
        lines(head="forces [KN],diameter [mm]"),
    ),
    "a compound unit": (
        keys().replace('"diameter"', '"stress"'),
        lines(head="force [kN],stress N/mm"),
        "'stress N/mm': 'N/mm' is not a unit of this column",
        keys().replace('"diameter"', '"stress N"'),
        lines(head="force [kN],stress N/mm"),
    ),
    "a unit that contradicts another dimension": (
        keys('force_unit = "kN"'),
        lines(head="force [mm],diameter [mm]"),
        "'force [mm]': 'mm' is not a unit of this column",
        keys('force_unit = "N"'),
        lines(),
    ),
    "an unknown unit of a key": (
        keys('force_unit = "KN"'),
        lines(head="force,diameter [mm]"),
        "force_unit must be one of",
        keys("force_unit = 1"),
        lines(head="force,diameter [mm]"),
    ),
    "two units": (
        keys('force_unit = "N"'),
        lines(),
        "force_unit is 'N', but the heading 'force [kN]' has 'kN'",
        keys('force_unit = "lbs"'),
        lines(),
    ),
    "no unit": (
        FROM,
        lines(head="force,diameter [mm]"),
        "the unit of the column 'force' is missing",
        FROM,
        lines(head="force [lbs],diameter [mm]"),
    ),
    "a file without end": (
        FROM,
        lines(*["1"] * (17 << 20)),
        "is larger than 32 MiB",
        FROM,
        lines("1" * 200_000),
    ),
    "a line without end": (
        FROM,
        lines("1" * 200_000),
        "100,000 are read at most",
        FROM,
        lines("1" * 20_000),
    ),
    "a sheet of a text": (
        keys('sheet = "First"'),
        lines(),
        "sheet belongs to workbooks",
        keys('sheets = "First"'),
        lines(),
    ),
    "a text over lines": (
        FROM,
        lines('"6.1', '",20'),
        "a text in quotes extends over several lines",
        FROM,
        lines('"6.1",20x'),
    ),
    "a sheet that is not there": (
        keys('sheet = "Second"'),
        book(HEAD.split(","), [6.1, 20]),
        "there is no sheet 'Second'",
        keys('sheet = "First"'),
        book(HEAD.split(",")),
    ),
    "a workbook that is none": (
        FROM,
        b"PK\x03\x04" + b"\0" * 99,
        "cannot be read as .xlsx",
        FROM,
        b"\0" * 99,
    ),
    "a column that is not there": (
        FROM.replace('"force"', '"load"'),
        lines(),
        "the column 'load' is not in",
        FROM,
        lines(head="force [kN],force [kN]"),
    ),
    "a column twice": (
        FROM,
        lines(head="force [kN],force [N]"),
        "is twice or more in",
        FROM,
        lines(head="forces [kN],diameter [mm]"),
    ),
    "numbers above": (
        FROM,
        "\n".join(ROWS).encode(),
        "the first row holds numbers",
        FROM,
        lines(head="loads,sizes"),
    ),
    "bars between columns": (
        FROM,
        "\n".join([HEAD, *ROWS]).replace(",", "|").encode(),
        "divide columns by commas, semicolons or tabs",
        FROM,
        lines(head="loads,sizes"),
    ),
    "an empty cell": (FROM, lines(",20"), "an empty cell", FROM, lines("x,20")),
    "a word": (FROM, lines("x,20"), "'x' is not a number", FROM, lines(",20")),
    "an error of a spreadsheet": (
        FROM,
        lines("#DIV/0!,20"),
        "line 2: force: '#DIV/0!' is not a number",
        FROM,
        lines("# broken,20", "x,20"),
    ),
    "a number without a square": (
        FROM,
        lines("1e200,20"),
        "a number is too large",
        FROM,
        lines("1e2000x,20"),
    ),
    "a summary": (FROM, lines("mean,20"), "this is a summary row", FROM, lines("meant,20")),
    "headings twice": (
        FROM,
        lines(*ROWS, HEAD),
        "the headings are repeated",
        FROM,
        lines(*ROWS, "force,20"),
    ),
    "a thousand": (FROM, lines('"1,234.5",20'), "a mark of thousands", FROM, lines('"1,2,3",20')),
    "a formula": (
        FROM,
        book(HEAD.split(","), *[["=6*1", 20]] * 3),
        "a formula without a stored value",
        FROM,
        book(HEAD.split(","), *[[None, 20]] * 3),
    ),
    "a flag": (
        keys('censored = "stopped"'),
        b"force [kN],diameter [mm],stopped\n6,20,2\n7,20,0\n8,20,0\n",
        "0 or 1 (1: stopped)",
        keys('censored = "stop"'),
        b"force [kN],diameter [mm],stopped\n6,20,2\n7,20,0\n8,20,0\n",
    ),
}


def refused_with(folder: Path, text: str, content: Any) -> str:
    if callable(content):
        content = content(folder)
    (folder / "tests.csv").write_bytes(content)
    return refusal_of(folder / "study.toml", text)


@pytest.mark.parametrize("name", TABLES)
def test_another_cause_in_a_table_is_not_told_in_the_same_words(tmp_path: Path, name: str) -> None:
    text, content, words, other_text, other_content = TABLES[name]
    assert words in refused_with(tmp_path, text, content)
    assert words not in refused_with(tmp_path, other_text, other_content)


def calls_of(path: Path) -> dict[tuple[str, int], int]:
    """Where a file makes refusals: its name and the first line of each, and the last one."""
    found = {}
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("Fault", "TableError"):
            found[path.name, node.lineno] = node.end_lineno or node.lineno
    return found


#: refusals that tests/study/test_strength.py and test_doors.py reach by larger files
ELSEWHERE = (
    "is insensitive to the force",
    "did not converge",
    "MiB; at most",
    "cells. Save the sheet as CSV",
    '"; ".join',
    "notes = [Fault(",  # of cautions, which refuse nothing
)


@pytest.mark.slow
def test_every_refusal_of_studies_and_tables_has_a_case(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A new refusal needs a case, and another cause."""
    made: set[tuple[str, int]] = set()

    def record(kind: type[Exception]) -> None:
        original = kind.__init__

        def noted(self: Any, *arguments: Any, **keys: Any) -> None:
            caller: FrameType = sys._getframe(1)
            made.add((Path(caller.f_code.co_filename).name, caller.f_lineno))
            original(self, *arguments, **keys)

        monkeypatch.setattr(kind, "__init__", noted)

    record(Fault)
    record(TableError)
    path = written(tmp_path)
    for case in CASES:
        path.write_bytes(case.content)
        with pytest.raises(UqsphereError):
            load_study(path)
    for text, _, other in REASONS.values():
        refusal_of(path, text)
        refusal_of(path, other)
    for text, content, _, other, other_content in TABLES.values():
        refused_with(tmp_path, text, content)
        refused_with(tmp_path, other, other_content)
    package = Path(uqsphere.__file__).parent
    for file in (*package.glob("study/*.py"), package / "tables.py"):
        source = file.read_text().splitlines()
        for (name, first), last in calls_of(file).items():
            if not any(word in "".join(source[first - 1 : last]) for word in ELSEWHERE):
                assert any(n == name and first <= line <= last for n, line in made), (name, first)
