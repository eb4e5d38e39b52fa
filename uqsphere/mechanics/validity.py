"""Validity checks: every row against the assumptions of the model, theory section 9.

Each check measures one number per row and grades it 0 ok, 1 note, 2 warning or 3 failure.  A breach
never stops a run; it is reported with the percentage of rows concerned.  Failed rows (status not 0)
are excluded.  Thresholds and sentences are in ``validity.toml``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce

import numpy as np

from uqsphere.arrays import Array, Flags, Places
from uqsphere.mechanics import bars, contact
from uqsphere.mechanics.criteria import CRITERIA, Parameters, ranges_of
from uqsphere.mechanics.inputs import declared
from uqsphere.mechanics.outputs import SceneAnswers, loss_to_waves
from uqsphere.mechanics.rigs import GRAVITY, sphere_body, terminal_speed
from uqsphere.mechanics.scene import Scene, answered
from uqsphere.mechanics.yielding import ContactParameters, Face, softer

#: residual indentation [m] beyond which a lapped flat needs lapping again
_RELAP = 1e-6
#: largest force difference over P_0 under a step pulse is 1.318 mu^0.45 for small mu, theory
#: section 5
_IMBALANCE = (1.318, 0.45)
#: the share of the samples whose largest number is told too, if it is below so much of the worst
_USUAL = 0.95
_FAR = 0.9


@dataclass(frozen=True, kw_only=True)
class Rule:
    """One check: thresholds of its grades 1, 2, 3 and its sentence; fields as in validity.toml."""

    key: str
    name: str
    words: str
    information: float = math.nan
    warning: float = math.nan
    failure: float = math.nan
    rising: bool = True
    law: str = ""
    movers: Sequence[str] = ()
    needs: str = ""

    @property
    def thresholds(self) -> tuple[float, float, float]:
        """Thresholds of the grades 1, 2 and 3; NaN for a grade without one."""
        return self.information, self.warning, self.failure

    def applies(self, scene: Scene) -> bool:
        """Whether it is made for the contact law, the rig and the columns of a scene."""
        return (
            self.law in ("", scene.contact_law)
            and (not self.movers or scene.setup.mover in self.movers)
            and (not self.needs or self.needs in scene.columns)
        )


RULES = {
    key: Rule(**{"key": key, "name": key, **entry})
    for key, entry in declared("validity.toml").items()
}


@dataclass(frozen=True, kw_only=True)
class ValidityCheck:
    """Result of one check over a batch.

    shares: fractions of the computed rows with the grades 1, 2 and 3.  worst: the worst measured
    number, None if the check could not be made.  text: the sentence on a breach.  grades (n,): of
    every row, 0 without a number.
    """

    check: str
    shares: tuple[float, ...] = (0.0, 0.0, 0.0)
    worst: float | None = None
    text: str = ""
    grades: Places = field(repr=False, compare=False)

    @property
    def grade(self) -> int:
        """The highest grade that any row has."""
        return max((grade for grade in (1, 2, 3) if self.shares[grade - 1] > 0.0), default=0)

    @property
    def share(self) -> float:
        """Fraction of the rows that break the check."""
        return sum(self.shares)


# --- what the checks measure: functions of a scene and its answers --------------------------------


def softest_partner(scene: Scene) -> ContactParameters:
    """Contact parameters of the counter-body that yields first in each row."""
    return reduce(softer, [partner.body for partner in scene.there])


def _over_onset(pressure: Array, onset: Array) -> Array:
    """Contact pressure / onset pressure; NaN for a body that does not yield."""
    return np.asarray(pressure / np.where((onset > 0.0) & np.isfinite(onset), onset, np.nan))


def _over_partner_onset(scene: Scene, answers: SceneAnswers) -> Array:
    """Hertz pressure at peak force / onset pressure of the counter-bodies; the largest."""
    force = answers.values["P_max"]
    ratios = [
        _over_onset(
            contact.pressure_at_force(force, partner.modulus, partner.effective_radius),
            partner.body.onset,
        )
        for partner in scene.there
    ]
    return np.asarray(np.fmax.reduce(ratios))


def _static_estimate(
    scene: Scene, answers: SceneAnswers, good: Flags, body: ContactParameters
) -> str:
    """Pressure and indentation, by statics, of a body that was taken as elastic."""
    scales = scene.scales
    law = Face(**body._asdict(), modulus=scales.modulus, effective_radius=scales.effective_radius)
    rows = np.flatnonzero(good & np.isfinite(body.onset) & np.isfinite(body.hardness))
    face = law.at(rows)
    press = face.pressed(face.depth_at(answers.values["P_max"][rows]))
    centre = press.centre[np.isfinite(press.centre)]
    dent = press.dent[np.isfinite(press.dent)]
    if len(centre) == 0 or len(dent) == 0:
        return ""
    pressure = f"{centre.max() / 1e9:.3g} GPa"
    depth = f"{1e6 * dent.max():.2g} um"
    return f". Static plastic estimate: p_max up to {pressure}, indentation {depth}"


def _at_peak(
    scene: Scene, answers: SceneAnswers, number: Callable[[Face, Array], Array]
) -> Array | None:
    """A number of each contact that yields, at the depth of the peak force; the largest."""
    faces = [partner.face for partner in scene.there if partner.face is not None]
    if not faces:
        return None
    force = answers.values["P_max"]
    return np.asarray(np.maximum.reduce([number(face, face.depth_at(force)) for face in faces]))


def _depth(scene: Scene, answers: SceneAnswers) -> Array | None:
    return _at_peak(scene, answers, lambda face, depth: depth)


def _relative_dent(scene: Scene, answers: SceneAnswers) -> Array | None:
    return _at_peak(
        scene, answers, lambda face, depth: face.pressed(depth).dent / face.effective_radius
    )


def _dents(scene: Scene, answers: SceneAnswers, good: Flags) -> str:
    depths = _at_peak(scene, answers, lambda face, depth: face.pressed(depth).dent)
    assert depths is not None
    deepest = np.nanmax(depths[good])
    text = f". Residual indentation: up to {1e6 * deepest:.2g} um"
    flats_yield = bool((softest_partner(scene).onset <= sphere_body(scene.columns).onset).any())
    # faces that are used again: those of bars and platens
    if flats_yield and deepest > _RELAP and scene.setup.mover in ("striker", ""):
        text += "; lap the flat faces again"
    return text


def _other_onset(scene: Scene, answers: SceneAnswers) -> Array | None:
    """Onset ratio of the harder and the softer body, the least of the contacts that yield.

    It is 1 where the body with the higher onset has the lower hardness.
    """
    sphere = sphere_body(scene.columns)
    ratios = []
    for partner in scene.there:
        if partner.face is not None:
            body = partner.body
            ratio = np.maximum(body.onset, sphere.onset) / np.minimum(body.onset, sphere.onset)
            crossed = (body.onset < sphere.onset) != (body.hardness < sphere.hardness)
            ratios.append(np.where(crossed & np.isfinite(ratio), 1.0, ratio))
    if not ratios:
        return None
    return np.asarray(np.fmin.reduce(ratios))


def _pulse_over_yield(scene: Scene, answers: SceneAnswers) -> Array:
    c = scene.columns
    level = np.ones(len(scene))
    if scene.shape == "two_peak":
        level = np.maximum(c["pulse.level1"], c["pulse.level2"])
    if scene.striker_ratio is not None:
        level = 2.0 * scene.striker_ratio / (1.0 + scene.striker_ratio)
    stress = level * bars.pulse_stress(c["striker.speed"], c["bars.E"], c["bars.density"])
    return _over_onset(stress, scene.column("bars.yield_strength"))


def _imbalance(scene: Scene, answers: SceneAnswers) -> Array:
    measured = answers.values["force_imbalance"]
    if np.any(measured > 0.0):
        return measured
    # forces of the massless model are balanced by assumption: the mass number gives an estimate
    factor, power = _IMBALANCE
    estimate = factor * scene.scales.mass_number**power
    return estimate * scene.scales.force / answers.values["P_max"]


def _transits(scene: Scene, time: Array) -> Array:
    """Wave transits of the sphere, 2 r/sqrt(E/rho), in a time."""
    c = scene.columns
    transit = 2.0 * c["sphere.radius"] / bars.wave_speed(c["sphere.E"], c["sphere.density"])
    return np.asarray(time / transit)


def _bars(scene: Scene) -> list[tuple[Array, Array]]:
    """Diameters and wave speeds of the counter-bodies that are bars."""
    pairs = []
    for partner in scene.there:
        if partner.kind == "bar":
            diameter, E, density = scene.numbers(partner.table, "diameter E density")
            pairs.append((diameter, bars.wave_speed(E, density)))
    return pairs


def _contact_over_bar(scene: Scene, answers: SceneAnswers) -> Array | None:
    ratios = [2.0 * answers.values["a_max"] / diameter for diameter, _ in _bars(scene)]
    if not ratios:
        return None
    return np.asarray(np.maximum.reduce(ratios))


def _rod_rise(scene: Scene, answers: SceneAnswers) -> Array | None:
    rise = answers.values["rise_time"]
    ratios = [rise * speed / (0.5 * diameter) for diameter, speed in _bars(scene)]
    if not ratios:
        return None
    return np.asarray(np.minimum.reduce(ratios))


def _pulse_rise(scene: Scene, answers: SceneAnswers) -> Array | None:
    c = scene.columns
    breaks = scene.pulse.breaks
    if scene.shape in ("rectangular", "step"):
        return None
    if scene.shape == "trapezoid":
        rise = np.minimum(c["pulse.rise"], c["pulse.fall"])
    elif scene.record is not None:
        rise = np.full(len(scene), scene.record.rise / 0.8)
    elif scene.shape == "ramp":
        rise = c["pulse.rise"]
    elif scene.shape == "two_peak":
        rise = np.minimum(breaks[:, 1], breaks[:, 4] - breaks[:, 3])
    else:
        rise = 0.5 * scene.pulse.end
    return np.asarray(
        rise * bars.wave_speed(c["bars.E"], c["bars.density"]) / (0.5 * c["bars.diameter"])
    )


def _ideal_pulse(scene: Scene, answers: SceneAnswers) -> Array | None:
    if scene.shape not in ("rectangular", "step"):
        return None
    return np.zeros(len(scene))


def _record_over_echo(scene: Scene, answers: SceneAnswers) -> Array | None:
    if not scene.infinite:
        return None
    # an end that is given as absorbing reflects nothing; one that is not given may
    echoing = [scene.column(f"bars.{bar}_end", 1.0) != 0.0 for bar in ("incident", "receiving")]
    first = np.where(np.stack(echoing, axis=1), scene.round_trips, np.inf).min(axis=1)
    return np.asarray(answers.record / np.where(np.isfinite(first), first, np.nan))


def _echo_under_load(scene: Scene, answers: SceneAnswers) -> Array | None:
    if not np.any(np.isfinite(scene.first_echo)):
        return None
    return answers.values["loaded_time"] / scene.first_echo


def _plate(scene: Scene) -> list[Array] | None:
    """E, nu, density, thickness and width of the counter-body that is a plate."""
    for partner in scene.there:
        if partner.kind == "plate":
            return scene.numbers(partner.table, "E nu density thickness width")
    return None


def _thin_plate(scene: Scene, answers: SceneAnswers) -> Array | None:
    """Thickness over contact radius, or wave transits of the thickness if fewer, but at least 2.

    A plate that is thick for the contact time is no failure: the kind `thick` fits it better.
    """
    plate = _plate(scene)
    if plate is None:
        return None
    E, nu, density, thickness, _ = plate
    sound = np.sqrt(E * (1.0 - nu) / (density * (1.0 + nu) * (1.0 - 2.0 * nu)))
    transits = answers.values["loaded_time"] * sound / (2.0 * thickness)
    return np.asarray(np.minimum(thickness / answers.values["a_max"], np.maximum(transits, 2.0)))


def _plate_edge(scene: Scene, answers: SceneAnswers) -> Array | None:
    """Contact time over the return time of the flexural wave from the plate edge.

    The group speed is that of a half period equal to the contact time t, c_g = 2 (D/(rho h))^(1/4)
    sqrt(pi/t), over a path of one width.
    """
    plate = _plate(scene)
    if plate is None:
        return None
    E, nu, density, thickness, width = plate
    loaded = answers.values["loaded_time"]
    bending = E * np.square(thickness) / (12.0 * (1.0 - nu * nu) * density)
    return np.asarray(loaded * 2.0 * bending**0.25 * np.sqrt(np.pi / loaded) / width)


def _gravity(scene: Scene, answers: SceneAnswers) -> Array:
    behind = scene.partners[0]
    moving = scene.scales.mass
    if behind is not None:
        moving = moving + behind.mass
    return moving * GRAVITY / answers.values["P_max"]


def _drag(scene: Scene, answers: SceneAnswers) -> Array:
    c = scene.columns
    terminal = terminal_speed(c["sphere.radius"], c["sphere.density"])
    return c["rig.drop_height"] * GRAVITY / terminal**2


def _small_contact(scene: Scene, answers: SceneAnswers) -> Array:
    return answers.values["a_max"] / scene.columns["sphere.radius"]


def _one_sided(scene: Scene, answers: SceneAnswers) -> Array:
    ratio = _small_contact(scene, answers)
    imbalance = answers.values.get("force_imbalance")
    if imbalance is None:
        return ratio
    return np.where(imbalance > 0.1, ratio, np.nan)


#: the number that each check measures, (n,), NaN for rows it does not apply to; None for a scene
#: it does not apply to
MEASURES: dict[str, Callable[[Scene, SceneAnswers], Array | None]] = {
    "small_contact": _small_contact,
    "contact_on_bar_end": _contact_over_bar,
    "bar_yield_contact": lambda s, a: _over_onset(a.values["p_max"], softest_partner(s).onset),
    "bar_yield_pulse": _pulse_over_yield,
    "force_balance": _imbalance,
    "quasi_static_sphere": lambda s, a: _transits(s, a.values["rise_time"]),
    "one_dimensional_bars": _pulse_rise,
    "ideal_pulse": _ideal_pulse,
    "force_level": lambda s, a: s.scales.pulse_number,
    "before_reflection": _record_over_echo,
    "sphere_yield_contact": lambda s, a: _over_onset(
        a.values["p_max"], sphere_body(s.columns).onset
    ),
    "dented": _depth,
    "softer_body": _other_onset,
    "plastic_range": _depth,
    "deep_dent": _relative_dent,
    "insert_thickness": lambda s, a: 3.0 * a.values["a_max"] / s.column("bars.insert_thickness"),
    "pressure_shape": _depth,
    "quasi_static_impact": lambda s, a: _transits(s, a.values["loaded_time"]),
    "face_yield": _over_partner_onset,
    "thin_plate": _thin_plate,
    "plate_edge": _plate_edge,
    "gravity": _gravity,
    "drag": _drag,
    "oblique": lambda s, a: np.rad2deg(s.columns["rig.angle"]),
    "wave_loss": lambda s, a: loss_to_waves(s),
    "one_dimensional_rod": _rod_rise,
    "echo_in_contact": _echo_under_load,
    "grazing_contact": lambda s, a: a.grazes,
    "chatter": lambda s, a: a.values["retouches"],
    "one_sided_field": _one_sided,
}
#: what is added to the sentence on a breach, from the scene, its answers and the computed rows
ADVICE: dict[str, Callable[[Scene, SceneAnswers, Flags], str]] = {
    "bar_yield_contact": lambda s, a, good: _static_estimate(s, a, good, softest_partner(s)),
    "sphere_yield_contact": lambda s, a, good: _static_estimate(s, a, good, sphere_body(s.columns)),
    "dented": _dents,
    "face_yield": lambda s, a, good: _static_estimate(s, a, good, softest_partner(s)),
}


# --- the checks of a batch ------------------------------------------------------------------------


def grades_of(rule: Rule, measured: Array) -> Places:
    """Grade 0 to 3 of every row; a row without a number is graded 0.

    >>> grades_of(RULES["small_contact"], np.array([0.1, 0.25, 0.4, np.nan])).tolist()
    [0, 2, 3, 0]
    """
    grades = np.zeros(len(measured), dtype=np.int64)
    for grade, threshold in enumerate(rule.thresholds, start=1):
        beyond = measured > threshold if rule.rising else measured < threshold
        grades[beyond] = grade
    return grades


def check_validity(
    scene: Scene, answers: SceneAnswers, quantities: Collection[str] = ()
) -> list[ValidityCheck]:
    """Every check that applies to a batch, on its answers, in the order of `RULES`.

    quantities: names whose criteria have a range of validity; each gets one more check, named
    ``range_of_QUANTITY``, at the peak force of each row.  Raises ValueError for answers of another
    batch.
    """
    if len(answers.status) != len(scene):
        raise ValueError(f"the scene has {len(scene)} rows, the answers have {len(answers.status)}")
    good = answered(answers.status)
    with np.errstate(all="ignore"):
        measured = {
            key: MEASURES[key](scene, answers) for key, rule in RULES.items() if rule.applies(scene)
        }
        checks = [
            _check(RULES[key], scene, answers, good, values)
            for key, values in measured.items()
            if values is not None
        ]
    return checks + _check_ranges(scene, answers, good, quantities)


def _check(
    rule: Rule, scene: Scene, answers: SceneAnswers, good: Flags, measured: Array
) -> ValidityCheck:
    grades = grades_of(rule, measured)
    usable = good & ~np.isnan(measured)
    if not usable.any():
        return ValidityCheck(check=rule.name, grades=grades)
    numbers = measured[usable]
    worst = float(numbers.max() if rule.rising else numbers.min())
    shares = np.bincount(grades[usable], minlength=4)[1:] / len(numbers)
    text = ""
    broken = float(shares.sum())
    if broken > 0.0:
        shown = f"{worst:.3g}" if np.isfinite(worst) else "unlimited"
        if rule.rising and broken > 1.0 - _USUAL:
            most = float(np.quantile(numbers, _USUAL, method="inverted_cdf"))
            if most < _FAR * worst:
                shown += f" ({most:.3g} in {100.0 * _USUAL:.3g} % of the samples)"
        # the threshold of the grade that the worst row reaches
        grade = int(grades[usable].max())
        limit = rule.thresholds[grade - 1]
        broken = float(shares[grade - 1])
        words = rule.words.format(worst=shown, limit=f"{limit:.3g}", shape=scene.shape)
        text = f"{_rows_text(broken)}: {words.replace(') (limit', '; limit')}"
        if rule.key in ADVICE:
            text += ADVICE[rule.key](scene, answers, good)
    return ValidityCheck(
        check=rule.name,
        shares=tuple(shares.tolist()),
        # a step pulse has an infinite duration
        worst=worst if np.isfinite(worst) else None,
        text=text,
        grades=grades,
    )


def _rows_text(fraction: float) -> str:
    """Which rows break a check."""
    if fraction == 1.0:
        return "all samples"
    return f"{100.0 * fraction:.3g} % of the samples"


# --- ranges of criteria ---------------------------------------------------------------------------
# Outside a table the value at its edge is used, outside the range of a formula the formula itself,
# so that a demand is never missing.  How many rows that concerns is a check like the others.

#: symbols of columns and parameters that have a range
_SYMBOLS = {"sphere.nu": "nu", "modulus": "m"}


def _check_ranges(
    scene: Scene, answers: SceneAnswers, good: Flags, quantities: Collection[str]
) -> list[ValidityCheck]:
    criteria: dict[str, tuple[str, Parameters]] = {
        entry.quantity: (name, {})
        for name, entry in CRITERIA.items()
        # the range of the contact pressure is Hertz's, which has its own check
        if entry.quantity is not None and name != "contact_pressure"
    }
    criteria |= scene.demands
    columns = {name: values[good] for name, values in {**scene.columns, **answers.values}.items()}
    return [
        _check_range(name, *criteria[name], columns, good)
        for name in dict.fromkeys(quantities)
        if name in criteria and CRITERIA[criteria[name][0]].ranges
    ]


def _check_range(
    quantity: str, key: str, parameters: Parameters, columns: Mapping[str, Array], good: Flags
) -> ValidityCheck:
    criterion = CRITERIA[key]
    grades = np.zeros_like(good, dtype=int)
    check = f"range_of_{quantity}"
    if not good.any():
        return ValidityCheck(check=check, grades=grades)
    outside = []
    for name, values, low, high in ranges_of(criterion, columns, parameters):
        grades[good] = np.maximum(grades[good], np.where((values < low) | (values > high), 2, 0))
        least = float(values.min())
        most = float(values.max())
        below = low - least
        above = most - high
        if max(below, above) > 0.0:
            text = f"{least if below > above else most:.3g}"
            if min(below, above) > 0.0:
                text = f"{least:.3g} to {most:.3g}"
            outside.append(f"{_SYMBOLS.get(name, name)} = {text}")
    share = float((grades[good] > 0).mean())
    text = ""
    if share > 0.0:
        consequence = "the formula is extrapolated"
        if "equal forces" in criterion.range_text:
            consequence = "the value at the table edge is used"
        text = (
            f"{_rows_text(share)}: {criterion.name} is outside its range "
            f"({criterion.range_text}), {', '.join(outside)}; {consequence}"
        )
    return ValidityCheck(check=check, shares=(0.0, share, 0.0), text=text, grades=grades)
