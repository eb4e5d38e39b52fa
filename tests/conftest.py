"""What all tests share: one thread of linear algebra, and a study from a text."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from threadpoolctl import threadpool_limits

import uqsphere
from uqsphere.study import Study

#: `tests.campaigns` and `tests.independent` are run as programs too, and go by their whole names
sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parent))

#: processes that tests start would compile the package again
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

#: programs, each run by a command of its own (docs/validation.md)
collect_ignore = ["campaigns", "independent"]

#: heavy enough for both faces and reflections; light enough to be run in a second
SMALL = """
title = "Small"
seed = 5
[sphere]
E = { dist = "lognormal", mean = "60 GPa", cov = 0.1 }
nu = 0.25
radius = { dist = "normal", mean = "5 mm", sd = "0.05 mm" }
density = "2650 kg/m3"
[bars]
E = "200 GPa"
nu = 0.3
density = "7850 kg/m3"
yield_strength = "1500 MPa"
diameter = "12 mm"
incident_length = "0.4 m"
receiving_length = "0.4 m"
receiving_end = "free"
[striker]
speed = { dist = "normal", mean = "5 m/s", cov = 0.05 }
length = "0.1 m"
[limits.crushing]
quantity = "p_max"
strength = { dist = "weibull", mean = "6 GPa", modulus = 12 }
target = 0.1
"""

#: rigid contact, infinite bars, a step, no mass, everything lognormal: p_max = (3 Z v0 E*^2/(pi^3 r^2))^(1/3)
CLOSED = """
[sphere]
E = { dist = "lognormal", mean = "52 GPa", cov = %g }
nu = 0.25
radius = { dist = "lognormal", mean = "10 mm", cov = %g }
density = "2650 kg/m3"
[bars]
E = "210 GPa"
nu = 0.3
density = "7850 kg/m3"
yield_strength = "1500 MPa"
diameter = "60 mm"
infinite = true
rigid_contact = true
[striker]
speed = { dist = "lognormal", mean = "1 m/s", cov = %g }
[pulse]
shape = "step"
[model]
fidelity = "massless"
horizon = "30 ms"
"""


def spread(cov: float) -> float:
    """Standard deviation of the logarithm of a lognormal number."""
    return math.sqrt(math.log1p(cov**2))


def middle(mean: float, cov: float) -> float:
    """Mean of the logarithm of a lognormal number."""
    return math.log(mean) - 0.5 * spread(cov) ** 2


def log_peak(covs: tuple[float, float, float]) -> float:
    """Mean of ln p_max (Pa) of the study CLOSED with these coefficients of variation."""
    impedance = math.pi * 0.03**2 * math.sqrt(210e9 * 7850.0)
    log_e = middle(52e9, covs[0]) - math.log(1.0 - 0.25**2)
    powers = middle(1.0, covs[2]) + 2.0 * log_e - 2.0 * middle(0.01, covs[1])
    return (math.log(3.0 * impedance / math.pi**3) + powers) / 3.0


@pytest.fixture(scope="session", autouse=True)
def one_blas_thread() -> Iterator[None]:
    """Sums of linear algebra in one fixed order."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield


@pytest.fixture
def study_from(tmp_path: Path) -> Callable[..., Study]:
    """A study from a text and overrides."""

    def build(*overrides: str, text: str = SMALL) -> Study:
        path = tmp_path / "study.toml"
        path.write_text(text, encoding="utf-8")
        return uqsphere.load_study(path, overrides)

    return build
