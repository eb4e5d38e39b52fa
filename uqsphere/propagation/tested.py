"""Strength tests as points on the axis of the free number."""

from __future__ import annotations

import numpy as np

from uqsphere.arrays import Array
from uqsphere.propagation.demands import demands_of, strength_of
from uqsphere.propagation.design import Design
from uqsphere.propagation.tables import Tables
from uqsphere.study import Limit
from uqsphere.uq import Law


def points_of_tests(design: Design, tables: Tables, limit: Limit) -> list[list[float]] | None:
    """Tests of a limit along the free number: values, shares broken, and 1 for right-censored ones.

    A test lies where the median demand is what its specimen bore; its share is that of Kaplan and
    Meier, in the middle of its step.  Tests beyond the range of the free number are left out.  None
    for a strength without tests, and without [margins].
    """
    law = strength_of(limit)
    if not isinstance(law, Law) or not law.data or len(tables.line) < 2:
        return None
    strengths = np.array([*law.data, *law.censored])
    stopped = np.arange(len(strengths)) >= len(law.data)
    values = np.array(sorted(tables.line))
    demands = np.array([np.nanmedian(demands_of(limit, tables.line[x])) for x in values])
    if not (np.isfinite(demands).all() and (np.diff(demands) > 0.0).all() and demands[0] > 0.0):
        return None
    logs = np.interp(np.log(strengths), np.log(demands), values, np.nan, np.nan)
    order = np.lexsort((stopped, strengths))
    shares = np.empty(len(strengths))
    shares[order] = _kaplan_meier(stopped[order])
    points = np.array([logs, shares, stopped.astype(float)])[:, order]
    shown: list[list[float]] = points[:, np.isfinite(points[0])].tolist()
    if not shown[0]:
        return None
    return shown


def _kaplan_meier(stopped: Array) -> Array:
    """Share broken at each of some tests in rising order, in the middle of its step."""
    left = len(stopped) - np.arange(len(stopped))
    survival = np.cumprod(np.where(stopped, 1.0, 1.0 - 1.0 / left))
    before = np.concatenate([[1.0], survival[:-1]])
    return np.asarray(1.0 - 0.5 * (before + survival))
