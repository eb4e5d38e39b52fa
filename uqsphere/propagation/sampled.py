"""What a sample of a cheap model answers: descriptions, indices and failure probabilities.

A slow model has an object that answers the same questions (`uqsphere.propagation.slow`): analyses
ask `source_of` for the one that a run has.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import chain, combinations

import numpy as np

from uqsphere.arrays import Array, Flags, frozen
from uqsphere.results.types import IndexMethod
from uqsphere.uq import Estimate, Sample, absent, exact, from_replicates
from uqsphere.uq.describe import Description, describe_controlled, heavy_tail
from uqsphere.uq.estimate import carriers, count_bound, ratio_of_means
from uqsphere.uq.indices import sampled_indices

from . import chaos
from .design import Design
from .slow import Slow, described_rows
from .tables import Indices, Tables

#: points at which an expansion that serves as control is evaluated, for each point of the sample,
#: and at most: a sample of so many needs no control
MANY = 16
MOST_MANY = 1 << 16
METHOD = "polynomial chaos, corrected by rows"
SAMPLED = "sample"
CONTROLLED = "sample, chaos as control variate"


def source_of(design: Design, tables: Tables) -> Slow | Sampled:
    """What answers the questions of the analyses."""
    return tables.surrogate or Sampled(design=design, tables=tables)


@frozen(eq=False)
class Sampled:
    """A sample of a cheap model, with the expansions and pairs beside it."""

    design: Design
    tables: Tables
    dropped: float = 0.0
    refusal: str = ""

    @property
    def rows(self) -> Sample:
        return self.tables.sample

    def describe(self, name: str) -> Description:
        """The description of a quantity; an accurate expansion is its control variate."""
        sample = self.rows
        quantiles = self.design.study.analysis.quantiles
        if not self.design.drawn.names and sample.knows(name):
            value = exact(sample.answer(name)[0, 0])
            return Description(
                mean=value,
                sd=exact(0.0),
                quantiles=dict.fromkeys(quantiles, value),
                censored_share=exact(0.0),
                scale=0.0,
            )
        expansion = self._control(name)
        if expansion is not None:
            return describe_controlled(
                sample.answer(name)[1:],
                expansion.values,
                self.values(name)[1:],
                quantiles=quantiles,
                method=CONTROLLED,
            )
        return described_rows(self.design, sample, name, SAMPLED)

    def _control(self, name: str) -> chaos.Expansion | None:
        """The expansion of a quantity that is accurate enough to be its control variate."""
        expansion = self.tables.expansions.get(name)
        if expansion is None or self.rows.count >= MOST_MANY:
            return None
        return expansion if expansion.left + expansion.beyond < chaos.CONTROL else None

    def values(self, name: str) -> Array:
        """Values (R, n) that stand for the distribution of a quantity: of its control variate at
        the sample's points continued, `MANY` for each.
        """
        expansion = self._control(name)
        if expansion is None:
            return self.rows.answer(name)
        count = min(MANY * self.rows.count, MOST_MANY)
        return chaos.values_at(self.design, expansion)(self.design.many_normals(count))

    def probability(
        self, column: str, sampled: Estimate, chance: Callable[[Sample], Array]
    ) -> Estimate:
        """The failure probability of the sample; only a bound where too few rows carry it."""
        small = sampled.value is not None and 0.0 < sampled.value < 1e-3
        if not small or carriers(chance(self.rows)) >= 20.0:
            return sampled
        bound = max(sampled.high or 0.0, count_bound(self.rows.size))
        reason = "fewer than 20 effective samples contribute to it; only a bound is given"
        return absent(reason, sampled.method, sampled.evaluations, below=min(bound, 1.0))

    # --- indices ----------------------------------------------------------------------------------

    def index_method(self, name: str) -> IndexMethod:
        """Where the indices of a quantity come from."""
        if name in self.tables.pairs:
            return "pairs"
        return "chaos" if name in self.tables.expansions else ""

    def indices(self, name: str) -> Indices:
        """First and total indices of a quantity for independent inputs, and second ones."""
        reason = heavy_tail(self.rows.outputs(name), certain=True)
        if not reason and name in self.tables.pairs:
            return _by_pairs(self.design, self.tables.pairs[name])
        if not reason and name in self.tables.expansions:
            return by_chaos(self.design, self.tables.expansions[name])
        reason = reason or "the quantity does not vary, or has no plain value at every point"
        nothing = absent(reason, METHOD, self.rows.size)
        return dict.fromkeys(self.design.inputs, (nothing, nothing))


def by_chaos(design: Design, expansion: chaos.Expansion) -> dict[str, tuple[Estimate, ...]]:
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


def _index(
    expansion: chaos.Expansion, which: Flags, share: float, least: Array, most: Array
) -> Estimate:
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


def by_chaos_accurate(design: Design, tables: Tables, name: str) -> bool:
    """Whether the chaos indices of a quantity are as accurate as required."""
    expansion = tables.expansions.get(name)
    if expansion is None:
        # where nothing varies there is nothing to sample
        return tables.sample.knows(name) and not chaos.varies(tables.sample.answer(name))
    estimates = chain(*by_chaos(design, expansion).values())
    widest = max(estimate.half_width for estimate in estimates)
    return widest <= design.study.analysis.accuracy.sobol


def _by_pairs(design: Design, values: Array) -> dict[str, tuple[Estimate, ...]]:
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
