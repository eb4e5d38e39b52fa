"""What a study asks of its indices and tolerance intervals: groups of inputs, and Wilks' runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from uqsphere.study.document import ToleranceTable
from uqsphere.study.faults import Findings, Place, one_of, shown, suggestion
from uqsphere.study.study import ToleranceRequest
from uqsphere.uq.tolerance import least_runs

__all__ = ["read_groups", "read_tolerance"]

MOST_GROUPS: Final = 50
MOST_RUNS: Final = 1_000_000


def read_groups(
    given: Mapping[str, Sequence[str]], random: Sequence[str], fixed: Mapping[str, Place], findings: Findings
) -> dict[str, tuple[str, ...]]:
    """Groups of random inputs by their names, each group's inputs named once.

    `random` are the inputs of the model that scatter, in order; `fixed` the other numbers, with their places.
    """
    place: Place = ("analysis", "groups")
    if len(given) > MOST_GROUPS:
        findings.add(place, f"found {len(given)} groups, at most {MOST_GROUPS} are allowed")
        return {}
    for group, names in given.items():
        if not names:
            findings.add((*place, group), "the group is empty: name its inputs")
        for index, name in enumerate(names):
            here = (*place, group, index)
            if name in names[:index]:
                findings.add(here, f"{shown(name)} is named twice")
            elif name in random:
                continue
            elif name in fixed:
                if findings.clean(fixed[name]):
                    findings.add(here, f"{shown(name)} does not scatter here: give it a distribution, or leave it out")
            else:
                listed = one_of(list(random[:20])) if random else "none"
                near = suggestion(name, random)
                findings.add(here, f"unknown random input {shown(name)}, random here: {listed}{near}")
    return {group: tuple(names) for group, names in given.items()}


def read_tolerance(table: ToleranceTable | None, findings: Findings) -> ToleranceRequest | None:
    """The tolerance intervals asked for; `runs` by default the fewest that give a two-sided interval."""
    if table is None:
        return None
    place: Place = ("analysis", "tolerance_intervals")
    before = len(findings.faults)
    for key, value in (("coverage", table.coverage), ("confidence", table.confidence)):
        if not 0.0 < value < 1.0:
            findings.add((*place, key), f"found {value!r}, a number between 0 and 1, both excluded, is due")
    if len(findings.faults) > before:
        return None
    least = least_runs(table.coverage, table.confidence, sides=1)
    both = least_runs(table.coverage, table.confidence, sides=2)
    if both > MOST_RUNS:
        findings.add(place, f"this coverage and confidence take {both:,} runs, at most {MOST_RUNS:,} are allowed")
        return None
    runs = both if table.runs is None else table.runs
    if not least <= runs <= MOST_RUNS:
        said = f"found {runs}, from {least} (one-sided; {both} for two sides) to {MOST_RUNS:,} are due"
        findings.add((*place, "runs"), said)
        return None
    return ToleranceRequest(coverage=table.coverage, confidence=table.confidence, runs=runs)
