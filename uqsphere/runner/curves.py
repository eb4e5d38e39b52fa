"""Probabilities along a free scalar: the same rows at a few values of it, and their demands interpolated between.

A look at few rows over the whole range tells where the curves rise.  There three values are evaluated with all rows,
and every value of the curve with a few of them.  The interpolated rows are a control variate for those few, which
leaves no error of interpolation on average, however the waves make a demand rise and halt.  A limit whose demands are
censored is not interpolated (`uqsphere.runner.margins` goes along it value by value).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.bars import section
from uqsphere.mechanics.contact import sphere_mass
from uqsphere.runner.limits import state_of
from uqsphere.runner.work import REPLICATES, Draw, OutOfBudget, Sample, Work, evaluate_points
from uqsphere.study import ENERGY, Limit, Study, law_with_mean
from uqsphere.uq.distribution import Law, nominal_mean
from uqsphere.uq.estimates import student
from uqsphere.uq.fragility import chebyshev_nodes, interpolate_rows
from uqsphere.uq.ignorance import is_fitted, possible_laws
from uqsphere.uq.inputs import physical_from_normal
from uqsphere.uq.laws import LawError
from uqsphere.uq.reliability import LimitState, tails
from uqsphere.uq.sampling import random_generator, sobol_points

__all__ = [
    "NodeSet",
    "evaluate_at",
    "find_nodes",
    "half_width",
    "law_curves",
    "moved_study",
    "probabilities",
    "strength_solved",
]

Array = npt.NDArray[np.float64]

#: points of each replicate that look over the range, and values that they look at
SCAN_POINTS: Final = 4
SCAN_VALUES: Final = 9
#: values that all rows are evaluated at
NODES: Final = 3
#: points of each replicate to begin with, and the most
FIRST_POINTS: Final = 64
MOST_POINTS: Final = 1024
#: of so many points one is evaluated at every value of the curve
SHARED: Final = 32
#: laws that the tests allow, for the range of a curve
TRIED: Final = 40
#: values on either side that a value of the curve shares corrections with
REACH: Final = 6.0
#: half-width of the band over the smaller side of the probability
ACCURACY: Final = 0.02
#: half-width that is said to be wider than wanted
WORTH_A_WORD: Final = 0.06
_WIDE: Final = "the band of the curve is wider than wanted: its share of the evaluations, or the time, was used up"
#: values at which curves are drawn
CURVE_VALUES: Final = 40


def strength_solved(name: str) -> str | None:
    """The limit whose strength is the free scalar; None for a number of the scene."""
    parts = name.split(".")
    return parts[1] if len(parts) == 3 and parts[0] == "limits" and parts[2] == "strength" else None


def moved_study(study: Study, name: str, value: float) -> Study:
    """The study with a number at `value`: the mean of its law, or the number itself."""
    if name in study.random:
        return replace(study, random={**study.random, name: law_with_mean(study, name, value)})
    return replace(study, fixed={**study.fixed, name: value})


def _speed_at_energy(work: Work, physical: Array, energy: float) -> Array:
    """Speeds (R, n) at which the striker's kinetic energy is `energy` times the mass of each row's sphere.

    A random speed keeps its ratio to its mean.
    """
    study, names = work.study, work.scene_names

    def column(name: str) -> Array:
        if name in names:
            return np.asarray(physical[:, :, names.index(name)])
        return np.full(physical.shape[:2], study.fixed[name])

    mass = sphere_mass(column("sphere.radius"), column("sphere.density"))
    striker = column("bars.density") * section(column("bars.diameter")) * column("striker.length")
    speed = np.sqrt(2.0 * energy * mass / striker)
    if "striker.speed" in study.random:
        speed = speed * column("striker.speed") / nominal_mean(study.random["striker.speed"])
    return np.asarray(speed)


@lru_cache(maxsize=16)
def _normals(dimension: int, seed: int, start: int, count: int) -> Array:
    """The same normal scores (R, count, dimension) at every value."""
    from scipy.special import ndtri

    found = [
        sobol_points(dimension=dimension, count=count, start=start, seed=seed, task="margins", replicate=r)
        for r in range(REPLICATES)
    ]
    return np.asarray(ndtri(np.stack(found)))


def evaluate_at(work: Work, value: float, *, start: int, count: int, tag: str = "") -> tuple[Draw, Sample]:
    """The points `start` to `start + count` of every replicate, the same random numbers at every value."""
    assert work.study.margins is not None
    solve = work.study.margins.solve
    energy = solve == ENERGY
    outside = energy or strength_solved(solve) is not None
    moved = work if outside else replace(work, study=moved_study(work.study, solve, value))
    normals = _normals(len(moved.drawn.names), work.study.seed, start, count)
    physical = physical_from_normal(moved.drawn, normals.reshape(-1, normals.shape[2])).reshape(normals.shape)
    points = Draw(normals=normals, physical=physical)
    names, d = moved.scene_names, len(moved.scene_names)
    rows = points.physical[:, :, :d]
    if energy:
        speed = _speed_at_energy(work, rows, value)
        if "striker.speed" in names:
            rows = rows.copy()
            rows[:, :, names.index("striker.speed")] = speed
        else:
            names, rows = (*names, "striker.speed"), np.concatenate([rows, speed[:, :, None]], axis=2)
    key = f"margins{tag}.{value:.12e}.{start}.{count}".replace("+", "p")
    flat = rows.reshape(-1, rows.shape[2])
    # without scatter in the scene one row stands for all
    answered = evaluate_points(moved, key, names, flat if rows.shape[2] else flat[:1])
    shape = (*points.physical.shape[:2], len(work.quantities))
    sample = Sample(
        values=np.resize(answered.values, shape),
        censored=np.resize(answered.censored, shape),
        status=np.resize(answered.status, shape[:2]),
    )
    return points, sample


def probabilities(state: LimitState) -> Array:
    """Exceedance of every replicate by itself, (R,)."""
    below, above = tails(state)
    total = below.sum(axis=1) + above.sum(axis=1)
    return np.asarray(below.sum(axis=1) / np.where(total > 0.0, total, 1.0))


@dataclass(kw_only=True)
class NodeSet:
    """Rows evaluated at some values of the free scalar, and some of the rows at every value of a curve.

    `samples` holds all rows at the nodes, `few` the first of them at the values of the curve, all of the same points.
    """

    work: Work
    tag: str
    points: Draw
    samples: dict[float, Sample] = field(default_factory=dict)
    few: dict[float, Sample] = field(default_factory=dict)

    @property
    def nodes(self) -> list[float]:
        return sorted(self.samples)

    @property
    def grid(self) -> Array:
        """Values of the curve."""
        return np.array(sorted(self.few) or self.nodes)

    @property
    def count(self) -> int:
        """Points of each replicate."""
        return int(self.points.normals.shape[1])

    def fits(self, limit: Limit) -> bool:
        """Whether the demands of a limit are known in full."""
        k = self.work.quantities.index(limit.quantity)
        every = (*self.samples.values(), *self.few.values())
        return all(
            not s.failed.any() and not s.censored[:, :, k].any() and bool(np.isfinite(s.values[:, :, k]).all())
            for s in every
        )

    def _between(self, k: int, values: Array, count: int | None) -> Array:
        """Column k (J, R, count) interpolated between the nodes."""
        if len({id(sample) for sample in self.samples.values()}) == 1:
            one = next(iter(self.samples.values())).values[:, :count, k]
            return np.broadcast_to(one, (len(values), *one.shape))
        stack = np.stack([self.samples[node].values[:, :count, k] for node in self.nodes])
        return interpolate_rows(self.nodes, stack, values)

    def _changes(self, k: int) -> tuple[Array, bool]:
        """What brings column k from interpolated to true along the curve, (J, R); whether it is a logarithm.

        What neighbouring values tell is shared between them, as far as they do not differ by more than their noise.
        """
        grid = self.grid
        true = np.stack([self.few[value].values[:, :, k] for value in grid.tolist()])
        ours = self._between(k, grid, true.shape[2])
        logarithmic = bool((true > 0.0).all() and (ours > 0.0).all())
        raw = (np.log(true / ours) if logarithmic else true - ours).mean(axis=2)
        smooth = _kernel(len(grid)) @ raw
        noise = float((raw.var(axis=1, ddof=1) / raw.shape[1]).mean())
        wave = float(((raw - smooth).mean(axis=1) ** 2).mean())
        own = max(0.0, 1.0 - noise / wave) if wave > 0.0 else 0.0
        return smooth + own * (raw - smooth), logarithmic

    def columns(self, quantity: str, values: Array, count: int | None = None, *, each: bool = False) -> Array:
        """A quantity (J, R, count) at J values: interpolated, and brought to what the few rows have on average.

        `each`: every replicate by its own few rows, so that their spread shows what that is worth.
        """
        k = self.work.quantities.index(quantity)
        found = self._between(k, values, count)
        if not self.few:
            return found
        grid = self.grid
        changes, logarithmic = self._changes(k)
        if not each:
            changes = np.repeat(changes.mean(axis=1, keepdims=True), changes.shape[1], axis=1)
        places, wanted = (np.log(grid), np.log(values)) if grid[0] > 0.0 else (grid, values)
        change = np.stack([np.interp(wanted, places, column) for column in changes.T], axis=1)[:, :, None]
        return np.asarray(found * np.exp(change) if logarithmic else found + change)

    def _state(self, limit: Limit, rows: Array, value: float) -> LimitState:
        """The state of a limit with demands (R, n) before its model factor, of the first n points."""
        n = rows.shape[1]
        points = Draw(normals=self.points.normals[:, :n], physical=self.points.physical[:, :n])
        full = np.ones((*rows.shape, len(self.work.quantities)))
        full[:, :, self.work.quantities.index(limit.quantity)] = rows
        sample = Sample(
            values=full, censored=np.zeros(full.shape, dtype=bool), status=np.zeros(rows.shape, dtype=np.int64)
        )
        return _scaled(self.work, limit, state_of(self.work, limit, points, sample), value)

    def states(self, limit: Limit, values: Array, count: int | None = None, *, each: bool = False) -> list[LimitState]:
        """States of a limit at some values, the demands interpolated."""
        demands = self.columns(limit.quantity, values, count, each=each)
        return [self._state(limit, rows, float(value)) for value, rows in zip(values, demands, strict=True)]

    def between(self, limit: Limit, values: Array) -> Array:
        """Probability of exceeding (J, R) at J values by interpolated demands alone."""
        return np.array([probabilities(state) for state in self.states(limit, values)])

    def curve(self, limit: Limit) -> Array:
        """Probability of exceeding (J, R) at the values of the curve, every replicate by itself.

        The interpolated rows are a control variate: what they are off by on the few rows is added, shared between
        neighbouring values.  What is left of the error of interpolation by chance shows in the spread of the
        replicates.
        """
        grid, k = self.grid, self.work.quantities.index(limit.quantity)
        states = self.states(limit, grid, each=True)
        found = np.array([probabilities(state) for state in states])
        if not self.few:
            return found
        off = np.zeros_like(found)
        for j, (value, state) in enumerate(zip(grid.tolist(), states, strict=True)):
            rows = self.few[value].values[:, :, k]
            true = self._state(limit, rows, value)
            ours = probabilities(_first(state, state.demands[:, : rows.shape[1]]))
            side = max(float(found[j].mean() * (1.0 - found[j].mean())), 1e-12)
            off[j] = (probabilities(true) - ours) / side
        side = found.mean(axis=1, keepdims=True) * (1.0 - found.mean(axis=1, keepdims=True))
        return np.asarray(np.clip(found + side * (_kernel(len(grid)) @ off), 0.0, 1.0))


def _kernel(size: int) -> Array:
    """Weights (size, size) by which neighbouring values of a curve share what they tell."""
    weights = np.maximum(0.0, REACH - np.abs(np.subtract.outer(np.arange(size), np.arange(size))))
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def _first(state: LimitState, demands: Array) -> LimitState:
    """The state of the first points of every replicate."""
    n = demands.shape[1]
    tie = None if state.tie is None else replace(state.tie, given=state.tie.given[:, :n])
    shift = None if state.shift is None else state.shift[:, :n]
    none = np.zeros(demands.shape, dtype=bool)
    return replace(state, demands=demands, shift=shift, tie=tie, censored=none, failed=none)


def _scaled(work: Work, limit: Limit, state: LimitState, value: float) -> LimitState:
    """The state with the strength's mean at `value`, where it is the free scalar: all its values in proportion."""
    assert work.study.margins is not None
    if strength_solved(work.study.margins.solve) != limit.name:
        return state
    nominal = nominal_mean(limit.strength) if isinstance(limit.strength, Law) else limit.strength
    return replace(state, demands=state.demands * (nominal / value))


def _region(work: Work, limits: Sequence[Limit], scan: NodeSet, least: float) -> tuple[float, float]:
    """Where the probabilities of the limits lie between `least` and its complement, by the few rows of the look."""
    assert work.study.margins is not None
    low, high = work.study.margins.between
    fine = np.geomspace(low, high, 301) if low > 0.0 else np.linspace(low, high, 301)
    fine[0], fine[-1] = low, high
    inside = np.zeros(fine.size, dtype=bool)
    for limit in limits:
        p = scan.between(limit, fine).mean(axis=1)
        sides = (p > least).astype(int) + (p > 1.0 - least)
        crossed = np.flatnonzero(np.diff(sides) != 0)
        inside |= sides == 1
        inside[crossed] = inside[crossed + 1] = True
        inside |= _open_to_tests(work, limit, scan, fine, least)
    if not inside.any():
        return low, high
    at = np.flatnonzero(inside)
    return float(fine[max(at[0] - 2, 0)]), float(fine[min(at[-1] + 2, fine.size - 1)])


def _open_to_tests(work: Work, limit: Limit, scan: NodeSet, fine: Array, least: float) -> Array:
    """Where a strength that was fitted to tests may bring the probability between `least` and its complement."""
    nothing = np.zeros(fine.size, dtype=bool)
    if not (isinstance(limit.strength, Law) and is_fitted(limit.strength)):
        return nothing
    generator = random_generator(seed=work.study.seed, task=f"ignorance limits.{limit.name}.strength")
    try:
        laws = possible_laws(limit.strength, TRIED, generator)
    except LawError:
        return nothing
    coarse = fine[:: max(1, fine.size // 30)]
    curves = law_curves(scan.states(limit, coarse), laws)
    # one law in fifty may leave the range
    low, high = np.quantile(curves, [0.02, 0.98], axis=0)
    inside = (high > least) & (low < 1.0 - least)
    return np.asarray(np.interp(np.arange(fine.size), np.searchsorted(fine, coarse), inside.astype(float)) > 0.0)


def law_curves(states: Sequence[LimitState], laws: Sequence[Law]) -> Array:
    """Probability of exceeding (laws, J) at J states with one law after the other in place of the strength."""
    found = np.full((len(laws), len(states)), 0.5)
    for j, state in enumerate(states):
        for k, law in enumerate(laws):
            below, above = tails(replace(state, strength=law))
            if (total := float(below.sum() + above.sum())) > 0.0:
                found[k, j] = float(below.sum()) / total
    return found


def find_nodes(
    work: Work, limits: Sequence[Limit], *, least: float, most: int, tag: str = "", accuracy: float = ACCURACY
) -> tuple[NodeSet, NodeSet | None, str]:
    """(the look over the range, the rows where the curves rise, a remark), for at most `most` evaluations.

    The second is None where a demand is not known in full.  `least` is the smallest probability of interest.
    """
    assert work.study.margins is not None
    low, high = work.study.margins.between
    before = work.ledger.total
    if strength_solved(work.study.margins.solve) is not None:
        points, sample = evaluate_at(work, low, start=0, count=FIRST_POINTS, tag=tag)
        nodes = scan = NodeSet(work=work, tag=tag, points=points, samples={low: sample, high: sample})
        if not all(nodes.fits(limit) for limit in limits):
            return nodes, None, ""
        grid = _spaced(*_region(work, limits, nodes, least), CURVE_VALUES)
        nodes = NodeSet(work=work, tag=tag, points=points, samples=dict.fromkeys(grid, sample))
    else:
        found = {v: evaluate_at(work, v, start=0, count=SCAN_POINTS, tag=tag) for v in _spaced(low, high, SCAN_VALUES)}
        scan = NodeSet(work=work, tag=tag, points=found[low][0], samples={v: s for v, (_, s) in found.items()})
        limits = [limit for limit in limits if scan.fits(limit)]
        if not limits:
            return scan, None, ""
        cost = REPLICATES * (NODES * FIRST_POINTS + CURVE_VALUES * (FIRST_POINTS // SHARED))
        if work.ledger.total + cost > work.study.analysis.budget.evaluations:
            return scan, None, "the curve is coarser than wanted: the budget of evaluations was used up"
        start, end = _region(work, limits, scan, least)
        nodes = NodeSet(work=work, tag=tag, points=scan.points)
        for value in chebyshev_nodes(start, end, NODES, logarithmic=low > 0.0):
            nodes.points, nodes.samples[value] = evaluate_at(work, value, start=0, count=FIRST_POINTS, tag=tag)
        for value in _spaced(start, end, CURVE_VALUES):
            nodes.few[value] = evaluate_at(work, value, start=0, count=FIRST_POINTS // SHARED, tag=tag)[1]
        limits = [limit for limit in limits if nodes.fits(limit)]
        if not limits:
            return scan, None, ""
    return scan, nodes, _grow(nodes, limits, least, before + most, accuracy)


def _spaced(low: float, high: float, count: int) -> list[float]:
    """`count` values from low to high in equal ratios, or in equal steps where they are not positive."""
    inner = np.geomspace(low, high, count) if low > 0.0 else np.linspace(low, high, count)
    return [low, *(float(value) for value in inner[1:-1]), high]


def _grow(nodes: NodeSet, limits: Sequence[Limit], least: float, most: int, accuracy: float) -> str:
    """As many rows as the accuracy takes, doubled each time, and a remark where they were not to be had."""
    work = nodes.work
    while (worst := max(half_width(nodes.curve(limit), 2.0 * least) for limit in limits)) > accuracy:
        few = next(iter(nodes.few.values())).status.shape[1] if nodes.few else 0
        distinct = {id(sample): value for value, sample in nodes.samples.items()}
        cost = REPLICATES * (nodes.count * len(distinct) + few * len(nodes.few))
        if nodes.count >= MOST_POINTS or work.ledger.total + cost > most:
            return _WIDE if worst > WORTH_A_WORD else ""
        try:
            more = {
                key: evaluate_at(work, value, start=nodes.count, count=nodes.count, tag=nodes.tag)
                for key, value in distinct.items()
            }
            rest = {v: evaluate_at(work, v, start=few, count=few, tag=nodes.tag)[1] for v in nodes.few}
        except OutOfBudget:
            return _WIDE
        points = next(iter(more.values()))[0]
        longer = {key: nodes.samples[value].join(more[key][1]) for key, value in distinct.items()}
        nodes.samples = {value: longer[id(sample)] for value, sample in nodes.samples.items()}
        nodes.few = {value: sample.join(rest[value]) for value, sample in nodes.few.items()}
        nodes.points = Draw(
            normals=np.concatenate([nodes.points.normals, points.normals], axis=1),
            physical=np.concatenate([nodes.points.physical, points.physical], axis=1),
        )
        if not all(nodes.fits(limit) for limit in limits):
            return "some rows have no answer"
    return ""


def half_width(curve: Array, least: float) -> float:
    """Largest half-width of the 95 % interval over the smaller side, where that is not below `least`; curve (J, R)."""
    p = curve.mean(axis=1)
    side = np.minimum(p, 1.0 - p)
    keep = side >= least
    if not keep.any():
        return 0.0
    error = curve.std(axis=1, ddof=1) / math.sqrt(curve.shape[1])
    return float((student(curve.shape[1]) * error[keep] / side[keep]).max())
