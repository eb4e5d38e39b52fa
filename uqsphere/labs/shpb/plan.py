"""The design of a test: at which speed, height or force which share of the spheres breaks.

The study gives sphere, rig, scatter and strengths.  At each value of the free number its random
inputs scatter (Sobol' points in eight randomisations), and a strength enters by its distribution
function at the demand of every row, so that a share of 4 % or 0.01 % comes from the law and not
from counting rows.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from pydantic import Field

from uqsphere.errors import UsageError
from uqsphere.labs.files import Section, csv_text, table
from uqsphere.quantities import display_unit, format_probability, format_value, lookup
from uqsphere.units import UnitError, parse_value

if TYPE_CHECKING:
    from uqsphere.arrays import Array
    from uqsphere.study import Study

#: randomisations of the Sobol' points
_SPLITS: Final = 8
#: free numbers of the rigs, in the order in which one is taken where the file names none
_FREE: Final = (
    "striker.speed",
    "rig.speed",
    "rig.drop_height",
    "hammer.speed",
    "hammer.drop_height",
    "platens.force",
    "platens.displacement",
)


class PlanDocument(Section):
    """An input file of `uqsphere shpb plan`.

    study : file of the study;  free : its number that is varied;  between : its ends
    shares : of broken spheres whose value is asked for;  limits : those that count, all that mean
        fracture if empty
    rows : samples at every value;  points : values
    """

    study: str
    free: str = ""
    between: tuple[str, str] | None = None
    shares: tuple[float, ...] = Field(default=(0.01, 0.1, 0.5, 0.9), min_length=1)
    limits: tuple[str, ...] = ()
    rows: int = Field(default=256, ge=64, le=65536)
    points: int = Field(default=25, ge=2, le=200)


def plan_test(asked: PlanDocument, folder: Path) -> dict[str, Any]:
    """Shares broken over the free number of a study, as plain JSON in SI.

    values (m,); force (m, 3) 5, 50 and 95 % of the largest force [N]; shares : by limit (m, 3)
    value, low, high of the 95 % interval of the computation; failed (m,) share of rows without an
    answer; reached : by limit, for every share the value with its interval, None beyond the range.

    Raises UsageError for a study without a limit that means fracture or without the number,
        StudyError as `load_study`.
    """
    import uqsphere
    from uqsphere.uq import Law, LimitState, tails
    from uqsphere.uq.curve import fragility

    study = uqsphere.load_study(folder / asked.study)
    if study.black_box:
        raise UsageError("a plan needs a sphere in a rig; this study is a black box")
    limits = [
        one
        for one in study.limits
        if one.fracture is not False and one.name in (asked.limits or [one.name])
    ]
    if not limits:
        raise UsageError(
            "no limit of the study means fracture: a plan needs a strength, [limits.NAME]"
        )
    free, low, high = _range(asked, study)
    factors = [
        f"limits.{one.name}.model_factor" for one in limits if isinstance(one.model_factor, Law)
    ]
    inputs, columns = study.inputs(), [*study.random, *factors]
    drawn = inputs.only(columns)
    scores = (
        drawn.scores(_normals(len(columns), asked.rows, study.seed))
        if columns
        else np.zeros((_SPLITS, 0))
    )
    samples = dict(zip(columns, drawn.marginal(scores).T, strict=True))
    shape = (asked.points, len(scores))
    values = (
        np.geomspace(low, high, asked.points) if low > 0.0 else np.linspace(low, high, asked.points)
    )
    frame = {name: np.tile(samples[name], asked.points) for name in study.random}
    scale = frame[free] / study.random[free].nominal_mean() if free in frame else 1.0
    frame[free] = np.repeat(values, len(scores)) * scale
    answers = uqsphere.evaluate(
        study, frame, tuple(dict.fromkeys(["P_max", *(one.quantity for one in limits)]))
    )
    force = answers["P_max"].to_numpy(dtype=float).reshape(shape)
    lost = np.isnan(force)
    shares: dict[str, Any] = {}
    reached: dict[str, Any] = {}
    for one in limits:
        factor = samples.get(f"limits.{one.name}.model_factor", one.model_factor)
        demand = answers[one.quantity].to_numpy(dtype=float).reshape(shape) * factor
        strength, tie = f"limits.{one.name}.strength", None
        if strength in inputs.names:
            tie = inputs.tie(
                strength, columns, np.broadcast_to(scores, (asked.points, *scores.shape))
            )
        # a row without an answer may break or not
        gone = np.isnan(demand)
        broken = np.where(
            gone, 0.5, tails(LimitState(demands=demand, strength=one.strength, tie=tie))[0]
        )
        each = broken.reshape(asked.points, _SPLITS, -1).mean(axis=2)
        found = fragility(
            values, each, asked.shares, samples=len(scores) // _SPLITS, evaluations=demand.size
        )
        shares[one.name] = [
            [share, max(low - part, 0.0), min(high + part, 1.0)]
            for (_, share, low, high), part in zip(
                found.curve, 0.5 * gone.mean(axis=1), strict=True
            )
        ]
        reached[one.name] = [
            {"share": share, "value": None if at.value is None else (at.value, at.low, at.high)}
            for share, at in found.values.items()
        ]
        lost = lost | gone
    notes = (
        ["each failure mode by itself; at least one of them breaks at least as many"]
        if len(limits) > 1
        else []
    )
    notes += [
        f"{one.name} is to break: 1 minus its share does not"
        for one in limits
        if one.aim == "break"
    ]
    return {
        "title": study.title,
        "free": free,
        "unit": lookup(free).unit,
        "values": values.tolist(),
        "force": np.nanquantile(force, [0.05, 0.5, 0.95], axis=1).T.tolist(),
        "shares": shares,
        "reached": reached,
        "failed": lost.mean(axis=1).tolist(),
        "notes": notes,
    }


def plan_text(plan: dict[str, Any]) -> str:
    """Tables for the terminal."""
    free, unit, factor = plan["free"], *display_unit(plan["free"])
    rows = [(free, "largest force, 5 to 95 %", *(f"broken: {name}" for name in plan["shares"]))]
    for k in range(0, len(plan["values"]), max(1, len(plan["values"]) // 13)):
        low, middle, high = (v * 1e-3 for v in plan["force"][k])
        cells = [
            "{} ({} to {})".format(*map(format_probability, share[k]))
            for share in plan["shares"].values()
        ]
        rows.append(
            (
                format_value(plan["values"][k], free),
                f"{middle:.4g} kN ({low:.4g} to {high:.4g})",
                *cells,
            )
        )
    wanted = [("share broken", *plan["reached"])]
    for one in zip(*plan["reached"].values(), strict=True):
        ends = ([v * factor for v in cell["value"]] if cell["value"] else None for cell in one)
        cells = [
            f"{e[0]:.4g} {unit} ({e[1]:.4g} to {e[2]:.4g})" if e else "beyond the range"
            for e in ends
        ]
        wanted.append((format_probability(one[0]["share"]), *cells))
    notes = [f"note: {note}" for note in plan["notes"]]
    return "\n\n".join([plan["title"], table(rows), f"{free} that breaks", table(wanted), *notes])


def plan_csv(plan: dict[str, Any]) -> str:
    """One row a value."""
    names = [
        f"{plan['free']} [{plan['unit']}]",
        *(f"P_max {share} % [N]" for share in (5, 50, 95)),
        *(f"{name}{end} [1]" for name in plan["shares"] for end in ("", " low", " high")),
        "failed [1]",
    ]
    shares = [column for share in plan["shares"].values() for column in np.transpose(share)]
    return csv_text(names, [plan["values"], *np.transpose(plan["force"]), *shares, plan["failed"]])


def _range(asked: PlanDocument, study: Study) -> tuple[str, float, float]:
    """The free number and its ends [SI]: of the file, of the study's margins, or a third to three
    times its value.
    """
    own, margins = study.at_means(), study.margins
    free = asked.free or (margins.solve if margins is not None and margins.solve in own else "")
    free = free or next((name for name in _FREE if name in own), "")
    if free not in own:
        raise UsageError(
            f"free = {free!r} is no number of the study; it has {', '.join(sorted(own))}"
        )
    low, high = own[free] / 3.0, 3.0 * own[free]
    if asked.between is not None:
        try:
            low, high = (parse_value(text, lookup(free).dimension) for text in asked.between)
        except UnitError as error:
            raise UsageError(f"between: {error}") from None
    elif margins is not None and margins.solve == free:
        low, high = margins.between
    if not low < high:
        raise UsageError("between: two values are required, the lower first")
    return free, low, high


def _normals(dimension: int, rows: int, seed: int) -> Array:
    """Standard normals (n, d) in `_SPLITS` blocks, each a randomisation of the same Sobol'
    points.
    """
    from scipy.special import ndtri

    from uqsphere.uq import sobol_points

    each = 1 << max(3, math.ceil(math.log2(rows / _SPLITS)))
    uniform = [
        sobol_points(dimension=dimension, count=each, seed=seed, task="shpb plan", replicate=split)
        for split in range(_SPLITS)
    ]
    return np.asarray(ndtri(np.concatenate(uniform)))
