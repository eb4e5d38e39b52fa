"""The likelihood of tests of single particles, its maximum, and the ensemble that draws from the posterior.

Every specimen says that its first fracture energy e lies in (lo, hi], or what it is:

    exact     ln f(e)
    interval  ln(P(hi) - P(lo)), from the tail that both lie in; lo = 0, or u_(k-1) E after k - 1 equal blows;
              hi = u_k E, or inf of a survivor

Parameters enter by their logarithms, x (R, W, d): R series or ensembles with W walkers each.  Sampler: the affine
invariant ensemble of J. Goodman and J. Weare, Commun. Appl. Math. Comput. Sci. 5 (2010) 65, stretch moves with a = 2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags, Places, Values
from uqsphere.feed import laws
from uqsphere.feed.tests import Specimens

#: ln of the largest number that a parameter can become: what lies beyond is a law that runs away
_FARTHEST: Final = 40.0
#: walkers of an ensemble, and the scale of its stretch moves, those of Goodman and Weare
WALKERS: Final = 32
_STRETCH: Final = 2.0
#: freedom of the t law about a mode, and the least curvature of a direction that it follows
_FREEDOM, _FLATTEST = 5.0, 0.1
#: gamma between which thresholds are interpolated: five standard deviations of the prior on either side, in ln; the
#: nodes leave 1e-9 of u_n up to n = 100
_GAMMA: Final = (0.7, 23.0)
_NODES: Final = 24
#: relative steps of the differences that find a maximum, and where its steps count as none
_STEP, _SETTLED, _MOST_STEPS = 1e-4, 1e-9, 80
#: ln of a bound that is none
_CERTAIN: Final = 1e4
#: rows of distinct tests above which they are gathered in cells of size and energy, and the first width of these
MOST_ROWS: Final = 4000
_CELL: Final = 0.005


@dataclass(frozen=True, kw_only=True)
class Prior:
    """ln theta is normal with this centre and scatter; `sd` inf: every ln theta is as likely."""

    centre: float = 0.0
    sd: float = math.inf


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """What specimens say: diameters, bounds by gamma and weights, with a leading axis R of series or 1.

    exact (R, m), at (R, m) sizes [m]; low, high (R, k) energies at `gamma`, or where that is nan and matters the
    polynomials of their logarithms (R, nodes, k); before, after (R, k, K) counts and blows (R, k, K) for a law whose
    damage is linear
    """

    exact: Array
    exact_at: Array
    exact_weight: Array
    low: Array
    high: Array
    at: Array
    weight: Array
    blows: Array
    before: Array
    after: Array
    survived: Flags
    gamma: float = math.nan
    classes: tuple[float, ...] = field(default=())

    @property
    def depends_on_gamma(self) -> bool:
        """Whether a bound depends on a gamma that is not given."""
        return self.low.ndim == 3


def evidence_of(series: Sequence[Specimens], gamma: float | None, classes: tuple[float, ...] = ()) -> Evidence:
    """The likelihood's view of series of tests, the shorter ones filled up with specimens of no weight; gamma None
    leaves it open where a specimen was hit twice."""
    exact = _filled([(one, np.flatnonzero(one.exact & one.broke)) for one in series])
    rest = _filled([(one, np.flatnonzero(~(one.exact & one.broke))) for one in series])
    blows, after, before, weight = (
        np.stack(part) for part in zip(*((o.energies, o.counts, o.before, o.weight) for o in rest), strict=True)
    )
    broke = np.stack([one.broke for one in rest])
    needs = bool((after.sum(axis=-1) > 1).any())
    nodes = _gammas() if gamma is None and needs else np.array(4.0 if gamma is None else gamma)
    spread = nodes.reshape(*nodes.shape, *(1,) * broke.ndim)
    low = laws.survivor_bound(blows, np.where(broke[..., None], before, after), spread)
    high = np.where(broke, laws.survivor_bound(blows, after, spread), np.inf)
    if nodes.ndim:
        low, high = _polynomial(low), _polynomial(high)
    return Evidence(
        exact=np.stack([one.last for one in exact]), exact_at=np.stack([one.diameter for one in exact]),
        exact_weight=np.stack([one.weight for one in exact]), low=low, high=high,
        at=np.stack([one.diameter for one in rest]), weight=weight, blows=blows,
        before=np.where(broke[..., None], before, after).astype(float), after=after.astype(float), survived=~broke,
        gamma=math.nan if gamma is None else gamma, classes=classes,
    )  # fmt: skip


def _filled(series: list[tuple[Specimens, Places]]) -> list[Specimens]:
    """Some specimens of every series, as many of each."""
    most = max(len(rows) for _, rows in series)
    found = []
    for one, rows in series:
        part = one.at(np.concatenate([rows, np.zeros(most - len(rows), dtype=np.int64)]))
        found.append(replace(part, weight=np.where(np.arange(most) < len(rows), part.weight, 0.0)))
    return found


def _gammas() -> Array:
    """Chebyshev nodes of ln gamma, as gamma."""
    low, high = np.log(_GAMMA)
    angles = math.pi * (np.arange(_NODES) + 0.5) / _NODES
    return np.asarray(np.exp(0.5 * (low + high) + 0.5 * (high - low) * np.cos(angles)))


def _polynomial(table: Array) -> Array:
    """Coefficients (R, nodes, k) of the Chebyshev polynomials in ln gamma of ln bounds (nodes, R, k).

    A bound of 0 or inf has none: it stands for itself, as ln 0 or ln inf at the first order.
    """
    known = np.isfinite(table[0]) & (table[0] > 0.0)
    angles = math.pi * (np.arange(_NODES) + 0.5) / _NODES
    transform = np.cos(np.arange(_NODES)[:, None] * angles) * (2.0 / _NODES)
    transform[0] *= 0.5
    found = np.tensordot(transform, np.log(np.where(known, table, 1.0)), axes=(1, 0))
    found[0] = np.where(known, found[0], np.where(table[0] > 0.0, _CERTAIN, -_CERTAIN))
    return np.ascontiguousarray(np.swapaxes(found, 0, 1))


def _at_gamma(coefficients: Array, log_gamma: Array) -> Array:
    """Bounds (R, W, k) at ln gamma (R, W)."""
    low, high = np.log(_GAMMA)
    u = np.clip((2.0 * log_gamma - low - high) / (high - low), -1.0, 1.0)
    return np.asarray(np.exp(np.cos(np.arange(_NODES) * np.arccos(u)[..., None]) @ coefficients))


# --- parameters -------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Model:
    """A law with a size law: the parameters whose logarithms are looked for, with their priors."""

    law: str
    size: str
    ratio: float
    priors: Mapping[str, Prior]
    classes: tuple[float, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.priors)

    def parameters(self, x: Array) -> dict[str, Array]:
        """Parameters (..., 1) of logarithms (..., d)."""
        return {name: np.exp(x[..., k : k + 1]) for k, name in enumerate(self.names)}

    def log_prior(self, x: Array) -> Array:
        """(...) of logarithms (..., d), without constants."""
        centre, precision = self._precisions
        far = (np.abs(x) > _FARTHEST).any(axis=-1)
        return np.where(far, -np.inf, -0.5 * np.square(x - centre) @ precision)

    @cached_property
    def _precisions(self) -> tuple[Array, Array]:
        """Centres and 1/sd² of the priors; 0 of a flat one."""
        parts = list(self.priors.values())
        return np.array([one.centre for one in parts]), np.array([1.0 / (one.sd * one.sd) for one in parts])

    def at(self, diameter: Array, p: Mapping[str, Array]) -> dict[str, Values]:
        """What the law is asked with at diameters (R, 1, m)."""
        found: dict[str, Values] = {"diameter": diameter, "ratio": self.ratio, **p}
        if not laws.LAWS[self.law].sized:
            return found
        if self.size != "class":
            return {**found, "median": laws.median_energy(self.size, diameter, p)}
        place = np.abs(np.log(diameter[..., None] / np.array(self.classes))).argmin(axis=-1)
        median: Values = 0.0
        for k in range(len(self.classes)):
            median = median + np.where(place == k, p[f"e50_{k + 1}"], 0.0)
        return {**found, "median": median}


def terms(model: Model, told: Evidence, x: Array) -> tuple[Array, Array]:
    """ln likelihood of every specimen (R, W, m) and (R, W, k), without its weight."""
    p, law = model.parameters(x), laws.LAWS[model.law]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        exact = law.density(told.exact[:, None, :], model.at(told.exact_at[:, None, :], p))
        if told.at.shape[1] == 0:
            return exact, np.zeros((*x.shape[:2], 0))
        at = model.at(told.at[:, None, :], p)
        if law.sized and told.depends_on_gamma:
            log_gamma = x[..., model.names.index("gamma")]
            low, high = _at_gamma(told.low, log_gamma), _at_gamma(told.high, log_gamma)
        else:
            low, high = bounds(model, told, at)
        return exact, law.between(low, high, at)


def bounds(model: Model, told: Evidence, at: Mapping[str, Values]) -> tuple[Array, Array]:
    """Energies (R, W, k) that every first fracture energy lies between, where no gamma is open."""
    if laws.LAWS[model.law].sized:
        return told.low[:, None], told.high[:, None]
    least = at["threshold"] / at["diameter"]
    low, high = (least + laws.excess_after(told.blows[:, None], n[:, None], least) for n in (told.before, told.after))
    return low, np.where(told.survived[:, None], np.inf, high)


def log_likelihood(model: Model, told: Evidence, x: Array) -> Array:
    """(R, W) of logarithms (R, W, d); -inf where there is none."""
    exact, between = terms(model, told, x)
    found = 0.0
    for part, weight in ((exact, told.exact_weight[:, None]), (between, told.weight[:, None])):
        found = found + np.where(weight > 0.0, part * np.where(weight > 0.0, weight, 1.0), 0.0).sum(axis=-1)
    return np.asarray(np.where(np.isnan(found), -np.inf, found))


# --- the maximum ------------------------------------------------------------------------------------------


def maximise(value: Callable[[Array], Array], start: Array) -> tuple[Array, Array, Flags]:
    """Newton's method by differences from (R, d): places (R, d), negative Hessians there (R, d, d), whether settled.

    `value` takes (R, P, d); where the Hessian is not negative it is stiffened, and a step that does not climb halved.
    """
    x, d = start.copy(), start.shape[-1]
    stencil, pairs = _stencil(d)
    best = value(x[:, None, :])[:, 0]
    settled = np.zeros(len(x), dtype=bool)
    curved = np.broadcast_to(np.eye(d), (len(x), d, d)).copy()
    for _ in range(_MOST_STEPS):
        found = value(x[:, None, :] + _STEP * stencil)
        # ln likelihood of what cannot be, for differences
        found = np.nan_to_num(found, posinf=0.0, neginf=-1e12)
        slope = (found[:, 1 : d + 1] - found[:, d + 1 : 2 * d + 1]) / (2.0 * _STEP)
        curved = _curvature(found, pairs, d)
        slope, curved = np.clip(slope, -1e12, 1e12), np.clip(curved, -1e12, 1e12)
        values, vectors = np.linalg.eigh(curved)
        stiff = np.maximum(np.abs(values), 1e-6 * np.abs(values).max(axis=1, keepdims=True) + 1e-12)
        step = np.einsum("rij,rj->ri", vectors, np.einsum("rji,rj->ri", vectors, slope) / stiff)
        step *= np.minimum(1.0, 2.0 / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-300))
        size = np.ones(len(x))
        for _ in range(30):
            following = value((x + size[:, None] * step)[:, None, :])[:, 0]
            worse = ~(following >= best - 1e-12 * np.abs(best))
            if not worse.any():
                break
            size = np.where(worse, 0.5 * size, size)
        x = np.where(worse[:, None], x, x + size[:, None] * step)
        best = np.where(worse, best, following)
        settled = np.abs(size[:, None] * step).max(axis=1) < _SETTLED
        if (settled | (np.abs(x) > _FARTHEST).any(axis=1)).all():
            break
    return x, curved, settled


def _stencil(d: int) -> tuple[Array, list[tuple[int, int]]]:
    """Offsets: none, one forth and one back along every axis, both forth along every pair and both back."""
    axes, pairs = np.eye(d), [(i, j) for i in range(d) for j in range(i)]
    both = np.array([axes[i] + axes[j] for i, j in pairs]).reshape(-1, d)
    return np.concatenate([np.zeros((1, d)), axes, -axes, both, -both]), pairs


def _curvature(found: Array, pairs: list[tuple[int, int]], d: int) -> Array:
    """Negative Hessians (R, d, d) of the values at the stencil."""
    centre, forth, back = found[:, :1], found[:, 1 : d + 1], found[:, d + 1 : 2 * d + 1]
    curved = np.zeros((len(found), d, d))
    curved[:, range(d), range(d)] = -(forth - 2.0 * centre + back) / _STEP**2
    count = len(pairs)
    for k, (i, j) in enumerate(pairs):
        mixed = found[:, 2 * d + 1 + k] + found[:, 2 * d + 1 + count + k] + 2.0 * centre[:, 0]
        mixed = (mixed - forth[:, i] - back[:, i] - forth[:, j] - back[:, j]) / (2.0 * _STEP**2)
        curved[:, i, j] = curved[:, j, i] = -mixed
    return curved


# --- the ensemble -----------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Hill:
    """A multivariate t law about a mode (R, d), as wide as its curvature says: where walkers start and jump to.

    `axes` (R, d, d) are eigenvectors in columns, `sd` (R, d) along them, no wider than a few in a flat direction.
    """

    mode: Array
    axes: Array
    sd: Array

    def draw(self, walkers: int, rng: np.random.Generator) -> Array:
        """(R, walkers, d)."""
        series, d = self.mode.shape
        stretch = np.sqrt(rng.chisquare(_FREEDOM, (series, walkers, 1)) / _FREEDOM)
        z = rng.standard_normal((series, walkers, d)) / stretch
        return np.asarray(self.mode[:, None] + np.einsum("rwi,rji->rwj", z * self.sd[:, None], self.axes))

    def log_density(self, x: Array) -> Array:
        """(R, W), without its constant."""
        z = np.einsum("rwj,rji->rwi", x - self.mode[:, None], self.axes) / self.sd[:, None]
        return np.asarray(-0.5 * (_FREEDOM + x.shape[-1]) * np.log1p(np.square(z).sum(axis=-1) / _FREEDOM))


def hill_at(mode: Array, curved: Array) -> Hill:
    """The t law of a mode (R, d) with its negative Hessian (R, d, d)."""
    values, vectors = np.linalg.eigh(curved)
    return Hill(mode=mode, axes=vectors, sd=1.0 / np.sqrt(np.clip(values, _FLATTEST, None)))


def hill_of(chain: Array) -> Hill:
    """The t law with mean and covariance of chains (steps, R, W, d), of all series of one density together."""
    flat = chain.reshape(-1, chain.shape[-1])
    values, vectors = np.linalg.eigh(np.cov(flat.T).reshape(flat.shape[1], -1))
    series = np.ones(chain.shape[1])
    return Hill(mode=series[:, None] * flat.mean(axis=0), axes=series[:, None, None] * vectors,
                sd=series[:, None] * np.sqrt(np.maximum(values, 1e-12)))  # fmt: skip


def ensemble(value: Callable[[Array], Array], x: Array, steps: int, rng: np.random.Generator, hill: Hill) -> Array:
    """Chains (steps, R, W, d) of the affine-invariant ensemble from walkers x (R, W, d).

    `value` takes (R, W/2, d) logarithms of a density: either half of the walkers moves along lines through the other.
    After both halves every walker is offered a jump to a draw of the hill, which takes it across in one step where the
    density is about normal, and costs nothing but a refusal where it is not.
    """
    series, walkers, d = x.shape
    half = walkers // 2
    halves = [x[:, :half].copy(), x[:, half:].copy()]
    at = [value(part) for part in halves]
    chain, rows = np.empty((steps, series, walkers, d)), np.arange(series)[:, None]
    for k in range(steps):
        for one, other in ((0, 1), (1, 0)):
            z = (1.0 + (_STRETCH - 1.0) * rng.random((series, half))) ** 2 / _STRETCH
            partner = halves[other][rows, rng.integers(half, size=(series, half))]
            moved = partner + z[..., None] * (halves[one] - partner)
            _move(halves, at, one, moved, value(moved), (d - 1.0) * np.log(z), rng)
            jumped = hill.draw(half, rng)
            favour = hill.log_density(halves[one]) - hill.log_density(jumped)
            _move(halves, at, one, jumped, value(jumped), favour, rng)
        chain[k, :, :half], chain[k, :, half:] = halves
    return chain


def _move(
    halves: list[Array], at: list[Array], one: int, moved: Array, there: Array, favour: Array, rng: np.random.Generator
) -> None:
    """Metropolis and Hastings: take what was proposed with the probability that its density and `favour` give."""
    with np.errstate(invalid="ignore"):
        take = np.log(rng.random(there.shape)) < favour + there - at[one]
    halves[one] = np.where(take[..., None], moved, halves[one])
    at[one] = np.where(take, there, at[one])


def split_r_hat(chain: Array) -> Array:
    """Split R-hat (...) of chains (steps, R, W, ...): the halves of every ensemble against each other."""
    steps = len(chain) // 2
    halves = np.concatenate([chain[:steps], chain[-steps:]], axis=1)
    means = halves.mean(axis=(0, 2))
    within = halves.var(axis=(0, 2)).mean(axis=0)
    return np.asarray(np.sqrt(1.0 + means.var(axis=0, ddof=1) / np.maximum(within, 1e-300)))


def effective_size(chain: Array) -> Array:
    """Effective number (...) of independent draws in chains (steps, R, W, ...), by their autocorrelation.

    Walkers' correlations are averaged and summed up to the first window of five times their sum (A. Sokal).
    """
    steps, series, walkers = chain.shape[:3]
    centred = chain - chain.mean(axis=(0, 1, 2))
    length = 1 << (2 * steps - 1).bit_length()
    power = np.abs(np.fft.rfft(centred, length, axis=0)) ** 2
    found = np.fft.irfft(power.mean(axis=(1, 2)), length, axis=0)[:steps]
    with np.errstate(invalid="ignore", divide="ignore"):
        sums = 2.0 * np.cumsum(found / found[0], axis=0) - 1.0
    short = np.arange(steps).reshape(-1, *(1,) * (sums.ndim - 1)) >= 5.0 * sums
    window = np.where(short.any(axis=0), short.argmax(axis=0), steps - 1)
    tau = np.take_along_axis(sums, window[None], axis=0)[0]
    return np.asarray(steps * series * walkers / np.maximum(np.where(np.isfinite(tau), tau, steps), 1.0))


# --- many rows --------------------------------------------------------------------------------------------


def in_cells(tests: Specimens) -> tuple[Specimens, float]:
    """At most `MOST_ROWS` specimens that stand for all, and the width of the cells in ln d and ln e; 0 where all stand.

    Specimens of one blow are gathered in cells of size and energy, at the mean of the logarithms in each.
    """
    found, width = tests.gathered(), 0.0
    if len(found) <= MOST_ROWS:
        return found, width
    single, width = ~found.repeated, _CELL
    one, rest = found.at(single), found.at(~single)
    while True:
        logs = np.log(np.column_stack([one.diameter, one.energies[:, 0]]))
        cells = np.column_stack([np.round(logs / width), one.broke, one.exact])
        _, first, place = np.unique(cells, axis=0, return_index=True, return_inverse=True)
        if len(first) + len(rest) <= MOST_ROWS or width > 0.2:
            break
        width *= 1.4
    place = place.ravel()
    weight = np.bincount(place, weights=one.weight).astype(float)
    centre = np.exp([np.bincount(place, weights=one.weight * part) / weight for part in logs.T])
    energies = np.zeros((len(first), found.energies.shape[1]))
    energies[:, 0] = centre[1]
    return replace(one.at(first), diameter=centre[0], energies=energies, weight=weight).join(rest), width
