"""Where the model may be trusted: checks of every row against the assumptions behind it, theory section 9.

Each check measures one number per row and grades it 0 ok, 1 information, 2 warning or 3 failure.  A breach
never stops a run; it is shown with the share of rows that break it.  Failed rows (status not 0) are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags, Places
from uqsphere.mechanics import bars
from uqsphere.mechanics.criteria import CRITERIA, DIAMETERS, ENERGIES, Criterion, Demands, in_range, ranges_of
from uqsphere.mechanics.outputs import Answers
from uqsphere.mechanics.partners import softest_partner, sphere_body
from uqsphere.mechanics.scene import CONTACT_LAWS, Scene, answered
from uqsphere.mechanics.yielding import Body, Face, Press

#: what a grade means
GRADES: Final = ("ok", "information", "warning", "failure")
#: largest depth z of a yielding face that finite elements were seen for (Kogut and Etsion 2002, Jackson and Green 2005)
_SEEN_DEPTH: Final = 110.0
#: a dent [m] after which a lapped flat is no flat any more
_RELAP: Final = 1e-6
#: share of the effective radius beyond which a dent has a curvature of its own
_DEEP_DENT: Final = 0.01
#: largest force difference over P_0 under a step pulse is 1.318 mu^0.45 for small mu, theory section 5
_IMBALANCE: Final = (1.318, 0.45)


@dataclass(frozen=True, kw_only=True)
class Rule:
    """One check: how a row is measured, and beyond what it is graded how.

    Attributes
    ----------
    name, meaning : str
    measure : function of (scene, answers)
        The number per row, (n,), NaN where it says nothing about a row; or a text, why the check is left out.
    information, warning, failure : float or None
        Beyond these a row gets the grade 1, 2, 3; None: the check does not give this grade.
    rising : bool
        Whether beyond means above; otherwise below.
    words : str
        Sentence on a breach, with {worst}, {limit} and {side} of the numbers.
    fine : str
        Sentence where no row breaks it, with {worst} and {limit}.
    laws : tuple of str
        Laws of the contact under which it is asked.
    further : function of (scene, answers, good rows), optional
        What is said further on a breach.
    """

    name: str
    meaning: str
    measure: Callable[[Scene, Answers], Array | str]
    information: float | None = None
    warning: float | None = None
    failure: float | None = None
    rising: bool = True
    words: str
    fine: str
    laws: tuple[str, ...] = CONTACT_LAWS
    further: Callable[[Scene, Answers, Flags], str] | None = None

    @property
    def limit(self) -> float:
        """The mildest of the thresholds."""
        return next(value for value in (self.information, self.warning, self.failure) if value is not None)


@dataclass(frozen=True, kw_only=True)
class Check:
    """Result of one check over a batch.

    The three shares are of the rows that were computed and do not overlap: each row has one grade.  `worst`
    is the worst measured number, None where the check was left out; `text` says it in plain words.
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


_NO_SCENE: Final = "not checked: no scene was computed"
_NO_YIELD: Final = "not checked: the yield strength of the bars is not given"


def _contact_over_radius(scene: Scene, answers: Answers) -> Array | str:
    return np.asarray(answers.values["a_max"] / scene.columns["sphere.radius"])


def _contact_over_bar(scene: Scene, answers: Answers) -> Array | str:
    return np.asarray(2.0 * answers.values["a_max"] / scene.columns["bars.diameter"])


def _positive(values: Array) -> Array:
    return np.where(values > 0.0, values, np.nan)


def _over_onset(scene: Scene, answers: Answers, body: Body, absent: str) -> Array | str:
    """The elastic contact pressure over that at which a body of the face yields."""
    onset = np.where(np.isfinite(body.onset), _positive(body.onset), np.nan)
    return absent if np.isnan(onset).all() else np.asarray(answers.values["p_max"] / onset)


def _over_bar_onset(scene: Scene, answers: Answers) -> Array | str:
    return _over_onset(scene, answers, softest_partner(scene), _NO_YIELD)


def _over_sphere_onset(scene: Scene, answers: Answers) -> Array | str:
    return _over_onset(scene, answers, sphere_body(scene), "not checked: the onset pressure of the sphere is not given")


def _pressed(scene: Scene, answers: Answers, body: Body, good: Flags) -> Press:
    """The face whose body yields at the largest force of every row, by the law without the motion."""
    scales = scene.scales
    face = Face(
        **{name: part[good] for name, part in body._asdict().items()},
        modulus=scales.modulus[good],
        effective_radius=scales.effective_radius[good],
    )
    return face.pressed(face.depth_at(np.asarray(answers.values["P_max"])[good]))


def _static(body_of: Callable[[Scene], Body]) -> Callable[[Scene, Answers, Flags], str]:
    """What the law says without the motion, where a body yields that was taken for elastic."""

    def further(scene: Scene, answers: Answers, good: Flags) -> str:
        yields = body_of(scene)
        with np.errstate(all="ignore"):
            press = _pressed(scene, answers, yields, good & np.isfinite(yields.onset) & np.isfinite(yields.hardness))
        centre, dent = press.centre[np.isfinite(press.centre)], press.dent[np.isfinite(press.dent)]
        if len(centre) == 0 or len(dent) == 0:
            return ""
        said = f"by the static law p_max is at most {centre.max() / 1e9:.3g} GPa"
        return f"; {said}, a dent of {1e6 * dent.max():.2g} um"

    return further


def _depth(scene: Scene, answers: Answers) -> Array | str:
    faces = scene.faces
    if faces is None:
        return "not checked: nothing yields"
    with np.errstate(all="ignore"):
        return np.asarray(faces.depth_at(np.asarray(answers.values["P_max"])))


def _dent_over_radius(scene: Scene, answers: Answers) -> Array | str:
    depth = _depth(scene, answers)
    if isinstance(depth, str) or scene.faces is None:
        return depth
    with np.errstate(all="ignore"):
        return np.asarray(scene.faces.pressed(depth).dent / scene.scales.effective_radius)


def _dents(scene: Scene, answers: Answers, good: Flags) -> str:
    depth = _depth(scene, answers)
    assert scene.faces is not None
    assert not isinstance(depth, str)
    dent = scene.faces.pressed(depth).dent[good]
    flats_yield = bool((softest_partner(scene).onset <= sphere_body(scene).onset).any())
    due = ": re-lap the bars" if flats_yield and np.nanmax(dent) > _RELAP else ""
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


def _transits(scene: Scene, answers: Answers) -> Array | str:
    c = scene.columns
    with np.errstate(all="ignore"):
        transit = 2.0 * c["sphere.radius"] / bars.wave_speed(c["sphere.E"], c["sphere.density"])
        return np.asarray(answers.values["rise_time"] / transit)


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
        return np.asarray(rise * bars.wave_speed(c["bars.E"], c["bars.density"]) / (0.5 * c["bars.diameter"]))


def _pulse_over_scale(scene: Scene, answers: Answers) -> Array | str:
    return np.asarray(scene.scales.pulse_number)


def _record_over_echo(scene: Scene, answers: Answers) -> Array | str:
    if not scene.infinite:
        return "not needed: what the far ends send back, if anything, is part of the model"
    # an end known to absorb sends nothing back; one that is not given may
    echoing = [scene.column(f"bars.{bar}_end", 1.0) != 0.0 for bar in ("incident", "receiving")]
    first = np.where(np.stack(echoing, axis=1), scene.round_trips, np.inf).min(axis=1)
    if not np.any(np.isfinite(first)):
        return "not checked: the bars are taken as infinite and no length with a reflecting end is given"
    return np.asarray(answers.record / first)


RULES: Final[tuple[Rule, ...]] = (
    Rule(name="small_contact", meaning="contact radius over sphere radius (Hertz: small)",
         measure=_contact_over_radius, warning=0.2, failure=0.3,
         words="the contact is not small against the sphere, a/r reaches {worst} (limit {limit})",
         fine="contact small against the sphere: a/r at most {worst} (limit {limit})"),
    Rule(name="contact_on_bar_end", meaning="contact radius over bar radius (Hertz: half space)",
         measure=_contact_over_bar, warning=0.2,
         words="the bar's end is no half space to the contact, a/(d_b/2) reaches {worst} "
               "(limit {limit})",
         fine="contact small against the bar's end: a/(d_b/2) at most {worst} (limit {limit})"),
    Rule(name="bar_yield_contact", meaning="contact pressure over that at which the bars yield (elastic contact)",
         measure=_over_bar_onset, warning=1.0, laws=("hertz", "damage"), further=_static(softest_partner),
         words="the bars yield under the sphere, p_0 reaches {worst} times the pressure at which they begin to",
         fine="bars elastic under the sphere: p_0 at most {worst} times the pressure at which they begin to yield"),
    Rule(name="bar_yield_pulse", meaning="stress of the pulse over the bars' yield strength (elastic waves)",
         measure=_pulse_over_yield, warning=1.0,
         words="the pulse makes the bars yield, its stress reaches {worst} times their yield strength",
         fine="bars elastic under the pulse: its stress is at most {worst} times their yield strength"),
    Rule(name="force_balance", meaning="largest difference of the two forces over the largest force",
         measure=_imbalance, information=0.05, warning=0.1,
         words="the two forces differ by up to {worst} of the largest at some instant (limit "
               "{limit}; at the peak itself it may be less): one gauge does not stand for both faces",
         fine="forces in balance: they differ by at most {worst} of the largest (limit {limit})"),
    Rule(name="quasi_static_sphere", meaning="wave transits of the sphere, 2 r/sqrt(E/rho), in the rise time",
         measure=_transits, warning=4.0, failure=3.0, rising=False,
         words="a wave, at sqrt(E/rho), crosses the sphere only {worst} times while the force rises from "
               "10 % to 90 % (at least {limit}), too few for a quasi-static sphere",
         fine="sphere quasi-static: a wave, at sqrt(E/rho), crosses it at least {worst} times while the "
              "force rises from 10 % to 90 % (at least {limit})"),
    Rule(name="one_dimensional_bars", meaning="rise of the pulse over bar radius/c_0 (one-dimensional waves)",
         measure=_pulse_rise, warning=5.0, rising=False,
         words="the pulse rises or falls within {worst} bar radii/c_0 (at least {limit}), sharper "
               "than one-dimensional waves can carry",
         fine="pulse smooth enough for one-dimensional waves: it rises in at least {worst} bar radii/c_0 "
              "(at least {limit})"),
    Rule(name="force_level", meaning="pulse length over t_c (does the force come near P_0 = Z v_0/2?)",
         measure=_pulse_over_scale, information=2.0, rising=False,
         words="the pulse is short, in the worst scene {worst} t_c (near P_0 from {limit}): the force of the first "
               "loading stays below P_0 = Z v_0/2 and depends on the pulse's length",
         fine="pulse long against the contact: at least {worst} t_c (from {limit} on the force nears "
              "P_0 = Z v_0/2)"),
    Rule(name="before_reflection", meaning="record over the first return of a reflected wave (infinite bars)",
         measure=_record_over_echo, information=1.0,
         words="infinite bars were asked for, but the record runs to {worst} times the first return of a "
               "reflected wave in bars of the given length",
         fine="infinite bars: the record ends before a wave is back, at {worst} times its first return"),
    Rule(name="sphere_yield_contact", meaning="contact pressure over that at which the sphere yields or crushes",
         measure=_over_sphere_onset, warning=1.0, laws=("hertz", "damage"), further=_static(sphere_body),
         words="the sphere crushes at its poles, p_0 reaches {worst} times the pressure at which it begins to",
         fine="sphere elastic at its poles: p_0 at most {worst} times the pressure at which it begins to crush"),
    Rule(name="dented", meaning="approach over that at which a face first yields",
         measure=_depth, information=1.0, laws=("plastic",), further=_dents,
         words="a face yields, its approach reaches {worst} times that at first yield",
         fine="no face yields: the approach is at most {worst} of that at first yield"),
    Rule(name="plastic_range", meaning="approach over that at which a face first yields (law seen up to 110)",
         measure=_depth, warning=_SEEN_DEPTH, failure=1000.0, laws=("plastic",),
         words="a face is pressed to {worst} times its first yield, beyond what its law was compared with ({limit})",
         fine="faces inside what their law was compared with: at most {worst} times the first yield (limit {limit})"),
    Rule(name="deep_dent", meaning="dent over the effective radius (the next blow meets the same curvature)",
         measure=_dent_over_radius, warning=_DEEP_DENT, laws=("plastic",),
         words="a dent is deep beside the curvature of the face, {worst} of its radius (limit {limit})",
         fine="dents shallow: at most {worst} of the radius (limit {limit})"),
    Rule(name="insert_thickness", meaning="three contact radii over the thickness of the inserts",
         measure=_contact_over_insert, warning=1.0,
         words="the inserts are thin, three contact radii reach {worst} of their thickness: the bar yields below them",
         fine="inserts thick enough: three contact radii are at most {worst} of their thickness"),
)  # fmt: skip


#: takes the place of force_balance where it is known when the sphere breaks
_AT_FRACTURE: Final = Rule(
    name="force_balance", meaning="difference of the two forces at fracture over the largest so far",
    measure=_imbalance, information=0.05, warning=0.1,
    words="the two forces differ by up to {worst} of the largest when it comes to fracture (limit {limit}): one gauge "
          "does not stand for both faces, and the stress inside is not that of equal forces",
    fine="forces in balance when the sphere breaks: they differ by at most {worst} of the largest (limit {limit})",
)  # fmt: skip


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
        and (rule.name != "insert_thickness" or "bars.insert_E" in scene.columns)
        and (rule.name != "sphere_yield_contact" or "sphere.onset_pressure" in scene.columns)
    )


def check_validity(scene: Scene, answers: Answers) -> list[Check]:
    """Every check that is asked of a batch, on its answers, in the order of `RULES`.

    Raises
    ------
    ValueError
        If the answers are not those of as many rows.
    """
    if len(answers.status) != len(scene):
        raise ValueError(f"{len(answers.status)} answers do not belong to a batch of {len(scene)} scenes")
    good = answered(answers.status)
    return [_check(rule, scene, answers, good) for rule in rules_of(scene)]


def check_at_fracture(imbalance: Array, weights: Array) -> Check:
    """The balance of the forces where it matters: at the fracture of n specimens, and not at a peak never reached.

    Parameters
    ----------
    imbalance : (n,) array
        Difference of the two forces over the largest so far at the moment of fracture; NaN is left out.
    weights : (n,) array
        What each specimen stands for.

    >>> check = check_at_fracture(np.array([0.01, 0.02, 0.2, 0.07]), np.array([3.0, 3.0, 1.0, 1.0]))
    >>> check.share_warning, check.share_information
    (0.125, 0.125)
    """
    rule = _AT_FRACTURE
    known = ~np.isnan(imbalance) & (weights > 0.0)
    if not known.any():
        return _result(rule.name, np.zeros(3), None, "not checked: no specimen breaks")
    measured, mass = imbalance[known], weights[known] / weights[known].sum()
    worst = float(measured.max())
    shares = np.asarray(np.bincount(grades(rule, measured), weights=mass, minlength=4)[1:], dtype=float)
    numbers = {"worst": f"{worst:.3g}", "limit": f"{rule.limit:.3g}"}
    if not shares.any():
        return _result(rule.name, shares, worst, rule.fine.format(**numbers))
    broken = f"{_percent(float(min(shares.sum(), 1.0)))} specimens that break".replace(
        "all specimens", "all the specimens"
    )
    return _result(rule.name, shares, worst, f"in {broken} {rule.words.format(**numbers)}")


def _check(rule: Rule, scene: Scene, answers: Answers, good: Flags) -> Check:
    measured = rule.measure(scene, answers)
    if isinstance(measured, str):
        return _without_number(rule, scene, measured, bool(good.any()))
    usable = measured[good & ~np.isnan(measured)]
    if len(usable) == 0:
        return _result(rule.name, np.zeros(3), None, _NO_SCENE)
    worst = float(usable.max() if rule.rising else usable.min())
    shares = np.bincount(grades(rule, usable), minlength=4)[1:] / len(usable)
    broken = float(shares.sum())
    seen = f"{worst:.3g}" if np.isfinite(worst) else "endlessly many"
    numbers = {"worst": seen, "limit": f"{rule.limit:.3g}"}
    if broken == 0.0:
        return _result(rule.name, shares, worst, rule.fine.format(**numbers))
    further = "" if rule.further is None else rule.further(scene, answers, good)
    text = f"in {_percent(broken)} scenes {rule.words.format(**numbers)}{further}"
    return _result(rule.name, shares, worst, text)


def _without_number(rule: Rule, scene: Scene, why: str, any_row: bool) -> Check:
    """A check that measures nothing: left out, or a jump of the pulse, which concerns every row alike."""
    if rule.name == "one_dimensional_bars" and any_row:
        text = f"the ideal {scene.shape} pulse jumps, sharper than any bar can carry: a real one needs time"
        return _result(rule.name, np.array([1.0, 0.0, 0.0]), 0.0, text)
    return _result(rule.name, np.zeros(3), None, why)


def _result(name: str, shares: Array, worst: float | None, text: str) -> Check:
    information, warning, failure = (float(share) for share in shares)
    # an endless pulse is infinitely long, and a report holds no infinity
    finite = worst if worst is not None and np.isfinite(worst) else None
    return Check(check=name, share_information=information, share_warning=warning, share_failure=failure,
                 worst=finite, text=text)  # fmt: skip


def _percent(share: float) -> str:
    return "all" if share == 1.0 else f"{100.0 * share:.3g} % of the"


# --- ranges of criteria -------------------------------------------------------------------------------
# Outside the range of a table the ratio at its edge is used, and outside the range of a formula the formula itself, so
# that a demand is never absent.  How many samples that concerns is a check like the others.

#: how the ranges are called, by the column or parameter that each is of
_WORDS: Final = {"sphere.nu": "nu", "modulus": "m"}


def check_ranges(
    scene: Scene, answers: Answers, quantities: Collection[str], demands: Demands | None = None
) -> list[Check]:
    """One check per criterion whose demand is among the quantities, named ``range_of_`` and the quantity.

    Parameters
    ----------
    scene, answers : a batch and its answers, with `p_max` and `a_max` among them
    quantities : names of quantities of interest; those that are no criterion with a range are passed over
    demands : further quantities, name -> (criterion, parameters); those of the scene if None

    Each row is judged at its largest force; one that breaks earlier never comes so far.
    """
    known: dict[str, tuple[str, Mapping[str, float]]] = {
        entry.quantity: (name, {})
        for name, entry in CRITERIA.items()
        # the range of the contact pressure is that of Hertz, which has a check of its own
        if entry.quantity is not None and name != "contact_pressure"
    }
    known |= dict(scene.demands if demands is None else demands)
    good = answered(answers.status)
    columns = {name: np.asarray(values)[good] for name, values in {**scene.columns, **answers.values}.items()}
    found = []
    for name in dict.fromkeys(quantities):
        if name in known and CRITERIA[known[name][0]].ranges:
            found.append(_check_range(name, CRITERIA[known[name][0]], known[name][1], columns))
    return [*found, *([_check_product(columns)] if "t10" in quantities else [])]


def _check_range(
    quantity: str, criterion: Criterion, parameters: Mapping[str, float], columns: Mapping[str, Array]
) -> Check:
    name = f"range_of_{quantity}"
    inside = in_range(criterion, columns, parameters)
    if len(inside) == 0:
        return _result(name, np.zeros(3), None, _NO_SCENE)
    share = float((~inside).sum() / len(inside))
    parts = [_farthest(*part) for part in ranges_of(criterion, columns, parameters)]
    worst = max(parts, key=lambda part: part[0])[1]
    if share == 0.0:
        text = f"{criterion.name} is used inside its range ({criterion.range_text})"
    else:
        left = ", ".join(words for beyond, _, words in parts if beyond > 0.0)
        edge = "at the edge of its table" if "equal forces" in criterion.range_text else "of the formula all the same"
        text = (
            f"in {_percent(share)} scenes {criterion.name} is outside its range ({criterion.range_text}): {left}; its "
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


def _check_product(columns: Mapping[str, Array]) -> Check:
    """The fineness against the energies and sizes that its A and b are fitted to."""
    energy, size = columns["specific_energy"], 2.0 * columns["sphere.radius"]
    allowed = "0.1 to 2.5 kWh/t, 13 to 63 mm"
    if len(energy) == 0:
        return _result("range_of_t10", np.zeros(3), None, _NO_SCENE)
    outside = [(energy < ENERGIES[0]) | (energy > ENERGIES[1]), (size < DIAMETERS[0]) | (size > DIAMETERS[1])]
    share = float((outside[0] | outside[1]).sum() / len(energy))
    lowest, highest = float(energy.min()), float(energy.max())
    worst = lowest if ENERGIES[0] / lowest > highest / ENERGIES[1] else highest
    text = f"t10 is used where A and b are measured ({allowed})"
    if share > 0.0:
        spans = (f"{lowest / 3600.0:.3g} to {highest / 3600.0:.3g} kWh/t",
                 f"{1e3 * size.min():.3g} to {1e3 * size.max():.3g} mm")  # fmt: skip
        left = " and ".join(span for span, which in zip(spans, outside, strict=True) if which.any())
        text = (
            f"in {_percent(share)} scenes t10 is outside the range of the drop-weight tests ({allowed}): found {left}"
        )
    return _result("range_of_t10", np.array([0.0, share, 0.0]), worst, text)
