"""The terminal's summary of a run: the sentence to act on, failure modes, quantities and indices,
in 40 lines.
"""

from __future__ import annotations

import textwrap

from uqsphere.report.format import (
    Results,
    estimate,
    failure_modes,
    find,
    meaning,
    of,
    probability,
    short,
    value,
    verdicts,
)

#: lines at most, and rows of each table
LINES, ROWS = 40, 8


def summary(results: Results, width: int = 79) -> str:
    """The summary as text of at most 40 lines."""
    lines = textwrap.wrap(results["study"]["title"], width)
    for names, verdict in verdicts(results):
        lines += [
            "",
            *textwrap.wrap(f"{names}: {verdict['headline']} {verdict['detail']}".strip(), width),
        ]
        lines += textwrap.wrap(f"Next: {verdict['next']}", width) if verdict["next"] else []
    if modes := _modes(results):
        lines += [
            "",
            *_table(("failure mode", "probability", "beta", "at the target"), modes[:ROWS], width),
        ]
        if any(row[0].endswith("*") for row in modes):
            lines.append("* by a strength of the library, not of this rock")
    lines += ["", *_table(("quantity", "mean", "5-95 % range"), _quantities(results)[:ROWS], width)]
    if indices := _indices(results):
        lines += [
            "",
            *_table(("Sobol' index, total", *results_names(results)), indices[:ROWS], width),
        ]
    if paper := _paper(results):
        lines += ["", *_table(("formula of the paper", "printed", "corrected"), paper, width)]
    accuracy = results["accuracy"]
    error = accuracy["reached"][-1]["error"] if accuracy["reached"] else None
    tail = f"{accuracy['runs']:,} model runs, {accuracy['seconds']:.3g} s"
    if error is not None:
        tail += f", largest error / tolerance {error:.2g} ({accuracy['stopped']})"
    lines += ["", *textwrap.wrap(tail, width)]
    return "\n".join(
        lines if len(lines) <= LINES else [*lines[: LINES - 1], "... the rest is in the report"]
    )


def results_names(results: Results) -> list[str]:
    """Quantities that have indices."""
    return [
        name
        for name in results["study"]["quantities"]
        if of(results["answers"], name, "sobol_total")
    ][:3]


def _modes(results: Results) -> list[tuple[str, ...]]:
    path = (results["study"]["free"] or {}).get("path", "")
    return [
        (
            mode.name.replace(" (assumed)", "*"),
            probability(mode.fracture),
            "–" if mode.index is None else f"{mode.index:.2f}",
            "–" if mode.margin is None else value(mode.margin["value"], path),
        )
        for mode in failure_modes(results)
    ]


def _quantities(results: Results) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for name, entry in results["study"]["quantities"].items():
        low, _, high = entry["range"]
        ends = "–" if low is None else f"{value(low, name)} to {value(high, name)}"
        rows.append(
            (short(entry["meaning"]), estimate(find(results["answers"], name, "mean"), name), ends)
        )
    return rows


def _indices(results: Results) -> list[tuple[str, ...]]:
    names = results_names(results)
    if not names:
        return []
    first = of(results["answers"], names[0], "sobol_total")
    ranked = sorted(first, key=lambda row: -(row["value"] or 0.0))
    rows: list[tuple[str, ...]] = []
    for row in ranked:
        cells = [find(results["answers"], name, "sobol_total", row["at"]) for name in names]
        if any(cell is not None and cell["value"] is not None for cell in cells):
            texts = ["–" if c is None or c["value"] is None else f"{c['value']:.3f}" for c in cells]
            rows.append((meaning(row["at"], results["inputs"]), *texts))
    return rows


def _paper(results: Results) -> list[tuple[str, ...]]:
    """The paper's printed values beside the corrected ones."""
    rows: list[tuple[str, ...]] = []
    for row in results.get("paper", ()):
        cells = [f"{row['printed']:.4g} {row['unit']}", "–"]
        if row["corrected"] is not None:
            cells[1] = f"{row['corrected']:.4g} {row['unit']}"
        rows.append((row["name"], *(cell.rstrip() for cell in cells)))
    return rows


def _table(header: tuple[str, ...], rows: list[tuple[str, ...]], width: int) -> list[str]:
    """Columns side by side; the first one gives way where the terminal is narrow."""
    cells = [header, *rows]
    widths = [max(len(row[k]) for row in cells) for k in range(len(header))]
    room = width - sum(widths[1:]) - 2 * (len(widths) - 1)
    widths[0] = max(min(widths[0], room), 8)
    return [
        "  ".join(text[:w].ljust(w) for text, w in zip(row, widths, strict=True)).rstrip()
        for row in cells
    ]
