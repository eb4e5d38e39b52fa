"""Verdicts: the ways to break that are judged, their probability against draws of all strengths, and every reason."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import uqsphere
from uqsphere.materials import library
from uqsphere.mechanics.criteria import CRITERIA, demand
from uqsphere.mechanics.validity import Rule, grades
from uqsphere.runner.evaluate import Ledger, Work
from uqsphere.runner.evidence import gather_early
from uqsphere.runner.finished import Run
from uqsphere.study import Limit, load_study
from uqsphere.study.study import breaks_by, means_fracture, ways_of
from uqsphere.uq.law import make_law
from uqsphere.uq.limit_state import LimitState
from uqsphere.uq.union import make_union

STUDIES = Path(uqsphere.__file__).parent.parent / "studies"

HEAD = """\
[sphere]
material = "{rock}"
E        = {{ dist = "lognormal", mean = "52 GPa", cov = 0.12 }}
radius   = "10 mm"
[bars]
material = "maraging_steel"
diameter = "40 mm"
infinite = true
[striker]
speed  = {{ dist = "normal", mean = "0.42 m/s", cov = 0.02 }}
[pulse]
shape = "step"
[model]
fidelity = "massless"
horizon = "1 ms"
[analysis]
quantities = ["p_max"]
accuracy = {{ mean = 0.1, quantile = 0.2, sobol = 0.2, probability = 0.2 }}
budget = {{ evaluations = 40_000 }}
methods = ["qmc"]
{more}
"""
CONTACT = '[limits.contact]\nquantity = "p_max"\nstrength = { dist = "weibull", mean = "%s", modulus = 12 }\n'
CORE = '[limits.core]\ncriterion = "core_tension"\nstrength = { dist = "weibull", mean = "%s", modulus = 10 }\n'


def found(folder: Path, limits: str, rock: str = "granite", more: str = "") -> Run:
    """A run of a small study with some limits."""
    path = folder / "study.toml"
    path.write_text(HEAD.format(rock=rock, more=more) + limits, encoding="utf-8")
    return uqsphere.run(load_study(path), out=folder / "out")


def codes(run: Run, limit: str) -> set[str]:
    """Codes of the reasons of a limit's verdict."""
    return {reason.code for reason in run.results.limits[limit].reasons}


# --- which ways ---------------------------------------------------------------------------------------------


def test_every_way_that_a_rock_has_no_limit_for_is_assumed_or_named() -> None:
    study = load_study(STUDIES / "granite.toml")
    ways = ways_of(study)
    assert [way.called for way in ways.assumed] == ["ring crack", "core tension", "fracture energy"]
    assert ways_of(load_study(STUDIES / "granite.toml", ["analysis.ways=given"])).assumed == ()
    sandstone = ways_of(load_study(STUDIES / "granite.toml", ["sphere.material=sandstone"]))
    assert [way.called for way in sandstone.assumed] == ["ring crack"]
    assert set(sandstone.not_judged) == {"core tension", "fracture energy"}
    assert all(why.startswith("no strength") for why in sandstone.not_judged.values())
    for name in ("glass_bead_small_bar", "ishigami"):
        assert ways_of(load_study(STUDIES / f"{name}.toml")).assumed == ()


def test_an_assumed_strength_is_the_librarys_for_this_size() -> None:
    energy = library()["sphere"]["granite"].properties["fracture_energy"]
    small, large = (
        ways_of(load_study(STUDIES / "granite.toml", [f"sphere.radius={radius}"])).assumed[2]
        for radius in ("1 mm", "10 mm")
    )
    for way, diameter in ((small, 2e-3), (large, 2e-2)):
        due = energy.value * (1.0 + (energy.further["size"] / diameter) ** energy.further["exponent"])
        assert way.limit.strength.ppf(np.array([0.5]))[0] == pytest.approx(due, rel=1e-12)
        assert way.weak.ppf(np.array([0.5]))[0] < due < way.strong.ppf(np.array([0.5]))[0]


def test_a_tension_strength_is_carried_by_the_size_law() -> None:
    """Twice the volume of the tests means a strength 2^(1/m) higher in the sphere."""
    way = ways_of(load_study(STUDIES / "granite.toml")).assumed[1]
    columns = {"p_max": np.array([2.5e9]), "a_max": np.array([6e-4]), "sphere.radius": 0.01, "sphere.nu": 0.25}
    criterion = CRITERIA[str(way.limit.criterion)]
    one = demand(criterion, columns, way.limit.parameters)
    twice = {**way.limit.parameters, "reference_volume": 2.0 * way.limit.parameters["reference_volume"]}
    ratio = demand(criterion, columns, twice) / one
    assert ratio == pytest.approx(2.0 ** (-1.0 / way.limit.parameters["modulus"]), rel=1e-12)


def test_what_a_limit_breaks_by() -> None:
    places = {name: breaks_by(Limit(name="a", quantity=name, strength=1.0))
              for name in ("p_max", "core_tension", "specific_energy", "P_max", "contact_time")}  # fmt: skip
    assert places == {"p_max": "contact", "core_tension": "core", "specific_energy": "energy", "P_max": "force",
                      "contact_time": ""}  # fmt: skip
    assert means_fracture(Limit(name="a", quantity="p_max", strength=1.0, fracture=False, aim="break"))
    assert not means_fracture(Limit(name="a", quantity="p_max", strength=1.0, fracture=False))


# --- probabilities ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("missed", [False, True])
@pytest.mark.parametrize("tie", [0.0, 0.7])
def test_a_union_of_what_is_exceeded_and_of_what_is_not_against_draws(missed: bool, tie: float) -> None:
    rng = np.random.default_rng(7)
    laws = [make_law("normal", {"mean": 3.0, "sd": 1.0}), make_law("weibull", {"mean": 4.0, "modulus": 5.0})]
    demands = rng.uniform(1.0, 5.0, (2, 16, 400))
    states = [LimitState(demands=one, strength=law) for one, law in zip(demands, laws, strict=True)]
    factor = np.linalg.cholesky(np.array([[1.0, tie], [tie, 1.0]]))
    together = make_union(states, factor, rng, missed=missed).any.mean()
    normals = rng.standard_normal((40, *demands.shape[1:], 2)) @ factor.T
    strengths = np.stack([law.from_normal(normals[..., k]) for k, law in enumerate(laws)])
    exceeded = demands[:, None] > strengths
    drawn = (~exceeded if missed else exceeded).any(axis=0)
    error = drawn.mean(axis=(0, 2)).std(ddof=1) / 4.0
    assert abs(together - drawn.mean()) < 4.0 * error


def test_limits_are_judged_together_whatever_each_says(tmp_path: Path) -> None:
    """Contact alone is met; with the core it is not, nor can both break where only one does."""
    limits = CONTACT % "4 GPa" + "target = 0.05\n" + CORE % "30 MPa"
    run = found(tmp_path, limits, more='ways = "given"')
    contact = run.results.limits["contact"]
    assert (contact.met, contact.verdict, codes(run, "contact"), run.met) == (True, "not met", {"together"}, False)
    entry = run.results.verdicts[0]
    assert (entry.governing, [one.name for one in entry.judged]) == ("core", ["contact", "core"])
    core = run.results.limits["core"].exceedance.number
    assert core <= entry.miss.number <= core + contact.miss.number + 1e-12


def test_to_break_every_way_must_be_exceeded(tmp_path: Path) -> None:
    limits = (CONTACT % "1.5 GPa" + 'aim = "break"\ntarget = 0.05\n') + (CORE % "60 MPa" + 'aim = "break"\n')
    run = found(tmp_path, limits, more='ways = "given"')
    assert run.results.limits["contact"].met is True
    assert run.results.limits["contact"].verdict == "not met"
    assert run.results.verdicts[0].governing == "core"


# --- reasons ------------------------------------------------------------------------------------------------


def test_rows_along_the_speed_are_made_where_a_curve_moves(tmp_path: Path) -> None:
    limits = CONTACT % "4 GPa" + "target = 0.05\n"
    head = HEAD.replace("40_000", "200_000").format(rock="granite", more="")
    margins = '[margins]\nsolve = "striker.speed"\nbetween = ["0.01 m/s", "10 m/s"]\nfor_probability = [0.05]\n'
    path = tmp_path / "study.toml"
    path.write_text(head + margins + limits, encoding="utf-8")
    work = Work(study=load_study(path), store=None, ledger=Ledger(), fidelity="full")
    early = gather_early(work)
    assert early is not None
    run = uqsphere.run(load_study(path), out=tmp_path / "out")
    taken = {one.part: one.taken for one in run.results.plan.parts}
    # beside them the sample, as it is, where contacts yield, and for the checks of the model
    assert 1 <= (taken["ways to break"] - early.evaluations) / taken["sampling"] <= 3
    curves = np.array([[p for _, p in one.curve] for one in run.results.verdicts[0].judged if one.assumed])
    values, made = np.geomspace(0.01, 10.0, 25), list(early.along)
    assert [value for value, _ in run.results.verdicts[0].judged[-1].curve] == made
    places = [int(np.argmin(np.abs(values - value))) for value in made]
    assert values[places] == pytest.approx(made)
    for begin in range(0, 24, 4):
        moved = np.abs(curves[:, places.index(begin)] - curves[:, places.index(begin + 4)]).max() > 0.1 * 0.05
        assert [place in places for place in range(begin + 1, begin + 4)] == 3 * [moved]


def test_an_assumed_strength_that_turns_a_verdict_leaves_it_not_established(tmp_path: Path) -> None:
    run = found(tmp_path, CONTACT % "4 GPa" + "target = 0.05\n")
    limit = run.results.limits["contact"]
    assert (limit.met, limit.verdict, codes(run, "contact"), run.met) == (True, "not established", {"c"}, False)
    judged = {one.name: one for one in run.results.verdicts[0].judged}
    low, high = judged["ring crack"].range or (1.0, 0.0)
    assert low < judged["ring crack"].miss.number < high
    assert judged["ring crack"].assumed
    assert not judged["contact"].assumed
    # what is missed by the study's own strengths no other way can mend
    (tmp_path / "weak").mkdir()
    assert (
        found(tmp_path / "weak", CONTACT % "2 GPa" + "target = 0.05\n").results.limits["contact"].verdict == "not met"
    )


def test_glass_and_a_study_that_wants_no_ways_are_judged_by_their_limits(tmp_path: Path) -> None:
    run = found(tmp_path, CONTACT % "4 GPa" + "target = 0.05\n", rock="soda_lime_glass")
    assert (run.results.limits["contact"].verdict, run.met) == ("met", True)
    assert run.results.verdicts[0].not_judged == {}


def _with_tests(folder: Path, count: int, extra: str = "") -> str:
    """A limit on the contact pressure whose strength was fitted to so many tests, all near 4 GPa."""
    law = make_law("weibull", {"mean": 4.0, "modulus": 12.0})
    values = law.ppf((np.arange(count) + 0.5) / count)
    (folder / "tests.csv").write_text("strength\n" + "\n".join(f"{value:.6f}" for value in values) + "\n")
    strength = (
        f'{{ dist = "empirical", file = "tests.csv", column = "strength", unit = "GPa", fit = "weibull"{extra} }}'
    )
    return f'[limits.contact]\nquantity = "p_max"\nstrength = {strength}\ntarget = 0.05\n'


@pytest.mark.parametrize(("count", "due"), [(4, {"d"}), (400, set())])
def test_few_tests_leave_a_verdict_not_established(tmp_path: Path, count: int, due: set[str]) -> None:
    run = found(tmp_path, _with_tests(tmp_path, count), more='ways = "given"')
    limit = run.results.limits["contact"]
    assert limit.met is True
    assert codes(run, "contact") == due
    assert limit.verdict == ("not established" if due else "met")


def test_tests_that_are_made_up_establish_nothing(tmp_path: Path) -> None:
    run = found(tmp_path, _with_tests(tmp_path, 400, ", made_up = true"), more='ways = "given"')
    assert codes(run, "contact") == {"f"}
    assert run.results.limits["contact"].verdict == "not established"


def test_a_model_that_fails_where_the_aim_is_missed_establishes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(scene: Any, answers: Any) -> dict[str, Any]:
        rule = Rule(name="x", meaning="pressure", measure=lambda scene, answers: answers.values["p_max"], failure=3.2e9,
                    words="")  # fmt: skip
        return {"pressure": grades(rule, answers.values["p_max"])}

    monkeypatch.setattr("uqsphere.mechanics.validity.grades_of", failing)
    run = found(tmp_path, CONTACT % "4 GPa" + "target = 0.05\n", more='ways = "given"')
    assert codes(run, "contact") == {"e"}


# --- beyond the laws of the strengths -----------------------------------------------------------------------


def test_a_verdict_that_turns_where_contacts_yield_is_not_established(tmp_path: Path) -> None:
    """Between soft bars the true pressure is that at which they flow: an elastic one beyond it breaks nothing."""
    limits = CONTACT % "2.5 GPa" + "target = 0.05\n"
    run = found(tmp_path, limits.replace("modulus = 12", "modulus = 60"), more='ways = "given"')
    assert run.results.limits["contact"].verdict == "not met"
    soft = tmp_path / "soft"
    soft.mkdir()
    path = soft / "study.toml"
    text = (
        (tmp_path / "study.toml")
        .read_text()
        .replace('"maraging_steel"', '"maraging_steel"\nyield_strength = "900 MPa"')
    )
    path.write_text(text)
    run = uqsphere.run(load_study(path), out=soft / "out")
    assert run.results.limits["contact"].met is False
    assert (codes(run, "contact"), run.results.limits["contact"].verdict) == ({"a"}, "not established")


def test_carriers_that_disagree_leave_a_service_not_established(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    head = HEAD.format(rock="granite", more="").split("[bars]")[0]
    path.write_text(
        head + '[rig]\nkind = "none"\n[service.chute]\nkind = "impact"\nspeed = "5.5 m/s"\n'
        'target = { kind = "thick", material = "steel" }\nsolve = "speed"\nbetween = ["1 m/s", "20 m/s"]\n'
        "[analysis]\naccuracy = { mean = 0.1, quantile = 0.2, sobol = 0.2, probability = 0.2 }\n"
        'methods = ["qmc"]\nways = "given"\n[limits.core]\nin = "chute"\ncriterion = "core_tension"\n'
        'strength = { dist = "weibull", mean = "32 MPa", modulus = 20 }\nplatens = "rigid"\ntarget = 0.01\n'
    )
    run = uqsphere.run(load_study(path), out=tmp_path / "out")
    limit = run.results.services["chute"].limits["core"]
    assert len({limit.met, *limit.carried.met.values()}) > 1
    assert "b" in {reason.code for reason in limit.reasons}
    assert (limit.verdict, run.met) == ("not established", False)
