"""A study as it was read, and the lists of what there is: what `check` and `list` print."""

from collections.abc import Iterator, Sequence

import numpy as np

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
#: what analyses, figures and report take beside model runs [s]
REPORT_SECONDS = 4.0


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
    """With how many model runs a run starts, and what it takes at most; of the impact model also
    how long these runs take, by 64 that are timed.
    """
    from uqsphere.models.model import Model
    from uqsphere.propagation.design import Design
    from uqsphere.propagation.grow import first_count, first_rows
    from uqsphere.propagation.tables import input_rows

    analysis = study.analysis
    most = analysis.budget.evaluations
    longest = analysis.budget.time
    least = first_rows(study)
    if study.black_box and (most < least or (analysis.cost or 0.0) * least > longest):  # `is_slow`
        course = "A run makes one design"
    else:
        first = first_rows(study, first_count(study))
        most = max(most, first)
        course = f"A run starts with {first:,} model runs"
        if study.black_box:
            course += " (or one design of fewer, if these take too long)"
        else:
            design = Design.of(study)
            names, rows = input_rows(design.points(4))  # of each of 16 replicates
            with Model(design.judged) as model:
                for _ in range(2):  # the first time it compiles the integrator
                    model.evaluate(names, rows, design.columns)
            seconds = first * model.seconds_per_row + REPORT_SECONDS
            course += f" (with analysis and report about {float(f'{seconds:.2g}'):g} s)"
        course += " and doubles the sample until it is accurate"
    return f"{course}: at most {most:,} model runs in {longest:,.0f} s (analysis.budget)."


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
