"""How many tests: what fixed designs tell, and the test that would tell most beside those that were made.

A target T(theta) is known so well as its posterior is narrow.  A test that may break the particle with P(theta) leaves

    E[Var T] = P Var(T | broke) + (1 - P) Var(T | survived)                                            (F13)

on average, both variances those of the draws weighted by P(theta) and 1 - P(theta); one that measures the energy at
failure leaves the mean over quantiles of that energy.  After many tests the draws are too few to be weighted: there
ln theta is taken for normal, every test adding its information.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.feed import laws
from uqsphere.feed.fit import Posterior
from uqsphere.uq.estimate import NORMAL

#: quantiles of an energy at failure that stand for all
_NODES: Final = 64
#: relative steps of differences
_STEP: Final = 1e-3
#: energies that are tried, over the median at the size, and blows; sizes between the smallest and the largest
_LEVELS: Final = (0.25, 0.35, 0.5, 0.71, 1.0, 1.41, 2.0, 4.0)
_BLOWS: Final = (1, 3, 10)
_SIZES: Final = 6
#: draws that are weighted for every test of the grid
_WEIGHED: Final = 1000
#: tests after which a precision is given up
MOST_TESTS: Final = 1000
#: the drop-weight practice: five sizes [m] at three energies [J/kg] with 20 particles each, and five energies at one
#: size; energies of 0.1, 1 and 2.5 kWh/t (Napier-Munn and others 1996, and SMC, both from memory)
JK_SIZES: Final = (0.0145, 0.0206, 0.0289, 0.0411, 0.0578)
JK_ENERGIES: Final = (360.0, 3600.0, 9000.0)
SMC_ENERGIES: Final = (360.0, 900.0, 1800.0, 3600.0, 9000.0)
PRACTICE: Final = 20
#: levels of go/no-go tests, in units of sigma about the median; the second pair tells both numbers best
DESIGNS: Final = {
    "go/no-go, all at the median": (0.0,),
    "two levels, 1.138 sigma on either side": (-1.138, 1.138),
    "five levels, -1.5 to 1.5 sigma": (-1.5, -0.75, 0.0, 0.75, 1.5),
    "five levels, one sigma off": (-0.5, 0.25, 1.0, 1.75, 2.5),
}


@dataclass(frozen=True, kw_only=True)
class Option:
    """A test: its size [m], the energy of a blow [J/kg] (None: the energy at failure is measured), its blows.

    `sd`: what it leaves of the target's standard deviation on average.
    """

    size: float
    energy: float | None
    blows: int = 1
    sd: float = math.nan

    @property
    def measured(self) -> bool:
        return self.energy is None


# --- fixed designs ----------------------------------------------------------------------------------------


def complete(tests: int, sigma: float) -> tuple[float, float, float, float]:
    """What n energies at failure of one size tell: factors (low, high) on E50, and on sigma, at 95 %; exact.

    exp(-+ t sigma/sqrt n) and sqrt((n - 1)/chi-squared).

    >>> [round(part, 2) for part in complete(20, 0.7)]
    [0.72, 1.39, 0.76, 1.46]
    """
    from scipy.stats import chi2, t

    half = float(t.ppf(0.975, tests - 1)) * sigma / math.sqrt(tests)
    ends = [math.sqrt((tests - 1) / float(chi2.ppf(share, tests - 1))) for share in (0.975, 0.025)]
    return math.exp(-half), math.exp(half), ends[0], ends[1]


def go_no_go(levels: Sequence[float]) -> tuple[float, float]:
    """n Var(ln E50)/sigma² and n Var(ln sigma) of go/no-go tests at these levels in units of sigma, for many tests.

    Tests whose energy at failure is measured have 1 and 0.5.

    >>> [round(part, 2) for part in go_no_go((-1.138, 1.138))]
    [2.55, 1.97]
    """
    from scipy.special import ndtr

    z = np.array(levels, dtype=float)
    below = ndtr(z)
    weight = np.exp(-z * z) / (2.0 * math.pi) / (below * (1.0 - below))
    first, mixed, second = weight.mean(), (weight * z).mean(), (weight * z * z).mean()
    determinant = first * second - mixed * mixed
    if determinant < 1e-12:
        return 1.0 / float(first), math.inf
    return float(second / determinant), float(first / determinant)


# --- the next test ----------------------------------------------------------------------------------------


def options(posterior: Posterior, target: Array, sizes: Sequence[float], *, rigs: Sequence[str] = ("go", "measured")
            ) -> list[Option]:  # fmt: skip
    """Tests on a grid of sizes, energies and blows, those that leave least of the target (n,) first."""
    found = []
    rows = np.linspace(0, len(posterior) - 1, min(len(posterior), _WEIGHED)).astype(int)
    posterior, whole, target = posterior.at(rows), float(target.std()), target[rows]
    # the few draws as wide as all of them
    target = target * whole / max(float(target.std()), 1e-300)
    for size in sizes:
        middle = float(np.median(posterior.energy_at(0.5, size)))
        if "measured" in rigs:
            found.append(Option(size=size, energy=None, sd=_after_measured(posterior, target, size)))
        for energy in [level * middle for level in _LEVELS] if "go" in rigs else []:
            for blows in _BLOWS:
                broken = posterior.broken(energy, size, blows)
                left = broken.mean() * _variance(target, broken) + (1.0 - broken).mean() * _variance(target, 1 - broken)
                found.append(Option(size=size, energy=energy, blows=blows, sd=math.sqrt(left)))
    return sorted(found, key=lambda one: one.sd)


def _variance(target: Array, weight: Array) -> float:
    total = float(weight.sum())
    if total <= 0.0:
        return 0.0
    centre = float(weight @ target) / total
    return float(weight @ (target - centre) ** 2) / total


def _after_measured(posterior: Posterior, target: Array, size: float) -> float:
    """Standard deviation that the energy at failure of one particle leaves on average."""
    shares = (np.arange(_NODES) + 0.5) / _NODES
    some = posterior.at(np.linspace(0, len(posterior) - 1, min(len(posterior), 400)).astype(int))
    nodes = np.quantile(some.energy_at(shares, size), shares)
    density = _densities(posterior, nodes, size)
    return math.sqrt(float(np.mean([_variance(target, part) for part in density.T])))


def _densities(posterior: Posterior, energy: Array, size: float) -> Array:
    """f(e) (n, nodes) of every draw at one size."""
    found = np.empty((len(posterior), energy.size))
    for name, rows, p in posterior.by_law(np.full(energy.shape, size)):
        found[rows] = np.exp(laws.LAWS[name].density(energy, p))
    return found


# --- after many tests -------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Normal:
    """ln theta of the law that most draws have, as normal: mean and covariance, and how the target hangs on it.

    What differs between laws is taken to be told by further tests as the rest is.
    """

    posterior: Posterior
    names: tuple[str, ...]
    mean: Array
    covariance: Array
    slope: Array

    def sd(self, information: Array) -> float:
        """Standard deviation of the target after tests that add this information (d, d)."""
        left = np.linalg.inv(np.linalg.inv(self.covariance) + information)
        return math.sqrt(max(float(self.slope @ left @ self.slope), 1e-300))

    def at(self, x: Array) -> Posterior:
        """The laws of logarithms x (n, d)."""
        which = np.full(len(x), self.posterior.which[0])
        draws = {name: np.exp(x[:, k]) for k, name in enumerate(self.names)}
        fixed = {name: np.full(len(x), column[0]) for name, column in self.posterior.draws.items() if name not in draws}
        return replace(self.posterior, draws={**draws, **fixed}, which=which)


def normal(posterior: Posterior, target: Array) -> Normal:
    """The posterior of the law that most draws have as a normal law, and the target as a plane over it."""
    names, counts = np.unique(posterior.which, return_counts=True)
    rows = np.flatnonzero(posterior.which == names[counts.argmax()])
    some, of = posterior.at(rows), target[rows]
    free = tuple(name for name, column in some.draws.items() if np.isfinite(column).all() and np.ptp(column) > 0.0)
    x = np.log(np.column_stack([some.draws[name] for name in free]))
    covariance = np.cov(x.T).reshape(len(free), -1) + 1e-12 * np.eye(len(free))
    slope = np.linalg.solve(covariance, (x - x.mean(axis=0)).T @ (of - of.mean()) / len(of))
    return Normal(posterior=some, names=free, mean=x.mean(axis=0), covariance=covariance, slope=slope)


def information(about: Normal, test: Option) -> Array:
    """What one test tells of ln theta, (d, d), at the mean."""
    d = len(about.names)
    x = about.mean + _STEP * np.concatenate([np.zeros((1, d)), np.eye(d), -np.eye(d)])
    there = about.at(x)
    if test.energy is None:
        shares = (np.arange(_NODES) + 0.5) / _NODES
        nodes = there.at(np.array([0])).energy_at(shares, test.size)[0]
        logs = np.log(np.maximum(_densities(there, nodes, test.size), 1e-300))
        score = (logs[1 : d + 1] - logs[d + 1 :]) / (2.0 * _STEP)
        return np.asarray(score @ score.T / _NODES)
    p = there.broken(test.energy, test.size, test.blows)
    score = (p[1 : d + 1] - p[d + 1 :]) / (2.0 * _STEP)
    return np.asarray(np.outer(score, score) / max(float(p[0] * (1.0 - p[0])), 1e-9))


def course(about: Normal, candidates: Sequence[Option], tests: int, aim: float) -> tuple[list[float], list[Option]]:
    """Standard deviation of the target before and after each of so many tests, always the best; ends at the aim."""
    each = np.stack([information(about, one) for one in candidates])
    told = np.linalg.inv(about.covariance)
    found, taken = [about.sd(np.zeros_like(told))], list[Option]()
    while len(taken) < tests and found[-1] > aim:
        left = np.einsum("i,kij,j->k", about.slope, np.linalg.inv(told + each), about.slope)
        best = int(np.argmin(left))
        told = told + each[best]
        found.append(math.sqrt(max(float(left[best]), 0.0)))
        taken.append(candidates[best])
    return found, taken


# --- the answer -------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class TestPlan:
    """What `uqsphere plan-tests` answers; widths are half-widths of 95 % intervals, of ln E or of a share.

    now : before any further test;  go, measured : the best next test of either kind
    after : tests -> half-width, the best test always taken;  needed : tests until `precision`, None beyond `MOST_TESTS`
    sizes : share of those tests by size;  worth : go/no-go tests that one measured energy is worth for the target
    practice : half-width after the JK and SMC programmes if breaks are counted
    """

    target: str
    relative: bool
    value: float
    now: float
    go: Option
    measured: Option
    after: dict[int, float]
    needed: int | None
    sizes: dict[float, float]
    worth: float
    practice: dict[str, float]


def plan_tests(
    posterior: Posterior, target: Array, words: str, precision: float, sizes: Sequence[float], *, relative: bool
) -> TestPlan:
    """The next best test, what 1, 10 and 30 more leave, and how many reach a precision.

    `target` (n,) is ln of an energy (`relative`) or a share; `precision` is that of its 95 % half-width, as a ratio
    above 1 less one, or as it stands.
    """
    grid = options(posterior, target, sizes)
    go, measured = (next(one for one in grid if one.measured is kind) for kind in (False, True))
    about = normal(posterior, target)
    aim = (math.log1p(precision) if relative else precision) / NORMAL
    # all that are measured, and the first of the others
    best = sorted(grid, key=lambda one: not one.measured)[: sum(one.measured for one in grid) + 40]
    # the normal law is a little narrower than the draws: what it forecasts is the share that is left
    now = float(target.std())
    scale = now / about.sd(np.zeros_like(about.covariance))
    path, taken = course(about, best, MOST_TESTS, aim / scale)
    long, _ = course(about, best, 30, 0.0)
    after = {1: NORMAL * min(go.sd, measured.sd), **{n: NORMAL * (scale * long[n]) for n in (10, 30)}}
    sizes_taken = [one.size for one in taken]
    middle = float(np.median(target))
    # by what each adds to the precision of the target
    before = about.sd(np.zeros_like(about.covariance)) ** -2
    gains = [about.sd(information(about, one)) ** -2 - before for one in (measured, go)]
    return TestPlan(
        target=words, relative=relative, value=math.exp(middle) if relative else middle,
        now=NORMAL * now, go=go, measured=measured, after=after,
        needed=len(taken) if path[-1] <= aim / scale else None,
        sizes={size: sizes_taken.count(size) / len(taken) for size in sorted({*sizes_taken})},
        worth=gains[0] / gains[1] if gains[1] > 0.0 else math.inf, practice=_practice(about, sizes, scale),
    )  # fmt: skip


def _practice(about: Normal, sizes: Sequence[float], scale: float) -> dict[str, float]:
    """Half-widths after the programmes of drop-weight tests, if it is counted how many break."""
    middle = float(np.sqrt(sizes[0] * sizes[-1]))
    programmes = {
        "JK": [Option(size=size, energy=energy) for size in JK_SIZES for energy in JK_ENERGIES],
        "SMC": [Option(size=middle, energy=energy) for energy in SMC_ENERGIES],
    }
    return {
        name: NORMAL * scale * about.sd(PRACTICE * np.sum([information(about, one) for one in tests], axis=0))
        for name, tests in programmes.items()
    }


def grid_of_sizes(low: float, high: float) -> tuple[float, ...]:
    """Sizes [m] from the smallest to the largest, evenly in ln d."""
    return tuple(float(size) for size in np.geomspace(low, high, _SIZES)) if high > 1.01 * low else (low,)
