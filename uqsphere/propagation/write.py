"""What is kept of a run: results.json, the tables, and the page."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.mechanics.failure_modes import mode_name
from uqsphere.mechanics.rigs import RIGS
from uqsphere.models.model import Model
from uqsphere.propagation.checks import Check
from uqsphere.propagation.design import Design
from uqsphere.propagation.distributions import MOST_MANY, density, many_values
from uqsphere.propagation.failure_modes import breaks_by, means_fracture
from uqsphere.propagation.fragility import planned_value
from uqsphere.propagation.indices import method_of
from uqsphere.propagation.limits import state_of
from uqsphere.propagation.tables import Tables
from uqsphere.quantities import display_unit, format_probability, format_value, lookup
from uqsphere.results import Answers, Run
from uqsphere.results.answers import as_json, frame_of
from uqsphere.results.folder import write_files
from uqsphere.study import Limit, Study
from uqsphere.uq import Law, random_generator
from uqsphere.uq.fitting import count_tests, is_fitted

if TYPE_CHECKING:
    import pandas as pd

#: rows of samples.csv
MOST_ROWS: Final = 16_384
PACKAGES: Final = (
    "numpy",
    "scipy",
    "numba",
    "pandas",
    "chaospy",
    "SALib",
    "pydantic",
    "matplotlib",
)


def results_of(
    design: Design,
    tables: Tables,
    answers: Answers,
    judged: dict[str, Any],
    checked: Sequence[Check],
    model: Model,
    seconds: float,
) -> dict[str, Any]:
    """results.json as a dictionary (docs/study-file.md, "Results")."""
    study = design.study
    accuracy = study.analysis.accuracy
    return {
        "schema_version": 2,
        "study": {
            "title": study.title,
            "hash": study.hash,
            "kind": "black box" if study.black_box else study.rig,
            "seed": study.seed,
            "description": _description(design),
            "free": _free(design),
            "overrides": list(study.overrides),
            "warnings": list(study.warnings),
            "quantities": {name: _quantity(design, tables, name) for name in design.described},
            "limits": {limit.name: _limit(design, limit) for limit in design.limits},
            "modes": {
                mode.called: {
                    **_limit(design, mode.limit),
                    "assumed": True,
                    "source": mode.source,
                    "source_checked": mode.seen,
                }
                for mode in design.modes
            },
            "not_judged": dict(design.not_judged),
            "dependence": [_dependence(tie) for tie in study.dependence],
        },
        "inputs": {
            name: _input(design, name) for name in (*study.fixed, *study.random, *_factors(design))
        },
        "answers": as_json(answers.rows),
        "verdicts": as_json(judged),
        "checks": [as_json(check.as_dict()) for check in checked],
        "accuracy": {
            "required": {
                name: getattr(accuracy, name)
                for name in ("mean", "quantile", "sobol", "probability")
            },
            "reached": [{"runs": runs, "error": as_json(error)} for runs, error in tables.reached],
            "stopped": tables.stopped,
            "missed": [
                {
                    "subject": m.subject,
                    "answer": m.answer,
                    "required": m.required,
                    "reached": as_json(m.reached),
                }
                for m in tables.inaccurate
            ],
            "runs": model.evaluations + model.reused,
            "reused": model.reused,
            "seconds": round(seconds, 2),
        },
        "versions": _versions(),
    }


def _description(design: Design) -> list[str]:
    """What was studied, in two lines: rock, size and rig; strength with its tests."""
    study = design.study
    if study.black_box:
        first = (
            f"Black box of {len(study.fixed) + len(study.random)} inputs: "
            f"{', '.join(study.outputs)}"
        )
    else:
        means = study.at_means()
        rock = study.materials.get("sphere", "").replace("_", " ") or "sphere"
        size = f"{2e3 * means['sphere.radius']:.3g} mm"
        scatter = ", ".join(lookup(name).meaning for name in study.random) or "nothing"
        sphere = f"{rock[:1].upper()}{rock[1:]}, {size}"
        first = f"{sphere}, {RIGS[study.rig].title}; random inputs: {scatter}"
    strengths = []
    for limit in design.limits:
        tests = _tests(limit)
        strengths.append(
            f"{limit.name}: {_strength_text(limit)}" + (f" from {tests} tests" if tests else "")
        )
    return [
        first,
        "Strength " + "; ".join(strengths)
        if strengths
        else "No strength: distributions and sensitivity only",
    ]


def _free(design: Design) -> dict[str, Any] | None:
    margins = design.study.margins
    if margins is None:
        return None
    path = margins.solve
    return {
        "path": path,
        "meaning": lookup(path).meaning,
        "planned": planned_value(design),
        "low": margins.between[0],
        "high": margins.between[1],
        "unit": display_unit(path)[0],
    }


def _quantity(design: Design, tables: Tables, name: str) -> dict[str, Any]:
    expansion = tables.expansions.get(name)
    if expansion is not None and expansion.left < 1e-3 and tables.sample.count < MOST_MANY:
        values = many_values(design, expansion, tables.sample.count)
    else:
        values = tables.sample.answer(name)
    known = values[np.isfinite(values)]
    ranges = (
        [None] * 3 if not known.size else [float(x) for x in np.quantile(known, [0.05, 0.5, 0.95])]
    )
    return {
        "meaning": lookup(name).meaning,
        "unit": display_unit(name)[0],
        "range": ranges,
        "method_of_indices": method_of(design, tables, name),
        "density": density(values),
    }


def _limit(design: Design, limit: Limit) -> dict[str, Any]:
    law = limit.strength
    strength: dict[str, Any] = {
        "text": _strength_text(limit),
        "unit": display_unit(limit.quantity)[0],
    }
    if isinstance(law, Law):
        p05, median, p95 = (float(x) for x in law.ppf(np.array([0.05, 0.5, 0.95])))
        ends = law.ppf(np.array([0.001, 0.999]))
        places = np.linspace(float(ends[0]), float(ends[1]), 160)
        smooth = not law.is_steps
        strength |= {
            "median": median,
            "p05": p05,
            "p95": p95,
            "density": [places.tolist(), as_json(law.pdf(places))] if smooth else None,
        }
    else:
        strength |= {"median": float(law), "p05": float(law), "p95": float(law), "density": None}
    tests = _tests(limit)
    return {
        "mode": mode_name(breaks_by(limit)),
        "quantity": limit.quantity,
        "aim": limit.aim,
        "target": limit.target,
        "criterion": limit.criterion,
        "fracture": means_fracture(limit),
        "assumed": False,
        "tests": tests,
        "strength": as_json(strength),
        "source": "study",
        "test_points": None,
    }


def _tests(limit: Limit) -> int | None:
    """Number of tests behind a strength, None for one that was not fitted to tests."""
    law = limit.strength
    return count_tests(law) if isinstance(law, Law) and is_fitted(law) else None


def _strength_text(limit: Limit) -> str:
    law = limit.strength
    if not isinstance(law, Law):
        return format_value(float(law), limit.quantity)
    mean, sd = law.mean(), law.sd()
    text = f"{law.family.name.replace('_', ' ').capitalize()}"
    if mean is not None:
        text += f", mean {format_value(mean, limit.quantity)}"
    if law.family.name == "weibull" and "modulus" in law.parameters:
        text += f", modulus {law.parameters['modulus']:.3g}"
    elif mean and sd is not None:
        text += f", scatter {format_probability(sd / abs(mean))}"
    return text


def _dependence(tie: Any) -> dict[str, Any]:
    """Names and text of a dependence."""
    kind, strength = (
        ("Spearman", tie.spearman) if tie.spearman is not None else ("Kendall", tie.kendall)
    )
    copula = (
        "" if tie.copula == "gaussian" else f", Student t copula of {tie.dof:g} degrees of freedom"
    )
    return {"of": list(tie.of), "text": f"{kind}'s rank correlation {strength:g}{copula}"}


def _factors(design: Design) -> list[str]:
    """Random factors on the demands of limits."""
    return [name for name in design.drawn.names if name not in design.study.random]


def _input(design: Design, name: str) -> Any:
    study = design.study
    quantity, source = lookup(name), study.sources.get(name)
    about = {
        "meaning": quantity.meaning,
        "unit": display_unit(name)[0],
        "source": source.source if source else "study",
        "source_checked": source.seen if source else True,
    }
    if name in design.drawn.names:
        law = study.laws()[name]
        low, high = (float(x) for x in law.ppf(np.array([0.05, 0.95])))
        return as_json(
            {
                **about,
                "mean": law.mean(),
                "sd": law.sd(),
                "p05": low,
                "p95": high,
                "fixed": False,
                "distribution": _distribution_text(law, name),
            }
        )
    value = study.fixed[name]
    return as_json(
        {
            **about,
            "mean": value,
            "sd": 0.0,
            "p05": value,
            "p95": value,
            "fixed": True,
            "distribution": "fixed",
        }
    )


def _distribution_text(law: Law, name: str) -> str:
    """The family with what mean and standard deviation leave open: shapes and bounds."""
    parts = [law.family.name.replace("_", " ")]
    parts += [
        f"{key} {law.parameters[key]:.3g}"
        for key in ("modulus", "shape", "dof")
        if key in law.parameters
    ]
    low, high = (
        None if math.isinf(end) else format_value(end, name) for end in (law.lower, law.upper)
    )
    if low and high:
        parts.append(f"{low} to {high}")
    elif low or high:
        parts.append(f"from {low}" if low else f"up to {high}")
    return ", ".join(parts)


def _versions() -> dict[str, str]:
    from uqsphere import __version__

    found = {
        "python": ".".join(str(part) for part in sys.version_info[:3]),
        "uqsphere": __version__,
    }
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def samples_of(design: Design, tables: Tables) -> pd.DataFrame:
    """Inputs, columns, and a strength of every row, of up to `MOST_ROWS` rows; SI units."""
    import pandas as pd

    sample = tables.sample
    count = max(min(sample.count, MOST_ROWS // sample.replicates), 1)
    head = sample.head(count)
    table: dict[str, Any] = {name: head.input(name).ravel() for name in head.names}
    generator = random_generator(seed=design.study.seed, task="strengths of samples")
    for limit in design.limits:
        state = state_of(design, limit, head)
        if isinstance(state.strength, Law):
            drawn = state.score_drawn(generator.standard_normal(state.demands.shape))
            table[f"limits.{limit.name}.strength"] = state.strength.from_normal(drawn).ravel()
    table |= {
        name: np.where(head.lost(name), np.nan, head.answer(name)).ravel()
        for name in head.quantities
    }
    if head.censored.any():
        table["censored"] = head.censored.any(axis=2).ravel()
    return pd.DataFrame(table)


def written(
    folder: Path | None,
    study: Study,
    results: dict[str, Any],
    samples: pd.DataFrame,
    live: dict[str, Any],
) -> Run:
    """The run, kept in its folder with its page where it has one."""
    found = Run(results=results, folder=folder, table=samples, live=live)
    if folder is None:
        return found
    files: dict[str, str | bytes] = {
        "study.toml": study.text,
        **{f"files/{name}": path.read_bytes() for name, path in study.files if path.is_file()},
        "results.json": json.dumps(results, indent=1, allow_nan=False, ensure_ascii=False) + "\n",
        "answers.csv": frame_of(results["answers"]).to_csv(index=False),
        "samples.csv": samples.to_csv(index=False),
    }
    write_files(folder, files)
    from uqsphere.report import write_page

    write_page(folder)
    return found
