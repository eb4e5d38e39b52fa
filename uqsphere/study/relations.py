"""What names the numbers of a study: groups of inputs, dependence, and which number is free between which values."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from uqsphere.quantities import INPUTS, lookup
from uqsphere.study.document import Dependence, Document, FamilyTable, MarginsTable
from uqsphere.study.faults import Findings, Place, one_of, shown, suggestion
from uqsphere.study.limits import LimitReading
from uqsphere.study.numbers import Reading, plain_quantity, read_fixed
from uqsphere.study.scene import Scene
from uqsphere.study.study import ENERGY, SPEED, Family, Margins, Study, make_axis, strength_name, tie_of
from uqsphere.units import Quantity
from uqsphere.uq import Law, LawError, make_law

MOST_DEPENDENCES: Final = 100
MOST_GROUPS: Final = 50
#: what curves can be had over beside the free scalar, and the scalars that go with it
IMPOSED: Final = "specific_energy"
SETS_ENERGY: Final = (SPEED, ENERGY, "rig.speed", "rig.drop_height", "hammer.speed", "hammer.drop_height")


@dataclass(frozen=True, kw_only=True)
class Named:
    """The numbers of a study by name: those that scatter, in order, and where every one stands, faulty ones too.

    `strengths` are the quantities of the limits by the paths of their strengths; `unread` are the parts of limits that
    could not be understood, some for the fault of another number.
    """

    scene: Scene
    black_box: bool
    random: Mapping[str, Reading]
    places: Mapping[str, Place]
    strengths: Mapping[str, str]
    unread: Collection[str] = ()

    def is_random(self, name: str, place: Place, among: Sequence[str], findings: Findings) -> bool:
        """Whether a name is that of a random number; noted where not, but for a number that is faulty itself."""
        if name in among:
            return True
        if name not in self.places:
            listed = one_of(list(among[:20])) if among else "none"
            findings.add(place, f"unknown random input {shown(name)}, random here: {listed}{suggestion(name, among)}")
        elif findings.clean(self.places[name]) and name not in self.unread:
            findings.add(place, f"{shown(name)} is a fixed number here: give it a distribution, or leave it out")
        return False

    def quantity(self, path: str) -> Quantity:
        """What a number is: a strength is in the unit of its limit's quantity, a mean above zero."""
        own = self.strengths.get(path, path)
        found = plain_quantity(own) if self.black_box else lookup(own)
        return replace(found, lower=0.0, meaning="the mean strength") if path in self.strengths else found


def named_numbers(document: Document, scene: Scene, limits: Sequence[LimitReading], *, black_box: bool) -> Named:
    """The numbers of a study: inputs in order, then strengths and model factors."""
    readings: dict[str, Reading | None] = dict(scene.readings)
    for limit in limits:
        readings |= limit.parts
    parts = [(name, part) for name in document.limits for part in ("strength", "model_factor")]
    places: dict[str, Place] = {f"limits.{name}.{part}": ("limits", name, part) for name, part in parts}
    # a value that could not even be taken in is gone from the document, but not from the file
    own = {name: ("inputs", name) for name in document.inputs or {}} if black_box else {
        name: tuple(name.split(".")) for name in INPUTS
    }  # fmt: skip
    return Named(
        scene=scene, black_box=black_box, places=places | own,
        random={n: item for n, item in readings.items() if item is not None and isinstance(item.value, Law)},
        strengths={strength_name(limit.name): limit.quantity for limit in limits if limit.quantity is not None},
        unread=[name for limit in limits for name, item in limit.parts.items() if item is None],
    )  # fmt: skip


def check_groups(groups: Mapping[str, Sequence[str]], named: Named, findings: Findings) -> None:
    """Note every group that is not one of inputs of the model that scatter."""
    place: Place = ("analysis", "groups")
    if len(groups) > MOST_GROUPS:
        findings.add(place, f"found {len(groups)} groups, at most {MOST_GROUPS} are allowed")
        return
    for group, names in groups.items():
        for index, name in enumerate(names):
            named.is_random(name, (*place, group, index), list(named.scene.random()), findings)


# --- dependence -----------------------------------------------------------------------------------------


def read_dependence(tables: Sequence[Dependence], named: Named, findings: Findings) -> tuple[Dependence, ...]:
    """The dependences between random variables, checked one by one and then together."""
    if len(tables) > MOST_DEPENDENCES:
        findings.add(("dependence",), f"found {len(tables)} dependences, at most {MOST_DEPENDENCES} are allowed")
        return ()
    usable, random = True, list(named.random)
    for index, table in enumerate(tables):
        place: Place = ("dependence", index)
        for at, name in enumerate(table.of):
            usable &= named.is_random(name, (*place, "of", at), random, findings)
        _check_strength(table, place, findings)
        usable &= findings.clean(place)
    if usable:
        _check_together(tables, random, findings)
    return tuple(tables)


def _check_strength(table: Dependence, place: Place, findings: Findings) -> None:
    """One rank correlation, and the degrees of freedom where they belong."""
    if table.spearman is not None and table.kendall is not None:
        findings.add((*place, "kendall"), "spearman is given too: one of them says how strong the dependence is")
    sound = findings.clean((*place, "spearman")) and findings.clean((*place, "kendall"))
    if table.spearman is None and table.kendall is None and sound:
        findings.add(
            (*place, "spearman"),
            "spearman is missing: add a rank correlation between -1 and 1, or kendall in its place",
        )
    if not findings.clean((*place, "copula")):
        return
    if table.copula == "student_t" and table.dof is None:
        findings.lack((*place, "dof"), "dof is missing: a Student t copula needs its degrees of freedom, 4 say")
    elif table.copula != "student_t" and table.dof is not None:
        findings.add((*place, "dof"), f'dof belongs to copula = "student_t", the copula here is {shown(table.copula)}')


def _check_together(tables: Sequence[Dependence], random: Sequence[str], findings: Findings) -> None:
    """Refuse the first dependence that contradicts those before it."""
    from uqsphere.uq import make_joint

    # Only the names that are tied matter, and a study can have many more.
    tied = [name for name in random if any(name in table.of for table in tables)]
    ties = [tie_of(table) for table in tables]
    unit = make_law("normal", {"mean": 0.0, "sd": 1.0})
    for count in range(1, len(ties) + 1):
        try:
            make_joint(tied, [unit] * len(tied), ties[:count])
        except LawError as error:
            key = error.key
            if key == "spearman" and ties[count - 1].spearman is None:
                key = "kendall"
            findings.add(("dependence", count - 1, *((key,) if key else ())), error.message)
            return


# --- margins --------------------------------------------------------------------------------------------


def read_margins(document: Document, named: Named, findings: Findings) -> Margins | None:
    """What the margins ask; None, with the faults noted, where they cannot be understood."""
    table = document.margins
    if table is None:
        return None
    if not document.limits and findings.clean(("limits",)):
        findings.add(("margins",), "margins need a limit to be asked of: add a table [limits.NAME]")
    _check_bars(table, named, findings)
    survived = (float(f"{1.0 - p:.12g}") for p in table.for_survival or ())  # so that two of one are one
    probabilities = {*table.for_probability, *(table.for_fracture or ()), *survived}
    if not _known_solve(table.solve, named, findings) or not findings.clean(("margins", "between")):
        return None
    family = None
    if table.family is not None and findings.clean(("margins", "family")):
        family = _read_family(table.family, table.solve, named, findings)
    _check_against(table, named.black_box, findings)
    ends = _read_between(table, named.quantity(table.solve), findings)
    if ends is None:
        return None
    axis = make_axis(table.solve, *ends, limits=named.strengths, black_box=named.black_box)
    return Margins(
        axis=axis, for_probability=tuple(sorted(probabilities)), family=family, bars_elastic=table.bars_elastic,
        against=table.against,
    )  # fmt: skip


def _read_between(table: MarginsTable, quantity: Quantity, findings: Findings) -> tuple[float, float] | None:
    """The lowest and the highest value of the free number; None, with the fault noted, where they are not that."""
    low, high = (read_fixed(raw, ("margins", "between", k), quantity, findings) for k, raw in enumerate(table.between))
    if low is None or high is None:
        return None
    if not low < high:
        first, second = map(shown, table.between)
        findings.add(("margins", "between"), f"found {first} and {second}: the lower value must come first")
        return None
    return low, high


def _check_bars(table: MarginsTable, named: Named, findings: Findings) -> None:
    """Only bars that have a yield strength can be asked whether they stay elastic."""
    if table.bars_elastic and named.black_box:
        findings.add(("margins", "bars_elastic"), "a black box has no bars: leave bars_elastic out")
    elif table.bars_elastic and "bars.yield_strength" not in named.scene.readings and findings.clean(("bars",)):
        findings.add(("margins", "bars_elastic"), "the bars have no yield strength: add bars.yield_strength")


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


def _read_family(table: FamilyTable, solve: str, named: Named, findings: Findings) -> Family | None:
    """Another number of the scene and its values; None, with the faults noted, if there is none."""
    place: Place = ("margins", "family")
    path, readings = table.path, named.scene.readings
    if path not in readings and not findings.clean(("inputs", path) if named.black_box else tuple(path.split("."))):
        return None  # it is there, and what is wrong with it is said
    if path not in readings or path == solve:
        why = "is the free number itself" if path == solve else "is no number of this scene"
        findings.add((*place, "path"), f"{shown(path)} {why}{suggestion(path, list(readings))}")
        return None
    quantity = plain_quantity(path) if named.black_box else lookup(path)
    read = [read_fixed(raw, (*place, "values", k), quantity, findings) for k, raw in enumerate(table.values)]
    values = [value for value in read if value is not None]
    if len(set(values)) < len(values):
        findings.add((*place, "values"), "a value is named twice")
    return Family(path=path, values=tuple(sorted(values)))


def _known_solve(solve: str, named: Named, findings: Findings) -> bool:
    """Whether the free number is one of the study; noted where not."""
    place, readings, places = ("margins", "solve"), named.scene.readings, named.places
    if not findings.clean(place):
        return False
    if solve in readings or solve in named.strengths:
        return True
    if solve == ENERGY and not named.black_box:
        if "striker.length" in readings:
            return True
        findings.add(place, f"{shown(solve)} needs the mass of the striker: give striker.length")
    elif solve not in places or findings.clean(places[solve]):
        kind = "input of this study" if named.black_box else "number of this scene"
        names = [*readings, *named.strengths, *([ENERGY] if SPEED in readings else [])]
        known = one_of(names[:30]) if names else "none"
        findings.add(place, f"{shown(solve)} is no {kind}, which has {known}{suggestion(solve, names)}")
    return False


def check_moved_mean(study: Study, findings: Findings) -> None:
    """A random number that margins move must have a law with every mean between the two ends."""
    margins = study.margins
    if margins is None:
        return
    axis, family = margins.axis, margins.family
    moved: list[tuple[str, tuple[float, ...], Place, tuple[str, str]]] = []
    if family is not None:
        moved.append((family.path, family.values, ("margins", "family"), ("path", "values")))
    moved.append((axis.path, (axis.low, axis.high), ("margins",), ("solve", "between")))
    for name, values, place, keys in moved:
        if name in study.random and "mean" not in study.given[name]:
            why = "scatters by a law that is not given by its mean, so there is no mean to move"
            due = "give it by mean and sd or cov, or as a fixed number"
            findings.add((*place, keys[0]), f"{shown(name)} {why}: {due}")
        for index, value in enumerate(values) if name in study.random and "mean" in study.given[name] else ():
            try:
                study.random[name].with_mean(value, study.given[name])
            except LawError as error:
                said = f"with this mean {name} has no law: {error.message} (SI)"
                findings.add((*place, keys[1], index), said)
