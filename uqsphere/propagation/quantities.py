"""What is answered on a quantity: its distribution, and the Sobol' indices of its inputs.

Mean, standard deviation, quantiles, density, and the share beyond the record.  First and total
indices come from the polynomial chaos where that is accurate enough, else from pairs of runs (pick
and freeze).
"""

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.models.model import Model
from uqsphere.models.rows import Interrupted
from uqsphere.results.answers import Rows, estimate_row
from uqsphere.uq import absent

from .tables import Slow, Tables


def distributions(tables: Tables) -> Rows:
    """Mean, standard deviation, quantiles and censored share of every quantity."""
    runs = tables.runs if tables.design.variables else 1
    for name in tables.design.described:
        description = tables.described(name)
        yield estimate_row(name, "mean", description.mean, runs=runs)
        yield estimate_row(name, "sd", description.sd, runs=runs)
        for p, estimate in description.quantiles.items():
            yield estimate_row(name, "quantile", estimate, p, runs=runs)
        if tables.sample.late(name).any():
            yield estimate_row(name, "censored_share", description.censored_share, runs=runs)


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
    reach = 3.0 * width
    counts, edges = np.histogram(flat, bins=2048, range=(places[0] - reach, places[-1] + reach))
    middles = 0.5 * (edges[1:] + edges[:-1])
    kernel = np.exp(-0.5 * ((places[:, None] - middles) / width) ** 2)
    kernel /= width * np.sqrt(2.0 * np.pi)
    return [places.tolist(), (kernel @ counts / flat.size).tolist()]


# --- Sobol' indices -------------------------------------------------------------------------------


def indices(tables: Tables) -> Rows:
    """First-order and total indices of every quantity, second-order ones where the study asks for
    them.
    """
    for name in tables.design.explained:
        for label, row in tables.sobol(name).items():
            runs = tables.runs
            if name in tables.pairs:
                runs += tables.pairs[name].size
            orders = ("second",) if "," in label else ("first", "total")
            for order, estimate in zip(orders, row, strict=True):
                yield estimate_row(name, f"sobol_{order}", estimate, label, runs=runs)


#: trajectories of Morris' design, and rows of the sample that SALib's other methods get
TRAJECTORIES, GIVEN = 64, 4096


def salib_indices(tables: Tables, model: Model) -> Rows:
    """The measures of SALib that a study names in `analysis.measures`: Morris by a design of its
    own, which a slow model is not asked for, the others from the rows that are there."""
    from uqsphere.uq.interop import SALIB_METHODS, morris_rows, salib_measures

    design = tables.design
    inputs = design.joint_inputs
    names = design.inputs
    if not names:
        return
    seed = design.study.seed
    sample = tables.rows
    given = special.ndtr(sample.scores[..., : len(names)].reshape(-1, len(names))[:GIVEN])
    for method in SALIB_METHODS:
        if method not in design.analysis.measures:
            continue
        reason = ""
        uniforms = given
        columns = {name: sample.answer(name).ravel()[:GIVEN] for name in design.described}
        if inputs.dependent:
            reason = "the inputs depend on each other, which SALib's measures do not allow for"
        elif method == "morris" and isinstance(tables, Slow):
            reason = "the model is too slow for a design of its own"
        elif method == "morris":
            uniforms, rows = morris_rows(inputs, TRAJECTORIES, seed=seed)
            try:
                values = model.evaluate(names, rows, design.described).values
                columns = dict(zip(design.described, values.T, strict=True))
            except Interrupted:
                reason = "interrupted before the runs of its design were there"
        for name, outputs in columns.items():
            if reason:
                row = [absent(reason, f"SALib {method}", 0)] * len(names)
            else:
                row = salib_measures(method, uniforms, outputs, names, seed=seed)
            for label, estimate in zip(names, row, strict=True):
                yield estimate_row(name, method, estimate, label, runs=len(uniforms))
