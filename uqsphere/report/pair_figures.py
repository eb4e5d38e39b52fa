"""Indices of pairs of inputs as a heat map, and of groups of inputs: who acts together with whom."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.report import canvas
from uqsphere.report.canvas import FAINT, INK, PAPER, Picture
from uqsphere.report.contents import Contents
from uqsphere.report.figures import ranked, slug
from uqsphere.report.index_marks import draw_indices
from uqsphere.report.tables import Table, index_cell
from uqsphere.report.wording import absent_reason, begin, capital, input_name, share_text, short_input, symbol

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["group_figure", "group_finding", "group_table", "pair_figure", "pair_finding", "pair_table"]

#: inputs of a heat map: with more no number can be read
MOST: Final = 10
#: a share below this is no finding, whatever its interval
_LEAST: Final = 0.005


def _pairs(contents: Contents, quantity: str) -> dict[tuple[str, str], Mapping[str, Any]]:
    """Indices of pairs that are known."""
    entry = contents.results["sensitivity"].get(quantity) or {}
    found = {}
    for name, estimate in (entry.get("second") or {}).items():
        a, _, b = name.partition("|")
        if estimate["value"] is not None:
            found[a, b] = estimate
    return found


def pair_figure(contents: Contents, quantity: str) -> Picture | None:
    """Shares of the variance of pairs below the diagonal, of single inputs on it; None where none is known."""
    pairs = _pairs(contents, quantity)
    entry = contents.results["sensitivity"].get(quantity)
    if not pairs or entry is None:
        return None
    taking_part = {name for pair in pairs for name in pair}
    names = [name for name in ranked(entry) if name in taking_part][:MOST]
    if len(names) < 2:
        return None
    with canvas.style():
        figure, (axes,) = canvas.new_figure(1.5 + 0.5 * len(names))
        for row, a in enumerate(names):
            for column, b in enumerate(names[: row + 1]):
                estimate = entry["first"][a] if a == b else pairs.get((a, b)) or pairs.get((b, a))
                if estimate is not None and estimate["value"] is not None:
                    _tile(axes, row, column, estimate, single=a == b, small=len(names) > 6)
        axes.set_xlim(-0.5, len(names) - 0.5)
        axes.set_ylim(len(names) - 0.5, -0.5)
        axes.set_yticks(range(len(names)), [canvas.wrap(f"{k + 1}  {short_input(n)}", 26) for k, n in enumerate(names)])
        axes.set_xticks(range(len(names)), [str(k + 1) for k in range(len(names))])
        axes.tick_params(length=0)
        axes.spines[["left", "bottom"]].set_visible(False)
        axes.set_xlabel(f"share of the variance of {symbol(quantity, 24)}\n(framed: the input alone; others: the pair)")
    return Picture(
        name=slug("pairs", quantity),
        title=f"Which inputs act together on {symbol(quantity)}",
        finding=pair_finding(contents, quantity),
        figure=figure,
    )


def _tile(axes: Axes, row: int, column: int, estimate: Mapping[str, Any], *, single: bool, small: bool) -> None:
    """One square: the deeper the larger the share; its number in the colour that can be read on it."""
    from matplotlib.patches import Rectangle

    share = float(np.clip(estimate["value"], 0.0, 1.0))
    # from the page's own background to blue, so that a dark page has dark small shares
    axes.add_patch(
        Rectangle((column - 0.48, row - 0.46), 0.96, 0.92, facecolor=canvas.BLUE, alpha=0.85 * share**0.5, linewidth=0)
    )
    axes.add_patch(
        Rectangle(
            (column - 0.48, row - 0.46), 0.96, 0.92, fill=False, edgecolor=INK if single else FAINT, linewidth=1.0
        )
    )
    seen = estimate["low"] is not None and estimate["low"] > 0.0
    text = share_text(estimate).replace("less than ", "<").removesuffix(" %").replace("nearly all", "all")
    axes.annotate(
        text if seen or single else "0",
        (column, row),
        ha="center",
        va="center",
        fontsize=7.0 if small else 9.0,
        color=PAPER if share > 0.35 else INK,
    )


def pair_finding(contents: Contents, quantity: str) -> str:
    """Which pair of inputs interacts most, and how much all pairs carry together."""
    entry = contents.results["sensitivity"].get(quantity) or {}
    pairs = _pairs(contents, quantity)
    if not pairs:
        reason = next((absent_reason(e) for e in (entry.get("second") or {}).values()), "")
        return f"Which inputs act together on {symbol(quantity)} is not known: {reason}." if reason else ""
    (a, b), largest = max(pairs.items(), key=lambda item: float(item[1]["value"]))
    seen = {p: e for p, e in pairs.items() if (e["low"] or 0.0) > 0.0 and e["value"] > _LEAST}
    if (a, b) not in seen:
        widest = max(float(e["high"]) for e in pairs.values() if e["high"] is not None)
        return f"No pair of inputs matters: each carries at most {100.0 * max(widest, 0.0):.2g} %."
    words = f"{begin(a, short_input(a))} and {short_input(b)} together carry {share_text(largest)} of the variance"
    text = f"{words} of {symbol(quantity)} beyond what each does alone"
    others = len(seen) - 1
    if not others:
        return text + "; no other pair is seen."
    return (
        text + f"; {others} more pair{'s' if others > 1 else ''} are seen." if others > 1 else text + "; one more is."
    )


def pair_table(contents: Contents, quantity: str) -> Table | None:
    """Indices of pairs with intervals, the largest first."""
    pairs = _pairs(contents, quantity)
    rows = sorted(pairs.items(), key=lambda item: -float(item[1]["value"]))
    if not rows:
        return None
    return Table(
        caption=f"Second-order indices of {symbol(quantity)} with 95 % intervals",
        header=("input", "with", "share of the variance"),
        rows=tuple((input_name(a), input_name(b), index_cell(e)) for (a, b), e in rows),
    )


def _groups(contents: Contents, quantity: str) -> dict[str, Mapping[str, Any]]:
    entry = contents.results["sensitivity"].get(quantity) or {}
    return dict(entry.get("groups") or {})


def group_figure(contents: Contents, quantity: str) -> Picture | None:
    """Closed and total indices of groups of inputs; None where none is known."""
    groups = _groups(contents, quantity)
    names = [n for n, e in (groups.get("total") or {}).items() if e["value"] is not None]
    names.sort(key=lambda n: -float(groups["total"][n]["value"]))
    if not names:
        return None
    figure = draw_indices(
        names,
        {n: canvas.shorten(n, 40) for n in names},
        groups["first"],
        groups["total"],
        f"share of the variance of {symbol(quantity, 24)}",
        ("by themselves (closed)", "with interactions (total)"),
    )
    return Picture(
        name=slug("groups", quantity),
        title=f"What groups of inputs do to {symbol(quantity)}",
        finding=group_finding(contents, quantity),
        figure=figure,
    )


def group_finding(contents: Contents, quantity: str) -> str:
    """Which group of inputs carries most."""
    total = _groups(contents, quantity).get("total") or {}
    known = {n: e for n, e in total.items() if e["value"] is not None}
    if not known:
        reason = next((absent_reason(e) for e in total.values()), "")
        return f"What the groups do is not known: {reason}." if reason else ""
    largest = max(known, key=lambda n: float(known[n]["value"]))
    share = share_text(known[largest])
    return f"Taken together, {canvas.shorten(largest, 60)} carries {share} of the variance of {symbol(quantity)}."


def group_table(contents: Contents, quantity: str) -> Table | None:
    """Indices of groups with intervals."""
    groups = _groups(contents, quantity)
    names = list(groups.get("total") or {})
    if not names:
        return None
    return Table(
        caption=capital(f"indices of groups of inputs, {symbol(quantity)}, with 95 % intervals"),
        header=("group", "by themselves (closed)", "with interactions (total)"),
        rows=tuple(
            (canvas.shorten(n, 60), index_cell(groups["first"][n]), index_cell(groups["total"][n])) for n in names
        ),
    )
