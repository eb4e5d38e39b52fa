"""The failure modes that a study has no limit for, assessed with library strengths, and what its
crushing tests leave of these.

Each sphere of the tests stood up to its force, so that every one of its strengths is at least the
demand at that force in the test rig, and F(demand) of a true strength lies below a uniform
variable: the one-sided Kolmogorov-Smirnov distance has at most its usual probability.  (The product
of the probabilities to stand would refute every true strength, because at the forces of failure it
is a product of uniform variables.)
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from uqsphere.arrays import Array, Values, frozen
from uqsphere.materials import Material, Property, library
from uqsphere.mechanics.criteria import CRITERIA
from uqsphere.mechanics.crushing import value_at
from uqsphere.mechanics.failure_modes import FAILURE_MODES, FailureMode, failure_place
from uqsphere.quantities import format_value, lookup
from uqsphere.results.types import EvidenceEntry
from uqsphere.study import Limit, Study, default_target
from uqsphere.study.values import Tested
from uqsphere.uq import Law, make_law, student

#: a strength, or a distribution, that makes the tests less probable than this is refuted
REFUTED = 0.05


#: behind the name of a mode, in that of its limit
_ASSUMED = " (assumed)"


@frozen
class AssumedLimit(Limit):
    """The limit of a failure mode that a study has none for."""

    @property
    def subject(self) -> str:
        """Its name in the table of answers."""
        return f"modes.{self.name.removesuffix(_ASSUMED)}"


@frozen
class AssumedMode:
    """A failure mode with a library strength: its limit, and the strength at both ends of the
    library's 95 % range.

    declared : what the mode is
    entry : the strength as the library has it
    counts : whether it means fracture; damage of the surface is shown only
    """

    declared: FailureMode
    limit: Limit
    weak: Law
    strong: Law
    entry: Property
    counts: bool

    @property
    def called(self) -> str:
        """The name of the mode."""
        return self.declared.name

    @property
    def middle(self) -> Law:
        """The strength that the limit has."""
        assert isinstance(self.limit.strength, Law)
        return self.limit.strength


def breaks_by(limit: Limit) -> str:
    """Place of the failure mode that a limit is on, see `failure_place`.

    >>> breaks_by(Limit(name="a", quantity="core_tension", strength=1e7))
    'core'
    """
    return failure_place(lookup(limit.quantity))


def means_fracture(limit: Limit) -> bool:
    """Whether a limit is on a failure mode; one that must break means it, also where it is not
    counted twice.
    """
    return breaks_by(limit) != "" and (limit.fracture is not False or limit.aim == "break")


def failure_modes_of(study: Study) -> tuple[list[AssumedMode], dict[str, str]]:
    """The failure modes without a limit, with assumed strengths, and why others are not assessed;
    none if no limit means fracture, or if the study excludes them.
    """
    limited = {breaks_by(limit) for limit in study.limits if means_fracture(limit)}
    if study.black_box or study.analysis.failure_modes == "given" or not limited:
        return [], {}
    material = library().get(study.materials.get("sphere", ""))
    assumed = []
    not_judged = {}
    for mode in FAILURE_MODES.values():
        # the fracture energies of the library are those of rock particles
        rock = material and material.rock
        if mode.place in limited or (mode.size_law == "particle" and not rock):
            continue
        reason = _not_judged(study, mode, material)
        if reason:
            not_judged[mode.name] = f"no strength: {reason}"
        else:
            assert material
            assumed.append(_assumed(study, mode, material))
    return assumed, not_judged


def _not_judged(study: Study, mode: FailureMode, material: Material | None) -> str:
    """Why a failure mode is not assessed; empty if it is."""
    if not material:
        return "the study names no material of the library; add a limit with your own strength"
    strength = material.properties.get(mode.strength)
    if not strength:
        title = f"{material.title[:1].lower()}{material.title[1:]}"
        return f"neither the study nor the library has one for {title}"
    if mode.size_law == "volume" and not (
        "volume" in strength.further and "weibull_modulus" in material.properties
    ):
        return "the library's strength is of no known volume"
    if not strength.range and material.rock:
        return "the library gives no range for it"
    # the sphere begins to yield at a pressure of the study or the library
    entry = material.properties.get("onset_pressure")
    usual = entry.value if entry else 0.0
    onset = study.at_means().get("sphere.onset_pressure", usual)
    if mode.place == "contact" and strength.value < onset:
        contact, least = (format_value(value, "p_max") for value in (strength.value, onset))
        return (
            f"the library's contact strength {contact} is below the onset of yield {least} of the "
            "sphere"
        )
    return ""


def _assumed(study: Study, mode: FailureMode, material: Material) -> AssumedMode:
    """A failure mode with the library strength of a material, for spheres of the mean diameter."""
    entry = material.properties[mode.strength]
    spread = math.exp(student(math.inf) * entry.cov)
    ends = entry.range or (entry.value / spread, entry.value * spread)
    parameters = {}
    criterion = None
    # a strength measured on a specimen says nothing of a volume a million times smaller without
    # its size law
    if mode.size_law == "volume":
        criterion = mode.criterion
        parameters = {
            "modulus": material.properties["weibull_modulus"].value,
            "reference_volume": entry.further["volume"],
        }
    size = size_factor(mode, entry, 2.0 * study.at_means()["sphere.radius"])

    def strength(value: float) -> Law:
        """The distribution with the mean, or median, `value`."""
        if mode.size_law == "volume":
            return make_law("weibull", {"mean": value, "modulus": parameters["modulus"]})
        if mode.size_law == "particle":
            return make_law("lognormal", {"log_mean": math.log(value * size), "log_sd": entry.cov})
        return make_law("lognormal", {"mean": value, "cov": entry.cov})

    name = mode.name + _ASSUMED
    weak, strong = map(strength, ends)
    return AssumedMode(
        declared=mode,
        limit=AssumedLimit(
            name=name,
            quantity=CRITERIA[mode.criterion].quantity or f"{mode.criterion}.{name}",
            strength=strength(entry.value),
            target=default_target(study.limits, study.margins, "survive"),
            criterion=criterion,
            parameters=parameters,
        ),
        weak=weak,
        strong=strong,
        entry=entry,
        counts=not mode.damage or study.analysis.damage_counts,
    )


def size_factor(mode: FailureMode, entry: Property, diameter: Values) -> Values:
    """Strength of a mode for spheres of a diameter [m] over the library value, apart from the size
    effect in its criterion: of particles that of their median fracture energy (Tavares and King
    1998, equation 15).
    """
    if mode.size_law != "particle":
        return 1.0
    return 1.0 + (entry.further["size"] / diameter) ** entry.further["exponent"]


def scaled_strength(law: Law, factor: float) -> Law:
    """A Weibull or lognormal strength with all its values multiplied."""
    parameters = dict(law.parameters)
    if law.family.name == "lognormal":
        parameters["log_mean"] += math.log(factor)
    else:
        parameters["scale"] *= factor
    return replace(law, parameters=parameters)


# --- what crushing tests say of strengths of the library ------------------------------------------


def judged_by_tests(
    study: Study, modes: list[AssumedMode]
) -> tuple[list[EvidenceEntry], list[AssumedMode]]:
    """The evidence on every assumed mode, and the modes that are left, with what is left of their
    range.
    """
    series = {
        limit.tested.forces: limit.tested
        for limit in study.limits
        if limit.tested and limit.tested.forces
    }
    if not series:
        return [], modes
    results = []
    modes_left = []
    for mode in modes:
        demands = demands_in_tests(study, [*series.values()], mode)
        weak, middle, strong = standing(
            np.array([law.cdf(demands) for law in (mode.weak, mode.middle, mode.strong)])
        ).tolist()
        refuted = strong < REFUTED
        raised = 1.0
        if weak < REFUTED and not refuted:
            # the strong end of a range may be of another scatter than its weak end
            (factor,) = least_factor(mode.weak, demands[None, :])
            raised = min(factor, median(mode.strong) / median(mode.weak))
        results.append(
            EvidenceEntry(
                mode=mode.called,
                tests=len(demands),
                weak=weak,
                middle=middle,
                strong=strong,
                refuted=refuted,
                raised=raised,
            )
        )
        if not refuted:
            least = scaled_strength(mode.weak, raised)
            limit = replace(mode.limit, strength=max(mode.middle, least, key=median))
            modes_left.append(replace(mode, weak=least, limit=limit))
    return results, modes_left


def demands_in_tests(study: Study, series: Sequence[Tested], mode: AssumedMode) -> Array:
    """The demand (n,) of a mode in each test at its force, over its size factor for that sphere."""
    mean = size_factor(mode.declared, mode.entry, 2.0 * study.at_means()["sphere.radius"])
    parts = []
    for tested in series:
        diameters = np.array(tested.diameters)
        demand = value_at(
            np.array(tested.forces),
            mode.limit.demand,
            tested.sphere,
            0.5 * diameters,
            tested.platens,
        )
        parts.append(demand / (size_factor(mode.declared, mode.entry, diameters) / mean))
    return np.concatenate(parts)


def standing(below: Array) -> Array:
    """Probability (J,) of J series of tests, from F(demand at the force that was borne) (J, n).

    >>> standing(np.array([[0.1, 0.3, 0.5, 0.7, 0.9], [0.9, 0.95, 0.97, 0.98, 0.99]])).round(3)
    array([0.854, 0.   ])
    """
    from scipy.stats import ks_1samp, uniform

    return np.asarray(ks_1samp(below, uniform.cdf, alternative="less", axis=1).pvalue)


def least_factor(law: Law, demands: Array) -> Array:
    """What a strength must be multiplied by (J,) at least for J series of tests, whose spheres bore
    demands (J, n), not to refute it.
    """
    from scipy.stats import ksone

    n = demands.shape[1]
    below = np.arange(n) / n + ksone.isf(REFUTED, n)
    inside = below < 1.0
    ordered = np.sort(demands, axis=1)[:, inside]
    return np.asarray((ordered / law.ppf(below[inside])).max(axis=1))


def median(law: Law) -> float:
    """The median of a distribution."""
    return float(law.ppf(0.5))
