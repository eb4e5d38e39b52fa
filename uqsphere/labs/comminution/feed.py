"""A feed under blows: shares broken by size and blow, product, energy, each over the draws of a
posterior.

Of n equal blows those particles break whose first fracture energy is at most u_n E.  What the tests
leave open (the draws) and the scatter of a lot stand apart.
"""

from __future__ import annotations

import math
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
from uqsphere.labs.comminution.energies import stiffness
from uqsphere.labs.comminution.fit import UNTESTED, Posterior, quantiles
from uqsphere.tables import read_table

#: draws that a feed is computed for
DRAWS: Final = 1000
#: mass of a sieve table that may be cut without a refusal
_CUT: Final = 0.05
#: specific energies [J/kg] and sizes [m] of the drop-weight tests behind A and b
_OFFERED, _DROPPED = (360.0, 9000.0), (0.0132, 0.063)


@dataclass(frozen=True, kw_only=True)
class Classes:
    """Size classes from coarse to fine, the last one all that is below the last sieve; mass (K,)
    sums to 1.

    edges (K,) : upper ends [m]; the lower end of one is the upper end of the next.
    """

    edges: Array
    mass: Array
    notes: tuple[str, ...] = ()

    @property
    def sizes(self) -> Array:
        """Representative diameters (K,): geometric means; of the last class half its upper end,
        times sqrt 2.
        """
        lower = np.append(self.edges[1:], 0.5 * self.edges[-1])
        return np.asarray(np.sqrt(self.edges * lower))


def load_classes(asked: SizesTable, folder: Path) -> Classes:
    """The classes of a feed; UsageError for a sieve table that leaves out more than 5 % of the
    mass.
    """
    from scipy.special import ndtr

    notes: list[str] = []
    if asked.law == "table":
        passing, top = _sieves(asked, folder, notes)
    else:
        v, top = asked.model_dump(), asked.top or math.inf
        passing = {
            "rosin_rammler": lambda x: -np.expm1(-((x / v["d63"]) ** v["n"])),
            "gaudin_schuhmann": lambda x: (x / top) ** v["n"],
            "lognormal": lambda x: ndtr(np.log(x / v["d50"]) / v["sd"]),
        }[asked.law]
        if (cut := 1.0 - float(passing(top))) > 1e-6:
            notes.append(
                f"{cut:.2g} of the mass is coarser than top = {top * 1e3:.4g} mm, is cut, and "
                "the rest scaled"
            )
    edges = np.asarray(top * asked.ratio ** -np.arange(asked.classes + 1.0), dtype=float)
    share = np.clip(passing(edges), 0.0, None)
    mass = np.append(share[:-1] - share[1:], share[-1]) / share[0]
    return Classes(edges=edges, mass=mass, notes=tuple(notes))


def _sieves(asked: SizesTable, folder: Path, notes: list[str]) -> tuple[Any, float]:
    """Passing as a function of the size, log-linear between sieves, and the top size."""
    column, table = str(asked.passing), read_table(folder / str(asked.file))
    sieve, given = (
        table.numbers(str(asked.sieve), "length", asked.sieve_unit or None),
        table.numbers(column),
    )
    table.finish()
    heading = table.headings[table.place(column)].lower()
    percent = "%" in heading or "percent" in heading or "pct" in heading
    order = np.argsort(sieve)
    sieve, given = sieve[order], given[order]
    largest = float(given[-1])
    if percent and largest <= 1.0:
        raise UsageError(
            f"{table.name}: {column!r} is headed as percent and reaches {largest:.4g}: are these "
            "shares? "
            "Head them so, without percent"
        )
    if not percent and largest > 1.0:
        percent = True
        notes.append(f"{table.name}: passing reaches {largest:.4g}, percent are taken")
    share = given * (0.01 if percent else 1.0)
    rising = (np.diff(sieve) > 0.0).all() and (np.diff(share) >= 0.0).all()
    if not rising or sieve[0] <= 0.0 or not 0 < share[-1] <= 1.0001:
        raise UsageError(
            f"{table.name}: sieves must differ, and what passes must rise with them up to 100 %"
        )
    left = 1.0 - float(share[-1])
    top = asked.top if asked.top is not None else float(sieve[-1])
    if asked.top is not None and asked.top > sieve[-1] * (1.0 + 1e-9):
        sieve, share = np.append(sieve, asked.top), np.append(share, 1.0)
        if left > 1e-4:
            notes.append(
                f"{left:.3g} of the mass lies between the coarsest sieve and top, where all "
                "passes: by a line"
            )
    elif left > _CUT:
        raise UsageError(
            f"{table.name}: the coarsest sieve passes {share[-1]:.1%}: {left:.1%} of the feed "
            "has no size; add "
            "top, the size that all passes"
        )
    elif left > 1e-4:
        notes.append(
            f"{left:.2g} of the mass is coarser than the coarsest sieve, is cut, and the rest "
            "scaled"
        )
    x, y = np.log(sieve), share

    def passing(size: Array) -> Array:
        # below the finest sieve a straight line in logarithms to nothing, by its own slope
        slope = (
            (math.log(y[1]) - math.log(y[0])) / (x[1] - x[0])
            if len(y) > 1 and y[0] > 0.0 and y[1] > y[0]
            else 1.0
        )
        low = np.log(np.asarray(size))
        return np.where(low < x[0], y[0] * np.exp(slope * (low - x[0])), np.interp(low, x, y))

    return passing, top


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What becomes of a feed; (D, ...) over draws, and `content` as plain JSON."""

    classes: Classes
    broken: Array
    total: Array
    sieves: Array
    passing: Array
    content: dict[str, Any]


def offered(asked: FeedTable, sizes: Array, density: float) -> Array:
    """Energy offered by one blow per mass of each class (K,) [J/kg]."""
    if asked.specific_energy is not None:
        return np.full(len(sizes), asked.specific_energy)
    if asked.speed is not None:
        return np.full(len(sizes), 0.5 * asked.speed**2)
    return (asked.energy or 0.0) / laws.mass_of(sizes, density)


def broken_by_blow(posterior: Posterior, energy: Array, sizes: Array, blows: int) -> Array:
    """Cumulative share broken (D, K, n + 1) of classes after 0 ... n equal blows of an energy (K,)
    [J/kg].
    """
    u = laws.thresholds(posterior.parameters["gamma"], blows)
    each = [posterior.broken(energy * u[:, k, None], sizes) for k in range(1, blows + 1)]
    return np.stack([np.zeros((len(posterior), len(sizes))), *each], axis=2)


def answer_feed(posterior: Posterior, asked: ComminutionDocument, folder: Path) -> Answer:
    """Broken shares, product and energy of the feed of an input file.

    Raises UsageError where [feed] is missing or cannot be.
    """
    feed, product, own = asked.feed, asked.product, asked.material
    if feed is None:
        raise UsageError("the input file has no [feed]")
    if feed.rebreak and product is None:
        raise UsageError("feed.rebreak needs the sizes of fragments: add [product]")
    if own.density is None:
        raise UsageError("material.density is required")
    classes = load_classes(feed.sizes, folder)
    posterior, rng = posterior.thin(DRAWS), np.random.default_rng([asked.seed, 739])
    draws, sizes, mass = len(posterior), classes.sizes, classes.mass
    given = offered(feed, sizes, own.density)
    share, warnings = 1.0, list(classes.notes)
    if feed.impact_surface is not None:
        share = laws.particle_share(stiffness(own), stiffness(feed.impact_surface))
    taken = given * share
    cumulative = broken_by_blow(posterior, taken, sizes, feed.blows)
    if feed.undersize == "stays":
        cumulative[:, -1] = 0.0
    broken = cumulative[:, :, -1]
    total = broken @ mass
    hit = np.append(np.ones(len(mass) - 1), float(feed.undersize == "breaks"))
    sieves = np.unique(
        np.concatenate(
            [classes.edges, classes.edges[-1] * feed.sizes.ratio ** -np.arange(1.0, 15.0)]
        )
    )
    lower = np.append(classes.edges[1:], 1e-6 * classes.edges[-1])
    # whole particles of a class lie evenly in the logarithm between its ends; below the last sieve
    # in proportion
    whole = np.clip(np.log(sieves[:, None] / lower) / np.log(classes.edges / lower), 0.0, 1.0)
    whole[:, -1] = np.clip(sieves / classes.edges[-1], 0.0, 1.0)
    before = whole @ mass
    passing, spread = np.full((draws, len(sieves)), np.nan), None
    if product is not None:
        fine = laws.t10(given, product.A, product.b)
        curves = _curves(product, fine, sizes, sieves, draws, rng)
        if feed.rebreak:
            finer = curves[:, np.searchsorted(sieves, classes.edges)]
            finer[:, 0] = 1.0
            spread = -np.diff(finer, axis=1, append=0.0)
    struck, weight, left = population(cumulative, mass, spread)
    numbers: dict[str, Array] = {
        "broken": total,
        "blows": struck @ hit,
        "energy [J/kg]": struck @ (hit * taken),
    }
    if product is not None:
        fragments = 0.0 if feed.rebreak else (curves * weight[:, None]).sum(axis=2)
        passing = np.minimum(np.maximum.accumulate(left @ whole.T + fragments, axis=1), 1.0)
        numbers["t10"] = (weight * fine).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-300)
        numbers |= {f"P{round(100 * p)} [m]": _size_at(p, sieves, passing) for p in (0.8, 0.5)}
        numbers["F80/P80"] = _size_at(0.8, sieves, before[None])[0] / numbers["P80 [m]"]
        if feed.fines is not None:
            numbers["fines"] = np.array(
                [np.interp(math.log(feed.fines), np.log(sieves), row) for row in passing]
            )
        outside = (
            (given < _OFFERED[0])
            | (given > _OFFERED[1])
            | (sizes < _DROPPED[0])
            | (sizes > _DROPPED[1])
        )
        beyond = float(
            (weight.mean(axis=0) * outside).sum() / max(weight.mean(axis=0).sum(), 1e-300)
        )
        if beyond > 0.01:
            warnings.append(
                f"{beyond:.0%} of what breaks lies beyond the drop-weight tests behind A and b "
                "(0.1 to 2.5 kWh/t, 13 to 63 mm): the product curve is extrapolated"
            )
    low, high = posterior.tested
    untested = (sizes < low / UNTESTED) | (sizes > high * UNTESTED)
    if float(mass[untested].sum()) > 0.005:
        warnings.append(
            f"{mass[untested].sum():.0%} of the feed lies beyond the tested {low * 1e3:.3g} to "
            f"{high * 1e3:.3g} mm: extrapolated"
        )
    if (
        feed.blows > 1
        and not any("gamma" in model.names for model in posterior.models)
        and asked.tests.gamma == "fit"
    ):
        warnings.append("no test was repeated: gamma of the damage has its prior, 2.0 to 7.9")
    warnings.append("energies are those of the particles; the machine takes more")
    content: dict[str, Any] = {
        "title": asked.title,
        "blows": feed.blows,
        "energy_offered": given.tolist(),
        "particle_share": share,
        "numbers": {name: quantiles(v) for name, v in numbers.items()},
        "classes": [
            {
                "upper": float(classes.edges[k]),
                "size": float(sizes[k]),
                "mass": float(mass[k]),
                "broken": quantiles(broken[:, k]),
                "by_blow": cumulative[:, k, 1:].mean(axis=0).tolist(),
                "extrapolated": bool(untested[k]),
            }
            for k in range(len(mass))
        ],
        "product": [
            {"sieve": float(s), "feed": float(before[k]), **quantiles(passing[:, k])}
            for k, s in enumerate(sieves)
        ]
        if product is not None
        else [],
    }
    content["numbers"]["never broken"] = quantiles(1.0 - total)
    if feed.lot is not None:
        count = np.maximum(np.round(mass * feed.lot / laws.mass_of(sizes, own.density)), 0.0)
        lots = _lots(broken, mass, count, rng)
        content["lot"] = {
            "mass": feed.lot,
            "broken": quantiles(lots),
            "epistemic_sd": float(total.std()),
            "lot_sd": float(math.sqrt(max(float(lots.var() - total.var()), 0.0))),
        }
    if asked.tests.synthetic:
        warnings.insert(0, "the tests are synthetic data: no number here is of a rock")
    content["warnings"] = warnings
    return Answer(
        classes=classes, broken=broken, total=total, sieves=sieves, passing=passing, content=content
    )


def population(cumulative: Array, mass: Array, spread: Array | None) -> tuple[Array, Array, Array]:
    """Mass of each class (D, K) over all blows: struck, once for every blow; broken; and what is
    left whole at the end.

    cumulative (D, K, n + 1) : share of fresh particles broken after 0 ... n blows; mass (K,) of the
    feed.
    spread (D or 1, K, K) : share of the fragments of class k that are of class j, at [:, j, k].
    Fragments are fresh particles that the blows left strike; None: they leave the machine.
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


def _curves(
    product: ProductTable,
    fine: Array,
    sizes: Array,
    sieves: Array,
    draws: int,
    rng: np.random.Generator,
) -> Array:
    """Share of the fragments of a class that passes a sieve, (D or 1, S, K), by t_n."""
    alpha = (
        np.full(1, product.alpha)
        if not isinstance(product.alpha, Lognormal)
        else np.exp(product.alpha.log_mean + product.alpha.log_sd * rng.standard_normal(draws))
    )
    return laws.t_n((sizes / sieves[:, None])[None], fine, product.curve, alpha[:, None, None])


def _size_at(share: float, sieves: Array, passing: Array) -> Array:
    """The size [m] that a share passes, in every row."""
    return np.asarray(np.exp([np.interp(share, row, np.log(sieves)) for row in passing]))


def _lots(broken: Array, mass: Array, count: Array, rng: np.random.Generator) -> Array:
    """Broken share of a lot for every draw: each class has so many particles, which break or
    not.
    """
    few, many, drawn = count < 1e8, np.maximum(count, 1.0), np.array(broken)
    drawn[:, few] = (
        rng.binomial(many[few].astype(np.int64), np.clip(broken[:, few], 0.0, 1.0)) / many[few]
    )
    return np.asarray(drawn @ mass)
