"""Every key of a study does something: each declared key is changed, and what a user sees changes.

Numbers and words of the scene are tried by one row and its checks; the others by whole runs.  A new
key without a case here fails `test_every_declared_key_has_a_case`.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import uqsphere
from uqsphere import Study
from uqsphere.documents import table_in
from uqsphere.mechanics.rigs import RIGS
from uqsphere.models.scene import absent_quantity, checked_rows
from uqsphere.propagation import run
from uqsphere.quantities import OUTPUTS
from uqsphere.report.history import history_rows
from uqsphere.study import load_study
from uqsphere.study.document import SCENE, Document
from uqsphere.study.values import numbers_of

pytestmark = pytest.mark.slow

_LAW = ("onset_pressure", "hardness", "pile_up")
SPHERE = """
[sphere]
E = "50 GPa"
nu = 0.25
density = "2600 kg/m3"
radius = "10 mm"
onset_pressure = "2 GPa"
hardness = "4 GPa"
[contact]
law = "plastic"
"""
STEEL = 'E = "200 GPa"\nnu = 0.3\ndensity = "7800 kg/m3"\n'
YIELDING = STEEL + 'onset_pressure = "1.5 GPa"\nhardness = "3 GPa"\npile_up = 1.1\n'
STRIKER = '[striker]\nspeed = "2 m/s"\nlength = "0.3 m"\n'
BARS = (
    SPHERE
    + "[bars]\n"
    + YIELDING
    + 'diameter = "40 mm"\nend_radius = "0.2 m"\nyield_strength = "500 MPa"\n'
    + 'incident_length = "1 m"\nreceiving_length = "0.5 m"\n'
    + "incident_end = 0.5\nreceiving_end = 0.5\n"
)
IMPACT = SPHERE + '[rig]\nkind = "impact"\nspeed = "5 m/s"\nangle = "70 deg"\n[target]\n' + YIELDING
DROP = (
    SPHERE
    + '[rig]\nkind = "drop_weight"\n'
    + "[hammer]\n"
    + YIELDING
    + 'mass = "0.3 kg"\nspeed = "3 m/s"\nface_radius = "0.1 m"\nyield_strength = "500 MPa"\n'
    + "[anvil]\n"
    + YIELDING
)
ROD = '[rod]\n%sdiameter = "20 mm"\nlength = "0.2 m"\nend = 0.5\nyield_strength = "500 MPa"\n'
STRUCK = {
    "thick": 'kind = "thick"\nyield_strength = "500 MPa"\nface_radius = "0.1 m"\n',
    "plate": 'kind = "plate"\nthickness = "8 mm"\nwidth = "40 mm"\n',
    "bar": 'kind = "bar"\ndiameter = "30 mm"\nlength = "0.1 m"\nend = 0.5\n',
    "mass": 'kind = "mass"\nmass = "0.5 kg"\n',
}
BASES = {
    "bars": BARS + STRIKER + '[pulse]\nshape = "trapezoid"\nrise = "20 us"\nfall = "20 us"\n',
    "half sine": BARS + STRIKER + '[pulse]\nshape = "half_sine"\nduration = "100 us"\n',
    "two peaks": BARS
    + '[striker]\nspeed = "2 m/s"\n[pulse]\nshape = "two_peak"\nduration = "90 us"\n'
    + 't1 = "20 us"\nlevel1 = 1.0\nt2 = "60 us"\nlevel2 = 0.8\nvalley = 0.4\n',
    "striker of another kind": BARS
    + STRIKER
    + 'E = "70 GPa"\ndensity = "2700 kg/m3"\ndiameter = "30 mm"\n',
    "impact, fall": IMPACT.replace('speed = "5 m/s"', 'drop_height = "1 m"') + STRUCK["thick"],
    **{f"impact, {kind}": IMPACT + keys for kind, keys in STRUCK.items()},
    **{f"drop weight, {kind}": DROP + keys for kind, keys in STRUCK.items()},
    "drop weight, fall": DROP.replace('speed = "3 m/s"', 'drop_height = "0.5 m"'),
    "hammer, ball": SPHERE
    + '[rig]\nkind = "drop_weight"\n[hammer]\nshape = "ball"\ndiameter = "25 mm"\n'
    + 'speed = "3 m/s"\n'
    + STEEL
    + "[anvil]\n"
    + STEEL,
    "two spheres": SPHERE
    + '[rig]\nkind = "sphere_on_sphere"\nspeed = "5 m/s"\n[other]\nradius = "8 mm"\n'
    + 'yield_strength = "500 MPa"\n'
    + YIELDING,
    "load cell": SPHERE
    + '[rig]\nkind = "load_cell"\n[hammer]\nspeed = "2 m/s"\nmass = "0.1 kg"\n'
    + STEEL
    + ROD % YIELDING,
    "platens": SPHERE
    + '[rig]\nkind = "platens"\n[platens]\nforce = "12 kN"\nloading_rate = "5 kN/s"\n'
    + 'yield_strength = "500 MPa"\n'
    + YIELDING,
    "platens by displacement": SPHERE
    + '[rig]\nkind = "platens"\n[platens]\ndisplacement = "0.1 mm"\nspeed = "1 mm/s"\n'
    + 'machine_stiffness = "50 MN/m"\n'
    + STEEL,
    "insert": BARS
    + STRIKER
    + '[insert]\nE = "400 GPa"\nnu = 0.2\nthickness = "5 mm"\nyield_strength = "2 GPa"\n',
    "contact": SPHERE.replace('onset_pressure = "2 GPa"\nhardness = "4 GPa"\n', "")
    + 'onset_pressure = "1 GPa"\nhardness = "2 GPa"\npile_up = 1.1\n'
    + "[bars]\n"
    + STEEL
    + 'diameter = "40 mm"\nincident_length = "1 m"\nreceiving_length = "1 m"\n'
    + STRIKER,
}


for _name, _text in list(BASES.items()):
    if "yield_strength" in _text:  # by which an elastic face is judged
        _lines = [line for line in _text.splitlines() if not line.startswith(_LAW)]
        BASES[f"{_name}, elastic"] = "\n".join(_lines).replace("plastic", "hertz")
#: keys of the scene by the path of their number
PATHS = {
    quantity.name: (table, key) for table in SCENE for key, quantity in numbers_of(table).items()
}


def declared_keys() -> set[str]:
    keys = set()
    for name, entry in Document.model_fields.items():
        table = table_in(entry.annotation)
        if table is None:
            keys.add(name)
        else:
            keys |= {f"{name}.{key}" for key in table.model_fields}
    return keys


# --- numbers of the scene: one row ----------------------------------------------------------------


def row_effects(study: Study, changes: dict[str, float]) -> tuple[Any, ...]:
    """All quantities of a row, and the words of its checks."""
    quantities = tuple(name for name in OUTPUTS if not absent_quantity(study, name))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        frame = uqsphere.evaluate(study, changes, quantities=quantities)
    rows = np.array([list(changes.values())]).reshape(1, len(changes))
    checks = checked_rows(study, tuple(changes), rows, quantities)
    return tuple(map(str, frame.iloc[0])), tuple(str(check) for check in checks)


def effective_numbers(base: str, paths: set[str]) -> set[str]:
    """Those numbers of a base, of some, that change an answer or a check."""
    study = load_study(text=BASES[base])
    tried = [path for path in study.fixed if path in paths]
    before = row_effects(study, {})
    return {path for path in tried if row_effects(study, {path: 0.8 * study.fixed[path]}) != before}


#: a press is slow: nothing of its inertia matters, but a body is written with its density
IDLE = {"platens.density"}
#: a number of a measured pulse; tried by a whole run
FROM_FILE = {"pulse.gain"}


def test_every_number_of_a_scene_changes_an_answer_or_a_check() -> None:
    effective: set[str] = set()
    for base in BASES:
        effective |= effective_numbers(base, set(PATHS) - effective)
    assert set(PATHS) - effective == IDLE | FROM_FILE


# --- words and tables: whole runs -----------------------------------------------------------------

LOOSE = "analysis.accuracy={ mean = 1, quantile = 1, sobol = 1, probability = 1 }"
#: evaluations of a shipped study: every kind of answer has its rows
FEW = "analysis.budget.evaluations=1000"
BOUND = ('analysis.on_failure="bound"',)
BOX = """
[inputs]
a = { dist = "normal", mean = 1.0, sd = 0.1 }
b = { dist = "normal", mean = 1.0, sd = 0.1 }
c = { dist = "normal", mean = 1.0, sd = 0.1 }
d = 2.0
[outputs]
names = ["y", "z"]
[limits.x]
quantity = "y"
strength = 3.0
target = 0.1
"""
MEASURED = (
    BARS
    + '[pulse]\nshape = "measured"\nfile = "pulse.csv"\ngain = 1.0\nfactor = 0.001\n'
    + 'columns = ["t", "a"]\nunits = ["us", "V"]\n'
)
WAVE = [np.sin(np.pi * t / 100) for t in range(101)]
PULSE = "t,a,b\n" + "".join(f"{t},{x:.5f},{x * x:.5f}\n" for t, x in enumerate(WAVE))
LIMIT = '[limits.x]\ncriterion = "%s"\nstrength = "20 MPa"\ntarget = 0.1\n'
TEXTS = {
    **BASES,
    "box": BOX,
    "failing": BOX,
    "slow": BOX + "[analysis]\nbudget = { evaluations = 64 }\n",
    "tied": BOX + '[[dependence]]\nof = ["a", "b"]\nkendall = 0.5\n',
    "measured": MEASURED,
    "workbook": MEASURED.replace("pulse.csv", "pulse.xlsx"),
    "gauges": BASES["bars"] + '[[gauges]]\nbar = "incident"\nposition = "0.3 m"\n',
    "trapezoid": BASES["bars"].replace(
        "[bars]", '[model]\nhorizon = "300 us"\n[bars]\ninfinite = true'
    ),
    "preset": BARS + '[striker]\nspeed = "2 m/s"\n[pulse]\npreset = "very_short"\n',
    "limit": BASES["bars"] + '[limits.x]\nquantity = "p_max"\nstrength = "2 GPa"\n'
    'strength_is = "pressure"\ntarget = 0.1\n',
    "core tension": BASES["bars"] + LIMIT % "core_tension",
    "weakest link": BASES["bars"]
    + LIMIT % "weakest_link_volume"
    + 'modulus = 8\nreference_volume = "100 mm3"\n',
    "weakest link of the surface": BASES["bars"]
    + LIMIT % "weakest_link_surface"
    + 'modulus = 8\nreference_area = "100 mm2"\n',
    "energy": BASES["impact, thick"]
    + '[limits.x]\ncriterion = "specific_energy"\nenergy_is = "contact"\ntarget = 0.1\n'
    + 'strength = { dist = "lognormal", mean = "50 J/kg", cov = 0.4 }\n'
    + 'largest_energy = "80 J/kg"\n',
    "striker": BARS + STRIKER + 'material = "steel"\n',
    "platens' material": SPHERE
    + '[rig]\nkind = "platens"\n[platens]\nforce = "12 kN"\nmaterial = "steel"\n',
    "insert's material": BARS + STRIKER + '[insert]\nmaterial = "steel"\nthickness = "5 mm"\n',
    "chute": SPHERE
    + '[rig]\nkind = "impact"\nspeed = "5 m/s"\n'
    + '[target]\nkind = "plate"\nmaterial = "steel"\nthickness = "12 mm"\n',
    "other's material": SPHERE
    + '[rig]\nkind = "sphere_on_sphere"\nspeed = "5 m/s"\n'
    + '[other]\nmaterial = "limestone"\nradius = "8 mm"\n',
}


def model(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {"y": x["a"] * x["b"] * x["d"] + x["c"], "z": x["a"] ** 2}


def model_that_fails(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    answers = model(x)
    return {name: np.where(x["a"] > 1.25, np.nan, values) for name, values in answers.items()}


SLOW = """
import time
def model(x):
    y = x["a"] * x["b"] * x["d"] + x["c"]
    if (x["a"] > 1.1).any():
        time.sleep(1.0)
    return {"y": y, "z": x["a"] ** 2}
"""


def run_effects(study: Study, name: str) -> dict[str, Any]:
    """What a user sees of a run, without the words of the study itself."""
    boxes: dict[str, Any] = {"failing": model_that_fails}
    if name == "slow":
        boxes["slow"] = str(study.path.with_name("model.py")) + ":model"
    box = boxes.get(name, model) if study.black_box else None
    results = run(study, box, threads=2).results
    rows: list[Any] = []
    if not study.black_box and not RIGS[study.rig].by_press:
        history = uqsphere.history(study)
        rows = [[*history_rows(history)], history.to_frame().sum().to_dict()]
        rows += [(gauge.name, float(np.abs(gauge.strain).sum())) for gauge in history.gauges]
    return {
        "answers": results.answers,
        "checks": results.checks,
        "decisions": results.decisions,
        "history": rows,
        "title": results.study.title,
        "warnings": results.study.warnings,
    }


@cache
def effects(name: str, settings: tuple[str, ...], folder: Path) -> str:
    """What a user sees of a study of `TEXTS`, or of a shipped one, with some settings."""
    path, text = Path("studies") / f"{name}.toml", None
    common = (LOOSE, FEW)
    if name in TEXTS:
        path, text, common = folder / "study.toml", TEXTS[name], (LOOSE,)
    return repr(run_effects(load_study(path, (*common, *settings), text=text), name))


@dataclass(frozen=True, kw_only=True)
class Case:
    """A key, and a change of it; `before` is set without the change as well."""

    key: str
    study: str
    change: tuple[str, ...]
    before: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.study}: {self.change[0]}"


CASES: list[Case] = []


def case(key: str, study: str, *change: str, before: tuple[str, ...] = ()) -> None:
    CASES.append(Case(key=key, study=study, change=change, before=before))


case("title", "granite", "title=Another title")
case("seed", "granite", "seed=1")
case("sphere.material", "granite", "sphere.material=limestone")
case("bars.material", "granite", "bars.material=aluminium")
case("bars.infinite", "granite", "bars.infinite=true")
case("bars.rigid_contact", "granite", "bars.rigid_contact=true")
case("striker.material", "striker", "striker.material=aluminium")
case("insert.material", "insert's material", "insert.material=aluminium")
case("platens.material", "platens' material", "platens.material=aluminium")
case("other.material", "other's material", "other.material=basalt")
case("target.material", "chute", "target.material=aluminium")
case("hammer.material", "limestone_drop_weight", "hammer.material=aluminium")
case("anvil.material", "limestone_drop_weight", "anvil.material=aluminium")
case("rod.material", "quartz_load_cell", "rod.material=aluminium")
case("rod.gauge", "quartz_load_cell", "rod.gauge=0.3 m")
case("gauges.position", "gauges", "gauges=[{ bar = 'incident', position = '0.4 m' }]")
case("gauges.bar", "gauges", "gauges=[{ bar = 'receiving', position = '0.3 m' }]")
for kind, sizes in {
    "thick": "",
    "plate": ", thickness = '9 mm'",
    "bar": ", diameter = '30 mm', length = '1 m'",
    "mass": ", mass = '1 kg'",
}.items():
    body = f"{{ kind = '{kind}', material = 'steel'{sizes} }}"
    case("target.kind", "chute", f"target={body}")
    if kind in ("plate", "mass"):
        case("anvil.kind", "limestone_drop_weight", f"anvil={body}")
case(
    "hammer.shape",
    "quartz_load_cell",
    "hammer={ mass = '0.06 kg', material = 'bearing_steel', drop_height = '0.2 m' }",
)
for shape in ("rectangular", "half_sine", "ramp", "step"):
    keys = ", rise = '20 us'" if shape == "ramp" else ""
    case("pulse.shape", "trapezoid", f"pulse={{ shape = '{shape}'{keys} }}")
case("pulse.preset", "preset", "pulse={ preset = 'short' }")
case("pulse.file", "measured", "pulse.file=other.csv")
case("pulse.sheet", "workbook", "pulse.sheet=second")
case("pulse.columns", "measured", 'pulse.columns=["t", "b"]')
case("pulse.units", "measured", 'pulse.units=["us", "mV"]')
case("pulse.factor", "measured", "pulse.factor=0.002")
case("pulse.gain", "measured", "pulse.gain=1.2")
case("contact.law", "granite", "contact.law=hertz", before=("sphere.onset_pressure=1 GPa",))
case("model.fidelity", "as_printed", "model.fidelity=massless")
case("model.fidelity", "as_printed", "model.fidelity=linear")
case("model.tolerance", "granite", "model.tolerance=1e-5")
case("model.first_loading_only", "granite", "model.first_loading_only=true")
case("model.whole_record", "gauges", "model.whole_record=true")
case("model.horizon", "granite", "model.horizon=200 us")
case("model.compare_with_paper", "as_printed", "model.compare_with_paper=false")
case("limits.quantity", "box", "limits.x.quantity=z")
case("limits.criterion", "core tension", "limits.x.criterion=centre_tension")
case("limits.strength", "limit", "limits.x.strength=2.1 GPa")
case("limits.strength_is", "granite", "limits.crushing.strength_is=pressure")
case("limits.aim", "granite", "limits.crushing.aim=break")
case("limits.target", "granite", "limits.crushing.target=0.2")
case("limits.model_factor", "granite", "limits.crushing.model_factor=1.1")
case("limits.fracture", "granite", "limits.crushing.fracture=false")
case("limits.energy_is", "energy", "limits.x.energy_is=sphere")
case("limits.energy_is", "energy", "limits.x.energy_is=input")
case("limits.largest_energy", "energy", "limits.x.largest_energy=60 J/kg")
case("limits.modulus", "weakest link", "limits.x.modulus=10")
case("limits.reference_volume", "weakest link", "limits.x.reference_volume=50 mm3")
case("limits.reference_area", "weakest link of the surface", "limits.x.reference_area=50 mm2")
case("limits.rate_0", "core tension", "limits.x.rate_0=50 1/s")
case("dependence.of", "tied", "dependence=[{ of = ['a', 'c'], kendall = 0.5 }]")
case("dependence.kendall", "tied", "dependence=[{ of = ['a', 'b'], kendall = 0.1 }]")
case("dependence.spearman", "tied", "dependence=[{ of = ['a', 'b'], spearman = 0.5 }]")
for dof in (3, 30):
    tie = f"{{ of = ['a', 'b'], kendall = 0.5, copula = 'student_t', dof = {dof} }}"
    case("dependence.dof" if dof == 3 else "dependence.copula", "tied", f"dependence=[{tie}]")
case("inputs", "box", "inputs.d=3.0")
case("outputs.names", "box", 'outputs.names=["y"]')
case("analysis.quantities", "granite", 'analysis.quantities=["p_max"]')
case("analysis.accuracy", "box", "analysis.accuracy.quantile=1e-3")
case("analysis.budget", "granite", "analysis.budget.evaluations=3000")
case("analysis.quantiles", "box", "analysis.quantiles=[0.5]")
for measure in ("morris", "delta", "pawn"):
    case("analysis.measures", "box", f'analysis.measures=["{measure}"]')
case("analysis.second_order", "box", "analysis.second_order=true")
case("analysis.failure_modes", "granite", "analysis.failure_modes=given")
case("analysis.damage_counts", "granite", "analysis.damage_counts=true")
case("analysis.on_failure", "failing", "analysis.on_failure=drop", before=BOUND)
case("analysis.cost", "box", "analysis.cost=10 s")
case("analysis.time_limit", "slow", "analysis.time_limit=0.3 s", before=BOUND)
case("margins.solve", "box", "margins={ solve = 'd', between = [1.0, 3.0] }")
case("margins.between", "granite", 'margins.between=["0.1 m/s", "5 m/s"]')
case("margins.for_probability", "granite", "margins.for_probability=[0.2]")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With the tables and the model that studies name."""
    folder = tmp_path_factory.mktemp("keys")
    (folder / "pulse.csv").write_text(PULSE, encoding="utf-8")
    with pd.ExcelWriter(folder / "pulse.xlsx") as book:
        for sheet, factor in (("first", 1.0), ("second", 0.9)):
            table = pd.DataFrame({"t": range(101), "a": factor * np.array(WAVE)})
            table.to_excel(book, sheet_name=sheet, index=False)
    (folder / "model.py").write_text(SLOW, encoding="utf-8")
    (folder / "other.csv").write_text(PULSE.replace(",0.9", ",0.8"), encoding="utf-8")
    return folder


@pytest.mark.parametrize("tried", CASES, ids=str)
def test_a_key_changes_what_a_user_sees(tried: Case, folder: Path) -> None:
    before = effects(tried.study, tried.before, folder)
    assert effects(tried.study, (*tried.before, *tried.change), folder) != before


def test_every_declared_key_has_a_case() -> None:
    numbers = {f"{table}.{key}" for table, key in PATHS.values()}
    tried = {entry.key for entry in CASES} | {"rig.kind"}
    assert declared_keys() - numbers == tried - numbers


def test_every_rig_gives_answers_of_its_own(folder: Path) -> None:
    kinds = {load_study(text=text).rig: name for name, text in BASES.items()}
    assert set(kinds) == set(RIGS)
    assert len({effects(name, (), folder) for name in kinds.values()}) == len(RIGS)
