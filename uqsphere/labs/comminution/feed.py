"""A feed under blows: shares broken by size and blow, product and energy over the draws of a fit.

Of n equal blows those particles break whose first fracture energy is at most u_n E.  The epistemic
uncertainty of the tests (the draws) and the scatter of a lot are separate.
"""

import math
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from uqsphere.arrays import Array, Function, Values, special
from uqsphere.labs.files import InputError, JsonObject
from uqsphere.tables import TableError

from . import laws
from .document import ComminutionDocument, Lognormal, SizesTable
from .energies import offered_shares
from .fit import SYNTHETIC, Posterior, quantiles

#: draws for which a feed is computed
DRAWS = 1000
#: largest share of mass above the coarsest sieve that is cut without a refusal
_CUT = 0.05
#: specific energies [J/kg] and sizes [m] of the drop-weight tests behind A and b
_OFFERED, _DROPPED = (360.0, 9000.0), (0.0132, 0.063)


# --- the feed -------------------------------------------------------------------------------------


class Classes(NamedTuple):
    """Size classes from coarse to fine; the last one is all below the last sieve.

    edges (K,) : upper ends [m]; the lower end of a class is the upper end of the next.
    mass (K,) : shares of mass, with the sum 1.
    """

    edges: Array
    mass: Array
    notes: list[str]

    @property
    def lower(self) -> Array:
        """Lower ends (K,) [m]; the last class ends at half its edge."""
        return np.append(self.edges[1:], 0.5 * self.edges[-1])

    @property
    def sizes(self) -> Array:
        """Representative diameters (K,) [m]: geometric means."""
        return np.sqrt(self.edges * self.lower)


def load_classes(asked: SizesTable, folder: Path) -> Classes:
    """The classes of a feed; UsageError for a sieve table without more than 5 % of the mass."""
    notes = list[str]()
    if asked.law == "table":
        passing, top = _sieves(asked, folder, notes)
    else:
        passing = partial(_law, asked)
        top = asked.top
    edges = top * asked.ratio ** -np.arange(asked.classes + 1, dtype=float)
    share = np.clip(passing(edges), 0.0, None)
    cut = 1.0 - share[0]
    if cut > 1e-6:
        notes.append(
            f"{cut:.2g} of the mass is coarser than {top * 1e3:.4g} mm: it is cut and the rest is "
            "scaled"
        )
    return Classes(edges, -np.diff(share, append=0.0) / share[0], notes)


def _law(asked: SizesTable, size: Array) -> Array:
    """The share that passes a size [m] by a law."""
    if asked.law == "rosin_rammler":
        return -np.expm1(-((size / asked.d63) ** asked.n))
    if asked.law == "gaudin_schuhmann":
        return (size / asked.top) ** asked.n
    return special.ndtr(np.log(size / asked.d50) / asked.sd)


def _sieves(asked: SizesTable, folder: Path, notes: list[str]) -> tuple[Function, float]:
    """Passing as a function of the size, log-linear between sieves, and the top size [m]."""
    table = asked.read(folder, {"sieve": "sieve_unit"})
    column = asked.passing
    sieve = table.numbers(asked.sieve, "length", asked.sieve_unit, key="sieve")
    share = table.numbers(column, key="passing")
    table.finish()
    order = np.argsort(sieve)
    sieve = sieve[order]
    share = share[order]
    # a heading says whether it is in percent
    heading = table.headings[table.place(column)].lower()
    percent = any(word in heading for word in ("%", "percent", "pct"))
    largest = share[-1]
    if largest > 1.0:
        share = share * 0.01
        if not percent:
            notes.append(f"{table.name}: passing reaches {largest:.4g}, percent are taken")
    elif percent:
        raise TableError(
            f"{table.name}: column {column!r} is headed as percent and reaches {largest:.4g}. If "
            "these are shares, remove percent from the heading",
            "passing",
        )
    wrong = (np.diff(sieve, prepend=0.0) <= 0.0) | (np.diff(share, prepend=0.0) < 0.0)
    wrong[-1] |= not 0.0 < share[-1] <= 1.0001
    table.refuse(
        "passing",
        "the sieves must be above 0 and differ, and the share that passes must rise with them, up "
        "to 100 %",
        np.sort(order[wrong]),
    )
    table.check()
    left = 1.0 - share[-1]
    top = asked.top or sieve[-1]
    if top > sieve[-1] * (1.0 + 1e-9):
        sieve = np.append(sieve, top)
        share = np.append(share, 1.0)
        if left > 1e-4:
            notes.append(
                f"{left:.3g} of the mass is between the coarsest sieve and top: it is interpolated"
            )
    elif left > _CUT:
        raise TableError(
            f"{table.name}: the coarsest sieve passes {share[-1]:.1%}: {left:.1%} of the feed has "
            "no size; add top, the size that all passes"
        )
    # below the finest sieve the share goes with a power of the size, that of the first two sieves
    power = 1.0
    if len(share) > 1 and share[1] > share[0] > 0.0:
        power = math.log(share[1] / share[0], sieve[1] / sieve[0])

    def passes(size: Array) -> Array:
        below = share[0] * (size / sieve[0]) ** power
        between = np.interp(np.log(size), np.log(sieve), share)
        return np.where(size < sieve[0], below, between)

    return passes, top


# --- blows ----------------------------------------------------------------------------------------


def broken_by_blow(posterior: Posterior, energy: Array, sizes: Array, blows: int) -> Array:
    """Cumulative share broken (D, K, n + 1) of classes after 0 ... n equal blows of an energy (K,)
    [J/kg]."""
    steps = laws.thresholds(posterior.parameters["gamma"], blows).T[:, :, None]
    return np.stack([posterior.broken(energy * step, sizes) for step in steps], axis=2)


def answer_feed(posterior: Posterior, asked: ComminutionDocument, folder: Path) -> JsonObject:
    """Broken shares, product and energy of the feed of an input file over the draws, as plain JSON.

    Raises UsageError for a missing or impossible [feed].
    """
    feed = asked.feed
    density = asked.material.density
    product = asked.product
    if not feed:
        raise InputError("the input file has no table [feed]", "feed")
    if feed.rebreak and not product:
        raise InputError("rebreak needs the sizes of fragments: add [product]", "feed.rebreak")
    if not density:
        raise InputError("density is required", "material")
    classes = load_classes(feed.sizes, folder)
    chosen = np.unique(np.linspace(0, len(posterior.law) - 1, DRAWS).astype(int))
    posterior = posterior.at(chosen)
    rng = np.random.default_rng([asked.seed, 739])
    edges, mass, warnings = classes
    sizes = classes.sizes
    # energy of one blow per mass [J/kg], given in one of three ways; share that a particle absorbs
    each = laws.mass_of(sizes, density)
    offered = feed.energy / each + feed.specific_energy + 0.5 * feed.speed**2
    share = np.ones(len(sizes))
    notes = list[str]()
    if feed.impact_surface:
        share, notes = offered_shares(asked, "feed.impact_surface", False, offered, sizes)
    taken = offered * share
    if feed.undersize == "stays":
        taken[-1] = 0.0  # these are not hit
    cumulative = broken_by_blow(posterior, taken, sizes, feed.blows)
    broken = cumulative[:, :, -1]
    total = broken @ mass
    # the edges of the classes and fourteen finer sieves
    sieves = edges[0] * feed.sizes.ratio ** np.arange(-13.0 - len(edges), 1.0)
    # whole particles are uniform in the logarithm within a class, below the last sieve uniform
    above = np.log(sieves[:, None] / classes.lower) / np.log(edges / classes.lower)
    unbroken = np.clip(above, 0.0, 1.0)
    unbroken[:, -1] = np.clip(sieves / edges[-1], 0.0, 1.0)
    before = unbroken @ mass
    spread = None
    if product:
        fineness = laws.t10(offered, product.A, product.b)
        alpha: Values = product.alpha
        if isinstance(alpha, Lognormal):
            alpha = rng.lognormal(alpha.log_mean, alpha.log_sd, (len(chosen), 1, 1))
        # share of the fragments of a class that passes a sieve, (D or 1, S, K)
        curves = laws.t_n(sizes / sieves[None, :, None], fineness, product.curve, alpha)
        if feed.rebreak:  # shares of the fragments of a class that are of another one
            among = curves[:, np.searchsorted(sieves, edges)]
            among[:, 0] = 1.0
            spread = -np.diff(among, axis=1, append=0.0)
    struck, broke, whole = population(cumulative, mass, spread)
    numbers = {"broken": total, "blows": struck @ (taken > 0.0), "energy [J/kg]": struck @ taken}
    passes = []
    if product:
        passing = whole @ unbroken.T
        if not feed.rebreak:
            passing = passing + (curves * broke[:, None]).sum(axis=2)
        passing = np.minimum(np.maximum.accumulate(passing, axis=1), 1.0)
        passes = [
            {"sieve": sieve, "feed": share, **quantiles(column)}
            for sieve, share, column in zip(sieves, before, passing.T, strict=True)
        ]
        numbers["t10"] = broke @ fineness / np.maximum(broke.sum(axis=1), 1e-300)
        log_sieves = np.log(sieves)
        reached = [np.interp((0.8, 0.5), row, log_sieves) for row in (before, *passing)]
        (f80, _), *product_sizes = np.exp(reached)
        p80, p50 = np.transpose(product_sizes)
        numbers |= {"P80 [m]": p80, "P50 [m]": p50, "F80/P80": f80 / p80}
        if feed.fines:
            size = math.log(feed.fines)
            numbers["fines"] = np.array([np.interp(size, log_sieves, row) for row in passing])
    untested = posterior.is_untested(sizes)

    # --- where the numbers are extrapolated or assumed
    if asked.tests.synthetic:
        warnings.insert(0, SYNTHETIC)
    if product:
        outside = (offered < _OFFERED[0]) | (offered > _OFFERED[1])
        outside |= (sizes < _DROPPED[0]) | (sizes > _DROPPED[1])
        beyond = broke[:, outside].sum() / max(broke.sum(), 1e-300)
        if beyond > 0.01:
            warnings.append(
                f"{beyond:.0%} of the broken mass is outside the drop-weight tests behind A and b "
                "(0.1 to 2.5 kWh/t, 13 to 63 mm): the product curve is extrapolated"
            )
    beyond = mass[untested].sum()
    if beyond > 0.005:
        low, high = posterior.tested
        warnings.append(
            f"{beyond:.0%} of the feed is outside the tested sizes ({low * 1e3:.3g} to "
            f"{high * 1e3:.3g} mm): its strength is extrapolated"
        )
    given = asked.tests.gamma != "fit" or "gamma" in posterior.models[0].priors
    if feed.blows > 1 and not given:
        warnings.append("no test was repeated: the damage exponent gamma has its prior, 2.0 to 7.9")
    warnings.append("energies are those absorbed by the particles; the machine uses more")

    content = {
        "title": asked.title,
        "blows": feed.blows,
        "energy_offered": offered.tolist(),
        "numbers": {name: quantiles(values) for name, values in numbers.items()},
        "classes": [
            {
                "upper": edges[k],
                "size": sizes[k],
                "mass": mass[k],
                "broken": quantiles(broken[:, k]),
                "by_blow": cumulative[:, k, 1:].mean(axis=0).tolist(),
                "extrapolated": bool(untested[k]),
            }
            for k in range(len(sizes))
        ],
        "product": passes,
        "warnings": warnings + notes,
        "particle_share": share.tolist(),
    }
    if feed.lot:
        # so many particles of each class, which break or not
        count = np.round(mass * feed.lot / each)
        few = count < 1e8
        many = np.maximum(count[few], 1.0)
        drawn = broken.copy()
        drawn[:, few] = rng.binomial(many.astype(int), drawn[:, few]) / many
        lots = drawn @ mass
        content["lot"] = {
            "mass": feed.lot,
            "broken": quantiles(lots),
            "epistemic_sd": total.std(),
            "lot_sd": math.sqrt(max(lots.var() - total.var(), 0.0)),
        }
    return content


def population(cumulative: Array, mass: Array, spread: Array | None) -> tuple[Array, Array, Array]:
    """Mass of each class (D, K) over all blows: struck, once for every blow; broken; and left whole
    at the end.

    cumulative (D, K, n + 1) : share of fresh particles broken after 0 ... n blows; mass (K,) of the
        feed.
    spread (D or 1, K, K) : share of the fragments of class k that are of class j, at [:, j, k].
        Fragments are fresh particles for the remaining blows; with None they leave the machine.
    """
    rest = 1.0 - cumulative
    breaks = np.diff(cumulative, axis=2)
    blows = breaks.shape[2]
    fresh = [mass]
    struck = broken = np.zeros_like(mass)

    def mass_of(share: Array, blow: int) -> Values:
        """Mass of a share of what became fresh before each blow up to this one."""
        return sum(f * share[:, :, blow - k] for k, f in enumerate(fresh))

    for blow in range(blows):
        struck = struck + mass_of(rest, blow)
        now = mass_of(breaks, blow)
        broken = broken + now
        if spread is not None:
            fresh.append((spread @ now[:, :, None])[:, :, 0])
    return struck, broken, mass_of(rest, blows)
