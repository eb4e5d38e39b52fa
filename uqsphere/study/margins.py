"""The inverse question of a study: which number is free, and between which values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

from uqsphere.quantities import lookup
from uqsphere.study.axis import ENERGY, SPEED, make_axis
from uqsphere.study.document import FamilyTable, MarginsTable
from uqsphere.study.faults import Findings, Place, one_of, shown, suggestion
from uqsphere.study.numbers import plain_quantity, read_fixed
from uqsphere.study.scene import Scene
from uqsphere.study.study import Family, Margins, Study
from uqsphere.units import Quantity
from uqsphere.uq.families import LawError

#: what curves can be had over beside the free scalar, and the scalars that go with it
IMPOSED: Final = "specific_energy"
SETS_ENERGY: Final = (SPEED, ENERGY, "rig.speed", "rig.drop_height", "hammer.speed", "hammer.drop_height")


def read_margins(
    table: MarginsTable | None,
    scene: Scene,
    black_box: bool,
    numbers: Mapping[str, Place],
    findings: Findings,
    limits: Mapping[str, str],
) -> Margins | None:
    """What the margins ask; `numbers` are the numbers of the study with their places, `limits` the quantities of the
    limits by the paths of their strengths."""
    if table is None:
        return None
    probabilities = (*table.for_probability, *(table.for_fracture or ()), *map(_rest, table.for_survival or ()))
    _check_bars(table, scene, black_box, findings)
    known = _known_solve(table.solve, scene, black_box, numbers, findings, limits)
    if not known or not findings.clean(("margins", "between")):
        return None
    family = None
    if table.family is not None and findings.clean(("margins", "family")):
        family = _read_family(table.family, table.solve, scene, black_box, findings)
    _check_against(table, black_box, findings)
    quantity = _quantity_of(table.solve, limits, black_box)
    low, high = (read_fixed(raw, ("margins", "between", k), quantity, findings) for k, raw in enumerate(table.between))
    if low is None or high is None:
        return None
    if not low < high:
        first, second = (shown(raw) for raw in table.between)
        findings.add(("margins", "between"), f"found {first} and {second}: the lower value must come first")
        return None
    return Margins(
        axis=make_axis(table.solve, low, high, limits=limits, black_box=black_box),
        for_probability=tuple(sorted(set(probabilities))),
        family=family,
        bars_elastic=table.bars_elastic,
        against=table.against,
    )


def _check_bars(table: MarginsTable, scene: Scene, black_box: bool, findings: Findings) -> None:
    """Only bars that have a yield strength can be asked whether they stay elastic."""
    if not table.bars_elastic:
        return
    place: Place = ("margins", "bars_elastic")
    if black_box:
        findings.add(place, "a black box has no bars: leave bars_elastic out")
    elif "bars.yield_strength" not in scene.readings and findings.clean(("bars",)):
        findings.add(place, "the bars have no yield strength: add bars.yield_strength")


def _check_against(table: MarginsTable, black_box: bool, findings: Findings) -> None:
    """The curves may be asked for over the specific energy, where the speed is what is free."""
    place: Place = ("margins", "against")
    if table.against is None:
        return
    if table.against != IMPOSED:
        findings.add(place, f"found {shown(table.against)}, only {shown(IMPOSED)} is allowed")
    elif black_box:
        findings.add(place, "a black box has no specific energy: leave against out")
    elif table.solve not in SETS_ENERGY:
        why = f"the energy is set by the speed: it goes with solve = {one_of(list(SETS_ENERGY))}"
        findings.add(place, f"{why}, found {shown(table.solve)}")


def _rest(p: float) -> float:
    """1 - p without the rounding that would make two of one probability."""
    return float(f"{1.0 - p:.12g}")


def _quantity_of(solve: str, limits: Mapping[str, str], black_box: bool) -> Quantity:
    """What the free scalar is: a strength is in the unit of its limit's quantity, a mean above zero."""
    if solve in limits:
        own = lookup(limits[solve]) if not black_box else plain_quantity(limits[solve])
        return replace(own, lower=0.0, meaning="the mean strength")
    return plain_quantity(solve) if black_box else lookup(solve)


def _read_family(table: FamilyTable, solve: str, scene: Scene, black_box: bool, findings: Findings) -> Family | None:
    """Another number of the scene and its values; None, with the faults noted, if there is none."""
    place: Place = ("margins", "family")
    path = table.path
    there = path in scene.readings
    if not there and not findings.clean(("inputs", path) if black_box else tuple(path.split("."))):
        return None  # it is there, and what is wrong with it is said
    if not there or path == solve:
        why = "is the free number itself" if path == solve else "is no number of this scene"
        findings.add((*place, "path"), f"{shown(path)} {why}{suggestion(path, list(scene.readings))}")
        return None
    quantity = plain_quantity(path) if black_box else lookup(path)
    read = [read_fixed(raw, (*place, "values", k), quantity, findings) for k, raw in enumerate(table.values)]
    values = [value for value in read if value is not None]
    if len(set(values)) < len(values):
        findings.add((*place, "values"), "a value is named twice")
    return Family(path=path, values=tuple(sorted(values)))


def _known_solve(
    solve: str,
    scene: Scene,
    black_box: bool,
    numbers: Mapping[str, Place],
    findings: Findings,
    limits: Mapping[str, str],
) -> bool:
    place: Place = ("margins", "solve")
    if not findings.clean(place):
        return False
    if solve in scene.readings or solve in limits:
        return True
    if solve == ENERGY and not black_box:
        if "striker.length" in scene.readings:
            return True
        findings.add(place, f"{shown(solve)} needs the mass of the striker: give striker.length")
        return False
    if solve in numbers and not findings.clean(numbers[solve]):
        return False
    kind = "input of this study" if black_box else "number of this scene"
    names = [*scene.readings, *limits, *([ENERGY] if SPEED in scene.readings else [])]
    known = one_of(names[:30]) if names else "none"
    findings.add(place, f"{shown(solve)} is no {kind}, which has {known}{suggestion(solve, names)}")
    return False


def check_moved_mean(study: Study, findings: Findings) -> None:
    """A random number that margins move must have a law with every mean between the two ends."""
    margins = study.margins
    if margins is None:
        return
    if margins.family is not None:
        _check_moved(study, margins.family.path, margins.family.values, ("path", "values"), findings)
    axis = margins.axis
    _check_moved(study, axis.path, (axis.low, axis.high), ("solve", "between"), findings)


def _check_moved(study: Study, name: str, values: Sequence[float], keys: tuple[str, str], findings: Findings) -> None:
    base: Place = ("margins",) if keys[0] == "solve" else ("margins", "family")
    if name not in study.random:
        return
    if "mean" not in study.given[name]:
        findings.add(
            (*base, keys[0]),
            f"{shown(name)} scatters by a law that is not given by its mean, so there is no mean "
            "to move: "
            "give it by mean and sd or cov, or as a fixed number",
        )
        return
    for index, value in enumerate(values):
        try:
            study.random[name].with_mean(value, study.given[name])
        except LawError as error:
            findings.add(
                (*base, keys[1], index),
                f"with this mean {name} has no law: {error.message} (SI)",
            )
