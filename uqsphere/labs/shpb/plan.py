"""The design of a test: at which speed, height or force which share of the spheres breaks.

The study gives sphere, rig, scatter and strengths.  At each value of the free number its random inputs scatter (Sobol'
points in eight randomisations), and a strength enters by its distribution function at the demand of every row, so that
a share of 4 % or 0.01 % comes from the law and not from counting rows.
"""

from __future__ import annotations

import io
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from pydantic import Field

from uqsphere.errors import UsageError
from uqsphere.labs.shpb.document import Section
from uqsphere.quantities import display_unit, format_value, lookup
from uqsphere.units import UnitError, parse_value

if TYPE_CHECKING:
    from uqsphere.arrays import Array
    from uqsphere.study import Study

#: randomisations of the Sobol' points, and Student's 97.5 % point of one less
_SPLITS, _REACH = 8, 2.364624
#: free numbers of the rigs, in the order in which one is taken where the file names none
_FREE: Final = (
    "striker.speed", "rig.speed", "rig.drop_height", "hammer.speed", "hammer.drop_height", "platens.force",
    "platens.displacement",
)  # fmt: skip


class PlanDocument(Section):
    """An input file of `uqsphere shpb plan`.

    study : file of the study;  free : its number that is varied;  between : its ends
    shares : of broken spheres whose value is asked for;  limits : those that count, all that mean fracture if empty
    rows : samples at every value;  points : values
    """

    study: str
    free: str = ""
    between: tuple[str, str] | None = None
    shares: tuple[float, ...] = Field(default=(0.01, 0.1, 0.5, 0.9), min_length=1)
    limits: tuple[str, ...] = ()
    rows: int = Field(default=256, ge=64, le=65536)
    points: int = Field(default=25, ge=2, le=200)


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Shares of broken spheres over the free number.

    values (m,) [SI]; force : (m, 3) 5, 50 and 95 % of the largest force [N]; shares : by limit (m, 3) value, low, high
    of the 95 % interval of the computation; failed : (m,) share of rows without an answer; reached : by limit and share
    the value with its interval, None beyond the range.
    """

    title: str
    free: str
    values: Array
    force: Array
    shares: Mapping[str, Array]
    failed: Array
    reached: Mapping[str, Sequence[tuple[float, tuple[float, float, float] | None]]]
    notes: tuple[str, ...]

    def text(self) -> str:
        """Tables for the terminal."""
        from uqsphere.labs.shpb.cli import table

        rows = [(self.free, "largest force, 5 to 95 %", *(f"broken: {name}" for name in self.shares))]
        for k in range(0, len(self.values), max(1, len(self.values) // 13)):
            low, middle, high = (v * 1e-3 for v in self.force[k])
            cells = [_percent(*share[k]) for share in self.shares.values()]
            rows.append(
                (format_value(float(self.values[k]), self.free), f"{middle:.4g} kN ({low:.4g} to {high:.4g})", *cells)
            )
        wanted = [("share broken", *self.shares)]
        for j, (share, _) in enumerate(next(iter(self.reached.values()))):
            cells = [_value(self.reached[name][j][1], self.free) for name in self.shares]
            wanted.append((_short(share), *cells))
        return "\n\n".join([self.title, table(rows), f"{self.free} that breaks", table(wanted), *self.notes])

    def content(self) -> dict[str, Any]:
        """Plain JSON, SI."""
        return {
            "title": self.title, "free": self.free, "values": self.values.tolist(), "force": self.force.tolist(),
            "shares": {name: share.tolist() for name, share in self.shares.items()}, "failed": self.failed.tolist(),
            "reached": {name: [{"share": s, "value": v} for s, v in own] for name, own in self.reached.items()},
            "notes": list(self.notes),
        }  # fmt: skip

    def csv(self) -> str:
        """One row a value."""
        import pandas as pd

        columns = {f"{self.free} [{lookup(self.free).unit}]": self.values}
        columns |= {f"P_max {name} [N]": self.force[:, k] for k, name in enumerate(("5 %", "50 %", "95 %"))}
        for name, share in self.shares.items():
            columns |= {f"{name}{end} [1]": share[:, k] for k, end in enumerate(("", " low", " high"))}
        text = io.StringIO()
        pd.DataFrame({**columns, "failed [1]": self.failed}).to_csv(text, index=False)
        return text.getvalue()


def _short(share: float) -> str:
    """A share in percent that is never rounded to 0 or 100 %.

    >>> _short(0.04), _short(3e-7), _short(0.0)
    ('4 %', '3e-05 %', '0 %')
    """
    if share > 0.999:
        return f"100 - {100.0 * (1.0 - share):.2g} %" if share < 1.0 else "100 %"
    return f"{100.0 * share:.2g} %"


def _percent(value: float, low: float, high: float) -> str:
    return f"{_short(value)} ({_short(low)} to {_short(high)})"


def _value(value: tuple[float, float, float] | None, free: str) -> str:
    if value is None:
        return "beyond the range"
    unit, factor = display_unit(free)
    return f"{value[0] * factor:.4g} {unit} ({value[1] * factor:.4g} to {value[2] * factor:.4g})"


def plan_test(asked: PlanDocument, folder: Path) -> Plan:
    """Shares broken over the free number of a study.

    Raises UsageError for a study without a limit that means fracture or without the number, StudyError as `load_study`.
    """
    import uqsphere
    from uqsphere.uq import Law

    study = uqsphere.load_study(folder / asked.study)
    if study.black_box:
        raise UsageError("a plan needs a sphere in a rig; this study is a black box")
    limits = [
        one for one in study.limits if one.fracture is not False and (not asked.limits or one.name in asked.limits)
    ]
    if not limits:
        raise UsageError("no limit of the study means fracture: a plan needs a strength, [limits.NAME]")
    free, low, high = _range(asked, study)
    names = [name for name in study.random if name != free]
    factors = [f"limits.{one.name}.model_factor" for one in limits if isinstance(one.model_factor, Law)]
    moved = study.random.get(free)
    columns = [*names, *([free] if moved is not None else []), *factors]
    samples = _samples(study, columns, asked.rows)
    rows = len(samples)
    values = np.geomspace(low, high, asked.points) if low > 0.0 else np.linspace(low, high, asked.points)
    frame = {name: np.tile(samples[:, k], asked.points) for k, name in enumerate(columns) if name not in factors}
    level = np.repeat(values, rows)
    frame[free] = level * (frame[free] / moved.nominal_mean() if moved is not None else 1.0)
    quantities = tuple(dict.fromkeys(["P_max", *(one.quantity for one in limits)]))
    answers = uqsphere.evaluate(study, frame, quantities)
    force = answers["P_max"].to_numpy(dtype=float).reshape(asked.points, rows)
    good = np.isfinite(force)
    shares, reached, notes = {}, {}, []
    for one in limits:
        demand = answers[one.quantity].to_numpy(dtype=float).reshape(asked.points, rows)
        name = f"limits.{one.name}.model_factor"
        factor = samples[:, columns.index(name)] if name in columns else one.model_factor
        demand = demand * factor
        good &= np.isfinite(demand)
        broken = one.strength.cdf(demand) if isinstance(one.strength, Law) else (demand > one.strength).astype(float)
        # a row without an answer may break or not
        lost = np.isnan(demand)
        each = np.where(lost, 0.5, broken).reshape(asked.points, _SPLITS, -1).mean(axis=2)
        gone = lost.mean(axis=1)
        mean, half = each.mean(axis=1), _REACH * each.std(axis=1, ddof=1) / math.sqrt(_SPLITS)
        spread = np.exp(np.minimum(half / np.maximum(mean, 1e-300), 50.0))
        lower, upper = np.maximum(mean / spread - 0.5 * gone, 0.0), np.minimum(mean + half + 0.5 * gone, 1.0)
        shares[one.name] = np.stack([mean, lower, upper], axis=1)
        reached[one.name] = [(share, _reach(values, each, share)) for share in asked.shares]
        tied = any(f"limits.{one.name}.strength" in getattr(group, "of", ()) for group in study.dependence)
        if tied:
            notes.append(
                f"note: the strength of {one.name} is tied to inputs in the study; here it is independent of them"
            )
        if isinstance(one.strength, Law) and one.aim == "break":
            notes.append(f"note: {one.name} is to break: 1 minus its share is the probability of not breaking")
    if len(limits) > 1:
        notes.append("note: each failure mode by itself; at least one breaks at least as many")
    return Plan(title=study.title, free=free, values=values, force=np.nanquantile(force, [0.05, 0.5, 0.95], axis=1).T,
                shares=shares, failed=1.0 - good.mean(axis=1), reached=reached, notes=tuple(notes))  # fmt: skip


def _range(asked: PlanDocument, study: Study) -> tuple[str, float, float]:
    """The free number and its ends [SI]: of the file, of the study's margins, or a third to three times its value."""
    own, axis = study.at_means(), study.margins.axis if study.margins is not None else None
    free = asked.free or (axis.path if axis is not None and axis.path in own else "")
    free = free or next((name for name in _FREE if name in own), "")
    if free not in own:
        raise UsageError(f"free = {free!r} is no number of the study; it has {', '.join(sorted(own))}")
    if asked.between is not None:
        try:
            low, high = (parse_value(text, lookup(free).dimension) for text in asked.between)
        except UnitError as error:
            raise UsageError(f"between: {error}") from None
    elif axis is not None and axis.path == free:
        low, high = axis.low, axis.high
    else:
        low, high = own[free] / 3.0, 3.0 * own[free]
    if not low < high:
        raise UsageError("between: two values are required, the lower first")
    return free, low, high


def _samples(study: Study, names: Sequence[str], rows: int) -> Array:
    """Scattering numbers (n, d) in SI, in `_SPLITS` blocks, each a randomisation of the same Sobol' points."""
    from scipy.special import ndtri
    from scipy.stats import qmc

    each = 1 << max(3, math.ceil(math.log2(rows / _SPLITS)))
    if not names:
        return np.zeros((_SPLITS, 0))
    blocks = []
    for split in range(_SPLITS):
        stream = np.random.default_rng([study.seed, zlib.crc32(b"shpb plan"), split])
        blocks.append(qmc.Sobol(len(names), rng=stream).random(each))
    uniform = np.clip(np.concatenate(blocks), 1e-12, 1.0 - 1e-12)
    return study.inputs().only(tuple(names)).physical(ndtri(uniform))


def _reach(values: Array, each: Array, share: float) -> tuple[float, float, float] | None:
    """The value at which a share breaks, with its interval from the randomisations (m, R); None beyond the range."""

    def at(course: Array) -> float | None:
        rising = np.maximum.accumulate(course)
        if not rising[0] <= share <= rising[-1]:
            return None
        logit = np.log(np.maximum(rising, 1e-300)) - np.log(np.maximum(1.0 - rising, 1e-300))
        wanted = math.log(share) - math.log1p(-share)
        kept = np.concatenate([[True], np.diff(logit) > 0.0])
        return float(np.exp(np.interp(wanted, logit[kept], np.log(values[kept]))))

    middle = at(each.mean(axis=1))
    ends = [at(each[:, k]) for k in range(each.shape[1])]
    if middle is None:
        return None
    known = np.log([end if end is not None else middle for end in ends])
    half = _REACH * float(known.std(ddof=1)) / math.sqrt(len(known))
    return middle, middle * math.exp(-half), middle * math.exp(half)
