"""Few calls of a dear model: active learning on the public problems, with at most 200 calls."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.bench.rare_models import problem

__all__ = ["FEW_PROBLEMS", "FewRow", "few_call_rows", "few_call_text"]

CALLS: Final = 200
FEW_PROBLEMS: Final = ("four branches", "two-sided", "RP14", "RP25", "RP35", "RP53", "RP57", "RP110", "roof truss")


@dataclass(frozen=True, kw_only=True)
class FewRow:
    """What repetitions gave on one problem; errors relative to the reference, `missed` of known modes at worst.

    `silent`: runs off by more than 20 % whose interval does not hold the reference and that give no warning.
    """

    name: str
    dimension: int
    repetitions: int
    calls: float
    rms: float
    worst: float
    covered: float
    warned: float
    missed: int
    silent: int


def few_call_rows(
    *, repetitions: int, problems: Sequence[str] = FEW_PROBLEMS, notice: Callable[[str], None] = lambda text: None
) -> list[FewRow]:
    """`learn_probability` with at most 200 calls and as many seeds as there are repetitions."""
    from uqsphere.uq.rare.active import learn_probability
    from uqsphere.uq.rare.problem import LimitFunction

    rows = []
    for name in problems:
        entry = problem(name)
        notice(f"few calls: {name}")
        limit = LimitFunction(function=entry.function, dimension=entry.dimension)
        found = [learn_probability(limit, seed=1 + k, budget=CALLS) for k in range(repetitions)]
        errors = np.array([(one.estimate.value or 0.0) / entry.reference - 1.0 for one in found])
        lows = np.array([one.estimate.low or 0.0 for one in found])
        highs = np.array([math.inf if one.estimate.high is None else one.estimate.high for one in found])
        held = (lows <= entry.reference) & (entry.reference <= highs)
        warned = np.array([bool(one.warning) or one.estimate.value is None for one in found])
        rows.append(
            FewRow(
                name=name,
                dimension=entry.dimension,
                repetitions=repetitions,
                calls=float(np.mean([one.calls for one in found])),
                rms=float(np.sqrt(np.mean(errors**2))),
                worst=float(np.abs(errors).max()),
                covered=float(held.mean()),
                warned=float(warned.mean()),
                missed=0 if entry.modes is None else max(0, entry.modes - min(one.modes for one in found)),
                silent=int(((np.abs(errors) > 0.2) & ~held & ~warned).sum()),
            )
        )
    return rows


def few_call_text(rows: Sequence[FewRow]) -> str:
    """The table in Markdown."""
    lines = [
        f"Active learning with at most {CALLS} calls, for models of which an evaluation takes seconds.",
        "",
        "| problem | inputs | runs | calls | rms error | worst | covered | warned | modes missed |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {row.name} | {row.dimension} | {row.repetitions} | {row.calls:.0f} | {row.rms:.1%} | {row.worst:.1%} "
        f"| {row.covered:.0%} | {row.warned:.0%} | {row.missed} |"
        for row in rows
    ]
    lines.append(f"\nOff by more than 20 % without interval or warning: {sum(row.silent for row in rows)}.")
    return "\n".join(lines)
