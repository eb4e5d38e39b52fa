"""Public reliability problems with reference probabilities, as functions of standard normal variables.

RP numbers are those of the TNO black-box reliability challenge (Rózsás and Slobbe 2019), with the formulas as
openturns/otbenchmark has them.  `published` is the probability printed there; where it is not that of the formula
our own stands as reference, and the difference is shown.
"""

from __future__ import annotations

import math
import sys
import tempfile
from ast import literal_eval
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt


from tests.campaigns import options, table, tell

from uqsphere.uq.law import Law, make_law

from uqsphere.uq.rare import find_probability
from uqsphere.uq.rare import LimitFunction

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Problem:
    """A limit function of `dimension` standard normals, failure where negative.

    `reference` is its probability, found by `how`: "closed form", "quadrature" (`integrate_plane` in two inputs)
    or "long run": randomised Sobol' points with one input integrated exactly, 16 times 65,536, joined with a
    million points of importance sampling where those are as good (relative standard error in `error`).  `modes`
    counts what matters of its failure domain.
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


def _roof_truss(q: Array, span: Array, steel: Array, concrete: Array, e_steel: Array, e_concrete: Array) -> Array:
    """Deflection of 30 mm at the top of a truss; Zhao and Ono 2001, as in much of the literature since."""
    return 0.03 - q * span**2 / 2.0 * (3.81 / (concrete * e_concrete) + 1.13 / (steel * e_steel))


def _shell(number: float) -> Callable[[Array], Array]:
    return lambda u: np.asarray(number - (u**2).sum(axis=1))


def _plane(beta: float) -> Callable[[Array], Array]:
    return lambda u: np.asarray(beta - u.sum(axis=1) / math.sqrt(u.shape[1]))


_RP8 = (*(_lognormal(120.0, 12.0),) * 4, _lognormal(50.0, 10.0), _lognormal(40.0, 8.0))
_RP14 = (make_law("uniform", {}, 70.0, 80.0), _normal(39.0, 0.1), make_law("gumbel", {"mean": 1500.0, "sd": 350.0}),
         _normal(400.0, 0.1), _normal(250_000.0, 35_000.0))  # fmt: skip
_RP38 = tuple(_normal(m, 0.1 * m) for m in (350.0, 50.8, 3.81, 173.0, 9.38, 33.1, 0.036))
_RP60 = (_lognormal(2200.0, 220.0), _lognormal(2100.0, 210.0), _lognormal(2300.0, 230.0), _lognormal(2000.0, 200.0),
         _lognormal(1200.0, 480.0))  # fmt: skip
_TRUSS = (_normal(20_000.0, 1400.0), _normal(12.0, 0.12), _normal(9.82e-4, 5.892e-5), _normal(0.04, 0.0048),
          _normal(1e11, 6e9), _normal(2e10, 1.2e9))  # fmt: skip


def _rp14(a: Array, b: Array, c: Array, d: Array, e: Array) -> Array:
    return a - 32.0 / (math.pi * b**3) * np.sqrt(c**2 * d**2 / 16.0 + e**2)


def _rp53(a: Array, b: Array) -> Array:
    return np.asarray(np.sin(2.5 * a) + 2.0 - (a**2 + 4.0) * (b - 1.0) / 20.0)


def _rp55(a: Array, b: Array) -> Array:
    far, bent = np.abs(a - b), 0.2 + 0.6 * (a - b) ** 4
    return np.asarray(np.minimum(bent - far / math.sqrt(2.0), 5.0 / math.sqrt(2.0) - 2.2 - far))


def _rp91(a: Array, b: Array, c: Array, d: Array, e: Array) -> Array:
    first = 0.847 + 0.96 * b + 0.986 * c - 0.216 * d + 0.077 * b**2 + 0.11 * c**2 + 7.0 / 378.0 * d**2
    first = first - c * b - 0.106 * b * d - 0.11 * c * d
    second = 84_000.0 * a / np.sqrt(c**2 + d**2 - c * d + 3.0 * e**2) - 1.0
    return np.asarray(np.min([first, second, 84_000.0 * a / np.abs(d) - 1.0], axis=0))


def _oscillator(m: Array, c1: Array, c2: Array, r: Array, f: Array, t: Array) -> Array:
    """A mass between two springs under a pulse, beyond three times the yield of one; Bucher and Bourgund 1990."""
    w = np.sqrt((c1 + c2) / m)
    return np.asarray(3.0 * r - np.abs(2.0 * f / (m * w**2) * np.sin(0.5 * w * t)))


_RP91 = tuple(_normal(*p) for p in ((0.07433, 0.005), (0.1, 0.01), (13.0, 60.0), (4751.0, 48.0), (-684.0, 11.0)))
_OSCILLATOR = tuple(_normal(*p) for p in ((1.0, 0.05), (1.0, 0.1), (0.1, 0.01), (0.5, 0.05), (1.0, 0.2), (1.0, 0.2)))

PROBLEMS: Final = (
    Problem(name="plane", text="plane at 3.5, two inputs", dimension=2, function=_plane(3.5),
            reference=2.3262907903552504e-4, how="closed form"),
    Problem(name="plane 1e-9", text="plane at 5.9978", dimension=2, function=_plane(5.9978070150076865),
            reference=1e-9, how="closed form"),
    Problem(name="two-sided", text="|u1| above 4, five inputs", dimension=5,
            function=lambda u: np.asarray(4.0 - np.abs(u[:, 0])), reference=6.334248366623988e-05,
            how="closed form", modes=2),
    Problem(name="shell", text="distance above sqrt(50), eight inputs: failure in every direction", dimension=8,
            function=_shell(50.0), reference=4.0867589479967445e-08, how="closed form"),
    Problem(name="four branches", text="four-branch series system, 7/sqrt 2 (Waarts 2000)", dimension=2,
            function=_four_branch, reference=2.222795306e-3, how="quadrature", published=2.186e-3, modes=4),
    Problem(name="plateau", text="plane at 4, flat below 3: no slope at the origin", dimension=3,
            function=lambda u: np.asarray(np.minimum(4.0 - u[:, 0], 1.0)), reference=3.167124183311986e-05,
            how="closed form"),
    Problem(name="RP8", text="linear in six lognormals", dimension=6,
            function=_mapped(_RP8, lambda a, b, c, d, e, f: a + 2 * b + 2 * c + d - 5 * e - 5 * f),
            reference=7.901e-4, how="long run", error=8e-4, published=7.84e-4),
    Problem(name="RP14", text="shaft in torsion, five inputs", dimension=5, function=_mapped(_RP14, _rp14),
            reference=7.724e-4, how="long run", error=7e-4, published=7.52e-3),
    Problem(name="RP22", text="parabola bent outwards", dimension=2,
            function=lambda u: np.asarray(2.5 - (u[:, 0] + u[:, 1]) / math.sqrt(2.0) + 0.1 * (u[:, 0] - u[:, 1]) ** 2),
            reference=4.207306750e-3, how="quadrature", published=4.16e-3),
    Problem(name="RP24", text="quartic valley", dimension=2,
            function=_mapped((_normal(10.0, 3.0),) * 2,
                             lambda a, b: 2.5 - 0.2357 * (a - b) + 0.00463 * (a + b - 20.0) ** 4),
            reference=2.859948110e-3, how="quadrature", published=2.86e-3),
    Problem(name="RP25", text="parallel system: a corner", dimension=2,
            function=lambda u: np.asarray(np.maximum(u[:, 0] ** 2 - 8 * u[:, 1] + 16, -16 * u[:, 0] + u[:, 1] + 32)),
            reference=4.148875739e-5, how="quadrature", published=6.14e-6),
    Problem(name="RP28", text="product of two normals", dimension=2,
            function=_mapped((_normal(78064.0, 11710.0), _normal(0.0104, 0.00156)), lambda a, b: a * b - 146.14),
            reference=1.453294655e-7, how="quadrature", published=1.763e-7, modes=None),
    Problem(name="RP31", text="narrow quartic valley", dimension=2,
            function=lambda u: np.asarray(2.0 - u[:, 1] + 256.0 * u[:, 0] ** 4),
            reference=3.226681210e-3, how="quadrature", published=1.8e-4),
    Problem(name="RP33", text="union of two planes, three inputs", dimension=3,
            function=lambda u: np.asarray(np.minimum(3.0 * math.sqrt(3.0) - u.sum(axis=1), 3.0 - u[:, 2])),
            reference=2.575597791e-3, how="quadrature", published=2.57e-3, modes=None),
    Problem(name="RP35", text="union with a product", dimension=2, function=_rp35, reference=3.478946145e-3,
            how="quadrature", published=3.54e-3, modes=None),
    Problem(name="RP38", text="seven normals", dimension=7, function=_mapped(_RP38, _rp38), reference=8.050e-3,
            how="long run", error=3e-4, published=8.1e-3),
    Problem(name="RP53", text="sine", dimension=2, function=_mapped((_normal(1.5, 1.0), _normal(2.5, 1.0)), _rp53),
            reference=3.132048569e-2, how="quadrature", published=3.13e-2, modes=None),
    Problem(name="RP57", text="union of a corner and a disc", dimension=2, function=_rp57, reference=2.823628421e-2,
            how="quadrature", published=2.84e-2, modes=None),
    Problem(name="RP60", text="system of five lognormals", dimension=5, function=_mapped(_RP60, _rp60),
            reference=4.483987e-2, how="long run", error=2e-6, published=4.56e-2, modes=None),
    Problem(name="RP75", text="product above 3", dimension=2, function=lambda u: np.asarray(3.0 - u[:, 0] * u[:, 1]),
            reference=9.819298722e-3, how="quadrature", published=1.07e-2, modes=2),
    Problem(name="RP77", text="discontinuous, three inputs", dimension=3,
            function=_mapped((_normal(10.0, 0.5), _normal(0.0, 1.0), _normal(4.0, 1.0)),
                             lambda a, b, c: np.where(c <= 5.0, a - b - c, c - b)),
            reference=2.690843952e-7, how="quadrature", published=2.679e-7, modes=None),
    Problem(name="RP107", text="plane at 5, ten inputs", dimension=10, function=_plane(5.0),
            reference=2.866515718791946e-07, how="closed form", published=2.806e-7),
    Problem(name="RP110", text="kinks that lead away from the greater part", dimension=2, function=_rp110,
            reference=3.195788433e-5, how="closed form", published=3.19e-5, modes=1),
    Problem(name="RP111", text="|product| above 12.5", dimension=2,
            function=lambda u: np.asarray(12.5 - np.abs(u[:, 0] * u[:, 1])), reference=8.035085965e-7, how="quadrature",
            published=8.08e-7, modes=4),
    Problem(name="roof truss", text="deflection of a roof truss, six inputs", dimension=6,
            function=_mapped(_TRUSS, _roof_truss), reference=9.3584e-3, how="long run", error=2.4e-4),
    Problem(name="plane 50", text="plane at 4.5, fifty inputs", dimension=50, function=_plane(4.5),
            reference=3.3976731247300535e-06, how="closed form"),
    Problem(name="plane 40 1e-9", text="plane at 5.9978, forty inputs", dimension=40,
            function=_plane(5.9978070150076865), reference=1e-9, how="closed form"),
    Problem(name="RP63", text="bowl in a hundred inputs", dimension=100,
            function=lambda u: np.asarray(0.1 * (u[:, 1:] ** 2).sum(axis=1) - u[:, 0] - 4.5), reference=3.769436118e-4,
            how="quadrature", published=3.79e-4),
    Problem(name="RP54", text="sum of twenty exponentials", dimension=20,
            function=_mapped((make_law("exponential", {"rate": 1.0}),) * 20, lambda *x: sum(x) - 8.951),
            reference=9.906030725e-4, how="closed form", published=9.98e-4),
    Problem(name="RP55", text="four branches in two uniforms", dimension=2,
            function=_mapped((make_law("uniform", {}, -1.0, 1.0),) * 2, _rp55),
            reference=0.5600144282863704, how="closed form", published=0.5600144282863704, modes=None),
    Problem(name="RP89", text="union of a parabola and a plane", dimension=2,
            function=lambda u: np.asarray(np.minimum(8.0 - u[:, 0] ** 2 - u[:, 1], 6.0 - u[:, 0] / 5.0 - u[:, 1])),
            reference=5.471280529e-3, how="quadrature", published=5.43e-3, modes=2),
    Problem(name="RP91", text="union of three, five inputs", dimension=5, function=_mapped(_RP91, _rp91),
            reference=7.00255e-4, how="long run", error=2e-6, published=6.97e-4, modes=None),
    Problem(name="R - S", text="resistance and stress (Waarts 2000)", dimension=2,
            function=_mapped((_normal(7.0, 1.0), _normal(2.0, 1.0)), lambda r, s: r - s),
            reference=2.0347600872247943e-4, how="closed form"),
    Problem(name="stressed beam", text="bar in tension", dimension=2,
            function=_mapped((_lognormal(300.0, 30.0), _normal(75e3, 5e3)), lambda r, f: r - f / (100.0 * math.pi)),
            reference=2.9198194625e-2, how="quadrature"),
    Problem(name="oscillator", text="spring and mass under a pulse, six inputs", dimension=6,
            function=_mapped(_OSCILLATOR, _oscillator), reference=2.85952e-2, how="long run", error=4e-5,
            published=2.834e-2),
)  # fmt: skip


def problem(name: str) -> Problem:
    """The problem of that name; KeyError otherwise."""
    return {entry.name: entry for entry in PROBLEMS}[name]


# --- The reliability table: evaluations, error and coverage of the rare-event methods on public problems.


def measure(
    entry: Problem, *, repetitions: int, seed: int = 1, accuracy: float = 0.015, budget: int = 30_000
) -> dict[str, float]:
    """`find_probability` with as many seeds as there are repetitions; errors relative to the reference.

    `covered`: share of the intervals that hold the reference; `wrong`: runs off by more than 20 % whose
    interval neither holds the reference nor is there a warning; `form`: first-order answer over the reference.
    """
    limit = LimitFunction(function=entry.function, dimension=entry.dimension)
    answers = [
        find_probability(limit, seed=1000 * seed + k, accuracy=accuracy, budget=budget) for k in range(repetitions)
    ]
    values = np.array([a.estimate.value if a.estimate.value is not None else math.nan for a in answers])
    errors = np.nan_to_num(values / entry.reference - 1.0, nan=-1.0)
    covered = np.array([
        (a.estimate.low or 0.0) <= entry.reference <= (a.estimate.high if a.estimate.high is not None else 1.0)
        for a in answers
    ])  # fmt: skip
    agreed, modes = np.array([a.agreed for a in answers]), [a.modes for a in answers]
    spent = [a.evaluations for a in answers]
    return {
        "evaluations": float(np.mean(spent)), "most": max(spent), "rms": float(np.sqrt(np.mean(errors**2))),
        "worst": float(np.abs(errors).max()), "covered": float(covered.mean()),
        "half-width": float(np.mean([a.estimate.half_width / (a.estimate.value or math.inf) for a in answers])),
        "agreed": float(agreed.mean()), "least modes": min(modes), "most modes": max(modes),
        "wrong": int(((np.abs(errors) > 0.2) & ~covered & agreed).sum()),
        "form": (answers[0].design.probability or math.nan) / entry.reference,
    }  # fmt: skip


def rare_text(repetitions: int) -> str:
    """Every problem in turn, as a table, with what it says of all problems of at most ten inputs."""
    rows, few, wrong = [], [], 0
    for entry in PROBLEMS:
        tell(f"reliability: {entry.name}")
        row = measure(entry, repetitions=repetitions)
        wrong += int(row["wrong"])
        few += [row] * (entry.dimension <= 10)
        modes = "–".join(f"{m:.0f}" for m in sorted({row["least modes"], row["most modes"]}))
        rows.append((entry.name, entry.dimension, f"{entry.reference:.4g}", f"{row['evaluations']:,.0f}",
                     *(f"{row[key]:.2%}" for key in ("rms", "worst")), f"{row['covered']:.0%}",
                     f"{row['half-width']:.2%}", f"{row['agreed']:.0%}", modes,
                     "none" if math.isnan(row["form"]) else f"{row['form']:.3g}"))  # fmt: skip
    header = ("problem", "inputs", "reference", "evaluations", "rms error", "worst", "covered", "half-width", "agreed",
              "modes", "FORM / reference")  # fmt: skip
    within = sum(row["rms"] <= 0.01 for row in few)
    return (
        f"{table(header, rows)}\n\nUp to ten inputs: rms error at most 1 % on {within} of {len(few)} problems, at most "
        f"{max(row['rms'] for row in few):.2%} on all; worst single run {max(row['worst'] for row in few):.2%}; pooled "
        f"coverage {np.mean([row['covered'] for row in few]):.1%}; at most {max(row['most'] for row in few):,} "
        f"evaluations.\nAnswers off by more than 20 % without interval or warning: {wrong}."
    )


def integrate_plane(function: Callable[[Array], Array], *, panels: int = 720, grid: int = 2001) -> float:
    """Probability that a function of two standard normals is negative, by quadrature: the reference of the table.

    Gauss–Legendre points in the first variable; along the second the edges of the failure domain are bisected
    from a grid and the normal distribution is exact between them.

    >>> bool(abs(integrate_plane(lambda u: 3.0 - u[:, 0], panels=180, grid=401) / 1.3498980316e-3 - 1.0) < 1e-3)
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
        ends = [*([-math.inf] if inside[0] else []), *(0.5 * (low + high)), *([math.inf] if inside[-1] else [])]
        for a, b in zip(ends[::2], ends[1::2], strict=True):
            total += share * float(ndtr(b) - ndtr(a) if a < 0.0 else ndtr(-a) - ndtr(-b))
    return total


# --- Few calls of an expensive model: active learning on the public problems, with at most 200 calls.

CALLS: Final = 200
FEW_PROBLEMS: Final = ("four branches", "two-sided", "RP14", "RP25", "RP35", "RP53", "RP57", "RP110", "roof truss")


def few_call_text(repetitions: int, problems: Sequence[str] = FEW_PROBLEMS, at_once: int = 1) -> str:
    """`learn_probability` with at most 200 calls and as many seeds as there are repetitions, as a table."""
    rows, silent = [], 0
    for name in problems:
        tell(f"few calls: {name}")
        entry = problem(name)
        limit = LimitFunction(function=entry.function, dimension=entry.dimension)
        found = [active.learn_probability(limit, seed=1 + k, budget=CALLS, at_once=at_once) for k in range(repetitions)]
        errors = np.abs([(one.estimate.value or 0.0) / entry.reference - 1.0 for one in found])
        lows = np.array([one.estimate.low or 0.0 for one in found])
        highs = np.array([math.inf if one.estimate.high is None else one.estimate.high for one in found])
        held = (lows <= entry.reference) & (entry.reference <= highs)
        warned = np.array([bool(one.warning) or one.estimate.value is None for one in found])
        silent += int(((errors > 0.2) & ~held & ~warned).sum())
        missed = 0 if entry.modes is None else max(0, entry.modes - min(one.modes for one in found))
        rows.append((name, entry.dimension, repetitions, f"{np.mean([one.calls for one in found]):.0f}",
                     f"{np.sqrt(np.mean(errors**2)):.1%}", f"{errors.max():.1%}", f"{held.mean():.0%}",
                     f"{warned.mean():.0%}", missed))  # fmt: skip
    header = ("problem", "inputs", "runs", "calls", "rms error", "worst", "covered", "warned", "modes missed")
    return (f"Active learning with at most {CALLS} calls, for models of which an evaluation takes seconds.\n\n"
            f"{table(header, rows)}\n\nOff by more than 20 % without interval or warning: {silent}.")  # fmt: skip


def rival_text(repetitions: int, problems: Sequence[str] = FEW_PROBLEMS) -> str:
    """The same problems by OpenTURNS as its manual has it: FORM, then importance sampling about its design point to a
    half-width of 5 %, and subset simulation with 10,000 rows a level; calls of the model, and how far off.

    OpenTURNS has no learning.  Needs the package openturns.
    """
    import openturns as ot

    methods, rows = ("FORM", "importance sampling", "subset simulation"), []
    for name in problems:
        tell(f"OpenTURNS: {name}")
        entry, found = problem(name), {method: [] for method in methods}  # type: dict[str, list[tuple[int, float]]]
        for k in range(repetitions):
            ot.RandomGenerator.SetSeed(1 + k)
            calls = [0]

            def function(points: object, entry: Problem = entry, calls: list[int] = calls) -> Array:
                values = entry.function(np.asarray(points, dtype=float))
                calls[0] += len(values)
                return values[:, None]

            model = ot.PythonFunction(entry.dimension, 1, func_sample=function)
            normal = ot.RandomVector(ot.Normal(entry.dimension))
            event = ot.ThresholdEvent(ot.CompositeRandomVector(model, normal), ot.Less(), 0.0)
            solver = ot.Cobyla()
            solver.setStartingPoint([0.0] * entry.dimension)
            form = ot.FORM(solver, event)
            try:
                form.run()
                found["FORM"].append((calls[0], form.getResult().getEventProbability()))
                search = ot.PostAnalyticalImportanceSampling(form.getResult())
                search.setMaximumOuterSampling(100_000)
                search.setMaximumCoefficientOfVariation(0.05 / 1.96)
                search.run()
                found["importance sampling"].append((calls[0], search.getResult().getProbabilityEstimate()))
            except RuntimeError:  # it says itself that its design point is none
                tell(f"no design point of {name}, seed {1 + k}")
            calls[0] = 0
            search = ot.SubsetSampling(event)
            search.setBlockSize(100)
            search.setMaximumOuterSampling(100)
            search.run()
            found["subset simulation"].append((calls[0], search.getResult().getProbabilityEstimate()))
        cells = []
        for method in methods:
            errors = [abs(p / entry.reference - 1.0) for _, p in found[method]]
            cells += (
                [f"{np.mean([n for n, _ in found[method]]):,.0f}", f"{max(errors):.1%}"] if errors else ["none", ""]
            )
        rows.append((name, *cells))
    return table(("problem", *(head for method in methods for head in (f"{method}: calls", "worst"))), rows)


# --- The same problems as a user has them: studies with a budget in all, through `uqsphere.run`.

#: evaluations of a cheap model, and runs of an expensive one: how many in all, at what cost, how accurate
BUDGETS: Final = {"cheap": (30_000, "1 us", 0.015), "few": (CALLS, "10 s", 0.05)}
_STUDY: Final = """
title = "{name}"
seed = {seed}
[inputs]
{inputs}
[outputs]
names = ["g"]
[limits.failure]
quantity = "g"
strength = 0.0
aim = "break"
[analysis]
cost = "{cost}"
budget = {{ evaluations = {evaluations}, time = "100 h" }}
accuracy = {{ probability = {accuracy} }}
"""


def run_problem(entry: Problem, kind: str, seed: int, folder: Path) -> object:
    """The probability of failure that a run of a study gives, by the number of evaluations in all."""
    evaluations, cost, accuracy = BUDGETS[kind]
    names = [f"u{k}" for k in range(entry.dimension)]
    inputs = "\n".join(f'{name} = {{ dist = "normal", mean = 0.0, sd = 1.0 }}' for name in names)
    file = folder / f"{entry.name.replace(' ', '_')}-{kind}-{seed}.toml"
    text = _STUDY.format(name=entry.name, seed=seed, inputs=inputs, cost=cost, evaluations=evaluations,
                         accuracy=accuracy)  # fmt: skip
    file.write_text(text, encoding="utf-8")

    def model(x: dict[str, Array]) -> dict[str, Array]:
        return {"g": np.asarray(entry.function(np.column_stack([x[name] for name in names])))}

    results = uqsphere.run(uqsphere.load_study(file), out=file.with_suffix(""), model=model).results
    return results.limits["failure"].miss


def run_text(kind: str, repetitions: int, problems: Sequence[str], first: int = 1) -> str:
    """Every problem through `uqsphere.run`, with seeds from the `first` on: error and coverage of what is answered, and
    how often it is but a bound.  Intervals that miss the reference are told as they are found."""
    rows, errors, held = [], [], []
    for name in problems:
        tell(f"through run, {kind}: {name}")
        entry = problem(name)
        with tempfile.TemporaryDirectory() as place:
            found = [run_problem(entry, kind, first + k, Path(place)) for k in range(repetitions)]
        known = [one.value / entry.reference - 1.0 for one in found if one.value is not None]
        covered = [(one.low or 0.0) <= entry.reference <= (1.0 if one.high is None else one.high) for one in found]
        for k, one in enumerate(found):
            if not covered[k]:
                tell(f"{name}, seed {first + k}: {one.low} to {one.high} misses {entry.reference}")
        rms = float(np.sqrt(np.mean(np.square(known)))) if known else math.nan
        errors.append(rms)
        held += covered
        widths = [0.5 * (one.high - one.low) / entry.reference for one in found
                  if one.value is not None and one.high is not None and one.low is not None]  # fmt: skip
        rows.append((name, entry.dimension, f"{entry.reference:.3g}", f"{rms:.2%}",
                     f"{max(np.abs(known), default=math.nan):.1%}", f"{np.mean(covered):.0%}",
                     f"{np.mean(widths) if widths else math.nan:.2%}", len(found) - len(known)))  # fmt: skip
    header = ("problem", "inputs", "reference", "rms error", "worst", "covered", "half-width", "bounds alone")
    within = [sum(error <= bound for error in errors) for bound in (0.01, 0.03)]
    return (
        f"{BUDGETS[kind][0]:,} evaluations in all, {repetitions} runs of each.\n\n{table(header, rows)}\n\n"
        f"Rms error at most 1 % on {within[0]} and 3 % on {within[1]} of {len(rows)}; {np.mean(held):.1%} of the "
        "intervals hold the reference."
    )


# --- A margin of an expensive model: five inputs, two outputs, the asked one with a kink, 150 runs in all.

MARGIN_CASE: Final = """
title = "Margin of a kinked output"
seed = {seed}
[inputs]
a = {{ dist = "normal", mean = 1.0, sd = 0.1 }}
b = {{ dist = "normal", mean = 2.0, sd = 0.3 }}
c = {{ dist = "uniform", lower = 0.0, upper = 1.0 }}
d = {{ dist = "normal", mean = 0.0, sd = 1.0 }}
e = {{ dist = "lognormal", mean = 1.0, sd = 0.2 }}
x = 1.0
[outputs]
names = ["smooth", "kinked"]
[limits.high]
quantity = "kinked"
strength = 6.0
aim = "survive"
[margins]
solve = "x"
between = [0.5, 2.0]
for_probability = [0.01]
[analysis]
cost = "1 s"
budget = {{ evaluations = {runs}, time = "1 h" }}
"""
#: 6 over the 99 % quantile of the kinked output at x = 1, from four million rows: known to 3e-4
MARGIN_TRUTH: Final = 1.2137


def margin_model(v: dict[str, Array]) -> dict[str, Array]:
    """Both outputs of the case."""
    kinks = 0.6 * np.abs(v["d"] - 0.5) + np.maximum(v["c"] - 0.5, 0.0)
    return {"smooth": v["a"] * v["b"] + v["c"] * v["e"], "kinked": v["x"] * (v["a"] * v["b"] + kinks) * v["e"]}


def margin_text(repetitions: int, runs: int) -> str:
    """The value of x that keeps the probability below 1 % from so many runs, by seeds."""
    rows = []
    for seed in range(1, 1 + repetitions):
        tell(f"margin: seed {seed}")
        with tempfile.TemporaryDirectory() as place:
            file = Path(place) / "case.toml"
            file.write_text(MARGIN_CASE.format(seed=seed, runs=runs), encoding="utf-8")
            study = uqsphere.load_study(file)
            one = uqsphere.run(study, out=file.with_suffix(""), model=margin_model).results.margins["high"]
        if (e := one.values.get("0.01")) is None or e.low is None or e.high is None:
            rows.append((seed, "none", "", "", "no"))
            continue
        rows.append((seed, f"{e.value:.4f}", e.low, e.high, "yes" if e.low <= MARGIN_TRUTH <= e.high else "no"))
        tell(f"{e.value} {e.low} {e.high}")
    return table(("seed", "x at 1 %", "low", "high", "held"), rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the tables; progress goes to stderr.  Words `NAME=VALUE` are other constants of learning."""
    asked = options("Rare-event methods on public problems", arguments, words=(), repetitions=10, through_run=str,
                    first=1, margin=False, runs=150, few=False, at_once=1, rival=False)  # fmt: skip
    for name, value in (word.split("=") for word in asked.words):
        setattr(active, name, literal_eval(value))
    if asked.rival:
        print(rival_text(asked.repetitions))
        return 0
    if asked.margin or asked.few:
        few = partial(few_call_text, at_once=asked.at_once)
        print(margin_text(asked.repetitions, asked.runs) if asked.margin else few(asked.repetitions))
        return 0
    if asked.through_run:
        names = [entry.name for entry in PROBLEMS] if asked.through_run == "cheap" else FEW_PROBLEMS
        print(run_text(asked.through_run, asked.repetitions, names, asked.first))
        return 0
    print(rare_text(asked.repetitions))
    print()
    print(few_call_text(asked.repetitions))
    return 0


if __name__ == "__main__":
    sys.exit(main())
