"""The tables of a study file, each declared once.

From a declaration follow how its table is read and what is said of its faults (`uqsphere.study.tables`), the schema for
editors and the tables of docs/study-file.md (`uqsphere.study.reference`), and, where nothing else enters, the frozen
noun itself.  Numbers that can scatter are taken as they come: `uqsphere.study.numbers` reads them where their quantity
is known.  How values go together is asked in `uqsphere.study.resolve`, where a fault in one part does not hide those of
others.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Annotated, Final

from pydantic import Field
from pydantic.dataclasses import dataclass

from uqsphere.mechanics.criteria import CRITERIA, PARAMETERS
from uqsphere.mechanics.pulses import PRESETS, SHAPES
from uqsphere.mechanics.rigs import PARTNER_KINDS
from uqsphere.mechanics.scene import CONTACT_LAWS
from uqsphere.study.faults import Misplaced, Raw, one_of, shown
from uqsphere.study.particle_tables import ENERGY_OF, FeedTable, MaterialTable, Platens, ProductTable, TestsTable
from uqsphere.study.tables import (
    CLOSED,
    MOST_LISTED,
    Check,
    Fixed,
    Flag,
    Length,
    Node,
    Number,
    Positive,
    Real,
    Share,
    Text,
    Whole,
    among,
    fixed,
    key,
    several,
    within,
)
from uqsphere.units import UNITS, Quantity
from uqsphere.uq.joint import COPULAS, LEAST_DOF, MOST_DOF

#: tables of a scene whose numbers are entries of `uqsphere.quantities.INPUTS`
SCENE: Final = (
    "sphere", "bars", "striker", "pulse", "contact", "product",
    "rig", "target", "anvil", "other", "hammer", "rod", "platens",
)  # fmt: skip
#: what a sphere is loaded by, and the tables that belong to each
RIG_TABLES: Final[dict[str, tuple[str, ...]]] = {
    "bars": ("bars", "striker", "pulse"),
    "impact": ("target",),
    "sphere_on_sphere": ("other",),
    "drop_weight": ("hammer", "anvil"),
    "load_cell": ("hammer", "rod"),
    "platens": ("platens",),
    "none": (),
}
FIDELITIES: Final = ("auto", "massless", "linear", "full")
#: analyses of their own, `uqsphere.runner.questions.further`
FURTHER: Final[tuple[str, ...]] = ("morris",)
METHODS: Final = ("qmc", "pce", "sobol", "form", "importance", "subset", *FURTHER)
#: gauges of one scene
MOST_GAUGES: Final = 20
#: places of one field: a row of answers is stored whole
MOST_PLACES: Final = 10_000
#: rows of one stored chunk, `uqsphere.runner.chunks`
_MOST_ROWS: Final = 16_384


# --- what a key can hold ----------------------------------------------------------------------------


def _signal_units() -> Iterable[str]:
    from uqsphere.records.table import SIGNAL_UNITS

    return SIGNAL_UNITS


def _in_order(values: tuple[float, ...]) -> tuple[float, ...]:
    if not 1 <= len(values) <= MOST_LISTED:
        raise ValueError(f"found {len(values)} numbers, from 1 to {MOST_LISTED} are due")
    return tuple(sorted(set(values)))


def _methods(value: Raw) -> Raw:
    """The word "auto" as a list."""
    if value != "auto" and not isinstance(value, (list, tuple)):
        hint = f'; write methods = ["{value}"]' if value in METHODS else ""
        raise ValueError(f'found {shown(value)}: "auto" or a list of {one_of(METHODS)} is due{hint}')
    return ("auto",) if value == "auto" else value


def _methods_schema() -> Node:
    return {"anyOf": [{"const": "auto"}, {"const": ["auto"]}, {"type": "array", "items": {"enum": list(METHODS)}}]}


def _together(values: tuple[str, ...]) -> tuple[str, ...]:
    if "auto" in values and len(values) > 1:
        raise Misplaced('"auto" goes with no other method', values.index("auto"))
    return values


def _window(values: tuple[float, ...]) -> tuple[float, ...]:
    if len(values) != 2:
        raise ValueError(f"found {len(values)} values, two are due: begin and end of the pulse in the record")
    if not values[0] < values[1]:
        raise ValueError(f"found {values[0]:g} s and {values[1]:g} s: the begin must come first")
    return values


def _ends(values: tuple[Raw, ...]) -> tuple[Raw, ...]:
    if len(values) != 2:
        raise ValueError(f"found {len(values)} values, two are due: the lowest and the highest")
    return values


Correlation = Annotated[Real, within(-1.0, 1.0)]
Shares = Annotated[tuple[Share, ...], Check(_in_order, lambda: {"minItems": 1})]
Names = Annotated[tuple[Text, ...], several(1, "names")]
Seconds = Annotated[float, fixed("time", "t")]
#: an instant of a record, which may begin before 0
Instant = Annotated[float, fixed("time", "t", -math.inf)]
Methods = Annotated[
    tuple[Annotated[Text, among((*METHODS, "auto"))], ...],
    several(1, "methods"),
    Check(_together),
    Check(_methods, _methods_schema, first=True),
]


# --- the tables -------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class SphereTable:
    """The sphere."""

    material: Text | None = key("name from `uqsphere list materials`; fills `E`, `nu`, `density` that are not given")
    E: Number = key("Young's modulus", default_is="from the material")
    nu: Number = key("Poisson ratio, below 0.5", default_is="from the material")
    density: Number = key("density", default_is="from the material")
    onset_pressure: Number = key(
        "contact pressure at which the sphere yields or crushes", default_is="from the material, else it does not"
    )
    hardness: Number = key(
        "mean pressure at which it flows or crushes fully; needed with `onset_pressure`", default_is="from the material"
    )
    radius: Number = key(
        "radius, not diameter; the sphere must fit its bars", due='add radius = "10 mm", half the diameter'
    )


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class BarsTable:
    """Both bars, alike in material and diameter."""

    material: Text | None = key("fills `E`, `nu`, `density`, `yield_strength` that are not given")
    E: Number = key("as for the sphere", default_is="from the material")
    nu: Number = key("as for the sphere", default_is="from the material")
    density: Number = key("as for the sphere", default_is="from the material")
    yield_strength: Number = key(
        "for the validity checks, and for the law of the contact where it is `plastic`", default_is="from the material"
    )
    diameter: Number = key("diameter of the bars", due='add diameter = "40 mm"')
    incident_length: Number = key(
        "length; with `infinite` it serves a validity check alone", default_is="required unless `infinite`"
    )
    receiving_length: Number = key("the same for the receiving bar", default_is="required unless `infinite`")
    incident_end: Number = key(
        'far end: `"free"`, `"absorbing"`, `"fixed"`, or a reflection coefficient from -1 (fixed) to 1 (free)',
        default_is='`"free"`',
    )
    receiving_end: Number = key("the same for the receiving bar", default_is='`"absorbing"`')
    receiving_damper: Text | None = key(
        "in place of `receiving_end`: a CSV beside the study with the columns `frequency` [Hz], `impedance_real` and "
        "`impedance_imag` [kg/s] of the far end"
    )
    end_radius: Number = key("radius of rounded ends at the sphere", default_is="flat")
    insert_material: Text | None = key(
        "a material of bars or plates, such as `tungsten_carbide` or `hard_4340`; fills `insert_E`, `insert_nu`, "
        "`insert_yield_strength` that are not given"
    )
    insert_E: Number = key(
        "Young's modulus of inserts that stand between bars and sphere; their waves are left out",
        default_is="from the material, else no insert",
    )
    insert_nu: Number = key("Poisson ratio of the inserts", default_is="from the material, else that of the bars")
    insert_yield_strength: Number = key("yield strength of the inserts", default_is="as `insert_nu`")
    insert_thickness: Number = key("thickness of the inserts, for a validity check")
    onset_pressure: Number = key(
        'centre pressure at which the face yields, with a contact that is "plastic"', default_is="from `yield_strength`"
    )
    hardness: Number = key("mean pressure of the face that flows fully", default_is="from `yield_strength`")
    pile_up: Number = key("pile-up of the face far beyond yield", default_is="8/3")
    infinite: Flag = key("no reflections", False)
    rigid_contact: Flag = key("leaves the bars out of the contact stiffness, `1/E* = (1 - nu²)/E`", False)


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class StrikerTable:
    """The striker."""

    speed: Number = key("striker speed `v_0`; the pulse has the particle speed `v_0/2`", default_is="required")
    length: Number = key(
        "gives the pulse its duration `2 l_0/c_0`; not needed with `pulse.duration` or a step", default_is="required"
    )
    material: Text | None = key("a material of the bars, for `E` and `density`", default_is="that of the bars")
    E: Number = key("of a striker that is no piece of the bars", default_is="that of the bars")
    density: Number = key("of a striker that is no piece of the bars", default_is="that of the bars")
    diameter: Number = key("of a striker that is no piece of the bars", default_is="that of the bars")


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class PulseTable:
    """The incident pulse; `uqsphere.study.scene.PULSE_KEYS` says which keys go with which shape."""

    preset: Annotated[Text, among(tuple(PRESETS))] | None = key("a pulse of the paper's Fig. 2, in place of shape")
    shape: Annotated[Text, among((*SHAPES, "measured"))] = key("shape of the incident pulse", "rectangular")
    duration: Number = None
    rise: Number = None
    fall: Number = None
    t1: Number = None
    level1: Number = None
    t2: Number = None
    level2: Number = None
    valley: Number = None
    file: Text | None = key("record beside the study, with columns of time and strain")
    columns: tuple[Text, ...] = key("names of the columns: time, then strain", ())
    time_unit: Annotated[Text, among(tuple(UNITS["time"]))] | None = key("unit of the time")
    unit: Annotated[Text, among(_signal_units)] | None = key("unit of the signal")
    gauge_factor: Positive | None = key("of the gauges")
    excitation: Positive | None = key("supply of the bridge [V]")
    amplification: Positive | None = key("of the signal")
    active_arms: Positive | None = key("1 quarter, 2 half bridge, 2 (1 + nu) with gauges across")
    polarity: Annotated[Text, among(("auto", "tension", "compression"))] | None = key("what is positive in the record")
    window: Annotated[tuple[Instant, ...], Check(_window)] | None = key("begin and end of the pulse in the record")
    correct_dispersion: Flag | None = key("carry the wave from the gauge to the sphere")
    gauge_distance: Length | None = key("distance of the gauge from the sphere")
    gain: Number = None
    noise: Flag | None = key("the noise of the record becomes random inputs")


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class ContactTable:
    """What a face does beyond Hertz: the softer of two bodies yields or crushes, or the sphere is damaged."""

    law: Annotated[Text, among(CONTACT_LAWS)] = key(
        '`"hertz"`; `"plastic"`: the softer body yields or crushes; `"damage"`: the sphere softens (Tavares)', "hertz"
    )
    dynamics: Annotated[Text, among(("auto", "elastic", "path"))] = key(
        '`"path"`: the law inside the equations of motion; `"elastic"`: the force by Hertz, the rest from the largest '
        'force; `"auto"`: by the rule of `[model] fidelity`',
        "auto",
    )
    onset_pressure: Number = key(
        "centre pressure at which a face begins to yield or to crush", default_is="that of the softer body"
    )
    hardness: Number = key(
        'mean pressure of a face that flows fully; `"onset"`: the same as the onset',
        default_is="that of the softer body",
    )
    pile_up: Number = key(
        "`a²` over `r` times the approach, far beyond yield: 1 to 3", default_is="`8/3` where a metal yields, else `2`"
    )
    gamma: Number = key("`damage`: exponent of the damage, 2 to 8", default_is="required by `damage`")
    fracture_energy: Number = key(
        '`damage`: specific fracture energy of the sphere; `{ same_as = "limits.NAME.strength" }` for a fixed one',
        default_is="required by `damage`",
    )
    blows: Annotated[Whole, within(1, 1000, closed=True)] = key(
        "`damage`: equal blows, each with the stiffness and fracture energy that the last has left", 1
    )


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class RigTable:
    """What loads the sphere; one of `speed` and `drop_height` where the sphere itself moves."""

    kind: Annotated[Text, among(tuple(RIG_TABLES))] = key(
        f"what loads the sphere: {one_of([f'`{shown(name)}`' for name in RIG_TABLES])}; the last where strengths come "
        "from laws or tests alone and a `[service.NAME]` asks",
        "bars",
    )
    speed: Number = key("closing speed; `impact` and `sphere_on_sphere` take it, or `drop_height`")
    drop_height: Number = key("height that the sphere falls from through air")
    angle: Number = key("between path and surface, above 5 deg; 90 deg is square on", default_is='`"90 deg"`')


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class PartnerTable:
    """What every body that touches the sphere has."""

    material: Text | None = key("fills `E`, `nu`, `density`, `yield_strength` that are not given")
    E: Number = key("Young's modulus", default_is="from the material")
    nu: Number = key("Poisson ratio", default_is="from the material")
    density: Number = key("density", default_is="from the material")
    yield_strength: Number = key("for the validity checks and a face that yields", default_is="from the material")
    onset_pressure: Number = key('centre pressure at which the face yields, with a contact that is "plastic"')
    hardness: Number = key("mean pressure of the face that flows fully")
    pile_up: Number = key("pile-up of the face far beyond yield")


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class TargetTable(PartnerTable):
    """What a sphere is thrown at, or lies on."""

    kind: Annotated[Text, among(PARTNER_KINDS)] = key(
        'a `"thick"` body, a `"plate"` that bends, the end of a `"bar"`, or a free `"mass"`', "thick"
    )
    thickness: Number = key("of a plate", default_is="required for a plate")
    width: Number = key("of a plate, for the check of its edges")
    mass: Number = key("of a free mass", default_is="required for a mass")
    diameter: Number = key("of a bar", default_is="required for a bar")
    length: Number = key("of a bar; without it nothing returns from its far end")
    end: Number = key("far end of a bar, as the ends of bars", default_is='`"free"`')
    face_radius: Number = key('radius of a rounded face; `"flat"` is flat', default_is="flat")


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class OtherTable(PartnerTable):
    """The other sphere, which is not judged."""

    radius: Number = key("radius of the other sphere", due='add radius = "10 mm"')


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class HammerTable(PartnerTable):
    """The weight that falls on the sphere, without drag; it is caught after the first blow."""

    mass: Number = key("mass of the weight", default_is="required, or a ball")
    shape: Annotated[Text, among(("ball",))] | None = key('`"ball"`: mass and `face_radius` follow from the `diameter`')
    diameter: Number = key("of a ball")
    face_radius: Number = key('radius of a rounded face; `"flat"` is flat', default_is="flat")
    speed: Number = key("speed at the sphere", default_is="one of `speed` and `drop_height`")
    drop_height: Number = key("height that the weight falls from", default_is="one of `speed` and `drop_height`")


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class RodTable(PartnerTable):
    """The rod of a load cell."""

    diameter: Number = key("diameter; the rod may be thinner than the sphere", due='add diameter = "20 mm"')
    length: Number = key("length", due='add length = "1.5 m"')
    end: Number = key("far end, as the ends of bars", default_is='`"free"`')
    gauge: Length | None = key("distance of the gauge from the sphere, for `history` alone")


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class PlatensTable(PartnerTable):
    """Two platens that press slowly."""

    force: Number = key("largest force", default_is="one of `force` and `displacement`")
    displacement: Number = key("largest approach of both contacts", default_is="one of `force` and `displacement`")
    speed: Number = key("speed of the crosshead, for rates")
    loading_rate: Number = key("loading rate in its place")
    machine_stiffness: Number = key("stiffness of the machine in series", default_is="rigid")


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class ServiceTable(RigTable):
    """A machine that the answer is wanted for: a rig with its tables nested."""

    kind: Annotated[Text, among(tuple(name for name in RIG_TABLES if name not in ("bars", "none")))] = key(
        "a rig but `bars`", "impact", due='add kind = "impact"'
    )
    target: TargetTable | None = key("as [target]")
    anvil: TargetTable | None = key("as [anvil]")
    other: OtherTable | None = key("as [other]")
    hammer: HammerTable | None = key("as [hammer]")
    rod: RodTable | None = key("as [rod]")
    platens: PlatensTable | None = key("as [platens]")
    solve: Text | None = key(
        'the number of the service that is free, as in [margins]: `"drop_height"`, `"hammer.drop_height"`'
    )
    between: Annotated[tuple[Raw, ...], Check(_ends, lambda: {"minItems": 2, "maxItems": 2})] | None = key(
        "two values with units, in order", default_is="required with `solve`"
    )


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class Gauge:
    """A strain gauge: its bar, and its distance from the sphere [m]."""

    bar: Annotated[Text, among(("incident", "receiving", "rod"))] = key(
        '`"incident"` or `"receiving"`; `"rod"` in a load cell', due='add bar = "incident"'
    )
    position: Length = key(
        "distance from the sphere, a length within the bar", due='add the distance from the sphere, position = "0.75 m"'
    )


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class ModelChoice:
    """Which mechanics, and how precisely; `horizon` [s]."""

    fidelity: Annotated[Text, among(FIDELITIES)] = key(
        '`"massless"`, `"linear"`, `"full"`, or the cheapest that is accurate enough, with `full` in rows where it is '
        "not; `massless` under a drop weight too, every other rig (a load cell among them) is `full` by `auto`",
        "auto",
    )
    tolerance: Annotated[Real, within(1e-12, 1e-2, closed=True)] = key(
        "relative error of the integration, in every quantity asked for; 1e-12 to 1e-2", 1e-6
    )
    first_loading_only: Flag = key("end the record when the first reflected wave is back", False)
    horizon: Seconds | None = key(
        "end of the record, a time",
        default_is="eight round trips of the longer bar; infinite bars: the pulse is over and both forces are below "
        "1 % of the largest",
    )
    compare_with_paper: Flag = key(
        "adds a table: the paper's printed massless formulas beside the corrected ones and the full model", False
    )
    stochastic: Flag = key(
        "a black box that answers the same row otherwise each time, the one key of this table for it: some rows are "
        "evaluated several times, and its own scatter is told apart from that of the inputs",
        False,
    )


def _parameter(name: str) -> Fixed:
    """A parameter of a criterion, as `uqsphere.mechanics.criteria.PARAMETERS` has it."""
    part = PARAMETERS[name]
    return Fixed(Quantity(name=name, symbol=name, dimension=part.dimension, lower=part.lower, upper=part.upper,
                          meaning=f"the {part.meaning}"))  # fmt: skip


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class LimitTable:
    """A strength, and the quantity or criterion that is held against it."""

    service: Text | None = key("service that it is asked of", default_is="the rig itself", named="in")
    quantity: Text | None = key("a quantity of `uqsphere list quantities`", default_is="required, or `criterion`")
    criterion: Annotated[Text, Check(lambda name: name, lambda: {"enum": list(CRITERIA)})] | None = key(
        "in place of `quantity`: a criterion of `uqsphere list criteria`, for the impact model"
    )
    modulus: Annotated[float, _parameter("modulus")] | None = key(
        "Weibull modulus of a weakest link; a strength that is a Weibull law has it already",
        default_is="that of the strength",
    )
    reference_volume: Annotated[float, _parameter("reference_volume")] | None = key(
        "volume on which the strength was measured", default_is="required by `weakest_link_volume`"
    )
    reference_area: Annotated[float, _parameter("reference_area")] | None = key(
        "area on which the strength was measured", default_is="required by `weakest_link_surface`, `weakest_link_rim`"
    )
    largest_energy: Annotated[float, _parameter("largest_energy")] | None = key(
        "`specific_energy`: upper bound of the fracture energy, whose law is then an upper-truncated lognormal"
    )
    rate_0: Annotated[float, _parameter("rate_0")] | None = key(
        "strain rate at which the strength has doubled: strengths in tension then grow with the rate of each sample"
    )
    energy_is: Annotated[Text, among(tuple(ENERGY_OF))] | None = key(
        'what a strength in J/kg means: energy stored in both bodies of all contacts, `"contact"`, the sphere\'s share '
        'of it, `"sphere"`, or what was offered, `"input"`',
        default_is="required with a rig that is not `bars`",
    )
    platens: Platens | None = key(
        "what a strength that is a law was measured between: `bars`, `rigid`, a material of bars, or a table of `E` "
        "and `nu`",
        default_is="the bars of the study, else `rigid`",
    )
    strength: Number = key(
        "what it is held against: value or distribution, in the unit of the quantity; or that of another limit, "
        '`{ same_as = "limits.NAME.strength" }`',
        due='add a number such as "4 GPa", or a distribution',
    )
    strength_is: Annotated[Text, among(("hertz", "pressure"))] | None = key(
        'which pressure the strength of a limit on pressure is: `"hertz"` (computed from a force by Hertz) or '
        '`"pressure"` (true)',
        default_is='required where the contact is `"plastic"`',
    )
    aim: Annotated[Text, among(("survive", "break"))] = key(
        '`"survive"`: the quantity must stay below the strength; `"break"`: it must exceed it', "survive"
    )
    model_factor: Number = key(
        "factor on the quantity for what the model leaves out; value or distribution", default_is="`1`"
    )
    target: Share | None = key("largest accepted probability of missing the aim, between 0 and 1")
    fracture: Flag | None = key(
        "whether exceeding it breaks the sphere: `true` for criteria, pressures, tensions, forces and energies; "
        "`false` for one that is no fracture, say bars that must stay elastic",
        default_is="by the quantity",
    )


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class Dependence:
    """One rank correlation, Spearman's or Kendall's, for every pair of the names; `dof` of a Student t copula."""

    of: Annotated[tuple[Text, ...], several(2, "names", 1_000)] = key(
        "two or more names of random variables", (), due="add the names of two or more random inputs"
    )
    spearman: Correlation | None = key(
        "Spearman's rank correlation, between -1 and 1; or `kendall` in its place", default_is="required"
    )
    copula: Annotated[Text, among(COPULAS)] = key(
        f"how they depend: {one_of([f'`{shown(name)}`' for name in COPULAS])}", "gaussian"
    )
    kendall: Correlation | None = key("Kendall's rank correlation, between -1 and 1")
    dof: Annotated[Real, Check(lambda value: value, lambda: {"minimum": LEAST_DOF, "maximum": MOST_DOF})] | None = key(
        "degrees of freedom of a Student t copula, 1 to 1000; required there, and for no other"
    )


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class Accuracy:
    """Half-widths of the 95 % intervals asked for: mean and quantile over sd, sobol absolute, probability relative.

    `curve` is that of the probability at every value of a fragility curve, over the smaller side of that probability.
    Infinite is what a study that names another of the first four leaves open.
    """

    mean: Positive = 0.002
    quantile: Positive = 0.01
    sobol: Positive = 0.01
    probability: Positive = 0.05
    curve: Positive = 0.02


#: which accuracy each kind of answer is held against
_PURSUED: Final = {"mean": "mean", "quantile": "quantile", "indices": "sobol", "exceedance": "probability",
                   "miss": "probability"}  # fmt: skip


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class Budget:
    """Where a run stops at the latest; `time` [s].

    `exhaust` spends all of it on an accuracy that is out of its reach; else such an accuracy is given up.
    """

    evaluations: Annotated[Whole, within(0.0)] = 2_000_000
    time: Seconds = 600.0
    exhaust: Flag = False


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class ToleranceRequest:
    """Distribution-free limits from independent runs: the share that they hold, with which confidence.

    `runs` are by default the fewest that give a two-sided interval.
    """

    coverage: Share = 0.95
    confidence: Share = 0.95
    runs: Annotated[Whole, within(0.0)] = 0


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class Analysis:
    """What is asked, how precisely, and at what cost.

    `cost` is what one evaluation of a black box takes [s]; None: it is measured.  `rows_per_call` rows go into one
    call of a black box, by their number if None; `time_limit` [s] ends an evaluation, none if None.
    """

    quantities: Names = key(
        "what is answered; quantities of limits are added",
        (),
        default_is='those of the limits, else `["p_max", "contact_time"]`',
    )
    accuracy: Accuracy = key(
        "half-widths of the 95 % intervals: mean and quantile relative to the standard deviation (half the 16-84 % "
        "range where it has none), sobol absolute, probability relative, curve relative to the smaller side; where one "
        "of the first four is given, no evaluations are spent on those that are not",
        Accuracy,
    )
    budget: Budget = key(
        "where the run stops at the latest; see below for `exhaust`",
        Budget,
        default_is='`{ evaluations = 2_000_000, time = "10 min", exhaust = false }`',
    )
    quantiles: Shares = key("between 0 and 1", (0.01, 0.05, 0.5, 0.95, 0.99))
    methods: Methods = key(
        f"or a list of {one_of([f'`{shown(name)}`' for name in METHODS])}", ("auto",), default_is='`"auto"`'
    )
    cost: Seconds | None = key(
        'what one evaluation of a black box takes, such as `"10 s"`; see below', default_is="measured"
    )
    ways: Annotated[Text, among(("all", "given"))] = key(
        '`"all"`: the sphere of a rock is judged by every way to break, with strengths of the library where the study '
        'has no limit; `"given"`: by its limits alone',
        "all",
    )
    on_failure: Annotated[Text, among(("abort", "bound", "drop"))] = key(
        'failed evaluations: `"abort"` at the first; `"bound"` counts each once as exceeding and once as not; '
        '`"drop"` leaves them out, up to 1 % (below 1,000 evaluations: what chance makes of 1 %)',
        "abort",
    )
    second_order: Flag = key("indices of all pairs of inputs as well", False)
    groups: Mapping[Text, Names] = key("indices of inputs taken together, each group by a name of yours", {})
    fields: Mapping[Text, Annotated[Whole, within(2, MOST_PLACES, closed=True)]] = key(
        "answers that are vectors, each with the number of its places: `force_a` and `force_b` over time, or arrays "
        "that a black box returns beside its outputs; 2 to 10,000",
        {},
    )
    tolerance_intervals: ToleranceRequest | None = key(
        "distribution-free limits: `coverage` and `confidence`, both 0.95 unless given, and `runs`, by default the "
        "fewest that give a two-sided interval"
    )
    rows_per_call: Annotated[Whole, within(1, _MOST_ROWS, closed=True)] | None = key(
        "rows in one call of a black box: [cluster.md](cluster.md)", default_is="by their number"
    )
    at_once: Annotated[Whole, within(1, 64, closed=True)] = key(
        "runs of an expensive black box that are chosen together where it learns, for machines that make as many side "
        "by side: 8 take about a quarter more of them in all",
        1,
    )
    time_limit: Seconds | None = key("longest time of one evaluation of a black box; one that takes longer has failed")

    def pursues(self, kind: str) -> bool:
        """Whether evaluations are spent on the accuracy of a kind of answer."""
        return kind not in _PURSUED or math.isfinite(getattr(self.accuracy, _PURSUED[kind]))

    @property
    def affordable(self) -> float:
        """Evaluations that the budget has room for, in its time too where an evaluation's is given."""
        return min(self.budget.evaluations, self.budget.time / self.cost if self.cost else math.inf)

    @property
    def samples_indices(self) -> bool:
        """Whether runs are paired for indices."""
        return bool({"auto", "sobol"} & set(self.methods)) and self.pursues("indices")


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class FamilyTable:
    """Another number of the scene, and values of it."""

    path: Text = key("number of the scene", due='add path = "sphere.radius"')
    values: Annotated[tuple[Raw, ...], several(1, "values", 12)] = key(
        "its values", (), due='add values = ["5 mm", "10 mm"]'
    )


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class MarginsTable:
    """The inverse question."""

    solve: Text = key(
        'the number that is free, such as `"striker.speed"`, `"hammer.drop_height"`, `"service.chute.drop_height"`',
        due='add the number that is free, such as solve = "striker.speed"',
    )
    between: Annotated[tuple[Raw, ...], Check(_ends, lambda: {"minItems": 2, "maxItems": 2})] = key(
        "two values with units, in order", (), due="add the lowest and the highest value to look at"
    )
    for_probability: Shares = key("probabilities that the quantity exceeds the strength", (0.01, 0.1, 0.5, 0.9, 0.99))
    for_survival: Shares | None = key(
        "probabilities of survival, added to those: 0.99 asks for a probability of fracture of 0.01"
    )
    for_fracture: Shares | None = key("probabilities of fracture, added as they are")
    family: FamilyTable | None = key("a curve at each of some `values` of another number of the scene, its `path`")
    bars_elastic: Flag = key(
        "also the value at which the bars yield, in the pulse and under the sphere in 1 % of the rows; told in any "
        "case where `p_max` is asked for",
        False,
    )
    against: Text | None = key('`"specific_energy"`: every curve also over the specific energy imposed on the sphere')


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class EmpiricalTable:
    """A distribution from a column of observations."""

    dist: Text = "empirical"
    file: Text = key("CSV beside the study", due='add file = "tests.csv"')
    column: Text = key("column of the CSV", due='add column = "strength"')
    unit: Text | None = key("unit of the column")
    fit: Text | None = key("`kde` (smooth), `steps` (the observations), or a distribution that is fitted to them")
    lower: Number = None
    upper: Number = None
    censored: Text | None = key("column of flags: tests stopped before a failure")
    unbiased: Flag = key("takes the bias of few tests out of the modulus or the scatter", False)
    made_up: Flag = key("the observations were made up, so that no verdict is established by them", False)


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class OutputsTable:
    """What a black box answers."""

    names: tuple[Text, ...] = key("names of the outputs", ())


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class Document:
    """A study file."""

    title: Text = key("heading of the report; not part of the study's hash", "", default_is="the file's name")
    seed: Annotated[Whole, within(0.0, closed=True)] = key("whole number; the same seed gives the same answers", 0)
    sphere: SphereTable | None = None
    bars: BarsTable | None = None
    striker: StrikerTable | None = None
    pulse: PulseTable | None = None
    contact: ContactTable | None = None
    product: ProductTable | None = None
    material: MaterialTable | None = None
    feed: FeedTable | None = None
    tests: TestsTable | None = None
    rig: RigTable | None = None
    target: TargetTable | None = None
    anvil: TargetTable | None = None
    other: OtherTable | None = None
    hammer: HammerTable | None = None
    rod: RodTable | None = None
    platens: PlatensTable | None = None
    service: Mapping[Text, ServiceTable] = Field(default_factory=dict)
    model: ModelChoice | None = None
    inputs: Mapping[Text, Number] | None = None
    outputs: OutputsTable | None = None
    limits: Mapping[Text, LimitTable] = Field(default_factory=dict)
    dependence: tuple[Dependence, ...] = ()
    gauges: tuple[Gauge, ...] = ()
    analysis: Analysis = Field(default_factory=Analysis)
    margins: MarginsTable | None = None

    @property
    def rig_kind(self) -> str:
        """What loads the sphere, a key of `RIG_TABLES`."""
        return "bars" if self.rig is None else self.rig.kind
