"""What is kept of a run: results.json, the tables, and the page."""

import contextlib
import math
import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from uqsphere.arrays import Array, Cells
from uqsphere.mechanics.failure_modes import mode_name
from uqsphere.mechanics.rigs import RIGS
from uqsphere.models.model import Model
from uqsphere.models.scene import onset_of
from uqsphere.quantities import display_unit, format_probability, format_value, lookup
from uqsphere.results.answers import answers_csv, csv_text
from uqsphere.results.folder import write_files
from uqsphere.results.paper import paper_of
from uqsphere.results.types import (
    AccuracyEntry,
    Answer,
    CheckEntry,
    Decision,
    DependenceEntry,
    FreeNumber,
    InputEntry,
    LimitEntry,
    QuantityEntry,
    Reached,
    Results,
    Shortfall,
    Strength,
    StudyEntry,
)
from uqsphere.study import Limit, Study
from uqsphere.uq import Dependence, Law

from .checks import Check
from .design import Design, demands_of, number_of_tests
from .failure_modes import breaks_by, means_fracture
from .limits import state_of
from .quantities import density
from .tables import Slow, Tables

#: rows of samples.csv
MOST_ROWS = 16_384
#: model runs that an expansion is compared with
MOST_HELD_OUT = 160
PACKAGES = [
    "numpy",
    "scipy",
    "numba",
    "pandas",
    "chaospy",
    "SALib",
    "pydantic",
    "matplotlib",
]


def results_of(
    tables: Tables,
    answers: list[Answer],
    decisions: list[Decision],
    checks: Sequence[Check],
    model: Model,
    seconds: float,
) -> Results:
    """What results.json holds, after so many seconds."""
    design = tables.design
    study = design.study
    return Results(
        study=StudyEntry(
            title=study.title,
            hash=study.hash,
            kind="black box" if study.black_box else study.rig,
            seed=study.seed,
            description=_description(design),
            free=free_number_of(tables),
            overrides=list(study.overrides),
            warnings=list(study.warnings),
            quantities={name: _quantity(tables, name) for name in design.described},
            limits={
                limit.name: _limit(
                    limit,
                    assumed=False,
                    source="study",
                    test_points=_test_points(tables, limit),
                )
                for limit in design.limits
            },
            modes={
                mode.called: _limit(
                    mode.limit,
                    assumed=True,
                    source=mode.entry.source,
                    source_checked=mode.entry.seen,
                )
                for mode in design.modes
            },
            not_judged=design.not_judged,
            dependence=[_dependence(tie) for tie in study.dependence],
        ),
        inputs={name: _input(study, name) for name in (*study.fixed, *design.variables)},
        answers=answers,
        decisions=decisions,
        evidence=design.evidence,
        checks=[CheckEntry(**check.model_dump(exclude={"failures"})) for check in checks],
        paper=paper_of(study),
        accuracy=AccuracyEntry(
            required=study.analysis.accuracy.model_dump(),
            reached=[Reached(runs=runs, error=error) for runs, error in tables.reached],
            stopped=tables.stopped,
            inaccurate=[Shortfall(**answer._asdict()) for answer in tables.inaccurate],
            runs=model.runs,
            reused=model.reused,
            seconds=seconds,
        ),
        versions=versions(),
    )


def _description(design: Design) -> list[str]:
    """What was studied, in two lines: rock, size and rig; strength with its tests."""
    study = design.study
    if study.black_box:
        names = ", ".join(study.outputs)
        first = f"Black box of {len(study.fixed) + len(study.random)} inputs: {names}"
    else:
        rock = study.materials.get("sphere", "").replace("_", " ") or "sphere"
        size = f"{2e3 * study.at_means()['sphere.radius']:.3g} mm"
        scatter = ", ".join(lookup(name).meaning for name in study.random) or "nothing"
        rock = f"{rock[:1].upper()}{rock[1:]}"
        first = f"{rock}, {size}, {RIGS[study.rig].title}; random inputs: {scatter}"
    strengths = []
    for limit in design.limits:
        text = f"{limit.name}: {_strength_text(limit)}"
        tests = number_of_tests(limit.strength)
        if tests:
            text += f" from {tests} tests"
        strengths.append(text)
    if not strengths:
        return [first, "No strength: distributions and sensitivity only"]
    return [first, "Strength " + "; ".join(strengths)]


def free_number_of(tables: Tables) -> FreeNumber | None:
    """The free number of a study's margins, as the results have it."""
    design = tables.design
    margins = design.study.margins
    if not margins:
        return None
    low, *_, high = tables.line or margins.between
    meaning = lookup(margins.solve).called
    if margins.limit:
        meaning = f"strength of {margins.limit}"
    return FreeNumber(
        path=margins.solve,
        quantity=design.free_quantity,
        meaning=meaning,
        planned=design.planned,
        low=low,
        high=high,
        unit=display_unit(design.free_quantity)[0],
    )


def _quantity(tables: Tables, name: str) -> QuantityEntry:
    values = tables.values(name)
    finite = values[np.isfinite(values)]
    answers = tables.described(name).quantiles

    def quantile(p: float) -> float:
        answer = answers.get(p)
        if answer and answer.value is not None:
            return answer.value
        if not finite.size:
            return math.nan
        return float(np.quantile(finite, p))

    left = pairs = None
    if name in tables.expansions:
        expansion = tables.expansions[name]
        left = expansion.left
        pairs = _some(tables.sample.answer(name)[1:], expansion.values)
    elif isinstance(tables, Slow) and tables.predicted:
        response = tables.responses[name]
        left = response.error
        pairs = _some(response.outputs, response.levels)
    return QuantityEntry(
        meaning=lookup(name).meaning,
        unit=display_unit(name)[0],
        range=(quantile(0.05), quantile(0.5), quantile(0.95)),
        method_of_indices=tables.index_method(name),
        density=density(values),
        onset=onset_of(tables.design.study) if name == "p_max" else None,
        expansion_error=left,
        held_out=pairs,
    )


def _some(outputs: Array, predicted: Array) -> list[list[float]]:
    """Outputs of some model runs, and what an expansion that was not fitted to them predicts."""
    pairs = np.stack([outputs.ravel(), predicted.ravel()])
    chosen = pairs[:, :: max(pairs.shape[1] // MOST_HELD_OUT, 1)][:, :MOST_HELD_OUT]
    return [[float(f"{number:.5g}") for number in row] for row in chosen]


def _limit(limit: Limit, **origin: Any) -> LimitEntry:
    """A limit with the `origin` of its strength."""
    tested = limit.tested
    platens = ""
    # how the strength of tested spheres follows their size, and the rate of loading
    size_law = []
    if tested:
        follows = lookup(limit.quantity).called
        if tested.forces:
            follows = "force"
            platens = "rigid platens"
            modulus = tested.platens[0]
            if math.isfinite(modulus):
                platens = f"platens with E = {1e-9 * modulus:.3g} GPa"
        if tested.exponent:
            size_law.append(f"{follows} at failure ~ diameter^{tested.exponent:.3g}")
    if "rate_0" in limit.parameters:
        size_law.append(f"doubled at a strain rate of {limit.parameters['rate_0']:.3g} 1/s")
    return LimitEntry(
        mode=mode_name(breaks_by(limit)),
        quantity=limit.quantity,
        aim=limit.aim,
        target=limit.target,
        has_target=limit.has_target,
        allowable=limit.allowable,
        criterion=limit.criterion,
        fracture=means_fracture(limit),
        tests=number_of_tests(limit.strength),
        strength=_strength(limit),
        platens=platens,
        size_law=", ".join(size_law),
        **origin,
    )


def _test_points(tables: Tables, limit: Limit) -> list[list[float]] | None:
    """Tests of a limit along the free number: values, shares broken, and 1 for right-censored ones.

    A test lies where the median demand is what its specimen bore; its share is that of Kaplan and
    Meier, in the middle of its step.  Tests beyond the range of the free number are left out.  None
    for a strength without tests, and without [margins].
    """
    from scipy.stats import CensoredData, ecdf

    law = limit.resistance
    if not isinstance(law, Law) or not law.data or len(tables.line) < 2:
        return None
    strengths = np.array([*law.data, *law.censored])
    stopped = np.arange(len(strengths)) >= len(law.data)
    held = ecdf(CensoredData(uncensored=law.data, right=law.censored)).sf
    demands = np.array([np.nanmedian(demands_of(limit, rows)) for rows in tables.line.values()])
    if not (np.isfinite(demands).all() and (np.diff(demands) > 0.0).all() and demands[0] > 0.0):
        return None
    along = np.interp(np.log(strengths), np.log(demands), [*tables.line], np.nan, np.nan)
    before = np.nextafter(strengths, -np.inf)
    shares = 1.0 - 0.5 * (held.evaluate(before) + held.evaluate(strengths))
    points = np.array([along, shares, stopped])
    shown: list[list[float]] = points[:, np.isfinite(along)].tolist()
    if not shown[0]:
        return None
    return shown


def _strength(limit: Limit) -> Strength:
    law = limit.strength
    density = None
    if isinstance(law, Law):
        low, p05, median, p95, high = law.ppf([0.001, 0.05, 0.5, 0.95, 0.999]).tolist()
        if not law.is_steps:
            places = np.linspace(low, high, 160)
            density = [places.tolist(), law.pdf(places).tolist()]
    else:
        p05 = median = p95 = law
    return Strength(
        text=_strength_text(limit),
        unit=display_unit(limit.quantity)[0],
        median=median,
        p05=p05,
        p95=p95,
        density=density,
    )


def _strength_text(limit: Limit) -> str:
    law = limit.strength
    if not isinstance(law, Law):
        return format_value(law, limit.quantity)
    mean = law.mean()
    text = f"{law.called.capitalize()}, mean {format_value(mean, limit.quantity)}"
    if law.family.name == "weibull" and "modulus" in law.parameters:
        text += f", modulus {law.parameters['modulus']:.3g}"
    elif mean:
        text += f", scatter {format_probability(law.sd() / abs(mean))}"
    return text


def _dependence(tie: Dependence) -> DependenceEntry:
    text = tie.text
    if tie.copula != "gaussian":
        text += f", Student t copula of {tie.dof:g} degrees of freedom"
    return DependenceEntry(of=list(tie.of), text=text)


def _input(study: Study, name: str) -> InputEntry:
    law = study.laws().get(name)
    source, checked = study.source_of(name)
    if not law:
        mean = p05 = p95 = study.fixed[name]
        sd = 0.0
        distribution = "fixed"
    else:
        mean = law.mean()
        sd = law.sd()
        distribution = _distribution_text(law, name)
        p05, p95 = law.ppf([0.05, 0.95]).tolist()
    return InputEntry(
        meaning=lookup(name).meaning,
        unit=display_unit(name)[0],
        source=source,
        source_checked=checked,
        mean=mean,
        sd=sd,
        p05=p05,
        p95=p95,
        fixed=law is None,
        distribution=distribution,
    )


def _distribution_text(law: Law, name: str) -> str:
    """The family with what mean and standard deviation leave open: shapes and bounds."""
    parts = [law.called]
    for key in ("modulus", "shape", "dof"):
        if key in law.parameters:
            parts.append(f"{key} {law.parameters[key]:.3g}")
    ends = [format_value(end, name) for end in law.ends]
    if len(ends) == 2:
        parts.append(" to ".join(ends))
    elif math.isfinite(law.lower):
        parts.append(f"from {ends[0]}")
    elif ends:
        parts.append(f"up to {ends[0]}")
    return ", ".join(parts)


def versions() -> dict[str, str]:
    """Versions of Python, of this package and of those that it computes with."""
    from uqsphere import __version__

    numbers = {"python": platform.python_version(), "uqsphere": __version__}
    for name in PACKAGES:
        with contextlib.suppress(PackageNotFoundError):
            numbers[name] = version(name)
    return numbers


def samples_of(tables: Tables) -> dict[str, Cells]:
    """Inputs, columns, and a strength of every row, of up to `MOST_ROWS` rows; SI units."""
    design = tables.design
    sample = tables.rows
    head = sample.head(MOST_ROWS // sample.replicates)
    table: dict[str, Cells] = {name: head.input(name).ravel() for name in head.names}
    generator = design.generator("strengths of samples")
    for limit in design.limits:
        state = state_of(design, limit, head)
        if isinstance(state.strength, Law):
            drawn = state.tie.score_at(generator.standard_normal(state.demands.shape))
            table[limit.strength_name] = state.strength.from_normal(drawn).ravel()
    table |= {name: head.outputs(name) for name in head.quantities}
    if head.censored.any():
        table["censored"] = head.censored.any(axis=2).ravel()
    return table


def cells_of(column: Cells) -> list[Any]:
    """A column as cells of a table: a number that is not known is left empty."""
    cells = column.astype(object)
    cells[np.isnan(column)] = None
    return [*cells]


def write_run(folder: Path, study: Study, results: Results, samples: dict[str, Cells]) -> None:
    """Keep a run in its folder, with its page."""
    files: dict[str, str | bytes] = {
        "study.toml": study.text,
        **{f"files/{name}": path.read_bytes() for name, path in study.files if path.is_file()},
        "results.json": results.to_json(),
        "answers.csv": answers_csv(results.answers),
        "samples.csv": csv_text(samples, zip(*map(cells_of, samples.values()), strict=True)),
    }
    from uqsphere.report import page_files

    try:
        files |= page_files(results, [*files])
    except Exception:
        write_files(folder, files, study.scene)  # a fault of a figure costs no results
        raise
    write_files(folder, files, study.scene)
