"""A study as it was understood, and the lists of what there is: what `check` and `list` print."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uqsphere.quantities import display_unit, format_value, lookup
from uqsphere.report.format import short
from uqsphere.study import Study
from uqsphere.uq import Law
from uqsphere.uq.fitting import STRENGTHS, count_tests, fit_strength, is_fitted, series_behind


def described(study: Study) -> str:
    """Inputs with their scatter and source, strengths with their tests, and dependences."""
    parts = [f"{study.title}: the study is valid", "", _inputs(study)]
    if study.limits:
        parts += ["", _strengths(study)]
    if study.dependence:
        parts += ["", "\n".join(f"dependence: {', '.join(tie.of)}" for tie in study.dependence)]
    return "\n".join(parts)


def _inputs(study: Study) -> str:
    rows = [("input", "mean", "sd", "5-95 % range", "distribution", "source")]
    numbers: dict[str, float | Law] = {**study.fixed, **study.random}
    for name, value in numbers.items():
        source = study.sources.get(name)
        text = (
            "study"
            if source is None
            else source.source
            if source.seen
            else f"{source.source} (source not checked)"
        )
        if isinstance(value, Law):
            low, high = (float(x) for x in value.ppf(np.array([0.05, 0.95])))
            mean, sd = value.mean(), value.sd()
            rows.append(
                (
                    name,
                    "-" if mean is None else format_value(mean, name),
                    "-" if sd is None else format_value(sd, name, 3),
                    f"{format_value(low, name)} to {format_value(high, name)}",
                    value.family.name.replace("_", " "),
                    text,
                )
            )
        else:
            rows.append((name, format_value(value, name), "-", "-", "fixed", text))
    return table(rows)


def _strengths(study: Study) -> str:
    rows = [
        (
            "strength",
            "tests",
            "range of the tests",
            "distribution",
            "mean",
            "5-95 % range",
            "held against",
        )
    ]
    for limit in study.limits:
        law, name = limit.strength, limit.quantity
        against = short(lookup(name).meaning)
        if not isinstance(law, Law):
            rows.append(
                (limit.name, "-", "-", "fixed", format_value(float(law), name), "-", against)
            )
            continue
        span = " to ".join(format_value(float(x), name) for x in law.ppf(np.array([0.05, 0.95])))
        tests = str(count_tests(law)) if is_fitted(law) else "-"
        ends = (
            f"{format_value(min(law.data), name)} to {format_value(max(law.data), name)}"
            if law.data
            else "-"
        )
        if limit.tested is not None and limit.tested.forces:
            forces, sizes = limit.tested.forces, limit.tested.diameters
            ends = " to ".join(format_value(end, "P_max") for end in (min(forces), max(forces)))
            ends += f" on {1e3 * min(sizes):.3g} to {1e3 * max(sizes):.3g} mm"
        mean = law.mean()
        text = law.family.name.replace("_", " ")
        for key, said in (("modulus", "modulus"), ("log_sd", "sd of the logarithm")):
            if key in law.parameters:
                text += f", {said} {law.parameters[key]:.3g}"
                if law.data:
                    tested = series_behind(law)
                    low, high = fit_strength(
                        tested, STRENGTHS[law.family.name], draws=1000
                    ).shape_interval
                    text += f" ({low:.3g} to {high:.3g})"
        rows.append(
            (
                limit.name,
                tests,
                ends,
                text,
                "-" if mean is None else format_value(mean, name),
                span,
                against,
            )
        )
    return table(rows)


def cost(study: Study) -> str:
    """About how long the first size of a run takes: 64 rows are timed, and multiplied."""
    from uqsphere.models.model import Model
    from uqsphere.propagation.design import Design
    from uqsphere.propagation.grow import first_rows

    first, price = first_rows(study), study.analysis.cost
    if study.black_box:
        long = "" if price is None else f", {first * price:,.0f} s by analysis.cost"
        return (
            f"a run begins with {first:,} model runs{long}; one too slow for its budget has one "
            "design of fewer runs"
        )
    design = Design.of(study)
    with Model(design.judged, threads=1) as model:
        names = design.inputs
        rows = (
            design.points(4).inputs[:, :, : len(names)].reshape(-1, len(names))
            if names
            else np.zeros((1, 0))
        )
        model.evaluate(names, rows, design.columns)
        each = model.seconds_per_row or 0.0
    took = max(first * each, 0.1)
    return (
        f"a run begins with {first:,} model runs, about {took:.1f} s, and doubles them until "
        "accurate"
    )


def table(rows: Sequence[Sequence[str]]) -> str:
    """Rows as columns of text, the first row underlined; the last column is not padded."""
    widths = [max(len(str(row[k])) for row in rows) for k in range(len(rows[0]))]
    lines = [
        "  ".join(str(c).ljust(w) for c, w in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    return "\n".join([lines[0], "-" * min(len(lines[0]), 79), *lines[1:]])


def listing(what: str) -> str:
    """Materials, quantities, criteria or distributions, as `uqsphere list` prints them."""
    if what == "materials":
        from uqsphere.materials import library

        lines = []
        for kind, entries in library().items():
            for name, material in entries.items():
                lines.append(f"{name} ({kind}): {material.title}")
                lines += [
                    f"    {key} {entry.text}  [{entry.source}]"
                    for key, entry in material.properties.items()
                ]
        return "\n".join(lines)
    if what == "quantities":
        from uqsphere.mechanics.outputs import OUTPUTS

        return table(
            [
                ("quantity", "unit", "meaning"),
                *((n, display_unit(n)[0], q.meaning) for n, q in OUTPUTS.items()),
            ]
        )
    if what == "criteria":
        from uqsphere.mechanics.criteria import CRITERIA

        return table(
            [("criterion", "meaning"), *((name, c.meaning) for name, c in CRITERIA.items())]
        )
    from uqsphere.uq.families import FAMILIES

    return table(
        [
            ("distribution", "keys"),
            *((name, ", ".join(getattr(f, "keys", ()))) for name, f in FAMILIES.items()),
        ]
    )
