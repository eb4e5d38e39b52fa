"""Polynomial chaos of a run: fitted to one replicate of the sample, and held against the rows of
all others.

With the expansion f of a quantity y, r = y - f the residual at rows that it was not fitted to, and
P_u the projection onto the terms of a set of inputs u, every variance of y is

    |P_u y|² = |P_u f|² + 2 <P_u f, r> + |P_u r|²,    0 <= |P_u r|² <= |r|².

The first part is a sum of squared coefficients, the second a mean over rows, and the third is
bounded by the error of the expansion, which the same rows measure; of a single input, the means of
blocks of rows show it.  So an index from chaos has an interval that holds whatever the fit, and its
value is the middle of what the third part may be.
An expansion of ln y is taken where it leaves less than half as much: its variances are integrated,
and projected by its plain form.

No row sees the variance that an expansion makes beyond all rows, such as a polynomial of high
degree in a tail.  What it may miss there is part of every interval (`moments_beyond`).
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from itertools import combinations

import numpy as np

from uqsphere.arrays import Array, Flags, Values, bundle
from uqsphere.uq import Estimate, Sample, from_replicates
from uqsphere.uq.chaos.basis import germ_points
from uqsphere.uq.chaos.beyond import moments_beyond
from uqsphere.uq.chaos.expansion import Chaos, Integrals
from uqsphere.uq.chaos.fit import fit_chaos
from uqsphere.uq.corrected import block_parts
from uqsphere.uq.estimate import ratio_of_means, spread, student
from uqsphere.uq.response import GOOD, REJECTED

from .design import Design

#: rows that an expansion is fitted to at most: more buy nothing on outputs with kinks, and smooth
#: ones need fewer
MOST_ROWS = 512
#: rows of a replicate that correct its indices at most
MOST_TERMS = 2048
#: share of the variance that an expansion may leave and still have a design point searched on it,
#: and serve as control variate: what it leaves more than that costs the tails as much as it gains
#: (granite, p_max against contact_duration)
MOST_LEFT, CONTROL = 0.05, 1e-3
METHOD = "polynomial chaos, corrected by rows"
#: first and total index by input, and second ones by "input,input"
Indices = Mapping[str, tuple[Estimate, ...]]


@bundle
class Expansion:
    """An expansion of one quantity with what the rows that it was not fitted to say of it.

    fit : the expansion, of the quantity or its logarithm, in the germs of the inputs; it was fitted
        to rows of the first replicate
    values : its values (R-1, n) at the rows of all other replicates
    residuals : (R-1, m) what it leaves of the first m of these rows
    cross : (R-1, T) means of the products of these with the terms of its plain form
    explained : (2, R-1, d) what each input explains of the mean square of the residuals, at least
        and at most
    left : share of the variance that it leaves, of all rows it was not fitted to
    beyond : share of its variance that may be wrong where an input lies beyond all rows
    """

    fit: Chaos
    values: Array
    residuals: Array
    cross: Array
    explained: Array
    left: float
    beyond: float

    @cached_property
    def variances(self) -> Values:
        """Variances (R-1,) of the quantity: of the expansion, corrected by the rows."""
        rest = self.residuals - self.residuals.mean()
        off = self.values[:, : rest.shape[1]] - self.fit.integrals.mean
        return self.fit.integrals.sd**2 + (rest * (2.0 * off + rest)).mean(axis=1)

    @property
    def moments(self) -> Integrals:
        """Moments of the expansion, with errors that allow for what may be wrong beyond all rows:
        the mean by no more than the share of the tails and its square allow (Cauchy and Schwarz).
        """
        tails = 2.0 * len(self.fit.germs) / self.residuals.size
        return self.fit.integrals.allowing(math.sqrt(self.beyond * tails), self.beyond)


def expansions(
    design: Design, sample: Sample, before: Mapping[str, Expansion]
) -> dict[str, Expansion]:
    """Expansions of the columns whose rows all have a plain value, in the independent germs of the
    inputs.

    One that was fitted to as many rows before, or leaves next to nothing, is not fitted again.
    """
    count = sample.count
    few = min(count, MOST_TERMS)
    points = points_of(design, sample.scores)
    fits = {}
    for name in design.described:
        outputs = sample.answer(name)
        if not sample.knows(name) or not varies(outputs):
            continue
        rows = min(count, MOST_ROWS)
        earlier = before.get(name)
        if earlier and (earlier.fit.samples == rows or earlier.left < GOOD):
            fit = earlier.fit
            values = fit.predict(points[1:])
            left = _left(outputs, values)
        else:
            fit, values, left = _fitted(design, points, outputs, rows)
        form = fit.plain_form
        rest = (outputs[1:] - values)[:, :few]
        terms = form.rows(np.concatenate(points[1:, :few]))
        wrong = _made_without_rows(fit, values, left)
        if not wrong < GOOD * CONTROL:
            continue
        seen = points[1:, :few]
        near = seen[:, :MOST_ROWS].reshape(-1, points.shape[2])
        _, tails = moments_beyond(
            fit,
            near,
            rest[:, :MOST_ROWS].ravel(),
            reach=np.array([seen.min(axis=(0, 1)), seen.max(axis=(0, 1))]),
            others=points[0],
        )
        fits[name] = Expansion(
            fit=fit,
            values=values,
            residuals=rest,
            cross=np.vecdot(terms.reshape(-1, *rest.shape), rest).T / few,
            explained=_explained(seen, rest),
            left=left,
            beyond=wrong + float(tails.sum()),
        )
    return fits


def _fitted(design: Design, points: Array, outputs: Array, rows: int) -> tuple[Chaos, Array, float]:
    """The expansion that is fitted to so many rows of the first replicate of outputs (R, n) at germ
    points (R, n, d), its values at those of the others, and the share of the variance that it
    leaves of them.
    """
    tried = []
    for plain in (True, False):
        fit = fit_chaos(points[0, :rows], outputs[0, :rows], design.germs, plain=plain)
        values = fit.predict(points[1:])
        tried.append((fit, values, _left(outputs, values)))
        if tried[0][2] <= GOOD or design.analysis.second_order:
            break
    plain_fit, other = tried[0], tried[-1]
    if other[0].log and other[2] < 0.5 * plain_fit[2]:
        return other
    return plain_fit


def varies(outputs: Array) -> bool:
    """Whether outputs (R, n) have a scatter beyond their rounding."""
    return bool(outputs.std() > 1e-12 * abs(outputs).max())


def _explained(points: Array, residuals: Array) -> Array:
    """What each input explains of residuals (R, m) at least and at most, (2, R, d), for germ points
    (R, m, d) of replicates.
    """
    parts = np.empty((2, *points[:, 0].shape))
    for r, (rows, rest) in enumerate(zip(points, residuals, strict=True)):
        for j, column in enumerate(rows.T):
            parts[:, r, j] = [part.mean() for part in block_parts(column, rest)[:2]]
    least, squares = parts
    # neighbours of one replicate have other inputs far apart, those of two are independent
    order = np.argsort(points, axis=1, kind="stable")
    ordered = np.take_along_axis(residuals[:, :, None], order, axis=1)
    neighbours = (ordered * np.roll(ordered, 1, axis=0)).mean(axis=1)
    larger = neighbours.mean(axis=0) > squares.mean(axis=0)
    return np.stack([least, np.where(larger, neighbours, squares)])


def _made_without_rows(fit: Chaos, values: Array, left: float) -> float:
    """Share of the variance of an expansion that it makes where no row lies, as far as it may be
    wrong there: 0 where the rows do not contradict its variance.

    Of an output with a heavy tail the rows may lack much of the variance: what of it is in doubt is
    what the expansion leaves.
    """
    moments = fit.integrals
    if not moments.sd > 0.0:
        return 0.0
    # over the variance of the expansion
    squares = (((values - moments.mean) / moments.sd) ** 2).mean(axis=1)
    missing = abs(1.0 - squares.mean())
    if missing <= student(len(squares), REJECTED) * spread(squares) + 1e-9 + 4.0 * moments.error:
        return 0.0
    doubt = math.sqrt(left)
    return float(missing * min(2.0 * doubt + doubt**2, 1.0))


def _left(outputs: Array, values: Array) -> float:
    """Share of the variance of the last R - 1 replicates of outputs (R, n) that values (R-1, n)
    leave; infinite for an expansion that runs away.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        left = float((outputs[1:] - values).var() / outputs[1:].var())
    if math.isnan(left):
        return math.inf
    return left


def points_of(design: Design, normals: Array) -> Array:
    """Germ points (..., d) of the inputs at independent normals (..., D) of all variables, of which
    they are the first."""
    return germ_points(normals[..., : len(design.germs)], design.germs)


def values_at(design: Design, expansion: Expansion, normals: Array) -> Array:
    """Values of an expansion at independent normals (..., D)."""
    return expansion.fit.predict(points_of(design, normals))


# --- Sobol' indices -------------------------------------------------------------------------------


def by_chaos(design: Design, expansion: Expansion) -> Indices:
    """Indices of an expansion, corrected by the rows that it was not fitted to."""
    form = expansion.fit.plain_form
    integrals = expansion.fit.integrals
    alone, active = form.parts
    everything = (expansion.residuals**2).mean(axis=1)
    indices = dict[str, tuple[Estimate, ...]]()
    for k, name in enumerate(design.inputs):
        least, most = expansion.explained[:, :, k]
        first = _index(expansion, alone[:, k], integrals.shares[0, k], least, most)
        least = np.clip(least, 0.0, everything)
        total = _index(expansion, active[:, k], integrals.shares[1, k], least, everything)
        if first.value is not None and total.value is not None and total.value < first.value:
            # a total index is no smaller: the difference is noise of the correction
            total = replace(total, value=min(first.value, total.high or 0.0))
        indices[name] = first, total
    if not design.analysis.second_order:
        return indices
    for (i, one), (j, other) in combinations(enumerate(design.inputs), 2):
        which = active[:, i] & active[:, j] & (active.sum(axis=1) == 2)
        share = 0.0
        if integrals.sd > 0.0:
            share = (form.coefficients[which] ** 2).sum() / integrals.sd**2
        second = _index(expansion, which, share, np.zeros_like(everything), everything)
        indices[f"{one},{other}"] = (second,)
    return indices


def _index(expansion: Expansion, which: Flags, share: float, least: Array, most: Array) -> Estimate:
    """One index: that of some terms (T,) of the expansion with their share of its variance, and
    what its residuals have of the index, `least` to `most` (R-1,).  The value is the middle of
    both.
    """
    # of the expansion's own part and its product with the residuals, before what is left is added
    coefficients = expansion.fit.plain_form.coefficients[which]
    own = share * expansion.fit.integrals.sd**2
    numerators = own + 2.0 * expansion.cross[:, which] @ coefficients
    ends = []
    for rest in (least, most):
        ratio, off = ratio_of_means(numerators + rest, expansion.variances)
        end = from_replicates(ratio + off, METHOD, expansion.residuals.size, float(ratio))
        if end.value is None or end.low is None or end.high is None:
            return end
        ends.append((end.value, end.low, end.high))
    values, lows, highs = np.transpose(ends)
    error = expansion.fit.integrals.error + expansion.beyond
    low = np.clip(lows.min() - error, 0.0, 1.0)
    high = np.clip(highs.max() + error, low, 1.0)
    return replace(end, value=np.clip(values.mean(), low, high)).spanning(low, high)
