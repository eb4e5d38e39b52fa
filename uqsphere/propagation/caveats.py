"""Caveats: what is no number, and holds a verdict at "not established"."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final, get_args

import numpy as np

from uqsphere.propagation.checks import Check, range_checks
from uqsphere.propagation.contact_law import YieldingRows
from uqsphere.propagation.decision import Settled
from uqsphere.propagation.doubts import ASSUMED
from uqsphere.propagation.line import Line
from uqsphere.results.types import Caveat, CaveatCode
from uqsphere.study import strength_name

#: ratio of diameters of tests and sphere beyond which no law of size was tested
_SIZES: Final = 1.5


def caveats_of(
    settled: Settled, yielding: YieldingRows | None, checks: Sequence[Check]
) -> list[Caveat]:
    """Why the verdict of an aim is not established; empty where nothing holds it."""
    caveats: list[Caveat] = []
    design, governing = settled.aim.design, settled.governing
    if governing.code == ASSUMED:
        caveats.append(Caveat(code="assumed strength", subject=design.subject(governing.limit)))
    caveats += _model_range(settled, yielding, checks)
    caveats += _sizes(settled)
    for code, path, text in design.study.caveats:
        literal = next(word for word in get_args(CaveatCode) if word == code)
        caveats.append(Caveat(code=literal, subject=path, text=text))
    # limits on the same tests rest on one set of synthetic data
    names = [strength_name(group[0].name) for group in settled.aim.groups]
    caveats += [
        Caveat(code="synthetic tests", subject=name)
        for name in dict.fromkeys([*names, *design.inputs])
        if name in design.study.made_up
    ]
    return caveats


def _model_range(
    settled: Settled, yielding: YieldingRows | None, checks: Sequence[Check]
) -> Iterator[Caveat]:
    """Checks that fail in the rows that fail: those of the plan, and those of the model's range at
    the number to use, where contacts can yield by contacts that do.
    """
    design, told = settled.aim.design, set[str]()
    for check in checks:
        for limit in settled.aim.limits:
            share = check.failures.get(limit.name, 0.0)
            if check.grade == "failure" and share > limit.target and check.name not in told:
                told.add(check.name)
                yield Caveat(code="model range", subject=check.name, value=share, text=check.text)
    number, line = settled.number, settled.line
    if design.study.black_box or number is None or not math.isfinite(number):
        return
    nearest = int(np.argmin(np.abs(line.places - line.place_of(number))))
    few = line.few
    under = Line(design=design, values=(few.values[nearest],), samples=(few.samples[nearest],))
    if yielding is not None:
        under = yielding.along(under) or under
    for check in range_checks(under, settled.aim.limits, under.values[0]):
        share = max(check.failures.values(), default=0.0)
        if share > design.study.analysis.accuracy.probability and check.name not in told:
            told.add(check.name)
            yield Caveat(code="model range", subject=check.name, value=share, text=check.text)


def _sizes(settled: Settled) -> Iterator[Caveat]:
    """A sphere that is more than half larger or smaller than all tested ones."""
    study = settled.aim.design.study
    for limit in settled.aim.limits:
        if limit.tested is None:
            continue
        diameter = 2.0 * study.at_means()["sphere.radius"]
        if limit.tested.beyond(diameter) > _SIZES:
            sizes = limit.tested.diameters or (limit.tested.diameter,)
            yield Caveat(
                code="size",
                subject=settled.aim.design.subject(limit),
                value=diameter,
                bound=min(sizes, key=lambda size: abs(size - diameter)),
            )
