"""Public reliability problems with reference probabilities, as functions of standard normal
variables.

RP numbers are those of the TNO black-box reliability challenge (Rózsás and Slobbe 2019), with the
formulas as openturns/otbenchmark has them.  `published` is the probability printed there; where it
is not that of the formula our own stands as reference, and the difference is shown.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

import uqsphere
from tests.campaigns import options, table, tell
from uqsphere.study import Study
from uqsphere.uq.law import Law, make_law
from uqsphere.uq.rare import Evaluator, failure_probability

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Problem:
    """A limit function of `dimension` standard normals, failure where negative.

    `reference` is its probability, found by `how`: "closed form", "quadrature" (`integrate_plane`
    in two inputs) or "long run": randomised Sobol' points with one input integrated exactly, 16
    times 65,536, joined with a million points of importance sampling where those are as good
    (relative standard error in `error`).  `modes` counts what matters of its failure domain.
    """

    name: str
    text: str
    dimension: int
    function: Callable[[Array], Array]
    reference: float
    how: str
    error: float = 0.0
    published: float | None = None
    modes: int | None = 1


def _normal(mean: float, sd: float) -> Law:
    return make_law("normal", {"mean": mean, "sd": sd})


def _lognormal(mean: float, sd: float) -> Law:
    return make_law("lognormal", {"mean": mean, "sd": sd})


def _mapped(laws: tuple[Law, ...], function: Callable[..., Array]) -> Callable[[Array], Array]:
    """A function of physical variables as one of standard normals."""

    def standard(u: Array) -> Array:
        return np.asarray(function(*(law.from_normal(u[:, k]) for k, law in enumerate(laws))))

    return standard


def _four_branch(u: Array) -> Array:
    bent = 3.0 + 0.1 * (u[:, 0] - u[:, 1]) ** 2
    along, across = (u[:, 0] + u[:, 1]) / math.sqrt(2.0), u[:, 0] - u[:, 1]
    edge = 7.0 / math.sqrt(2.0)
    return np.asarray(np.min([bent - along, bent + along, edge + across, edge - across], axis=0))


def _rp57(u: Array) -> Array:
    x, y = u.T
    first = np.maximum(-(x**2) + y**3 + 3.0, 2.0 - x - 8.0 * y)
    return np.asarray(np.minimum(first, (x + 3.0) ** 2 + (y + 3.0) ** 2 - 4.0))


def _rp110(u: Array) -> Array:
    first = np.where(u[:, 0] <= 3.5, 0.85 - 0.1 * u[:, 0], 4.0 - u[:, 0])
    second = np.where(u[:, 1] <= 2.0, 2.3 - u[:, 1], 0.5 - 0.1 * u[:, 1])
    return np.asarray(np.minimum(first, second))


def _rp35(u: Array) -> Array:
    first = 2.0 - u[:, 1] + np.exp(-0.1 * u[:, 0] ** 2) + (0.2 * u[:, 0]) ** 4
    return np.asarray(np.minimum(first, 4.5 - u[:, 0] * u[:, 1]))


def _rp38(a: Array, b: Array, c: Array, d: Array, e: Array, f: Array, g: Array) -> Array:
    above = d**2 - 4.0 * e * f * g**2 + d * (f + 4.0 * e + 2.0 * f * g)
    return 15.59e4 - a * b**3 / (2.0 * c**3) * above / (d * e * (d + f + 2.0 * f * g))


def _rp60(a: Array, b: Array, c: Array, d: Array, e: Array) -> Array:
    half = np.min([b - e / 2.0, c - e / 2.0, d - e / 2.0], axis=0)
    whole = np.maximum(d - e, np.minimum(b - e, c - e))
    return np.asarray(np.minimum(a - e, np.maximum(half, whole)))


def _roof_truss(
    q: Array, span: Array, steel: Array, concrete: Array, e_steel: Array, e_concrete: Array
) -> Array:
    """Deflection of 30 mm at the top of a truss; Zhao and Ono 2001, as in much of the literature
    since.
    """
    return 0.03 - q * span**2 / 2.0 * (3.81 / (concrete * e_concrete) + 1.13 / (steel * e_steel))


def _shell(number: float) -> Callable[[Array], Array]:
    return lambda u: np.asarray(number - (u**2).sum(axis=1))


def _plane(beta: float) -> Callable[[Array], Array]:
    return lambda u: np.asarray(beta - u.sum(axis=1) / math.sqrt(u.shape[1]))


_RP8 = (*(_lognormal(120.0, 12.0),) * 4, _lognormal(50.0, 10.0), _lognormal(40.0, 8.0))
_RP14 = (
    make_law("uniform", {}, 70.0, 80.0),
    _normal(39.0, 0.1),
    make_law("gumbel", {"mean": 1500.0, "sd": 350.0}),
    _normal(400.0, 0.1),
    _normal(250_000.0, 35_000.0),
)
_RP38 = tuple(_normal(m, 0.1 * m) for m in (350.0, 50.8, 3.81, 173.0, 9.38, 33.1, 0.036))
_RP60 = (
    _lognormal(2200.0, 220.0),
    _lognormal(2100.0, 210.0),
    _lognormal(2300.0, 230.0),
    _lognormal(2000.0, 200.0),
    _lognormal(1200.0, 480.0),
)
_TRUSS = (
    _normal(20_000.0, 1400.0),
    _normal(12.0, 0.12),
    _normal(9.82e-4, 5.892e-5),
    _normal(0.04, 0.0048),
    _normal(1e11, 6e9),
    _normal(2e10, 1.2e9),
)


def _rp14(a: Array, b: Array, c: Array, d: Array, e: Array) -> Array:
    return a - 32.0 / (math.pi * b**3) * np.sqrt(c**2 * d**2 / 16.0 + e**2)


def _rp53(a: Array, b: Array) -> Array:
    return np.asarray(np.sin(2.5 * a) + 2.0 - (a**2 + 4.0) * (b - 1.0) / 20.0)


def _rp55(a: Array, b: Array) -> Array:
    far, bent = np.abs(a - b), 0.2 + 0.6 * (a - b) ** 4
    return np.asarray(np.minimum(bent - far / math.sqrt(2.0), 5.0 / math.sqrt(2.0) - 2.2 - far))


def _rp91(a: Array, b: Array, c: Array, d: Array, e: Array) -> Array:
    first = (
        0.847 + 0.96 * b + 0.986 * c - 0.216 * d + 0.077 * b**2 + 0.11 * c**2 + 7.0 / 378.0 * d**2
    )
    first = first - c * b - 0.106 * b * d - 0.11 * c * d
    second = 84_000.0 * a / np.sqrt(c**2 + d**2 - c * d + 3.0 * e**2) - 1.0
    return np.asarray(np.min([first, second, 84_000.0 * a / np.abs(d) - 1.0], axis=0))


def _oscillator(m: Array, c1: Array, c2: Array, r: Array, f: Array, t: Array) -> Array:
    """A mass between two springs under a pulse, beyond three times the yield of one; Bucher and
    Bourgund 1990.
    """
    w = np.sqrt((c1 + c2) / m)
    return np.asarray(3.0 * r - np.abs(2.0 * f / (m * w**2) * np.sin(0.5 * w * t)))


_RP91 = tuple(
    _normal(*p)
    for p in ((0.07433, 0.005), (0.1, 0.01), (13.0, 60.0), (4751.0, 48.0), (-684.0, 11.0))
)
_OSCILLATOR = tuple(
    _normal(*p) for p in ((1.0, 0.05), (1.0, 0.1), (0.1, 0.01), (0.5, 0.05), (1.0, 0.2), (1.0, 0.2))
)

PROBLEMS: Final = (
    Problem(
        name="plane",
        text="plane at 3.5, two inputs",
        dimension=2,
        function=_plane(3.5),
        reference=2.3262907903552504e-4,
        how="closed form",
    ),
    Problem(
        name="plane 1e-9",
        text="plane at 5.9978",
        dimension=2,
        function=_plane(5.9978070150076865),
        reference=1e-9,
        how="closed form",
    ),
    Problem(
        name="two-sided",
        text="|u1| above 4, five inputs",
        dimension=5,
        function=lambda u: np.asarray(4.0 - np.abs(u[:, 0])),
        reference=6.334248366623988e-05,
        how="closed form",
        modes=2,
    ),
    Problem(
        name="shell",
        text="distance above sqrt(50), eight inputs: failure in every direction",
        dimension=8,
        function=_shell(50.0),
        reference=4.0867589479967445e-08,
        how="closed form",
    ),
    Problem(
        name="four branches",
        text="four-branch series system, 7/sqrt 2 (Waarts 2000)",
        dimension=2,
        function=_four_branch,
        reference=2.222795306e-3,
        how="quadrature",
        published=2.186e-3,
        modes=4,
    ),
    Problem(
        name="plateau",
        text="plane at 4, flat below 3: no slope at the origin",
        dimension=3,
        function=lambda u: np.asarray(np.minimum(4.0 - u[:, 0], 1.0)),
        reference=3.167124183311986e-05,
        how="closed form",
    ),
    Problem(
        name="RP8",
        text="linear in six lognormals",
        dimension=6,
        function=_mapped(_RP8, lambda a, b, c, d, e, f: a + 2 * b + 2 * c + d - 5 * e - 5 * f),
        reference=7.901e-4,
        how="long run",
        error=8e-4,
        published=7.84e-4,
    ),
    Problem(
        name="RP14",
        text="shaft in torsion, five inputs",
        dimension=5,
        function=_mapped(_RP14, _rp14),
        reference=7.724e-4,
        how="long run",
        error=7e-4,
        published=7.52e-3,
    ),
    Problem(
        name="RP22",
        text="parabola bent outwards",
        dimension=2,
        function=lambda u: np.asarray(
            2.5 - (u[:, 0] + u[:, 1]) / math.sqrt(2.0) + 0.1 * (u[:, 0] - u[:, 1]) ** 2
        ),
        reference=4.207306750e-3,
        how="quadrature",
        published=4.16e-3,
    ),
    Problem(
        name="RP24",
        text="quartic valley",
        dimension=2,
        function=_mapped(
            (_normal(10.0, 3.0),) * 2,
            lambda a, b: 2.5 - 0.2357 * (a - b) + 0.00463 * (a + b - 20.0) ** 4,
        ),
        reference=2.859948110e-3,
        how="quadrature",
        published=2.86e-3,
    ),
    Problem(
        name="RP25",
        text="parallel system: a corner",
        dimension=2,
        function=lambda u: np.asarray(
            np.maximum(u[:, 0] ** 2 - 8 * u[:, 1] + 16, -16 * u[:, 0] + u[:, 1] + 32)
        ),
        reference=4.148875739e-5,
        how="quadrature",
        published=6.14e-6,
    ),
    Problem(
        name="RP28",
        text="product of two normals",
        dimension=2,
        function=_mapped(
            (_normal(78064.0, 11710.0), _normal(0.0104, 0.00156)), lambda a, b: a * b - 146.14
        ),
        reference=1.453294655e-7,
        how="quadrature",
        published=1.763e-7,
        modes=None,
    ),
    Problem(
        name="RP31",
        text="narrow quartic valley",
        dimension=2,
        function=lambda u: np.asarray(2.0 - u[:, 1] + 256.0 * u[:, 0] ** 4),
        reference=3.226681210e-3,
        how="quadrature",
        published=1.8e-4,
    ),
    Problem(
        name="RP33",
        text="union of two planes, three inputs",
        dimension=3,
        function=lambda u: np.asarray(
            np.minimum(3.0 * math.sqrt(3.0) - u.sum(axis=1), 3.0 - u[:, 2])
        ),
        reference=2.575597791e-3,
        how="quadrature",
        published=2.57e-3,
        modes=None,
    ),
    Problem(
        name="RP35",
        text="union with a product",
        dimension=2,
        function=_rp35,
        reference=3.478946145e-3,
        how="quadrature",
        published=3.54e-3,
        modes=None,
    ),
    Problem(
        name="RP38",
        text="seven normals",
        dimension=7,
        function=_mapped(_RP38, _rp38),
        reference=8.050e-3,
        how="long run",
        error=3e-4,
        published=8.1e-3,
    ),
    Problem(
        name="RP53",
        text="sine",
        dimension=2,
        function=_mapped((_normal(1.5, 1.0), _normal(2.5, 1.0)), _rp53),
        reference=3.132048569e-2,
        how="quadrature",
        published=3.13e-2,
        modes=None,
    ),
    Problem(
        name="RP57",
        text="union of a corner and a disc",
        dimension=2,
        function=_rp57,
        reference=2.823628421e-2,
        how="quadrature",
        published=2.84e-2,
        modes=None,
    ),
    Problem(
        name="RP60",
        text="system of five lognormals",
        dimension=5,
        function=_mapped(_RP60, _rp60),
        reference=4.483987e-2,
        how="long run",
        error=2e-6,
        published=4.56e-2,
        modes=None,
    ),
    Problem(
        name="RP75",
        text="product above 3",
        dimension=2,
        function=lambda u: np.asarray(3.0 - u[:, 0] * u[:, 1]),
        reference=9.819298722e-3,
        how="quadrature",
        published=1.07e-2,
        modes=2,
    ),
    Problem(
        name="RP77",
        text="discontinuous, three inputs",
        dimension=3,
        function=_mapped(
            (_normal(10.0, 0.5), _normal(0.0, 1.0), _normal(4.0, 1.0)),
            lambda a, b, c: np.where(c <= 5.0, a - b - c, c - b),
        ),
        reference=2.690843952e-7,
        how="quadrature",
        published=2.679e-7,
        modes=None,
    ),
    Problem(
        name="RP107",
        text="plane at 5, ten inputs",
        dimension=10,
        function=_plane(5.0),
        reference=2.866515718791946e-07,
        how="closed form",
        published=2.806e-7,
    ),
    Problem(
        name="RP110",
        text="kinks that lead away from the greater part",
        dimension=2,
        function=_rp110,
        reference=3.195788433e-5,
        how="closed form",
        published=3.19e-5,
        modes=1,
    ),
    Problem(
        name="RP111",
        text="|product| above 12.5",
        dimension=2,
        function=lambda u: np.asarray(12.5 - np.abs(u[:, 0] * u[:, 1])),
        reference=8.035085965e-7,
        how="quadrature",
        published=8.08e-7,
        modes=4,
    ),
    Problem(
        name="roof truss",
        text="deflection of a roof truss, six inputs",
        dimension=6,
        function=_mapped(_TRUSS, _roof_truss),
        reference=9.3584e-3,
        how="long run",
        error=2.4e-4,
    ),
    Problem(
        name="plane 50",
        text="plane at 4.5, fifty inputs",
        dimension=50,
        function=_plane(4.5),
        reference=3.3976731247300535e-06,
        how="closed form",
    ),
    Problem(
        name="plane 40 1e-9",
        text="plane at 5.9978, forty inputs",
        dimension=40,
        function=_plane(5.9978070150076865),
        reference=1e-9,
        how="closed form",
    ),
    Problem(
        name="RP63",
        text="bowl in a hundred inputs",
        dimension=100,
        function=lambda u: np.asarray(0.1 * (u[:, 1:] ** 2).sum(axis=1) - u[:, 0] - 4.5),
        reference=3.769436118e-4,
        how="quadrature",
        published=3.79e-4,
    ),
    Problem(
        name="RP54",
        text="sum of twenty exponentials",
        dimension=20,
        function=_mapped((make_law("exponential", {"rate": 1.0}),) * 20, lambda *x: sum(x) - 8.951),
        reference=9.906030725e-4,
        how="closed form",
        published=9.98e-4,
    ),
    Problem(
        name="RP55",
        text="four branches in two uniforms",
        dimension=2,
        function=_mapped((make_law("uniform", {}, -1.0, 1.0),) * 2, _rp55),
        reference=0.5600144282863704,
        how="closed form",
        published=0.5600144282863704,
        modes=None,
    ),
    Problem(
        name="RP89",
        text="union of a parabola and a plane",
        dimension=2,
        function=lambda u: np.asarray(
            np.minimum(8.0 - u[:, 0] ** 2 - u[:, 1], 6.0 - u[:, 0] / 5.0 - u[:, 1])
        ),
        reference=5.471280529e-3,
        how="quadrature",
        published=5.43e-3,
        modes=2,
    ),
    Problem(
        name="RP91",
        text="union of three, five inputs",
        dimension=5,
        function=_mapped(_RP91, _rp91),
        reference=7.00255e-4,
        how="long run",
        error=2e-6,
        published=6.97e-4,
        modes=None,
    ),
    Problem(
        name="R - S",
        text="resistance and stress (Waarts 2000)",
        dimension=2,
        function=_mapped((_normal(7.0, 1.0), _normal(2.0, 1.0)), lambda r, s: r - s),
        reference=2.0347600872247943e-4,
        how="closed form",
    ),
    Problem(
        name="stressed beam",
        text="bar in tension",
        dimension=2,
        function=_mapped(
            (_lognormal(300.0, 30.0), _normal(75e3, 5e3)), lambda r, f: r - f / (100.0 * math.pi)
        ),
        reference=2.9198194625e-2,
        how="quadrature",
    ),
    Problem(
        name="oscillator",
        text="spring and mass under a pulse, six inputs",
        dimension=6,
        function=_mapped(_OSCILLATOR, _oscillator),
        reference=2.85952e-2,
        how="long run",
        error=4e-5,
        published=2.834e-2,
    ),
)


def problem(name: str) -> Problem:
    """The problem of that name; KeyError otherwise."""
    return {entry.name: entry for entry in PROBLEMS}[name]


# --- what is measured -----------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Answer:
    """A probability with its interval, whether two methods agree on it, and the runs it took."""

    value: float
    low: float
    high: float
    sure: bool
    runs: float


def by_search(entry: Problem, seed: int, budget: int) -> Answer:
    """The answer of the search for small probabilities by itself."""
    evaluator = Evaluator(entry.function, entry.dimension, budget=budget, seed=seed)
    answer = failure_probability(evaluator)
    estimate = answer.estimate
    return Answer(
        value=estimate.value or 0.0,
        low=estimate.low or 0.0,
        high=1.0 if estimate.high is None else estimate.high,
        sure=answer.sure,
        runs=estimate.evaluations,
    )


def by_run(entry: Problem, seed: int, budget: int) -> Answer:
    """The answer of a whole run, with indices at their defaults beside it, that asks for the
    probability to 2 %.
    """
    names = [f"u{k}" for k in range(entry.dimension)]
    study = Study(
        inputs={name: {"dist": "normal", "mean": 0.0, "sd": 1.0} for name in names},
        outputs="g",
        limits={"fails": {"quantity": "g", "aim": "break", "strength": 0.0}},
        analysis={"accuracy": {"probability": 0.02}, "budget": {"evaluations": budget}},
        seed=seed,
    )

    def model(columns: dict[str, Array]) -> dict[str, Array]:
        return {"g": entry.function(np.stack([columns[name] for name in names], axis=1))}

    run = uqsphere.run(study, model)
    row = run.answers[run.answers["answer"] == "failure_probability"].iloc[0].fillna(0.0)
    return Answer(
        value=float(row["value"]),
        low=float(row["low"]),
        high=float(row["high"]) or 1.0,
        sure=bool(row["value"]),
        runs=run.results.accuracy.runs,
    )


WAYS: Final = {"search": by_search, "run": by_run}


def measured(entry: Problem, way: str, seeds: Sequence[int], budget: int) -> Sequence[float]:
    """Root mean square of the relative error, share of the intervals that hold the reference, the
    share that is sure, and mean model runs."""
    answers = [WAYS[way](entry, seed, budget) for seed in seeds]
    room = 3.0 * entry.error * entry.reference
    errors = [answer.value / entry.reference - 1.0 for answer in answers]
    holds = [a.low - room <= entry.reference <= a.high + room for a in answers]
    return (
        float(np.sqrt(np.mean(np.square(errors)))),
        float(np.mean(holds)),
        float(np.mean([answer.sure for answer in answers])),
        float(np.mean([answer.runs for answer in answers])),
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """A row for each problem, and what they sum up to; progress goes to stderr."""
    given = options(
        __doc__,
        arguments,
        problems=[entry.name for entry in PROBLEMS],
        ways=list(WAYS),
        seeds=[1, 2, 3],
        budget=30_000,
    )
    rows = []
    with np.errstate(all="ignore"):
        for name in given.problems:
            for way in given.ways:
                entry = problem(name)
                rms, holds, sure, runs = measured(entry, way, given.seeds, given.budget)
                figures = [f"{rms:.4f}", f"{holds:.2f}", f"{sure:.2f}", f"{runs:.0f}"]
                rows.append([name, str(entry.dimension), way, *figures])
                tell(" ".join(rows[-1]))
    print(table(["problem", "inputs", "by", "rms", "hold", "sure", "model runs"], rows))
    for way in given.ways:
        of_way = [row for row in rows if row[2] == way]
        few = [row for row in of_way if int(row[1]) <= 10]
        within = sum(float(row[3]) <= 0.03 for row in few)
        holding = np.mean([float(row[4]) for row in of_way])
        print(
            f"\nBy {way}, up to ten inputs: {within} of {len(few)} within 3 %; "
            f"{holding:.3f} of all intervals hold."
        )
    return 0


def integrate_plane(
    function: Callable[[Array], Array], *, panels: int = 720, grid: int = 2001
) -> float:
    """Probability that a function of two standard normals is negative, by quadrature: the reference
    of the table.

    Gauss–Legendre points in the first variable; along the second the edges of the failure domain
    are bisected from a grid and the normal distribution is exact between them.

    >>> found = integrate_plane(lambda u: 3.0 - u[:, 0], panels=180, grid=401)
    >>> bool(abs(found / 1.3498980316e-3 - 1.0) < 1e-3)
    True
    """
    from scipy.special import ndtr

    nodes, weights = np.polynomial.legendre.leggauss(8)
    edges = np.linspace(-9.0, 9.0, panels + 1)
    half, middle = 0.5 * np.diff(edges), 0.5 * (edges[1:] + edges[:-1])
    first = (middle[:, None] + half[:, None] * nodes).ravel()
    mass = (half[:, None] * weights).ravel() * np.exp(-0.5 * first**2) / math.sqrt(2.0 * math.pi)
    second = np.linspace(-9.0, 9.0, grid)
    total = 0.0
    for x, share in zip(first, mass, strict=True):
        inside = function(np.column_stack([np.full(grid, x), second])) < 0.0
        change = np.flatnonzero(inside[1:] != inside[:-1])
        low, high, state = second[change].copy(), second[change + 1].copy(), inside[change]
        for _ in range(45 if change.size else 0):
            centre = 0.5 * (low + high)
            same = (function(np.column_stack([np.full(centre.size, x), centre])) < 0.0) == state
            low, high = np.where(same, centre, low), np.where(same, high, centre)
        ends = [
            *([-math.inf] if inside[0] else []),
            *(0.5 * (low + high)),
            *([math.inf] if inside[-1] else []),
        ]
        for a, b in zip(ends[::2], ends[1::2], strict=True):
            total += share * float(ndtr(b) - ndtr(a) if a < 0.0 else ndtr(-a) - ndtr(-b))
    return total


if __name__ == "__main__":
    sys.exit(main())
