"""A first look at the scene: which fidelity serves, what the numbers of the scene are, which checks it breaks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.mechanics.fidelity import Fallback, fit_error_law
from uqsphere.mechanics.outputs import all_with
from uqsphere.mechanics.yielding import Face
from uqsphere.model import cheaper_fidelities, is_answered, scene_of, solve_scene
from uqsphere.results import CheckEntry, Fields
from uqsphere.runner.chunks import remembered
from uqsphere.runner.evaluate import Work, draw
from uqsphere.runner.schedule import PILOT, pilot_points
from uqsphere.runner.similarity import Tabled, table_entry, table_saved
from uqsphere.study import Limit, Study
from uqsphere.uq import Law, finite

if TYPE_CHECKING:
    from uqsphere.mechanics.outputs import Answers
    from uqsphere.mechanics.scene import Scene

#: a cheaper fidelity is taken if its error is below this share of the tightest accuracy asked for
SHARE = 0.2
#: cost of a row in steps of the integrator: what a row takes before its first step, and what one in closed form takes
#: altogether.  Counted and not timed, so that no choice depends on the clock
START_STEPS = 10.0
CLOSED_STEPS = 3.0
#: an error law is dropped if more than this share of the rows it has not seen err by more than it says
BROKEN = 0.02
#: how far a row's estimated error may lie above what the mean square of all may be, tried in turn, and the share of
#: that mean square that the rows the law was fitted to may use up
ROW_BOUNDS, USED_UP = (3.0, 2.0, 1.0), 0.7
#: a mixture that costs more than this of the full model is not worth its bookkeeping
WORTHWHILE = 0.8


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A cheaper fidelity as the pilot sees it, beside `full` on the same rows.

    Attributes
    ----------
    error, worst : root-mean-square and largest difference from `full` over the quantity's standard deviation
    correlation : with `full`, by quantity
    cost : of a row, over that of a row of `full`
    fits : whether it passes the rule in every row by itself
    mixed_error : error of the mixture with `full` on rows that the error law has not seen; empty if not tried
    fallback_share : share of those rows that the mixture leaves to `full`
    fallback : the error law; None where it cannot be fitted
    """

    fidelity: str
    error: dict[str, float | None]
    worst: dict[str, float | None]
    correlation: dict[str, float | None]
    cost: float
    fits: bool
    mixed_error: dict[str, float | None] = field(default_factory=dict)
    fallback_share: float = 0.0
    fallback: Fallback | None = None

    def mixes(self, bound: float) -> bool:
        """Whether it passes the rule where rows that its error law tells are left to `full`."""
        return self.fallback is not None and _passes(self.mixed_error, bound)

    @property
    def told_error(self) -> dict[str, float | None]:
        """The error of what serves: by itself, or mixed with `full`."""
        return self.error if self.fallback_share == 0.0 else self.mixed_error

    @property
    def mixed_cost(self) -> float:
        """Cost of a row of the mixture over that of a row of `full`."""
        return self.fallback_share + (1.0 - self.fallback_share) * self.cost


@dataclass(frozen=True, kw_only=True)
class Pilot:
    """The choice of the model, with what was measured for it, and the validity checks on the pilot sample."""

    chosen: str
    why: str
    measured_error: dict[str, float | None] = field(default_factory=dict)
    validity: list[CheckEntry] = field(default_factory=list)
    numbers: dict[str, float] = field(default_factory=dict)
    evaluations: dict[str, int] = field(default_factory=dict)
    candidates: tuple[Candidate, ...] = ()
    fallback: Fallback | None = None

    def entry(self, work: Work, sampling: Tabled, indices: Tabled, curves: Sequence[Tabled]) -> Fields:
        """Which model answered, what it took, and what cheaper ones, or tables, saved."""
        names = ("error", "worst", "correlation", "cost", "fits", "mixed_error", "fallback_share")
        ledger, share, saved = work.ledger, None, table_saved((sampling, indices, *curves))
        if self.fallback is not None:
            spared = ledger.evaluations.get(self.chosen, 0) - self.evaluations.get(self.chosen, 0)
            rows, cut, text = spared + ledger.fallback, 0.0, "nothing was evaluated after the pilot"
            if rows:
                cost = {c.fidelity: c.cost for c in self.candidates}[self.chosen]
                share, cut = ledger.fallback / rows, 1.0 - (ledger.fallback + spared * cost) / rows
                text = f"{spared:,} evaluations of full are spared, {100.0 * cut:.0f} % of the cost after the pilot"
            saved = {"full_evaluations": spared if rows else 0, "cost_share": cut, "text": text}
        return {
            "chosen": self.chosen,
            "why": self.why,
            "measured_error": self.measured_error,
            "evaluations": dict(ledger.evaluations),
            "failures": sum(ledger.failures.values()),
            "failure_reasons": {str(code): number for code, number in sorted(ledger.failures.items())},
            "numbers": self.numbers,
            "considered": {c.fidelity: {name: getattr(c, name) for name in names} for c in self.candidates},
            "fallback_share": share,
            "control": table_entry(sampling, indices, curves),
            "saved": saved,
            "undecided": ledger.undecided,
        }


#: share of the strengths above the hardness that is told, and beyond which breaking is doubtful, and out of reach
_REACH = (0.01, 0.5, 0.99)


def allowed_error(study: Study) -> float:
    """Largest error of a fidelity, over the standard deviation, that the study's accuracy allows."""
    asked = study.analysis.accuracy
    return SHARE * min(asked.mean, asked.quantile, asked.sobol, asked.probability)


def differences(other: Answers, full: Answers, quantities: tuple[str, ...], scatter: Array) -> Array:
    """Differences of two models over the standard deviation, (n, q); NaN where one has no answer.

    An answer that outlasts the record in one model alone is off by at least one standard deviation.
    """
    columns = []
    good = is_answered(full.status) & is_answered(other.status)
    none = np.zeros(len(good), dtype=bool)
    for name, sd in zip(quantities, scatter, strict=True):
        gap = other.values[name] - full.values[name]
        with np.errstate(all="ignore"):
            gap = np.where(gap == 0.0, 0.0, gap / sd)
        unlike = other.censored.get(name, none) != full.censored.get(name, none)
        gap = np.where(unlike, np.copysign(np.maximum(np.abs(gap), 1.0), gap), gap)
        columns.append(np.where(good, gap, np.nan))
    return np.stack(columns, axis=1)


def _summary(gaps: Array, quantities: tuple[str, ...], how: str = "rms") -> dict[str, float | None]:
    """Root mean square, or largest, of the differences (n, q) by quantity; None where there is none."""
    known = gaps[~np.isnan(gaps).any(axis=1)]
    if len(known) == 0:
        return dict.fromkeys(quantities)
    found = np.sqrt(np.mean(known**2, axis=0)) if how == "rms" else np.abs(known).max(axis=0)
    return {name: finite(value) for name, value in zip(quantities, found, strict=True)}


def _passes(errors: Mapping[str, float | None], bound: float) -> bool:
    return all(error is not None and error < bound for error in errors.values())


def _worst(errors: Mapping[str, float | None]) -> float:
    found = [np.inf if e is None else e for e in errors.values()]
    return max(found, default=0.0)


def row_cost(answers: Answers) -> float:
    """Mean cost of a row in steps of the integrator, drawing the row included."""
    steps = float(np.mean(answers.steps))
    return START_STEPS + steps if steps > 0.0 else CLOSED_STEPS


def _correlation(cheap: Array, full: Array) -> float | None:
    if not cheap.size:  # every compared row failed
        return None
    x, y = cheap - cheap.mean(), full - full.mean()
    xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
    return xy / float(np.sqrt(xx * yy)) if xx > 0.0 and yy > 0.0 else None


def _candidate(
    fidelity: str, cheap: Answers, full: Answers, scene: Scene, work: Work, scatter: Array, cost: float
) -> Candidate:
    """What the compared rows say of a cheaper fidelity, alone and mixed with `full`."""
    quantities, bound = work.quantities, allowed_error(work.study)
    gaps = differences(cheap, full, quantities, scatter)
    known: Flags = np.asarray(~np.isnan(gaps).any(axis=1))
    error = _summary(gaps, quantities)
    alone = Candidate(
        fidelity=fidelity,
        error=error,
        worst=_summary(gaps, quantities, "largest"),
        correlation={name: _correlation(cheap.values[name][known], full.values[name][known]) for name in quantities},
        cost=cost,
        fits=_passes(error, bound),
    )
    fallback = _error_law(alone, gaps, scene, bound)
    if fallback is None:
        return alone
    judged = np.arange(len(known)) >= len(known) // 2
    by_full = fallback.doubtful(scene) | ~known
    mixed = np.where(by_full[:, None], 0.0, gaps)
    return replace(
        alone,
        mixed_error=_summary(mixed[judged], quantities),
        fallback_share=float(by_full[judged].mean()),
        fallback=fallback,
    )


def _error_law(alone: Candidate, gaps: Array, scene: Scene, bound: float) -> Fallback | None:
    """Which rows to leave to `full`, by a law fitted to one half of the rows; None if the other half contradicts it."""
    known: Flags = np.asarray(~np.isnan(gaps).any(axis=1))
    half = np.arange(len(known)) < len(known) // 2
    mu, theta = scene.scales.mass_number, scene.scales.pulse_number
    if (known & half).sum() < 8 or not np.isfinite(gaps[known]).all():
        return None
    law, masses, pulses = fit_error_law(mu[known & half], theta[known & half], gaps[known & half])
    anything = Fallback(coefficients=law, bounds=(np.inf,) * len(law), mass_range=masses, pulse_range=pulses)
    said = anything.estimate(scene)
    beyond: Flags = np.asarray((np.abs(gaps) > said).any(axis=1))
    if beyond[known & ~half].mean() > BROKEN:
        return None
    if alone.fits:
        # it serves by itself: only rows that look worse than any of the pilot's are left to `full`
        return replace(anything, bounds=tuple(float(value) for value in said[known].max(axis=0)))
    for factor in ROW_BOUNDS:
        some = replace(anything, bounds=(factor * bound,) * len(law))
        rest = np.where(some.doubtful(scene)[:, None], 0.0, gaps)[known & half]
        if np.sqrt(np.mean(rest**2, axis=0)).max() <= USED_UP * bound:
            return some
    return some


def _choose(candidates: Sequence[Candidate], bound: float) -> Candidate | None:
    """The cheapest that passes the rule, alone or mixed with `full`."""
    served = [c for c in candidates if c.mixed_cost <= WORTHWHILE and (c.fits or c.mixes(bound))]
    return min(served, key=lambda c: c.mixed_cost) if served else None


def _own_error(work: Work, few: Scene, full: Answers, scatter: Array) -> Mapping[str, float | None]:
    """What the full model is off by at its tolerance, by quantity: beside one a hundred times closer."""
    tolerance = max(1e-12, 0.01 * work.study.model.tolerance)
    closer = solved(work, "pilot.full", few, work.quantities, tolerance=tolerance)
    return _summary(differences(full, closer, work.quantities, scatter), work.quantities)


def _tried(study: Study, count: int) -> list[str]:
    """The cheaper fidelities that so many points compare: that which is asked for, or all by enough points."""
    asked = study.model.fidelity
    enough = count >= (PILOT.least if asked == "auto" else 2)
    return [fidelity for fidelity in cheaper_fidelities(study) if enough and asked in (fidelity, "auto")]


def first_look(work: Work) -> Pilot:
    """Evaluate a pilot sample with the full model, compare what is cheaper, and choose.

    A cheaper fidelity is taken when its error over the quantity's standard deviation is below a fifth of the
    tightest accuracy that the study asks for, in every quantity asked for; where that holds in some rows alone,
    and an error law tells which, the other rows are left to `full`, row by row.
    """
    study = work.study
    if study.black_box:
        return Pilot(chosen="black box", why="the model is the user's own")
    inputs = work.all_inputs.only(work.scene_names)
    count = pilot_points(study.analysis.budget.evaluations) if work.scene_names else 1
    points = draw(inputs, seed=study.seed, task="pilot", start=0, count=count, replicates=1)
    values = {name: points.input(name)[0] for name in work.scene_names}
    scene, half = scene_of(study, values, count), max(count // 2, 1)
    few = scene_of(study, {name: column[:half] for name, column in values.items()}, half)
    full = solved(work, "pilot.full", scene, all_with(scene, work.quantities))
    same = full.at(slice(half))
    scatter = np.array([_scatter(full, name) for name in work.quantities])
    asked, bound = study.model.fidelity, allowed_error(study)
    candidates = []
    for fidelity in _tried(study, count):
        cheap = solved(work, f"pilot.{fidelity}", few, work.quantities, fidelity=fidelity)
        candidates.append(_candidate(fidelity, cheap, same, few, work, scatter, row_cost(cheap) / row_cost(full)))
    taken = _choose(candidates, bound) if asked == "auto" else None
    chosen = taken.fidelity if taken else asked.replace("auto", "full")
    measured: Mapping[str, float | None] = {}
    if taken:
        measured = taken.told_error
    elif chosen != "full":
        measured = candidates[0].error if candidates else {}
    elif count > 1:
        measured = _own_error(work, few, same, scatter)
    return Pilot(
        chosen=chosen,
        why=_why(asked, chosen, taken, measured, candidates, bound),
        measured_error=dict(measured),
        validity=[*check_table(scene, full, work.quantities), *out_of_reach(study, scene)],
        numbers=_numbers(scene),
        evaluations=dict(work.ledger.evaluations),
        candidates=tuple(candidates) if asked == "auto" else (),
        fallback=taken.fallback if taken else None,
    )


def solved(
    work: Work, key: str, scene: Scene, quantities: tuple[str, ...] | None, *, fidelity: str = "full",
    tolerance: float | None = None,
) -> Answers:  # fmt: skip
    """Answers of a scene, from the store if it was asked before, and counted as evaluations."""
    tolerance = work.study.model.tolerance if tolerance is None else tolerance
    evaluations, threads = work.ledger.evaluations, work.threads
    evaluations[fidelity] = evaluations.get(fidelity, 0) + len(scene)
    about = [fidelity, scene.contact_law, scene.contact_dynamics, tolerance, quantities]
    return remembered(
        work.store, key, scene, about,
        lambda: solve_scene(scene, fidelity, tolerance=tolerance, threads=threads, quantities=quantities),
    )  # fmt: skip


def _scatter(full: Answers, name: str) -> float:
    known = full.values[name][is_answered(full.status)]
    return float(np.std(known)) if len(known) > 1 else 0.0


def _numbers(scene: Scene) -> dict[str, float]:
    """Medians of the numbers that tell one scene from another; no pulse number where the pulse never ends."""
    scales = scene.scales
    found = {
        "mu_median": scales.mass_number,
        "theta_median": scales.pulse_number if scene.rig == "bars" and scene.shape != "step" else None,
        "P_0_median": scales.force,
        "t_c_median": scales.time,
    }
    return {name: float(np.nanmedian(column)) for name, column in found.items() if column is not None}


def _why(
    asked: str,
    chosen: str,
    taken: Candidate | None,
    measured: Mapping[str, float | None],
    candidates: Sequence[Candidate],
    bound: float,
) -> str:
    """Why a fidelity was taken, in a clause."""
    if asked != "auto":
        return f"the study asks for {asked}"
    if not measured:
        return "nothing is random, so there is no scatter to compare the error of a cheaper model with"
    if taken and taken.fallback_share > 0.0:
        return (
            f"its error on the pilot sample, {_worst(measured):.2g} of the standard deviation, is below the "
            f"{bound:.2g} that the accuracy asked for allows once rows whose estimated error is larger are left to "
            f"full ({100.0 * taken.fallback_share:.0f} % of them)"
        )
    if taken:
        return (
            f"its error on the pilot sample, {_worst(measured):.2g} of the standard deviation, is below "
            f"the {bound:.2g} that the accuracy asked for allows"
        )
    tried = ", ".join(f"{c.fidelity} {_worst(c.error):.2g}" for c in candidates)
    if close := [c for c in candidates if c.fits]:
        costs = ", ".join(f"{c.fidelity} {_worst(c.error):.2g} at {100.0 * c.cost:.0f} % of the cost" for c in close)
        return f"no cheaper model that is accurate enough saves much ({costs})"
    return (
        f"the cheaper models err by more than the {bound:.2g} standard deviations that the accuracy allows "
        f"(worst quantity on the pilot sample: {tried})"
    )


def check_table(scene: Scene, answers: Answers, quantities: tuple[str, ...]) -> list[CheckEntry]:
    """Every validity check of a batch."""
    from uqsphere.mechanics.validity import check_ranges, check_validity

    return [CheckEntry.of(row) for row in (*check_validity(scene, answers), *check_ranges(scene, answers, quantities))]


def out_of_reach(study: Study, scene: Scene) -> list[CheckEntry]:
    """A strength that is a true pressure above the hardness, which no pressure exceeds; none where nothing yields.

    Of the limit most of whose strengths are such; a warning or a failure where the sphere is meant to break.
    """
    limits = [limit for limit in study.limits if limit.quantity in ("p_max", "first_peak", "p_mean")]
    if not isinstance(scene.faces, Face) or not limits:
        return []
    hardness = scene.faces.hardness[scene.status == 0]

    def above(limit: Limit) -> float:
        strength = limit.strength
        beyond = strength.sf(hardness) if isinstance(strength, Law) else np.asarray(strength > hardness, dtype=float)
        return float(np.mean(beyond)) if len(hardness) else 0.0

    worst = max(limits, key=lambda limit: (limit.aim == "break") + above(limit))
    share = above(worst)
    grade = np.searchsorted(_REACH if worst.aim == "break" else _REACH[:1], share)
    shares = [float(grade == k) for k in (1, 2, 3)]
    said = f"{100.0 * share:.3g} % of the strengths of {worst.name} lie above the hardness, which no pressure exceeds"
    return [CheckEntry(check="reachable", share=shares[1] + shares[2], share_information=shares[0],
                       share_warning=shares[1], share_failure=shares[2], worst=share, text=said)]  # fmt: skip
