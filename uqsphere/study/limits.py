"""The limits of a study: what is held against which strength, by a quantity or by a criterion of fracture."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from uqsphere.materials import library
from uqsphere.mechanics.criteria import CRITERIA, PARAMETERS, Criterion
from uqsphere.mechanics.outputs import PATHS, follows_force
from uqsphere.quantities import OUTPUTS, lookup
from uqsphere.study.contact import compared_pressure
from uqsphere.study.document import ContactTable, LimitTable
from uqsphere.study.faults import Findings, Place, Raw, one_of, shown, unknown
from uqsphere.study.numbers import Reading, is_fit, read_fit_strength, read_number
from uqsphere.study.particle_tables import ENERGY_OF
from uqsphere.study.scene import Scene, read_platens, worded
from uqsphere.study.sphere_tests import Demand, is_sphere_tests, read_sphere_tests
from uqsphere.study.study import Limit
from uqsphere.units import Quantity
from uqsphere.uq import Law

MOST_LIMITS: Final = 50
#: pressures [Pa] that a strength is likely to be
_STRONG: Final = (1e4, 1e12)
_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_-]{0,63}")
_FACTOR: Final = Quantity(
    name="model_factor", symbol="f", dimension="number", meaning="the model factor", plausible=(0.5, 2.0)
)


@dataclass(frozen=True, kw_only=True)
class LimitReading:
    """A limit with its parts as understood; None where a part is faulty."""

    name: str
    table: LimitTable
    demand: Demand | None = None
    strength: Reading | None = None
    model_factor: Reading | None = None
    platens: tuple[float, float] | None = None

    @property
    def quantity(self) -> str | None:
        """The quantity that is held against the strength."""
        return None if self.demand is None else self.demand.quantity

    @property
    def parts(self) -> dict[str, Reading | None]:
        """The numbers that can be random, by the names they go by."""
        return {
            f"limits.{self.name}.strength": self.strength,
            f"limits.{self.name}.model_factor": self.model_factor,
        }

    def limit(self) -> Limit | None:
        """The noun, if every part is there."""
        if self.demand is None or self.strength is None or self.model_factor is None:
            return None
        return Limit(
            name=self.name,
            criterion=self.demand.criterion,
            parameters=self.demand.parameters,
            quantity=self.demand.quantity,
            strength=self.strength.value,
            aim=self.table.aim,
            model_factor=self.model_factor.value,
            target=self.table.target,
            fracture=self.table.fracture,
            platens=self.platens,
            tested=self.strength.tested,
        )


def valid_name(name: str) -> bool:
    """Whether a name of the user's can stand in tables, figures and file names."""
    return _NAME.fullmatch(name) is not None


def valid_names(names: Iterable[str], section: str, findings: Findings) -> list[str]:
    """Those of the names of a user's tables that are valid; the others are noted."""
    valid = []
    for name in names:
        if valid_name(name):
            valid.append(name)
        else:
            said = "a name takes up to 64 letters, digits, _ and -, and begins with a letter"
            findings.add((section, name), said)
    return valid


def read_limits(
    tables: Mapping[str, LimitTable], outputs: Sequence[str] | None, findings: Findings, scene: Scene
) -> list[LimitReading]:
    """The limits; `outputs` are the names of a black box (None: those of the impact model)."""
    if len(tables) > MOST_LIMITS:
        findings.add(("limits",), f"found {len(tables)} limits, at most {MOST_LIMITS} are allowed")
        return []
    names = valid_names(tables, "limits", findings)
    return [_read_limit(name, tables[name], outputs, scene, findings) for name in names]


def _read_limit(
    name: str, table: LimitTable, outputs: Sequence[str] | None, scene: Scene, findings: Findings
) -> LimitReading:
    """A limit with its parts as far as they can be understood."""
    place: Place = ("limits", name)
    demand = _demand(table, name, outputs, scene, findings)
    strength = None
    if table.strength is not None and demand is None:
        # without its quantity the strength has no unit to be read in: neither right nor wrong
        findings.spoiled.add((*place, "strength"))
    elif table.strength is not None and demand is not None:
        strength = _read_strength(table.strength, (*place, "strength"), demand, outputs is not None, scene, findings)
    if demand is not None and outputs is None:
        demand = replace(demand, quantity=compared_pressure(demand.quantity, table, name, scene, findings))
    if demand is not None:
        demand = _with_modulus_of(strength, demand, name, findings)
    factor = None
    if table.model_factor is not None:
        factor = read_number(table.model_factor, (*place, "model_factor"), _FACTOR, findings)
    elif findings.clean((*place, "model_factor")):
        factor = Reading(value=1.0)
    if table.fracture and demand is not None and table.criterion is None and demand.quantity not in PATHS:
        due = f"fracture = true is for a criterion or one of {one_of(sorted(PATHS))}"
        findings.add((*place, "fracture"), f"exceeding {demand.quantity} breaks no sphere: {due}")
    platens = _platens_of(table, demand, place, scene, findings)
    return LimitReading(name=name, table=table, demand=demand, strength=strength, model_factor=factor, platens=platens)


def _platens_of(
    table: LimitTable, demand: Demand | None, place: Place, scene: Scene, findings: Findings
) -> tuple[float, float] | None:
    """What a strength was measured between, where it is carried to a rig that is not its test."""
    base = "" if demand is None else demand.criterion or demand.quantity
    carried = base and (CRITERIA[base].follows != "" if base in CRITERIA else follows_force(base))
    if not carried or scene.options.get("rig.kind", "bars") in ("bars", "none"):
        return None
    raw, at = table.platens, (*place, "platens")
    if is_sphere_tests(table.strength):
        raw, at = table.strength.get("platens", "bars"), (*place, "strength", "platens")
    return None if raw is None or not findings.clean(at) else read_platens(raw, at, scene, findings)


def say_platens(limit: dict[str, Raw], bars: Mapping[str, Raw]) -> None:
    """Say what a strength was measured between, which the file leaves to the bars that it has."""
    strength = limit.get("strength")
    if is_sphere_tests(strength):
        assert isinstance(strength, Mapping)
        if strength.get("platens", "bars") == "bars" and bars:
            limit["strength"] = {**strength, "platens": _as_platens(bars)}
    elif limit.get("platens", "bars") == "bars":
        limit["platens"] = _as_platens(bars) if bars else limit.get("platens", "rigid")


def _as_platens(bars: Mapping[str, Raw]) -> Raw:
    """The bars of a study as platens: their material, or E and nu at their means."""
    material = bars.get("material")
    if isinstance(material, str) and "E" not in bars and "nu" not in bars:
        return material
    known = library()["bars"].get(str(material))
    found: dict[str, Raw] = {}
    for key, unit in (("E", " Pa"), ("nu", "")):
        raw = bars.get(key)
        if raw is None and known is not None:
            value = known.properties[key].value
            raw = f"{value!r}{unit}" if unit else value
        found[key] = raw.get("mean") if isinstance(raw, Mapping) else raw
    return {key: value for key, value in found.items() if value is not None}


def _read_strength(
    raw: Raw, place: Place, demand: Demand, black_box: bool, scene: Scene, findings: Findings
) -> Reading | None:
    """A strength: a number or law in the unit of the demand, or what tests or a fit tell of it."""
    if not black_box and is_sphere_tests(raw):
        return read_sphere_tests(raw, place, demand, scene, findings)
    if not black_box and is_fit(raw):
        return read_fit_strength(raw, place, demand.quantity, scene.mean("sphere.radius"), findings)
    entry = lookup(demand.quantity)
    plausible = _STRONG if entry.dimension == "pressure" else (0.0, math.inf)
    due = replace(entry, meaning=f"the strength against {demand.quantity}", plausible=plausible, closed=False)
    return read_number(raw, place, due, findings)


def known_quantity(name: str, place: Place, outputs: Sequence[str] | None, findings: Findings) -> bool:
    """Whether the model answers a quantity; noted where it does not."""
    known = list(OUTPUTS) if outputs is None else list(outputs)
    if name not in known and known:
        findings.add(place, unknown("quantity", name, known, 40))
    return name in known


# --- what is held against the strength --------------------------------------------------------------------


def _demand(
    table: LimitTable, name: str, outputs: Sequence[str] | None, scene: Scene, findings: Findings
) -> Demand | None:
    """The demand of a limit by its quantity or criterion; None, with the faults noted, where it has none."""
    place: Place = ("limits", name)
    key, black_box = table.criterion, outputs is not None
    if key is None:
        for part in PARAMETERS:
            if getattr(table, part) is not None:
                due = "add criterion = … (uqsphere list criteria)"
                findings.add((*place, part), f"{part} belongs to a criterion: {due}")
        if table.quantity is None:
            if findings.clean((*place, "quantity")):
                due = f'add quantity = "{(outputs or ["p_max"])[0]}"'
                findings.add((*place, "quantity"), f"quantity is missing: {due}")
            return None
        known = known_quantity(table.quantity, (*place, "quantity"), outputs, findings)
        return Demand(quantity=table.quantity) if known else None
    if black_box:
        findings.add((*place, "criterion"), "a criterion belongs to the impact model: name a quantity instead")
    elif key not in CRITERIA:
        findings.add((*place, "criterion"), unknown("criterion", key, CRITERIA))
    elif table.quantity is not None:
        findings.add((*place, "quantity"), "quantity and criterion both say what is compared: leave one of them out")
    else:
        key = _energy_meant(key, table, place, scene, findings)
        entry = CRITERIA[key]
        parameters = _parameters(table, entry, place, findings)
        if parameters is not None and not parameters and entry.quantity is not None:
            return Demand(quantity=entry.quantity)
        if parameters is not None:
            return Demand(quantity=f"{key}.{name}", criterion=key, parameters=parameters)
    return None


def _energy_meant(key: str, table: LimitTable, place: Place, scene: Scene, findings: Findings) -> str:
    """The criterion with the energy that the strength means, which another rig than bars leaves open."""
    meant = table.energy_is
    if key not in ENERGY_OF.values() and meant is not None:
        findings.add((*place, "energy_is"), "energy_is belongs to the criterion specific_energy: leave it out")
    if key != ENERGY_OF["contact"]:
        return key
    if meant is None and scene.options.get("rig.kind", "bars") != "bars":
        findings.lack((*place, "energy_is"), f"energy_is is missing: say what the strength means, {one_of(ENERGY_OF)}")
    return ENERGY_OF[meant or "contact"]


def _parameters(table: LimitTable, entry: Criterion, place: Place, findings: Findings) -> dict[str, float] | None:
    takes = (*entry.parameters, *entry.optional)
    found: dict[str, float] = {}
    clean = True
    for key, part in PARAMETERS.items():
        value = getattr(table, key)
        if value is None:
            clean &= findings.clean((*place, key))
            # the modulus may stand in the strength, which is read later
            if key in entry.parameters and key != "modulus":
                findings.lack((*place, key), f"{key} is missing: the criterion {entry.name} needs the {part.meaning}")
                clean = False
        elif key not in takes:
            allowed = one_of(takes) if takes else "none"
            findings.add((*place, key), f"the criterion {entry.name} takes no {key} (it takes: {allowed})")
            clean = False
        else:
            found[key] = value
    return found if clean else None


def _with_modulus_of(strength: Reading | None, demand: Demand, name: str, findings: Findings) -> Demand | None:
    """The demand with the Weibull modulus of its strength, where it needs one; they must not contradict."""
    if demand.criterion is None or "modulus" not in CRITERIA[demand.criterion].parameters:
        return demand
    law = strength.value if strength is not None else None
    own = law.parameters.get("modulus") if isinstance(law, Law) else None
    given = demand.parameters.get("modulus")
    place: Place = ("limits", name, "modulus")
    if own is not None and given is not None and abs(own - given) > 1e-9 * given:
        findings.add(place, f"found {given:g}, but the strength has the modulus {own:g}: leave modulus out")
        return None
    modulus = given if own is None else own
    if modulus is None:
        if strength is not None:
            findings.lack(place, "modulus is missing: give it here or by a strength that is a Weibull law")
        return None
    if own is None and strength is not None:
        said = "the strength of a weakest link is a Weibull law of its modulus; with another the probability is not"
        findings.warn(("limits", name), f"{said} that of the flaws")
    return replace(demand, parameters={"modulus": float(modulus), **demand.parameters})


def share_fracture_energy(
    table: ContactTable | None, limits: Sequence[LimitReading], scene: Scene, findings: Findings
) -> None:
    """Put the strength of a limit in place of ``{ same_as = "limits.NAME.strength" }``."""
    raw: Raw = table and table.fracture_energy
    if not worded("contact", "fracture_energy", raw) or scene.options.get("contact.law") != "damage":
        return
    place = ("contact", "fracture_energy", "same_as")
    named = {f"limits.{limit.name}.strength": limit for limit in limits}
    limit = named.get(raw["same_as"]) if isinstance(raw["same_as"], str) else None
    if limit is None:
        findings.add(place, f"found {shown(raw['same_as'])}: the strength of a limit is due, limits.NAME.strength")
    elif limit.quantity not in ("specific_energy", "energy_sphere", "specific_energy_sphere"):
        findings.add(place, f"limits.{limit.name} is no limit on a specific energy")
    elif limit.strength is not None and isinstance(limit.strength.value, Law):
        said = "its strength scatters and is averaged over, not drawn, so that no row could share it"
        findings.add(place, f"limits.{limit.name}: {said}; give fracture_energy a law of its own")
    elif limit.strength is not None:
        scene.readings["contact.fracture_energy"] = Reading(value=limit.strength.value)
