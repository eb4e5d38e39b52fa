"""Probabilities along a free scalar: the same rows at a few values of it, and their demands interpolated between.

A look at few rows over the whole range tells where the curves rise.  There four values are evaluated with all rows, and
a share of the rows half-way between them: where those differ from the interpolation, values are added.  A limit whose
demands jump, or are censored, is not interpolated (`uqsphere.runner.margins` goes along it value by value).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
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

__all__ = ["NodeSet", "evaluate_at", "find_nodes", "law_curves", "moved_study", "probabilities", "strength_solved"]

Array = npt.NDArray[np.float64]

#: points of each replicate that look over the range, and values that they look at
SCAN_POINTS: Final = 4
SCAN_VALUES: Final = 9
#: nodes to begin with, the most of them, and rounds of adding
FIRST_NODES: Final = 4
MOST_NODES: Final = 25
ROUNDS: Final = 4
#: points of each replicate to begin with, and the most
FIRST_POINTS: Final = 64
MOST_POINTS: Final = 1024
#: share of the points of a replicate that check the interpolation
CHECKED: Final = 8
#: laws that the tests allow, for the range of a curve
TRIED: Final = 50
#: what interpolation may change in a probability, relative to the smaller side, and its half-width
INTERPOLATION: Final = 0.003
ACCURACY: Final = 0.02
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
    """The same normal scores (R, count, dimension) at every value: to make them takes longer than to evaluate them."""
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
    """Rows evaluated at some values of the free scalar; `samples` by value, all of the same points."""

    work: Work
    tag: str
    points: Draw
    samples: dict[float, Sample] = field(default_factory=dict)
    #: largest change of a probability by interpolation, relative to the smaller side, by limit
    lost: dict[str, float] = field(default_factory=dict)
    #: rows evaluated half-way between nodes, by value
    checked: dict[float, tuple[Draw, Sample]] = field(default_factory=dict)

    @property
    def nodes(self) -> list[float]:
        return sorted(self.samples)

    @property
    def count(self) -> int:
        """Points of each replicate."""
        return int(self.points.normals.shape[1])

    @property
    def whole(self) -> bool:
        """Whether every row has an answer at every node."""
        return all(not s.failed.any() and bool(np.isfinite(s.values).all()) for s in self.samples.values())

    def fits(self, limit: Limit) -> bool:
        """Whether the demands of a limit are known in full."""
        k = self.work.quantities.index(limit.quantity)
        return self.whole and not any(bool(s.censored[:, :, k].any()) for s in self.samples.values())

    def columns(self, quantity: str, values: Array, few: int | None = None) -> Array:
        """A quantity (J, R, n) at J values, of the first `few` points of each replicate."""
        k = self.work.quantities.index(quantity)
        solve = self.work.study.margins
        assert solve is not None
        if strength_solved(solve.solve) is not None:
            one = next(iter(self.samples.values())).values[:, :few, k]
            return np.broadcast_to(one, (len(values), *one.shape))
        stack = np.stack([self.samples[node].values[:, :few, k] for node in self.nodes])
        return interpolate_rows(self.nodes, stack, values)

    def states(self, limit: Limit, values: Array, few: int | None = None) -> list[LimitState]:
        """States of a limit at some values, the demands interpolated."""
        demands = self.columns(limit.quantity, values, few)
        points = Draw(normals=self.points.normals[:, :few], physical=self.points.physical[:, :few])
        k, q = self.work.quantities.index(limit.quantity), len(self.work.quantities)
        found = []
        for value, rows in zip(values, demands, strict=True):
            full = np.ones((*rows.shape, q))
            full[:, :, k] = rows
            sample = Sample(
                values=full, censored=np.zeros(full.shape, dtype=bool), status=np.zeros(rows.shape, dtype=np.int64)
            )
            found.append(_scaled(self.work, limit, state_of(self.work, limit, points, sample), float(value)))
        return found

    def curve(self, limit: Limit, values: Array, few: int | None = None) -> Array:
        """Probability of exceeding (J, R) at J values, every replicate by itself."""
        return np.array([probabilities(state) for state in self.states(limit, values, few)])


def _scaled(work: Work, limit: Limit, state: LimitState, value: float) -> LimitState:
    """The state with the strength's mean at `value`, where it is the free scalar: all its values in proportion."""
    assert work.study.margins is not None
    if strength_solved(work.study.margins.solve) != limit.name:
        return state
    nominal = nominal_mean(limit.strength) if isinstance(limit.strength, Law) else limit.strength
    return replace(state, demands=state.demands * (nominal / value))


def _direct(work: Work, limit: Limit, points: Draw, sample: Sample, value: float) -> Array:
    return probabilities(_scaled(work, limit, state_of(work, limit, points, sample), value))


def _region(work: Work, limits: Sequence[Limit], scan: NodeSet, least: float) -> tuple[float, float]:
    """Where the probabilities of the limits lie between `least` and its complement, by the few rows of the look."""
    assert work.study.margins is not None
    low, high = work.study.margins.between
    fine = np.geomspace(low, high, 301) if low > 0.0 else np.linspace(low, high, 301)
    fine[0], fine[-1] = low, high
    inside = np.zeros(fine.size, dtype=bool)
    for limit in limits:
        p = scan.curve(limit, fine).mean(axis=1)
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
    coarse = fine[:: max(1, fine.size // 60)]
    curves = law_curves(scan.states(limit, coarse), laws)
    # one law in fifty may leave the range
    low, high = np.quantile(curves, [0.02, 0.98], axis=0)
    inside = (high > least) & (low < 1.0 - least)
    return np.asarray(np.interp(np.arange(fine.size), np.searchsorted(fine, coarse), inside.astype(float)) > 0.0)


def law_curves(states: Sequence[LimitState], laws: Sequence[Law]) -> Array:
    """Probability of exceeding (laws, J) at J states with one law after the other in place of the strength."""
    found = np.empty((len(laws), len(states)))
    for j, state in enumerate(states):
        for k, law in enumerate(laws):
            below, above = tails(replace(state, strength=law))
            total = float(below.sum() + above.sum())
            found[k, j] = float(below.sum()) / total if total > 0.0 else 0.5
    return found


def _misses(work: Work, limits: Sequence[Limit], nodes: NodeSet, least: float) -> tuple[list[float], int]:
    """Values half-way between nodes at which interpolated probabilities are off, by rows evaluated there."""
    few = max(1, nodes.count // CHECKED)
    places = nodes.nodes
    logarithmic = places[0] > 0.0
    wrong = []
    nodes.lost = {limit.name: 0.0 for limit in limits}
    for a, b in pairwise(places):
        value = math.sqrt(a * b) if logarithmic else 0.5 * (a + b)
        if value not in nodes.checked:
            nodes.checked[value] = evaluate_at(work, value, start=0, count=few, tag=nodes.tag)
        points, sample = nodes.checked[value]
        for limit in limits:
            k = work.quantities.index(limit.quantity)
            if sample.failed.any() or sample.censored[:, :, k].any():
                nodes.lost[limit.name] = math.inf
                continue
            true = float(_direct(work, limit, points, sample, value).mean())
            ours = float(nodes.curve(limit, np.array([value]), few).mean())
            off = abs(ours - true) / max(min(true, 1.0 - true), least)
            nodes.lost[limit.name] = max(nodes.lost[limit.name], off)
            if off > INTERPOLATION and value not in wrong:
                wrong.append(value)
    return wrong, few


def find_nodes(
    work: Work, limits: Sequence[Limit], *, least: float, most: int, tag: str = "", accuracy: float = ACCURACY
) -> tuple[NodeSet, NodeSet | None, str]:
    """(the look over the range, the rows where the curves rise, a remark), for at most `most` evaluations.

    The second is None where the demands cannot be interpolated.  `least` is the smallest probability of interest.
    """
    assert work.study.margins is not None
    margins = work.study.margins
    low, high = margins.between
    logarithmic = low > 0.0
    spent, before = 0, work.ledger.total

    def left() -> int:
        nonlocal spent
        spent = work.ledger.total - before
        return most - spent

    if strength_solved(margins.solve) is not None:
        points, sample = evaluate_at(work, low, start=0, count=FIRST_POINTS, tag=tag)
        one = NodeSet(work=work, tag=tag, points=points, samples={low: sample, high: sample})
        if not all(one.fits(limit) for limit in limits):
            return one, None, ""
        one.lost = {limit.name: 0.0 for limit in limits}
        low, high = _region(work, limits, one, least)
        return one, *_more_rows(one, limits, low, high, least, left, accuracy)
    space = np.geomspace if logarithmic else np.linspace
    values = [low, *(float(v) for v in space(low, high, SCAN_VALUES)[1:-1]), high]
    found = {value: evaluate_at(work, value, start=0, count=SCAN_POINTS, tag=tag) for value in values}
    scan = NodeSet(work=work, tag=tag, points=found[low][0], samples={v: s for v, (_, s) in found.items()})
    usable = [limit for limit in limits if scan.fits(limit)]
    if not usable:
        return scan, None, ""
    start, end = _region(work, usable, scan, least)
    nodes = NodeSet(work=work, tag=tag, points=found[low][0])
    todo = chebyshev_nodes(start, end, FIRST_NODES, logarithmic=logarithmic)
    for _ in range(ROUNDS + 1):
        if REPLICATES * FIRST_POINTS * len(todo) > left() or len(nodes.samples) + len(todo) > MOST_NODES:
            break
        for value in todo:
            nodes.points, nodes.samples[value] = evaluate_at(work, value, start=0, count=FIRST_POINTS, tag=tag)
        usable = [limit for limit in usable if nodes.fits(limit)]
        if not usable:
            return scan, None, ""
        todo, _ = _misses(work, usable, nodes, least)
        if not todo:
            break
    if len(nodes.samples) < FIRST_NODES:
        return scan, None, "the curve is coarser than wanted: the budget of evaluations was used up"
    return scan, *_more_rows(nodes, usable, start, end, least, left, accuracy)


def _more_rows(
    nodes: NodeSet, limits: Sequence[Limit], low: float, high: float, least: float, left: object, accuracy: float
) -> tuple[NodeSet, str]:
    """The nodes with as many rows as the accuracy takes, doubled each time."""
    assert callable(left)
    work, tag = nodes.work, nodes.tag
    values = np.geomspace(low, high, CURVE_VALUES) if low > 0.0 else np.linspace(low, high, CURVE_VALUES)
    values[0], values[-1] = low, high
    solved = strength_solved(work.study.margins.solve) is not None if work.study.margins else False
    while nodes.count < MOST_POINTS:
        worst = max(_half_width(nodes.curve(limit, values), least) for limit in limits)
        if worst <= accuracy:
            return nodes, ""
        each = REPLICATES * nodes.count
        if each * (1 if solved else len(nodes.samples)) > left():
            return nodes, "the band of the curve is wider than wanted: its share of the evaluations was used up"
        try:
            more = [(v, evaluate_at(work, v, start=nodes.count, count=nodes.count, tag=tag)) for v in nodes.nodes[:1]]
            if not solved:
                rest = nodes.nodes[1:]
                more += [(v, evaluate_at(work, v, start=nodes.count, count=nodes.count, tag=tag)) for v in rest]
        except OutOfBudget:
            return nodes, "the band of the curve is wider than wanted: the time was over"
        added, (points, first) = dict(more), more[0][1]
        nodes.samples = {v: s.join(added[v][1] if v in added else first) for v, s in nodes.samples.items()}
        nodes.points = Draw(
            normals=np.concatenate([nodes.points.normals, points.normals], axis=1),
            physical=np.concatenate([nodes.points.physical, points.physical], axis=1),
        )
    return nodes, ""


def _half_width(curve: Array, least: float) -> float:
    """Largest half-width of the 95 % interval over the smaller side, where that is not below `least`; curve (J, R)."""
    p = curve.mean(axis=1)
    side = np.minimum(p, 1.0 - p)
    keep = side >= least
    if not keep.any():
        return 0.0
    error = curve.std(axis=1, ddof=1) / math.sqrt(curve.shape[1])
    return float((student(curve.shape[1]) * error[keep] / side[keep]).max())
