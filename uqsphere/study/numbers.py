"""One number of a study: a fixed value with its unit, a distribution, or what `uqsphere fit` found, all checked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from uqsphere.errors import AccessError, FolderError
from uqsphere.quantities import INPUTS, format_value
from uqsphere.study.columns import inside_folder, open_observations, unit_factor
from uqsphere.study.document import EmpiricalTable
from uqsphere.study.faults import Findings, Misplaced, Place, Raw, one_of, shown, suggestion
from uqsphere.study.particle_tables import ENERGY_OF, FitStrengthTable
from uqsphere.study.tables import bounds_in_words, declared, fixed_value, likely_unit, number_value, read_table
from uqsphere.units import UNITS, Quantity, UnitError
from uqsphere.uq import Law, make_law
from uqsphere.uq.families import FAMILIES, Family, LawError, family_named
from uqsphere.uq.families.observed import DRAWN
from uqsphere.uq.fitting import LEAST_TESTS, count_tests, fitted_law

#: more than this share of a law outside what has a meaning is worth a word
SHARE_WORTH_A_WORD: Final = 1e-6
#: parameters of a law that are values of the quantity itself
_WHERE: Final = ("mean", "mode", "lower", "upper")
#: standard deviation over mean of a positive number that is worth a warning, and that is refused
_WIDE: Final = 3.0
_TOO_WIDE: Final = 1000.0
#: fewer observations than these are worth a warning, and leave open what cannot be told
_FEW: Final = 10
_HARDLY: Final = (
    "a law can be laid through any so few, and how far it is off cannot be told (the standard deviation of a normal "
    f"law by more than a factor of 30); the intervals take it for exact: {_FEW} observations are a start"
)
_OPEN: Final = (
    "what so few leave open is told beside the answers where the evaluations reach it, and is not in their intervals; "
    f"{_FEW} and more leave less"
)


@dataclass(frozen=True, kw_only=True)
class Tested:
    """What a strength was tested at: mean diameter [m], growth of the force over the force [1/s] if it is given."""

    diameter: float
    growth: float | None = None


@dataclass(frozen=True, kw_only=True)
class Reading:
    """A number as understood: SI value or law, the law's parameters as given (SI), whether its data are made up, and
    what they were tested at."""

    value: float | Law
    given: Mapping[str, float] = field(default_factory=dict)
    made_up: bool = False
    tested: Tested | None = None

    @property
    def nominal(self) -> float:
        """The value, or the law's mean before truncation."""
        return self.value.nominal_mean() if isinstance(self.value, Law) else self.value


def plain_quantity(name: str) -> Quantity:
    """The entry of a number without unit and bounds: a black-box input."""
    return Quantity(name=name, symbol=name, dimension="number", lower=-math.inf, meaning=name)


def read_number(raw: object, place: Place, quantity: Quantity, findings: Findings) -> Reading | None:
    """Value or law of `raw`; None, with the faults noted, where it is neither."""
    if isinstance(raw, Mapping):
        return _read_law(raw, place, quantity, findings)
    value = read_fixed(raw, place, quantity, findings)
    return None if value is None else Reading(value=value)


def read_fixed(raw: object, place: Place, quantity: Quantity, findings: Findings) -> float | None:
    """SI value of a fixed number inside the bounds of its meaning; None, with the fault noted, where it is none."""
    try:
        return fixed_value(raw, quantity)
    except UnitError as error:
        findings.add(place, str(error))
        return None


def _unit_beside(raw: Mapping[str, Raw], quantity: Quantity) -> str:
    """The unit that a law's mean, mode or bound has or should have: its scatter is suggested in the same."""
    for value in (raw[key] for key in _WHERE if key in raw):
        if isinstance(value, str) and value.split()[-1:] and value.split()[-1] in UNITS[quantity.dimension]:
            return value.split()[-1]
        if isinstance(value, (int, float)):
            return likely_unit(value, quantity)
    return quantity.display


def _read_law(raw: Mapping[str, Raw], place: Place, quantity: Quantity, findings: Findings) -> Reading | None:
    """The law of a table; None, with the faults noted, where there is none."""
    family = _family(raw, place, findings)
    if family is None:
        return None
    table = None
    if family.observed:
        table = read_table(EmpiricalTable, raw, findings, place)
    else:
        _refuse_unknown(raw, family, place, findings)
    given = _parameters(raw, family, place, quantity, findings)
    if not findings.clean(place):
        return None
    bounds = given.pop("lower", None), given.pop("upper", None)
    with findings.noting(place):
        try:
            law = (make_law(family.name, given, *bounds) if table is None
                   else _observed_law(table, quantity, bounds, findings))  # fmt: skip
        except LawError as error:
            raise _in_units(error, family, quantity) from None
        if not _sensible_scatter(law, place, raw, findings):
            return None
        if table is not None:
            # a law fitted to few observations enters the answers as if it were known
            count = count_tests(law)
            told = _HARDLY if count < LEAST_TESTS else _OPEN if count < _FEW else ""
            if told:
                findings.warn((*place, "file"), f"found {count} observations: {told}")
        _warn_of_bounds(law, given, place, quantity, findings)
        found = Reading(value=law, given=given, made_up=table is not None and table.made_up)
        return found if _inside(law, place, quantity, findings) else None
    return None


def _in_units(error: LawError, family: Family, quantity: Quantity) -> Misplaced:
    """What is wrong with a law, whose own message speaks in SI."""
    spoken = (error.key == "" or error.key in family.dimensional) and any(map(str.isdigit, error.message))
    unit = f" (numbers in {quantity.unit})" if spoken and quantity.unit else ""
    return Misplaced(f"{error.message}{unit}", error.key)


def _family(raw: Mapping[str, Raw], place: Place, findings: Findings) -> Family | None:
    """The distribution that a table names."""
    kind = raw.get("dist")
    family = family_named(kind) if isinstance(kind, str) else None
    if family is not None:
        return family
    if "dist" in raw:
        near = suggestion(kind, FAMILIES) if isinstance(kind, str) else ""
        findings.add((*place, "dist"), f"found {shown(kind)}, known distributions: {one_of(FAMILIES)}{near}")
    elif not findings.touched((*place, "dist")):
        near = f"found a table without dist{suggestion(next(iter(raw)), ['dist'])}" if raw else "found an empty table"
        findings.add(place, f'a distribution is due here, such as {{ dist = "normal", … }}: {near}')
    return None


def _parameters(
    raw: Mapping[str, Raw], family: Family, place: Place, quantity: Quantity, findings: Findings
) -> dict[str, float]:
    """The parameters of a law and its bounds in SI, as far as they are given and in order."""
    found: dict[str, float] = {}
    for key in (*family.keys, "lower", "upper"):
        if key not in raw:
            continue
        due = quantity if key in family.dimensional else plain_quantity(quantity.name)
        if key not in _WHERE:
            beside = _unit_beside(raw, due) if due.dimension != "number" else ""
            due = replace(due, plausible=(0.0, math.inf), display=beside)
        try:
            found[key] = number_value(raw[key], due)
        except UnitError as error:
            findings.add((*place, key), str(error))
    return found


def _observed_law(
    table: EmpiricalTable, quantity: Quantity, bounds: tuple[float | None, float | None], findings: Findings
) -> Law:
    """The law of a column of observations; raises Misplaced and LawError."""
    factor = unit_factor(table.unit, quantity)
    observed = open_observations(table.file, findings.folder)
    data = observed.whole(table.column, "column", factor)
    stopped = np.zeros(len(data), dtype=bool)
    if table.censored is not None:
        stopped = observed.stopped(table.censored, "censored")
        observed.raise_first()
    rest = data[stopped].tolist()
    return fitted_law(data[~stopped].tolist(), table.fit, *bounds, censored=rest, unbiased=table.unbiased)


def _warn_of_bounds(law: Law, given: Mapping[str, float], place: Place, quantity: Quantity, findings: Findings) -> None:
    """A mean that the bounds cut off is the mean of nothing that is drawn: the law in force is a tail of it."""
    middle = given.get("mean")
    if middle is None or law.lower <= middle <= law.upper:
        return
    key, end = ("lower", law.lower) if middle < law.lower else ("upper", law.upper)
    found, limit = (format_value(value, quantity.name) for value in (middle, end))
    findings.warn(
        (*place, key),
        f"the mean {found} lies {'below' if key == 'lower' else 'above'} the bound {limit}: what is drawn is "
        "only a tail of the law, and its mean is another; is that meant?",
    )


def _sensible_scatter(law: Law, place: Place, raw: Mapping[str, Raw], findings: Findings) -> bool:
    """Whether the scatter of a law of positive numbers lets moments be computed; a large one is warned of."""
    try:
        cov = law.family.variation(law.parameters)
    except (OverflowError, ZeroDivisionError, ValueError):
        cov = math.inf
    if cov <= _WIDE:
        return True
    said = f"the standard deviation is {cov:.3g} times the mean"
    truncated = math.isfinite(law.lower) or math.isfinite(law.upper)
    if cov <= _TOO_WIDE or truncated:
        effect = "" if truncated else ": mean and standard deviation of the answers may never become accurate"
        findings.warn(place, f"{said}{effect}; is that meant?")
        return True
    key = next((key for key in ("cov", "sd", "log_sd", "shape", "modulus") if key in raw), "")
    hint = "; a share is due, such as cov = 0.12 for 12 %" if key == "cov" else ""
    findings.add((*place, key) if key else place, f"{said}, at most {_TOO_WIDE:g} can be computed with{hint}")
    return False


def _refuse_unknown(raw: Mapping[str, Raw], family: Family, place: Place, findings: Findings) -> None:
    """Note every key of a law that its distribution does not take."""
    allowed = ("dist", *family.keys, "lower", "upper")
    others = {key for other in FAMILIES.values() for key in other.keys} | set(declared(EmpiricalTable))
    takes = f"{family.name} takes {one_of(allowed[1:])}"
    for key in (key for key in raw if key not in allowed):
        said = f"unknown key {shown(key)}{suggestion(key, allowed) or f'; {takes}'}"
        if key in others:
            said = f"{shown(key)} does not belong to the distribution {takes.replace(' takes', ', which takes', 1)}"
        findings.add((*place, key), said)


def _inside(law: Law, place: Place, quantity: Quantity, findings: Findings) -> bool:
    """Whether the law lies where the quantity has a meaning; a far tail outside is warned of."""
    centre = law.nominal_mean()
    if not quantity.allows(centre):
        found = format_value(centre, quantity.name)
        findings.add(place, f"the distribution has its mean at {found}: {bounds_in_words(quantity)}")
        return False
    if law.family.bounded:
        for key, bound in (("lower", law.lower), ("upper", law.upper)):
            if not quantity.lower <= bound <= quantity.upper:
                findings.add((*place, key), f"{format_value(bound, quantity.name)}: {bounds_in_words(quantity)}")
                return False
        return True
    # mass of the law in force below and above the bounds of meaning
    share = 0.0
    if max(law.lower, law.family.least(law.parameters, law.lower, law.upper)) < quantity.lower:
        share += float(law.cdf(np.array([quantity.lower]))[0])
    if law.upper > quantity.upper:
        share += float(law.sf(np.array([quantity.upper]))[0])
    if share > SHARE_WORTH_A_WORD:
        # A strength below nothing is exceeded by anything; a scene of such numbers cannot be computed at all.
        effect = "these samples count as failed evaluations: " if quantity.name in INPUTS else ""
        findings.warn(
            place,
            f"a share of {share:.2g} of the distribution lies where it has no meaning "
            f"({bounds_in_words(quantity)}); {effect}truncate it with lower or upper, or take another one",
        )
    return True


# --- a strength that uqsphere fit has found -----------------------------------------------------------------


#: draws of a fit that a study carries: the Monte Carlo error of a mean of 200 laws is 7 % of what tests leave open;
#: a diameter counts as tested within this factor
_DRAWS: Final = 200
_BESIDE: Final = 1.01


def is_fit(raw: object) -> bool:
    """Whether a strength is what `uqsphere fit` has found, by its folder."""
    return isinstance(raw, Mapping) and "fit" in raw and not {"dist", "tests", "file"} & set(raw)


def read_fit_strength(
    raw: Mapping[str, Raw], place: Place, quantity: str, radius: float | None, findings: Findings
) -> Reading | None:
    """The fracture energy of the sphere by the draws of a fit, of a mean radius [m]; None, with the faults noted.

    Each draw is one of the laws that the tests allow, and the law in force their mean.
    """
    table = read_table(FitStrengthTable, raw, findings, place)
    if quantity != ENERGY_OF["sphere"]:
        said = 'a fit is of the energy that the particle itself takes up: criterion = "specific_energy"'
        findings.add((*place, "fit"), f'{said} with energy_is = "sphere" goes with it')
    if not table.fit or radius is None or not findings.clean(place):
        return None
    from uqsphere.feed.fit import Posterior, read_fit

    with findings.noting(place):
        folder = inside_folder(table.fit, findings.folder, "fit")
        try:
            posterior, about = Posterior.load(folder), read_fit(folder)
        except (FolderError, AccessError) as error:
            raise Misplaced(str(error), "fit") from None
        diameter = 2.0 * radius
        low, high = about.tested
        if not low / _BESIDE <= diameter <= high * _BESIDE:
            found = (
                f"the sphere of {1e3 * diameter:.4g} mm lies beyond the tests, {1e3 * low:.4g} to {1e3 * high:.4g} mm"
            )
            findings.warn((*place, "fit"), f"{found}: its strength is extrapolated")
        draws = posterior.as_laws(diameter, _DRAWS)
        if not draws:
            raise Misplaced(f"no size class of the fit is near {1e3 * diameter:.4g} mm", "fit")
        tests = 0.0 if about.tests is None else float(about.tests.particles)
        law = Law(family=DRAWN, parameters={"tests": tests}, draws=draws)
        return Reading(value=law, made_up=about.made_up)
    return None
