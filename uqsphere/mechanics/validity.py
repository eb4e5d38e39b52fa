"""Validity checks: every row against the assumptions of the model, theory section 9.

Each check measures one number per row and grades it 0 ok, 1 note, 2 warning or 3 failure.  A breach
never stops a run; it is reported with the percentage of rows concerned.  Failed rows (status not 0)
are excluded.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Final, TypeAlias

import numpy as np

from uqsphere.arrays import Array, Flags, Places
from uqsphere.mechanics import bars, contact
from uqsphere.mechanics.criteria import CRITERIA, Criterion, Demands, in_range, ranges_of
from uqsphere.mechanics.outputs import SceneAnswers, loss_to_waves
from uqsphere.mechanics.rigs import GRAVITY, Rig, body_of, sphere_body, terminal_speed
from uqsphere.mechanics.scene import Scene, answered
from uqsphere.mechanics.yielding import ContactParameters, Face, softer

#: residual indentation [m] beyond which a lapped flat needs lapping again
_RELAP: Final = 1e-6
#: largest force difference over P_0 under a step pulse is 1.318 mu^0.45 for small mu, theory
#: section 5
_IMBALANCE: Final = (1.318, 0.45)
#: the share of the samples whose largest number is told too, if it is below so much of the worst
_USUAL: Final = 0.95
_FAR: Final = 0.9

#: numbers of the rows (n,), why a check was not made, or None where it does not apply
Measured: TypeAlias = "Array | str | None"


@dataclass(frozen=True, kw_only=True)
class Rule:
    """One check: what it measures, its thresholds, and its sentence.

    measure: function of (scene, answers) that returns the measured number per row, (n,), NaN for
    rows it does not apply to; or a text, why the check was not made; or None for a scene it does
    not apply to.  information, warning, failure: thresholds of the grades 1, 2, 3; exceeded above
    if `rising`, else below.  words: sentence on a breach, with {worst} and {limit}.  laws: contact
    laws it applies to.  applies: whether it applies to a rig.  advice: function of (scene, answers,
    good rows) that returns what is added to the sentence on a breach.  needs: column without which
    the check is not made.
    """

    name: str
    meaning: str
    measure: Callable[[Scene, SceneAnswers], Measured]
    information: float | None = None
    warning: float | None = None
    failure: float | None = None
    rising: bool = True
    words: str
    laws: tuple[str, ...] = ("hertz", "plastic")
    applies: Callable[[Rig], bool] = lambda rig: True
    advice: Callable[[Scene, SceneAnswers, Flags], str] = lambda scene, answers, good: ""
    needs: str = "sphere.E"

    @property
    def thresholds(self) -> dict[int, float]:
        """Thresholds by their grade."""
        values = {1: self.information, 2: self.warning, 3: self.failure}
        return {grade: value for grade, value in values.items() if value is not None}

    def statement(self, worst: float, rows: str, advice: str = "", usual: str = "") -> str:
        """The sentence on the worst number, with the threshold of the grade that it reaches.

        rows: which rows break the check; empty if none does.  usual: what few rows are beyond.
        """
        shown = f"{worst:.3g}" if np.isfinite(worst) else "unlimited"
        grade = int(grades(self, np.array([worst]))[0])
        if not rows or grade == 0:
            side = "at most" if self.rising else "at least"
            limit = next(iter(self.thresholds.values()))
            return f"{self.meaning}: {side} {shown} (limit {limit:.3g})"
        limit = self.thresholds[grade]
        words = self.words.format(worst=shown + usual, limit=f"{limit:.3g}")
        return f"{rows}: {words.replace(') (limit', '; limit')}{advice}"


@dataclass(frozen=True, kw_only=True)
class ValidityCheck:
    """Result of one check over a batch.

    The three shares are fractions of the computed rows and do not overlap: each row has one grade.
    `worst` is the worst measured number, None if the check was not made; `text` is the sentence.
    """

    check: str
    share_information: float
    share_warning: float
    share_failure: float
    worst: float | None
    text: str

    @property
    def grade(self) -> int:
        """The highest grade that any row has."""
        if self.share_failure > 0.0:
            return 3
        if self.share_warning > 0.0:
            return 2
        return int(self.share_information > 0.0)

    @property
    def share(self) -> float:
        """Fraction of the rows that break the check."""
        return self.share_information + self.share_warning + self.share_failure


_NO_FACE: Final = "not checked: no contact yields"
_NO_ROW: Final = "not checked: no row was computed"
_NO_YIELD: Final = "not checked: the yield strength of the bars is not given"
_NO_ONSET: Final = "not checked: the onset pressure of the sphere is not given"


def softest_partner(scene: Scene) -> ContactParameters:
    """Contact parameters of the counter-body that yields first in each row."""
    tables = dict.fromkeys(partner.table for partner in scene.there)
    return reduce(softer, [body_of(scene.columns, table, scene.rigid_contact) for table in tables])


def _contact_over_radius(scene: Scene, answers: SceneAnswers) -> Array | str:
    return answers.values["a_max"] / scene.columns["sphere.radius"]


def _bars_of(scene: Scene) -> list[tuple[Array, Array]]:
    """Diameters and wave speeds of the counter-bodies that are bars."""
    c = scene.columns
    tables = dict.fromkeys(partner.table for partner in scene.there if partner.kind == "bar")
    return [
        (c[f"{table}.diameter"], bars.wave_speed(c[f"{table}.E"], c[f"{table}.density"]))
        for table in tables
    ]


def _contact_over_bar(scene: Scene, answers: SceneAnswers) -> Array | str | None:
    ratios = [2.0 * answers.values["a_max"] / diameter for diameter, _ in _bars_of(scene)]
    if not ratios:
        return None
    return np.asarray(np.maximum.reduce(ratios))


def _positive(values: Array) -> Array:
    return np.where(values > 0.0, values, np.nan)


def _over_onset(
    scene: Scene, answers: SceneAnswers, body: ContactParameters, absent: str
) -> Array | str:
    """Elastic contact pressure over the onset pressure of a body."""
    onset = np.where(np.isfinite(body.onset), _positive(body.onset), np.nan)
    if np.isnan(onset).all():
        return absent
    return np.asarray(answers.values["p_max"] / onset)


def _static_estimate(
    scene: Scene, answers: SceneAnswers, good: Flags, body: ContactParameters
) -> str:
    """Pressure and indentation, by statics, of a body that was taken as elastic."""
    with np.errstate(all="ignore"):
        scales = scene.scales
        law = Face(
            **body._asdict(), modulus=scales.modulus, effective_radius=scales.effective_radius
        )
        rows = np.flatnonzero(good & np.isfinite(body.onset) & np.isfinite(body.hardness))
        face = law.at(rows)
        press = face.pressed(face.depth_at(np.asarray(answers.values["P_max"])[rows]))
    centre, dent = press.centre[np.isfinite(press.centre)], press.dent[np.isfinite(press.dent)]
    if len(centre) == 0 or len(dent) == 0:
        return ""
    pressure, depth = f"{centre.max() / 1e9:.3g} GPa", f"{1e6 * dent.max():.2g} um"
    return f". Static plastic estimate: p_max up to {pressure}, indentation {depth}"


def _partner_estimate(scene: Scene, answers: SceneAnswers, good: Flags) -> str:
    return _static_estimate(scene, answers, good, softest_partner(scene))


def _sphere_estimate(scene: Scene, answers: SceneAnswers, good: Flags) -> str:
    return _static_estimate(scene, answers, good, sphere_body(scene.columns))


def _over_partner_onset(scene: Scene, answers: SceneAnswers) -> Array | str:
    """Hertz pressure at peak force / onset pressure of the counter-bodies; the largest."""
    ratios = []
    for table, partner in {partner.table: partner for partner in scene.there}.items():
        onset = body_of(scene.columns, table, scene.rigid_contact).onset
        pressure = contact.pressure_at_force(
            answers.values["P_max"], partner.modulus, partner.effective_radius
        )
        ratios.append(pressure / np.where(np.isfinite(onset), _positive(onset), np.nan))
    worst = np.asarray(np.fmax.reduce(ratios))
    if np.isnan(worst).all():
        return "not checked: the yield strength of the counter-body is not given"
    return worst


def _depth(scene: Scene, answers: SceneAnswers) -> Array | str:
    return _of_faces(scene, answers, lambda face, depth: depth)


def _of_faces(
    scene: Scene, answers: SceneAnswers, pick: Callable[[Face, Array], Array]
) -> Array | str:
    """A number of each contact that yields, at the depth of the peak force; the largest."""
    faces = [partner.face for partner in scene.there if isinstance(partner.face, Face)]
    if not faces:
        return _NO_FACE
    force = np.asarray(answers.values["P_max"])
    with np.errstate(all="ignore"):
        values = [pick(face, face.depth_at(force)) for face in faces]
    return np.asarray(np.maximum.reduce(values))


def _other_onset(scene: Scene, answers: SceneAnswers) -> Array | str:
    """Onset ratio of the harder and the softer body, the least of the contacts that yield.

    It is 1 where the body with the higher onset has the lower hardness.
    """
    sphere = sphere_body(scene.columns)
    ratios = []
    for partner in scene.there:
        if partner.face is None:
            continue
        body = body_of(scene.columns, partner.table, scene.rigid_contact)
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = np.maximum(body.onset, sphere.onset) / np.minimum(body.onset, sphere.onset)
            crossed = (body.onset < sphere.onset) != (body.hardness < sphere.hardness)
            ratios.append(np.where(crossed & np.isfinite(ratio), 1.0, ratio))
    if not ratios:
        return _NO_FACE
    return np.asarray(np.fmin.reduce(ratios))


def _dents(scene: Scene, answers: SceneAnswers, good: Flags) -> str:
    depths = _of_faces(scene, answers, lambda face, depth: face.pressed(depth).dent)
    assert not isinstance(depths, str)
    deepest = np.nanmax(depths[good])
    text = f". Residual indentation: up to {1e6 * deepest:.2g} um"
    flats_yield = bool((softest_partner(scene).onset <= sphere_body(scene.columns).onset).any())
    if flats_yield and deepest > _RELAP:
        text += "; lap the flat faces again"
    return text


def _contact_over_insert(scene: Scene, answers: SceneAnswers) -> Array | str:
    thickness = scene.columns.get("bars.insert_thickness")
    if thickness is None:
        return "not checked: the thickness of the inserts is not given"
    return 3.0 * answers.values["a_max"] / thickness


def _pulse_over_yield(scene: Scene, answers: SceneAnswers) -> Array | str:
    strength = _positive(scene.column("bars.yield_strength"))
    if np.isnan(strength).all():
        return _NO_YIELD
    c = scene.columns
    level = np.ones(len(scene))
    if scene.shape == "two_peak":
        level = np.maximum(c["pulse.level1"], c["pulse.level2"])
    if scene.striker_ratio is not None:
        level = 2.0 * scene.striker_ratio / (1.0 + scene.striker_ratio)
    stress = level * bars.pulse_stress(c["striker.speed"], c["bars.E"], c["bars.density"])
    return np.asarray(stress / strength)


def _imbalance(scene: Scene, answers: SceneAnswers) -> Array | str:
    measured = answers.values["force_imbalance"]
    if np.any(measured > 0.0):
        return measured
    # forces of the massless model are balanced by assumption: the mass number gives an estimate
    factor, power = _IMBALANCE
    with np.errstate(all="ignore"):
        estimate = factor * scene.scales.mass_number**power
        return estimate * scene.scales.force / answers.values["P_max"]


def _transits(scene: Scene, answers: SceneAnswers, time: str) -> Array:
    """Wave transits of the sphere during the rise time, or during the contact time."""
    c = scene.columns
    with np.errstate(all="ignore"):
        transit = 2.0 * c["sphere.radius"] / bars.wave_speed(c["sphere.E"], c["sphere.density"])
        return np.asarray(answers.values[time] / transit)


def _plate_of(scene: Scene) -> tuple[str, tuple[Array, ...]] | None:
    """Table of the counter-body that is a plate; its E, nu, density and thickness."""
    for partner in scene.there:
        if partner.kind == "plate":
            keys = (f"{partner.table}.{key}" for key in ("E", "nu", "density", "thickness"))
            return partner.table, tuple(scene.columns[key] for key in keys)
    return None


def _thin_plate(scene: Scene, answers: SceneAnswers) -> Array | str | None:
    """Thickness over contact radius, or wave transits of the thickness if fewer, but at least 2.

    A plate that is thick for the contact time is no failure: the kind `thick` fits it better.
    """
    plate = _plate_of(scene)
    if plate is None:
        return None
    _, (E, nu, density, thickness) = plate
    with np.errstate(all="ignore"):
        sound = np.sqrt(E * (1.0 - nu) / (density * (1.0 + nu) * (1.0 - 2.0 * nu)))
        transits = answers.values["loaded_time"] * sound / (2.0 * thickness)
        return np.asarray(
            np.minimum(thickness / answers.values["a_max"], np.maximum(transits, 2.0))
        )


def _plate_edge(scene: Scene, answers: SceneAnswers) -> Array | str | None:
    """Contact time over the return time of the flexural wave from the plate edge.

    The group speed is that of a half period equal to the contact time t, c_g = 2 (D/(rho h))^(1/4)
    sqrt(pi/t), over a path of one width.
    """
    plate = _plate_of(scene)
    if plate is None:
        return None
    table, (E, nu, density, thickness) = plate
    width = scene.columns.get(f"{table}.width")
    if width is None:
        return f"not checked: {table}.width is not given"
    with np.errstate(all="ignore"):
        loaded = answers.values["loaded_time"]
        bending = E * np.square(thickness) / (12.0 * (1.0 - nu * nu) * density)
        return np.asarray(loaded * 2.0 * bending**0.25 * np.sqrt(np.pi / loaded) / width)


def _gravity(scene: Scene, answers: SceneAnswers) -> Array | str:
    behind, moving = scene.partners[0], scene.scales.mass
    if behind is not None:
        moving = moving + behind.mass
    return moving * GRAVITY / answers.values["P_max"]


def _drag(scene: Scene, answers: SceneAnswers) -> Array:
    c = scene.columns
    terminal = terminal_speed(c["sphere.radius"], c["sphere.density"])
    return c["rig.drop_height"] * GRAVITY / terminal**2


def _rod_rise(scene: Scene, answers: SceneAnswers) -> Array | str | None:
    rise = answers.values["rise_time"]
    ratios = [rise * speed / (0.5 * diameter) for diameter, speed in _bars_of(scene)]
    if not ratios:
        return None
    return np.asarray(np.minimum.reduce(ratios))


def _echo_under_load(scene: Scene, answers: SceneAnswers) -> Array | str | None:
    if not np.any(np.isfinite(scene.first_echo)):
        return None
    with np.errstate(all="ignore"):
        return answers.values["loaded_time"] / scene.first_echo


def _one_sided(scene: Scene, answers: SceneAnswers) -> Array | str:
    ratio = _contact_over_radius(scene, answers)
    imbalance = answers.values.get("force_imbalance")
    if imbalance is None:
        return ratio
    return np.where(imbalance > 0.1, ratio, np.nan)


def _pulse_rise(scene: Scene, answers: SceneAnswers) -> Array | str:
    c, breaks = scene.columns, scene.pulse.breaks
    if scene.shape in ("rectangular", "step"):
        return "an ideal jump"
    with np.errstate(all="ignore"):
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


def _record_over_echo(scene: Scene, answers: SceneAnswers) -> Array | str:
    if not scene.infinite:
        return "not needed: reflected waves are part of the model"
    # an end that is given as absorbing reflects nothing; one that is not given may
    echoing = [scene.column(f"bars.{bar}_end", 1.0) != 0.0 for bar in ("incident", "receiving")]
    first = np.where(np.stack(echoing, axis=1), scene.round_trips, np.inf).min(axis=1)
    if not np.any(np.isfinite(first)):
        return "not checked: the bars are infinite, and no length with a reflecting end is given"
    return np.asarray(answers.record / first)


def _between_bars(rig: Rig) -> bool:
    return rig.by_wave


def _one_contact(rig: Rig) -> bool:
    return rig.contacts == 1


def _two_contacts(rig: Rig) -> bool:
    return rig.contacts == 2 and not rig.by_press


def _on_rod(rig: Rig) -> bool:
    return rig.may_have("bar") and not rig.by_wave


RULES: Final[tuple[Rule, ...]] = (
    Rule(
        name="small_contact",
        meaning="contact radius / sphere radius (Hertz: small contact)",
        measure=_contact_over_radius,
        warning=0.2,
        failure=0.3,
        words="the contact is not small, a/r up to {worst} (limit {limit})",
    ),
    Rule(
        name="contact_on_bar_end",
        meaning="contact radius / bar radius (Hertz: half space)",
        measure=_contact_over_bar,
        warning=0.2,
        failure=1.0,
        applies=lambda rig: rig.may_have("bar"),
        words="the contact is large for the bar end, a/(d_b/2) up to {worst} (limit {limit})",
    ),
    Rule(
        name="bar_yield_contact",
        meaning="contact pressure / onset pressure of the bars (elastic contact)",
        measure=lambda s, a: _over_onset(s, a, softest_partner(s), _NO_YIELD),
        warning=1.0,
        laws=("hertz",),
        applies=_between_bars,
        advice=_partner_estimate,
        words="the bars yield under the sphere, p_0 up to {worst} times their onset pressure. Use "
        'harder bars or inserts, thinner bars or a shorter pulse, or contact.law = "plastic"',
    ),
    Rule(
        name="bar_yield_pulse",
        meaning="pulse stress / yield strength of the bars (elastic waves)",
        measure=_pulse_over_yield,
        warning=1.0,
        applies=_between_bars,
        words="the pulse yields the bars: its stress is up to {worst} times their yield strength",
    ),
    Rule(
        name="force_balance",
        meaning="peak difference of the contact forces / peak force",
        measure=_imbalance,
        information=0.05,
        warning=0.1,
        applies=_two_contacts,
        words="the two contact forces differ by up to {worst} of the peak force (limit {limit}). A "
        "gauge at one contact does not measure the force at the other",
    ),
    Rule(
        name="quasi_static_sphere",
        meaning="wave transits of the sphere, 2 r/sqrt(E/rho), in the rise time",
        measure=lambda s, a: _transits(s, a, "rise_time"),
        warning=4.0,
        failure=3.0,
        rising=False,
        applies=_two_contacts,
        words="only {worst} wave transits of the sphere during the rise time (at least {limit} are "
        "needed for a quasi-static sphere)",
    ),
    Rule(
        name="one_dimensional_bars",
        meaning="rise time of the pulse / (bar radius/c_0) (one-dimensional waves)",
        measure=_pulse_rise,
        warning=5.0,
        rising=False,
        applies=_between_bars,
        words="the pulse rises or falls within {worst} bar radii/c_0 (at least {limit} are needed "
        "for one-dimensional waves)",
    ),
    Rule(
        name="force_level",
        meaning="pulse duration / t_c (does the force reach P_0 = Z v_0/2?)",
        measure=lambda s, a: s.scales.pulse_number,
        information=2.0,
        rising=False,
        applies=_between_bars,
        words="the pulse is short: {worst} times the contact time scale t_c (limit {limit}). The "
        "peak force depends on the pulse duration; Z v_0/2 would overestimate it",
    ),
    Rule(
        name="before_reflection",
        meaning="evaluation window / arrival of the first reflected wave (infinite bars)",
        measure=_record_over_echo,
        information=1.0,
        applies=_between_bars,
        words="the bars are taken as infinite, but the evaluation window is up to {worst} times "
        "the arrival of the first reflected wave in bars of the given length",
    ),
    Rule(
        name="sphere_yield_contact",
        needs="sphere.onset_pressure",
        meaning="contact pressure / onset pressure of the sphere",
        measure=lambda s, a: _over_onset(s, a, sphere_body(s.columns), _NO_ONSET),
        warning=1.0,
        laws=("hertz",),
        advice=_sphere_estimate,
        words="the sphere yields or crushes at the contacts, p_0 up to {worst} times its onset "
        "pressure",
    ),
    Rule(
        name="dented",
        meaning="approach / approach at first yield",
        measure=_depth,
        information=1.0,
        laws=("plastic",),
        advice=_dents,
        words="a contact yields: the approach is up to {worst} times that at first yield (included "
        "in the pressures)",
    ),
    Rule(
        name="softer_body",
        meaning="onset pressure of the harder / the softer body of a contact",
        measure=_other_onset,
        information=1.3,
        rising=False,
        laws=("plastic",),
        words="both bodies of a contact yield at nearly the same pressure, ratio {worst} (distinct "
        "above {limit}). The law lets only the softer one yield: forces and pressures beyond first "
        "yield are upper bounds",
    ),
    Rule(
        name="plastic_range",
        meaning="approach / approach at first yield (law validated up to 110)",
        measure=_depth,
        warning=110.0,  # finite elements: Kogut and Etsion 2002, Jackson and Green 2005
        failure=1000.0,
        laws=("plastic",),
        words="the approach of a contact is up to {worst} times that at first yield; the law is "
        "validated up to {limit}",
    ),
    Rule(
        name="deep_dent",
        meaning="residual indentation / effective radius (curvature unchanged)",
        measure=lambda s, a: _of_faces(
            s, a, lambda face, depth: face.pressed(depth).dent / face.effective_radius
        ),
        warning=0.01,
        failure=0.045,  # a contact of 0.3 times the effective radius: a² = 2 R · dent
        laws=("plastic",),
        words="the residual indentation is not shallow: up to {worst} of the effective radius "
        "(limit {limit})",
    ),
    Rule(
        name="insert_thickness",
        needs="bars.insert_E",
        meaning="three contact radii / thickness of the inserts",
        measure=_contact_over_insert,
        warning=1.0,
        applies=_between_bars,
        words="the inserts are thin: three contact radii are up to {worst} times their thickness. "
        "The bars deform, and may yield, below them",
    ),
    Rule(
        name="pressure_shape",
        meaning="approach / approach at first yield (pressure distribution)",
        measure=_depth,
        information=2.0,
        warning=6.0,
        laws=("plastic",),
        words="the approach of a contact is up to {worst} times that at first yield (limit "
        "{limit}): the pressure distribution is flatter than Hertz's, stresses inside the sphere "
        "and at the rim are approximate",
    ),
    Rule(
        name="quasi_static_sphere",
        meaning="wave transits of the sphere, 2 r/sqrt(E/rho), during contact",
        measure=lambda s, a: _transits(s, a, "loaded_time"),
        warning=6.0,
        failure=4.0,
        rising=False,
        applies=_one_contact,
        words="only {worst} wave transits of the sphere during contact (at least {limit} are "
        "needed for a quasi-static sphere)",
    ),
    Rule(
        name="face_yield",
        meaning="contact pressure / onset pressure of the counter-body",
        measure=_over_partner_onset,
        warning=1.0,
        laws=("hertz",),
        applies=lambda rig: not rig.by_wave,
        advice=_partner_estimate,
        words="the counter-body yields under the sphere, p_0 up to {worst} times its onset "
        "pressure",
    ),
    Rule(
        name="thin_plate",
        meaning="plate thickness / contact radius, or wave transits of the plate during contact",
        measure=_thin_plate,
        warning=5.0,
        failure=2.0,
        rising=False,
        applies=lambda rig: rig.may_have("plate"),
        words="the plate is too thick for the thin-plate model (thickness/contact radius or wave "
        'transits: {worst}, at least {limit} needed). Use kind = "thick" if few waves cross the '
        "thickness during contact",
    ),
    Rule(
        name="plate_edge",
        meaning="contact time / return time of the flexural wave from the plate edge",
        measure=_plate_edge,
        warning=1.0,
        applies=lambda rig: rig.may_have("plate"),
        words="the contact lasts up to {worst} times the return time of the flexural wave from the "
        "plate edge",
    ),
    Rule(
        name="gravity",
        meaning="moving weight / peak force (gravity is neglected)",
        measure=_gravity,
        information=0.01,
        warning=0.05,
        applies=lambda rig: rig.by_impact,
        words="the weight of the moving bodies is up to {worst} of the peak force (limit {limit}); "
        "the motion neglects gravity",
    ),
    Rule(
        name="drag",
        meaning="air drag of the fall, g h/v_t²",
        measure=_drag,
        needs="rig.drop_height",
        information=0.05,
        warning=0.2,
        applies=_one_contact,
        words="air drag affects the impact speed: g h/v_t² up to {worst} (limit {limit})",
    ),
    Rule(
        name="oblique",
        meaning="impact angle from the surface [deg] (friction and spin are neglected)",
        measure=lambda s, a: np.rad2deg(s.columns["rig.angle"]),
        needs="rig.angle",
        information=75.0,
        warning=45.0,
        failure=20.0,
        rising=False,
        applies=_one_contact,
        words="oblique impact, {worst} deg (limit {limit}). Only the normal velocity is used; "
        "friction, spin and rim tension due to sliding are neglected",
    ),
    Rule(
        name="wave_loss",
        meaning="fraction of the impact energy radiated into a thick target",
        measure=lambda s, a: loss_to_waves(s),
        information=0.02,
        warning=0.05,
        applies=_one_contact,
        words="up to {worst} of the impact energy is radiated into the target (limit {limit}). The "
        "restitution includes this loss; forces and durations neglect it",
    ),
    Rule(
        name="one_dimensional_rod",
        meaning="rise time of the force / (bar radius/c_0) (one-dimensional waves)",
        measure=_rod_rise,
        warning=5.0,
        rising=False,
        applies=_on_rod,
        words="the force rises within {worst} rod radii/c_0 (at least {limit} are needed for "
        "one-dimensional waves)",
    ),
    Rule(
        name="echo_in_contact",
        meaning="contact time / wave round trip of the rod",
        measure=_echo_under_load,
        information=1.0,
        applies=_on_rod,
        words="reflected waves return along the rod during contact: {worst} round trips",
    ),
    Rule(
        name="grazing_contact",
        meaning="grazing contact, lost or kept by rounding alone (1 or 0)",
        measure=lambda s, a: np.where(a.grazes, 1.0, 0.0),
        information=0.0,
        words="the contact force nearly vanishes, or contact is lost too often to keep the "
        "tolerance: time to first contact loss, contact duration and force imbalance may be wrong "
        "by what one oscillation of the sphere changes",
    ),
    Rule(
        name="chatter",
        meaning="number of recontacts before peak force",
        measure=lambda s, a: a.values["retouches"],
        information=0.0,
        applies=lambda rig: rig.weight_falls,
        words="contact is lost and regained before peak force, up to {worst} times",
    ),
    Rule(
        name="one_sided_field",
        meaning="contact radius / sphere radius where the contact forces differ",
        measure=_one_sided,
        information=0.1,
        warning=0.2,
        failure=0.3,
        applies=lambda rig: rig.by_impact,
        words="the contact forces differ and the contact is large, a/r up to {worst} (limit "
        "{limit}). Stresses inside the sphere are approximate: the one-sided stress field is not "
        "half the two-sided one",
    ),
)


def grades(rule: Rule, measured: Array) -> Places:
    """Grade 0 to 3 of every row; a row without a number is graded 0.

    >>> grades(RULES[0], np.array([0.1, 0.25, 0.4, np.nan])).tolist()
    [0, 2, 3, 0]
    """
    result = np.zeros(len(measured), dtype=np.int64)
    for grade, threshold in enumerate((rule.information, rule.warning, rule.failure), start=1):
        if threshold is not None:
            beyond = measured > threshold if rule.rising else measured < threshold
            result[beyond] = grade
    return result


def rules_of(scene: Scene) -> tuple[Rule, ...]:
    """The checks that apply to a scene, by its contact law, its rig and its columns."""
    return tuple(
        rule
        for rule in RULES
        if scene.contact_law in rule.laws
        and rule.applies(scene.setup)
        and rule.needs in scene.columns
    )


def measured_rules(scene: Scene, answers: SceneAnswers) -> dict[Rule, Measured]:
    """What every rule that applies measures, in the order of `RULES`."""
    return {rule: rule.measure(scene, answers) for rule in rules_of(scene)}


def check_validity(
    scene: Scene, answers: SceneAnswers, measured: Mapping[Rule, Measured] | None = None
) -> list[ValidityCheck]:
    """Every check that applies to a batch, on its answers, in the order of `RULES`.

    `measured` is what `measured_rules` returns, where it is at hand.  Raises ValueError for answers
    of another batch.
    """
    if len(answers.status) != len(scene):
        raise ValueError(f"the scene has {len(scene)} rows, the answers have {len(answers.status)}")
    good = answered(answers.status)
    if measured is None:
        measured = measured_rules(scene, answers)
    checks = [_check(rule, scene, answers, good, values) for rule, values in measured.items()]
    return [check for check in checks if check is not None]


def _check(
    rule: Rule, scene: Scene, answers: SceneAnswers, good: Flags, measured: Measured
) -> ValidityCheck | None:
    if measured is None:
        return None
    if isinstance(measured, str):
        return _without_number(rule, scene, measured, bool(good.any()))
    usable = measured[good & ~np.isnan(measured)]
    if len(usable) == 0:
        return _result(rule.name, np.zeros(3), None, _NO_ROW)
    worst = float(usable.max() if rule.rising else usable.min())
    shares = np.bincount(grades(rule, usable), minlength=4)[1:] / len(usable)
    if not shares.any():
        return _result(rule.name, shares, worst, rule.statement(worst, ""))
    usual, beyond = "", float(shares.sum())
    if rule.rising and beyond > 1.0 - _USUAL:
        most = float(np.quantile(usable, _USUAL, method="inverted_cdf"))
        if most < _FAR * worst:
            usual = f" ({most:.3g} in {100.0 * _USUAL:.3g} % of the samples)"
    text = rule.statement(worst, _rows_text(beyond), rule.advice(scene, answers, good), usual)
    return _result(rule.name, shares, worst, text)


def _without_number(rule: Rule, scene: Scene, why: str, any_row: bool) -> ValidityCheck:
    """A check without a number: one that was not made, or a pulse that jumps in every row."""
    if rule.name == "one_dimensional_bars" and any_row:
        text = (
            f"an ideal {scene.shape} pulse has a vertical front that no bar transmits; use a "
            "trapezoid with a measured rise time"
        )
        return _result(rule.name, np.array([1.0, 0.0, 0.0]), 0.0, text)
    return _result(rule.name, np.zeros(3), None, why)


def _result(name: str, shares: Array, worst: float | None, text: str) -> ValidityCheck:
    information, warning, failure = (float(share) for share in shares)
    # a step pulse has an infinite duration
    if worst is not None and not np.isfinite(worst):
        worst = None
    return ValidityCheck(
        check=name,
        share_information=information,
        share_warning=warning,
        share_failure=failure,
        worst=worst,
        text=text,
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
_SYMBOLS: Final = {"sphere.nu": "nu", "modulus": "m"}


def check_ranges(
    scene: Scene, answers: SceneAnswers, quantities: Collection[str], demands: Demands | None = None
) -> list[ValidityCheck]:
    """One check per criterion whose demand is among the quantities, named ``range_of_QUANTITY``.

    answers: with `p_max` and `a_max`.  demands: name -> (criterion, parameters), those of the scene
    if None.  Each row is checked at its peak force.
    """
    criteria: dict[str, tuple[str, Mapping[str, float]]] = {
        entry.quantity: (name, {})
        for name, entry in CRITERIA.items()
        # the range of the contact pressure is Hertz's, which has its own check
        if entry.quantity is not None and name != "contact_pressure"
    }
    criteria |= dict(scene.demands if demands is None else demands)
    good = answered(answers.status)
    columns = {
        name: np.asarray(values)[good]
        for name, values in {**scene.columns, **answers.values}.items()
    }
    checks = []
    for name in dict.fromkeys(quantities):
        if name in criteria:
            key, parameters = criteria[name]
            if CRITERIA[key].ranges:
                checks.append(_check_range(name, CRITERIA[key], parameters, columns))
    return checks


def _check_range(
    quantity: str,
    criterion: Criterion,
    parameters: Mapping[str, float],
    columns: Mapping[str, Array],
) -> ValidityCheck:
    name = f"range_of_{quantity}"
    inside = in_range(criterion, columns, parameters)
    if len(inside) == 0:
        return _result(name, np.zeros(3), None, _NO_ROW)
    share = float((~inside).sum() / len(inside))
    parts = [_farthest(*part) for part in ranges_of(criterion, columns, parameters)]
    worst = max(parts, key=lambda part: part[0])[1]
    text = f"{criterion.name} is used inside its range ({criterion.range_text})"
    if share > 0.0:
        outside = ", ".join(words for beyond, _, words in parts if beyond > 0.0)
        consequence = "the formula is extrapolated"
        if "equal forces" in criterion.range_text:
            consequence = "the value at the table edge is used"
        text = (
            f"{_rows_text(share)}: {criterion.name} is outside its range "
            f"({criterion.range_text}), {outside}; {consequence}"
        )
    return _result(name, np.array([0.0, share, 0.0]), worst, text)


def _farthest(key: str, values: Array, low: float, high: float) -> tuple[float, float, str]:
    """How far values lie beyond the bounds (over their distance), the farthest value, its text."""
    least, most = float(values.min()), float(values.max())
    below, above = low - least, most - high
    worst = most
    if below > max(above, 0.0):
        worst = least
    text = f"{worst:.3g}"
    if min(below, above) > 0.0:
        text = f"{least:.3g} to {most:.3g}"
    return max(below, above) / (high - low), worst, f"{_SYMBOLS.get(key, key)} = {text}"
