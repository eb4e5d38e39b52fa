"""How many tests: fixed designs against their tables, the next test against a posterior that had it."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from uqsphere.arrays import Array
from uqsphere.cli import main
from uqsphere.feed import laws
from uqsphere.feed.infer import Request, fit
from uqsphere.feed.plan import Option, complete, go_no_go, information, normal, options, plan_tests
from uqsphere.feed.tests import make_specimens

RNG = np.random.default_rng
TRUTH = {"e_inf": 55.0, "d0": 0.008, "phi": 1.0, "sigma": 0.6}
STUDY = """
title = "Limestone, made up"
[material]
name = "limestone"
[tests]
file = "t.csv"
made_up = true
rig = "platens"
diameter = "d"
diameter_unit = "mm"
specific_energy = "e"
specific_energy_unit = "J/kg"
energy_is = "sphere"
outcome = "out"
"""


def energies(d: Array, seed: int) -> Array:
    p = {**TRUTH, "ratio": 4.0, "median": laws.median_energy("tavares", d, TRUTH)}
    return laws.LAWS["lognormal"].quantile(RNG(seed).random(d.size), p)


@pytest.mark.parametrize(
    ("tests", "sigma", "up", "down", "low", "high"),
    [(10, 0.5, 43, -30, 0.69, 1.83), (20, 0.7, 39, -28, 0.76, 1.46), (50, 0.9, 29, -23, 0.84, 1.25)],
)
def test_complete_tests(tests: int, sigma: float, up: float, down: float, low: float, high: float) -> None:
    found = complete(tests, sigma)
    assert [round(100 * (found[1] - 1)), round(100 * (found[0] - 1))] == [up, down]
    assert [round(part, 2) for part in found[2:]] == [low, high]


@pytest.mark.parametrize(
    ("levels", "centre", "scatter"),
    [((0.0,), 1.57, math.inf), (np.linspace(-1.5, 1.5, 5), 2.26, 2.79), ((-1.138, 1.138), 2.55, 1.97),
     (np.linspace(-0.5, 2.5, 5), 3.33, 4.12)],
)  # fmt: skip
def test_go_no_go_designs(levels: tuple[float, ...], centre: float, scatter: float) -> None:
    found = go_no_go(levels)
    assert [round(part, 2) if math.isfinite(part) else part for part in found] == [centre, scatter]


def test_the_next_test_against_one_that_is_made() -> None:
    """Mean variance over both outcomes, each weighted draws, is that of posteriors that had the outcome."""
    d = np.repeat([0.005, 0.015], 8)
    e = energies(d, 3)
    request = Request(law="lognormal", seed=2)
    posterior, _ = fit(make_specimens(d, e), request)
    target = np.log(posterior.energy_at(0.5, 0.015))
    (best, *_) = [one for one in options(posterior, target, (0.015,)) if not one.measured and one.blows == 1]
    share = float(posterior.broken(best.energy, 0.015).mean())
    left = 0.0
    for broke, weight in ((True, share), (False, 1.0 - share)):
        more = make_specimens([*d, 0.015], [*e, best.energy], broke=[*[True] * d.size, broke],
                              exact=[*[True] * d.size, False])  # fmt: skip
        after, _ = fit(more, request)
        left += weight * float(np.log(after.energy_at(0.5, 0.015)).var())
    assert best.sd < target.std()
    assert best.sd == pytest.approx(math.sqrt(left), rel=0.06)


def test_information_of_plain_lognormal_tests() -> None:
    """1 and 0.5 over sigma² of a measured energy; one at the median 1/1.57 of that."""
    posterior, _ = fit(make_specimens(np.full(60, 0.01), energies(np.full(60, 0.01), 5)),
                       Request(law="lognormal", size="class", ratio=math.inf))  # fmt: skip
    about = normal(posterior, np.log(posterior.draws["e50_1"]))
    sigma = math.exp(about.mean[about.names.index("sigma")])
    place = about.names.index("e50_1")
    measured = information(about, Option(size=0.01, energy=None))[place, place]
    middle = float(np.exp(about.mean[place]))
    offered = information(about, Option(size=0.01, energy=middle))[place, place]
    assert offered == pytest.approx(2.0 / math.pi / sigma**2, rel=1e-3)
    assert measured == pytest.approx(1.0 / sigma**2, rel=0.06)


def test_a_plan_names_what_narrows_the_target() -> None:
    d = np.repeat([0.004, 0.01, 0.02], 8)
    posterior, _ = fit(make_specimens(d, energies(d, 6)), Request(seed=4))
    target = np.log(posterior.energy_at(0.5, 0.02))
    plan = plan_tests(posterior, target, "x", 0.2, (0.004, 0.009, 0.02), relative=True)
    assert plan.measured.size == 0.02
    assert plan.now > plan.after[1] > plan.after[10] > plan.after[30]
    assert plan.needed is not None
    assert plan.worth > 1.0
    # a forecast of ten more, against ten more
    more = np.r_[d, np.full(10, 0.02)]
    widths = []
    for seed in range(4):
        after, _ = fit(make_specimens(more, np.r_[energies(d, 6), energies(np.full(10, 0.02), 50 + seed)]),
                       Request(seed=4))  # fmt: skip
        widths.append(1.96 * np.log(after.energy_at(0.5, 0.02)).std())
    assert plan.after[10] == pytest.approx(float(np.mean(widths)), rel=0.2)


@pytest.fixture
def study(tmp_path: Path) -> Path:
    d = np.repeat([0.004, 0.01, 0.02], 6)
    rows = "".join(f"{1e3 * a:g},{b:.6g},broke\n" for a, b in zip(d, energies(d, 7), strict=True))
    (tmp_path / "t.csv").write_text("d,e,out\n" + rows, encoding="utf-8")
    path = tmp_path / "study.toml"
    path.write_text(STUDY, encoding="utf-8")
    return path


def test_commands(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = study.parent / "out"
    assert main(["fit", str(study), "--out", str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["made_up"] is True
    assert found["tests"]["particles"] == 18
    assert {"draws.csv", "fit.json", "report.html"} <= {path.name for path in out.iterdir()}
    assert main(["fit", str(study), "--out", str(out)]) == 0
    text = capsys.readouterr().out
    assert "breaks half" in text
    assert "weibull" in text
    assert main(["plan-tests", str(study), "--at", "20 mm", "--json"]) == 0
    plan = json.loads(capsys.readouterr().out)
    assert plan["next"]["now"] > plan["next"]["after"]["30"]
    assert plan["complete"]["20"]["0.7"][1] == pytest.approx(1.39, abs=0.005)
    assert main(["plan-tests", str(study), "--precision", "0.15"]) == 0
    assert "the precision asked for takes" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [(["--at", "-3 mm"], "must be above 0"), (["--at", "20 kg"], "--at"), (["--precision", "0"], "above 0 is due")],
)
def test_plans_refused(study: Path, arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan-tests", str(study), *arguments]) == 2
    assert says in capsys.readouterr().err


def test_a_study_without_tests(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "study.toml"
    path.write_text(
        '[material]\nname = "limestone"\n[feed]\n'
        'sizes = { law = "rosin_rammler", d63 = "30 mm", n = 1.2, top = "71 mm" }\n'
        'energy = { specific = "100 J/kg" }\n', encoding="utf-8")  # fmt: skip
    assert main(["fit", str(path)]) == 2
    assert "has no [tests]" in capsys.readouterr().err
    assert main(["plan-tests", str(path)]) == 0
    assert "first batch" in capsys.readouterr().out
