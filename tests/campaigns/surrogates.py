"""How far a surrogate of the granite study's largest pressure comes, between finite bars, and whether it says so."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from uqsphere.report.figures.canvas import Picture

__all__ = ["figures", "measure", "text"]

STUDY: Final = "granite"
QUANTITY: Final = "p_max"
#: what is due from so many evaluations, or the engine says that the output is too rough
DUE: Final = 1e-5
DUE_POINTS: Final = 128
_SIZES: Final = (64, 128, 256, 512, 1024)
HELD_OUT: Final = 4096


def measure(quick: bool, notice: Callable[[str], None]) -> dict[str, Any]:
    """1 - Q² on held-out points, the error that each fit reports, and the verdict, by number of points and seed."""
    from uqsphere.model import answer
    from uqsphere.runner.evaluate import draw
    from uqsphere.study import load_study, shipped_studies
    from uqsphere.uq.expansion import fit_chaos, germ_points, judge, validation_error
    from uqsphere.uq.law import germs_of

    study = load_study(shipped_studies()[STUDY])
    names = tuple(name for name in study.random if not name.startswith("limits."))
    # as a run chooses them
    germs = germs_of(study.random[name] for name in names)
    inputs = study.inputs().only(names)
    sizes = _SIZES[:2] if quick else _SIZES
    seeds = range(1, 3 if quick else 11)

    def drawn(task: str, seed: int, count: int) -> tuple[Any, Any]:
        points = draw(inputs, seed=seed, task=f"surrogate: {task}", start=0, count=count, replicates=1)
        found = answer(study, names, points.inputs[0], (QUANTITY,), tolerance=1e-8)
        if (found.status != 0).any():
            notice(f"granite: {int((found.status != 0).sum())} of {count} rows have a status")
        return germ_points(points.scores[0], germs), found.values[:, 0]

    unseen, checked = drawn("held out", 0, HELD_OUT)
    fits = []
    for seed in seeds:
        points, outputs = drawn("fit", seed, max(sizes))
        for size in sizes:
            chaos = fit_chaos(points[:size], outputs[:size], germs)
            error = validation_error(chaos, unseen, checked)
            verdict = judge(chaos, error)
            fits.append({
                "points": size, "seed": seed, "error": error, "reported": chaos.cross_validation_error,
                "usable": verdict.usable, "terms": int(chaos.coefficients.size), "solver": chaos.solver,
                "transform": chaos.transform,
            })  # fmt: skip
        notice(f"granite: seed {seed}")
    return {"study": STUDY, "quantity": QUANTITY, "inputs": list(names), "held_out": HELD_OUT, "due": DUE,
            "scatter": float(np.std(checked) / np.mean(checked)), "fits": fits}  # fmt: skip


def text(content: dict[str, Any]) -> str:
    """The table, and the verdict on what is due."""
    fits = content["fits"]
    lines = [
        f"`{content['quantity']}` of `studies/{content['study']}.toml` (finite bars; random: "
        f"{', '.join(content['inputs'])}), which scatters by {content['scatter']:.1%}; 1 - Q² on "
        f"{content['held_out']:,} points, over {len({fit['seed'] for fit in fits})} designs; what the fits report of "
        "themselves; how often that is within a factor 3.",
        "",
        "| evaluations | 1 - Q², median | best | worst | reported, median | within a factor 3 | usable | terms |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for size in dict.fromkeys(fit["points"] for fit in fits):
        group = [fit for fit in fits if fit["points"] == size]
        errors = [fit["error"] for fit in group]
        honest = sum(max(fit["error"], fit["reported"]) <= 3.0 * min(fit["error"], fit["reported"]) for fit in group)
        reported = float(np.median([fit["reported"] for fit in group]))
        lines.append(
            f"| {size} | {np.median(errors):.1e} | {min(errors):.1e} | {max(errors):.1e} | {reported:.1e} | "
            f"{honest} of {len(group)} | {sum(fit['usable'] for fit in group)} of {len(group)} | "
            f"{np.median([fit['terms'] for fit in group]):.0f} |"
        )
    at = [fit for fit in fits if fit["points"] == DUE_POINTS]
    good = sum(fit["error"] < content["due"] for fit in at)
    knew = sum(fit["reported"] > content["due"] for fit in at if fit["error"] >= content["due"])
    lines += ["", f"Below {content['due']:g} from {DUE_POINTS} evaluations: {good} of {len(at)} fits."]
    if good < len(at):
        lines.append(
            f"Of the {len(at) - good} others {knew} report an error above {content['due']:g} themselves. "
            "A run samples, and the expansion is no more than its control variate."
        )
    return "\n".join(lines)


def figures(content: dict[str, Any]) -> list[Picture]:
    """True and reported error against evaluations."""
    from tests.campaigns.uncertainty import surrogate_figure

    return [surrogate_figure(content)]
