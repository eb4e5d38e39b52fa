"""Sobol' indices of the quantities, first and total: from the polynomial chaos where that is
accurate enough, else from pairs of runs (pick and freeze)."""

import numpy as np

from uqsphere.arrays import special
from uqsphere.models.model import Model
from uqsphere.propagation.design import Design
from uqsphere.propagation.sampled import METHOD, source_of
from uqsphere.propagation.tables import Indices, Tables
from uqsphere.results import Answers
from uqsphere.uq import absent


def indices(design: Design, tables: Tables) -> Answers:
    """First-order and total indices of every quantity, second-order ones where the study asks for
    them.
    """
    answers = Answers()
    for name in design.explained:
        for label, row in of_quantity(design, tables, name).items():
            runs = tables.runs
            if name in tables.pairs:
                runs += tables.pairs[name].size
            orders = ("second",) if "," in label else ("first", "total")
            for order, estimate in zip(orders, row, strict=True):
                answers.add(name, f"sobol_{order}", label, estimate, runs=runs)
    return answers


#: trajectories of Morris' design, and rows of the sample that SALib's other methods get
TRAJECTORIES, GIVEN = 64, 4096


def salib_indices(design: Design, tables: Tables, model: Model) -> Answers:
    """The measures of SALib that a study names in `analysis.measures`: Morris by a design of its
    own, which a slow model is not asked for, the others from the rows that are there."""
    from uqsphere.uq.interop import SALIB_METHODS, morris_rows, salib_measures

    answers = Answers()
    inputs = design.joint_inputs
    names = design.inputs
    if not names:
        return answers
    source = source_of(design, tables)
    seed = design.study.seed
    sample = source.rows
    scores = sample.scores[..., : len(names)].reshape(-1, len(names))
    given = special.ndtr(scores[:GIVEN])
    for method in SALIB_METHODS:
        if method not in design.study.analysis.measures:
            continue
        reason = ""
        uniforms = given
        columns = {name: sample.answer(name).ravel()[:GIVEN] for name in design.described}
        if inputs.dependent:
            reason = "the inputs depend on each other, which SALib's measures do not allow for"
        elif method == "morris" and source.refusal:
            reason = source.refusal
        elif method == "morris":
            uniforms, rows = morris_rows(inputs, TRAJECTORIES, seed=seed)
            answered = model.evaluate(names, rows, design.described)
            values = np.where(answered.good[:, None], answered.values, np.nan)
            columns = dict(zip(design.described, values.T, strict=True))
        for name, outputs in columns.items():
            row = [absent(reason or "none", f"SALib {method}", 0)] * len(names)
            if not reason:
                row = salib_measures(method, uniforms, outputs, names, seed=seed)
            for label, estimate in zip(names, row, strict=True):
                answers.add(name, method, label, estimate, runs=len(uniforms))
    return answers


def of_quantity(design: Design, tables: Tables, name: str) -> Indices:
    """(first, total) by input, and (second,) by "input,input"."""
    if not design.inputs:
        return {}
    if design.joint_inputs.dependent:
        # variance has no parts of its own for each of inputs that are tied
        reason = "inputs depend on each other: their Sobol' indices have no meaning"
        nothing = absent(reason, METHOD, tables.runs)
        return dict.fromkeys(design.inputs, (nothing, nothing))
    return source_of(design, tables).indices(name)
