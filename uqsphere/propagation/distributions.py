"""Distributions of the quantities: mean, standard deviation, quantiles, density, and the share
beyond the record.
"""

import numpy as np

from uqsphere.arrays import Array
from uqsphere.propagation.design import Design
from uqsphere.propagation.sampled import source_of
from uqsphere.propagation.tables import Tables
from uqsphere.results import Answers
from uqsphere.uq.describe import Description


def distributions(design: Design, tables: Tables) -> Answers:
    """Mean, standard deviation, quantiles and censored share of every quantity."""
    answers = Answers()
    runs = tables.runs if design.drawn.names else 1
    for name in design.described:
        description = described(design, tables, name)
        answers.add(name, "mean", "", description.mean, runs=runs)
        answers.add(name, "sd", "", description.sd, runs=runs)
        for p, estimate in description.quantiles.items():
            answers.add(name, "quantile", p, estimate, runs=runs)
        if tables.sample.late(name).any():
            answers.add(name, "censored_share", "", description.censored_share, runs=runs)
    return answers


def described(design: Design, tables: Tables, name: str) -> Description:
    """The description of a quantity."""
    if name in tables.descriptions:  # the loop and the analyses ask for the same ones
        return tables.descriptions[name]
    return source_of(design, tables).describe(name)


def density(values: Array) -> list[list[float]] | None:
    """Density of samples of any shape over their range, by a kernel of Silverman's width on 160
    places.

    None where the values do not vary.
    """
    flat = np.sort(values[np.isfinite(values)].ravel())
    if flat.size < 16 or not flat[-1] - flat[0] > 1e-9 * abs(flat[-1]):
        return None
    low, first, third, high = np.quantile(flat, [0.0005, 0.25, 0.75, 0.9995])
    sd = flat.std()
    width = 0.9 * (min(sd, (third - first) / 1.349) or sd) * flat.size**-0.2
    places = np.linspace(low - 2.0 * width, high + 2.0 * width, 160)
    # counts in cells much finer than the kernel, so that the cost does not grow with the rows
    ends = places[0] - 3.0 * width, places[-1] + 3.0 * width
    counts, edges = np.histogram(flat, bins=2048, range=ends)
    middles = 0.5 * (edges[1:] + edges[:-1])
    kernel = np.exp(-0.5 * ((places[:, None] - middles) / width) ** 2)
    kernel /= width * np.sqrt(2.0 * np.pi)
    return [places.tolist(), (kernel @ counts / flat.size).tolist()]
