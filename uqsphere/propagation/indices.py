"""Sobol' indices of the quantities, first and total: from the polynomial chaos where that is
accurate enough, else from pairs of runs (pick and freeze)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations

import numpy as np

from uqsphere.arrays import special
from uqsphere.models.model import Model
from uqsphere.propagation import chaos, surrogate
from uqsphere.propagation.design import Design
from uqsphere.propagation.tables import Tables
from uqsphere.quantities import lookup
from uqsphere.results import Answers
from uqsphere.results.types import IndexMethod
from uqsphere.uq import Estimate, absent, from_replicates
from uqsphere.uq.estimate import ratio_of_means
from uqsphere.uq.indices import Blocks, sampled_indices

CHAOS = "polynomial chaos, corrected by rows"


def indices(design: Design, tables: Tables) -> Answers:
    """First-order and total indices of every quantity, second-order ones where the study asks for
    them.
    """
    answers = Answers()
    for name in design.explained:
        for label, row in of_quantity(design, tables, name).items():
            runs = tables.sample.size + (tables.pairs[name].size if name in tables.pairs else 0)
            for order, estimate in zip(
                ("sobol_second",) if "," in label else ("sobol_first", "sobol_total"),
                row,
                strict=True,
            ):
                answers.add(name, order, label, estimate, unit="1", runs=runs)
    return answers


#: trajectories of Morris' design, and rows of the sample that SALib's other methods get
TRAJECTORIES, GIVEN = 64, 4096


def salib_indices(design: Design, tables: Tables, model: Model) -> Answers:
    """The measures of SALib that a study names in `analysis.measures`: Morris by a design of its
    own, which a slow model is not asked for, the others from the rows that are there."""
    from uqsphere.uq.interop import SALIB_METHODS, morris_rows, salib_measures

    answers, inputs = Answers(), design.joint.only(design.inputs)
    methods = [name for name in SALIB_METHODS if name in design.study.analysis.measures]
    sample = tables.sample if tables.slow is None else tables.slow.rows
    order = [sample.names.index(name) for name in design.inputs]
    for method in methods if design.inputs else ():
        reason, columns = (
            "",
            {name: sample.answer(name).ravel()[:GIVEN] for name in design.described},
        )
        uniforms = special.ndtr(sample.scores[:, :, order].reshape(-1, len(order))[:GIVEN])
        if inputs.dependent:
            reason = "the inputs depend on each other, which SALib's measures do not allow for"
        elif method == "morris" and tables.slow is not None:
            reason = "the model is too slow for a design of its own"
        elif method == "morris":
            uniforms, rows = morris_rows(inputs, TRAJECTORIES, seed=design.study.seed)
            found = model.evaluate(design.inputs, rows, design.described)
            values = np.where(found.good[:, None], found.values, np.nan)
            columns = {name: values[:, k] for k, name in enumerate(design.described)}
        for name, outputs in columns.items():
            row = (
                [absent(reason, f"SALib {method}", 0)] * len(inputs.names)
                if reason
                else salib_measures(method, uniforms, outputs, inputs.names, seed=design.study.seed)
            )
            for label, estimate in zip(inputs.names, row, strict=True):
                # mu* is the change of the quantity over the whole range of an input
                unit = lookup(name).unit if method == "morris" else "1"
                answers.add(name, method, label, estimate, unit=unit, runs=len(uniforms))
    return answers


def of_quantity(design: Design, tables: Tables, name: str) -> Mapping[str, tuple[Estimate, ...]]:
    """(first, total) by input, and (second,) by "input,input"."""
    if not design.inputs:
        return {}
    if design.joint.only(design.inputs).dependent:
        # variance has no parts of its own for each of inputs that are tied
        nothing = absent(
            "inputs depend on each other: their Sobol' indices have no meaning",
            CHAOS,
            tables.sample.size,
        )
        return dict.fromkeys(design.inputs, (nothing, nothing))
    if tables.slow is not None:
        return surrogate.shares(design, tables.slow, name)
    if name in tables.pairs:
        return _by_pairs(design, tables, name)
    if name in tables.expansions:
        return by_chaos(design, tables.expansions[name])
    nothing = absent(
        "the quantity does not vary, or has no plain value at every point",
        CHAOS,
        tables.sample.size,
    )
    return dict.fromkeys(design.inputs, (nothing, nothing))


def method_of(design: Design, tables: Tables, name: str) -> IndexMethod:
    """Where the indices of a quantity come from: "chaos", "pairs" or nothing."""
    if not design.inputs:
        return ""
    if tables.slow is not None:
        return "chaos" if name in tables.slow.responses else ""
    return "pairs" if name in tables.pairs else "chaos" if name in tables.expansions else ""


def by_chaos(design: Design, expansion: chaos.Expansion) -> dict[str, tuple[Estimate, ...]]:
    """Indices of an expansion, corrected by the rows that it was not fitted to."""
    form, known = expansion.fit.plain_form, expansion.known
    active = form.multi_indices > 0
    many = active.sum(axis=1)
    rows: dict[str, tuple[Estimate, ...]] = {}
    for k, name in enumerate(design.inputs):
        first = _index(expansion, active[:, k] & (many == 1), float(known.first[k]))
        total = _index(expansion, active[:, k], float(known.total[k]))
        if first.value is not None and total.value is not None and total.value < first.value:
            # a total index is no smaller: the difference is noise of the correction
            total = replace(total, value=min(first.value, total.high or 1.0))
        rows[name] = first, total
    if design.study.analysis.second_order:
        for i, j in combinations(range(len(design.inputs)), 2):
            own = active[:, i] & active[:, j] & (many == 2)
            share = (
                float((form.coefficients[own] ** 2).sum()) / known.sd**2 if known.sd > 0.0 else 0.0
            )
            rows[f"{design.inputs[i]},{design.inputs[j]}"] = (_index(expansion, own, share),)
    return rows


def _index(expansion: chaos.Expansion, which: np.ndarray, share: float) -> Estimate:
    """One index of the terms `which`, of which the expansion has `share`: what no term of it holds,
    between nothing and all that is left, widens it upwards, and the value takes that to be made up
    as the expansion is."""
    value, off = ratio_of_means(*expansion.projection(which, share))
    estimate = from_replicates(value + off, CHAOS, expansion.residuals.size, float(value))
    if estimate.value is None or estimate.low is None or estimate.high is None:
        return estimate
    best = min(max(estimate.value, 0.0) / max(1.0 - expansion.left, 1e-300), 1.0)
    error = expansion.known.error
    low, high = max(estimate.low - error, 0.0), min(estimate.high + error + expansion.left, 1.0)
    return replace(estimate, value=min(best, high)).spanning(low, high)


def by_chaos_accurate(design: Design, tables: Tables, name: str) -> bool:
    """Whether the chaos indices of a quantity are as accurate as required."""
    expansion = tables.expansions.get(name)
    if expansion is None:
        # nothing varies: there is nothing to sample
        return tables.sample.knows(name)
    widest = max(e.half_width for row in by_chaos(design, expansion).values() for e in row)
    return widest <= design.study.analysis.accuracy.sobol


def _by_pairs(design: Design, tables: Tables, name: str) -> dict[str, tuple[Estimate, ...]]:
    """Indices of the pairs; points of which any run has no value are left out."""
    blocks = Blocks(
        inputs_count=len(design.inputs), second=bool(design.study.analysis.second_order)
    )
    values = tables.pairs[name]
    whole = np.asarray(np.isfinite(values).all(axis=2))
    least = int(whole.sum(axis=1).min())
    if least < 2:
        nothing = absent("too few pairs without a failure", "pairs of runs", values.size)
        return dict.fromkeys(design.inputs, (nothing, nothing))
    found = sampled_indices(
        np.stack([own[keep][:least] for own, keep in zip(values, list(whole), strict=True)]), blocks
    )
    if not whole.all():
        share = float(whole.mean())
        found = replace(
            found,
            first=[surrogate.of_answered(e, share, "pairs") for e in found.first],
            total=[surrogate.of_answered(e, share, "pairs") for e in found.total],
        )
    rows: dict[str, tuple[Estimate, ...]] = dict(
        zip(design.inputs, zip(found.first, found.total, strict=True), strict=True)
    )
    for (i, j), estimate in found.second.items():
        rows[f"{design.inputs[i]},{design.inputs[j]}"] = (estimate,)
    return rows
