"""Fracture by any limit of the study: how likely, by which mode first, and in what state of
loading.

The moment of fracture is read off the loading of a few hundred spheres, drawn with their strengths
from those that break.
"""

from collections.abc import Sequence

import numpy as np

from uqsphere.arrays import Array
from uqsphere.models.scene import fractures_of
from uqsphere.propagation.design import Design
from uqsphere.propagation.limits import state_of
from uqsphere.propagation.tables import Tables, input_rows
from uqsphere.results import Answers
from uqsphere.study import Limit, strength_name
from uqsphere.uq import random_generator
from uqsphere.uq.estimate import share as share_of
from uqsphere.uq.limit_state import (
    draw_breaking,
    exceedance,
    make_union,
    residual_correlation,
    union_state,
    weighted_quantile,
)

#: spheres of each replicate whose loading is followed, of the first so many points
SPECIMENS, MOST = 16, 512
METHOD = "spheres that break, along their loading"


def fracture(design: Design, tables: Tables) -> Answers:
    """Probability of fracture by any limit, the share of each mode, and time and force at
    fracture.
    """
    answers = Answers()
    limits = _each_once(design.fracture)
    if len(limits) < 2 or design.study.black_box or not design.drawn.names:
        return answers
    sample = tables.sample.head(MOST)
    generator = random_generator(seed=design.study.seed, task="fracture")
    union = make_union(
        [state_of(design, limit, sample) for limit in limits],
        _common_factor(design, limits),
        generator,
    )
    exceeded = exceedance(union_state(union))
    answers.add("fracture", "exceedance_probability", "", exceeded, runs=tables.runs)
    drawn = draw_breaking(union, SPECIMENS, generator)
    if drawn is None:
        return answers
    shape = drawn.rows.shape
    flat = (np.arange(shape[0])[:, None] * sample.count + drawn.rows).ravel()
    names, rows = input_rows(design, sample, {})
    fractures = fractures_of(
        design.judged,
        names,
        rows[flat],
        [limit.quantity for limit in limits],
        drawn.shares.reshape(len(limits), -1).T,
    )
    first = fractures.first.reshape(shape)
    for k, limit in enumerate(limits):
        share = share_of(first == k, METHOD, weights=drawn.weights)
        answers.add("fracture", "mode_share", limit.name, share, runs=first.size)
    for name in ("time", "force", "energy"):
        values = getattr(fractures, name)
        filled = np.where(np.isfinite(values), values, 0.0).reshape(shape)
        for p in (0.05, 0.5, 0.95):
            estimate = weighted_quantile(filled, drawn.weights, p, METHOD, first.size)
            answers.add("fracture", f"{name}_at_fracture", p, estimate, runs=first.size)
    return answers


def _each_once(limits: Sequence[Limit]) -> list[Limit]:
    """The limits that count as fracture, one for each strength: a sphere that must not break below
    one speed and must above another has one strength.
    """
    once: list[Limit] = []
    strengths: list[object] = []
    for limit in limits:
        strength = (limit.quantity, limit.strength, limit.model_factor)
        if limit.fracture is not False and strength not in strengths:
            once.append(limit)
            strengths.append(strength)
    return once


def _common_factor(design: Design, limits: Sequence[Limit]) -> Array:
    """Cholesky factor of the correlation that strengths have with each other, given all that is
    drawn.
    """
    joint = design.joint
    covariance = np.eye(len(limits))
    names = [strength_name(limit.name) for limit in limits]
    random = [k for k, name in enumerate(names) if name in joint.names]
    if joint.correlation is None or len(random) < 2:
        return covariance
    at = [joint.names.index(names[k]) for k in random]
    drawn = [joint.names.index(name) for name in design.drawn.names]
    among = joint.correlation[np.ix_(at, at)]
    across = joint.correlation[np.ix_(drawn, at)]
    within = joint.correlation[np.ix_(drawn, drawn)]
    covariance[np.ix_(random, random)] = among - across.T @ np.linalg.solve(within, across)
    return residual_correlation(covariance)
