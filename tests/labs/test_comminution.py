"""Laws of single particles, their posterior, and a feed under blows against closed forms and
`feed_cases.json`.
"""

from __future__ import annotations

import json
import math
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ndtr

import uqsphere
from uqsphere.cli import main
from uqsphere.errors import UsageError
from uqsphere.labs.comminution import laws
from uqsphere.labs.comminution.document import (
    ComminutionDocument,
    FeedTable,
    ProductTable,
    SizesTable,
)
from uqsphere.labs.comminution.feed import answer_feed, broken_by_blow, load_classes, population
from uqsphere.labs.comminution.fit import PRIORS, EnergyModel, Fit, Posterior, fit, log_likelihoods
from uqsphere.labs.comminution.tests import Specimens, load_tests

ROOT = Path(__file__).parents[2]
CASES = json.loads((ROOT / "tests/data/feed_cases.json").read_text())
EXACT = 1e-12


def document(**changes: Any) -> ComminutionDocument:
    tests = {
        "file": "tests.csv",
        "diameter": "d [mm]",
        "specific_energy": "e [J/kg]",
        "energy_is": "sphere",
        "outcome": "outcome",
        **changes.pop("tests", {}),
    }
    tests = {key: value for key, value in tests.items() if value is not None}
    return ComminutionDocument(**{"material": {"material": "limestone"}, "tests": tests, **changes})


def specimens(diameter: Any, energy: Any, broke: Any = True, exact: Any = True) -> Specimens:
    d, e, b, x = np.broadcast_arrays(
        np.asarray(diameter, dtype=float), np.asarray(energy, dtype=float), broke, exact
    )
    return Specimens(
        diameter=d.copy(),
        blows=e[:, None].copy(),
        broke=b.copy(),
        exact=x & b,
        weight=np.ones(len(d)),
    )


def one_draw(**parameters: float) -> Posterior:
    """A posterior of one known truth."""
    size = "tavares" if "e_inf" in parameters else "power"
    ratio = parameters.pop("ratio", 4.0)
    model = EnergyModel(
        law="lognormal", size=size, ratio=ratio, priors=dict.fromkeys(parameters, (0.0, 1.0))
    )
    values = {name: np.array([value]) for name, value in parameters.items()}
    return Posterior(
        models=(model,),
        law=np.zeros(1, dtype=int),
        parameters={"gamma": np.array([4.0]), **values},
        tested=(0.001, 0.1),
        tests=40,
    )


# --- laws -----------------------------------------------------------------------------------------


def test_energy_of_a_force_and_the_share_of_the_particle() -> None:
    h = CASES["hertz"]
    own, other = h["E"] / (1 - h["nu"] ** 2), h["Es"] / (1 - h["nus"] ** 2)
    modulus = 1.0 / (1.0 / own + 1.0 / other)
    assert modulus == pytest.approx(h["Estar"], rel=EXACT)
    mass = laws.mass_of(h["d"], h["density"])
    assert float(laws.energy_of_force(h["force"], h["d"], modulus, mass)) == pytest.approx(
        h["specific"], rel=EXACT
    )
    assert laws.particle_share(own, other) == pytest.approx(h["particle_share"], rel=EXACT)


@pytest.mark.parametrize("case", CASES["damage"], ids=lambda c: f"{c['gamma']}-{c['q']}")
def test_damage_of_a_blow(case: dict[str, float]) -> None:
    q, left = case["q"], (1.0 - case["D"]) / case["q"]
    assert float(laws.before_blow(left, case["gamma"])) == pytest.approx(
        max(1.0 / q, 1.0), rel=1e-10
    )


def damage(share: float, gamma: float) -> float:
    """D of a blow of E/e, (L4)."""
    return (
        float(
            brentq(
                lambda d: d ** (2.5 / gamma) * (2 * gamma + 5 - 5 * d) / (2 * gamma) - share,
                0.0,
                1.0,
                xtol=1e-14,
            )
        )
        if share < 1.0
        else 1.0
    )


@pytest.mark.parametrize("gamma", CASES["thresholds"])
def test_thresholds_of_equal_blows(gamma: str) -> None:
    found = laws.thresholds(float(gamma), 20)
    np.testing.assert_allclose(found, CASES["thresholds"][gamma], rtol=1e-11)
    equal = [float(laws.survivor_bound(np.ones(n), float(gamma))) for n in range(1, 6)]
    np.testing.assert_allclose(equal, found[1:6], rtol=1e-11)
    # blow by blow: what is just below the bound breaks at the last blow, what is just above does
    # not
    for wide, breaks in ((1.0 - 1e-6, True), (1.0 + 1e-6, False)):
        left = wide * found[5]
        for _ in range(4):
            left = left * (1.0 - damage(1.0 / left, float(gamma)))
        assert bool(left <= 1.0) is breaks


@pytest.mark.parametrize("case", CASES["law"], ids=str)
def test_broken_share_and_its_inverse(case: dict[str, float]) -> None:
    ratio = case["ratio"] or math.inf
    lognormal = laws.Scatter("lognormal", case["E50"], case["sigma"], ratio)
    share = lognormal.broken_share(case["e"])
    assert float(share) == pytest.approx(case["cdf"], rel=EXACT)
    if 0.0 < case["cdf"] < 1.0 - 1e-9:
        assert float(lognormal.energy_at(share)) == pytest.approx(case["e"], rel=1e-9)
    weibull = laws.Scatter("weibull", case["E50"], 3.0, ratio)
    back = weibull.energy_at(weibull.broken_share(case["e"]))
    assert float(back) == pytest.approx(case["e"], rel=1e-9)


@pytest.mark.parametrize("case", CASES["size_laws"], ids=str)
def test_size_laws_are_not_interchangeable(case: dict[str, float]) -> None:
    for size in ("tavares", "king"):
        found = laws.median_energy(size, case["d"], *SIZED)
        assert float(found) == pytest.approx(case[size], rel=EXACT)


SIZED = (213.5, 1.22, 8.07e-3)


@pytest.mark.parametrize("case", CASES["tn"], ids=lambda c: f"{c['n']}-{c['t10']}")
def test_other_finenesses_from_t10(case: dict[str, float]) -> None:
    for key, curve, alpha in (("trr08", "trr", 0.8), ("trr1", "trr", 1.0), ("milin", "milin", 1.0)):
        assert float(laws.t_n(case["n"], case["t10"], curve, alpha)) == pytest.approx(
            case[key], rel=1e-11
        )
    assert float(laws.t_n(0.5, case["t10"], "trr", 0.6)) == 1.0


# --- tests to a posterior -------------------------------------------------------------------------


def test_thirty_tests_of_one_size_have_the_exact_intervals() -> None:
    case = CASES["G1"]
    tests = specimens(0.02, case["energy"])
    found = fit(tests, document(tests={"law": "lognormal", "ratio": math.inf}))
    for name, key in (("e50_1", "E50"), ("sigma", "sigma")):
        one = found.content["parameters"][name]
        low, middle, high = case["exact95"][key]
        assert [one["low"], one["value"], one["high"]] == pytest.approx(
            [low, middle, high], rel=0.02
        )
    assert found.content["laws"]["lognormal"]["log_likelihood"] == pytest.approx(
        case["loglik"], abs=1e-6
    )
    value = log_likelihoods(found.posterior.models[0], tests)
    best = np.log([case["mle"]["E50"], case["mle"]["sigma"]])
    assert float(value(best).sum()) == pytest.approx(case["loglik"], abs=1e-9)


def test_intervals_of_go_no_go_come_from_the_tail_that_both_ends_lie_in() -> None:
    tests = Specimens(
        diameter=np.full(3, 0.01),
        blows=np.array([[100.0], [1e-9], [380.0]]),
        weight=np.ones(3),
        broke=np.array([True, True, False]),
        exact=np.zeros(3, dtype=bool),
    )
    model = EnergyModel(
        law="lognormal",
        size="power",
        ratio=4.0,
        priors={"C": (0, 1), "phi": (0, 1), "sigma": (0, 1)},
    )
    x = np.log([100.0 * 0.01**0.5, 0.5, 0.6])
    found = log_likelihoods(model, tests)(x)
    z = np.array([math.log(100.0 / 0.75 / 100.0), 0.0, math.log(380.0 / 0.05 / 100.0)]) / 0.6
    assert found[0] == pytest.approx(math.log(ndtr(z[0])), rel=1e-9)
    assert -2000.0 < found[1] < -500.0  # the far tail, not minus infinity
    assert found[2] == pytest.approx(math.log(ndtr(-z[2])), rel=1e-9)


def made_up(rng: np.random.Generator, each: int = 12) -> Specimens:
    """Energies at failure of 2 to 20 mm, of E_inf 60 J/kg, d0 6 mm, phi 1.1, sigma 0.55, E_max/E50
    4.
    """
    d = np.repeat([0.002, 0.005, 0.01, 0.02], each)
    median = laws.median_energy("tavares", d, 60.0, 1.1, 0.006)
    return specimens(d, laws.Scatter("lognormal", median, 0.55, 4.0).energy_at(rng.random(len(d))))


@pytest.fixture(scope="module")
def fitted() -> Fit:
    return fit(made_up(np.random.default_rng(5)), document())


def test_the_size_law_holds_the_truth_and_its_diagnostics_settle(fitted: Fit) -> None:
    content = fitted.content
    for one in content["sizes"]:
        truth = float(laws.median_energy("tavares", one["diameter"], 60.0, 1.1, 0.006)) * 0.8
        assert one["breaks_half"]["low"] < truth < one["breaks_half"]["high"]
    assert all(one["settled"] for one in content["laws"].values())
    assert sum(one["weight"] for one in content["laws"].values()) == pytest.approx(1.0)
    # the family decides how little breaks 1 %: both are in the average
    assert set(np.unique(fitted.posterior.law)) == {0, 1}


def test_tests_that_do_not_overlap_show_no_scatter() -> None:
    energy, broke = [50.0, 100.0, 200.0, 400.0], np.array([False, False, True, True])
    with pytest.raises(UsageError, match="do not show how strengths scatter"):
        fit(specimens(0.01, energy, broke, exact=False), document(tests={"law": "lognormal"}))
    given = document(
        tests={"law": "lognormal", "prior": {"sigma": {"log_mean": -0.7, "log_sd": 0.3}}}
    )
    (size,) = fit(specimens(0.01, energy, broke, exact=False), given).content["sizes"]
    assert 50.0 < size["breaks_half"]["value"] < 400.0


def test_moduli_that_no_strength_has_are_refused_without_a_warning() -> None:
    prior = {"modulus": {"log_mean": -9.0, "log_sd": 0.3}}
    broke = np.array([True, False, True, True])
    asked = document(tests={"law": "weibull", "prior": prior}, draws=200)
    fitted = fit(specimens(0.02, [10.0, 30.0, 40.0, 60.0], broke), asked)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(UsageError, match=r"Weibull moduli down to .*prior\.modulus"):
            fitted.posterior.strength_csv(0.02)


def test_every_specimen_has_one_size() -> None:
    """Of sizes in a row, each close to the next, none is left out."""
    tests = specimens(0.01 * 1.004 ** np.arange(8.0), 10.0)
    (group,) = tests.sizes.values()
    assert group.all()
    both = specimens([0.01, 0.02, 0.01], 10.0).sizes
    assert [group.tolist() for group in both.values()] == [
        [True, False, True],
        [False, True, False],
    ]


def test_the_page_of_the_lab_has_every_key() -> None:
    text = (ROOT / "docs/lab-comminution.md").read_text("utf-8")
    text += (ROOT / "studies/lab_limestone_feed.toml").read_text("utf-8")
    own = ComminutionDocument.model_fields["tests"].annotation
    assert own is not None
    tables = [ComminutionDocument, own, SizesTable, FeedTable, ProductTable]
    keys = [key for table in tables for key in table.model_fields]
    assert [key for key in keys if not re.search(rf"\b{key}\b", text)] == []


def test_one_break_beside_survivors_shows_no_scatter() -> None:
    """Without a second energy at failure the scatter may be as small as any."""
    tests = specimens(0.01, [5.0, 50.0], np.array([False, True]))
    with pytest.raises(UsageError, match="do not show how strengths scatter"):
        fit(tests, document())


@pytest.mark.parametrize("exact", [False, True])
def test_breaks_and_survivors_at_one_energy_show_no_scatter(exact: bool) -> None:
    """Half of them break at their median, however little strengths scatter."""
    broke = np.array([True, False, True, False])
    with pytest.raises(UsageError, match="do not show how strengths scatter"):
        fit(specimens(0.01, [50.0] * 4, broke, exact=exact), document())
    sizes = np.array([0.01, 0.01, 0.02, 0.02])
    if exact:
        with pytest.raises(UsageError, match="do not show how strengths scatter"):
            fit(specimens(sizes, [50.0] * 4, broke), document())


def test_a_prior_that_no_test_agrees_with_is_refused() -> None:
    prior = {"phi": {"log_mean": 1e5, "log_sd": 1e-9}}
    tests = specimens([0.01, 0.02, 0.01, 0.02], [10.0, 30.0, 40.0, 60.0])
    with pytest.raises(UsageError, match="Is a prior far out"):
        fit(tests, document(tests={"law": "lognormal", "prior": prior}, draws=200))


@pytest.mark.parametrize("size", ["-5", "0"])
def test_a_size_that_is_none_is_refused(tmp_path: Path, size: str) -> None:
    """The mean of a sieve above and one below is a root of a square, which has no sign."""
    lines = ["d [mm],e [J/kg],outcome", f"{size},10,broke", "8,20,survived", "8,30,broke"]
    (tmp_path / "t.csv").write_text("\n".join(lines))
    asked = document(tests={"file": "t.csv", "diameter": "d", "specific_energy": "e"})
    with pytest.raises(UsageError, match="line 2: the size must be above 0"):
        load_tests(asked, tmp_path)


def test_a_size_of_no_particle_asks_for_its_unit(tmp_path: Path) -> None:
    lines = ["d [mm],e [J/kg],outcome", "8000,10,broke", "8,20,survived", "8,30,broke"]
    (tmp_path / "t.csv").write_text("\n".join(lines))
    asked = document(tests={"file": "t.csv", "diameter": "d", "specific_energy": "e"})
    assert "line 2: the size is unusual: is its unit right?" in load_tests(asked, tmp_path).notes


def test_draws_as_a_strength_are_the_law_at_its_size(fitted: Fit) -> None:
    lines = fitted.posterior.strength_csv(0.01).splitlines()
    assert lines[0] == (
        "distribution,scale [J/kg],shape,bound,tests,synthetic,diameter [mm],size_exponent,"
        "smallest [mm],largest [mm]"
    )
    assert len(lines) == 4001
    energy = 60.0
    from_law = fitted.posterior.broken(energy, 0.01)[:, 0]
    for k in (0, 17, 4000 - 1):
        name, scale, shape, bound, tests, synthetic, size, exponent, *sizes = lines[k + 1].split(
            ","
        )
        assert synthetic == "0"
        assert [float(size) for size in sizes] == [2.0, 20.0]
        larger = fitted.posterior.median(0.012)[k, 0] / fitted.posterior.median(0.01)[k, 0]
        assert larger == pytest.approx(1.2 ** float(exponent), rel=0.01)
        assert (tests, float(size)) == ("48", pytest.approx(10.0))
        x = energy / (1.0 - float(bound) * energy / float(scale)) / float(scale)
        share = (
            ndtr(math.log(x) / float(shape))
            if name == "lognormal"
            else -math.expm1(-(x ** float(shape)))
        )
        assert share == pytest.approx(from_law[k], rel=1e-6)


def test_coverage_of_the_median_over_series() -> None:
    inside = 0
    for seed in range(12):
        tests = made_up(np.random.default_rng(100 + seed), each=6)
        found = fit(tests, document(seed=seed, draws=500, tests={"law": "lognormal"}))
        low, high = np.quantile(found.posterior.median(0.01)[:, 0], [0.025, 0.975])
        inside += low < float(laws.median_energy("tavares", 0.01, 60.0, 1.1, 0.006)) < high
    assert inside >= 9  # 11.4 expected


def test_priors_of_both_laws_have_one_scatter() -> None:
    """The logarithm of a Weibull energy of shape 3 m/5 has the sd pi/sqrt(6)/(3 m/5)."""
    sigma, modulus = (math.exp(PRIORS[name][0]) for name in ("sigma", "modulus"))
    assert math.pi / math.sqrt(6.0) / (0.6 * modulus) == pytest.approx(sigma, rel=1e-3)


def test_repeated_blows_determine_gamma() -> None:
    rng = np.random.default_rng(11)
    n, blows = 60, 12
    e = laws.Scatter("lognormal", 100.0, 0.5, 4.0).energy_at(rng.random(n))
    u = laws.thresholds(3.0, blows)
    series = np.zeros((n, blows))
    broke = np.zeros(n, dtype=bool)
    for k in range(n):
        offered = 60.0 + 40.0 * rng.random()
        count = int(np.searchsorted(u * offered, e[k]))
        broke[k] = count <= blows
        series[k, : min(max(count, 1), blows)] = offered
    tests = Specimens(
        diameter=np.full(n, 0.02),
        blows=series,
        broke=broke,
        exact=np.zeros(n, bool),
        weight=np.ones(n),
    )
    found = fit(tests, document(tests={"law": "lognormal"})).content["parameters"]
    assert found["gamma"]["low"] < 3.0 < found["gamma"]["high"]
    assert found["gamma"]["sd"] < 0.35
    assert found["e50_1"]["low"] < 100.0 < found["e50_1"]["high"]


def table(folder: Path, text: str, **tests: Any) -> Specimens:
    (folder / "tests.csv").write_text(text)
    return load_tests(document(tests=tests), folder)


def test_tables_of_tests(tmp_path: Path) -> None:
    plain = "d [mm];e [J/kg];outcome\n10;80,5;broke\n10;120,5;survived\n20;60,5;1\n"
    tests = table(tmp_path, plain)
    np.testing.assert_allclose(tests.last, [80.5, 120.5, 60.5])
    assert tests.broke.tolist() == [True, False, True]
    low, high = tests.bounds(np.array(4.0))
    np.testing.assert_allclose(low, [80.5, 120.5, 60.5])
    assert high[1] == math.inf
    dropped = table(tmp_path, plain, rig="drop_weight", energy_is="input")
    assert dropped.bounds(np.array(4.0))[0].tolist() == [0.0, 120.5, 0.0]
    grouped = table(
        tmp_path,
        "d [mm],e [J/kg],n,b\n10,50,20,3\n10,100,20,15\n",
        rig="drop_weight",
        energy_is="input",
        outcome=None,
        particles="n",
        broken="b",
    )
    assert grouped.weight.tolist() == [3.0, 17.0, 15.0, 5.0]
    hit = table(
        tmp_path,
        "d [mm],e [J/kg],outcome,s\n10,50,0,a\n10,60,0,a\n10,70,1,a\n10,80,1,b\n",
        rig="drop_weight",
        energy_is="input",
        specimen="s",
    )
    assert hit.blows[0].tolist() == [50.0, 60.0, 70.0]
    low, high = hit.bounds(np.array(4.0))
    assert low[0] == pytest.approx(float(laws.survivor_bound([50.0, 60.0], 4.0)))
    assert high[0] == pytest.approx(float(laws.survivor_bound([50.0, 60.0, 70.0], 4.0)))


def test_a_force_needs_a_stiffness(tmp_path: Path) -> None:
    text = "d [mm],F [kN],K [GPa],outcome\n20,20,44.71836,broke\n20,20,22.35918,broke\n"
    with pytest.raises(ValueError, match="stiffness of each particle"):
        table(tmp_path, text, specific_energy=None, energy_is=None, force="F")
    tests = table(
        tmp_path,
        text,
        specific_energy=None,
        energy_is=None,
        force="F",
        stiffness="K",
        partner={"E": "210 GPa", "nu": 0.3, "density": "7850 kg/m3"},
    )
    assert tests.last[1] / tests.last[0] == pytest.approx(2.0 ** (2.0 / 3.0), rel=1e-9)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("10,-5,broke", "line 2: the energy must be above 0"),
        ("0,5,broke", "line 2: the size"),
        ("10,5,perhaps", "line 2: outcome"),
        ("10,5,survived", "every particle survived"),
        ("10,x,broke\n10,5,broke", "line 2"),
    ],
)
def test_faults_of_tables_name_their_lines(text: str, match: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=match):
        table(tmp_path, f"d [mm],e [J/kg],outcome\n{text}\n")


def test_only_breaks_of_go_no_go_bound_nothing_and_odd_rows_are_named(tmp_path: Path) -> None:
    head = "d [mm],e [J/kg],outcome\n"
    with pytest.raises(UsageError, match="nothing bounds it from below"):
        table(tmp_path, head + "10,5,1\n20,5,1\n", rig="drop_weight", energy_is="input")
    rows = "".join(f"10,{80 + k},1\n" for k in range(12))
    assert any(
        "line 14: the energy lies far" in note
        for note in table(tmp_path, head + rows + "10,80000,1\n").notes
    )
    with pytest.raises(UsageError, match="hit again after it broke"):
        table(tmp_path, head.replace("outcome", "outcome,s") + "10,5,1,a\n10,5,1,a\n", specimen="s")


# --- feed -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("blows", "key"), [(1, "blows1"), (3, "blows3"), (10, "blows10")])
def test_a_rosin_rammler_feed_of_a_known_truth(blows: int, key: str, tmp_path: Path) -> None:
    case = CASES["F2"]
    sizes = SizesTable(law="rosin_rammler", d63="30 mm", n=1.2, top="71.5 mm")
    classes = load_classes(sizes, tmp_path)
    np.testing.assert_allclose(classes.edges, case["edges"], rtol=1e-12)
    np.testing.assert_allclose(classes.mass, case["mass"], rtol=1e-9)
    np.testing.assert_allclose(classes.sizes, case["mid"], rtol=1e-9)
    assert "0.059 of the mass" in classes.notes[0]
    truth = one_draw(e_inf=60.0, d0=0.006, phi=1.1, sigma=0.55)
    broken = broken_by_blow(truth, np.full(15, case["energy"]), classes.sizes, blows)[0, :, -1]
    np.testing.assert_allclose(broken, case[key]["truth_class"], rtol=1e-8)
    assert float(broken @ classes.mass) == pytest.approx(case[key]["truth_total"], rel=1e-9)


@pytest.mark.parametrize(("blows", "key"), [(1, "closed"), (5, "n5_gamma4")])
def test_a_lognormal_feed_of_a_power_law_in_closed_form(
    blows: int, key: str, tmp_path: Path
) -> None:
    case = CASES["F1"]
    fine = load_classes(
        SizesTable(law="lognormal", d50="30 mm", sd=0.7, top="3 m", ratio=1.06, classes=190),
        tmp_path,
    )
    truth = one_draw(C=case["C"], phi=case["phi"], sigma=case["sigma"], ratio=math.inf)
    broken = broken_by_blow(truth, np.full(len(fine.mass), case["energy"]), fine.sizes, blows)[
        0, :, -1
    ]
    assert float(broken @ fine.mass) == pytest.approx(case[key], abs=2e-4)


SIZES = {"law": "rosin_rammler", "d63": "15 mm", "n": 1.2, "top": "40 mm"}


def feed_document(**feed: Any) -> ComminutionDocument:
    feed = {"sizes": SIZES, "specific_energy": "100 J/kg", **feed}
    return document(feed=feed, product={"A": "55 %", "b": "0.8 t/kWh"})


def passing(answer: dict[str, Any]) -> Any:
    """Median, low and high share (S, 3) of the product that passes each sieve."""
    return np.array([[row[key] for key in ("value", "low", "high")] for row in answer["product"]])


def test_mass_is_kept_and_the_product_is_finer_after_more_blows(
    fitted: Fit, tmp_path: Path
) -> None:
    one, five = (answer_feed(fitted.posterior, feed_document(blows=n), tmp_path) for n in (1, 5))
    assert sum(row["mass"] for row in one["classes"]) == pytest.approx(1.0, abs=EXACT)
    assert (np.diff(passing(one), axis=0) >= -EXACT).all()
    assert passing(one)[-1] == pytest.approx(1.0, abs=1e-9)
    broken = [answer["numbers"]["broken"] for answer in (one, five)]
    assert all(broken[1][end] > broken[0][end] for end in ("value", "low", "high"))
    assert five["numbers"]["P80 [m]"]["value"] < one["numbers"]["P80 [m]"]["value"]
    finer = answer_feed(
        fitted.posterior, feed_document(sizes=SIZES | {"ratio": 2**0.25, "classes": 28}), tmp_path
    )
    coarse, fine = (answer["numbers"]["P80 [m]"]["value"] for answer in (one, finer))
    assert fine == pytest.approx(coarse, rel=0.01)


def test_fragments_are_hit_again(fitted: Fit, tmp_path: Path) -> None:
    once, thrice = (
        [
            answer_feed(fitted.posterior, feed_document(blows=n, rebreak=again), tmp_path)
            for again in (False, True)
        ]
        for n in (1, 3)
    )
    # the fragments of the last blow are hit no more: the same mass passes the edges of the classes
    sieves = [row["sieve"] for row in once[0]["product"]]
    at = np.searchsorted(sieves, [row["upper"] for row in once[0]["classes"]])
    np.testing.assert_allclose(passing(once[1])[at], passing(once[0])[at], rtol=1e-9)
    (out, again), key = thrice, "energy [J/kg]"
    assert again["numbers"]["P80 [m]"]["value"] < out["numbers"]["P80 [m]"]["value"]
    assert again["numbers"][key]["value"] > out["numbers"][key]["value"]
    np.testing.assert_allclose(passing(again)[-1], 1.0, atol=EXACT)
    # two blows of two classes by hand
    cumulative = np.array([[[0.0, 0.5, 0.7], [0.0, 0.2, 0.3]]])
    struck, broken, left = population(
        cumulative, np.array([0.8, 0.2]), np.array([[[0.4, 0.0], [0.6, 1.0]]])
    )
    fresh = np.array([0.4 * 0.4, 0.6 * 0.4 + 0.04])
    np.testing.assert_allclose(struck[0], [0.8 + 0.4 + fresh[0], 0.2 + 0.16 + fresh[1]], rtol=EXACT)
    now = np.array([0.8 * 0.2 + 0.5 * fresh[0], 0.2 * 0.1 + 0.2 * fresh[1]])
    np.testing.assert_allclose(broken[0], [0.4 + now[0], 0.04 + now[1]], rtol=EXACT)
    last = [0.24 + 0.5 * fresh[0] + 0.4 * now[0], 0.14 + 0.8 * fresh[1] + 0.6 * now[0] + now[1]]
    np.testing.assert_allclose(left[0], last, rtol=EXACT)
    with pytest.raises(UsageError, match=r"rebreak needs .*\[product\]"):
        answer_feed(
            fitted.posterior,
            feed_document(rebreak=True).model_copy(update={"product": None}),
            tmp_path,
        )


def test_a_lot_scatters_beside_what_the_tests_leave_open(fitted: Fit, tmp_path: Path) -> None:
    small = answer_feed(fitted.posterior, feed_document(lot="0.2 kg"), tmp_path)["lot"]
    large = answer_feed(fitted.posterior, feed_document(lot="2 t"), tmp_path)["lot"]
    assert small["lot_sd"] > 5.0 * large["lot_sd"]
    assert small["epistemic_sd"] == large["epistemic_sd"]


def sieved(folder: Path, text: str, **sizes: Any) -> Any:
    (folder / "psd.csv").write_text(text)
    return load_classes(
        SizesTable(
            law="table", file="psd.csv", sieve="sieve [um]", passing="passing_percent", **sizes
        ),
        folder,
    )


def test_a_sieve_table_that_ends_early(tmp_path: Path) -> None:
    text = "sieve [um],passing_percent\n100,10\n150,50\n"
    with pytest.raises(UsageError, match=r"passes 50.0%.*add top"):
        sieved(tmp_path, text)
    made = sieved(tmp_path, text, top="200 um")
    assert made.edges[0] == pytest.approx(200e-6)
    assert "0.5 of the mass" in made.notes[0]
    # the next class ends at 141 um, where 44 % pass on a line in the logarithm of the size
    assert made.mass[0] == pytest.approx(1.0 - 0.4419, abs=1e-3)
    with pytest.raises(UsageError, match="headed as percent and reaches"):
        sieved(tmp_path, "sieve [um],passing_percent\n100,0.1\n150,0.986\n")
    near = sieved(tmp_path, "sieve [um],passing_percent\n100,10\n150,98\n")
    assert "0.02 of the mass" in near.notes[0]
    # a top below sieves that pass more cuts these, which is told as for a law
    cut = sieved(tmp_path, "sieve [um],passing_percent\n100,60\n150,100\n", top="100 um")
    assert cut.notes == ["0.4 of the mass is coarser than 0.1 mm: it is cut and the rest is scaled"]


def test_the_shipped_feed_and_its_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(ROOT / "studies/lab_limestone_feed.toml")
    assert main(["comminution", "feed", path, "--out", str(tmp_path / "out"), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert {file.name for file in (tmp_path / "out").iterdir()} == {
        "draws.csv",
        "fit.json",
        "feed.json",
        "classes.csv",
        "product.csv",
        "SHA256SUMS",
    }
    truth = laws.median_energy(
        "tavares", 0.016, 60.0, 0.9, 0.012
    )  # what the shipped tests were made with
    half = next(one for one in content["fit"]["sizes"] if abs(one["diameter"] - 0.016) < 1e-4)[
        "E50"
    ]
    assert half["low"] < float(truth) < half["high"]
    assert "synthetic" in content["feed"]["warnings"][0]
    assert main(["comminution", "fit", path, "--out", str(tmp_path / "fit")]) == 0
    assert "synthetic" in capsys.readouterr().err
    bad = tmp_path / "bad.toml"
    bad.write_text('[material]\nmaterial = "cheese"\n[tests]\nfile = "x.csv"\n')
    assert main(["comminution", "fit", str(bad)]) == 2
    assert 'unknown material "cheese"' in capsys.readouterr().err
    assert main(["comminution", "fit", str(tmp_path / "none.toml")]) == 6


# --- back into a study ----------------------------------------------------------------------------

LOOP = """
title = "Limestone under the drop weight of its tests"
seed = 5
[sphere]
E = "50 GPa"
nu = 0.25
density = "2700 kg/m3"
radius = "10 mm"
[rig]
kind = "drop_weight"
[hammer]
mass = "1 kg"
drop_height = "{height} m"
material = "steel"
face_radius = "flat"
[anvil]
kind = "thick"
material = "steel"
{contact}
[limits.fracture]
quantity = "specific_energy_sphere"
strength = {{ draws = "draws.csv" }}
aim = "break"
target = 0.1
[analysis]
quantities = ["specific_impact_energy"]
"""


@pytest.mark.slow
@pytest.mark.parametrize("law", [None, "hertz"])
def test_drop_weight_tests_that_break_half_break_half_in_the_same_drop_weight(
    law: str | None, tmp_path: Path
) -> None:
    """The fit credits a particle with its share of the energy offered, as the study does."""
    half, mass = 130.0, 2700.0 * math.pi / 6.0 * 0.02**3
    offered = half * np.geomspace(0.25, 4.0, 9)
    broken = np.round(60 * ndtr(np.log(offered / half) / 0.5)).astype(int)
    rows = [f"20,{e:.6g},60,{b}" for e, b in zip(offered, broken, strict=True)]
    (tmp_path / "tests.csv").write_text("\n".join(["d [mm],e [J/kg],n,b", *rows]) + "\n")
    asked = document(
        material={"E": "50 GPa", "nu": 0.25, "density": "2700 kg/m3"},
        tests={
            "rig": "drop_weight",
            "energy_is": "input",
            "outcome": None,
            "particles": "n",
            "broken": "b",
            "partner": {"material": "steel"},
            "law": "lognormal",
            "ratio": math.inf,
        },
        contact_law=law,
    )
    tests = load_tests(asked, tmp_path)
    fitted = fit(tests, asked)
    (size,) = fitted.content["sizes"]
    if law == "hertz":
        assert size["breaks_half"]["value"] == pytest.approx(0.8075 * half, rel=0.05)
    (tmp_path / "draws.csv").write_text(fitted.posterior.strength_csv(0.02))
    contact = "" if law is None else f'[contact]\nlaw = "{law}"'
    study = LOOP.format(height=half * mass / 9.80665, contact=contact)
    (tmp_path / "loop.toml").write_text(study)
    run = uqsphere.run(uqsphere.load_study(tmp_path / "loop.toml"))
    frame = run.answers
    rows_of = (frame.subject == "limits.fracture") & (frame.answer == "exceedance_probability")
    (answer,) = frame[rows_of].itertuples()
    assert answer.value == pytest.approx(0.5, abs=0.04)
    # draws of synthetic tests establish no verdict
    assert not uqsphere.load_study(tmp_path / "loop.toml").made_up
    (tmp_path / "draws.csv").write_text(fitted.posterior.strength_csv(0.02, synthetic=True))
    assert "limits.fracture.strength" in uqsphere.load_study(tmp_path / "loop.toml").made_up


@pytest.mark.parametrize("rig", ["drop_weight", "impact", "drop"])
def test_every_offered_energy_is_shared_with_the_partner(rig: str, tmp_path: Path) -> None:
    text = "d [mm],e [J/kg],outcome\n20,100,broke\n20,80,survived\n20,90,broke\n20,120,survived\n"
    steel = {"material": "steel"}
    (tmp_path / "tests.csv").write_text(text)
    keys = {"rig": rig, "energy_is": "input", "partner": steel}
    shared = load_tests(document(tests=keys, contact_law="hertz"), tmp_path)
    own, other = 60e9 / (1.0 - 0.25**2), 210e9 / (1.0 - 0.3**2)
    elastic = 100.0 * laws.particle_share(own, other)
    assert shared.last[0] == pytest.approx(elastic, rel=0.05)
    # a particle that yields takes more of it
    yielding = load_tests(document(tests=keys, contact_law="plastic"), tmp_path)
    assert elastic < yielding.last[0] < 100.0
    whole = table(tmp_path, text, rig=rig, energy_is="input")
    assert whole.last.tolist() == [100.0, 80.0, 90.0, 120.0]
    assert any("credited with the whole energy offered" in note for note in whole.notes)


def test_a_strength_beyond_the_tested_sizes_is_told_and_holds_a_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(8)
    rows = [
        f"{17 + 6 * rng.random():.4g},{100 * math.exp(0.4 * rng.standard_normal()):.4g},1"
        for _ in range(30)
    ]
    (tmp_path / "tests.csv").write_text("\n".join(["d [mm],e [J/kg],outcome", *rows]) + "\n")
    text = (
        'strength_at = "{at}"\n[material]\nmaterial = "limestone"\n[tests]\nfile = "tests.csv"\n'
        'diameter = "d [mm]"\nspecific_energy = "e [J/kg]"\nenergy_is = "sphere"\n'
        'outcome = "outcome"\n'
    )
    for at, told in (("20 mm", False), ("80 mm", True)):
        (tmp_path / "fit.toml").write_text(text.format(at=at))
        command = ["comminution", "fit", str(tmp_path / "fit.toml"), "--out", str(tmp_path)]
        assert main(command) == 0
        assert ("80 mm is outside the tested sizes (17" in capsys.readouterr().err) is told
    (tmp_path / "study.toml").write_text(
        LOOP.format(height=0.01, contact="")
        .replace('"10 mm"', '"40 mm"')
        .replace('"break"', '"survive"')
    )
    study = uqsphere.load_study(tmp_path / "study.toml")
    tested = study.limits[0].tested
    assert tested is not None
    assert tested.diameter == pytest.approx(0.08)
    assert tested.beyond(0.08) == pytest.approx(0.08 / max(tested.diameters))
    assert max(tested.diameters) < 0.0231
