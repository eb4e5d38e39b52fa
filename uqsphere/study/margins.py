"""The inverse question of a study: which number is free, and between which values."""

from __future__ import annotations

from collections.abc import Mapping

from uqsphere.quantities import lookup
from uqsphere.study.findings import Findings, Place, one_of, shown, suggestion
from uqsphere.study.nouns import Margins, Study, law_with_mean
from uqsphere.study.numbers import plain_quantity, read_fixed
from uqsphere.study.requests import shares
from uqsphere.study.scene import Scene
from uqsphere.study.schema import MarginsTable
from uqsphere.uq.laws import LawError

__all__ = ["check_moved_mean", "read_margins"]


def read_margins(
    table: MarginsTable | None,
    scene: Scene,
    black_box: bool,
    numbers: Mapping[str, Place],
    findings: Findings,
) -> Margins | None:
    if table is None:
        return None
    probabilities = shares(table.for_probability, ("margins", "for_probability"), findings)
    known = _known_solve(table.solve, scene, black_box, numbers, findings)
    if table.between is None:
        if findings.clean(("margins", "between")):
            findings.add(("margins", "between"), "between is missing: add the lowest and the highest value to look at")
        return None
    if len(table.between) != 2:
        findings.add(
            ("margins", "between"),
            f"found {len(table.between)} values, two are due: the lowest and the highest",
        )
        return None
    if table.solve is None or not known:
        return None
    quantity = lookup(table.solve) if not black_box else plain_quantity(table.solve)
    ends = [
        read_fixed(raw, ("margins", "between", index), quantity, findings) for index, raw in enumerate(table.between)
    ]
    low, high = ends
    if low is None or high is None:
        return None
    if not low < high:
        first, second = (shown(raw) for raw in table.between)
        findings.add(("margins", "between"), f"found {first} and {second}: the lower value must come first")
        return None
    return Margins(solve=table.solve, between=(low, high), for_probability=probabilities)


def _known_solve(
    solve: str | None, scene: Scene, black_box: bool, numbers: Mapping[str, Place], findings: Findings
) -> bool:
    place: Place = ("margins", "solve")
    if solve is None:
        if findings.clean(place):
            findings.add(
                place,
                f'solve is missing: add the number that is free, such as solve = "{_example(black_box)}"',
            )
        return False
    if solve in scene.readings:
        return True
    if solve in numbers and not findings.clean(numbers[solve]):
        return False
    kind = "input of this study" if black_box else "number of this scene"
    names = list(scene.readings)
    known = one_of(names[:30]) if names else "none"
    findings.add(place, f"{shown(solve)} is no {kind}, which has {known}{suggestion(solve, names)}")
    return False


def _example(black_box: bool) -> str:
    return "x1" if black_box else "striker.speed"


def check_moved_mean(study: Study, findings: Findings) -> None:
    """A random number that margins move must have a law with every mean between the two ends."""
    margins = study.margins
    if margins is None or margins.solve not in study.random:
        return
    if "mean" not in study.given[margins.solve]:
        findings.add(
            ("margins", "solve"),
            f"{shown(margins.solve)} scatters by a law that is not given by its mean, so there is no mean "
            "to move: "
            "give it by mean and sd or cov, or as a fixed number",
        )
        return
    for index, value in enumerate(margins.between):
        try:
            law_with_mean(study, margins.solve, value)
        except LawError as error:
            findings.add(
                ("margins", "between", index),
                f"with this mean {margins.solve} has no law: {error.message} (SI)",
            )
