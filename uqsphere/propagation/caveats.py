"""Caveats: what is no number, and holds a verdict at "not established"."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from uqsphere.propagation.checks import RANGE, Check, range_checks
from uqsphere.propagation.decision import Settled
from uqsphere.propagation.line import YieldingRows
from uqsphere.results.types import Caveat
from uqsphere.study import strength_name
from uqsphere.study.values import FARTHEST_SIZE


def caveats_of(
    settled: Settled, yielding: YieldingRows | None, checks: Sequence[Check]
) -> Iterator[Caveat]:
    """Why the verdict of an aim is not established; nothing where nothing holds it."""
    design = settled.aim.design
    governing = settled.governing
    if governing.code == "assumed strength":
        yield Caveat(code="assumed strength", subject=design.subject(governing.limit))
    yield from _model_range(settled, yielding, checks)
    yield from _sizes(settled)
    ours = tuple(f"limits.{limit.name}." for limit in settled.aim.limits)
    for code, path, text in design.study.caveats:
        if code != "rate" or path.startswith(ours):
            yield Caveat.model_validate({"code": code, "subject": path, "text": text})
    # limits on the same tests rest on one set of synthetic data
    names = [strength_name(group[0].name) for group in settled.aim.groups]
    for name in dict.fromkeys([*names, *design.inputs]):
        if name in design.study.made_up:
            yield Caveat(code="synthetic tests", subject=name)


def _model_range(
    settled: Settled, yielding: YieldingRows | None, checks: Sequence[Check]
) -> Iterator[Caveat]:
    """Checks that fail in the rows that fail: those of the plan, and those of the model's range at
    the number to use, where contacts can yield by contacts that do.
    """
    study = settled.aim.design.study
    limits = settled.aim.limits
    line = settled.line
    failing: dict[str, tuple[float, str]] = {}
    at_number = {}
    for check in checks:
        for limit in limits:
            share = check.failures.get(limit.name, 0.0)
            if check.grade == "failure" and share > limit.target:
                failing.setdefault(check.name, (share, check.text))
    if settled.use is not None and not study.black_box:
        nearest = line.values[np.argmin(np.abs(line.places - line.place_of(settled.use)))]
        under = replace(line, samples={nearest: line.few.samples[nearest]})
        if yielding is not None:
            under = yielding.along(under) or under
        for check in range_checks(under, limits):
            share = max(check.failures.values(), default=0.0)
            if share > study.analysis.accuracy.probability:
                at_number[check.name] = (share, f"at the number to use, {check.text}")
        for name, (share, text) in failing.items():
            if name in at_number:
                failing[name] = share, f"at the plan and at the number to use, {text}"
            elif name in RANGE:
                failing[name] = share, f"at the plan, not at the number to use, {text}"
    for name, (share, text) in (at_number | failing).items():
        yield Caveat(code="model range", subject=name, value=share, text=text)


def _sizes(settled: Settled) -> Iterator[Caveat]:
    """A sphere that is more than half larger, or a third smaller, than all tested ones."""
    design = settled.aim.design
    diameter = 2.0 * design.study.at_means().get("sphere.radius", math.nan)
    for limit in settled.aim.limits:
        tested = limit.tested
        if tested is not None and tested.beyond(diameter) > FARTHEST_SIZE:
            sizes = tested.diameters or (tested.diameter,)
            yield Caveat(
                code="size",
                subject=design.subject(limit),
                value=diameter,
                bound=min(sizes, key=lambda size: abs(size - diameter)),
            )
