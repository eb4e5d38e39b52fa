"""[tests] of a study: every column and rig, and every fault with the line of its file."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from uqsphere.errors import StudyError
from uqsphere.feed.laws import energy_of_force, particle_share
from uqsphere.feed.likelihood import Prior
from uqsphere.study import Study, load_study

MATERIAL = '[material]\nE = "60 GPa"\nnu = 0.25\ndensity = "2700 kg/m3"\n'
TESTS = """
[tests]
file = "t.csv"
rig = "platens"
diameter = "d"
diameter_unit = "mm"
specific_energy = "e"
specific_energy_unit = "J/kg"
energy_is = "sphere"
outcome = "out"
"""
CSV = "d,e,out,n\n10,100,broke,a\n10,150,1,b\n20,60,survived,a\n20,80,broke,b\n"
Load = Callable[..., Study]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def with_parts(csv: str = CSV, *changes: tuple[str, str], more: str = "", material: str = MATERIAL) -> Study:
        text = TESTS
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "t.csv").write_text(csv, encoding="utf-8")
        (tmp_path / "study.toml").write_text(f"seed = 3\n{material}{text}{more}", encoding="utf-8")
        return load_study(tmp_path / "study.toml")

    return with_parts


def test_a_table_is_read_as_it_stands(load: Load) -> None:
    plan = load().tests
    assert plan.rows == 4
    assert plan.specimens.diameter.tolist() == [0.01, 0.01, 0.02, 0.02]
    assert plan.specimens.last.tolist() == [100.0, 150.0, 60.0, 80.0]
    assert plan.specimens.broke.tolist() == [True, True, False, True]
    assert plan.specimens.exact.all()
    assert (plan.request.law, plan.request.size, plan.request.ratio, plan.request.seed) == (
        "average",
        "tavares",
        4.0,
        3,
    )


@pytest.mark.parametrize("divider", [";", "\t"])
def test_dividers_comments_and_rows_that_count(load: Load, divider: str) -> None:
    csv = "# made up\n" + CSV.replace(",", divider) + "# the end\n"
    plan = load(csv, more='where = { n = "b" }\n').tests
    assert plan.specimens.last.tolist() == [150.0, 80.0]


def test_energies_are_the_particles_own(load: Load) -> None:
    share = float(particle_share(60e9, 0.25, 205e9, 0.29))
    steel = 'platens = { E = "205 GPa", nu = 0.29 }\n'

    def found(*changes: tuple[str, str], more: str = steel, csv: str = CSV) -> float:
        plan = load(csv, *changes, more=more).tests
        return float(plan.specimens.last[0])

    assert found(('"sphere"', '"contact"')) == pytest.approx(100.0 * share, rel=1e-12)
    assert found(('"sphere"', '"contact"'), more='platens = "rigid"\n') == pytest.approx(100.0)
    thrown = ('"platens"', '"impact"')
    speed = (('specific_energy = "e"\nspecific_energy_unit = "J/kg"\nenergy_is = "sphere"',
              'speed = "e"\nspeed_unit = "m/s"'))  # fmt: skip
    assert found(thrown, speed) == pytest.approx(0.5 * 100.0**2 * share, rel=1e-12)
    dropped = ('"platens"', '"drop_weight"')
    energy = ('specific_energy = "e"\nspecific_energy_unit = "J/kg"', 'energy = "e"\nenergy_unit = "mJ"')
    mass = math.pi / 6.0 * 0.01**3 * 2700.0
    assert found(dropped, energy, ('"sphere"', '"input"')) == pytest.approx(0.1 / mass, rel=1e-12)
    weighed = "d,e,out,m\n10,100,broke,2\n10,150,broke,2\n20,60,survived,20\n"
    more = 'mass = "m"\nmass_unit = "g"\n'
    assert found(dropped, energy, csv=weighed, more=more) == pytest.approx(0.1 / 2e-3, rel=1e-12)


def test_forces_need_the_stiffness_of_the_particle(load: Load) -> None:
    force = ('specific_energy = "e"\nspecific_energy_unit = "J/kg"\nenergy_is = "sphere"',
             'force = "e"\nforce_unit = "N"')  # fmt: skip
    steel = 'platens = { E = "205 GPa", nu = 0.29 }\n'
    with pytest.raises(StudyError, match=r"tests\.stiffness: stiffness is missing: rocks touch at asperities"):
        load(CSV, force, more=steel)
    intact = load(CSV, force, more=steel + "assume_intact = true\n")
    assert any("intact rock" in said for said in intact.warnings)
    csv = "d,e,out,k\n10,100,broke,10\n10,150,broke,10\n20,60,survived,10\n"
    plan = load(csv, force, more=steel + 'stiffness = "k"\n').tests
    share = 1.0 - 10e9 / (205e9 / (1.0 - 0.29**2))
    assert float(plan.specimens.last[0]) == pytest.approx(
        share * float(energy_of_force(100.0, 0.01, 10e9, 2700.0)), rel=1e-12)  # fmt: skip
    assert float(plan.specimens.last[0]) > 2.0 * float(intact.tests.specimens.last[0])  # type: ignore[union-attr]


def test_repeated_blows_classes_and_meshes(load: Load) -> None:
    csv = "lo,hi,e,out,who,n,k,rig\n8,11.2,50,0,a,1,2,drop_weight\n8,11.2,50,1,a,1,1,drop_weight\n"
    csv += "16,22.4,30,3,,10,1,drop_weight\n16,22.4,99,1,,1,1,platens\n"
    plan = load(
        csv, ('rig = "platens"', 'rig = { column = "rig" }'), ('diameter = "d"\ndiameter_unit = "mm"',
        'mesh_lower = "lo"\nmesh_upper = "hi"\nmesh_unit = "mm"'), ('outcome = "out"', 'broken = "out"'),
        more='specimen = "who"\nparticles = "n"\nblows = "k"\n',
    ).tests  # fmt: skip
    tests = plan.specimens
    assert tests.diameter[0] == pytest.approx(math.sqrt(8.0 * 11.2) * 1e-3)
    assert tests.energies[0].tolist() == [50.0, 50.0]
    assert tests.counts[0].tolist() == [2, 1]
    assert sorted(tests.weight.tolist()) == [1.0, 1.0, 3.0, 7.0]
    assert int(tests.exact.sum()) == 1


def test_fineness_and_what_it_is_told_of(load: Load) -> None:
    csv = "d,e,out,t,p5,p1\n20,300,broke,12,40,6\n20,900,broke,30,,\n20,500,survived,,,\n"
    dropped = ('"platens"', '"drop_weight"'), ('"sphere"', '"input"')
    plan = load(csv, *dropped, more='t10 = "t"\npassing = { "5 mm" = "p5", "1 mm" = "p1" }\n').tests
    np.testing.assert_allclose(plan.fineness.t10, [0.12, 0.30])
    np.testing.assert_allclose(plan.fineness.sieves, [0.005, 0.001])
    np.testing.assert_allclose(plan.fineness.offered, [300.0, 900.0])
    np.testing.assert_allclose(plan.fineness.passing, [[0.4, 0.06], [np.nan, np.nan]])


def test_priors_and_gamma(load: Load) -> None:
    more = 'gamma = 5\nratio = "inf"\nprior = { phi = { dist = "lognormal", log_mean = 0.1, log_sd = 0.2 }, '
    more += 'd0 = { dist = "lognormal", mean = "4 mm", cov = 0.1 } }\n'
    request = load(more=more).tests.request  # type: ignore[union-attr]
    assert request.gamma == 5.0
    assert math.isinf(request.ratio)
    assert request.priors["phi"] == Prior(centre=0.1, sd=0.2)
    assert math.exp(request.priors["d0"].centre) == pytest.approx(0.004, rel=0.01)
    law = load(more='gamma = { dist = "lognormal", log_mean = 1.4, log_sd = 0.1 }\n').tests.request  # type: ignore[union-attr]
    assert law.gamma is None
    assert law.priors["gamma"] == Prior(centre=1.4, sd=0.1)


def changed(line: int, row: str) -> str:
    lines = CSV.splitlines()
    lines[line - 1] = row
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("csv", "changes", "more", "says"),
    [
        (changed(3, "10,0,broke,a"), (), "", r"tests\.specific_energy: t\.csv:3: the energy must be above 0, found 0"),
        (changed(3, "0,9,broke,a"), (), "", r"tests\.diameter: t\.csv:3: the diameter must be above 0, found 0"),
        (changed(5, "10,x,broke,a"), (), "", r't\.csv:5: found "x", where a finite number is due'),
        (changed(4, "10,5,perhaps,a"), (), "", r't\.csv:4: found "perhaps", where "broke" or "survived"'),
        (CSV.replace("broke", "survived").replace(",1,", ",0,"), (), "", "every particle survived: nothing bounds"),
        (CSV.replace("survived", "broke"), (('"platens"', '"drop_weight"'),), "", "every particle broke"),
        (CSV, (), 'specimen = "n"\n', r"tests\.specimen: t\.csv:4: this specimen is hit again after it broke"),
        (CSV, (), 'blows = "d"\n', r"tests\.blows: t\.csv:2: platens press once"),
        (CSV, (), 'force = "d"\nforce_unit = "N"\n', r"t\.csv:2: force and specific_energy stand in one row: one is"),
        (CSV, (('"platens"', '"hammer"'),), "", 'found "hammer", allowed: platens, load_cell'),
        (CSV, (('rig = "platens"', 'rig = { column = "n" }'),), "", r't\.csv:2: unknown rig "a", known: platens'),
        (CSV, (('specific_energy_unit = "J/kg"', ""),), "", "specific_energy_unit is missing"),
        (CSV, (('diameter_unit = "mm"', ""),), "", r"tests.*diameter_unit"),
        (CSV, (('"J/kg"', '"J"'),), "", 'found "J", allowed: J/kg'),
        (CSV, (('energy_is = "sphere"', ""),), "", "energy_is is missing"),
        (CSV, (('"sphere"', '"contact"'),), "", "platens is missing: say what the particles were tested between"),
        (CSV, (), 't10 = "e"\n', r"tests\.t10: t\.csv:3: t10 must lie between 0 and 100 %, found 150"),
        ("d,e,out,p,q\n9,1,1,10,20\n9,2,1,8,4\n", (), 'passing = { "2 mm" = "p", "1 mm" = "q" }\n',
         r"t\.csv:2: more passes a finer sieve"),
        (CSV, (), 'where = { n = "z" }\n', 'has no row with n = "z"'),
        (CSV, (), 'size = "weakest_link"\n', "belongs to law = \"weibull\""),
        (CSV, (), "gamma = 0.2\n", "gamma lies from 1 to 20"),
        (CSV, (), 'prior = { phy = 1 }\n', "did you mean 'phi'"),
        (CSV, (), "prior = { phi = 1 }\n", "a prior is a lognormal law"),
        (CSV, (('outcome = "out"', 'broken = "e"'),), 'particles = "d"\n', r"t\.csv:2: broken must lie from 0"),
        (CSV, (('outcome = "out"', ""),), "", "outcome is missing"),
        (CSV, (("\nfile = \"t.csv\"", ""),), "", "file is missing"),
    ],
)  # fmt: skip
def test_faults(load: Load, csv: str, changes: tuple[tuple[str, str], ...], more: str, says: str) -> None:
    with pytest.raises(StudyError, match=says):
        load(csv, *changes, more=more)


def test_every_fault_at_once(load: Load) -> None:
    with pytest.raises(StudyError) as caught:
        load("d,e,out,n\n0,100,broke,a\n10,-1,broke,a\n10,5,what,a\n")
    text = str(caught.value)
    assert all(f"t.csv:{line}: " in text for line in (2, 3, 4))


def test_only_survivors_with_a_prior_are_a_start(load: Load) -> None:
    csv = CSV.replace("broke", "survived").replace(",1,", ",0,")
    prior = 'prior = { e_inf = { dist = "lognormal", mean = "80 J/kg", cov = 0.5 } }\n'
    study = load(csv, more=prior)
    assert study.tests is not None
    assert any("the level of the law is the prior's" in said for said in study.warnings)


def test_one_row_and_a_hundred_thousand(load: Load) -> None:
    assert load("d,e,out\n10,100,broke\n").tests.rows == 1  # type: ignore[union-attr]
    rows = "".join(f"{5 + k % 90 / 10},{50 + k % 997},{k % 2}\n" for k in range(100_000))
    assert load("d,e,out\n" + rows).tests.rows == 100_000  # type: ignore[union-attr]


def test_the_sphere_of_a_study_is_what_its_particles_are_of(load: Load, tmp_path: Path) -> None:
    scene = '[sphere]\nmaterial = "granite"\nradius = "10 mm"\n[rig]\nkind = "impact"\nspeed = "5 m/s"\n'
    scene += '[target]\nmaterial = "steel"\n[limits.a]\nquantity = "p_max"\nstrength = "4 GPa"\n'
    study = load(material=scene)
    assert study.tests is not None
    assert study.particles.name == "granite"
    other = CSV.replace("150", "151")
    assert load(other, material=scene).hash != study.hash


# --- strengths of a limit -------------------------------------------------------------------------------------

SCENE = """
[sphere]
E = "60 GPa"
nu = 0.25
density = "2700 kg/m3"
radius = { dist = "normal", mean = "10 mm", cov = 0.01 }
[rig]
kind = "impact"
speed = "5 m/s"
[target]
material = "steel"
[limits.a]
criterion = "specific_energy"
energy_is = "sphere"
strength = { STRENGTH }
"""


def strength_of(folder: Path, text: str, csv: str) -> Study:
    (folder / "t.csv").write_text(csv, encoding="utf-8")
    (folder / "study.toml").write_text(SCENE.replace("STRENGTH", text), encoding="utf-8")
    return load_study(folder / "study.toml")


def test_a_strength_takes_the_columns_of_tests(tmp_path: Path) -> None:
    csv = "d,e,out\n20,100,broke\n20,150,broke\n20,120,survived\n20,80,broke\n"
    text = 'tests = "t.csv", diameter = "d", diameter_unit = "mm", specific_energy = "e", platens = "rigid", '
    text += 'specific_energy_unit = "J/kg", energy_is = "sphere", outcome = "out", rig = "load_cell"'
    law = strength_of(tmp_path, text, csv).limits[0].strength
    assert law.data == pytest.approx([80.0, 100.0, 150.0], rel=1e-12)  # type: ignore[union-attr]
    assert law.censored == pytest.approx([120.0], rel=1e-12)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        (('"load_cell"', '"drop_weight"'), r't\.csv:2: this rig gives what was offered.*strength = \{ fit = "DIR" \}'),
        (('tests = "t.csv"', 'tests = "t.csv", file = "t.csv"'), "tests names a file too"),
        (('outcome = "out"', 'outcome = "out", censored = "out"'), "outcome is given too"),
        (('specific_energy = "e"', 'speed = "e", speed_unit = "m/s", specific_energy = "e"'), "a speed is what was"),
    ],
)
def test_tests_that_are_no_strength(tmp_path: Path, changes: tuple[str, str], says: str) -> None:
    text = 'tests = "t.csv", diameter = "d", diameter_unit = "mm", specific_energy = "e", platens = "rigid", '
    text += 'specific_energy_unit = "J/kg", energy_is = "sphere", outcome = "out", rig = "load_cell"'
    with pytest.raises(StudyError, match=says):
        strength_of(tmp_path, text.replace(*changes), "d,e,out\n20,100,1\n20,150,1\n20,80,1\n")
