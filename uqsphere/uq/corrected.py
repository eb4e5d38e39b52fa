"""Answers of a slow model from its rows and the expansions that are cross-fitted to them.

For every function g of the output, with f_k the expansion without fold k,

    E[g(y)] = mean over k of E_table[g(f_k)] + E_rows[g(y) - g(f)]                             (1)

holds whatever the expansions are, since none has seen the row that it is compared with (the
difference estimator; cross-prediction-powered inference, Zrnic and Candes, PNAS 121, 2024).  Value
and interval of every answer come from (1): from what each row moves the answer by (its influence),
and from the points and the folds of the table.

    mean         y - f
    sd           ((y - m)^2 - (f - m)^2)/(2 s)
    P(y <= t)    1(y <= t) - 1(f <= t)
    quantile     where the interval of P(y <= t) crosses p (Woodruff, J. Amer. Statist. Assoc. 47,
                 1952, 635)
    index        (2 r P_j - S_j ((y - m)^2 - (f - m)^2))/V,    r = y - f

Where no row changes sides of t, its variance is not zero: it is at least E|1(f + r <= t) - 1(f <=
t)|, the share of the law that residuals r like those of the rows would move across t.  Nor is that
of rows that failed where all of them are on one side: it is at least P (1 - P).

Answers are of the rows that answer.  Where l rows of n + l fail, E_table has points like them as
well: what expansions predict at these rows is taken away from it.

    E[g(y)] = (E_table[g(f)] - E_all rows[g(f)] + E_all rows[g(y), 0 if failed])/(n/(n + l))   (2)

An event that none of n rows shows, rarer than `count_bound`, about 3/n, is not in (1).
Probabilities and quantiles have a second interval that allows for it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from uqsphere.arrays import Array, Duo, Pair, Values, bundle

from .describe import Description, heavy_tail, rising
from .estimate import (
    Estimate,
    absent,
    bounded,
    count_bound,
    distances,
    fold_spread,
    nearest_of,
    spread,
    spreads,
    student,
    takes_few_values,
)
from .response import FOLDS, METHOD, Response, unseen

#: residuals at which a change of sides is computed, and values of the output at which the
#: distribution function is: its steps are part of a quantile's interval, and 1 in 2,048 is as wide
#: as that of good expansions at 1 %
NODES, PLACES = 17, 8192
#: share of the variance: expansions that leave more than they explain tell less of an index than
#: rows in blocks
HALF = 0.5


@bundle
class Corrected:
    """The outputs of rows beside the predictions of expansions that have not seen them, and the
    predictions at many points of the law.

    response : the cross-fitted expansions
    table : (R, m) predictions at points of the law, as of `Response.table`
    lost : (K, l) predictions of all folds for rows that failed, and were left out
    """

    response: Response
    table: Array
    lost: Array

    @property
    def runs(self) -> int:
        """Rows of the model."""
        return self.response.count

    @property
    def failed(self) -> int:
        """Rows that were left out."""
        return len(self.lost.T)

    @property
    def method(self) -> str:
        return f"{METHOD}; {unseen(self.runs)}"

    @property
    def _odds(self) -> float:
        return self.failed / self.runs

    # --- moments ----------------------------------------------------------------------------------

    def _table_moment(self, power: int, centre: float = 0.0) -> tuple[Array, float]:
        """E_table[(f_k - centre)^power] (K,) of every fold, power 1 or 2, and the half-width of
        their mean: by the integrals of the expansions where these are more accurate than the table.
        """
        replicates = ((self.table - centre) ** power).mean(axis=1)
        half = student(len(replicates)) * spread(replicates)
        table = replicates.reshape(-1, FOLDS).mean(axis=0)
        if any(fold.reach for fold in self.response.folds):
            return table, half
        response = self.response
        beyond = np.linalg.norm(response.beyond, axis=1).tolist()
        integrals = response.integrals
        values = np.array([each.mean - centre for each in integrals])
        if power == 2:
            values = values**2 + [each.sd**2 for each in integrals]
        # all of them are integrated at the same points
        errors = [
            (each.moment_errors[power - 1], each.allowing(*beyond).moment_errors[power - 1])
            for each in integrals
        ]
        error, allowed = np.mean(errors, axis=0).tolist()
        if error < half:
            return values, allowed
        # points of the table lie beyond all rows as well
        return table, half + allowed - error

    def mean(self) -> Estimate:
        """The mean by (1)."""
        levels, sampling = self._table_moment(1)
        centre = levels.mean()
        influence = of_answered(centre, self.response.residuals, self.lost.mean(axis=0))
        corrected = centre + influence.mean()
        ends = _ends(corrected, influence, sampling)
        return self._estimate(_settled(np.median(levels), corrected, *ends), *ends)

    def _estimate(self, value: Values, low: float, high: float) -> Estimate:
        """An estimate held between its ends; absent where one is not finite."""
        value = min(max(float(value), low), high)
        return bounded(value, low, high, 0.25 * (high - low), self.method, self.runs)

    def sd(self) -> Estimate:
        """The standard deviation by (1), or of the rows alone where these know it better.

        The upper end is open where the tail may be too heavy for a variance.
        """
        outputs = self.response.outputs
        if not np.ptp(outputs):  # nothing but the rounding of a sum
            return self._estimate(0.0, 0.0, 0.0)
        centre = self._table_moment(1)[0].mean()
        centre += of_answered(centre, self.response.residuals, self.lost.mean(axis=0)).mean()
        influence = (outputs - centre) ** 2 - (self.response.levels - centre) ** 2
        squares, sampling = self._table_moment(2, centre)
        lost = ((self.lost - centre) ** 2).mean(axis=0)
        influence = of_answered(squares.mean(), influence, lost)
        corrected = squares.mean() + influence.mean()
        ends = _ends(corrected, influence, math.hypot(sampling, fold_spread(squares)))
        value = _settled(np.median(squares), corrected, *ends)
        rows = (outputs - outputs.mean()) ** 2
        alone = _ends(rows.mean(), rows)
        if alone[1] - alone[0] < ends[1] - ends[0] or corrected <= 0.0:
            value = rows.mean()
            ends = alone
        estimate = self._estimate(*np.sqrt(np.maximum([value, *ends], 0.0)))
        reason = heavy_tail(self.table) or heavy_tail(outputs, certain=True)
        if reason and estimate.value is not None:
            return replace(estimate, high=None, reason=reason)
        return estimate

    # --- probabilities and quantiles --------------------------------------------------------------

    def probability(
        self, *, rows: Array, left_out: Array, lost: Array, table: Callable[[float], Array]
    ) -> Estimate:
        """The mean of probabilities g(y) in [0, 1], such as 1(y > t), by (1).

        Parameters
        ----------
        rows, left_out : (n,) g of the outputs of all rows, and of their predictions
        lost : (l,) g of the predictions of rows that failed
        table : g (R, m) of the predictions of the table, where a residual is added to all of them
        """
        predicted = table(0.0)
        nodes, weights = nodes_of(self.response.residuals)
        changes = [np.mean((table(node) - predicted) ** 2) for node in nodes]
        cell = 0.0
        if np.isin(predicted, (0.0, 1.0)).all():
            cell = 1.0 / predicted.shape[1]  # a replicate knows what it counts to one cell
        value, low, high = map(
            float,
            corrected_probability(
                predicted.mean(axis=1),
                rows - left_out,
                lost,
                odds=self._odds,
                expected=float(weights @ changes),
                cell=cell,
            ),
        )
        missed = count_bound(self.runs, self.failed)
        least = max(low - missed, 0.0)
        most = min(high + missed, 1.0)
        if not 0.0 < value < 1.0 or (rows.sum() < 1e-3 and high * predicted.size < 3.0):
            reason = f"too small for {self.runs} runs: {unseen(self.runs)}"
            return replace(absent(reason, self.method, self.runs), low=least, high=most)
        estimate = self._estimate(value, low, high)
        return replace(estimate, low_unseen=least, high_unseen=most)

    @cached_property
    def _few_values(self) -> bool:
        """Whether the output takes few different values, such as numbers of something."""
        return takes_few_values(np.sort(self.response.outputs))

    @cached_property
    def _predicted(self) -> tuple[Array, Array, Array]:
        """Predictions (R, m) of the table, (n,) of the rows and (K, l) of those that failed: of an
        output with few values the nearest of those that a fold has seen.
        """
        table, levels, lost = self.table.copy(), self.response.levels.copy(), self.lost.copy()
        if self._few_values:
            for k in range(FOLDS):
                left_out = self.response.fold == k
                values = np.unique(self.response.outputs[~left_out])
                levels[left_out] = nearest_of(values, values, levels[left_out])
                table[k::FOLDS] = nearest_of(values, values, table[k::FOLDS])
                lost[k] = nearest_of(values, values, lost[k])
        return table, levels, lost

    @cached_property
    def _distribution(self) -> tuple[Array, Array, Array, Array]:
        """Places (g,), and P(y <= place) with both ends (g,) of its interval, all rising."""
        predicted, levels, lost = self._predicted
        pooled = np.sort(predicted, axis=None)
        outputs = self.response.outputs
        step = max(len(pooled) // PLACES, 1)
        # not at the rows and at their predictions: between the two a row would count, however close
        ends = [outputs.min(), outputs.max()]
        places = np.unique(np.concatenate([pooled[::step], pooled[-1:], ends])) + 0.0  # no -0.0

        def below(values: Array, shift: float = 0.0) -> Array:
            return np.searchsorted(values, places - shift, side="right") / max(len(values), 1)

        expected = sum(
            weight * np.abs(below(pooled, node) - below(pooled))
            for node, weight in zip(*nodes_of(outputs - levels), strict=True)
        )
        table = np.array([below(np.sort(values)) for values in predicted])
        # rows are many and places too: what they move a place by is counted, not listed
        lower, upper = np.sort(np.sort([outputs, levels], axis=0))
        correction = below(np.sort(outputs)) - below(np.sort(levels))
        # the rows that failed as in `of_answered`
        level, of_lost = table.mean(axis=0), below(np.sort(lost, axis=None))
        correction += self._odds * (level - of_lost)
        answer = level + correction
        squares = answer**2 + of_lost * (1.0 - 2.0 * answer)
        squares = below(lower) - below(upper) + self._odds * squares
        variance = (squares - (1.0 + self._odds) * correction**2) * self.runs / (self.runs - 1)
        expected += self._odds * answer * (1.0 - answer)
        value, low, high = _corrected(
            table,
            correction,
            np.maximum(variance, expected) / self.runs,
            runs=self.runs,
            cell=1.0 / predicted.shape[1],
        )
        value = np.mean(rising(value), axis=0)
        return places, value, np.minimum(rising(low)[0], value), np.maximum(rising(high)[1], value)

    def quantile(self, p: float) -> Estimate:
        """The quantile at p: where the distribution function of (1) reaches it."""
        places, value, low, high = self._distribution

        def above(levels: Array) -> float:
            # the place itself: the output may be this value with a probability
            return float(np.append(places, math.inf)[np.searchsorted(levels, p - 1e-12)])

        def below(levels: Array) -> float:
            if self._few_values:
                return above(levels)
            # between two places the whole of the step may be anywhere
            last = int(np.searchsorted(levels, p - 1e-12)) - 1
            return float(places[max(last, 0)])

        at = above(value)
        if not self._few_values:
            at = float(np.interp(p, value, places))
        missed = count_bound(self.runs, self.failed)
        upper = max(above(low), at)
        if math.isinf(upper) or (p <= high[0] and not self._few_values):
            reason = f"{self.runs} runs are too few to estimate the {p:g} quantile"
            return absent(reason, self.method, self.runs)
        outer = min(below(high + missed), at)
        if p <= high[0] + missed:
            outer = -math.inf
        estimate = self._estimate(at, min(below(high), at), upper)
        return replace(estimate, low_unseen=outer, high_unseen=max(above(low - missed), at))

    def describe(self, quantiles: Sequence[float]) -> Description:
        """Mean, standard deviation and quantiles."""
        sd = self.sd()
        return Description(
            mean=self.mean(),
            sd=sd,
            quantiles={p: self.quantile(p) for p in quantiles},
            scale=sd.value or self.response.outputs.std(),
        )


def nodes_of(residuals: Array) -> Pair:
    """Values of residuals (n,), and the share of the rows that each of them stands for."""
    nodes = np.unique(np.quantile(residuals, np.linspace(0.0, 1.0, NODES)))
    # a row between two nodes stands for both, the more for the one that is nearer
    shares = [np.interp(residuals, nodes, hat).mean() for hat in np.eye(nodes.size)]
    return nodes, np.array(shares)


def _ends(value: float, influence: Array, sampling: float = 0.0) -> Duo:
    """Ends of the interval about a value that rows move by influences (n,) and points of the law by
    a half-width.
    """
    down, up = distances(influence)
    return value - math.hypot(down, sampling), value + math.hypot(up, sampling)


def _settled(expanded: Values, corrected: Values, low: Values, high: Values) -> Values:
    """What the expansions give wherever the interval of (1) holds it, and what (1) gives elsewhere:
    a correction that noise could make by itself adds little but that noise.

    expanded : of means over folds the median: a fold that runs away does not count
    """
    return np.where((low <= expanded) & (expanded <= high), expanded, corrected)


def of_answered(level: Values, influence: Array, lost: Array) -> Array:
    """What each of all rows (n + l,) moves the answer of those that answered by, (2); the mean is
    what the answer differs by from the level, E_table[g(f)].

    influence : (n,) of the rows that answered, by (1)
    lost : (l,) g as predicted for those that failed
    """
    runs = len(influence)
    shift = (influence.sum() + (level - lost).sum()) / runs
    every = np.append(influence, level + shift - lost)
    return np.asarray(every + (every - every.mean()) * (len(lost) / runs))


def corrected_probability(
    table: Array, influence: Array, lost: Array, *, odds: float, expected: float, cell: float
) -> tuple[Array, Array, Array]:
    """Value and ends of a probability: that of the replicates of the table (R,), known to a cell,
    corrected by influences (n,) of rows that answered, and by what is predicted for others (l,).

    odds : how many rows fail for one that answers
    expected : variance that residuals like those of the rows make
    """
    level = table.mean()
    influence = of_answered(level, influence, lost)
    correction = influence.mean()
    answer = level + correction
    expected = (expected + odds * answer * (1.0 - answer)) * (1.0 + odds)
    n = len(influence)
    noise = np.maximum(influence.var(ddof=1), expected) / n
    return _corrected(table, correction, noise, runs=n, cell=cell)


def _corrected(
    table: Array, correction: Values, noise: Values, *, runs: int, cell: Values
) -> tuple[Array, Array, Array]:
    """The same by corrections (...) of so many runs, with their variances (...)."""
    expanded = table.mean(axis=0)
    corrected = expanded + correction
    sampling = student(len(table)) * spreads(table, cell)
    half = np.hypot(student(runs) * np.sqrt(noise), sampling)
    low, high = np.clip(corrected + np.array([-half, half]), 0.0, 1.0)
    return np.clip(_settled(expanded, corrected, low, high), low, high), low, high


# --- Sobol' indices -------------------------------------------------------------------------------


def indices_of(response: Response) -> dict[str, list[Estimate]]:
    """First and total indices {"first": [...], "total": [...]} of the model, one for each input.

    With P_j the part of an input in the expansion f, V_f and S_f its variance and index, r = y - f
    and m the mean, an index is

        S_j = E[S_f V_f + 2 r P_j + |P_j r|^2] / E[V_f + 2 r (f - m) + r^2]

    of all rows, each with its own fold (`_row_parts`); `_rests` has the last part of the numerator.
    The value is the median of the folds' S_f wherever the interval holds it.  Where expansions
    leave more of the variance than they explain f is the mean.  Where the variance of the rows may
    be infinite, every interval is from 0 to 1.
    """
    y = response.outputs
    n = response.count
    folds = response.trusted if response.error < HALF else ()
    method = f"{METHOD if folds else 'rows in blocks'}; {unseen(n)}"
    if not np.ptp(y) > 1e-14 * abs(y).max():
        reason = "the output does not vary with the inputs"
        nothing = [absent(reason, method, n)] * len(response.germs)
        return {"first": nothing, "total": nothing}
    rows = _row_parts(response, folds)
    whole = rows.bottom.mean()
    least, most, error, likely = _rests(rows)
    values = rows.top.mean(axis=2) / whole
    influences = (rows.top - values[:, :, None] * rows.bottom) / whole
    reach = np.apply_along_axis(distances, 2, influences)
    further = np.hypot(np.hypot(fold_spread(rows.shares), error), rows.rounding)
    if folds:
        further = np.hypot(further, _of_tails(response.beyond[1], np.median(rows.shares, axis=0)))
    reach = np.hypot(reach, further[:, :, None])
    lows = np.clip(values + least - reach[:, :, 0], 0.0, 1.0)
    highs = np.clip(values + most + reach[:, :, 1], 0.0, 1.0)
    reasons = [heavy_tail(y, certain=True)] * 2
    if reasons[0]:
        lows[:] = 0.0
        highs[:] = 1.0
    best = values + likely
    if folds:
        best = _settled(np.median(rows.shares, axis=0), best, lows, highs)
    if not response.usable:
        # what changes from a row to its neighbours is in no block
        highs[0] = np.maximum(highs[0], highs[1])
    if not folds:
        # no less than the first index, and at most what the others leave; in between the median of
        # the expansions, which contradict each other
        lows[1] = lows[0]
        highs[1] = np.clip(1.0 - (lows[0].sum() - lows[0]), lows[0], 1.0)
        best[1] = math.nan
        if response.error < 1.0:
            best[1] = np.median([moments.shares[1] for moments in response.integrals], axis=0)
        reasons[1] = "bounded by the first indices"
    orders = {}
    columns = np.stack([np.clip(best, lows, highs), lows, highs], axis=2).tolist()
    for order, ends, reason in zip(("first", "total"), columns, reasons, strict=True):
        orders[order] = [
            replace(
                bounded(value, low, high, 0.25 * (high - low), method, n),
                low=low,
                high=high,
                reason=reason or None,
            )
            for value, low, high in ends
        ]
    return orders


def _of_tails(beyond: Values, shares: Array) -> Array:
    """What first and total indices, `shares` (2, d), may be off by where shares (d,) of the
    variance may be wrong in the tails of single inputs.

    What is wrong in the tail of its own input is all in a total index, and any part of it in a
    first one; that of the others is any part of a total index, and none of a first one.
    """
    others = np.sqrt(np.maximum((beyond**2).sum() - beyond**2, 0.0))
    any_part = np.maximum(shares, 1.0 - shares)
    first = np.hypot(any_part[0] * beyond, shares[0] * others)
    total = np.hypot((1.0 - shares[1]) * beyond, any_part[1] * others)
    return np.stack([first, total])


@bundle
class _RowParts:
    """What n rows add to the indices of d inputs, in units of the expansions' standard deviation.

    points : (n, d) of the germs
    top : (2, d, n) S_f V_f + 2 r P_j of the first and of the total indices
    bottom : (n,) V_f + 2 r (f - m) + r^2
    residuals : (n,) r
    shares : (K, 2, d) S_f of each fold
    rounding : error of the mean of the S_f
    """

    points: Array
    top: Array
    bottom: Array
    residuals: Array
    shares: Array
    rounding: float


def _row_parts(response: Response, folds: Sequence[int]) -> _RowParts:
    """The parts of the rows of some folds; without folds of all rows, about their mean."""
    y = response.outputs
    d = len(response.germs)
    residuals = (y - y.mean()) / y.std()
    top = np.zeros((2, d, response.count))
    bottom = residuals**2
    shares = np.zeros((max(len(folds), 2), 2, d))
    rounding = 1e-15
    for place, k in enumerate(folds):
        there = response.fold == k
        moments = response.integrals[k]
        unit = moments.sd or 1.0
        shares[place] = moments.shares
        # all of them are integrated at the same points
        rounding += moments.error / len(folds)
        residuals[there] = response.residuals[there] / unit
        parts = response.folds[k].fit.projections(response.points[there]) / unit
        top[:, :, there] = shares[place][:, :, None] + 2.0 * residuals[there] * parts
        level = (response.levels[there] - moments.mean) / unit
        bottom[there] = 1.0 + 2.0 * residuals[there] * level + residuals[there] ** 2
    used = np.isin(response.fold, folds or range(FOLDS))
    return _RowParts(
        points=response.points[used],
        top=top[:, :, used],
        bottom=bottom[used],
        residuals=residuals[used],
        shares=shares,
        rounding=rounding,
    )


def _rests(rows: _RowParts) -> Array:
    """What the residuals add to the first and the total indices (4, 2, d): the least, the most, the
    half-width of these, and what is likeliest.

    To the first ones the parts of `block_parts`; to the total ones between that and all of r^2: the
    middle of the former, and as much of r^2 as S_f is of the expansion, are likeliest.
    """
    squares = rows.residuals**2
    whole = rows.bottom.mean()
    left = squares.mean() / whole
    rests = np.zeros((4, *rows.top.shape[:2]))
    for j, column in enumerate(rows.points.T):
        blocks = block_parts(column, rows.residuals)
        low, *larger = (part.mean() / whole for part in blocks)
        half = max(distances(part)[1] for part in blocks) / whole
        rests[:, 0, j] = low, max(larger), half, 0.5 * (low + max(larger))
    rests[1, 1] = min(left + distances(squares)[1] / whole, 1.0)
    rests[3, 1] = np.median(rows.shares, axis=0)[1] * left
    return rests


def block_parts(column: Array, residual: Array) -> tuple[Array, Array, Array]:
    """What an input (n,) explains of the mean square of residuals (n,): of each block (about
    sqrt(n),) the mean product of different rows and the square of the mean, and the products of
    neighbours (n // 2,).

    The rows are cut into blocks in the order of the input.  The products have the mean E[E[r |
    x]^2] where the other inputs are random; where these are stratified, as in a quasi-random
    design, the square of the block's mean has it.  What changes sign within a block is only seen by
    neighbours.
    """
    n = len(column)
    edges = np.linspace(0, n, round(math.sqrt(n)) + 1).astype(int)
    counts = np.diff(edges)
    ordered = residual[np.argsort(column, kind="stable")]
    means = np.add.reduceat(ordered, edges[:-1]) / counts
    second = np.add.reduceat(ordered**2, edges[:-1]) / counts
    neighbours = ordered[: n - 1 : 2] * ordered[1::2]
    return (counts * means**2 - second) / (counts - 1), means**2, neighbours
