"""What a study means: shipped studies, defaults, hash, overrides, moved means, Python's form,
schema and page.
"""

from __future__ import annotations

import inspect
import json
import math
import pickle
import re
import runpy
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from study_base import BASE, BLACK_BOX
from test_broken import CASES

import uqsphere
from tests.campaigns.fuzz import campaign
from uqsphere.cli import main
from uqsphere.errors import AccessError, StudyError, UsageError
from uqsphere.propagation.failure_modes import failure_modes_of
from uqsphere.study import Limit, Study, json_schema, load_study, shipped_studies
from uqsphere.study.document import Document

Load = Callable[..., Study]
TRAPEZOID = 'shape = "trapezoid"\nrise = "25 us"\nfall = "25 us"'


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def changed(
        text: str = BASE, *edits: tuple[str, str], overrides: tuple[str, ...] = ()
    ) -> Study:
        for old, new in edits:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        (tmp_path / "study.toml").write_text(text)
        return load_study(tmp_path / "study.toml", overrides)

    return changed


@pytest.mark.parametrize("name", sorted(shipped_studies()))
def test_shipped_study(name: str, tmp_path: Path) -> None:
    path = tmp_path / f"{name}.toml"
    assert main(["new", name, "-o", str(path)]) == 0
    study = load_study(path)
    usual = ("Real particles are not spheres", "the tests were quasi-static")
    assert [text for text in study.warnings if not any(part in text for part in usual)] == []
    assert json.loads(json.dumps(study.meaning(), allow_nan=False))["order"] == list(
        study.inputs().names
    )
    assert set(study.at_means()) == set(study.fixed) | set(study.random)
    assert pickle.loads(pickle.dumps(study)).hash == study.hash
    assert study.black_box or {"p_max", "contact_duration"} <= set(study.analysis.quantities)
    jsonschema.validate(tomllib.loads(path.read_text()), json_schema())


def test_granite_in_si() -> None:
    study = load_study(shipped_studies()["granite"])
    assert list(study.random) == ["sphere.E", "sphere.nu", "sphere.radius", "striker.speed"]
    assert study.random["sphere.E"].sd() == pytest.approx(0.12 * 52e9, rel=1e-12)
    assert study.random["striker.speed"].parameters["sd"] == pytest.approx(0.01, rel=1e-12)
    expected = {
        "sphere.density": 2650.0,
        "bars.diameter": 0.04,
        "bars.incident_end": 1.0,
        "bars.receiving_end": 0.0,
        "striker.length": 0.8,
        "pulse.rise": 25e-6,
        "sphere.onset_pressure": 3.2e9,
    }
    assert {name: study.fixed[name] for name in expected} == pytest.approx(expected, rel=1e-12)
    assert study.limits[0].quantity == "p_hertz"
    assert (study.model.fidelity, study.model.first_loading_only) == ("full", False)
    assert [way.called for way in failure_modes_of(study)[0]] == [
        "ring crack",
        "core tension",
        "fracture energy",
    ]
    assert failure_modes_of(load_study(study.path, ["analysis.failure_modes=given"])) == ([], {})


@pytest.mark.parametrize(
    "demand",
    [
        *(
            f'criterion = "specific_energy"\nenergy_is = "{e}"'
            for e in ("contact", "sphere", "input")
        ),
        'quantity = "impact_energy"',
    ],
)
def test_a_limit_on_any_energy_stands_for_the_fracture_energy(demand: str) -> None:
    text = shipped_studies()["limestone_drop_weight"].read_text(encoding="utf-8")
    unit = "J" if "quantity" in demand else "J/kg"
    limit = f'[limits.broken]\n{demand}\nstrength = "150 {unit}"\ntarget = 0.1\n'
    study = load_study("drop.toml", text=text[: text.index("[limits")] + limit)
    assert [mode.called for mode in failure_modes_of(study)[0]] == ["ring crack", "core tension"]


def test_one_rig_with_three_limits_on_the_same_tests() -> None:
    for name, aim in (("limestone_chute", "survive"), ("limestone_rotor", "break")):
        study = load_study(shipped_studies()[name])
        assert study.rig == "impact"
        assert {limit.aim for limit in study.limits} == {aim}
        quantities = ["P_max", "specific_energy_sphere", "centre_tension"]
        assert [limit.quantity for limit in study.limits] == quantities
        tests = [limit.tested for limit in study.limits]
        assert len({test.forces for test in tests if test is not None}) == 1
        assert set(study.made_up) == {f"limits.{limit.name}.strength" for limit in study.limits}


@pytest.mark.parametrize(
    ("old", "new", "same"),
    [
        ('title = "granite"', 'title = "another" # and a comment', True),
        ('diameter = "40 mm"', "diameter   =  '0.04 m'", True),
        ('incident_end = "free"', "incident_end = 1.0", True),
        ("[model]\ntolerance = 1e-6\n", "", True),
        ("target = 0.01", 'target = "1 %"', True),
        ("seed = 7", "seed = 8", False),
        ("cov = 0.12", "cov = 0.13", False),
        ('lower = "9 mm"', 'lower = "9.1 mm"', False),
        ('incident_end = "free"', "infinite = true", False),
        ('rise = "25 us"', 'rise = "26 us"', False),
        ("tolerance = 1e-6", "tolerance = 1e-7", False),
        ("modulus = 12", "modulus = 13", False),
        ("target = 0.01", 'aim = "break"', False),
        ("spearman = 0.6", "spearman = 0.5", False),
        ('"20 m/s"', '"21 m/s"', False),
        # the same number from the library: its source is part of what is reported
        ("nu = 0.25\n", "", False),
    ],
)
def test_hash_sees_the_meaning_alone(load: Load, old: str, new: str, same: bool) -> None:
    assert (load().hash == load(BASE, (old, new)).hash) is same


def test_random_inputs_keep_the_order_of_the_file(load: Load) -> None:
    sphere, rest = BASE.split("[bars]")
    bars, rest = rest.split("[striker]")
    head, sphere = sphere.split("[sphere]")
    study = load(f"{head}[striker]{rest}[bars]{bars}[sphere]{sphere}")
    assert list(study.random) == ["striker.speed", "sphere.E", "sphere.radius"]


def test_inputs_carry_strengths_and_the_dependence(load: Load) -> None:
    inputs = load(
        BASE, ("target = 0.01", 'model_factor = { dist = "lognormal", mean = 1.0, cov = "5 %" }')
    ).inputs()
    assert inputs.names[3:] == ("limits.crushing.strength", "limits.crushing.model_factor")
    assert inputs.correlation[0, 3] == pytest.approx(2.0 * math.sin(math.pi * 0.6 / 6.0), rel=1e-12)


def test_defaults(load: Load) -> None:
    study = load(
        BASE.split("[pulse]")[0]
        .replace('incident_end = "free"\n', "")
        .replace('title = "granite"\n', "")
    )
    assert study.title == "study"
    assert (study.fixed["bars.incident_end"], study.fixed["bars.receiving_end"]) == (1.0, 0.0)
    assert study.options["pulse.shape"] == "rectangular"
    assert study.analysis.quantities == ("p_max", "contact_duration")
    accuracy = study.analysis.accuracy
    assert (accuracy.mean, accuracy.quantile, accuracy.sobol, accuracy.probability) == (
        0.005,
        0.02,
        0.02,
        0.05,
    )
    assert (study.limits, study.margins, study.analysis.measures) == ((), None, ())


def test_quantities_of_limits_are_not_asked_for(load: Load) -> None:
    study = load(
        BASE, ("[analysis]", '[limits.b]\nquantity = "energy"\nstrength = "2 mJ"\n[analysis]')
    )
    assert study.analysis.quantities == ("p_max",)
    assert study.limits[1] == Limit(name="b", quantity="energy", strength=2e-3)


def test_pulses_and_inserts(load: Load) -> None:
    peaks = (
        'shape = "two_peak"\nt1 = "50 us"\nlevel1 = 1.2\nt2 = "120 us"\nlevel2 = 0.8\nduration = '
        '"175 us"'
    )
    study = load(BASE, (TRAPEZOID, peaks), ('length = "0.8 m"', ""))
    assert study.fixed["pulse.level1"] == 1.2
    assert "striker.length" not in study.fixed
    step = load(
        BASE,
        ('incident_end = "free"', "infinite = true"),
        (TRAPEZOID, 'shape = "step"'),
        ("tolerance = 1e-6", 'horizon = "3 ms"'),
        ('length = "0.8 m"', ""),
    )
    assert step.model.horizon == pytest.approx(3e-3, rel=1e-12)
    insert = load(
        BASE,
        (
            "[pulse]",
            '[insert]\nE = { dist = "normal", mean = "600 GPa", cov = 0.1 }\nnu = 0.2\n[pulse]',
        ),
        ('["0.05 m/s", "20 m/s"]', '["500 GPa", "700 GPa"]'),
        ('"striker.speed"', '"insert.E"'),
    )
    assert insert.fixed["bars.insert_nu"] == 0.2
    assert insert.margins is not None and insert.margins.solve == "bars.insert_E"  # noqa: PT018
    assert insert.moved(550e9).random["bars.insert_E"].nominal_mean() == 550e9


def test_a_measured_pulse(load: Load, tmp_path: Path) -> None:
    t = np.arange(0.0, 260.0, 0.5)
    strain = np.where((t > 20) & (t < 220), 150.0 * np.sin(np.pi * (t - 20) / 200) ** 2, 0.0)
    rows = "\n".join(f"{a:g};{-b:.6f}".replace(".", ",") for a, b in zip(t, strain, strict=True))
    (tmp_path / "p.csv").write_text(f"time [us];gauge [microstrain]\n{rows}\n")
    striker = (
        '[striker]\nspeed = { dist = "normal", mean = "0.5 m/s", cov = 0.02 }\nlength = "0.8 m"\n'
    )
    edits = (
        (striker, ""),
        (
            TRAPEZOID,
            'shape = "measured"\nfile = "p.csv"\ngain = { dist = "normal", mean = 1, cov = 0.02 }',
        ),
    )
    text = BASE.split("[margins]")[0]
    study = load(text, *edits)
    assert study.record is not None
    assert study.record.peak == pytest.approx(150e-6, rel=2e-3)
    assert study.record.duration == pytest.approx(200e-6, rel=0.05)
    assert study.record.rise == pytest.approx(59e-6, rel=0.02)  # sin² of a tenth and nine tenths
    assert any("compression is positive" in warning for warning in study.warnings)
    assert list(study.random)[-1] == "pulse.gain"
    volts = (edits[1][0], edits[1][1].replace('"p.csv"', '"p.csv"\nunits = ["us", "mV"]'))
    (tmp_path / "p.csv").write_text(f"time;gauge\n{rows}\n")
    with pytest.raises(StudyError, match="factor, the strain of one volt, is missing"):
        load(text, edits[0], volts)


@pytest.mark.parametrize(
    ("noise", "back", "said"), [(0.0, 0.0, ""), (3.0, 0.0, ""), (3.0, -60.0, "strain reaches 4")]
)
def test_noise_ahead_of_a_pulse_is_no_contact(
    load: Load, tmp_path: Path, noise: float, back: float, said: str
) -> None:
    t = np.arange(0.0, 500.0, 0.5)
    strain = np.interp(t, [100, 125, 275, 300, 350, 375, 400], [0, 150, 150, 0, 0, back, 0])
    strain += noise * np.random.default_rng(3).standard_normal(len(t))
    rows = "\n".join(f"{a:g},{b:.3f}" for a, b in zip(t, strain, strict=True))
    (tmp_path / "p.csv").write_text(f"time [us],gauge [microstrain]\n{rows}\n")
    striker = (
        '[striker]\nspeed = { dist = "normal", mean = "0.5 m/s", cov = 0.02 }\nlength = "0.8 m"\n'
    )
    edits = (striker, ""), (TRAPEZOID, 'shape = "measured"\nfile = "p.csv"')
    if said:
        with pytest.raises(StudyError, match=said):
            load(BASE.split("[margins]")[0], *edits)
        return
    speed = 2.0 * math.sqrt(190e9 / 8000.0) * 150e-6
    exact = load(
        BASE, (TRAPEZOID, f'{TRAPEZOID}\nduration = "175 us"'), ('"0.5 m/s"', f'"{speed} m/s"')
    )
    of = [
        uqsphere.evaluate(study, {"sphere.nu": np.array([0.25])}, quantities=("p_max",))["p_max"][0]
        for study in (load(BASE.split("[margins]")[0], *edits), exact)
    ]
    assert of[0] == pytest.approx(of[1], rel=1e-3)


def test_a_record_without_a_pulse_is_refused(load: Load, tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text(
        "time [us],gauge [microstrain]\n" + "".join(f"{k},0\n" for k in range(99))
    )
    striker = (
        '[striker]\nspeed = { dist = "normal", mean = "0.5 m/s", cov = 0.02 }\nlength = "0.8 m"\n'
    )
    with pytest.raises(
        StudyError, match=r"pulse\.file: the pulse must have at least 8 samples, not 0"
    ):
        load(
            BASE.split("[margins]")[0],
            (striker, ""),
            (TRAPEZOID, 'shape = "measured"\nfile = "p.csv"'),
        )


def test_warnings_of_laws(load: Load) -> None:
    (warning,) = load(
        BASE, ("nu = 0.25", 'nu = { dist = "normal", mean = 0.4, sd = 0.05 }')
    ).warnings
    assert "study.toml:7: sphere.nu: 2.3 % of the distribution " in warning
    assert (
        load(
            BASE, ("nu = 0.25", 'nu = { dist = "normal", mean = 0.4, sd = 0.05, upper = 0.49 }')
        ).warnings
        == ()
    )
    (warning,) = load(BASE, ('lower = "9 mm"', 'lower = "11 mm"')).warnings
    assert (
        "study.toml:8: sphere.radius.lower: the mean 10 mm lies below the bound 11 mm: " in warning
    )


def test_moving_the_mean_keeps_what_was_given(load: Load) -> None:
    by_cov, by_sd = load(), load(BASE, ('"0.5 m/s", cov = 0.02', '"0.5 m/s", sd = "0.01 m/s"'))
    assert by_cov.moved(2.0).random["striker.speed"].sd() == pytest.approx(0.04, rel=1e-12)
    assert by_sd.moved(2.0).random["striker.speed"].sd() == pytest.approx(0.01, rel=1e-12)
    law = '{ dist = "normal", mean = "0.5 m/s", cov = 0.02 }'
    beta = (
        '{ dist = "beta", mean = "0.5 m/s", sd = "0.01 m/s", lower = "0.4 m/s", upper = "0.6 m/s" }'
    )
    with pytest.raises(
        StudyError, match=r"between\[1\]: striker.speed has no distribution with this mean"
    ):
        load(BASE, (law, beta))
    with pytest.raises(StudyError, match="not given by its mean"):
        load(BASE, (law, '{ dist = "uniform", lower = "0.4 m/s", upper = "0.6 m/s" }'))


def test_overrides(load: Load) -> None:
    sets = (
        "striker.speed.mean=0.6 m/s",
        "bars.infinite=true",
        "dependence[0].spearman=0.1",
        "bars.receiving_end=fixed",
        "analysis.quantiles=[0.5]",
        'limits."crushing".target = 0.2',
        "seed=9",
        "margins=null",
    )
    study = load(BASE, overrides=sets)
    assert study.random["striker.speed"].nominal_mean() == 0.6
    assert (study.dependence[0].spearman, study.analysis.quantiles, study.seed) == (0.1, (0.5,), 9)
    assert (study.limits[0].target, study.fixed["bars.receiving_end"], study.margins) == (
        0.2,
        -1.0,
        None,
    )
    assert study.overrides == sets
    with pytest.raises(StudyError) as caught:
        load(BASE, overrides=("striker.speed.mean=0.6 s",))
    (problem,) = caught.value.problems
    assert problem.line == BASE[: BASE.index("speed = ")].count("\n") + 1
    assert problem.message.endswith("(set by --set)")
    with pytest.raises(
        StudyError, match=r"limits.crush.quantity: exactly one of quantity and criterion"
    ):
        load(BASE, overrides=("limits.crush.strength=3",))
    assert (
        len(load(BASE, overrides=("limits.b.quantity=p_max", "limits.b.strength=5 GPa")).limits)
        == 2
    )


@pytest.mark.parametrize(
    "override",
    [
        "",
        "x",
        "=1",
        "a..b=1",
        "a.=1",
        ".a=1",
        "striker.length.mean=1 m",
        "dependence[7].spearman=0",
        "sphere[0]=1",
        "a.b.c.d.e.f.g.h.i.j=1",
        "dependence.-1.spearman=0",
        "margins.sove=null",
        "limit=null",
        "dependence[7]=null",
        "seed.a=null",
    ],
)
def test_override_that_is_none(load: Load, override: str) -> None:
    with pytest.raises((UsageError, StudyError)):
        load(BASE, overrides=(override,))


def test_python_dict_and_text_are_one_study(tmp_path: Path) -> None:
    from scipy import stats

    text = load_study(
        tmp_path / "study.toml",
        text=BLACK_BOX.replace("[outputs]", '[limits.g]\nquantity = "y"\nstrength = 0\n[outputs]'),
    )
    python = Study(
        inputs={"x1": stats.uniform(-1, 2), "x2": 2.0},
        outputs="y",
        limits={"g": {"quantity": "y", "strength": 0}},
    )
    tables = load_study(tomllib.loads(python.text))
    assert python.hash == text.hash == tables.hash
    assert python.outputs == ("y",)
    with pytest.raises(StudyError, match=r"study.toml:1: inputs.x: .* did you mean 'dist'"):
        Study(inputs={"x": {"dits": "normal"}}, outputs="y")
    endless: list[object] = []
    endless.append(endless)
    for value, says in (
        (object(), r"inputs\.x .*found object"),
        (1j, "found complex"),
        (10**5000, "no file can hold"),
        (endless, "no file can hold"),
    ):
        with pytest.raises(UsageError, match=says):
            Study(inputs={"x": value}, outputs="y")
    assert Study(inputs={"x1": 2.0}, outputs="y", title=None).title == "study"


def test_schema_and_page() -> None:
    schema = json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    assert len(json.dumps(schema)) < 60_000
    names = {
        "a unit of something else",
        "an unknown key",
        "an unknown shape",
        "a word for a flag",
        "a target of one",
        "an unknown fidelity",
        "another copula",
        "a method of later",
        "a negative seed",
        "a length without its unit",
    }
    for case in (case for case in CASES if case.name in names):
        assert not jsonschema.Draft202012Validator(schema).is_valid(
            tomllib.loads(case.content.decode())
        ), case.name
    docs = runpy.run_path(str(Path(__file__).parents[2] / "docs" / "study_file.py"))
    page = docs["PAGE"].read_text(encoding="utf-8")
    assert page == docs["build_page"](page), "python docs/study_file.py"
    assert len(page.split()) <= 3_500
    # numbers and words that tables share are one key each
    tables = page.partition("## Top level")[2]
    assert len(set(re.findall(r"(?m)^\| `(\w+)` \|", tables))) <= 120
    assert set(inspect.signature(Study).parameters) == set(Document.model_fields)


def test_what_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "mark.toml").write_bytes(b"\xef\xbb\xbf" + BASE.encode())
    assert load_study(tmp_path / "mark.toml").title == "granite"
    with pytest.raises(UsageError, match="this is a directory"):
        load_study(tmp_path)
    (tmp_path / "large.toml").write_bytes(b"# x\n" * 2_600_000)
    with pytest.raises(UsageError, match="at most 1 MiB are read"):
        load_study(tmp_path / "large.toml")
    (tmp_path / "loop.toml").symlink_to(tmp_path / "loop.toml")
    for path in (tmp_path / "none.toml", tmp_path / "a\0b", tmp_path / "loop.toml"):
        with pytest.raises(AccessError):
            load_study(path)


@pytest.mark.slow
def test_mutated_studies_and_tables_are_refused_or_read() -> None:
    codes, failures = campaign(60, 11)
    assert failures == []
    assert codes[2] > 30


def test_reading_a_study_imports_nothing_heavy() -> None:
    code = (
        f"import sys, uqsphere.study as s; s.load_study({str(shipped_studies()['granite'])!r}); "
        "print({'pandas', 'scipy.stats', 'chaospy', 'SALib', 'matplotlib', 'numba'} & "
        "set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("inputs..x2=3", "needs PATH=VALUE"),
        (".inputs.x2=3", "needs PATH=VALUE"),
        ("inputs.x2.=3", "needs PATH=VALUE"),
        ("inputs x2=3", "needs PATH=VALUE"),
        ("inputs.x22=3", "there is no inputs.x22 in the study; did you mean 'x2'"),
    ],
)
def test_an_override_names_a_number_that_is_there(override: str, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        load_study("study.toml", [override], text=BLACK_BOX)
    for way in ("inputs.x2=3", "inputs . x2 = 3", "'inputs'.\"x2\"=3"):
        assert load_study("study.toml", [way], text=BLACK_BOX).fixed == {"x2": 3.0}


def test_an_end_of_the_free_number_without_a_scene_has_its_line(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    text = BASE.replace('"striker.speed"', '"striker.length"')
    path.write_text(text.replace('["0.05 m/s", "20 m/s"]', '["0.05 m", "5 m"]'))
    with pytest.raises(StudyError) as caught:
        uqsphere.run(load_study(path))
    line = text[: text.index("between")].count("\n") + 1
    first, second = str(caught.value).splitlines()
    assert first.startswith(f"{path}:{line}: margins.between[0]: 50 mm for striker.length: outside")
    assert second.startswith(
        f"{path}:{line}: margins.between[1]: 5 m for striker.length: the pulse"
    )


@pytest.mark.parametrize("between", [[-1e308, 1e308], [1e-300, 1e100]])
def test_a_range_wider_than_numbers_reach_is_refused(between: list[float]) -> None:
    limit = {"quantity": "y", "strength": 5.0, "aim": "survive", "target": 0.01}
    with pytest.raises(StudyError, match=r"margins.between: the two values are too far apart"):
        Study(
            inputs={"x": 1.0},
            outputs="y",
            limits={"a": limit},
            margins={"solve": "x", "between": between},
        )
