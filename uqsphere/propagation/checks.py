"""Where the model may be trusted: its validity checks on the first rows, cautions on inputs and
answers, and the caveats that hold a verdict at "not established".
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import get_args

import numpy as np

from uqsphere.mechanics.criteria import CERTAIN
from uqsphere.models.scene import checked_rows, hardness_of, later_loading
from uqsphere.quantities import format_probability, format_together
from uqsphere.results.types import Caveat, CaveatCode, CheckEntry, Grade
from uqsphere.study import Limit
from uqsphere.study.values import FARTHEST_SIZE
from uqsphere.uq import Law
from uqsphere.uq.describe import heavy_tail
from uqsphere.uq.estimate import count_bound

from .decision import Settled
from .design import Design
from .limits import failure, failure_given_inputs
from .line import Line, plan_of
from .tables import Slow, Tables, input_rows

#: rows that are checked
ROWS = 512
#: share of strengths above the hardness that is worth a word, and from which most of the strength
#: cannot be reached
REACH = (0.01, 0.5)
#: what a loss of contact that comes a swing sooner or later changes
_TIMES = {"time_to_first_loss", "loaded_time", "contact_duration", "force_imbalance"}


class Check(CheckEntry):
    """One check, with the share of each limit's failures that breach it."""

    share: float = 1.0
    failures: Mapping[str, float] = {}


def checks(tables: Tables, notes: Sequence[str] = ()) -> Iterator[Check]:
    """Checks of the model on the first rows of every replicate, those of the tables, and what the
    model noted.
    """
    unknown = "bias not quantified"
    for note in notes:
        yield Check(name="model", text=note, grade="warning", effect=unknown)
    design = tables.design
    sample = tables.sample
    if not design.study.black_box:
        plan = plan_of(design, sample.head(ROWS // sample.replicates))
        for check in _breaches(plan, design.limits):
            worst = max(check.failures.values(), default=0.0)
            effect = ""
            if worst and check.grade == "failure":
                limit = max(design.limits, key=lambda limit: check.failures.get(limit.name, 0.0))
                event = "failures" if limit.aim == "survive" else "samples that do not break"
                effect = f"{format_probability(worst)} of the {event} are among them"
            elif check.grade != "note":
                effect = unknown
            of_times = check.name == "grazing_contact" and check.grade == "note"
            if not of_times or not _TIMES.isdisjoint(design.columns):
                yield check.model_copy(update={"effect": effect})
        _, rows = input_rows(plan.rows)
        yield from _later_loading(design, rows)
        yield from _out_of_reach(design, rows)
    failed = tables.failed
    if failed > 0.0:
        effect = "left out: answers are of those that answered"
        if design.analysis.policy == "bound":
            effect = (
                "intervals widened; mean, standard deviation and indices are of those that answered"
            )
        yield Check(
            name="failed_rows",
            share=failed,
            grade="warning",
            text=f"{format_probability(failed)} of the model runs failed",
            effect=f"{effect}; verdict and number to use hold whatever they would have been; "
            "accuracies are of the runs that answered: more runs do not lower what is left open",
        )
    margins = design.study.moving
    if margins and tables.line:
        low, *_, high = tables.line
        if not np.allclose((low, high), margins.between, rtol=1e-9):
            first, last = format_together((low, high), design.free_quantity)
            yield Check(
                name="short_curve",
                grade="warning",
                text=f"the curve goes from {first} to {last}: beyond, too many model runs fail",
            )
    if isinstance(tables, Slow):
        n = tables.runs
        yield Check(
            name="few_runs",
            grade="note",
            text=f"answers rest on {n} model runs: an event rarer than about 3/{n} is not in them",
            effect=f"failure probabilities below {count_bound(n):.2g} are bounds",
        )
        if margins and not tables.line:
            yield Check(
                name="no_margin",
                grade="note",
                text=f"no margins: along {margins.solve} the runs are too few for expansions, "
                "these leave too much of the variance, or the model fails",
                effect="more runs, or a narrower margins.between, may give them",
            )
    yield from _searches(tables)
    yield from _heavy_tails(tables)


def _breaches(line: Line, limits: Sequence[Limit], yields: Sequence[str] = ()) -> Iterator[Check]:
    """The checks that rows breach, with the share of each limit's failures in rows that fail them;
    a warning of `yields`, or of the range of a limit's criterion, is enough.
    """
    design = line.design
    warned = (*yields, *map(_range_of, limits))
    weights = {}
    for limit in limits:
        state = line.state(design.limit(limit.name))
        weights[limit.name] = np.nan_to_num(failure_given_inputs(state, limit)).ravel()
    for result in checked_rows(design.judged, *input_rows(line.rows), design.columns):
        beyond = result.grades >= 3
        if result.check in warned:
            beyond = result.grades >= 2
        if result.grade:
            yield Check(
                name=result.check,
                text=result.text,
                share=result.share,
                grade=get_args(Grade)[result.grade],
                failures={
                    name: np.average(beyond, weights=weight)
                    for name, weight in weights.items()
                    if weight.any()
                },
            )


def _later_loading(design: Design, rows: np.ndarray) -> Iterator[Check]:
    """Whether the loose sphere strikes one bar harder after the record than in it."""
    ratio = later_loading(design.study, design.inputs, rows)
    finite = ratio[np.isfinite(ratio)]
    harder = finite[finite > 1.001]
    if harder.size:
        share = harder.size / finite.size
        yield Check(
            name="later_loading",
            share=share,
            grade="failure",
            failures={limit.name: share for limit in design.fracture if limit.aim == "survive"},
            text=f"in {format_probability(share)} of the rows the loose sphere later strikes one "
            f"bar with {np.median(harder):.3g} times the largest force of the record",
            effect="blows on one face after the last squeeze between both are not counted: set "
            "model.whole_record = true",
        )


def _out_of_reach(design: Design, rows: np.ndarray) -> Iterator[Check]:
    """Strengths that are true pressures above the hardness, which no pressure exceeds: such spheres
    never break.
    """
    hardness = hardness_of(design.study, design.inputs, rows)
    for limit in design.limits:
        if hardness is None or limit.quantity not in ("p_max", "first_peak", "p_mean"):
            continue
        law = limit.strength
        share = float(np.mean(law.sf(hardness) if isinstance(law, Law) else law > hardness))
        if share >= REACH[0]:
            yield Check(
                name="reachable",
                share=share,
                grade="warning" if share < REACH[1] else "failure",
                failures={limit.name: share},
                text=f"{format_probability(share)} of the strengths of {limit.name} lie above the "
                "hardness, which no pressure exceeds",
                effect='such spheres never break by it: set strength_is = "hertz" if it was '
                "computed from a force, else measure the hardness",
            )


def _searches(tables: Tables) -> Iterator[Check]:
    """Failure probabilities that rest on the failures that a search has met."""
    for limit in tables.design.limits:
        estimate = failure(tables, limit)
        searched = tables.rare.get(limit.subject)
        if searched and estimate.value and estimate.method == searched.estimate.method:
            grade: Grade = "warning"
            effect = searched.warning
            if not effect:
                grade = "note"
                bound = format_probability(None, estimate.outer[1])
                effect = f"with them the failure probability is {bound}"
            yield Check(
                name=f"search_{limit.name}",
                grade=grade,
                text=f"{limit.name}: failures that the search has not met are not in the interval",
                effect=effect,
            )


def _heavy_tails(tables: Tables) -> Iterator[Check]:
    """Outputs whose variance may not exist, by Hill's rule, and demands that nothing bears."""
    for name in tables.design.described:
        values = tables.sample.outputs(name)
        _, parameters = tables.design.study.demands.get(name, ("", {}))
        certain = values >= CERTAIN * parameters.get("largest_energy", math.inf)
        if certain.any():
            yield Check(
                name=f"certain_{name}",
                grade="warning",
                text=f"{name}: {format_probability(certain.mean())} of the samples reach "
                "largest_energy, at which every sphere breaks",
                effect="read quantiles; do not use mean, standard deviation and indices",
            )
        reason = heavy_tail(values)
        if reason and np.isfinite(values).sum() >= 1000:
            yield Check(
                name=f"heavy_tail_{name}",
                grade="warning",
                text=f"{name}: {reason}",
                effect="read quantiles; do not use standard deviation and indices",
            )


# --- caveats --------------------------------------------------------------------------------------

#: checks of the contact that hold a number where they fail; those of faces that yield do so from a
#: warning on wherever they are taken for elastic, with no law of their yield
_RANGE = ("small_contact", "deep_dent", "plastic_range")
_YIELD = ("bar_yield_contact", "sphere_yield_contact", "face_yield")


def _range_of(limit: Limit) -> str:
    """The check of the range of a limit's criterion."""
    return f"range_of_{limit.quantity}"


def caveats_of(settled: Settled, checks: Sequence[Check]) -> Iterator[Caveat]:
    """Why the verdict of an aim is not established; nothing where nothing holds it."""
    design = settled.aim.design
    governing = settled.governing
    if governing.code == "assumed strength":
        yield Caveat(code="assumed strength", subject=governing.limit.subject)
    yield from _model_range(settled, checks)
    # a sphere that is more than half larger, or a third smaller, than all tested ones
    diameter = 2.0 * design.study.at_means().get("sphere.radius", math.nan)
    for limit in settled.aim.limits:
        tested = limit.tested
        if tested and tested.beyond(diameter) > FARTHEST_SIZE:
            sizes = tested.diameters or (tested.diameter,)
            yield Caveat(
                code="size",
                subject=limit.subject,
                value=diameter,
                bound=min(sizes, key=lambda size: abs(size - diameter)),
            )
    ours = tuple(f"limits.{limit.name}." for limit in settled.aim.limits)
    for code, path, text in design.study.caveats:
        if path.startswith(ours) or not path.startswith("limits."):
            yield Caveat.model_validate({"code": code, "subject": path, "text": text})
    # limits on the same tests rest on one set of synthetic data
    names = [group[0].strength_name for group in settled.aim.groups]
    for name in dict.fromkeys([*names, *design.inputs]):
        if name in design.study.made_up:
            yield Caveat(code="synthetic tests", subject=name)


def _model_range(settled: Settled, checks: Sequence[Check]) -> Iterator[Caveat]:
    """Checks that fail in the rows that fail, and criteria that are extrapolated there: those of
    the plan, and those of the model's range at the number to use, where contacts can yield by
    contacts that do.
    """
    study = settled.aim.design.study
    limits = settled.aim.limits
    line = settled.line
    accuracy = study.analysis.accuracy.probability
    failing: dict[str, tuple[float, str]] = {}
    at_number = {}
    ranges = [*map(_range_of, limits)]
    for check in checks:
        for limit in limits:
            share = check.failures.get(limit.name, 0.0)
            # a plan that is milder than the number does not rest on its own range
            unnumbered = settled.use is None and check.name == _range_of(limit)
            if (unnumbered and share > accuracy) or (
                check.grade == "failure" and share > limit.target
            ):
                failing.setdefault(check.name, (share, check.text))
    if settled.use is not None and not study.black_box:
        nearest = line.values[np.argmin(np.abs(line.places - line.place_of(settled.use)))]
        under = replace(line, samples={nearest: line.few.samples[nearest]})
        if settled.aim.yielding:
            under = settled.aim.yielding.along(under) or under
        yields: Sequence[str] = ()
        if under.design.study.options.get("contact.law", "hertz") == "hertz":
            yields = _YIELD
        concerned = {}
        for limit in limits:
            concerned[limit.name] = [*_RANGE, *yields]
            exceeded = line.at(settled.base(limit)[0].mean(axis=1), settled.use)
            # the range of a criterion concerns the failures by it, where the target rests on them
            if limit.missed(exceeded) / limit.target > accuracy:
                concerned[limit.name].append(_range_of(limit))
        for check in _breaches(under, limits, yields):
            shares = [
                check.failures.get(name, 0.0)
                for name, names in concerned.items()
                if check.name in names
            ]
            share = max(shares, default=0.0)
            if share > accuracy:
                at_number[check.name] = (share, f"at the number to use, {check.text}")
        for name, (share, text) in failing.items():
            if name in at_number:
                failing[name] = share, f"at the plan and at the number to use, {text}"
            elif name in _RANGE:
                failing[name] = share, f"at the plan, not at the number to use, {text}"
    for name, (share, text) in (at_number | failing).items():
        code: CaveatCode = "criterion range" if name in ranges else "model range"
        yield Caveat(code=code, subject=name, value=share, text=text)
