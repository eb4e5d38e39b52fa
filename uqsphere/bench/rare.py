"""The reliability table: evaluations, error and coverage of the rare-event methods on public problems."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from uqsphere.bench.rare_models import PROBLEMS, Problem

__all__ = ["Row", "integrate_plane", "measure", "rare_table", "rare_text"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Row:
    """What repetitions of `auto` gave on one problem; errors relative to the reference.

    `covered`: share of the intervals that hold the reference; `wrong`: runs off by more than 20 % whose
    interval neither holds the reference nor is there a warning; `form`: first-order answer over the reference.
    """

    name: str
    dimension: int
    reference: float
    published: float | None
    repetitions: int
    evaluations: float
    most_evaluations: int
    rms: float
    worst: float
    covered: float
    half_width: float
    agreed: float
    modes: tuple[int, int]
    wrong: int
    form: float | None


def measure(entry: Problem, *, repetitions: int, seed: int = 1, accuracy: float = 0.015, budget: int = 30_000) -> Row:
    """`find_probability` with as many seeds as there are repetitions."""
    from uqsphere.uq.rare.auto import find_probability
    from uqsphere.uq.rare.problem import LimitFunction

    limit = LimitFunction(function=entry.function, dimension=entry.dimension)
    answers = [
        find_probability(limit, seed=1000 * seed + k, accuracy=accuracy, budget=budget) for k in range(repetitions)
    ]
    values = np.array([a.estimate.value if a.estimate.value is not None else math.nan for a in answers])
    errors = np.nan_to_num(values / entry.reference - 1.0, nan=-1.0)
    covered = np.array([
        (a.estimate.low or 0.0) <= entry.reference <= (a.estimate.high if a.estimate.high is not None else 1.0)
        for a in answers
    ])  # fmt: skip
    spent = np.array([a.evaluations for a in answers])
    first = answers[0].design.probability
    return Row(
        name=entry.name,
        dimension=entry.dimension,
        reference=entry.reference,
        published=entry.published,
        repetitions=repetitions,
        evaluations=float(spent.mean()),
        most_evaluations=int(spent.max()),
        rms=float(np.sqrt(np.mean(errors**2))),
        worst=float(np.abs(errors).max()),
        covered=float(covered.mean()),
        half_width=float(np.mean([a.estimate.half_width / (a.estimate.value or math.inf) for a in answers])),
        agreed=float(np.mean([a.agreed for a in answers])),
        modes=(min(a.modes for a in answers), max(a.modes for a in answers)),
        wrong=sum(bool(abs(e) > 0.2 and not c and a.agreed) for e, c, a in zip(errors, covered, answers, strict=True)),
        form=None if first is None else first / entry.reference,
    )


def rare_table(
    *,
    repetitions: int = 10,
    problems: Sequence[Problem] = PROBLEMS,
    notice: Callable[[str], None] = lambda text: None,
) -> list[Row]:
    """Every problem in turn."""
    rows = []
    for entry in problems:
        notice(f"reliability: {entry.name}")
        rows.append(measure(entry, repetitions=repetitions))
    return rows


def rare_text(rows: Sequence[Row]) -> str:
    """The table in Markdown, with what it says of all problems of at most ten inputs."""
    lines = [
        "| problem | inputs | reference | evaluations | rms error | worst | covered | half-width | agreed | modes "
        "| FORM / reference |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        form = "none" if row.form is None else f"{row.form:.3g}"
        modes = f"{row.modes[0]}" if row.modes[0] == row.modes[1] else f"{row.modes[0]}–{row.modes[1]}"
        lines.append(
            f"| {row.name} | {row.dimension} | {row.reference:.4g} | {row.evaluations:,.0f} | {row.rms:.2%} "
            f"| {row.worst:.2%} | {row.covered:.0%} | {row.half_width:.2%} | {row.agreed:.0%} | {modes} | {form} |"
        )
    few = [row for row in rows if row.dimension <= 10]
    if few:
        within = sum(row.rms <= 0.01 for row in few)
        lines += [
            "",
            f"Up to ten inputs: rms error at most 1 % on {within} of {len(few)} problems, at most "
            f"{max(row.rms for row in few):.2%} on all; worst single run {max(row.worst for row in few):.2%}; pooled "
            f"coverage {np.mean([row.covered for row in few]):.1%}; at most "
            f"{max(row.most_evaluations for row in few):,} evaluations.",
        ]
    lines.append(f"Answers off by more than 20 % without interval or warning: {sum(row.wrong for row in rows)}.")
    return "\n".join(lines)


def integrate_plane(function: Callable[[Array], Array], *, panels: int = 720, grid: int = 2001) -> float:
    """Probability that a function of two standard normals is negative, by quadrature: the reference of the table.

    Gauss–Legendre points in the first variable; along the second the edges of the failure domain are bisected
    from a grid and the normal distribution is exact between them.

    >>> bool(abs(integrate_plane(lambda u: 3.0 - u[:, 0], panels=180, grid=401) / 1.3498980316e-3 - 1.0) < 1e-3)
    True
    """
    from scipy.special import ndtr

    nodes, weights = np.polynomial.legendre.leggauss(8)
    edges = np.linspace(-9.0, 9.0, panels + 1)
    half, middle = 0.5 * np.diff(edges), 0.5 * (edges[1:] + edges[:-1])
    first = (middle[:, None] + half[:, None] * nodes).ravel()
    mass = (half[:, None] * weights).ravel() * np.exp(-0.5 * first**2) / math.sqrt(2.0 * math.pi)
    second = np.linspace(-9.0, 9.0, grid)
    total = 0.0
    for x, share in zip(first, mass, strict=True):
        inside = function(np.column_stack([np.full(grid, x), second])) < 0.0
        change = np.flatnonzero(inside[1:] != inside[:-1])
        low, high, state = second[change].copy(), second[change + 1].copy(), inside[change]
        for _ in range(45 if change.size else 0):
            centre = 0.5 * (low + high)
            same = (function(np.column_stack([np.full(centre.size, x), centre])) < 0.0) == state
            low, high = np.where(same, centre, low), np.where(same, high, centre)
        ends = [*([-math.inf] if inside[0] else []), *(0.5 * (low + high)), *([math.inf] if inside[-1] else [])]
        for a, b in zip(ends[::2], ends[1::2], strict=True):
            total += share * float(ndtr(b) - ndtr(a) if a < 0.0 else ndtr(-a) - ndtr(-b))
    return total
