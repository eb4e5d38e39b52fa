"""Strengths from a file: a column of observations, draws of a fit, or forces at which spheres broke between platens.

A crushing test is a slow compression between two flat platens.  By the law of the study's contact its force gives the
value that the limit's criterion reached, and those values the strength.  `equivalent_force` goes the other way: the
force that gives a row's value on the row's own sphere in the rig of the tests; `test_force` carries it to the size of
the tests, where `Tested.law` holds.  So the scatter of E and nu in the tests is never counted twice.  One size law
serves rows, curves and the free number: `Tested.exponent`; without any, sizes are held within 50 % of the tests.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, Final

import numpy as np
from pydantic import ValidationError

from uqsphere.arrays import Array, Flags, Values
from uqsphere.errors import AccessError, UsageError
from uqsphere.files import is_device_name
from uqsphere.materials import library
from uqsphere.mechanics import contact
from uqsphere.mechanics.criteria import CRITERIA
from uqsphere.mechanics.criteria import demand as demand_of
from uqsphere.mechanics.outputs import OUTPUTS, at_force, follows_force
from uqsphere.mechanics.yielding import Face
from uqsphere.quantities import INPUTS
from uqsphere.study.document import (
    Fault,
    Number,
    Observations,
    Place,
    Reader,
    fault_text,
    one_of,
    shown,
    suggestion,
    value_of,
)
from uqsphere.study.study import Limit, Tested
from uqsphere.tables import Table, TableError, read_table
from uqsphere.units import UNITS, Quantity
from uqsphere.uq import Law, LawError
from uqsphere.uq.fitting import STRENGTHS, fitted_law, law_of_draws, make_tests, probability_of

#: fewer observations than these are worth a warning
_FEW: Final = 10
#: ratio of diameters of tests and sphere that is told, and beyond which nothing but a size law carries a strength
SIZES_TOLD, SIZES_REFUSED = 1.1, 1.5
#: a criterion rises at least with this power of the force
_RISES: Final = 0.05
#: usual strengths by dimension, the pressures of tensions and of contacts, and usual 0.9 P/D² of brittle spheres
USUAL: Final = {"pressure": (1e5, 5e9), "specific_energy": (1.0, 2e4), "toughness": (1e4, 2e7)}
_CONTACT: Final = (3e7, 1e11)
_TENSION: Final = (2e5, 5e8)
#: a row as many robust deviations from the rest of the logarithms is told, and a fit less likely than this
_APART, _UNLIKELY = 5.0, 0.01


@dataclass(frozen=True, kw_only=True)
class Demand:
    """What a limit holds against its strength: a quantity, or a criterion with its parameters by a name of its own."""

    quantity: str
    criterion: str | None = None
    parameters: Mapping[str, float]

    @property
    def base(self) -> str:
        """The quantity of interest that is the demand, but for its parameters."""
        return self.quantity if self.criterion is None else CRITERIA[self.criterion].quantity or self.criterion

    @property
    def place(self) -> str:
        """The part of the sphere that it is a load of, as of a `Quantity`."""
        entry = OUTPUTS.get(self.quantity) if self.criterion is None else CRITERIA[self.criterion]
        return "" if entry is None else entry.place


# --- the force in the test that is worth a row's value -------------------------------------------------------------


def reached(demand: Demand, force: Array, sphere: Mapping[str, Values], radius: Array, platens: tuple[float, float],
            rate: Array | None = None) -> Array:  # fmt: skip
    """The value (n,) of a demand in spheres of a radius (n,) that are pressed to a force (n,) between platens.

    Parameters as of `equivalent_force`; rate: of the loading [N/s].
    """
    full = {key: np.broadcast_to(np.asarray(value, dtype=float), radius.shape) for key, value in sphere.items()}
    E, nu, mass, takes = full["E"], full["nu"], contact.sphere_mass(radius, full["density"]), full.get("takes")
    modulus, compliance = np.asarray(contact.reduced_modulus(E, nu, *platens)), (1.0 - nu * nu) / E
    face = None if takes is None else Face(onset=full["onset_pressure"], hardness=full["hardness"],
                                           pile_up=full["pile_up"], modulus=modulus,
                                           effective_radius=radius)  # fmt: skip
    state = at_force(force, {
        **{f"sphere.{key}": value for key, value in full.items()}, "sphere.radius": radius, "modulus": modulus,
        "effective_radius": radius, "mass": mass, "hertz_constant": contact.hertz_constant(modulus, radius),
        "loading_rate": np.zeros(radius.shape) if rate is None else rate, "face": face,
        "takes": 0.0 if takes is None else takes,
    })  # fmt: skip
    # the sphere's share of what both contacts store, here and between the partners of the study's own rig
    elastic = modulus * compliance * state["energy"]
    own = elastic + (0.0 if takes is None else takes) * state["dissipated"]
    both = elastic * (1.0 + full["partner"] / compliance) if "partner" in full else state["energy"]
    state = type(state)({**state, "energy_sphere": own, "specific_energy_sphere": own / mass, "energy": both,
                         "specific_energy": both / mass, "specific_impact_energy": state["energy"] / mass})  # fmt: skip
    if demand.criterion is not None:
        return demand_of(CRITERIA[demand.criterion], state, demand.parameters)
    return np.asarray(state[demand.quantity], dtype=float)


def equivalent_force(
    limit: Limit | Demand, value: Values, sphere: Mapping[str, Values], radius: Values, platens: tuple[float, float]
) -> Array:
    """The force [N] that gives a criterion's value on the row's own sphere, pressed slowly between platens.

    Every criterion rises with the force, nearly as a power of it: the secant in logarithms ends after some steps.  It
    is exact for Hertz: p_max = (6 P E*²/(pi³ r²))^(1/3) gives P = pi³ p_max³ r²/(6 E*²).

    Parameters
    ----------
    limit : its quantity, or criterion with parameters.
    value : (n,) of that criterion in the row, SI.
    sphere : E [Pa], nu, density [kg/m³], (n,) each or numbers; where its poles yield onset_pressure, hardness [Pa],
        pile_up and takes, 1 if the sphere itself yields; partner: (1 - nu²)/E [1/Pa] of what is on the other side in
        the row's own rig, where the energy of both is what is limited.
    radius : of the row's sphere [m], (n,).
    platens : E [Pa], infinite if rigid, and nu of the platens of the tests.

    Returns
    -------
    (n,) forces; 0 for a value of 0, infinite for one that no force reaches (a pressure above the hardness).
    """
    demand = limit if isinstance(limit, Demand) else Demand(
        quantity=limit.quantity, criterion=limit.criterion,
        parameters={k: v for k, v in limit.parameters.items() if k != "rate_0"})  # fmt: skip
    value, radius = np.broadcast_arrays(*(np.atleast_1d(np.asarray(v, dtype=float)) for v in (value, radius)))
    wanted = np.log(np.where(value > 0.0, value, 1.0))

    def logarithm(log_force: Array) -> Array:
        with np.errstate(all="ignore"):
            return np.asarray(np.log(reached(demand, np.exp(log_force), sphere, radius, platens)))

    x = np.log(1e7 * np.square(radius))
    y, slope = logarithm(x), np.full(radius.shape, 0.7)
    for _ in range(60):
        step = np.clip((wanted - y) / slope, -6.0, 6.0)
        if not (np.abs(step) > 1e-13 * np.maximum(np.abs(x), 1.0)).any():
            break
        after = logarithm(x + step)
        with np.errstate(all="ignore"):
            secant = (after - y) / step
        slope = np.where((secant > 0.02) & (np.abs(step) > 1e-9), secant, slope)
        x, y = x + step, after
    found = np.where(np.abs(wanted - y) < 1e-6, np.exp(x), np.inf)
    return np.where(value > 0.0, found, 0.0)


def test_force(limit: Limit, value: Values, sphere: Mapping[str, Values], radius: Values) -> Array:
    """The force [N] in the limit's tests that is worth a row's value: what `limit.tested.law` is held against.

    The equivalent force on the row's own sphere, times (D_tests/D)^a with the exponent a of `Tested`; of the draws of a
    lab the value itself, in the size that they hold for.  Parameters and result as of `equivalent_force`.
    """
    tested = limit.tested
    assert tested is not None
    if tested.law is not None:
        value = equivalent_force(limit, value, {**tested.sphere, **sphere}, radius, tested.platens)
    return np.asarray(value * (tested.diameter / (2.0 * np.asarray(radius, dtype=float))) ** tested.exponent)


test_force.__test__ = False  # type: ignore[attr-defined]


# --- files ---------------------------------------------------------------------------------------------------------


def inside_folder(name: str, reader: Reader, key: str) -> Path:
    """The file as a real path, links followed; raises Fault at `key` unless it lies in the study's folder."""
    posix = PurePosixPath(name.replace("\\", "/"))
    if not name or len(name) > 255 or "\0" in name or ":" in name or posix.is_absolute() or ".." in posix.parts:
        raise Fault(f"found {shown(name)}: a study reads files of its own folder only, by a relative path", key)
    if any(is_device_name(part) for part in posix.parts):
        raise Fault(f"found {shown(name)}: some system takes that for a device; rename the file", key)
    try:
        home = reader.folder.resolve()
        path = (home / name).resolve()
        there, beside = path.exists(), [item.name for item in home.iterdir()] if home.is_dir() else []
    except (OSError, RuntimeError, ValueError):
        raise Fault(f"found {shown(name)}, which cannot be read", key) from None
    if not path.is_relative_to(home):
        raise Fault(f"{shown(name)} is a link that leaves the study's folder", key)
    if not there:
        raise Fault(f"there is no file {shown(name)} beside the study{suggestion(name, beside)}", key)
    reader.files[posix.as_posix()] = path
    return path


def open_table(name: str, reader: Reader, key: str, decimal: str | None = None) -> Table:
    """The table of a file of the study; raises Fault at `key`."""
    path = inside_folder(name, reader, key)
    try:
        return read_table(path, decimal=decimal or "")
    except TableError as error:
        raise Fault(str(error), key) from None
    except (AccessError, UsageError):
        raise Fault(f"{shown(name)} cannot be read as a file", key) from None


def platens_of(raw: Any, bars: tuple[float, float] | None, *at: str) -> tuple[float, float]:
    """E [Pa], infinite if rigid, and nu of what a strength was measured between; raises Fault."""
    known = {name: (material.properties["E"].value, material.properties["nu"].value)
             for name, material in library()["bars"].items()}  # fmt: skip
    choices = {"bars": bars, "rigid": (math.inf, 0.3), **known}
    if isinstance(raw, Mapping):
        if set(raw) != {"E", "nu"}:
            raise Fault(f"a table of platens has E and nu, found {one_of(raw) if raw else 'nothing'}", *at)
        return value_of(raw["E"], INPUTS["bars.E"]), value_of(raw["nu"], INPUTS["bars.nu"])
    if not isinstance(raw, str) or raw not in choices:
        raise Fault(f"found {shown(raw)}, allowed: {one_of(choices)}{suggestion(raw, known)}", *at)
    if (found := choices[raw]) is None:
        said = 'there are no bars here: write what it was measured between, platens = "rigid" or a material'
        raise Fault(said, *at)
    return found


# --- distributions from a file -------------------------------------------------------------------------------------


def _declared(raw: Mapping[str, Any]) -> Observations:
    """The keys of a distribution from a file; raises Fault for the first that is none."""
    try:
        return Observations.model_validate(dict(raw))
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        raise Fault(fault_text(fault, fault["loc"], Observations)[0], str(fault["loc"][0])) from None


def is_tests(raw: Any) -> bool:
    """Whether a strength is written as forces at which spheres broke."""
    return isinstance(raw, Mapping) and ("force" in raw or "diameter" in raw) and not {"column", "draws"} & set(raw)


def observed_law(raw: Mapping[str, Any], quantity: Quantity, reader: Reader, place: Place) -> Number:
    """The distribution of a column, or of draws; raises Fault."""
    table = _declared(raw)
    if table.draws is not None:
        return _drawn(table, quantity, reader)
    if is_tests(raw):
        raise Fault("forces at failure belong to the strength of a limit of the impact model", "force")
    if table.file is None or table.column is None:
        missing = "file" if table.file is None else "column"
        raise Fault(f'{missing} is missing: add {missing} = "{"tests.csv" if missing == "file" else "strength"}"')
    found = open_table(table.file, reader, "file", table.decimal)
    with _faults(found):
        data = found.numbers(table.column, quantity.dimension, table.unit, key="column")
        stopped, many = _flags_and_counts(found, table)
    bounds = [None if end is None else value_of(end, quantity, bounded=False) for end in (table.lower, table.upper)]
    _warn(found, data, stopped, many, reader, place)
    law = _fitted(np.repeat(data, many), np.repeat(stopped, many), table, table.fit, *bounds)
    return Number(value=law, synthetic=table.synthetic)


def _drawn(table: Observations, quantity: Quantity, reader: Reader) -> Number:
    """The mean of the distributions that a fit allows, each a draw of its parameters."""
    from uqsphere.uq.observed import LOGNORMAL, WEIBULL

    assert table.draws is not None
    found = open_table(table.draws, reader, "draws", table.decimal)
    kinds = {"lognormal": LOGNORMAL, "weibull": WEIBULL}
    heads = [heading.split(" ")[0] for heading in found.headings]

    def numbers(name: str, dimension: str = "number", unit: str | None = None) -> Array:
        needed = name in heads or name in ("scale", "shape")
        return found.numbers(name, dimension, unit, key="draws") if needed else np.zeros(len(found))

    with _faults(found, "draws"):
        words = found.texts("distribution", "draws")
        found.refuse("draws", f"distribution: {one_of(kinds)} is required", np.array([w not in kinds for w in words]))
        scale, least = (numbers(name, quantity.dimension, table.unit) for name in ("scale", "least"))
        shape, bound, tests, exponent = (numbers(name) for name in ("shape", "bound", "tests", "size_exponent"))
        size = numbers("diameter", "length")
        wrong = ~((scale > 0.0) & (shape > 0.0) & (least >= 0.0) & (bound >= 0.0) & (bound < 1.0))
        found.refuse("draws", "scale and shape above 0, least from 0, bound from 0 to below 1 are required", wrong)
    kind = np.array([kinds[word] for word in words])
    law = law_of_draws(np.column_stack([kind, least, scale, shape, bound]).tolist(), int(tests[0]))
    tested = Tested(diameter=float(size[0]), exponent=float(exponent.mean()), size="none") if size[0] > 0.0 else None
    return Number(value=law, synthetic=table.synthetic, tested=tested)


@contextmanager
def _faults(table: Table, key: str = "file") -> Iterator[None]:
    """Turns the faults of a table into one Fault, all that were noted inside together."""
    try:
        yield
        table.finish()
    except TableError as fault:
        raise Fault(str(fault), key if key == "draws" else fault.key or key) from None


def _flags_and_counts(found: Table, table: Observations) -> tuple[Flags, Any]:
    """Which rows are tests that were stopped, and how many equal tests each row stands for."""
    n = len(found)
    stopped = np.zeros(n, dtype=bool)
    if table.censored is not None:
        stopped = found.flags(table.censored, "censored", meant="0 or 1 (1: stopped)")
    many = np.ones(n) if table.count is None else found.numbers(table.count, key="count")
    found.refuse("count", "counts are whole numbers from 1 on", (many < 1.0) | (many % 1.0 != 0.0))
    found.refuse("count", "more than two million tests", np.cumsum(many) > 2e6)
    return stopped, np.where(np.isfinite(many), many, 1.0).clip(1.0, 2e6).astype(int)


def _fitted(data: Array, stopped: Flags, table: Observations, fit: str | None, lower: float | None = None,
            upper: float | None = None, *, slope: float = 1.0) -> Law:  # fmt: skip
    """The law of some observations; raises Fault.  `slope`: they are forces to this power, which have the modulus."""
    modulus = None if table.modulus is None else table.modulus / slope
    if modulus is None and (len(data) < 2 or stopped.all()):
        said = f"all {len(data)} tests were stopped" if len(data) > 1 else f"found {len(data)} observation"
        raise Fault(f"{said}: two failures or more are required, or a known Weibull modulus: modulus = …", "file")
    try:
        return fitted_law(data[~stopped].tolist(), fit, lower, upper, censored=data[stopped].tolist(),
                          unbiased=table.unbiased, modulus=modulus)  # fmt: skip
    except LawError as error:
        raise Fault(error.message, error.key if error.key in ("fit", "lower", "upper") else "file") from None


def modulus_of(law: object) -> float | None:
    """The Weibull modulus of a strength, fitted or known beforehand; None where it has none."""
    if not isinstance(law, Law):
        return None
    drawn = {(draw[0], draw[3]) for draw in law.draws} if law.family.name == "draws" else ()
    return next(iter(drawn))[1] if len(drawn) == 1 and law.draws[0][0] else law.parameters.get("modulus")


# --- strengths from crushing tests ---------------------------------------------------------------------------------


def tested_strength(
    raw: Mapping[str, Any], demand: Demand, sphere: Mapping[str, float], radii: tuple[float, ...],
    bars: tuple[float, float] | None, face: Callable[[tuple[float, float]], dict[str, float]], reader: Reader,
    place: Place, *, quick: bool,
) -> Number:  # fmt: skip
    """The law of the strength against a demand from forces at failure, and the tests themselves; raises Fault.

    sphere: E, nu, density and partner at their means (see `equivalent_force`); radii: its mean [m] and the ends of its
    scatter; bars: E and nu of the study's bars; face: what yields between platens, by their E and nu; quick: whether
    the study's rig is a blow.
    """
    table = _declared(raw)
    for key, example in (("file", "tests.csv"), ("force", "F"), ("diameter", "D")):
        if getattr(table, key) is None:
            raise Fault(f'{key} is missing: add {key} = "{example}"')
    assert table.file is not None
    assert table.force is not None
    assert table.diameter is not None
    if demand.criterion is None and not follows_force(demand.quantity):
        raise Fault(f"a force at failure is no measure of {demand.quantity}: name a criterion", "force")
    platens = platens_of(table.platens, bars, "platens")
    sphere = {**sphere, **face(platens)}
    found = open_table(table.file, reader, "file", table.decimal)
    with _faults(found):
        force = found.numbers(table.force, "force", table.force_unit, key="force")
        if table.diameter[:1].isdigit():
            diameter = np.full(len(force), value_of(table.diameter, INPUTS["bars.diameter"]))
        else:
            diameter = found.numbers(table.diameter, "length", table.diameter_unit, key="diameter")
        rate = None if table.rate is None else found.numbers(table.rate, "loading_rate", key="rate")
        stopped, many = _flags_and_counts(found, table)
        for key, column in (("force", force), ("diameter", diameter)):
            found.refuse(key, f"the {key} must be above 0", column <= 0.0)
    fit = table.fit or "weibull"
    _warn(found, force, stopped, many, reader, place)
    _warn_of_tests(table, force, diameter, radii[0], reader, place)
    force, diameter, stopped = (np.repeat(column, many) for column in (force, diameter, stopped))
    rate = None if rate is None else np.repeat(rate, many)
    knows = demand.criterion is not None and "modulus" in CRITERIA[demand.criterion].parameters
    g = {"ring_crack_toughness": 1.0, "energy": 0.2, "energy_sphere": 0.2, "P_max": 0.0}.get(demand.base, 2.0)
    links = 3.0 if demand.place in ("core", "") or demand.base.endswith("energy") else 2.0
    mean = float(diameter.mean())

    def of_force(exponent: float) -> tuple[Law, float]:
        law = _fitted(force * (mean / diameter) ** exponent, stopped, table, fit)
        return law, g - links / (modulus_of(law) or math.inf) if g else g

    law, exponent = _agreeing(of_force, g)
    tested = Tested(
        diameter=mean, forces=tuple(force.tolist()), diameters=tuple(diameter.tolist()),
        suspended=tuple(stopped.tolist()), platens=platens, sphere=dict(sphere),
        law=law, exponent=exponent, size="weakest link" if modulus_of(law) and g else "none",
    )  # fmt: skip
    compare_sizes(tested, radii, reader, (*place, "diameter"), knows)
    if quick and "rate_0" not in demand.parameters:
        reader.warn(place, "slow tests, quick rig: struck rocks bore 1.24 to 2.12 times as much; that is conservative "
                    "for survive, not for break; rate_0 of the criterion accounts for it (110 to 760 1/s)")  # fmt: skip

    def value(modulus: float, factor: float = 1.0) -> Array:
        own = replace(demand, parameters={"modulus": modulus, **demand.parameters}) if knows else demand
        return reached(own, factor * force, sphere, 0.5 * diameter, platens, rate)

    slopes = np.log(value(8.0, 1.01) / value(8.0)) / math.log(1.01)
    if not np.isfinite(value(8.0)).all():
        raise Fault(f"some tests lie beyond what {demand.quantity} can reach: raise largest_energy, or the hardness")
    if not (slopes > _RISES).all():
        raise Fault(f"{demand.quantity} hardly rises with the force of such tests, so that no force tells its "
                    "strength: take another criterion")  # fmt: skip
    if fit != "weibull" and knows and "modulus" not in demand.parameters:
        raise Fault('the strength of a weakest link is a Weibull distribution: write fit = "weibull"', "fit")

    def of_value(modulus: float) -> tuple[Law, float]:
        law = _fitted(value(modulus), stopped, table, fit, slope=float(np.median(slopes)))
        return law, (modulus_of(law) or modulus) if knows else modulus

    law, _ = _agreeing(of_value, 8.0)
    return Number(value=law, synthetic=table.synthetic, tested=tested)


def _agreeing(fitted: Callable[[float], tuple[Law, float]], number: float) -> tuple[Law, float]:
    """A law that needs a number, and the number that it gives: of the size law, of a weakest link; raises Fault."""
    for _ in range(60):
        try:
            law, after = fitted(number)
        except Fault:
            raise
        except ValueError as error:
            raise Fault(f"the tests cannot be turned into a strength: {error}", "file") from None
        if abs(after - number) < 1e-10 * max(abs(number), 1.0):
            return law, after
        number = after
    raise Fault("no modulus agrees with itself: give it by the key modulus")


def compare_sizes(tested: Tested, radii: tuple[float, ...], reader: Reader, place: Place, knows: bool = False) -> None:
    """Warn of tests of another diameter than the sphere's, of its first radius [m].

    Raises Fault where no size law carries them to one of the radii; `knows`: the criterion itself has such a law.
    """
    carried = knows or tested.size == "weakest link"
    ratios = [max(tested.diameter / (2.0 * radius), 2.0 * radius / tested.diameter) for radius in radii]
    far = max(ratios)
    radius = radii[ratios.index(far) if far > SIZES_REFUSED and not carried else 0]
    sizes = f"the tests have a mean diameter of {1e3 * tested.diameter:.4g} mm, the sphere of {2e3 * radius:.4g} mm"
    if far > SIZES_REFUSED and not carried:
        way = 'or take fit = "weibull"' if tested.law is not None else "or fit anew with this size as strength_at"
        raise Fault(f"{sizes}, and no size law over more than 50 %: test spheres of this size, {way}", str(place[-1]))
    if ratios[0] > SIZES_TOLD:
        by = "the weakest link" if carried else "its size_exponent" if not tested.law and tested.exponent else "nothing"
        reader.warn(place, f"{sizes}: {by} carries the strength")


# --- whether the numbers of a file are plausible -------------------------------------------------------------------


def usual_strength(demand: Demand, dimension: str) -> tuple[float, float]:
    """Usual range of a strength (SI): contacts bear more than tensions."""
    contact_bears = demand.base in ("p_max", "p_hertz", "first_peak")
    return _CONTACT if contact_bears else USUAL.get(dimension, (0.0, math.inf))


def _warn(found: Table, data: Array, stopped: Flags, many: Any, reader: Reader, place: Place) -> None:
    """Warn of what the file itself and its scatter say: notes of the reader, few tests, rows apart, an unlikely fit."""
    said = [*found.notes, *(f"{found.name}: {odd}" for odd in unusual_rows(data, stopped, many, found.lines))]
    if many.sum() < _FEW:
        said.append(f"{many.sum()} observations: what so few leave open is large; {_FEW} or more are a start")
    for text in said:
        reader.warn((*place, "file"), text)


def unusual_rows(data: Array, stopped: Flags, many: Array, lines: list[int]) -> Iterator[str]:
    """What is odd about observations (n,): rows far from the rest of the logarithms, a shape that no fit has."""
    x = np.log(np.where(data > 0.0, data, 1.0))
    if (~stopped & (data > 0.0)).sum() < 6:
        return
    middle = np.median(x[~stopped])
    deviation = 1.4826 * np.median(np.abs(x[~stopped] - middle))
    # a Weibull law's lower tail is exponential in the logarithm: of n rows the lowest lies some ln n away
    apart = np.flatnonzero(~stopped & (np.abs(x - middle) > max(_APART, math.log(len(x))) * deviation))
    if deviation > 0.0 and 0 < len(apart) <= max(1, len(data) // 10):
        rows = ", ".join(f"line {lines[k]} ({math.exp(x[k] - middle):.3g} times the median)" for k in apart[:5])
        yield f"{rows}: far from the other rows; a slip of the decimal point?"
    try:
        tests = make_tests(data, stopped, many)
    except ValueError:
        return
    p = max(probability_of(tests, law) for law in STRENGTHS.values())
    if p < _UNLIKELY:
        yield f"neither a Weibull nor a lognormal distribution fits (p = {p:.2g}): mixed or faulty rows?"


def _warn_of_tests(
    table: Observations, force: Array, diameter: Array, radius: float, reader: Reader, place: Place
) -> None:
    """Warn of forces and diameters that no sphere has, with the unit that would make them usual."""
    off = diameter / (2.0 * radius)
    far = (off > 3.0) | (off < 1.0 / 3.0)
    if far.any():
        k, ratio = int(np.argmax(far)), float(np.median(off)) / UNITS["length"].get(table.diameter_unit or "", math.inf)
        likely = [unit for unit in ("um", "mm", "cm", "m") if 0.5 < ratio * UNITS["length"][unit] < 2.0]
        reader.warn((*place, "diameter"), f"{table.file}: {far.sum()} of {len(off)} diameters are more than three "
                    f"times off the sphere's, the first {1e3 * diameter[k]:.4g} mm"
                    + (f": is the unit {one_of(likely)}?" if likely else ""))  # fmt: skip
    typical = float(np.median(0.9 * force / np.square(diameter)))
    if not _TENSION[0] <= typical <= _TENSION[1]:
        given = UNITS["force"].get(table.force_unit or "", 1.0)
        likely = [u for u in ("N", "kN", "MN") if u != table.force_unit and not far.all()
                  and _TENSION[0] <= typical * UNITS["force"][u] / given <= _TENSION[1]]  # fmt: skip
        hint = f": is the unit {one_of(likely)}?" if likely and table.force_unit else ": are the units right?"
        value = f"{typical / 1e9:.3g} GPa" if typical > 1e9 else f"{typical / 1e6:.3g} MPa"
        reader.warn((*place, "force"), f"0.9 P/D² of {table.file} is {value}, usual are "
                    f"{_TENSION[0] / 1e6:g} to {_TENSION[1] / 1e6:g} MPa{hint}")  # fmt: skip
