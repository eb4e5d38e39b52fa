"""A feed under blows: shares broken by size and blow, product and energy over the draws of a fit.

Of n equal blows those particles break whose first fracture energy is at most u_n E.  The epistemic
uncertainty of the tests (the draws) and the scatter of a lot are separate.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import UsageError
from uqsphere.labs.comminution import laws
from uqsphere.labs.comminution.document import (
    ComminutionDocument,
    FeedTable,
    Lognormal,
    ProductTable,
    SizesTable,
)
from uqsphere.labs.comminution.energies import Contact
from uqsphere.labs.comminution.fit import UNTESTED, Posterior, quantiles
from uqsphere.tables import Table, read_table

#: draws for which a feed is computed
DRAWS: Final = 1000
#: largest share of mass above the coarsest sieve that is cut without a refusal
_CUT: Final = 0.05
#: specific energies [J/kg] and sizes [m] of the drop-weight tests behind A and b
_OFFERED, _DROPPED = (360.0, 9000.0), (0.0132, 0.063)


@dataclass(frozen=True, kw_only=True)
class Classes:
    """Size classes from coarse to fine; the last one is all below the last sieve.

    edges (K,) : upper ends [m]; the lower end of a class is the upper end of the next.
    mass (K,) : shares of mass, with the sum 1.
    """

    edges: Array
    mass: Array
    notes: tuple[str, ...] = ()

    @property
    def sizes(self) -> Array:
        """Representative diameters (K,) [m]: geometric means; the last class ends at half its
        edge."""
        lower = np.append(self.edges[1:], 0.5 * self.edges[-1])
        return np.asarray(np.sqrt(self.edges * lower))


def load_classes(asked: SizesTable, folder: Path) -> Classes:
    """The classes of a feed; UsageError for a sieve table without more than 5 % of the mass."""
    notes: list[str] = []
    if asked.law == "table":
        passing, top = _sieves(asked, folder, notes)
    else:
        passing, top = _law(asked), asked.top or math.inf
        cut = 1.0 - float(passing(np.asarray(top)))
        if cut > 1e-6:
            notes.append(
                f"{cut:.2g} of the mass is coarser than top = {top * 1e3:.4g} mm: it is cut and "
                "the rest is scaled"
            )
    edges = np.asarray(top * asked.ratio ** -np.arange(asked.classes + 1.0), dtype=float)
    share = np.clip(passing(edges), 0.0, None)
    mass = np.append(share[:-1] - share[1:], share[-1]) / share[0]
    return Classes(edges=edges, mass=mass, notes=tuple(notes))


def _law(asked: SizesTable) -> Callable[[Array], Array]:
    """Passing as a function of the size [m]."""
    from scipy.special import ndtr

    numbers, top = asked.model_dump(), asked.top or math.inf
    if asked.law == "rosin_rammler":
        return lambda size: -np.expm1(-((size / numbers["d63"]) ** numbers["n"]))
    if asked.law == "gaudin_schuhmann":
        return lambda size: np.asarray((size / top) ** numbers["n"])
    return lambda size: np.asarray(ndtr(np.log(size / numbers["d50"]) / numbers["sd"]))


def _sieves(
    asked: SizesTable, folder: Path, notes: list[str]
) -> tuple[Callable[[Array], Array], float]:
    """Passing as a function of the size, log-linear between sieves, and the top size [m]."""
    table = read_table(folder / str(asked.file))
    sieve = table.numbers(str(asked.sieve), "length", asked.sieve_unit or None)
    passing = table.numbers(str(asked.passing))
    table.finish()
    order = np.argsort(sieve)
    sieve, share = sieve[order], _as_shares(table, str(asked.passing), passing[order], notes)
    rising = (np.diff(sieve) > 0.0).all() and (np.diff(share) >= 0.0).all()
    if not rising or sieve[0] <= 0.0 or not 0 < share[-1] <= 1.0001:
        raise UsageError(
            f"{table.name}: the sieves must differ, and the share that passes must rise with them, "
            "up to 100 %"
        )
    left, top = 1.0 - float(share[-1]), float(sieve[-1])
    if asked.top is not None:
        top = asked.top
    if top > sieve[-1] * (1.0 + 1e-9):
        sieve, share = np.append(sieve, top), np.append(share, 1.0)
        if left > 1e-4:
            notes.append(
                f"{left:.3g} of the mass is between the coarsest sieve and top: it is interpolated"
            )
    elif left > _CUT:
        raise UsageError(
            f"{table.name}: the coarsest sieve passes {share[-1]:.1%}: {left:.1%} of the feed has "
            "no size; add top, the size that all passes"
        )
    elif left > 1e-4:
        notes.append(
            f"{left:.2g} of the mass is coarser than the coarsest sieve: it is cut and the rest is "
            "scaled"
        )
    log_sieve = np.log(sieve)
    # below the finest sieve the share goes with a power of the size, that of the first two sieves
    power = 1.0
    if len(share) > 1 and share[1] > share[0] > 0.0:
        power = math.log(share[1] / share[0]) / (log_sieve[1] - log_sieve[0])

    def passes(size: Array) -> Array:
        log_size = np.log(np.asarray(size))
        below = share[0] * np.exp(power * (log_size - log_sieve[0]))
        inside = np.interp(log_size, log_sieve, share)
        return np.where(log_size < log_sieve[0], below, inside)

    return passes, top


def _as_shares(table: Table, column: str, passing: Array, notes: list[str]) -> Array:
    """Passing as shares; a heading says whether it is in percent."""
    heading = table.headings[table.place(column)].lower()
    percent = any(word in heading for word in ("%", "percent", "pct"))
    largest = float(passing[-1])
    if percent and largest <= 1.0:
        raise UsageError(
            f"{table.name}: column {column!r} is headed as percent and reaches {largest:.4g}. If "
            "these are shares, remove percent from the heading"
        )
    if not percent and largest > 1.0:
        percent = True
        notes.append(f"{table.name}: passing reaches {largest:.4g}, percent are taken")
    return passing * 0.01 if percent else passing


# --- blows ----------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Answer:
    """A feed after its blows, (D, ...) over draws, and `content` as plain JSON."""

    classes: Classes
    broken: Array
    total: Array
    sieves: Array
    passing: Array
    content: dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class _Struck:
    """Mass (D, K) of each class over all blows, and cumulative shares broken (D, K, n + 1).

    struck : once for every blow; broke : that broke; whole : left whole at the end.
    offered, taken : energy of a blow per mass (K,) [J/kg], offered and taken up by a particle.
    """

    cumulative: Array
    struck: Array
    broke: Array
    whole: Array
    offered: Array
    taken: Array


@dataclass(frozen=True, kw_only=True)
class _Product:
    """Sieves (S,) [m], passing (D, S) after the blows, and of the feed (S,).

    fineness : t10 of each class (K,).
    """

    sieves: Array
    passing: Array
    feed: Array
    fineness: Array


def offered(asked: FeedTable, sizes: Array, density: float) -> Array:
    """Energy offered by one blow per mass of each class (K,) [J/kg]."""
    if asked.specific_energy is not None:
        return np.full(len(sizes), asked.specific_energy)
    if asked.speed is not None:
        return np.full(len(sizes), 0.5 * asked.speed**2)
    return (asked.energy or 0.0) / laws.mass_of(sizes, density)


def broken_by_blow(posterior: Posterior, energy: Array, sizes: Array, blows: int) -> Array:
    """Cumulative share broken (D, K, n + 1) of classes after 0 ... n equal blows of an energy (K,)
    [J/kg]."""
    u = laws.thresholds(posterior.parameters["gamma"], blows)
    each = [posterior.broken(energy * u[:, k, None], sizes) for k in range(1, blows + 1)]
    return np.stack([np.zeros((len(posterior), len(sizes))), *each], axis=2)


def answer_feed(posterior: Posterior, asked: ComminutionDocument, folder: Path) -> Answer:
    """Broken shares, product and energy of the feed of an input file.

    Raises UsageError for a missing or impossible [feed].
    """
    feed, density = asked.feed, asked.material.density
    if feed is None:
        raise UsageError("the input file has no table [feed]")
    if feed.rebreak and asked.product is None:
        raise UsageError("feed.rebreak needs the sizes of fragments: add [product]")
    if density is None:
        raise UsageError("material.density is required")
    classes = load_classes(feed.sizes, folder)
    posterior, rng = posterior.thin(DRAWS), np.random.default_rng([asked.seed, 739])
    sizes, mass = classes.sizes, classes.mass
    energy, share, notes = offered(feed, sizes, density), np.ones(len(sizes)), list[str]()
    if feed.impact_surface is not None:
        share, notes = Contact.of(asked, feed.impact_surface, False).shares(energy, sizes)
    cumulative = broken_by_blow(posterior, energy * share, sizes, feed.blows)
    if feed.undersize == "stays":
        cumulative[:, -1] = 0.0
    sieves = _product_sieves(feed, classes)
    curves = None
    if asked.product is not None:
        curves = _curves(asked.product, energy, (sizes, sieves), len(posterior), rng)
    struck, broke, whole = population(cumulative, mass, _spread(feed, classes, sieves, curves))
    blows = _Struck(
        cumulative=cumulative,
        struck=struck,
        broke=broke,
        whole=whole,
        offered=energy,
        taken=energy * share,
    )
    product = _product(asked, classes, blows, sieves, curves)
    broken = cumulative[:, :, -1]
    content = _content(asked, posterior, classes, blows, product)
    content["particle_share"] = share.tolist()
    content["warnings"] += notes
    if feed.lot is not None:
        count = np.maximum(np.round(mass * feed.lot / laws.mass_of(sizes, density)), 0.0)
        content["lot"] = {"mass": feed.lot, **_lot(broken, mass, count, rng)}
    return Answer(
        classes=classes,
        broken=broken,
        total=broken @ mass,
        sieves=sieves,
        passing=product.passing,
        content=content,
    )


def population(cumulative: Array, mass: Array, spread: Array | None) -> tuple[Array, Array, Array]:
    """Mass of each class (D, K) over all blows: struck, once for every blow; broken; and left whole
    at the end.

    cumulative (D, K, n + 1) : share of fresh particles broken after 0 ... n blows; mass (K,) of the
        feed.
    spread (D or 1, K, K) : share of the fragments of class k that are of class j, at [:, j, k].
        Fragments are fresh particles for the remaining blows; with None they leave the machine.
    """
    rest, breaks = 1.0 - cumulative, np.diff(cumulative, axis=2)
    blows, fresh = breaks.shape[2], [np.broadcast_to(mass, cumulative.shape[:2])]
    struck, broken = np.zeros(cumulative.shape[:2]), np.zeros(cumulative.shape[:2])
    for k in range(blows):
        struck += sum(f * rest[:, :, k - j] for j, f in enumerate(fresh))
        now = np.asarray(sum(f * breaks[:, :, k - j] for j, f in enumerate(fresh)))
        broken += now
        if spread is not None:
            fresh.append((spread @ now[:, :, None])[:, :, 0])
    left = np.asarray(sum(f * rest[:, :, blows - j] for j, f in enumerate(fresh)))
    return struck, broken, left


# --- the product ----------------------------------------------------------------------------------


def _product_sieves(feed: FeedTable, classes: Classes) -> Array:
    """The edges of the classes and fourteen finer sieves (S,) [m]."""
    finer = classes.edges[-1] * feed.sizes.ratio ** -np.arange(1.0, 15.0)
    return np.unique(np.concatenate([classes.edges, finer]))


def _curves(
    product: ProductTable,
    energy: Array,
    sizes_and_sieves: tuple[Array, Array],
    draws: int,
    rng: np.random.Generator,
) -> Array:
    """Share of the fragments of a class that passes a sieve, (D or 1, S, K), from t_n."""
    sizes, sieves = sizes_and_sieves
    if isinstance(product.alpha, Lognormal):
        scatter = product.alpha.log_sd * rng.standard_normal(draws)
        alpha = np.exp(product.alpha.log_mean + scatter)
    else:
        alpha = np.full(1, product.alpha)
    fine = laws.t10(energy, product.A, product.b)
    ratio = (sizes / sieves[:, None])[None]
    return laws.t_n(ratio, fine, product.curve, alpha[:, None, None])


def _spread(feed: FeedTable, classes: Classes, sieves: Array, curves: Array | None) -> Array | None:
    """Share of the fragments of class k that are of class j, (D or 1, K, K); None where they leave
    the machine."""
    if curves is None or not feed.rebreak:
        return None
    finer = curves[:, np.searchsorted(sieves, classes.edges)]
    finer[:, 0] = 1.0
    return -np.diff(finer, axis=1, append=0.0)


def _product(
    asked: ComminutionDocument,
    classes: Classes,
    blows: _Struck,
    sieves: Array,
    curves: Array | None,
) -> _Product:
    """The product: whole particles, and fragments where [product] gives their sizes."""
    lower = np.append(classes.edges[1:], 1e-6 * classes.edges[-1])
    # whole particles are uniform in the logarithm within a class, below the last sieve uniform
    whole = np.clip(np.log(sieves[:, None] / lower) / np.log(classes.edges / lower), 0.0, 1.0)
    whole[:, -1] = np.clip(sieves / classes.edges[-1], 0.0, 1.0)
    passing = np.full((len(blows.broke), len(sieves)), np.nan)
    fineness = np.full(len(classes.mass), np.nan)
    if curves is not None and asked.product is not None and asked.feed is not None:
        fineness = laws.t10(blows.offered, asked.product.A, asked.product.b)
        passing = blows.whole @ whole.T
        if not asked.feed.rebreak:
            passing = passing + (curves * blows.broke[:, None]).sum(axis=2)
        passing = np.minimum(np.maximum.accumulate(passing, axis=1), 1.0)
    return _Product(sieves=sieves, passing=passing, feed=whole @ classes.mass, fineness=fineness)


def _size_at(share: float, sieves: Array, passing: Array) -> Array:
    """The size [m] that a share passes, in every row."""
    return np.asarray(np.exp([np.interp(share, row, np.log(sieves)) for row in passing]))


# --- its description ------------------------------------------------------------------------------


def _content(
    asked: ComminutionDocument,
    posterior: Posterior,
    classes: Classes,
    blows: _Struck,
    product: _Product,
) -> dict[str, Any]:
    """A feed after its blows as plain JSON."""
    feed = asked.feed
    assert feed is not None
    low, high = posterior.tested
    sizes, mass, broken = classes.sizes, classes.mass, blows.cumulative[:, :, -1]
    untested = (sizes < low / UNTESTED) | (sizes > high * UNTESTED)
    rows = [
        {
            "upper": float(classes.edges[k]),
            "size": float(sizes[k]),
            "mass": float(mass[k]),
            "broken": quantiles(broken[:, k]),
            "by_blow": blows.cumulative[:, k, 1:].mean(axis=0).tolist(),
            "extrapolated": bool(untested[k]),
        }
        for k in range(len(mass))
    ]
    passes = []
    if asked.product is not None:
        for k, sieve in enumerate(product.sieves.tolist()):
            share = quantiles(product.passing[:, k])
            passes.append({"sieve": sieve, "feed": float(product.feed[k]), **share})
    numbers = _numbers(asked, blows, product, mass)
    return {
        "title": asked.title,
        "blows": feed.blows,
        "energy_offered": blows.offered.tolist(),
        "numbers": {name: quantiles(values) for name, values in numbers.items()},
        "classes": rows,
        "product": passes,
        "warnings": _warnings(asked, posterior, classes, blows),
    }


def _numbers(
    asked: ComminutionDocument, blows: _Struck, product: _Product, mass: Array
) -> dict[str, Array]:
    """Single answers (D,) by name."""
    feed = asked.feed
    assert feed is not None
    hit = np.append(np.ones(len(mass) - 1), float(feed.undersize == "breaks"))
    total = blows.cumulative[:, :, -1] @ mass
    numbers = {
        "broken": total,
        "blows": blows.struck @ hit,
        "energy [J/kg]": blows.struck @ (hit * blows.taken),
    }
    if asked.product is not None:
        broke = np.maximum(blows.broke.sum(axis=1), 1e-300)
        numbers["t10"] = (blows.broke * product.fineness).sum(axis=1) / broke
        for share in (0.8, 0.5):
            name = f"P{round(100 * share)} [m]"
            numbers[name] = _size_at(share, product.sieves, product.passing)
        before = _size_at(0.8, product.sieves, product.feed[None])[0]
        numbers["F80/P80"] = before / numbers["P80 [m]"]
        if feed.fines is not None:
            size, log_sieves = math.log(feed.fines), np.log(product.sieves)
            numbers["fines"] = np.array(
                [np.interp(size, log_sieves, row) for row in product.passing]
            )
    numbers["never broken"] = 1.0 - total
    return numbers


def _warnings(
    asked: ComminutionDocument, posterior: Posterior, classes: Classes, blows: _Struck
) -> list[str]:
    """Where the numbers of a feed are extrapolated or assumed."""
    feed = asked.feed
    assert feed is not None
    low, high = posterior.tested
    sizes, warnings = classes.sizes, [*classes.notes]
    if asked.tests.synthetic:
        warnings.insert(0, "the tests are synthetic data: the numbers describe no real rock")
    if asked.product is not None:
        outside = (blows.offered < _OFFERED[0]) | (blows.offered > _OFFERED[1])
        outside |= (sizes < _DROPPED[0]) | (sizes > _DROPPED[1])
        broke = blows.broke.mean(axis=0)
        beyond = float((broke * outside).sum() / max(broke.sum(), 1e-300))
        if beyond > 0.01:
            warnings.append(
                f"{beyond:.0%} of the broken mass is outside the drop-weight tests behind A and b "
                "(0.1 to 2.5 kWh/t, 13 to 63 mm): the product curve is extrapolated"
            )
    untested = (sizes < low / UNTESTED) | (sizes > high * UNTESTED)
    share = float(classes.mass[untested].sum())
    if share > 0.005:
        warnings.append(
            f"{share:.0%} of the feed is outside the tested sizes ({low * 1e3:.3g} to "
            f"{high * 1e3:.3g} mm): its strength is extrapolated"
        )
    fitted = any("gamma" in model.names for model in posterior.models)
    if feed.blows > 1 and not fitted and asked.tests.gamma == "fit":
        warnings.append("no test was repeated: the damage exponent gamma has its prior, 2.0 to 7.9")
    warnings.append("energies are those taken up by the particles; the machine needs more")
    return warnings


def _lot(broken: Array, mass: Array, count: Array, rng: np.random.Generator) -> dict[str, Any]:
    """Broken share of a lot of so many particles of each class, which break or not."""
    few, many, drawn = count < 1e8, np.maximum(count, 1.0), np.array(broken)
    chance = np.clip(broken[:, few], 0.0, 1.0)
    drawn[:, few] = rng.binomial(many[few].astype(np.int64), chance) / many[few]
    lots, total = drawn @ mass, broken @ mass
    return {
        "broken": quantiles(lots),
        "epistemic_sd": float(total.std()),
        "lot_sd": math.sqrt(max(float(lots.var() - total.var()), 0.0)),
    }
