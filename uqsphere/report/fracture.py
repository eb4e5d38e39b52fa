"""Fracture by any limit: the probabilities, which limit comes first, the state it comes in, and the interplay."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.quantities import display_unit, format_value
from uqsphere.report import canvas, event
from uqsphere.report.canvas import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, RED, SKY, Picture
from uqsphere.report.contents import Contents
from uqsphere.report.decision import probability_axis, score, x_scale
from uqsphere.report.figures import axis_label
from uqsphere.report.tables import Table, cell, thousands
from uqsphere.report.wording import (
    absent_reason,
    input_name,
    limit_name,
    listed,
    plain_percent,
    probability_text,
    rounded,
)

__all__ = ["fracture_finding", "fracture_table", "interplay_figure", "interplay_remarks"]

#: what is shown of the state at fracture: words, and a quantity with the same unit
_STATE: Final = {
    "time": ("time of fracture", "contact_time"),
    "force": ("force at fracture", "P_max"),
    "energy": ("energy in both contacts at fracture", "energy"),
    "specific_energy": ("the same per mass of the sphere", "specific_energy"),
    "t10": ("product finer than a tenth of the sphere, t10 from the record's energy", "t10"),
    "imbalance": ("difference of the two forces at fracture, over the larger so far", "force_imbalance"),
}
_SHARES: Final = {"0.05": "5 %", "0.5": "median", "0.95": "95 %"}
_COLOURS: Final = (BLUE, ORANGE, GREEN, PURPLE, SKY, RED)
_STYLES: Final = ("-", "--", "-.", ":")
#: normal scores go so far out that a curve leaves the picture where it would
_FAR: Final = 1e-14
#: high over low beyond which the curve of one limit is not drawn beside that of all
_KNOWN: Final = 4.0
#: smallest probability that is drawn
_LEAST: Final = 1e-6
#: limits that are drawn
MOST_CURVES: Final = 8


def _found(contents: Contents) -> Mapping[str, Any]:
    found: Mapping[str, Any] = contents.results.get("fracture") or {}
    return found


def fracture_finding(contents: Contents) -> str:
    """Whether it breaks, when, by what and in which state, in a few sentences."""
    found = _found(contents)
    union, first = found.get("union"), found.get("first_loading")
    if not union or union["value"] is None:
        return f"No answer: {found.get('reason') or absent_reason(union or {})}."
    text = f"The sphere breaks with a probability of {probability_text(union)} over the record"
    if first and first["value"] is not None:
        text += f", of {probability_text(first)} in the first loading, before the first reflected wave is back"
    parts = [text + "."]
    governed = {n: e for n, e in found.get("governed_by", {}).items() if e["value"]}
    if len(found["limits"]) > 1 and governed:
        ranked = sorted(governed.items(), key=lambda item: -item[1]["value"])
        named = [f"{limit_name(n)} in {plain_percent(e['value'])}" for n, e in ranked]
        parts.append(f"Of the spheres that break, the strength reached first is {listed(named)}.")
    if "time" in found:
        time, force, energy = (rounded(found[key]["median"], _STATE[key][1], 3) for key in ("time", "force", "energy"))
        imbalance = plain_percent(float(f"{found['imbalance']['median']['value']:.2g}"))
        whole = union["value"]
        whom, weakest = "The spheres that break", ""
        if 0.0 < whole < 0.5:
            count = float(f"{1.0 / whole:.2g}")
            whom = f"The spheres that break as planned, one in {thousands(round(count))} and the weakest of all,"
            weakest = ", which is no property of all spheres"
        parts.append(
            f"{whom} do so in the median at {time}, at {force} and {energy} in the contacts{weakest}; the two forces "
            f"then differ by {imbalance}."
        )
    if "t10" in found:
        ends = [rounded(found["t10"]["quantiles"][p], "t10", 3) for p in ("0.05", "0.5", "0.95")]
        parts.append(
            f"Of their mass {ends[1]} is then finer than a tenth of the sphere in the median, {ends[0]} to "
            f"{ends[2]} in nine of ten (t10)."
        )
    if "time" not in found and found.get("reason"):
        parts.append(f"When it breaks is not known: {found['reason']}.")
    again = [n for n in found.get("left_out", ()) if event.breaks(contents.results, n)]
    other = [n for n in found.get("left_out", ()) if n not in again]
    if again:
        parts.append(
            f"The limit {listed([limit_name(n) for n in again])} means the same event with another aim, and is not "
            "counted a second time."
        )
    if other:
        parts.append(f"Limits that mean no fracture are left out: {listed([limit_name(n) for n in other])}.")
    return " ".join(parts)


def fracture_table(contents: Contents) -> Table | None:
    """Probabilities, shares, orders, and the state at fracture."""
    found = _found(contents)
    if not found:
        return None
    several = len(found["limits"]) > 1
    rows = [
        (
            "probability of fracture over the record" + (", by any limit" if several else ""),
            cell(found["union"], probability=True),
        )
    ]
    if "first_loading" in found:
        rows.append(("probability of fracture in the first loading", cell(found["first_loading"], probability=True)))
    if several:
        rows += [
            (f"share of fractures in which {limit_name(name)} is reached first", cell(estimate, probability=True))
            for name, estimate in found.get("governed_by", {}).items()
        ]
        rows += [
            (
                "share in the order " + ", then ".join(limit_name(n) for n in entry["limits"]),
                cell(entry["share"], probability=True),
            )
            for entry in found.get("order", ())
            if len(entry["limits"]) > 1
        ]
    for key, (words, like) in _STATE.items():
        for p, e in found.get(key, {}).get("quantiles", {}).items():
            rows.append((f"{words}, {_SHARES.get(p, p)}", cell(e, like)))
    return Table(
        caption="Fracture, with 95 % intervals; what follows the probabilities is of the spheres that break",
        header=("", "value (95 % interval)"),
        rows=tuple(rows),
    )


def _beside(contents: Contents) -> dict[str, Array]:
    """Curves (K, 4) of the limits within the values of that of fracture by any of them."""
    found, margins = _found(contents), contents.results["margins"]
    lowest, highest = float(found["curve"][0][0]), float(found["curve"][-1][0])
    curves = {
        name: np.array(margins[name]["curve"], dtype=float)
        for name in found["limits"][:MOST_CURVES]
        if len(margins.get(name, {}).get("curve", ())) > 1
    }
    return {n: c[(c[:, 0] >= lowest * 0.999) & (c[:, 0] <= highest * 1.001)] for n, c in curves.items()}


def _hardly_known(curve: Array) -> Flags:
    return np.asarray(curve[:, 3] > _KNOWN * curve[:, 2])


def interplay_remarks(contents: Contents) -> tuple[str, ...]:
    """Where the curve of a limit is left out of the figure for the few rows that it rests on."""
    found = _found(contents)
    if len(found.get("curve", ())) < 2:
        return ()
    told = []
    for name, curve in _beside(contents).items():
        gone = curve[_hardly_known(curve) & (curve[:, 3] > _LEAST), 0]
        if gone.size:
            ends = [format_value(float(end), str(found["solve"]), 3) for end in dict.fromkeys((gone[0], gone[-1]))]
            told.append(f"{limit_name(name)} ({' to '.join(ends)})")
    if not told:
        return ()
    return (f"Not drawn where the few rows of its curve do not tell it to a factor of two: {listed(told)}.",)


def interplay_figure(contents: Contents) -> Picture | None:
    """Probability of exceeding each limit, and of fracture by any, over the free scalar."""
    found = _found(contents)
    if len(found.get("curve", ())) < 2:
        return None
    solve = str(found["solve"])
    factor = display_unit(solve)[1]
    union = np.array(found["curve"], dtype=float)
    here = contents.at_mean(solve)
    lowest, highest = float(union[0, 0]), float(union[-1, 0])
    with canvas.style():
        figure, (axes,) = canvas.new_figure(4.3)
        axes.fill_between(
            union[:, 0] * factor,
            score(union[:, 2], least=_FAR),
            score(union[:, 3], least=_FAR),
            color=GREY,
            alpha=0.35,
            linewidth=0.0,
        )
        axes.plot(
            union[:, 0] * factor,
            score(union[:, 1], least=_FAR),
            color=INK,
            linewidth=3.0,
            alpha=0.55,
            label="any of them",
        )
        for k, (name, curve) in enumerate(_beside(contents).items()):
            axes.plot(
                curve[:, 0] * factor,
                # not known to a factor of two, it may seem to lie above that of any of them
                score(np.where(_hardly_known(curve), np.nan, curve[:, 1]), least=_FAR),
                color=_COLOURS[k % len(_COLOURS)],
                linestyle=_STYLES[k % len(_STYLES)],
                label=canvas.shorten(limit_name(name), 28),
            )
        x_scale(axes, union[:, 0] * factor)
        axes.set_ylim(float(score(_LEAST)), float(score(1.0 - 1e-4)))
        if here is not None and lowest <= here <= highest:
            axes.axvline(here * factor, color=INK, linewidth=0.8, linestyle=":")
            left = axes.transAxes.inverted().transform(axes.transData.transform((here * factor, 0.0)))[0] > 0.3
            axes.annotate(
                "as planned",
                (here * factor, axes.get_ylim()[0]),
                xytext=(-4 if left else 4, 4),
                ha="right" if left else "left",
                textcoords="offset points",
                fontsize=9.0,
            )
        probability_axis(axes)
        axes.legend(loc="upper left")
        word = "mean " if solve in contents.resolved["random"] else ""
        axes.set_xlabel(axis_label(solve, word + canvas.shorten(input_name(solve), 50)))
        axes.set_ylabel("probability of reaching the strength")
    finding = f"Which criterion breaks the sphere, over {input_name(solve)}: {_half(found)}"
    return Picture(name="interplay", title="Interplay of the limits", finding=finding, figure=figure)


def _half(found: Mapping[str, Any]) -> str:
    known = {p: e for p, e in found.get("values", {}).items() if e["value"] is not None}
    parts = [f"{plain_percent(float(p))} at {rounded(e, found['solve'])}" for p, e in known.items()]
    return f"by any of them {', '.join(parts)}." if parts else "no value has the probabilities asked for."
