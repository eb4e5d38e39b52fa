"""Where the model may be trusted: its validity checks on the first rows, and cautions on inputs and
answers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from uqsphere.models.scene import checked_rows, hardness_of, later_loading
from uqsphere.propagation.design import Design
from uqsphere.propagation.limits import failure_given_inputs, state_of
from uqsphere.propagation.line import Line
from uqsphere.propagation.sampled import source_of
from uqsphere.propagation.tables import Tables, stacked
from uqsphere.quantities import format_probability
from uqsphere.results.types import CheckEntry, Grade
from uqsphere.study import Limit
from uqsphere.uq import Law

#: rows that are checked
ROWS = 512
#: share of strengths above the hardness that is worth a word, and from which most of the strength
#: cannot be reached
REACH = (0.01, 0.5)
#: what a loss of contact that comes a swing sooner or later changes
_TIMES = {"time_to_first_loss", "contact_duration"}
GRADES: tuple[Grade, ...] = ("ok", "note", "warning", "failure")


@dataclass(frozen=True, kw_only=True)
class Check:
    """One check: the share of rows that breach it, its grade, and the share of each limit's
    failures that do.
    """

    name: str
    text: str
    share: float
    grade: Grade
    effect: str = ""
    failures: Mapping[str, float] = field(default_factory=dict)

    def entry(self) -> CheckEntry:
        """As the results have it."""
        return CheckEntry(
            name=self.name,
            text=self.text,
            share=self.share,
            grade=self.grade,
            effect=self.effect,
        )


def checks(design: Design, tables: Tables, notes: Sequence[str] = ()) -> list[Check]:
    """Checks of the model on the first rows of every replicate, those of the tables, and what the
    model noted.
    """
    breached = [
        Check(name="model", text=note, share=1.0, grade="warning", effect="bias not quantified")
        for note in notes
    ]
    sample = tables.sample
    each = max(ROWS // len(sample.scores), 1)
    head = sample.head(min(each, sample.count))
    if not design.study.black_box:
        rows = stacked([head.input(name).ravel() for name in design.inputs])
        results, grades = checked_rows(design.judged, design.inputs, rows, design.columns)
        weights = {
            limit.name: np.ravel(failure_given_inputs(state_of(design, limit, head), limit.aim))
            for limit in design.limits
        }
        for result in results:
            if not result.grade or (
                result.check == "grazing_contact" and _TIMES.isdisjoint(design.columns)
            ):
                continue
            broken = np.resize(grades.get(result.check, np.zeros(1)), head.size) == 3
            failures = {
                name: float((w * broken).sum() / w.sum())
                for name, w in weights.items()
                if w.sum() > 0.0
            }
            worst = max(failures.values(), default=0.0)
            effect = ""
            if worst:
                effect = f"{format_probability(worst)} of the failures lie in such rows"
            elif GRADES[result.grade] != "note":
                effect = "bias not quantified"
            breached.append(
                Check(
                    name=result.check,
                    text=result.text,
                    share=float(result.share),
                    grade=GRADES[result.grade],
                    effect=effect,
                    failures=failures,
                )
            )
        breached += _later_loading(design, rows) + _out_of_reach(design, rows)
    source = source_of(design, tables)
    failed = source.dropped or float(sample.failed.mean())
    if failed > 0.0:
        policy = design.study.analysis.policy
        breached.append(
            Check(
                name="failed_rows",
                share=failed,
                grade="warning",
                text=f"{format_probability(failed)} of the model runs failed",
                effect="left out" if policy == "drop" else "intervals widened",
            )
        )
    if source.refusal:
        n = tables.runs
        breached.append(
            Check(
                name="few_runs",
                share=1.0,
                grade="note",
                text=(
                    f"answers rest on {n} model runs: an event rarer than about 3/{n} is not in "
                    "them"
                ),
                effect=f"failure probabilities below {3.0 / n:.2g} are bounds",
            )
        )
    breached += _heavy_tails(design, tables)
    return breached


#: checks of the contact that hold a number in rows of the worst grade
_RANGE: Final = ("small_contact", "deep_dent", "plastic_range")
#: those that hold it wherever faces yield that are taken for elastic, with no law of their yield
_YIELD: Final = ("bar_yield_contact", "sphere_yield_contact", "face_yield")


def range_checks(line: Line, limits: Sequence[Limit], value: float | None = None) -> list[Check]:
    """The checks of the contact's range in the rows of a line at one value of the free number, with
    the share of each limit's failures that lie in rows beyond it.
    """
    design, sample = line.design, line.samples[0]
    names, columns = list(design.inputs), [sample.input(name).ravel() for name in design.inputs]
    margins = design.study.margins
    moves = value is not None and margins is not None and margins.limit is None
    if moves and margins is not None and margins.solve not in names:
        names.append(margins.solve)
        columns.append(np.full(sample.size, value))
    rows = stacked(columns, sample.size)
    results, grades = checked_rows(design.judged, names, rows, design.columns)
    limit_by_name = {limit.name: limit for limit in design.judged.limits}
    elastic = design.study.options.get("contact.law", "hertz") == "hertz"
    breached = []
    for result in results:
        worst = 3 if result.check in _RANGE else 2
        if result.check not in (*_RANGE, *_YIELD) or (worst == 2 and not elastic):
            continue
        beyond = grades.get(result.check, np.zeros(sample.size)) >= worst
        failures = {}
        for limit in limits:
            state = line.state(limit_by_name[limit.name])
            weights = np.nan_to_num(failure_given_inputs(state, limit.aim)).ravel()
            if weights.sum() > 0.0:
                failures[limit.name] = float((weights * beyond).sum() / weights.sum())
        breached.append(
            Check(
                name=result.check,
                text=result.text,
                share=float(beyond.mean()),
                grade="failure",
                failures=failures,
            )
        )
    return breached


def _later_loading(design: Design, rows: np.ndarray) -> list[Check]:
    """Whether the loose sphere strikes one bar harder after the record than in it."""
    with np.errstate(all="ignore"):
        ratio = later_loading(design.study, design.inputs, rows)
    finite = ratio[np.isfinite(ratio)]
    harder = finite > 1.001
    if not harder.any():
        return []
    share, median = float(harder.mean()), float(np.median(finite[harder]))
    whole = {limit.name: share for limit in design.fracture if limit.aim == "survive"}
    return [
        Check(
            name="later_loading",
            share=share,
            grade="failure",
            failures=whole,
            text=f"in {format_probability(share)} of the rows the loose sphere later strikes one "
            f"bar with {median:.3g} times the largest force of the record",
            effect=(
                "blows on one face after the last squeeze between both are not counted: set "
                "model.whole_record = true"
            ),
        )
    ]


def _out_of_reach(design: Design, rows: np.ndarray) -> list[Check]:
    """Strengths that are true pressures above the hardness, which no pressure exceeds: such spheres
    never break.
    """
    hardness = hardness_of(design.study, design.inputs, rows)
    breached: list[Check] = []
    if hardness is None:
        return breached
    for limit in design.limits:
        if limit.quantity not in ("p_max", "first_peak", "p_mean"):
            continue
        law = limit.strength
        share = float(np.mean(law.sf(hardness) if isinstance(law, Law) else law > hardness))
        if share < REACH[0]:
            continue
        breached.append(
            Check(
                name="reachable",
                share=share,
                grade="warning" if share < REACH[1] else "failure",
                failures={limit.name: share},
                text=f"{format_probability(share)} of the strengths of {limit.name} lie above the "
                "hardness, which no "
                "pressure exceeds",
                effect='such spheres never break by it: set strength_is = "hertz" if it was '
                "computed from a force, else measure the hardness",
            )
        )
    return breached


def _heavy_tails(design: Design, tables: Tables) -> list[Check]:
    """One warning by Hill's rule: an output whose variance may not exist."""
    from uqsphere.uq.describe import hill

    heavy = []
    for name in design.described:
        values = tables.sample.outputs(name)
        values = values[np.isfinite(values)]
        if values.size < 1000 or not values.std() > 0.0:
            continue
        order = hill(values)
        if order < 2.0:
            heavy.append(
                Check(
                    name=f"heavy_tail_{name}",
                    share=1.0,
                    grade="warning",
                    text=f"{name} has a tail so heavy that its variance may not exist (Hill index "
                    f"{order:.2g})",
                    effect="read quantiles; do not use standard deviation and indices",
                )
            )
    return heavy
