"""Which terms of a basis to keep: solvers of one signature, each judged on samples that it has not seen.

A solver takes a `Task` and returns a `Path`: rows of the basis in the order in which they enter, and the K-fold error
of every size.  It runs on all samples and on all samples but one fold, K times, side by side ("lanes", the first of
which has all samples): the fold left out is predicted by terms that were chosen without it.  The leave-one-out error
of terms chosen on all samples is ten to a hundred times too small where candidates outnumber samples.

What an expansion reports of itself: K-fold errors hold the choice of terms, and are those of fewer samples: too large
where an error falls fast.  Leave-one-out errors of the terms chosen know nothing of the choice: too small.  Their
geometric mean is nearer than either (`blended`).  Neither sees beyond the samples, where a polynomial is loose: what
the coefficients are uncertain by, by the jackknife over the folds (Efron and Stein 1981), is carried to the law itself
(`refits`).  What the next terms would be, and how large under the law, tells what lies in tails without samples
(`neglected`, `leaned`).  A mean of squares that a single sample makes up says little: `steadied` leans on the others.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array

Order: TypeAlias = npt.NDArray[np.intp]

_ROUNDING: Final = 1e-15  # of the norm of the outputs: what is left is rounding
_DEPENDENT: Final = 1e-8  # of its square norm: a row that hangs on those taken before
_LEAST_PATIENCE: Final = 10
_BLOCK: Final = 96  # rows whose products with the few lanes are taken at once: more would be copied around first


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """A basis (P, n) at the samples, row 0 constant; values (n,) to be fitted; the fold (n,) of every sample.

    `error` gives the relative mean square error, in output units, of predictions (n,) of the values.  `sizes` are
    the whole sets within the basis, for solvers that take nothing less; `most` is the largest number of terms.
    """

    basis: Array
    values: Array
    folds: npt.NDArray[np.intp]
    error: Callable[[Array], float]
    most: int
    sizes: tuple[int, ...] = ()

    @property
    def masks(self) -> Array:
        """Which samples each lane sees, (1 + K, n) of 0 and 1; the first sees all."""
        count = int(self.folds.max()) + 1
        return np.stack([np.ones(self.folds.size), *((self.folds != k).astype(float) for k in range(count))])


@dataclass(frozen=True, kw_only=True, eq=False)
class Path:
    """Rows in the order of their entry, and the K-fold error (k,) of the first 1, 2, … of them.

    -1 stands for a step that found nothing to add.  `held_out` (n,) are the predictions of every sample without its
    fold, at the size of the least error.  `without` (K, k) are the rows that were chosen without each fold; None from
    a solver whose folds choose nothing of their own.
    """

    order: Order
    errors: Array
    held_out: Array
    without: Order | None = None

    def chosen_without(self) -> list[Order]:
        """The rows chosen without each fold, as many as leave the least error; none where folds choose nothing."""
        if self.without is None:
            return []
        return [line[line >= 0] for line in self.without[:, : int(np.argmin(self.errors)) + 1]]

    def best(self) -> tuple[Order, float]:
        """The rows with the least error, and that error."""
        size = int(np.argmin(self.errors)) + 1
        order = self.order[:size]
        return order[order >= 0], float(self.errors[size - 1])


Solver: TypeAlias = Callable[[Task], Path]


def _dots(one: Array, other: Array) -> Array:
    """Inner products (lanes,) of the lines of two (lanes, n)."""
    return np.asarray(np.vecdot(one, other))


class _Lanes:
    """Orthonormal directions of every lane, known at all samples, and the fits in them.

    A direction is orthonormal over the samples that its lane sees and goes on over the fold left out, so that the
    fit is a prediction there.
    """

    def __init__(self, task: Task, most: int) -> None:
        self.task, self.masks = task, task.masks
        lanes, n = self.masks.shape
        self.directions = np.empty((lanes, most, n))
        # products of every direction with every row of the basis: what a new row has in common with those before
        self.along = np.empty((most, lanes, task.basis.shape[0]))
        self.norms = self.masks @ (task.basis**2).T  # square norms of all rows over what each lane sees
        self.every = np.arange(lanes)
        self.residuals = self.masks * task.values
        self.squares = _dots(self.residuals, self.residuals)
        self.floors = _ROUNDING**2 * self.squares
        self.lane, self.sample = 1 + task.folds, np.arange(n)
        self.predicted = np.zeros(n)  # of every sample by the lane that does not see it
        self.count = 0
        self.errors: list[float] = []
        self.held_out = np.zeros(n)
        self.orders: list[Order] = []
        self._least, self._since = np.inf, 0

    def add(self, rows: Order, wanted: npt.NDArray[np.bool_]) -> tuple[Array, Array]:
        """One more row for every lane: the length of what is new in it (lanes,), and its overlaps (lanes, k)."""
        k = self.count
        fresh = self.task.basis[rows]
        before = self.norms[self.every, rows]
        overlaps = part = np.ascontiguousarray(self.along[:k, self.every, rows].T)
        for turn in range(2):
            if k:
                fresh -= np.matmul(part[:, None, :], self.directions[:, :k])[:, 0]
            masked = self.masks * fresh
            squares = _dots(masked, masked)
            if turn or (squares > 1e-5 * before).all():  # once is enough where something is left
                break
            part = np.matmul(self.directions[:, :k], masked[:, :, None])[:, :, 0]
            overlaps = overlaps + part
        sound = wanted & (squares > _DEPENDENT * before)
        lengths = np.where(sound, np.sqrt(squares), 0.0)
        inverse = np.where(sound, 1.0 / np.where(sound, lengths, 1.0), 0.0)[:, None]
        fresh *= inverse
        masked *= inverse
        self.directions[:, k] = fresh
        steps = np.where(self.squares > self.floors, _dots(masked, self.residuals), 0.0)
        self.residuals -= steps[:, None] * masked
        self.squares = _dots(self.residuals, self.residuals)
        self.predicted += steps[self.lane] * fresh[self.lane, self.sample]
        self.count += 1
        self.orders.append(np.where(sound, rows, -1))
        self.steps = steps
        self._project(masked, self.along[k])
        return lengths, overlaps

    def _project(self, masked: Array, out: Array) -> None:
        """Products (lanes, P) of what the lanes see of their new directions with every row of the basis."""
        basis = self.task.basis
        for k in range(0, len(basis), _BLOCK):
            np.matmul(masked, basis[k : k + _BLOCK].T, out=out[:, k : k + _BLOCK])

    def finished(self) -> bool:
        """Counts the error of the fold left out; true where it has risen for a good while, or nothing is left."""
        error = self.task.error(self.predicted)
        if error < min(self.errors, default=np.inf):
            self.held_out = self.predicted.copy()
        self.errors.append(error if math.isfinite(error) else np.inf)
        self._since = 0 if error < 0.99 * self._least else self._since + 1
        self._least = min(self._least, self.errors[-1])
        nothing_left = bool((self.squares <= self.floors).all())
        return nothing_left or self._since > max(_LEAST_PATIENCE, self.count // 4)

    def path(self) -> Path:
        orders = np.array(self.orders, dtype=np.intp).reshape(-1, self.every.size).T
        return Path(order=orders[0], errors=np.array(self.errors), held_out=self.held_out, without=orders[1:])


def forward_selection(task: Task) -> Path:
    """Orthogonal least squares: the row that lowers the residual most (Chen, Billings and Luo 1989).

    Correlations follow from those before by one product of the basis with the new directions of all lanes.
    """
    basis = task.basis
    most = max(min(task.most, basis.shape[0]), 1)
    lanes = _Lanes(task, most)
    least = np.maximum(_DEPENDENT * lanes.norms, 1e-300)
    left = lanes.norms.copy()  # square norms of the rows beyond the span of those taken
    correlations = lanes.residuals @ basis.T
    every = np.arange(lanes.masks.shape[0])
    closed = np.zeros_like(left, dtype=bool)
    rows = np.zeros(every.size, dtype=np.intp)
    wanted = np.ones(every.size, dtype=bool)
    for k in range(most):
        if k:
            closed |= left <= least
            scores = correlations**2 / np.maximum(left, least)
            scores[closed] = -1.0
            rows = np.argmax(scores, axis=1)
            wanted = scores[every, rows] >= 0.0
            if not wanted.any():
                break
        lanes.add(rows, wanted)
        closed[every, rows] = True
        if lanes.finished():
            break
        left -= lanes.along[k] ** 2
        correlations -= lanes.steps[:, None] * lanes.along[k]
    return lanes.path()


def least_angles(task: Task) -> Path:
    """Least-angle regression (Efron et al. 2004), for the order alone: coefficients are refitted by least squares.

    With Q R the decomposition of the active rows, normed and centred, and R'τ their signs, the equiangular direction
    is Q τ/|τ|: one more row adds one entry to τ, so that a step costs one product with the basis.
    """
    basis = task.basis
    most = max(min(task.most, basis.shape[0]), 1)
    lanes = _Lanes(task, most)
    every = np.arange(lanes.masks.shape[0])
    lanes.add(np.zeros(every.size, dtype=np.intp), np.ones(every.size, dtype=bool))
    lanes.finished()
    seen = lanes.masks.sum(axis=1)[:, None]
    squares, means = lanes.norms, lanes.masks @ basis.T / seen
    centred = squares - seen * means**2
    usable = centred > _DEPENDENT * squares
    norms = np.sqrt(np.where(usable, centred, 1.0))
    correlations = np.where(usable, lanes.residuals @ basis.T / norms, 0.0)
    floors = _ROUNDING * np.abs(correlations).max(axis=1)
    height = np.abs(correlations).max(axis=1)
    tau, along = np.zeros((every.size, most)), np.zeros_like(correlations)
    rows = np.argmax(np.abs(correlations), axis=1)
    for k in range(1, most):
        wanted = usable[every, rows] & (height > floors)
        if not wanted.any():
            break
        signs = np.where(correlations[every, rows] > 0.0, 1.0, -1.0)
        lengths, overlaps = lanes.add(rows, wanted)
        usable[every, rows] = False
        norm = norms[every, rows]
        done = signs - np.sum(overlaps[:, 1:] * tau[:, 1:k], axis=1) / norm
        tau[:, k] = np.where(lengths > 0.0, done * norm / np.where(lengths > 0.0, lengths, 1.0), 0.0)
        along += tau[:, k, None] * lanes.along[k] / norms
        if lanes.finished():
            break
        # All active rows lose correlation at the rate 1/|τ|; the first of the others to catch up enters.
        rate = 1.0 / np.maximum(np.sqrt(np.sum(tau[:, : k + 1] ** 2, axis=1)), 1e-300)
        slopes, top = along * rate[:, None], height[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            near = (top - correlations) / (rate[:, None] - slopes)
            far = (top + correlations) / (rate[:, None] + slopes)
        near[~(near > 1e-14 * top)] = np.inf
        far[~(far > 1e-14 * top)] = np.inf
        steps = np.where(usable, np.minimum(near, far), np.inf)
        rows = np.argmin(steps, axis=1)
        step = np.minimum(steps[every, rows], height / rate)
        correlations -= (step * rate)[:, None] * along
        height = height - step * rate
    return lanes.path()


def least_squares(task: Task) -> Path:
    """All terms of a set, the best of the nested sets of the basis."""
    seen = int(task.masks.sum(axis=1).min())
    sizes = [size for size in task.sizes if size <= min(task.most, seen - 1)]
    largest = max(sizes, default=1)
    predicted = np.empty((len(sizes), task.values.size))
    for mask in task.masks[1:]:
        inside, outside = mask == 1.0, mask == 0.0
        q, r = np.linalg.qr(task.basis[:largest, inside].T)
        diagonal = np.abs(np.diag(r))
        r = r + np.diag(np.where(diagonal > 1e-10 * diagonal.max(), 0.0, np.inf))
        r[~np.isfinite(r)] = 1e150  # a column that hangs on the others gets no weight
        ahead = np.linalg.solve(r.T, task.basis[:largest, outside]).T
        fitted = np.cumsum(ahead * (q.T @ task.values[inside]), axis=1)
        predicted[:, outside] = fitted[:, [size - 1 for size in sizes]].T
    errors = np.full(largest, np.inf)
    lines = [task.error(line) for line in predicted]
    errors[[size - 1 for size in sizes]] = lines
    held_out = predicted[int(np.argmin(lines))] if lines else np.zeros(task.values.size)
    return Path(order=np.arange(largest, dtype=np.intp), errors=errors, held_out=held_out)


#: name -> solver
SOLVERS: Final[dict[str, Solver]] = {
    "forward selection": forward_selection,
    "least angles": least_angles,
    "least squares": least_squares,
}


def solve_rows(rows: Array, values: Array) -> Array:
    """Least-squares coefficients (k,) of values (n,) in rows (k, n)."""
    q, r = np.linalg.qr(rows.T)
    return np.asarray(np.linalg.solve(r, q.T @ values))


# --- the error that an expansion reports ----------------------------------------------------------

#: an error above the first falls too slowly with the number of samples for K-fold to be much too large; one below
#: the second falls fast
_SLOW: Final = 1e-1
_FAST: Final = 1e-3
#: terms that come next, at most, and the least share of what is left for a second one and those after it
_NEXT: Final = 5
_FAIR: Final = 0.2
_SINGULAR: Final = 1e-10  # a direction that only the fold itself determines


@dataclass(frozen=True, kw_only=True, eq=False)
class Refits:
    """Least squares with samples left out, the terms as they are.

    `coefficients` (k,) of all samples, `without` (K, k) those without each fold, and the prediction of every sample
    without itself, `left_out` (n,).
    """

    coefficients: Array
    without: Array
    left_out: Array


def refits(rows: Array, values: Array, folds: npt.NDArray[np.intp]) -> Refits:
    """Fits of values (n,) in rows (k, n), k <= n, and without each of the folds (n,): one factorisation gives all.

    With Q R the rows and e what is left, fold g takes R⁻¹ Q_g' (1 - Q_g Q_g')⁻¹ e_g off the coefficients.
    """
    q, r = np.linalg.qr(rows.T)
    off = values - q @ (q.T @ values)
    count = int(folds.max()) + 1
    steps = np.zeros((q.shape[1], count))
    for fold in range(count):
        there = folds == fold
        inside = q[there]
        rest = np.eye(inside.shape[0]) - inside @ inside.T
        rest.flat[:: rest.shape[0] + 1] += _SINGULAR
        steps[:, fold] = inside.T @ np.linalg.solve(rest, off[there])
    solved = np.linalg.solve(r, np.column_stack([q.T @ values, steps]))
    return Refits(
        coefficients=solved[:, 0],
        without=(solved[:, :1] - solved[:, 1:]).T,
        left_out=_without_itself(q, values, off),
    )


@dataclass(frozen=True, kw_only=True)
class Neglected:
    """The terms left out that come next: the `share` of what is left at the samples that they explain, and `energy`.

    From the share is taken off what the best of as many terms explain of noise.  `energy` is the mean square, under the
    law of the inputs, of these terms with their coefficients and of what the terms kept hold of them by mistake.
    """

    share: float
    energy: float


def neglected(rows: Array, values: Array, others: Array, most: int = _NEXT) -> Neglected:
    """The most telling of `others` (m, n), rows of orthonormal terms beside those kept (k, n), k < n, for values (n,).

    One after another, at most `most`, as long as each explains a fair share of what is left.  What least squares
    leaves of the values is fitted in what it leaves of them; with c the coefficients, and b what least squares puts
    of each into the terms kept, they have c·c + |b c|² under the law.  The best of m terms leaves about
    m^(-2/(n - k)) of noise.

    >>> import numpy as np
    >>> x = np.linspace(-1.0, 1.0, 9)
    >>> found = neglected(np.ones((1, 9)), 3.0 + 0.5 * x, np.array([x**2, x]))
    >>> round(found.share, 9), round(found.energy, 9)
    (1.0, 0.25)
    """
    q, triangle = np.linalg.qr(rows.T)
    off = values - q @ (q.T @ values)
    held = q.T @ others.T
    fresh = others.T - q @ held
    first, least = float(off @ off), _SINGULAR * np.sum(others**2, axis=1)
    free, left, beyond, taken, of_noise = max(values.size - len(rows), 1), off, fresh.copy(), [], 1.0
    for step in range(min(most, len(others), free)):
        squares = np.sum(beyond**2, axis=0)
        shares = np.where(squares > least, (left @ beyond) ** 2 / np.where(squares > least, squares, 1.0), 0.0)
        best, now = int(np.argmax(shares)), float(left @ left)
        chance = len(others) ** (2.0 / max(free - step, 1))
        if not shares[best] > 0.0 or (step and 1.0 - max(1.0 - shares[best] / now, 0.0) * chance < _FAIR):
            break
        along = beyond[:, best] / math.sqrt(squares[best])
        left = left - along * float(along @ left)
        beyond -= np.outer(along, along @ beyond)
        taken.append(best)
        of_noise *= chance
    if not taken:
        return Neglected(share=0.0, energy=0.0)
    upper = np.linalg.qr(fresh[:, taken])
    coefficients = np.linalg.solve(upper[1], upper[0].T @ off)
    mistaken = np.linalg.solve(triangle, held[:, taken] @ coefficients)
    return Neglected(
        share=max(1.0 - float(left @ left) / first * of_noise, 0.0),
        energy=float(coefficients @ coefficients + mistaken @ mistaken),
    )


def left_one_out(rows: Array, values: Array) -> Array:
    """Predictions (n,) of every value by least squares in rows (k, n) without itself."""
    q, _ = np.linalg.qr(rows.T)
    return _without_itself(q, values, values - q @ (q.T @ values))


def _without_itself(q: Array, values: Array, off: Array) -> Array:
    return np.asarray(values - off / (1.0 - np.minimum((q**2).sum(axis=1), 1.0 - 1e-9)))


def steadied(squares: Array) -> float:
    """A mean of squares (n,) that no single one of them decides: m^(1 - 1/e) r^(1/e), r the mean without the largest.

    The effective number e = (Σ s)²/Σ s² is n where all are alike, and 1 where one of them is all there is.

    >>> import numpy as np
    >>> steadied(np.array([2.0, 2.0, 2.0, 2.0])), round(steadied(np.array([1e8, 1.0, 1.0, 1.0])), 6)
    (2.0, 1.000001)
    """
    mean = float(np.mean(squares))
    if squares.size < 2 or not (mean > 0.0 and math.isfinite(mean)):
        return mean
    shares = squares / (mean * squares.size)
    rest = mean * squares.size * float(np.sum(np.delete(shares, int(np.argmax(shares))))) / (squares.size - 1)
    lean = float(np.sum(shares**2))
    return math.exp((1.0 - lean) * math.log(mean) + lean * math.log(max(rest, 1e-300)))


def blended(
    folded: float, left_out: float, loose: float = 0.0, chosen: float = 0.0, *, share: float | None = None
) -> float:
    """The error reported: `folded` by K-fold, `left_out` one by one, `loose` and `chosen` over the law.

    All are over the variance: `loose` is what the coefficients are uncertain by, `chosen` the choice of terms.
    u^(1 - w) l^w, with u the largest of folded, loose and chosen, l the larger of left_out + loose and chosen, and w
    from 0, for errors of a tenth, to a half, below a thousandth, or as given in `share`; never below `loose`.
    """
    upper, lower = max(folded, loose, chosen), max(left_out + loose, chosen)
    if not (math.isfinite(upper) and math.isfinite(lower)):
        return math.inf
    if not (upper > 0.0 and lower > 0.0):
        return upper
    if share is None:
        falls = math.log(_SLOW / max(folded, 1e-300)) / math.log(_SLOW / _FAST)
        share = 0.5 * min(max(falls, 0.0), 1.0)
    return max(math.exp((1.0 - share) * math.log(upper) + share * math.log(lower)), loose)


def leaned(error: float, energy: float, share: float) -> float:
    """An error moved towards the `energy` of the next terms, the more the larger the share s that they explain.

    error^(1 - s) energy^s, and never below the energy: terms that explain all that is left are the error.

    >>> [round(leaned(1e-2, 1e-4, share), 9) for share in (0.0, 0.5, 1.0)], leaned(1e-6, 1e-4, 0.0)
    ([0.01, 0.001, 0.0001], 0.0001)
    """
    if not (energy > 0.0 and math.isfinite(error) and error > 0.0):
        return max(error, energy)
    return max(math.exp((1.0 - share) * math.log(error) + share * math.log(energy)), energy)
