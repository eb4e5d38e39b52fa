"""Ten analytical models that surrogates are commonly tried on, with the laws of their inputs.

Sources: Ishigami and Homma (ISUMA 1990); borehole: Harper and Gupta (ONWI-516, 1983) with radii and ranges as in
Morris, Mitchell and Ylvisaker (Technometrics 35, 1993, 243); OTL circuit and piston: Ben-Ari and Steinberg (Quality
Engineering 19, 2007, 327); wing weight: Forrester, Sobester and Keane (Engineering Design via Surrogate Modelling,
2008); g-function: Saltelli and Sobol' (1995); function of 20 inputs: Morris (Technometrics 33, 1991, 161), with the
random small coefficients left out; short column: Kuschel and Rackwitz (1997), here with independent inputs; flood:
Iooss and Lemaitre (2015), the overflow, whose bathtub of a dyke gives the kinked cost.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.expansion import germ_points
from uqsphere.uq.points import random_generator, sobol_points

__all__ = ["CHECKED", "MODELS", "ChaosModel", "checked", "design", "inputs_of", "relative_error"]

#: points on which the true error is counted
CHECKED: Final = 20_000


@dataclass(frozen=True, kw_only=True)
class ChaosModel:
    """A model of germs: laws are ("uniform", low, high), ("normal", mean, sd) or ("lognormal", mean, sd of ln)."""

    name: str
    laws: tuple[tuple[str, float, float], ...]
    function: Callable[[Array], Array]

    @property
    def germs(self) -> tuple[str, ...]:
        """Germ of every input: Legendre for a uniform one, Hermite for normal and lognormal ones."""
        return tuple("uniform" if law == "uniform" else "normal" for law, _, _ in self.laws)

    def __call__(self, germs: Array) -> Array:
        """Outputs (n,) at germ points (n, d)."""
        return np.asarray(self.function(inputs_of(self, germs)), dtype=np.float64)


def inputs_of(model: ChaosModel, germs: Array) -> Array:
    """Inputs (n, d) in their own units from germ points (n, d)."""
    inputs = np.empty_like(germs)
    for j, (law, first, second) in enumerate(model.laws):
        if law == "uniform":
            inputs[:, j] = first + 0.5 * (germs[:, j] + 1.0) * (second - first)
        else:
            inputs[:, j] = first + second * germs[:, j]
            if law == "lognormal":
                inputs[:, j] = np.exp(inputs[:, j])
    return inputs


def _uniform(*ranges: tuple[float, float]) -> tuple[tuple[str, float, float], ...]:
    return tuple(("uniform", low, high) for low, high in ranges)


def _lognormal(mean: float, sd: float) -> tuple[str, float, float]:
    spread = math.log1p((sd / mean) ** 2)
    return "lognormal", math.log(mean) - 0.5 * spread, math.sqrt(spread)


def _ishigami(x: Array) -> Array:
    return np.asarray(np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0]))


def _borehole(x: Array) -> Array:
    rw, r, tu, hu, tl, hl, length, kw = x.T
    log = np.log(r / rw)
    return np.asarray(2.0 * np.pi * tu * (hu - hl) / (log * (1.0 + 2.0 * length * tu / (log * rw**2 * kw) + tu / tl)))


def _otl(x: Array) -> Array:
    b1, b2, f, c1, c2, beta = x.T
    base = 12.0 * b2 / (b1 + b2)
    below = beta * (c2 + 9.0) + f
    return np.asarray(
        (base + 0.74) * beta * (c2 + 9.0) / below + 11.35 * f / below + 0.74 * f * beta * (c2 + 9.0) / (below * c1)
    )


def _piston(x: Array) -> Array:
    mass, area, volume, spring, pressure, ambient, gas = x.T
    force = pressure * area + 19.62 * mass - spring * volume / area
    free = area / (2.0 * spring) * (np.sqrt(force**2 + 4.0 * spring * pressure * volume * ambient / gas) - force)
    stiffness = spring + area**2 * pressure * volume * ambient / (gas * free**2)
    return np.asarray(2.0 * np.pi * np.sqrt(mass / stiffness))


def _wing(x: Array) -> Array:
    area, fuel, aspect, sweep, pressure, taper, thickness, load, gross, paint = x.T
    cosine = np.cos(np.radians(sweep))
    return np.asarray(
        0.036 * area**0.758 * fuel**0.0035 * (aspect / cosine**2) ** 0.6 * pressure**0.006 * taper**0.04
        * (100.0 * thickness / cosine) ** -0.3 * (load * gross) ** 0.49 + area * paint
    )  # fmt: skip


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
    return np.asarray(1.0 - 4.0 * moment / (width * height**2 * strength) - (force / (width * height * strength)) ** 2)


_SCATTER: Final = np.array([0.5, 0.3, 0.2, 0.2, 0.1, 0.1])


def _product(x: Array) -> Array:
    return np.asarray(np.prod(x, axis=1))


def _dyke(x: Array) -> Array:
    """Cost of a flood: the dyke is overtopped or not."""
    flow, strickler, downstream, upstream, height, crest, length, width = x.T
    slope = np.maximum(upstream - downstream, 1e-3) / length
    level = downstream + (flow / (width * strickler * np.sqrt(slope))) ** 0.6 - height - crest
    return np.asarray(np.maximum(level, -2.0))


#: name -> model
MODELS: Final = {
    model.name: model
    for model in (
        ChaosModel(name="Ishigami", laws=_uniform(*[(-math.pi, math.pi)] * 3), function=_ishigami),
        ChaosModel(
            name="borehole",
            laws=_uniform(
                (0.05, 0.15), (100.0, 50000.0), (63070.0, 115600.0), (990.0, 1110.0), (63.1, 116.0), (700.0, 820.0),
                (1120.0, 1680.0), (9855.0, 12045.0),
            ),
            function=_borehole,
        ),
        ChaosModel(
            name="OTL circuit",
            laws=_uniform((50.0, 150.0), (25.0, 70.0), (0.5, 3.0), (1.2, 2.5), (0.25, 1.2), (50.0, 300.0)),
            function=_otl,
        ),
        ChaosModel(
            name="piston",
            laws=_uniform(
                (30.0, 60.0), (0.005, 0.020), (0.002, 0.010), (1000.0, 5000.0), (90000.0, 110000.0), (290.0, 296.0),
                (340.0, 360.0),
            ),
            function=_piston,
        ),
        ChaosModel(
            name="wing weight",
            laws=_uniform(
                (150.0, 200.0), (220.0, 300.0), (6.0, 10.0), (-10.0, 10.0), (16.0, 45.0), (0.5, 1.0), (0.08, 0.18),
                (2.5, 6.0), (1700.0, 2500.0), (0.025, 0.08),
            ),
            function=_wing,
        ),
        ChaosModel(name="g-function", laws=_uniform(*[(0.0, 1.0)] * 8), function=_g_function),
        ChaosModel(name="Morris", laws=_uniform(*[(0.0, 1.0)] * 20), function=_morris),
        ChaosModel(
            name="short column",
            laws=(_lognormal(5.0, 0.5), ("normal", 2000.0, 400.0), ("normal", 500.0, 100.0)),
            function=_short_column,
        ),
        ChaosModel(
            name="product",
            laws=tuple(("lognormal", 0.0, float(sd)) for sd in _SCATTER),
            function=_product,
        ),
        ChaosModel(
            name="dyke",
            laws=(
                _lognormal(1300.0, 550.0), _lognormal(30.0, 5.0), *_uniform((49.0, 51.0), (54.0, 56.0), (7.0, 9.0),
                (45.0, 46.0), (4990.0, 5010.0), (295.0, 305.0)),
            ),
            function=_dyke,
        ),
    )
}  # fmt: skip


def design(model: ChaosModel, samples: int, seed: int) -> Array:
    """Germ points (n, d) of a scrambled Sobol' design."""
    from scipy.special import ndtri

    uniforms = sobol_points(dimension=len(model.laws), count=samples, seed=seed, task="chaos bench", replicate=0)
    return germ_points(ndtri(uniforms), model.germs)


def checked(model: ChaosModel) -> tuple[Array, Array]:
    """Germ points (n, d) that no fit has seen, and their outputs (n,)."""
    generator = random_generator(seed=0, task="chaos bench: check")
    points = germ_points(generator.standard_normal((CHECKED, len(model.laws))), model.germs)
    return points, model(points)


def relative_error(predicted: Array, outputs: Array) -> float:
    """Mean square error over the variance of the outputs, both (n,)."""
    return float(np.mean((predicted - outputs) ** 2) / np.var(outputs))
