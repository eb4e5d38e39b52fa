"""Services: machines that a study asks of, each made into a study file of its own.

The file of a service has the sphere, the analysis and the seed of the study, the service as its rig, and the limits
that are asked of it.  It is read as every study is, and what is wrong with it is said where it stands in the file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Final

from uqsphere.materials import library
from uqsphere.study.document import RIG_TABLES, RigTable
from uqsphere.study.faults import Findings, Place, Raw, one_of, shown, suggestion
from uqsphere.study.limits import valid_names
from uqsphere.study.particle_tables import ENERGY_OF
from uqsphere.study.sphere_tests import is_sphere_tests
from uqsphere.study.tables import declared
from uqsphere.study.text import toml_text

#: tables that every service has as the study has them, and their keys that speak of the study's own rig
_SHARED: Final = ("seed", "sphere", "product", "contact", "model", "analysis")
_OWN_RIG: Final = {"model": ("first_loading_only", "compare_with_paper", "horizon")}
#: tables that can stand in a service, and what it asks of the free scalar
_NESTED: Final = tuple(
    dict.fromkeys(table for name, tables in RIG_TABLES.items() if name != "bars" for table in tables)
)
_ASKED: Final = ("solve", "between")
#: keys of [margins] that hold for every service that is solved
_FOR_ALL: Final = ("for_probability", "for_survival", "for_fracture")
_BEGINNING: Final = "service."
_SAME: Final = "same_as"


@dataclass(frozen=True, kw_only=True)
class Service:
    """The study file of a service as plain values; `dependences` are the places of its dependences in the file."""

    name: str
    data: dict[str, Raw]
    dependences: tuple[int, ...] = ()
    solved_here: bool = True

    def home(self, place: Place) -> Place:
        """Where something of the service stands in the file.

        >>> Service(name="chute", data={}).home(("rig", "speed"))
        ('service', 'chute', 'speed')
        """
        if not place or place[0] in (*_SHARED, "limits"):
            return place
        here: Place = ("service", self.name)
        if place[0] == "rig":
            return (*here, *place[1:])
        if place[0] == "dependence" and len(place) > 1:
            return ("dependence", self.dependences[int(place[1])], *place[2:])
        if place[0] == "margins":
            if not self.solved_here or (place[1:2] and place[1] in _FOR_ALL):
                return place
            return (*here, *(place[1:] or ("solve",)))
        return (*here, *place)

    def report(self, found: Findings, findings: Findings) -> None:
        """Note what was found in the service at its place in the file, but for what lacks where a fault is known."""
        for place, message in found.faults:
            if (home := self.home(place)) not in findings.spoiled:
                findings.add(home, message)

    @property
    def text(self) -> str:
        """The study file."""
        return toml_text(self.data)


def split(data: Mapping[str, Raw], findings: Findings) -> tuple[dict[str, Raw], list[Service]]:
    """The study of the rig itself, and those of its services."""
    tables = {name: table for name, table in _table(data, "service").items() if isinstance(table, Mapping)}
    valid_names(tables, "service", findings)
    own = _without_references(data, findings)
    limits = _table(own, "limits")
    homes = {name: _home_of(name, table, tables, findings) for name, table in limits.items()}
    made = [_service(name, table, own, homes) for name, table in tables.items()]
    if isinstance(own.get("limits"), Mapping):
        own["limits"] = {name: table for name, table in limits.items() if homes[name] is None}
        if not own["limits"]:
            del own["limits"]
    margins = _table(own, "margins")
    if str(margins.get("solve", "")).startswith(_BEGINNING) or ("solve" not in margins and tables):
        if "feed" not in data or margins:
            _check_named(margins, tables, findings)
        own.pop("margins", None)
    ties = own.get("dependence")
    _share_dependence(own, made, ties if isinstance(ties, list) else [], findings)
    _share_budget(made, own)
    return own, made


def _check_named(margins: Mapping[str, Raw], services: Mapping[str, Raw], findings: Findings) -> None:
    """Note a [margins] that names no service, or that says what a service is to say."""
    path = str(margins.get("solve", ""))
    name = path.removeprefix(_BEGINNING).partition(".")[0]
    if path and name not in services:
        known = f"known: {one_of(list(services))}{suggestion(name, services)}" if services else "the study has none"
        findings.add(("margins", "solve"), f"found {shown(path)}: no service {shown(name)}, {known}")
    elif not path and not any("solve" in table for table in services.values()):
        findings.add(("margins", "solve"), "solve is missing: add the number that is free, here or in a service")


def _table(data: Mapping[str, Raw], key: str) -> dict[str, Raw]:
    found = data.get(key)
    return dict(found) if isinstance(found, Mapping) else {}


def _home_of(name: str, table: Raw, services: Mapping[str, Raw], findings: Findings) -> str | None:
    """The service that a limit is asked of; None for the rig itself."""
    asked = table.get("in") if isinstance(table, Mapping) else None
    if not isinstance(asked, str):
        energy = isinstance(table, Mapping) and table.get("criterion") == "specific_energy"
        if services and energy and "energy_is" not in table:
            said = f"energy_is is missing beside services: say what the strength means, {one_of(ENERGY_OF)}"
            findings.add(("limits", name, "energy_is"), said)
        return None
    if asked in services:
        return asked
    known = f"known: {one_of(list(services))}{suggestion(asked, services)}" if services else "the study has none"
    findings.add(("limits", name, "in"), f"no service {shown(asked)}, {known}: add [service.NAME], or leave in out")
    return None


# --- strengths that are those of another limit ----------------------------------------------------------


def _without_references(data: Mapping[str, Raw], findings: Findings) -> dict[str, Raw]:
    """The file with every strength written out where it is needed."""
    limits = {name: dict(t) if isinstance(t, Mapping) else t for name, t in _table(data, "limits").items()}
    for name, table in limits.items():
        if not isinstance(table, dict) or _SAME not in _table(table, "strength"):
            continue
        source = _source_of(name, _table(data, "limits"), findings)
        if source is None:
            del table["strength"]
            findings.spoiled.add(("limits", name, "strength"))
            continue
        table["strength"] = deepcopy(source["strength"])
        if "platens" in source:
            table.setdefault("platens", source["platens"])
    return {**data, "limits": limits} if limits else dict(data)


def _source_of(name: str, limits: Mapping[str, Raw], findings: Findings) -> dict[str, Raw] | None:
    """The limit whose strength is meant in the end; None, with the fault noted, where there is none."""
    place: Place = ("limits", name, "strength", _SAME)
    seen = [name]
    while True:
        table = _table(limits, seen[-1])
        strength: Raw = table.get("strength")
        if strength is None:
            findings.add(place, f"limit {shown(seen[-1])} has no strength: give one, or name another limit")
            return None
        if not isinstance(strength, Mapping) or _SAME not in strength:
            return table
        path = str(strength[_SAME])
        other = path.removeprefix("limits.").removesuffix(".strength")
        if not path.startswith("limits.") or not path.endswith(".strength") or other not in limits:
            paths = [f"limits.{one}.strength" for one in limits if one != name]
            known = f"known: {one_of(paths)}{suggestion(path, paths)}" if paths else "there is no other"
            findings.add(place, f"found {shown(path)}, which is no strength of this file; {known}")
            return None
        if len(strength) > 1:
            findings.add(place, "a strength that is that of another limit has no other key: leave the rest out")
            return None
        if other in seen:
            chain = " → ".join([*seen, other])
            findings.add(place, f"the strengths refer to each other in a circle, {chain}: write one of them out")
            return None
        seen.append(other)


# --- the file of a service --------------------------------------------------------------------------------


def _service(name: str, table: Mapping[str, Raw], own: Mapping[str, Raw], homes: Mapping[str, str | None]) -> Service:
    """The study file of one service."""
    data: dict[str, Raw] = {"title": f"{own.get('title', 'Untitled study')}: {name}"}
    for key in _SHARED:
        if key in own:
            data[key] = deepcopy(own[key])
            if isinstance(data[key], dict):
                data[key] = {part: value for part, value in data[key].items() if part not in _OWN_RIG.get(key, ())}
    rig = {key: table[key] for key in declared(RigTable) if key in table}
    data["rig"] = {"kind": "impact", **rig}
    data |= {key: deepcopy(table[key]) for key in _NESTED if key in table}
    limits = {one: dict(t) for one, t in _table(own, "limits").items() if homes[one] == name}
    for limit in limits.values():
        limit.pop("in", None)
        _say_platens(limit, _table(own, "bars"))
    if limits:
        data["limits"] = limits
    margins, here = _margins(name, table, _table(own, "margins"))
    if margins:
        data["margins"] = margins
    return Service(name=name, data=data, solved_here=here)


def _say_platens(limit: dict[str, Raw], bars: Mapping[str, Raw]) -> None:
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


def _margins(name: str, table: Mapping[str, Raw], margins: Mapping[str, Raw]) -> tuple[dict[str, Raw], bool]:
    """What is solved for in a service, and whether the service says so itself."""
    common = {key: margins[key] for key in _FOR_ALL if key in margins}
    beginning = f"{_BEGINNING}{name}."
    path = str(margins.get("solve", ""))
    if path.startswith(beginning):
        return {**margins, "solve": _path(path.removeprefix(beginning))}, False
    asked = {key: table[key] for key in _ASKED if key in table}
    if isinstance(asked.get("solve"), str):
        asked["solve"] = _path(asked["solve"])
    return ({**common, **asked} if asked else {}), True


def _path(path: str) -> str:
    """A number of a service by its path in the file of the service.

    >>> _path("drop_height"), _path("hammer.drop_height")
    ('rig.drop_height', 'hammer.drop_height')
    """
    return path if "." in path else f"rig.{path}"


# --- what the parts share -----------------------------------------------------------------------------------


def _share_dependence(own: dict[str, Raw], made: list[Service], ties: Sequence[Raw], findings: Findings) -> None:
    """Give every part the dependences between the numbers that it has."""
    if not made or not ties:
        return
    for index, tie in enumerate(ties):
        _check_tie(tie, ("dependence", index, "of"), [own, *(service.data for service in made)], made, findings)
    # what is no list of names stays with the rig's own, where it is told
    own["dependence"] = [kept for tie in ties if (kept := tie if _names(tie) is None else _share(tie, own))]
    for at, service in enumerate(made):
        given = {index: kept for index, tie in enumerate(ties) if (kept := _share(tie, service.data, service.name))}
        if given:
            data = {**service.data, "dependence": list(given.values())}
            made[at] = replace(service, data=data, dependences=tuple(given))


def _names(tie: Raw) -> list[Raw] | None:
    """The names of a dependence; None where it has none, or too few to be shared."""
    names = tie.get("of") if isinstance(tie, Mapping) else None
    return names if isinstance(names, list) and len(names) > 1 else None


def _share(tie: Raw, data: Mapping[str, Raw], service: str = "") -> Raw | None:
    """The part of a dependence that stands between numbers of one part; None where there are no two."""
    kept = [_local(name, service) for name in _names(tie) or () if _has(data, name, service)]
    return {**tie, "of": kept} if len(kept) > 1 else None


def _check_tie(
    tie: Raw, place: Place, parts: Sequence[Mapping[str, Raw]], made: Sequence[Service], findings: Findings
) -> None:
    """Note a name that no part has, and a dependence no two numbers of which are in one part."""
    of = list(zip(parts, ["", *(service.name for service in made)], strict=True))
    names = _names(tie) or []
    unknown = [at for at, name in enumerate(names) if not any(_has(data, name, own) for data, own in of)]
    for at in unknown:
        findings.add((*place, at), f"unknown random input {shown(names[at])} in every part")
    if names and not unknown and not any(_share(tie, data, own) for data, own in of):
        findings.add(place, "no part of the study has two of these numbers: a dependence is between numbers of one rig")


def _local(path: Raw, service: str) -> str:
    """A path of the file as the file of a service has it."""
    beginning = f"{_BEGINNING}{service}."
    text = str(path)
    return _path(text.removeprefix(beginning)) if text.startswith(beginning) else text


def _has(data: Mapping[str, Raw], path: Raw, service: str = "") -> bool:
    """Whether something stands at a path."""
    # the numbers of a service stand in the study's own file as well, which does not run them
    node: Raw = data if service or not str(path).startswith(_BEGINNING) else {}
    for part in _local(path, service).split("."):
        if not isinstance(node, Mapping) or part not in node:
            return False
        node = node[part]
    return True


def _share_budget(made: Sequence[Service], own: Mapping[str, Raw]) -> None:
    """Divide the budget among the parts that are run, so that what each does is settled by its own file."""
    budget = _table(_table(own, "analysis"), "budget")
    parts = len(made) + (_table(own, "rig").get("kind") != "none")
    for service in made:
        share = dict(budget)
        most = share.get("evaluations", 2_000_000)
        if isinstance(most, int) and not isinstance(most, bool) and most > 0:
            share["evaluations"] = max(most // parts, 1)
        analysis = _table(service.data, "analysis")
        service.data["analysis"] = {**analysis, "budget": share}
