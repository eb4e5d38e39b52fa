"""What all tests share: one thread of linear algebra, a small study, and one finished run of it."""

from __future__ import annotations

import math
import os
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

import uqsphere
from uqsphere.study import Study

#: `tests.campaigns` and `tests.independent` are run as programs too, and go by their whole names
sys.path.insert(0, str(Path(__file__).parent.parent))

#: processes that tests start would compile the package again
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

#: programs, each run by a command of its own (docs/validation.md)
collect_ignore = ["campaigns", "independent"]

#: heavy enough for both faces, reflections and every analysis; light enough to be run in a second or two
SMALL = """\
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
incident_end = "free"
receiving_end = "free"

[striker]
speed = { dist = "normal", mean = "5 m/s", cov = 0.05 }
length = "0.1 m"

[model]
fidelity = "full"
tolerance = 1e-4

[limits.crushing]
quantity = "p_max"
strength = { dist = "weibull", mean = "6 GPa", modulus = 12 }
target = 0.1

[[dependence]]
of = ["sphere.E", "limits.crushing.strength"]
spearman = 0.5

[analysis]
quantities = ["p_max", "contact_time"]
accuracy = { mean = 0.05, quantile = 0.2, sobol = 0.3, probability = 0.5 }
budget = { evaluations = 30_000, time = "10 min" }
quantiles = [0.05, 0.5, 0.95]
"""

MARGINS = """
[margins]
solve = "striker.speed"
between = ["3 m/s", "20 m/s"]
for_probability = [0.1, 0.5, 0.9]
"""

#: a black box of two inputs
BOX = """\
title = "box"
seed = 1
[inputs]
x1 = { dist = "uniform", lower = 0.0, upper = 1.0 }
x2 = { dist = "normal", mean = 0.0, sd = 1.0 }
[outputs]
names = ["y"]
[analysis]
methods = ["sobol"]
quantiles = [0.5]
accuracy = { mean = 0.1, quantile = 0.1, sobol = 0.5, probability = 0.5 }
"""

#: a black box of two normal inputs, a limit and its curve over one of them
SUM = """\
title = "a sum"
seed = 3
[inputs]
a = { dist = "normal", mean = 0.0, sd = 1.0 }
b = { dist = "normal", mean = 0.0, sd = 1.0 }
[outputs]
names = ["y"]
[limits.high]
quantity = "y"
strength = { dist = "normal", mean = 5.0, sd = 1.0 }
aim = "survive"
target = 0.01
[analysis]
cost = "1 us"
accuracy = { mean = 0.05, quantile = 0.2, sobol = 0.05, probability = 0.5 }
quantiles = [0.05, 0.5, 0.95]
budget = { evaluations = 9000, time = "10 h" }
[margins]
solve = "a"
between = ["-6", "8"]
for_probability = [0.5]
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


#: infinite bars in closed form, and no limit that asks for the moment of fracture: thousands of rows in no time
QUICK = (
    'bars.infinite=true', 'model.fidelity="massless"', 'analysis.quantities=["p_max"]', 'analysis.methods=["sobol"]',
    "limits.crushing.fracture=false",
)  # fmt: skip


@pytest.fixture(scope="session", autouse=True)
def one_blas_thread() -> Iterator[None]:
    """Sums of linear algebra in one fixed order."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield


@pytest.fixture(scope="session", autouse=True)
def fits_of_the_same_runs() -> Iterator[None]:
    """Surrogates are fitted once to the same runs: they depend on nothing else, and many tests share their runs."""
    from uqsphere.uq import response
    from uqsphere.uq.expansion import fit_outputs

    known: dict[tuple[object, ...], object] = {}

    def remembered(points: np.ndarray, outputs: np.ndarray, germs: Sequence[object], **how: object) -> object:
        asked = (repr(tuple(germs)), repr(sorted(how.items())))
        key = (points.shape, points.tobytes(), outputs.shape, outputs.tobytes(), *asked)
        if key not in known:
            known[key] = fit_outputs(points, outputs, germs, **how)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(response, "fit_outputs", remembered)
        yield


@pytest.fixture(scope="session")
def small_text() -> str:
    return SMALL


@pytest.fixture(scope="session")
def box_text() -> str:
    return BOX


@pytest.fixture
def study_from(tmp_path: Path) -> Callable[..., Study]:
    """A study from a text and overrides; `quick` puts the small study into its closed form."""

    def build(*overrides: str, text: str = SMALL, quick: bool = False) -> Study:
        path = tmp_path / "study.toml"
        path.write_text(text, encoding="utf-8")
        return uqsphere.load_study(path, [*(QUICK if quick else ()), *overrides])

    return build


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of one finished run of the small study with margins and report; not to be written to."""
    from uqsphere.report import build_report

    folder = tmp_path_factory.mktemp("finished")
    path = folder / "small.toml"
    path.write_text(SMALL + MARGINS, encoding="utf-8")
    run = uqsphere.run(uqsphere.load_study(path), out=folder / "results", threads=1)
    build_report(run.folder)
    return run.folder


@pytest.fixture
def finished_copy(finished: Path, tmp_path: Path) -> Path:
    """A copy of the finished run for tests that damage it."""
    return Path(shutil.copytree(finished, tmp_path / "results"))
