"""A study as it was read, and the lists of what there is: what `check` and `list` print."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from uqsphere.arrays import one_thread
from uqsphere.materials import library
from uqsphere.mechanics.criteria import CRITERIA
from uqsphere.quantities import OUTPUTS, display_unit, format_value
from uqsphere.study import Limit, Study
from uqsphere.uq import Law
from uqsphere.uq.families import FAMILIES
from uqsphere.uq.fitting import STRENGTHS, is_fitted, series_behind

from .format import DASH, meaning, source_text, value, value_range
from .page import render
from .tables import PageTable, Row, columns

#: probabilities of the ends of the range that is printed of a random number
ENDS = np.array([0.05, 0.95])
#: model runs of a trial run, and what its analyses, figures and report take beside model runs [s]
TRIAL_RUNS, REPORT_SECONDS = 1400, 4.0


def described(study: Study) -> str:
    """Inputs with their distribution and source, strengths with their tests, and dependences."""
    lines = [f"{study.title}: the study is valid"]
    inputs, *others = _tables(study)
    sources = dict.fromkeys(row[-1] for row in inputs.rows if row[-1] != "study")
    marks = {source: f"[{number}]" for number, source in enumerate(sources, 1)}
    rows = [(*cells, marks.get(source, source)) for *cells, source in inputs.rows]
    lines += ["", *columns([inputs.head, *rows])]
    lines += [f"{mark} {source}" for source, mark in marks.items()]
    for table in others:
        lines += ["", *columns([table.head, *table.rows])]
    if study.dependence:
        lines += ["", *_ties(study)]
    return "\n".join(lines)


def study_html(study: Study) -> str:
    """Inputs and strengths, for a notebook's cell."""
    title = "; ".join([study.title, *_ties(study)])
    return render("notebook.html", title=title, tables=_tables(study), pictures={})


def _ties(study: Study) -> Iterator[str]:
    for tie in study.dependence:
        yield f"dependence: {', '.join(tie.of)}: {tie.text}"


def _tables(study: Study) -> Iterator[PageTable]:
    """Inputs, and strengths where there are limits."""
    rows = list[Row]()
    for name, number in study.fixed.items():
        source = source_text(*study.source_of(name))
        rows.append((name, format_value(number, name), DASH, DASH, "fixed", source))
    for name, law in study.random.items():
        numbers = (value(law.mean(), name, 4), value(law.sd(), name), _range(law, name))
        rows.append((name, *numbers, law.called, source_text(*study.source_of(name))))
    head = ("input", "mean", "sd", "5-95 % range", "distribution", "source")
    yield PageTable("Inputs", head, rows)
    if study.limits:
        head = ("strength", "tests", "range of the tests", "distribution", "mean", "5-95 % range")
        rows = [_strength(limit) for limit in study.limits]
        yield PageTable("Strengths", (*head, "demand"), rows)


def _range(law: Law, name: str) -> str:
    low, high = law.ppf(ENDS).tolist()
    return value_range(low, high, name)


def _strength(limit: Limit) -> Row:
    """A strength as read: its tests, distribution, mean and range, and what it is held against."""
    law = limit.strength
    name = limit.quantity
    demand = meaning(name)
    if not isinstance(law, Law):
        return limit.name, DASH, DASH, "fixed", format_value(float(law), name), DASH, demand
    tests = str(law.tests) if is_fitted(law) else DASH
    cells = (_shape(law), value(law.mean(), name, 4), _range(law, name))
    return limit.name, tests, _tested(limit, law), *cells, demand


def _tested(limit: Limit, law: Law) -> str:
    """The range of the tests behind a strength: forces on sizes, or values."""
    if limit.tested and limit.tested.forces:
        forces = limit.tested.forces
        sizes = limit.tested.diameters
        ends = value_range(min(forces), max(forces), "P_max")
        return f"{ends} on {1e3 * min(sizes):.3g} to {1e3 * max(sizes):.3g} mm"
    if law.data:
        return value_range(min(law.data), max(law.data), limit.quantity)
    return DASH


def _shape(law: Law) -> str:
    """Family and shape of a strength, with the shape's interval where it was fitted."""
    text = law.called
    for key, word in (("modulus", "modulus"), ("log_sd", "sd of the logarithm")):
        if key in law.parameters:
            text += f", {word} {law.parameters[key]:.3g}"
            if law.data:
                fit = series_behind(law).fit(STRENGTHS[law.family.name], draws=1000)
                low, high = fit.shape_interval
                text += f" ({low:.3g} to {high:.3g})"
    return text


def cost(study: Study) -> str:
    """The expected cost of a whole run, from a short trial run; of a user model, its bounds."""
    from uqsphere.models.model import Model
    from uqsphere.propagation.design import Design
    from uqsphere.propagation.grow import first_count, first_rows, grow
    from uqsphere.propagation.tables import input_rows
    from uqsphere.propagation.verdict import judge

    first = first_rows(study, first_count(study))
    budget = study.analysis.budget
    start = f"A run starts with {first:,} model runs and doubles the sample until it is accurate"
    if study.black_box:
        longest = budget.time
        if study.analysis.cost is not None:
            longest = min(study.analysis.cost * budget.evaluations, longest)
        most = f"at most {budget.evaluations:,} in {longest:,.0f} s (analysis.budget)"
        return f"{start}: {most}. A slow model gets one design of fewer runs."
    few = study.analysis.model_copy(
        update={"budget": budget.model_copy(update={"evaluations": min(TRIAL_RUNS, first)})}
    )
    design = Design.of(replace(study, analysis=few))
    names, rows = input_rows(design.points(4))
    with Model(design.judged, threads=1) as model:  # compiles the integrator, once
        model.evaluate(names, rows, design.columns)
        each = model.seconds_per_row
    began = time.monotonic()
    with one_thread(), Model(design.judged) as model:
        tables = grow(design, model, seconds=budget.time)
        _, tables = judge(model, tables, began + budget.time)
    took = time.monotonic() - began
    runs, error = tables.reached[-1]
    error = max(error, 1.0)
    # the error falls with the runs n as n^(-3/4) or faster
    needed = min(max(runs * error ** (4.0 / 3.0), first), budget.evaluations)
    seconds = took + needed * each + REPORT_SECONDS
    return (
        f"{start}: up to about {float(f'{needed:.2g}'):,.0f} in total, "
        f"{float(f'{seconds:.2g}'):,g} s with analysis and report."
    )


def listing(what: str) -> str:
    """Materials, quantities, criteria or distributions, as `uqsphere list` prints them."""
    if what == "materials":
        return "\n".join(_materials())
    outputs = ((name, display_unit(name)[0], entry.meaning) for name, entry in OUTPUTS.items())
    criteria = ((name, criterion.meaning) for name, criterion in CRITERIA.items())
    families = ((name, law.allowed() or "values, or a file") for name, law in FAMILIES.items())
    rows: dict[str, Sequence[Row]] = {
        "quantities": [("quantity", "unit", "meaning"), *outputs],
        "criteria": [("criterion", "meaning"), *criteria],
        "distributions": [("distribution", "keys"), *families],
    }
    return "\n".join(columns(rows[what]))


def _materials() -> Iterator[str]:
    for name, material in library().items():
        yield f"{name} ({material.kind}): {material.title}"
        for key, entry in material.properties.items():
            yield f"    {key} {entry.text}  [{entry.source}]"
