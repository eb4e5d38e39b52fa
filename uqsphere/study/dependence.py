"""The dependences between the random variables of a study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from uqsphere.study.document import DependenceTable
from uqsphere.study.faults import Findings, Place, one_of, shown, suggestion
from uqsphere.study.study import Dependence, tie_of
from uqsphere.uq.elliptical import COPULAS
from uqsphere.uq.law import LawError, make_law

__all__ = ["read_dependence"]

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
    if table.copula not in COPULAS:
        near = suggestion(table.copula, COPULAS)
        findings.add((*place, "copula"), f"unknown copula {shown(table.copula)}, allowed: {one_of(COPULAS)}{near}")
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
    _check_strength(table, place, findings)
    if len(findings.faults) > before or not usable or table.of is None:
        return None
    return Dependence(
        of=tuple(table.of), copula=table.copula, spearman=table.spearman, kendall=table.kendall, dof=table.dof
    )


def _check_strength(table: DependenceTable, place: Place, findings: Findings) -> None:
    """One rank correlation, within its range, and the degrees of freedom where they belong."""
    for key, value in (("spearman", table.spearman), ("kendall", table.kendall)):
        if value is not None and not -1.0 < value < 1.0:
            found = f"found {value!r}, a rank correlation between -1 and 1, both excluded, is due"
            findings.add((*place, key), found)
    if table.spearman is not None and table.kendall is not None:
        findings.add((*place, "kendall"), "spearman is given too: one of them says how strong the dependence is")
    sound = findings.clean((*place, "spearman")) and findings.clean((*place, "kendall"))
    if table.spearman is None and table.kendall is None and sound:
        missing = "spearman is missing: add a rank correlation between -1 and 1, or kendall in its place"
        findings.add((*place, "spearman"), missing)
    if table.copula == "student_t" and table.dof is None:
        if findings.clean((*place, "dof")):
            findings.add((*place, "dof"), "dof is missing: a Student t copula needs its degrees of freedom, 4 say")
    elif table.copula in COPULAS and table.copula != "student_t" and table.dof is not None:
        findings.add((*place, "dof"), f'dof belongs to copula = "student_t", the copula here is {shown(table.copula)}')


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
    from uqsphere.uq.joint import make_inputs

    # Only the names that are tied matter, and a study can have many more.
    tied = [name for name in random if any(name in group.of for group in groups)]
    ties = [tie_of(group) for group in groups]
    unit = make_law("normal", {"mean": 0.0, "sd": 1.0})
    for count in range(1, len(ties) + 1):
        try:
            make_inputs(tied, [unit] * len(tied), ties[:count])
        except LawError as error:
            key = error.key
            if key == "spearman" and ties[count - 1].spearman is None:
                key = "kendall"
            findings.add(("dependence", count - 1, *((key,) if key else ())), error.message)
            return
