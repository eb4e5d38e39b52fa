"""Where the model may be trusted: checks of every row against the assumptions behind it, theory
section 9.

Each check measures one number per row and grades it 0 ok, 1 information, 2 warning or 3 failure.  A
breach never stops a run; it is shown with the share of rows that break it.  Failed rows (status not
0) are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags, Places
from uqsphere.mechanics import bars, contact
from uqsphere.mechanics.criteria import CRITERIA, Criterion, Demands, in_range, ranges_of
from uqsphere.mechanics.outputs import Answers
from uqsphere.mechanics.rigs import (
    GRAVITY,
    Partner,
    Rig,
    body_of,
    loss_to_waves,
    softest_partner,
    sphere_body,
    terminal_speed,
)
from uqsphere.mechanics.scene import Scene, answered
from uqsphere.mechanics.yielding import Body, Face

#: a dent [m] after which a lapped flat is no flat any more
_RELAP: Final = 1e-6
#: largest force difference over P_0 under a step pulse is 1.318 mu^0.45 for small mu, theory
#: section 5
_IMBALANCE: Final = (1.318, 0.45)


@dataclass(frozen=True, kw_only=True)
class Rule:
    """One check: how a row is measured, and beyond what it is graded how.

    measure: function of (scene, answers) that returns the measured number per row, (n,), NaN for
    rows it does not apply to; or a text, why the check was not made; or None for a scene it does
    not apply to.  information, warning, failure: thresholds of the grades 1, 2, 3; exceeded above
    if `rising`, else below.  words: sentence on a breach, with {worst} and {limit}.  laws: contact
    laws it applies to.  applies: whether it applies to a rig.  further: function of (scene,
    answers, good rows) that returns what is added on a breach.
    """

    name: str
    meaning: str
    measure: Callable[[Scene, Answers], Array | str | None]
    information: float | None = None
    warning: float | None = None
    failure: float | None = None
    rising: bool = True
    words: str
    laws: tuple[str, ...] = ("hertz", "plastic")
    applies: Callable[[Rig], bool] = lambda rig: True
    further: Callable[[Scene, Answers, Flags], str] | None = None

    @property
    def limit(self) -> float:
        """The mildest of the thresholds."""
        return next(
            value for value in (self.information, self.warning, self.failure) if value is not None
        )

    def statement(self, worst: float, broken: str, further: str = "") -> str:
        """What the worst number means: in `broken`, which rows break the check, or that none
        does.
        """
        seen = f"{worst:.3g}" if np.isfinite(worst) else "endlessly many"
        limit = f"{self.limit:.3g}"
        if not broken:
            return f"{self.meaning}: at {'most' if self.rising else 'least'} {seen} (limit {limit})"
        return f"in {broken} {self.words.format(worst=seen, limit=limit)}{further}"


@dataclass(frozen=True, kw_only=True)
class Check:
    """Result of one check over a batch.

    The three shares are of the rows that were computed and do not overlap: each row has one grade.
    `worst` is the worst measured number, None where the check was left out; `text` says it in plain
    words.
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
        shares = (self.share_failure, self.share_warning, self.share_information)
        return next((3 - k for k, share in enumerate(shares) if share > 0.0), 0)

    @property
    def share(self) -> float:
        """Share of the rows that break the check at all."""
        return self.share_information + self.share_warning + self.share_failure


_NO_FACE: Final = "not checked: nothing yields"
_NO_ROW: Final = "not checked: no row was computed"
_NO_YIELD: Final = "not checked: the yield strength of the bars is not given"
_NO_ONSET: Final = "not checked: the onset pressure of the sphere is not given"


def _contact_over_radius(scene: Scene, answers: Answers) -> Array | str:
    return np.asarray(answers.values["a_max"] / scene.columns["sphere.radius"])


def _bars_of(scene: Scene) -> list[tuple[Partner, Array]]:
    """Partners that are bars, and their diameters."""
    there = dict.fromkeys(one.table for one in scene.there if one.kind == "bar")
    first = {one.table: one for one in scene.there}
    return [(first[table], scene.columns[f"{table}.diameter"]) for table in there]


def _contact_over_bar(scene: Scene, answers: Answers) -> Array | str | None:
    found = [2.0 * answers.values["a_max"] / diameter for _, diameter in _bars_of(scene)]
    return np.maximum.reduce(found) if found else None


def _positive(values: Array) -> Array:
    return np.where(values > 0.0, values, np.nan)


def _over_onset(scene: Scene, answers: Answers, body: Body, absent: str) -> Array | str:
    """The elastic contact pressure over that at which a body of the face yields."""
    onset = np.where(np.isfinite(body.onset), _positive(body.onset), np.nan)
    return absent if np.isnan(onset).all() else np.asarray(answers.values["p_max"] / onset)


def _static(body_of: Callable[[Scene], Body]) -> Callable[[Scene, Answers, Flags], str]:
    """What the law says without the motion, where a body yields that was taken for elastic."""

    def further(scene: Scene, answers: Answers, good: Flags) -> str:
        yields = body_of(scene)
        with np.errstate(all="ignore"):
            known = good & np.isfinite(yields.onset) & np.isfinite(yields.hardness)
            scales, law = (
                scene.scales,
                {name: part[known] for name, part in yields._asdict().items()},
            )
            face = Face(
                **law,
                modulus=scales.modulus[known],
                effective_radius=scales.effective_radius[known],
            )
            press = face.pressed(face.depth_at(np.asarray(answers.values["P_max"])[known]))
        centre, dent = press.centre[np.isfinite(press.centre)], press.dent[np.isfinite(press.dent)]
        if len(centre) == 0 or len(dent) == 0:
            return ""
        said = f"by the static law p_max is at most {centre.max() / 1e9:.3g} GPa"
        return f"; {said}, a dent of {1e6 * dent.max():.2g} um"

    return further


def _over_partner_onset(scene: Scene, answers: Answers) -> Array | str:
    """The pressure that the largest force is at each face over that at which its partner yields;
    the largest.
    """
    found = []
    for one in dict.fromkeys(one.table for one in scene.there):
        partner = next(part for part in scene.there if part.table == one)
        onset = body_of(scene.columns, one, scene.rigid_contact).onset
        pressure = contact.pressure_at_force(
            answers.values["P_max"], partner.modulus, partner.effective_radius
        )
        found.append(pressure / np.where(np.isfinite(onset), _positive(onset), np.nan))
    worst = np.fmax.reduce(found)
    return (
        "not checked: no yield strength of what stands at the poles is given"
        if np.isnan(worst).all()
        else worst
    )


def _depth(scene: Scene, answers: Answers) -> Array | str:
    return _of_faces(scene, answers, lambda face, depth: depth)


def _of_faces(scene: Scene, answers: Answers, pick: Callable[[Face, Array], Array]) -> Array | str:
    """The largest over the faces that yield of what is picked at the depth of the largest force."""
    faces = [one.face for one in scene.there if isinstance(one.face, Face)]
    with np.errstate(all="ignore"):
        found = [pick(face, face.depth_at(np.asarray(answers.values["P_max"]))) for face in faces]
    return np.maximum.reduce(found) if found else _NO_FACE


def _other_onset(scene: Scene, answers: Answers) -> Array | str:
    """Onset of the harder body over that of the softer one, the least of the faces that yield; 1
    where the harder body has the lower hardness."""
    sphere, found = sphere_body(scene.columns), []
    for one in (one for one in scene.there if isinstance(one.face, Face)):
        body = body_of(scene.columns, one.table, scene.rigid_contact)
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = np.maximum(body.onset, sphere.onset) / np.minimum(body.onset, sphere.onset)
            crossed = (body.onset < sphere.onset) != (body.hardness < sphere.hardness)
            found.append(np.where(crossed & np.isfinite(ratio), 1.0, ratio))
    return np.fmin.reduce(found) if found else _NO_FACE


def _dents(scene: Scene, answers: Answers, good: Flags) -> str:
    found = _of_faces(scene, answers, lambda face, depth: face.pressed(depth).dent)
    assert not isinstance(found, str)
    dent = found[good]
    flats_yield = bool((softest_partner(scene).onset <= sphere_body(scene.columns).onset).any())
    faces = "the bars" if scene.by_wave else "what stands there"
    due = f": re-lap {faces}" if flats_yield and np.nanmax(dent) > _RELAP else ""
    return f"; dents of up to {1e6 * np.nanmax(dent):.2g} um stay{due}"


def _contact_over_insert(scene: Scene, answers: Answers) -> Array | str:
    thickness = scene.columns.get("bars.insert_thickness")
    if thickness is None:
        return "not checked: no thickness of an insert is given"
    return np.asarray(3.0 * answers.values["a_max"] / thickness)


def _pulse_over_yield(scene: Scene, answers: Answers) -> Array | str:
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


def _imbalance(scene: Scene, answers: Answers) -> Array | str:
    measured = answers.values["force_imbalance"]
    if np.any(measured > 0.0):
        return measured
    # answers of the massless model: balanced by assumption, so the mass number has to say it
    factor, power = _IMBALANCE
    with np.errstate(all="ignore"):
        estimate = factor * scene.scales.mass_number**power
        return np.asarray(estimate * scene.scales.force / answers.values["P_max"])


def _transits(scene: Scene, answers: Answers, time: str) -> Array:
    """Passages of a wave through the sphere during the rise, or of one contact under load, of which
    that is 0.314.
    """
    c = scene.columns
    with np.errstate(all="ignore"):
        transit = 2.0 * c["sphere.radius"] / bars.wave_speed(c["sphere.E"], c["sphere.density"])
        return np.asarray(answers.values[time] / transit)


def _thin_plate(scene: Scene, answers: Answers) -> Array | str | None:
    """Thickness over contact radius, or transits of the thickness under load where these are fewer
    (not below 2: a plate that is thick beside the blow is no failure, `thick` is nearer)."""
    plate = next((one.table for one in scene.there if one.kind == "plate"), None)
    if plate is None:
        return None
    E, nu, density, thickness = (
        scene.columns[f"{plate}.{key}"] for key in ("E", "nu", "density", "thickness")
    )
    with np.errstate(all="ignore"):
        sound = np.sqrt(E * (1.0 - nu) / (density * (1.0 + nu) * (1.0 - 2.0 * nu)))
        transits = answers.values["loaded_time"] * sound / (2.0 * thickness)
        return np.asarray(
            np.minimum(thickness / answers.values["a_max"], np.maximum(transits, 2.0))
        )


def _plate_edge(scene: Scene, answers: Answers) -> Array | str | None:
    """Time under load over the return of a bending wave from the edge, at the group speed of the
    blow's half period.

    c_g = 2 (D/(rho h))^(1/4) sqrt(pi/t), way there and back the width.
    """
    plate, c = next((one.table for one in scene.there if one.kind == "plate"), None), scene.columns
    if plate is None:
        return None
    if f"{plate}.width" not in c:
        return f"not checked: add width to [{plate}] for the way to its edge and back"
    E, nu, density, thickness = (c[f"{plate}.{key}"] for key in ("E", "nu", "density", "thickness"))
    with np.errstate(all="ignore"):
        loaded = answers.values["loaded_time"]
        bending = E * np.square(thickness) / (12.0 * (1.0 - nu * nu) * density)
        return np.asarray(
            loaded * 2.0 * bending**0.25 * np.sqrt(np.pi / loaded) / c[f"{plate}.width"]
        )


def _gravity(scene: Scene, answers: Answers) -> Array | str:
    behind = scene.partners[0]
    weight = scene.scales.mass + (0.0 if behind is None else behind.mass)
    return np.asarray(weight * GRAVITY / answers.values["P_max"])


def _rod_rise(scene: Scene, answers: Answers) -> Array | str | None:
    found = []
    for partner, diameter in _bars_of(scene):
        speed = bars.wave_speed(
            *(scene.columns[f"{partner.table}.{key}"] for key in ("E", "density"))
        )
        found.append(answers.values["rise_time"] * speed / (0.5 * diameter))
    return np.minimum.reduce(found) if found else None


def _echo_under_load(scene: Scene, answers: Answers) -> Array | str | None:
    with np.errstate(all="ignore"):
        found = answers.values["loaded_time"] / scene.first_echo
    return found if np.any(np.isfinite(scene.first_echo)) else None


def _one_sided(scene: Scene, answers: Answers) -> Array | str:
    ratio = _contact_over_radius(scene, answers)
    imbalance = answers.values.get("force_imbalance")
    return ratio if imbalance is None else np.where(imbalance > 0.1, ratio, np.nan)


def _pulse_rise(scene: Scene, answers: Answers) -> Array | str:
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


def _record_over_echo(scene: Scene, answers: Answers) -> Array | str:
    if not scene.infinite:
        return "not needed: what the far ends send back, if anything, is part of the model"
    # an end known to absorb sends nothing back; one that is not given may
    echoing = [scene.column(f"bars.{bar}_end", 1.0) != 0.0 for bar in ("incident", "receiving")]
    first = np.where(np.stack(echoing, axis=1), scene.round_trips, np.inf).min(axis=1)
    if not np.any(np.isfinite(first)):
        return (
            "not checked: the bars are taken as infinite and no length with a reflecting end is "
            "given"
        )
    return np.asarray(answers.record / first)


RULES: Final[tuple[Rule, ...]] = (
    Rule(
        name="small_contact",
        meaning="contact radius over sphere radius (Hertz: small)",
        measure=_contact_over_radius,
        warning=0.2,
        failure=0.3,
        words="the contact is not small against the sphere, a/r reaches {worst} (limit {limit})",
    ),
    Rule(
        name="contact_on_bar_end",
        meaning="contact radius over bar radius (Hertz: half space)",
        measure=_contact_over_bar,
        warning=0.2,
        failure=1.0,
        applies=lambda rig: rig.may_have("bar"),
        words="the contact is large for the bar's end, a/(d_b/2) reaches {worst} (limit {limit})",
    ),
    Rule(
        name="bar_yield_contact",
        meaning="contact pressure over that at which the bars yield (elastic contact)",
        measure=lambda s, a: _over_onset(s, a, softest_partner(s), _NO_YIELD),
        warning=1.0,
        laws=("hertz",),
        applies=lambda rig: rig.by_wave,
        further=_static(softest_partner),
        words="the bars yield under the sphere, p_0 reaches {worst} times the pressure at which "
        "they begin to; "
        "harder bars or inserts, thinner bars or a shorter pulse help",
    ),
    Rule(
        name="bar_yield_pulse",
        meaning="stress of the pulse over the bars' yield strength (elastic waves)",
        measure=_pulse_over_yield,
        warning=1.0,
        applies=lambda rig: rig.by_wave,
        words=(
            "the pulse makes the bars yield, its stress reaches {worst} times their yield strength"
        ),
    ),
    Rule(
        name="force_balance",
        meaning="largest difference of the two forces over the largest force",
        measure=_imbalance,
        information=0.05,
        warning=0.1,
        applies=lambda rig: rig.contacts == 2 and not rig.by_press,
        words="the forces of the two faces differ by up to {worst} of the largest at some instant "
        "(limit {limit}). "
        "What measures one of them does not measure the other",
    ),
    Rule(
        name="quasi_static_sphere",
        meaning="wave transits of the sphere, 2 r/sqrt(E/rho), in the rise time",
        measure=lambda s, a: _transits(s, a, "rise_time"),
        warning=4.0,
        failure=3.0,
        rising=False,
        applies=lambda rig: rig.contacts == 2 and not rig.by_press,
        words="a wave, at sqrt(E/rho), crosses the sphere only {worst} times while the force rises "
        "from "
        "10 % to 90 % (at least {limit}); too few for a quasi-static sphere",
    ),
    Rule(
        name="one_dimensional_bars",
        meaning="rise of the pulse over bar radius/c_0 (one-dimensional waves)",
        measure=_pulse_rise,
        warning=5.0,
        rising=False,
        applies=lambda rig: rig.by_wave,
        words="the pulse rises or falls within {worst} bar radii/c_0 (at least {limit}), sharper "
        "than one-dimensional waves can carry",
    ),
    Rule(
        name="force_level",
        meaning="pulse length over t_c (does the force come near P_0 = Z v_0/2?)",
        measure=lambda s, a: s.scales.pulse_number,
        information=2.0,
        rising=False,
        applies=lambda rig: rig.by_wave,
        words="the pulse is short: {worst} times the time scale of the contact (limit {limit}). "
        "The force depends on "
        "the pulse's length; the formula Z v_0/2 would overestimate it",
    ),
    Rule(
        name="before_reflection",
        meaning="record over the first return of a reflected wave (infinite bars)",
        measure=_record_over_echo,
        information=1.0,
        applies=lambda rig: rig.by_wave,
        words="infinite bars were requested; but the record runs to {worst} times the first return "
        "of a "
        "reflected wave in bars of the given length",
    ),
    Rule(
        name="sphere_yield_contact",
        meaning="contact pressure over that at which the sphere yields or crushes",
        measure=lambda s, a: _over_onset(s, a, sphere_body(s.columns), _NO_ONSET),
        warning=1.0,
        laws=("hertz",),
        further=_static(lambda s: sphere_body(s.columns)),
        words=(
            "the sphere crushes at its poles, p_0 reaches {worst} times the pressure at which it "
            "begins to"
        ),
    ),
    Rule(
        name="dented",
        meaning="approach over that at which a face first yields",
        measure=_depth,
        information=1.0,
        laws=("plastic",),
        further=_dents,
        words=(
            "a contact yields: the approach reaches {worst} times that at first yield; the "
            "pressures include it"
        ),
    ),
    Rule(
        name="softer_body",
        meaning="onset of the harder body of a face over that of the softer one",
        measure=_other_onset,
        information=1.3,
        rising=False,
        laws=("plastic",),
        words="both bodies of a contact yield at nearly the same pressure, ratio {worst} (clear "
        "from {limit}). The "
        "law lets only the softer one yield: beyond first yield it is a bound",
    ),
    Rule(
        name="plastic_range",
        meaning="approach over that at which a face first yields (law seen up to 110)",
        measure=_depth,
        warning=110.0,  # finite elements: Kogut and Etsion 2002, Jackson and Green 2005
        failure=1000.0,
        laws=("plastic",),
        words=(
            "a face is pressed to {worst} times its first yield, beyond what its law was "
            "compared with ({limit})"
        ),
    ),
    Rule(
        name="deep_dent",
        meaning="dent over the effective radius (the next blow meets the same curvature)",
        measure=lambda s, a: _of_faces(
            s, a, lambda face, depth: face.pressed(depth).dent / face.effective_radius
        ),
        warning=0.01,
        laws=("plastic",),
        words=(
            "a dent is deep beside the curvature of the face, {worst} of its radius (limit {limit})"
        ),
    ),
    Rule(
        name="insert_thickness",
        meaning="three contact radii over the thickness of the inserts",
        measure=_contact_over_insert,
        warning=1.0,
        applies=lambda rig: rig.by_wave,
        words=(
            "the inserts are thin, three contact radii reach {worst} of their thickness: the bar "
            "yields below them"
        ),
    ),
    Rule(
        name="pressure_shape",
        meaning="approach over that at which a face first yields (shape of the pressure)",
        measure=_depth,
        information=2.0,
        warning=6.0,
        laws=("plastic",),
        words="a contact is pressed to {worst} times its first yield: the true pressure is flatter "
        "than Hertz's "
        "(limit {limit}). Stresses inside the sphere and at the rim are approximate",
    ),
    Rule(
        name="quasi_static_sphere",
        meaning="wave transits of the sphere, 2 r/sqrt(E/rho), under load",
        measure=lambda s, a: _transits(s, a, "loaded_time"),
        warning=6.0,
        failure=4.0,
        rising=False,
        applies=lambda rig: rig.contacts == 1,
        words="a wave, at sqrt(E/rho), crosses the sphere only {worst} times while it is pressed "
        "(at least {limit}); "
        "too few for a quasi-static sphere",
    ),
    Rule(
        name="face_yield",
        meaning="contact pressure over that at which what stands at a pole yields",
        measure=_over_partner_onset,
        warning=1.0,
        laws=("hertz",),
        applies=lambda rig: not rig.by_wave,
        further=_static(softest_partner),
        words=(
            "what stands at a pole yields under the sphere, p_0 reaches {worst} times the "
            "pressure where it begins"
        ),
    ),
    Rule(
        name="thin_plate",
        meaning="thickness of the plate over the contact radius, or transits of it under load",
        measure=_thin_plate,
        warning=5.0,
        failure=2.0,
        rising=False,
        applies=lambda rig: rig.may_have("plate"),
        words="the plate is not thin beside the blow, or the contact: {worst} (at least {limit}); "
        "where few "
        "waves cross its thickness under load, a thick target is nearer",
    ),
    Rule(
        name="plate_edge",
        meaning="time under load over the return of the bending wave from the plate's edge",
        measure=_plate_edge,
        warning=1.0,
        applies=lambda rig: rig.may_have("plate"),
        words=(
            "the bending wave is back from the plate's edge while the sphere is pressed: {worst} "
            "returns"
        ),
    ),
    Rule(
        name="gravity",
        meaning="weight of what moves over the largest force (left out of the motion)",
        measure=_gravity,
        information=0.01,
        warning=0.05,
        applies=lambda rig: rig.by_impact,
        words=(
            "weights, which the motion leaves out, reach {worst} of the largest force (limit "
            "{limit})"
        ),
    ),
    Rule(
        name="drag",
        meaning="fall over that in which air drag would stop the gain of speed, g h/v_t²",
        measure=lambda s, a: (
            s.columns["rig.drop_height"]
            * GRAVITY
            / terminal_speed(s.columns["sphere.radius"], s.columns["sphere.density"]) ** 2
            if "rig.drop_height" in s.columns
            else None
        ),
        information=0.05,
        warning=0.2,
        applies=lambda rig: rig.contacts == 1,
        words=(
            "the drag of the air matters for the speed after the fall: g h/v_t² reaches {worst} "
            "(limit {limit})"
        ),
    ),
    Rule(
        name="oblique",
        meaning="angle between the path and the surface [deg]; friction and spin are left out",
        measure=lambda s, a: (
            np.rad2deg(s.columns["rig.angle"]) if "rig.angle" in s.columns else None
        ),
        information=75.0,
        warning=45.0,
        failure=20.0,
        rising=False,
        applies=lambda rig: rig.contacts == 1,
        words="the blow is oblique, {worst} deg (square on from {limit}); friction, spin and "
        "tension by sliding at "
        "the rim are left out, the normal part of the speed counts",
    ),
    Rule(
        name="wave_loss",
        meaning="share of the energy that a thick target carries off as waves",
        measure=lambda s, a: loss_to_waves(s),
        information=0.02,
        warning=0.05,
        applies=lambda rig: rig.contacts == 1,
        words="{worst} of the impact energy is radiated into the target (limit {limit}). The "
        "restitution includes this loss; the computed forces and durations neglect it",
    ),
    Rule(
        name="one_dimensional_rod",
        meaning="rise of the force over bar radius/c_0 (one-dimensional waves)",
        measure=_rod_rise,
        warning=5.0,
        rising=False,
        applies=lambda rig: rig.may_have("bar") and not rig.by_wave,
        words=(
            "the force rises within {worst} rod radii/c_0 (at least {limit}), too fast for waves "
            "of one dimension"
        ),
    ),
    Rule(
        name="echo_in_contact",
        meaning="time under load over the round trip of the rod",
        measure=_echo_under_load,
        information=1.0,
        applies=lambda rig: rig.may_have("bar") and not rig.by_wave,
        words="waves come back along the rod while the sphere is pressed: {worst} round trips",
    ),
    Rule(
        name="grazing_contact",
        meaning="contact that comes so near to a loss that rounding decides (1 or 0)",
        measure=lambda s, a: np.where(a.grazes, 1.0, 0.0),
        information=0.0,
        words=(
            "contact grazes zero: the first loss and the duration of those rows may be a swing off"
        ),
    ),
    Rule(
        name="chatter",
        meaning="contacts lost and found again before the largest force",
        measure=lambda s, a: a.values["retouches"],
        information=0.0,
        applies=lambda rig: rig.weight_falls,
        words="contacts are lost and found again before the largest force, up to {worst} times",
    ),
    Rule(
        name="one_sided_field",
        meaning="contact radius over sphere radius where the forces differ at the peak",
        measure=_one_sided,
        information=0.1,
        warning=0.2,
        failure=0.3,
        applies=lambda rig: rig.by_impact,
        words="the forces at the poles differ and the contact is large, a/r reaches {worst} (limit "
        "{limit}); the "
        "field of one force is not half that of two",
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
            result[measured > threshold if rule.rising else measured < threshold] = grade
    return result


def rules_of(scene: Scene) -> tuple[Rule, ...]:
    """The checks that are asked of a scene, by its law of the contact and by what stands in it."""
    return tuple(
        rule
        for rule in RULES
        if scene.contact_law in rule.laws
        and rule.applies(scene.setup)
        and (rule.name != "insert_thickness" or "bars.insert_E" in scene.columns)
        and (rule.name != "sphere_yield_contact" or "sphere.onset_pressure" in scene.columns)
    )


def check_validity(scene: Scene, answers: Answers) -> list[Check]:
    """Every check that is asked of a batch, on its answers, in the order of `RULES`."""
    if len(answers.status) != len(scene):
        raise ValueError(
            f"{len(answers.status)} answers do not belong to a batch of {len(scene)} rows"
        )
    good = answered(answers.status)
    found = (_check(rule, scene, answers, good) for rule in rules_of(scene))
    return [check for check in found if check is not None]


def _check(rule: Rule, scene: Scene, answers: Answers, good: Flags) -> Check | None:
    measured = rule.measure(scene, answers)
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
    further = "" if rule.further is None else rule.further(scene, answers, good)
    return _result(
        rule.name,
        shares,
        worst,
        rule.statement(worst, f"{_percent(float(shares.sum()))} rows", further),
    )


def _without_number(rule: Rule, scene: Scene, why: str, any_row: bool) -> Check:
    """A check that measures nothing: left out, or a jump of the pulse, which concerns every row
    alike.
    """
    if rule.name == "one_dimensional_bars" and any_row:
        text = (
            f"the ideal {scene.shape} pulse jumps, sharper than any bar can carry: a real one "
            "needs time"
        )
        return _result(rule.name, np.array([1.0, 0.0, 0.0]), 0.0, text)
    return _result(rule.name, np.zeros(3), None, why)


def _result(name: str, shares: Array, worst: float | None, text: str) -> Check:
    information, warning, failure = (float(share) for share in shares)
    # an endless pulse is infinitely long, and a report holds no infinity
    finite = worst if worst is not None and np.isfinite(worst) else None
    return Check(
        check=name,
        share_information=information,
        share_warning=warning,
        share_failure=failure,
        worst=finite,
        text=text,
    )


def _percent(share: float) -> str:
    return "all" if share == 1.0 else f"{100.0 * share:.3g} % of the"


# --- ranges of criteria ---------------------------------------------------------------------------
# Outside the range of a table the ratio at its edge is used, and outside the range of a formula the
# formula itself, so that a demand is never absent.  How many rows that concerns is a check like the
# others.

#: how the ranges are called, by the column or parameter that each is of
_WORDS: Final = {"sphere.nu": "nu", "modulus": "m"}


def check_ranges(
    scene: Scene, answers: Answers, quantities: Collection[str], demands: Demands | None = None
) -> list[Check]:
    """One check per criterion whose demand is among the quantities, named ``range_of_`` and the
    quantity.

    answers: with `p_max` and `a_max`; demands: name -> (criterion, parameters), those of the scene
    if None.  Each row is judged at its largest force; one that breaks earlier never comes so far.
    """
    known: dict[str, tuple[str, Mapping[str, float]]] = {
        entry.quantity: (name, {})
        for name, entry in CRITERIA.items()
        # the range of the contact pressure is that of Hertz, which has a check of its own
        if entry.quantity is not None and name != "contact_pressure"
    }
    known |= dict(scene.demands if demands is None else demands)
    good = answered(answers.status)
    columns = {
        name: np.asarray(values)[good]
        for name, values in {**scene.columns, **answers.values}.items()
    }
    found = []
    for name in dict.fromkeys(quantities):
        if name in known and CRITERIA[known[name][0]].ranges:
            found.append(_check_range(name, CRITERIA[known[name][0]], known[name][1], columns))
    return found


def _check_range(
    quantity: str,
    criterion: Criterion,
    parameters: Mapping[str, float],
    columns: Mapping[str, Array],
) -> Check:
    name = f"range_of_{quantity}"
    inside = in_range(criterion, columns, parameters)
    if len(inside) == 0:
        return _result(name, np.zeros(3), None, _NO_ROW)
    share = float((~inside).sum() / len(inside))
    parts = [_farthest(*part) for part in ranges_of(criterion, columns, parameters)]
    worst = max(parts, key=lambda part: part[0])[1]
    text = f"{criterion.name} is used inside its range ({criterion.range_text})"
    if share > 0.0:
        left = ", ".join(words for beyond, _, words in parts if beyond > 0.0)
        edge = (
            "at the edge of its table"
            if "equal forces" in criterion.range_text
            else "of the formula all the same"
        )
        text = (
            f"in {_percent(share)} rows {criterion.name} is outside its range "
            f"({criterion.range_text}): {left}; its "
            f"value there is that {edge}"
        )
    return _result(name, np.array([0.0, share, 0.0]), worst, text)


def _farthest(key: str, values: Array, low: float, high: float) -> tuple[float, float, str]:
    """How far beyond the bounds over their distance, the value furthest out, and that in words."""
    least, most = float(values.min()), float(values.max())
    below, above = low - least, most - high
    worst = least if below > max(above, 0.0) else most
    found = f"{least:.3g} to {most:.3g}" if min(below, above) > 0.0 else f"{worst:.3g}"
    return max(below, above) / (high - low), worst, f"{_WORDS.get(key, key)} reaches {found}"
