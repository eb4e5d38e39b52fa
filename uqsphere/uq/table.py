"""A table of functions of one to three numbers, finer where they change and where it is asked.

Cells are boxes with a node at every corner; inside one the functions are interpolated linearly along each axis.  The
first cells are those that rows lie in, and a cell is split into halves along every axis where

    (largest difference of its corners over the standard deviation)² times the rows in it

is the largest.  A function that jumps is not known near the jump: the cells whose corners differ by `JUMP` or more when
the nodes are used up, and those with a corner without an answer, give no number.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import product
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array, Flags

#: cells along an axis to begin with, for one, two and three numbers: a few hundred nodes each
FIRST: Final = (64, 16, 6)
#: halvings of a cell, at the most
DEPTH: Final = 12
#: corners that differ by half a standard deviation tell nothing in between; across a smaller jump interpolation is off
#: by a sixth of its square in the mean: one in a hundred rows there leaves less than a thousandth of the variance
JUMP: Final = 0.5
#: root mean square of that difference over all rows at which a table is done: less than a twelfth of its square, 5e-4,
#: of the variance is left
CLOSE: Final = 0.08

Whole: TypeAlias = npt.NDArray[np.int64]


@dataclass(kw_only=True)
class Table:
    """Functions (c,) of k numbers, made by `make_table`.

    Attributes
    ----------
    low, width : (k,) the corner of the first cells and their sides.
    leaves : the cells of every level by their sorted codes; `corners`: (cells, 2^k) which nodes their corners are.
    codes, values : (N,) sorted codes of the nodes, (N, c) the functions there.
    sure : for every level, which of its leaves interpolate.
    """

    low: Array
    width: Array
    codes: Whole
    values: Array
    leaves: list[Whole] = field(default_factory=list)
    corners: list[Whole] = field(default_factory=list)
    sure: list[Flags] = field(default_factory=list)

    @property
    def nodes(self) -> int:
        """How often the functions were evaluated."""
        return len(self.codes)

    @property
    def cells(self) -> int:
        """How many cells there are."""
        return sum(map(len, self.leaves))

    def at(self, points: Array) -> tuple[Array, Flags]:
        """The functions (n, c) at points (n, k), and whether they are known there: not across jumps, nor outside."""
        n, k = points.shape
        found, known = np.full((n, self.values.shape[1]), np.nan), np.zeros(n, dtype=bool)
        left = np.arange(n)
        for level, (leaves, corners, sure) in enumerate(zip(self.leaves, self.corners, self.sure, strict=True)):
            scaled = (points[left] - self.low) / self.width * 2.0**level
            cells = np.floor(scaled)
            inside = _code(cells.astype(np.int64))
            place = np.minimum(np.searchsorted(leaves, inside), max(len(leaves) - 1, 0))
            here = leaves[place] == inside if len(leaves) else np.zeros(len(left), dtype=bool)
            taken = here & sure[place] if len(leaves) else here
            rows, nodes = left[taken], corners[place[taken]]
            share = scaled[taken] - cells[taken]
            total = np.zeros((len(rows), self.values.shape[1]))
            for corner, node in zip(product((0, 1), repeat=k), nodes.T, strict=True):
                weight = np.prod(np.where(np.array(corner) == 1, share, 1.0 - share), axis=1)
                total += weight[:, None] * self.values[node]
            found[rows], known[rows] = total, True
            left = left[~here]
        return found, known


def _code(places: Whole) -> Whole:
    """One number for the places (n, k) of a lattice; 20 bits an axis, which may be a little negative."""
    code = np.zeros(len(places), dtype=np.int64)
    for column in places.T:
        code = (code << 20) + (column + 1024)
    return code


def _places(codes: Whole, axes: int) -> Whole:
    columns = [((codes >> (20 * (axes - 1 - a))) & ((1 << 20) - 1)) - 1024 for a in range(axes)]
    return np.stack(columns, axis=1)


def _corners(cells: Whole, level: int) -> Whole:
    """Codes (n, 2^k) of the corners of cells (n, k) of a level, on the lattice of the finest."""
    step = 1 << (DEPTH - level)
    return np.stack(
        [_code((cells + np.array(corner)) * step) for corner in product((0, 1), repeat=cells.shape[1])], axis=1
    )


def make_table(rows: Array, evaluate: Callable[[Array], Array], followed: int, most: int, spared: float = 1.0) -> Table:
    """The table of functions at the places of rows (n, k) for at most `most` evaluations.

    Parameters
    ----------
    rows : (n, k) array, k from 1 to 3
        Where the table will be asked, about of unit scatter along each axis.
    evaluate : function of (m, k) points to (m, c) values, NaN where there is no answer
    followed : so many of the last columns say how the functions change, in standard deviations of what they are for;
        they are no part of the table
    most : evaluations
    spared : share of the rows that it may leave without an answer; where so many evaluations cannot reach that, it ends

    >>> points = np.random.default_rng(1).normal(size=(4000, 2))
    >>> step = lambda x: x[:, :1] + 2.0 * (x[:, :1] > 0.3 * x[:, 1:])
    >>> table = make_table(points, lambda x: np.concatenate([step(x), step(x)], axis=1), 1, 2000)
    >>> values, known = table.at(points)
    >>> bool(known.mean() > 0.7), bool(np.abs(values - step(points))[known].max() < 0.1), table.nodes <= 2000
    (True, True, True)
    """
    axes = rows.shape[1]
    low, high = rows.min(axis=0), rows.max(axis=0)
    width = np.maximum(high - low, 1e-9) * (1.0 + 1e-9) / FIRST[axes - 1]
    table = Table(low=low, width=width, codes=np.empty(0, dtype=np.int64), values=np.empty((0, 0)))
    fresh, counts = np.unique(_code(np.floor((rows - low) / width).astype(np.int64)), return_counts=True)
    _evaluate(table, evaluate, _corners(_places(fresh, axes), 0))
    splits = _Splits(table=table, rows=rows, followed=followed)
    splits.add(0, fresh, counts)
    # a cell that is split shares the new nodes with its neighbours: about one for each of its parts
    while room := (most - table.nodes) // (3**axes - 2**axes):
        if table.nodes + splits.least(spared) > most or not splits.split(room, evaluate):
            break
    splits.close()
    return table


def _evaluate(table: Table, evaluate: Callable[[Array], Array], corners: Whole) -> None:
    """Add what nodes are still lacking."""
    wanted = np.setdiff1d(corners.ravel(), table.codes)
    if not len(wanted):
        return
    places = _places(wanted, len(table.low))
    values = evaluate(table.low + table.width * places / 2.0**DEPTH)
    codes = np.concatenate([table.codes, wanted])
    values = np.concatenate([table.values, values]) if len(table.codes) else values
    order = np.argsort(codes)
    table.codes, table.values = codes[order], values[order]


@dataclass(kw_only=True)
class _Splits:
    """The cells of a table while it is made: level, code, rows in each, and the largest difference of its corners."""

    table: Table
    rows: Array
    followed: int
    levels: Whole = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    cells: Whole = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    counts: Whole = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    ranges: Array = field(default_factory=lambda: np.empty(0))

    def add(self, level: int, cells: Whole, counts: Whole) -> None:
        """Cells of a level whose nodes are there."""
        table = self.table
        corners = _corners(_places(cells, len(table.low)), level)
        values = table.values[:, -self.followed :][np.searchsorted(table.codes, corners)]
        # variances are made of squares: far out an error counts as often as the value
        spread = np.ptp(values, axis=1) * np.maximum(np.abs(values).max(axis=1), 1.0)
        # a corner without an answer is split as a jump of a standard deviation; what it answers is not a number
        ranges = np.where(np.isnan(spread), 1.0, spread).max(axis=1, initial=0.0)
        self.levels = np.concatenate([self.levels, np.full(len(cells), level)])
        self.cells, self.counts = np.concatenate([self.cells, cells]), np.concatenate([self.counts, counts])
        self.ranges = np.concatenate([self.ranges, ranges])

    def least(self, spared: float) -> float:
        """Evaluations that it takes at least to leave no more than this share of the rows near jumps.

        Of a cell that is not sure either halving its sides halves the differences, or a jump goes through it, and half
        of its parts stay so.
        """
        unsure, axes = self.ranges >= JUMP, len(self.table.low)
        ahead = self.counts[unsure].sum() / (spared * len(self.rows))
        if ahead <= 1.0:
            return 0.0
        smooth = float((2.0 ** (axes * (np.floor(np.log2(self.ranges[unsure] / JUMP)) + 1.0))).sum())
        return min(smooth, float(unsure.sum() * ahead ** (axes - 1)))

    def split(self, room: int, evaluate: Callable[[Array], Array]) -> bool:
        """Split the cells that matter most, half of what all of them matter together; False where none is left."""
        matter = np.where(self.levels < DEPTH, self.ranges**2 * self.counts, 0.0)
        if matter.sum() <= CLOSE**2 * len(self.rows):
            return False
        order = np.argsort(-matter, kind="stable")
        enough = int(np.searchsorted(np.cumsum(matter[order]), 0.5 * matter.sum())) + 1
        chosen = order[: min(room, enough)]
        chosen = chosen[matter[chosen] > 0.0]
        if not len(chosen):
            return False
        levels, cells = self.levels[chosen], self.cells[chosen]
        keep = np.ones(len(self.cells), dtype=bool)
        keep[chosen] = False
        self.levels, self.cells = self.levels[keep], self.cells[keep]
        self.counts, self.ranges = self.counts[keep], self.ranges[keep]
        parts = {int(level): self._parts(int(level), cells[levels == level]) for level in np.unique(levels)}
        axes = len(self.table.low)
        corners = [_corners(_places(new, axes), level + 1).ravel() for level, (new, _) in parts.items()]
        _evaluate(self.table, evaluate, np.concatenate(corners))
        for level, (new, counts) in parts.items():
            self.add(level + 1, new, counts)
        return True

    def _parts(self, level: int, cells: Whole) -> tuple[Whole, Whole]:
        """The halves along every axis of cells of a level, and how many rows lie in each."""
        inside = (self.rows - self.table.low) / self.table.width * 2.0**level
        here = np.isin(_code(np.floor(inside).astype(np.int64)), cells)
        met, counts = np.unique(_code(np.floor(2.0 * inside[here]).astype(np.int64)), return_counts=True)
        axes = len(self.table.low)
        every = np.unique([_code(2 * _places(cells, axes) + np.array(half)) for half in product((0, 1), repeat=axes)])
        found = np.zeros(len(every), dtype=np.int64)
        found[np.searchsorted(every, met)] = counts
        return every, found

    def close(self) -> None:
        """Give the table its leaves, and say which of them answer."""
        for level in range(int(self.levels.max(initial=0)) + 1):
            here = self.levels == level
            order = np.argsort(self.cells[here])
            cells = self.cells[here][order]
            corners = _corners(_places(cells, len(self.table.low)), level)
            self.table.leaves.append(cells)
            self.table.corners.append(np.searchsorted(self.table.codes, corners))
            self.table.sure.append(self.ranges[here][order] < JUMP)
        self.table.values = np.ascontiguousarray(self.table.values[:, : -self.followed])
