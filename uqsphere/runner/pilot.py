"""A first look at the scene: which fidelity serves, what the numbers of the scene are, which checks it breaks."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from uqsphere.model import failed, scene_of
from uqsphere.runner.work import Work, draw, sub_inputs
from uqsphere.study import Study

__all__ = ["Pilot", "first_look"]

#: points of the pilot; the comparison with other fidelities and tolerances uses the first of them
POINTS = 512
COMPARED = 128


@dataclass(frozen=True, kw_only=True)
class Pilot:
    """The choice of the model, with what was measured for it, and the validity checks on the pilot sample."""

    chosen: str
    why: str
    measured_error: dict[str, float | None] = field(default_factory=dict)
    validity: list[dict[str, Any]] = field(default_factory=list)
    numbers: dict[str, float] = field(default_factory=dict)
    evaluations: dict[str, int] = field(default_factory=dict)


def _tightest(study: Study) -> float:
    asked = study.analysis.accuracy
    return min(asked.mean, asked.quantile, asked.sobol, asked.probability)


def _errors(other: Any, full: Any, quantities: tuple[str, ...], rows: slice) -> dict[str, float | None]:
    """Root-mean-square difference of two models over the quantity's standard deviation, row by row."""
    errors: dict[str, float | None] = {}
    good = ~failed(full.status[rows]) & ~failed(other.status[rows])
    for name in quantities:
        exact, approximate = full.values[name][rows][good], other.values[name][rows][good]
        scatter = float(np.std(full.values[name][~failed(full.status)])) if (~failed(full.status)).sum() > 1 else 0.0
        difference = float(np.sqrt(np.mean((exact - approximate) ** 2))) if len(exact) else np.inf
        ratio = difference / scatter if scatter > 0.0 else (0.0 if difference == 0.0 else np.inf)
        errors[name] = ratio if np.isfinite(ratio) else None
    return errors


def first_look(work: Work) -> Pilot:
    """Evaluate a pilot sample with the full model, compare what is cheaper, and choose.

    A cheaper fidelity is taken when its error over the quantity's standard deviation is below a fifth of
    the tightest accuracy that the study asks for, in every quantity asked for.
    """
    study = work.study
    if study.black_box:
        return Pilot(chosen="black box", why="the model is the user's own")
    from uqsphere.mechanics import closed_form, dynamics
    from uqsphere.mechanics.validity import check_validity

    inputs = sub_inputs(work.all_inputs, work.scene_names)
    count = POINTS if work.scene_names else 1
    points = draw(inputs, seed=study.seed, task="pilot", start=0, count=count, replicates=1)
    values = {name: points.physical[0, :, k] for k, name in enumerate(work.scene_names)}
    scene = scene_of(study, values, count)
    tolerance = study.model.tolerance
    full = dynamics.solve(scene, fidelity="full", tolerance=tolerance, threads=work.threads)
    evaluations = {"full": count}
    compared = slice(0, min(COMPARED, count))
    few = scene_of(study, {name: column[compared] for name, column in values.items()}, min(COMPARED, count))

    def cheaper(fidelity: str) -> Any:
        evaluations[fidelity] = evaluations.get(fidelity, 0) + len(few)
        if closed_form.closed_form_applies(few, fidelity):
            return closed_form.solve_closed(few, fidelity)
        return dynamics.solve(
            few, fidelity=fidelity, tolerance=tolerance, threads=work.threads, quantities=work.quantities
        )

    bound = 0.2 * _tightest(study)
    asked = study.model.fidelity
    measured: dict[str, dict[str, float | None]] = {}
    for fidelity in ("massless", "linear"):
        if asked in ("auto", fidelity) and count > 1:
            measured[fidelity] = _errors(cheaper(fidelity), full, work.quantities, compared)
    chosen = asked
    if asked == "auto":
        fits = [name for name, errors in measured.items() if all(e is not None and e < bound for e in errors.values())]
        chosen = fits[0] if fits and count > 1 else "full"
    if chosen == "full" and count > 1:
        closer = dynamics.solve(
            few,
            fidelity="full",
            tolerance=max(1e-12, 0.01 * tolerance),
            threads=work.threads,
            quantities=work.quantities,
        )
        evaluations["full"] += len(few)
        measured["full"] = _errors(full, closer, work.quantities, compared)
    numbers = {
        "mu_median": float(np.nanmedian(scene.scales.mass_number)),
        "theta_median": float(np.nanmedian(scene.scales.pulse_number))
        if study.options["pulse.shape"] != "step"
        else None,
        "P_0_median": float(np.nanmedian(scene.scales.force)),
        "t_c_median": float(np.nanmedian(scene.scales.time)),
    }
    return Pilot(
        chosen=chosen,
        why=_why(asked, chosen, measured, bound),
        measured_error=measured.get(chosen, {}),
        validity=[_check(row) for row in check_validity(scene, full)],
        numbers={name: value for name, value in numbers.items() if value is not None},
        evaluations=evaluations,
    )


def _worst(errors: dict[str, float | None]) -> float:
    found = [np.inf if e is None else e for e in errors.values()]
    return max(found, default=0.0)


def _why(asked: str, chosen: str, measured: dict[str, dict[str, float | None]], bound: float) -> str:
    if asked != "auto":
        return f"the study asks for {asked}"
    if not measured.get(chosen):
        return "nothing is random, so there is no scatter to compare the error of a cheaper model with"
    if chosen != "full":
        return (
            f"its error on the pilot sample, {_worst(measured[chosen]):.2g} of the standard deviation, is below "
            f"the {bound:.2g} that the accuracy asked for allows"
        )
    tried = ", ".join(f"{name} {_worst(errors):.2g}" for name, errors in measured.items() if name != "full")
    return (
        f"the cheaper models err by more than the {bound:.2g} of a standard deviation that the accuracy asked for "
        f"allows (worst quantity on the pilot sample: {tried})"
    )


def _check(row: Any) -> dict[str, Any]:
    return {
        "check": row.check,
        "share": row.share_warning + row.share_failure,
        "share_information": row.share_information,
        "share_warning": row.share_warning,
        "share_failure": row.share_failure,
        "worst": row.worst,
        "text": row.text,
    }
