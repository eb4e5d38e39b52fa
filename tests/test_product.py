"""Product fineness t10: the formula, its keys in a study, its answers in a run, and when its range is left."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

import uqsphere
from uqsphere.errors import StudyError, UsageError
from uqsphere.mechanics.criteria import CRITERIA, product_fineness
from uqsphere.model import evaluate
from uqsphere.report import build_report
from uqsphere.study import Study

PRODUCT = """
[product]
A = { dist = "normal", mean = "55 %", cov = 0.08, upper = "100 %" }
b = { dist = "lognormal", mean = "0.8 t/kWh", cov = 0.2 }
"""
#: a criterion whose range is left: the modulus beyond its table; and one whose contacts are larger than it is meant for
LIMITS = """
[limits.volume]
criterion = "weakest_link_volume"
reference_volume = "1 cm3"
strength = { dist = "weibull", scale = "60 MPa", modulus = 60 }
[limits.edge]
quantity = "edge_tension"
strength = "2 GPa"
fracture = false
[limits.fine]
quantity = "t10"
strength = "2 %"
aim = "break"
model_factor = { dist = "lognormal", mean = 1.0, cov = 0.1 }
"""


def test_the_formula_has_its_slope_its_half_and_its_limit() -> None:
    b = 0.8 / 3600.0
    assert product_fineness(1e-3, 0.55, b) == pytest.approx(0.55 * b * 1e-3, rel=1e-6)
    assert product_fineness(math.log(2.0) / b, 0.55, b) == pytest.approx(0.275, rel=1e-12)
    assert product_fineness(1e9, np.array([0.4, 0.55]), b).tolist() == [0.4, 0.55]
    assert product_fineness(0.0, 0.55, b) == 0.0


def test_a_study_with_a_product_answers_it(study_from: Callable[..., Study], small_text: str) -> None:
    study = study_from(text=small_text + PRODUCT)
    assert "t10" in study.analysis.quantities
    assert set(study.random) >= {"product.A", "product.b"}
    rows = {"striker.speed": np.array([2.0, 4.0]), "product.A": np.array([0.5, 0.6])}
    for fidelity in ("massless", "full"):
        frame = evaluate(study, rows, ("specific_energy", "t10"), fidelity=fidelity, tolerance=1e-4)
        wanted = product_fineness(frame["specific_energy"].to_numpy(), rows["product.A"], 0.8 / 3600.0)
        assert frame["t10"].to_numpy() == pytest.approx(wanted, rel=1e-12)
        # the energy is followed although it was not asked for
        alone = evaluate(study, rows, ("t10",), fidelity=fidelity, tolerance=1e-4)
        assert alone["t10"].to_numpy() == pytest.approx(wanted, rel=1e-3)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('\n[product]\nA = "120 %"\nb = "1 t/kWh"\n', "largest product fineness t10 must lie from 0.1 % to 100 %"),
        ('\n[product]\nA = 55\nb = "1 t/kWh"\n', "55 has no unit"),
        ('\n[product]\nA = "55 %"\nb = "1 kWh/t"\n', "unknown unit 'kWh/t' for a mass per energy"),
        ('\n[product]\nA = "55 %"\n', "b is missing"),
        ('\n[product]\nA = "55 %"\nb = "0 t/kWh"\n', "must be above 0"),
        ('\n[product]\nA = "55 %"\nb = "1 t/kWh"\nc = 1\n', 'unknown key "c"'),
        ('\n[limits.fine]\nquantity = "t10"\nstrength = "20 %"\n', r"needs a table \[product\]"),
        (PRODUCT + '\n[limits.fine]\nquantity = "t10"\nstrength = "20 %"\nfracture = true\n', "breaks no sphere"),
    ],
)
def test_what_is_wrong_is_said(text: str, words: str, study_from: Callable[..., Study], small_text: str) -> None:
    with pytest.raises(StudyError, match=words) as caught:
        study_from(text=small_text + text)
    assert len(caught.value.problems) == 1


def test_asked_without_a_product_it_is_refused(study_from: Callable[..., Study], small_text: str) -> None:
    with pytest.raises(UsageError, match=r"t10 needs product\.A and product\.b"):
        evaluate(study_from(), {}, ("t10",), tolerance=1e-4)
    with pytest.raises(StudyError, match=r"quantities\[1\]: t10 needs"):
        study_from(text=small_text.replace('"contact_time"]', '"t10"]'))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, small_text: str) -> uqsphere.Run:
    folder = tmp_path_factory.mktemp("product")
    (folder / "s.toml").write_text(small_text + PRODUCT + LIMITS, encoding="utf-8")
    found = uqsphere.run(uqsphere.load_study(folder / "s.toml"), out=folder / "r")
    build_report(found.folder)
    return found


def test_a_run_has_it_beside_the_probability(run: uqsphere.Run) -> None:
    results = run.results.document()
    every, broken = results["quantities"]["t10"], results["fracture"]["t10"]
    samples = run.samples()
    study = uqsphere.load_study(run.folder / "study.toml")
    few = {name: samples[name].to_numpy()[:50] for name in study.random}
    energy = evaluate(study, few, ("specific_energy",), tolerance=1e-6)["specific_energy"].to_numpy()
    wanted = product_fineness(energy, few["product.A"], few["product.b"])
    assert samples["t10"].to_numpy()[:50] == pytest.approx(wanted, rel=1e-3)
    assert every["mean"]["low"] < every["mean"]["value"] < every["mean"]["high"]
    # spheres break under the larger energies, and those make the finer product
    middle = broken["median"]
    assert middle["low"] < middle["value"] < middle["high"]
    assert middle["high"] > every["quantiles"]["0.5"]["value"]
    assert results["fracture"]["limits"] == ["crushing", "volume"]
    assert results["limits"]["fine"]["exceedance"]["value"] is not None
    page = (run.folder / "report.html").read_text("utf-8")
    assert "finer than a tenth of the sphere" in page


def test_ranges_that_are_left_are_told_with_their_share(run: uqsphere.Run) -> None:
    found = {check["check"]: check for check in run.results.document()["validity"]}
    volume = found["range_of_weakest_link_volume.volume"]
    assert (volume["share"], volume["worst"]) == (1.0, 60.0)
    assert "m reaches 60" in volume["text"]
    assert CRITERIA["weakest_link_volume"].range_text in volume["text"]
    edge = found["range_of_edge_tension"]
    assert edge["share_warning"] == 1.0
    assert edge["worst"] > 0.05
    # 10 mm spheres are smaller than those that A and b are measured on
    assert " mm" in found["range_of_t10"]["text"]
    assert found["range_of_t10"]["share"] == 1.0
    assert "range_of_p_max" not in found
    page = (run.folder / "report.html").read_text("utf-8")
    assert "m reaches 60" in page
