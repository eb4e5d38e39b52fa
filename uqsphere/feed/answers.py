"""What becomes of a feed, with how sure that is: answers with ignorance and scatter apart, the target, feed.json."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from pydantic import Field

from uqsphere.arrays import Array, Flags, Places
from uqsphere.errors import FolderError
from uqsphere.feed import laws
from uqsphere.feed.fit import Entry, FitEntry, Interval, Posterior, read_entry
from uqsphere.feed.population import Feed, Outcome, breaking, draws_for, populate
from uqsphere.feed.product import Fineness, Product, ProductPlan, draw_product
from uqsphere.files import Json, read_whole
from uqsphere.mechanics.criteria import DIAMETERS, ENERGIES
from uqsphere.uq import random_generator

FEED_FILE, TABLE_FILE = "feed.json", "feed-draws.csv"
#: ends of a 95 % interval
_ENDS: Final = (0.025, 0.975)
#: sizes within this factor of the tested ones are theirs: half a root-two class
_NEAR: Final = 2.0**0.25
_NO_SIZE: Final = "no law of size"
#: standard errors of a probability that leave a target undecided
_ERRORS: Final = 2.0
#: a product without one, so that the shares broken can be computed
_NO_PRODUCT: Final = Product(A=0.5, b=1e-4)


class Answer(Entry):
    """A mean with its 95 % interval over the draws (ignorance), that of lots, and both standard deviations apart.

    Null, with the reason, where it is not known.
    """

    value: float | None = None
    low: float | None = None
    high: float | None = None
    lot_low: float | None = None
    lot_high: float | None = None
    ignorance: float | None = None
    scatter: float | None = None
    reason: str = ""


class ClassEntry(Entry):
    """A class of sizes [m], its mass share, particles of a lot, and whether it lies beyond the tested sizes."""

    upper: float
    lower: float
    size: float
    mass: float
    particles: float | None
    extrapolated: bool
    E50: Interval
    slope: Interval
    broken: Answer
    blows: Answer


class SieveEntry(Entry):
    """A sieve [m]: share of the feed and of the product that is finer."""

    sieve: float
    feed: float
    value: float
    low: float
    high: float


class GoalEntry(Entry):
    """The target: its probability with the error of the draws, its verdict as of a limit, and why."""

    broken: float
    at_least: float
    probability: float
    error: float
    verdict: str
    reasons: tuple[str, ...] = ()


class FeedEntry(Entry):
    """What feed.json holds, in SI: energies in J/kg given to the particles, not by the machine."""

    title: str
    seed: int
    hash: str = ""
    made_up: bool = False
    draws: int
    blows: int
    progeny: str
    of: dict[str, str]
    particles: dict[str, float] = Field(default_factory=dict)
    share: float = 1.0
    reference_size: float = 0.0
    form: str = ""
    curve_law: str = ""
    lot: float | None
    spectrum_error: float
    tested: tuple[float, float]
    classes: tuple[ClassEntry, ...]
    broken: Answer
    never: Answer
    expected_blows: Answer
    energy: Answer
    t10: Answer
    p80: Answer
    p50: Answer
    reduction: Answer
    fines: Answer
    fines_sieve: float | None = None
    curve: tuple[SieveEntry, ...] = ()
    product: dict[str, Interval] = Field(default_factory=dict)
    sources: dict[str, str] = Field(default_factory=dict)
    goal: GoalEntry | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class FeedPlan:
    """What is asked of a feed.

    goal : least share that must break, least probability of that;  of : sizes, blows and partner in words
    particles : E [Pa], nu, density [kg/m³];  meaning : the tables of a study as plain values, for its hash
    """

    feed: Feed
    product: ProductPlan
    goal: tuple[float, float] | None = None
    of: Mapping[str, str] = field(default_factory=dict)
    particles: Mapping[str, float] = field(default_factory=dict)
    meaning: Mapping[str, Json] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class Evaluated:
    """The answers with what they were computed from, draw by draw: which draws of the posterior, and the product."""

    entry: FeedEntry
    rows: Places
    broken: Array
    product: Product | None

    def table(self) -> tuple[list[str], list[list[float]]]:
        """feed-draws.csv: the share broken and the product's numbers of every draw of the feed."""
        columns: dict[str, Array] = {"draw": np.asarray(self.rows + 1, dtype=float), "broken": self.broken}
        if self.product is not None:
            count = len(self.rows)
            unit = "kg/J" if self.product.form == "jk" else "1"
            A, b, alpha = (
                np.broadcast_to(v, count) for v in (self.product.A, self.product.b, self.product.curve.alpha)
            )
            columns |= {"A": A, f"b [{unit}]": b, "alpha": alpha}
        return list(columns), np.column_stack(list(columns.values())).tolist()


def answer_feed(
    posterior: Posterior, fitted: FitEntry, plan: FeedPlan, tests: Fineness | None = None, title: str = ""
) -> Evaluated:
    """The answers of a feed to what a posterior leaves open.

    Raises ValueError where fragments are to be hit again and nothing tells their sizes, or the tests tell nothing of a
    class.
    """
    feed = plan.feed
    rng = random_generator(seed=feed.seed, task="feed.product")
    drawn, missing = draw_product(plan.product, tests, len(posterior), rng)
    if drawn is None and feed.progeny == "again":
        raise ValueError(f'progeny = "again" hits the fragments, and {missing}')
    wanted = draws_for(drawn or _NO_PRODUCT, feed, len(posterior))
    rows = np.unique(np.linspace(0, len(posterior) - 1, wanted).astype(np.int64))
    some, product = posterior.at(rows), (drawn or _NO_PRODUCT).drawn(rows)
    _refuse_what_is_not_told(some, feed)
    broken = breaking(some, product, feed)
    mean, lots = populate(broken, product, feed), None
    if math.isfinite(feed.lot):
        lots = populate(broken, product, feed, random_generator(seed=feed.seed, task="feed.lots"))
    # the class that half of the feed's mass is coarser than: where laws of one kind stand for those of another
    middle = float(feed.classes.sizes[int(np.searchsorted(np.cumsum(feed.classes.mass), 0.5))])
    entry = FeedEntry(
        title=title, seed=feed.seed, made_up=fitted.made_up, draws=len(rows), blows=feed.blows.count,
        progeny=feed.progeny, of=dict(plan.of), particles=dict(plan.particles), share=feed.blows.share,
        lot=feed.lot if math.isfinite(feed.lot) else None, spectrum_error=broken.error, tested=posterior.tested,
        classes=_classes(some, mean, lots, feed), reference_size=middle, form=product.form,
        curve_law=product.curve.law, fines_sieve=feed.fines,
        goal=None if plan.goal is None else _judge(plan.goal, mean, lots, feed, fitted),
        warnings=tuple(_warnings(fitted, mean, feed, product=drawn is not None)),
        **_finding(mean, lots, feed, missing),
    )  # fmt: skip
    if drawn is None:
        return Evaluated(entry=entry, rows=rows, broken=mean.broken, product=None)
    # the product on every sieve, its band over draws and, where there is one, over lots
    low, high = np.quantile(mean.passing if lots is None else lots.passing, _ENDS, axis=0)
    columns = (mean.sieves, feed.classes.passing(mean.sieves), mean.passing.mean(axis=0), low, high)
    curve = tuple(
        SieveEntry(sieve=x, feed=finer, value=value, low=least, high=most)
        for x, finer, value, least, most in np.column_stack(columns).tolist()
    )
    parts = {"A": product.A, "b": product.b, "A b": np.asarray(product.A) * product.b}
    if product.curve.law == "trr":
        parts["alpha"] = product.curve.alpha
    numbers = {name: Interval.of(np.atleast_1d(np.asarray(v, dtype=float)), "") for name, v in parts.items()}
    told = {"curve": curve, "product": numbers, "sources": dict(product.sources)}
    return Evaluated(entry=entry.model_copy(update=told), rows=rows, broken=mean.broken, product=product)


def _refuse_what_is_not_told(posterior: Posterior, feed: Feed) -> None:
    """Refuse blows without the damage that they do, and classes of which no law of size speaks."""
    damaged = any(laws.LAWS[str(name)].sized for name in posterior.which)
    if feed.blows.count > 1 and damaged and "gamma" not in posterior.draws:
        raise ValueError('repeated blows need gamma: add gamma to [tests], a number, a law or "fit"')
    sizes = feed.classes.sizes if feed.rest_breaks else feed.classes.sizes[:-1]
    unknown = sizes[~np.isfinite(posterior.median(sizes)[0])] if posterior.size == "class" else np.empty(0)
    if unknown.size:
        raise ValueError(
            f'size = "class" says nothing of {len(unknown)} classes of the feed, {1e3 * unknown[0]:.3g} mm among them: '
            'take size = "tavares", "king" or "power"'
        )


# --- answers with their intervals -----------------------------------------------------------------------------


def answer(mean: Array, lots: Array | None = None, particles: float | None = None, reason: str = "") -> Answer:
    """The answer of draws (D,) and of lots (D,); of a share of so many particles the scatter is that of (F10)."""
    known = np.isfinite(mean)
    if reason or not known.all():
        share = f"in {100 * float((~known).mean()):.0f} % of the draws it lies below the finest sieve, or nothing broke"
        return Answer(reason=reason or share)
    low, high = (float(v) for v in np.quantile(mean, _ENDS))
    found = {"value": float(mean.mean()), "low": low, "high": high, "ignorance": float(mean.std())}
    if lots is not None and np.isfinite(lots).all():
        scatter = math.sqrt(float(((lots - mean) ** 2).mean()))
        if particles is not None:
            scatter = math.sqrt(float((mean * (1.0 - mean)).mean()) / max(1.0, particles))
        ends = (float(v) for v in np.quantile(lots, _ENDS))
        found |= {"scatter": scatter, **dict(zip(("lot_low", "lot_high"), ends, strict=True))}
    return Answer.model_validate(found)


def _finding(mean: Outcome, lots: Outcome | None, feed: Feed, missing: str) -> dict[str, Any]:
    def one(name: str, *, product: bool = False) -> Answer:
        of_lots = None if lots is None else getattr(lots, name)
        return answer(getattr(mean, name), of_lots, reason=missing if product else "")

    fines = one("fines", product=True) if feed.fines is not None else Answer(reason="no sieve fines was asked for")
    return {
        "broken": one("broken"), "expected_blows": one("blows"), "energy": one("energy"),
        "never": answer(1.0 - mean.broken, None if lots is None else 1.0 - lots.broken), "fines": fines,
        **{name: one(name, product=True) for name in ("t10", "p80", "p50", "reduction")},
    }  # fmt: skip


def _beyond(feed: Feed, tested: tuple[float, float]) -> Flags:
    sizes, (low, high) = feed.classes.sizes, tested
    return np.asarray((sizes * _NEAR < low) | (sizes > high * _NEAR))


def _classes(posterior: Posterior, mean: Outcome, lots: Outcome | None, feed: Feed) -> tuple[ClassEntry, ...]:
    classes, beyond = feed.classes, _beyond(feed, posterior.tested)
    particle = math.pi / 6.0 * feed.density * classes.sizes**3
    median, slope = posterior.median(classes.sizes), posterior.slope(classes.sizes)
    lower = np.append(classes.edges[1:], 0.0)
    found = []
    for k, size in enumerate(classes.sizes):
        count = None if lots is None else float(feed.lot * classes.mass[k] / particle[k])
        broken, blows = (
            (getattr(mean, name)[:, k], None if lots is None else getattr(lots, name)[:, k])
            for name in ("by_class", "blows_by_class")
        )
        found.append(
            ClassEntry(
                upper=float(classes.edges[k]),
                lower=float(lower[k]),
                size=float(size),
                mass=float(classes.mass[k]),
                particles=count,
                extrapolated=bool(beyond[k]),
                E50=Interval.of(median[:, k], _NO_SIZE),
                slope=Interval.of(slope[:, k], _NO_SIZE),
                broken=answer(*broken, particles=count),
                blows=answer(*blows),
            )
        )
    return tuple(found)


# --- the target, and what to be careful about -------------------------------------------------------------------


def _judge(goal: tuple[float, float], mean: Outcome, lots: Outcome | None, feed: Feed, fitted: FitEntry) -> GoalEntry:
    """Whether so much breaks so surely; in lots of the feed where there are any."""
    least, sure = goal
    outcome = mean if lots is None else lots

    def share(total: Array) -> float:
        return float((total >= least).mean())

    probability = share(outcome.broken)
    error = math.sqrt(max(probability * (1.0 - probability), 1.0 / len(mean.broken)) / len(mean.broken))
    kept = probability - _ERRORS * error >= sure
    lost = probability + _ERRORS * error < sure
    verdict = "met" if kept else "not met" if lost else "undecided"
    reasons = [] if verdict != "undecided" else [f"{len(mean.broken)} draws give the probability to ± {error:.2g}"]
    beyond = _beyond(feed, fitted.tested)
    mass = feed.classes.mass
    known, untested = (outcome.by_class * mass)[:, ~beyond].sum(axis=1), 100.0 * float(mass[beyond].sum())
    if verdict == "met" and share(known) < sure:
        reasons.append(f"{untested:.0f} % of the feed lies beyond the tested sizes, and counts")
    elif verdict == "not met" and share(known + float(mass[beyond].sum())) >= sure:
        reasons.append(f"{untested:.0f} % of the feed lies beyond the tested sizes, and could turn it")
    if not fitted.converged:
        reasons.append("the draws of the fit did not settle")
    if fitted.made_up:
        reasons.append("the tests are made up")
    if reasons and verdict != "undecided":
        verdict = "not established"
    return GoalEntry(broken=least, at_least=sure, probability=probability, error=error, verdict=verdict,
                     reasons=tuple(reasons))  # fmt: skip


def _warnings(fitted: FitEntry, mean: Outcome, feed: Feed, *, product: bool) -> list[str]:
    found = ["the tests are made up: no number of this page is of a rock"] if fitted.made_up else []
    found.append("energies are those given to the particles: the machine takes more")
    beyond = _beyond(feed, fitted.tested)
    if beyond.any():
        low, high = (1e3 * v for v in fitted.tested)
        share = 100.0 * float(feed.classes.mass[beyond].sum())
        found.append(f"{share:.0f} % of the feed lies beyond the tested {low:.3g} to {high:.3g} mm: extrapolated")
    if product:
        offered = feed.blows.offered(feed.blows.series(feed.seed), feed.classes.sizes, feed.density).mean(axis=(0, 1))
        sizes = feed.classes.sizes
        outside = (offered < ENERGIES[0]) | (offered > ENERGIES[1]) | (sizes < DIAMETERS[0]) | (sizes > DIAMETERS[1])
        weight = mean.by_class.mean(axis=0) * feed.classes.mass
        share = float(weight[outside].sum() / max(weight.sum(), 1e-300))
        if share > 0.0:
            found.append(
                f"{100 * share:.0f} % of what breaks lies beyond the drop-weight tests behind A and b "
                "(range_of_t10: 0.1 to 2.5 kWh/t, 13 to 63 mm)"
            )
    found.append("sizes are those of the sphere of equal volume; tests must be of particles of this shape")
    return found


def read_feed(folder: Path) -> FeedEntry:
    """feed.json of a folder; raises FolderError where it is missing or damaged."""
    return read_entry(FeedEntry, folder / FEED_FILE)


def read_draws(folder: Path, draws: int) -> dict[str, Array]:
    """Columns of feed-draws.csv; raises FolderError where it is damaged, or not of so many draws of a fit."""
    path = folder / TABLE_FILE
    try:
        header, *rows = csv.reader(io.StringIO(read_whole(path).decode("utf-8")), strict=True)
        values = np.array(rows, dtype=float)
        columns = {name: values[:, k] for k, name in enumerate(header)}
        number = columns["draw"]
        sound = bool(np.isfinite(values).all() and (number >= 1).all() and (number <= draws).all())
    except (ValueError, IndexError, KeyError, csv.Error) as error:
        raise FolderError(f"{path} is damaged: {error}") from error
    if not sound or "broken" not in columns:
        raise FolderError(f"{path} is damaged: it is no table of draws as `uqsphere feed` writes it")
    return columns
