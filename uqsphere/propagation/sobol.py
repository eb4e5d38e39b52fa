"""Sobol' indices of a sample of a cheap model: by its expansions, which its rows correct, and by
pairs of runs.
"""

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations
from typing import TypeAlias

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.uq import Estimate, absent, from_replicates
from uqsphere.uq.estimate import ratio_of_means
from uqsphere.uq.indices import sampled_indices

from .chaos import Expansion
from .design import Design

METHOD = "polynomial chaos, corrected by rows"
#: first and total index by input, and second ones by "input,input"
Indices: TypeAlias = Mapping[str, tuple[Estimate, ...]]


def by_chaos(design: Design, expansion: Expansion) -> Indices:
    """Indices of an expansion, corrected by the rows that it was not fitted to."""
    form = expansion.fit.plain_form
    integrals = expansion.integrals
    active = form.multi_indices > 0
    many = active.sum(axis=1)
    everything = (expansion.residuals**2).mean(axis=1)
    indices = dict[str, tuple[Estimate, ...]]()
    for k, name in enumerate(design.inputs):
        least, most = expansion.explained[:, :, k]
        alone = active[:, k] & (many == 1)
        first = _index(expansion, alone, integrals.first[k], least, most)
        least = np.clip(least, 0.0, everything)
        total = _index(expansion, active[:, k], integrals.total[k], least, everything)
        if first.value is not None and total.value is not None and total.value < first.value:
            # a total index is no smaller: the difference is noise of the correction
            total = replace(total, value=min(first.value, total.high or 1.0))
        indices[name] = first, total
    if not design.study.analysis.second_order:
        return indices
    for (i, one), (j, other) in combinations(enumerate(design.inputs), 2):
        which = active[:, i] & active[:, j] & (many == 2)
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
    numerators, variances = expansion.projection(which, share)
    ends = []
    for rest in (least, most):
        ratio, off = ratio_of_means(numerators + rest, variances)
        end = from_replicates(ratio + off, METHOD, expansion.residuals.size, float(ratio))
        if end.value is None or end.low is None or end.high is None:
            return end
        ends.append((end.value, end.low, end.high))
    values, lows, highs = np.transpose(ends)
    error = expansion.integrals.error + expansion.beyond
    low = np.clip(lows.min() - error, 0.0, 1.0)
    high = np.clip(highs.max() + error, low, 1.0)
    value = np.clip(values.mean(), low, high)
    return replace(end, value=value).spanning(low, high)


def by_pairs(design: Design, values: Array) -> Indices:
    """Indices of pairs (R, n, blocks); points of which any run has no value are left out."""
    whole = np.asarray(np.isfinite(values).all(axis=2))
    names = design.inputs
    least = whole.sum(axis=1).min()
    if least < 2:
        nothing = absent("too few pairs without a failure", "pairs of runs", values.size)
        return dict.fromkeys(names, (nothing, nothing))
    kept = [rows[answered][:least] for rows, answered in zip(values, whole, strict=True)]
    sampled = sampled_indices(np.stack(kept), design.blocks)
    text = ""
    if not whole.all():
        text = f"; of the {100.0 * whole.mean():.3g} % of pairs that answered"
    first, total = (
        [replace(index, method=index.method + text) for index in order]
        for order in (sampled.first, sampled.total)
    )
    indices = dict[str, tuple[Estimate, ...]](
        zip(names, zip(first, total, strict=True), strict=True)
    )
    return indices | {f"{names[i]},{names[j]}": (e,) for (i, j), e in sampled.second.items()}
