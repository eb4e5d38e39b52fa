"""Validity checks: every row against the assumptions of the model, theory section 9.

Each check measures one number per row and grades it 0 ok, 1 note, 2 warning or 3 failure.  A breach
never stops a run; it is reported with the percentage of rows concerned.  Failed rows (status not 0)
are excluded.  Thresholds and sentences are in ``validity.toml``.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import field, replace
from functools import partial, reduce
from math import inf, nan

import numpy as np

from uqsphere.arrays import Array, Names, Places, Values, frozen, quiet

from . import bars, contact
from .criteria import CRITERIA, Demands, Parameters, ranges_of
from .inputs import declared
from .outputs import SceneAnswers, loss_to_waves
from .rigs import GRAVITY, sphere_body, terminal_speed
from .scene import Scene, answered
from .yielding import ContactParameters, Face, softer

#: residual indentation [m] beyond which a lapped flat needs lapping again
_RELAP = 1e-6
#: largest force difference over P_0 under a step pulse is 1.318 mu^0.45 for small mu, theory
#: section 5
_IMBALANCE = (1.318, 0.45)
#: the share of the samples whose largest number is told too, if it is below so much of the worst
_USUAL = 0.95
_FAR = 0.9


@frozen
class Rule:
    """One check: thresholds of its grades 1, 2, 3 and its sentence; fields as in validity.toml."""

    name: str
    words: str
    information: float = nan
    warning: float = nan
    failure: float = nan
    rising: bool = True
    law: str = ""
    movers: Names = ()
    ahead: str = ""
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
            and self.ahead in ("", scene.partners[1].kind)
            and (not self.needs or self.needs in scene.columns)
        )


#: every check by its key; two with one name are one to the reader, in different rigs
RULES = declared("validity.toml", Rule)


@frozen
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
        return int(max(np.flatnonzero(self.shares) + 1, default=0))

    @property
    def share(self) -> float:
        """Fraction of the rows that break the check."""
        return sum(self.shares)


# --- what the checks measure ----------------------------------------------------------------------


class Measures(dict[str, Values]):
    """Columns of a batch and its answers by name, (n,) each, and the number that each check
    measures of them: a method for every rule, named by its key.

    It is (n,), with NaN for rows that the check does not apply to; None for a scene that it does
    not apply to.  Sentences on a breach end with what a method of `ADVICE` adds.
    """

    def __init__(self, scene: Scene, answers: SceneAnswers) -> None:
        super().__init__({**scene.columns, **answers.values})
        self.scene = scene
        self.answers = answers
        self.good = answered(answers.status)
        self.sphere = sphere_body(scene.columns)
        #: the counter-body that yields first in each row
        self.partner = reduce(softer, [partner.body for partner in scene.there])
        #: numbers of the counter-body ahead, by their keys
        self.ahead = partial(scene.numbers, scene.partners[1].table)
        self.faces = [partner.face for partner in scene.there if partner.face is not None]

    # --- contact and yield ---

    def small_contact(self) -> Values:
        return self["a_max"] / self["sphere.radius"]

    def one_sided_field(self) -> Values:
        imbalance = self.get("force_imbalance", inf)
        return np.where(imbalance > 0.1, self.small_contact(), nan)

    def contact_on_bar_end(self) -> Values:
        (diameter,) = self.ahead("diameter")
        return 2.0 * self["a_max"] / diameter

    def bar_yield_contact(self) -> Values:
        return _over_onset(self["p_max"], self.partner.onset)

    def sphere_yield_contact(self) -> Values:
        return _over_onset(self["p_max"], self.sphere.onset)

    def face_yield(self) -> Values | None:
        """Hertz pressure at peak force / onset pressure of the counter-bodies; the largest."""
        ratios = []
        for partner in self.scene.there:
            radius = partner.effective_radius
            hertz = contact.pressure_at_force(self["P_max"], partner.modulus, radius)
            ratios.append(_over_onset(hertz, partner.body.onset))
        return _extreme(np.fmax, ratios)

    def _partner_estimate(self) -> str:
        return self._static_estimate(self.partner)

    def _static_estimate(self, body: ContactParameters) -> str:
        """Pressure and indentation, by statics, of a body that was taken as elastic."""
        scales = self.scene.scales
        law = Face(
            **body._asdict(), modulus=scales.modulus, effective_radius=scales.effective_radius
        )
        rows = np.flatnonzero(self.good & np.isfinite(body.onset) & np.isfinite(body.hardness))
        face = law.at(rows)
        press = face.pressed(face.depth_at(self["P_max"][rows]))
        centre = press.p_max[np.isfinite(press.p_max)]
        dent = press.dent_left[np.isfinite(press.dent_left)]
        if len(centre) == 0 or len(dent) == 0:
            return ""
        pressure = f"{centre.max() / 1e9:.3g} GPa"
        depth = f"{1e6 * dent.max():.2g} um"
        return f". Static plastic estimate: p_max up to {pressure}, indentation {depth}"

    def _at_peak(self, number: Callable[[Face, Array], Array]) -> Values | None:
        """A number of each contact that yields, at the depth of the peak force; the largest."""
        force = self["P_max"]
        return _extreme(np.maximum, [number(face, face.depth_at(force)) for face in self.faces])

    def dented(self) -> Values | None:
        return self._at_peak(lambda face, depth: depth)

    plastic_range = pressure_shape = dented

    def deep_dent(self) -> Values | None:
        return self._at_peak(
            lambda face, depth: face.pressed(depth).dent_left / face.effective_radius
        )

    def _dents(self) -> str:
        depths = self._at_peak(lambda face, depth: face.pressed(depth).dent_left)
        assert depths is not None
        deepest = np.nanmax(depths[self.good])
        text = f". Residual indentation: up to {1e6 * deepest:.2g} um"
        flats_yield = (self.partner.onset <= self.sphere.onset).any()
        # faces that are used again: those of bars and platens
        if flats_yield and deepest > _RELAP and self.scene.setup.mover in ("striker", ""):
            text += "; lap the flat faces again"
        return text

    def softer_body(self) -> Values | None:
        """Onset ratio of the harder and the softer body, the least of the contacts that yield.

        It is 1 where the body with the higher onset has the lower hardness.
        """
        sphere = self.sphere
        ratios = []
        for partner in self.scene.there:
            if partner.face is not None:
                body = partner.body
                ratio = np.maximum(body.onset, sphere.onset) / np.minimum(body.onset, sphere.onset)
                crossed = (body.onset < sphere.onset) != (body.hardness < sphere.hardness)
                ratios.append(np.where(crossed & np.isfinite(ratio), 1.0, ratio))
        return _extreme(np.fmin, ratios)

    def insert_thickness(self) -> Values:
        return 3.0 * self["a_max"] / self.scene.column("bars.insert_thickness")

    # --- waves in the sphere, in bars and in plates ---

    def bar_yield_pulse(self) -> Values:
        level = 1.0
        ratio = self.scene.striker_ratio
        if self.scene.shape == "two_peak":
            level = np.maximum(self["pulse.level1"], self["pulse.level2"])
        if ratio is not None:
            level = 2.0 * ratio / (1.0 + ratio)
        stress = level * bars.pulse_stress(
            self["striker.speed"], self["bars.E"], self["bars.density"]
        )
        return _over_onset(stress, self.scene.column("bars.yield_strength"))

    def force_balance(self) -> Values:
        measured = self["force_imbalance"]
        if np.any(measured > 0.0):
            return measured
        # forces of the massless model are balanced by assumption: the mass number gives an estimate
        factor, power = _IMBALANCE
        scales = self.scene.scales
        return factor * scales.mass_number**power * scales.force / self["P_max"]

    def quasi_static_sphere(self) -> Values:
        return self._transits("rise_time")

    def quasi_static_impact(self) -> Values:
        return self._transits("loaded_time")

    def _transits(self, time: str) -> Values:
        """Wave transits of the sphere, 2 r/sqrt(E/rho), in a time."""
        speed = bars.wave_speed(self["sphere.E"], self["sphere.density"])
        return self[time] * speed / (2.0 * self["sphere.radius"])

    def one_dimensional_rod(self) -> Values:
        return self._bar_transits(self["rise_time"])

    def _bar_transits(self, time: Values) -> Values:
        """Wave transits of the radius of a bar in a time."""
        diameter, E, density = self.ahead("diameter E density")
        return time * bars.wave_speed(E, density) / (0.5 * diameter)

    def one_dimensional_bars(self) -> Values | None:
        scene = self.scene
        breaks = scene.pulse.breaks
        if scene.shape in ("rectangular", "step"):
            return None
        rise: Values = 0.5 * scene.pulse.end
        if scene.shape in ("trapezoid", "ramp"):
            rise = np.minimum(self["pulse.rise"], scene.column("pulse.fall", inf))
        elif scene.record is not None:
            rise = scene.record.rise / 0.8
        elif scene.shape == "two_peak":
            rise = np.minimum(breaks[:, 1], breaks[:, 4] - breaks[:, 3])
        return self._bar_transits(rise)

    def ideal_pulse(self) -> Values | None:
        if self.scene.shape not in ("rectangular", "step"):
            return None
        return np.zeros(len(self.scene))

    def force_level(self) -> Values:
        return self.scene.scales.pulse_number

    def before_reflection(self) -> Values | None:
        scene = self.scene
        if not scene.infinite:
            return None
        # an end that is given as absorbing reflects nothing; one that is not given may
        ends = [scene.column(f"bars.{bar}_end", 1.0) for bar in ("incident", "receiving")]
        first = np.where(np.transpose(ends) != 0.0, scene.round_trips, inf).min(axis=1)
        return self.answers.record / np.where(np.isfinite(first), first, nan)

    def echo_in_contact(self) -> Values | None:
        if not np.any(np.isfinite(self.scene.first_echo)):
            return None
        return self["loaded_time"] / self.scene.first_echo

    def thin_plate(self) -> Values:
        """Thickness over contact radius, or wave transits of the thickness if fewer, but at least
        2.

        A plate that is thick for the contact time is no failure: the kind `thick` fits it better.
        """
        E, nu, density, thickness = self.ahead("E nu density thickness")
        sound = np.sqrt(E * (1.0 - nu) / (density * (1.0 + nu) * (1.0 - 2.0 * nu)))
        transits = self["loaded_time"] * sound / (2.0 * thickness)
        return np.minimum(thickness / self["a_max"], np.maximum(transits, 2.0))

    def plate_edge(self) -> Values:
        """Contact time over the return time of the flexural wave from the plate edge.

        The group speed is that of a half period equal to the contact time t, c_g = 2 (D/(rho
        h))^(1/4) sqrt(pi/t), over a path of one width.
        """
        E, nu, density, thickness, width = self.ahead("E nu density thickness width")
        loaded = self["loaded_time"]
        bending = E * np.square(thickness) / (12.0 * (1.0 - nu * nu) * density)
        return loaded * 2.0 * bending**0.25 * np.sqrt(np.pi / loaded) / width

    def wave_loss(self) -> Values | None:
        return loss_to_waves(self.scene)

    # --- what the model leaves out, and how well it is solved ---

    def gravity(self) -> Values:
        behind = self.scene.partners[0]
        moving = self.scene.scales.mass
        if behind is not None:
            moving = moving + behind.mass
        return moving * GRAVITY / self["P_max"]

    def drag(self) -> Values:
        terminal = terminal_speed(self["sphere.radius"], self["sphere.density"])
        return self["rig.drop_height"] * GRAVITY / terminal**2

    def oblique(self) -> Values:
        return np.rad2deg(self["rig.angle"])

    def grazing_contact(self) -> Values:
        return self.answers.grazes

    def chatter(self) -> Values:
        return self["retouches"]


def _over_onset(pressure: Values, onset: Array) -> Values:
    """Contact pressure / onset pressure; NaN for a body that does not yield."""
    return pressure / np.where((onset > 0.0) & np.isfinite(onset), onset, nan)


def _extreme(choose: np.ufunc, numbers: Sequence[Array]) -> Values | None:
    """The largest or smallest of the numbers of several contacts; None without one."""
    return choose.reduce(numbers) if numbers else None


#: method of `Measures` that gives the end of the sentence on a breach
ADVICE = {
    "bar_yield_contact": Measures._partner_estimate,
    "sphere_yield_contact": lambda self: self._static_estimate(self.sphere),
    "dented": Measures._dents,
    "face_yield": Measures._partner_estimate,
}


# --- the checks of a batch ------------------------------------------------------------------------


def grades_of(rule: Rule, measured: Array) -> Places:
    """Grade 0 to 3 of every row; a row without a number is graded 0.

    >>> grades_of(RULES["small_contact"], np.array([0.1, 0.25, 0.4, nan])).tolist()
    [0, 2, 3, 0]
    """
    grades = np.zeros(len(measured), np.int64)
    for grade, threshold in enumerate(rule.thresholds, start=1):
        beyond = measured > threshold if rule.rising else measured < threshold
        grades[beyond] = grade
    return grades


@quiet
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
    measures = Measures(scene, answers)
    checks = []
    for key, rule in RULES.items():
        measured = getattr(measures, key)() if rule.applies(scene) else None
        if measured is not None:
            check = _check(rule, measures, np.asarray(measured))
            if check.text and key in ADVICE:
                check = replace(check, text=check.text + ADVICE[key](measures))
            checks.append(check)
    return checks + _check_ranges(measures, quantities)


def _check(rule: Rule, measures: Measures, measured: Array) -> ValidityCheck:
    grades = grades_of(rule, measured)
    usable = measures.good & ~np.isnan(measured)
    if not usable.any():
        return ValidityCheck(check=rule.name, grades=grades)
    numbers = measured[usable]
    worst = float(numbers.max() if rule.rising else numbers.min())
    shares = np.bincount(grades[usable], minlength=4)[1:] / len(numbers)
    text = ""
    grade = int(grades[usable].max())
    if grade:
        shown = f"{worst:.3g}" if np.isfinite(worst) else "unlimited"
        if rule.rising and shares.sum() > 1.0 - _USUAL:
            most = float(np.quantile(numbers, _USUAL, method="inverted_cdf"))
            if most < _FAR * worst:
                shown += f" ({most:.3g} in {100.0 * _USUAL:.3g} % of the samples)"
        # the threshold of the grade that the worst row reaches
        limit = f"{rule.thresholds[grade - 1]:.3g}"
        words = rule.words.format(worst=shown, limit=limit, shape=measures.scene.shape)
        text = f"{_rows_text(shares[grade - 1])}: {words.replace(') (limit', '; limit')}"
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
    return "all samples" if fraction == 1.0 else f"{100.0 * fraction:.3g} % of the samples"


# --- ranges of criteria ---------------------------------------------------------------------------
# Outside a table the value at its edge is used, outside the range of a formula the formula itself,
# so that a demand is never missing.  How many rows that concerns is a check like the others.

#: symbols of columns and parameters that have a range
_SYMBOLS = {"sphere.nu": "nu", "modulus": "m"}


def _check_ranges(measures: Measures, quantities: Collection[str]) -> list[ValidityCheck]:
    ranged: Demands = {
        entry.quantity: (name, {})
        for name, entry in CRITERIA.items()
        # the range of the contact pressure is Hertz's, which has its own check
        if entry.quantity is not None and name != "contact_pressure"
    }
    criteria = {**ranged, **measures.scene.demands}
    columns = {name: column[measures.good] for name, column in measures.items()}
    return [
        _check_range(name, *criteria[name], columns, measures)
        for name in dict.fromkeys(quantities)
        if name in criteria and CRITERIA[criteria[name][0]].ranges
    ]


def _check_range(
    quantity: str,
    key: str,
    parameters: Parameters,
    columns: Mapping[str, Array],
    measures: Measures,
) -> ValidityCheck:
    """A check like the others; columns: of the computed rows."""
    criterion = CRITERIA[key]
    good = measures.good
    is_outside = np.zeros(len(good))
    outside = []
    for name, values, low, high in ranges_of(criterion, columns, parameters):
        is_outside[good] = np.where((values >= low) & (values <= high), is_outside[good], 1.0)
        ends = ((values.min(initial=low), low), (values.max(initial=high), high))
        texts = [f"{end:.3g}" for end, limit in ends if end != limit]
        if texts:
            outside.append(f"{_SYMBOLS.get(name, name)} = {' to '.join(texts)}")
    consequence = "the formula is extrapolated"
    if "equal forces" in criterion.range_text:
        consequence = "the value at the table edge is used"
    rule = Rule(
        name=f"range_of_{quantity}",
        words=f"{criterion.name} is outside its range ({criterion.range_text}), "
        f"{', '.join(outside)}: {consequence}",
        warning=0.5,
    )
    return replace(_check(rule, measures, is_outside), worst=None)
