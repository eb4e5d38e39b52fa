"""The dependences between the random variables of a study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from uqsphere.study.findings import Findings, Place, one_of, shown, suggestion
from uqsphere.study.nouns import Dependence
from uqsphere.study.schema import DependenceTable
from uqsphere.uq.laws import LawError

__all__ = ["read_dependence"]

LATER_COPULAS: Final = ("student_t", "clayton", "gumbel", "frank")
MOST_DEPENDENCES: Final = 100


def read_dependence(
    tables: Sequence[DependenceTable], random: Sequence[str], fixed: Mapping[str, Place], findings: Findings
) -> tuple[Dependence, ...]:
    """The dependences between random variables, checked one by one and then together.

    `random` are the names that scatter, in order; `fixed` the other numbers of the study, with their places.
    """
    if len(tables) > MOST_DEPENDENCES:
        findings.add(("dependence",), f"found {len(tables)} dependences, at most {MOST_DEPENDENCES} are allowed")
        return ()
    groups = [_read_group(table, ("dependence", index), random, fixed, findings) for index, table in enumerate(tables)]
    whole = [group for group in groups if group is not None]
    if groups and len(whole) == len(groups):
        _check_together(whole, random, findings)
    return tuple(whole)


def _read_group(
    table: DependenceTable,
    place: Place,
    random: Sequence[str],
    fixed: Mapping[str, Place],
    findings: Findings,
) -> Dependence | None:
    before = len(findings.faults)
    usable = findings.clean(place)
    if table.copula in LATER_COPULAS:
        said = f'the copula {shown(table.copula)} is not in this version; allowed: "gaussian"'
        findings.add((*place, "copula"), said)
    elif table.copula != "gaussian":
        near = suggestion(table.copula, ["gaussian"])
        findings.add((*place, "copula"), f'unknown copula {shown(table.copula)}, allowed: "gaussian"{near}')
    if table.of is None:
        if findings.clean((*place, "of")):
            findings.add((*place, "of"), "of is missing: add the names of two or more random inputs")
    elif len(table.of) < 2:
        findings.add((*place, "of"), f"found {len(table.of)} names, two or more are due")
    for index, name in enumerate(table.of or ()):
        if name in (table.of or ())[:index]:
            findings.add((*place, "of", index), f"{shown(name)} is named twice")
        elif name not in random:
            usable = _refuse_unrandom(name, (*place, "of", index), random, fixed, findings) and usable
    if table.spearman is None:
        if findings.clean((*place, "spearman")):
            findings.add((*place, "spearman"), "spearman is missing: add a rank correlation between -1 and 1")
    elif not -1.0 < table.spearman < 1.0:
        found = f"found {table.spearman!r}, a rank correlation between -1 and 1, both excluded, is due"
        findings.add((*place, "spearman"), found)
    if len(findings.faults) > before or not usable or table.of is None or table.spearman is None:
        return None
    return Dependence(of=tuple(table.of), copula=table.copula, spearman=table.spearman)


def _refuse_unrandom(
    name: str, place: Place, random: Sequence[str], fixed: Mapping[str, Place], findings: Findings
) -> bool:
    """Note why a name cannot be in a dependence; nothing is said of a number that is faulty itself."""
    if name in fixed:
        if findings.clean(fixed[name]):
            findings.add(place, f"{shown(name)} is a fixed number here: give it a distribution, or leave it out")
        return False
    listed = one_of(random[:20]) if random else "none"
    findings.add(place, f"unknown random input {shown(name)}, random here: {listed}{suggestion(name, random)}")
    return False


def _check_together(groups: Sequence[Dependence], random: Sequence[str], findings: Findings) -> None:
    """Refuse the first dependence that contradicts those before it."""
    from uqsphere.uq.inputs import correlation_from_spearman

    # Only the names that are tied matter, and a study can have many more.
    tied = [name for name in random if any(name in group.of for group in groups)]
    pairs = [(group.of, group.spearman) for group in groups]
    for count in range(1, len(pairs) + 1):
        try:
            correlation_from_spearman(tied, pairs[:count])
        except LawError as error:
            findings.add(("dependence", count - 1, *((error.key,) if error.key else ())), error.message)
            return
