"""Families of fragility curves over another number, and the lognormal curve in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from uqsphere.quantities import display_unit, format_value
from uqsphere.report import canvas
from uqsphere.report.canvas import BLUE, GREEN, INK, MARKS, ORANGE, PURPLE, RED, SKY, Picture
from uqsphere.report.contents import Contents
from uqsphere.report.decision import lognormal_scores, probability_axis, score, x_scale
from uqsphere.report.figures import axis_label, slug
from uqsphere.report.sections import Table
from uqsphere.report.wording import (
    estimate_text,
    input_name,
    limit_name,
    number_text,
    plain_percent,
    symbol,
    value_text,
)

__all__ = ["family_figure", "family_name", "family_table", "lognormal_remarks"]

_COLOURS = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY, INK)


def lognormal_remarks(contents: Contents, name: str) -> tuple[str, ...]:
    """The lognormal curve and how near it comes, or why there is none."""
    entry = contents.results["margins"][name]
    fitted = entry.get("lognormal")
    if not fitted:
        return ()
    if not fitted.get("median"):
        return (f"No lognormal curve: {fitted.get('reason', 'none was fitted')}.",)
    subject = contents.subject(entry["solve"])
    return (
        f"Dashed: the lognormal curve nearest to it, with the median {estimate_text(fitted['median'], subject)} and "
        f"the dispersion {estimate_text(fitted['dispersion'])}. It is off by at most "
        f"{plain_percent(fitted['largest_gap'])} of all specimens, at {value_text(fitted['largest_gap_at'], subject)}."
        f"{_not_small(entry, subject)}",
    )


def _not_small(entry: Mapping[str, Any], subject: str) -> str:
    """That the lognormal curve does not serve small probabilities, with the first probability it is far off."""
    curve = np.array(entry["curve"], dtype=float)
    off = np.isnan(lognormal_scores(entry, curve[:, :2]))
    far = off & (curve[:, 1] > 1e-6) & (curve[:, 1] < 0.5)
    if not far.any():
        return ""
    k = int(np.flatnonzero(far)[np.argmax(curve[far, 1])])
    return (
        f" Small probabilities must not be read off it: from {plain_percent(float(f'{curve[k, 1]:.2g}'))} down, at "
        f"{value_text(curve[k, 0], subject, 3)}, it is off by more than a factor of two and not drawn."
    )


def family_name(contents: Contents, name: str) -> str:
    """The number over which the curves form a family."""
    return input_name(contents.results["margins"][name]["family"]["path"])


def family_figure(contents: Contents, name: str) -> Picture | None:
    """The curves of a family; None where fewer than two could be computed."""
    entry = contents.results["margins"][name]
    family = entry["family"]
    members = [member for member in family["members"] if len(member["curve"]) > 1]
    if len(members) < 2:
        return None
    subject = contents.subject(entry["solve"])
    factor = display_unit(subject)[1]
    with canvas.style():
        figure, (axes,) = canvas.new_figure(3.7)
        low, high = np.inf, -np.inf
        for k, member in enumerate(members):
            curve = np.array(member["curve"], dtype=float)
            inside = np.flatnonzero((curve[:, 1] > 1e-4) & (curve[:, 1] < 1.0 - 1e-4))
            kept = slice(max(inside[0] - 1, 0), inside[-1] + 2) if inside.size else slice(None)
            x, p = curve[kept, 0] * factor, curve[kept, 1]
            low, high = min(low, float(x[0])), max(high, float(x[-1]))
            label = number_text(format_value(member["value"], family["path"], 3))
            colour, mark = _COLOURS[k % len(_COLOURS)], MARKS[k % len(MARKS)]
            every = max(1, x.size // 6)
            axes.plot(x, score(p), color=colour, marker=mark, markevery=every, markersize=4.5, label=label)
        x_scale(axes, np.array([low, high]))
        axes.set_ylim(float(score(1e-3)) - 0.2, float(score(0.999)) + 0.2)
        probability_axis(axes)
        axes.set_xlabel(axis_label(subject, canvas.shorten(input_name(entry["solve"]), 50)))
        axes.set_ylabel(
            f"probability that {symbol(contents.results['limits'][name]['quantity'], 24)}\nexceeds the strength"
        )
        axes.legend(title=canvas.shorten(input_name(family["path"]), 30), title_fontsize=9.0, loc="upper left")
    title = f"Fragility of {limit_name(name)} over {family_name(contents, name)}"
    return Picture(name=slug("fragility-family", name), title=title, finding="", figure=figure)


def family_table(contents: Contents, name: str) -> Table:
    """The values at the probabilities asked for, and the lognormal curve, of every member."""
    entry = contents.results["margins"][name]
    family, subject = entry["family"], contents.subject(entry["solve"])
    keys = sorted({p for member in family["members"] for p in member["values"]}, key=float)
    rows = []
    for member in family["members"]:
        fitted = member.get("lognormal") or {}
        cells = [estimate_text(member["values"][p], subject) if p in member["values"] else "–" for p in keys]
        dispersion = estimate_text(fitted["dispersion"]) if fitted.get("dispersion") else "–"
        rows.append((value_text(member["value"], family["path"], 4), *cells, dispersion))
    header = (family_name(contents, name), *(plain_percent(float(p)) for p in keys), "dispersion")
    return Table(caption=f"{input_name(entry['solve'])} at probabilities of exceeding", header=header, rows=tuple(rows))
