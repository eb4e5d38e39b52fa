"""A feed of sizes under repeated blows: which share breaks, how fine, for which energy, how sure.

Every class of sizes has one particle size, the geometric mean of its sieves.  The answers are computed for every draw
of the posterior: their scatter over draws is ignorance, which more tests make smaller.  A lot of so many particles
scatters besides.  For the broken share of N particles

    V = Var(P) + E[P (1 - P)]/N                                                                             (F10)

Energies are those offered to a particle per its mass; it takes up `share` of them itself, (S2).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.special import ndtr

from uqsphere.arrays import Array
from uqsphere.feed import laws
from uqsphere.feed.fit import Posterior
from uqsphere.feed.product import Product
from uqsphere.uq import Law, sobol_points

#: series of blows of a spectrum: in so many randomisations, which tell its error, and draws that are asked with them
SERIES, RANDOMISATIONS, SPECTRUM_DRAWS = 512, 8, 200
_EACH: Final = SERIES // RANDOMISATIONS
#: energies of the last blow, and fracture energies, that fineness is told apart by
_BINS, _OWN = 16, 8
#: numbers (draw, blow, bin, class, sieve) of product curves that are held at once [80 MB]
_MOST: Final = 10_000_000
#: sieves between those of the classes, and below the last of them: as fine as the largest particle over this
_BETWEEN, _FINEST = 4, 2000.0
_SPHERE: Final = math.pi / 6.0

# --- the feed -----------------------------------------------------------------------------------------------

#: share finer than x [m] of a size distribution, by name, with its parameters in SI
PASSING: Final[Mapping[str, Callable[[Array, Mapping[str, float]], Array]]] = {
    "rosin_rammler": lambda x, p: -np.expm1(-((x / p["d63"]) ** p["n"])),
    "gaudin_schuhmann": lambda x, p: np.minimum(x / p["top"], 1.0) ** p["n"],
    "lognormal": lambda x, p: ndtr(np.log(x / p["d50"]) / p["log_sd"]),
}


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """A size distribution by mass: of a law of `PASSING`, or of a table of sieves (ascending, m) with shares finer,
    which is linear in ln x between them and as x below the first.  Cut at `top` [m].

    >>> Sizes(sieves=(0.01, 0.1), finer=(0.5, 1.0), top=0.1).passing(np.array([0.005, 0.1])).tolist()
    [0.25, 1.0]
    """

    law: str = "table"
    parameters: Mapping[str, float] = field(default_factory=dict)
    sieves: tuple[float, ...] = ()
    finer: tuple[float, ...] = ()
    top: float

    def passing(self, x: Array) -> Array:
        """Share finer than x [m]."""
        whole = float(self._whole(np.array([self.top]))[0])
        return np.minimum(self._whole(np.minimum(x, self.top)) / whole, 1.0)

    def _whole(self, x: Array) -> Array:
        if self.law != "table":
            return PASSING[self.law](x, self.parameters)
        inside = np.interp(np.log(x), np.log(self.sieves), self.finer)
        return np.where(x < self.sieves[0], self.finer[0] * x / self.sieves[0], inside)


@dataclass(frozen=True, kw_only=True, eq=False)
class Classes:
    """Sieves (K + 1,) [m] from the top down, mass shares and particle sizes (K + 1,) of the classes and the rest."""

    edges: Array
    mass: Array
    sizes: Array
    of: Sizes

    def passing(self, x: Array) -> Array:
        """Share of the feed finer than x [m]."""
        return self.of.passing(x)


def make_classes(sizes: Sizes, *, ratio: float, count: int) -> Classes:
    """Classes of a size distribution: `count` of them from its top, each `ratio` below the last.

    >>> made = make_classes(Sizes(sieves=(1e-6, 0.1), finer=(1e-5, 1.0), top=0.1), ratio=2.0, count=3)
    >>> (1e3 * made.edges).tolist()
    [100.0, 50.0, 25.0, 12.5]
    """
    edges = sizes.top * ratio ** -np.arange(count + 1.0)
    finer = sizes.passing(edges)
    mass = np.append(finer[:-1] - finer[1:], finer[-1])
    middle = np.append(edges[1:] * math.sqrt(ratio), edges[-1] / ratio)
    return Classes(edges=edges, mass=mass, sizes=middle, of=sizes)


@dataclass(frozen=True, kw_only=True)
class Blows:
    """What hits a particle `count` times: `energy` is a number or a law, of J/kg, J or m/s as `kind` says.

    kind : "specific" (the same per mass for all sizes), "energy" (the same per blow) or "speed"
    share : of it that the particle takes up itself
    """

    count: int
    kind: str
    energy: float | Law
    share: float = 1.0

    def offered(self, values: Array, sizes: Array, density: float) -> Array:
        """J/kg (..., K) of values (...) of `energy` at sizes (K,)."""
        if self.kind == "energy":
            return values[..., None] / (_SPHERE * density * sizes**3)
        specific = 0.5 * values**2 if self.kind == "speed" else values
        return np.repeat(specific[..., None], len(sizes), axis=-1)

    def series(self, seed: int) -> Array:
        """Energies (S, n) of series of blows: one where they are all the same."""
        if not isinstance(self.energy, Law):
            return np.full((1, self.count), self.energy)
        parts = [
            sobol_points(dimension=self.count, count=_EACH, seed=seed, task="feed.blows", replicate=replicate)
            for replicate in range(RANDOMISATIONS)
        ]
        return np.asarray(self.energy.ppf(np.concatenate(parts)))


@dataclass(frozen=True, kw_only=True)
class Feed:
    """A feed and what happens to it.

    progeny : "out" (fragments leave) or "again" (they are fresh particles that get the blows that are left)
    rest_breaks : whether what is finer than the last sieve breaks too
    density : of the particles [kg/m³]; lot : mass of a lot [kg], inf without one
    fines : sieve [m] whose passing is asked for
    """

    classes: Classes
    blows: Blows
    density: float
    progeny: str = "out"
    rest_breaks: bool = False
    lot: float = math.inf
    fines: float | None = None
    seed: int = 0


# --- who breaks when ----------------------------------------------------------------------------------------


def draws_for(product: Product, feed: Feed, most: int) -> int:
    """How many draws the feed is computed with: `most`, or fewer where every one of them is dear."""
    if isinstance(feed.blows.energy, Law):
        return min(most, SPECTRUM_DRAWS)
    dear = feed.blows.count * (_OWN if product.form == "tavares_own" else 1) if product.form != "jk" else 1
    return min(most, max(SPECTRUM_DRAWS, most // (4 * dear if feed.progeny == "again" else dear)))


@dataclass(frozen=True, kw_only=True)
class Breaking:
    """Fresh particles of D draws and K classes: what breaks at every blow, in bins of fineness.

    share : (D, n, B, K) that breaks at the blow; t10 : (D, 1 or n, B, K); error : standard error of the total by the
    spectrum
    """

    share: Array
    t10: Array
    error: float


def _bounds(energy: Array, name: str, p: Mapping[str, Array], gamma: Array | None) -> Array:
    """First fracture energy up to which particles are broken by the first k blows, (R, n, S, K), k = 1 ... n.

    energy : the particle's own of blow 1 ... n, (n, S, K); p of shape (R, 1, 1 or K)
    """
    n = len(energy)
    if not laws.LAWS[name].sized:
        least = np.asarray(p["threshold"] / p["diameter"])
        return np.asarray(least + np.cumsum(np.maximum(energy[None] - least, 0.0), axis=1))
    if n == 1:
        return np.asarray(energy[None])
    assert gamma is not None
    if energy.shape[1] == 1:
        reach = laws.thresholds(gamma, n)[:, 1:]
        return np.asarray(reach[:, :, None, None] * energy[:1])
    # a bound is homogeneous in the energies, which differ between classes by a factor alone
    scale = energy[0, 0] / energy[0, 0, 0]
    bound = np.empty((len(gamma), n, energy.shape[1]))
    for k in range(n):
        c = np.broadcast_to(energy[k, :, 0], bound[:, k].shape)
        for before in range(k - 1, -1, -1):
            c = energy[before, :, 0] * laws.before_blow(c / energy[before, :, 0], gamma[:, None])
        bound[:, k] = c
    return np.asarray(bound[..., None] * scale)


def breaking(posterior: Posterior, product: Product, feed: Feed) -> Breaking:
    """Who of fresh particles breaks at which blow, and how fine; one chunk of draws after the other."""
    series = feed.blows.series(feed.seed)
    offered = feed.blows.offered(series.T, feed.classes.sizes, feed.density)
    step = max(1, _MOST // (4 * offered.size))
    parts = [
        _breaking(posterior.at(rows), product.drawn(rows), feed, offered)
        for rows in np.array_split(np.arange(len(posterior)), math.ceil(len(posterior) / step))
    ]
    share, t10, total = (np.concatenate([part[k] for part in parts]) for k in range(3))
    if not feed.rest_breaks:
        share[..., -1] = total[..., -1] = 0.0
    means = (total @ feed.classes.mass).mean(axis=0).reshape(-1, max(1, len(series) // RANDOMISATIONS)).mean(axis=1)
    error = float(means.std(ddof=1) / math.sqrt(len(means))) if len(means) > 1 else 0.0
    return Breaking(share=share, t10=t10, error=error)


def _breaking(posterior: Posterior, product: Product, feed: Feed, offered: Array) -> tuple[Array, Array, Array]:
    """Shares (D, n, B, K) and t10 of some draws; shares broken in all by series (D, S, K)."""
    (n, count, classes), draws = offered.shape, len(posterior)
    own = feed.blows.share * offered
    nodes = (np.arange(_OWN) + 0.5) / _OWN if product.form == "tavares_own" and count == 1 else np.array([0.5])
    # fineness needs no more series than there are bins to sort them into
    some = slice(None, None, count // (4 * _BINS) if count > 1 else 1)
    bins = _BINS if count > 1 else len(nodes)
    at_blow = np.empty((draws, n, count, classes))
    middle = np.empty((draws, n, *at_blow[0, 0, some, :1].shape[:1], len(nodes), classes))
    for name, rows, p in posterior.by_law(feed.classes.sizes[None, None, :]):
        gamma = posterior.draws["gamma"][rows] if n > 1 and laws.LAWS[name].sized else None
        bound = _bounds(own, name, p, gamma)
        below = np.broadcast_to(np.exp(laws.LAWS[name].below(bound, p)), (len(rows), n, count, classes))
        at_blow[rows] = np.maximum(np.diff(below, axis=1, prepend=0.0), 0.0)
        if product.form.startswith("tavares"):
            for j, node in enumerate(nodes):
                quantile = below - (1.0 - node) * at_blow[rows]
                middle[rows, :, :, j] = _left(name, p, quantile[:, :, some], own[:, some], gamma)
    fine = product.t10(_measure(product, feed, offered[:, some], own[:, some], middle))
    if count == 1:
        share = np.repeat(at_blow / len(nodes), len(nodes), axis=2)
        return share, fine, at_blow.sum(axis=1)
    share, binned = np.empty((2, draws, n, bins, classes))
    for k in range(n):
        share[:, k] = at_blow[:, k][:, np.argsort(offered[k, :, 0]).reshape(bins, -1)].sum(axis=2) / count
        groups = np.argsort(offered[k, some, 0]).reshape(bins, -1)
        weight = at_blow[:, k, some][:, groups]
        t10 = np.broadcast_to(fine[:, k], at_blow[:, k, some].shape)[:, groups]
        binned[:, k] = (weight * t10).sum(axis=2) / np.maximum(weight.sum(axis=2), 1e-300)
    return share, binned, at_blow.sum(axis=1)


def _left(name: str, p: Mapping[str, Array], quantile: Array, own: Array, gamma: Array | None) -> Array:
    """What the blows before have left of the fracture energies at quantiles (R, n, S, K)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.array(laws.LAWS[name].quantile(np.clip(quantile, 1e-300, 1.0 - 1e-16), p))
        for k in range(1, len(own)):
            for before in range(k if gamma is not None else 0):
                assert gamma is not None
                found[:, k] = laws.damaged(found[:, k], own[before], gamma[:, None, None])
    return np.maximum(found, 1e-12 * own)


def _measure(product: Product, feed: Feed, offered: Array, own: Array, middle: Array) -> Array:
    """The measure of energy that t10 is a function of: (D, 1 or n, S or nodes, K)."""
    if product.form == "jk":
        same = offered.shape[1] == 1
        return offered[None, :1] if same else offered[None]
    if product.form == "shi_kojovic":
        sizes = feed.classes.sizes
        least = np.asarray(product.threshold).reshape(-1, 1, 1, 1) / sizes
        return np.asarray(sizes * np.cumsum(np.maximum(own[None] - least, 0.0), axis=1))
    ratio = own[None, :, :, None] / middle
    return np.asarray(ratio[:, :, 0] if own.shape[1] == 1 else ratio[..., 0, :])


# --- what becomes of it -------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Answers by draw.  Shares by class and in all, blows by class and in all, in (D, K + 1) and (D,); `passing`
    (D, M) on the sieves (M,) [m] from the finest up; sizes [m]; `energy` [J/kg] given to the particles of the feed."""

    by_class: Array
    broken: Array
    blows_by_class: Array
    blows: Array
    t10: Array
    sieves: Array
    passing: Array
    p80: Array
    p50: Array
    fines: Array
    energy: Array
    reduction: Array


def sieve_series(classes: Classes) -> Array:
    """Sieves of the product, ascending [m]: those of the classes, some between, and finer ones."""
    step = (classes.edges[0] / classes.edges[1]) ** (1.0 / _BETWEEN)
    count = math.ceil(math.log(_FINEST) / math.log(step))
    finest = max(count, _BETWEEN * (len(classes.edges) - 1) + 1)
    return np.asarray(classes.edges[0] * step ** -np.arange(finest, -1.0, -1.0))


def size_at(share: float, sieves: Array, passing: Array) -> Array:
    """Size [m] that this share of the mass is finer than, (D,) of curves (D, M); nan below the finest sieve.

    >>> size_at(0.8, np.array([1.0, 2.0]), np.array([[0.6, 1.0]])).round(4).tolist()
    [1.4142]
    """
    above = np.argmax(passing >= share, axis=1)
    low = np.maximum(above - 1, 0)
    rows = np.arange(len(passing))
    p0, p1 = passing[rows, low], passing[rows, above]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.where(p1 > p0, (share - p0) / (p1 - p0), 1.0)
        found = sieves[low] * (sieves[above] / sieves[low]) ** along
    return np.where(above > 0, found, np.nan)


def _whole_finer(classes: Classes, sieves: Array) -> Array:
    """Share of whole particles of every class that is finer than each sieve, (K + 1, M)."""
    upper, lower = classes.edges, np.append(classes.edges[1:], 0.0)
    finer, at = classes.passing(sieves), classes.passing(upper)
    below = np.append(at[1:], 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        inside = (finer - below[:, None]) / (at - below)[:, None]
        even = np.log(sieves / lower[:, None]) / np.log(upper / lower)[:, None]
        found = np.clip(np.where((at > below)[:, None], inside, even), 0.0, 1.0)
    found[sieves >= upper[:, None] * (1.0 - 1e-12)] = 1.0
    return np.asarray(found)


def _fragments(product: Product, t10: Array, mass: Array, sieves: Array) -> Array:
    """Mass of fragments finer than every sieve, (D, M), of masses broken and their t10 (D, a, B, K + 1).

    Sizes are spread evenly in ln d over their class, so that every class has the same curve, moved by its steps.
    """
    if t10.shape[1] == 1:
        mass = mass.sum(axis=1, keepdims=True)
    draws, steps, last = len(mass), len(sieves) - 1, mass.shape[-1] - 1
    n = (sieves[-1] / sieves[-2]) ** (np.arange(steps) + 0.5)
    moved = [*(_BETWEEN * k for k in range(last)), _BETWEEN * last + _BETWEEN // 2]
    alike = bool(np.all(t10 == t10[..., :1]))
    found = np.zeros((draws, steps + 1))
    for rows in np.array_split(np.arange(draws), math.ceil(draws * mass[0, ..., 0].size * steps / _MOST)):
        curve = product.drawn(rows).curve
        some = np.broadcast_to(t10 if len(t10) == 1 else t10[rows], (len(rows), *t10.shape[1:]))
        finer = np.empty(0)
        for k, by in enumerate(moved):
            if k == 0 or not alike:
                one = curve.passing(n, some[..., k])
                padded = np.concatenate(
                    [np.zeros((*one.shape[:-1], 1)), np.ones((*one.shape[:-1], _BETWEEN)), one], axis=-1
                )
                total = np.cumsum(padded, axis=-1)
                finer = (total[..., _BETWEEN:] - total[..., :-_BETWEEN]) / _BETWEEN
            at = np.einsum("dabm,dab->dm", finer[..., : steps + 1 - by], mass[rows, ..., k])
            found[rows, :by] += mass[rows, ..., k].sum(axis=(1, 2))[:, None]
            found[rows, by:] += at
    return found[:, ::-1]


def _split(mass: Array, share: Array, counts: Array | None, rng: np.random.Generator) -> Array:
    """Masses (D, ..., K) that go each of the ways of share (D, ..., w, K): as expected, or by a lot of particles."""
    expected = mass[..., None, :] * share
    if counts is None:
        return expected
    number = np.round(np.where(mass > 0.0, mass, 0.0) * counts)
    ways = np.moveaxis(share, -2, -1)
    rest = np.maximum(1.0 - ways.sum(axis=-1, keepdims=True), 0.0)
    chance = np.concatenate([ways, rest], axis=-1)
    chance /= chance.sum(axis=-1, keepdims=True)
    drawn = rng.multinomial(number.astype(np.int64), chance)[..., :-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        part = np.where(number[..., None] >= 1.0, mass[..., None] * drawn / number[..., None], 0.0)
    # less than a particle does not scatter
    return np.where((number < 1.0)[..., None, :], expected, np.moveaxis(part, -1, -2))


def populate(broken: Breaking, product: Product, feed: Feed, rng: np.random.Generator | None = None) -> Outcome:
    """The feed after its blows; with `rng` that of one lot for every draw, whose particles scatter."""
    classes, (draws, n, bins, count) = feed.classes, broken.share.shape
    particle = _SPHERE * feed.density * classes.sizes**3
    counts = None if rng is None else feed.lot / particle
    rng = np.random.default_rng(0) if rng is None else rng
    fresh = np.broadcast_to(classes.mass, (draws, count))
    flat = _split(fresh, broken.share.reshape(draws, n * bins, count), counts, rng)
    at_blow = flat.reshape(draws, n, bins, count)
    hit = np.ones(count)
    hit[-1] = float(feed.rest_breaks)
    first = at_blow.sum(axis=2)
    unbroken = np.maximum(fresh - first.sum(axis=1), 0.0)
    struck = (np.arange(1.0, n + 1.0)[:, None] * first).sum(axis=1) + n * unbroken * hit
    mean = (feed.blows.share * feed.blows.offered(feed.blows.series(feed.seed), classes.sizes, feed.density)).mean(
        axis=(0, 1)
    )
    sieves = sieve_series(classes)
    if feed.progeny == "again":
        whole, finer, energy, t10 = _again(broken, product, feed, counts, rng, sieves, mean)
    else:
        whole, finer = unbroken, _fragments(product, broken.t10, at_blow, sieves)
        total = at_blow.sum(axis=(1, 2, 3))
        fineness = (at_blow * broken.t10).sum(axis=(1, 2, 3))
        energy, t10 = struck @ mean, fineness / np.where(total > 0.0, total, np.nan)
    passing = np.minimum(whole @ _whole_finer(classes, sieves) + finer, 1.0)
    passing = np.maximum.accumulate(passing, axis=1)
    p80, p50 = (size_at(p, sieves, passing) for p in (0.8, 0.5))
    f80 = size_at(0.8, sieves, classes.passing(sieves)[None])[0]
    fines = np.full(draws, np.nan)
    if feed.fines is not None:
        place = np.interp(math.log(feed.fines), np.log(sieves), np.arange(len(sieves)))
        low = min(int(place), len(sieves) - 2)
        fines = passing[:, low] + (place - low) * (passing[:, low + 1] - passing[:, low])
    with np.errstate(divide="ignore", invalid="ignore"):
        by_class = np.where(classes.mass > 0.0, first.sum(axis=1) / classes.mass, 0.0)
        blows_by_class = np.where(classes.mass > 0.0, struck / classes.mass, 0.0)
    return Outcome(
        by_class=by_class, broken=first.sum(axis=(1, 2)), blows_by_class=blows_by_class, blows=struck.sum(axis=1),
        t10=t10, sieves=sieves, passing=passing, p80=p80, p50=p50, fines=fines, energy=energy, reduction=f80 / p80,
    )  # fmt: skip


def _again(
    broken: Breaking, product: Product, feed: Feed, counts: Array | None, rng: np.random.Generator, sieves: Array,
    mean: Array,
) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """Fragments that get the blows that are left: whole masses (D, K), mass of fragments finer than every sieve that
    are finer than the last class, energy [J/kg], t10."""
    classes, (draws, n, _, count) = feed.classes, broken.share.shape
    hit = np.ones(count)
    hit[-1] = float(feed.rest_breaks)
    survived = 1.0 - np.cumsum(broken.share.sum(axis=2), axis=1)
    before = np.concatenate([np.ones((draws, 1, count)), survived[:, :-1]], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        chance = np.where(before[:, :, None] > 0.0, broken.share / before[:, :, None], 0.0)
    # alive (D, age, K): whole particles by the blows that they have had
    alive = np.zeros((draws, n + 1, count))
    alive[:, 0] = classes.mass
    tail, energy, weight, fineness = np.zeros((draws, len(sieves))), *np.zeros((3, draws))
    edge = np.searchsorted(sieves, classes.edges * (1.0 - 1e-9))
    for _ in range(n):
        energy += (alive[:, :n].sum(axis=1) * hit) @ mean
        out = _split(alive[:, :n], chance, counts, rng)
        left = np.maximum(alive[:, :n] - out.sum(axis=2), 0.0)
        weight += out.sum(axis=(1, 2, 3))
        fineness += (out * broken.t10).sum(axis=(1, 2, 3))
        made = _fragments(product, broken.t10, out, sieves)
        finer = made[:, edge]
        alive = np.concatenate([np.zeros((draws, 1, count)), left], axis=1)
        alive[:, 0, :-1] += finer[:, :-1] - finer[:, 1:]
        if feed.rest_breaks:
            alive[:, 0, -1] += finer[:, -1]
        else:
            tail += np.minimum(made, finer[:, -1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        return alive.sum(axis=1), tail, energy, fineness / np.where(weight > 0.0, weight, np.nan)
