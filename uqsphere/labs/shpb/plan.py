"""The design of a test: at which speed, height or force which share of the spheres breaks.

The study gives sphere, rig, scatter and strengths.  The shares are the fragility curves of its run
(`uqsphere.fragility_curves`): a strength from tests counts by the equivalent test force, and a
share of 0.01 % comes from the distribution of the strength, not from counted samples.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

import uqsphere
from uqsphere.documents import Fault, unknown
from uqsphere.errors import StudyError, UsageError
from uqsphere.labs.files import InputError, JsonObject, Section, csv_text, in_unit, table
from uqsphere.quantities import (
    format_estimate,
    format_probability,
    format_probability_estimate,
    format_value,
    lookup,
)

Share = Annotated[float, in_unit("number"), Field(gt=0.0, lt=1.0)]


class PlanDocument(Section):
    """An input file of `uqsphere shpb plan`.

    study : file of the study.
    free : number of the study that is varied; between : lowest and highest value (default: those of
        the study's margins).
    shares : shares of broken spheres whose values are wanted.
    limits : limits that count (default: all that mean fracture, and the failure modes with a
        strength of the library).
    rows : samples at every value; points : values.
    """

    study: str
    free: str = ""
    between: tuple[str, str] | None = None
    shares: tuple[Share, ...] = Field(default=(0.01, 0.1, 0.5, 0.9), min_length=1)
    limits: tuple[str, ...] = ()
    rows: int = Field(default=256, ge=64, le=65536)
    points: int = Field(default=25, ge=2, le=200)


def plan_test(asked: PlanDocument, folder: Path) -> JsonObject:
    """Shares broken over the free number of a study, as plain JSON in SI.

    values (m,); force (m, 3): 5, 50 and 95 % of the largest force [N]; shares: by limit (m, 3)
    value, low, high of the 95 % interval of the computation; failed (m,): share of samples without
    an answer; reached: by limit, for every share the value with its interval, None beyond the
    range.

    Raises UsageError for a study without a limit that means fracture or without the number, and for
        a range that no study could have; StudyError as `load_study`.
    """
    path = folder / asked.study
    study = uqsphere.load_study(path)
    if study.black_box:
        raise UsageError("a plan needs a sphere in a rig; this study is a black box")
    limits = {limit.name: limit for limit in study.limits if limit.fracture is not False}
    if not limits:
        raise UsageError(
            "no limit of the study means fracture: a plan needs a strength, [limits.NAME]"
        )
    for name in asked.limits:
        if name not in limits:
            raise InputError(unknown("limit that means fracture", name, limits), "limits")
    limits = {name: limit for name, limit in limits.items() if name in (asked.limits or limits)}
    solved = study.margins.solve if study.margins else ""
    free = asked.free or solved
    if not free or not (asked.between or free == solved):
        raise InputError(
            "give a number of the study, such as striker.speed, and between = [lowest, highest]; "
            "only what [margins] of the study has may be omitted",
            "free",
        )
    overrides = [f"margins.solve={free}"]
    if asked.between:
        overrides.append(f"margins.between={json.dumps(asked.between)}")
    try:
        study = uqsphere.load_study(path, overrides)
    except StudyError as error:
        refused = InputError(str(error))
        refused.faults = []
        for fault in error.problems:
            message = fault.message.removesuffix(" (set by --set)")
            key = fault.path.replace("margins.solve", "free").removeprefix("margins.")
            refused.faults.append(Fault(message, key))
        raise refused from None
    margins = study.margins
    assert margins
    quantities = ("P_max", *(limit.quantity for limit in limits.values()))
    counted: JsonObject = {"quantities": (*dict.fromkeys(quantities),)}
    # those that mean no fracture stand in the place of a failure mode of the library, as in a run
    known = {limit.name for limit in study.limits} - limits.keys()
    if asked.limits:
        counted["failure_modes"] = "given"
        study = replace(study, limits=tuple(limits.values()))
    planned = replace(
        study,
        margins=margins.model_copy(update={"for_probability": asked.shares}),
        analysis=study.analysis.model_copy(update=counted),
    )
    curves = uqsphere.fragility_curves(planned, rows=asked.rows, values=asked.points)
    shares = {}
    reached = dict[str, list[JsonObject]]()
    for name, curve in curves.limits.items():
        if name in known:
            continue
        shares[name] = np.array(curve.curve)[:, 1:4].tolist()
        reached[name] = []
        for share, at in curve.values.items():
            value = None if at.value is None else (at.value, at.low, at.high)
            reached[name].append({"share": share, "value": value})
    notes = [*study.warnings]
    if len(shares) > len(limits):
        notes.append("assumed: a strength of the library, at its middle, not measured on this rock")
    if len(shares) > 1:
        notes.append("each failure mode by itself; the share that breaks by any of them is larger")
    notes += [
        f"{limit.name} has the aim to break: the shares are of broken spheres"
        for limit in limits.values()
        if limit.aim == "break"
    ]
    return {
        "title": study.title,
        "free": free,
        "unit": lookup(free).unit,
        "values": curves.values.tolist(),
        "force": np.nanquantile(curves.outputs["P_max"], [0.05, 0.5, 0.95], axis=1).T.tolist(),
        "shares": shares,
        "reached": reached,
        "failed": curves.failed.tolist(),
        "notes": notes,
    }


def plan_text(plan: JsonObject) -> str:
    """Tables for the terminal."""
    free = plan["free"]
    rows = [[free, "largest force, 5 to 95 %", *(f"broken: {name}" for name in plan["shares"])]]
    values = plan["values"]
    for k in range(0, len(values), max(1, len(values) // 13)):
        low, middle, high = plan["force"][k]
        row = [format_value(values[k], free), format_estimate(middle, low, high, "P_max")]
        row += [format_probability_estimate(*shares[k]) for shares in plan["shares"].values()]
        rows.append(row)
    wanted = [["share broken", *plan["reached"]]]
    for cells in zip(*plan["reached"].values(), strict=True):
        row = [format_probability(cells[0]["share"])]
        for cell in cells:
            text = "outside the range"
            if cell["value"]:
                value, low, high = cell["value"]
                text = format_estimate(value, low, high, free)
            row.append(text)
        wanted.append(row)
    notes = [f"note: {note}" for note in plan["notes"]]
    return "\n\n".join(
        [plan["title"], table(rows), f"{free} at which a share breaks", table(wanted), *notes]
    )


def plan_csv(plan: JsonObject) -> str:
    """One row a value."""
    head = [f"{plan['free']} [{plan['unit']}]"]
    head += [f"P_max {percent} % [N]" for percent in (5, 50, 95)]
    for name in plan["shares"]:
        head += [f"{name} [1]", f"{name} low [1]", f"{name} high [1]"]
    columns = [plan["values"], plan["force"], *plan["shares"].values(), plan["failed"]]
    return csv_text(np.column_stack(columns), [*head, "failed [1]"])
