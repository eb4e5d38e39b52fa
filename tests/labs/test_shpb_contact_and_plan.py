"""The contact law from a slow record, and the design of a test."""

from __future__ import annotations

import json
import math
import re
import shutil
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.stats import weibull_min

import uqsphere
from uqsphere.cli import main
from uqsphere.documents import load_document
from uqsphere.errors import StudyError, UsageError
from uqsphere.labs.comminution.document import ComminutionDocument
from uqsphere.labs.shpb.contact import ContactDocument, face_approach, fit_contact
from uqsphere.labs.shpb.document import RecordDocument
from uqsphere.labs.shpb.plan import PlanDocument, plan_test, plan_text
from uqsphere.mechanics.contact import hertz_constant
from uqsphere.mechanics.yielding import Face

TRUTH: dict[str, Any] = {"modulus": 40e9, "onset": 1.0e9, "hardness": 2.5e9, "pile_up": 2.0}
RADIUS = 5e-3


def loading(
    noise: float = 2e-8, top: float = 3000.0, unload: bool = True, compliance: float = 0.0
) -> pd.DataFrame:
    force = np.concatenate(
        [np.linspace(0.0, top, 400), *([np.linspace(top, 0.0, 300)] if unload else [])]
    )
    largest = np.maximum(np.maximum.accumulate(force), 1e-9)
    approach = face_approach(force, largest, Face(effective_radius=np.array(RADIUS), **TRUTH))
    rng = np.random.default_rng(1)
    path = 2.0 * approach + compliance * force + 1e-5 + noise * rng.standard_normal(len(force))
    return pd.DataFrame({"u [um]": path * 1e6, "F [N]": force})


def fit(frame: pd.DataFrame, folder: Path, **keys: Any) -> Any:
    frame.to_csv(folder / "slow.csv", index=False)
    asked = ContactDocument(file="slow.csv", diameter="10 mm", **keys)
    return fit_contact(asked, folder)


def test_a_face_is_hertz_below_its_onset() -> None:
    force = np.array([5.0, 20.0])
    numbers: dict[str, Any] = {"modulus": 40e9, "onset": 50e9, "hardness": 100e9, "pile_up": 2.0}
    law = Face(effective_radius=np.array(RADIUS), **numbers)
    elastic = face_approach(force, force, law)
    np.testing.assert_allclose(
        elastic, np.cbrt(np.square(force / hertz_constant(40e9, RADIUS))), rtol=1e-9
    )


def test_a_slow_test_gives_back_its_law(tmp_path: Path) -> None:
    found = fit(loading(), tmp_path)
    for name, value in (
        ("modulus", 40e9),
        ("onset_pressure", 1e9),
        ("hardness", 2.5e9),
        ("pile_up", 2.0),
    ):
        one = getattr(found, name)
        assert one.low < value < one.high
        assert one.value == pytest.approx(value, rel=0.03)
    assert found.misfit == pytest.approx(2e-8, rel=0.1)
    lines = tomllib.loads(found.lines())["contact"]
    assert lines["law"] == "plastic"
    assert lines["onset_pressure"].endswith("GPa")


def test_machine_and_platens_are_taken_off(tmp_path: Path) -> None:
    keys = {"machine_stiffness": "50 N/um", "platens": "maraging_steel", "nu": 0.25}
    found = fit(loading(compliance=1.0 / 50e6), tmp_path, **keys)
    assert found.modulus.value == pytest.approx(40e9, rel=0.02)
    assert found.sphere_modulus.value > 40e9 * (1.0 - 0.25**2)


@pytest.mark.parametrize(
    ("frame", "keys", "match"),
    [
        (loading(unload=False), {}, "not unloaded"),
        (loading(top=60.0, noise=1e-10), {}, "hardly beyond Hertz"),
        (loading().iloc[::50], {}, "samples above 1%"),
        (loading() * [1.0, -1.0], {}, "never positive"),
        (loading() * [-1.0, 1.0], {}, "does not grow"),
        (loading().sample(frac=1.0, random_state=1), {}, "jumps|grow"),
        (loading().rename(columns={"F [N]": "F"}), {}, "unit of the column 'F' is missing"),
    ],
)
def test_what_is_no_such_test_is_refused(
    frame: pd.DataFrame, keys: Any, match: str, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match=match):
        fit(frame, tmp_path, **keys)


def test_fit_contact_from_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    loading().to_csv(tmp_path / "slow.csv", index=False)
    (tmp_path / "slow.toml").write_text('file = "slow.csv"\ndiameter = "10 mm"\n')
    assert (
        main(["shpb", "fit-contact", str(tmp_path / "slow.toml"), "--out", str(tmp_path / "out")])
        == 0
    )
    assert 'law = "plastic"' in capsys.readouterr().out
    written = tomllib.loads((tmp_path / "out/contact.toml").read_text())
    assert written["contact"]["pile_up"] == pytest.approx(2.0, rel=0.03)
    (tmp_path / "slow.toml").write_text('file = "slow.csv"\n')
    assert main(["shpb", "fit-contact", str(tmp_path / "slow.toml")]) == 2
    assert "diameter" in capsys.readouterr().err


# --- plan -----------------------------------------------------------------------------------------

STUDY = """
title = "A ball between bars"
seed = 1
[sphere]
E = {E}
nu = 0.25
density = "2650 kg/m3"
radius = "5 mm"
[bars]
material = "maraging_steel"
diameter = "20 mm"
incident_length = "1.5 m"
receiving_length = "1.5 m"
[striker]
speed = "1 m/s"
length = "0.3 m"
[limits.crushing]
quantity = "P_max"
strength = {{ dist = "weibull", mean = "12 kN", modulus = 6 }}
aim = "survive"
"""


SPEEDS: dict[str, Any] = {"free": "striker.speed", "between": ("0.05 m/s", "2 m/s")}


def plan(folder: Path, capsys: pytest.CaptureFixture[str], E: str, *more: str) -> dict[str, Any]:
    (folder / "ball.toml").write_text(STUDY.format(E=E))
    lines = [
        'study = "ball.toml"',
        "shares = [1e-4, 0.04, 0.5]",
        "points = 9",
        'free = "striker.speed"',
        'between = ["0.3 m/s", "6 m/s"]',
        *more,
    ]
    (folder / "plan.toml").write_text("\n".join(lines))
    assert (
        main(["shpb", "plan", str(folder / "plan.toml"), "--json", "--out", str(folder / "out")])
        == 0
    )
    return json.loads(capsys.readouterr().out)  # type: ignore[no-any-return]


def test_small_shares_come_from_the_law_of_the_strength(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = plan(tmp_path, capsys, '"60 GPa"')
    force = np.array(found["force"])[:, 1]
    truth = weibull_min.cdf(force, 6.0, scale=12e3 / math.gamma(1.0 + 1.0 / 6.0))
    np.testing.assert_allclose(np.array(found["shares"]["crushing"])[:, 0], truth, rtol=1e-6)
    assert 0.0 < truth[0] < 1e-4
    reached = {one["share"]: one["value"][0] for one in found["reached"]["crushing"]}
    assert reached[1e-4] < reached[0.04] < reached[0.5]
    there = np.interp(np.log(reached[0.04]), np.log(found["values"]), np.log(truth))
    assert there == pytest.approx(np.log(0.04), abs=0.2)
    assert pd.read_csv(tmp_path / "out/plan.csv").shape[0] == 9
    # a bound is told once, and a value with its interval in one unit
    text = plan_text(found)
    assert "(above" not in text
    assert re.search(r"above 9\d(\.\d+)? %", text)
    assert re.search(r"\d \([\d.]+ to [\d.]+\) m/s", text)


def test_scatter_widens_the_shares_and_intervals_hold_finer_ones(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    E = '{ dist = "lognormal", mean = "60 GPa", cov = 0.2 }'
    coarse, fine = (
        plan(tmp_path, capsys, E, f"rows = {rows}")["shares"]["crushing"] for rows in (64, 2048)
    )
    held = [low <= there[0] <= high for (_, low, high), there in zip(coarse, fine, strict=True)]
    assert sum(held) >= 7
    assert all(low < value < high for value, low, high in fine[:6])


@pytest.mark.parametrize("chosen", [False, True])
def test_a_plan_has_every_failure_mode_that_means_fracture(chosen: bool, tmp_path: Path) -> None:
    """Those with a strength of the library break first; who names limits asks for these alone."""
    text = STUDY.format(E='"60 GPa"').replace("[sphere]", '[sphere]\nmaterial = "granite"')
    (tmp_path / "ball.toml").write_text(text)
    asked = PlanDocument(
        study="ball.toml",
        shares=(0.01,),
        rows=64,
        points=3,
        **SPEEDS,
        limits=("crushing",) * chosen,
    )
    plan = plan_test(asked, tmp_path)
    names = ["crushing"]
    if not chosen:
        names += [f"{mode} (assumed)" for mode in ("contact crushing", "core tension")]
        names.append("fracture energy (assumed)")
        crushed, tension = (plan["shares"][name][-1][0] for name in (names[0], names[2]))
        assert tension > crushed
    assert [*plan["shares"]] == [*plan["reached"]] == names
    assert any("library" in note for note in plan["notes"]) != chosen


def test_what_a_plan_cannot_use_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """At its line and key."""
    (tmp_path / "ball.toml").write_text(STUDY.format(E='"60 GPa"'))
    shutil.copy(Path(__file__).parents[2] / "studies" / "ishigami.toml", tmp_path)
    file = tmp_path / "plan.toml"
    free = '\nfree = "striker.speed"'
    between = '\nbetween = ["1 m/s", "2 m/s"]'
    for line, match in (
        ('free = "striker.speed"', "free: give a number of the study, such as striker"),
        ('free = "striker.mass"' + between, 'free: "striker.mass" is not a number of this study'),
        ('between = ["1 kg", "2 kg"]' + free, "between[0]: unknown unit 'kg' for a speed"),
        ('between = ["0 m/s", "2 m/s"]' + free, "between[0]: striker speed must be above 0 m/s"),
        ('between = ["2 m/s", "1 m/s"]' + free, "between: must be [low, high], not"),
        ('limits = ["none"]', 'limits: unknown limit that means fracture "none", known: crushing'),
        ('limits = ["crushing", "none"]', 'limits: unknown limit that means fracture "none"'),
        ("rows = 3", "rows: must be greater than or equal to 64, not 3"),
        ("shares = [0.1, 1.5]", "shares[1]: must be less than 1, not 1.5"),
        ('study = "ishigami.toml"', "study: a plan needs a sphere in a rig"),
        ('study = "none.toml"', f"study: {tmp_path / 'none.toml'}: there is no such file"),
    ):
        text = f"# a plan\n{line}\n"
        if not line.startswith("study"):
            text += 'study = "ball.toml"\n'
        file.write_text(text)
        assert main(["shpb", "plan", str(file)]) in (2, 6)
        assert capsys.readouterr().err.startswith(f"{file}:2: {match}")
    for line in ("", between):
        file.write_text('study = "ball.toml"' + line)
        assert main(["shpb", "plan", str(file)]) == 2
        assert "give a number of the study, such as striker.speed" in capsys.readouterr().err
    margins = '[margins]\nsolve = "striker.speed"\nbetween = ["1 m/s", "2 m/s"]\n'
    (tmp_path / "ball.toml").write_text(STUDY.format(E='"60 GPa"') + margins)
    file.write_text('study = "ball.toml"\nfree = "sphere.radius"')
    assert main(["shpb", "plan", str(file)]) == 2
    assert "only what [margins] of the study has may be omitted" in capsys.readouterr().err


def test_a_plan_takes_what_it_is_not_given_from_the_margins_of_the_study(tmp_path: Path) -> None:
    margins = '[margins]\nsolve = "striker.speed"\nbetween = ["0.05 m/s", "2 m/s"]\n'
    (tmp_path / "ball.toml").write_text(STUDY.format(E='"60 GPa"') + margins)
    few: dict[str, Any] = {"study": "ball.toml", "rows": 64, "points": 2}
    plans = []
    for given in ({}, {"free": SPEEDS["free"]}, {"between": SPEEDS["between"]}, SPEEDS):
        plans.append(plan_test(PlanDocument(**few, **given), tmp_path))
    assert plans[0]["values"] == [0.05, 2.0]
    assert all(plan == plans[0] for plan in plans)


def test_a_limit_that_means_no_fracture_stands_for_its_mode_in_a_plan_as_in_a_run(
    tmp_path: Path,
) -> None:
    """Where the study's own tests tell of the centre, no strength of the library does."""
    own = '[limits.centre]\ncriterion = "core_tension"\nstrength = "9 MPa"\nfracture = false\n'
    own += 'aim = "break"\n'
    text = STUDY.format(E='"60 GPa"').replace("[sphere]", '[sphere]\nmaterial = "granite"')
    (tmp_path / "ball.toml").write_text(text + own)
    asked = PlanDocument(study="ball.toml", rows=64, points=2, **SPEEDS)
    plan = plan_test(asked, tmp_path)
    assumed = ["contact crushing (assumed)", "fracture energy (assumed)"]
    assert [*plan["shares"]] == [*plan["reached"]] == ["crushing", *assumed]


def test_a_plan_tells_what_a_run_warns_of(tmp_path: Path) -> None:
    (tmp_path / "ball.toml").write_text(STUDY.format(E='"0.6 GPa"'))
    asked = PlanDocument(study="ball.toml", rows=64, points=2, **SPEEDS)
    warnings = uqsphere.load_study(tmp_path / "ball.toml").warnings
    assert "0.6 GPa is unusual" in "".join(warnings)
    assert {*warnings} <= {*plan_test(asked, tmp_path)["notes"]}


PELLETS = """
title = "Pellets dropped on steel"
seed = 3
[sphere]
E = { dist = "lognormal", mean = "20 GPa", cov = 0.3 }
nu = 0.25
density = "3700 kg/m3"
radius = "6 mm"
[rig]
kind = "impact"
drop_height = "1 m"
[target]
material = "steel"
kind = "thick"
[contact]
law = "hertz"
[limits.broken]
criterion = "core_tension"
strength = { file = "tests.csv", force = "force [kN]", diameter = "12 mm", platens = "rigid" }
aim = "survive"
[margins]
solve = "rig.drop_height"
between = ["0.05 m", "20 m"]
for_probability = [0.01, 0.5]
[analysis]
quantities = ["P_max"]
accuracy = { mean = 0.1, quantile = 0.2, sobol = 0.2, probability = 0.05 }
"""


@pytest.mark.slow
def test_plan_and_run_give_the_same_heights_for_tests_of_spheres_whose_modulus_scatters(
    tmp_path: Path,
) -> None:
    """The scatter of E is in the forces of the tests already: `plan` does not count it twice."""
    rng = np.random.default_rng(12)
    forces = 2.2 * rng.weibull(5.0, 40)
    lines = ["force [kN]", *(f"{force:.4g}" for force in forces)]
    (tmp_path / "tests.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "pellets.toml").write_text(PELLETS)
    asked = PlanDocument(study="pellets.toml", shares=(0.01, 0.5), rows=512)
    reached = plan_test(asked, tmp_path)["reached"]["broken"]
    run = uqsphere.run(uqsphere.load_study(tmp_path / "pellets.toml"))
    frame = run.answers
    margins = frame[(frame.answer == "margin") & (frame.subject == "limits.broken")]
    assert len(reached) == 2
    for wanted in reached:
        height, low, high = wanted["value"]
        at = pd.to_numeric(margins["at"], errors="coerce")
        (margin,) = margins[at == wanted["share"]]["value"]
        assert low <= height <= high
        assert height == pytest.approx(margin, rel=0.03)


def test_a_law_that_no_solid_has_asks_for_its_units(tmp_path: Path) -> None:
    frame = loading()
    frame["u [um]"] *= 30
    notes = fit(frame, tmp_path).notes
    for key in ("onset_pressure", "hardness"):
        (note,) = [note for note in notes if note.startswith(key)]
        assert "is unusual. Are the units right?" in note
    assert not [note for note in fit(loading(), tmp_path).notes if "unusual" in note]
    frame["u [um]"] *= 1e1
    with pytest.raises(UsageError, match=r"more than the diameter.*another unit"):
        fit(frame, tmp_path)


BAR = """
[incident_bar]
material = "steel"
diameter = "20 mm"
length = "1 m"
gauge = "0.5 m"
[receiving_bar]
gauge = "0.4 m"
[record]
file = "x.csv"
"""


@pytest.mark.parametrize(
    ("lab", "text", "says"),
    [
        (ContactDocument, 'file = "x.csv"\ndiameter = "1 mm"\nplatens = "stel"', "mean 'steel'"),
        (PlanDocument, 'study = "s.toml"\nbetween = []', "between[1]: a value is missing here"),
        (
            RecordDocument,
            'title = ""\n[incident_bar]\nE = "1 GPa"\nmaterial = ["steel"]',
            "lab.toml:4: incident_bar.material: unknown material an array of 1, known: ",
        ),
        (
            RecordDocument,
            '[incident_bar]\n[receiving_bar]\nmaterial = "stel"',
            'lab.toml:3: receiving_bar.material: unknown material "stel"',
        ),
        (
            RecordDocument,
            BAR.replace("0.5 m", "2 m"),
            "lab.toml:6: incident_bar.gauge: must be on the bar of 1 m, not at 2 m",
        ),
        (RecordDocument, BAR + 'sample_interval = "0 us"', "lab.toml:11: record.sample_interval: "),
        (
            ComminutionDocument,
            '[tests]\nfile = "x"\ngamma = 99.0\nspecific_energy = "e"\nenergy_is = "sphere"\n'
            'diameter = "d"\noutcome = "o"',
            "lab.toml:3: tests.gamma: must be between 0.5 and 50",
        ),
        (
            ComminutionDocument,
            '[feed]\nspeed = "1 m/s"\n[feed.sizes]\nlaw = "table"',
            'lab.toml:4: feed.sizes.law: law = "table" requires file and sieve and passing',
        ),
        (
            ComminutionDocument,
            '[material]\nmaterial = "limeston"',
            'lab.toml:2: material.material: unknown material "limeston"',
        ),
        (ComminutionDocument, "[material]\nnu = true", "lab.toml:2: material.nu: must be a number"),
        (ContactDocument, 'file = "x.csv"\npile_up = true', "lab.toml:2: pile_up: must be a "),
        (ComminutionDocument, "[product]\nalpha = -1.0", "product.alpha: must be greater than 0"),
        (ComminutionDocument, "[feed.sizes]\nn = inf", "feed.sizes.n: must be a finite number"),
    ],
)
def test_a_wrong_key_of_a_lab_is_told_by_its_line(
    tmp_path: Path, lab: Any, text: str, says: str
) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(text)
    with pytest.raises(StudyError) as caught:
        load_document(path, lab)
    assert says in str(caught.value)
