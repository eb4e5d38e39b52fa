"""Distributions of the quantities: mean, standard deviation, quantiles, density, and the share
beyond the record.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from uqsphere.arrays import Array
from uqsphere.propagation import chaos, surrogate
from uqsphere.propagation.design import Design
from uqsphere.propagation.tables import Tables
from uqsphere.quantities import lookup
from uqsphere.results import Answers
from uqsphere.uq import exact
from uqsphere.uq.describe import Description, describe, describe_controlled

#: points at which an expansion that serves as control is evaluated, for each point of the sample,
#: and at most: a sample of so many needs no control
MANY, MOST_MANY = 16, 1 << 16
SAMPLED = "sample"
CONTROLLED = "sample, chaos as control variate"


def distributions(design: Design, tables: Tables) -> Answers:
    """Mean, standard deviation, quantiles and censored share of every quantity."""
    answers = Answers()
    runs = tables.sample.size if design.drawn.names else 1
    for name in design.described:
        found = described(design, tables, name)
        unit = lookup(name).unit
        answers.add(name, "mean", "", found.mean, unit=unit, runs=runs)
        answers.add(name, "sd", "", found.sd, unit=unit, runs=runs)
        for p, estimate in found.quantiles.items():
            answers.add(name, "quantile", p, estimate, unit=unit, runs=runs)
        if tables.sample.late(name).any():
            answers.add(name, "censored_share", "", found.censored_share, unit="", runs=runs)
    return answers


def described(design: Design, tables: Tables, name: str) -> Description:
    """The description of a quantity; an accurate expansion is its control variate."""
    if name in tables.descriptions:  # the loop and the analyses ask for the same ones
        return tables.descriptions[name]
    return _described(design, tables, name)


def _described(design: Design, tables: Tables, name: str) -> Description:
    analysis, sample = design.study.analysis, tables.sample
    if not design.drawn.names and not sample.late(name).any() and not sample.failed.any():
        value = exact(float(sample.answer(name)[0, 0]))
        return Description(
            mean=value,
            sd=exact(0.0),
            quantiles=dict.fromkeys(analysis.quantiles, value),
            censored_share=exact(0.0),
            scale=0.0,
        )
    if tables.slow is not None:
        return surrogate.described(design, tables.slow, sample, name)
    expansion = tables.expansions.get(name)
    if expansion is not None and expansion.left < chaos.CONTROL and sample.count < MOST_MANY:
        many = many_values(design, expansion, sample.count)
        return describe_controlled(
            sample.answer(name)[1:],
            expansion.values,
            many[1:],
            quantiles=analysis.quantiles,
            method=CONTROLLED,
        )
    policy = "drop" if analysis.policy == "abort" else analysis.policy
    return describe(
        sample.answer(name),
        censored=sample.late(name),
        failed=sample.lost(name),
        on_failure=policy,
        quantiles=analysis.quantiles,
        method=SAMPLED,
    )


def many_values(design: Design, expansion: chaos.Expansion, count: int) -> Array:
    """Values (R, m) of an expansion at the sample's points continued, `MANY` for each."""
    return chaos.values_at(design, expansion)(_many_points(design, min(MANY * count, MOST_MANY)))


@lru_cache(maxsize=2)
def _many_points(design: Design, count: int) -> Array:
    return design.normals(count)


def density(values: Array) -> list[list[float]] | None:
    """Density of samples of any shape over their range, by a kernel of Silverman's width on 160
    places.

    None where the values do not vary.
    """
    flat = np.sort(values[np.isfinite(values)].ravel())
    if flat.size < 16 or not flat[-1] - flat[0] > 1e-9 * abs(flat[-1]):
        return None
    low, high = np.quantile(flat, [0.0005, 0.9995])
    spread = min(
        float(flat.std()), float(np.subtract(*np.quantile(flat, [0.75, 0.25]))) / 1.349
    ) or float(flat.std())
    width = 0.9 * spread * flat.size**-0.2
    if not width > 0.0:
        return None
    places = np.linspace(low - 2.0 * width, high + 2.0 * width, 160)
    # counts in cells much finer than the kernel, so that the cost does not grow with the rows
    counts, edges = np.histogram(
        flat, bins=2048, range=(places[0] - 3.0 * width, places[-1] + 3.0 * width)
    )
    middles = 0.5 * (edges[1:] + edges[:-1])
    kernel = np.exp(-0.5 * ((places[:, None] - middles) / width) ** 2) / (
        width * np.sqrt(2.0 * np.pi)
    )
    return [places.tolist(), (kernel @ counts / flat.size).tolist()]
