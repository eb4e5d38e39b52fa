"""Twenty-two analytical models that surrogates are commonly tried on, with the laws of their
inputs.

Sources: Ishigami and Homma (ISUMA 1990); borehole: Harper and Gupta (ONWI-516, 1983) with radii and
ranges as in Morris, Mitchell and Ylvisaker (Technometrics 35, 1993, 243); OTL circuit and piston:
Ben-Ari and Steinberg (Quality Engineering 19, 2007, 327); wing weight: Forrester, Sobester and
Keane (Engineering Design via Surrogate Modelling, 2008); g-function: Saltelli and Sobol' (1995);
function of 20 inputs: Morris (Technometrics 33, 1991, 161), with the random small coefficients left
out; short column and steel column: Kuschel and Rackwitz (1997), here with independent inputs;
flood: Iooss and Lemaitre (2015), the overflow, whose bathtub of a dyke gives the kinked cost;
cantilever with two beta inputs, tube under bending, Chaboche's law and the stressed rod: use cases
of OpenTURNS 1.27; truss: Lee and Kwak (Struct. Multidisc. Optim. 31, 2006, 145) with the laws of
Blatman and Sudret (2011); Friedman (Ann. Statist. 19, 1991, 1); robot arm: An and Owen (J.
Complexity 17, 2001, 588); discontinuous: Genz (1984) in two inputs; damped oscillator: Igusa and
Der Kiureghian (1985); quadratic form of 15 normal numbers: all 136 terms of the second degree.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from tests.campaigns import options, table, tell
from uqsphere.arrays import Array
from uqsphere.uq.chaos.basis import (
    Germ,
    GermLike,
    base_of,
    germ_points,
    germs_of,
    hyperbolic_indices,
)
from uqsphere.uq.chaos.fit import fit_chaos
from uqsphere.uq.law import Law, make_law
from uqsphere.uq.points import random_generator, sobol_points

#: points on which the true error is counted
CHECKED: Final = 20_000


@dataclass(frozen=True, kw_only=True)
class ChaosModel:
    """A model of inputs (n, d) with independent laws."""

    name: str
    laws: tuple[Law, ...]
    function: Callable[[Array], Array]

    @property
    def germs(self) -> tuple[GermLike, ...]:
        """Germ of every input."""
        return germs_of(self.laws)

    def inputs(self, points: Array) -> Array:
        """Inputs (n, d) in their own units at germ points (n, d)."""
        from scipy.special import ndtri

        columns = [
            law.from_normal(ndtri(0.5 * (column + 1.0)) if base_of(germ) == "uniform" else column)
            for law, germ, column in zip(self.laws, self.germs, points.T, strict=True)
        ]
        return np.column_stack(columns)

    def __call__(self, points: Array) -> Array:
        """Outputs (n,) at germ points (n, d)."""
        return np.asarray(self.function(self.inputs(points)), dtype=np.float64)


def _law(kind: str, lower: float | None = None, upper: float | None = None, **given: float) -> Law:
    return make_law(kind, given, lower, upper)


def _uniform(*ranges: tuple[float, float]) -> tuple[Law, ...]:
    return tuple(_law("uniform", low, high) for low, high in ranges)


def _normal(mean: float, sd: float) -> Law:
    return _law("normal", mean=mean, sd=sd)


def _lognormal(mean: float, sd: float) -> Law:
    return _law("lognormal", mean=mean, sd=sd)


def _ishigami(x: Array) -> Array:
    return np.asarray(
        np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    )


def _borehole(x: Array) -> Array:
    rw, r, tu, hu, tl, hl, length, kw = x.T
    log = np.log(r / rw)
    return np.asarray(
        2.0
        * np.pi
        * tu
        * (hu - hl)
        / (log * (1.0 + 2.0 * length * tu / (log * rw**2 * kw) + tu / tl))
    )


def _otl(x: Array) -> Array:
    b1, b2, f, c1, c2, beta = x.T
    base = 12.0 * b2 / (b1 + b2)
    below = beta * (c2 + 9.0) + f
    return np.asarray(
        (base + 0.74) * beta * (c2 + 9.0) / below
        + 11.35 * f / below
        + 0.74 * f * beta * (c2 + 9.0) / (below * c1)
    )


def _piston(x: Array) -> Array:
    mass, area, volume, spring, pressure, ambient, gas = x.T
    force = pressure * area + 19.62 * mass - spring * volume / area
    free = (
        area
        / (2.0 * spring)
        * (np.sqrt(force**2 + 4.0 * spring * pressure * volume * ambient / gas) - force)
    )
    stiffness = spring + area**2 * pressure * volume * ambient / (gas * free**2)
    return np.asarray(2.0 * np.pi * np.sqrt(mass / stiffness))


def _wing(x: Array) -> Array:
    area, fuel, aspect, sweep, pressure, taper, thickness, load, gross, paint = x.T
    cosine = np.cos(np.radians(sweep))
    return np.asarray(
        0.036
        * area**0.758
        * fuel**0.0035
        * (aspect / cosine**2) ** 0.6
        * pressure**0.006
        * taper**0.04
        * (100.0 * thickness / cosine) ** -0.3
        * (load * gross) ** 0.49
        + area * paint
    )


_G: Final = np.array([0.0, 1.0, 4.5, 9.0, 99.0, 99.0, 99.0, 99.0])


def _g_function(x: Array) -> Array:
    return np.asarray(np.prod((np.abs(4.0 * x - 2.0) + _G) / (1.0 + _G), axis=1))


def _morris(x: Array) -> Array:
    w = 2.0 * (x - 0.5)
    for j in (2, 4, 6):
        w[:, j] = 2.0 * (1.1 * x[:, j] / (x[:, j] + 0.1) - 0.5)
    y = 20.0 * w[:, :10].sum(axis=1)
    head = w[:, :6].sum(axis=1)
    y -= 15.0 * 0.5 * (head**2 - (w[:, :6] ** 2).sum(axis=1))
    triples = w[:, :5]
    s1, s2, s3 = (np.sum(triples**k, axis=1) for k in (1, 2, 3))
    y -= 10.0 * (s1**3 - 3.0 * s1 * s2 + 2.0 * s3) / 6.0
    return np.asarray(y + 5.0 * w[:, 0] * w[:, 1] * w[:, 2] * w[:, 3])


def _short_column(x: Array) -> Array:
    strength, moment, force = x.T
    width, height = 5.0, 15.0
    return np.asarray(
        1.0
        - 4.0 * moment / (width * height**2 * strength)
        - (force / (width * height * strength)) ** 2
    )


_SCATTER: Final = np.array([0.5, 0.3, 0.2, 0.2, 0.1, 0.1])


def _product(x: Array) -> Array:
    return np.asarray(np.prod(x, axis=1))


def _flood(x: Array) -> Array:
    """How far a river overtops its dyke."""
    flow, strickler, downstream, upstream, height, crest, length, width = x.T
    slope = np.maximum(upstream - downstream, 1e-3) / length
    return np.asarray(
        downstream + (flow / (width * strickler * np.sqrt(slope))) ** 0.6 - height - crest
    )


def _dyke(x: Array) -> Array:
    """Cost of a flood: the dyke is overtopped or not."""
    return np.asarray(np.maximum(_flood(x), -2.0))


def _cantilever(x: Array) -> Array:
    """Deflection under a load at the end."""
    modulus, load, length, inertia = x.T
    return np.asarray(load * length**3 / (3.0 * modulus * inertia))


def _tube(x: Array) -> Array:
    """Deflection of a hollow beam under a load at a from its end."""
    load, length, place, outer, inner, modulus = x.T
    inertia = np.pi * (outer**4 - inner**4) / 32.0
    return np.asarray(-load * place**2 * (length - place) ** 2 / (3.0 * modulus * length * inertia))


def _chaboche(x: Array) -> Array:
    """Stress of a hardening metal at a strain."""
    strain, limit, hardening, rate = x.T
    return np.asarray(limit + hardening / rate * -np.expm1(-rate * strain))


def _rod(x: Array) -> Array:
    return np.asarray(x[:, 0] - x[:, 1] / (100.0 * np.pi))


def _steel_column(x: Array) -> Array:
    limit, dead, one, other, breadth, flange, height, bend, modulus = x.T
    load = dead + one + other
    euler = np.pi**2 * modulus * breadth * flange * height**2 / (2.0 * 7500.0**2)
    return np.asarray(
        limit
        - load
        * (
            1.0 / (2.0 * breadth * flange)
            + bend * euler / (breadth * flange * height * (euler - load))
        )
    )


def _truss(x: Array) -> Array:
    """Deflection of the middle of a truss of 23 bars: 6 panels of 4 m, 2 m high, loads on the upper
    chord.
    """
    chord, diagonal, area, slender = x[:, 6:].T
    place = 2.0 + 4.0 * np.arange(6)  # of the loads
    # shear and moment of a simply supported beam of 24 m carry over to the bars (method of
    # sections)
    shear = np.array(
        [[(24.0 - p) / 24.0 - (p < at) for p in place] for at in np.arange(1.0, 24.0, 2.0)]
    )
    moment = np.array(
        [
            [(24.0 - p) / 24.0 * at - max(at - p, 0.0) for p in place]
            for at in np.arange(2.0, 24.0, 2.0)
        ]
    )
    unit_shear = np.array([0.5 if at < 12.0 else -0.5 for at in np.arange(1.0, 24.0, 2.0)])
    unit_moment = np.array([0.5 * at - max(at - 12.0, 0.0) for at in np.arange(2.0, 24.0, 2.0)])
    forces = x[:, :6]
    slanted = math.sqrt(2.0)  # bars at 45 degrees carry sqrt 2 of the shear
    along = (forces @ moment.T) @ (unit_moment / 4.0) * 4.0 / (chord * area)
    across = (forces @ shear.T) @ unit_shear * 2.0 * 2.0 * slanted / (diagonal * slender)
    return np.asarray(along + across)


def _friedman(x: Array) -> Array:
    return np.asarray(
        10.0 * np.sin(np.pi * x[:, 0] * x[:, 1])
        + 20.0 * (x[:, 2] - 0.5) ** 2
        + 10.0 * x[:, 3]
        + 5.0 * x[:, 4]
    )


def _robot(x: Array) -> Array:
    turned = np.cumsum(x[:, :4], axis=1)
    return np.hypot(
        (x[:, 4:] * np.cos(turned)).sum(axis=1), (x[:, 4:] * np.sin(turned)).sum(axis=1)
    )


def _discontinuous(x: Array) -> Array:
    return np.where((x > 0.5).any(axis=1), 0.0, np.exp(5.0 * x.sum(axis=1)))


def _oscillator(x: Array) -> Array:
    """Force on the spring of a secondary system on a primary one, both shaken by white noise: its
    peak.
    """
    mass, second, stiffness, soft, damping, own, shaking = x.T
    omega, other = np.sqrt(stiffness / mass), np.sqrt(soft / second)
    ratio, mean = second / mass, 0.5 * (omega + other)
    damped, apart = 0.5 * (damping + own), (omega - other) / mean
    square = (
        np.pi
        * shaking
        / (4.0 * own * other**3)
        * damped
        * own
        / (damping * own * (4.0 * damped**2 + apart**2) + ratio * damped**2)
        * (damping * omega**3 + own * other**3)
        * omega
        / (4.0 * damped * mean**4)
    )
    return np.asarray(3.0 * soft * np.sqrt(square))


def _quadratic(x: Array) -> Array:
    i = np.arange(1.0, x.shape[1] + 1.0)
    return np.asarray(np.sum(x @ np.cos(np.add.outer(i, 2.0 * i)) * x, axis=1) + x @ np.sin(i))


#: name -> model
MODELS: Final = {
    name: ChaosModel(name=name, laws=laws, function=function)
    for name, laws, function in (
        ("Ishigami", _uniform(*[(-math.pi, math.pi)] * 3), _ishigami),
        (
            "borehole",
            _uniform(
                (0.05, 0.15),
                (100.0, 50000.0),
                (63070.0, 115600.0),
                (990.0, 1110.0),
                (63.1, 116.0),
                (700.0, 820.0),
                (1120.0, 1680.0),
                (9855.0, 12045.0),
            ),
            _borehole,
        ),
        (
            "OTL circuit",
            _uniform(
                (50.0, 150.0), (25.0, 70.0), (0.5, 3.0), (1.2, 2.5), (0.25, 1.2), (50.0, 300.0)
            ),
            _otl,
        ),
        (
            "piston",
            _uniform(
                (30.0, 60.0),
                (0.005, 0.020),
                (0.002, 0.010),
                (1000.0, 5000.0),
                (90000.0, 110000.0),
                (290.0, 296.0),
                (340.0, 360.0),
            ),
            _piston,
        ),
        (
            "wing weight",
            _uniform(
                (150.0, 200.0),
                (220.0, 300.0),
                (6.0, 10.0),
                (-10.0, 10.0),
                (16.0, 45.0),
                (0.5, 1.0),
                (0.08, 0.18),
                (2.5, 6.0),
                (1700.0, 2500.0),
                (0.025, 0.08),
            ),
            _wing,
        ),
        ("g-function", _uniform(*[(0.0, 1.0)] * 8), _g_function),
        ("Morris", _uniform(*[(0.0, 1.0)] * 20), _morris),
        (
            "short column",
            (_lognormal(5.0, 0.5), _normal(2000.0, 400.0), _normal(500.0, 100.0)),
            _short_column,
        ),
        (
            "product",
            tuple(_law("lognormal", log_mean=0.0, log_sd=float(sd)) for sd in _SCATTER),
            _product,
        ),
        (
            "dyke",
            (
                _lognormal(1300.0, 550.0),
                _lognormal(30.0, 5.0),
                *_uniform(
                    (49.0, 51.0),
                    (54.0, 56.0),
                    (7.0, 9.0),
                    (45.0, 46.0),
                    (4990.0, 5010.0),
                    (295.0, 305.0),
                ),
            ),
            _dyke,
        ),
        (
            "flood",
            (
                _law("gumbel", 500.0, 3000.0, location=1013.0, scale=558.0),
                _law("normal", 15.0, mean=30.0, sd=8.0),
                _law("triangular", 49.0, 51.0, mode=50.0),
                _law("triangular", 54.0, 56.0, mode=55.0),
                *_uniform((7.0, 9.0)),
                _law("triangular", 55.0, 56.0, mode=55.5),
                _law("triangular", 4990.0, 5010.0, mode=5000.0),
                _law("triangular", 295.0, 305.0, mode=300.0),
            ),
            _flood,
        ),
        (
            "cantilever",
            (
                _law("beta", 2.8e7, 4.8e7, alpha=0.9, beta=2.2),
                _lognormal(30000.0, 9000.0),
                *_uniform((250.0, 260.0)),
                _law("beta", 310.0, 450.0, alpha=2.5, beta=1.5),
            ),
            _cantilever,
        ),
        (
            "tube",
            (
                _normal(1.0, 0.1),
                _normal(1.5, 0.01),
                *_uniform((0.7, 1.2)),
                _law("triangular", 0.75, 0.85, mode=0.8),
                _law("triangular", 0.09, 0.11, mode=0.1),
                _normal(2e5, 2e3),
            ),
            _tube,
        ),
        (
            "Chaboche",
            (
                *_uniform((0.0, 0.07)),
                _lognormal(750e6, 11e6),
                _normal(2750e6, 250e6),
                _normal(10.0, 2.0),
            ),
            _chaboche,
        ),
        ("rod", (_lognormal(300.0, 30.0), _normal(75e3, 5e3)), _rod),
        (
            "steel column",
            (
                _lognormal(400.0, 35.0),
                _normal(5e5, 5e4),
                _law("gumbel", mean=6e5, sd=9e4),
                _law("gumbel", mean=6e5, sd=9e4),
                _lognormal(300.0, 3.0),
                _lognormal(20.0, 2.0),
                _lognormal(300.0, 5.0),
                _normal(30.0, 10.0),
                _law("weibull", mean=2.1e5, modulus=63.4),
            ),
            _steel_column,
        ),
        (
            "truss",
            (
                *[_law("gumbel", mean=5e4, sd=7.5e3)] * 6,
                *[_lognormal(2.1e11, 2.1e10)] * 2,
                _lognormal(2e-3, 2e-4),
                _lognormal(1e-3, 1e-4),
            ),
            _truss,
        ),
        ("Friedman", _uniform(*[(0.0, 1.0)] * 10), _friedman),
        ("robot arm", _uniform(*[(0.0, 2.0 * math.pi)] * 4, *[(0.0, 1.0)] * 4), _robot),
        ("discontinuous", _uniform(*[(0.0, 1.0)] * 2), _discontinuous),
        (
            "damped oscillator",
            (
                _lognormal(1.5, 0.15),
                _lognormal(0.01, 0.001),
                _lognormal(1.0, 0.2),
                _lognormal(0.01, 0.002),
                _lognormal(0.05, 0.02),
                _lognormal(0.02, 0.01),
                _lognormal(100.0, 10.0),
            ),
            _oscillator,
        ),
        ("quadratic form", (_normal(0.0, 1.0),) * 15, _quadratic),
    )
}


def design(model: ChaosModel, samples: int, seed: int) -> Array:
    """Germ points (n, d) of a scrambled Sobol' design."""
    from scipy.special import ndtri

    uniforms = sobol_points(
        dimension=len(model.laws), count=samples, seed=seed, task="chaos bench", replicate=0
    )
    return germ_points(ndtri(uniforms), model.germs)


def checked(model: ChaosModel) -> tuple[Array, Array]:
    """Germ points (n, d) that no fit has seen, and their outputs (n,)."""
    generator = random_generator(seed=0, task="chaos bench: check")
    points = germ_points(generator.standard_normal((CHECKED, len(model.laws))), model.germs)
    return points, model(points)


def relative_error(predicted: Array, outputs: Array) -> float:
    """Mean square error over the variance of the outputs, both (n,)."""
    return float(np.mean((predicted - outputs) ** 2) / np.var(outputs))


# --- what is measured -----------------------------------------------------------------------------


def measured(name: str, samples: int, seed: int) -> tuple[float, float, float, str]:
    """True and reported relative mean square error of a fit, its CPU seconds (one thread), and what
    it is.
    """
    model = MODELS[name]
    points, (unseen, truth) = design(model, samples, seed), checked(model)
    outputs = model(points)
    begin = time.process_time()
    fit = fit_chaos(points, outputs, model.germs)
    seconds = time.process_time() - begin
    return (
        relative_error(fit.predict(unseen), truth),
        fit.cross_validation_error,
        seconds,
        repr(fit),
    )


# --- OpenTURNS on the same points (the extra `peers`) ---------------------------------------------


def peer_errors(name: str, samples: int, seed: int) -> tuple[float, float]:
    """True errors of OpenTURNS: on the basis that it takes by itself, and on the one of its least
    own error.

    LARS with the corrected leave-one-out error, in our germs where they are normal or uniform, else
    in the polynomials that it finds for the law.  Its own basis has as many terms as points, of
    norm 1/2; the other is the best by its own error of degrees 1 to 15 and norms 1, 3/4 and 1/2, of
    at most 4 N terms.
    """
    import openturns as ot

    ot.Log.Show(ot.Log.NONE)
    ot.TBB.SetThreadsNumber(1)
    ot.ResourceMap.SetAsBool("FunctionalChaosAlgorithm-Sparse", True)
    model = MODELS[name]
    points, (unseen, truth) = design(model, samples, seed), checked(model)
    own = [isinstance(germ, Germ) for germ in model.germs]
    places = ot.Sample(np.where(own, model.inputs(unseen), unseen))
    laws = [_peer_law(ot, law, germ) for law, germ in zip(model.laws, model.germs, strict=True)]
    given = (
        ot.Sample(np.where(own, model.inputs(points), points)),
        ot.Sample(model(points)[:, None]),
    )

    def fitted(*basis: Any) -> tuple[float, float]:
        algorithm = ot.FunctionalChaosAlgorithm(*given, ot.JointDistribution(laws), *basis)
        algorithm.run()
        result = algorithm.getResult()
        found = np.asarray(result.getMetaModel()(places))[:, 0]
        return min(result.getErrorHistory(), default=1.0), relative_error(found, truth)

    families = [ot.StandardDistributionPolynomialFactory(law) for law in laws]
    lars = ot.LeastSquaresStrategy(
        ot.LeastSquaresMetaModelSelectionFactory(ot.LARS(), ot.CorrectedLeaveOneOut())
    )
    tried = [(1.0, 1.0)]
    for norm in (1.0, 0.75, 0.5):
        order, worse = ot.HyperbolicAnisotropicEnumerateFunction(len(laws), norm), 0
        basis = ot.OrthogonalProductPolynomialFactory(families, order)
        for degree in range(1, 16):
            terms = hyperbolic_indices(len(laws), degree, norm, max(4 * samples, len(laws) + 1))
            if terms is None or worse == 2:
                break
            tried.append(fitted(ot.FixedStrategy(basis, len(terms)), lars))
            worse = 0 if tried[-1] <= min(tried) else worse + 1
    return fitted()[1], min(tried)[1]


def _peer_law(ot: Any, law: Law, germ: GermLike) -> Any:
    """The law that OpenTURNS expands an input in."""
    if not isinstance(germ, Germ):
        return ot.Uniform(-1.0, 1.0) if germ == "uniform" else ot.Normal(0.0, 1.0)
    own = law.parameters
    whole = {
        "beta": lambda: ot.Beta(own["alpha"], own["beta"], law.lower, law.upper),
        "gumbel": lambda: ot.Gumbel(own["scale"], own["location"]),
        "normal": lambda: ot.Normal(own["mean"], own["sd"]),
        "triangular": lambda: ot.Triangular(law.lower, own["mode"], law.upper),
        "weibull": lambda: ot.WeibullMin(own["scale"], own["modulus"]),
    }[law.family.name]()
    if law.family.name in ("beta", "triangular") or (
        math.isinf(law.lower) and math.isinf(law.upper)
    ):
        return whole
    return ot.TruncatedDistribution(
        whole, ot.Interval([max(law.lower, -1e300)], [min(law.upper, 1e300)])
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Medians over the seeds of each model and size, `--openturns` with those of OpenTURNS;
    progress goes to stderr.
    """
    given = options(
        "Sparse polynomial chaos on 22 analytical models",
        arguments,
        models=[*MODELS],
        sizes=[64, 128, 256],
        seeds=[1, 41, 42],
        openturns=False,
    )
    measured("product", 64, 0)  # what is loaded once
    rows, honest, count, level = [], 0, 0, dict.fromkeys(given.sizes, 0)
    for name in given.models:
        for samples in given.sizes:
            found = [measured(name, samples, seed) for seed in given.seeds]
            for true, reported, _, _ in found:
                low, high = sorted((max(true, 1e-24), max(reported, 1e-24)))
                honest, count = honest + (high <= 3.0 * low), count + 1
            true, reported, seconds = (
                float(np.median([one[k] for one in found])) for k in range(3)
            )
            row = [
                name,
                str(samples),
                f"{true:.1e}",
                f"{reported:.1e}",
                f"{seconds:.2f}",
                found[0][3],
            ]
            if given.openturns:
                peers = np.median(
                    [peer_errors(name, samples, seed) for seed in given.seeds], axis=0
                )
                level[samples] += true <= max(1.05 * float(peers.min()), 1e-10)
                row[3:] = [f"{peer:.1e}" for peer in peers]
            rows.append(row)
            tell(" ".join(row))
    own = (
        ["reported", "s", "fit"]
        if not given.openturns
        else ["OpenTURNS, own basis", "OpenTURNS, least own error"]
    )
    print(table(["model", "N", "true error", *own], rows))
    if given.openturns:
        counts = ", ".join(f"{number} at {samples}" for samples, number in level.items())
        print(
            f"\nNo worse than the better of both by 5 % or 1e-10, of {len(given.models)} models: "
            f"{counts}."
        )
    else:
        print(f"\nReported within a factor 3 of the true error: {honest} of {count}.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
