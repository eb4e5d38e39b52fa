"""A law made of the draws of a fit, and a study whose strength it is."""

from __future__ import annotations

import math
import pickle
from pathlib import Path

import numpy as np
import pytest

from uqsphere.errors import StudyError
from uqsphere.feed import laws
from uqsphere.feed.fit import DRAWS_FILE, FIT_FILE, Posterior
from uqsphere.feed.infer import Request, fit
from uqsphere.feed.tests import make_specimens
from uqsphere.runner.api import run
from uqsphere.study import load_study
from uqsphere.uq.families.observed import DRAWN, LOGNORMAL, WEIBULL
from uqsphere.uq.fitting import count_tests, is_fitted, laws_of_more_tests, possible_laws
from uqsphere.uq.law import Law, make_law

RNG = np.random.default_rng
DRAWS = ((LOGNORMAL, 0.0, 100.0, 0.6, 0.25), (WEIBULL, 0.0, 120.0, 2.4, 0.0), (WEIBULL, 12.0, 90.0, 1.0, 0.0))
X = np.array([5.0, 40.0, 80.0, 150.0, 390.0])
STUDY = """
seed = 5
[sphere]
E = "60 GPa"
nu = 0.25
density = "2700 kg/m3"
radius = "5 mm"
[rig]
kind = "impact"
speed = { dist = "normal", mean = "12 m/s", cov = 0.05 }
[target]
material = "steel"
[limits.fracture]
criterion = "specific_energy"
energy_is = "sphere"
strength = { fit = "DIR" }
aim = "break"
target = 0.5
[analysis]
ways = "given"
budget = { evaluations = 4096 }
"""


def of(*draws: tuple[float, ...]) -> Law:
    return Law(family=DRAWN, parameters={"tests": 40.0}, draws=draws)


def test_one_draw_is_the_law_that_it_stands_for() -> None:
    bounded = laws.broken_share("lognormal", X, {"median": 100.0, "sigma": 0.6, "ratio": 4.0})
    np.testing.assert_allclose(of(DRAWS[0]).cdf(X), bounded, rtol=1e-12)
    weibull = make_law("weibull", {"scale": 120.0, "modulus": 2.4})
    np.testing.assert_allclose(of(DRAWS[1]).cdf(X), weibull.cdf(X), rtol=1e-12)
    np.testing.assert_allclose(of(DRAWS[1]).pdf(X), weibull.pdf(X), rtol=1e-12)
    assert of(DRAWS[1]).mean() == pytest.approx(weibull.mean(), rel=1e-6)
    assert of(DRAWS[2]).cdf(np.array([12.0])) == 0.0


def test_the_law_is_the_mean_of_its_draws() -> None:
    law = of(*DRAWS)
    alone = [of(one) for one in DRAWS]
    np.testing.assert_allclose(law.cdf(X), np.mean([one.cdf(X) for one in alone], axis=0), rtol=1e-7)
    np.testing.assert_allclose(law.sf(X), np.mean([one.sf(X) for one in alone], axis=0), rtol=1e-6)
    p = np.array([1e-9, 1e-4, 0.02, 0.5, 0.97, 1.0 - 1e-7])
    np.testing.assert_allclose(law.cdf(law.ppf(p)), p, rtol=1e-8)
    assert np.array_equal(pickle.loads(pickle.dumps(law)).cdf(X), law.cdf(X))


def test_what_the_tests_leave_open_are_the_draws() -> None:
    law = of(*DRAWS)
    assert is_fitted(law)
    assert count_tests(law) == 40
    found = possible_laws(law, 30, RNG(1))
    assert {one.draws[0] for one in found} == set(DRAWS)
    spread = [(LOGNORMAL, 0.0, scale, 0.6, 0.25) for scale in np.exp(0.3 * RNG(2).standard_normal(300))]
    narrower = laws_of_more_tests(of(*spread), 160, 300, RNG(3))
    logs = [math.log(one.draws[0][2]) for one in narrower]
    assert np.std(logs) == pytest.approx(0.5 * np.std(np.log([one[2] for one in spread])), rel=1e-6)


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Posterior]:
    """The folder of a study beside the folder of a fit."""
    home = tmp_path_factory.mktemp("fit")
    d = np.repeat([0.005, 0.01, 0.02], 15)
    e = 60.0 * (1.0 + 0.006 / d) * np.exp(0.5 * RNG(4).standard_normal(d.size))
    posterior, entry = fit(make_specimens(d, e), Request(seed=1, made_up=True))
    (home / "DIR").mkdir()
    (home / "DIR" / DRAWS_FILE).write_text(posterior.csv(), encoding="utf-8")
    (home / "DIR" / FIT_FILE).write_text(entry.model_dump_json(), encoding="utf-8")
    return home, posterior


def load(home: Path, text: str = STUDY) -> object:
    (home / "study.toml").write_text(text, encoding="utf-8")
    return load_study(home / "study.toml")


def test_a_strength_is_read_from_a_fit(fitted: tuple[Path, Posterior]) -> None:
    home, posterior = fitted
    study = load(home)
    law = study.limits[0].strength  # type: ignore[attr-defined]
    np.testing.assert_allclose(law.cdf(X), posterior.broken(X, 0.01).mean(axis=0), atol=0.01)
    assert study.made_up == ("limits.fracture.strength",)  # type: ignore[attr-defined]
    assert count_tests(law) == 45


def test_the_draws_are_carried_through_as_ignorance(fitted: tuple[Path, Posterior], tmp_path: Path) -> None:
    home, posterior = fitted
    found = run(load(home), out=tmp_path / "out").results  # type: ignore[arg-type]
    limit = found.limits["fracture"]
    energy = found.quantities["specific_energy_sphere"].mean.value
    broken = posterior.broken(energy, 0.01)
    assert limit.exceedance.value == pytest.approx(float(broken.mean()), abs=0.02)
    low, high = np.quantile(1.0 - broken, [0.025, 0.975])
    np.testing.assert_allclose(limit.ignorance.miss, [low, high], atol=0.03)
    assert high - low > 0.1


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (('energy_is = "sphere"', 'energy_is = "contact"'), "energy that the particle itself takes up"),
        (('fit = "DIR"', 'fit = "nowhere"'), "no file \"nowhere\""),
        (('fit = "DIR"', 'fit = "../DIR"'), "own folder only"),
        (('fit = "DIR"', 'fit = "DIR", law = "weibull"'), "unknown key \"law\""),
    ],
)  # fmt: skip
def test_fits_refused(fitted: tuple[Path, Posterior], change: tuple[str, str], says: str) -> None:
    with pytest.raises(StudyError, match=says):
        load(fitted[0], STUDY.replace(*change))


def test_a_sphere_beyond_the_tests_is_told_of(fitted: tuple[Path, Posterior]) -> None:
    study = load(fitted[0], STUDY.replace('"5 mm"', '"40 mm"'))
    assert any("beyond the tests" in said for said in study.warnings)  # type: ignore[attr-defined]
