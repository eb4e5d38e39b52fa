"""Families of fragility curves over another number, and the lognormal curve in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from uqsphere.quantities import display_unit
from uqsphere.report import canvas
from uqsphere.report.canvas import BLUE, GREEN, INK, MARKS, ORANGE, PURPLE, RED, SKY, Picture
from uqsphere.report.contents import Contents
from uqsphere.report.decision import lognormal_scores, probability_axis, score, solved_label, x_scale
from uqsphere.report.figures import slug
from uqsphere.report.sections import Table
from uqsphere.report.wording import (
    begin,
    estimate_text,
    input_name,
    limit_name,
    number_text,
    plain_percent,
    rounded,
    symbol,
    value_text,
)
from uqsphere.runner.margins import member_values

__all__ = ["family_figure", "family_finding", "family_name", "family_table", "lognormal_remarks"]

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


def family_finding(contents: Contents, name: str) -> str:
    """How far the values at one half, or the nearest that is known of all, move over the family; else empty."""
    entry = contents.results["margins"][name]
    family, subject = entry["family"], contents.subject(entry["solve"])
    members = sorted(family["members"], key=lambda member: float(member["value"]))
    known = [p for p in members[0]["values"] if all(m["values"].get(p, {}).get("value") is not None for m in members)]
    if len(members) < 2 or not known:
        return ""
    p = min(known, key=lambda p: abs(float(p) - 0.5))
    first, last = members[0], members[-1]
    ends = [m["values"][p] for m in (first, last)]
    apart = ends[0]["high"] < ends[1]["low"] or ends[1]["high"] < ends[0]["low"]
    change = 100.0 * (ends[1]["value"] / ends[0]["value"] - 1.0) if ends[0]["value"] else 0.0
    verb = f"{'rises' if change > 0.0 else 'falls'} by {abs(change):.2g} %" if apart else "does not change visibly"
    at_first, at_last = map(number_text, member_values(family["path"], [first["value"], last["value"]], 3))
    return (
        f"From {at_first} to {at_last} of the {family_name(contents, name)}, the {input_name(entry['solve'])} at which "
        f"{plain_percent(float(p))} exceed {limit_name(name)} {verb}: from {rounded(ends[0], subject)} to "
        f"{rounded(ends[1], subject)}."
    )


def family_figure(contents: Contents, name: str) -> Picture | None:
    """The curves of a family; None where fewer than two could be computed."""
    entry = contents.results["margins"][name]
    family = entry["family"]
    members = [member for member in family["members"] if len(member["curve"]) > 1]
    if len(members) < 2:
        return None
    subject = contents.subject(entry["solve"])
    factor = display_unit(subject)[1]
    from matplotlib.lines import Line2D

    handles = []
    with canvas.style():
        figure, (axes,) = canvas.new_figure(3.7)
        low, high = np.inf, -np.inf
        labels = member_values(family["path"], [member["value"] for member in members], 3)
        for k, (member, label) in enumerate(zip(members, labels, strict=True)):
            curve = np.array(member["curve"], dtype=float)
            inside = np.flatnonzero((curve[:, 1] > 1e-4) & (curve[:, 1] < 1.0 - 1e-4))
            kept = slice(max(inside[0] - 1, 0), inside[-1] + 2) if inside.size else slice(None)
            x, p = curve[kept, 0] * factor, curve[kept, 1]
            low, high = min(low, float(x[0])), max(high, float(x[-1]))
            colour, mark = _COLOURS[k % len(_COLOURS)], MARKS[k % len(MARKS)]
            axes.plot(x, score(p), color=colour)
            # marks at the probabilities asked for alone: those of all curves are to be compared
            asked = [(e["value"] * factor, float(q)) for q, e in member["values"].items() if e["value"] is not None]
            points = np.array([point for point in asked if x[0] <= point[0] <= x[-1]]).reshape(-1, 2)
            axes.plot(points[:, 0], score(points[:, 1]), color=colour, marker=mark, markersize=4.5, linestyle="none")
            handles.append(Line2D([], [], color=colour, marker=mark, markersize=4.5, label=number_text(label)))
        x_scale(axes, np.array([low, high]))
        axes.set_ylim(float(score(1e-3)) - 0.2, float(score(0.999)) + 0.2)
        probability_axis(axes)
        axes.set_xlabel(solved_label(contents, entry["solve"]))
        axes.set_ylabel(
            f"probability that {symbol(contents.results['limits'][name]['quantity'], 24)}\nexceeds the strength"
        )
        axes.legend(
            handles=handles, title=canvas.shorten(input_name(family["path"]), 30), title_fontsize=9.0, loc="upper left"
        )
    title = f"Fragility of {limit_name(name)} over {family_name(contents, name)}"
    return Picture(
        name=slug("fragility-family", name),
        title=title,
        finding=family_finding(contents, name),
        figure=figure,
        header=(family["path"], entry["solve"], "probability", "low", "high"),
        rows=tuple((float(m["value"]), *map(float, point)) for m in members for point in m["curve"]),
    )


def family_table(contents: Contents, name: str) -> Table:
    """The values at the probabilities asked for, and the lognormal curve, of every member."""
    entry = contents.results["margins"][name]
    family, subject = entry["family"], contents.subject(entry["solve"])
    members = family["members"]
    keys = sorted({p for member in members for p in member["values"]}, key=float)
    rows = [
        (
            plain_percent(float(p)),
            *(estimate_text(m["values"][p], subject) if p in m["values"] else "–" for m in members),
        )
        for p in keys
    ]
    fitted = [(member.get("lognormal") or {}).get("dispersion") for member in members]
    rows.append(("dispersion of the lognormal curve", *(estimate_text(found) if found else "–" for found in fitted)))
    name_of = canvas.shorten(family_name(contents, name), 40)
    solved = begin(entry["solve"], input_name(entry["solve"]))
    caption = f"{solved} at which {limit_name(name)} is exceeded, by {name_of}"
    header = ("probability", *map(number_text, member_values(family["path"], [m["value"] for m in members])))
    return Table(caption=caption, header=header, rows=tuple(rows))
